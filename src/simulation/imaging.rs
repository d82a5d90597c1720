//! The sensor: from irradiance to whole numbers.

use rand::SeedableRng;
use rand::rngs::StdRng;
use rand_distr::{Distribution, Normal, Poisson};
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

use super::sampling::hash;
use crate::camera::positive;
use crate::error::{Error, Result};
use crate::image::{Color, Image, RawImage};

/// How the sensor is set and how good it is. The response is linear.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Imaging {
    /// What the middle of the brightest micro-image of a white target fills of a pixel's full well;
    /// above 1 it overflows.
    pub exposure: f64,
    /// Amplification after the pixel: with 4 a quarter of the full well is full scale.
    pub gain: f64,
    /// 8 or 16.
    pub bits: u32,
    /// Grey, RGB or a colour mosaic.
    pub color: Color,
    /// Response of red, green and blue pixels; grey ones respond with 1.
    pub channel_response: [f64; 3],
    /// Electrons in a full pixel, which decide on the shot noise; `inf` for none.
    pub full_well_electrons: f64,
    /// Standard deviation of the read noise, electrons.
    pub read_noise_electrons: f64,
}

impl Default for Imaging {
    /// An 8-bit grey image, well exposed, with the noise of a middling CMOS sensor.
    fn default() -> Self {
        Self {
            exposure: 0.8,
            gain: 1.0,
            bits: 8,
            color: Color::Grey,
            channel_response: [0.6, 1.0, 0.7],
            full_well_electrons: 13_000.0,
            read_noise_electrons: 13.0,
        }
    }
}

impl Imaging {
    pub(super) fn validate(&self) -> Result<()> {
        positive(self.exposure, "the exposure")?;
        positive(self.gain, "the gain")?;
        for response in self.channel_response {
            positive(response, "the response of a colour channel")?;
        }
        if self.bits != 8 && self.bits != 16 {
            return Err(Error::invalid(format!(
                "images of {} bits cannot be written; choose 8 or 16",
                self.bits
            )));
        }
        if self.full_well_electrons.is_nan() || self.full_well_electrons < 1.0 {
            return Err(Error::invalid(format!(
                "a full well of {} electrons is not possible; give 1 or more, or inf for no shot \
                 noise",
                self.full_well_electrons
            )));
        }
        if !self.read_noise_electrons.is_finite() || self.read_noise_electrons < 0.0 {
            return Err(Error::invalid(format!(
                "a read noise of {} electrons is not possible; give 0 or more",
                self.read_noise_electrons
            )));
        }
        Ok(())
    }

    /// Reads out an image of irradiance relative to the reference, see
    /// [`Tracer::render`](super::Tracer::render). The same seed gives the same noise.
    pub fn read_out(&self, irradiance: &Image, seed: u64) -> Result<RawImage> {
        self.validate()?;
        let Image { width, height, .. } = *irradiance;
        let per_row = width * self.color.samples();
        let mut samples = vec![0; per_row * height];
        let read_noise = Normal::new(0.0, self.read_noise_electrons)
            .map_err(|e| Error::invalid(format!("the read noise: {e}")))?;
        samples.par_chunks_mut(per_row).enumerate().for_each(|(v, row)| {
            // A stream for each row, so that threads do not matter.
            let mut random = StdRng::seed_from_u64(hash([seed, v as u64, 0, 1]));
            for (u, pixel) in row.chunks_mut(self.color.samples()).enumerate() {
                let light = f64::from(irradiance.at(u, v)) * self.exposure;
                for (channel, sample) in pixel.iter_mut().enumerate() {
                    let response = match self.color {
                        Color::Grey => 1.0,
                        Color::Rgb => self.channel_response[channel],
                        mosaic => self.channel_response[mosaic.mosaic(u, v).unwrap_or(1)],
                    };
                    *sample = self.sample(light * response, read_noise, &mut random);
                }
            }
        });
        Ok(RawImage { width, height, color: self.color, bits: self.bits, samples })
    }

    /// One sample for a mean signal in parts of the full well.
    fn sample(&self, signal: f64, read_noise: Normal<f64>, random: &mut StdRng) -> u16 {
        let well = self.full_well_electrons;
        let noisy = if well.is_finite() {
            // No photons, no shot noise; Poisson takes positive means only.
            let shot = Poisson::new(signal * well).map_or(0.0, |p| p.sample(random));
            (shot + read_noise.sample(random)) / well
        } else {
            signal
        };
        let full_scale = f64::from((1_u32 << self.bits) - 1);
        let value = (noisy.min(1.0) * self.gain * full_scale).round().clamp(0.0, full_scale);
        #[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss)] // clamped
        let value = value as u16;
        value
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn flat(value: f32) -> Image {
        Image { width: 200, height: 100, pixels: vec![value; 20_000] }
    }

    fn moments(image: &RawImage) -> (f64, f64) {
        let n = image.samples.len() as f64;
        let mean = image.samples.iter().map(|&s| f64::from(s)).sum::<f64>() / n;
        let variance =
            image.samples.iter().map(|&s| (f64::from(s) - mean).powi(2)).sum::<f64>() / n;
        (mean, variance)
    }

    #[test]
    fn noise_has_the_size_of_photons_and_read_out() {
        let imaging = Imaging { bits: 16, exposure: 0.5, ..Imaging::default() };
        let (mean, variance) = moments(&imaging.read_out(&flat(0.6), 1).unwrap());
        let scale = 65_535.0 / imaging.full_well_electrons;
        let electrons = 0.3 * imaging.full_well_electrons;
        let expected = (electrons + imaging.read_noise_electrons.powi(2)) * scale * scale;
        // 20 000 samples know the mean to σ/141 and the variance to 1 %.
        assert!((mean / (electrons * scale) - 1.0).abs() < 4.0 / 141.0 / electrons.sqrt());
        assert!((variance / expected - 1.0).abs() < 0.04, "{variance} for {expected}");
    }

    #[test]
    fn exposure_overflows_the_pixel_and_gain_the_converter() {
        let ideal = Imaging { full_well_electrons: f64::INFINITY, ..Imaging::default() };
        let value = |imaging: Imaging, light| imaging.read_out(&flat(light), 0).unwrap().samples[0];
        assert_eq!(value(Imaging { exposure: 1.0, ..ideal }, 0.5), 128);
        assert_eq!(value(Imaging { exposure: 4.0, ..ideal }, 0.5), 255);
        assert_eq!(value(Imaging { exposure: 4.0, gain: 0.5, ..ideal }, 0.5), 128);
        assert_eq!(value(Imaging { exposure: 0.1, gain: 4.0, ..ideal }, 0.5), 51);
        assert_eq!(value(Imaging { exposure: 1.0, gain: 4.0, ..ideal }, 0.5), 255);
    }

    #[test]
    fn colours_are_where_the_name_says() {
        let ideal = Imaging {
            full_well_electrons: f64::INFINITY,
            exposure: 1.0,
            bits: 16,
            channel_response: [0.2, 0.4, 0.8],
            ..Imaging::default()
        };
        let [r, g, b] = [13_107, 26_214, 52_428];
        let read = |color| Imaging { color, ..ideal }.read_out(&flat(1.0), 0).unwrap();
        let image = read(Color::BayerGbrg);
        assert_eq!(image.samples[..2], [g, b]);
        assert_eq!(image.samples[200..202], [r, g]);
        let image = read(Color::Rgb);
        assert_eq!(image.samples.len(), 60_000);
        assert_eq!(image.samples[..6], [r, g, b, r, g, b]);
    }
}
