//! Straight rays, the openings that they pass, and the ends of their paths.

use nalgebra::{Point3, Vector2};

/// A straight ray: the point where it crosses z = 0, and its slopes dx/dz and dy/dz.
#[derive(Debug, Clone, Copy)]
pub(super) struct Ray {
    pub at_lens: Vector2<f64>,
    pub slope: Vector2<f64>,
}

impl Ray {
    /// Creates the ray through a point with a slope.
    #[inline]
    pub fn from(point: &Point3<f64>, slope: Vector2<f64>) -> Self {
        Self { at_lens: point.xy().coords - slope * point.z, slope }
    }

    /// Returns the point where the ray crosses the plane at z.
    #[inline(always)]
    #[allow(clippy::inline_always)] // compiled for the registers of loops over rays
    pub fn at(&self, z: f64) -> Vector2<f64> {
        self.at_lens + self.slope * z
    }
}

/// A circular opening perpendicular to the optical axis.
#[derive(Debug, Clone, Copy)]
pub(super) struct Stop {
    pub center: Point3<f64>,
    pub radius: f64,
    /// Square of the largest distance from the middle at which rays pass.
    limit2: f64,
}

impl Stop {
    pub fn new(center: Point3<f64>, radius: f64) -> Self {
        // Rounding must not block a ray drawn on the rim.
        Self { center, radius, limit2: radius * radius * (1.0 + 1e-9) }
    }

    #[inline(always)]
    #[allow(clippy::inline_always)] // compiled for the registers of loops over rays
    pub fn passes(&self, ray: &Ray) -> bool {
        let off = ray.at(self.center.z) - self.center.xy().coords;
        off.x * off.x + off.y * off.y <= self.limit2
    }
}

/// End of the path of a ray from the sensor.
#[derive(Debug, Clone, Copy)]
pub(super) enum Passage {
    /// The ray is blocked.
    Blocked,
    /// The ray leads away from the board.
    Away,
    /// The ray continues in front of the lens.
    Seen(Ray),
}
