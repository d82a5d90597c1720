//! Light of micro-images by ring about their centres, and the illumination gradient of each micro-image.
//!
//! A micro-image off the axis is brighter on one side. Its light is the mean light Ī(r) of all micro-images of its
//! type, at the distance r from its centre, times 1 − g·(y − M). The pixel y sees the pupil through the part of the
//! micro-lens about M. An error δ of the centre adds −δ·Ī′ along the radius. The two effects depend on r in different
//! ways, so both are fitted. Therefore g does not depend on the window, the centroid or clipping.
//!
//! A pixel enters only by its ring and its direction. So the pixels of a ring reduce to a few sums, and an image is
//! read once.

use nalgebra::{Matrix3, Matrix6, SMatrix, Vector2, Vector3, Vector6};
use rayon::prelude::*;

use super::centers::part_with;
use super::disc_geometry::DiscLight;
use super::tilt_gradient::Growth;
use crate::image::Grey;

/// Width of the rings, px.
const RING_PX: f64 = 0.25;
/// Fraction of full scale above which samples may be clipped. The mean of a ring with more than the fraction `HOT` of
/// them may be clipped too; fewer are hot pixels.
const CLIPPED: f32 = 0.97;
const HOT: f64 = 0.01;
/// Variance of a pixel without light, relative to the brightest.
const READ_NOISE: f64 = 0.02;
/// Fewest pixels for the six unknowns of a micro-image.
const FEWEST: f64 = 30.0;

/// Sums over the pixels of a ring: their number and light, by direction (x, y) from the centre.
#[derive(Debug, Clone, Copy, Default)]
struct Sums {
    count: f64,
    x: f64,
    y: f64,
    xx: f64,
    xy: f64,
    light: f64,
    light_x: f64,
    light_y: f64,
    square: f64,
    /// Sum of light that is not clipped, and number of pixels that may be clipped.
    unclipped: f64,
    clipped: f64,
}

impl Sums {
    #[inline]
    fn add(&mut self, x: f64, y: f64, value: f32) {
        let light = f64::from(value);
        self.count += 1.0;
        self.x += x;
        self.y += y;
        self.xx += x * x;
        self.xy += x * y;
        self.light += light;
        self.light_x += light * x;
        self.light_y += light * y;
        self.square += light * light;
        if value > CLIPPED {
            self.clipped += 1.0;
        } else {
            self.unclipped += light;
        }
    }

    /// Returns the sums of products of (1, x, y).
    fn directions(&self) -> Matrix3<f64> {
        let yy = self.count - self.xx;
        Matrix3::new(self.count, self.x, self.y, self.x, self.xx, self.xy, self.y, self.xy, yy)
    }
}

/// Micro-image as sums by ring.
#[derive(Debug)]
struct MicroImage {
    center: Vector2<f64>,
    rings: Vec<Sums>,
}

impl MicroImage {
    fn read(image: &Grey, center: Vector2<f64>, reach: f64) -> Self {
        let (part, corner) = part_with(image, std::iter::once(center), reach + 1.0);
        let from = center - corner;
        let mut rings = vec![Sums::default(); count_of(reach)];
        let columns: Vec<f64> = (0..part.width).map(|u| u as f64 - from.x).collect();
        for (v, row) in part.pixels.chunks_exact(part.width.max(1)).enumerate() {
            let y = v as f64 - from.y;
            let rest = reach * reach - y * y;
            for (&x, value) in columns.iter().zip(row).filter(|(x, _)| x.powi(2) <= rest) {
                let r = (x * x + y * y).sqrt();
                #[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss)] // a distance
                let ring = (r / RING_PX) as usize;
                let inverse = 1.0 / r.max(1e-9);
                rings[ring].add(x * inverse, y * inverse, *value);
            }
        }
        Self { center, rings }
    }
}

/// Returns the number of rings up to a distance.
fn count_of(reach: f64) -> usize {
    #[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss)] // a few pixels
    let count = (reach / RING_PX).floor() as usize + 1;
    count
}

/// Ring of the mean micro-image.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct Ring {
    /// Radius of its middle, px.
    pub radius: f64,
    /// Mean light Ī.
    pub light: f64,
    /// Part of Ī that is not clipped.
    pub unclipped: f64,
    /// Slope Ī′, px⁻¹.
    pub slope: f64,
    /// True if nothing is clipped nearby.
    pub whole: bool,
}

/// Illumination gradient of a micro-image.
#[derive(Debug, Clone, Copy)]
pub(super) struct Gradient {
    pub place: Vector2<f64>,
    /// Gradient g, px⁻¹, and one over its variance per axis.
    pub value: Vector2<f64>,
    pub weight: f64,
    /// Relative growth of its discs over the mean of its type.
    pub growth: Growth,
}

/// Micro-images of one lens type in one image.
#[derive(Debug)]
pub(super) struct Alike {
    images: Vec<MicroImage>,
    /// Mean light of these micro-images.
    pub mean: Vec<Ring>,
}

impl Alike {
    /// Reads the light of the micro-images with these centres, up to a distance.
    pub fn read(image: &Grey, centers: &[Vector2<f64>], reach: f64) -> Self {
        let images: Vec<MicroImage> =
            centers.par_iter().map(|center| MicroImage::read(image, *center, reach)).collect();
        let mut sums = vec![(0.0, 0.0, 0.0, 0.0); count_of(reach)];
        for of_image in &images {
            for (sum, ring) in sums.iter_mut().zip(&of_image.rings) {
                sum.0 += ring.count;
                sum.1 += ring.light;
                sum.2 += ring.unclipped;
                sum.3 += ring.clipped;
            }
        }
        let ring = |i: usize| {
            let (before, here, after) = (sums.get(i.checked_sub(1)?)?, sums[i], sums.get(i + 1)?);
            let near = [*before, here, *after];
            let [before, light, after] = near.map(|(count, light, ..)| light / count);
            near.iter().all(|(count, ..)| *count > 0.0).then(|| Ring {
                radius: (i as f64 + 0.5) * RING_PX,
                light,
                unclipped: here.2 / here.0,
                slope: (after - before) / (2.0 * RING_PX),
                whole: near.iter().all(|(count, .., clipped)| *clipped <= HOT * count),
            })
        };
        let mean = (0..sums.len()).map(|i| ring(i).unwrap_or_default()).collect();
        Self { images, mean }
    }

    /// Returns true if light up to a distance is clipped.
    pub fn is_clipped(&self, reach: f64) -> bool {
        self.mean.iter().any(|ring| ring.radius > 0.0 && ring.radius < reach && !ring.whole)
    }

    /// Fits g and the growth of every micro-image that shows them, to its light up to a distance. `discs` are the model
    /// of the light.
    pub fn gradients(&self, reach: f64, discs: &DiscLight) -> Vec<Gradient> {
        let brightest = self.mean.iter().map(|ring| ring.light).fold(0.0, f64::max);
        let within = |ring: &Ring| ring.whole && ring.radius < reach;
        let of_rings: Vec<(&Ring, (f64, f64))> = self
            .mean
            .iter()
            .map(|ring| {
                (ring, if within(ring) { discs.with_growth(ring.radius) } else { (0.0, 0.0) })
            })
            .collect();
        // If the middle is clipped, its light follows from the edge.
        let whole = || of_rings.iter().filter(|(ring, _)| within(ring));
        let products = whole().map(|(ring, (light, _))| ring.light * light).sum::<f64>();
        let squares = whole().map(|(_, (light, _))| light * light).sum::<f64>();
        let middle = products / squares.max(f64::MIN_POSITIVE);
        let design = |(ring, (_, growth)): &(&Ring, (f64, f64))| {
            let sensitivity = -ring.light * discs.sensitivity(ring.radius);
            let slope = -ring.slope;
            let weight = 1.0 / (ring.light + READ_NOISE * brightest);
            let growth = middle * growth;
            // Rows: scale, g, δ and growth. Columns: 1, x and y of a pixel.
            #[rustfmt::skip]
            let columns = SMatrix::<f64, 6, 3>::new(
                ring.light, 0.0, 0.0,
                0.0, sensitivity, 0.0,
                0.0, 0.0, sensitivity,
                0.0, slope, 0.0,
                0.0, 0.0, slope,
                growth, 0.0, 0.0,
            );
            (columns, weight)
        };
        let design: Vec<Option<Design>> =
            of_rings.iter().map(|ring| within(ring.0).then(|| design(ring))).collect();
        self.images.par_iter().filter_map(|image| gradient(image, &design)).collect()
    }
}

/// Derivatives of the light of a ring, and its weight.
type Design = (SMatrix<f64, 6, 3>, f64);

/// Fits g of a micro-image; `None` if too little of its light is usable.
fn gradient(image: &MicroImage, design: &[Option<Design>]) -> Option<Gradient> {
    let (mut normal, mut right) = (Matrix6::<f64>::zeros(), Vector6::<f64>::zeros());
    let (mut squares, mut count) = (0.0, 0.0);
    let usable = design.iter().zip(&image.rings).filter_map(|(d, ring)| Some((d.as_ref()?, ring)));
    for ((columns, weight), ring) in usable {
        let columns_by_weight = columns * *weight;
        normal += columns_by_weight * ring.directions() * columns.transpose();
        right += columns_by_weight * Vector3::new(ring.light, ring.light_x, ring.light_y);
        squares += weight * ring.square;
        count += ring.count;
    }
    if count < FEWEST {
        return None;
    }
    let inverse = normal.cholesky()?.inverse();
    let solution = inverse * right;
    let variance = (squares - right.dot(&solution)) / (count - 6.0);
    let of_axes = variance * f64::midpoint(inverse[(1, 1)], inverse[(2, 2)]);
    let scale = solution[0];
    (scale > 0.0 && of_axes > 0.0).then(|| Gradient {
        place: image.center,
        value: Vector2::new(solution[1], solution[2]) / scale,
        weight: scale * scale / of_axes,
        growth: Growth {
            place: image.center,
            value: solution[5] / scale,
            weight: scale * scale / (variance * inverse[(5, 5)]),
        },
    })
}
