//! A board moved in known steps: measured against true displacement along z (paper,
//! Table 3).

use serde::Serialize;

use crate::checks::steps::{Step, steps};
use crate::error::{Error, Result};
use crate::finding::Finding;
use crate::model::{Board, FramePose};
use crate::numerics::mean_and_std_dev;

/// Displacement of the board between two frames.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Displacement {
    /// The earlier frame.
    pub from: u32,
    /// The later frame.
    pub to: u32,
    /// Known displacement, mm; positive away from the camera.
    pub true_mm: f64,
    /// Measured displacement along z, mm.
    pub measured_mm: f64,
}

impl Displacement {
    /// Returns |measured − true|, mm.
    #[must_use]
    pub fn absolute_error_mm(&self) -> f64 {
        (self.measured_mm - self.true_mm).abs()
    }

    /// Returns the absolute error over the true displacement.
    #[must_use]
    pub fn relative_error(&self) -> f64 {
        self.absolute_error_mm() / self.true_mm.abs()
    }
}

/// A mean and a standard deviation.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Spread {
    /// Mean of the values.
    pub mean: f64,
    /// Standard deviation about the mean; `None` for a single value.
    #[serde(rename = "standard_deviation")]
    pub std_dev: Option<f64>,
}

impl Spread {
    fn of(values: impl Iterator<Item = f64> + Clone) -> Self {
        let (mean, std_dev) = mean_and_std_dev(values);
        Self { mean, std_dev }
    }
}

/// All displacements of a series, with the errors of the paper's Table 3: mean and standard deviation
/// over the steps.
#[derive(Debug, Clone, PartialEq)]
pub struct Displacements {
    /// Displacements from every frame to the next.
    pub steps: Vec<Displacement>,
    /// Displacement from the first frame to the last.
    pub whole: Displacement,
    /// True if poses moved against the sign of the step. Distances from other software have their own direction.
    pub reversed: bool,
}

impl Displacements {
    /// Computes displacements from distances along z, by frame. Frames are `step_mm` apart, and
    /// some may be missing.
    ///
    /// Distances may have either sign and grow in either direction (`RxLive` measures towards the camera),
    /// so the direction follows from the first and last frames. Fails if there are fewer than two
    /// frames.
    pub fn of(distances_mm: &[(u32, f64)], step_mm: f64) -> Result<Self> {
        if !(step_mm.is_finite() && step_mm != 0.0) {
            return Err(Error::invalid(format!(
                "the step of the translation is {step_mm} mm, but has to be finite and not 0"
            )));
        }
        let mut sorted = distances_mm.to_vec();
        sorted.sort_by_key(|&(frame, _)| frame);
        let (Some(&first), Some(&last)) = (sorted.first(), sorted.last()) else {
            return Err(Error::invalid("no frame has a known distance"));
        };
        if sorted.len() < 2 {
            return Err(Error::invalid("a displacement needs two frames, but only one was given"));
        }
        let side = ((last.1 - first.1) * step_mm).signum();
        let between = |a: (u32, f64), b: (u32, f64)| Displacement {
            from: a.0,
            to: b.0,
            true_mm: step_mm * f64::from(b.0 - a.0),
            measured_mm: (b.1 - a.1) * side,
        };
        Ok(Self {
            steps: sorted.windows(2).map(|pair| between(pair[0], pair[1])).collect(),
            whole: between(first, last),
            reversed: false,
        })
    }

    /// Returns findings about the steps, for squares of this edge.
    #[must_use]
    pub fn findings(&self, square_mm: f64) -> Vec<Finding> {
        let ratio = |step: &Displacement| step.measured_mm / step.true_mm;
        let step = |d: &Displacement| Step { from: d.from, to: d.to, ratio: ratio(d) };
        let all: Vec<Step> = self.steps.iter().map(step).collect();
        let step_mm = self.whole.true_mm / f64::from(self.whole.to - self.whole.from);
        steps(&all, ratio(&self.whole), self.reversed, (step_mm, square_mm))
    }

    /// Computes displacements from poses, measured at the middle of the board, where the distance is most
    /// accurate.
    pub fn of_poses(poses: &[FramePose], board: &Board, step_mm: f64) -> Result<Self> {
        let corners = [0, board.corners() - 1].map(|corner| board.point_mm(corner));
        let middle = nalgebra::center(&corners[0], &corners[1]);
        let distances: Vec<(u32, f64)> =
            poses.iter().map(|p| (p.frame, (p.camera_from_board * middle).z)).collect();
        let found = Self::of(&distances, step_mm)?;
        let distance = |frame: u32| distances.iter().find(|d| d.0 == frame).map_or(0.0, |d| d.1);
        let way_mm = distance(found.whole.to) - distance(found.whole.from);
        Ok(Self { reversed: way_mm * step_mm < 0.0, ..found })
    }

    /// Returns mean and standard deviation of the relative errors of the steps.
    #[must_use]
    pub fn relative(&self) -> Spread {
        Spread::of(self.steps.iter().map(Displacement::relative_error))
    }

    /// Returns mean and standard deviation of the absolute errors of the steps, mm.
    #[must_use]
    pub fn absolute_mm(&self) -> Spread {
        Spread::of(self.steps.iter().map(Displacement::absolute_error_mm))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::finding::{Issue, Severity};

    #[test]
    fn errors_are_those_of_steps_and_missing_frames_make_longer_steps() {
        // Steps of 10 mm; frame 2 is missing. By hand: 10.1, 20.4 and 9.5 mm.
        let distances = [(0, 400.0), (1, 410.1), (3, 430.5), (4, 440.0)];
        let all = Displacements::of(&distances, 10.0).unwrap();
        assert_eq!(all.steps.len(), 3);
        let relative = all.relative();
        assert!((relative.mean - (0.01 + 0.02 + 0.05) / 3.0).abs() < 1e-12);
        assert!((all.absolute_mm().mean - (0.1 + 0.4 + 0.5) / 3.0).abs() < 1e-12);
        assert!((all.whole.measured_mm - 40.0).abs() < 1e-12);
        // Distances towards the camera, in any order.
        let turned: Vec<(u32, f64)> = distances.iter().rev().map(|&(f, z)| (f, -z)).collect();
        assert_eq!(Displacements::of(&turned, 10.0).unwrap(), all);
        assert!(Displacements::of(&distances[..1], 10.0).is_err());
        assert!(Displacements::of(&distances, 0.0).is_err());
    }

    /// Returns displacements of these steps, from 300 mm on.
    fn moved(steps_mm: &[f64]) -> Displacements {
        let place = |i: usize| 300.0 + steps_mm[..i].iter().sum::<f64>();
        let places = (0..=steps_mm.len()).map(place);
        let distances: Vec<(u32, f64)> = (0..).zip(places).collect();
        Displacements::of(&distances, 10.0).unwrap()
    }

    #[test]
    fn steps_tell_what_is_wrong_with_them() {
        let of = |steps_mm: &[f64]| moved(steps_mm).findings(3.0);
        assert!(of(&[10.0, 10.01, 9.99, 10.02]).is_empty());
        let [scale] = &of(&[9.0, 9.01, 8.99, 9.0])[..] else { panic!("no scale") };
        let Issue::StepScale { ratio, step_mm, .. } = scale.issue else { panic!("{scale}") };
        assert!((ratio - 0.9).abs() < 1e-9 && (step_mm - 10.0).abs() < 1e-12);
        assert_eq!(scale.severity, Severity::Unusable);
        assert_eq!(of(&[9.8, 9.81, 9.79, 9.8])[0].severity, Severity::Caution);
        let text = scale.to_string();
        assert!(text.contains("3.3333 mm") && text.contains("9.0000 mm"), "{text}");
        // An image is missing between frames 1 and 2.
        let [uneven] = &of(&[10.0, 20.0, 10.0, 10.0])[..] else { panic!("no uneven step") };
        let Issue::StepUneven { from: 1, to: 2, ratio } = uneven.issue else { panic!("{uneven}") };
        assert!((ratio - 2.0).abs() < 1e-9);
        // Two images are swapped.
        let swapped = of(&[20.0, -10.0, 20.0, 10.0]);
        assert_eq!(swapped.len(), 3);
        assert!(swapped.iter().all(|finding| finding.code() == "step-uneven"));
        // Scattering steps do not contradict the scale.
        assert!(of(&[10.9, 9.6, 10.8, 9.4]).is_empty());
    }
}
