//! Boards that are not flat.

use nalgebra::{Translation3, UnitQuaternion, Vector3};
use plenocal::Issue;
use plenocal::assessment::{Group, Posed, Worth, assess, compare_models, pose_boards};
use plenocal::calibration::{
    BoardModel, Calibration, CalibrationOptions, Mode, PriorSource, Start, Trial, calibrate,
};
use plenocal::io::poses_document;
use plenocal::model::{
    BentBoard, Board, BoardShape, FramePose, Noise, NoiseSource, Observations, Parameter,
    PlenopticCamera, optics,
};
use plenocal::report::calibration_section;
use plenocal::solver::synthesize_bent;

use crate::support::{codes, datasheet_start, defaults, pairs, true_camera};

const NOISE: Noise = Noise { uv_px: 0.1, rho_px: 0.02, centers_px: 0.05 };

/// A stream of numbers.
pub struct Random(NoiseSource);

impl Random {
    pub fn new(seed: u64) -> Self {
        Self(NoiseSource::new(&Noise { uv_px: 1.0, rho_px: 1.0, centers_px: 1.0 }, seed).unwrap())
    }

    pub fn normal(&mut self) -> f64 {
        let zero = plenocal::model::MicroImageCenter {
            k: 0,
            l: 0,
            u_px: 0.0,
            v_px: 0.0,
            std_dev_px: None,
        };
        self.0.center(&zero).u_px
    }

    /// From −1 to 1.
    pub fn even(&mut self) -> f64 {
        let part = self.normal() * 1e4;
        2.0 * (part - part.floor()) - 1.0
    }

    /// From 0 to below a number.
    fn below(&mut self, count: u8) -> usize {
        let part = f64::midpoint(self.even(), 1.0) * f64::from(count);
        (1..count).filter(|&i| part >= f64::from(i)).count()
    }
}

/// A camera, a board and its poses, all different.
pub struct Scene {
    pub camera: PlenopticCamera,
    pub board: Board,
    pub poses: Vec<FramePose>,
}

pub fn scene(seed: u64) -> Scene {
    let mut random = Random::new(seed);
    let mut camera = true_camera();
    let scale = 1.0 + 0.02 * random.even();
    camera.main_lens.focal_length_mm *= scale;
    camera.mla.lens_to_mla_mm *= scale;
    camera.main_lens.exit_pupil_mm.z = -2.0 + 2.0 * random.even();
    camera.main_lens.field_curvature_per_mm = 0.003 * random.even();
    camera.main_lens.field_curvature_growth_per_mm = 0.005 * random.even();
    for tilt in [0, 1] {
        camera.mla.rotation_rad[tilt] += 0.002 * random.even();
    }
    let columns = [7, 9, 11, 13][random.below(4)];
    let rows = [5, 6, 8][random.below(3)];
    let square_mm = 30.0 / f64::from(columns.max(rows)) * (1.0 + 0.1 * random.even());
    let board = Board { columns, rows, square_mm };
    let frames = 10 + u32::try_from(random.below(8)).unwrap();
    let pose = |frame: u32| {
        let (tilt, towards) = (0.45 + 0.2 * random.even(), std::f64::consts::PI * random.even());
        let turn = UnitQuaternion::from_scaled_axis(Vector3::new(
            tilt * towards.cos(),
            tilt * towards.sin(),
            0.3 * random.even(),
        ));
        let z = 90.0 + 13.0 * random.even();
        let place = Vector3::new(2.0 * random.even(), 2.0 * random.even(), z)
            - turn * board.middle_mm().coords;
        FramePose { frame, camera_from_board: Translation3::from(place) * turn }
    };
    let poses = (0..frames).map(pose).collect();
    Scene { camera, board, poses }
}

/// Checks boards so bent that a refinement with a flat one may run away.
#[test]
fn strongly_bent_boards_are_found_from_the_start() {
    const FIVE_SIGMA: f64 = 5.0;
    for seed in 1..9 {
        let scene = scene(seed);
        let shape = BoardShape { sag_x_mm: 1.2, ..BoardShape::default() };
        let found = scene.calibrated(&scene.observed(shape, seed), BoardModel::Auto);
        let std_dev = found.uncertainty.intrinsic_std_devs(3)[0].unwrap();
        let truth = scene.camera.main_lens.focal_length_mm;
        let off = (found.camera.main_lens.focal_length_mm - truth) / std_dev;
        println!("seed {seed}: F {off:.1} σ, sag {:.3} mm", found.board.bent.shape.sag_x_mm);
        assert!(found.converged && off.abs() < FIVE_SIGMA, "seed {seed}: {off} σ");
        assert!((found.board.bent.shape.sag_x_mm - 1.2).abs() < 0.1, "seed {seed}");
    }
}

/// Checks frames of which the board fills the view: their corners are numbered up to a shift.
#[test]
fn shifted_numbers_move_poses_and_not_the_camera() {
    let scene = scene(3);
    let observations = scene.observed(BoardShape::default(), 3);
    let larger =
        Board { columns: scene.board.columns + 2, rows: scene.board.rows + 2, ..scene.board };
    let calibrated = |shift: &dyn Fn(u32) -> i32| {
        let mut observations = observations.clone();
        for feature in &mut observations.features {
            let (columns, shift) = (scene.board.columns, shift(feature.frame));
            let (column, row) =
                (feature.corner % columns + shift, feature.corner / columns + shift);
            feature.corner = row * larger.columns + column;
        }
        let shifted = |frame: &u32| shift(*frame) > 0;
        observations.shifted_frames = observations.frames().into_iter().filter(shifted).collect();
        let whole =
            Scene { board: larger, camera: scene.camera.clone(), poses: scene.poses.clone() };
        whole.calibrated(&observations, BoardModel::Auto)
    };
    let (plain, shifted) = (calibrated(&|_| 0), calibrated(&|frame| i32::from(frame % 3 == 0) * 2));
    let std_devs = plain.uncertainty.intrinsic_std_devs(3);
    for ((name, a, b), std_dev) in pairs(&plain.camera, &shifted.camera).iter().zip(std_devs) {
        assert!((a - b).abs() <= 0.02 * std_dev.unwrap_or(0.0), "{name}: {a} and {b}");
    }
    let step = larger.square_mm * 2.0 * 2.0_f64.sqrt();
    for (a, b) in plain.poses.iter().zip(&shifted.poses) {
        let off = (a.camera_from_board.translation.vector - b.camera_from_board.translation.vector)
            .norm();
        let expected = if a.frame % 3 == 0 { step } else { 0.0 };
        assert!((off - expected).abs() < 0.01, "frame {}: {off} mm", a.frame);
    }
    let bent = CalibrationOptions { board: BoardModel::Bent, ..defaults() };
    let mut observations = observations;
    observations.shifted_frames.insert(2);
    let refused = |observations: &Observations, options: &CalibrationOptions| {
        calibrate(&scene.start(), &scene.board, observations, options, &mut |_| true)
            .err()
            .is_some_and(|error| error.to_string().contains("fills the view in frames 2"))
    };
    assert!(refused(&observations, &bent));
    let mut with_prior = defaults();
    with_prior.priors.state("sag_x", 0.0, 0.1);
    assert!(refused(&observations, &with_prior) && !refused(&observations, &defaults()));
    let without = CalibrationOptions { exclude_frames: vec![2], ..bent };
    assert!(!refused(&observations, &without));
    let document = poses_document(&shifted.poses, None, &shifted.shifted_frames);
    let is_shifted = |pose: &serde_json::Value| pose["shifted"] == true;
    let marked =
        document["poses"].as_array().unwrap().iter().filter(|pose| is_shifted(pose)).count();
    assert_eq!(marked, shifted.shifted_frames.len());
}

impl Scene {
    pub fn observed(&self, shape: BoardShape, seed: u64) -> Observations {
        let bent = BentBoard { board: self.board, shape };
        let mut observations =
            synthesize_bent(&self.camera, &bent, &self.poses, &NOISE, seed).unwrap();
        for f in &mut observations.features {
            f.std_dev_px = Some([NOISE.uv_px; 2]);
            f.rho_std_dev_px = Some(NOISE.rho_px);
        }
        for c in &mut observations.centers {
            c.std_dev_px = Some(NOISE.centers_px);
        }
        observations
    }

    fn start(&self) -> Start {
        let Start::Datasheet(mut sheet, _) = datasheet_start() else { unreachable!() };
        sheet.focal_length_mm = self.camera.main_lens.focal_length_mm * 1.01;
        Start::Datasheet(sheet, optics::internal_parameters(&self.camera))
    }

    pub fn calibrated(&self, observations: &Observations, board: BoardModel) -> Calibration {
        self.with(observations, &CalibrationOptions { board, ..defaults() })
    }

    fn with(&self, observations: &Observations, options: &CalibrationOptions) -> Calibration {
        calibrate(&self.start(), &self.board, observations, options, &mut |_| true).unwrap()
    }
}

/// Sags, twist and aspect of a board that is bent by 0.4 % of its diagonal.
const BENT: BoardShape =
    BoardShape { sag_x_mm: 0.12, sag_y_mm: -0.05, twist_mm: 0.04, aspect: 1.5e-3 };
const FOUR_SIGMA: f64 = 4.0;

/// Errors of F, D and d, in σ and relative.
pub fn length_errors(calibration: &Calibration, truth: &PlenopticCamera) -> [(f64, f64); 3] {
    let std_devs = calibration.uncertainty.intrinsic_std_devs(3);
    let all = pairs(&calibration.camera, truth);
    ["F", "D", "d"].map(|wanted| {
        let i = all.iter().position(|(name, ..)| *name == wanted).unwrap();
        let (_, value, truth) = all[i];
        ((value - truth) / std_devs[i].unwrap(), value / truth - 1.0)
    })
}

#[test]
fn the_shape_of_a_bent_board_is_found_and_the_camera_is_right() {
    let scene = scene(3);
    let observations = scene.observed(BENT, 5);
    let found = scene.calibrated(&observations, BoardModel::Auto);
    assert!(found.converged);
    for (parameter, std_dev) in Parameter::SHAPE.into_iter().zip(found.board.std_devs) {
        let (value, truth) = (found.board.bent.shape.value(parameter), BENT.value(parameter));
        let std_dev = std_dev.unwrap();
        let name = parameter.name();
        assert!((value - truth).abs() < FOUR_SIGMA * std_dev, "{name}: {value} ± {std_dev}");
        assert!(std_dev < truth.abs() / 3.0, "{name}: {std_dev}");
    }
    for (std_devs, _) in length_errors(&found, &scene.camera) {
        assert!(std_devs.abs() < FOUR_SIGMA, "{std_devs}");
    }
    assert_eq!(found.findings, []);
    // A flat board leaves d far off, and the residuals too large.
    let flat = scene.calibrated(&observations, BoardModel::Flat);
    let [.., (_, d)] = length_errors(&found, &scene.camera);
    let [.., (_, flat_d)] = length_errors(&flat, &scene.camera);
    assert!(d.abs() < 0.005 && flat_d.abs() > 0.01, "{d}, {flat_d}");
    assert_eq!(flat.board.bent.shape, BoardShape::default());
    // Without its priors it is found as well.
    let mut options = defaults();
    options.priors.default = false;
    let free = scene.with(&observations, &options);
    let (a, b) = (free.board.bent.shape.sag_x_mm, found.board.bent.shape.sag_x_mm);
    assert!((a - b).abs() < found.board.std_devs[0].unwrap(), "{a}, {b}");
    assert!(free.priors.iter().all(|known| known.source != PriorSource::FlatBoard));
}

/// The trial of a shape leaves no trace but what it has shown.
#[test]
fn with_a_flat_board_nothing_changes() {
    let scene = scene(4);
    let observations = scene.observed(BoardShape::default(), 6);
    let auto = scene.calibrated(&observations, BoardModel::Auto);
    let flat = scene.calibrated(&observations, BoardModel::Flat);
    assert_eq!((&auto.camera, &auto.poses), (&flat.camera, &flat.poses));
    assert_eq!(auto.uncertainty.covariance, flat.uncertainty.covariance);
    assert_eq!((&auto.priors, &auto.cost), (&flat.priors, &flat.cost));
    assert_eq!(auto.board.bent, flat.board.bent);
    assert_eq!((&flat.board.trial, flat.board.limits()), (&Trial::NotTried, [None; 4]));
    let limits = auto.board.limits().map(Option::unwrap);
    assert!(limits[..2].iter().all(|limit| (1e-4..0.03).contains(limit)), "{limits:?} mm");
    assert!(auto.board.aside.iterations > 0 && auto.board.aside.time_s > 0.0);
    let assessment = assess(&auto, &scene.board).unwrap();
    let text = calibration_section("Calibration", &auto, &assessment, Vec::new()).to_text();
    assert!(text.contains("The board is flat: below sag_x 0.0"), "{text}");
    assert!(text.contains("Differences from 0: bend "), "{text}");
    // A parameter that is fixed has no limit, and takes none from the others.
    let mut options = defaults();
    options.fix.push(Parameter::Twist);
    let limits = scene.with(&observations, &options).board.limits();
    assert_eq!(limits.map(|limit| limit.is_some()), [true, true, false, true]);
}

/// A board of which only the ratio of the spacings is off stays flat.
#[test]
fn bend_and_aspect_are_told_apart() {
    let scene = scene(5);
    let stretched = BoardShape { aspect: -2e-3, ..BoardShape::default() };
    let found = scene.calibrated(&scene.observed(stretched, 8), BoardModel::Auto).board;
    assert_eq!(found.std_devs.map(|s| s.is_some()), [false, false, false, true]);
    let (error, std_dev) = (found.bent.shape.aspect + 2e-3, found.std_devs[3].unwrap());
    assert!(error.abs() < FOUR_SIGMA * std_dev, "{error} ± {std_dev}");
    assert!(found.bent.bend_mm().abs() < f64::EPSILON);
    let bent = BoardShape { sag_y_mm: 0.1, ..BoardShape::default() };
    let found = scene.calibrated(&scene.observed(bent, 8), BoardModel::Auto).board;
    assert_eq!(found.std_devs.map(|s| s.is_some()), [true, true, true, false]);
    // Folds take that over.
    let decided = defaults().with_decision(found.std_devs);
    assert_eq!(decided.board, BoardModel::Bent);
    assert!(decided.fix.contains(&Parameter::Aspect));
    let again = scene.with(&scene.observed(BoardShape::default(), 9), &decided).board;
    assert_eq!(again.std_devs.map(|s| s.is_some()), [true, true, true, false]);
}

#[test]
fn few_frames_do_not_show_that_a_board_is_bent() {
    let mut scene = scene(3);
    scene.poses.truncate(5);
    let observations = scene.observed(BENT, 5);
    let found = scene.calibrated(&observations, BoardModel::Auto);
    assert_eq!(
        (found.board.bent.shape, found.board.trial),
        (BoardShape::default(), Trial::TooFewFrames)
    );
    // It can be asked for.
    let asked = scene.calibrated(&observations, BoardModel::Bent);
    assert!((asked.board.bent.shape.sag_x_mm - BENT.sag_x_mm).abs() < 0.03, "{:?}", asked.board);
}

#[test]
fn a_known_shape_is_kept_and_places_the_boards() {
    let scene = scene(3);
    let observations = scene.observed(BENT, 5);
    let bent = BentBoard { board: scene.board, shape: BENT };
    let known = pose_boards(&scene.camera, &bent, &observations.features).unwrap();
    let flat = pose_boards(&scene.camera, &scene.board.into(), &observations.features).unwrap();
    assert!(known.converged && flat.converged);
    let [known_px, flat_px] = [&known, &flat].map(|posed| posed.reprojection.rmse().uv_px);
    assert!((known_px / (NOISE.uv_px * 2.0_f64.sqrt()) - 1.0).abs() < 0.05, "{known_px} px");
    assert!(flat_px > 1.5 * known_px, "{flat_px} px");
    let worst = |posed: &Posed| {
        let apart = |(a, b): (&FramePose, &FramePose)| {
            let middle = scene.board.middle_mm();
            (a.camera_from_board * middle - b.camera_from_board * middle).norm()
        };
        posed.poses.iter().zip(&scene.poses).map(apart).fold(0.0, f64::max)
    };
    assert!(
        worst(&known) < 0.05 && worst(&flat) > worst(&known),
        "{} {}",
        worst(&known),
        worst(&flat)
    );
    let kept = scene.calibrated(&observations, BoardModel::Known(BENT)).board;
    assert_eq!((kept.bent.shape, kept.std_devs), (BENT, [None; 4]));
}

#[test]
fn a_board_that_is_bent_too_far_is_a_warning() {
    let scene = scene(3);
    let shape = BoardShape { sag_x_mm: 0.3, ..BoardShape::default() };
    let found = scene.calibrated(&scene.observed(shape, 5), BoardModel::Auto);
    let warped = |found: &Calibration| {
        found.findings.iter().find_map(|finding| match finding.issue {
            Issue::WarpedBoard { bend_mm, estimated, .. } => Some((bend_mm, estimated)),
            _ => None,
        })
    };
    let is_warped = |told: Option<(f64, bool)>, estimated: bool| {
        told.is_some_and(|(bend_mm, by)| (bend_mm - 0.3).abs() < 0.02 && by == estimated)
    };
    assert!(is_warped(warped(&found), true), "{:?}", found.findings);
    let known = scene.calibrated(&scene.observed(shape, 5), BoardModel::Known(shape));
    assert!(is_warped(warped(&known), false), "{:?}", known.findings);
    // The prior that boards are flat to 0.1 % does not pull it back.
    assert!(
        found.priors.iter().all(|known| known.normalised_residual().abs() < 3.0),
        "{:?}",
        found.priors
    );
    let assessment = assess(&found, &scene.board).unwrap();
    assert!(codes(&assessment.findings).contains(&"warped-board"));
    assert!(assessment.object_space.is_some() && assessment.next_board.is_some());
}

/// Priors of the shape are those of any parameter.
#[test]
fn what_is_known_of_a_board_can_be_stated() {
    let scene = scene(3);
    let observations = scene.observed(BENT, 5);
    let mut options = defaults();
    options.priors.state("sag_x", 0.1, 1e-7);
    options.fix.push(Parameter::Twist);
    let found = scene.with(&observations, &options).board;
    assert!((found.bent.shape.sag_x_mm - 0.1).abs() < 1e-4, "{found:?}");
    assert_eq!((found.bent.shape.twist_mm, found.std_devs[2]), (0.0, None));
    // The paper's options have a flat board, but a bent one can be asked for.
    let paper = CalibrationOptions { board: BoardModel::Bent, ..CalibrationOptions::paper() };
    assert!(scene.with(&observations, &paper).board.std_devs.iter().all(Option::is_some));
    let mut fixed = paper;
    fixed.fix.extend(Parameter::SHAPE);
    let error = calibrate(&scene.start(), &scene.board, &observations, &fixed, &mut |_| true);
    let error = error.unwrap_err().to_string();
    assert!(error.contains("sag_x, sag_y, twist, aspect are fixed"), "{error}");
    options.board = BoardModel::Flat;
    let error = calibrate(&scene.start(), &scene.board, &observations, &options, &mut |_| true)
        .unwrap_err();
    assert!(error.to_string().contains("sag_x has a prior, but is fixed"), "{error}");
    let bent = CalibrationOptions { mode: Mode::PosesOnly, board: BoardModel::Bent, ..defaults() };
    let camera = Start::Camera(scene.camera.clone());
    let error = calibrate(&camera, &scene.board, &observations, &bent, &mut |_| true).unwrap_err();
    assert!(error.to_string().contains("give the shape from that calibration"), "{error}");
}

#[test]
fn models_are_compared_without_the_shape_of_a_bent_board() {
    let scene = scene(3);
    let found = scene.calibrated(&scene.observed(BENT, 5), BoardModel::Auto);
    let compared = compare_models(&found, &scene.board, 5, &|| ()).unwrap();
    let shape = compared.groups.iter().find(|w| w.group == Group::BoardShape).unwrap();
    assert_eq!(shape.parameters, Parameter::SHAPE);
    assert_eq!(shape.worth(), Worth::Needed, "{:?}", shape.mean_growth());
    assert!(shape.converged && shape.cost_growth[0] > 100.0, "{:?}", shape.cost_growth);
}
