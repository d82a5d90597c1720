//! A folder of results that appear all together or not at all.

use std::fs;
use std::io::{self, Write};
use std::mem;
use std::path::{Path, PathBuf};

use tempfile::NamedTempFile;

use crate::error::{Error, Result};

/// Collects files under temporary names in their folder; `commit` gives them their names. What is
/// not committed leaves nothing behind.
#[derive(Debug)]
pub struct OutputFolder {
    folder: PathBuf,
    staged: Vec<(NamedTempFile, PathBuf)>,
    /// Folders that were not there before.
    created: Vec<PathBuf>,
}

impl OutputFolder {
    /// An error if the path cannot become a folder; nothing is created yet.
    pub fn new(folder: &Path) -> Result<Self> {
        if folder.exists() && !folder.is_dir() {
            return Err(Error::content(folder, "is a file, but results go into a folder"));
        }
        Ok(Self { folder: folder.to_owned(), staged: Vec::new(), created: Vec::new() })
    }

    /// Writes a file of the folder by a function.
    pub fn stage(
        &mut self,
        name: impl AsRef<Path>,
        write: impl FnOnce(&mut dyn Write) -> io::Result<()>,
    ) -> Result<()> {
        let path = self.folder.join(name);
        let folder = path.parent().unwrap_or(&self.folder);
        let missing = folder.ancestors().take_while(|f| !f.as_os_str().is_empty() && !f.exists());
        let missing: Vec<PathBuf> = missing.map(Path::to_owned).collect();
        self.created.extend(missing.into_iter().rev());
        let staged = fs::create_dir_all(folder).and_then(|()| temporary_file(folder)).and_then(
            |mut file| {
                let mut buffer = io::BufWriter::new(&mut file);
                write(&mut buffer)?;
                buffer.flush()?;
                drop(buffer);
                Ok(file)
            },
        );
        match staged {
            Ok(file) => {
                self.staged.push((file, path));
                Ok(())
            }
            Err(source) => Err(Error::Write { path, source }),
        }
    }

    /// Writes a JSON file, indented, with a final line break.
    pub fn stage_json(&mut self, name: impl AsRef<Path>, value: &serde_json::Value) -> Result<()> {
        self.stage(name, |out| {
            serde_json::to_writer_pretty(&mut *out, value)?;
            writeln!(out)
        })
    }

    /// An error unless files can be written into the folder; leaves nothing behind.
    pub fn probe(mut self) -> Result<()> {
        self.stage(".probe", |_| Ok(()))
    }

    /// What another folder has staged is committed with this one.
    pub fn take(&mut self, mut other: Self) {
        self.created.append(&mut other.created);
        self.staged.append(&mut other.staged);
    }

    /// Gives all files their names, replacing older ones. Returns the paths.
    pub fn commit(mut self) -> Result<Vec<PathBuf>> {
        // What would keep one of them from its name is looked for before the first gets it.
        if let Some((_, path)) = self.staged.iter().find(|(_, path)| path.is_dir()) {
            return Err(Error::content(path, "is a folder, but a result has this name"));
        }
        let mut paths = Vec::new();
        for (file, path) in mem::take(&mut self.staged) {
            file.persist(&path)
                .map_err(|e| Error::Write { path: path.clone(), source: e.error })?;
            paths.push(path);
        }
        Ok(paths)
    }
}

impl Drop for OutputFolder {
    /// Folders in which nothing came to be go again.
    fn drop(&mut self) {
        self.staged.clear();
        for folder in self.created.iter().rev() {
            // One that is not empty stays.
            let _ = fs::remove_dir(folder);
        }
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
    builder.tempfile_in(folder)
}
