//! Detects values held over several rows: a historian that samples more slowly than it exports repeats each value, so the
//! distances between changes are multiples of the same number of rows.

/// Fewest changes needed, and the share of them that must fit.
const FEWEST: usize = 30;
const FIT: f64 = 0.95;

/// Number of rows for which each value is held; 1 if none is held.
#[must_use]
pub fn held_over(values: &[f64]) -> usize {
    let changes: Vec<usize> = (1..values.len()).filter(|k| values[*k] != values[*k - 1]).collect();
    if changes.len() < FEWEST || 2 * changes.len() > values.len() + 1 {
        return 1;
    }
    let counts = |of: &mut dyn Iterator<Item = usize>| {
        let mut counts = vec![0_usize; values.len()];
        of.for_each(|n| counts[n] += 1);
        counts
    };
    let runs = counts(&mut changes.windows(2).map(|w| w[1] - w[0]));
    let usual = runs.iter().enumerate().max_by_key(|(_, count)| **count).map_or(1, |(run, _)| run);
    let fits = |rows: &usize| {
        let places = counts(&mut changes.iter().map(|k| k % rows));
        places.into_iter().max().unwrap_or(0) as f64 >= FIT * changes.len() as f64
    };
    (2..=usual).rev().filter(|rows| usual % rows == 0).find(fits).unwrap_or(1)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rows_per_value_are_counted_where_all_changes_fit() {
        let noise = |k: usize| (k.wrapping_mul(2_654_435_761) >> 7 & 1023) as f64;
        for rows in [1, 2, 5, 12] {
            let held: Vec<f64> = (3..1000).map(|k| noise(k / rows)).collect();
            assert_eq!(held_over(&held), rows);
        }
        // Occasionally equal by chance, and one row missing.
        let mut few: Vec<f64> = (0..1000).map(|k| (noise(k / 5) / 100.0).round()).collect();
        assert_eq!(held_over(&few), 5);
        few.remove(990);
        assert_eq!(held_over(&few), 5);
        // A coarse sensor repeats its value at irregular distances.
        let coarse: Vec<f64> =
            (0..1000).map(|k| libm::sin(k as f64 / 17.3).mul_add(6.0, noise(k) / 2000.0).round()).collect();
        assert_eq!(held_over(&coarse), 1);
        assert_eq!((held_over(&[1.0; 500]), held_over(&[])), (1, 1));
    }
}
