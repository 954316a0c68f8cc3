//! The budget and what can be told, as parts of the gap document.

use std::collections::BTreeMap;

use serde::{Deserialize, Serialize};

use super::Budget;
use super::parts::Part;
use crate::core::gap::effects;
use crate::core::gap::set_point;
use crate::core::gap::sizes::Quantity;
use crate::core::gap::types::{Signature, Slip};
use crate::core::record::Record;

/// What valve and process make of OP.
pub const VALVE_AND_PROCESS: &str = "valve_and_process";
/// Several loads that step or last a while.
pub(crate) const UPSETS: &str = "upsets";
/// What wanders from outside.
pub const DISTURBANCE: &str = "disturbance";
/// Both, where they are not told apart.
pub const NOT_SPLIT: &str = "valve_process_and_disturbance";
/// Measurement noise.
pub const NOISE: &str = "noise";
/// What nothing predicts.
pub const UNEXPLAINED: &str = "unexplained";

/// Gains of log likelihood, nats, up to which the process' structure is hardly told from PV and OP, and from which it mostly
/// is. Measured on simulated twins of three structures: .34 right below, .86 above (chance .33).
pub const TOLD: [f64; 2] = [104.0, 305.0];
/// Largest factor by which a longer record is asked for.
const MOST_LONGER: f64 = 10.0;

/// Sizes of an effect by their names.
type Sizes = BTreeMap<String, Quantity>;

/// A part of PV's variance.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct PartNote {
    /// `valve_and_process`, the id of an effect or of the cause, `upsets`, `disturbance`,
    /// `valve_process_and_disturbance`, `noise` or `unexplained`.
    pub id: String,
    /// Share of PV's variance, %; all parts sum to 100. Negative for a part that works against the others.
    pub share_pct: f64,
    /// Its standard deviation, PV units.
    pub sd: f64,
    /// An effect's sizes; the disturbance's
    /// `period` (s) and band (`from` and `to`, Hz).
    pub parameters: BTreeMap<String, Quantity>,
    /// Log likelihood that an effect gains under the noise model beyond what its parameters cost, nats; for the cause, what its
    /// run gains over the next best driver.
    pub gain_nats: Option<f64>,
    /// Whether the record's halves confirm an effect; false means "suspected", as always where a recorder changed PV. Of the cause,
    /// what the document's `cause` says.
    pub confirmed: Option<bool>,
    /// The loads of `upsets`, in time.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub events: Vec<EventNote>,
}

/// A load that steps or lasts a while.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct EventNote {
    /// Time after the record's start, s.
    pub at_s: f64,
    /// Its height, PV units.
    pub size: f64,
    /// How long it lasts, s; `None` for a step, which stays.
    pub length_s: Option<f64>,
    /// Whether the record's halves confirm it.
    pub confirmed: bool,
}

/// The size from which an effect would have been named in this record.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct SmallestNote {
    /// Its id.
    pub id: String,
    /// Height of a step, or amplitude of a sinusoid, PV units.
    pub size: f64,
    /// The sinusoid's period, s.
    pub period_s: Option<f64>,
}

/// PV's variance, split under a noise model.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct BudgetNote {
    /// Points split: the record's last ones.
    pub points: u64,
    /// Time between them, s.
    pub point_s: f64,
    /// Time of the first after the record's start, s.
    pub from_s: f64,
    /// The parts; their shares sum to 100.
    pub parts: Vec<PartNote>,
    /// Why valve and process are not told from the disturbance: `process_unstable` or `parts_correlate`.
    pub no_split: Option<String>,
    /// What drives the process in the noise model: `op`, a fitted valve's `stem`, or a free run: that of the `base`, or of the
    /// base with the `cause`.
    pub driven_by: String,
    /// Order of the noise model.
    pub order: u8,
    /// From which size on a step or a slow sinusoid would have been named.
    pub smallest: Vec<SmallestNote>,
    /// What a recorder did to PV, by effect: it makes every figure here less sure.
    pub recorder: Vec<String>,
}

/// What the record can tell.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct TellableNote {
    /// Log likelihood of PV that OP adds to PV's own past, nats.
    pub gain_nats: f64,
    /// Whether that tells the process' structure: `hardly`, `partly` or `mostly`.
    pub structure: String,
    /// Share of OP's moves that the controller read from the record does not explain, %; `None` where none could be read.
    pub outside_controller_pct: Option<f64>,
    /// Moves of the set point.
    pub sp_moves: u64,
    /// Slips of the base's valve.
    pub slips: u64,
    /// Periods of the oscillation or the typical movement.
    pub periods: f64,
    /// What would tell more: `longer_record`, `op_step`, `valve_position`.
    pub helps: Vec<String>,
    /// How many times as long a record would have to be for `structure` to be `mostly`, if it went on like this one.
    pub times_as_long: Option<f64>,
}

impl PartNote {
    /// A part without parameters, by its share, %, and its standard deviation, PV units.
    #[must_use]
    pub(in crate::core::gap) fn plain(id: &str, share_pct: f64, sd: f64) -> Self {
        let (gain_nats, confirmed) = (None, None);
        Self { id: id.to_owned(), share_pct, sd, parameters: BTreeMap::new(), gain_nats, confirmed, events: Vec::new() }
    }

    /// Takes over so much of PV's variance, %, of a part of this standard deviation.
    pub(in crate::core::gap) fn take_over(&mut self, share_pct: f64, sd: f64) {
        self.share_pct += share_pct;
        self.sd = libm::hypot(self.sd, sd);
    }
}

impl BudgetNote {
    /// The note of a budget; `cause` has the sizes of the cause that a search named, and whether it is confirmed.
    #[must_use]
    pub(crate) fn of(budget: &Budget, signatures: &[Signature], cause: Option<(&Sizes, bool)>) -> Self {
        let series = &budget.series;
        let (split, deviation) = (&budget.split, series.of_pv[1]);
        let plain = |id: &str, part: Part| PartNote::plain(id, 100.0 * part.share, part.size * deviation);
        let recorded = |s: &&Signature| s.met && effects::by_id(&s.id).is_some_and(|e| e.recorder.is_some());
        let recorder: Vec<String> = signatures.iter().filter(recorded).map(|s| s.id.clone()).collect();
        // What a recorder drew or held between two values may look like anything.
        let sure = recorder.is_empty();
        let named = budget.named();
        let effect = |(place, effects): (usize, &Vec<usize>)| {
            let (id, confirmed) = &named[place];
            let gain = effects.iter().map(|k| budget.searched.added[*k].gain).sum();
            let sizes = |k: usize| {
                let beta = &budget.searched.fit.beta[budget.searched.places(k)];
                budget.searched.added[k].shape.sizes(beta, series, split.gain)
            };
            let (parameters, events) = match effects.as_slice() {
                [one] => (sizes(*one), Vec::new()),
                several => {
                    let event = |k: &usize| EventNote::of(&sizes(*k), budget.confirmed[*k] && sure);
                    let mut events: Vec<EventNote> = several.iter().map(event).collect();
                    events.sort_by(|x, y| x.at_s.total_cmp(&y.at_s));
                    (BTreeMap::new(), events)
                }
            };
            let confirmed = Some(*confirmed && sure);
            PartNote { parameters, gain_nats: Some(gain), confirmed, events, ..plain(id, split.effects[place]) }
        };
        let hertz = |cycles: f64| Quantity { value: cycles / series.point_s, unit: "Hz".to_owned() };
        let [from, to] = split.course.band;
        let mut course = BTreeMap::from([("from".to_owned(), hertz(from)), ("to".to_owned(), hertz(to))]);
        if let Some(period) = split.course.period {
            course.insert("period".to_owned(), Quantity { value: period * series.point_s, unit: "s".to_owned() });
        }
        let cause_row = budget.model.cause(series).zip(split.cause).map(|((run, _), share)| PartNote {
            parameters: cause.map(|(sizes, _)| sizes.clone()).unwrap_or_default(),
            gain_nats: budget.model.lead,
            confirmed: Some(cause.is_some_and(|(_, confirmed)| confirmed)),
            ..plain(&run.id, share)
        });
        let name = if split.valve_and_process.is_some() { DISTURBANCE } else { NOT_SPLIT };
        let mut parts: Vec<PartNote> =
            split.valve_and_process.into_iter().map(|part| plain(VALVE_AND_PROCESS, part)).collect();
        parts.extend(cause_row);
        parts.extend(budget.searched.parts().iter().enumerate().map(effect));
        parts.push(PartNote { parameters: course, ..plain(name, split.disturbance) });
        parts.extend([plain(NOISE, split.noise), plain(UNEXPLAINED, split.unexplained)]);
        let step = budget.smallest_step.map(|size| (effects::step_load::EFFECT.id, size, None));
        let wave =
            budget.smallest_sinusoid.map(|(size, f)| (effects::sinusoid::EFFECT.id, size, Some(series.point_s / f)));
        let smallest = step.into_iter().chain(wave).map(|(id, size, period_s)| SmallestNote {
            id: id.to_owned(),
            size: size * deviation,
            period_s,
        });
        Self {
            points: series.n() as u64,
            point_s: series.point_s,
            from_s: series.time_s(0),
            parts,
            no_split: split.no_split.map(str::to_owned),
            driven_by: budget.model.driven_by(series).to_owned(),
            order: budget.searched.fit.order() as u8,
            smallest: smallest.collect(),
            recorder,
        }
    }
}

impl EventNote {
    /// The event of a load by its sizes.
    fn of(sizes: &BTreeMap<String, Quantity>, confirmed: bool) -> Self {
        let value = |name: &str| sizes.get(name).map(|q| q.value);
        Self {
            at_s: value("at").unwrap_or_default(),
            size: value("size").unwrap_or_default(),
            length_s: value("length"),
            confirmed,
        }
    }
}

impl TellableNote {
    /// What a record can tell by its budget, the slips of the base and how much of OP's moves the controller explains.
    #[must_use]
    pub fn of(record: &Record, budget: &Budget, slips: &[Slip], explained: Option<f64>) -> Self {
        let (gain, periods) = (budget.model.gain_by_op, budget.series.n() as f64 / budget.series.period);
        let [hardly, mostly] = TOLD;
        let sp_moves = set_point::moves(record).len();
        // Nats grow with the record's length.
        let times = (gain < mostly && gain > 0.0).then(|| mostly / gain).filter(|t| *t <= MOST_LONGER);
        let wanted = gain < mostly;
        let helps = [
            ("longer_record", times.is_some()),
            ("op_step", wanted),
            ("valve_position", wanted && record.mv.is_none()),
        ];
        Self {
            gain_nats: gain,
            structure: if gain < hardly {
                "hardly"
            } else if gain < mostly {
                "partly"
            } else {
                "mostly"
            }
            .to_owned(),
            outside_controller_pct: explained.map(|r2| 100.0 * (1.0 - r2)),
            sp_moves: sp_moves as u64,
            slips: slips.len() as u64,
            periods,
            helps: helps.iter().filter(|(_, helps)| *helps).map(|(id, _)| (*id).to_owned()).collect(),
            times_as_long: times,
        }
    }
}

/// The record holds too little to tell causes apart.
pub const CANNOT_BE_TOLD: &str = "cannot_be_told";
/// The record holds enough, and no effect of the catalogue explains it.
pub(crate) const NOT_IN_CATALOGUE: &str = "not_in_catalogue";
