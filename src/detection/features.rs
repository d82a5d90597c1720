//! Features of a frame: the result of the detection.

use nalgebra::{Matrix3, Vector2, Vector3};

use super::aberration_fit::AberrationInformation;
use super::board::LabelledBoard;
use super::corner_measurement::CornerMeasurement;
use super::edge_width::{EdgeWidth, WidthChange};
use super::frame::Frame;
use super::line::median_inverse_virtual_depth;
use super::second_pass::{Change, SecondPassed, SettledCorner};
use super::{Aberration, CornerLine, CornerObservation, DepthEstimator, MicroImages, MicroOptics};
use crate::model::{BapFeature, MeasuredBlur};
use crate::optics::aberration::AberrationEstimate;
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
    /// Number of corners that match another part of the board, if they do: the board fills the view, and the corners are numbered
    /// up to a shift by whole squares and a quarter turn.
    pub elsewhere: Option<usize>,
    /// Aberrations that positions are corrected for: a main lens without them would show the corners there.
    pub aberration: Aberration,
    /// Sharpness of its edges, if they show it.
    pub edges: Option<Edges>,
    frame: u32,
    estimator: DepthEstimator,
    /// Measurements that the features follow from.
    measured: SecondPassed,
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
    /// Creates the detection from the corners that were found, with the aberrations of this frame alone.
    pub(super) fn new(frame: &Frame, measured: SecondPassed, labelled: &LabelledBoard) -> Self {
        let search = frame.search;
        let mut found = Self {
            features: Vec::new(),
            corners: Vec::new(),
            homography: labelled.homography,
            elsewhere: labelled.elsewhere,
            aberration: measured.aberration.aberration,
            edges: None,
            frame: frame.frame,
            estimator: search.estimator,
            measured,
        };
        let fitted_with = search.micro_images.with_aperture_ratio(found.measured.aperture_ratio);
        found.edges =
            found.measured.width.map(|width| edges(&fitted_with, &width, found.measured.wider_px2));
        let aberration = found.measured.aberration;
        found.settle(search.micro_images, &aberration, None);
        found
    }

    /// Returns the information of its corners about the aberrations.
    pub(super) fn about_aberration(&self) -> &AberrationInformation {
        &self.measured.information
    }

    /// Computes its features, corner by corner, and the corners for the aperture ratio of some micro-images and an aberration,
    /// and measures their blur. `wider_px2` is the excess edge variance, px², if other frames determine it better. Positions
    /// and lines move by their derivatives; ρ also moves by q'ᵢ, since white images show φqᵢ. The measured blur does not depend
    /// on the aperture ratio. Returns the number of features of corners whose line is not possible any more.
    pub(super) fn settle(
        &mut self,
        micro_images: &MicroImages,
        aberration: &AberrationEstimate,
        wider_px2: Option<Estimate>,
    ) -> usize {
        let half_pitch = micro_images.grid.pitch_px / 2.0;
        let ratio = micro_images.aperture_ratio();
        let measured = &self.measured;
        let fitted_with = micro_images.with_aperture_ratio(measured.aperture_ratio);
        let change = Change {
            from: &measured.measured_with,
            to: aberration,
            log_ratio: (ratio / measured.aperture_ratio).ln(),
        };
        let (mut features, mut corners, mut given_up) = (Vec::new(), Vec::new(), 0);
        for corner in &measured.corners {
            let Some(SettledCorner { corner, line, seen, .. }) =
                corner.settled(&fitted_with, &change)
            else {
                given_up += corner.seen.len();
                continue;
            };
            let observations: Vec<CornerObservation> = seen.iter().map(|s| s.observation).collect();
            // Each corner has at least two observations.
            let median = median_inverse_virtual_depth(&observations).unwrap_or(f64::NAN);
            corners.push(DetectedCorner {
                corner,
                line,
                median_inverse_virtual_depth: median,
                features: seen.len(),
            });
            for CornerMeasurement { observation, corner: fitted, sensitivities, width, .. } in &seen
            {
                let (k, l) = (observation.k, observation.l);
                let optics = micro_images.optics(k, l);
                let rho_px = match self.estimator {
                    DepthEstimator::Median => optics.rho_of_depth_px(median),
                    DepthEstimator::Line => optics.rho_px(line.slope),
                };
                let blur = measured.blur(width, &fitted_with.optics(k, l), line.slope, wider_px2);
                let std_devs = [0, 1].map(|i| fitted.covariance[(i, i)].sqrt());
                features.push(BapFeature {
                    frame: self.frame,
                    corner,
                    k,
                    l,
                    u_px: observation.position.x,
                    v_px: observation.position.y,
                    rho_px: Some(rho_px),
                    std_dev_px: Some(std_devs),
                    correlation: fitted.covariance[(0, 1)] / (std_devs[0] * std_devs[1]),
                    // It follows from the slope of the corner's line, even if ρ is from the median over pairs. The uncertainty
                    // of q'ᵢ, which all features of a lens type share, is not included.
                    rho_std_dev_px: Some(half_pitch * line.slope_std_dev),
                    sensitivities_px: Some(sensitivities.by_taken.into()),
                    blur: blur.map(|blur| MeasuredBlur { aperture_ratio: ratio, ..blur }),
                });
            }
        }
        (self.features, self.corners, self.aberration) = (features, corners, aberration.aberration);
        given_up
    }

    /// Returns the pinhole image of a position on the board in columns and rows, px.
    #[must_use]
    pub fn pinhole(&self, column: f64, row: f64) -> Vector2<f64> {
        let p = self.homography * Vector3::new(column, row, 1.0);
        p.xy() / p.z
    }
}

impl SecondPassed {
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
