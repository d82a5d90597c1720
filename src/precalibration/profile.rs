//! The light across a micro-image of a white target, and the outer radius from it.
//!
//! On the sensor the main lens's pupil, seen through the middle of a micro-lens, is a disc of radius
//! a, and every point of it is spread by the micro-lens over a disc of radius b: the micro-image is
//! the overlap of two discs, flat up to |a − b| and dark from a + b on. a = |m|/N and b = |qᵢ| of
//! Eq. (miradiusfnumber), so that the outer radius is the paper's radius of the micro-image.

use nalgebra::{Matrix2, Vector2};

use crate::vignetting::{CommonPart, Obliquity, common_part, overlap};

/// Mean light at distances from the middle of micro-images of one type.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Profile {
    pub bins: Vec<Bin>,
}

#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub(super) struct Bin {
    /// Mean distance, px.
    pub radius: f64,
    pub light: f64,
    /// Standard deviation of the mean.
    pub std_dev: f64,
    /// Light over what it would be if it came straight.
    pub fall_off: f64,
}

/// Two discs fitted to a profile.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Discs {
    /// a + b, px.
    pub outer: f64,
    /// |a − b|, px.
    pub inner: f64,
    /// Light in the middle, and of the background.
    pub amplitude: f64,
    pub background: f64,
    /// Standard deviation of `outer`, px.
    pub std_dev: f64,
}

/// Width of the bins, px.
const BIN_PX: f64 = 0.125;
/// Samples in a bin that give it a standard deviation worth having.
const FEWEST: f64 = 8.0;
/// Above this part of full scale samples may be clipped; a bin that holds such is left out.
const CLIPPED: f64 = 0.97;
/// Only light up to this part of the brightest is fitted: the edge says where the outer radius is, and
/// what oblique rays do to the light changes little across it.
const OUTER_LIGHT: f64 = 0.5;
/// What discs leave unexplained of the light in the middle: oblique rays, pixels, grids.
const MODEL_ERROR: f64 = 2e-3;
/// One bin in so many tells where a descent should start.
const COARSE: usize = 4;
/// Gauss-Newton steps shrink fast: after one that is so short, px, nothing is left to gain.
const SETTLED_PX: f64 = 1e-6;
/// Starts that are followed down.
const DESCENTS: usize = 2;
/// Nodes and weights of Gauss' rule across a pixel.
const PIXEL: [(f64, f64); 3] = [
    (-0.387_298_334_620_741_7, 5.0 / 18.0),
    (0.0, 8.0 / 18.0),
    (0.387_298_334_620_741_7, 5.0 / 18.0),
];

/// Collects samples into a profile.
#[derive(Debug)]
pub(super) struct Stack {
    bins: Vec<[f64; 5]>,
}

impl Stack {
    /// For distances up to `reach`, px.
    pub fn new(reach: f64) -> Self {
        #[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss)] // a few pixels
        let bins = (reach / BIN_PX).ceil() as usize;
        Self { bins: vec![[0.0; 5]; bins] }
    }

    #[inline]
    pub fn add(&mut self, radius: f64, light: f64) {
        #[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss)] // a distance
        let bin = (radius / BIN_PX) as usize;
        if let Some(bin) = self.bins.get_mut(bin) {
            bin[0] += 1.0;
            bin[1] += radius;
            bin[2] += light;
            bin[3] += light * light;
            bin[4] += f64::from(u8::from(light > CLIPPED));
        }
    }

    pub fn profile(&self) -> Profile {
        let bin = |&[count, radius, light, square, clipped]: &[f64; 5]| {
            let mean = light / count;
            let variance = (square / count - mean * mean).max(0.0);
            (count >= FEWEST && clipped == 0.0).then(|| Bin {
                radius: radius / count,
                light: mean,
                std_dev: (variance / count).sqrt(),
                fall_off: 1.0,
            })
        };
        let bins: Vec<Bin> = self.bins.iter().filter_map(bin).collect();
        let clipped = self.bins.iter().any(|bin| bin[4] > 0.0);
        let brightest = bins.iter().map(|bin| bin.light).fold(0.0, f64::max);
        let limit = OUTER_LIGHT * if clipped { 1.0 } else { brightest };
        Profile { bins: bins.into_iter().filter(|bin| bin.light <= limit).collect() }
    }
}

/// Overlap of discs averaged over a pixel.
pub(super) fn seen(r: f64, outer: f64, inner: f64) -> f64 {
    // Across the direction to the middle a pixel has a mean square of 1/12.
    PIXEL
        .iter()
        .map(|&(x, weight)| weight * overlap(((r + x).powi(2) + 1.0 / 12.0).sqrt(), outer, inner))
        .sum()
}

impl Profile {
    /// The same profile, knowing that light comes obliquely: through a micro-lens with the blur radius
    /// `q_px` (with the sign that Eq. (radiusfinal) gives it) from a pupil of radius `pupil_px`.
    ///
    /// Where f < d the far side of the micro-lens lights the edge of the micro-image, at a steep angle;
    /// where f > d the near side does.
    pub fn oblique(&self, pupil_px: f64, q_px: f64, obliquity: &Obliquity) -> Self {
        let q = q_px.abs().max(1e-6);
        let of_bin = |bin: &Bin| {
            let part = common_part(bin.radius / q, pupil_px / q);
            let part = part.unwrap_or(CommonPart { mean: 1.0, along: 0.0, across: 0.0, area: 0.0 });
            let from_lens = bin.radius + part.mean * q_px.signum() * obliquity.lens_px;
            let from_lens = Vector2::new(from_lens, 0.0);
            Bin { fall_off: obliquity.light(&from_lens, part.along, part.across), ..*bin }
        };
        Self { bins: self.bins.iter().map(of_bin).collect() }
    }

    /// Fits two discs; `None` if the profile does not show an edge.
    pub fn fit(&self, largest: f64) -> Option<Discs> {
        // The sum of squares has several valleys where much is clipped: look all over first, at some
        // of the bins.
        let coarse = Self { bins: self.bins.iter().step_by(COARSE).copied().collect() };
        let mut starts: Vec<(f64, f64, f64)> = (9..=22)
            .map(|i| f64::from(i) * 0.05 * largest)
            .flat_map(|outer| [0.05, 0.25, 0.5, 0.75].map(|inner| (outer, inner * outer)))
            .filter_map(|(outer, inner)| {
                let (linear, residuals) = coarse.residuals(outer, inner)?;
                let sum = residuals.iter().map(|r| r * r).sum();
                (linear.x > 0.0).then_some((sum, outer, inner))
            })
            .collect();
        starts.sort_by(|a, b| a.0.total_cmp(&b.0));
        starts
            .into_iter()
            .take(DESCENTS)
            .filter_map(|(_, outer, inner)| self.descend(outer, inner, largest))
            .min_by(|a, b| a.1.total_cmp(&b.1))
            .map(|(discs, _)| discs)
    }

    /// Amplitude and background that fit best, and the weighted residuals.
    fn residuals(&self, outer: f64, inner: f64) -> Option<(Vector2<f64>, Vec<f64>)> {
        let brightest = self.bins.iter().map(|b| b.light).fold(0.0, f64::max);
        let weight = |bin: &Bin| 1.0 / bin.std_dev.hypot(MODEL_ERROR * brightest);
        let shape = |b: &Bin| seen(b.radius, outer, inner) * b.fall_off;
        let shape: Vec<f64> = self.bins.iter().map(shape).collect();
        let (mut normal, mut right) = (Matrix2::zeros(), Vector2::zeros());
        for (bin, &shape) in self.bins.iter().zip(&shape) {
            let w2 = weight(bin).powi(2);
            let row = Vector2::new(shape, 1.0);
            normal += row * row.transpose() * w2;
            right += row * (bin.light * w2);
        }
        let linear = normal.try_inverse()? * right;
        let residual =
            |(bin, shape): (&Bin, &f64)| (bin.light - linear.x * shape - linear.y) * weight(bin);
        Some((linear, self.bins.iter().zip(&shape).map(residual).collect()))
    }

    /// Light in the middle of discs of known size, above the background, over what clips it.
    pub fn peak(&self, outer: f64, inner: f64) -> Option<f64> {
        self.residuals(outer, inner).map(|(linear, _)| linear.x)
    }

    /// Levenberg-Marquardt from one start: the discs and the sum of squares.
    fn descend(&self, outer: f64, inner: f64, largest: f64) -> Option<(Discs, f64)> {
        const STEP: f64 = 1e-4;
        let sum = |residuals: &[f64]| residuals.iter().map(|r| r * r).sum::<f64>();
        let inside = |p: Vector2<f64>| {
            let outer = p.x.clamp(0.5, 1.4 * largest);
            Vector2::new(outer, p.y.clamp(0.0, 0.98 * outer))
        };
        let mut place = inside(Vector2::new(outer, inner));
        let (mut linear, mut residuals) = self.residuals(place.x, place.y)?;
        let mut damping = 1e-3;
        let mut normal = Matrix2::identity();
        for _ in 0..60 {
            let derivative = |step: Vector2<f64>| {
                let (_, moved) = self.residuals(place.x + step.x, place.y + step.y)?;
                let change = moved.iter().zip(&residuals).map(|(m, r)| (m - r) / STEP);
                Some(change.collect::<Vec<f64>>())
            };
            let columns =
                [derivative(Vector2::new(STEP, 0.0))?, derivative(Vector2::new(0.0, STEP))?];
            let dot = |a: &[f64], b: &[f64]| a.iter().zip(b).map(|(a, b)| a * b).sum::<f64>();
            normal = Matrix2::from_fn(|i, j| dot(&columns[i], &columns[j]));
            let right = -Vector2::from_fn(|i, _| dot(&columns[i], &residuals));
            let damped = normal + Matrix2::from_diagonal(&normal.diagonal()) * damping;
            let step = damped.try_inverse().map_or_else(Vector2::zeros, |inverse| inverse * right);
            let next = inside(place + step);
            let (next_linear, next_residuals) = self.residuals(next.x, next.y)?;
            if sum(&next_residuals) < sum(&residuals) {
                let moved = (next - place).norm();
                (place, linear, residuals) = (next, next_linear, next_residuals);
                damping = (damping / 5.0).max(1e-9);
                if moved < SETTLED_PX {
                    break;
                }
            } else {
                damping *= 5.0;
                if damping > 1e6 {
                    break;
                }
            }
        }
        let total = sum(&residuals);
        let freedom = (self.bins.len() as f64 - 4.0).max(1.0);
        let variance = normal.try_inverse().map_or(f64::INFINITY, |inverse| inverse[(0, 0)]);
        (linear.x > 0.0).then_some((
            Discs {
                outer: place.x,
                inner: place.y,
                amplitude: linear.x,
                background: linear.y,
                std_dev: (variance * (total / freedom).max(1.0)).sqrt(),
            },
            total,
        ))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn drawn(outer: f64, inner: f64, amplitude: f64) -> Profile {
        let mut stack = Stack::new(14.0);
        for i in 0..4000_i32 {
            let radius = 14.0 * (f64::from(i) + 0.5) / 4000.0;
            let light = (0.02 + amplitude * seen(radius, outer, inner)).min(1.0);
            for _ in 0..8 {
                stack.add(radius, light);
            }
        }
        stack.profile()
    }

    #[test]
    fn the_outer_radius_comes_back_at_any_exposure() {
        for amplitude in [0.3, 0.8, 1.5, 3.0, 6.0] {
            for (outer, inner) in [(11.66, 1.1), (8.4, 1.7), (6.8, 3.7), (10.0, 0.0)] {
                let discs = drawn(outer, inner, amplitude).fit(12.0).unwrap();
                let off = (discs.outer - outer).abs();
                assert!(off < 0.02, "{outer}, {inner} px at {amplitude}: off by {off} px");
            }
        }
    }
}
