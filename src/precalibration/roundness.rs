//! Check whether the pupil of the main lens is round all over the image.
//!
//! A micro-image is an image of the pupil. If a second stop or the barrel cuts oblique light, the pupil is the overlap
//! of two discs, a cat's eye. Micro-images are then narrower along the direction from the middle of the image than
//! across it. The model and the detection assume round pupils.

use nalgebra::{Matrix2, Vector1, Vector2};
use rayon::prelude::*;

use crate::image::{Grey, bounds};
use crate::model::MicroImageCenter;
use crate::numerics::NormalEquations;
use crate::quantity::Estimate;

/// Distance from the centre up to which light is read, in pitches.
const REACH: f64 = 0.5;

/// Measures the fraction by which micro-images at the corners of the image are narrower towards its middle than across.
/// Returns `None` if too few are lit.
pub(super) fn vignetting(
    image: &Grey,
    centers: &[MicroImageCenter],
    pitch_px: f64,
) -> Option<Estimate> {
    let (width, height) = image.size();
    let middle = Vector2::new(width as f64 - 1.0, height as f64 - 1.0) / 2.0;
    let measured = |center: &MicroImageCenter| {
        let place = Vector2::new(center.u_px, center.v_px);
        let field = place - middle;
        let outwards = field.try_normalize(1.0)?;
        let moments = moments(image, &place, pitch_px)?;
        let along = outwards.dot(&(moments * outwards));
        // A width is proportional to the root of its mean square.
        let narrower = 1.0 - (along / (moments.trace() - along)).sqrt();
        Some((field.norm_squared() / middle.norm_squared(), narrower))
    };
    let all: Vec<(f64, f64)> = centers.par_iter().filter_map(measured).collect();
    let mut equations = NormalEquations::<f64, 2, 1>::new();
    for (square, narrower) in &all {
        equations.add(&Vector2::new(1.0, *square), &Vector1::new(*narrower), 1.0);
    }
    let fitted = equations.solve()?;
    let squares: f64 = all.iter().map(|(s, n)| (n - fitted[0] - fitted[1] * s).powi(2)).sum();
    let variance = squares / (all.len() as f64 - 2.0).max(1.0);
    let inverse = equations.normal().try_inverse()?;
    let at_corners = fitted[0] + fitted[1];
    let sum = Vector2::repeat(1.0);
    Some(Estimate { value: at_corners, std_dev: (variance * sum.dot(&(inverse * sum))).sqrt() })
}

/// Computes the second moments of the light of a micro-image about its centroid, px²; `None` if it is cut or dark.
fn moments(image: &Grey, center: &Vector2<f64>, pitch_px: f64) -> Option<Matrix2<f64>> {
    let reach = REACH * pitch_px;
    let size = image.size();
    let room = Vector2::new(size.0 as f64 - 1.0, size.1 as f64 - 1.0) - center;
    if center.min() < reach || room.min() < reach {
        return None;
    }
    let ((left, top, width, height), corner) = bounds(std::iter::once(*center), reach);
    let part = image.part(left, top, width, height);
    let (mut light, mut first, mut second) = (0.0, Vector2::zeros(), Matrix2::zeros());
    for (i, &pixel) in part.pixels.iter().enumerate() {
        let at = Vector2::new((i % part.width) as f64, (i / part.width) as f64);
        let offset = corner + at - center;
        if offset.norm_squared() <= reach * reach {
            let weight = f64::from(pixel);
            light += weight;
            first += offset * weight;
            second += offset * offset.transpose() * weight;
        }
    }
    let mean = first / light;
    (light > 0.0).then(|| second / light - mean * mean.transpose())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::checks::whites::vignettes;
    use crate::image::{Color, RawImage, Samples};

    const PITCH: f64 = 20.0;

    /// Measures 20 x 15 ellipses, which at the corners are narrower by `narrower` towards the middle of the image.
    #[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss)] // eight bits
    fn found(narrower: f64) -> f64 {
        let (width, height) = (400, 300);
        let middle = Vector2::new(199.5, 149.5);
        let place = |i: usize| {
            Vector2::new((i % 20) as f64, (i / 20) as f64) * PITCH + Vector2::new(9.7, 10.2)
        };
        let light = |u: usize, v: usize| {
            let center = place(20 * (v / 20) + u / 20);
            let field = center - middle;
            let outwards = field.normalize();
            let less = 1.0 - narrower * field.norm_squared() / middle.norm_squared();
            let offset = Vector2::new(u as f64, v as f64) - center;
            let along = offset.dot(&outwards);
            let across = (offset - outwards * along).norm();
            // With an edge of 2 px, pixels show the shape.
            let inside = (7.0 - (along / less).hypot(across)) / 2.0 + 0.5;
            (200.0 * inside.clamp(0.0, 1.0)) as u8
        };
        let pixels = (0..width * height).map(|i| light(i % width, i / width)).collect();
        let raw = RawImage { width, height, color: Color::Grey, samples: Samples::Bits8(pixels) };
        let center = |i: usize| MicroImageCenter {
            k: 0,
            l: 0,
            u_px: place(i).x,
            v_px: place(i).y,
            std_dev_px: None,
        };
        let centers: Vec<MicroImageCenter> = (0..300).map(center).collect();
        let found = vignetting(&raw.grey(), &centers, PITCH);
        assert_eq!(vignettes(found), narrower > 0.02);
        found.unwrap().value
    }

    #[test]
    fn ellipses_are_as_narrow_as_they_were_drawn() {
        assert!(found(0.0).abs() < 2e-3);
        assert!((found(0.1) - 0.1).abs() < 0.01);
    }
}
