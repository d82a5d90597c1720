//! A corner as it was seen in a micro-image, and how that depends on what was taken for granted.

use nalgebra::{SMatrix, Vector2, Vector3};

use super::corner::Corner;
use super::corner_fit::Sensitivities;
use super::edge_width::EdgeWidth;
use super::{CornerObservation, MicroOptics};
use crate::model::TAKEN;

/// An observation of a corner, made with the slope and the aberration that were known before. Places are
/// straightened, see [`super::Aberration`].
pub(super) struct CornerMeasurement {
    pub observation: CornerObservation,
    pub corner: Corner,
    /// γ₀, the slope that its line had before.
    pub slope_before: f64,
    /// By how much the observation moves with that slope and the aberration.
    pub sensitivities: Sensitivities,
    /// What its light tells about its blur radius and the variance of its edges.
    pub width: EdgeWidth,
}

impl CornerMeasurement {
    /// The observation as it enters the line: its place i + (γ − γ₀) sensitivity = β + γ c is a line in γ as well, that
    /// of i − γ₀ sensitivity over c − sensitivity. So the slope and the blur that follows from it are found together;
    /// by turns, each round would leave half of an error.
    pub fn on_line(&self) -> CornerObservation {
        CornerObservation {
            center: self.observation.center - self.sensitivities.by_slope,
            position: self.observation.position - self.sensitivities.by_slope * self.slope_before,
            ..self.observation
        }
    }

    /// Adds to the sensitivities by what is taken from white images what follows from how the slope of the line changes with it.
    pub fn take_slope(&mut self, slope_by_taken: &SMatrix<f64, 1, TAKEN>) {
        self.sensitivities.by_taken += self.sensitivities.by_slope * slope_by_taken;
    }

    /// Moves the observation to where another aberration puts it.
    pub fn change_aberration(&mut self, change: &Vector3<f64>) {
        self.moved(&(self.sensitivities.by_aberration * change));
    }

    /// Moves the observation to where the blur radius of another slope puts it. The change of the blur radius is then from the
    /// one of that slope.
    pub fn change_slope(&mut self, slope: f64, optics: &MicroOptics) {
        self.moved(&(self.sensitivities.by_slope * (slope - self.slope_before)));
        self.width = self.width_at(slope, optics);
        self.slope_before = slope;
    }

    /// What its light tells about the change of the blur radius from the one of a slope, and about the variance of its edges.
    pub fn width_at(&self, slope: f64, optics: &MicroOptics) -> EdgeWidth {
        let wider_px = optics.blur_radius_px(slope) - optics.blur_radius_px(self.slope_before);
        self.width.about(&Vector2::new(-wider_px, 0.0))
    }

    fn moved(&mut self, by: &Vector2<f64>) {
        self.observation.position += by;
        self.corner.place += by;
    }
}

#[cfg(test)]
mod tests {
    use nalgebra::{Matrix2, Matrix2x3};

    use super::super::corner_fit::ByTaken;
    use super::super::micro_images::tests::micro_images;
    use super::*;

    /// The measured blur radius does not depend on the slope that the corner was fitted with.
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
                by_aberration: Matrix2x3::zeros(),
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
