//! Options of a fit.

/// Order of the process model.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum ModelChoice {
    /// First order with dead time.
    Fopdt,
    /// Second order with dead time.
    Sopdt,
    /// Second order only if it fits significantly better.
    #[default]
    Auto,
}

impl ModelChoice {
    /// All choices, with their names in commands.
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

/// Valve model.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum ValveChoice {
    /// He's two-parameter model.
    He,
    /// The tracking (sliding) model.
    Tracking,
    /// Both; the better one is reported.
    #[default]
    Auto,
}

impl ValveChoice {
    /// All choices, with their names in commands.
    pub const ALL: [(&'static str, Self); 3] = [("auto", Self::Auto), ("he", Self::He), ("tracking", Self::Tracking)];
}

/// Options of a fit.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Options {
    /// Process order.
    pub model: ModelChoice,
    /// Dead time.
    pub delay: DelayChoice,
    /// Valve model.
    pub valve: ValveChoice,
    /// Step of the contour grid, % of the span.
    pub fineness_pct: f64,
    /// Seed of all random choices.
    pub seed: u64,
    /// Period of the oscillation in points, if known.
    pub period_points: Option<f64>,
    /// Longest dead time searched, s: longer ones are implausible for such a loop.
    pub longest_dead_time_s: f64,
    /// Whether such a loop may be integrating.
    pub may_integrate: bool,
}

impl Default for Options {
    /// The daemon's options, without a period.
    fn default() -> Self {
        Self {
            model: ModelChoice::default(),
            delay: DelayChoice::default(),
            valve: ValveChoice::default(),
            fineness_pct: 5.0,
            seed: 1,
            period_points: None,
            longest_dead_time_s: f64::INFINITY,
            may_integrate: true,
        }
    }
}
