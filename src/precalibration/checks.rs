//! Whether white images belong together and to the camera that is stated, and what the user should know.

use super::array::LensTypes;
use super::disc_geometry::DiscGeometry;
use super::grid::MicroImageArray;
use super::options::White;
use super::pattern::Pattern;
use super::radii::{REACH, profile_at};
use super::samples::Samples;
use crate::error::{Error, Result};
use crate::image::Grey;
use crate::model::{Datasheet, InternalParameters, Sensor, positive};

/// A radius this part away from that of its f-number is the sign of another one: half a stop at f/4 changes a
/// radius by 10 %.
const CONTRADICTION: f64 = 0.05;
/// Stated and measured pitch of the micro-images agree within this part. Both are known to a few parts in
/// 10⁴, or to 10⁻³ where centres are not corrected for oblique light; beyond that they are of different
/// cameras.
const SAME_PITCH: f64 = 2e-3;
/// Part of the micro-images that agrees with its lens type where nothing is wrong.
const AGREEMENT: f64 = 0.9;

/// An error that names the image.
pub(super) fn named(name: &str, error: &Error) -> Error {
    Error::invalid(format!("{name}: {error}"))
}

/// The white image that the array is measured in; an error unless all of them belong together.
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

/// White images whose colour is not what is stated.
pub(super) fn doubtful_colors(whites: &[White]) -> Vec<String> {
    let doubt = |white: &White| Some(format!("{}: {}", white.name, white.image.doubtful_color()?));
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
            "there are white images at {} f-number(s), but the internal parameters take at least \
             two, better five: stop the main lens down between them",
            numbers.len()
        )));
    }
    Ok(())
}

fn check_sizes(whites: &[White], reference: &White) -> Result<()> {
    let size = |white: &White| (white.image.width, white.image.height);
    match whites.iter().find(|white| size(white) != size(reference)) {
        Some(white) => Err(Error::invalid(format!(
            "{} has {} x {} px, but {} has {} x {} px: all white images have to be of one camera",
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

/// An error if the camera's file or the internal parameters state another pitch Δc of the micro-images
/// than their centres have.
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
                "{whose} a micro-image pitch of {stated:.4} px, but the centres have one of {:.4} \
                 px: they are of different cameras, or the pixel size is wrong",
                grid.pitch_px
            )));
        }
    }
    Ok(())
}

/// A warning if the micro-images of the reference do not have the size of its f-number.
pub(super) fn different_aperture(
    (reference, grey): (&White, &Grey),
    levers: &DiscGeometry,
    samples: &Samples,
    pattern: &Pattern,
) -> Option<String> {
    let (middle, pattern) = samples.middle_of(grey, pattern);
    let profile = profile_at((&middle, grey.floor()), &pattern, samples.nodes.first()?);
    let (a, b) = levers.radii(0);
    let radius = profile.fit(REACH * pattern.pitch(), levers.pixel())?.outer;
    let looks_like = reference.f_number * a / (radius - b);
    ((radius / (a + b) - 1.0).abs() > CONTRADICTION).then(|| {
        format!(
            "{}: at f/{:.2} micro-images of type 1 should have a radius of {:.2} px, but have \
             {radius:.2} px: it was taken at about f/{looks_like:.2}. Check the f-number of the main lens \
             (f_number), which is that of this image and of the boards",
            reference.name,
            reference.f_number,
            a + b
        )
    })
}

/// A warning of lens types that do not follow the lattice.
pub(super) fn disagreeing_types(lens_types: &LensTypes) -> Option<String> {
    let agreement = lens_types.agreement.filter(|agreement| *agreement < AGREEMENT)?;
    Some(format!(
        "only {:.0} % of the micro-images have the size of their lens type: the image is noisy, \
         not white, or the types do not follow the lattice",
        100.0 * agreement
    ))
}
