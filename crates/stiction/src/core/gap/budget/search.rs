//! Effects added one by one under the noise model: the best of all shapes, refitted, as long as it gains enough.

use super::scan::Scan;
use super::series::{Run, Series};
use super::shapes::{APART, Shape};
use crate::core::gap::effects;
use crate::core::gap::noise::arx::{Design, Fit};
use crate::core::gap::set_point::explains;
use crate::core::gap::structure::BASE;
use crate::core::signal::stats;
use crate::core::sim::noise::{Noise, stream_of};

/// Nats that an effect gains at least, beyond its coefficients and the choice among its shapes. Chosen on every second real
/// recording (PLANTGAP's even ones), so that their resampled nulls name nothing.
pub(crate) const LEAST_GAIN: f64 = 8.0;
/// Most effects that are added, all loads that step or last a while being one, and most such loads.
const MOST_ADDED: usize = 3;
const MOST_LOADS: usize = 8;
/// How far apart the edges of two loads are at least, part of the record: a load that comes through a lag is not several.
const LOADS_APART: f64 = 1.0 / 60.0;
/// Shapes of a kind that are refitted: alone, beside those of a low order, and of a low order.
const REFITTED: [usize; 3] = [3, 2, 2];
/// Order of A that cannot swallow a sinusoid.
const LOW: usize = 2;
/// Steps by which a sinusoid's frequency is refined, cycles in the record.
const FINER: [f64; 3] = [0.25, 0.125, 0.0625];
/// Rounds of a sinusoid's fit that begins there.
const LOW_ROUNDS: usize = 5;
/// Largest deviation of the process' part that counts in drift and bend, standard deviations of PV.
const MOST_DRIVEN: f64 = 6.0;
/// Parameters of a sticking valve.
const BANDS: usize = 2;
/// Variance of it beyond which OP itself takes its place.
const FAR: f64 = 100.0;

/// What drives the process in the noise model.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Driver {
    /// OP, through B/A.
    Op,
    /// The stem of one of [`Series::runs`], through B/A.
    Stem(usize),
    /// One of [`Series::runs`]: the noise model is one of what it leaves.
    Run(usize),
}

/// The noise model of a series.
#[derive(Debug, Clone)]
pub struct Model {
    /// What is fitted.
    pub design: Design,
    /// The fit without effects.
    pub base: Fit,
    /// What valve and process make of OP, for drift and bend.
    pub driven: Vec<f64>,
    /// What drives it.
    pub driver: Driver,
    /// Nats by which that beats the next best; `None` where nothing else drives it.
    pub lead: Option<f64>,
    /// Log likelihood that OP adds to PV's own past, nats.
    pub gain_by_op: f64,
}

/// A driver with its fit.
#[derive(Debug, Clone)]
struct Choice {
    driver: Driver,
    design: Design,
    fit: Fit,
    bic: f64,
}

impl Choice {
    fn of(driver: Driver, design: Design, parameters: usize) -> Option<Self> {
        let (fit, bic) = design.best(parameters)?;
        Some(Self { driver, design, fit, bic })
    }
}

impl Model {
    /// Chooses the driver and the order by BIC; `None` where nothing can be fitted.
    #[must_use]
    pub(crate) fn of(series: &Series) -> Option<Self> {
        let alone = series.driven_by(None).best(0)?.0;
        let mut choices = vec![Choice::of(Driver::Op, series.driven_by(Some(&series.op)), 0)?];
        for (place, run) in series.runs.iter().enumerate() {
            let by_stem = |stem: &Vec<f64>| Choice::of(Driver::Stem(place), series.driven_by(Some(stem)), BANDS);
            choices.extend(run.stem.as_ref().and_then(by_stem));
        }
        let most = |choices: &[Choice]| choices.iter().max_by(|x, y| x.bic.total_cmp(&y.bic)).cloned();
        let by_u = most(&choices)?;
        // What a model runs away with is no part of PV.
        let usable = series.runs.iter().enumerate().filter(|(_, run)| stats::variance(&run.pv) < FAR);
        choices.extend(usable.filter_map(|(place, run)| {
            Choice::of(Driver::Run(place), Design::of_residual(&series.pv, &run.pv, series.period), run.parameters)
        }));
        let best = most(&choices)?;
        choices.retain(|choice| choice.driver != best.driver);
        let u = match best.driver {
            Driver::Op => Some(&series.op),
            Driver::Stem(place) | Driver::Run(place) => series.runs[place].stem.as_ref(),
        };
        let driven = best.design.simulated(&best.fit).filter(|x| stats::variance(x) < FAR).or_else(|| u.cloned())?;
        Some(Self {
            gain_by_op: by_u.fit.log_likelihood() - alone.log_likelihood(),
            driven: driven.iter().map(|d| d.clamp(-MOST_DRIVEN, MOST_DRIVEN)).collect(),
            lead: most(&choices).map(|next| best.bic - next.bic),
            design: best.design,
            base: best.fit,
            driver: best.driver,
        })
    }

    /// What drives it, as documents have it.
    #[must_use]
    pub(crate) fn driven_by(&self, series: &Series) -> &'static str {
        match self.driver {
            Driver::Op => "op",
            Driver::Stem(_) => "stem",
            Driver::Run(place) if series.runs[place].id == BASE => "base",
            Driver::Run(_) => "cause",
        }
    }

    /// The run that drives it where its model has an effect beside the base, and the base's own.
    #[must_use]
    pub fn cause<'s>(&self, series: &'s Series) -> Option<(&'s Run, &'s Run)> {
        let Driver::Run(place) = self.driver else { return None };
        let run = Some(&series.runs[place]).filter(|run| run.id != BASE)?;
        Some((run, series.runs.iter().find(|run| run.id == BASE)?))
    }

    /// A series as this model's own innovations, drawn anew, make it: nothing is in it but noise.
    #[must_use]
    pub fn resampled(&self, series: &Series, seed: u64) -> Series {
        let mut noise = Noise::new(seed, stream_of("gap/budget/resampled"));
        let e = &self.base.e;
        let mean = stats::mean(e);
        let drawn: Vec<f64> = (0..series.n()).map(|_| e[noise.below(e.len() as u64) as usize] - mean).collect();
        Series { pv: self.design.pv(&self.design.driven(&self.base, &drawn)), ..series.clone() }
    }

    /// The columns of a shape.
    #[must_use]
    pub(crate) fn columns(&self, shape: &Shape) -> Vec<Vec<f64>> {
        shape.columns(self.design.y.len(), &self.driven)
    }
}

/// An effect that was added.
#[derive(Debug, Clone, PartialEq)]
pub struct Added {
    /// What it is.
    pub shape: Shape,
    /// Nats that it gained when it was added, its cost taken off.
    pub gain: f64,
}

/// All effects that were added, and the fit with them.
#[derive(Debug, Clone)]
pub struct Searched {
    /// The effects, in the order of their adding.
    pub added: Vec<Added>,
    /// Their columns, one effect after the other.
    pub columns: Vec<Vec<f64>>,
    /// The fit with all of them.
    pub fit: Fit,
}

impl Searched {
    /// Which columns an effect has.
    #[must_use]
    pub(crate) fn places(&self, effect: usize) -> core::ops::Range<usize> {
        let count = |added: &Added| match &added.shape {
            Shape::Sinusoid(_) => 2,
            Shape::Outliers(at) => at.len(),
            _ => 1,
        };
        let from: usize = self.added[..effect].iter().map(count).sum();
        from..from + count(&self.added[effect])
    }

    /// The effects by part: steps and pulses are one, wherever the search found them.
    #[must_use]
    pub(crate) fn parts(&self) -> Vec<Vec<usize>> {
        let mut out: Vec<Vec<usize>> = Vec::new();
        let is_load = |k: usize| self.added[k].shape.edges().is_some();
        for k in 0..self.added.len() {
            match out.iter_mut().find(|part| is_load(k) && is_load(part[0])) {
                Some(loads) => loads.push(k),
                None => out.push(vec![k]),
            }
        }
        out
    }

    /// Whether another effect may be added.
    fn has_room_for(&self, shape: &Shape) -> bool {
        let parts = self.parts();
        let loads = parts.iter().find(|part| self.added[part[0]].shape.edges().is_some());
        match loads.filter(|_| shape.edges().is_some()) {
            Some(loads) => loads.len() < MOST_LOADS,
            None => parts.len() < MOST_ADDED,
        }
    }

    /// What effects add to PV, standard deviations.
    #[must_use]
    pub(crate) fn sum(&self, effects: &[usize]) -> Vec<f64> {
        let mut out = vec![0.0; self.columns.first().map_or(0, Vec::len)];
        for place in effects.iter().flat_map(|effect| self.places(*effect)) {
            let beta = self.fit.beta[place];
            out.iter_mut().zip(&self.columns[place]).for_each(|(out, x)| *out += beta * x);
        }
        out
    }
}

/// A shape with its fit.
struct Tried {
    shape: Shape,
    gain: f64,
    columns: Vec<Vec<f64>>,
    fit: Fit,
}

/// Adds effects to a model until none gains [`LEAST_GAIN`].
#[must_use]
pub(crate) fn search(series: &Series, model: &Model) -> Searched {
    let mut so_far = Searched { added: Vec::new(), columns: Vec::new(), fit: model.base.clone() };
    while let Some(best) = best(series, model, &so_far).filter(|best| best.gain >= LEAST_GAIN) {
        so_far.added.push(Added { shape: best.shape, gain: best.gain });
        so_far.columns = best.columns;
        so_far.fit = best.fit;
    }
    so_far
}

/// The shape that gains most beside those that are there.
fn best(series: &Series, model: &Model, so_far: &Searched) -> Option<Tried> {
    let n = series.n();
    let scan = Scan::new(&so_far.fit, n);
    let low = (so_far.fit.order() > LOW).then(|| {
        let design = model.design.with_y(model.design.less(&so_far.columns, &so_far.fit.beta));
        design.fit(LOW, &[], None)
    });
    let low = low.flatten();
    let frequencies = scan.frequencies(series);
    let shapes = candidates(series, &scan, low.as_ref().map(|fit| Scan::new(fit, n)).as_ref(), &frequencies);
    let in_run = |shape: &Shape| {
        let run = model.cause(series).map(|(run, _)| run.id.as_str());
        matches!(shape, Shape::Drift | Shape::Bend | Shape::Neighbour(..))
            && effects::parts(run.unwrap_or_default()).any(|id| id == shape.full_id())
    };
    let there = |shape: &Shape| in_run(shape) || so_far.added.iter().any(|a| is_same(shape, &a.shape, n));
    let try_one = |shape: Shape| {
        let mut columns = so_far.columns.clone();
        columns.extend(model.columns(&shape));
        let fit = refit(
            model,
            &columns,
            low.as_ref().filter(|_| matches!(shape, Shape::Sinusoid(_) | Shape::Neighbour(..))),
        )?;
        let cost = shape.cost(n, scan.tried(&shape, frequencies.len()));
        let gain = fit.log_likelihood() - so_far.fit.log_likelihood() - cost;
        if follows_set_point(series, &shape, fit.beta.last().copied().unwrap_or(0.0)) {
            return None;
        }
        Some(Tried { shape, gain, columns, fit })
    };
    let all = shapes.into_iter().filter(|s| so_far.has_room_for(s) && !there(s)).filter_map(try_one);
    let mut best = all.max_by(|x, y| x.gain.total_cmp(&y.gain))?;
    // Between the frequencies that are looked through lies a better one.
    for step in FINER {
        let Shape::Sinusoid(frequency) = best.shape else { break };
        if best.gain < LEAST_GAIN {
            break;
        }
        let beside = [-step, step].map(|step| Shape::Sinusoid(frequency + step / n as f64));
        best = beside.into_iter().filter_map(try_one).chain([best]).max_by(|x, y| x.gain.total_cmp(&y.gain))?;
    }
    Some(best)
}

/// Whether a load begins or ends while PV answers a move of the set point that may be what is seen; `size` as fitted.
fn follows_set_point(series: &Series, shape: &Shape, size: f64) -> bool {
    let answers = |at: usize| at != usize::MAX && explains(&series.sp_moves, (at as f64, size), series.answer);
    match shape {
        Shape::Ramp(from) => answers(*from),
        shape => shape.edges().is_some_and(|edges| edges.into_iter().any(answers)),
    }
}

/// Whether a shape is one that is there already.
pub(super) fn is_same(shape: &Shape, there: &Shape, n: usize) -> bool {
    if let (Some(own), Some(other)) = (shape.edges(), there.edges()) {
        let least = (LOADS_APART * n as f64) as usize;
        return own.iter().any(|x| *x != usize::MAX && other.iter().any(|y| x.abs_diff(*y) < least));
    }
    match (shape, there) {
        (Shape::Sinusoid(own), Shape::Sinusoid(other)) => (own - other).abs() < APART / n as f64,
        _ => shape.full_id() == there.full_id(),
    }
}

/// The shapes that are worth a fit.
fn candidates(series: &Series, scan: &Scan<'_>, low: Option<&Scan<'_>>, frequencies: &[f64]) -> Vec<Shape> {
    let [alone, beside, of_low] = REFITTED;
    let most = if low.is_some() { beside } else { alone };
    let mut out = vec![Shape::Drift, Shape::Bend];
    let mut add = |shapes: Vec<Shape>| {
        for shape in shapes {
            if !out.contains(&shape) {
                out.push(shape);
            }
        }
    };
    for (scan, most) in [(Some(scan), most), (low, of_low)] {
        let Some(scan) = scan else { continue };
        add(scan.steps(most));
        add(scan.pulses(most));
        add(scan.ramps(most));
        add(scan.sinusoids(frequencies, most));
        add(scan.neighbours(series, most));
    }
    add(scan.outliers().into_iter().collect());
    out
}

/// The fit with effects, begun from the base's A and, with `low`, from an A that holds no sinusoid.
pub(super) fn refit(model: &Model, columns: &[Vec<f64>], low: Option<&Fit>) -> Option<Fit> {
    let order = model.base.order();
    let own = model.design.fit(order, columns, Some(&model.base));
    let from_low = low.and_then(|low| model.design.fit_in(order, columns, Some(low), LOW_ROUNDS));
    own.into_iter().chain(from_low).max_by(|x, y| x.log_likelihood().total_cmp(&y.log_likelihood()))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::core::gap::budget::tests::{Loop, named};

    #[test]
    fn each_effect_is_found_beside_a_wandering_disturbance() {
        let plain = Loop::default();
        assert!(named(&plain.series(1)).is_empty(), "{:?}", named(&plain.series(1)));
        let step = named(&Loop { step: 1.5, ..plain }.series(1));
        assert!(matches!(step[..], [Shape::Step(at)] if at.abs_diff(500) <= 2), "{step:?}");
        let wave = named(&Loop { wave: 0.6, ..plain }.series(1));
        assert!(matches!(wave[..], [Shape::Sinusoid(f)] if (1.0 / f - 23.0).abs() < 0.5), "{wave:?}");
        let wild = named(&Loop { wild: 3.0, ..plain }.series(1));
        assert!(matches!(&wild[..], [Shape::Outliers(at)] if at.len() == 8), "{wild:?}");
        let drift = named(&Loop { drift: 0.8, ..plain }.series(1));
        assert_eq!(drift, [Shape::Drift]);
    }
}
