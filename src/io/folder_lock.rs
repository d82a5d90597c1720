//! A folder that one process at a time works in.

use std::fs::{File, TryLockError};
use std::path::{Path, PathBuf};

use super::output::{make_folder, remove_empty, remove_left_overs};
use crate::error::{Error, Result};

/// Holds a folder until it is dropped. The system lets go of it when the process ends, however it ends, so no file is
/// left that would say otherwise.
#[derive(Debug)]
pub struct FolderLock {
    /// The folder itself, open; `None` where the file system has no locks.
    _locked: Option<File>,
    /// Folders that were not there before; they go again if nothing was written.
    created: Vec<PathBuf>,
}

impl FolderLock {
    /// Makes the folder if necessary, and holds it; an error if another process does. Temporary files of a process that was
    /// killed are removed.
    pub fn hold(folder: &Path) -> Result<Self> {
        let write_error = |source| Error::Write { path: folder.to_owned(), source };
        let created = make_folder(folder).map_err(write_error)?;
        let file = File::open(folder).map_err(write_error)?;
        let locked = match file.try_lock() {
            Ok(()) => Some(file),
            Err(TryLockError::WouldBlock) => {
                return Err(Error::content(
                    folder,
                    "is in use by another run: wait for its end, or choose another folder",
                ));
            }
            Err(TryLockError::Error(_)) => None,
        };
        // Without a lock, another process may still need its own.
        if locked.is_some() {
            remove_left_overs(folder);
        }
        Ok(Self { _locked: locked, created })
    }
}

impl Drop for FolderLock {
    fn drop(&mut self) {
        remove_empty(&self.created);
    }
}

#[cfg(test)]
mod tests {
    use std::fs;

    use super::*;

    #[test]
    fn a_folder_is_held_by_one() {
        let place = tempfile::tempdir().unwrap();
        let folder = place.path().join("a/b");
        let first = FolderLock::hold(&folder).unwrap();
        let error = FolderLock::hold(&folder).unwrap_err().to_string();
        assert!(error.contains("in use by another run"), "{error}");
        drop(first);
        assert!(!place.path().join("a").exists());
        let again = FolderLock::hold(&folder).unwrap();
        fs::write(folder.join("result"), "").unwrap();
        drop(again);
        assert!(folder.join("result").exists());
    }
}
