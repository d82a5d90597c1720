//! Reads and writes COMPOTE's files. Nothing outside this module depends on its conventions.
//!
//! They differ from plenocal's:
//! - JSON numbers are mostly written as strings, vectors as matrices of one row.
//! - Micro-lenses (k', l') count along +x and +y of the camera, opposite to the micro-images:
//!   k' = columns − 1 − k, l' = rows − 1 − l. Pixels of the sensor's frame are reversed likewise:
//!   x = W − 1 − u, y = H − 1 − v.
//! - The origin of the array's frame is the lattice position (0, 0), not the centre of the array.
//!   The origin of the sensor's frame is its own pixel (0, 0). Poses transform from array or sensor
//!   to the camera.
//! - On a hexagonal mesh the rows of even index are shifted, both of the array (l') and of the
//!   micro-images (l), so only arrays with an even number of rows can be written.
//! - A pose (R, t) has its origin at t in the parent's frame, and R rotates from the parent's axes
//!   to its own: a point p of the parent is at R (p − t). The pose of a frame is the pose of the
//!   camera in the world, with the board at z = 0. (With the opposite convention, the published
//!   R12-A camera misses its own micro-image centres by 0.88 px instead of 0.29 px RMS, and the
//!   published poses are far from those that fit the features.)
//! - The blur radius seems to be computed with the distance d at node (0, 0) for all micro-lenses:
//!   with the published R12-A camera the residuals of ρ vanish there and grow linearly across the
//!   tilted array, to 0.4 px at its centre. plenocal uses the distance of each micro-lens.

mod files;
mod json;
mod linked;

use nalgebra::{Matrix3, Rotation3, SMatrix, Vector2, Vector3};
use serde_json::{Value, json};

use super::json_file::document_of;
use super::poses_file::possible;
use crate::error::{Error, Result};
use crate::model::{
    Board, Configuration, Datasheet, EdgeSpread, FramePose, InternalParameters, Lattice,
    LatticeKind, LensSetting, MainLens, MicroLensArray, Opening, Packing, Parity, PlenopticCamera,
    ROW_DISTANCE, Sensor, optics,
};
use crate::precalibration::MicroImageArray;
use files::{CameraFile, IntrinsicsFile, ParametersFile, PosesFile, SceneFile};
use json::{matrix, number, vector};

pub(super) use linked::{is_linked_observations, linked_observations};

/// Returns the datasheet values of a `camera.js`.
pub(super) fn datasheet_from(value: Value) -> Result<Datasheet> {
    let file: CameraFile = document_of(value, "camera.js, intrinsics.js or camera.json")?;
    Ok(Datasheet {
        sensor: file.sensor.sensor()?,
        focal_length_mm: file.main_lens.f.0,
        focus_distance_mm: file.dist_focus.0,
        f_number: file.main_lens.aperture.0,
        configuration: match file.mode.0 {
            0 => Configuration::Unfocused,
            1 => Configuration::Keplerian,
            2 => Configuration::Galilean,
            other => {
                return Err(Error::invalid(format!(
                    "mode {other} is not known; it is 0 (unfocused), 1 (Keplerian) or 2 (Galilean)"
                )));
            }
        },
        lattice_kind: file.mia.mesh.lattice_kind()?,
        array_size: Some(file.mia.mesh.size()?),
        lens_types: file.lens_types.count("I")?,
        micro_image_pitch_px: match &file.mia.mesh.pitch {
            Some(pitch) => Some(pitch.fixed::<2>("the pitch of the mesh of the mia")?[0]),
            None => None,
        },
        opening: None,
    })
}

/// Returns the internal parameters of a `params.js`.
pub(super) fn internal_parameters_from(
    value: Value,
    pixel_size_mm: Option<f64>,
) -> Result<InternalParameters> {
    let file: ParametersFile = document_of(value, "params.js")?;
    if let Some(lens_types) = &file.lens_types
        && lens_types.count("I")? != file.q_prime.len()
    {
        return Err(Error::invalid(format!(
            "I is {}, but there are {} values of q_prime",
            lens_types.0,
            file.q_prime.len()
        )));
    }
    if let (Some(scale), Some(pixel)) = (&file.scale, pixel_size_mm)
        && (scale.0 / pixel - 1.0).abs() > 1e-6
    {
        return Err(Error::invalid(format!(
            "the internal parameters are for pixels of {} mm, but the pixels of the camera have {} \
             mm",
            scale.0, pixel
        )));
    }
    Ok(InternalParameters {
        // In the Galilean configuration, m is negative by the paper's sign of radii.
        m_mm: file.m.0.abs(),
        q_prime_mm: file.q_prime.iter().map(|q| q.0).collect(),
        micro_image_pitch_mm: file.dc.map(|dc| dc.0),
        m_std_dev_mm: None,
        q_prime_std_dev_mm: Vec::new(),
        pupil_growth: 0.0,
        fall_off: None,
        tilt_gradient: None,
        vignetting: None,
        point_spread_px2: None,
        aperture_ratio: None,
        opening: Opening::Disc,
        levels: None,
    })
}

/// Returns the board of a `scene.js`; an error unless there is exactly one.
pub(super) fn board_from(value: Value) -> Result<Board> {
    let file: SceneFile = document_of(value, "scene.js")?;
    let [board] = file.checkerboards.as_slice() else {
        return Err(Error::invalid(format!(
            "the scene has {} checkerboards; exactly one is supported",
            file.checkerboards.len()
        )));
    };
    Ok(Board {
        columns: board.x_grid.positive("x_grid")?,
        rows: board.y_grid.positive("y_grid")?,
        square_mm: board.lph.0,
    })
}

/// Returns the parity of the shifted rows of the array in plenocal's indices: even l' is shifted, and l' = rows − 1 − l.
fn shifted_parity(kind: LatticeKind, columns: i32, rows: i32) -> Parity {
    let across = match kind {
        LatticeKind::HexagonalRows => rows,
        LatticeKind::HexagonalColumns => columns,
        LatticeKind::Orthogonal => return Parity::Even,
    };
    // In the direction −x, a shift of even l' by +½ is a shift of odd l' by +½ and of all by −½.
    if across % 2 == 0 { Parity::Even } else { Parity::Odd }
}

/// Returns the position of COMPOTE's node (k', l') in its mesh, in pitches.
fn mesh_node(kind: LatticeKind, k: i32, l: i32) -> Vector2<f64> {
    let (k, l) = (f64::from(k), f64::from(l));
    let shift = |index: f64| if index % 2.0 == 0.0 { 0.5 } else { 0.0 };
    match kind {
        LatticeKind::Orthogonal => Vector2::new(k, l),
        LatticeKind::HexagonalRows => Vector2::new(k + shift(l), ROW_DISTANCE * l),
        LatticeKind::HexagonalColumns => Vector2::new(ROW_DISTANCE * k, l + shift(k)),
    }
}

/// Returns the vector from the origin of COMPOTE's mesh to the centre of plenocal's array, mm in the array's axes.
fn mesh_to_center(lattice: &Lattice, pitch_mm: f64, ratio: f64) -> Vector3<f64> {
    // Node (0, 0) of the mesh is the last node of the lattice, and positions in the two run in opposite directions.
    let center =
        mesh_node(lattice.kind(), 0, 0) + lattice.node(lattice.columns - 1, lattice.rows - 1);
    Vector3::new(center.x * pitch_mm, center.y * pitch_mm * ratio, 0.0)
}

/// Returns the camera of an `intrinsics.js`.
pub(super) fn camera_from(value: Value) -> Result<PlenopticCamera> {
    let file: IntrinsicsFile = document_of(value, "intrinsics.js")?;
    let sensor = file.sensor.sensor.sensor()?;
    let mesh = &file.mla.mesh.mesh;
    let (kind, (columns, rows)) = (mesh.lattice_kind()?, mesh.size()?);
    let lattice =
        Lattice { packing: Packing::new(kind, shifted_parity(kind, columns, rows)), columns, rows };
    let focal_lengths_mm: Vec<f64> = file.mla.focal_lengths.iter().map(|f| f.0).collect();
    if file.lens_types.count("I")? != focal_lengths_mm.len() {
        return Err(Error::invalid(format!(
            "I is {}, but there are {} focal lengths of micro-lenses",
            file.lens_types.0,
            focal_lengths_mm.len()
        )));
    }
    let pitch =
        mesh.pitch.as_ref().ok_or_else(|| Error::invalid("the mesh of the mla has no pitch"))?;
    let [pitch_x, pitch_y] = pitch.fixed("the pitch of the mesh of the mla")?;
    let pitch_ratio = pitch_y / pitch_x;
    let camera_from_mesh = file.mla.mesh.pose.parent_from_own()?;
    let center =
        camera_from_mesh * nalgebra::Point3::from(mesh_to_center(&lattice, pitch_x, pitch_ratio));
    let camera_from_sensor = file.sensor.pose.parent_from_own()?;
    if camera_from_sensor.rotation.angle() > 1e-9 {
        return Err(Error::invalid(
            "the sensor is rotated relative to the main lens: plenocal does not read this rotation of \
             COMPOTE's files. Calibrate with COMPOTE's sensor parallel to the lens",
        ));
    }
    let origin = camera_from_sensor.translation.vector;
    let (roll, pitch, yaw) = camera_from_mesh.rotation.euler_angles();
    let camera = PlenopticCamera {
        sensor,
        lattice,
        main_lens: MainLens {
            radial: file.distortions.radial.fixed("the radial distortion")?,
            tangential: file.distortions.tangential.fixed("the tangential distortion")?,
            setting: Some(LensSetting {
                f_number: file.main_lens.aperture.0,
                focus_distance_mm: file.dist_focus.0,
            }),
            ..MainLens::thin(file.main_lens.f.0)
        },
        mla: MicroLensArray {
            principal_point_px: last_pixel(&sensor) + origin.xy() / sensor.pixel_size_mm,
            mla_to_sensor_mm: center.z - origin.z,
            rotation_rad: Vector3::new(roll, pitch, yaw),
            offset_mm: center.coords.xy(),
            lens_to_mla_mm: -center.z,
            pitch_mm: pitch_x,
            pitch_ratio,
            focal_lengths_mm,
        },
        edge_spread: EdgeSpread::default(),
    };
    camera.validate()?;
    Ok(camera)
}

fn last_pixel(sensor: &Sensor) -> Vector2<f64> {
    2.0 * sensor.center_px()
}

/// Returns the poses of a `poses.js`.
pub(super) fn poses_from(value: Value) -> Result<Vec<FramePose>> {
    let file: PosesFile = document_of(value, "poses.js or poses.json")?;
    file.poses
        .iter()
        .map(|f| {
            let frame = u32::try_from(f.frame.0)
                .map_err(|_| Error::invalid(format!("{} is not a frame number", f.frame.0)))?;
            possible(FramePose { frame, camera_from_board: f.pose.parent_from_own()?.inverse() })
        })
        .collect()
}

/// Writes a pose, from the rotation that transforms from its own axes to the parent's, and its origin in the parent frame.
fn pose<const N: usize>(parent_from_own: &SMatrix<f64, N, N>, origin: &[f64]) -> Value {
    json!({ "rotation": matrix(&parent_from_own.transpose()), "translation": vector(origin) })
}

/// Returns the content of an `intrinsics.js`. `grid` is the micro-image array of the calibration.
///
/// An error if COMPOTE's mesh cannot represent the array, or if the setting of the lens is not known.
pub fn intrinsics_document(camera: &PlenopticCamera, grid: &MicroImageArray) -> Result<Value> {
    let (lens, mla, lattice) = (&camera.main_lens, &camera.mla, &camera.lattice);
    let (sensor, columns, rows) = (&camera.sensor, lattice.columns, lattice.rows);
    if lattice.packing.shifted().is_some_and(|shifted| {
        shifted != Parity::Even || shifted_parity(lattice.kind(), columns, rows) != Parity::Even
    }) {
        return Err(Error::invalid(format!(
            "COMPOTE cannot represent this array of {columns} x {rows}: it needs an even number of \
             rows (columns), with the even ones shifted"
        )));
    }
    let setting = lens.setting.ok_or_else(|| {
        Error::invalid("COMPOTE's intrinsics.js needs the f-number, which is not known")
    })?;

    let [roll, pitch, yaw] = mla.rotation_rad.into();
    let rotation = Rotation3::from_euler_angles(roll, pitch, yaw);
    let center = Vector3::new(mla.offset_mm.x, mla.offset_mm.y, -mla.lens_to_mla_mm);
    let origin = center - rotation * mesh_to_center(lattice, mla.pitch_mm, mla.pitch_ratio);
    let mla_pitch = [mla.pitch_mm, mla.pitch_mm * mla.pitch_ratio];
    let mla_mesh = mesh(lattice, mla_pitch, &pose(rotation.matrix(), origin.as_slice()));

    let sensor_xy = (mla.principal_point_px - last_pixel(sensor)) * sensor.pixel_size_mm;
    let sensor_z = -(mla.lens_to_mla_mm + mla.mla_to_sensor_mm);
    let unturned = Matrix3::<f64>::identity();
    Ok(json!({
        "I": camera.lens_types().to_string(),
        "mode": mode(camera.configuration().unwrap_or(Configuration::Unfocused)),
        "dist_focus": number(setting.focus_distance_mm),
        "distortions": {
            "radial": vector(&lens.radial),
            "tangential": vector(&lens.tangential),
        },
        "main_lens": {
            "aperture": number(setting.f_number),
            "diameter": number(lens.focal_length_mm / setting.f_number),
            "f": number(lens.focal_length_mm),
            "pose": pose(&unturned, &[0.0; 3]),
        },
        "mia": { "mesh": mia_mesh(grid) },
        "mla": {
            "focal_lengths": mla.focal_lengths_mm.iter().map(|&f| number(f)).collect::<Vec<_>>(),
            "mesh": mla_mesh,
        },
        "sensor": {
            "width": sensor.width_px.to_string(),
            "height": sensor.height_px.to_string(),
            "scale": number(sensor.pixel_size_mm),
            "pose": pose(&unturned, &[sensor_xy.x, sensor_xy.y, sensor_z]),
        },
    }))
}

/// Returns COMPOTE's number for a configuration.
fn mode(configuration: Configuration) -> &'static str {
    match configuration {
        Configuration::Unfocused => "0",
        Configuration::Keplerian => "1",
        Configuration::Galilean => "2",
    }
}

fn mesh(lattice: &Lattice, pitch: [f64; 2], pose: &Value) -> Value {
    let geometry = match lattice.kind() {
        LatticeKind::Orthogonal => 0,
        LatticeKind::HexagonalRows => 1,
        LatticeKind::HexagonalColumns => 2,
    };
    json!({
        "geometry": geometry.to_string(),
        "width": lattice.columns.to_string(),
        "height": lattice.rows.to_string(),
        "pitch": vector(&pitch),
        "pose": pose,
    })
}

/// Returns the mesh of the micro-images, with its origin at micro-image (0, 0).
fn mia_mesh(grid: &MicroImageArray) -> Value {
    let lattice = &grid.lattice;
    let first = mesh_node(lattice.kind(), 0, 0) - lattice.node(0, 0);
    let (sin, cos) = grid.rotation_rad.sin_cos();
    let turn = nalgebra::Matrix2::new(cos, -sin, sin, cos);
    let origin = grid.center_px - turn * first * grid.pitch_px;
    mesh(lattice, [grid.pitch_px, grid.pitch_px], &pose(&turn, origin.as_slice()))
}

/// Returns the content of a `camera.js`: the datasheet and the measured micro-image array.
#[must_use]
pub fn camera_document(sheet: &Datasheet, grid: &MicroImageArray, lens_types: usize) -> Value {
    json!({
        "mia": { "mesh": mia_mesh(grid) },
        "sensor": {
            "scale": number(sheet.sensor.pixel_size_mm),
            "width": sheet.sensor.width_px.to_string(),
            "height": sheet.sensor.height_px.to_string(),
        },
        "main_lens": { "aperture": number(sheet.f_number), "f": number(sheet.focal_length_mm) },
        "dist_focus": number(sheet.focus_distance_mm),
        "I": lens_types.to_string(),
        "mode": mode(sheet.configuration),
    })
}

/// Returns the content of a `params.js`. In the Galilean configuration radii, m and q are negative. λ = D/(D + d) is computed
/// from the initial camera.
#[must_use]
pub fn parameters_document(internal: &InternalParameters, sheet: &Datasheet) -> Value {
    let pitch = internal.micro_image_pitch_mm.unwrap_or(0.0);
    let (lens_to_mla, mla_to_sensor) = optics::initial_distances(
        sheet.focal_length_mm,
        sheet.focus_distance_mm,
        internal.m_mm,
        sheet.configuration,
        0.0,
    );
    let lambda = lens_to_mla / (lens_to_mla + mla_to_sensor);
    let side = if sheet.configuration == Configuration::Keplerian { 1.0 } else { -1.0 };
    let numbers = |values: Vec<f64>| values.into_iter().map(number).collect::<Vec<_>>();
    json!({
        "m": number(side * internal.m_mm),
        "scale": number(sheet.sensor.pixel_size_mm),
        "q": numbers(internal.q_prime_mm.iter().map(|q| q - pitch / 2.0).collect()),
        "q_prime": numbers(internal.q_prime_mm.clone()),
        "dc": number(pitch),
        "dC": number(lambda * pitch),
        "lambda": number(lambda),
        "N": number(sheet.f_number),
        "I": internal.q_prime_mm.len().to_string(),
    })
}

/// Returns the content of a `poses.js`.
#[must_use]
pub fn poses_document(poses: &[FramePose]) -> Value {
    let frame = |p: &FramePose| {
        let world_from_camera = p.camera_from_board.inverse();
        json!({
            "frame": p.frame.to_string(),
            "pose": pose(
                world_from_camera.rotation.to_rotation_matrix().matrix(),
                world_from_camera.translation.vector.as_slice(),
            ),
        })
    };
    json!({ "poses": poses.iter().map(frame).collect::<Vec<_>>() })
}
