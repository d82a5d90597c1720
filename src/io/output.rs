//! A folder of results that appear all together or not at all.

use std::fs;
use std::io::{self, ErrorKind, Write};
use std::mem;
use std::path::{Path, PathBuf};
use std::sync::{Mutex, MutexGuard, PoisonError};
use std::time::Instant;

use tempfile::NamedTempFile;
use tracing::{debug, info};

use crate::error::{Error, Result};

/// Collects files under temporary names in their folder; `commit` gives them their final names.
/// Without a commit nothing is left behind, not even after [`abandon_output`].
#[derive(Debug)]
pub struct OutputFolder {
    folder: PathBuf,
    staged: Vec<(NamedTempFile, PathBuf)>,
    /// Folders that were not there before.
    created: Vec<PathBuf>,
}

/// What all output folders of the process have on disk but not committed.
struct Registry {
    files: Vec<PathBuf>,
    folders: Vec<PathBuf>,
    committed: bool,
}

static REGISTRY: Mutex<Registry> =
    Mutex::new(Registry { files: Vec::new(), folders: Vec::new(), committed: false });

/// Locked wherever files or folders are created, removed or given their names.
fn registry() -> MutexGuard<'static, Registry> {
    REGISTRY.lock().unwrap_or_else(PoisonError::into_inner)
}

/// Removes everything that is staged but not committed, for a process that is about to end early.
/// Returns whether anything was committed before.
///
/// Waits for a commit in progress. From then on, any thread that stages, commits or drops an
/// [`OutputFolder`] waits for the end of the process, so that nothing more is written.
#[must_use]
pub fn abandon_output() -> bool {
    let registry = registry();
    for file in &registry.files {
        let _ = fs::remove_file(file);
    }
    remove_empty(&registry.folders);
    let committed = registry.committed;
    mem::forget(registry);
    committed
}

/// Enters the folders that have to be made for one into the registry, and returns them.
fn entered(registry: &mut Registry, folder: &Path) -> Vec<PathBuf> {
    let missing = folder.ancestors().take_while(|f| !f.as_os_str().is_empty() && !f.exists());
    let mut missing: Vec<PathBuf> = missing.map(Path::to_owned).collect();
    missing.reverse();
    registry.folders.extend(missing.iter().cloned());
    missing
}

/// Makes a folder, and those it lies in. Those that were not there are returned, and go again if the process is
/// interrupted before anything is in them.
pub(super) fn make_folder(folder: &Path) -> io::Result<Vec<PathBuf>> {
    let created = entered(&mut registry(), folder);
    fs::create_dir_all(folder)?;
    Ok(created)
}

/// Removes folders, the last first; a folder that is not empty stays.
pub(super) fn remove_empty(folders: &[PathBuf]) {
    for folder in folders.iter().rev() {
        let _ = fs::remove_dir(folder);
    }
}

impl OutputFolder {
    /// Creates nothing yet; an error if the path cannot become a folder, or nothing can be written
    /// there.
    pub fn new(folder: &Path) -> Result<Self> {
        if folder.exists() && !folder.is_dir() {
            return Err(Error::content(folder, "is a file, but results go into a folder"));
        }
        let there = folder.ancestors().find(|f| f.exists()).unwrap_or(Path::new("."));
        if !there.is_dir() {
            return Err(Error::content(
                folder,
                format!("cannot become a folder, because {} is a file", there.display()),
            ));
        }
        // Found now rather than after the work; the file has no name on most systems.
        tempfile::tempfile_in(there)
            .map_err(|e| Error::Write { path: folder.to_owned(), source: plain(e) })?;
        Ok(Self { folder: folder.to_owned(), staged: Vec::new(), created: Vec::new() })
    }

    /// Stages a file of the folder, written by a function.
    pub fn stage(
        &mut self,
        name: impl AsRef<Path>,
        write: impl FnOnce(&mut dyn Write) -> io::Result<()>,
    ) -> Result<()> {
        let path = self.folder.join(name);
        let folder = path.parent().map_or_else(|| self.folder.clone(), Path::to_owned);
        let staged = self.open(&folder).and_then(|mut file| {
            let mut buffer = io::BufWriter::new(file.as_file_mut());
            write(&mut buffer)?;
            buffer.flush()?;
            drop(buffer);
            Ok(file)
        });
        match staged {
            Ok(file) => {
                self.staged.push((file, path));
                Ok(())
            }
            Err(source) => Err(Error::Write { path, source }),
        }
    }

    /// A temporary file, its folder created if necessary, both entered in the registry.
    fn open(&mut self, folder: &Path) -> io::Result<NamedTempFile> {
        let mut registry = registry();
        self.created.extend(entered(&mut registry, folder));
        fs::create_dir_all(folder)?;
        let file = temporary_file(folder)?;
        registry.files.push(file.path().to_owned());
        Ok(file)
    }

    /// Stages a JSON file, indented, with a final line break.
    pub fn stage_json(&mut self, name: impl AsRef<Path>, value: &serde_json::Value) -> Result<()> {
        self.stage(name, |out| {
            serde_json::to_writer_pretty(&mut *out, value)?;
            writeln!(out)
        })
    }

    /// Takes over what another folder has staged, to be committed with this one.
    pub fn take(&mut self, mut other: Self) {
        self.created.append(&mut other.created);
        self.staged.append(&mut other.staged);
    }

    /// Gives all files their final names, replacing older files. Returns the paths.
    pub fn commit(mut self) -> Result<Vec<PathBuf>> {
        // A name that is taken by a folder is found before the first file gets its name.
        if let Some((_, path)) = self.staged.iter().find(|(_, path)| path.is_dir()) {
            return Err(Error::content(path, "is a folder, but a result has this name"));
        }
        let begun = Instant::now();
        let mut paths = Vec::new();
        {
            // No interrupt can come between the first and the last.
            let mut registry = registry();
            for (file, path) in mem::take(&mut self.staged) {
                let staged = file.path().to_owned();
                file.persist(&path)
                    .map_err(|e| Error::Write { path: path.clone(), source: e.error })?;
                registry.files.retain(|file| *file != staged);
                registry.committed = true;
                paths.push(path);
            }
        }
        for path in &paths {
            debug!("written: {}", path.display());
        }
        info!(
            "{} file(s) written to {} in {:.3} s",
            paths.len(),
            self.folder.display(),
            begun.elapsed().as_secs_f64()
        );
        Ok(paths)
    }
}

impl Drop for OutputFolder {
    /// Removes the created folders that are still empty.
    fn drop(&mut self) {
        let mut registry = registry();
        self.staged.clear();
        remove_empty(&self.created);
        registry.folders.retain(|folder| !self.created.contains(folder));
        // Those of this folder are removed, or have their final names.
        registry.files.retain(|file| file.exists());
    }
}

/// The system's reason alone: the temporary file's name would only mislead.
fn plain(error: io::Error) -> io::Error {
    match error.kind() {
        kind @ (ErrorKind::NotFound
        | ErrorKind::PermissionDenied
        | ErrorKind::StorageFull
        | ErrorKind::QuotaExceeded
        | ErrorKind::ReadOnlyFilesystem) => kind.into(),
        _ => error,
    }
}

/// Temporary files are private by default; results are as readable as any other new file.
fn temporary_file(folder: &Path) -> io::Result<NamedTempFile> {
    let mut builder = tempfile::Builder::new();
    #[cfg(unix)]
    {
        use std::os::unix::fs::PermissionsExt;
        builder.permissions(fs::Permissions::from_mode(0o666)); // less the user's umask
    }
    builder.tempfile_in(folder).map_err(plain)
}
