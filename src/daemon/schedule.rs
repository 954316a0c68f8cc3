//! Decides which waiting window gets the next worker, and which one is dropped when too many wait.
//!
//! Windows of all loops end at the same whole multiples of the hop, so thousands come due at once. They are served oldest
//! first; those of the same instant in the order of a hash of their loops' names. Loops take turns: one that asks for many
//! windows gets one for each that the others get (start-time fair queueing with equal shares).
//!
//! Up to [`BURST`] windows wait as they come, so that history played fast is estimated completely. Beyond that each loop holds
//! one window: a newer one takes the older one's place in the queue, which stretches the loop's hop. If there are still too
//! many, the loop that was skipped longest ago is skipped.

use std::cmp::Reverse;
use std::collections::{BTreeSet, HashMap, VecDeque};

use stiction_engine::shard::stable_hash;

/// Number of waiting windows beyond which each loop may hold only one.
pub const BURST: usize = 1024;
/// Most windows that may wait.
pub const LIMIT: usize = 1_000_000;
/// Most bytes that they may take.
pub const LIMIT_BYTES: usize = 512 << 20;

/// One waiting job of a loop.
#[derive(Debug)]
struct Waiting<J> {
    /// Its place in the common queue.
    tag: u64,
    bytes: usize,
    job: J,
}

/// A loop in the schedule.
#[derive(Debug)]
struct Share<J> {
    hash: u64,
    waiting: VecDeque<Waiting<J>>,
    /// Earliest place of its next job.
    next_tag: u64,
    /// When it was last skipped, counted in skips of all loops.
    passed_over: u64,
}

/// Jobs by loop, in the order in which they are to be run.
#[derive(Debug)]
pub struct Schedule<J> {
    loops: HashMap<usize, Share<J>>,
    /// Tag of each loop's first job, with the tie-breakers.
    row: BTreeSet<(u64, u64, usize)>,
    /// Loops by number of jobs held, most first, then by when they were last skipped.
    holders: BTreeSet<(Reverse<usize>, u64, u64, usize)>,
    /// Tag of the last job handed out.
    now: u64,
    skips: u64,
    length: usize,
    bytes: usize,
    limits: [usize; 3],
}

impl<J> Default for Schedule<J> {
    fn default() -> Self {
        Self::new([BURST, LIMIT, LIMIT_BYTES])
    }
}

impl<J> Schedule<J> {
    /// A schedule with limits: windows kept in order of arrival, windows in total, bytes.
    #[must_use]
    pub fn new(limits: [usize; 3]) -> Self {
        Self {
            loops: HashMap::new(),
            row: BTreeSet::new(),
            holders: BTreeSet::new(),
            now: 0,
            skips: 0,
            length: 0,
            bytes: 0,
            limits,
        }
    }

    /// Number of waiting jobs.
    #[must_use]
    pub const fn waiting(&self) -> usize {
        self.length
    }

    /// Bytes of the waiting jobs.
    #[must_use]
    pub const fn bytes(&self) -> usize {
        self.bytes
    }

    /// Number of loops in it.
    #[cfg(test)]
    #[must_use]
    pub fn count(&self) -> usize {
        self.loops.len()
    }

    /// Forgets a loop with no waiting job.
    pub fn forget(&mut self, of: usize) {
        if self.loops.get(&of).is_some_and(|share| share.waiting.is_empty()) {
            self.loops.remove(&of);
        }
    }

    /// Adds a job; returns those that must be dropped to make room.
    pub fn push(&mut self, of: usize, name: &str, bytes: usize, job: J) -> Vec<J> {
        let (now, skips) = (self.now, self.skips);
        self.leave(of);
        let share = self.loops.entry(of).or_insert_with(|| Share {
            hash: stable_hash(name),
            waiting: VecDeque::new(),
            next_tag: 0,
            passed_over: skips,
        });
        let tag = share.next_tag.max(now);
        share.next_tag = tag + 1;
        share.waiting.push_back(Waiting { tag, bytes, job });
        self.enter(of);
        self.length += 1;
        self.bytes += bytes;
        let [burst, limit, limit_bytes] = self.limits;
        let mut given_up = Vec::new();
        while let Some((Reverse(held), _, _, holder)) = self.holders.first().copied() {
            let too_many = self.length > limit || self.bytes > limit_bytes;
            if !(too_many || (self.length > burst && held > 1)) {
                break;
            }
            given_up.extend(self.evict_oldest(holder));
        }
        given_up
    }

    /// The job whose turn it is.
    pub fn pop(&mut self) -> Option<J> {
        let (tag, _, of) = self.row.first().copied()?;
        self.leave(of);
        let taken = self.loops.get_mut(&of).and_then(|share| share.waiting.pop_front());
        self.enter(of);
        let taken = taken?;
        self.now = tag;
        self.length -= 1;
        self.bytes -= taken.bytes;
        Some(taken.job)
    }

    /// Drops a loop's oldest job; the loop's next job takes its place in the queue.
    fn evict_oldest(&mut self, of: usize) -> Option<J> {
        self.leave(of);
        self.skips += 1;
        let share = self.loops.get_mut(&of)?;
        let taken = share.waiting.pop_front()?;
        share.passed_over = self.skips;
        let mut tag = taken.tag;
        for waiting in &mut share.waiting {
            std::mem::swap(&mut tag, &mut waiting.tag);
        }
        share.next_tag = tag;
        self.enter(of);
        self.length -= 1;
        self.bytes -= taken.bytes;
        Some(taken.job)
    }

    fn leave(&mut self, of: usize) {
        if let Some((row, holder)) = self.loops.get(&of).and_then(|share| keys(of, share)) {
            self.row.remove(&row);
            self.holders.remove(&holder);
        }
    }

    fn enter(&mut self, of: usize) {
        if let Some((row, holder)) = self.loops.get(&of).and_then(|share| keys(of, share)) {
            self.row.insert(row);
            self.holders.insert(holder);
        }
    }
}

type Keys = ((u64, u64, usize), (Reverse<usize>, u64, u64, usize));

/// A loop's keys in both orders, while it holds any job.
fn keys<J>(of: usize, share: &Share<J>) -> Option<Keys> {
    let first = share.waiting.front()?;
    Some(((first.tag, share.hash, of), (Reverse(share.waiting.len()), share.passed_over, share.hash, of)))
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    /// Loop and window.
    type Job = (usize, u64);

    fn push(schedule: &mut Schedule<Job>, of: usize, window: u64) -> Vec<Job> {
        schedule.push(of, &format!("L{of}"), 10, (of, window))
    }

    #[test]
    fn all_loops_get_their_turn_when_all_windows_come_due_at_once() {
        // 3,000 loops, and workers for a third of them in each hop: within three hops each loop has had its fit.
        let mut schedule = Schedule::default();
        let mut fits = vec![0; 3000];
        let mut skipped = 0;
        for window in 0..9 {
            for of in 0..3000 {
                skipped += push(&mut schedule, of, window).len();
            }
            for _ in 0..1000 {
                fits[schedule.pop().unwrap().0] += 1;
            }
        }
        assert!(fits.iter().all(|n| *n == 3), "{:?} to {:?}", fits.iter().min(), fits.iter().max());
        assert_eq!(skipped + 9000 + schedule.waiting(), 27_000);
        assert!(schedule.waiting() <= 3000, "each holds one");
    }

    #[test]
    fn a_hard_limit_passes_loops_over_in_turn() {
        let mut schedule = Schedule::new([10, 100, usize::MAX]);
        let mut passed = vec![0; 200];
        for window in 0..6 {
            for of in 0..200 {
                push(&mut schedule, of, window).iter().for_each(|(of, _)| passed[*of] += 1);
            }
            while schedule.pop().is_some() {}
        }
        let (least, most) = (passed.iter().min().unwrap(), passed.iter().max().unwrap());
        // A new loop counts as just skipped, so the first round is not quite even.
        assert!(most - least <= 2, "{least} to {most}");
    }

    #[test]
    fn a_loop_with_racing_stamps_takes_no_more_than_its_share() {
        let mut schedule = Schedule::default();
        let mut served = [0; 6];
        let mut lost_by_others = 0;
        // Loop 0 requests a hundred windows for each one of the others.
        for window in 0..100 {
            for k in 0..100 {
                lost_by_others += push(&mut schedule, 0, 100 * window + k).iter().filter(|(of, _)| *of != 0).count();
            }
            for of in 1..6 {
                lost_by_others += push(&mut schedule, of, window).iter().filter(|(of, _)| *of != 0).count();
            }
            for _ in 0..8 {
                served[schedule.pop().unwrap().0] += 1;
            }
        }
        assert_eq!((lost_by_others, &served[1..]), (0, &[100; 5][..]));
    }

    #[test]
    fn history_played_fast_is_kept_whole_and_in_order() {
        let mut schedule = Schedule::default();
        for window in 0..BURST as u64 {
            assert!(push(&mut schedule, 7, window).is_empty());
        }
        let order: Vec<u64> = std::iter::from_fn(|| schedule.pop()).map(|(_, window)| window).collect();
        assert!(order.iter().copied().eq(0..BURST as u64));
    }

    proptest! {
        #[test]
        fn nothing_is_lost_and_limits_hold(steps in proptest::collection::vec((0_usize..9, 0_usize..40), 1..300)) {
            let mut schedule = Schedule::new([20, 30, 500]);
            let (mut inside, mut k) = (BTreeSet::new(), 0);
            for (of, bytes) in steps {
                if of == 8 {
                    if let Some(job) = schedule.pop() {
                        prop_assert!(inside.remove(&job));
                    }
                } else {
                    k += 1;
                    inside.insert((of, k));
                    for job in schedule.push(of, &format!("L{of}"), bytes, (of, k)) {
                        prop_assert!(inside.remove(&job));
                    }
                }
                prop_assert!(schedule.waiting() <= 30 && schedule.bytes() <= 500);
                prop_assert_eq!(schedule.waiting(), inside.len());
            }
            let rest: BTreeSet<Job> = std::iter::from_fn(|| schedule.pop()).collect();
            prop_assert_eq!(rest, inside);
            prop_assert_eq!(schedule.bytes(), 0);
        }
    }
}
