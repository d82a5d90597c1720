//! The valid files that are damaged.

use std::fs;
use std::io::{Cursor, Write};
use std::path::{Path, PathBuf};

use flate2::Compression;
use flate2::write::GzEncoder;
use image::{DynamicImage, GrayImage, ImageFormat};
use plenocal::io::{Project, read_camera, read_centers, read_features, read_poses};
use plenocal::model::{Board, Datasheet, FramePose, Observations, PlenopticCamera};
use tiff::encoder::colortype::{ColorType, Gray8, Gray32, Gray32Float, Gray64Float, GrayI16};
use tiff::encoder::{Compression as Packing, TiffEncoder, TiffValue};

use super::documents::{self, FEW};

/// A file of the repository's data.
pub fn data(name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("data").join(name)
}

fn shipped(name: &str) -> PathBuf {
    data("synthetic").join(name)
}

fn bytes(path: &Path) -> Vec<u8> {
    fs::read(path).unwrap_or_else(|e| panic!("{}: {e}", path.display()))
}

/// The first lines of a file.
fn head(path: &Path) -> Vec<u8> {
    let text = String::from_utf8(bytes(path)).expect("a text");
    text.lines().take(FEW).flat_map(|line| [line, "\n"]).collect::<String>().into_bytes()
}

fn project() -> Project {
    Project::read(&shipped("project.toml")).expect("the shipped project is valid")
}

/// The shipped board.
pub const BOARD: Board = Board { columns: 9, rows: 5, square_mm: 3.0 };

/// The shipped datasheet.
pub fn datasheet() -> Datasheet {
    project().datasheet().expect("the tables are complete").expect("the project has a camera")
}

/// The shipped truth.
pub fn true_camera() -> PlenopticCamera {
    read_camera(&shipped("truth/camera.json")).expect("the truth is valid")
}

/// The shipped truth.
pub fn true_poses() -> Vec<FramePose> {
    read_poses(&shipped("truth/poses.json")).expect("the truth is valid")
}

/// The shipped observations.
pub fn observations() -> Observations {
    let read = read_features(&shipped("features.csv"), true);
    let mut observations = read.expect("the shipped features are valid");
    observations.centers = read_centers(&shipped("centers.csv")).expect("so are the centres");
    observations
}

fn pretty(document: &serde_json::Value) -> Vec<u8> {
    serde_json::to_vec_pretty(document).expect("a document is written")
}

pub fn projects() -> Vec<Vec<u8>> {
    vec![bytes(&shipped("project.toml")), documents::PROJECT.as_bytes().to_vec()]
}

pub fn features() -> Vec<Vec<u8>> {
    vec![head(&shipped("features.csv")), documents::full_features(), linked()]
}

/// CSV, features, maps of numbers and images.
pub fn virtual_depths() -> Vec<Vec<u8>> {
    let mut files = vec![
        b"k,l,u,v,nu\n5,5,120.5,100.25,2.5\n6,5,143.5,100.5,3\n".to_vec(),
        b"k,l,u,v,nu,std_u,std_v,std_nu\n5,5,120.5,100.25,2.5,0.1,0.1,0.02\n".to_vec(),
        documents::full_features(),
    ];
    let header = |kind: &str| {
        let text = format!("{{'descr': '{kind}', 'fortran_order': False, 'shape': (2, 3), }}\n");
        let length = u16::try_from(text.len()).expect("it is short");
        [b"\x93NUMPY\x01\x00", &length.to_le_bytes()[..], text.as_bytes()].concat()
    };
    let depths = [2.5, f32::NAN, 3.0, 2.25, 4.0, f32::NAN];
    files.push([header("<f4"), depths.map(f32::to_le_bytes).concat()].concat());
    files.push([header("<f8"), depths.map(|d| f64::from(d).to_le_bytes()).concat()].concat());
    files.extend(images().into_iter().take(3));
    files
}

pub fn centers() -> Vec<Vec<u8>> {
    let with_std_dev = "k,l,u,v,std_dev,type\n5,5,120.5,100.25,0.01,1\n6,5,143.5,100.5,,2\n";
    vec![head(&shipped("centers.csv")), with_std_dev.into(), linked()]
}

fn linked() -> Vec<u8> {
    let mut packed = GzEncoder::new(Vec::new(), Compression::fast());
    packed.write_all(&documents::linked()).expect("memory can be written");
    packed.finish().expect("memory can be written")
}

/// Not compressed: damage to the packed bytes is found by their checksum.
pub fn unpacked() -> Vec<Vec<u8>> {
    vec![documents::linked()]
}

/// Cameras of plenocal and COMPOTE.
pub fn cameras() -> Vec<Vec<u8>> {
    let [intrinsics, camera, ..] = documents::compote_documents();
    let [calibrated, ..] = &*documents::CALIBRATED;
    let shipped = bytes(&shipped("truth/camera.json"));
    let mut cameras = vec![shipped, pretty(calibrated), pretty(&intrinsics), pretty(&camera)];
    cameras.extend(projects());
    cameras
}

pub fn poses() -> Vec<Vec<u8>> {
    let [.., compote] = documents::compote_documents();
    let [_, calibrated, _] = &*documents::CALIBRATED;
    vec![pretty(calibrated), pretty(&compote)]
}

pub fn internal_parameters() -> Vec<Vec<u8>> {
    let [_, _, compote, _] = documents::compote_documents();
    vec![pretty(&documents::precalibration()), pretty(&compote), documents::PROJECT.into()]
}

pub fn boards() -> Vec<Vec<u8>> {
    vec![documents::SCENE.into(), documents::PROJECT.into()]
}

pub fn board_shapes() -> Vec<Vec<u8>> {
    let [_, _, calibration] = &*documents::CALIBRATED;
    vec![pretty(calibration)]
}

pub fn problems() -> Vec<Vec<u8>> {
    documents::PROBLEM.iter().take(1).map(|(_, bytes)| bytes.clone()).collect()
}

/// Writes the other files of a problem into its folder, unless they are there.
pub fn complete_problem(folder: &Path) {
    for (name, bytes) in documents::PROBLEM.iter().skip(1) {
        let path = folder.join(name);
        if !path.exists() {
            fs::write(&path, bytes).unwrap_or_else(|e| panic!("{}: {e}", path.display()));
        }
    }
}

pub fn true_boards() -> Vec<Vec<u8>> {
    vec![documents::BOARD_SHAPE.into()]
}

pub fn clouds() -> Vec<Vec<u8>> {
    vec![b"x y z\n# points\n1 2 3 255 0 0\n1\t2  5\n\n1,2,-4.5\n// end\n0;0;7.25\n".to_vec()]
}

pub fn raytrix() -> Vec<Vec<u8>> {
    vec![documents::raytrix().into_bytes()]
}

pub fn manifests() -> Vec<Vec<u8>> {
    let manifest = serde_json::to_value(documents::manifest()).expect("a manifest is written");
    vec![pretty(&manifest)]
}

pub fn simulations() -> Vec<Vec<u8>> {
    let presets = documents::toml_files("presets");
    presets.iter().chain(&documents::toml_files("simulations")).map(|path| bytes(path)).collect()
}

pub fn prescriptions() -> Vec<Vec<u8>> {
    documents::toml_files("lenses").iter().map(|path| bytes(path)).collect()
}

/// TIFF files of samples that are not those of a camera, `BigTIFF`, and a stack.
fn tiffs() -> Vec<Vec<u8>> {
    fn of<C: ColorType>(level: impl Fn(u16) -> C::Inner, big: bool, pages: usize) -> Vec<u8>
    where
        [C::Inner]: TiffValue,
    {
        const EDGE: u32 = 12;
        let samples: Vec<C::Inner> = (0..144).map(level).collect();
        let mut bytes = Cursor::new(Vec::new());
        if big {
            let mut encoder = TiffEncoder::new_big(&mut bytes).expect("memory can be written");
            for _ in 0..pages {
                encoder.write_image::<C>(EDGE, EDGE, &samples).expect("the size is right");
            }
        } else {
            let encoder = TiffEncoder::new(&mut bytes).expect("memory can be written");
            let mut encoder = encoder.with_compression(Packing::Lzw);
            for _ in 0..pages {
                encoder.write_image::<C>(EDGE, EDGE, &samples).expect("the size is right");
            }
        }
        bytes.into_inner()
    }
    vec![
        of::<Gray32Float>(|i| f32::from(i) * 100.25, false, 1),
        of::<Gray64Float>(|i| f64::from(i) * 100.25, true, 1),
        of::<GrayI16>(|i| i16::try_from(i).unwrap_or_default() * 100, false, 1),
        of::<Gray32>(|i| u32::from(i) * 400, true, 1),
        of::<Gray8>(|i| u8::try_from(i).unwrap_or_default(), false, 3),
    ]
}

/// Images with a profile, an orientation or several pages.
pub fn images_with_notes() -> Vec<Vec<u8>> {
    const FIRST_CHUNK: usize = 33;
    let mut files = tiffs();
    let [png, _, _, _, jpeg] = &images()[..5] else { return files };
    // Little-endian: an orientation, and an offset of the block with the colour space, both within the block.
    let exif = b"II*\0\x08\0\0\0\x02\0\x12\x01\x03\0\x01\0\0\0\x06\0\0\0\x69\x87\x04\0\x01\0\0\0\x26\0\0\0\0\0\0\0\
        \x01\0\x01\xa0\x03\0\x01\0\0\0\x01\0\0\0\0\0\0\0";
    let profile =
        [&[0; 128][..], b"\0\0\0\x01kTRC\0\0\0\x90\0\0\0\x0ecurv\0\0\0\0\0\0\0\x01\x02\x33"]
            .concat();
    let chunk = |name: &[u8], content: &[u8]| {
        let length = u32::try_from(content.len()).unwrap_or_default().to_be_bytes();
        [&length[..], name, content, &[0; 4]].concat()
    };
    let with = |file: &[u8], at: usize, piece: &[u8]| [&file[..at], piece, &file[at..]].concat();
    for piece in [chunk(b"eXIf", exif), chunk(b"gAMA", &45_455_u32.to_be_bytes())] {
        files.push(with(png, FIRST_CHUNK, &piece));
    }
    for (marker, begin, content) in
        [(0xe1, &b"Exif\0\0"[..], &exif[..]), (0xe2, b"ICC_PROFILE\0\x01\x01", &profile)]
    {
        let length = u16::try_from(begin.len() + content.len() + 2).unwrap_or_default();
        let segment = [&[0xff, marker][..], &length.to_be_bytes(), begin, content].concat();
        files.push(with(jpeg, 2, &segment));
    }
    files
}

/// Small images of every kind that is read.
pub fn images() -> Vec<Vec<u8>> {
    let pixel = |x, y| image::Luma([u8::try_from((7 * x + 13 * y) % 256).unwrap_or_default()]);
    let grey = DynamicImage::ImageLuma8(GrayImage::from_fn(24, 16, pixel));
    let kinds = [
        grey.clone(),
        DynamicImage::ImageLuma16(grey.to_luma16()),
        DynamicImage::ImageRgb8(grey.to_rgb8()),
        DynamicImage::ImageRgb16(grey.to_rgb16()),
        DynamicImage::ImageLumaA8(grey.to_luma_alpha8()),
        DynamicImage::ImageRgba16(grey.to_rgba16()),
        DynamicImage::ImageRgb32F(grey.to_rgb32f()),
    ];
    let formats = [
        ImageFormat::Png,
        ImageFormat::Tiff,
        ImageFormat::Bmp,
        ImageFormat::Pnm,
        ImageFormat::Jpeg,
    ];
    let encoded = |(image, format): (&DynamicImage, ImageFormat)| {
        let mut bytes = Cursor::new(Vec::new());
        // Not every format takes every kind of sample.
        image.write_to(&mut bytes, format).ok().map(|()| bytes.into_inner())
    };
    let mut files: Vec<Vec<u8>> = kinds
        .iter()
        .flat_map(|image| formats.map(|format| (image, format)))
        .filter_map(encoded)
        .collect();
    files.extend(tiffs());
    files.push(b"P2\n3 2\n255\n0 10 20\n30 40 50\n".to_vec());
    files.push(b"P3\n1 2\n65535\n0 10 20\n30 40 50\n".to_vec());
    files
}
