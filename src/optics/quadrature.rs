//! Quadratures of the opening of a micro-lens.
//!
//! The opening is uniform, and half its width is 1. A quadrature replaces it by a few normal distributions of equal width, its
//! nodes, with weights. Nodes of a disc are on rings, nodes of a polygon have its symmetry. Their places, weights and width
//! minimise ∫ |F(k) − F̂(k)|² k⁻² exp(−s²k²) dk over all directions, the error of an edge seen through a pixel. F is the
//! Fourier transform of the opening, for a disc 2 J₁(k)/k, F̂ is the transform of the nodes, and s is 12^(−1/2) px over the
//! blur radius. As a constraint, the blur radius and the edge variance have no error if both are fitted to an opening by these
//! nodes. (A width that keeps the second moment of the disc instead makes blur radii 0.17 % too small and variances up to
//! 0.02 px² too large, which is an error of 0.4 % of the aperture ratio. Cells of equal area need 61 nodes for the accuracy of
//! positions and blur radii that 24 of these nodes reach.)

use std::f32::consts::TAU;
use std::sync::LazyLock;

use crate::model::Opening;

/// Nodes at one distance from the middle: one in each direction given by their number and the direction of the first, as a
/// part of the angle between them; their distance, and weight of each.
type Ring = (usize, f64, f64, f64);
/// Rings, variance of a node along an axis, and largest blur radius, px, for which edges are accurate to 0.3 %.
type Design = (&'static [Ring], f64, f64);

/// Directions of the first node of a ring: towards a side, towards a corner, and for a disc, where only the differences between
/// rings count.
const SIDE: f64 = 0.0;
const CORNER: f64 = 0.5;
const ANY: f64 = 0.25;

const DISC: [Design; 3] = [
    (&[(5, ANY, 0.3536, 0.9963), (11, ANY, 0.7881, 1.0017)], 0.017_178, 1.75),
    (&[(1, ANY, 0.0, 1.2356), (8, ANY, 0.438, 0.974), (15, ANY, 0.8121, 0.9981)], 0.013_582, 3.0),
    (
        &[
            (1, ANY, 0.0, 0.7334),
            (6, ANY, 0.2799, 0.9735),
            (13, ANY, 0.5547, 0.9749),
            (20, ANY, 0.8495, 1.0376),
        ],
        0.008_562,
        5.0,
    ),
];
const HEXAGON: [Design; 3] = [
    (
        &[(6, CORNER, 0.3668, 0.9191), (6, SIDE, 0.7797, 1.0365), (6, CORNER, 0.8798, 1.0492)],
        0.017_536,
        1.75,
    ),
    (
        &[
            (1, SIDE, 0.0, 0.8593),
            (6, CORNER, 0.4295, 0.9526),
            (6, SIDE, 0.7872, 1.0773),
            (6, CORNER, 0.8837, 1.1109),
        ],
        0.017_947,
        3.0,
    ),
    (
        &[
            (1, SIDE, 0.0, 0.9607),
            (6, CORNER, 0.3207, 0.9675),
            (6, SIDE, 0.5601, 0.9639),
            (6, CORNER, 0.6321, 0.9361),
            (6, CORNER, 0.9575, 1.1074),
            (6, 0.180_482, 0.8594, 1.0637),
            (6, -0.180_482, 0.8594, 1.0637),
        ],
        0.009_583,
        5.0,
    ),
];
const SQUARE: [Design; 3] = [
    (
        &[
            (4, CORNER, 0.3487, 0.973),
            (4, 0.202_700, 0.7839, 0.9949),
            (4, -0.202_700, 0.7839, 0.9949),
            (4, CORNER, 1.0503, 1.0321),
        ],
        0.023_492,
        1.75,
    ),
    (
        &[
            (1, SIDE, 0.0, 0.9375),
            (4, SIDE, 0.3868, 0.9516),
            (4, CORNER, 0.5491, 0.9656),
            (4, SIDE, 0.7867, 1.0156),
            (4, 0.289_853, 0.8783, 1.0236),
            (4, -0.289_853, 0.8783, 1.0236),
            (4, CORNER, 1.1114, 1.1063),
        ],
        0.016_726,
        3.0,
    ),
    (
        &[
            (4, CORNER, 0.2312, 0.9529),
            (4, 0.203_782, 0.5139, 0.934),
            (4, -0.203_782, 0.5139, 0.934),
            (4, CORNER, 0.6853, 0.9423),
            (4, 0.122_931, 0.8352, 1.0108),
            (4, -0.122_931, 0.8352, 1.0108),
            (4, 0.338_682, 0.9509, 1.0288),
            (4, -0.338_682, 0.9509, 1.0288),
            (4, CORNER, 1.1553, 1.132),
        ],
        0.012_253,
        5.0,
    ),
];

type Designs = [Quadrature; 3];

static ALL: LazyLock<[Designs; 3]> = LazyLock::new(|| {
    [DISC, HEXAGON, SQUARE]
        .map(|designs| designs.map(|(rings, variance, _)| Quadrature::new(rings, variance)))
});

/// Node of the opening.
#[derive(Debug, Clone, Copy)]
pub(super) struct Node {
    /// Position; a polygon has one of its sides along x.
    pub x: f32,
    pub y: f32,
    /// Share of the opening.
    pub weight: f32,
}

/// Nodes that replace the opening.
#[derive(Debug)]
pub(super) struct Quadrature {
    pub nodes: Vec<Node>,
    /// Variance of a node along an axis.
    pub variance: f32,
    /// Radius of the outermost ring.
    pub radius: f32,
}

impl Quadrature {
    /// Returns the cheapest quadrature of an opening for a blur radius, px.
    pub fn of_blur(opening: Opening, radius_px: f64) -> &'static Self {
        let enough = DISC.iter().position(|(.., largest)| radius_px.abs() <= *largest);
        &Self::designs(opening)[enough.unwrap_or(DISC.len() - 1)]
    }

    /// Returns the quadrature of an opening with the fewest nodes.
    pub fn coarsest(opening: Opening) -> &'static Self {
        &Self::designs(opening)[0]
    }

    fn designs(opening: Opening) -> &'static Designs {
        match opening {
            Opening::Disc => &ALL[0],
            Opening::Hexagon => &ALL[1],
            Opening::Square => &ALL[2],
        }
    }

    #[allow(clippy::cast_possible_truncation)] // single precision, as the light
    fn new(rings: &[Ring], variance: f64) -> Self {
        let whole: f64 = rings.iter().map(|(count, _, _, weight)| *count as f64 * weight).sum();
        let mut nodes = Vec::new();
        for &(count, first, radius, weight) in rings {
            for i in 0..count {
                let (sin, cos) = (TAU * (i as f32 + first as f32) / count as f32).sin_cos();
                let (radius, weight) = (radius as f32, (weight / whole) as f32);
                nodes.push(Node { x: radius * cos, y: radius * sin, weight });
            }
        }
        let radius = rings.iter().map(|(_, _, radius, _)| *radius).fold(0.0, f64::max);
        Self { nodes, variance: variance as f32, radius: radius as f32 }
    }
}

#[cfg(test)]
mod tests {
    use nalgebra::{Matrix2, Vector2};

    use super::*;

    /// Returns the Fourier transform of an opening at a spatial frequency, and its derivative by the logarithm of its size.
    fn transform(opening: Opening, k: &Vector2<f64>) -> [f64; 2] {
        let size = k.norm();
        if opening == Opening::Disc {
            return [2.0 * libm::j1(size) / size, -2.0 * libm::jn(2, size)];
        }
        // A sum over strips perpendicular to k, with the width of the opening along k.
        let normals = opening.normals(0.0);
        let along = k / size;
        let across = Vector2::new(-along.y, along.x);
        let (mut area, mut sums) = (0.0, [0.0; 2]);
        let strips = 3000;
        for x in (0..strips).map(|i| opening.reach() * (f64::from(i) + 0.5) / f64::from(strips)) {
            let (mut low, mut high) = (f64::NEG_INFINITY, f64::INFINITY);
            for normal in normals.iter().filter(|normal| normal.norm() > 0.5) {
                let (base, slope) = (x * normal.dot(&along), normal.dot(&across));
                if slope.abs() < 1e-9 {
                    if base.abs() > 1.0 {
                        high = f64::NEG_INFINITY;
                    }
                    continue;
                }
                let ends = [(-1.0 - base) / slope, (1.0 - base) / slope];
                low = low.max(ends[0].min(ends[1]));
                high = high.min(ends[0].max(ends[1]));
            }
            let width = (high - low).max(0.0);
            area += width;
            sums[0] += width * (size * x).cos();
            sums[1] -= width * size * x * (size * x).sin();
        }
        sums.map(|sum| sum / area)
    }

    /// Returns the errors of an edge seen through a pixel: of ln ρ with the edge variance known, of ln ρ and of the edge
    /// variance, px², if both are fitted, and the root mean square error of the profile.
    fn errors(opening: Opening, quadrature: &Quadrature, rho: f64) -> [f64; 4] {
        let pixel = 1.0 / 12.0 / rho.powi(2);
        let (step, angles) = (0.05, 12);
        let (mut normal, mut right, mut squares) = (Matrix2::zeros(), Vector2::zeros(), 0.0);
        for k in (0..600).map(|i| step * (f64::from(i) + 0.5)) {
            let cell = (-0.5 * k * k * f64::from(quadrature.variance)).exp();
            let weight = (-pixel * k * k).exp() / (k * k) * step / f64::from(angles);
            for angle in (0..angles).map(|i| 0.01 + f64::from(i) * std::f64::consts::PI / 12.0) {
                let (sin, cos) = angle.sin_cos();
                let [exact, by_size] = transform(opening, &(Vector2::new(cos, sin) * k));
                let (mut re, mut im) = (0.0, 0.0);
                for node in &quadrature.nodes {
                    let phase = k * (f64::from(node.x) * cos + f64::from(node.y) * sin);
                    re += f64::from(node.weight) * phase.cos() * cell;
                    im += f64::from(node.weight) * phase.sin() * cell;
                }
                // Derivatives by ln ρ, and by the variance in units of ρ².
                let by = Vector2::new(by_size, -0.5 * k * k * exact);
                normal += by * by.transpose() * weight;
                right += by * (exact - re) * weight;
                squares += ((exact - re).powi(2) + im * im) * weight;
            }
        }
        let both = normal.try_inverse().unwrap() * right;
        [right.x / normal[(0, 0)], both.x, both.y * rho * rho, squares.sqrt()]
    }

    #[test]
    fn blur_radius_and_edge_variance_are_without_error() {
        for opening in [Opening::Disc, Opening::Hexagon, Opening::Square] {
            for rho in [0.75, 1.0, 1.5, 1.75, 1.76, 2.5, 3.0, 3.01, 4.0, 5.0] {
                let quadrature = Quadrature::of_blur(opening, rho);
                let [known, free, wider, rms] = errors(opening, quadrature, rho);
                println!(
                    "{opening:?} {rho} px: {known:.5}, {free:.5} and {wider:.5} px², {rms:.5}"
                );
                let of_radius = known.abs().max(free.abs()) * rho;
                assert!(of_radius < 1.5e-3, "{known} {free} at {rho} px");
                assert!(wider.abs() < 7e-3, "{wider} px² at {rho} px");
                assert!(rms < 3e-3, "{rms} at {rho} px");
            }
        }
    }
}
