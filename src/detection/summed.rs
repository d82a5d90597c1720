//! The light of a corner, summed over many points of the micro-lens.
//!
//! The fit of a corner stands for what a pixel sees by few points of the visible part of the micro-lens, and for the step
//! of an edge by a cubic. That is right to a few hundredths of a pixel of a place, but not to a thousandth of a blur radius.
//! Here each of more points w of the whole micro-lens stands for a cell of it. Over that cell, and over the light that a
//! pixel at p collects (its square and the point spread), two places vary together: y = p − qᵢ w in the pupil, and the origin
//! o = p − ρ w on the board. Both are taken to be normally distributed. Light arrives where |y| < a, so
//! - with the variance σ² of y along an axis and z = (a − |ȳ|)/σ − σ/2a, since the rim is bent, its part is Φ(z);
//! - given that, y has the mean, variance and third moments of a normal distribution that the rim cuts off ([`Rim`]), and the
//!   origin follows it by cov(o, y)/σ²;
//! - the mean of the two steps of a corner is that of normal edges, with the terms of Edgeworth's series for third moments, for
//!   the fourth ones of the pixel, which has ends, and for edges that are not perpendicular, without their third order.

// Only what is inlined into a dispatched function is compiled for its registers.
#![allow(clippy::inline_always)]

use std::sync::LazyLock;

use nalgebra::Vector2;
use pulp::{Arch, Simd, WithSimd};

use super::blur::Blur;
use super::corner::Corner;
use super::cut_normal::{Rim, Step};
use super::patch::Patch;
use super::simd::sum;
use crate::vignetting::cells_of_disc;

/// Numbers of points of the micro-lens in rings, from the middle.
const RINGS: [usize; 5] = [1, 6, 12, 18, 24];
const POINTS: usize = 61;
/// Room for them that fills registers.
const ROOM: usize = POINTS.next_multiple_of(8);

/// Edges that are so many standard deviations beyond the blur of a pixel do not show in it.
const FAR: f32 = 3.0;

/// The points in single precision, as the light.
struct Lens {
    x: [f32; ROOM],
    y: [f32; ROOM],
    /// 1 for a point, 0 in the room behind them.
    is_one: [f32; ROOM],
    /// Variance of a cell along an axis.
    cell: f32,
}

#[allow(clippy::cast_possible_truncation)] // single precision, as the light
static LENS: LazyLock<Lens> = LazyLock::new(|| {
    let points = cells_of_disc::<POINTS>(&RINGS);
    let of = |of: &dyn Fn(&Vector2<f64>) -> f64| {
        std::array::from_fn(|j| points.get(j).map_or(0.0, |point| of(point) as f32))
    };
    // That of the disc along an axis is a quarter.
    let square = points.iter().map(Vector2::norm_squared).sum::<f64>() / 2.0 / POINTS as f64;
    Lens { x: of(&|w| w.x), y: of(&|w| w.y), is_one: of(&|_| 1.0), cell: (0.25 - square) as f32 }
});

/// The two steps of a corner, each from −1 to 1, as a pixel sees their product.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct SummedShape {
    /// The mean over the light of the pixel; not a number where it should have no light.
    pub shape: f32,
    /// Its derivative by the place of the corner (x, y), px⁻¹.
    pub by_place: [f32; 2],
    /// By the blur radius, px⁻¹.
    pub by_radius: f32,
    /// By the variance of edges, px⁻².
    pub by_width: f32,
}

impl SummedShape {
    /// The mean over points of the lens, from their light, and that times their shapes.
    #[inline(always)]
    fn mean<S: Simd>(simd: S, light: &[f32; ROOM], shapes: &[[f32; ROOM]; 5]) -> Self {
        let per_light = sum(simd, light).recip();
        Self {
            shape: sum(simd, &shapes[0]) * per_light,
            by_place: [sum(simd, &shapes[1]) * per_light, sum(simd, &shapes[2]) * per_light],
            by_radius: sum(simd, &shapes[3]) * per_light,
            by_width: sum(simd, &shapes[4]) * per_light,
        }
    }
}

/// How the pixels of a patch see a corner. Derivatives leave out third and fourth moments, and how the light of a pixel
/// changes.
pub(super) fn summed(blur: &Blur, corner: &Corner, patch: &Patch) -> Vec<SummedShape> {
    let mut shapes = vec![SummedShape::default(); patch.x.len()];
    Arch::new().dispatch(Sum { blur, corner, patch, shapes: &mut shapes });
    shapes
}

/// By how much the main lens bends the rays of a pixel at (x, y), px.
#[inline(always)]
#[allow(clippy::cast_possible_truncation)] // single precision, as the light
fn bent(blur: &Blur, lens: &Lens, [x, y]: [f32; 2]) -> [[f32; ROOM]; 2] {
    let (mut bent_x, mut bent_y) = ([0.0; ROOM], [0.0; ROOM]);
    if blur.bend.bends() {
        let (bend, q) = (blur.bend.in_single(), blur.q as f32);
        let bent = bent_x.iter_mut().zip(&mut bent_y);
        for ((bent_x, bent_y), (w_x, w_y)) in bent.zip(lens.x.iter().zip(&lens.y)) {
            let by = bend.at(&Vector2::new(x - q * w_x, y - q * w_y));
            (*bent_x, *bent_y) = (by.x, by.y);
        }
    }
    [bent_x, bent_y]
}

struct Sum<'a> {
    blur: &'a Blur<'a>,
    corner: &'a Corner,
    patch: &'a Patch,
    shapes: &'a mut [SummedShape],
}

impl WithSimd for Sum<'_> {
    type Output = ();

    #[inline(always)]
    #[allow(clippy::cast_possible_truncation)] // single precision, as the light
    fn with_simd<S: Simd>(self, simd: S) {
        let Self { blur, corner, patch, shapes } = self;
        let lens = &*LENS;
        let [rho, q] = [blur.rho as f32, blur.q as f32];
        let pixel = blur.vignetting.pixel_variance();
        let seen = pixel + q * q * lens.cell;
        let origin = pixel + blur.wider_px2 + rho * rho * lens.cell;
        let rim = Rim::new(blur.pupil as f32, seen);
        // By standard deviations of the place in the pupil.
        let follows = (pixel + rho * q * lens.cell) * rim.per_spread;
        let (squared, cubed) = (follows * follows, follows * follows * follows);
        let follows_by_radius = q * lens.cell * rim.per_spread;
        let squared_by_radius = 2.0 * follows * follows_by_radius;
        let origin_by_radius = 2.0 * rho * lens.cell;
        let (place_x, place_y) = (corner.place.x as f32, corner.place.y as f32);
        let [(s1, c1), (s2, c2)] = [unit(corner.angles[0]), unit(corner.angles[1])];
        let cosine = c1 * c2 + s1 * s2;
        let fourths = of_pixel([s1, c1], [s2, c2]);
        let falling = blur.obliquity.in_single();
        let reach = rho.abs() + FAR * (origin.sqrt() + follows.abs());
        let lit2 = (blur.pupil * blur.pupil) as f32;
        for ((&x, &y), shape) in patch.x.iter().zip(&patch.y).zip(shapes) {
            let [bent_x, bent_y] = bent(blur, lens, [x, y]);
            let (from_x, from_y) = (x - place_x, y - place_y);
            let [d1, d2] = [c1 * from_y - s1 * from_x, c2 * from_y - s2 * from_x];
            let sees_none = d1.abs().min(d2.abs()) > reach + furthest(&bent_x, &bent_y);
            if sees_none && x * x + y * y < lit2 {
                *shape = SummedShape { shape: d1.signum() * d2.signum(), ..Default::default() };
                continue;
            }
            let mut all = [0.0_f32; ROOM];
            let mut sums = [[0.0_f32; ROOM]; 5];
            for j in 0..ROOM {
                let (w_x, w_y) = (lens.x[j], lens.y[j]);
                let (light, by_x, by_y) = falling.light((x, y), (w_x, w_y));
                // More light comes from the brighter side of the pixel and of the cell.
                let (x, y) = (x + pixel * by_x, y + pixel * by_y);
                let in_cell = lens.cell * falling.half_pitch;
                let (w_x, w_y) = (w_x + in_cell * by_x, w_y + in_cell * by_y);
                let (seen_x, seen_y) = (x - q * w_x, y - q * w_y);
                let square = seen_x * seen_x + seen_y * seen_y;
                let inverse = square.max(1e-6).sqrt().recip();
                let (out_x, out_y) = (seen_x * inverse, seen_y * inverse);
                let cut = rim.cut(square);
                let (inwards, origin) = (follows * cut.mean, origin - squared * cut.sideways);
                let narrower = squared * cut.narrower;
                let o_x = x - rho * w_x - inwards * out_x + bent_x[j] - place_x;
                let o_y = y - rho * w_y - inwards * out_y + bent_y[j] - place_y;
                let (n1, n2) = (c1 * out_y - s1 * out_x, c2 * out_y - s2 * out_x);
                let (t1, t2) = (c1 * out_x + s1 * out_y, c2 * out_x + s2 * out_y);
                let a = Step::new(c1 * o_y - s1 * o_x, origin - narrower * n1 * n1);
                let b = Step::new(c2 * o_y - s2 * o_x, origin - narrower * n2 * n2);
                let both = origin * cosine - narrower * n1 * n2;
                let thirds = cut.thirds([n1, t1], [n2, t2]);
                let value = mean_of_product([&a, &b], both, cubed, thirds, fourths);
                let light = lens.is_one[j] * light * cut.visible;
                let [by_1, by_2, by_11, by_22, by_12] = derivatives([&a, &b], both);
                let moved = follows_by_radius * cut.mean;
                let (moved_x, moved_y) = (w_x + moved * out_x, w_y + moved * out_y);
                let wider = origin_by_radius - squared_by_radius * cut.sideways;
                let narrower = squared_by_radius * cut.narrower;
                let by_radius = by_1 * (s1 * moved_x - c1 * moved_y)
                    + by_2 * (s2 * moved_x - c2 * moved_y)
                    + by_11 * (wider - narrower * n1 * n1)
                    + by_22 * (wider - narrower * n2 * n2)
                    + by_12 * (wider * cosine - narrower * n1 * n2);
                let by_width = by_11 + by_22 + by_12 * cosine;
                all[j] = light;
                sums[0][j] = light * value;
                sums[1][j] = light * (by_1 * s1 + by_2 * s2);
                sums[2][j] = -light * (by_1 * c1 + by_2 * c2);
                sums[3][j] = light * by_radius;
                sums[4][j] = light * by_width;
            }
            *shape = SummedShape::mean(simd, &all, &sums);
        }
    }
}

/// The largest distance of some places from the origin.
#[inline(always)]
fn furthest(x: &[f32; ROOM], y: &[f32; ROOM]) -> f32 {
    let mut most = 0.0_f32;
    for j in 0..ROOM {
        most = most.max(x[j] * x[j] + y[j] * y[j]);
    }
    most.sqrt()
}

/// The mean of the product of two steps whose edges vary together, by the covariance of their distances, the third cumulants,
/// which are `cubed` times their numbers, and the fourth ones.
#[inline(always)]
fn mean_of_product(
    [a, b]: [&Step; 2],
    both: f32,
    cubed: f32,
    [third_1, third_2, mixed_1, mixed_2]: [f32; 4],
    [fourth_1, fourth_31, fourth_22, fourth_13, fourth_2]: [f32; 5],
) -> f32 {
    a.of_cumulants(cubed * third_1, fourth_1) * b.of_cumulants(cubed * third_2, fourth_2)
        + both * a.first * b.first
        + 0.5 * both * both * a.second * b.second
        + 0.5 * cubed * (mixed_1 * a.second * b.first + mixed_2 * a.first * b.second)
        + (fourth_31 * a.third * b.first + fourth_13 * a.first * b.third) / 6.0
        + 0.25 * fourth_22 * a.second * b.second
}

/// How that changes with the distance from either step, with their variances and with their covariance, without third and fourth
/// moments.
#[inline(always)]
fn derivatives([a, b]: [&Step; 2], both: f32) -> [f32; 5] {
    [
        a.first * b.value + both * a.second * b.first,
        a.value * b.first + both * a.first * b.second,
        0.5 * (a.second * b.value + both * a.third * b.first),
        0.5 * (a.value * b.second + both * a.first * b.third),
        a.first * b.first + both * a.second * b.second,
    ]
}

/// The fourth cumulants of places in a pixel across two edges, px⁴: of the first four, three, two, one and no times. Along
/// either axis it is −1/120, and the axes are independent.
#[inline(always)]
fn of_pixel([s1, c1]: [f32; 2], [s2, c2]: [f32; 2]) -> [f32; 5] {
    let of = |first: i32, second: i32| {
        -(s1.powi(first) * s2.powi(second) + c1.powi(first) * c2.powi(second)) / 120.0
    };
    [of(4, 0), of(3, 1), of(2, 2), of(1, 3), of(0, 4)]
}

/// Sine and cosine in single precision.
#[inline(always)]
#[allow(clippy::cast_possible_truncation)]
fn unit(angle: f64) -> (f32, f32) {
    let (sin, cos) = angle.sin_cos();
    (sin as f32, cos as f32)
}

#[cfg(test)]
mod tests {
    use nalgebra::Matrix2;

    use super::super::corner::{FitRoom, Free};
    use super::super::corner_sensitivity::sensitivities;
    use super::super::edge_width::EdgeWidth;
    use super::super::exact_light::{DIRECTIONS, ExactLight};
    use super::*;

    /// By how much corners of exact light seem further outwards, px; ln |ρ|, its change where edges are known not to be
    /// wider, and the variance by which they seem wider, px². They are fitted with a blur radius that is larger by the part
    /// `off`.
    fn errors_with(light: &ExactLight, distance: f64, off: f64) -> [f64; 4] {
        let vignetting = light.vignetting();
        let taken = ExactLight { rho: light.rho * (1.0 + off), ..*light };
        let blur = taken.blur(&vignetting);
        let (mut information, mut right) = (Matrix2::zeros(), Vector2::zeros());
        let mut outwards = 0.0;
        for (corner, patch) in light.corners(distance) {
            let rays = blur.rays(&patch);
            let found = corner.fitted(&patch, &rays, Free::Place, &mut FitRoom::default()).unwrap();
            let summed = summed(&blur, &found, &patch);
            let (_, inverse) = sensitivities(&found, &patch, &rays, 0.5, &blur.bend).unwrap();
            let all = (&inverse, 1.0);
            let (width, off) =
                EdgeWidth::of(&found, &patch, &rays, &summed, taken.rho, all).unwrap();
            let (own, own_right) = width.equations();
            information += own;
            right += own_right;
            let place = found.place + off - corner.place;
            outwards += place.dot(&corner.place) / distance / DIRECTIONS as f64;
        }
        let both = information.try_inverse().unwrap() * right;
        [outwards, both.x, right.x / information[(0, 0)], both.y]
    }

    fn errors(light: &ExactLight, distance: f64) -> [f64; 4] {
        errors_with(light, distance, 0.0)
    }

    #[test]
    fn exact_light_has_the_blur_and_the_place_that_it_has() {
        for (rho, q, pupil, of_pixels_per_px2) in [
            (-3.4, -4.19, 20.0, 0.0),
            (-4.2, -5.1, 6.48, 0.0),
            (3.0, 4.0, 6.5, 0.0),
            (4.2, 5.1, 20.0, 1.5e-3),
        ] {
            for distance in [1.0, 3.0, 5.0] {
                let light = ExactLight {
                    rho,
                    q,
                    pupil,
                    of_pixels_per_px2,
                    of_pixel: 8,
                    ..ExactLight::default()
                };
                let [outwards, free, known, wider] = errors(&light, distance);
                assert!(outwards.abs() < 0.001, "{outwards} px at {distance} for {rho}");
                assert!(free.abs() < 0.001, "{free} at {distance} for {rho}");
                assert!(known.abs() < 0.001, "{known} at {distance} for {rho}");
                // Eight places along a pixel have 0.001 px² less than a pixel.
                assert!(wider.abs() < 0.005, "{wider} px² at {distance} for {rho}");
            }
        }
    }

    #[test]
    fn light_with_a_wide_point_spread_too() {
        let wide = |rho, q, pupil| ExactLight {
            rho,
            q,
            pupil,
            point_spread_px2: 1.0,
            of_pixel: 17,
            rings: 8,
            ..ExactLight::default()
        };
        for (rho, q, pupil) in [(-3.4, -4.19, 20.0), (-4.2, -5.1, 6.48), (2.0, 1.5, 9.0)] {
            for distance in [1.0, 5.0] {
                let [outwards, _, known, _] = errors(&wide(rho, q, pupil), distance);
                assert!(outwards.abs() < 0.015, "{outwards} px at {distance} for {rho}");
                assert!(known.abs() < 0.007, "{known} at {distance} for {rho}");
            }
        }
    }

    /// The derivatives are those of the light: a blur radius that is a tenth off is found in one step.
    #[test]
    fn a_wrong_blur_radius_is_set_right() {
        for point_spread_px2 in [0.0, 1.0] {
            for (rho, q, pupil) in [(2.0, 4.1, 6.57), (-2.6, -3.9, 6.57)] {
                let light = ExactLight { rho, q, pupil, point_spread_px2, ..ExactLight::default() };
                let light = ExactLight { of_pixel: 17, rings: 8, ..light };
                for (distance, off) in [(1.0, 0.1), (5.0, -0.1)] {
                    let [_, free, known, _] = errors_with(&light, distance, off);
                    let expected = -f64::ln(1.0 + off);
                    for found in [free, known] {
                        assert!(
                            (found - expected).abs() < 0.016,
                            "{found} for {expected} at {rho}"
                        );
                    }
                }
            }
        }
    }
}
