//! Image files.

mod dark;
mod foreign;
mod icc;
mod jpeg;
mod notes;
mod pages;
mod png;
mod raw;
mod reader;
mod scans;
mod tags;
#[cfg(test)]
mod tests;
mod tiff;

use std::borrow::Cow;
use std::error::Error as StdError;
use std::fmt::Display;
use std::fs::File;
use std::io::{self, BufReader, Cursor, ErrorKind, Write};
use std::path::Path;

use image::codecs::jpeg::JpegEncoder;
use image::codecs::png::{CompressionType, FilterType, PngEncoder};
use image::{
    DynamicImage, ExtendedColorType, ImageDecoder, ImageEncoder, ImageError, ImageFormat,
    ImageReader as FileReader,
};

use super::open;
use crate::error::{Error, Result};
use crate::image::{Color, RawImage, Samples};
use crate::quantity::counted;

pub(super) use foreign::by_name as not_read;
pub use pages::Pages;
pub use raw::{Packing, RawLayout, is_raw};
pub use reader::ImageReader;

/// Largest size of the samples of an image, bytes.
const LIMIT_BYTES: u64 = 512 << 20;

/// Content of a file before its colour is interpreted.
struct Decoded {
    width: usize,
    height: usize,
    /// Grey or RGB.
    color: Color,
    samples: Stored,
}

/// Samples of a file.
enum Stored {
    Levels(Samples),
    /// Numbers of a type that cameras do not deliver; true if they may have fractions.
    Numbers(Vec<f64>, bool),
}

impl Stored {
    fn count(&self) -> usize {
        match self {
            Self::Levels(Samples::Bits8(all)) => all.len(),
            Self::Levels(Samples::Bits16(all)) => all.len(),
            Self::Numbers(all, _) => all.len(),
        }
    }

    /// Returns the bits of grey levels; `None` for other numbers.
    fn bits(&self) -> Option<u32> {
        match self {
            Self::Levels(Samples::Bits8(_)) => Some(8),
            Self::Levels(Samples::Bits16(_)) => Some(16),
            Self::Numbers(..) => None,
        }
    }

    /// Returns grey levels of 8 or 16 bits. An error states the remedy for numbers that are no grey levels.
    fn into_levels(self) -> Result<Samples> {
        match self {
            Self::Levels(samples) => Ok(samples),
            Self::Numbers(numbers, fractions) => tiff::as_levels(&numbers, fractions),
        }
    }

    /// Returns a copy as grey levels, see [`Self::into_levels`].
    fn levels(&self) -> Result<Samples> {
        match self {
            Self::Levels(samples) => Ok(samples.clone()),
            Self::Numbers(numbers, fractions) => tiff::as_levels(numbers, *fractions),
        }
    }

    /// Returns the samples as numbers, as they are.
    fn into_numbers(self) -> Vec<f64> {
        match self {
            Self::Levels(Samples::Bits8(all)) => all.into_iter().map(f64::from).collect(),
            Self::Levels(Samples::Bits16(all)) => all.into_iter().map(f64::from).collect(),
            Self::Numbers(all, _) => all,
        }
    }
}

/// Reads an image with the [`ImageReader`] for this colour alone: one page, no dark image.
pub fn read_image(path: &Path, color: Option<Color>) -> Result<RawImage> {
    ImageReader::of_color(color).read(path)
}

/// Decodes the image in the bytes of a file.
pub(super) fn image_of(bytes: &[u8], color: Option<Color>) -> Result<RawImage> {
    pages::decoded(bytes, Pages::First).and_then(|decoded| interpreted(decoded, color))
}

/// Returns width and height, px, and grey or RGB, from the header of an image file.
pub(super) fn format_of(path: &Path) -> Result<(u32, u32, Color)> {
    header_of(path).map(|(format, _)| format)
}

/// Width, height and colour, and bytes per sample.
type Header = ((u32, u32, Color), u64);

fn header_of(path: &Path) -> Result<Header> {
    let read = |source| Error::Read { path: path.to_owned(), source };
    let file = open(path).map_err(read)?;
    let of_tiff = tags::Tags::of(BufReader::new(&file)).map(|mut tags| {
        let format = tiff::format(&mut tags);
        format.map(|format| (format, tiff::sample_bytes(&mut tags)))
    });
    let header = match of_tiff {
        Some(header) => header.ok_or_else(|| cut_off("TIFF")),
        None => File::try_clone(&file).map_err(read).and_then(header_of_others),
    };
    header.map_err(|e| e.in_file(path))
}

fn header_of_others(mut file: File) -> Result<Header> {
    io::Seek::rewind(&mut file).map_err(|e| unreadable("image", &e))?;
    let (reader, name) = reader_of(BufReader::new(file))?;
    let decoder = reader.into_decoder().map_err(|e| refused(name, &e))?;
    let (width, height) = decoder.dimensions();
    let kind = decoder.color_type();
    let color = if kind.has_color() { Color::Rgb } else { Color::Grey };
    let sample_bytes = u64::from(kind.bytes_per_pixel()) / u64::from(kind.channel_count());
    Ok(((width, height, color), sample_bytes))
}

/// Decodes a page, counted from 0 with smaller versions and masks. Only TIFF files have several pages.
fn decode(bytes: &[u8], page: usize) -> Result<Decoded> {
    if bytes.is_empty() {
        return Err(Error::invalid("this image file is empty: copy it again"));
    }
    if bytes.starts_with(jpeg::MAGIC) {
        if !jpeg::is_whole(bytes) {
            return Err(cut_off("JPEG"));
        } else if !scans::are_complete(bytes) {
            return Err(damaged("JPEG"));
        }
    }
    if tags::Tags::of(Cursor::new(bytes)).is_some()
        && let Some(decoded) = tiff::decode(bytes, page)?
    {
        return Ok(decoded);
    }
    let (reader, name) = reader_of(Cursor::new(bytes))?;
    if reader.format() == Some(ImageFormat::Png) && !png::is_whole(bytes) {
        return Err(cut_off(name));
    }
    let wrong = |e: ImageError| refused(name, &e);
    let decoder = reader.into_decoder().map_err(wrong)?;
    let (width, height) = decoder.dimensions();
    within_limit(width, height, u64::from(decoder.color_type().bytes_per_pixel()))?;
    samples_of(DynamicImage::from_decoder(decoder).map_err(wrong)?)
}

/// Returns a decoder for the format of a file, by its first bytes, and the name of the format.
fn reader_of<R: io::BufRead + io::Seek>(file: R) -> Result<(FileReader<R>, &'static str)> {
    let reader =
        FileReader::new(file).with_guessed_format().map_err(|e| unreadable("image", &e))?;
    let name = match reader.format() {
        Some(ImageFormat::Png) => "PNG",
        Some(ImageFormat::Tiff) => "TIFF",
        Some(ImageFormat::Bmp) => "BMP",
        Some(ImageFormat::Pnm) => "PGM",
        Some(ImageFormat::Jpeg) => "JPEG",
        _ => {
            return Err(Error::invalid(
                "the content is not PNG, TIFF, BMP, PGM, PPM or JPEG: save the image as PNG or \
                 TIFF with 8 or 16 bits",
            ));
        }
    };
    Ok((reader, name))
}

fn samples_of(decoded: DynamicImage) -> Result<Decoded> {
    let (width, height) = (decoded.width() as usize, decoded.height() as usize);
    let (color, samples) = match decoded {
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
            return Err(Error::invalid(format!(
                "samples of type {:?} are not supported: save the image with integers of 8 or 16 \
                 bits, linear in light",
                other.color()
            )));
        }
    };
    Ok(Decoded { width, height, color, samples: Stored::Levels(samples) })
}

/// Returns the image as samples of this colour.
fn interpreted(decoded: Decoded, color: Option<Color>) -> Result<RawImage> {
    let Decoded { width, height, color: stored, samples } = decoded;
    if width == 0 || height == 0 {
        return Err(Error::invalid(format!(
            "this image of {width} x {height} px has no pixels: save it again"
        )));
    }
    // In a contradictory header, the decoder may use another part than this function.
    let count = samples.count();
    if width.checked_mul(height).and_then(|pixels| pixels.checked_mul(stored.samples()))
        != Some(count)
    {
        return Err(damaged("image"));
    }
    let color = match (color, stored) {
        (None, stored) => stored,
        // A grey image may be stored in three channels.
        (Some(Color::Grey | Color::Rgb), Color::Rgb) => Color::Rgb,
        (Some(color), Color::Grey) if color != Color::Rgb => color,
        (Some(color), _) => {
            let channels = stored.samples();
            return Err(Error::invalid(format!(
                "this image has {}, but its colour is stated as '{}': correct the colour, or give the \
                 image as the camera delivered it",
                counted(channels, "channel"),
                color.name()
            )));
        }
    };
    Ok(RawImage { width, height, color, samples: samples.into_levels()? })
}

/// Creates the error for a file whose end is missing.
fn cut_off(format: &str) -> Error {
    Error::invalid(format!("this {format} file is cut off: copy it again, or take the image again"))
}

/// Creates the error for a file of which a part is missing or corrupt.
fn damaged(format: &str) -> Error {
    Error::invalid(format!(
        "this {format} file is damaged, and a part of the image is missing: copy it again, or take the image again"
    ))
}

/// Creates the error for a file that cannot be decoded.
fn unreadable(format: &str, reason: &dyn Display) -> Error {
    Error::invalid(format!(
        "this {format} file cannot be read ({reason}): copy it again if it is damaged, or save the \
         image as PNG or TIFF with 8 or 16 bits, grey or RGB"
    ))
}

fn refused(format: &str, error: &ImageError) -> Error {
    match error {
        ImageError::Limits(_) => Error::invalid(format!(
            "this {format} file states a size that needs more than {} MB of memory, the limit: \
             give a smaller image",
            LIMIT_BYTES >> 20
        )),
        error if is_end_of_file(error) => cut_off(format),
        // This message means that the file ends within the header of a PGM image.
        error if error.to_string().ends_with("Unexpected end of PNM header") => cut_off(format),
        error => unreadable(format, error),
    }
}

/// Returns true if an error is, or is caused by, an unexpected end of file.
fn is_end_of_file(error: &(dyn StdError + 'static)) -> bool {
    let mut cause = Some(error);
    while let Some(error) = cause {
        let of_system = match error.downcast_ref::<ImageError>() {
            Some(ImageError::IoError(error)) => Some(error),
            _ => error.downcast_ref::<io::Error>(),
        };
        if of_system.is_some_and(|error| error.kind() == ErrorKind::UnexpectedEof) {
            return true;
        }
        cause = error.source();
    }
    false
}

fn too_large(width: u32, height: u32) -> Error {
    Error::invalid(format!(
        "this image of {width} x {height} px needs more than {} MB of memory, the limit: give a \
         smaller image",
        LIMIT_BYTES >> 20
    ))
}

/// Returns an error if an image is too large.
fn within_limit(width: u32, height: u32, bytes_per_pixel: u64) -> Result<()> {
    let bytes = u64::from(width) * u64::from(height);
    match bytes.checked_mul(bytes_per_pixel) {
        Some(bytes) if bytes <= LIMIT_BYTES => Ok(()),
        _ => Err(too_large(width, height)),
    }
}

/// Writes a raw image as PNG, 8 or 16 bits, grey (also for a colour mosaic) or RGB.
pub fn write_png(out: &mut dyn Write, raw: &RawImage) -> io::Result<()> {
    let rgb = raw.color == Color::Rgb;
    let (bytes, color) = match &raw.samples {
        Samples::Bits8(samples) => {
            let color = if rgb { ExtendedColorType::Rgb8 } else { ExtendedColorType::L8 };
            (Cow::from(samples), color)
        }
        Samples::Bits16(samples) => {
            let color = if rgb { ExtendedColorType::Rgb16 } else { ExtendedColorType::L16 };
            // The encoder expects the machine's byte order.
            (samples.iter().flat_map(|s| s.to_ne_bytes()).collect(), color)
        }
    };
    let encoder = PngEncoder::new_with_quality(out, CompressionType::Fast, FilterType::Adaptive);
    encode(encoder, raw, &bytes, color)
}

/// Writes a raw image as JPEG with a quality from 1 to 100, 8 bits, grey or RGB. An error for samples of 16 bits and for a
/// colour mosaic, whose colours JPEG would mix.
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
            // The system's own message is the clearest, for example for a full disk.
            ImageError::IoError(error) => error,
            other => io::Error::other(other),
        }
    })
}
