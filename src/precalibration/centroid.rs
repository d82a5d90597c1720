//! Sub-pixel centre of one micro-image: its centroid in a soft window.

// Only what is inlined into the dispatched function is compiled for its registers.
#![allow(clippy::inline_always)]

use nalgebra::Vector2;

use super::pattern::Pattern;
use crate::image::Image;
use crate::model::LatticeKind;

/// Measurement of one micro-image.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Blob {
    /// Node of the pattern.
    pub node: (i32, i32),
    /// Intensity centroid, px.
    pub center: Vector2<f64>,
    /// Standard deviation of the centre per axis, px, from the asymmetry of the light about it.
    pub std_dev: f64,
    /// Mean intensity above the background.
    pub light: f64,
    /// Mean square distance of the light from the centre, px².
    pub spread: f64,
    /// Fraction of the window that is saturated.
    pub saturated: f64,
}

/// Window of the centroid, in pitches: 1 up to the first radius, falling to 0 at the second. The soft edge keeps pixels
/// from jumping in and out; it ends where neighbours may begin.
pub(super) const WINDOW: (f64, f64) = (0.40, 0.54);
/// Rounds of the centroid. If the window is off by ε, the centroid is off by up to ε/10, so a few rounds are enough.
const ROUNDS: usize = 4;
/// Step of a centre, px, below which the rounds end: the next step would be a tenth of it.
pub(super) const SETTLED_PX: f64 = 0.03;
/// Step of the rows in the first round, which only has to come near.
const FIRST_ROWS: usize = 2;
/// Measures one micro-image near the place that the pattern gives. Returns `None` if its window leaves the image or
/// holds no light.
#[inline(always)]
pub(super) fn measure_blob(image: &Image, pattern: &Pattern, node: (i32, i32)) -> Option<Blob> {
    let pattern = pattern.near(node);
    let pitch = pattern.pitch();
    let expected = pattern.place(node.0, node.1);
    let background = darkest_neighbourhood(image, &pattern, &expected)?;
    let window = Window { image, inner: WINDOW.0 * pitch, outer: WINDOW.1 * pitch, background };
    let (mut center, _) = window.centroid(&expected, FIRST_ROWS)?;
    let mut sums = Sums::default();
    for _ in 0..ROUNDS {
        let (next, there) = window.centroid(&center, 1)?;
        sums = there;
        let step = next - center;
        // A centre outside the cell belongs to another micro-image.
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

/// Returns the background: the mean intensity at the places about a micro-image that are furthest from all others.
pub(super) fn darkest_neighbourhood(
    image: &Image,
    pattern: &Pattern,
    at: &Vector2<f64>,
) -> Option<f64> {
    let (a, b) = (pattern.along, pattern.across);
    let gaps: Vec<Vector2<f64>> = if pattern.kind == LatticeKind::Orthogonal {
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

/// Soft round window on an image.
struct Window<'a> {
    image: &'a Image,
    inner: f64,
    outer: f64,
    background: f64,
}

/// Number of pixels that are added up side by side.
const LANES: usize = 8;

/// Sums over a window: light, light times offset, light times squared offset, weights, number of pixels and number of
/// saturated pixels.
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

/// Square of pixels about a window: its first pixel, its numbers of columns and rows, and the offset of the first pixel
/// from the centre.
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
    /// Returns the square about a centre; `None` if it comes within a pixel of the border of the image. Its pixels
    /// outside the window have no weight.
    fn square(&self, center: &Vector2<f64>) -> Option<Square> {
        let (first, last) = (center.map(|x| x - self.outer), center.map(|x| x + self.outer));
        let fits = first.min() >= 1.0
            && last.x <= self.image.width as f64 - 2.0
            && last.y <= self.image.height as f64 - 2.0;
        // For values that are not negative a cast takes the floor, and faster.
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

    /// Returns the reciprocal of the range of r² over which the weight falls. r² needs no root.
    fn fall(&self) -> f32 {
        (1.0 / (self.outer * self.outer - self.inner * self.inner)) as f32
    }

    #[inline(always)]
    fn sums(&self, center: &Vector2<f64>, step: usize) -> Option<Sums> {
        let (outer2, fall) = ((self.outer * self.outer) as f32, self.fall());
        let background = self.background as f32;
        let mut lanes = [[0.0_f32; LANES]; 7];
        let Square { left, top, columns, rows, dx, dy } = self.square(center)?;
        // Chunks are whole; their pixels outside the window have no weight.
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

    /// Returns the standard deviation of the centroid per axis, px, from the difference between both sides: noise or
    /// asymmetry.
    #[inline(always)]
    fn std_dev(&self, center: &Vector2<f64>, light: f64) -> Option<f64> {
        let (outer2, fall) = ((self.outer * self.outer) as f32, self.fall());
        let width = self.image.width;
        let Square { left, top, columns, rows, dx, dy } = self.square(center)?;
        // A pixel mirrored in the centre lies between four pixels, with the same weights for all.
        let (twice_u, twice_v) = (2.0 * center.x, 2.0 * center.y);
        let (whole_u, whole_v) = (twice_u as usize, twice_v as usize);
        let (du, dv) = ((twice_u - whole_u as f64) as f32, (twice_v - whole_v as f64) as f32);
        let first = whole_u + 1 - left - columns;
        let mut lanes = [0.0_f32; LANES];
        let mut odd = vec![0.0_f32; columns.next_multiple_of(LANES)];
        // The other half of the rows mirrors this one.
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
            // The buffer beyond the row has no weight.
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
        // The variance along an axis is 2 Σ (w x e)² over all pixels; here the mean of both axes, from half of the
        // pixels.
        Some((2.0 * variance).sqrt() / light)
    }
}

/// Calls `visit` with the offset and value of every pixel within a radius.
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
