//! Values that an export repeats: held over its rows, or frozen for a long time.

use stiction::core::record::{Sample, Signal};
use stiction::core::signal::held::held_over;
use stiction::core::units::{format_rfc3339, number, s_from_ns};

/// Fewest equal values in a row that are reported as a frozen stretch, and how many times longer than the average run it must be.
const FEWEST: usize = 30;
const TIMES: f64 = 20.0;

/// Notes on values of OP and PV that are repeated, one line each.
#[must_use]
pub fn repeated_values(samples: &[Sample]) -> Vec<String> {
    [Signal::Op, Signal::Pv].into_iter().flat_map(|signal| of_signal(signal, samples)).collect()
}

fn of_signal(signal: Signal, samples: &[Sample]) -> Vec<String> {
    let own = samples.iter().filter(|s| s.signal == signal);
    let (times, values): (Vec<i64>, Vec<f64>) = own.filter_map(|s| Some((s.t_ns, s.value.as_number()?))).unzip();
    let name = signal.name().to_uppercase();
    let mut notes = Vec::new();
    let rows = held_over(&values);
    if let (2.., Some(span_ns)) = (rows, times.last().zip(times.first()).map(|(end, start)| end.saturating_sub(*start)))
    {
        let every_s = s_from_ns(span_ns) / (times.len() - 1) as f64 * rows as f64;
        notes.push(format!("{name} is held over {rows} rows: it was sampled every {} s", number(every_s)));
    }
    // Runs of equal values, as first and last index.
    let mut runs: Vec<(usize, usize)> = Vec::new();
    for (k, value) in values.iter().enumerate() {
        match runs.last_mut() {
            Some((from, to)) if values[*from] == *value => *to = k,
            _ => runs.push((k, k)),
        }
    }
    let usual = values.len() as f64 / runs.len().max(1) as f64;
    let is_still = |(from, to): &&(usize, usize)| to - from >= FEWEST && (to - from) as f64 >= TIMES * usual;
    let still: Vec<(usize, usize)> = runs.iter().filter(is_still).copied().collect();
    if let Some((from, to)) = still.iter().max_by_key(|(from, to)| to - from) {
        let rows: usize = still.iter().map(|(from, to)| to - from + 1).sum();
        let share = (100.0 * rows as f64 / values.len() as f64).ceil();
        let count = if still.len() == 1 { "a stretch".to_owned() } else { format!("{} stretches", still.len()) };
        let [from, to] = [from, to].map(|k| format_rfc3339(times[*k]));
        notes.push(format!("{name} stands still in {count}, {share} % of its values; the longest is {from} to {to}"));
    }
    notes
}

#[cfg(test)]
mod tests {
    use super::*;
    use stiction::core::record::Value;

    fn notes(value: impl Fn(i64) -> f64) -> Vec<String> {
        let sample = |k: i64| Sample {
            signal: Signal::Pv,
            t_ns: k * 1_000_000_000,
            value: Value::Number(value(k)),
            quality: None,
        };
        repeated_values(&(0..600).map(sample).collect::<Vec<_>>())
    }

    #[test]
    fn held_values_and_stretches_without_a_move_are_named() {
        let noise = |k: i64| (k.wrapping_mul(2_654_435_761) >> 7 & 1023) as f64;
        assert_eq!(notes(noise), Vec::<String>::new());
        assert_eq!(notes(|k| noise(k / 10)), ["PV is held over 10 rows: it was sampled every 10 s"]);
        let frozen = |k: i64| if (100..160).contains(&k) || (300..341).contains(&k) { 7.5 } else { noise(k) };
        let text = "PV stands still in 2 stretches, 17 % of its values; the longest is 1970-01-01T00:01:40Z to 1970-01-01T00:02:39Z";
        assert_eq!(notes(frozen), [text]);
        // A slow sensor with coarse steps is not a frozen one.
        assert_eq!(notes(|k| (k / 31) as f64), Vec::<String>::new());
    }
}
