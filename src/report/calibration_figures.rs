//! Pictures of a calibration.

mod charts;
mod correlations;
mod distortion;
mod histograms;
mod scene;
mod vectors;

pub use vectors::array_residuals_figure;

use super::html::Figure;
use crate::calibration::Calibration;
use crate::error::Result;
use crate::model::Board;

/// All pictures that a calibration gives; those that it has nothing to show for are left out: without
/// centres their residuals, with the camera held its correlations, and so on.
pub fn calibration_figures(calibration: &Calibration, board: &Board) -> Result<Vec<Figure>> {
    let figures = [
        vectors::residual_vectors(calibration)?,
        histograms::residual_histograms(calibration)?,
        charts::rmse(calibration)?,
        vectors::center_residuals(calibration)?,
        correlations::correlations(calibration)?,
        charts::convergence(calibration)?,
        scene::scene(calibration, board)?,
        distortion::distortion(&calibration.camera)?,
    ];
    Ok(figures.into_iter().flatten().collect())
}

/// A figure by the parts of its name and caption.
fn figure(name: &str, caption: String, svg: String) -> Figure {
    Figure { name: format!("{name}.svg"), caption, svg }
}
