//! What a fit can be told.

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
