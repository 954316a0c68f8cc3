//! Resamples irregular samples to a constant rate.

use super::LoadedLoop;
use stiction::core::record::{Sample, Signal, Value};
use stiction::core::units::{ns_from_s, s_from_ns};

/// Gaps of more than this many steps, of the new rate or of the signal's own, remain data gaps.
const LONGEST_STEPS: i64 = 5;
/// Most points: a year of seconds.
const MOST_POINTS: i64 = 40_000_000;

/// Samples of a loop every `ts_s` seconds from its first timestamp: OP, SP and MODE are held, PV and MV interpolated
/// linearly. In data gaps OP and PV are missing; other signals have no samples there.
///
/// # Errors
/// A sentence: no samples, or implausibly many points.
pub fn even(one: &LoadedLoop, ts_s: f64) -> Result<LoadedLoop, String> {
    let step_ns = ns_from_s(ts_s);
    let stamps = || one.samples.iter().filter(|s| matches!(s.signal, Signal::Op | Signal::Pv)).map(|s| s.t_ns);
    let (Some(start), Some(end)) = (stamps().min(), stamps().max()) else {
        return Err("has neither OP nor PV".into());
    };
    let points = end.saturating_sub(start) / step_ns.max(1) + 1;
    if step_ns < 1 || points > MOST_POINTS {
        let span_s = s_from_ns(end.saturating_sub(start));
        return Err(format!("one sample every {ts_s} s over {span_s} s makes {points} points; choose a longer step"));
    }
    let mut samples: Vec<Sample> = Vec::new();
    for signal in Signal::ALL {
        let mut own: Vec<(i64, Value)> =
            one.samples.iter().filter(|s| s.signal == signal).map(|s| (s.t_ns, s.value)).collect();
        own.sort_by_key(|(t, _)| *t);
        if own.is_empty() {
            continue;
        }
        let longest = LONGEST_STEPS * step_ns.max(median_step(&own));
        let straight = matches!(signal, Signal::Pv | Signal::Mv);
        let needed = matches!(signal, Signal::Op | Signal::Pv);
        let mut next = 0;
        for point in 0..points {
            let t_ns = start + point * step_ns;
            while next < own.len() && own[next].0 <= t_ns {
                next += 1;
            }
            let value = between(next.checked_sub(1).map(|k| own[k]), own.get(next).copied(), t_ns, longest, straight);
            if needed || value != Value::Missing {
                samples.push(Sample { signal, t_ns, value, quality: None });
            }
        }
    }
    samples.sort_by_key(|s| s.t_ns);
    let about = one.about.clone().map(|about| super::About { ts_s, ..about });
    Ok(LoadedLoop { about, units: one.units.clone(), ..LoadedLoop::new(one.name.clone(), samples) })
}

fn median_step(own: &[(i64, Value)]) -> i64 {
    let mut steps: Vec<i64> = own.windows(2).map(|w| w[1].0.saturating_sub(w[0].0)).filter(|s| *s > 0).collect();
    if steps.is_empty() {
        return 0;
    }
    let middle = steps.len() / 2;
    *steps.select_nth_unstable(middle).1
}

/// The value at a time, from the sample at or before it and the one after it.
fn between(
    before: Option<(i64, Value)>,
    behind: Option<(i64, Value)>,
    t_ns: i64,
    longest: i64,
    straight: bool,
) -> Value {
    let Some((from, value)) = before else { return Value::Missing };
    if from == t_ns {
        return value;
    }
    match (value, behind) {
        _ if t_ns.saturating_sub(from) > longest => Value::Missing,
        (Value::Number(a), Some((to, Value::Number(b)))) if straight => {
            if to.saturating_sub(from) > longest {
                return Value::Missing;
            }
            Value::Number(a + (b - a) * (s_from_ns(t_ns - from) / s_from_ns(to - from)))
        }
        (_, _) if straight => Value::Missing,
        (held, _) => held,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn op_is_held_pv_runs_straight_and_holes_stay() {
        let of = |signal, t: f64, v: f64| Sample { signal, t_ns: ns_from_s(t), value: Value::Number(v), quality: None };
        let times = [0.0, 1.1, 1.9, 3.0, 4.2, 20.0, 21.0];
        let rows = times.iter().flat_map(|t| [of(Signal::Op, *t, t.floor()), of(Signal::Pv, *t, 10.0 * t)]);
        let resampled = even(&LoadedLoop::new("A", rows.collect()), 1.0).unwrap();
        let values = |signal| {
            let own = resampled.samples.iter().filter(|s| s.signal == signal);
            own.map(|s| s.value.as_number()).collect::<Vec<_>>()
        };
        let pv = values(Signal::Pv);
        assert_eq!(pv.len(), 22);
        for (k, v) in pv.iter().enumerate() {
            let expected = if (5..20).contains(&k) { None } else { Some(10.0 * k as f64) };
            assert!(
                v.is_some() == expected.is_some() && (v.unwrap_or(0.0) - expected.unwrap_or(0.0)).abs() < 1e-9,
                "{k}: {v:?}"
            );
        }
        // Held, not moved ahead: at 2 s stands what was sent at 1.9 s.
        assert_eq!(values(Signal::Op)[..5], [Some(0.0), Some(0.0), Some(1.0), Some(3.0), Some(3.0)]);
        assert!(even(&LoadedLoop::new("A", Vec::new()), 1.0).is_err());
        assert!(even(&resampled, 1e-9).unwrap_err().contains("longer step"));
    }
}
