//! How far oblique light shifts the centroids of micro-images.
//!
//! Light falls off with its angle of incidence, by cos⁴ and by what the pixels add. Away from the
//! optical axis a micro-image is therefore brighter on one side, and its centroid is shifted in
//! proportion to its distance from the axis: all centres together seem to have another pitch. How far
//! depends on the micro-image. Light that comes through the point M of a micro-lens to the point y beside
//! the micro-image's centre is steeper by (y − M)/d than the ray through the middle, and to first order
//! the centroid is shifted in proportion to
//!
//! ```text
//!     X = ⟨y · (y − M)⟩ / 2,
//! ```
//!
//! the mean over the light that is not clipped: by −g X, g being the gradient of [`FallOff`], whatever its law.
//!
//! [`FallOff`]: crate::model::FallOff

use nalgebra::Vector2;

use crate::vignetting::Obliquity;

/// Number of points that a disc is sampled at.
const POINTS: u32 = 160;
/// Number of rings that the micro-image is divided into.
const RINGS: usize = 48;

/// X (px²) of a micro-image in the middle of the image, the overlap of discs of radius a (pupil) and b
/// (blur), px; `inverted` for f < d. `peak` is the light in its middle over full scale, above 1 where that
/// clips it.
pub(super) fn shift_moment(
    a: f64,
    b: f64,
    obliquity: &Obliquity,
    inverted: bool,
    peak: f64,
) -> f64 {
    let (of_pupil, of_lens) = (disc(a), disc(b));
    // Where the micro-lens inverts, its points have the opposite sign.
    let magnified = obliquity.half_pitch_px / b.max(1e-9) * if inverted { -1.0 } else { 1.0 };
    let mut rings = [(0.0, 0.0); RINGS];
    for pupil in &of_pupil {
        for spread in &of_lens {
            let y = pupil + spread;
            #[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss)] // within a + b
            let ring = ((y.norm() / (a + b)) * RINGS as f64) as usize;
            let ring = &mut rings[ring.min(RINGS - 1)];
            let from_lens = y - spread * magnified;
            let light = obliquity.light(&from_lens, 0.0, 0.0);
            ring.0 += light;
            ring.1 += light * y.dot(&from_lens) / 2.0;
        }
    }
    // Pairs of points over the area of their ring; full light is the smaller disc's share of all pairs.
    let area = |i: usize| (2 * i + 1) as f64 / (RINGS * RINGS) as f64 * (a + b).powi(2);
    let full = f64::from(POINTS).powi(2) / a.max(b).powi(2);
    let (mut light, mut moment) = (0.0, 0.0);
    for (i, (of_ring, sum)) in rings.into_iter().enumerate() {
        let brightness = of_ring / area(i) / full * peak;
        if brightness < 1.0 {
            light += of_ring;
            moment += sum;
        } else {
            light += of_ring / brightness;
        }
    }
    moment / light
}

/// Points spread evenly over a disc, as in the head of a sunflower.
fn disc(radius: f64) -> Vec<Vector2<f64>> {
    let golden = std::f64::consts::PI * (3.0 - 5.0_f64.sqrt());
    (0..POINTS)
        .map(|i| {
            let r = radius * ((f64::from(i) + 0.5) / f64::from(POINTS)).sqrt();
            let (sin, cos) = (golden * f64::from(i)).sin_cos();
            Vector2::new(r * cos, r * sin)
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn lens_of(half_pitch_px: f64) -> Obliquity {
        Obliquity { half_pitch_px, ..Obliquity::default() }
    }

    /// Points of two discs are independent, so X = (a² + b² ∓ b r)/4 without clipping.
    #[test]
    fn moments_without_clipping_have_a_closed_form() {
        for (a, b, lens, inverted) in
            [(6.5, 5.3, 11.6, false), (1.6, 4.4, 11.6, false), (6.5, 3.0, 11.5, true)]
        {
            let side = if inverted { 1.0 } else { -1.0 };
            let expected = (a * a + b * b + side * b * lens) / 4.0;
            let x = shift_moment(a, b, &lens_of(lens), inverted, 0.5);
            assert!((x - expected).abs() < 0.02 * (a * a + b * b), "{x} for {expected}");
        }
    }

    #[test]
    fn clipped_light_shifts_nothing() {
        let x = |peak| shift_moment(6.5, 5.3, &lens_of(11.6), false, peak);
        // The smallest rings hold few pairs, so that some seem clipped early.
        assert!((x(0.3) - x(0.9)).abs() < 0.1);
        // All but the outermost ring is clipped: only its share of the light is left.
        assert!(x(1e6).abs() < 0.2 * x(4.0).abs());
    }
}
