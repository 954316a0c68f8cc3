//! Settings for an engine and its loops, from the configuration.

use std::sync::Arc;

use super::{Config, LoopConfig};
use crate::alarm::LoopContext;
use crate::engine::{EngineSettings, LoopSettings, Origins};
use stiction::core::units::{LoopKind, ns_from_s};
use stiction::core::verdict::AssessParams;
use stiction::samples::align::AlignParams;

impl Config {
    /// Settings of an engine.
    #[must_use]
    pub fn engine(&self) -> EngineSettings {
        let own = |l: &LoopConfig| (l.name.clone(), Arc::new(self.of_loop(Some(l), LoopKind::of_tag(&l.name))));
        let config_hash = self.hash();
        EngineSettings {
            origins: Origins::new(&config_hash),
            config_hash: config_hash.into(),
            daemon: None,
            max_loops: self.input.max_loops,
            common: LoopKind::ALL.map(|kind| Arc::new(self.of_loop(None, kind))),
            own: Arc::new(self.loops.iter().map(own).collect()),
        }
    }

    /// Settings of a loop by name.
    #[must_use]
    pub fn loop_settings(&self, name: &str) -> LoopSettings {
        self.of_loop(self.loop_named(name), LoopKind::of_tag(name))
    }

    /// Settings of a loop; `kind` comes from its tag and is overridden by its own settings.
    pub(super) fn of_loop(&self, own: Option<&LoopConfig>, kind: LoopKind) -> LoopSettings {
        let (window, alarm) = own.map_or((self.window, self.alarm), |l| (l.window, l.alarm));
        LoopSettings {
            keys: own.map(|l| l.keys.clone()).unwrap_or_default(),
            align: AlignParams {
                lateness_ns: ns_from_s(window.lateness_s),
                max_gap_s: window.max_gap_s,
                quality: self.input.quality,
                modes: self.input.modes.clone(),
            },
            assess: AssessParams {
                min_periods: window.min_periods,
                min_samples_per_period: window.min_samples_per_period,
                min_reversals: window.min_reversals,
                op_range: own.and_then(|l| l.op_range),
                op_unit: own.and_then(|l| place_of(l).op_unit),
                kind: own.and_then(|l| l.kind).unwrap_or(kind),
                prevalence: self.verdict.prevalence,
                final_element: own.map(|l| l.final_element).unwrap_or_default(),
                ..AssessParams::default()
            },
            window,
            alarm,
            gap: self.gap,
            place: LoopContext { site: self.site.prefix.as_str().into(), ..own.map(place_of).unwrap_or_default() },
        }
    }
}

/// The loop's context from the configuration.
fn place_of(own: &LoopConfig) -> LoopContext {
    let said = |text: &String| Some(text.clone()).filter(|text| !text.is_empty());
    // OP with a range of 0 to 100 is in %, whoever wrote the range.
    let percent = (own.op_range == Some([0.0, 100.0])).then(|| "%".to_owned());
    LoopContext {
        criticality: Some(own.criticality),
        area: said(&own.area),
        equipment: said(&own.equipment),
        op_unit: said(&own.op_unit).or(percent),
        upstream: own.upstream.clone(),
        ..LoopContext::default()
    }
}
