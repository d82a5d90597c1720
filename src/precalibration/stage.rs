//! The pre-calibration as one stage: from white images to the array and the internal parameters.

use nalgebra::Vector2;
use rayon::prelude::*;
use tracing::{debug, info, trace};

use super::array::{ArrayMeasurement, FoundArray, fit_found, fit_found_regular, found_array};
use super::centers::{Blob, measure_sample, part_with};
use super::grid::MicroImageArray;
use super::internal::{InternalFit, RadiusMeasurement, fit_internal};
use super::pattern::Pattern;
use super::profile::Profile;
use super::radii::{REACH, RadiusEstimator, TypeRadius, middle_nodes, profile_at, radius_at};
use super::shading::{Shaded, fit_shading, shading_moment};
use super::types::{LensTypes, judge_types};
use crate::error::{Error, Result};
use crate::image::{Grey, Image, RawImage};
use crate::model::{
    Configuration, Datasheet, InternalParameters, LatticeKind, MicroImageCenter, optics, positive,
};
use crate::vignetting::Obliquity;

/// A white image.
#[derive(Debug, Clone, PartialEq)]
pub struct White {
    /// What messages call it.
    pub name: String,
    /// F-number N, as it is: √(2^AV).
    pub f_number: f64,
    /// The image as the camera delivered it, its samples linear in light.
    pub image: RawImage,
}

/// Options of the pre-calibration.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PrecalibrationOptions {
    /// Edge of a pixel s, mm.
    pub pixel_size_mm: f64,
    /// Decides on the sign of the radii.
    pub configuration: Configuration,
    /// Number of columns and rows of micro-lenses, where it is stated.
    pub array_size: Option<(i32, i32)>,
    /// How radii are measured.
    pub estimator: RadiusEstimator,
    /// Focal length F and focus distance h of the main lens as its scale has them, mm: they give the
    /// distance of the array, and so the angles of the light.
    pub lens_mm: (f64, f64),
}

impl PrecalibrationOptions {
    /// For a camera as its data sheet has it.
    #[must_use]
    pub fn of_datasheet(sheet: &Datasheet) -> Self {
        Self {
            pixel_size_mm: sheet.sensor.pixel_size_mm,
            configuration: sheet.configuration,
            array_size: Some((sheet.columns, sheet.rows)),
            estimator: RadiusEstimator::default(),
            lens_mm: (sheet.focal_length_mm, sheet.focus_distance_mm),
        }
    }

    /// Angles of the light in the middle of the image, for a slope m of the radii.
    fn obliquity(&self, m_mm: f64, pitch_px: f64) -> Obliquity {
        let (focal_length, focus_distance) = self.lens_mm;
        let image_distance = optics::focus_image_distance(focal_length, focus_distance);
        let (_, mla_to_sensor) =
            optics::initial_distances(focal_length, image_distance, m_mm, self.configuration);
        Obliquity {
            chief: Vector2::zeros(),
            inverse_distance: self.pixel_size_mm / mla_to_sensor,
            lens_px: pitch_px / 2.0,
        }
    }
}

/// What white images tell of a camera.
#[derive(Debug, Clone, PartialEq)]
pub struct Precalibration {
    /// The micro-image array, centres free of shading.
    pub array: ArrayMeasurement,
    /// Lens types.
    pub lens_types: LensTypes,
    /// Radii by f-number and lens type.
    pub radii: Vec<RadiusMeasurement>,
    /// The internal parameters.
    pub internal: InternalFit,
    /// Relative change of the pitch that shading made, and was taken back.
    pub pitch_correction: f64,
    /// What the user should know, in words.
    pub warnings: Vec<String>,
}

/// Patterns of one camera at two f-numbers agree in pitch within this part, and in place within so
/// many pitches: shading changes both by less.
const SAME_PITCH: f64 = 1e-3;
const SAME_PLACE: f64 = 0.25;
/// A radius this part away from where the other f-numbers put it speaks of a wrong f-number: half a
/// stop at f/4 changes a radius by 10 %.
const CONTRADICTION: f64 = 0.05;
/// Where the others make straight lines far better than this one fits them, so many times, this part is
/// enough: f/9 for f/8.
const NOTICEABLE: f64 = 0.01;
const OUT_OF_LINE: f64 = 8.0;
/// The others say how straight lines are if there are more than three of them.
const FEWEST_TO_JUDGE: usize = 4;
/// A stated pitch is right within this part.
const STATED_PITCH: f64 = 2e-3;
/// Share of micro-images that agrees with the colouring where nothing is wrong.
const AGREEMENT: f64 = 0.9;

/// Measures array and internal parameters.
///
/// The array is that of `reference`, the white image that belongs to the boards, or else of the
/// white image with the smallest f-number. `progress` is told of every finished image. An error if
/// images do not belong together, show no array, or do not span a range of f-numbers.
pub fn precalibrate(
    whites: &[White],
    reference: Option<&White>,
    options: &PrecalibrationOptions,
    progress: &(dyn Fn() + Sync),
) -> Result<Precalibration> {
    let _span = tracing::info_span!("pre-calibration").entered();
    positive(options.pixel_size_mm, "the pixel size (mm)")?;
    check_f_numbers(whites)?;
    let widest = whites.iter().min_by(|a, b| a.f_number.total_cmp(&b.f_number));
    let Some(reference) = reference.or(widest) else {
        return Err(Error::invalid("there are no white images"));
    };
    check_sizes(whites, reference)?;
    let grey = reference.image.grey();
    let found = found_array(&grey, options.array_size).map_err(|e| named(&reference.name, &e))?;
    debug!(
        "{}: a '{}' lattice with a pitch of {:.4} px, {} centres measured",
        reference.name,
        found.pattern.kind.name(),
        found.pattern.pitch(),
        found.array.centers.len()
    );
    let colors = if found.pattern.kind == LatticeKind::Orthogonal { 1 } else { 3 };
    let nodes = middle_nodes(&found, grey.size(), colors);
    let samples = whites
        .par_iter()
        .map(|white| sample(white, reference, &found, &nodes).inspect(|_| progress()))
        .collect::<Result<Vec<Sample>>>()?;

    let by_profile = all_radii(whites, &samples, &nodes, RadiusEstimator::Profile)?;
    let lens_types = judge_types(&by_profile, &found);
    let (nodes, by_profile) = if lens_types.types == colors {
        (nodes, by_profile)
    } else {
        let all = vec![nodes.concat()];
        let radii = all_radii(whites, &samples, &all, RadiusEstimator::Profile)?;
        (all, radii)
    };

    // Shading takes the true sizes of the discs, whatever estimator is asked for.
    let fit = |radii: &mut [RadiusMeasurement], pitch_px: f64| {
        let (types, pixel) = (lens_types.types, options.pixel_size_mm);
        let fitted = fit_internal(radii, types, pixel, pitch_px, options.configuration);
        let fitted = fitted.ok_or_else(|| {
            Error::invalid(
                "the f-numbers of the white images are too close to each other for a straight line: \
                 take them a stop or more apart",
            )
        })?;
        if fitted.parameters.m_mm <= 0.0 {
            return Err(Error::invalid(
                "micro-images do not grow as the f-number falls: the f-numbers do not belong to \
                 these images, or the lens was not set by them",
            ));
        }
        Ok(fitted)
    };
    let pitch_px = found.array.grid.pitch_px;
    let first = fit(&mut measurements(whites, &by_profile), pitch_px)?;
    let by_profile = seen_obliquely(whites, &by_profile, &first.parameters, pitch_px, options);
    let first = fit(&mut measurements(whites, &by_profile), pitch_px)?;
    let (middle, there) = middle_of(&grey, &found.pattern, &nodes);
    let of_reference: Vec<Profile> =
        nodes.par_iter().map(|nodes| profile_at(&middle, &there, nodes)).collect();
    let moments = Moments { internal: &first.parameters, grid: &found.array.grid, options };
    let of_images: Vec<Vec<f64>> = whites
        .par_iter()
        .zip(&by_profile)
        .map(|(white, radii)| moments.of_image(white.f_number, radii.iter().map(|r| &r.profile)))
        .collect();
    let other_stop = moments.contradicted_by(reference, &of_reference);
    let of_reference = moments.of_image(reference.f_number, &of_reference);
    let (array, pitch_correction) = unshaded(&found, whites, &samples, &of_images, &of_reference)?;

    let mut radii = match options.estimator {
        RadiusEstimator::Profile => measurements(whites, &by_profile),
        RadiusEstimator::Moments => {
            let by_moments = all_radii(whites, &samples, &nodes, RadiusEstimator::Moments)?;
            measurements(whites, &by_moments)
        }
    };
    let internal = fit(&mut radii, array.grid.pitch_px)?;
    info!(
        "{} centres, {:.3} px RMS about a grid of {} x {} with a pitch of {:.5} px; {} lens type(s)",
        array.centers.len(),
        array.grid.rms_px,
        array.grid.lattice.columns,
        array.grid.lattice.rows,
        array.grid.pitch_px,
        lens_types.types
    );
    info!(
        "|m| = {:.6} mm, q' = {:.6?} mm; radii {:.4} px RMS about the lines",
        internal.parameters.m_mm, internal.parameters.q_prime_mm, internal.rms_px
    );
    let mut warnings = contradictions(whites, &radii, lens_types.types, options);
    warnings.extend(other_stop);
    if let Some(agreement) = lens_types.agreement
        && agreement < AGREEMENT
    {
        warnings.push(format!(
            "only {:.0} % of the micro-images have the size of their lens type: the image is noisy, \
             not white, or the types do not follow the lattice",
            100.0 * agreement
        ));
    }
    Ok(Precalibration { array, lens_types, radii, internal, pitch_correction, warnings })
}

impl Precalibration {
    /// Radii by lens type in one of the white images, px.
    ///
    /// # Panics
    /// If there were fewer white images.
    #[must_use]
    pub fn radii_px(&self, white: usize) -> Vec<f64> {
        let types = self.lens_types.types;
        self.radii[white * types..(white + 1) * types].iter().map(|r| r.radius_px).collect()
    }

    /// An error naming both values where the images contradict what is stated of the camera.
    pub fn check_stated(&self, sheet: &Datasheet) -> Result<()> {
        let grid = &self.array.grid;
        if grid.lattice.kind() != sheet.lattice_kind {
            return Err(Error::invalid(format!(
                "the micro-images lie on a '{}' lattice, but the camera is said to have a '{}' one: \
                 correct the one, or give the images of that camera",
                grid.lattice.kind().name(),
                sheet.lattice_kind.name()
            )));
        }
        if let Some(pitch) = sheet.micro_image_pitch_px
            && (grid.pitch_px / pitch - 1.0).abs() > STATED_PITCH
        {
            return Err(Error::invalid(format!(
                "the micro-images have a pitch of {:.4} px, but the camera is said to have one of \
                 {pitch} px: correct the one, or give the images of that camera",
                grid.pitch_px
            )));
        }
        let types = self.lens_types.types;
        // Pinholes have no lens types that could show.
        if sheet.lens_types > 0 && types != sheet.lens_types {
            return Err(Error::invalid(format!(
                "{types} lens type(s) show in the white images, but the camera is said to have {}: \
                 correct the one, or take sharper white images",
                sheet.lens_types
            )));
        }
        Ok(())
    }
}

fn named(name: &str, error: &Error) -> Error {
    Error::invalid(format!("{name}: {error}"))
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
            "there are white images at {} f-number(s), but the internal parameters take two at \
             least, better five: stop the main lens down between them",
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

/// What is looked at of a white image.
struct Sample {
    /// Micro-images from all over it.
    blobs: Vec<Blob>,
    /// Its middle, where radii are measured, and the pattern there.
    middle: Image,
    pattern: Pattern,
}

/// Measures a sample of a white image where the reference has micro-images; an error if it has them
/// elsewhere. `nodes` are those of the middle.
fn sample(
    white: &White,
    reference: &White,
    found: &FoundArray,
    nodes: &[Vec<(i32, i32)>],
) -> Result<Sample> {
    let grey = white.image.grey();
    let pattern = &found.pattern;
    let of_array: Vec<(i32, i32)> = found.blobs.iter().map(|blob| blob.node).collect();
    let (followed, blobs) = measure_sample(&grey, pattern, &of_array).ok_or_else(|| {
        Error::invalid(format!(
            "{}: no micro-images show where {} has them",
            white.name, reference.name
        ))
    })?;
    let pitch = pattern.pitch();
    let moved = (followed.origin - pattern.origin).norm() / pitch;
    if (followed.pitch() / pitch - 1.0).abs() > SAME_PITCH || moved > SAME_PLACE {
        return Err(Error::invalid(format!(
            "{} has a pitch of {:.3} px, but {} one of {pitch:.3} px, {moved:.2} of it elsewhere: \
             they are of different cameras, or one is no white image",
            white.name,
            followed.pitch(),
            reference.name
        )));
    }
    trace!("{}: pitch {:.5} px, {} micro-images", white.name, followed.pitch(), blobs.len());
    let (middle, pattern) = middle_of(&grey, &followed, nodes);
    Ok(Sample { blobs, middle, pattern })
}

/// The part of an image that holds some nodes, and the pattern there.
fn middle_of(grey: &Grey, pattern: &Pattern, nodes: &[Vec<(i32, i32)>]) -> (Image, Pattern) {
    let places = nodes.iter().flatten().map(|&(i, j)| pattern.place(i, j));
    let (part, corner) = part_with(grey, places, 2.0 * pattern.pitch());
    (part, pattern.seen_from(&corner))
}

/// Radii by image and by group of nodes.
fn all_radii(
    whites: &[White],
    samples: &[Sample],
    nodes: &[Vec<(i32, i32)>],
    estimator: RadiusEstimator,
) -> Result<Vec<Vec<TypeRadius>>> {
    let of_white = |(white, sample): (&White, &Sample)| {
        let radius = |nodes: &Vec<(i32, i32)>| {
            radius_at(&sample.middle, &sample.pattern, nodes, estimator).ok_or_else(|| {
                Error::invalid(format!(
                    "{}: the micro-images in the middle show no edge: the image is too dark, or \
                     saturated all over",
                    white.name
                ))
            })
        };
        nodes.iter().map(radius).collect()
    };
    whites.par_iter().zip(samples).map(of_white).collect()
}

/// The radii once more, now that it is known how obliquely the light of the profiles came.
fn seen_obliquely(
    whites: &[White],
    radii: &[Vec<TypeRadius>],
    internal: &InternalParameters,
    pitch_px: f64,
    options: &PrecalibrationOptions,
) -> Vec<Vec<TypeRadius>> {
    let obliquity = options.obliquity(internal.m_mm, pitch_px);
    let pixel = options.pixel_size_mm;
    let of_white = |(white, radii): (&White, &Vec<TypeRadius>)| {
        let pupil_px = internal.m_mm / white.f_number / pixel;
        let again = |(radius, q_prime): (&TypeRadius, &f64)| {
            radius.seen_obliquely(pupil_px, q_prime / pixel - pitch_px / 2.0, &obliquity)
        };
        radii.iter().zip(&internal.q_prime_mm).map(again).collect()
    };
    whites.par_iter().zip(radii).map(of_white).collect()
}

fn measurements(whites: &[White], radii: &[Vec<TypeRadius>]) -> Vec<RadiusMeasurement> {
    let of_white = |(white, radii): (&White, &Vec<TypeRadius>)| {
        let measurement = |(lens_type, r): (usize, &TypeRadius)| RadiusMeasurement {
            f_number: white.f_number,
            lens_type,
            radius_px: r.radius_px,
            std_dev_px: r.std_dev_px,
            residual_px: 0.0,
            single_px: r.single_px.clone(),
        };
        radii.iter().enumerate().map(measurement).collect::<Vec<_>>()
    };
    whites.iter().zip(radii).flat_map(of_white).collect()
}

/// What the moments of shading follow from.
struct Moments<'a> {
    internal: &'a InternalParameters,
    grid: &'a MicroImageArray,
    options: &'a PrecalibrationOptions,
}

impl Moments<'_> {
    /// Radii of the pupil's image and of its blur, px.
    fn discs(&self, f_number: f64, q_prime_mm: f64) -> (f64, f64) {
        let pixel = self.options.pixel_size_mm;
        let blur = q_prime_mm / pixel - self.grid.pitch_px / 2.0;
        (self.internal.m_mm / f_number / pixel, blur.abs())
    }

    /// What is wrong with the reference if its micro-images do not have the size of its f-number.
    fn contradicted_by(&self, reference: &White, profiles: &[Profile]) -> Option<String> {
        let measured =
            |profile: &Profile| profile.fit(REACH * self.grid.pitch_px).map(|discs| discs.outer);
        let (profile, q_prime) = (profiles.first()?, self.internal.q_prime_mm.first()?);
        let (a, b) = self.discs(reference.f_number, *q_prime);
        let radius = measured(profile)?;
        ((radius / (a + b) - 1.0).abs() > CONTRADICTION).then(|| {
            format!(
                "{}: at f/{:.2} micro-images of type 1 should have a radius of {:.2} px, but have \
                 {radius:.2} px: it was taken with another aperture",
                reference.name,
                reference.f_number,
                a + b
            )
        })
    }

    /// X by lens type, see [`super::shading`].
    fn of_image<'p>(
        &self,
        f_number: f64,
        profiles: impl IntoIterator<Item = &'p Profile>,
    ) -> Vec<f64> {
        let obliquity = self.options.obliquity(self.internal.m_mm, self.grid.pitch_px);
        let inverted = self.options.configuration == Configuration::Keplerian;
        let of_type = |(profile, q_prime): (&Profile, &f64)| {
            let (a, b) = self.discs(f_number, *q_prime);
            let peak = profile.peak(a + b, (a - b).abs()).unwrap_or(1.0);
            shading_moment(a, b, &obliquity, inverted, peak)
        };
        profiles.into_iter().zip(&self.internal.q_prime_mm).map(of_type).collect()
    }
}

/// The array with its centres free of shading, and by how much the pitch has changed. The moments of
/// shading are those of each white image, and of the reference, by lens type.
fn unshaded(
    found: &FoundArray,
    whites: &[White],
    samples: &[Sample],
    of_images: &[Vec<f64>],
    of_reference: &[f64],
) -> Result<(ArrayMeasurement, f64)> {
    let grid = &found.array.grid;
    let lattice = &grid.lattice;
    let types = of_reference.len();
    let shaded = samples
        .par_iter()
        .zip(whites)
        .zip(of_images)
        .map(|((sample, white), moments)| {
            let centers: Vec<MicroImageCenter> =
                sample.blobs.iter().map(|blob| found.center(blob)).collect();
            let fitted =
                fit_found_regular(&centers, lattice).map_err(|e| named(&white.name, &e))?;
            let x = moments.iter().sum::<f64>() / types as f64;
            Ok(Shaded { x, pitch_px: fitted.pitch_px, center_px: fitted.center_px })
        })
        .collect::<Result<Vec<Shaded>>>()?;
    let shading = fit_shading(&shaded);
    let mut array = found.array.clone();
    for center in &mut array.centers {
        let x = of_reference[lattice.lens_type(center.k, center.l, types)];
        let measured = Vector2::new(center.u_px, center.v_px);
        let place = shading.corrected(measured, &grid.center_px, x);
        (center.u_px, center.v_px) = (place.x, place.y);
    }
    array.grid = fit_found(&array.centers, lattice)?;
    let correction = array.grid.pitch_px / grid.pitch_px - 1.0;
    Ok((array, correction))
}

/// White images whose radii are not where the others put them.
fn contradictions(
    whites: &[White],
    radii: &[RadiusMeasurement],
    types: usize,
    options: &PrecalibrationOptions,
) -> Vec<String> {
    if whites.len() < 3 {
        return Vec::new();
    }
    let mut worst: Option<(f64, String)> = None;
    for (i, white) in whites.iter().enumerate() {
        // Rows are in the order of the images.
        let own = &radii[i * types..(i + 1) * types];
        let mut others = [&radii[..i * types], &radii[(i + 1) * types..]].concat();
        let Some(fit) = fit_internal(&mut others, types, 1.0, 0.0, options.configuration) else {
            continue;
        };
        let side = if options.configuration == Configuration::Keplerian { 1.0 } else { -1.0 };
        let expected = |m: &RadiusMeasurement| {
            fit.parameters.m_mm / m.f_number + side * fit.parameters.q_prime_mm[m.lens_type]
        };
        let off: f64 =
            own.iter().map(|m| m.radius_px / expected(m) - 1.0).sum::<f64>() / own.len() as f64;
        let usual = fit.rms_px / own[0].radius_px;
        let noticed = off.abs() > CONTRADICTION
            || whites.len() > FEWEST_TO_JUDGE && off.abs() > NOTICEABLE.max(OUT_OF_LINE * usual);
        if noticed && worst.as_ref().is_none_or(|(w, _)| off.abs() > *w) {
            let (measured, said) = (own[0].radius_px, expected(&own[0]));
            let text = format!(
                "{}: at f/{:.2} the radius of type 1 is {measured:.2} px, but the other images say \
                 {said:.2} px: check its f-number",
                white.name, white.f_number
            );
            worst = Some((off.abs(), text));
        }
    }
    worst.into_iter().map(|(_, text)| text).collect()
}
