//! An edit of the configuration while the daemon runs: it adds, changes and removes loops and leaves all others alone.

use std::collections::HashSet;
use std::time::Duration;

use super::Core;
use crate::daemon::command_policy::CommandPolicy;
use crate::daemon::sink::recorder::{Item, RecordedConfig};
use crate::runtime::control::Edit;
use stiction_engine::alarm::State;
use stiction_engine::codec::topic::Kind;
use stiction_engine::config::Config;
use stiction_engine::engine::{LoopId, RecordedInput, StateDocument};

impl Core {
    /// Takes an edit over between two messages. Every open recording is finished; the next ones begin under the new
    /// configuration, which is how a replay knows of the edit.
    pub(super) fn edit(&mut self, edit: Edit) {
        let Edit { config, text, changes } = edit;
        self.policy = CommandPolicy::new(&config.commands);
        let settings = config.engine().in_place_of(self.engine.engine_settings());
        let recorded = RecordedConfig::new(&config, text).with_origins(&settings.origins);
        let changed = self.engine.reconfigure(settings);
        let remapped = changes.changed.iter().filter(|one| one.is_remapped()).map(|one| &one.name);
        let new_sources: HashSet<LoopId> =
            remapped.chain(&changes.added).filter_map(|name| self.engine.find(name)).collect();
        self.routes.reconfigure(&config, &self.engine);
        self.bundles.reconfigure(&config);
        self.feeds.reconfigure(&config, &new_sources);
        self.record_under(recorded, &config);
        if let Some(overview) = &self.overview {
            overview.expect(config.clone(), self.clock.now(), self.clock.now_ns());
        }
        self.config = config;
        self.describe(&changed);
        for name in &changes.removed {
            if let Some(id) = self.find_or_revive(name) {
                self.removed.insert(id);
            }
        }
        self.forget_removed();
    }

    fn record_under(&mut self, recorded: RecordedConfig, config: &Config) {
        let (max_bytes, max_age) = (config.recording.max_bytes, Duration::from_secs_f64(config.recording.max_s));
        if let Some(recorder) = &mut self.recorder {
            recorder.record(Item::Configuration { config: Box::new(recorded), max_bytes, max_age });
        }
        self.reopen_shards();
    }

    /// Shows what the configuration says of changed loops now.
    fn describe(&mut self, changed: &[LoopId]) {
        if let Some(board) = &mut self.board {
            board.name_loops(&self.config);
        }
        for id in changed {
            let (name, place) = (self.engine.name(*id), &self.engine.settings(*id).place);
            if let Some(board) = &mut self.board {
                board.describe(&self.metrics.series, name, place);
            }
            if let Some(overview) = &self.overview {
                overview.figures(name, place, self.clock.now(), &self.engine.figures(*id));
            }
        }
    }

    /// Forgets removed loops that have no work under way, as loops that have left; their alarms end first.
    pub(super) fn forget_removed(&mut self) {
        if self.removed.is_empty() {
            return;
        }
        let idle: Vec<LoopId> = self.removed.iter().copied().filter(|id| self.engine.is_idle(*id)).collect();
        self.removed.retain(|id| !idle.contains(id));
        for id in &idle {
            if self.engine.checkpoint(*id).alarm.shown() == State::Normal {
                continue;
            }
            let at_ns = self.engine.figures(*id).greatest_ns.unwrap_or(0);
            self.record(*id, Kind::Input, &RecordedInput::Removed, at_ns);
            if let Some(document) = self.engine.end_alarm(*id) {
                self.alarm_changed(*id, &document);
                let state = StateDocument::new(self.engine.name(*id), Some(document.changed_ns), self.memory(*id));
                self.record(*id, Kind::State, &state, document.changed_ns);
            }
        }
        self.forget(&idle);
    }
}
