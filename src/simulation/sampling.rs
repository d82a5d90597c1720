//! The rays of a pixel: low-discrepancy points over the pixel and a disc.

use nalgebra::Vector2;
use sobol_burley::sample;

use super::spread::Footprint;
use crate::model::Opening;

/// Number of rays that are traced side by side.
pub(super) const BLOCK: usize = 32;

/// A block of rays: positions from the middle of the pixel (±½ px, and more with a point spread), and in the
/// square from −1 to 1, which is also mapped onto the unit disc.
#[derive(Debug)]
struct PointBlock {
    pixel: [[f64; BLOCK]; 2],
    square: [[f64; BLOCK]; 2],
    disc: [[f64; BLOCK]; 2],
    /// Positions in the opening of a micro-lens, in units of the radius of the circle about it.
    opening: [[f64; BLOCK]; 2],
    /// Weights of the rays: 1, or 0 beyond the last ray of the set.
    share: [f64; BLOCK],
}

/// The rays of a block, or their mirror images.
#[derive(Debug, Clone, Copy)]
pub(super) struct Points<'a> {
    block: &'a PointBlock,
    /// Signs of the axes of the pixel and of the disc.
    signs: [f64; 4],
}

#[allow(clippy::inline_always)] // compiled for the registers of loops over rays
impl Points<'_> {
    /// Returns the position of ray `i` in the pixel.
    #[inline(always)]
    pub fn pixel(&self, i: usize) -> [f64; 2] {
        let ([x, y], [sign_x, sign_y, ..]) = (&self.block.pixel, self.signs);
        [x[i] * sign_x, y[i] * sign_y]
    }

    /// Returns the position of ray `i` in the square.
    #[inline(always)]
    pub fn square(&self, i: usize) -> Vector2<f64> {
        let ([x, y], [.., sign_x, sign_y]) = (&self.block.square, self.signs);
        Vector2::new(x[i] * sign_x, y[i] * sign_y)
    }

    /// Returns the position of ray `i` on the disc.
    #[inline(always)]
    pub fn disc(&self, i: usize) -> Vector2<f64> {
        let ([x, y], [.., sign_x, sign_y]) = (&self.block.disc, self.signs);
        Vector2::new(x[i] * sign_x, y[i] * sign_y)
    }

    /// Returns the position of ray `i` in the opening of the micro-lens.
    #[inline(always)]
    pub fn opening(&self, i: usize) -> Vector2<f64> {
        let ([x, y], [.., sign_x, sign_y]) = (&self.block.opening, self.signs);
        Vector2::new(x[i] * sign_x, y[i] * sign_y)
    }

    /// Returns the weights of the rays: 1, or 0 beyond the last ray of the set.
    #[inline(always)]
    pub fn share(&self) -> &[f64; BLOCK] {
        &self.block.share
    }
}

/// Many differently scrambled sets of points. Every pixel of every micro-lens takes a random set, so that the error of a set
/// becomes noise rather than a pattern.
#[derive(Debug)]
pub(super) struct RaySets {
    rays: usize,
    sets: Vec<Vec<PointBlock>>,
}

/// One of the sets, or its mirror image.
#[derive(Debug, Clone, Copy)]
pub(super) struct RaySet<'a> {
    rays: usize,
    blocks: &'a [PointBlock],
    /// Signs of the axes of the pixel and of the disc.
    signs: [f64; 4],
}

/// Number of mirror images of each set, in the axes of the pixel and of the disc. With all of them, the sets have no common
/// error. With 256 independent sets instead, images would be displaced by 0.001 px, all alike.
const MIRRORED: u64 = 16;
/// Largest number of sets. Neighbouring pixels then rarely share one, and the second moments of the sets, which mirror images
/// share, have little common error: with 16 sets of 64 points they are 0.4 % too small, and m of `mini` is 0.7 % off.
const SETS: u32 = 256;
/// Largest number of points in all sets. Long sets have little error to repeat, so fewer are enough.
const POINTS: u32 = 1 << 14;

impl RaySets {
    /// Creates sets of `rays` points for pixels with a footprint.
    pub fn new(rays: u32, footprint: &Footprint) -> Self {
        let block = |set: u32, first: u32| {
            let none = [[0.0; BLOCK]; 2];
            let mut block = PointBlock {
                pixel: none,
                square: none,
                disc: none,
                opening: none,
                share: [0.0; BLOCK],
            };
            for (i, ray) in (first..rays).take(BLOCK).enumerate() {
                let part = |d: u32| f64::from(sample(ray, d, set));
                let (a, b) = (2.0 * part(2) - 1.0, 2.0 * part(3) - 1.0);
                let [x, y] = disc(a, b);
                for (axis, dimension) in (0..2).zip(0..) {
                    block.pixel[axis][i] = footprint.place(part(dimension));
                    block.square[axis][i] = [a, b][axis];
                    block.disc[axis][i] = [x, y][axis];
                    block.opening[axis][i] = [x, y][axis];
                }
                block.share[i] = 1.0;
            }
            block
        };
        let set = |set: u32| (0..rays).step_by(BLOCK).map(|first| block(set, first)).collect();
        let sets = (POINTS / rays).clamp(1, SETS);
        Self { rays: rays as usize, sets: (0..sets).map(set).collect() }
    }

    /// Takes micro-lenses with this opening, with the direction of the normal of one of its sides, rad: along an axis.
    pub fn through(mut self, opening: Opening, normal_rad: f64) -> Self {
        for block in self.sets.iter_mut().flatten() {
            for i in 0..BLOCK {
                let disc = Vector2::new(block.disc[0][i], block.disc[1][i]);
                let place = opening.of_disc(&disc, normal_rad) / opening.reach();
                (block.opening[0][i], block.opening[1][i]) = (place.x, place.y);
            }
        }
        self
    }

    /// Returns the set that belongs to a hash.
    #[inline]
    #[allow(clippy::cast_possible_truncation)] // below their number
    pub fn set(&self, hash: u64) -> RaySet<'_> {
        let index = hash % (MIRRORED * self.sets.len() as u64);
        let (set, mirror) = (index / MIRRORED, index % MIRRORED);
        let sign = |axis: u64| if mirror >> axis & 1 == 0 { 1.0 } else { -1.0 };
        RaySet {
            rays: self.rays,
            blocks: &self.sets[set as usize],
            signs: [sign(0), sign(1), sign(2), sign(3)],
        }
    }
}

impl RaySet<'_> {
    /// Returns the number of rays.
    pub fn rays(&self) -> usize {
        self.rays
    }

    /// Returns the number of blocks.
    pub fn blocks(&self) -> usize {
        self.blocks.len()
    }

    /// Returns a block of rays.
    #[inline(always)]
    #[allow(clippy::inline_always)] // compiled for the registers of loops over rays
    pub fn block(&self, index: usize) -> Points<'_> {
        Points { block: &self.blocks[index], signs: self.signs }
    }

    /// Returns all rays: their positions in the pixel and on the disc.
    #[cfg(test)]
    pub fn points(&self) -> Vec<([f64; 2], [f64; 2])> {
        let of = |index: usize| {
            let points = self.block(index);
            (0..BLOCK)
                .filter(move |&i| points.share()[i] > 0.0)
                .map(move |i| (points.pixel(i), points.disc(i).into()))
        };
        (0..self.blocks()).flat_map(of).collect()
    }
}

/// Maps the square from −1 to 1 onto the unit disc. The map preserves areas (Shirley and Chiu's concentric map) and keeps
/// neighbours together.
fn disc(x: f64, y: f64) -> [f64; 2] {
    let eighth = std::f64::consts::FRAC_PI_4;
    let (radius, angle) = if x.abs() > y.abs() {
        (x, eighth * y / x)
    } else if y == 0.0 {
        (0.0, 0.0)
    } else {
        (y, 2.0 * eighth - eighth * x / y)
    };
    [radius * angle.cos(), radius * angle.sin()]
}

/// Mixes several numbers into one (the finaliser of SplitMix64, chained).
#[inline]
pub(super) fn hash(values: [u64; 4]) -> u64 {
    values.iter().fold(0x9e37_79b9_7f4a_7c15, |state, &value| {
        let mut z = state.wrapping_add(value).wrapping_mul(0x9e37_79b9_7f4a_7c15);
        z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        z ^ (z >> 31)
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sets_have_no_error_in_common() {
        for (rays, point_spread_px, limit) in [(16, 0.0, 2e-3), (64, 0.5, 5e-4), (3000, 0.0, 5e-4)]
        {
            let sets = RaySets::new(rays, &Footprint::new(point_spread_px));
            let all: Vec<_> = (0..MIRRORED * sets.sets.len() as u64)
                .flat_map(|hash| sets.set(hash).points())
                .collect();
            let mean = |of: &dyn Fn([f64; 2], [f64; 2]) -> f64| {
                all.iter().map(|&(pixel, disc)| of(pixel, disc)).sum::<f64>() / all.len() as f64
            };
            for i in 0..2 {
                assert!(mean(&|p, _| p[i]).abs() < 1e-9 && mean(&|_, d| d[i]).abs() < 1e-9);
                for j in 0..2 {
                    assert!(mean(&|p, d| p[i] * d[j]).abs() < 1e-9);
                }
            }
            let square = mean(&|_, d| d[0].powi(2) + d[1].powi(2));
            assert!((square - 0.5).abs() < limit, "{square} with {rays} rays");
        }
    }

    #[test]
    fn points_fill_pixel_and_disc_evenly() {
        let sets = RaySets::new(64, &Footprint::new(0.0));
        for hash in 0..MIRRORED * u64::from(SETS) {
            let points = sets.set(hash).points();
            let n = points.len() as f64;
            let mean = |of: &dyn Fn([f64; 2], [f64; 2]) -> f64| {
                points.iter().map(|&(pixel, disc)| of(pixel, disc)).sum::<f64>() / n
            };
            // 64 stratified points have a mean within a sixteenth of their range.
            assert!(mean(&|p, _| p[0]).abs() < 0.03 && mean(&|p, _| p[1]).abs() < 0.03);
            assert!(mean(&|_, d| d[0]).abs() < 0.06 && mean(&|_, d| d[1]).abs() < 0.06);
            let second = mean(&|_, d| d[0].powi(2) + d[1].powi(2));
            assert!((second - 0.5).abs() < 0.03, "a uniform disc has <r²> = 1/2, not {second}");
            assert!(points.iter().all(|(_, d)| d[0].hypot(d[1]) <= 1.0 + 1e-12));
        }
    }

    /// A set may have any number of rays, also one that does not fill a block.
    #[test]
    fn a_block_may_have_fewer_rays() {
        for rays in [1, 8, 13] {
            let sets = RaySets::new(rays, &Footprint::new(0.0));
            let set = sets.set(77);
            assert_eq!((set.points().len(), set.rays()), (rays as usize, rays as usize));
        }
    }
}
