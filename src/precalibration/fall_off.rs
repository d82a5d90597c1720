//! The fall-off of light with its angle, from how lopsided micro-images of white targets are.
//!
//! A micro-image off the axis is brighter on one side. Its light is the mean light of all micro-images of
//! its type at the distance r from its centre, Ī(r), times 1 − g·(y − M), where the pixel y sees the pupil
//! through the part of the micro-lens about M. A centre that is off by δ makes it lopsided too, by −δ·Ī′ along
//! the radius. The two differ in how they change with r, so both are fitted, and no other centre is needed:
//! g is the same whatever window and centroid were used, whether part of the light is clipped or not.
//! Pixels of all micro-images of a type have the same design, up to the grid of pixels; the plane g(c) = G (c −
//! c₀) through all of them gives G with its σ.

use nalgebra::{Matrix3, SVector, Vector1, Vector2, Vector3};
use rayon::prelude::*;
use tracing::debug;

use super::array::FoundArray;
use super::centers::part_with;
use super::centroid::{Blob, pixels_about};
use super::profile::PIXEL;
use super::samples::Samples;
use super::stage::{PrecalibrationOptions, White};
use crate::image::Grey;
use crate::model::{FallOff, InternalParameters};
use crate::numerics::{NormalEquations, Outliers, Scale, Weight};
use crate::vignetting::overlap;

/// Light is used up to this distance from the centre, in pitches: beyond, neighbours may begin.
const REACH: f64 = 0.46;
/// Width of the rings that the mean light is taken over, px.
const RING_PX: f64 = 0.25;
/// Samples above this part of full scale may be clipped; so may the mean of a ring with one.
const CLIPPED: f32 = 0.97;
/// What a pixel, and a point spread, take from the plateau of a micro-image, px.
const PLATEAU_MARGIN_PX: f64 = 1.2;
/// The smallest plateau across which light falls off by enough to be seen, px.
const LEAST_PLATEAU_PX: f64 = 1.5;
/// Variance of a pixel without light, over that of the brightest.
const READ_NOISE: f64 = 0.02;
/// So many micro-images of the reference give G to about a per cent.
const SAMPLE: usize = 3000;
/// Fewest pixels that determine the five numbers of a micro-image.
const FEWEST: usize = 30;
/// Fewest micro-images for a plane.
const FEWEST_GRADIENTS: usize = 30;
/// Gradients this many times further than the typical one from the plane are dust and faults.
const OUTLIERS: Outliers =
    Outliers { weight: Weight::Cut, scale: Scale::PerAxis, scales: 4.0, least: 0.0, slack: 1e-12 };
/// Rounds of the fit.
const ROUNDS: usize = 4;

/// The discs of pupil and blur, by white image.
struct Discs {
    /// a, px.
    pupil_px: f64,
    /// qᵢ with its sign, by lens type, px.
    q_px: Vec<f64>,
    /// Δc/2, px.
    half_pitch_px: f64,
}

impl Discs {
    /// Of an image at this f-number.
    fn new(internal: &InternalParameters, f_number: f64, pitch_px: f64, pixel_mm: f64) -> Self {
        Self {
            pupil_px: internal.pupil_radius_mm(f_number) / pixel_mm,
            q_px: internal.q_prime_mm.iter().map(|q| q / pixel_mm - pitch_px / 2.0).collect(),
            half_pitch_px: pitch_px / 2.0,
        }
    }

    /// |y − M|, outwards, the mean over the light of a pixel at distance r: through which part of the
    /// micro-lens it sees the pupil.
    fn lens_to_pixel(&self, lens_type: usize, r: f64) -> f64 {
        let q = self.q_px[lens_type];
        let size = q.abs().max(1e-6);
        let (mut light, mut sum) = (0.0, 0.0);
        for (along, weight) in PIXEL {
            // Across the direction to the middle a pixel has a mean square of 1/12.
            let distance = ((r + along).powi(2) + 1.0 / 12.0).sqrt();
            // Where nothing is visible there is no light either.
            let Some(part) = overlap(distance / size, self.pupil_px / size) else { continue };
            let outwards = (r + along) / distance;
            light += weight * part.area;
            sum += weight
                * part.area
                * (r + along + part.mean * q.signum() * self.half_pitch_px * outwards);
        }
        if light > 0.0 { sum / light } else { 0.0 }
    }

    /// How far from the centre all pixels see the whole pupil, or the whole micro-lens, px, and |y − M|/|y|
    /// there.
    fn plateau(&self, lens_type: usize) -> (f64, f64) {
        let (a, q) = (self.pupil_px, self.q_px[lens_type]);
        let lever = if a < q.abs() { 1.0 + self.half_pitch_px / q } else { 1.0 };
        ((a - q.abs()).abs() - PLATEAU_MARGIN_PX, lever)
    }
}

/// How lopsided a micro-image is.
#[derive(Debug, Clone, Copy)]
struct Gradient {
    place: Vector2<f64>,
    /// g, px⁻¹, and one over its variance per axis.
    value: Vector2<f64>,
    weight: f64,
}

/// A fall-off is known if its σ is below this part of that of cos⁴: corners near the border of an R12 are then
/// right to 0.01 px.
const KNOWN: f64 = 0.2;

/// The fall-off that white images show, or else that of cos⁴ with a warning.
pub(super) fn known_fall_off(
    found: &FoundArray,
    samples: &Samples,
    reference: &White,
    internal: &InternalParameters,
    options: &PrecalibrationOptions,
) -> (FallOff, Option<String>) {
    let pitch_px = found.array.grid.pitch_px;
    let discs = |f_number| Discs::new(internal, f_number, pitch_px, options.pixel_size_mm);
    let of_whites: Vec<Discs> = samples.whites.iter().map(|white| discs(white.f_number)).collect();
    let of_reference = (reference, &discs(reference.f_number));
    let lopsided = Lopsided::of_images(found, samples, of_reference, &of_whites);
    let (lens_to_sensor_px, mla_to_sensor_px) = options.distances_px(internal.m_mm);
    let (width, height) = (reference.image.width as f64, reference.image.height as f64);
    let middle = Vector2::new(width - 1.0, height - 1.0) / 2.0;
    let cos4 = FallOff::cos4(mla_to_sensor_px, lens_to_sensor_px, middle);
    if let Some(mut measured) = plane(&lopsided.gradients) {
        let within = mean_within(&lopsided.within);
        debug!(
            "light falls off by {:.3} ± {:.3} of cos⁴ over the image, and inside micro-images by {:.3?}",
            measured.growth_per_px2 / cos4.growth_per_px2,
            measured.std_dev_per_px2 / cos4.growth_per_px2,
            within.map(|(h, std_dev)| [h, std_dev].map(|x| x / cos4.within_per_px2)),
        );
        let (within_per_px2, within_std_dev_per_px2) = within
            .filter(|(_, std_dev)| *std_dev < KNOWN * cos4.within_per_px2)
            .unwrap_or((measured.growth_per_px2 * lens_to_sensor_px / mla_to_sensor_px, 0.0));
        measured = FallOff { within_per_px2, within_std_dev_per_px2, ..measured };
        if measured.std_dev_per_px2 < KNOWN * cos4.growth_per_px2 {
            return (measured, None);
        }
    }
    let warning = "how light falls off with its angle does not show in the white images: it is taken to be \
                   cos⁴, and corners far from the axis may be off by 0.1 px; take white images that are not \
                   clipped";
    (cos4, Some(warning.to_owned()))
}

/// What micro-images show of the fall-off.
#[derive(Default)]
struct Lopsided {
    gradients: Vec<Gradient>,
    /// H with its variance, by image and type.
    within: Vec<(f64, f64)>,
}

impl Lopsided {
    /// What all white images show.
    fn of_images(
        found: &FoundArray,
        samples: &Samples,
        (reference, of_reference): (&White, &Discs),
        of_whites: &[Discs],
    ) -> Self {
        let types = of_reference.q_px.len();
        let reach = REACH * found.pattern.pitch();
        let lens_type = |blob: &Blob| {
            let (k, l) = found.index(blob.node);
            found.array.grid.lattice.lens_type(k, l, types)
        };
        let of_image = |image: &Grey, blobs: &[Blob], discs: &Discs| -> Self {
            let of_type = |own: usize| {
                let blobs: Vec<Blob> =
                    blobs.iter().copied().filter(|blob| lens_type(blob) == own).collect();
                Self::of_type(image, &blobs, (discs, own), reach)
            };
            (0..types).map(of_type).fold(Self::default(), Self::and)
        };
        let step = found.blobs.len().div_ceil(SAMPLE).max(1);
        // Every third in a row would be of one lens type.
        let step = if step.is_multiple_of(3) { step + 1 } else { step };
        let sample: Vec<Blob> = found.blobs.iter().copied().step_by(step).collect();
        let whites = samples.whites.par_iter().zip(&samples.samples).zip(of_whites);
        whites
            .map(|((white, sample), discs)| of_image(&white.image.grey(), &sample.blobs, discs))
            .reduce(Self::default, Self::and)
            .and(of_image(&reference.image.grey(), &sample, of_reference))
    }

    /// What the micro-images of one type show in one image.
    fn of_type(
        image: &Grey,
        blobs: &[Blob],
        (discs, lens_type): (&Discs, usize),
        reach: f64,
    ) -> Self {
        let light: Vec<Pixels> =
            blobs.par_iter().map(|blob| pixels_of(image, &blob.center, reach)).collect();
        let rings = Rings::new(&light, reach, |r| discs.lens_to_pixel(lens_type, r));
        let gradients = blobs
            .par_iter()
            .zip(&light)
            .filter_map(|(blob, pixels)| rings.gradient(&blob.center, pixels))
            .collect();
        let (plateau_px, lever) = discs.plateau(lens_type);
        Self { gradients, within: within(&light, plateau_px, lever).into_iter().collect() }
    }

    fn and(mut self, other: Self) -> Self {
        self.gradients.extend(other.gradients);
        self.within.extend(other.within);
        self
    }
}

/// H with its variance, from how much darker the plateaus of micro-images become away from their centres;
/// `None` if those are too small or clipped. Every micro-image is compared with its own mean.
fn within(light: &[Pixels], plateau_px: f64, lever: f64) -> Option<(f64, f64)> {
    if plateau_px < LEAST_PLATEAU_PX {
        return None;
    }
    let (mut square, mut product, mut residual, mut count) = (0.0, 0.0, 0.0, 0.0);
    for pixels in light {
        let inside: Vec<(f64, f64)> = pixels
            .iter()
            .filter(|(offset, _)| offset.norm() < plateau_px)
            .map(|(offset, value)| ((lever * offset.norm()).powi(2) / 2.0, *value))
            .collect();
        let clipped = inside.iter().any(|(_, value)| *value > f64::from(CLIPPED));
        if clipped || inside.len() < 2 {
            continue;
        }
        let n = inside.len() as f64;
        let mean_x = inside.iter().map(|(x, _)| x).sum::<f64>() / n;
        let mean = inside.iter().map(|(_, value)| value).sum::<f64>() / n;
        for (x, value) in inside {
            let (x, y) = (x - mean_x, value / mean - 1.0);
            square += x * x;
            product += x * y;
            residual += y * y;
            count += 1.0;
        }
    }
    (count > FEWEST as f64).then(|| (-product / square, residual / count / square))
}

/// The mean of all H, and its σ by their scatter or their variances, whichever is larger.
fn mean_within(all: &[(f64, f64)]) -> Option<(f64, f64)> {
    let weights: f64 = all.iter().map(|(_, variance)| 1.0 / variance).sum();
    let mean = all.iter().map(|(h, variance)| h / variance).sum::<f64>() / weights;
    let scatter: f64 = all.iter().map(|(h, variance)| (h - mean).powi(2) / variance).sum();
    let freedom = (all.len() as f64 - 1.0).max(1.0);
    (!all.is_empty()).then(|| (mean, ((scatter / freedom).max(1.0) / weights).sqrt()))
}

/// Pixels of a micro-image: offsets from its centre, light.
type Pixels = Vec<(Vector2<f64>, f64)>;

fn pixels_of(image: &Grey, center: &Vector2<f64>, reach: f64) -> Pixels {
    let (part, corner) = part_with(image, std::iter::once(*center), reach + 1.0);
    let mut pixels = Vec::new();
    pixels_about(&part, &(center - corner), reach, |offset, value| pixels.push((offset, value)));
    pixels
}

/// A ring of the mean micro-image.
#[derive(Debug, Clone, Copy, Default)]
struct Ring {
    light: f64,
    /// Ī′, px⁻¹.
    slope: f64,
    /// Ī |y − M|, px.
    lever: f64,
    usable: bool,
}

/// The mean light of the micro-images of one type in one image, by distance from the centre.
struct Rings(Vec<Ring>);

impl Rings {
    fn new(all: &[Pixels], reach: f64, lens_to_pixel: impl Fn(f64) -> f64) -> Self {
        #[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss)] // a few pixels
        let count = (reach / RING_PX).ceil() as usize + 1;
        let mut sums = vec![(0.0, 0.0, false); count];
        for (offset, value) in all.iter().flatten() {
            let sum = &mut sums[ring_of(offset)];
            sum.0 += 1.0;
            sum.1 += value;
            sum.2 |= *value > f64::from(CLIPPED);
        }
        let mean = |i: usize| {
            let (count, light, clipped) = sums[i];
            (count > 0.0 && !clipped).then(|| light / count)
        };
        let ring = |i: usize| {
            let (before, here, after) = (mean(i.checked_sub(1)?)?, mean(i)?, mean(i + 1)?);
            Some(Ring {
                light: here,
                slope: (after - before) / (2.0 * RING_PX),
                lever: here * lens_to_pixel((i as f64 + 0.5) * RING_PX),
                usable: true,
            })
        };
        let rings =
            (0..count).map(|i| if i + 1 < count { ring(i) } else { None }.unwrap_or_default());
        Self(rings.collect())
    }

    /// g of a micro-image; `None` if too little of its light is usable.
    fn gradient(&self, place: &Vector2<f64>, pixels: &Pixels) -> Option<Gradient> {
        let brightest = self.0.iter().map(|ring| ring.light).fold(0.0, f64::max);
        let rows = || {
            pixels.iter().filter_map(|(offset, value)| {
                let ring = &self.0[ring_of(offset)];
                let outwards = offset / offset.norm().max(1e-9);
                let row = SVector::<f64, 5>::new(
                    ring.light,
                    -ring.lever * outwards.x,
                    -ring.lever * outwards.y,
                    -ring.slope * outwards.x,
                    -ring.slope * outwards.y,
                );
                let weight = 1.0 / (ring.light + READ_NOISE * brightest);
                (ring.usable && *value <= f64::from(CLIPPED)).then_some((row, *value, weight))
            })
        };
        let count = rows().count();
        if count < FEWEST {
            return None;
        }
        let mut equations = NormalEquations::<f64, 5, 1>::new();
        rows().for_each(|(row, value, weight)| equations.add(&row, &Vector1::new(value), weight));
        let solution = equations.solve()?;
        let squares: f64 =
            rows().map(|(row, value, weight)| (value - row.dot(&solution)).powi(2) * weight).sum();
        let variance = squares / (count - 5) as f64;
        let inverse = equations.normal().try_inverse()?;
        let of_axes = variance * f64::midpoint(inverse[(1, 1)], inverse[(2, 2)]);
        let scale = solution[0];
        (scale > 0.0 && of_axes > 0.0).then(|| Gradient {
            place: *place,
            value: Vector2::new(solution[1], solution[2]) / scale,
            weight: scale * scale / of_axes,
        })
    }
}

fn ring_of(offset: &Vector2<f64>) -> usize {
    #[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss)] // a distance
    let ring = (offset.norm() / RING_PX) as usize;
    ring
}

/// G and c₀ of g = G (c − c₀) over all gradients.
fn plane(gradients: &[Gradient]) -> Option<FallOff> {
    if gradients.len() < FEWEST_GRADIENTS {
        return None;
    }
    let count = gradients.len() as f64;
    let middle = gradients.iter().map(|g| g.place).sum::<Vector2<f64>>() / count;
    let mut kept = vec![true; gradients.len()];
    let mut fitted = Vector3::zeros();
    let mut information = Matrix3::zeros();
    let mut variance = 1.0;
    for _ in 0..ROUNDS {
        let mut equations = NormalEquations::<f64, 3, 1>::new();
        for (g, _) in gradients.iter().zip(&kept).filter(|(_, kept)| **kept) {
            let from = g.place - middle;
            let rows = [Vector3::new(from.x, 1.0, 0.0), Vector3::new(from.y, 0.0, 1.0)];
            for (row, value) in rows.into_iter().zip(g.value.iter()) {
                equations.add(&row, &Vector1::new(*value), g.weight);
            }
        }
        fitted = equations.solve()?;
        information = equations.normal();
        let residual = |g: &Gradient| {
            let expected = (g.place - middle) * fitted[0] + Vector2::new(fitted[1], fitted[2]);
            (g.value - expected).norm() * g.weight.sqrt()
        };
        let lengths: Vec<f64> = gradients.iter().map(residual).collect();
        let typical = OUTLIERS.typical(&lengths)?;
        variance = typical * typical;
        kept = lengths.iter().map(|length| *length <= OUTLIERS.limit(typical)).collect();
    }
    let std_dev = (variance * information.try_inverse()?[(0, 0)]).sqrt();
    let growth = fitted[0];
    // Without a fall-off it has no middle.
    let shift = Vector2::new(fitted[1], fitted[2]);
    let off = if growth.abs() > 3.0 * std_dev { -shift / growth } else { Vector2::zeros() };
    Some(FallOff {
        growth_per_px2: growth,
        std_dev_per_px2: std_dev,
        middle_px: (middle + off).into(),
        within_per_px2: 0.0,
        within_std_dev_per_px2: 0.0,
    })
}
