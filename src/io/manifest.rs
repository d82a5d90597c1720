//! `manifest.json`: inputs and written files of a run.

use std::collections::BTreeMap;
use std::ffi::OsStr;
use std::fmt::Write as _;
use std::fs;
use std::io::{self, BufRead, BufReader};
use std::path::{Component, Path, PathBuf};
use std::time::SystemTime;

use rayon::prelude::*;
use serde::{Deserialize, Serialize};
use sha2::{Digest, Sha256};

use super::{open, read_text};
use crate::error::{Error, Result};

/// Name of the file in the folder of a run.
pub const MANIFEST: &str = "manifest.json";
const FORMAT: &str = "plenocal-run";
/// Files of version 2 and before also have hashes of the results.
const VERSION: u64 = 3;

/// Inputs and written files of a run.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Manifest {
    format: String,
    version: u64,
    /// Version of plenocal.
    pub plenocal: String,
    /// Project file.
    pub project: PathBuf,
    /// Arguments of the program, which may override the project.
    #[serde(default)]
    pub arguments: Vec<String>,
    /// SHA-256 of every file that was read, by path.
    pub inputs: BTreeMap<PathBuf, String>,
    /// Stages of the run, in order.
    pub stages: Vec<StageRecord>,
    /// Size and time of modification of the inputs when they were hashed.
    #[serde(skip)]
    seen: BTreeMap<PathBuf, Option<(u64, Option<SystemTime>)>>,
}

/// Stage of a run.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct StageRecord {
    /// Name of the stage and of its folder.
    pub name: String,
    /// Wall time, s.
    pub time_s: f64,
    /// Names of the written files.
    pub files: Vec<String>,
}

/// Number of bytes read at once.
const CHUNK: usize = 1 << 20;

/// Computes the SHA-256 of a file, hexadecimal, as `sha256sum` prints it.
pub fn hash_file(path: &Path) -> Result<String> {
    let digest = || -> io::Result<String> {
        let mut hasher = Sha256::new();
        let mut reader = BufReader::with_capacity(CHUNK, open(path)?);
        loop {
            let chunk = reader.fill_buf()?;
            if chunk.is_empty() {
                return Ok(hexadecimal(&hasher.finalize()));
            }
            hasher.update(chunk);
            let read = chunk.len();
            reader.consume(read);
        }
    };
    digest().map_err(|source| Error::Read { path: path.to_owned(), source })
}

fn hexadecimal(bytes: &[u8]) -> String {
    bytes.iter().fold(String::new(), |mut text, byte| {
        // Writing to a String cannot fail.
        let _ = write!(text, "{byte:02x}");
        text
    })
}

fn look(path: &Path) -> Option<(u64, Option<SystemTime>)> {
    let metadata = fs::metadata(path).ok()?;
    Some((metadata.len(), metadata.modified().ok()))
}

impl Manifest {
    /// Creates the manifest of a run that has not begun, with the hashes of its input files. The hash of a file that cannot be
    /// read is empty; the error is reported when the file is used.
    #[must_use]
    pub fn of<'a>(
        project: &Path,
        arguments: Vec<String>,
        files: impl Iterator<Item = &'a Path>,
    ) -> Self {
        let files: Vec<PathBuf> = files.map(Path::to_owned).collect();
        let seen = files.iter().map(|path| (path.clone(), look(path))).collect();
        let hashed: Vec<(PathBuf, String)> = files
            .into_par_iter()
            .map(|path| {
                let hash = hash_file(&path).unwrap_or_default();
                (path, hash)
            })
            .collect();
        Self {
            format: FORMAT.to_owned(),
            version: VERSION,
            plenocal: env!("CARGO_PKG_VERSION").to_owned(),
            project: project.to_owned(),
            arguments,
            inputs: hashed.into_iter().collect(),
            stages: Vec::new(),
            seen,
        }
    }

    /// Returns input files that have changed since they were hashed: results may be computed from either content.
    #[must_use]
    pub fn changed_inputs(&self) -> Vec<PathBuf> {
        let changed = self.seen.iter().filter(|(path, seen)| look(path) != **seen);
        changed.map(|(path, _)| path.clone()).collect()
    }

    /// Returns one hash of several input files: the SHA-256 of the lines of their hashes, as `sha256sum FILES | cut -c1-64 |
    /// sha256sum` prints it.
    #[must_use]
    pub fn hash_of<'a>(&self, files: impl Iterator<Item = &'a Path>) -> String {
        let mut hasher = Sha256::new();
        for hash in files.filter_map(|path| self.inputs.get(path)) {
            hasher.update(hash);
            hasher.update("\n");
        }
        hexadecimal(&hasher.finalize())
    }

    /// Reads the manifest of a folder; `None` if there is none of this version.
    #[must_use]
    pub fn read(folder: &Path) -> Option<Self> {
        let text = read_text(&folder.join(MANIFEST)).ok()?;
        let manifest: Self = serde_json::from_str(&text).ok()?;
        (manifest.format == FORMAT && manifest.version == VERSION).then_some(manifest)
    }

    /// Removes the files that the run of this manifest wrote into a folder, except the `written` ones, such as pictures of
    /// frames that no longer exist.
    pub fn remove_stale(&self, folder: &Path, written: &[PathBuf]) {
        for StageRecord { name, files, .. } in &self.stages {
            // Anyone can edit a manifest, so only files in the folder may be removed.
            let inside = files.iter().filter(|file| is_plain(name) && is_plain(file));
            let paths = inside.map(|file| folder.join(name).join(file));
            for path in paths.filter(|path| !written.contains(path)) {
                let _ = fs::remove_file(path);
            }
            if is_plain(name) {
                // `remove_dir` removes only an empty folder.
                let _ = fs::remove_dir(folder.join(name));
            }
        }
    }
}

/// Returns true if a name is a plain file name, without a path.
fn is_plain(name: &str) -> bool {
    Path::new(name).components().eq([Component::Normal(OsStr::new(name))])
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn hashes_agree_with_sha256sum_and_changes_are_noticed() {
        let folder = tempfile::TempDir::new().unwrap();
        let path = folder.path().join("abc");
        fs::write(&path, "abc").unwrap();
        let manifest =
            Manifest::of(Path::new("project.toml"), Vec::new(), [path.as_path()].into_iter());
        let known = "ba7816bf8f01cfea414140de5dae2223b00361a396177a9cb410ff61f20015ad";
        assert_eq!(manifest.inputs[&path], known);
        // echo ba78…15ad | sha256sum
        let of_one = "620a3df236da0af638c2a61c86951463731998f91dbb3ed629f47b9fe00ad118";
        assert_eq!(manifest.hash_of([path.as_path()].into_iter()), of_one);
        assert!(manifest.changed_inputs().is_empty());
        fs::write(&path, "abcd").unwrap();
        assert_eq!(manifest.changed_inputs(), [path]);
    }

    #[test]
    fn only_files_of_the_folder_that_are_not_written_anew_are_removed() {
        let folder = tempfile::TempDir::new().unwrap();
        let stage = folder.path().join("stage");
        fs::create_dir(&stage).unwrap();
        let [old, new, beside] = ["old", "new", "../beside"].map(|name| stage.join(name));
        for path in [&old, &new, &beside] {
            fs::write(path, "").unwrap();
        }
        let mut manifest = Manifest::of(Path::new("project.toml"), Vec::new(), [].into_iter());
        let files = ["old", "new", "../beside", "", "."].map(str::to_owned).to_vec();
        manifest.stages.push(StageRecord { name: "stage".to_owned(), time_s: 0.0, files });
        let text = serde_json::to_string(&manifest).unwrap();
        fs::write(folder.path().join(MANIFEST), text).unwrap();
        let read = Manifest::read(folder.path()).unwrap();
        read.remove_stale(folder.path(), std::slice::from_ref(&new));
        assert!(!old.exists() && new.exists() && beside.exists());
        fs::write(folder.path().join(MANIFEST), "{}").unwrap();
        assert!(Manifest::read(folder.path()).is_none());
    }
}
