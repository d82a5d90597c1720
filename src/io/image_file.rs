//! Image files.

use std::io::{self, BufReader, Write};
use std::path::Path;

use image::codecs::png::{CompressionType, FilterType, PngEncoder};
use image::{DynamicImage, ExtendedColorType, ImageEncoder, ImageReader};

use crate::error::{Error, Result};
use crate::image::{Color, RawImage};

/// Reads a PNG, TIFF, BMP, PGM/PPM or JPEG file of 8 or 16 bits; transparency is passed over.
///
/// `color` says what the samples stand for; without it grey or RGB, as the file has them. A file of
/// three channels cannot be a colour mosaic, and one of a single channel cannot be RGB.
pub fn read_image(path: &Path, color: Option<Color>) -> Result<RawImage> {
    let file = std::fs::File::open(path)
        .map_err(|source| Error::Read { path: path.to_owned(), source })?;
    let decoded = ImageReader::new(BufReader::new(file))
        .with_guessed_format()
        .map_err(|source| Error::Read { path: path.to_owned(), source })?
        .decode()
        .map_err(|e| Error::content(path, format!("this image cannot be read: {e}")))?;
    let (width, height) = (decoded.width() as usize, decoded.height() as usize);
    let wide = |samples: Vec<u8>| samples.into_iter().map(u16::from).collect();
    let (stored, bits, samples): (Color, u32, Vec<u16>) = match decoded {
        DynamicImage::ImageLuma8(image) => (Color::Grey, 8, wide(image.into_raw())),
        DynamicImage::ImageLuma16(image) => (Color::Grey, 16, image.into_raw()),
        DynamicImage::ImageRgb16(image) => (Color::Rgb, 16, image.into_raw()),
        DynamicImage::ImageRgba16(_) => (Color::Rgb, 16, decoded.into_rgb16().into_raw()),
        DynamicImage::ImageLumaA8(_) => (Color::Grey, 8, wide(decoded.into_luma8().into_raw())),
        DynamicImage::ImageLumaA16(_) => (Color::Grey, 16, decoded.into_luma16().into_raw()),
        DynamicImage::ImageRgb8(image) => (Color::Rgb, 8, wide(image.into_raw())),
        other => (Color::Rgb, 8, wide(other.into_rgb8().into_raw())),
    };
    let color = match (color, stored) {
        (None, stored) => stored,
        // A grey picture may be stored in three channels.
        (Some(Color::Grey | Color::Rgb), Color::Rgb) => Color::Rgb,
        (Some(color), Color::Grey) if color != Color::Rgb => color,
        (Some(color), _) => {
            let channels = stored.samples();
            return Err(Error::content(
                path,
                format!(
                    "this image has {channels} channel(s), but is said to be '{}': correct the \
                     colour, or give the image as the camera delivered it",
                    color.name()
                ),
            ));
        }
    };
    Ok(RawImage { width, height, color, bits, samples })
}

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
