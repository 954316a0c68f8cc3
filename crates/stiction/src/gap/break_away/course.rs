//! What a stem did: its slips, and where it rested between them.

use core::ops::Range;

/// A slip: the point, between which forces the stem broke away, and the band that is taken there.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Slip {
    pub point: usize,
    /// Force up to which the stem held, and force at which it did not, OP units.
    pub between: [f64; 2],
    /// Static band, OP units: positive for a slip upwards.
    pub band: f64,
}

/// The likeliest course of a stem.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Course {
    /// Its slips, in time.
    pub slips: Vec<Slip>,
    /// The stem at each point, OP units.
    pub stem: Vec<f64>,
    /// Static band of the last slip at each point, by which times the ratio of the bands the stem came to rest below OP.
    pub below: Vec<f64>,
    /// What it costs to say the slips, nats.
    pub cost: f64,
}

impl Course {
    /// Points from a slip's on, up to the next one's.
    pub(super) fn rest(&self, which: usize) -> Range<usize> {
        let next = self.slips.get(which + 1).map_or(self.stem.len(), |slip| slip.point);
        self.slips[which].point..next
    }

    /// OP at each point's last slip, by the ratio of the bands that the stem has.
    pub(super) fn held(&self, ratio: f64) -> Vec<f64> {
        self.stem.iter().zip(&self.below).map(|(stem, below)| stem + ratio * below).collect()
    }
}
