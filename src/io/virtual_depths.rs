//! Virtual depths by other software: CSV of single points, and maps.

use std::path::Path;

use super::observations_file::read_virtual_rows;
use super::read_bytes;
use crate::error::{Error, Result};
use crate::image::{Color, RawImage, Samples};
use crate::solver::VirtualPoint;

/// A map of virtual depths, row by row; NaN where there is none.
#[derive(Debug, Clone, PartialEq)]
pub struct DepthMap {
    /// Columns, px.
    pub width: usize,
    /// Rows, px.
    pub height: usize,
    /// ν of each pixel.
    pub depths: Vec<f64>,
}

/// What a file of virtual depths has.
#[derive(Debug, Clone, PartialEq)]
pub enum VirtualDepths {
    /// One point in each line of a CSV file.
    Points(Vec<VirtualPoint>),
    /// Depths by pixel, from a `.npy` file of numbers or from an image.
    Map(DepthMap),
    /// A CSV file without depths: features, from which points are triangulated.
    Features,
}

/// First bytes of a `.npy` file.
const NPY: &[u8] = b"\x93NUMPY";
/// What an image lacks.
const LEVELS: &str = "what its grey levels mean is not known: give A and B if the virtual depth is A + B times the level";

/// Reads virtual depths. In an image, the depth is `scale[0]` + `scale[1]` times the grey level of the file, and level 0
/// stands for no depth. σ of points in CSV files is `std_dev` (u, v and ν) where they state none.
///
/// An error says what is wrong in the file, or that it is an image and no scale is given.
pub fn read_virtual_depths(
    path: &Path,
    scale: Option<[f64; 2]>,
    std_dev: [f64; 3],
) -> Result<VirtualDepths> {
    let bytes = read_bytes(path)?;
    if bytes.starts_with(NPY) {
        return depths_of_npy(&bytes).map(VirtualDepths::Map).map_err(|e| e.in_file(path));
    }
    let first_line = bytes.split(|b| *b == b'\n').next().unwrap_or_default();
    // Columns that are separated otherwise are refused by the reader of CSV, which says how.
    let names: Vec<&str> = std::str::from_utf8(first_line)
        .unwrap_or_default()
        .trim_start_matches('\u{feff}')
        .split([',', ';', '\t'])
        .map(str::trim)
        .collect();
    if names.contains(&"k") {
        if names.contains(&"nu") {
            return read_virtual_rows(path, &bytes, std_dev).map(VirtualDepths::Points);
        }
        return Ok(VirtualDepths::Features);
    }
    let image = super::read_image(path, Some(Color::Grey))?;
    let scale = scale.ok_or_else(|| Error::content(path, LEVELS))?;
    Ok(VirtualDepths::Map(depths_of_image(&image, scale)))
}

fn depths_of_image(image: &RawImage, [offset, factor]: [f64; 2]) -> DepthMap {
    let depth = |level: f64| if level > 0.0 { offset + factor * level } else { f64::NAN };
    let depths = match &image.samples {
        Samples::Bits8(levels) => levels.iter().map(|level| depth(f64::from(*level))).collect(),
        Samples::Bits16(levels) => levels.iter().map(|level| depth(f64::from(*level))).collect(),
    };
    DepthMap { width: image.width, height: image.height, depths }
}

/// The numbers of a `.npy` file with two dimensions, `<f4` or `<f8`, in C order.
fn depths_of_npy(bytes: &[u8]) -> Result<DepthMap> {
    let wrong = |what: &str| Error::invalid(format!("this .npy file {what}"));
    let version = *bytes.get(6).ok_or_else(|| wrong("is cut off"))?;
    let (begin, length) = match version {
        1 => (10, bytes.get(8..10).map(|b| usize::from(u16::from_le_bytes([b[0], b[1]])))),
        2 | 3 => {
            let length = bytes.get(8..12).map(|b| u32::from_le_bytes([b[0], b[1], b[2], b[3]]));
            (12, length.and_then(|length| usize::try_from(length).ok()))
        }
        _ => return Err(wrong("is of a version that is not known")),
    };
    let end = length.and_then(|length| length.checked_add(begin)).unwrap_or(usize::MAX);
    let header = bytes.get(begin..end).ok_or_else(|| wrong("is cut off"))?;
    let header = std::str::from_utf8(header).map_err(|_| wrong("has a header that is no text"))?;
    let value = |key: &str| {
        let at = header.find(&format!("'{key}':"))? + key.len() + 3;
        Some(header[at..].trim_start())
    };
    let kind = value("descr").unwrap_or_default();
    let size = match kind {
        kind if kind.starts_with("'<f4'") => 4,
        kind if kind.starts_with("'<f8'") => 8,
        _ => return Err(wrong("does not have floating-point numbers, '<f4' or '<f8'")),
    };
    if !value("fortran_order").is_some_and(|order| order.starts_with("False")) {
        return Err(wrong("is in Fortran's order: save numpy.ascontiguousarray of the array"));
    }
    let shape = value("shape").and_then(|shape| shape.strip_prefix('(')?.split(')').next());
    let sizes: Vec<usize> =
        shape.unwrap_or_default().split(',').filter_map(|n| n.trim().parse().ok()).collect();
    let [height, width] = sizes[..] else {
        return Err(wrong("does not have two dimensions, height and width"));
    };
    let count = width.checked_mul(height).and_then(|count| count.checked_mul(size));
    let data = &bytes[end..];
    if count != Some(data.len()) {
        return Err(wrong("does not have as many numbers as its shape says"));
    }
    let depths = data.chunks_exact(size).map(|number| match number {
        [a, b, c, d] => f64::from(f32::from_le_bytes([*a, *b, *c, *d])),
        number => f64::from_le_bytes(number.try_into().unwrap_or_default()),
    });
    Ok(DepthMap { width, height, depths: depths.collect() })
}
