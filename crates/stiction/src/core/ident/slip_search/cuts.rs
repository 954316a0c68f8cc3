//! Searches of cuts from later in the record: the right slips may be easier to find there than at its beginning.

use super::candidate::Candidate;
use super::local_search::{STEMS, neighbours, random_steps};
use super::problem::Problem;
use super::stages::{CARRIED, Request, Search};
use crate::core::ident::class::Class;
use crate::core::ident::random::seeded_rng;
use rand_chacha::ChaCha8Rng;
use std::ops::Range;

/// Rounds through a candidate's neighbours on the whole record.
const ROUNDS: usize = 6;
/// Purpose of the random draws on the whole record; the number of the cut is added.
const PURPOSE: u64 = 40;

impl Search<'_, '_> {
    /// Whether searching cuts is worthwhile: every point counts, and friction explains part of the error.
    pub(super) fn shows_friction(&mut self) -> bool {
        let least = self.best_sse();
        self.problem.counted.is_empty() && least <= (1.0 - self.settings.worth_a_round) * self.without(Class::First)
    }

    /// Searches cuts until a candidate leaves only noise on the whole record; returns whether one does.
    pub(super) fn search_cuts(&mut self) -> bool {
        let cuts = self.settings.cuts;
        let n = self.problem.points();
        let share = |share: f64| (share * n as f64) as usize;
        self.found.is_noise = (1..=cuts.count).any(|number| {
            let from = share(cuts.apart * number as f64);
            self.search_cut(number as u64, from..from + share(cuts.length))
        });
        self.found.is_noise
    }

    /// Searches one cut. If the result leaves only noise, continues on the whole record; returns whether it leaves only noise
    /// there, too.
    fn search_cut(&mut self, number: u64, points: Range<usize>) -> bool {
        let cut = self.problem.normalised.cut(points);
        let problem = Problem::new(&cut, self.problem.sign);
        let mut settings = self.settings.clone();
        settings.rounds.truncate(1);
        let request = Request { seed: self.request.seed.wrapping_add(number), rival: f64::INFINITY, ..*self.request };
        let (of_cut, search) = Search::new(&problem, &request, &settings).run();
        self.found.evaluations += search.evaluations();
        let mut rng = seeded_rng(self.request.seed, PURPOSE + number);
        of_cut.is_noise && of_cut.best.iter().any(|candidate| self.continue_on_whole(candidate, &mut rng))
    }

    /// Continues a cut's candidate on the whole record, where its first slip differs; returns whether it leaves only noise.
    fn continue_on_whole(&mut self, of_cut: &Candidate, rng: &mut ChaCha8Rng) -> bool {
        let near = self.settings.near;
        let (evaluator, view) = (&mut self.whole, &mut self.plain);
        (evaluator.class, evaluator.law) = (of_cut.class, of_cut.law);
        let Candidate { s, j, fit, .. } = *of_cut;
        let starts = self.problem.starts(0.5 * (s + j), &STEMS);
        let fits = starts.into_iter().filter_map(|start| evaluator.fit(view, [s, j], start, &fit, f64::INFINITY));
        let mut held: Vec<Candidate> = fits.filter(|c| c.fit.gain != 0.0).collect();
        held.sort_by(|a, b| a.sse().total_cmp(&b.sse()));
        held.truncate(self.settings.cuts.starts);
        for c in &mut held {
            *c = random_steps(evaluator, view, *c, CARRIED, near, rng);
            *c = neighbours(evaluator, view, *c, ROUNDS, near);
        }
        self.found.seen.extend(&held);
        let Some(best) = held.into_iter().min_by(|a, b| a.sse().total_cmp(&b.sse())) else { return false };
        self.keep(best);
        self.is_noise(&best)
    }
}
