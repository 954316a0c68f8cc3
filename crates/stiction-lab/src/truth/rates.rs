//! True and false positive rates on loops of known truth, by excitation: one table for every command that counts them.

use std::collections::BTreeMap;

use stiction::core::verdict::tally::{self, Scored, wilson};

/// One loop of known truth, and the decisions that call it sticking.
#[derive(Debug, Clone, Copy)]
pub struct Called<'k, const N: usize> {
    /// Excitation of the loop.
    pub kind: &'k str,
    /// The valve sticks.
    pub sticks: bool,
    /// Whether each decision calls the valve sticking.
    pub called: [bool; N],
}

/// `part` of `all` with Wilson's 95 % interval, per cent; `-` if `all` is 0.
#[must_use]
pub fn share(part: usize, all: usize) -> String {
    wilson(part as f64, all as f64).map_or("-".to_owned(), |[low, high]| {
        let share = format!("{part}/{all}");
        let rate = 100.0 * part as f64 / all as f64;
        format!("{share:>9} {rate:>5.1} % ({:.0}..{:.0})", 100.0 * low, 100.0 * high)
    })
}

/// Number of loops with this truth that a decision calls sticking, and the number of all such loops.
#[must_use]
pub fn count<const N: usize>(loops: &[Called<'_, N>], sticks: bool, decision: usize) -> (usize, usize) {
    let of = || loops.iter().filter(|one| one.sticks == sticks);
    (of().filter(|one| one.called[decision]).count(), of().count())
}

/// True (TPR) and false positive rates (FPR): one line per kind, sorted by the first decision's false positives, and a total.
#[must_use]
pub fn table<const N: usize>(decisions: [&str; N], loops: &[Called<'_, N>]) -> Vec<String> {
    let mut kinds: BTreeMap<&str, Vec<Called<'_, N>>> = BTreeMap::new();
    for one in loops {
        kinds.entry(one.kind).or_default().push(*one);
    }
    let mut rows: Vec<(&str, Vec<Called<'_, N>>)> = kinds.into_iter().collect();
    let rate = |loops: &[Called<'_, N>]| {
        let (called, all) = count(loops, false, 0);
        if all == 0 { -1.0 } else { called as f64 / all as f64 }
    };
    rows.sort_by(|a, b| rate(&b.1).total_cmp(&rate(&a.1)));
    rows.push(("all", loops.to_vec()));
    let row = |name: &str, cells: Vec<String>| {
        let cells: String = cells.iter().map(|cell| format!("  {cell:<26}")).collect();
        format!("  {name:<20}{cells}").trim_end().to_owned()
    };
    let heads = decisions.iter().flat_map(|name| ["TPR", "FPR"].map(|rate| format!("{rate}, {name}")));
    let mut lines = vec![row("moved by", heads.collect())];
    lines.extend(rows.iter().map(|(kind, loops)| {
        let cell = |decision, sticks| {
            let (called, all) = count(loops, sticks, decision);
            share(called, all)
        };
        row(kind, (0..N).flat_map(|decision| [cell(decision, true), cell(decision, false)]).collect())
    }));
    lines
}

/// Reliability of the probabilities, as lines of text.
#[must_use]
pub fn reliability_lines(all: &[Scored]) -> Vec<String> {
    let bins = tally::reliability_equal(all, 10);
    let bin = |b: &tally::Bin| {
        format!("  p {:.2}..{:.2}  mean {:.3}  sticking {:.3}  ({})", b.from, b.to, b.mean_p, b.rate, b.count)
    };
    let mut lines = vec!["reliability, bins of equally many loops:".to_owned()];
    lines.extend(bins.iter().map(bin));
    let off = tally::miscalibration(&bins).unwrap_or(f64::NAN);
    lines.push(format!("mean distance {off:.3}, Brier score {:.3}", tally::brier(all).unwrap_or(f64::NAN)));
    lines
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_kind_with_the_most_false_positives_comes_first() {
        let one = |kind, sticks, first, second| Called { kind, sticks, called: [first, second] };
        let loops = [
            one("calm", false, false, false),
            one("calm", true, true, false),
            one("worst", false, true, false),
            one("worst", false, true, true),
        ];
        let lines = table(["p >= 0.5", "p >= 0.7"], &loops);
        assert_eq!(lines.len(), 4);
        assert!(lines[1].trim_start().starts_with("worst") && lines[1].contains("2/2 100.0 %"), "{lines:?}");
        assert!(lines[2].contains("1/1 100.0 %") && lines[2].contains("0/1   0.0 %"), "{lines:?}");
        assert!(lines[3].trim_start().starts_with("all") && lines[3].contains("1/3  33.3 %"), "{lines:?}");
        assert_eq!(share(0, 0), "-");
    }
}
