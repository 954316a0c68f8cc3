//! The valve models in slip coordinates, as used for identification.
//!
//! After a slip in direction `d` at OP value `at`, the stem is at `at - d fd`. It slips on when `d (op - at) > j` and back when
//! `-d (op - at) > s`, with `s = fs + fd`, `j = fs - fd`. So the sequence of slips depends only on (s, j), `fd` enters the stem
//! position linearly, and all (s, j) of a rectangle give the same sequence. Sample for sample identical to
//! [`super::valve::he_step`] and [`super::valve::tracking_step`].

/// Valve model.
#[derive(Debug, Clone, Copy, PartialEq, Eq, serde::Serialize, serde::Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(rename_all = "snake_case")]
pub enum Law {
    /// He's staircase.
    He,
    /// Sliding after the first slip, until OP reverses.
    Tracking,
}

impl Law {
    /// Its name in documents and model files.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::He => "he",
            Self::Tracking => "tracking",
        }
    }

    /// Its name in sentences.
    #[must_use]
    pub const fn words(self) -> &'static str {
        match self {
            Self::He => "He's law",
            Self::Tracking => "tracking law",
        }
    }
}

/// The first slip of a record, in place of the unknown stem position before it: towards `direction`, as soon as
/// `direction * (op - threshold) > 0`.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct FirstSlip {
    /// +1 up, -1 down.
    pub direction: f64,
    /// OP value that must be passed.
    pub threshold: f64,
}

/// Additional properties of a valve.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Stroke {
    /// Bands are wider by the factor `1 + uneven` upwards and `1 - uneven` downwards, `-1 < uneven < 1`.
    pub uneven: f64,
    /// Where the stem meets its stops: least and greatest OP value that counts as that of a slip. The stem stands at a
    /// stop fd below the greatest, or above the least one.
    pub ends: [f64; 2],
    /// Share of OP's lead beyond the threshold by which a slip goes further: a heavy stem swings as far past its new
    /// resting place as it was pulled away from it, less what friction takes.
    pub carried: f64,
    /// Fastest motion of the stem, OP units a point.
    pub rate: f64,
    /// Time constant with which a sliding stem follows OP, points.
    pub drag: f64,
    /// Speed below which a sliding stem sticks again, OP units a point.
    pub slowest: f64,
}

impl Stroke {
    /// Even bands, no stop, no mass, no delay in motion.
    pub const FREE: Self = Self {
        uneven: 0.0,
        ends: [f64::NEG_INFINITY, f64::INFINITY],
        carried: 0.0,
        rate: f64::INFINITY,
        drag: 0.0,
        slowest: 0.0,
    };
}

impl Stroke {
    /// Whether there are no additional properties.
    #[must_use]
    pub(crate) fn is_plain(&self) -> bool {
        *self == Self::FREE
    }
}

impl Default for Stroke {
    fn default() -> Self {
        Self::FREE
    }
}

/// The stem's memory between OP values, and what is learned of the cell on the way.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Stem {
    at: f64,
    direction: f64,
    ends: [f64; 2],
    carried: f64,
    /// Fastest motion between two OP values.
    rate: f64,
    /// Drag in OP values, the share of a way that it leaves after one, and the force that it lacks when the stem stops.
    drag: f64,
    left: f64,
    rest: f64,
    /// By how much the stem's mean place since the last OP value is behind `at`.
    behind: f64,
    /// What unevenness adds to the way back, and by how much it divides the way on, in the direction of the last slip.
    back: f64,
    on: f64,
    slipped: bool,
    moving: bool,
    s_cell: [f64; 2],
    j_cell: [f64; 2],
    slips: usize,
    reversals: usize,
}

/// Bands that differ with the direction: `fs (1 + uneven)`, `fd (1 + uneven)` upwards, `1 - uneven` downwards. In slip
/// coordinates the way back is `s - d uneven j`, the way on `j (1 + d uneven)`; the stem shifts by a constant.
#[derive(Debug, Clone, Copy)]
struct Uneven {
    uneven: f64,
    j: f64,
}

impl Uneven {
    fn of(self, direction: f64) -> (f64, f64) {
        let d = direction * self.uneven;
        (d * self.j, 1.0 / (1.0 + d))
    }
}

impl Stem {
    /// Before the first slip: as if the last one had gone the other way, s away.
    fn new(first: FirstSlip, s: f64, uneven: Uneven, stroke: Stroke, per_point: usize) -> Self {
        let (back, on) = uneven.of(-first.direction);
        let drag = stroke.drag * per_point as f64;
        let left = if drag > 0.0 { libm::exp(-1.0 / drag) } else { 0.0 };
        Self {
            at: first.threshold - first.direction * (s - back),
            direction: -first.direction,
            ends: stroke.ends,
            carried: stroke.carried,
            rate: stroke.rate / per_point as f64,
            drag,
            left,
            rest: stroke.drag * stroke.slowest,
            behind: 0.0,
            back,
            on,
            slipped: false,
            moving: false,
            s_cell: [0.0, f64::INFINITY],
            j_cell: [0.0, f64::INFINITY],
            slips: 0,
            reversals: 0,
        }
    }

    /// A stem that rests at `position` with bands `[fs, fd]`, to be taken on value by value, a point each.
    #[must_use]
    pub(crate) fn resting(position: f64, [fs, fd]: [f64; 2], stroke: Stroke) -> Self {
        let uneven = Uneven { uneven: stroke.uneven, j: fs - fd };
        let mut stem = Self::new(FirstSlip { direction: 1.0, threshold: position }, fs + fd, uneven, stroke, 1);
        stem.direction = 1.0;
        (stem.back, stem.on) = uneven.of(1.0);
        stem.at = position + fd * (1.0 + stroke.uneven);
        stem
    }

    /// Before the first slip, with bands `[s, j]` and `per_point` OP values a point.
    #[must_use]
    pub(crate) fn before(first: FirstSlip, [s, j]: [f64; 2], stroke: Stroke, per_point: usize) -> Self {
        Self::new(first, s, Uneven { uneven: stroke.uneven, j }, stroke, per_point)
    }

    /// Takes the next OP value with bands `[s, j]`.
    #[inline]
    pub(crate) fn meet(&mut self, law: Law, op: f64, [s, j]: [f64; 2], stroke: Stroke) {
        self.take(law, op, s, j, Uneven { uneven: stroke.uneven, j });
    }

    /// Level and direction of the stem, `level - fd (direction + uneven)`, averaged since the OP value before.
    #[inline]
    #[must_use]
    pub(crate) fn signal(&self) -> (f64, f64) {
        (self.at - self.behind, self.direction)
    }

    /// Moves so far.
    #[inline]
    #[must_use]
    pub(crate) const fn slips(&self) -> usize {
        self.slips
    }

    /// Moves so far against the move before.
    #[must_use]
    pub(crate) const fn reversals(&self) -> usize {
        self.reversals
    }

    /// Whether the next OP value may move it without a slip.
    #[inline]
    #[must_use]
    pub(crate) const fn is_moving(&self) -> bool {
        self.moving
    }

    /// Values of s, then of j, that give the same moves so far.
    #[must_use]
    pub(crate) const fn cells(&self) -> [[f64; 2]; 2] {
        [self.s_cell, self.j_cell]
    }

    /// Takes the next OP value with bands `[fs, fd]` and answers the mean position until the next one.
    pub(crate) fn follow(&mut self, law: Law, op: f64, [fs, fd]: [f64; 2], uneven: f64) -> f64 {
        self.take(law, op, fs + fd, fs - fd, Uneven { uneven, j: fs - fd });
        self.at - self.behind - fd * (self.direction + uneven)
    }

    /// Takes the next OP value.
    #[inline]
    fn take(&mut self, law: Law, op: f64, s: f64, j: f64, uneven: Uneven) {
        let ahead = self.direction * (op - self.at);
        self.behind = 0.0;
        if ahead >= 0.0 {
            let on = ahead * self.on;
            if self.moving {
                self.advance(law, op);
            } else if on > j && !self.is_at_stop() {
                self.slip(law, op, self.direction, ahead - j / self.on, 0.0);
                self.j_cell[1] = self.j_cell[1].min(on);
            } else if self.slipped && on <= j {
                self.j_cell[0] = self.j_cell[0].max(on);
            }
            return;
        }
        self.moving = false;
        let back = self.back - ahead;
        if back > s {
            if self.slipped {
                self.s_cell[1] = self.s_cell[1].min(back);
                self.reversals += 1;
            }
            self.slip(law, op, -self.direction, back - s, s - j);
            (self.back, self.on) = uneven.of(self.direction);
        } else if self.slipped {
            self.s_cell[0] = self.s_cell[0].max(back);
        }
    }

    /// Takes a run of OP values by its least and greatest, if the stem rests through all of it, with the same result as
    /// [`Stem::take`] value by value. Returns false and changes nothing if the stem may move.
    #[inline]
    pub(crate) fn rests_between(&mut self, [low, high]: [f64; 2], [s, j]: [f64; 2]) -> bool {
        if self.moving {
            return false;
        }
        let (far, near) = if self.direction > 0.0 { (high, low) } else { (low, high) };
        let (most, least) = (self.direction * (far - self.at), self.direction * (near - self.at));
        let (on, back) = (most * self.on, self.back - least);
        if on > j || least < 0.0 && back > s {
            return false;
        }
        self.behind = 0.0;
        if self.slipped && most >= 0.0 {
            self.j_cell[0] = self.j_cell[0].max(on);
        }
        if self.slipped && least < 0.0 {
            self.s_cell[0] = self.s_cell[0].max(back);
        }
        true
    }

    /// Whether a stop is in the way of going on.
    #[inline]
    fn is_at_stop(&self) -> bool {
        self.at == self.ends[usize::from(self.direction > 0.0)]
    }

    /// Breaks away; a reversal moves the place that counts by `turn`, twice the kinetic band.
    #[inline]
    fn slip(&mut self, law: Law, op: f64, direction: f64, lead: f64, turn: f64) {
        self.direction = direction;
        self.slipped = true;
        self.moving = true;
        self.slips += 1;
        self.at += direction * turn;
        self.advance(law, op + direction * self.carried * lead);
    }

    /// Motion towards OP for as long as one value of it lasts.
    #[inline]
    fn advance(&mut self, law: Law, op: f64) {
        self.moving = law == Law::Tracking;
        if self.rate < f64::INFINITY {
            let way = self.direction * (op - self.at);
            let step = way.min(self.rate);
            self.moving |= step < way;
            self.at += self.direction * step;
            self.behind = 0.5 * self.direction * step * step / self.rate;
        } else if self.left > 0.0 && self.moving {
            self.slide(op);
        } else {
            self.at = op;
        }
        self.at = self.at.clamp(self.ends[0], self.ends[1]);
    }

    /// Motion against drag: towards a place beyond OP by what the stem still has to overcome when it is slowest, until
    /// it is at OP.
    fn slide(&mut self, op: f64) {
        let way = self.direction * (op - self.at);
        let start = way + self.rest;
        let end = start * self.left - self.rest;
        if end <= 0.0 && self.rest > 0.0 {
            self.moving = false;
            self.at = op;
            self.behind = self.direction * self.drag * (way - self.rest * libm::log(start / self.rest));
        } else {
            self.at = op - self.direction * end;
            self.behind = self.direction * (self.drag * start * (1.0 - self.left) - self.rest - end);
        }
    }
}

#[cfg(test)]
pub(crate) mod by_sample;
#[cfg(test)]
mod tests;
