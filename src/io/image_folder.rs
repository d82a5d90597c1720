//! Folder of images, sorted into the lists of a project by the names of its folders and files.

use std::cmp::Ordering;
use std::collections::HashSet;
use std::fs;
use std::path::{Path, PathBuf};

use super::image_file::{format_of, is_raw, not_read};
use crate::error::{Error, Result};
use crate::image::Color;
use crate::model::optics;

/// F-number in a file name.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum NamedFNumber {
    /// F-number as engraved on lenses, such as 5.6, which stands for 5.657.
    Stop(f64),
    /// Any other number, taken as written.
    FNumber(f64),
}

impl NamedFNumber {
    fn of(number: f64) -> Self {
        if ENGRAVED.contains(&number) { Self::Stop(number) } else { Self::FNumber(number) }
    }

    /// Returns the number in the name.
    fn number(self) -> f64 {
        match self {
            Self::Stop(number) | Self::FNumber(number) => number,
        }
    }

    /// Returns true if lenses have such a stop. Any other number in a name may be the number of an image.
    fn is_stop(self) -> bool {
        let number = self.number();
        ENGRAVED.contains(&number)
            || (number / optics::f_number_of_stop(number) - 1.0).abs() < ROUNDED
    }
}

/// Images of a folder, each list in natural order (2 before 10).
#[derive(Debug, Clone, PartialEq, Default)]
pub struct SortedImages {
    /// White images, with the f-number if a name states one.
    pub whites: Vec<(PathBuf, Option<NamedFNumber>)>,
    /// White images in the light of the boards; a project uses one.
    pub devignetting: Vec<PathBuf>,
    /// Images without light; a project uses one.
    pub dark: Vec<PathBuf>,
    /// Boards of the calibration.
    pub calibration: Vec<PathBuf>,
    /// Boards of the evaluation.
    pub evaluation: Vec<PathBuf>,
    /// Images of a board moved along the optical axis.
    pub translation: Vec<PathBuf>,
    /// Images whose names do not indicate their content, or are contradictory.
    pub unsorted: Vec<PathBuf>,
    /// Files with the name of an image that cannot be used, and the reason.
    pub skipped: Vec<(PathBuf, &'static str)>,
}

/// Format shared by all sorted images.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct CommonFormat {
    /// Width, px.
    pub width_px: u32,
    /// Height, px.
    pub height_px: u32,
    /// RGB if all files have three channels, grey if all have one. Files do not state whether a single channel is grey or a
    /// colour mosaic. `None` if they differ.
    pub channels: Option<Color>,
}

const ENDINGS: [&str; 10] =
    ["png", "tif", "tiff", "bmp", "pgm", "ppm", "pnm", "jpg", "jpeg", "raw"];
/// F-numbers of full stops and thirds of stops, as engraved on lenses.
#[rustfmt::skip]
const ENGRAVED: [f64; 35] = [
    0.95, 1.0, 1.1, 1.2, 1.4, 1.6, 1.8, 2.0, 2.2, 2.5, 2.8, 3.2, 3.5, 4.0, 4.5, 5.0, 5.6, 6.3, 7.1,
    8.0, 9.0, 10.0, 11.0, 13.0, 14.0, 16.0, 18.0, 20.0, 22.0, 25.0, 29.0, 32.0, 36.0, 40.0, 45.0,
];
/// Relative rounding of f-numbers of two digits in names.
const ROUNDED: f64 = 2e-3;
/// Largest f-number.
const LARGEST: f64 = 128.0;
/// Largest number of files that a message names.
const NAMED: usize = 8;

#[derive(Clone, Copy, PartialEq, Eq)]
enum Kind {
    White,
    Devignetting,
    Dark,
    Calibration,
    Evaluation,
    Translation,
}

/// Finds PNG, TIFF, BMP, PGM/PPM and JPEG files, and `.raw` files without a header, in a folder and its subfolders, and
/// sorts them by their paths in the folder. Hidden files are skipped. Broken links, pipes, images of formats that are not read,
/// and names that a project file cannot contain are skipped and listed.
///
/// An error if there are no images.
pub fn sort_images(folder: &Path) -> Result<SortedImages> {
    let mut found = Vec::new();
    images_in(folder, &mut HashSet::new(), &mut found)?;
    let (mut files, mut skipped) = (Vec::new(), Vec::new());
    for path in found {
        match unusable(&path, folder) {
            None => files.push(path),
            Some(reason) => skipped.push((path, reason)),
        }
    }
    if files.is_empty() {
        let first = skipped.first().map(|(path, reason)| {
            let name = path.file_name().unwrap_or_default().to_string_lossy();
            format!(" ({name}, for example, is skipped: {reason})")
        });
        let message = format!(
            "there are no images in this folder{}: give a folder with PNG, TIFF, BMP, PGM or JPEG \
             files",
            first.unwrap_or_default()
        );
        return Err(Error::content(folder, message));
    }
    let below =
        |path: &Path| path.strip_prefix(folder).unwrap_or(path).to_string_lossy().into_owned();
    files.sort_by(|a, b| natural_order(&below(a), &below(b)));
    let mut sorted = SortedImages { skipped, ..SortedImages::default() };
    for path in files {
        let name = below(&path);
        let name = name.rsplit_once('.').map_or(name.as_str(), |(stem, _)| stem).to_lowercase();
        let f_number = named_f_number(&name);
        // If the name states nothing else, an f-number indicates a white image.
        let only_stop = || f_number.filter(|n| n.is_stop()).map(|_| Kind::White);
        match kind(&name) {
            Ok(found) => match found.or_else(only_stop) {
                Some(Kind::White) => sorted.whites.push((path, f_number)),
                Some(Kind::Devignetting) => sorted.devignetting.push(path),
                Some(Kind::Dark) => sorted.dark.push(path),
                Some(Kind::Calibration) => sorted.calibration.push(path),
                Some(Kind::Evaluation) => sorted.evaluation.push(path),
                Some(Kind::Translation) => sorted.translation.push(path),
                None => sorted.unsorted.push(path),
            },
            Err(Contradiction) => sorted.unsorted.push(path),
        }
    }
    Ok(sorted)
}

/// Returns the reason why a file in a folder cannot be used in a project.
fn unusable(path: &Path, folder: &Path) -> Option<&'static str> {
    let Ok(metadata) = fs::metadata(path) else {
        return Some("the target of the link does not exist");
    };
    if !metadata.is_file() {
        return Some("it is a pipe or a device");
    }
    let below = path.strip_prefix(folder).unwrap_or(path);
    let rename = || below.to_str().is_none().then_some("its name is not UTF-8: rename it");
    not_read(path).or_else(rename)
}

fn images_in(folder: &Path, seen: &mut HashSet<PathBuf>, images: &mut Vec<PathBuf>) -> Result<()> {
    let unreadable = |source| Error::Read { path: folder.to_owned(), source };
    // Links may form a cycle.
    if !seen.insert(fs::canonicalize(folder).map_err(unreadable)?) {
        return Ok(());
    }
    for entry in fs::read_dir(folder).map_err(unreadable)? {
        let path = entry.map_err(unreadable)?.path();
        let hidden = path.file_name().is_some_and(|n| n.to_string_lossy().starts_with('.'));
        let ending = path.extension().map(|e| e.to_string_lossy().to_lowercase());
        if hidden {
            continue;
        }
        if path.is_dir() {
            images_in(&path, seen, images)?;
        } else if ending.is_some_and(|e| ENDINGS.contains(&e.as_str())) || not_read(&path).is_some()
        {
            images.push(path);
        }
    }
    Ok(())
}

/// Compares runs of digits by value, and other characters without regard to case.
fn natural_order(a: &str, b: &str) -> Ordering {
    fn split(text: &str) -> (&str, &str) {
        let digits = text.starts_with(|c: char| c.is_ascii_digit());
        let end = text.find(|c: char| c.is_ascii_digit() != digits).unwrap_or(text.len());
        text.split_at(end)
    }
    let (mut rest_a, mut rest_b) = (a, b);
    while !rest_a.is_empty() && !rest_b.is_empty() {
        let ((part_a, after_a), (part_b, after_b)) = (split(rest_a), split(rest_b));
        let digits = |part: &str| part.starts_with(|c: char| c.is_ascii_digit());
        let order = if digits(part_a) && digits(part_b) {
            let (x, y) = (part_a.trim_start_matches('0'), part_b.trim_start_matches('0'));
            x.len().cmp(&y.len()).then_with(|| x.cmp(y))
        } else {
            part_a.to_lowercase().cmp(&part_b.to_lowercase())
        };
        if order != Ordering::Equal {
            return order;
        }
        (rest_a, rest_b) = (after_a, after_b);
    }
    rest_a.len().cmp(&rest_b.len()).then_with(|| a.cmp(b))
}

struct Contradiction;

/// Returns the content of an image according to its lower-case name. Words of the file take precedence over words of its
/// folders, and words for one subset over words for any board.
fn kind(name: &str) -> std::result::Result<Option<Kind>, Contradiction> {
    let of_parts = |of_part: fn(&str) -> Option<Kind>| name.rsplit('/').filter_map(of_part);
    let clear: Vec<Kind> = of_parts(clear_kind).collect();
    let is_board = |kind: &Kind| !matches!(kind, Kind::White | Kind::Devignetting | Kind::Dark);
    if let [first, rest @ ..] = clear.as_slice() {
        let contradicted = rest.iter().any(|kind| is_board(kind) && kind != first);
        return if is_board(first) && contradicted { Err(Contradiction) } else { Ok(Some(*first)) };
    }
    Ok(of_parts(unclear_kind).next())
}

fn words(part: &str) -> impl Iterator<Item = &str> {
    part.split(|c: char| !c.is_alphabetic()).filter(|word| !word.is_empty())
}

fn clear_kind(part: &str) -> Option<Kind> {
    const CONTAINED: [(&str, Kind); 5] = [
        ("devign", Kind::Devignetting),
        ("vignett", Kind::Devignetting),
        ("white", Kind::White),
        ("calib", Kind::Calibration),
        ("translation", Kind::Translation),
    ];
    const DARK: [&str; 4] = ["dark", "darks", "darkframe", "darkframes"];
    const BEGINNING: [(&str, Kind); 2] = [("eval", Kind::Evaluation), ("step", Kind::Translation)];
    let contained = CONTAINED.iter().find(|(word, _)| part.contains(word));
    let begun = || BEGINNING.iter().find(|(start, _)| words(part).any(|w| w.starts_with(start)));
    let is_dark = unclear_kind(part).is_none() && words(part).any(|word| DARK.contains(&word));
    let dark = is_dark.then_some(Kind::Dark);
    match contained.or_else(begun).map(|&(_, kind)| kind) {
        // A dark image may name the images that it belongs to.
        Some(Kind::White | Kind::Devignetting) | None if dark.is_some() => dark,
        kind => kind,
    }
}

fn unclear_kind(part: &str) -> Option<Kind> {
    let board =
        |word: &str| ["board", "check", "chess"].iter().any(|start| word.starts_with(start));
    words(part).any(board).then_some(Kind::Calibration)
}

/// Returns the f-number in a lower-case name: of the file, otherwise of the innermost folder that has one. `None` if a name has
/// two different ones.
fn named_f_number(name: &str) -> Option<NamedFNumber> {
    let numbers = name.rsplit('/').map(f_numbers).find(|numbers| !numbers.is_empty())?;
    let first = *numbers.first()?;
    let same = numbers.iter().all(|n| n.to_bits() == first.to_bits());
    same.then(|| NamedFNumber::of(first))
}

/// Returns the numbers after a separate letter f or n: f4.0, f_5.6, n-11.31, N8.
fn f_numbers(part: &str) -> Vec<f64> {
    let mut found = Vec::new();
    for (at, letter) in part.char_indices() {
        let alone = !part[..at].ends_with(char::is_alphanumeric);
        if !alone || !matches!(letter, 'f' | 'n') {
            continue;
        }
        let rest = &part[at + 1..];
        let rest = rest.strip_prefix(['-', '_', '=', ' ']).unwrap_or(rest);
        let end = rest.find(|c: char| !c.is_ascii_digit() && c != '.').unwrap_or(rest.len());
        let digits = rest[..end].trim_end_matches('.');
        // A number such as 01 counts images.
        let counts = digits.len() > 1 && digits.starts_with('0') && !digits.starts_with("0.");
        let number = digits.parse::<f64>().ok().filter(|n| (0.5..=LARGEST).contains(n));
        if let (Some(number), false) = (number, counts) {
            found.push(number);
        }
    }
    found
}

impl SortedImages {
    /// Returns all sorted images.
    pub fn sorted(&self) -> impl Iterator<Item = &Path> {
        let whites = self.whites.iter().map(|(path, _)| path);
        let boards = self.calibration.iter().chain(&self.evaluation).chain(&self.translation);
        whites.chain(&self.devignetting).chain(&self.dark).chain(boards).map(PathBuf::as_path)
    }

    /// Returns true if some images are files without a header.
    pub fn has_raw(&self) -> bool {
        self.sorted().any(is_raw)
    }

    /// Returns size and channels of the sorted images with a header; `None` if there are none. An error names the
    /// images that differ in size from most.
    pub fn common_format(&self) -> Result<Option<CommonFormat>> {
        let with_header = self.sorted().filter(|path| !is_raw(path));
        let formats = with_header.map(|path| Ok((path, format_of(path)?)));
        let formats = formats.collect::<Result<Vec<(&Path, (u32, u32, Color))>>>()?;
        let size = |&(_, (width, height, _)): &(&Path, (u32, u32, Color))| (width, height);
        let alike = |this| formats.iter().filter(|format| size(format) == this).count();
        // If two sizes are equally frequent, the first one is used.
        let Some((width_px, height_px)) =
            formats.iter().rev().map(size).max_by_key(|&this| alike(this))
        else {
            return Ok(None);
        };
        let other = formats.iter().filter(|format| size(format) != (width_px, height_px));
        let other: Vec<String> = other
            .map(|&(path, (width, height, _))| format!("  {}: {width} x {height}", path.display()))
            .collect();
        if !other.is_empty() {
            let more = other.len().saturating_sub(NAMED);
            return Err(Error::invalid(format!(
                "{} of {} images have {width_px} x {height_px} px, but these have another \
                 size:\n{}{}\nGive all images uncropped, as the camera delivered them, or remove \
                 these from the folder",
                formats.len() - other.len(),
                formats.len(),
                other[..other.len().min(NAMED)].join("\n"),
                if more > 0 { format!("\n  and {more} more") } else { String::new() }
            )));
        }
        let (_, (.., first)) = formats[0];
        let channels = formats.iter().all(|&(_, (.., color))| color == first).then_some(first);
        Ok(Some(CommonFormat { width_px, height_px, channels }))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_count_by_their_value() {
        let mut names = ["b/2.png", "a10.png", "B/10.png", "a2.png", "a02.png"];
        names.sort_by(|a, b| natural_order(a, b));
        assert_eq!(names, ["a02.png", "a2.png", "a10.png", "b/2.png", "B/10.png"]);
    }

    #[test]
    fn f_numbers_of_names() {
        use NamedFNumber::{FNumber, Stop};
        for (name, expected) in [
            ("white-0-n-4.00", Some(Stop(4.0))),
            ("whites/white-1-n-5.66", Some(FNumber(5.66))),
            ("white_f4.0_03", Some(Stop(4.0))),
            ("f_5.6", Some(Stop(5.6))),
            ("n8", Some(Stop(8.0))),
            ("f_5.6/03", Some(Stop(5.6))),
            ("f8/white_f11", Some(Stop(11.0))),
            ("f4_n8", None),
            ("n01", None),
            ("img_4", None),
            ("frame4", None),
            ("screen8", None),
            ("n1234", None),
        ] {
            assert_eq!(named_f_number(name), expected, "{name}");
        }
        assert!(FNumber(5.66).is_stop() && !FNumber(3.0).is_stop());
    }

    #[test]
    fn kinds_of_names() {
        for (name, expected) in [
            ("whites/img-03", Some(Kind::White)),
            ("calibration/white-f4", Some(Kind::White)),
            ("whites/devignetting", Some(Kind::Devignetting)),
            ("calib_03", Some(Kind::Calibration)),
            ("boards/7", Some(Kind::Calibration)),
            ("white-f4-dark", Some(Kind::Dark)),
            ("darks/white-f4", Some(Kind::White)),
            ("dark/03", Some(Kind::Dark)),
            ("board-dark-03", Some(Kind::Calibration)),
            ("darkroom", None),
            ("evaluation/board-02", Some(Kind::Evaluation)),
            ("eval03", Some(Kind::Evaluation)),
            ("medieval", None),
            ("step-10/board", Some(Kind::Translation)),
            ("img_0007", None),
        ] {
            assert!(kind(name).is_ok_and(|kind| kind == expected), "{name}");
        }
        assert!(kind("eval/calib-03").is_err());
    }
}
