//! Results for people: a report as data, made from results, shown on a terminal, as a page, or as JSON; and its figures.

mod assessment;
mod calibration;
mod certificate;
mod comparison;
mod cost;
mod detection;
mod drawing;
mod evaluation;
mod figures;
mod html;
mod models;
mod photograph;
mod pictures;
mod precalibration;
mod summary;
mod text;
mod tree;

pub use assessment::result_section;
pub use calibration::calibration_section;
pub use certificate::{Certified, certificate_section};
pub use comparison::comparison_section;
pub use cost::cost_section;
pub use detection::detection_section;
pub use evaluation::{cameras_table, evaluation_section, truth_table};
pub use figures::{
    OF_RESIDUALS, OF_RESULT, array_residuals_figure, calibration_figures, comparison_figures,
    features_figure, micro_images_figure, model_figures, precalibration_figures, radii_figure,
};
pub use models::{MODELS, models_parts};
pub use photograph::Photograph;
pub use pictures::{Picture, PictureSource, pictures_part};
pub use precalibration::{array_text, precalibration_section, types_text};
pub use tree::{Cell, Column, Figure, Part, Question, Report, Section, Table, sentence};
