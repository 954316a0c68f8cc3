//! Explains why an alarm is not active: how the newest windows of its loop counted.

use super::{AlarmParams, Evidence, no_alarm, s_limit};
use stiction::core::people::size;
use stiction::core::verdict::Assessment;
use stiction::words;

/// Most reasons listed.
const LISTED: usize = 4;

/// Why the alarm of a loop is not active after these windows, oldest first.
#[must_use]
pub fn why_not_active(windows: &[Assessment], params: &AlarmParams) -> String {
    let [m, n] = params.raise.map(usize::from);
    let counts = |a: &&Assessment| Evidence::of(a, params) != Evidence::None;
    let counting: Vec<&Assessment> = windows.iter().rev().filter(counts).take(n).collect();
    let found = counting.iter().filter(|a| Evidence::of(a, params) == Evidence::For).count();
    let mut told: Vec<String> = Vec::new();
    for why in windows.iter().rev().take(n).chain(counting.iter().copied()).filter_map(|a| why_not(a, params)) {
        if !told.contains(&why) && told.len() < LISTED {
            told.push(why);
        }
    }
    let of = match counting.len() {
        0 => "no window counts".to_owned(),
        1 => format!("{found} of 1 window that counts finds stiction of at least the limit"),
        some => format!("{found} of the last {some} windows that count find stiction of at least the limit"),
    };
    let because = if told.is_empty() { String::new() } else { format!(": {}", told.join("; ")) };
    format!("{of}, {m} of {n} are needed{because}")
}

/// Why a window does not count towards raising the alarm; `None` if it does.
fn why_not(a: &Assessment, params: &AlarmParams) -> Option<String> {
    match (Evidence::of(a, params), a.stiction) {
        (Evidence::For, _) => None,
        (_, Some(false)) => Some("no stiction found".to_owned()),
        (Evidence::Against | Evidence::Between, _) => {
            let (s, limit) = (a.s.unwrap_or(0.0), s_limit(a, params).unwrap_or(0.0));
            Some(format!("s {} is below the limit of {} OP units", size(s), size(limit)))
        }
        (Evidence::None, None) => Some(a.reason.map_or_else(|| "no answer".to_owned(), words::reason)),
        (Evidence::None, Some(true)) => Some(no_alarm(a).unwrap_or("the window does not count").to_owned()),
    }
}
