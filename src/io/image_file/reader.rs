//! The reader of the images of one camera: their colour, their pages, and the dark image.

use std::io::Read;
use std::path::Path;

use super::dark::Dark;
use super::notes::image_findings;
use super::pages::{self, Pages, Sum};
use super::raw::{RawFormat, RawLayout, is_raw};
use super::{Decoded, Header, foreign, header_of, interpreted};
use crate::error::{Error, Result};
use crate::finding::Finding;
use crate::image::{Color, RawImage};
use crate::io::{open, read_bytes};

/// Number of bytes that identify a format.
const HEAD: u64 = 64;

/// Reads image files, and corrects their samples in the same way for all images of a camera.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct ImageReader {
    color: Option<Color>,
    pages: Pages,
    raw: Option<RawFormat>,
    dark: Option<Dark>,
    black_level: Option<f64>,
}

impl ImageReader {
    /// Creates a reader of single pages, without a dark image. `color` states the meaning of the samples; without it they are
    /// grey or RGB, as in the file. A file with three channels cannot be a colour mosaic, and one with a single channel cannot
    /// be RGB.
    #[must_use]
    pub fn of_color(color: Option<Color>) -> Self {
        Self { color, ..Self::default() }
    }

    /// Chooses the pages of TIFF files.
    #[must_use]
    pub fn with_pages(self, pages: Pages) -> Self {
        Self { pages, ..self }
    }

    /// Sets the layout of files without a header, and the size of their images, px.
    #[must_use]
    pub fn with_raw(self, layout: Option<RawLayout>, size: (u32, u32)) -> Self {
        let format = |layout| RawFormat::new(layout, size, self.color);
        Self { raw: layout.map(format), ..self }
    }

    /// Sets the black level of images without a dark image, in their grey levels.
    #[must_use]
    pub fn with_black_level(self, black_level: Option<f64>) -> Self {
        Self { black_level, ..self }
    }

    /// Reads a dark image, whose pages are averaged, to subtract it from images like `first`.
    pub fn with_dark(self, dark: &Path, first: &Path) -> Result<Self> {
        let bits = self.bits(first)?;
        let in_file = |e: Error| e.in_file(dark);
        let content = read_bytes(dark)?;
        let sum = match self.raw_of(dark) {
            Some(format) => format.decode(&content).map(Sum::of_page),
            None => {
                foreign::check(dark, &content).and_then(|()| Sum::of_file(&content, |_| Ok(())))
            }
        };
        let dark = Dark::of(dark, sum.map_err(in_file)?, bits, self.pages).map_err(in_file)?;
        Ok(Self { dark: Some(dark), ..self })
    }

    /// Returns the stated layout if a file has no header.
    fn raw_of(&self, path: &Path) -> Option<&RawFormat> {
        self.raw.as_ref().filter(|_| is_raw(path))
    }

    fn header(&self, path: &Path) -> Result<Header> {
        if let Some(format) = self.raw_of(path) {
            return Ok(format.header());
        }
        let read = |source| Error::Read { path: path.to_owned(), source };
        let mut head = Vec::new();
        open(path).and_then(|file| file.take(HEAD).read_to_end(&mut head)).map_err(read)?;
        foreign::check(path, &head).map_err(|e| e.in_file(path))?;
        header_of(path)
    }

    /// Returns the bits of a sample in memory without corrections.
    fn bits(&self, path: &Path) -> Result<u32> {
        let (_, bytes) = self.header(path)?;
        Ok(if bytes > 1 { 16 } else { 8 })
    }

    fn decoded(&self, path: &Path, bytes: &[u8]) -> Result<Decoded> {
        if let Some(format) = self.raw_of(path) {
            return pages::alone(format.decode(bytes)?, self.pages);
        }
        foreign::check(path, bytes)?;
        pages::decoded(bytes, self.pages)
    }

    /// Reads a PNG, TIFF, BMP, PGM/PPM or JPEG file, or one without a header whose layout is stated; transparency is ignored.
    ///
    /// Samples have 8 or 16 bits. Samples of TIFF files may be signed, have 32 or 64 bits, or be floating-point numbers, if
    /// they are grey levels from 0 to 65535; these are rounded to whole levels.
    pub fn read(&self, path: &Path) -> Result<RawImage> {
        // Reading the whole file first separates errors of the disk from errors of the image.
        let bytes = read_bytes(path)?;
        let decoded = self.decoded(path, &bytes);
        let image = decoded.and_then(|decoded| interpreted(decoded, self.color));
        let image = image.map_err(|e| e.in_file(path))?;
        match &self.dark {
            Some(dark) => {
                let bits = self.bits(path)?;
                dark.subtracted_from(image, bits).map_err(|e| e.in_file(path))
            }
            None => Ok(image),
        }
    }

    /// Returns the size of the samples of an image file in memory, bytes, from its header; with averaged pages also the size of
    /// the file.
    pub fn bytes(&self, path: &Path) -> Result<u64> {
        let ((width, height, color), sample_bytes) = self.header(path)?;
        // The product may overflow, since a header may state any size.
        let samples = u64::from(width).saturating_mul(u64::from(height) * color.samples() as u64);
        let read = |source| Error::Read { path: path.to_owned(), source };
        let file = match self.pages {
            Pages::Average => std::fs::metadata(path).map_err(read)?.len(),
            Pages::First | Pages::Number(_) => 0,
        };
        Ok(samples.saturating_mul(sample_bytes).saturating_add(file))
    }

    /// Returns the black level of the dark image or, without one, the stated black level; `None` if neither is given.
    #[must_use]
    pub fn black_level(&self) -> Option<f64> {
        self.dark.as_ref().map(Dark::black_level).or(self.black_level)
    }

    /// Returns findings about declared tone curves and orientations, about several pages, and about the dark image. Declared
    /// curves and orientations are not applied. A file that cannot be read gives no finding here, since reading it reports the
    /// reason.
    #[must_use]
    pub fn findings<P: AsRef<Path> + Sync>(&self, images: &[P]) -> Vec<Finding> {
        let is_dark = |path: &Path| self.dark.as_ref().is_some_and(|dark| dark.is(path));
        let images = images.iter().map(AsRef::as_ref);
        let images: Vec<&Path> = images.filter(|path| self.raw_of(path).is_none()).collect();
        let mut findings = image_findings(&images, self.pages, &is_dark);
        findings.extend(self.dark.as_ref().map(Dark::finding));
        findings
    }
}
