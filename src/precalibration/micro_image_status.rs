//! Nodes of a pattern that show a micro-image, and reasons why some give no centre.

use rayon::prelude::*;

use super::centers::{is_cut, middle_light, nodes_in};
use super::centroid::Blob;
use super::nodes::ByNode;
use super::pattern::Pattern;
use crate::image::Grey;
use crate::numerics::median;

/// Fraction of the neighbours' light below which a micro-image is faulty. Lens types differ less.
const DARK: f64 = 0.4;
/// Fraction of the usual light below which a micro-image is unlit. Vignetting leaves more at the border of an image.
const UNLIT: f64 = 0.1;
/// Fewest lit neighbours of the array. Light with fewer is a reflection.
const FEWEST_NEIGHBOURS: usize = 2;
/// Saturated fraction of its window above which a micro-image shows no edge.
const SATURATED: f64 = 0.97;

/// Reason why a micro-image gave no centre.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum LeftOut {
    Cut,
    Dark,
    Saturated,
}

/// Status of a node of the pattern in an image.
pub(super) struct MicroImageStatus {
    pub node: (i32, i32),
    /// Reason why the node gave no centre, if it gave none.
    pub left_out: Option<LeftOut>,
    /// True if it shows light, with a centre or without.
    pub lit: bool,
}

/// Returns the status of the micro-images that were measured, then of the other nodes in the image.
pub(super) fn judge(image: &Grey, pattern: &Pattern, blobs: &[Blob]) -> Vec<MicroImageStatus> {
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
        MicroImageStatus { node: blob.node, left_out, lit: !dark }
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
        MicroImageStatus { node, left_out: Some(left_out), lit: full || light > unlit }
    };
    let mut others = nodes_in(image.size(), pattern);
    others.retain(|&node| light.at(node).is_none());
    blobs.par_iter().map(of_blob).chain(others.par_iter().map(of_other)).collect()
}

/// Returns the nodes that show light of the array.
pub(super) fn lit_nodes(statuses: &[MicroImageStatus]) -> Vec<(i32, i32)> {
    let lit: Vec<((i32, i32), ())> =
        statuses.iter().filter(|v| v.lit).map(|v| (v.node, ())).collect();
    let by_node = ByNode::new(&lit);
    let among_others = |node: &(i32, i32)| by_node.around(*node, 1).count() >= FEWEST_NEIGHBOURS;
    lit.iter().map(|&(node, ())| node).filter(among_others).collect()
}

/// Returns the usual light: micro-images at least as bright hold half of all light. The many dark ones around a small
/// array do not affect it.
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
