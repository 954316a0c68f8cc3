//! The text of the demo: what is simulated, where to look, one line per window, and the truth next to the answers.

use std::collections::BTreeMap;

use serde::Deserialize;
use serde_json::Value as Json;

use crate::cli::{Format, say};
use stiction::core::units::{duration, format_rfc3339, number};
use stiction::core::verdict::Verdict;
use stiction::simulated::scenario::{Label, LoopSpec, Scenario};
use stiction::words::answer::settled;
use stiction_engine::codec::topic::{self, Kind};
use stiction_engine::config::Config;

/// Prints what runs and where to look.
pub(super) fn beginning(scenario: &Scenario, config: &Config, port: u16, speed: f64) -> anyhow::Result<()> {
    let count = scenario.loops.len();
    say(format!("A simulated plant of {count} loops, {} times faster than real, watched live:\n", number(speed)))?;
    for spec in &scenario.loops {
        say(format!("  {:<8} {}", spec.name, truth(spec)))?;
    }
    let plane = topic::plane(&config.site.prefix, "**");
    say(format!(
        "\n  page        http://{web}/\n  results     Zenoh tcp/127.0.0.1:{port}, key {plane}\n  metrics     http://{web}/metrics, health at \
         http://{web}/healthz\n  recordings  {dir}\n",
        web = config.web.listen,
        dir = config.recording.dir
    ))?;
    say(format!(
        "Plant time starts now and runs ahead of the clock. Each loop is judged every {} of plant time. p is the \
         probability that the valve sticks; fs and fd are the friction bands of He's valve model in OP units. Ctrl-C ends.\n",
        duration(config.window.hop_s)
    ))?;
    say("plant time (UTC)      loop     verdict            p     fs     fd  period")?;
    Ok(())
}

/// The simulated truth in words.
fn truth(spec: &LoopSpec) -> String {
    let bands = format!("fs {}, fd {}", number(spec.valve.fs), number(spec.valve.fd));
    match spec.label {
        Some(Label::Stiction | Label::Deadband) => format!("the valve sticks ({bands})"),
        Some(Label::NoStiction) => "healthy and quiet".to_owned(),
        Some(Label::Tuning) => "healthy valve, controller tuned too tight: the loop rings".to_owned(),
        Some(Label::Disturbance) => "healthy valve, well tuned; sine disturbance from upstream".to_owned(),
        None => "not labelled".to_owned(),
    }
}

/// Prints an estimate or an alarm, and keeps the verdicts of each loop, newest first.
pub(super) fn finding(
    leaf: &str,
    json: &[u8],
    format: Format,
    last: &mut BTreeMap<String, Vec<Verdict>>,
) -> anyhow::Result<()> {
    let kind = Kind::of_document(leaf);
    if !matches!(kind, Some(Kind::Estimate | Kind::Alarm)) {
        return Ok(());
    }
    if format == Format::Json {
        say(String::from_utf8_lossy(json))?;
        return Ok(());
    }
    let d: Json = serde_json::from_slice(json)?;
    let name = d["loop"].as_str().unwrap_or("?").to_owned();
    if kind == Some(Kind::Alarm) {
        let [changed, state, why, todo] =
            ["changed", "state", "detail", "what_to_do"].map(|key| d[key].as_str().unwrap_or(""));
        say(format!("{changed}  {name:<8} ALARM ({state})"))?;
        let todo = if d["event"] == "raised" { todo } else { "" };
        for line in [why, todo].iter().flat_map(|text| wrapped(text, 88)) {
            say(format!("{:31}{line}", ""))?;
        }
        return Ok(());
    }
    let sticks = d["stiction"] == true;
    let place = |v: &Json, digits: usize| v.as_f64().map_or("-".to_owned(), |x| format!("{x:.digits$}"));
    // In noise, the strongest period is not a period of the loop.
    let period = d["oscillation"]["period_s"].as_f64().filter(|_| d["oscillation"]["oscillating"] == true);
    let band = |v: &Json| if sticks { place(v, 2) } else { "-".to_owned() };
    say(format!(
        "{}  {name:<8} {:<15} {:>4} {:>6} {:>6}  {}",
        format_rfc3339(d["window"]["end_ns"].as_i64().unwrap_or(0)),
        d["verdict"].as_str().unwrap_or("?"),
        place(&d["p_stiction"], 2),
        band(&d["fs"]),
        band(&d["fd"]),
        period.map_or("-".to_owned(), duration),
    ))?;
    if let Ok(verdict) = Verdict::deserialize(&d["verdict"]) {
        last.entry(name).or_default().insert(0, verdict);
    }
    Ok(())
}

/// A text in lines of at most `width` characters, broken between words; a longer word keeps its own line.
fn wrapped(text: &str, width: usize) -> Vec<String> {
    let mut lines: Vec<String> = Vec::new();
    for word in text.split_whitespace() {
        match lines.last_mut() {
            Some(line) if line.chars().count() + 1 + word.chars().count() <= width => {
                line.push(' ');
                line.push_str(word);
            }
            _ => lines.push(word.to_owned()),
        }
    }
    lines
}

/// The truth next to the last answers.
pub(super) fn ending(scenario: &Scenario, last: &BTreeMap<String, Vec<Verdict>>, dir: &str) -> anyhow::Result<()> {
    say("\nloop     simulated         last answer       agrees")?;
    for spec in &scenario.loops {
        let truth = spec.label.map_or("-", Label::name);
        let found = last.get(&spec.name).and_then(|verdicts| shown(verdicts)).map(Verdict::name);
        say(format!("{:<8} {truth:<17} {:<17} {}", spec.name, found.unwrap_or("no window yet"), agrees(spec, found)))?;
    }
    say(format!(
        "\nRecorded in {dir}. Recompute the same numbers from the recording: stictiond replay {dir} --verify"
    ))?;
    Ok(())
}

/// A loop's state: its newest verdict, or the cause that most of its last windows name.
fn shown(newest_first: &[Verdict]) -> Option<Verdict> {
    let newest = *newest_first.first()?;
    let settled = settled(newest_first.iter().copied()).filter(|_| newest.stiction() == Some(false));
    Some(settled.map_or(newest, |(cause, ..)| cause))
}

/// Whether an answer is right, and if not, the likely reason.
fn agrees(spec: &LoopSpec, found: Option<&str>) -> &'static str {
    let Some(found) = found else { return "not yet: a window needs five periods" };
    let healthy = matches!(spec.label, Some(Label::NoStiction | Label::Tuning | Label::Disturbance));
    match (spec.label, found) {
        (Some(label), found) if label.name() == found => "yes",
        (Some(Label::NoStiction), "not_oscillating") => "yes: no oscillation, so no sign of sticking",
        (_, "inconclusive") => "no answer: not enough evidence in this window",
        _ if healthy && found != "stiction" && found != "deadband" => "about the valve, yes; about the cause, no",
        _ => "NO",
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_long_text_is_broken_between_words_and_loses_none() {
        let text = "the valve sticks and slips, with a band of 5.6 OP units: inspect packing, actuator and positioner";
        let lines = wrapped(text, 30);
        assert!(lines.len() > 2 && lines.iter().all(|line| line.len() <= 30), "{lines:?}");
        assert_eq!(lines.join(" "), text);
        assert!(wrapped("", 30).is_empty());
    }
}
