//! The sensor: from irradiance to samples.

use rand::SeedableRng;
use rand::rngs::StdRng;
use rand_distr::{Distribution, Normal, Poisson};
use rayon::prelude::*;

use super::imaging::Imaging;
use super::sampling::hash;
use crate::error::{Error, Result};
use crate::image::{Color, Image, RawImage, Samples};

/// Seed of the positions of hot pixels, which changes nothing else.
const HOT: u64 = 0x0068_6f74;

impl Imaging {
    /// Reads out an image of irradiance relative to the reference, see
    /// [`Tracer::render`](super::Tracer::render). The same `seed` gives the same noise, and the same
    /// `sensor_seed` the same hot pixels.
    pub fn read_out(&self, irradiance: &Image, sensor_seed: u64, seed: u64) -> Result<RawImage> {
        self.validate()?;
        let Image { width, height, .. } = *irradiance;
        if irradiance.pixels.is_empty() {
            return Err(Error::invalid("an image without pixels cannot be read out"));
        }
        let per_row = width * self.color.samples();
        let mut samples = vec![0; per_row * height];
        let read_noise = Normal::new(0.0, self.read_noise_electrons)
            .map_err(|e| Error::invalid(format!("the read noise: {e}")))?;
        samples.par_chunks_mut(per_row).enumerate().for_each(|(v, row)| {
            // Each row has its own random stream, so that the number of threads has no effect.
            let mut random = StdRng::seed_from_u64(hash([seed, v as u64, 0, 1]));
            for (u, pixel) in row.chunks_mut(self.color.samples()).enumerate() {
                for (channel, sample) in pixel.iter_mut().enumerate() {
                    let signal = self.mixed_signal(irradiance, [u, v], channel);
                    *sample = self.sample(signal, read_noise, &mut random);
                }
            }
        });
        for pixel in self.hot(width * height, sensor_seed)? {
            let channels = self.color.samples();
            samples[pixel * channels..][..channels].fill(self.largest_sample());
        }
        let samples = if self.bits == 8 {
            #[allow(clippy::cast_possible_truncation)] // at most full scale
            Samples::Bits8(samples.into_iter().map(|s: u16| s as u8).collect())
        } else {
            Samples::Bits16(samples)
        };
        Ok(RawImage { width, height, color: self.color, samples })
    }

    /// Returns the mean signal of a channel of a pixel, as a fraction of the full well, without crosstalk.
    fn signal(&self, irradiance: &Image, [u, v]: [usize; 2], channel: usize) -> f64 {
        let response = match self.color {
            Color::Grey => 1.0,
            Color::Rgb => self.channel_response[channel],
            mosaic => self.channel_response[mosaic.mosaic(u, v).unwrap_or(1)],
        };
        f64::from(irradiance.at(u, v)) * self.exposure * response
    }

    /// Returns the mean signal of a channel of a pixel, as a fraction of the full well, with crosstalk.
    fn mixed_signal(&self, irradiance: &Image, [u, v]: [usize; 2], channel: usize) -> f64 {
        let own = self.signal(irradiance, [u, v], channel);
        if self.crosstalk == 0.0 {
            return own;
        }
        let neighbours = [[u.wrapping_sub(1), v], [u + 1, v], [u, v.wrapping_sub(1)], [u, v + 1]];
        let inside = |[u, v]: &[usize; 2]| *u < irradiance.width && *v < irradiance.height;
        let more = neighbours.into_iter().filter(inside);
        let more = more.map(|place| self.signal(irradiance, place, channel) - own);
        own + self.crosstalk * more.sum::<f64>()
    }

    /// Draws one sample for a mean signal given as a fraction of the full well.
    fn sample(&self, signal: f64, read_noise: Normal<f64>, random: &mut StdRng) -> u16 {
        let well = self.full_well_electrons;
        let noisy = if well.is_finite() {
            let mean = signal * well;
            // Only a mean of 0 is rejected; it gives 0 without noise.
            let shot = Poisson::new(mean).map_or(mean, |p| p.sample(random));
            (shot.min(well) + read_noise.sample(random)) / well
        } else {
            signal.min(1.0)
        };
        self.rounded(self.sample_of(noisy * self.gain + self.black_level).min(self.saturation))
    }

    fn largest_sample(&self) -> u16 {
        self.rounded(self.saturation)
    }

    fn rounded(&self, part: f64) -> u16 {
        let full_scale = f64::from((1_u32 << self.bits) - 1);
        #[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss)] // from 0 to 1
        let sample = (part * full_scale).round() as u16;
        sample
    }

    /// Draws the hot ones among a number of pixels.
    fn hot(&self, pixels: usize, seed: u64) -> Result<Vec<usize>> {
        if self.hot_pixels > pixels {
            return Err(Error::invalid(format!(
                "{} hot pixels are more than the {pixels} pixels of the image",
                self.hot_pixels
            )));
        }
        let mut random = StdRng::seed_from_u64(seed ^ HOT);
        Ok(rand::seq::index::sample(&mut random, pixels, self.hot_pixels).into_vec())
    }
}

#[cfg(test)]
mod tests {
    use super::super::imaging::{MAX_ELECTRONS, MAX_FACTOR};
    use super::*;

    fn flat(value: f32) -> Image {
        Image { width: 200, height: 100, pixels: vec![value; 20_000] }
    }

    fn samples(image: &RawImage) -> Vec<u16> {
        match &image.samples {
            Samples::Bits8(samples) => samples.iter().map(|&s| u16::from(s)).collect(),
            Samples::Bits16(samples) => samples.clone(),
        }
    }

    fn moments(image: &RawImage) -> (f64, f64) {
        let samples = samples(image);
        let n = samples.len() as f64;
        let mean = samples.iter().map(|&s| f64::from(s)).sum::<f64>() / n;
        let variance = samples.iter().map(|&s| (f64::from(s) - mean).powi(2)).sum::<f64>() / n;
        (mean, variance)
    }

    #[test]
    fn noise_is_shot_noise_plus_read_noise() {
        let imaging = Imaging { bits: 16, exposure: 0.5, ..Imaging::default() };
        let (mean, variance) = moments(&imaging.read_out(&flat(0.6), 0, 1).unwrap());
        let scale = 65_535.0 / imaging.full_well_electrons;
        let electrons = 0.3 * imaging.full_well_electrons;
        let expected = (electrons + imaging.read_noise_electrons.powi(2)) * scale * scale;
        // 20 000 samples determine the mean to σ/141 and the variance to 1 %.
        assert!((mean / (electrons * scale) - 1.0).abs() < 4.0 / 141.0 / electrons.sqrt());
        assert!((variance / expected - 1.0).abs() < 0.04, "{variance} for {expected}");
    }

    #[test]
    fn exposure_overflows_the_pixel_and_gain_the_converter() {
        let ideal = Imaging { full_well_electrons: f64::INFINITY, ..Imaging::default() };
        let value =
            |imaging: Imaging, light| samples(&imaging.read_out(&flat(light), 0, 0).unwrap())[0];
        assert_eq!(value(Imaging { exposure: 1.0, ..ideal }, 0.5), 128);
        assert_eq!(value(Imaging { exposure: 4.0, ..ideal }, 0.5), 255);
        assert_eq!(value(Imaging { exposure: 4.0, gain: 0.5, ..ideal }, 0.5), 128);
        assert_eq!(value(Imaging { exposure: 0.1, gain: 4.0, ..ideal }, 0.5), 51);
        assert_eq!(value(Imaging { exposure: 1.0, gain: 4.0, ..ideal }, 0.5), 255);
    }

    /// A full pixel has the read noise of its amplifier; the strongest light gives white.
    #[test]
    fn full_pixels_keep_their_read_noise() {
        let imaging = Imaging {
            exposure: MAX_FACTOR,
            gain: 0.5,
            full_well_electrons: 100.0,
            read_noise_electrons: 5.0,
            ..Imaging::default()
        };
        let (mean, variance) = moments(&imaging.read_out(&flat(1.0), 0, 3).unwrap());
        // 5 of 100 electrons at half the range of 255, plus 1/12 for rounding.
        let expected = (0.05_f64 * 0.5 * 255.0).powi(2) + 1.0 / 12.0;
        assert!((mean - 127.5).abs() < 4.0 * expected.sqrt() / 141.0, "{mean}");
        assert!((variance / expected - 1.0).abs() < 0.04, "{variance} for {expected}");
        let strongest = Imaging { full_well_electrons: MAX_ELECTRONS, gain: 1.0, ..imaging };
        assert!(samples(&strongest.read_out(&flat(1.0), 0, 3).unwrap()).iter().all(|&s| s == 255));
    }

    #[test]
    fn colour_channels_follow_the_name_of_the_mosaic() {
        let ideal = Imaging {
            full_well_electrons: f64::INFINITY,
            exposure: 1.0,
            bits: 16,
            channel_response: [0.2, 0.4, 0.8],
            ..Imaging::default()
        };
        let [r, g, b] = [13_107, 26_214, 52_428];
        let read = |color| samples(&Imaging { color, ..ideal }.read_out(&flat(1.0), 0, 0).unwrap());
        let image = read(Color::BayerGbrg);
        assert_eq!(image[..2], [g, b]);
        assert_eq!(image[200..202], [r, g]);
        let image = read(Color::Rgb);
        assert_eq!(image.len(), 60_000);
        assert_eq!(image[..6], [r, g, b, r, g, b]);
    }

    fn ideal() -> Imaging {
        Imaging { full_well_electrons: f64::INFINITY, exposure: 1.0, ..Imaging::default() }
    }

    /// The image has 5 × 3 pixels, of which one in the middle and one in a corner are bright.
    #[test]
    fn neighbours_share_a_signal_and_lose_none_of_it() {
        let mut image = Image { width: 5, height: 3, pixels: vec![0.0; 15] };
        (image.pixels[7], image.pixels[0]) = (0.8, 0.4);
        let imaging = Imaging { crosstalk: 0.1, bits: 16, ..ideal() };
        let found = samples(&imaging.read_out(&image, 0, 0).unwrap());
        let parts: [f64; 15] =
            [0.32, 0.04, 0.08, 0.0, 0.0, 0.04, 0.08, 0.48, 0.08, 0.0, 0.0, 0.0, 0.08, 0.0, 0.0];
        assert_eq!(found, parts.map(|part| imaging.rounded(part)));
    }

    /// A red pixel away from the border has four green neighbours: 0.2 + 4 · 0.1 (0.6 − 0.2) = 0.36.
    #[test]
    fn crosstalk_is_behind_the_mosaic() {
        let imaging = Imaging {
            crosstalk: 0.1,
            bits: 16,
            color: Color::BayerRggb,
            channel_response: [0.2, 0.6, 0.4],
            ..ideal()
        };
        let found = samples(&imaging.read_out(&flat(1.0), 0, 0).unwrap());
        assert_eq!(found[2 * 200 + 2], 23_593);
    }

    #[test]
    fn samples_follow_black_level_gamma_and_saturation_in_this_order() {
        let sample =
            |imaging: Imaging, light| samples(&imaging.read_out(&flat(light), 0, 0).unwrap())[0];
        let black = Imaging { black_level: 16.0 / 255.0, ..ideal() };
        assert_eq!([sample(black, 0.0), sample(black, 0.4), sample(black, 0.95)], [16, 118, 255]);
        // The gain does not raise the black level.
        assert_eq!(sample(Imaging { gain: 2.0, ..black }, 0.1), 67);
        let gamma = Imaging { gamma: 2.0, ..ideal() };
        assert_eq!([sample(gamma, 0.0), sample(gamma, 0.36), sample(gamma, 2.0)], [0, 153, 255]);
        // The samples are the square roots of 0.09 and 0.36.
        let both = Imaging { black_level: 0.09, ..gamma };
        assert_eq!([sample(both, 0.0), sample(both, 0.27)], [77, 153]);
        // Saturation applies to full scale, not to light: its square root is 0.95.
        let full = Imaging { saturation: 0.9, bits: 16, ..gamma };
        assert_eq!([sample(full, 0.36), sample(full, 0.9)], [39_321, 58_982]);
    }

    /// Without a black level, half of the read noise would be cut off.
    #[test]
    fn a_black_level_keeps_the_read_noise_of_dark_pixels() {
        let imaging = Imaging {
            bits: 16,
            black_level: 0.05,
            full_well_electrons: 1000.0,
            read_noise_electrons: 10.0,
            ..Imaging::default()
        };
        let (mean, variance) = moments(&imaging.read_out(&flat(0.0), 0, 7).unwrap());
        assert!((mean / 65_535.0 - 0.05).abs() < 4.0 * 0.01 / 141.0, "{mean}");
        assert!((variance.sqrt() / 65_535.0 / 0.01 - 1.0).abs() < 0.02, "{variance}");
    }

    #[test]
    fn hot_pixels_stay_where_they_are() {
        let hot = |saturation, sensor_seed, seed| {
            let color = Color::Rgb;
            let imaging = Imaging { hot_pixels: 25, saturation, color, ..Imaging::default() };
            let image = imaging.read_out(&flat(0.1), sensor_seed, seed).unwrap();
            let pixels: Vec<Vec<u16>> = samples(&image).chunks(3).map(<[u16]>::to_vec).collect();
            let hot: Vec<usize> = (0..pixels.len()).filter(|&i| pixels[i][1] > 200).collect();
            assert!(hot.iter().all(|&i| pixels[i] == [pixels[hot[0]][0]; 3]));
            (pixels[hot[0]][0], hot)
        };
        let (sample, places) = hot(1.0, 1, 1);
        assert_eq!((sample, places.len()), (255, 25));
        assert_eq!(hot(0.9, 1, 2), (230, places.clone()));
        assert_ne!(hot(1.0, 2, 1).1, places);
        let too_many = Imaging { hot_pixels: 20_001, ..Imaging::default() };
        let error = too_many.read_out(&flat(0.1), 0, 0).unwrap_err().to_string();
        assert!(error.contains("20001 hot pixels are more than the 20000"), "{error}");
    }
}
