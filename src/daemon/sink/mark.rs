//! Progress of the document store, which the state store must not overtake: a state that survives a crash implies that its
//! alarm was sent, so the document must survive too.

use std::sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError};

#[derive(Debug, Default)]
struct State {
    handed: u64,
    stored: u64,
    refused: u64,
    why: String,
    is_closed: bool,
}

/// Counts the documents handed over, and what happened to them. Clones share one count.
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

    /// Hands over one more document; returns its number.
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

    /// All documents up to this number are on disk or no longer need to be.
    pub fn store(&self, number: u64) {
        let mut state = self.lock();
        state.stored = state.stored.max(number);
        drop(state);
        self.0.1.notify_all();
    }

    /// The disk refused the documents up to this number.
    pub fn refuse(&self, number: u64, why: &str) {
        let mut state = self.lock();
        state.refused = state.refused.max(number);
        why.clone_into(&mut state.why);
        drop(state);
        self.0.1.notify_all();
    }

    /// No further document will be stored.
    pub fn close(&self) {
        let mut state = self.lock();
        state.is_closed = true;
        if state.why.is_empty() {
            "the store of documents has ended".clone_into(&mut state.why);
        }
        drop(state);
        self.0.1.notify_all();
    }

    /// What happened to the documents up to this number; `None` while that is undecided.
    #[must_use]
    pub fn look(&self, number: u64) -> Option<Result<(), String>> {
        self.lock().of(number)
    }

    /// The same, waiting until it is decided.
    ///
    /// # Errors
    /// Why they are not on disk.
    pub fn wait(&self, number: u64) -> Result<(), String> {
        let open = |state: &mut State| state.of(number).is_none();
        let state = self.0.1.wait_while(self.lock(), open).unwrap_or_else(PoisonError::into_inner);
        state.of(number).unwrap_or(Ok(()))
    }
}
