//! The configured order of a plant: which loops are upstream of which.

use std::collections::{BTreeMap, BTreeSet};

use super::PlantLoop;

/// The loops that the configuration names upstream of each loop.
pub(super) struct Order<'a> {
    upstream: BTreeMap<&'a str, &'a [String]>,
}

impl<'a> Order<'a> {
    pub fn of(loops: &[PlantLoop<'a>]) -> Self {
        let told = loops.iter().filter(|l| !l.upstream.is_empty());
        Self { upstream: told.map(|l| (l.name, l.upstream)).collect() }
    }

    /// Whether `above` is upstream of `below`, directly or through other loops.
    pub fn is_upstream(&self, above: &str, below: &str) -> bool {
        let (mut seen, mut next) = (BTreeSet::new(), vec![below]);
        while let Some(name) = next.pop() {
            for name in self.upstream.get(name).copied().unwrap_or_default() {
                if name == above {
                    return true;
                }
                if seen.insert(name.as_str()) {
                    next.push(name);
                }
            }
        }
        false
    }

    /// Moves loops before those that they are upstream of, and otherwise keeps the order. If loops are upstream of each other
    /// (a recycle), the first one stays first.
    pub fn sort(&self, loops: &[PlantLoop], ranked: &mut Vec<usize>) {
        if self.upstream.is_empty() {
            return;
        }
        let mut left = std::mem::take(ranked);
        while !left.is_empty() {
            let is_first = |at: &usize| {
                let name = loops[left[*at]].name;
                let others = left.iter().filter(|other| loops[**other].name != name);
                !others.into_iter().any(|other| self.is_upstream(loops[*other].name, name))
            };
            let at = (0..left.len()).find(is_first).unwrap_or(0);
            ranked.push(left.remove(at));
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::core::record::Record;
    use crate::core::verdict::{Assessment, Oscillation, Window};

    /// Members ranked A, B, C ..., in the configured order.
    fn sorted(upstream: &[&[&str]]) -> String {
        let record = Record::uniform(1.0, vec![50.0; 40], vec![0.0; 40]);
        let oscillation = Oscillation {
            oscillating: true,
            period_s: None,
            periods: None,
            samples_per_period: None,
            regularity: None,
        };
        let assessment = Assessment::empty(Window::of(&record), oscillation);
        let names = ["A", "B", "C", "D"];
        let told: Vec<Vec<String>> = upstream.iter().map(|of| of.iter().map(|n| (*n).to_owned()).collect()).collect();
        let of = |k: usize| PlantLoop {
            name: names[k],
            record: &record,
            assessment: &assessment,
            area: None,
            upstream: &told[k],
        };
        let loops: Vec<PlantLoop> = (0..told.len()).map(of).collect();
        let mut ranked: Vec<usize> = (0..told.len()).collect();
        Order::of(&loops).sort(&loops, &mut ranked);
        ranked.iter().map(|k| names[*k]).collect()
    }

    #[test]
    fn upstream_loops_come_first_and_nothing_else_moves() {
        assert_eq!(sorted(&[&[], &[], &[]]), "ABC");
        assert_eq!(sorted(&[&["C"], &[], &[]]), "BCA");
        // D is upstream of A through B.
        assert_eq!(sorted(&[&["B"], &["D"], &[], &[]]), "CDBA");
        assert_eq!(sorted(&[&[], &["A", "elsewhere"], &[]]), "ABC");
    }

    #[test]
    fn a_recycle_keeps_the_order() {
        assert_eq!(sorted(&[&["B"], &["A"], &[]]), "CAB");
        assert_eq!(sorted(&[&["B"], &["A"]]), "AB");
    }
}
