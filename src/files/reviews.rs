//! What people found at valves, beside what the daemon had said: one line a review in `INDEX.csv`, one table of samples
//! each beside it, so that `stictiond evaluate` takes the folder as it is.

use std::fs::{self, OpenOptions};
use std::io::{self, Write};
use std::path::{Path, PathBuf};
use std::sync::{Mutex, PoisonError};

use serde::{Deserialize, Serialize};

use super::LoadedLoop;
use super::csv as table;
use stiction::units::{Moment, file_stem_of};
use stiction_monitor::short_hash;

/// Name of the folder below the recordings.
pub const FOLDER: &str = "reviews";
/// Name of the index.
pub const INDEX: &str = "INDEX.csv";

/// What was found.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, schemars::JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum Label {
    /// The valve sticks.
    Stiction,
    /// It does not.
    NoStiction,
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
}

/// The reviews of a folder.
#[derive(Debug)]
pub struct Reviews {
    dir: PathBuf,
    /// Held while a line is written.
    writing: Mutex<()>,
}

impl Reviews {
    /// Those below a folder of recordings.
    #[must_use]
    pub fn below(recordings: &Path) -> Self {
        Self { dir: recordings.join(FOLDER), writing: Mutex::default() }
    }

    /// The index.
    #[must_use]
    pub fn index(&self) -> PathBuf {
        self.dir.join(INDEX)
    }

    /// Keeps a review with the samples that it is about; gives it with the name of their table.
    ///
    /// # Errors
    /// The system refuses.
    pub fn keep(&self, mut review: Review, samples: &LoadedLoop) -> io::Result<Review> {
        let _writing = self.writing.lock().unwrap_or_else(PoisonError::into_inner);
        fs::create_dir_all(&self.dir)?;
        if !samples.samples.is_empty() {
            // Names that differ in what files cannot hold stay apart.
            let (stem, name) = (file_stem_of(&review.r#loop), short_hash(review.r#loop.as_bytes()));
            let kept = if stem == review.r#loop { stem } else { format!("{stem}-{}", &name[..6]) };
            review.file = format!("{kept}_{}.csv", review.window_end.0);
            let mut out = Vec::new();
            table::write(&samples.samples, &mut out)?;
            fs::write(self.dir.join(&review.file), out)?;
        }
        let index = self.index();
        let new = !index.exists();
        let mut line = csv::WriterBuilder::new().has_headers(new).from_writer(Vec::new());
        line.serialize(&review).map_err(io::Error::other)?;
        let line = line.into_inner().map_err(|e| io::Error::other(e.to_string()))?;
        let mut file = OpenOptions::new().create(true).append(true).open(index)?;
        file.write_all(&line)?;
        file.sync_all()?;
        Ok(review)
    }

    /// Every review, oldest first.
    ///
    /// # Errors
    /// The index cannot be read; the message names the line.
    pub fn all(&self) -> Result<Vec<Review>, String> {
        let index = self.index();
        if !index.exists() {
            return Ok(Vec::new());
        }
        let failed = |error: csv::Error| format!("{}: {error}; mend the line or take it out", index.display());
        let mut reader = csv::Reader::from_path(&index).map_err(failed)?;
        reader.deserialize().collect::<Result<_, _>>().map_err(failed)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;
    use stiction::record::{Sample, Signal, Value};

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
        fn whatever_people_write_comes_back_and_no_name_leads_out_of_the_folder(name in "\\PC{1,40}", why in "\\PC{0,60}|[,\"\n=]{0,6}") {
            let folder = tempfile::tempdir().unwrap();
            let reviews = Reviews::below(folder.path());
            prop_assert!(reviews.all().unwrap().is_empty());
            let kept = reviews.keep(review(&name, Some(&why)), &samples()).unwrap();
            reviews.keep(review(&name, None), &LoadedLoop::new("A", Vec::new())).unwrap();
            let all = reviews.all().unwrap();
            prop_assert_eq!(all.len(), 2);
            prop_assert_eq!(&all[0].r#loop, &name);
            prop_assert_eq!(all[0].why.clone().unwrap_or_default(), why);
            prop_assert!(Path::new(&kept.file).components().count() == 1);
            prop_assert!(folder.path().join(FOLDER).join(&kept.file).is_file());
            prop_assert!(all[1].file.is_empty());
        }
    }

    #[test]
    fn a_line_that_cannot_be_read_is_named() {
        let folder = tempfile::tempdir().unwrap();
        let reviews = Reviews::below(folder.path());
        reviews.keep(review("A", None), &samples()).unwrap();
        let mut text = fs::read_to_string(reviews.index()).unwrap();
        text.push_str("x,maybe,A\n");
        fs::write(reviews.index(), text).unwrap();
        assert!(reviews.all().unwrap_err().contains("line"), "{:?}", reviews.all());
    }
}
