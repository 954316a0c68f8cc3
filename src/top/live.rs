//! The live table: takes keys and bus input, draws frames, until the user quits.

use std::future::Future;
use std::time::{Duration, Instant};

use ratatui::crossterm::event::Event;
use tokio::sync::mpsc::{Receiver, UnboundedSender};

use super::board::{LoopTable, News, Now};
use super::cells::TerminalStyle;
use super::draw;
use super::screen::{self, Screen};
use super::view::{Ask, View};

/// Shortest time between frames, except after a key.
const PICTURE: Duration = Duration::from_millis(200);
/// Longest time between frames, so that ages advance.
const AGES: Duration = Duration::from_secs(1);
/// Inputs taken before the next key is handled.
const AT_ONCE: usize = 512;

/// Shows the board until `ends` completes or the user quits.
///
/// # Errors
/// The terminal cannot be used.
pub async fn show(
    board: &mut LoopTable,
    below: &[String],
    news: &mut Receiver<News>,
    asks: &UnboundedSender<Ask>,
    ends: impl Future<Output = ()>,
) -> anyhow::Result<()> {
    let look = TerminalStyle::of_environment();
    let person = std::env::var("USER").or_else(|_| std::env::var("LOGNAME")).unwrap_or_default();
    let mut view = View::of(&person);
    let mut screen = Screen::open()?;
    let mut keys = screen::keys()?;
    let mut tick = tokio::time::interval(PICTURE);
    tokio::pin!(ends);
    let (mut changed, mut drawn) = (true, None::<Instant>);
    loop {
        let mut at_once = false;
        tokio::select! {
            () = &mut ends => return Ok(()),
            event = keys.recv() => {
                let Some(event) = event else { return Ok(()) };
                at_once = true;
                let ask = if let Event::Key(key) = event { view.key(key, board) } else { None };
                match ask {
                    Some(Ask::Quit) => return Ok(()),
                    Some(ask) => {
                        if let Ask::Watch(name) = &ask {
                            board.watch(name.as_deref());
                        }
                        // Who carries it out ends with the program alone.
                        drop(asks.send(ask));
                    }
                    None => {}
                }
            }
            first = news.recv() => {
                let Some(first) = first else { return Ok(()) };
                let now = Now::read();
                board.take(first, now);
                for _ in 0..AT_ONCE {
                    let Ok(more) = news.try_recv() else { break };
                    board.take(more, now);
                }
                changed = true;
            }
            _ = tick.tick() => {
                at_once = drawn.is_none_or(|at| changed || at.elapsed() >= AGES);
            }
        }
        if at_once {
            screen.draw(|frame| draw::draw(frame, board, &mut view, below, look, Now::read()))?;
            (changed, drawn) = (false, Some(Instant::now()));
        }
    }
}
