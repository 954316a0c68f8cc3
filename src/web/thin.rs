//! Long curves with fewer points that look the same: the extremes stay.

/// Places, in rising order, of at most `most` of the points of curves over one axis. The axis is cut into stretches of
/// as many points each; of a stretch the lowest and highest value of every curve stay, and one point at which a curve
/// has no value where there is such a point, so that holes stay holes. First and last point always stay. Values that are
/// not finite count as missing; shorter curves have no value behind their end.
#[must_use]
pub fn places(length: usize, curves: &[&[f64]], most: usize) -> Vec<usize> {
    if length <= most {
        return (0..length).collect();
    }
    let each = 2 * curves.len() + 1;
    let stretches = (most.saturating_sub(2) / each).max(1);
    let mut kept = Vec::with_capacity(stretches * each + 2);
    kept.push(0);
    for stretch in 0..stretches {
        // In 128 bits no length is too great.
        let edge = |k: usize| (length as u128 * k as u128 / stretches as u128) as usize;
        let (from, to) = (edge(stretch), edge(stretch + 1));
        let mut hole = None;
        for curve in curves {
            let found = extremes(curve, from, to);
            kept.extend(found.ends.into_iter().flatten());
            hole = hole.or(found.hole);
        }
        kept.extend(hole);
    }
    kept.push(length - 1);
    kept.sort_unstable();
    kept.dedup();
    kept
}

/// What of one stretch of a curve stays.
struct Extremes {
    /// Places of the lowest and the highest value.
    ends: Option<[usize; 2]>,
    /// The first place without a value.
    hole: Option<usize>,
}

fn extremes(curve: &[f64], from: usize, to: usize) -> Extremes {
    let mut found = Extremes { ends: None, hole: None };
    for at in from..to {
        match curve.get(at).copied().filter(|value| value.is_finite()) {
            None => found.hole = found.hole.or(Some(at)),
            Some(value) => {
                let [low, high] = found.ends.get_or_insert([at, at]);
                if value < curve[*low] {
                    *low = at;
                }
                if value > curve[*high] {
                    *high = at;
                }
            }
        }
    }
    found
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn range(curve: &[f64], at: impl Iterator<Item = usize>) -> (f64, f64) {
        at.map(|k| curve[k]).filter(|v| v.is_finite()).fold((f64::MAX, f64::MIN), |(low, high), v| (low.min(v), high.max(v)))
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(256))]

        #[test]
        fn what_is_left_has_the_same_extremes_and_keeps_within_its_number(
            curve in prop::collection::vec(prop_oneof![9 => -1e6..1e6_f64, 1 => Just(f64::NAN)], 1..2_000),
            most in 5_usize..400,
        ) {
            let other: Vec<f64> = curve.iter().rev().copied().collect();
            let kept = places(curve.len(), &[&curve, &other], most.max(7));
            prop_assert!(kept.len() <= most.max(7));
            prop_assert!(kept.windows(2).all(|pair| pair[0] < pair[1]));
            prop_assert_eq!((kept[0], kept[kept.len() - 1]), (0, curve.len() - 1));
            for one in [&curve, &other] {
                prop_assert_eq!(range(one, kept.iter().copied()), range(one, 0..one.len()));
                prop_assert_eq!(one.iter().any(|v| v.is_nan()), kept.iter().any(|k| one[*k].is_nan() || other[*k].is_nan() || curve[*k].is_nan()));
            }
        }
    }

    #[test]
    fn a_spike_of_one_point_is_seen_and_short_curves_stay_whole() {
        let mut curve = vec![0.0; 1_000_000];
        curve[654_321] = 7.0;
        let kept = places(curve.len(), &[&curve], 500);
        assert!(kept.len() <= 500 && kept.contains(&654_321));
        assert_eq!(places(4, &[&[1.0, 2.0]], 10), [0, 1, 2, 3]);
        assert!(places(0, &[], 10).is_empty());
    }
}
