//! Image files.

use std::io::{self, Write};

use image::codecs::png::{CompressionType, FilterType, PngEncoder};
use image::{ExtendedColorType, ImageEncoder};

use crate::image::{Color, RawImage};

/// Writes a raw image as PNG, 8 or 16 bit, grey (a colour mosaic too) or RGB.
pub fn write_png(out: &mut dyn Write, raw: &RawImage) -> io::Result<()> {
    let (bytes, color): (Vec<u8>, _) = match (raw.bits, raw.color) {
        (8, color) => {
            #[allow(clippy::cast_possible_truncation)] // 8-bit samples
            let bytes = raw.samples.iter().map(|&s| s as u8).collect();
            let rgb = color == Color::Rgb;
            (bytes, if rgb { ExtendedColorType::Rgb8 } else { ExtendedColorType::L8 })
        }
        (_, color) => {
            // The encoder takes the machine's byte order.
            let bytes = raw.samples.iter().flat_map(|s| s.to_ne_bytes()).collect();
            let rgb = color == Color::Rgb;
            (bytes, if rgb { ExtendedColorType::Rgb16 } else { ExtendedColorType::L16 })
        }
    };
    let size = |pixels: usize| u32::try_from(pixels).map_err(io::Error::other);
    PngEncoder::new_with_quality(out, CompressionType::Fast, FilterType::Adaptive)
        .write_image(&bytes, size(raw.width)?, size(raw.height)?, color)
        .map_err(io::Error::other)
}
