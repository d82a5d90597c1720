//! The functions of this room.

use std::collections::BTreeMap;

use nalgebra::{Point3, Vector2};
use rayon::prelude::*;

use crate::error::{Error, Result};
use crate::model::{
    BapFeature, MetricPoint, MicroPixel, PlenopticCamera, Ray, SeenPoint, Sighting, VirtualPoint,
};
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
    points: &[SeenPoint],
    loss: Loss,
) -> Result<Vec<Option<MetricPoint>>> {
    camera.validate()?;
    in_chunks(points, |points| solver::triangulate(camera, points, loss))
}

/// Where the loss on the sightings of a corner sets in, σ: few features lie that far off, but those that do are false.
const LOSS_SCALE: f64 = 3.0;

/// Features without noise scatter by nothing; their variance is not taken to be less than this part of what they state.
const LEAST_SCATTER: f64 = 1e-6;
/// Rounds in which σ is set by the scatter.
const ROUNDS: usize = 2;
/// A scatter by fewer degrees of freedom is chance: σ is then as stated.
const LEAST_FREEDOM: usize = 30;

/// Corners of boards in space.
#[derive(Debug, Clone, PartialEq)]
pub struct Corners {
    /// Frame and number of each corner.
    pub labels: Vec<(u32, i32)>,
    /// Where they are; `None` where their features do not determine it.
    pub points: Vec<Option<MetricPoint>>,
    /// By how much features scatter more than their σ says, in variance; 1 if hardly anything is redundant.
    pub scatter: f64,
}

/// Corners from the features of boards: false ones are withstood (Huber, 3 σ), and covariances are multiplied by how much
/// features scatter more than their σ says, in the mean of all corners. σ of ρ is at least what the detection states: all
/// features of a corner were found with the same blur, which follows from their own line, so that they err together.
///
/// Features without σ have one of 1 px. An error as of [`triangulate`].
pub fn corners(camera: &PlenopticCamera, features: &[BapFeature]) -> Result<Corners> {
    let mut seen: BTreeMap<(u32, i32), SeenPoint> = BTreeMap::new();
    for f in features {
        let point = seen.entry((f.frame, f.corner)).or_default();
        point.sightings.push(Sighting {
            at: MicroPixel { k: f.k, l: f.l, u_px: f.u_px, v_px: f.v_px },
            std_dev_px: f.std_dev_px.unwrap_or([1.0; 2]),
            correlation: f.correlation,
            rho: None,
        });
        point.rho_std_dev_px = point.rho_std_dev_px.max(f.rho_std_dev_px.unwrap_or(0.0));
    }
    let (labels, mut seen): (Vec<_>, Vec<_>) = seen.into_iter().unzip();
    let loss = Loss { kind: LossKind::Huber, scale: LOSS_SCALE };
    let mut points = triangulate(camera, &seen, loss)?;
    let mut all = 1.0;
    // The loss sets in elsewhere once σ is right, and that changes the scatter a little.
    for _ in 0..ROUNDS {
        let more = scatter(&points);
        all *= more;
        let sightings = seen.iter_mut().flat_map(|point| &mut point.sightings);
        for std_dev in sightings.flat_map(|sighting| &mut sighting.std_dev_px) {
            *std_dev *= more.max(LEAST_SCATTER).sqrt();
        }
        points = triangulate(camera, &seen, loss)?;
    }
    Ok(Corners { labels, points, scatter: all })
}

/// χ² for each degree of freedom over all points.
fn scatter(points: &[Option<MetricPoint>]) -> f64 {
    let freedom: usize = points.iter().flatten().map(|p| p.freedom).sum();
    let chi_square: f64 = points.iter().flatten().map(|p| p.chi_square).sum();
    if freedom >= LEAST_FREEDOM { chi_square / freedom as f64 } else { 1.0 }
}
