//! The recording folder compared with what the retention allows.

use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};
use std::time::SystemTime;

use stiction_files::RecordingReader;
use stiction_files::rescue::{REMOVED, SAMPLES_KEY};

pub const RAW_DAYS: i64 = 6;
pub const RESULTS_DAYS: i64 = 12;
const DAY_NS: i64 = 86_400_000_000_000;

/// One recording: its time of last change, ns, and whether its samples were removed.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Seen {
    modified_ns: i64,
    results_only: bool,
}

/// Recordings by their finished names.
pub type Look = BTreeMap<String, Seen>;

pub struct Folder {
    path: PathBuf,
    /// Names of files that the retention changed or removed.
    touched: BTreeSet<String>,
    pub thinned: u64,
    pub removed: u64,
}

impl Folder {
    pub fn new(path: &Path) -> Self {
        Self { path: path.to_owned(), touched: BTreeSet::new(), thinned: 0, removed: 0 }
    }

    pub fn look(&self) -> Look {
        let mut seen = Look::new();
        for entry in std::fs::read_dir(&self.path).unwrap().flatten() {
            let name = entry.file_name().into_string().unwrap();
            let Some(name) = name.strip_suffix(".part").or(Some(name.as_str())).filter(|n| n.ends_with(".mcap")) else {
                continue;
            };
            let Ok(reader) = RecordingReader::open(&entry.path()) else { continue };
            let results_only = reader.metadata().get(SAMPLES_KEY).is_some_and(|word| word == REMOVED);
            let modified = entry.metadata().unwrap().modified().unwrap();
            let modified_ns = modified.duration_since(SystemTime::UNIX_EPOCH).unwrap().as_nanos() as i64;
            seen.insert(name.to_owned(), Seen { modified_ns, results_only });
        }
        seen
    }

    /// Whether the retention has changed files of a run.
    pub fn has_touched(&self, run_id: &str) -> bool {
        self.touched.iter().any(|name| name.contains(run_id))
    }

    /// Checks that everything removed was too old, and, if the clock has been calm for long, that nothing too old is left.
    pub fn compare(&mut self, before: &Look, now_ns: i64, calm: bool) {
        let after = self.look();
        let age_days = |seen: &Seen| (now_ns - seen.modified_ns) as f64 / DAY_NS as f64;
        for (name, old) in before {
            match after.get(name) {
                None => {
                    assert!(old.results_only && age_days(old) > RESULTS_DAYS as f64, "{name} was removed: {old:?}");
                    self.removed += 1;
                }
                Some(new) if new.results_only && !old.results_only => {
                    assert!(age_days(old) > RAW_DAYS as f64, "{name} lost its samples: {old:?}");
                    assert_eq!(old.modified_ns, new.modified_ns, "{name} keeps its age");
                    self.thinned += 1;
                }
                Some(new) => {
                    assert_eq!(old.results_only, new.results_only, "{name}");
                    continue;
                }
            }
            self.touched.insert(name.clone());
        }
        for (name, old) in before.iter().filter(|_| calm) {
            let limit = if old.results_only { RESULTS_DAYS } else { RAW_DAYS };
            let stays = after.get(name).is_some_and(|new| new.results_only == old.results_only);
            assert!(!stays || age_days(old) <= limit as f64, "{name} is still there: {old:?}");
        }
    }
}
