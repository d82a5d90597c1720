//! Initial intrinsics from datasheet, internal parameters and grid (paper, section 5.1).

use nalgebra::Vector3;

use crate::error::{Error, Result};
use crate::model::{
    Datasheet, InternalParameters, LensSetting, MainLens, MicroLensArray, PlenopticCamera, optics,
};
use crate::precalibration::MicroImageArray;

/// The camera to start the refinement from. The array is placed so that the micro-image centres are
/// reprojected onto the grid.
///
/// An error if a value is impossible.
pub fn initial_camera(
    datasheet: &Datasheet,
    internal: &InternalParameters,
    grid: &MicroImageArray,
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
    );
    if !(lens_to_mla > 0.0 && mla_to_sensor > 0.0) {
        return Err(Error::invalid(format!(
            "F = {} mm and m = {} mm leave no place for the array: D = {lens_to_mla} mm, d = \
             {mla_to_sensor} mm",
            datasheet.focal_length_mm, internal.m_mm
        )));
    }
    let pitch = optics::micro_lens_pitch(micro_image_pitch, lens_to_mla, mla_to_sensor);
    let principal_point = datasheet.sensor.center_px();
    // The centre of the array seen from O meets the sensor at the centre of the grid.
    let shrink = lens_to_mla / (lens_to_mla + mla_to_sensor);
    let focal_length = |&q: &f64| optics::micro_lens_focal_length(q, pitch, mla_to_sensor);
    Ok(PlenopticCamera {
        sensor: datasheet.sensor,
        lattice: grid.lattice,
        main_lens: MainLens {
            focal_length_mm: datasheet.focal_length_mm,
            radial: [0.0; 3],
            tangential: [0.0; 2],
            setting: Some(LensSetting {
                f_number: datasheet.f_number,
                focus_distance_mm: datasheet.focus_distance_mm,
            }),
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
    })
}
