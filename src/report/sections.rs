//! The sections of a run's report, one for each stage.

use super::assessment::{
    OBJECT_SPACE, anchors_table, object_space_table, outliers_text, verdict_lines,
};
use super::calibration::{errors_table, parameters_table, summary};
use super::detection::{detection_table, dropped_text};
use super::html::{Figure, HtmlTable, Part, Section};
use super::precalibration::{array_text, internal_table, levels_text, radii_table, types_text};
use crate::assessment::Assessment;
use crate::calibration::Calibration;
use crate::detection::DetectedBoards;
use crate::finding::Finding;
use crate::precalibration::Precalibration;

/// Number of frames whose figures are shown at once; the others are shown on demand.
const FRAMES_SHOWN: usize = 1;

fn paragraphs(text: &str) -> impl Iterator<Item = Part> {
    text.lines().map(str::trim).filter(|line| !line.is_empty()).map(|l| Part::Text(l.to_owned()))
}

fn texts(findings: &[Finding]) -> Vec<String> {
    findings.iter().map(ToString::to_string).collect()
}

fn warnings_part(warnings: &[String]) -> Option<Part> {
    (!warnings.is_empty()).then(|| Part::Details {
        summary: format!("{} warning(s)", warnings.len()),
        parts: warnings.iter().map(|warning| Part::Text(warning.clone())).collect(),
    })
}

/// Micro-image array, radii and internal parameters.
#[must_use]
pub fn precalibration_section(result: &Precalibration, figures: Vec<Figure>) -> Section {
    let mut parts: Vec<Part> = paragraphs(&array_text(&result.array)).collect();
    parts.extend(paragraphs(&types_text(&result.lens_types)));
    parts.extend(levels_text(result).map(Part::Text));
    parts.extend(warnings_part(&texts(&result.findings)));
    parts.push(Part::Table(
        internal_table(result).captioned("Internal parameters (paper, Table 2)"),
    ));
    parts.push(Part::Table(
        radii_table(result).captioned("Radii of the micro-images by f-number and lens type"),
    ));
    parts.extend(figures.into_iter().map(Part::Figure));
    Section { title: "Pre-calibration".to_owned(), parts, warnings: texts(&result.findings) }
}

/// The boards of a subset, frame by frame.
#[must_use]
pub fn detection_section(subset: &str, boards: &DetectedBoards, figures: Vec<Figure>) -> Section {
    let mut parts = Vec::new();
    parts.extend(warnings_part(&texts(&boards.findings)));
    parts.push(Part::Table(detection_table(&boards.frames).captioned("Frame by frame")));
    parts.extend(paragraphs(&dropped_text(&boards.frames)));
    let mut figures = figures.into_iter().map(Part::Figure);
    parts.extend(figures.by_ref().take(FRAMES_SHOWN));
    let others: Vec<Part> = figures.collect();
    if !others.is_empty() {
        parts.push(Part::Details { summary: "The other frames".to_owned(), parts: others });
    }
    Section { title: format!("Boards: {subset}"), parts, warnings: texts(&boards.findings) }
}

/// Parameters with their standard deviations, errors, and figures.
#[must_use]
pub fn calibration_section(
    title: &str,
    calibration: &Calibration,
    assessment: &Assessment,
    figures: Vec<Figure>,
) -> Section {
    let mut parts: Vec<Part> = verdict_lines(assessment).into_iter().map(Part::Text).collect();
    let warnings = texts(&calibration.findings);
    parts.extend(warnings_part(&warnings));
    parts.push(Part::Table(parameters_table(calibration).captioned("Parameters")));
    parts.extend(anchors_table(calibration).map(|t| {
        Part::Table(
            t.captioned("What was known, what came out, and how the observations pull on it"),
        )
    }));
    if let Some(space) = &assessment.object_space {
        parts.push(Part::Table(object_space_table(space).captioned(OBJECT_SPACE)));
    }
    parts.extend(outliers_text(assessment).into_iter().map(Part::Text));
    parts.extend(paragraphs(&summary(calibration)));
    parts.push(Part::Table(
        errors_table(calibration).captioned("Reprojection errors, px, root mean square"),
    ));
    parts.extend(figures.into_iter().map(Part::Figure));
    Section { title: title.to_owned(), parts, ..Section::default() }
}

/// Tables under a title.
#[must_use]
pub fn tables_section(title: &str, tables: Vec<HtmlTable>, texts: &[String]) -> Section {
    let texts = texts.iter().map(|text| Part::Text(text.clone()));
    let parts = tables.into_iter().map(Part::Table).chain(texts).collect();
    Section { title: title.to_owned(), parts, ..Section::default() }
}

impl Section {
    /// All figures of the section.
    pub fn figures_mut(&mut self) -> Vec<&mut Figure> {
        fn collect<'a>(parts: &'a mut [Part], figures: &mut Vec<&'a mut Figure>) {
            for part in parts {
                match part {
                    Part::Figure(figure) => figures.push(figure),
                    Part::Details { parts, .. } => collect(parts, figures),
                    Part::Text(_) | Part::Table(_) => {}
                }
            }
        }
        let mut figures = Vec::new();
        collect(&mut self.parts, &mut figures);
        figures
    }
}
