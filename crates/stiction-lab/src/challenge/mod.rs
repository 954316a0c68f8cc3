//! Test of the gap diagnosis on hidden causes: a generator with independent physics, a sealed truth, and a scorer that opens
//! both.
//!
//! The three parts share no truth. The generator ([`Deck`]) makes closed loops from a force balance with Stribeck friction at
//! 20 sub-steps per sample and processes outside the catalogue's forms, gives each an effect (in the catalogue, outside it, or
//! none), and writes the truth to a file whose SHA-256 is printed first. The diagnosis sees only the recordings: module `gap`
//! can import neither this module nor the generator's physics, which is tested. The scorer ([`score`]) rejects a truth with
//! another digest.
//!
//! Two [`Split`]s use separate random streams: thresholds are chosen on [`Split::A`] (development set), figures reported on
//! [`Split::B`] (test set). Odd seeds are A and even seeds B by default.
//!
//! | part of a deck with `k` cases per effect | cases |
//! |---|---|
//! | each effect of the catalogue | `k` |
//! | each effect outside the catalogue | `k` |
//! | two effects at once | a tenth of all with an effect |
//! | no effect | `10 k` |
//!
//! Within an effect the three sizes, limit cycles and set-point changes, and records with and without the start alternate;
//! noise (0.5 to 10 % of PV's standard deviation) and whether the valve position is recorded (one in four) are drawn.

pub mod artefact;
mod enter;
pub(crate) mod generator;
mod kinds;
pub(crate) mod plant;
pub mod real;
pub mod score;
mod truth;
pub(crate) mod valve;
pub mod windows;

pub use kinds::{Kind, Stage};
pub use truth::{Answer, Tampered, Truth, TruthCase, seal};

use crate::truth::draw::Draw;
use generator::Order;
use stiction::core::record::Record;

/// Development or test set: nothing chosen on one is reported on the same.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum Split {
    /// For choosing thresholds.
    A,
    /// For reported figures.
    B,
}

impl Split {
    /// The split of a seed: odd seeds are A, even ones B.
    #[must_use]
    pub const fn of_seed(seed: u64) -> Self {
        if seed % 2 == 1 { Self::A } else { Self::B }
    }

    /// Its name in random streams and documents.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::A => "A",
            Self::B => "B",
        }
    }
}

/// The cases of a challenge, in an order that reveals nothing.
#[derive(Debug, Clone)]
pub struct Deck {
    orders: Vec<Order>,
    /// Seed of all draws.
    pub seed: u64,
    /// Development or test set.
    pub split: Split,
    /// Cases per effect.
    pub cases: usize,
}

/// One case: the recording and its truth.
#[derive(Debug, Clone, PartialEq)]
pub struct Dealt {
    /// Name of the recording, which reveals nothing.
    pub name: String,
    /// The recording; with the valve position only if the truth says so.
    pub record: Record,
    /// The truth.
    pub truth: TruthCase,
}

impl Deck {
    /// The challenge of `seed` with `cases` cases per effect.
    #[must_use]
    pub fn new(seed: u64, split: Split, cases: usize) -> Self {
        let mut shuffle = Draw::new(seed, &format!("challenge/{}/order", split.name()));
        let mut orders = Vec::new();
        let mut order = |kinds: Vec<Kind>, name: &str, index: usize, turn: [u64; 3], mv: bool| {
            let at = |which: usize| index as u64 + turn[which];
            orders.push(Order {
                stream: format!("challenge/{}/{name}/{index}", split.name()),
                seed,
                kinds,
                size: (at(0) % 3) as usize,
                setpoint_moves: at(1) % 2 == 0,
                transient: (at(2) / 2) % 2 == 0,
                mv,
                periods: None,
            });
        };
        let turn = |draw: &mut Draw| [draw.seed() % 3, draw.seed() % 2, draw.seed() % 4];
        for kind in Kind::CATALOGUE.into_iter().chain(Kind::FOREIGN) {
            let now = turn(&mut shuffle);
            (0..cases).for_each(|i| order(vec![kind], kind.id(), i, now, shuffle.chance(0.25)));
        }
        let mut own = Draw::new(seed, &format!("challenge/{}/filter", split.name()));
        let now = turn(&mut own);
        (0..cases).for_each(|i| order(vec![Kind::FILTER], Kind::FILTER.id(), i, now, own.chance(0.25)));
        let singles = cases * (Kind::CATALOGUE.len() + Kind::FOREIGN.len());
        for i in 0..singles.div_ceil(9) {
            let pair = two(&mut shuffle);
            order(pair.to_vec(), "pair", i, [2, 0, 0], shuffle.chance(0.25));
        }
        (0..10 * cases).for_each(|i| order(vec![], "none", i, [0; 3], shuffle.chance(0.25)));
        // Fisher & Yates.
        for last in (1..orders.len()).rev() {
            let other = (shuffle.between(0.0, 1.0) * (last + 1) as f64) as usize;
            orders.swap(last, other.min(last));
        }
        Self { orders, seed, split, cases }
    }

    /// `cases` loops of each of these effects (none for `None`), with separate random streams.
    #[must_use]
    pub fn of(seed: u64, split: Split, kinds: &[Option<Kind>], cases: usize) -> Self {
        let one = |kind: Option<Kind>, index: usize| Order {
            stream: format!("challenge/{}/of/{}/{index}", split.name(), kind.map_or("none", Kind::id)),
            seed,
            kinds: kind.into_iter().collect(),
            size: index % 3,
            setpoint_moves: index.is_multiple_of(2),
            transient: (index / 2).is_multiple_of(2),
            mv: false,
            periods: None,
        };
        let orders = kinds.iter().flat_map(|kind| (0..cases).map(|index| one(*kind, index))).collect();
        Self { orders, seed, split, cases }
    }

    /// Number of cases.
    #[must_use]
    pub fn len(&self) -> usize {
        self.orders.len()
    }

    /// Whether there are no cases.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.orders.is_empty()
    }

    /// The case at `index`, bit-identical for the same deck. `None` beyond the end.
    #[must_use]
    pub fn deal(&self, index: usize) -> Option<Dealt> {
        let order = self.orders.get(index)?;
        let case = generator::case(order);
        let name = format!("loop-{:04}", index + 1);
        let mut record = Record::uniform(case.ts_s, case.op.clone(), case.pv.clone());
        record.sp = Some(case.sp.clone());
        if order.mv {
            record.mv = Some(transmitted(&case.mv, order.seed, &order.stream));
        }
        let truth = TruthCase::of(&name, order, &case);
        Some(Dealt { name, record, truth })
    }

    /// All truths in the order of the recordings, for sealing.
    #[must_use]
    pub fn truth(&self, cases: Vec<TruthCase>) -> Truth {
        Truth::new(self.seed, self.split, self.cases, cases)
    }
}

/// Two effects at different locations.
fn two(draw: &mut Draw) -> [Kind; 2] {
    loop {
        let mut pick = || draw.pick(&Kind::CATALOGUE, Kind::ExtraLag);
        let (a, b) = (pick(), pick());
        if a.stage() != b.stage() {
            return if a.id() < b.id() { [a, b] } else { [b, a] };
        }
    }
}

/// The stem position as a position transmitter sends it: with its own gain, sign, offset and a little noise.
fn transmitted(mv: &[f64], seed: u64, stream: &str) -> Vec<f64> {
    let mut draw = Draw::new(seed, &format!("{stream}/transmitter"));
    let (gain, zero) = (draw.sign() * draw.log_between(0.8, 1.25), draw.between(-5.0, 5.0));
    let noise = 0.02;
    mv.iter().map(|x| zero + gain * x + noise * draw.gaussian()).collect()
}

#[cfg(test)]
mod tests;
