//! Shapes: exports as written by common systems, with the expected result for each.

use super::columnar::columnar;
use super::data::{Form, ROWS, XlsxCell, grouped, local, op, point, pv, t_s, utc, xlsx};

/// The expected result for a shape.
pub enum Must {
    /// The data, under this loop's name.
    Read(&'static str),
    /// A refusal that contains this text; with the flags, the data under the loop's name.
    Ask(&'static str, &'static [&'static str], &'static str),
    /// A refusal that contains this text.
    Refuse(&'static str),
}

/// One shape.
pub struct Shape {
    pub name: &'static str,
    /// Files with their bytes; a single one is read directly, several through their folder.
    pub files: Vec<(&'static str, Vec<u8>)>,
    pub flags: &'static [&'static str],
    pub must: Must,
}

pub const BERLIN: &[&str] = &["--tz", "Europe/Berlin"];
pub const UTC: &[&str] = &["--tz", "UTC"];

pub fn text(name: &'static str, file: &'static str, text: String, flags: &'static [&'static str], must: Must) -> Shape {
    Shape { name, files: vec![(file, text.into_bytes())], flags, must }
}

pub fn iso(k: usize) -> String {
    utc(k, "%Y-%m-%dT%H:%M:%SZ")
}

fn pi(k: usize) -> String {
    local(k, "Europe/Berlin", "%d-%b-%y %H:%M:%S")
}

fn german(k: usize) -> String {
    local(k, "Europe/Berlin", "%d.%m.%Y %H:%M:%S")
}

fn american(k: usize) -> String {
    local(k, "America/Chicago", "%-m/%-d/%Y %-I:%M:%S %p")
}

/// Moves the data to a day after the 12th, so that the file itself shows the order of day and month.
fn shifted(rows: String, day: &str, to: &str) -> String {
    rows.replace(day, to)
}

pub fn excel_days(k: usize) -> f64 {
    t_s(k) as f64 / 86_400.0 + 25_569.0
}

/// Text exports that differ in times or encodings.
fn times() -> Vec<Shape> {
    use Must::{Ask, Read, Refuse};
    let tags = &["Time", "41FIC101.OP", "41FIC101.PV"];
    let table = |time: fn(usize) -> String| Form::with(time).table(tags);
    vec![
        text(
            "the program's own, seconds",
            "41FIC101.csv",
            Form::with(|k| t_s(k).to_string()).table(&["t", "op", "pv"]),
            &[],
            Read("41FIC101"),
        ),
        text(
            "the program's own, RFC 3339",
            "41FIC101.csv",
            Form::with(iso).table(&["t", "op", "pv"]),
            &[],
            Read("41FIC101"),
        ),
        text("epoch seconds", "a.csv", table(|k| t_s(k).to_string()), &[], Read("41FIC101")),
        text("epoch ms", "a.csv", table(|k| format!("{}000", t_s(k))), &[], Read("41FIC101")),
        text("epoch µs", "a.csv", table(|k| format!("{}000000", t_s(k))), &[], Read("41FIC101")),
        text("epoch ns", "a.csv", table(|k| format!("{}000000000", t_s(k))), &[], Read("41FIC101")),
        text(
            "RFC 3339 with offset",
            "a.csv",
            table(|k| local(k, "Europe/Berlin", "%Y-%m-%dT%H:%M:%S%:z")),
            &[],
            Read("41FIC101"),
        ),
        text(
            "ISO without zone",
            "a.csv",
            table(|k| utc(k, "%Y-%m-%d %H:%M:%S")),
            &[],
            Ask("--tz Europe/Berlin", UTC, "41FIC101"),
        ),
        text(
            "ISO without zone, zone in the heading",
            "a.csv",
            Form::with(|k| utc(k, "%Y-%m-%d %H:%M:%S")).table(&["Time (UTC)", "41FIC101.OP", "41FIC101.PV"]),
            &[],
            Read("41FIC101"),
        ),
        text("PI: month by name, two-figure year", "pi.csv", table(pi), BERLIN, Read("41FIC101")),
        text(
            "PI: German names of months",
            "pi.csv",
            table(pi).replace("Jan", "Mai"),
            &["--tz", "Europe/Berlin"],
            Must::Read("41FIC101 in May"),
        ),
        text(
            "German: dd.mm.yyyy, semicolons, decimal comma",
            "de.csv",
            Form::german(german).table(tags),
            BERLIN,
            Read("41FIC101"),
        ),
        text(
            "US: AM/PM, the day shows the order",
            "us.csv",
            shifted(table(american), "1/5/2026", "1/25/2026"),
            &["--tz", "America/Chicago"],
            Must::Read("41FIC101 twenty days on"),
        ),
        text(
            "AM/PM, nothing shows the order",
            "us.csv",
            table(american),
            &["--tz", "America/Chicago"],
            Ask("--time-format mdy", &["--tz", "America/Chicago", "--time-format", "mdy"], "41FIC101"),
        ),
        text(
            "dd/mm/yyyy, nothing shows the order",
            "uk.csv",
            table(|k| utc(k, "%d/%m/%Y %H:%M:%S")),
            UTC,
            Ask("--time-format dmy", &["--tz", "UTC", "--time-format", "dmy"], "41FIC101"),
        ),
        text(
            "a pattern of its own",
            "x.csv",
            table(|k| utc(k, "%Hh%Mm%S on %d.%m.%Y")),
            UTC,
            Ask("--time-format", &["--tz", "UTC", "--time-format", "%Hh%Mm%S on %d.%m.%Y"], "41FIC101"),
        ),
        text("yyyymmddhhmmss", "x.csv", table(|k| utc(k, "%Y%m%d%H%M%S")), UTC, Read("41FIC101")),
        text("Excel day numbers", "x.csv", table(|k| format!("{:.9}", excel_days(k))), UTC, Read("41FIC101")),
        text(
            "MATLAB datenum",
            "m.csv",
            table(|k| format!("{:.9}", t_s(k) as f64 / 86_400.0 + 719_529.0)),
            UTC,
            Read("41FIC101"),
        ),
        text(
            "Excel day numbers under t",
            "x.csv",
            Form::with(|k| format!("{:.9}", excel_days(k))).table(&["t", "op", "pv"]),
            UTC,
            Ask("--time-format", &["--tz", "UTC", "--time-format", "excel"], "x"),
        ),
        text(
            "MATLAB datenum under t, 10 min apart",
            "x.csv",
            Form::with(|k| format!("{:.9}", (t_s(k) as f64 + 590.0 * k as f64) / 86_400.0 + 719_529.0))
                .table(&["t", "op", "pv"]),
            UTC,
            Refuse("--time-format datenum"),
        ),
        text(
            "Excel days since 1904",
            "x.csv",
            table(|k| format!("{:.9}", excel_days(k) - 1462.0)),
            &["--tz", "UTC", "--time-format", "excel1904"],
            Read("41FIC101"),
        ),
        text(
            "seconds from the start",
            "x.csv",
            table(|k| (t_s(k) - t_s(0)).to_string()),
            &[],
            Must::Ask("--time-format s", &["--time-format", "s"], "41FIC101 from 1970"),
        ),
        text(
            "seconds from the start, unit in the heading",
            "x.csv",
            Form::with(|k| (t_s(k) - t_s(0)).to_string()).table(&["Time [s]", "41FIC101.OP", "41FIC101.PV"]),
            &[],
            Must::Read("41FIC101 from 1970"),
        ),
        text(
            "steps below a millisecond",
            "x.csv",
            table(|k| format!("{}.{:06}", t_s(0), 10 * k)),
            &[],
            Refuse("faster than loops are sampled"),
        ),
        text(
            "a date in 1926",
            "x.csv",
            table(|k| utc(k, "%Y-%m-%dT%H:%M:%SZ").replace("2026", "1926")),
            &[],
            Refuse("not between 1990 and next year"),
        ),
        text(
            "zone in a column",
            "x.csv",
            Form::with(|k| local(k, "Europe/Berlin", "%d.%m.%Y %H:%M:%S,%:z")).table(&[
                "Time",
                "UTC offset",
                "41FIC101.OP",
                "41FIC101.PV",
            ]),
            &[],
            Read("41FIC101"),
        ),
        text(
            "milliseconds in a column",
            "x.csv",
            Form::with(|k| utc(k, "%Y-%m-%dT%H:%M:%SZ,250")).table(&["Time", "ms", "41FIC101.OP", "41FIC101.PV"]),
            &[],
            Ask("part of the time", &["--map", "t=1,op=3,pv=4"], "x"),
        ),
        text(
            "date and time in two columns",
            "x.csv",
            Form::with(|k| utc(k, "%Y-%m-%d,%H:%M:%S")).table(&["Date", "Time", "41FIC101.OP", "41FIC101.PV"]),
            UTC,
            Read("41FIC101"),
        ),
    ]
}

/// Text exports that differ in layout.
fn layouts() -> Vec<Shape> {
    use Must::{Ask, Read, Refuse};
    let tags = &["Timestamp", "41FIC101.OP", "41FIC101.PV"];
    let with = Form::with(iso);
    let long = |quality: &str| {
        let row = |k: usize| {
            let t = iso(k);
            format!(
                "41FIC101.PV,{t},{}{quality}\n41FIC101.OP,{t},{}{quality}\n41TI5,{t},20{quality}\n",
                point(pv(k)),
                point(op(k))
            )
        };
        (0..ROWS).map(row).collect::<String>()
    };
    let one =
        |value: fn(usize) -> f64| (0..ROWS).map(|k| format!("{},{}\n", iso(k), point(value(k)))).collect::<String>();
    let german_tags = Form::german(german).table(&["Zeit", "41FIC101.OP", "41FIC101.PV"]);
    vec![
        text("tabs", "x.txt", Form { separator: "\t", ..with }.table(tags), &[], Read("41FIC101")),
        text(
            "quotes, thousands with commas",
            "x.csv",
            Form { number: |v| format!("\"{}\"", grouped(v, ',', '.')), ..with }.table(tags),
            &[],
            Read("41FIC101"),
        ),
        text(
            "thousands with points, decimal comma",
            "x.csv",
            Form { separator: ";", number: |v| grouped(v, '.', ','), ..with }.table(tags),
            &[],
            Read("41FIC101"),
        ),
        text(
            "thousands with blanks, decimal comma",
            "x.csv",
            Form { separator: ";", number: |v| grouped(v, '\u{a0}', ','), ..with }.table(tags),
            &[],
            Read("41FIC101"),
        ),
        text(
            "three figures behind every comma",
            "x.csv",
            Form { separator: ";", number: |v| format!("{:.3}", v).replace('.', ","), ..with }
                .table(tags)
                .replace("12", "2")
                .replace("0,", "1,"),
            &[],
            Refuse("--decimal comma"),
        ),
        text(
            "decimal commas between commas",
            "x.csv",
            Form { number: super::data::comma, ..with }.table(tags),
            &[],
            Refuse("decimal comma in a comma-separated file"),
        ),
        text(
            "comment lines, a title",
            "x.csv",
            format!("# PI export\nPlant 41, June\n{}", with.table(tags)),
            &[],
            Read("41FIC101"),
        ),
        text("a row of units", "x.csv", with.table(tags).replacen('\n', "\n,%,m3/h\n", 1), &[], Read("41FIC101")),
        text(
            "units in brackets (Seeq)",
            "x.csv",
            with.table(&["Date-Time", "41FIC101.OP (%)", "41FIC101.PV (m³/h)"]),
            &[],
            Read("41FIC101"),
        ),
        text("no header", "x.csv", with.rows(), &[], Ask("--map t=1,op=2,pv=3", &["--map", "t=1,op=2,pv=3"], "x")),
        text(
            "tags that say nothing",
            "x.csv",
            with.table(&["Timestamp", "41FY101", "41FI101"]),
            &[],
            Ask("--map op=TAG,pv=TAG", &["--map", "op=41FY101,pv=41FI101"], "41F"),
        ),
        text(
            "newest first",
            "x.csv",
            format!("{}\n{}", tags.join(","), with.rows_of((0..ROWS).rev())),
            &[],
            Read("41FIC101"),
        ),
        text(
            "unordered",
            "x.csv",
            format!("{}\n{}", tags.join(","), with.rows_of((0..ROWS).map(|k| (k * 37) % ROWS))),
            &[],
            Read("41FIC101"),
        ),
        text(
            "long: tag, timestamp, value, quality",
            "x.csv",
            format!("tag,timestamp,value,quality\n{}", long(",Good")),
            &[],
            Read("41FIC101"),
        ),
        text(
            "long: classic OPC codes",
            "x.csv",
            format!("TagName;Timestamp;Value;Quality\n{}", long(",192")).replace(',', ";"),
            &[],
            Read("41FIC101"),
        ),
        text(
            "long: codes of no known meaning",
            "x.csv",
            format!("tag,timestamp,value,status\n{}", long(",3")),
            &[],
            Ask("--quality", &["--quality", "ignore"], "41FIC101"),
        ),
        Shape {
            name: "one file a signal",
            files: vec![
                ("41FIC101.OP.csv", format!("Timestamp,Value\n{}", one(op)).into_bytes()),
                ("41FIC101.PV.csv", format!("Timestamp,Value\n{}", one(pv)).into_bytes()),
            ],
            flags: &[],
            must: Read("41FIC101"),
        },
        text(
            "one signal alone",
            "41FIC101.OP.csv",
            format!("Timestamp,Value\n{}", one(op)),
            &[],
            Refuse("give the folder"),
        ),
        text(
            "Honeywell: blocks",
            "x.csv",
            with.table(&["Timestamp", "41FIC101.PIDA.OP", "41FIC101.DACA.PV"]),
            &[],
            Read("41FIC101"),
        ),
        text(
            "DeltaV: parameters",
            "x.csv",
            with.table(&["Timestamp", "41FIC101/PID1/OUT.CV", "41FIC101/PID1/PV.CV"]),
            &[],
            Read("41FIC101"),
        ),
        text(
            "AspenTech: process value, output",
            "x.csv",
            with.table(&["Timestamp", "41FIC101_OUT", "41FIC101_PROCESS_VALUE"]),
            &[],
            Read("41FIC101"),
        ),
        text(
            "Yokogawa: MV is the output",
            "x.csv",
            with.table(&["Timestamp", "41FIC101.MV", "41FIC101.PV"]),
            &[],
            Read("41FIC101"),
        ),
        text(
            "InfluxDB: annotated",
            "x.csv",
            {
                let row = |k: usize| {
                    let part = |v: f64, field: &str| format!(",,0,{},{},{field},41FIC101\n", iso(k), point(v));
                    part(op(k), "OP") + &part(pv(k), "PV")
                };
                let head = "#datatype,string,long,dateTime:RFC3339,double,string,string\n,result,table,_time,_value,_field,_measurement\n";
                format!("{head}{}", (0..ROWS).map(row).collect::<String>())
            },
            &[],
            Read("41FIC101"),
        ),
        text(
            "the rows of two loops in one table",
            "x.csv",
            {
                let row = |k: usize| {
                    let of = |name: &str, v: f64| format!("{},{name},{},{}\n", iso(k), point(v), point(pv(k) + v));
                    of("A", op(k)) + &of("B", op(k) + 1.0)
                };
                format!("Time,Unit,41FIC101.OP,41FIC101.PV\n{}", (0..ROWS).map(row).collect::<String>())
            },
            &[],
            Refuse("two values at most of its times"),
        ),
        text(
            "PI DataLink: each tag its own times",
            "x.csv",
            {
                let row = |k: usize| format!("{t},{},{t},{}\n", point(op(k)), point(pv(k)), t = iso(k));
                format!("Time,41FIC101.OP,Time,41FIC101.PV\n{}", (0..ROWS).map(row).collect::<String>())
            },
            &[],
            Read("41FIC101"),
        ),
        Shape {
            name: "UTF-8 with byte order mark",
            files: vec![("x.csv", format!("\u{feff}{}", with.table(tags)).into_bytes())],
            flags: &[],
            must: Read("41FIC101"),
        },
        Shape {
            name: "UTF-16 with byte order mark",
            files: vec![(
                "x.csv",
                format!("\u{feff}{}", with.table(tags)).encode_utf16().flat_map(u16::to_le_bytes).collect(),
            )],
            flags: &[],
            must: Read("41FIC101"),
        },
        Shape {
            name: "Latin-1",
            files: vec![(
                "x.csv",
                german_tags.replacen('\n', "\n;%;m³/h\n", 1).chars().map(|c| u32::from(c) as u8).collect(),
            )],
            flags: BERLIN,
            must: Read("41FIC101"),
        },
        text("Excel's sep= line", "x.csv", format!("sep=;\n{german_tags}"), BERLIN, Read("41FIC101")),
        text("no table at all", "x.csv", "Dear all,\nplease find nothing.\n".to_owned(), &[], Refuse("line 1")),
        text(
            "a time in the middle that is none",
            "x.csv",
            with.table(tags).replace(&iso(30), "soon"),
            &[],
            Refuse("line 32"),
        ),
        text(
            "texts where numbers should stand",
            "x.csv",
            Form { number: |_| "abc".to_owned(), ..with }.table(tags),
            &[],
            Refuse("which is not a number"),
        ),
    ]
}

/// Words for missing values, and files that are not text.
fn others() -> Vec<Shape> {
    use Must::{Ask, Read};
    let rows = |date: fn(usize) -> XlsxCell| {
        let head = ["Time", "41FIC101.OP", "41FIC101.PV"].map(|t| XlsxCell::Text(t.to_owned()));
        let row = |k: usize| vec![date(k), XlsxCell::Number(op(k)), XlsxCell::Number(pv(k))];
        std::iter::once(Vec::from(head)).chain((0..ROWS).map(row)).collect::<Vec<_>>()
    };
    let with = Form::with(iso);
    let table = with.table(&["Time", "41FIC101.OP", "41FIC101.PV"]);
    let line = |k: usize| format!("{},{},{}\n", iso(k), point(op(k)), point(pv(k)));
    let bad = |k: usize, word: &str| format!("{},{word},{word}\n", iso(k));
    let words = [(50, "Bad Input"), (52, "I/O Timeout"), (54, "No Data"), (56, "Bad Input")]
        .iter()
        .fold(table, |text, (k, word)| text.replace(&line(*k), &bad(*k, word)));
    let marked = |heads: &[&str]| {
        let mark = |k: usize| if [50, 52, 54, 56].contains(&k) { ",Bad" } else { ",Good" };
        let row = |k: usize| line(k).trim_end().to_owned() + &mark(k).repeat(heads.len()) + "\n";
        let rows: String = (0..ROWS).map(row).collect();
        format!("Time,41FIC101.OP,41FIC101.PV,{}\n{rows}", heads.join(","))
    };
    let sentinels = words.replace("Bad Input", "-9999").replace("I/O Timeout", "-9999").replace("No Data", "-9999");
    let mut all = vec![
        text("Bad Input, I/O Timeout, No Data", "x.csv", words, &[], Must::Read("41FIC101 with 4 missing")),
        text(
            "quality columns in a block behind the values",
            "x.csv",
            marked(&["41FIC101.OP.Quality", "41FIC101.PV.Quality"]),
            &[],
            Must::Read("41FIC101 with 4 missing"),
        ),
        text(
            "one quality column for the row",
            "x.csv",
            marked(&["Quality"]),
            &[],
            Must::Read("41FIC101 with 4 missing"),
        ),
        text(
            "words for quality under a heading of its own",
            "x.csv",
            marked(&["Zustand"]),
            &[],
            Ask("--map quality=4", &["--map", "quality=4"], "41FIC101 with 4 missing"),
        ),
        text(
            "flags that are set where a value is bad, as of PI",
            "x.csv",
            marked(&["Good", "Questionable", "Substituted"])
                .replace(",Bad,Bad,Bad", ",True,True,False")
                .replace(",Good,Good,Good\n", ",True,False,False\n"),
            &[],
            Must::Read("41FIC101 with 4 missing"),
        ),
        text(
            "a flag of the value before it",
            "x.csv",
            marked(&["41FIC101.PV Questionable", "41FIC101.OP Questionable"])
                .replace(",Bad", ",1")
                .replace(",Good", ",0"),
            &[],
            Must::Read("41FIC101 with 4 missing"),
        ),
        text(
            "a flag that is none",
            "x.csv",
            marked(&["Questionable"]),
            &[],
            Ask("not true or false", &["--quality", "ignore"], "41FIC101"),
        ),
        text(
            "a number that loggers write for a missing value",
            "x.csv",
            sentinels,
            &[],
            Ask("--missing=-9999", &["--missing", "-9999"], "41FIC101 with 4 missing"),
        ),
        Shape {
            name: "workbook with dates",
            files: vec![("x.xlsx", xlsx(&rows(|k| XlsxCell::Date(excel_days(k)))))],
            flags: &[],
            must: Ask("--tz", UTC, "41FIC101"),
        },
        Shape {
            name: "workbook with day numbers",
            files: vec![("x.xlsx", xlsx(&rows(|k| XlsxCell::Number(excel_days(k)))))],
            flags: UTC,
            must: Read("41FIC101"),
        },
        Shape {
            name: "workbook with texts as times",
            files: vec![("x.xlsx", xlsx(&rows(|k| XlsxCell::Text(iso(k)))))],
            flags: &[],
            must: Read("41FIC101"),
        },
    ];
    all.extend(columnar());
    all
}

/// Every shape, in the order of the page.
pub fn all() -> Vec<Shape> {
    [times(), layouts(), others(), super::doubts::doubts()].into_iter().flatten().collect()
}
