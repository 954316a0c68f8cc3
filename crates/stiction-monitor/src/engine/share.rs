//! Loops that several daemons share: one is taken with what its last owner remembered, and released with what this one
//! does. Both are facts from outside: the recording must hold them as inputs.

use super::{Checkpoint, Engine, Event, LoopId};
use crate::alarm::AlarmDocument;

impl Engine {
    /// A loop is this daemon's from now on. It begins with an empty window and, where there is one, with the memory of the
    /// daemon that had it; windows up to the last one that this memory knows are done, and do not come due again while the
    /// loop's past is taken once more. Gives the alarm's document where it is not at rest.
    pub fn take(&mut self, id: LoopId, memory: Option<Checkpoint>) -> Option<AlarmDocument> {
        let document = self.of_mut(id).take(memory);
        document.map(|document| self.signed(document))
    }

    /// Another daemon has the loop now: gives what is remembered of it, and holds nothing more. Windows that wait for
    /// their answers are the other's, who makes them again; no alarm is cleared.
    pub fn release(&mut self, id: LoopId) -> Checkpoint {
        self.of_mut(id).release()
    }

    /// Whether the loop was released, and not taken since.
    #[must_use]
    pub fn is_away(&self, id: LoopId) -> bool {
        self.of(id).away
    }

    /// Loops that were released, and not taken since.
    #[must_use]
    pub fn count_away(&self) -> usize {
        self.loops.iter().flatten().filter(|of| of.away).count()
    }

    /// The alarm's document, under this daemon's name.
    pub(super) fn signed(&self, document: AlarmDocument) -> AlarmDocument {
        AlarmDocument { daemon: self.settings.daemon.as_deref().map(str::to_owned), ..document }
    }

    /// Puts this daemon's name on what stands in a list from a place on.
    pub(super) fn sign(&self, out: &mut [Event]) {
        let Some(daemon) = &self.settings.daemon else { return };
        for event in out {
            match event {
                Event::Estimate(_, document) => document.daemon = Some(daemon.to_string()),
                Event::Alarm(_, document) => document.daemon = Some(daemon.to_string()),
                Event::GapRequest(request) => request.daemon = Some(daemon.clone()),
                Event::Due { .. } | Event::Request(_) | Event::State(..) | Event::Gap(..) => {}
            }
        }
    }
}
