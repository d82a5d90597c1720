//! The checkerboard that the camera looks at, and its true surface.

use nalgebra::{Point3, Vector2, Vector3};
use serde::{Deserialize, Serialize};

use crate::error::{Error, Result};
use crate::model::{Board, positive};

/// A printed checkerboard: squares around its inner corners, a border, and the background. The square
/// diagonally before corner 0 is black. Radiances are relative to a white target.
///
/// With ξ = (x − h_x)/h_x and η = (y − h_y)/h_y, where h is half the extent of the inner corners and x and y
/// count from corner 0 in the board frame, the true surface is z = `sag_mm`\[0\] ξ² + `sag_mm`\[1\] η² +
/// `twist_mm` ξη; z points away from the camera.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Target {
    /// Number of inner corners along a row.
    pub columns: i32,
    /// Number of inner corners along a column.
    pub rows: i32,
    /// Side of a square, mm.
    pub square_mm: f64,
    /// Width of the white border around the squares, mm.
    pub border_mm: f64,
    /// Radiance of white squares and border.
    pub white: f64,
    /// Radiance of black squares.
    pub black: f64,
    /// Radiance of everything beyond the border.
    pub background: f64,
    /// Sag, mm: distance by which the ends of the middle row, and of the middle column, are further away than the middle of the
    /// board.
    #[serde(default)]
    pub sag_mm: [f64; 2],
    /// Twist, mm: distance by which it moves the first and the last corner away from the camera. The other two outer corners
    /// come nearer by it.
    #[serde(default)]
    pub twist_mm: f64,
    /// Spacing of the corners along the rows over the spacing along the columns, minus 1. x grows by half of it, y
    /// shrinks by half of it.
    #[serde(default)]
    pub aspect: f64,
    /// Gradient g of the illumination along rows and columns: relative excess at their ends over the middle. The radiance of
    /// the print is multiplied by 1 + g·(ξ, η), or by a twentieth if that is larger.
    #[serde(default)]
    pub uneven_light: [f64; 2],
}

/// Largest relative difference of both spacings. A print is off by much less.
const MAX_ASPECT: f64 = 0.2;
/// Points along each side of a bent sheet, of which the nearest one is searched for.
const GRID: i32 = 17;

impl Target {
    /// Returns the board by its inner corners, flat and exact, as a user states it.
    #[must_use]
    pub fn board(&self) -> Board {
        Board { columns: self.columns, rows: self.rows, square_mm: self.square_mm }
    }

    /// Returns true if the corners are where [`Target::board`] has them.
    #[must_use]
    pub fn is_flat_and_exact(&self) -> bool {
        self.surface().is_none() && self.aspect == 0.0
    }

    /// Returns the true position of a corner in the board frame, mm.
    #[must_use]
    pub fn corner_mm(&self, corner: i32) -> Point3<f64> {
        let place = self.board().point_mm(corner).coords.xy().component_mul(&self.stretch());
        self.on_surface(place)
    }

    /// Returns the factors by which x and y are stretched.
    pub(super) fn stretch(&self) -> Vector2<f64> {
        Vector2::new(1.0 + self.aspect / 2.0, 1.0 - self.aspect / 2.0)
    }

    /// Returns the surface; `None` if it is flat.
    pub(super) fn surface(&self) -> Option<Surface> {
        let surface =
            Surface { half: self.half_mm(), sag: self.sag_mm.into(), twist: self.twist_mm };
        (surface.sag != Vector2::zeros() || surface.twist != 0.0).then_some(surface)
    }

    /// Returns points of the sheet in the board frame, mm, which include the outermost: its corners and, if it is
    /// bent, a grid over all of it.
    pub(super) fn sheet_mm(&self) -> Vec<Point3<f64>> {
        let low = Vector2::repeat(-self.square_mm - self.border_mm).component_mul(&self.stretch());
        let size = Vector2::new(f64::from(self.columns), f64::from(self.rows));
        let high =
            (size * self.square_mm).add_scalar(self.border_mm).component_mul(&self.stretch());
        let last = if self.surface().is_some() { GRID - 1 } else { 1 };
        let at = |part: [i32; 2]| {
            let part = Vector2::from(part.map(|i| f64::from(i) / f64::from(last)));
            low.component_mul(&part.map(|p| 1.0 - p)) + high.component_mul(&part)
        };
        let places = (0..=last).flat_map(|j| (0..=last).map(move |i| at([i, j])));
        places.map(|place| self.on_surface(place)).collect()
    }

    fn on_surface(&self, place: Vector2<f64>) -> Point3<f64> {
        let z = self.surface().map_or(0.0, |surface| surface.height(&place));
        Point3::from(place.push(z))
    }

    /// Returns half the extent of the inner corners along x and y, mm.
    fn half_mm(&self) -> Vector2<f64> {
        Vector2::new(f64::from(self.columns - 1), f64::from(self.rows - 1)) * (self.square_mm / 2.0)
    }

    pub(super) fn validate(&self) -> Result<()> {
        self.board().validate()?;
        if !self.border_mm.is_finite() || self.border_mm < 0.0 {
            return Err(Error::invalid(format!(
                "the border of the target is {} mm wide: give 0 or more",
                self.border_mm
            )));
        }
        positive(self.white, "the radiance of the target's white")?;
        for (name, radiance) in [("black", self.black), ("background", self.background)] {
            if !(0.0..f64::INFINITY).contains(&radiance) {
                return Err(Error::invalid(format!(
                    "the radiance of the target's {name} is {radiance}: give 0 or more"
                )));
            }
        }
        if self.black >= self.white {
            return Err(Error::invalid(format!(
                "the target's black ({}) is not darker than its white ({})",
                self.black, self.white
            )));
        }
        self.validate_shape()
    }

    fn validate_shape(&self) -> Result<()> {
        let [along_x, along_y] = self.sag_mm;
        let most = self.half_mm().min();
        for (name, bend) in
            [("sag along x", along_x), ("sag along y", along_y), ("twist", self.twist_mm)]
        {
            if bend.is_nan() || bend.abs() > most {
                return Err(Error::invalid(format!(
                    "a {name} of the target of {bend} mm is not possible: give at most ±{most} mm, \
                     half the extent of its corners"
                )));
            }
        }
        if self.aspect.is_nan() || self.aspect.abs() > MAX_ASPECT {
            return Err(Error::invalid(format!(
                "an aspect of the target of {} is not possible: give -{MAX_ASPECT} to \
                 {MAX_ASPECT}, the ratio of its spacings minus 1",
                self.aspect
            )));
        }
        if let Some(light) = self.uneven_light.iter().find(|g| !(-1.0..=1.0).contains(*g)) {
            return Err(Error::invalid(format!(
                "uneven light of {light} on the target is not possible: give -1 to 1, the fraction \
                 by which its ends are brighter than its middle"
            )));
        }
        Ok(())
    }
}

/// Surface of a bent board, in the board frame, mm.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Surface {
    half: Vector2<f64>,
    sag: Vector2<f64>,
    twist: f64,
}

impl Surface {
    /// Returns z at a position.
    pub fn height(&self, place: &Vector2<f64>) -> f64 {
        let at = place.component_div(&self.half).add_scalar(-1.0);
        self.along(&at, &at)
    }

    /// Returns dz/dx and dz/dy at a position.
    pub fn slope(&self, place: &Vector2<f64>) -> Vector2<f64> {
        let at = place.component_div(&self.half).add_scalar(-1.0);
        let slope = self.sag.component_mul(&at) * 2.0 + Vector2::new(at.y, at.x) * self.twist;
        slope.component_div(&self.half)
    }

    /// Returns the point where a line through `place` in the plane z = 0, with the slopes dx/dz and dy/dz, meets the surface:
    /// the intersection next to the plane. `None` if the line misses the surface.
    ///
    /// Along the line the height of the surface is h₀ + h₁z + h₂z², and the point is the root of
    /// h₂z² − (1 − h₁)z + h₀ that goes to 0 with h₀.
    pub fn meet(&self, place: &Vector2<f64>, slope: &Vector2<f64>) -> Option<Vector3<f64>> {
        let at = place.component_div(&self.half).add_scalar(-1.0);
        let step = slope.component_div(&self.half);
        let (h0, h1, h2) =
            (self.along(&at, &at), 2.0 * self.along(&at, &step), self.along(&step, &step));
        let linear = 1.0 - h1;
        let square = linear * linear - 4.0 * h2 * h0;
        if square.is_nan() || square < 0.0 {
            return None;
        }
        let z = 2.0 * h0 / (linear + square.sqrt().copysign(linear));
        Some((place + slope * z).push(z))
    }

    /// Returns the symmetric bilinear form of the surface. Its value for (ξ, η) twice is z.
    fn along(&self, a: &Vector2<f64>, b: &Vector2<f64>) -> f64 {
        self.sag.x * a.x * b.x + self.sag.y * a.y * b.y + self.twist * (a.x * b.y + a.y * b.x) / 2.0
    }
}

#[cfg(test)]
pub(super) mod tests {
    use nalgebra::Point2;

    use super::*;

    /// Returns a target of five by three corners that is bent, stretched and unevenly lit.
    pub fn target() -> Target {
        Target {
            columns: 5,
            rows: 3,
            square_mm: 10.0,
            border_mm: 4.0,
            white: 0.9,
            black: 0.05,
            background: 0.3,
            sag_mm: [0.8, -0.5],
            twist_mm: 0.3,
            aspect: 0.002,
            uneven_light: [0.5, -1.0],
        }
    }

    /// h = (20, 10) mm. With the aspect the last corner is at (40.04, 19.98).
    #[test]
    fn corners_lie_on_the_surface_and_further_apart_along_x() {
        let target = target();
        let exact = Target { aspect: 0.0, ..target };
        let close = |corner: i32, x: f64, y: f64, z: f64| {
            let found = exact.corner_mm(corner);
            assert!((found - Point3::new(x, y, z)).norm() < 1e-12, "{found}");
        };
        close(14, 40.0, 20.0, 0.8 - 0.5 + 0.3);
        close(4, 40.0, 0.0, 0.8 - 0.5 - 0.3);
        close(7, 20.0, 10.0, 0.0);
        close(5, 0.0, 10.0, 0.8);
        let last = target.corner_mm(14);
        assert!((last.xy() - Point2::new(40.04, 19.98)).norm() < 1e-12, "{last}");
        let (xi, eta) = (1.002, 0.998);
        let height = 0.8 * xi * xi - 0.5 * eta * eta + 0.3 * xi * eta;
        assert!((last.z - height).abs() < 1e-12, "{last}");
        // Spacing along the rows over the spacing along the columns.
        let along = |a: i32, b: i32| (target.corner_mm(b) - target.corner_mm(a)).xy().norm();
        assert!((along(0, 1) / along(0, 5) - 1.002).abs() < 1e-5);
        assert!(!target.is_flat_and_exact() && !exact.is_flat_and_exact());
        let flat = Target { sag_mm: [0.0; 2], twist_mm: 0.0, ..exact };
        assert!(flat.is_flat_and_exact());
        assert_eq!(flat.corner_mm(14), flat.board().point_mm(14));
    }

    #[test]
    fn lines_meet_the_surface() {
        let surface = target().surface().unwrap();
        for slope in [(0.0, 0.0), (0.7, -0.4), (-2.0, 1.0)].map(|(x, y)| Vector2::new(x, y)) {
            for place in [(0.0, 0.0), (20.0, 10.0), (47.0, -9.0)].map(|(x, y)| Vector2::new(x, y)) {
                let hit = surface.meet(&place, &slope).unwrap();
                assert!((surface.height(&hit.xy()) - hit.z).abs() < 1e-12, "{hit}");
                assert!((place + slope * hit.z - hit.xy()).norm() < 1e-12, "{hit}");
                assert!(hit.z.abs() < 5.0, "{hit} is the nearest");
            }
        }
        // Far beyond the sheet, the surface falls away faster than the line.
        assert_eq!(surface.meet(&Vector2::new(20.0, 300.0), &Vector2::new(0.0, -1.0)), None);
    }

    #[test]
    fn slopes_are_derivatives_of_the_height() {
        let (surface, place, step) = (target().surface().unwrap(), Vector2::new(7.0, 17.0), 1e-4);
        let along = |axis: Vector2<f64>| {
            (surface.height(&(place + axis * step)) - surface.height(&(place - axis * step)))
                / (2.0 * step)
        };
        let expected = Vector2::new(along(Vector2::x()), along(Vector2::y()));
        assert!((surface.slope(&place) - expected).norm() < 1e-9);
    }

    /// The sheet ends 14 mm beyond the corners, at ξ = ±1.7.
    #[test]
    fn a_bent_sheet_is_nearest_where_it_bends_to() {
        let nearest = |sag: f64| {
            let bent = Target { sag_mm: [sag, 0.0], twist_mm: 0.0, aspect: 0.0, ..target() };
            bent.sheet_mm().into_iter().map(|p| p.z).fold(f64::MAX, f64::min)
        };
        assert!(nearest(0.8).abs() < 1e-12);
        assert!((nearest(-1.0) + 1.7 * 1.7).abs() < 1e-12, "{}", nearest(-1.0));
    }
}
