//! From pixels back into space.

use nalgebra::{Matrix3, Point3, Vector2, Vector3};

use super::{ffi, solver_error};
use crate::error::Result;
use crate::model::{
    MetricPoint, MicroPixel, PlenopticCamera, Ray, SeenPoint, Sighting, VirtualPoint,
};
use crate::solver::Loss;

/// The micro-images that pixels belong to; `None` outside the array.
pub(crate) fn micro_images_at(
    camera: &PlenopticCamera,
    pixels: &[Vector2<f64>],
) -> Result<Vec<Option<(i32, i32)>>> {
    let pixels: Vec<_> = pixels.iter().map(|p| ffi::PairRow { x: p.x, y: p.y }).collect();
    let rows = ffi::micro_images_at(&camera.into(), &pixels).map_err(solver_error)?;
    Ok(rows.iter().map(|at| (at.k >= 0).then_some((at.k, at.l))).collect())
}

/// Rays in space of pixels, from where they are at a distance.
pub(crate) fn object_rays(
    camera: &PlenopticCamera,
    pixels: &[MicroPixel],
    z_mm: f64,
) -> Result<Vec<Option<Ray>>> {
    let to_row = |p: &MicroPixel| ffi::MicroPixelRow { k: p.k, l: p.l, u_px: p.u_px, v_px: p.v_px };
    let pixels: Vec<_> = pixels.iter().map(to_row).collect();
    let rows = ffi::object_rays(&camera.into(), &pixels, z_mm).map_err(solver_error)?;
    Ok(rows.iter().map(ray).collect())
}

/// The same of pixels in the micro-images that they belong to.
pub(crate) fn pixel_rays(
    camera: &PlenopticCamera,
    pixels: &[Vector2<f64>],
    z_mm: f64,
) -> Result<Vec<Option<Ray>>> {
    let pixels: Vec<_> = pixels.iter().map(|p| ffi::PairRow { x: p.x, y: p.y }).collect();
    let rows = ffi::pixel_rays(&camera.into(), &pixels, z_mm).map_err(solver_error)?;
    Ok(rows.iter().map(ray).collect())
}

fn ray(row: &ffi::RayRow) -> Option<Ray> {
    row.defined.then(|| Ray {
        origin_mm: Point3::from(row.origin_mm),
        direction: Vector3::from(row.direction),
    })
}

/// Points that are seen at virtual depths, in the raw image or in a total-focus one.
pub(crate) fn metric_points(
    camera: &PlenopticCamera,
    seen: &[VirtualPoint],
    focused: bool,
) -> Result<Vec<Option<MetricPoint>>> {
    let to_row = |s: &VirtualPoint| ffi::VirtualRow {
        k: s.at.k,
        l: s.at.l,
        u_px: s.at.u_px,
        v_px: s.at.v_px,
        virtual_depth: s.virtual_depth,
        std_dev: s.std_dev,
    };
    let seen: Vec<_> = seen.iter().map(to_row).collect();
    let rows = ffi::metric_points(&camera.into(), &seen, focused).map_err(solver_error)?;
    Ok(rows.iter().map(metric_point).collect())
}

/// Virtual depths of points, each for the micro-lens of a pixel.
pub(crate) fn virtual_depths(
    camera: &PlenopticCamera,
    points: &[(MicroPixel, Point3<f64>)],
) -> Result<Vec<Option<f64>>> {
    let of = |(at, _): &(MicroPixel, Point3<f64>)| ffi::MicroLensIndex { k: at.k, l: at.l };
    let micro_lenses: Vec<_> = points.iter().map(of).collect();
    let points: Vec<_> = points.iter().map(|(_, point)| ffi::PointRow::from(point)).collect();
    let depths = ffi::virtual_depths(&camera.into(), &micro_lenses, &points);
    let depths = depths.map_err(solver_error)?;
    Ok(depths.into_iter().map(|depth| depth.is_finite().then_some(depth)).collect())
}

/// Points that several micro-lenses see.
pub(crate) fn triangulate(
    camera: &PlenopticCamera,
    points: &[SeenPoint],
    loss: Loss,
) -> Result<Vec<Option<MetricPoint>>> {
    let to_row = |s: &Sighting| ffi::SightingRow {
        k: s.at.k,
        l: s.at.l,
        u_px: s.at.u_px,
        v_px: s.at.v_px,
        rho_px: s.rho.map_or(f64::NAN, |[rho_px, _]| rho_px),
        std_dev_px: [
            s.std_dev_px[0],
            s.std_dev_px[1],
            s.rho.map_or(f64::INFINITY, |[_, std_dev_px]| std_dev_px),
        ],
        correlation: s.correlation,
    };
    let seen = |p: &SeenPoint| ffi::SeenRow {
        sightings: p.sightings.len(),
        rho_std_dev_px: p.rho_std_dev_px,
    };
    let seen: Vec<_> = points.iter().map(seen).collect();
    let sightings: Vec<_> = points.iter().flat_map(|p| &p.sightings).map(to_row).collect();
    let rows = ffi::triangulate(&camera.into(), &sightings, &seen, loss.kind.into(), loss.scale)
        .map_err(solver_error)?;
    Ok(rows.iter().map(metric_point).collect())
}

fn metric_point(row: &ffi::MetricRow) -> Option<MetricPoint> {
    row.defined.then(|| MetricPoint {
        point_mm: Point3::from(row.point_mm),
        covariance_mm2: Matrix3::from_row_slice(&row.covariance_mm2),
        chi_square: row.chi_square,
        freedom: usize::try_from(row.freedom).unwrap_or(0),
    })
}
