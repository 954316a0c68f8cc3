//! The links of a plant's pairs, and the resulting groups.
//!
//! Most pairs are unrelated, and a sketch of their phases shows it; only the others are compared in full. Within a set of loops
//! connected by links every pair is compared: the groups are the same as without this shortcut, unless it dropped a link.

use std::collections::BTreeMap;

use super::calibration::Calibration;
use super::cycle::Cycle;
use super::groups::{self, Link};
use super::sketch::Sketch;
use super::{PlantLoop, pair};

/// Largest shortfall from 1 of the agreement of two loops' sketches at which the pair is compared in full. On plants and pairs
/// of plants of the development seeds, the full comparison links no pair with a shortfall above 0.065.
const LARGEST_SHORTFALL: f64 = 0.15;
/// Relative decrease of that limit per logit by which the threshold rises. On the same pairs the limit stays at least 1.6 times
/// the largest shortfall of a linked pair.
const FALL: f64 = 0.2;

/// Loops that oscillate, and the links of their pairs.
pub(super) struct Links<'a> {
    loops: &'a [PlantLoop<'a>],
    cycles: &'a [Option<Cycle>],
    rules: &'a Calibration,
    /// Number of pairs in one area that oscillate at nearly the same frequency at the same time.
    pub compared: usize,
    /// Logits of the pairs that were compared in full.
    found: Vec<Link>,
}

/// Members of a group in rising order, and the links among them.
pub(super) type Linked = (Vec<usize>, Vec<Link>);

impl<'a> Links<'a> {
    pub fn of(loops: &'a [PlantLoop<'a>], cycles: &'a [Option<Cycle>], rules: &'a Calibration) -> Self {
        let mut links = Self { loops, cycles, rules, compared: 0, found: Vec::new() };
        let mut oscillating: Vec<(usize, &Cycle, Sketch)> =
            cycles.iter().enumerate().filter_map(|(k, cycle)| cycle.as_ref().map(|c| (k, c, Sketch::of(c)))).collect();
        oscillating.sort_by(|a, b| a.1.frequency_hz.total_cmp(&b.1.frequency_hz).then(a.0.cmp(&b.0)));
        let mut open: Vec<([usize; 2], f64)> = Vec::new();
        for (place, (a, of_a, sketch_a)) in oscillating.iter().enumerate() {
            let highest = of_a.frequency_hz * libm::exp(pair::NEAR);
            for (b, of_b, sketch_b) in oscillating[place + 1..].iter().take_while(|of| of.1.frequency_hz < highest) {
                if links.are_apart(*a, *b) || pair::common(of_a, of_b).is_none() {
                    continue;
                }
                links.compared += 1;
                let shortfall = shortfall(sketch_a, sketch_b);
                if shortfall <= LARGEST_SHORTFALL {
                    open.push(([*a.min(b), *a.max(b)], shortfall));
                }
            }
        }
        let largest = largest_shortfall(rules, links.compared);
        open.retain(|(_, shortfall)| *shortfall <= largest);
        links.found = open.into_iter().filter_map(|(pair, _)| links.link(pair)).collect();
        links
    }

    fn are_apart(&self, a: usize, b: usize) -> bool {
        self.loops[a].area.zip(self.loops[b].area).is_some_and(|(a, b)| a != b)
    }

    /// Compares a pair in full.
    fn link(&self, pair: [usize; 2]) -> Option<Link> {
        let [a, b] = pair.map(|k| self.cycles[k].as_ref());
        // The lower frequency comes first, so that the order of the loops does not matter.
        let (a, b) = (a?, b?);
        let (low, high) = if a.frequency_hz <= b.frequency_hz { (a, b) } else { (b, a) };
        let score = pair::link(&pair::compare(low, high)?, &self.rules.link);
        Some(Link { pair, score })
    }

    /// The groups, largest first.
    pub fn groups(&self) -> Vec<Linked> {
        let threshold = self.rules.chance.threshold_among(self.compared);
        let linked = self.found.iter().filter(|link| link.score - threshold > 0.0).map(|link| link.pair);
        let sets = groups::connected(self.loops.len(), linked);
        let mut groups: Vec<Linked> = self
            .within(&sets)
            .into_iter()
            .zip(&sets)
            .flat_map(|(links, set)| {
                let above: Vec<Link> = links.iter().map(|l| Link { score: l.score - threshold, ..*l }).collect();
                let inside = |members: &[usize]| {
                    links.iter().filter(|l| l.pair.iter().all(|m| members.binary_search(m).is_ok())).copied().collect()
                };
                let merged = groups::merged(set, &above);
                merged
                    .into_iter()
                    .map(|members| (inside(&members), members))
                    .map(|(links, members)| (members, links))
                    .collect::<Vec<_>>()
            })
            .collect();
        groups.sort_by_key(|(members, _)| (core::cmp::Reverse(members.len()), members[0]));
        groups
    }

    /// Links of every pair inside each set.
    fn within(&self, sets: &[Vec<usize>]) -> Vec<Vec<Link>> {
        let mut set_of = BTreeMap::new();
        for (place, set) in sets.iter().enumerate() {
            set_of.extend(set.iter().map(|member| (*member, place)));
        }
        let mut known: Vec<BTreeMap<[usize; 2], f64>> = vec![BTreeMap::new(); sets.len()];
        for Link { pair, score } in &self.found {
            if let [Some(a), Some(b)] = pair.each_ref().map(|member| set_of.get(member))
                && a == b
            {
                known[*a].insert(*pair, *score);
            }
        }
        let complete = |(set, known): (&Vec<usize>, &BTreeMap<[usize; 2], f64>)| {
            let pairs = set.iter().enumerate().flat_map(|(at, a)| set[at + 1..].iter().map(move |b| [*a, *b]));
            let link = |pair: [usize; 2]| match known.get(&pair) {
                Some(score) => Some(Link { pair, score: *score }),
                None if self.are_apart(pair[0], pair[1]) => None,
                None => self.link(pair),
            };
            pairs.filter_map(link).collect()
        };
        sets.iter().zip(&known).map(complete).collect()
    }
}

/// Shortfall from 1 of the agreement of two loops' sketches; 0 if they have too few common frames.
fn shortfall(a: &Sketch, b: &Sketch) -> f64 {
    a.agreement(b).map_or(0.0, |agreement| 1.0 - f64::from(agreement))
}

/// The largest shortfall allowed if this many pairs are compared.
fn largest_shortfall(rules: &Calibration, compared: usize) -> f64 {
    let raised = rules.chance.threshold_among(compared) - rules.chance.threshold;
    LARGEST_SHORTFALL * libm::exp(-FALL * raised)
}

/// Whether the sketches of two loops of a small plant allow that they share an oscillation.
pub(super) fn may_share(a: &Cycle, b: &Cycle) -> bool {
    shortfall(&Sketch::of(a), &Sketch::of(b)) <= LARGEST_SHORTFALL
}
