//! All cores, a progress bar and a clock for a search that knows none of them.

use std::sync::atomic::{AtomicUsize, Ordering};
use std::time::{Duration, Instant};

use indicatif::{ProgressBar, ProgressStyle};

use stiction::gap::{Ask, Executor};

/// A team of threads; ends the search on request or when its time is up.
pub(super) struct Team<'a> {
    cores: usize,
    bar: ProgressBar,
    until: Option<Instant>,
    go_on: &'a (dyn Fn() -> bool + Sync),
}

impl<'a> Team<'a> {
    /// A team for one search of at most `time`, as long as `go_on` says so.
    pub fn new(name: &str, ask: &Ask, time: Option<Duration>, go_on: &'a (dyn Fn() -> bool + Sync)) -> Self {
        let bar = ProgressBar::new(ask.budget_evaluations);
        if let Ok(style) = ProgressStyle::with_template("{wide_msg} {bar:30} {percent:>3} %") {
            bar.set_style(style);
        }
        bar.set_message(name.to_owned());
        let cores = std::thread::available_parallelism().map_or(1, std::num::NonZero::get);
        Self { cores, bar, until: time.map(|t| Instant::now() + t), go_on }
    }

    /// Takes the bar away.
    pub fn finish(&self) {
        self.bar.finish_and_clear();
    }
}

impl Executor for Team<'_> {
    fn run(&self, jobs: usize, job: &(dyn Fn(usize) + Sync)) {
        let next = AtomicUsize::new(0);
        let share = || {
            loop {
                let index = next.fetch_add(1, Ordering::Relaxed);
                if index >= jobs {
                    return;
                }
                job(index);
            }
        };
        std::thread::scope(|scope| {
            // This thread works too.
            for _ in 1..self.cores.min(jobs) {
                scope.spawn(share);
            }
            share();
        });
    }

    fn tick(&self, done: u64) -> bool {
        self.bar.set_position(done);
        (self.go_on)() && self.until.is_none_or(|until| Instant::now() < until)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::sync::atomic::{AtomicBool, AtomicU64};

    #[test]
    fn every_job_is_done_once_and_the_flag_ends_the_search() {
        let stop = AtomicBool::new(false);
        let go_on = || !stop.load(Ordering::Relaxed);
        let team = Team::new("a", &Ask::default(), None, &go_on);
        let counts: Vec<AtomicU64> = (0..100).map(|_| AtomicU64::new(0)).collect();
        team.run(100, &|i| {
            counts[i].fetch_add(1, Ordering::Relaxed);
        });
        assert!(counts.iter().all(|c| c.load(Ordering::Relaxed) == 1));
        assert!(team.tick(1));
        stop.store(true, Ordering::Relaxed);
        assert!(!team.tick(2));
        let late = Team::new("b", &Ask::default(), Some(Duration::ZERO), &|| true);
        assert!(!late.tick(0));
    }
}
