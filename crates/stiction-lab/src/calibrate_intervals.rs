//! Compares intervals with the simulated truth: how often they contain it, and how wide they must be.

use serde::{Deserialize, Serialize};

use crate::truth::{Half, Regime};
use stiction::core::detect::oscillation;
use stiction::core::ident::width::{Floor, Intervals, Settings, Spread, Trust};
use stiction::core::ident::{Options, quantify};
use stiction::core::signal::stats;

/// One simulated loop: truth, estimate, and the likelihood's intervals. OP units.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Row {
    /// Name of the loop's regime.
    pub regime: String,
    /// Seed of the loop.
    pub seed: u64,
    /// True s and j.
    pub truth: [f64; 2],
    /// Estimated s and j.
    pub found: [f64; 2],
    /// The likelihood's intervals.
    pub spread: Spread,
    /// OP's span.
    pub span: f64,
    /// Model responses computed.
    pub evaluations: u64,
}

/// Fits one simulated loop as the daemon does; `None` if the fit fails.
#[must_use]
pub fn look(half: Half, regime: Regime, seed: u64) -> Option<Row> {
    let case = crate::truth::accuracy(half, regime, seed);
    let record = case.record();
    let period_points = oscillation::detect(&record.op(), &record.pv).map(|o| o.period_points);
    let options = Options { seed, period_points, ..Options::default() };
    let e = quantify(&record, &options).ok()?;
    let regime = regime.name().to_owned();
    let (truth, found) = ([case.s?, case.j?], [e.s, e.j]);
    Some(Row { regime, seed, truth, found, spread: e.spread, span: e.span, evaluations: e.evaluations })
}

/// Share of loops that the intervals of each class must cover.
const AIM: f64 = 0.9;

impl Row {
    /// True s, j, fs, fd.
    fn true_bands(&self) -> [f64; 4] {
        bands(self.truth)
    }

    fn trust(&self) -> Trust {
        self.spread.trust(self.found[0])
    }

    /// The intervals that would be reported.
    fn told(&self, floor: &Floor) -> [[f64; 2]; 4] {
        let [s, j] = self.found;
        let Intervals { s, j, fs, fd } = self.spread.told(s, j, floor, 1.0).within(self.span, s, j);
        [s, j, fs, fd]
    }

    /// The smallest floors for which each interval contains the truth.
    fn needed(&self) -> [f64; 4] {
        let (truth, found) = (self.true_bands(), bands(self.found));
        let told = self.told(&Floor { s: 0.0, j: 0.0, fs: 0.0, fd: 0.0 });
        core::array::from_fn(|i| {
            if told[i][0] <= truth[i] && truth[i] <= told[i][1] {
                return 0.0;
            }
            if i == 0 || i == 2 {
                (truth[i] / found[i]).max(found[i] / truth[i]) - 1.0
            } else {
                (truth[i] - found[i]).abs() / self.found[0]
            }
        })
    }
}

fn bands([s, j]: [f64; 2]) -> [f64; 4] {
    [s, j, 0.5 * (s + j), 0.5 * (s - j)]
}

/// The smallest widths with which every class of fits contains the truth as often as required; a class with hardly any `rows`
/// keeps the widths of `before`.
#[must_use]
pub fn fit(rows: &[Row], before: &Settings, made: String) -> Settings {
    const FEWEST: usize = 10;
    let mut out = Settings { made, ..before.clone() };
    for trust in Trust::ALL {
        let needed: Vec<[f64; 4]> = rows.iter().filter(|r| r.trust() == trust).map(Row::needed).collect();
        if needed.len() < FEWEST {
            continue;
        }
        // One more than the share, to cover a future loop.
        let rank = ((needed.len() as f64 + 1.0) * AIM).ceil() as usize;
        let at = |i: usize| {
            let sorted = stats::sorted(&needed.iter().map(|n| n[i]).collect::<Vec<_>>());
            let value = sorted[rank.min(sorted.len()) - 1];
            // Rounded up to four decimals.
            (value * 1e4).ceil() / 1e4
        };
        *out.of_mut(trust) = Floor { s: at(0), j: at(1), fs: at(2), fd: at(3) };
    }
    out
}

/// Quality of estimates and intervals in one regime, or in one class of fits.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Coverage {
    /// The name of the regime or class.
    pub name: String,
    /// Number of loops.
    pub loops: usize,
    /// Median error of s, %.
    pub median_pct: f64,
    /// 90th percentile of that error, %.
    pub p90_pct: f64,
    /// Share of loops whose interval contains the true s, j, fs and fd.
    pub held: [f64; 4],
    /// Median width of the intervals relative to the true s, %.
    pub width_pct: [f64; 4],
    /// Share of loops whose j is identified separately from the gain.
    pub identifiable: f64,
}

impl Coverage {
    fn of(name: &str, rows: &[&Row], settings: &Settings) -> Self {
        let n = rows.len() as f64;
        let told: Vec<[[f64; 2]; 4]> = rows.iter().map(|r| r.told(&settings.least(&r.spread, r.found[0]))).collect();
        let errors: Vec<f64> = rows.iter().map(|r| 100.0 * (r.found[0] / r.truth[0] - 1.0).abs()).collect();
        let held = core::array::from_fn(|i| {
            let inside = rows.iter().zip(&told).filter(|(r, t)| {
                let truth = r.true_bands()[i];
                t[i][0] <= truth && truth <= t[i][1]
            });
            inside.count() as f64 / n
        });
        let width_pct = core::array::from_fn(|i| {
            let widths = rows.iter().zip(&told).map(|(r, t)| 100.0 * (t[i][1] - t[i][0]) / r.truth[0]);
            stats::median(&widths.collect::<Vec<_>>())
        });
        Self {
            name: name.to_owned(),
            loops: rows.len(),
            median_pct: stats::median(&errors),
            p90_pct: stats::quantile(&errors, 0.9),
            held,
            width_pct,
            identifiable: rows.iter().filter(|r| r.spread.j_identifiable).count() as f64 / n,
        }
    }
}

/// Coverage by regime, in the order of the regimes, then by class of fits.
#[must_use]
pub fn table(rows: &[Row], settings: &Settings) -> Vec<Coverage> {
    let regimes = Regime::ALL.iter().map(|regime| {
        let of: Vec<&Row> = rows.iter().filter(|r| r.regime == regime.name()).collect();
        (regime.name(), of)
    });
    let classes = Trust::ALL.iter().map(|trust| {
        let of: Vec<&Row> = rows.iter().filter(|r| r.trust() == *trust).collect();
        (trust.name(), of)
    });
    let all = regimes.chain(classes).filter(|(_, of)| !of.is_empty());
    all.map(|(name, of)| Coverage::of(name, &of, settings)).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use stiction::core::ident::residual::Whiteness;
    use stiction::core::ident::width::THIRDS;

    /// A white fit whose true s exceeds the estimate by the share `off`.
    fn row(off: f64) -> Row {
        let whiteness =
            Whiteness { r1: 0.0, portmanteau: 20.0, cross: 1.0, inflation: 1.0, white: true, follows_op: false };
        let (s, j) = (4.0, 2.0);
        let spread = Spread {
            s: [3.98, 4.02],
            j: [1.95, 2.05],
            fs: [2.95, 3.05],
            fd: [0.95, 1.05],
            j_identifiable: true,
            whiteness,
            quantum: 0.0,
            index: 0.95,
            distinct: false,
            thirds: [None; THIRDS],
        };
        let (truth, found) = ([s * (1.0 + off), j], [s, j]);
        Row { regime: "he start".to_owned(), seed: 0, truth, found, spread, span: 8.0, evaluations: 9 }
    }

    #[test]
    fn floors_are_as_wide_as_it_takes_to_hold_the_truth_nine_times_of_ten() {
        let rows: Vec<Row> = (0..100).map(|k| row(0.001 * f64::from(k))).collect();
        let before = Settings::unknown();
        let found = fit(&rows, &before, "here".to_owned());
        assert!((found.white.s - 0.09).abs() < 0.0021 && found.coloured == before.coloured, "{found:?}");
        let table = table(&rows, &found);
        assert_eq!(table.len(), 2);
        assert!((0.9..=0.93).contains(&table[0].held[0]) && table[0].held[1] == 1.0, "{:?}", table[0]);
        assert!((table[0].median_pct - 4.7).abs() < 0.3 && table[1].name == "white");
    }
}
