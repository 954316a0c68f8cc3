//! Passes windows to the workers. Thousands may come due at once; the schedule decides which is next.

use super::EngineThread;
use crate::daemon::worker::Job;
use stiction_engine::codec::topic::Kind;
use stiction_engine::engine::{LoopId, RecordedInput, Request, SkipReason};

impl EngineThread {
    /// Puts a due window into the schedule, and skips those that must make room for it.
    pub(super) fn schedule_window(&mut self, request: Request) {
        self.metrics.windows.inc();
        let id = request.id;
        if let Some(plant) = &mut self.loops.plant {
            plant.watch.expect(request.end_ns);
        }
        // A loop's first waiting window shares most of its memory with the history; every further one holds a copy.
        let bytes = if self.loops.engine.waiting(id).nth(1).is_some() { request.bytes() } else { 0 };
        let job = Job { request, arrival_ns: self.inputs.arrival_ns };
        for Job { request, .. } in self.loops.schedule.push(id.index(), self.loops.engine.name(id), bytes, job) {
            self.skip(request.id, request.seq, request.end_ns, SkipReason::QueueFull);
        }
        self.dispatch_to_workers();
    }

    /// Gives waiting windows to idle workers.
    pub(super) fn dispatch_to_workers(&mut self) {
        while !self.loops.workers.jobs.is_full() {
            let Some(job) = self.loops.schedule.pop() else { return };
            let (id, seq, end_ns) = (job.request.id, job.request.seq, job.request.end_ns);
            if self.loops.workers.jobs.try_send(job).is_err() {
                self.skip(id, seq, end_ns, SkipReason::Failed);
            }
        }
    }

    pub(super) fn window_answered(&mut self, end_ns: i64) {
        if let Some(plant) = &mut self.loops.plant {
            plant.watch.answered(end_ns);
        }
    }

    pub(super) fn skip(&mut self, id: LoopId, seq: u64, window_end_ns: i64, reason: SkipReason) {
        self.metrics.fits_skipped.inc();
        self.record(id, Kind::Input, &RecordedInput::Skip { window_end_ns, seq, reason }, window_end_ns);
        self.loops.engine.skip(id, seq, &mut self.loops.events);
        self.window_answered(window_end_ns);
    }
}
