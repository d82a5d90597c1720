//! The worth of the parameters beyond a plain camera: the calibration is repeated without a group of them, and
//! judged by frames that took no part in it.

use std::fmt;

use rayon::prelude::*;

use super::cross_validation::{frames_of_fold, indivisible};
use super::patterns::image_pattern;
use crate::calibration::{Calibration, Minimum, Refit};
use crate::error::{Error, Result};
use crate::finding::{Finding, Issue, Subject};
use crate::model::{Board, Parameter, PlenopticCamera, Reprojection};

/// Fewest frames. The scatter of the differences of fewer frames is too uncertain.
const MIN_FRAMES: usize = 6;
/// Significant mean growth, in standard errors.
const CLEAR: f64 = 2.0;
/// Relevant mean growth, as a fraction of the squared error. A group that is not needed changes the error by some tenths of
/// a per cent, and by 2 standard errors in every tenth case.
const NOTICEABLE: f64 = 0.01;
/// Errors |r/σ|² due to rounding.
const NOTHING: f64 = 1e-9;
/// Change of F, in σ, above which it depends on the model.
const MOVED: f64 = 3.0;

/// A group of parameters that a plain camera does not have.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Group {
    /// Distance e_z of the exit pupil from the lens, and its aberration e_r.
    ExitPupil,
    /// Field curvature κ and its growth κ_m.
    FieldCurvature,
    /// Growth of field curvature (κ_m) and distortion (Q₁ₘ) with the magnification.
    Growth,
    /// Tilt of the main lens, ωx and ωy.
    LensTilt,
    /// Radial distortion, Q₁ to Q₃ and Q₁ₘ.
    RadialDistortion,
    /// Tangential distortion, P₁ and P₂.
    TangentialDistortion,
    /// Shape of the board.
    BoardShape,
}

impl Group {
    /// All groups.
    pub const ALL: [Self; 7] = [
        Self::ExitPupil,
        Self::FieldCurvature,
        Self::Growth,
        Self::LensTilt,
        Self::RadialDistortion,
        Self::TangentialDistortion,
        Self::BoardShape,
    ];

    /// Returns the parameters of the group.
    #[must_use]
    pub fn parameters(self) -> &'static [Parameter] {
        use Parameter as P;
        match self {
            Self::ExitPupil => &[P::PupilZ, P::PupilAberration],
            Self::FieldCurvature => &[P::FieldCurvature, P::FieldCurvatureGrowth],
            Self::Growth => &[P::FieldCurvatureGrowth, P::Radial1Growth],
            Self::LensTilt => &[P::LensRotationX, P::LensRotationY],
            Self::RadialDistortion => &[P::Radial1, P::Radial2, P::Radial3, P::Radial1Growth],
            Self::TangentialDistortion => &[P::Tangential1, P::Tangential2],
            Self::BoardShape => &P::SHAPE,
        }
    }
}

impl fmt::Display for Group {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::ExitPupil => "exit pupil",
            Self::FieldCurvature => "field curvature",
            Self::Growth => "growth with the magnification",
            Self::LensTilt => "tilt of the main lens",
            Self::RadialDistortion => "radial distortion",
            Self::TangentialDistortion => "tangential distortion",
            Self::BoardShape => "shape of the board",
        })
    }
}

/// The worth of a group of parameters, judged by frames that took no part in the calibration.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Worth {
    /// Frames fit worse without the group.
    Needed,
    /// Frames fit as well without the group.
    NoDifference,
    /// Frames fit better without the group.
    Harmful,
}

impl fmt::Display for Worth {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Needed => "needed",
            Self::NoDifference => "no difference",
            Self::Harmful => "harmful",
        })
    }
}

/// The calibration without a group of parameters, compared with the calibration with all of them.
#[derive(Debug, Clone, PartialEq)]
pub struct WithoutGroup {
    /// Group that is left out.
    pub group: Group,
    /// Free parameters of the group, which are 0 here.
    pub parameters: Vec<Parameter>,
    /// Camera without these parameters.
    pub camera: PlenopticCamera,
    /// Residuals of this camera.
    pub reprojection: Reprojection,
    /// [`Patterns::image`](crate::assessment::Patterns::image) of these residuals.
    pub pattern: f64,
    /// Relative growth of the error of each left-out frame ([`ModelComparison::errors`]), by frame.
    pub growth: Vec<(u32, f64)>,
    /// Growth of twice the cost over the weight of the priors: the parts of features, centres and priors. It is a likelihood
    /// ratio, with the distribution χ² if the group is not needed.
    pub cost_growth: [f64; 3],
    /// Change of F, mm, and the same in σ of the calibration with the group; no σ if F is not free.
    pub focal_length_change: (f64, Option<f64>),
    /// True if the calibration without the group converged.
    pub converged: bool,
}

impl WithoutGroup {
    /// Returns the relative growth of the error of a left-out frame, as a geometric mean over the frames, and its
    /// standard error from their scatter.
    #[must_use]
    pub fn mean_growth(&self) -> (f64, f64) {
        let (mean, std_error) = self.log_growth();
        (mean.exp_m1(), mean.exp() * std_error)
    }

    /// Returns the mean logarithm of the growth and its standard error. With logarithms, a frame with larger errors than the
    /// others does not dominate.
    fn log_growth(&self) -> (f64, f64) {
        let count = self.growth.len() as f64;
        let logarithms = || self.growth.iter().map(|(_, growth)| growth.ln_1p());
        let mean = logarithms().sum::<f64>() / count;
        let square: f64 = logarithms().map(|log| (log - mean).powi(2)).sum();
        (mean, (square / (count - 1.0) / count).sqrt())
    }

    /// Returns the verdict: a group is needed if the mean growth exceeds one per cent and two standard errors, and harmful if
    /// the decrease does.
    #[must_use]
    pub fn worth(&self) -> Worth {
        let (mean, std_error) = self.log_growth();
        if mean.abs() < NOTICEABLE.max(CLEAR * std_error) {
            Worth::NoDifference
        } else if mean > 0.0 {
            Worth::Needed
        } else {
            Worth::Harmful
        }
    }

    /// Returns true if F depends on the group although the left-out frames do not need it.
    #[must_use]
    pub fn moves_unasked(&self) -> bool {
        let moved = self.focal_length_change.1.is_some_and(|std_devs| std_devs.abs() > MOVED);
        moved && self.worth() != Worth::Needed
    }
}

/// The worth of each group of parameters.
#[derive(Debug, Clone, PartialEq)]
pub struct ModelComparison {
    /// Number of folds that the frames were divided into.
    pub folds: usize,
    /// Error of each frame when it is left out of the calibration with all groups: the mean over its
    /// features of |r/σ|², with the weights and the loss of the calibration.
    pub errors: Vec<(u32, f64)>,
    /// [`Patterns::image`](crate::assessment::Patterns::image) with all groups.
    pub pattern: f64,
    /// Results of the groups with free parameters.
    pub groups: Vec<WithoutGroup>,
    /// Parts that could not be compared, with the reason.
    pub findings: Vec<Finding>,
}

impl ModelComparison {
    /// Returns the mean error of left-out frames.
    #[must_use]
    pub fn mean_error(&self) -> f64 {
        self.errors.iter().map(|e| e.1).sum::<f64>() / self.errors.len() as f64
    }
}

/// The minimum with all parameters or without some, and the errors of left-out frames.
struct Model {
    minimum: Minimum,
    errors: Vec<(u32, f64)>,
}

/// Data that the models share.
struct Comparison<'a> {
    refit: Refit<'a>,
    frames: Vec<u32>,
    folds: usize,
    progress: &'a (dyn Fn() + Sync),
}

/// Returns the number of calls of `progress` by [`compare_models`].
#[must_use]
pub fn comparison_steps(calibration: &Calibration, folds: usize) -> usize {
    let groups = free_groups(calibration).len();
    groups + (groups + 1) * folds
}

/// Calibrates without each group of parameters, and compares with the calibration by cross-validation. Both calibrations are
/// repeated without the frames of a fold, and the poses of these frames are refined for the fixed cameras. Fold i of n
/// has the frames i, i + n and so on. Differences are paired by frame, because a frame has the same errors in
/// all models.
///
/// `progress` is called after every calibration. Fails if the calibration has not converged, has too few frames, or has none
/// of the groups.
pub fn compare_models(
    calibration: &Calibration,
    board: &Board,
    folds: usize,
    progress: &(dyn Fn() + Sync),
) -> Result<ModelComparison> {
    let _span = tracing::info_span!("models").entered();
    let groups = free_groups(calibration);
    let frames: Vec<u32> = calibration.poses.iter().map(|pose| pose.frame).collect();
    check(calibration, &groups, folds)?;
    let refit = Refit::new(calibration, board);
    let comparison = Comparison { refit, frames, folds, progress };
    let (all, without) = rayon::join(
        || comparison.model(comparison.refit.minimum(), &[]),
        || -> Vec<Result<Model>> {
            groups.par_iter().map(|(_, parameters)| comparison.model_without(parameters)).collect()
        },
    );
    let all = all?;
    let about = |group: Group, issue: Issue| {
        Finding::note(issue).about(Subject::Part(format!("without the {group}")))
    };
    let (mut compared, mut findings) = (Vec::new(), Vec::new());
    for ((group, parameters), model) in groups.into_iter().zip(without) {
        let found = model
            .and_then(|model| comparison.compared(calibration, group, parameters, &model, &all));
        match found {
            Ok(found) => {
                if !found.converged {
                    findings.push(about(group, Issue::ModelNotConverged));
                }
                compared.push(found);
            }
            Err(error) => {
                findings.push(about(group, Issue::PartFailed { reason: error.to_string() }));
            }
        }
    }
    let sensor = &calibration.camera.sensor;
    let pattern = image_pattern(sensor, &calibration.reprojection.features);
    Ok(ModelComparison { folds, errors: all.errors, pattern, groups: compared, findings })
}

impl Comparison<'_> {
    fn model_without(&self, parameters: &[Parameter]) -> Result<Model> {
        let minimum = self.refit.without(parameters);
        (self.progress)();
        self.model(minimum?, parameters)
    }

    fn model(&self, minimum: Minimum, parameters: &[Parameter]) -> Result<Model> {
        let of_fold = |fold: usize| {
            let held_out = frames_of_fold(&self.frames, fold, self.folds);
            let errors = self.refit.held_out(&minimum, parameters, &held_out);
            (self.progress)();
            errors
        };
        let errors = (0..self.folds).into_par_iter().map(of_fold).collect::<Result<Vec<_>>>()?;
        let mut errors = errors.concat();
        errors.sort_by_key(|(frame, _)| *frame);
        Ok(Model { minimum, errors })
    }

    fn compared(
        &self,
        calibration: &Calibration,
        group: Group,
        parameters: Vec<Parameter>,
        model: &Model,
        all: &Model,
    ) -> Result<WithoutGroup> {
        let minimum = &model.minimum;
        let weight = calibration.cost.prior_weight;
        let growth = |i: usize| 2.0 * (minimum.cost_parts[i] - all.minimum.cost_parts[i]) / weight;
        let lens_types = calibration.camera.lens_types();
        let std_dev = calibration.uncertainty.intrinsic_std_devs(lens_types)[0];
        let longer =
            minimum.camera.main_lens.focal_length_mm - calibration.camera.main_lens.focal_length_mm;
        let reprojection = self.refit.reprojection(minimum)?;
        let by_frame = model.errors.iter().zip(&all.errors).map(|((frame, without), (_, with))| {
            (*frame, (without + NOTHING) / (with + NOTHING) - 1.0)
        });
        Ok(WithoutGroup {
            group,
            parameters,
            pattern: image_pattern(&minimum.camera.sensor, &reprojection.features),
            reprojection,
            growth: by_frame.collect(),
            cost_growth: [growth(0), growth(1), growth(2)],
            focal_length_change: (longer, std_dev.map(|std_dev| longer / std_dev)),
            camera: minimum.camera.clone(),
            converged: minimum.converged,
        })
    }
}

/// Returns the groups with free parameters, and these parameters.
fn free_groups(calibration: &Calibration) -> Vec<(Group, Vec<Parameter>)> {
    let all = Parameter::shared(calibration.camera.lens_types());
    let free: Vec<Parameter> =
        calibration.uncertainty.free_intrinsics.iter().map(|&i| all[i]).collect();
    let of_group = |group: Group| {
        let parameters: Vec<Parameter> =
            group.parameters().iter().copied().filter(|p| free.contains(p)).collect();
        (!parameters.is_empty()).then_some((group, parameters))
    };
    Group::ALL.into_iter().filter_map(of_group).collect()
}

fn check(
    calibration: &Calibration,
    groups: &[(Group, Vec<Parameter>)],
    folds: usize,
) -> Result<()> {
    let frames = calibration.poses.len();
    if groups.is_empty() {
        return Err(Error::invalid(
            "exit pupil, field curvature and distortion are all fixed: free one of them to compare \
             models",
        ));
    }
    if !calibration.converged {
        return Err(Error::invalid(
            "models are not compared, because the calibration has not converged",
        ));
    }
    if frames < MIN_FRAMES {
        return Err(Error::invalid(format!(
            "models are not compared: a significant difference needs at least {MIN_FRAMES} frames, not \
             {frames}"
        )));
    }
    if folds < 2 || folds > frames {
        return Err(indivisible(frames, folds));
    }
    Ok(())
}
