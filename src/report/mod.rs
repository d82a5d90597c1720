//! Results for people: tables, text, figures, and the report of a run.

mod assessment;
mod board;
mod calibration;
mod calibration_figures;
mod common_errors;
mod comparison;
mod cost;
mod detection;
mod drawing;
mod evaluation;
mod figures;
mod fill_factor;
mod html;
mod models;
mod precalibration;
mod sections;
mod table;

pub use assessment::{outliers_text, verdict_lines, verdict_section};
pub use calibration::calibration_text;
pub use calibration_figures::{array_residuals_figure, calibration_figures, model_figures};
pub use comparison::{comparison_pictures, comparison_text};
pub use cost::cost_text;
pub use detection::{detection_text, features_figure};
pub use evaluation::{cameras_table, evaluation_tables, truth_table};
pub use figures::{micro_images_figure, radii_figure};
pub use html::{Figure, HtmlReport, HtmlTable, Part, Section};
pub use models::{MODELS, models_parts, models_text};
pub use precalibration::{array_text, precalibration_text, types_text};
pub use sections::{
    calibration_section, detection_section, precalibration_section, tables_section,
};
