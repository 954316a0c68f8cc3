//! Effort and stopping rules of the search stages. Every number was chosen on one set of simulated loops and reported on
//! another.

use super::local_search::Nearness;

/// The coarse scan of one round.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct ScanSettings {
    /// Evaluations allowed for the contour solver; more if its grid has more places.
    pub budget: u64,
    /// Smallest s, spans.
    pub least_s: f64,
    /// Values of s on a logarithmic scale, and of j for each.
    pub sizes: usize,
    /// See `sizes`.
    pub jumps: usize,
    /// Candidates kept: overall, and of every third of j / s.
    pub keep: [usize; 2],
}

/// One round of a search.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct RoundSettings {
    /// Filter of the error during the search, `1 - rho q^-1`: differencing forgets a wrong slip, so the right one can be found
    /// from farther away.
    pub rho: f64,
    /// Share of the record that is searched first; least and greatest length of that part, periods.
    pub part: [f64; 3],
    /// The part starts where OP first moves far: integrators accumulate the error of a wrong slip.
    pub from_far: bool,
    /// The coarse scan.
    pub scan: ScanSettings,
    /// Candidates, and random steps for each, in the stages of the local search.
    pub stages: &'static [(usize, usize)],
    /// Random steps on the whole record at the end.
    pub last: usize,
}

/// Searches of later cuts of the record: the middle may show what the beginning does not.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct CutSettings {
    /// Number of cuts.
    pub count: usize,
    /// Distance between the beginnings of two cuts, and length of a cut, shares of the record.
    pub apart: f64,
    /// See `apart`.
    pub length: f64,
    /// Best candidates of each law that continue from a cut.
    pub starts: usize,
}

/// A whole search.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct SearchSettings {
    /// Rounds, in order.
    pub rounds: Vec<RoundSettings>,
    /// Searched before the second round, if friction is visible.
    pub cuts: CutSettings,
    /// Limits for refining processes.
    pub near: Nearness,
    /// Share of PV that the best candidate leaves below which every test chooses the class again: the right slips may have been
    /// kept in a wrong class.
    pub closely: f64,
    /// Error relative to another law's from which a law is dropped, in a round and for the next one.
    pub behind: [f64; 2],
    /// Error relative to the frictionless one's from which further stages are not worthwhile.
    pub no_friction: f64,
    /// Stiction index above which another round is worthwhile if the rounds do not agree.
    pub worth_a_round: f64,
    /// Share by which a round must reduce the error to count as disagreeing.
    pub gain: f64,
    /// Share of the frictionless error from which one round without gain ends a search.
    pub much: f64,
    /// Consecutive rounds without gain that end a search.
    pub agreeing: usize,
    /// Reversals of the stem below which a search continues after a model that leaves only noise, until rounds agree. Chosen on
    /// 400 simulated loops; on 1,200 fresh ones s was within 1 % in 1,484 of 1,514 searches instead of 1,454 (34 won, 4 lost).
    pub few_reversals: usize,
    /// Cells per side walked along the ridge if the stem moves seldom.
    pub cells_along: usize,
    /// Whether bands read from PV's kinks are tried, too.
    pub reads_pv: bool,
}

const CUTS: CutSettings = CutSettings { count: 2, apart: 0.3, length: 0.35, starts: 2 };
const SCAN: ScanSettings = ScanSettings { budget: 250, least_s: 0.04, sizes: 40, jumps: 6, keep: [14, 4] };
const ROUND: RoundSettings = RoundSettings {
    rho: 0.9,
    part: [0.1, 3.0, 12.0],
    from_far: true,
    scan: SCAN,
    stages: &[(4, 24), (12, 24), (6, 50), (3, 80)],
    last: 100,
};

impl SearchSettings {
    /// The daemon's settings.
    #[must_use]
    pub(crate) fn usual() -> Self {
        let wide = ScanSettings { sizes: 90, jumps: 8, keep: [24, 6], ..SCAN };
        let rounds = vec![
            ROUND,
            RoundSettings { rho: 0.0, part: [0.45, 5.0, 12.0], from_far: false, ..ROUND },
            RoundSettings { rho: 0.98, part: [0.45, 3.0, 12.0], from_far: false, ..ROUND },
            RoundSettings { rho: 0.7, part: [0.1, 3.0, 12.0], from_far: true, ..ROUND },
            RoundSettings {
                rho: 0.98,
                part: [0.1, 3.0, 12.0],
                from_far: true,
                scan: wide,
                stages: &[(6, 40), (44, 40), (12, 100), (4, 200)],
                last: 150,
            },
        ];
        Self {
            rounds,
            cuts: CUTS,
            near: Nearness::USUAL,
            closely: 0.03,
            behind: [1.5, 1.15],
            no_friction: 0.9,
            worth_a_round: 0.15,
            gain: 0.01,
            much: 0.7,
            agreeing: 3,
            few_reversals: 8,
            cells_along: 700,
            reads_pv: true,
        }
    }

    /// Only `count` rounds, no cuts, and stopping at the first model that leaves only noise: the probabilities of gap decisions
    /// were calibrated with these settings.
    #[must_use]
    pub(crate) fn in_rounds(count: usize) -> Self {
        let mut settings = Self { cuts: CutSettings { count: 0, ..CUTS }, few_reversals: 0, ..Self::usual() };
        settings.rounds.truncate(count);
        settings
    }

    /// One reduced round, for comparing many structures; the likely ones are searched as usual afterwards.
    #[must_use]
    pub(crate) fn brief() -> Self {
        let scan = ScanSettings { budget: 60, sizes: 24, jumps: 4, keep: [8, 2], ..SCAN };
        let round = RoundSettings { scan, stages: &[(3, 16), (4, 24)], last: 20, ..ROUND };
        Self { rounds: vec![round], cells_along: 0, reads_pv: false, ..Self::usual() }
    }
}
