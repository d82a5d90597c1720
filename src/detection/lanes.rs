//! Sums of single precision, added up side by side as registers do.

// Only what is inlined into a dispatched function is compiled for its registers.
#![allow(clippy::inline_always)]

/// Numbers that are added up side by side.
pub(super) const LANES: usize = 8;

/// The sum of products.
#[inline(always)]
pub(super) fn dot(a: &[f32], b: &[f32]) -> f32 {
    let mut lanes = [0.0_f32; LANES];
    let (a, a_rest) = a.as_chunks::<LANES>();
    let (b, b_rest) = b.as_chunks::<LANES>();
    for (a, b) in a.iter().zip(b) {
        for lane in 0..LANES {
            lanes[lane] += a[lane] * b[lane];
        }
    }
    let rest: f32 = a_rest.iter().zip(b_rest).map(|(a, b)| a * b).sum();
    lanes.iter().sum::<f32>() + rest
}

/// The sum of numbers.
#[inline(always)]
pub(super) fn sum(a: &[f32]) -> f32 {
    let mut lanes = [0.0_f32; LANES];
    let (a, a_rest) = a.as_chunks::<LANES>();
    for a in a {
        for lane in 0..LANES {
            lanes[lane] += a[lane];
        }
    }
    lanes.iter().sum::<f32>() + a_rest.iter().sum::<f32>()
}

/// The largest of numbers that are not negative; 0 without any.
#[inline(always)]
pub(super) fn largest(a: &[f32]) -> f32 {
    let mut lanes = [0.0_f32; LANES];
    let (a, a_rest) = a.as_chunks::<LANES>();
    for a in a {
        for lane in 0..LANES {
            lanes[lane] = if a[lane] > lanes[lane] { a[lane] } else { lanes[lane] };
        }
    }
    lanes.iter().chain(a_rest).fold(0.0, |most, a| most.max(*a))
}

/// Weighted products of rows with each other, in the lower triangle, and with numbers on their right. `weighted` is room for a
/// row.
#[inline(always)]
pub(super) fn products<const P: usize, const Q: usize>(
    rows: [&[f32]; P],
    right: [&[f32]; Q],
    weight: &[f32],
    weighted: &mut [f32],
) -> ([[f32; P]; P], [[f32; Q]; P]) {
    let (mut normal, mut of_right) = ([[0.0; P]; P], [[0.0; Q]; P]);
    for a in 0..P {
        for ((weighted, row), weight) in weighted.iter_mut().zip(rows[a]).zip(weight) {
            *weighted = row * weight;
        }
        for b in 0..=a {
            normal[a][b] = dot(weighted, rows[b]);
        }
        for b in 0..Q {
            of_right[a][b] = dot(weighted, right[b]);
        }
    }
    (normal, of_right)
}
