//! The light of one micro-image, devignetted.

use nalgebra::Vector2;

use super::micro_images::MicroImages;
use crate::image::{Grey, Image};

/// Pixels of a micro-image: offsets from its centre (px), light relative to the white image, and
/// weights, 1 where the white image is brightest.
#[derive(Debug, Clone, Default)]
pub(super) struct Patch {
    pub x: Vec<f32>,
    pub y: Vec<f32>,
    pub light: Vec<f32>,
    pub weight: Vec<f32>,
    /// Part of the pixels that is saturated in the board's image.
    pub saturated: f32,
    /// Part of them that is saturated in the white image.
    pub saturated_white: f32,
    /// Its brightest light in the white image.
    pub brightest: f32,
}

/// Why a micro-image shows nothing.
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
    /// Every n-th of its pixels.
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

    /// Weighted mean of the light.
    pub fn mean(&self) -> f64 {
        self.mean_and_std_dev().0
    }

    /// Weighted mean and standard deviation of the light.
    pub fn mean_and_std_dev(&self) -> (f64, f64) {
        let (mut sum, mut first, mut second) = (0.0_f32, 0.0_f32, 0.0_f32);
        for (light, weight) in self.light.iter().zip(&self.weight) {
            sum += weight;
            first += weight * light;
            second += weight * light * light;
        }
        let mean = first / sum;
        (f64::from(mean), f64::from((second / sum - mean * mean).max(0.0).sqrt()))
    }

    /// Weighted sum of squares of the light less its mean.
    pub fn sum_of_squares(&self) -> f64 {
        let all = || {
            let all = self.light.iter().zip(&self.weight);
            all.map(|(&light, &weight)| (f64::from(light), f64::from(weight)))
        };
        let weights: f64 = all().map(|(_, weight)| weight).sum();
        let mean = all().map(|(light, weight)| light * weight).sum::<f64>() / weights;
        all().map(|(light, weight)| (light - mean).powi(2) * weight).sum()
    }
}

/// Pixels with less than this part of the micro-image's brightest light in the white image are not used.
pub(super) const USABLE: f32 = 0.06;
/// Variance of the read noise over that of the photon noise in the white image's brightest pixel: relative
/// to their light, darker pixels have more of it.
const READ_NOISE: f32 = 0.25;

/// The weight of a pixel whose light in the white image is such a part of the micro-image's brightest.
pub(super) fn weight(white: f32) -> f32 {
    white * white / (READ_NOISE + white) * (1.0 + READ_NOISE)
}

/// Fewest pixels for a corner of seven parameters, with some redundancy.
const FEWEST_PIXELS: usize = 40;

/// Two images of the same place: a board and its white image.
pub(super) struct Pair {
    pub board: Image,
    pub white: Image,
    /// Place of the first pixel.
    pub corner: Vector2<f64>,
}

impl Pair {
    /// The part of both images that is up to `reach` from some places.
    pub fn about(
        board: &Grey,
        white: &Grey,
        places: impl Iterator<Item = Vector2<f64>>,
        reach: f64,
    ) -> Self {
        let ((left, top, width, height), corner) = crate::image::bounds(places, reach);
        Self {
            board: board.part(left, top, width, height),
            white: white.part(left, top, width, height),
            corner,
        }
    }

    /// The patch of a micro-image, or why there is none.
    #[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss)] // inside the image; 32 bits do
    pub fn patch(&self, micro_images: &MicroImages, (k, l): (i32, i32)) -> Result<Patch, Unusable> {
        let center = micro_images.center(k, l) - self.corner;
        let optics = micro_images.optics(k, l);
        let reach = optics.outer_radius_px().min(optics.half_pitch_px);
        let (first, last) =
            (center.map(|x| (x - reach).ceil()), center.map(|x| (x + reach).floor()));
        let inside = first.min() >= 0.0
            && last.x < self.white.width as f64
            && last.y < self.white.height as f64;
        if !inside {
            return Err(Unusable::Cut);
        }
        let (left, top) = (first.x as usize, first.y as usize);
        let (right, bottom) = (last.x as usize, last.y as usize);
        let mut patch = Patch::default();
        let mut whites: Vec<f32> = Vec::new();
        let mut brightest = 0.0_f32;
        let reach2 = (reach * reach) as f32;
        for v in top..=bottom {
            let y = (v as f64 - center.y) as f32;
            for u in left..=right {
                let x = (u as f64 - center.x) as f32;
                if x * x + y * y > reach2 {
                    continue;
                }
                let i = v * self.white.width + u;
                let (board, white) = (self.board.pixels[i], self.white.pixels[i]);
                brightest = brightest.max(white);
                patch.x.push(x);
                patch.y.push(y);
                patch.light.push(board);
                whites.push(white);
            }
        }
        if brightest <= 0.0 {
            return Err(Unusable::Dark);
        }
        let part =
            |light: &[f32]| light.iter().filter(|&&l| l >= 1.0).count() as f32 / light.len() as f32;
        patch.brightest = brightest;
        patch.saturated = part(&patch.light);
        patch.saturated_white = part(&whites);
        let (mut kept, mut lit, mut lit_white) = (0, 0, 0);
        for (i, &of_pixel) in whites.iter().enumerate() {
            let white = of_pixel / brightest;
            if white < USABLE {
                continue;
            }
            lit += 1;
            lit_white += usize::from(of_pixel < 1.0);
            if patch.light[i] >= 1.0 || of_pixel >= 1.0 {
                continue;
            }
            patch.x[kept] = patch.x[i];
            patch.y[kept] = patch.y[i];
            patch.light[kept] = patch.light[i] / of_pixel;
            patch.weight.push(weight(white));
            kept += 1;
        }
        patch.x.truncate(kept);
        patch.y.truncate(kept);
        patch.light.truncate(kept);
        match (kept, lit_white, lit) {
            (FEWEST_PIXELS.., ..) => Ok(patch),
            (_, FEWEST_PIXELS.., _) => Err(Unusable::Saturated),
            (_, _, FEWEST_PIXELS..) => Err(Unusable::SaturatedWhite),
            _ => Err(Unusable::TooSmall),
        }
    }
}

#[cfg(test)]
pub(super) mod tests {
    use super::*;
    use crate::model::{
        Configuration, Datasheet, InternalParameters, Lattice, LatticeKind, Packing, Sensor,
    };
    use crate::precalibration::MicroImageArray;

    /// Three by three micro-images about the middle of an image of 61 x 61 px.
    pub fn micro_images(pitch_px: f64) -> MicroImages {
        let sheet = Datasheet {
            sensor: Sensor { width_px: 61, height_px: 61, pixel_size_mm: 0.0055 },
            focal_length_mm: 16.0,
            focus_distance_mm: 120.0,
            f_number: 4.0,
            configuration: Configuration::Galilean,
            lattice_kind: LatticeKind::Orthogonal,
            array_size: Some((3, 3)),
            lens_types: 1,
            micro_image_pitch_px: None,
        };
        let internal = InternalParameters {
            m_mm: 0.5 * pitch_px * 0.0055,
            q_prime_mm: vec![0.9 * pitch_px * 0.0055],
            micro_image_pitch_mm: None,
            m_std_dev_mm: None,
            q_prime_std_dev_mm: Vec::new(),
            pupil_growth: 0.0,
            fall_off: None,
            lean: None,
            point_spread: None,
            fill_factor: None,
            levels: None,
        };
        let grid = MicroImageArray {
            lattice: Lattice { packing: Packing::Orthogonal, columns: 3, rows: 3 },
            pitch_px,
            rotation_rad: 0.0,
            center_px: Vector2::new(30.0, 30.0),
            perspective_per_px: Vector2::zeros(),
            rms_px: 0.0,
            outliers: 0,
        };
        MicroImages::new(&grid, &[], &internal, &sheet).unwrap()
    }

    #[test]
    fn an_unusable_micro_image_says_why() {
        let flat = |light: f32| Image { width: 61, height: 61, pixels: vec![light; 61 * 61] };
        let of = |board: f32, white: f32, pitch_px: f64, corner: Vector2<f64>| {
            let pair = Pair { board: flat(board), white: flat(white), corner };
            pair.patch(&micro_images(pitch_px), (1, 1)).map(|patch| patch.light.len())
        };
        let whole = Vector2::zeros();
        assert!(of(0.5, 0.8, 16.0, whole).is_ok_and(|pixels| pixels > 100));
        assert_eq!(of(1.0, 0.8, 16.0, whole), Err(Unusable::Saturated));
        assert_eq!(of(0.5, 1.0, 16.0, whole), Err(Unusable::SaturatedWhite));
        assert_eq!(of(1.0, 1.0, 16.0, whole), Err(Unusable::SaturatedWhite));
        assert_eq!(of(0.5, 0.0, 16.0, whole), Err(Unusable::Dark));
        assert_eq!(of(0.5, 0.8, 6.0, whole), Err(Unusable::TooSmall));
        assert_eq!(of(0.5, 0.8, 16.0, Vector2::new(25.0, 0.0)), Err(Unusable::Cut));
    }

    /// The array may be smaller than the sensor.
    #[test]
    fn in_view_is_what_the_micro_images_show() {
        let micro_images = micro_images(16.0);
        let large = Sensor { width_px: 61, height_px: 61, pixel_size_mm: 0.0055 };
        let small = Sensor { height_px: 41, ..large };
        let shows = |u: f64, v: f64, sensor: &Sensor, margin_px: f64| {
            micro_images.show(&Vector2::new(u, v), sensor, margin_px)
        };
        // 24 px to every side of (30, 30).
        assert!(shows(53.0, 30.0, &large, 0.0) && !shows(55.0, 30.0, &large, 0.0));
        assert!(shows(7.0, 7.0, &large, 0.5) && !shows(7.0, 7.0, &large, 2.0));
        assert!(shows(30.0, 53.0, &large, 0.0) && !shows(30.0, 53.0, &small, 0.0));
        assert!(!shows(f64::NAN, 30.0, &large, 0.0));
    }
}
