//! Sub-pixel centres of micro-images.

// Only what is inlined into the dispatched function is compiled for its registers.
#![allow(clippy::inline_always)]

use nalgebra::{Matrix3x2, Vector2, Vector3};
use pulp::{Arch, NullaryFnOnce};
use rayon::prelude::*;

use super::pattern::Pattern;
use crate::image::{Grey, Image, bounds};
use crate::numerics::median;

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
/// A window that is off by ε has its centroid off by up to a tenth of ε; a few rounds end that.
const ROUNDS: usize = 4;
/// Where a round moves a centre by less, px, the next would move it by a tenth of that.
const SETTLED_PX: f64 = 0.03;
/// The first round looks at one row in so many: it need only come near.
const FIRST_ROWS: usize = 2;
/// The pattern is followed outwards from where it was found, so many pitches at first, and each time
/// so many times further.
const FIRST_REACH: f64 = 8.0;
const REACH_FACTOR: f64 = 3.0;
/// Micro-images that the pattern is fitted to on the way outwards.
const SAMPLE: usize = 250;
/// Micro-images that give the pitch to 2 · 10⁻⁶, with a scatter of 0.03 px over a hundred rows.
const LARGE_SAMPLE: usize = 800;
/// A window may move by this part of a pitch as it follows the centroid.
const FOLLOWED: f64 = 0.1;
/// The middle of a micro-image, in pitches.
const MIDDLE: f64 = 0.25;
/// Micro-images along the edge of a tile: some 400 px, so that it stays in a core's cache.
const TILE: i32 = 16;
/// Enough micro-images for an affine fit that stands a few bad ones.
const FEWEST: usize = 7;

/// Measures every micro-image whose window lies in the image, and gives the pattern that fits them
/// all; `None` if the pattern does not go on from where it was found.
pub(super) fn measure(image: &Grey, found: &Pattern) -> Option<(Pattern, Vec<Blob>)> {
    let pattern = followed(image, found)?;
    let blobs = measure_all(image, &pattern);
    Some((refit(&pattern, &blobs)?, blobs))
}

/// The pattern fitted to micro-images all over the image, a sample of them at every reach.
fn followed(image: &Grey, found: &Pattern) -> Option<Pattern> {
    let mut pattern = *found;
    let start = found.origin;
    let right_bottom = Vector2::new(image.size().0 as f64, image.size().1 as f64);
    let furthest = start.norm().max((right_bottom - start).norm());
    let mut reach = FIRST_REACH * pattern.pitch();
    loop {
        let mut nodes = nodes_in(image.size(), &pattern);
        nodes.retain(|&(i, j)| (pattern.place(i, j) - start).norm() < reach);
        let step = nodes.len().div_ceil(SAMPLE);
        let sample: Vec<(i32, i32)> = nodes.into_iter().step_by(step.max(1)).collect();
        pattern = refit(&pattern, &measure_some(image, &pattern, &sample))?;
        if reach > furthest {
            return Some(pattern);
        }
        reach *= REACH_FACTOR;
    }
}

/// Measures a sample of some micro-images of an image whose pattern is known, and fits that to them;
/// `None` if it does not show there.
pub(super) fn measure_sample(
    image: &Grey,
    pattern: &Pattern,
    nodes: &[(i32, i32)],
) -> Option<(Pattern, Vec<Blob>)> {
    let step = nodes.len().div_ceil(LARGE_SAMPLE).max(1);
    // Every third in a row would be of one lens type.
    let step = if step.is_multiple_of(3) { step + 1 } else { step };
    let sample: Vec<(i32, i32)> = nodes.iter().copied().step_by(step).collect();
    let blobs = measure_some(image, pattern, &sample);
    Some((refit(pattern, &blobs)?, blobs))
}

/// The part of an image that holds some places and what is `reach` about them, cut at the border of
/// the image, and the place of its first pixel.
pub(super) fn part_with(
    image: &Grey,
    places: impl Iterator<Item = Vector2<f64>>,
    reach: f64,
) -> (Image, Vector2<f64>) {
    let ((left, top, width, height), corner) = bounds(places, reach);
    (image.part(left, top, width, height), corner)
}

/// Calls with the offset and value of all pixels within a radius.
pub(super) fn pixels_about(
    image: &Image,
    center: &Vector2<f64>,
    radius: f64,
    mut visit: impl FnMut(Vector2<f64>, f64),
) {
    #[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss)] // cut to the image
    let range = |center: f64, length: usize| {
        (center - radius).ceil().max(0.0) as usize
            ..((center + radius).floor() + 1.0).max(0.0).min(length as f64) as usize
    };
    for v in range(center.y, image.height) {
        for u in range(center.x, image.width) {
            let offset = Vector2::new(u as f64, v as f64) - center;
            if offset.norm_squared() <= radius * radius {
                visit(offset, f64::from(image.at(u, v)));
            }
        }
    }
}

/// Measures micro-images that are far from each other.
fn measure_some(image: &Grey, pattern: &Pattern, nodes: &[(i32, i32)]) -> Vec<Blob> {
    nodes.par_chunks(1).flat_map_iter(|node| measure_near(image, pattern, node)).collect()
}

/// Measures all micro-images, row by row.
fn measure_all(image: &Grey, pattern: &Pattern) -> Vec<Blob> {
    let mut nodes = nodes_in(image.size(), pattern);
    let tile = |(i, j): (i32, i32)| (j.div_euclid(TILE), i.div_euclid(TILE));
    nodes.sort_by_key(|&node| tile(node));
    let tiles: Vec<&[(i32, i32)]> = nodes.chunk_by(|&a, &b| tile(a) == tile(b)).collect();
    let of_tile = |nodes: &&[(i32, i32)]| measure_near(image, pattern, nodes);
    let mut blobs: Vec<Blob> = tiles.par_iter().flat_map_iter(of_tile).collect();
    blobs.sort_by_key(|blob| (blob.node.1, blob.node.0));
    blobs
}

/// Measures micro-images that are near to each other, in the part of the image that holds them all.
fn measure_near(image: &Grey, pattern: &Pattern, nodes: &[(i32, i32)]) -> Vec<Blob> {
    let places = nodes.iter().map(|&(i, j)| pattern.place(i, j));
    let (part, corner) = part_with(image, places, pattern.pitch());
    let pattern = pattern.seen_from(&corner);
    let mut blobs = Arch::new().dispatch(Near { part: &part, pattern: &pattern, nodes });
    for blob in &mut blobs {
        blob.center += corner;
    }
    blobs
}

/// Work that is dispatched to code for the widest registers that the processor has; what it calls has
/// to be inlined for that.
struct Near<'a> {
    part: &'a Image,
    pattern: &'a Pattern,
    nodes: &'a [(i32, i32)],
}

impl NullaryFnOnce for Near<'_> {
    type Output = Vec<Blob>;

    #[inline(always)]
    fn call(self) -> Vec<Blob> {
        let mut blobs = Vec::with_capacity(self.nodes.len());
        for &node in self.nodes {
            blobs.extend(measure_blob(self.part, self.pattern, node));
        }
        blobs
    }
}

/// Nodes in an image of so many pixels.
pub(super) fn nodes_in((width, height): (usize, usize), pattern: &Pattern) -> Vec<(i32, i32)> {
    let Some(inverse) = pattern.basis().try_inverse() else { return Vec::new() };
    let (right, bottom) = (width as f64 - 1.0, height as f64 - 1.0);
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

/// Whether the border of an image of so many pixels cuts the window of a micro-image.
pub(super) fn is_cut((width, height): (usize, usize), pattern: &Pattern, node: (i32, i32)) -> bool {
    let place = pattern.place(node.0, node.1);
    let to_border =
        place.min().min(width as f64 - 1.0 - place.x).min(height as f64 - 1.0 - place.y);
    to_border < (WINDOW.1 + FOLLOWED) * pattern.pitch() + 1.0
}

/// Mean light of the middle of a micro-image above the background, and the part of it that is
/// saturated, also where the border of the image cuts it.
pub(super) fn middle_light(
    image: &Grey,
    pattern: &Pattern,
    node: (i32, i32),
) -> Option<(f64, f64)> {
    let place = pattern.place(node.0, node.1);
    let (part, corner) = part_with(image, std::iter::once(place), pattern.pitch());
    let place = place - corner;
    let background = darkest_neighbourhood(&part, pattern, &place)?;
    let (mut count, mut light, mut saturated) = (0.0, 0.0, 0.0);
    pixels_about(&part, &place, MIDDLE * pattern.pitch(), |_, value| {
        count += 1.0;
        light += value - background;
        saturated += f64::from(u8::from(value >= 1.0));
    });
    (count > 0.0).then(|| (light / count, saturated / count))
}

/// The affine map from nodes to centres, robustly: those far off lose their weight, and what is dark
/// has little, as noise.
fn refit(pattern: &Pattern, blobs: &[Blob]) -> Option<Pattern> {
    if blobs.len() < FEWEST {
        return None;
    }
    let mut fitted = *pattern;
    for _ in 0..3 {
        let miss = |blob: &Blob| (blob.center - fitted.place(blob.node.0, blob.node.1)).norm();
        let typical = median(blobs.iter().map(miss))?;
        let mut normal = nalgebra::Matrix3::zeros();
        let mut right = Matrix3x2::zeros();
        for blob in blobs.iter().filter(|blob| miss(blob) <= 3.0 * typical + SETTLED_PX) {
            let row = Vector3::new(1.0, f64::from(blob.node.0), f64::from(blob.node.1));
            normal += row * row.transpose() * blob.light;
            right += row * blob.center.transpose() * blob.light;
        }
        let solution = normal.cholesky()?.solve(&right);
        let column = |i: usize| Vector2::new(solution[(i, 0)], solution[(i, 1)]);
        fitted = Pattern { origin: column(0), along: column(1), across: column(2), ..fitted };
    }
    Some(fitted)
}

/// Measures one micro-image from where the pattern expects it; `None` if its window leaves the
/// image or holds no light.
#[inline(always)]
pub(super) fn measure_blob(image: &Image, pattern: &Pattern, node: (i32, i32)) -> Option<Blob> {
    let pitch = pattern.pitch();
    let expected = pattern.place(node.0, node.1);
    let background = darkest_neighbourhood(image, pattern, &expected)?;
    let window = Window { image, inner: WINDOW.0 * pitch, outer: WINDOW.1 * pitch, background };
    let (mut center, _) = window.centroid(&expected, FIRST_ROWS)?;
    let mut sums = Sums::default();
    for _ in 0..ROUNDS {
        let (next, there) = window.centroid(&center, 1)?;
        sums = there;
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
    let std_dev = window.std_dev(&center, sums.light)?;
    std_dev.is_finite().then(|| Blob {
        node,
        center,
        std_dev,
        light: sums.light / sums.weights,
        spread: sums.square / sums.light,
        saturated: sums.saturated / sums.count,
    })
}

/// Mean intensity at the places furthest from all micro-images about one, where the least light of
/// any arrives.
pub(super) fn darkest_neighbourhood(
    image: &Image,
    pattern: &Pattern,
    at: &Vector2<f64>,
) -> Option<f64> {
    let (a, b) = (pattern.along, pattern.across);
    let gaps: Vec<Vector2<f64>> = if pattern.kind == crate::model::LatticeKind::Orthogonal {
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

/// A soft round window on an image.
struct Window<'a> {
    image: &'a Image,
    inner: f64,
    outer: f64,
    background: f64,
}

/// Pixels that are added up side by side.
const LANES: usize = 8;

/// Sums over a window: light, light times offset, light times square offset, weights, pixels and
/// saturated ones.
#[derive(Debug, Clone, Copy, Default)]
struct Sums {
    light: f64,
    x: f64,
    y: f64,
    square: f64,
    weights: f64,
    count: f64,
    saturated: f64,
}

/// The pixels of the square about a window: the first one, how many columns and rows, and where the
/// first is from the centre.
struct Square {
    left: usize,
    top: usize,
    columns: usize,
    rows: usize,
    dx: f32,
    dy: f32,
}

#[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss)] // inside the image; 32 bits do
impl Window<'_> {
    /// The square about a centre; `None` if it comes within a pixel of the border of the image. What
    /// of it is outside the window has no weight.
    fn square(&self, center: &Vector2<f64>) -> Option<Square> {
        let (first, last) = (center.map(|x| x - self.outer), center.map(|x| x + self.outer));
        let fits = first.min() >= 1.0
            && last.x <= self.image.width as f64 - 2.0
            && last.y <= self.image.height as f64 - 2.0;
        // Of what is not below 0 a cast takes the floor, and faster.
        let ceil = |x: f64| x as usize + usize::from(x > x as usize as f64);
        fits.then(|| {
            let (left, top) = (ceil(first.x), ceil(first.y));
            Square {
                left,
                top,
                columns: last.x as usize + 1 - left,
                rows: last.y as usize + 1 - top,
                dx: (left as f64 - center.x) as f32,
                dy: (top as f64 - center.y) as f32,
            }
        })
    }

    /// Reciprocal of the range over which the weight falls, in r²: so it needs no root.
    fn fall(&self) -> f32 {
        (1.0 / (self.outer * self.outer - self.inner * self.inner)) as f32
    }

    #[inline(always)]
    fn sums(&self, center: &Vector2<f64>, step: usize) -> Option<Sums> {
        let (outer2, fall) = ((self.outer * self.outer) as f32, self.fall());
        let background = self.background as f32;
        let mut lanes = [[0.0_f32; LANES]; 7];
        let Square { left, top, columns, rows, dx, dy } = self.square(center)?;
        // Whole chunks; what they hold beyond the window has no weight.
        let columns = columns.next_multiple_of(LANES);
        let first = left.min(self.image.width.saturating_sub(columns));
        let start = dx - (left - first) as f32;
        for row in (0..rows).step_by(step) {
            let pixels =
                self.image.pixels[(top + row) * self.image.width + first..].get(..columns)?;
            let dy = dy + row as f32;
            let left = outer2 - dy * dy;
            for (i, chunk) in pixels.as_chunks::<LANES>().0.iter().enumerate() {
                let start = start + (i * LANES) as f32;
                for lane in 0..LANES {
                    let (dx, value) = (start + lane as f32, chunk[lane]);
                    let weight = ((left - dx * dx) * fall).clamp(0.0, 1.0);
                    let light = weight * (value - background);
                    let inside = f32::from(u8::from(weight > 0.0));
                    lanes[0][lane] += light;
                    lanes[1][lane] += light * dx;
                    lanes[2][lane] += light * dy;
                    lanes[3][lane] += light * (dx * dx + dy * dy);
                    lanes[4][lane] += weight;
                    lanes[5][lane] += inside;
                    lanes[6][lane] += if value >= 1.0 { inside } else { 0.0 };
                }
            }
        }
        let [light, x, y, square, weights, count, saturated] =
            lanes.map(|lanes| lanes.iter().map(|&x| f64::from(x)).sum::<f64>());
        Some(Sums { light, x, y, square, weights, count, saturated })
    }

    #[inline(always)]
    fn centroid(&self, center: &Vector2<f64>, step: usize) -> Option<(Vector2<f64>, Sums)> {
        let sums = self.sums(center, step)?;
        let moved = Vector2::new(sums.x, sums.y) / sums.light;
        (sums.light > 0.0).then_some((center + moved, sums))
    }

    /// Standard deviation of the centroid per axis, px, from what differs on both sides of it: noise,
    /// or a fault of symmetry.
    #[inline(always)]
    fn std_dev(&self, center: &Vector2<f64>, light: f64) -> Option<f64> {
        let (outer2, fall) = ((self.outer * self.outer) as f32, self.fall());
        let width = self.image.width;
        let Square { left, top, columns, rows, dx, dy } = self.square(center)?;
        // A pixel mirrored in the centre lies between four pixels, in the same way for all.
        let (twice_u, twice_v) = (2.0 * center.x, 2.0 * center.y);
        let (whole_u, whole_v) = (twice_u as usize, twice_v as usize);
        let (du, dv) = ((twice_u - whole_u as f64) as f32, (twice_v - whole_v as f64) as f32);
        let first = whole_u + 1 - left - columns;
        let mut lanes = [0.0_f32; LANES];
        let mut odd = vec![0.0_f32; columns.next_multiple_of(LANES)];
        // The other half of the rows is the mirror of this.
        for row in (0..rows).take_while(|&row| dy + (row as f32) < 0.0) {
            let (v, dy) = (top + row, dy + row as f32);
            let pixels = &self.image.pixels[v * width + left..][..columns];
            let opposite = (whole_v - v) * width + first;
            let upper = &self.image.pixels[opposite..][..=columns];
            let lower = &self.image.pixels[opposite + width..][..=columns];
            let left = outer2 - dy * dy;
            let mirrored = upper.windows(2).zip(lower.windows(2)).rev();
            for ((odd, &value), (upper, lower)) in odd.iter_mut().zip(pixels).zip(mirrored) {
                let above = upper[0] * (1.0 - du) + upper[1] * du;
                let below = lower[0] * (1.0 - du) + lower[1] * du;
                *odd = (value - above * (1.0 - dv) - below * dv) * 0.5;
            }
            // What the buffer holds beyond the row has no weight.
            for (i, chunk) in odd.as_chunks::<LANES>().0.iter().enumerate() {
                let start = dx + (i * LANES) as f32;
                for lane in 0..LANES {
                    let dx = start + lane as f32;
                    let weight = ((left - dx * dx) * fall).clamp(0.0, 1.0);
                    lanes[lane] += (weight * chunk[lane]).powi(2) * (dx * dx + dy * dy);
                }
            }
        }
        let variance = lanes.iter().map(|&x| f64::from(x)).sum::<f64>();
        // 2 Σ (w x e)² over all pixels along an axis, here the mean of both axes, from half of them.
        Some((2.0 * variance).sqrt() / light)
    }
}
