//! A queue between two threads that reuses its memory. Items are collected in blocks, and the receiver takes a block at a time,
//! so neither end allocates for each item, and the lock is held briefly and seldom by the receiver. The queue is unbounded: the
//! sender limits it by a [`super::queue::Budget`].

use std::collections::VecDeque;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

/// Items in a block.
const BLOCK: usize = 256;
/// Most empty blocks kept: more than wait for a receiver that keeps up.
const SPARE: usize = 64;

struct State<T> {
    full: VecDeque<VecDeque<T>>,
    spare: Vec<VecDeque<T>>,
    /// Whether the receiver sleeps and must be woken.
    sleeps: bool,
    /// Set when the sender is dropped, and when the receiver is.
    ended: bool,
    left: bool,
}

struct Shared<T> {
    state: Mutex<State<T>>,
    wake: Condvar,
    waiting: AtomicUsize,
}

impl<T> Shared<T> {
    fn lock(&self) -> MutexGuard<'_, State<T>> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

/// The sending end; dropping it ends the queue.
pub struct BlockSender<T>(Arc<Shared<T>>);

/// The receiving end, which takes items in order.
pub struct BlockReceiver<T> {
    shared: Arc<Shared<T>>,
    /// The block being taken.
    open: VecDeque<T>,
}

/// Result of an attempt to take an item.
#[derive(Debug, PartialEq, Eq)]
pub enum Received<T> {
    /// The next item.
    Item(T),
    /// No item came in time.
    Nothing,
    /// There is no item, and none will come.
    End,
}

/// Both ends of a queue.
#[must_use]
pub fn queue<T>() -> (BlockSender<T>, BlockReceiver<T>) {
    let state = State { full: VecDeque::new(), spare: Vec::new(), sleeps: false, ended: false, left: false };
    let shared = Arc::new(Shared { state: Mutex::new(state), wake: Condvar::new(), waiting: AtomicUsize::new(0) });
    (BlockSender(shared.clone()), BlockReceiver { shared, open: VecDeque::new() })
}

impl<T> BlockSender<T> {
    /// Appends an item.
    ///
    /// # Errors
    /// The item, if the receiver is gone.
    pub fn put(&self, item: T) -> Result<(), T> {
        let mut state = self.0.lock();
        if state.left {
            return Err(item);
        }
        if state.full.back().is_none_or(|block| block.len() >= BLOCK) {
            let block = state.spare.pop().unwrap_or_else(|| VecDeque::with_capacity(BLOCK));
            state.full.push_back(block);
        }
        if let Some(block) = state.full.back_mut() {
            block.push_back(item);
        }
        self.0.waiting.fetch_add(1, Ordering::Relaxed);
        let sleeps = std::mem::take(&mut state.sleeps);
        drop(state);
        if sleeps {
            self.0.wake.notify_one();
        }
        Ok(())
    }

    /// Number of waiting items.
    #[must_use]
    pub fn waiting(&self) -> usize {
        self.0.waiting.load(Ordering::Relaxed)
    }
}

impl<T> Drop for BlockSender<T> {
    fn drop(&mut self) {
        self.0.lock().ended = true;
        self.0.wake.notify_one();
    }
}

impl<T> BlockReceiver<T> {
    /// The next item, waiting up to `wait` for it.
    pub fn take_within(&mut self, wait: Duration) -> Received<T> {
        if self.open.is_empty() {
            let until = Instant::now() + wait;
            let mut state = self.shared.lock();
            while state.full.is_empty() {
                let left = until.saturating_duration_since(Instant::now());
                if state.ended || left.is_zero() {
                    return if state.ended { Received::End } else { Received::Nothing };
                }
                state.sleeps = true;
                state = self.shared.wake.wait_timeout(state, left).unwrap_or_else(PoisonError::into_inner).0;
                state.sleeps = false;
            }
            let block = state.full.pop_front().unwrap_or_default();
            let taken = std::mem::replace(&mut self.open, block);
            if state.spare.len() < SPARE && taken.capacity() > 0 {
                state.spare.push(taken);
            }
        }
        let Some(item) = self.open.pop_front() else { return Received::Nothing };
        self.shared.waiting.fetch_sub(1, Ordering::Relaxed);
        Received::Item(item)
    }
}

impl<T> Drop for BlockReceiver<T> {
    fn drop(&mut self) {
        let mut state = self.shared.lock();
        state.left = true;
        state.full.clear();
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn items_come_in_their_order_over_many_blocks_and_then_the_end() {
        let (sender, mut receiver) = queue();
        let filling = std::thread::spawn(move || (0..10 * BLOCK).for_each(|k| sender.put(k).unwrap()));
        let mut wanted = 0;
        loop {
            match receiver.take_within(Duration::from_secs(10)) {
                Received::Item(k) => {
                    assert_eq!(k, wanted);
                    wanted += 1;
                }
                Received::Nothing => panic!("nothing came for ten seconds"),
                Received::End => break,
            }
        }
        filling.join().unwrap();
        assert_eq!(wanted, 10 * BLOCK);
    }

    #[test]
    fn blocks_are_used_again() {
        let (sender, mut receiver) = queue();
        let mut places = std::collections::BTreeSet::new();
        for _ in 0..100 {
            (0..BLOCK).for_each(|k| sender.put(k).unwrap());
            assert_eq!(sender.waiting(), BLOCK);
            (0..BLOCK).for_each(|k| assert_eq!(receiver.take_within(Duration::ZERO), Received::Item(k)));
            assert_eq!((receiver.take_within(Duration::ZERO), sender.waiting()), (Received::Nothing, 0));
            places.insert(receiver.open.as_slices().0.as_ptr() as usize);
        }
        assert!(places.len() <= 2, "{} blocks were asked for", places.len());
    }

    #[test]
    fn what_nobody_takes_is_given_back() {
        let (sender, receiver) = queue();
        sender.put(Arc::new(1)).unwrap();
        drop(receiver);
        assert_eq!(sender.put(Arc::new(2)), Err(Arc::new(2)));
    }
}
