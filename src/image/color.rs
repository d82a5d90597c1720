//! The colours of the samples of a raw image.

use clap::ValueEnum;
use serde::{Deserialize, Serialize};

/// The colours of the samples of a raw image.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, ValueEnum)]
#[serde(rename_all = "kebab-case")]
pub enum Color {
    /// One sample per pixel.
    Grey,
    /// Red, green and blue of every pixel.
    Rgb,
    /// Colour mosaic that begins with red and green above green and blue.
    BayerRggb,
    /// Colour mosaic that begins with green and red above blue and green.
    BayerGrbg,
    /// Colour mosaic that begins with green and blue above red and green.
    BayerGbrg,
    /// Colour mosaic that begins with blue and green above green and red.
    BayerBggr,
}

impl Color {
    /// Returns the name used in files.
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

    /// Returns the number of samples per pixel.
    #[must_use]
    pub fn samples(self) -> usize {
        if self == Self::Rgb { 3 } else { 1 }
    }

    /// Returns the colour (0 red, 1 green, 2 blue) of a mosaic at pixel (u, v); `None` without a mosaic.
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
