//! Checks of a calibrated camera in use: white images, virtual depths and features must belong to the same camera in the same
//! state.

use nalgebra::Vector2;

use crate::checks::{calibration as fit_checks, camera as checks};
use crate::error::{Error, Result};
use crate::finding::{Finding, Issue};
use crate::model::{
    BapFeature, Configuration, Datasheet, InternalParameters, PlenopticCamera, optics,
};
use crate::precalibration::MicroImageArray;
use crate::solver::{self, Corners, MicroPixel, VirtualPoint};

/// Checks a calibrated camera against a pre-calibration, `grid` and `internal`, and against the datasheet of the camera of the
/// images: centres, blur radii of the lens types, m, and the f-number.
///
/// Fails if sensor, lattice or number of lens types differ: indices and pixels then belong to different cameras.
pub fn check_camera(
    camera: &PlenopticCamera,
    sheet: &Datasheet,
    grid: &MicroImageArray,
    internal: &InternalParameters,
) -> Result<Vec<Finding>> {
    refuse_other(camera, sheet, grid, internal)?;
    let (rms_px, shift_px) = centers_against(camera, grid)?;
    let own = optics::internal_parameters(camera);
    let [white_images_px, camera_px] =
        [internal, &own].map(|of| blur_radii_px(of, grid.pitch_px, sheet.sensor.pixel_size_mm));
    let f_numbers = camera.main_lens.setting.map(|setting| [setting.f_number, sheet.f_number]);
    let slope = 1.0 - own.m_mm.abs() / internal.m_mm.abs();
    Ok(checks::centers(rms_px, shift_px.into(), grid.pitch_px)
        .into_iter()
        .chain(checks::lens_types(&white_images_px, &camera_px))
        .chain(fit_checks::slope(slope, 0.0))
        .chain(f_numbers.and_then(|[camera, boards]| checks::f_number(camera, boards)))
        .collect())
}

fn refuse_other(
    camera: &PlenopticCamera,
    sheet: &Datasheet,
    grid: &MicroImageArray,
    internal: &InternalParameters,
) -> Result<()> {
    let others = |what: &str, camera: String, images: String| {
        Err(Error::invalid(format!(
            "the camera has {what} {camera}, but the project and its white images have {images}: \
             they belong to different cameras"
        )))
    };
    if camera.sensor != sheet.sensor {
        return others("a sensor of", camera.sensor.to_string(), sheet.sensor.to_string());
    }
    if camera.lattice != grid.lattice {
        return others("an array of", camera.lattice.to_string(), grid.lattice.to_string());
    }
    let (types, shown) = (camera.lens_types(), internal.q_prime_mm.len());
    if types > 0 && types != shown {
        return others("a number of lens types of", types.to_string(), shown.to_string());
    }
    Ok(())
}

/// Returns the differences of the micro-image centres of a camera from a grid: root mean square and mean, px.
fn centers_against(
    camera: &PlenopticCamera,
    grid: &MicroImageArray,
) -> Result<(f64, Vector2<f64>)> {
    let lattice = &grid.lattice;
    let nodes: Vec<(i32, i32)> =
        (0..lattice.rows).flat_map(|l| (0..lattice.columns).map(move |k| (k, l))).collect();
    let projected = solver::project_centers(camera, nodes.iter().copied())?;
    let off: Vec<Vector2<f64>> = nodes
        .iter()
        .zip(projected)
        .map(|(&(k, l), center)| Vector2::from(center) - grid.center_of(k, l))
        .collect();
    let count = off.len() as f64;
    let mean_square = off.iter().map(Vector2::norm_squared).sum::<f64>() / count;
    Ok((mean_square.sqrt(), off.iter().sum::<Vector2<f64>>() / count))
}

/// Returns the blur radius φqᵢ = φ(q'ᵢ − Δc/2) of each lens type, px, which white images show (Eq. (radiusfinal)).
fn blur_radii_px(internal: &InternalParameters, pitch_px: f64, pixel_size_mm: f64) -> Vec<f64> {
    let blur = |q: &f64| internal.aperture_ratio() * (q / pixel_size_mm - pitch_px / 2.0);
    internal.q_prime_mm.iter().map(blur).collect()
}

/// Checks the points of corners against each other; `None` if no feature states its σ.
#[must_use]
pub fn check_corners(corners: &Corners, features: &[BapFeature]) -> Option<Finding> {
    let stated = features.iter().any(|feature| feature.std_dev_px.is_some());
    stated.then(|| corners.scatter.sqrt()).and_then(checks::corners)
}

/// Checks virtual points of the raw image: their micro-lenses must belong to the array, their pixels to the micro-images, and
/// their depths to the side of the array where the camera has its images. Points count from 1.
///
/// Fails if the camera is not valid.
pub fn check_virtual_points(
    camera: &PlenopticCamera,
    points: &[VirtualPoint],
) -> Result<Vec<Finding>> {
    let mut found = check_places(camera, points.iter().map(|point| point.at))?;
    let galilean = match camera.configuration() {
        Some(Configuration::Galilean) => Some(true),
        Some(Configuration::Keplerian) => Some(false),
        Some(Configuration::Unfocused) | None => None,
    };
    let of_other_sign = |galilean: bool| -> Vec<usize> {
        let is_other = |depth: f64| if galilean { depth <= 0.0 } else { depth >= 0.0 };
        let all = (1..).zip(points).filter(|(_, point)| is_other(point.virtual_depth));
        all.map(|(number, _)| number).collect()
    };
    found.extend(galilean.and_then(|galilean| {
        counted(&of_other_sign(galilean), |points, first| Issue::DepthsOfOtherSign {
            points,
            first,
            galilean,
        })
    }));
    Ok(found)
}

/// Checks that micro-lenses belong to the array of a camera, and pixels to their micro-images. Pixels count from 1.
///
/// Fails if the camera is not valid.
pub fn check_places(
    camera: &PlenopticCamera,
    pixels: impl IntoIterator<Item = MicroPixel>,
) -> Result<Vec<Finding>> {
    let (lattice, pitch_px) = (&camera.lattice, camera.micro_image_pitch_px());
    let is_inside =
        |at: &MicroPixel| (0..lattice.columns).contains(&at.k) && (0..lattice.rows).contains(&at.l);
    let numbered: Vec<(usize, MicroPixel)> = (1..).zip(pixels).collect();
    let (inside, outside): (Vec<&_>, Vec<&_>) = numbered.iter().partition(|(_, at)| is_inside(at));
    let centers = solver::project_centers(camera, inside.iter().map(|(_, at)| (at.k, at.l)))?;
    let far: Vec<usize> = inside
        .iter()
        .zip(centers)
        .filter(|((_, at), [u, v])| (at.u_px - u).hypot(at.v_px - v) > pitch_px)
        .map(|((number, _), _)| *number)
        .collect();
    let outside: Vec<usize> = outside.into_iter().map(|(number, _)| *number).collect();
    let found = [
        counted(&outside, |points, first| Issue::OutsideArray { points, first }),
        counted(&far, |points, first| Issue::FarFromMicroImage { points, first, pitch_px }),
    ];
    Ok(found.into_iter().flatten().collect())
}

/// Creates a finding about some of the points, by their numbers; `None` if there are none.
fn counted(numbers: &[usize], issue: impl Fn(usize, usize) -> Issue) -> Option<Finding> {
    numbers.first().map(|first| Finding::caution(issue(numbers.len(), *first)))
}
