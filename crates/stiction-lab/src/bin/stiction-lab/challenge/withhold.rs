//! `stiction-lab challenge withhold`: diagnoses recordings with a catalogue that lacks their effect, which the truth names.

use std::path::PathBuf;
use std::sync::Mutex;

use anyhow::Context;
use serde_json::{Value, json};

use super::{ANSWERS, RECORDINGS, answer, opened, read, record_of, write};
use stiction::core::gap::GapOptions;
use stiction_lab::challenge::Answer as Right;
use stictiond::cli::{Format, Outcome, on_all_cores, say};

#[derive(Debug, clap::Args)]
pub(super) struct Args {
    /// Folder of an answered challenge.
    dir: PathBuf,
    /// Only the first N recordings with an effect of the catalogue.
    #[arg(long, value_name = "N")]
    first: Option<usize>,
}

/// Runs the command: adds to the answers the causes that are named without the true effect.
///
/// # Errors
/// The truth was changed, or a recording is not answered or cannot be diagnosed.
pub(super) fn run(args: &Args, format: Format) -> anyhow::Result<Outcome> {
    let truth = opened(&args.dir)?;
    let path = args.dir.join(ANSWERS);
    let text = String::from_utf8_lossy(&read(&path)?).into_owned();
    let parsed: Result<Vec<Value>, _> = text.lines().map(serde_json::from_str).collect();
    let mut answers = parsed.with_context(|| format!("cannot read {}; run the challenge again", path.display()))?;
    let effect_of = |answer: &Value| {
        let case = truth.cases.iter().find(|case| answer["recording"] == case.name)?;
        (case.answer == Right::Known).then(|| case.effect.clone())
    };
    let asked = answers.iter_mut().filter_map(|answer| Some((effect_of(answer)?, answer)));
    let asked: Vec<(String, Mutex<&mut Value>)> =
        asked.take(args.first.unwrap_or(usize::MAX)).map(|(effect, answer)| (effect, Mutex::new(answer))).collect();
    let work = |(effect, answer): &(String, Mutex<&mut Value>)| -> anyhow::Result<()> {
        let mut answer = answer.lock().map_err(|_| anyhow::anyhow!("{}: another thread failed", path.display()))?;
        let name = answer["recording"].as_str().unwrap_or_default().to_owned();
        let made_with = &answer["made_with"];
        let default = GapOptions::default();
        let options = GapOptions {
            budget_evaluations: made_with["evaluations"].as_u64().unwrap_or(default.budget_evaluations),
            seed: made_with["seed"].as_u64().unwrap_or(default.seed),
            without: vec![effect.clone()],
            ..default
        };
        let record = record_of(&args.dir.join(RECORDINGS).join(format!("{name}.csv")))?;
        let (diagnosis, _) = answer::ask_for(&name, &record, &options).with_context(|| name.clone())?;
        answer["withheld"] = json!([{ "without": effect, "cause": answer::cause(&diagnosis.cause) }]);
        Ok(())
    };
    on_all_cores(&asked, |(effect, _)| effect.clone(), work).into_iter().collect::<anyhow::Result<Vec<()>>>()?;
    let count = asked.len();
    let text: String = answers.iter().map(|answer| format!("{answer}\n")).collect();
    write(&path, text.as_bytes())?;
    match format {
        Format::Json => say(json!({ "withheld": count }))?,
        Format::Text => say(format!("{} recordings diagnosed without their effect; `score` counts them", count))?,
    }
    Ok(Outcome::Done)
}
