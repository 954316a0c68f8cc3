//! What may be wrong with a loop of the challenge: the effects that the catalogue promises, and some that none has.

/// Where an effect sits, in the words of the gap's document.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub enum Stage {
    /// Actuator, positioner, stem.
    Valve,
    /// Between stem and PV.
    Process,
    /// What enters from outside.
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
    /// Bands differ by direction.
    AsymmetricStiction,
    /// The stem comes to rest beyond OP.
    SlipOvershoot,
    /// The stem slides once it moves.
    SlidingValve,
    /// Play behind the stem.
    Backlash,
    /// The stem meets a stop.
    TravelLimit,
    /// The stem moves slowly.
    RateLimit,
    /// A lag in front of the stem.
    PositionerLag,
    /// A lag behind the stem, of the process or the sensor.
    ExtraLag,
    /// A curved valve, or a gain that hangs on the level.
    StaticNonlinearity,
    /// PV goes the wrong way first.
    InverseResponse,
    /// PV does not settle by itself.
    Integrating,
    /// The gain changes over the record.
    GainDrift,
    /// The dead time changes within the record.
    DeadTimeChange,
    /// A sine from outside.
    Sinusoid,
    /// A ramp from outside.
    Ramp,
    /// A step from outside.
    StepLoad,
    /// Noise with a memory.
    ColouredNoise,
    /// PV in coarse steps.
    Quantisation,
    /// PV recorded when it has changed enough.
    HoldCompression,
    /// PV thinned to straight lines.
    SwingingDoor,
    /// PV cut off at the end of its range.
    Clipping,
    /// Single false values of PV.
    Outliers,
    /// PV stands still for a while.
    FrozenSensor,
    /// PV recorded some samples apart from OP.
    TimeSkew,
    /// PV and its noise filtered in the transmitter or the PV block.
    SensorFilter,
    /// A second loop acts on this one and feels it.
    InteractingLoop,
    /// Stiction grows or falls over the record.
    ChangingStiction,
    /// The controller is retuned half way and PV filtered from then on.
    RetunedFilter,
    /// The limit cycle of a valve upstream.
    UpstreamCycle,
    /// The time constant falls as the flow rises, as in a heat exchanger.
    FlowDependentLag,
    /// Samples are taken late by chance, the stamps do not say so.
    ClockJitter,
    /// The packing lets go at a force that changes from one rest to the next.
    RandomPacking,
    /// PV falls more slowly than it rises.
    SluggishFall,
}

impl Kind {
    /// Effects that the catalogue promises and that two at once are drawn from.
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

    /// One more that the catalogue promises. It has a stream of its own, so that the other cases of a seed stay as they are.
    pub const FILTER: Self = Self::SensorFilter;

    /// Effects that no catalogue has.
    pub const FOREIGN: [Self; 8] = [
        Self::InteractingLoop,
        Self::ChangingStiction,
        Self::RetunedFilter,
        Self::UpstreamCycle,
        Self::FlowDependentLag,
        Self::ClockJitter,
        Self::RandomPacking,
        Self::SluggishFall,
    ];

    /// Its id, the catalogue's where that has it.
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
            Self::RandomPacking => "random_packing",
            Self::SluggishFall => "sluggish_fall",
        }
    }

    /// Where it sits.
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
            | Self::RandomPacking => Stage::Valve,
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
            | Self::UpstreamCycle => Stage::Disturbance,
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

    /// Whether the catalogue has it.
    #[must_use]
    pub fn is_in_catalogue(self) -> bool {
        self == Self::FILTER || Self::CATALOGUE.contains(&self)
    }

    /// Whether a free run cannot predict it even when it is known: what it leaves counts as floor.
    #[must_use]
    pub const fn is_unpredictable(self) -> bool {
        matches!(self, Self::ColouredNoise | Self::Quantisation | Self::Outliers)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::collections::BTreeSet;

    #[test]
    fn ids_are_distinct_and_the_two_lists_share_none() {
        let all: Vec<Kind> = Kind::CATALOGUE.into_iter().chain(Kind::FOREIGN).collect();
        let ids: BTreeSet<&str> = all.iter().map(|k| k.id()).collect();
        assert_eq!(ids.len(), all.len());
        assert!(Kind::FOREIGN.iter().all(|k| !k.is_in_catalogue()));
    }
}
