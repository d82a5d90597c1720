//! First pass: corners in single micro-images, and groups of corners that lie on lines.

use nalgebra::Vector2;
use rayon::prelude::*;

use super::corner::{Corner, FitRoom};
use super::dbscan::dbscan;
use super::frame::{Frame, FrameCounts};
use super::grouping::{Group, LineSearch, groups_on_lines, is_texture};
use super::patch::{Patch, Room};
use super::saddle::saddles;
use super::{CornerObservation, MicroOptics};
use crate::model::{Configuration, LatticeKind};

/// Number of micro-images along the edge of a tile, which one thread searches.
const TILE: i32 = 16;
/// Distance from the centre of a micro-image with a corner, in pitches, up to which others may show it too.
const ABOUT: f64 = 1.8;
/// Smallest and largest contrast of corners, relative to the frame's: apart from noise, nothing is brighter or darker than its
/// squares.
pub(super) const LEAST_CONTRAST: f64 = 0.35;
const MOST_CONTRAST: f64 = 1.5;
/// Smallest part of the light of its micro-image that a corner explains.
const EXPLAINED: f64 = 0.8;
/// Largest imbalance of a corner, see [`Corner::imbalance`].
const IMBALANCE: f64 = 0.25;
/// Number of saddles of a micro-image that are tried.
const STARTS: usize = 2;
/// Sine of the smallest angle between two edges.
const OPENING: f64 = 0.4;
/// Largest standard deviation of a corner, px.
const UNCERTAIN_PX: f64 = 0.6;
/// Smallest distance of corners from the edge of the micro-image, px, since the blur is not known yet.
const EDGE_PX: f64 = 1.5;
/// Largest distance of neighbours in a cluster, relative to their distance if none is missing.
const GAP: f64 = 1.5;
/// Largest distance of a corner in neighbouring micro-images, in pitches, if its image is in front of the array (Keplerian): it
/// is larger than the distance of their centres.
const FURTHEST_BEFORE: f64 = 1.5;
/// Largest distance of observations from their line before vignetting is taken into account, in pitches.
const ROUGH: f64 = 0.06;

/// Corners in single micro-images.
///
/// Several neighbours show a corner of the board, so one micro-image in four is searched first, and then those near corners.
pub(super) struct FirstPass<'a> {
    frame: &'a Frame<'a>,
    /// Contrast of the frame.
    pub contrast: f64,
    /// True for micro-images of the lattice that are in the image and were not searched yet.
    left: Vec<bool>,
    /// Number of micro-images that were searched, and of unusable ones among them.
    pub looked_at: usize,
    pub unusable: usize,
    /// Observations of corners.
    pub observations: Vec<CornerObservation>,
}

impl<'a> FirstPass<'a> {
    /// Creates the pass before any of these micro-images is searched.
    pub fn new(frame: &'a Frame<'a>, nodes: &[(i32, i32)], contrast: f64) -> Self {
        let mut pass = Self {
            frame,
            contrast,
            left: vec![false; frame.search.micro_images.grid.lattice.nodes()],
            looked_at: 0,
            unusable: 0,
            observations: Vec::new(),
        };
        for &node in nodes {
            let i = pass.index(node);
            pass.left[i] = true;
        }
        pass
    }

    /// Searches one micro-image in four, and all near corners.
    pub fn search_some(&mut self) {
        let kind = self.frame.search.micro_images.grid.lattice.kind();
        let mut next = self.take_left(|node| is_among_some(kind, node));
        while !next.is_empty() {
            let found = self.search(next);
            next = self.take_about(found);
        }
    }

    /// Searches all others.
    pub fn search_rest(&mut self) {
        let rest = self.take_left(|_| true);
        self.search(rest);
    }

    fn index(&self, (k, l): (i32, i32)) -> usize {
        let lattice = &self.frame.search.micro_images.grid.lattice;
        lattice.index(k, l).expect("nodes of the lattice")
    }

    /// Takes the wanted ones of the micro-images that were not searched yet.
    fn take_left(&mut self, wanted: impl Fn((i32, i32)) -> bool) -> Vec<(i32, i32)> {
        let lattice = self.frame.search.micro_images.grid.lattice;
        let nodes = (0..lattice.rows).flat_map(|l| (0..lattice.columns).map(move |k| (k, l)));
        let mut taken = Vec::new();
        for (left, node) in self.left.iter_mut().zip(nodes) {
            if *left && wanted(node) {
                *left = false;
                taken.push(node);
            }
        }
        taken
    }

    /// Takes the micro-images near the observations, from index `first` on.
    fn take_about(&mut self, first: usize) -> Vec<(i32, i32)> {
        let micro_images = self.frame.search.micro_images;
        let reach = ABOUT * micro_images.grid.pitch_px;
        let mut taken = Vec::new();
        for i in first..self.observations.len() {
            for node in micro_images.about(&self.observations[i].center, reach) {
                let index = self.index(node);
                if std::mem::take(&mut self.left[index]) {
                    taken.push(node);
                }
            }
        }
        taken
    }

    /// Searches micro-images, each alone. Returns the previous number of observations.
    fn search(&mut self, mut nodes: Vec<(i32, i32)>) -> usize {
        let Self { frame, contrast, .. } = *self;
        let micro_images = frame.search.micro_images;
        let tile = |(k, l): (i32, i32)| (l / TILE, k / TILE);
        nodes.sort_by_key(|&node| tile(node));
        let tiles: Vec<&[(i32, i32)]> = nodes.chunk_by(|&a, &b| tile(a) == tile(b)).collect();
        let of_tile = |nodes: &&[(i32, i32)]| {
            let mut unusable = 0;
            let mut observations = Vec::new();
            let (mut patch, mut room) = (Patch::default(), Room::default());
            let mut fit_room = FitRoom::default();
            for &node in *nodes {
                if frame.read(node, &mut patch, &mut room).is_err() {
                    unusable += 1;
                    continue;
                }
                let optics = micro_images.optics(node.0, node.1);
                let corner = corner_alone(&patch, &optics, contrast, &mut fit_room);
                observations.extend(corner.map(|corner| frame.observation(node, &corner)));
            }
            (observations, unusable)
        };
        let found: Vec<(Vec<CornerObservation>, usize)> = tiles.par_iter().map(of_tile).collect();
        let before = self.observations.len();
        self.looked_at += nodes.len();
        for (observations, unusable) in found {
            self.observations.extend(observations);
            self.unusable += unusable;
        }
        before
    }
}

/// Returns true for one micro-image in four, spread evenly: every second one of every second row, staggered.
fn is_among_some(kind: LatticeKind, (k, l): (i32, i32)) -> bool {
    let (along, row) = match kind {
        LatticeKind::HexagonalColumns => (l, k),
        _ => (k, l),
    };
    row % 2 == 0 && (along - row / 2) % 2 == 0
}

/// Clusters observations, and sorts them into groups on lines.
pub(super) fn groups(
    frame: &Frame,
    observations: &[CornerObservation],
    counts: &mut FrameCounts,
) -> Vec<Group> {
    let micro_images = frame.search.micro_images;
    let pitch = micro_images.grid.pitch_px;
    let furthest = match micro_images.configuration {
        Configuration::Galilean => 1.0,
        _ => FURTHEST_BEFORE,
    };
    let places: Vec<Vector2<f64>> = observations.iter().map(|o| o.position).collect();
    let clusters = dbscan(&places, GAP * furthest * pitch, 2);
    let count = clusters.iter().flatten().max().map_or(0, |last| last + 1);
    let mut members = vec![Vec::new(); count];
    for (i, cluster) in clusters.iter().enumerate() {
        match cluster {
            Some(cluster) => members[*cluster].push(i),
            None => counts.alone += 1,
        }
    }
    counts.clusters = count;
    let line_search = LineSearch {
        tolerance_px: ROUGH * pitch,
        reach_px: micro_images.largest_outer_radius_px(),
        micro_image_pitch_px: pitch,
        configuration: micro_images.configuration,
    };
    let of_cluster = |members: &Vec<usize>| groups_on_lines(observations, members, &line_search);
    let groups: Vec<Vec<Group>> = members.par_iter().map(of_cluster).collect();
    for (members, groups) in members.iter().zip(&groups) {
        let on_line: usize = groups.iter().map(|g| g.members.len()).sum();
        let off_line = members.len() - on_line;
        if is_texture(off_line, on_line) {
            counts.texture += off_line;
        } else {
            counts.off_line += off_line;
        }
    }
    groups.into_iter().flatten().collect()
}

/// Returns the corner of a micro-image, if it clearly shows one.
fn corner_alone(
    patch: &Patch,
    optics: &MicroOptics,
    contrast: f64,
    room: &mut FitRoom,
) -> Option<Corner> {
    let reach = optics.outer_radius_px() - EDGE_PX;
    let clear = |corner: &Corner| {
        corner.place.norm() < reach
            && corner.explained > EXPLAINED
            && (LEAST_CONTRAST..MOST_CONTRAST).contains(&(corner.contrast.abs() / contrast))
            && corner.opening() > OPENING
            && corner.std_dev_px() < UNCERTAIN_PX
            && corner.imbalance(patch).is_some_and(|part| part < IMBALANCE)
    };
    saddles(patch, LEAST_CONTRAST * contrast)
        .iter()
        .filter(|corner| corner.place.norm() < reach)
        .take(STARTS)
        .filter_map(|corner| corner.fitted(patch, room))
        .find(clear)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::model::{Lattice, Packing, Parity};

    /// Checks that one in four is taken, and that no other is further than a pitch and a quarter from one of them.
    #[test]
    fn some_micro_images_are_spread_evenly() {
        for packing in [
            Packing::Orthogonal,
            Packing::HexagonalRows(Parity::Even),
            Packing::HexagonalRows(Parity::Odd),
            Packing::HexagonalColumns(Parity::Even),
            Packing::HexagonalColumns(Parity::Odd),
        ] {
            let lattice = Lattice { packing, columns: 24, rows: 20 };
            let nodes = || (0..20).flat_map(|l| (0..24).map(move |k| (k, l)));
            let some: Vec<_> = nodes().filter(|&n| is_among_some(lattice.kind(), n)).collect();
            assert_eq!(some.len(), 120);
            for (k, l) in nodes().filter(|(k, l)| (2..22).contains(k) && (2..18).contains(l)) {
                let distance =
                    |&(a, b): &(i32, i32)| (lattice.node(a, b) - lattice.node(k, l)).norm();
                let nearest = some.iter().map(distance).fold(f64::INFINITY, f64::min);
                assert!(nearest < 1.26, "({k}, {l}) of {packing:?}: {nearest}");
            }
        }
    }
}
