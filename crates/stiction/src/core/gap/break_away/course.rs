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
    /// Static band of the last slip, at each point: the stem rests by this times the ratio of the bands below that slip's OP.
    pub last_band: Vec<f64>,
    /// Negative log probability of the slips, nats.
    pub cost: f64,
}

impl Course {
    /// Points from a slip's on, up to the next one's.
    pub(super) fn rest(&self, which: usize) -> Range<usize> {
        let next = self.slips.get(which + 1).map_or(self.stem.len(), |slip| slip.point);
        self.slips[which].point..next
    }

    /// OP at the last slip, at each point, for the ratio of the bands that the stem has.
    pub(super) fn op_at_slip(&self, ratio: f64) -> Vec<f64> {
        self.stem.iter().zip(&self.last_band).map(|(stem, band)| stem + ratio * band).collect()
    }
}
