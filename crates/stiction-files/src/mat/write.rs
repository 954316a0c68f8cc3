//! Writes variables as MATLAB's `save -v7` (compressed) or `-v6` (plain), little-endian.

use super::{Mat, class, kind};
use flate2::Compression;
use flate2::write::ZlibEncoder;
use std::io::{self, Write};

/// Length of a field name including the end mark, as in MATLAB.
const NAME_LENGTH: usize = 64;

/// Writes a file of variables.
///
/// # Errors
/// Error of the system; [`io::ErrorKind::InvalidInput`] if a name or value cannot be represented.
pub fn write(out: &mut impl Write, variables: &[(&str, &Mat)], deflated: bool) -> io::Result<()> {
    let mut text = format!("MATLAB 5.0 MAT-file, written by stictiond {}", stiction::core::VERSION).into_bytes();
    text.resize(116, b' ');
    text.extend([0; 8]);
    text.extend([0, 1, b'I', b'M']);
    out.write_all(&text)?;
    for (name, value) in variables {
        let mut plain = Vec::new();
        matrix(&mut plain, name, value)?;
        if deflated {
            let mut encoder = ZlibEncoder::new(Vec::new(), Compression::default());
            encoder.write_all(&plain)?;
            let packed = encoder.finish()?;
            // Deflated variables are the only elements that are not padded.
            out.write_all(&tag(kind::COMPRESSED, packed.len())?)?;
            out.write_all(&packed)?;
        } else {
            out.write_all(&plain)?;
        }
    }
    Ok(())
}

fn refused(what: impl Into<String>) -> io::Error {
    io::Error::new(io::ErrorKind::InvalidInput, what.into())
}

fn tag(kind: u32, size: usize) -> io::Result<[u8; 8]> {
    let size = u32::try_from(size).map_err(|_| refused("a variable of over 4 GB; split it"))?;
    let mut out = [0; 8];
    out[..4].copy_from_slice(&kind.to_le_bytes());
    out[4..].copy_from_slice(&size.to_le_bytes());
    Ok(out)
}

fn element(out: &mut Vec<u8>, kind: u32, content: &[u8]) -> io::Result<()> {
    out.extend(tag(kind, content.len())?);
    out.extend(content);
    out.resize(out.len().next_multiple_of(8), 0);
    Ok(())
}

fn whole(values: &[usize]) -> io::Result<Vec<u8>> {
    let size = |v: &usize| i32::try_from(*v).map_err(|_| refused(format!("an array of {v} rows; split it")));
    Ok(values.iter().map(size).collect::<io::Result<Vec<i32>>>()?.iter().flat_map(|v| v.to_le_bytes()).collect())
}

/// A matrix element with its tag.
fn matrix(out: &mut Vec<u8>, name: &str, value: &Mat) -> io::Result<()> {
    let start = out.len();
    out.extend([0; 8]);
    let (class, dims) = match value {
        Mat::Numbers { dims, .. } => (class::DOUBLE, dims.clone()),
        Mat::Text(rows) => (class::CHAR, vec![rows.len(), width(rows)]),
        Mat::Cell { dims, .. } => (class::CELL, dims.clone()),
        Mat::Struct(_) => (class::STRUCT, vec![1, 1]),
        Mat::Other(what) => return Err(refused(format!("{what} cannot be written"))),
    };
    let flags = [u32::from(class), 0];
    element(out, kind::UINT32, &flags.map(u32::to_le_bytes).concat())?;
    element(out, kind::INT32, &whole(&dims)?)?;
    element(out, kind::INT8, name.as_bytes())?;
    match value {
        Mat::Numbers { values, .. } => {
            element(out, kind::DOUBLE, &values.iter().flat_map(|v| v.to_le_bytes()).collect::<Vec<u8>>())?;
        }
        Mat::Text(rows) => element(out, kind::UTF8, columns_of(rows).as_bytes())?,
        Mat::Cell { items, .. } => {
            for item in items {
                matrix(out, "", item)?;
            }
        }
        Mat::Struct(fields) => structure(out, fields)?,
        Mat::Other(_) => {}
    }
    let size = out.len() - start - 8;
    out[start..start + 8].copy_from_slice(&tag(kind::MATRIX, size)?);
    Ok(())
}

fn structure(out: &mut Vec<u8>, fields: &[(String, Mat)]) -> io::Result<()> {
    // The length of names is a small element: type and size in one word.
    out.extend((kind::INT32 | (4 << 16)).to_le_bytes());
    out.extend((NAME_LENGTH as u32).to_le_bytes());
    let mut names = Vec::with_capacity(NAME_LENGTH * fields.len());
    for (name, _) in fields {
        let fits =
            (1..NAME_LENGTH).contains(&name.len()) && name.bytes().all(|c| c.is_ascii_alphanumeric() || c == b'_');
        if !fits {
            return Err(refused(format!("{name:?} is not a valid field name")));
        }
        names.extend(name.bytes());
        names.resize(names.len().next_multiple_of(NAME_LENGTH), 0);
    }
    element(out, kind::INT8, &names)?;
    fields.iter().try_for_each(|(_, value)| matrix(out, "", value))
}

/// Letters in the longest row.
fn width(rows: &[String]) -> usize {
    rows.iter().map(|r| r.chars().count()).max().unwrap_or(0)
}

/// Rows of characters as stored: by columns, short rows padded with blanks.
fn columns_of(rows: &[String]) -> String {
    if let [one] = rows {
        return one.clone();
    }
    let letters: Vec<Vec<char>> = rows.iter().map(|r| r.chars().collect()).collect();
    let at = |column: usize| letters.iter().map(move |row| row.get(column).copied().unwrap_or(' '));
    (0..width(rows)).flat_map(at).collect()
}
