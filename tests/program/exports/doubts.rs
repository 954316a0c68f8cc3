//! Shapes with a second reading that a careless reader takes: each is read by what the file says, or refused.

use super::data::{Form, ROWS, XlsxCell, local, op, point, pv, t_s, utc, workbook, xlsx};
use super::shapes::Must::{Ask, Read, Refuse};
use super::shapes::{BERLIN, Shape, UTC, excel_days, iso, text};

const TAGS: &[&str] = &["Time", "41FIC101.OP", "41FIC101.PV"];

fn berlin(k: usize) -> String {
    local(k, "Europe/Berlin", "%Y-%m-%d %H:%M:%S")
}

/// A table, with some of its values replaced by a word.
fn with(word: &str, rows: &[usize]) -> String {
    let row = |k: usize| match rows.contains(&k) {
        true => format!("{},{word},{word}\n", iso(k)),
        false => format!("{},{},{}\n", iso(k), point(op(k)), point(pv(k))),
    };
    format!("{}\n{}", TAGS.join(","), (0..ROWS).map(row).collect::<String>())
}

fn zones() -> Vec<Shape> {
    let table = |head: &str| Form::with(berlin).table(&[head, "41FIC101.OP", "41FIC101.PV"]);
    let below = |line: &str| format!("{line}\n{}", Form::with(berlin).table(TAGS));
    let refused = |name, text_of: String, part| text(name, "x.csv", text_of, UTC, Ask(part, BERLIN, "41FIC101"));
    vec![
        text("a zone in a comment", "x.csv", below("# Time zone: Europe/Berlin"), &[], Read("41FIC101")),
        text("a city in brackets", "x.csv", table("Time (Berlin)"), &[], Read("41FIC101")),
        refused("a zone in a comment against --tz", below("# Time zone: Europe/Berlin"), "line 1 names Europe/Berlin"),
        refused("a zone in a title against --tz", below("Times in Europe/Berlin,,"), "line 1 names Europe/Berlin"),
        refused("a city against --tz", table("Time (Berlin)"), "--tz Europe/Berlin"),
        refused("a region against --tz", table("Time (Central European Time)"), "--tz Europe/Berlin"),
        refused(
            "a zone in the row of units against --tz",
            table("Time").replacen('\n', "\nEurope/Berlin,%,bar\n", 1),
            "--tz",
        ),
        text(
            "a region alone",
            "x.csv",
            table("Time (Central European Time)"),
            &[],
            Ask("summer time open; give the time zone: --tz Europe/Berlin", BERLIN, "41FIC101"),
        ),
        text(
            "letters in a comment",
            "x.csv",
            below("# all times in CET"),
            &[],
            Ask("CET names a zone for half of the year", BERLIN, "41FIC101"),
        ),
        text(
            "a zone that is not known",
            "x.csv",
            table("Time (Atlantis)"),
            BERLIN,
            Ask("\"Atlantis\", which is no time zone", &["--tz", "Europe/Berlin", "--map", "t=1,op=2,pv=3"], "x"),
        ),
        text(
            "an instant of the export in a comment",
            "x.csv",
            below("# exported at 08:00 UTC"),
            BERLIN,
            Read("41FIC101"),
        ),
    ]
}

fn numbers() -> Vec<Shape> {
    let since = |year: &str, offset_s: i64| {
        let rows = |k: usize| format!("{},{},{}\n", t_s(k) - offset_s, point(op(k)), point(pv(k)));
        let part = match year {
            "2001" => "in s since 1970 a time of 1995",
            _ => "in s since 1970 a time of 2016",
        };
        let name = if year == "2001" { "seconds since 2001" } else { "seconds since 1980" };
        let all: String = (0..ROWS).map(rows).collect();
        text(name, "x.csv", format!("{}\n{all}", TAGS.join(",")), &[], Refuse(part))
    };
    let long = |psi: usize| {
        let row = |k: usize| {
            let unit = if k == psi { "psi" } else { "bar" };
            format!("41FIC101.OP,{t},{},%\n41FIC101.PV,{t},{},{unit}\n", point(op(k)), point(pv(k)), t = iso(k))
        };
        format!("tag,timestamp,value,units\n{}", (0..ROWS).map(row).collect::<String>())
    };
    let none = |value: &'static str, flag: &'static [&'static str]| Ask(value, flag, "41FIC101 with 4 missing");
    let missing = [50, 52, 54, 56];
    vec![
        since("2001", 978_307_200),
        since("1980", 315_964_800),
        text(
            "a number that no list has",
            "x.csv",
            with("6999", &missing),
            &[],
            none("--missing=6999", &["--missing", "6999"]),
        ),
        text(
            "a huge number",
            "x.csv",
            with("1e10", &missing),
            &[],
            none("--missing=10000000000", &["--missing", "1e10"]),
        ),
        text(
            "one psi among bare numbers",
            "x.csv",
            with("14.5 psi", &[20]),
            &[],
            Refuse("line 22: \"41FIC101.OP\" contains \"14.5 psi\""),
        ),
        text(
            "a unit that changes in its column",
            "x.csv",
            long(30),
            &[],
            Refuse("is in \"psi\", and in \"bar\" before"),
        ),
        text("a unit in its column", "x.csv", long(ROWS), &[], Read("41FIC101")),
        text(
            "times without their seconds",
            "x.csv",
            Form::with(|k| utc(k, "%Y-%m-%dT%H:%MZ")).table(TAGS),
            &[],
            Refuse(
                "line 3: the tag \"41FIC101.OP\" has two values at most of its times; export times with their seconds",
            ),
        ),
    ]
}

fn ends() -> Vec<Shape> {
    let whole = Form::with(iso).table(TAGS);
    let cut = |by: usize| whole[..whole.len() - 1 - by].to_owned();
    let more = |end: &str| format!("{whole}{end}");
    let next = iso(ROWS);
    vec![
        text("no end of line, and nothing is missing", "x.csv", cut(0), &[], Read("41FIC101")),
        text("cut inside its last number", "x.csv", more(&format!("{next},40.25,1200.5")), &[], Read("41FIC101")),
        text("cut inside its second number", "x.csv", more(&format!("{next},40.2")), &[], Read("41FIC101")),
        text("cut inside its time", "x.csv", more(&next[..14]), &[], Read("41FIC101")),
        text(
            "cut inside its last word",
            "x.csv",
            (0..=ROWS)
                .map(|k| format!("{},{},{},Good\n", iso(k), point(op(k)), point(pv(k))))
                .fold("Time,41FIC101.OP,41FIC101.PV,Quality\n".to_owned(), |all, row| all + &row)
                .trim_end_matches("od\n")
                .to_owned(),
            &[],
            Read("41FIC101"),
        ),
    ]
}

fn workbooks() -> Vec<Shape> {
    let rows = |time: fn(f64) -> XlsxCell, value: fn(f64) -> XlsxCell, offset: f64| {
        let head = TAGS.iter().map(|tag| XlsxCell::Text((*tag).to_owned())).collect();
        let row = |k: usize| vec![time(excel_days(k) - offset), value(op(k)), XlsxCell::Number(pv(k))];
        std::iter::once(head).chain((0..ROWS).map(row)).collect::<Vec<_>>()
    };
    let since_1904 = "<workbookPr date1904=\"1\"/>";
    let book = |name, bytes, must| Shape { name, files: vec![("x.xlsx", bytes)], flags: UTC, must };
    vec![
        book(
            "workbook since 1904 with day numbers",
            workbook(&rows(XlsxCell::Number, XlsxCell::Number, 1462.0), since_1904),
            Read("41FIC101"),
        ),
        book(
            "workbook since 1904 with dates",
            workbook(&rows(XlsxCell::Date, XlsxCell::Number, 1462.0), since_1904),
            Read("41FIC101"),
        ),
        book(
            "workbook whose values became dates",
            xlsx(&rows(XlsxCell::Date, XlsxCell::Date, 0.0)),
            Refuse("\"41FIC101.OP\" contains the date 1900-02-0"),
        ),
    ]
}

/// Shapes with a second reading.
pub fn doubts() -> Vec<Shape> {
    [zones(), numbers(), ends(), workbooks()].into_iter().flatten().collect()
}
