//! What the parameters beyond a plain camera are worth: the calibration repeated without a group of them, and
//! judged by frames that took no part in it.

use std::fmt;

use rayon::prelude::*;

use super::cross_validation::frames_of_fold;
use super::patterns::image_pattern;
use crate::calibration::{Calibration, Minimum, Refit};
use crate::error::{Error, Result};
use crate::finding::{Finding, Issue, Subject};
use crate::model::{Board, Parameter, PlenopticCamera, Reprojection};

/// With fewer frames, the scatter of their differences says too little.
const MIN_FRAMES: usize = 6;
/// A mean growth by more standard errors than this is hardly an accident,
const CLEAR: f64 = 2.0;
/// and one by less than this fraction of the squared error makes no difference in practice. A group that is not
/// needed changes it by some tenths of a per cent, and by 2 standard errors in every tenth case.
const NOTICEABLE: f64 = 0.01;
/// Errors |r/σ|² below this are rounding.
const NOTHING: f64 = 1e-9;
/// A focal length that moves by more σ than this depends on the model.
const MOVED: f64 = 3.0;

/// A group of parameters that a plain camera does without.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Group {
    /// The distance e_z of the exit pupil from the lens.
    ExitPupil,
    /// The curvature κ of the field, and its growth κ_m.
    FieldCurvature,
    /// The growth κ_m of the curvature with the magnification.
    CurvatureGrowth,
    /// Radial distortion, Q₁ to Q₃.
    RadialDistortion,
    /// Tangential distortion, P₁ and P₂.
    TangentialDistortion,
    /// The shape of the board.
    BoardShape,
}

impl Group {
    /// All groups.
    pub const ALL: [Self; 6] = [
        Self::ExitPupil,
        Self::FieldCurvature,
        Self::CurvatureGrowth,
        Self::RadialDistortion,
        Self::TangentialDistortion,
        Self::BoardShape,
    ];

    /// Its parameters.
    #[must_use]
    pub fn parameters(self) -> &'static [Parameter] {
        use Parameter as P;
        match self {
            Self::ExitPupil => &[P::PupilZ],
            Self::FieldCurvature => &[P::FieldCurvature, P::FieldCurvatureGrowth],
            Self::CurvatureGrowth => &[P::FieldCurvatureGrowth],
            Self::RadialDistortion => &[P::Radial1, P::Radial2, P::Radial3],
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
            Self::CurvatureGrowth => "growth of the field curvature",
            Self::RadialDistortion => "radial distortion",
            Self::TangentialDistortion => "tangential distortion",
            Self::BoardShape => "shape of the board",
        })
    }
}

/// Whether a group of parameters should be there, as frames say that took no part in the calibration.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Worth {
    /// Without it they fit worse.
    EarnsItsKeep,
    /// They fit as well without it.
    NoDifference,
    /// Without it they fit better.
    Harms,
}

impl fmt::Display for Worth {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::EarnsItsKeep => "earns its keep",
            Self::NoDifference => "makes no difference",
            Self::Harms => "harms",
        })
    }
}

/// The calibration without a group of parameters, compared with the one with all of them.
#[derive(Debug, Clone, PartialEq)]
pub struct WithoutGroup {
    /// The group.
    pub group: Group,
    /// The parameters of the group that were free; they are 0 here.
    pub parameters: Vec<Parameter>,
    /// The camera without them.
    pub camera: PlenopticCamera,
    /// Its residuals.
    pub reprojection: Reprojection,
    /// [`Patterns::image`](crate::assessment::Patterns::image) of these.
    pub pattern: f64,
    /// By what fraction the error of each frame grows that is left out ([`ModelComparison::errors`]), by frame.
    pub growth: Vec<(u32, f64)>,
    /// By how much twice the cost grows, divided by the weight of the priors: the parts of features,
    /// centres and priors. A likelihood ratio, χ² if the group is not needed.
    pub cost_growth: [f64; 3],
    /// The change of F, mm, and the same in σ of the calibration with the group, where F is free.
    pub focal_length_change: (f64, Option<f64>),
    /// Whether the calibration without the group converged.
    pub converged: bool,
}

impl WithoutGroup {
    /// By what fraction the error of a left-out frame grows in the (geometric) mean over the frames, and the
    /// standard error of that from their scatter.
    #[must_use]
    pub fn mean_growth(&self) -> (f64, f64) {
        let (mean, std_error) = self.log_growth();
        (mean.exp_m1(), mean.exp() * std_error)
    }

    /// Of logarithms, so that a frame with larger errors than the others does not decide alone.
    fn log_growth(&self) -> (f64, f64) {
        let count = self.growth.len() as f64;
        let logarithms = || self.growth.iter().map(|(_, growth)| growth.ln_1p());
        let mean = logarithms().sum::<f64>() / count;
        let square: f64 = logarithms().map(|log| (log - mean).powi(2)).sum();
        (mean, (square / (count - 1.0) / count).sqrt())
    }

    /// The verdict: a mean growth by more than one per cent and two standard errors earns its keep, a mean loss
    /// by as much harms.
    #[must_use]
    pub fn worth(&self) -> Worth {
        let (mean, std_error) = self.log_growth();
        if mean.abs() < NOTICEABLE.max(CLEAR * std_error) {
            Worth::NoDifference
        } else if mean > 0.0 {
            Worth::EarnsItsKeep
        } else {
            Worth::Harms
        }
    }

    /// Whether F depends on the group although the frames do not ask for it.
    #[must_use]
    pub fn moves_unasked(&self) -> bool {
        let moved = self.focal_length_change.1.is_some_and(|std_devs| std_devs.abs() > MOVED);
        moved && self.worth() != Worth::EarnsItsKeep
    }
}

/// What each group of parameters is worth.
#[derive(Debug, Clone, PartialEq)]
pub struct ModelComparison {
    /// Number of folds that the frames were divided into.
    pub folds: usize,
    /// The error of each frame when it is left out of the calibration with all groups: the mean over its
    /// features of |r/σ|², with the weights and the loss of the calibration.
    pub errors: Vec<(u32, f64)>,
    /// [`Patterns::image`](crate::assessment::Patterns::image) with all groups.
    pub pattern: f64,
    /// Groups with free parameters.
    pub groups: Vec<WithoutGroup>,
    /// What could not be compared, and why.
    pub findings: Vec<Finding>,
}

impl ModelComparison {
    /// Mean of the errors of left-out frames.
    #[must_use]
    pub fn mean_error(&self) -> f64 {
        self.errors.iter().map(|e| e.1).sum::<f64>() / self.errors.len() as f64
    }
}

/// The camera with all parameters or without some, at its minimum, and the errors of left-out frames.
struct Model {
    minimum: Minimum,
    errors: Vec<(u32, f64)>,
}

/// What the models have in common.
struct Comparison<'a> {
    refit: Refit<'a>,
    frames: Vec<u32>,
    folds: usize,
    progress: &'a (dyn Fn() + Sync),
}

/// How often [`compare_models`] calls `progress`.
#[must_use]
pub fn comparison_steps(calibration: &Calibration, folds: usize) -> usize {
    let groups = free_groups(calibration).len();
    groups + (groups + 1) * folds
}

/// Calibrates without each group of parameters, and compares with the calibration by cross-validation: both are
/// repeated without the frames of a fold, and the poses of these are refined with the cameras fixed. Fold i of n
/// has the frames i, i + n and so on. Differences are paired by frame, because a frame has the same errors under
/// all models.
///
/// `progress` is called after every calibration. An error if the calibration has not converged, or has too few
/// frames, or none of the groups.
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

/// The groups with free parameters, and these.
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
            "exit pupil, field curvature and distortion are all fixed: there are no models to compare",
        ));
    }
    if !calibration.converged {
        return Err(Error::invalid(
            "models are not compared, since the calibration has not converged",
        ));
    }
    if frames < MIN_FRAMES {
        return Err(Error::invalid(format!(
            "models are not compared: {frames} frame(s) do not show what is accident; take {MIN_FRAMES} \
             or more"
        )));
    }
    if folds < 2 || folds > frames {
        return Err(Error::invalid(format!(
            "{frames} frames cannot be divided into {folds} folds: take two folds or more, and not more \
             than there are frames"
        )));
    }
    Ok(())
}
