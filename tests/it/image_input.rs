//! What is read from image files: dark images, pages, and files without a header.

use std::fs;
use std::io::Cursor;
use std::path::{Path, PathBuf};
use std::sync::LazyLock;

use plenocal::image::{Color, RawImage, Samples};
use plenocal::io::{
    ImageReader, Packing, Pages, RawLayout, read_features, read_internal_parameters, write_png,
};
use predicates::prelude::PredicateBooleanExt;
use predicates::str::contains;
use tempfile::TempDir;
use tiff::encoder::{TiffEncoder, colortype};
use tiff::tags::Tag;

use crate::prepared::Files;
use crate::support::plenocal;

const WIDTH: usize = 24;
const HEIGHT: usize = 16;
/// Samples of the dark image are these above the least.
const SPREAD: usize = 7;

/// White images of a camera with a black level of 16 of 255, and a board.
static CLEAN: LazyLock<Files> = LazyLock::new(|| {
    let folder = TempDir::new().unwrap();
    let mut simulate = plenocal();
    simulate.args(["simulate", "--set", "rays=8", "--set", "boards.calibration=1"]);
    simulate.args(["--set", "boards.evaluation=0", "--set", "translation.images=0"]);
    simulate.args(["--set", "white_images.f_numbers=[4.0, 8.0, 16.0]"]);
    simulate.args(["--set", "imaging.black_level=0.06274509803921569"]);
    simulate.arg("--out").arg(folder.path()).assert().success();
    Files::read(folder.path())
});

/// Sample without light of a pixel, from 13 to 19.
fn without_light(i: usize) -> u8 {
    u8::try_from(13 + i * 31 % 97 % SPREAD).unwrap()
}

fn grey(width: usize, height: usize, samples: Samples) -> RawImage {
    RawImage { width, height, color: Color::Grey, samples }
}

fn write(path: &Path, image: &RawImage) {
    write_png(&mut fs::File::create(path).unwrap(), image).unwrap();
}

fn bits8(image: &RawImage) -> &[u8] {
    let Samples::Bits8(samples) = &image.samples else { panic!("samples of 16 bits") };
    samples
}

fn bits16(image: &RawImage) -> &[u16] {
    let Samples::Bits16(samples) = &image.samples else { panic!("samples of 8 bits") };
    samples
}

/// A file in a folder of its own.
struct InFolder {
    folder: TempDir,
}

impl InFolder {
    fn new() -> Self {
        Self { folder: TempDir::new().unwrap() }
    }

    fn file(&self, name: &str, bytes: &[u8]) -> PathBuf {
        let path = self.folder.path().join(name);
        fs::write(&path, bytes).unwrap();
        path
    }

    fn png(&self, name: &str, samples: Samples) -> PathBuf {
        let path = self.folder.path().join(name);
        write(&path, &grey(WIDTH, HEIGHT, samples));
        path
    }
}

/// A TIFF file of these pages.
fn tiff_of<C: colortype::ColorType>(pages: &[Vec<C::Inner>]) -> Vec<u8>
where
    [C::Inner]: tiff::encoder::TiffValue,
{
    let mut bytes = Cursor::new(Vec::new());
    let mut encoder = TiffEncoder::new(&mut bytes).unwrap();
    let (width, height) = (u32::try_from(WIDTH).unwrap(), u32::try_from(HEIGHT).unwrap());
    for page in pages {
        encoder.write_image::<C>(width, height, page).unwrap();
    }
    bytes.into_inner()
}

fn refused<T>(result: plenocal::Result<T>, words: &[&str]) {
    let error = result.err().expect("it is refused").to_string();
    for word in words {
        assert!(error.contains(word), "{word}: {error}");
    }
}

/// Samples of an image from 100 on, without full pixels.
fn lit(i: usize) -> u16 {
    u16::try_from(100 + i * 7).unwrap()
}

fn all<T>(of: impl Fn(usize) -> T) -> Vec<T> {
    (0..WIDTH * HEIGHT).map(of).collect()
}

#[test]
fn noise_below_black_is_kept_and_full_pixels_stay_full() {
    let set = InFolder::new();
    // A hot pixel is full in the image.
    let of_dark = |i: usize| if i == 310 { 200 } else { without_light(i) };
    let dark = set.png("dark.png", Samples::Bits8(all(of_dark)));
    // Pixels without light, with noise of 2 levels; then with light; then full.
    let noisy = |i: usize| match i {
        0..300 => without_light(i) - 2 + u8::try_from(i % 5).unwrap(),
        300..330 => 255,
        _ => without_light(i) + u8::try_from(i % 200).unwrap(),
    };
    let image = set.png("image.png", Samples::Bits8(all(noisy)));
    let reader = ImageReader::of_color(None).with_dark(&dark, &image).unwrap();
    let black = reader.black_level().unwrap();
    assert!(black > 16.0 && black.fract() < 1e-9, "{black}");
    let read = reader.read(&image).unwrap();
    for (i, (&sample, &dark)) in bits8(&read).iter().zip(&all(without_light)).enumerate() {
        let light = f64::from(sample) - black;
        let expected = f64::from(noisy(i)) - f64::from(dark);
        let is_full = (300..330).contains(&i);
        assert!(if is_full { sample == 255 } else { (light - expected).abs() < 1e-6 }, "{i}");
    }
    // Without light, samples are 0 ± 2 about the black level, on both sides.
    let below = bits8(&read)[..300].iter().filter(|&&sample| f64::from(sample) < black).count();
    assert_eq!(below, 120);
}

#[test]
fn pages_of_a_dark_image_are_averaged_and_fractions_count() {
    let set = InFolder::new();
    let image = set.png("image.png", Samples::Bits16(all(lit)));
    let eight = |i: usize| u8::try_from(lit(i) / 12).unwrap();
    let image_8 = set.png("image-8.png", Samples::Bits8(all(eight)));
    let page = |more: u16| all(|i| 64 + more + u16::try_from(i % 4).unwrap());
    let stack = set.file("stack.tif", &tiff_of::<colortype::Gray16>(&[page(0), page(2), page(4)]));
    let mean = all(|i| 66.0 + (i % 4) as f32);
    let float = set.file("float.tif", &tiff_of::<colortype::Gray32Float>(&[mean]));
    let [by_stack, by_float] = [stack, float].map(|dark| {
        let reader = ImageReader::of_color(None).with_dark(&dark, &image).unwrap();
        (reader.black_level(), reader.read(&image).unwrap())
    });
    assert_eq!(by_stack, by_float);
    let light = |i: usize| f64::from(bits16(&by_stack.1)[i]) - by_stack.0.unwrap();
    assert!(
        (0..WIDTH * HEIGHT)
            .all(|i| { (light(i) - (f64::from(lit(i)) - 66.0 - (i % 4) as f64)).abs() < 1e-6 })
    );
    // Of 8 bits: in steps of 1/257 of a grey level.
    let few = |more: u8| all(|i| 3 + more + u8::from(i % 2 == 0));
    let stack = set.file("eight.tif", &tiff_of::<colortype::Gray8>(&[few(0), few(0), few(1)]));
    let reader = ImageReader::of_color(None).with_dark(&stack, &image_8).unwrap();
    let read = reader.read(&image_8).unwrap();
    for (i, &sample) in bits16(&read).iter().enumerate() {
        let light = (f64::from(sample) - reader.black_level().unwrap()) / 257.0;
        let dark = 3.0 + 1.0 / 3.0 + f64::from(u8::from(i % 2 == 0));
        assert!((light - (f64::from(eight(i)) - dark)).abs() < 1.0 / 257.0, "{i}: {light}");
    }
    let findings = plenocal::io::ImageReader::findings(&reader, &[&stack, &image_8]);
    assert_eq!(crate::support::codes(&findings), ["dark-image-subtracted"]);
    assert!(
        findings[0].message().contains("eight.tif") && findings[0].message().contains("3 pages")
    );
}

#[test]
fn a_dark_image_of_other_images_is_refused_by_name() {
    let set = InFolder::new();
    let image = set.png("image.png", Samples::Bits16(all(lit)));
    let dark = |name: &str, image: &RawImage| {
        let path = set.folder.path().join(name);
        write(&path, image);
        path
    };
    let read = |dark: &Path| {
        let reader = ImageReader::of_color(None).with_dark(dark, &image)?;
        reader.read(&image)
    };
    let small = grey(4, 4, Samples::Bits16(vec![60; 16]));
    refused(read(&dark("small.png", &small)), &["image.png", "24 x 16", "small.png", "4 x 4"]);
    let eight = grey(WIDTH, HEIGHT, Samples::Bits8(all(without_light)));
    refused(read(&dark("eight.png", &eight)), &["eight.png", "8 bits", "16"]);
    let white = grey(WIDTH, HEIGHT, Samples::Bits16(all(|i| lit(i) + 1)));
    refused(read(&dark("white.png", &white)), &["white.png", "lens covered"]);
    let long = grey(WIDTH, HEIGHT, Samples::Bits16(all(|i| if i % 3 == 0 { 50 } else { 1400 })));
    refused(read(&dark("long.png", &long)), &["long.png", "half of the dark image is above 1400"]);
    let third = |i: usize| if i < 200 { lit(i) + 1 } else { 60 };
    let part = grey(WIDTH, HEIGHT, Samples::Bits16(all(third)));
    refused(read(&dark("part.png", &part)), &["part.png", "52 % of the pixels are darker"]);
    let rgb = RawImage { color: Color::Rgb, samples: Samples::Bits16(vec![60; 3 * 384]), ..white };
    refused(read(&dark("rgb.png", &rgb)), &["rgb.png", "3 channels", "1 channel"]);
    let missing = set.folder.path().join("none.png");
    refused(read(&missing), &["none.png", "No such file"]);
    // Images of other bits than the first.
    let reader = ImageReader::of_color(None);
    let good = dark("good.png", &grey(WIDTH, HEIGHT, Samples::Bits16(vec![60; 384])));
    let other = dark("other.png", &eight);
    refused(reader.with_dark(&good, &image).unwrap().read(&other), &["other.png", "8 bits"]);
}

/// Writes the images of the set with a pattern of the pixels, and a dark image.
fn patterned() -> TempDir {
    let set = CLEAN.copy();
    let reader = ImageReader::of_color(None);
    let mut size = (0, 0);
    for name in CLEAN.names().filter(|name| name.extension().is_some_and(|kind| kind == "png")) {
        let path = set.path().join(name);
        let mut image = reader.read(&path).unwrap();
        size = (image.width, image.height);
        let Samples::Bits8(samples) = &mut image.samples else { panic!("8 bits") };
        for (i, sample) in samples.iter_mut().enumerate().filter(|(_, sample)| **sample < 255) {
            let shifted = i16::from(*sample) + i16::from(without_light(i)) - 16;
            *sample = u8::try_from(shifted.clamp(0, 254)).unwrap();
        }
        write(&path, &image);
    }
    let samples = (0..size.0 * size.1).map(without_light).collect();
    write(&set.path().join("dark.png"), &grey(size.0, size.1, Samples::Bits8(samples)));
    set
}

fn project_with(set: &Path, images: &str) -> PathBuf {
    let text = fs::read_to_string(set.join("project.toml")).unwrap();
    let path = set.join("other.toml");
    fs::write(&path, text.replace("[images]\n", &format!("[images]\n{images}\n"))).unwrap();
    path
}

fn program(command: &str, project: &Path, out: &Path) -> assert_cmd::assert::Assert {
    plenocal().arg(command).arg(project).arg("--out").arg(out).assert()
}

#[test]
fn commands_subtract_the_dark_image_of_a_project() {
    let (clean, set) = (CLEAN.copy(), patterned());
    let stated = project_with(clean.path(), "black_level = 16");
    let with_dark = project_with(set.path(), "dark = \"dark.png\"");
    let note = contains("note: the dark image dark.png is subtracted from all images (1 page");
    let (a, b) = (clean.path().join("out"), set.path().join("out"));
    program("detect", &stated, &a).success().stderr(contains("dark").not());
    program("detect", &with_dark, &b).success().stderr(note.clone());
    let internal = |folder: &Path| {
        read_internal_parameters(&folder.join("precalibration.json"), Some(0.0055)).unwrap()
    };
    let (a_white, b_white) = (internal(&a), internal(&b));
    assert!((a_white.m_mm / b_white.m_mm - 1.0).abs() < 1e-4);
    let levels = b_white.levels.unwrap();
    assert!((levels.black_level - 34.0).abs() < 1e-9, "{levels:?}");
    let features = |folder: &Path| read_features(&folder.join("features.csv"), true).unwrap();
    let (a, b_features) = (features(&a).features, features(&b).features);
    let most = a.len().max(b_features.len()) as f64;
    assert!(a.len() > 200 && a.len().abs_diff(b_features.len()) as f64 <= 0.01 * most);

    let white = set.path().join("white");
    program("precalibrate", &with_dark, &white).success().stderr(note.clone());
    assert_eq!(internal(&white), b_white);
    // The folder is for this dark image alone.
    let mut detect = plenocal();
    detect.arg("detect").arg(project_with(set.path(), "black_level = 16"));
    detect.arg("--precalibration").arg(&white).arg("--out").arg(set.path().join("other"));
    detect
        .assert()
        .code(1)
        .stderr(contains("with a black level of 34, but [images] says black_level = 16"));

    let both = project_with(set.path(), "dark = \"dark.png\"\nblack_level = 16");
    program("precalibrate", &both, &white).code(1).stderr(contains("both dark and black_level"));
    let missing = project_with(set.path(), "dark = \"none.png\"");
    program("run", &missing, &white).code(1).stderr(contains("none.png"));

    // Of a single image.
    let single = set.path().join("single");
    let image = set.path().join("whites/white-1-n-8.00.png");
    let mut alone = plenocal();
    alone.arg("precalibrate").arg(&image).arg("--dark").arg(set.path().join("dark.png"));
    alone.arg("--out").arg(&single).assert().success().stderr(note);
}

#[test]
fn a_chosen_page_is_read_or_the_mean_of_all() {
    let set = InFolder::new();
    // Noise that cancels out, and pixels that are full on two of three pages.
    let page = |more: u16| all(|i| if i < 60 { 4095 - more } else { lit(i) + more });
    let pages = [page(0), page(30), page(0)];
    let stack = set.file("stack.tif", &tiff_of::<colortype::Gray16>(&pages));
    let read = |pages: Pages| ImageReader::of_color(None).with_pages(pages).read(&stack);
    assert_eq!(bits16(&read(Pages::First).unwrap()), pages[0]);
    assert_eq!(bits16(&read(Pages::Number(2)).unwrap()), pages[1]);
    refused(read(Pages::Number(4)), &["stack.tif", "page 4", "3 pages"]);
    let mean = read(Pages::Average).unwrap();
    for (i, &sample) in bits16(&mean).iter().enumerate() {
        let expected = if i < 60 { 4095 } else { lit(i) + 10 };
        assert_eq!(sample, expected, "pixel {i}");
    }
    // Of 8 bits.
    let page = |more: u8| all(|i| u8::try_from(i % 200).unwrap() + more);
    let eight = set.file("eight.tif", &tiff_of::<colortype::Gray8>(&[page(0), page(1), page(1)]));
    let averaging = ImageReader::of_color(None).with_pages(Pages::Average);
    let mean = averaging.read(&eight).unwrap();
    let expected = all(|i| u16::try_from(257 * (i % 200)).unwrap() + 171);
    assert_eq!(bits16(&mean)[..100], expected[..100]);
    // A file with one page is its own mean, with 16 bits as the others.
    let png = set.png("one.png", Samples::Bits8(page(0)));
    let one: Vec<u16> = page(0).into_iter().map(|sample| 257 * u16::from(sample)).collect();
    assert_eq!(bits16(&averaging.read(&png).unwrap()), one);
    refused(ImageReader::of_color(None).with_pages(Pages::Number(2)).read(&png), &["1 page"]);

    let said = |reader: &ImageReader| reader.findings(&[&stack, &eight, &png]);
    let of = |pages: Pages| said(&ImageReader::of_color(None).with_pages(pages));
    let [first, chosen, mean] = [Pages::First, Pages::Number(2), Pages::Average].map(of);
    assert_eq!(crate::support::codes(&first), ["several-pages"]);
    assert_eq!(crate::support::codes(&chosen), ["pages-used"]);
    assert!(chosen[0].message().contains("page 2 is read"), "{}", chosen[0]);
    assert!(
        mean[0].message().contains("2 TIFF files with several pages (first: stack.tif, 3 pages)")
    );
    assert!(mean[0].message().contains("the mean of all pages is used"), "{}", mean[0]);
}

#[test]
fn pages_are_stated_in_the_project_or_for_a_single_image() {
    let set = CLEAN.copy();
    let white = set.path().join("whites/white-1-n-8.00.png");
    let image = ImageReader::of_color(None).read(&white).unwrap();
    let brighter: Vec<u8> = bits8(&image).iter().map(|&sample| sample.saturating_add(4)).collect();
    let mut bytes = Cursor::new(Vec::new());
    let mut encoder = TiffEncoder::new(&mut bytes).unwrap();
    let (width, height) = (u32::try_from(image.width), u32::try_from(image.height));
    let (width, height) = (width.unwrap(), height.unwrap());
    encoder.write_image::<colortype::Gray8>(width, height, bits8(&image)).unwrap();
    encoder.write_image::<colortype::Gray8>(width, height, &brighter).unwrap();
    let stack = set.path().join("whites/stack.tif");
    fs::write(&stack, bytes.into_inner()).unwrap();
    let out = set.path().join("out");
    let text = fs::read_to_string(set.path().join("project.toml")).unwrap();
    let text = text.replace("whites/white-1-n-8.00.png", "whites/stack.tif");
    fs::write(set.path().join("project.toml"), text).unwrap();
    program("precalibrate", &set.path().join("project.toml"), &out)
        .success()
        .stderr(contains("only the first page is read").and(contains("\"average\"")));
    let average = project_with(set.path(), "pages = \"average\"");
    program("precalibrate", &average, &out)
        .success()
        .stderr(contains("note: 1 TIFF file with several pages (first: stack.tif, 2 pages)"));
    let levels = read_internal_parameters(&out.join("precalibration.json"), None).unwrap().levels;
    assert_eq!(levels.unwrap().bits, 16);
    for (wrong, words) in [
        ("pages = \"mean\"", "the number of a page, from 1 on, or \"average\""),
        ("pages = 0", "from 1 on"),
        ("pages = 2.5", "from 1 on"),
        ("pages = 3", "page 3 is stated, but this file has"),
    ] {
        let project = project_with(set.path(), wrong);
        program("precalibrate", &project, &out).code(1).stderr(contains(words));
    }
    let mut alone = plenocal();
    alone.arg("precalibrate").arg(&stack).args(["--pages", "average", "--out"]).arg(&out);
    alone.assert().success().stderr(contains("the mean of all pages is used"));
    let mut project = plenocal();
    project.arg("precalibrate").arg(&average).args(["--pages", "2", "--out"]).arg(&out);
    project.assert().code(1).stderr(contains("--pages is for a single image"));
}

/// A reader of files without a header, of 6 x 2 px.
fn raw(packing: Packing, header_bytes: u64, row_bytes: Option<u64>) -> ImageReader {
    let layout = RawLayout { packing, header_bytes, row_bytes };
    ImageReader::of_color(None).with_raw(Some(layout), (6, 2))
}

/// Samples one after the other from the lowest bit of the first byte on.
fn consecutive(samples: &[u16], bits: usize) -> Vec<u8> {
    let mut bytes = vec![0; (samples.len() * bits).div_ceil(8)];
    for (i, sample) in samples.iter().enumerate() {
        for bit in (0..bits).filter(|bit| sample >> bit & 1 == 1) {
            bytes[(i * bits + bit) / 8] |= 1 << ((i * bits + bit) % 8);
        }
    }
    bytes
}

const TEN: [u16; 12] = [0, 1023, 1, 512, 341, 682, 3, 768, 500, 77, 1022, 255];

#[test]
fn packed_samples_are_read_in_every_stated_layout() {
    let twelve = TEN.map(|sample| 4 * sample + sample % 4);
    let upper = |sample: u16, bits: u32| u8::try_from(sample >> (bits - 8)).unwrap();
    let low = |sample: u16, mask: u16| u8::try_from(sample & mask).unwrap();
    let pairs = |all: &[u16], bits: u32, shift: u32| -> Vec<u8> {
        let mask = (1 << (bits - 8)) - 1;
        let of = |p: &[u16]| {
            let lower = low(p[0], mask) | low(p[1], mask) << shift;
            [upper(p[0], bits), lower, upper(p[1], bits)]
        };
        all.chunks(2).flat_map(of).collect()
    };
    let mipi_10 = |p: &[u16]| {
        let lower = (0..4).fold(0, |byte, i| byte | low(p[i], 3) << (2 * i));
        [0, 1, 2, 3].map(|i| upper(p[i], 10)).into_iter().chain([lower])
    };
    let mipi_12 =
        |p: &[u16]| [upper(p[0], 12), upper(p[1], 12), low(p[0], 15) | low(p[1], 15) << 4];
    for (packing, bytes, expected) in [
        (Packing::Mono10p, consecutive(&TEN, 10), TEN),
        (Packing::Mono12p, consecutive(&twelve, 12), twelve),
        (Packing::Mono10Packed, pairs(&TEN, 10, 4), TEN),
        (Packing::Mono12Packed, pairs(&twelve, 12, 4), twelve),
        (Packing::Raw10, TEN.chunks(4).flat_map(mipi_10).collect(), TEN),
        (Packing::Raw12, twelve.chunks(2).flat_map(mipi_12).collect(), twelve),
        (Packing::Mono16, TEN.iter().flat_map(|s| s.to_le_bytes()).collect(), TEN),
        (Packing::Mono16BigEndian, TEN.iter().flat_map(|s| s.to_be_bytes()).collect(), TEN),
    ] {
        let set = InFolder::new();
        let plain = set.file("plain.raw", &bytes);
        let image = raw(packing, 0, None).read(&plain).unwrap();
        assert_eq!(
            (image.width, image.height, bits16(&image)),
            (6, 2, &expected[..]),
            "{packing:?}"
        );
        let headed = set.file("headed.BIN", &[&[9; 5][..], &bytes].concat());
        assert_eq!(raw(packing, 5, None).read(&headed).unwrap(), image, "{packing:?}");
        let more = set.file("more.raw", &[&bytes[..], &[0]].concat());
        let size = (bytes.len() + 1).to_string();
        refused(raw(packing, 0, None).read(&more), &["more.raw", &size, "[images.raw]", "6 x 2"]);
        refused(raw(packing, 1, None).read(&plain), &["plain.raw", "after a header (1 bytes)"]);
    }
    // The bytes of the definitions.
    let first = |packing: Packing, bytes: &[u8]| {
        let set = InFolder::new();
        let file = [bytes, &[0; 30][bytes.len()..]].concat();
        let layout = RawLayout { packing, header_bytes: 0, row_bytes: Some(15) };
        let reader = ImageReader::of_color(None).with_raw(Some(layout), (4, 2));
        bits16(&reader.read(&set.file("a.raw", &file)).unwrap())[..4].to_vec()
    };
    assert_eq!(first(Packing::Mono12p, &[0x34, 0xa2, 0x78])[..2], [0x234, 0x78a]);
    assert_eq!(first(Packing::Mono12Packed, &[0x23, 0xa4, 0x78])[..2], [0x234, 0x78a]);
    assert_eq!(first(Packing::Raw12, &[0x23, 0x78, 0xa4])[..2], [0x234, 0x78a]);
    assert_eq!(first(Packing::Raw10, &[0x80, 0x40, 0x20, 0x10, 0xe4]), [512, 257, 130, 67]);
    assert_eq!(first(Packing::Mono10p, &[0x01, 0x08, 0x30, 0x00, 0x01]), [1, 2, 3, 4]);
}

#[test]
fn rows_of_stated_length_are_read_and_impossible_ones_refused() {
    let set = InFolder::new();
    let rows = [consecutive(&TEN[..6], 10), consecutive(&TEN[6..], 10)];
    let padded = set.file("padded.raw", &[&rows[0][..], &[7, 7], &rows[1], &[7, 7]].concat());
    let image = raw(Packing::Mono10p, 0, Some(10)).read(&padded).unwrap();
    assert_eq!(bits16(&image), TEN);
    // The last row may end with its samples.
    let short = set.file("short.raw", &[&rows[0][..], &[7, 7], &rows[1]].concat());
    assert_eq!(raw(Packing::Mono10p, 0, Some(10)).read(&short).unwrap(), image);
    refused(raw(Packing::Mono10p, 0, Some(7)).read(&short), &["row_bytes is 7", "need 8 bytes"]);
    let wide = raw(Packing::Mono10p, 0, Some(u64::MAX)).read(&short);
    refused(wide, &["short.raw", "correct [images.raw]"]);
    let empty = set.file("empty.raw", &[]);
    refused(raw(Packing::Mono8, u64::MAX, None).read(&empty), &["0 bytes"]);
    // Not stated, or of another name.
    let reader = ImageReader::of_color(None);
    refused(
        reader.read(&short),
        &["short.raw", "[images.raw]", "packing", "Mono12p", "header_bytes"],
    );
    let other = set.file("other.dat", &[1; 12]);
    refused(raw(Packing::Mono8, 0, None).read(&other), &["other.dat", "not PNG"]);
}

#[test]
fn files_without_a_header_serve_like_others() {
    let set = CLEAN.copy();
    let reader = ImageReader::of_color(None);
    for name in CLEAN.names().filter(|name| name.extension().is_some_and(|kind| kind == "png")) {
        let path = set.path().join(name);
        let image = reader.read(&path).unwrap();
        let content = [&[255; 16][..], bits8(&image)].concat();
        fs::write(path.with_extension("raw"), content).unwrap();
    }
    let project = set.path().join("project.toml");
    let (a, b) = (set.path().join("a"), set.path().join("b"));
    program("detect", &project, &a).success();
    let text = fs::read_to_string(&project).unwrap().replace(".png", ".raw");
    fs::write(&project, &text).unwrap();
    program("detect", &project, &b).code(1).stderr(contains("add [images.raw] to a project"));
    let raw = "\n[images.raw]\npacking = \"Mono8\"\nheader_bytes = 16\n\n[[images.whites]]";
    let stated = text.replacen("\n[[images.whites]]", raw, 1);
    fs::write(&project, &stated).unwrap();
    program("detect", &project, &b).success();
    assert_eq!(
        fs::read(a.join("features.csv")).unwrap(),
        fs::read(b.join("features.csv")).unwrap()
    );
    assert_eq!(fs::read(a.join("centers.csv")).unwrap(), fs::read(b.join("centers.csv")).unwrap());
    fs::write(&project, stated.replace("Mono8", "Mono11p")).unwrap();
    program("detect", &project, &b).code(1).stderr(contains("Mono11p").and(contains("Mono12p")));

    // `init` leaves the layout to be filled in.
    for name in CLEAN.names().filter(|name| name.extension().is_some_and(|kind| kind == "png")) {
        fs::remove_file(set.path().join(name)).unwrap();
    }
    let made = set.path().join("made.toml");
    let mut init = plenocal();
    init.arg("init").arg(set.path()).arg("--out").arg(&made).args(["--preset", "mini"]);
    init.assert()
        .success()
        .stdout(contains("[images.raw] packing").and(contains("3 white images")));
    let made = fs::read_to_string(&made).unwrap();
    assert!(made.contains("# width_px = ?") && made.contains("[images.raw]"), "{made}");
}

#[test]
fn files_of_other_formats_are_refused_with_the_format_to_save() {
    let set = InFolder::new();
    let png = set.png("image.png", Samples::Bits8(vec![9; 384]));
    let png = fs::read(png).unwrap();
    for (name, content, words) in [
        ("a.ray", &png[..], "recording of Raytrix"),
        ("a.NEF", &png[..], "dcraw -D -4 -T -t 0"),
        ("a.dng", b"II*\0", "raw file of a photo camera"),
        ("a.lfr", b"\x89LFP\r\n\x1a\n", "Lytro"),
        ("a.png", b"\x89LFP\r\n\x1a\n", "Lytro"),
        ("a.h5", b"", "save the image in it as PNG or TIFF"),
        ("h5.tif", b"\x89HDF\r\n\x1a\n", "file of arrays"),
        ("b.png", b"SIMPLE  =                    T", "file of arrays"),
        ("c.png", b"\x93NUMPY", "file of arrays"),
        ("d.png", b"RIFFxxxxWEBP", "save the image as PNG or TIFF"),
    ] {
        let path = set.file(name, content);
        refused(ImageReader::default().read(&path), &[name, words]);
        refused(ImageReader::default().bytes(&path), &[name, words]);
    }
    // `init` lists them.
    let mut init = plenocal();
    init.arg("init").arg(set.folder.path()).arg("--out").arg(set.folder.path().join("p.toml"));
    fs::remove_file(set.folder.path().join("h5.tif")).unwrap();
    init.assert().success().stdout(contains("a.ray: a recording of Raytrix"));
}

/// A TIFF file with an orientation tag.
fn turned(orientation: u16) -> Vec<u8> {
    let mut bytes = Cursor::new(Vec::new());
    let mut encoder = TiffEncoder::new(&mut bytes).unwrap();
    let mut image = encoder.new_image::<colortype::Gray8>(24, 16).unwrap();
    image.encoder().write_tag(Tag::Orientation, orientation).unwrap();
    image.write_data(&[9; 384]).unwrap();
    bytes.into_inner()
}

#[test]
fn different_orientations_of_a_set_are_told() {
    let set = InFolder::new();
    let plain = set.png("plain.png", Samples::Bits8(vec![9; 384]));
    let [upright, on_side, too] =
        [("a.tif", 1), ("b.tif", 6), ("c.tif", 6)].map(|(name, of)| set.file(name, &turned(of)));
    let told = |files: &[&PathBuf]| ImageReader::default().findings(files);
    assert_eq!(told(&[&plain, &upright]), []);
    assert_eq!(crate::support::codes(&told(&[&on_side, &too])), ["image-orientation"]);
    let differ = told(&[&plain, &upright, &on_side, &too]);
    assert_eq!(crate::support::codes(&differ), ["image-orientations-differ"]);
    let words = "orientation 1: 2 images, first plain.png; orientation 6: 2 images, first b.tif";
    assert!(differ[0].message().contains(words), "{}", differ[0]);
    // Pixels stay as they are stored.
    let read = ImageReader::default().read(&on_side).unwrap();
    assert_eq!((read.width, read.height), (24, 16));
}
