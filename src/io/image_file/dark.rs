//! Dark image: what the camera delivers without light, subtracted pixel by pixel.
//!
//! A constant is added to the difference, since samples are whole numbers from 0 on, and noise about 0 must not be cut off. It
//! becomes the black level of all images.

use std::path::{Path, PathBuf};

use super::pages::{Pages, Sum, WIDER};
use crate::error::{Error, Result};
use crate::finding::{Finding, Issue};
use crate::image::{RawImage, Samples};
use crate::numerics::median;
use crate::quantity::counted;

/// Black level above the median of the dark image, in standard deviations: nearly no pixel needs more.
const MARGIN: f32 = 6.0;
/// Median deviation of normally distributed values, in standard deviations.
const MEDIAN_DEVIATION: f64 = 0.6745;
/// Largest part of the pixels that may be darker than the dark image. Without any light, noise makes just under half of them
/// darker.
const DARKER: f64 = 0.5;
/// Largest level of a dark image, relative to the largest sample of an image.
const DARK: f32 = 0.5;
/// Largest number of pixels for median and scatter.
const SAMPLE: usize = 1 << 20;

/// Image without light.
#[derive(Debug, Clone, PartialEq)]
pub struct Dark {
    path: PathBuf,
    width: usize,
    height: usize,
    samples_per_pixel: usize,
    /// Bits of the samples of the images to correct.
    bits: u32,
    /// Number of averaged pages.
    pages: usize,
    /// Mean samples without light, grey levels of the files.
    samples: Vec<f32>,
    /// Median of the samples.
    level: f32,
    /// Black level of the corrected images, grey levels of the files.
    black: f32,
    /// Grey levels of the corrected images per grey level of the files.
    scale: f32,
    /// Standard deviation between the pixels, grey levels of the files.
    scatter: f32,
}

impl Dark {
    /// Creates the dark image in a file from its pages, for images with samples of `bits` bits.
    pub fn of(path: &Path, sum: Sum, bits: u32, pages: Pages) -> Result<Self> {
        if sum.bits.is_some_and(|own| own != bits) {
            return Err(Error::invalid(format!(
                "this dark image has {} bits, but the images have {bits}: save it as they are",
                sum.bits.unwrap_or_default()
            )));
        }
        let (width, height, color, count) = (sum.width, sum.height, sum.color, sum.pages);
        let samples = sum.mean();
        let wrong = samples.iter().find(|sample| !sample.is_finite());
        if let Some(wrong) = wrong {
            return Err(Error::invalid(format!("a sample of this dark image is {wrong}")));
        }
        let step = samples.len().div_ceil(SAMPLE).max(1);
        let some = || samples.iter().step_by(step).map(|sample| f64::from(*sample));
        let middle = median(some()).unwrap_or_default();
        let scatter = median(some().map(|s| (s - middle).abs())).unwrap_or_default();
        let scatter = scatter / MEDIAN_DEVIATION;
        #[allow(clippy::cast_possible_truncation)] // single precision
        let (level, scatter) = (middle as f32, scatter as f32);
        let black = (level + MARGIN * scatter).round().max(0.0);
        // Differences of whole levels need no finer levels.
        let fractions = samples.iter().any(|sample| sample.fract() != 0.0);
        let finer = bits == 8 && (fractions || pages == Pages::Average);
        Ok(Self {
            path: path.to_owned(),
            width,
            height,
            samples_per_pixel: color.samples(),
            bits,
            pages: count,
            samples,
            level,
            black,
            scale: if finer { WIDER } else { 1.0 },
            scatter,
        })
    }

    /// Returns the black level of corrected images, in their grey levels.
    pub fn black_level(&self) -> f64 {
        f64::from(self.black * self.scale)
    }

    /// Returns true if this file is the dark image.
    pub fn is(&self, path: &Path) -> bool {
        self.path == path
    }

    /// Returns the finding that the dark image is subtracted.
    pub fn finding(&self) -> Finding {
        let mean = self.samples.iter().map(|sample| f64::from(*sample)).sum::<f64>();
        Finding::note(Issue::DarkSubtracted {
            dark: self.name(),
            pages: self.pages,
            mean: mean / self.samples.len() as f64,
            scatter: f64::from(self.scatter),
            hot_pixels: self.samples.iter().filter(|sample| **sample > self.black).count(),
        })
    }

    fn name(&self) -> String {
        self.path.file_name().unwrap_or_default().to_string_lossy().into_owned()
    }

    fn check(&self, image: &RawImage, bits: u32) -> Result<()> {
        let channels = image.color.samples();
        let [largest, _] = image.largest_and_step();
        let largest = f32::from(largest) / if image.bits() == bits { 1.0 } else { WIDER };
        let wrong = if (self.width, self.height) != (image.width, image.height) {
            format!(
                "the image has {} x {} px, but the dark image {} x {}",
                image.width, image.height, self.width, self.height
            )
        } else if channels != self.samples_per_pixel {
            let own = counted(self.samples_per_pixel, "channel");
            format!("the image has {}, but the dark image {own}", counted(channels, "channel"))
        } else if bits != self.bits {
            format!("the image has {bits} bits, but the dark image is for images of {}", self.bits)
        } else if self.level > DARK * largest {
            format!(
                "the image has samples up to {largest}, but half of the dark image is above {}",
                self.level
            )
        } else {
            return Ok(());
        };
        Err(self.refused(&wrong))
    }

    fn refused(&self, wrong: &str) -> Error {
        Error::invalid(format!(
            "{wrong}: take the dark image {} with this camera, with the lens covered, at the exposure \
             time and gain of the images, and save it as they are",
            self.name()
        ))
    }

    /// Subtracts the dark image from an image whose file has samples of `bits` bits. Full pixels stay full. An error if the
    /// image does not belong to the dark image.
    pub fn subtracted_from(&self, image: RawImage, bits: u32) -> Result<RawImage> {
        self.check(&image, bits)?;
        let RawImage { width, height, color, .. } = image;
        #[allow(clippy::cast_possible_truncation)] // samples have 16 bits
        let full = image.plateau().unwrap_or_else(|| image.full_scale()) as f32;
        // Averaged samples are finer already.
        let finer = if image.bits() == 8 { self.scale } else { 1.0 };
        let full = full * finer;
        let mut darker = 0;
        let mut corrected = |sample: f32, dark: f32| {
            let sample = sample * finer;
            if sample >= full {
                return sample;
            }
            darker += usize::from(sample < dark * self.scale);
            (sample + (self.black - dark) * self.scale).round().clamp(0.0, full)
        };
        let mut of = |(sample, dark): (f32, &f32)| corrected(sample, *dark);
        #[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss)] // cut to the range
        let samples = match image.samples {
            Samples::Bits8(all) => {
                let light = all.into_iter().map(f32::from).zip(&self.samples).map(&mut of);
                if finer > 1.0 {
                    Samples::Bits16(light.map(|light| light as u16).collect())
                } else {
                    Samples::Bits8(light.map(|light| light as u8).collect())
                }
            }
            Samples::Bits16(all) => {
                let light = all.into_iter().map(f32::from).zip(&self.samples).map(&mut of);
                Samples::Bits16(light.map(|light| light as u16).collect())
            }
        };
        let part = darker as f64 / self.samples.len().max(1) as f64;
        if part > DARKER {
            let part = 100.0 * part;
            return Err(self
                .refused(&format!("{part:.0} % of the pixels are darker than in the dark image")));
        }
        Ok(RawImage { width, height, color, samples })
    }
}
