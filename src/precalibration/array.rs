//! The micro-image array of a white image as one step: from pixels to centres and grid.

use nalgebra::{Matrix2, Vector2};
use rayon::prelude::*;

use super::centers::{Blob, is_cut, measure, middle_light, nodes_in};
use super::grid::{MicroImageArray, fit_grid, fit_regular_grid};
use super::nodes::ByNode;
use super::pattern::{Pattern, find_pattern, of_steps};
use super::types::{LensTypes, judge_single};
use crate::error::{Error, Result};
use crate::image::{Grey, RawImage};
use crate::model::{Lattice, LatticeKind, MicroImageCenter, Packing, Parity};
use crate::numerics::median;

/// The micro-images of a white image.
#[derive(Debug, Clone, PartialEq)]
pub struct ArrayMeasurement {
    /// The regular grid.
    pub grid: MicroImageArray,
    /// Lens types as far as this image alone shows them.
    pub lens_types: LensTypes,
    /// The centres that agree with it.
    pub centers: Vec<MicroImageCenter>,
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
            lens_types: LensTypes::stated(lens_types.max(1)),
            centers,
            left_out: LeftOutCenters::default(),
        }
    }
}

/// Micro-images of the grid that gave no centre.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct LeftOutCenters {
    /// Their window is cut by the border of the image.
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
/// Less light than this part of the usual is none: vignetting leaves more at the rim of an image.
const UNLIT: f64 = 0.1;
/// Light with fewer lit neighbours than this is a reflection, not a part of the array.
const FEWEST_NEIGHBOURS: usize = 2;
/// With more than this part of its window saturated a micro-image shows no edge.
const SATURATED: f64 = 0.97;
/// Centres further from the grid than this many times the root mean square distance of those that
/// agree with it do not belong to it.
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
/// first column and row that show light. An error if no lattice of micro-images shows, or not one of
/// the stated size.
pub fn measure_array(image: &RawImage, stated: Option<(i32, i32)>) -> Result<ArrayMeasurement> {
    found_array(&image.grey(), stated).map(|found| found.array)
}

/// All centres in an image of `size` (width, height), px, that a known lattice puts there: one of them
/// at `origin`, the next at the two `steps` (columns, px). Indices count as in [`measure_array`].
pub fn lattice_centers(
    size: (u16, u16),
    origin: &Vector2<f64>,
    steps: &Matrix2<f64>,
) -> Result<Vec<MicroImageCenter>> {
    let pattern = Pattern { origin: *origin, ..known(steps)? };
    let nodes = nodes_in((size.0.into(), size.1.into()), &pattern);
    let labels = Labels::possible(&pattern, &nodes, None)?;
    let labels = labels
        .first()
        .ok_or_else(|| Error::invalid("no centre lies in it: give a larger image"))?;
    let center =
        |&node: &(i32, i32)| labels.center(&pattern, node, &pattern.place(node.0, node.1), None);
    Ok(nodes.iter().map(center).collect())
}

/// Packing and rotation (rad, from u towards v) of the lattice that two steps (columns, px) make, and
/// its steps to two neighbours: along the straight rows (columns), and to the next row (column) at 60
/// degrees from it, or at 90 on a square lattice.
pub fn lattice_orientation(steps: &Matrix2<f64>) -> Result<(LatticeKind, f64, Matrix2<f64>)> {
    let pattern = known(steps)?;
    let along_rows = pattern.lattice_axes().column(0).into_owned();
    Ok((pattern.kind, along_rows.y.atan2(along_rows.x), pattern.basis()))
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
    /// The micro-images that have a centre in the array, in the same order.
    pub blobs: Vec<Blob>,
    labels: Labels,
}

impl FoundArray {
    /// Index (k, l) of a node of the pattern.
    pub fn index(&self, node: (i32, i32)) -> (i32, i32) {
        self.labels.index(&self.pattern, node)
    }

    /// The centre that a micro-image has in one of the white images.
    pub fn center(&self, blob: &Blob) -> MicroImageCenter {
        self.labels.center(&self.pattern, blob.node, &blob.center, Some(blob.std_dev))
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

    fn center(
        &self,
        pattern: &Pattern,
        node: (i32, i32),
        place: &Vector2<f64>,
        std_dev_px: Option<f64>,
    ) -> MicroImageCenter {
        let (k, l) = self.index(pattern, node);
        MicroImageCenter { k, l, u_px: place.x, v_px: place.y, std_dev_px }
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
        Lattice { packing: Packing::new(kind, shifted), columns: self.size.0, rows: self.size.1 }
    }

    /// Every way to count some nodes, those that show, that suits the stated size, with it; else the
    /// ones with the fewest columns and rows.
    fn possible(
        pattern: &Pattern,
        nodes: &[(i32, i32)],
        stated: Option<(i32, i32)>,
    ) -> Result<Vec<Self>> {
        if nodes.is_empty() {
            return Err(Error::invalid("no micro-image lies in the image: give a larger one"));
        }
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
    let verdicts = judge(image, &pattern, &blobs);
    let (width, height) = image.size();
    let middle = Vector2::new(width as f64 - 1.0, height as f64 - 1.0) / 2.0;
    // From the middle of the image to that of the array.
    let off = |labels: &Labels| {
        let (k, l) = labels.index(&pattern, (0, 0));
        (pattern.origin - pattern.lattice_axes() * labels.lattice(pattern.kind).node(k, l) - middle)
            .norm()
    };
    let possible = Labels::possible(&pattern, &lit_nodes(&verdicts), stated)?;
    let Some(labels) = possible.into_iter().min_by(|a, b| off(a).total_cmp(&off(b))) else {
        return Err(Error::invalid(
            "the micro-images cannot be counted: give a white image of the whole array",
        ));
    };
    let lattice = labels.lattice(pattern.kind);
    let of_array = |node: (i32, i32)| {
        let (k, l) = labels.index(&pattern, node);
        lattice.contains(k, l)
    };
    let blobs: Vec<Blob> = blobs
        .into_iter()
        .zip(&verdicts)
        .filter(|(blob, verdict)| verdict.left_out.is_none() && of_array(blob.node))
        .map(|(blob, _)| blob)
        .collect();
    let center = |blob: &Blob| labels.center(&pattern, blob.node, &blob.center, Some(blob.std_dev));
    let all: Vec<MicroImageCenter> = blobs.iter().map(center).collect();
    let grid = fit_found(&all, &lattice)?;
    let limit = MISPLACED * grid.rms_px + MISPLACED_PX;
    let fits = |blob: &Blob| {
        let (k, l) = labels.index(&pattern, blob.node);
        (grid.center_of(k, l) - blob.center).norm() <= limit
    };
    let (blobs, misplaced): (Vec<Blob>, Vec<Blob>) = blobs.into_iter().partition(fits);
    let count = |reason: LeftOut| {
        verdicts.iter().filter(|v| v.left_out == Some(reason) && of_array(v.node)).count()
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
    let mut found = FoundArray { array, pattern, blobs, labels };
    found.array.lens_types = judge_single(&found);
    Ok(found)
}

/// The grid of centres that were found in an image.
pub(super) fn fit_found(
    centers: &[MicroImageCenter],
    lattice: &Lattice,
) -> Result<MicroImageArray> {
    fit_grid(centers, lattice.kind(), lattice.columns, lattice.rows).map_err(|_| no_grid(centers))
}

/// The same without perspective, which moves the middle: for comparing images of one camera.
pub(super) fn fit_found_regular(
    centers: &[MicroImageCenter],
    lattice: &Lattice,
) -> Result<MicroImageArray> {
    fit_regular_grid(centers, lattice.kind(), lattice.columns, lattice.rows)
        .map_err(|_| no_grid(centers))
}

fn no_grid(centers: &[MicroImageCenter]) -> Error {
    Error::invalid(format!(
        "{} micro-images show in the image, but they make no grid: give a white image, sharp and \
         undistorted, of a larger part of the array",
        centers.len()
    ))
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

/// Why a micro-image gave no centre.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum LeftOut {
    Cut,
    Dark,
    Saturated,
}

/// What an image shows of a node of its pattern.
struct Verdict {
    node: (i32, i32),
    /// Why it has no centre, if it has none.
    left_out: Option<LeftOut>,
    /// Whether light shows, with a centre or without.
    lit: bool,
}

/// Judges the micro-images that were measured, and then the other nodes in the image.
fn judge(image: &Grey, pattern: &Pattern, blobs: &[Blob]) -> Vec<Verdict> {
    let light: Vec<((i32, i32), f64)> = blobs.iter().map(|b| (b.node, b.light)).collect();
    let light = ByNode::new(&light);
    let unlit = UNLIT * usual_light(blobs);
    let of_blob = |blob: &Blob| {
        let typical = median(light.around(blob.node, 2)).unwrap_or_default();
        let dark = blob.light < unlit.max(DARK * typical);
        let left_out = if dark {
            Some(LeftOut::Dark)
        } else {
            (blob.saturated > SATURATED).then_some(LeftOut::Saturated)
        };
        Verdict { node: blob.node, left_out, lit: !dark }
    };
    let of_other = |&node: &(i32, i32)| {
        let (light, saturated) = middle_light(image, pattern, node).unwrap_or_default();
        let full = saturated > SATURATED;
        let left_out = if is_cut(image.size(), pattern, node) {
            LeftOut::Cut
        } else if full {
            LeftOut::Saturated
        } else {
            LeftOut::Dark
        };
        Verdict { node, left_out: Some(left_out), lit: full || light > unlit }
    };
    let mut others = nodes_in(image.size(), pattern);
    others.retain(|&node| light.at(node).is_none());
    blobs.par_iter().map(of_blob).chain(others.par_iter().map(of_other)).collect()
}

/// The nodes of the array as far as it shows light.
fn lit_nodes(verdicts: &[Verdict]) -> Vec<(i32, i32)> {
    let lit: Vec<((i32, i32), ())> =
        verdicts.iter().filter(|v| v.lit).map(|v| (v.node, ())).collect();
    let by_node = ByNode::new(&lit);
    let among_others = |node: &(i32, i32)| by_node.around(*node, 1).count() >= FEWEST_NEIGHBOURS;
    lit.iter().map(|&(node, ())| node).filter(among_others).collect()
}

/// Half of all light is in micro-images at least as bright: so the many dark ones about a small array
/// have no say.
fn usual_light(blobs: &[Blob]) -> f64 {
    let mut lights: Vec<f64> = blobs.iter().map(|blob| blob.light).collect();
    lights.sort_unstable_by(|a, b| b.total_cmp(a));
    let half = lights.iter().sum::<f64>() / 2.0;
    let mut sum = 0.0;
    let reaches_half = |light: &f64| {
        sum += light;
        sum >= half
    };
    lights.into_iter().find(reaches_half).unwrap_or_default()
}
