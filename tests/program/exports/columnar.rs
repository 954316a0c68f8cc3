//! Shapes of Parquet and Arrow files.

use super::shapes::Shape;

#[cfg(not(feature = "parquet"))]
pub fn columnar() -> Vec<Shape> {
    Vec::new()
}

#[cfg(feature = "parquet")]
pub fn columnar() -> Vec<Shape> {
    use std::sync::Arc;

    use super::data::{ROWS, arrow, op, parquet, pv, t_s, wide};
    use super::shapes::Must::{Ask, Read};
    use super::shapes::UTC;
    use arrow_array::{ArrayRef, Float64Array, RecordBatch, StringArray, TimestampMillisecondArray};

    let (zoned, plain) = (wide(true), wide(false));
    let tags: Vec<&str> = ["41FIC101.OP", "41FIC101.PV"].into_iter().cycle().take(2 * ROWS).collect();
    let stamps =
        TimestampMillisecondArray::from_iter_values((0..2 * ROWS).map(|k| t_s(k / 2) * 1000)).with_timezone("UTC");
    let values = Float64Array::from_iter_values((0..2 * ROWS).map(|k| if k % 2 == 0 { op(k / 2) } else { pv(k / 2) }));
    let long = RecordBatch::try_from_iter([
        ("tag", Arc::new(StringArray::from(tags)) as ArrayRef),
        ("timestamp", Arc::new(stamps) as ArrayRef),
        ("value", Arc::new(values) as ArrayRef),
    ])
    .unwrap();
    let shape = |name, file, bytes, flags, must| Shape { name, files: vec![(file, bytes)], flags, must };
    vec![
        shape("Parquet, wide, as pandas writes it", "x.parquet", parquet(&zoned), &[][..], Read("41FIC101")),
        shape("Parquet, times without zone", "x.parquet", parquet(&plain), &[], Ask("--tz", UTC, "41FIC101")),
        shape("Parquet, long", "x.parquet", parquet(&long), &[], Read("41FIC101")),
        shape("Arrow IPC (Feather)", "x.feather", arrow(&zoned), &[], Read("41FIC101")),
    ]
}
