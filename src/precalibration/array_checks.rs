//! Checks whether an image is a white image that shows its array well.

use std::collections::HashMap;

use nalgebra::{Matrix2, Vector2};

use super::array::ArrayMeasurement;
use crate::checks::whites::{self as checks, MOSTLY_FULL, Stretch};
use crate::error::Error;
use crate::finding::Finding;
use crate::image::{Grey, Image, RawImage};
use crate::model::MicroImageCenter;
use crate::numerics::median;

/// Factor within which a micro-image of a white image is as bright as its neighbours.
const AS_BRIGHT: f64 = 2.0;

/// Returns an error if nearly all of an image is saturated.
pub(super) fn over_exposed(image: &Grey) -> Option<Error> {
    let (width, height) = image.size();
    let full = full_part(&image.part(0, 0, width, height));
    (full > MOSTLY_FULL).then(|| {
        Error::invalid(format!(
            "{:.0} % of its pixels are saturated, and no array of micro-images was found: reduce \
             the exposure until the light in the micro-images is below full scale",
            100.0 * full
        ))
    })
}

fn full_part(image: &Image) -> f64 {
    image.pixels.iter().filter(|light| **light >= 1.0).count() as f64 / image.pixels.len() as f64
}

/// Returns findings about the image in which an array was measured: no white image, over-exposed, or not regular.
#[must_use]
pub fn array_findings(array: &ArrayMeasurement, image: &RawImage) -> Vec<Finding> {
    let (grid, image) = (&array.grid, image.to_grey());
    let (full, uneven) = (full_part(&image), uneven_part(array, &image));
    let of_array = checks::array(uneven, (grid.rms_px, grid.pitch_px), stretch(array), full);
    let out = &array.left_out;
    of_array
        .into_iter()
        .chain(checks::left_out(array.centers.len(), out.dark, out.misplaced))
        .chain(checks::alternating(array.lens_types.alternating))
        .collect()
}

/// Measures how much longer the lattice is along one direction than across it, from the linear map of a regular lattice to
/// the centres without their perspective (least squares). Returns `None` for too few centres.
fn stretch(array: &ArrayMeasurement) -> Option<Stretch> {
    let grid = &array.grid;
    let of = |c: &MicroImageCenter| {
        let place = Vector2::new(c.u_px, c.v_px);
        (grid.lattice.node(c.k, c.l), grid.without_perspective(&place) / grid.pitch_px)
    };
    let pairs: Vec<(Vector2<f64>, Vector2<f64>)> = array.centers.iter().map(of).collect();
    let count = pairs.len().max(1) as f64;
    let sum =
        pairs.iter().fold((Vector2::zeros(), Vector2::zeros()), |(a, b), (x, y)| (a + x, b + y));
    let (from, to) = (sum.0 / count, sum.1 / count);
    let (mut squares, mut products) = (Matrix2::zeros(), Matrix2::zeros());
    for (x, y) in &pairs {
        squares += (x - from) * (x - from).transpose();
        products += (y - to) * (x - from).transpose();
    }
    let map = products * squares.try_inverse()?;
    let off = |(x, y): &(Vector2<f64>, Vector2<f64>)| (y - to - map * (x - from)).norm_squared();
    let scatter = (pairs.iter().map(off).sum::<f64>() / count).sqrt();
    let sizes = map.singular_values();
    let relative = (sizes.min() > 0.0).then(|| sizes.max() / sizes.min() - 1.0)?;
    // It moves one half of the centres outwards, the other inwards.
    let moved = relative / 2.0 * (squares.trace() / count).sqrt();
    Some(Stretch { relative, moved, scatter })
}

/// Returns the fraction of the micro-images that are not about as bright as their neighbours.
fn uneven_part(array: &ArrayMeasurement, image: &Image) -> f64 {
    let of = |c: &MicroImageCenter| Some(((c.k, c.l), light_at(image, c)?));
    let light: HashMap<(i32, i32), f64> = array.centers.iter().filter_map(of).collect();
    let is_uneven = |(&(k, l), light_here): (&(i32, i32), &f64)| {
        let around = (-1..=1).flat_map(|dk| (-1..=1).map(move |dl| (k + dk, l + dl)));
        let around = around.filter(|node| *node != (k, l));
        let usual = median(around.filter_map(|node| light.get(&node).copied()));
        usual
            .is_some_and(|usual| *light_here > AS_BRIGHT * usual || *light_here < usual / AS_BRIGHT)
    };
    light.iter().filter(|one| is_uneven(*one)).count() as f64 / light.len().max(1) as f64
}

/// Returns the mean light of the nine pixels about a centre.
fn light_at(image: &Image, center: &MicroImageCenter) -> Option<f64> {
    #[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss)] // a negative one is cut to 0
    let [u, v] = [center.u_px, center.v_px].map(|x| x.round() as usize);
    let inside = u > 0 && v > 0 && u + 1 < image.width && v + 1 < image.height;
    let at = |u: usize, v: usize| f64::from(image.pixels[v * image.width + u]);
    inside.then(|| {
        (v - 1..=v + 1).flat_map(|v| (u - 1..=u + 1).map(move |u| at(u, v))).sum::<f64>() / 9.0
    })
}
