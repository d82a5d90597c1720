//! Images: linear grey values to compute with, and the samples of a camera.

mod color;
mod grey;
mod plateau;

use nalgebra::Vector2;

pub use color::Color;
pub use grey::Grey;

use crate::finding::Issue;
use crate::model::full_scale;

/// A grey image in linear light, row by row from the top.
#[derive(Debug, Clone, PartialEq)]
pub struct Image {
    /// Width, px.
    pub width: usize,
    /// Height, px.
    pub height: usize,
    /// Values of the pixels, `width · height`.
    pub pixels: Vec<f32>,
}

impl Image {
    /// Returns the value of pixel (u, v).
    ///
    /// # Panics
    /// If there is no such pixel.
    #[must_use]
    pub fn at(&self, u: usize, v: usize) -> f32 {
        assert!(u < self.width, "the image is {} px wide", self.width);
        self.pixels[v * self.width + u]
    }
}

/// Largest relative difference of the means of a mosaic's two greens, or of a grey image's parities.
const ALIKE: f64 = 0.05;

/// Returns true if two of [`RawImage::parity_means`] differ like two colours of a mosaic.
fn alternate(a: f64, b: f64) -> bool {
    (a / b - 1.0).abs() > ALIKE
}

/// The samples of a camera: whole numbers from 0 to 255, or to 65 535.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Samples {
    /// Samples of 8 bits.
    Bits8(Vec<u8>),
    /// Samples of 16 bits.
    Bits16(Vec<u16>),
}

/// An image with the samples of a camera.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct RawImage {
    /// Width, px.
    pub width: usize,
    /// Height, px.
    pub height: usize,
    /// Colours of the samples.
    pub color: Color,
    /// Samples, row by row: `width · height · color.samples()` values.
    pub samples: Samples,
}

/// Largest sample for the comparison of colours, as a fraction of the range. Larger ones are too close to saturation.
const NEARLY_FULL: f64 = 0.95;
/// Smallest sample for the comparison of colours, as a fraction of the range. Smaller ones are mostly noise.
const NEARLY_DARK: f64 = 0.02;
/// Least number of pairs of rows, spread over a large image, in which its channels are compared.
const COMPARED: usize = 256;

impl RawImage {
    /// Returns the number of bits of a sample: 8 or 16.
    #[must_use]
    pub fn bits(&self) -> u32 {
        match self.samples {
            Samples::Bits8(_) => 8,
            Samples::Bits16(_) => 16,
        }
    }

    /// Returns the largest value that a sample can have.
    #[must_use]
    pub fn full_scale(&self) -> f64 {
        full_scale(self.bits())
    }

    /// Returns the means of the samples at even and odd columns of even rows, then of odd rows, over places
    /// where none is saturated or dark, as fractions of the range of the image; `None` if there are no
    /// such places. Places where light rises and falls have equal weights. Behind a colour mosaic the
    /// means differ, except for the two greens; in a grey image they do not.
    #[must_use]
    pub fn parity_means(&self) -> Option<[f64; 4]> {
        if self.color == Color::Rgb {
            return None;
        }
        // By direction: light falls, stays or rises along u, then along v.
        let (mut sums, mut counts) = ([[0.0_f64; 4]; 9], [0.0_f64; 9]);
        self.compared(self.range(None), |(u, v), square| {
            let change = |before: Option<f64>, after: Option<f64>| {
                let change = before.zip(after).and_then(|(a, b)| b.partial_cmp(&a));
                change.map_or(1, |order| usize::from(order.is_ge()) + usize::from(order.is_gt()))
            };
            let before_u = u.checked_sub(2).and_then(|before| self.square(before, v));
            let before_v = v.checked_sub(2).and_then(|before| self.square(u, before));
            let direction = 3 * change(before_u, self.square(u + 2, v))
                + change(before_v, self.square(u, v + 2));
            counts[direction] += 1.0;
            for (sum, &(_, part)) in sums[direction].iter_mut().zip(square) {
                *sum += part;
            }
        });
        // Edges that rise and fall unequally often by chance would look like a mosaic.
        let weight = |i: usize| (counts[i] + counts[8 - i]) / counts[i].max(1.0);
        let paired: Vec<usize> = (0..9).filter(|&i| counts[i] * counts[8 - i] > 0.0).collect();
        let total: f64 = paired.iter().map(|&i| weight(i) * counts[i]).sum();
        let mean = |channel: usize| {
            paired.iter().map(|&i| weight(i) * sums[i][channel]).sum::<f64>() / total
        };
        (total > 0.0).then(|| [0, 1, 2, 3].map(mean))
    }

    /// Returns the sum of the four samples from (u, v) on; `None` beyond the border.
    fn square(&self, u: usize, v: usize) -> Option<f64> {
        let at = |index: usize| match &self.samples {
            Samples::Bits8(samples) => f64::from(samples[index]),
            Samples::Bits16(samples) => f64::from(samples[index]),
        };
        let (first, next) = (v * self.width + u, (v + 1) * self.width + u);
        let inside = u + 1 < self.width && v + 1 < self.height;
        inside.then(|| at(first) + at(first + 1) + at(next) + at(next + 1))
    }

    /// Returns true if a white image with one sample per pixel seems to be behind a colour mosaic; `None`
    /// if this cannot be decided.
    #[must_use]
    pub fn shows_mosaic(&self) -> Option<bool> {
        let [a, b, c, d] = self.parity_means()?;
        Some(alternate(a, b) || alternate(a, c) || alternate(a, d))
    }

    /// Returns the reason why the stated colour of a white image is doubtful; `None` if it is not.
    #[must_use]
    pub fn doubtful_color(&self) -> Option<Issue> {
        let [a, b, c, d] = self.parity_means()?;
        let greens_differ = match self.color {
            Color::Grey => {
                return self.shows_mosaic()?.then_some(Issue::ColorMosaic);
            }
            Color::BayerRggb | Color::BayerBggr => alternate(b, c),
            _ => alternate(a, d),
        };
        greens_differ.then_some(Issue::WrongMosaic)
    }

    /// Calls `visit` with the first pixel (u, v), the channels and the samples, as fractions of a
    /// range, of many places all over the image where none is saturated or dark: pixels of an RGB
    /// image, squares of four pixels of any other.
    fn compared(&self, range: (f64, f64), visit: impl FnMut((usize, usize), &[(usize, f64)])) {
        match &self.samples {
            Samples::Bits8(samples) => self.compared_of(samples, range, visit),
            Samples::Bits16(samples) => self.compared_of(samples, range, visit),
        }
    }

    fn compared_of<T: Copy + Into<f64>>(
        &self,
        samples: &[T],
        (black, white): (f64, f64),
        mut visit: impl FnMut((usize, usize), &[(usize, f64)]),
    ) {
        let part = |sample: T| (sample.into() - black) / (white - black);
        let mut visit_usable = |at: (usize, usize), place: &[(usize, f64)]| {
            if place.iter().all(|(_, part)| (NEARLY_DARK..NEARLY_FULL).contains(part)) {
                visit(at, place);
            }
        };
        let per_row = self.width * self.color.samples();
        if per_row == 0 {
            return;
        }
        let channel = |u, v| self.color.mosaic(u, v).unwrap_or_default();
        let square = [(0, 0), (1, 0), (0, 1), (1, 1)].map(|(u, v)| channel(u, v));
        for pair in spread(self.height / 2, COMPARED) {
            let (v, rows) = (2 * pair, &samples[2 * pair * per_row..][..2 * per_row]);
            if self.color == Color::Rgb {
                for (i, rgb) in rows.chunks_exact(3).enumerate() {
                    let at = (i % self.width, v + i / self.width);
                    visit_usable(at, &[(0, part(rgb[0])), (1, part(rgb[1])), (2, part(rgb[2]))]);
                }
                continue;
            }
            let (upper, lower) = rows.split_at(per_row);
            for (i, (upper, lower)) in upper.chunks_exact(2).zip(lower.chunks_exact(2)).enumerate()
            {
                let four = [
                    (square[0], part(upper[0])),
                    (square[1], part(upper[1])),
                    (square[2], part(lower[0])),
                    (square[3], part(lower[1])),
                ];
                visit_usable((2 * i, v), &four);
            }
        }
    }
}

/// Returns at most `most` of the numbers below `count`, spread over all of them at uneven distances: rows at even distances would
/// meet rows of micro-images again and again at the same height.
#[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss)] // below `count`
fn spread(count: usize, most: usize) -> impl Iterator<Item = usize> {
    /// Fractional part of the golden ratio, whose multiples are spread evenly modulo 1.
    const GOLDEN: f64 = 0.618_033_988_749_895;
    let step = count as f64 / most as f64;
    let of = move |i: usize| {
        if count <= most { i } else { ((i as f64 + (i as f64 * GOLDEN).fract()) * step) as usize }
    };
    (0..count.min(most)).map(of)
}

/// Returns the rectangle (left, top, width, height) of pixels that contains some positions with a margin of
/// `reach`, cut at 0, and the position of its first pixel.
#[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss)] // not below 0
pub(crate) fn bounds(
    places: impl Iterator<Item = Vector2<f64>>,
    reach: f64,
) -> ((usize, usize, usize, usize), Vector2<f64>) {
    let nothing = (Vector2::repeat(f64::MAX), Vector2::repeat(f64::MIN));
    let (low, high) = places.fold(nothing, |(low, high), p| (low.inf(&p), high.sup(&p)));
    let first = low.map(|x| (x - reach).floor().max(0.0));
    let size = (high - first).map(|x| ((x + reach).ceil() + 1.0).max(0.0));
    ((first.x as usize, first.y as usize, size.x as usize, size.y as usize), first)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rows_are_spread_at_uneven_distances() {
        assert_eq!(spread(3, 256).collect::<Vec<_>>(), [0, 1, 2]);
        let rows: Vec<usize> = spread(1534, 256).collect();
        assert!(rows.len() == 256 && rows.is_sorted() && rows.iter().all(|row| *row < 1534));
        // Rows of micro-images at any distance are met at all heights.
        for distance in [5.99, 10.0, 20.13] {
            let phases = rows.iter().map(|row| *row as f64 / distance * std::f64::consts::TAU);
            let (sin, cos) =
                phases.map(f64::sin_cos).fold((0.0, 0.0), |a, b| (a.0 + b.0, a.1 + b.1));
            assert!(f64::hypot(sin, cos) < 0.15 * 256.0, "{distance}: {sin} {cos}");
        }
    }

    #[test]
    fn samples_of_12_bits_in_16_have_a_step() {
        let of = |samples: Vec<u16>| RawImage {
            width: samples.len(),
            height: 1,
            color: Color::Grey,
            samples: Samples::Bits16(samples),
        };
        assert_eq!(of(vec![0, 4080, 65_520, 32]).largest_and_step(), [65_520, 16]);
        assert_eq!(of(vec![0, 4095, 12]).largest_and_step(), [4095, 3]);
        assert_eq!(of(vec![7, 4095, 12]).largest_and_step(), [4095, 1]);
        assert_eq!(of(vec![0, 0]).largest_and_step(), [0, 1]);
        // Samples of 4 bits in 16; of 12 bits in 16, also with little light; of 16 bits with almost no light.
        let levels = |samples: Vec<u16>| of(samples).rounded_to_levels();
        assert_eq!(levels(vec![4369, 0, 13_107]), Some(16));
        assert_eq!(levels(vec![0, 65_520, 16]), None);
        assert_eq!(levels(vec![0, 480, 16]), None);
        assert_eq!(levels(vec![65_535, 65_535]), None);
        assert_eq!(levels(vec![0, 9, 4]), None);
        // Raised to a power, the largest sample stays full.
        let raised = of(vec![0, 1000, 4095]).to_the_power(2.2);
        let expected = (65_535.0 * (1000.0_f64 / 4095.0).powf(2.2)).round();
        assert_eq!(raised.largest_and_step()[0], 65_535);
        let Samples::Bits16(samples) = raised.samples else { unreachable!() };
        assert!((f64::from(samples[1]) - expected).abs() < 0.5);
    }

    /// Returns grey levels behind a mosaic, with channels that respond with 0.5, 1 and 0.25.
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
        RawImage { width, height: 2, color, samples: Samples::Bits16(samples) }
    }

    #[test]
    fn every_mosaic_becomes_grey_and_is_clipped_where_green_saturates() {
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

    /// A part may begin at any pixel.
    #[test]
    #[allow(clippy::float_cmp)] // of the same samples
    fn a_part_of_a_row_is_that_of_the_image() {
        for color in [Color::Grey, Color::Rgb, Color::BayerGrbg, Color::BayerBggr] {
            let samples =
                (0..24 * color.samples()).map(|i| u8::try_from(i * i % 251).unwrap()).collect();
            let image = RawImage { width: 6, height: 4, color, samples: Samples::Bits8(samples) };
            let (grey, whole) = (image.grey(), image.to_grey());
            for (left, v) in [(0, 0), (1, 0), (2, 1), (3, 3)] {
                let mut row = [0.0; 3];
                grey.read_row((left, v), &mut row);
                assert_eq!(row, whole.pixels[v * 6 + left..][..3], "{color:?} at ({left}, {v})");
            }
        }
    }

    #[test]
    fn an_image_without_pixels_has_nothing_to_compare() {
        for (width, height) in [(0, 5), (5, 0)] {
            for color in [Color::Grey, Color::Rgb, Color::BayerRggb] {
                let image = RawImage { width, height, color, samples: Samples::Bits8(Vec::new()) };
                assert_eq!(image.parity_means(), None);
                assert!(image.to_grey().pixels.is_empty());
            }
        }
    }

    /// Saturated micro-images show only their edges, and more rising than falling ones by chance.
    #[test]
    #[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss)] // from 0 to 255
    fn edges_alone_are_no_mosaic() {
        let (pitch, row) = (24.1, 24.1 * 0.75_f64.sqrt());
        let light = |n: usize| {
            let (u, v) = ((n % 300) as f64 - 0.5, (n / 300) as f64);
            let l = (v / row).round();
            let shift = 0.5 * l.rem_euclid(2.0);
            let k = (u / pitch - shift).round() + shift;
            let off = (u - k * pitch).hypot(v - l * row);
            ((8.0 - off) / 2.5 * 255.0 + 128.0).clamp(0.0, 255.0).round() as u8
        };
        let samples = Samples::Bits8((0..300 * 200).map(light).collect());
        let image = RawImage { width: 300, height: 200, color: Color::Grey, samples };
        assert_eq!(image.shows_mosaic(), Some(false), "{:?}", image.parity_means());
    }

    #[test]
    fn a_mosaic_shows_in_the_means_of_its_squares() {
        let image = mosaic(Color::BayerGrbg, &[0.2, 0.4]);
        let [a, b, c, d] = image.parity_means().unwrap();
        assert!((a / d - 1.0).abs() < 1e-3 && (b / a - 0.5).abs() < 1e-3);
        assert!((c / a - 0.25).abs() < 1e-3);
    }
}
