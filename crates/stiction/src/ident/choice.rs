//! What a fit can be told.

use crate::optim::SolverName;

/// Order of the process model.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum ModelChoice {
    /// First order with dead time.
    Fopdt,
    /// Second order with dead time.
    Sopdt,
    /// Second order only where it earns its parameter.
    #[default]
    Auto,
}

impl ModelChoice {
    /// All of them, with the words of commands.
    pub const ALL: [(&'static str, Self); 3] = [("auto", Self::Auto), ("fopdt", Self::Fopdt), ("sopdt", Self::Sopdt)];
}

/// Dead time of the process model.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub enum DelayChoice {
    /// Estimated.
    #[default]
    Auto,
    /// Known, in seconds.
    Seconds(f64),
    /// Known, in raw samples.
    Samples(f64),
}

/// Valve law.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum ValveChoice {
    /// He's two-parameter law.
    He,
    /// The tracking (sliding) law.
    Tracking,
    /// Both; the better one is reported.
    #[default]
    Auto,
}

impl ValveChoice {
    /// All of them, with the words of commands.
    pub const ALL: [(&'static str, Self); 3] = [("auto", Self::Auto), ("he", Self::He), ("tracking", Self::Tracking)];
}

/// What a fit is told.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Options {
    /// Process order.
    pub model: ModelChoice,
    /// Dead time.
    pub delay: DelayChoice,
    /// Valve law.
    pub valve: ValveChoice,
    /// The global solver.
    pub solver: SolverName,
    /// Step of the contour grid, % of the span.
    pub fineness_pct: f64,
    /// Seed of every random choice.
    pub seed: u64,
    /// Period of the oscillation, points, where one is known.
    pub period_points: Option<f64>,
    /// Longest dead time that is looked for, s: longer ones nobody would believe of such a loop.
    pub longest_dead_time_s: f64,
    /// Whether such a loop may integrate.
    pub may_integrate: bool,
}

impl Default for Options {
    /// As the daemon asks, without a period.
    fn default() -> Self {
        Self {
            model: ModelChoice::default(),
            delay: DelayChoice::default(),
            valve: ValveChoice::default(),
            solver: SolverName::default(),
            fineness_pct: 5.0,
            seed: 1,
            period_points: None,
            longest_dead_time_s: f64::INFINITY,
            may_integrate: true,
        }
    }
}
