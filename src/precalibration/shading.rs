//! What oblique light does to centroids, and its correction.
//!
//! Light falls off with the angle at which it meets the sensor, by cos⁴ and by what the pixels add.
//! Away from the optical axis a micro-image is therefore brighter on one side, and its centroid moves
//! in proportion to its distance from the axis: all centres together seem to have another pitch. By
//! how much depends on the size of the micro-image. To first order, with the discs of radius a
//! (pupil) and b (micro-lens, of radius r) that make up a micro-image, the shift is proportional to
//!
//!     X = (a² − b (r − b)) / 4   (f > d)        X = (a² + b (r + b)) / 4   (f < d),
//!
//! the mean of offset times the change of slope there. Pitch and centre measured at several f-numbers
//! and extrapolated to X = 0 are free of it, whatever the law.

use nalgebra::Vector2;

/// What is known of a white image: X (px²), and pitch and centre of the grid fitted to it.
#[derive(Debug, Clone, Copy)]
pub(super) struct Shaded {
    pub x: f64,
    pub pitch_px: f64,
    pub center_px: Vector2<f64>,
}

/// Shift of centroids with X.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct Shading {
    /// Relative change of the pitch by X, 1/px².
    pub pitch: f64,
    /// Change of the centre by X, 1/px.
    pub center: Vector2<f64>,
}

/// X of discs of radius a and b behind a micro-lens of radius r, all on the sensor in px; `inverted`
/// for f < d.
pub(super) fn shading_moment(a: f64, b: f64, r: f64, inverted: bool) -> f64 {
    let of_lens = if inverted { b * (r + b) } else { -b * (r - b) };
    (a * a + of_lens) / 4.0
}

/// Least range of X (px²) that says something of the slope.
const LEAST_RANGE: f64 = 0.5;

/// Slopes of pitch and centre over X; none if there is too little to tell.
pub(super) fn fit_shading(images: &[Shaded]) -> Shading {
    let count = images.len() as f64;
    let mean_x = images.iter().map(|s| s.x).sum::<f64>() / count;
    let spread = images.iter().map(|s| (s.x - mean_x).powi(2)).sum::<f64>();
    if images.len() < 2 || (spread / count).sqrt() < LEAST_RANGE {
        return Shading::default();
    }
    let mean_pitch = images.iter().map(|s| s.pitch_px).sum::<f64>() / count;
    let pitch = images.iter().map(|s| (s.x - mean_x) * s.pitch_px).sum::<f64>() / spread;
    let center = images.iter().map(|s| s.center_px * (s.x - mean_x)).sum::<Vector2<f64>>() / spread;
    Shading { pitch: pitch / mean_pitch, center }
}

impl Shading {
    /// The centre free of shading, of a micro-image with moment x.
    pub fn corrected(&self, measured: Vector2<f64>, middle: &Vector2<f64>, x: f64) -> Vector2<f64> {
        measured - (self.center + (measured - middle) * self.pitch) * x
    }
}
