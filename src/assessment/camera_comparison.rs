//! Comparison of two calibrations of one camera: by their parameters, and by their projections.
//!
//! Parameters trade off against each other, and the calibration defines the camera frame. Two cameras with the same projections
//! may therefore have different parameters, and frames that differ by a rigid motion. So the motion that makes them agree best
//! is fitted first, over points all over the image at several distances. The remaining shifts are the difference.

use nalgebra::{Isometry3, Point3, Vector2, Vector3};

use crate::error::{Error, Result};
use crate::finding::{Finding, Issue};
use crate::model::{BentBoard, Board, BoardShape, Parameter, PlenopticCamera};
use crate::quantity::counted;
use crate::solver::{
    self, CostOptions, Loss, LossKind, MicroPixel, Problem, Projected, Ray, SolverFeature,
    SolverOptions, VirtualPoint, metric_points, micro_images_at, pixel_rays, virtual_depths,
};

/// Numbers of pixels at which cameras are compared, along u and v.
const GRID: [u32; 2] = [32, 24];
/// Fewest points to which a motion is fitted.
const FEWEST: usize = 12;
/// Largest number of distances, each with [`GRID`] points in memory.
const MOST_DISTANCES: usize = 100;

/// A parameter of both cameras.
#[derive(Debug, Clone, PartialEq)]
pub struct ParameterPair {
    /// Name of the parameter.
    pub name: &'static str,
    /// Unit of the parameter.
    pub unit: &'static str,
    /// Values in the first and the second camera.
    pub values: [f64; 2],
    /// Standard deviations in both cameras; `None` if not known.
    pub std_devs: [Option<f64>; 2],
}

impl ParameterPair {
    /// Returns the difference, second minus first, over its σ; `None` if no σ is known.
    #[must_use]
    pub fn difference_in_std_devs(&self) -> Option<f64> {
        let std_dev = self.std_devs.iter().flatten().fold(0.0, |sum: f64, s| sum.hypot(*s));
        (std_dev > 0.0).then(|| (self.values[1] - self.values[0]) / std_dev)
    }
}

/// The difference of two cameras at one distance, after the motion.
#[derive(Debug, Clone, PartialEq)]
pub struct DistanceDifference {
    /// Distance in the frame of the first camera, mm.
    pub at_mm: f64,
    /// Pixels of the first camera, and their shifts, px: projections of its points by the second camera minus those by the
    /// first.
    pub shifts_px: Vec<(Vector2<f64>, Vector2<f64>)>,
    /// Root mean square of the shifts, px.
    pub rms_px: f64,
    /// Largest shift, px.
    pub largest_px: f64,
    /// Root mean square distance between the points that both cameras see in one pixel at one virtual depth, across the axis
    /// and along it, mm; `None` if the second camera sees none.
    pub rms_mm: Option<[f64; 2]>,
    /// Mean distance by which the second camera sees these points further away, mm.
    pub further_mm: Option<f64>,
    /// Root mean square difference of the blur radii of points, px; `None` for arrays of pinholes.
    pub blur_rms_px: Option<f64>,
}

/// Two cameras compared.
#[derive(Debug, Clone, PartialEq)]
pub struct CameraComparison {
    /// All parameters. The second camera counts the array like the first.
    pub parameters: Vec<ParameterPair>,
    /// Root mean square of the shifts without the motion, px.
    pub raw_rms_px: f64,
    /// Motion from the frame of the first camera to the frame of the second.
    pub second_from_first: Isometry3<f64>,
    /// Differences after the motion, by distance.
    pub distances: Vec<DistanceDifference>,
    /// Other differences.
    pub findings: Vec<Finding>,
}

impl CameraComparison {
    /// Returns the root mean square of all shifts after the motion, px.
    #[must_use]
    pub fn rms_px(&self) -> f64 {
        let shifts = || self.distances.iter().flat_map(|d| &d.shifts_px).map(|(_, shift)| shift);
        root_mean_square(shifts().map(Vector2::norm))
    }

    /// Returns the largest root mean square difference of blur radii at a distance, px; `None` for arrays of pinholes.
    #[must_use]
    pub fn blur_rms_px(&self) -> Option<f64> {
        self.distances.iter().filter_map(|d| d.blur_rms_px).reduce(f64::max)
    }
}

/// A camera with the σ of its parameters, where known, in the order of [`PlenopticCamera::intrinsics`].
pub type WithStdDevs<'a> = (&'a PlenopticCamera, &'a [Option<f64>]);

fn root_mean_square(values: impl Iterator<Item = f64>) -> f64 {
    let (mut sum, mut count) = (0.0, 0.0);
    for value in values {
        sum += value * value;
        count += 1.0;
    }
    (sum / f64::max(count, 1.0)).sqrt()
}

/// Returns points of the first camera at a distance, with the pixels that show them.
fn seen(camera: &PlenopticCamera, at_mm: f64) -> Result<Vec<(MicroPixel, Point3<f64>)>> {
    let along = |size: u32, parts: u32| {
        (0..parts).map(move |i| (f64::from(i) + 0.5) * f64::from(size) / f64::from(parts) - 0.5)
    };
    let sensor = &camera.sensor;
    let pixels: Vec<Vector2<f64>> = along(sensor.height_px, GRID[1])
        .flat_map(|v| along(sensor.width_px, GRID[0]).map(move |u| Vector2::new(u, v)))
        .collect();
    let micro_images = micro_images_at(camera, &pixels)?;
    let rays = pixel_rays(camera, &pixels, at_mm)?;
    let point = |((pixel, at), ray): ((&Vector2<f64>, _), Option<Ray>)| {
        let (k, l): (i32, i32) = at?;
        Some((MicroPixel { k, l, u_px: pixel.x, v_px: pixel.y }, ray?.origin_mm.into()))
    };
    Ok(pixels.iter().zip(micro_images).zip(rays).filter_map(point).collect())
}

/// Compares two cameras at these distances, mm from the main lens of the first.
///
/// Fails if their arrays have different lattices, if they have different lens types or sensors, or if they do not see the same
/// points.
pub fn compare_cameras(
    (first, first_std_devs): WithStdDevs,
    (second, second_std_devs): WithStdDevs,
    distances_mm: &[f64],
) -> Result<CameraComparison> {
    if first.sensor != second.sensor {
        return Err(Error::invalid(format!(
            "the first camera has a sensor of {}, but the second has one of {}",
            first.sensor, second.sensor
        )));
    }
    if distances_mm.len() > MOST_DISTANCES {
        return Err(Error::invalid(format!(
            "cameras are compared at up to {MOST_DISTANCES} distances, but {} were given",
            distances_mm.len()
        )));
    }
    let types = first.lens_types();
    let counted_otherwise = (first.lattice != second.lattice).then(|| {
        let [first, second] = [first, second].map(|camera| camera.lattice.to_string());
        Finding::caution(Issue::CountedOtherwise { first, second })
    });
    let alike = second.with_array_of(first).filter(|second| second.lens_types() == types);
    let second = alike.ok_or_else(|| {
        Error::invalid(format!(
            "the first camera has {} and {}, but the second has {} and {}: they belong to different \
             cameras",
            first.lattice,
            counted(types, "lens type"),
            second.lattice,
            second.lens_types()
        ))
    })?;
    let mut points = Vec::new();
    for &at_mm in distances_mm {
        points.push(seen(first, at_mm)?);
    }
    let all: Vec<(MicroPixel, Point3<f64>)> = points.iter().flatten().copied().collect();
    if all.len() < FEWEST {
        return Err(Error::invalid("the first camera images too few points at these distances"));
    }
    let raw = shifts(&second, &Isometry3::identity(), &all)?;
    let motion = motion(&second, &all)?;
    let differences = distances_mm
        .iter()
        .zip(&points)
        .map(|(&at_mm, points)| difference(first, &second, &motion, at_mm, points));
    let parameters = Parameter::intrinsic(types).iter().enumerate().map(|(i, p)| ParameterPair {
        name: p.name(),
        unit: p.unit(),
        values: [first.value(*p), second.value(*p)],
        std_devs: [first_std_devs, second_std_devs].map(|of| of.get(i).copied().flatten()),
    });
    Ok(CameraComparison {
        parameters: parameters.collect(),
        raw_rms_px: root_mean_square(raw.iter().map(|(_, shift)| shift.norm())),
        second_from_first: motion,
        distances: differences.collect::<Result<_>>()?,
        findings: counted_otherwise.into_iter().collect(),
    })
}

fn difference(
    first: &PlenopticCamera,
    second: &PlenopticCamera,
    motion: &Isometry3<f64>,
    at_mm: f64,
    points: &[(MicroPixel, Point3<f64>)],
) -> Result<DistanceDifference> {
    let shifts_px = shifts(second, motion, points)?;
    let lengths = || shifts_px.iter().map(|(_, shift)| shift.norm());
    let depths = virtual_depths(first, points)?;
    let (mut there, mut virtual_points) = (Vec::new(), Vec::new());
    for ((at, point), depth) in points.iter().zip(depths) {
        if let Some(virtual_depth) = depth {
            there.push(motion * point);
            virtual_points.push(VirtualPoint { at: *at, virtual_depth, std_dev: [0.0; 3] });
        }
    }
    let found = metric_points(second, &virtual_points)?;
    let off: Vec<Vector3<f64>> = there
        .iter()
        .zip(found)
        .filter_map(|(there, found)| Some(Point3::from(found?.point_mm) - there))
        .collect();
    let some = !off.is_empty();
    let blur = [(first, Isometry3::identity()), (second, *motion)]
        .map(|(camera, motion)| with_problem(camera, &motion, points, solver::project));
    let [first_blur, second_blur] = blur;
    let blur: Vec<f64> = first_blur?
        .iter()
        .zip(second_blur?)
        .filter_map(|(first, second)| Some(second?.rho()? - (*first)?.rho()?))
        .collect();
    Ok(DistanceDifference {
        blur_rms_px: (!blur.is_empty()).then(|| root_mean_square(blur.iter().copied())),
        at_mm,
        rms_px: root_mean_square(lengths()),
        largest_px: lengths().fold(0.0, f64::max),
        rms_mm: some.then(|| {
            let across = root_mean_square(off.iter().map(|off| off.xy().norm()));
            [across, root_mean_square(off.iter().map(|off| off.z))]
        }),
        further_mm: some.then(|| off.iter().map(|off| off.z).sum::<f64>() / off.len() as f64),
        shifts_px,
    })
}

/// Calls `f` with a problem whose features are these points, seen by the second camera after a motion.
fn with_problem<R>(
    second: &PlenopticCamera,
    motion: &Isometry3<f64>,
    points: &[(MicroPixel, Point3<f64>)],
    f: impl FnOnce(&Problem) -> R,
) -> R {
    let feature = |(at, point): &(MicroPixel, Point3<f64>)| SolverFeature {
        pose: 0,
        board_point_mm: point.coords.into(),
        k: at.k,
        l: at.l,
        u_px: at.u_px,
        v_px: at.v_px,
        rho_px: f64::NAN,
        std_dev_px: [1.0; 3],
    };
    let features: Vec<SolverFeature> = points.iter().map(feature).collect();
    // The board has no shape, so that the points stay in place.
    let board = Board { columns: 2, rows: 2, square_mm: 1.0 };
    let board = BentBoard { board, shape: BoardShape::default() };
    f(&Problem { camera: second, board, poses: &[*motion], features: &features, centers: &[] })
}

/// Returns the pixels of the points, and their shifts in the second camera.
fn shifts(
    second: &PlenopticCamera,
    motion: &Isometry3<f64>,
    points: &[(MicroPixel, Point3<f64>)],
) -> Result<Vec<(Vector2<f64>, Vector2<f64>)>> {
    let projected = with_problem(second, motion, points, solver::project)?;
    let shift = |((at, _), found): (&(MicroPixel, Point3<f64>), Option<Projected>)| {
        let found = found?;
        let pixel = Vector2::new(at.u_px, at.v_px);
        Some((pixel, Vector2::new(found.u_px, found.v_px) - pixel))
    };
    Ok(points.iter().zip(projected).filter_map(shift).collect())
}

/// Fits the motion from the first frame to the second with the smallest shifts.
fn motion(
    second: &PlenopticCamera,
    points: &[(MicroPixel, Point3<f64>)],
) -> Result<Isometry3<f64>> {
    let all = Parameter::shared(second.lens_types());
    let cost = CostOptions {
        rho: false,
        loss: Loss { kind: LossKind::None, scale: 1.0 },
        fixed: all.iter().map(|parameter| parameter.name().to_owned()).collect(),
        ..CostOptions::default()
    };
    let refined = with_problem(second, &Isometry3::identity(), points, |problem| {
        solver::refine(problem, &cost, &SolverOptions::default(), &mut |_| true)
    });
    let refinement = refined.map_err(|e| {
        Error::invalid(format!(
            "the second camera does not image the points that the first camera images at these \
             distances: {e}"
        ))
    })?;
    Ok(refinement.poses[0])
}
