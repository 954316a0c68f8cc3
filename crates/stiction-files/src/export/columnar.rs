//! Parquet and Arrow IPC: typed columns, read batch by batch.

use std::io::Cursor;
use std::sync::Arc;

use arrow_array::cast::AsArray as _;
use arrow_array::types::{Float64Type, Int64Type, TimestampNanosecondType};
use arrow_array::{Array, ArrayRef, RecordBatch, RecordBatchReader};
use arrow_schema::{ArrowError, DataType, Field, SchemaRef, TimeUnit};
use bytes::Bytes;
use parquet::arrow::arrow_reader::ParquetRecordBatchReaderBuilder;

use super::cell::{Cell, Rows, Table, Take};
use super::{ExportError, guarded};
use crate::InputKind;
use crate::partition::METADATA_UNIT;

/// Rows per batch.
const BATCH: usize = 8192;

fn fault(error: impl std::fmt::Display) -> ExportError {
    ExportError::at(0, error.to_string(), "export it again, without compression or with zstd, snappy, gzip or lz4")
}

type Batches = Box<dyn Iterator<Item = Result<RecordBatch, ArrowError>>>;

/// The table of a file.
///
/// # Errors
/// The file is damaged, or uses an unsupported feature.
pub(super) fn table(kind: InputKind, bytes: &[u8]) -> Result<Table<'static>, ExportError> {
    let rows = Columns { kind, bytes: bytes.to_vec().into() };
    let (schema, _) = guarded(|| rows.open())?;
    let unit = |field: &Arc<Field>| field.metadata().get(METADATA_UNIT).cloned();
    let units = schema.fields().iter().map(|field| unit(field).unwrap_or_default()).collect();
    let names = schema.fields().iter().map(|f| f.name().clone()).collect();
    let words = vec![if kind == InputKind::Parquet { "Parquet".to_owned() } else { "Arrow IPC".to_owned() }];
    Ok(Table { names, units, words, ..Table::of(Box::new(rows)) })
}

struct Columns {
    kind: InputKind,
    bytes: Bytes,
}

impl Columns {
    fn open(&self) -> Result<(SchemaRef, Batches), ExportError> {
        let source = || Cursor::new(self.bytes.clone());
        if self.kind == InputKind::Parquet {
            let builder = ParquetRecordBatchReaderBuilder::try_new(self.bytes.clone());
            let reader = builder.map_err(fault)?.with_batch_size(BATCH).build().map_err(fault)?;
            return Ok((reader.schema(), Box::new(reader)));
        }
        if self.bytes.starts_with(b"ARROW1") {
            let reader = arrow_ipc::reader::FileReader::try_new(source(), None).map_err(fault)?;
            return Ok((reader.schema(), Box::new(reader)));
        }
        let reader = arrow_ipc::reader::StreamReader::try_new(source(), None).map_err(fault)?;
        Ok((reader.schema(), Box::new(reader)))
    }
}

impl Rows for Columns {
    fn each(&self, take: &mut Take<'_>) -> Result<(), ExportError> {
        let (schema, mut batches) = guarded(|| self.open())?;
        let own = schema.fields().iter().any(|field| field.metadata().contains_key(METADATA_UNIT));
        let mut row = 0;
        while let Some(batch) = guarded(|| batches.next().transpose().map_err(fault))? {
            let columns: Vec<Column> =
                guarded(|| batch.columns().iter().map(Column::of).collect::<Result<_, ExportError>>())?;
            for at in 0..batch.num_rows() {
                row += 1;
                let cells: Vec<Cell<'_>> = columns.iter().map(|c| c.cell(at, own)).collect();
                if !take(row, &cells)? {
                    return Ok(());
                }
            }
        }
        Ok(())
    }
}

/// A column of a type that cells can have.
enum Column {
    Text(ArrayRef),
    Number(ArrayRef),
    Integer(ArrayRef),
    Local(ArrayRef),
    Instant(ArrayRef),
    /// Lists, structures and other types that are not signals.
    Other,
}

impl Column {
    fn of(array: &ArrayRef) -> Result<Self, ExportError> {
        let to = |kind: &DataType| arrow_cast::cast(array, kind).map_err(fault);
        let plain = match array.data_type() {
            DataType::Dictionary(_, values) => values.as_ref(),
            other => other,
        };
        let nanoseconds = |zone| DataType::Timestamp(TimeUnit::Nanosecond, zone);
        Ok(match plain {
            DataType::Timestamp(_, Some(zone)) => Self::Instant(to(&nanoseconds(Some(Arc::clone(zone))))?),
            DataType::Timestamp(_, None) | DataType::Date32 | DataType::Date64 => Self::Local(to(&nanoseconds(None))?),
            DataType::Int8
            | DataType::Int16
            | DataType::Int32
            | DataType::Int64
            | DataType::UInt8
            | DataType::UInt16
            | DataType::UInt32 => Self::Integer(to(&DataType::Int64)?),
            DataType::UInt64
            | DataType::Float16
            | DataType::Float32
            | DataType::Float64
            | DataType::Decimal128(..)
            | DataType::Decimal256(..) => Self::Number(to(&DataType::Float64)?),
            DataType::Utf8 | DataType::LargeUtf8 | DataType::Utf8View | DataType::Boolean => {
                Self::Text(to(&DataType::Utf8)?)
            }
            _ => Self::Other,
        })
    }

    /// `own`: written by this program, whose NaN is a missing value; elsewhere it may be the row of another column.
    fn cell(&self, at: usize, own: bool) -> Cell<'_> {
        let (Self::Text(array)
        | Self::Number(array)
        | Self::Integer(array)
        | Self::Local(array)
        | Self::Instant(array)) = self
        else {
            return Cell::Empty;
        };
        if array.is_null(at) {
            return Cell::Empty;
        }
        match self {
            Self::Text(array) => match array.as_string::<i32>().value(at).trim() {
                "" => Cell::Empty,
                text => Cell::Text(text),
            },
            Self::Number(array) => {
                let value = array.as_primitive::<Float64Type>().value(at);
                match (value.is_finite(), own) {
                    (true, _) => Cell::Number(value),
                    // Missing, and of a column of numbers all the same.
                    (false, true) => Cell::Number(value),
                    (false, false) => Cell::Empty,
                }
            }
            Self::Integer(array) => Cell::Integer(array.as_primitive::<Int64Type>().value(at)),
            Self::Local(array) => Cell::Local(array.as_primitive::<TimestampNanosecondType>().value(at)),
            Self::Instant(array) => Cell::Instant(array.as_primitive::<TimestampNanosecondType>().value(at)),
            Self::Other => Cell::Empty,
        }
    }
}
