//! The plant and all other senders on the bus: samples with every fault that a gateway or stranger can add.

use rand_chacha::ChaCha8Rng;
use rand_chacha::rand_core::Rng;

/// Step of the simulation and sampling time of the plant: ten minutes, ns.
pub const STEP_NS: i64 = 600_000_000_000;
const DAY_NS: i64 = 86_400_000_000_000;

/// One message under way, and the most samples it can contain.
pub struct Sent {
    pub key: String,
    pub payload: Vec<u8>,
    pub samples: u64,
}

pub struct Plant {
    pub prefix: &'static str,
    pub loops: usize,
    /// Offsets of the loops' clocks, ns.
    offsets_ns: Vec<i64>,
    /// Remaining steps of the loop with racing stamps, and how far its stamps have come.
    racing: (u32, i64),
    /// Messages that arrive one step late.
    late: Vec<Sent>,
    /// Batches that some loops' gateways collect for an hour, OP and PV.
    gathered: Vec<[Vec<String>; 2]>,
}

pub fn below(random: &mut ChaCha8Rng, n: u32) -> u32 {
    random.next_u32() % n
}

pub fn one_in(random: &mut ChaCha8Rng, n: u32) -> bool {
    below(random, n) == 0
}

impl Plant {
    pub fn new(prefix: &'static str, loops: usize) -> Self {
        let offsets_ns = (0..loops as i64).map(|k| k * 1_000_000).collect();
        let gathered = (0..loops).map(|_| Default::default()).collect();
        Self { prefix, loops, offsets_ns, racing: (0, 0), late: Vec::new(), gathered }
    }

    pub fn name(index: usize) -> String {
        format!("L{index:03}")
    }

    /// The plant's messages in a step, in order of arrival.
    pub fn step(&mut self, random: &mut ChaCha8Rng, step: i64, start_ns: i64) -> Vec<Sent> {
        let mut out = std::mem::take(&mut self.late);
        for index in 0..self.loops {
            if one_in(random, 50_000) {
                // A clock on site is set forwards or backwards, by hours or by years.
                let far = if one_in(random, 4) { 3650 * DAY_NS } else { DAY_NS / 4 };
                self.offsets_ns[index] += if one_in(random, 2) { far } else { -far };
            }
            let t_ns = start_ns + step * STEP_NS + self.offsets_ns[index];
            let phase = step as f64 * 0.3 + index as f64;
            let values = [50.0 + 8.0 * phase.sin() + (phase * 0.37).sin(), 30.0 + 5.0 * (phase - 0.8).sin()];
            for (signal, value) in values.into_iter().enumerate() {
                self.send(random, index, signal, &format!("{{\"t\":{t_ns},\"v\":{value:.4}}}"), &mut out);
            }
        }
        self.put_racing_stamps(random, step, start_ns, &mut out);
        strangers(random, self.prefix, &mut out);
        if one_in(random, 3) {
            // Messages overtake each other.
            for k in (1..out.len()).rev() {
                let near = k.saturating_sub(below(random, 40) as usize);
                out.swap(k, near);
            }
        }
        out
    }

    fn send(&mut self, random: &mut ChaCha8Rng, index: usize, signal: usize, object: &str, out: &mut Vec<Sent>) {
        let key = format!("{}/{}/{}", self.prefix, Self::name(index), ["op", "pv"][signal]);
        let (payload, samples) = if index.is_multiple_of(2) {
            (object.to_owned(), 1)
        } else {
            let batch = &mut self.gathered[index][signal];
            batch.push(object.to_owned());
            if batch.len() < 6 {
                return;
            }
            let whole = format!("[{}]", batch.join(","));
            (whole, std::mem::take(batch).len() as u64)
        };
        let sent = Sent { key, payload: payload.into_bytes(), samples };
        match below(random, 400) {
            0..4 => {} // lost
            4..12 => self.late.push(sent),
            12..20 => {
                out.push(Sent { key: sent.key.clone(), payload: sent.payload.clone(), ..sent });
                out.push(sent);
            }
            20 => out.push(Sent { payload: b"{\"v\":[[nonsense".to_vec(), samples: 0, ..sent }),
            _ => out.push(sent),
        }
    }

    /// Whether the first loop's stamps are racing.
    pub const fn has_racing_stamps(&self) -> bool {
        self.racing.0 > 0
    }

    /// Sometimes the first loop's stamps race: from years ago, twelve hours per sample.
    fn put_racing_stamps(&mut self, random: &mut ChaCha8Rng, step: i64, start_ns: i64, out: &mut Vec<Sent>) {
        if self.racing.0 == 0 {
            if one_in(random, 300) {
                self.racing = (12, start_ns + step * STEP_NS - 3650 * DAY_NS);
            }
            return;
        }
        self.racing.0 -= 1;
        for _ in 0..300 {
            self.racing.1 += DAY_NS / 2;
            for signal in ["op", "pv"] {
                let payload = format!("{{\"t\":{},\"v\":1.5}}", self.racing.1).into_bytes();
                let key = format!("{}/{}/{signal}", self.prefix, Self::name(0));
                out.push(Sent { key, payload, samples: 1 });
            }
        }
    }
}

/// Meaningless keys, unknown loops, and bytes of all kinds.
fn strangers(random: &mut ChaCha8Rng, prefix: &str, out: &mut Vec<Sent>) {
    for _ in 0..below(random, 4) {
        let n = below(random, 1_000_000);
        let key = match below(random, 3) {
            0 => format!("{prefix}/x{n}/temperature"),
            1 => format!("{prefix}/\u{1b}[2J{n}/op"),
            _ => format!("{prefix}/stranger{n}/op"),
        };
        // Some of it can be read as numbers.
        let payload: Vec<u8> = (0..below(random, 64)).map(|_| below(random, 256) as u8).collect();
        out.push(Sent { samples: payload.len() as u64, key, payload });
    }
}
