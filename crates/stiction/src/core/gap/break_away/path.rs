//! The times of the slips, by a beam search.
//!
//! At each point at which the force on the resting stem is larger than ever since it came to rest, the stem may break away
//! or hold. A path is weighed by the probability of that and by what its run leaves of PV, so that its weight is, but for
//! what all have in common, the log probability of slips and PV together.

use super::bands::Bands;
use super::course::{Course, Slip};
use super::plant::Plant;
use crate::core::sim::process::Poles;

/// Paths that are followed.
const BEAM: usize = 100;
/// Squared error over its variance beyond which a point counts no more.
const OUTLYING: f64 = 25.0;
/// Force on a stem that has just come to rest, at least, OP units.
const LEAST_FORCE: f64 = 1e-9;

/// What the paths are weighed by.
pub(super) struct Search<'a> {
    /// OP and PV at each point.
    pub op: &'a [f64],
    pub pv: &'a [f64],
    pub plant: &'a Plant,
    pub bands: Bands,
    /// Variance of what the run leaves of PV.
    pub variance: f64,
    /// First point of PV that counts.
    pub from: usize,
}

/// A path on its way.
#[derive(Clone, Copy)]
struct Path {
    weight: f64,
    /// Log probability of its slips.
    slips: f64,
    stem: f64,
    /// Largest force since the stem came to rest.
    most: f64,
    poles: Poles,
    /// Its last slip in the list of all.
    last: Option<usize>,
}

/// A slip and the place of the one before it in the list of all.
#[derive(Clone, Copy)]
struct Link {
    slip: Slip,
    before: Option<usize>,
}

impl Search<'_> {
    /// The best course of a stem that begins at `start`; `None` where no path has a weight.
    pub(super) fn best(&self, start: f64) -> Option<Course> {
        let first = Path {
            weight: 0.0,
            slips: 0.0,
            stem: start,
            most: LEAST_FORCE,
            poles: self.plant.at_rest(start),
            last: None,
        };
        let (mut paths, mut next, mut links) = (vec![first], Vec::new(), Vec::new());
        for point in 0..self.op.len().saturating_sub(self.plant.lag()) {
            next.clear();
            paths.iter().for_each(|path| self.branch(path, point, &mut links, &mut next));
            core::mem::swap(&mut paths, &mut next);
            if paths.len() > BEAM {
                paths.select_nth_unstable_by(BEAM, |a, b| b.weight.total_cmp(&a.weight).then(a.last.cmp(&b.last)));
                paths.truncate(BEAM);
            }
        }
        let best = paths.iter().filter(|path| path.weight.is_finite()).max_by(|a, b| a.weight.total_cmp(&b.weight))?;
        let mut slips: Vec<Slip> = Vec::new();
        let mut link = best.last.map(|last| links[last]);
        while let Some(Link { slip, before }) = link {
            slips.push(slip);
            link = before.map(|before| links[before]);
        }
        slips.reverse();
        Some(self.course(start, slips, -best.slips))
    }

    /// What may become of a path at a point.
    fn branch(&self, path: &Path, point: usize, links: &mut Vec<Link>, out: &mut Vec<Path>) {
        let time = point as f64 / self.op.len() as f64 - 0.5;
        let force = self.op[point] - path.stem;
        let now = force.abs();
        let most = now.max(path.most);
        out.push(self.weighed(path, point, path.stem, most, self.bands.holds(time, path.most, most), path.last));
        if now > path.most {
            // The likeliest band of those that hold at the one force and not at the other.
            let band = self.bands.median_at(time).clamp(path.most, now).copysign(force);
            links.push(Link { slip: Slip { point, between: [path.most, now], band }, before: path.last });
            let stem = self.op[point] - self.plant.ratio * band;
            let rests = (self.op[point] - stem).abs().max(LEAST_FORCE);
            let log_p = self.bands.breaks(time, path.most, now);
            out.push(self.weighed(path, point, stem, rests, log_p, Some(links.len() - 1)));
        }
    }

    /// A path with its stem at the next place, weighed by PV.
    fn weighed(&self, path: &Path, point: usize, stem: f64, most: f64, log_p: f64, last: Option<usize>) -> Path {
        let mut poles = path.poles;
        let run = self.plant.step(&mut poles, stem, path.stem);
        let at = point + self.plant.lag();
        let error = self.pv[at] - self.plant.offset[at] - run;
        let counts = if at < self.from { 0.0 } else { 1.0 };
        let weight = path.weight + log_p - 0.5 * counts * (error * error / self.variance).min(OUTLYING);
        Path { weight, slips: path.slips + log_p, stem, most, poles, last }
    }

    fn course(&self, start: f64, slips: Vec<Slip>, cost: f64) -> Course {
        let mut course = Course { stem: vec![start; self.op.len()], last_band: vec![0.0; self.op.len()], slips, cost };
        for slip in &course.slips {
            course.last_band[slip.point..].fill(slip.band);
            course.stem[slip.point..].fill(self.op[slip.point] - self.plant.ratio * slip.band);
        }
        course
    }
}
