//! How costs grow with loops, samples and periods: the exponent of a straight line through the logarithms of several
//! sizes.

use super::{PREFIX, Row, cpu};
use stiction::core::record::{Record, Sample, Signal, Value};
use stiction::core::units::ns_from_s;
use stiction::core::verdict::{AssessParams, assess};
use stiction_engine::config::Config;
use stiction_engine::engine::{Engine, Event};

/// Numbers of loops compared, and samples of each signal.
const LOOPS: [usize; 4] = [500, 1000, 2000, 4000];
const SAMPLES_A_LOOP: usize = 400;
/// Samples per signal compared, with a hundred loops.
const SAMPLES: [usize; 4] = [250, 500, 1000, 2000];
const LOOPS_OF_SAMPLES: usize = 100;
/// Samples of a window with a period of 50; and periods of a window of 2,000 samples.
const WINDOW_SAMPLES: [usize; 4] = [250, 500, 1000, 2000];
const WINDOW_PERIODS: [usize; 4] = [5, 10, 20, 40];
/// Sampling time, s.
const EVERY_S: f64 = 10.0;

/// Every row.
pub fn rows() -> Vec<Row> {
    let by_loops = LOOPS.map(|loops| (loops as f64, filled(loops, SAMPLES_A_LOOP)));
    let by_samples = SAMPLES.map(|samples| (samples as f64, filled(LOOPS_OF_SAMPLES, samples)));
    let points = |all: &[(f64, [f64; 2]); 4], of: usize| all.map(|(x, y)| (x, y[of]));
    let window = |n: usize, period: f64| cpu::ms(5, || assess(&swinging(n, period), &AssessParams::default()));
    let mut rows = Vec::new();
    let mut add = |what: &str, unit: &'static str, all: [(f64, f64); 4]| {
        for (x, y) in all {
            rows.push(Row { name: format!("{what}, {x:.0}"), value: y, unit });
        }
        rows.push(Row { name: format!("{what}: exponent"), value: exponent(&all), unit: "" });
    };
    add("memory of the loops, by loops", "MiB", points(&by_loops, 0));
    add("CPU of the intake, by loops", "ms", points(&by_loops, 1));
    add("memory of 100 loops, by samples held of each signal", "MiB", points(&by_samples, 0));
    add("CPU of the intake of 100 loops, by samples", "ms", points(&by_samples, 1));
    add("estimate of an oscillating loop, by samples", "ms", WINDOW_SAMPLES.map(|n| (n as f64, window(n, 50.0))));
    let of_periods = |periods: usize| (periods as f64, window(2000, 2000.0 / periods as f64));
    add("estimate of 2,000 samples, by periods", "ms", WINDOW_PERIODS.map(of_periods));
    rows
}

/// Memory (MiB) of this many loops and samples, and CPU time (ms) of their intake.
fn filled(loops: usize, samples: usize) -> [f64; 2] {
    let mut config = Config::with_prefix(PREFIX);
    config.window.hop_s = 1e9;
    let mut engine = Engine::new(config.engine());
    let ids: Vec<_> = (0..loops).filter_map(|k| engine.appear(&format!("L{k:06}"))).collect();
    let (mut events, before) = (Vec::<Event>::new(), cpu::seconds());
    for k in 0..samples {
        for (index, id) in ids.iter().enumerate() {
            for (signal, phase) in [(Signal::Op, 0.0), (Signal::Pv, 1.0)] {
                let value = Value::number(50.0 + libm::sin(0.1 * k as f64 + phase + index as f64));
                let sample = Sample { signal, t_ns: ns_from_s(EVERY_S * k as f64), value, quality: None };
                engine.push(*id, sample, &mut events);
            }
        }
    }
    let took_ms = 1e3 * (cpu::seconds() - before);
    let bytes: usize = ids.iter().map(|id| engine.bytes(*id)).sum();
    [bytes as f64 / f64::from(1 << 20), took_ms]
}

/// A loop that oscillates with a period given in samples.
fn swinging(n: usize, period: f64) -> Record {
    let wave = |k: usize, phase: f64| libm::sin(2.0 * core::f64::consts::PI * (k as f64 / period + phase));
    let noise = |k: usize| ((k as u64).wrapping_mul(0x9e37_79b9_7f4a_7c15) >> 40) as f64 / f64::from(1 << 24) - 0.5;
    let op = (0..n).map(|k| 50.0 + 4.0 * wave(k, 0.0) + 0.1 * noise(k)).collect();
    let pv = (0..n).map(|k| 30.0 + 3.0 * wave(k, 0.2).signum() + 0.1 * noise(k + n)).collect();
    Record::uniform(EVERY_S, op, pv)
}

/// Slope of the logarithms, by least squares.
pub fn exponent(points: &[(f64, f64)]) -> f64 {
    let logs: Vec<(f64, f64)> = points.iter().map(|(x, y)| (libm::log(*x), libm::log(*y))).collect();
    let n = logs.len() as f64;
    let (mx, my) = (logs.iter().map(|p| p.0).sum::<f64>() / n, logs.iter().map(|p| p.1).sum::<f64>() / n);
    let top: f64 = logs.iter().map(|(x, y)| (x - mx) * (y - my)).sum();
    top / logs.iter().map(|(x, _)| (x - mx) * (x - mx)).sum::<f64>()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_exponent_is_read_from_sizes() {
        let of = |power: f64| [1.0, 2.0, 4.0, 8.0].map(|x: f64| (x, 3.0 * libm::pow(x, power)));
        assert!([0.0, 1.0, 2.0].into_iter().all(|power| (exponent(&of(power)) - power).abs() < 1e-12));
    }
}
