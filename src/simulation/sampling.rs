//! Where the rays of a pixel go: low-discrepancy points over the pixel and a disc.

use sobol_burley::sample;

use super::spread::Footprint;

/// One ray: position from the middle of the pixel (±½ px, and more with a point spread), and in the unit
/// square, which is also mapped onto the unit disc.
#[derive(Debug, Clone, Copy)]
pub(super) struct RayPoint {
    pub pixel: [f64; 2],
    pub square: [f64; 2],
    pub disc: [f64; 2],
}

/// Many differently scrambled sets of points. Every pixel of every micro-lens takes a random one, so
/// that the error of a set becomes noise rather than a pattern.
#[derive(Debug)]
pub(super) struct RaySets {
    sets: Vec<Vec<RayPoint>>,
}

/// Each set comes with all its mirror images, in the axes of the pixel and of the disc, so that the sets have no error in
/// common: with 256 others images were 0.001 px from their place, all alike.
const MIRRORED: u32 = 16;
/// Enough sets that neighbouring pixels rarely share one, and that their second moments, which mirror images share, have little
/// error in common: those of 16 sets of 64 points are 0.4 % too small, and m of `mini` was 0.7 % off.
const SETS: u32 = 256 * MIRRORED;
/// If the sets are long, fewer are enough: each has little error to repeat.
const POINTS: u32 = 1 << 18;
const FEWEST_SETS: u32 = MIRRORED;

impl RaySets {
    /// Sets of `rays` points for pixels with a footprint.
    pub fn new(rays: u32, footprint: &Footprint) -> Self {
        let point = |set: u32, ray: u32| {
            let [x, y, a, b] = [0, 1, 2, 3].map(|d| {
                let part = f64::from(sample(ray, d, set / MIRRORED));
                if set >> d & 1 == 0 { part } else { 1.0 - part }
            });
            RayPoint { pixel: [x, y].map(|p| footprint.place(p)), square: [a, b], disc: disc(a, b) }
        };
        let set = |set: u32| (0..rays).map(|ray| point(set, ray)).collect();
        let sets = (POINTS / rays).clamp(FEWEST_SETS, SETS) / MIRRORED * MIRRORED;
        Self { sets: (0..sets).map(set).collect() }
    }

    /// The set that belongs to a hash.
    #[inline]
    #[allow(clippy::cast_possible_truncation)] // below their number
    pub fn set(&self, hash: u64) -> &[RayPoint] {
        &self.sets[(hash % self.sets.len() as u64) as usize]
    }
}

/// Area-preserving map of the unit square onto the unit disc (Shirley and Chiu's concentric map);
/// neighbours stay neighbours.
fn disc(a: f64, b: f64) -> [f64; 2] {
    let (x, y) = (2.0 * a - 1.0, 2.0 * b - 1.0);
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

/// A well-mixed number from several (the finaliser of SplitMix64, chained).
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
            let sets = RaySets::new(rays, &Footprint::new(point_spread_px)).sets;
            let points = || sets.iter().flatten();
            let mean = |of: &dyn Fn(&RayPoint) -> f64| {
                points().map(of).sum::<f64>() / points().count() as f64
            };
            for i in 0..2 {
                assert!(mean(&|p| p.pixel[i]).abs() < 1e-9 && mean(&|p| p.disc[i]).abs() < 1e-9);
                for j in 0..2 {
                    assert!(mean(&|p| p.pixel[i] * p.disc[j]).abs() < 1e-9);
                }
            }
            let square = mean(&|p| p.disc[0].powi(2) + p.disc[1].powi(2));
            assert!((square - 0.5).abs() < limit, "{square} with {rays} rays");
        }
    }

    #[test]
    fn points_fill_pixel_and_disc_evenly() {
        let sets = RaySets::new(64, &Footprint::new(0.0));
        for hash in 0..u64::from(SETS) {
            let points = sets.set(hash);
            let n = points.len() as f64;
            let mean = |f: fn(&RayPoint) -> f64| points.iter().map(f).sum::<f64>() / n;
            // 64 stratified points have a mean within a sixteenth of their range.
            assert!(mean(|p| p.pixel[0]).abs() < 0.03 && mean(|p| p.pixel[1]).abs() < 0.03);
            assert!(mean(|p| p.disc[0]).abs() < 0.06 && mean(|p| p.disc[1]).abs() < 0.06);
            let second = mean(|p| p.disc[0].powi(2) + p.disc[1].powi(2));
            assert!((second - 0.5).abs() < 0.03, "a uniform disc has <r²> = 1/2, not {second}");
            assert!(points.iter().all(|p| p.disc[0].hypot(p.disc[1]) <= 1.0 + 1e-12));
        }
    }
}
