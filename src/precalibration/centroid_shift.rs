//! How far oblique light shifts the centroids of micro-images.
//!
//! Light falls off with its angle of incidence, by cos⁴ and by what the pixels add. Away from the
//! optical axis a micro-image is therefore brighter on one side, and its centroid is shifted in
//! proportion to its distance from the axis: all centres together seem to have another pitch. How far
//! depends on the micro-image: its light Ī(r) changes by −g·L Ī, with the lever L(r) of [`Levers::lever`], and
//! a centroid that is off by ε sees its window with −ε Ī′ more light on that side. In a window w(r) the two
//! balance at ε = −g X with
//!
//! ```text
//!     X = Σ w L Ī r² / Σ w (−Ī′) r²
//! ```
//!
//! over the rings of the mean micro-image as the image shows it. Light that is clipped changes nothing, and a
//! window that cuts some of it is taken into account.
//!
//! [`Levers::lever`]: super::levers::Levers::lever

use super::rings::Ring;

/// X (px²) of micro-images with these rings, in a window by distance.
pub(super) fn shift_moment(
    rings: &[Ring],
    window: impl Fn(f64) -> f64,
    lever: impl Fn(f64) -> f64,
) -> f64 {
    let (mut change, mut restoring) = (0.0, 0.0);
    for ring in rings {
        let weight = window(ring.radius) * ring.radius.powi(2);
        if weight > 0.0 {
            change += weight * ring.unclipped * lever(ring.radius);
            restoring -= weight * ring.slope;
        }
    }
    if restoring > 0.0 { change / restoring } else { 0.0 }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Rings of light that falls from full to nothing about `edge`, clipped inside `clipped`.
    fn disc(edge: f64, clipped: f64) -> Vec<Ring> {
        let ring = |i: u32| {
            let radius = (f64::from(i) + 0.5) * 0.25;
            let at = |r: f64| (edge + 1.0 - r).clamp(0.0, 2.0) / 2.0;
            let light = at(radius);
            Ring {
                radius,
                light,
                unclipped: if radius < clipped { 0.0 } else { light },
                slope: (at(radius + 0.01) - at(radius - 0.01)) / 0.02,
                ..Ring::default()
            }
        };
        (0..80).map(ring).collect()
    }

    /// A disc of radius a whose light changes by −g·y has the centroid −g a²/4; here a is 5 to 7, in equal
    /// parts by light of the edge, and ⟨a⁴⟩/4⟨a²⟩ = 1368.2/145.3.
    #[test]
    fn an_open_window_sees_the_whole_moment() {
        let x = shift_moment(&disc(6.0, 0.0), |_| 1.0, |r| r);
        assert!((x - 9.415).abs() < 0.05, "{x}");
    }

    /// In a window that ends inside the light nothing holds the centroid but the fall of the window itself.
    #[test]
    fn a_window_that_cuts_the_light_amplifies_the_shift() {
        let window = |r: f64| ((7.0 - r) / 2.0).clamp(0.0, 1.0);
        let x = shift_moment(&disc(6.0, 0.0), window, |r| r);
        assert!(x > 12.0, "{x}");
    }

    #[test]
    fn clipped_light_shifts_nothing() {
        let open = |_: f64| 1.0;
        let x = |clipped| shift_moment(&disc(6.0, clipped), open, |r| r);
        assert!(x(5.0) < 0.6 * x(0.0), "{} {}", x(5.0), x(0.0));
        assert!(x(8.0).abs() < 1e-12);
    }
}
