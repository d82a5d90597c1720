//! Observations simulated with the camera model itself, with Gaussian noise of known size.
//!
//! They test the estimation, which has to recover the parameters within their predicted uncertainty. They cannot test the
//! model, since they are made with it.

use nalgebra::{Isometry3, Vector2};

use super::bridge::ffi::{Projected, SolverFeature};
use super::forward::{project, project_centers};
use super::problem::Problem;
use crate::error::Result;
use crate::model::{
    BapFeature, BentBoard, Board, FramePose, MicroImageCenter, Noise, NoiseSource, Observations,
    PlenopticCamera,
};

/// Least distance of a visible corner from the edge of its micro-image, px: nearer to the edge a detector cannot use both sides
/// of the corner.
const EDGE_MARGIN_PX: f64 = 3.0;

/// Simulates the centres of all micro-images that lie completely in the image, and the features of every corner in every
/// micro-image that shows it, frame by frame. The same seed gives the same noise.
pub fn synthesize(
    camera: &PlenopticCamera,
    board: &Board,
    poses: &[FramePose],
    noise: &Noise,
    seed: u64,
) -> Result<Observations> {
    synthesize_bent(camera, &BentBoard::from(*board), poses, noise, seed)
}

/// Simulates the observations of a board that is not flat, like [`synthesize`].
pub fn synthesize_bent(
    camera: &PlenopticCamera,
    board: &BentBoard,
    poses: &[FramePose],
    noise: &Noise,
    seed: u64,
) -> Result<Observations> {
    camera.validate()?;
    board.board.validate()?;
    let mut source = NoiseSource::new(noise, seed)?;
    let centers = whole_micro_images(camera)?;
    let radius = camera.micro_image_pitch_px() / 2.0 - EDGE_MARGIN_PX;

    let mut features = Vec::new();
    for pose in poses {
        for corner in 0..board.board.corners() {
            for (center, projected) in
                centers.iter().zip(project_corner(camera, board, pose, corner, &centers)?)
            {
                let Some(projected) = projected else { continue };
                let Projected { u_px, v_px, .. } = projected;
                let offset = Vector2::new(u_px - center.u_px, v_px - center.v_px);
                if offset.norm() <= radius {
                    features.push(source.feature(&BapFeature {
                        frame: pose.frame,
                        corner,
                        k: center.k,
                        l: center.l,
                        u_px,
                        v_px,
                        rho_px: projected.rho(),
                        std_dev_px: None,
                        rho_std_dev_px: None,
                        correlation: 0.0,
                        sensitivities_px: None,
                        blur: None,
                    }));
                }
            }
        }
    }
    let centers = centers.iter().map(|center| source.center(center)).collect();
    Ok(Observations { centers, features, ..Observations::default() })
}

fn whole_micro_images(camera: &PlenopticCamera) -> Result<Vec<MicroImageCenter>> {
    let mut centers: Vec<MicroImageCenter> = (0..camera.lattice.rows)
        .flat_map(|l| (0..camera.lattice.columns).map(move |k| (k, l)))
        .map(|(k, l)| MicroImageCenter { k, l, u_px: 0.0, v_px: 0.0, std_dev_px: None })
        .collect();
    let projected = project_centers(camera, centers.iter().map(|c| (c.k, c.l)))?;
    let radius = camera.micro_image_pitch_px() / 2.0;
    let whole = |c: &MicroImageCenter| {
        let inside = |x: f64, size: u32| x >= radius && x <= f64::from(size) - 1.0 - radius;
        inside(c.u_px, camera.sensor.width_px) && inside(c.v_px, camera.sensor.height_px)
    };
    for (center, [u, v]) in centers.iter_mut().zip(projected) {
        (center.u_px, center.v_px) = (u, v);
    }
    centers.retain(whole);
    Ok(centers)
}

fn project_corner(
    camera: &PlenopticCamera,
    board: &BentBoard,
    pose: &FramePose,
    corner: i32,
    centers: &[MicroImageCenter],
) -> Result<Vec<Option<Projected>>> {
    let features: Vec<SolverFeature> = centers
        .iter()
        .map(|c| SolverFeature {
            pose: 0,
            board_point_mm: board.board.point_mm(corner).coords.into(),
            k: c.k,
            l: c.l,
            u_px: 0.0,
            v_px: 0.0,
            rho_px: f64::NAN,
            std_dev_px: [1.0; 3],
        })
        .collect();
    let poses: [Isometry3<f64>; 1] = [pose.camera_from_board];
    project(&Problem { camera, board: *board, poses: &poses, features: &features, centers: &[] })
}
