//! A small preloaded library, compiled when a test runs, that breaks the disk and clock of one process: file systems and
//! containers cannot do this without root.

use std::fs::{self, File};
use std::os::unix::fs::FileExt;
use std::path::{Path, PathBuf};
use std::process::Command;

use crate::live::Daemon;

const SOURCE: &str = include_str!("shim.c");

pub const YEAR_S: i64 = 365 * 86_400;

pub struct Shim {
    told: File,
    environment: Vec<String>,
}

impl Shim {
    /// Compiles it; `None` without a C compiler.
    pub fn new(dir: &Path) -> Option<Self> {
        let [source, library, told] = ["shim.c", "shim.so", "told"].map(|name| dir.join(name));
        fs::write(&source, SOURCE).unwrap();
        let arguments: [&Path; 5] = ["-shared".as_ref(), "-fPIC".as_ref(), "-o".as_ref(), &library, &source];
        let made = Command::new("cc").args(arguments).arg("-ldl").status().ok()?;
        assert!(made.success(), "the C compiler refuses the shim");
        fs::write(&told, [0; 16]).unwrap();
        let place = |path: &PathBuf| path.to_str().unwrap().to_owned();
        let below = fs::canonicalize(dir).unwrap().join("rec");
        let environment = vec![
            "env".to_owned(),
            format!("LD_PRELOAD={}", place(&library)),
            format!("SHIM_TOLD={}", place(&told)),
            format!("SHIM_BELOW={}", place(&below)),
        ];
        Some(Self { told: File::options().write(true).open(told).unwrap(), environment })
    }

    /// Starts a daemon with the library preloaded.
    pub fn start(&self, dir: &Path, extra: &str) -> Daemon {
        let by: Vec<&str> = self.environment.iter().map(String::as_str).collect();
        Daemon::start_by(&by, dir, extra)
    }

    /// Sets whether access to the recording folder fails.
    pub fn break_disk(&self, broken: bool) {
        self.told.write_all_at(&i64::from(broken).to_ne_bytes(), 0).unwrap();
    }

    /// Sets whether access to the recording folder hangs.
    pub fn hang_disk(&self, hangs: bool) {
        self.told.write_all_at(&(2 * i64::from(hangs)).to_ne_bytes(), 0).unwrap();
    }

    /// Sets how far the wall clock is ahead.
    pub fn set_clock(&self, ahead_s: i64) {
        self.told.write_all_at(&ahead_s.to_ne_bytes(), 8).unwrap();
    }
}
