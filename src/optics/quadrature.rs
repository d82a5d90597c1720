//! Quadratures of the opening of a micro-lens.
//!
//! The opening is a uniform disc of radius 1. A quadrature stands for it by a few normal distributions of one width: nodes on
//! rings, with weights. Radii and weights minimise ∫ |F(k) − F̂(k)|² k⁻² exp(−0.01 k²) dk over all directions, the error of an
//! edge seen through a pixel of a tenth of the blur radius, where F is the Fourier transform of the disc, 2 J₁(k)/k, and F̂ that
//! of the nodes. Their width keeps the second moment of the disc and the fit its fourth one, 1/3: an error of either is a wrong
//! blur radius. (Cells of equal area need 61 nodes for the places and blur radii that these have with 24.)

use std::f32::consts::TAU;

/// A ring of nodes: their number, radius and weight of each.
type Ring = (usize, f64, f64);

const SMALL: [Ring; 3] = [(1, 0.0, 1.2381), (8, 0.4389, 0.9755), (15, 0.8139, 0.9972)];
const LARGE: [Ring; 4] =
    [(1, 0.0, 0.6523), (6, 0.2768, 0.9884), (13, 0.5593, 1.0027), (20, 0.8543, 1.0191)];
/// Blur radii above this, px, need the finer quadrature: there its cells are as wide as a pixel.
const SMALL_PX: f64 = 3.0;

/// A node of the opening.
#[derive(Debug, Clone, Copy)]
pub(super) struct Node {
    /// Place.
    pub x: f32,
    pub y: f32,
    /// Share of the opening.
    pub weight: f32,
}

/// Nodes that stand for the opening.
#[derive(Debug)]
pub(super) struct Quadrature {
    pub nodes: Vec<Node>,
    /// Variance of a node along an axis.
    pub variance: f32,
}

impl Quadrature {
    /// The cheapest one for a blur radius, px.
    pub fn of_blur(radius_px: f64) -> &'static Self {
        static ALL: std::sync::LazyLock<[Quadrature; 2]> =
            std::sync::LazyLock::new(|| [Quadrature::new(&SMALL), Quadrature::new(&LARGE)]);
        &ALL[usize::from(radius_px.abs() > SMALL_PX)]
    }

    #[allow(clippy::cast_possible_truncation)] // single precision, as the light
    fn new(rings: &[Ring]) -> Self {
        let whole: f64 = rings.iter().map(|(count, _, weight)| *count as f64 * weight).sum();
        let mut nodes = Vec::new();
        for &(count, radius, weight) in rings {
            for i in 0..count {
                let (sin, cos) = (TAU * (i as f32 + 0.25) / count as f32).sin_cos();
                let (radius, weight) = (radius as f32, (weight / whole) as f32);
                nodes.push(Node { x: radius * cos, y: radius * sin, weight });
            }
        }
        let of_ring = |(count, radius, weight): &Ring| *count as f64 * weight * radius * radius;
        let square: f64 = rings.iter().map(of_ring).sum::<f64>() / whole / 2.0;
        // The variance of the disc along an axis is a quarter.
        Self { nodes, variance: (0.25 - square) as f32 }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// ⟨r⁴⟩ and ⟨r⁶⟩ of the disc are 1/3 and 1/4; with a normal distribution of the variance s about a node at r they are
    /// r⁴ + 8 r² s + 8 s² and r⁶ + 18 r⁴ s + 72 r² s² + 48 s³.
    #[test]
    fn nodes_have_the_moments_of_the_disc() {
        for (radius, fourth, sixth) in [(1.0, 1e-3, 1e-2), (5.0, 4e-3, 1e-2)] {
            let quadrature = Quadrature::of_blur(radius);
            let s = quadrature.variance;
            let mean = |of: &dyn Fn(f32) -> f32| {
                let of = |node: &Node| node.weight * of(node.x * node.x + node.y * node.y);
                quadrature.nodes.iter().map(of).sum::<f32>()
            };
            assert!((mean(&|_| 1.0) - 1.0).abs() < 1e-5);
            assert!((mean(&|r2| r2 + 2.0 * s) - 0.5).abs() < 1e-5);
            let of_fourth = mean(&|r2| r2 * r2 + 8.0 * r2 * s + 8.0 * s * s);
            assert!((of_fourth - 1.0 / 3.0).abs() < fourth, "{of_fourth}");
            let of_sixth =
                mean(&|r2| r2.powi(3) + 18.0 * r2 * r2 * s + 72.0 * r2 * s * s + 48.0 * s.powi(3));
            assert!((of_sixth - 0.25).abs() < sixth, "{of_sixth}");
        }
    }
}
