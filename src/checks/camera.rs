//! Checks of a camera in use: it must be the camera of the white images and boards.

use super::calibration::severity_above;
use crate::finding::{Finding, Issue, Severity};
use crate::quantity::Estimate;

/// Largest RMS difference of micro-image centres, px. An array that has moved by half a pixel moves u₀ and v₀ by as much.
/// Cameras of the presets are within 0.02 px RMS of their white images, R12-A within 0.3 px.
const CENTERS_PX: f64 = 0.5;
/// RMS difference, as a part of the pitch, above which it is another array or another sensor.
const CENTERS_WRONG: f64 = 0.1;
/// Largest difference of blur radii of white images and camera, as a part of the largest radius. Two sets of white images of
/// one simulated camera agree to 0.1 %; f-numbers of real lenses have a tolerance of 2 %.
const BLUR: f64 = 0.05;
const BLUR_WRONG: f64 = 0.2;
/// Largest remaining difference, relative to the stated order, for which a permutation explains white images.
const PERMUTED: f64 = 0.3;
/// Relative tolerance of engraved f-numbers; half a stop is 19 %.
const F_NUMBER: f64 = 0.1;
/// Largest RMS difference of the blur radii of boards, in σ; cameras that are right have 1.4 (docs/use.md).
const BLUR_STD_DEVS: f64 = 3.0;
const BLUR_STD_DEVS_WRONG: f64 = 8.0;
/// Largest deviation of the scale of the squares from 1. Calibrated cameras, through real lenses too, are within 0.04 %
/// (docs/use.md); the error of distances equals the error of the squares.
const SCALE: f64 = 0.003;
const SCALE_WRONG: f64 = 0.01;
/// Smallest deviation of a scale from 1 that counts, in σ.
const SURE: f64 = 5.0;

/// Compares the micro-image centres of a camera with those of white images: root mean square and mean difference, px.
pub(crate) fn centers(rms_px: f64, shift_px: [f64; 2], pitch_px: f64) -> Option<Finding> {
    (rms_px > CENTERS_PX).then(|| {
        let issue = Issue::CentersContradicted { rms_px, shift_px, pitch_px };
        let severity = severity_above(rms_px, CENTERS_WRONG * pitch_px);
        Finding::new(severity, issue).weighing(50.0)
    })
}

/// Compares the blur radii of the lens types, px, in white images and in a camera.
pub(crate) fn lens_types(white_images_px: &[f64], camera_px: &[f64]) -> Option<Finding> {
    let off = |order: &[usize]| {
        let pairs = white_images_px.iter().zip(order);
        pairs.map(|(white, i)| (white - camera_px[*i]).abs()).fold(0.0, f64::max)
    };
    let stated: Vec<usize> = (0..camera_px.len()).collect();
    let largest = white_images_px.iter().fold(0.0, |max: f64, q| max.max(q.abs()));
    let part = off(&stated) / largest;
    if white_images_px.len() != camera_px.len() || part.is_nan() || part <= BLUR {
        return None;
    }
    let orders = permutations(camera_px.len());
    let best = orders.iter().min_by(|a, b| off(a).total_cmp(&off(b)))?;
    let permuted = (off(best) < PERMUTED * off(&stated))
        .then(|| best.iter().map(|i| i + 1).collect::<Vec<usize>>());
    let severity = match permuted {
        Some(_) => Severity::Unusable,
        None => severity_above(part, BLUR_WRONG),
    };
    let (white_images_px, camera_px) = (white_images_px.to_vec(), camera_px.to_vec());
    let issue = Issue::LensTypesContradicted { white_images_px, camera_px, permuted };
    Some(Finding::new(severity, issue).weighing(40.0 * part / BLUR))
}

/// Returns all orders of a few numbers.
fn permutations(count: usize) -> Vec<Vec<usize>> {
    (0..count).fold(vec![Vec::new()], |orders, next| {
        let with = |order: &Vec<usize>| {
            let order = order.clone();
            (0..=order.len()).map(move |at| {
                let mut longer = order.clone();
                longer.insert(at, next);
                longer
            })
        };
        orders.iter().flat_map(with).collect()
    })
}

/// Compares the f-number that a camera was calibrated at with the f-number of the boards.
pub(crate) fn f_number(camera: f64, boards: f64) -> Option<Finding> {
    ((boards / camera - 1.0).abs() > F_NUMBER)
        .then(|| Finding::caution(Issue::OtherFNumber { camera, boards }))
}

/// Compares blur radii of boards with a fixed camera: root mean square of the differences over their σ.
pub(crate) fn blur(rms_std_devs: f64) -> Option<Finding> {
    (rms_std_devs > BLUR_STD_DEVS).then(|| {
        let severity = severity_above(rms_std_devs, BLUR_STD_DEVS_WRONG);
        Finding::new(severity, Issue::BlurContradicted { rms_std_devs })
            .weighing(5.0 * rms_std_devs / BLUR_STD_DEVS)
    })
}

/// Checks the scale of the squares with which boards fit a fixed camera best.
pub(crate) fn squares(scale: &Estimate, square_mm: f64) -> Option<Finding> {
    let off = (scale.value - 1.0).abs();
    (off > SCALE && off > SURE * scale.std_dev).then(|| {
        let issue = Issue::SquaresContradicted { fitted_mm: scale.scaled(square_mm), square_mm };
        let severity = severity_above(off, SCALE_WRONG);
        Finding::new(severity, issue).weighing(20.0 * off / SCALE)
    })
}

/// Range beyond the boards of a calibration in which its camera is trusted, as a part of their distance.
const BEYOND: f64 = 0.2;

/// Comparison of the distances of points or rays with the nearest and furthest board of a calibration.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct DistanceCheck {
    near_mm: f64,
    far_mm: f64,
    all: usize,
    beyond: usize,
}

impl DistanceCheck {
    /// Creates the check from the distances of the nearest and the furthest board, mm.
    #[must_use]
    pub fn new([near_mm, far_mm]: [f64; 2]) -> Self {
        Self { near_mm, far_mm, all: 0, beyond: 0 }
    }

    /// Counts a distance, mm.
    pub fn count(&mut self, distance_mm: f64) {
        let trusted = self.near_mm * (1.0 - BEYOND)..=self.far_mm * (1.0 + BEYOND);
        self.all += 1;
        self.beyond += usize::from(!trusted.contains(&distance_mm));
    }

    /// Returns the finding if some of the distances lie far from the boards.
    #[must_use]
    pub fn finding(&self) -> Option<Finding> {
        let Self { near_mm, far_mm, all, beyond } = *self;
        (beyond > 0).then(|| Finding::caution(Issue::BeyondBoards { beyond, all, near_mm, far_mm }))
    }
}

/// Largest scatter of the features of corners about their points, over their σ; simulated boards have 1.1 to 1.2.
const CORNERS: f64 = 2.0;
const CORNERS_WRONG: f64 = 5.0;

/// Checks the scatter of the features of corners about their points, over their σ.
pub(crate) fn corners(ratio: f64) -> Option<Finding> {
    (ratio > CORNERS).then(|| {
        let severity = severity_above(ratio, CORNERS_WRONG);
        Finding::new(severity, Issue::CornersScatter { ratio }).weighing(5.0 * ratio / CORNERS)
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_permutation_of_lens_types_is_named() {
        let white = [-3.0, -1.5, -2.2];
        assert_eq!(lens_types(&white, &[-3.02, -1.48, -2.19]), None);
        let found = lens_types(&white, &[-2.2, -1.5, -3.0]).unwrap();
        assert_eq!(found.severity, Severity::Unusable);
        let Issue::LensTypesContradicted { permuted, .. } = &found.issue else { panic!() };
        assert_eq!(permuted.as_deref(), Some([3, 2, 1].as_slice()));
        let other = lens_types(&white, &[-3.3, -1.6, -2.4]).unwrap();
        assert_eq!(other.severity, Severity::Caution);
        assert_eq!(lens_types(&white, &[-6.0, -3.0, -4.0]).unwrap().severity, Severity::Unusable);
        assert_eq!(permutations(3).len(), 6);
    }

    #[test]
    fn squares_have_to_be_off_by_much_and_surely() {
        assert_eq!(squares(&Estimate::new(1.002, 1e-5), 10.0), None);
        assert_eq!(squares(&Estimate::new(1.02, 0.01), 10.0), None);
        let severity = |scale| squares(&Estimate::new(scale, 1e-4), 10.0).unwrap().severity;
        assert_eq!([severity(1.005), severity(0.98)], [Severity::Caution, Severity::Unusable]);
    }
}
