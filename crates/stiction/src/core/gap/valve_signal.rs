//! The valve signal of a model structure as the list of its steps: friction, what follows the stem, and what changes
//! with time.

use std::sync::Arc;

use super::candidate::Parameters;
use super::plan::{Drift, Plan};
use super::problem::Problem;
use crate::core::ident::kinetic_band::{Freedom, MIN_SLIPS, band_freedom};
use crate::core::ident::slip_search::problem::BehindStem;
use crate::core::sim::actuator::lag_path;
use crate::core::sim::slips::Stem;
use crate::core::sim::steps::{Path, Step, Steps};

/// Paths behind a positioner that are kept: a local search comes back to the lag it started from.
const PATHS: usize = 4;

/// Makes valve signals, with its own buffers.
#[derive(Debug, Default)]
pub(crate) struct ValveSignal {
    /// The steps, and the cells of the bands that give the same.
    pub steps: Steps,
    /// Level and direction before the first step.
    start: [f64; 2],
    mean: Vec<f64>,
    paths: Vec<(u64, Arc<Path>)>,
    behind: Behind,
}

impl ValveSignal {
    /// Makes the signal of a plan with these parameters, whose fd is moved into the band of its slips where the signal is
    /// not linear in it; `None` where the stem hardly moves.
    pub(crate) fn make(
        &mut self,
        problem: &Problem,
        plan: &Plan,
        theta: &mut Parameters,
        sign: f64,
    ) -> Option<Freedom> {
        let limits = problem.normalised.limits;
        let path = self.path(problem, plan);
        let n = problem.n();
        let mut freedom = Freedom { fd: [0.0; 2], fd_default: 0.0, sign, limits };
        let mut start = [path.values().first().copied().unwrap_or(0.0), 0.0];
        match plan.law {
            Some(law) => {
                let bands = [theta.s, theta.j];
                self.steps.run(&path, n, plan.stroke, law, bands, theta.first);
                if self.steps.slips < MIN_SLIPS {
                    return None;
                }
                let (level, direction) = Stem::before(theta.first, bands, plan.stroke, path.per_point()).signal();
                start = [level, direction];
                let cells = [self.steps.s_cell, self.steps.j_cell];
                freedom = band_freedom(cells, bands, sign, limits, plan.slip_end());
            }
            None => self.follow_op(&path, &mut start),
        }
        let fd = theta.fd.clamp(freedom.fd[0], freedom.fd[1]);
        if !plan.is_linear_in_fd() {
            theta.fd = fd;
        }
        self.start = self.behind.shape(plan, &mut self.steps, start, fd, &mut freedom, [n, n]);
        Some(freedom)
    }

    /// Level and direction at every one of `points` points.
    pub(crate) fn sample(&self, points: usize, samples: &mut [Vec<f64>; 2]) {
        self.steps.sample(self.start, points, samples);
    }

    /// OP on its way to the stem.
    fn path(&mut self, problem: &Problem, plan: &Plan) -> Arc<Path> {
        if plan.actuator.lag <= 0.0 {
            return Arc::clone(&problem.normalised.path);
        }
        let key = plan.actuator.lag.to_bits();
        if let Some(at) = self.paths.iter().position(|(k, _)| *k == key) {
            return Arc::clone(&self.paths[at].1);
        }
        let made = Arc::new(lag_path(&problem.normalised.path, plan.actuator.lag));
        if self.paths.len() == PATHS {
            self.paths.remove(0);
        }
        self.paths.push((key, Arc::clone(&made)));
        made
    }

    /// A valve without friction: OP averaged over each point.
    fn follow_op(&mut self, path: &Path, start: &mut [f64; 2]) {
        let m = path.per_point();
        let mean = &mut self.mean;
        mean.clear();
        mean.extend(path.values().chunks_exact(m).map(|p| p.iter().sum::<f64>() / m as f64));
        *start = [mean.first().copied().unwrap_or(0.0), 0.0];
        let none = [0.0, f64::INFINITY];
        self.steps.of_signal(mean, &[]);
        (self.steps.s_cell, self.steps.j_cell, self.steps.slips, self.steps.reversals) = (none, none, 0, 0);
    }
}

/// What stands between the stem and the process, with its own buffers.
#[derive(Debug, Default)]
struct Behind {
    work: Vec<Step>,
    samples: [Vec<f64>; 2],
}

impl Behind {
    /// Turns the steps of a stem that begins at `start` into those of the signal that the process gets, with this fd where
    /// the signal is not linear in it, and returns its first level and direction; `points` of the `whole` record are wanted.
    fn shape(
        &mut self,
        plan: &Plan,
        steps: &mut Steps,
        start: [f64; 2],
        fd: f64,
        freedom: &mut Freedom,
        [points, whole]: [usize; 2],
    ) -> [f64; 2] {
        let mut start = start;
        // Side by side, two lags leave fd open: it is found with their gains.
        if !plan.is_linear_in_fd() && (!plan.zero || plan.actuator.shapes_flow()) {
            start = [self.follow(plan, steps, start, fd, points), 0.0];
            freedom.fd = [0.0; 2];
            freedom.fd_default = 0.0;
        }
        if let Some([time, more]) = plan.switch {
            self.switch(steps, time, more, points);
        }
        if let Some(drift) = plan.drift {
            start = self.drift(drift, steps, start, [points, whole]);
        }
        start
    }

    /// Rate limit, stops, play and characteristic behind a stem that starts at `start`, in this order; the signal at the
    /// first point.
    fn follow(&mut self, plan: &Plan, steps: &mut Steps, start: [f64; 2], fd: f64, n: usize) -> f64 {
        let mut stem = start[0] - fd * start[1];
        let list = core::mem::replace(&mut steps.list, core::mem::take(&mut self.work));
        let out = &mut steps.list;
        out.clear();
        // Where the stem stands at the first point, there is what follows it.
        let first = list.partition_point(|s| s.point == 0);
        stem += list[..first].iter().map(|s| s.level - fd * s.direction).sum::<f64>();
        let mut memory = [stem; 2];
        let at_first = plan.actuator.flow(stem, &mut memory);
        let mut last = at_first;
        for (m, step) in list.iter().enumerate().skip(first) {
            stem += step.level - fd * step.direction;
            let until = list.get(m + 1).map_or(n, |s| s.point as usize);
            for k in step.point as usize..until {
                let now = plan.actuator.flow(stem, &mut memory);
                if now != last {
                    out.push(Step { point: k as u32, level: now - last, direction: 0.0 });
                    last = now;
                }
                if memory[0] == stem {
                    break;
                }
            }
        }
        self.work = list;
        at_first
    }

    /// From point `time` on the signal comes `more` points later.
    fn switch(&mut self, steps: &mut Steps, time: f64, more: f64, n: usize) {
        let list = core::mem::replace(&mut steps.list, core::mem::take(&mut self.work));
        let (at, whole, part) = switch_of(time, more, n);
        let out = &mut steps.list;
        out.clear();
        let mut put = |point: i64, level: f64, direction: f64| {
            if point < 0 || point >= n as i64 || (level == 0.0 && direction == 0.0) {
                return;
            }
            match out.last_mut() {
                Some(last) if i64::from(last.point) == point => {
                    last.level += level;
                    last.direction += direction;
                }
                _ => out.push(Step { point: point as u32, level, direction }),
            }
        };
        // What the later signal has gone through by then less what the earlier one has.
        let mut jump = [0.0; 2];
        for s in &list {
            let point = i64::from(s.point);
            if point < at {
                put(point, s.level, s.direction);
                jump = [jump[0] - s.level, jump[1] - s.direction];
            }
            for (place, share) in [(point + whole, 1.0 - part), (point + whole + 1, part)] {
                if place <= at {
                    jump = [jump[0] + share * s.level, jump[1] + share * s.direction];
                }
            }
        }
        put(at, jump[0], jump[1]);
        for s in &list {
            let point = i64::from(s.point);
            for (place, share) in [(point + whole, 1.0 - part), (point + whole + 1, part)] {
                if place > at {
                    put(place, share * s.level, share * s.direction);
                }
            }
        }
        self.work = list;
    }

    /// A gain that drifts: the signal times its course. Returns its first level and direction.
    fn drift(&mut self, drift: Drift, steps: &mut Steps, start: [f64; 2], [points, whole]: [usize; 2]) -> [f64; 2] {
        steps.sample(start, points, &mut self.samples);
        let [level, direction] = &mut self.samples;
        for ((level, direction), x) in level.iter_mut().zip(&mut *direction).zip(drift.course(whole)) {
            let gain = 1.0 + drift.change * x;
            *level *= gain;
            *direction *= gain;
        }
        steps.of_signal(level, direction);
        [level, direction].map(|signal| signal.first().copied().unwrap_or(0.0))
    }
}

/// What a plan has behind the stem, for the search of slips over a record of so many points; it holds fd where a pair of
/// bands puts it.
#[derive(Debug)]
pub(crate) struct HeldPlan {
    /// The plan.
    pub plan: Plan,
    /// Points of the record.
    pub points: usize,
}

impl BehindStem for HeldPlan {
    fn shape(&self, steps: &mut Steps, start: [f64; 2], freedom: &mut Freedom, points: usize) {
        let fd = freedom.fd_default;
        Behind::default().shape(&self.plan, steps, start, fd, freedom, [points, self.points]);
    }
}

/// Point at which a change of dead time happens, and by how much later the signal comes from then on, whole points and
/// the rest.
fn switch_of(time: f64, more: f64, n: usize) -> (i64, i64, f64) {
    let at = time.clamp(0.0, n.saturating_sub(1) as f64) as i64;
    let whole = more.floor();
    (at, whole as i64, more - whole)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::core::gap::candidate::MAX_PARAMS;
    use crate::core::gap::effects;
    use crate::core::gap::plain::PlainPass;
    use crate::core::gap::plain::tests::made_by;
    use crate::core::gap::problem::View;
    use crate::core::gap::structure::Structure;
    use crate::core::sim::actuator::Actuator;
    use crate::core::sim::slips::by_sample::Sequence;
    use crate::core::sim::slips::{Law, Stroke};

    /// The signal that a plan makes, sample by sample.
    fn made(problem: &Problem, plan: &Plan, theta: &Parameters) -> Vec<f64> {
        let mut signal = ValveSignal::default();
        let mut theta = *theta;
        signal.make(problem, plan, &mut theta, 1.0).unwrap();
        let mut samples = [Vec::new(), Vec::new()];
        signal.sample(problem.n(), &mut samples);
        let fd = if plan.is_linear_in_fd() { theta.fd } else { 0.0 };
        samples[0].iter().zip(&samples[1]).map(|(level, direction)| level - fd * direction).collect()
    }

    /// The stem by the law itself, OP value by OP value.
    fn stem(problem: &Problem, plan: &Plan, theta: &Parameters) -> Vec<f64> {
        let op = &problem.normalised.path;
        let lagged = lag_path(op, plan.actuator.lag.max(1e-9));
        let path = if plan.actuator.lag > 0.0 { &lagged } else { &**op };
        let m = path.per_point();
        let Some(law) = plan.law else {
            return path.values().chunks_exact(m).map(|point| point.iter().sum::<f64>() / m as f64).collect();
        };
        let made = Sequence::of(plan.stroke, law, path.values(), m, [theta.s, theta.j], theta.first);
        made.at.iter().zip(&made.direction).map(|(at, direction)| at - theta.fd * direction).collect()
    }

    /// What a plan has behind the stem, sample by sample.
    fn behind(plan: &Plan, stem: &[f64]) -> Vec<f64> {
        let (n, mut memory) = (stem.len(), [stem[0]; 2]);
        let flow: Vec<f64> = stem.iter().map(|v| plan.actuator.flow(*v, &mut memory)).collect();
        let later = |k: usize| {
            let [at, more] = plan.switch.unwrap_or([n as f64, 0.0]);
            let back = if k as f64 >= at { more } else { 0.0 };
            let value = |back: f64| flow[(k as f64 - back).clamp(0.0, n as f64 - 1.0) as usize];
            let part = back - back.floor();
            (1.0 - part) * value(back.floor()) + part * value(back.floor() + 1.0)
        };
        let gain: Vec<f64> =
            plan.drift.map_or_else(|| vec![1.0; n], |d| d.course(n).map(|x| 1.0 + d.change * x).collect());
        (0..n).map(|k| gain[k] * later(k)).collect()
    }

    #[test]
    fn the_signal_is_that_of_every_part_sample_by_sample_in_its_order() {
        let (problem, theta) = made_by(&Structure::base(Some(Law::He)), [0.0; MAX_PARAMS]);
        let actuators = [
            Actuator::NONE,
            Actuator { lag: 3.0, ..Actuator::NONE },
            Actuator { lag: 1.5, rate: 0.02, ..Actuator::NONE },
            Actuator { stops: [-0.3, 0.25], play: 0.08, ..Actuator::NONE },
            Actuator { rate: 0.05, bend: 0.7, ..Actuator::NONE },
        ];
        let valves = [
            (None, Stroke::FREE),
            (Some(Law::He), Stroke::FREE),
            (Some(Law::He), Stroke { uneven: 0.2, ..Stroke::FREE }),
            (Some(Law::Tracking), Stroke::FREE),
        ];
        let drift = Drift { change: 0.6, by_factor: true };
        for (law, stroke) in valves {
            for actuator in actuators {
                for (switch, drift) in
                    [(None, None), (Some([300.0, 4.3]), Some(drift)), (Some([222.0, -2.6]), None), (None, Some(drift))]
                {
                    let plan = Plan { stroke, actuator, switch, drift, ..Plan::base(law) };
                    let expected = behind(&plan, &stem(&problem, &plan, &theta));
                    let made = made(&problem, &plan, &theta);
                    for (k, (made, expected)) in made.iter().zip(&expected).enumerate() {
                        assert!((made - expected).abs() < 1e-9, "{plan:?} at {k}: {made} {expected}");
                    }
                }
            }
        }
    }

    #[test]
    fn the_flow_of_a_fit_is_that_before_the_dead_time_changes() {
        let base = Structure::base(Some(Law::He));
        let (problem, theta) = made_by(&base, [0.0; MAX_PARAMS]);
        let mut pass = PlainPass::new(&problem, 1.0);
        let of = pass.evaluate(&base, &theta, View::Plain).unwrap();
        let (run, flow) = pass.simulate(&base, &of).unwrap();
        let changed = Structure::with(Some(Law::He), effects::by_id("dead_time_change").unwrap());
        let mut later = of;
        later.theta.p[..2].copy_from_slice(&[350.0, 6.0]);
        let (later_run, later_flow) = pass.simulate(&changed, &later).unwrap();
        assert_eq!(flow, later_flow);
        assert!(run[..350] == later_run[..350] && run[400..] != later_run[400..]);
    }
}
