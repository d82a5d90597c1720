//! plenocal

#![allow(clippy::doc_markdown)]
pub mod calibration;
pub mod camera;
pub mod error;
pub mod evaluation;
pub mod io;
pub mod lattice;
pub mod observations;
pub mod optics;
pub mod precalibration;
pub mod report;
pub mod synthetic;

mod bridge;

pub use error::{Error, Result};
