//! Reads and writes variables of MATLAB files of version 5 (`save -v6` and `save -v7`).
//!
//! Based on MathWorks' "MAT-File Format" (level 5). Reads both byte orders, compressed or not, numbers of every class,
//! characters, cells, structures, nested to a limit. Bytes, items and depth are bounded; a fault names its byte. No crate
//! reads structures and cells of both byte orders and survives damaged files.

mod read;
mod write;

pub use read::{read, read_from};
pub use write::write;

use std::io;
use thiserror::Error;

/// Largest variable read, decompressed bytes. A year of one loop at 1 s takes 0.5 GB.
pub const MAX_BYTES: u64 = 512 << 20;
/// Deepest nesting of cells and structures; the compact store has five levels.
pub const MAX_DEPTH: usize = 16;
/// Most values (numbers, texts, cells, structures) in one file.
pub const MAX_ITEMS: u64 = 64 << 20;
/// Bytes before the first variable.
const HEADER: usize = 128;

/// Types of data elements.
mod kind {
    pub const INT8: u32 = 1;
    pub const UINT8: u32 = 2;
    pub const INT16: u32 = 3;
    pub const UINT16: u32 = 4;
    pub const INT32: u32 = 5;
    pub const UINT32: u32 = 6;
    pub const SINGLE: u32 = 7;
    pub const DOUBLE: u32 = 9;
    pub const INT64: u32 = 12;
    pub const UINT64: u32 = 13;
    pub const MATRIX: u32 = 14;
    pub const COMPRESSED: u32 = 15;
    pub const UTF8: u32 = 16;
    pub const UTF16: u32 = 17;
    pub const UTF32: u32 = 18;
}

/// Classes of arrays.
mod class {
    pub const CELL: u8 = 1;
    pub const STRUCT: u8 = 2;
    pub const CHAR: u8 = 4;
    pub const SPARSE: u8 = 5;
    pub const DOUBLE: u8 = 6;
    pub const UINT64: u8 = 15;
}

/// A variable, cell or field. Dimensions are MATLAB's; values are in column order.
#[derive(Debug, Clone, PartialEq)]
pub enum Mat {
    /// Numbers of any class, real parts.
    Numbers {
        /// Rows, columns and so on.
        dims: Vec<usize>,
        /// Product of `dims` values.
        values: Vec<f64>,
    },
    /// Rows of characters.
    Text(Vec<String>),
    /// Cells.
    Cell {
        /// Rows, columns and so on.
        dims: Vec<usize>,
        /// Product of `dims` cells.
        items: Vec<Mat>,
    },
    /// A single structure; arrays of structures are [`Mat::Other`].
    Struct(Vec<(String, Mat)>),
    /// An unsupported type, by name.
    Other(&'static str),
}

impl Mat {
    /// One number.
    #[must_use]
    pub fn number(value: f64) -> Self {
        Self::Numbers { dims: vec![1, 1], values: vec![value] }
    }

    /// One line of text.
    #[must_use]
    pub fn text(line: impl Into<String>) -> Self {
        Self::Text(vec![line.into()])
    }

    /// A column of cells.
    #[must_use]
    pub fn column(items: Vec<Self>) -> Self {
        Self::Cell { dims: vec![items.len(), 1], items }
    }

    /// A field of a structure.
    #[must_use]
    pub fn field(&self, name: &str) -> Option<&Self> {
        let Self::Struct(fields) = self else { return None };
        fields.iter().find(|(n, _)| n == name).map(|(_, value)| value)
    }

    /// Description in words.
    #[must_use]
    pub fn describe(&self) -> String {
        let size = |dims: &[usize]| dims.iter().map(ToString::to_string).collect::<Vec<_>>().join(" x ");
        match self {
            Self::Numbers { dims, .. } => format!("{} numbers", size(dims)),
            Self::Text(rows) => format!("{} rows of text", rows.len()),
            Self::Cell { dims, .. } => format!("{} cells", size(dims)),
            Self::Struct(fields) => format!("a structure of {} fields", fields.len()),
            Self::Other(what) => (*what).to_owned(),
        }
    }
}

/// A MATLAB file that cannot be read or written.
#[derive(Debug, Error)]
pub enum MatError {
    /// The system refuses.
    #[error(transparent)]
    Io(#[from] io::Error),
    /// Another version of the format.
    #[error("unsupported MATLAB file version {version}; load it in MATLAB and save it with save -v7")]
    Version {
        /// As MATLAB counts them.
        version: &'static str,
    },
    /// Not a MATLAB file.
    #[error("not a MATLAB file: {0}")]
    Foreign(&'static str),
    /// The file ends too early.
    #[error("{place}: the file ends here, {wanted} more bytes expected and {left} left; copy it again")]
    Cut {
        /// Where.
        place: MatOffset,
        /// Bytes announced.
        wanted: u64,
        /// Bytes there.
        left: u64,
    },
    /// An invalid item.
    #[error("{place}: {what}")]
    Damaged {
        /// Where.
        place: MatOffset,
        /// What is wrong.
        what: String,
    },
    /// Beyond a limit.
    #[error("{place}: {what} {found}, limit {limit}; split the file")]
    TooLarge {
        /// Where.
        place: MatOffset,
        /// What is limited.
        what: &'static str,
        /// Number found.
        found: u64,
        /// Largest number allowed.
        limit: u64,
    },
}

/// A place in a file.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct MatOffset {
    /// Byte offset at which a compressed variable begins, if the fault is inside one.
    pub variable: Option<u64>,
    /// Byte offset in the file, or in the decompressed variable.
    pub byte: u64,
}

impl core::fmt::Display for MatOffset {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        match self.variable {
            Some(start) => write!(f, "byte {} of the variable compressed at byte {start}", self.byte),
            None => write!(f, "byte {}", self.byte),
        }
    }
}

/// Whether a file begins as a MATLAB file, and if so, whether its version is supported.
///
/// # Errors
/// [`MatError::Version`] for versions 4 and 7.3.
pub fn recognise(head: &[u8]) -> Result<bool, MatError> {
    if head.starts_with(b"MATLAB 7.3") || head.starts_with(b"\x89HDF\r\n\x1a\n") {
        return Err(MatError::Version { version: "7.3 (HDF5)" });
    }
    if order_of(head).is_some() || head.starts_with(b"MATLAB 5.0") {
        return Ok(true);
    }
    if is_version_4(head) { Err(MatError::Version { version: "4" }) } else { Ok(false) }
}

/// Byte order of a version 5 file: true for big-endian.
fn order_of(head: &[u8]) -> Option<bool> {
    match head.get(124..HEADER)? {
        [0, 1, b'I', b'M'] => Some(false),
        [1, 0, b'M', b'I'] => Some(true),
        _ => None,
    }
}

/// Version 4 has no mark: five integers of narrow ranges, then the first variable's name.
fn is_version_4(head: &[u8]) -> bool {
    let word = |at: usize, big: bool| -> Option<u32> {
        let bytes: [u8; 4] = head.get(at..at + 4)?.try_into().ok()?;
        Some(if big { u32::from_be_bytes(bytes) } else { u32::from_le_bytes(bytes) })
    };
    [false, true].into_iter().any(|big| {
        let fields: Option<Vec<u32>> = (0..5).map(|k| word(4 * k, big)).collect();
        let Some(&[mopt, rows, columns, imaginary, name_length]) = fields.as_deref() else { return false };
        let [machine, zero, precision, form] = [mopt / 1000, mopt / 100 % 10, mopt / 10 % 10, mopt % 10];
        let name = head.get(20..20 + (name_length as usize).min(64)).unwrap_or_default();
        let named = name.split_last().is_some_and(|(last, rest)| {
            *last == 0 && !rest.is_empty() && rest.iter().all(|c| c.is_ascii_alphanumeric() || *c == b'_')
        });
        let sizes = u64::from(rows) * u64::from(columns) < 1 << 40;
        machine <= 4
            && zero == 0
            && precision <= 5
            && form <= 2
            && imaginary <= 1
            && name_length <= 64
            && named
            && sizes
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;
    use std::io::Cursor;

    fn read_all(bytes: &[u8]) -> Result<Vec<(String, Mat)>, MatError> {
        read_from(Cursor::new(bytes), &|_| true)
    }

    fn nested() -> Mat {
        let numbers = Mat::Numbers { dims: vec![2, 3], values: vec![1.0, -0.0, 1e300, 0.1, 5.0, 6.0] };
        let rows = Mat::Text(vec!["ab".into(), "Öl €".into()]);
        let empty = Mat::Numbers { dims: vec![0, 0], values: Vec::new() };
        Mat::Struct(vec![
            ("a".into(), Mat::column(vec![numbers, rows, empty])),
            ("b_2".into(), Mat::Struct(vec![("c".into(), Mat::text("µ"))])),
        ])
    }

    #[test]
    fn what_is_written_reads_back_equal() {
        let one = Mat::number(7.0);
        for deflated in [false, true] {
            let mut bytes = Vec::new();
            write(&mut bytes, &[("n", &one), ("s", &nested())], deflated).unwrap();
            let all = read_all(&bytes).unwrap();
            assert_eq!(all, [("n".to_owned(), Mat::number(7.0)), ("s".to_owned(), nested())]);
            let some = read_from(Cursor::new(&bytes), &|name| name == "n").unwrap();
            assert_eq!(some.len(), 1);
        }
    }

    /// A file with the greatest byte first: a row of small integers, and letters of 16 bits.
    fn big_endian() -> Vec<u8> {
        let mut out = vec![b' '; 116];
        out.extend([0; 8]);
        out.extend([1, 0, b'M', b'I']);
        let array = |class: u8, columns: u8, name: u8, content: &[u8]| {
            let mut a = vec![0, 0, 0, 6, 0, 0, 0, 8, 0, 0, 0, class, 0, 0, 0, 0];
            a.extend([0, 0, 0, 5, 0, 0, 0, 8, 0, 0, 0, 1, 0, 0, 0, columns]);
            a.extend([0, 1, 0, 1, name, 0, 0, 0]);
            a.extend(content);
            let mut framed = vec![0, 0, 0, 14, 0, 0, 0, a.len() as u8];
            framed.extend(a);
            framed
        };
        out.extend(array(6, 3, b'x', &[0, 3, 0, 1, 255, 0, 0, 0]).iter());
        let at = out.len() - 8;
        // Three bytes in a small element: 255, 2, 3.
        out[at..].copy_from_slice(&[0, 3, 0, 2, 255, 2, 3, 0]);
        out.extend(array(4, 2, b'y', &[0, 4, 0, 17, 0, 0xd6, 0, b'l']));
        out
    }

    #[test]
    fn the_greatest_byte_may_come_first() {
        let all = read_all(&big_endian()).unwrap();
        assert_eq!(all[0].1, Mat::Numbers { dims: vec![1, 3], values: vec![255.0, 2.0, 3.0] });
        assert_eq!(all[1], ("y".to_owned(), Mat::text("Öl")));
    }

    #[test]
    fn other_versions_and_foreign_files_are_named() {
        let mut four = vec![0; 20];
        for (at, v) in [(4, 3_u8), (8, 2), (16, 2)] {
            four[at] = v;
        }
        four.extend(b"x\0");
        assert!(recognise(&four).unwrap_err().to_string().contains("version 4"));
        assert!(recognise(&four).unwrap_err().to_string().contains("save -v7"));
        assert!(recognise(b"MATLAB 7.3 MAT-file").unwrap_err().to_string().contains("7.3"));
        assert!(recognise(b"\x89HDF\r\n\x1a\n").unwrap_err().to_string().contains("HDF5"));
        for other in [&b"t,op,pv\n"[..], b"", &[0; 200], b"\x89MCAP0\r\n"] {
            assert!(!recognise(other).unwrap(), "{other:?}");
        }
    }

    #[test]
    fn faults_name_their_byte() {
        let mut bytes = Vec::new();
        write(&mut bytes, &[("s", &nested())], false).unwrap();
        for (at, part) in [(60, "byte"), (127, "byte"), (200, "byte 128"), (bytes.len() - 1, "byte 128")] {
            let error = read_all(&bytes[..at]).unwrap_err().to_string();
            assert!(error.contains(part), "cut at {at}: {error}");
        }
        let mut long = bytes[..128].to_vec();
        long.resize(4096, 0);
        assert!(read_all(&long).unwrap_err().to_string().contains("byte 128: type 0"));
        // A variable that announces 4 GB.
        long[128..136].copy_from_slice(&[14, 0, 0, 0, 255, 255, 255, 255]);
        assert!(read_all(&long).unwrap_err().to_string().contains("4294967295 more bytes"));
    }

    #[test]
    fn depth_and_size_have_limits() {
        let mut deep = Mat::number(1.0);
        for _ in 0..200 {
            deep = Mat::column(vec![deep]);
        }
        let mut bytes = Vec::new();
        write(&mut bytes, &[("deep", &deep)], true).unwrap();
        assert!(read_all(&bytes).unwrap_err().to_string().contains("cells within cells"));
        // Some kilobytes that inflate to a gigabyte.
        let mut bomb = bytes[..128].to_vec();
        let mut packed = flate2::write::ZlibEncoder::new(Vec::new(), flate2::Compression::best());
        std::io::Write::write_all(&mut packed, &[14, 0, 0, 0, 0, 0, 0, 64]).unwrap();
        for _ in 0..1024 {
            std::io::Write::write_all(&mut packed, &[0; 1024]).unwrap();
        }
        let packed = packed.finish().unwrap();
        bomb.extend([15, 0, 0, 0]);
        bomb.extend((packed.len() as u32).to_le_bytes());
        bomb.extend(packed);
        assert!(read_all(&bomb).unwrap_err().to_string().contains("limit 536870912"));
    }

    fn any_mat() -> impl Strategy<Value = Mat> {
        let leaf = prop_oneof![
            proptest::collection::vec(-1e9..1e9_f64, 0..6)
                .prop_map(|values| Mat::Numbers { dims: vec![values.len(), 1], values }),
            "[a-zA-ZäÖ€ ]{0,8}[a-z]".prop_map(Mat::text),
        ];
        leaf.prop_recursive(3, 24, 4, |inner| {
            prop_oneof![
                proptest::collection::vec(inner.clone(), 0..4).prop_map(Mat::column),
                proptest::collection::vec(("[a-z_]{1,9}", inner), 0..4).prop_map(Mat::Struct),
            ]
        })
    }

    proptest! {
        #[test]
        fn any_value_survives(value in any_mat(), deflated in any::<bool>()) {
            let mut bytes = Vec::new();
            write(&mut bytes, &[("v", &value)], deflated).unwrap();
            prop_assert_eq!(&read_all(&bytes).unwrap()[0].1, &value);
        }

        #[test]
        fn no_damage_panics(
            flips in proptest::collection::vec((0_usize..4096, any::<u8>()), 0..6),
            cut in 0_usize..4096,
            deflated in any::<bool>(),
            big in any::<bool>()
        ) {
            let mut bytes = Vec::new();
            if big {
                bytes = big_endian();
            } else {
                write(&mut bytes, &[("n", &Mat::number(7.0)), ("s", &nested())], deflated).unwrap();
            }
            let length = bytes.len();
            for (at, byte) in flips {
                bytes[at % length] = byte;
            }
            bytes.truncate(length - cut % length / 4);
            let _ = read_all(&bytes);
        }
    }
}
