//! Corners of simulated boards as points in space, against where they are: how far off, and what their covariance says.
//!
//!     cargo run --release --example points_against_truth -- DATA-SET SUBSET camera.json features.csv
//!
//! SUBSET is `calibration` or `evaluation`. The points are those of `plenocal points camera.json features.csv`. The frame of a
//! calibrated camera is where its lens is taken to be, so the motion to the true one is fitted; the last line is without it.

use std::path::Path;

use nalgebra::{
    Isometry3, Matrix3, Matrix6, Point3, Translation3, UnitQuaternion, Vector3, Vector6,
};
use plenocal::io::{Project, read_camera, read_features, read_poses};
use plenocal::{Error, Result, solver};

/// A corner: where it is found, with its covariance, and where it is.
struct Corner {
    found: Point3<f64>,
    covariance: Matrix3<f64>,
    truth: Point3<f64>,
}

fn main() -> Result<()> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let [set, subset, camera, features] = &arguments[..] else {
        return Err(Error::invalid(
            "usage: points_against_truth DATA-SET SUBSET camera.json features.csv",
        ));
    };
    let corners = corners(Path::new(set), subset, Path::new(camera), Path::new(features))?;
    let motion = fitted_motion(&corners);
    println!("{} corners", corners.len());
    report("after the motion between the camera frames", &corners, &motion, 6);
    report("as they are", &corners, &Isometry3::identity(), 0);
    Ok(())
}

fn corners(set: &Path, subset: &str, camera: &Path, features: &Path) -> Result<Vec<Corner>> {
    let board = Project::read(&set.join("project.toml"))?.board.expect("a data set has a board");
    let poses = read_poses(&set.join("truth").join(subset).join("poses.json"))?;
    let found = solver::corners(&read_camera(camera)?, &read_features(features, false)?.features)?;
    println!("features scatter by {:.2} times their sigma", found.scatter.sqrt());
    let corner = |((frame, number), point): ((u32, i32), Option<_>)| {
        let solver::MetricPoint { point_mm, covariance_mm2, .. } = point?;
        let pose = poses.iter().find(|pose| pose.frame == frame)?;
        Some(Corner {
            found: point_mm.into(),
            covariance: Matrix3::from_row_slice(&covariance_mm2),
            truth: pose.camera_from_board * board.point_mm(number),
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

/// Errors across and along the ray from the lens, as they are and as predicted, and χ² over its degrees of freedom.
fn report(how: &str, corners: &[Corner], motion: &Isometry3<f64>, fitted: usize) {
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
    let [across, along] = off_square.map(|square| (square / count).sqrt());
    let [sigma_across, sigma_along] = predicted.map(|square| (square / count).sqrt());
    println!(
        "{how}: RMS {across:.4} mm across (per axis; predicted {sigma_across:.4}), {along:.4} mm along (predicted \
         {sigma_along:.4}), chi-square {:.2} for each degree of freedom",
        chi_square / (3.0 * count - fitted as f64)
    );
}
