//! Results for people (tables, words) and for machines (JSON).

mod calibration;

pub use calibration::{
    calibrated_camera, calibration_json, calibration_text, termination_text,
    weakest_directions_text,
};
