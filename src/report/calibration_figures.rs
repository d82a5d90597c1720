//! Figures of a calibration.

mod blur;
mod charts;
mod correlations;
mod distortion;
mod histograms;
mod models;
mod object_space;
mod scene;
mod vectors;

pub use models::model_figures;
pub use vectors::array_residuals_figure;
pub(super) use vectors::shifts_picture;

use super::html::Figure;
use crate::assessment::Assessment;
use crate::calibration::Calibration;
use crate::error::Result;
use crate::model::Board;

/// All figures of a calibration. Those with nothing to show are left out: residuals of centres if
/// there are no centres, correlations if the camera is fixed, and so on.
pub fn calibration_figures(
    calibration: &Calibration,
    assessment: &Assessment,
    board: &Board,
) -> Result<Vec<Figure>> {
    let space = assessment.object_space.as_ref().map(object_space::object_space).transpose()?;
    let figures = [
        space.flatten(),
        vectors::residual_vectors(calibration)?,
        histograms::residual_histograms(calibration)?,
        charts::rmse(calibration)?,
        blur::measured_blur(calibration)?,
        vectors::center_residuals(calibration)?,
        correlations::correlations(calibration)?,
        charts::convergence(calibration)?,
        scene::scene(calibration, board)?,
        distortion::distortion(&calibration.camera)?,
    ];
    Ok(figures.into_iter().flatten().collect())
}

/// A figure; `name` is without the extension.
fn figure(name: &str, caption: String, svg: String) -> Figure {
    Figure { name: format!("{name}.svg"), caption, svg }
}
