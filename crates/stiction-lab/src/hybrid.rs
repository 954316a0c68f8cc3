//! Known effects in real loops: the recorded disturbance and the controller's actions beyond PID are kept, and the loop is
//! simulated in closed loop through process and PID with the effect added, so that OP reacts.
//!
//! The simulation computes differences from the recording: PV's by A and B of the noise model from the difference in OP, OP's
//! by the controller identified from the recording. Without an effect the result is the recording itself.

use crate::truth::draw::Draw;
use stiction::core::gap::budget::Budget;
use stiction::core::gap::budget::search::Model;
use stiction::core::gap::budget::series::Series;
use stiction::core::ident::controller::Reading;
use stiction::core::record::Record;
use stiction::core::signal::stats::std_dev;
use stiction::core::signal::{detrend, stats};

/// Effects that can be added.
pub const EFFECTS: [&str; 5] = ["step_load", "outliers", "sinusoid", "ramp", "gain_drift"];
/// Deviations of PV and of OP, relative to the recording's own, from which the closed loop counts as unstable.
const LARGEST: [f64; 2] = [4.0, 20.0];
/// Deviations at which the simulation stops.
const FAR: f64 = 1e6;

/// A recording with its variance budget, which closes its loop.
#[derive(Debug, Clone, Copy)]
pub struct Loop<'a> {
    /// The recording.
    pub record: &'a Record,
    /// The recording's budget, computed without a base.
    pub budget: &'a Budget,
}

/// Effect on a loop at each point: addition to PV, standard deviations of PV, and factor on the process's response to OP.
struct Entry {
    added: Vec<f64>,
    gain: Vec<f64>,
}

impl Entry {
    /// An effect of full size times `size`, at a random position and of random sign.
    fn draw(effect: &str, size: f64, n: usize, draw: &mut Draw) -> Self {
        let mut out = Self { added: vec![0.0; n], gain: vec![1.0; n] };
        let sign = draw.sign();
        let part = |k: usize| k as f64 / n as f64;
        match effect {
            "step_load" => {
                let at = draw.between(0.35, 0.65);
                (0..n).filter(|k| part(*k) >= at).for_each(|k| out.added[k] = 2.0 * size * sign);
            }
            "ramp" => (0..n).for_each(|k| out.added[k] = 3.0 * size * sign * part(k)),
            "sinusoid" => {
                let cycles = draw.between(3.2, 5.7);
                let wave = draw.sine(n as f64 / cycles, n);
                out.added.iter_mut().zip(wave).for_each(|(x, w)| *x = 0.9 * size * w);
            }
            "outliers" => {
                for x in &mut out.added {
                    if draw.chance(0.01) {
                        *x = size * draw.sign() * draw.between(3.0, 6.0);
                    }
                }
            }
            _ => (0..n).for_each(|k| out.gain[k] = 1.0 + 0.8 * size * sign * (part(k) - 0.5)),
        }
        out
    }
}

impl Loop<'_> {
    fn series(&self) -> &Series {
        &self.budget.series
    }

    fn model(&self) -> &Model {
        &self.budget.model
    }

    /// The recording with an effect in PV alone: OP does not react.
    #[must_use]
    pub fn in_pv(&self, effect: &str, size: f64, seed: u64) -> Record {
        let series = self.series();
        let entry = Entry::draw(effect, size, series.n(), &mut draw_of(effect, seed));
        let x = &self.model().driven;
        let change = |k: usize| entry.added[k] + (entry.gain[k] - 1.0) * x[k];
        let pv: Vec<f64> = (0..series.n()).map(|k| series.pv[k] + change(k)).collect();
        self.recorded(&series.op.clone(), &pv)
    }

    /// The recording with a step (size in standard deviations of PV) after the share `at` of it, in PV alone.
    #[must_use]
    pub fn with_step(&self, size: f64, at: f64) -> Record {
        let series = self.series();
        let from = (at * series.n() as f64) as usize;
        let pv: Vec<f64> = series.pv.iter().enumerate().map(|(k, y)| if k >= from { y + size } else { *y }).collect();
        self.recorded(&series.op.clone(), &pv)
    }

    /// The recording with a sinusoid of given amplitude (standard deviations of PV), frequency (cycles per point) and phase
    /// (turns) in PV alone.
    #[must_use]
    pub fn with_wave(&self, size: f64, frequency: f64, phase: f64) -> Record {
        let series = self.series();
        let wave = |k: usize| size * libm::sin(core::f64::consts::TAU * (frequency * k as f64 + phase));
        let pv: Vec<f64> = series.pv.iter().enumerate().map(|(k, y)| y + wave(k)).collect();
        self.recorded(&series.op.clone(), &pv)
    }

    /// A realisation of the noise model with resampled innovations: it contains only noise.
    #[must_use]
    pub fn null(&self, seed: u64) -> Record {
        let series = self.model().resampled(self.series(), seed);
        self.recorded(&series.op, &series.pv)
    }

    /// The recording's loop, simulated in closed loop with an effect; `None` if it is unstable.
    #[must_use]
    pub fn closed(&self, effect: &str, size: f64, controller: &Reading, seed: u64) -> Option<Record> {
        let series = self.series();
        let entry = Entry::draw(effect, size, series.n(), &mut draw_of(effect, seed));
        let (op, pv) = self.run(&entry, controller)?;
        let stable = std_dev(&pv) < LARGEST[0] * std_dev(&series.pv) && std_dev(&op) < LARGEST[1] * std_dev(&series.op);
        stable.then(|| self.recorded(&op, &pv))
    }

    /// OP and PV in standard deviations.
    fn run(&self, entry: &Entry, controller: &Reading) -> Option<(Vec<f64>, Vec<f64>)> {
        let (series, model) = (self.series(), self.model());
        let (n, fit, width) = (series.n(), &model.base, model.design.width);
        let scale = series.of_pv[1] / series.op_deviation;
        let kc = controller.kc * scale;
        let by_time = if controller.ti_s.is_finite() { series.point_s / controller.ti_s } else { 0.0 };
        let gains = [kc, kc * by_time, kc * controller.td_s / series.point_s];
        let lag = (controller.lag_samples * self.record.ts_s / series.point_s).round().max(0.0) as usize;
        let driven = model.design.simulated(fit).unwrap_or_else(|| vec![0.0; n]);
        let mut sums = vec![0.0];
        let (mut change, mut error) = (vec![0.0; n], vec![0.0; n]);
        let (mut op, mut pv, mut moved) = (Vec::with_capacity(n), Vec::with_capacity(n), 0.0);
        for k in 0..n {
            let bin = |j: usize| sums[k.saturating_sub(j * width)] - sums[k.saturating_sub((j + 1) * width)];
            let by_op: f64 = fit.b.iter().enumerate().map(|(j, b)| b * bin(j) / width as f64).sum();
            let own: f64 = fit.a[1..].iter().take(k).enumerate().map(|(i, a)| a * change[k - 1 - i]).sum();
            change[k] = by_op - own;
            let all = entry.gain[k] * (driven[k] + change[k]) - driven[k] + entry.added[k];
            pv.push(series.pv[k] + all);
            error[k] = -all;
            if let Some([now, before, earlier]) = k.checked_sub(lag + 2).map(|e| [error[e + 2], error[e + 1], error[e]])
            {
                moved += gains[0] * (now - before) + gains[1] * now + gains[2] * (now - 2.0 * before + earlier);
            }
            op.push(series.op[k] + moved);
            sums.push(sums[k] + moved);
            let bounded = all.abs() < FAR && moved.abs() < FAR;
            if !bounded {
                return None;
            }
        }
        Some((op, pv))
    }

    /// A record of these signals in recorded units.
    fn recorded(&self, op: &[f64], pv: &[f64]) -> Record {
        let series = self.series();
        let boxed = |x: &[f64]| detrend::box_means(&x[series.from..], series.box_points);
        let middle = stats::mean(&boxed(&self.record.op()));
        let [mean, deviation] = series.of_pv;
        let op = op.iter().map(|x| middle + series.op_deviation * x).collect();
        let pv = pv.iter().map(|x| mean + deviation * x).collect();
        Record { sp: self.record.sp.as_deref().map(boxed), ..Record::uniform(series.point_s, op, pv) }
    }
}

fn draw_of(effect: &str, seed: u64) -> Draw {
    Draw::new(seed, &format!("hybrid/{effect}"))
}

#[cfg(test)]
mod tests {
    use super::*;
    use stiction::core::gap::budget::Known;
    use stiction::core::ident::controller;
    use stiction::core::sim::noise::Noise;

    /// A PI loop with a wandering load.
    fn record() -> Record {
        let (mut noise, mut x, mut d, mut sum) = (Noise::new(4, 1), 0.0, 0.0, 0.0);
        let (mut op, mut pv) = (vec![], vec![]);
        for k in 0..800 {
            d = 0.97 * d + 0.08 * noise.gaussian();
            let y = x + d;
            let e = if (k / 80) % 2 == 0 { 1.0 } else { -1.0 } - y;
            sum += 0.08 * e;
            op.push(0.8 * e + sum);
            pv.push(y);
            x = 0.9 * x + 0.1 * op[k];
        }
        let sp = (0..800).map(|k| if (k / 80) % 2 == 0 { 1.0 } else { -1.0 }).collect();
        Record { sp: Some(sp), ..Record::uniform(1.0, op, pv) }
    }

    #[test]
    fn without_an_effect_the_recording_comes_out_and_with_one_op_answers() {
        let record = record();
        let budget = Budget::of(&record, Known { period: Some(160.0), ..Known::default() }).unwrap();
        let own = Loop { record: &record, budget: &budget };
        let controller = controller::read(&record).unwrap();
        assert!((controller.kc - 0.8).abs() < 0.05, "{controller:?}");
        let same = own.closed("ramp", 0.0, &controller, 3).unwrap();
        assert!(same.pv.iter().zip(&record.pv).all(|(x, y)| (x - y).abs() < 1e-9));
        let step = own.closed("step_load", 1.0, &controller, 3).unwrap();
        let (op, pv) =
            (stats::mean(&step.op()[600..]) - stats::mean(&record.op()[600..]), step.pv[700] - record.pv[700]);
        // Integral action moves the step from PV to OP.
        let size = 2.0 * std_dev(&record.pv);
        assert!(pv.abs() < 0.3 * size && op.abs() > 0.5 * size, "{pv} {op} {size}");
        assert_eq!(own.in_pv("step_load", 1.0, 3).op(), own.with_step(0.0, 0.5).op());
    }
}
