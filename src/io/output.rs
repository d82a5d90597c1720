//! Folder of results that appear all together or not at all.

use std::fs;
use std::io::{self, ErrorKind, Seek, SeekFrom, Write};
use std::mem;
use std::path::{Path, PathBuf};
use std::sync::{Mutex, MutexGuard, PoisonError};
use std::time::Instant;

use serde::Serialize;
use tempfile::NamedTempFile;
use tracing::{debug, info};

use crate::error::{Error, Result};
use crate::quantity::counted;

/// Beginning and end of the names of temporary files; no other program uses such names.
const TEMPORARY: [&str; 2] = [".plenocal-", ".tmp"];

/// Collects files under temporary names in their folder; `commit` renames them to their final names. Without a commit no file
/// remains, not even after [`abandon_output`].
#[derive(Debug)]
pub struct OutputFolder {
    folder: PathBuf,
    staged: Vec<(NamedTempFile, PathBuf)>,
    /// Folders that did not exist before.
    created: Vec<PathBuf>,
}

/// File of an [`OutputFolder`] that is being written. If it is dropped, it is removed.
#[derive(Debug)]
pub struct StagedFile {
    file: io::BufWriter<Unnamed>,
    path: PathBuf,
}

/// Temporary file whose errors do not contain its misleading name.
#[derive(Debug)]
struct Unnamed(NamedTempFile);

impl Write for Unnamed {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        self.0.as_file_mut().write(bytes)
    }

    fn flush(&mut self) -> io::Result<()> {
        self.0.as_file_mut().flush()
    }
}

impl Seek for Unnamed {
    fn seek(&mut self, to: SeekFrom) -> io::Result<u64> {
        self.0.as_file_mut().seek(to)
    }
}

impl StagedFile {
    /// Creates an error of writing with the final name of the file.
    #[must_use]
    pub fn error(&self, source: io::Error) -> Error {
        Error::Write { path: self.path.clone(), source }
    }
}

impl Write for StagedFile {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        self.file.write(bytes)
    }

    fn flush(&mut self) -> io::Result<()> {
        self.file.flush()
    }
}

impl Seek for StagedFile {
    fn seek(&mut self, to: SeekFrom) -> io::Result<u64> {
        self.file.seek(to)
    }
}

/// Files and folders on disk that output folders of this process have not committed.
struct Registry {
    files: Vec<PathBuf>,
    folders: Vec<PathBuf>,
    committed: bool,
}

static REGISTRY: Mutex<Registry> =
    Mutex::new(Registry { files: Vec::new(), folders: Vec::new(), committed: false });

/// Locks the registry, as required wherever files or folders are created, removed or renamed.
fn registry() -> MutexGuard<'static, Registry> {
    REGISTRY.lock().unwrap_or_else(PoisonError::into_inner)
}

/// Removes everything that is staged but not committed, for a process that is about to end early. Returns true if anything was
/// committed before.
///
/// This function waits for a commit in progress. From then on, any thread that stages, commits or drops an [`OutputFolder`]
/// waits for the end of the process, so that nothing more is written.
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

/// Adds the missing folders on a path to the registry, and returns them.
fn entered(registry: &mut Registry, folder: &Path) -> Vec<PathBuf> {
    let missing = folder.ancestors().take_while(|f| !f.as_os_str().is_empty() && !f.exists());
    let mut missing: Vec<PathBuf> = missing.map(Path::to_owned).collect();
    missing.reverse();
    registry.folders.extend(missing.iter().cloned());
    missing
}

/// Creates a folder and its parents, and returns those that did not exist. They are removed if the process is interrupted while
/// they are empty.
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
    /// Creates an empty collection without any file. An error if the path cannot become a folder, or if it is not writable.
    pub fn new(folder: &Path) -> Result<Self> {
        if folder.exists() && !folder.is_dir() {
            return Err(Error::content(folder, "is a file, but results need a folder"));
        }
        let there = folder.ancestors().find(|f| f.exists()).unwrap_or(Path::new("."));
        if !there.is_dir() {
            return Err(Error::content(
                folder,
                format!("cannot be created as a folder, because {} is a file", there.display()),
            ));
        }
        if folder.is_relative() && std::env::current_dir().is_err() {
            let gone = "the working folder no longer exists: change to another one";
            return Err(Error::Write { path: folder.to_owned(), source: io::Error::other(gone) });
        }
        // This test reports an unwritable folder before the work; the file has no name on most systems.
        tempfile::tempfile_in(there)
            .map_err(|e| Error::Write { path: folder.to_owned(), source: plain(e) })?;
        Ok(Self { folder: folder.to_owned(), staged: Vec::new(), created: Vec::new() })
    }

    /// Stages a file of the folder, written by a function; it replaces a staged file of the same name.
    pub fn stage(
        &mut self,
        name: impl AsRef<Path>,
        write: impl FnOnce(&mut dyn Write) -> io::Result<()>,
    ) -> Result<()> {
        let mut file = self.begin(name)?;
        write(&mut file).map_err(|source| file.error(source))?;
        self.finish(file)
    }

    /// Creates a file of the folder that is written piece by piece; `finish` stages it.
    pub fn begin(&mut self, name: impl AsRef<Path>) -> Result<StagedFile> {
        let path = self.folder.join(name);
        let folder = path.parent().map_or_else(|| self.folder.clone(), Path::to_owned);
        match self.open(&folder) {
            Ok(file) => Ok(StagedFile { file: io::BufWriter::new(Unnamed(file)), path }),
            Err(source) => Err(Error::Write { path, source }),
        }
    }

    /// Stages a complete file created by `begin`; it replaces a staged file of the same name.
    pub fn finish(&mut self, file: StagedFile) -> Result<()> {
        let StagedFile { file, path } = file;
        match file.into_inner() {
            Ok(Unnamed(file)) => {
                self.staged.retain(|(_, earlier)| *earlier != path);
                self.staged.push((file, path));
                Ok(())
            }
            Err(error) => Err(Error::Write { path, source: error.into_error() }),
        }
    }

    /// Creates a temporary file, and its folder if necessary, and adds both to the registry.
    fn open(&mut self, folder: &Path) -> io::Result<NamedTempFile> {
        let mut registry = registry();
        self.created.extend(entered(&mut registry, folder));
        fs::create_dir_all(folder)?;
        let file = temporary_file(folder)?;
        registry.files.push(file.path().to_owned());
        Ok(file)
    }

    /// Stages a JSON file, indented, with a final line break.
    pub fn stage_json(&mut self, name: impl AsRef<Path>, value: &impl Serialize) -> Result<()> {
        self.stage(name, |out| {
            serde_json::to_writer_pretty(&mut *out, value)?;
            writeln!(out)
        })
    }

    /// Returns the names of the staged files, relative to the folder.
    #[must_use]
    pub fn names(&self) -> Vec<String> {
        let name =
            |path: &Path| path.strip_prefix(&self.folder).unwrap_or(path).display().to_string();
        self.staged.iter().map(|(_, path)| name(path)).collect()
    }

    /// Takes over the staged files of another folder, to be committed with this one.
    pub fn take(&mut self, mut other: Self) {
        self.created.append(&mut other.created);
        self.staged.append(&mut other.staged);
    }

    /// Renames all files to their final names, replacing older files. Returns the paths.
    pub fn commit(mut self) -> Result<Vec<PathBuf>> {
        // A folder with the name of a result is an error before the first file is renamed.
        if let Some((_, path)) = self.staged.iter().find(|(_, path)| path.is_dir()) {
            return Err(Error::content(path, "is a folder, but has the name of a result file"));
        }
        let begun = Instant::now();
        // A full or broken disk may report an error only now.
        for (file, path) in &self.staged {
            written_through(file.as_file())
                .map_err(|source| Error::Write { path: path.clone(), source: plain(source) })?;
        }
        let paths = {
            // The lock keeps an interrupt from coming between the first and the last file.
            let mut registry = registry();
            name_all(mem::take(&mut self.staged), &mut registry)?
        };
        for path in &paths {
            debug!("written: {}", path.display());
        }
        info!(
            "{} written to {} in {:.3} s",
            counted(paths.len(), "file"),
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
        // The files of this folder are already removed or renamed.
        registry.files.retain(|file| file.exists());
    }
}

/// File with its final name, and the older one that it replaced.
struct Named {
    path: PathBuf,
    older: Option<NamedTempFile<()>>,
}

impl Named {
    /// Renames a file to its final name. If the file system has links, the older file is kept under a temporary name until all
    /// files are renamed.
    fn give(file: NamedTempFile, path: PathBuf) -> Result<Self> {
        let folder = path.parent().unwrap_or(Path::new(""));
        let keep = |kept: &Path| fs::hard_link(&path, kept);
        let older = named_builder().make_in(folder, keep).ok();
        match renamed(file, &path) {
            Ok(()) => Ok(Self { path, older }),
            Err(source) => Err(Error::Write { path, source: plain(source) }),
        }
    }

    /// Restores the older file.
    fn undo(self) {
        let _ = match self.older {
            Some(older) => renamed(older, &self.path),
            None => fs::remove_file(&self.path),
        };
    }
}

/// Renames a temporary file. On an error it is removed.
fn renamed<F>(file: NamedTempFile<F>, path: &Path) -> io::Result<()> {
    fs::rename(file.path(), path)?;
    // Without this, the renamed file would be removed on drop.
    file.into_temp_path().keep().map(|_| ()).map_err(|e| e.error)
}

fn named_builder() -> tempfile::Builder<'static, 'static> {
    let mut builder = tempfile::Builder::new();
    builder.prefix(TEMPORARY[0]).suffix(TEMPORARY[1]);
    builder
}

/// Renames all files to their final names, or none of them.
fn name_all(
    staged: Vec<(NamedTempFile, PathBuf)>,
    registry: &mut Registry,
) -> Result<Vec<PathBuf>> {
    let mut named: Vec<Named> = Vec::new();
    for (file, path) in staged {
        match Named::give(file, path) {
            Ok(given) => named.push(given),
            Err(error) => {
                named.into_iter().rev().for_each(Named::undo);
                return Err(error);
            }
        }
    }
    registry.files.retain(|file| file.exists());
    registry.committed |= !named.is_empty();
    Ok(named.into_iter().map(|named| named.path).collect())
}

/// Waits until a file is on the disk; an error of file systems that do not support this is ignored.
fn written_through(file: &fs::File) -> io::Result<()> {
    match file.sync_data() {
        Err(e) if matches!(e.kind(), ErrorKind::InvalidInput | ErrorKind::Unsupported) => Ok(()),
        result => result,
    }
}

/// Removes temporary files of a killed process in a folder and its subfolders. The caller has to hold the folder.
pub(super) fn remove_left_overs(folder: &Path) {
    let [begin, end] = TEMPORARY;
    let within = |folder: &Path| -> Vec<PathBuf> {
        let entries = fs::read_dir(folder).into_iter().flatten().flatten();
        entries.map(|entry| entry.path()).collect()
    };
    for path in within(folder) {
        let inner = if path.is_dir() && !path.is_symlink() { within(&path) } else { Vec::new() };
        for file in inner.into_iter().chain([path]) {
            let name = file.file_name().unwrap_or_default().to_string_lossy();
            if name.starts_with(begin) && name.ends_with(end) && !file.is_dir() {
                let _ = fs::remove_file(&file);
            }
        }
    }
}

/// Returns the system's reason alone: the name of the temporary file would be misleading.
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

/// Creates a temporary file with the permissions of any other new file; by default temporary files are private.
fn temporary_file(folder: &Path) -> io::Result<NamedTempFile> {
    let mut builder = named_builder();
    #[cfg(unix)]
    {
        use std::os::unix::fs::PermissionsExt;
        builder.permissions(fs::Permissions::from_mode(0o666)); // less the user's umask
    }
    builder.tempfile_in(folder).map_err(plain)
}
