//! Angular response of light, from the illumination gradients of micro-images of white targets.
//!
//! Every micro-image of a sample of each white image gives its own g ([`super::rings`]). The pixels of all micro-images
//! of a type have the same design matrix, up to the grid of pixels. The plane g(c) = G (c − c₀) through all g gives G
//! with its σ.

use nalgebra::{Matrix5, SVector, Vector1, Vector2, Vector5};
use rayon::prelude::*;
use tracing::debug;

use super::array::FoundArray;
use super::centroid::{Blob, WINDOW};
use super::disc_geometry::DiscGeometry;
use super::options::PrecalibrationOptions;
use super::rings::{Alike, Gradient};
use super::samples::Samples;
use super::tilt_gradient::{Group, tilt_gradient};
use crate::checks::whites as checks;
use crate::finding::Finding;
use crate::image::Grey;
use crate::model::{FallOff, InternalParameters, TiltGradient, lens_over_pupil};
use crate::numerics::{NormalEquations, Outliers, Scale, Weight};
use crate::optics::Obliquity;
use crate::quantity::Estimate;

/// Distance from the centre up to which light determines g, in pitches: neighbours may begin beyond.
const REACH: f64 = 0.46;
/// Number of micro-images of the reference: enough for G to about a per cent.
const SAMPLE: usize = 3000;
/// Fewest micro-images for a plane.
const FEWEST_GRADIENTS: usize = 30;
/// Outliers, due to dust and faults: gradients this many times further from the plane than the typical one.
const OUTLIERS: Outliers =
    Outliers { weight: Weight::Cut, scale: Scale::PerAxis, scales: 4.0, least: 0.0, slack: 1e-12 };
/// Rounds of the fit.
const ROUNDS: usize = 4;
/// Largest σ of a known angular response, relative to cos⁴. Corners near the border of an R12 are then right to 0.01
/// px.
const KNOWN: f64 = 0.2;
/// Relative σ of H if it follows from G by the law of the angle: pixels respond differently to the two angles, and the main
/// lens has vignetting and pupil aberrations.
const LAW: f64 = 0.25;
/// Aperture ratios of micro-lenses with gaps. The parabola in ln φ through these and φ = 1 gives the tilt gradient at
/// 0.8 to half a per cent.
const OTHERWISE: [f64; 2] = [0.9, 0.7];

/// Measured angular response of a camera.
pub(super) struct Measured {
    pub fall_off: FallOff,
    /// Tilt gradient of the array, if it shows.
    pub tilt_gradient: Option<TiltGradient>,
    /// Ratio of the distance L = D + e_z + d from exit pupil to sensor to d.
    pub pupil_to_sensor: f64,
    /// Finding if the angular response was not measured.
    pub finding: Option<Finding>,
}

/// Light of micro-images in a sample of every white image.
pub(super) struct Light {
    /// Light by image, with its f-number, and by lens type; the reference is last.
    of_images: Vec<(f64, Vec<Alike>)>,
    reach_px: f64,
    seen_pitch_px: f64,
    /// Perspective of the centres, px⁻¹.
    perspective_per_px: Vector2<f64>,
    /// Middle of the image, px.
    middle: Vector2<f64>,
}

impl Light {
    /// Reads the samples of all white images, and a larger sample of the reference, which has this f-number.
    pub fn read(found: &FoundArray, samples: &Samples, reference: (f64, &Grey)) -> Self {
        let types = samples.nodes.len();
        let pitch = found.pattern.pitch();
        let of_image = |image: &Grey, blobs: &[Blob]| -> Vec<Alike> {
            let mut centers = vec![Vec::new(); types];
            for blob in blobs {
                let (k, l) = found.index(blob.node);
                centers[found.array.grid.lattice.lens_type(k, l, types)].push(blob.center);
            }
            let of_type =
                |centers: &Vec<Vector2<f64>>| Alike::read(image, centers, WINDOW.1 * pitch);
            centers.iter().map(of_type).collect()
        };
        let step = found.blobs.len().div_ceil(SAMPLE).max(1);
        // Every third micro-image in a row would be of one lens type.
        let step = if step.is_multiple_of(3) { step + 1 } else { step };
        let sample: Vec<Blob> = found.blobs.iter().copied().step_by(step).collect();
        let whites = samples.whites.iter().zip(&samples.samples);
        let images: Vec<(f64, &Grey, &[Blob])> = whites
            .map(|(white, of)| (white.f_number, &of.grey, of.blobs.as_slice()))
            .chain([(reference.0, reference.1, sample.as_slice())])
            .collect();
        let of_images = images
            .par_iter()
            .map(|(f_number, grey, blobs)| (*f_number, of_image(grey, blobs)))
            .collect();
        let (width, height) = reference.1.size();
        Self {
            of_images,
            reach_px: REACH * pitch,
            seen_pitch_px: found.array.grid.pitch_px,
            perspective_per_px: found.array.grid.perspective_per_px,
            middle: Vector2::new(width as f64 - 1.0, height as f64 - 1.0) / 2.0,
        }
    }

    /// Returns the mean light of each type in the reference.
    pub fn of_reference(&self) -> &[Alike] {
        self.of_images.last().map_or(&[], |(_, types)| types)
    }

    /// Returns the angular response that the images show, or else cos⁴ with a warning. Inside micro-images it follows
    /// the same law. `law` is the response inside micro-images as far as it is known; it has a small effect on the
    /// light.
    pub fn fall_off(
        &self,
        internal: &InternalParameters,
        options: &PrecalibrationOptions,
        law: &Obliquity,
    ) -> Measured {
        let (lens_to_sensor_px, mla_to_sensor_px) = options.distances_px(internal.m_mm);
        let cos4 = FallOff::cos4(mla_to_sensor_px, lens_to_sensor_px, self.middle);
        let known = |fall_off: &FallOff| fall_off.std_dev_per_px2 < KNOWN * cos4.growth_per_px2;
        let gradients = self.gradients(internal, options, law);
        let tilt_gradient = self.tilt_gradient(&gradients, None);
        let lens_to_sensor = lens_to_sensor_px / mla_to_sensor_px;
        let pupil =
            lens_over_pupil(tilt_gradient.as_ref(), &self.perspective_per_px, lens_to_sensor);
        let pupil_to_sensor = lens_to_sensor / pupil.value;
        debug!("{tilt_gradient:?}, (D + d)/(D + e_z + d) {pupil:?}");
        let Some(measured) = plane(&gradients.concat()).filter(known) else {
            let within_std_dev_per_px2 = cos4.within_per_px2;
            let fall_off = FallOff { within_std_dev_per_px2, ..cos4 };
            let finding = Some(checks::response_unknown());
            return Measured { fall_off, tilt_gradient, pupil_to_sensor, finding };
        };
        let [growth, std_dev] =
            [measured.growth_per_px2, measured.std_dev_per_px2].map(|x| x / cos4.growth_per_px2);
        debug!(
            "light falls off by {growth:.3} ± {std_dev:.3} of cos⁴ over the image, about {:.1?} px",
            measured.middle_px,
        );
        // Inside micro-images the same law applies, so that H = G (D + e_z + d)/d.
        let within_per_px2 = measured.growth_per_px2 * pupil_to_sensor;
        // The larger side of the error of a quotient: the pupil may be far away.
        let of_pupil = pupil.std_dev / (pupil.value - pupil.std_dev).max(pupil.std_dev);
        let within_std_dev_per_px2 =
            LAW.hypot(of_pupil) * within_per_px2.abs().max(cos4.within_per_px2);
        Measured {
            fall_off: FallOff { within_per_px2, within_std_dev_per_px2, ..measured },
            tilt_gradient,
            pupil_to_sensor,
            finding: None,
        }
    }

    fn tilt_gradient(
        &self,
        gradients: &[Vec<Gradient>],
        otherwise: Option<&[Vec<Gradient>]>,
    ) -> Option<TiltGradient> {
        let alike = || self.of_images.iter().flat_map(|(_, types)| types);
        let of_group = |(group, alike): (&Vec<Gradient>, &Alike)| Group {
            growths: group.iter().map(|g| g.growth).collect(),
            is_clipped: alike.is_clipped(self.reach_px),
        };
        let groups = |all: &[Vec<Gradient>]| all.iter().zip(alike()).map(of_group).collect();
        let (at, otherwise): (Vec<Group>, Option<Vec<Group>>) =
            (groups(gradients), otherwise.map(groups));
        tilt_gradient(&at, otherwise.as_deref(), &self.middle)
    }

    /// Returns the tilt gradient with the error of H, and its dependence on the aperture ratio, which white images do not show.
    /// Returns `None` if no tilt gradient shows with another aperture ratio or another H.
    pub fn complete(
        &self,
        internal: &InternalParameters,
        options: &PrecalibrationOptions,
        law: &Obliquity,
        fall_off: &FallOff,
    ) -> Option<TiltGradient> {
        let (_, mla_to_sensor_px) = options.distances_px(internal.m_mm);
        let within = law.within_per_px2 + fall_off.within_std_dev_per_px2;
        let otherwise =
            Obliquity::in_the_middle(within, mla_to_sensor_px, self.seen_pitch_px / 2.0);
        let of = |internal: &InternalParameters| {
            let [at, otherwise] =
                [law, &otherwise].map(|law| self.gradients(internal, options, law));
            self.tilt_gradient(&at, Some(&otherwise))
        };
        let tilt_gradient = of(internal)?;
        debug!("with the error of H: {tilt_gradient:?}");
        let pitch_mm = self.seen_pitch_px * options.pixel_size_mm;
        // Change of the tilt gradient over the change of ln φ.
        let with_gaps = |value: f64| {
            let narrower = internal.with_aperture_ratio(Estimate::exact(value), pitch_mm);
            let other = of(&narrower)?;
            let change = (value / internal.aperture_ratio()).ln();
            let than = |i: usize| other.growth_per_px[i] - tilt_gradient.growth_per_px[i];
            Some((change, [0, 1].map(|i| than(i) / change)))
        };
        let [(near, slope), (far, other)] = [with_gaps(OTHERWISE[0])?, with_gaps(OTHERWISE[1])?];
        let by_aperture_ratio_squared_per_px = [0, 1].map(|i| (other[i] - slope[i]) / (far - near));
        let by_aperture_ratio_per_px =
            [0, 1].map(|i| slope[i] - by_aperture_ratio_squared_per_px[i] * near);
        Some(TiltGradient {
            by_aperture_ratio_per_px,
            by_aperture_ratio_squared_per_px,
            ..tilt_gradient
        })
    }

    /// Computes the gradients of all micro-images, by image and type.
    fn gradients(
        &self,
        internal: &InternalParameters,
        options: &PrecalibrationOptions,
        law: &Obliquity,
    ) -> Vec<Vec<Gradient>> {
        let of_image = |(f_number, types): &(f64, Vec<Alike>)| {
            let geometry = DiscGeometry::new(internal, *f_number, self.seen_pitch_px, options);
            let of_type = |(lens_type, alike): (usize, &Alike)| {
                alike.gradients(self.reach_px, &geometry.light(lens_type, 0.0, law, self.reach_px))
            };
            types.iter().enumerate().map(of_type).collect::<Vec<_>>()
        };
        self.of_images.iter().flat_map(of_image).collect()
    }
}

/// Fits G and c₀ of g = G (c − c₀) to all gradients.
///
/// If the array is tilted, d grows across the image, and the discs with it. Then gradients have a part (T·c) c, whose
/// mean is not 0. Without this part, c₀ would move by a hundred pixels on an R12 tilted by 1 mrad.
fn plane(gradients: &[Gradient]) -> Option<FallOff> {
    if gradients.len() < FEWEST_GRADIENTS {
        return None;
    }
    let count = gradients.len() as f64;
    let middle = gradients.iter().map(|g| g.place).sum::<Vector2<f64>>() / count;
    // One row per axis. Squares are in thousands of px².
    let rows = |g: &Gradient| {
        let from = g.place - middle;
        let (uu, uv, vv) = (from.x * from.x / 1e3, from.x * from.y / 1e3, from.y * from.y / 1e3);
        [Vector5::new(from.x, 1.0, 0.0, uu, uv), Vector5::new(from.y, 0.0, 1.0, uv, vv)]
    };
    let mut kept = vec![true; gradients.len()];
    let mut fitted = SVector::<f64, 5>::zeros();
    let mut information = Matrix5::zeros();
    let mut variance = 1.0;
    for _ in 0..ROUNDS {
        let mut equations = NormalEquations::<f64, 5, 1>::new();
        for (g, _) in gradients.iter().zip(&kept).filter(|(_, kept)| **kept) {
            for (row, value) in rows(g).into_iter().zip(g.value.iter()) {
                equations.add(&row, &Vector1::new(*value), g.weight);
            }
        }
        fitted = equations.solve()?;
        information = equations.normal();
        let residual = |g: &Gradient| {
            let expected = Vector2::from(rows(g).map(|row| row.dot(&fitted)));
            (g.value - expected).norm() * g.weight.sqrt()
        };
        let lengths: Vec<f64> = gradients.iter().map(residual).collect();
        let typical = OUTLIERS.typical(&lengths)?;
        variance = typical * typical;
        kept = lengths.iter().map(|length| *length <= OUTLIERS.limit(typical)).collect();
    }
    let std_dev = (variance * information.try_inverse()?[(0, 0)]).sqrt();
    let growth = fitted[0];
    // Without a fall-off the middle is undefined.
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
