//! What people found at valves, beside what the daemon had said: one line a review in `INDEX.csv`, and beside it one table of
//! samples each, so that `stictiond evaluate` takes the folder as it is.
//!
//! People open the index in a spreadsheet, which takes a cell that begins with `=` and the like for a formula. Such a cell is
//! written with an apostrophe before it, which reading takes away again.

use std::collections::{HashMap, HashSet};
use std::fs::{self, OpenOptions};
use std::io::{self, Write};
use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::SystemTime;

use serde::{Deserialize, Serialize};

use super::LoadedLoop;
use super::csv as table;
use stiction::core::units::{Moment, file_stem_of, s_from_ns};
use stiction_engine::short_hash;

/// Name of the folder below the recordings.
pub const FOLDER: &str = "reviews";
/// Name of the index.
pub const INDEX: &str = "INDEX.csv";

/// Reviews that the folder may have, and bytes of its files.
const MAX_REVIEWS: usize = 10_000;
const MAX_BYTES: u64 = 1 << 30;
/// Characters that make a spreadsheet take a cell for a formula, where they come first.
const FORMULA_STARTS: [char; 7] = ['=', '+', '-', '@', '\t', '\r', '\n'];

/// Why a review was not kept.
#[derive(Debug, thiserror::Error)]
pub enum KeepError {
    /// The folder has as much as it may have.
    #[error("{0} is full: move it elsewhere, or shorten [retention] results_days")]
    Full(String),
    /// The system refuses.
    #[error("the review could not be kept: {0}")]
    System(#[from] io::Error),
}

/// What was found.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, schemars::JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum Label {
    /// The valve sticks.
    Stiction,
    /// It does not.
    NoStiction,
    /// It was repaired.
    Repaired,
}

/// How it was found out.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, schemars::JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum Method {
    /// The valve was moved in steps, with the controller in manual.
    StrokeTest,
    /// It was taken apart or looked at.
    Inspection,
    /// Somebody who knows the loop says so.
    FalseAlarm,
    /// In another way.
    Other,
}

/// One review; the fields are the index's columns.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, schemars::JsonSchema)]
pub struct Review {
    /// Table of the samples that were judged, beside the index; empty where none were recorded.
    pub file: String,
    /// What was found.
    pub label: Label,
    /// The loop's name.
    pub r#loop: String,
    /// How it was found out.
    pub method: Method,
    /// Who.
    pub by: String,
    /// In that person's words.
    pub why: Option<String>,
    /// When it was said.
    #[schemars(with = "String")]
    pub at: Moment,
    /// End of the window that was judged.
    #[schemars(with = "String")]
    pub window_end: Moment,
    /// What the daemon had said of it.
    pub verdict: String,
    /// How probable it had called it that the valve sticks.
    pub p_stiction: Option<f64>,
    /// The size that it had found, OP units.
    pub s: Option<f64>,
    /// When the valve was repaired, by the clock of its data.
    #[schemars(with = "Option<String>")]
    pub work_at: Option<Moment>,
}

/// Whether a spreadsheet takes a cell for a formula, apostrophes before it left out.
fn begins_formula(cell: &str) -> bool {
    cell.trim_start_matches('\'').starts_with(FORMULA_STARTS)
}

/// A cell as it is written: never a formula.
#[must_use]
pub fn escaped(cell: &str) -> String {
    if begins_formula(cell) { format!("'{cell}") } else { cell.to_owned() }
}

/// A cell as it was before it was written.
fn unescaped(cell: &str) -> String {
    cell.strip_prefix('\'').filter(|rest| begins_formula(rest)).unwrap_or(cell).to_owned()
}

impl Review {
    /// The same with every text changed that comes from outside.
    fn map_texts(self, change: fn(&str) -> String) -> Self {
        Self {
            r#loop: change(&self.r#loop),
            by: change(&self.by),
            why: self.why.as_deref().map(change),
            verdict: change(&self.verdict),
            ..self
        }
    }
}

/// Reviews as lines of the index, below its head where they come first.
fn lines_of(reviews: impl IntoIterator<Item = Review>, with_head: bool) -> io::Result<Vec<u8>> {
    let mut lines = csv::WriterBuilder::new().has_headers(with_head).from_writer(Vec::new());
    for review in reviews {
        lines.serialize(review.map_texts(escaped)).map_err(io::Error::other)?;
    }
    lines.into_inner().map_err(|e| io::Error::other(e.to_string()))
}

/// Reviews as they were read.
#[derive(Debug, Default, PartialEq)]
pub struct ReviewList {
    all: Vec<Review>,
    newest: HashMap<String, usize>,
}

impl ReviewList {
    fn new(all: Vec<Review>) -> Self {
        let newest = all.iter().enumerate().map(|(k, review)| (review.r#loop.clone(), k)).collect();
        Self { all, newest }
    }

    /// Every review, oldest first.
    #[must_use]
    pub fn all(&self) -> &[Review] {
        &self.all
    }

    /// The last review of a loop.
    #[must_use]
    pub fn newest_of(&self, loop_name: &str) -> Option<&Review> {
        self.all.get(*self.newest.get(loop_name)?)
    }

    /// The index for people to open in a spreadsheet.
    ///
    /// # Errors
    /// A line cannot be written.
    pub fn table(&self) -> io::Result<Vec<u8>> {
        if self.all.is_empty() {
            return Ok(b"file,label\n".to_vec());
        }
        lines_of(self.all.iter().cloned(), true)
    }
}

/// Size and time of the last change of the index: while both stay, so does its content.
type IndexStamp = (u64, Option<SystemTime>);

/// The reviews of a folder.
#[derive(Debug)]
pub struct Reviews {
    dir: PathBuf,
    /// Held while a line is written.
    writing: Mutex<()>,
    /// What was read last. Never held while the disk is asked.
    read: Mutex<(Option<IndexStamp>, Arc<ReviewList>)>,
}

impl Reviews {
    /// Those below a folder of recordings.
    #[must_use]
    pub fn below(recordings: &Path) -> Self {
        Self { dir: recordings.join(FOLDER), writing: Mutex::default(), read: Mutex::default() }
    }

    /// The index.
    #[must_use]
    pub fn index(&self) -> PathBuf {
        self.dir.join(INDEX)
    }

    /// Keeps a review with the samples that it is about; gives it with the name of their table. Reviews that are older than
    /// `keep_days` are removed, 0: none.
    ///
    /// # Errors
    /// The folder is full, or the system refuses.
    pub fn keep(&self, mut review: Review, samples: &LoadedLoop, keep_days: f64) -> Result<Review, KeepError> {
        let _writing = self.writing.lock().unwrap_or_else(PoisonError::into_inner);
        fs::create_dir_all(&self.dir)?;
        let mut table_bytes = Vec::new();
        if !samples.samples.is_empty() {
            review.file = table_name(&review);
            table::write(samples, &mut table_bytes)?;
        }
        // An index that cannot be read is left as it is: `all` names its line.
        if let Ok(kept) = self.all() {
            let number = self.remove_old(kept, review.at, keep_days)?;
            if number >= MAX_REVIEWS || self.bytes()? + table_bytes.len() as u64 > MAX_BYTES {
                return Err(KeepError::Full(self.dir.display().to_string()));
            }
        }
        if !review.file.is_empty() {
            fs::write(self.dir.join(&review.file), table_bytes)?;
        }
        let index = self.index();
        // One from which all old reviews were removed has no head either.
        let is_empty = fs::metadata(&index).map_or(true, |meta| meta.len() == 0);
        let line = lines_of([review.clone()], is_empty)?;
        let mut file = OpenOptions::new().create(true).append(true).open(index)?;
        file.write_all(&line)?;
        file.sync_all()?;
        Ok(review)
    }

    fn write_all(&self, all: Vec<Review>) -> io::Result<()> {
        let part = self.dir.join(format!("{INDEX}.part"));
        fs::write(&part, lines_of(all, true)?)?;
        fs::rename(part, self.index())
    }

    /// Removes what is older than so many days; gives how many reviews stay.
    fn remove_old(&self, all: Vec<Review>, now: Moment, keep_days: f64) -> io::Result<usize> {
        let is_old =
            |review: &Review| keep_days > 0.0 && s_from_ns(now.0.saturating_sub(review.at.0)) > keep_days * 86_400.0;
        let (old, kept): (Vec<Review>, Vec<Review>) = all.into_iter().partition(is_old);
        if old.is_empty() {
            return Ok(kept.len());
        }
        let number = kept.len();
        let named: HashSet<String> = kept.iter().map(|review| review.file.clone()).collect();
        self.write_all(kept)?;
        let is_ours = |file: &&String| is_plain_name(file) && !named.contains(*file);
        for file in old.iter().map(|review| &review.file).filter(is_ours) {
            // One that somebody removed before is gone too.
            let _ = fs::remove_file(self.dir.join(file));
        }
        tracing::info!(removed = old.len(), "reviews older than [retention] results_days were removed");
        Ok(number)
    }

    /// Bytes of the folder's files.
    fn bytes(&self) -> io::Result<u64> {
        let entries = fs::read_dir(&self.dir)?;
        Ok(entries.filter_map(|entry| entry.ok()?.metadata().ok()).map(|meta| meta.len()).sum())
    }

    /// The reviews, read again where the index has changed.
    ///
    /// # Errors
    /// The index cannot be read; the message names the line.
    pub fn read(&self) -> Result<Arc<ReviewList>, String> {
        let stamp = fs::metadata(self.index()).ok().map(|meta| (meta.len(), meta.modified().ok()));
        let known = self.read.lock().unwrap_or_else(PoisonError::into_inner).clone();
        if known.0 == stamp {
            return Ok(known.1);
        }
        let list = Arc::new(ReviewList::new(self.all()?));
        *self.read.lock().unwrap_or_else(PoisonError::into_inner) = (stamp, list.clone());
        Ok(list)
    }

    /// The reviews as they were read last, without asking the disk.
    #[must_use]
    pub fn known(&self) -> Arc<ReviewList> {
        self.read.lock().unwrap_or_else(PoisonError::into_inner).1.clone()
    }

    fn all(&self) -> Result<Vec<Review>, String> {
        let index = self.index();
        let Ok(meta) = fs::metadata(&index) else { return Ok(Vec::new()) };
        if !meta.is_file() {
            return Err(format!("{} is not a file; move it elsewhere", index.display()));
        }
        let failed = |error: csv::Error| format!("{}: {error}; correct the line or remove it", index.display());
        let mut reader = csv::Reader::from_path(&index).map_err(failed)?;
        let read = |row: Result<Review, csv::Error>| row.map(|review| review.map_texts(unescaped));
        reader.deserialize().map(read).collect::<Result<_, _>>().map_err(failed)
    }
}

/// Whether a name leads to a file in the same folder, whoever wrote it.
fn is_plain_name(name: &str) -> bool {
    !name.contains(['/', '\\']) && Path::new(name).file_name().is_some_and(|own| own == name)
}

/// The name of the table of a review's samples. Loops whose names differ in characters that file names cannot have get
/// different tables, and no name is a formula or a hidden file.
fn table_name(review: &Review) -> String {
    let (stem, hash) = (file_stem_of(&review.r#loop), short_hash(review.r#loop.as_bytes()));
    let safe = if begins_formula(&stem) { format!("_{stem}") } else { stem };
    let name = if safe == review.r#loop { safe } else { format!("{safe}-{}", &hash[..6]) };
    format!("{name}_{}.csv", review.window_end.0)
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;
    use stiction::core::record::{Sample, Signal, Value};

    fn review(name: &str, why: Option<&str>) -> Review {
        Review {
            file: String::new(),
            label: Label::NoStiction,
            r#loop: name.to_owned(),
            method: Method::StrokeTest,
            by: "ann".into(),
            why: why.map(str::to_owned),
            at: Moment(1_700_000_000_000_000_000),
            window_end: Moment(1_700_000_000_000_000_000),
            verdict: "stiction".into(),
            p_stiction: Some(0.8),
            s: None,
            work_at: None,
        }
    }

    fn samples() -> LoadedLoop {
        let of =
            |signal, k: i64| Sample { signal, t_ns: k * 1_000_000_000, value: Value::Number(k as f64), quality: None };
        LoadedLoop::new("A", (0..40).flat_map(|k| [of(Signal::Op, k), of(Signal::Pv, k)]).collect())
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(64))]
        #[test]
        fn whatever_people_write_comes_back_and_no_name_leads_out_of_the_folder(name in "\\PC{1,40}", why in "\\PC{0,60}|[,\"\n\r\t'=+@-]{0,6}") {
            let folder = tempfile::tempdir().unwrap();
            let reviews = Reviews::below(folder.path());
            prop_assert!(reviews.all().unwrap().is_empty());
            let kept = reviews.keep(review(&name, Some(&why)), &samples(), 0.0).unwrap();
            reviews.keep(review(&name, None), &LoadedLoop::new("A", Vec::new()), 0.0).unwrap();
            let all = reviews.all().unwrap();
            prop_assert_eq!(all.len(), 2);
            prop_assert_eq!(&all[0].r#loop, &name);
            prop_assert_eq!(all[0].why.clone().unwrap_or_default(), why);
            prop_assert!(Path::new(&kept.file).components().count() == 1);
            prop_assert!(folder.path().join(FOLDER).join(&kept.file).is_file());
            prop_assert!(all[1].file.is_empty());
            for index in [fs::read(reviews.index()).unwrap(), reviews.read().unwrap().table().unwrap()] {
                for row in csv::ReaderBuilder::new().has_headers(false).from_reader(index.as_slice()).records() {
                    prop_assert!(row.unwrap().iter().all(|cell| !cell.starts_with(FORMULA_STARTS)));
                }
            }
        }
    }

    #[test]
    fn old_reviews_are_removed_with_their_tables_and_new_ones_stay() {
        const DAY: i64 = 86_400_000_000_000;
        let folder = tempfile::tempdir().unwrap();
        let reviews = Reviews::below(folder.path());
        let keep = |day: i64, window: i64| {
            let (at, window_end) = (Moment(day * DAY), Moment(window));
            reviews.keep(Review { at, window_end, ..review("A", None) }, &samples(), 10.0).unwrap()
        };
        let (first, second, third) = (keep(1, 1), keep(2, 2), keep(5, 2));
        assert_eq!(reviews.all().unwrap(), [first.clone(), second.clone(), third.clone()]);
        let newest = keep(13, 3);
        // The table of the second is that of the third too.
        assert_eq!(reviews.all().unwrap(), [third, newest]);
        let is_there = |review: &Review| folder.path().join(FOLDER).join(&review.file).is_file();
        assert!(!is_there(&first) && is_there(&second));
    }

    #[test]
    fn an_index_that_others_wrote_removes_no_file_outside_its_folder() {
        const DAY: i64 = 86_400_000_000_000;
        let folder = tempfile::tempdir().unwrap();
        let reviews = Reviews::below(folder.path());
        let kept = reviews.keep(Review { at: Moment(DAY), ..review("A", None) }, &samples(), 0.0).unwrap();
        let outside = [folder.path().join("recording.mcap"), folder.path().join("elsewhere")];
        let below = folder.path().join(FOLDER).join("below");
        fs::create_dir(&below).unwrap();
        let names = ["../recording.mcap", outside[1].to_str().unwrap(), "below/x", "..", "."];
        for path in outside.iter().chain([&below.join("x")]) {
            fs::write(path, "kept").unwrap();
        }
        let mut all = reviews.all().unwrap();
        let first = all[0].clone();
        all.extend(names.map(|name| Review { file: name.to_owned(), ..first.clone() }));
        reviews.write_all(all).unwrap();
        reviews.keep(Review { at: Moment(99 * DAY), ..review("B", None) }, &samples(), 10.0).unwrap();
        assert_eq!(reviews.all().unwrap().len(), 1, "all old ones are gone");
        assert!(outside.iter().chain([&below.join("x")]).all(|path| path.is_file()));
        assert!(!folder.path().join(FOLDER).join(&kept.file).exists(), "its own table goes");
    }

    #[test]
    fn reviews_are_read_again_only_where_the_index_has_changed() {
        let folder = tempfile::tempdir().unwrap();
        let reviews = Reviews::below(folder.path());
        assert!(reviews.read().unwrap().all().is_empty());
        let keep = |name: &str, why: &str| reviews.keep(review(name, Some(why)), &samples(), 0.0).unwrap();
        let (first, second) = (keep("A", "one"), keep("B", "two"));
        let list = reviews.read().unwrap();
        assert_eq!(list.all(), [first, second.clone()]);
        assert!(Arc::ptr_eq(&list, &reviews.read().unwrap()) && Arc::ptr_eq(&list, &reviews.known()));
        let third = keep("A", "three");
        let list = reviews.read().unwrap();
        assert_eq!(
            (list.newest_of("A"), list.newest_of("B"), list.newest_of("C")),
            (Some(&third), Some(&second), None)
        );
    }

    #[test]
    fn a_line_that_cannot_be_read_is_named() {
        let folder = tempfile::tempdir().unwrap();
        let reviews = Reviews::below(folder.path());
        reviews.keep(review("A", None), &samples(), 0.0).unwrap();
        let mut text = fs::read_to_string(reviews.index()).unwrap();
        text.push_str("x,maybe,A\n");
        fs::write(reviews.index(), text).unwrap();
        assert!(reviews.all().unwrap_err().contains("line"), "{:?}", reviews.all());
    }
}
