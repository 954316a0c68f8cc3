//! Thins a curve for a screen, keeping its extremes.

/// Indices of at most about `points` points of curves over one axis, ascending: the first and last, and the minimum and maximum
/// of each curve in every equal part between them. All indices if there are no more than `points`. Values that are not finite
/// count as missing.
#[must_use]
pub fn thin(curves: &[&[f64]], points: usize) -> Vec<usize> {
    let length = curves.iter().map(|c| c.len()).max().unwrap_or(0);
    if length <= points.max(2) {
        return (0..length).collect();
    }
    let parts = (points / (2 * curves.len()).max(1)).max(1);
    let mut places = vec![0, length - 1];
    for part in 0..parts {
        let range = part * length / parts..(part + 1) * length / parts;
        for curve in curves {
            let known = || range.clone().filter(|k| curve.get(*k).is_some_and(|v| v.is_finite()));
            places.extend(known().min_by(|a, b| curve[*a].total_cmp(&curve[*b])));
            places.extend(known().max_by(|a, b| curve[*a].total_cmp(&curve[*b])));
        }
    }
    places.sort_unstable();
    places.dedup();
    places
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn extremes_and_ends_stay(
            values in proptest::collection::vec(prop_oneof![9 => -1e3..1e3_f64, 1 => Just(f64::NAN)], 2..600),
            points in 2_usize..200,
        ) {
            let other: Vec<f64> = values.iter().map(|v| -v * v).collect();
            let places = thin(&[&values, &other], points);
            prop_assert!(places.is_sorted() && places.len() <= points.max(4) + 4 || places.len() == values.len());
            prop_assert_eq!((places[0], places[places.len() - 1]), (0, values.len() - 1));
            for curve in [&values, &other] {
                let best = |all: &mut dyn Iterator<Item = f64>| {
                    all.filter(|v| v.is_finite()).fold([f64::INFINITY, f64::NEG_INFINITY], |[a, b], v| [a.min(v), b.max(v)])
                };
                let all = best(&mut curve.iter().copied());
                prop_assert_eq!(best(&mut places.iter().map(|k| curve[*k])), all);
            }
        }
    }
}
