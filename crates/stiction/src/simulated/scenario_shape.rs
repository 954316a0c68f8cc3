//! Faults of a scenario's shape, all at once: unknown keys, missing keys, values of the wrong type.

use serde::Deserialize;
use toml::Spanned;
use toml::de::{DeTable, DeValue, Deserializer};

use super::scenario::Scenario;

/// Most faults reported.
const MOST: usize = 100;

/// The faults, each with its line, in order; empty if the text has the shape of a scenario, or is not TOML.
pub(super) fn shape_faults(text: &str) -> Vec<String> {
    let Ok(mut root) = DeTable::parse(text) else { return Vec::new() };
    let line = |at: usize| text.get(..at).map_or(1, |head| head.matches('\n').count() + 1);
    let (mut found, mut taken_out) = (Vec::new(), Vec::new());
    for _ in 0..MOST {
        let Err(error) = Scenario::deserialize(Deserializer::from(root.clone())) else { break };
        let at = error.span().map_or(0, |span| span.start);
        let message = error.message().trim().replace('\n', ", ");
        // A key removed for its own fault is not missing.
        let follows = taken_out.iter().any(|name| message == format!("missing field `{name}`"));
        if !follows {
            found.push((line(at), message));
        }
        let Some(name) = take_out(root.get_mut(), at) else { break };
        taken_out.push(name);
    }
    found.sort();
    found.dedup();
    found.into_iter().map(|(line, message)| format!("line {line}: {message}")).collect()
}

/// Removes the innermost entry at this byte, so that the next fault becomes visible, and returns its name.
fn take_out(table: &mut DeTable<'_>, at: usize) -> Option<String> {
    if let Some(name) = table.iter_mut().find_map(|(_, value)| take_out_of(value, at)) {
        return Some(name);
    }
    let here = |key: &Spanned<_>, value: &Spanned<DeValue<'_>>| key.span().contains(&at) || value.span().contains(&at);
    let name = table.iter().find(|(key, value)| here(key, value)).map(|(key, _)| key.get_ref().to_string())?;
    table.remove(name.as_str());
    Some(name)
}

fn take_out_of(value: &mut Spanned<DeValue<'_>>, at: usize) -> Option<String> {
    match value.get_mut() {
        DeValue::Table(table) => take_out(table, at),
        DeValue::Array(array) => {
            if let Some(name) = array.iter_mut().find_map(|one| take_out_of(one, at)) {
                return Some(name);
            }
            let index = array.iter().position(|one| one.span().contains(&at))?;
            let rest = array.iter().enumerate().filter(|(place, _)| *place != index);
            *array = rest.map(|(_, one)| one.clone()).collect();
            Some(String::new())
        }
        _ => None,
    }
}
