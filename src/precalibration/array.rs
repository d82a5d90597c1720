//! The micro-image array of a white image as one step: from pixels to centres and grid.

use nalgebra::{Matrix2, Vector2};
use rayon::prelude::*;

use super::centers::{Blob, measure, nodes_in};
use super::grid::{MicroImageArray, fit_grid};
use super::nodes::ByNode;
use super::pattern::{Pattern, find_pattern, of_steps};
use super::types::{LensTypes, judge_single};
use crate::error::{Error, Result};
use crate::image::{Grey, RawImage};
use crate::lattice::{Lattice, LatticeKind, Parity};
use crate::observations::MicroImageCenter;

/// The micro-images of a white image.
#[derive(Debug, Clone, PartialEq)]
pub struct ArrayMeasurement {
    /// The regular grid.
    pub grid: MicroImageArray,
    /// Lens types as far as this image alone shows them.
    pub lens_types: LensTypes,
    /// The centres that agree with it.
    pub centers: Vec<MicroImageCenter>,
    /// Standard deviation of each centre per axis, px.
    pub std_devs_px: Vec<f64>,
    /// How many micro-images gave no centre, by reason.
    pub left_out: LeftOutCenters,
}

impl ArrayMeasurement {
    /// An array that is known from elsewhere, without uncertainty.
    #[must_use]
    pub fn of_grid(
        grid: MicroImageArray,
        centers: Vec<MicroImageCenter>,
        lens_types: usize,
    ) -> Self {
        Self {
            grid,
            lens_types: LensTypes { types: lens_types.max(1), separation: 0.0, agreement: 1.0 },
            std_devs_px: vec![0.0; centers.len()],
            centers,
            left_out: LeftOutCenters::default(),
        }
    }
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

/// Micro-images at the rim of an array may lie beyond the sensor, so that fewer show than there are:
/// so many on both sides together.
const BEYOND: i32 = 2;

/// Finds and measures all micro-images of a white image, from the image alone.
///
/// `stated` is the number of columns and rows of the array where it is known. Indices (k, l) then
/// count such that the middle of the array is nearest to that of the image; else they count from the
/// first column and row that have a centre in the image. An error if no lattice of micro-images
/// shows, or not one of the stated size.
pub fn measure_array(image: &RawImage, stated: Option<(i32, i32)>) -> Result<ArrayMeasurement> {
    found_array(&image.grey(), stated).map(|found| found.array)
}

/// All centres in an image of `size` (width, height), px, that a known lattice puts there: one of them
/// at `origin`, the next at the two `steps` (columns, px). Indices count as in [`measure_array`].
pub fn lattice_centers(
    size: (u32, u32),
    origin: &Vector2<f64>,
    steps: &Matrix2<f64>,
) -> Result<(LatticeKind, Vec<MicroImageCenter>)> {
    let pattern = Pattern { origin: *origin, ..known(steps)? };
    let nodes = nodes_in((size.0 as usize, size.1 as usize), &pattern);
    let labels = Labels::possible(&pattern, &nodes, None)?;
    let labels = labels.first().ok_or_else(|| Error::invalid("no centre lies in the image"))?;
    let center = |&(i, j): &(i32, i32)| {
        let (k, l) = labels.index(&pattern, (i, j));
        let place = pattern.place(i, j);
        MicroImageCenter { k, l, u_px: place.x, v_px: place.y }
    };
    Ok((pattern.kind, nodes.iter().map(center).collect()))
}

/// Packing and rotation (rad, from u towards v) of the lattice that two steps (columns, px) make.
pub fn lattice_orientation(steps: &Matrix2<f64>) -> Result<(LatticeKind, f64)> {
    let pattern = known(steps)?;
    let along_rows = pattern.lattice_axes().column(0).into_owned();
    Ok((pattern.kind, along_rows.y.atan2(along_rows.x)))
}

fn known(steps: &Matrix2<f64>) -> Result<Pattern> {
    of_steps(steps).ok_or_else(|| {
        Error::invalid(
            "its steps make neither a hexagonal nor a square lattice with a pitch from 5 to 90 px",
        )
    })
}

/// The array with what the next steps need of how it was found.
pub(super) struct FoundArray {
    pub array: ArrayMeasurement,
    pub pattern: Pattern,
    /// Micro-images with a centre, dark and saturated ones left out.
    pub blobs: Vec<Blob>,
    labels: Labels,
}

impl FoundArray {
    /// Index (k, l) of a node of the pattern.
    pub fn index(&self, node: (i32, i32)) -> (i32, i32) {
        self.labels.index(&self.pattern, node)
    }
}

/// How the nodes of a pattern are counted.
#[derive(Debug, Clone, Copy)]
struct Labels {
    later: bool,
    first: (i32, i32),
    size: (i32, i32),
}

impl Labels {
    fn index(&self, pattern: &Pattern, node: (i32, i32)) -> (i32, i32) {
        let (k, l) = pattern.index(node, self.later);
        (k - self.first.0, l - self.first.1)
    }

    /// The lattice so counted.
    fn lattice(&self, kind: LatticeKind) -> Lattice {
        let row = match kind {
            LatticeKind::HexagonalColumns => self.first.0,
            _ => self.first.1,
        };
        // Of the pattern's own rows the odd ones are further, or with `later` the even ones.
        let odd = row.rem_euclid(2) == i32::from(self.later);
        let shifted = if odd { Parity::Odd } else { Parity::Even };
        Lattice { kind, columns: self.size.0, rows: self.size.1, shifted }
    }

    /// Every way to count that suits the stated size, with it; else the ones with the fewest columns
    /// and rows.
    fn possible(
        pattern: &Pattern,
        nodes: &[(i32, i32)],
        stated: Option<(i32, i32)>,
    ) -> Result<Vec<Self>> {
        let both = [false, true].map(|later| {
            let indices = || nodes.iter().map(|&node| pattern.index(node, later));
            let low = indices().fold((i32::MAX, i32::MAX), |a, b| (a.0.min(b.0), a.1.min(b.1)));
            let high = indices().fold((i32::MIN, i32::MIN), |a, b| (a.0.max(b.0), a.1.max(b.1)));
            Self { later, first: low, size: (high.0 - low.0 + 1, high.1 - low.1 + 1) }
        });
        let Some((columns, rows)) = stated else {
            let fewest = both.iter().map(|l| l.size).min().unwrap_or((0, 0));
            return Ok(both.into_iter().filter(|l| l.size == fewest).collect());
        };
        let beyond = |l: &Self| (columns - l.size.0, rows - l.size.1);
        let shifted = |l: Self| {
            let (k, l_beyond) = beyond(&l);
            let first = l.first;
            (0..=k).flat_map(move |dk| {
                (0..=l_beyond).map(move |dl| Self {
                    first: (first.0 - dk, first.1 - dl),
                    size: (columns, rows),
                    ..l
                })
            })
        };
        let fits = |l: &Self| {
            let (k, l) = beyond(l);
            (0..=BEYOND).contains(&k) && (0..=BEYOND).contains(&l)
        };
        let possible: Vec<Self> = both.into_iter().filter(fits).flat_map(shifted).collect();
        if possible.is_empty() {
            let found = both.map(|l| format!("{} x {}", l.size.0, l.size.1));
            let found = if found[0] == found[1] { found[0].clone() } else { found.join(" or ") };
            return Err(Error::invalid(format!(
                "the array is said to have {columns} x {rows} micro-lenses, but {found} \
                 micro-images show in the image: correct the one, or give the image of that camera"
            )));
        }
        Ok(possible)
    }
}

pub(super) fn found_array(image: &Grey, stated: Option<(i32, i32)>) -> Result<FoundArray> {
    let (pattern, blobs) = find(image)?;
    let (blobs, mut left_out) = judge(blobs);
    let all = nodes_in(image.size(), &pattern);
    let Some(any) = blobs.first() else {
        return Err(Error::invalid("no micro-image lies wholly in the image"));
    };
    let (width, height) = image.size();
    let middle = Vector2::new(width as f64 - 1.0, height as f64 - 1.0) / 2.0;
    // From the middle of the image to that of the array.
    let off = |labels: &Labels| {
        let (k, l) = labels.index(&pattern, any.node);
        (any.center - pattern.lattice_axes() * labels.lattice(pattern.kind).node(k, l) - middle)
            .norm()
    };
    let possible = Labels::possible(&pattern, &all, stated)?;
    let Some(labels) = possible.into_iter().min_by(|a, b| off(a).total_cmp(&off(b))) else {
        return Err(Error::invalid("the micro-images cannot be counted"));
    };
    let center = |blob: &Blob| {
        let (k, l) = labels.index(&pattern, blob.node);
        MicroImageCenter { k, l, u_px: blob.center.x, v_px: blob.center.y }
    };
    let centers: Vec<MicroImageCenter> = blobs.iter().map(center).collect();
    let grid = fit_grid(&centers, pattern.kind, labels.size.0, labels.size.1)?;
    let limit = MISPLACED * grid.rms_px + MISPLACED_PX;
    let (centers, std_devs_px): (Vec<_>, Vec<_>) = centers
        .into_iter()
        .zip(blobs.iter().map(|blob| blob.std_dev))
        .filter(|(c, _)| (grid.center_of(c.k, c.l) - Vector2::new(c.u_px, c.v_px)).norm() <= limit)
        .unzip();
    left_out.misplaced = blobs.len() - centers.len();
    left_out.cut =
        all.len() - centers.len() - left_out.dark - left_out.saturated - left_out.misplaced;
    let lens_types = LensTypes { types: 1, separation: 0.0, agreement: 1.0 };
    let array = ArrayMeasurement { grid, lens_types, centers, std_devs_px, left_out };
    let mut found = FoundArray { array, pattern, blobs, labels };
    found.array.lens_types = judge_single(&found);
    Ok(found)
}

/// The pattern, looked for in the middle and then, should that be damaged, in the quarters.
fn find(image: &Grey) -> Result<(Pattern, Vec<Blob>)> {
    let (w, h) = image.size();
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
    let light: Vec<((i32, i32), f64)> = blobs.iter().map(|b| (b.node, b.light)).collect();
    let light = ByNode::new(&light);
    let typical = |node: (i32, i32)| {
        let mut near: Vec<f64> = light.around(node, 2).collect();
        let middle = near.len() / 2;
        (!near.is_empty()).then(|| *near.select_nth_unstable_by(middle, f64::total_cmp).1)
    };
    let is_dark = |blob: &Blob| typical(blob.node).is_some_and(|t| blob.light < DARK * t);
    let dark: Vec<bool> = blobs.par_iter().map(is_dark).collect();
    let mut left_out = LeftOutCenters::default();
    let good = blobs.into_iter().zip(dark).filter(|(blob, dark)| {
        let saturated = !dark && blob.saturated > SATURATED;
        left_out.dark += usize::from(*dark);
        left_out.saturated += usize::from(saturated);
        !dark && !saturated
    });
    let good = good.map(|(blob, _)| blob).collect();
    (good, left_out)
}
