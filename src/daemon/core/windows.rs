//! Windows from the moment they are due to the worker: thousands come due at once, so each is cut from its loop's memory
//! only when a worker is free for it.

use super::Core;
use stiction_monitor::codec::topic::Kind;
use stiction_monitor::engine::{LoopId, RecordedInput, SkipReason};

/// A window in the row.
#[derive(Debug, Clone, Copy)]
pub(super) struct Due {
    id: LoopId,
    seq: u64,
    end_ns: i64,
}

impl Core {
    /// A window came due: it takes its place in the row, and whoever must make room is skipped.
    pub(super) fn due(&mut self, id: LoopId, seq: u64, end_ns: i64) {
        self.metrics.windows.inc();
        self.due.insert((id, seq), self.arrival_ns);
        let job = Due { id, seq, end_ns };
        let given_up = self.schedule.push(id.index(), self.engine.name(id), size_of::<Due>(), job);
        for Due { id, seq, end_ns } in given_up {
            self.skip(id, seq, end_ns, SkipReason::QueueFull);
        }
        self.employ();
    }

    /// Gives idle workers what is next.
    pub(super) fn employ(&mut self) {
        while !self.workers.requests.is_full() {
            let Some(Due { id, seq, end_ns }) = self.schedule.pop() else { return };
            let Some(request) = self.engine.request(id, seq) else {
                // Its loop has changed hands since.
                self.due.remove(&(id, seq));
                continue;
            };
            if self.workers.requests.try_send(request).is_err() {
                self.skip(id, seq, end_ns, SkipReason::Failed);
            }
        }
    }

    pub(super) fn skip(&mut self, id: LoopId, seq: u64, window_end_ns: i64, reason: SkipReason) {
        self.metrics.fits_skipped.inc();
        self.due.remove(&(id, seq));
        self.record(id, Kind::Input, &RecordedInput::Skip { window_end_ns, seq, reason }, window_end_ns);
        self.engine.skip(id, seq, &mut self.events);
    }
}
