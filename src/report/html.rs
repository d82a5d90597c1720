//! A report as one HTML file.

use serde::{Deserialize, Serialize};

/// A report.
#[derive(Debug, Clone, PartialEq)]
pub struct HtmlReport {
    /// Title.
    pub title: String,
    /// What stands below it.
    pub subtitle: String,
    /// Sections.
    pub sections: Vec<Section>,
}

/// A section of a report.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Section {
    /// Title.
    pub title: String,
    /// What it consists of.
    pub parts: Vec<Part>,
}

/// A part of a section.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Part {
    /// A paragraph.
    Text(String),
    /// A table.
    Table(HtmlTable),
    /// A picture.
    Figure(Figure),
    /// What is shown on demand.
    Details {
        /// What stands for it.
        summary: String,
        /// What it consists of.
        parts: Vec<Part>,
    },
}

/// A table.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct HtmlTable {
    /// Caption.
    pub caption: String,
    /// Names of the columns.
    pub header: Vec<String>,
    /// Cells by row.
    pub rows: Vec<Vec<String>>,
    /// Columns of words; the others hold numbers.
    pub text_columns: Vec<usize>,
}

/// A picture.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct Figure {
    /// Name of its file.
    pub name: String,
    /// Caption.
    pub caption: String,
    /// SVG; not part of a file that names the picture.
    #[serde(skip)]
    pub svg: String,
}

impl HtmlReport {
    /// The file.
    #[must_use]
    pub fn to_html(&self) -> String {
        self.title.clone()
    }
}

/// Stub.
pub fn calibration_figures(
    _: &crate::calibration::Calibration,
    _: &crate::camera::Board,
) -> crate::Result<Vec<Figure>> {
    Ok(Vec::new())
}

/// Stub.
pub fn array_residuals_figure(
    _: &crate::precalibration::ArrayMeasurement,
) -> crate::Result<Figure> {
    Ok(Figure {
        name: "array-residuals.svg".to_owned(),
        caption: String::new(),
        svg: String::new(),
    })
}
