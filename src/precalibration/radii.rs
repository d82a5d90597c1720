//! Radii of the micro-images in the middle of a white image.

use nalgebra::{Matrix2, Matrix5, Vector2, Vector5};
use serde::{Deserialize, Serialize};

use super::array::FoundArray;
use super::centers::{Blob, darkest_neighbourhood, measure_blob, pixels_about};
use super::pattern::Pattern;
use super::profile::{Discs, Profile, Stack, seen};
use crate::image::Image;
use crate::numerics::median;
use crate::vignetting::Obliquity;

/// How the radius of a micro-image is measured.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum RadiusEstimator {
    /// The outer edge of two overlapping discs fitted to the light, clipped or not.
    #[default]
    Profile,
    /// The paper's: 2.357 times the square root of the greater second central moment.
    Moments,
}

/// Radii of one lens type in one white image.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct TypeRadius {
    pub radius_px: f64,
    pub std_dev_px: f64,
    /// Of single micro-images.
    pub single_px: Vec<f64>,
    /// Their light.
    pub profile: Profile,
}

impl TypeRadius {
    /// The radius where light comes obliquely, see [`Profile::oblique`]; as it was if that shows no edge.
    pub fn seen_obliquely(&self, pupil_px: f64, q_px: f64, obliquity: &Obliquity) -> Self {
        let mut again = self.clone();
        let largest = REACH * 2.0 * obliquity.lens_px;
        if let Some(discs) = self.profile.oblique(pupil_px, q_px, obliquity).fit(largest) {
            let change = discs.outer - self.radius_px;
            again.radius_px += change;
            again.single_px.iter_mut().for_each(|radius| *radius += change);
        }
        again
    }
}

/// Micro-images of each type that are looked at, those nearest the middle of the image: enough for a
/// hundredth of a pixel, and not so far out that vignetting cuts them.
const OF_EACH_TYPE: usize = 150;
/// How far from the middle light is taken for a micro-image's own, in pitches.
pub(super) const REACH: f64 = 0.52;
/// α of the paper: 98 % of a normal distribution.
const ALPHA: f64 = 2.357;

/// Nodes in the middle of the image by colour, nearest first.
pub(super) fn middle_nodes(
    found: &FoundArray,
    size: (usize, usize),
    colors: usize,
) -> Vec<Vec<(i32, i32)>> {
    let middle = Vector2::new(size.0 as f64, size.1 as f64) / 2.0;
    let distance = |blob: &Blob| (blob.center - middle).norm_squared();
    let mut blobs: Vec<&Blob> = found.blobs.iter().collect();
    blobs.sort_by(|a, b| distance(a).total_cmp(&distance(b)));
    let mut nodes = vec![Vec::new(); colors];
    for blob in blobs {
        let (k, l) = found.index(blob.node);
        let of_color = &mut nodes[found.array.grid.lattice.lens_type(k, l, colors)];
        if of_color.len() < OF_EACH_TYPE {
            of_color.push(blob.node);
        }
    }
    nodes
}

/// The radius of the micro-images at some nodes; `None` if they show no edge.
pub(super) fn radius_at(
    image: &Image,
    pattern: &Pattern,
    nodes: &[(i32, i32)],
    estimator: RadiusEstimator,
) -> Option<TypeRadius> {
    let (blobs, profile) = stacked(image, pattern, nodes);
    match estimator {
        RadiusEstimator::Profile => profile_radius(image, pattern, &blobs, profile),
        RadiusEstimator::Moments => moments_radius(image, pattern, &blobs, profile),
    }
}

/// The light of the micro-images at some nodes.
pub(super) fn profile_at(image: &Image, pattern: &Pattern, nodes: &[(i32, i32)]) -> Profile {
    stacked(image, pattern, nodes).1
}

/// The micro-images at some nodes, and their light.
fn stacked(image: &Image, pattern: &Pattern, nodes: &[(i32, i32)]) -> (Vec<Blob>, Profile) {
    let blobs: Vec<Blob> =
        nodes.iter().filter_map(|&node| measure_blob(image, pattern, node)).collect();
    let reach = REACH * pattern.pitch();
    let mut stack = Stack::new(reach);
    for blob in &blobs {
        pixels_about(image, &blob.center, reach, |offset, value| stack.add(offset.norm(), value));
    }
    (blobs, stack.profile())
}

fn moments_radius(
    image: &Image,
    pattern: &Pattern,
    blobs: &[Blob],
    profile: Profile,
) -> Option<TypeRadius> {
    let single = |blob: &Blob| {
        let background = darkest_neighbourhood(image, pattern, &blob.center)?;
        let (mut sum, mut first, mut second) = (0.0, Vector2::zeros(), Matrix2::zeros());
        pixels_about(image, &blob.center, pattern.pitch() / 2.0, |offset, value| {
            let light = value - background;
            sum += light;
            first += offset * light;
            second += offset * offset.transpose() * light;
        });
        let mean = first / sum;
        let moments = second / sum - mean * mean.transpose();
        let greater = moments.symmetric_eigenvalues().max();
        (greater > 0.0).then(|| ALPHA * greater.sqrt())
    };
    let single_px: Vec<f64> = blobs.iter().filter_map(single).collect();
    let (radius_px, scatter) = mean_and_scatter(&single_px)?;
    let std_dev_px = scatter / (single_px.len() as f64).sqrt();
    Some(TypeRadius { radius_px, std_dev_px, single_px, profile })
}

fn profile_radius(
    image: &Image,
    pattern: &Pattern,
    blobs: &[Blob],
    profile: Profile,
) -> Option<TypeRadius> {
    let reach = REACH * pattern.pitch();
    let discs = profile.fit(reach)?;
    let template = Template::new(&discs, reach);
    let single_px: Vec<f64> =
        blobs.iter().filter_map(|blob| template.single(image, blob)).collect();
    let (_, scatter) = mean_and_scatter(&single_px)?;
    // What single micro-images differ by is more than what the stack tells of itself.
    let std_dev_px = discs.std_dev.hypot(scatter / (single_px.len() as f64).sqrt());
    Some(TypeRadius { radius_px: discs.outer, std_dev_px, single_px, profile })
}

/// Values further from the median than this many times the median distance are not of the rest.
const OUTLYING: f64 = 6.0;

/// Mean and standard deviation, outlying values left out.
fn mean_and_scatter(values: &[f64]) -> Option<(f64, f64)> {
    if values.len() < 2 {
        return None;
    }
    let middle = median(values.iter().copied())?;
    let usual = median(values.iter().map(|v| (v - middle).abs()))?;
    let kept: Vec<f64> =
        values.iter().copied().filter(|v| (v - middle).abs() <= OUTLYING * usual + 1e-9).collect();
    let count = kept.len() as f64;
    let mean = kept.iter().sum::<f64>() / count;
    let variance = kept.iter().map(|v| (v - mean).powi(2)).sum::<f64>() / (count - 1.0).max(1.0);
    Some((mean, variance.sqrt()))
}

/// The fitted light and its derivatives by distance, for one linear step per micro-image.
struct Template {
    discs: Discs,
    reach: f64,
    shape: Vec<f64>,
    by_outer: Vec<f64>,
}

/// Resolution of the template, px.
const TEMPLATE_PX: f64 = 0.05;

impl Template {
    fn new(discs: &Discs, reach: f64) -> Self {
        const STEP: f64 = 0.02;
        #[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss)] // a few pixels
        let count = (reach / TEMPLATE_PX) as usize + 3;
        let place = |i: usize| i as f64 * TEMPLATE_PX;
        let shape = |outer: f64, r: f64| seen(r, outer, discs.inner);
        Self {
            discs: *discs,
            reach,
            shape: (0..count).map(|i| shape(discs.outer, place(i))).collect(),
            by_outer: (0..count)
                .map(|i| {
                    let (more, less) = (discs.outer + STEP, discs.outer - STEP);
                    (shape(more, place(i)) - shape(less, place(i))) / (2.0 * STEP)
                })
                .collect(),
        }
    }

    /// Outer radius of one micro-image, from where light and place of all of them are near.
    fn single(&self, image: &Image, blob: &Blob) -> Option<f64> {
        let (mut normal, mut right) = (Matrix5::zeros(), Vector5::zeros());
        pixels_about(image, &blob.center, self.reach, |offset, value| {
            if value >= 1.0 {
                return;
            }
            let r = offset.norm();
            #[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss)] // within reach
            let i = (r / TEMPLATE_PX) as usize;
            let part = r / TEMPLATE_PX - i as f64;
            let at = |table: &[f64]| table[i] * (1.0 - part) + table[i + 1] * part;
            let slope = (self.shape[i + 1] - self.shape[i]) / TEMPLATE_PX;
            let outwards = offset / r.max(1e-9);
            let amplitude = self.discs.amplitude;
            let row = Vector5::new(
                at(&self.shape),
                1.0,
                -amplitude * slope * outwards.x,
                -amplitude * slope * outwards.y,
                amplitude * at(&self.by_outer),
            );
            // The lower triangle is all that is read.
            for i in 0..5 {
                for j in 0..=i {
                    normal[(i, j)] += row[i] * row[j];
                }
            }
            right += row * value;
        });
        let solution = normal.cholesky()?.solve(&right);
        let radius = self.discs.outer + solution[4];
        (radius.is_finite() && radius > 0.0).then_some(radius)
    }
}
