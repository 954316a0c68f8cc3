//! `[alarm]`: how many windows raise an alarm, and the size above which a window counts.

use super::reader::TableReader;
use crate::alarm::AlarmParams;

/// Reads a table of alarm keys. Setting one limit removes the default of the other: a limit of 2 OP units is not meant in
/// addition to a share of the span.
pub(super) fn read_alarm(r: &mut TableReader<'_, '_>, d: AlarmParams) -> AlarmParams {
    let mut raise = d.raise;
    if let Some(([m, n], line)) = r.pair("raise", "two whole numbers, such as [3, 4]") {
        let whole = |x: f64| x.fract() == 0.0 && (1.0..=32.0).contains(&x);
        if whole(m) && whole(n) && m <= n {
            raise = [m as u8, n as u8];
        } else {
            r.refuse(
                line,
                "raise",
                format!("[{m}, {n}] is not a valid m of n"),
                "write 1 <= m <= n <= 32, such as [3, 4]",
            );
        }
    }
    let limits = [r.number("s_limit_op", f64::NAN, 0.0, 1e12), r.number("s_limit_span", f64::NAN, 0.0, 1.0)];
    let [s_limit_op, s_limit_span] = if limits.iter().all(|limit| limit.is_nan()) {
        [d.s_limit_op, d.s_limit_span]
    } else {
        limits.map(|limit| if limit.is_nan() { 0.0 } else { limit })
    };
    AlarmParams { raise, s_limit_op, s_limit_span }
}

#[cfg(test)]
mod tests {
    use crate::config::Config;

    #[test]
    fn a_limit_that_is_set_holds_alone_and_two_hold_together() {
        let limits = |common: &str, own: &str| {
            let text = format!("[site]\nprefix = \"p\"\n[alarm]\n{common}\n[[loop]]\nname = \"A\"\n{own}\n");
            let a = Config::parse(&text).unwrap().loop_named("A").unwrap().alarm;
            (a.s_limit_op, a.s_limit_span)
        };
        assert_eq!(limits("", ""), (1.0, 0.1));
        assert_eq!(limits("s_limit_op = 2", ""), (2.0, 0.0));
        assert_eq!(limits("s_limit_op = 2", "s_limit_span = 0.3"), (0.0, 0.3));
        assert_eq!(limits("s_limit_span = 0.2", "raise = [1, 2]"), (0.0, 0.2));
        assert_eq!(limits("", "s_limit_op = 0.5\ns_limit_span = 0.2"), (0.5, 0.2));
        assert_eq!(limits("s_limit_op = 0", ""), (0.0, 0.0));
    }
}
