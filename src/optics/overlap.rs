//! The overlap of the main lens's pupil and a micro-lens, seen from a pixel.
//!
//! On the sensor the pupil, seen through the middle of a micro-lens, is a disc, and the micro-lens
//! blurs every point of it over another disc. A pixel sees the pupil through the part of the micro-lens
//! where the two overlap.

/// Common area of two discs at distance r, over the area of the smaller one. `outer` is the sum of
/// their radii, `inner` the difference.
pub(crate) fn overlap_area(r: f64, outer: f64, inner: f64) -> f64 {
    if r <= inner {
        return 1.0;
    }
    if r >= outer {
        return 0.0;
    }
    let (large, small) = (f64::midpoint(outer, inner), (outer - inner) / 2.0);
    let (l2, s2, r2) = (large * large, small * small, r * r);
    let of_large = ((r2 + l2 - s2) / (2.0 * r * large)).clamp(-1.0, 1.0);
    let of_small = ((r2 + s2 - l2) / (2.0 * r * small)).clamp(-1.0, 1.0);
    let kite =
        (-r + large + small) * (r + large - small) * (r - large + small) * (r + large + small);
    let area = s2 * of_small.acos() + l2 * of_large.acos() - 0.5 * kite.max(0.0).sqrt();
    area / (std::f64::consts::PI * s2)
}

/// The part of the unit disc that another disc covers.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Overlap {
    /// Distance of its centroid from the middle of the unit disc, towards the other disc.
    pub mean: f64,
    /// Standard deviations in that direction and across it, over those of the whole disc.
    pub along: f64,
    pub across: f64,
    /// Area.
    pub area: f64,
}

/// Strips that the integrals are summed over.
const STRIPS: u32 = 200;
/// An overlap of less than this fraction of the disc is too small for moments.
const LEAST: f64 = 1e-3;

/// The overlap of the unit disc with a disc of another radius at a distance; `None` if it is
/// negligible.
pub(crate) fn overlap(distance: f64, radius: f64) -> Option<Overlap> {
    let (low, high) = ((-1.0_f64).max(distance - radius), 1.0_f64.min(distance + radius));
    if high <= low {
        return None;
    }
    let width = (high - low) / f64::from(STRIPS);
    let (mut area, mut first, mut second, mut across) = (0.0, 0.0, 0.0, 0.0);
    for i in 0..STRIPS {
        let x = low + (f64::from(i) + 0.5) * width;
        let chord = |radius: f64, x: f64| (radius * radius - x * x).max(0.0).sqrt();
        let half = chord(1.0, x).min(chord(radius, x - distance));
        area += 2.0 * half;
        first += 2.0 * half * x;
        second += 2.0 * half * x * x;
        across += 2.0 * half.powi(3) / 3.0;
    }
    if area * width < LEAST * std::f64::consts::PI {
        return None;
    }
    let mean = first / area;
    // A disc has a standard deviation of half its radius.
    Some(Overlap {
        mean,
        along: 2.0 * (second / area - mean * mean).max(0.0).sqrt(),
        across: 2.0 * (across / area).sqrt(),
        area: area * width,
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    /// By hand: equal discs one radius r apart have the area (2π/3 − √3/2) r² in common.
    #[test]
    fn areas_of_overlaps() {
        let equal = (2.0 * std::f64::consts::PI / 3.0 - 0.75_f64.sqrt()) / std::f64::consts::PI;
        assert!((overlap_area(2.0, 4.0, 0.0) - equal).abs() < 1e-12);
        assert!((overlap_area(0.5, 4.0, 1.0) - 1.0).abs() < 1e-12);
        assert!(overlap_area(4.0, 4.0, 1.0).abs() < 1e-12);
        // The integral over the plane is the area of the larger disc.
        let (outer, inner) = (7.0, 2.0);
        let area: f64 = (0..70_000)
            .map(|i| (f64::from(i) + 0.5) * 1e-4)
            .map(|r| std::f64::consts::TAU * r * overlap_area(r, outer, inner) * 1e-4)
            .sum();
        assert!((area / (std::f64::consts::PI * 4.5 * 4.5) - 1.0).abs() < 1e-6);
    }

    #[test]
    fn moments_of_overlaps() {
        let close = |a: f64, b: f64| (a - b).abs() < 1e-3;
        // The whole micro-lens, the whole pupil, and by hand two half discs: their centroid is
        // 4/3π from the cut.
        let whole = overlap(1.0, 3.0).unwrap();
        assert!(close(whole.mean, 0.0) && close(whole.along, 1.0) && close(whole.across, 1.0));
        let pupil = overlap(0.3, 0.5).unwrap();
        assert!(close(pupil.mean, 0.3) && close(pupil.along, 0.5) && close(pupil.across, 0.5));
        let half = overlap(1000.0, 1000.0).unwrap();
        assert!(close(half.mean, 4.0 / 3.0 / std::f64::consts::PI) && close(half.across, 1.0));
        assert!(overlap(2.0, 0.9).is_none());
    }
}
