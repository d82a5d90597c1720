//! Images: linear grey values to compute with, and samples as a camera delivers them.

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
