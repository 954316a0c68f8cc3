//! Applies an edit of the configuration at run time: adds, changes and removes loops, and leaves all others alone.

use std::collections::HashSet;
use std::time::Duration;

use super::EngineThread;
use crate::daemon::command_policy::CommandPolicy;
use crate::daemon::sink::recorder::{Item, RecordedConfig};
use crate::runtime::control::Edit;
use stiction_engine::alarm::State;
use stiction_engine::codec::topic::Kind;
use stiction_engine::config::Config;
use stiction_engine::engine::{LoopId, RecordedInput, StateDocument};

impl EngineThread {
    /// Applies an edit between two messages. All open recordings are closed; the next ones start under the new configuration,
    /// from which a replay learns of the edit.
    pub(super) fn edit(&mut self, edit: Edit) {
        let Edit { config, text, changes } = edit;
        self.inputs.policy = CommandPolicy::new(&config.commands);
        let settings = config.engine().in_place_of(self.loops.engine.engine_settings());
        let recorded = RecordedConfig::new(&config, text).with_origins(&settings.origins);
        let changed = self.loops.engine.reconfigure(settings);
        let remapped = changes.changed.iter().filter(|one| one.is_remapped()).map(|one| &one.name);
        let new_sources: HashSet<LoopId> =
            remapped.chain(&changes.added).filter_map(|name| self.loops.engine.find(name)).collect();
        self.inputs.routes.reconfigure(&config, &self.loops.engine);
        self.inputs.bundles.reconfigure(&config);
        self.inputs.feeds.reconfigure(&config, &new_sources);
        self.record_under(recorded, &config);
        if let Some(overview) = &self.outputs.overview {
            overview.expect(config.clone(), self.clock.now(), self.clock.now_ns());
        }
        self.config = config;
        self.describe(&changed);
        for name in &changes.removed {
            if let Some(id) = self.find_or_revive(name) {
                self.loops.removed.insert(id);
            }
        }
        self.forget_removed();
    }

    fn record_under(&mut self, recorded: RecordedConfig, config: &Config) {
        let (max_bytes, max_age) = (config.recording.max_bytes, Duration::from_secs_f64(config.recording.max_s));
        if let Some(recorder) = &mut self.outputs.recorder {
            recorder.record(Item::Configuration { config: Box::new(recorded), max_bytes, max_age });
        }
        self.reopen_segments();
    }

    /// Updates the settings of changed loops in the metrics and on the page.
    fn describe(&mut self, changed: &[LoopId]) {
        if let Some(board) = &mut self.outputs.board {
            board.name_loops(&self.config);
        }
        for id in changed {
            let (name, place) = (self.loops.engine.name(*id), &self.loops.engine.settings(*id).place);
            if let Some(board) = &mut self.outputs.board {
                board.describe(&self.metrics.series, name, place);
            }
            if let Some(overview) = &self.outputs.overview {
                overview.figures(name, place, self.clock.now(), &self.loops.engine.figures(*id));
            }
        }
    }

    /// Forgets removed loops once no work is under way for them. Their alarms end first, and they then count as loops that have
    /// left.
    pub(super) fn forget_removed(&mut self) {
        if self.loops.removed.is_empty() {
            return;
        }
        let idle: Vec<LoopId> =
            self.loops.removed.iter().copied().filter(|id| self.loops.engine.is_idle(*id)).collect();
        self.loops.removed.retain(|id| !idle.contains(id));
        for id in &idle {
            if self.loops.engine.checkpoint(*id).alarm.shown() == State::Normal {
                continue;
            }
            let at_ns = self.loops.engine.figures(*id).greatest_ns.unwrap_or(0);
            self.record(*id, Kind::Input, &RecordedInput::Removed, at_ns);
            if let Some(document) = self.loops.engine.end_alarm(*id) {
                self.alarm_changed(*id, &document);
                let state =
                    StateDocument::new(self.loops.engine.name(*id), Some(document.changed_ns), self.memory(*id));
                self.record(*id, Kind::State, &state, document.changed_ns);
            }
        }
        self.forget(&idle);
    }
}
