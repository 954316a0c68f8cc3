//! Simulated closed loops of known truth, for calibration and evaluation.
//!
//! [`accuracy`] makes sticking, well-posed loops of one [`Regime`] with known `s` and `j`, whose valve visibly moves.
//! [`verdict_case`] makes healthy and sticking loops of every kind, including hard ones, as plants would store them.
//! [`cause_case`] makes loops of a known cause, half of them with a moving set point. All are functions of (half, what, seed)
//! alone, to the last bit.
//!
//! The two [`Half`]s draw from separate streams, so nothing calibrated on one occurs in the other, whatever the seeds. Loops
//! are drawn until one fits its regime; the number of the attempt is part of the stream.
//!
//! Bands are in OP units (0..100 %), times in scans unless they are in seconds; `ts_s` is a label only.
//!
//! | module | |
//! |---|---|
//! | `accuracy`, `verdict`, `causes` | which loops are drawn |
//! | [`draw`] | seeded draws |
//! | [`rig`] | a loop with its inputs, and its tuning |
//! | [`storage`] | effects of recording on a signal |
//! | [`fixture`] | small loops that a test defines completely |
//! | [`methods`] | published methods of detection, one file each |
//! | [`rates`] | true and false positive rates as a table |

mod accuracy;
mod causes;
pub mod draw;
pub mod fixture;
pub mod methods;
pub mod rates;
pub mod rig;
pub mod storage;
mod verdict;

pub use accuracy::Regime;
pub use causes::CAUSES;
pub use verdict::{KINDS, LIMIT_CYCLE, PROCESS_KINDS, RECORD_KINDS};

use stiction::core::record::Record;
use stiction::core::sim::controller::PidSettings;
use stiction::core::sim::process::ProcessModel;
use stiction::core::units::ns_from_s;
use stiction::core::verdict::AssessParams;
use stiction::samples::align::Point;
use stiction_engine::analysis::Judgeable;
use stiction_engine::engine::{WindowParams, windows};

/// Half of all loops: nothing fitted on one may be reported on the same.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum Half {
    /// For fitting weights, margins and thresholds.
    Calibration,
    /// For reported figures.
    Report,
}

impl Half {
    /// The half's name in random streams and tables.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::Calibration => "calibration",
            Self::Report => "report",
        }
    }
}

/// One simulated loop as recorded, with its truth.
#[derive(Debug, Clone, PartialEq)]
pub struct TruthLoop {
    /// Controller output as recorded, OP units.
    pub op: Vec<f64>,
    /// Process variable as recorded, PV units.
    pub pv: Vec<f64>,
    /// Set point, PV units.
    pub sp: Vec<f64>,
    /// Valve position, OP units, exact.
    pub mv: Vec<f64>,
    /// Time between recorded samples, s.
    pub ts_s: f64,
    /// Standard deviation of the white measurement noise, PV units.
    pub noise_sd: f64,
    /// Residual of a fit with the true model (standard deviation), if known: OP recorded exactly, a valve that follows one of
    /// the laws, and only white noise on PV.
    pub floor_sd: Option<f64>,
    /// Whether the valve sticks.
    pub sticks: bool,
    /// Valve: `none`, `he`, `tracking` or `physical`.
    pub law: &'static str,
    /// Stick band, OP units; `None` for a healthy valve. For the physical valve measured on a slow ramp.
    pub s: Option<f64>,
    /// Slip jump, OP units.
    pub j: Option<f64>,
    /// Process, in recorded samples.
    pub process: ProcessModel,
    /// Controller.
    pub controller: PidSettings,
    /// Ends of the valve's travel, OP units.
    pub travel: [f64; 2],
    /// Seed of the draws.
    pub seed: u64,
    /// Excitation of the loop: `limit cycle`, or its name.
    pub kind: &'static str,
    /// `fast flow`, `first order`, `second order` or `integrating`.
    pub process_kind: &'static str,
    /// Effect of recording: `raw`, or its name.
    pub record_kind: &'static str,
    /// Cause of the oscillation: `valve`, `tuning`, `disturbance` or `none`.
    pub cause: &'static str,
    /// Regime of [`accuracy`] loops, else `verdict`.
    pub regime: &'static str,
    /// Noise relative to PV's spread without noise.
    pub noise_share: f64,
    /// Intended period, recorded samples.
    pub period: f64,
    /// Size of the disturbance: in [`accuracy`] loops relative to half the span of the stick-slip PV, in [`verdict_case`] loops
    /// in OP units relative to fs if sticking, and in OP units if healthy.
    pub disturbance: f64,
}

impl TruthLoop {
    /// The record for an estimate: with the set point, without the valve position.
    #[must_use]
    pub fn record(&self) -> Record {
        let mut record = Record::uniform(self.ts_s, self.op.clone(), self.pv.clone());
        record.sp = Some(self.sp.clone());
        record
    }

    /// The record with its windows, as a recording is judged.
    #[must_use]
    pub fn judgeable(&self) -> Judgeable {
        let record = self.record();
        let points: Vec<Point> = (0..record.len()).map(|k| point(&record, k)).collect();
        let windows = windows(&points, &WindowParams::default());
        Judgeable { record, windows, params: AssessParams { always_fit: true, ..AssessParams::default() } }
    }

    /// Periods in the record, by the intended period.
    #[must_use]
    pub fn cycles(&self) -> f64 {
        self.pv.len() as f64 / self.period
    }
}

/// One sample of a simulated record.
fn point(record: &Record, k: usize) -> Point {
    Point {
        t_ns: record.start_ns + ns_from_s(k as f64 * record.ts_s),
        op: record.op_path[k],
        pv: record.pv[k],
        sp: record.sp.as_ref().map(|sp| sp[k]),
        mv: None,
        manual: false,
        filled: false,
        bad: 0,
    }
}

/// Draws until `attempt` returns a loop.
fn first_that_fits(
    half: Half,
    what: &str,
    seed: u64,
    attempt: impl Fn(&mut draw::Draw) -> Option<TruthLoop>,
) -> TruthLoop {
    let mut number = 0_u32;
    loop {
        // This ends only on success: draws are independent, and valid draws are not rare in any regime or kind.
        let mut draw = draw::Draw::new(seed, &format!("truth/{}/{what}/{number}", half.name()));
        if let Some(mut found) = attempt(&mut draw) {
            found.seed = seed;
            return found;
        }
        number += 1;
    }
}

/// A sticking, well-posed loop of `regime`.
#[must_use]
pub fn accuracy(half: Half, regime: Regime, seed: u64) -> TruthLoop {
    first_that_fits(half, regime.name(), seed, |draw| accuracy::attempt(draw, regime))
}

/// A loop for the verdict: healthy for even seeds, sticking for odd ones. `seed / 2` cycles through the kinds; everything else
/// is drawn.
#[must_use]
pub fn verdict_case(half: Half, seed: u64) -> TruthLoop {
    verdict_stretch(half, seed, 1)
}

/// The same kind of loop, recorded for `windows` times as long: consecutive windows of one loop.
#[must_use]
pub fn verdict_stretch(half: Half, seed: u64, windows: usize) -> TruthLoop {
    let (sticks, what) = if seed % 2 == 1 { (true, "verdict sticking") } else { (false, "verdict healthy") };
    first_that_fits(half, what, seed, |draw| verdict::attempt(draw, sticks, seed / 2, windows))
}

/// A loop of a known cause: the seed cycles through tuning, disturbance, valve and none, `seed / 4` through constant and moving
/// set points, `seed / 8` through kinds.
#[must_use]
pub fn cause_case(half: Half, seed: u64) -> TruthLoop {
    first_that_fits(half, "cause", seed, |draw| causes::attempt(draw, seed))
}

#[cfg(test)]
mod tests {
    use super::*;
    use stiction::core::sim::slips::{FirstSlip, Law};
    use stiction::core::sim::steps::Path;

    fn bits(found: &TruthLoop) -> Vec<u64> {
        found.op.iter().chain(&found.pv).chain(&found.sp).chain(&found.mv).map(|x| x.to_bits()).collect()
    }

    #[test]
    fn equal_seeds_give_equal_bits_and_halves_have_nothing_in_common() {
        for seed in 0..6 {
            let case = |half, seed| bits(&verdict_case(half, seed));
            assert_eq!(case(Half::Report, seed), case(Half::Report, seed));
            assert_ne!(case(Half::Report, seed), case(Half::Calibration, seed));
            assert_ne!(case(Half::Report, seed), case(Half::Report, seed + 2));
            let regime = Regime::ALL[seed as usize * 4];
            let case = |half, seed| bits(&accuracy(half, regime, seed));
            assert_eq!(case(Half::Report, seed), case(Half::Report, seed));
            assert_ne!(case(Half::Report, seed), case(Half::Calibration, seed));
            assert_ne!(case(Half::Report, seed), case(Half::Report, seed + 1));
        }
    }

    #[test]
    fn the_valve_obeys_its_law_in_slip_coordinates_too() {
        for (regime, law) in [(Regime::HeStart, Law::He), (Regime::TrackingSetPoint, Law::Tracking)] {
            let cases = (0..12).map(|seed| accuracy(Half::Calibration, regime, seed));
            // The initial position is visible unless the first scan moves the stem.
            for found in cases.filter(|found| found.mv[0] == found.mv[1]).take(4) {
                let seed = found.seed;
                let (s, j) = (found.s.unwrap(), found.j.unwrap());
                let (fs, fd) = (0.5 * (s + j), 0.5 * (s - j));
                // The stem starts at the operating point: an upward slip needs OP to be fs above it.
                let rest = found.mv[0];
                let first = found.mv.iter().position(|v| *v != rest).unwrap();
                let direction = (found.op[first] - rest).signum();
                let first = FirstSlip { direction, threshold: rest + direction * fs };
                let (stem, _) = Path::new(found.op.clone(), 1).stem(law, [s, j], fd, first);
                let slipped = found.mv.iter().position(|v| *v != rest).unwrap();
                for (k, (stem, mv)) in stem.iter().zip(&found.mv).enumerate().skip(slipped) {
                    assert!((stem - mv).abs() < 1e-9, "{regime:?} {seed} at {k}");
                }
            }
        }
    }

    #[test]
    fn the_noise_is_what_the_truth_says() {
        let found = accuracy(Half::Report, Regime::HighNoise, 1);
        assert!((found.floor_sd, found.sticks) == (Some(found.noise_sd), true));
        // Second differences contain six times the noise variance, and little of the process.
        let rough: f64 = found.pv.windows(3).map(|w| (w[2] - 2.0 * w[1] + w[0]).powi(2)).sum();
        let sd = (rough / (6.0 * (found.pv.len() - 2) as f64)).sqrt();
        assert!((0.9..1.3).contains(&(sd / found.noise_sd)), "{sd} {}", found.noise_sd);
    }

    #[test]
    fn a_record_shows_what_a_historian_has() {
        let found = accuracy(Half::Report, Regime::Decimated, 0);
        let record = found.record();
        assert!(record.mv.is_none() && record.sp.is_some() && record.len() == found.pv.len());
        assert_eq!(record.ts_s, found.ts_s);
    }
}
