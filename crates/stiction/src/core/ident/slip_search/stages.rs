//! Stages of the search: coarse scan of a part of the record, local search there, carrying the best to the whole record and
//! testing it; rounds with new random draws while the test fails and the rounds do not agree.

use rand_chacha::ChaCha8Rng;

use super::candidate::{Candidate, apart};
use super::classes::{FAR_ALONG, allowed, choose_class, index_of, suited};
use super::evaluator::Evaluator;
use super::local_search::{along_cells, along_ridge, neighbours, random_steps};
use super::part::{LawRound, Part, frictionless};
use super::problem::Problem;
use super::read::{self, Reading};
use super::scan::Scan;
use super::settings::{RoundSettings, SearchSettings};
use crate::core::ident::choice::ModelChoice;
use crate::core::ident::class::Class;
use crate::core::ident::evaluator::View;
use crate::core::ident::random::seeded_rng;
use crate::core::ident::residual::{self, Whiteness};
use crate::core::signal::stats;
use crate::core::sim::slips::Law;
use serde::Serialize;

/// Share of PV's variance below which the residual is rounding, whatever it looks like.
const ROUNDING: f64 = 1e-9;
/// Lag-1 autocorrelation from which a residual is not white, without further tests.
const COLOURED: f64 = 0.12;
/// Random steps on the whole record for candidates from the part.
pub(super) const CARRIED: usize = 60;
/// Random steps on the way there, at each length.
const ON_THE_WAY: usize = 24;
/// Fewer moves than this are few.
const SELDOM: usize = 40;
/// The part that is searched first if the process integrates: the error of wrong slips accumulates there.
const SHORT_PART: [f64; 3] = [0.1, 3.0, 12.0];
/// Filters that replace one that leaves mostly noise, and the share of noise from which they do.
const WEAKER: [f64; 3] = [0.9, 0.7, 0.4];
const MOST_NOISE: f64 = 0.3;
/// Share of the error without friction from which no friction is visible in the part.
const FAINT_IN_PART: f64 = 0.6;

/// Parameters of a search in addition to its problem.
pub struct Request<'r> {
    /// Laws, in the order in which they are searched.
    pub laws: &'r [Law],
    /// Classes of process that are allowed.
    pub model: ModelChoice,
    /// Step of the coarse scan's grid, % of OP's span.
    pub fineness_pct: f64,
    /// Seed.
    pub seed: u64,
    /// Error of another explanation (the other sign of the gain) from which this search is given up.
    pub rival: f64,
}

/// Why a search ended.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(rename_all = "snake_case")]
pub enum Ended {
    /// The best model leaves nothing but noise.
    Noise,
    /// No friction shows.
    NoFriction,
    /// Rounds agree: another one gained next to nothing.
    Agreement,
    /// Another explanation is far better.
    Behind,
    /// All rounds were made.
    Complete,
}

/// Result of a search.
#[derive(Debug, Clone)]
pub struct Found {
    /// The best candidate of each law that was searched, by the plain error on the whole record, best first.
    pub best: Vec<Candidate>,
    /// Other candidates that were found, by the plain error or that of a part: rivals of the best.
    pub seen: Vec<Candidate>,
    /// The coarse scans' candidates, before any local search: they may include the right slips if the error prefers others.
    pub scanned: Vec<Candidate>,
    /// Whether the best candidate leaves only noise.
    pub is_noise: bool,
    /// Error models and valve signals computed.
    pub evaluations: u64,
    /// Rounds made.
    pub rounds: usize,
    /// Why the search ended.
    pub ended: Ended,
}

/// One search.
pub struct Search<'s, 'a> {
    pub(super) problem: &'a Problem<'a>,
    pub(super) request: &'s Request<'s>,
    pub(super) settings: &'s SearchSettings,
    pub(super) plain: View,
    pub(super) whole: Evaluator<'a>,
    without: [Option<f64>; 4],
    pub(super) found: Found,
    law_best: [f64; 2],
    /// Standard deviation of PV's white noise.
    noise_sd: f64,
    /// Whether the last round found friction in the part that is not visible on the whole record.
    shows_in_part: bool,
    /// Bands read from PV's kinks, once requested.
    readings: Option<Vec<Reading>>,
}

impl<'s, 'a> Search<'s, 'a> {
    /// A search without results yet.
    #[must_use]
    pub(crate) fn new(problem: &'a Problem<'a>, request: &'s Request<'s>, settings: &'s SearchSettings) -> Self {
        let points = problem.points();
        let found = Found {
            best: Vec::new(),
            seen: Vec::new(),
            scanned: Vec::new(),
            is_noise: false,
            evaluations: 0,
            rounds: 0,
            ended: Ended::Complete,
        };
        Self {
            problem,
            request,
            settings,
            plain: problem.view(0.0, points),
            whole: Evaluator::new(problem, Law::He, Class::First, points),
            without: [None; 4],
            found,
            law_best: [f64::INFINITY; 2],
            noise_sd: stats::noise_sd(problem.pv()),
            shows_in_part: false,
            readings: None,
        }
    }

    /// Evaluator and plain view of the whole record.
    pub(crate) fn whole(&mut self) -> (&mut Evaluator<'a>, &mut View) {
        (&mut self.whole, &mut self.plain)
    }

    /// Error models and valve signals computed so far.
    #[must_use]
    pub(crate) fn evaluations(&self) -> u64 {
        self.found.evaluations + self.whole.evaluations
    }

    /// Least error found so far.
    pub(super) fn best_sse(&self) -> f64 {
        self.law_best.into_iter().fold(f64::INFINITY, f64::min)
    }

    /// Runs all rounds.
    #[must_use]
    pub(crate) fn run(mut self) -> (Found, Self) {
        let mut agreeing = 0;
        for (number, round) in self.settings.rounds.iter().enumerate() {
            let before = self.best_sse();
            self.found.rounds = number + 1;
            if number == 1 && !self.found.is_noise && self.shows_friction() && self.search_cuts() {
                self.found.ended = Ended::Noise;
                break;
            }
            let ended = self.round(number, round);
            let best = self.best_sse();
            agreeing = if best > (1.0 - self.settings.gain) * before { agreeing + 1 } else { 0 };
            if self.found.is_noise {
                self.found.ended = Ended::Noise;
                if ended == Some(Ended::Noise) && self.stem_turns_seldom() && agreeing < self.settings.agreeing {
                    continue;
                }
                break;
            }
            if let Some(ended) = ended {
                self.found.ended = ended;
                break;
            }
            let nothing = self.without(Class::First).min(self.best().map_or(f64::INFINITY, |c| self.without(c.class)));
            // One filter of the error may miss what another shows.
            if number >= 1 && best > (1.0 - self.settings.worth_a_round) * nothing && !self.shows_in_part {
                self.found.ended = Ended::NoFriction;
                break;
            }
            // If much is left, the law does not fit, and another round would find the same.
            let is_much = best > self.settings.much * nothing && !self.shows_in_part;
            let enough = if is_much { 1 } else { self.settings.agreeing };
            if agreeing >= enough {
                self.found.ended = Ended::Agreement;
                break;
            }
        }
        let mut found = self.found.clone();
        found.best.sort_by(|a, b| a.sse().total_cmp(&b.sse()));
        (found, self)
    }

    /// Whether the stem reverses so seldom that several pairs of bands can leave only noise: then the first such pair need not
    /// be the best.
    fn stem_turns_seldom(&self) -> bool {
        self.best().is_some_and(|c| c.reversals < self.settings.few_reversals)
    }

    /// The best candidate so far.
    fn best(&self) -> Option<Candidate> {
        self.found.best.iter().copied().min_by(|a, b| a.sse().total_cmp(&b.sse()))
    }

    /// One round of all laws still in the running, stage by stage, the better law first; returns why the search ends, if it
    /// does.
    fn round(&mut self, number: usize, round: &RoundSettings) -> Option<Ended> {
        let points = self.part(round);
        let mut runs: Vec<LawRound<'a>> = Vec::new();
        for &law in self.request.laws {
            let other = self.law_best[usize::from(law == Law::He)];
            // A law may miss its best fit in one round.
            if number > 1 && self.law_best[law as usize] > self.settings.behind[1] * other {
                continue;
            }
            // The laws are similar enough: if one sees no friction, the other need not be searched.
            if let Some(first) = runs.first_mut()
                && first.least() > self.settings.no_friction * self.without(Class::First)
            {
                self.stage(round, first, f64::INFINITY);
                if first.faint {
                    break;
                }
            }
            let mut run = self.begin(law, number, round, points);
            self.stage(round, &mut run, f64::INFINITY);
            runs.push(run);
            if runs.iter().any(|r| r.is_noise) {
                break;
            }
        }
        while !runs.iter().any(|r| r.is_noise) && runs.iter().any(|r| r.open) {
            runs.sort_by(|a, b| a.least().total_cmp(&b.least()));
            for k in 0..runs.len() {
                let other = runs.iter().enumerate().filter(|(o, _)| *o != k).map(|(_, r)| r.least());
                let other = other.fold(f64::INFINITY, f64::min);
                if runs[k].open {
                    self.stage(round, &mut runs[k], other);
                }
                if runs[k].is_noise {
                    break;
                }
            }
        }
        runs.sort_by(|a, b| b.is_noise.cmp(&a.is_noise).then(a.least().total_cmp(&b.least())));
        self.end_of(number, round, runs)
    }

    /// Finishes the laws of a round, the best first.
    fn end_of(&mut self, number: usize, round: &RoundSettings, runs: Vec<LawRound<'a>>) -> Option<Ended> {
        let mut faint = true;
        self.shows_in_part = false;
        for mut run in runs {
            faint &= run.faint;
            let much = self.settings.much * self.without(Class::First);
            self.shows_in_part |= !run.is_noise && run.least() > much && !self.is_faint_in_part(&mut run);
            self.found.evaluations += run.scan.looks + run.part.evaluator.evaluations;
            if self.finish(round, run) {
                self.found.is_noise = true;
                return Some(Ended::Noise);
            }
            if self.best_sse() > self.request.rival {
                return Some(Ended::Behind);
            }
        }
        (faint && number > 0).then_some(Ended::NoFriction)
    }

    /// Points of the record that a round searches first.
    fn part(&self, round: &RoundSettings) -> usize {
        let (n, period) = (self.problem.points(), self.problem.normalised.period);
        let [share, least, most] = if self.integrates() { SHORT_PART } else { round.part };
        let from = self.problem.normalised.from;
        let longest = self.problem.normalised.limits.lag[1].min(20.0);
        let part = (share * n as f64).max(least * period).min(most * period).max(from as f64 + 8.0 * longest);
        let start = if round.from_far || self.integrates() { self.problem.first_far(0.35) } else { 0 };
        (part as usize + start).min(n)
    }

    /// Whether the best so far integrates, by its class or by a lag longer than the record.
    fn integrates(&self) -> bool {
        let slow = |c: Candidate| !c.class.integrates() && c.taus()[0] > self.problem.points() as f64;
        self.best().is_some_and(|c| c.class.integrates() || slow(c))
    }

    /// Starts a law's round: its coarse scan, and refits of the best candidates.
    fn begin(&mut self, law: Law, number: usize, round: &RoundSettings, points: usize) -> LawRound<'a> {
        let mut rng = seeded_rng(self.request.seed, 10 + 2 * number as u64 + u64::from(law == Law::Tracking));
        let mut view = self.view_of_part(round.rho, points);
        let rho = view.rho();
        let mut evaluator = Evaluator::new(self.problem, law, Class::First, points);
        let seed = self.request.seed.wrapping_add((number as u64) << 32);
        let mut scan = Scan::new(&evaluator, rho, view.nothing());
        scan.run(&mut evaluator, self.request.fineness_pct, seed, &round.scan, &mut rng);
        self.found.scanned.extend(scan.of_every_size(&evaluator));
        let seen = scan.best(&round.scan);
        let mut refitted = seen.iter().filter_map(|c| evaluator.settle(&mut view, c)).collect::<Vec<_>>();
        self.found.scanned.extend(seen);
        refitted.extend(self.seeds_of_other_law(&mut evaluator, &mut view, law, &mut rng));
        let part = Part { points, head: None, view, evaluator, held: apart(&refitted, usize::MAX, 0) };
        LawRound::new(part, rng, scan)
    }

    /// If the first look did not end the search: closer looks, then the choice of the class of process.
    fn look_closer(&mut self, round: &RoundSettings, run: &mut LawRound<'a>, [count, steps]: [usize; 2]) {
        let near = self.settings.near;
        let LawRound { part, scan, rng, .. } = run;
        let class = part.evaluator.class;
        part.evaluator.class = Class::First;
        let reads = part.evaluator.law == Law::He && self.settings.reads_pv && self.problem.behind.is_none();
        let readings: &[Reading] =
            if reads { self.readings.get_or_insert_with(|| read::readings(self.problem)) } else { &[] };
        let seen = scan.closer(&mut part.evaluator, readings, &round.scan, rng);
        part.evaluator.class = class;
        let refitted = seen.iter().filter_map(|c| part.evaluator.in_class(&mut part.view, c, class));
        let mut refitted = apart(&refitted.collect::<Vec<_>>(), usize::MAX, 0);
        for c in refitted.iter_mut().take(count) {
            *c = random_steps(&mut part.evaluator, &mut part.view, *c, steps, near, rng);
        }
        self.found.scanned.extend(seen);
        refitted.extend(&part.held);
        part.held = apart(&refitted, usize::MAX, 0);
        if part.held.first().is_some_and(|c| c.class == Class::First) {
            choose_class(self.problem, self.request.model, run, steps, near);
        }
        if run.part.held.first().is_some_and(|c| c.class == Class::Second) {
            self.look_behind_lag(round, run, [count, steps]);
        }
    }

    /// Repeats the search for slips if the best candidates of the part need a second lag.
    fn look_behind_lag(&mut self, round: &RoundSettings, run: &mut LawRound<'a>, [count, steps]: [usize; 2]) {
        let LawRound { part, scan, rng, .. } = run;
        let Some(best) = part.held.first().copied() else { return };
        part.evaluator.class = best.class;
        let (seen, looks) = Scan::behind_lag(&mut part.evaluator, best.taus()[1], &round.scan, rng);
        scan.looks += looks;
        let refitted = seen.iter().filter_map(|c| part.evaluator.settle(&mut part.view, c));
        let mut refitted = apart(&refitted.collect::<Vec<_>>(), usize::MAX, 0);
        for c in refitted.iter_mut().take(count) {
            *c = random_steps(&mut part.evaluator, &mut part.view, *c, steps, self.settings.near, rng);
        }
        refitted.extend(&part.held);
        part.held = apart(&refitted, usize::MAX, 0);
    }

    /// A part filtered by `1 - rho q^-1`, or by a weaker filter if that one would leave mostly noise.
    fn view_of_part(&self, rho: f64, points: usize) -> View {
        let weaker = WEAKER.into_iter().filter(|w| *w < rho);
        let views = [rho].into_iter().chain(weaker).map(|rho| self.problem.view(rho, points));
        let mut views = views.filter(|v| {
            let noise = (1.0 + v.rho() * v.rho()) * self.noise_sd * self.noise_sd * v.count();
            noise <= MOST_NOISE * v.nothing()
        });
        views.next().unwrap_or_else(|| self.problem.view(0.0, points))
    }

    /// Candidates of the other law refitted under this one: slips with nearly the right bands suit both laws.
    fn seeds_of_other_law(
        &self,
        evaluator: &mut Evaluator<'a>,
        view: &mut View,
        law: Law,
        rng: &mut ChaCha8Rng,
    ) -> Vec<Candidate> {
        let near = self.settings.near;
        let mut out = Vec::new();
        for other in self.found.best.iter().filter(|c| c.law != law) {
            let moved = Candidate { law, ..*other };
            let Some(found) = evaluator.in_class(view, &moved, Class::First).filter(|c| c.fit.gain != 0.0) else {
                continue;
            };
            let found = random_steps(evaluator, view, found, CARRIED, near, rng);
            out.push(neighbours(evaluator, view, found, 2, near));
        }
        evaluator.class = Class::First;
        out
    }

    /// One more stage of a law's local search on the part, with its best candidate tested on the whole record; `other` is the
    /// least error of other laws in this round.
    fn stage(&mut self, round: &RoundSettings, run: &mut LawRound<'a>, other: f64) {
        let Some((count, steps)) = round.stages.get(run.stage).copied() else {
            run.open = false;
            return;
        };
        let (stage, near) = (run.stage, self.settings.near);
        run.stage += 1;
        if stage == 1 {
            self.look_closer(round, run, round.stages[0].into());
        }
        run.refine(stage, [count, if stage == 1 { round.stages[0].0 } else { 0 }], steps, near);
        let Some(best) = run.part.held.first().copied() else {
            run.open = false;
            return;
        };
        if run.tested.iter().any(|t| t.law == best.law && t.covers(best.s, best.j, best.start)) {
            run.stale += 1;
            run.open &= run.stale < 2 || stage < 2;
            return;
        }
        let old = run.least();
        run.is_noise = self.test(run, best);
        let (low, nothing) = (run.least(), self.without(Class::First));
        if run.is_noise {
            run.open = false;
        } else if stage > 0 {
            run.stale += usize::from(low > (1.0 - self.settings.gain) * old);
            run.faint = low > self.settings.no_friction * nothing && self.is_faint_in_part(run);
            let behind = low > self.settings.behind[0] * other.min(self.law_best[usize::from(best.law == Law::He)]);
            run.open = !(run.faint || behind || run.stale > 0 && self.is_real());
        }
    }

    /// Whether hardly any friction is visible in the part either: on the whole record it may not show yet.
    fn is_faint_in_part(&self, run: &mut LawRound<'a>) -> bool {
        let LawRound { part, without, .. } = run;
        let class = part.evaluator.class;
        let nothing = *without.get_or_insert_with(|| {
            let found = frictionless(&mut part.evaluator, &mut part.view, Class::First);
            found.map_or(f64::INFINITY, |f| f.sse).min(part.view.nothing())
        });
        part.evaluator.class = class;
        part.held.first().is_none_or(|c| c.sse() > FAINT_IN_PART * nothing)
    }

    /// Whether earlier rounds have shown that no model leaves only noise.
    const fn is_real(&self) -> bool {
        self.found.rounds > 1
    }

    /// Carries a candidate from the part to the whole record; returns whether it leaves only noise there.
    fn test(&mut self, run: &mut LawRound<'a>, best: Candidate) -> bool {
        let near = self.settings.near;
        let LawRound { part, tested, finals, rng, .. } = run;
        let best = neighbours(&mut part.evaluator, &mut part.view, best, 3, near);
        tested.push(best);
        let Some(mut found) = self.carried(part, best, rng) else { return false };
        let mut is_noise = self.is_noise(&found);
        if !is_noise && part.points < self.problem.points() {
            found = random_steps(&mut self.whole, &mut self.plain, found, CARRIED, near, rng);
            found = neighbours(&mut self.whole, &mut self.plain, found, 4, near);
            is_noise = self.is_noise(&found);
        }
        let closely = found.sse() < self.settings.closely * self.plain.nothing();
        if !is_noise && (tested.len() == 1 || closely) {
            let other = suited(self.request.model, &mut self.whole, &mut self.plain, found);
            if other.class != found.class {
                found = neighbours(&mut self.whole, &mut self.plain, other, 4, near);
                is_noise = self.is_noise(&found);
                if part.held.first().is_some_and(|c| c.class != found.class) {
                    part.move_to(found.class, &found);
                }
            }
        }
        finals.push(found);
        is_noise
    }

    /// From the part to the whole record in steps of twice the length, by the part's filtered error: behind an integrator a
    /// slightly wrong slip accumulates in the plain error.
    fn carried(&mut self, part: &Part<'a>, best: Candidate, rng: &mut ChaCha8Rng) -> Option<Candidate> {
        let (n, near) = (self.problem.points(), self.settings.near);
        let mut found = best;
        let mut length = part.points;
        while length < n {
            length = if (2 * length) as f64 > 0.75 * n as f64 { n } else { 2 * length };
            let mut view = self.problem.view(part.view.rho(), length);
            let mut evaluator = Evaluator::new(self.problem, best.law, best.class, length);
            found = evaluator.in_class(&mut view, &found, best.class)?;
            found = random_steps(&mut evaluator, &mut view, found, ON_THE_WAY, near, rng);
            found = neighbours(&mut evaluator, &mut view, found, 3, near);
            self.found.evaluations += evaluator.evaluations;
        }
        let class = allowed(self.request.model, best.class);
        let found = self.whole.in_class(&mut self.plain, &found, class)?;
        Some(neighbours(&mut self.whole, &mut self.plain, found, 4, near))
    }

    /// The last steps on the whole record; returns whether the result leaves only noise.
    fn finish(&mut self, round: &RoundSettings, run: LawRound<'a>) -> bool {
        let near = self.settings.near;
        let LawRound { part, mut finals, tested, faint, is_noise, mut rng, .. } = run;
        let rng = &mut rng;
        self.found.seen.extend(tested.iter().chain(&finals).copied());
        self.found.seen.extend(part.held.iter().take(6).copied());
        let steps = if is_noise {
            finals = finals.last().copied().into_iter().collect();
            40
        } else if faint {
            finals = apart(&finals, 1, 0);
            20
        } else {
            for c in part.held.iter().skip(1).take(2) {
                let class = allowed(self.request.model, c.class);
                finals.extend(self.whole.in_class(&mut self.plain, c, class));
            }
            finals = apart(&finals, 3, 0);
            let Some(best) = finals.first().copied() else { return false };
            let other = self.law_best[usize::from(best.law == Law::He)];
            if best.slips < SELDOM && best.sse() < self.settings.closely * self.plain.nothing() {
                for c in along_cells(&mut self.whole, &mut self.plain, &best, self.settings.cells_along) {
                    let Some(c) = self.whole.settle(&mut self.plain, &c) else { continue };
                    finals.push(neighbours(&mut self.whole, &mut self.plain, c, 3, near));
                }
                finals = apart(&finals, 3, 0);
            }
            if best.sse() < 0.95 * self.without(Class::First) && best.sse() < 1.3 * other {
                let (reach, steps) = if best.class.order() > 1 { FAR_ALONG } else { (0.05, 15) };
                let mut more = along_ridge(&mut self.whole, &mut self.plain, &best, reach, steps);
                more.retain(|c| c.sse() < 4.0 * best.sse());
                finals.extend(more);
                finals = apart(&finals, 2, 0);
                round.last
            } else {
                finals.truncate(1);
                20
            }
        };
        for c in &mut finals {
            *c = random_steps(&mut self.whole, &mut self.plain, *c, steps, near, rng);
            *c = neighbours(&mut self.whole, &mut self.plain, *c, 6, near);
        }
        finals.sort_by(|a, b| a.sse().total_cmp(&b.sse()));
        self.found.seen.extend(finals.iter().copied());
        let Some(best) = finals.first().copied() else { return false };
        self.keep(best);
        is_noise || self.is_noise(&best)
    }

    /// Keeps the best candidate of its law.
    pub(super) fn keep(&mut self, c: Candidate) {
        let least = &mut self.law_best[c.law as usize];
        if c.sse() < *least {
            *least = c.sse();
            self.found.best.retain(|b| b.law != c.law);
            self.found.best.push(c);
        }
    }

    /// Whether a candidate, fitted to the plain error of the whole record, leaves only noise.
    pub(crate) fn is_noise(&mut self, of: &Candidate) -> bool {
        if of.sse() < ROUNDING * self.plain.count() {
            return true;
        }
        let Some(process) = self.whole.polish(&self.plain, of) else { return false };
        let left = self.whole.leftover(&self.plain, &process);
        tests(self.problem, &self.plain, &left).is_some_and(|t| t.is_noise())
    }

    /// Least plain error without friction in a class, computed once.
    pub(crate) fn without(&mut self, class: Class) -> f64 {
        let known = self.without[index_of(class)];
        known.unwrap_or_else(|| {
            let found = frictionless(&mut self.whole, &mut self.plain, class);
            let sse = found.map_or(f64::INFINITY, |f| f.sse).min(self.plain.nothing());
            self.without[index_of(class)] = Some(sse);
            sse
        })
    }
}

/// Whiteness tests of a residual from the view's first point on; `None` if it is clearly coloured.
fn tests(problem: &Problem<'_>, view: &View, left: &[f64]) -> Option<Whiteness> {
    if stats::autocorrelation_1(left).abs() > COLOURED {
        return None;
    }
    let from = view.from().min(problem.normalised.mean.len());
    Some(residual::whiteness(left, &problem.normalised.mean[from..]))
}
