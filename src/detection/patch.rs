//! Light of one micro-image, devignetted.

// Only functions inlined into a dispatched function are compiled for its registers.
#![allow(clippy::inline_always)]

use nalgebra::Vector2;
use pulp::{Arch, NullaryFnOnce, Simd, WithSimd};

use crate::image::Grey;
use crate::numerics::simd::{dot, largest, sum, weighted_squares};

/// Pixels of a micro-image: offsets from its centre (px), light relative to the white image, and weights, which are 1 where the
/// white image is brightest.
#[derive(Debug, Clone, Default)]
pub(super) struct Patch {
    pub x: Vec<f32>,
    pub y: Vec<f32>,
    pub light: Vec<f32>,
    pub weight: Vec<f32>,
    /// Part of the pixels that is saturated in the board's image.
    pub saturated: f32,
    /// Part of the pixels that is saturated in the white image.
    pub saturated_white: f32,
    /// Brightest light in the white image.
    pub brightest: f32,
}

/// Reason why a micro-image shows nothing.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Unusable {
    /// Cut by the border of the image.
    Cut,
    /// Without light in the white image.
    Dark,
    /// Too few pixels, though none is saturated.
    TooSmall,
    /// Saturated in the board's image.
    Saturated,
    /// Saturated in the white image.
    SaturatedWhite,
}

impl Patch {
    /// Returns every n-th of its pixels.
    pub fn thinned(&self, n: usize) -> Self {
        let few = |all: &[f32]| all.iter().copied().step_by(n).collect();
        Self {
            x: few(&self.x),
            y: few(&self.y),
            light: few(&self.light),
            weight: few(&self.weight),
            ..*self
        }
    }

    /// Keeps the pixels that are marked, and returns their number.
    pub(super) fn keep(&mut self, marks: &[u8]) -> usize {
        let n = marks.len();
        let all = [&mut self.x, &mut self.y, &mut self.light, &mut self.weight];
        let mut kept = 0;
        if marks.contains(&0) {
            for values in all {
                let values = &mut values[..n];
                kept = 0;
                for (i, mark) in marks.iter().enumerate() {
                    values[kept] = values[i];
                    kept += usize::from(*mark);
                }
            }
        } else {
            kept = n;
        }
        for values in [&mut self.x, &mut self.y, &mut self.light, &mut self.weight] {
            values.truncate(kept);
        }
        kept
    }

    /// Returns the weighted mean of the light.
    pub fn mean(&self) -> f64 {
        self.mean_and_std_dev().0
    }

    /// Returns the weighted mean and standard deviation of the light.
    pub fn mean_and_std_dev(&self) -> (f64, f64) {
        let [sum, first, second] = Arch::new().dispatch(LightMoments(self));
        let mean = first / sum;
        (f64::from(mean), f64::from((second / sum - mean * mean).max(0.0).sqrt()))
    }

    /// Returns the sum of the weights.
    pub fn sum_of_weights(&self) -> f64 {
        let [sum, ..] = Arch::new().dispatch(LightMoments(self));
        f64::from(sum)
    }

    /// Returns the weighted sum of squares of the light minus its mean.
    pub fn sum_of_squares(&self) -> f64 {
        let std_dev = self.mean_and_std_dev().1;
        self.sum_of_weights() * std_dev * std_dev
    }
}

/// Smallest light of a pixel in the white image, relative to the brightest of the micro-image; darker pixels are not used.
pub(super) const USABLE: f32 = 0.06;
/// Variance of the read noise over the variance of the photon noise, in the white image's brightest pixel. Relative to their
/// light, darker pixels have more read noise.
const READ_NOISE: f32 = 0.25;

/// Returns the weight of a pixel from its light in the white image, relative to the brightest of the micro-image.
#[inline(always)]
pub(super) fn weight(white: f32) -> f32 {
    white * white / (READ_NOISE + white) * (1.0 + READ_NOISE)
}

/// Smallest number of pixels for a corner of seven parameters, with some redundancy.
const FEWEST_PIXELS: usize = 40;

/// Two images of the same size: a board and its white image.
#[derive(Clone, Copy)]
pub(super) struct Pair<'a> {
    pub board: &'a Grey<'a>,
    pub white: &'a Grey<'a>,
}

impl Pair<'_> {
    /// Reads the patch of a micro-image with the light up to `reach` px from its centre, into a patch that can be reused; an
    /// error if there is none.
    pub fn read(
        &self,
        center: &Vector2<f64>,
        reach: f64,
        patch: &mut Patch,
        room: &mut Room,
    ) -> Result<(), Unusable> {
        let whole = self.collect(center, reach, patch, &mut room.white).ok_or(Unusable::Cut)?;
        let (brightest, saturated, saturated_white) = whole;
        if brightest <= 0.0 {
            return Err(Unusable::Dark);
        }
        let pixels = patch.x.len();
        patch.brightest = brightest;
        patch.saturated = saturated as f32 / pixels as f32;
        patch.saturated_white = saturated_white as f32 / pixels as f32;
        room.keep.clear();
        room.keep.resize(pixels, 0);
        patch.weight.clear();
        patch.weight.resize(pixels, 0.0);
        let (lit, lit_white) = Arch::new().dispatch(Divided { patch, room });
        let kept = patch.keep(&room.keep);
        match (kept, lit_white, lit) {
            (FEWEST_PIXELS.., ..) => Ok(()),
            (_, FEWEST_PIXELS.., _) => Err(Unusable::Saturated),
            (_, _, FEWEST_PIXELS..) => Err(Unusable::SaturatedWhite),
            _ => Err(Unusable::TooSmall),
        }
    }

    /// Collects the pixels up to `reach` from a centre, with their undivided light. Returns the brightest light in the white
    /// image, and the number of saturated pixels in each image; `None` if some pixels are missing.
    #[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss)] // inside the image; 32 bits do
    fn collect(
        &self,
        center: &Vector2<f64>,
        reach: f64,
        patch: &mut Patch,
        whites: &mut Vec<f32>,
    ) -> Option<(f32, u32, u32)> {
        let (top, bottom) = ((center.y - reach).ceil(), (center.y + reach).floor());
        let (left, right) = ((center.x - reach).ceil(), (center.x + reach).floor());
        let (width, height) = self.white.size();
        if top < 0.0 || left < 0.0 || right >= width as f64 || bottom >= height as f64 {
            return None;
        }
        for all in [&mut patch.x, &mut patch.y, &mut patch.light, whites] {
            all.clear();
        }
        for v in top as usize..=bottom as usize {
            let y = v as f64 - center.y;
            let half = (reach * reach - y * y).max(0.0).sqrt();
            let first = (center.x - half).ceil() as usize;
            let last = ((center.x + half).floor() + 1.0) as usize;
            if first >= last {
                continue;
            }
            let from_center = (first as f64 - center.x) as f32;
            patch.x.extend((0..(last - first) as u16).map(|i| from_center + f32::from(i)));
            patch.y.resize(patch.x.len(), y as f32);
            let so_far = patch.light.len();
            for (image, light) in [(self.board, &mut patch.light), (self.white, &mut *whites)] {
                light.resize(patch.x.len(), 0.0);
                image.read_row((first, v), &mut light[so_far..]);
            }
        }
        Some(Arch::new().dispatch(Brightness { board: &patch.light, white: whites }))
    }
}

/// Brightest light in the white image, and number of saturated pixels in each image.
struct Brightness<'a> {
    board: &'a [f32],
    white: &'a [f32],
}

impl WithSimd for Brightness<'_> {
    type Output = (f32, u32, u32);

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) -> Self::Output {
        let (mut saturated, mut saturated_white) = (0, 0);
        for (board, white) in self.board.iter().zip(self.white) {
            saturated += u32::from(*board >= 1.0);
            saturated_white += u32::from(*white >= 1.0);
        }
        (largest(simd, self.white), saturated, saturated_white)
    }
}

/// Buffers for reading a patch.
#[derive(Default)]
pub(super) struct Room {
    /// Light in the white image.
    white: Vec<f32>,
    /// Marks of pixels: 1 for those that are used.
    keep: Vec<u8>,
}

/// Sums over a patch of the weights, of weights times light, and of weights times squared light.
struct LightMoments<'a>(&'a Patch);

impl WithSimd for LightMoments<'_> {
    type Output = [f32; 3];

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) -> Self::Output {
        let Patch { light, weight, .. } = self.0;
        [sum(simd, weight), dot(simd, weight, light), weighted_squares(simd, weight, light)]
    }
}

/// Division of the light of pixels by the white image, with weights and marks. It returns the number of pixels with enough
/// light in the white image, and how many of them are not saturated there.
struct Divided<'a> {
    patch: &'a mut Patch,
    room: &'a mut Room,
}

impl NullaryFnOnce for Divided<'_> {
    type Output = (usize, usize);

    #[allow(clippy::needless_bitwise_bool)] // without branches
    #[inline(always)]
    fn call(self) -> Self::Output {
        let Self { patch, room } = self;
        let brighter = patch.brightest.recip();
        let n = patch.light.len();
        let (white, keep) = (&room.white[..n], &mut room.keep[..n]);
        let (light, weights) = (&mut patch.light[..n], &mut patch.weight[..n]);
        let (mut lit, mut lit_white) = (0_u32, 0_u32);
        for i in 0..n {
            let part = white[i] * brighter;
            let (is_lit, is_below) = (part >= USABLE, white[i] < 1.0);
            lit += u32::from(is_lit);
            lit_white += u32::from(is_lit & is_below);
            keep[i] = u8::from(is_lit & is_below & (light[i] < 1.0));
            light[i] /= white[i];
            weights[i] = weight(part);
        }
        (lit as usize, lit_white as usize)
    }
}

#[cfg(test)]
mod tests {
    use super::super::micro_images::tests::micro_images;
    use super::*;
    use crate::image::{Color, RawImage, Samples};

    #[test]
    fn an_unusable_micro_image_says_why() {
        let of = |board: f64, white: f64, pitch_px: f64, (width, height): (usize, usize)| {
            #[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss)] // of 8 bits
            let flat = |light: f64| RawImage {
                width,
                height,
                color: Color::Grey,
                samples: Samples::Bits8(vec![(255.0 * light) as u8; width * height]),
            };
            let (board, white) = (flat(board), flat(white));
            let pair = Pair { board: &board.as_they_are(), white: &white.as_they_are() };
            let mut patch = Patch::default();
            let micro_images = micro_images(pitch_px);
            let (center, reach) = (micro_images.center(1, 1), micro_images.optics(1, 1).reach_px());
            pair.read(&center, reach, &mut patch, &mut Room::default()).map(|()| patch.light.len())
        };
        let whole = (61, 61);
        assert!(of(0.5, 0.8, 16.0, whole).is_ok_and(|pixels| pixels > 100));
        assert_eq!(of(1.0, 0.8, 16.0, whole), Err(Unusable::Saturated));
        assert_eq!(of(0.5, 1.0, 16.0, whole), Err(Unusable::SaturatedWhite));
        assert_eq!(of(1.0, 1.0, 16.0, whole), Err(Unusable::SaturatedWhite));
        assert_eq!(of(0.5, 0.0, 16.0, whole), Err(Unusable::Dark));
        assert_eq!(of(0.5, 0.8, 6.0, whole), Err(Unusable::TooSmall));
        assert_eq!(of(0.5, 0.8, 16.0, (36, 61)), Err(Unusable::Cut));
        assert_eq!(of(0.5, 0.8, 16.0, (61, 36)), Err(Unusable::Cut));
        // The middle is 30 px from the first pixels.
        assert!(of(0.5, 0.8, 60.0, whole).is_ok());
        assert_eq!(of(0.5, 0.8, 62.0, (100, 100)), Err(Unusable::Cut));
    }
}
