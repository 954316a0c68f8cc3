//! `stictiond simulate`: records a simulated plant as the daemon would.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use anyhow::{Context, anyhow, bail};
use serde_json::json;

use crate::cli::reading::{model_file, scenario_file};
use crate::cli::{Format, Outcome, list, say};
use crate::daemon::sink::recorder::{RecordedConfig, RunInfo};
use crate::daemon::to_json;
use stiction::core::gap::Serial;
use stiction::core::gap::check_model;
use stiction::core::gap::in_loop::Parts;
use stiction::core::gap::loop_run::parts;
use stiction::core::record::Record;
use stiction::core::sim::closed_loop::ValveLaw;
use stiction::simulated::scenario::{ProcessSpec, Scenario};
use stiction_engine::codec::topic::{self, Kind};
use stiction_engine::config::Config;
use stiction_engine::engine::{Engine, Event, RecordedInput, SkipReason};
use stiction_engine::short_hash;
use stiction_files::RecordingFile;

/// Simulate a plant and write the recording that a daemon would make of it: samples, estimates, alarms.
#[derive(Debug, clap::Args)]
#[command(after_help = "Examples:
  stictiond simulate recordings/scenarios/sticking.toml --out sticking.mcap
  stictiond simulate recordings/scenarios/sticking.toml --model gap.json --out as-diagnosed.mcap")]
pub struct Args {
    /// Scenario file (TOML); see recordings/scenarios.
    pub scenario: PathBuf,
    /// Recording to write (.mcap).
    #[arg(long)]
    pub out: PathBuf,
    /// Daemon configuration (TOML); its prefix must match the scenario's [default: a window every 300 s].
    #[arg(long)]
    pub config: Option<PathBuf>,
    /// Model file (JSON) whose valve and process replace the scenario's: an estimate, a gap document's model, or a plain
    /// model. Controller, set point, noise and disturbances stay; the model's loads are added.
    #[arg(long, value_name = "FILE.json")]
    pub model: Option<PathBuf>,
    /// Loop of the scenario that gets the model; needed if there are several.
    #[arg(long = "loop", value_name = "NAME", requires = "model")]
    pub loop_name: Option<String>,
    /// Write samples only, without results.
    #[arg(long)]
    pub raw: bool,
    /// Replace an existing file.
    #[arg(long)]
    pub force: bool,
}

/// Runs the command.
///
/// # Errors
/// A faulty scenario or configuration; an output that exists or cannot be written.
pub fn run(args: &Args, format: Format) -> anyhow::Result<Outcome> {
    let (text, mut scenario) = scenario_file(&args.scenario)?;
    if let Some(path) = &args.model {
        put_model(&mut scenario, path, args.loop_name.as_deref())?;
    }
    let config_text = match &args.config {
        Some(path) => std::fs::read_to_string(path).with_context(|| path.display().to_string())?,
        None => format!("[site]\nprefix = \"{}\"\n\n[window]\nhop_s = 300.0\n", scenario.site.prefix),
    };
    let config =
        Config::parse(&config_text).map_err(|faults| anyhow!("the configuration has faults:\n  {}", list(&faults)))?;
    if config.site.prefix != scenario.site.prefix {
        bail!(
            "the configuration has prefix {:?}, the scenario {:?}; make them equal",
            config.site.prefix,
            scenario.site.prefix
        );
    }
    if args.out.extension().is_none_or(|e| e != "mcap") {
        bail!("{}: name an .mcap file; `stictiond convert` makes other formats of it", args.out.display());
    }
    if args.out.exists() && !args.force {
        bail!("{}: already exists; use --force to replace it", args.out.display());
    }
    let run = RunInfo {
        prefix: config.site.prefix.clone(),
        // The same scenario and model give the same file, byte for byte.
        run_id: short_hash(format!("{text}\n{config_text}{}", model_text(args)?).as_bytes())[..8].to_owned(),
        started_ns: scenario.start_ns(),
        run_number: None,
        origin: if args.raw { "simulate_raw" } else { "simulate" },
        daemon: String::new(),
        raw: config.recording.raw,
        continued: BTreeMap::new(),
        config: RecordedConfig::new(&config, config_text),
    };
    let made = write(args, &scenario, config, &run)?;
    let counts: BTreeMap<&str, u64> = made.into_iter().map(|(kind, n)| (kind.name(), n)).collect();
    match format {
        Format::Json => say(json!({"schema": "stictiond.simulate.v1", "file": args.out, "messages": counts,
            "truth": scenario.truth()}))?,
        Format::Text => {
            let counts: Vec<String> = counts.iter().map(|(kind, n)| format!("{n} {kind}")).collect();
            say(format!("{}: {}", args.out.display(), counts.join(", ")))?;
            say(scenario.truth().trim_end())?;
        }
    }
    Ok(Outcome::Done)
}

/// The model file's text; empty without one.
fn model_text(args: &Args) -> anyhow::Result<String> {
    let Some(path) = &args.model else { return Ok(String::new()) };
    std::fs::read_to_string(path).with_context(|| path.display().to_string())
}

/// Puts the valve and process of a model file into one loop of the scenario.
fn put_model(scenario: &mut Scenario, path: &Path, name: Option<&str>) -> anyhow::Result<()> {
    let names: Vec<String> = scenario.loop_names().map(str::to_owned).collect();
    let at = match name {
        Some(name) => names.iter().position(|n| n == name),
        None => (names.len() == 1).then_some(0),
    };
    let Some(at) = at else { bail!("choose the loop that gets the model with --loop: {}", names.join(", ")) };
    let spec = &mut scenario.loops[at];
    let rest = Record::uniform(scenario.run.ts_s, vec![spec.operating_point.op], vec![spec.operating_point.pv]);
    let model = model_file(path)?.on(&rest);
    let wrong = || path.display().to_string();
    check_model(&model).with_context(wrong)?;
    let Parts { stroke, actuator, load, on_pv } = parts(&model, scenario.run.ts_s).with_context(wrong)?;
    // The scenario's process has a different operating point from the model's.
    let (actuator, slope) = actuator.counted_from(spec.operating_point.op);
    (spec.valve.stroke, spec.valve.actuator) = (stroke, actuator);
    spec.disturbance.load.extend(load);
    spec.disturbance.pv.extend(on_pv);
    spec.valve.law = match model.valve.law.as_str() {
        "he" => ValveLaw::He,
        "tracking" => ValveLaw::Tracking,
        _ => ValveLaw::None,
    };
    (spec.valve.fs, spec.valve.fd) = (model.valve.fs, model.valve.fd);
    spec.process = ProcessSpec {
        gain: model.process.gain * slope,
        time_constants_s: model.process.time_constants_s,
        dead_time_s: model.process.dead_time_s,
        integrating: model.process.integrating,
    };
    Ok(())
}

/// Writes to a temporary name first: the output is complete or absent.
fn write(args: &Args, scenario: &Scenario, config: Config, run: &RunInfo) -> anyhow::Result<BTreeMap<Kind, u64>> {
    let mut part = args.out.clone().into_os_string();
    part.push(".part");
    let part = PathBuf::from(part);
    if part.exists() {
        std::fs::remove_file(&part).with_context(|| part.display().to_string())?;
    }
    let mut file = RecordingFile::create_at(part, args.out.clone(), &run.metadata(0, 0, "", 0))?;
    let mut counts: BTreeMap<Kind, u64> = BTreeMap::new();
    let mut engine = Engine::new(config.engine());
    let names: Vec<String> = scenario.loop_names().map(str::to_owned).collect();
    let mut events = Vec::new();
    for simulated in scenario.stream() {
        let name = &names[simulated.loop_index];
        let Some(id) = engine.appear(name) else {
            bail!("the scenario has more loops than max_loops; raise [input] max_loops")
        };
        let (sample, arrival_ns) = (simulated.sample, simulated.arrival_ns);
        file.sample(&topic::raw(&run.prefix, name, sample.signal), arrival_ns, &sample)?;
        *counts.entry(Kind::of_signal(sample.signal)).or_default() += 1;
        if args.raw {
            continue;
        }
        engine.push(id, sample, &mut events);
        while !events.is_empty() {
            for event in std::mem::take(&mut events) {
                let (id, kind, at_ns, json) = match event {
                    Event::Request(request) => {
                        engine.complete(request.id, request.seq, request.compute(), &mut events);
                        continue;
                    }
                    Event::GapRequest(request) => {
                        let (id, number, reason) = (request.id, request.number, SkipReason::Failed);
                        if let Ok(document) = request.compute(&Serial) {
                            engine.complete_gap(id, number, document, &mut events);
                            continue;
                        }
                        engine.skip_gap(id, number, reason, &mut events);
                        let at_ns = request.record.end_ns;
                        (id, Kind::Input, at_ns, to_json(&RecordedInput::GapSkip { number, reason }))
                    }
                    // Recordings of simulated loops have no groups: each scenario counts as a separate plant.
                    Event::Window(..) => continue,
                    Event::Gap(id, d) => (id, Kind::Gap, d.end_ns(), to_json(&d)),
                    Event::Estimate(id, d) => (id, Kind::Estimate, d.assessment.window.end_ns, to_json(&d)),
                    Event::Alarm(id, d) => (id, Kind::Alarm, d.changed_ns, to_json(&d)),
                    Event::State(id, d) => (id, Kind::State, d.window_end_ns.unwrap_or(0), to_json(&d)),
                };
                let Some(json) = json else { continue };
                file.write(&topic::result(&run.prefix, engine.name(id), kind), kind, arrival_ns, at_ns, &json)?;
                *counts.entry(kind).or_default() += 1;
            }
        }
    }
    file.finish()?;
    Ok(counts)
}
