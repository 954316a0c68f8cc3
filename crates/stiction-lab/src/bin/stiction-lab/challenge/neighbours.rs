//! `stiction-lab challenge neighbours`: offers other loops to the diagnosis, with the acting loop withheld and then included
//! among unrelated loops.

use std::collections::BTreeMap;

use serde_json::json;

use super::answer::ask_for;
use stiction::core::detect::oscillation;
use stiction::core::gap::effects::neighbour::id_of;
use stiction::core::gap::{DEFAULT_EVALUATIONS, GapOptions, Neighbour, UNKNOWN, compare_neighbours};
use stiction::core::record::Record;
use stiction_lab::challenge::{Deck, Split};
use stiction_lab::plants::{Relation, disturbed, unrelated_loops};
use stictiond::cli::{Format, Outcome, UsageError, on_all_cores, say};

/// How many loops of each kind, and how many unrelated loops beside each.
#[derive(Debug, clap::Args)]
#[command(after_help = "Example:
  stiction-lab challenge neighbours --seed 2 --cases 40
Odd seeds are for development, even ones for reported figures.")]
pub(super) struct Args {
    /// Seed of all random draws.
    #[arg(long)]
    seed: u64,
    /// Loops that a neighbour drives, as many that drive one, and as many without.
    #[arg(long, default_value_t = 20)]
    cases: u64,
    /// Loops of nearly the same period that have nothing to do with the diagnosed one.
    #[arg(long, default_value_t = 50)]
    unrelated: usize,
    /// Most model responses per search.
    #[arg(long, default_value_t = DEFAULT_EVALUATIONS)]
    evaluations: u64,
    /// Only compare the loops, without a search for the base: what the noise model names, with OP for the stem. A second a
    /// case instead of a minute.
    #[arg(long)]
    without_search: bool,
}

/// Kind of loop in a case.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
enum Kind {
    /// Another loop acts on it.
    Driven,
    /// It acts on another loop.
    Driving,
    /// Unrelated to any other loop: the loops of the challenge.
    Alone,
}

impl Kind {
    const ALL: [Self; 3] = [Self::Driven, Self::Driving, Self::Alone];

    const fn name(self) -> &'static str {
        match self {
            Self::Driven => "driven",
            Self::Driving => "driving",
            Self::Alone => "alone",
        }
    }
}

/// Name of the other loop among the unrelated ones.
const OTHER: &str = "OTHER";

/// The counted part of an answer.
#[derive(Debug, Clone)]
struct Said {
    id: String,
    probability: f64,
    confirmed: bool,
    p_value: Option<f64>,
    share: Option<f64>,
    closed_pct: Option<f64>,
    over_floor: Option<f64>,
    fitted: usize,
}

impl Said {
    fn names(&self, other: bool) -> bool {
        let named = stiction::core::gap::effects::parts(&self.id).find(|part| part.starts_with("neighbour("));
        named.is_some_and(|part| (part == format!("neighbour({OTHER})")) == other)
    }

    fn json(&self) -> serde_json::Value {
        json!({"id": self.id, "probability": self.probability, "confirmed": self.confirmed, "p_value": self.p_value,
            "share": self.share, "closed_pct": self.closed_pct})
    }
}

/// One loop with its answers: alone, among unrelated loops, and with the other loop among them.
#[derive(Debug)]
struct Case {
    kind: Kind,
    name: String,
    alone: Said,
    withheld: Said,
    revealed: Option<Said>,
    /// Whether the diagnosed loop's own valve sticks, if another loop acts on it.
    sticks: Option<bool>,
}

/// Runs all cases and prints the counts.
///
/// # Errors
/// A loop cannot be diagnosed.
pub(super) fn run(args: &Args, format: Format) -> anyhow::Result<Outcome> {
    if args.cases == 0 {
        return Err(UsageError("--cases must be 1 or more".to_owned()).into());
    }
    let items: Vec<(Kind, u64)> = Kind::ALL.into_iter().flat_map(|k| (0..args.cases).map(move |n| (k, n))).collect();
    let name = |item: &(Kind, u64)| format!("{} {}", item.0.name(), item.1);
    let made: anyhow::Result<Vec<Option<Case>>> =
        on_all_cores(&items, name, |(kind, number)| case(args, *kind, *number)).into_iter().collect();
    let cases: Vec<Case> = made?.into_iter().flatten().collect();
    match format {
        Format::Text => say(table(args, &cases))?,
        Format::Json => {
            for case in &cases {
                say(
                    json!({"schema": "stictiond.challenge.neighbours.v1", "kind": case.kind.name(), "name": case.name,
                    "alone": case.alone.json(), "withheld": case.withheld.json(),
                    "revealed": case.revealed.as_ref().map(Said::json)}),
                )?;
            }
        }
    }
    Ok(Outcome::Done)
}

/// A loop of a kind.
struct Drawn {
    record: Record,
    other: Option<Record>,
    periods_s: Vec<f64>,
    what: String,
    sticks: Option<bool>,
}

/// The loop of a kind and number, with the other loop.
fn drawn(args: &Args, kind: Kind, number: u64) -> Option<Drawn> {
    let split = Split::of_seed(args.seed);
    match kind {
        Kind::Alone => {
            // As many cases as needed from the deck for every kind of effect to occur.
            let deck = Deck::new(args.seed, split, args.cases.div_ceil(40).max(1) as usize);
            let dealt = deck.deal(number as usize)?;
            let periods_s = vec![dealt.truth.period * dealt.record.ts_s];
            Some(Drawn { record: dealt.record, other: None, periods_s, what: dealt.truth.effect, sticks: None })
        }
        _ => {
            let relation = if kind == Kind::Driven { Relation::Acts } else { Relation::Follows };
            let case = disturbed(split.name(), args.seed, number, relation);
            let what = if case.sticks { "its own valve sticks" } else { "its own valve is healthy" };
            Some(Drawn {
                record: case.record,
                other: Some(case.other),
                periods_s: case.periods_s.to_vec(),
                what: what.to_owned(),
                sticks: (kind == Kind::Driven).then_some(case.sticks),
            })
        }
    }
}

fn case(args: &Args, kind: Kind, number: u64) -> anyhow::Result<Option<Case>> {
    let Some(Drawn { record, other, periods_s, what, sticks }) = drawn(args, kind, number) else { return Ok(None) };
    let place = 1000 * kind as u64 + number;
    let mut others = Vec::new();
    for (i, unrelated) in unrelated_loops(args.seed, place, args.unrelated, &record, &periods_s).iter().enumerate() {
        others.push(Neighbour::of(&format!("S{i:02}"), unrelated, &record)?);
    }
    let ask = |neighbours: Vec<Neighbour>| -> anyhow::Result<Said> {
        if args.without_search {
            return Ok(compared(&record, &neighbours));
        }
        let options = GapOptions { budget_evaluations: args.evaluations, neighbours, ..GapOptions::default() };
        let (made, document) = ask_for("loop", &record, &options)?;
        Ok(Said {
            id: document.cause.id.clone(),
            probability: document.cause.probability,
            confirmed: document.cause.confirmed,
            p_value: document.neighbours.as_ref().and_then(|n| n.p_value),
            share: document.neighbours.as_ref().and_then(|n| n.share),
            fitted: document.neighbours.as_ref().map_or(0, |n| n.fitted.len()),
            closed_pct: document.named().and_then(|e| e.closed_pct),
            over_floor: made.findings.floor.noise_floor.map(|floor| made.findings.base.rmse_train / floor),
        })
    };
    let withheld = ask(others.clone())?;
    // Neighbours that are not fitted do not change any other result, as a test verifies.
    let alone = if withheld.fitted == 0 || args.without_search { withheld.clone() } else { ask(Vec::new())? };
    let revealed = match other {
        None => None,
        Some(other) => {
            let at = (number as usize * 7) % (others.len() + 1);
            others.insert(at, Neighbour::of(OTHER, &other, &record)?);
            Some(ask(others)?)
        }
    };
    Ok(Some(Case { kind, name: format!("{} {number} ({what})", kind.name()), alone, withheld, revealed, sticks }))
}

/// Result of the noise model alone, without a search.
fn compared(record: &Record, neighbours: &[Neighbour]) -> Said {
    let period = oscillation::detect(&record.op(), &record.pv).map(|o| o.period_points);
    let compared = compare_neighbours(record, neighbours, period, GapOptions::default().seed);
    let acts = compared.as_ref().and_then(|c| c.acts.as_deref());
    Said {
        id: acts.map_or_else(|| UNKNOWN.to_owned(), id_of),
        probability: 0.0,
        confirmed: acts.is_some(),
        p_value: compared.as_ref().and_then(|c| c.p_value),
        share: compared.as_ref().and_then(|c| c.share),
        closed_pct: None,
        over_floor: None,
        fitted: 0,
    }
}

/// Ratio of base error to noise floor from which there is something to explain.
const SHOWS: f64 = 1.35;

fn table(args: &Args, cases: &[Case]) -> String {
    let mut lines = vec![format!("seed {}, {} unrelated loops", args.seed, args.unrelated)];
    let mut row = |what: &str, kind: Kind, of: &dyn Fn(&Case) -> Option<bool>| {
        let told: Vec<bool> = cases.iter().filter(|c| c.kind == kind).filter_map(of).collect();
        if told.is_empty() {
            return;
        }
        let found = told.iter().filter(|x| **x).count();
        lines.push(format!("{:<8} {what:<64} {found}/{}", kind.name(), told.len()));
    };
    let shows = |c: &Case| c.alone.over_floor.is_some_and(|over| over >= SHOWS);
    // Without a search there is neither a base nor an answer to compare.
    let searched = |said: bool| (!args.without_search).then_some(said);
    row("something to explain (base's error over the floor 1.35 or more)", Kind::Driven, &|c| searched(shows(c)));
    let revealed = |c: &Case, of: &dyn Fn(&Said) -> bool| c.revealed.as_ref().map(of);
    row("revealed: the neighbour named", Kind::Driven, &|c| revealed(c, &|s| s.names(true)));
    row("  where there is something to explain", Kind::Driven, &|c| {
        shows(c).then(|| revealed(c, &|s| s.names(true)))?
    });
    for (what, sticks) in [("  its own valve healthy", false), ("  its own valve sticks", true)] {
        row(what, Kind::Driven, &|c| c.sticks.filter(|s| *s == sticks).and(revealed(c, &|s| s.names(true))));
    }
    row("revealed: p-value 0.05 or less", Kind::Driven, &|c| revealed(c, &|s| s.p_value.is_some_and(|p| p <= 0.05)));
    row("revealed: named with probability 0.5 or more", Kind::Driven, &|c| {
        searched(revealed(c, &|s| s.names(true) && s.probability >= 0.5)?)
    });
    row("revealed: an unrelated loop named", Kind::Driven, &|c| revealed(c, &|s| s.names(false)));
    row("withheld: an unrelated loop named", Kind::Driven, &|c| Some(c.withheld.names(false)));
    row("withheld: the answer of no neighbours", Kind::Driven, &|c| searched(c.withheld.id == c.alone.id));
    row("follower among unrelated loops: the follower named", Kind::Driving, &|c| revealed(c, &|s| s.names(true)));
    row("follower among unrelated loops: an unrelated loop named", Kind::Driving, &|c| {
        revealed(c, &|s| s.names(false))
    });
    row("follower among unrelated loops: the answer of no neighbours", Kind::Driving, &|c| {
        searched(revealed(c, &|s| s.id == c.alone.id)?)
    });
    row("unrelated loops: one named", Kind::Driving, &|c| Some(c.withheld.names(false)));
    row("unrelated loops: one named", Kind::Alone, &|c| Some(c.withheld.names(false)));
    row("unrelated loops: the answer of no neighbours", Kind::Alone, &|c| searched(c.withheld.id == c.alone.id));
    let mut instead: BTreeMap<String, usize> = BTreeMap::new();
    for said in cases.iter().filter(|c| c.kind == Kind::Driven).filter_map(|c| c.revealed.as_ref()) {
        if !said.names(true) {
            *instead.entry(said.id.clone()).or_default() += 1;
        }
    }
    let each: Vec<String> = instead.iter().map(|(id, n)| format!("{id} {n}")).collect();
    lines.push(format!("driven, revealed, answered otherwise: {}", each.join(", ")));
    lines.join("\n")
}
