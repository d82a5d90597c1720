//! Openings of the micro-lenses: discs, or the cells of the lattice if the lenslets leave no gaps.

use std::f64::consts::{FRAC_PI_2, PI};

use nalgebra::Vector2;
use serde::{Deserialize, Serialize};

use super::lattice::LatticeKind;
use crate::error::{Error, Result};

/// Shape of the opening (clear aperture) of a micro-lens. Its width between parallel sides is the diameter.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Opening {
    /// Disc.
    #[default]
    Disc,
    /// Hexagon with its sides towards the six neighbours: the cell of a hexagonal lattice.
    Hexagon,
    /// Square with its sides towards the four neighbours: the cell of an orthogonal lattice.
    Square,
}

/// Discs whose weighted sum is a shape averaged over all directions: radius and weight.
type Discs = &'static [(f64, f64)];

/// A side at the distance 1 from the middle has the distance 1/cos φ in the direction φ from its normal. So the mean over all
/// directions is a mean over discs with these radii. They are at the nodes of Gauss and Legendre from φ = 0 to the corner.
const HEXAGON: Discs = &[
    (1.000_661, 0.173_927),
    (1.015_117, 0.326_073),
    (1.064_854, 0.326_073),
    (1.131_700, 0.173_927),
];
const SQUARE: Discs = &[
    (1.000_679, 0.118_463),
    (1.016_652, 0.239_314),
    (1.082_392, 0.284_444),
    (1.215_093, 0.239_314),
    (1.364_865, 0.118_463),
];

impl Opening {
    /// Returns the cell of a lattice.
    #[must_use]
    pub fn cell(kind: LatticeKind) -> Self {
        match kind {
            LatticeKind::Orthogonal => Self::Square,
            LatticeKind::HexagonalRows | LatticeKind::HexagonalColumns => Self::Hexagon,
        }
    }

    /// Returns true for a disc, which files do not name.
    #[allow(clippy::trivially_copy_pass_by_ref)] // for serde
    pub(crate) fn is_disc(&self) -> bool {
        *self == Self::Disc
    }

    /// Returns the name used in files.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::Disc => "disc",
            Self::Hexagon => "hexagon",
            Self::Square => "square",
        }
    }

    /// Checks that micro-lenses with this opening form a lattice.
    pub fn check(self, kind: LatticeKind) -> Result<()> {
        if self == Self::Disc || self == Self::cell(kind) {
            return Ok(());
        }
        Err(Error::invalid(format!(
            "an opening cannot be a {} in a lattice of kind '{}': give \"disc\" or \"{}\"",
            self.name(),
            kind.name(),
            Self::cell(kind).name()
        )))
    }

    /// Returns the direction of the normal of one of its sides, rad, in a lattice whose rows have this direction.
    #[must_use]
    pub fn normal_rad(kind: LatticeKind, rows_rad: f64) -> f64 {
        match kind {
            LatticeKind::Orthogonal | LatticeKind::HexagonalRows => rows_rad,
            LatticeKind::HexagonalColumns => rows_rad + FRAC_PI_2,
        }
    }

    /// Returns the normals of its pairs of parallel sides, of which the first has this direction; zero vectors in place of
    /// missing pairs.
    #[must_use]
    pub fn normals(self, first_rad: f64) -> [Vector2<f64>; 3] {
        let pairs = usize::from(self.sides() / 2);
        std::array::from_fn(|i| {
            let angle = first_rad + PI * i as f64 / pairs.max(1) as f64;
            if i < pairs { Vector2::new(angle.cos(), angle.sin()) } else { Vector2::zeros() }
        })
    }

    /// Returns the number of sides; 0 for a disc.
    #[must_use]
    pub fn sides(self) -> u8 {
        match self {
            Self::Disc => 0,
            Self::Hexagon => 6,
            Self::Square => 4,
        }
    }

    /// Returns the radius of the circumscribed circle over half the width.
    #[must_use]
    pub fn reach(self) -> f64 {
        if self == Self::Disc { 1.0 } else { 1.0 / (PI / f64::from(self.sides())).cos() }
    }

    /// Returns the area over the square of half the width.
    #[must_use]
    pub fn area(self) -> f64 {
        let half_side = (PI / f64::from(self.sides())).tan();
        if self == Self::Disc { PI } else { f64::from(self.sides()) * half_side }
    }

    /// Returns the standard deviation along an axis over half the width: for polygons it is the same along all axes.
    #[must_use]
    pub fn std_dev(self) -> f64 {
        match self {
            Self::Disc => 0.5,
            Self::Hexagon => (5.0_f64 / 18.0).sqrt(),
            Self::Square => (1.0_f64 / 3.0).sqrt(),
        }
    }

    /// Maps a point of the unit disc into the opening, in units of half its width. The map preserves ratios of areas: it stretches
    /// sectors of the disc to the triangles between the middle and a side.
    #[must_use]
    pub fn of_disc(self, place: &Vector2<f64>, normal_rad: f64) -> Vector2<f64> {
        if self == Self::Disc {
            return *place;
        }
        let half = PI / f64::from(self.sides());
        let angle = place.y.atan2(place.x) - normal_rad;
        let side = (angle / (2.0 * half)).round();
        // From −1 to 1 along the side.
        let along = angle / half - 2.0 * side;
        let (sin, cos) = (normal_rad + 2.0 * half * side).sin_cos();
        let along = along * half.tan();
        Vector2::new(cos - along * sin, sin + along * cos) * place.norm()
    }

    /// Returns the discs whose weighted sum is this shape averaged over all directions: radius over half the width, and
    /// weight.
    #[must_use]
    pub fn discs(self) -> &'static [(f64, f64)] {
        match self {
            Self::Disc => &[(1.0, 1.0)],
            Self::Hexagon => HEXAGON,
            Self::Square => SQUARE,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Compares the discs with the polygons by area, π, 2√3 and 4, and by second moment.
    #[test]
    fn mean_discs_have_the_area_and_the_width_of_the_shape() {
        let areas =
            [(Opening::Disc, PI), (Opening::Hexagon, 12.0_f64.sqrt()), (Opening::Square, 4.0)];
        for (opening, area) in areas {
            assert!((opening.area() - area).abs() < 1e-12, "{opening:?}");
            let sum = |power: i32| -> f64 {
                opening.discs().iter().map(|(r, weight)| weight * r.powi(power)).sum()
            };
            assert!((PI * sum(2) / area - 1.0).abs() < 1e-5, "{opening:?}");
            let variance = sum(4) / sum(2) / 4.0;
            assert!((variance.sqrt() / opening.std_dev() - 1.0).abs() < 1e-4, "{opening:?}");
        }
    }

    #[test]
    fn sides_are_towards_neighbours() {
        let [first, second, third] = Opening::Hexagon.normals(0.1);
        for (normal, angle) in [(first, 0.1), (second, 0.1 + PI / 3.0), (third, 0.1 + PI / 1.5)] {
            assert!((normal.y.atan2(normal.x) - angle).abs() < 1e-12);
        }
        let normals = Opening::Square.normals(0.0);
        assert!((normals[1] - Vector2::y()).norm() < 1e-12 && normals[2] == Vector2::zeros());
        assert_eq!(Opening::Disc.normals(0.3), [Vector2::zeros(); 3]);
        assert!((Opening::Hexagon.reach() - 2.0 / 3.0_f64.sqrt()).abs() < 1e-12);
        assert!(Opening::Square.check(LatticeKind::HexagonalRows).is_err());
        assert!(Opening::Hexagon.check(LatticeKind::HexagonalColumns).is_ok());
    }
}
