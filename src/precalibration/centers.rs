//! Centres of all micro-images of an image, and the pattern that fits them.

// Only what is inlined into the dispatched function is compiled for its registers.
#![allow(clippy::inline_always)]

use nalgebra::{Matrix3x2, SVector, Vector1, Vector2, Vector3};
use pulp::{Arch, NullaryFnOnce};
use rayon::prelude::*;

use super::centroid::{
    Blob, SETTLED_PX, WINDOW, darkest_neighbourhood, measure_blob, pixels_about,
};
use super::grid::SIGNIFICANT;
use super::pattern::Pattern;
use crate::image::{Grey, Image, bounds};
use crate::numerics::{self, NormalEquations, Outliers, Reweighted, Scale, Weight};

/// Distance up to which the pattern is followed at first from where it was found, in pitches, and the factor of each
/// further distance.
const FIRST_REACH: f64 = 8.0;
const REACH_FACTOR: f64 = 3.0;
/// Number of micro-images to which the pattern is fitted on the way outwards.
const SAMPLE: usize = 250;
/// Number of micro-images that gives the pitch to 2 · 10⁻⁶, at a scatter of 0.03 px over a hundred rows.
const LARGE_SAMPLE: usize = 800;
/// Distance by which a window may move as it follows the centroid, in pitches.
const FOLLOWED: f64 = 0.1;
/// Radius of the middle of a micro-image, in pitches.
const MIDDLE: f64 = 0.25;
/// Number of micro-images along the edge of a tile: some 400 px, so that it stays in the cache of a core.
const TILE: i32 = 16;
/// Fewest micro-images for an affine fit that a few outliers do not spoil.
const FEWEST: usize = 7;

/// Measures every micro-image whose window lies in the image, and fits the pattern to them all. Returns `None` if the
/// pattern does not continue from where it was found.
pub(super) fn measure(image: &Grey, found: &Pattern) -> Option<(Pattern, Vec<Blob>)> {
    let pattern = followed(image, found)?;
    let blobs = measure_all(image, &pattern);
    Some((refit(&pattern, &blobs)?, blobs))
}

/// Fits the pattern to micro-images all over the image, to a sample of them at every reach.
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

/// Measures a sample of some micro-images of an image with a known pattern, and fits the pattern to them. Returns
/// `None` if it does not show there.
pub(super) fn measure_sample(
    image: &Grey,
    pattern: &Pattern,
    nodes: &[(i32, i32)],
) -> Option<(Pattern, Vec<Blob>)> {
    let step = nodes.len().div_ceil(LARGE_SAMPLE).max(1);
    // Every third micro-image in a row would be of one lens type.
    let step = if step.is_multiple_of(3) { step + 1 } else { step };
    let sample: Vec<(i32, i32)> = nodes.iter().copied().step_by(step).collect();
    let blobs = measure_some(image, pattern, &sample);
    Some((refit(pattern, &blobs)?, blobs))
}

/// Returns the part of an image up to `reach` about some places, cut at the border of the image, and the position of
/// its first pixel.
pub(super) fn part_with(
    image: &Grey,
    places: impl Iterator<Item = Vector2<f64>>,
    reach: f64,
) -> (Image, Vector2<f64>) {
    let ((left, top, width, height), corner) = bounds(places, reach);
    (image.part(left, top, width, height), corner)
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

/// Measures micro-images that are near to each other, in the part of the image that contains them all.
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

/// Work for the widest registers of the processor. The functions that it calls have to be inlined for this.
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

/// Returns the nodes in an image of this size, px.
pub(super) fn nodes_in((width, height): (usize, usize), pattern: &Pattern) -> Vec<(i32, i32)> {
    let (right, bottom) = (width as f64 - 1.0, height as f64 - 1.0);
    let corners = [(0.0, 0.0), (right, 0.0), (0.0, bottom), (right, bottom)]
        .map(|(u, v)| pattern.node_at(&Vector2::new(u, v)));
    let [Some(a), Some(b), Some(c), Some(d)] = corners else { return Vec::new() };
    let corners = [a, b, c, d];
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

/// Returns true if the border of an image of this size, px, cuts the window of a micro-image.
pub(super) fn is_cut((width, height): (usize, usize), pattern: &Pattern, node: (i32, i32)) -> bool {
    let pattern = pattern.near(node);
    let place = pattern.place(node.0, node.1);
    let to_border =
        place.min().min(width as f64 - 1.0 - place.x).min(height as f64 - 1.0 - place.y);
    to_border < (WINDOW.1 + FOLLOWED) * pattern.pitch() + 1.0
}

/// Returns the mean light of the middle of a micro-image above the background, and the fraction of it that is
/// saturated, even if the border of the image cuts the micro-image.
pub(super) fn middle_light(
    image: &Grey,
    pattern: &Pattern,
    node: (i32, i32),
) -> Option<(f64, f64)> {
    let pattern = pattern.near(node);
    let place = pattern.place(node.0, node.1);
    let (part, corner) = part_with(image, std::iter::once(place), pattern.pitch());
    let place = place - corner;
    let background = darkest_neighbourhood(&part, &pattern, &place)?;
    let (mut count, mut light, mut saturated) = (0.0, 0.0, 0.0);
    pixels_about(&part, &place, MIDDLE * pattern.pitch(), |_, value| {
        count += 1.0;
        light += value - background;
        saturated += f64::from(u8::from(value >= 1.0));
    });
    (count > 0.0).then(|| (light / count, saturated / count))
}

/// Outliers of a pattern. It is fitted to windows that have settled only to [`SETTLED_PX`].
const OUTLIERS: Outliers = Outliers {
    weight: Weight::Cut,
    scale: Scale::Median,
    scales: 3.0,
    least: 0.0,
    slack: SETTLED_PX,
};
/// Rounds of the fit. Outliers of one pattern mostly stay outliers of the next; after three rounds they no longer
/// change.
const FITS: usize = 3;

/// Fits the map from nodes to centres robustly: with perspective if it is significant, otherwise an affine map. Outliers
/// have no weight, and dark micro-images have little, since their centres are noisy.
fn refit(pattern: &Pattern, blobs: &[Blob]) -> Option<Pattern> {
    if blobs.len() < FEWEST {
        return None;
    }
    let fit = |perspective: bool| {
        let start = Projection { pattern: *pattern, deviations: 0.0 };
        let nodes = Nodes { blobs, perspective };
        numerics::fit(&nodes, Some(start), FITS, &OUTLIERS).map(|fitted| fitted.model)
    };
    let projected = fit(true).filter(|fit| fit.deviations > SIGNIFICANT);
    projected.or_else(|| fit(false)).map(|fit| fit.pattern)
}

/// Fitted pattern.
struct Projection {
    pattern: Pattern,
    /// Significance of its perspective, in standard deviations.
    deviations: f64,
}

/// Centres of micro-images by node.
struct Nodes<'a> {
    blobs: &'a [Blob],
    perspective: bool,
}

impl Nodes<'_> {
    fn affine(&self, weights: &[f64], last: &Pattern) -> Option<Projection> {
        let mut equations = NormalEquations::<f64, 3, 2>::new();
        for (blob, weight) in self.blobs.iter().zip(weights) {
            let row = Vector3::new(1.0, f64::from(blob.node.0), f64::from(blob.node.1));
            equations.add(&row, &blob.center.transpose(), blob.light * weight);
        }
        let solution: Matrix3x2<f64> = equations.solve()?;
        let column = |i: usize| solution.row(i).transpose();
        let pattern = Pattern {
            origin: column(0),
            along: column(1),
            across: column(2),
            perspective: Vector2::zeros(),
            ..*last
        };
        Some(Projection { pattern, deviations: 0.0 })
    }

    /// Solves for a pattern in perspective. The equations are linear if the perspective is multiplied by the positions of
    /// the round before.
    fn projected(&self, weights: &[f64], last: &Pattern) -> Option<Projection> {
        let mut equations = NormalEquations::<f64, 8, 1>::new();
        let rows = |blob: &Blob| {
            let (i, j) = (f64::from(blob.node.0), f64::from(blob.node.1));
            let p = last.place(blob.node.0, blob.node.1) - last.origin;
            [
                SVector::from([1.0, 0.0, i, 0.0, j, 0.0, i * p.x, j * p.x]),
                SVector::from([0.0, 1.0, 0.0, i, 0.0, j, i * p.y, j * p.y]),
            ]
        };
        for (blob, weight) in self.blobs.iter().zip(weights).filter(|(_, weight)| **weight > 0.0) {
            for (row, measured) in rows(blob).iter().zip(&blob.center) {
                equations.add(row, &Vector1::new(*measured), blob.light * weight);
            }
        }
        let solution = equations.solve()?;
        let pair = |i: usize| Vector2::new(solution[i], solution[i + 1]);
        let pattern = Pattern {
            origin: pair(0),
            along: pair(2),
            across: pair(4),
            perspective: pair(6),
            ..*last
        };
        let (mut squares, mut count) = (0.0, 0.0);
        for (blob, weight) in self.blobs.iter().zip(weights).filter(|(_, weight)| **weight > 0.0) {
            let off = blob.center - pattern.place(blob.node.0, blob.node.1);
            squares += blob.light * weight * off.norm_squared();
            count += 2.0;
        }
        let variance = squares / (count - 8.0);
        let covariance = equations.normal().cholesky()?.inverse() * variance;
        let of_perspective = covariance.fixed_view::<2, 2>(6, 6).try_inverse()?;
        let deviations = pattern.perspective.dot(&(of_perspective * pattern.perspective)).sqrt();
        Some(Projection { pattern, deviations })
    }
}

impl Reweighted for Nodes<'_> {
    type Model = Projection;

    fn count(&self) -> usize {
        self.blobs.len()
    }

    fn solve(&self, weights: &[f64], last: Option<&Projection>) -> Option<Projection> {
        let last = &last?.pattern;
        if self.perspective { self.projected(weights, last) } else { self.affine(weights, last) }
    }

    fn length(&self, fit: &Projection, datum: usize) -> f64 {
        let blob = &self.blobs[datum];
        (blob.center - fit.pattern.place(blob.node.0, blob.node.1)).norm()
    }
}
