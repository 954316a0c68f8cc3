//! `stictiond demo`: a simulated plant on the bus and the daemon, in one command.

mod told;

use std::collections::BTreeMap;
use std::io::IsTerminal;
use std::net::TcpListener;
use std::time::{Duration, Instant};

use anyhow::{anyhow, bail};
use zenoh::bytes::Encoding;
use zenoh::qos::CongestionControl;

use crate::cli::{Format, Outcome, asked_to_stop, block_on, list};
use crate::commands::{browser, play};
use crate::daemon::RunOptions;
use stiction::core::units::NS_PER_S;
use stiction::core::verdict::Verdict;
use stiction::simulated::plant::SimulatedPlant;
use stiction::simulated::scenario::Scenario;
use stiction_engine::codec::encode_recorded;
use stiction_engine::codec::topic;
use stiction_engine::config::Config;

/// The simulated plant.
const SCENARIO: &str = include_str!("../../../recordings/scenarios/demo.toml");
/// The daemon's configuration.
const CONFIG: &str = include_str!("../../../config/demo.toml");
/// Speed of the plant as a multiple of real time.
const SPEED: f64 = 100.0;

/// Run a demonstration: a simulated plant with a sticking, a healthy, a badly tuned and a disturbed loop, watched live.
///
/// Needs no set-up. Records below recordings/demo and runs until Ctrl-C. Prints one line per result; a desktop opens
/// the page in the browser.
#[derive(Debug, clap::Args)]
pub struct Args {
    /// Do not open a browser.
    #[arg(long)]
    pub no_open: bool,
    /// End after this many seconds [default: run until Ctrl-C].
    #[arg(long = "for", value_name = "SECONDS", value_parser = seconds)]
    pub for_s: Option<f64>,
}

fn seconds(text: &str) -> Result<f64, String> {
    match text.parse::<f64>() {
        Ok(s) if s > 0.0 && s < 1e9 => Ok(s),
        _ => Err(format!("{text:?} is not a number of seconds above 0")),
    }
}

/// The wanted port if it is free, else any free port.
///
/// # Errors
/// The system gives no port.
pub fn free_port(wanted: u16) -> anyhow::Result<u16> {
    let listener = TcpListener::bind(("127.0.0.1", wanted)).or_else(|_| TcpListener::bind(("127.0.0.1", 0)))?;
    Ok(listener.local_addr()?.port())
}

/// The demo's configuration with free ports, as text because recordings contain it.
fn config_text() -> anyhow::Result<(String, u16)> {
    let (bus, web) = (free_port(7447)?, free_port(8080)?);
    for (wanted, got, what) in [(7447, bus, "Zenoh"), (8080, web, "the page")] {
        if wanted != got {
            tracing::info!("port {wanted} is in use; {what} listens on {got}");
        }
    }
    let text = CONFIG.replace("127.0.0.1:7447", &format!("127.0.0.1:{bus}"));
    Ok((text.replace("127.0.0.1:8080", &format!("127.0.0.1:{web}")), bus))
}

/// Runs the command.
///
/// # Errors
/// No port can be opened, or recordings/demo cannot be written.
pub fn run(args: &Args, format: Format) -> anyhow::Result<Outcome> {
    let scenario = Scenario::parse(SCENARIO).map_err(|e| anyhow!("the built-in scenario: {e}"))?;
    let (text, port) = config_text()?;
    let config = match Config::parse(&text) {
        Ok(config) => config,
        Err(faults) => bail!("the built-in configuration has faults:\n  {}", list(&faults)),
    };
    if format == Format::Text {
        told::beginning(&scenario, &config, port, SPEED)?;
    }
    // A program that reads the output needs no window.
    if !args.no_open && std::io::stdout().is_terminal() {
        config.web.listen.parse().into_iter().for_each(browser::open_once_there);
    }
    let last = block_on(async {
        let (stop, stopped) = tokio::sync::oneshot::channel::<()>();
        let daemon =
            tokio::spawn(crate::daemon::run(config.clone(), text, RunOptions::of("demo", crate::web::serve), async {
                drop(stopped.await)
            }));
        let watched = watch(&scenario, &config, port, args.for_s, format).await;
        drop(stop);
        daemon.await??;
        watched
    })?;
    if format == Format::Text {
        told::ending(&scenario, &last, &config.recording.dir)?;
    }
    Ok(Outcome::Done)
}

/// Publishes the plant and shows the daemon's results until time is up or the user stops it.
async fn watch(
    scenario: &Scenario,
    config: &Config,
    port: u16,
    for_s: Option<f64>,
    format: Format,
) -> anyhow::Result<BTreeMap<String, Vec<Verdict>>> {
    let limit = async {
        match for_s {
            Some(s) => tokio::time::sleep(Duration::from_secs_f64(s)).await,
            None => std::future::pending().await,
        }
    };
    let stopping = asked_to_stop()?;
    // The daemon listens before anything else; the session keeps trying until it does.
    let session = crate::cli::bus::connect(&format!("tcp/127.0.0.1:{port}")).await?;
    play::wait_for_subscriber(&session, &config.site.prefix).await?;
    let plant = publish(&session, scenario, &config.site.prefix);
    let ends = async {
        tokio::select! {
            ended = plant => ended,
            () = limit => Ok(()),
            () = stopping => Ok(()),
        }
    };
    let last = lines(&session, config, format, ends).await;
    let _ = tokio::time::timeout(Duration::from_secs(1), session.close()).await;
    last
}

/// Prints one line per result.
async fn lines(
    session: &zenoh::Session,
    config: &Config,
    format: Format,
    ends: impl Future<Output = anyhow::Result<()>>,
) -> anyhow::Result<BTreeMap<String, Vec<Verdict>>> {
    let (found, mut findings) = tokio::sync::mpsc::unbounded_channel();
    let results = topic::plane(&config.site.prefix, "*/*");
    let _subscriber = session
        .declare_subscriber(results)
        .callback(move |sample| {
            let leaf = topic::leaf(sample.key_expr().as_str()).to_owned();
            let _ = found.send((leaf, sample.payload().to_bytes().into_owned()));
        })
        .await
        .map_err(|e| anyhow!("{e}"))?;
    tokio::pin!(ends);
    let mut last = BTreeMap::new();
    loop {
        tokio::select! {
            ended = &mut ends => return ended.map(|()| last),
            finding = findings.recv() => {
                let Some((leaf, json)) = finding else { return Ok(last) };
                told::finding(&leaf, &json, format, &mut last)?;
            }
        }
    }
}

/// Runs the plant faster than real time, starting now.
async fn publish(session: &zenoh::Session, scenario: &Scenario, prefix: &str) -> anyhow::Result<()> {
    let names: Vec<String> = scenario.loop_names().map(str::to_owned).collect();
    let start_ns = crate::runtime::clock::now_ns() / NS_PER_S * NS_PER_S;
    let mut plant = SimulatedPlant::starting_at(scenario, start_ns);
    let started = Instant::now();
    let mut json = Vec::new();
    let mut scans = 0.0;
    loop {
        for simulated in plant.step() {
            json.clear();
            encode_recorded(&simulated.sample, &mut json);
            let key = topic::raw(prefix, &names[simulated.loop_index], simulated.sample.signal);
            let put = session.put(&key, json.clone()).encoding(Encoding::APPLICATION_JSON);
            put.congestion_control(CongestionControl::Block).await.map_err(|e| anyhow!("{key}: {e}"))?;
        }
        scans += 1.0;
        let due = Duration::from_secs_f64(scans * scenario.run.ts_s / SPEED);
        tokio::time::sleep(due.saturating_sub(started.elapsed())).await;
    }
}
