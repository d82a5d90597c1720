//! Conversion of raw samples to grey values that are linear in light.

use pulp::{Arch, NullaryFnOnce};
use rayon::prelude::*;

use super::{Color, Image, RawImage, Samples};
use crate::model::SampleLevels;

/// Smallest number of rows per thread. With fewer rows a second thread does not pay.
const SIDE_BY_SIDE: usize = 128;

impl RawImage {
    /// Returns the image as grey values, to be read whole or in parts, without black level.
    #[must_use]
    pub fn grey(&self) -> Grey<'_> {
        self.grey_between(None)
    }

    /// Returns the image as grey values between the levels of the camera.
    ///
    /// Pixels are full at the plateau of the image, see [`Self::plateau`]. Without a plateau they are full at the saturation
    /// level of the camera, unless the image exceeds it, since the gain may differ.
    #[must_use]
    pub fn grey_between(&self, levels: Option<&SampleLevels>) -> Grey<'_> {
        let range = self.range(levels);
        Grey::between(self, self.channel_gains(range), range)
    }

    /// Returns the samples as fractions of full scale, without gains of the channels or levels of the camera.
    pub(crate) fn as_they_are(&self) -> Grey<'_> {
        Grey::between(self, [1.0; 3], (0.0, self.full_scale()))
    }

    /// Returns the image with its samples, as fractions of the largest sample, raised to a power.
    pub(crate) fn to_the_power(&self, power: f64) -> Self {
        let [largest, _] = self.largest_and_step();
        let (largest, full) = (f64::from(largest).max(1.0), f64::from(u16::MAX));
        #[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss)] // cut to 16 bits
        let raised = |sample: f64| (full * (sample / largest).powf(power)).round() as u16;
        #[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss)] // 16 bits
        let table: Vec<u16> =
            (0..=self.full_scale() as u32).map(|s| raised(f64::from(s))).collect();
        let samples = match &self.samples {
            Samples::Bits8(all) => all.iter().map(|&s| table[usize::from(s)]).collect(),
            Samples::Bits16(all) => all.iter().map(|&s| table[usize::from(s)]).collect(),
        };
        Self { samples: Samples::Bits16(samples), ..*self }
    }

    /// Returns the largest sample, and the largest step of which all samples are multiples: 16 for samples of 12 bits shifted
    /// into 16.
    pub(crate) fn largest_and_step(&self) -> [u16; 2] {
        self.largest_and_step_of_rows(1)
    }

    /// Returns the number of levels that the samples can have, if they were rounded to few; `None` otherwise. It follows from
    /// the step between the samples of every 16th row. (An image with little light has few levels too, but was not rounded.)
    pub(crate) fn rounded_to_levels(&self) -> Option<u32> {
        const ONE_ROW_IN: usize = 16;
        const FEW: u32 = 64;
        let [largest, step] = self.largest_and_step_of_rows(ONE_ROW_IN);
        #[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss)] // 16 bits
        let levels = self.full_scale() as u32 / u32::from(step) + 1;
        // The samples of an image that is full everywhere have one level and no step.
        (levels <= FEW && largest > step).then_some(levels)
    }

    fn largest_and_step_of_rows(&self, one_in: usize) -> [u16; 2] {
        fn of(samples: impl Iterator<Item = u16>) -> [u16; 2] {
            let (mut largest, mut step) = (0, 0);
            for sample in samples {
                largest = largest.max(sample);
                let (mut a, mut b) = (step, sample);
                while step != 1 && b != 0 {
                    (a, b) = (b, a % b);
                }
                step = if step == 1 { 1 } else { a };
            }
            [largest, step.max(1)]
        }
        let row = (self.width * self.color.samples()).max(1);
        match &self.samples {
            Samples::Bits8(all) => {
                of(all.chunks(row).step_by(one_in).flatten().map(|&sample| u16::from(sample)))
            }
            Samples::Bits16(all) => of(all.chunks(row).step_by(one_in).flatten().copied()),
        }
    }

    /// Returns the sample without light and the sample of full pixels.
    pub(super) fn range(&self, levels: Option<&SampleLevels>) -> (f64, f64) {
        let full = self.full_scale();
        let (black, saturation) = levels.map_or((0.0, None), SampleLevels::parts);
        let of_camera = || saturation.map(|part| part * full).filter(|level| !self.exceeds(*level));
        let black = black * full;
        // An image without light has a plateau at the black level.
        let own = self.plateau().filter(|level| *level > black);
        (black, own.or_else(of_camera).unwrap_or(full))
    }

    /// Returns the whole image in grey, see [`Grey`].
    #[must_use]
    pub fn to_grey(&self) -> Image {
        self.grey().part(0, 0, self.width, self.height)
    }

    /// Returns the amplification of red, green and blue.
    #[allow(clippy::cast_possible_truncation)] // single precision, as grey values
    fn channel_gains(&self, range: (f64, f64)) -> [f32; 3] {
        let mut sums = [(0.0, 0.0); 3];
        if self.color != Color::Grey {
            self.compared(range, |_, place| {
                for &(channel, part) in place {
                    sums[channel].0 += part;
                    sums[channel].1 += 1.0;
                }
            });
        }
        let means = sums.map(|(sum, count)| sum / count);
        let strongest = means.iter().copied().fold(f64::NAN, f64::max);
        // An image that is dark or saturated everywhere has nothing to compare.
        means.map(|mean| if mean > 0.0 { (strongest / mean) as f32 } else { 1.0 })
    }
}

/// A row of samples without colours, and its grey values.
struct GreyRow<'a, T> {
    samples: &'a [T],
    pixels: &'a mut [f32],
    black: f32,
    scale: f32,
}

impl<T: Copy + Into<f32>> NullaryFnOnce for GreyRow<'_, T> {
    type Output = ();

    // Only functions inlined into a dispatched one are compiled for its registers.
    #[allow(clippy::inline_always)]
    #[inline(always)]
    fn call(self) {
        let Self { samples, pixels, black, scale } = self;
        let n = pixels.len();
        let samples = &samples[..n];
        for i in 0..n {
            let light = (samples[i].into() - black) * scale;
            pixels[i] = if light > 1.0 { 1.0 } else { light };
        }
    }
}

/// A raw image as grey values, linear from 0 to 1, at full resolution.
///
/// Black level and saturation level become 0 and 1. Noise about black is kept: values may be
/// negative.
///
/// The light is assumed to be neutral. Channels are amplified so that all respond like the strongest
/// one, by their means over places where none is saturated. Then all are clipped at 1, where the
/// strongest one saturates. So a pixel of 1 is saturated, for any colour.
#[derive(Debug, Clone, Copy)]
pub struct Grey<'a> {
    raw: &'a RawImage,
    gains: [f32; 3],
    /// Black level, grey levels.
    black: f32,
    /// Light per grey level.
    scale: f32,
}

impl Grey<'_> {
    /// Creates grey values between these samples.
    #[allow(clippy::cast_possible_truncation)] // samples have 16 bits
    fn between(raw: &RawImage, gains: [f32; 3], (black, white): (f64, f64)) -> Grey<'_> {
        let range = (white - black) as f32;
        // Rounded up, so that a full pixel is never below 1.
        let mut scale = (1.0 / range).next_up();
        while (white as f32 - black as f32) * scale < 1.0 {
            scale = scale.next_up();
        }
        Grey { raw, gains, black: black as f32, scale }
    }

    /// Returns the light of a sample of 0 in the strongest channel. Noise below it is clipped.
    #[must_use]
    pub fn floor(&self) -> f64 {
        f64::from(-self.black * self.scale)
    }

    /// Returns width and height of the whole image, px.
    #[must_use]
    pub fn size(&self) -> (usize, usize) {
        (self.raw.width, self.raw.height)
    }

    /// Returns a part of the image, cut at its borders.
    #[must_use]
    pub fn part(&self, left: usize, top: usize, width: usize, height: usize) -> Image {
        match &self.raw.samples {
            Samples::Bits8(samples) => self.part_of(samples, (left, top), (width, height)),
            Samples::Bits16(samples) => self.part_of(samples, (left, top), (width, height)),
        }
    }

    fn part_of<T: Copy + Into<f32> + Sync>(
        &self,
        samples: &[T],
        (left, top): (usize, usize),
        (width, height): (usize, usize),
    ) -> Image {
        let raw = self.raw;
        let (right, bottom) = (raw.width.min(left + width), raw.height.min(top + height));
        let (width, height) = (right.saturating_sub(left), bottom.saturating_sub(top));
        let mut pixels = vec![0.0; width * height];
        if width > 0 {
            let rows = pixels.par_chunks_exact_mut(width).enumerate();
            let fill = |(row, pixels): (usize, &mut [f32])| {
                self.row_of(samples, (left, top + row), pixels);
            };
            rows.with_min_len(SIDE_BY_SIDE).for_each(fill);
        }
        Image { width, height, pixels }
    }

    /// Reads pixels of a row, starting at (u, v).
    #[inline]
    pub(crate) fn read_row(&self, from: (usize, usize), pixels: &mut [f32]) {
        match &self.raw.samples {
            Samples::Bits8(samples) => self.row_of(samples, from, pixels),
            Samples::Bits16(samples) => self.row_of(samples, from, pixels),
        }
    }

    #[inline]
    fn row_of<T: Copy + Into<f32>>(
        &self,
        samples: &[T],
        (left, v): (usize, usize),
        pixels: &mut [f32],
    ) {
        let (color, black, scale) = (self.raw.color, self.black, self.scale);
        let per_pixel = color.samples();
        let first = (v * self.raw.width + left) * per_pixel;
        let samples = &samples[first..][..pixels.len() * per_pixel];
        let value = |sample: T, gain: f32| ((sample.into() - black) * scale * gain).min(1.0);
        match color {
            Color::Grey => {
                Arch::new().dispatch(GreyRow { samples, pixels, black, scale });
            }
            Color::Rgb => {
                for (pixel, rgb) in pixels.iter_mut().zip(samples.chunks_exact(3)) {
                    let sum: f32 = (0..3).map(|c| value(rgb[c], self.gains[c])).sum();
                    *pixel = sum / 3.0;
                }
            }
            mosaic => {
                let gain = |u| self.gains[mosaic.mosaic(u, v).unwrap_or_default()];
                let gains = [gain(left), gain(left + 1)];
                for (u, (pixel, &sample)) in pixels.iter_mut().zip(samples).enumerate() {
                    *pixel = value(sample, gains[u % 2]);
                }
            }
        }
    }
}
