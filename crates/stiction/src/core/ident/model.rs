//! A valve and a process in recorded units, from a fit, a document or a file.

use super::class::Class;
use crate::core::record::Record;
use crate::core::sim::slips::Law;

/// A valve and the process behind it.
#[derive(Debug, Clone, PartialEq)]
pub struct Model {
    /// The valve's law.
    pub law: Law,
    /// Static band, OP units; if it and `fd` are 0, the valve follows OP.
    pub fs: f64,
    /// Kinetic band, OP units.
    pub fd: f64,
    /// PV units per OP unit (also per second if integrating).
    pub gain: f64,
    /// Time constants, s, largest first: one or two if self-regulating, none or one if integrating.
    pub time_constants_s: Vec<f64>,
    /// Dead time, s.
    pub dead_time_s: f64,
    /// Integrating instead of self-regulating.
    pub integrating: bool,
}

impl Model {
    /// The process class; `None` if no class has this number of time constants.
    pub(crate) fn class(&self) -> Option<Class> {
        match (self.integrating, self.time_constants_s.len()) {
            (false, 1) => Some(Class::First),
            (false, 2) => Some(Class::Second),
            (true, 0) => Some(Class::Integrating),
            (true, 1) => Some(Class::LagIntegrating),
            _ => None,
        }
    }

    /// Time constants in points of a record, the larger first; the last one is repeated for those that the class lacks.
    pub(crate) fn taus(&self, record: &Record) -> [f64; 2] {
        let last = self.time_constants_s.last().copied().unwrap_or(1.0);
        [0, 1].map(|index| self.time_constants_s.get(index).copied().unwrap_or(last) / record.point_s())
    }

    /// Dead time plus the sample that a held signal takes to act, points of a record.
    pub(crate) fn lag(&self, record: &Record) -> f64 {
        (self.dead_time_s / record.ts_s + 1.0) / record.box_samples as f64
    }
}
