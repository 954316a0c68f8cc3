//! Distributes work over all cores, reports its progress, and lets the caller end it early. Used by commands and the page.

use std::collections::BTreeMap;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::time::{Duration, Instant};

use stiction::core::gap::{Executor, GapOptions};

/// Receives progress, and may end the work.
pub trait Watch: Sync {
    /// Reports that `done` evaluations (or pieces) of at most `of` are finished, with the current step in words.
    fn reached(&self, done: u64, of: u64, words: &str);

    /// Whether to continue.
    fn go_on(&self) -> bool {
        true
    }
}

/// Cores that this program may use, at least one.
#[must_use]
pub fn cores() -> usize {
    std::thread::available_parallelism().map_or(1, std::num::NonZero::get)
}

/// Runs `job(0)` to `job(jobs - 1)` on all cores, the calling thread included, and returns when all are done.
pub fn share(jobs: usize, job: &(dyn Fn(usize) + Sync)) {
    let next = AtomicUsize::new(0);
    let work = || {
        loop {
            let index = next.fetch_add(1, Ordering::Relaxed);
            if index >= jobs {
                return;
            }
            job(index);
        }
    };
    std::thread::scope(|scope| {
        for _ in 1..cores().min(jobs) {
            scope.spawn(work);
        }
        work();
    });
}

/// Runs `work` on each item; `take` gets each answer as soon as all earlier ones are there. No further item is started once
/// `go_on` returns false or `take` fails; answers may then be missing in between.
///
/// # Errors
/// The first error of `take`.
pub fn in_order<T: Sync, R: Send, E>(
    items: &[T],
    go_on: &(dyn Fn() -> bool + Sync),
    work: impl Fn(&T) -> R + Sync,
    mut take: impl FnMut(R) -> Result<(), E>,
) -> Result<(), E> {
    let next = AtomicUsize::new(0);
    let (send, answers) = crossbeam_channel::unbounded();
    let share = |send: crossbeam_channel::Sender<(usize, R)>| {
        while go_on() {
            let index = next.fetch_add(1, Ordering::Relaxed);
            let Some(item) = items.get(index) else { break };
            if send.send((index, work(item))).is_err() {
                break;
            }
        }
    };
    std::thread::scope(|scope| {
        let share = &share;
        for send in std::iter::repeat_n(send, cores().min(items.len().max(1))) {
            scope.spawn(move || share(send));
        }
        let mut early = BTreeMap::new();
        let mut wanted = 0;
        for (index, answer) in &answers {
            early.insert(index, answer);
            while let Some(answer) = early.remove(&wanted) {
                wanted += 1;
                if let Err(error) = take(answer) {
                    // Stop the other threads, since nobody takes their answers.
                    next.store(items.len(), Ordering::Relaxed);
                    return Err(error);
                }
            }
        }
        early.into_values().try_for_each(&mut take)
    })
}

/// Provides cores and a clock to a search that has access to neither.
pub struct Team<'a> {
    watch: &'a dyn Watch,
    limit: u64,
    until: Option<Instant>,
}

impl<'a> Team<'a> {
    /// For one search of at most `time`, while `watch` lets it continue.
    #[must_use]
    pub fn new(watch: &'a dyn Watch, options: &GapOptions, time: Option<Duration>) -> Self {
        Self { watch, limit: options.budget_evaluations, until: time.map(|t| Instant::now() + t) }
    }
}

impl Executor for Team<'_> {
    fn run(&self, jobs: usize, job: &(dyn Fn(usize) + Sync)) {
        share(jobs, job);
    }

    fn tick(&self, done: u64) -> bool {
        self.watch.reached(done, self.limit, "");
        self.watch.go_on() && self.until.is_none_or(|until| Instant::now() < until)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::sync::atomic::{AtomicBool, AtomicU64};

    #[derive(Default)]
    struct Flag {
        stop: AtomicBool,
        done: AtomicU64,
    }

    impl Watch for Flag {
        fn reached(&self, done: u64, of: u64, _: &str) {
            assert!(done <= of);
            self.done.store(done, Ordering::Relaxed);
        }

        fn go_on(&self) -> bool {
            !self.stop.load(Ordering::Relaxed)
        }
    }

    #[test]
    fn every_job_is_done_once_and_the_flag_ends_the_search() {
        let flag = Flag::default();
        let team = Team::new(&flag, &GapOptions::default(), None);
        let counts: Vec<AtomicU64> = (0..100).map(|_| AtomicU64::new(0)).collect();
        team.run(100, &|i| {
            counts[i].fetch_add(1, Ordering::Relaxed);
        });
        assert!(counts.iter().all(|c| c.load(Ordering::Relaxed) == 1));
        assert!(team.tick(1));
        flag.stop.store(true, Ordering::Relaxed);
        assert!(!team.tick(2));
        assert_eq!(flag.done.load(Ordering::Relaxed), 2);
        let late = Team::new(&flag, &GapOptions::default(), Some(Duration::ZERO));
        assert!(!late.tick(0));
    }

    #[test]
    fn answers_come_in_the_items_order_until_somebody_says_no() {
        let items: Vec<u64> = (0..50).collect();
        let slow_first = |k: &u64| {
            std::thread::sleep(Duration::from_millis(u64::from(*k == 0) * 20));
            *k
        };
        let mut got = Vec::new();
        let kept: Result<(), ()> = in_order(&items, &|| true, slow_first, |k| {
            got.push(k);
            Ok(())
        });
        assert_eq!((kept, got), (Ok(()), items.clone()));
        let third = in_order(&items, &|| true, slow_first, |k| if k < 3 { Ok(()) } else { Err(k) });
        assert_eq!(third, Err(3));
        let none: Result<(), u64> = in_order(&items, &|| false, slow_first, Err);
        assert_eq!(none, Ok(()));
    }
}
