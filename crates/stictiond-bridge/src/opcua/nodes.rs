//! The list of nodes, one `NODEID [KEY]` per line, and the keys of nodes without one.

use std::collections::HashMap;
use std::fmt::Write as _;

use crate::bus::is_key;

/// A subscribed node.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Node {
    /// Identifier as OPC UA writes it: `ns=2;s=FIC101.OP`, or `nsu=URI;s=FIC101.OP`.
    pub id: String,
    /// Key below the prefix.
    pub key: String,
}

/// Reads the list.
///
/// # Errors
/// Every fault with its line number.
pub fn read(text: &str) -> Result<Vec<Node>, Vec<String>> {
    let (mut nodes, mut faults, mut lines) = (Vec::new(), Vec::new(), HashMap::new());
    for (line, text) in text.lines().enumerate().map(|(at, text)| (at + 1, text)) {
        match node(text) {
            Ok(None) => {}
            Ok(Some(node)) => match lines.insert(node.key.clone(), line) {
                Some(first) => faults.push(format!(
                    "line {line}: line {first} already uses the key {:?}; write another key after the node",
                    node.key
                )),
                None => nodes.push(node),
            },
            Err(why) => faults.push(format!("line {line}: {why}")),
        }
    }
    if nodes.is_empty() && faults.is_empty() {
        faults.push("no nodes; write one NODEID [KEY] per line".to_owned());
    }
    if faults.is_empty() { Ok(nodes) } else { Err(faults) }
}

/// Writes a list that [`read`] parses to the same nodes. Names with control characters are left out.
#[must_use]
pub fn write(nodes: &[Node]) -> String {
    nodes.iter().fold(String::new(), |mut text, node| {
        // Writing into a String cannot fail.
        let _ = writeln!(text, "{} {}", word(&node.id), word(&node.key));
        text
    })
}

fn node(line: &str) -> Result<Option<Node>, String> {
    let mut words = words(line)?.into_iter();
    let Some(id) = words.next() else { return Ok(None) };
    check_id(&id)?;
    let key = words.next().unwrap_or_else(|| key_of(&id));
    if let Some(more) = words.next() {
        return Err(format!("unexpected {more:?} after NODEID and KEY; quote names with spaces: \"…\""));
    }
    // A shell removes the quotes of a name with spaces unless the whole is quoted.
    if !is_key(&key) || key.contains('"') {
        return Err(format!("{key:?} is not a valid key; use no empty parts, wildcards, quotes or @"));
    }
    Ok(Some(Node { id, key }))
}

/// The words of a line. Quotes allow spaces; inside them `\` escapes the next character.
fn words(line: &str) -> Result<Vec<String>, String> {
    let (mut words, mut rest) = (Vec::new(), line.trim());
    while !rest.is_empty() && !rest.starts_with('#') {
        let Some(quoted) = rest.strip_prefix('"') else {
            let end = rest.find(char::is_whitespace).unwrap_or(rest.len());
            words.push(rest[..end].to_owned());
            rest = rest[end..].trim_start();
            continue;
        };
        let (mut word, mut chars) = (String::new(), quoted.char_indices());
        loop {
            match chars.next() {
                Some((at, '"')) => {
                    rest = &quoted[at + 1..];
                    break;
                }
                Some((_, '\\')) => word.extend(chars.next().map(|(_, c)| c)),
                Some((_, c)) => word.push(c),
                None => return Err("missing closing quote".to_owned()),
            }
        }
        if rest.starts_with(|c: char| !c.is_whitespace()) {
            return Err("missing space after a quote".to_owned());
        }
        words.push(word);
        rest = rest.trim_start();
    }
    Ok(words)
}

/// Quotes a word so that [`words`] reads it back.
fn word(text: &str) -> String {
    if !text.is_empty() && !text.contains(char::is_whitespace) && !text.starts_with(['"', '#']) {
        return text.to_owned();
    }
    format!("\"{}\"", text.replace('\\', "\\\\").replace('"', "\\\""))
}

/// Checks the syntax of a node identifier.
pub fn check_id(id: &str) -> Result<(), String> {
    let rest = match id.split_once(';') {
        Some((space, rest)) if space.starts_with("ns=") => {
            space[3..].parse::<u16>().map_err(|_| format!("{id:?}: ns must be a number up to 65535"))?;
            rest
        }
        Some((space, rest)) if space.starts_with("nsu=") && space.len() > 4 => rest,
        _ => id,
    };
    let sound = match rest.split_at_checked(2) {
        Some(("i=", number)) => number.parse::<u32>().is_ok(),
        Some(("s=", text)) => !text.is_empty() && !text.contains(char::is_control),
        Some(("g=", guid)) => guid.len() == 36 && guid.chars().all(|c| c == '-' || c.is_ascii_hexdigit()),
        Some(("b=", bytes)) => {
            !bytes.is_empty() && bytes.bytes().all(|b| b.is_ascii_alphanumeric() || b"+/=".contains(&b))
        }
        _ => false,
    };
    let why = || {
        format!("{id:?} is not a node identifier; write one such as ns=2;s=FIC101.OP, ns=2;i=17 or nsu=URI;s=FIC101.OP")
    };
    if sound { Ok(()) } else { Err(why()) }
}

/// The key of a node without one: a string identifier as it is, other kinds with namespace and value.
#[must_use]
pub fn key_of(id: &str) -> String {
    let (space, rest) = match id.split_once(';') {
        Some((space, rest)) if space.starts_with("ns") => (space, rest),
        _ => ("ns=0", id),
    };
    match rest.strip_prefix("s=") {
        Some(text) => key_from(text.split('/')),
        None => key_from([format!("{}.{}", space.replace('=', ""), rest.replace('=', ""))].iter().map(String::as_str)),
    }
}

/// A key from names: replaces invalid characters and drops the quotes that controllers put around names.
pub fn key_from<'a>(chunks: impl IntoIterator<Item = &'a str>) -> String {
    let clean = |chunk: &str| {
        let chunk: String = chunk
            .chars()
            .filter(|c| *c != '"')
            .map(|c| if "*$?#/".contains(c) || c.is_control() { '_' } else { c })
            .collect();
        let chunk = chunk.trim();
        if chunk.starts_with('@') { chunk.replacen('@', "_", 1) } else { chunk.to_owned() }
    };
    let chunks: Vec<String> = chunks.into_iter().map(clean).filter(|chunk| !chunk.is_empty()).collect();
    if chunks.is_empty() { "_".to_owned() } else { chunks.join("/") }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn of(id: &str, key: &str) -> Node {
        Node { id: id.into(), key: key.into() }
    }

    #[test]
    fn every_kind_of_line_is_read() {
        let text = "# nodes\n\nns=2;s=FIC101.OP\n  ns=2;s=FIC101.PV\tu1/FIC101/pv # measured\n\
                    \"ns=2;s=Simulation Examples.Ramp 8\" \"ramp 8\"\nns=3;s=\"DB 7\".\"OP\"\n";
        let faults = read(text).unwrap_err();
        assert_eq!(faults.len(), 1, "{faults:?}");
        assert!(faults[0].starts_with("line 6: ") && faults[0].contains("7\\\".\\\"OP"), "{faults:?}");
        let nodes = read(&text.replace("DB 7", "DB7")).unwrap();
        let wanted = [
            of("ns=2;s=FIC101.OP", "FIC101.OP"),
            of("ns=2;s=FIC101.PV", "u1/FIC101/pv"),
            of("ns=2;s=Simulation Examples.Ramp 8", "ramp 8"),
            of("ns=3;s=\"DB7\".\"OP\"", "DB7.OP"),
        ];
        assert_eq!(nodes, wanted);
    }

    #[test]
    fn all_faults_are_told_with_their_lines() {
        let text =
            "ns=2;s=A\nnonsense\nns=70000;i=1\nns=2;i=x\nns=3;s=A\ni=1 a//b\ni=2 a b\n\"i=3\ni=4 @x\ng=12\nb=??\n";
        let faults = read(text).unwrap_err();
        let lines: Vec<&str> = faults.iter().filter_map(|f| f.split(':').next()).collect();
        let wanted = [2, 3, 4, 5, 6, 7, 8, 9, 10, 11].map(|line| format!("line {line}"));
        assert_eq!(lines, wanted, "{faults:?}");
        assert!(faults[3].contains("line 1 already uses the key"), "{faults:?}");
        assert!(read("# nothing\n").unwrap_err()[0].contains("no node"));
    }

    #[test]
    fn keys_come_from_identities() {
        for (id, key) in [
            ("ns=2;s=Plant/U1/FIC101.OP", "Plant/U1/FIC101.OP"),
            ("ns=2;s=/a//@b*c", "a/_b_c"),
            ("ns=3;s=\"DB\".\"OP\"", "DB.OP"),
            ("ns=4;i=17", "ns4.i17"),
            ("i=2258", "ns0.i2258"),
            ("nsu=urn:a;s=X", "X"),
            ("ns=2;s=\"\"", "_"),
        ] {
            assert_eq!(key_of(id), key);
            assert!(is_key(&key_of(id)));
        }
    }

    proptest! {
        #[test]
        fn what_is_written_is_read_back(ids in prop::collection::vec("[^\\p{Cc}]{1,20}", 1..20)) {
            let all: Vec<Node> = ids
                .iter()
                .enumerate()
                .map(|(at, id)| of(&format!("ns=2;s={id}"), &format!("k{at} {}", key_from(id.split('/')))))
                .collect();
            prop_assert_eq!(read(&write(&all)).unwrap(), all);
        }

        #[test]
        fn any_text_is_read_or_refused_with_lines(text in "(ns=[0-9];s=|[ \"\\\\#\t\n]|\\PC){0,80}") {
            match read(&text) {
                Ok(nodes) => prop_assert!(nodes.iter().all(|n| is_key(&n.key) && check_id(&n.id).is_ok())),
                Err(faults) => prop_assert!(faults.iter().all(|f| f.starts_with("line ") || f.starts_with("no node"))),
            }
        }

        #[test]
        fn keys_from_any_names_are_keys(names in prop::collection::vec(any::<String>(), 0..5)) {
            prop_assert!(is_key(&key_from(names.iter().map(String::as_str))));
        }
    }
}
