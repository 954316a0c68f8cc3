//! The command line that makes a report, as quoted in reports.

/// A command that can be pasted into a shell.
pub fn command_line(arguments: impl Iterator<Item = String>) -> String {
    let plain = |c: char| c.is_ascii_alphanumeric() || "-_./,:=+@%".contains(c);
    let quoted = arguments.enumerate().map(|(k, text)| {
        // The program by name only, since its path differs between machines.
        let text = if k == 0 { text.rsplit('/').next().unwrap_or("stictiond").to_owned() } else { text };
        if !text.is_empty() && text.chars().all(plain) { text } else { format!("'{}'", text.replace('\'', "'\\''")) }
    });
    quoted.collect::<Vec<_>>().join(" ")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_command_can_be_pasted() {
        let given = ["/usr/bin/stictiond", "analyze", "my file.csv", "--loop", "it's", ""].map(str::to_owned);
        assert_eq!(command_line(given.into_iter()), "stictiond analyze 'my file.csv' --loop 'it'\\''s' ''");
    }
}
