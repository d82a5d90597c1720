//! `manifest.json`: what a run was made from, so that it can be traced, checked and resumed.

use std::collections::BTreeMap;
use std::ffi::OsStr;
use std::fmt::Write as _;
use std::io::{self, BufRead, BufReader};
use std::path::{Component, Path, PathBuf};

use serde::{Deserialize, Serialize};
use sha2::{Digest, Sha256};

use super::{OutputFolder, open, read_text};
use crate::error::{Error, Result};

/// Name of the file in the folder of a run.
pub const MANIFEST: &str = "manifest.json";
const FORMAT: &str = "plenocal-run";
const VERSION: u64 = 2;

/// What a run was made from.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Manifest {
    format: String,
    version: u64,
    /// Version of plenocal.
    pub plenocal: String,
    /// SHA-256 of the program.
    pub program_sha256: String,
    /// The project file.
    pub project: PathBuf,
    /// SHA-256 of every file that was read, by its path.
    pub inputs: BTreeMap<String, String>,
    /// The stages that are done, in order.
    pub stages: Vec<StageRecord>,
}

/// A stage that is done.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct StageRecord {
    /// Name of the stage and of its folder.
    pub name: String,
    /// SHA-256 of its input and of the program: while it is the same, the stage need not be
    /// repeated.
    pub key: String,
    /// What it was made from: values, and files by name and SHA-256.
    pub input: serde_json::Value,
    /// Wall time, s.
    pub time_s: f64,
    /// SHA-256 of what it wrote, by name.
    pub files: BTreeMap<String, String>,
}

/// Bytes read at a time.
const CHUNK: usize = 1 << 20;

/// SHA-256 of a file, hexadecimal, as `sha256sum` prints it.
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

/// SHA-256 of a text, hexadecimal.
#[must_use]
pub fn hash_text(text: &str) -> String {
    hexadecimal(&Sha256::digest(text))
}

fn hexadecimal(bytes: &[u8]) -> String {
    bytes.iter().fold(String::new(), |mut text, byte| {
        // Writing to a String cannot fail.
        let _ = write!(text, "{byte:02x}");
        text
    })
}

impl Manifest {
    /// The manifest of a run in which nothing is done yet, by a program with this SHA-256.
    #[must_use]
    pub fn new(project: &Path, program_sha256: String) -> Self {
        Self {
            format: FORMAT.to_owned(),
            version: VERSION,
            plenocal: env!("CARGO_PKG_VERSION").to_owned(),
            program_sha256,
            project: project.to_owned(),
            inputs: BTreeMap::new(),
            stages: Vec::new(),
        }
    }

    /// Reads the manifest of a folder; `None` if there is none, or if it has another version: then
    /// nothing in the folder is relied on. Nor is a stage whose files are not plain names: what a later run removes has to
    /// lie in the folder.
    #[must_use]
    pub fn read(folder: &Path) -> Option<Self> {
        let text = read_text(&folder.join(MANIFEST)).ok()?;
        let mut manifest: Self = serde_json::from_str(&text).ok()?;
        manifest.stages.retain(|stage| stage.files.keys().all(|name| is_plain(name)));
        (manifest.format == FORMAT && manifest.version == VERSION).then_some(manifest)
    }

    /// The record of a stage.
    #[must_use]
    pub fn stage(&self, name: &str) -> Option<&StageRecord> {
        self.stages.iter().find(|stage| stage.name == name)
    }

    /// Records a stage as done, in place of an earlier record.
    pub fn note(&mut self, record: StageRecord) {
        self.stages.retain(|stage| stage.name != record.name);
        self.stages.push(record);
    }

    /// Writes it into a folder.
    pub fn write(&self, folder: &Path) -> Result<()> {
        let value = serde_json::to_value(self)
            .map_err(|e| Error::invalid(format!("the manifest cannot be written: {e}")))?;
        let mut output = OutputFolder::new(folder)?;
        output.stage_json(MANIFEST, &value)?;
        output.commit().map(|_| ())
    }
}

/// Whether a name is that of a file in a folder, and leads nowhere else.
fn is_plain(name: &str) -> bool {
    Path::new(name).components().eq([Component::Normal(OsStr::new(name))])
}

impl StageRecord {
    /// Whether everything the stage wrote is still there, unchanged.
    #[must_use]
    pub fn is_intact(&self, folder: &Path) -> bool {
        self.files
            .iter()
            .all(|(name, hash)| hash_file(&folder.join(name)).is_ok_and(|found| found == *hash))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn hashes_are_those_of_sha256sum() {
        let folder = tempfile::TempDir::new().unwrap();
        let path = folder.path().join("abc");
        std::fs::write(&path, "abc").unwrap();
        let known = "ba7816bf8f01cfea414140de5dae2223b00361a396177a9cb410ff61f20015ad";
        assert_eq!(hash_file(&path).unwrap(), known);
        assert_eq!(hash_text("abc"), known);
        let record = StageRecord {
            name: "s".to_owned(),
            key: String::new(),
            input: serde_json::Value::Null,
            time_s: 0.0,
            files: BTreeMap::from([("abc".to_owned(), known.to_owned())]),
        };
        assert!(record.is_intact(folder.path()));
        let mut manifest = Manifest::new(Path::new("project.toml"), String::new());
        manifest.note(record.clone());
        manifest.write(folder.path()).unwrap();
        assert_eq!(Manifest::read(folder.path()).unwrap(), manifest);
        for elsewhere in ["../abc", "/abc", "a/../../abc", "", ".", ".."] {
            let mut manifest = manifest.clone();
            manifest.stages[0].files.insert(elsewhere.to_owned(), known.to_owned());
            manifest.write(folder.path()).unwrap();
            assert!(Manifest::read(folder.path()).unwrap().stages.is_empty(), "{elsewhere}");
        }
        std::fs::write(&path, "abd").unwrap();
        assert!(!record.is_intact(folder.path()));
        std::fs::write(folder.path().join(MANIFEST), "{}").unwrap();
        assert!(Manifest::read(folder.path()).is_none());
    }
}
