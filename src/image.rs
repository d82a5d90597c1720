//! Images: linear grey values to compute with, and samples as a camera delivers them.

use rayon::prelude::*;
use serde::{Deserialize, Serialize};

/// A grey image in linear light, row by row from the top.
#[derive(Debug, Clone, PartialEq)]
pub struct Image {
    /// Width, px.
    pub width: usize,
    /// Height, px.
    pub height: usize,
    /// `width · height` values.
    pub pixels: Vec<f32>,
}

impl Image {
    /// The value of pixel (u, v).
    ///
    /// # Panics
    /// If there is no such pixel.
    #[must_use]
    pub fn at(&self, u: usize, v: usize) -> f32 {
        assert!(u < self.width, "the image is {} px wide", self.width);
        self.pixels[v * self.width + u]
    }
}

/// What the samples of a raw image stand for.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Color {
    /// One sample a pixel.
    Grey,
    /// Red, green and blue of every pixel.
    Rgb,
    /// One sample a pixel behind a colour mosaic; the name gives the first two pixels of the first
    /// two rows.
    BayerRggb,
    /// As before.
    BayerGrbg,
    /// As before.
    BayerGbrg,
    /// As before.
    BayerBggr,
}

impl Color {
    /// The name used in files.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::Grey => "grey",
            Self::Rgb => "rgb",
            Self::BayerRggb => "bayer-rggb",
            Self::BayerGrbg => "bayer-grbg",
            Self::BayerGbrg => "bayer-gbrg",
            Self::BayerBggr => "bayer-bggr",
        }
    }

    /// Samples per pixel.
    #[must_use]
    pub fn samples(self) -> usize {
        if self == Self::Rgb { 3 } else { 1 }
    }

    /// The colour (0 red, 1 green, 2 blue) that a mosaic has at pixel (u, v).
    #[must_use]
    pub fn mosaic(self, u: usize, v: usize) -> Option<usize> {
        let square = match self {
            Self::Grey | Self::Rgb => return None,
            Self::BayerRggb => [0, 1, 1, 2],
            Self::BayerGrbg => [1, 0, 2, 1],
            Self::BayerGbrg => [1, 2, 0, 1],
            Self::BayerBggr => [2, 1, 1, 0],
        };
        Some(square[2 * (v % 2) + u % 2])
    }
}

/// An image as a camera delivers it: whole numbers from 0 to `2^bits − 1`.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct RawImage {
    /// Width, px.
    pub width: usize,
    /// Height, px.
    pub height: usize,
    /// What the samples stand for.
    pub color: Color,
    /// 8 or 16.
    pub bits: u32,
    /// `width · height · color.samples()` values, row by row.
    pub samples: Vec<u16>,
}

/// Samples from here on, in parts of full scale, are too near to it to tell colours by.
const NEARLY_FULL: f64 = 0.95;
/// Samples below this part of full scale are mostly noise.
const NEARLY_DARK: f64 = 0.02;

impl RawImage {
    /// The largest value that a sample can have.
    #[must_use]
    pub fn full_scale(&self) -> f64 {
        f64::from((1_u32 << self.bits) - 1)
    }

    /// The image in grey, linear from 0 to 1, at full resolution.
    ///
    /// Light is taken to be neutral: channels are amplified so that all respond as the strongest one
    /// does, by the sums over places where none is full. Then all are cut at 1, where the strongest
    /// one is full, so that a pixel of 1 is a saturated one, whatever its colour.
    #[must_use]
    pub fn to_grey(&self) -> Image {
        let gains = self.channel_gains();
        let scale = 1.0 / self.full_scale();
        // Sample by channel to grey value, for every value that there is.
        let tables: Vec<Vec<f32>> = gains
            .iter()
            .map(|gain| {
                let value = |sample: u32| (f64::from(sample) * scale * gain).min(1.0);
                #[allow(clippy::cast_possible_truncation)] // samples have 16 bits at most
                let table = (0..1_u32 << self.bits).map(|sample| value(sample) as f32);
                table.collect()
            })
            .collect();
        let look_up = |channel: usize, sample: u16| tables[channel][usize::from(sample)];
        let pixels = match self.color {
            Color::Grey => self.samples.par_iter().map(|&s| look_up(0, s)).collect(),
            Color::Rgb => {
                let mean = |rgb: &[u16]| {
                    (0..3).map(|channel| look_up(channel, rgb[channel])).sum::<f32>() / 3.0
                };
                self.samples.par_chunks_exact(3).map(mean).collect()
            }
            mosaic => {
                let row = |(v, row): (usize, &[u16])| {
                    let value = |(u, &s): (usize, &u16)| {
                        look_up(mosaic.mosaic(u, v).unwrap_or_default(), s)
                    };
                    row.iter().enumerate().map(value).collect::<Vec<f32>>()
                };
                self.samples.par_chunks_exact(self.width).enumerate().flat_map_iter(row).collect()
            }
        };
        Image { width: self.width, height: self.height, pixels }
    }

    /// Amplification of each channel: of red, green and blue, or of grey alone.
    fn channel_gains(&self) -> Vec<f64> {
        let channels = if self.color == Color::Grey { 1 } else { 3 };
        if channels == 1 {
            return vec![1.0];
        }
        let usable = NEARLY_DARK * self.full_scale()..NEARLY_FULL * self.full_scale();
        let mut sums = vec![(0.0, 0.0); channels];
        let mut add = |place: &[(usize, u16)]| {
            if place.iter().all(|&(_, sample)| usable.contains(&f64::from(sample))) {
                for &(channel, sample) in place {
                    sums[channel].0 += f64::from(sample);
                    sums[channel].1 += 1.0;
                }
            }
        };
        if self.color == Color::Rgb {
            for rgb in self.samples.chunks_exact(3) {
                add(&[(0, rgb[0]), (1, rgb[1]), (2, rgb[2])]);
            }
        } else {
            for (v, rows) in self.samples.chunks_exact(2 * self.width).enumerate() {
                let (upper, lower) = rows.split_at(self.width);
                let squares = upper.chunks_exact(2).zip(lower.chunks_exact(2)).enumerate();
                for (u, (upper, lower)) in squares {
                    let channel = |u, v| self.color.mosaic(u, v).unwrap_or_default();
                    let (u, v) = (2 * u, 2 * v);
                    add(&[
                        (channel(u, v), upper[0]),
                        (channel(u + 1, v), upper[1]),
                        (channel(u, v + 1), lower[0]),
                        (channel(u + 1, v + 1), lower[1]),
                    ]);
                }
            }
        }
        let means: Vec<f64> = sums.iter().map(|&(sum, count)| sum / count).collect();
        let strongest = means.iter().copied().fold(f64::NAN, f64::max);
        // Nothing to go by: an image all dark or full.
        let gain = |mean: &f64| if *mean > 0.0 { strongest / mean } else { 1.0 };
        means.iter().map(gain).collect()
    }

    /// Means of the samples at even and odd columns of even rows, then of odd rows, over places where
    /// none is full or dark, in parts of full scale; `None` if there are no such places. They differ
    /// behind a colour mosaic, but for its two green ones, and in a grey image they do not.
    #[must_use]
    pub fn parity_means(&self) -> Option<[f64; 4]> {
        if self.color == Color::Rgb {
            return None;
        }
        let usable = NEARLY_DARK * self.full_scale()..NEARLY_FULL * self.full_scale();
        let (mut sums, mut count) = ([0.0; 4], 0.0);
        for rows in self.samples.chunks_exact(2 * self.width) {
            let (upper, lower) = rows.split_at(self.width);
            for (upper, lower) in upper.chunks_exact(2).zip(lower.chunks_exact(2)) {
                let square = [upper[0], upper[1], lower[0], lower[1]].map(f64::from);
                if square.iter().all(|sample| usable.contains(sample)) {
                    count += 1.0;
                    for (sum, sample) in sums.iter_mut().zip(square) {
                        *sum += sample;
                    }
                }
            }
        }
        (count > 0.0).then(|| sums.map(|sum| sum / count / self.full_scale()))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A square of grey as a mosaic, with channels that respond 0.5, 1 and 0.25.
    fn mosaic(color: Color, levels: &[f64]) -> RawImage {
        let width = 2 * levels.len();
        let response = [0.5, 1.0, 0.25];
        let sample = |i: usize| {
            let (u, v) = (i % width, i / width);
            let light = levels[u / 2] * response[color.mosaic(u, v).unwrap()];
            #[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss)]
            let sample = (light * 65_535.0).round().min(65_535.0) as u16;
            sample
        };
        let samples = (0..2 * width).map(sample).collect();
        RawImage { width, height: 2, color, bits: 16, samples }
    }

    #[test]
    fn every_mosaic_becomes_grey_and_is_cut_where_green_is_full() {
        for color in [Color::BayerRggb, Color::BayerGrbg, Color::BayerGbrg, Color::BayerBggr] {
            let grey = mosaic(color, &[0.3, 0.6, 0.9, 1.5]).to_grey();
            for v in 0..2 {
                for (u, level) in [0.3, 0.3, 0.6, 0.6, 0.9, 0.9, 1.0, 1.0].into_iter().enumerate() {
                    // Rounding of the weakest channel, amplified four times.
                    assert!((grey.at(u, v) - level).abs() < 1e-4, "{color:?} at ({u}, {v})");
                }
            }
            assert!(grey.pixels[6..8].iter().all(|&p| p >= 1.0));
        }
    }

    #[test]
    fn a_mosaic_shows_in_the_means_of_its_squares() {
        let image = mosaic(Color::BayerGrbg, &[0.2, 0.4]);
        let [a, b, c, d] = image.parity_means().unwrap();
        assert!((a / d - 1.0).abs() < 1e-3 && (b / a - 0.5).abs() < 1e-3);
        assert!((c / a - 0.25).abs() < 1e-3);
    }
}
