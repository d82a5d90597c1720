//! The quality of a calibration.
//!
//! [`assess`] judges it by itself: whether it can be trusted, its σ in space, and the board that would improve it most.
//! [`evaluate`] judges it by other data: reprojection errors on boards that were not used, known displacements,
//! cross-validation, and true cameras and poses. [`compare_models`] judges groups of parameters, [`DetectionScore`] features.

pub mod bias;
mod budget;
mod camera_comparison;
mod camera_in_use;
mod cross_validation;
mod detection_score;
mod evaluation;
mod held_out_boards;
mod model_comparison;
mod next_board;
mod object_space;
mod outliers;
mod patterns;
mod reconstruction;
mod stage;
mod translation;
mod truth;
mod verdict;

pub use crate::checks::camera::DistanceCheck;
pub use budget::{BudgetLine, Source, uncertainty_budget};
pub use camera_comparison::{
    CameraComparison, DistanceDifference, ParameterPair, WithStdDevs, compare_cameras,
};
pub use camera_in_use::{check_camera, check_corners, check_places, check_virtual_points};
pub use cross_validation::{CrossValidation, Fold, cross_validate, foldable_frames};
pub use detection_score::{DetectionScore, INSIDE_PX, SMALL_RHO_PX, TRUE_PX};
pub use evaluation::{
    Candidate, CandidateResult, Evaluation, EvaluationInput, Folds, PosePairs, evaluate,
};
pub use held_out_boards::{Posed, pose_boards};
pub use model_comparison::{
    Group, ModelComparison, WithoutGroup, Worth, compare_models, comparison_steps,
};
pub use next_board::NextBoard;
pub use object_space::{Distance, ObjectSpace, PointTrust};
pub use outliers::{Influence, Outliers, OutlyingFrame};
pub use patterns::{Patterns, image_pattern};
pub use reconstruction::Reconstruction;
pub use stage::{Assessment, assess};
pub use translation::{Displacement, Displacements, Spread};
pub use truth::{ParameterError, PoseErrors, parameter_errors, pose_errors, shape_errors};
pub use verdict::Verdict;
