//! What the samples of a raw image stand for.

use clap::ValueEnum;
use serde::{Deserialize, Serialize};

/// What the samples of a raw image stand for.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, ValueEnum)]
#[serde(rename_all = "kebab-case")]
pub enum Color {
    /// One sample per pixel.
    Grey,
    /// Red, green and blue of every pixel.
    Rgb,
    /// A colour mosaic that begins with red and green above green and blue.
    BayerRggb,
    /// Green and red above blue and green.
    BayerGrbg,
    /// Green and blue above red and green.
    BayerGbrg,
    /// Blue and green above green and red.
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
