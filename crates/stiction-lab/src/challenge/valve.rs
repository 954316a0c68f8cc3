//! The valve of the challenge: a force balance at sub-sample steps, with the parts before and behind the stem.

use stiction::core::sim::friction::{Friction, FrictionState, SUB_STEPS};
use stiction::core::sim::noise::Noise;
use stiction::core::sim::valve::{Tracking, he_step, tracking_step};

/// Length of a sub-step, scans.
pub(crate) const DT: f64 = 1.0 / SUB_STEPS as f64;

/// Parts of a sub-step while the stem moves: a slip takes some tenths of a scan.
const WHILE_MOVING: usize = 20;

/// The Stribeck curve of packing, divided by the spring rate: bands in OP units, times in scans.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Packing {
    /// Static band.
    pub fs: f64,
    /// Coulomb band.
    pub fc: f64,
    /// Stribeck speed, OP units per scan: far below OP's own speed the stem slides, far above it sticks and slips.
    pub vs: f64,
    /// Viscous time, scans.
    pub fv: f64,
}

impl Packing {
    /// Both bands times `by`.
    fn scaled(&self, by: f64) -> Friction {
        Friction::new(self.fs * by, self.fc * by, self.vs, self.fv, 0.0)
    }
}

/// Model that moves the stem.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) enum Law {
    /// The force balance.
    Forces,
    /// He's model with the bands `[fs, fd]` upwards and downwards: the form in the catalogue.
    He([[f64; 2]; 2]),
    /// The tracking model with bands `[fs, fd]`.
    Tracking([f64; 2]),
}

/// A valve from OP to flow, without state.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct ValveSpec {
    pub packing: Packing,
    pub law: Law,
    /// Bands are larger by `1 + asymmetry` upwards and `1 - asymmetry` downwards.
    pub asymmetry: f64,
    /// Moving mass over stiffness, scans squared; 0 for none.
    pub mass: f64,
    /// Bands at the end of the run over those at its start, minus 1.
    pub growth: f64,
    /// Spread of the static band from one rest to the next (standard deviation of its logarithm).
    pub scatter: f64,
    /// First-order lag before the stem, scans.
    pub positioner_lag: f64,
    /// Largest speed of the stem, OP units per scan.
    pub rate_limit: f64,
    /// Travel limits, OP units.
    pub stops: [f64; 2],
    /// Backlash between stem and plug, OP units.
    pub play: f64,
    /// Largest speed of the part behind the stem (a large damper behind a small pilot), OP units per scan.
    pub follow_rate: f64,
    /// Flow limit of the port or pump, as the stem position of a linear valve, OP units.
    pub port: [f64; 2],
    /// Curvature of an equal-percentage characteristic around the operating point, 1 / OP unit; 0 for a linear one.
    pub curvature: f64,
}

impl ValveSpec {
    /// A linear valve with this packing and no other effects.
    pub const fn plain(packing: Packing) -> Self {
        Self {
            packing,
            law: Law::Forces,
            asymmetry: 0.0,
            mass: 0.0,
            growth: 0.0,
            scatter: 0.0,
            positioner_lag: 0.0,
            rate_limit: f64::INFINITY,
            stops: [-1e9, 1e9],
            play: 0.0,
            follow_rate: f64::INFINITY,
            port: [-1e9, 1e9],
            curvature: 0.0,
        }
    }

    /// `[fs, fd]` as measured by a slow ramp on the bench, upwards (`1.0`) or downwards (`-1.0`): the breakaway force and the
    /// force left when the stem rests again, both in OP units.
    pub fn bench(&self, along: f64) -> [f64; 2] {
        let clean = Self { positioner_lag: 0.0, rate_limit: f64::INFINITY, stops: [-1e9, 1e9], ..self.clone() };
        let clean = Self { law: Law::Forces, growth: 0.0, scatter: 0.0, ..clean };
        let mut valve = Valve::new(clean, 0.0, 0.0, Noise::new(0, 0));
        let pace = along * self.packing.fs / 2_000.0;
        let fs = valve.now[usize::from(along < 0.0)].static_band();
        let (mut op, mut broke, mut least) = (0.0, false, f64::INFINITY);
        for _ in 0..20_000 {
            op += pace;
            valve.sub_step(op);
            broke |= along * valve.position() > 0.02 * fs;
            if broke {
                least = least.min(along * (op - valve.position()));
            }
            if broke && (valve.stem.speed == 0.0 || along * op > 4.0 * fs) {
                return [fs, least];
            }
        }
        [self.packing.fs, self.packing.fc]
    }
}

/// A valve with its state.
#[derive(Debug, Clone)]
pub(crate) struct Valve {
    spec: ValveSpec,
    /// Current packing upwards and downwards.
    now: [Friction; 2],
    stem: FrictionState,
    /// State of the signal model, if used instead of the forces.
    law: Tracking,
    plug: f64,
    rest: f64,
    noise: Noise,
    grown: f64,
    luck: f64,
}

impl Valve {
    /// A valve at rest at `rest` with the strain `strain` (OP above the stem by this, OP units).
    pub fn new(spec: ValveSpec, rest: f64, strain: f64, noise: Noise) -> Self {
        let position = rest - strain;
        let stem = FrictionState { drive: rest, ..FrictionState::at_rest(position) };
        let law = Tracking { position, direction: 0 };
        let mut valve =
            Self { now: [Friction::NONE; 2], stem, law, plug: position, rest, noise, grown: 1.0, luck: 1.0, spec };
        valve.repack();
        valve
    }

    fn repack(&mut self) {
        let by = self.grown * self.luck;
        let a = self.spec.asymmetry;
        self.now = [self.spec.packing.scaled(by * (1.0 + a)), self.spec.packing.scaled(by * (1.0 - a))];
    }

    /// Stem position, OP units.
    pub const fn position(&self) -> f64 {
        self.stem.position
    }

    /// Sets the progress of the run (0..1), for parameters that change over time.
    pub fn age(&mut self, share: f64) {
        if self.spec.growth != 0.0 {
            self.grown = 1.0 + self.spec.growth * share;
            self.repack();
        }
    }

    /// One sub-step with OP at `op`; returns the flow, OP units, equal to OP for a linear valve without friction.
    pub fn sub_step(&mut self, op: f64) -> f64 {
        let lag = self.spec.positioner_lag;
        let share = if lag > 0.0 { 1.0 - libm::exp(-DT / lag) } else { 1.0 };
        self.stem.drive += share * (op - self.stem.drive);
        let before = self.stem;
        match self.spec.law {
            Law::Forces => self.forces(),
            law => self.obey(law),
        }
        self.limit(&before);
        if self.spec.scatter > 0.0 && before.speed != 0.0 && self.stem.speed == 0.0 {
            self.luck = libm::exp(self.spec.scatter * self.noise.gaussian());
            self.repack();
        }
        let half = 0.5 * self.spec.play;
        let wanted = self.plug.clamp(self.stem.position - half, self.stem.position + half);
        let most = self.spec.follow_rate * DT;
        self.plug += (wanted - self.plug).clamp(-most, most);
        self.flow()
    }

    fn flow(&self) -> f64 {
        let [least, most] = self.spec.port;
        let plug = self.plug.clamp(least, most);
        let (c, x) = (self.spec.curvature, plug - self.rest);
        if c == 0.0 { plug } else { self.rest + libm::expm1(c * x) / c }
    }

    fn forces(&mut self) {
        let e = self.stem.drive - self.stem.position;
        let along = if self.stem.speed == 0.0 { e } else { self.stem.speed };
        let friction = if along >= 0.0 { self.now[0] } else { self.now[1] };
        if self.spec.mass > 0.0 {
            self.heavy(&friction, e);
        } else {
            let drive = self.stem.drive;
            let rests = self.stem.speed == 0.0 && e.abs() <= friction.static_band();
            let parts = if rests { 1 } else { WHILE_MOVING };
            (0..parts).for_each(|_| friction.sub_step(&mut self.stem, drive, DT / parts as f64));
        }
    }

    /// A stem with mass (symplectic Euler): it stops where its speed would change sign, and holds below the static band. It may
    /// therefore come to rest beyond OP.
    fn heavy(&mut self, friction: &Friction, e: f64) {
        let v = self.stem.speed;
        if v == 0.0 && e.abs() <= friction.static_band() {
            return;
        }
        let along = if v == 0.0 { e.signum() } else { v.signum() };
        let next = v + DT / self.spec.mass * (e - along * friction.force(v.abs()));
        self.stem.speed = if next * along <= 0.0 { 0.0 } else { next };
        self.stem.position += DT * self.stem.speed;
    }

    fn obey(&mut self, law: Law) {
        let (drive, from) = (self.stem.drive, self.law.position);
        match law {
            Law::He([up, down]) => {
                let [fs, fd] = if drive >= from { up } else { down };
                self.law.position = he_step(from, drive, fs, fd);
            }
            Law::Tracking([fs, fd]) => self.law = tracking_step(self.law, drive, fs, fd),
            Law::Forces => {}
        }
        self.stem.position = self.law.position;
        self.stem.speed = if self.law.position == from { 0.0 } else { (self.law.position - from) / DT };
    }

    /// Applies rate limit and travel limits to the stem's movement since `before`.
    fn limit(&mut self, before: &FrictionState) {
        let most = self.spec.rate_limit * DT;
        let moved = self.stem.position - before.position;
        if moved.abs() > most {
            // Packing in motion drags at its kinetic level, however slowly the air lets the stem move.
            self.stem.position = before.position + most * moved.signum();
        }
        let [low, high] = self.spec.stops;
        if !(low..=high).contains(&self.stem.position) {
            self.stem.position = self.stem.position.clamp(low, high);
            self.stem.speed = 0.0;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const PACKING: Packing = Packing { fs: 3.0, fc: 1.5, vs: 0.5, fv: 0.05 };

    fn run(spec: ValveSpec, ops: &[f64]) -> Vec<f64> {
        let mut valve = Valve::new(spec, ops[0], 0.0, Noise::new(1, 1));
        ops.iter()
            .map(|op| {
                (0..SUB_STEPS).for_each(|_| _ = valve.sub_step(*op));
                valve.position()
            })
            .collect()
    }

    fn cycle() -> Vec<f64> {
        (0..600).map(|k| 50.0 + 8.0 * libm::sin(f64::from(k) * 0.05)).collect()
    }

    #[test]
    fn the_stem_makes_hes_staircase_within_the_bands_of_the_bench() {
        let spec = ValveSpec::plain(PACKING);
        let bands = [spec.bench(1.0), spec.bench(-1.0)];
        assert!((bands[0][0] - 3.0).abs() < 0.1 && (bands[0][0] - bands[1][0]).abs() < 1e-6, "{bands:?}");
        let he = run(ValveSpec { law: Law::He(bands), ..spec.clone() }, &cycle());
        let stem = run(spec, &cycle());
        let far = stem.iter().zip(&he).filter(|(a, b)| (*a - *b).abs() > 0.3).count();
        assert!(far < 60, "{far} of 600 samples differ");
    }

    #[test]
    fn a_stem_with_mass_comes_to_rest_beyond_op() {
        let spec = ValveSpec { mass: 0.03, ..ValveSpec::plain(Packing { fc: 0.4, fv: 0.06, vs: 0.02, ..PACKING }) };
        let [fs, fd] = spec.bench(1.0);
        assert!((fs - 3.0).abs() < 0.1 && fd < -1.0, "{fs} {fd}");
    }

    #[test]
    fn little_speed_of_stribeck_slides_and_much_sticks() {
        let rests = |vs: f64, fv: f64| {
            let stem = run(ValveSpec::plain(Packing { vs, fv, ..PACKING }), &cycle());
            stem.windows(2).filter(|w| (w[1] - w[0]).abs() < 1e-3).count()
        };
        let (slides, sticks) = (rests(1e-3, 1.2), rests(0.5, 0.05));
        assert!(slides < 330 && sticks > 480, "{slides} {sticks}");
    }

    #[test]
    fn stops_rates_and_play_hold_the_stem() {
        let plain = ValveSpec::plain(PACKING);
        let stopped = run(ValveSpec { stops: [45.0, 52.0], ..plain.clone() }, &cycle());
        assert!(stopped.iter().all(|x| (45.0..=52.0).contains(x)));
        let slow = run(ValveSpec { rate_limit: 0.2, ..plain }, &cycle());
        assert!(slow.windows(2).all(|w| (w[1] - w[0]).abs() < 0.2 + 1e-9));
    }

    #[test]
    fn bands_differ_by_direction() {
        let spec = ValveSpec { asymmetry: 0.5, ..ValveSpec::plain(PACKING) };
        let (up, down) = (spec.bench(1.0), spec.bench(-1.0));
        assert!((up[0] - 4.5).abs() < 0.1 && (down[0] - 1.5).abs() < 0.1, "{up:?} {down:?}");
    }
}
