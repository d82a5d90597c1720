//! What is done to the images of a set, by the roles they have.

use image::{DynamicImage, GrayImage, ImageFormat, ImageReader};
use rayon::prelude::*;

use crate::set::Set;

/// Images that a mistake is made in.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Of {
    All,
    /// White images, the devignetting image included.
    Whites,
    /// Boards of all subsets.
    Boards,
    /// One board of the calibration.
    OneBoard,
}

impl Of {
    pub fn name(self) -> &'static str {
        match self {
            Self::All => "all images",
            Self::Whites => "whites",
            Self::Boards => "boards",
            Self::OneBoard => "one board",
        }
    }

    fn images(self, set: &Set) -> Vec<String> {
        let whites = || [set.images("whites"), vec!["devignetting.png".to_owned()]].concat();
        let boards =
            || ["calibration", "evaluation", "translation"].map(|role| set.images(role)).concat();
        match self {
            Self::All => [whites(), boards()].concat(),
            Self::Whites => whites(),
            Self::Boards => boards(),
            Self::OneBoard => vec!["calibration/calibration-04.png".to_owned()],
        }
    }
}

/// Changes images; they stay PNG.
pub fn changed(set: Set, of: Of, change: impl Fn(usize, GrayImage) -> DynamicImage + Sync) -> Set {
    let names = of.images(&set);
    let write = |(i, name): (usize, &String)| {
        let path = set.path().join(name);
        let image =
            ImageReader::open(&path).expect("it is there").decode().expect("it is an image");
        let mut bytes = std::io::Cursor::new(Vec::new());
        change(i, image.to_luma8()).write_to(&mut bytes, ImageFormat::Png).expect("it is written");
        set.write(name, bytes.into_inner());
    };
    names.par_iter().enumerate().for_each(write);
    set
}

/// Changes grey images, all alike.
pub fn grey(set: Set, of: Of, change: impl Fn(&GrayImage) -> GrayImage + Sync) -> Set {
    changed(set, of, |_, image| change(&image).into())
}

/// Writes images as JPEG, under that name.
pub fn jpeg(set: Set, of: Of, quality: u8) -> Set {
    let names = of.images(&set);
    let write = |name: &String| {
        let path = set.path().join(name);
        let image =
            ImageReader::open(&path).expect("it is there").decode().expect("it is an image");
        let mut bytes = Vec::new();
        image
            .write_with_encoder(image::codecs::jpeg::JpegEncoder::new_with_quality(
                &mut bytes, quality,
            ))
            .expect("it is written");
        set.write(&name.replace(".png", ".jpg"), bytes);
    };
    names.par_iter().for_each(write);
    names.iter().fold(set, |set, name| {
        set.text(&format!("\"{name}\""), &format!("\"{}\"", name.replace(".png", ".jpg")))
    })
}
