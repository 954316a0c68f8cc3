//! A minimum by a simplex of points (Nelder and Mead 1965) whose steps suit the number of variables (Gao and Han 2012).

/// Cost below which the simplex is as good as flat.
const FLAT: f64 = 0.02;

/// The best point within `most` evaluations, begun at `start` with these steps, and its cost.
pub(super) fn minimum(
    start: &[f64],
    steps: &[f64],
    most: usize,
    mut cost: impl FnMut(&[f64]) -> f64,
) -> (Vec<f64>, f64) {
    let mut cost = |x: &[f64]| Some(cost(x)).filter(|c| !c.is_nan()).unwrap_or(f64::INFINITY);
    let size = start.len();
    let n = size as f64;
    let [grow, inwards, shrink] = [1.0 + 2.0 / n, 0.75 - 0.5 / n, 1.0 - 1.0 / n];
    let mut all = vec![(start.to_vec(), cost(start))];
    for k in 0..size {
        let mut x = start.to_vec();
        x[k] += steps[k];
        let value = cost(&x);
        all.push((x, value));
    }
    let mut made = size + 1;
    loop {
        all.sort_by(|x, y| x.1.total_cmp(&y.1));
        let (best, worst) = (all[0].1, all[size].1);
        if made >= most || worst - best < FLAT {
            return all.swap_remove(0);
        }
        let centre: Vec<f64> = (0..size).map(|k| all[..size].iter().map(|(x, _)| x[k]).sum::<f64>() / n).collect();
        // From the worst point through the centre, and as far beyond.
        let mut along = |by: f64| {
            made += 1;
            let x: Vec<f64> = centre.iter().zip(&all[size].0).map(|(c, w)| c + by * (c - w)).collect();
            let value = cost(&x);
            (x, value)
        };
        let beyond = along(1.0);
        let next = if beyond.1 < best {
            let far = along(grow);
            Some(if far.1 < beyond.1 { far } else { beyond })
        } else if beyond.1 < all[size - 1].1 {
            Some(beyond)
        } else {
            let outside = beyond.1 < worst;
            let near = along(if outside { inwards } else { -inwards });
            (near.1 < beyond.1.min(worst)).then_some(near)
        };
        if let Some(next) = next {
            all[size] = next;
            continue;
        }
        let top = all[0].0.clone();
        for (x, value) in all.iter_mut().skip(1) {
            x.iter_mut().zip(&top).for_each(|(x, top)| *x = top + shrink * (*x - top));
            *value = cost(x);
            made += 1;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_curved_valley_ends_at_its_bottom() {
        let valley =
            |x: &[f64]| 1e3 * (100.0 * (x[1] - x[0] * x[0]) * (x[1] - x[0] * x[0]) + (1.0 - x[0]) * (1.0 - x[0]));
        let (at, cost) = minimum(&[-1.2, 1.0], &[0.5, 0.5], 1_000, valley);
        assert!((at[0] - 1.0).abs() < 0.05 && cost < 1.0, "{at:?} {cost}");
        // Not a number is worse than all.
        let (at, _) = minimum(&[1.0], &[0.5], 200, |x| if x[0] < 0.1 { f64::NAN } else { x[0] });
        assert!((0.1..0.3).contains(&at[0]), "{at:?}");
    }
}
