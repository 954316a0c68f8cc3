//! Names from outside: shown and written into command lines, but never used as a path on this machine.

/// Longest name, characters.
const LONGEST: usize = 120;

/// A displayable name for a file from outside: the last part of the given name, whichever system it is from, without control
/// characters. The extension remains, since loops of tables are named after their files.
#[must_use]
pub fn shown(sent: &str) -> String {
    let last = sent.rsplit(['/', '\\']).find(|part| !part.trim().is_empty()).unwrap_or_default();
    // Marks that reverse the direction of text can disguise a file extension.
    let steers = |c: &char| {
        c.is_control()
            || matches!(c, '\u{200b}'..='\u{200f}' | '\u{2028}'..='\u{202e}' | '\u{2066}'..='\u{2069}' | '\u{feff}')
    };
    let plain: String = last.chars().filter(|c| !steers(c)).collect();
    let plain = plain.trim_start_matches(|c: char| c.is_whitespace() || c == '.' || c == '-').trim_end();
    let count = plain.chars().count();
    let name: String = match plain.rsplit_once('.') {
        Some((stem, ending)) if count > LONGEST && ending.chars().count() < 10 => {
            let room = LONGEST - ending.chars().count() - 1;
            format!("{}.{ending}", stem.chars().take(room).collect::<String>())
        }
        _ => plain.chars().take(LONGEST).collect(),
    };
    // Remove a space that is now at the end.
    let name = name.trim_end();
    if name.is_empty() { "file".to_owned() } else { name.to_owned() }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(256))]

        #[test]
        fn no_name_is_a_path_or_an_option(sent in "\\PC{0,300}", inside in prop::sample::select(vec!["/", "\\", "..", "\0", "\u{202e}", "-", ""])) {
            let name = shown(&format!("{sent}{inside}{sent}"));
            prop_assert!(!name.is_empty() && name.chars().count() <= LONGEST);
            let steering = ['/', '\\', '\0', '\n', '\u{202e}'];
            prop_assert!(!name.contains(steering));
            prop_assert!(!name.starts_with(['.', '-']));
            prop_assert_eq!(std::path::Path::new(&name).components().count(), 1);
            // A clean name is not changed.
            prop_assert_eq!(shown(&name), name);
        }
    }

    #[test]
    fn plain_names_stay() {
        for (sent, name) in [
            ("loop4.csv", "loop4.csv"),
            ("../../etc/passwd", "passwd"),
            ("C:\\data\\Füllstand 1.xlsx", "Füllstand 1.xlsx"),
            ("..", "file"),
            ("/", "file"),
            ("--out=x.csv", "out=x.csv"),
            ("a\u{202e}vsc.exe", "avsc.exe"),
            ("- -x.csv", "x.csv"),
        ] {
            assert_eq!(shown(sent), name, "{sent}");
        }
        let long = shown(&format!("{}.csv", "x".repeat(500)));
        assert!(long.ends_with("x.csv") && long.len() == LONGEST);
        let cut_at_a_space = format!("{} {}", "x".repeat(LONGEST - 1), "y".repeat(20));
        assert_eq!(shown(&cut_at_a_space), "x".repeat(LONGEST - 1));
    }
}
