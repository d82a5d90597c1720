//! Declarations of image files that are reported but not applied: tone curves, orientation, pages.

use std::collections::BTreeMap;
use std::io::{self, BufReader, Cursor, Read, Seek};
use std::path::Path;

use flate2::read::ZlibDecoder;
use rayon::prelude::*;

use super::tags::{Tags, tag};
use super::{Pages, icc, jpeg, png, tiff};
use crate::finding::{Finding, Issue};
use crate::io::open;

/// Size of the beginning of PNG and JPEG files that contains profiles and EXIF blocks, bytes.
const HEAD: u64 = 1 << 20;
/// Largest size of a profile, bytes.
const LONGEST_PROFILE: u64 = 1 << 22;
/// Markers of the segments of JPEG files with EXIF blocks and profiles, and the first bytes of their contents.
const APP1: u8 = 0xe1;
const APP2: u8 = 0xe2;
const EXIF: &[u8] = b"Exif\0\0";
const ICC: &[u8] = b"ICC_PROFILE\0";
/// Value of `ColorSpace` in EXIF blocks for sRGB.
const SRGB: u64 = 1;
/// Orientation of an image that is neither rotated nor reflected.
const UPRIGHT: u64 = 1;
/// Value of `gAMA` for samples that are linear in light, which is also its unit.
const LINEAR_GAMA: u32 = 100_000;

/// Declarations of a file.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
struct Notes {
    /// Reason why the samples are not linear in light.
    curve: Option<String>,
    /// Declared rotation or reflection of the image, if there is one.
    orientation: Option<u64>,
    /// Number of pages without smaller versions and masks.
    pages: usize,
}

/// Returns findings about the declarations of image files, and about the pages that are read; all pages of a dark image are.
pub fn image_findings(
    images: &[&Path],
    pages: Pages,
    is_dark: &(dyn Fn(&Path) -> bool + Sync),
) -> Vec<Finding> {
    let notes: Vec<(String, Notes)> = images
        .par_iter()
        .map(|path| {
            let notes = notes_of(path).unwrap_or_default();
            let pages = if is_dark(path) { 1 } else { notes.pages };
            (name(path), Notes { pages, ..notes })
        })
        .collect();
    let of_curve = |(name, notes): &(String, Notes)| {
        notes.curve.clone().map(|profile| (name.clone(), profile))
    };
    let of_pages =
        |(name, notes): &(String, Notes)| (notes.pages > 1).then(|| (name.clone(), notes.pages));
    let curves = first_of(notes.iter().filter_map(of_curve));
    let several = first_of(notes.iter().filter_map(of_pages));
    let issues = [
        curves.map(|(images, first, profile)| Issue::ImageProfile { images, first, profile }),
        orientation_issue(&notes),
    ];
    let several = several.map(|(images, first, count)| match pages {
        Pages::First => Finding::caution(Issue::SeveralPages { images, first, pages: count }),
        _ => {
            Finding::note(Issue::PagesUsed { images, first, pages: count, used: pages.to_string() })
        }
    });
    issues.into_iter().flatten().map(Finding::caution).chain(several).collect()
}

/// Returns the issue that images have orientation tags, or different ones.
fn orientation_issue(notes: &[(String, Notes)]) -> Option<Issue> {
    // Groups of images by orientation: their number and the first one.
    let mut groups: BTreeMap<u64, (usize, String)> = BTreeMap::new();
    for (name, notes) in notes {
        let group = groups.entry(notes.orientation.unwrap_or(UPRIGHT));
        group.or_insert_with(|| (0, name.clone())).0 += 1;
    }
    let (&orientation, (images, first)) = groups.iter().find(|(of, _)| **of != UPRIGHT)?;
    let (images, first) = (*images, first.clone());
    Some(if groups.len() == 1 {
        Issue::ImageOrientation { images, first, orientation }
    } else {
        let groups = groups.into_iter().map(|(of, (images, first))| (of, images, first));
        Issue::OrientationsDiffer { groups: groups.collect() }
    })
}

/// Returns the number of items, and the first one.
fn first_of<T>(mut found: impl Iterator<Item = (String, T)>) -> Option<(usize, String, T)> {
    let (name, what) = found.next()?;
    Some((1 + found.count(), name, what))
}

fn name(path: &Path) -> String {
    path.file_name().unwrap_or_default().to_string_lossy().into_owned()
}

fn notes_of(path: &Path) -> io::Result<Notes> {
    let mut file = open(path)?;
    if let Some(tags) = Tags::of(BufReader::new(&file)) {
        return Ok(of_tiff(tags));
    }
    file.rewind()?;
    let mut head = Vec::new();
    file.take(HEAD).read_to_end(&mut head)?;
    Ok(if head.starts_with(jpeg::MAGIC) { of_jpeg(&head) } else { of_png(&head) })
}

fn of_tiff(mut tags: Tags<impl Read + Seek>) -> Notes {
    let count = tiff::pages(&mut tags).len();
    let first = tags.first();
    let entry = |number: u16| first.as_ref().and_then(|page| page.entry(number));
    let profile = entry(tag::ICC_PROFILE).and_then(|entry| tags.content(entry));
    let orientation = entry(tag::ORIENTATION).and_then(|entry| tags.value(entry));
    Notes {
        curve: profile.and_then(|profile| icc::curve(&profile)),
        orientation: orientation.filter(is_turned),
        pages: count,
    }
}

#[allow(clippy::trivially_copy_pass_by_ref)] // as a filter
fn is_turned(orientation: &u64) -> bool {
    (2..=8).contains(orientation)
}

/// Returns orientation and colour space of an EXIF block.
fn of_exif(block: &[u8]) -> Notes {
    let Some(mut tags) = Tags::of(Cursor::new(block)) else { return Notes::default() };
    let Some(page) = tags.first() else { return Notes::default() };
    let orientation = page.entry(tag::ORIENTATION).and_then(|entry| tags.value(entry));
    let inner = page.entry(tag::EXIF).and_then(|entry| tags.page_at(entry));
    let space = inner.and_then(|page| page.entry(tag::EXIF_COLOR_SPACE));
    let is_srgb = space.and_then(|entry| tags.value(entry)) == Some(SRGB);
    Notes {
        curve: is_srgb.then(|| "EXIF colour space sRGB".to_owned()),
        orientation: orientation.filter(is_turned),
        pages: 1,
    }
}

fn of_jpeg(head: &[u8]) -> Notes {
    let with = |wanted: u8, begin: &'static [u8]| {
        let of_kind = jpeg::header(head).filter(move |segment| segment.marker == wanted);
        of_kind.filter_map(move |segment| segment.content.strip_prefix(begin))
    };
    let exif = with(APP1, EXIF).next().map(of_exif).unwrap_or_default();
    // The first two bytes are the number of the segment and the number of segments.
    let profile: Vec<u8> =
        with(APP2, ICC).flat_map(|content| content.get(2..).unwrap_or_default()).copied().collect();
    let curve = if profile.is_empty() { exif.curve } else { icc::curve(&profile) };
    Notes { curve, ..exif }
}

fn of_png(head: &[u8]) -> Notes {
    let chunk = |wanted: &[u8; 4]| {
        png::chunks(head).find(|(name, _)| name == wanted).map(|(_, content)| content)
    };
    let exif = chunk(b"eXIf").map(of_exif).unwrap_or_default();
    // A profile takes precedence over the other chunks, and sRGB over gAMA.
    let curve = if let Some(profile) = chunk(b"iCCP").and_then(unpacked_profile) {
        icc::curve(&profile)
    } else if chunk(b"sRGB").is_some() {
        Some("sRGB chunk".to_owned())
    } else if let Some(gama) = chunk(b"gAMA").and_then(|content| content.first_chunk()) {
        let gama = u32::from_be_bytes(*gama);
        let text = format!("gAMA {}", f64::from(gama) / f64::from(LINEAR_GAMA));
        (gama != LINEAR_GAMA).then_some(text)
    } else {
        exif.curve
    };
    Notes { curve, ..exif }
}

/// Unpacks the profile in an `iCCP` chunk, which follows its name and the method of compression.
fn unpacked_profile(chunk: &[u8]) -> Option<Vec<u8>> {
    let end = chunk.iter().position(|byte| *byte == 0)?;
    let mut profile = Vec::new();
    let packed = ZlibDecoder::new(chunk.get(end + 2..)?);
    packed.take(LONGEST_PROFILE).read_to_end(&mut profile).ok()?;
    Some(profile)
}
