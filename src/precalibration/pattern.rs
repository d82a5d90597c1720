//! Search for the pattern of micro-images in an image alone: packing, pitch and orientation.

use std::f64::consts::{FRAC_PI_2, FRAC_PI_3, TAU};
use std::ops::RangeInclusive;

use nalgebra::{Matrix2, Vector2};
use rayon::prelude::*;
use rustfft::FftPlanner;
use rustfft::num_complex::Complex;

use crate::image::{Grey, Image};
use crate::model::{LatticeKind, ROW_DISTANCE};

/// Lattice of micro-images in an image, in perspective: node g = (i, j) is at `origin + g' / (1 − s · g)` for whole i and
/// j, with g' = i · `along` + j · `across` and the perspective s.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Pattern {
    pub kind: LatticeKind,
    /// Position of one micro-image, px.
    pub origin: Vector2<f64>,
    /// Step at the origin to the next micro-image along the straight rows (columns), px.
    pub along: Vector2<f64>,
    /// Step at the origin to a micro-image of the next row (column), px: to the right (down) on a hexagonal lattice.
    pub across: Vector2<f64>,
    /// Perspective s by node; 0 if the pitch is the same everywhere.
    pub perspective: Vector2<f64>,
    /// Fraction of the variance of the image that the repetition explains, from 0 to 1.
    pub explained: f64,
}

impl Pattern {
    /// Returns the position of node (i, j).
    pub fn place(&self, i: i32, j: i32) -> Vector2<f64> {
        self.place_of(&Vector2::new(f64::from(i), f64::from(j)))
    }

    /// Returns the position of a node, or of a point between nodes.
    pub fn place_of(&self, node: &Vector2<f64>) -> Vector2<f64> {
        self.origin + self.basis() * node / (1.0 - self.perspective.dot(node))
    }

    /// Returns the node, or the point between nodes, at a position; `None` beyond the horizon.
    pub fn node_at(&self, place: &Vector2<f64>) -> Option<Vector2<f64>> {
        let regular = self.basis().try_inverse()? * (place - self.origin);
        let nearer = 1.0 + self.perspective.dot(&regular);
        (nearer > 0.0).then(|| regular / nearer)
    }

    /// Returns the lattice without perspective that has the position and the steps of this one at a node.
    pub fn near(&self, (i, j): (i32, i32)) -> Self {
        let node = Vector2::new(f64::from(i), f64::from(j));
        let nearer = 1.0 - self.perspective.dot(&node);
        let regular = self.basis() * node / nearer;
        let basis = (self.basis() + regular * self.perspective.transpose()) / nearer;
        Self {
            origin: self.origin + regular - basis * node,
            along: basis.column(0).into_owned(),
            across: basis.column(1).into_owned(),
            perspective: Vector2::zeros(),
            ..*self
        }
    }

    /// Returns the pattern in a part of the image whose first pixel is at `corner`.
    pub fn seen_from(&self, corner: &Vector2<f64>) -> Self {
        Self { origin: self.origin - corner, ..*self }
    }

    /// Returns the pitch at the origin, px.
    pub fn pitch(&self) -> f64 {
        self.basis().determinant().abs().sqrt() / cell_area(self.kind).sqrt()
    }

    /// Returns the map from lattice positions, in pitches, to px, at the origin.
    pub fn lattice_axes(&self) -> Matrix2<f64> {
        // It is a pitch long, at a right angle to the rows.
        let across_rows = (self.across - self.along / 2.0) / ROW_DISTANCE;
        match self.kind {
            LatticeKind::Orthogonal => self.basis(),
            LatticeKind::HexagonalRows => Matrix2::from_columns(&[self.along, across_rows]),
            LatticeKind::HexagonalColumns => Matrix2::from_columns(&[across_rows, self.along]),
        }
    }

    /// Returns the steps at the origin, as columns.
    pub fn basis(&self) -> Matrix2<f64> {
        Matrix2::from_columns(&[self.along, self.across])
    }

    /// Returns the indices (k, l) of node (i, j), counted from an arbitrary node. On a hexagonal lattice the odd rows
    /// are half a pitch further or, with `later`, the even rows.
    pub fn index(&self, (i, j): (i32, i32), later: bool) -> (i32, i32) {
        let half = (j + i32::from(later)).div_euclid(2);
        match self.kind {
            LatticeKind::Orthogonal => (i, j),
            LatticeKind::HexagonalRows => (i + half, j),
            LatticeKind::HexagonalColumns => (j, i + half),
        }
    }
}

/// Returns the area of a cell at a pitch of 1.
fn cell_area(kind: LatticeKind) -> f64 {
    match kind {
        LatticeKind::Orthogonal => 1.0,
        _ => ROW_DISTANCE,
    }
}

/// Largest edge of the square whose spectrum is used, px. It holds some six micro-images of the largest pitch, and
/// gives the smallest pitch to a hundredth of a pixel.
const LARGEST_CROP: usize = 512;
/// Number of rows that one thread transforms at once.
const ROWS_AT_ONCE: usize = 32;
/// Pitches that can be found in a square, in its pixels.
const IN_CROP: RangeInclusive<f64> = 5.0..=90.0;
/// Smallest pitch that is looked for in a reduced image, in its pixels: smaller ones show in the image itself.
const LEAST_REDUCED: f64 = 40.0;
/// Factors by which the image is reduced, one after the other until a lattice is sure, so that squares hold larger pitches.
const REDUCTIONS: [usize; 3] = [1, 2, 4];
/// Pitches that can be found, px.
pub(super) const PITCHES: RangeInclusive<f64> = 5.0..=360.0;
/// Part of the variance above which a lattice clearly shows.
pub(super) const CLEAR: f64 = 0.1;
/// Least part of the variance that a lattice of many cells explains, if dark holes and uneven light explain the rest.
const LEAST: f64 = 0.03;
/// Least part for few cells, times their number: by chance, a lattice explains some three over the number of its cells.
const BY_CHANCE: f64 = 10.0;
/// Part of the variance above which a lattice is sure. Parts of a lattice of larger pitch explain less than 0.3.
const SURE: f64 = 0.6;
/// Number of frequencies that are used. The strongest ones belong to the lattice, its harmonics and the lens types.
const PEAKS: usize = 16;
/// Tolerance of a regular lattice: for the lengths of its two steps, relative, and for their angle, rad.
const REGULAR: f64 = 0.06;
/// Number of bins of a folded image along each step.
const FOLD: usize = 12;
/// Step of the folded rows. They show enough of a cell if they do not keep step with the rows of the lattice.
const FOLDED_ROWS: f64 = 5.0;
/// Least variance that the lattice of all micro-images explains, relative to the best lattice. Lens types repeat on a
/// lattice of three times the area, which explains more of the image. A finer lattice explains less: 0.6 if
/// micro-images just fill their cells, which leaves the fundamental frequency dark.
const FUNDAMENTAL: f64 = 0.75;

/// Finds the patterns that the part of an image about `middle` may have, the most likely one first. Returns none if nothing
/// repeats on a known lattice.
pub(super) fn find_patterns(image: &Grey, middle: (usize, usize)) -> Vec<Pattern> {
    let mut found: Vec<Pattern> = Vec::new();
    for reduction in REDUCTIONS {
        found.extend(find_reduced(image, middle, reduction));
        if found.last().is_some_and(|found| found.explained >= SURE) {
            break;
        }
    }
    let likely = fundamental(&found);
    found.sort_by_key(|pattern| Some(*pattern) != likely);
    found
}

/// Finds the pattern of the part of a reduced image about `middle`.
fn find_reduced(image: &Grey, middle: (usize, usize), reduction: usize) -> Option<Pattern> {
    let (width, height) = image.size();
    let size = LARGEST_CROP.min(width / reduction).min(height / reduction);
    if size == 0 {
        return None;
    }
    let start = |middle: usize, length: usize| {
        let size = size * reduction;
        middle.saturating_sub(size / 2).min(length.saturating_sub(size))
    };
    let (left, top) = (start(middle.0, width), start(middle.1, height));
    let crop = Crop::new(image, (left, top), size, reduction)?;
    let peaks = crop.frequencies();
    let mut candidates: Vec<Pattern> = Vec::new();
    for (n, first) in peaks.iter().enumerate() {
        for second in &peaks[..n] {
            let Some(candidate) = regular_lattice(first, second) else { continue };
            if reduction > 1 && candidate.pitch() < LEAST_REDUCED {
                continue;
            }
            let known = candidates.iter().any(|c| {
                c.kind == candidate.kind
                    && (c.along - candidate.along).norm() < 0.01 * c.along.norm()
            });
            if !known {
                candidates.push(candidate);
            }
        }
    }
    let candidates: Vec<Pattern> = candidates.par_iter().map(|c| crop.folded(c)).collect();
    let found = fundamental(&candidates)?;
    let cells = (size * size) as f64 / found.basis().determinant().abs();
    let least = (BY_CHANCE / cells).clamp(LEAST, CLEAR);
    (found.explained >= least).then(|| crop.in_image(&found))
}

/// Returns the lattice of all micro-images among those that the image may have.
fn fundamental(candidates: &[Pattern]) -> Option<Pattern> {
    let best = candidates.iter().map(|c| c.explained).fold(0.0, f64::max);
    let explains = candidates.iter().filter(|c| c.explained >= FUNDAMENTAL * best);
    explains.min_by(|a, b| a.pitch().total_cmp(&b.pitch())).copied()
}

/// Square piece of a reduced image, less its mean.
struct Crop {
    left: f64,
    top: f64,
    reduction: f64,
    size: usize,
    values: Vec<f32>,
    variance: f64,
}

impl Crop {
    /// Creates a piece; `None` if all its values are equal.
    #[allow(clippy::cast_possible_truncation)] // intensities need no more than 32 bits
    fn new(
        image: &Grey,
        (left, top): (usize, usize),
        size: usize,
        reduction: usize,
    ) -> Option<Self> {
        let whole = image.part(left, top, size * reduction, size * reduction);
        let mut values = reduced(whole, reduction);
        let count = values.len() as f64;
        let mean = values.iter().map(|&v| f64::from(v)).sum::<f64>() / count;
        for value in &mut values {
            *value -= mean as f32;
        }
        let variance = values.iter().map(|&v| f64::from(v).powi(2)).sum::<f64>() / count;
        (variance > 1e-9).then_some(Self {
            left: left as f64,
            top: top as f64,
            reduction: reduction as f64,
            size,
            values,
            variance,
        })
    }

    /// Returns a pattern of the piece as it is in the image.
    fn in_image(&self, pattern: &Pattern) -> Pattern {
        // The middle of a reduced pixel is the middle of the pixels in it.
        let first = Vector2::new(self.left, self.top).add_scalar((self.reduction - 1.0) / 2.0);
        Pattern {
            origin: pattern.origin * self.reduction + first,
            along: pattern.along * self.reduction,
            across: pattern.across * self.reduction,
            ..*pattern
        }
    }

    /// Returns the strongest frequencies (cycles per px) of a half plane, strongest first.
    fn frequencies(&self) -> Vec<Vector2<f64>> {
        let n = self.size;
        let power = self.spectrum();
        let at = |x: usize, y: usize| f64::from(power[(y % n) * n + x % n]);
        let signed = |f: usize| if f > n / 2 { f as f64 - n as f64 } else { f as f64 };
        let mut peaks = Vec::new();
        for y in 0..n {
            for x in 0..=n / 2 {
                let length = signed(x).hypot(signed(y)) / n as f64;
                // A hexagonal lattice has frequencies of up to 2/√3 over the pitch; the frequencies of its lens types
                // are 1/√3 of these.
                if length < 0.6 / IN_CROP.end() || length > 1.2 / IN_CROP.start() {
                    continue;
                }
                if x == 0 && signed(y) < 0.0 {
                    continue;
                }
                let here = at(x, y);
                let (before, above) = (at(x + n - 1, y), at(x, y + n - 1));
                let (after, below) = (at(x + 1, y), at(x, y + 1));
                if here > before && here >= after && here > above && here >= below {
                    let shift = |low: f64, high: f64| {
                        // The vertex of the parabola through the logarithms.
                        let (low, mid, high) = (low.ln(), here.ln(), high.ln());
                        let bend = low - 2.0 * mid + high;
                        if bend < 0.0 { 0.5 * (low - high) / bend } else { 0.0 }
                    };
                    let place = Vector2::new(
                        signed(x) + shift(before, after),
                        signed(y) + shift(above, below),
                    );
                    peaks.push((here, place / n as f64));
                }
            }
        }
        peaks.sort_by(|a, b| b.0.total_cmp(&a.0));
        peaks.into_iter().take(PEAKS).map(|(_, place)| place).collect()
    }

    /// Computes the power spectrum under a Hann window.
    #[allow(clippy::cast_possible_truncation)] // single precision finds peaks as well
    fn spectrum(&self) -> Vec<f32> {
        let n = self.size;
        let hann = |i: usize| 0.5 - 0.5 * (TAU * (i as f64 + 0.5) / n as f64).cos();
        let window: Vec<f32> = (0..n).map(|i| hann(i) as f32).collect();
        let mut data: Vec<Complex<f32>> = self
            .values
            .iter()
            .enumerate()
            .map(|(i, v)| Complex::new(v * window[i % n] * window[i / n], 0.0))
            .collect();
        let transform = FftPlanner::new().plan_fft_forward(n);
        let process = |rows: &mut [Complex<f32>]| {
            rows.par_chunks_mut(ROWS_AT_ONCE * n).for_each(|rows| transform.process(rows));
        };
        process(&mut data);
        let mut turned = vec![Complex::default(); n * n];
        for (y, row) in data.chunks_exact(n).enumerate() {
            for (x, &value) in row.iter().enumerate() {
                turned[x * n + y] = value;
            }
        }
        process(&mut turned);
        let mut power = vec![0.0; n * n];
        for (x, column) in turned.chunks_exact(n).enumerate() {
            for (y, value) in column.iter().enumerate() {
                power[y * n + x] = value.norm_sqr();
            }
        }
        power
    }

    /// Folds the image into one cell of a candidate. Returns the candidate with the position of its micro-images and
    /// the variance that it explains.
    fn folded(&self, candidate: &Pattern) -> Pattern {
        let Some(to_cell) = candidate.basis().try_inverse() else { return *candidate };
        let mut sums = [[0.0; FOLD]; FOLD];
        let mut counts = [[0.0; FOLD]; FOLD];
        let bin = |part: f64| {
            #[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss)] // from 0 to 1
            let bin = ((part - part.floor()) * FOLD as f64) as usize;
            bin.min(FOLD - 1)
        };
        let mut total = 0.0;
        let golden = f64::midpoint(1.0, 5.0_f64.sqrt());
        let is_folded = |v: usize| (v as f64 * golden).fract() < 1.0 / FOLDED_ROWS;
        let rows = self.values.chunks_exact(self.size).enumerate();
        for (v, row) in rows.filter(|(v, _)| is_folded(*v)) {
            for (u, value) in row.iter().enumerate() {
                let cell = to_cell * Vector2::new(u as f64, v as f64);
                let (x, y) = (bin(cell.x), bin(cell.y));
                sums[y][x] += f64::from(*value);
                counts[y][x] += 1.0;
                total += 1.0;
            }
        }
        let mean = |y: usize, x: usize| {
            sums[y % FOLD][x % FOLD] / f64::max(counts[y % FOLD][x % FOLD], 1.0)
        };
        let bins = (0..FOLD).flat_map(|y| (0..FOLD).map(move |x| (y, x)));
        let explained: f64 =
            bins.clone().map(|(y, x)| mean(y, x).powi(2) * counts[y][x]).sum::<f64>();
        // The first circular moment of the folded cell along each step locates its light.
        let phase = |along: fn(usize, usize) -> usize| {
            let darkest = bins.clone().map(|(y, x)| mean(y, x)).fold(f64::MAX, f64::min);
            let moment: Complex<f64> = bins
                .clone()
                .map(|(y, x)| {
                    let angle = TAU * (along(y, x) as f64 + 0.5) / FOLD as f64;
                    Complex::from_polar(mean(y, x) - darkest, angle)
                })
                .sum();
            moment.arg() / TAU
        };
        let cell = Vector2::new(phase(|_, x| x), phase(|y, _| y));
        // Use the node nearest to the middle of the piece.
        let middle = Vector2::repeat(self.size as f64 / 2.0);
        let steps = (to_cell * middle - cell).map(f64::round);
        Pattern {
            origin: candidate.basis() * (cell + steps),
            explained: explained / total / self.variance,
            ..*candidate
        }
    }
}

/// Returns the means of squares of `reduction` pixels of a square image.
fn reduced(image: Image, reduction: usize) -> Vec<f32> {
    if reduction == 1 {
        return image.pixels;
    }
    #[allow(clippy::cast_precision_loss)] // a few pixels
    let part = 1.0 / (reduction * reduction) as f32;
    let size = image.width / reduction;
    let mut means = vec![0.0; size * size];
    for (v, row) in image.pixels.chunks_exact(image.width).enumerate() {
        for (u, pixels) in row.chunks_exact(reduction).enumerate() {
            means[v / reduction * size + u] += pixels.iter().sum::<f32>() * part;
        }
    }
    means
}

/// Returns the hexagonal or square lattice that has two frequencies, if there is one.
fn regular_lattice(first: &Vector2<f64>, second: &Vector2<f64>) -> Option<Pattern> {
    let frequencies = Matrix2::from_columns(&[*first, *second]);
    of_steps(&frequencies.transpose().try_inverse()?, &IN_CROP)
}

/// Returns the hexagonal or square lattice that two steps (columns, px) span, if they span one with such a pitch. Its
/// origin is (0, 0).
pub(super) fn of_steps(steps: &Matrix2<f64>, pitches: &RangeInclusive<f64>) -> Option<Pattern> {
    // Gauss' reduction gives the two shortest steps.
    let (mut a, mut b) = (steps.column(0).into_owned(), steps.column(1).into_owned());
    loop {
        if a.norm_squared() > b.norm_squared() {
            std::mem::swap(&mut a, &mut b);
        }
        let times = (a.dot(&b) / a.norm_squared()).round();
        let shorter = b - a * times;
        // Steps at exactly 60 degrees keep their lengths.
        let gains = shorter.norm_squared() < b.norm_squared() * (1.0 - 1e-9);
        if !gains {
            break;
        }
        b = shorter;
    }
    if !pitches.contains(&a.norm()) || (b.norm() / a.norm() - 1.0).abs() > REGULAR {
        return None;
    }
    let angle = (a.dot(&b) / (a.norm() * b.norm())).clamp(-1.0, 1.0).acos();
    let sixth = if angle < FRAC_PI_2 { angle } else { std::f64::consts::PI - angle };
    if (sixth - FRAC_PI_3).abs() < REGULAR {
        Some(hexagonal(a, b))
    } else if (sixth - FRAC_PI_2).abs() < REGULAR {
        let along = nearest(&[a, b, -a, -b], &Vector2::x());
        let across = nearest(&[a, b, -a, -b], &Vector2::y());
        Some(pattern(LatticeKind::Orthogonal, along, across))
    } else {
        None
    }
}

fn hexagonal(a: Vector2<f64>, b: Vector2<f64>) -> Pattern {
    let c = if a.dot(&b) > 0.0 { b - a } else { b + a };
    let steps = [a, b, c, -a, -b, -c];
    let (right, down) = (nearest(&steps, &Vector2::x()), nearest(&steps, &Vector2::y()));
    // The straight rows run along u if a step is closer to u than any step is to v.
    if right.normalize().x > down.normalize().y {
        // The next row is half a step to the right.
        let across = nearest(&steps, &Vector2::new(0.5, ROW_DISTANCE));
        pattern(LatticeKind::HexagonalRows, right, across)
    } else {
        let across = nearest(&steps, &Vector2::new(ROW_DISTANCE, 0.5));
        pattern(LatticeKind::HexagonalColumns, down, across)
    }
}

/// Returns the step that points most towards a direction.
fn nearest(steps: &[Vector2<f64>], direction: &Vector2<f64>) -> Vector2<f64> {
    let towards = |step: &Vector2<f64>| step.dot(direction);
    steps
        .iter()
        .copied()
        .max_by(|a, b| towards(a).total_cmp(&towards(b)))
        .unwrap_or_else(Vector2::zeros)
}

fn pattern(kind: LatticeKind, along: Vector2<f64>, across: Vector2<f64>) -> Pattern {
    let (origin, perspective) = (Vector2::zeros(), Vector2::zeros());
    Pattern { kind, origin, along, across, perspective, explained: 0.0 }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::image::{Color, RawImage, Samples};

    /// Spots of 10 px whose rows are whole numbers of pixels apart. Pixels that keep step with them would also show a
    /// lattice of a third of the area.
    #[test]
    fn rows_that_are_whole_pixels_apart_hide_no_darkness() {
        for row_px in [15.0, 20.0, 25.0] {
            let pitch = row_px / ROW_DISTANCE;
            let spot = |n: usize| {
                let (u, v) = ((n % 600) as f64, (n / 600) as f64);
                let row = (v / row_px).round();
                let along = u / pitch - 0.5 * row.rem_euclid(2.0);
                let off = ((along - along.round()) * pitch).hypot(v - row * row_px);
                if off < 5.0 { 200 } else { 5 }
            };
            let samples = Samples::Bits8((0..600 * 600).map(spot).collect());
            let image = RawImage { width: 600, height: 600, color: Color::Grey, samples };
            let found = find_patterns(&image.grey(), (300, 300))[0];
            assert!((found.pitch() - pitch).abs() < 0.02 * pitch, "{} for {pitch}", found.pitch());
            assert_eq!(found.kind, LatticeKind::HexagonalRows);
        }
    }
}
