//! Reads variables. A variable is read into memory completely (bounded), and each step parses slices of it, so damage gives
//! an error with its place and a damaged length allocates nothing.

use super::{HEADER, MAX_BYTES, MAX_DEPTH, MAX_ITEMS, Mat, MatError, MatOffset, class, kind, order_of, recognise};
use flate2::read::ZlibDecoder;
use std::fs::File;
use std::io::{BufReader, Read, Seek, SeekFrom};
use std::path::Path;

/// Reads the variables whose names `wanted` accepts, in file order; others are skipped.
///
/// # Errors
/// [`MatError`] names the place and the remedy.
pub fn read(path: &Path, wanted: &dyn Fn(&str) -> bool) -> Result<Vec<(String, Mat)>, MatError> {
    read_from(BufReader::with_capacity(1 << 16, File::open(path)?), wanted)
}

/// As [`read`], from any seekable source.
///
/// # Errors
/// [`MatError`] names the place and the remedy.
pub fn read_from(mut source: impl Read + Seek, wanted: &dyn Fn(&str) -> bool) -> Result<Vec<(String, Mat)>, MatError> {
    let length = source.seek(SeekFrom::End(0))?;
    source.rewind()?;
    let mut head = Vec::with_capacity(HEADER);
    source.by_ref().take(HEADER as u64).read_to_end(&mut head)?;
    if !recognise(&head)? {
        return Err(MatError::Foreign("wrong first bytes"));
    }
    let at = |byte| MatOffset { variable: None, byte };
    let Some(big) = order_of(&head) else {
        let left = head.len() as u64;
        return Err(if head.len() < HEADER {
            MatError::Cut { place: at(left), wanted: HEADER as u64 - left, left: 0 }
        } else {
            damaged(at(124), "wrong version or byte order for version 5")
        });
    };
    let mut items = Items(0);
    let mut found = Vec::new();
    let mut start = HEADER as u64;
    while start < length {
        source.seek(SeekFrom::Start(start))?;
        let mut tag = Vec::with_capacity(8);
        source.by_ref().take(8).read_to_end(&mut tag)?;
        let mut bytes = Bytes { data: &tag, at: 0, big, base: start, variable: None };
        let (kind, size) = (bytes.word()?, u64::from(bytes.word()?));
        if !matches!(kind, kind::MATRIX | kind::COMPRESSED) {
            return Err(damaged(at(start), format!("type {kind} where a variable must begin")));
        }
        let left = length - start - 8;
        if size > left {
            return Err(MatError::Cut { place: at(start), wanted: size, left });
        }
        let body = source.by_ref().take(size);
        let one = if kind == kind::COMPRESSED {
            compressed(body, start, big, wanted, &mut items)?
        } else {
            plain(body, start + 8, size, big, wanted, &mut items)?
        };
        found.extend(one);
        start += 8 + size;
    }
    Ok(found)
}

fn damaged(place: MatOffset, what: impl Into<String>) -> MatError {
    MatError::Damaged { place, what: what.into() }
}

/// Bytes for a variable's flags, dimensions and name, with a margin.
const PEEK: u64 = 512;

type NamedVariable = Option<(String, Mat)>;

/// An uncompressed variable.
fn plain(
    mut body: impl Read,
    start: u64,
    size: u64,
    big: bool,
    wanted: &dyn Fn(&str) -> bool,
    items: &mut Items,
) -> Result<NamedVariable, MatError> {
    let mut data = Vec::new();
    body.by_ref().take(PEEK).read_to_end(&mut data)?;
    let peek = Bytes { data: &data, at: 0, big, base: start, variable: None };
    if name_of(peek).is_ok_and(|name| !wanted(&name)) {
        return Ok(None);
    }
    check_size(MatOffset { variable: None, byte: start }, size)?;
    body.read_to_end(&mut data)?;
    matrix(Bytes { data: &data, at: 0, big, base: start, variable: None }, 0, items).map(Some)
}

/// A compressed variable: an element of its own once inflated.
fn compressed(
    body: impl Read,
    start: u64,
    big: bool,
    wanted: &dyn Fn(&str) -> bool,
    items: &mut Items,
) -> Result<NamedVariable, MatError> {
    let mut inflated = ZlibDecoder::new(body);
    let mut data = Vec::new();
    let place = |byte: usize| MatOffset { variable: Some(start), byte: byte as u64 };
    let broken =
        |e: std::io::Error, at: usize| damaged(place(at), format!("cannot be decompressed: {e}; copy the file again"));
    inflated.by_ref().take(8 + PEEK).read_to_end(&mut data).map_err(|e| broken(e, 0))?;
    let mut tag = inside(&data, big, start);
    let (kind, size) = (tag.word()?, u64::from(tag.word()?));
    if kind != kind::MATRIX {
        return Err(damaged(place(0), format!("type {kind} where a variable must begin")));
    }
    if name_of(inside(data.get(8..).unwrap_or_default(), big, start)).is_ok_and(|name| !wanted(&name)) {
        return Ok(None);
    }
    check_size(place(0), size)?;
    let more = (8 + size).saturating_sub(data.len() as u64);
    let before = data.len();
    inflated.take(more).read_to_end(&mut data).map_err(|e| broken(e, before))?;
    let (_, content) = inside(&data, big, start).element()?;
    matrix(content, 0, items).map(Some)
}

/// The inflated bytes of the variable that begins at `start`.
fn inside(data: &[u8], big: bool, start: u64) -> Bytes<'_> {
    Bytes { data, at: 0, big, base: 0, variable: Some(start) }
}

fn check_size(place: MatOffset, size: u64) -> Result<(), MatError> {
    if size > MAX_BYTES {
        return Err(MatError::TooLarge { place, what: "bytes in a variable:", found: size, limit: MAX_BYTES });
    }
    Ok(())
}

/// Counts created values, so that a file cannot use more memory than allowed.
struct Items(u64);

impl Items {
    fn add(&mut self, count: u64, place: MatOffset) -> Result<(), MatError> {
        self.0 = self.0.saturating_add(count);
        if self.0 > MAX_ITEMS {
            return Err(MatError::TooLarge { place, what: "values:", found: self.0, limit: MAX_ITEMS });
        }
        Ok(())
    }
}

/// A range of bytes, read from its start.
#[derive(Clone, Copy)]
struct Bytes<'a> {
    data: &'a [u8],
    at: usize,
    big: bool,
    /// Offset of the first byte.
    base: u64,
    variable: Option<u64>,
}

impl<'a> Bytes<'a> {
    fn place(&self) -> MatOffset {
        MatOffset { variable: self.variable, byte: self.base + self.at as u64 }
    }

    fn left(&self) -> usize {
        self.data.len() - self.at
    }

    fn take(&mut self, count: usize) -> Result<&'a [u8], MatError> {
        let cut = MatError::Cut { place: self.place(), wanted: count as u64, left: self.left() as u64 };
        let end = self.at.checked_add(count).filter(|end| *end <= self.data.len()).ok_or(cut)?;
        let taken = &self.data[self.at..end];
        self.at = end;
        Ok(taken)
    }

    fn word(&mut self) -> Result<u32, MatError> {
        let big = self.big;
        let bytes = self.take(4)?;
        let fold = |value: u32, byte: &u8| (value << 8) | u32::from(*byte);
        Ok(if big { bytes.iter().fold(0, fold) } else { bytes.iter().rev().fold(0, fold) })
    }

    /// The next data element: type and content. Small elements pack type, size and up to four bytes into eight.
    fn element(&mut self) -> Result<(u32, Bytes<'a>), MatError> {
        let first = self.word()?;
        let (kind, size, small) = match first >> 16 {
            0 => (first, self.word()? as usize, false),
            size => (first & 0xffff, size as usize, true),
        };
        if small && size > 4 {
            return Err(damaged(self.place(), format!("small element of {size} bytes; at most 4 are valid")));
        }
        let (base, big, variable) = (self.base + self.at as u64, self.big, self.variable);
        let data = self.take(size)?;
        let padded = if small { 4 } else { size.next_multiple_of(8) };
        self.at = (self.at + padded - size).min(self.data.len());
        Ok((kind, Bytes { data, at: 0, big, base, variable }))
    }

    /// An element of integers.
    fn whole(&mut self) -> Result<Vec<usize>, MatError> {
        let (kind, content) = self.element()?;
        if !matches!(kind, kind::INT32 | kind::UINT32) {
            return Err(damaged(content.place(), format!("type {kind} where integers are expected")));
        }
        let place = content.place();
        let sizes = numbers(kind, content)?.into_iter().map(|v| if v >= 0.0 { Ok(v as usize) } else { Err(v) });
        sizes.collect::<Result<_, _>>().map_err(|v| damaged(place, format!("invalid size {v}")))
    }
}

/// The name of the variable whose content begins here.
fn name_of(mut bytes: Bytes<'_>) -> Result<String, MatError> {
    bytes.element()?;
    bytes.element()?;
    let (_, name) = bytes.element()?;
    Ok(String::from_utf8_lossy(name.data).trim_end_matches('\0').to_owned())
}

/// The content of a matrix element: name and value.
fn matrix(mut bytes: Bytes<'_>, depth: usize, items: &mut Items) -> Result<(String, Mat), MatError> {
    let place = bytes.place();
    items.add(1, place)?;
    if depth > MAX_DEPTH {
        let found = depth as u64;
        return Err(MatError::TooLarge { place, what: "cells within cells:", found, limit: MAX_DEPTH as u64 });
    }
    if bytes.left() == 0 {
        // An empty field or cell.
        return Ok((String::new(), Mat::Numbers { dims: vec![0, 0], values: Vec::new() }));
    }
    let flags = bytes.whole()?;
    let class = *flags.first().ok_or_else(|| damaged(place, "array without a class"))? as u8;
    // Objects of newer classes keep neither dimensions nor name where others do.
    if class > class::UINT64 {
        return Ok((String::new(), Mat::Other("an object or function")));
    }
    let dims = bytes.whole()?;
    let (_, name) = bytes.element()?;
    let name = String::from_utf8_lossy(name.data).trim_end_matches('\0').to_owned();
    let count = dims.iter().try_fold(1_usize, |n, d| n.checked_mul(*d));
    let count = count.ok_or_else(|| damaged(place, "dimensions too large"))?;
    let value = match class {
        class::CELL => cells(&mut bytes, dims, count, depth, items)?,
        class::STRUCT => structure(&mut bytes, count, depth, items)?,
        class::CHAR => text(&mut bytes, &dims, items)?,
        class::DOUBLE..=class::UINT64 => {
            let (kind, content) = bytes.element()?;
            let place = content.place();
            items.add(content.left() as u64 / 8 + 1, place)?;
            let values = numbers(kind, content)?;
            if values.len() != count {
                let what = format!("array of {count} numbers with {} values", values.len());
                return Err(damaged(place, what));
            }
            Mat::Numbers { dims, values }
        }
        class::SPARSE => Mat::Other("a sparse array"),
        _ => Mat::Other("an object"),
    };
    Ok((name, value))
}

/// The next element, which must be a matrix.
fn nested(bytes: &mut Bytes<'_>, depth: usize, items: &mut Items) -> Result<Mat, MatError> {
    let place = bytes.place();
    match bytes.element()? {
        (kind::MATRIX, content) => Ok(matrix(content, depth + 1, items)?.1),
        (kind, _) => Err(damaged(place, format!("type {kind} where an array is expected"))),
    }
}

fn cells(
    bytes: &mut Bytes<'_>,
    dims: Vec<usize>,
    count: usize,
    depth: usize,
    items: &mut Items,
) -> Result<Mat, MatError> {
    let mut held = Vec::new();
    for _ in 0..count {
        held.push(nested(bytes, depth, items)?);
    }
    Ok(Mat::Cell { dims, items: held })
}

fn structure(bytes: &mut Bytes<'_>, count: usize, depth: usize, items: &mut Items) -> Result<Mat, MatError> {
    let place = bytes.place();
    let length = bytes.whole()?.first().copied().filter(|l| *l > 0);
    let length = length.ok_or_else(|| damaged(place, "structure with empty field names"))?;
    let (_, names) = bytes.element()?;
    if count != 1 {
        return Ok(Mat::Other(if count == 0 { "an empty structure" } else { "an array of structures" }));
    }
    let mut fields = Vec::new();
    for name in names.data.chunks_exact(length) {
        let name = name.split(|c| *c == 0).next().unwrap_or_default();
        fields.push((String::from_utf8_lossy(name).into_owned(), nested(bytes, depth, items)?));
    }
    Ok(Mat::Struct(fields))
}

/// Characters as rows.
fn text(bytes: &mut Bytes<'_>, dims: &[usize], items: &mut Items) -> Result<Mat, MatError> {
    let rows = dims.first().copied().unwrap_or(0);
    if bytes.left() == 0 {
        return Ok(Mat::Text(vec![String::new()]));
    }
    let (kind, content) = bytes.element()?;
    items.add(content.left() as u64 / 8 + 1, content.place())?;
    let letters: Vec<char> = match kind {
        kind::UTF8 => String::from_utf8_lossy(content.data).chars().collect(),
        kind::UTF16 | kind::UINT16 | kind::INT16 => {
            let units = numbers(if kind == kind::UTF16 { kind::UINT16 } else { kind }, content)?;
            let units = units.into_iter().map(|u| u as u16);
            char::decode_utf16(units).map(|c| c.unwrap_or(char::REPLACEMENT_CHARACTER)).collect()
        }
        kind => {
            let codes = numbers(if kind == kind::UTF32 { kind::UINT32 } else { kind }, content)?;
            codes.into_iter().map(|c| char::from_u32(c as u32).unwrap_or(char::REPLACEMENT_CHARACTER)).collect()
        }
    };
    let line = |letters: &mut dyn Iterator<Item = char>| {
        let line: String = letters.collect();
        line.trim_end_matches(['\0', ' ']).to_owned()
    };
    if rows <= 1 {
        return Ok(Mat::Text(vec![line(&mut letters.into_iter())]));
    }
    let row = |r: usize| line(&mut letters.iter().skip(r).step_by(rows).copied());
    Ok(Mat::Text((0..rows.min(letters.len())).map(row).collect()))
}

/// The numbers of an element; MATLAB stores integral doubles in smaller types.
fn numbers(kind: u32, content: Bytes<'_>) -> Result<Vec<f64>, MatError> {
    let width = match kind {
        kind::INT8 | kind::UINT8 => 1,
        kind::INT16 | kind::UINT16 => 2,
        kind::INT32 | kind::UINT32 | kind::SINGLE => 4,
        kind::DOUBLE | kind::INT64 | kind::UINT64 => 8,
        _ => return Err(damaged(content.place(), format!("type {kind} is not numeric"))),
    };
    if !content.left().is_multiple_of(width) {
        let what = format!("{} bytes are not a multiple of the value size, {width} bytes", content.left());
        return Err(damaged(content.place(), what));
    }
    let value = |chunk: &[u8]| {
        let fold = |bits: u64, byte: &u8| (bits << 8) | u64::from(*byte);
        let bits = if content.big { chunk.iter().fold(0, fold) } else { chunk.iter().rev().fold(0, fold) };
        match kind {
            kind::INT8 => f64::from(bits as u8 as i8),
            kind::INT16 => f64::from(bits as u16 as i16),
            kind::INT32 => f64::from(bits as u32 as i32),
            kind::SINGLE => f64::from(f32::from_bits(bits as u32)),
            kind::DOUBLE => f64::from_bits(bits),
            kind::INT64 => bits as i64 as f64,
            _ => bits as f64,
        }
    };
    Ok(content.data.chunks_exact(width).map(value).collect())
}
