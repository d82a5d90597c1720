//! `plenocal rays`: computes the ray of every pixel.

use std::io::{self as std_io, Write};
use std::path::PathBuf;
use std::process::ExitCode;

use clap::Args;
use nalgebra::{Point3, Vector2};
use plenocal::io::{NpyHeader, OutputFolder};
use plenocal::model::PlenopticCamera;
use plenocal::quantity::significant;
use plenocal::solver::{Ray, micro_images_at, pixel_rays};
use plenocal::{Error, Result};
use serde_json::{Value, json};

use super::evaluate::{calibrated, distance_check};
use super::messages::{announce_file, print_result, tell};
use super::progress;

/// Compute the ray in space of every pixel of a calibrated camera.
///
/// A pixel belongs to the micro-image whose micro-lens is nearest to the point where the ray from the centre of the exit pupil
/// to the pixel meets the array. Its ray is the chief ray, which passes through the centre of that micro-lens. Rays are in the
/// camera frame: the origin is the middle of the main lens, x points to the right, y down and z towards the scene.
#[derive(Args)]
#[command(after_help = EXAMPLES)]
pub struct Arguments {
    /// Calibrated camera (camera.json, COMPOTE's intrinsics.js).
    camera: PathBuf,
    #[arg(long, value_name = "DIR", help = results_help!("rays.npy, rays.json, and with --micro-images micro-images.npy"))]
    out: PathBuf,
    /// Distance of the origins of rays from the main lens, mm [default: the plane in focus, or 100 focal lengths if that is at
    /// infinity or not known]. Distortion bends rays a little; they are exact at this distance.
    #[arg(long, value_name = "MM")]
    at: Option<f64>,
    /// Write numbers of 64 bits instead of 32.
    #[arg(long)]
    double: bool,
    /// Also write the micro-image (k, l) of each pixel.
    #[arg(long)]
    micro_images: bool,
    /// Print a summary as one JSON object instead of sentences.
    #[arg(long)]
    json: bool,
}

const EXAMPLES: &str = "\
Examples:
  plenocal rays results/calibration/camera.json --out rays
  plenocal rays camera.json --at 450 --micro-images --out rays

In Python:
  rays = numpy.load('rays/rays.npy')       # height x width x 6, mm; NaN where there is none
  origin, direction = rays[v, u, :3], rays[v, u, 3:]";

/// Number of pixels whose rays are computed at once: all rays of a large sensor would take tens of gigabytes.
const AT_ONCE: u64 = 1 << 16;
/// Distance of the origins of rays of a lens focused at infinity, in focal lengths.
const FAR: f64 = 100.0;
/// Multiples of the distance at which the bending of rays is measured. It is measured on every `SPARSE`-th pixel along u and v,
/// but on at most `MOST_ALONG` pixels along each.
const MULTIPLES: [f64; 2] = [0.7, 1.5];
const SPARSE: u32 = 37;
const MOST_ALONG: u32 = 500;

/// Runs the command.
pub fn run(arguments: &Arguments) -> Result<ExitCode> {
    let mut output = OutputFolder::new(&arguments.out)?;
    let camera = calibrated(&arguments.camera)?;
    let at_mm = arguments.at.unwrap_or_else(|| default_distance(&camera));
    let bend = bend(&camera, at_mm)?;
    let (width, height) = (camera.sensor.width_px, camera.sensor.height_px);
    let bar = progress::share(camera.sensor.pixels());
    let mut count = 0;
    let shape = [height as usize, width as usize, 6];
    let size = if arguments.double { 8.0 } else { 4.0 };
    announce_file("rays.npy", camera.sensor.pixels() as f64 * 6.0 * size);
    let header = NpyHeader::floats(arguments.double, &shape);
    let staged = output.stage("rays.npy", |out| {
        header.write(out)?;
        for pixels in pieces(&camera) {
            let rays = pixel_rays(&camera, &pixels, at_mm).map_err(std_io::Error::other)?;
            count += rays.iter().flatten().count();
            write_rays(out, &rays, arguments.double)?;
            bar.inc(pixels.len() as u64);
        }
        Ok(())
    });
    bar.finish_and_clear();
    staged?;
    if arguments.micro_images {
        stage_micro_images(&mut output, &camera)?;
    }
    let pixels = camera.sensor.pixels();
    let document = json!({
        "format": "plenocal-rays",
        "version": 1,
        "camera": arguments.camera.display().to_string(),
        "columns": ["x_mm", "y_mm", "z_mm", "dx", "dy", "dz"],
        "width_px": width,
        "height_px": height,
        "at_mm": at_mm,
        "rays": count,
        "pixels": pixels,
        "bend": bend.iter().map(Bend::document).collect::<Vec<Value>>(),
    });
    output.stage_json("rays.json", &document)?;
    let doubt = distance_check(&arguments.camera)?.and_then(|mut check| {
        check.count(at_mm);
        check.finding()
    });
    let paths = output.commit()?;
    tell(&doubt);
    let bends: Vec<String> = bend.iter().map(Bend::text).collect();
    let text = format!(
        "{count} of {pixels} pixels have a ray; the others are outside the array.\nRays begin at {at_mm:.1} mm from the \
         main lens. {}",
        bends.join(" ")
    );
    print_result(arguments.json, &document, &text, &paths)?;
    Ok(ExitCode::SUCCESS)
}

/// Returns the distance of the plane in focus from the main lens, mm; `FAR` focal lengths if it is at infinity or not known.
pub(super) fn default_distance(camera: &PlenopticCamera) -> f64 {
    let behind_mm = camera.mla.lens_to_mla_mm + camera.mla.mla_to_sensor_mm;
    let focused_mm =
        camera.main_lens.setting.map_or(f64::INFINITY, |s| s.focus_distance_mm) - behind_mm;
    let far_mm = FAR * camera.main_lens.focal_length_mm;
    if focused_mm.is_finite() {
        focused_mm.max(1.01 * camera.main_lens.focal_length_mm)
    } else {
        far_mm
    }
}

/// Returns all pixels, row by row, in pieces.
fn pieces(camera: &PlenopticCamera) -> impl Iterator<Item = Vec<Vector2<f64>>> {
    let width = u64::from(camera.sensor.width_px);
    let count = camera.sensor.pixels();
    let pixel = move |i: u64| Vector2::new((i % width) as f64, (i / width) as f64);
    let step = usize::try_from(AT_ONCE).unwrap_or(usize::MAX);
    (0..count)
        .step_by(step)
        .map(move |first| (first..count.min(first + AT_ONCE)).map(pixel).collect())
}

fn write_rays(out: &mut dyn Write, rays: &[Option<Ray>], double: bool) -> std_io::Result<()> {
    let mut bytes = Vec::with_capacity(rays.len() * 48);
    for ray in rays {
        let values = ray.map_or([f64::NAN; 6], |ray| {
            let ([x, y, z], [dx, dy, dz]) = (ray.origin_mm, ray.direction);
            [x, y, z, dx, dy, dz]
        });
        for value in values {
            if double {
                bytes.extend_from_slice(&value.to_le_bytes());
            } else {
                #[allow(clippy::cast_possible_truncation)] // as documented
                bytes.extend_from_slice(&(value as f32).to_le_bytes());
            }
        }
    }
    out.write_all(&bytes)
}

fn stage_micro_images(output: &mut OutputFolder, camera: &PlenopticCamera) -> Result<()> {
    let (width, height) = (camera.sensor.width_px, camera.sensor.height_px);
    let header = NpyHeader::integers(&[height as usize, width as usize, 2]);
    announce_file("micro-images.npy", camera.sensor.pixels() as f64 * 8.0);
    output.stage("micro-images.npy", |out| {
        header.write(out)?;
        for pixels in pieces(camera) {
            let found = micro_images_at(camera, &pixels);
            let found = found.map_err(std_io::Error::other)?;
            let indices = found.into_iter().map(|at| at.unwrap_or((-1, -1)));
            let bytes: Vec<u8> =
                indices.flat_map(|(k, l)| [k, l]).flat_map(i32::to_le_bytes).collect();
            out.write_all(&bytes)?;
        }
        Ok(())
    })?;
    Ok(())
}

/// Distance of rays from the points that the model images, at one distance from the lens.
struct Bend {
    at_mm: f64,
    /// RMS and largest distance across the axis, mm.
    rms_mm: f64,
    largest_mm: f64,
}

impl Bend {
    fn document(&self) -> Value {
        json!({ "at_mm": self.at_mm, "rms_mm": self.rms_mm, "largest_mm": self.largest_mm })
    }

    fn text(&self) -> String {
        format!(
            "At {:.0} mm their error is {} mm RMS, at most {} mm.",
            self.at_mm,
            significant(self.rms_mm, 3),
            significant(self.largest_mm, 3)
        )
    }
}

fn bend(camera: &PlenopticCamera, at_mm: f64) -> Result<Vec<Bend>> {
    let along = |size: u32| {
        let step = SPARSE.max(size.div_ceil(MOST_ALONG));
        // A sensor with fewer pixels than a step is measured at its middle.
        let first = if size > step / 2 { step / 2 } else { size / 2 };
        (first..size).step_by(step as usize)
    };
    let places: Vec<Vector2<f64>> = along(camera.sensor.height_px)
        .flat_map(|v| {
            along(camera.sensor.width_px).map(move |u| Vector2::new(f64::from(u), f64::from(v)))
        })
        .collect();
    let rays = pixel_rays(camera, &places, at_mm)?;
    let nearest_mm = camera.main_lens.focal_length_mm;
    let distances = MULTIPLES.map(|multiple| multiple * at_mm);
    let measured = distances.into_iter().filter(|z_mm| *z_mm > nearest_mm).map(|z_mm| {
        let there = pixel_rays(camera, &places, z_mm)?;
        let off = |(ray, exact): (&Option<Ray>, &Option<Ray>)| {
            let (ray, exact) = ((*ray)?, (*exact)?);
            Some((ray.at(z_mm) - Point3::from(exact.origin_mm)).norm())
        };
        let off: Vec<f64> = rays.iter().zip(&there).filter_map(off).collect();
        let square: f64 = off.iter().map(|x| x * x).sum();
        Ok(Bend {
            at_mm: z_mm,
            rms_mm: (square / off.len().max(1) as f64).sqrt(),
            largest_mm: off.iter().copied().fold(0.0, f64::max),
        })
    });
    let measured: Vec<Bend> = measured.collect::<Result<_>>()?;
    if rays.iter().all(Option::is_none) {
        return Err(Error::invalid(
            "no pixel of this camera has a ray: check that its array covers its sensor",
        ));
    }
    Ok(measured)
}
