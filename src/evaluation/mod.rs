//! How good a calibration is: reprojection errors, the uncertainty of the parameters, known
//! displacements, cross-validation, what groups of parameters are worth, and cameras, poses and features against the truth.

pub mod bias;
mod comparison;
mod cross_validation;
mod detection;
mod models;
mod reconstruction;
mod stage;
mod translation;
mod truth;

pub use comparison::{
    CameraComparison, DistanceDifference, ParameterPair, WithStdDevs, compare_cameras,
};
pub use cross_validation::{CrossValidation, Fold, cross_validate, foldable_frames};
pub use detection::{DetectionScore, INSIDE_PX, SMALL_RHO_PX, TRUE_PX};
pub use models::{Group, ModelComparison, WithoutGroup, Worth, compare_models, comparison_steps};
pub use reconstruction::Reconstruction;
pub use stage::{
    Candidate, CandidateResult, Evaluation, EvaluationInput, Folds, PosePairs, Posed, evaluate,
    pose_boards,
};
pub use translation::{Displacement, Displacements, Spread, StepDoubt};
pub use truth::{ParameterError, PoseErrors, parameter_errors, pose_errors, shape_errors};
