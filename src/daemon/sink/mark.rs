//! How far the store of documents is, for the store of states, which must not be ahead of it: a state that outlives a crash
//! says that its alarm was told, so the document must outlive it too.

use std::sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError};

#[derive(Debug, Default)]
struct State {
    handed: u64,
    stored: u64,
    refused: u64,
    why: String,
    is_closed: bool,
}

/// How many documents were handed over, and what has become of them. Copies are the same one.
#[derive(Debug, Clone, Default)]
pub struct Mark(Arc<(Mutex<State>, Condvar)>);

impl State {
    fn of(&self, number: u64) -> Option<Result<(), String>> {
        if number <= self.stored {
            Some(Ok(()))
        } else if self.is_closed || number <= self.refused {
            Some(Err(self.why.clone()))
        } else {
            None
        }
    }
}

impl Mark {
    fn lock(&self) -> MutexGuard<'_, State> {
        self.0.0.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// One more document is handed over; gives its number.
    pub fn hand(&self) -> u64 {
        let mut state = self.lock();
        state.handed += 1;
        state.handed
    }

    /// Number of the newest document.
    #[must_use]
    pub fn handed(&self) -> u64 {
        self.lock().handed
    }

    /// All up to this number are on the disk, or need it no more.
    pub fn store(&self, number: u64) {
        let mut state = self.lock();
        state.stored = state.stored.max(number);
        drop(state);
        self.0.1.notify_all();
    }

    /// The disk refused those up to this number.
    pub fn refuse(&self, number: u64, why: &str) {
        let mut state = self.lock();
        state.refused = state.refused.max(number);
        why.clone_into(&mut state.why);
        drop(state);
        self.0.1.notify_all();
    }

    /// Nothing is stored any more.
    pub fn close(&self) {
        let mut state = self.lock();
        state.is_closed = true;
        if state.why.is_empty() {
            "the store of documents has ended".clone_into(&mut state.why);
        }
        drop(state);
        self.0.1.notify_all();
    }

    /// What has become of the documents up to this number; none while that is open.
    #[must_use]
    pub fn look(&self, number: u64) -> Option<Result<(), String>> {
        self.lock().of(number)
    }

    /// The same, once it is known.
    ///
    /// # Errors
    /// Why they are not on the disk.
    pub fn wait(&self, number: u64) -> Result<(), String> {
        let open = |state: &mut State| state.of(number).is_none();
        let state = self.0.1.wait_while(self.lock(), open).unwrap_or_else(PoisonError::into_inner);
        state.of(number).unwrap_or(Ok(()))
    }
}
