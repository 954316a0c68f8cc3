//! The table without a terminal: documents of a shipped recording in, pictures as text out.

use std::path::Path;
use std::time::{Duration, Instant};

use ratatui::Terminal;
use ratatui::backend::TestBackend;
use ratatui::buffer::Buffer;
use ratatui::crossterm::event::{KeyCode, KeyEvent, KeyModifiers};
use ratatui::style::Color;
use serde_json::{Value, json};

use super::board::{LoopTable, News, Now};
use super::cells::TerminalStyle;
use super::draw;
use super::view::{Ask, Order, Page, Prompt, View};
use stiction_core::record::Signal;
use stiction_files::RecordingReader;
use stiction_monitor::codec::topic;

const PREFIX: &str = "area2";
const PLAIN: TerminalStyle = TerminalStyle { unicode: true, colour: false };
/// A quarter past midnight behind the recording's last window.
const END_NS: i64 = 1_767_659_100_000_000_000 + 900_000_000_000;

fn now(after_s: u64) -> Now {
    // One start for all moments of a test run.
    static START: std::sync::OnceLock<Instant> = std::sync::OnceLock::new();
    let start = *START.get_or_init(Instant::now);
    Now { at: start + Duration::from_secs(after_s), ns: END_NS + after_s as i64 * 1_000_000_000 }
}

fn document(key: &str, value: &Value) -> News {
    News::Document(topic::plane(PREFIX, key), value.to_string().into_bytes())
}

fn health(id: &str, faults: &[&str]) -> News {
    let counters = json!({"dropped_input": 3, "recording_lost": 0});
    let value = json!({"version": "1.2.3", "uptime_s": 3600.0, "counters": counters, "faults": faults});
    document(&format!("@daemon/{id}/health"), &value)
}

/// The four loops of the recording, as a daemon published them.
fn four_loops() -> LoopTable {
    let mut board = LoopTable::new(PREFIX);
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("recordings/four-loops.mcap");
    let mut reader = RecordingReader::open(&path).unwrap();
    while let Some(message) = reader.next_message().unwrap() {
        board.take(News::Document(message.topic().to_owned(), message.data.to_vec()), now(0));
    }
    board.take(health("d1", &["the disk is nearly full: 3 % are free"]), now(0));
    let flow = json!({"schema": "x", "data_age_s": 3.0, "data_gaps": 1, "dropped": 4});
    board.take(document("FIC201/health", &flow), now(0));
    board
}

fn drawn(board: &LoopTable, view: &mut View, width: u16, height: u16, look: TerminalStyle, at: Now) -> Buffer {
    let mut terminal = Terminal::new(TestBackend::new(width, height)).unwrap();
    terminal.draw(|frame| draw::draw(frame, board, view, &["below".to_owned()], look, at)).unwrap();
    terminal.backend().buffer().clone()
}

fn lines(buffer: &Buffer) -> Vec<String> {
    let width = usize::from(buffer.area.width);
    let rows = buffer.content.chunks(width);
    rows.map(|row| row.iter().map(|cell| cell.symbol()).collect::<String>().trim_end().to_owned()).collect()
}

fn text(board: &LoopTable, view: &mut View, width: u16, height: u16) -> String {
    lines(&drawn(board, view, width, height, PLAIN, now(0))).join("\n")
}

fn press(view: &mut View, board: &LoopTable, code: KeyCode) -> Option<Ask> {
    view.key(KeyEvent::new(code, KeyModifiers::NONE), board)
}

fn type_in(view: &mut View, board: &LoopTable, typed: &str) {
    for c in typed.chars() {
        assert_eq!(press(view, board, KeyCode::Char(c)), None);
    }
}

#[test]
fn eighty_columns_show_every_loop_with_its_verdict_and_what_is_wrong() {
    let board = four_loops();
    let told = text(&board, &mut View::of("ann"), 80, 14);
    let shown: Vec<&str> = told.lines().collect();
    assert_eq!(
        shown[..5],
        [
            "stictiond 1.2.3  area2  daemon d1  up 60 min  4 loops",
            "1 stiction, 1 deadband, 2 disturbance; alarms 2 active, 2 to acknowledge",
            "data: 0 silent, oldest data 15m (TIC204), gaps 1, dropped 4; 3 messages dropped",
            "FAULT: the disk is nearly full: 3 % are free",
            "107  loop   verdict            p     s      90 % g   period alarm     p trend",
        ],
        "{told}"
    );
    // The figures go with the recording, which each build of the solver writes anew; the columns do not.
    let rows = [
        ("M ◆  FIC201 stiction        ", "s UNACK     ·"),
        ("M ◆  LIC202 deadband        ", "s UNACK     ·"),
        ("S ▲  TIC204 disturbance     ", "s -         ·"),
        ("S ▲  PIC203 disturbance     ", "s -         ·"),
    ];
    for (line, (before, behind)) in shown[5..9].iter().zip(rows) {
        assert!(line.starts_with(before) && line.contains(behind), "{line}");
        let row = board.row(line.split_whitespace().nth(2).unwrap()).unwrap();
        let figures: Vec<&str> = line[before.len()..].split_whitespace().take(4).collect();
        assert_eq!(figures[0], format!("{:.2}", row.p_stiction.unwrap()), "{line}");
        let s: f64 = figures[1].parse().unwrap();
        assert!((s - row.s.unwrap()).abs() < 0.006 * s.max(1.0), "{line}");
        let (low, high) = figures[2].split_once("..").unwrap();
        let interval = [low, high].map(|x| x.parse::<f64>().unwrap());
        for (shown, known) in interval.iter().zip(row.s_interval.unwrap()) {
            assert!((shown - known).abs() < 0.06 * known.max(1.0), "{line}");
        }
        assert_eq!(figures[3], row.grade.unwrap().to_string(), "{line}");
    }
    assert_eq!(shown[11], "below");
    assert_eq!(shown[12], "FIC201: the valve sticks and slips");
}

#[test]
fn a_wide_screen_says_the_verdict_in_words_and_a_narrow_one_keeps_the_category() {
    let board = four_loops();
    let wide = text(&board, &mut View::default(), 140, 12);
    assert!(wide.contains("the loop oscillates, most likely because of an external disturbance"), "{wide}");
    assert!(wide.contains(" 3s"), "the age of FIC201's data: {wide}");
    let narrow = text(&board, &mut View::default(), 40, 12);
    assert!(narrow.contains("M ◆  FIC201 stiction"), "{narrow}");
}

#[test]
fn any_size_and_page_is_drawn() {
    let board = four_loops();
    for page in [Page::Table, Page::Loop("FIC201".into()), Page::Loop("gone".into()), Page::Help(Box::new(Page::Table))]
    {
        for (width, height) in [(1, 1), (3, 2), (10, 5), (20, 40), (80, 24), (300, 100)] {
            let mut view = View { page: page.clone(), ..View::default() };
            drawn(&board, &mut view, width, height, PLAIN, now(0));
        }
    }
}

#[test]
fn without_colour_and_without_unicode_the_letter_and_the_shape_still_say_it() {
    let board = four_loops();
    let ascii = TerminalStyle { unicode: false, colour: false };
    let picture = drawn(&board, &mut View::default(), 100, 20, ascii, now(0));
    assert!(picture.content.iter().all(|cell| cell.symbol().is_ascii()), "{}", lines(&picture).join("\n"));
    assert!(picture.content.iter().all(|cell| cell.fg == Color::Reset));
    assert!(lines(&picture).join("\n").contains("M #  FIC201"));
    let coloured = drawn(&board, &mut View::default(), 100, 20, TerminalStyle { unicode: true, colour: true }, now(0));
    assert!(coloured.content.iter().any(|cell| cell.fg == Color::LightBlue));
}

#[test]
fn one_loop_says_in_words_what_is_known_and_draws_what_comes() {
    let mut board = four_loops();
    let mut view = View { page: Page::Loop("FIC201".into()), ..View::default() };
    board.watch(Some("FIC201"));
    for k in 0..100 {
        let t_ns = k * 1_000_000_000;
        board.take(News::Sample("FIC201".into(), Signal::Op, t_ns, 40.0 + (k % 20) as f64), now(0));
        board.take(News::Sample("LIC202".into(), Signal::Pv, t_ns, 1.0), now(0));
    }
    let told = text(&board, &mut view, 120, 50);
    let row = board.row("FIC201").unwrap();
    let probability = format!("Stiction very likely (p {:.2})", row.p_stiction.unwrap());
    assert!(told.contains(&probability), "{probability}\n{told}");
    for part in [
        "FIC201  M ◆  the valve sticks and slips",
        " OP units, 90 % interval ",
        "What to do: ",
        "Data: age 3s, gaps 1, dropped 4",
        "Alarm unack, priority medium",
        "OP 40 to 59, last 99 s",
        "PV: waiting for samples",
        ": points to sticking.",
    ] {
        assert!(told.contains(part), "{part}\n{told}");
    }
}

#[test]
fn keys_order_filter_and_mark() {
    let board = four_loops();
    let mut view = View::of("ann");
    let names = |view: &View| view.rows(&board).iter().map(|r| r.name.clone()).collect::<Vec<_>>();
    assert_eq!(names(&view), ["FIC201", "LIC202", "TIC204", "PIC203"]);
    assert_eq!(press(&mut view, &board, KeyCode::Char('2')), None);
    assert_eq!((view.order, names(&view)[0].as_str()), (Order::Name, "FIC201"));
    press(&mut view, &board, KeyCode::Char('r'));
    assert_eq!(names(&view), ["TIC204", "PIC203", "LIC202", "FIC201"]);
    press(&mut view, &board, KeyCode::Char('r'));
    press(&mut view, &board, KeyCode::Char('4'));
    assert_eq!(names(&view), ["FIC201", "LIC202", "TIC204", "PIC203"]);
    press(&mut view, &board, KeyCode::Down);
    press(&mut view, &board, KeyCode::Down);
    assert_eq!(view.selected.as_deref(), Some("TIC204"));
    press(&mut view, &board, KeyCode::PageUp);
    assert_eq!(view.selected.as_deref(), Some("FIC201"));
    press(&mut view, &board, KeyCode::End);
    assert_eq!(view.selected.as_deref(), Some("PIC203"));

    press(&mut view, &board, KeyCode::Char('/'));
    type_in(&mut view, &board, "dist");
    press(&mut view, &board, KeyCode::Enter);
    assert_eq!(names(&view), ["TIC204", "PIC203"]);
    assert_eq!(press(&mut view, &board, KeyCode::Enter), Some(Ask::Watch(Some("PIC203".into()))));
    assert_eq!(press(&mut view, &board, KeyCode::Esc), Some(Ask::Watch(None)));
    press(&mut view, &board, KeyCode::Esc);
    assert_eq!(names(&view).len(), 4);
    assert_eq!(press(&mut view, &board, KeyCode::Char('q')), Some(Ask::Quit));
    let ctrl_c = KeyEvent::new(KeyCode::Char('c'), KeyModifiers::CONTROL);
    press(&mut view, &board, KeyCode::Char('/'));
    assert_eq!(view.key(ctrl_c, &board), Some(Ask::Quit));
}

#[test]
fn an_acknowledgement_wants_a_name_and_an_alarm_that_waits() {
    let board = four_loops();
    let mut view = View::of("");
    view.selected = Some("PIC203".into());
    press(&mut view, &board, KeyCode::Char('a'));
    assert_eq!(view.prompt, None);
    assert!(view.refused.as_ref().unwrap().contains("PIC203 is normal"));
    view.selected = Some("LIC202".into());
    press(&mut view, &board, KeyCode::Char('a'));
    assert_eq!(view.prompt, Some((Prompt::Acknowledge("LIC202".into()), String::new())));
    assert_eq!(press(&mut view, &board, KeyCode::Enter), None);
    assert!(view.refused.is_some() && view.prompt.is_some(), "nobody was named");
    type_in(&mut view, &board, "q;cmd=shelve");
    assert_eq!(press(&mut view, &board, KeyCode::Enter), None);
    assert!(view.refused.as_ref().unwrap().contains("';'"));
    for _ in 0..11 {
        press(&mut view, &board, KeyCode::Backspace);
    }
    type_in(&mut view, &board, "uinn");
    let asked = press(&mut view, &board, KeyCode::Enter);
    assert_eq!(asked, Some(Ask::Acknowledge { name: "LIC202".into(), by: "quinn".into() }));
    assert_eq!(view.person, "quinn");
}

#[test]
fn what_is_old_is_said_to_be_old_until_a_daemon_comes_back() {
    let mut board = four_loops();
    assert_eq!(board.stale(now(10)), None);
    assert!(board.stale(now(60)).unwrap().contains("no report from the daemon for 60 s"));
    board.take(News::Connected(false), now(60));
    assert!(board.stale(now(65)).unwrap().contains("connection lost 5 s ago"));
    let told = lines(&drawn(&board, &mut View::default(), 80, 20, PLAIN, now(65))).join("\n");
    assert!(told.contains("STALE: connection lost 5 s ago") && told.contains("FIC201"), "{told}");
    board.take(News::Connected(true), now(70));
    assert!(board.stale(now(70)).unwrap().contains("the daemon stopped"));
    board.take(News::Came("d2".into()), now(71));
    board.take(health("d2", &[]), now(71));
    assert_eq!(board.stale(now(72)), None);
    assert_eq!(board.daemons.len(), 1, "the old one is forgotten");
    board.take(News::Left("d2".into()), now(80));
    assert!(board.stale(now(81)).unwrap().contains("the daemon stopped 1 s ago"));
}

#[test]
fn what_was_said_before_counts_once_and_what_cannot_be_read_is_counted() {
    let mut board = four_loops();
    let before = board.row("FIC201").unwrap().recent.len();
    let again = board.newest("FIC201").estimate.unwrap();
    let again = serde_json::to_value(&*again).unwrap();
    board.take(document("FIC201/estimate", &again), now(1));
    assert_eq!(board.row("FIC201").unwrap().recent.len(), before);
    for (key, payload) in [("FIC201/estimate", "{"), ("FIC201/alarm", "{}"), ("X/gap", "[1]")] {
        board.take(News::Document(topic::plane(PREFIX, key), payload.into()), now(1));
    }
    assert_eq!(board.unread, 3);
    assert!(text(&board, &mut View::default(), 80, 20).contains("3 documents could not be parsed"));
    assert!(board.row("X").is_none());
}

#[test]
fn nothing_that_others_publish_steers_the_terminal() {
    let mut board = four_loops();
    let mut alarm = serde_json::to_value(&*board.newest("FIC201").alarm.unwrap()).unwrap();
    alarm["detail"] = json!("\u{1b}]0;x\u{7}\u{9b}2J");
    board.take(document("FIC201/alarm", &alarm), now(1));
    board.take(health("\u{1b}[2J", &["\u{1b}[31m"]), now(1));
    for page in [Page::Table, Page::Loop("FIC201".into())] {
        let mut view = View { page, ..View::default() };
        let picture = drawn(&board, &mut view, 120, 40, PLAIN, now(1));
        assert!(picture.content.iter().all(|cell| !cell.symbol().contains(char::is_control)));
    }
}
