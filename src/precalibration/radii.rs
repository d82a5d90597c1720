//! Radii of the micro-images in the middle of a white image.

use clap::ValueEnum;
use nalgebra::{Matrix2, Vector1, Vector2, Vector5};
use serde::{Deserialize, Serialize};

use super::array::FoundArray;
use super::centroid::{Blob, darkest_neighbourhood, measure_blob, pixels_about};
use super::pattern::Pattern;
use super::profile::{Edge, Profile, RadialHistogram};
use crate::image::Image;
use crate::model::Opening;
use crate::numerics::{NormalEquations, Outliers, Scale, Weight, median};
use crate::optics::{RadialPixels, Seen, WhiteDiscs};

/// Estimator of the radius of a micro-image.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize, ValueEnum)]
#[serde(rename_all = "kebab-case")]
pub enum RadiusEstimator {
    /// Outer radius of two overlapping discs fitted to the light.
    #[default]
    Profile,
    /// Second moments (the paper): 2.357 times the square root of the greater one.
    Moments,
}

/// Radii of one lens type in one white image.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct TypeRadius {
    pub radius_px: f64,
    pub std_dev_px: f64,
    /// Standard deviation of the mean radius due to differences between micro-images, px.
    pub of_lenses_px: f64,
    /// Radii of single micro-images, px.
    pub single_px: Vec<f64>,
    /// Light of the micro-images.
    pub profile: Profile,
}

impl TypeRadius {
    /// Returns the radius for light with the angular response of `discs`. Uses light up to `reach_px` from the centre,
    /// as pixels with a point spread see it, px². Returns the radius unchanged if that light shows no edge.
    pub fn oblique(&self, discs: &WhiteDiscs, reach_px: f64, point_spread_px2: f64) -> Self {
        let mut again = self.clone();
        let largest = REACH * 2.0 * discs.law.half_pitch_px;
        if let Some(edge) =
            self.profile.whole(reach_px).fit(largest, point_spread_px2, discs.opening, Some(discs))
        {
            let change = edge.outer - self.radius_px;
            again.radius_px += change;
            again.std_dev_px = edge.std_dev.hypot(self.of_lenses_px);
            again.single_px.iter_mut().for_each(|radius| *radius += change);
        }
        again
    }
}

/// Number of micro-images of each type on which radii are measured: one of so many in the image, within these limits.
/// The micro-images nearest to the middle are used. They suffice for a hundredth of a pixel in clipped white images,
/// and are not so far out that the main lens vignettes them.
const ONE_OF: usize = 40;
const OF_EACH_TYPE: (usize, usize) = (150, 600);
/// Distance from the centre up to which light counts as the micro-image's own, in pitches.
pub(super) const REACH: f64 = 0.52;
/// Factor α of the paper: 2.357 standard deviations hold 98 % of a normal distribution.
const ALPHA: f64 = 2.357;

/// Returns the nodes in the middle of the image by colour of the lattice, nearest first.
pub(super) fn middle_nodes(
    found: &FoundArray,
    size: (usize, usize),
    colors: usize,
) -> Vec<Vec<(i32, i32)>> {
    let middle = Vector2::new(size.0 as f64, size.1 as f64) / 2.0;
    let distance = |blob: &Blob| (blob.center - middle).norm_squared();
    let mut blobs: Vec<&Blob> = found.blobs.iter().collect();
    blobs.sort_by(|a, b| distance(a).total_cmp(&distance(b)));
    let of_each_type = (blobs.len() / ONE_OF).clamp(OF_EACH_TYPE.0, OF_EACH_TYPE.1);
    let mut nodes = vec![Vec::new(); colors];
    for blob in blobs {
        let (k, l) = found.index(blob.node);
        let of_color = &mut nodes[found.array.grid.lattice.lens_type(k, l, colors)];
        if of_color.len() < of_each_type {
            of_color.push(blob.node);
        }
    }
    nodes
}

/// Measures the radius of the micro-images at some nodes, in light that is clipped at `floor`. Returns `None` if they
/// show no edge.
pub(super) fn radius_at(
    (image, floor): (&Image, f64),
    pattern: &Pattern,
    nodes: &[(i32, i32)],
    estimator: RadiusEstimator,
) -> Option<TypeRadius> {
    let (blobs, profile) = stacked((image, floor), pattern, nodes);
    match estimator {
        RadiusEstimator::Profile => profile_radius(image, pattern, &blobs, profile),
        RadiusEstimator::Moments => moments_radius(image, pattern, &blobs, profile),
    }
}

/// Measures the light of the micro-images at some nodes.
pub(super) fn profile_at(
    (image, floor): (&Image, f64),
    pattern: &Pattern,
    nodes: &[(i32, i32)],
) -> Profile {
    stacked((image, floor), pattern, nodes).1
}

/// Measures the micro-images at some nodes, and their light.
fn stacked(
    (image, floor): (&Image, f64),
    pattern: &Pattern,
    nodes: &[(i32, i32)],
) -> (Vec<Blob>, Profile) {
    let blobs: Vec<Blob> =
        nodes.iter().filter_map(|&node| measure_blob(image, pattern, node)).collect();
    let reach = REACH * pattern.pitch();
    let mut histogram = RadialHistogram::new(reach, floor);
    for blob in &blobs {
        pixels_about(image, &blob.center, reach, |offset, value| {
            histogram.add(offset.norm(), value);
        });
    }
    (blobs, histogram.profile())
}

fn moments_radius(
    image: &Image,
    pattern: &Pattern,
    blobs: &[Blob],
    profile: Profile,
) -> Option<TypeRadius> {
    let single = |blob: &Blob| {
        let background = darkest_neighbourhood(image, &pattern.near(blob.node), &blob.center)?;
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
    Some(TypeRadius { radius_px, std_dev_px, of_lenses_px: std_dev_px, single_px, profile })
}

fn profile_radius(
    image: &Image,
    pattern: &Pattern,
    blobs: &[Blob],
    profile: Profile,
) -> Option<TypeRadius> {
    let reach = REACH * pattern.pitch();
    let edge = profile.fit(reach, 0.0, Opening::Disc, None)?;
    let template = Template::new(&edge, reach);
    let single_px: Vec<f64> =
        blobs.iter().filter_map(|blob| template.single(image, blob)).collect();
    let (_, scatter) = mean_and_scatter(&single_px)?;
    // Micro-images differ by more than the noise of their sum.
    let of_lenses_px = scatter / (single_px.len() as f64).sqrt();
    let std_dev_px = edge.std_dev.hypot(of_lenses_px);
    Some(TypeRadius { radius_px: edge.outer, std_dev_px, of_lenses_px, single_px, profile })
}

/// Outliers among the radii of single micro-images: dust, scratches, faulty micro-lenses.
const OUTLIERS: Outliers =
    Outliers { weight: Weight::Cut, scale: Scale::Median, scales: 6.0, least: 0.0, slack: 1e-9 };

/// Returns mean and standard deviation without outliers; `None` for fewer than two values.
pub(super) fn mean_and_scatter(values: &[f64]) -> Option<(f64, f64)> {
    if values.len() < 2 {
        return None;
    }
    let middle = median(values.iter().copied())?;
    let distances: Vec<f64> = values.iter().map(|v| (v - middle).abs()).collect();
    let limit = OUTLIERS.limit(OUTLIERS.typical(&distances)?);
    let kept: Vec<f64> = values.iter().copied().filter(|v| (v - middle).abs() <= limit).collect();
    let count = kept.len() as f64;
    let mean = kept.iter().sum::<f64>() / count;
    let variance = kept.iter().map(|v| (v - mean).powi(2)).sum::<f64>() / (count - 1.0).max(1.0);
    Some((mean, variance.sqrt()))
}

/// Fitted light and its derivative by the outer radius, for one linear step per micro-image.
struct Template {
    edge: Edge,
    reach: f64,
    shape: Seen,
    by_outer: Seen,
}

impl Template {
    fn new(edge: &Edge, reach: f64) -> Self {
        let (larger, smaller) =
            (f64::midpoint(edge.outer, edge.inner), (edge.outer - edge.inner) / 2.0);
        let discs = WhiteDiscs::plain(larger, smaller);
        let [shape, by_outer] = RadialPixels::new(0.0, reach)
            .see(|t| [discs.light(t), discs.by_radii(t).iter().sum::<f64>() / 2.0]);
        Self { edge: *edge, reach, shape, by_outer }
    }

    /// Fits the outer radius of one micro-image by one step from the fit to all of them.
    fn single(&self, image: &Image, blob: &Blob) -> Option<f64> {
        let mut equations = NormalEquations::<f64, 5, 1>::new();
        pixels_about(image, &blob.center, self.reach, |offset, value| {
            if value >= 1.0 {
                return;
            }
            let r = offset.norm();
            let (shape, slope) = self.shape.with_slope(r);
            let outwards = offset / r.max(1e-9);
            let amplitude = self.edge.amplitude;
            let row = Vector5::new(
                shape,
                1.0,
                -amplitude * slope * outwards.x,
                -amplitude * slope * outwards.y,
                amplitude * self.by_outer.at(r),
            );
            equations.add(&row, &Vector1::new(value), 1.0);
        });
        let solution = equations.solve()?;
        let radius = self.edge.outer + solution[4];
        (radius.is_finite() && radius > 0.0).then_some(radius)
    }
}
