//! Departures of real cameras from the model.

use nalgebra::Vector3;
use rand::rngs::StdRng;
use rand::{RngExt, SeedableRng};
use serde::{Deserialize, Serialize};

use super::array::MicroLens;
use super::spread::half_width_px;
use crate::error::{Error, Result};
use crate::model::{Opening, PlenopticCamera, Sensor, positive};

/// Departures from the ideal model, none by default.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Imperfections {
    /// Second stop that cuts off oblique rays, such as the rim of a lens barrel.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub second_stop: Option<SecondStop>,
    /// Aperture ratio: diameter of the micro-lenses' openings over their pitch, above 0 and up to 1. The rest is opaque.
    #[serde(alias = "fill_factor")]
    pub aperture_ratio: f64,
    /// Shape of these openings.
    pub opening: Opening,
    /// Law of the angular response: fall-off of light with its angle of incidence on the sensor.
    pub fall_off: FallOffLaw,
    /// Standard deviation of a Gaussian point spread on the sensor along each axis, px, due to diffraction, aberrations of the
    /// micro-lenses and the response of pixels. It is cut at 4σ.
    pub point_spread_px: f64,
    /// Number of micro-lenses that block all light.
    pub dead_micro_lenses: usize,
    /// Number of opaque specks on the sensor.
    pub dust_specks: usize,
    /// Diameter of the largest speck, px; the smallest has a quarter of this diameter.
    pub dust_diameter_px: f64,
}

/// Fall-off of light with its angle of incidence θ on the sensor.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum FallOffLaw {
    /// cos⁴θ: natural vignetting, with pixels whose response does not depend on the angle.
    #[default]
    Cos4,
    /// Constant response: a white target gives every ray the weight of light on the axis, per area of the micro-lens.
    None,
    /// cos⁴θ · 2^−(tan θ/tan θ½)²: pixels whose response falls to one half at θ½, in degrees.
    HalfResponseDeg(f64),
}

/// A circular opening perpendicular to the optical axis.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SecondStop {
    /// Position along z from the main lens, mm; negative behind it. A stop in front of the lens has the apparent position seen
    /// from behind.
    pub z_mm: f64,
    /// Diameter, mm.
    pub diameter_mm: f64,
}

impl Default for Imperfections {
    fn default() -> Self {
        Self {
            second_stop: None,
            aperture_ratio: 1.0,
            opening: Opening::Disc,
            fall_off: FallOffLaw::Cos4,
            point_spread_px: 0.0,
            dead_micro_lenses: 0,
            dust_specks: 0,
            dust_diameter_px: 10.0,
        }
    }
}

/// Largest number of dust specks. More would cover the whole image.
const MAX_SPECKS: usize = 100_000;
/// Largest distance of a stop, mm. A stop further away is equivalent to one at infinity.
const FURTHEST_MM: f64 = 1e6;
/// Largest point spread, px. A wider one would blur away a micro-image of the usual size.
const WIDEST_SPREAD_PX: f64 = 10.0;
/// Smallest angle of half response, degrees. Pixels with a smaller one would receive almost no light.
const LEAST_ANGLE_DEG: f64 = 1.0;
/// Seeds of random positions. They are separate, so that one does not change the other.
const DEAD: u64 = 0x6465_6164;
const DUST: u64 = 0x6475_7374;

impl FallOffLaw {
    /// Returns the irradiance through a small area of the micro-lens, over that area, for light of a given radiance. `inner` is
    /// the vector from sensor to micro-lens, `distance` the distance between their planes.
    #[inline(always)]
    #[allow(clippy::inline_always)] // compiled for the registers of loops over rays
    pub(super) fn light(self, radiance: f64, inner: &Vector3<f64>, distance: f64) -> f64 {
        if let Self::None = self {
            return radiance / (distance * distance);
        }
        let z2 = inner.z * inner.z;
        let square = inner.x * inner.x + inner.y * inner.y + z2;
        // Irradiance through a small area of a plane parallel to the sensor: L cos⁴/distance².
        let natural = radiance * z2 / (square * square);
        if let Self::HalfResponseDeg(half) = self {
            return natural * Self::response(half, inner);
        }
        natural
    }

    /// Returns the relative response to light along `inner` of a pixel whose response falls to one half at an angle.
    fn response(half_deg: f64, inner: &Vector3<f64>) -> f64 {
        let tangents = inner.xy().norm() / inner.z / half_deg.to_radians().tan();
        (-tangents * tangents).exp2()
    }
}

impl Imperfections {
    pub(super) fn validate(&self, camera: &PlenopticCamera) -> Result<()> {
        let distance = camera.mla.lens_to_mla_mm;
        if !(self.aperture_ratio > 0.0 && self.aperture_ratio <= 1.0) {
            return Err(Error::invalid(format!(
                "an aperture ratio of {} is not possible: give a number above 0 and up to 1",
                self.aperture_ratio
            )));
        }
        self.opening.check(camera.lattice.packing.kind())?;
        if let Some(stop) = self.second_stop {
            positive(stop.diameter_mm, "the diameter of the second stop (mm)")?;
            place("a second stop", stop.z_mm, distance)?;
        }
        if let FallOffLaw::HalfResponseDeg(angle) = self.fall_off
            && !(LEAST_ANGLE_DEG..90.0).contains(&angle)
        {
            return Err(Error::invalid(format!(
                "a half response at {angle} degrees is not possible: give {LEAST_ANGLE_DEG} or \
                 more, and less than 90"
            )));
        }
        if !(0.0..=WIDEST_SPREAD_PX).contains(&self.point_spread_px) {
            return Err(Error::invalid(format!(
                "a point spread of {} px is not possible: give its standard deviation, 0 to \
                 {WIDEST_SPREAD_PX} px",
                self.point_spread_px
            )));
        }
        let micro_lenses = camera.lattice.nodes();
        if self.dead_micro_lenses > micro_lenses {
            return Err(Error::invalid(format!(
                "{} dead micro-lenses are more than the {micro_lenses} micro-lenses of the array",
                self.dead_micro_lenses
            )));
        }
        if self.dust_specks > MAX_SPECKS {
            return Err(Error::invalid(format!(
                "{} specks of dust are too many: give at most {MAX_SPECKS}",
                self.dust_specks
            )));
        }
        positive(self.dust_diameter_px, "the diameter of the dust (px)")
    }

    pub(super) fn kill(&self, lenses: &mut [MicroLens], seed: u64) {
        let mut random = StdRng::seed_from_u64(seed ^ DEAD);
        for i in rand::seq::index::sample(&mut random, lenses.len(), self.dead_micro_lenses) {
            lenses[i].alive = false;
        }
    }
}

/// Fails unless z lies in front of the array, and not so far away that all rays are parallel.
fn place(what: &str, z: f64, lens_to_mla: f64) -> Result<()> {
    if z > -lens_to_mla && z <= FURTHEST_MM {
        return Ok(());
    }
    Err(Error::invalid(format!(
        "{what} at z = {z} mm is not possible: it has to lie between the array, at z = -{lens_to_mla} mm, \
         and {FURTHEST_MM} mm in front of the main lens"
    )))
}

/// Dust specks on the sensor.
#[derive(Debug)]
pub(super) struct Dust {
    /// Specks that may touch a row, for every row of the image.
    rows: Vec<Vec<Speck>>,
    /// Largest distance from the middle of a pixel at which its light may arrive, px.
    margin: f64,
}

#[derive(Debug, Clone, Copy)]
struct Speck {
    u: f64,
    v: f64,
    radius: f64,
}

impl Dust {
    pub fn new(imperfections: &Imperfections, sensor: &Sensor, seed: u64) -> Self {
        let mut random = StdRng::seed_from_u64(seed ^ DUST);
        let largest = imperfections.dust_diameter_px / 2.0;
        let speck = |_| Speck {
            u: random.random_range(0.0..f64::from(sensor.width_px)),
            v: random.random_range(0.0..f64::from(sensor.height_px)),
            radius: random.random_range(largest / 4.0..=largest),
        };
        let specks: Vec<Speck> = (0..imperfections.dust_specks).map(speck).collect();
        let margin = 2.0 * half_width_px(imperfections.point_spread_px);
        let mut rows = vec![Vec::new(); sensor.height_px as usize];
        for speck in specks {
            let reach = speck.radius + margin;
            for (_, row) in
                rows.iter_mut().enumerate().filter(|(v, _)| (*v as f64 - speck.v).abs() <= reach)
            {
                row.push(speck);
            }
        }
        Self { rows, margin }
    }

    /// Returns true if a speck may cover part of pixel (u, v).
    pub fn touches(&self, u: usize, v: usize) -> bool {
        self.near(v, u as f64, v as f64, self.margin)
    }

    /// Returns true if a speck covers the point where light of pixel (u, v) would arrive without point spread. The shadow of a
    /// speck is spread as well.
    pub fn covers(&self, u: usize, v: usize, [right, down]: [f64; 2]) -> bool {
        self.near(v, u as f64 + right, v as f64 + down, 0.0)
    }

    fn near(&self, row: usize, u: f64, v: f64, margin: f64) -> bool {
        self.rows[row].iter().any(|s| (u - s.u).hypot(v - s.v) <= s.radius + margin)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The factor cos⁴ is a quarter at 45°. A pixel has half the response at its angle, and a sixteenth at twice the tangent.
    #[test]
    fn light_falls_off_by_the_law() {
        let at = |law: FallOffLaw, tangent: f64| {
            law.light(3.0, &Vector3::new(0.0, -0.5 * tangent, 0.5), 0.5) / 12.0
        };
        let close = |a: f64, b: f64| (a - b).abs() < 1e-12;
        assert!(close(at(FallOffLaw::Cos4, 1.0), 0.25) && close(at(FallOffLaw::None, 1.0), 1.0));
        let pixel = FallOffLaw::HalfResponseDeg(20.0);
        for (part, response) in [(0.0, 1.0), (1.0, 0.5), (2.0, 1.0 / 16.0)] {
            let tangent = part * 20_f64.to_radians().tan();
            assert!(close(at(pixel, tangent), response * at(FallOffLaw::Cos4, tangent)), "{part}");
        }
    }
}
