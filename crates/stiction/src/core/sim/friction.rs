//! A valve with friction, from forces instead of a signal model: an actuator whose force is proportional to OP, a spring, and
//! packing that holds up to the static band and then drags along the Stribeck curve.
//!
//! Forces are divided by the spring rate, so they are in OP units; times are in scans. Inertia is neglected: a globe valve with
//! some hundred newtons per millimetre settles within milliseconds. The equation
//! `|op - x| = fc + (fs - fc) exp(-(v/vs)^2) + fv |v|` is solved for the speed on the stem's branch. A slow OP gives a
//! staircase; a ramp faster than the speed at the curve's minimum gives smooth tracking.
//!
//! Limits: the packing is rigid. With stiff bristles, LuGre agrees for a few slips between reversals of OP; in long staircases
//! small differences decide on slips, and the two may differ by a step for some scans. With soft bristles or sudden steps of
//! OP, LuGre breaks away below the static band; this model does not.

/// Integration steps per scan.
pub const SUB_STEPS: usize = 20;

/// Friction of a stem, with the turning points of its curve.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Friction {
    fs: f64,
    fc: f64,
    vs: f64,
    fv: f64,
    lag: f64,
    /// Speed and force at the curve's maximum (creeping below) and minimum (sliding above); none if it is monotonic.
    folds: Option<[(f64, f64); 2]>,
}

/// Friction of a valve in a scenario.
#[derive(Debug, Clone, Copy, PartialEq, serde::Deserialize)]
#[serde(deny_unknown_fields)]
pub struct FrictionSpec {
    /// Force that holds the stem, OP units.
    pub stick: f64,
    /// Force during fast motion, OP units.
    pub drag: f64,
    /// Speed over which `stick` falls to `drag`, OP units per scan.
    pub speed: f64,
    /// Viscous time, scans.
    pub viscous: f64,
    /// Lag of the actuator, scans.
    pub lag: f64,
}

impl FrictionSpec {
    /// The friction.
    #[must_use]
    pub fn friction(self) -> Friction {
        Friction::new(self.stick, self.drag, self.speed, self.viscous, self.lag)
    }
}

impl Friction {
    /// No friction.
    pub const NONE: Self = Self { fs: 0.0, fc: 0.0, vs: 1.0, fv: 1e-3, lag: 0.0, folds: None };

    /// Friction with static band `fs` and Coulomb band `fc <= fs` (OP units), Stribeck speed `vs` (OP units a scan),
    /// viscous time `fv` (scans) and the actuator's lag (scans, 0 for none). All but the lag are > 0.
    #[must_use]
    pub fn new(fs: f64, fc: f64, vs: f64, fv: f64, lag: f64) -> Self {
        let (fc, vs, fv) = (fc.min(fs), vs.max(1e-9), fv.max(1e-6));
        let mut friction = Self { fs, fc, vs, fv, lag, folds: None };
        // The slope is 0 where w exp(-w^2) = fv vs / (2 (fs - fc)), w = v/vs; the left side is largest at 1/sqrt 2.
        let side = |w: f64| w * libm::exp(-w * w);
        let top = core::f64::consts::FRAC_1_SQRT_2;
        let level = fv * vs / (2.0 * (fs - fc).max(1e-12));
        if level < side(top) {
            let solve = |mut below: f64, mut above: f64| {
                for _ in 0..60 {
                    let mid = 0.5 * (below + above);
                    if side(mid) < level { below = mid } else { above = mid }
                }
                0.5 * (below + above) * vs
            };
            let (crest, trough) = (solve(0.0, top), solve(8.0, top));
            friction.folds = Some([(crest, friction.force(crest)), (trough, friction.force(trough))]);
        }
        friction
    }

    /// Force at the speed `v >= 0`.
    #[must_use]
    pub fn force(&self, v: f64) -> f64 {
        let w = v / self.vs;
        self.fc + (self.fs - self.fc) * libm::exp(-w * w) + self.fv * v
    }

    /// Static band, OP units.
    #[must_use]
    pub const fn static_band(&self) -> f64 {
        self.fs
    }

    /// The speed between `low` and `high`, on a rising part of the curve, at which the force is `e`.
    fn speed_within(&self, e: f64, mut low: f64, mut high: f64) -> f64 {
        let mut v = high;
        for _ in 0..40 {
            let w = v / self.vs;
            let bell = (self.fs - self.fc) * libm::exp(-w * w);
            let over = self.fc + bell + self.fv * v - e;
            if over > 0.0 {
                high = v
            } else {
                low = v
            }
            let slope = self.fv - 2.0 * bell * w / self.vs;
            let newton = v - over / slope;
            let next = if newton > low && newton < high { newton } else { 0.5 * (low + high) };
            if (next - v).abs() <= 1e-9 * self.vs.min(v.max(1e-12)) {
                return next;
            }
            v = next;
        }
        v
    }

    /// Speed under the force `e >= 0` for a stem that moves with `v >= 0`.
    fn speed(&self, e: f64, v: f64) -> f64 {
        let fastest = ((e - self.fc) / self.fv).max(0.0);
        match self.folds {
            None if e <= self.fs => 0.0,
            None => self.speed_within(e, 0.0, fastest),
            Some([(crest, most), (trough, least)]) => {
                let slides = v >= trough * (1.0 - 1e-9);
                if e > most || (slides && e >= least) {
                    self.speed_within(e, trough, fastest.max(trough))
                } else if e <= self.fs {
                    0.0
                } else {
                    self.speed_within(e, 0.0, crest)
                }
            }
        }
    }

    /// One short step of `dt` scans with the actuator at `drive`; the viscous part is exact for a constant drive.
    pub fn sub_step(&self, stem: &mut FrictionState, drive: f64, dt: f64) {
        let e = drive - stem.position;
        let along = stem.speed * e.signum();
        let v = e.signum() * self.speed(e.abs(), along.max(0.0));
        stem.position += v * self.fv * (1.0 - libm::exp(-dt / self.fv));
        stem.speed = v;
    }

    /// Moves `stem` over one scan with OP held at `op`; returns its mean position, which is the input of the process.
    pub(crate) fn step(&self, stem: &mut FrictionState, op: f64) -> f64 {
        let dt = 1.0 / SUB_STEPS as f64;
        let share = if self.lag > 0.0 { 1.0 - libm::exp(-dt / self.lag) } else { 1.0 };
        let mut sum = 0.0;
        for _ in 0..SUB_STEPS {
            let before = stem.position;
            stem.drive += share * (op - stem.drive);
            self.sub_step(stem, stem.drive, dt);
            sum += 0.5 * (before + stem.position);
        }
        sum * dt
    }

    /// Stick band and slip jump `(s, j)` as a bench test would measure them: OP ramps up slowly until the stem has made a step
    /// (or slides), reverses, and travels `s` until the stem moves back; the stem then catches up by `j`.
    #[must_use]
    pub fn measure(&self) -> (f64, f64) {
        let dt = 1.0 / SUB_STEPS as f64;
        let pace = self.fs / 2_000.0;
        let mut stem = FrictionState::at_rest(0.0);
        let mut op = 0.0;
        self.one_motion(&mut stem, &mut op, pace, dt);
        let turned = op;
        let (started, caught_up) = self.one_motion(&mut stem, &mut op, -pace, dt);
        ((started - turned).abs(), caught_up)
    }

    /// Ramps OP by `pace` per integration step until the stem has moved and rests again, or has slid for three static bands.
    /// Returns OP at the first motion and how far the stem caught up with OP.
    fn one_motion(&self, stem: &mut FrictionState, op: &mut f64, pace: f64, dt: f64) -> (f64, f64) {
        let along = pace.signum();
        let mut from = stem.position;
        let (mut started, mut most, mut least) = (*op, 0.0_f64, f64::INFINITY);
        let mut moved = false;
        for _ in 0..20_000 {
            *op += pace;
            self.sub_step(stem, *op, dt);
            let e = (*op - stem.position) * along;
            if !moved {
                // Creep before the motion does not count.
                from = if along * (stem.position - from) < 0.0 { stem.position } else { from };
                started = *op;
                most = most.max(e);
                moved = along * (stem.position - from) > 1e-3 * self.fs;
            }
            if moved {
                least = least.min(e);
                if stem.speed == 0.0 || (*op - started).abs() > 3.0 * self.fs {
                    break;
                }
            }
        }
        (started, (most - least).max(0.0))
    }
}

/// State of a stem with friction.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct FrictionState {
    /// Position, OP units.
    pub position: f64,
    /// Speed, OP units a scan.
    pub speed: f64,
    /// Target of the lagging actuator, OP units.
    pub drive: f64,
}

impl FrictionState {
    /// A stem at rest at `position` without stress.
    #[must_use]
    pub const fn at_rest(position: f64) -> Self {
        Self { position, speed: 0.0, drive: position }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::core::sim::noise::Noise;

    /// The LuGre model with mass (Canudas de Wit et al. 1995), implicit where it is stiff.
    struct LuGre {
        friction: Friction,
        mass: f64,
        bristle: f64,
        damping: f64,
        x: f64,
        v: f64,
        z: f64,
    }

    impl LuGre {
        fn step(&mut self, drive: f64, dt: f64) {
            let Friction { fs, fc, vs, fv, .. } = self.friction;
            let w = self.v / vs;
            let g = (fc + (fs - fc) * (-w * w).exp()) / self.bristle;
            let slip = (1.0 - self.v.signum() * self.z / g).max(0.0);
            let force = drive - self.x - self.bristle * self.z;
            self.v = (self.v + dt / self.mass * force) / (1.0 + dt / self.mass * (fv + self.damping * slip));
            self.z = (self.z + self.v * dt) / (1.0 + self.v.abs() * dt / g);
            self.x += self.v * dt;
        }
    }

    /// OP as a cycle with kinks and a slow wander, so that the stem reverses at unequal excursions.
    fn path(seed: u64, size: f64, period: f64) -> Vec<f64> {
        let mut noise = Noise::new(seed, 3);
        let mut wander = 0.0;
        (0..400)
            .map(|k| {
                let turns = f64::from(k) / period;
                wander += 0.005 * size * noise.gaussian();
                size * (4.0 * (turns - turns.floor() - 0.5).abs() - 1.0) + wander
            })
            .collect()
    }

    #[test]
    fn the_stem_goes_where_one_with_mass_and_bristles_goes() {
        let mut worst = 0.0_f64;
        // fs, fc, vs, fv, lag, period: staircases first, smooth tracking last.
        for (case, (fs, fc, vs, fv, lag, period)) in [
            (3.0, 1.5, 0.05, 0.1, 0.3, 200.0),
            (3.0, 2.4, 0.04, 0.2, 0.3, 160.0),
            (5.0, 2.0, 0.1, 0.3, 0.4, 120.0),
            (2.0, 1.0, 0.05, 0.1, 0.5, 200.0),
            (4.0, 3.6, 0.03, 0.15, 0.2, 150.0),
            (6.0, 5.0, 0.05, 0.5, 0.2, 100.0),
            (3.0, 2.0, 0.1, 1.0, 0.3, 150.0),
            (3.0, 1.5, 0.01, 1.5, 0.4, 100.0),
            (4.0, 2.0, 0.3, 0.5, 0.3, 80.0),
            (2.0, 1.8, 1.0, 1.0, 0.8, 80.0),
        ]
        .into_iter()
        .enumerate()
        {
            let friction = Friction::new(fs, fc, vs, fv, lag);
            let ops = path(case as u64, 1.3 * fs, period);
            let mut stem = FrictionState::at_rest(ops[0]);
            let mut full = LuGre { friction, mass: 3e-4, bristle: 4_000.0, damping: 0.05, x: ops[0], v: 0.0, z: 0.0 };
            let (mut drive, fine) = (ops[0], 4_000);
            let dt = 1.0 / f64::from(fine);
            let share = if lag > 0.0 { 1.0 - (-dt / lag).exp() } else { 1.0 };
            let mut apart = 0.0;
            for &op in &ops {
                friction.step(&mut stem, op);
                for _ in 0..fine {
                    drive += share * (op - drive);
                    full.step(drive, dt);
                }
                apart += (stem.position - full.x).abs();
            }
            let s = friction.measure().0;
            let off = apart / ops.len() as f64 / s;
            worst = worst.max(off);
        }
        // Averaged over the run, because a slip one scan later is an error of a whole step for that long.
        assert!(worst < 0.04, "{worst}");
    }

    #[test]
    fn a_bench_test_reads_the_bands_of_the_curve() {
        let friction = Friction::new(4.0, 2.0, 0.01, 0.2, 0.0);
        let (s, j) = friction.measure();
        let [_, (_, least)] = friction.folds.unwrap();
        assert!((s - (4.0 + least)).abs() < 0.1 && (j - (4.0 - least)).abs() < 0.1, "{s} {j} {least}");
        // Much viscous drag: the stem creeps without a jump.
        let (s, j) = Friction::new(4.0, 3.5, 1.0, 5.0, 0.0).measure();
        assert!((s - 8.0).abs() < 0.3 && j < 0.2, "{s} {j}");
    }

    #[test]
    fn a_slow_ramp_gives_a_staircase_and_a_quick_one_is_tracked() {
        let friction = Friction::new(3.0, 1.5, 0.05, 0.2, 1.0);
        let rests = |pace: f64| {
            let mut stem = FrictionState::at_rest(0.0);
            let n = (30.0 / pace) as usize;
            let mut still = 0;
            for k in 0..n {
                friction.step(&mut stem, pace * k as f64);
                still += usize::from(k > n / 2 && stem.speed == 0.0);
            }
            still as f64 / (n as f64 / 2.0)
        };
        assert!(rests(0.01) > 0.8 && rests(2.0) == 0.0, "{} {}", rests(0.01), rests(2.0));
    }

    #[test]
    fn no_friction_follows() {
        let mut stem = FrictionState::at_rest(50.0);
        for op in [51.0, 49.0, 30.0] {
            Friction::NONE.step(&mut stem, op);
            assert!((stem.position - op).abs() < 1e-6);
        }
    }
}
