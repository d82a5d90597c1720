//! Observations in images: micro-image centres and BAP features.

use std::collections::{BTreeMap, BTreeSet, HashSet};

use nalgebra::Vector2;

use crate::error::{Error, Observed, Result};
use crate::model::{Board, Sensor};

/// Centre of micro-image (k, l) in a white image.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct MicroImageCenter {
    /// Index along u.
    pub k: i32,
    /// Index along v.
    pub l: i32,
    /// Position u, px.
    pub u_px: f64,
    /// Position v, px.
    pub v_px: f64,
    /// Standard deviation of u and of v, px, if measured.
    pub std_dev_px: Option<f64>,
}

/// Blur aware plenoptic feature: a board corner in micro-image (k, l) of a frame.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct BapFeature {
    /// Number of the frame.
    pub frame: u32,
    /// Board corner, `row · columns + column` (COMPOTE's `cluster`).
    pub corner: i32,
    /// Index of the micro-image along u.
    pub k: i32,
    /// Index of the micro-image along v.
    pub l: i32,
    /// Position u, px.
    pub u_px: f64,
    /// Position v, px.
    pub v_px: f64,
    /// Signed blur radius ρ of a micro-lens whose opening is as wide as the pitch, px, if measured.
    pub rho_px: Option<f64>,
    /// Standard deviations of u and v, px, if measured.
    pub std_dev_px: Option<[f64; 2]>,
    /// Correlation of the errors of u and v; 0 if it was not measured. Points in space use it, calibrations do not.
    pub correlation: f64,
    /// Standard deviation of ρ, px, if measured.
    pub rho_std_dev_px: Option<f64>,
    /// Sensitivities of u and v to the quantities [`TAKEN_QUANTITIES`], if known: px per relative change of each, per px² of the
    /// point spread, and per standard deviation of each combination of the aberrations.
    pub sensitivities_px: Option<[[f64; 2]; TAKEN]>,
    /// Blur radius from the width of its edges, if measured.
    pub blur: Option<MeasuredBlur>,
}

/// Blur radius from the width of edges. If the aperture ratio is below 1, it is smaller than ρ.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct MeasuredBlur {
    /// Blur radius φρ with the sign of ρ, px.
    pub radius_px: f64,
    /// Standard deviation of the radius, px, without the shared error.
    pub std_dev_px: f64,
    /// Change of the radius, px, due to one standard deviation of the excess edge variance of board images relative to white
    /// images: an error that all features share.
    pub shared_px: f64,
    /// Aperture ratio assumed in the fit of u, v and ρ.
    pub aperture_ratio: f64,
}

/// Number of quantities, common to all corners, on which the measurement of a position depends.
pub const TAKEN: usize = 10;
/// Names of these quantities: radius a of the exit pupil seen through the middle of a micro-lens; q'ᵢ; angular response H
/// inside a micro-image; aperture ratio, with the qᵢ that white images show; variance of the point spread; and five
/// independent combinations of the aberrations S, C and T of the main lens and its optical axis.
pub const TAKEN_QUANTITIES: [&str; TAKEN] = [
    "pupil",
    "intercept",
    "fall_off",
    "aperture_ratio",
    "point_spread",
    "aberration_1",
    "aberration_2",
    "aberration_3",
    "aberration_4",
    "aberration_5",
];

/// Indices of the quantities in [`TAKEN_QUANTITIES`].
pub mod taken {
    /// Index of the pupil radius a.
    pub const PUPIL: usize = 0;
    /// Index of q'ᵢ.
    pub const INTERCEPT: usize = 1;
    /// Index of the angular response H.
    pub const FALL_OFF: usize = 2;
    /// Index of the aperture ratio φ.
    pub const APERTURE_RATIO: usize = 3;
    /// Index of the variance of the point spread along an axis.
    pub const POINT_SPREAD: usize = 4;
    /// Index of the first combination of the aberrations.
    pub const ABERRATIONS: usize = 5;
    /// Number of combinations of the aberrations.
    pub const ABERRATION_COUNT: usize = super::TAKEN - ABERRATIONS;
}

/// Observations of a calibration.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Observations {
    /// Micro-image centres.
    pub centers: Vec<MicroImageCenter>,
    /// BAP features of all frames.
    pub features: Vec<BapFeature>,
    /// Optical axis as aberrations in images of boards show it, px: the start of the principal point.
    pub axis_px: Option<Vector2<f64>>,
    /// Frames whose corners are numbered up to a shift by whole squares and a quarter turn, since the board fills the view. Poses
    /// and the shape of the board depend on these; the camera does not.
    pub shifted_frames: BTreeSet<u32>,
}

/// Smallest number of board corners that determines a pose.
pub const MIN_CORNERS: usize = 4;

impl Observations {
    /// Removes the standard deviations of all observations.
    pub(crate) fn forget_std_devs(&mut self) {
        for feature in &mut self.features {
            (feature.std_dev_px, feature.rho_std_dev_px) = (None, None);
            feature.correlation = 0.0;
        }
        for center in &mut self.centers {
            center.std_dev_px = None;
        }
    }

    /// Returns the numbers of the frames, ascending.
    #[must_use]
    pub fn frames(&self) -> Vec<u32> {
        self.features.iter().map(|f| f.frame).collect::<BTreeSet<_>>().into_iter().collect()
    }

    /// Checks all observations; an error names the first impossible one: not finite, outside the array, the board or the image,
    /// or given twice; or a frame with too few corners.
    pub fn validate(
        &self,
        sensor: &Sensor,
        array: (i32, i32),
        board: &Board,
        needs_rho: bool,
    ) -> Result<()> {
        check_centers(&self.centers, sensor, array)?;
        let mut seen = HashSet::new();
        let mut corners: BTreeMap<u32, BTreeSet<i32>> = BTreeMap::new();
        for f in &self.features {
            let key = (f.frame, f.corner, f.k, f.l);
            let is_new = seen.insert(key);
            check_feature(f, sensor, array, board, needs_rho)
                .and_then(|()| once(is_new, || feature_text(f)))
                .map_err(|error| of_observation(f.observed(), error))?;
            corners.entry(f.frame).or_default().insert(f.corner);
        }
        match corners.into_iter().find(|(_, corners)| corners.len() < MIN_CORNERS) {
            Some((frame, corners)) => {
                let (corners, needed) = (corners.len(), MIN_CORNERS);
                Err(Error::TooFewCorners { frame, corners, needed })
            }
            None => Ok(()),
        }
    }
}

impl BapFeature {
    /// Returns the subject of the observation.
    fn observed(&self) -> Observed {
        let Self { frame, corner, k, l, .. } = *self;
        Observed::Feature { frame, corner, k, l }
    }
}

fn feature_text(f: &BapFeature) -> String {
    format!("corner {} in micro-image ({}, {}) of frame {}", f.corner, f.k, f.l, f.frame)
}

/// Returns an error unless a feature is possible by itself.
fn check_feature(
    f: &BapFeature,
    sensor: &Sensor,
    array: (i32, i32),
    board: &Board,
    needs_rho: bool,
) -> Result<()> {
    let what = feature_text(f);
    check_position(&what, (f.k, f.l), (f.u_px, f.v_px), array, sensor)?;
    check_rho(f.rho_px, needs_rho, &what, sensor)?;
    let of_blur = f.blur.as_ref().map(|blur| &blur.std_dev_px);
    let std_devs = f.std_dev_px.iter().flatten().chain(&f.rho_std_dev_px);
    check_std_devs(std_devs.chain(of_blur), &what)?;
    if !(0..board.corners()).contains(&f.corner) {
        return Err(Error::invalid(format!(
            "{what} is not on the board of {} x {} inner corners: corners are numbered from 0 to \
             {}, as row · columns + column",
            board.columns,
            board.rows,
            board.corners() - 1
        )));
    }
    Ok(())
}

/// Returns an error unless an observation is the first of its kind.
fn once(is_new: bool, what: impl Fn() -> String) -> Result<()> {
    if is_new { Ok(()) } else { Err(Error::invalid(format!("{} is given twice", what()))) }
}

/// Adds the observation to an error. The error of a missing blur radius stays, since it has its own remedy.
fn of_observation(observation: Observed, error: Error) -> Error {
    match error {
        Error::Invalid(message) => Error::Observation { observation, message },
        other => other,
    }
}

/// Checks micro-image centres; an error names the first one that is impossible or given twice.
pub(crate) fn check_centers(
    centers: &[MicroImageCenter],
    sensor: &Sensor,
    array: (i32, i32),
) -> Result<()> {
    let mut seen = HashSet::new();
    for c in centers {
        let what = || format!("the centre of micro-image ({}, {})", c.k, c.l);
        let is_new = seen.insert((c.k, c.l));
        check_position(&what(), (c.k, c.l), (c.u_px, c.v_px), array, sensor)
            .and_then(|()| check_std_devs(&c.std_dev_px, &what()))
            .and_then(|()| once(is_new, what))
            .map_err(|error| of_observation(Observed::Center { k: c.k, l: c.l }, error))?;
    }
    Ok(())
}

/// Largest distance of an observation beyond the centres of the outermost pixels, px: half a pixel, and one for interpolation.
const BEYOND_PX: f64 = 1.5;

/// Returns an error unless an observation lies in the array and in the image.
fn check_position(
    what: &str,
    (k, l): (i32, i32),
    (u, v): (f64, f64),
    (columns, rows): (i32, i32),
    sensor: &Sensor,
) -> Result<()> {
    if !(u.is_finite() && v.is_finite()) {
        return Err(Error::invalid(format!(
            "{what} is at ({u}, {v}), but has to have a finite position"
        )));
    }
    if !(0..columns).contains(&k) || !(0..rows).contains(&l) {
        return Err(Error::invalid(format!(
            "{what} is outside the array of {columns} x {rows} micro-lenses: the size of the array \
             and the observations do not belong together"
        )));
    }
    let inside = |x: f64, size: u32| (-BEYOND_PX..=f64::from(size) - 1.0 + BEYOND_PX).contains(&x);
    if !inside(u, sensor.width_px) || !inside(v, sensor.height_px) {
        return Err(Error::invalid(format!(
            "{what} is at ({u}, {v}), outside the image of {} x {} px",
            sensor.width_px, sensor.height_px
        )));
    }
    Ok(())
}

/// Returns an error unless a blur radius is possible, and was measured if it is needed. Residuals state it in any case.
fn check_rho(rho_px: Option<f64>, is_needed: bool, what: &str, sensor: &Sensor) -> Result<()> {
    let Some(rho_px) = rho_px.filter(|rho| !rho.is_nan()) else {
        let error = Error::NoBlurRadius { feature: what.to_owned() };
        return if is_needed { Err(error) } else { Ok(()) };
    };
    if rho_px.abs() > f64::from(sensor.width_px) {
        return Err(Error::invalid(format!(
            "{what} has the blur radius {rho_px} px, wider than the image"
        )));
    }
    Ok(())
}

/// Returns an error unless standard deviations can divide residuals.
fn check_std_devs<'a>(values: impl IntoIterator<Item = &'a f64>, what: &str) -> Result<()> {
    match values.into_iter().find(|value| !(value.is_finite() && **value > 0.0)) {
        Some(value) => Err(Error::invalid(format!(
            "{what} has the standard deviation {value} px, but it has to be positive and finite"
        ))),
        None => Ok(()),
    }
}
