//! Checks of the image files of a project, before any computation.

use std::collections::HashMap;
use std::collections::hash_map::Entry;
use std::io::Read;
use std::path::Path;

use rayon::prelude::*;

use super::image_file::ImageReader;
use super::manifest::hash_file;
use super::{ImagesSection, open};
use crate::error::{Error, Result};
use crate::finding::{Finding, Issue};

/// First bytes of a JPEG file.
const JPEG: [u8; 2] = [0xff, 0xd8];

/// Checks all image files that a project lists, and returns findings with their remedies.
///
/// An error if a file does not exist, or if two white images of different f-numbers are identical.
pub fn first_look(images: &ImagesSection, reader: &ImageReader) -> Result<Vec<Finding>> {
    for path in images.files() {
        open(path).map_err(|source| Error::Read { path: path.to_owned(), source })?;
    }
    let whites: Vec<&Path> = images.whites.iter().map(|white| white.image.as_path()).collect();
    for (white, before) in whites.iter().zip(repeated(&[], &whites)) {
        if let Some(before) = before {
            return Err(Error::invalid(format!(
                "{before} and {} are the same image: list one white image for each f-number",
                name(white)
            )));
        }
    }
    Ok(doubtful_files(images, reader))
}

/// Returns findings about the files themselves: compression with loss, and [`ImageReader::findings`].
#[must_use]
pub fn doubtful_files(images: &ImagesSection, reader: &ImageReader) -> Vec<Finding> {
    let files: Vec<&Path> = images.files().collect();
    compressed(images).into_iter().chain(reader.findings(&files)).collect()
}

/// Returns for each image the name of an identical one among `before` or earlier in the list. A frame that is used twice makes
/// σ too small, and a calibrated frame is no evaluation.
#[must_use]
pub fn repeated<P: AsRef<Path> + Sync>(before: &[P], images: &[P]) -> Vec<Option<String>> {
    // A file that cannot be read is reported when it is used.
    let hash = |path: &P| hash_file(path.as_ref()).ok();
    let all: Vec<&P> = before.iter().chain(images).collect();
    let hashes: Vec<Option<String>> = all.par_iter().map(|path| hash(path)).collect();
    let mut seen: HashMap<String, String> = HashMap::new();
    let mut found = Vec::new();
    for (path, hash) in all.into_iter().zip(hashes) {
        let first = hash.and_then(|hash| match seen.entry(hash) {
            Entry::Occupied(first) => Some(first.get().clone()),
            Entry::Vacant(place) => {
                place.insert(name(path.as_ref()));
                None
            }
        });
        found.push(first);
    }
    found.split_off(before.len())
}

/// Returns a finding if there are JPEG files: their blocks of 8 px move edges and change the profile of micro-images.
fn compressed(images: &ImagesSection) -> Option<Finding> {
    let jpegs: Vec<&Path> = images.files().filter(|path| is_jpeg(path)).collect();
    let first = name(jpegs.first()?);
    Some(Finding::caution(Issue::LossyCompression { images: jpegs.len(), first }))
}

fn is_jpeg(path: &Path) -> bool {
    let mut head = [0; 2];
    open(path).and_then(|mut file| file.read_exact(&mut head)).is_ok() && head == JPEG
}

fn name(path: &Path) -> String {
    path.file_name().unwrap_or_default().to_string_lossy().into_owned()
}

#[cfg(test)]
mod tests {
    use std::path::PathBuf;

    use super::super::{Pages, WhiteImage};
    use super::*;
    use crate::image::Color;

    /// Writes files with these contents.
    fn files(contents: &[&[u8]]) -> (tempfile::TempDir, Vec<PathBuf>) {
        let folder = tempfile::tempdir().unwrap();
        let write = |(i, content): (usize, &&[u8])| {
            let path = folder.path().join(format!("{i}.png"));
            std::fs::write(&path, content).unwrap();
            path
        };
        let paths = contents.iter().enumerate().map(write).collect();
        (folder, paths)
    }

    fn section(whites: &[PathBuf], calibration: &[PathBuf]) -> ImagesSection {
        let white =
            |path: &PathBuf| WhiteImage { image: path.clone(), f_number: Some(8.0), stop: None };
        ImagesSection {
            color: Color::Grey,
            black_level: None,
            pages: Pages::First,
            dark: None,
            raw: None,
            whites: whites.iter().map(white).collect(),
            devignetting: None,
            calibration: calibration.to_vec(),
            evaluation: Vec::new(),
            translation: None,
        }
    }

    #[test]
    fn images_that_came_before_are_named() {
        let (_folder, paths) = files(&[b"a", b"b", b"a", b"c", b"b"]);
        let before = |name: &str| Some(name.to_owned());
        assert_eq!(repeated(&[], &paths[..3]), [None, None, before("0.png")]);
        assert_eq!(repeated(&paths[..3], &paths[3..]), [None, before("1.png")]);
        // Files that cannot be read are not the same.
        let none = [paths[0].with_extension("x"), paths[0].with_extension("y")];
        assert_eq!(repeated(&[], &none), [None, None]);
    }

    #[test]
    fn whites_that_are_one_and_missing_files_are_errors() {
        let (folder, paths) = files(&[b"a", b"a"]);
        let reader = ImageReader::default();
        let error = first_look(&section(&paths, &[]), &reader).unwrap_err().to_string();
        assert!(error.starts_with("0.png and 1.png are the same image"), "{error}");
        let missing = [folder.path().join("none.png")];
        let error = first_look(&section(&paths[..1], &missing), &reader).unwrap_err().to_string();
        assert!(error.contains("none.png"), "{error}");
    }

    #[test]
    fn jpeg_files_are_named_whatever_they_are_called() {
        let (_folder, paths) = files(&[b"a", &[0xff, 0xd8, 0xff]]);
        let findings = first_look(&section(&[], &paths), &ImageReader::default()).unwrap();
        let [finding] = &findings[..] else { panic!("{findings:?}") };
        let first = "1.png".to_owned();
        assert_eq!(finding.issue, Issue::LossyCompression { images: 1, first });
    }
}
