//! Settings of the sensor.

use std::ops::RangeInclusive;

use serde::{Deserialize, Serialize};

use crate::error::{Error, Result};
use crate::image::Color;

/// Settings and noise of the sensor.
///
/// They apply in this order: light, crosstalk, shot noise, full well, read noise, gain, black level, clipping to 0 and full
/// scale, gamma, saturation, rounding; then hot pixels.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Imaging {
    /// Signal in the middle of the brightest micro-image of a white target, as a fraction of the full well; above 1 the pixel
    /// overflows. It holds at any f-number: the exposure time is adapted to the light.
    pub exposure: f64,
    /// Amplification after the pixel: with a gain of 4, a quarter of the full well gives full scale.
    pub gain: f64,
    /// Bits per sample, 8 or 16.
    pub bits: u32,
    /// Arrangement of the colours: grey, RGB or a colour mosaic.
    pub color: Color,
    /// Response of red, green and blue pixels; grey pixels have the response 1.
    pub channel_response: [f64; 3],
    /// Full well in electrons, which determines the shot noise; `inf` for no noise at all.
    pub full_well_electrons: f64,
    /// Standard deviation of the read noise, electrons.
    pub read_noise_electrons: f64,
    /// Fraction of a pixel's signal that goes to each of its four neighbours. At the border of the image it stays in the
    /// pixel.
    pub crosstalk: f64,
    /// Linear value of a pixel without light, as a fraction of full scale.
    pub black_level: f64,
    /// Exponent γ of the samples: a sample is its linear value to the power of 1/γ, both as fractions of full scale.
    pub gamma: f64,
    /// Largest sample, as a fraction of full scale.
    pub saturation: f64,
    /// Number of pixels that always have the largest sample, at the same places in all images of a set.
    pub hot_pixels: usize,
    /// Quality of JPEG files, from 1 to 100, instead of PNG. JPEG files have 8 bits and are grey or RGB.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub jpeg_quality: Option<u8>,
}

/// Upper limits, far beyond any real sensor, shutter or amplifier.
pub(super) const MAX_FACTOR: f64 = 1e6;
pub(super) const MAX_ELECTRONS: f64 = 1e9;
/// Largest crosstalk. With 0.2, a pixel keeps as much as each of its neighbours gets.
const MAX_CROSSTALK: f64 = 0.2;
const GAMMAS: RangeInclusive<f64> = 0.1..=10.0;

impl Default for Imaging {
    /// Returns an 8-bit grey image, well exposed, with the noise of an average CMOS sensor.
    fn default() -> Self {
        Self {
            exposure: 0.8,
            gain: 1.0,
            bits: 8,
            color: Color::Grey,
            channel_response: [0.6, 1.0, 0.7],
            full_well_electrons: 13_000.0,
            read_noise_electrons: 13.0,
            crosstalk: 0.0,
            black_level: 0.0,
            gamma: 1.0,
            saturation: 1.0,
            hot_pixels: 0,
            jpeg_quality: None,
        }
    }
}

impl Imaging {
    pub(super) fn validate(&self) -> Result<()> {
        let [red, green, blue] = self.channel_response;
        for (name, value) in [
            ("exposure", self.exposure),
            ("gain", self.gain),
            ("response of red", red),
            ("response of green", green),
            ("response of blue", blue),
        ] {
            if !(value > 0.0 && value <= MAX_FACTOR) {
                return Err(Error::invalid(format!(
                    "the {name} is {value}, but has to be above 0 and at most {MAX_FACTOR}"
                )));
            }
        }
        if self.bits != 8 && self.bits != 16 {
            return Err(Error::invalid(format!(
                "images with {} bits cannot be written: choose 8 or 16",
                self.bits
            )));
        }
        let well = self.full_well_electrons;
        if !(1.0..=MAX_ELECTRONS).contains(&well) && well != f64::INFINITY {
            return Err(Error::invalid(format!(
                "a full well of {well} electrons is not possible: give 1 to {MAX_ELECTRONS}, or \
                 inf for no noise"
            )));
        }
        if !(0.0..=MAX_ELECTRONS).contains(&self.read_noise_electrons) {
            return Err(Error::invalid(format!(
                "a read noise of {} electrons is not possible: give 0 to {MAX_ELECTRONS}",
                self.read_noise_electrons
            )));
        }
        if !(0.0..=MAX_CROSSTALK).contains(&self.crosstalk) {
            return Err(Error::invalid(format!(
                "a crosstalk of {} is not possible: give 0 to {MAX_CROSSTALK}, the fraction of its \
                 signal that a pixel gives to each of four neighbours",
                self.crosstalk
            )));
        }
        self.validate_scale()?;
        self.validate_file()
    }

    fn validate_scale(&self) -> Result<()> {
        if !GAMMAS.contains(&self.gamma) {
            return Err(Error::invalid(format!(
                "a gamma of {} is not possible: give {} to {}, 1 for samples that are linear in \
                 light",
                self.gamma,
                GAMMAS.start(),
                GAMMAS.end()
            )));
        }
        if !(self.saturation > 0.0 && self.saturation <= 1.0) {
            return Err(Error::invalid(format!(
                "samples cannot saturate at {} of full scale: give a number above 0 and up to 1",
                self.saturation
            )));
        }
        let black = self.sample_of(self.black_level);
        if !(0.0..1.0).contains(&self.black_level) || black >= self.saturation {
            return Err(Error::invalid(format!(
                "a black level of {} is not possible: give a fraction of full scale, 0 or more, \
                 whose samples are below saturation, {}",
                self.black_level, self.saturation
            )));
        }
        Ok(())
    }

    fn validate_file(&self) -> Result<()> {
        let Some(quality) = self.jpeg_quality else { return Ok(()) };
        if !(1..=100).contains(&quality) {
            return Err(Error::invalid(format!(
                "a JPEG quality of {quality} is not possible: give 1 to 100, or leave it out for \
                 PNG"
            )));
        }
        if self.bits != 8 || !matches!(self.color, Color::Grey | Color::Rgb) {
            return Err(Error::invalid(format!(
                "JPEG files have 8 bits and are grey or rgb, but these images have {} bits and are \
                 '{}': change the images, or leave out jpeg_quality",
                self.bits,
                self.color.name()
            )));
        }
        Ok(())
    }

    /// Returns the sample of a linear value before saturation, both as fractions of full scale.
    pub(super) fn sample_of(&self, linear: f64) -> f64 {
        let clipped = linear.clamp(0.0, 1.0);
        let is_linear = (self.gamma - 1.0).abs() < f64::EPSILON;
        if is_linear { clipped } else { clipped.powf(1.0 / self.gamma) }
    }
}
