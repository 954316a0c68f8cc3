//! Bounded first-in first-out queue of values waiting for the bus; drops the oldest when full.

use std::collections::VecDeque;
use std::sync::{Arc, Mutex, PoisonError};

use tokio::sync::Notify;

use super::values::Reading;

/// A value and its key.
pub type Item = (Arc<str>, Reading);

/// The queue between server and bus.
pub struct Hold {
    inner: Mutex<(VecDeque<Item>, u64)>,
    filled: Notify,
    limit: usize,
}

impl Hold {
    /// A queue for at most this many values.
    pub fn new(limit: usize) -> Self {
        Self { inner: Mutex::default(), filled: Notify::new(), limit: limit.max(1) }
    }

    fn with<T>(&self, what: impl FnOnce(&mut (VecDeque<Item>, u64)) -> T) -> T {
        what(&mut self.inner.lock().unwrap_or_else(PoisonError::into_inner))
    }

    /// Adds a value.
    pub fn push(&self, item: Item) {
        self.with(|(items, dropped)| {
            if items.len() >= self.limit {
                items.pop_front();
                *dropped += 1;
            }
            items.push_back(item);
        });
        self.filled.notify_one();
    }

    /// Waits for the oldest value.
    pub async fn pop(&self) -> Item {
        loop {
            if let Some(item) = self.with(|(items, _)| items.pop_front()) {
                return item;
            }
            self.filled.notified().await;
        }
    }

    /// Number of dropped values.
    pub fn dropped(&self) -> u64 {
        self.with(|(_, dropped)| *dropped)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_oldest_is_dropped_and_counted() {
        let hold = Hold::new(3);
        for t_ns in 0..5 {
            hold.push((Arc::from("k"), Reading { t_ns, value: None, status: 0 }));
        }
        assert_eq!(hold.dropped(), 2);
        let runtime = tokio::runtime::Builder::new_current_thread().build().unwrap();
        let left: Vec<i64> = (0..3).map(|_| runtime.block_on(hold.pop()).1.t_ns).collect();
        assert_eq!(left, [2, 3, 4]);
    }
}
