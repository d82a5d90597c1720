//! White light of a micro-image: the sum of [`super::Bundle`] without a scene. It depends on the distance from the centre alone
//! and is integrated over the opening in closed form.
//!
//! The rays that reach a point p of the sensor pass the part of the opening that the pupil covers: the overlap of discs with
//! the radii |q| and a, the distance |p| apart. The light is the area of this overlap times the mean angular response of its
//! rays. The moments of the overlap give this mean to the second order of the squared angle. A pixel averages the light over
//! its square and the point spread, with weights that depend on the pixel alone. A polygonal opening is averaged over all
//! directions: a weighted sum of discs ([`Opening::discs`]).

use rayon::prelude::*;

use super::response::Obliquity;
use crate::model::Opening;

/// The two discs of a micro-image, with the angular response.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct WhiteDiscs {
    /// Radius a of the pupil, seen through the middle of the micro-lens, px.
    pub pupil_px: f64,
    /// Blur radius q of a point of the pupil, px, with the sign of Eq. (radiusfinal).
    pub q_px: f64,
    /// Half the width of the opening, px.
    pub opening_px: f64,
    pub opening: Opening,
    pub law: Obliquity,
}

/// Light at a point of the sensor, with its derivatives.
#[derive(Debug, Clone, Copy, Default)]
pub(crate) struct PointLight {
    /// Light relative to normal incidence from the whole smaller disc, of which one is the disc within the opening.
    pub light: f64,
    /// Decrease of the light with the outward gradient g of the angular response, px: the light times the mean of the vectors
    /// y − M of its rays, weighted by the decrease of light with their angle.
    pub sensitivity: f64,
    /// Derivative of the light by H, px².
    pub by_within: f64,
    /// Derivative of the light by the logarithm of all squared angles.
    pub by_obliquity: f64,
}

/// Steps of numerical derivatives: by radii and vectors, px; by H, px⁻²; relative. All functions are in closed form, in double
/// precision.
const STEP_PX: f64 = 1e-5;
const STEP_PER_PX2: f64 = 1e-8;
const STEP: f64 = 1e-5;
/// Smallest blur radius, px; smaller ones are as good as 0.
const LEAST_PX: f64 = 1e-6;

impl WhiteDiscs {
    /// Creates discs of two radii, px, without angular response.
    pub fn plain(pupil_px: f64, blur_px: f64) -> Self {
        let (opening, law) = (Opening::Disc, Obliquity::default());
        Self { pupil_px, q_px: blur_px, opening_px: 0.0, opening, law }
    }

    /// Returns the light at a distance from the centre, px.
    pub fn light(&self, distance_px: f64) -> f64 {
        self.parts().map(|(weight, part)| weight * part.light_of_disc(distance_px)).sum()
    }

    /// Returns the mean angular response at a distance from the centre, px.
    pub fn fall_off(&self, distance_px: f64) -> f64 {
        let response = |part: &Self| part.response(distance_px, &part.overlap(distance_px), 0.0);
        let area = |(weight, part): &(f64, Self)| weight * part.overlap(distance_px).area;
        let whole: f64 = self.parts().map(|part| area(&part)).sum();
        if whole <= 0.0 {
            return response(self);
        }
        self.light(distance_px) / whole
    }

    /// Returns the light at a distance from the centre, px, with its derivatives.
    pub fn point(&self, distance_px: f64) -> PointLight {
        self.parts().fold(PointLight::default(), |sum, (weight, part)| {
            let of = part.point_of_disc(distance_px);
            PointLight {
                light: sum.light + weight * of.light,
                sensitivity: sum.sensitivity + weight * of.sensitivity,
                by_within: sum.by_within + weight * of.by_within,
                by_obliquity: sum.by_obliquity + weight * of.by_obliquity,
            }
        })
    }

    /// Returns the discs that replace the opening, with their weights.
    fn parts(&self) -> impl Iterator<Item = (f64, Self)> {
        let smaller_px = self.smaller_px();
        self.opening.discs().iter().map(move |&(radius, weight)| {
            let part = Self {
                q_px: self.q_px * radius,
                opening_px: self.opening_px * radius,
                opening: Opening::Disc,
                ..*self
            };
            (weight * (part.smaller_px() / smaller_px).powi(2), part)
        })
    }

    fn light_of_disc(&self, distance_px: f64) -> f64 {
        let overlap = self.overlap(distance_px);
        overlap.area * self.response(distance_px, &overlap, 0.0)
    }

    fn point_of_disc(&self, distance_px: f64) -> PointLight {
        let overlap = self.overlap(distance_px);
        if overlap.area <= 0.0 {
            return PointLight::default();
        }
        let Obliquity { within_per_px2: within, of_pixels_per_px2: of_pixels, .. } = self.law;
        let response = self.response(distance_px, &overlap, 0.0);
        let by = |moved: f64, step: f64| overlap.area * (moved - response) / step;
        let with_law = |within_per_px2: f64, of_pixels_per_px2: f64| {
            let law = Obliquity { within_per_px2, of_pixels_per_px2, ..self.law };
            Self { law, ..*self }.response(distance_px, &overlap, 0.0)
        };
        // The derivative of f(s²) along s is 2 s f′; at normal incidence, f′ = −H/2.
        let sensitivity = if within == 0.0 {
            overlap.area * self.angles(distance_px, &overlap, 0.0).0
        } else {
            -by(self.response(distance_px, &overlap, STEP_PX), STEP_PX) / within
        };
        // The pixels cause the part of H above cos⁴.
        let more_of_pixels = if of_pixels > 0.0 { STEP_PER_PX2 } else { 0.0 };
        PointLight {
            light: overlap.area * response,
            sensitivity,
            by_within: by(
                with_law(within + STEP_PER_PX2, of_pixels + more_of_pixels),
                STEP_PER_PX2,
            ),
            by_obliquity: by(with_law(within * (1.0 + STEP), of_pixels * (1.0 + STEP)), STEP),
        }
    }

    /// Returns the derivatives of the light by a and |q|, px⁻¹, with the smaller disc held as the unit.
    pub fn by_radii(&self, distance_px: f64) -> [f64; 2] {
        let (light, smaller) = (self.light(distance_px), self.smaller_px());
        let step_q = STEP_PX.copysign(self.q_px);
        [(STEP_PX, 0.0), (0.0, step_q)].map(|(by_pupil, by_q)| {
            let moved =
                Self { pupil_px: self.pupil_px + by_pupil, q_px: self.q_px + by_q, ..*self };
            let unit = (moved.smaller_px() / smaller).powi(2);
            (moved.light(distance_px) * unit - light) / STEP_PX
        })
    }

    fn blur_px(&self) -> f64 {
        self.q_px.abs().max(LEAST_PX)
    }

    fn smaller_px(&self) -> f64 {
        self.pupil_px.min(self.blur_px())
    }

    fn overlap(&self, distance_px: f64) -> Overlap {
        let blur = self.blur_px();
        Overlap::new(distance_px / blur, self.pupil_px / blur)
    }

    /// Returns the mean response of the rays through an overlap, with vectors y − M that are longer by a step outwards.
    fn response(&self, distance_px: f64, overlap: &Overlap, step_px: f64) -> f64 {
        let (_, square, variance) = self.angles(distance_px, overlap, step_px);
        self.law.mean_light(square, variance)
    }

    /// Returns the outward mean of the vectors y − M, px, the mean of their squares, px², and the variance of their squares,
    /// px⁴.
    fn angles(&self, distance_px: f64, overlap: &Overlap, step_px: f64) -> (f64, f64, f64) {
        // If f < d, the far side of the micro-lens lights the edge of the micro-image; if f > d, the near side does.
        let outwards = distance_px + step_px + overlap.mean * self.opening_px * self.q_px.signum();
        let square = self.opening_px.powi(2);
        let (along, across) = (overlap.along * square, overlap.across * square);
        // The fourth moments are taken from an ellipse with these variances.
        let variance = 4.0 * outwards * outwards * along + along * along + across * across
            - 2.0 / 3.0 * along * across;
        (outwards, outwards * outwards + along + across, variance)
    }
}

/// Part of the unit disc that another disc covers.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Overlap {
    /// Area, relative to the smaller disc.
    area: f64,
    /// Distance of the centroid from the middle of the unit disc, towards the other disc.
    mean: f64,
    /// Variances along this direction and across it.
    along: f64,
    across: f64,
}

/// Returns the area of a segment of a disc, its first moment about the middle of the disc towards the segment, and its second
/// moments along and across this direction.
fn segment(radius: f64, distance: f64) -> [f64; 4] {
    let cos = (distance / radius).clamp(-1.0, 1.0);
    let (angle, sin) = (cos.acos(), (1.0 - cos * cos).sqrt());
    let (sector, cubed) = (angle - sin * cos, sin * sin * sin);
    let squared = radius * radius;
    [
        squared * sector,
        2.0 / 3.0 * squared * radius * cubed,
        squared * squared / 4.0 * (sector + 2.0 * cubed * cos),
        squared * squared / 12.0 * (3.0 * sector - 2.0 * cubed * cos),
    ]
}

/// Smallest relative area for which moments are computed.
const LEAST_AREA: f64 = 1e-9;

impl Overlap {
    /// Computes the overlap with a disc of another radius at a distance.
    fn new(distance: f64, radius: f64) -> Self {
        if distance + 1.0 <= radius {
            return Self { area: 1.0, mean: 0.0, along: 0.25, across: 0.25 };
        }
        if distance + radius <= 1.0 {
            let variance = radius * radius / 4.0;
            return Self { area: 1.0, mean: distance, along: variance, across: variance };
        }
        if distance >= 1.0 + radius {
            return Self { area: 0.0, mean: 1.0, along: 0.0, across: 0.0 };
        }
        // The line through the intersections of the two circles divides the overlap into one segment of each disc.
        let line = (distance * distance + 1.0 - radius * radius) / (2.0 * distance);
        let [area, first, along, across] = segment(1.0, line);
        let [other, first_of, along_of, across_of] = segment(radius, distance - line);
        let all = area + other;
        let smaller = std::f64::consts::PI * radius.min(1.0).powi(2);
        if all < LEAST_AREA * smaller {
            return Self { area: all / smaller, mean: line, along: 0.0, across: 0.0 };
        }
        let mean = (first + distance * other - first_of) / all;
        let square =
            (along + distance * distance * other - 2.0 * distance * first_of + along_of) / all;
        Self {
            area: all / smaller,
            mean,
            along: (square - mean * mean).max(0.0),
            across: (across + across_of) / all,
        }
    }
}

/// Steps of the distances from the middle, px: of pixels and of the light that they collect.
const SEEN_PX: f64 = 0.0625;
const FROM_PX: f64 = 0.031_25;
/// Variance of a pixel along an axis, px², above which its blur permits steps of twice `FROM_PX`.
const WIDE_PX2: f64 = 0.25;
/// Number of sample points of a pixel along an axis, and their reach beyond the square, in standard deviations of the point
/// spread.
const PLACES: usize = 24;
const BEYOND: f64 = 4.5;
/// Variance added to the point spread, px², without which the sample points would change too fast near 0.
const SMOOTH_PX2: f64 = 0.0025;
/// Variance of a square of 1 px along an axis, px².
const SQUARE_PX2: f64 = 1.0 / 12.0;

/// Weights with which pixels with a point spread collect light that depends on the distance from a middle, by the distances of
/// the pixel and of the light.
#[derive(Debug)]
pub(crate) struct RadialPixels {
    rows: Vec<Row>,
    /// Step of the distances of the light, px, and their number.
    from_px: f64,
    from: usize,
}

/// Weights of a pixel at one distance.
#[derive(Debug)]
struct Row {
    /// Index of the smallest distance of the light.
    first: usize,
    /// Weights by distance: of light, and of the component along the direction to the pixel of outward vectors.
    weights: Vec<[f64; 2]>,
}

/// Values of pixels, by their distance.
#[derive(Debug)]
pub(crate) struct Seen(Vec<f64>);

impl RadialPixels {
    /// Computes the weights for a point spread with this variance along an axis, px², up to a distance from the middle, px.
    pub fn new(point_spread_px2: f64, reach_px: f64) -> Self {
        let variance = SQUARE_PX2 + point_spread_px2.max(0.0);
        let places = places(variance);
        #[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss)] // some pixels
        let count = (reach_px / SEEN_PX).ceil() as usize + 4;
        let from_px = if variance > WIDE_PX2 { 2.0 * FROM_PX } else { FROM_PX };
        let row = |i: usize| Row::new(i as f64 * SEEN_PX, &places, from_px);
        let rows: Vec<Row> = (0..count).into_par_iter().map(row).collect();
        let from = rows.iter().map(|row| row.first + row.weights.len()).max().unwrap_or_default();
        Self { rows, from_px, from }
    }

    /// Returns the pixel values of quantities that depend on the distance.
    pub fn see<const N: usize>(&self, light: impl Fn(f64) -> [f64; N]) -> [Seen; N] {
        self.seen(light, 0)
    }

    /// Returns the pixel values of vectors that point away from the middle: their outward components.
    pub fn see_outwards<const N: usize>(&self, lengths: impl Fn(f64) -> [f64; N]) -> [Seen; N] {
        self.seen(lengths, 1)
    }

    fn seen<const N: usize>(&self, light: impl Fn(f64) -> [f64; N], which: usize) -> [Seen; N] {
        let light: Vec<[f64; N]> = (0..self.from).map(|i| light(i as f64 * self.from_px)).collect();
        let of_row = |row: &Row, of: usize| {
            let all = row.weights.iter().zip(&light[row.first..]);
            all.map(|(weights, light)| weights[which] * light[of]).sum()
        };
        std::array::from_fn(|of| Seen(self.rows.iter().map(|row| of_row(row, of)).collect()))
    }
}

/// Returns sample points along an axis from the middle of a pixel with a variance, px, and their weights. They change smoothly
/// with the point spread, down to 0.
fn places(variance: f64) -> [(f64, f64); PLACES] {
    let spread = (variance - SQUARE_PX2).max(1e-12);
    let reach = 0.5 + BEYOND * (spread + SMOOTH_PX2).sqrt();
    let step = 2.0 * reach / PLACES as f64;
    let spread = spread.sqrt();
    // Integral of the cumulative normal distribution; its differences give the blurred square.
    let integral = |x: f64| {
        let z = x / spread;
        let below = 0.5 * libm::erfc(-z * std::f64::consts::FRAC_1_SQRT_2);
        x * below + spread * (-z * z / 2.0).exp() / std::f64::consts::TAU.sqrt()
    };
    let up_to = |x: f64| integral(x + 0.5) - integral(x - 0.5);
    let rule: [(f64, f64); PLACES] = std::array::from_fn(|i| {
        let left = i as f64 * step - reach;
        (left + step / 2.0, up_to(left + step) - up_to(left))
    });
    let sum: f64 = rule.iter().map(|(_, weight)| weight).sum();
    let square: f64 = rule.iter().map(|(x, weight)| x * x * weight).sum();
    let wider = (variance * sum / square).sqrt();
    rule.map(|(x, weight)| (x * wider, weight / sum))
}

impl Row {
    fn new(r: f64, places: &[(f64, f64)], from_px: f64) -> Self {
        let widest = places.iter().map(|(x, _)| x.abs()).fold(0.0, f64::max);
        #[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss)] // some pixels
        let (first, last) = (
            ((r - widest).max(0.0) / from_px) as usize,
            ((r + widest).hypot(widest) / from_px) as usize + 1,
        );
        // If the pixel contains the middle, light comes from all distances up to its corner.
        let first = if r > widest { first } else { 0 };
        let mut weights = vec![[0.0; 2]; last + 1 - first];
        for &(x, of_x) in places {
            // Both halves are symmetric.
            for &(y, of_y) in &places[places.len() / 2..] {
                let distance = (r + x).hypot(y);
                let at = distance / from_px;
                #[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss)] // not below 0
                let below = at as usize;
                let (part, weight) = (at - below as f64, 2.0 * of_x * of_y);
                let along = (r + x) / distance.max(1e-9);
                for (i, part) in [(below, 1.0 - part), (below + 1, part)] {
                    weights[i - first][0] += weight * part;
                    weights[i - first][1] += weight * part * along;
                }
            }
        }
        Self { first, weights }
    }
}

impl Seen {
    /// Returns the difference from another over a step.
    pub fn change(&self, from: &Self, step: f64) -> Self {
        Self(self.0.iter().zip(&from.0).map(|(to, from)| (to - from) / step).collect())
    }

    /// Returns this plus some steps of another.
    pub fn plus(&self, by: &Self, step: f64) -> Self {
        Self(self.0.iter().zip(&by.0).map(|(light, by)| light + step * by).collect())
    }

    /// Returns the value of a pixel at a distance, px.
    pub fn at(&self, distance_px: f64) -> f64 {
        self.with_slope(distance_px).0
    }

    /// Returns this value and its derivative by the distance, px⁻¹.
    pub fn with_slope(&self, distance_px: f64) -> (f64, f64) {
        let place = distance_px / SEEN_PX;
        #[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss)] // cut to the table
        let i = (place as usize).clamp(1, self.0.len() - 3);
        debug_assert!(place < (self.0.len() - 1) as f64, "{distance_px} px is beyond the table");
        let x = place - i as f64;
        // Lagrange interpolation through four values.
        let weights = [
            -x * (x - 1.0) * (x - 2.0) / 6.0,
            (x + 1.0) * (x - 1.0) * (x - 2.0) / 2.0,
            -(x + 1.0) * x * (x - 2.0) / 2.0,
            (x + 1.0) * x * (x - 1.0) / 6.0,
        ];
        let slopes = [
            -(3.0 * x * x - 6.0 * x + 2.0) / 6.0,
            (3.0 * x * x - 4.0 * x - 1.0) / 2.0,
            -(3.0 * x * x - 2.0 * x - 2.0) / 2.0,
            (3.0 * x * x - 1.0) / 6.0,
        ];
        let of = |weights: &[f64; 4]| -> f64 {
            weights.iter().zip(&self.0[i - 1..i + 3]).map(|(weight, light)| weight * light).sum()
        };
        (of(&weights), of(&slopes) / SEEN_PX)
    }
}

#[cfg(test)]
mod tests {
    use nalgebra::Vector2;

    use super::super::oracle::{HALF_PITCH, Oracle};
    use super::*;

    /// Compares with the exact area: equal discs one radius r apart have (2π/3 − √3/2) r² in common.
    #[test]
    fn areas_of_overlaps() {
        let light = |a, b, r| WhiteDiscs::plain(a, b).light(r);
        let equal = (2.0 * std::f64::consts::PI / 3.0 - 0.75_f64.sqrt()) / std::f64::consts::PI;
        assert!((light(2.0, 2.0, 2.0) - equal).abs() < 1e-12);
        assert!((light(2.5, 1.5, 0.5) - 1.0).abs() < 1e-12);
        assert!(light(2.5, 1.5, 4.0).abs() < 1e-12);
        // The integral over the plane is the area of the larger disc.
        let area: f64 = (0..70_000)
            .map(|i| (f64::from(i) + 0.5) * 1e-4)
            .map(|r| std::f64::consts::TAU * r * light(4.5, 2.5, r) * 1e-4)
            .sum();
        assert!((area / (std::f64::consts::PI * 4.5 * 4.5) - 1.0).abs() < 1e-6);
    }

    /// Compares with sums over points of the unit disc.
    #[test]
    fn moments_of_overlaps() {
        for (distance, radius) in [(1.0, 3.0), (0.3, 0.5), (1.3, 0.9), (0.9, 0.4), (2.0, 1.8)] {
            let [mut sum, mut first, mut along, mut across] = [0.0; 4];
            for i in -800..=800 {
                for j in -800..=800 {
                    let [x, y] = [i, j].map(|k| f64::from(k) / 800.0);
                    if x.hypot(y) < 1.0 && (x - distance).hypot(y) < radius {
                        sum += 1.0;
                        first += x;
                        along += x * x;
                        across += y * y;
                    }
                }
            }
            let mean = first / sum;
            let expected = [mean, along / sum - mean * mean, across / sum];
            let Overlap { mean, along, across, .. } = Overlap::new(distance, radius);
            for (found, expected) in [mean, along, across].iter().zip(expected) {
                assert!((found - expected).abs() < 1e-3, "{distance}, {radius}: {found}");
            }
        }
    }

    /// Compares with the sum over rays that also tests the light of corners, averaged over the directions of a square pixel.
    #[test]
    fn white_light_is_the_sum_of_its_rays() {
        for (spread, a, q, of_pixels) in [
            (0.0, 5.7, -4.3, 0.0),
            (0.01, 5.7, 4.3, 0.0),
            (0.25, 6.6, -2.6, 1.2e-3),
            (1.0, 5.25, 1.55, 0.0),
            (1.0, 2.3, -2.9, 1.2e-3),
            (0.09, 1.67, -5.1, 0.0),
        ] {
            let oracle = Oracle {
                q,
                pupil: a,
                point_spread_px2: spread,
                of_pixels_per_px2: of_pixels,
                of_pixel: if spread > 0.5 { 32 } else { 20 },
                rings: 60,
                ..Oracle::default()
            };
            let law = oracle.law();
            let discs = WhiteDiscs {
                pupil_px: a,
                q_px: q,
                opening_px: HALF_PITCH,
                opening: Opening::Disc,
                law,
            };
            let [seen] = RadialPixels::new(spread, 12.0).see(|t| [discs.light(t)]);
            let all = oracle.whole_disc() * f64::min(1.0, a / q.abs()).powi(2);
            for r in [0.0, 0.6, 2.9, 4.5, 6.4, 8.1, 9.6] {
                let of = |turn: f64| oracle.of_pixel([r * turn.cos(), r * turn.sin()], &[]).0 / all;
                let expected = (of(0.05) + of(0.3) + of(0.55)) / 3.0;
                let found = seen.at(r);
                assert!(
                    (found - expected).abs() < 1e-3,
                    "{a} {q} {spread} {r}: {found} {expected}"
                );
            }
        }
    }

    /// Compares with the sum over rays in many directions.
    #[test]
    fn white_light_of_polygons_is_the_mean_over_directions() {
        for (opening, a, q) in [
            (Opening::Hexagon, 5.7, -4.3),
            (Opening::Square, 6.6, -2.6),
            (Opening::Square, 2.3, -4.0),
        ] {
            let oracle =
                Oracle { q, pupil: a, opening, of_pixel: 12, rings: 30, ..Oracle::default() };
            let law = oracle.law();
            let discs = WhiteDiscs { pupil_px: a, q_px: q, opening_px: HALF_PITCH, opening, law };
            let [seen] = RadialPixels::new(0.0, 12.0).see(|t| [discs.light(t)]);
            let of = |r: f64, turn: f64| oracle.of_pixel([r * turn.cos(), r * turn.sin()], &[]).0;
            let mean = |r: f64| (0..40).map(|i| of(r, f64::from(i) * 0.157 + 0.01)).sum::<f64>();
            let middle = mean(0.0) / seen.at(0.0);
            for r in [1.6, 2.9, 4.5, 6.4, 8.1] {
                let (found, expected) = (seen.at(r), mean(r) / middle);
                assert!((found - expected).abs() < 5e-3, "{opening:?} {r}: {found} {expected}");
            }
        }
    }

    /// Compares derivatives with differences, and the sensitivity with a sum over rays.
    #[test]
    fn derivatives_of_white_light() {
        let discs = WhiteDiscs {
            pupil_px: 5.7,
            q_px: -4.3,
            opening_px: 11.0,
            opening: Opening::Disc,
            law: Obliquity::in_the_middle(5e-3, 60.0, 11.5),
        };
        let with = |change: &dyn Fn(&mut WhiteDiscs)| {
            let mut changed = discs;
            change(&mut changed);
            changed
        };
        let more = with(&|d| d.law = Obliquity::in_the_middle(5e-3 + 1e-7, 60.0, 11.5));
        for r in [0.5, 2.0, 4.0, 7.0, 9.5] {
            let PointLight { light, sensitivity, by_within, .. } = discs.point(r);
            let by = (more.light(r) - light) / 1e-7;
            assert!((by_within - by).abs() < 0.02 * by.abs(), "{r}: {by_within} for {by}");
            let [by_pupil, by_blur] = discs.by_radii(r);
            // Both radii and the distance grow by the same factor.
            let larger = with(&|d| (d.pupil_px, d.q_px) = (d.pupil_px * 1.001, d.q_px * 1.001));
            let by = (larger.light(r) * 1.001_f64.powi(2) - light) / 1e-3;
            let found = by_pupil * discs.pupil_px + by_blur * discs.q_px.abs();
            assert!((found - by).abs() < 5e-3, "{r}: {found} for {by}");

            let (mut sum, mut count) = (0.0, 0.0);
            let law = discs.law;
            for i in 0..300_000 {
                let radius = ((f64::from(i) + 0.5) / 300_000.0).sqrt();
                let (sin, cos) = (f64::from(i) * 2.399_963_229_728_653).sin_cos();
                let w = Vector2::new(cos, sin) * radius;
                count += 1.0;
                if (Vector2::new(r, 0.0) - w * discs.q_px).norm() < discs.pupil_px {
                    let s = Vector2::new(r, 0.0) + w * discs.opening_px;
                    let fall =
                        (law.light(s.norm_squared()) - law.light(s.norm_squared() + 1e-3)) / 1e-3;
                    sum += s.x * fall * 2.0 / law.within_per_px2;
                }
            }
            let expected = sum / count;
            assert!(
                (sensitivity - expected).abs() < 0.01 * expected.abs().max(2.0),
                "{r}: {sensitivity} for {expected}"
            );
        }
    }

    /// Checks that a vector field of constant slope points away from the middle in every pixel.
    #[test]
    fn vectors_keep_their_direction() {
        let pixels = RadialPixels::new(0.25, 6.0);
        let [seen] = pixels.see_outwards(|t| [t]);
        for r in [0.5, 1.7, 4.2] {
            let (value, slope) = seen.with_slope(r);
            assert!((value - r).abs() < 1e-4 && (slope - 1.0).abs() < 1e-3, "{r}: {value} {slope}");
        }
    }
}
