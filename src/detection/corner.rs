//! A checkerboard corner in a micro-image.

// Only what is inlined into a dispatched function is compiled for its registers.
#![allow(clippy::inline_always)]

use nalgebra::{Matrix2, Matrix4, Vector2, Vector4};
use pulp::{Arch, Simd, WithSimd};

use super::lanes::{Lanes, products};
use super::patch::Patch;
use super::rays::{OfRays, RayLanes, Rays};

/// Two edges that cross: light m + h at directions between n₁ and n₂, m − h beside.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Corner {
    /// Offset from the centre of the micro-image, px.
    pub place: Vector2<f64>,
    /// Directions of the edges, rad.
    pub angles: [f64; 2],
    /// m.
    pub level: f64,
    /// h.
    pub contrast: f64,
    /// Half the width over which a step rises, over that of the rays.
    pub width: f64,
    /// Covariance of the place, px².
    pub covariance: Matrix2<f64>,
    /// Part of the variance of the light that it explains.
    pub explained: f64,
}

/// The two edges of a corner, in single precision as the light.
pub(super) struct Edges<S: Simd> {
    place: [Lanes<S>; 2],
    narrower: Lanes<S>,
    /// Sine and cosine of both directions.
    directions: [[Lanes<S>; 2]; 2],
    one: Lanes<S>,
    half: Lanes<S>,
}

/// What rays show of two edges.
pub(super) struct SeenEdges<S: Simd> {
    /// The place less that of the corner, in half widths of steps.
    from: [Lanes<S>; 2],
    /// One over that half width, px⁻¹.
    inverse: Lanes<S>,
    /// Distances from the edges, in half widths.
    distance: [Lanes<S>; 2],
    /// The steps there, and their slopes.
    pub steps: [Lanes<S>; 2],
    slopes: [Lanes<S>; 2],
}

impl<S: Simd> Edges<S> {
    #[inline(always)]
    #[allow(clippy::cast_possible_truncation)] // single precision, as the light
    pub fn of(simd: S, corner: &Corner) -> Self {
        let all = |x: f64| Lanes::splat(simd, x as f32);
        let [(s1, c1), (s2, c2)] = [corner.angles[0].sin_cos(), corner.angles[1].sin_cos()];
        Self {
            place: [all(corner.place.x), all(corner.place.y)],
            narrower: all(1.0 / corner.width),
            directions: [[all(s1), all(c1)], [all(s2), all(c2)]],
            one: all(1.0),
            half: all(0.5),
        }
    }

    #[inline(always)]
    pub fn seen(&self, rays: &RayLanes<S>) -> SeenEdges<S> {
        let inverse = rays.inverse_width * self.narrower;
        let x = (rays.origin[0] - self.place[0]) * inverse;
        let y = (rays.origin[1] - self.place[1]) * inverse;
        let [[s1, c1], [s2, c2]] = self.directions;
        let distance = [s1.mul_from(x, c1 * y), s2.mul_from(x, c2 * y)];
        let ([t1, e1], [t2, e2]) = (self.step(distance[0]), self.step(distance[1]));
        SeenEdges { from: [x, y], inverse, distance, steps: [t1, t2], slopes: [e1, e2] }
    }

    /// A step at a distance from it in its half widths, −1 to 1, and its slope: t (3 − t²)/2 and 3 (1 − t²)/2.
    #[inline(always)]
    fn step(&self, distance: Lanes<S>) -> [Lanes<S>; 2] {
        let t = distance.clamp(-self.one, self.one);
        let half_slope = (self.half * t).mul_from(t, self.half);
        [t * (half_slope + self.one), half_slope + half_slope + half_slope]
    }

    /// The distances along the edges, in half widths.
    #[inline(always)]
    fn along(&self, seen: &SeenEdges<S>) -> [Lanes<S>; 2] {
        let ([x, y], [[s1, c1], [s2, c2]]) = (seen.from, self.directions);
        [c1.mul_add(x, s1 * y), c2.mul_add(x, s2 * y)]
    }

    /// How the product of both steps changes with the place of the corner, px⁻¹.
    #[inline(always)]
    pub fn by_place(&self, seen: &SeenEdges<S>) -> [Lanes<S>; 2] {
        let [[s1, c1], [s2, c2]] = self.directions;
        let [g1, g2] = seen.by_distance();
        [g1.mul_add(s1, g2 * s2) * seen.inverse, -g1.mul_add(c1, g2 * c2) * seen.inverse]
    }

    /// How it changes with both directions and with the width of the steps, times that.
    #[inline(always)]
    pub fn by_form(&self, seen: &SeenEdges<S>) -> [Lanes<S>; 3] {
        let ([g1, g2], [along_1, along_2]) = (seen.by_distance(), self.along(seen));
        let [d1, d2] = seen.distance;
        [-(g1 * along_1), -(g2 * along_2), -g1.mul_add(d1, g2 * d2)]
    }
}

impl<S: Simd> SeenEdges<S> {
    /// The product of both steps.
    #[inline(always)]
    pub fn shape(&self) -> Lanes<S> {
        self.steps[0] * self.steps[1]
    }

    /// How it changes with the distances from the edges.
    #[inline(always)]
    fn by_distance(&self) -> [Lanes<S>; 2] {
        [self.slopes[0] * self.steps[1], self.steps[0] * self.slopes[1]]
    }
}

impl Corner {
    /// Positive along directions to bright squares, of a size that does not depend on the contrast.
    pub fn squares(&self) -> Matrix2<f64> {
        let [a, b] = self.angles.map(|angle| Vector2::new(-angle.sin(), angle.cos()));
        (a * b.transpose() + b * a.transpose()) * self.contrast.signum()
    }

    /// How far the four quarters are from two bright and two dark ones: the steps across single edges
    /// over that across both. 0 for a corner of a checkerboard, 1 where only one quarter is dark, as at
    /// the outer corners of the board; `None` if the light does not determine it.
    pub fn imbalance(&self, patch: &Patch, rays: &Rays) -> Option<f64> {
        let mut room = vec![0.0; 5 * patch.x.len()];
        let (normal, right) =
            Arch::new().dispatch(Quarters { corner: self, patch, rays, room: &mut room });
        let normal = Matrix4::from_fn(|a, b| normal[a.max(b)][a.min(b)]);
        let levels = normal.cholesky()?.solve(&Vector4::from(right.map(|[right]| right)));
        Some(f64::from(levels[1].abs().max(levels[2].abs()) / levels[3].abs()))
    }

    /// Standard deviation of the place per axis, px, the mean of both axes.
    pub fn std_dev_px(&self) -> f64 {
        (self.covariance.trace() / 2.0).max(0.0).sqrt()
    }

    /// Sine of the angle between the edges.
    pub fn opening(&self) -> f64 {
        (self.angles[0] - self.angles[1]).sin().abs()
    }
}

/// Normal equations of the mean light, the steps across either edge, and that across both.
struct Quarters<'a> {
    corner: &'a Corner,
    patch: &'a Patch,
    rays: &'a Rays,
    /// Room for five rows.
    room: &'a mut [f32],
}

impl WithSimd for Quarters<'_> {
    type Output = ([[f32; 4]; 4], [[f32; 1]; 4]);

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) -> Self::Output {
        let Self { corner, patch, rays, room } = self;
        let n = patch.x.len();
        let mut rows = room.chunks_exact_mut(n.max(1));
        let [ones, first, second, both, weighted] =
            std::array::from_fn(|_| rows.next().map_or(&mut [][..], |row| &mut row[..n]));
        ones.fill(1.0);
        rays.means(simd, &Steps(Edges::of(simd, corner)), &mut [first, second, both]);
        let rows = [&*ones, first, second, both];
        products(simd, rows, [&patch.light[..n]], &patch.weight, weighted)
    }
}

/// Both steps, and their product.
struct Steps<S: Simd>(Edges<S>);

impl<S: Simd> OfRays<S, 3> for Steps<S> {
    #[inline(always)]
    fn of_rays(&self, rays: &RayLanes<S>) -> [Lanes<S>; 3] {
        let seen = self.0.seen(rays);
        [seen.steps[0], seen.steps[1], seen.shape()]
    }
}
