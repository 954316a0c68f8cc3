//! The horizontal axis: values, or times.

use std::ops::Range;

use plotters::coord::ranged1d::{DefaultFormatting, KeyPointHint, Ranged};
use plotters::coord::types::RangedCoordf64;

use stiction::core::units::{format_rfc3339, is_date, ns_from_s, to_decimals};

/// Pixels needed by a label: a number or a time of day, and a date with its time.
const LABEL: u32 = 62;
const LONG_LABEL: u32 = 92;
/// Possible intervals between time labels, s.
const STEPS_S: [f64; 22] = [
    1.0,
    2.0,
    5.0,
    10.0,
    15.0,
    30.0,
    60.0,
    120.0,
    300.0,
    600.0,
    900.0,
    1_800.0,
    3_600.0,
    7_200.0,
    10_800.0,
    21_600.0,
    43_200.0,
    DAY_S,
    172_800.0,
    432_000.0,
    864_000.0,
    2_592_000.0,
];
const DAY_S: f64 = 86_400.0;

/// What a horizontal axis shows.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Across {
    label: String,
    /// Stamp of the axis' zero, if the labels are times of day.
    start_ns: Option<i64>,
    /// Whether the axis is in seconds; long ones are labelled in minutes, hours or days.
    is_time: bool,
    labelled: bool,
}

/// Unit for the labels of an axis of this width, and its length in seconds.
fn unit_of(width_s: f64) -> (f64, &'static str) {
    match width_s {
        w if w > 3.0 * DAY_S => (DAY_S, "d"),
        w if w > 3.0 * 3_600.0 => (3_600.0, "h"),
        w if w > 3.0 * 600.0 => (60.0, "min"),
        _ => (1.0, "s"),
    }
}

impl Across {
    /// Values, with a label that includes the unit.
    #[must_use]
    pub fn value(label: &str) -> Self {
        Self { label: label.to_owned(), start_ns: None, is_time: false, labelled: true }
    }

    /// Seconds from a stamp: labelled in UTC if the stamp is a date, else as time from the start.
    #[must_use]
    pub fn time_from(start_ns: i64) -> Self {
        let start_ns = is_date(start_ns).then_some(start_ns);
        Self { start_ns, is_time: true, ..Self::value("time from the section's start") }
    }

    /// The same axis without labels, for a panel above the lowest.
    #[must_use]
    pub fn without_labels(&self) -> Self {
        Self { labelled: false, ..self.clone() }
    }

    /// Whether it has labels.
    pub(super) const fn labelled(&self) -> bool {
        self.labelled
    }

    /// The title below the labels.
    pub(super) fn title(&self, [from, to]: [f64; 2]) -> String {
        match self.start_ns {
            _ if !self.labelled => String::new(),
            None if self.is_time => format!("{}, {}", self.label, unit_of(to - from).1),
            None => self.label.clone(),
            Some(start_ns) => {
                let [first, last] = [from, to].map(|s| format_rfc3339(start_ns + ns_from_s(s))[..10].to_owned());
                if first == last { format!("UTC, {first}") } else { format!("UTC, {first} to {last}") }
            }
        }
    }

    /// Positions of labels and grid lines on an axis of this width.
    pub(super) fn ticks(&self, x: [f64; 2], pixels: u32) -> Vec<f64> {
        let Some(start_ns) = self.start_ns else {
            let unit_s = if self.is_time { unit_of(x[1] - x[0]).0 } else { 1.0 };
            let at = ticks(x.map(|end| end / unit_s), (pixels / LABEL).clamp(2, 14) as usize);
            return at.into_iter().map(|t| t * unit_s).collect();
        };
        let wide = if x[1] - x[0] > DAY_S { LONG_LABEL } else { LABEL };
        let step_s = clock_step_s(x, (pixels / wide).clamp(2, 14));
        // At whole intervals of the clock, not counted from the start of the record.
        let into_step_s = start_ns.rem_euclid(ns_from_s(step_s)) as f64 * 1e-9;
        let first = ((x[0] + into_step_s) / step_s - 1e-9).ceil();
        (0..50)
            .map(|k| (first + f64::from(k)) * step_s - into_step_s)
            .take_while(|t| *t <= x[1] + 1e-9 * step_s)
            .collect()
    }

    /// Text of the label at a value.
    pub(super) fn tick(&self, value: f64, x: [f64; 2]) -> String {
        match self.start_ns {
            _ if !self.labelled => String::new(),
            None => {
                let unit_s = if self.is_time { unit_of(x[1] - x[0]).0 } else { 1.0 };
                tick(value / unit_s, (x[1] - x[0]) / unit_s)
            }
            Some(start_ns) => {
                let stamp = format_rfc3339(start_ns + ns_from_s(value.round()));
                match x[1] - x[0] {
                    span if span > 14.0 * DAY_S => stamp[5..10].to_owned(),
                    span if span > DAY_S => format!("{} {}", &stamp[5..10], &stamp[11..16]),
                    span if span > 600.0 => stamp[11..16].to_owned(),
                    _ => stamp[11..19].to_owned(),
                }
            }
        }
    }
}

/// The smallest interval that needs at most this many labels.
fn clock_step_s(x: [f64; 2], labels: u32) -> f64 {
    let least = (x[1] - x[0]) / f64::from(labels);
    STEPS_S.into_iter().find(|step| *step >= least).unwrap_or_else(|| (least / DAY_S).ceil() * DAY_S)
}

/// Round values within a range, about `count` of them.
pub(super) fn ticks(x: [f64; 2], count: usize) -> Vec<f64> {
    let raw = (x[1] - x[0]) / count.max(1) as f64;
    let scale = 10.0_f64.powf(raw.log10().floor());
    let step = [1.0, 2.0, 5.0, 10.0].into_iter().map(|k| k * scale).find(|s| *s >= raw * 0.999).unwrap_or(raw);
    let first = (x[0] / step - 1e-9).ceil() as i64;
    (first..).map(|k| k as f64 * step).take_while(|v| *v <= x[1] + 1e-9 * step).take(50).collect()
}

/// Text of a tick on an axis that spans `width`, with enough digits to tell ticks apart.
pub(super) fn tick(value: f64, width: f64) -> String {
    let size = value.abs();
    if value != 0.0 && (size >= 1e6 || (size < 1e-4 && width < 1e-4)) {
        return format!("{value:.1e}");
    }
    let digits = (1.3 - width.max(1e-12).log10()).ceil().clamp(0.0, 9.0) as usize;
    let text = to_decimals(value, digits);
    if text == "-0" { "0".to_owned() } else { text.replace('-', "\u{2212}") }
}

/// A horizontal scale with labels and grid lines from [`Across`].
#[derive(Clone)]
pub(super) struct Ticked {
    scale: RangedCoordf64,
    ticks: Vec<f64>,
}

impl Ticked {
    pub(super) fn new(x: [f64; 2], ticks: Vec<f64>) -> Self {
        Self { scale: (x[0]..x[1]).into(), ticks }
    }
}

impl Ranged for Ticked {
    type FormatOption = DefaultFormatting;
    type ValueType = f64;

    fn map(&self, value: &f64, limit: (i32, i32)) -> i32 {
        self.scale.map(value, limit)
    }

    fn key_points<Hint: KeyPointHint>(&self, _hint: Hint) -> Vec<f64> {
        self.ticks.clone()
    }

    fn range(&self) -> Range<f64> {
        self.scale.range()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ticks_can_be_told_apart() {
        assert_eq!(
            (tick(0.5, 2.0), tick(-0.05, 0.2), tick(100.0, 400.0)),
            ("0.5".into(), "\u{2212}0.05".into(), "100".into())
        );
        assert_eq!(ticks([-0.3, 5.8], 5), [0.0, 2.0, 4.0]);
        assert_ne!(tick(1.001, 0.004), tick(1.002, 0.004));
        assert_eq!(tick(-1e-17, 1.0), "0");
    }

    #[test]
    fn a_clock_is_labelled_at_whole_steps_of_its_own() {
        // 2026-01-06T08:07:30Z.
        let across = Across::time_from(1_767_686_850_000_000_000);
        let x = [0.0, 3_600.0];
        let said: Vec<String> = across.ticks(x, 600).iter().map(|t| across.tick(*t, x)).collect();
        assert_eq!(said, ["08:10", "08:20", "08:30", "08:40", "08:50", "09:00"]);
        assert_eq!(across.title(x), "UTC, 2026-01-06");
        let days = [0.0, 3.0 * DAY_S];
        let said: Vec<String> = across.ticks(days, 600).iter().map(|t| across.tick(*t, days)).collect();
        assert_eq!(said[..2], ["01-06 12:00", "01-07 00:00"]);
        assert_eq!(across.title(days), "UTC, 2026-01-06 to 2026-01-09");
        assert!(across.without_labels().tick(150.0, x).is_empty());
    }

    #[test]
    fn a_clock_that_starts_at_zero_is_told_in_the_unit_of_its_length() {
        let across = Across::time_from(0);
        assert_eq!(across.tick(600.0, [0.0, 1_200.0]), "600");
        assert_eq!(across.title([0.0, 1_200.0]), "time from the section's start, s");
        let days = [0.0, 432_000.0];
        let said: Vec<String> = across.ticks(days, 400).iter().map(|t| across.tick(*t, days)).collect();
        assert_eq!(
            (said.join(" ").as_str(), across.title(days).as_str()),
            ("0 1 2 3 4 5", "time from the section's start, d")
        );
    }
}
