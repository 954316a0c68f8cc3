//! Comma-separated values in options.

use stiction::core::verdict::prevalence::SHARES;

/// Two words separated by a comma, such as `example`.
///
/// # Errors
/// There is no comma.
pub fn pair<'t>(text: &'t str, example: &str) -> Result<(&'t str, &'t str), String> {
    text.split_once(',').ok_or_else(|| format!("write two values with a comma between them, such as {example}"))
}

/// Two numbers, lower first.
///
/// # Errors
/// One is not a number, or the first is not smaller than the second.
pub fn rising(text: &str) -> Result<[f64; 2], String> {
    let (low, high) = pair(text, "0,100")?;
    let number = |s: &str| s.trim().parse::<f64>().map_err(|_| format!("{s:?} is not a number"));
    let range = [number(low)?, number(high)?];
    if range[1] > range[0] { Ok(range) } else { Err("the upper end must be above the lower".to_owned()) }
}

/// A fraction strictly between 0 and 1, within [`SHARES`].
///
/// # Errors
/// It is not a number, or outside the limits.
pub fn share(text: &str) -> Result<f64, String> {
    let share = text.trim().parse::<f64>().map_err(|_| format!("{text:?} is not a number"))?;
    let [least, most] = SHARES;
    let message = || format!("{text} is not a share; write one from {least} to {most}, such as 0.1 for one in ten");
    (least..=most).contains(&share).then_some(share).ok_or_else(message)
}

#[cfg(test)]
mod tests {
    use super::{rising, share};

    #[test]
    fn two_rising_numbers_are_read_or_refused() {
        assert_eq!(rising("0, 100"), Ok([0.0, 100.0]));
        assert!(rising("5,5").is_err() && rising("5").is_err() && rising("a,b").is_err());
    }

    #[test]
    fn a_share_is_neither_nothing_nor_all() {
        assert_eq!(share("0.1"), Ok(0.1));
        assert!(["0", "1", "30", "a", "nan"].iter().all(|text| share(text).is_err()));
    }
}
