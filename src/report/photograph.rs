//! An image of the camera as a picture of a page, reduced.

use image::codecs::jpeg::JpegEncoder;
use image::{GrayImage, Luma};

use crate::error::{Error, Result};
use crate::image::RawImage;

/// Largest width, px.
const WIDTH: usize = 1400;
/// Largest width of a picture that is one of many on a page, px.
const SMALL_WIDTH: usize = 700;
/// JPEG quality, up to 100.
const QUALITY: u8 = 60;
const SMALL_QUALITY: u8 = 35;

/// Image of the camera, reduced to the mean of square blocks of pixels.
#[derive(Debug, Clone, PartialEq)]
pub struct Photograph {
    /// Width and height of the image, px.
    pub image_px: [usize; 2],
    /// Pixels of the image along an edge of a block.
    pub reduced: usize,
    /// Width and height of the picture, px.
    pub size: [usize; 2],
    /// Largest value of the picture, as a fraction of full scale.
    pub brightest: f32,
    values: Vec<f32>,
}

impl Photograph {
    /// Creates a picture of an image.
    #[must_use]
    pub fn of(image: &RawImage) -> Self {
        let (width, height) = (image.width, image.height);
        let reduced = width.div_ceil(WIDTH).max(1);
        let grey = image.grey();
        let rows = (height / reduced).max(1);
        let band = |y: usize| grey.part(0, y * reduced, width, reduced.min(height)).pixels;
        Self::of_bands(band, [width, height], reduced, rows, width)
    }

    /// Returns a picture small enough to be one of many on a page.
    #[must_use]
    pub fn small(&self) -> Self {
        let [width, rows] = self.size;
        let by = width.div_ceil(SMALL_WIDTH).max(1);
        let band = |y: usize| self.values[y * by * width..][..by.min(rows) * width].to_vec();
        Self::of_bands(band, self.image_px, self.reduced * by, (rows / by).max(1), width)
    }

    /// Creates a picture from bands of rows, each `width` px wide and as high as a block.
    fn of_bands(
        band: impl Fn(usize) -> Vec<f32>,
        image_px: [usize; 2],
        reduced: usize,
        rows: usize,
        width: usize,
    ) -> Self {
        let columns = (image_px[0] / reduced).max(1);
        let block = (width / columns).max(1);
        let mut values = Vec::with_capacity(columns * rows);
        let mut sums = vec![0.0; width];
        for y in 0..rows {
            sums.fill(0.0);
            let pixels = band(y);
            for row in pixels.chunks_exact(width) {
                for (sum, pixel) in sums.iter_mut().zip(row) {
                    *sum += pixel;
                }
            }
            let count = (pixels.len() / width * block) as f32;
            let mean = |block: &[f32]| block.iter().sum::<f32>() / count;
            values.extend(sums.chunks(block).take(columns).map(mean));
        }
        let brightest = values.iter().copied().fold(f32::MIN_POSITIVE, f32::max);
        Self { image_px, reduced, size: [columns, rows], brightest, values }
    }

    /// Returns the picture as a JPEG file in which the brightest value is white.
    pub(super) fn jpeg(&self) -> Result<Vec<u8>> {
        self.encoded(QUALITY)
    }

    /// Returns a small picture as a JPEG file.
    pub(super) fn small_jpeg(&self) -> Result<Vec<u8>> {
        self.encoded(SMALL_QUALITY)
    }

    #[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss)] // pixels of 8 bits
    fn encoded(&self, quality: u8) -> Result<Vec<u8>> {
        let [columns, rows] = self.size;
        let picture = GrayImage::from_fn(columns as u32, rows as u32, |x, y| {
            let value = self.values[y as usize * columns + x as usize];
            Luma([(value / self.brightest * 255.0) as u8])
        });
        let mut jpeg = Vec::new();
        JpegEncoder::new_with_quality(&mut jpeg, quality)
            .encode_image(&picture)
            .map_err(|e| Error::invalid(format!("a figure could not be drawn: {e}")))?;
        Ok(jpeg)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::image::{Color, Samples};

    /// An image in which each column has its own value.
    fn ramp(width: usize, height: usize) -> RawImage {
        let samples = (0..width * height).map(|i| u16::try_from(i % width).unwrap()).collect();
        RawImage { width, height, color: Color::Grey, samples: Samples::Bits16(samples) }
    }

    #[test]
    fn a_picture_has_the_means_of_blocks() {
        let photograph = Photograph::of(&ramp(2803, 7));
        assert_eq!((photograph.reduced, photograph.size), (3, [934, 2]));
        let in_samples = |value: f32| (value * 65_535.0).round();
        assert!((in_samples(photograph.values[10]) - 31.0).abs() < 0.1);
        let small = photograph.small();
        assert_eq!((small.reduced, small.size, small.image_px), (6, [467, 1], [2803, 7]));
        assert!((in_samples(small.values[10]) - 63.0).abs() < 1.1, "{}", small.values[10]);
    }

    #[test]
    fn a_small_image_stays_as_it_is() {
        let photograph = Photograph::of(&ramp(5, 2)).small();
        assert_eq!((photograph.reduced, photograph.size), (1, [5, 2]));
        assert!((photograph.brightest * 65_535.0 - 4.0).abs() < 1e-3);
        assert!(photograph.jpeg().unwrap().len() > 100);
    }
}
