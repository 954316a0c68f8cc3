//! Columns of a loop's history: growing ring buffers, times in four bytes if they fit, and mostly absent values.

use std::collections::VecDeque;

use crate::core::units::NS_PER_S;

/// Unit of a step: a millisecond, ns.
const NS_PER_MS: i64 = NS_PER_S / 1000;
/// Increment for a small ring.
const LEAST_GROWTH: usize = 8;

/// Adds a value to a ring of at most `most` values; it grows by a quarter, up to that limit.
pub(super) fn put<T>(ring: &mut VecDeque<T>, value: T, most: usize) {
    if ring.len() == ring.capacity() {
        let room = most.saturating_sub(ring.len()).max(1);
        ring.reserve_exact((ring.len() / 4).max(LEAST_GROWTH).min(room));
    }
    ring.push_back(value);
}

/// Memory of a ring, bytes.
pub(super) fn bytes<T>(ring: &VecDeque<T>) -> usize {
    ring.capacity() * size_of::<T>()
}

/// Increasing timestamps: whole milliseconds from a base while they fit (49 days), else nanoseconds.
#[derive(Debug, Clone, Default)]
pub(super) struct Times {
    base_ns: i64,
    steps: VecDeque<u32>,
    /// Used alone once a timestamp does not fit.
    whole: VecDeque<i64>,
}

impl Times {
    pub fn len(&self) -> usize {
        self.steps.len() + self.whole.len()
    }

    pub fn get(&self, place: usize) -> Option<i64> {
        if self.whole.is_empty() {
            return self.steps.get(place).map(|step| self.stamp(*step));
        }
        self.whole.get(place).copied()
    }

    pub fn back(&self) -> Option<i64> {
        self.get(self.len().checked_sub(1)?)
    }

    /// Index of the first timestamp at or after a time.
    pub fn place_at(&self, t_ns: i64) -> usize {
        if self.whole.is_empty() {
            return self.steps.partition_point(|step| self.stamp(*step) < t_ns);
        }
        self.whole.partition_point(|t| *t < t_ns)
    }

    pub fn push(&mut self, t_ns: i64, most: usize) {
        if self.len() == 0 {
            self.base_ns = t_ns;
        }
        if self.whole.is_empty() {
            if let Some(step) = self.step(t_ns).or_else(|| self.step_after_rebase(t_ns)) {
                return put(&mut self.steps, step, most);
            }
            self.whole = self.steps.iter().map(|step| self.stamp(*step)).collect();
            self.steps = VecDeque::new();
        }
        put(&mut self.whole, t_ns, most);
    }

    pub fn pop_front(&mut self) {
        if self.whole.is_empty() {
            self.steps.pop_front();
        } else {
            self.whole.pop_front();
        }
    }

    pub fn bytes(&self) -> usize {
        bytes(&self.steps) + bytes(&self.whole)
    }

    fn stamp(&self, step: u32) -> i64 {
        self.base_ns.saturating_add(i64::from(step) * NS_PER_MS)
    }

    fn step(&self, t_ns: i64) -> Option<u32> {
        let past = t_ns.checked_sub(self.base_ns)?;
        (past % NS_PER_MS == 0).then(|| u32::try_from(past / NS_PER_MS).ok()).flatten()
    }

    /// As the step above, after moving the base to the oldest timestamp.
    fn step_after_rebase(&mut self, t_ns: i64) -> Option<u32> {
        let oldest = *self.steps.front()?;
        if oldest == 0 {
            return None;
        }
        self.base_ns = self.stamp(oldest);
        self.steps.iter_mut().for_each(|step| *step -= oldest);
        self.step(t_ns)
    }
}

/// A column of mostly absent values: it uses no memory before the first value.
#[derive(Debug, Clone)]
pub(super) struct Sparse<T> {
    values: VecDeque<T>,
    none: T,
}

impl<T: Copy> Sparse<T> {
    /// An empty column, and its placeholder for absent values.
    pub const fn new(none: T) -> Self {
        Self { values: VecDeque::new(), none }
    }

    /// Adds the value after `before` others.
    pub fn push(&mut self, value: Option<T>, before: usize, most: usize) {
        if self.values.is_empty() {
            if value.is_none() {
                return;
            }
            self.values.extend(std::iter::repeat_n(self.none, before));
        }
        put(&mut self.values, value.unwrap_or(self.none), most);
    }

    pub fn get(&self, place: usize) -> T {
        self.values.get(place).copied().unwrap_or(self.none)
    }

    pub fn pop_front(&mut self) {
        self.values.pop_front();
    }

    pub fn bytes(&self) -> usize {
        bytes(&self.values)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn rings_grow_by_need_and_not_beyond_it() {
        let mut ring = VecDeque::new();
        for k in 0..100 {
            put(&mut ring, k, 100);
            assert!(ring.capacity() <= 100 && ring.capacity() <= ring.len() + (ring.len() / 4).max(LEAST_GROWTH));
        }
    }

    #[test]
    fn stamps_of_whole_milliseconds_take_four_bytes_for_ever() {
        let mut times = Times::default();
        // Ten thousand samples at ten minutes span 69 days: more than a step covers from the first base.
        for k in 0..10_000_i64 {
            if times.len() == 500 {
                times.pop_front();
            }
            times.push(7 + k * 600_000 * NS_PER_MS, 500);
        }
        assert_eq!((times.len(), times.bytes()), (500, 2000));
        assert_eq!(times.back(), Some(7 + 9_999 * 600_000 * NS_PER_MS));
    }

    proptest! {
        #[test]
        fn stamps_read_back_exactly(
            steps in proptest::collection::vec(prop_oneof![
                8 => (1_i64..100).prop_map(|k| k * NS_PER_MS),
                1 => 1_i64..1_000_000_000,
                1 => Just(40 * 86_400_000 * NS_PER_MS),
            ], 1..200),
            held in 1_usize..50, start in -1_000_000_000_000_000_000_i64..1_000_000_000_000_000_000
        ) {
            let (mut times, mut plain, mut t_ns) = (Times::default(), VecDeque::new(), start);
            for step in steps {
                t_ns += step;
                if plain.len() == held {
                    plain.pop_front();
                    times.pop_front();
                }
                plain.push_back(t_ns);
                times.push(t_ns, held);
                prop_assert_eq!(times.len(), plain.len());
                prop_assert!(plain.iter().enumerate().all(|(k, t)| times.get(k) == Some(*t)));
                prop_assert_eq!(times.place_at(t_ns), plain.len() - 1);
            }
        }

        #[test]
        fn absent_values_take_nothing_and_the_others_read_back(
            values in proptest::collection::vec(proptest::option::weighted(0.1, 1_u16..9), 1..100), held in 1_usize..20
        ) {
            let (mut column, mut plain) = (Sparse::new(0_u16), VecDeque::new());
            for value in &values {
                if plain.len() == held {
                    plain.pop_front();
                    column.pop_front();
                }
                column.push(*value, plain.len(), held);
                plain.push_back(value.unwrap_or(0));
                prop_assert!(plain.iter().enumerate().all(|(k, v)| column.get(k) == *v));
            }
            prop_assert!(values.iter().any(Option::is_some) || column.bytes() == 0);
        }
    }
}
