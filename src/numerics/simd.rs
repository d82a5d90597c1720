//! Numbers of single precision, side by side in registers.

// Only functions inlined into a dispatched function are compiled for its registers.
#![allow(clippy::inline_always)]

use std::ops::{Add, Mul, Neg, Sub};

use pulp::Simd;

/// Numbers that fill a register.
#[derive(Clone, Copy)]
pub(crate) struct Lanes<S: Simd> {
    simd: S,
    x: S::f32s,
}

impl<S: Simd> Lanes<S> {
    /// Creates lanes with the same number in all.
    #[inline(always)]
    pub fn splat(simd: S, x: f32) -> Self {
        Self { simd, x: simd.splat_f32s(x) }
    }

    /// Creates lanes from a register.
    #[inline(always)]
    pub fn of(simd: S, x: S::f32s) -> Self {
        Self { simd, x }
    }

    /// Returns the register.
    #[inline(always)]
    pub fn register(self) -> S::f32s {
        self.x
    }

    /// Returns self · by + and.
    #[inline(always)]
    pub fn mul_add(self, by: Self, and: Self) -> Self {
        Self::of(self.simd, self.simd.mul_add_e_f32s(self.x, by.x, and.x))
    }

    /// Returns self · by + and, for a number `by`.
    #[inline(always)]
    pub fn mul_add_scalar(self, by: f32, and: Self) -> Self {
        self.mul_add(Self::splat(self.simd, by), and)
    }

    /// Returns from − self · by.
    #[inline(always)]
    pub fn mul_from(self, by: Self, from: Self) -> Self {
        Self::of(self.simd, self.simd.negate_mul_add_e_f32s(self.x, by.x, from.x))
    }

    #[inline(always)]
    pub fn clamp(self, least: Self, most: Self) -> Self {
        let simd = self.simd;
        Self::of(simd, simd.max_f32s(least.x, simd.min_f32s(self.x, most.x)))
    }

    #[inline(always)]
    pub fn max(self, other: Self) -> Self {
        Self::of(self.simd, self.simd.max_f32s(self.x, other.x))
    }

    /// Returns the square roots; not a number for numbers below 0.
    #[inline(always)]
    pub fn sqrt(self) -> Self {
        Self::of(self.simd, self.simd.sqrt_f32s(self.x))
    }

    /// Returns the reciprocals.
    #[inline(always)]
    pub fn recip(self) -> Self {
        Self::of(self.simd, self.simd.div_f32s(self.simd.splat_f32s(1.0), self.x))
    }

    #[inline(always)]
    pub fn abs(self) -> Self {
        Self::of(self.simd, self.simd.abs_f32s(self.x))
    }

    #[inline(always)]
    pub fn min(self, other: Self) -> Self {
        Self::of(self.simd, self.simd.min_f32s(self.x, other.x))
    }

    /// Returns `yes` where this is below a limit, and `no` elsewhere.
    #[inline(always)]
    pub fn where_below(self, limit: f32, yes: Self, no: Self) -> Self {
        let simd = self.simd;
        let below = simd.less_than_f32s(self.x, simd.splat_f32s(limit));
        Self::of(simd, simd.select_f32s(below, yes.x, no.x))
    }

    /// Returns the largest number.
    #[inline(always)]
    pub fn largest(self) -> f32 {
        self.simd.reduce_max_f32s(self.x)
    }

    /// Returns the smallest number.
    #[inline(always)]
    pub fn smallest(self) -> f32 {
        self.simd.reduce_min_f32s(self.x)
    }

    /// Returns the sum of all numbers.
    #[inline(always)]
    pub fn sum(self) -> f32 {
        self.simd.reduce_sum_f32s(self.x)
    }
}

impl<S: Simd> Add for Lanes<S> {
    type Output = Self;

    #[inline(always)]
    fn add(self, other: Self) -> Self {
        Self::of(self.simd, self.simd.add_f32s(self.x, other.x))
    }
}

impl<S: Simd> Sub for Lanes<S> {
    type Output = Self;

    #[inline(always)]
    fn sub(self, other: Self) -> Self {
        Self::of(self.simd, self.simd.sub_f32s(self.x, other.x))
    }
}

impl<S: Simd> Mul for Lanes<S> {
    type Output = Self;

    #[inline(always)]
    fn mul(self, other: Self) -> Self {
        Self::of(self.simd, self.simd.mul_f32s(self.x, other.x))
    }
}

impl<S: Simd> Neg for Lanes<S> {
    type Output = Self;

    #[inline(always)]
    fn neg(self) -> Self {
        Self::of(self.simd, self.simd.neg_f32s(self.x))
    }
}

impl<S: Simd> Add<f32> for Lanes<S> {
    type Output = Self;

    #[inline(always)]
    fn add(self, other: f32) -> Self {
        self + Self::splat(self.simd, other)
    }
}

impl<S: Simd> Sub<f32> for Lanes<S> {
    type Output = Self;

    #[inline(always)]
    fn sub(self, other: f32) -> Self {
        self - Self::splat(self.simd, other)
    }
}

impl<S: Simd> Mul<f32> for Lanes<S> {
    type Output = Self;

    #[inline(always)]
    fn mul(self, other: f32) -> Self {
        self * Self::splat(self.simd, other)
    }
}

/// Returns the sum of products.
#[inline(always)]
pub(crate) fn dot<S: Simd>(simd: S, a: &[f32], b: &[f32]) -> f32 {
    let n = a.len().min(b.len());
    let ((a, a_rest), (b, b_rest)) = (S::as_simd_f32s(&a[..n]), S::as_simd_f32s(&b[..n]));
    let zero = Lanes::splat(simd, 0.0);
    // Each sum has to wait for its last product, so there are two.
    let mut sums = [zero, zero];
    let half = a.len() / 2;
    for i in 0..half {
        sums[0] = Lanes::of(simd, a[2 * i]).mul_add(Lanes::of(simd, b[2 * i]), sums[0]);
        sums[1] = Lanes::of(simd, a[2 * i + 1]).mul_add(Lanes::of(simd, b[2 * i + 1]), sums[1]);
    }
    if a.len() > 2 * half {
        sums[0] = Lanes::of(simd, a[2 * half]).mul_add(Lanes::of(simd, b[2 * half]), sums[0]);
    }
    let mut rest = 0.0;
    for (a, b) in a_rest.iter().zip(b_rest) {
        rest += a * b;
    }
    (sums[0] + sums[1]).sum() + rest
}

/// Returns the sum of numbers.
#[inline(always)]
pub(crate) fn sum<S: Simd>(simd: S, a: &[f32]) -> f32 {
    let (a, a_rest) = S::as_simd_f32s(a);
    let mut all = Lanes::splat(simd, 0.0);
    for a in a {
        all = all + Lanes::of(simd, *a);
    }
    let mut rest = 0.0;
    for a in a_rest {
        rest += a;
    }
    all.sum() + rest
}

/// Returns the weighted sum of squares.
#[inline(always)]
pub(crate) fn weighted_squares<S: Simd>(simd: S, weight: &[f32], a: &[f32]) -> f32 {
    let n = a.len().min(weight.len());
    let ((w, w_rest), (a, a_rest)) = (S::as_simd_f32s(&weight[..n]), S::as_simd_f32s(&a[..n]));
    let mut all = Lanes::splat(simd, 0.0);
    for (w, a) in w.iter().zip(a) {
        let a = Lanes::of(simd, *a);
        all = (Lanes::of(simd, *w) * a).mul_add(a, all);
    }
    let mut rest = 0.0;
    for (w, a) in w_rest.iter().zip(a_rest) {
        rest += w * a * a;
    }
    all.sum() + rest
}

/// Returns the largest of numbers that are not negative; 0 without any.
#[inline(always)]
pub(crate) fn largest<S: Simd>(simd: S, a: &[f32]) -> f32 {
    let (a, a_rest) = S::as_simd_f32s(a);
    let mut most = Lanes::splat(simd, 0.0);
    for a in a {
        most = most.max(Lanes::of(simd, *a));
    }
    let mut rest = simd.reduce_max_f32s(most.x);
    for a in a_rest {
        rest = if *a > rest { *a } else { rest };
    }
    rest
}

/// Returns weighted products of rows with each other, in the lower triangle, and with the numbers on their right. `weighted` is
/// a buffer for a row.
#[inline(always)]
pub(crate) fn products<S: Simd, const P: usize, const Q: usize>(
    simd: S,
    rows: [&[f32]; P],
    right: [&[f32]; Q],
    weight: &[f32],
    weighted: &mut [f32],
) -> ([[f32; P]; P], [[f32; Q]; P]) {
    let (mut normal, mut of_right) = ([[0.0; P]; P], [[0.0; Q]; P]);
    for a in 0..P {
        let (row, weight) = (&rows[a][..weighted.len()], &weight[..weighted.len()]);
        for i in 0..weighted.len() {
            weighted[i] = row[i] * weight[i];
        }
        for b in 0..=a {
            normal[a][b] = dot(simd, weighted, rows[b]);
        }
        for b in 0..Q {
            of_right[a][b] = dot(simd, weighted, right[b]);
        }
    }
    (normal, of_right)
}
