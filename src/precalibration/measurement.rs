//! Measurement of white images: from pixels to array, lens types, discs and internal parameters.

use tracing::debug;

use super::array::FoundArray;
use super::array_search::{found_array, patterns};
use super::black::black_level;
use super::centroid_shift::{corrected_array, shift_moments};
use super::checks::{ReferenceRadius, doubtful_colors, named};
use super::disc_geometry::DiscGeometry;
use super::discs::Discs;
use super::f_numbers::{Doubt, doubtful};
use super::fall_off::{Light, Measured};
use super::lens_types::judge_types;
use super::opening::cell_share;
use super::options::{PrecalibrationOptions, White};
use super::pattern::Pattern;
use super::radii::{RadiusEstimator, TypeRadius};
use super::result::Precalibration;
use super::roundness::vignetting;
use super::samples::Samples;
use crate::checks::whites as checks;
use crate::error::Result;
use crate::finding::Finding;
use crate::image::Grey;
use crate::model::{FallOff, InternalParameters, Opening, SampleLevels, full_scale};
use crate::optics::Obliquity;
use crate::quantity::Estimate;

/// Measures the white images. Returns the discs too, if the light shows them.
pub(super) fn measured(
    whites: &[White],
    reference: &White,
    options: &PrecalibrationOptions,
    progress: &(dyn Fn() + Sync),
) -> Result<(Precalibration, Option<Discs>)> {
    let pattern = patterns(&reference.image.grey()).next();
    let (levels, black) = levels_of(whites, reference, pattern.as_ref(), options.black_level)?;
    let grey = reference.image.grey_between(Some(&levels));
    let found = located(reference, &grey, pattern, options)?;
    let samples = Samples::measure(whites, (reference, &levels), &found, options, progress)?;
    let by_color = samples.radii(RadiusEstimator::Profile)?;
    let lens_types = judge_types(&by_color, &found);
    let (samples, by_profile) = samples.by_lens_type(lens_types.types, by_color)?;

    let by_images = samples.measurements(&by_profile);
    let half_pitch_px = found.array.grid.pitch_px / 2.0;
    let sizes = (lens_types.types, half_pitch_px);
    let doubt = doubtful(whites, &by_images, sizes, options.configuration)?;
    if let Some((doubt, f_number)) = doubt.as_ref().and_then(|d| Some((d, d.f_number?))) {
        return without((doubt, f_number), whites, reference, options);
    }

    // The discs determine the shift of centroids, whatever the estimator.
    let seen_pitch_px = found.array.grid.pitch_px;
    let lines =
        samples.fit_internal(&mut samples.measurements(&by_profile), seen_pitch_px)?.parameters;
    let geometry = DiscGeometry::new(&lines, reference.f_number, seen_pitch_px, options);
    let radius = ReferenceRadius::measure(&grey, &geometry, &samples, &found.pattern);
    let overlap = radius.and_then(|r| r.overlapping(reference.f_number, &geometry, half_pitch_px));
    let mut everywhere = None;
    if let Some((overlap, apart)) = overlap {
        let others = whites.iter().filter(|white| white.f_number >= apart);
        let other = others.min_by(|a, b| a.f_number.total_cmp(&b.f_number));
        if let Some(other) = other.filter(|other| other.name != reference.name) {
            let (mut result, discs) = measured(whites, other, options, &|| ())?;
            result.findings.push(Finding::note(overlap).about_image(&reference.name));
            return Ok((result, discs));
        }
        // No white image shows the array and the angular response without overlap.
        everywhere = Some(Finding::caution(overlap).about_image(&reference.name));
    }
    let light = Light::read(&found, &samples, (reference.f_number, &grey));
    let cos4 = in_the_middle(None, &lines, seen_pitch_px, options);
    let mut first = light.fall_off(&lines, options, &cos4);
    // Straight lines are accurate enough for a start.
    let Shaped { discs: of_light, cell_share, doubtful: doubtful_opening } =
        shaped(&samples, &by_profile, &found, options, (&lines, &first))?;
    let discs = of_light.as_ref();
    take_within(&mut first.fall_off, discs);
    let obliquity = in_the_middle(Some(&first.fall_off), &lines, seen_pitch_px, options);
    let internal_of = |by_type: &[Vec<TypeRadius>]| {
        let mut radii = samples.measurements(by_type);
        samples.internal(discs, &mut radii, by_type, seen_pitch_px)
    };
    let by_profile =
        samples.oblique(&by_profile, &internal_of(&by_profile)?.parameters, &obliquity);
    let oblique = internal_of(&by_profile)?;
    // Repeated with the fitted discs.
    let Measured { mut fall_off, tilt_gradient, finding: unknown_fall_off, .. } =
        light.fall_off(&oblique.parameters, options, &obliquity);
    take_within(&mut fall_off, discs);
    let geometry =
        DiscGeometry::new(&oblique.parameters, reference.f_number, seen_pitch_px, options);
    let moments = shift_moments(light.of_reference(), &geometry, seen_pitch_px, &obliquity);
    let growth = geometry.growth_per_px(tilt_gradient.as_ref(), &found.array.grid);
    let (array, pitch_correction) = corrected_array(&found, &fall_off, &moments, &growth)?;

    let (by_type, discs) = match options.estimator {
        RadiusEstimator::Profile => (by_profile, discs),
        // The radii of the paper are not radii of the discs.
        RadiusEstimator::Moments => (samples.radii(RadiusEstimator::Moments)?, None),
    };
    let mut radii = samples.measurements(&by_type);
    let mut internal = samples.internal(discs, &mut radii, &by_type, array.grid.pitch_px)?;
    internal.parameters.fall_off = Some(fall_off);
    internal.parameters.tilt_gradient = tilt_gradient
        .and_then(|_| light.complete(&oblique.parameters, options, &obliquity, &fall_off));
    internal.parameters.levels = Some(levels);
    let wrong_f_number = doubt.map(|doubt| doubt.finding);
    // With a wrong f-number the lines cannot judge the aperture of the reference.
    let wrong_aperture = ReferenceRadius::measure(&grey, &geometry, &samples, &found.pattern)
        .and_then(|radius| radius.different_aperture(reference))
        .filter(|_| wrong_f_number.is_none());
    let by_lines = by_lines(discs, options.estimator, &mut internal.parameters);
    internal.parameters.vignetting = vignetting(&grey, &array.centers, array.grid.pitch_px);
    let oblong = checks::roundness(internal.parameters.vignetting);
    let types = checks::lens_types(lens_types.agreement);
    // A wrong f-number explains why there are no discs.
    let by_light = wrong_f_number.or(by_lines);
    let told = [
        by_light,
        wrong_aperture,
        doubtful_opening,
        everywhere,
        oblong,
        types,
        unknown_fall_off,
        black,
    ];
    let findings = doubtful_colors(whites).into_iter().chain(told.into_iter().flatten()).collect();
    let images = whites.iter().map(|white| white.name.clone()).collect();
    let measured = Precalibration {
        array,
        lens_types,
        images,
        radii,
        internal,
        cell_share,
        pitch_correction,
        findings,
    };
    Ok((measured, of_light))
}

/// Fit of pupil, blur and point spread to the white light, with the shape of the openings.
struct Shaped {
    /// Discs, if the light shows them.
    discs: Option<Discs>,
    cell_share: Option<Estimate>,
    /// Finding if the shape is doubtful.
    doubtful: Option<Finding>,
}

/// Fits the light with discs as openings, which are accurate enough for the cell share, and then with the shape that it shows.
fn shaped(
    samples: &Samples,
    by_profile: &[Vec<TypeRadius>],
    found: &FoundArray,
    options: &PrecalibrationOptions,
    (lines, first): (&InternalParameters, &Measured),
) -> Result<Shaped> {
    let grid = &found.array.grid;
    let response = (&first.fall_off, first.pupil_to_sensor);
    let of_shape =
        |opening: Opening| samples.discs(by_profile, lines, response, grid.pitch_px, opening);
    let discs = of_shape(Opening::Disc);
    let mut radii = samples.measurements(by_profile);
    let round = samples.internal(discs.as_ref(), &mut radii, by_profile, grid.pitch_px)?;
    let cell_share = cell_share(samples, found, &round.parameters, options.pixel_size_mm);
    let stated = options.stated.and_then(|sheet| sheet.opening);
    let (opening, doubtful) = checks::opening(stated, grid.lattice.kind(), cell_share);
    let discs = if opening == Opening::Disc { discs } else { of_shape(opening) };
    Ok(Shaped { discs, cell_share, doubtful })
}

/// Finds the array in the reference image.
fn located(
    reference: &White,
    grey: &Grey,
    pattern: Option<Pattern>,
    options: &PrecalibrationOptions,
) -> Result<FoundArray> {
    let found =
        found_array(grey, pattern, options.array_size).map_err(|e| named(&reference.name, &e))?;
    debug!(
        "{}: a '{}' lattice with a pitch of {:.4} px, {} centres measured",
        reference.name,
        found.pattern.kind.name(),
        found.pattern.pitch(),
        found.array.centers.len()
    );
    Ok(found)
}

/// Repeats the measurement without a white image whose micro-images cannot be measured, or whose f-number cannot be right.
fn without(
    (doubt, f_number): (&Doubt, f64),
    whites: &[White],
    reference: &White,
    options: &PrecalibrationOptions,
) -> Result<(Precalibration, Option<Discs>)> {
    let mut others = whites.to_vec();
    let doubtful = others.remove(doubt.white);
    // A reference with a wrong f-number still shows the array.
    let f_number = if doubtful.name == reference.name { f_number } else { reference.f_number };
    let reference = White { f_number, ..reference.clone() };
    let (mut result, discs) = measured(&others, &reference, options, &|| ())?;
    result.findings.insert(0, doubt.finding.clone());
    Ok((result, discs))
}

/// Returns the levels of the white images, and a finding if the black level is doubtful. Returns an error if images
/// saturate below a stated black level.
fn levels_of(
    whites: &[White],
    reference: &White,
    pattern: Option<&Pattern>,
    stated: Option<f64>,
) -> Result<(SampleLevels, Option<Finding>)> {
    let black = black_level(whites, pattern, stated)?;
    let full = |white: &White| Some(white.image.plateau()? / white.image.full_scale());
    let full = whites.iter().chain([reference]).filter_map(full).fold(1.0, f64::min);
    let levels = SampleLevels {
        bits: black.bits,
        black_level: black.level,
        black_level_std_dev: black.std_dev,
        saturation_level: (full < 1.0).then_some(full * full_scale(black.bits)),
    };
    levels.validate()?;
    debug!("{levels:?}");
    Ok((levels, black.finding))
}

/// Returns a finding, and increases the standard deviations of m and q', if these come from straight lines for lack of
/// discs, and not because the moments estimator was requested.
fn by_lines(
    discs: Option<&Discs>,
    estimator: RadiusEstimator,
    internal: &mut InternalParameters,
) -> Option<Finding> {
    if discs.is_some() || estimator == RadiusEstimator::Moments {
        return None;
    }
    internal.m_std_dev_mm =
        internal.m_std_dev_mm.map(|x| x.hypot(checks::BY_LINES.0 * internal.m_mm));
    for (std_dev, q) in internal.q_prime_std_dev_mm.iter_mut().zip(&internal.q_prime_mm) {
        *std_dev = std_dev.hypot(checks::BY_LINES.1 * q);
    }
    Some(checks::no_discs())
}

/// Replaces H and its σ by the values of the discs, if there are any.
fn take_within(fall_off: &mut FallOff, discs: Option<&Discs>) {
    if let Some(discs) = discs {
        debug!("{discs:?}");
        (fall_off.within_per_px2, fall_off.within_std_dev_per_px2) = discs.within_per_px2;
    }
}

/// Returns the angular response in the middle of the image, where radii are measured; cos⁴ if it is not known.
fn in_the_middle(
    fall_off: Option<&FallOff>,
    internal: &InternalParameters,
    pitch_px: f64,
    options: &PrecalibrationOptions,
) -> Obliquity {
    let (_, mla_to_sensor_px) = options.distances_px(internal.m_mm);
    let cos4 = 4.0 / mla_to_sensor_px.powi(2);
    let within = fall_off.map_or(cos4, |fall_off| fall_off.within_per_px2);
    Obliquity::in_the_middle(within, mla_to_sensor_px, pitch_px / 2.0)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn straight_lines_have_larger_standard_deviations_and_a_warning() {
        let measured = InternalParameters {
            m_mm: 0.15,
            q_prime_mm: vec![0.036, 0.041],
            m_std_dev_mm: Some(1e-4),
            q_prime_std_dev_mm: vec![1e-5, 1e-5],
            micro_image_pitch_mm: None,
            pupil_growth: 0.0,
            fall_off: None,
            tilt_gradient: None,
            vignetting: None,
            point_spread_px2: None,
            aperture_ratio: None,
            opening: Opening::Disc,
            levels: None,
        };
        let of = |estimator| {
            let mut internal = measured.clone();
            (by_lines(None, estimator, &mut internal), internal)
        };
        let (warning, internal) = of(RadiusEstimator::Profile);
        assert!(warning.unwrap().to_string().contains("change m by 6 % and q' by 3 %"));
        assert!((internal.m_std_dev_mm.unwrap() / measured.m_mm - 0.06).abs() < 1e-4);
        for (std_dev, q) in internal.q_prime_std_dev_mm.iter().zip(&internal.q_prime_mm) {
            assert!((std_dev / q - 0.03).abs() < 1e-4);
        }
        // The moments estimator was requested.
        assert_eq!(of(RadiusEstimator::Moments), (None, measured.clone()));
    }
}
