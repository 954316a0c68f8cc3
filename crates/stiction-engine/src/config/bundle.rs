//! `[[bundle]]`: keys with several named signals per payload.

use serde::Serialize;
use toml::de::DeTable;

use super::reader::{Fault, Lines, TableReader, subtables};
use crate::codec::{self, ConfiguredCodec};

/// Separator between a key and a name in its payloads, in `[[loop]]`.
pub const NAME_MARK: char = '#';

/// One key, or several by wildcards.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct BundleKey {
    /// Zenoh key expression.
    pub key: String,
    /// Payload codec.
    #[serde(serialize_with = "codec::serialize_choice")]
    pub codec: ConfiguredCodec,
}

/// Why a text is not a key expression: parts must not be empty, and wildcards must be whole parts.
fn fault_of(key: &str) -> Option<&'static str> {
    let sound =
        |chunk: &str| !chunk.is_empty() && (matches!(chunk, "*" | "**") || !chunk.contains(['*', '$', '?', '#']));
    if !key.split('/').all(sound) {
        return Some("is not a key expression: it has an empty part, or a wildcard that is not a whole part");
    }
    key.contains("**/**").then_some("is not a key expression: it has ** twice in a row")
}

pub(super) fn read_bundles(lines: &Lines, root: &DeTable<'_>, faults: &mut Vec<Fault>) -> Vec<BundleKey> {
    let mut all: Vec<BundleKey> = Vec::new();
    if !root.iter().any(|(key, _)| key.get_ref() == "bundle") {
        return all;
    }
    for (index, (table, line)) in subtables(lines, root, "bundle", faults).into_iter().enumerate() {
        let mut r = TableReader::new(lines, &format!("bundle[{index}]"), line, Some(table), faults);
        let key = r.text("key");
        match &key {
            None => r.refuse(line, "key", "is missing", "write key = \"gateway/spBv1.0/**\""),
            Some((key, line)) => {
                if let Some(why) = fault_of(key) {
                    r.refuse(
                        *line,
                        "key",
                        format!("{key:?} {why}"),
                        "write one such as gateway/spBv1.0/** or gateway/*/data",
                    );
                }
                if all.iter().any(|other| other.key == *key) {
                    r.refuse(*line, "key", format!("{key:?} occurs twice"), "write each key once");
                }
            }
        }
        let codec = r.choice("codec", &codec::choices());
        r.close();
        if let Some((key, _)) = key {
            all.push(BundleKey { key, codec });
        }
    }
    all
}

#[cfg(test)]
mod tests {
    use crate::codec;
    use crate::config::Config;

    #[test]
    fn bundles_are_read_and_their_faults_told() {
        let text = "[site]\nprefix = \"p\"\n[[bundle]]\nkey = \"gw/spBv1.0/**\"\ncodec = \"sparkplug-b\"\n[[loop]]\nname = \"A\"\nop = \"gw/plc#A.OP\"\n";
        let config = Config::parse(text).unwrap();
        assert_eq!(config.bundles[0].key, "gw/spBv1.0/**");
        assert_eq!(config.bundles[0].codec.map(codec::Codec::name), Some("sparkplug-b"));
        let bad = "[site]\nprefix = \"p\"\n[[bundle]]\nkey = \"gw//x\"\n[[bundle]]\nkey = \"a*\"\ncodec = \"xml\"\n[[loop]]\nname = \"A\"\nop = \"gw/plc#\"\n";
        let faults = Config::parse(bad).unwrap_err();
        let seen: Vec<&str> = faults.iter().map(|f| f.key.as_str()).collect();
        assert_eq!(seen, ["bundle[0].key", "bundle[1].key", "bundle[1].codec", "loop[0].op"]);
        assert!(faults.iter().any(|f| f.remedy.contains("sparkplug-b")), "{faults:?}");
    }
}
