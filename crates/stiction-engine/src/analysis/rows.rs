//! Rows of a table to samples: which empty cells are missing values and which are no samples, and the order of rows.
//!
//! An empty cell of OP or PV is a missing sample. In other columns it is no sample, since set points and modes are often
//! written only when they change. The same holds for OP and PV if they are in separate rows, each with its stamps. A table with
//! rows that are newest first or shuffled is sorted by time. Each correction is noted in one line.

use std::collections::HashSet;

use stiction::core::record::{Sample, Signal, Value};

/// A table counts as newest first from this many backward steps on, if they outnumber the forward steps.
const NEWEST_FIRST: u64 = 3;
/// A table counts as shuffled from this many backward steps on, if they are at least one in twenty: recordings have a few late
/// rows, which are left in place.
const DISORDER: u64 = 10;
/// Fewest samples of a sorted block.
const BLOCK: usize = 20;

/// Rows as they are added.
#[derive(Debug, Clone, Default)]
pub struct Rows {
    out: Joined,
    /// Indices of samples that stand for empty cells.
    empty: Vec<usize>,
    /// Whether the current row has OP, and PV.
    has: [bool; 2],
    /// Rows with OP and PV, with OP alone, with PV alone.
    both: u64,
    op_only: u64,
    pv_only: u64,
    /// Time of the current row, and how often time went forward or back between rows.
    t_ns: Option<i64>,
    forward: u64,
    backward: u64,
    repeated: u64,
}

/// The samples of a table, with notes.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Joined {
    /// Samples in the order of the rows, and within a row in the order in which they were added.
    pub samples: Vec<Sample>,
    /// Number of rows.
    pub rows: u64,
    /// Number of cells that are empty or not finite.
    pub missing: u64,
    /// Notes for the user, one line each.
    pub warnings: Vec<String>,
}

impl Rows {
    /// Starts a row; its cells follow.
    pub fn begin(&mut self, t_ns: i64) {
        self.close();
        self.out.rows += 1;
        if let Some(last_ns) = self.t_ns.replace(t_ns) {
            self.forward += u64::from(t_ns > last_ns);
            self.repeated += u64::from(t_ns == last_ns);
            self.backward += u64::from(t_ns < last_ns);
        }
    }

    /// Adds a cell of the row with its quality, or `None` if it is empty; the cells of a row come in the order of
    /// [`Signal::ALL`].
    pub fn cell(&mut self, signal: Signal, cell: Option<(Value, Option<u32>)>) {
        let required = match signal {
            Signal::Op => Some(0),
            Signal::Pv => Some(1),
            _ => None,
        };
        let (value, quality) = match (cell, required) {
            (Some(taken), at) => {
                at.into_iter().for_each(|at| self.has[at] = true);
                taken
            }
            (None, None) => return,
            (None, Some(_)) => {
                self.empty.push(self.out.samples.len());
                (Value::Missing, None)
            }
        };
        self.out.missing += u64::from(value == Value::Missing);
        self.out.samples.push(Sample { signal, t_ns: self.t_ns.unwrap_or(0), value, quality });
    }

    fn close(&mut self) {
        let [op, pv] = std::mem::take(&mut self.has);
        self.both += u64::from(op && pv);
        self.op_only += u64::from(op && !pv);
        self.pv_only += u64::from(pv && !op);
    }

    /// The samples of all rows.
    #[must_use]
    pub fn finish(mut self) -> Joined {
        self.close();
        // A dead sensor gives such rows for one signal only.
        if self.op_only.min(self.pv_only) > self.both {
            self.out.warnings.push(format!(
                "op and pv are in separate rows ({} and {} of {} rows): empty cells are not samples",
                self.op_only, self.pv_only, self.out.rows
            ));
            self.drop_empty();
        }
        if self.backward + self.repeated > 0 {
            self.drop_repeated();
        }
        self.order();
        self.out
    }

    /// Sorts a table by time if its rows are newest first or shuffled; rows with equal times keep their order.
    fn order(&mut self) {
        let out = &mut self.out;
        let newest_first = self.backward >= NEWEST_FIRST && self.backward > self.forward;
        if newest_first {
            out.warnings.push(format!("the {} rows are newest first: sorted by time", out.rows));
        } else if self.backward >= DISORDER && 20 * self.backward > out.rows || swapped_blocks(&out.samples) {
            out.warnings.push(format!("the {} rows are out of order: sorted by time", out.rows));
        } else {
            return;
        }
        out.samples.sort_by_key(|sample| sample.t_ns);
    }

    /// Drops rows that are repeated because tables overlap.
    fn drop_repeated(&mut self) {
        let key = |s: &Sample| {
            let mode = if let Value::Mode(mode) = s.value { Some(mode) } else { None };
            (s.t_ns, s.signal, s.value.as_number().map(f64::to_bits), mode, s.quality)
        };
        let mut known = HashSet::new();
        let rows = self.out.samples.chunk_by(|a, b| a.t_ns == b.t_ns);
        let kept: Vec<&[Sample]> = rows.filter(|row| known.insert(row.iter().map(key).collect::<Vec<_>>())).collect();
        let samples = kept.concat();
        let repeated = self.out.samples.len() - samples.len();
        if repeated < BLOCK {
            return;
        }
        let steps = |back: bool| {
            let times = kept.windows(2).map(|w| (w[0][0].t_ns, w[1][0].t_ns));
            times.filter(|(a, b)| if back { b < a } else { b > a }).count() as u64
        };
        (self.forward, self.backward) = (steps(false), steps(true));
        self.out.samples = samples;
        self.out.warnings.push(format!("{repeated} samples that the table has twice are left out"));
    }

    fn drop_empty(&mut self) {
        let mut empty = self.empty.iter().copied().peekable();
        let mut at = 0;
        self.out.samples.retain(|_| {
            let drop = empty.next_if_eq(&at).is_some();
            at += 1;
            !drop
        });
        self.out.missing -= self.empty.len() as u64;
    }
}

/// Whether samples come in sorted blocks that do not overlap, such as days that were joined the wrong way round. A clock that was
/// set back also gives sorted blocks, but they overlap.
fn swapped_blocks(samples: &[Sample]) -> bool {
    let mut blocks: Vec<&[Sample]> = samples.chunk_by(|a, b| a.t_ns <= b.t_ns).collect();
    if blocks.len() < 2 || blocks.iter().any(|block| block.len() < BLOCK) {
        return false;
    }
    blocks.sort_by_key(|block| block[0].t_ns);
    blocks.windows(2).all(|pair| pair[0][pair[0].len() - 1].t_ns < pair[1][0].t_ns)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn empty_cells_are_missing_only_where_every_row_should_have_them() {
        let mut rows = Rows::default();
        for k in 0..3 {
            rows.begin(k);
            rows.cell(Signal::Op, (k != 1).then_some((Value::Number(1.0), None)));
            rows.cell(Signal::Sp, None);
            rows.cell(Signal::Pv, Some((Value::Number(2.0), None)));
        }
        let found = rows.finish();
        assert_eq!((found.samples.len(), found.rows, found.missing), (6, 3, 1));
        assert!(found.warnings.is_empty());
    }

    #[test]
    fn rows_of_overlapping_tables_count_once() {
        let read = |times: &mut dyn Iterator<Item = i64>| {
            let mut rows = Rows::default();
            for t_ns in times {
                rows.begin(t_ns);
                rows.cell(Signal::Op, Some((Value::Number(t_ns as f64), None)));
                rows.cell(Signal::Pv, Some((Value::Number(2.0 * t_ns as f64), None)));
            }
            rows.finish()
        };
        let once = read(&mut (0..300));
        let twice = read(&mut (0..200).chain(100..300));
        assert_eq!(twice.samples, once.samples);
        assert_eq!(twice.warnings, ["200 samples that the table has twice are left out"]);
        let swapped = read(&mut (100..300).chain(0..200));
        assert_eq!(swapped.samples, once.samples);
    }
}
