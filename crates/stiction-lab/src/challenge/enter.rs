//! Adds each effect to a loop, with sizes relative to the loop's own amplitude, speed and period; 0 for none.

use super::artefact::{Artefact, spikes};
use super::kinds::Kind;
use super::plant::{Drive, Neighbour, Plant, ProcessSpec};
use crate::truth::draw::{Draw, scaled};
use stiction::core::sim::disturbance::Disturbance;

/// The loop's signals without the effect and the length of the run, which define the sizes.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Scale {
    /// Mean and standard deviation of PV without noise, PV units.
    pub pv_mean: f64,
    pub pv_sd: f64,
    /// Lowest and highest stem position, OP units.
    pub stem: [f64; 2],
    /// Slip jump, OP units.
    pub jump: f64,
    /// Period, scans.
    pub period: f64,
    /// Scans of the run, and number of initial ones left out.
    pub scans: usize,
    pub from: usize,
}

impl Scale {
    fn stem_span(&self) -> f64 {
        self.stem[1] - self.stem[0]
    }

    /// A share of the recorded part as a scan number.
    fn at(&self, share: f64) -> f64 {
        self.from as f64 + share * (self.scans - self.from) as f64
    }
}

/// A loop with its inputs and its recording.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Made {
    pub plant: Plant,
    pub drive: Drive,
    pub artefacts: Vec<Artefact>,
    /// Samples are taken at random up to this many scans late.
    pub jitter: f64,
    /// True sizes by name, with units.
    pub sizes: Vec<(&'static str, f64, &'static str)>,
    /// Variant of an effect that has several.
    pub form: Option<&'static str>,
}

impl Made {
    pub const fn new(plant: Plant, drive: Drive) -> Self {
        Self { plant, drive, artefacts: vec![], jitter: 0.0, sizes: vec![], form: None }
    }

    fn note(&mut self, name: &'static str, value: f64, unit: &'static str) {
        self.sizes.push((name, value, unit));
    }

    /// Adds `kind` with `size` (about 0.3 small, 1 large, 0 not at all).
    pub fn enter(&mut self, kind: Kind, size: f64, scale: &Scale, draw: &mut Draw) {
        match kind {
            Kind::AsymmetricStiction
            | Kind::SlipOvershoot
            | Kind::SlidingValve
            | Kind::Backlash
            | Kind::TravelLimit
            | Kind::RateLimit
            | Kind::PositionerLag
            | Kind::ChangingStiction
            | Kind::RandomFriction => self.enter_valve(kind, size, scale, draw),
            Kind::Sinusoid
            | Kind::Ramp
            | Kind::StepLoad
            | Kind::ColouredNoise
            | Kind::UpstreamCycle
            | Kind::InteractingLoop
            | Kind::Upsets => self.enter_load(kind, size, scale, draw),
            Kind::ExtraLag
            | Kind::StaticNonlinearity
            | Kind::InverseResponse
            | Kind::Integrating
            | Kind::GainDrift
            | Kind::DeadTimeChange
            | Kind::FlowDependentLag
            | Kind::SluggishFall => self.enter_process(kind, size, scale, draw),
            _ => self.enter_record(kind, size, scale, draw),
        }
    }

    fn enter_valve(&mut self, kind: Kind, size: f64, scale: &Scale, draw: &mut Draw) {
        let valve = &mut self.plant.valve;
        match kind {
            Kind::AsymmetricStiction => {
                valve.asymmetry = draw.sign() * 0.6 * size;
                let asymmetry = valve.asymmetry;
                self.note("alpha", asymmetry, "");
            }
            Kind::SlipOvershoot if size > 0.0 => {
                // Little friction in motion and a moving mass: half a swing of the stem takes about half a scan.
                valve.packing.fc = valve.packing.fs * (0.3 - 0.27 * size.min(1.1));
                valve.packing.fv = 0.06;
                valve.packing.vs *= 0.05;
                valve.mass = draw.between(0.02, 0.04);
                let [fs, fd] = valve.bench(1.0);
                self.note("fd_over_fs", fd / fs, "");
            }
            Kind::SlidingValve if size > 0.0 => {
                // A Stribeck speed far below OP's speed, and enough drag for the stem to be still in motion at the next scan.
                valve.packing.vs *= libm::exp(-5.0 - 2.0 * size);
                valve.packing.fv = 0.25 + 0.25 * size;
                let vs = valve.packing.vs;
                self.note("stribeck_speed", vs, "op/sample");
            }
            Kind::Backlash => {
                valve.play = 0.4 * size * scale.stem_span();
                let play = valve.play;
                self.note("play", play, "op");
            }
            Kind::TravelLimit if size > 0.0 => {
                let cut = 0.35 * size * scale.stem_span();
                let high = draw.chance(0.5);
                let at = if high { scale.stem[1] - cut } else { scale.stem[0] + cut };
                let of_stem = draw.chance(0.5);
                let ends = if of_stem { &mut valve.stops } else { &mut valve.port };
                ends[usize::from(high)] = at;
                self.form = Some(if of_stem { "stop of the stem" } else { "end of the flow" });
                self.note("stop", at, "op");
            }
            Kind::RateLimit if size > 0.0 => {
                // A slip takes up to an eighth of the period.
                let rate = scale.jump / (0.12 * size * scale.period);
                let of_stem = draw.chance(0.5);
                *(if of_stem { &mut valve.rate_limit } else { &mut valve.follow_rate }) = rate;
                self.form = Some(if of_stem { "stem" } else { "behind the stem" });
                self.note("rate", rate, "op/sample");
            }
            Kind::PositionerLag => {
                valve.positioner_lag = (0.16 * size * scale.period).min(40.0);
                let lag = valve.positioner_lag;
                self.note("lag", lag, "samples");
            }
            Kind::ChangingStiction => {
                valve.growth = if draw.chance(0.7) { 1.2 * size } else { -0.6 * size.min(1.0) };
                let growth = valve.growth;
                self.note("growth", growth, "");
            }
            Kind::RandomFriction => {
                valve.scatter = 0.4 * size;
                let scatter = valve.scatter;
                self.note("scatter", scatter, "");
            }
            _ => {}
        }
    }

    fn enter_process(&mut self, kind: Kind, size: f64, scale: &Scale, draw: &mut Draw) {
        let process = &mut self.plant.process;
        let [which, sign] = [draw.chance(0.5), draw.chance(0.5)];
        match kind {
            Kind::ExtraLag => {
                let lag = 0.8 * size * process.tau;
                self.form = Some(if which { "behind the valve" } else { "sensor" });
                if which {
                    process.input_lag = lag
                } else {
                    process.sensor_lag = lag
                }
                self.note("tau2", lag, "samples");
            }
            Kind::StaticNonlinearity => {
                if which {
                    self.plant.valve.curvature = libm::log(1.0 + 6.0 * size) / scale.stem_span();
                    self.form = Some("equal percentage");
                    let curvature = self.plant.valve.curvature;
                    self.note("curvature", curvature, "1/op");
                } else {
                    process.level_gain = if sign { 0.35 } else { -0.35 } * size / scale.pv_sd;
                    self.form = Some("level");
                    let level_gain = process.level_gain;
                    self.note("level_gain", level_gain, "1/pv");
                }
            }
            Kind::InverseResponse => {
                process.against = 0.8 * size;
                process.against_tau = 0.25 * process.tau;
                let against = process.against;
                self.note("against", against, "");
            }
            Kind::Integrating => {
                process.open = if size > 0.0 { 1.0 } else { 0.0 };
                let open = process.open;
                self.note("open", open, "");
            }
            Kind::GainDrift => {
                process.drift = if sign { 1.0 } else { -1.0 } * size;
                let drift = process.drift;
                self.note("log_gain", drift, "");
            }
            Kind::DeadTimeChange => {
                let change = 0.16 * size * scale.period;
                process.pipe_change = if sign && change < process.dead_time { -change } else { change };
                process.pipe_at = scale.at(draw.between(0.3, 0.7)) / scale.scans as f64;
                let ProcessSpec { pipe_change, pipe_at, .. } = *process;
                self.note("change", pipe_change, "samples");
                self.note("at", pipe_at * scale.scans as f64 - scale.from as f64, "samples");
            }
            Kind::FlowDependentLag => {
                process.tau_slope = 2.2 * size / scale.stem_span();
                let slope = process.tau_slope;
                self.note("log_tau_per_op", slope, "1/op");
            }
            Kind::SluggishFall => {
                process.sluggish = 2.5 * size;
                let sluggish = process.sluggish;
                self.note("slower", sluggish, "");
            }
            _ => {}
        }
    }

    fn enter_load(&mut self, kind: Kind, size: f64, scale: &Scale, draw: &mut Draw) {
        let n = scale.scans;
        let gain = self.plant.process.gain.abs();
        let behind = draw.chance(0.5);
        let place = if behind { "on pv" } else { "process input" };
        // A shape of half span 1, and its intended half span in PV.
        let (shape, on_pv) = match kind {
            Kind::Sinusoid => {
                let ratio = if draw.chance(0.5) { draw.log_between(0.2, 0.7) } else { draw.log_between(1.5, 4.0) };
                let period = scale.period * ratio;
                self.note("period", period, "samples");
                let lag = if behind { 0.0 } else { 2.0 * core::f64::consts::PI * self.plant.process.tau / period };
                (draw.sine(period, n), 0.9 * size * scale.pv_sd * (1.0 + lag * lag).sqrt())
            }
            Kind::Ramp => {
                let from_s = scale.at(draw.pick(&[0.0, 0.0, 0.2, 0.4], 0.0));
                let shape = Disturbance::Ramp { size: 2.0 * draw.sign(), from_s, over_s: n as f64 - from_s };
                self.note("from", from_s - scale.from as f64, "samples");
                (draw.series(shape, n), 2.0 * size * scale.pv_sd)
            }
            Kind::StepLoad => {
                let at_s = scale.at(draw.between(0.25, 0.75)).round();
                self.note("at", at_s - scale.from as f64, "samples");
                let shape = Disturbance::Step { size: 2.0 * draw.sign(), at_s };
                (draw.series(shape, n), 1.1 * size * scale.pv_sd)
            }
            Kind::Upsets => {
                let (shape, unit) = self.upsets(scale, draw);
                (shape, 1.8 * size * scale.pv_sd * unit)
            }
            Kind::ColouredNoise => return self.enter_coloured(size, scale, draw),
            Kind::UpstreamCycle => {
                let period = scale.period * draw.log_between(0.35, 2.5);
                self.note("period", period, "samples");
                let shape = if draw.chance(0.5) { draw.square(period, n) } else { draw.triangle(period, n) };
                (shape, 1.2 * size * scale.pv_sd)
            }
            _ => return self.enter_neighbour(size, scale, draw),
        };
        self.form = Some(place);
        self.note("half_span", if behind { on_pv } else { on_pv / gain }, if behind { "pv" } else { "op" });
        let (into, by) = if behind { (&mut self.drive.on_pv, on_pv) } else { (&mut self.drive.load, on_pv / gain) };
        if size > 0.0 {
            // Scaling is relative to the span, so a shape that starts at 0 still does.
            into.iter_mut().zip(scaled(&shape, by)).for_each(|(x, more)| *x += more);
        }
    }

    /// Steps and short pulses at sparse times, and half of their total span relative to the size of one.
    fn upsets(&mut self, scale: &Scale, draw: &mut Draw) -> (Vec<f64>, f64) {
        let count = draw.pick(&[3, 4, 5, 6], 3);
        let mut shape = vec![0.0; scale.scans];
        for k in 0..count {
            let at = scale.at(0.08 + 0.86 * (f64::from(k) + draw.between(0.2, 0.8)) / f64::from(count)).round();
            let length = scale.period * draw.log_between(0.06, 0.4);
            let end = if draw.chance(0.5) { at + length } else { f64::INFINITY };
            let size = draw.sign() * draw.between(0.7, 1.3);
            let is_on = |k: usize| (at..end).contains(&(k as f64));
            shape.iter_mut().enumerate().filter(|(k, _)| is_on(*k)).for_each(|(_, x)| *x += size);
        }
        self.note("events", f64::from(count), "");
        let half = 0.5 * stiction::core::signal::stats::span(&shape);
        (shape, half)
    }

    fn enter_coloured(&mut self, size: f64, scale: &Scale, draw: &mut Draw) {
        let walk = draw.chance(0.4);
        let shape = if walk {
            Disturbance::RandomWalk { sd_per_root_s: 1.0 / ((scale.scans - scale.from) as f64).sqrt() }
        } else {
            Disturbance::Ar1 { sd: 1.0, time_constant_s: scale.period * draw.log_between(0.03, 0.3) }
        };
        let sd = size * scale.pv_sd * if walk { 1.5 } else { 0.5 };
        let series = draw.series(shape, scale.scans);
        self.form = Some(if walk { "random walk" } else { "first order" });
        self.note("sd", sd, "pv");
        self.drive.on_pv.iter_mut().zip(series).for_each(|(x, more)| *x += sd * more);
    }

    fn enter_neighbour(&mut self, size: f64, scale: &Scale, draw: &mut Draw) {
        if size == 0.0 {
            return;
        }
        let mut plant = self.plant.clone();
        let stretch = draw.log_between(0.4, 2.2);
        plant.process.tau *= stretch;
        plant.process.dead_time *= stretch;
        plant.controller.ti_s *= stretch;
        plant.seed ^= 0x5eed;
        plant.strain = draw.between(-0.8, 0.8) * plant.valve.packing.fs;
        plant.valve.packing.fs *= draw.log_between(0.7, 1.5);
        let [to_us, to_it] =
            [draw.sign() * 0.6 * size, draw.sign() * draw.between(0.1, 0.3)].map(|share| share / plant.process.gain);
        self.note("to_us", to_us, "op/pv");
        self.note("to_it", to_it, "op/pv");
        self.note("period_over_ours", stretch, "");
        let _ = scale;
        self.plant.neighbour = Some(Box::new(Neighbour { plant, to_us, to_it }));
    }

    fn enter_record(&mut self, kind: Kind, size: f64, scale: &Scale, draw: &mut Draw) {
        let n = scale.scans - scale.from;
        if size == 0.0 {
            return;
        }
        let sd = scale.pv_sd;
        match kind {
            Kind::SensorFilter => {
                let lag = 0.8 * size * self.plant.process.tau;
                self.note("lag", lag, "samples");
                self.plant.pv_filter = lag;
                self.plant.retuned_at = 0.0;
            }
            Kind::Quantisation => {
                self.note("quantum", 0.9 * size * sd, "pv");
                self.artefacts.push(Artefact::Rounding(0.9 * size * sd));
            }
            Kind::HoldCompression => {
                self.note("band", 0.6 * size * sd, "pv");
                self.artefacts.push(Artefact::Hold(0.6 * size * sd));
            }
            Kind::SwingingDoor => {
                self.note("band", 0.5 * size * sd, "pv");
                self.artefacts.push(Artefact::Door(0.5 * size * sd));
            }
            Kind::Clipping => {
                let level = scale.pv_mean + draw.sign() * (1.5 - 1.1 * size.min(1.1)) * sd;
                let bounds = if level > scale.pv_mean { [f64::MIN, level] } else { [level, f64::MAX] };
                self.note("bound", level, "pv");
                self.artefacts.push(Artefact::Clip(bounds));
            }
            Kind::Outliers => {
                let found = spikes(draw, n, 0.02 * size, sd);
                self.note("share", found.len() as f64 / n as f64, "");
                self.artefacts.push(Artefact::Spikes(found));
            }
            Kind::FrozenSensor => {
                let span = (1.5 * size * scale.period) as usize;
                let from = (draw.between(0.1, 0.7) * n as f64) as usize;
                self.note("from", from as f64, "samples");
                self.note("for", span as f64, "samples");
                self.artefacts.push(Artefact::Freeze(from, span));
            }
            Kind::TimeSkew => {
                let samples = (1.0 + 6.0 * size.min(1.0)) * draw.sign();
                self.note("late", samples.round(), "samples");
                self.artefacts.push(Artefact::Skew(samples.round() as i32));
            }
            Kind::ClockJitter => {
                self.jitter = 0.08 * size * scale.period;
                let jitter = self.jitter;
                self.note("late_up_to", jitter, "samples");
            }
            Kind::RetunedFilter => {
                self.plant.retuned_at = scale.at(draw.between(0.35, 0.65)) / scale.scans as f64;
                self.plant.retuned = draw.between(0.5, 0.8);
                self.plant.pv_filter = 0.15 * size * scale.period;
                let filter = self.plant.pv_filter;
                self.note("filter", filter, "samples");
            }
            _ => {}
        }
    }
}
