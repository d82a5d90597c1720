//! Results that take long to make and are shared by several tests: made once, kept in memory, and
//! written anew for every test.

use std::fs;
use std::path::{Path, PathBuf};

use tempfile::TempDir;

/// The files below a folder, by their path in it.
#[derive(Debug, PartialEq)]
pub struct Files(Vec<(PathBuf, Vec<u8>)>);

impl Files {
    pub fn read(folder: &Path) -> Self {
        let mut files = Vec::new();
        let mut open = vec![folder.to_owned()];
        while let Some(next) = open.pop() {
            for entry in fs::read_dir(next).unwrap() {
                let path = entry.unwrap().path();
                if path.is_dir() {
                    open.push(path);
                } else {
                    let name = path.strip_prefix(folder).unwrap().to_owned();
                    files.push((name, fs::read(&path).unwrap()));
                }
            }
        }
        files.sort();
        Self(files)
    }

    /// A folder with copies of these files, which a test may change.
    pub fn copy(&self) -> TempDir {
        let folder = TempDir::new().unwrap();
        for (name, bytes) in &self.0 {
            let path = folder.path().join(name);
            fs::create_dir_all(path.parent().unwrap()).unwrap();
            fs::write(path, bytes).unwrap();
        }
        folder
    }

    pub fn get(&self, name: &str) -> &[u8] {
        let found = self.0.iter().find(|(path, _)| path == Path::new(name));
        &found.unwrap_or_else(|| panic!("there is no {name}")).1
    }

    /// The names of all files.
    pub fn names(&self) -> impl Iterator<Item = &Path> {
        self.0.iter().map(|(name, _)| name.as_path())
    }

    /// The names of the files that differ from those of the same name in `other`.
    pub fn differing(&self, other: &Self) -> Vec<&Path> {
        let (ours, theirs): (Vec<_>, Vec<_>) = (self.names().collect(), other.names().collect());
        assert_eq!(ours, theirs, "the names differ");
        self.0
            .iter()
            .zip(&other.0)
            .filter(|(a, b)| a.1 != b.1)
            .map(|(a, _)| a.0.as_path())
            .collect()
    }
}
