//! Input files from a command line: files, folders, patterns; and files that are read together, as those of one signal each and
//! those of the same tags day by day.

use std::collections::HashMap;
use std::fs::File;
use std::io::Read as _;
use std::path::{Path, PathBuf};

use super::export::{self, ReadOptions};
use super::{FileError, InputKind, Loaded, load, partition};

/// File extensions read from folders.
const ENDINGS: [&str; 16] = [
    "csv", "txt", "tsv", "tab", "dat", "asc", "xlsx", "xlsm", "parquet", "pq", "arrow", "feather", "ipc", "mat",
    "mcap", "part",
];
/// Bytes examined to recognise a single-signal file.
const HEAD: u64 = 1 << 16;
/// Deepest level of subfolders.
const DEPTH: usize = 8;

/// Files that are read together.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Unit {
    /// One file, or files that are read together: a signal each, or the same tags day by day.
    pub paths: Vec<PathBuf>,
}

impl Unit {
    /// Its name in messages.
    #[must_use]
    pub fn name(&self) -> String {
        let first = self.paths.first().map(|p| p.display().to_string()).unwrap_or_default();
        match self.paths.len() {
            0 | 1 => first,
            n => format!("{first} and {} more", n - 1),
        }
    }

    /// Reads it.
    ///
    /// # Errors
    /// As [`load`].
    pub fn load(&self, options: &ReadOptions) -> Result<Loaded, FileError> {
        if let [one] = &self.paths[..]
            && partition::loop_of(one).is_none()
        {
            return load(one, options);
        }
        if let Some(name) = self.paths.first().and_then(|path| partition::loop_of(path)) {
            return partition::load(&name, &self.paths, options);
        }
        let part = |path: &PathBuf| {
            let kind = InputKind::detect(path)?;
            let bytes = std::fs::read(path).map_err(|cause| FileError::Io { path: path.clone(), cause })?;
            let contents = export::contents(kind, path, &bytes, options);
            let contents = contents.map_err(|cause| FileError::Export { path: path.clone(), cause })?;
            Ok((export::stem_of(path), contents))
        };
        let (mut parts, mut faults) = (Vec::with_capacity(self.paths.len()), Vec::new());
        for read in self.paths.iter().map(part) {
            match read {
                Ok(part) => parts.push(part),
                Err(fault) => faults.push(fault),
            }
        }
        if parts.is_empty()
            && let Some(fault) = faults.pop()
        {
            return Err(fault);
        }
        let path = self.paths.first().cloned().unwrap_or_default();
        let read = export::read_parts(parts, options).map_err(|cause| FileError::Export { path, cause })?;
        let mut loaded = Loaded::of_export(InputKind::Csv, read);
        loaded.warnings.extend(faults.iter().map(|fault| format!("not read: {fault}")));
        Ok(loaded)
    }
}

/// The units named by paths and patterns, in order.
///
/// # Errors
/// A path or pattern matches nothing, or a folder cannot be read.
pub fn units(words: &[PathBuf], options: &ReadOptions) -> Result<Vec<Unit>, FileError> {
    let mut files = Vec::new();
    for word in words {
        expand(word, &mut files)?;
    }
    let whole = |path| Unit { paths: vec![path] };
    if files.len() < 2 {
        return Ok(files.into_iter().map(whole).collect());
    }
    let mut units: Vec<Unit> = Vec::new();
    let mut by_loop: HashMap<(PathBuf, String), usize> = HashMap::new();
    for path in files {
        // The days of one loop are its one file.
        let days = partition::loop_of(&path).zip(path.ancestors().nth(3).map(Path::to_owned));
        let of_tags = || {
            let name = common_of(&path, options)?;
            Some((name, path.parent().map_or_else(PathBuf::new, Path::to_owned)))
        };
        let Some((name, folder)) = days.or_else(of_tags) else {
            units.push(whole(path));
            continue;
        };
        let at = *by_loop.entry((folder, name)).or_insert(units.len());
        if at == units.len() {
            units.push(whole(path));
        } else {
            units[at].paths.push(path);
        }
    }
    Ok(units)
}

fn expand(word: &Path, files: &mut Vec<PathBuf>) -> Result<(), FileError> {
    let nothing = |what| FileError::Kind { path: word.to_owned(), what };
    if word.is_dir() {
        let before = files.len();
        walk(word, 0, files)?;
        return if files.len() > before {
            Ok(())
        } else {
            Err(nothing("a folder without readable files; it needs .csv, .txt, .xlsx, .parquet, .arrow, .mat or .mcap"))
        };
    }
    let text = word.to_string_lossy();
    if word.exists() || !text.contains(['*', '?', '[']) {
        files.push(word.to_owned());
        return Ok(());
    }
    let found = glob::glob(&text).map_err(|_| nothing("an invalid pattern; use the wildcards * and ?"))?;
    let mut found: Vec<PathBuf> = found.flatten().filter(|p| p.is_file()).collect();
    if found.is_empty() {
        return Err(nothing("a pattern that matches no file"));
    }
    found.sort();
    files.append(&mut found);
    Ok(())
}

fn walk(folder: &Path, depth: usize, files: &mut Vec<PathBuf>) -> Result<(), FileError> {
    let failed = |cause| FileError::Io { path: folder.to_owned(), cause };
    let mut entries: Vec<PathBuf> = Vec::new();
    for entry in std::fs::read_dir(folder).map_err(failed)? {
        entries.push(entry.map_err(failed)?.path());
    }
    entries.sort();
    for path in entries {
        let hidden = path.file_name().is_some_and(|n| n.to_string_lossy().starts_with(['.', '~']));
        if hidden {
            continue;
        }
        if path.is_dir() {
            // A link to a folder may lead back here.
            if depth < DEPTH && !path.is_symlink() {
                walk(&path, depth + 1, files)?;
            }
        } else if path.extension().is_some_and(|e| ENDINGS.contains(&e.to_string_lossy().to_lowercase().as_str())) {
            files.push(path);
        }
    }
    Ok(())
}

/// The common tags of files that are days of one loop, from their first rows; `None` for other files.
fn common_of(path: &Path, options: &ReadOptions) -> Option<String> {
    let kind = InputKind::detect(path).ok().filter(|kind| *kind == InputKind::Csv)?;
    let mut head = Vec::new();
    File::open(path).ok()?.take(HEAD).read_to_end(&mut head).ok()?;
    export::together(kind, path, &head, options)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn files_of_one_signal_are_read_together() {
        let folder = tempfile::tempdir().unwrap();
        let write = |name: &str, text: &str| std::fs::write(folder.path().join(name), text).unwrap();
        let rows = "2026-01-05T08:00:00Z,1\n2026-01-05T08:00:01Z,2\n";
        write("A.OP.csv", &format!("Timestamp,Value\n{rows}"));
        write("A.PV.csv", &format!("Timestamp,Value\n{rows}"));
        write("B.csv", "t,op,pv\n0,1,2\n");
        write("notes.md", "no table");
        std::fs::create_dir(folder.path().join("sub")).unwrap();
        write("sub/C.csv", "t,op,pv\n0,1,2\n");
        let options = ReadOptions::default();
        let units = units(&[folder.path().to_owned()], &options).unwrap();
        let counts: Vec<usize> = units.iter().map(|u| u.paths.len()).collect();
        assert_eq!(counts, [2, 1, 1]);
        let loaded = units[0].load(&options).unwrap();
        assert_eq!((loaded.loops[0].name.as_str(), loaded.loops[0].samples.len()), ("A", 4));
        let pattern = folder.path().join("*.csv");
        assert_eq!(super::units(&[pattern], &options).unwrap().len(), 2);
        let none = super::units(&[folder.path().join("*.xyz")], &options).unwrap_err().to_string();
        assert!(none.contains("matches no file"), "{none}");
    }

    #[test]
    fn days_of_the_same_tags_are_one_record() {
        let folder = tempfile::tempdir().unwrap();
        let write = |name: &str, head: &str, from: usize| {
            let rows: String = (from..from + 9).map(|k| format!("2026-01-05T08:00:{k:02}Z,{k},{}\n", k * k)).collect();
            std::fs::write(folder.path().join(name), format!("{head}\n{rows}")).unwrap();
        };
        write("day2.csv", "Time,A.OP,A.PV", 29);
        write("day1.csv", "Time,A.OP,A.PV", 20);
        write("other.csv", "Time,B.OP,B.PV", 20);
        write("own1.csv", "t,op,pv", 20);
        write("own2.csv", "t,op,pv", 20);
        let options = ReadOptions::default();
        let units = units(&[folder.path().to_owned()], &options).unwrap();
        assert_eq!(units.iter().map(|u| u.paths.len()).collect::<Vec<_>>(), [2, 1, 1, 1]);
        let days = units[0].load(&options).unwrap().loops.remove(0);
        assert!(days.samples.len() == 36 && days.samples.is_sorted_by_key(|s| s.t_ns));
        std::fs::write(folder.path().join("day1.csv"), "Time,A.OP,A.PV\nnever,1,2\n1,2,3\n").unwrap();
        let rest = units[0].load(&options).unwrap();
        assert!(rest.loops[0].samples.len() == 18 && rest.warnings.iter().any(|w| w.contains("day1.csv")));
    }
}
