//! Triangulation of corners of boards.

use std::collections::BTreeMap;

use super::back_projection::triangulate;
use super::bridge::ffi::{Loss, LossKind, MetricPoint, MicroPixel, SeenPoint, Sighting};
use crate::error::Result;
use crate::model::{BapFeature, PlenopticCamera};

/// Scale of the loss on the sightings of a corner, σ: few features are that far off, and these are outliers.
const LOSS_SCALE: f64 = 3.0;

/// Least factor on the variance of features: without noise there is no scatter.
const LEAST_SCATTER: f64 = 1e-6;
/// Number of rounds that adapt σ to the scatter.
const ROUNDS: usize = 2;
/// Least number of degrees of freedom that adapts σ: with fewer, the scatter is chance, and σ stays as stated.
const LEAST_FREEDOM: usize = 30;

/// Corners of boards in space.
#[derive(Debug, Clone, PartialEq)]
pub struct Corners {
    /// Frame and number of each corner.
    pub labels: Vec<(u32, i32)>,
    /// Positions of the corners; `None` if their features do not determine them.
    pub points: Vec<Option<MetricPoint>>,
    /// Ratio of the variance of features to the variance according to their σ; 1 with too few redundant features.
    pub scatter: f64,
}

/// Triangulates corners from the features of boards. A loss (Huber, 3 σ) makes this robust to outliers. Covariances are
/// multiplied by the ratio of the variance of features to the variance according to their σ, the mean over all corners. σ of ρ
/// is at least the value stated by the detection: all features of a corner were fitted with the same blur, which follows from
/// their own line, so that they share its error.
///
/// Features without σ have 1 px. Errors are the same as in [`triangulate`].
pub fn corners(camera: &PlenopticCamera, features: &[BapFeature]) -> Result<Corners> {
    let mut seen: BTreeMap<(u32, i32), SeenPoint> = BTreeMap::new();
    for f in features {
        let point = seen.entry((f.frame, f.corner)).or_default();
        let [u, v] = f.std_dev_px.unwrap_or([1.0; 2]);
        point.sightings.push(Sighting {
            at: MicroPixel { k: f.k, l: f.l, u_px: f.u_px, v_px: f.v_px },
            rho_px: f64::NAN,
            std_dev_px: [u, v, f64::INFINITY],
            correlation: f.correlation,
        });
        point.rho_std_dev_px = point.rho_std_dev_px.max(f.rho_std_dev_px.unwrap_or(0.0));
    }
    let (labels, mut seen): (Vec<_>, Vec<_>) = seen.into_iter().unzip();
    let loss = Loss { kind: LossKind::Huber, scale: LOSS_SCALE };
    let mut points = triangulate(camera, &seen, loss)?;
    let mut all = 1.0;
    // A new σ changes which sightings the loss affects, and thus slightly the scatter.
    for _ in 0..ROUNDS {
        let more = scatter(&points);
        all *= more;
        let sightings = seen.iter_mut().flat_map(|point| &mut point.sightings);
        for std_dev in sightings.flat_map(|sighting| &mut sighting.std_dev_px[..2]) {
            *std_dev *= more.max(LEAST_SCATTER).sqrt();
        }
        points = triangulate(camera, &seen, loss)?;
    }
    Ok(Corners { labels, points, scatter: all })
}

/// Computes χ² per degree of freedom over all points.
fn scatter(points: &[Option<MetricPoint>]) -> f64 {
    let freedom: usize = points.iter().flatten().map(|p| p.freedom).sum();
    let chi_square: f64 = points.iter().flatten().map(|p| p.chi_square).sum();
    if freedom >= LEAST_FREEDOM { chi_square / freedom as f64 } else { 1.0 }
}
