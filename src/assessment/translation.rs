//! A board moved in known steps: the displacement along the optical axis against the truth (paper,
//! Table 3).

use crate::error::{Error, Result};
use crate::model::{Board, FramePose};
use crate::numerics::median;

/// Displacement of the board between two frames.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Displacement {
    /// The earlier frame.
    pub from: u32,
    /// The later frame.
    pub to: u32,
    /// Known displacement, mm; positive away from the camera.
    pub true_mm: f64,
    /// Measured displacement along the optical axis, mm.
    pub measured_mm: f64,
}

impl Displacement {
    /// |measured − true|, mm.
    #[must_use]
    pub fn absolute_error_mm(&self) -> f64 {
        (self.measured_mm - self.true_mm).abs()
    }

    /// The absolute error over the true displacement.
    #[must_use]
    pub fn relative_error(&self) -> f64 {
        self.absolute_error_mm() / self.true_mm.abs()
    }
}

/// Mean and standard deviation.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Spread {
    /// Mean.
    pub mean: f64,
    /// Standard deviation about the mean; `None` for a single value.
    pub std_dev: Option<f64>,
}

impl Spread {
    fn of(values: impl Iterator<Item = f64> + Clone) -> Self {
        let count = values.clone().count() as f64;
        let mean = values.clone().sum::<f64>() / count;
        let square: f64 = values.map(|v| (v - mean).powi(2)).sum();
        Self { mean, std_dev: (count > 1.0).then(|| (square / (count - 1.0)).sqrt()) }
    }
}

/// All displacements of a series, with the errors of the paper's Table 3: mean and standard deviation
/// over the steps.
#[derive(Debug, Clone, PartialEq)]
pub struct Displacements {
    /// From every frame to the next.
    pub steps: Vec<Displacement>,
    /// From the first frame to the last.
    pub whole: Displacement,
    /// Whether poses moved against the sign of the step. Distances of other software have a direction of their own.
    pub reversed: bool,
}

/// What known steps say against a camera, its board, or themselves.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum StepDoubt {
    /// The board moved the other way.
    Reversed,
    /// One step is so many times as long as the others.
    Uneven {
        /// That step.
        step: Displacement,
        /// Its length over that of the others.
        ratio: f64,
    },
    /// All steps together come out so many times as long as they are known to be.
    Scale {
        /// Measured over known.
        ratio: f64,
        /// The known step, mm.
        step_mm: f64,
    },
}

/// A step that differs by more than this from the typical one is no step of the series.
const UNEVEN: f64 = 0.3;
/// Steps that are more than this off, and more than so many of their σ, contradict the scale.
const SCALE: f64 = 0.01;
const SCALE_STD_DEVS: f64 = 3.0;

impl StepDoubt {
    /// What it means for squares of this edge, mm.
    #[must_use]
    pub fn text(&self, square_mm: f64) -> String {
        match self {
            Self::Reversed => {
                "the board of the translation moved the other way: step_mm is negative towards the \
                               camera; change its sign, or the order of the images"
                    .to_owned()
            }
            Self::Uneven { step, ratio } => format!(
                "the step of the translation from frame {} to {} is {ratio:.2} times as long as the others: an image is \
                 missing, there twice, or out of order",
                step.from, step.to
            ),
            Self::Scale { ratio, step_mm } => format!(
                "the known steps of the translation come out {ratio:.3} times as long as they are: if step_mm is right, \
                 the squares of the board are {:.4} mm and not {square_mm} mm (square_mm); if these are right, the step \
                 is {:.4} mm and not {step_mm} mm (step_mm). Measure both",
                square_mm / ratio,
                step_mm * ratio
            ),
        }
    }
}

impl Displacements {
    /// Displacements from distances along the optical axis, by frame; frames are `step_mm` apart, and
    /// some may be missing.
    ///
    /// Distances may have either sign and grow in either direction (`RxLive` measures towards the camera),
    /// so the direction follows from the first and last frames. An error if there are fewer than two
    /// frames.
    pub fn of(distances_mm: &[(u32, f64)], step_mm: f64) -> Result<Self> {
        if !(step_mm.is_finite() && step_mm != 0.0) {
            return Err(Error::invalid(format!(
                "the step of the translation is {step_mm} mm; it has to be finite and not 0"
            )));
        }
        let mut sorted = distances_mm.to_vec();
        sorted.sort_by_key(|&(frame, _)| frame);
        let (Some(&first), Some(&last)) = (sorted.first(), sorted.last()) else {
            return Err(Error::invalid("there are no frames with a distance"));
        };
        if sorted.len() < 2 {
            return Err(Error::invalid("a displacement needs two frames, but there is only one"));
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

    /// What they say against the camera, the board, or themselves.
    #[must_use]
    pub fn doubts(&self) -> Vec<StepDoubt> {
        let ratio = |step: &Displacement| step.measured_mm / step.true_mm;
        let mut doubts = Vec::new();
        if self.reversed {
            doubts.push(StepDoubt::Reversed);
        }
        // Images that are out of order leave the whole way nearly as it is.
        let whole = ratio(&self.whole);
        let of_steps = || median(self.steps.iter().map(ratio)).unwrap_or(whole);
        let typical = if (whole - 1.0).abs() < UNEVEN { 1.0 } else { of_steps() };
        let uneven = |step: &&Displacement| (ratio(step) / typical - 1.0).abs() > UNEVEN;
        let mut even: Vec<f64> = Vec::new();
        for step in &self.steps {
            if self.steps.len() > 2 && uneven(&step) {
                doubts.push(StepDoubt::Uneven { step: *step, ratio: ratio(step) / typical });
            } else {
                even.push(ratio(step));
            }
        }
        let spread = Spread::of(even.iter().copied());
        let std_dev = spread.std_dev.unwrap_or(0.0) / (even.len() as f64).sqrt();
        let all = even.len() == self.steps.len();
        if all && (spread.mean - 1.0).abs() > SCALE.max(SCALE_STD_DEVS * std_dev) {
            let step_mm = self.whole.true_mm / f64::from(self.whole.to - self.whole.from);
            doubts.push(StepDoubt::Scale { ratio: spread.mean, step_mm });
        }
        doubts
    }

    /// Displacements from poses, measured at the middle of the board, where the distance is most
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

    /// Relative errors of the steps.
    #[must_use]
    pub fn relative(&self) -> Spread {
        Spread::of(self.steps.iter().map(Displacement::relative_error))
    }

    /// Absolute errors of the steps, mm.
    #[must_use]
    pub fn absolute_mm(&self) -> Spread {
        Spread::of(self.steps.iter().map(Displacement::absolute_error_mm))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

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
        // Measured towards the camera, in any order.
        let turned: Vec<(u32, f64)> = distances.iter().rev().map(|&(f, z)| (f, -z)).collect();
        assert_eq!(Displacements::of(&turned, 10.0).unwrap(), all);
        assert!(Displacements::of(&distances[..1], 10.0).is_err());
        assert!(Displacements::of(&distances, 0.0).is_err());
    }

    /// Distances of 300 mm and on, whose steps are these.
    fn moved(steps_mm: &[f64]) -> Displacements {
        let place = |i: usize| 300.0 + steps_mm[..i].iter().sum::<f64>();
        let places = (0..=steps_mm.len()).map(place);
        let distances: Vec<(u32, f64)> = (0..).zip(places).collect();
        Displacements::of(&distances, 10.0).unwrap()
    }

    #[test]
    fn steps_tell_what_is_wrong_with_them() {
        assert!(moved(&[10.0, 10.01, 9.99, 10.02]).doubts().is_empty());
        let [StepDoubt::Scale { ratio, step_mm }] = moved(&[9.0, 9.01, 8.99, 9.0]).doubts()[..]
        else {
            panic!("no scale");
        };
        assert!((ratio - 0.9).abs() < 1e-9 && (step_mm - 10.0).abs() < 1e-12);
        let text = StepDoubt::Scale { ratio, step_mm }.text(3.0);
        assert!(text.contains("3.3333 mm") && text.contains("9.0000 mm"), "{text}");
        // An image is missing between frames 1 and 2.
        let [StepDoubt::Uneven { step, ratio }] = moved(&[10.0, 20.0, 10.0, 10.0]).doubts()[..]
        else {
            panic!("no uneven step");
        };
        assert!((step.from, step.to) == (1, 2) && (ratio - 2.0).abs() < 1e-9);
        // Two images in the other's place.
        let swapped = moved(&[20.0, -10.0, 20.0, 10.0]).doubts();
        assert_eq!(swapped.len(), 3);
        assert!(swapped.iter().all(|doubt| matches!(doubt, StepDoubt::Uneven { .. })));
        // Scattering steps do not contradict the scale.
        assert!(moved(&[10.9, 9.6, 10.8, 9.4]).doubts().is_empty());
    }
}
