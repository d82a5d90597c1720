//! Back-projection from pixels into space.

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

/// Returns the micro-images (k, l) to which pixels of the raw image belong: the micro-lens of each is nearest to the ray from
/// the exit pupil. `None` outside the array.
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

/// Computes the chief rays of pixels, with their origins at the distance `z_mm` from the main lens. `None` if the camera sees
/// nothing there. Distortion and field curvature bend rays a little; these are tangents to the true ones at `z_mm`.
///
/// An error if the camera is not valid, or if the distance is not beyond its focal length.
pub fn object_rays(
    camera: &PlenopticCamera,
    pixels: &[MicroPixel],
    z_mm: f64,
) -> Result<Vec<Option<Ray>>> {
    check_rays(camera, z_mm)?;
    let rays = in_chunks(camera, pixels, |camera, chunk| ffi::object_rays(camera, chunk, z_mm))?;
    Ok(found(rays, |ray| ray.origin_mm[0]))
}

/// Computes the chief rays of pixels in the micro-images to which they belong ([`micro_images_at`]).
///
/// Errors are the same as in [`object_rays`].
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
        "rays begin at {z_mm} mm, but have to begin beyond the focal length of the camera, \
         {focal_length_mm} mm"
    )))
}

/// Computes the points seen at virtual depths; `None` if there is no such point.
///
/// An error if the camera is not valid, or a σ negative or not finite.
pub fn metric_points(
    camera: &PlenopticCamera,
    seen: &[VirtualPoint],
) -> Result<Vec<Option<MetricPoint>>> {
    points(camera, seen, false)
}

/// Computes the points for pixels of a total-focus image of other software: (u, v) is the position of the image of a point
/// across the axis, and the micro-image is not used.
///
/// Errors are the same as in [`metric_points`].
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

/// Computes the virtual depths of points of the camera frame (mm), each for the micro-lens of a pixel; `None` if there is none.
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

/// Triangulates points seen through several micro-lenses, each by weighted least squares over its sightings. A loss on |r/σ|
/// makes it robust to outliers. `None` if the sightings do not determine a point.
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
    /// Returns the point at a distance from the main lens, mm.
    #[must_use]
    pub fn at(&self, z_mm: f64) -> Point3<f64> {
        let origin = Point3::from(self.origin_mm);
        let direction = Vector3::from(self.direction);
        origin + direction * ((z_mm - origin.z) / direction.z)
    }
}

impl MetricPoint {
    /// Returns σ of x, y and z, mm.
    #[must_use]
    pub fn std_devs_mm(&self) -> [f64; 3] {
        [0, 4, 8].map(|i| self.covariance_mm2[i].sqrt())
    }
}

#[cfg(test)]
mod tests;
