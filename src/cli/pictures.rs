//! The pictures of a run for its report.

use std::fmt::Write as _;
use std::fs;
use std::path::{Component, Path, PathBuf};

use plenocal::calibration::OutlyingFeature;
use plenocal::detection::{DetectedBoards, DetectedFrame};
use plenocal::model::{FeatureResidual, Subset};
use plenocal::precalibration::Precalibration;
use plenocal::report::{Part, Photograph, Picture, PictureSource, pictures_part};
use plenocal::{Error, Finding, Result, Subject};
use rayon::prelude::*;

use super::boards::{Photographs, Shoot, images_of};

/// Boards of a subset, with what is known about their images.
pub struct ShownBoards<'a> {
    pub subset: Subset,
    pub found: &'a DetectedBoards,
    pub photographs: &'a Photographs,
    pub residuals: &'a [FeatureResidual],
    pub findings: Vec<Finding>,
    pub outlying: &'a [OutlyingFeature],
}

/// White images with their pre-calibration, in the order of the project.
pub struct ShownWhites<'a> {
    pub result: &'a Precalibration,
    pub photographs: &'a [Photograph],
}

/// Returns the pictures of a run, whose report is in the folder `out`.
pub fn pictures_of(
    shoot: &Shoot,
    boards: &[ShownBoards],
    whites: &ShownWhites,
    out: &Path,
) -> Result<Part> {
    let radii_px = radii_of_boards(shoot, whites.result)?;
    let all: Vec<_> = boards
        .iter()
        .flat_map(|of| {
            let images = images_of(of.subset, &shoot.images);
            of.found.frames.iter().zip(images).map(move |(frame, path)| (of, frame, path))
        })
        .collect();
    let picture = |&(of, frame, path): &(&ShownBoards, &DetectedFrame, &PathBuf)| {
        let Some(photograph) = of.photographs.get(&frame.frame) else { return Ok(None) };
        let group = format!("Boards: {}", of.subset.name());
        let image = address(out, path)?;
        let source = PictureSource { group: &group, photograph, image, radii_px: &radii_px };
        let is_about = |f: &&Finding| matches!(f.subject, Subject::Frame { frame: of, .. } if of == frame.frame);
        let about: Vec<Finding> = of.findings.iter().filter(is_about).cloned().collect();
        let board = &shoot.board;
        Picture::of_board(source, frame, board, of.residuals, &about, of.outlying).map(Some)
    };
    let of_boards = all.par_iter().map(picture).collect::<Result<Vec<_>>>()?;
    let mut pictures: Vec<Picture> = of_boards.into_iter().flatten().collect();
    for (white, photograph) in shoot.images.whites.iter().zip(whites.photographs) {
        let path = &white.image;
        let radii_px = radii_of(path, whites.result);
        let image = address(out, path)?;
        let source =
            PictureSource { group: "White images", photograph, image, radii_px: &radii_px };
        let name = path.display().to_string();
        let about: Vec<Finding> = whites
            .result
            .findings
            .iter()
            .filter(|f| matches!(&f.subject, Subject::Image(of) if *of == name))
            .cloned()
            .collect();
        let file = path.file_name().unwrap_or_default().to_string_lossy();
        pictures.push(Picture::of_white(source, &file, &about)?);
    }
    pictures_part(pictures, whites.result)
}

/// Returns the radii of the micro-images in a white image, px; empty if it was not measured.
fn radii_of(path: &Path, result: &Precalibration) -> Vec<f64> {
    let name = path.display().to_string();
    let place = result.images.iter().position(|of| *of == name);
    place.map(|place| result.radii_px(place)).unwrap_or_default()
}

/// Returns the radii in the white image whose f-number is nearest to that of the boards.
fn radii_of_boards(shoot: &Shoot, result: &Precalibration) -> Result<Vec<f64>> {
    let mut nearest: (f64, &[PathBuf]) = (f64::INFINITY, &[]);
    for white in &shoot.images.whites {
        let off = (white.f_number()? / shoot.sheet.f_number).ln().abs();
        if off < nearest.0 {
            nearest = (off, std::slice::from_ref(&white.image));
        }
    }
    Ok(nearest.1.first().map(|path| radii_of(path, result)).unwrap_or_default())
}

/// Kinds of files that every browser shows.
const SHOWN: [&str; 4] = ["png", "jpg", "jpeg", "bmp"];

/// Returns the address of an image relative to a folder; `None` if a browser cannot show its kind of file.
fn address(folder: &Path, image: &Path) -> Result<Option<String>> {
    let kind = image.extension().unwrap_or_default().to_string_lossy().to_lowercase();
    if !SHOWN.contains(&kind.as_str()) {
        return Ok(None);
    }
    let absolute = |path: &Path| {
        fs::canonicalize(path).map_err(|source| Error::Read { path: path.to_owned(), source })
    };
    Ok(Some(relative(&absolute(folder)?, &absolute(image)?)))
}

/// Returns the way from an absolute folder to an absolute path, as an address on a page.
fn relative(folder: &Path, path: &Path) -> String {
    let common = folder.components().zip(path.components()).take_while(|(a, b)| a == b).count();
    let up = folder.components().skip(common).map(|_| "..".to_owned());
    let down = path.components().skip(common).map(encoded);
    up.chain(down).collect::<Vec<_>>().join("/")
}

/// Returns a part of a path with all but letters, digits and a few signs as %XX.
fn encoded(part: Component) -> String {
    let mut text = String::new();
    for &byte in part.as_os_str().as_encoded_bytes() {
        if byte.is_ascii_alphanumeric() || b"-_.~".contains(&byte) {
            text.push(char::from(byte));
        } else {
            // Writing to a String cannot fail.
            let _ = write!(text, "%{byte:02X}");
        }
    }
    text
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_address_leads_from_the_folder_to_the_image() {
        let of = |folder: &str, path: &str| relative(Path::new(folder), Path::new(path));
        assert_eq!(of("/a/out", "/a/set/b 1#é.png"), "../set/b%201%23%C3%A9.png");
        assert_eq!(of("/a", "/a/x.png"), "x.png");
        assert_eq!(of("/a/b", "/c/x.png"), "../../c/x.png");
    }
}
