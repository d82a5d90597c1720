//! Search for the micro-image array of a white image: from pixels to centres and grid.

use nalgebra::{Matrix2, Vector2};

use super::array::{ArrayMeasurement, FoundArray, LeftOutCenters, LensTypes};
use super::array_checks::over_exposed;
use super::centers::{measure, nodes_in};
use super::centroid::Blob;
use super::grid::{MicroImageArray, fit_grid};
use super::indexing::Indexing;
use super::lens_types::judge_single;
use super::micro_image_status::{LeftOut, judge, lit_nodes};
use super::pattern::{CLEAR, PITCHES, Pattern, find_patterns, of_steps};
use crate::error::{Error, Result};
use crate::image::{Grey, RawImage};
use crate::model::{Lattice, LatticeKind, MicroImageCenter};

/// Distance from the grid beyond which centres do not belong to it, over the root mean square distance of the centres
/// that agree with it.
const MISPLACED: f64 = 6.0;
/// Addition to this distance, px: on a nearly perfect grid a hundredth of a pixel is no fault.
const MISPLACED_PX: f64 = 0.05;

/// Largest root mean square distance from the grid, in pitches, of the centres of a pattern that explains little of the image.
/// Real arrays between holes have up to 0.09, lattices of chance 0.12.
const REGULAR: f64 = 0.1;
/// Part of the micro-images of an array in a grid above which its pattern is right. Of a lattice that is too fine, at most half
/// of the nodes show light.
const MOST: f64 = 0.5;

/// Finds and measures all micro-images of a white image, from the image alone.
///
/// `stated` is the number of columns and rows of the array, if it is known. Then indices (k, l) put the middle of the
/// array nearest to the middle of the image. Otherwise they count from the first column and row that show light.
///
/// Returns an error if no lattice of micro-images shows, or not one of the stated size.
pub fn measure_array(image: &RawImage, stated: Option<(i32, i32)>) -> Result<ArrayMeasurement> {
    found_array(&image.grey(), None, stated).map(|found| found.array)
}

/// Returns the centres of a known lattice in an image of `size` (width, height), px. One centre is at `origin`, the
/// next ones two `steps` away (columns, px). Indices count as in [`measure_array`].
pub fn lattice_centers(
    size: (u16, u16),
    origin: &Vector2<f64>,
    steps: &Matrix2<f64>,
) -> Result<Vec<MicroImageCenter>> {
    let pattern = Pattern { origin: *origin, ..known(steps)? };
    let nodes = nodes_in((size.0.into(), size.1.into()), &pattern);
    let indexing = Indexing::possible(&pattern, &nodes, None)?;
    let indexing = indexing
        .first()
        .ok_or_else(|| Error::invalid("the image contains no centre: give a larger image"))?;
    let center =
        |&node: &(i32, i32)| indexing.center(&pattern, node, &pattern.place(node.0, node.1), None);
    Ok(nodes.iter().map(center).collect())
}

/// Returns packing and rotation (rad, from u towards v) of the lattice that two steps (columns, px) span, and its steps
/// to two neighbours: along the straight rows (columns), and to the next row (column), at 60 degrees or, on a square
/// lattice, at 90 degrees.
pub fn lattice_orientation(steps: &Matrix2<f64>) -> Result<(LatticeKind, f64, Matrix2<f64>)> {
    let pattern = known(steps)?;
    let along_rows = pattern.lattice_axes().column(0).into_owned();
    Ok((pattern.kind, along_rows.y.atan2(along_rows.x), pattern.basis()))
}

fn known(steps: &Matrix2<f64>) -> Result<Pattern> {
    of_steps(steps, &PITCHES).ok_or_else(|| {
        Error::invalid(format!(
            "its steps form neither a hexagonal nor a square lattice with a pitch from {} to {} px",
            PITCHES.start(),
            PITCHES.end()
        ))
    })
}

/// Finds and measures all micro-images like [`measure_array`], with the pattern if it is known.
pub(super) fn found_array(
    image: &Grey,
    known: Option<Pattern>,
    stated: Option<(i32, i32)>,
) -> Result<FoundArray> {
    search(image, known, stated).map_err(|error| over_exposed(image).unwrap_or(error))
}

/// Tries the `known` pattern, then those of the image, until one continues over the image and most of its micro-images form
/// a grid. Otherwise it takes the pattern with the largest part of its micro-images in a grid.
fn search(image: &Grey, known: Option<Pattern>, stated: Option<(i32, i32)>) -> Result<FoundArray> {
    let mut best: Option<Result<FoundArray>> = None;
    let used = |found: &Result<FoundArray>| found.as_ref().map_or(-1.0, |f| used_part(&f.array));
    for pattern in known.into_iter().chain(patterns(image)) {
        let Some((pattern, blobs)) = measure(image, &pattern) else { continue };
        let found = of_pattern(image, pattern, blobs, stated);
        if pattern.explained < CLEAR && !found.as_ref().is_ok_and(is_regular) {
            continue;
        }
        if used(&found) >= MOST {
            return found;
        }
        if best.as_ref().is_none_or(|best| used(&found) > used(best)) {
            best = Some(found);
        }
    }
    best.unwrap_or_else(|| Err(no_pattern()))
}

/// Returns true if the centres of an array are too near a regular grid for a lattice of chance.
fn is_regular(found: &FoundArray) -> bool {
    let grid = &found.array.grid;
    grid.rms_px < REGULAR * grid.pitch_px
}

/// Returns the part of the micro-images of an array, without those that the border of the image cuts, that gave a centre.
fn used_part(array: &ArrayMeasurement) -> f64 {
    let (used, out) = (array.centers.len(), &array.left_out);
    used as f64 / (used + out.dark + out.saturated + out.misplaced).max(1) as f64
}

/// Indexes the micro-images of a pattern, and fits the grid to them.
fn of_pattern(
    image: &Grey,
    pattern: Pattern,
    blobs: Vec<Blob>,
    stated: Option<(i32, i32)>,
) -> Result<FoundArray> {
    let statuses = judge(image, &pattern, &blobs);
    let (width, height) = image.size();
    let middle = Vector2::new(width as f64 - 1.0, height as f64 - 1.0) / 2.0;
    // Distance from the middle of the image to the middle of the array.
    let off = |indexing: &Indexing| {
        let (k, l) = indexing.index(&pattern, (0, 0));
        let to_middle = pattern.lattice_axes() * -indexing.lattice(pattern.kind).node(k, l);
        let steps = pattern.basis().try_inverse().unwrap_or_default() * to_middle;
        (pattern.place_of(&steps) - middle).norm()
    };
    let possible = Indexing::possible(&pattern, &lit_nodes(&statuses), stated)?;
    let Some(indexing) = possible.into_iter().min_by(|a, b| off(a).total_cmp(&off(b))) else {
        return Err(Error::invalid(
            "the micro-images cannot be indexed: give a white image of the whole array",
        ));
    };
    let lattice = indexing.lattice(pattern.kind);
    let of_array = |node: (i32, i32)| {
        let (k, l) = indexing.index(&pattern, node);
        lattice.contains(k, l)
    };
    let blobs: Vec<Blob> = blobs
        .into_iter()
        .zip(&statuses)
        .filter(|(blob, status)| status.left_out.is_none() && of_array(blob.node))
        .map(|(blob, _)| blob)
        .collect();
    let center =
        |blob: &Blob| indexing.center(&pattern, blob.node, &blob.center, Some(blob.std_dev));
    let all: Vec<MicroImageCenter> = blobs.iter().map(center).collect();
    let grid = fit_found(&all, &lattice)?;
    let limit = MISPLACED * grid.rms_px + MISPLACED_PX;
    let fits = |blob: &Blob| {
        let (k, l) = indexing.index(&pattern, blob.node);
        (grid.center_of(k, l) - blob.center).norm() <= limit
    };
    let (blobs, misplaced): (Vec<Blob>, Vec<Blob>) = blobs.into_iter().partition(fits);
    let count = |reason: LeftOut| {
        statuses.iter().filter(|v| v.left_out == Some(reason) && of_array(v.node)).count()
    };
    let array = ArrayMeasurement {
        grid,
        lens_types: LensTypes::ONE,
        centers: blobs.iter().map(center).collect(),
        left_out: LeftOutCenters {
            cut: count(LeftOut::Cut),
            dark: count(LeftOut::Dark),
            saturated: count(LeftOut::Saturated),
            misplaced: misplaced.len(),
        },
    };
    let mut found = FoundArray { array, pattern, blobs, indexing };
    found.array.lens_types = judge_single(&found);
    Ok(found)
}

/// Fits the grid to centres that were found in an image.
pub(super) fn fit_found(
    centers: &[MicroImageCenter],
    lattice: &Lattice,
) -> Result<MicroImageArray> {
    fit_grid(centers, lattice.kind(), lattice.columns, lattice.rows).map_err(|_| no_grid(centers))
}

fn no_grid(centers: &[MicroImageCenter]) -> Error {
    Error::invalid(format!(
        "{} micro-images were found, but they do not form a grid: give a sharp, undistorted and \
         unstretched white image of a larger part of the array",
        centers.len()
    ))
}

fn no_pattern() -> Error {
    Error::invalid(format!(
        "no array of micro-images was found: nothing repeats on a hexagonal or square lattice with \
         a pitch from {} to {} px; give a white image that is neither black nor saturated, and \
         shows at least five micro-images along either side",
        PITCHES.start(),
        PITCHES.end()
    ))
}

/// Returns the patterns in the middle of the image, then the patterns in its quarters in case the middle is damaged.
pub(super) fn patterns(image: &Grey) -> impl Iterator<Item = Pattern> {
    let (w, h) = image.size();
    let places = [
        (w / 2, h / 2),
        (w / 4, h / 4),
        (3 * w / 4, h / 4),
        (w / 4, 3 * h / 4),
        (3 * w / 4, 3 * h / 4),
    ];
    places.into_iter().flat_map(|place| find_patterns(image, place))
}
