//! The line that all sights of one corner lie on.
//!
//! Micro-lens (k, l) with its micro-image about c shows a point at i = β + γ c: the same β and slope γ
//! in all micro-images, γ = λ (1 − 1/ν) with λ = D/(D + d). Where i = c the point is seen through the
//! middle of the main lens: its pinhole image.

use nalgebra::{Matrix3, Matrix3x2, Vector2, Vector3};

use super::Sight;
use crate::model::Configuration;

/// i = β + γ c.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SightLine {
    /// β, px.
    pub start: Vector2<f64>,
    /// γ.
    pub slope: f64,
    /// Standard deviation of γ: by the uncertainty that sights state or their scatter about the line,
    /// whichever is larger.
    pub slope_std_dev: f64,
    /// Root mean square distance of the sights that count, px.
    pub rms_px: f64,
}

/// Sights beyond so many robust standard deviations lose their weight.
const OUTLIER_SCALES: f64 = 4.0;
/// The robust standard deviation is not taken below this, px: nothing is measured better.
const MIN_SCALE_PX: f64 = 0.03;
/// Reweighted fits settle in a few rounds.
const ROUNDS: usize = 20;
/// Median of the length of a 2-D Gaussian vector over its per-axis standard deviation.
const MEDIAN_LENGTH_2D: f64 = 1.177_410_022_515_474_7;
/// |1 − γ| that can be told from 0 and from micro-images that do not overlap.
const INVERSE_DEPTHS: std::ops::Range<f64> = 0.02..0.98;

impl SightLine {
    /// Where the point is seen in the micro-image about `center`, px.
    #[must_use]
    pub fn at(&self, center: &Vector2<f64>) -> Vector2<f64> {
        self.start + center * self.slope
    }

    /// Pinhole image of the point: where a ray through the middles of main lens and a micro-lens
    /// would meet the sensor, px.
    #[must_use]
    pub fn pinhole(&self) -> Vector2<f64> {
        self.start / (1.0 - self.slope)
    }

    /// 1/ν = 1 − γ/λ, Eq. (virtdepth).
    #[must_use]
    pub fn inverse_virtual_depth(&self, lambda: f64) -> f64 {
        1.0 - self.slope / lambda
    }

    /// The line through a pinhole image.
    #[must_use]
    pub fn through(pinhole: &Vector2<f64>, slope: f64) -> Self {
        Self::exact(pinhole * (1.0 - slope), slope)
    }

    /// The line with these parameters.
    fn exact(start: Vector2<f64>, slope: f64) -> Self {
        Self { start, slope, slope_std_dev: 0.0, rms_px: 0.0 }
    }

    /// Fits the line robustly; `None` if the sights are of a single micro-image.
    #[must_use]
    #[allow(clippy::needless_pass_by_value)] // an iterator, cloned for every pass
    pub fn fit<'a>(sights: impl Iterator<Item = &'a Sight> + Clone) -> Option<Self> {
        let count = sights.clone().count();
        let middle = sights.clone().map(|s| s.center).sum::<Vector2<f64>>() / count as f64;
        let mut weights: Vec<f64> = sights.clone().map(|s| s.std_dev_px.powi(-2)).collect();
        let mut line = None;
        for _ in 0..ROUNDS {
            let (mut normal, mut right) = (Matrix3::zeros(), Vector3::zeros());
            for (sight, &weight) in sights.clone().zip(&weights) {
                let c = sight.center - middle;
                let rows = Matrix3x2::new(1.0, 0.0, 0.0, 1.0, c.x, c.y);
                normal += rows * rows.transpose() * weight;
                right += rows * sight.position * weight;
            }
            let inverse = normal.try_inverse().filter(|_| {
                normal[(2, 2)] * normal[(0, 0)] > 1e-6 * normal[(0, 0)].powi(2) && count > 1
            })?;
            let solution = inverse * right;
            let slope = solution.z;
            let start = solution.xy() - middle * slope;
            let next = Self::exact(start, slope);
            let lengths: Vec<f64> =
                sights.clone().map(|s| (s.position - next.at(&s.center)).norm()).collect();
            let mut sorted = lengths.clone();
            let median = *sorted.select_nth_unstable_by(count / 2, f64::total_cmp).1;
            let scale = (median / MEDIAN_LENGTH_2D).max(MIN_SCALE_PX);
            let weight = |(sight, length): (&Sight, &f64)| {
                let x = length / (OUTLIER_SCALES * scale);
                let tukey = if x < 1.0 { (1.0 - x * x).powi(2) } else { 0.0 };
                tukey * sight.std_dev_px.powi(-2)
            };
            weights = sights.clone().zip(&lengths).map(weight).collect();
            let used = lengths.iter().filter(|&&l| l < OUTLIER_SCALES * scale);
            let square: f64 = used.clone().map(|l| l * l).sum();
            let used = used.count() as f64;
            // Of two coordinates each, three go into the line. Weights are in 1/px²: what they leave
            // over tells how much larger the errors are.
            let freedom = (2.0 * used - 3.0).max(1.0);
            let weighted: f64 = sights
                .clone()
                .zip(&lengths)
                .filter(|&(_, &l)| l < OUTLIER_SCALES * scale)
                .map(|(s, l)| (l / s.std_dev_px).powi(2))
                .sum();
            // Few sights may agree by chance, which makes them no better than they are.
            let factor = (weighted / freedom).max(1.0);
            let settled = line.is_some_and(|last: Self| (last.slope - slope).abs() < 1e-10);
            line = Some(Self {
                slope_std_dev: (inverse[(2, 2)] * factor).max(0.0).sqrt(),
                rms_px: (square / used.max(1.0)).sqrt(),
                ..next
            });
            if settled {
                break;
            }
        }
        line.filter(|l| l.slope.is_finite() && l.start.iter().all(|x| x.is_finite()))
    }
}

/// Slopes that a point can have: behind the array (Galilean) neighbouring micro-images show it closer
/// together than they are, before it (Keplerian) further apart.
#[must_use]
pub fn possible_slope(slope: f64, configuration: Configuration) -> bool {
    match configuration {
        Configuration::Galilean => INVERSE_DEPTHS.contains(&(1.0 - slope)),
        Configuration::Keplerian => INVERSE_DEPTHS.contains(&(slope - 1.0)),
        Configuration::Unfocused => INVERSE_DEPTHS.contains(&(1.0 - slope).abs()),
    }
}

/// 1/ν as the paper has it: the median of Eq. (virtdepth) over all pairs of sights, with λ = 1. Of an
/// even number of pairs the upper one of the middle, as COMPOTE has it; `None` for a single sight.
#[must_use]
pub fn median_inverse_virtual_depth(sights: &[Sight]) -> Option<f64> {
    let mut depths = Vec::new();
    for (n, a) in sights.iter().enumerate() {
        for b in &sights[..n] {
            let baseline = (a.center - b.center).norm();
            let disparity = baseline - (a.position - b.position).norm();
            if baseline > 0.0 && disparity != 0.0 {
                depths.push(baseline / disparity);
            }
        }
    }
    let middle = depths.len() / 2;
    (!depths.is_empty()).then(|| 1.0 / *depths.select_nth_unstable_by(middle, f64::total_cmp).1)
}

/// Sights of the same line, as indices.
#[derive(Debug, Clone, PartialEq)]
pub struct Group {
    /// Members.
    pub members: Vec<usize>,
    /// Their line.
    pub line: SightLine,
}

/// What sights of one corner have in common.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct LineSearch {
    /// How far from their line they are at most, px.
    pub tolerance_px: f64,
    /// How far from the centre of a micro-image a corner shows at most, px.
    pub reach_px: f64,
    /// Pitch of the micro-images, px.
    pub pitch_px: f64,
    /// Behind or before the array.
    pub configuration: Configuration,
}

/// Pairs of sights that a line is tried through.
const MOST_PAIRS: usize = 4000;
const MOST_PAIRS_OF_PART: usize = 1000;
/// Sights that a line is looked for among, those about one of them: clusters of neighbouring corners
/// merge where the squares are as small as a corner's spread, and hold thousands.
const AT_ONCE: usize = 500;
/// About a sight without a line so many are given up.
const GIVEN_UP: usize = 100;
/// Two or three sights are on a line by chance where there are many.
const STURDY: usize = 4;
/// If so many sights are on no such line, and so many times as many as are, the rest is texture.
const TEXTURE: usize = 1000;
const TEXTURE_RATIO: usize = 9;
/// Fewest sights of a line.
const FEWEST: usize = 2;
/// A line on which fewer of the micro-images that should show its corner do so is chance: the flatter
/// it is the more of them there are.
const LEAST_SHOWN: f64 = 0.06;

impl LineSearch {
    /// Number of micro-images, about, that show a corner with this slope: those with a centre within
    /// reach/|1 − γ| of its pinhole image.
    fn shown_in(&self, slope: f64) -> f64 {
        std::f64::consts::PI * (self.spread(slope) / self.pitch_px).powi(2)
    }

    /// How far from the pinhole image the centres of micro-images are that show it, px.
    fn spread(&self, slope: f64) -> f64 {
        self.reach_px / (1.0 - slope).abs()
    }

    /// The line through two sights, if both can be of one corner.
    fn through(&self, a: &Sight, b: &Sight) -> Option<SightLine> {
        let (baseline, moved) = (a.center - b.center, a.position - b.position);
        // Not a number for two sights in one micro-image.
        let slope = moved.dot(&baseline) / baseline.norm_squared();
        let possible = possible_slope(slope, self.configuration)
            && baseline.norm() < 2.0 * self.spread(slope)
            && (moved - baseline * slope).norm() < 2.0 * self.tolerance_px;
        let start = (a.position + b.position - (a.center + b.center) * slope) / 2.0;
        possible.then(|| SightLine::exact(start, slope))
    }

    fn is_on(&self, line: &SightLine, sight: &Sight) -> bool {
        (sight.position - line.at(&sight.center)).norm_squared() <= self.tolerance_px.powi(2)
    }

    fn is_enough(&self, members: usize, slope: f64) -> bool {
        members >= FEWEST
            && members as f64 >= LEAST_SHOWN * self.shown_in(slope)
            && possible_slope(slope, self.configuration)
    }
}

/// Whether sights of a cluster that are on no line are of texture, rather than false corners among true
/// ones.
pub(super) fn is_texture(off_line: usize, on_line: usize) -> bool {
    off_line >= TEXTURE && off_line >= TEXTURE_RATIO * on_line
}

/// Sorts sights into groups with a common line: the line through some two of them that most others
/// are on, then what is left, and so on. Sights on no line are in no group.
///
/// Of a large cluster a part is looked at at a time, so that the time it takes grows as the square of
/// its size at most; texture, which has lines of two or three sights by chance only, is given up.
#[must_use]
pub fn groups_on_lines(sights: &[Sight], cluster: &[usize], search: &LineSearch) -> Vec<Group> {
    let mut groups: Vec<Group> = Vec::new();
    let (mut on_line, mut off_line) = (0, 0);
    let mut left = cluster.to_vec();
    while left.len() >= FEWEST && !is_texture(off_line, on_line) {
        let is_part = left.len() > AT_ONCE;
        if is_part {
            let first = sights[left[0]].center;
            let away = |i: &usize| (sights[*i].center - first).norm();
            left.select_nth_unstable_by(AT_ONCE, |a, b| away(a).total_cmp(&away(b)));
            left[..AT_ONCE].sort_by(|a, b| away(a).total_cmp(&away(b)));
        }
        let near = &left[..left.len().min(AT_ONCE)];
        let on = |line: &SightLine, among: &[usize]| -> Vec<usize> {
            among.iter().copied().filter(|&i| search.is_on(line, &sights[i])).collect()
        };
        let pairs =
            near.iter().enumerate().flat_map(|(n, &a)| near[..n].iter().map(move |&b| (a, b)));
        let lines: Vec<SightLine> =
            pairs.filter_map(|(a, b)| search.through(&sights[a], &sights[b])).collect();
        let most = if is_part { MOST_PAIRS_OF_PART } else { MOST_PAIRS };
        let step = lines.len().div_ceil(most).max(1);
        let count =
            |line: &SightLine| near.iter().filter(|&&i| search.is_on(line, &sights[i])).count();
        let best = lines
            .iter()
            .step_by(step)
            .map(|line| (count(line), line))
            .filter(|(members, line)| search.is_enough(*members, line.slope))
            .max_by_key(|(members, _)| *members)
            .map(|(_, line)| on(line, near));
        let Some(best) = best else {
            if !is_part {
                break;
            }
            left.drain(..GIVEN_UP);
            off_line += GIVEN_UP;
            continue;
        };
        // The fit to all of them may win some more, and lose some.
        let fitted = SightLine::fit(best.iter().map(|&i| &sights[i]));
        let members = fitted.map_or_else(Vec::new, |line| on(&line, &left));
        let line = SightLine::fit(members.iter().map(|&i| &sights[i]));
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
    use nalgebra::Matrix2;

    use super::*;

    /// Sights of a point on a square array of pitch 20, off by a little.
    fn sights(pinhole: Vector2<f64>, slope: f64) -> Vec<Sight> {
        let line = SightLine::through(&pinhole, slope);
        let mut sights = Vec::new();
        for (k, l) in (-2..=2).flat_map(|l| (-2..=2).map(move |k| (k, l))) {
            let center = Vector2::new(f64::from(k), f64::from(l)) * 20.0 + pinhole.map(f64::round);
            let noise =
                Vector2::new(f64::from((k * 7 + l * 3) % 5), f64::from((k + l * 4) % 3)) * 0.02;
            sights.push(Sight {
                k,
                l,
                center,
                position: line.at(&center) + noise,
                std_dev_px: 0.05,
                squares: Matrix2::zeros(),
            });
        }
        sights
    }

    #[test]
    fn a_line_comes_back_and_says_how_well() {
        let pinhole = Vector2::new(503.2, 377.9);
        let mut seen = sights(pinhole, 0.75);
        // Two false ones have no say.
        seen[3].position += Vector2::new(4.0, -2.0);
        seen[17].position += Vector2::new(-3.0, 5.0);
        let line = SightLine::fit(seen.iter()).unwrap();
        // Errors of up to 0.08 px over 80 px.
        assert!((line.slope - 0.75).abs() < 1e-3, "{}", line.slope);
        assert!((1e-5..2e-3).contains(&line.slope_std_dev), "{}", line.slope_std_dev);
        assert!((line.pinhole() - pinhole).norm() < 0.5, "{}", line.pinhole());
        assert!((line.inverse_virtual_depth(1.0) - 0.25).abs() < 1e-3);
        assert!(SightLine::fit(seen[..1].iter()).is_none());
    }

    /// By hand: micro-images 20 px apart that show the point 15 px apart have ν = 4.
    #[test]
    fn the_median_over_pairs_is_that_of_the_disparity() {
        let inverse = median_inverse_virtual_depth(&sights(Vector2::new(500.0, 370.0), 0.75));
        assert!((inverse.unwrap() - 0.25).abs() < 2e-3);
        assert!(median_inverse_virtual_depth(&[]).is_none());
    }

    #[test]
    fn merged_clusters_become_two_lines() {
        let mut both = sights(Vector2::new(500.0, 370.0), 0.75);
        both.extend(sights(Vector2::new(540.0, 376.0), 0.74));
        let all: Vec<usize> = (0..both.len()).collect();
        let behind = LineSearch {
            tolerance_px: 0.8,
            reach_px: 10.0,
            pitch_px: 20.0,
            configuration: Configuration::Galilean,
        };
        let groups = groups_on_lines(&both, &all, &behind);
        let mut places: Vec<f64> = groups.iter().take(2).map(|g| g.line.pinhole().x).collect();
        places.sort_by(f64::total_cmp);
        assert!((places[0] - 500.0).abs() < 2.0 && (places[1] - 540.0).abs() < 2.0, "{places:?}");
        assert!(groups[0].members.len() > 20 && groups[1].members.len() > 20);
        // Behind the array neighbours see a point closer together, before it further apart.
        let before = LineSearch { configuration: Configuration::Keplerian, ..behind };
        let before = groups_on_lines(&both, &all, &before);
        assert!(before.iter().all(|g| g.line.slope > 1.0 && g.members.len() < 10));
        assert!(possible_slope(0.75, Configuration::Galilean));
        assert!(!possible_slope(1.25, Configuration::Galilean));
        assert!(possible_slope(1.25, Configuration::Keplerian));
        assert!(!possible_slope(f64::NAN, Configuration::Unfocused));
    }

    /// Two sights that happen to agree are as uncertain as they state.
    #[test]
    fn chance_agreement_is_not_certainty() {
        let mut seen = sights(Vector2::new(500.0, 370.0), 0.75);
        let line = SightLine::through(&Vector2::new(500.0, 370.0), 0.75);
        seen.truncate(2);
        for sight in &mut seen {
            sight.position = line.at(&sight.center);
        }
        let line = SightLine::fit(seen.iter()).unwrap();
        // 0.05 px each, 20 px apart.
        assert!((line.slope_std_dev - 0.05 * 2.0_f64.sqrt() / 20.0).abs() < 1e-9);
    }

    /// A corner shows in 60 micro-images, and each micro-image shows one of the corners within reach.
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
            // From anywhere, the first corner that shows.
            (0..225).map(|n| ((x + n % 15) % 15, (y + n / 15) % 15)).find_map(|(x, y)| {
                let line = SightLine::through(&corner(x, y), slope);
                let position = line.at(&center);
                let off = Vector2::new(f64::from((k * 7 + l * 3) % 5), f64::from((k + l * 4) % 3));
                ((position - center).norm() < 10.0).then_some(Sight {
                    k,
                    l,
                    center,
                    position: position + off * 0.02,
                    std_dev_px: 0.05,
                    squares: Matrix2::zeros(),
                })
            })
        });
        let mut all: Vec<Sight> = shown.collect();
        let search = LineSearch {
            tolerance_px: 0.8,
            reach_px: 10.0,
            pitch_px: 20.0,
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
        for (n, sight) in (0_u32..).zip(&mut all) {
            let turn = f64::from(n) * 2.399_963;
            sight.position = sight.center
                + 9.0 * f64::from(n % 97).sqrt() / 10.0 * Vector2::new(turn.cos(), turn.sin());
        }
        let groups = groups_on_lines(&all, &cluster, &search);
        let members: usize = groups.iter().map(|g| g.members.len()).sum();
        assert!(is_texture(all.len() - members, members), "{members} of {}", all.len());
    }
}
