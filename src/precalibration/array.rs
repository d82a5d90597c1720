//! The micro-image array of a white image as one step: from pixels to centres and grid.

use std::collections::HashMap;

use super::centers::{Blob, measure};
use super::grid::{MicroImageArray, fit_grid};
use super::pattern::{Pattern, find_pattern};
use crate::error::{Error, Result};
use crate::image::Image;
use crate::observations::MicroImageCenter;

/// The micro-images of a white image.
#[derive(Debug, Clone, PartialEq)]
pub struct ArrayMeasurement {
    /// The regular grid.
    pub grid: MicroImageArray,
    /// The centres that agree with it.
    pub centers: Vec<MicroImageCenter>,
    /// Standard deviation of each centre per axis, px.
    pub std_devs_px: Vec<f64>,
    /// How many micro-images gave no centre, by reason.
    pub left_out: LeftOutCenters,
}

/// Micro-images of the grid that gave no centre.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct LeftOutCenters {
    /// Cut by the border of the image.
    pub cut: usize,
    /// Without light, or with much less than their neighbours.
    pub dark: usize,
    /// Saturated all over, so that no edge shows.
    pub saturated: usize,
    /// Far from the place that the others leave for them: dust, scratches, reflections.
    pub misplaced: usize,
}

/// Less light than this part of the neighbours' is a fault, not a lens type.
const DARK: f64 = 0.4;
/// With more than this part of its window saturated a micro-image shows no edge.
const SATURATED: f64 = 0.97;
/// Centres beyond this many robust standard deviations do not belong to the grid.
const MISPLACED: f64 = 6.0;
/// On a nearly perfect grid a hundredth of a pixel is no fault, px.
const MISPLACED_PX: f64 = 0.05;
/// What a repeated pattern of micro-images explains at least of an image.
const PATTERN: f64 = 0.1;

/// Finds and measures all micro-images of a white image, from the image alone.
///
/// Indices (k, l) count from the first column and row that have a centre in the image. An error if
/// no lattice of micro-images shows.
pub fn measure_array(image: &Image) -> Result<ArrayMeasurement> {
    let (pattern, blobs) = find(image)?;
    let (blobs, mut left_out) = judge(blobs);
    let all = super::centers::nodes_in(image, &pattern);
    let indices: Vec<(i32, i32)> = all.iter().map(|&(i, j)| pattern.index(i, j)).collect();
    let low_k = indices.iter().map(|&(k, _)| k).min().unwrap_or(0);
    let low_l = indices.iter().map(|&(_, l)| l).min().unwrap_or(0);
    let high_k = indices.iter().map(|&(k, _)| k).max().unwrap_or(0);
    let high_l = indices.iter().map(|&(_, l)| l).max().unwrap_or(0);
    let center = |blob: &Blob| {
        let (k, l) = pattern.index(blob.node.0, blob.node.1);
        let (k, l) = (k - low_k, l - low_l);
        MicroImageCenter { k, l, u_px: blob.center.x, v_px: blob.center.y }
    };
    let centers: Vec<MicroImageCenter> = blobs.iter().map(center).collect();
    let grid = fit_grid(&centers, pattern.kind, high_k - low_k + 1, high_l - low_l + 1)?;
    let limit = MISPLACED * grid.rms_px + MISPLACED_PX;
    let (centers, std_devs_px): (Vec<_>, Vec<_>) = centers
        .into_iter()
        .zip(blobs.iter().map(|blob| blob.std_dev))
        .filter(|(c, _)| {
            let miss = grid.center_of(c.k, c.l) - nalgebra::Vector2::new(c.u_px, c.v_px);
            miss.norm() <= limit
        })
        .unzip();
    left_out.misplaced = blobs.len() - centers.len();
    left_out.cut =
        all.len() - centers.len() - left_out.dark - left_out.saturated - left_out.misplaced;
    Ok(ArrayMeasurement { grid, centers, std_devs_px, left_out })
}

/// The pattern, looked for in the middle and then, should that be damaged, in the quarters.
fn find(image: &Image) -> Result<(Pattern, Vec<Blob>)> {
    let (w, h) = (image.width, image.height);
    let places = [
        (w / 2, h / 2),
        (w / 4, h / 4),
        (3 * w / 4, h / 4),
        (w / 4, 3 * h / 4),
        (3 * w / 4, 3 * h / 4),
    ];
    for place in places {
        let Some(pattern) = find_pattern(image, place) else { continue };
        if pattern.explained < PATTERN {
            continue;
        }
        if let Some(found) = measure(image, &pattern) {
            return Ok(found);
        }
    }
    Err(Error::invalid(
        "no array of micro-images shows in this image: nothing repeats on a hexagonal or square \
         lattice with a pitch from 5 to 90 px; give a white image, neither black nor saturated",
    ))
}

/// Sorts out what is dark or saturated.
fn judge(blobs: Vec<Blob>) -> (Vec<Blob>, LeftOutCenters) {
    let light: HashMap<(i32, i32), f64> = blobs.iter().map(|b| (b.node, b.light)).collect();
    let mut left_out = LeftOutCenters::default();
    let neighbours = |(i, j): (i32, i32)| {
        let near = (-2..=2).flat_map(move |dj| (-2..=2).map(move |di| (i + di, j + dj)));
        let mut near: Vec<f64> =
            near.filter(|&n| n != (i, j)).filter_map(|n| light.get(&n).copied()).collect();
        let middle = near.len() / 2;
        (!near.is_empty()).then(|| *near.select_nth_unstable_by(middle, f64::total_cmp).1)
    };
    let blobs = blobs
        .into_iter()
        .filter(|blob| {
            let dark = neighbours(blob.node).is_some_and(|typical| blob.light < DARK * typical);
            let saturated = blob.saturated > SATURATED;
            left_out.dark += usize::from(dark);
            left_out.saturated += usize::from(saturated && !dark);
            !dark && !saturated
        })
        .collect();
    (blobs, left_out)
}
