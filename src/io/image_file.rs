//! Image files.

use std::borrow::Cow;
use std::io::{self, Cursor, Write};
use std::path::Path;

use image::codecs::jpeg::JpegEncoder;
use image::codecs::png::{CompressionType, FilterType, PngEncoder};
use image::{DynamicImage, ExtendedColorType, ImageEncoder, ImageError, ImageReader};

use super::read_bytes;
use crate::error::{Error, Result};
use crate::image::{Color, RawImage, Samples};

/// Reads a PNG, TIFF, BMP, PGM/PPM or JPEG file of 8 or 16 bits; transparency is ignored.
///
/// `color` says what the samples stand for; without it they are grey or RGB, as in the file. A file
/// with three channels cannot be a colour mosaic, and one with a single channel cannot be RGB.
pub fn read_image(path: &Path, color: Option<Color>) -> Result<RawImage> {
    // Read whole before it is decoded: a failure of the disk is one of reading, not of the image.
    let bytes = read_bytes(path)?;
    let decoded = ImageReader::new(Cursor::new(bytes))
        .with_guessed_format()
        .map_err(|source| Error::Read { path: path.to_owned(), source })?
        .decode()
        .map_err(|e| Error::content(path, format!("this image cannot be read: {e}")))?;
    let (width, height) = (decoded.width() as usize, decoded.height() as usize);
    if width == 0 || height == 0 {
        return Err(Error::content(
            path,
            format!("this image of {width} x {height} px is empty: save it again"),
        ));
    }
    let (stored, samples) = match decoded {
        DynamicImage::ImageLuma8(image) => (Color::Grey, Samples::Bits8(image.into_raw())),
        DynamicImage::ImageLuma16(image) => (Color::Grey, Samples::Bits16(image.into_raw())),
        DynamicImage::ImageRgb16(_) | DynamicImage::ImageRgba16(_) => {
            (Color::Rgb, Samples::Bits16(decoded.into_rgb16().into_raw()))
        }
        DynamicImage::ImageLumaA8(_) => {
            (Color::Grey, Samples::Bits8(decoded.into_luma8().into_raw()))
        }
        DynamicImage::ImageLumaA16(_) => {
            (Color::Grey, Samples::Bits16(decoded.into_luma16().into_raw()))
        }
        DynamicImage::ImageRgb8(_) | DynamicImage::ImageRgba8(_) => {
            (Color::Rgb, Samples::Bits8(decoded.into_rgb8().into_raw()))
        }
        other => {
            return Err(Error::content(
                path,
                format!(
                    "samples of the kind {:?} are not supported: save the image with whole numbers \
                     of 8 or 16 bits, linear in light",
                    other.color()
                ),
            ));
        }
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
    Ok(RawImage { width, height, color, samples })
}

/// Writes a raw image as PNG, 8 or 16 bit, grey (a colour mosaic too) or RGB.
pub fn write_png(out: &mut dyn Write, raw: &RawImage) -> io::Result<()> {
    let rgb = raw.color == Color::Rgb;
    let (bytes, color) = match &raw.samples {
        Samples::Bits8(samples) => {
            let color = if rgb { ExtendedColorType::Rgb8 } else { ExtendedColorType::L8 };
            (Cow::from(samples), color)
        }
        Samples::Bits16(samples) => {
            let color = if rgb { ExtendedColorType::Rgb16 } else { ExtendedColorType::L16 };
            // The encoder takes the machine's byte order.
            (samples.iter().flat_map(|s| s.to_ne_bytes()).collect(), color)
        }
    };
    let encoder = PngEncoder::new_with_quality(out, CompressionType::Fast, FilterType::Adaptive);
    encode(encoder, raw, &bytes, color)
}

/// Writes a raw image as JPEG of a quality from 1 to 100, 8 bit, grey or RGB. An error for samples of 16 bits
/// and for a colour mosaic, whose colours JPEG would mix.
pub fn write_jpeg(out: &mut dyn Write, raw: &RawImage, quality: u8) -> io::Result<()> {
    let (Samples::Bits8(samples), Color::Grey | Color::Rgb) = (&raw.samples, raw.color) else {
        return Err(io::Error::other(
            "only images of 8 bits, grey or rgb, can be written as JPEG: write this one as PNG",
        ));
    };
    let rgb = raw.color == Color::Rgb;
    let color = if rgb { ExtendedColorType::Rgb8 } else { ExtendedColorType::L8 };
    encode(JpegEncoder::new_with_quality(out, quality), raw, samples, color)
}

fn encode(
    encoder: impl ImageEncoder,
    raw: &RawImage,
    bytes: &[u8],
    color: ExtendedColorType,
) -> io::Result<()> {
    let size = |pixels: usize| u32::try_from(pixels).map_err(io::Error::other);
    encoder.write_image(bytes, size(raw.width)?, size(raw.height)?, color).map_err(|error| {
        match error {
            // A full disk, for example: the system's own message says it best.
            ImageError::IoError(error) => error,
            other => io::Error::other(other),
        }
    })
}
