//! Files without a header: rows of samples, whole or packed.
//!
//! Names follow the Pixel Format Naming Convention of GenICam (PFNC, EMVA), GigE Vision (`Packed`) and MIPI CSI-2 (`raw10`,
//! `raw12`). A colour mosaic has the same layout.

use std::path::Path;

use serde::Deserialize;

use super::{Decoded, Stored, within_limit};
use crate::error::{Error, Result};
use crate::image::{Color, Samples};

/// Extensions of files without a header.
const ENDINGS: [&str; 2] = ["raw", "bin"];

/// Layout of the samples of a row.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Deserialize)]
pub enum Packing {
    /// One byte each.
    Mono8,
    /// 10, 12, 14 or 16 bits in two bytes, the lower one first.
    #[serde(alias = "Mono10", alias = "Mono12", alias = "Mono14")]
    Mono16,
    /// As [`Self::Mono16`], with the upper byte first.
    Mono16BigEndian,
    /// 10 bits each, one after the other from the lowest bit of the first byte on.
    Mono10p,
    /// 12 bits each, one after the other from the lowest bit of the first byte on.
    Mono12p,
    /// Two samples in three bytes: the upper 8 bits of the first, the lower bits of both (the first in the lower half), the
    /// upper 8 bits of the second.
    Mono10Packed,
    /// As [`Self::Mono10Packed`], with 12 bits.
    Mono12Packed,
    /// Four samples in five bytes: the upper 8 bits of each, then the lower 2 bits, of the first one lowest.
    #[serde(rename = "raw10")]
    Raw10,
    /// Two samples in three bytes: the upper 8 bits of each, then the lower 4 bits, of the first one lowest.
    #[serde(rename = "raw12")]
    Raw12,
}

impl Packing {
    /// Returns the numbers of samples and bytes of a group that begins with a new byte.
    fn group(self) -> (u64, u64) {
        match self {
            Self::Mono8 => (1, 1),
            Self::Mono16 | Self::Mono16BigEndian => (1, 2),
            Self::Mono10p | Self::Raw10 => (4, 5),
            Self::Mono12p | Self::Mono10Packed | Self::Mono12Packed | Self::Raw12 => (2, 3),
        }
    }

    /// Returns the bytes of this many samples; only consecutive bits may end within a group.
    fn bytes(self, samples: u64) -> u64 {
        let (in_group, bytes) = self.group();
        match self {
            Self::Mono10p | Self::Mono12p => (samples * 8 * bytes / in_group).div_ceil(8),
            _ => samples.div_ceil(in_group) * bytes,
        }
    }

    /// Returns the samples of a group.
    fn unpacked(self, group: &[u8]) -> [u16; 4] {
        let at = |i: usize| u16::from(group.get(i).copied().unwrap_or(0));
        match self {
            Self::Mono8 => [at(0), 0, 0, 0],
            Self::Mono16 => [at(1) << 8 | at(0), 0, 0, 0],
            Self::Mono16BigEndian => [at(0) << 8 | at(1), 0, 0, 0],
            Self::Mono10p => [
                (at(1) & 0x03) << 8 | at(0),
                (at(2) & 0x0f) << 6 | at(1) >> 2,
                (at(3) & 0x3f) << 4 | at(2) >> 4,
                at(4) << 2 | at(3) >> 6,
            ],
            Self::Mono12p => [(at(1) & 0x0f) << 8 | at(0), at(2) << 4 | at(1) >> 4, 0, 0],
            Self::Mono10Packed => [at(0) << 2 | at(1) & 0x03, at(2) << 2 | at(1) >> 4 & 0x03, 0, 0],
            Self::Mono12Packed => [at(0) << 4 | at(1) & 0x0f, at(2) << 4 | at(1) >> 4, 0, 0],
            Self::Raw10 => [0, 1, 2, 3].map(|i| at(i) << 2 | at(4) >> (2 * i) & 0x03),
            Self::Raw12 => [at(0) << 4 | at(2) & 0x0f, at(1) << 4 | at(2) >> 4, 0, 0],
        }
    }
}

/// Table `[images.raw]`: layout of files without a header.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct RawLayout {
    /// Layout of a row.
    pub packing: Packing,
    /// Number of bytes before the first row.
    #[serde(default)]
    pub header_bytes: u64,
    /// Bytes from row to row; without it, rows follow each other, and packed samples continue into the next row.
    pub row_bytes: Option<u64>,
}

/// Layout and size of files without a header.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct RawFormat {
    layout: RawLayout,
    width: u32,
    height: u32,
    /// Samples per pixel.
    channels: u64,
}

/// Returns true if a file with this name has no header.
#[must_use]
pub fn is_raw(path: &Path) -> bool {
    let ending = path.extension().unwrap_or_default().to_string_lossy().to_lowercase();
    ENDINGS.contains(&ending.as_str())
}

/// Creates the error for a file without a header whose layout is not stated.
pub fn not_stated() -> Error {
    Error::invalid(
        "a .raw or .bin file has no header that states its layout: add [images.raw] to a project, with packing = \
         \"Mono12p\" (or Mono8, Mono10, Mono12, Mono14, Mono16, Mono16BigEndian, Mono10p, Mono10Packed, Mono12Packed, raw10, \
         raw12) and, if there are any, header_bytes and row_bytes, or save the image as TIFF",
    )
}

impl RawFormat {
    pub fn new(layout: RawLayout, (width, height): (u32, u32), color: Option<Color>) -> Self {
        let channels = color.map_or(1, Color::samples) as u64;
        Self { layout, width, height, channels }
    }

    /// Returns size, colour and bytes per sample in memory.
    pub fn header(&self) -> super::Header {
        let color = if self.channels == 3 { Color::Rgb } else { Color::Grey };
        let bytes = if self.layout.packing == Packing::Mono8 { 1 } else { 2 };
        ((self.width, self.height, color), bytes)
    }

    /// Decodes a file. Returns an error if the stated layout needs another size.
    pub fn decode(&self, file: &[u8]) -> Result<Decoded> {
        let Self { layout, width, height, channels } = *self;
        let RawLayout { packing, header_bytes, row_bytes } = layout;
        within_limit(width, height, 2 * channels)?;
        let in_row = u64::from(width) * channels;
        let needed = packing.bytes(in_row);
        let rows = u64::from(height);
        let per_row = row_bytes.unwrap_or(needed);
        if per_row < needed {
            return Err(Error::invalid(format!(
                "row_bytes is {per_row}, but {in_row} samples of {packing:?} need {needed} bytes: \
                 correct [images.raw]"
            )));
        }
        let whole = match row_bytes {
            // The last row may end with its samples.
            Some(_) => per_row.checked_mul(rows - 1).and_then(|bytes| bytes.checked_add(needed)),
            None => Some(packing.bytes(in_row * rows)),
        };
        let most = row_bytes.map_or(whole, |bytes| bytes.checked_mul(rows));
        let with_header = |bytes: Option<u64>| bytes.and_then(|b| b.checked_add(header_bytes));
        let (least, most) = (with_header(whole), with_header(most));
        let size = file.len() as u64;
        if least.is_none_or(|least| size < least) || most.is_none_or(|most| size > most) {
            return Err(Error::invalid(format!(
                "this file has {size} bytes, but {width} x {height} px of {packing:?} after a header ({header_bytes} bytes) \
                 {}need {}: correct [images.raw], or the size in [sensor]",
                row_bytes.map_or(String::new(), |bytes| format!("and rows of {bytes} bytes ")),
                most.map_or("more than any file".to_owned(), |most| most.to_string())
            )));
        }
        let start = usize::try_from(header_bytes).unwrap_or(usize::MAX);
        let content = file.get(start..).unwrap_or_default();
        let samples = match row_bytes {
            None => unpacked(packing, content, in_row * rows),
            Some(bytes) => {
                let stride = usize::try_from(bytes).unwrap_or(usize::MAX).max(1);
                content.chunks(stride).flat_map(|row| unpacked(packing, row, in_row)).collect()
            }
        };
        let samples = if packing == Packing::Mono8 {
            Samples::Bits8(samples.into_iter().map(|sample| sample.to_le_bytes()[0]).collect())
        } else {
            Samples::Bits16(samples)
        };
        let ((.., color), _) = self.header();
        let (width, height) = (width as usize, height as usize);
        Ok(Decoded { width, height, color, samples: Stored::Levels(samples) })
    }
}

/// Returns the first samples of packed bytes.
fn unpacked(packing: Packing, bytes: &[u8], count: u64) -> Vec<u16> {
    let (in_group, group_bytes) = packing.group();
    let (in_group, size) = (usize::try_from(in_group).unwrap_or(1), usize::try_from(group_bytes));
    let count = usize::try_from(count).unwrap_or(usize::MAX);
    let mut samples = Vec::with_capacity(count.min(bytes.len() * 2));
    for group in bytes.chunks(size.unwrap_or(1)) {
        let left = count - samples.len();
        samples.extend(&packing.unpacked(group)[..in_group.min(left)]);
    }
    samples
}
