//! How the place of a corner depends on what its fit takes for granted: the slope of its line, from which the
//! blur follows, and the aberrations of the main lens.
//!
//! A fit has ∂cost/∂place = 0. If the light of the model is moved, the place follows as by one more step of
//! Gauss and Newton: all pixels along both edges have their say, each with the rays that it receives.

// Only what is inlined into a dispatched function is compiled for its registers.
#![allow(clippy::inline_always)]

use nalgebra::{Matrix2x3, Matrix4, SMatrix, Vector2};
use pulp::{Arch, Simd, WithSimd};

use super::aberration::Bend;
use super::corner::{Corner, Edges};
use super::lanes::{Lanes, products};
use super::micro_images::OTHERWISE;
use super::patch::Patch;
use super::rays::{OfRays, RayLanes, Rays};
use crate::model::TAKEN;

/// Derivatives of a place by what is taken from white images, px: see [`crate::model::TAKEN_FROM_WHITES`].
pub(super) type ByTaken = SMatrix<f64, 2, TAKEN>;

/// Derivatives of the straightened place of a corner.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Levers {
    /// By the slope, px.
    pub by_slope: Vector2<f64>,
    /// By S, C and T, px³.
    pub by_aberration: Matrix2x3<f64>,
    /// By what is taken from white images; 0 where it was not asked for.
    pub by_taken: ByTaken,
}

/// By how much what is taken from white images is changed, by its index: the part [`OTHERWISE`] of it, and the variance of the
/// point spread, which may be 0, by px².
pub(super) const STEPS: [f64; TAKEN] = [OTHERWISE, OTHERWISE, OTHERWISE, OTHERWISE, 0.02];

/// What is taken for granted beside that: γ, S, C and T.
const GIVEN: usize = 4;
/// Columns: derivatives of the light by u and v, its shape, and by γ, S, C and T.
const COLUMNS: usize = 3 + GIVEN;

/// The unknowns of a fit: place (u, v), level and contrast.
pub(super) const UNKNOWNS: usize = 4;

impl Corner {
    /// The levers of a corner that was fitted, but for those by what is taken from white images, and the inverse of the normal
    /// matrix of its fit; `None` if the light does not determine its place.
    #[allow(clippy::cast_possible_truncation)] // single precision, as the light
    pub fn levers(
        &self,
        patch: &Patch,
        rays: &Rays,
        slope: f64,
        bend: &Bend,
    ) -> Option<(Levers, Matrix4<f64>)> {
        let pixels = patch.x.len();
        let mut room = vec![0.0; (COLUMNS + 2) * pixels];
        let sums = Sums {
            room: &mut room,
            patch,
            corner: self,
            rays,
            bend: bend.in_single(),
            nearness: (slope - 1.0) as f32,
        };
        let (normal, right) = Arch::new().dispatch(sums);
        let normal = Matrix4::from_fn(|a, b| f64::from(normal[a.max(b)][a.min(b)]));
        let inverse = normal.cholesky()?.inverse();
        let levers =
            inverse * SMatrix::<f64, UNKNOWNS, GIVEN>::from_fn(|a, b| f64::from(right[a][b]));
        let place = levers.fixed_rows::<2>(0);
        levers.iter().all(|x| x.is_finite()).then(|| {
            let levers = Levers {
                by_slope: place.column(0).into_owned(),
                by_aberration: place.fixed_columns::<3>(1).into_owned(),
                by_taken: ByTaken::zeros(),
            };
            (levers, inverse)
        })
    }

    /// The mean of the shapes that all rays show, pixel by pixel.
    pub fn shape(&self, rays: &Rays) -> Vec<f32> {
        let mut shape = vec![0.0; rays.len()];
        Arch::new().dispatch(MeanShape { corner: self, rays, shape: &mut shape });
        shape
    }
}

/// See [`Corner::shape`].
struct MeanShape<'a> {
    corner: &'a Corner,
    rays: &'a Rays,
    shape: &'a mut [f32],
}

impl WithSimd for MeanShape<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) {
        self.rays.means(simd, &Shape(Edges::of(simd, self.corner)), &mut [self.shape]);
    }
}

/// The product of both steps.
pub(super) struct Shape<S: Simd>(pub Edges<S>);

impl<S: Simd> OfRays<S, 1> for Shape<S> {
    #[inline(always)]
    fn of_rays(&self, rays: &RayLanes<S>) -> [Lanes<S>; 1] {
        [self.0.seen(rays).shape()]
    }
}

/// What a place depends on, in the order of [`COLUMNS`], but for what is the same for all pixels.
struct Terms<S: Simd> {
    edges: Edges<S>,
    /// Of the bend.
    field: [Lanes<S>; 2],
    zone2: Lanes<S>,
}

impl<S: Simd> OfRays<S, COLUMNS> for Terms<S> {
    #[inline(always)]
    fn of_rays(&self, rays: &RayLanes<S>) -> [Lanes<S>; COLUMNS] {
        let seen = self.edges.seen(rays);
        let ([u, v], [x, y]) = (self.edges.by_place(&seen), rays.pupil);
        // The origin is w + (γ − 1) (what the point of the micro-lens and E make of it).
        let by_slope = u.mul_add(rays.origin[0] - x, v * (rays.origin[1] - y));
        // See `Bend::terms`.
        let (square, along) = (x.mul_add(x, y * y), self.field[0].mul_add(x, self.field[1] * y));
        let outwards = u.mul_add(x, v * y);
        let of_field = u.mul_add(self.field[0], v * self.field[1]);
        let by_s = outwards * (square - self.zone2);
        let by_c = outwards.mul_add(along + along, of_field * square);
        [u, v, seen.shape(), by_slope, by_s, by_c, of_field * along]
    }
}

/// Normal equations of the unknowns, with the changes of the light by γ, S, C and T on their right.
struct Sums<'a> {
    /// Room for [`COLUMNS`] and two more rows.
    room: &'a mut [f32],
    patch: &'a Patch,
    corner: &'a Corner,
    rays: &'a Rays,
    bend: Bend<f32>,
    /// γ − 1.
    nearness: f32,
}

impl WithSimd for Sums<'_> {
    type Output = ([[f32; UNKNOWNS]; UNKNOWNS], [[f32; GIVEN]; UNKNOWNS]);

    #[inline(always)]
    #[allow(clippy::cast_possible_truncation)] // single precision, as the light
    fn with_simd<S: Simd>(self, simd: S) -> Self::Output {
        let Self { room, patch, corner, rays, bend, nearness } = self;
        let n = patch.x.len();
        let mut rows = room.chunks_exact_mut(n.max(1));
        let mut row = || rows.next().map_or(&mut [][..], |row| &mut row[..n]);
        let (ones, weighted) = (row(), row());
        let mut columns: [&mut [f32]; COLUMNS] = std::array::from_fn(|_| row());
        let terms = Terms {
            edges: Edges::of(simd, corner),
            field: [Lanes::splat(simd, bend.field.x), Lanes::splat(simd, bend.field.y)],
            zone2: Lanes::splat(simd, bend.zone2),
        };
        rays.means(simd, &terms, &mut columns);
        let h = corner.contrast as f32;
        let mut factors = [h * nearness; COLUMNS];
        factors[..4].copy_from_slice(&[h, h, 1.0, h / nearness]);
        for (column, factor) in columns.iter_mut().zip(factors) {
            for x in column.iter_mut() {
                *x *= factor;
            }
        }
        ones.fill(1.0);
        let [by_u, by_v, shape, given @ ..] = &columns;
        products(
            simd,
            [&**by_u, &**by_v, ones, &**shape],
            given.each_ref().map(|given| &**given),
            &patch.weight,
            weighted,
        )
    }
}

#[cfg(test)]
pub(super) mod tests {
    use nalgebra::Matrix2;

    use super::super::aberration::Aberration;
    use super::super::blur::Blur;
    use super::super::by_taken::OnEdges;
    use super::super::corner_fit::{FitRoom, Free};
    use super::super::patch::tests::micro_images;
    use super::*;

    pub const SLOPE: f64 = 0.75;

    pub fn corner(place: Vector2<f64>) -> Corner {
        Corner {
            place,
            angles: [0.2, 1.6],
            level: 0.5,
            contrast: 0.4,
            width: 1.0,
            covariance: Matrix2::zeros(),
            explained: 0.0,
        }
    }

    /// The pixels of a micro-image, without light.
    pub fn disc(radius: i16) -> Patch {
        let mut patch = Patch::default();
        let places = (-radius..=radius).flat_map(|y| (-radius..=radius).map(move |x| (x, y)));
        for (x, y) in places.map(|(x, y)| (f32::from(x), f32::from(y))) {
            if x * x + y * y < f32::from(radius).powi(2) {
                patch.x.push(x + 0.3);
                patch.y.push(y - 0.2);
                patch.light.push(0.0);
                patch.weight.push(1.0);
            }
        }
        patch
    }

    /// The light of a corner in a micro-image with these rays.
    #[allow(clippy::cast_possible_truncation)] // single precision, as the light
    fn light(patch: &mut Patch, corner: &Corner, rays: &Rays) {
        for (light, shape) in patch.light.iter_mut().zip(corner.shape(rays)) {
            *light = (corner.level + corner.contrast * f64::from(shape)) as f32;
        }
    }

    /// The place follows what is taken for granted, as fits with other values show.
    #[test]
    fn levers_are_the_changes_of_fits() {
        let micro_images = micro_images(23.0);
        let optics = micro_images.optics(1, 1);
        let vignetting = micro_images.vignetting(&optics);
        // Far off the middle of the image, where all three aberrations show.
        let center = Vector2::new(400.0, -300.0);
        let place = Vector2::new(4.0, -2.5);
        let rays = |slope: f64, coefficients: [f64; 3], patch: &Patch| {
            let none = Aberration::none(Vector2::zeros(), optics.pupil_px);
            let bend = none.changed(&coefficients.into()).bend(&center, slope);
            (Blur::new(&optics, slope, bend, vignetting).rays(patch), bend)
        };
        let mut patch = disc(10);
        let (known, bend) = rays(SLOPE, [0.0; 3], &patch);
        let truth = corner(place);
        light(&mut patch, &truth, &known);
        let (levers, inverse) = truth.levers(&patch, &known, SLOPE, &bend).unwrap();
        let place_with = |slope: f64, coefficients: [f64; 3]| {
            let (rays, _) = rays(slope, coefficients, &patch);
            truth.fitted(&patch, &rays, Free::Place, &mut FitRoom::default()).unwrap().place
        };
        assert!((place_with(SLOPE, [0.0; 3]) - place).norm() < 2e-3);
        let close = |change: Vector2<f64>, lever: Vector2<f64>, step: f64| {
            let expected = lever * step;
            assert!(
                (change - expected).norm() < 0.15 * expected.norm() + 3e-3,
                "{change} {expected}"
            );
        };
        let by_slope = place_with(SLOPE + 0.01, [0.0; 3]) - place_with(SLOPE - 0.01, [0.0; 3]);
        close(by_slope, levers.by_slope, 0.02);
        for i in 0..3 {
            let lever = levers.by_aberration.column(i).into_owned();
            // That moves the place by a fiftieth of a pixel.
            let step = 0.02 / lever.norm();
            let with = |sign: f64| {
                let mut coefficients = [0.0; 3];
                coefficients[i] = sign * step;
                place_with(SLOPE, coefficients)
            };
            close(with(1.0) - with(-1.0), lever, 2.0 * step);
        }
        let others = |patch: &Patch| -> [Rays; TAKEN] {
            std::array::from_fn(|taken| {
                let (optics, vignetting) = micro_images.otherwise(&optics, taken);
                Blur::new(&optics, SLOPE, bend, vignetting).rays(patch)
            })
        };
        let mut on_edges = OnEdges::default();
        on_edges.find(&truth, &patch, &known);
        let by_taken = on_edges.by_taken(&truth, &others(&on_edges.patch), &inverse, 1.0);
        for ((other, lever), step) in others(&patch).iter().zip(by_taken.column_iter()).zip(STEPS) {
            let moved =
                truth.fitted(&patch, other, Free::Place, &mut FitRoom::default()).unwrap().place
                    - place;
            close(moved, lever.into_owned(), step);
        }
        assert!(by_taken.column(0).norm() > 0.5, "{by_taken}");
    }
}
