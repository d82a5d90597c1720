//! Priors: knowledge of a camera before any board is seen, as residuals in the cost.
//!
//! Every prior has a value, a σ, and one residual (quantity − value)/σ. Observations of a frame share errors, so their
//! residuals claim more knowledge than they contain. The weight w of the priors compensates for this: it is the factor
//! by which the variance that observations leave to quantities with a prior exceeds the claimed variance
//! ([`Uncertainty::dispersion`](crate::solver::Uncertainty)). This is the magnitude adjustment of a composite
//! likelihood (Pauli, Racugno, Ventura 2011), on the other side of the balance.

use std::fmt;

use crate::calibration::options::LENS_TILT;
use crate::calibration::{CalibrationOptions, Mode, Start};
use crate::checks::calibration as checks;
use crate::error::{Error, Result};
use crate::finding::Finding;
use crate::model::{BoardShape, MAX_LENS_TYPES, Parameter, PlenopticCamera, optics};
use crate::quantity::{Estimate, display_unit};
use crate::solver::{Prior, Problem};

/// Name of |m| among the quantities of priors.
pub const SLOPE: &str = "m";
/// Names of the tilt gradient of the array along u and v among the quantities of priors.
pub const TILT_GRADIENT: [&str; 2] = ["tilt_u", "tilt_v"];
/// Relative σ of an engraved focal length, which is rounded: a "50 mm" lens often has 51.6 mm.
const ENGRAVED: f64 = 0.03;
/// Relative σ of q'ᵢ if none is stated.
pub(super) const INTERCEPTS: f64 = 0.005;
/// σ of the angle between lens and sensor, rad: a mount or a sensor board that is 0.15 mm higher on one side of 30 mm.
const MOUNT_TILT_RAD: f64 = 5e-3;
/// Relative σ of f-numbers, and therefore of m.
const F_NUMBERS: f64 = 0.02;

/// Source of the value of a prior.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum PriorSource {
    /// Focal length in the datasheet.
    Datasheet,
    /// m and q'ᵢ of the white images.
    WhiteImages,
    /// Camera from which the calibration starts.
    Start,
    /// Middle of the sensor.
    SensorMiddle,
    /// Mount of the lens, parallel to the sensor.
    Mount,
    /// Flatness of boards as they are made.
    FlatBoard,
    /// Statement of the user.
    Stated,
}

/// Prior, and its value in the refined camera.
#[derive(Debug, Clone, PartialEq)]
pub struct PriorResult {
    /// The prior.
    pub prior: Prior,
    /// Source of its value.
    pub source: PriorSource,
    /// Value in the refined camera, in the unit of the quantity.
    pub result: f64,
}

impl PriorResult {
    /// Returns the residual of the prior over its σ: (result − value)/σ.
    #[must_use]
    pub fn normalised_residual(&self) -> f64 {
        (self.result - self.prior.value) / self.prior.std_dev
    }

    /// Returns the unit of the quantity.
    #[must_use]
    pub fn unit(&self) -> &'static str {
        unit(&self.prior.quantity)
    }
}

impl fmt::Display for PriorSource {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Datasheet => "datasheet",
            Self::WhiteImages => "white images",
            Self::Start => "starting camera",
            Self::SensorMiddle => "middle of the sensor",
            Self::Mount => "mount",
            Self::FlatBoard => "flat board",
            Self::Stated => "stated",
        })
    }
}

/// Returns the name of q'ᵢ among the quantities of priors. The first lens type has the index 0 and the name `q'_1`.
#[must_use]
pub fn intercept_name(lens_type: usize) -> String {
    format!("q'_{}", lens_type + 1)
}

fn unit(quantity: &str) -> &'static str {
    if TILT_GRADIENT.contains(&quantity) {
        return "mm^-1";
    }
    quantity.parse().map_or("mm", Parameter::unit)
}

/// Returns the priors of a calibration: the stated ones, and the default ones that are wanted, that no other replaces,
/// and whose quantity is free.
pub(super) fn priors(start: &Start, options: &CalibrationOptions) -> Vec<(Prior, PriorSource)> {
    if options.mode == Mode::PosesOnly {
        return Vec::new();
    }
    let stated = options.priors.stated().into_iter().map(|a| (a, PriorSource::Stated));
    let fixed = options.fixed();
    let wanted = |prior: &Prior| {
        let stated = options.priors.quantities.contains_key(&prior.quantity);
        !stated && is_free(&prior.quantity, &fixed)
    };
    let mut defaults = if options.priors.default { default_priors(start) } else { Vec::new() };
    if !options.has_rho() {
        defaults.extend(of_white_images(start));
    }
    stated.chain(defaults.into_iter().filter(|(prior, _)| wanted(prior))).collect()
}

/// Returns the priors that white images measure: q'ᵢ, or the q'ᵢ of the starting camera, and the tilt gradient of the
/// array. They are observations that all features share: without ρ and without q'ᵢ nothing determines fᵢ.
fn of_white_images(start: &Start) -> Vec<(Prior, PriorSource)> {
    let (internal, source) = match start {
        Start::Datasheet(_, internal) => (internal.clone(), PriorSource::WhiteImages),
        Start::Camera(camera) => (optics::internal_parameters(camera), PriorSource::Start),
    };
    let intercept = |lens_type: usize| {
        let value = internal.q_prime_mm[lens_type];
        let std_dev = internal.q_prime_std_dev_mm.get(lens_type).copied();
        let std_dev = std_dev.unwrap_or(INTERCEPTS * value);
        Prior { quantity: intercept_name(lens_type), value, std_dev }
    };
    let mut priors: Vec<Prior> = (0..start.lens_types()).map(intercept).collect();
    if let Some(tilt_gradient) = &internal.tilt_gradient {
        let pixel_size_mm = start.sensor().pixel_size_mm;
        priors.extend(TILT_GRADIENT.iter().enumerate().map(|(axis, quantity)| Prior {
            quantity: (*quantity).to_owned(),
            value: tilt_gradient.growth_per_px[axis] / pixel_size_mm,
            std_dev: tilt_gradient.std_dev_per_px[axis] / pixel_size_mm,
        }));
    }
    priors.into_iter().map(|prior| (prior, source)).collect()
}

fn default_priors(start: &Start) -> Vec<(Prior, PriorSource)> {
    let prior = |quantity: &str, value: f64, std_dev: f64| Prior {
        quantity: quantity.to_owned(),
        value,
        std_dev,
    };
    let sensor = start.sensor();
    let (middle, mount) = (sensor.center_px(), sensor.mount_px());
    let mut priors = Vec::new();
    if let Start::Datasheet(sheet, internal) = start {
        let (f, m) = (sheet.focal_length_mm, internal.m_mm);
        let of_m = internal.m_std_dev_mm.unwrap_or(0.0).hypot(F_NUMBERS * m);
        priors.push((prior("F", f, ENGRAVED * f), PriorSource::Datasheet));
        priors.push((prior(SLOPE, m, of_m), PriorSource::WhiteImages));
    }
    priors.push((prior("u0", middle.x, mount), PriorSource::SensorMiddle));
    priors.push((prior("v0", middle.y, mount), PriorSource::SensorMiddle));
    for parameter in LENS_TILT {
        priors.push((prior(parameter.name(), 0.0, MOUNT_TILT_RAD), PriorSource::Mount));
    }
    priors
}

/// Returns true if a quantity depends on a parameter that is not fixed.
fn is_free(quantity: &str, fixed: &[Parameter]) -> bool {
    use Parameter as P;
    let any_is_free = |parameters: &[P]| parameters.iter().any(|p| !fixed.contains(p));
    if quantity == SLOPE {
        return any_is_free(&[P::FocalLength, P::ArrayToSensor, P::LensToArray, P::PupilZ]);
    }
    if TILT_GRADIENT.contains(&quantity) {
        return any_is_free(&[P::RotationX, P::RotationY, P::ArrayToSensor]);
    }
    if let Some(lens_type) = (0..MAX_LENS_TYPES).find(|&i| intercept_name(i) == quantity) {
        return any_is_free(&[P::ArrayToSensor, P::Pitch, P::focal_length_of(lens_type)]);
    }
    quantity.parse().is_ok_and(|parameter: P| any_is_free(&[parameter]))
}

/// Returns an error that names an impossible prior.
pub(super) fn check_priors(options: &CalibrationOptions, lens_types: usize) -> Result<()> {
    let known = Parameter::shared(lens_types);
    let names = || -> Vec<String> {
        let parameters = known.iter().map(|p| p.name().to_owned());
        let of_white_images = [SLOPE].into_iter().chain(TILT_GRADIENT).map(str::to_owned);
        parameters.chain(of_white_images).chain((0..lens_types).map(intercept_name)).collect()
    };
    let unknown = |quantity: &str| {
        Error::invalid(format!(
            "the quantity '{quantity}' of a prior does not exist; this camera has {}",
            names().join(", ")
        ))
    };
    let stated = options.priors.stated();
    if options.mode == Mode::PosesOnly && !stated.is_empty() {
        return Err(Error::invalid(
            "priors on the camera have no effect if only poses are estimated: leave them out",
        ));
    }
    let mut quantities = options.priors.quantities.keys();
    if let Some(quantity) = quantities.find(|q| !names().contains(q)) {
        return Err(unknown(quantity));
    }
    let fixed = options.fixed();
    for Prior { quantity, value, std_dev } in &stated {
        if !value.is_finite() {
            return Err(Error::invalid(format!(
                "the prior on {quantity} has the value {value}, but has to be finite"
            )));
        }
        if !(std_dev.is_finite() && *std_dev > 0.0) {
            return Err(Error::invalid(format!(
                "the prior on {quantity} has σ = {std_dev}, but σ has to be positive; fix the \
                 parameter to hold it at a value"
            )));
        }
        if !is_free(quantity, &fixed) || options.keeps(quantity) {
            return Err(Error::invalid(format!(
                "{quantity} has a prior, but is fixed: remove the prior or free the parameter"
            )));
        }
    }
    Ok(())
}

/// Returns a finding for each prior that the observations contradict.
pub(super) fn contradicted(results: &[PriorResult]) -> impl Iterator<Item = Finding> {
    results.iter().filter_map(|r| {
        let Prior { quantity, value, std_dev } = &r.prior;
        let prior = Estimate { value: *value, std_dev: *std_dev };
        checks::prior((quantity, r.unit()), prior, r.result, &r.source.to_string())
    })
}

/// Relative distance from the start beyond which a stated prior may be a mistake.
const FAR_PART: f64 = 0.5;

/// Adds to an error of a refinement the stated prior that is furthest from its start, if one is far.
pub(super) fn with_far_prior(
    error: Error,
    priors: &[(Prior, PriorSource)],
    start: &Problem,
) -> Error {
    let stated = priors.iter().filter(|(_, source)| *source == PriorSource::Stated);
    let at_start = results(stated.cloned().collect(), start.camera, &start.board.shape);
    let is_far = |of: &&PriorResult| {
        (of.prior.value - of.result).abs() > FAR_PART * of.result.abs().max(of.prior.std_dev)
    };
    let farthest = at_start
        .iter()
        .filter(is_far)
        .max_by(|a, b| a.normalised_residual().abs().total_cmp(&b.normalised_residual().abs()));
    let Some(of) = farthest else { return error };
    let (unit, factor) = display_unit(&of.prior.quantity, of.unit());
    let prior = Estimate { value: of.prior.value, std_dev: of.prior.std_dev }.scaled(factor);
    let (at_start, _) = Estimate::new(of.result * factor, prior.std_dev).text();
    Error::invalid(format!(
        "the prior {} = {prior} {unit} is far from the start, {at_start} {unit}, and the \
         calibration fails with it: check its value and its unit, or remove it ({error})",
        of.prior.quantity
    ))
}

/// Evaluates the priors in the refined camera and board.
pub(super) fn results(
    priors: Vec<(Prior, PriorSource)>,
    camera: &PlenopticCamera,
    shape: &BoardShape,
) -> Vec<PriorResult> {
    let value = |quantity: &str| {
        if quantity == SLOPE {
            return optics::internal_parameters(camera).m_mm;
        }
        if let Some(lens_type) = (0..camera.lens_types()).find(|&i| intercept_name(i) == quantity) {
            return optics::internal_parameters(camera).q_prime_mm[lens_type];
        }
        if let Some(axis) = TILT_GRADIENT.iter().position(|name| *name == quantity) {
            return optics::tilt_gradient_per_mm(camera)[axis];
        }
        match quantity.parse::<Parameter>() {
            Ok(parameter) if parameter.is_of_board() => shape.value(parameter),
            Ok(parameter) => camera.value(parameter),
            Err(_) => f64::NAN,
        }
    };
    let result = |(prior, source): (Prior, PriorSource)| PriorResult {
        result: value(&prior.quantity),
        prior,
        source,
    };
    priors.into_iter().map(result).collect()
}
