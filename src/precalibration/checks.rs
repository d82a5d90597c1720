//! Checks whether white images belong together and to the stated camera, and findings for the user.

use super::disc_geometry::DiscGeometry;
use super::f_numbers::apart;
use super::grid::MicroImageArray;
use super::options::White;
use super::pattern::Pattern;
use super::radii::{REACH, profile_at};
use super::samples::Samples;
use crate::checks::whites as checks;
use crate::error::{Error, Result};
use crate::finding::{Finding, Issue};
use crate::image::Grey;
use crate::model::{Datasheet, InternalParameters, Sensor, positive};
use crate::quantity::counted;

/// Relative tolerance between stated and measured micro-image pitch. Both are known to a few parts in 10⁴, or to 10⁻³
/// if centres are not corrected for oblique light. A larger difference means different cameras.
const SAME_PITCH: f64 = 2e-3;

/// Returns an error that names the image.
pub(super) fn named(name: &str, error: &Error) -> Error {
    Error::invalid(format!("{name}: {error}"))
}

/// Returns the white image in which the array is measured. Returns an error unless all images belong together.
pub(super) fn reference_of<'a>(
    whites: &'a [White],
    reference: Option<&'a White>,
    stated: Option<&Datasheet>,
) -> Result<&'a White> {
    check_f_numbers(whites)?;
    let widest = whites.iter().min_by(|a, b| a.f_number.total_cmp(&b.f_number));
    let Some(reference) = reference.or(widest) else {
        return Err(Error::invalid("there are no white images"));
    };
    check_sizes(whites, reference)?;
    if let Some(Sensor { width_px, height_px, .. }) = stated.map(|sheet| sheet.sensor)
        && (reference.image.width, reference.image.height)
            != (width_px as usize, height_px as usize)
    {
        return Err(Error::invalid(format!(
            "{} has {} x {} px, but the sensor {width_px} x {height_px}: correct [sensor], or give \
             the image uncropped as the camera delivered it",
            reference.name, reference.image.width, reference.image.height
        )));
    }
    Ok(reference)
}

/// Returns findings about white images whose colour is not the stated one.
pub(super) fn doubtful_colors(whites: &[White]) -> Vec<Finding> {
    let doubt = |white: &White| {
        Some(Finding::caution(white.image.doubtful_color()?).about_image(&white.name))
    };
    whites.iter().filter_map(doubt).collect()
}

fn check_f_numbers(whites: &[White]) -> Result<()> {
    for white in whites {
        positive(white.f_number, &format!("the f-number of {}", white.name))?;
    }
    let mut numbers: Vec<f64> = whites.iter().map(|white| white.f_number).collect();
    numbers.sort_by(f64::total_cmp);
    numbers.dedup();
    if numbers.len() < 2 {
        return Err(Error::invalid(format!(
            "there are white images at {}, but the internal parameters need at least two, better \
             five: stop the main lens down between them",
            counted(numbers.len(), "f-number")
        )));
    }
    Ok(())
}

fn check_sizes(whites: &[White], reference: &White) -> Result<()> {
    let size = |white: &White| (white.image.width, white.image.height);
    match whites.iter().find(|white| size(white) != size(reference)) {
        Some(white) => Err(Error::invalid(format!(
            "{} has {} x {} px, but {} has {} x {} px: give white images of one camera",
            white.name,
            white.image.width,
            white.image.height,
            reference.name,
            reference.image.width,
            reference.image.height
        ))),
        None => Ok(()),
    }
}

/// Returns an error if the camera's file or the internal parameters state another micro-image pitch Δc than the centres
/// have.
pub fn check_stated_pitch(
    sheet: &Datasheet,
    internal: &InternalParameters,
    grid: &MicroImageArray,
) -> Result<()> {
    let of_internal = internal.micro_image_pitch_mm.map(|mm| mm / sheet.sensor.pixel_size_mm);
    for (stated, whose) in [
        (sheet.micro_image_pitch_px, "the camera is stated to have"),
        (of_internal, "the internal parameters state"),
    ] {
        if let Some(stated) = stated
            && (stated / grid.pitch_px - 1.0).abs() > SAME_PITCH
        {
            return Err(Error::invalid(format!(
                "{whose} a micro-image pitch of {stated:.4} px, but the centres have a pitch of \
                 {:.4} px: they are of different cameras, or the pixel size is wrong",
                grid.pitch_px
            )));
        }
    }
    Ok(())
}

/// Outer radius of micro-images of type 1 in the reference, as measured and as expected at its f-number.
pub(super) struct ReferenceRadius {
    radius_px: f64,
    /// Radius a of the pupil, and blur radius |φqᵢ|, px.
    expected_px: (f64, f64),
}

impl ReferenceRadius {
    /// Measures the radius; `None` if micro-images in the middle of the image are not complete.
    pub fn measure(
        grey: &Grey,
        geometry: &DiscGeometry,
        samples: &Samples,
        pattern: &Pattern,
    ) -> Option<Self> {
        let (middle, pattern) = samples.middle_of(grey, pattern);
        let profile = profile_at((&middle, grey.floor()), &pattern, samples.nodes.first()?);
        let fit = profile.fit(
            REACH * pattern.pitch(),
            geometry.point_spread_px2(),
            geometry.opening(),
            None,
        )?;
        Some(Self { radius_px: fit.outer, expected_px: geometry.radii(0) })
    }

    /// Returns a finding if both the measured and the expected radius exceed half the pitch, and the f-number from which on
    /// micro-images do not overlap. If the stated f-number is too small, only the expected radius does.
    pub fn overlapping(
        &self,
        f_number: f64,
        geometry: &DiscGeometry,
        half_pitch_px: f64,
    ) -> Option<(Issue, f64)> {
        let ((pupil, blur), widest) = (self.expected_px, geometry.widest_blur_px());
        let part = (pupil + widest) / half_pitch_px - 1.0;
        let least = part.min((self.radius_px + widest - blur) / half_pitch_px - 1.0);
        let apart = apart(f_number * pupil, widest, half_pitch_px)?;
        let issue = Issue::MicroImagesOverlap { f_number, apart, part };
        (least > checks::TOUCHING).then_some((issue, apart))
    }

    /// Returns a finding if micro-images do not have the size of the f-number.
    pub fn different_aperture(&self, reference: &White) -> Option<Finding> {
        let (pupil, blur) = self.expected_px;
        let looks_like = reference.f_number * pupil / (self.radius_px - blur);
        checks::aperture(reference.f_number, self.radius_px, pupil + blur, looks_like)
            .map(|finding| finding.about_image(&reference.name))
    }
}
