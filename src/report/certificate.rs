//! Certificate of a calibration, on one page to print.

use super::assessment::verdict_parts;
use super::summary::rmse_text;
use super::tree::{Cell, Column, Part, Section, Table};
use crate::assessment::{Assessment, BudgetLine, Source, uncertainty_budget};
use crate::calibration::Calibration;
use crate::finding::Finding;
use crate::model::{Board, Datasheet};
use crate::quantity::{counted, fixed};

/// Subject of a certificate.
#[derive(Debug, Clone, Copy)]
pub struct Certified<'a> {
    /// Name of the camera.
    pub camera: &'a str,
    /// Camera as the project states it.
    pub sheet: &'a Datasheet,
    /// Board of the calibration.
    pub board: &'a Board,
    /// Kinds of images with their number and the hash that identifies them.
    pub images: &'a [(String, usize, String)],
    /// Calibration.
    pub calibration: &'a Calibration,
    /// Its assessment.
    pub assessment: &'a Assessment,
    /// Findings of all stages, which determine the verdict.
    pub findings: &'a [Finding],
}

/// Largest number of reasons of the verdict.
const MOST_REASONS: usize = 3;

/// Returns the certificate of a calibration: verdict, camera, images, method, uncertainty budget and validity.
#[must_use]
pub fn certificate_section(of: &Certified) -> Section {
    let lines = uncertainty_budget(of.calibration, of.assessment.object_space.as_ref());
    let mut parts = verdict_parts(of.findings, MOST_REASONS);
    parts.push(Part::Table(subject_table(of)));
    parts.push(Part::Table(budget_table(&lines)));
    let shared = if of.calibration.uncertainty.shared {
        "Shared errors are the scatter of the frames beyond noise."
    } else {
        "Fewer than six frames do not determine the errors that their observations share; σ does not contain them."
    };
    parts.push(Part::Text(format!(
        "All σ are standard uncertainties (k = 1), due to all sources and to each; squares add up. Points have the \
         median σ over the image, against the boards, without the noise of their own observation. {shared} The shape of \
         the board, if estimated, is in all columns. σ does not contain a wrong size of the squares, which changes \
         all lengths in proportion."
    )));
    parts.push(Part::Text(validity_text(of)));
    Section::new("Certificate", parts)
}

/// Returns the table of camera, images and method.
fn subject_table(of: &Certified) -> Table {
    let (sheet, calibration) = (of.sheet, of.calibration);
    let (sensor, board) = (&sheet.sensor, of.board);
    let features = calibration.reprojection.features.len();
    let mut rows = vec![
        (
            "Camera".to_owned(),
            format!(
                "{}: {} × {} px of {} µm, {}",
                of.camera,
                sensor.width_px,
                sensor.height_px,
                fixed(sensor.pixel_size_mm * 1e3, 2),
                counted(calibration.camera.lens_types().max(1), "lens type")
            ),
        ),
        (
            "Main lens".to_owned(),
            format!(
                "F = {} mm as engraved, f/{}, focused at {}",
                sheet.focal_length_mm,
                fixed(sheet.f_number, 2),
                focus(sheet)
            ),
        ),
        (
            "Board".to_owned(),
            format!(
                "{} × {} corners, squares of {} mm",
                board.columns, board.rows, board.square_mm
            ),
        ),
    ];
    rows.extend(
        of.images
            .iter()
            .map(|(kind, count, hash)| (kind.clone(), format!("{count}, SHA-256 {hash}"))),
    );
    rows.push((
        "Method".to_owned(),
        format!(
            "least squares over {features} features of {} boards and {} centres of micro-images, with {} priors",
            calibration.poses.len(),
            calibration.reprojection.centers.len(),
            calibration.priors.len()
        ),
    ));
    rows.push(("Residuals (RMS)".to_owned(), rmse_text(&calibration.reprojection.rmse())));
    let mut table =
        Table::new("Camera, images and method", ["Subject", "Description"].map(Column::text));
    for (name, text) in rows {
        table.push([name.into(), text.into()]);
    }
    table
}

fn focus(sheet: &Datasheet) -> String {
    if sheet.focus_distance_mm.is_finite() {
        format!("{} mm", sheet.focus_distance_mm)
    } else {
        "infinity".to_owned()
    }
}

fn budget_table(lines: &[BudgetLine]) -> Table {
    let columns = ["Quantity", "Unit"].map(Column::text).into_iter();
    let numbers = ["Value", "± σ"].map(Column::number);
    let sources = Source::ALL.map(|source| Column::number(source.name()));
    let mut table = Table::new("Uncertainty budget", columns.chain(numbers).chain(sources));
    for line in lines {
        let row = [
            line.name.as_str().into(),
            line.unit.into(),
            line.value.map_or(Cell::empty(), |value| Cell::value(value, Some(line.std_dev))),
            Cell::two_digits(line.std_dev),
        ];
        let parts = line.parts.map(|part| match part {
            Some(part) if part > 0.0 => Cell::two_digits(part),
            Some(_) => Cell::fixed(0.0, 0),
            None => Cell::Missing,
        });
        table.push(row.into_iter().chain(parts));
    }
    table
}

/// Returns a text on the distances, the field, the focus and the aperture for which a calibration holds.
fn validity_text(of: &Certified) -> String {
    let (calibration, sheet) = (of.calibration, of.sheet);
    let middle = of.board.middle_mm();
    let range = |values: &mut dyn Iterator<Item = f64>| {
        values.fold([f64::INFINITY, f64::NEG_INFINITY], |[low, high], x| [low.min(x), high.max(x)])
    };
    let [near, far] =
        range(&mut calibration.poses.iter().map(|p| (p.camera_from_board * middle).z));
    let features = || calibration.reprojection.features.iter().map(|f| &f.feature);
    let [left, right] = range(&mut features().map(|f| f.u_px));
    let [top, bottom] = range(&mut features().map(|f| f.v_px));
    format!(
        "Valid for points at {near:.0} to {far:.0} mm from the main lens, the distances of the boards, that are seen \
         in u = {left:.0} to {right:.0} px and v = {top:.0} to {bottom:.0} px, where features were; with the main lens \
         at f/{}, focused at {}. Another focus, aperture, zoom or array needs a new calibration.",
        fixed(sheet.f_number, 2),
        focus(sheet)
    )
}
