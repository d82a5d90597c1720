//! Measurements of every white image: centres all over it, and radii in its middle.

use rayon::prelude::*;
use tracing::trace;

use super::array::FoundArray;
use super::centers::{measure_sample, part_with};
use super::centroid::Blob;
use super::discs::{Discs, Known, fit_discs};
use super::internal::{InternalFit, RadiusMeasurement, fit_internal, internal_of_discs};
use super::options::{PrecalibrationOptions, White};
use super::pattern::Pattern;
use super::profile::own_light_px;
use super::radii::{RadiusEstimator, TypeRadius, middle_nodes, radius_at};
use crate::error::{Error, Result};
use crate::image::{Grey, Image};
use crate::model::{FallOff, InternalParameters, LatticeKind, Opening, SampleLevels};
use crate::optics::{Obliquity, WhiteDiscs};
use crate::quantity::Estimate;

/// Tolerances of the patterns of one camera at two f-numbers: of the pitch, relative, and of the position, in pitches.
/// Oblique light changes both by less.
const SAME_PITCH: f64 = 1e-3;
const SAME_PLACE: f64 = 0.25;

/// White images with a sample of each.
pub(super) struct Samples<'a> {
    pub whites: &'a [White],
    pub samples: Vec<Sample<'a>>,
    /// Nodes in the middle of the images, by lens type, or by colour of the lattice while the types are not known.
    pub nodes: Vec<Vec<(i32, i32)>>,
    options: &'a PrecalibrationOptions,
}

/// Measurements of one white image.
pub(super) struct Sample<'a> {
    pub grey: Grey<'a>,
    /// Micro-images from all over the image.
    pub blobs: Vec<Blob>,
    /// Middle of the image, where radii are measured, and the pattern there.
    middle: Image,
    pattern: Pattern,
}

impl<'a> Samples<'a> {
    /// Measures every white image, between these levels, at the micro-images of the reference. Returns an error if an
    /// image has its micro-images elsewhere.
    pub fn measure(
        whites: &'a [White],
        (reference, levels): (&White, &SampleLevels),
        found: &FoundArray,
        options: &'a PrecalibrationOptions,
        progress: &(dyn Fn() + Sync),
    ) -> Result<Self> {
        let colors = if found.pattern.kind == LatticeKind::Orthogonal { 1 } else { 3 };
        let size = (reference.image.width, reference.image.height);
        let nodes = middle_nodes(found, size, colors);
        let of_white = |white: &'a White| {
            sample((white, levels), reference, found, &nodes).inspect(|_| progress())
        };
        let samples = whites.par_iter().map(of_white).collect::<Result<Vec<Sample<'a>>>>()?;
        Ok(Self { whites, samples, nodes, options })
    }

    /// Returns the samples by lens type, and the radii of the profiles. Measures the radii again if the colours are not
    /// the lens types.
    pub fn by_lens_type(
        mut self,
        types: usize,
        by_color: Vec<Vec<TypeRadius>>,
    ) -> Result<(Self, Vec<Vec<TypeRadius>>)> {
        if types == self.nodes.len() {
            return Ok((self, by_color));
        }
        self.nodes = vec![self.nodes.concat()];
        let radii = self.radii(RadiusEstimator::Profile)?;
        Ok((self, radii))
    }

    /// Measures radii by white image and by group of nodes.
    pub fn radii(&self, estimator: RadiusEstimator) -> Result<Vec<Vec<TypeRadius>>> {
        let of_white = |(white, sample): (&White, &Sample<'_>)| {
            let middle = (&sample.middle, sample.grey.floor());
            let radius = |nodes: &Vec<(i32, i32)>| {
                radius_at(middle, &sample.pattern, nodes, estimator).ok_or_else(|| {
                    Error::invalid(format!(
                        "{}: the micro-images in the middle have no edge: the image is too dark, \
                         fully saturated, or taken at an aperture so wide that they touch; remove \
                         it from the white images",
                        white.name
                    ))
                })
            };
            self.nodes.iter().map(radius).collect()
        };
        self.whites.par_iter().zip(&self.samples).map(of_white).collect()
    }

    /// Measures the radii again, with the angular response.
    pub fn oblique(
        &self,
        radii: &[Vec<TypeRadius>],
        internal: &InternalParameters,
        obliquity: &Obliquity,
    ) -> Vec<Vec<TypeRadius>> {
        let half_pitch_px = obliquity.half_pitch_px;
        let pixel_size_mm = self.options.pixel_size_mm;
        let spread_px2 = internal.point_spread_px2();
        let of_types = internal.q_prime_mm.iter().map(|q| q / pixel_size_mm - half_pitch_px);
        let q_px: Vec<f64> = of_types.collect();
        let widest = q_px.iter().map(|q| q.abs()).fold(0.0, f64::max);
        let of_white = |(white, radii): (&White, &Vec<TypeRadius>)| {
            let pupil_px = internal.pupil_radius_mm(white.f_number) / pixel_size_mm;
            let reach = own_light_px(2.0 * half_pitch_px, pupil_px + widest, spread_px2.sqrt());
            let again = |(radius, q_px): (&TypeRadius, &f64)| {
                let (q_px, opening_px, law) = (*q_px, half_pitch_px, *obliquity);
                let opening = internal.opening;
                let discs = WhiteDiscs { pupil_px, q_px, opening_px, opening, law };
                radius.oblique(&discs, reach, spread_px2)
            };
            radii.iter().zip(&q_px).map(again).collect()
        };
        self.whites.par_iter().zip(radii).map(of_white).collect()
    }

    /// Fits the discs to the light of all white images, from a start by straight lines, the angular
    /// response, and the distance of the exit pupil from the sensor over d. Returns `None` if the
    /// light does not determine them.
    pub fn discs(
        &self,
        radii: &[Vec<TypeRadius>],
        internal: &InternalParameters,
        (fall_off, pupil_to_sensor): (&FallOff, f64),
        micro_image_pitch_px: f64,
        opening: Opening,
    ) -> Option<Discs> {
        let pixel = self.options.pixel_size_mm;
        let mla_to_sensor_px = self.options.distances_px(internal.m_mm).1;
        let FallOff { within_per_px2, within_std_dev_per_px2, .. } = *fall_off;
        let known = Known {
            f_numbers: self.whites.iter().map(|white| white.f_number).collect(),
            m_px: internal.m_mm / pixel,
            q_px: internal
                .q_prime_mm
                .iter()
                .map(|q_prime| q_prime / pixel - micro_image_pitch_px / 2.0)
                .collect(),
            mla_to_sensor_px,
            pitch_px: micro_image_pitch_px,
            within: Estimate::new(within_per_px2, within_std_dev_per_px2)
                .scaled(mla_to_sensor_px.powi(2) / 4.0),
            pupil_to_sensor,
            opening,
        };
        let profiles: Vec<Vec<_>> =
            radii.iter().map(|radii| radii.iter().map(|r| &r.profile).collect()).collect();
        fit_discs(&profiles, &known)
    }

    /// Returns the middle of a white image, where radii are measured, and the pattern there.
    pub fn middle(&self, white: usize) -> (&Image, &Pattern) {
        let sample = &self.samples[white];
        (&sample.middle, &sample.pattern)
    }

    /// Lists the radii by white image and then by lens type.
    pub fn measurements(&self, radii: &[Vec<TypeRadius>]) -> Vec<RadiusMeasurement> {
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
        self.whites.iter().zip(radii).flat_map(of_white).collect()
    }

    /// Fits the internal parameters to radii at several f-numbers. Returns an error if the radii do not determine them.
    pub fn fit_internal(
        &self,
        radii: &mut [RadiusMeasurement],
        micro_image_pitch_px: f64,
    ) -> Result<InternalFit> {
        let PrecalibrationOptions { pixel_size_mm, configuration, .. } = *self.options;
        let types = self.nodes.len();
        let fitted = fit_internal(radii, types, pixel_size_mm, micro_image_pitch_px, configuration);
        let fitted = fitted.ok_or_else(|| {
            Error::invalid(
                "the f-numbers of the white images are too close to each other for a straight \
                 line: take white images a stop or more apart",
            )
        })?;
        if fitted.parameters.m_mm <= 0.0 {
            return Err(Error::invalid(
                "the radii of micro-images do not increase with decreasing f-number: check that \
                 the f-numbers belong to these images, that the lens was set to them, and that \
                 micro-images do not overlap",
            ));
        }
        Ok(fitted)
    }

    /// Computes the internal parameters from the discs, or else from straight lines through the radii. Fills in the
    /// residuals.
    pub fn internal(
        &self,
        discs: Option<&Discs>,
        radii: &mut [RadiusMeasurement],
        by_type: &[Vec<TypeRadius>],
        micro_image_pitch_px: f64,
    ) -> Result<InternalFit> {
        let Some(discs) = discs else { return self.fit_internal(radii, micro_image_pitch_px) };
        let PrecalibrationOptions { pixel_size_mm, configuration, .. } = *self.options;
        // All white images show the same micro-lenses. The smallest scatter of radii contains the least noise.
        let of_lenses = |lens_type: usize| {
            by_type.iter().map(|radii| radii[lens_type].of_lenses_px).fold(f64::INFINITY, f64::min)
        };
        let of_lenses: Vec<f64> = (0..discs.blur_px.len()).map(of_lenses).collect();
        let pitch = micro_image_pitch_px;
        Ok(internal_of_discs(discs, &of_lenses, radii, pixel_size_mm, pitch, configuration))
    }

    /// Returns the middle of an image, where radii are measured, and the pattern there.
    pub fn middle_of(&self, grey: &Grey, pattern: &Pattern) -> (Image, Pattern) {
        middle_of(grey, pattern, &self.nodes)
    }
}

/// Measures a sample of a white image at the micro-images of the reference. `nodes` are the nodes in the middle.
/// Returns an error if the image has its micro-images elsewhere.
fn sample<'a>(
    (white, levels): (&'a White, &SampleLevels),
    reference: &White,
    found: &FoundArray,
    nodes: &[Vec<(i32, i32)>],
) -> Result<Sample<'a>> {
    let grey = white.image.grey_between(Some(levels));
    let pattern = &found.pattern;
    let of_array: Vec<(i32, i32)> = found.blobs.iter().map(|blob| blob.node).collect();
    let (followed, blobs) = measure_sample(&grey, pattern, &of_array).ok_or_else(|| {
        Error::invalid(format!(
            "{}: no micro-images were found at the positions known from {}",
            white.name, reference.name
        ))
    })?;
    let pitch = pattern.pitch();
    let moved = (followed.origin - pattern.origin).norm() / pitch;
    if (followed.pitch() / pitch - 1.0).abs() > SAME_PITCH || moved > SAME_PLACE {
        return Err(Error::invalid(format!(
            "{} has micro-images with a pitch of {:.3} px, but {} has a pitch of {pitch:.3} px, \
             with an offset of {moved:.2} pitches: they are of different cameras, or one is not a \
             white image",
            white.name,
            followed.pitch(),
            reference.name
        )));
    }
    trace!("{}: pitch {:.5} px, {} micro-images", white.name, followed.pitch(), blobs.len());
    let (middle, pattern) = middle_of(&grey, &followed, nodes);
    Ok(Sample { grey, blobs, middle, pattern })
}

/// Returns the part of an image that shows some nodes, and the pattern there.
fn middle_of(grey: &Grey, pattern: &Pattern, nodes: &[Vec<(i32, i32)>]) -> (Image, Pattern) {
    let places = nodes.iter().flatten().map(|&(i, j)| pattern.place(i, j));
    let (part, corner) = part_with(grey, places, 2.0 * pattern.pitch());
    (part, pattern.seen_from(&corner))
}
