//! Lock on a folder for one process at a time.

use std::fs::{File, TryLockError};
use std::path::{Path, PathBuf};

use super::output::{make_folder, remove_empty, remove_left_overs};
use crate::error::{Error, Result};

/// Lock on a folder until it is dropped. The system releases it when the process ends in any way, so that no lock file remains.
#[derive(Debug)]
pub struct FolderLock {
    /// The open folder itself; `None` if the file system has no locks.
    _locked: Option<File>,
    /// Folders that did not exist before; they are removed if nothing was written.
    created: Vec<PathBuf>,
}

impl FolderLock {
    /// Creates the folder if necessary, and locks it; an error if another process holds the lock. Temporary files of a killed
    /// process are removed.
    pub fn hold(folder: &Path) -> Result<Self> {
        let write_error = |source| Error::Write { path: folder.to_owned(), source };
        let created = make_folder(folder).map_err(write_error)?;
        let file = File::open(folder).map_err(write_error)?;
        let locked = match file.try_lock() {
            Ok(()) => Some(file),
            Err(TryLockError::WouldBlock) => {
                return Err(Error::content(
                    folder,
                    "is in use by another run: wait until it ends, or choose another folder",
                ));
            }
            Err(TryLockError::Error(_)) => None,
        };
        // Without a lock, another process may still use its temporary files.
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
