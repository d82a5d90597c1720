//! A checkerboard corner in a micro-image.
//!
//! Light that comes through a point w of the micro-lens (a disc of radius 1) shows the board moved by
//! ρ w, and the pupil of the main lens moved by qᵢ w: pixel p sees the mean of the board at p − ρ w
//! over those w for which p − qᵢ w lies in the pupil, a disc of radius a about the centre of the
//! micro-image. Away from the centre the pupil cuts the disc of blur, and the mean moves: without that
//! a corner near the edge would seem up to ρ away from its place.

// Only what is inlined into a dispatched function is compiled for its registers.
#![allow(clippy::inline_always)]

use nalgebra::{DMatrix, DVector, Matrix2, Matrix4, Matrix6, Vector2, Vector4, Vector6};
use pulp::{Arch, NullaryFnOnce};

use super::patch::Patch;
use crate::vignetting::{Obliquity, Shade};

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
    /// Half the width over which a step rises, px.
    pub width: f64,
    /// Covariance of the place, px².
    pub covariance: Matrix2<f64>,
    /// Part of the variance of the light that it explains.
    pub explained: f64,
}

/// How the light of a point is spread in a micro-image.
#[derive(Debug, Clone)]
pub(super) struct Spread<'a> {
    /// ρ, px.
    rho: f64,
    /// What the pupil leaves of it.
    shade: &'a Shade,
    /// At which angles it arrives.
    obliquity: Obliquity,
    /// Points of the unit disc that stand for equal shares of it.
    points: Vec<Vector2<f64>>,
    /// Half the width of steps between two of them, and of a pixel.
    width: f64,
}

/// Numbers of points in rings, from the middle.
const RINGS: [u32; 3] = [1, 6, 12];

impl<'a> Spread<'a> {
    /// For a blur radius ρ, px.
    pub fn new(rho: f64, shade: &'a Shade, obliquity: Obliquity) -> Self {
        let all = f64::from(RINGS.iter().sum::<u32>());
        let mut points = Vec::new();
        let mut inside = 0;
        for count in RINGS {
            // The root mean square radius of the ring's share of the area.
            let radius = if count == 1 {
                0.0
            } else {
                ((f64::from(inside) + f64::from(count) / 2.0) / all).sqrt()
            };
            points.extend((0..count).map(|i| {
                let angle = std::f64::consts::TAU * (f64::from(i) + 0.25) / f64::from(count);
                Vector2::new(angle.cos(), angle.sin()) * radius
            }));
            inside += count;
        }
        // What the points lack of the mean square of the disc's light along an axis, a quarter.
        let held = points.iter().map(|p| p.norm_squared() / 2.0).sum::<f64>() / all;
        // The step's derivative has a variance of a fifth of its half width squared.
        let width = (5.0 * (1.0 / 12.0 + rho * rho * (0.25 - held))).sqrt();
        Self { rho, shade, obliquity, points, width }
    }

    /// A point alone, for steps of unknown width.
    pub fn unknown(shade: &'a Shade) -> Self {
        let obliquity = Obliquity::default();
        Self { rho: 0.0, shade, obliquity, points: vec![Vector2::zeros()], width: 3.0 }
    }

    /// By point, where every pixel looks: its offset less what the spread moves it by.
    #[allow(clippy::cast_possible_truncation)] // single precision, as the light
    fn looks(&self, patch: &Patch) -> Vec<[Vec<f32>; 2]> {
        let rho = self.rho;
        let (mut middle, mut squeeze) = (Vec::new(), Vec::new());
        for (&x, &y) in patch.x.iter().zip(&patch.y) {
            let offset = Vector2::new(f64::from(x), f64::from(y));
            let part = self.shade.part(&offset);
            // Points of the micro-lens are turned by half against where they are.
            let from_lens = offset + part.mean * self.obliquity.lens_px;
            let mean = part.mean - self.obliquity.shift(&from_lens, &part.squeeze);
            middle.push((part.seen_at - mean * rho).map(|x| x as f32));
            squeeze.push((part.squeeze * rho).map(|x| x as f32));
        }
        let of_point = |point: &Vector2<f64>| {
            let point = point.map(|x| x as f32);
            let look = |row: usize| {
                let of_pixel = |(m, s): (&Vector2<f32>, &Matrix2<f32>)| {
                    m[row] - s[(row, 0)] * point.x - s[(row, 1)] * point.y
                };
                middle.iter().zip(&squeeze).map(of_pixel).collect::<Vec<f32>>()
            };
            [look(0), look(1)]
        };
        self.points.iter().map(of_point).collect()
    }
}

/// Least saddle that may be a corner: its flatter curvature over the steeper.
const SADDLE: f64 = 0.12;
/// Least curvature of a saddle over the least contrast, 1/px²: of the widest blur.
const CURVATURE: f64 = 0.03;
/// Steps of a fit.
const STEPS: usize = 12;
/// A step shorter than this, px, ends a fit.
const SETTLED_PX: f64 = 0.003;

/// Where saddles are looked for: all of the micro-image, and round windows of it, px.
const WINDOW_PX: f64 = 5.5;
const WINDOWS_AT_PX: f64 = 4.5;

/// Saddles of the light in windows of a micro-image, strongest first; none where the light varies
/// less than a corner of the least contrast makes it.
pub(super) fn saddles(patch: &Patch, least_contrast: f64) -> Vec<Corner> {
    let (mean, std_dev) = patch.mean_and_std_dev();
    if std_dev < 0.3 * least_contrast {
        return Vec::new();
    }
    let around = (0..6).map(|i| {
        let angle = std::f64::consts::TAU * f64::from(i) / 6.0;
        (Vector2::new(angle.cos(), angle.sin()) * WINDOWS_AT_PX, WINDOW_PX)
    });
    let windows = std::iter::once((Vector2::zeros(), f64::INFINITY)).chain(around);
    let mut saddles: Vec<(f64, Corner)> = windows
        .filter_map(|(middle, radius)| saddle(patch, mean, std_dev, &middle, radius))
        .collect();
    saddles.retain(|(curvature, _)| *curvature > CURVATURE * least_contrast);
    saddles.sort_by(|a, b| b.0.total_cmp(&a.0));
    saddles.into_iter().map(|(_, corner)| corner).collect()
}

/// The saddle of a quadratic fitted to the light in a window, and its weaker curvature; `None` if it
/// is none, or elsewhere.
#[allow(clippy::cast_possible_truncation)] // single precision, as the light
fn saddle(
    patch: &Patch,
    mean: f64,
    std_dev: f64,
    middle: &Vector2<f64>,
    radius: f64,
) -> Option<(f64, Corner)> {
    // Coordinates of size one.
    const SCALE: f32 = 8.0;
    let (mut normal, mut right) = (Matrix6::<f32>::zeros(), Vector6::<f32>::zeros());
    let (x0, y0, radius2) = (middle.x as f32, middle.y as f32, (radius * radius) as f32);
    for i in 0..patch.x.len() {
        let (x, y) = (patch.x[i] - x0, patch.y[i] - y0);
        if x * x + y * y > radius2 {
            continue;
        }
        let (x, y) = (x / SCALE, y / SCALE);
        let row = Vector6::new(1.0, x, y, x * x, x * y, y * y);
        let weighted = row * patch.weight[i];
        for a in 0..6 {
            for b in 0..=a {
                normal[(a, b)] += weighted[a] * row[b];
            }
        }
        right += weighted * (patch.light[i] - mean as f32);
    }
    let fit = normal.map(f64::from).cholesky()?.solve(&right.map(f64::from));
    let scale = f64::from(SCALE);
    let hessian = Matrix2::new(2.0 * fit[3], fit[4], fit[4], 2.0 * fit[5]) / (scale * scale);
    let eigen = hessian.symmetric_eigen();
    let (up, down) = if eigen.eigenvalues[0] > eigen.eigenvalues[1] { (0, 1) } else { (1, 0) };
    let (bright, dark) = (eigen.eigenvalues[up], -eigen.eigenvalues[down]);
    if bright <= 0.0 || dark <= 0.0 || bright.min(dark) < SADDLE * bright.max(dark) {
        return None;
    }
    let from_middle = -(hessian.try_inverse()? * Vector2::new(fit[1], fit[2]) / scale);
    if from_middle.norm() > radius.min(1.5 * WINDOW_PX) {
        return None;
    }
    // Where the quadratic is flat run the edges, on both sides of the bright direction.
    let tilt = (bright / dark).sqrt().atan();
    let axis = eigen.eigenvectors.column(up);
    let angle = axis.y.atan2(axis.x);
    let corner = Corner {
        place: middle + from_middle,
        angles: [angle + tilt, angle - tilt],
        level: mean,
        contrast: -1.3 * std_dev,
        width: 3.0,
        covariance: Matrix2::zeros(),
        explained: 0.0,
    };
    Some((bright.min(dark), corner))
}

/// What a fit is free to change.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Free {
    /// Place, levels, directions and width.
    All,
    /// Place and levels.
    Place,
}

impl Corner {
    /// Fits the corner to the light; `None` if it leads nowhere.
    pub fn fitted(&self, patch: &Patch, spread: &Spread, free: Free) -> Option<Self> {
        let looks = spread.looks(patch);
        let mut corner = *self;
        if free == Free::Place {
            corner.width = spread.width;
        }
        let count = if free == Free::All { 7 } else { 4 };
        let mut model = Model::new(patch.x.len());
        let mut at_next = Model::new(patch.x.len());
        let mut damping = 1e-3;
        let mut cost = model.evaluate(&corner, patch, &looks);
        for _ in 0..STEPS {
            let (normal, right) = model.normal_equations(patch, count);
            let mut damped = normal.clone();
            for i in 0..count {
                damped[(i, i)] *= 1.0 + damping;
            }
            let step = damped.cholesky()?.solve(&right);
            let next = corner.moved(&step, free);
            let next_cost = at_next.evaluate(&next, patch, &looks);
            if next_cost < cost {
                let length = (next.place - corner.place).norm();
                (corner, cost) = (next, next_cost);
                std::mem::swap(&mut model, &mut at_next);
                damping = (damping * 0.1).max(1e-6);
                if length < SETTLED_PX {
                    break;
                }
            } else {
                damping *= 10.0;
                if damping > 1e4 {
                    break;
                }
            }
            if corner.place.norm() > 30.0 {
                return None;
            }
        }
        let (normal, _) = model.normal_equations(patch, count);
        let inverse = normal.cholesky()?.inverse();
        let pixels = patch.x.len() as f64;
        let weights: f64 = patch.weight.iter().map(|&w| f64::from(w)).sum();
        let mean = patch
            .light
            .iter()
            .zip(&patch.weight)
            .map(|(&l, &w)| f64::from(l) * f64::from(w))
            .sum::<f64>()
            / weights;
        let total: f64 = patch
            .light
            .iter()
            .zip(&patch.weight)
            .map(|(&l, &w)| (f64::from(l) - mean).powi(2) * f64::from(w))
            .sum();
        let variance = cost / (pixels - count as f64).max(1.0);
        corner.covariance = inverse.fixed_view::<2, 2>(0, 0).into_owned() * variance;
        corner.explained = 1.0 - cost / total;
        let finite = corner.place.iter().all(|x| x.is_finite()) && corner.contrast.is_finite();
        finite.then_some(corner)
    }

    fn moved(&self, step: &DVector<f64>, free: Free) -> Self {
        // Steps are cut where the linear model says nothing any more.
        let mut place = Vector2::new(step[0], step[1]);
        if place.norm() > 2.0 {
            place *= 2.0 / place.norm();
        }
        let mut next = *self;
        next.place += place;
        next.level += step[2];
        next.contrast += step[3];
        if free == Free::All {
            next.angles[0] += step[4].clamp(-0.3, 0.3);
            next.angles[1] += step[5].clamp(-0.3, 0.3);
            next.width = (next.width + step[6].clamp(-1.0, 1.0)).clamp(0.6, 8.0);
        }
        next
    }

    /// Positive along directions to bright squares, of a size that does not depend on the contrast.
    pub fn squares(&self) -> Matrix2<f64> {
        let [a, b] = self.angles.map(|angle| Vector2::new(-angle.sin(), angle.cos()));
        (a * b.transpose() + b * a.transpose()) * self.contrast.signum()
    }

    /// How unlike the four quarters are to two bright and two dark ones: the steps across single edges
    /// over that across both. 0 for a corner of a checkerboard, 1 where only one quarter is dark, as at
    /// the outer corners of the board; `None` if the light does not tell.
    #[allow(clippy::cast_possible_truncation)] // single precision, as the light
    pub fn imbalance(&self, patch: &Patch, spread: &Spread) -> Option<f64> {
        let (mut normal, mut right) = (Matrix4::<f32>::zeros(), Vector4::<f32>::zeros());
        let inverse = (1.0 / self.width) as f32;
        let place = self.place.map(|x| x as f32);
        let normals = self.angles.map(|angle| [-angle.sin() as f32, angle.cos() as f32]);
        let looks = spread.looks(patch);
        let share = 1.0 / looks.len() as f32;
        for i in 0..patch.x.len() {
            let mut row = Vector4::new(1.0, 0.0, 0.0, 0.0);
            for [look_x, look_y] in &looks {
                let (x, y) = ((look_x[i] - place.x) * inverse, (look_y[i] - place.y) * inverse);
                let [s, t] = normals.map(|n| {
                    let t = (n[0] * x + n[1] * y).clamp(-1.0, 1.0);
                    t * (1.5 - 0.5 * t * t)
                });
                row += Vector4::new(0.0, s, t, s * t) * share;
            }
            normal += row * row.transpose() * patch.weight[i];
            right += row * (patch.weight[i] * patch.light[i]);
        }
        let levels = normal.cholesky()?.solve(&right);
        Some(f64::from(levels[1].abs().max(levels[2].abs()) / levels[3].abs()))
    }

    /// Sine of the angle between the edges.
    pub fn opening(&self) -> f64 {
        (self.angles[0] - self.angles[1]).sin().abs()
    }
}

/// The model of the light and its derivatives, pixel by pixel.
struct Model {
    residual: Vec<f32>,
    /// By u, v, level, contrast, both directions, and width.
    rows: [Vec<f32>; 7],
}

impl Model {
    fn new(pixels: usize) -> Self {
        Self { residual: vec![0.0; pixels], rows: std::array::from_fn(|_| vec![0.0; pixels]) }
    }

    /// Fills in residuals and derivatives; the weighted sum of squares.
    fn evaluate(&mut self, corner: &Corner, patch: &Patch, looks: &[[Vec<f32>; 2]]) -> f64 {
        // The same operations in the widest registers that the processor has.
        Arch::new().dispatch(Evaluation { model: self, corner, patch, looks })
    }

    /// J'WJ and J'Wr of the first parameters.
    fn normal_equations(&self, patch: &Patch, count: usize) -> (DMatrix<f64>, DVector<f64>) {
        let sums = Arch::new().dispatch(Products { model: self, weight: &patch.weight, count });
        let normal = DMatrix::from_fn(count, count, |a, b| f64::from(sums[a.max(b)][a.min(b)]));
        let right = DVector::from_fn(count, |a, _| f64::from(sums[a][7]));
        (normal, right)
    }
}

/// Weighted products of the rows of a model with each other and, in the last place, the residuals.
struct Products<'a> {
    model: &'a Model,
    weight: &'a [f32],
    count: usize,
}

/// Numbers that are added up side by side.
const LANES: usize = 8;

impl NullaryFnOnce for Products<'_> {
    type Output = [[f32; 8]; 7];

    #[inline(always)]
    fn call(self) -> [[f32; 8]; 7] {
        let n = self.weight.len();
        let mut sums = [[0.0; 8]; 7];
        let mut weighted = vec![0.0_f32; n];
        for (a, sums) in sums.iter_mut().enumerate().take(self.count) {
            for ((weighted, row), weight) in
                weighted.iter_mut().zip(&self.model.rows[a]).zip(self.weight)
            {
                *weighted = row * weight;
            }
            for (sum, row) in sums.iter_mut().zip(&self.model.rows).take(a + 1) {
                *sum = dot(&weighted, row);
            }
            sums[7] = dot(&weighted, &self.model.residual);
        }
        sums
    }
}

#[inline(always)]
fn dot(a: &[f32], b: &[f32]) -> f32 {
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

/// One evaluation of a model.
struct Evaluation<'a> {
    model: &'a mut Model,
    corner: &'a Corner,
    patch: &'a Patch,
    looks: &'a [[Vec<f32>; 2]],
}

impl NullaryFnOnce for Evaluation<'_> {
    type Output = f64;

    #[inline(always)]
    #[allow(clippy::cast_possible_truncation)] // single precision, as the light
    fn call(self) -> f64 {
        let Self { model, corner, patch, looks } = self;
        let n = patch.x.len();
        for row in &mut model.rows {
            row.fill(0.0);
        }
        let inverse = (1.0 / corner.width) as f32;
        let place = corner.place.map(|x| x as f32);
        let [(s1, c1), (s2, c2)] = corner.angles.map(|angle| {
            let (s, c) = angle.sin_cos();
            (s as f32, c as f32)
        });
        let share = 1.0 / looks.len() as f32;
        let rows = model.rows.each_mut().map(|row| &mut row[..n]);
        let [by_u, by_v, level, shape, by_1, by_2, by_width] = rows;
        for [look_x, look_y] in looks {
            let (look_x, look_y) = (&look_x[..n], &look_y[..n]);
            for i in 0..n {
                let (x, y) = ((look_x[i] - place.x) * inverse, (look_y[i] - place.y) * inverse);
                let (d1, d2) = (c1 * y - s1 * x, c2 * y - s2 * x);
                let (a, b) = (d1.clamp(-1.0, 1.0), d2.clamp(-1.0, 1.0));
                let (t1, t2) = (a * (1.5 - 0.5 * a * a), b * (1.5 - 0.5 * b * b));
                let (e1, e2) = (1.5 - 1.5 * a * a, 1.5 - 1.5 * b * b);
                let (g1, g2) = (e1 * t2, t1 * e2);
                shape[i] += t1 * t2;
                by_u[i] += g1 * s1 + g2 * s2;
                by_v[i] -= g1 * c1 + g2 * c2;
                by_1[i] -= g1 * (c1 * x + s1 * y);
                by_2[i] -= g2 * (c2 * x + s2 * y);
                by_width[i] -= g1 * d1 + g2 * d2;
            }
        }
        let (m, h) = (corner.level as f32, corner.contrast as f32);
        let (per_angle, per_px) = (h * share, h * share * inverse);
        let (light, weight, residuals) =
            (&patch.light[..n], &patch.weight[..n], &mut model.residual[..n]);
        for i in 0..n {
            shape[i] *= share;
            residuals[i] = light[i] - m - h * shape[i];
            level[i] = 1.0;
            by_u[i] *= per_px;
            by_v[i] *= per_px;
            by_1[i] *= per_angle;
            by_2[i] *= per_angle;
            by_width[i] *= per_px;
        }
        let mut cost = 0.0_f32;
        for i in 0..n {
            cost += weight[i] * residuals[i] * residuals[i];
        }
        f64::from(cost)
    }
}
