//! Corners of simulated boards as points in space, against their truth: errors, and what their covariance predicts.

use nalgebra::{
    Isometry3, Matrix3, Matrix6, Point3, Translation3, UnitQuaternion, Vector3, Vector6,
};
use plenocal::calibration::CalibrationOptions;
use plenocal::model::Subset;
use plenocal::quantity::fixed;
use plenocal::{Result, solver};

use crate::sets::{Extent, Set, seeds, set, step};
use crate::shoot::Calibrated;
use crate::text::Table;

const SETS: [Set; 5] = [
    set("`mini`", "mini", &[]),
    set("`mini`, noise of 4 grey levels", "mini", &["imaging.read_noise_electrons=204"]),
    set("`keplerian`", "keplerian", &[]),
    set("`mini-double-gauss`", "mini-double-gauss", &[]),
    set("`r12-a`", "r12-a", &[]),
];
const SEED: u64 = 7701;

/// Corner: its measured position with the covariance, and the true position.
struct Corner {
    found: Point3<f64>,
    covariance: Matrix3<f64>,
    truth: Point3<f64>,
}

/// Compares errors with their predictions.
pub fn errors(extent: &Extent) -> Result<Vec<String>> {
    let mut table = Table::new(&[
        "set",
        "corners",
        "across (predicted), mm",
        "along (predicted), mm",
        "χ² per degree of freedom",
    ]);
    for (set, settings) in extent.settings(&SETS, SEED)? {
        step(set.name);
        let camera = Calibrated::of(settings, &CalibrationOptions::default())?;
        let corners = corners(&camera)?;
        // The frame of a calibrated camera is where its lens is taken to be.
        let cells = compared(&corners, &fitted_motion(&corners));
        table.row([set.name.to_owned(), corners.len().to_string()].into_iter().chain(cells));
    }
    Ok(vec![table.with(&seeds(&SETS, SEED))])
}

/// Triangulates the corners of the boards that were not used in the calibration.
fn corners(camera: &Calibrated) -> Result<Vec<Corner>> {
    let Calibrated { shoot, boards, calibration, .. } = camera;
    let features = shoot.other_boards(Subset::Evaluation, boards)?;
    let poses = shoot.true_poses(Subset::Evaluation);
    let found = solver::corners(&calibration.camera, &features)?;
    let corner = |((frame, number), point): ((u32, i32), Option<_>)| {
        let solver::MetricPoint { point_mm, covariance_mm2, .. } = point?;
        let pose = poses.iter().find(|pose| pose.frame == frame)?;
        Some(Corner {
            found: point_mm.into(),
            covariance: Matrix3::from_row_slice(&covariance_mm2),
            truth: pose.camera_from_board * shoot.board.point_mm(number),
        })
    };
    Ok(found.labels.into_iter().zip(found.points).filter_map(corner).collect())
}

/// The motion that takes the points nearest to the truth, by their covariances.
fn fitted_motion(corners: &[Corner]) -> Isometry3<f64> {
    const STEPS: usize = 5;
    let mut motion = Isometry3::identity();
    for _ in 0..STEPS {
        let (mut normal, mut right) = (Matrix6::zeros(), Vector6::zeros());
        for corner in corners {
            let point = motion * corner.found;
            let turned = motion.rotation.to_rotation_matrix();
            let weight = (turned * corner.covariance * turned.transpose())
                .try_inverse()
                .expect("covariances are positive");
            let mut by = nalgebra::Matrix3x6::zeros();
            by.fixed_columns_mut::<3>(0).copy_from(&Matrix3::identity());
            by.fixed_columns_mut::<3>(3).copy_from(&-point.coords.cross_matrix());
            normal += by.transpose() * weight * by;
            right += by.transpose() * weight * (corner.truth - point);
        }
        let step = normal.try_inverse().expect("corners determine a motion") * right;
        let turn = UnitQuaternion::from_scaled_axis(step.fixed_rows::<3>(3).into_owned());
        let shift = Translation3::from(step.fixed_rows::<3>(0).into_owned());
        motion = Isometry3::from_parts(shift, turn) * motion;
    }
    motion
}

/// Number of parameters of a motion.
const MOTION: f64 = 6.0;

/// Formats the errors across (per axis) and along the ray from the lens with their predictions, and χ² over its degrees of
/// freedom.
fn compared(corners: &[Corner], motion: &Isometry3<f64>) -> [String; 3] {
    let (mut off_square, mut predicted, mut chi_square) = ([0.0; 2], [0.0; 2], 0.0);
    for corner in corners {
        let turned = motion.rotation.to_rotation_matrix();
        let covariance = turned * corner.covariance * turned.transpose();
        let off: Vector3<f64> = motion * corner.found - corner.truth;
        let ray = corner.truth.coords.normalize();
        let along = off.dot(&ray);
        off_square[0] += (off.norm_squared() - along * along) / 2.0;
        off_square[1] += along * along;
        let variance_along = ray.dot(&(covariance * ray));
        predicted[0] += (covariance.trace() - variance_along) / 2.0;
        predicted[1] += variance_along;
        chi_square += off.dot(&(covariance.try_inverse().expect("positive") * off));
    }
    let count = corners.len() as f64;
    let mm = |square: f64| fixed((square / count).sqrt(), 4);
    let [across, along] = [0, 1].map(|i| format!("{} ({})", mm(off_square[i]), mm(predicted[i])));
    [across, along, fixed(chi_square / (3.0 * count - MOTION), 2)]
}
