//! `plenocal precalibrate`: measures the micro-image array and internal parameters on white images.

use std::path::{Path, PathBuf};
use std::process::ExitCode;

use clap::Args;
use nalgebra::Vector2;
use plenocal::image::Color;
use plenocal::io::{self, ImageReader, ImagesSection, OutputFolder, Pages, Project, compote};
use plenocal::model::{Datasheet, MicroImageCenter};
use plenocal::precalibration::{
    ArrayMeasurement, Precalibration, PrecalibrationOptions, RadiusEstimator, White,
    array_findings, fit_grid, measure_array, precalibrate,
};
use plenocal::quantity::counted;
use plenocal::report::{self, Figure};
use plenocal::{Error, Finding, Result, Subject};
use rayon::prelude::*;

use super::boards::{camera_of, listed_images};
use super::messages::{announce_memory, print_result, shown, tell};
use super::progress;

/// Measure the micro-image array and the internal parameters on white images.
///
/// Pitch (5 to 360 px), orientation, packing and lens types are found from the images. Give a
/// project file that lists them with their f-numbers, or a single white image to measure its array
/// alone.
#[derive(Args)]
#[command(after_help = EXAMPLES)]
pub struct Arguments {
    /// Project file (TOML) with [images], one white image (PNG, TIFF, BMP, PGM, JPEG), or a Raytrix calibration (XML), which
    /// gives the centres and lens types measured by the maker.
    input: PathBuf,
    /// Size of the images of a Raytrix calibration, e.g. 2048x2048.
    #[arg(long, value_name = "WxH", value_parser = size)]
    size: Option<(u16, u16)>,
    #[arg(long, value_name = "DIR", help = results_help!("precalibration.json and centers.csv; from images also \
micro-images.svg; from a project also radii.svg and COMPOTE's camera.js and params.js"))]
    out: PathBuf,
    /// Estimator of radii: the edge of a fitted profile, or the paper's second moments, which are right only for some
    /// over-exposures; for a project [default: profile].
    #[arg(long)]
    estimator: Option<RadiusEstimator>,
    /// Meaning of the samples of a single image [default: grey or RGB, as in the file].
    #[arg(long)]
    color: Option<Color>,
    /// Page of a single TIFF image that is read, from 1, or the mean of all pages: `average` [default: the first].
    #[arg(long)]
    pages: Option<Pages>,
    /// Image without light, which is subtracted from a single image.
    #[arg(long, value_name = "FILE")]
    dark: Option<PathBuf>,
    /// Print the result as one JSON object instead of tables.
    #[arg(long)]
    json: bool,
}

fn size(text: &str) -> std::result::Result<(u16, u16), String> {
    let parse = |number: &str| number.trim().parse::<u16>().ok().filter(|&n| n > 0);
    text.split_once('x').and_then(|(w, h)| Some((parse(w)?, parse(h)?))).ok_or_else(|| {
        format!("'{text}' is not a size: write it as 2048x2048, each edge from 1 to 65535 px")
    })
}

const EXAMPLES: &str = "\
Examples:
  plenocal precalibrate project.toml --out results
  plenocal precalibrate white.png --color bayer-rggb --out results
  plenocal calibrate project.toml --params results/precalibration.json \\
      --centers results/centers.csv --features features.csv --out results";

/// Kind of the input, by its file name extension.
#[derive(Clone, Copy, PartialEq)]
enum Kind {
    Project,
    Raytrix,
    Image,
}

impl Kind {
    fn of(input: &Path) -> Self {
        let ends_in = |name: &str| input.extension().is_some_and(|e| e.eq_ignore_ascii_case(name));
        if ends_in("toml") {
            Self::Project
        } else if ends_in("xml") {
            Self::Raytrix
        } else {
            Self::Image
        }
    }
}

const OF_PROJECT: [&str; 3] = [
    "--color is for a single image; a project states it in [images]",
    "--pages is for a single image; a project states it in [images]",
    "--dark is for a single image; a project states it in [images]",
];

/// Checks the options; an error names an option for another kind of input.
fn check_options(arguments: &Arguments, kind: Kind) -> Result<()> {
    let options = [
        (arguments.size.is_some(), Kind::Raytrix, "--size is for a Raytrix calibration (XML)"),
        (arguments.estimator.is_some(), Kind::Project, "--estimator is for a project (TOML)"),
        (arguments.color.is_some(), Kind::Image, OF_PROJECT[0]),
        (arguments.pages.is_some(), Kind::Image, OF_PROJECT[1]),
        (arguments.dark.is_some(), Kind::Image, OF_PROJECT[2]),
    ];
    match options.iter().find(|&&(given, of, _)| given && of != kind) {
        Some((.., what)) => {
            let error = Error::invalid(format!("{what}: leave it out here"));
            Err(error.in_file(&arguments.input))
        }
        None => Ok(()),
    }
}

/// Runs the command.
pub fn run(arguments: &Arguments) -> Result<ExitCode> {
    let kind = Kind::of(&arguments.input);
    check_options(arguments, kind)?;
    let mut output = OutputFolder::new(&arguments.out)?;
    let (text, document) = match kind {
        Kind::Project => of_project(arguments, &mut output),
        Kind::Raytrix => of_raytrix(arguments, &mut output),
        Kind::Image => of_image(arguments, &mut output),
    }?;
    output.stage_json("precalibration.json", &document)?;
    let paths = output.commit()?;
    print_result(arguments.json, &document, &text, &paths)?;
    Ok(ExitCode::SUCCESS)
}

fn of_image(
    arguments: &Arguments,
    output: &mut OutputFolder,
) -> Result<(String, serde_json::Value)> {
    let path = &arguments.input;
    let reader = ImageReader::of_color(arguments.color);
    let reader = reader.with_pages(arguments.pages.unwrap_or_default());
    let reader = match &arguments.dark {
        Some(dark) => reader.with_dark(dark, path)?,
        None => reader,
    };
    let bytes = reader.bytes(path)? as f64;
    announce_memory("measuring an image of this size", bytes * (1.0 + WORK_BYTES_ALONE));
    let image = reader.read(path)?;
    let array = measure_array(&image, None).map_err(|e| e.in_file(path))?;
    tell(&reader.findings(&[path]));
    let of_color = image.doubtful_color().map(Finding::caution).into_iter();
    let findings = of_color.chain(array_findings(&array, &image));
    tell(&findings.map(|f| f.about(Subject::File(path.clone()))).collect::<Vec<_>>());
    let half_pitch = array.grid.pitch_px / 2.0;
    let types = array.lens_types.types;
    let figure = report::micro_images_figure(&image, &array, &vec![half_pitch; types])?;
    output.stage(&figure.name, |out| out.write_all(figure.svg.as_bytes()))?;
    output.stage("centers.csv", |out| {
        let lens_type = |c: &MicroImageCenter| array.grid.lattice.lens_type(c.k, c.l, types);
        io::write_measured_centers(out, &array, lens_type)
    })?;
    let text = format!("{}\n{}", report::array_text(&array), report::types_text(&array.lens_types));
    Ok((text, io::array_document(&array)))
}

fn of_raytrix(
    arguments: &Arguments,
    output: &mut OutputFolder,
) -> Result<(String, serde_json::Value)> {
    let path = &arguments.input;
    let maker = io::read_raytrix(path)?;
    let findings = maker.findings().into_iter().map(|f| f.about(Subject::File(path.clone())));
    tell(&findings.collect::<Vec<_>>());
    let (width, height) = arguments.size.ok_or_else(|| {
        Error::invalid("a Raytrix calibration does not state the size of the images: give --size")
            .in_file(path)
    })?;
    let of_this_size = |e: Error| {
        Error::invalid(format!("in an image of {width} x {height} px: {e}. Check --size"))
            .in_file(path)
    };
    let about = maker.number_of_centers(width, height).map_err(of_this_size)?;
    announce_memory(&format!("an array of about {about:.0} micro-lenses"), about * CENTER_BYTES);
    let centers = maker.centers(width, height).map_err(of_this_size)?;
    let count =
        |index: fn(&MicroImageCenter) -> i32| centers.iter().map(index).max().unwrap_or(-1) + 1;
    let (columns, rows) = (count(|c| c.k), count(|c| c.l));
    let grid = fit_grid(&centers, maker.kind, columns, rows).map_err(of_this_size)?;
    let array = ArrayMeasurement::of_grid(grid, centers, maker.lens_types);
    output.stage("centers.csv", |out| {
        let place = |c: &MicroImageCenter| Vector2::new(c.u_px, c.v_px);
        io::write_measured_centers(out, &array, |c| maker.lens_type(width, height, place(c)))
    })?;
    let text = format!(
        "{}\n{}, numbered from 1 in the order of the file.",
        report::array_text(&array),
        counted(maker.lens_types, "lens type")
    );
    Ok((text, io::array_document(&array)))
}

fn of_project(
    arguments: &Arguments,
    output: &mut OutputFolder,
) -> Result<(String, serde_json::Value)> {
    let path = &arguments.input;
    let project = Project::read(path)?;
    let sheet = camera_of(path, &project)?;
    let images = listed_images(path, &project, "[[images.whites]]")?;
    let reader = images.reader(&sheet.sensor)?;
    let options = PrecalibrationOptions {
        estimator: arguments.estimator.unwrap_or_default(),
        black_level: reader.black_level(),
        ..PrecalibrationOptions::of_datasheet(&sheet)
    };
    let (result, whites) = measure(path, &images, &reader, &sheet, &options, arguments.json)?;
    tell(&of_whites(&images, &reader));
    tell(&result.findings);
    stage(output, &result, &sheet, &whites)?;
    let section = report::precalibration_section(&result, Vec::new());
    Ok((shown(&section), io::precalibration_document(&result)))
}

/// Returns findings about the files of the white images.
fn of_whites(images: &ImagesSection, reader: &ImageReader) -> Vec<Finding> {
    let none = ImagesSection { calibration: Vec::new(), evaluation: Vec::new(), ..images.clone() };
    io::doubtful_files(&ImagesSection { translation: None, ..none }, reader)
}

/// Measures the white images of a project, and returns the images too.
pub(super) fn measure(
    path: &Path,
    images: &ImagesSection,
    reader: &ImageReader,
    sheet: &Datasheet,
    options: &PrecalibrationOptions,
    quiet: bool,
) -> Result<(Precalibration, Vec<White>)> {
    announce(images, reader)?;
    let (whites, reference) = read_whites(images, reader, sheet).map_err(|e| e.in_file(path))?;
    let bar = progress::steps(quiet, whites.len(), "measuring white images");
    let result = precalibrate(&whites, reference.as_ref(), options, &|| bar.inc());
    bar.finish();
    Ok((result.map_err(|e| e.in_file(path))?, whites))
}

/// Stages everything but precalibration.json.
pub(super) fn stage(
    output: &mut OutputFolder,
    result: &Precalibration,
    sheet: &Datasheet,
    whites: &[White],
) -> Result<Vec<Figure>> {
    let types = result.lens_types.types;
    let internal = &result.internal.parameters;
    stage_centers(output, result)?;
    output.stage_json("params.js", &compote::parameters_document(internal, sheet))?;
    let camera = compote::camera_document(sheet, &result.array.grid, types);
    output.stage_json("camera.js", &camera)?;
    let middle = result.images.len() / 2;
    let of_middle = |white: &&White| white.name == result.images[middle];
    let shown = whites.iter().find(of_middle).unwrap_or(&whites[0]);
    let figures = report::precalibration_figures(result, &shown.image)?;
    for figure in &figures {
        output.stage(&figure.name, |out| out.write_all(figure.svg.as_bytes()))?;
    }
    Ok(figures)
}

/// Stages centers.csv.
pub(super) fn stage_centers(output: &mut OutputFolder, result: &Precalibration) -> Result<()> {
    let types = result.lens_types.types;
    let lens_type = |c: &MicroImageCenter| result.array.grid.lattice.lens_type(c.k, c.l, types);
    output.stage("centers.csv", |out| io::write_measured_centers(out, &result.array, lens_type))
}

/// Memory of the measurement per pixel, without the images, bytes: 9 were measured on images of 12.5 MP, 5 with a single image.
const WORK_BYTES: f64 = 9.0;
const WORK_BYTES_ALONE: f64 = 5.0;

/// Memory of a centre of a maker's calibration, bytes: 180 were measured with 16 million centres.
const CENTER_BYTES: f64 = 180.0;

/// Announces the memory for the white images of a project, all of which are measured together.
fn announce(images: &ImagesSection, reader: &ImageReader) -> Result<()> {
    let files = images.whites.iter().map(|white| &white.image).chain(&images.devignetting);
    let bytes: Vec<u64> = files.map(|path| reader.bytes(path)).collect::<Result<_>>()?;
    let all: f64 = bytes.iter().map(|bytes| *bytes as f64).sum();
    // The number of bytes is an upper limit of the number of pixels: a pixel takes one, two, three or six bytes.
    let largest = bytes.iter().max().map_or(0.0, |bytes| *bytes as f64);
    let work = format!("measuring {} white images together", bytes.len());
    announce_memory(&work, all + WORK_BYTES * largest);
    Ok(())
}

/// Reads the white images of a project, and its devignetting image.
fn read_whites(
    images: &ImagesSection,
    reader: &ImageReader,
    sheet: &Datasheet,
) -> Result<(Vec<White>, Option<White>)> {
    let named = images.whites.iter().map(|white| Ok((&white.image, white.f_number()?)));
    let reference = images.devignetting.iter().map(|path| Ok((path, sheet.f_number)));
    let all = named.chain(reference).collect::<Result<Vec<(&PathBuf, f64)>>>()?;
    let mut whites = all
        .par_iter()
        .map(|&(path, f_number)| {
            let image = reader.read(path)?;
            Ok(White { name: path.display().to_string(), f_number, image })
        })
        .collect::<Result<Vec<White>>>()?;
    let reference = images.devignetting.as_ref().and_then(|_| whites.pop());
    Ok((whites, reference))
}
