//! Sub-pixel centres of micro-images.

use nalgebra::{Matrix3x2, Vector2, Vector3};
use rayon::prelude::*;

use super::pattern::Pattern;
use crate::image::Image;

/// What was measured of one micro-image.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Blob {
    /// Node of the pattern.
    pub node: (i32, i32),
    /// Intensity centroid, px.
    pub center: Vector2<f64>,
    /// Its standard deviation per axis, px, from what is not symmetric about it.
    pub std_dev: f64,
    /// Mean intensity above the background.
    pub light: f64,
    /// Mean square distance of the light from the centre, px².
    pub spread: f64,
    /// Part of the window that is saturated.
    pub saturated: f64,
}

/// Window of the centroid: 1 up to the first radius, falling to 0 at the second, in pitches. The
/// soft edge keeps pixels from jumping in and out; it reaches as far as neighbours may touch.
const WINDOW: (f64, f64) = (0.40, 0.54);
/// A window that is off by ε has its centroid off by a part of ε; a few rounds end that.
const ROUNDS: usize = 4;
/// Where a round moves a centre by less, px, the next would move it by a small part of that.
const SETTLED_PX: f64 = 0.02;
/// The pattern is followed outwards from where it was found, doubling the distance; this is the
/// first one, in pitches.
const FIRST_REACH: f64 = 8.0;
/// Micro-images that the pattern is fitted to on the way outwards.
const SAMPLE: usize = 400;
/// Micro-images that give the pitch to 10⁻⁶, with a scatter of 0.03 px over a hundred rows.
const LARGE_SAMPLE: usize = 2500;
/// Enough micro-images for an affine fit that stands a few bad ones.
const FEWEST: usize = 7;

/// Measures every micro-image whose window lies in the image, and gives the pattern that fits them
/// all; `None` if the pattern does not go on from where it was found.
pub(super) fn measure(image: &Image, found: &Pattern) -> Option<(Pattern, Vec<Blob>)> {
    let pattern = followed(image, found)?;
    let blobs = measure_nodes(image, &pattern, nodes_in(image, &pattern));
    Some((refit(&pattern, &blobs)?, blobs))
}

/// The pattern fitted to micro-images all over the image, a sample of them at every reach.
fn followed(image: &Image, found: &Pattern) -> Option<Pattern> {
    let mut pattern = *found;
    let start = found.origin;
    let right_bottom = Vector2::new(image.width as f64, image.height as f64);
    let furthest = start.norm().max((right_bottom - start).norm());
    let mut reach = FIRST_REACH * pattern.pitch();
    loop {
        let mut nodes = nodes_in(image, &pattern);
        nodes.retain(|&(i, j)| (pattern.place(i, j) - start).norm() < reach);
        let step = nodes.len().div_ceil(SAMPLE);
        let sample = nodes.into_iter().step_by(step.max(1)).collect();
        pattern = refit(&pattern, &measure_nodes(image, &pattern, sample))?;
        if reach > furthest {
            return Some(pattern);
        }
        reach *= 2.0;
    }
}

/// Measures a sample of micro-images all over an image whose pattern is known, and fits that to them;
/// `None` if it does not show there.
pub(super) fn measure_sample(image: &Image, pattern: &Pattern) -> Option<(Pattern, Vec<Blob>)> {
    let nodes = nodes_in(image, pattern);
    let step = nodes.len().div_ceil(LARGE_SAMPLE).max(1);
    // Every third in a row would be of one lens type.
    let step = if step.is_multiple_of(3) { step + 1 } else { step };
    let blobs = measure_nodes(image, pattern, nodes.into_iter().step_by(step).collect());
    Some((refit(pattern, &blobs)?, blobs))
}

fn measure_nodes(image: &Image, pattern: &Pattern, nodes: Vec<(i32, i32)>) -> Vec<Blob> {
    nodes.into_par_iter().filter_map(|node| measure_blob(image, pattern, node)).collect()
}

/// Nodes in the image.
pub(super) fn nodes_in(image: &Image, pattern: &Pattern) -> Vec<(i32, i32)> {
    let Some(inverse) = pattern.basis().try_inverse() else { return Vec::new() };
    let (right, bottom) = (image.width as f64 - 1.0, image.height as f64 - 1.0);
    let corners = [(0.0, 0.0), (right, 0.0), (0.0, bottom), (right, bottom)]
        .map(|(u, v)| inverse * (Vector2::new(u, v) - pattern.origin));
    let low = corners.iter().fold(corners[0], |a, b| a.inf(b));
    let high = corners.iter().fold(corners[0], |a, b| a.sup(b));
    #[allow(clippy::cast_possible_truncation)] // indices of an image of at most 2³² px
    let range = |low: f64, high: f64| low.floor() as i32..=high.ceil() as i32;
    let inside = |&(i, j): &(i32, i32)| {
        let place = pattern.place(i, j);
        (0.0..=right).contains(&place.x) && (0.0..=bottom).contains(&place.y)
    };
    range(low.y, high.y)
        .flat_map(|j| range(low.x, high.x).map(move |i| (i, j)))
        .filter(inside)
        .collect()
}

/// The affine map from nodes to centres, robustly: those far off lose their weight.
fn refit(pattern: &Pattern, blobs: &[Blob]) -> Option<Pattern> {
    if blobs.len() < FEWEST {
        return None;
    }
    let mut fitted = *pattern;
    for _ in 0..3 {
        let miss = |blob: &Blob| (blob.center - fitted.place(blob.node.0, blob.node.1)).norm();
        let mut misses: Vec<f64> = blobs.iter().map(miss).collect();
        let middle = misses.len() / 2;
        let typical = *misses.select_nth_unstable_by(middle, f64::total_cmp).1;
        let mut normal = nalgebra::Matrix3::zeros();
        let mut right = Matrix3x2::zeros();
        for blob in blobs.iter().filter(|blob| miss(blob) <= 3.0 * typical + SETTLED_PX) {
            let row = Vector3::new(1.0, f64::from(blob.node.0), f64::from(blob.node.1));
            normal += row * row.transpose();
            right += row * blob.center.transpose();
        }
        let solution = normal.cholesky()?.solve(&right);
        let column = |i: usize| Vector2::new(solution[(i, 0)], solution[(i, 1)]);
        fitted = Pattern { origin: column(0), along: column(1), across: column(2), ..fitted };
    }
    Some(fitted)
}

/// Measures one micro-image from where the pattern expects it; `None` if its window leaves the
/// image or holds no light.
pub(super) fn measure_blob(image: &Image, pattern: &Pattern, node: (i32, i32)) -> Option<Blob> {
    let pitch = pattern.pitch();
    let expected = pattern.place(node.0, node.1);
    let background = darkest_neighbourhood(image, pattern, &expected)?;
    let window = Window { image, inner: WINDOW.0 * pitch, outer: WINDOW.1 * pitch, background };
    let mut center = expected;
    for _ in 0..ROUNDS {
        let next = window.centroid(&center)?;
        let step = next - center;
        // Light that leads out of the cell is not of this micro-image.
        if (next - expected).norm() > 0.5 * pitch {
            return None;
        }
        center = next;
        if step.norm() < SETTLED_PX {
            break;
        }
    }
    window.describe(node, center)
}

/// Mean intensity at the places furthest from all micro-images about one, where the least light of
/// any arrives.
pub(super) fn darkest_neighbourhood(
    image: &Image,
    pattern: &Pattern,
    at: &Vector2<f64>,
) -> Option<f64> {
    let (a, b) = (pattern.along, pattern.across);
    let gaps: Vec<Vector2<f64>> = if pattern.kind == crate::lattice::LatticeKind::Orthogonal {
        vec![(a + b) / 2.0, (a - b) / 2.0]
    } else {
        vec![(a + b) / 3.0, (b * 2.0 - a) / 3.0, (b - a * 2.0) / 3.0]
    };
    let around: Vec<f64> = gaps
        .iter()
        .flat_map(|gap| [at + gap, at - gap])
        .filter_map(|p| bilinear(image, &p))
        .collect();
    (!around.is_empty()).then(|| around.iter().sum::<f64>() / around.len() as f64)
}

fn bilinear(image: &Image, p: &Vector2<f64>) -> Option<f64> {
    let (u, v) = (p.x.floor(), p.y.floor());
    let inside =
        u >= 0.0 && v >= 0.0 && u + 1.0 < image.width as f64 && v + 1.0 < image.height as f64;
    if !inside {
        return None;
    }
    let (du, dv) = (p.x - u, p.y - v);
    #[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss)] // inside the image
    let (u, v) = (u as usize, v as usize);
    let at = |u: usize, v: usize| f64::from(image.at(u, v));
    Some(
        (at(u, v) * (1.0 - du) + at(u + 1, v) * du) * (1.0 - dv)
            + (at(u, v + 1) * (1.0 - du) + at(u + 1, v + 1) * du) * dv,
    )
}

/// Values of an image mirrored in a point. The mirrored pixels lie between four pixels, always in
/// the same way.
struct Opposite<'a> {
    image: &'a Image,
    twice: (f64, f64),
    whole: (f64, f64),
}

impl<'a> Opposite<'a> {
    fn new(image: &'a Image, center: &Vector2<f64>) -> Self {
        let twice = (2.0 * center.x, 2.0 * center.y);
        Self { image, twice, whole: (twice.0.floor(), twice.1.floor()) }
    }

    #[inline]
    fn value(&self, u: f64, v: f64) -> f64 {
        let (du, dv) = (self.twice.0 - self.whole.0, self.twice.1 - self.whole.1);
        #[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss)] // inside the image
        let (u, v) = (
            ((self.whole.0 - u).round() as usize).min(self.image.width - 2),
            ((self.whole.1 - v).round() as usize).min(self.image.height - 2),
        );
        let row = &self.image.pixels[v * self.image.width + u..];
        let at = |i: usize| f64::from(row[i]);
        let next = self.image.width;
        (at(0) * (1.0 - du) + at(1) * du) * (1.0 - dv)
            + (at(next) * (1.0 - du) + at(next + 1) * du) * dv
    }
}

struct Window<'a> {
    image: &'a Image,
    inner: f64,
    outer: f64,
    background: f64,
}

impl Window<'_> {
    /// Calls with offset, weight and intensity of every pixel; `None` if some are outside.
    #[inline]
    fn each(&self, center: &Vector2<f64>, mut visit: impl FnMut(f64, f64, f64, f64)) -> Option<()> {
        let image = self.image;
        let (left, right) = (center.x - self.outer, center.x + self.outer);
        let (top, bottom) = (center.y - self.outer, center.y + self.outer);
        let fits = left >= 0.0
            && top >= 0.0
            && right <= image.width as f64 - 1.0
            && bottom <= image.height as f64 - 1.0;
        if !fits {
            return None;
        }
        #[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss)] // inside the image
        let range = |low: f64, high: f64| low.ceil() as usize..high.floor() as usize + 1;
        let (inner2, outer2) = (self.inner * self.inner, self.outer * self.outer);
        let fall = 1.0 / (outer2 - inner2);
        for v in range(top, bottom) {
            let dy = v as f64 - center.y;
            let row = &image.pixels[v * image.width..][..image.width];
            for u in range(left, right) {
                let dx = u as f64 - center.x;
                let r2 = dx * dx + dy * dy;
                if r2 < outer2 {
                    // In r² the fall is smooth enough and needs no root.
                    let weight = ((outer2 - r2) * fall).min(1.0);
                    visit(dx, dy, weight, f64::from(row[u]));
                }
            }
        }
        Some(())
    }

    fn centroid(&self, center: &Vector2<f64>) -> Option<Vector2<f64>> {
        let (mut sum, mut x, mut y) = (0.0, 0.0, 0.0);
        self.each(center, |dx, dy, weight, value| {
            let light = weight * (value - self.background);
            sum += light;
            x += light * dx;
            y += light * dy;
        })?;
        (sum > 0.0).then(|| center + Vector2::new(x, y) / sum)
    }

    fn describe(&self, node: (i32, i32), center: Vector2<f64>) -> Option<Blob> {
        let (mut sum, mut weights, mut saturated, mut count) = (0.0, 0.0, 0.0, 0.0);
        let mut spread = 0.0;
        let mut variance = 0.0;
        let opposite = Opposite::new(self.image, &center);
        self.each(&center, |dx, dy, weight, value| {
            let light = weight * (value - self.background);
            sum += light;
            spread += light * (dx * dx + dy * dy);
            weights += weight;
            count += 1.0;
            saturated += f64::from(u8::from(value >= 1.0));
            // What differs on both sides of the centre is noise or a fault of symmetry. Each pixel
            // is met twice, as one and as the other side.
            let odd = (value - opposite.value(center.x + dx, center.y + dy)) / 2.0;
            variance += (weight * odd).powi(2) * (dx * dx + dy * dy);
        })?;
        // 2 Σ (w x e)² along an axis, here the mean of both axes.
        let std_dev = variance.sqrt() / sum;
        (std_dev.is_finite() && sum > 0.0).then_some(Blob {
            node,
            center,
            std_dev,
            light: sum / weights,
            spread: spread / sum,
            saturated: saturated / count,
        })
    }
}
