//! One loop's data, written in every shape; reading must give these values at these times.

use std::fmt::Write as _;

use jiff::Timestamp;
use jiff::tz::TimeZone;

/// Number of rows.
pub const ROWS: usize = 60;
/// 2026-01-05T08:00:00Z, s.
pub const START_S: i64 = 1_767_600_000;
/// Time between rows, s.
pub const STEP_S: i64 = 10;

/// Time of a row, s since 1970.
pub fn t_s(k: usize) -> i64 {
    START_S + STEP_S * k as i64
}

/// OP of a row, %.
pub fn op(k: usize) -> f64 {
    40.25 + (k % 7) as f64 * 1.5
}

/// PV of a row: above a thousand, to test thousands separators.
pub fn pv(k: usize) -> f64 {
    1200.5 + (k % 5) as f64 * 12.25
}

/// Format of a table.
#[derive(Clone, Copy)]
pub struct Form {
    pub separator: &'static str,
    pub time: fn(usize) -> String,
    pub number: fn(f64) -> String,
}

pub fn local(k: usize, zone: &str, pattern: &str) -> String {
    let zone = TimeZone::get(zone).unwrap();
    Timestamp::from_second(t_s(k)).unwrap().to_zoned(zone).strftime(pattern).to_string()
}

pub fn utc(k: usize, pattern: &str) -> String {
    local(k, "UTC", pattern)
}

pub fn point(v: f64) -> String {
    format!("{v:.2}")
}

pub fn comma(v: f64) -> String {
    point(v).replace('.', ",")
}

/// A number with separators for thousands and decimals.
pub fn grouped(v: f64, group: char, decimal: char) -> String {
    let text = point(v);
    let (whole, fraction) = text.split_once('.').unwrap();
    let whole = if whole.len() > 3 {
        format!("{}{group}{}", &whole[..whole.len() - 3], &whole[whole.len() - 3..])
    } else {
        whole.to_owned()
    };
    format!("{whole}{decimal}{fraction}")
}

impl Form {
    /// Comma-separated, with decimal points.
    pub fn with(time: fn(usize) -> String) -> Self {
        Self { separator: ",", time, number: point }
    }

    /// Semicolon-separated, with decimal commas.
    pub fn german(time: fn(usize) -> String) -> Self {
        Self { separator: ";", time, number: comma }
    }

    /// Header, and rows of time, OP, PV.
    pub fn table(self, header: &[&str]) -> String {
        let mut text = header.join(self.separator);
        if !header.is_empty() {
            text.push('\n');
        }
        text + &self.rows()
    }

    pub fn rows(self) -> String {
        self.rows_of(0..ROWS)
    }

    pub fn rows_of(self, rows: impl Iterator<Item = usize>) -> String {
        let s = self.separator;
        rows.fold(String::new(), |mut text, k| {
            let _ = writeln!(text, "{}{s}{}{s}{}", (self.time)(k), (self.number)(op(k)), (self.number)(pv(k)));
            text
        })
    }
}

/// A cell of a workbook with one sheet: a number or a text.
pub enum XlsxCell {
    Number(f64),
    /// A number shown as a date.
    Date(f64),
    Text(String),
}

/// A minimal workbook: a zip archive without compression.
pub fn xlsx(rows: &[Vec<XlsxCell>]) -> Vec<u8> {
    workbook(rows, "")
}

/// `properties` goes into `workbook.xml`: Excel says there that days count from 1904.
pub fn workbook(rows: &[Vec<XlsxCell>], properties: &str) -> Vec<u8> {
    let mut sheet =
        String::from(r#"<worksheet xmlns="http://schemas.openxmlformats.org/spreadsheetml/2006/main"><sheetData>"#);
    for (r, row) in rows.iter().enumerate() {
        let _ = write!(sheet, r#"<row r="{}">"#, r + 1);
        for (c, cell) in row.iter().enumerate() {
            let at = format!("{}{}", char::from(b'A' + c as u8), r + 1);
            let _ = match cell {
                XlsxCell::Number(v) => write!(sheet, r#"<c r="{at}"><v>{v}</v></c>"#),
                XlsxCell::Date(v) => write!(sheet, r#"<c r="{at}" s="1"><v>{v}</v></c>"#),
                XlsxCell::Text(t) => write!(sheet, r#"<c r="{at}" t="inlineStr"><is><t>{t}</t></is></c>"#),
            };
        }
        sheet.push_str("</row>");
    }
    sheet.push_str("</sheetData></worksheet>");
    let head = r#"<?xml version="1.0" encoding="UTF-8" standalone="yes"?>"#;
    let main = "http://schemas.openxmlformats.org/spreadsheetml/2006/main";
    let office = "http://schemas.openxmlformats.org/officeDocument/2006/relationships";
    let package = "http://schemas.openxmlformats.org/package/2006";
    let parts = [
        (
            "[Content_Types].xml",
            format!(
                r#"{head}<Types xmlns="{package}/content-types"><Default Extension="rels" ContentType="application/vnd.openxmlformats-package.relationships+xml"/><Default Extension="xml" ContentType="application/xml"/><Override PartName="/xl/workbook.xml" ContentType="application/vnd.openxmlformats-officedocument.spreadsheetml.sheet.main+xml"/></Types>"#
            ),
        ),
        (
            "_rels/.rels",
            format!(
                r#"{head}<Relationships xmlns="{package}/relationships"><Relationship Id="r1" Type="{office}/officeDocument" Target="xl/workbook.xml"/></Relationships>"#
            ),
        ),
        (
            "xl/workbook.xml",
            format!(
                r#"{head}<workbook xmlns="{main}" xmlns:r="{office}">{properties}<sheets><sheet name="Data" sheetId="1" r:id="r1"/></sheets></workbook>"#
            ),
        ),
        (
            "xl/_rels/workbook.xml.rels",
            format!(
                r#"{head}<Relationships xmlns="{package}/relationships"><Relationship Id="r1" Type="{office}/worksheet" Target="worksheets/sheet1.xml"/><Relationship Id="r2" Type="{office}/styles" Target="styles.xml"/></Relationships>"#
            ),
        ),
        (
            "xl/styles.xml",
            format!(
                r#"{head}<styleSheet xmlns="{main}"><fonts><font/></fonts><fills><fill/></fills><borders><border/></borders><cellStyleXfs><xf/></cellStyleXfs><cellXfs><xf numFmtId="0"/><xf numFmtId="22" applyNumberFormat="1"/></cellXfs></styleSheet>"#
            ),
        ),
        ("xl/worksheets/sheet1.xml", format!("{head}{sheet}")),
    ];
    zip(&parts.map(|(name, text)| (name, text.into_bytes())))
}

/// An archive of uncompressed files.
fn zip(files: &[(&str, Vec<u8>)]) -> Vec<u8> {
    let (mut out, mut index) = (Vec::new(), Vec::new());
    for (name, bytes) in files {
        let mut crc = flate2::Crc::new();
        crc.update(bytes);
        let mut entry = Vec::new();
        for half in [20_u16, 0, 0, 0, 0x21] {
            entry.extend(half.to_le_bytes());
        }
        for word in [crc.sum(), bytes.len() as u32, bytes.len() as u32] {
            entry.extend(word.to_le_bytes());
        }
        entry.extend((name.len() as u16).to_le_bytes());
        entry.extend(0_u16.to_le_bytes());
        index.extend(*b"PK\x01\x02");
        index.extend(20_u16.to_le_bytes());
        index.extend(&entry);
        index.extend([0; 10]);
        index.extend((out.len() as u32).to_le_bytes());
        index.extend(name.as_bytes());
        out.extend(*b"PK\x03\x04");
        out.extend(&entry);
        out.extend(name.as_bytes());
        out.extend(bytes);
    }
    let at = out.len() as u32;
    let count = files.len() as u16;
    out.extend(&index);
    out.extend(*b"PK\x05\x06\0\0\0\0");
    out.extend(count.to_le_bytes());
    out.extend(count.to_le_bytes());
    out.extend((index.len() as u32).to_le_bytes());
    out.extend(at.to_le_bytes());
    out.extend([0, 0]);
    out
}

/// The rows, with times as instants or without a zone, in the last column as pandas writes its index.
#[cfg(feature = "parquet")]
pub fn wide(zoned: bool) -> arrow_array::RecordBatch {
    use std::sync::Arc;
    let column = |of: fn(usize) -> f64| -> arrow_array::ArrayRef {
        Arc::new(arrow_array::Float64Array::from_iter_values((0..ROWS).map(of)))
    };
    let times = arrow_array::TimestampMillisecondArray::from_iter_values((0..ROWS).map(|k| t_s(k) * 1000));
    let times = if zoned { times.with_timezone("UTC") } else { times };
    let columns = [("41FIC101.OP", column(op)), ("41FIC101.PV", column(pv)), ("__index_level_0__", Arc::new(times))];
    arrow_array::RecordBatch::try_from_iter(columns).unwrap()
}

#[cfg(feature = "parquet")]
pub fn parquet(batch: &arrow_array::RecordBatch) -> Vec<u8> {
    let mut bytes = Vec::new();
    let mut writer = parquet::arrow::ArrowWriter::try_new(&mut bytes, batch.schema(), None).unwrap();
    writer.write(batch).unwrap();
    writer.close().unwrap();
    bytes
}

#[cfg(feature = "parquet")]
pub fn arrow(batch: &arrow_array::RecordBatch) -> Vec<u8> {
    let mut writer = arrow_ipc::writer::FileWriter::try_new(Vec::new(), &batch.schema()).unwrap();
    writer.write(batch).unwrap();
    writer.finish().unwrap();
    writer.into_inner().unwrap()
}
