//! Which nodes of a pattern show a micro-image, and why some give no centre.

use rayon::prelude::*;

use super::centers::{is_cut, middle_light, nodes_in};
use super::centroid::Blob;
use super::nodes::ByNode;
use super::pattern::Pattern;
use crate::image::Grey;
use crate::numerics::median;

/// Less light than this part of the neighbours' is a fault, not a lens type.
const DARK: f64 = 0.4;
/// Less light than this part of the usual is none: vignetting leaves more at the rim of an image.
const UNLIT: f64 = 0.1;
/// Light with fewer lit neighbours than this is a reflection, not a part of the array.
const FEWEST_NEIGHBOURS: usize = 2;
/// With more than this part of its window saturated a micro-image shows no edge.
const SATURATED: f64 = 0.97;

/// Why a micro-image gave no centre.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum LeftOut {
    Cut,
    Dark,
    Saturated,
}

/// What an image shows of a node of its pattern.
pub(super) struct MicroImageStatus {
    pub node: (i32, i32),
    /// Why it gave no centre, if it gave none.
    pub left_out: Option<LeftOut>,
    /// Whether it shows light, with a centre or without.
    pub lit: bool,
}

/// The status of the micro-images that were measured, then on the other nodes in the image.
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

/// The nodes that show light of the array.
pub(super) fn lit_nodes(statuses: &[MicroImageStatus]) -> Vec<(i32, i32)> {
    let lit: Vec<((i32, i32), ())> =
        statuses.iter().filter(|v| v.lit).map(|v| (v.node, ())).collect();
    let by_node = ByNode::new(&lit);
    let among_others = |node: &(i32, i32)| by_node.around(*node, 1).count() >= FEWEST_NEIGHBOURS;
    lit.iter().map(|&(node, ())| node).filter(among_others).collect()
}

/// Micro-images at least as bright hold half of all light: the many dark ones around a small array have
/// no say in that.
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
