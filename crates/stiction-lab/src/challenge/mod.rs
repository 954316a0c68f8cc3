//! The check of the gap diagnosis on causes that it is not told: a generator whose physics is not the diagnosis's, a
//! sealed truth, and a scorer that opens both.
//!
//! Three parts share no truth. The generator ([`Deck`]) makes closed loops from a force balance with Stribeck friction
//! at 20 sub-steps a sample and processes that no catalogue writes down in that form, gives each an effect (of the
//! catalogue, of none, or no effect at all), and tells the truth to a file whose SHA-256 is printed first. The diagnosis
//! sees recordings only: the room `gap` can import neither this room nor the generator's physics, which a test holds.
//! The scorer ([`score`]) refuses a truth whose digest is another.
//!
//! Two [`Split`]s draw from streams of their own: thresholds are chosen on [`Split::A`], figures reported on
//! [`Split::B`]. Odd seeds are A and even seeds B, unless the caller says otherwise.
//!
//! | shares of a deck with `k` cases an effect | cases |
//! |---|---|
//! | each effect that the catalogue promises | `k` |
//! | each effect that no catalogue has | `k` |
//! | two effects at once | a tenth of all with an effect |
//! | no effect | `10 k` |
//!
//! Within an effect the three sizes, limit cycles and set-point moves, records with and without the start take turns;
//! noise (0.5 to 10 % of PV's standard deviation) and whether the valve position is recorded (one in four) are drawn.

pub mod artefact;
mod enter;
mod generate;
mod kinds;
mod plant;
pub mod real;
pub mod score;
mod truth;
mod valve;

pub use kinds::{Kind, Stage};
pub use truth::{Answer, Tampered, Truth, TruthCase, seal};

use crate::truth::draw::Draw;
use generate::Order;
use stiction::record::Record;

/// Which half of all cases: nothing chosen on one may be reported on the same.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum Split {
    /// For thresholds.
    A,
    /// For the figures that are printed.
    B,
}

impl Split {
    /// The split of a seed: odd seeds are A, even ones B.
    #[must_use]
    pub const fn of_seed(seed: u64) -> Self {
        if seed % 2 == 1 { Self::A } else { Self::B }
    }

    /// Its name in streams and documents.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::A => "A",
            Self::B => "B",
        }
    }
}

/// The orders of a challenge, in an order that tells nothing.
#[derive(Debug, Clone)]
pub struct Deck {
    orders: Vec<Order>,
    /// Seed of all draws.
    pub seed: u64,
    /// Which half.
    pub split: Split,
    /// Cases an effect.
    pub cases: usize,
}

/// One case: the recording, and what is true of it.
#[derive(Debug, Clone, PartialEq)]
pub struct Dealt {
    /// Name of the recording, which tells nothing.
    pub name: String,
    /// What is recorded; the valve position only where the truth says so.
    pub record: Record,
    /// The truth.
    pub truth: TruthCase,
}

impl Deck {
    /// The challenge of `seed` with `cases` cases an effect.
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

    /// How many cases it has.
    #[must_use]
    pub fn len(&self) -> usize {
        self.orders.len()
    }

    /// Whether it has none.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.orders.is_empty()
    }

    /// The case at `index`; the same for the same deck, to the last bit. None behind the end.
    #[must_use]
    pub fn deal(&self, index: usize) -> Option<Dealt> {
        let order = self.orders.get(index)?;
        let case = generate::case(order);
        let name = format!("loop-{:04}", index + 1);
        let mut record = Record::uniform(case.ts_s, case.op.clone(), case.pv.clone());
        record.sp = Some(case.sp.clone());
        if order.mv {
            record.mv = Some(transmitted(&case.mv, order.seed, &order.stream));
        }
        let truth = TruthCase::of(&name, order, &case);
        Some(Dealt { name, record, truth })
    }

    /// All truths in the order of the recordings, to be sealed.
    #[must_use]
    pub fn truth(&self, cases: Vec<TruthCase>) -> Truth {
        Truth::new(self.seed, self.split, self.cases, cases)
    }
}

/// Two effects of different stages.
fn two(draw: &mut Draw) -> [Kind; 2] {
    loop {
        let mut pick = || draw.pick(&Kind::CATALOGUE, Kind::ExtraLag);
        let (a, b) = (pick(), pick());
        if a.stage() != b.stage() {
            return if a.id() < b.id() { [a, b] } else { [b, a] };
        }
    }
}

/// The stem position as a position transmitter sends it: its own gain, sign and zero, and a little noise.
fn transmitted(mv: &[f64], seed: u64, stream: &str) -> Vec<f64> {
    let mut draw = Draw::new(seed, &format!("{stream}/transmitter"));
    let (gain, zero) = (draw.sign() * draw.log_between(0.8, 1.25), draw.between(-5.0, 5.0));
    let noise = 0.02;
    mv.iter().map(|x| zero + gain * x + noise * draw.gaussian()).collect()
}

#[cfg(test)]
mod tests;
