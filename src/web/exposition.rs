//! `/metrics` in the two formats that collectors ask for, including figures of the process.

use std::fmt::Write as _;

/// Media type of OpenMetrics.
pub(super) const OPEN_METRICS: &str = "application/openmetrics-text; version=1.0.0; charset=utf-8";
/// Media type of the older Prometheus format, which `promtool check metrics` reads.
pub(super) const PLAIN: &str = "text/plain; version=0.0.4; charset=utf-8";

/// Format of an answer.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Form {
    /// OpenMetrics.
    Open,
    /// The older format.
    Plain,
    /// The client accepts neither.
    Neither,
}

/// The format that the request prefers (RFC 9110, 12.5.1). Without a preference it is OpenMetrics; for `*/*` it is the older
/// format, which every tool reads.
pub(super) fn form(accept: Option<&str>) -> Form {
    let Some(accept) = accept.filter(|a| !a.trim().is_empty()) else { return Form::Open };
    let [open, plain] = [["application", "openmetrics-text"], ["text", "plain"]].map(|kind| weight(accept, kind));
    match (open, plain) {
        (o, p) if o <= 0.0 && p <= 0.0 => Form::Neither,
        (o, p) if o > p || (o >= p && accept.contains("openmetrics-text")) => Form::Open,
        _ => Form::Plain,
    }
}

/// Weight of a media type in the request, from the most specific matching range; 0 if not accepted.
fn weight(accept: &str, [kind, subtype]: [&str; 2]) -> f64 {
    let mut best = (0, 0.0);
    for range in accept.split(',') {
        let mut parts = range.split(';').map(str::trim);
        let (name, rest) = (parts.next().unwrap_or_default().to_ascii_lowercase(), parts);
        let telling = match name.split_once('/') {
            Some((k, s)) if k == kind && s == subtype => 3,
            Some((k, "*")) if k == kind => 2,
            Some(("*", "*")) => 1,
            _ => continue,
        };
        let q = rest.filter_map(|p| p.strip_prefix("q=")?.trim().parse::<f64>().ok()).next().unwrap_or(1.0);
        if telling > best.0 || (telling == best.0 && q > best.1) {
            best = (telling, q);
        }
    }
    best.1
}

/// Converts OpenMetrics to the older format, in which a counter is described under the name of its samples.
pub(super) fn plain(open_metrics: &str) -> String {
    let types = open_metrics.lines().filter_map(|line| line.strip_prefix("# TYPE ")?.split_once(' '));
    let types: std::collections::HashMap<&str, &str> = types.collect();
    let mut out = String::with_capacity(open_metrics.len() + 1024);
    for line in open_metrics.lines() {
        let described = line.strip_prefix("# HELP ").or_else(|| line.strip_prefix("# TYPE "));
        match described.and_then(|rest| rest.split_once(' ')) {
            _ if line == "# EOF" || line.starts_with("# UNIT ") => {}
            Some((name, rest)) => {
                let keyword = &line[..7];
                // The older format has no info type; it is a gauge of 1.
                let (end, rest) = match (types.get(name), rest) {
                    (Some(&"counter"), rest) => ("_total", rest),
                    (Some(&"info"), "info") => ("_info", "gauge"),
                    (Some(&"info"), rest) => ("_info", rest),
                    (_, rest) => ("", rest),
                };
                let _ = writeln!(out, "{keyword}{name}{end} {}", rest.trim_end_matches('.'));
            }
            None => {
                let _ = writeln!(out, "{line}");
            }
        }
    }
    out
}

/// CPU time, memory, files and start time of this process, under the names that collectors know; empty if the system does not
/// provide them.
pub(super) fn of_process() -> String {
    process().unwrap_or_default()
}

#[cfg(target_os = "linux")]
fn process() -> Option<String> {
    let stat = std::fs::read_to_string("/proc/self/stat").ok()?;
    // The process name before it may contain spaces and brackets. Fields are counted from the state, which is the third.
    let fields: Vec<&str> = stat.rsplit_once(')')?.1.split_whitespace().collect();
    let field = |number: usize| fields.get(number - 3).and_then(|f| f.parse::<f64>().ok());
    let (ticks, page) = (rustix::param::clock_ticks_per_second() as f64, rustix::param::page_size() as f64);
    let cpu_s = (field(14)? + field(15)?) / ticks;
    let boot_s: f64 = std::fs::read_to_string("/proc/stat")
        .ok()?
        .lines()
        .find_map(|l| l.strip_prefix("btime "))
        .and_then(|t| t.trim().parse().ok())?;
    let files = std::fs::read_dir("/proc/self/fd").ok()?.count();
    let limits = std::fs::read_to_string("/proc/self/limits").ok()?;
    let most = limits.lines().find_map(|l| l.strip_prefix("Max open files")).and_then(|l| l.split_whitespace().next());
    let mut out = String::new();
    let mut gauge = |name: &str, help: &str, value: f64| {
        let _ = writeln!(out, "# HELP {name} {help}.\n# TYPE {name} gauge\n{name} {value}");
    };
    gauge("process_resident_memory_bytes", "Resident memory size in bytes", field(24)? * page);
    gauge("process_virtual_memory_bytes", "Virtual memory size in bytes", field(23)?);
    gauge("process_start_time_seconds", "Start time of the process since 1970 in seconds", boot_s + field(22)? / ticks);
    gauge("process_threads", "Threads of the process", field(20)?);
    gauge("process_open_fds", "Open file descriptors", files as f64);
    if let Some(most) = most.and_then(|m| m.parse::<f64>().ok()) {
        gauge("process_max_fds", "Most file descriptors that may be open", most);
    }
    let name = "process_cpu_seconds";
    let _ = writeln!(
        out,
        "# HELP {name} User and system CPU time in seconds.\n# TYPE {name} counter\n{name}_total {cpu_s}"
    );
    Some(out)
}

#[cfg(not(target_os = "linux"))]
fn process() -> Option<String> {
    None
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_older_form_describes_samples_by_their_own_names() {
        let open = "# HELP a Messages.\n# TYPE a counter\na_total 3\n# HELP b Build.\n# TYPE b info\nb_info{version=\"1\"} 1\n\
                    # HELP c Waiting.\n# TYPE c gauge\n# UNIT c bytes\nc 2\n# EOF\n";
        let text = plain(open);
        assert!(text.contains("# HELP a_total Messages\n# TYPE a_total counter\na_total 3\n"), "{text}");
        assert!(
            text.contains("# HELP b_info Build\n# TYPE b_info gauge\nb_info{")
                && text.contains("# TYPE c gauge\nc 2\n"),
            "{text}"
        );
        assert!(!text.contains("EOF") && !text.contains("UNIT"), "{text}");
        for (accept, wanted) in [
            (None, Form::Open),
            (Some(""), Form::Open),
            (Some("*/*"), Form::Plain),
            (Some("text/plain"), Form::Plain),
            (Some("text/html,application/xml;q=0.9,*/*;q=0.8"), Form::Plain),
            (Some("application/openmetrics-text;version=1.0.0,text/plain;q=0.5"), Form::Open),
            (Some("application/openmetrics-text; version=1.0.0"), Form::Open),
            (Some("application/openmetrics-text;q=0.3, text/plain;version=0.0.4;q=0.4"), Form::Plain),
            (Some("application/openmetrics-text;q=0,*/*"), Form::Plain),
            (Some("application/json"), Form::Neither),
        ] {
            assert_eq!(form(accept), wanted, "{accept:?}");
        }
    }

    #[cfg(target_os = "linux")]
    #[test]
    fn the_process_tells_of_itself() {
        let text = of_process();
        let value = |name: &str| -> f64 {
            let line = text.lines().find_map(|l| l.strip_prefix(name)).unwrap();
            line.trim().parse().unwrap()
        };
        assert!(value("process_resident_memory_bytes ") > 1e6 && value("process_open_fds ") >= 3.0);
        let now = std::time::SystemTime::now().duration_since(std::time::UNIX_EPOCH).unwrap().as_secs_f64();
        assert!((now - value("process_start_time_seconds ")).abs() < 86_400.0);
        assert!(value("process_cpu_seconds_total ") >= 0.0);
    }
}
