//! Fits the rules of the plant-wide judgement to simulated plants, and scores them on others.

use nalgebra::{DMatrix, DVector};
use serde::Serialize;

use crate::calibrate::regress;
use crate::plants::{CaseLoop, Difficulty, Role, plant, stretched};
use crate::truth::Half;
use crate::truth::draw::Draw;
use stiction::core::units::ns_from_s;
use stiction::core::verdict::prevalence::CALIBRATED_FOR;
use stiction::core::verdict::{AssessParams, Assessment, assess};
use stiction::plantwide::{
    Calibration, Chance, GroupDocument, Logit, Made, PairFigures, PlantLoop, SourceKind, assess_plant_by, frequency_hz,
    group_figures, member_figures, pair_figures, source_figures,
};

/// Settings of the fits.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Settings {
    /// Number of pairs from different plants for each step of [`APART`].
    pub foreign: usize,
    /// Share of those pairs above the link threshold.
    pub chance_links: f64,
    /// Probability by the member's rule below which a follower's own signs of stiction are attributed to the source.
    pub capped_below: f64,
}

impl Default for Settings {
    fn default() -> Self {
        Self { foreign: 500, chance_links: 0.009, capped_below: 0.6 }
    }
}

/// Share of those pairs from which the decay of the tail is estimated.
const TAIL: f64 = 0.1;
/// Ridge penalties: links, sources, members.
const RIDGE: [f64; 3] = [2.0, 5.0, 4.0];
/// Most steps of the fit of the source's rule, and the longest step.
const CHOICE_ROUNDS: usize = 60;
/// See [`CHOICE_ROUNDS`].
const LONGEST_STEP: f64 = 2.0;
/// Largest standardised figure in the rules of source and member.
const LIMIT: f64 = 4.0;
/// Relative differences in frequency of pairs from different plants.
pub const APART: [[f64; 2]; 4] = [[0.0005, 0.003], [0.003, 0.01], [0.01, 0.03], [0.03, 0.1]];
/// Index of the logarithm of the compared periods among a pair's figures.
const PERIODS: usize = 5;

/// A plant with each loop's own assessment.
#[derive(Debug, Clone)]
pub struct Judged {
    loops: Vec<CaseLoop>,
    assessments: Vec<Assessment>,
    seed: u64,
    difficulty: Difficulty,
}

impl Judged {
    /// Draws a plant and judges each of its loops alone, as `analyze` does.
    #[must_use]
    pub fn new(half: Half, seed: u64, difficulty: Difficulty) -> Self {
        let params = AssessParams { always_fit: true, prevalence: CALIBRATED_FOR, ..AssessParams::default() };
        let loops = plant(half.name(), seed, difficulty);
        let assessments = loops.iter().map(|l| assess(&l.record, &params)).collect();
        Self { loops, assessments, seed, difficulty }
    }

    /// The same plant with skewed clocks: each loop's by its own draw, uniform from 0 to this many of its periods.
    #[must_use]
    pub fn with_skewed_clocks(mut self, periods: f64) -> Self {
        let mut draw = Draw::new(self.seed, "clocks");
        for l in &mut self.loops {
            let period_s = frequency_hz(&l.record).map_or(0.0, |frequency| 1.0 / frequency);
            let skew_ns = ns_from_s(draw.between(0.0, periods) * period_s);
            (l.record.start_ns, l.record.end_ns) = (l.record.start_ns + skew_ns, l.record.end_ns + skew_ns);
        }
        self
    }

    /// Difficulty of the plant.
    #[must_use]
    pub const fn difficulty(&self) -> Difficulty {
        self.difficulty
    }

    fn at(&self, k: usize) -> PlantLoop<'_> {
        PlantLoop {
            name: &self.loops[k].name,
            record: &self.loops[k].record,
            assessment: &self.assessments[k],
            area: None,
            upstream: &[],
        }
    }

    fn all(&self) -> Vec<PlantLoop<'_>> {
        (0..self.loops.len()).map(|k| self.at(k)).collect()
    }

    fn place(&self, name: &str) -> usize {
        self.loops.iter().position(|l| l.name == name).unwrap_or(0)
    }

    fn shares(&self, a: usize, b: usize) -> bool {
        self.loops[a].group.is_some() && self.loops[a].group == self.loops[b].group
    }

    fn pairs(&self) -> impl Iterator<Item = [usize; 2]> {
        let n = self.loops.len();
        (0..n).flat_map(move |a| (a + 1..n).map(move |b| [a, b]))
    }

    /// The oscillation shared by most members of a group, if at least two share one, and its true source.
    fn truth(&self, members: &[usize]) -> Option<Truth> {
        let count = |group: usize| members.iter().filter(|m| self.loops[**m].group == Some(group)).count();
        let group = (0..2).max_by_key(|group| count(*group)).filter(|group| count(*group) > 1)?;
        let mut inside = members.iter().filter(|m| self.loops[**m].group == Some(group));
        if inside.clone().any(|m| self.loops[*m].role == Role::Driven) {
            return Some(Truth::Outside);
        }
        Some(inside.find(|m| self.loops[**m].role == Role::Source).map_or(Truth::NotMeasured, |m| Truth::Member(*m)))
    }
}

/// True source of a group's oscillation.
#[derive(Debug, Clone, Copy, PartialEq)]
enum Truth {
    Member(usize),
    Outside,
    /// A sticking valve that is not in the group.
    NotMeasured,
}

/// Figures of a pair, and whether the pair shares an oscillation.
type Row = (Vec<f64>, bool);

/// Figures of `count` pairs from different plants for each step of [`APART`]: the time of one loop is stretched so that the
/// frequencies nearly agree.
#[must_use]
pub fn foreign_pairs(plants: &[Judged], count: usize, seed: u64) -> Vec<Vec<PairFigures>> {
    let known: Vec<(usize, usize, f64)> = plants
        .iter()
        .enumerate()
        .flat_map(|(p, plant)| {
            plant.loops.iter().enumerate().filter_map(move |(k, l)| Some((p, k, frequency_hz(&l.record)?)))
        })
        .collect();
    let mut draw = Draw::new(seed, "pairs of different plants");
    let mut one_step = |[low, high]: [f64; 2]| {
        let mut rows = Vec::new();
        for _ in 0..20 * count {
            let [a, b] = [0; 2].map(|_| draw.pick(&known, (0, 0, 1.0)));
            let apart = 1.0 + draw.sign() * draw.log_between(low, high);
            if a.0 == b.0 || rows.len() == count {
                continue;
            }
            let fixed = plants[a.0].at(a.1);
            let record = stretched(&plants[b.0].loops[b.1].record, b.2 / (a.2 * apart), fixed.record.end_ns);
            let other = PlantLoop { record: &record, ..plants[b.0].at(b.1) };
            rows.extend(pair_figures(&fixed, &other));
        }
        rows
    };
    APART.into_iter().map(&mut one_step).collect()
}

/// Means and scales for standardising figures.
struct Standard {
    means: Vec<f64>,
    scales: Vec<f64>,
    limit: f64,
}

impl Standard {
    fn of(rows: &[&[f64]], limit: f64) -> Option<Self> {
        let (n, k) = (rows.len() as f64, rows.first()?.len());
        let mean = |c: usize| rows.iter().map(|r| r[c]).sum::<f64>() / n;
        let means: Vec<f64> = (0..k).map(mean).collect();
        let square = |x: f64| x * x;
        let spread = |c: usize| (rows.iter().map(|r| square(r[c] - means[c])).sum::<f64>() / n).sqrt() + 1e-9;
        let scales = (0..k).map(spread).collect();
        Some(Self { means, scales, limit })
    }

    /// A column of ones, and one column per standardised figure.
    fn table(&self, rows: &[&[f64]]) -> DMatrix<f64> {
        let cell = |row: usize, c: usize| match c {
            0 => 1.0,
            c => ((rows[row][c - 1] - self.means[c - 1]) / self.scales[c - 1]).clamp(-self.limit, self.limit),
        };
        DMatrix::from_fn(rows.len(), self.means.len() + 1, cell)
    }

    fn logit(self, found: &DVector<f64>) -> Logit {
        let weights = found.as_slice()[1..].to_vec();
        Logit { constant: found[0], weights, means: self.means, scales: self.scales, limit: self.limit }
    }
}

/// Logistic regression on standardised figures limited to `+-limit`.
fn fit(rows: &[Row], ridge: f64, limit: f64) -> Option<Logit> {
    let figures: Vec<&[f64]> = rows.iter().map(|row| row.0.as_slice()).collect();
    let standard = Standard::of(&figures, limit)?;
    let truth: Vec<[f64; 2]> = rows.iter().map(|r| [f64::from(u8::from(r.1)), 1.0]).collect();
    let found = regress(&standard.table(&figures), &truth, ridge)?;
    Some(standard.logit(&found))
}

/// A group of which one member, or none, causes the oscillation.
struct Choice {
    /// Figures of each member.
    members: Vec<Vec<f64>>,
    source: Option<usize>,
}

/// Conditional logistic regression (McFadden 1974): the members of a group compete with each other and with an external source,
/// whose logit is 0.
fn fit_choices(choices: &[Choice], ridge: f64, limit: f64) -> Option<Logit> {
    let figures: Vec<&[f64]> = choices.iter().flat_map(|c| c.members.iter().map(Vec::as_slice)).collect();
    let standard = Standard::of(&figures, limit)?;
    let x = standard.table(&figures);
    let k = x.ncols();
    let mut b = DVector::<f64>::zeros(k);
    for _ in 0..CHOICE_ROUNDS {
        let z = &x * &b;
        let mut gradient = DVector::from_fn(k, |c, _| if c == 0 { 0.0 } else { ridge * b[c] });
        let mut hessian = DMatrix::from_fn(k, k, |r, c| if r == c { if c == 0 { 1e-9 } else { ridge } } else { 0.0 });
        let mut first = 0;
        for choice in choices {
            let rows = first..first + choice.members.len();
            first = rows.end;
            let odds: Vec<f64> = rows.clone().map(|row| libm::exp(z[row].min(50.0))).collect();
            let all = 1.0 + odds.iter().sum::<f64>();
            let mut mean = DVector::<f64>::zeros(k);
            for (member, row) in rows.enumerate() {
                let figures = x.row(row).transpose();
                let p = odds[member] / all;
                let truth = f64::from(u8::from(choice.source == Some(member)));
                gradient += &figures * (p - truth);
                hessian += &figures * figures.transpose() * p;
                mean += figures * p;
            }
            hessian -= &mean * mean.transpose();
        }
        let step = hessian.cholesky()?.solve(&gradient);
        // A long first step would overshoot.
        let shortened = (LONGEST_STEP / step.amax()).min(1.0);
        b -= &step * shortened;
        if step.amax() < 1e-9 {
            break;
        }
    }
    Some(standard.logit(&b))
}

/// Fits every rule. `None` if the plants contain no examples for one of them.
#[must_use]
pub fn calibrate(plants: &[Judged], settings: &Settings) -> Option<Calibration> {
    let mut links: Vec<Row> = Vec::new();
    for plant in plants {
        let row = |[a, b]: [usize; 2]| Some((pair_figures(&plant.at(a), &plant.at(b))?.values, plant.shares(a, b)));
        links.extend(plant.pairs().filter_map(row));
    }
    let shared = links.iter().filter(|row| row.1).count();
    let apart: Vec<Vec<f64>> =
        foreign_pairs(plants, settings.foreign, 1).into_iter().flatten().map(|pair| pair.values).collect();
    links.extend(apart.iter().map(|figures| (figures.clone(), false)));
    let link = fit(&links, RIDGE[0], f64::MAX)?;
    let mut scores: Vec<f64> = apart.iter().map(|figures| link.of(figures)).collect();
    scores.sort_by(f64::total_cmp);
    let rules = Calibration {
        chance: chance(&scores, settings.chance_links)?,
        link,
        capped_below: settings.capped_below,
        made: Made {
            plants: plants.len(),
            loops: plants.iter().map(|p| p.loops.len()).sum(),
            pairs: [shared, apart.len()],
            seed: plants.iter().map(|p| p.seed).min()?,
        },
        ..Calibration::default()
    };
    fit_sources(plants, rules)
}

/// The threshold of links, and the decay of chance links above it.
fn chance(sorted: &[f64], rate: f64) -> Option<Chance> {
    let at = |share: f64| sorted.get(((1.0 - share) * sorted.len() as f64) as usize).copied();
    let (threshold, tail) = (at(rate)?, at(TAIL)?);
    let above: Vec<f64> = sorted.iter().filter(|s| **s > tail).map(|s| s - tail).collect();
    let decay = above.iter().sum::<f64>() / above.len().max(1) as f64;
    Some(Chance { threshold, rate, decay })
}

fn fit_sources(plants: &[Judged], rules: Calibration) -> Option<Calibration> {
    let mut groups = Vec::new();
    for plant in plants {
        for group in assess_plant_by(&plant.all(), &rules) {
            let mut members: Vec<usize> = group.members.iter().map(|name| plant.place(name)).collect();
            members.sort_unstable();
            let loops: Vec<PlantLoop> = members.iter().map(|m| plant.at(*m)).collect();
            let (Some(truth), Some(figures)) = (plant.truth(&members), group_figures(&loops)) else { continue };
            groups.push((plant, members, truth, figures));
        }
    }
    let mut choices: Vec<Choice> = Vec::new();
    for (_, members, truth, figures) in &groups {
        let source = members.iter().position(|m| *truth == Truth::Member(*m));
        choices.push(Choice { members: source_figures(figures), source });
    }
    let source = fit_choices(&choices, RIDGE[1], LIMIT)?;
    let mut stuck: Vec<Row> = Vec::new();
    for (plant, members, _, figures) in &groups {
        let logits: Vec<f64> = source_figures(figures).iter().map(|f| source.of(f)).collect();
        let best = logits.iter().copied().fold(f64::MIN, f64::max);
        let row = |k: usize| (member_figures(&figures[k], logits[k], best), plant.loops[members[k]].sticks);
        stuck.extend((0..members.len()).map(row));
    }
    let member = fit(&stuck, RIDGE[2], LIMIT)?;
    Some(Calibration { source, member, ..rules })
}

/// A count out of a total.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize)]
pub struct Count {
    /// Number found.
    pub found: usize,
    /// Total.
    pub of: usize,
}

impl Count {
    fn add(&mut self, found: bool) {
        self.found += usize::from(found);
        self.of += 1;
    }

    /// The share; NaN if the total is 0.
    #[must_use]
    pub fn share(self) -> f64 {
        self.found as f64 / self.of as f64
    }
}

/// Accuracy of the rules.
#[derive(Debug, Clone, Default, PartialEq, Serialize)]
pub struct Score {
    /// Number of plants and of their loops.
    pub plants: usize,
    /// See `plants`.
    pub loops: usize,
    /// Compared pairs that share an oscillation, linked: over 8 periods and more, and over fewer.
    pub links: [Count; 2],
    /// Unrelated pairs of one plant, linked.
    pub false_links: Count,
    /// Pairs from different plants, linked, for each step of [`APART`].
    pub foreign_links: [Count; 4],
    /// Linked pairs of one plant or of two that a large plant would not compare, because their sketches disagree.
    pub left_out: Count,
    /// Pairs in one group that truly share an oscillation.
    pub precision: Count,
    /// Pairs that share an oscillation, visible in both, in one group.
    pub recall: Count,
    /// Groups whose source is a sticking valve: the source is ranked first.
    pub first: Count,
    /// The same: the source is named.
    pub named: Count,
    /// The same: another loop is named.
    pub other_named: Count,
    /// Groups with an external source: reported as external.
    pub outside: Count,
    /// The same: a loop is named.
    pub outside_named: Count,
    /// Groups whose source is not a member: no loop is named.
    pub unmeasured: Count,
    /// Healthy members of groups called sticking, alone and by the group.
    pub false_positives: [Count; 2],
    /// Sources called sticking, alone and by the group.
    pub sources: [Count; 2],
    /// Followers with a sticking valve: called sticking alone, by the group, and reported as masked.
    pub second_valves: [Count; 3],
    /// Loops that share no oscillation, put into a group.
    pub alone_grouped: Count,
}

/// Probability from which a valve is called sticking here.
const CALLED: f64 = 0.5;

/// Scores the rules on plants that they were not fitted to.
#[must_use]
pub fn score(plants: &[Judged], rules: &Calibration, foreign: usize, seed: u64) -> Score {
    let mut score = Score { plants: plants.len(), ..Score::default() };
    for plant in plants {
        score.loops += plant.loops.len();
        score.count_links(plant, rules);
        let groups = assess_plant_by(&plant.all(), rules);
        score.count_groups(plant, &groups);
        groups.iter().for_each(|group| score.count_source(plant, group));
        score.count_members(plant, &groups);
    }
    let of_two_plants = foreign_pairs(plants, foreign, seed);
    for (count, rows) in score.foreign_links.iter_mut().zip(of_two_plants) {
        for pair in rows {
            let linked = rules.link.of(&pair.values) > rules.chance.threshold;
            count.add(linked);
            if linked {
                score.left_out.add(!pair.may_share);
            }
        }
    }
    score
}

impl Score {
    fn count_links(&mut self, plant: &Judged, rules: &Calibration) {
        for [a, b] in plant.pairs() {
            let Some(figures) = pair_figures(&plant.at(a), &plant.at(b)) else { continue };
            let linked = rules.link.of(&figures.values) > rules.chance.threshold;
            let long = libm::exp(figures.values[PERIODS]) >= 8.0;
            if linked {
                self.left_out.add(!figures.may_share);
            }
            match plant.shares(a, b) {
                true => self.links[usize::from(!long)].add(linked),
                false => self.false_links.add(linked),
            }
        }
    }

    fn count_groups(&mut self, plant: &Judged, groups: &[GroupDocument]) {
        let group_of = |k: usize| groups.iter().position(|g| g.members.contains(&plant.loops[k].name));
        let shows = |k: usize| frequency_hz(&plant.loops[k].record).is_some();
        for [a, b] in plant.pairs() {
            let together = group_of(a).is_some() && group_of(a) == group_of(b);
            if together {
                self.precision.add(plant.shares(a, b));
            }
            if plant.shares(a, b) && shows(a) && shows(b) {
                self.recall.add(together);
            }
        }
        let alone = (0..plant.loops.len()).filter(|k| plant.loops[*k].group.is_none());
        alone.for_each(|k| self.alone_grouped.add(group_of(k).is_some()));
    }

    fn count_source(&mut self, plant: &Judged, group: &GroupDocument) {
        let members: Vec<usize> = group.members.iter().map(|name| plant.place(name)).collect();
        let named = match group.source.kind {
            SourceKind::Loop => group.source.loop_name.as_deref().map(|name| plant.place(name)),
            _ => None,
        };
        match plant.truth(&members) {
            Some(Truth::Member(source)) => {
                self.first.add(members[0] == source);
                self.named.add(named == Some(source));
                self.other_named.add(named.is_some_and(|loop_| loop_ != source));
            }
            Some(Truth::Outside) => {
                self.outside.add(group.source.kind == SourceKind::Outside);
                self.outside_named.add(named.is_some());
            }
            Some(Truth::NotMeasured) => self.unmeasured.add(named.is_none()),
            None => {}
        }
    }

    fn count_members(&mut self, plant: &Judged, groups: &[GroupDocument]) {
        for judged in groups.iter().flat_map(|g| &g.judgements) {
            let l = &plant.loops[plant.place(&judged.loop_name)];
            let called = [judged.p_alone, judged.p_stiction].map(|p| p.unwrap_or(0.0) >= CALLED);
            let counts: &mut [Count] = match (l.role, l.sticks) {
                (Role::Source, _) => &mut self.sources,
                (_, true) => &mut self.second_valves[..2],
                (_, false) => &mut self.false_positives,
            };
            counts.iter_mut().zip(called).for_each(|(count, called)| count.add(called));
            if l.sticks && l.role != Role::Source {
                self.second_valves[2].add(judged.masked);
            }
        }
    }
}
