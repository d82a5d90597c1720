//! The bridge to the C++ core: whole problems go over as plain values, results come back as
//! `Result`. No other module knows that there is C++ on the far side, and no other is unsafe.

use std::any::Any;
use std::panic::{AssertUnwindSafe, catch_unwind, resume_unwind};

use nalgebra::{DMatrix, Isometry3, Translation3, UnitQuaternion, Vector3};

use super::options::{CostOptions, Loss, SolverOptions};
use super::problem::{Problem, SolverCenter, SolverFeature};
use super::refinement::{Iteration, Refinement, Termination};
use super::uncertainty::Uncertainty;
use crate::error::{Error, Result};
use crate::model::{LatticeKind, Parity, PlenopticCamera};

// cxx asks for the lifetimes to be spelt out.
#[allow(unsafe_code, clippy::elidable_lifetime_names)]
#[cxx::bridge(namespace = "plenocal::bridge")]
mod ffi {
    /// A camera as the solver's parameter blocks plus what is not a parameter.
    struct CameraParts {
        lattice_kind: i32,
        columns: i32,
        rows: i32,
        shifted_parity: i32,
        pixel_size_mm: f64,
        main_lens: [f64; 6],
        array: [f64; 11],
        focal_lengths_mm: Vec<f64>,
    }

    /// `camera_from_board` as angle-axis (rad) and translation (mm).
    struct PoseBlock {
        block: [f64; 6],
    }

    struct FeatureRow {
        frame: i32,
        board_point_mm: [f64; 3],
        k: i32,
        l: i32,
        u_px: f64,
        v_px: f64,
        rho_px: f64,
        /// Of u, v and ρ.
        std_dev_px: [f64; 3],
    }

    struct CenterRow {
        k: i32,
        l: i32,
        u_px: f64,
        v_px: f64,
        std_dev_px: f64,
    }

    /// Micro-lens (k, l).
    struct MicroLensIndex {
        k: i32,
        l: i32,
    }

    /// A projected feature or centre; `lens_type` is -1 where the model is not defined.
    struct Projection {
        lens_type: i32,
        u_px: f64,
        v_px: f64,
        rho_px: f64,
    }

    struct CostParts {
        uv_std_dev_px: f64,
        rho_std_dev_px: f64,
        centers_std_dev_px: f64,
        loss_kind: i32,
        loss_scale: f64,
        held: Vec<String>,
    }

    struct SolverParts {
        max_iterations: i32,
        threads: i32,
        initial_trust_region_radius: f64,
        extrapolate: bool,
    }

    struct IterationRow {
        number: i32,
        cost: f64,
        gradient_max_norm: f64,
        step_norm: f64,
        trust_region_radius: f64,
        time_s: f64,
    }

    struct RefinementParts {
        camera: CameraParts,
        poses: Vec<PoseBlock>,
        initial_cost: f64,
        cost: f64,
        frame_costs: Vec<f64>,
        termination: i32,
        message: String,
        report: String,
        time_s: f64,
        iterations: Vec<IterationRow>,
    }

    struct UncertaintyParts {
        free_intrinsics: Vec<i32>,
        size: i32,
        rank: i32,
        covariance: Vec<f64>,
        information: Vec<f64>,
        weakest: Vec<f64>,
        determined: Vec<bool>,
        residual_std_dev_px: [f64; 3],
        expected_decrease: f64,
    }

    extern "Rust" {
        type ProgressSink<'a>;
        unsafe fn report<'a>(self: &mut ProgressSink<'a>, iteration: &IterationRow) -> bool;
    }

    unsafe extern "C++" {
        include!("bridge.hpp");

        fn silence_log();
        #[allow(dead_code)] // used by tests
        fn intrinsic_names(lens_types: i32) -> Vec<String>;
        #[allow(dead_code)] // used by tests
        fn lattice(camera: &CameraParts) -> Vec<Projection>;
        fn project(
            camera: &CameraParts,
            poses: &[PoseBlock],
            features: &[FeatureRow],
        ) -> Result<Vec<Projection>>;
        fn project_centers(
            camera: &CameraParts,
            micro_lenses: &[MicroLensIndex],
        ) -> Result<Vec<Projection>>;
        unsafe fn refine<'a>(
            camera: &CameraParts,
            poses: &[PoseBlock],
            features: &[FeatureRow],
            centers: &[CenterRow],
            cost: &CostParts,
            solver: &SolverParts,
            progress: &mut ProgressSink<'a>,
        ) -> Result<RefinementParts>;
        fn uncertainty(
            camera: &CameraParts,
            poses: &[PoseBlock],
            features: &[FeatureRow],
            centers: &[CenterRow],
            cost: &CostParts,
        ) -> Result<UncertaintyParts>;
    }
}

/// Carries the caller's progress function across, and a panic of it back.
struct ProgressSink<'a> {
    callback: &'a mut dyn FnMut(&Iteration) -> bool,
    panic: Option<Box<dyn Any + Send>>,
}

impl ProgressSink<'_> {
    fn report(&mut self, row: &ffi::IterationRow) -> bool {
        let iteration = Iteration::from(row);
        match catch_unwind(AssertUnwindSafe(|| (self.callback)(&iteration))) {
            Ok(go_on) => go_on,
            Err(panic) => {
                self.panic = Some(panic);
                false
            }
        }
    }
}

/// Keeps warnings of Ceres off stderr, for the whole process: those of steps that leave the domain
/// of the model are no news.
///
/// For programs, once, before they start threads. A library leaves the log as it finds it.
pub fn silence_log() {
    ffi::silence_log();
}

/// Names of the intrinsic parameters as the core orders them.
#[cfg(test)]
pub(crate) fn intrinsic_names(lens_types: usize) -> Vec<String> {
    ffi::intrinsic_names(count(lens_types))
}

/// Position (pitches) and lens type of every micro-lens as the core numbers them, row by row.
#[cfg(test)]
pub(crate) fn lattice(camera: &PlenopticCamera) -> Vec<(f64, f64, usize)> {
    let nodes = ffi::lattice(&camera.into());
    nodes.iter().map(|p| (p.u_px, p.v_px, usize::try_from(p.lens_type).unwrap())).collect()
}

/// Projects every feature's board point through its micro-lens: (u, v, ρ) in px; `None` where the
/// model is not defined.
pub(crate) fn project(problem: &Problem) -> Result<Vec<Option<[f64; 3]>>> {
    let rows =
        ffi::project(&problem.camera.into(), &problem.pose_blocks(), &problem.feature_rows())
            .map_err(solver_error)?;
    let defined = |p: &ffi::Projection| (p.lens_type >= 0).then_some([p.u_px, p.v_px, p.rho_px]);
    Ok(rows.iter().map(defined).collect())
}

/// Projects micro-lenses (k, l) to their micro-image centres (u, v) in px.
pub(crate) fn project_centers(
    camera: &PlenopticCamera,
    micro_lenses: impl Iterator<Item = (i32, i32)>,
) -> Result<Vec<[f64; 2]>> {
    let micro_lenses: Vec<_> = micro_lenses.map(|(k, l)| ffi::MicroLensIndex { k, l }).collect();
    let rows = ffi::project_centers(&camera.into(), &micro_lenses).map_err(solver_error)?;
    Ok(rows.iter().map(|p| [p.u_px, p.v_px]).collect())
}

/// Minimises the cost over camera and poses.
#[allow(unsafe_code)]
pub(crate) fn refine(
    problem: &Problem,
    cost: &CostOptions,
    solver: &SolverOptions,
    progress: &mut dyn FnMut(&Iteration) -> bool,
) -> Result<Refinement> {
    let mut sink = ProgressSink { callback: progress, panic: None };
    // SAFETY: the sink is used by this call only, which ends before it and what it borrows do.
    let result = unsafe {
        ffi::refine(
            &problem.camera.into(),
            &problem.pose_blocks(),
            &problem.feature_rows(),
            &problem.center_rows(),
            &cost.into(),
            &solver.into(),
            &mut sink,
        )
    };
    if let Some(panic) = sink.panic {
        resume_unwind(panic);
    }
    let parts = result.map_err(solver_error)?;
    Ok(Refinement {
        camera: problem.camera.with_intrinsics(&parts.camera.intrinsics()),
        poses: parts.poses.iter().map(Isometry3::from).collect(),
        initial_cost: parts.initial_cost,
        cost: parts.cost,
        frame_costs: parts.frame_costs,
        termination: match parts.termination {
            0 => Termination::Converged,
            1 => Termination::IterationLimit,
            2 => Termination::Stopped,
            _ => Termination::Failed,
        },
        message: parts.message,
        report: parts.report,
        time_s: parts.time_s,
        iterations: parts.iterations.iter().map(Iteration::from).collect(),
    })
}

/// Uncertainty of the parameters at a minimum.
pub(crate) fn uncertainty(problem: &Problem, cost: &CostOptions) -> Result<Uncertainty> {
    let parts = ffi::uncertainty(
        &problem.camera.into(),
        &problem.pose_blocks(),
        &problem.feature_rows(),
        &problem.center_rows(),
        &cost.into(),
    )
    .map_err(solver_error)?;
    let size = usize::try_from(parts.size).unwrap_or(0);
    let index = |i: &i32| usize::try_from(*i).unwrap_or(0);
    Ok(Uncertainty {
        free_intrinsics: parts.free_intrinsics.iter().map(index).collect(),
        rank: usize::try_from(parts.rank).unwrap_or(0),
        covariance: DMatrix::from_row_slice(size, size, &parts.covariance),
        information: parts.information,
        weakest: parts.weakest.chunks_exact(size.max(1)).map(<[f64]>::to_vec).collect(),
        determined: parts.determined,
        residual_std_dev_px: parts.residual_std_dev_px,
        expected_decrease: parts.expected_decrease,
    })
}

// Values map_err hands over.
#[allow(clippy::needless_pass_by_value)]
fn solver_error(error: cxx::Exception) -> Error {
    Error::Invalid(error.what().to_owned())
}

fn count(n: usize) -> i32 {
    i32::try_from(n).unwrap_or(i32::MAX)
}

impl Problem<'_> {
    fn pose_blocks(&self) -> Vec<ffi::PoseBlock> {
        self.poses.iter().map(ffi::PoseBlock::from).collect()
    }

    fn feature_rows(&self) -> Vec<ffi::FeatureRow> {
        let row = |f: &SolverFeature| ffi::FeatureRow {
            frame: count(f.pose),
            board_point_mm: f.board_point_mm.coords.into(),
            k: f.k,
            l: f.l,
            u_px: f.u_px,
            v_px: f.v_px,
            rho_px: f.rho_px,
            std_dev_px: f.std_dev_px,
        };
        self.features.iter().map(row).collect()
    }

    fn center_rows(&self) -> Vec<ffi::CenterRow> {
        let row = |c: &SolverCenter| ffi::CenterRow {
            k: c.k,
            l: c.l,
            u_px: c.u_px,
            v_px: c.v_px,
            std_dev_px: c.std_dev_px,
        };
        self.centers.iter().map(row).collect()
    }
}

impl From<&PlenopticCamera> for ffi::CameraParts {
    fn from(camera: &PlenopticCamera) -> Self {
        let values = camera.intrinsics();
        let (main_lens, rest) = values.split_at(6);
        let (array, focal_lengths) = rest.split_at(11);
        Self {
            lattice_kind: match camera.lattice.kind() {
                LatticeKind::Orthogonal => 0,
                LatticeKind::HexagonalRows => 1,
                LatticeKind::HexagonalColumns => 2,
            },
            columns: camera.lattice.columns,
            rows: camera.lattice.rows,
            shifted_parity: match camera.lattice.packing.shifted() {
                None | Some(Parity::Even) => 0,
                Some(Parity::Odd) => 1,
            },
            pixel_size_mm: camera.sensor.pixel_size_mm,
            main_lens: main_lens.try_into().expect("the block has this size"),
            array: array.try_into().expect("the block has this size"),
            focal_lengths_mm: focal_lengths.to_vec(),
        }
    }
}

impl ffi::CameraParts {
    fn intrinsics(&self) -> Vec<f64> {
        [&self.main_lens[..], &self.array[..], &self.focal_lengths_mm[..]].concat()
    }
}

impl From<&Isometry3<f64>> for ffi::PoseBlock {
    fn from(pose: &Isometry3<f64>) -> Self {
        let (r, t) = (pose.rotation.scaled_axis(), pose.translation.vector);
        Self { block: [r.x, r.y, r.z, t.x, t.y, t.z] }
    }
}

impl From<&ffi::PoseBlock> for Isometry3<f64> {
    fn from(pose: &ffi::PoseBlock) -> Self {
        let [rx, ry, rz, tx, ty, tz] = pose.block;
        let rotation = UnitQuaternion::from_scaled_axis(Vector3::new(rx, ry, rz));
        Isometry3::from_parts(Translation3::new(tx, ty, tz), rotation)
    }
}

impl From<&ffi::IterationRow> for Iteration {
    fn from(row: &ffi::IterationRow) -> Self {
        Self {
            number: row.number,
            cost: row.cost,
            gradient_max_norm: row.gradient_max_norm,
            step_norm: row.step_norm,
            trust_region_radius: row.trust_region_radius,
            time_s: row.time_s,
        }
    }
}

impl From<&CostOptions> for ffi::CostParts {
    fn from(cost: &CostOptions) -> Self {
        let (loss_kind, loss_scale) = match cost.loss {
            Loss::None => (0, 1.0),
            Loss::Huber { scale } => (1, scale),
            Loss::Cauchy { scale } => (2, scale),
        };
        Self {
            uv_std_dev_px: cost.uv_std_dev_px,
            rho_std_dev_px: cost.rho_std_dev_px,
            centers_std_dev_px: cost.centers_std_dev_px,
            loss_kind,
            loss_scale,
            held: cost.fixed.clone(),
        }
    }
}

impl From<&SolverOptions> for ffi::SolverParts {
    fn from(solver: &SolverOptions) -> Self {
        Self {
            max_iterations: count(solver.max_iterations),
            threads: count(solver.threads),
            initial_trust_region_radius: solver.initial_trust_region_radius,
            extrapolate: solver.extrapolate,
        }
    }
}

#[cfg(test)]
mod tests {
    use nalgebra::{Point3, Vector2, Vector3};

    use super::*;
    use crate::model::{Lattice, MainLens, MicroLensArray, Packing, Sensor, intrinsic_parameters};

    fn camera(packing: Packing, columns: i32, rows: i32) -> PlenopticCamera {
        let types = if packing == Packing::Orthogonal { 1 } else { 3 };
        PlenopticCamera {
            sensor: Sensor { width_px: 100, height_px: 80, pixel_size_mm: 0.0055 },
            lattice: Lattice { packing, columns, rows },
            main_lens: MainLens {
                focal_length_mm: 50.0,
                radial: [1.0, 2.0, 3.0],
                tangential: [4.0, 5.0],
                setting: None,
            },
            mla: MicroLensArray {
                principal_point_px: Vector2::new(6.0, 7.0),
                mla_to_sensor_mm: 0.3,
                rotation_rad: Vector3::new(0.1, 0.2, 0.3),
                offset_mm: Vector2::new(8.0, 9.0),
                lens_to_mla_mm: 56.0,
                pitch_mm: 0.127,
                pitch_ratio: 1.01,
                focal_lengths_mm: vec![0.5; types],
            },
        }
    }

    #[test]
    fn both_sides_name_the_parameters_alike() {
        for types in [0, 1, 3] {
            let ours: Vec<&str> = intrinsic_parameters(types).iter().map(|p| p.name).collect();
            assert_eq!(ours, intrinsic_names(types));
        }
    }

    #[test]
    fn both_sides_number_the_lattice_alike() {
        for kind in
            [LatticeKind::Orthogonal, LatticeKind::HexagonalRows, LatticeKind::HexagonalColumns]
        {
            for &packing in Packing::of_kind(kind) {
                for (columns, rows) in [(5, 4), (4, 5), (1, 3), (3, 1)] {
                    let camera = camera(packing, columns, rows);
                    let mut theirs = lattice(&camera).into_iter();
                    for l in 0..rows {
                        for k in 0..columns {
                            let (x, y, lens_type) = theirs.next().unwrap();
                            let ours = camera.lattice.node(k, l);
                            assert!((ours - Vector2::new(x, y)).norm() < 1e-12);
                            assert_eq!(camera.lens_type(k, l), lens_type);
                        }
                    }
                }
            }
        }
    }

    #[test]
    fn a_panic_in_the_progress_function_comes_back_as_a_panic() {
        let camera = camera(Packing::HexagonalRows(Parity::Even), 8, 8);
        let pose = Isometry3::translation(0.0, 0.0, 300.0);
        let feature = |k, l, u_px| SolverFeature {
            pose: 0,
            board_point_mm: Point3::origin(),
            k,
            l,
            u_px,
            v_px: 40.0,
            rho_px: 0.0,
            std_dev_px: [1.0; 3],
        };
        let features: Vec<_> = (0..8).map(|i| feature(i, 7 - i, 10.0 * f64::from(i))).collect();
        let problem =
            Problem { camera: &camera, poses: &[pose], features: &features, centers: &[] };
        let outcome = catch_unwind(AssertUnwindSafe(|| {
            refine(&problem, &CostOptions::default(), &SolverOptions::default(), &mut |_| {
                panic!("from the caller")
            })
        }));
        let message = outcome.unwrap_err();
        assert_eq!(message.downcast_ref::<&str>(), Some(&"from the caller"));
    }

    #[test]
    fn what_the_core_rejects_arrives_as_an_error() {
        let mut camera = camera(Packing::HexagonalRows(Parity::Even), 8, 8);
        camera.mla.mla_to_sensor_mm = f64::NAN;
        let error = project_centers(&camera, std::iter::empty()).unwrap_err().to_string();
        assert!(error.contains("d (mm)"), "{error}");
    }
}
