//! Residual patterns with and without a group of parameters.

use std::collections::BTreeMap;

use nalgebra::Vector2;

use super::super::drawing::{Area, Axis, BLUE, Drawing, INK, ORANGE};
use super::super::tree::Figure;
use super::vectors::means_side_by_side;
use crate::assessment::{ModelComparison, WithoutGroup};
use crate::calibration::Calibration;
use crate::model::{FeatureResidual, PlenopticCamera};

/// Number of rings around the axis.
const RINGS: usize = 12;
/// Fewest corners of a ring whose mean is used.
const MIN_CORNERS: usize = 5;
/// Fewest micro-images for a parallax.
const MIN_MICRO_IMAGES: usize = 3;

/// Draws residual patterns with and without each group, two figures for each, in the order of the comparison.
#[must_use]
pub fn model_figures(calibration: &Calibration, comparison: &ModelComparison) -> Vec<Vec<Figure>> {
    let of_group =
        |without: &WithoutGroup| vec![arrows(calibration, without), rings(calibration, without)];
    comparison.groups.iter().map(of_group).collect()
}

fn name(without: &WithoutGroup, what: &str) -> String {
    format!("without-{}-{what}", without.group.to_string().replace(' ', "-"))
}

fn titles(without: &WithoutGroup) -> [String; 2] {
    [format!("With the {}", without.group), format!("Without the {}", without.group)]
}

fn arrows(calibration: &Calibration, without: &WithoutGroup) -> Figure {
    let residuals = [&calibration.reprojection, &without.reprojection].map(|r| &r.features[..]);
    let [with, gone] = titles(without);
    let (drawing, how) = means_side_by_side(&calibration.camera.sensor, residuals, [&with, &gone]);
    let caption = format!(
        "Observed minus projected (u, v) of features with the {0} and without: {how}. Patterns \
         that appear only on the right are explained by the {0}.",
        without.group
    );
    drawing.figure(&name(without, "residuals"), caption)
}

/// The mean residual and the parallax of the micro-images that show a corner, with its position.
struct Corner {
    /// Distance of the corner from the axis, px.
    radius_px: f64,
    /// Mean residual away from the axis, px.
    outward_px: f64,
    /// Relative excess of the distances between its images; `None` with too few micro-images.
    parallax: Option<f64>,
}

fn corners(camera: &PlenopticCamera, residuals: &[FeatureResidual]) -> Vec<Corner> {
    let mut by_corner: BTreeMap<(u32, i32), Vec<&FeatureResidual>> = BTreeMap::new();
    for r in residuals {
        by_corner.entry((r.feature.frame, r.feature.corner)).or_default().push(r);
    }
    let axis = camera.axis_px();
    let at = |r: &FeatureResidual| Vector2::new(r.feature.u_px, r.feature.v_px);
    let off = |r: &FeatureResidual| Vector2::new(r.du_px, r.dv_px);
    let corner = |seen: Vec<&FeatureResidual>| {
        let count = seen.len() as f64;
        let middle = seen.iter().map(|r| at(r)).sum::<Vector2<f64>>() / count;
        let mean = seen.iter().map(|r| off(r)).sum::<Vector2<f64>>() / count;
        let from_axis = middle - axis;
        let square: f64 = seen.iter().map(|r| (at(r) - middle).norm_squared()).sum();
        let product: f64 = seen.iter().map(|r| (at(r) - middle).dot(&off(r))).sum();
        Corner {
            radius_px: from_axis.norm(),
            outward_px: mean.dot(&from_axis) / from_axis.norm().max(f64::MIN_POSITIVE),
            parallax: (seen.len() >= MIN_MICRO_IMAGES && square > 0.0).then(|| product / square),
        }
    };
    by_corner.into_values().map(corner).collect()
}

/// Mean and standard error in a ring, at the middle of the ring.
struct Ring {
    radius_px: f64,
    mean: f64,
    std_error: f64,
}

fn ring_means(
    corners: &[Corner],
    farthest_px: f64,
    of: impl Fn(&Corner) -> Option<f64>,
) -> Vec<Ring> {
    let width = farthest_px / RINGS as f64;
    let ring = |i: usize| {
        let inner = i as f64 * width;
        let values: Vec<f64> = corners
            .iter()
            .filter(|c| (inner..inner + width).contains(&c.radius_px))
            .filter_map(&of)
            .collect();
        let count = values.len() as f64;
        let mean = values.iter().sum::<f64>() / count;
        let square: f64 = values.iter().map(|v| (v - mean).powi(2)).sum();
        let std_error = (square / (count - 1.0) / count).sqrt();
        (values.len() >= MIN_CORNERS).then_some(Ring {
            radius_px: inner + width / 2.0,
            mean,
            std_error,
        })
    };
    (0..RINGS).filter_map(ring).collect()
}

fn rings(calibration: &Calibration, without: &WithoutGroup) -> Figure {
    let both = [
        corners(&calibration.camera, &calibration.reprojection.features),
        corners(&without.camera, &without.reprojection.features),
    ];
    let farthest = both.iter().flatten().map(|c| c.radius_px).fold(1.0, f64::max) * 1.001;
    let outward = both.each_ref().map(|of| ring_means(of, farthest, |c| Some(c.outward_px)));
    let parallax =
        both.each_ref().map(|of| ring_means(of, farthest, |c| c.parallax.map(|p| 1e3 * p)));
    let mut drawing = Drawing::new(900.0, 340.0);
    let [left, right] = Area::new(0.0, 0.0, 900.0, 340.0).split_at(450.0);
    panel(&left.within_axes(), &outward, farthest, "away from the axis, px", &mut drawing);
    panel(&right.within_axes(), &parallax, farthest, "parallax too large, ‰", &mut drawing);
    let [with, gone] = titles(without);
    let names = [(&*with, BLUE), (&*gone, ORANGE)];
    drawing.legend(Vector2::new(76.0, 18.0), 250.0, &names);
    let caption = format!(
        "The same residuals against the distance from the axis, as means over the corners in rings \
         with their standard errors: radial displacement of corners from their projections, and \
         excess parallax of a corner between micro-images, which is an error of depth. Both should \
         be 0 with the {0}. Deviations without it are explained by the {0} and not by the poses of \
         the boards.",
        without.group
    );
    drawing.figure(&name(without, "over-radius"), caption)
}

fn panel(chart: &Area, series: &[Vec<Ring>; 2], farthest: f64, what: &str, drawing: &mut Drawing) {
    let ends = series.iter().flatten().flat_map(|r| [r.mean - r.std_error, r.mean + r.std_error]);
    let largest = ends.filter(|v| v.is_finite()).map(f64::abs).fold(1e-9, f64::max) * 1.1;
    let x = Axis::new("distance from the axis, px", [0.0, farthest]);
    let plane = drawing.axes(chart, &x, &Axis::new(what, [-largest, largest]).with_grid());
    drawing.line(&[plane.place(0.0, 0.0), plane.place(farthest, 0.0)], INK, 0.6);
    for (rings, color) in series.iter().zip([BLUE, ORANGE]) {
        let places: Vec<Vector2<f64>> =
            rings.iter().map(|r| plane.place(r.radius_px, r.mean)).collect();
        drawing.line(&places, color, 1.6);
        drawing.discs(&places, 3.0, color);
        for r in rings {
            let end = |sign: f64| plane.place(r.radius_px, r.mean + sign * r.std_error);
            drawing.line(&[end(-1.0), end(1.0)], color, 1.0);
        }
    }
}
