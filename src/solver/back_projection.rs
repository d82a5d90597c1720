//! From pixels back into space.

use nalgebra::{Point3, Vector2, Vector3};
use rayon::prelude::*;

use super::bridge::ffi::{
    self, CameraParts, Loss, MetricPoint, MicroPixel, Ray, SeenPoint, VirtualPoint,
};
use super::conversions::{found, rows};
use crate::error::{Error, Result};
use crate::model::PlenopticCamera;

/// Number of pixels that cross the bridge at once.
const CHUNK: usize = 4096;

/// Applies a function of the bridge to chunks, on all cores, and keeps the order.
fn in_chunks<T: Sync, R: Send>(
    camera: &PlenopticCamera,
    all: &[T],
    of_chunk: impl Fn(&CameraParts, &[T]) -> std::result::Result<Vec<R>, cxx::Exception> + Sync,
) -> Result<Vec<R>> {
    camera.validate()?;
    let camera = camera.into();
    let of_chunk = |chunk| Ok(of_chunk(&camera, chunk)?);
    let chunks: Vec<Vec<R>> = all.par_chunks(CHUNK).map(of_chunk).collect::<Result<_>>()?;
    Ok(chunks.into_iter().flatten().collect())
}

/// The micro-images (k, l) that pixels of the raw image belong to: those whose micro-lens is the nearest
/// to the ray from the exit pupil. `None` outside the array.
///
/// An error if the camera is not valid.
pub fn micro_images_at(
    camera: &PlenopticCamera,
    pixels: &[Vector2<f64>],
) -> Result<Vec<Option<(i32, i32)>>> {
    let all =
        in_chunks(camera, pixels, |camera, chunk| ffi::micro_images_at(camera, &rows(chunk)))?;
    Ok(all.iter().map(|at| (at.k >= 0).then_some((at.k, at.l))).collect())
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
    let rays = in_chunks(camera, pixels, |camera, chunk| ffi::object_rays(camera, chunk, z_mm))?;
    Ok(found(rays, |ray| ray.origin_mm[0]))
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
    let rays =
        in_chunks(camera, pixels, |camera, chunk| ffi::pixel_rays(camera, &rows(chunk), z_mm))?;
    Ok(found(rays, |ray| ray.origin_mm[0]))
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
    points(camera, seen, false)
}

/// The same of pixels of a total-focus image, as other software renders it: (u, v) is where the image of a point lies
/// across the axis, and the micro-image is not used.
///
/// Errors are as those of [`metric_points`].
pub fn focused_points(
    camera: &PlenopticCamera,
    seen: &[VirtualPoint],
) -> Result<Vec<Option<MetricPoint>>> {
    points(camera, seen, true)
}

fn points(
    camera: &PlenopticCamera,
    seen: &[VirtualPoint],
    focused: bool,
) -> Result<Vec<Option<MetricPoint>>> {
    let points =
        in_chunks(camera, seen, |camera, chunk| ffi::metric_points(camera, chunk, focused))?;
    Ok(found(points, |point| point.point_mm[0]))
}

/// Virtual depths of points of the camera frame (mm), each for the micro-lens of a pixel; `None` where there is none.
///
/// An error if the camera is not valid.
pub fn virtual_depths(
    camera: &PlenopticCamera,
    points: &[(MicroPixel, Point3<f64>)],
) -> Result<Vec<Option<f64>>> {
    let depths = in_chunks(camera, points, |camera, chunk| {
        let (at, points): (Vec<_>, Vec<_>) = chunk.iter().copied().unzip();
        ffi::virtual_depths(camera, &at, &rows(&points))
    })?;
    Ok(found(depths, |depth| *depth))
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
    let points = in_chunks(camera, points, |camera, chunk| ffi::triangulate(camera, chunk, &loss))?;
    Ok(found(points, |point| point.point_mm[0]))
}

impl Ray {
    /// The point at a distance from the main lens, mm.
    #[must_use]
    pub fn at(&self, z_mm: f64) -> Point3<f64> {
        let origin = Point3::from(self.origin_mm);
        let direction = Vector3::from(self.direction);
        origin + direction * ((z_mm - origin.z) / direction.z)
    }
}

impl MetricPoint {
    /// σ of x, y and z, mm.
    #[must_use]
    pub fn std_devs_mm(&self) -> [f64; 3] {
        [0, 4, 8].map(|i| self.covariance_mm2[i].sqrt())
    }
}

#[cfg(test)]
mod tests;
