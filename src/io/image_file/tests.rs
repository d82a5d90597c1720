//! Reading of files as written by cameras and other software, complete and cut off.

use std::io::Cursor;
use std::path::PathBuf;

use ::tiff::encoder::{Compression, TiffEncoder, colortype};
use image::{DynamicImage, GrayImage, ImageFormat};
use tempfile::TempDir;

use super::*;
use crate::finding::Issue;

const WIDTH: u32 = 24;
const HEIGHT: u32 = 16;

fn level(i: u32) -> u8 {
    u8::try_from(i * 7 % 251).unwrap()
}

fn grey() -> DynamicImage {
    let pixel = |x, y| image::Luma([level(y * WIDTH + x)]);
    DynamicImage::ImageLuma8(GrayImage::from_fn(WIDTH, HEIGHT, pixel))
}

fn encoded(image: &DynamicImage, format: ImageFormat) -> Vec<u8> {
    let mut bytes = Cursor::new(Vec::new());
    image.write_to(&mut bytes, format).unwrap();
    bytes.into_inner()
}

fn file(name: &str, bytes: &[u8]) -> (TempDir, PathBuf) {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join(name);
    std::fs::write(&path, bytes).unwrap();
    (folder, path)
}

fn read(bytes: &[u8]) -> Result<RawImage> {
    let (_folder, path) = file("image", bytes);
    let image = read_image(&path, None);
    // `init` uses the header alone, which has to agree with the image.
    if let Ok(image) = &image {
        let (width, height, color) = format_of(&path).unwrap();
        assert_eq!(
            (width as usize, height as usize, color),
            (image.width, image.height, image.color)
        );
    }
    image
}

fn assert_refused(bytes: &[u8], words: &[&str]) {
    let error = match read(bytes) {
        Err(error) => error.to_string(),
        Ok(image) => panic!("{} x {} px are read instead of {words:?}", image.width, image.height),
    };
    for word in words {
        assert!(error.contains(word), "{word}: {error}");
    }
}

/// Encodes samples as a TIFF file with a type of the encoder.
fn tiff_of<C: colortype::ColorType>(samples: &[C::Inner], big: bool) -> Vec<u8>
where
    [C::Inner]: ::tiff::encoder::TiffValue,
{
    let mut bytes = Cursor::new(Vec::new());
    if big {
        let mut encoder = TiffEncoder::new_big(&mut bytes).unwrap();
        encoder.write_image::<C>(WIDTH, HEIGHT, samples).unwrap();
    } else {
        let mut encoder = TiffEncoder::new(&mut bytes).unwrap().with_compression(Compression::Lzw);
        encoder.write_image::<C>(WIDTH, HEIGHT, samples).unwrap();
    }
    bytes.into_inner()
}

/// Creates a TIFF file of one strip with these tags (number, kind, values), with the same page `pages` times.
fn tiff(tags: &[(u16, u16, Vec<u16>)], samples: &[u8], pages: usize) -> Vec<u8> {
    let mut bytes = b"II*\0".to_vec();
    let mut link = bytes.len();
    bytes.extend([0; 4]);
    for _ in 0..pages {
        let strip = u32::try_from(bytes.len()).unwrap();
        bytes.extend(samples);
        let values: Vec<u32> = tags
            .iter()
            .map(|(_, _, values)| {
                let at = u32::try_from(bytes.len()).unwrap();
                if values.len() > 2 {
                    bytes.extend(values.iter().flat_map(|v| v.to_le_bytes()));
                    return at;
                }
                u32::from(values[0]) | u32::from(*values.get(1).unwrap_or(&0)) << 16
            })
            .collect();
        let mut entries: Vec<(u16, u16, u32, u32)> = tags
            .iter()
            .zip(values)
            .map(|((tag, kind, all), value)| {
                (*tag, *kind, u32::try_from(all.len()).unwrap(), value)
            })
            .collect();
        entries.push((273, 4, 1, strip));
        entries.push((279, 4, 1, u32::try_from(samples.len()).unwrap()));
        entries.sort_unstable();
        let begin = u32::try_from(bytes.len()).unwrap();
        bytes[link..link + 4].copy_from_slice(&begin.to_le_bytes());
        bytes.extend(u16::try_from(entries.len()).unwrap().to_le_bytes());
        for (tag, kind, count, value) in entries {
            bytes.extend(tag.to_le_bytes());
            bytes.extend(kind.to_le_bytes());
            bytes.extend(count.to_le_bytes());
            bytes.extend(value.to_le_bytes());
        }
        link = bytes.len();
        bytes.extend([0; 4]);
    }
    bytes
}

/// Returns the tags of an image with these numbers of bits, and further tags.
fn described(bits: &[u16], more: &[(u16, Vec<u16>)]) -> Vec<(u16, u16, Vec<u16>)> {
    let channels = u16::try_from(bits.len()).unwrap();
    let mut tags = vec![
        (256, 3, vec![u16::try_from(WIDTH).unwrap()]),
        (257, 3, vec![u16::try_from(HEIGHT).unwrap()]),
        (258, 3, bits.to_vec()),
        (277, 3, vec![channels]),
        (278, 3, vec![u16::try_from(HEIGHT).unwrap()]),
    ];
    tags.extend(more.iter().map(|(tag, values)| (*tag, 3, values.clone())));
    tags
}

fn all<T>(sample: impl Fn(u32) -> T) -> Vec<T> {
    (0..WIDTH * HEIGHT).map(sample).collect()
}

fn sixteen(factor: u16, offset: u16) -> Samples {
    Samples::Bits16(all(|i| u16::from(level(i)) * factor + offset))
}

const FORMATS: [ImageFormat; 5] =
    [ImageFormat::Png, ImageFormat::Tiff, ImageFormat::Bmp, ImageFormat::Pnm, ImageFormat::Jpeg];

#[test]
fn files_that_are_cut_off_are_refused_wherever_the_cut_is() {
    for (format, name) in FORMATS.into_iter().zip(["PNG", "TIFF", "BMP", "PGM", "JPEG"]) {
        let whole = encoded(&grey(), format);
        read(&whole).unwrap();
        for cut in [1, 2, 5, 40, whole.len() / 2, whole.len() - 40] {
            let bytes = &whole[..whole.len() - cut];
            assert_refused(bytes, &[name, "is cut off: copy it again"]);
        }
    }
    assert_refused(&[], &["is empty"]);
}

/// Creates noise, whose JPEG file has long scans.
fn noise() -> DynamicImage {
    let pixel = |x: u32, y: u32| {
        let of = |factor: u32| u8::try_from(x * y * factor % 251).unwrap();
        image::Rgb([of(37), of(11), of(5)])
    };
    DynamicImage::ImageRgb8(image::RgbImage::from_fn(97, 83, pixel))
}

#[test]
fn a_jpeg_file_whose_samples_end_early_is_damaged() {
    for image in [noise(), DynamicImage::ImageLuma8(noise().to_luma8())] {
        let whole = encoded(&image, ImageFormat::Jpeg);
        read(&whole).unwrap();
        for left in [whole.len() / 2, whole.len() * 9 / 10, whole.len() - 20] {
            let short = [&whole[..left], &[0xff, 0xd9]].concat();
            assert_refused(&short, &["JPEG", "damaged", "copy it again"]);
        }
    }
    let whole = encoded(&noise(), ImageFormat::Jpeg);
    // A thumbnail in an EXIF block has an end of image too.
    let mut nested = whole[..2].to_vec();
    let small = encoded(&grey(), ImageFormat::Jpeg);
    nested.extend([0xff, 0xe1]);
    nested.extend(u16::try_from(small.len() + 2).unwrap().to_be_bytes());
    nested.extend(&small);
    nested.extend(&whole[2..]);
    read(&nested).unwrap();
    assert_refused(&nested[..nested.len() / 2], &["is cut off"]);
    // Bytes after the end of the image are ignored.
    nested.extend([0; 100]);
    read(&nested).unwrap();
}

#[test]
fn numbers_of_other_types_are_grey_levels_if_they_can_be() {
    let floats =
        tiff_of::<colortype::Gray32Float>(&all(|i| f32::from(level(i)) * 16.0 + 5.25), false);
    assert_eq!(read(&floats).unwrap().samples, sixteen(16, 5));
    let doubles = tiff_of::<colortype::Gray64Float>(&all(|i| f64::from(level(i)) * 200.0), true);
    assert_eq!(read(&doubles).unwrap().samples, sixteen(200, 0));
    let signed = tiff_of::<colortype::GrayI16>(&all(|i| i16::from(level(i)) * 16), false);
    assert_eq!(read(&signed).unwrap().samples, sixteen(16, 0));
    let long = tiff_of::<colortype::Gray32>(&all(|i| u32::from(level(i)) * 256), true);
    assert_eq!(read(&long).unwrap().samples, sixteen(256, 0));
    let big = tiff_of::<colortype::Gray8>(&all(level), true);
    assert_eq!(read(&big).unwrap().samples, Samples::Bits8(all(level)));
    let rgb: Vec<f32> =
        all(|i| f32::from(level(i)) * 16.0).into_iter().flat_map(|s| [s; 3]).collect();
    let rgb = read(&tiff_of::<colortype::RGB32Float>(&rgb, false)).unwrap();
    assert_eq!((rgb.color, rgb.width, rgb.height), (Color::Rgb, 24, 16));
}

#[test]
fn numbers_that_are_no_grey_levels_are_refused_with_what_to_do() {
    let floats = |of: &dyn Fn(f32) -> f32| {
        tiff_of::<colortype::Gray32Float>(&all(|i| of(f32::from(level(i)))), false)
    };
    assert_refused(&floats(&|s| s / 251.0), &["from 0 to 0.99", "by 65535 if they go from 0 to 1"]);
    assert_refused(&floats(&|s| s), &["to 250", "by 257 if they are grey levels of 8 bits"]);
    assert_refused(&floats(&|s| 16.0 * s - 3.0), &["down to -3", "dark image", "black_level"]);
    assert_refused(&floats(&|s| 1000.0 * s), &["up to 250000", "divide all images"]);
    assert_refused(&floats(&|s| if s < 1.0 { f32::NAN } else { 2000.0 }), &["NaN"]);
    let signed = tiff_of::<colortype::GrayI16>(&all(|i| i16::from(level(i)) - 1), false);
    assert_refused(&signed, &["down to -1"]);
    // Noise around black may be slightly negative; it is rounded too.
    assert!(read(&floats(&|s| 16.0 * s - 0.25)).is_ok());
}

#[test]
fn palettes_transparency_and_few_bits_are_read() {
    let numbers: Vec<u8> = all(|i| level(i) % 16);
    let map = |of: &dyn Fn(u16, u16) -> u16| -> Vec<u16> {
        (0..3).flat_map(|c| (0..256).map(move |i| (c, i))).map(|(c, i)| of(c, i)).collect()
    };
    let palette =
        |map: Vec<u16>| tiff(&described(&[8], &[(262, vec![3]), (320, map)]), &numbers, 1);
    let image = read(&palette(map(&|_, i| i * 257))).unwrap();
    assert_eq!((image.color, &image.samples), (Color::Grey, &Samples::Bits8(numbers.clone())));
    let image = read(&palette(map(&|c, i| (i / (c + 1)) << 8))).unwrap();
    assert_eq!(image.color, Color::Rgb);
    let Samples::Bits8(rgb) = &image.samples else { panic!("{image:?}") };
    let number = numbers[13];
    assert_eq!(rgb[3 * 13..3 * 14], [number, number / 2, number / 3]);

    let with_alpha: Vec<u8> =
        all(|i| [(u16::from(level(i)) * 200).to_le_bytes(), [0xff; 2]].concat()).concat();
    let extra = |kind: u16| described(&[16, 16], &[(262, vec![1]), (338, vec![kind])]);
    assert_eq!(read(&tiff(&extra(2), &with_alpha, 1)).unwrap().samples, sixteen(200, 0));
    assert_refused(&tiff(&extra(0), &with_alpha, 1), &["2 channels", "save it with one channel"]);

    let packed: Vec<u8> = numbers.chunks(2).map(|pair| pair[0] << 4 | pair[1]).collect();
    let four = read(&tiff(&described(&[4], &[(262, vec![1])]), &packed, 1)).unwrap();
    let stretched = numbers.iter().map(|number| number * 17).collect();
    assert_eq!(four.samples, Samples::Bits8(stretched));
}

#[test]
fn other_files_and_sizes_are_refused_with_a_reason() {
    assert_refused(b"<html>not found</html>", &["not PNG, TIFF", "save the image as"]);
    let huge = [(256, vec![65_535]), (257, vec![65_535]), (262, vec![1])];
    let mut tags = described(&[8], &[]);
    tags.retain(|(tag, ..)| *tag != 256 && *tag != 257);
    tags.extend(huge.iter().map(|(tag, values)| (*tag, 3, values.clone())));
    assert_refused(&tiff(&tags, &[0; 10], 1), &["65535 x 65535 px", "512 MB"]);
    let preview = described(&[8], &[(262, vec![1]), (254, vec![1])]);
    assert_refused(&tiff(&preview, &[0; 384], 1), &["preview", "save the whole image"]);
    let pgm = b"P5\n60000 60000\n255\n";
    assert_refused(pgm, &["512 MB"]);
}

fn codes(name: &str, bytes: &[u8]) -> Vec<Issue> {
    let (_folder, path) = file(name, bytes);
    ImageReader::default().findings(&[path]).into_iter().map(|finding| finding.issue).collect()
}

/// Creates a PNG file with a chunk after its first one; the reader ignores the checksum.
fn with_chunk(name: &[u8], content: &[u8]) -> Vec<u8> {
    const FIRST: usize = 8 + 12 + 13;
    let mut bytes = encoded(&grey(), ImageFormat::Png);
    let mut chunk = u32::try_from(content.len()).unwrap().to_be_bytes().to_vec();
    chunk.extend(name);
    chunk.extend(content);
    chunk.extend([0; 4]);
    bytes.splice(FIRST..FIRST, chunk);
    bytes
}

/// Creates an EXIF block with an orientation and a colour space.
fn exif(orientation: u16, space: u16) -> Vec<u8> {
    let mut block = b"II*\0\x08\0\0\0".to_vec();
    let entry = |tag: u16, kind: u16, value: u32| {
        [&tag.to_le_bytes()[..], &kind.to_le_bytes(), &1_u32.to_le_bytes(), &value.to_le_bytes()]
            .concat()
    };
    block.extend(2_u16.to_le_bytes());
    block.extend(entry(274, 3, orientation.into()));
    block.extend(entry(34_665, 4, 38));
    block.extend([0; 4]);
    block.extend(1_u16.to_le_bytes());
    block.extend(entry(40_961, 3, space.into()));
    block
}

/// Creates a profile with one curve of this gamma.
fn profile(gamma: u16) -> Vec<u8> {
    let mut profile = vec![0; 128];
    profile.extend(1_u32.to_be_bytes());
    profile.extend(b"kTRC");
    profile.extend([144_u32, 14].into_iter().flat_map(u32::to_be_bytes));
    profile.extend(b"curv\0\0\0\0");
    profile.extend(1_u32.to_be_bytes());
    profile.extend(gamma.to_be_bytes());
    profile
}

fn with_segment(marker: u8, content: &[u8]) -> Vec<u8> {
    let mut bytes = encoded(&grey(), ImageFormat::Jpeg);
    let mut segment = vec![0xff, marker];
    segment.extend(u16::try_from(content.len() + 2).unwrap().to_be_bytes());
    segment.extend(content);
    bytes.splice(2..2, segment);
    bytes
}

#[test]
fn plain_files_say_nothing_of_themselves() {
    for format in FORMATS {
        assert_eq!(codes("plain", &encoded(&grey(), format)), [], "{format:?}");
    }
    for (name, content) in [(b"gAMA", 100_000_u32.to_be_bytes()), (b"pHYs", [0; 4])] {
        assert_eq!(codes("plain.png", &with_chunk(name, &content)), []);
    }
    assert_eq!(
        codes("plain.jpg", &with_segment(0xe1, &[EXIF_MARK, &exif(1, 65_535)].concat())),
        []
    );
    let linear = [b"ICC_PROFILE\0\x01\x01", &profile(256)[..]].concat();
    assert_eq!(codes("plain.jpg", &with_segment(0xe2, &linear)), []);
}

const EXIF_MARK: &[u8] = b"Exif\0\0";

#[test]
fn curves_orientation_and_pages_are_told() {
    let told = |profile: &str| {
        let profile = profile.to_owned();
        vec![Issue::ImageProfile { images: 1, first: "a".to_owned(), profile }]
    };
    let turned = |orientation: u64| Issue::ImageOrientation {
        images: 1,
        first: "a".to_owned(),
        orientation,
    };
    assert_eq!(codes("a", &with_chunk(b"sRGB", &[0])), told("sRGB chunk"));
    assert_eq!(codes("a", &with_chunk(b"gAMA", &45_455_u32.to_be_bytes())), told("gAMA 0.45455"));
    assert_eq!(codes("a", &with_chunk(b"eXIf", &exif(3, 0))), [turned(3)]);
    let of_jpeg = with_segment(0xe1, &[EXIF_MARK, &exif(6, 1)].concat());
    assert_eq!(codes("a", &of_jpeg), [told("EXIF colour space sRGB"), vec![turned(6)]].concat());
    let curved = [b"ICC_PROFILE\0\x01\x01", &profile(563)[..]].concat();
    let gamma = told("ICC profile with gamma 2.20");
    assert_eq!(codes("a", &with_segment(0xe2, &curved)), gamma);
    let packed = {
        use flate2::{Compression, write::ZlibEncoder};
        let mut packed = ZlibEncoder::new(b"grey\0\0".to_vec(), Compression::fast());
        packed.write_all(&profile(563)).unwrap();
        packed.finish().unwrap()
    };
    assert_eq!(codes("a", &with_chunk(b"iCCP", &packed)), gamma);
    let samples = all(level);
    let tags = described(&[8], &[(262, vec![1]), (274, vec![8])]);
    let stack = tiff(&tags, &samples, 3);
    let several = Issue::SeveralPages { images: 1, first: "a".to_owned(), pages: 3 };
    assert_eq!(codes("a", &stack), [turned(8), several]);
    assert_eq!(read(&stack).unwrap().samples, Samples::Bits8(samples));
}
