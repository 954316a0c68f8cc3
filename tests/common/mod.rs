//! Helpers of the tests: a small closed loop, and records read from CSV files.
#![allow(missing_docs, dead_code)]
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]

pub mod healthy;
#[cfg(feature = "daemon")]
pub mod program;

use rand_chacha::ChaCha8Rng;
use rand_chacha::rand_core::{Rng, SeedableRng};
use stictiond::record::Record;
use stictiond::sim::process::Pole;
use stictiond::sim::valve::{Tracking, he_step, tracking_step};

pub struct Draw(ChaCha8Rng);

impl Draw {
    pub fn new(seed: u64) -> Self {
        Self(ChaCha8Rng::seed_from_u64(seed))
    }

    pub fn uniform(&mut self) -> f64 {
        (self.0.next_u64() >> 11) as f64 / (1_u64 << 53) as f64
    }

    pub fn between(&mut self, low: f64, high: f64) -> f64 {
        low + (high - low) * self.uniform()
    }

    pub fn normal(&mut self) -> f64 {
        (0..12).map(|_| self.uniform()).sum::<f64>() - 6.0
    }
}

/// A loop with one valve: PI controller, valve law, process as a sum of poles, white noise on PV.
#[derive(Debug, Clone)]
pub struct Loop {
    pub fs: f64,
    pub fd: f64,
    pub tracking: bool,
    pub gain: f64,
    /// One or two time constants, samples; empty: integrating.
    pub taus: Vec<f64>,
    pub dead_time: f64,
    pub kc: f64,
    pub ti: f64,
    pub noise: f64,
    /// Set point as a function of the sample.
    pub sp: fn(usize) -> f64,
    pub n: usize,
    pub warm_up: usize,
    pub seed: u64,
}

pub struct Simulated {
    pub record: Record,
    pub mv: Vec<f64>,
    pub noise_sd: f64,
    /// PV without noise.
    pub clean: Vec<f64>,
}

impl Loop {
    pub fn run(&self) -> Simulated {
        let mut draw = Draw::new(self.seed);
        let fraction = self.dead_time.fract();
        let whole = self.dead_time.floor() as usize;
        let parts: Vec<(f64, Pole)> = match self.taus.as_slice() {
            [] => vec![(1.0, Pole::integrator(fraction))],
            [t] => vec![(1.0, Pole::lag(*t, fraction))],
            [a, b, ..] => {
                vec![(a / (a - b), Pole::lag(*a, fraction)), (-b / (a - b), Pole::lag(*b, fraction))]
            }
        };
        let mut state = vec![0.0; parts.len()];
        let mut history = vec![0.0; whole + 2];
        let (mut position, mut track) = (0.0, Tracking { position: 0.0, direction: 0 });
        let (mut op, mut last_error) = (0.0_f64, None);
        let (mut ops, mut pvs, mut mvs, mut clean) = (vec![], vec![], vec![], vec![]);
        for k in 0..self.n + self.warm_up {
            // The valve position held since the sample before acts now, `dead_time` later.
            history.rotate_right(1);
            history[0] = position;
            let (newer, older) = (history[whole], history[whole + 1]);
            let mut x = 0.0;
            for ((w, pole), s) in parts.iter().zip(&mut state) {
                *s = pole.a * *s + pole.b0 * newer + pole.b1 * older;
                x += w * *s;
            }
            let pv = self.gain * x + self.noise * draw.normal();
            let error = (self.sp)(k) - pv;
            op += self.kc * (error - last_error.unwrap_or(error)) + self.kc / self.ti * error;
            last_error = Some(error);
            if self.tracking {
                track = tracking_step(track, op, self.fs, self.fd);
                position = track.position;
            } else {
                position = he_step(position, op, self.fs, self.fd);
            }
            if k >= self.warm_up {
                ops.push(50.0 + op);
                pvs.push(200.0 + pv);
                mvs.push(50.0 + position);
                clean.push(200.0 + self.gain * x);
            }
        }
        Simulated { record: Record::uniform(1.0, ops, pvs), mv: mvs, noise_sd: self.noise, clean }
    }

    /// A random sticking loop of the given kind: 0 first order, 1 second order, 2 integrating.
    pub fn random(kind: u8, seed: u64) -> Self {
        let mut d = Draw::new(seed.wrapping_mul(7919).wrapping_add(u64::from(kind)));
        let sign = if d.uniform() < 0.5 { 1.0 } else { -1.0 };
        let tau = libm::exp(d.between(libm::log(4.0), libm::log(30.0)));
        let dead_time = d.between(0.5, 10.0);
        let gain = sign * d.between(0.5, 3.0);
        let fs = d.between(1.0, 4.0);
        let fd = fs * d.between(0.05, 0.9);
        let (taus, kc, ti) = match kind {
            0 => (vec![tau], d.between(0.25, 0.5) * tau / (dead_time + 1.0) / gain, tau),
            1 => {
                let second = tau * d.between(0.2, 0.7);
                (vec![tau, second], d.between(0.2, 0.35) * tau / (dead_time + 1.0 + second) / gain, tau + second)
            }
            _ => {
                let slope = gain / 20.0;
                (vec![], d.between(0.2, 0.35) / (slope * (dead_time + 1.0)), 10.0 * (dead_time + 1.0))
            }
        };
        let gain = if kind >= 2 { gain / 20.0 } else { gain };
        let sp: fn(usize) -> f64 = if d.uniform() < 0.3 { |_| 2.0 } else { |k| [0.0, 5.0, -3.0, 4.0][k / 300 % 4] };
        let mut out =
            Self { fs, fd, tracking: false, gain, taus, dead_time, kc, ti, noise: 0.0, sp, n: 1200, warm_up: 0, seed };
        // Noise of 0.5 to 10 % of PV's spread.
        let spread = stictiond::signal::stats::std_dev(&out.run().record.pv);
        out.noise = spread * libm::exp(d.between(libm::log(0.005), libm::log(0.1)));
        out
    }
}

/// Boxes of `k` raw samples: PV's mean, and OP's first, extremes (in the order in which they came) and last.
pub fn boxed(ts_s: f64, op: &[f64], pv: &[f64], k: usize) -> Record {
    let mut record = Record::uniform(ts_s, op.to_vec(), pv.to_vec());
    if k <= 1 {
        return record;
    }
    record.box_samples = k;
    record.pv = pv.chunks_exact(k).map(|c| c.iter().sum::<f64>() / k as f64).collect();
    record.op_path = op
        .chunks_exact(k)
        .flat_map(|c| {
            let at = |better: fn(f64, f64) -> bool| (0..c.len()).fold(0, |b, i| if better(c[i], c[b]) { i } else { b });
            let (low, high) = (at(|a, b| a < b), at(|a, b| a > b));
            let (one, two) = if low < high { (c[low], c[high]) } else { (c[high], c[low]) };
            [c[0], one, two, c[k - 1]]
        })
        .collect();
    record
}

/// One labelled recording.
pub struct Labelled {
    pub file: String,
    pub label: String,
    /// What the loop controls, as the index words it.
    pub kind: String,
    pub record: Record,
}

/// Cells of a line of CSV, quotes taken off.
pub fn cells(line: &str) -> Vec<String> {
    let (mut out, mut quoted) = (vec![String::new()], false);
    for c in line.chars() {
        match c {
            '"' => quoted = !quoted,
            ',' if !quoted => out.push(String::new()),
            c => out.last_mut().unwrap().push(c),
        }
    }
    out
}

/// The recordings that the product may look at, or nothing where they are not there.
pub fn labelled(folder: &str) -> Vec<Labelled> {
    let root = std::path::Path::new(folder);
    let Ok(index) = std::fs::read_to_string(root.join("INDEX.csv")) else { return Vec::new() };
    let mut lines = index.lines();
    let header: Vec<&str> = lines.next().unwrap().split(',').collect();
    let place = |name: &str| header.iter().position(|h| *h == name).unwrap();
    let (file, label, ts) = (place("file"), place("label"), place("sample_time_s"));
    let kind = place("loop_type");
    lines
        .filter_map(|line| {
            let cells: Vec<&str> = line.split(',').collect();
            let record = read(&root.join(cells[file]), cells[ts].parse().ok())?;
            let [file, label, kind] = [file, label, kind].map(|at| cells[at].to_owned());
            Some(Labelled { file, label, kind, record })
        })
        .collect()
}

/// Where the labelled recordings of real loops are, which are no part of the project.
pub const RECORDINGS: &str = "../shared/data";

/// The same, or a loud word that `test` was skipped for want of them.
pub fn labelled_or_skip(test: &str) -> Option<Vec<Labelled>> {
    let all = labelled(RECORDINGS);
    if all.is_empty() {
        skipped(test, "no labelled recordings in ../shared/data");
    }
    (!all.is_empty()).then_some(all)
}

/// Says that a test was skipped, past the harness, which keeps what passing tests print to itself; `tests/run.sh` counts
/// these lines.
pub fn skipped(test: &str, why: &str) {
    use std::io::Write;
    let _ = std::io::stderr().lock().write_all(format!("\nSKIPPED: {test}: {why}\n").as_bytes());
}

/// Reads `t,op,pv[,sp]`, drops rows that are not finite or do not advance, and boxes what is longer than 2000 samples.
fn read(path: &std::path::Path, _ts: Option<f64>) -> Option<Record> {
    let text = std::fs::read_to_string(path).ok()?;
    let mut lines = text.lines();
    let header: Vec<&str> = lines.next()?.split(',').collect();
    let place = |name: &str| header.iter().position(|h| h.trim() == name);
    let (t, op, pv) = (place("t")?, place("op")?, place("pv")?);
    let sp = place("sp");
    let mut rows: Vec<[f64; 4]> = Vec::new();
    for line in lines {
        let cells: Vec<&str> = line.split(',').collect();
        let number = |at: usize| cells.get(at).and_then(|c| c.trim().parse::<f64>().ok()).unwrap_or(f64::NAN);
        let row = [number(t), number(op), number(pv), sp.map_or(0.0, number)];
        if row.iter().all(|v| v.is_finite()) && rows.last().is_none_or(|r| r[0] < row[0]) {
            rows.push(row);
        }
    }
    if rows.len() < 2 {
        return None;
    }
    let ts = (rows[rows.len() - 1][0] - rows[0][0]) / (rows.len() - 1) as f64;
    let mut k = 1;
    while rows.len().div_ceil(k) > 2000 {
        k *= 2;
    }
    let column = |at: usize| rows.iter().map(|r| r[at]).collect::<Vec<f64>>();
    let mut record = boxed(ts, &column(1), &column(2), k);
    if sp.is_some() && column(3).iter().any(|v| *v != 0.0) {
        record.sp = Some(column(3).chunks_exact(k).map(|c| c.iter().sum::<f64>() / k as f64).collect());
    }
    let steps: Vec<f64> = rows.windows(2).map(|w| w[1][0] - w[0][0]).collect();
    record.irregularity = 1.4826 * stictiond::signal::stats::mad(&steps) / ts;
    Some(record)
}
