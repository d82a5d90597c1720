//! Checks of a calibration: its convergence, residuals, priors, boards and parameters.

use std::collections::BTreeSet;

use crate::finding::{Finding, Issue, Severity};
use crate::model::{BentBoard, FramePose, Observations, Parameter, PlenopticCamera, Reprojection};
use crate::quantity::Estimate;
use crate::solver::Uncertainty;

/// Deviation from a prior, in σ, above which there is a finding.
pub(crate) const CONTRADICTED: f64 = 3.0;
/// Deviation, in σ, above which the prior or the observations are wrong.
const WRONG: f64 = 6.0;
/// Tolerance of m of the white images besides its own σ, due to engraved f-numbers, relative.
const SLOPE_FLOOR: f64 = 0.02;
/// Largest relative difference between m of camera and white images; for simulated cameras it is below 1 %.
const SLOPES_AGREE: f64 = 0.015;
/// Largest scatter of features over their σ; clean images, of real lenses too, have 1.1 to 1.4.
const SCATTER: f64 = 1.6;
/// Scatter over σ above which the camera is wrong. Of 428 users' mistakes, those that left the camera right had up to 4.8; with
/// 6.5 and more it was wrong.
const SCATTER_WRONG: f64 = 6.0;
/// Largest reprojection error that noise of a detector can explain, as a fraction of the micro-image pitch. On the R12 it is
/// 2.3 px; real data have 0.9 px.
const BAD_FIT: f64 = 0.1;
/// Largest residuals of blur radii, as a fraction of their spread, that a right model leaves. R12-A leaves 0.08; radii and q'
/// for aperture ratios that are 8 % apart leave 0.5.
const UNEXPLAINED_RHO: f64 = 0.3;
/// Factor by which an array may be larger than the image.
const ARRAY_OVER_IMAGE: f64 = 1.5;
/// Largest part of outlying features. Single outliers have no effect, since the loss reduces their weight; more of them have a
/// cause.
const OUTLYING_PART: f64 = 0.002;
/// Largest patterns, as fractions of the residuals.
const IMAGE_PATTERN: f64 = 0.3;
const MICRO_IMAGE_PATTERN: f64 = 0.1;
/// Largest ratio of the residuals of two lens types.
const LENS_TYPES: f64 = 1.4;
/// Number of frames below which the errors that the features of a frame share cannot be estimated.
const ENOUGH_FRAMES: usize = 6;
/// Number of frames below which too much is left to chance.
const MIN_FRAMES: usize = 3;
/// Tilt of a board, rad (10°), below which it carries little information on F.
const TILTED_RAD: f64 = 0.1745;
const ENOUGH_TILTED: usize = 3;
/// Tilt, rad (5°), below which boards can hardly be distinguished in a projection.
const FRONTO_PARALLEL_RAD: f64 = 0.087;
/// Smallest ratio of the largest to the smallest distance of boards.
const DISTANCES: f64 = 1.2;
/// Smallest part of the image that boards cover.
const COVERAGE: f64 = 0.5;
/// Largest share of one frame in the information on a parameter.
const DOMINANT: f64 = 0.5;
/// Largest relative σ of a length.
const UNCERTAIN: f64 = 0.01;
const UNKNOWN: f64 = 0.1;
/// Parameters whose relative σ matters.
const LENGTHS: [&str; 6] = ["F", "D", "d", "f_1", "f_2", "f_3"];
/// Bend, as a part of the diagonal, above which another board is needed.
const WARPED: f64 = 5e-3;
/// Relative stretch of squares above which their size may have been measured along either side.
const STRETCHED: f64 = 0.01;
/// Smallest relative difference of the aperture ratios of two lens types that counts, and the same in σ.
const RATIOS_DIFFER_PART: f64 = 0.01;
const RATIOS_DIFFER: f64 = 3.0;

pub(crate) fn severity_above(value: f64, limit: f64) -> Severity {
    if value < limit { Severity::Caution } else { Severity::Unusable }
}

pub(crate) fn not_converged(converged: bool) -> Option<Finding> {
    (!converged).then(|| Finding::unusable(Issue::NotConverged).weighing(100.0))
}

/// Finds micro-image centres far from the grid: a note, since the loss reduces their weight.
pub(crate) fn outlying_centers(
    outliers: usize,
    centers: usize,
    grid_rms_px: f64,
) -> Option<Finding> {
    (outliers > 0).then(|| Finding::note(Issue::OutlyingCenters { outliers, centers, grid_rms_px }))
}

/// Finds an array that extends far beyond the image.
pub(crate) fn array_beyond_image(camera: &PlenopticCamera) -> Option<Finding> {
    let (lattice, sensor) = (&camera.lattice, &camera.sensor);
    let extent = camera.micro_image_pitch_px()
        * (lattice.node(lattice.columns - 1, lattice.rows - 1) - lattice.node(0, 0));
    let beyond = |extent: f64, image: u32| extent > ARRAY_OVER_IMAGE * f64::from(image);
    (beyond(extent.x, sensor.width_px) || beyond(extent.y, sensor.height_px)).then(|| {
        Finding::caution(Issue::ArrayBeyondImage {
            array: [lattice.columns, lattice.rows],
            extent_px: [extent.x, extent.y],
            image_px: [sensor.width_px, sensor.height_px],
        })
        .weighing(50.0)
    })
}

/// Finds parameters that the observations do not determine.
pub(crate) fn undetermined(camera: &PlenopticCamera, uncertainty: &Uncertainty) -> Option<Finding> {
    let (rank, parameters) = (uncertainty.rank, uncertainty.size());
    let all = Parameter::shared(camera.lens_types());
    let names = uncertainty.undetermined_intrinsics().into_iter().map(|i| all[i].name().to_owned());
    (rank < parameters).then(|| {
        Finding::unusable(Issue::Undetermined { rank, parameters, names: names.collect() })
            .weighing(50.0)
    })
}

/// Finds residuals that noise cannot explain.
pub(crate) fn fit(camera: &PlenopticCamera, reprojection: &Reprojection) -> Option<Finding> {
    let (rmse, micro_image_pitch_px) = (reprojection.rmse(), camera.micro_image_pitch_px());
    if rmse.all_px > BAD_FIT * micro_image_pitch_px {
        let issue = Issue::BadFit { rms_px: rmse.all_px, micro_image_pitch_px };
        return Some(Finding::unusable(issue).weighing(50.0));
    }
    let count = rmse.count as f64;
    let radii = || reprojection.features.iter().filter_map(|r| r.feature.rho_px);
    let mean = radii().sum::<f64>() / count;
    let spread_px = (radii().map(|rho| (rho - mean).powi(2)).sum::<f64>() / count).sqrt();
    let rms_px = rmse.rho_px.filter(|rms_px| *rms_px > UNEXPLAINED_RHO * spread_px)?;
    Some(Finding::unusable(Issue::UnexplainedBlur { rms_px, spread_px }).weighing(50.0))
}

/// Returns the tilts of boards, rad.
fn tilts(poses: &[FramePose]) -> impl Iterator<Item = f64> {
    poses.iter().map(|pose| {
        let normal = pose.camera_from_board.rotation * nalgebra::Vector3::z();
        normal.z.abs().min(1.0).acos()
    })
}

/// Finds boards that are all parallel to the image plane: F and their distance can hardly be separated.
pub(crate) fn fronto_parallel(poses: &[FramePose]) -> Option<Finding> {
    let largest_tilt_deg = tilts(poses).fold(0.0, f64::max).to_degrees();
    (largest_tilt_deg.to_radians() < FRONTO_PARALLEL_RAD)
        .then(|| Finding::caution(Issue::FrontoParallel { largest_tilt_deg }).weighing(50.0))
}

/// Finds boards that are too few, hardly tilted, or all at one distance.
pub(crate) fn boards(poses: &[FramePose]) -> Vec<Finding> {
    let frames = poses.len();
    let mut findings = Vec::new();
    if frames < ENOUGH_FRAMES {
        let severity = if frames < MIN_FRAMES { Severity::Unusable } else { Severity::Caution };
        findings.push(Finding::new(severity, Issue::FewFrames { frames }).weighing(4.0));
    }
    let tilted = tilts(poses).filter(|tilt| *tilt >= TILTED_RAD).count();
    if tilted < ENOUGH_TILTED && fronto_parallel(poses).is_none() {
        findings.push(Finding::caution(Issue::FewTilts { tilted, frames }).weighing(3.0));
    }
    let distances = poses.iter().map(|p| p.camera_from_board.translation.z);
    let ratio = distances.clone().fold(0.0, f64::max) / distances.fold(f64::INFINITY, f64::min);
    if frames > 1 && ratio < DISTANCES {
        findings.push(Finding::caution(Issue::OneDistance { ratio }).weighing(3.0));
    }
    findings
}

/// Finds poses of frames without features.
pub(crate) fn poses_of_no_frame(
    given: &[FramePose],
    observations: &Observations,
) -> Option<Finding> {
    let seen: BTreeSet<u32> = observations.features.iter().map(|f| f.frame).collect();
    let frames: Vec<u32> = given.iter().map(|p| p.frame).filter(|f| !seen.contains(f)).collect();
    (!frames.is_empty()).then(|| Finding::caution(Issue::PosesOfNoFrame { frames }).weighing(50.0))
}

/// Finds a prior that the observations contradict. `source` names the origin of the prior.
pub(crate) fn prior(
    (quantity, unit): (&str, &'static str),
    prior: Estimate,
    result: f64,
    source: &str,
) -> Option<Finding> {
    let off = ((result - prior.value) / prior.std_dev).abs();
    (off > CONTRADICTED).then(|| {
        let (quantity, source) = (quantity.to_owned(), source.to_owned());
        let issue = Issue::PriorContradicted { quantity, unit, prior, result, source };
        Finding::new(severity_above(off, WRONG), issue).weighing(2.0 * off)
    })
}

/// Compares m of the white images with m of the camera, which has this relative σ; `error` is (m* − m)/m*.
pub(crate) fn slope(error: f64, std_dev: f64) -> Option<Finding> {
    let off = error.abs();
    let wrong = off > WRONG * SLOPE_FLOOR;
    (wrong || (off > SLOPES_AGREE && off > CONTRADICTED * std_dev)).then(|| {
        Finding::new(severity_above(off, WRONG * SLOPE_FLOOR), Issue::SlopeContradicted { error })
            .weighing(2.0 * off / SLOPE_FLOOR)
    })
}

/// Checks the residuals over the σ of the detection.
pub(crate) fn scatter(ratio: f64) -> Option<Finding> {
    (ratio > SCATTER).then(|| {
        let severity = severity_above(ratio, SCATTER_WRONG);
        Finding::new(severity, Issue::Scatter { ratio }).weighing(5.0 * ratio / SCATTER)
    })
}

pub(crate) fn outlying_features(outlying: usize, all: usize) -> Option<Finding> {
    (outlying as f64 > OUTLYING_PART * all as f64)
        .then(|| Finding::caution(Issue::OutlyingFeatures { outlying, all }).weighing(2.0))
}

/// Finds a pattern of the residuals over the image, as a part of their size.
pub(crate) fn image_pattern(part: f64) -> Option<Finding> {
    (part > IMAGE_PATTERN).then(|| {
        Finding::caution(Issue::ImagePattern { part }).weighing(4.0 * part / IMAGE_PATTERN)
    })
}

/// Finds a pattern of the residuals over the radius of micro-images, as a part of their size.
pub(crate) fn micro_image_pattern(part: f64) -> Option<Finding> {
    (part > MICRO_IMAGE_PATTERN).then(|| {
        Finding::caution(Issue::MicroImagePattern { part })
            .weighing(4.0 * part / MICRO_IMAGE_PATTERN)
    })
}

/// Checks the ratio of the largest to the smallest residuals of a lens type.
pub(crate) fn lens_type_pattern(ratio: f64) -> Option<Finding> {
    (ratio > LENS_TYPES)
        .then(|| Finding::caution(Issue::LensTypePattern { ratio }).weighing(2.0 * ratio))
}

/// Checks the part of the image that boards cover.
pub(crate) fn coverage(part: f64) -> Option<Finding> {
    (part < COVERAGE).then(|| Finding::caution(Issue::Coverage { part }).weighing(2.0))
}

/// Finds lengths that depend on one frame, or have a large σ: the worst of each.
pub(crate) fn parameters(
    camera: &PlenopticCamera,
    uncertainty: &Uncertainty,
    poses: &[FramePose],
) -> Vec<Finding> {
    let parameters = Parameter::intrinsic(camera.lens_types());
    let is_length =
        |index: usize| parameters.get(index).is_some_and(|p| LENGTHS.contains(&p.name()));
    let free = uncertainty.free_intrinsics.iter().enumerate();
    let lengths = free.filter(|(row, index)| is_length(**index) && uncertainty.determined[*row]);
    let mut dominant: Option<(usize, usize, f64)> = None;
    let mut uncertain: Option<(usize, f64)> = None;
    for (row, &index) in lengths {
        for frame in 0..poses.len() {
            let share = uncertainty.frame_shares[(frame, row)];
            if share > DOMINANT.max(dominant.map_or(0.0, |d| d.2)) {
                dominant = Some((frame, index, share));
            }
        }
        let value = camera.value(parameters[index]);
        let relative = uncertainty.covariance[(row, row)].sqrt() / value.abs();
        if relative > UNCERTAIN.max(uncertain.map_or(0.0, |u| u.1)) {
            uncertain = Some((index, relative));
        }
    }
    let dominant = dominant.filter(|_| poses.len() > 1).map(|(frame, index, share)| {
        let (frame, parameter) = (poses[frame].frame, parameters[index].name().to_owned());
        Finding::caution(Issue::DominantFrame { frame, parameter, share }).weighing(3.0)
    });
    let uncertain = uncertain.map(|(index, relative)| {
        let parameter = parameters[index].name().to_owned();
        Finding::new(severity_above(relative, UNKNOWN), Issue::Uncertain { parameter, relative })
            .weighing((4.0 * relative / UNCERTAIN).min(40.0))
    });
    dominant.into_iter().chain(uncertain).collect()
}

/// Finds a board that bends so far that it should be replaced, or has oblong squares; `estimated` is true if its shape is free.
pub(crate) fn board_shape(board: &BentBoard, estimated: bool) -> Vec<Finding> {
    let (bend_mm, diagonal_mm, aspect) =
        (board.bend_mm(), board.board.diagonal_mm(), board.shape.aspect);
    let warped = (bend_mm > WARPED * diagonal_mm)
        .then(|| Finding::caution(Issue::WarpedBoard { bend_mm, diagonal_mm, estimated }));
    let stretched =
        (aspect.abs() > STRETCHED).then(|| Finding::caution(Issue::StretchedBoard { aspect }));
    warped.into_iter().chain(stretched).map(|finding| finding.weighing(50.0)).collect()
}

/// Finds the two lens types, from 0, whose aperture ratios differ most, if they differ; `mean` is the ratio of all.
pub(crate) fn aperture_ratios(of_types: &[(usize, Estimate)], mean: f64) -> Option<Finding> {
    let pairs = of_types.iter().flat_map(|a| of_types.iter().map(move |b| (a, b)));
    let apart = |(a, b): &(&(usize, Estimate), &(usize, Estimate))| a.1.std_devs_from(&b.1);
    let (a, b) = pairs.max_by(|x, y| apart(x).total_cmp(&apart(y)))?;
    let clearly = a.1.value - b.1.value > RATIOS_DIFFER_PART * mean;
    (clearly && apart(&(a, b)) > RATIOS_DIFFER).then(|| {
        let (lens_types, estimated) = ([a.0 + 1, b.0 + 1], [a.1, b.1]);
        Finding::caution(Issue::ApertureRatiosDiffer { lens_types, estimated }).weighing(50.0)
    })
}
