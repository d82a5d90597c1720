//! Pixels of micro-images, and what is seen through them.

use nalgebra::{Matrix3, Point3, Vector3};

/// A pixel of micro-image (k, l).
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct MicroPixel {
    /// Column of the micro-lens.
    pub k: i32,
    /// Its row.
    pub l: i32,
    /// Place in the raw image, px.
    pub u_px: f64,
    /// Likewise.
    pub v_px: f64,
}

/// A straight line in the camera frame.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Ray {
    /// A point of it, mm.
    pub origin_mm: Point3<f64>,
    /// Of unit length, towards the scene.
    pub direction: Vector3<f64>,
}

/// A point that is seen at a virtual depth.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct VirtualPoint {
    /// Where it is seen.
    pub at: MicroPixel,
    /// ν: how far behind the array its image lies, in units of the distance to the sensor.
    pub virtual_depth: f64,
    /// σ of u and v, px, and of ν; 0 for what is known.
    pub std_dev: [f64; 3],
}

/// A point as one micro-lens sees it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Sighting {
    /// Where it is seen.
    pub at: MicroPixel,
    /// σ of u and v, px.
    pub std_dev_px: [f64; 2],
    /// Correlation of their errors, between −1 and 1.
    pub correlation: f64,
    /// ρ and its σ, px, where it was measured.
    pub rho: Option<[f64; 2]>,
}

/// A point that several micro-lenses see.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct SeenPoint {
    /// How each of them sees it.
    pub sightings: Vec<Sighting>,
    /// σ of its ρ is at least this, px: what the sightings have in common does not average out. 0 if they have nothing in
    /// common.
    pub rho_std_dev_px: f64,
}

impl From<Vec<Sighting>> for SeenPoint {
    fn from(sightings: Vec<Sighting>) -> Self {
        Self { sightings, rho_std_dev_px: 0.0 }
    }
}

/// A point in the camera frame.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct MetricPoint {
    /// Its place, mm.
    pub point_mm: Point3<f64>,
    /// Covariance of x, y and z by what was measured, mm²; that of the camera is not in it.
    pub covariance_mm2: Matrix3<f64>,
    /// Of a point that several micro-lenses see: the sum of squared residuals over σ, weighted by the loss.
    pub chi_square: f64,
    /// And their number beyond three.
    pub freedom: usize,
}
