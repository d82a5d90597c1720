//! Number of lens types, and check whether they follow the three-colouring of the lattice.

use rayon::prelude::*;

use super::array::{FoundArray, LensTypes};
use super::nodes::ByNode;
use super::radii::TypeRadius;
use crate::model::LatticeKind;

/// Least difference between the mean radii of two types that counts as real: in standard deviations, and relative to
/// the radius.
const DIFFERENT: f64 = 8.0;
const DIFFERENT_PART: f64 = 0.005;
/// Least relative difference between the radii of micro-images that alternate in size.
const ALTERNATING_PART: f64 = 0.01;
/// Fraction of the micro-images with the size of neighbours of their own type above which the relative difference alone
/// suffices; by chance it is a third. σ of radii contains noise, and errors that all types share.
const AGREE: f64 = 0.8;
/// Distance, in nodes, up to which neighbours show the local size of a type.
const NEAR: i32 = 3;

/// Judges the sizes of the three colours in one white image, from their second moments.
pub(super) fn judge_single(found: &FoundArray) -> LensTypes {
    let lattice = &found.array.grid.lattice;
    let one = || LensTypes { alternating: alternating(found), ..LensTypes::ONE };
    if lattice.kind() == LatticeKind::Orthogonal {
        return one();
    }
    let mut sums = [[0.0_f64; 3]; 3];
    for blob in &found.blobs {
        let (k, l) = found.index(blob.node);
        let sum = &mut sums[lattice.lens_type(k, l, 3)];
        sum[0] += 1.0;
        sum[1] += blob.spread;
        sum[2] += blob.spread * blob.spread;
    }
    let of_color = sums.map(|[count, sum, square]| {
        let mean = sum / count;
        (mean, ((square / count - mean * mean).max(0.0) / count).sqrt())
    });
    let pairs = [(0, 1), (1, 2), (2, 0)].map(|(a, b): (usize, usize)| {
        let apart = (of_color[a].0 - of_color[b].0).abs();
        (apart / of_color[a].1.hypot(of_color[b].1).max(1e-9), apart / of_color[a].0)
    });
    // A second moment is proportional to the square of the radius.
    if !pairs.iter().any(|&(s, part)| s > DIFFERENT && part > 2.0 * DIFFERENT_PART) {
        return one();
    }
    let separation = pairs.iter().map(|&(s, _)| s).fold(f64::INFINITY, f64::min);
    LensTypes {
        types: 3,
        separation: Some(separation),
        agreement: Some(agreement(found)),
        alternating: None,
    }
}

/// Judges the radii of the three colours in every white image.
pub(super) fn judge_types(images: &[Vec<TypeRadius>], found: &FoundArray) -> LensTypes {
    let pairs = [(0, 1), (1, 2), (2, 0)];
    let (mut clear, mut apart) = (false, false);
    let mut best: f64 = 0.0;
    for radii in images.iter().filter(|radii| radii.len() == 3) {
        let significance = |(a, b): (usize, usize)| {
            let (a, b) = (&radii[a], &radii[b]);
            let apart = (a.radius_px - b.radius_px).abs();
            let std_dev = a.std_dev_px.hypot(b.std_dev_px).max(1e-9);
            (apart / std_dev, apart / a.radius_px)
        };
        let all = pairs.map(significance);
        clear |= all.iter().any(|&(s, part)| s > DIFFERENT && part > DIFFERENT_PART);
        apart |= all.iter().any(|&(_, part)| part > DIFFERENT_PART);
        best = best.max(all.iter().map(|&(s, _)| s).fold(f64::INFINITY, f64::min));
    }
    let one = LensTypes { alternating: found.array.lens_types.alternating, ..LensTypes::ONE };
    if !apart {
        return one;
    }
    // The reference image has been judged already, unless its types did not show.
    let agreement = found.array.lens_types.agreement.unwrap_or_else(|| agreement(found));
    if !clear && agreement < AGREE {
        return one;
    }
    LensTypes { types: 3, separation: Some(best), agreement: Some(agreement), alternating: None }
}

/// Returns the relative difference of the radii of micro-images of two types: of even and odd rows, even and odd columns, or the
/// fields of a chessboard. `None` if no such difference is clear.
fn alternating(found: &FoundArray) -> Option<f64> {
    let difference = |parity: fn(i32, i32) -> i32| {
        let mut sums = [[0.0_f64; 3]; 2];
        for blob in &found.blobs {
            let (k, l) = found.index(blob.node);
            let sum = &mut sums[usize::from(parity(k, l) & 1 == 1)];
            sum[0] += 1.0;
            sum[1] += blob.spread;
            sum[2] += blob.spread * blob.spread;
        }
        let [even, odd] = sums.map(|[count, sum, square]| {
            let mean = sum / count;
            (mean, (square / count - mean * mean).max(0.0) / count)
        });
        let apart = (even.0 - odd.0).abs();
        let std_dev = (even.1 + odd.1).sqrt().max(1e-9 * even.0);
        // A second moment is proportional to the square of the radius.
        let of_radius = apart / (even.0 + odd.0);
        (apart > DIFFERENT * std_dev && of_radius > ALTERNATING_PART).then_some(of_radius)
    };
    let parities: [fn(i32, i32) -> i32; 3] = [|_, l| l, |k, _| k, |k, l| k + l];
    parities.into_iter().filter_map(difference).reduce(f64::max)
}

/// Returns the fraction of the micro-images that have the size of their own colour.
fn agreement(found: &FoundArray) -> f64 {
    let lattice = &found.array.grid.lattice;
    let color = |node: (i32, i32)| {
        let (k, l) = found.index(node);
        lattice.lens_type(k, l, 3)
    };
    let sizes: Vec<((i32, i32), (usize, f64))> =
        found.blobs.iter().map(|blob| (blob.node, (color(blob.node), blob.spread))).collect();
    let by_node = ByNode::new(&sizes);
    let agrees = |&&(node, (own_color, own)): &&((i32, i32), (usize, f64))| {
        let (mut sums, mut counts) = ([0.0; 3], [0.0; 3]);
        for (color, spread) in by_node.around(node, NEAR) {
            sums[color] += spread;
            counts[color] += 1.0;
        }
        let off = |c: usize| (sums[c] / counts[c] - own).abs();
        (0..3).min_by(|&a, &b| off(a).total_cmp(&off(b))) == Some(own_color)
    };
    sizes.par_iter().filter(agrees).count() as f64 / sizes.len().max(1) as f64
}
