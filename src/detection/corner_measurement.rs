//! Measurement of a corner in a micro-image, with its sensitivities to assumed quantities.

use nalgebra::{SMatrix, Vector2};

use super::corner::Corner;
use super::corner_fit::Sensitivities;
use super::edge_width::EdgeWidth;
use super::{CornerObservation, MicroOptics};
use crate::model::TAKEN;

/// Observation of a corner, made with the slope and the aberration that were known before. Positions are corrected for the
/// aberration, see [`super::Aberration`].
#[derive(Debug, Clone, PartialEq)]
pub(super) struct CornerMeasurement {
    pub observation: CornerObservation,
    pub corner: Corner,
    /// Slope γ₀ that its line had before.
    pub slope_before: f64,
    /// Sensitivities of the position to this slope, to the aberration, and to the quantities that all corners share.
    pub sensitivities: Sensitivities,
    /// Information of its light about its blur radius and the variance of its edges.
    pub width: EdgeWidth,
}

impl CornerMeasurement {
    /// Returns the observation for the fit of the line. With the sensitivity s to the slope, the line i + (γ − γ₀) s = β + γ c
    /// is linear in γ too: i − γ₀ s over c − s. The fit thus finds the slope together with the blur that follows from it. Fits
    /// of both in turn would leave half of an error in each round.
    pub fn on_line(&self) -> CornerObservation {
        CornerObservation {
            center: self.observation.center - self.sensitivities.by_slope,
            position: self.observation.position - self.sensitivities.by_slope * self.slope_before,
            ..self.observation
        }
    }

    /// Adds the effect of the slope of the line to the sensitivities to quantities that all corners share.
    pub fn take_slope(&mut self, slope_by_taken: &SMatrix<f64, 1, TAKEN>) {
        self.sensitivities.by_taken += self.sensitivities.by_slope * slope_by_taken;
    }

    /// Moves the observation to the blur radius of another slope. The change of the blur radius is then relative to this
    /// radius.
    pub fn change_slope(&mut self, slope: f64, optics: &MicroOptics) {
        self.moved(&(self.sensitivities.by_slope * (slope - self.slope_before)));
        self.width = self.width_at(slope, optics);
        self.slope_before = slope;
    }

    /// Returns the information about the change of the blur radius from the radius of a slope, and about the variance of its
    /// edges.
    pub fn width_at(&self, slope: f64, optics: &MicroOptics) -> EdgeWidth {
        let wider_px = optics.blur_radius_px(slope) - optics.blur_radius_px(self.slope_before);
        self.width.about(&Vector2::new(-wider_px, 0.0))
    }

    /// Moves the position.
    pub fn moved(&mut self, by: &Vector2<f64>) {
        self.observation.position += by;
        self.corner.place += by;
    }
}

#[cfg(test)]
mod tests {
    use nalgebra::{Matrix2, Matrix2x5};

    use super::super::corner_fit::ByTaken;
    use super::super::micro_images::tests::micro_images;
    use super::*;

    /// Checks that the measured blur radius does not depend on the slope that the corner was fitted with.
    #[test]
    fn the_measured_blur_radius_stays_with_another_slope() {
        let optics = micro_images(23.0).optics(1, 1);
        let width =
            EdgeWidth::new(Matrix2::new(900.0, 100.0, 100.0, 400.0), Vector2::new(9.0, 2.0));
        let mut seen = CornerMeasurement {
            observation: CornerObservation {
                k: 1,
                l: 1,
                center: Vector2::zeros(),
                position: Vector2::zeros(),
                covariance: Matrix2::identity(),
                squares: Matrix2::identity(),
            },
            corner: Corner {
                place: Vector2::zeros(),
                angles: [0.2, 1.6],
                level: 0.5,
                contrast: 0.4,
                width: 1.0,
                covariance: Matrix2::identity(),
                explained: 1.0,
            },
            slope_before: 0.5,
            sensitivities: Sensitivities {
                by_slope: Vector2::new(0.3, -0.2),
                by_aberration: Matrix2x5::zeros(),
                by_taken: ByTaken::zeros(),
            },
            width,
        };
        let radius_px = |seen: &CornerMeasurement| {
            let change = seen.width.of_first(&Vector2::zeros()).unwrap().0;
            optics.blur_radius_px(seen.slope_before) + change
        };
        let before = radius_px(&seen);
        seen.change_slope(0.52, &optics);
        assert!((radius_px(&seen) - before).abs() < 1e-9, "{} for {before}", radius_px(&seen));
        assert!((seen.observation.position - Vector2::new(0.006, -0.004)).norm() < 1e-12);
    }
}
