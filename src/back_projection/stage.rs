//! The functions of this room.

use nalgebra::{Point3, Vector2};
use rayon::prelude::*;

use crate::error::{Error, Result};
use crate::model::{MetricPoint, MicroPixel, PlenopticCamera, Ray, Sighting, VirtualPoint};
use crate::solver::{self, Loss, LossKind};

/// So many pixels cross the bridge at once.
const CHUNK: usize = 4096;

/// Many at once, on all cores, in their order.
fn in_chunks<T: Sync, R: Send>(
    all: &[T],
    of_chunk: impl Fn(&[T]) -> Result<Vec<R>> + Sync + Send,
) -> Result<Vec<R>> {
    let chunks: Vec<Vec<R>> = all.par_chunks(CHUNK).map(of_chunk).collect::<Result<_>>()?;
    Ok(chunks.into_iter().flatten().collect())
}

/// The micro-images (k, l) that pixels of the raw image belong to: those whose micro-lens is the nearest to the ray from
/// the exit pupil. `None` outside the array.
///
/// An error if the camera is not valid.
pub fn micro_images_at(
    camera: &PlenopticCamera,
    pixels: &[Vector2<f64>],
) -> Result<Vec<Option<(i32, i32)>>> {
    camera.validate()?;
    in_chunks(pixels, |pixels| solver::micro_images_at(camera, pixels))
}

/// The chief rays of pixels, with their origins at the distance `z_mm` from the main lens. `None` where the camera sees
/// nothing there. Distortion and field curvature bend rays a little; these touch the true ones at `z_mm`.
///
/// An error if the camera is not valid, or the distance not beyond its focal length.
pub fn object_rays(
    camera: &PlenopticCamera,
    pixels: &[MicroPixel],
    z_mm: f64,
) -> Result<Vec<Option<Ray>>> {
    check_rays(camera, z_mm)?;
    in_chunks(pixels, |pixels| solver::object_rays(camera, pixels, z_mm))
}

/// The same of pixels in the micro-images that they belong to ([`micro_images_at`]).
///
/// Errors are those of [`object_rays`].
pub fn pixel_rays(
    camera: &PlenopticCamera,
    pixels: &[Vector2<f64>],
    z_mm: f64,
) -> Result<Vec<Option<Ray>>> {
    check_rays(camera, z_mm)?;
    in_chunks(pixels, |pixels| solver::pixel_rays(camera, pixels, z_mm))
}

fn check_rays(camera: &PlenopticCamera, z_mm: f64) -> Result<()> {
    camera.validate()?;
    let focal_length_mm = camera.main_lens.focal_length_mm;
    if z_mm.is_finite() && z_mm > focal_length_mm {
        return Ok(());
    }
    Err(Error::invalid(format!(
        "rays begin at {z_mm} mm, but the camera sees only what is beyond its focal length of {focal_length_mm} mm"
    )))
}

/// The points that are seen at virtual depths; `None` where there is none.
///
/// An error if the camera is not valid, or a σ negative or not finite.
pub fn metric_points(
    camera: &PlenopticCamera,
    seen: &[VirtualPoint],
) -> Result<Vec<Option<MetricPoint>>> {
    camera.validate()?;
    in_chunks(seen, |seen| solver::metric_points(camera, seen, false))
}

/// The same of pixels of a total-focus image, as other software renders it: (u, v) is where the image of a point lies
/// across the axis, and the micro-image is not used.
///
/// Errors are as those of [`metric_points`].
pub fn focused_points(
    camera: &PlenopticCamera,
    seen: &[VirtualPoint],
) -> Result<Vec<Option<MetricPoint>>> {
    camera.validate()?;
    in_chunks(seen, |seen| solver::metric_points(camera, seen, true))
}

/// Virtual depths of points of the camera frame (mm), each for the micro-lens of a pixel; `None` where there is none.
///
/// An error if the camera is not valid.
pub fn virtual_depths(
    camera: &PlenopticCamera,
    points: &[(MicroPixel, Point3<f64>)],
) -> Result<Vec<Option<f64>>> {
    camera.validate()?;
    in_chunks(points, |points| solver::virtual_depths(camera, points))
}

/// Points that several micro-lenses see, each by the weighted least squares of its sightings, where a loss on |r/σ| may
/// withstand false ones; `None` where they do not determine it.
///
/// An error if the camera is not valid, or a σ not positive.
pub fn triangulate(
    camera: &PlenopticCamera,
    points: &[Vec<Sighting>],
    loss: Loss,
) -> Result<Vec<Option<MetricPoint>>> {
    camera.validate()?;
    in_chunks(points, |points| solver::triangulate(camera, points, loss))
}

/// Where the loss on the sightings of a corner sets in, σ: few features lie that far off, but those that do are false.
const LOSS_SCALE: f64 = 3.0;

/// Sightings without noise scatter by nothing; the loss then sets in at this fraction of its place.
const LEAST_SCATTER: f64 = 1e-3;
/// A scatter by fewer degrees of freedom is chance: σ is then as stated.
const LEAST_FREEDOM: usize = 30;

/// Corners from what boards show of them: false sightings are withstood (Huber, 3 σ), and covariances are multiplied by how
/// much sightings scatter more than their σ says, in variance, in the mean of all corners. That factor is returned too; 1 if
/// hardly anything is redundant.
///
/// An error as of [`triangulate`].
pub fn corners(
    camera: &PlenopticCamera,
    points: &[Vec<Sighting>],
) -> Result<(Vec<Option<MetricPoint>>, f64)> {
    let loss = Loss { kind: LossKind::Huber, scale: LOSS_SCALE };
    let first = triangulate(camera, points, loss)?;
    let factor = scatter(&first);
    // The loss sets in where it should once σ is right.
    let loss = Loss { scale: LOSS_SCALE * factor.sqrt().max(LEAST_SCATTER), ..loss };
    let mut found = triangulate(camera, points, loss)?;
    let factor = scatter(&found);
    for point in found.iter_mut().flatten() {
        point.covariance_mm2 *= factor;
    }
    Ok((found, factor))
}

/// χ² for each degree of freedom over all points.
fn scatter(points: &[Option<MetricPoint>]) -> f64 {
    let freedom: usize = points.iter().flatten().map(|p| p.freedom).sum();
    let chi_square: f64 = points.iter().flatten().map(|p| p.chi_square).sum();
    if freedom >= LEAST_FREEDOM { chi_square / freedom as f64 } else { 1.0 }
}
