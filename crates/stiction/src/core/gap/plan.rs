//! The simulator between OP and PV, block by block, in the normalised units of the search: OP in spans, PV in standard
//! deviations, times in points.
//!
//! OP → positioner lag → friction → rate limit → stops → play → characteristic → dead time → lag → second lag → zero,
//! and what disturbs PV. A [`Plan`] says which blocks are there; every block left at its neutral value is the base.

use crate::core::ident::class::Class;
use crate::core::ident::normalised::SlipEnd;
use crate::core::sim::actuator::Actuator;
use crate::core::sim::process::separated;
use crate::core::sim::slips::{Law, Stroke};

/// Stairs of a drifting gain: so few steps make a valve signal of it, and each is a small share of what any noise hides.
const STAIRS: usize = 500;

/// A gain that goes from one value to another over the record.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Drift {
    /// Gain at the end less that at the start, over that in the middle.
    pub change: f64,
    /// By the same factor in every stretch, not by the same amount.
    pub by_factor: bool,
}

impl Drift {
    /// At each of `n` points the gain over that in the middle, less 1, over the change: from about -1/2 to 1/2, held for a
    /// [`STAIRS`]th of the record.
    pub(crate) fn course(self, n: usize) -> impl Iterator<Item = f64> {
        let by_factor = self.by_factor && self.change.abs() > 1e-6;
        let exponent = 2.0 * libm::asinh(0.5 * self.change);
        let stair = n.div_ceil(STAIRS).max(1);
        (0..n).map(move |k| {
            let middle = (k / stair * stair) as f64 + 0.5 * (stair - 1) as f64;
            let late = middle / n as f64 - 0.5;
            if by_factor { libm::expm1(exponent * late) / self.change } else { late }
        })
    }
}

/// A part that is added to PV with linear coefficients of its own.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Part {
    /// Sine and cosine.
    Waves,
    /// A ramp.
    Ramp,
    /// A step.
    Step,
    /// A neighbour's signal.
    Neighbour,
}

/// Which blocks stand in the simulator.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Plan {
    /// Friction; `None` for a valve that follows OP.
    pub law: Option<Law>,
    /// The stem may jump beyond OP: fd < 0.
    pub overshoot: bool,
    /// Uneven bands, and stops that the stem itself meets, spans.
    pub stroke: Stroke,
    /// The parts before and behind the stem, points and spans.
    pub actuator: Actuator,
    /// Share by which gain and time constant grow with the valve signal, for each span.
    pub level: f64,
    /// The gain drifts over the record.
    pub drift: Option<Drift>,
    /// Second lag, points; 0 for none.
    pub tau2: f64,
    /// The second lag's share is free: a zero.
    pub zero: bool,
    /// The process integrates.
    pub integrating: bool,
    /// From a point on, so much is added to the lag.
    pub switch: Option<[f64; 2]>,
    /// A sinusoid of this frequency is added, radians a point.
    pub omega: Option<f64>,
    /// A ramp from this point on is added.
    pub ramp: Option<f64>,
    /// A step at this point is added, through the process' lag or (`true`) straight to PV.
    pub step: Option<(f64, bool)>,
    /// A neighbour's signal is added, behind this lag and delay, points.
    pub neighbour: Option<[f64; 2]>,
}

impl Plan {
    /// Both time constants beside a main one of this logarithm, points; the second 0 for none.
    #[must_use]
    pub(crate) fn time_constants(&self, log_tau: f64) -> [f64; 2] {
        let tau = libm::exp(log_tau);
        if self.tau2 > 0.0 { separated(tau, self.tau2).into() } else { [tau, 0.0] }
    }

    /// Where its slips end.
    #[must_use]
    pub(crate) const fn slip_end(&self) -> SlipEnd {
        if self.overshoot { SlipEnd::Beyond } else { SlipEnd::Short }
    }

    /// The base with a valve law, or without friction.
    #[must_use]
    pub(crate) const fn base(law: Option<Law>) -> Self {
        Self {
            law,
            overshoot: false,
            stroke: Stroke::FREE,
            actuator: Actuator::NONE,
            level: 0.0,
            drift: None,
            tau2: 0.0,
            zero: false,
            integrating: false,
            switch: None,
            omega: None,
            ramp: None,
            step: None,
            neighbour: None,
        }
    }

    /// What the search of the slips knows of it: all but a process that goes with its level or has a zero. Loads are free
    /// columns there.
    #[must_use]
    pub(crate) const fn searchable(&self) -> Self {
        let tau2 = if self.zero { 0.0 } else { self.tau2 };
        Self { level: 0.0, zero: false, tau2, omega: None, ramp: None, step: None, neighbour: None, ..*self }
    }

    /// Whether something stands behind the stem that changes its signal.
    #[must_use]
    pub(crate) fn shapes_signal(&self) -> bool {
        self.actuator.shapes_flow() || self.switch.is_some() || self.drift.is_some()
    }

    /// The class of process that the search of [`crate::core::ident`] knows it by.
    #[must_use]
    pub(crate) fn class(&self) -> Class {
        match (self.integrating, self.tau2 > 0.0 && !self.zero) {
            (true, _) => Class::Integrating,
            (false, true) => Class::Second,
            (false, false) => Class::First,
        }
    }

    /// Whether the valve signal is linear in fd, `at - fd * direction`.
    #[must_use]
    pub(crate) fn is_linear_in_fd(&self) -> bool {
        self.law.is_some() && !self.actuator.shapes_flow() && self.level == 0.0 && !self.zero
    }

    /// Where the linear coefficients of a part stand among those of the other columns, which the evaluator makes in this
    /// order: the constant, the memories (or an integrator's slope), then the parts.
    #[must_use]
    pub(crate) fn column(&self, part: Part) -> usize {
        let lags = if !self.integrating && self.tau2 > 0.0 { 2 } else { 1 };
        let waves = if self.omega.is_some() { 2 } else { 0 };
        let [ramp, drift, step] = [self.ramp.is_some(), self.drift.is_some(), self.step.is_some()].map(usize::from);
        let before = match part {
            Part::Waves => 0,
            Part::Ramp => waves,
            Part::Step => waves + ramp + drift,
            Part::Neighbour => waves + ramp + drift + step,
        };
        1 + lags + before
    }

    /// Linear coefficients beside gain, fd, constant and memory.
    #[must_use]
    pub(crate) fn extras(&self) -> usize {
        let two = if self.omega.is_some() { 2 } else { 0 };
        let loads = [self.ramp.is_some(), self.step.is_some(), self.neighbour.is_some()];
        let ones = [self.drift.is_some(), self.zero].into_iter().chain(loads);
        two + ones.filter(|x| *x).count()
    }
}
