//! The answer of an estimate, computed in one place for every display: standing, sentence, probability, grade and size, all in
//! the unit in which sizes are reported.

use serde::Serialize;

use crate::core::verdict::answer::{Standing, grade, size};
use crate::core::verdict::{Assessment, Verdict};
use crate::words;

/// What an estimate answers. Whoever shows it takes every part from here, so that no two can contradict each other.
#[derive(Debug, Clone, PartialEq, Serialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct Answer {
    /// Where it stands.
    pub standing: Standing,
    /// The verdict in a sentence, without its grade.
    pub sentence: String,
    /// The probability in words: `p 0.96`, `open (p 0.41)`, `not seen (p 0.12)`, `no answer`.
    pub probability: String,
    /// The grade, where stiction was found.
    pub grade: Option<char>,
    /// s with its interval and unit, where stiction was found and a model was fitted.
    pub size: Option<String>,
}

impl Answer {
    /// Answer of an estimate.
    #[must_use]
    pub fn of(a: &Assessment) -> Self {
        Self {
            standing: Standing::of(a),
            sentence: words::claim(a),
            probability: words::seen(a),
            grade: grade(a),
            size: size(a),
        }
    }
}

/// The cause that more than half of these verdicts name, newest first; verdicts that find stiction or have no answer are left
/// out. If no cause has a majority, the loop oscillates for an unknown cause, or does not oscillate. Also returns how many
/// verdicts agree, out of how many.
#[must_use]
pub fn settled(newest_first: impl IntoIterator<Item = Verdict>) -> Option<(Verdict, usize, usize)> {
    /// Verdicts considered.
    const MOST: usize = 9;
    let last: Vec<Verdict> = newest_first.into_iter().filter(|v| v.stiction() == Some(false)).take(MOST).collect();
    let count = |named: &dyn Fn(Verdict) -> bool| last.iter().filter(|v| named(**v)).count();
    let more_than_half = |n: usize| 2 * n > last.len();
    let named = [Verdict::NotOscillating, Verdict::Tuning, Verdict::Disturbance, Verdict::CauseUnknown]
        .map(|cause| (cause, count(&|v| v == cause)));
    let oscillating = count(&|v| v != Verdict::NotOscillating);
    let (cause, n) = match named.into_iter().find(|(_, n)| more_than_half(*n)) {
        Some(named) => named,
        None if 2 * oscillating >= last.len() => (Verdict::CauseUnknown, oscillating),
        None => (Verdict::NotOscillating, last.len() - oscillating),
    };
    (!last.is_empty()).then_some((cause, n, last.len()))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::core::record::Record;
    use crate::core::verdict::answer::{OPEN_FROM, Scale};
    use crate::core::verdict::prevalence::{PREVALENCE, for_prevalence};
    use crate::core::verdict::rule::{Cuts, Opinion};
    use crate::core::verdict::{Oscillation, Window};
    use proptest::prelude::*;

    fn estimate(stiction: Option<bool>, p: f64, range: Option<[f64; 2]>) -> Assessment {
        let window = Window::of(&Record::uniform(1.0, vec![0.0; 40], vec![0.0; 40]));
        let oscillation = Oscillation {
            oscillating: true,
            period_s: None,
            periods: None,
            samples_per_period: None,
            regularity: None,
        };
        let verdict = match stiction {
            Some(true) => Verdict::Stiction,
            Some(false) => Verdict::NotOscillating,
            None => Verdict::Inconclusive,
        };
        Assessment {
            verdict,
            stiction,
            p_stiction: Some(for_prevalence(p, PREVALENCE)),
            p_calibrated: Some(p),
            prevalence: PREVALENCE,
            grade: Some('B'),
            s: Some(1.6),
            s_interval: Some([1.2, 2.0]),
            s_over_span: Some(0.4),
            op_range: range,
            op_unit: Some("mA".to_owned()),
            explanation: Some(Opinion { base: 0.0, logit: 0.0, cuts: Cuts { called: 0.5, alarm: 0.7 } }),
            ..Assessment::empty(window, oscillation)
        }
    }

    proptest! {
        #![proptest_config(ProptestConfig { failure_persistence: None, ..ProptestConfig::default() })]

        /// The parts of an answer agree: none contradicts another.
        #[test]
        fn no_part_of_an_answer_contradicts_another(
            called in prop::option::of(any::<bool>()),
            p in 0.0..1.0,
            range in prop::option::of(Just([4.0, 20.0])),
        ) {
            // A record is called sticking from the threshold up.
            let a = estimate(called.map(|_| p >= 0.5), p, range);
            let answer = Answer::of(&a);
            let found = answer.standing.is_found();
            prop_assert_eq!(answer.grade.is_some(), found);
            prop_assert_eq!(answer.size.is_some(), found);
            let all = format!("{} {} {}", words::headline(&a), words::sureness(&a), answer.probability);
            prop_assert_eq!(all.contains("valve sticks and slips"), found, "{}", &all);
            prop_assert_eq!(all.contains("not seen"), answer.standing == Standing::NotSeen, "{}", &all);
            prop_assert_eq!(all.contains("open (p"), answer.standing == Standing::Open, "{}", &all);
            prop_assert_eq!(answer.standing == Standing::Open, a.stiction == Some(false) && p >= OPEN_FROM);
            prop_assert!(!all.contains("grade") || found, "{}", &all);
            let unit = if range.is_some() { "% of travel" } else { "mA" };
            for text in answer.size.iter().chain(words::size(&a).iter()) {
                prop_assert!(text.contains(unit), "{}", text);
            }
        }
    }

    #[test]
    fn sizes_have_one_unit_and_a_second_only_where_it_differs() {
        let size_in = |range| size(&estimate(Some(true), 0.9, range)).unwrap();
        assert_eq!(size_in(None), "1.6 (1.2 to 2) mA");
        assert_eq!(size_in(Some([4.0, 20.0])), "10 (7.5 to 13) % of travel");
        let mut a = estimate(Some(true), 0.9, Some([4.0, 20.0]));
        assert_eq!(Scale::of(&a).told(1.6), "10 % of travel (1.6 mA)");
        a.op_range = Some([0.0, 100.0]);
        assert_eq!(Scale::of(&a).told(1.6), "1.6 % of travel");
        (a.s_over_span, a.s_interval) = (Some(1.0), Some([1.1, 1.6]));
        assert_eq!(size(&a).unwrap(), "1.6, at least 1.1 % of travel");
    }

    #[test]
    fn a_cause_is_shown_that_more_than_half_of_the_windows_name() {
        use Verdict::{CauseUnknown, Disturbance, Inconclusive, NotOscillating, Stiction, Tuning};
        assert_eq!(settled([Inconclusive, Stiction]), None);
        assert_eq!(settled([Disturbance, Stiction, Inconclusive, Tuning, Tuning]), Some((Tuning, 2, 3)));
        assert_eq!(settled([Disturbance, Tuning, CauseUnknown, Tuning, Disturbance]), Some((CauseUnknown, 5, 5)));
        assert_eq!(settled([NotOscillating, NotOscillating, Tuning]), Some((NotOscillating, 2, 3)));
        assert_eq!(settled([Tuning, NotOscillating]), Some((CauseUnknown, 1, 2)));
        assert_eq!(settled(std::iter::repeat_n(Tuning, 4).chain([Disturbance; 30])), Some((Disturbance, 5, 9)));
    }
}
