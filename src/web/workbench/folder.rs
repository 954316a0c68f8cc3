//! A folder of our own for what is uploaded, gone when it is no longer needed.

use std::hash::{BuildHasher, Hasher, RandomState};
use std::io;
use std::path::{Path, PathBuf};

/// Names that are tried.
const TRIES: u32 = 8;

/// A folder that nobody else can look into; removed with everything in it when dropped.
#[derive(Debug)]
pub struct Folder(PathBuf);

impl Folder {
    /// A new one below the system's folder for passing files.
    ///
    /// # Errors
    /// The system refuses it.
    pub fn new() -> io::Result<Self> {
        let mut failed = io::Error::other("no name was free");
        for _ in 0..TRIES {
            // Its hasher begins with a number that others cannot guess.
            let number = RandomState::new().build_hasher().finish();
            let path = std::env::temp_dir().join(format!("stictiond-{}-{number:016x}", std::process::id()));
            match private(&path) {
                Ok(()) => return Ok(Self(path)),
                Err(error) => failed = error,
            }
        }
        Err(failed)
    }

    /// Where it is.
    #[must_use]
    pub fn path(&self) -> &Path {
        &self.0
    }
}

impl Drop for Folder {
    fn drop(&mut self) {
        // What cannot be removed is left to the system's own cleaning.
        let _ = std::fs::remove_dir_all(&self.0);
    }
}

/// Makes a folder that was not there, for its owner alone.
fn private(path: &Path) -> io::Result<()> {
    let mut builder = std::fs::DirBuilder::new();
    #[cfg(unix)]
    {
        use std::os::unix::fs::DirBuilderExt as _;
        builder.mode(0o700);
    }
    builder.create(path)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    #[cfg(unix)]
    fn it_is_private_and_goes_with_its_owner() {
        use std::os::unix::fs::PermissionsExt as _;
        let folder = Folder::new().unwrap();
        let path = folder.path().to_owned();
        assert_eq!(std::fs::metadata(&path).unwrap().permissions().mode() & 0o777, 0o700);
        std::fs::write(path.join("1"), "x").unwrap();
        assert!(private(&path).is_err(), "a folder that is there already is not ours");
        drop(folder);
        assert!(!path.exists());
    }
}
