//! What pixels see of the overlap of two discs.
//!
//! The light of a pixel at distance r is the mean of that at distances t of all places that the pixel collects light from:
//! the overlap of the discs there, times how light falls off with the angles at which it arrives. So it is a sum over t with
//! weights that depend on r and the pixel alone. They are found once, and then used for any discs.

use rayon::prelude::*;

use crate::optics::{Obliquity, Overlap, Pixel, overlap, overlap_area};

/// Steps of the distances from the middle that light is seen at, and of those that it comes from, px.
const SEEN_PX: f64 = 0.0625;
const FROM_PX: f64 = 0.031_25;
/// Pixels of a larger variance along an axis, px², blur what steps of twice that would miss.
const WIDE_PX2: f64 = 0.25;

/// Steps of the distances at which angles are known, px.
const ANGLES_PX: f64 = 0.125;

/// The angles at which light arrives through a micro-lens, by distance from the middle of the micro-image.
#[derive(Debug, Clone, PartialEq, Default)]
pub(super) struct Angles(Vec<Angle>);

#[derive(Debug, Clone, Copy, PartialEq)]
struct Angle {
    /// Mean square of the vectors from the part of the micro-lens that light comes through to here, px².
    square: f64,
    /// Variance of these squares, px⁴.
    variance: f64,
}

/// Light over what it would be at normal incidence, by distance from the middle; 1 without any.
#[derive(Debug, Clone, PartialEq, Default)]
pub(super) struct Oblique(Vec<f64>);

impl Angles {
    /// Through a micro-lens with the blur radius `q_px` (with the sign that Eq. (radiusfinal) gives it), from a pupil of radius
    /// `pupil_px`.
    pub fn new(pupil_px: f64, q_px: f64, half_pitch_px: f64) -> Self {
        let q = q_px.abs().max(1e-6);
        #[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss)] // some pixels
        let count = ((pupil_px + q) / ANGLES_PX).ceil() as usize + 1;
        let angle = |i: usize| {
            let r = i as f64 * ANGLES_PX;
            let part = overlap(r / q, pupil_px / q);
            let part = part.unwrap_or(Overlap { mean: 1.0, along: 0.0, across: 0.0, area: 0.0 });
            let from_lens = r + part.mean * q_px.signum() * half_pitch_px;
            let [along, across] =
                [part.along, part.across].map(|of_half| (of_half * half_pitch_px / 2.0).powi(2));
            // As of a disc with these variances.
            let variance = 4.0 * from_lens * from_lens * along + along * along + across * across
                - 2.0 / 3.0 * along * across;
            Angle { square: from_lens * from_lens + along + across, variance }
        };
        Self((0..count).map(angle).collect())
    }

    /// How light falls off with them.
    pub fn oblique(&self, law: &Obliquity) -> Oblique {
        Oblique(self.0.iter().map(|angle| law.mean_light(angle.square, angle.variance)).collect())
    }
}

impl Oblique {
    fn at(&self, distance_px: f64) -> f64 {
        let Some(last) = self.0.len().checked_sub(1) else { return 1.0 };
        let place = (distance_px / ANGLES_PX).min(last as f64);
        #[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss)] // cut to the table
        let below = place as usize;
        let part = place - below as f64;
        self.0[below] * (1.0 - part) + self.0[(below + 1).min(last)] * part
    }
}

/// The weights by which pixels of one kind see the light.
#[derive(Debug)]
pub(super) struct PixelResponse {
    rows: Vec<Row>,
    /// Step of the distances that light comes from, px, and their number.
    from_px: f64,
    from: usize,
}

/// The weights of a pixel at one distance.
#[derive(Debug)]
struct Row {
    /// The first distance that light comes from.
    first: usize,
    /// By distance.
    weights: Vec<f64>,
}

/// The light of two discs as pixels see it, by distance.
pub(super) struct SeenDiscs(Vec<f64>);

impl PixelResponse {
    /// Of such pixels up to a distance from the middle, px.
    pub fn new(pixel: &Pixel, reach_px: f64) -> Self {
        let places = pixel.places();
        #[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss)] // some pixels
        let count = (reach_px / SEEN_PX).ceil() as usize + 4;
        let from_px = if pixel.variance > WIDE_PX2 { 2.0 * FROM_PX } else { FROM_PX };
        let row = |i: usize| Row::new(i as f64 * SEEN_PX, &places, from_px);
        let rows: Vec<Row> = (0..count).into_par_iter().map(row).collect();
        let from = rows.iter().map(|row| row.first + row.weights.len()).max().unwrap_or_default();
        Self { rows, from_px, from }
    }

    /// The light of discs with these sum and difference of radii, px.
    pub fn discs(&self, outer: f64, inner: f64, oblique: &Oblique) -> SeenDiscs {
        let light = |i: usize| {
            let t = i as f64 * self.from_px;
            if t < outer { overlap_area(t, outer, inner) * oblique.at(t) } else { 0.0 }
        };
        let light: Vec<f64> = (0..self.from).map(light).collect();
        let seen = |row: &Row| {
            let all = row.weights.iter().zip(&light[row.first..]);
            all.map(|(weight, light)| weight * light).sum()
        };
        SeenDiscs(self.rows.iter().map(seen).collect())
    }
}

impl Row {
    fn new(r: f64, places: &[(f64, f64)], from_px: f64) -> Self {
        let widest = places.iter().map(|(x, _)| x.abs()).fold(0.0, f64::max);
        #[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss)] // some pixels
        let (first, last) = (
            ((r - widest).max(0.0) / from_px) as usize,
            ((r + widest).hypot(widest) / from_px) as usize + 1,
        );
        // Where the pixel contains the middle, light comes from everywhere up to its corner.
        let first = if r > widest { first } else { 0 };
        let mut weights = vec![0.0; last + 1 - first];
        for &(x, of_x) in places {
            // Both sides together.
            for &(y, of_y) in &places[places.len() / 2..] {
                let at = (r + x).hypot(y) / from_px;
                #[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss)] // not below 0
                let below = at as usize;
                let (part, weight) = (at - below as f64, 2.0 * of_x * of_y);
                weights[below - first] += weight * (1.0 - part);
                weights[below + 1 - first] += weight * part;
            }
        }
        Self { first, weights }
    }
}

impl SeenDiscs {
    /// What a pixel at distance r sees, px.
    pub fn at(&self, r: f64) -> f64 {
        let place = r / SEEN_PX;
        #[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss)] // cut to the table
        let i = (place as usize).clamp(1, self.0.len() - 3);
        debug_assert!(place < (self.0.len() - 1) as f64, "{r} px is beyond the table");
        let x = place - i as f64;
        // Lagrange's polynomial through four.
        let weights = [
            -x * (x - 1.0) * (x - 2.0) / 6.0,
            (x + 1.0) * (x - 1.0) * (x - 2.0) / 2.0,
            -(x + 1.0) * x * (x - 2.0) / 2.0,
            (x + 1.0) * x * (x - 1.0) / 6.0,
        ];
        weights.iter().zip(&self.0[i - 1..i + 3]).map(|(weight, light)| weight * light).sum()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Against sums over a pixel's square and a normal spread, with light that falls off.
    #[test]
    fn pixels_see_what_falls_into_them() {
        let law = Obliquity::in_the_middle(4.0 / 3600.0, 60.0, 11.5);
        for (spread, a, b) in [
            (0.0, 5.7, 4.3),
            (0.01, 5.7, 4.3),
            (0.25, 6.6, 2.6),
            (1.0, 5.25, 1.55),
            (1.0, 2.3, 2.9),
        ] {
            let oblique = Angles::new(a, -b, 11.5).oblique(&law);
            let (outer, inner) = (a + b, f64::abs(a - b));
            let seen = PixelResponse::new(&Pixel::new(spread), 10.0).discs(outer, inner, &oblique);
            for r in [0.0, 0.6, 2.9, 4.5, 6.4, 8.1, 9.6] {
                let (mut sum, mut weights) = (0.0, 0.0);
                let reach = 0.5 + 5.0 * f64::sqrt(spread);
                let places = || (0..201).map(|i| reach * (f64::from(i) - 100.0) / 100.5);
                let below = |x: f64| libm::erf(x / f64::sqrt(2.0 * spread));
                let weight = |x: f64| {
                    if spread == 0.0 { 1.0 } else { below(x + 0.5) - below(x - 0.5) }
                };
                for (x, y) in places().flat_map(|x| places().map(move |y| (x, y))) {
                    let (weight, t) = (weight(x) * weight(y), (r + x).hypot(y));
                    weights += weight;
                    sum += weight * overlap_area(t, outer, inner) * oblique.at(t);
                }
                let (found, expected) = (seen.at(r), sum / weights);
                assert!(
                    (found - expected).abs() < 5e-4,
                    "{spread}, {r} px: {found} for {expected}"
                );
            }
        }
    }
}
