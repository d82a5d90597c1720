//! Operations on the pixels of grey images, as cameras, programs and people apply them.

use image::{GrayImage, Luma};
use rand::rngs::StdRng;
use rand::{RngExt, SeedableRng};
use rand_distr::{Distribution, Normal};

#[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss)] // clamped
fn grey_level(value: f64) -> u8 {
    value.round().clamp(0.0, 255.0) as u8
}

/// Every grey level replaced.
pub fn curve(image: &GrayImage, of: impl Fn(f64) -> f64) -> GrayImage {
    let table: Vec<u8> = (0..=255_u8).map(|x| grey_level(of(f64::from(x)))).collect();
    let mut image = image.clone();
    image.pixels_mut().for_each(|p| p.0[0] = table[usize::from(p.0[0])]);
    image
}

pub fn gamma(image: &GrayImage, gamma: f64) -> GrayImage {
    curve(image, |x| 255.0 * (x / 255.0).powf(1.0 / gamma))
}

/// Noise of a given standard deviation, in grey levels.
pub fn noise(image: &GrayImage, std_dev: f64) -> GrayImage {
    let mut random = StdRng::seed_from_u64(
        7 + u64::from(image.as_raw().iter().map(|x| u32::from(*x)).sum::<u32>()),
    );
    let normal = Normal::new(0.0, std_dev).expect("it is positive");
    let mut image = image.clone();
    image
        .pixels_mut()
        .for_each(|p| p.0[0] = grey_level(f64::from(p.0[0]) + normal.sample(&mut random)));
    image
}

/// A part of all pixels full or dark.
pub fn salt_and_pepper(image: &GrayImage, part: f64) -> GrayImage {
    let mut random = StdRng::seed_from_u64(11);
    let mut image = image.clone();
    for p in image.pixels_mut() {
        if random.random::<f64>() < part {
            p.0[0] = if random.random::<bool>() { 255 } else { 0 };
        }
    }
    image
}

pub fn blur(image: &GrayImage, std_dev: f32) -> GrayImage {
    image::imageops::blur(image, std_dev)
}

/// Sharpened by the difference to a blurred image, as cameras do.
pub fn sharpened(image: &GrayImage, amount: f64) -> GrayImage {
    let soft = blur(image, 1.0);
    GrayImage::from_fn(image.width(), image.height(), |u, v| {
        let (x, s) = (f64::from(image.get_pixel(u, v).0[0]), f64::from(soft.get_pixel(u, v).0[0]));
        Luma([grey_level(x + amount * (x - s))])
    })
}

/// The grey level at a place, interpolated; that of the border beyond it.
fn at(image: &GrayImage, u: f64, v: f64) -> f64 {
    let (width, height) = (f64::from(image.width() - 1), f64::from(image.height() - 1));
    let (u, v) = (u.clamp(0.0, width), v.clamp(0.0, height));
    let (u0, v0) = (u.floor().min(width - 1.0), v.floor().min(height - 1.0));
    #[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss)] // within the image
    let pixel =
        |du: f64, dv: f64| f64::from(image.get_pixel((u0 + du) as u32, (v0 + dv) as u32).0[0]);
    let (a, b) = (u - u0, v - v0);
    (1.0 - b) * ((1.0 - a) * pixel(0.0, 0.0) + a * pixel(1.0, 0.0))
        + b * ((1.0 - a) * pixel(0.0, 1.0) + a * pixel(1.0, 1.0))
}

/// The image taken from other places of itself.
pub fn moved(image: &GrayImage, from: impl Fn(f64, f64) -> (f64, f64)) -> GrayImage {
    GrayImage::from_fn(image.width(), image.height(), |u, v| {
        let (u, v) = from(f64::from(u), f64::from(v));
        Luma([grey_level(at(image, u, v))])
    })
}

pub fn shifted(image: &GrayImage, by: f64) -> GrayImage {
    moved(image, |u, v| (u - by, v))
}

pub fn turned(image: &GrayImage, degrees: f64) -> GrayImage {
    let (sine, cosine) = degrees.to_radians().sin_cos();
    let (cu, cv) = (f64::from(image.width()) / 2.0, f64::from(image.height()) / 2.0);
    moved(image, |u, v| {
        (cu + cosine * (u - cu) + sine * (v - cv), cv - sine * (u - cu) + cosine * (v - cv))
    })
}

/// Enlarged about the middle, along u and v.
pub fn enlarged(image: &GrayImage, along_u: f64, along_v: f64) -> GrayImage {
    let (cu, cv) = (f64::from(image.width()) / 2.0, f64::from(image.height()) / 2.0);
    moved(image, |u, v| (cu + (u - cu) / along_u, cv + (v - cv) / along_v))
}

/// Light that changes over the image, from one part at the left to another at the right.
pub fn uneven(image: &GrayImage, left: f64, right: f64) -> GrayImage {
    GrayImage::from_fn(image.width(), image.height(), |u, v| {
        let part = f64::from(u) / f64::from(image.width());
        Luma([grey_level(f64::from(image.get_pixel(u, v).0[0]) * (left + (right - left) * part))])
    })
}

/// Moved by `length` pixels along u while it was taken.
pub fn motion(image: &GrayImage, length: u32) -> GrayImage {
    GrayImage::from_fn(image.width(), image.height(), |u, v| {
        let sum: f64 = (0..length)
            .map(|i| f64::from(image.get_pixel((u + i).min(image.width() - 1), v).0[0]))
            .sum();
        Luma([grey_level(sum / f64::from(length))])
    })
}

/// A dark rectangle over part of the image: a hand, a cable, a text.
pub fn covered(image: &GrayImage, [left, top, width, height]: [u32; 4], level: u8) -> GrayImage {
    let mut image = image.clone();
    for v in top..(top + height).min(image.height()) {
        for u in left..(left + width).min(image.width()) {
            image.put_pixel(u, v, Luma([level]));
        }
    }
    image
}
