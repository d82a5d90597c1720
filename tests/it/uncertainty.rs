//! Standard deviations against what they predict.

use nalgebra::{Isometry3, Translation3, UnitQuaternion, Vector3};
use plenocal::Estimate;
use plenocal::assessment::{BudgetLine, Source, assess, uncertainty_budget};
use plenocal::calibration::{CalibrationOptions, Start, StatedPrior};
use plenocal::model::{FramePose, Noise, NoiseSource, Observations, Parameter, optics};
use plenocal::solver::synthesize;
use rayon::prelude::*;

use crate::support::{
    NO_NOISE, board, datasheet_start, options, pairs, run, true_camera, true_poses,
};

/// Draws of a Monte Carlo experiment. The standard error of a scatter from them is 3.5 %.
const DRAWS: u64 = 400;

/// A stream of standard normal numbers.
struct Normal(NoiseSource);

impl Normal {
    fn new(seed: u64) -> Self {
        Self(NoiseSource::new(&Noise { uv_px: 1.0, rho_px: 1.0, centers_px: 1.0 }, seed).unwrap())
    }
    fn draw(&mut self) -> f64 {
        let zero = plenocal::model::MicroImageCenter {
            k: 0,
            l: 0,
            u_px: 0.0,
            v_px: 0.0,
            std_dev_px: None,
        };
        self.0.center(&zero).u_px
    }
}

/// Exact observations with a σ of their own, uneven by a factor of four, and noise of that size.
fn unevenly_noisy(exact: &Observations, normal: &mut Normal) -> Observations {
    let mut observations = exact.clone();
    for (f, factor) in
        observations.features.iter_mut().zip([1.0, 2.0, 3.0, 4.0].into_iter().cycle())
    {
        let std_dev = 0.1 * factor;
        f.u_px += std_dev * normal.draw();
        f.v_px += std_dev * normal.draw();
        f.std_dev_px = Some([std_dev; 2]);
    }
    // One error for all features of a corner in a frame.
    let mut errors = std::collections::BTreeMap::new();
    for f in &mut observations.features {
        let error = *errors.entry((f.frame, f.corner)).or_insert_with(|| 0.02 * normal.draw());
        f.rho_px = f.rho_px.map(|rho| rho + error);
        f.rho_std_dev_px = Some(0.02);
    }
    for c in &mut observations.centers {
        c.u_px += 0.1 * normal.draw();
        c.v_px += 0.1 * normal.draw();
        c.std_dev_px = Some(0.1);
    }
    observations
}

/// The shipped poses, and as many more: turned in their plane, and further away.
pub fn sixteen_poses() -> Vec<FramePose> {
    let near = true_poses();
    let center = Isometry3::from(board().point_mm(board().corners() - 1).coords / 2.0);
    let far = near.iter().map(|pose| {
        let turn = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), 0.5);
        let turned = pose.camera_from_board * center * turn * center.inverse();
        let shift = Translation3::new(0.0, 0.0, 0.1 * turned.translation.z);
        FramePose { frame: pose.frame + 8, camera_from_board: shift * turned }
    });
    near.iter().copied().chain(far).collect()
}

fn exact() -> Observations {
    synthesize(&true_camera(), &board(), &sixteen_poses(), &NO_NOISE, 0).unwrap()
}

/// One draw: what is calibrated, from where, and how.
type Draw = (Start, Observations, CalibrationOptions);

/// Errors of the parameters, σ, and σ if errors are independent.
type Outcome = (Vec<f64>, Vec<Option<f64>>, Vec<Option<f64>>);

/// Returns the scatter over draws, relative to the root mean square of both predictions, and prints it as rows of the table
/// that `make evidence` takes.
fn monte_carlo(draw: impl Fn(u64) -> Draw + Sync) -> Vec<(&'static str, f64, f64)> {
    let truth = true_camera();
    let parameters = Parameter::intrinsic(3);
    let one = |seed: u64| {
        let (start, observations, options) = draw(seed);
        let calibration = run(&start, &observations, &options);
        assert!(calibration.converged, "seed {seed}");
        let u = &calibration.uncertainty;
        let errors: Vec<f64> =
            pairs(&calibration.camera, &truth).iter().map(|(_, a, b)| a - b).collect();
        (errors, u.intrinsic_std_devs(3), u.independent_std_devs(3))
    };
    let draws: Vec<Outcome> = (0..DRAWS).into_par_iter().map(one).collect();
    let rms = |value: &dyn Fn(&Outcome) -> f64| {
        (draws.iter().map(|d| value(d).powi(2)).sum::<f64>() / DRAWS as f64).sqrt()
    };
    let mut ratios = Vec::new();
    for (i, parameter) in parameters.iter().enumerate() {
        if draws[0].1[i].is_none() {
            continue;
        }
        let error = rms(&|d| d.0[i]);
        let (shared, independent) = (rms(&|d| d.1[i].unwrap()), rms(&|d| d.2[i].unwrap()));
        let (shared, independent) = (error / shared, error / independent);
        println!("| {} | {shared:.2} | {independent:.2} |", parameter.name());
        ratios.push((parameter.name(), shared, independent));
    }
    ratios
}

/// Datasheet and internal parameters of the true camera, with σ of q'.
fn true_start(q_prime_std_dev_mm: f64) -> Start {
    let Start::Datasheet(sheet, _) = datasheet_start() else { unreachable!() };
    let mut internal = optics::internal_parameters(&true_camera());
    internal.q_prime_std_dev_mm = vec![q_prime_std_dev_mm; 3];
    Start::Datasheet(sheet, internal)
}

#[test]
#[ignore = "slow: 400 calibrations; run by `make test-slow`"]
fn monte_carlo_of_independent_errors_weights_and_priors() {
    let truth = true_camera();
    let exact = exact();
    let pixel = truth.sensor.pixel_size_mm;
    let ratios = monte_carlo(|seed| {
        let mut normal = Normal::new(seed);
        let mut observations = unevenly_noisy(&exact, &mut normal);
        let q_px = 0.02;
        let errors = [normal.draw(), normal.draw(), normal.draw()];
        for f in &mut observations.features {
            let error = q_px * errors[truth.lens_type(f.k, f.l)];
            f.rho_px = f.rho_px.map(|rho| rho + error);
        }
        let m = optics::internal_parameters(&truth).m_mm;
        let known = [
            ("F", truth.main_lens.focal_length_mm, 0.02),
            ("m", m, 0.002 * m),
            ("u0", truth.mla.principal_point_px.x, 5.0),
            ("v0", truth.mla.principal_point_px.y, 5.0),
        ];
        let mut options = options();
        for (quantity, value, std_dev) in known {
            options.priors.state(quantity, value + std_dev * normal.draw(), std_dev);
        }
        (true_start(q_px * pixel), observations, options)
    });
    for (name, shared, independent) in ratios {
        // σ of 16 frames is by chance above that of independent errors, and never below it.
        assert!(shared < 1.01 * independent, "{name}: {shared}, {independent}");
        assert!((0.83..1.1).contains(&shared), "{name}: {shared}");
        assert!((0.9..1.1).contains(&independent), "{name}: {independent}");
    }
}

#[test]
#[ignore = "slow: 400 calibrations; run by `make test-slow`"]
fn monte_carlo_of_errors_that_frames_share() {
    let exact = exact();
    let half = board().point_mm(board().corners() - 1).coords / 2.0;
    let ratios = monte_carlo(|seed| {
        let mut normal = Normal::new(10_000 + seed);
        let mut observations = unevenly_noisy(&exact, &mut normal);
        let mut of_frame = std::collections::BTreeMap::new();
        for f in &mut observations.features {
            let [a, b, c] = *of_frame
                .entry(f.frame)
                .or_insert_with(|| std::array::from_fn(|_| 0.5 * normal.draw()));
            let place = board().point_mm(f.corner).coords - half;
            let (x, y) = (place.x / half.x, place.y / half.x);
            f.u_px += a * (x * x - y * y) + c;
            f.v_px += b * x * y;
        }
        (true_start(0.0), observations, options())
    });
    for (name, shared, _) in ratios {
        assert!((0.8..1.25).contains(&shared), "{name}: {shared}");
    }
}

/// First order without a prior and a real calibration, on a scene where the model is right.
#[test]
fn leaving_a_frame_out_is_predicted() {
    let noise = Noise { uv_px: 0.1, rho_px: 0.02, centers_px: 0.05 };
    let observations = synthesize(&true_camera(), &board(), &sixteen_poses(), &noise, 1).unwrap();
    let full = run(&datasheet_start(), &observations, &options());
    let u = &full.uncertainty;
    let std_devs = u.intrinsic_std_devs(3);
    for (i, pose) in full.poses.iter().enumerate() {
        let mut options = options();
        options.exclude_frames.push(pose.frame);
        let without = run(&datasheet_start(), &observations, &options).camera.intrinsics();
        for (row, &index) in u.free_intrinsics.iter().enumerate() {
            let change = without[index] - full.camera.intrinsics()[index];
            let predicted = u.left_out_changes[(i, row)];
            assert!(
                (change - predicted).abs() < 0.05 * std_devs[index].unwrap(),
                "frame {i}, parameter {index}: {change}, predicted {predicted}"
            );
        }
    }
}

#[test]
fn few_frames_are_taken_as_independent() {
    let noise = Noise { uv_px: 0.1, rho_px: 0.02, centers_px: 0.05 };
    let with = |frames: usize| {
        let poses: Vec<FramePose> = sixteen_poses().into_iter().take(frames).collect();
        let observations = synthesize(&true_camera(), &board(), &poses, &noise, 1).unwrap();
        run(&datasheet_start(), &observations, &options()).uncertainty
    };
    let five = with(5);
    assert!(!five.shared && five.covariance == five.independent_covariance);
    assert!(five.std_dev_uncertainties(3).iter().all(Option::is_none));
    let six = with(6);
    assert!(six.shared && six.covariance != six.independent_covariance);
    // A standard deviation from six values is known to 1/√(2·5) = 32 %, if all count the same.
    let worst = six.std_dev_uncertainties(3).into_iter().flatten().fold(0.0, f64::max);
    assert!((0.3..1.0).contains(&worst), "{worst}");
}

/// The budget splits the variance that is reported, and a prior's part grows with its σ.
#[test]
fn the_parts_of_a_budget_add_up() {
    let noise = Noise { uv_px: 0.1, rho_px: 0.02, centers_px: 0.05 };
    let budget = |frames: usize, of_f: f64| {
        let poses: Vec<FramePose> = sixteen_poses().into_iter().take(frames).collect();
        let observations = synthesize(&true_camera(), &board(), &poses, &noise, 1).unwrap();
        let mut options = options();
        let of_f = StatedPrior::Known(Estimate { value: 16.2, std_dev: of_f });
        options.priors.quantities.insert("F".to_owned(), of_f);
        let calibration = run(&datasheet_start(), &observations, &options);
        let space = assess(&calibration, &board()).unwrap().object_space;
        let std_dev = calibration.uncertainty.intrinsic_std_devs(3)[0].unwrap();
        let lines = uncertainty_budget(&calibration, space.as_ref());
        assert!((lines[0].std_dev / std_dev - 1.0).abs() < 1e-12, "{:?}", lines[0]);
        lines
    };
    let part = |line: &BudgetLine, source: Source| {
        line.parts[Source::ALL.iter().position(|of| *of == source).unwrap()]
    };
    for frames in [5, 16] {
        let lines = budget(frames, 0.5);
        let names: Vec<&str> = lines.iter().take(6).map(|line| line.name.as_str()).collect();
        assert_eq!(names, ["F", "D", "d", "f_1", "f_2", "f_3"]);
        assert_eq!(lines.len(), 12);
        for line in &lines {
            let sum: f64 = line.parts.iter().flatten().map(|part| part.powi(2)).sum();
            assert!((sum.sqrt() / line.std_dev - 1.0).abs() < 0.02, "{line:?}");
            assert_eq!(part(line, Source::Shared).is_some(), frames == 16);
        }
    }
    let [tight, loose] = [1e-4, 0.5].map(|of_f| part(&budget(5, of_f)[0], Source::Priors).unwrap());
    assert!(tight < 1e-3 && loose > 3.0 * tight, "{tight} {loose}");
}

/// ρ = q' − Δc/2ν: with all else known, an error of q'ᵢ goes into fᵢ, and nowhere else.
#[test]
fn the_uncertainty_of_q_prime_reaches_the_focal_lengths() {
    let observations = exact();
    let mut noisy = observations.clone();
    let mut normal = Normal::new(3);
    for f in &mut noisy.features {
        f.u_px += 0.1 * normal.draw();
        f.v_px += 0.1 * normal.draw();
    }
    let std_dev_mm = 1e-4;
    let plain = run(&true_start(0.0), &noisy, &options());
    let told = run(&true_start(std_dev_mm), &noisy, &options());
    assert_eq!(plain.camera, told.camera);
    let (before, after) =
        (plain.uncertainty.intrinsic_std_devs(3), told.uncertainty.intrinsic_std_devs(3));
    let mla = &told.camera.mla;
    for (i, parameter) in Parameter::intrinsic(3).iter().enumerate() {
        let (Some(before), Some(after)) = (before[i], after[i]) else { continue };
        let added = (after * after - before * before).max(0.0).sqrt();
        if parameter.name().starts_with("f_") {
            // q' = dΔC/2f.
            let f = told.camera.value(*parameter);
            let expected = std_dev_mm * 2.0 * f * f / (mla.mla_to_sensor_mm * mla.pitch_mm);
            assert!(
                (added / expected - 1.0).abs() < 0.02,
                "{}: {added}, {expected}",
                parameter.name()
            );
        } else {
            assert!(added < 0.05 * before, "{}: {before} to {after}", parameter.name());
        }
    }
}
