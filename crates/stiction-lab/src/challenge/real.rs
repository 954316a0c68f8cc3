//! Known truth in real recordings: exact artefacts, and effects added to an existing PV.

use super::artefact::{Artefact, spikes};
use crate::truth::draw::Draw;
use stiction::core::record::Record;
use stiction::core::signal::stats::{noise_sd, quantile, std_dev};
use stiction::core::sim::disturbance::Disturbance;

/// A recording with an effect added to its PV.
#[derive(Debug, Clone, PartialEq)]
pub struct Spoilt {
    /// Id of the added effect.
    pub effect: &'static str,
    /// The modified recording.
    pub record: Record,
}

/// The recording with each effect that can be added, sized by PV's own spread. The controller's reaction is not simulated,
/// because the plant did not experience these effects.
#[must_use]
pub fn spoilt(record: &Record, seed: u64) -> Vec<Spoilt> {
    let (n, sd) = (record.len(), std_dev(&record.pv));
    let draw = |purpose: &str| Draw::new(seed, &format!("challenge/real/{purpose}"));
    let mut out = artefacts(&record.pv, n, sd, &mut draw("artefacts"));
    let mut add = |effect: &'static str, more: Vec<f64>| {
        let pv = record.pv.iter().zip(more).map(|(y, x)| y + x).collect();
        out.push((effect, pv));
    };
    let part = n as f64;
    let mut shapes = draw("shapes");
    let sign = shapes.sign();
    let ramp = Disturbance::Ramp { size: 3.0 * sd * sign, from_s: 0.0, over_s: part };
    add("ramp", shapes.series(ramp, n));
    let step = Disturbance::Step { size: -2.0 * sd * sign, at_s: (part * shapes.between(0.35, 0.65)).round() };
    add("step_load", shapes.series(step, n));
    let wave = part / shapes.between(3.2, 5.7);
    add("sinusoid", shapes.sine(wave, n).into_iter().map(|x| 0.9 * sd * x).collect());
    out.push(("extra_lag", lagged(&record.pv, (part / 60.0).clamp(3.0, 20.0))));
    out.into_iter().map(|(effect, pv)| Spoilt { effect, record: with_pv(record, pv) }).collect()
}

fn artefacts(pv: &[f64], n: usize, sd: f64, draw: &mut Draw) -> Vec<(&'static str, Vec<f64>)> {
    let from = (draw.between(0.2, 0.6) * n as f64) as usize;
    let all = [
        ("quantisation", Artefact::Rounding(0.7 * sd)),
        ("hold_compression", Artefact::Hold(0.4 * sd)),
        ("swinging_door", Artefact::Door(0.4 * sd)),
        ("clipping", Artefact::Clip([f64::MIN, quantile(pv, 0.75)])),
        ("outliers", Artefact::Spikes(spikes(draw, n, 0.01, sd))),
        ("frozen_sensor", Artefact::Freeze(from, n / 12)),
        ("time_skew", Artefact::Skew(5)),
    ];
    let with = |artefact: &Artefact| {
        let mut spoilt = pv.to_vec();
        artefact.apply(&mut spoilt);
        spoilt
    };
    all.iter().map(|(effect, artefact)| (*effect, with(artefact))).collect()
}

/// PV after a first-order lag of `tau` samples. The lag also reduces its noise, so white noise is added to restore it.
fn lagged(pv: &[f64], tau: f64) -> Vec<f64> {
    let share = 1.0 - libm::exp(-1.0 / tau);
    let mut noise = Draw::new(1, "challenge/real/lag");
    let sd = noise_sd(pv);
    let mut now = pv.first().copied().unwrap_or(0.0);
    pv.iter()
        .map(|y| {
            now += share * (y - now);
            now + sd * noise.gaussian()
        })
        .collect()
}

fn with_pv(record: &Record, pv: Vec<f64>) -> Record {
    let mut out = Record { pv, ..record.clone() };
    out.facts.pv_repeats = out.pv.windows(2).filter(|w| w[0] == w[1]).count() as u32;
    out
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_effect_is_put_in_and_op_is_left_alone() {
        let wave = |k: i32| libm::sin(f64::from(k) * 0.09);
        let record = Record::uniform(1.0, (0..600).map(|k| 50.0 + wave(k)).collect(), (0..600).map(wave).collect());
        let all = spoilt(&record, 1);
        assert_eq!(all.len(), 11);
        for one in &all {
            assert_eq!(one.record.op_path, record.op_path, "{}", one.effect);
            let apart: f64 = one.record.pv.iter().zip(&record.pv).map(|(a, b)| (a - b).abs()).sum();
            assert!(apart > 1.0, "{}: {apart}", one.effect);
        }
        assert_eq!(all, spoilt(&record, 1));
    }
}
