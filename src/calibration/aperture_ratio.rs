//! Aperture ratio φ of the micro-lenses from the widths of edges in the boards.
//!
//! White images show φqᵢ, the blur radius of the pupil itself, with qᵢ = q'ᵢ − Δc/2. A corner whose line has the slope
//! γ has the blur radius φρ = φqᵢ + φ(1 − γ)Δc/2. So φ is the measured blur radius less φqᵢ, over (1 − γ)Δc/2. φ gives
//! the q'ᵢ that belong to the whole pitch, and with them fᵢ.

use std::collections::BTreeMap;

use crate::calibration::Start;
use crate::calibration::priors::INTERCEPTS;
use crate::checks::calibration as checks;
use crate::error::{Error, Result};
use crate::finding::Finding;
use crate::model::taken::APERTURE_RATIO;
use crate::model::{
    APERTURE_RATIO_MODEL, BapFeature, InternalParameters, Lattice, at_most_full,
    check_aperture_ratio, optics,
};
use crate::numerics::{median, weighted_mean};
use crate::precalibration::MicroImageArray;
use crate::quantity::Estimate;

/// Aperture ratios of a camera from the widths of edges.
#[derive(Debug, Clone, PartialEq)]
pub struct BlurMeasurement {
    /// Aperture ratio of all micro-lenses.
    pub aperture_ratio: Estimate,
    /// Measurement of each lens type by itself, by type; `None` without features.
    pub types: Vec<Option<TypeBlur>>,
}

/// Measurement of one lens type from the widths of edges.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct TypeBlur {
    /// Aperture ratio from this type alone.
    pub aperture_ratio: Estimate,
    /// Mean of measured less predicted blur radii, with the aperture ratio of all types; σ by the scatter of frames,
    /// px.
    pub excess_px: Estimate,
    /// Number of its features.
    pub features: usize,
}

/// Outliers of a frame: features this many times further than the typical one from all others.
const OUTLIERS: f64 = 5.0;
/// Rounds in which outliers are left out.
const ROUNDS: usize = 5;
/// Median deviation of a normal distribution, in σ.
const MEDIAN_DEVIATION: f64 = 0.6745;

/// Feature with a measured blur radius.
struct Measured {
    frame: u32,
    lens_type: usize,
    /// Aperture ratio from this feature alone.
    ratio: Estimate,
    /// Change of the ratio with one σ of the error that all features share.
    shared: f64,
    /// Growth (1 − γ) Δc/2 of the blur radius with the aperture ratio, px.
    growth_px: f64,
}

/// Internal parameters Ω in pixels.
struct InPixels<'a> {
    internal: &'a InternalParameters,
    half_pitch: f64,
    pixel_mm: f64,
}

impl InPixels<'_> {
    /// Returns qᵢ with another aperture ratio, px; `None` if there is no such type.
    fn q(&self, lens_type: usize, ratio: f64) -> Option<f64> {
        let q_prime = self.internal.q_prime_mm.get(lens_type)? / self.pixel_mm;
        Some((q_prime - self.half_pitch) * self.internal.aperture_ratio() / ratio)
    }

    /// Returns σ of φqᵢ, px.
    fn std_dev(&self, lens_type: usize) -> f64 {
        let of_type = |of: &Vec<f64>| of.get(lens_type).copied();
        let stated = of_type(&self.internal.q_prime_std_dev_mm);
        let assumed = || of_type(&self.internal.q_prime_mm).map(|q| INTERCEPTS * q);
        stated.or_else(assumed).unwrap_or(0.0) * self.internal.aperture_ratio() / self.pixel_mm
    }

    /// Computes the aperture ratio from a measured blur radius: (blur − φqᵢ)/((1 − γ)Δc/2), where γ follows from ρ. The
    /// ratio is expanded about the one with which the corner was found. So the local q'ᵢ, which varies over a tilted
    /// array, cancels.
    fn measured(&self, f: &BapFeature, lens_type: usize) -> Option<Measured> {
        let (blur, rho) = (f.blur?, f.rho_px?);
        let growth_px = rho - self.q(lens_type, blur.aperture_ratio)?;
        let ratio = blur.aperture_ratio + (blur.radius_px - blur.aperture_ratio * rho) / growth_px;
        let std_dev = blur.std_dev_px / growth_px.abs();
        let usable = ratio.is_finite() && std_dev.is_finite();
        usable.then_some(Measured {
            frame: f.frame,
            lens_type,
            ratio: Estimate::new(ratio, std_dev),
            shared: blur.shared_px / growth_px,
            growth_px,
        })
    }

    /// Estimates the aperture ratio from some features. Features of a frame share errors, so its σ comes from the
    /// scatter between frames. Errors that all frames share, σ of q'ᵢ and the model error are added.
    fn aperture_ratio<'a>(
        &self,
        some: impl Iterator<Item = &'a Measured> + Clone,
    ) -> Option<Estimate> {
        let Estimate { value, std_dev } = by_frames(some.clone().map(|m| (m.frame, m.ratio)))?;
        let (mut weights, mut shared, mut by_type) = (0.0, 0.0, BTreeMap::<usize, f64>::new());
        for m in some {
            let weight = m.ratio.std_dev.powi(-2);
            weights += weight;
            shared += weight * m.shared;
            *by_type.entry(m.lens_type).or_default() += weight / m.growth_px;
        }
        let of_type = |(lens_type, by): (&usize, &f64)| self.std_dev(*lens_type) * by / weights;
        let of_white_images = by_type.iter().map(of_type).fold(0.0, f64::hypot);
        let of_all = (shared / weights).hypot(of_white_images).hypot(APERTURE_RATIO_MODEL * value);
        let std_dev = std_dev.hypot(of_all);
        Some(Estimate { value, std_dev })
    }
}

impl BlurMeasurement {
    /// Measures the aperture ratios from features that state their measured blur, with internal parameters of a
    /// datasheet. Returns `None` if there are none, and an error if the aperture ratio is not possible.
    pub(super) fn of(
        start: &Start,
        grid: Option<&MicroImageArray>,
        features: &[BapFeature],
    ) -> Result<Option<Self>> {
        let (Start::Datasheet(sheet, internal), Some(grid)) = (start, grid) else {
            return Ok(None);
        };
        let pixel_mm = sheet.sensor.pixel_size_mm;
        let half_pitch = pitch_mm(internal, grid, pixel_mm) / pixel_mm / 2.0;
        let in_pixels = InPixels { internal, half_pitch, pixel_mm };
        let types = internal.q_prime_mm.len();
        let of_feature =
            |f: &BapFeature| in_pixels.measured(f, grid.lattice.lens_type(f.k, f.l, types));
        let all: Vec<Measured> = features.iter().filter_map(of_feature).collect();
        let Some(aperture_ratio) = in_pixels.aperture_ratio(all.iter()) else { return Ok(None) };
        check_aperture_ratio(&aperture_ratio).map_err(|error| {
            Error::invalid(format!(
                "the widths of edges do not fit the internal parameters: {error}. Check that both \
                 are of the same camera, or remove the columns blur, std_blur and aperture_ratio \
                 from the features"
            ))
        })?;
        let of_type = |lens_type: usize| {
            let own = || all.iter().filter(move |m| m.lens_type == lens_type);
            let excess = |m: &Measured| {
                let excess = Estimate { value: m.ratio.value - aperture_ratio.value, ..m.ratio };
                (m.frame, excess.scaled(m.growth_px))
            };
            Some(TypeBlur {
                aperture_ratio: in_pixels.aperture_ratio(own())?,
                excess_px: by_frames(own().map(excess))?,
                features: own().count(),
            })
        };
        Ok(Some(Self { aperture_ratio, types: (0..types).map(of_type).collect() }))
    }

    /// Returns a finding about the two lens types that disagree most on the aperture ratio, if they do.
    pub(super) fn contradiction(&self) -> Option<Finding> {
        let of_types =
            self.types.iter().enumerate().filter_map(|(i, t)| Some((i, (*t)?.aperture_ratio)));
        checks::aperture_ratios(&of_types.collect::<Vec<_>>(), self.aperture_ratio.value)
    }
}

/// Returns the start with the measured aperture ratio.
pub(super) fn with_aperture_ratio(
    start: Start,
    grid: Option<&MicroImageArray>,
    measured: Option<&BlurMeasurement>,
) -> Start {
    match (start, grid, measured) {
        (Start::Datasheet(sheet, internal), Some(grid), Some(measured)) => {
            let pitch_mm = pitch_mm(&internal, grid, sheet.sensor.pixel_size_mm);
            let internal =
                internal.with_aperture_ratio(at_most_full(&measured.aperture_ratio), pitch_mm);
            Start::Datasheet(sheet, internal)
        }
        (start, ..) => start,
    }
}

/// Returns Δc, mm.
fn pitch_mm(internal: &InternalParameters, grid: &MicroImageArray, pixel_mm: f64) -> f64 {
    internal.micro_image_pitch_mm.unwrap_or(grid.pitch_px * pixel_mm)
}

/// Converts features that were found with a different aperture ratio to the aperture ratio of the camera: ρ by qᵢ, since
/// φqᵢ is constant, u and v by their sensitivities. Features without measured blur stay unchanged.
pub(super) fn with_that_of_start(
    mut features: Vec<BapFeature>,
    start: &Start,
    lattice: &Lattice,
) -> Vec<BapFeature> {
    let pixel_mm = start.sensor().pixel_size_mm;
    let internal = match start {
        Start::Datasheet(_, internal) => internal.clone(),
        Start::Camera(camera) => optics::internal_parameters(camera),
    };
    let (Some(ratio), Some(pitch_mm)) = (internal.aperture_ratio, internal.micro_image_pitch_mm)
    else {
        return features;
    };
    let (types, half_pitch) = (internal.q_prime_mm.len(), pitch_mm / pixel_mm / 2.0);
    let in_pixels = InPixels { internal: &internal, half_pitch, pixel_mm };
    for f in &mut features {
        let Some(blur) = &mut f.blur else { continue };
        let q = in_pixels.q(lattice.lens_type(f.k, f.l, types), ratio.value);
        if let (Some(rho), Some(q)) = (&mut f.rho_px, q) {
            *rho += q * (1.0 - ratio.value / blur.aperture_ratio);
        }
        if let Some(sensitivities) = f.sensitivities_px {
            let [by_u, by_v] = sensitivities[APERTURE_RATIO];
            let change = (ratio.value / blur.aperture_ratio).ln();
            f.u_px += by_u * change;
            f.v_px += by_v * change;
        }
        blur.aperture_ratio = ratio.value;
    }
    features
}

/// Returns the mean over frames of the means of frames.
fn by_frames(values: impl Iterator<Item = (u32, Estimate)>) -> Option<Estimate> {
    let mut frames: BTreeMap<u32, Vec<Estimate>> = BTreeMap::new();
    for (frame, value) in values {
        frames.entry(frame).or_default().push(value);
    }
    weighted_mean(frames.values().filter_map(|of_frame| of_one_frame(of_frame)))
}

/// Returns the mean of values with their σ, without outliers.
fn of_one_frame(values: &[Estimate]) -> Option<Estimate> {
    let mut kept = values.to_vec();
    let mut found = None;
    for _ in 0..ROUNDS {
        let mean = weighted_mean(kept.iter().copied())?;
        found = Some(mean);
        let far = |e: &Estimate| (e.value - mean.value).abs() / e.std_dev;
        let typical = median(values.iter().map(far))? / MEDIAN_DEVIATION;
        kept = values.to_vec();
        kept.retain(|value| far(value) <= OUTLIERS * typical.max(1.0));
    }
    found
}

#[cfg(test)]
mod tests;
