//! Faults of the challenge's loops: the effects of the catalogue, and some outside it.

/// Location of an effect, in the words of the gap document.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub enum Stage {
    /// Actuator, positioner, stem.
    Valve,
    /// Between stem and PV.
    Process,
    /// An external disturbance.
    Disturbance,
    /// Sensor and historian.
    Measurement,
}

impl Stage {
    /// Its word in documents.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::Valve => "valve",
            Self::Process => "process",
            Self::Disturbance => "disturbance",
            Self::Measurement => "measurement",
        }
    }
}

/// One effect.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub enum Kind {
    /// Bands depend on the direction.
    AsymmetricStiction,
    /// The stem comes to rest beyond OP.
    SlipOvershoot,
    /// The stem slides once it moves.
    SlidingValve,
    /// Backlash behind the stem.
    Backlash,
    /// The stem meets a stop.
    TravelLimit,
    /// The stem moves slowly.
    RateLimit,
    /// A lag before the stem.
    PositionerLag,
    /// A lag behind the stem, of the process or the sensor.
    ExtraLag,
    /// A nonlinear valve, or a gain that depends on the level.
    StaticNonlinearity,
    /// PV first moves in the wrong direction.
    InverseResponse,
    /// PV is integrating.
    Integrating,
    /// The gain changes over the record.
    GainDrift,
    /// The dead time changes within the record.
    DeadTimeChange,
    /// An external sine.
    Sinusoid,
    /// An external ramp.
    Ramp,
    /// An external step.
    StepLoad,
    /// Coloured noise.
    ColouredNoise,
    /// PV with coarse resolution.
    Quantisation,
    /// PV recorded on change.
    HoldCompression,
    /// PV compressed to straight lines.
    SwingingDoor,
    /// PV clipped at the end of its range.
    Clipping,
    /// Single outliers of PV.
    Outliers,
    /// PV frozen for a while.
    FrozenSensor,
    /// PV recorded some samples later or earlier than OP.
    TimeSkew,
    /// PV and its noise filtered in the transmitter or the PV block.
    SensorFilter,
    /// A second loop that interacts with this one.
    InteractingLoop,
    /// Stiction grows or falls over the record.
    ChangingStiction,
    /// The controller is retuned half way, with a filter on PV.
    RetunedFilter,
    /// The limit cycle of a valve upstream.
    UpstreamCycle,
    /// The time constant falls as the flow rises, as in a heat exchanger.
    FlowDependentLag,
    /// Sampling times jitter, but the timestamps do not show it.
    ClockJitter,
    /// The breakaway force varies from one rest to the next.
    RandomFriction,
    /// PV falls more slowly than it rises.
    SluggishFall,
    /// Several external steps and short pulses.
    Upsets,
}

impl Kind {
    /// Effects of the catalogue, from which pairs are drawn.
    pub const CATALOGUE: [Self; 24] = [
        Self::AsymmetricStiction,
        Self::SlipOvershoot,
        Self::SlidingValve,
        Self::Backlash,
        Self::TravelLimit,
        Self::RateLimit,
        Self::PositionerLag,
        Self::ExtraLag,
        Self::StaticNonlinearity,
        Self::InverseResponse,
        Self::Integrating,
        Self::GainDrift,
        Self::DeadTimeChange,
        Self::Sinusoid,
        Self::Ramp,
        Self::StepLoad,
        Self::ColouredNoise,
        Self::Quantisation,
        Self::HoldCompression,
        Self::SwingingDoor,
        Self::Clipping,
        Self::Outliers,
        Self::FrozenSensor,
        Self::TimeSkew,
    ];

    /// One more effect of the catalogue, with its own random stream, so that the other cases of a seed do not change.
    pub const FILTER: Self = Self::SensorFilter;

    /// Effects outside the catalogue.
    pub const FOREIGN: [Self; 8] = [
        Self::InteractingLoop,
        Self::ChangingStiction,
        Self::RetunedFilter,
        Self::UpstreamCycle,
        Self::FlowDependentLag,
        Self::ClockJitter,
        Self::SluggishFall,
        Self::RandomFriction,
    ];

    /// The effect that the budget alone names, outside every usual deck.
    pub const OF_BUDGET: Self = Self::Upsets;

    /// Its id, as in the catalogue if it is there.
    #[must_use]
    pub const fn id(self) -> &'static str {
        match self {
            Self::AsymmetricStiction => "asymmetric_stiction",
            Self::SlipOvershoot => "slip_overshoot",
            Self::SlidingValve => "sliding_valve",
            Self::Backlash => "backlash",
            Self::TravelLimit => "travel_limit",
            Self::RateLimit => "rate_limit",
            Self::PositionerLag => "positioner_lag",
            Self::ExtraLag => "extra_lag",
            Self::StaticNonlinearity => "static_nonlinearity",
            Self::InverseResponse => "inverse_response",
            Self::Integrating => "integrating",
            Self::GainDrift => "gain_drift",
            Self::DeadTimeChange => "dead_time_change",
            Self::Sinusoid => "sinusoid",
            Self::Ramp => "ramp",
            Self::StepLoad => "step_load",
            Self::ColouredNoise => "coloured_noise",
            Self::Quantisation => "quantisation",
            Self::HoldCompression => "hold_compression",
            Self::SwingingDoor => "swinging_door",
            Self::Clipping => "clipping",
            Self::Outliers => "outliers",
            Self::FrozenSensor => "frozen_sensor",
            Self::TimeSkew => "time_skew",
            Self::SensorFilter => "sensor_filter",
            Self::InteractingLoop => "interacting_loop",
            Self::ChangingStiction => "changing_stiction",
            Self::RetunedFilter => "retuned_filter",
            Self::UpstreamCycle => "upstream_cycle",
            Self::FlowDependentLag => "flow_dependent_lag",
            Self::ClockJitter => "clock_jitter",
            Self::RandomFriction => "random_friction",
            Self::SluggishFall => "sluggish_fall",
            Self::Upsets => "upsets",
        }
    }

    /// Its location.
    #[must_use]
    pub const fn stage(self) -> Stage {
        match self {
            Self::AsymmetricStiction
            | Self::SlipOvershoot
            | Self::SlidingValve
            | Self::Backlash
            | Self::TravelLimit
            | Self::RateLimit
            | Self::PositionerLag
            | Self::ChangingStiction
            | Self::RandomFriction => Stage::Valve,
            Self::ExtraLag
            | Self::StaticNonlinearity
            | Self::InverseResponse
            | Self::Integrating
            | Self::GainDrift
            | Self::DeadTimeChange
            | Self::FlowDependentLag
            | Self::SluggishFall => Stage::Process,
            Self::Sinusoid
            | Self::Ramp
            | Self::StepLoad
            | Self::ColouredNoise
            | Self::InteractingLoop
            | Self::UpstreamCycle
            | Self::Upsets => Stage::Disturbance,
            Self::Quantisation
            | Self::HoldCompression
            | Self::SwingingDoor
            | Self::Clipping
            | Self::Outliers
            | Self::FrozenSensor
            | Self::TimeSkew
            | Self::SensorFilter
            | Self::RetunedFilter
            | Self::ClockJitter => Stage::Measurement,
        }
    }

    /// Whether it is in the catalogue.
    #[must_use]
    pub fn is_in_catalogue(self) -> bool {
        self == Self::FILTER || Self::CATALOGUE.contains(&self)
    }

    /// Whether a free run cannot predict it even if it is known: its residual counts as noise floor.
    #[must_use]
    pub const fn is_unpredictable(self) -> bool {
        matches!(self, Self::ColouredNoise | Self::Quantisation | Self::Outliers | Self::RandomFriction)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::collections::BTreeSet;

    #[test]
    fn ids_are_distinct_and_the_two_lists_share_none() {
        let all: Vec<Kind> = Kind::CATALOGUE.into_iter().chain(Kind::FOREIGN).chain([Kind::OF_BUDGET]).collect();
        let ids: BTreeSet<&str> = all.iter().map(|k| k.id()).collect();
        assert_eq!(ids.len(), all.len());
        assert!(Kind::FOREIGN.iter().all(|k| !k.is_in_catalogue()));
    }
}
