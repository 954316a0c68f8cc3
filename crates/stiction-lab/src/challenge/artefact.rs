//! Artefacts of sensor and historian on an existing PV: exact, so they can also be applied to real recordings.

use crate::truth::draw::Draw;
use crate::truth::storage;
use stiction::core::sim::noise::quantise;

/// An artefact on PV (and, for a skew, on PV relative to OP).
#[derive(Debug, Clone, PartialEq)]
pub enum Artefact {
    /// Rounded to multiples of this, PV units.
    Rounding(f64),
    /// Stored when it has changed by more than this, else held, PV units.
    Hold(f64),
    /// Stored such that straight lines pass all values within this, PV units.
    Door(f64),
    /// Clipped below and above, PV units.
    Clip([f64; 2]),
    /// Added at single samples: `(index, size)`, PV units.
    Spikes(Vec<(usize, f64)>),
    /// Frozen from `.0` for `.1` samples.
    Freeze(usize, usize),
    /// Recorded this many samples late (early if negative).
    Skew(i32),
}

impl Artefact {
    /// The recorded PV.
    pub fn apply(&self, pv: &mut [f64]) {
        match self {
            Self::Rounding(quantum) => pv.iter_mut().for_each(|y| *y = quantise(*y, *quantum)),
            Self::Hold(band) => storage::exception_hold(pv, *band),
            Self::Door(band) => storage::swinging_door(pv, *band),
            Self::Clip([low, high]) => pv.iter_mut().for_each(|y| *y = y.clamp(*low, *high)),
            Self::Spikes(spikes) => {
                for (at, size) in spikes {
                    if let Some(y) = pv.get_mut(*at) {
                        *y += size;
                    }
                }
            }
            Self::Freeze(from, samples) => {
                if let Some(held) = pv.get(*from).copied() {
                    pv.iter_mut().skip(*from).take(*samples).for_each(|y| *y = held);
                }
            }
            Self::Skew(samples) => shift(pv, *samples),
        }
    }
}

/// Moves values `samples` later; the ends are held.
fn shift(x: &mut [f64], samples: i32) {
    let raw = x.to_vec();
    let last = raw.len().saturating_sub(1) as i64;
    for (k, y) in x.iter_mut().enumerate() {
        let from = (k as i64 - i64::from(samples)).clamp(0, last);
        *y = raw.get(from as usize).copied().unwrap_or(*y);
    }
}

/// Isolated spikes in `n` samples: a share of `rate`, each 4 to 10 `scale` to either side, at least three.
pub(super) fn spikes(draw: &mut Draw, n: usize, rate: f64, scale: f64) -> Vec<(usize, f64)> {
    let count = ((rate * n as f64) as usize).max(3);
    let mut found: Vec<(usize, f64)> = Vec::new();
    for _ in 0..count {
        let at = (draw.between(0.02, 0.98) * n as f64) as usize;
        let size = draw.sign() * scale * draw.between(4.0, 10.0);
        if found.iter().all(|(other, _)| other.abs_diff(at) > 2) {
            found.push((at, size));
        }
    }
    found.sort_by_key(|(at, _)| *at);
    found
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn each_does_what_it_says() {
        let raw: Vec<f64> = (0..300).map(|k| libm::sin(f64::from(k) * 0.07)).collect();
        let with = |artefact: Artefact| {
            let mut pv = raw.clone();
            artefact.apply(&mut pv);
            pv
        };
        assert!(with(Artefact::Rounding(0.25)).iter().all(|y| (y * 4.0).fract() == 0.0));
        assert!(with(Artefact::Clip([-0.5, 0.8])).iter().all(|y| (-0.5..=0.8).contains(y)));
        let frozen = with(Artefact::Freeze(100, 50));
        assert!(frozen[100..150].iter().all(|y| *y == raw[100]) && frozen[150] == raw[150]);
        assert_eq!(with(Artefact::Skew(3))[10], raw[7]);
        assert_eq!(with(Artefact::Skew(-3))[10], raw[13]);
        let spiked = with(Artefact::Spikes(vec![(5, 3.0)]));
        assert_eq!((spiked[5], spiked[6]), (raw[5] + 3.0, raw[6]));
        assert!(with(Artefact::Hold(0.3)).windows(2).filter(|w| w[0] == w[1]).count() > 150);
        assert!(with(Artefact::Door(0.1)).iter().zip(&raw).all(|(a, b)| (a - b).abs() < 0.2));
    }
}
