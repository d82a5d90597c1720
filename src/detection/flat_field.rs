//! Comparison of board images with the white image. If a square of the board fills a micro-image, its light is the white image
//! times a factor.
//!
//! Deviations are compared with the effects of a wrong black level, a tone curve, another aperture or a shift on the white
//! image w: a constant, w ln w, the change of w along the radius, and its gradient.

use nalgebra::{SMatrix, SVector};

use super::MicroImages;
use super::patch::USABLE;
use crate::finding::{Finding, Issue, Subject};
use crate::image::{Grey, Image, bounds};
use crate::numerics::median;

/// Fields: the white image, its Laplacian, which takes up the noise of both images, and the possible causes of deviations.
const FIELDS: usize = 9;
const WHITE: usize = 0;
const NOISE: usize = 1;
const BLACK: usize = 2;
const TONE: usize = 3;
const RADIUS: usize = 4;
const SHIFT: [usize; 2] = [5, 6];
const SCALE: usize = 7;
const TURN: usize = 8;

/// Number of micro-images that are compared.
const ENOUGH: usize = 600;
/// Smallest step between them.
const LEAST_STEP: usize = 3;
/// Smallest light of bright squares, from the darkest (0) to the brightest micro-images (1); and part of the micro-images left
/// out at both ends.
const BRIGHT: f64 = 0.6;
const TAIL: f64 = 0.02;
/// Largest residual of a micro-image that shows only one square, over a quantile of the residuals of bright ones; and this
/// quantile.
const EVEN: f64 = 1.2;
const MOST_EVEN: f64 = 0.05;
/// Smallest number of such micro-images, and of their pixels, for a comparison.
const FEWEST: usize = 8;
const FEWEST_PIXELS: usize = 60;
/// Variance of the read noise over the photon noise, as in the weights of patches.
const READ_NOISE: f64 = 0.25;
/// Smallest part of the deviation explained by all causes together that one cause has to explain.
const EXPLAINS: f64 = 0.7;
/// Limits of the difference of black levels, as a part of the light of a bright square, and of powers.
const BLACK_LIMIT: f64 = 0.02;
const TONE_LIMIT: f64 = 0.06;
/// Limit of the relative difference of pupils: f/4.1 for f/4.
const PUPIL_LIMIT: f64 = 0.03;
/// Limit of shifts, px, and of the shift at the corner of the image by scales and turns.
const SHIFT_LIMIT_PX: f64 = 0.1;
/// Multiple of these limits above which a single frame is reported.
const OF_ONE: f64 = 3.0;
/// Multiple of these limits above which one cause looks like another.
const STRANGE: f64 = 12.0;
const FEWEST_FRAMES: usize = 4;

type Matrix = SMatrix<f64, FIELDS, FIELDS>;
type Vector = SVector<f64, FIELDS>;

/// Sums over the pixels of micro-images that show only one square, each divided by its light.
#[derive(Debug, Clone)]
struct Sums {
    normal: Matrix,
    by: Vector,
    square: f64,
}

/// Comparison of a board's image with the white image.
#[derive(Debug, Clone)]
pub(super) struct Likeness {
    sums: Sums,
    /// Radius of the pupil, and half the diagonal of the image, px.
    pupil_px: f64,
    half_diagonal_px: f64,
}

/// Cause of a deviation from the white image: a field, and its coefficient.
#[derive(Debug, Clone, Copy)]
struct Difference {
    field: usize,
    value: SVector<f64, FIELDS>,
}

impl Likeness {
    /// Compares a board's image with the white image; `None` if too few micro-images show only one square.
    pub fn of(board: &Grey, white: &Grey, micro_images: &MicroImages) -> Option<Self> {
        if board.size() != white.size() {
            return None;
        }
        let lattice = &micro_images.grid.lattice;
        let nodes = (0..lattice.rows).flat_map(|l| (0..lattice.columns).map(move |k| (k, l)));
        let nodes: Vec<(i32, i32)> = nodes.collect();
        let step = (nodes.len() / ENOUGH).max(LEAST_STEP);
        let compared: Vec<Compared> = nodes
            .into_iter()
            .step_by(step)
            .filter_map(|node| Compared::of(board, white, micro_images, node))
            .collect();
        let at = |mut all: Vec<f64>, part: f64| {
            all.sort_by(f64::total_cmp);
            #[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss)]
            // a part of the length
            all.get((part * all.len() as f64) as usize).copied()
        };
        let light = || compared.iter().map(|c| c.light).collect();
        let (dark, bright) = (at(light(), TAIL)?, at(light(), 1.0 - TAIL)?);
        let is_bright = |c: &&Compared| c.light > dark + BRIGHT * (bright - dark);
        let left = compared.iter().filter(is_bright).map(|c| c.left).collect();
        let even = EVEN * at(left, MOST_EVEN)?;
        let all: Vec<&Compared> =
            compared.iter().filter(is_bright).filter(|c| c.left <= even).collect();
        if all.len() < FEWEST {
            return None;
        }
        let sums = all.iter().fold(Sums::none(), |sum, c| Sums {
            normal: sum.normal + c.sums.normal,
            by: sum.by + c.sums.by,
            square: sum.square + c.sums.square,
        });
        let (width, height) = board.size();
        let half_diagonal_px = (width as f64).hypot(height as f64) / 2.0;
        Some(Self { sums, pupil_px: micro_images.pupil_px(), half_diagonal_px })
    }

    /// Fits some fields besides the white image. Returns the remaining sum of squares, and the coefficients relative to the
    /// white image.
    fn fit(&self, fields: &[usize]) -> Option<(f64, Vector)> {
        let mut used = vec![WHITE, NOISE];
        used.extend(fields);
        let normal = self.sums.normal.select_rows(&used).select_columns(&used);
        let by = self.sums.by.select_rows(&used);
        let solution = normal.cholesky()?.solve(&by);
        let mut values = Vector::zeros();
        for (field, value) in used.iter().zip(solution.iter()) {
            values[*field] = value / solution[0];
        }
        Some((self.sums.square - by.dot(&solution), values))
    }

    /// Returns the single cause that explains the deviation best, if one does.
    fn difference(&self) -> Option<Difference> {
        let (without, _) = self.fit(&[])?;
        let all: Vec<usize> = (BLACK..FIELDS).collect();
        let (with_all, _) = self.fit(&all)?;
        let explanations: [&[usize]; 6] = [&[BLACK], &[TONE], &[RADIUS], &SHIFT, &[SCALE], &[TURN]];
        let fitted = explanations.iter().filter_map(|fields| Some((fields[0], self.fit(fields)?)));
        let (field, (left, value)) = fitted.min_by(|a, b| a.1.0.total_cmp(&b.1.0))?;
        (without - left > EXPLAINS * (without - with_all)).then_some(Difference { field, value })
    }

    /// Returns a difference in units of its limit.
    fn weight(&self, field: usize, value: &Vector) -> f64 {
        match field {
            BLACK => value[BLACK] / BLACK_LIMIT,
            TONE => value[TONE] / TONE_LIMIT,
            RADIUS => value[RADIUS] / (PUPIL_LIMIT * self.pupil_px),
            SCALE | TURN => value[field] * self.half_diagonal_px / SHIFT_LIMIT_PX,
            _ => value[SHIFT[0]].hypot(value[SHIFT[1]]) / SHIFT_LIMIT_PX,
        }
    }

    fn issue(&self, field: usize, value: &Vector) -> Issue {
        if self.weight(field, value).abs() > STRANGE {
            return Issue::UnlikeWhite;
        }
        match field {
            BLACK => Issue::OtherBlackLevel { difference: value[BLACK] },
            TONE => Issue::OtherToneCurve { power: 1.0 + value[TONE] },
            RADIUS => {
                // With a smaller pupil, the same brightness lies further inside.
                let pupil_px = (self.pupil_px - value[RADIUS]).max(0.1 * self.pupil_px);
                Issue::OtherAperture { ratio: self.pupil_px / pupil_px }
            }
            SCALE => Issue::OtherScale { scale: value[SCALE] },
            TURN => Issue::OtherRotation { angle_deg: value[TURN].to_degrees().abs() },
            _ => Issue::OtherOrigin { shift_px: [-value[SHIFT[0]], -value[SHIFT[1]]] },
        }
    }
}

/// Comparison of one micro-image of a board with the white image.
struct Compared {
    /// Light, relative to the white image.
    light: f64,
    /// Root mean square of the residuals of all fields, relative to the light.
    left: f64,
    sums: Sums,
}

impl Compared {
    fn of(board: &Grey, white: &Grey, all: &MicroImages, (k, l): (i32, i32)) -> Option<Self> {
        let (place, reach) = (all.center(k, l), all.grid.pitch_px / 2.0);
        let ((left, top, width, height), corner) = bounds(std::iter::once(place), reach + 2.0);
        let [board, white] = [board, white].map(|image| image.part(left, top, width, height));
        let (width, height) = (white.width, white.height);
        let center = place - corner;
        let inside = center.min() >= reach + 1.0
            && center.x + reach + 1.0 < width as f64 - 1.0
            && center.y + reach + 1.0 < height as f64 - 1.0;
        if !inside {
            return None;
        }
        let at = |u: usize, v: usize| f64::from(white.pixels[v * width + u]);
        let pixels = (1..height - 1).flat_map(|v| (1..width - 1).map(move |u| (u, v)));
        let off = |&(u, v): &(usize, usize)| (u as f64 - center.x).hypot(v as f64 - center.y);
        let pixels: Vec<(usize, usize)> = pixels.filter(|pixel| off(pixel) < reach).collect();
        let brightest = pixels.iter().map(|&(u, v)| at(u, v)).fold(0.0, f64::max);
        // Noise in the slopes makes shifts too small; the mean of both images has half the noise variance of one.
        let sum = |image: &Image| -> f64 {
            pixels.iter().map(|&(u, v)| f64::from(image.pixels[v * width + u])).sum()
        };
        let (of_white, of_board) = (0.5, 0.5 * sum(&white) / sum(&board).max(f64::MIN_POSITIVE));
        let both = |u: usize, v: usize| {
            of_white * at(u, v) + of_board * f64::from(board.pixels[v * width + u])
        };
        let (from_middle, mut sums) = (place - all.middle(), Sums::none());
        let mut kept = 0;
        for pixel @ &(u, v) in &pixels {
            let (w, b) = (at(u, v), f64::from(board.pixels[v * width + u]));
            if w < f64::from(USABLE) * brightest || w >= 1.0 || b >= 1.0 {
                continue;
            }
            let (du, dv) =
                ((both(u + 1, v) - both(u - 1, v)) / 2.0, (both(u, v + 1) - both(u, v - 1)) / 2.0);
            let laplacian = at(u + 1, v) + at(u - 1, v) + at(u, v + 1) + at(u, v - 1) - 4.0 * w;
            let (x, y) = (u as f64 - center.x, v as f64 - center.y);
            let along_radius = (du * x + dv * y) / off(pixel).max(1.0);
            let fields = Vector::from([
                w,
                laplacian,
                brightest,
                w * (w / brightest).ln(),
                along_radius,
                du,
                dv,
                du * from_middle.x + dv * from_middle.y,
                dv * from_middle.x - du * from_middle.y,
            ]);
            sums.add(&(fields / brightest), b / brightest, 1.0 / (w / brightest + READ_NOISE));
            kept += 1;
        }
        if kept < FEWEST_PIXELS {
            return None;
        }
        let light = sums.by[WHITE] / sums.normal[(WHITE, WHITE)];
        let solution = sums.normal.cholesky()?.solve(&sums.by);
        let left = (sums.square - sums.by.dot(&solution)).max(0.0) / kept as f64;
        Some(Self { light, left: left.sqrt() / light, sums: sums.scaled(1.0 / light) })
            .filter(|_| light > 0.0)
    }
}

impl Sums {
    fn none() -> Self {
        Self { normal: Matrix::zeros(), by: Vector::zeros(), square: 0.0 }
    }

    fn add(&mut self, fields: &Vector, board: f64, weight: f64) {
        self.normal += fields * fields.transpose() * weight;
        self.by += fields * (board * weight);
        self.square += board * board * weight;
    }

    /// Returns the sums of an image that is brighter by a factor.
    fn scaled(self, factor: f64) -> Self {
        Self { by: self.by * factor, square: self.square * factor * factor, ..self }
    }
}

/// Frame by its number and name, with the comparison of its light.
pub(super) type ComparedFrame<'a> = (u32, &'a str, &'a Likeness);

/// Returns findings about frames that deviate from the white image: one about most of them, or one about each.
pub(super) fn unlike(all: &[ComparedFrame]) -> Vec<Finding> {
    let weighty = |(_, _, likeness): &ComparedFrame, limit: f64| {
        let Difference { field, value } = likeness.difference()?;
        (likeness.weight(field, &value).abs() > limit).then_some((field, value))
    };
    let found: Vec<Option<(usize, Vector)>> = all.iter().map(|one| weighty(one, 1.0)).collect();
    let usual = (BLACK..FIELDS).max_by_key(|field| of_field(&found, *field).count());
    if let Some(field) = usual
        && 2 * of_field(&found, field).count() > all.len()
    {
        let values: Vec<Vector> = of_field(&found, field).collect();
        let middle = Vector::from_fn(|row, _| median(values.iter().map(|v| v[row])).unwrap_or(0.0));
        let boards = Subject::Part("boards differ from the white image".to_owned());
        return vec![Finding::caution(all[0].2.issue(field, &middle)).about(boards)];
    }
    if all.len() < FEWEST_FRAMES {
        return Vec::new();
    }
    let of_one = |one @ (frame, name, likeness): &ComparedFrame| {
        let (field, value) = weighty(one, OF_ONE)?;
        Some(Finding::note(likeness.issue(field, &value)).about_frame(*frame, Some(name)))
    };
    all.iter().filter_map(of_one).collect()
}

fn of_field(found: &[Option<(usize, Vector)>], field: usize) -> impl Iterator<Item = Vector> {
    found.iter().flatten().filter(move |(f, _)| *f == field).map(|(_, value)| *value)
}
