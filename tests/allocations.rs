//! The path of a sample from the bus's callback through queue, decoding, limits and engine to the recorder allocates no memory
//! per sample. Measured with a counting allocator, over a whole daemon without threads.
#![allow(missing_docs, clippy::unwrap_used, clippy::expect_used, clippy::panic)]

use std::io::Write as _;
use std::sync::Arc;

use allocation_counter::measure;
use stiction_engine::config::Config;
use stiction_files::disk::{Disk, SystemDisk};
use stictiond::daemon::sim_daemon::{SimDaemon, no_receiver};
use stictiond::runtime::clock::Clock;

const LOOPS: usize = 50;
const START_NS: i64 = 1_700_000_123_000_000_000;
/// Scans until every ring buffer has its final size, and the scans that are measured.
const WARM: usize = 400;
const COUNTED: usize = 200;

struct Plant {
    keys: Vec<String>,
    payload: Vec<u8>,
    scan: i64,
}

impl Plant {
    /// Every key's next `batch` samples, as one message each.
    fn scan(&mut self, stage: &SimDaemon, batch: i64) {
        for (index, key) in self.keys.iter().enumerate() {
            self.payload.clear();
            for k in self.scan..self.scan + batch {
                let mark = if batch == 1 {
                    ""
                } else if k == self.scan {
                    "["
                } else {
                    ","
                };
                let t_ns = START_NS + k * 10_000_000_000;
                let value = 50.0 + ((k * 7919 + index as i64) % 1000) as f64 / 300.0;
                write!(self.payload, "{mark}{{\"t\":{t_ns},\"v\":{value:?}}}").unwrap();
            }
            if batch > 1 {
                self.payload.push(b']');
            }
            stage.deliver(key, &self.payload);
        }
        self.scan += batch;
    }
}

fn stage(dir: &std::path::Path) -> (SimDaemon, Plant) {
    let text = format!(
        "[site]\nprefix = \"p\"\n[window]\nhop_s = 31622400.0\nmax_points = 128\nmax_window_s = 31622400.0\n[recording]\ndir = {:?}\n",
        dir.to_str().unwrap()
    );
    let disk = Arc::new(SystemDisk) as Arc<dyn Disk>;
    let stage =
        SimDaemon::start(Config::parse(&text).unwrap(), &text, &Clock::standing(START_NS), &disk, no_receiver).unwrap();
    let of = |k: usize| ["op", "pv"].map(|signal| format!("p/L{k}/{signal}"));
    (stage, Plant { keys: (0..LOOPS).flat_map(of).collect(), payload: Vec::with_capacity(1 << 16), scan: 0 })
}

/// Allocations per thousand samples in intake and engine, and in the recorder.
fn counted(batch: i64) -> [f64; 2] {
    let dir = tempfile::tempdir().unwrap();
    let (mut stage, mut plant) = stage(dir.path());
    for _ in 0..WARM {
        plant.scan(&stage, 10);
        stage.turn();
        stage.record();
    }
    stage.published().for_each(drop);
    let (mut taking, mut recording) = (0, 0);
    for _ in 0..COUNTED {
        taking += measure(|| {
            plant.scan(&stage, batch);
            stage.turn();
        })
        .count_total;
        recording += measure(|| stage.record()).count_total;
    }
    let samples = (COUNTED * plant.keys.len()) as f64 * batch as f64;
    assert_eq!(stage.metrics().samples.get() as f64, samples + (WARM * plant.keys.len() * 10) as f64);
    assert_eq!(stage.metrics().dropped_input.get() + stage.metrics().recording_lost.get(), 0);
    [taking, recording].map(|n| 1e3 * n as f64 / samples)
}

#[test]
fn a_thousand_samples_ask_for_memory_a_few_dozen_times() {
    for batch in [1, 50] {
        let [taking, recording] = counted(batch);
        println!(
            "batches of {batch}: {taking:.2} allocations a thousand samples up to the queue of the recorder, {recording:.2} in it"
        );
        // Measured: 7.5 singly and 3.3 in batches up to the recorder, and 44 and 53 in it, for its file's index of each chunk
        // and channel.
        assert!(taking < 12.0, "{taking} a thousand samples in the intake");
        assert!(recording < 60.0, "{recording} a thousand samples in the recorder");
    }
}
