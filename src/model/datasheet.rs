//! Values of a camera that are known before its calibration: the datasheet and the internal parameters.

use serde::{Deserialize, Serialize};

use super::checks::positive;
use super::edge_spread::EdgeSpread;
use super::fall_off::FallOff;
use super::lattice::{Configuration, LatticeKind, check_array_size, check_lens_types};
use super::levels::SampleLevels;
use super::observations::MicroImageCenter;
use super::opening::Opening;
use super::sensor::Sensor;
use super::tilt_gradient::TiltGradient;
use crate::error::{Error, Result};
use crate::quantity::Estimate;

/// Largest tangent of the angle off the axis for lenses without distortion: 63 degrees.
const WIDEST: f64 = 2.0;

/// Datasheet values of a camera: the start of a calibration.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Datasheet {
    /// Image sensor.
    pub sensor: Sensor,
    /// Focal length F of the main lens, mm.
    pub focal_length_mm: f64,
    /// Distance h between the sensor and the plane in focus, mm; infinite is allowed.
    pub focus_distance_mm: f64,
    /// F-number N of the main lens setting.
    pub f_number: f64,
    /// Galilean, Keplerian or unfocused.
    pub configuration: Configuration,
    /// Packing of the micro-lenses.
    pub lattice_kind: LatticeKind,
    /// Number of micro-lenses along a row and along a column, if stated.
    pub array_size: Option<(i32, i32)>,
    /// Number I of lens types; 0 for an array of pinholes.
    pub lens_types: usize,
    /// Distance between neighbouring micro-image centres, px, if stated.
    pub micro_image_pitch_px: Option<f64>,
    /// Shape of the openings of the micro-lenses, if stated.
    pub opening: Option<Opening>,
}

/// Internal parameters Ω = {m, q'₁ … q'_I} (paper, section 3.2), measured on white images.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct InternalParameters {
    /// Slope |m| of the micro-image radius over 1/N, for small pupils, mm.
    pub m_mm: f64,
    /// Internal parameters q'ᵢ by lens type, mm.
    pub q_prime_mm: Vec<f64>,
    /// Distance Δc between neighbouring micro-image centres, mm, if measured.
    pub micro_image_pitch_mm: Option<f64>,
    /// σ of |m|, mm, if known.
    pub m_std_dev_mm: Option<f64>,
    /// σ of each q'ᵢ, mm; empty if not known.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub q_prime_std_dev_mm: Vec<f64>,
    /// Coefficient g, times 1/N², of the relative growth of the pupil image beyond |m|/N: 0 for a thin lens, see
    /// [`Self::pupil_radius_mm`].
    #[serde(default)]
    pub pupil_growth: f64,
    /// Angular response, if measured.
    pub fall_off: Option<FallOff>,
    /// Tilt gradient of the array, if measured.
    #[serde(alias = "lean")]
    pub tilt_gradient: Option<TiltGradient>,
    /// Fraction by which micro-images at the corners of the image are narrower towards its middle than across, since the main
    /// lens vignettes; if measured.
    pub vignetting: Option<Estimate>,
    /// Point spread, if measured.
    #[serde(alias = "point_spread")]
    pub point_spread_px2: Option<Estimate>,
    /// Aperture ratio to which q'ᵢ belong, if known; otherwise 1. White images show its product with qᵢ = q'ᵢ − Δc/2.
    #[serde(alias = "fill_factor")]
    pub aperture_ratio: Option<Estimate>,
    /// Shape of the openings of the micro-lenses.
    #[serde(default)]
    pub opening: Opening,
    /// Black and saturation level of the images, if known; otherwise samples are linear from 0 to full scale.
    pub levels: Option<SampleLevels>,
}

impl Datasheet {
    /// Returns the number of micro-lenses along a row and along a column, as stated; if it is not stated, as required by the
    /// indices of the centres.
    #[must_use]
    pub fn array_size_by(&self, centers: &[MicroImageCenter]) -> (i32, i32) {
        self.array_size.unwrap_or_else(|| {
            let reached = |n: i32, index: i32| n.max(index.saturating_add(1));
            centers.iter().fold((1, 1), |(k, l), c| (reached(k, c.k), reached(l, c.l)))
        })
    }

    /// Checks all values; an error names an impossible one.
    pub fn validate(&self) -> Result<()> {
        self.sensor.validate()?;
        if let Some((columns, rows)) = self.array_size {
            check_array_size(columns, rows)?;
        }
        if let Some(pitch) = self.micro_image_pitch_px {
            positive(pitch, "the micro-image pitch (micro_image_pitch_px)")?;
        }
        positive(self.focal_length_mm, "the focal length of the main lens (focal_length_mm)")?;
        positive(self.f_number, "the f-number of the main lens (f_number)")?;
        check_lens_types(self.lens_types, self.lattice_kind)?;
        if let Some(opening) = self.opening {
            opening.check(self.lattice_kind)?;
        }
        let half_diagonal_mm = self.sensor.half_diagonal_mm();
        if half_diagonal_mm > WIDEST * self.focal_length_mm {
            return Err(Error::invalid(format!(
                "with F = {} mm a sensor with a diagonal of {:.1} mm would have a half field angle \
                 of {:.0} degrees, which no lens covers: check the focal length (focal_length_mm) \
                 and the pixel size (pixel_size_mm), both in mm",
                self.focal_length_mm,
                2.0 * half_diagonal_mm,
                (half_diagonal_mm / self.focal_length_mm).atan().to_degrees()
            )));
        }
        // The sum of object and image distance of a thin lens is at least 4F.
        if self.focus_distance_mm.is_nan() || self.focus_distance_mm < 4.0 * self.focal_length_mm {
            return Err(Error::invalid(format!(
                "a focus distance of {} mm is not possible with F = {} mm: focus_distance_mm is \
                 measured from the sensor and has to be at least 4 F",
                self.focus_distance_mm, self.focal_length_mm
            )));
        }
        Ok(())
    }
}

impl InternalParameters {
    /// Returns the radius of the exit pupil on the sensor, seen through the middle of a micro-lens, at f-number N, mm: |m|/N ·
    /// (1 + g/N²). By Abbe's sine condition a real lens has g = (m/d)²/2.
    #[must_use]
    pub fn pupil_radius_mm(&self, f_number: f64) -> f64 {
        self.m_mm.abs() / f_number * (1.0 + self.pupil_growth / f_number.powi(2))
    }

    /// Returns the variance of the point spread along an axis, px²; 0 if it is not known.
    #[must_use]
    pub fn point_spread_px2(&self) -> f64 {
        self.point_spread_px2.map_or(0.0, |spread| spread.value)
    }

    /// Returns the aperture ratio φ to which q'ᵢ belong; 1 if it is not known.
    #[must_use]
    pub fn aperture_ratio(&self) -> f64 {
        self.aperture_ratio.map_or(1.0, |ratio| ratio.value)
    }

    /// Returns the parameters with another aperture ratio φ, for the micro-image pitch Δc, mm. The observable quantities of
    /// white images stay the same: φqᵢ = φ(q'ᵢ − Δc/2) and the growth of the discs over the image.
    #[must_use]
    pub fn with_aperture_ratio(&self, aperture_ratio: Estimate, pitch_mm: f64) -> Self {
        let change = self.aperture_ratio() / aperture_ratio.value;
        let half_mm = pitch_mm / 2.0;
        let of_std_dev = |std_dev: &f64| std_dev * change;
        Self {
            q_prime_mm: self.q_prime_mm.iter().map(|q| half_mm + (q - half_mm) * change).collect(),
            q_prime_std_dev_mm: self.q_prime_std_dev_mm.iter().map(of_std_dev).collect(),
            micro_image_pitch_mm: Some(pitch_mm),
            tilt_gradient: self
                .tilt_gradient
                .map(|tilt_gradient| tilt_gradient.with_aperture_ratio(-change.ln())),
            aperture_ratio: Some(aperture_ratio),
            ..self.clone()
        }
    }

    /// Checks all values; an error names an impossible one, or a wrong number of q'.
    pub fn validate(&self, lens_types: usize) -> Result<()> {
        positive(self.m_mm, "the internal parameter |m| (m_mm)")?;
        for (i, &q) in self.q_prime_mm.iter().enumerate() {
            positive(q, &format!("the internal parameter q'_{} (q_prime_mm)", i + 1))?;
        }
        if let Some(pitch) = self.micro_image_pitch_mm {
            positive(pitch, "the micro-image pitch (micro_image_pitch_mm)")?;
        }
        if lens_types != 0 && self.q_prime_mm.len() != lens_types {
            return Err(Error::invalid(format!(
                "the camera has I = {lens_types} lens types, but the internal parameters have {} \
                 values of q': give both for the same camera",
                self.q_prime_mm.len()
            )));
        }
        for std_dev in self.m_std_dev_mm.iter().chain(&self.q_prime_std_dev_mm) {
            if !(std_dev.is_finite() && *std_dev >= 0.0) {
                return Err(Error::invalid(format!(
                    "a standard deviation of the internal parameters is {std_dev}, but has to be 0 \
                     or more and finite"
                )));
            }
        }
        if !self.pupil_growth.is_finite() {
            return Err(Error::invalid(format!(
                "pupil_growth of the internal parameters is {}, but has to be finite",
                self.pupil_growth
            )));
        }
        if let Some(fall_off) = &self.fall_off {
            fall_off.validate()?;
        }
        if let Some(tilt_gradient) = &self.tilt_gradient {
            tilt_gradient.validate()?;
        }
        let (aperture_ratio, point_spread_px2) = (self.aperture_ratio, self.point_spread_px2);
        EdgeSpread { aperture_ratio, opening: self.opening, point_spread_px2 }.validate()?;
        if let Some(levels) = &self.levels {
            levels.validate()?;
        }
        let given = self.q_prime_std_dev_mm.len();
        if given != 0 && given != self.q_prime_mm.len() {
            return Err(Error::invalid(format!(
                "there are {} values of q', but {given} standard deviations",
                self.q_prime_mm.len()
            )));
        }
        Ok(())
    }
}
