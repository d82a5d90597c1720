//! Figures.

mod blur;
mod charts;
mod correlations;
mod distortion;
mod features;
mod histograms;
mod models;
mod object_space;
mod scene;
mod vectors;
mod white_images;

pub(super) use features::board_lines;
pub use features::features_figure;
pub use models::model_figures;
pub use vectors::{array_residuals_figure, comparison_figures};
pub use white_images::{micro_images_figure, precalibration_figures, radii_figure};

use super::tree::Figure;
use crate::assessment::Assessment;
use crate::calibration::Calibration;
use crate::error::Result;
use crate::model::Board;

/// File names of the figures that are shown beside a result: the scene, and σ in space.
pub const OF_RESULT: [&str; 2] = ["scene.svg", "object-space.svg"];

/// File names of the figures of residuals.
pub const OF_RESIDUALS: [&str; 4] =
    ["residual-vectors.svg", "residual-histograms.svg", "rmse.svg", "center-residuals.svg"];

/// Draws all figures of a calibration. Figures with nothing to show are left out: residuals of centres if
/// there are no centres, correlations if the camera is fixed, and so on.
pub fn calibration_figures(
    calibration: &Calibration,
    assessment: &Assessment,
    board: &Board,
) -> Result<Vec<Figure>> {
    let figures = [
        assessment.object_space.as_ref().and_then(object_space::object_space),
        vectors::residual_vectors(calibration),
        histograms::residual_histograms(calibration),
        charts::rmse(calibration),
        blur::measured_blur(calibration),
        vectors::center_residuals(calibration),
        correlations::correlations(calibration),
        charts::convergence(calibration),
        scene::scene(calibration, board),
        distortion::distortion(&calibration.camera)?,
    ];
    Ok(figures.into_iter().flatten().collect())
}
