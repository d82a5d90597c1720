//! Writes the figures of the documentation: crops of simulated raw images, enlarged four times, and
//! what pre-calibration and detection find in them.
//!
//!     cargo run --release --example figures -- docs/figures

#![allow(clippy::cast_possible_truncation)] // images of less than a megapixel

use std::io::Cursor;
use std::path::Path;

use image::imageops::{FilterType, crop_imm, replace, resize};
use image::{DynamicImage, GrayImage, ImageFormat, Luma};
use plenocal::detection::{DepthEstimator, MicroImages, Search, detect_frame};
use plenocal::image::{RawImage, Samples};
use plenocal::io::OutputFolder;
use plenocal::precalibration::{PrecalibrationOptions, White, precalibrate};
use plenocal::simulation::{DataSet, Imaging, PRESETS, Settings, Shot};
use plenocal::{Result, report};

/// Size of a crop, px.
const CROP: (u32, u32) = (140, 105);
const ENLARGED: u32 = 4;
/// Gap between two crops, px.
const GAP: u32 = 8;

fn grey(raw: &RawImage) -> GrayImage {
    let Samples::Bits8(samples) = &raw.samples else { panic!("an 8-bit image") };
    GrayImage::from_raw(raw.width as u32, raw.height as u32, samples.clone()).expect("its size")
}

/// Crops about (u, v), enlarged without smoothing, side by side.
fn side_by_side(images: &[GrayImage], (u, v): (u32, u32)) -> GrayImage {
    let (width, height) = (CROP.0 * ENLARGED, CROP.1 * ENLARGED);
    let count = images.len() as u32;
    let mut all = GrayImage::from_pixel(count * (width + GAP) - GAP, height, Luma([255]));
    for (i, image) in (0..).zip(images) {
        let part = crop_imm(image, u - CROP.0 / 2, v - CROP.1 / 2, CROP.0, CROP.1).to_image();
        let part = resize(&part, width, height, FilterType::Nearest);
        replace(&mut all, &part, i64::from(i * (width + GAP)), 0);
    }
    all
}

/// Adds a style with which a drawing exchanges light and dark where the reader prefers dark.
fn light_or_dark(svg: &str) -> String {
    const STYLE: &str = "\n<style>@media (prefers-color-scheme: dark) { svg { filter: invert(0.93) \
                         hue-rotate(180deg); } }</style>";
    let (head, content) = svg.split_at(svg.find('>').map_or(0, |end| end + 1));
    format!("{head}{STYLE}{content}")
}

fn main() -> Result<()> {
    let folder = std::env::args().nth(1).unwrap_or_else(|| "docs/figures".to_owned());
    let settings = Settings::preset(PRESETS[0].name, &["rays=256".to_owned()])?;
    let data_set = DataSet::plan(&settings, None)?;
    let take = |shot: &Shot| shot.take(&settings, &|| ()).map(|raw| grey(&raw));

    let white = data_set.whites[2];
    let amplified = Shot { imaging: Imaging { gain: 4.0, ..white.imaging }, ..white };
    let whites = side_by_side(&[take(&white)?, take(&amplified)?], (500, 375));

    // Far and near: the three types exchange their blur.
    let frames = &data_set.subsets[2];
    let (far, near) = (take(&frames[frames.len() - 1].1)?, take(&frames[0].1)?);
    let boards = side_by_side(&[far, near], (500, 375));

    let taken = |shot: &Shot| {
        let name = format!("f/{:.2}", shot.f_number);
        let image = shot.take(&settings, &|| ())?;
        Ok(White { name, f_number: shot.f_number, image })
    };
    let whites_taken = data_set.whites.iter().map(taken).collect::<Result<Vec<White>>>()?;
    let sheet = settings.datasheet();
    let options = PrecalibrationOptions::of_datasheet(&sheet);
    let result = precalibrate(&whites_taken, None, &options, &|| ())?;
    let middle = whites_taken.len() / 2;
    let (image, radii) = (&whites_taken[middle].image, result.radii_px(middle));
    let found = report::micro_images_figure(image, &result.array, &radii)?;

    let micro_images = MicroImages::of_precalibration(&result, &sheet)?;
    let board = settings.target.board();
    let search = Search {
        micro_images: &micro_images,
        board: &board,
        sensor: &sheet.sensor,
        estimator: DepthEstimator::default(),
    };
    let (pose, shot) = &data_set.subsets[0][4];
    let reference = data_set.devignetting.take(&settings, &|| ())?;
    let image = shot.take(&settings, &|| ())?;
    let (detected, _) = detect_frame(pose.frame, &image.grey(), &reference.grey(), &search);
    let detected = detected.expect("the board is in view");
    let features = report::features_figure(&report::Photograph::of(&image), &detected, &board)?;

    let mut output = OutputFolder::new(Path::new(&folder))?;
    for (name, figure) in [
        ("radii.svg", light_or_dark(&report::radii_figure(&result).svg)),
        ("micro-images.svg", found.svg),
        ("features.svg", features),
    ] {
        output.stage(name, |out| out.write_all(figure.as_bytes()))?;
    }
    for (name, figure) in [("white.png", whites), ("board.png", boards)] {
        let mut bytes = Cursor::new(Vec::new());
        DynamicImage::from(figure)
            .write_to(&mut bytes, ImageFormat::Png)
            .expect("a picture in memory can be written");
        output.stage(name, |out| out.write_all(bytes.get_ref()))?;
    }
    for path in output.commit()? {
        println!("{}", path.display());
    }
    Ok(())
}
