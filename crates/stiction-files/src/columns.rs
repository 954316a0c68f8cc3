//! Raw samples of many loops in one message, stored column by column: what `[recording] raw = "columns"` writes. [`LAYOUT`]
//! is the complete format, and is in every such file as its schema.

use stiction::core::record::{Mode, Value};
use stiction_engine::codec::topic;
use thiserror::Error;

/// Name of the schema.
pub const SCHEMA: &str = "stictiond.columns.v1";
/// Encoding of the schema: plain text.
pub const SCHEMA_ENCODING: &str = "x-text";
/// Encoding of the messages.
pub const ENCODING: &str = "x-stictiond-columns";
/// Metadata key of a recording with raw samples in columns, and its value.
pub const METADATA_RAW: &str = "raw";
/// See [`METADATA_RAW`].
pub const METADATA_COLUMNS: &str = "columns";
/// Last part of the topic; no loop name begins like this.
const CHUNK: &str = "@columns";

/// The format in words.
pub const LAYOUT: &str = "Samples of many channels in the order in which they came. All numbers are little-endian.\n\
    Head, 32 bytes, four int64: source time of the first sample, ns since 1970; unit of the column t, ns; arrival of the \
    first sample, ns since 1970; unit of the column arrival, ns.\n\
    Then n rows of 31 bytes, transposed: first byte 0 of every row, then byte 1 of every row, and so on. A row is\n\
    channel uint16, t int64, arrival int64, value float64, quality uint32, form uint8.\n\
    channel, t and arrival are differences to the row before (channel to 0 in the first row), which wrap around: sum them \
    up, then multiply t and arrival by their units and add the first time.\n\
    channel is the id of the file's channel record with the topic of the signal.\n\
    form, lowest 7 bits: 0 a number, 1 a missing value, 2 auto, 3 manual, 4 cascade, 5 unknown mode; bit 7: quality was sent.\n";

/// Bytes before the rows.
const HEAD: usize = 32;
/// Offsets of the parts of a row.
pub const ROW: usize = 31;
/// Where in a row its parts begin.
const T: usize = 2;
const ARRIVAL: usize = 10;
const VALUE: usize = 18;
const QUALITY: usize = 26;
const FORM: usize = 30;
/// Set in `form` if a quality was sent.
const HAS_QUALITY: u8 = 0x80;
/// Modes by their form, which counts from 2.
const MODES: [Mode; 4] = [Mode::Auto, Mode::Manual, Mode::Cascade, Mode::Unknown];
/// Rows after which a message is closed, and most rows that one may have.
pub const ROWS: usize = 16_384;
const MOST_ROWS: usize = 65_536;
/// Arrival times are kept to the millisecond; nothing is computed from them.
const ARRIVAL_NS: i64 = 1_000_000;

/// One sample of one channel.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Row {
    /// Channel number in the file.
    pub channel: u16,
    /// Source time, ns since 1970.
    pub t_ns: i64,
    /// Arrival time, ns since 1970.
    pub arrival_ns: i64,
    /// The value.
    pub value: Value,
    /// Quality code, if one was sent.
    pub quality: Option<u32>,
}

/// A message that contradicts its encoding.
#[derive(Debug, Clone, PartialEq, Eq, Error)]
pub enum ColumnsError {
    /// Incomplete head or rows, or too many of them.
    #[error("{0} bytes are not a head of {HEAD} bytes and 1 to {MOST_ROWS} rows of {ROW} bytes")]
    Length(usize),
    /// An undefined form.
    #[error("row {0} has the undefined form {1}")]
    Form(usize, u8),
}

/// The topic of the messages below a prefix.
#[must_use]
pub fn topic_of(prefix: &str) -> String {
    topic::plane(prefix, CHUNK)
}

/// Rows of a message under construction.
#[derive(Debug, Default)]
pub struct Columns {
    rows: Vec<Row>,
}

impl Columns {
    /// Whether there are no rows.
    #[must_use]
    pub const fn is_empty(&self) -> bool {
        self.rows.is_empty()
    }

    /// Whether the message should be written.
    #[must_use]
    pub const fn is_full(&self) -> bool {
        self.rows.len() >= ROWS
    }

    /// Adds a row; a number that is not finite counts as missing.
    pub fn push(&mut self, row: Row) {
        let value = row.value.as_number().map_or(row.value, Value::number);
        self.rows.push(Row {
            arrival_ns: row.arrival_ns.div_euclid(ARRIVAL_NS).saturating_mul(ARRIVAL_NS),
            value,
            ..row
        });
    }

    /// First arrival and first source time, ns; `None` if there are no rows.
    #[must_use]
    pub fn times_ns(&self) -> Option<[i64; 2]> {
        self.rows.first().map(|row| [row.arrival_ns, row.t_ns])
    }

    /// Writes all rows as one message and clears them.
    #[must_use]
    pub fn take(&mut self) -> Vec<u8> {
        let rows = std::mem::take(&mut self.rows);
        let bytes = encode(&rows);
        // Its room serves the next ones.
        self.rows = rows;
        self.rows.clear();
        bytes
    }
}

/// A column of times as differences in a common unit: first time, unit, differences.
fn differences(times: impl Iterator<Item = i64> + Clone) -> (i64, i64, Vec<i64>) {
    let first = times.clone().next().unwrap_or(0);
    let pairs = std::iter::once(first).chain(times.clone()).zip(times);
    let exact: Option<Vec<i64>> = pairs.clone().map(|(before, t)| t.checked_sub(before)).collect();
    let Some(steps) = exact else {
        return (first, 1, pairs.map(|(before, t)| t.wrapping_sub(before)).collect());
    };
    let unit = steps.iter().fold(0, |unit, step| greatest_divisor(unit, step.unsigned_abs()));
    let unit = i64::try_from(unit).unwrap_or(1).max(1);
    (first, unit, steps.into_iter().map(|step| step / unit).collect())
}

const fn greatest_divisor(mut a: u64, mut b: u64) -> u64 {
    while b != 0 {
        (a, b) = (b, a % b);
    }
    a
}

fn encode(rows: &[Row]) -> Vec<u8> {
    let n = rows.len();
    let (t_ns, t_unit, t) = differences(rows.iter().map(|row| row.t_ns));
    let (arrival_ns, arrival_unit, arrival) = differences(rows.iter().map(|row| row.arrival_ns));
    let mut out = vec![0; HEAD + n * ROW];
    for (place, number) in out.chunks_exact_mut(8).zip([t_ns, t_unit, arrival_ns, arrival_unit]) {
        place.copy_from_slice(&number.to_le_bytes());
    }
    let mut before = 0;
    for (at, row) in rows.iter().enumerate() {
        let (form, bits) = match row.value {
            Value::Number(number) => (0, number.to_bits()),
            Value::Missing => (1, 0),
            Value::Mode(mode) => (2 + MODES.iter().position(|m| *m == mode).unwrap_or(MODES.len() - 1) as u8, 0),
        };
        let mut bytes = [0; ROW];
        bytes[..T].copy_from_slice(&row.channel.wrapping_sub(before).to_le_bytes());
        bytes[T..ARRIVAL].copy_from_slice(&t[at].to_le_bytes());
        bytes[ARRIVAL..VALUE].copy_from_slice(&arrival[at].to_le_bytes());
        bytes[VALUE..QUALITY].copy_from_slice(&bits.to_le_bytes());
        bytes[QUALITY..FORM].copy_from_slice(&row.quality.unwrap_or(0).to_le_bytes());
        bytes[FORM] = form | if row.quality.is_some() { HAS_QUALITY } else { 0 };
        before = row.channel;
        for (plane, byte) in bytes.into_iter().enumerate() {
            out[HEAD + plane * n + at] = byte;
        }
    }
    out
}

/// Reads a message's rows in order.
///
/// # Errors
/// [`ColumnsError`]; `rows` is then empty.
pub fn decode(data: &[u8], rows: &mut Vec<Row>) -> Result<(), ColumnsError> {
    rows.clear();
    let length = || ColumnsError::Length(data.len());
    let (head, planes) = data.split_at_checked(HEAD).ok_or_else(length)?;
    let n = planes.len() / ROW;
    if n * ROW != planes.len() || !(1..=MOST_ROWS).contains(&n) {
        return Err(length());
    }
    let number = |k: usize| i64::from_le_bytes(std::array::from_fn(|b| head[8 * k + b]));
    let [mut t_ns, t_unit, mut arrival_ns, arrival_unit] = std::array::from_fn(number);
    let word = |at: usize, from: usize| u64::from_le_bytes(std::array::from_fn(|b| planes[(from + b) * n + at]));
    let mut channel = 0_u16;
    rows.reserve(n);
    for at in 0..n {
        channel = channel.wrapping_add(u16::from_le_bytes([planes[at], planes[n + at]]));
        t_ns = t_ns.wrapping_add(word(at, T).cast_signed().wrapping_mul(t_unit));
        arrival_ns = arrival_ns.wrapping_add(word(at, ARRIVAL).cast_signed().wrapping_mul(arrival_unit));
        let form = planes[FORM * n + at];
        let value = match form & !HAS_QUALITY {
            0 => Value::number(f64::from_bits(word(at, VALUE))),
            1 => Value::Missing,
            mode => match MODES.get(usize::from(mode) - 2) {
                Some(mode) => Value::Mode(*mode),
                None => {
                    rows.clear();
                    return Err(ColumnsError::Form(at, form));
                }
            },
        };
        let quality = u32::from_le_bytes(std::array::from_fn(|b| planes[(QUALITY + b) * n + at]));
        let quality = (form & HAS_QUALITY != 0).then_some(quality);
        rows.push(Row { channel, t_ns, arrival_ns, value, quality });
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn value() -> impl Strategy<Value = Value> {
        prop_oneof![
            any::<u64>().prop_map(|bits| Value::number(f64::from_bits(bits))),
            Just(Value::Missing),
            (0..MODES.len()).prop_map(|k| Value::Mode(MODES[k])),
        ]
    }

    fn row() -> impl Strategy<Value = Row> {
        let t_ns = prop_oneof![any::<i64>(), (0..1000_i64).prop_map(|s| 1_700_000_000_000_000_000 + s * 250_000_000)];
        (any::<u16>(), t_ns, 0..1_i64 << 40, value(), any::<Option<u32>>()).prop_map(
            |(channel, t_ns, ms, value, quality)| Row { channel, t_ns, arrival_ns: ms * 1_000_000, value, quality },
        )
    }

    fn packed(rows: &[Row]) -> Vec<u8> {
        let mut columns = Columns::default();
        rows.iter().for_each(|row| columns.push(*row));
        let bytes = columns.take();
        assert!(columns.is_empty());
        bytes
    }

    proptest! {
        #[test]
        fn rows_read_back_equal_to_the_last_bit_and_in_their_order(rows in prop::collection::vec(row(), 1..60)) {
            let bytes = packed(&rows);
            prop_assert_eq!(bytes.len(), HEAD + rows.len() * ROW);
            let mut back = Vec::new();
            decode(&bytes, &mut back).unwrap();
            prop_assert_eq!(&back, &rows);
            for (a, b) in back.iter().zip(&rows) {
                prop_assert_eq!(a.value.as_number().map(f64::to_bits), b.value.as_number().map(f64::to_bits));
            }
        }

        #[test]
        fn any_bytes_are_answered(bytes in prop::collection::vec(any::<u8>(), 0..400)) {
            let mut rows = Vec::new();
            match decode(&bytes, &mut rows) {
                Ok(()) => prop_assert_eq!(rows.len() * ROW + HEAD, bytes.len()),
                Err(_) => prop_assert!(rows.is_empty()),
            }
        }
    }

    #[test]
    fn even_times_become_small_numbers_and_what_cannot_be_is_refused() {
        let at = |k: i64| Row {
            channel: 7 + k as u16,
            t_ns: 10_000_000_000 * k,
            arrival_ns: 1_234_567_890 + 1_000_000 * k,
            value: Value::Number(k as f64),
            quality: None,
        };
        let rows: Vec<Row> = (0..100).map(at).collect();
        let bytes = packed(&rows);
        assert_eq!(bytes[8..16], 10_000_000_000_i64.to_le_bytes());
        // The lowest byte of each difference: nothing, then one unit a row.
        assert_eq!(bytes[HEAD + T * 100], 0);
        assert!(bytes[HEAD + T * 100 + 1..HEAD + (T + 1) * 100].iter().all(|b| *b == 1));
        let mut back = Vec::new();
        decode(&bytes, &mut back).unwrap();
        assert_eq!(back[0].arrival_ns, 1_234_000_000, "to the millisecond");
        assert_eq!(decode(&bytes[..bytes.len() - 1], &mut back), Err(ColumnsError::Length(bytes.len() - 1)));
        assert!(back.is_empty() && decode(&bytes[..HEAD], &mut back).is_err() && decode(b"", &mut back).is_err());
        let mut wrong = bytes;
        let last = wrong.len() - 1;
        wrong[last] = 6;
        assert_eq!(decode(&wrong, &mut back), Err(ColumnsError::Form(99, 6)));
        assert_eq!(decode(&vec![0; HEAD + (MOST_ROWS + 1) * ROW], &mut back).ok(), None);
    }
}
