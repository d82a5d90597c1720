//! Observations of a cluster, sorted into corners by common lines.

use super::CornerObservation;
use super::line::{CornerLine, possible_slope};
use crate::model::Configuration;

/// Observations on a common line, as indices.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Group {
    /// Indices of the observations.
    pub members: Vec<usize>,
    /// Line of the observations.
    pub line: CornerLine,
}

/// Common properties of the observations of one corner.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct LineSearch {
    /// Largest distance from their line, px.
    pub tolerance_px: f64,
    /// Largest distance of a corner from the centre of a micro-image that shows it, px.
    pub reach_px: f64,
    /// Distance Δc of neighbouring micro-image centres, px.
    pub micro_image_pitch_px: f64,
    /// Configuration of the camera.
    pub configuration: Configuration,
}

/// Largest number of pairs of observations that lines are tried through: of a whole cluster, and of a part of one.
const MOST_PAIRS: usize = 4000;
const MOST_PAIRS_OF_PART: usize = 1000;
/// Number of observations that a line is sought among, the nearest ones to one of them. Clusters of neighbouring corners merge
/// if squares are as small as the spread of a corner, and then have thousands of observations.
const AT_ONCE: usize = 500;
/// Number of them that is given up if there is no line among them.
const GIVEN_UP: usize = 100;
/// Number of observations below which lines in large clusters arise by chance.
const STURDY: usize = 4;
/// Number of observations off such lines, and its ratio to the number on them, from which the cluster is texture.
const TEXTURE: usize = 1000;
const TEXTURE_RATIO: usize = 9;
/// Fewest observations on a line.
const FEWEST: usize = 2;
/// Part of the micro-images that should show a corner which must do so: with fewer, its line arises by chance. The nearer γ is
/// to 1, the more micro-images should show it.
const LEAST_SHOWN: f64 = 0.06;

impl LineSearch {
    /// Returns the approximate number of micro-images that show a corner with this slope: their centres lie within
    /// reach/|1 − γ| of its pinhole image.
    fn shown_in(&self, slope: f64) -> f64 {
        std::f64::consts::PI * (self.spread(slope) / self.micro_image_pitch_px).powi(2)
    }

    /// Returns the largest distance from the pinhole image to the centre of a micro-image that shows it, px.
    fn spread(&self, slope: f64) -> f64 {
        self.reach_px / (1.0 - slope).abs()
    }

    /// Returns the line through two observations, if both can be of one corner.
    fn through(&self, a: &CornerObservation, b: &CornerObservation) -> Option<CornerLine> {
        let (baseline, moved) = (a.center - b.center, a.position - b.position);
        // The slope is NaN for two observations in one micro-image.
        let slope = moved.dot(&baseline) / baseline.norm_squared();
        let possible = possible_slope(slope, self.configuration)
            && baseline.norm() < 2.0 * self.spread(slope)
            && (moved - baseline * slope).norm() < 2.0 * self.tolerance_px;
        let start = (a.position + b.position - (a.center + b.center) * slope) / 2.0;
        possible.then(|| CornerLine::exact(start, slope))
    }

    fn is_on(&self, line: &CornerLine, observation: &CornerObservation) -> bool {
        (observation.position - line.at(&observation.center)).norm_squared()
            <= self.tolerance_px.powi(2)
    }

    /// Returns the observations, of some, that are on a line.
    fn members(
        &self,
        line: &CornerLine,
        observations: &[CornerObservation],
        among: &[usize],
    ) -> Vec<usize> {
        among.iter().copied().filter(|&i| self.is_on(line, &observations[i])).collect()
    }

    /// Returns the members of the line through two of some observations that has most members.
    fn best_line(
        &self,
        observations: &[CornerObservation],
        near: &[usize],
        is_part: bool,
    ) -> Option<Vec<usize>> {
        let pairs =
            near.iter().enumerate().flat_map(|(n, &a)| near[..n].iter().map(move |&b| (a, b)));
        let lines: Vec<CornerLine> =
            pairs.filter_map(|(a, b)| self.through(&observations[a], &observations[b])).collect();
        let most = if is_part { MOST_PAIRS_OF_PART } else { MOST_PAIRS };
        let step = lines.len().div_ceil(most).max(1);
        let count = |line: &CornerLine| {
            near.iter().filter(|&&i| self.is_on(line, &observations[i])).count()
        };
        lines
            .iter()
            .step_by(step)
            .map(|line| (count(line), line))
            .filter(|(members, line)| self.is_enough(*members, line.slope))
            .max_by_key(|(members, _)| *members)
            .map(|(_, line)| self.members(line, observations, near))
    }

    fn is_enough(&self, members: usize, slope: f64) -> bool {
        members >= FEWEST
            && members as f64 >= LEAST_SHOWN * self.shown_in(slope)
            && possible_slope(slope, self.configuration)
    }
}

/// Returns true if the observations of a cluster that are on no line are texture, rather than false corners among true ones.
pub(super) fn is_texture(off_line: usize, on_line: usize) -> bool {
    off_line >= TEXTURE && off_line >= TEXTURE_RATIO * on_line
}

/// Sorts the observations of a cluster into groups with a common line. The first is the line through two observations that has
/// most members; the rest is sorted in the same way. Observations on no line are in no group.
///
/// A large cluster is searched in parts, so that the time grows at most as the square of its size. Texture, where lines of two
/// or three observations arise by chance, is given up.
pub(super) fn groups_on_lines(
    observations: &[CornerObservation],
    cluster: &[usize],
    search: &LineSearch,
) -> Vec<Group> {
    let mut groups: Vec<Group> = Vec::new();
    let (mut on_line, mut off_line) = (0, 0);
    let mut left = cluster.to_vec();
    while left.len() >= FEWEST && !is_texture(off_line, on_line) {
        let is_part = left.len() > AT_ONCE;
        if is_part {
            let first = observations[left[0]].center;
            let away = |i: &usize| (observations[*i].center - first).norm();
            left.select_nth_unstable_by(AT_ONCE, |a, b| away(a).total_cmp(&away(b)));
            left[..AT_ONCE].sort_by(|a, b| away(a).total_cmp(&away(b)));
        }
        let near = &left[..left.len().min(AT_ONCE)];
        let Some(best) = search.best_line(observations, near, is_part) else {
            if !is_part {
                break;
            }
            left.drain(..GIVEN_UP);
            off_line += GIVEN_UP;
            continue;
        };
        // The line that fits all of them may gain members, and lose some.
        let fitted = CornerLine::fit(best.iter().map(|&i| observations[i]));
        let members =
            fitted.map_or_else(Vec::new, |line| search.members(&line, observations, &left));
        let line = CornerLine::fit(members.iter().map(|&i| observations[i]));
        let line = line.filter(|line| search.is_enough(members.len(), line.slope));
        if let Some(line) = line {
            left.retain(|i| !members.contains(i));
            if members.len() >= STURDY {
                on_line += members.len();
            } else {
                off_line += members.len();
            }
            groups.push(Group { members, line });
        } else {
            left.retain(|i| !best.contains(i));
            off_line += best.len();
        }
    }
    if is_texture(off_line, on_line) {
        groups.retain(|group| group.members.len() >= STURDY);
    }
    groups
}

#[cfg(test)]
mod tests {
    use nalgebra::{Matrix2, Vector2};

    use super::super::line::tests::observations;
    use super::*;

    #[test]
    fn merged_clusters_become_two_lines() {
        let mut both = observations(Vector2::new(500.0, 370.0), 0.75);
        both.extend(observations(Vector2::new(540.0, 376.0), 0.74));
        let all: Vec<usize> = (0..both.len()).collect();
        let behind = LineSearch {
            tolerance_px: 0.8,
            reach_px: 10.0,
            micro_image_pitch_px: 20.0,
            configuration: Configuration::Galilean,
        };
        let groups = groups_on_lines(&both, &all, &behind);
        let mut places: Vec<f64> = groups.iter().take(2).map(|g| g.line.pinhole().x).collect();
        places.sort_by(f64::total_cmp);
        assert!((places[0] - 500.0).abs() < 2.0 && (places[1] - 540.0).abs() < 2.0, "{places:?}");
        assert!(groups[0].members.len() > 20 && groups[1].members.len() > 20);
        // Behind the array, neighbours see a point closer together; in front of it, further apart.
        let before = LineSearch { configuration: Configuration::Keplerian, ..behind };
        let before = groups_on_lines(&both, &all, &before);
        assert!(before.iter().all(|g| g.line.slope > 1.0 && g.members.len() < 10));
    }

    /// Checks corners that are in 60 micro-images each, if every micro-image shows one of the corners within reach.
    #[test]
    fn corners_of_a_merged_cluster_are_told_apart() {
        const SIDE: i32 = 80;
        let slope = 0.885;
        let corner = |x: i32, y: i32| {
            Vector2::new(f64::from(x), f64::from(y)) * 105.0 + Vector2::new(64.3, 57.9)
        };
        let nodes = (0..SIDE).flat_map(|l| (0..SIDE).map(move |k| (k, l)));
        let shown = nodes.filter_map(|(k, l)| {
            let center = Vector2::new(f64::from(k), f64::from(l)) * 20.0;
            let (x, y) = ((k * 13 + l * 7) % 15, (k * 5 + l * 11) % 15);
            // The micro-image shows the first visible corner after an arbitrary one.
            (0..225).map(|n| ((x + n % 15) % 15, (y + n / 15) % 15)).find_map(|(x, y)| {
                let line = CornerLine::through(&corner(x, y), slope);
                let position = line.at(&center);
                let off = Vector2::new(f64::from((k * 7 + l * 3) % 5), f64::from((k + l * 4) % 3));
                ((position - center).norm() < 10.0).then_some(CornerObservation {
                    k,
                    l,
                    center,
                    position: position + off * 0.02,
                    covariance: Matrix2::identity() * 0.0025,
                    squares: Matrix2::zeros(),
                })
            })
        });
        let mut all: Vec<CornerObservation> = shown.collect();
        let search = LineSearch {
            tolerance_px: 0.8,
            reach_px: 10.0,
            micro_image_pitch_px: 20.0,
            configuration: Configuration::Galilean,
        };
        let cluster: Vec<usize> = (0..all.len()).collect();
        assert!(cluster.len() > 5000, "{}", cluster.len());
        let groups = groups_on_lines(&all, &cluster, &search);
        let members: usize = groups.iter().map(|g| g.members.len()).sum();
        let found = (0..225).filter(|n| {
            let true_place = corner(n % 15, n / 15);
            groups.iter().any(|g| (g.line.pinhole() - true_place).norm() < 2.0)
        });
        assert_eq!(found.count(), 225);
        assert!(members * 100 > 98 * all.len(), "{members} of {}", all.len());
        assert!(!is_texture(all.len() - members, members));

        // Texture has corners anywhere.
        for (n, observation) in (0_u32..).zip(&mut all) {
            let turn = f64::from(n) * 2.399_963;
            observation.position = observation.center
                + 9.0 * f64::from(n % 97).sqrt() / 10.0 * Vector2::new(turn.cos(), turn.sin());
        }
        let groups = groups_on_lines(&all, &cluster, &search);
        let members: usize = groups.iter().map(|g| g.members.len()).sum();
        assert!(is_texture(all.len() - members, members), "{members} of {}", all.len());
    }
}
