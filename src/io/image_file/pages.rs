//! Pages of TIFF files: one of them, or the mean of all.

use std::fmt;
use std::io::Cursor;
use std::str::FromStr;

use serde::Deserialize;
use toml::Value;

use super::tags::Tags;
use super::{Decoded, Stored, decode, tiff};
use crate::error::{Error, Result};
use crate::image::{Color, RawImage, Samples};
use crate::quantity::counted;

/// Factor from samples of 8 bits to samples of 16 bits, which keeps full scale.
pub const WIDER: f32 = 257.0;

/// Pages of a TIFF file that make an image. Smaller versions and masks are no pages.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Deserialize)]
#[serde(try_from = "Value")]
pub enum Pages {
    /// First page; other pages raise a warning.
    #[default]
    First,
    /// Page with this number, from 1.
    Number(usize),
    /// Mean of all pages, as samples of 16 bits. A pixel that is full on one page is full.
    Average,
}

const WHAT: &str = "state the number of a page, from 1 on, or \"average\"";

impl fmt::Display for Pages {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::First => f.write_str("the first page is read"),
            Self::Number(number) => write!(f, "page {number} is read"),
            Self::Average => f.write_str("the mean of all pages is used"),
        }
    }
}

impl FromStr for Pages {
    type Err = String;

    fn from_str(text: &str) -> std::result::Result<Self, String> {
        let number = || text.parse().ok().filter(|number| *number > 0).map(Self::Number);
        let stated = if text == "average" { Some(Self::Average) } else { number() };
        stated.ok_or_else(|| format!("'{text}' is no page: {WHAT}"))
    }
}

impl TryFrom<Value> for Pages {
    type Error = String;

    fn try_from(value: Value) -> std::result::Result<Self, String> {
        match value {
            Value::String(text) if text == "average" => Ok(Self::Average),
            Value::Integer(number) => number.to_string().parse(),
            other => Err(format!("pages is {other}: {WHAT}")),
        }
    }
}

/// Returns the places of the pages of a file, counted with smaller versions and masks.
pub fn places(bytes: &[u8]) -> Vec<usize> {
    Tags::of(Cursor::new(bytes)).map_or_else(|| vec![0], |mut tags| tiff::pages(&mut tags))
}

/// Decodes an image from these pages.
pub fn decoded(bytes: &[u8], pages: Pages) -> Result<Decoded> {
    match pages {
        Pages::First => decode(bytes, 0),
        Pages::Number(number) => {
            let places = places(bytes);
            let place = places.get(number - 1).ok_or_else(|| no_page(number, places.len()))?;
            decode(bytes, *place)
        }
        Pages::Average => average(bytes),
    }
}

/// Returns the image of a file with one page, from these pages.
pub fn alone(image: Decoded, pages: Pages) -> Result<Decoded> {
    match (pages, image.samples) {
        (Pages::Number(number), _) if number > 1 => Err(no_page(number, 1)),
        (Pages::Average, Stored::Levels(Samples::Bits8(all))) => {
            #[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss)] // a whole factor
            let wider = all.into_iter().map(|sample| (f32::from(sample) * WIDER) as u16);
            let samples = Stored::Levels(Samples::Bits16(wider.collect()));
            Ok(Decoded { samples, ..image })
        }
        (_, samples) => Ok(Decoded { samples, ..image }),
    }
}

fn no_page(number: usize, pages: usize) -> Error {
    Error::invalid(format!(
        "page {number} is stated, but this file has {}: correct pages in [images]",
        counted(pages, "page")
    ))
}

/// Sum of pages.
pub struct Sum {
    pub width: usize,
    pub height: usize,
    pub color: Color,
    /// Bits of the samples; `None` for numbers of a type that cameras do not deliver.
    pub bits: Option<u32>,
    pub pages: usize,
    pub sums: Vec<f32>,
}

impl Sum {
    fn empty(page: &Decoded) -> Self {
        let &Decoded { width, height, color, .. } = page;
        let bits = page.samples.bits();
        Self { width, height, color, bits, pages: 0, sums: vec![0.0; page.samples.count()] }
    }

    /// Creates the sum of one page.
    pub fn of_page(page: Decoded) -> Self {
        let mut sum = Self::empty(&page);
        sum.add(page.samples);
        sum
    }

    /// Adds all pages of a file; `also` is called with each of them.
    pub fn of_file(bytes: &[u8], mut also: impl FnMut(&Decoded) -> Result<()>) -> Result<Self> {
        let mut sum: Option<Self> = None;
        for (number, place) in (1..).zip(places(bytes)) {
            let in_page = |e: Error| Error::invalid(format!("on page {number}: {e}"));
            let page = decode(bytes, place).map_err(in_page)?;
            also(&page).map_err(in_page)?;
            let bits = page.samples.bits();
            let sum = sum.get_or_insert_with(|| Self::empty(&page));
            let alike = (page.width, page.height, page.color, bits, page.samples.count())
                == (sum.width, sum.height, sum.color, sum.bits, sum.sums.len());
            if !alike {
                return Err(Error::invalid(format!(
                    "page {number} has another size or type of samples than the first page: save \
                     the pages that belong together in a file of their own"
                )));
            }
            sum.add(page.samples);
        }
        sum.ok_or_else(|| Error::invalid("this TIFF file has no page with a whole image"))
    }

    #[allow(clippy::cast_possible_truncation)] // single precision
    fn add(&mut self, page: Stored) {
        fn to<T>(sums: &mut [f32], samples: Vec<T>, number: impl Fn(T) -> f32) {
            sums.iter_mut().zip(samples).for_each(|(sum, sample)| *sum += number(sample));
        }
        self.pages += 1;
        let sums = &mut self.sums;
        match page {
            Stored::Levels(Samples::Bits8(all)) => to(sums, all, f32::from),
            Stored::Levels(Samples::Bits16(all)) => to(sums, all, f32::from),
            Stored::Numbers(all, _) => to(sums, all, |number| number as f32),
        }
    }

    /// Returns the mean of the pages.
    pub fn mean(self) -> Vec<f32> {
        let pages = self.pages as f32;
        self.sums.into_iter().map(|sum| sum / pages).collect()
    }
}

/// Returns the mean of all pages as samples of 16 bits. Noise on nearly full pixels is cut off, so that their mean would be too
/// low: the largest sample stays.
fn average(bytes: &[u8]) -> Result<Decoded> {
    let mut largest: Option<Samples> = None;
    let sum = Sum::of_file(bytes, |page| {
        // Numbers of other types must be grey levels too.
        let levels = page.samples.levels()?;
        largest = Some(match largest.take() {
            Some(before) => larger(before, &levels),
            None => levels,
        });
        Ok(())
    })?;
    let (width, height, color) = (sum.width, sum.height, sum.color);
    let samples = largest.ok_or_else(|| Error::invalid("this TIFF file has no page"))?;
    let brightest = RawImage { width, height, color, samples };
    #[allow(clippy::cast_possible_truncation)] // samples have 16 bits
    let full = brightest.plateau().unwrap_or_else(|| brightest.full_scale()) as f32;
    let scale = if brightest.bits() == 8 { WIDER } else { 1.0 };
    let largest: Vec<f32> = match brightest.samples {
        Samples::Bits8(all) => all.into_iter().map(f32::from).collect(),
        Samples::Bits16(all) => all.into_iter().map(f32::from).collect(),
    };
    #[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss)] // within 16 bits
    let sample =
        |(mean, most): (f32, f32)| (scale * if most >= full { most } else { mean }).round() as u16;
    let samples = sum.mean().into_iter().zip(largest).map(sample).collect();
    Ok(Decoded { width, height, color, samples: Stored::Levels(Samples::Bits16(samples)) })
}

/// Returns the larger one of each pair of samples; of pages of other types, the first.
fn larger(mut a: Samples, b: &Samples) -> Samples {
    fn of<T: Ord + Copy>(a: &mut [T], b: &[T]) {
        a.iter_mut().zip(b).for_each(|(a, b)| *a = (*a).max(*b));
    }
    match (&mut a, b) {
        (Samples::Bits8(a), Samples::Bits8(b)) => of(a, b),
        (Samples::Bits16(a), Samples::Bits16(b)) => of(a, b),
        _ => {}
    }
    a
}
