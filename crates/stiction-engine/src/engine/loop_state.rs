//! One loop: aligner, history, due windows, answers in order, alarm.

use std::collections::VecDeque;
use std::sync::Arc;

use super::due::{Computed, Request, Snapshot, Waiting, WindowAnswer};
use super::gaps::{GapReason, GapRefusal, GapRequest, GapWatch, POOLED, POOLED_NS, PublishedGap, is_recordable};
use super::plant::{GroupStanding, LoopWindow};
use super::{Checkpoint, Event, LoopFigures, LoopId, LoopSettings, SkipReason, StateDocument, StreamState};
use crate::alarm::{Alarm, AlarmDocument, Command, CommandError, State};
use stiction::core::gap::MIN_POINTS;
use stiction::core::gap::model::Model;
use stiction::core::gap::pool;
use stiction::core::record::{Record, Sample};
use stiction::core::units::ns_from_s;
use stiction::core::verdict::{AssessParams, Assessment, EstimateDocument, MemberJudgement};
use stiction::samples::align::{Aligned, Aligner};
use stiction::samples::history::History;

/// A diagnosis under way; the answer, once it came, is `None` if it was skipped.
#[derive(Debug)]
struct WaitingGap {
    number: u64,
    /// Whether a person asked for it.
    by_person: bool,
    answer: Option<Option<PublishedGap>>,
}

#[derive(Debug)]
pub(super) struct LoopState {
    pub name: Arc<str>,
    pub settings: Arc<LoopSettings>,
    pub alarm: Alarm,
    pub gap: GapWatch,
    pub group: Option<GroupStanding>,
    aligner: Aligner,
    history: History,
    /// End of the current window: the first multiple of the hop at or after the last sample.
    next_end_ns: Option<i64>,
    windows: u64,
    waiting: VecDeque<Waiting>,
    gaps: u64,
    gaps_waiting: VecDeque<WaitingGap>,
    /// Windows of the latest diagnoses, which do not overlap.
    diagnosed: VecDeque<pool::Window>,
    /// End of the last window that came due, or after a restart of the last one that the alarm took, so that late samples make
    /// no window twice. Reset when the plant's clock is set back.
    taken_ns: Option<i64>,
    /// Whether it was removed from the configuration; its settings are kept until it is dropped.
    pub removed: bool,
}

impl LoopState {
    pub fn new(name: Arc<str>, settings: Arc<LoopSettings>) -> Self {
        Self {
            name,
            alarm: Alarm::default(),
            gap: GapWatch::default(),
            group: None,
            aligner: Aligner::new(),
            history: settings.window.history(0),
            next_end_ns: None,
            windows: 0,
            waiting: VecDeque::new(),
            gaps: 0,
            gaps_waiting: VecDeque::new(),
            diagnosed: VecDeque::new(),
            taken_ns: None,
            removed: false,
            settings,
        }
    }

    /// The same loop for another run, under the settings there: its stream continues; the rest is restored separately or starts
    /// from nothing.
    pub fn in_next_run(self, settings: Arc<LoopSettings>) -> Self {
        let Self { name, aligner, history, next_end_ns, windows, gaps, .. } = self;
        Self { aligner, history, next_end_ns, windows, gaps, ..Self::new(name, settings) }
    }

    /// Adopts new settings; true if they differ. If its window cannot continue under them, it starts empty: windows under way
    /// are kept, and no window comes due twice.
    pub fn take_settings(&mut self, settings: Arc<LoopSettings>) -> bool {
        let old = std::mem::replace(&mut self.settings, settings);
        if !old.window_continues_under(&self.settings) {
            self.taken_ns = self.taken_ns.or(self.alarm.window_end_ns());
            self.next_end_ns = None;
            self.aligner = Aligner::new();
            self.history = self.settings.window.history(0);
        }
        old != self.settings
    }

    /// Takes a sample. Due windows leave as requests.
    pub fn push(&mut self, id: LoopId, sample: Sample, out: &mut Vec<Event>) {
        let settings = self.settings.clone();
        self.aligner.push(sample, &settings.align);
        let keep_ns = ns_from_s(settings.window.max_window_s);
        while let Some(t_ns) = self.aligner.next_ready_ns(&settings.align) {
            self.enter_hop(id, t_ns, out);
            let Self { history, aligner, .. } = self;
            aligner.take_next(&settings.align, &mut |aligned| match aligned {
                Aligned::Point(point) => history.push(&point, point.t_ns.saturating_sub(keep_ns)),
                Aligned::Break => history.clear(),
            });
        }
        // A window is complete once the loop's time has passed its end and no sample of it waits to be sorted in.
        if let (Some(end_ns), Some(now_ns)) = (self.next_end_ns, self.aligner.event_time_ns(&settings.align))
            && now_ns >= end_ns
            && self.aligner.waiting_ns().is_none_or(|t| t > end_ns)
        {
            self.due(id, end_ns, out);
            self.next_end_ns = None;
        }
    }

    /// Closes the window before a sample and opens the one that contains it. Hops without a sample have no window, since an
    /// outage of years would otherwise produce thousands of empty documents.
    fn enter_hop(&mut self, id: LoopId, t_ns: i64, out: &mut Vec<Event>) {
        let hop_ns = ns_from_s(self.settings.window.hop_s).max(1);
        let is_before = |end_ns: &mut i64| t_ns <= end_ns.saturating_sub(hop_ns);
        if let Some(end_ns) = self.next_end_ns.filter(|end_ns| t_ns > *end_ns) {
            self.due(id, end_ns, out);
            self.next_end_ns = None;
        }
        // Samples before the hop of a window that was due or under way are not used, unless the clock was set back.
        self.next_end_ns.take_if(is_before);
        self.taken_ns.take_if(is_before);
        if self.next_end_ns.is_none() {
            let end = t_ns.div_euclid(hop_ns).saturating_mul(hop_ns);
            self.next_end_ns = Some(if end == t_ns { end } else { end.saturating_add(hop_ns) });
        }
    }

    /// A window comes due and leaves as a request.
    fn due(&mut self, id: LoopId, end_ns: i64, out: &mut Vec<Event>) {
        if self.taken_ns.is_some_and(|taken_ns| end_ns <= taken_ns) {
            return;
        }
        self.taken_ns = Some(end_ns);
        let (seq, bad) = (self.windows, self.aligner.bad_since_last_point());
        self.windows += 1;
        let ts_s = self.aligner.sampling_time_s().unwrap_or(0.0);
        self.waiting.push_back(Waiting::new(seq, end_ns, &self.history, ts_s));
        let (snapshot, settings) = (Snapshot::now(&self.history, end_ns), self.settings.clone());
        let accepted = self.gap.accepted().cloned();
        out.push(Event::Request(Box::new(Request { id, seq, end_ns, settings, snapshot, bad, ts_s, accepted })));
    }

    /// Takes an answer (or none), and processes all answers that are next in order.
    pub fn resolve(
        &mut self,
        id: LoopId,
        seq: u64,
        answer: Option<WindowAnswer>,
        hash: &Arc<str>,
        out: &mut Vec<Event>,
    ) {
        let Some(waiting) = self.waiting.iter_mut().find(|w| w.seq == seq) else { return };
        match answer {
            Some(answer) => waiting.answer = Some((answer.assessment, Some((answer.record, answer.watched)))),
            None => waiting.skip(),
        }
        while self.waiting.front().is_some_and(|w| w.answer.is_some()) {
            if let Some((assessment, computed)) = self.waiting.pop_front().and_then(|w| w.answer) {
                self.consume(id, computed, assessment, hash, out);
            }
        }
    }

    fn consume(
        &mut self,
        id: LoopId,
        computed: Option<Computed>,
        own: Assessment,
        hash: &Arc<str>,
        out: &mut Vec<Event>,
    ) {
        let (assessment, group) = self.with_group(&own);
        let change = self.alarm.window(&self.name, &assessment, &self.settings.alarm);
        // A window that was not computed has no model that could depart.
        let record = computed.as_ref().map(|(record, _)| record.clone());
        let departed = computed.and_then(|(record, watched)| {
            let asked = self.gap.window(&own, &record, watched, &self.settings.gap)?;
            Some((record, asked))
        });
        let end_ns = assessment.window.end_ns;
        let document = EstimateDocument { group, ..EstimateDocument::new(&self.name, hash, assessment) };
        out.push(Event::Estimate(id, Box::new(document)));
        if let Some(document) = change {
            out.push(Event::Alarm(id, Box::new(document.at(&self.settings.place))));
        }
        let (alarm, gap, group) = (self.alarm.clone(), self.gap.clone(), self.group.clone());
        let checkpoint = Checkpoint { alarm, gap, group, stream: None };
        out.push(Event::State(id, Box::new(StateDocument::new(&self.name, Some(end_ns), checkpoint))));
        if let Some(record) = record {
            out.push(Event::Window(id, Box::new(LoopWindow::new(record, own, &self.settings))));
        }
        if let Some((record, (reason, model))) = departed {
            self.ask_gap(id, (reason, None), (record, model, Vec::new()), hash, out);
        }
    }

    /// A window's assessment, combined with the judgement of the loop's group.
    fn with_group(&mut self, own: &Assessment) -> (Assessment, Option<MemberJudgement>) {
        let mut assessment = own.clone();
        let group = self.group.as_ref().and_then(|standing| standing.answer(own));
        if let Some(judged) = &group {
            judged.apply(&mut assessment);
        }
        self.group.take_if(|standing| !standing.count_window());
        (assessment, group)
    }

    /// The history up to a stamp, or to the newest sample; for an older stamp, what is still held.
    pub fn snapshot(&self, end_ns: Option<i64>) -> Option<Snapshot> {
        let end_ns = end_ns.or_else(|| self.history.newest_ns())?;
        Some(Snapshot::up_to(&self.history, end_ns))
    }

    /// A person requests a diagnosis of the latest data, cut like a window that ended now. With `pool`, the windows of earlier
    /// diagnoses help to decide the cause.
    pub fn run_gap(
        &mut self,
        id: LoopId,
        (by, pool): (Option<&str>, bool),
        hash: &Arc<str>,
        out: &mut Vec<Event>,
    ) -> Result<u64, GapRefusal> {
        let record = self.snapshot(None).and_then(|snapshot| snapshot.record(&self.settings.window));
        let points = record.as_ref().map_or(0, Record::len);
        let Some(record) = record.filter(|_| points >= MIN_POINTS) else {
            return Err(GapRefusal::TooShort { points, needed: MIN_POINTS });
        };
        let earlier = if pool { self.earlier_than(&record) } else { Vec::new() };
        if pool && earlier.is_empty() {
            return Err(GapRefusal::NothingEarlier);
        }
        let (asked, model) = ((GapReason::Operator, by.map(str::to_owned)), self.gap.model().cloned());
        Ok(self.ask_gap(id, asked, (Arc::new(record), model, earlier), hash, out))
    }

    /// Windows of earlier diagnoses that end before a record begins.
    fn earlier_than(&self, record: &Record) -> Vec<pool::Window> {
        let age_ns = |window: &&pool::Window| record.start_ns.saturating_sub(window.end_ns);
        self.diagnosed.iter().filter(|window| (0..=POOLED_NS).contains(&age_ns(window))).cloned().collect()
    }

    fn remember_diagnosis(&mut self, window: pool::Window) {
        if !is_recordable(&window) {
            return;
        }
        self.diagnosed.retain(|earlier| earlier.end_ns <= window.start_ns);
        if self.diagnosed.len() == POOLED {
            self.diagnosed.pop_front();
        }
        self.diagnosed.push_back(window);
    }

    fn ask_gap(
        &mut self,
        id: LoopId,
        (reason, by): (GapReason, Option<String>),
        (record, model, earlier): (Arc<Record>, Option<Model>, Vec<pool::Window>),
        hash: &Arc<str>,
        out: &mut Vec<Event>,
    ) -> u64 {
        let number = self.gaps;
        self.gaps += 1;
        self.gaps_waiting.push_back(WaitingGap { number, by_person: reason == GapReason::Operator, answer: None });
        out.push(Event::GapRequest(Box::new(GapRequest {
            id,
            number,
            loop_name: self.name.clone(),
            reason,
            by,
            record,
            assess: AssessParams { always_fit: true, ..self.settings.assess.clone() },
            model,
            neighbours: Vec::new(),
            earlier,
            budget_evaluations: self.settings.gap.budget_evaluations,
            config_hash: hash.clone(),
            daemon: None,
        })));
        number
    }

    /// Takes a diagnosis, or none, and emits all that are next in order.
    pub fn resolve_gap(&mut self, id: LoopId, number: u64, answer: Option<PublishedGap>, out: &mut Vec<Event>) {
        let Some(waiting) = self.gaps_waiting.iter_mut().find(|w| w.number == number) else { return };
        waiting.answer = Some(answer);
        while self.gaps_waiting.front().is_some_and(|w| w.answer.is_some()) {
            let document = self.gaps_waiting.pop_front().and_then(|w| w.answer).flatten();
            if let Some(document) = document {
                if let Some(own) = &document.own {
                    self.remember_diagnosis((**own).clone());
                }
                out.push(Event::Gap(id, Box::new(document)));
            }
        }
    }

    /// Skips a diagnosis. If an automatic one found no place in the queue, the next departing window requests it again.
    pub fn skip_gap(&mut self, id: LoopId, number: u64, reason: SkipReason, out: &mut Vec<Event>) {
        let own = self.gaps_waiting.iter().any(|w| w.number == number && !w.by_person);
        if own && reason == SkipReason::QueueFull {
            self.gap.gave_up();
        }
        self.resolve_gap(id, number, None, out);
    }

    pub fn gaps_waiting(&self) -> impl Iterator<Item = u64> + '_ {
        self.gaps_waiting.iter().filter(|w| w.answer.is_none()).map(|w| w.number)
    }

    pub fn waiting(&self) -> impl Iterator<Item = (u64, i64)> + '_ {
        self.waiting.iter().filter(|w| w.answer.is_none()).map(|w| (w.seq, w.end_ns))
    }

    pub fn command(&mut self, command: &Command) -> Result<AlarmDocument, CommandError> {
        let document = self.alarm.command(&self.name, command, self.event_time_ns())?;
        Ok(document.at(&self.settings.place))
    }

    /// Ends the alarm of a loop that is no longer watched; `None` if it is normal.
    pub fn end_alarm(&mut self) -> Option<AlarmDocument> {
        let document = self.alarm.remove(&self.name, self.event_time_ns())?;
        Some(document.at(&self.settings.place))
    }

    fn event_time_ns(&self) -> i64 {
        let clock = self.aligner.event_time_ns(&self.settings.align);
        clock.or(self.alarm.window_end_ns()).unwrap_or(0)
    }

    pub fn checkpoint(&self) -> Checkpoint {
        let stream = StreamState {
            aligner: self.aligner.clone(),
            points: self.history.total(),
            next_end_ns: self.next_end_ns,
            windows: self.windows,
            gaps: self.gaps,
            waiting: self.waiting.len() as u64,
            taken_ns: self.taken_ns,
        };
        Checkpoint { alarm: self.alarm.clone(), gap: self.gap.clone(), group: self.group.clone(), stream: Some(stream) }
    }

    pub fn restore(&mut self, checkpoint: Checkpoint) -> Option<AlarmDocument> {
        (self.alarm, self.gap, self.group) = (checkpoint.alarm, checkpoint.gap, checkpoint.group);
        if let Some(stream) = checkpoint.stream {
            // An empty history may have the sizes of other settings.
            if self.history.total() != stream.points || stream.points == 0 {
                self.history = self.settings.window.history(stream.points);
            }
            self.aligner = stream.aligner;
            self.next_end_ns = stream.next_end_ns;
            self.windows = stream.windows;
            self.gaps = stream.gaps;
            self.taken_ns = stream.taken_ns;
        } else if self.aligner.greatest_ns().is_some() {
            self.taken_ns = self.alarm.window_end_ns();
        }
        let restored = || self.alarm.restored(&self.name).at(&self.settings.place);
        (self.alarm.shown() != State::Normal).then(restored)
    }

    /// Whether nothing of it is under way.
    pub fn is_idle(&self) -> bool {
        self.waiting.is_empty() && self.gaps_waiting.is_empty()
    }

    /// Bytes that it occupies, without what all loops share.
    pub fn bytes(&self) -> usize {
        size_of::<Self>() + self.name.len() + self.history.bytes() + self.aligner.bytes()
    }

    pub fn figures(&self) -> LoopFigures {
        LoopFigures {
            counts: *self.aligner.counts(),
            greatest_ns: self.aligner.greatest_ns(),
            windows: self.windows,
            waiting: self.waiting.len(),
        }
    }
}
