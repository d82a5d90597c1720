//! TIFF files: grey and RGB with any depth and type of numbers, palettes, transparency, `BigTIFF`.
//!
//! Samples become grey levels of 8 or 16 bits without scaling, since scaling would change black level and saturation of the
//! file. Samples that do not fit are refused, with a remedy.

use std::io::Cursor;

use tiff::ColorType;
use tiff::decoder::{Decoder, DecodingResult, Limits};

use super::tags::{Page, Tags, tag};
use super::{
    Decoded, LIMIT_BYTES, Stored, cut_off, is_end_of_file, too_large, unreadable, within_limit,
};
use crate::error::{Error, Result};
use crate::image::{Color, Samples};

/// Values of `PhotometricInterpretation` for a palette, and for images in which 0 is white or black.
const PALETTE: u64 = 3;
const WHITE_IS_ZERO: u64 = 0;
const BLACK_IS_ZERO: u16 = 1;
/// Value of `SampleFormat` for whole numbers without sign.
const UNSIGNED: u64 = 1;
/// Bit of `NewSubfileType` for a smaller version of another page.
pub const REDUCED: u64 = 1;
/// Bit of `NewSubfileType` for a mask.
pub const MASK: u64 = 4;
/// Least allowed maximum of samples with fractions: rounding to whole levels then changes no sample by more than half a
/// thousandth of the maximum.
const LEAST_WITH_FRACTIONS: f64 = 1023.0;
const MOST: f64 = 65_535.0;

/// Description of a page in its tags.
struct Described {
    width: u64,
    height: u64,
    bits: u64,
    photometric: Option<u64>,
    /// True if samples are whole numbers without sign.
    unsigned: bool,
    /// Number of channels, if some of them are neither grey or RGB nor a single transparency.
    unknown_channels: Option<u64>,
    palette: Option<(Vec<u64>, u64)>,
    reduced: bool,
}

fn described(bytes: &[u8], page: usize) -> Option<(Described, [u8; 2])> {
    let mut tags = Tags::of(Cursor::new(bytes))?;
    let page = tags.pages().into_iter().nth(page)?;
    let mut all = |number: u16| page.entry(number).and_then(|entry| tags.values(entry));
    let mut one = |number: u16| all(number).and_then(|values| values.first().copied());
    let photometric = one(tag::PHOTOMETRIC);
    let bits = one(tag::BITS).unwrap_or(1);
    let samples = one(tag::SAMPLES_PER_PIXEL).unwrap_or(1);
    let width = one(tag::WIDTH)?;
    let height = one(tag::HEIGHT)?;
    let unsigned = one(tag::SAMPLE_FORMAT).unwrap_or(UNSIGNED) == UNSIGNED;
    let reduced = one(tag::SUBFILE_TYPE).unwrap_or(0) & REDUCED != 0;
    let extra = all(tag::EXTRA_SAMPLES);
    let map = all(tag::COLOR_MAP);
    let is_grey = matches!(photometric, Some(WHITE_IS_ZERO | 1));
    let known = match &extra {
        None => samples == 1 || !is_grey,
        Some(extra) => extra.is_empty() || matches!(extra[..], [1 | 2]),
    };
    let at = page.entry(tag::PHOTOMETRIC).map(|entry| entry.at);
    let palette = (photometric == Some(PALETTE)).then_some(()).and(map.zip(at));
    let unknown_channels = (!known).then_some(samples);
    let black_is_zero = tags.encoded(BLACK_IS_ZERO);
    let described = Described {
        width,
        height,
        bits,
        photometric,
        unsigned,
        unknown_channels,
        palette,
        reduced,
    };
    Some((described, black_is_zero))
}

/// Returns width, height and channels, from the tags.
pub fn format(tags: &mut Tags<impl std::io::Read + std::io::Seek>) -> Option<(u32, u32, Color)> {
    let page = tags.first()?;
    let mut one = |number: u16| page.entry(number).and_then(|entry| tags.value(entry));
    let edge = |size: Option<u64>| size.and_then(|size| u32::try_from(size).ok());
    let grey = matches!(one(tag::PHOTOMETRIC), Some(WHITE_IS_ZERO | 1));
    let (width, height) = (edge(one(tag::WIDTH))?, edge(one(tag::HEIGHT))?);
    let color = if grey || palette_of(tags, &page).is_some_and(|map| is_grey(&map)) {
        Color::Grey
    } else {
        Color::Rgb
    };
    Some((width, height, color))
}

/// Returns the size of a sample in memory, bytes.
pub fn sample_bytes(tags: &mut Tags<impl std::io::Read + std::io::Seek>) -> u64 {
    let page = tags.first();
    let bits = page.and_then(|page| page.entry(tag::BITS).and_then(|entry| tags.value(entry)));
    if bits.unwrap_or(1) > 8 { 2 } else { 1 }
}

fn palette_of(
    tags: &mut Tags<impl std::io::Read + std::io::Seek>,
    page: &Page,
) -> Option<Vec<u64>> {
    let is_palette = |number| number == PALETTE;
    page.entry(tag::PHOTOMETRIC).and_then(|entry| tags.value(entry)).filter(|n| is_palette(*n))?;
    page.entry(tag::COLOR_MAP).and_then(|entry| tags.values(entry))
}

/// Returns true if red, green and blue of a palette are equal.
fn is_grey(map: &[u64]) -> bool {
    let n = map.len() / 3;
    map[..n] == map[n..2 * n] && map[..n] == map[2 * n..3 * n]
}

/// Returns the places of the pages that are neither smaller versions nor masks.
pub fn pages(tags: &mut Tags<impl std::io::Read + std::io::Seek>) -> Vec<usize> {
    let pages = tags.pages();
    let mut is_image = |page: &Page| {
        let kind = page.entry(tag::SUBFILE_TYPE).and_then(|entry| tags.value(entry));
        kind.unwrap_or(0) & (REDUCED | MASK) == 0
    };
    pages.iter().enumerate().filter(|(_, page)| is_image(page)).map(|(place, _)| place).collect()
}

/// Decodes a page; `None` if its colours are neither grey nor RGB.
pub fn decode(bytes: &[u8], page: usize) -> Result<Option<Decoded>> {
    let (of_page, black_is_zero) = described(bytes, page).ok_or_else(|| cut_off("TIFF"))?;
    if of_page.reduced {
        return Err(Error::invalid(
            "the first page of this TIFF file is a preview, as in raw files of photo cameras: save the whole image as PNG \
             or TIFF, linear in light",
        ));
    }
    if let Some(samples) = of_page.unknown_channels {
        return Err(Error::invalid(format!(
            "this TIFF file has {samples} channels of unknown meaning: save it with one channel, \
             or as RGB"
        )));
    }
    let edges = u32::try_from(of_page.width).ok().zip(u32::try_from(of_page.height).ok());
    let Some((width, height)) = edges else {
        return Err(unreadable("TIFF", &"its size is not valid"));
    };
    let mut bytes = std::borrow::Cow::Borrowed(bytes);
    if let Some((_, at)) = &of_page.palette {
        // The decoder has no palettes; with this tag it returns the numbers of the colours as grey levels.
        let place = usize::try_from(*at).ok().and_then(|at| bytes.to_mut().get_mut(at..at + 2));
        place.ok_or_else(|| cut_off("TIFF"))?.copy_from_slice(&black_is_zero);
    }
    within_limit(width, height, of_page.bits.div_ceil(8).max(1))?;
    let wrong = |error: tiff::TiffError| match error {
        tiff::TiffError::LimitsExceeded => too_large(width, height),
        error if is_end_of_file(&error) => cut_off("TIFF"),
        error => unreadable("TIFF", &error),
    };
    let mut decoder = Decoder::new(Cursor::new(bytes)).map_err(wrong)?.with_limits(limits());
    decoder.seek_to_image(page).map_err(wrong)?;
    let (channels, kept, color) = match decoder.colortype().map_err(wrong)? {
        ColorType::Gray(_) => (1, 1, Color::Grey),
        ColorType::Multiband { num_samples, .. } => (usize::from(num_samples), 1, Color::Grey),
        ColorType::RGB(_) => (3, 3, Color::Rgb),
        ColorType::RGBA(_) => (4, 3, Color::Rgb),
        _ => return Ok(None),
    };
    let size = of_page.bits.div_ceil(8).max(1);
    within_limit(width, height, size.saturating_mul(channels as u64))?;
    if of_page.photometric == Some(WHITE_IS_ZERO) && !of_page.unsigned {
        return Err(Error::invalid(
            "this TIFF file has 0 for white and samples that are not positive integers, so black \
             is not known: save it with 0 for black",
        ));
    }
    let mut buffer = DecodingResult::U8(Vec::new());
    let layout = decoder.read_image_to_buffer(&mut buffer).map_err(wrong)?;
    if buffer.as_buffer(0).byte_len() < layout.complete_len {
        return Err(too_large(width, height));
    }
    let (width, height) = (width as usize, height as usize);
    let channels = Channels { pixels: width * height, channels, kept, planar: layout.planes > 1 };
    let samples = if of_page.bits < 8 {
        let DecodingResult::U8(packed) = buffer else { return Ok(None) };
        let levels = unpacked(&packed, width * channels.in_row(), of_page.bits);
        let levels = stretched(levels, of_page.bits, of_page.palette.is_some());
        Stored::Levels(Samples::Bits8(channels.of(&levels)))
    } else {
        levels(buffer, &channels)
    };
    let decoded = Decoded { width, height, color, samples };
    match of_page.palette {
        Some((map, _)) => colored(decoded, &map).map(Some),
        None => Ok(Some(decoded)),
    }
}

fn limits() -> Limits {
    let mut limits = Limits::default();
    limits.decoding_buffer_size = usize::try_from(LIMIT_BYTES).unwrap_or(usize::MAX);
    limits.intermediate_buffer_size = limits.decoding_buffer_size;
    limits
}

/// Layout of the channels of pixels.
struct Channels {
    pixels: usize,
    channels: usize,
    /// Number of the first channels that are kept.
    kept: usize,
    /// True if each channel is stored as a separate image.
    planar: bool,
}

impl Channels {
    /// Returns the number of adjacent samples per pixel.
    fn in_row(&self) -> usize {
        if self.planar { 1 } else { self.channels }
    }

    /// Returns the samples of the kept channels, pixel by pixel.
    fn of<T: Copy>(&self, samples: &[T]) -> Vec<T> {
        let Self { pixels, channels, kept, planar } = *self;
        if channels == kept && !planar {
            return samples.to_vec();
        }
        let at = |pixel: usize, channel: usize| {
            if planar { channel * pixels + pixel } else { pixel * channels + channel }
        };
        let kept = (0..pixels).flat_map(|pixel| (0..kept).map(move |channel| at(pixel, channel)));
        kept.filter_map(|i| samples.get(i).copied()).collect()
    }

    /// Converts samples of other types to numbers.
    fn numbers<T: Copy>(&self, samples: &[T], number: impl Fn(T) -> f64) -> Vec<f64> {
        self.of(samples).into_iter().map(number).collect()
    }
}

/// Unpacks samples of 1, 2 or 4 bits; each row begins with a new byte.
fn unpacked(packed: &[u8], in_row: usize, bits: u64) -> Vec<u8> {
    let (per_byte, mask) = (8 / bits, 0xff >> (8 - bits));
    let row_bytes = (in_row as u64).div_ceil(per_byte);
    let row = |row: &[u8]| -> Vec<u8> {
        let of_byte = |byte: &u8| {
            let byte = *byte;
            (1..=per_byte).map(move |i| byte >> (8 - i * bits) & mask)
        };
        row.iter().flat_map(of_byte).take(in_row).collect()
    };
    packed.chunks(usize::try_from(row_bytes).unwrap_or(1).max(1)).flat_map(row).collect()
}

/// Scales samples of few bits to 8 bits, as in PNG; numbers of colours are not scaled.
fn stretched(mut levels: Vec<u8>, bits: u64, is_palette: bool) -> Vec<u8> {
    let most = u8::try_from((1_u64 << bits) - 1).unwrap_or(u8::MAX).max(1);
    if !is_palette {
        for level in &mut levels {
            *level *= u8::MAX / most;
        }
    }
    levels
}

/// Returns the samples of the kept channels.
fn levels(buffer: DecodingResult, channels: &Channels) -> Stored {
    let whole = |numbers: Vec<f64>| Stored::Numbers(numbers, false);
    let fractions = |numbers: Vec<f64>| Stored::Numbers(numbers, true);
    let of_8_bits = |all| Stored::Levels(Samples::Bits8(all));
    let of_16_bits = |all| Stored::Levels(Samples::Bits16(all));
    match buffer {
        DecodingResult::U8(all) if channels.kept == channels.channels && !channels.planar => {
            of_8_bits(all)
        }
        DecodingResult::U8(all) => of_8_bits(channels.of(&all)),
        DecodingResult::U16(all) if channels.kept == channels.channels && !channels.planar => {
            of_16_bits(all)
        }
        DecodingResult::U16(all) => of_16_bits(channels.of(&all)),
        #[allow(clippy::cast_precision_loss)] // far above what is accepted
        DecodingResult::U64(all) => whole(channels.numbers(&all, |n| n as f64)),
        #[allow(clippy::cast_precision_loss)]
        DecodingResult::I64(all) => whole(channels.numbers(&all, |n| n as f64)),
        DecodingResult::U32(all) => whole(channels.numbers(&all, f64::from)),
        DecodingResult::I8(all) => whole(channels.numbers(&all, f64::from)),
        DecodingResult::I16(all) => whole(channels.numbers(&all, f64::from)),
        DecodingResult::I32(all) => whole(channels.numbers(&all, f64::from)),
        DecodingResult::F16(all) => fractions(channels.numbers(&all, |n| f64::from(n.to_f32()))),
        DecodingResult::F32(all) => fractions(channels.numbers(&all, f64::from)),
        DecodingResult::F64(all) => fractions(channels.numbers(&all, |n| n)),
    }
}

/// Converts numbers of a type that cameras do not use to grey levels, by rounding to whole levels. An error states the remedy
/// for numbers that no camera delivers.
pub fn as_levels(numbers: &[f64], fractions: bool) -> Result<Samples> {
    let (mut least, mut most) = (f64::INFINITY, f64::NEG_INFINITY);
    for &number in numbers {
        if !number.is_finite() {
            return Err(Error::invalid(format!(
                "a sample of this TIFF file is {number}: give every pixel a finite grey level"
            )));
        }
        (least, most) = (least.min(number), most.max(number));
    }
    let same = "save all images, white images and boards, with 16 bits";
    if least.round() < 0.0 {
        return Err(Error::invalid(format!(
            "the samples of this TIFF file go down to {least} (a subtracted dark image?), but grey \
             levels begin at 0: give the images as the camera delivered them and state the dark \
             image as dark in [images], or add the same number to all images, {same}, and state it \
             as black_level in [images]"
        )));
    }
    if most.round() > MOST {
        return Err(Error::invalid(format!(
            "the samples of this TIFF file go up to {most}, but grey levels end at {MOST}: divide all images by the same \
             number, and {same}"
        )));
    }
    if fractions && most < LEAST_WITH_FRACTIONS {
        return Err(Error::invalid(format!(
            "the samples of this TIFF file are floating-point numbers from {least} to {most}, and \
             full scale is not known: multiply them by 257 if they are grey levels of 8 bits, or by 65535 if \
             they go from 0 to 1, and {same}"
        )));
    }
    #[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss)] // within 16 bits
    Ok(Samples::Bits16(numbers.iter().map(|number| number.round() as u16).collect()))
}

/// Replaces the numbers of colours by the colours of a palette; grey if all colours of the palette are.
fn colored(numbers: Decoded, map: &[u64]) -> Result<Decoded> {
    let colors = map.len() / 3;
    // Colours have 8 bits if they use the upper byte alone or the same value in both bytes; otherwise 16 bits.
    let eight = map.iter().all(|level| level % 256 == 0)
        || map.iter().all(|level| level % 256 == level / 256);
    let color = if is_grey(map) { Color::Grey } else { Color::Rgb };
    let (width, height) = (numbers.width, numbers.height);
    #[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss)] // at most 16 bits
    let pixels: Vec<usize> =
        numbers.samples.into_numbers().into_iter().map(|number| number as usize).collect();
    if pixels.iter().any(|&number| number >= colors) {
        return Err(Error::invalid(
            "this TIFF file has a pixel outside its palette: save it without a palette",
        ));
    }
    let of = |number: usize| (0..color.samples()).map(move |channel| channel * colors + number);
    let levels = pixels.iter().flat_map(|&number| of(number).map(|at| map[at]));
    #[allow(clippy::cast_possible_truncation)] // values of a palette have 16 bits
    let samples = if eight {
        Samples::Bits8(levels.map(|level| (level >> 8) as u8).collect())
    } else {
        Samples::Bits16(levels.map(|level| level as u16).collect())
    };
    Ok(Decoded { width, height, color, samples: Stored::Levels(samples) })
}
