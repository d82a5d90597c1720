//! Initial intrinsics from datasheet, internal parameters and grid (paper, section 5.1).

use nalgebra::{Vector2, Vector3};

use crate::error::{Error, Result};
use crate::model::{
    Datasheet, EdgeSpread, InternalParameters, LensSetting, MainLens, MicroLensArray,
    PlenopticCamera, optics,
};
use crate::precalibration::MicroImageArray;

/// Returns the camera from which the refinement starts. The array is placed so that the micro-image centres are
/// reprojected onto the grid. The optical axis meets the sensor at `principal_point`, px, and has the exit pupil at
/// e_z = `exit_pupil_mm`.
///
/// Returns an error if a value is impossible.
pub fn initial_camera(
    datasheet: &Datasheet,
    internal: &InternalParameters,
    grid: &MicroImageArray,
    exit_pupil_mm: f64,
    principal_point: Vector2<f64>,
) -> Result<PlenopticCamera> {
    datasheet.validate()?;
    internal.validate(datasheet.lens_types)?;
    let pixel = datasheet.sensor.pixel_size_mm;
    let micro_image_pitch = internal.micro_image_pitch_mm.unwrap_or(grid.pitch_px * pixel);
    let (lens_to_mla, mla_to_sensor) = optics::initial_distances(
        datasheet.focal_length_mm,
        datasheet.focus_distance_mm,
        internal.m_mm,
        datasheet.configuration,
        exit_pupil_mm,
    );
    let pupil_to_mla = lens_to_mla + exit_pupil_mm;
    if !(lens_to_mla > 0.0 && mla_to_sensor > 0.0 && pupil_to_mla > 0.0) {
        return Err(Error::invalid(format!(
            "F = {} mm, m = {} mm and an exit pupil at {exit_pupil_mm} mm contradict each other: \
             they give D = {lens_to_mla} mm and d = {mla_to_sensor} mm",
            datasheet.focal_length_mm, internal.m_mm
        )));
    }
    let pitch = optics::micro_lens_pitch(micro_image_pitch, pupil_to_mla, mla_to_sensor);
    // The ray from the pupil through the centre of the array meets the sensor at the centre of the grid.
    let shrink = pupil_to_mla / (pupil_to_mla + mla_to_sensor);
    let focal_length = |&q: &f64| optics::micro_lens_focal_length(q, pitch, mla_to_sensor);
    Ok(PlenopticCamera {
        sensor: datasheet.sensor,
        lattice: grid.lattice,
        main_lens: MainLens {
            setting: Some(LensSetting {
                f_number: datasheet.f_number,
                focus_distance_mm: datasheet.focus_distance_mm,
            }),
            exit_pupil_mm: Vector3::new(0.0, 0.0, exit_pupil_mm),
            ..MainLens::thin(datasheet.focal_length_mm)
        },
        mla: MicroLensArray {
            principal_point_px: principal_point,
            mla_to_sensor_mm: mla_to_sensor,
            rotation_rad: Vector3::new(0.0, 0.0, grid.rotation_rad),
            offset_mm: (principal_point - grid.center_px) * pixel * shrink,
            lens_to_mla_mm: lens_to_mla,
            pitch_mm: pitch,
            pitch_ratio: 1.0,
            focal_lengths_mm: internal
                .q_prime_mm
                .iter()
                .take(datasheet.lens_types)
                .map(focal_length)
                .collect(),
        },
        edge_spread: EdgeSpread {
            aperture_ratio: internal.aperture_ratio,
            opening: internal.opening,
            point_spread_px2: internal.point_spread_px2,
        },
    })
}
