//! Requests from people: commands on alarms, and gap diagnoses with their answers.

use super::super::gaps::{self, Diagnosed, Outcome};
use super::{EngineThread, to_json};
use crate::runtime::control::{Answer, WindowSnapshot};
use stiction::core::gap::MIN_POINTS;
use stiction_engine::alarm::{AlarmDocument, Command, CommandError};
use stiction_engine::codec::topic::Kind;
use stiction_engine::engine::{
    Checkpoint, GapRefusal, GapRequest, LoopId, RecordedInput, RecordedNeighbour, SkipReason, StateDocument,
};

impl EngineThread {
    /// Carries out a command. The reply is sent only after the effect and the document for receivers are on disk, so a crash
    /// after the reply loses nothing.
    pub(super) fn take_command(&mut self, loop_name: &str, command: &Command, answer: Answer) {
        // The daemon of the loop's shard answers.
        if !self.config.shard.owns(loop_name) {
            return;
        }
        // Commands for unknown loops do not use up the rate.
        let has_left = self.loops.engine.has_left(loop_name);
        let known = self.loops.engine.find(loop_name).is_some() || has_left;
        // A loop that has left accepts commands even if there is no place for it; without a place it is forgotten again at
        // once.
        let is_guest = has_left && !self.loops.engine.has_place_for(loop_name);
        self.answer_command((loop_name, known), command, answer);
        if is_guest && let Some(id) = self.loops.engine.find(loop_name) {
            self.forget(&[id]);
        }
    }

    fn answer_command(&mut self, (loop_name, known): (&str, bool), command: &Command, answer: Answer) {
        let now = self.clock.since(self.started);
        let allowed = self
            .inputs
            .policy
            .check(command)
            .and_then(|()| if known { self.inputs.policy.command(now) } else { Ok(()) });
        let done = allowed.and_then(|()| self.command(loop_name, command).map_err(|e| e.to_string()));
        let (id, document) = match done {
            Ok(done) => done,
            Err(why) => {
                self.metrics.commands_refused.inc();
                self.inputs.policy.log_refusal(
                    self.clock.since(self.started),
                    command.action.name(),
                    loop_name,
                    command.by.as_deref(),
                    &why,
                );
                return answer(Err(why));
            }
        };
        self.metrics.commands.inc();
        let at_ns = document.changed_ns;
        let state = StateDocument::new(self.loops.engine.name(id), Some(at_ns), self.memory(id));
        self.record(id, Kind::State, &state, at_ns);
        let unwritten = || "carried out, but its document cannot be written; see the log".to_owned();
        let json = to_json(&document).ok_or_else(unwritten);
        let Some(state_writer) = &self.outputs.state_writer else { return answer(json) };
        let Some(state) = to_json(&state) else { return answer(Err(unwritten())) };
        let kept = move |kept: Result<(), String>| {
            answer(match kept {
                Ok(()) => json,
                Err(why) => {
                    Err(format!("carried out, but not stored: {why}. It is forgotten if the daemon ends before"))
                }
            });
        };
        state_writer.keep_then(self.loops.engine.name(id), state, self.clock.now(), Box::new(kept));
    }

    fn command(&mut self, loop_name: &str, command: &Command) -> Result<(LoopId, AlarmDocument), CommandError> {
        let id = self.find_or_revive(loop_name).ok_or_else(|| CommandError::UnknownLoop(loop_name.to_owned()))?;
        let document = self.loops.engine.command(id, command)?;
        self.record(id, Kind::Input, &RecordedInput::Command(command.clone()), document.changed_ns);
        self.alarm_changed(id, &document);
        Ok((id, document))
    }

    /// Hands out a loop's history; the caller cuts the window.
    pub(super) fn get_window(
        &self,
        loop_name: &str,
        end_ns: Option<i64>,
        answer: Box<dyn FnOnce(Option<WindowSnapshot>) + Send>,
    ) {
        answer(self.loops.engine.find(loop_name).map(|id| WindowSnapshot {
            snapshot: self.loops.engine.snapshot(id, end_ns),
            settings: self.loops.engine.settings(id).clone(),
        }));
    }

    /// The part of a loop's state that survives a restart.
    pub(super) fn memory(&self, id: LoopId) -> Checkpoint {
        Checkpoint { stream: None, ..self.loops.engine.checkpoint(id) }
    }

    /// Starts a diagnosis for a person. If one is already running for the loop, the person gets its answer.
    pub(super) fn run_gap(&mut self, loop_name: &str, by: Option<String>, pool: bool, answer: Answer) {
        if !self.config.shard.owns(loop_name) {
            return;
        }
        if let Err(why) = self.inputs.policy.name(by.as_deref()) {
            return self.refuse_gap(answer, loop_name, by.as_deref(), &why);
        }
        let Some(id) = self.loops.engine.find(loop_name).filter(|id| !self.loops.removed.contains(id)) else {
            // For a loop that has left, no samples are held.
            let why = if self.loops.engine.has_left(loop_name) {
                GapRefusal::TooShort { points: 0, needed: MIN_POINTS }
            } else {
                GapRefusal::UnknownLoop(loop_name.to_owned())
            };
            return self.refuse_gap(answer, loop_name, by.as_deref(), &why.to_string());
        };
        if let Some(number) = self.loops.engine.gaps_waiting(id).last() {
            let asking = self.loops.asking.entry((id, number)).or_default();
            if asking.len() < gaps::QUEUE {
                return asking.push(answer);
            }
            return self.refuse_gap(
                answer,
                loop_name,
                by.as_deref(),
                &format!("{} wait for this diagnosis already", gaps::QUEUE),
            );
        }
        if let Err(why) = self.inputs.policy.run(self.clock.since(self.started)) {
            return self.refuse_gap(answer, loop_name, by.as_deref(), &why);
        }
        if self.loops.diagnoser.requests.is_full() {
            return self.refuse_gap(
                answer,
                loop_name,
                by.as_deref(),
                &format!("{} diagnoses wait already: try again later", gaps::QUEUE),
            );
        }
        match self.loops.engine.run_gap(id, by.as_deref(), pool, &mut self.loops.events) {
            Ok(number) => {
                let at_ns = self.loops.engine.figures(id).greatest_ns.unwrap_or(0);
                self.record(id, Kind::Input, &RecordedInput::GapRun { number, by }, at_ns);
                self.loops.asking.entry((id, number)).or_default().push(answer);
                self.handle_events();
            }
            Err(refusal) => self.refuse_gap(answer, loop_name, None, &refusal.to_string()),
        }
    }

    fn refuse_gap(&mut self, answer: Answer, loop_name: &str, by: Option<&str>, why: &str) {
        self.metrics.gaps_skipped.inc();
        self.inputs.policy.log_refusal(self.clock.since(self.started), "run", loop_name, by, why);
        answer(Err(why.to_owned()));
    }

    /// Starts a diagnosis with all loops that may influence this one as neighbours, and records its inputs.
    pub(super) fn request_gap(&mut self, mut request: GapRequest) {
        let (id, number) = (request.id, request.number);
        let neighbours = self.loops.engine.neighbours_of(&request);
        if !neighbours.is_empty() {
            request.neighbours = neighbours.iter().map(RecordedNeighbour::neighbour).collect();
            let input = RecordedInput::GapNeighbours { number, neighbours };
            self.record(id, Kind::Input, &input, request.record.end_ns);
        }
        if !request.earlier.is_empty() {
            let input = RecordedInput::GapEarlier { number, windows: request.earlier.clone() };
            self.record(id, Kind::Input, &input, request.record.end_ns);
        }
        if self.loops.diagnoser.requests.try_send(request).is_err() {
            self.skip_gap(id, number, SkipReason::QueueFull, "too many diagnoses wait already");
        }
    }

    pub(super) fn diagnosed(&mut self, diagnosed: Diagnosed) {
        let Diagnosed { id, number, outcome } = diagnosed;
        match outcome {
            Outcome::Skipped(reason, why) => self.skip_gap(id, number, reason, &why),
            Outcome::Done(document, cut) => {
                if let Some(evaluations) = cut {
                    self.metrics.gaps_cut.inc();
                    let input = RecordedInput::GapCut { number, evaluations };
                    self.record(id, Kind::Input, &input, document.end_ns());
                }
                let json = to_json(&document).ok_or("the diagnosis cannot be written; see the log");
                self.loops.engine.complete_gap(id, number, *document, &mut self.loops.events);
                self.handle_events();
                for answer in self.loops.asking.remove(&(id, number)).into_iter().flatten() {
                    answer(json.clone().map_err(str::to_owned));
                }
            }
        }
        self.handle_events();
        self.forget_removed();
    }

    pub(super) fn skip_gap(&mut self, id: LoopId, number: u64, reason: SkipReason, why: &str) {
        self.metrics.gaps_skipped.inc();
        tracing::info!(name = %self.loops.engine.name(id), why, "a gap diagnosis was not made");
        let at_ns = self.loops.engine.figures(id).greatest_ns.unwrap_or(0);
        self.record(id, Kind::Input, &RecordedInput::GapSkip { number, reason }, at_ns);
        self.loops.engine.skip_gap(id, number, reason, &mut self.loops.events);
        for answer in self.loops.asking.remove(&(id, number)).into_iter().flatten() {
            answer(Err(why.to_owned()));
        }
    }
}
