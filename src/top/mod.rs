//! `stictiond top`: the loops of running daemons as a table, live in a terminal, printed once otherwise.

pub mod board;
mod bus;
mod cells;
mod detail;
pub mod draw;
mod head;
mod live;
mod screen;
#[cfg(test)]
mod tests;
mod view;

use std::io::IsTerminal;
use std::path::PathBuf;
use std::time::Duration;

use anyhow::anyhow;
use serde_json::json;
use tokio::sync::mpsc;
use zenoh::Session;

use self::board::{LoopTable, Now};
use self::cells::{Figure, TerminalStyle};
use self::view::View;
use super::reading::config_file;
use super::{Format, Outcome, asked_to_stop, block_on, say};
use stiction_core::units::ms_from_ns;

/// Default endpoint of a daemon.
const USUAL: &str = "tcp/127.0.0.1:7447";
/// Most inputs waiting for the next frame.
const QUEUE: usize = 65_536;
/// Width of the table as plain text.
const TEXT_WIDTH: usize = 132;

/// Show the loops of running daemons as a live table.
///
/// In a terminal the table is live; press ? for its keys. Otherwise it is printed once.
#[derive(Debug, clap::Args)]
#[command(after_help = "Example: stictiond top --connect tcp/gateway.plant:7447 --prefix plant1/area1")]
pub struct Args {
    /// Zenoh endpoint of a daemon or router; repeatable [default: tcp/127.0.0.1:7447].
    #[arg(long, value_name = "ENDPOINT", value_parser = stiction_command::bus::endpoint)]
    pub connect: Vec<String>,
    /// Key prefix of the daemons; needed only if several plants share the bus.
    #[arg(long, value_parser = stiction_command::bus::prefix)]
    pub prefix: Option<String>,
    /// Daemon configuration (TOML) from which to take prefix, endpoints and security.
    #[arg(long, value_name = "FILE")]
    pub config: Option<PathBuf>,
}

/// Whether input and output are a terminal.
pub(super) fn is_possible(format: Format) -> bool {
    format == Format::Text && std::io::stdout().is_terminal() && std::io::stdin().is_terminal()
}

/// Runs the command.
///
/// # Errors
/// No daemon answers, or the terminal cannot be used.
pub fn run(args: &Args, format: Format) -> anyhow::Result<Outcome> {
    let reach = Reach::of(args)?;
    block_on(async {
        let stop = asked_to_stop()?;
        let session = reach.open().await?;
        let prefix = bus::prefix_of_daemons(&session, reach.prefix.as_deref(), &reach.endpoints.join(", ")).await?;
        let mut board = LoopTable::new(&prefix);
        let shown = if is_possible(format) {
            follow(&session, &mut board, &[], stop).await
        } else {
            once(&session, &mut board, format).await
        };
        let _ = tokio::time::timeout(Duration::from_secs(1), session.close()).await;
        shown.map(|()| Outcome::Done)
    })
}

/// Shows the table, fed from the bus, until `ends` completes or the user quits.
pub(super) async fn follow(
    session: &Session,
    board: &mut LoopTable,
    below: &[String],
    ends: impl Future<Output = ()>,
) -> anyhow::Result<()> {
    let (told, mut news) = mpsc::channel(QUEUE);
    let (asks, asked) = mpsc::unbounded_channel();
    let following = tokio::spawn(bus::follow(session.clone(), board.prefix().to_owned(), told, asked));
    let shown = live::show(board, below, &mut news, &asks, ends).await;
    drop(asks);
    // Where it ended before us, it says why.
    if following.is_finished() {
        following.await??;
    } else {
        following.abort();
    }
    shown
}

/// Prints the table once.
async fn once(session: &Session, board: &mut LoopTable, format: Format) -> anyhow::Result<()> {
    let now = Now::read();
    for news in bus::last_values(session, board.prefix()).await? {
        board.take(news, now);
    }
    let view = View::default();
    let rows = view.rows(board);
    if format == Format::Json {
        for row in rows {
            let mut document = json!({"schema": "stictiond.top.v1", "at_ms": ms_from_ns(now.ns)});
            if let (Some(all), serde_json::Value::Object(fields)) =
                (document.as_object_mut(), serde_json::to_value(row)?)
            {
                all.extend(fields);
            }
            document["data_age_s"] = json!(board.age_s(&row.name, now));
            say(document)?;
        }
        return Ok(());
    }
    for (_, text) in head::texts(board, now) {
        say(text)?;
    }
    let look = TerminalStyle::of_environment();
    let longest = rows.iter().map(|row| row.name.chars().count()).max().unwrap_or(0);
    // One window is all that the last documents tell of: bars would have one place.
    let mut columns = cells::layout(TEXT_WIDTH, longest);
    columns.retain(|(column, _)| *column != cells::Column::Recent);
    let line = |cell: &dyn Fn(cells::Column, usize) -> String| {
        let cells = columns.iter().map(|(column, width)| draw::padded(&cell(*column, *width), *column, *width));
        cells.collect::<String>().trim_end().to_owned()
    };
    say(format!("\n{}", line(&|column, _| column.head(Figure::P).to_owned())))?;
    for row in rows {
        let age_s = board.age_s(&row.name, now);
        say(line(&|column, width| column.cell(row, width, Figure::P, age_s, look)))?;
    }
    Ok(())
}

/// Where and how to reach the daemons.
struct Reach {
    endpoints: Vec<String>,
    prefix: Option<String>,
    config: zenoh::Config,
}

impl Reach {
    fn of(args: &Args) -> anyhow::Result<Self> {
        let Some(path) = &args.config else {
            let endpoints = if args.connect.is_empty() { vec![USUAL.to_owned()] } else { args.connect.clone() };
            return Self::over(endpoints, args.prefix.clone(), zenoh::Config::default());
        };
        let (_, mut config) = config_file(path)?;
        let listening = config.zenoh.listen.iter().map(|endpoint| reachable(endpoint)).collect();
        let endpoints = [&args.connect, &config.zenoh.connect, &listening].into_iter().find(|list| !list.is_empty());
        let endpoints = endpoints.cloned().unwrap_or_else(|| vec![USUAL.to_owned()]);
        let prefix = args.prefix.clone().unwrap_or_else(|| config.site.prefix.clone());
        // Who may command is the daemon's to decide; here it would keep our own questions back.
        config.commands.principals.clear();
        let base = stiction_daemon::source::zenoh::session_config(&config)?;
        Self::over(endpoints, Some(prefix), base)
    }

    fn over(endpoints: Vec<String>, prefix: Option<String>, mut config: zenoh::Config) -> anyhow::Result<Self> {
        let timeout = bus::ANSWER_WITHIN.as_millis().to_string();
        let list = serde_json::to_string(&endpoints)?;
        // A client keeps to one of its endpoints; a peer has links to all of them.
        let mode = if endpoints.len() == 1 { "\"client\"" } else { "\"peer\"" };
        let settings = [
            ("mode", mode),
            ("id", "null"),
            ("scouting/multicast/enabled", "false"),
            ("listen/endpoints", "[]"),
            ("connect/endpoints", list.as_str()),
            ("connect/timeout_ms", timeout.as_str()),
            ("connect/exit_on_failure", if endpoints.len() == 1 { "true" } else { "false" }),
        ];
        for (key, value) in settings {
            config.insert_json5(key, value).map_err(|e| anyhow!("Zenoh rejects the setting {key} = {value}: {e}"))?;
        }
        Ok(Self { endpoints, prefix, config })
    }

    async fn open(&self) -> anyhow::Result<Session> {
        let at = self.endpoints.join(", ");
        zenoh::open(self.config.clone()).await.map_err(|e| {
            anyhow!(
                "no answer from {at} within {} s; start a daemon with `stictiond run --config FILE` \
                 or `stictiond demo`, and name its [zenoh] listen endpoint, or its router's, with --connect ({e})",
                bus::ANSWER_WITHIN.as_secs()
            )
        })
    }
}

/// A listen endpoint as one to connect to from the same machine.
fn reachable(endpoint: &str) -> String {
    endpoint.replace("/0.0.0.0:", "/127.0.0.1:").replace("/[::]:", "/[::1]:")
}
