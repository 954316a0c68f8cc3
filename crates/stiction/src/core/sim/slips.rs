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
    /// The law's name in documents and model files.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::He => "he",
            Self::Tracking => "tracking",
        }
    }

    /// The law's name in sentences.
    #[must_use]
    pub const fn words(self) -> &'static str {
        match self {
            Self::He => "He's law",
            Self::Tracking => "tracking law",
        }
    }
}

/// The first slip of a record, in place of the unknown initial stem position: towards `direction`, as soon as
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
    /// The bands are wider by the factor `1 + uneven` upwards and `1 - uneven` downwards, `-1 < uneven < 1`.
    pub uneven: f64,
    /// Positions of the stops: least and greatest OP value that counts as that of a slip. At a stop the stem is fd below the
    /// greatest, or above the least one.
    pub ends: [f64; 2],
    /// Overshoot of a slip, as a share of OP's lead beyond the threshold: a heavy stem swings as far past its new resting
    /// position as it was away from it, minus the loss to friction.
    pub carried: f64,
    /// Fastest motion of the stem, OP units per point.
    pub rate: f64,
    /// Time constant with which a sliding stem follows OP, points.
    pub drag: f64,
    /// Speed below which a sliding stem sticks again, OP units per point.
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
    /// Whether the valve has no additional properties.
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

/// State of the stem between OP values, and the bounds of its cell found so far.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Stem {
    at: f64,
    direction: f64,
    ends: [f64; 2],
    carried: f64,
    /// Fastest motion between two OP values.
    rate: f64,
    /// Drag in OP values, its decay factor per value, and how far beyond OP the stem aims, so that it stops at its slowest
    /// speed.
    drag: f64,
    left: f64,
    rest: f64,
    /// Distance by which the stem's mean position since the last OP value lags behind `at`.
    behind: f64,
    /// Addition to the travel back, and factor of the travel forward, after a slip in the last direction, from unevenness.
    back: f64,
    on: f64,
    slipped: bool,
    moving: bool,
    s_cell: [f64; 2],
    j_cell: [f64; 2],
    slips: usize,
    reversals: usize,
}

/// Bands that depend on the direction: `fs (1 + uneven)`, `fd (1 + uneven)` upwards, `1 - uneven` downwards. In slip
/// coordinates the threshold back is `s - d uneven j`, the threshold forward `j (1 + d uneven)`; the stem shifts by a constant.
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
    /// Before the first slip: as if the last slip had gone the other way, s away.
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

    /// A stem at rest at `position` with bands `[fs, fd]`, driven value by value, one value per point.
    #[must_use]
    pub(crate) fn resting(position: f64, [fs, fd]: [f64; 2], stroke: Stroke) -> Self {
        let uneven = Uneven { uneven: stroke.uneven, j: fs - fd };
        let mut stem = Self::new(FirstSlip { direction: 1.0, threshold: position }, fs + fd, uneven, stroke, 1);
        stem.direction = 1.0;
        (stem.back, stem.on) = uneven.of(1.0);
        stem.at = position + fd * (1.0 + stroke.uneven);
        stem
    }

    /// A stem before its first slip, with bands `[s, j]` and `per_point` OP values per point.
    #[must_use]
    pub(crate) fn before(first: FirstSlip, [s, j]: [f64; 2], stroke: Stroke, per_point: usize) -> Self {
        Self::new(first, s, Uneven { uneven: stroke.uneven, j }, stroke, per_point)
    }

    /// Processes the next OP value with bands `[s, j]`.
    #[inline]
    pub(crate) fn meet(&mut self, law: Law, op: f64, [s, j]: [f64; 2], stroke: Stroke) {
        self.take(law, op, s, j, Uneven { uneven: stroke.uneven, j });
    }

    /// Level and direction of the stem, `level - fd (direction + uneven)`, averaged since the previous OP value.
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

    /// Moves so far that reversed the direction.
    #[must_use]
    pub(crate) const fn reversals(&self) -> usize {
        self.reversals
    }

    /// Whether the next OP value may move the stem without a slip.
    #[inline]
    #[must_use]
    pub(crate) const fn is_moving(&self) -> bool {
        self.moving
    }

    /// Ranges of s, then of j, that give the same moves so far.
    #[must_use]
    pub(crate) const fn cells(&self) -> [[f64; 2]; 2] {
        [self.s_cell, self.j_cell]
    }

    /// Processes the next OP value with bands `[fs, fd]` and returns the mean position until the following one.
    pub(crate) fn follow(&mut self, law: Law, op: f64, [fs, fd]: [f64; 2], uneven: f64) -> f64 {
        self.take(law, op, fs + fd, fs - fd, Uneven { uneven, j: fs - fd });
        self.at - self.behind - fd * (self.direction + uneven)
    }

    /// Processes the next OP value.
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

    /// Processes a run of OP values by its minimum and maximum, if the stem rests throughout, with the same result as
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

    /// Whether a stop prevents further motion.
    #[inline]
    fn is_at_stop(&self) -> bool {
        self.at == self.ends[usize::from(self.direction > 0.0)]
    }

    /// Breaks away; a reversal shifts `at` by `turn`, twice the kinetic band.
    #[inline]
    fn slip(&mut self, law: Law, op: f64, direction: f64, lead: f64, turn: f64) {
        self.direction = direction;
        self.slipped = true;
        self.moving = true;
        self.slips += 1;
        self.at += direction * turn;
        self.advance(law, op + direction * self.carried * lead);
    }

    /// Motion towards OP during one OP value.
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

    /// Motion against drag: the stem approaches a point `rest` beyond OP exponentially, and stops when it reaches OP.
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
