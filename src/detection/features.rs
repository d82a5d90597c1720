//! The features of a frame: what detection hands on.

use nalgebra::{Matrix3, Vector2, Vector3};

use super::edge_width::{EdgeWidth, WidthChange};
use super::frame::Frame;
use super::line::median_inverse_virtual_depth;
use super::second_pass::{Found, SecondPassed};
use super::{Aberration, CornerLine, CornerObservation, DepthEstimator};
use crate::model::{BapFeature, MeasuredBlur};
use crate::quantity::Estimate;

/// A corner of the board as a whole.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct DetectedCorner {
    /// Board corner, `row · columns + column`.
    pub corner: i32,
    /// The line of its observations.
    pub line: CornerLine,
    /// 1/ν as the paper has it, by the median over pairs with λ = 1.
    pub median_inverse_virtual_depth: f64,
    /// Number of its features.
    pub features: usize,
}

/// The features of a frame.
#[derive(Debug, Clone, PartialEq)]
pub struct Detection {
    /// Features, corner by corner.
    pub features: Vec<BapFeature>,
    /// The corners of the board.
    pub corners: Vec<DetectedCorner>,
    /// From (column, row, 1) of a corner to its pinhole image, px.
    pub homography: Matrix3<f64>,
    /// What was taken out of the places: they are where a main lens without it would show the corners.
    pub aberration: Aberration,
    /// How sharp its edges are, where they show it.
    pub edges: Option<Edges>,
    /// By how much the measured blur of each feature grows with the variance of edges, px⁻¹.
    blur_by_width: Vec<f64>,
    /// That of the frame, for a search with other micro-images.
    pub(super) contrast: f64,
}

/// What the widths of edges in a frame say.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Edges {
    /// The aperture ratio of the micro-lenses by this frame alone.
    pub aperture_ratio: Estimate,
    /// Variance along an axis by which edges are wider than the blur of a whole pixel makes them, px²: the point spread, with
    /// what print and motion add.
    pub spread_px2: Estimate,
    /// What its corners say of ln φ and of by how much edges are wider than those of white images.
    pub(super) corners: EdgeWidth,
    /// That, px².
    wider_px2: f64,
}

impl Detection {
    /// Measures blur with edges that are as wide as those of other frames, by this variance with its σ, px², over white
    /// images.
    pub(super) fn take_width(&mut self, wider_px2: Estimate) {
        let Some(edges) = &self.edges else { return };
        for (feature, by) in self.features.iter_mut().zip(&self.blur_by_width) {
            if let Some(blur) = &mut feature.blur {
                blur.radius_px += by * (wider_px2.value - edges.wider_px2);
                blur.shared_px = by * wider_px2.std_dev;
            }
        }
    }

    /// Pinhole image of a place on the board in columns and rows, px.
    #[must_use]
    pub fn pinhole(&self, column: f64, row: f64) -> Vector2<f64> {
        let p = self.homography * Vector3::new(column, row, 1.0);
        p.xy() / p.z
    }
}

/// The features of the corners that were found.
pub(super) fn detection(
    frame: &Frame,
    passed: &SecondPassed,
    homography: Matrix3<f64>,
) -> Detection {
    let micro_images = frame.search.micro_images;
    let change = passed.width.map(|width| width.change);
    let half_pitch = micro_images.grid.pitch_px / 2.0;
    let (mut features, mut corners) = (Vec::new(), Vec::new());
    let mut blur_by_width = Vec::new();
    for found in &passed.corners {
        let observations: Vec<CornerObservation> =
            found.observations.iter().map(|found| found.observation).collect();
        // There are at least two.
        let median = median_inverse_virtual_depth(&observations).unwrap_or(f64::NAN);
        corners.push(DetectedCorner {
            corner: found.corner,
            line: found.line,
            median_inverse_virtual_depth: median,
            features: observations.len(),
        });
        for Found { observation, corner, by_taken, width } in &found.observations {
            let optics = micro_images.optics(observation.k, observation.l);
            let rho_px = match frame.search.estimator {
                DepthEstimator::Median => optics.rho_of_depth_px(median),
                DepthEstimator::Line => optics.rho_px(found.line.slope),
            };
            let per = optics.blur_by_ratio_px(found.line.slope);
            let blur = change.zip(*width).and_then(|(change, width)| {
                let (by, variance) = width.of_ratio(&Vector2::new(0.0, change.y))?;
                Some(MeasuredBlur {
                    radius_px: optics.blur_radius_px(found.line.slope) + by * per,
                    std_dev_px: variance.sqrt() * per.abs(),
                    shared_px: 0.0,
                    aperture_ratio: optics.aperture_ratio,
                })
            });
            let std_devs = [0, 1].map(|i| corner.covariance[(i, i)].sqrt());
            blur_by_width.push(width.map_or(0.0, |width| width.ratio_by_width() * per));
            features.push(BapFeature {
                frame: frame.frame,
                corner: found.corner,
                k: observation.k,
                l: observation.l,
                u_px: observation.position.x,
                v_px: observation.position.y,
                rho_px: Some(rho_px),
                std_dev_px: Some(std_devs),
                correlation: corner.covariance[(0, 1)] / (std_devs[0] * std_devs[1]),
                // By that of the slope of the corner's line, also where ρ is from the median
                // over pairs. The uncertainty of q'ᵢ, which all features of a lens type share,
                // is not in it.
                rho_std_dev_px: Some(half_pitch * found.line.slope_std_dev),
                sensitivities_px: Some((*by_taken).into()),
                blur,
            });
        }
    }
    let edges = passed.width.map(|width| edges(frame, &width, passed.wider_px2));
    Detection {
        features,
        corners,
        homography,
        aberration: passed.aberration,
        edges,
        blur_by_width,
        contrast: passed.contrast,
    }
}

fn edges(frame: &Frame, width: &WidthChange, wider_px2: f64) -> Edges {
    let micro_images = frame.search.micro_images;
    let std_dev = |i: usize| width.covariance[(i, i)].sqrt();
    let value = micro_images.aperture_ratio() * width.change.x.exp();
    let about = Vector2::new(micro_images.aperture_ratio().ln(), wider_px2);
    let wider_px2 = wider_px2 + width.change.y;
    Edges {
        aperture_ratio: Estimate { value, std_dev: value * std_dev(0) },
        spread_px2: Estimate::new(micro_images.point_spread_px2() + wider_px2, std_dev(1)),
        corners: width.corners.about(&about),
        wider_px2,
    }
}
