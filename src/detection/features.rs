//! Features of a frame: the result of the detection.

use nalgebra::{Matrix3, Vector2, Vector3};

use super::edge_width::{EdgeWidth, WidthChange};
use super::frame::Frame;
use super::line::median_inverse_virtual_depth;
use super::second_pass::{BoardCorner, Found, SecondPassed};
use super::{Aberration, CornerLine, CornerObservation, DepthEstimator, MicroImages, MicroOptics};
use crate::model::taken::APERTURE_RATIO;
use crate::model::{BapFeature, MeasuredBlur};
use crate::quantity::Estimate;

/// Corner of the board, from all of its observations.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct DetectedCorner {
    /// Board corner, `row · columns + column`.
    pub corner: i32,
    /// Line of its observations.
    pub line: CornerLine,
    /// 1/ν as in the paper, from the median over pairs with λ = 1.
    pub median_inverse_virtual_depth: f64,
    /// Number of its features.
    pub features: usize,
}

/// Features of a frame, with the corners and optics that they follow from.
#[derive(Debug, Clone, PartialEq)]
pub struct Detection {
    /// Features, corner by corner.
    pub features: Vec<BapFeature>,
    /// The corners of the board.
    pub corners: Vec<DetectedCorner>,
    /// Homography from (column, row, 1) of a corner to its pinhole image, px.
    pub homography: Matrix3<f64>,
    /// Aberrations that positions are corrected for: a main lens without them would show the corners there.
    pub aberration: Aberration,
    /// Sharpness of its edges, if they show it.
    pub edges: Option<Edges>,
    /// Measurements that the features follow from.
    measured: Measured,
}

/// Measurements of the second pass in a frame, for the aperture ratio that its corners were fitted with.
#[derive(Debug, Clone, PartialEq)]
struct Measured {
    frame: u32,
    estimator: DepthEstimator,
    corners: Vec<BoardCorner>,
    width: Option<WidthChange>,
    aperture_ratio: f64,
    /// Excess edge variance along an axis, px².
    wider_px2: f64,
}

/// Estimates from the widths of edges in a frame.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Edges {
    /// Aperture ratio of the micro-lenses from this frame alone.
    pub aperture_ratio: Estimate,
    /// Variance of edges along an axis beyond the blur of a whole pixel, px²: the point spread, and the effects of print and
    /// motion.
    pub spread_px2: Estimate,
    /// Information of its corners about ln φ and the excess edge variance.
    pub(super) corners: EdgeWidth,
}

impl Detection {
    /// Moves its features to the aperture ratio of some micro-images, and measures their blur. `wider_px2` is the excess edge
    /// variance, px², if other frames determine it better.
    pub(super) fn settle(&mut self, micro_images: &MicroImages, wider_px2: Option<Estimate>) {
        (self.features, self.corners) = self.measured.features(micro_images, wider_px2);
    }

    /// Returns the pinhole image of a position on the board in columns and rows, px.
    #[must_use]
    pub fn pinhole(&self, column: f64, row: f64) -> Vector2<f64> {
        let p = self.homography * Vector3::new(column, row, 1.0);
        p.xy() / p.z
    }
}

/// Computes the features of the corners that were found, with the aperture ratio of the search.
pub(super) fn detection(
    frame: &Frame,
    passed: SecondPassed<'_>,
    homography: Matrix3<f64>,
) -> Detection {
    let SecondPassed { micro_images, corners, aberration, wider_px2, width } = passed;
    let edges = width.map(|width| edges(&micro_images, &width, wider_px2));
    let measured = Measured {
        frame: frame.frame,
        estimator: frame.search.estimator,
        corners,
        width,
        aperture_ratio: micro_images.aperture_ratio(),
        wider_px2,
    };
    let (features, corners) = measured.features(frame.search.micro_images, None);
    Detection { features, corners, homography, aberration, edges, measured }
}

impl Measured {
    /// Returns the features with the aperture ratio of some micro-images, corner by corner, and the corners. Positions and
    /// lines move by their derivatives; ρ also moves by q'ᵢ, since white images show φqᵢ. The measured blur does not depend on
    /// the aperture ratio.
    fn features(
        &self,
        micro_images: &MicroImages,
        wider_px2: Option<Estimate>,
    ) -> (Vec<BapFeature>, Vec<DetectedCorner>) {
        let half_pitch = micro_images.grid.pitch_px / 2.0;
        let ratio = micro_images.aperture_ratio();
        let log_change = (ratio / self.aperture_ratio).ln();
        let fitted_with = micro_images.with_aperture_ratio(self.aperture_ratio);
        let (mut features, mut corners) = (Vec::new(), Vec::new());
        for found in &self.corners {
            let line = found.line.moved(&found.line_by_ratio, log_change);
            let moved = |found: &Found| {
                let by_ratio = found.by_taken.column(APERTURE_RATIO);
                let position = found.observation.position + by_ratio * log_change;
                CornerObservation { position, ..found.observation }
            };
            let observations: Vec<CornerObservation> =
                found.observations.iter().map(moved).collect();
            // Each corner has at least two observations.
            let median = median_inverse_virtual_depth(&observations).unwrap_or(f64::NAN);
            corners.push(DetectedCorner {
                corner: found.corner,
                line,
                median_inverse_virtual_depth: median,
                features: observations.len(),
            });
            for (found_in, observation) in found.observations.iter().zip(observations) {
                let Found { corner, by_taken, width, .. } = found_in;
                let (k, l) = (observation.k, observation.l);
                let optics = micro_images.optics(k, l);
                let rho_px = match self.estimator {
                    DepthEstimator::Median => optics.rho_of_depth_px(median),
                    DepthEstimator::Line => optics.rho_px(line.slope),
                };
                let blur = self.blur(width, &fitted_with.optics(k, l), found.line.slope, wider_px2);
                let std_devs = [0, 1].map(|i| corner.covariance[(i, i)].sqrt());
                features.push(BapFeature {
                    frame: self.frame,
                    corner: found.corner,
                    k,
                    l,
                    u_px: observation.position.x,
                    v_px: observation.position.y,
                    rho_px: Some(rho_px),
                    std_dev_px: Some(std_devs),
                    correlation: corner.covariance[(0, 1)] / (std_devs[0] * std_devs[1]),
                    // It follows from the slope of the corner's line, even if ρ is from the median over pairs. The uncertainty
                    // of q'ᵢ, which all features of a lens type share, is not included.
                    rho_std_dev_px: Some(half_pitch * line.slope_std_dev),
                    sensitivities_px: Some((*by_taken).into()),
                    blur: blur.map(|blur| MeasuredBlur { aperture_ratio: ratio, ..blur }),
                });
            }
        }
        (features, corners)
    }

    /// Returns the measured blur of a feature whose line has a slope.
    fn blur(
        &self,
        width: &EdgeWidth,
        optics: &MicroOptics,
        slope: f64,
        wider_px2: Option<Estimate>,
    ) -> Option<MeasuredBlur> {
        let own = self.width?.change.y;
        let change = wider_px2.map_or(own, |wider| wider.value - self.wider_px2);
        let (by, variance) = width.of_first(&Vector2::new(0.0, change))?;
        Some(MeasuredBlur {
            radius_px: optics.blur_radius_px(slope) + by,
            std_dev_px: variance.sqrt(),
            shared_px: wider_px2.map_or(0.0, |wider| width.first_by_width() * wider.std_dev),
            aperture_ratio: optics.aperture_ratio,
        })
    }
}

fn edges(micro_images: &MicroImages, width: &WidthChange, wider_px2: f64) -> Edges {
    let std_dev = |i: usize| width.covariance[(i, i)].sqrt();
    let value = micro_images.aperture_ratio() * width.change.x.exp();
    let about = Vector2::new(micro_images.aperture_ratio().ln(), wider_px2);
    let wider_px2 = wider_px2 + width.change.y;
    Edges {
        aperture_ratio: Estimate { value, std_dev: value * std_dev(0) },
        spread_px2: Estimate::new(micro_images.point_spread_px2() + wider_px2, std_dev(1)),
        corners: width.corners.about(&about),
    }
}
