//! Focus distance of the main lens as the boards show it: as a start, and to check the stated one.
//!
//! The slope of the line of a corner, γ = 1 − 1/ν = 1 + d/a, shows its virtual depth and so the position of its image,
//! a = D − b before the array. The pose of its board, from the barycentres, gives the distance z of the corner, and
//! with F the position that its image should have, b = Fz/(z − F). D and d follow from the focus distance h, F and m;
//! the pose grows with D + d. So one number, h, has to make both agree.

use std::collections::BTreeMap;

use crate::calibration::poses::poses_of_board;
use crate::calibration::{CalibrationOptions, Start};
use crate::finding::{Finding, Issue};

use crate::model::{
    BapFeature, Board, Datasheet, InternalParameters, Parameter, PlenopticCamera, optics,
};
use crate::numerics::median;

/// Largest focus distance that is tried, in F. The distances begin at the nearest that a lens can be focused at (4F),
/// and grow in equal ratios.
const FARTHEST: f64 = 1000.0;
const TRIALS: u32 = 300;
/// Relative difference of D up to which the stated focus distance stands; thin lenses and poses from barycentres are no
/// better. A difference of up to twice as much may be due to F, and raises no warning.
const AGREES: f64 = 0.015;
const REMARKABLE: f64 = 0.03;
/// Mismatch of the virtual depths, relative to the best focus distance, up to which the stated one stands as well.
const AS_WELL: f64 = 1.5;
/// Fewest corners that determine a focus distance.
const FEWEST: usize = 20;

/// Corner: γ, and its distance from the main lens over D + d.
struct Corner {
    slope: f64,
    distance: f64,
}

/// Returns the start with the focus distance by the boards if the stated one disagrees with them, and a warning if the
/// difference is remarkable. Returns `None` if an option fixes D.
pub(super) fn refocused(
    start: &Start,
    initial: &PlenopticCamera,
    board: &Board,
    features: &[BapFeature],
    options: &CalibrationOptions,
) -> Option<(Start, Option<Finding>)> {
    let Start::Datasheet(sheet, internal) = start else { return None };
    if options.fix.contains(&Parameter::LensToArray) || options.priors.knows("D") {
        return None;
    }
    let corners = corners(initial, internal, board, features);
    if corners.len() < FEWEST {
        return None;
    }
    let exit_pupil_mm = options.exit_pupil_mm().unwrap_or(0.0);
    let lens = Lens { sheet, m_mm: internal.m_mm, exit_pupil_mm };
    let nearest = 4.0 * sheet.focal_length_mm;
    let ratio = (FARTHEST / 4.0).powf(1.0 / f64::from(TRIALS));
    let trials = (0..=TRIALS).map(|i| nearest * ratio.powf(f64::from(i)));
    let tried = trials.filter_map(|h| Some((h, lens.mismatch(h, &corners)?)));
    let (by_boards_mm, best) = tried.min_by(|a, b| a.1.total_cmp(&b.1))?;
    let stated_mm = sheet.focus_distance_mm;
    let distance = |h: f64| lens.distances(h).map(|(lens_to_mla, _)| lens_to_mla);
    let off = distance(stated_mm).map_or(f64::INFINITY, |stated| {
        distance(by_boards_mm).map_or(0.0, |by_boards| (by_boards / stated - 1.0).abs())
    });
    let explains = lens.mismatch(stated_mm, &corners).is_some_and(|stated| stated < AS_WELL * best);
    if off < AGREES || explains {
        return None;
    }
    let sheet = Datasheet { focus_distance_mm: by_boards_mm, ..*sheet };
    let finding = Finding::caution(Issue::FocusDistance { stated_mm, by_boards_mm }).weighing(50.0);
    Some((Start::Datasheet(sheet, internal.clone()), (off > REMARKABLE).then_some(finding)))
}

/// Quantities that determine D and d, besides h.
struct Lens<'a> {
    sheet: &'a Datasheet,
    m_mm: f64,
    exit_pupil_mm: f64,
}

impl Lens<'_> {
    /// Computes D and d, mm. Returns `None` if a focus distance leaves no place for the array.
    fn distances(&self, focus_distance_mm: f64) -> Option<(f64, f64)> {
        let (lens_to_mla, mla_to_sensor) = optics::initial_distances(
            self.sheet.focal_length_mm,
            focus_distance_mm,
            self.m_mm,
            self.sheet.configuration,
            self.exit_pupil_mm,
        );
        let possible = lens_to_mla > 0.0 && mla_to_sensor > 0.0 && lens_to_mla.is_finite();
        possible.then_some((lens_to_mla, mla_to_sensor))
    }

    /// Computes the median difference between γ of the corners and γ from their distances.
    fn mismatch(&self, focus_distance_mm: f64, corners: &[Corner]) -> Option<f64> {
        let (lens_to_mla, mla_to_sensor) = self.distances(focus_distance_mm)?;
        let focal_length = self.sheet.focal_length_mm;
        median(corners.iter().map(|corner| {
            let z = corner.distance * (lens_to_mla + mla_to_sensor);
            // A board within the focal length has no image.
            let image = if z > focal_length {
                focal_length * z / (z - focal_length)
            } else {
                f64::INFINITY
            };
            let slope = 1.0 + mla_to_sensor / (lens_to_mla - image);
            (slope - corner.slope).abs()
        }))
    }
}

/// Returns the corners of all boards that have a pose and features with blur.
fn corners(
    initial: &PlenopticCamera,
    internal: &InternalParameters,
    board: &Board,
    features: &[BapFeature],
) -> Vec<Corner> {
    let pixel_mm = initial.sensor.pixel_size_mm;
    let mla = &initial.mla;
    let projected_pitch = mla.pitch_mm * (1.0 + mla.mla_to_sensor_mm / mla.lens_to_mla_mm);
    let half_pitch_px = internal.micro_image_pitch_mm.unwrap_or(projected_pitch) / 2.0 / pixel_mm;
    let mut by_frame: BTreeMap<u32, Vec<BapFeature>> = BTreeMap::new();
    for feature in features {
        by_frame.entry(feature.frame).or_default().push(*feature);
    }
    let types = internal.q_prime_mm.len();
    let mut corners = Vec::new();
    for features in by_frame.values() {
        let Ok(poses) = poses_of_board(initial, board, features) else { continue };
        let Some(pose) = poses.first() else { continue };
        let mut by_corner: BTreeMap<i32, (f64, f64)> = BTreeMap::new();
        for feature in features {
            // A camera calibrated from corners only has no lens types.
            let lens_type = initial.lattice.lens_type(feature.k, feature.l, types);
            let q_prime = internal.q_prime_mm.get(lens_type);
            let (Some(q_prime), Some(rho)) = (q_prime, feature.rho_px) else { continue };
            // ρ = q'ᵢ − γΔc/2.
            let (sum, count) = by_corner.entry(feature.corner).or_default();
            *sum += (q_prime / pixel_mm - rho) / half_pitch_px;
            *count += 1.0;
        }
        corners.extend(by_corner.into_iter().map(|(corner, (sum, count))| Corner {
            slope: sum / count,
            distance: (pose * board.point_mm(corner)).z
                / (mla.lens_to_mla_mm + mla.mla_to_sensor_mm),
        }));
    }
    corners
}
