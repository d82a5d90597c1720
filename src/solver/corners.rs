//! Corners of boards in space.

use std::collections::BTreeMap;

use super::back_projection::triangulate;
use super::bridge::ffi::{Loss, LossKind, MetricPoint, MicroPixel, SeenPoint, Sighting};
use crate::error::Result;
use crate::model::{BapFeature, PlenopticCamera};

/// Where the loss on the sightings of a corner sets in, σ: few features lie that far off, but those that do are false.
const LOSS_SCALE: f64 = 3.0;

/// Features without noise scatter by nothing; their variance is not taken to be less than this part of what they state.
const LEAST_SCATTER: f64 = 1e-6;
/// Rounds in which σ is set by the scatter.
const ROUNDS: usize = 2;
/// A scatter by fewer degrees of freedom is chance: σ is then as stated.
const LEAST_FREEDOM: usize = 30;

/// Corners of boards in space.
#[derive(Debug, Clone, PartialEq)]
pub struct Corners {
    /// Frame and number of each corner.
    pub labels: Vec<(u32, i32)>,
    /// Where they are; `None` where their features do not determine it.
    pub points: Vec<Option<MetricPoint>>,
    /// By how much features scatter more than their σ says, in variance; 1 if hardly anything is redundant.
    pub scatter: f64,
}

/// Corners from the features of boards: false ones are withstood (Huber, 3 σ), and covariances are
/// multiplied by how much features scatter more than their σ says, in the mean of all corners. σ of ρ is at
/// least what the detection states: all features of a corner were found with the same blur, which follows
/// from their own line, so that they err together.
///
/// Features without σ have one of 1 px. An error as of [`triangulate`].
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
    // The loss sets in elsewhere once σ is right, and that changes the scatter a little.
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

/// χ² for each degree of freedom over all points.
fn scatter(points: &[Option<MetricPoint>]) -> f64 {
    let freedom: usize = points.iter().flatten().map(|p| p.freedom).sum();
    let chi_square: f64 = points.iter().flatten().map(|p| p.chi_square).sum();
    if freedom >= LEAST_FREEDOM { chi_square / freedom as f64 } else { 1.0 }
}
