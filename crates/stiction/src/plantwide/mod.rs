//! Many loops of one plant: which of them share an oscillation, and which one causes it.
//!
//! A sticking valve disturbs its neighbours, and an external load disturbs several loops at once. Judged alone, a healthy loop
//! that follows another loop's limit cycle looks as if its own valve stuck. This module groups loops that share an oscillation
//! (their phases are locked and wander together), searches for the source of each group, and judges every member again with the
//! group's evidence. It needs no topology.
//!
//! Limits: loops whose periods differ by less than 0.3 % over few periods cannot be distinguished; a sticking follower of a
//! sticking source is reported as masked, not as healthy; clocks that differ by a sizeable part of a period spoil the lags and
//! the search for the source, not the groups.

mod calibration;
mod cycle;
mod document;
mod evidence;
mod groups;
mod links;
mod logit;
mod order;
mod pair;
mod same;
mod sketch;
mod source;
mod words;

pub use calibration::{Calibration, Chance, Made};
pub use document::{Follower, GROUP_SCHEMA, GroupDocument, Source, SourceKind, Span};
pub use logit::Logit;
pub use source::{member_figures, source_figures};
pub use words::{headline, of_member, text};

use crate::core::record::Record;
use crate::core::units::Moment;
pub use crate::core::verdict::MemberJudgement;
use crate::core::verdict::{Assessment, Gate, for_prevalence};
use cycle::Cycle;
use evidence::{Evidence, Signals};
use groups::Link;
use links::{Linked, Links};
use order::Order;
use source::Decision;

/// Most members whose evidence is gathered: the cost grows with its square. In larger groups these are the members most likely
/// to stick by their own windows; the others can only be followers.
const MOST_CANDIDATES: usize = 10;

/// A loop of a plant with its window and assessment.
#[derive(Debug, Clone, Copy)]
pub struct PlantLoop<'a> {
    /// The loop's name.
    pub name: &'a str,
    /// The window.
    pub record: &'a Record,
    /// The loop's own assessment of that window.
    pub assessment: &'a Assessment,
    /// The plant area, if known: loops of different areas are not compared.
    pub area: Option<&'a str>,
    /// Names of the loops that are upstream by configuration. They change the order of a group's members, but no probability.
    pub upstream: &'a [String],
}

/// The groups of a plant, largest first; loops in no group keep their own answer.
#[must_use]
pub fn assess_plant(loops: &[PlantLoop]) -> Vec<GroupDocument> {
    assess_plant_by(loops, Calibration::shipped())
}

/// As [`assess_plant`], with other rules than those of this build.
#[must_use]
pub fn assess_plant_by(loops: &[PlantLoop], rules: &Calibration) -> Vec<GroupDocument> {
    let epoch_ns = loops.iter().map(|l| l.record.start_ns).min().unwrap_or(0);
    let cycles: Vec<Option<Cycle>> = loops.iter().map(|l| Cycle::of(l.record, epoch_ns)).collect();
    let links = Links::of(loops, &cycles, rules);
    let document = |(members, inside): Linked| {
        let p_value = p_value(&members, &inside, links.compared, rules);
        Group { members, loops, cycles: &cycles, epoch_ns, rules }.document(p_value, links.compared)
    };
    links.groups().into_iter().filter_map(document).collect()
}

/// Figures of a pair.
#[derive(Debug, Clone, PartialEq)]
pub struct PairFigures {
    /// Features for the link of the pair.
    pub values: Vec<f64>,
    /// Whether the sketches of both loops allow that they share an oscillation, so that the pair is compared in full.
    pub may_share: bool,
}

/// The figures of a pair; `None` if a loop does not oscillate, or the two oscillate at different frequencies or times.
#[must_use]
pub fn pair_figures(a: &PlantLoop, b: &PlantLoop) -> Option<PairFigures> {
    let epoch_ns = a.record.start_ns.min(b.record.start_ns);
    let [a, b] = [a, b].map(|l| Cycle::of(l.record, epoch_ns));
    let (a, b) = (a?, b?);
    let values = pair::expanded(&pair::compare(&a, &b)?);
    Some(PairFigures { values, may_share: links::may_share(&a, &b) })
}

/// Whether two periods, s, are close enough for their loops to share an oscillation.
#[must_use]
pub fn is_near(a_s: f64, b_s: f64) -> bool {
    libm::fabs(libm::log(a_s / b_s)) < pair::NEAR
}

/// Frequency of a loop's dominant oscillation, Hz; `None` if it does not oscillate.
#[must_use]
pub fn frequency_hz(record: &Record) -> Option<f64> {
    Cycle::of(record, record.start_ns).map(|cycle| cycle.frequency_hz)
}

/// Figures for judging a group's source and members, one row per member; `None` if their windows overlap too little.
#[must_use]
pub fn group_figures(members: &[PlantLoop]) -> Option<Vec<[f64; Evidence::NAMES.len()]>> {
    let epoch_ns = members.iter().map(|l| l.record.start_ns).min()?;
    let cycles: Vec<Cycle> = members.iter().map(|l| Cycle::of(l.record, epoch_ns)).collect::<Option<_>>()?;
    let found = evidence_of(members, common_period_s(cycles.iter()), epoch_ns)?;
    Some(found.into_iter().map(|evidence| evidence.figures).collect())
}

fn evidence_of(members: &[PlantLoop], period_s: f64, epoch_ns: i64) -> Option<Vec<Evidence>> {
    let signals: Vec<Signals> = members.iter().map(|l| Signals::of(l.record, l.assessment, epoch_ns)).collect();
    let both: Vec<(&Signals, &Assessment)> = signals.iter().zip(members.iter().map(|l| l.assessment)).collect();
    evidence::gather(&both, period_s)
}

fn common_period_s<'a>(cycles: impl Iterator<Item = &'a Cycle>) -> f64 {
    crate::core::signal::stats::median(&cycles.map(Cycle::period_s).collect::<Vec<f64>>())
}

/// Probability that the weakest member has its best link into the group by chance, given `compared` pairs.
fn p_value(members: &[usize], inside: &[Link], compared: usize, rules: &Calibration) -> f64 {
    let best =
        |member: &usize| inside.iter().filter(|l| l.pair.contains(member)).map(|l| l.score).fold(f64::MIN, f64::max);
    let weakest = members.iter().map(best).fold(f64::MAX, f64::min);
    (compared as f64 * rules.chance.p_value(weakest)).min(1.0)
}

/// A group during judgement.
struct Group<'a> {
    members: Vec<usize>,
    loops: &'a [PlantLoop<'a>],
    cycles: &'a [Option<Cycle>],
    epoch_ns: i64,
    rules: &'a Calibration,
}

impl Group<'_> {
    /// The members whose evidence is gathered, in the order of the plant's loops.
    fn candidates(&self) -> Vec<usize> {
        let p = |member: &usize| self.loops[*member].assessment.p_calibrated.unwrap_or(0.0);
        let mut candidates = self.members.clone();
        candidates.sort_by(|a, b| p(b).total_cmp(&p(a)).then(a.cmp(b)));
        candidates.truncate(MOST_CANDIDATES);
        candidates.sort_unstable();
        candidates
    }

    fn document(&self, p_value: f64, pairs_compared: usize) -> Option<GroupDocument> {
        let period_s = common_period_s(self.members.iter().filter_map(|m| self.cycles[*m].as_ref()));
        let candidates = self.candidates();
        let of_candidates: Vec<PlantLoop> = candidates.iter().map(|m| self.loops[*m]).collect();
        let evidence = evidence_of(&of_candidates, period_s, self.epoch_ns)?;
        let in_manual = |l: &PlantLoop| l.assessment.gates.contains(&Gate::Manual);
        let eligible: Vec<bool> = of_candidates.iter().map(|l| !in_manual(l)).collect();
        let decision = Decision::of(&evidence, &eligible, self.rules);
        let p_source =
            |member: usize| candidates.iter().position(|c| *c == member).map_or(0.0, |place| decision.p_source[place]);
        let mut ranked = self.members.clone();
        ranked.sort_by(|a, b| p_source(*b).total_cmp(&p_source(*a)).then(a.cmp(b)));
        let by_evidence = ranked.clone();
        let best = candidates[decision.best];
        let same_record = self.same_record();
        let mut source = if same_record.is_empty() {
            words::source(&decision, &evidence[decision.best], self.loops[best].name, period_s)
        } else {
            Source::unnamed()
        };
        self.put_in_order(&mut ranked, &source, best);
        source.reasons.extend(self.reason_of_order(&by_evidence, &ranked));
        let judged = |member: &usize| {
            // Loops with the same record are no evidence for each other.
            let place = candidates.iter().position(|c| c == member).filter(|_| same_record.is_empty());
            self.judgement(*member, place, &decision, &source)
        };
        let starts = self.members.iter().map(|m| self.loops[*m].record.start_ns);
        let ends = self.members.iter().map(|m| self.loops[*m].record.end_ns);
        let (start_ns, end_ns) = (starts.max()?, ends.min()?);
        Some(GroupDocument {
            schema: GROUP_SCHEMA,
            members: ranked.iter().map(|m| self.loops[*m].name.to_owned()).collect(),
            same_record: same_record.iter().map(|m| self.loops[*m].name.to_owned()).collect(),
            followers: self.followers(&ranked, best, &source, period_s),
            judgements: ranked.iter().map(judged).collect(),
            source,
            period_s,
            window: Span { start_ns, end_ns, start: Moment(start_ns), end: Moment(end_ns) },
            p_value,
            pairs_compared,
            area: self.area(),
            version: crate::core::VERSION,
            daemon: None,
        })
    }

    /// Moves members before those that they are upstream of; a source named by the windows stays first.
    fn put_in_order(&self, ranked: &mut Vec<usize>, source: &Source, best: usize) {
        let order = Order::of(self.loops);
        match source.kind {
            SourceKind::Loop => {
                ranked.retain(|member| *member != best);
                order.sort(self.loops, ranked);
                ranked.insert(0, best);
            }
            _ => order.sort(self.loops, ranked),
        }
    }

    /// The first change made by the configured order, as a reason: a member that was moved back, and the one upstream of it
    /// that overtook it.
    fn reason_of_order(&self, before: &[usize], after: &[usize]) -> Option<String> {
        let name = |member: usize| self.loops[member].name;
        let passed = before.iter().zip(after).find(|(before, after)| before != after).map(|(before, _)| *before)?;
        let order = Order::of(self.loops);
        let mut ahead = after.iter().copied().take_while(|member| *member != passed);
        let first = ahead.find(|member| order.is_upstream(name(*member), name(passed)))?;
        Some(format!("{} is listed before {}, as the configuration puts it upstream", name(first), name(passed)))
    }

    /// Members with the same record as another member.
    fn same_record(&self) -> Vec<usize> {
        self.members.iter().copied().filter(|member| self.twin_of(*member).is_some()).collect()
    }

    fn twin_of(&self, member: usize) -> Option<usize> {
        let is_same = |other: &usize| same::is_same(self.loops[member].record, self.loops[*other].record);
        self.members.iter().copied().filter(|other| *other != member).find(is_same)
    }

    /// The area in which all members are configured.
    fn area(&self) -> Option<String> {
        let of = |member: &usize| self.loops[*member].area;
        let area = self.members.first().and_then(of)?;
        self.members.iter().all(|member| of(member) == Some(area)).then(|| area.to_owned())
    }

    fn judgement(&self, member: usize, place: Option<usize>, decision: &Decision, source: &Source) -> MemberJudgement {
        let l = self.loops[member];
        let twin = self.twin_of(member).map(|twin| self.loops[twin].name);
        let p_alone = l.assessment.p_calibrated.filter(|_| l.assessment.stiction.is_some());
        let converted = |p: f64| for_prevalence(p, l.assessment.prevalence);
        let is_source = source.kind == SourceKind::Loop && source.loop_name.as_deref() == Some(l.name);
        // A member beyond the candidates is less likely to stick, by its own window, than each of them.
        let judged = place.zip(p_alone).map(|(place, p)| decision.p_stiction(place, p, self.rules));
        let (p_calibrated, lowered) = judged.map_or((p_alone, false), |(p, lowered)| (Some(p), lowered));
        let called = p_calibrated.is_some_and(|p| p >= l.assessment.called_at());
        MemberJudgement {
            loop_name: l.name.to_owned(),
            p_source: place.map_or(0.0, |place| decision.p_source[place]),
            p_alone: p_alone.map(converted),
            p_stiction: p_calibrated.map(converted),
            p_calibrated,
            cause: twin
                .map_or_else(|| (!is_source).then(|| words::cause(source)).flatten(), |twin| Some(words::twice(twin))),
            masked: !is_source && twin.is_none() && (lowered || !called),
        }
    }

    fn followers(&self, ranked: &[usize], best: usize, source: &Source, period_s: f64) -> Vec<Follower> {
        let leads = source.kind == SourceKind::Loop;
        let of = |member: &usize| Follower {
            loop_name: self.loops[*member].name.to_owned(),
            lag_s: cycle::lag_s([best, *member].map(|m| self.loops[m].record), self.epoch_ns, period_s),
            share: self.cycles[*member].as_ref().map_or(0.0, |cycle| cycle.share),
        };
        ranked.iter().filter(|m| !leads || **m != best).map(of).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_shipped_rules_can_be_read_and_fit_the_figures() {
        let rules = Calibration::shipped();
        assert!(rules.chance.threshold.is_finite());
        for rule in [&rules.link, &rules.source, &rules.member] {
            assert!(rule.weights.len() == rule.means.len() && rule.means.len() == rule.scales.len());
        }
        let figures = [[0.0; Evidence::NAMES.len()]; 2];
        assert_eq!(source_figures(&figures)[0].len(), rules.source.weights.len());
        assert_eq!(source::names().count(), rules.source.weights.len());
        assert_eq!(member_figures(&figures[0], 0.0, 0.0).len(), rules.member.weights.len());
        assert_eq!(pair::expanded(&[0.0; 11]).len(), rules.link.weights.len());
    }

    #[test]
    fn one_record_under_two_names_is_said_and_names_no_source() {
        let mut seed = 7_u64;
        let mut noise = || {
            seed = seed.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
            (seed >> 40) as f64 / f64::from(1 << 24) - 0.5
        };
        let mut phase = 0.0;
        let (mut op, mut pv) = (Vec::new(), Vec::new());
        for _ in 0..1_200 {
            phase += core::f64::consts::PI / 30.0 * (1.0 + 0.2 * noise());
            op.push(50.0 + 3.0 * libm::sin(phase) + 0.1 * noise());
            pv.push(20.0 + libm::sin(phase - 0.8) + 0.1 * noise());
        }
        let record = Record::uniform(1.0, op, pv);
        let oscillation = crate::core::verdict::Oscillation {
            oscillating: true,
            period_s: Some(60.0),
            periods: Some(20.0),
            samples_per_period: Some(60.0),
            regularity: Some(5.0),
        };
        let assessment = Assessment {
            stiction: Some(false),
            p_calibrated: Some(0.1),
            ..Assessment::empty(crate::core::verdict::Window::of(&record), oscillation)
        };
        let of = |name| PlantLoop { name, record: &record, assessment: &assessment, area: None, upstream: &[] };
        let groups = assess_plant(&[of("A"), of("B")]);
        let [group] = &groups[..] else { panic!("{} groups", groups.len()) };
        assert_eq!((group.source.kind, &group.source.loop_name), (SourceKind::CannotTell, &None));
        assert_eq!(group.same_record, ["A", "B"]);
        assert!(headline(group).starts_with("A and B have the same record"), "{}", headline(group));
        for judged in &group.judgements {
            assert_eq!((judged.masked, judged.p_stiction), (false, judged.p_alone));
            assert!(judged.cause.as_ref().is_some_and(|cause| cause.starts_with("recorded twice")), "{judged:?}");
        }
    }
}
