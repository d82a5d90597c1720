//! Systematic errors of observations, due to quantities that all of them share.
//!
//! The position of a corner depends a little on the pupil of the main lens, on q'ᵢ, on the angular response inside a
//! micro-image, on the aperture ratio, on the point spread, on the aberrations of the main lens, and on the tilt of the
//! array. All features share the errors of these, and no scatter shows them. All centres share the error of the shift of
//! centroids by the angular response.

use nalgebra::Vector2;

use crate::calibration::priors::{TILT_GRADIENT, intercept_name};
use crate::calibration::{CalibrationOptions, Mode, Start};
use crate::error::Result;
use crate::model::{
    BapFeature, InternalParameters, MicroImageCenter, PlenopticCamera, TAKEN, TiltGradient, taken,
};
use crate::solver::{self, CostOptions, Prior, SystematicError};

/// Relative model error of the distance of a corner from the centre of its micro-image. In simulated images corners are
/// 0.1 % too far outwards with ideal lenses, and 0.3 % with traced ones (docs/accuracy.md).
const BLUR_MODEL: f64 = 2e-3;

/// Name of the error of the aperture ratio.
pub const APERTURE_RATIO: &str = "aperture ratio";
/// Names of the errors of the models of corners and of centroids, and of the aberrations of the main lens.
pub const MODEL_ERRORS: [&str; 2 + taken::ABERRATION_COUNT] = [
    BLUR,
    CENTROIDS,
    ABERRATIONS[0],
    ABERRATIONS[1],
    ABERRATIONS[2],
    ABERRATIONS[3],
    ABERRATIONS[4],
];
const BLUR: &str = "blur";
const CENTROIDS: &str = "centroids";

/// Names of the errors of the aberrations of the main lens: independent combinations of all of them.
const ABERRATIONS: [&str; taken::ABERRATION_COUNT] =
    ["aberration 1", "aberration 2", "aberration 3", "aberration 4", "aberration 5"];

/// Model error of the shift of centroids, over the gradient of the angular response, px²: the accuracy on simulated
/// cameras with any law.
const CENTROID_MODEL_PX2: f64 = 0.07;

/// Computes the systematic errors of features, and of the priors that share them.
pub(super) fn systematic_errors(
    start: &Start,
    camera: &PlenopticCamera,
    (features, centers): (&[BapFeature], &[MicroImageCenter]),
    cost: &CostOptions,
    options: &CalibrationOptions,
) -> Result<Vec<SystematicError>> {
    let Some(internal) = start.internal().filter(|_| options.mode != Mode::PosesOnly) else {
        return Ok(Vec::new());
    };
    let at_prior_on = |quantity: &str| {
        cost.priors.iter().map(|a| if a.quantity == quantity { 1.0 } else { 0.0 }).collect()
    };
    let types: Vec<usize> = features.iter().map(|f| camera.lens_type(f.k, f.l)).collect();
    let pixel_mm = camera.sensor.pixel_size_mm;
    let sensitivities = |f: &BapFeature| f.sensitivities_px.unwrap_or([[0.0; 2]; TAKEN]);
    let mut errors = Vec::new();
    let mut add = |source: &str, priors: Vec<f64>, by: &dyn Fn(usize, &BapFeature) -> [f64; 3]| {
        let features_px: Vec<f64> =
            features.iter().enumerate().flat_map(|(i, f)| by(i, f)).collect();
        // An error of one prior alone is already in its σ.
        let of_several = priors.iter().filter(|by| **by != 0.0).count() > 1;
        if of_several || features_px.iter().any(|by| *by != 0.0) {
            let (source, centers_px) = (source.to_owned(), Vec::new());
            // White images do not determine the aperture ratio, so the σ of their priors do not contain its error.
            let in_priors = source != APERTURE_RATIO;
            errors.push(SystematicError { source, features_px, centers_px, priors, in_priors });
        }
    };
    let [pupil, within, ratio, spread_px2] = std_devs(internal);
    for (name, taken, std_dev) in [
        ("pupil", taken::PUPIL, pupil),
        ("fall-off", taken::FALL_OFF, within),
        ("point spread", taken::POINT_SPREAD, spread_px2),
    ] {
        add(name, Vec::new(), &|_, f| {
            let [u, v] = sensitivities(f)[taken];
            [u * std_dev, v * std_dev, 0.0]
        });
    }
    for (i, name) in ABERRATIONS.into_iter().enumerate() {
        add(name, Vec::new(), &|_, f| {
            let [u, v] = sensitivities(f)[taken::ABERRATIONS + i];
            [u, v, 0.0]
        });
    }
    for (lens_type, std_dev_mm) in internal.q_prime_std_dev_mm.iter().enumerate() {
        let name = intercept_name(lens_type);
        let relative = std_dev_mm / internal.q_prime_mm[lens_type];
        // ρ = q'ᵢ − γΔc/2.
        let rho = if cost.rho { std_dev_mm / pixel_mm } else { 0.0 };
        add(&name, at_prior_on(&name), &|i, f| {
            let [u, v] = sensitivities(f)[taken::INTERCEPT];
            if types[i] == lens_type { [u * relative, v * relative, rho] } else { [0.0; 3] }
        });
    }
    let (q_mm, of_priors) = by_aperture_ratio(internal, &cost.priors, pixel_mm);
    add(APERTURE_RATIO, of_priors.iter().map(|by| by * ratio).collect(), &|i, f| {
        let [u, v] = sensitivities(f)[taken::APERTURE_RATIO];
        let rho = if cost.rho { -q_mm[types[i]] / pixel_mm } else { 0.0 };
        [u * ratio, v * ratio, rho * ratio]
    });
    let own_centers = solver::project_centers(camera, features.iter().map(|f| (f.k, f.l)))?;
    if let Some(tilt_gradient) = &internal.tilt_gradient {
        let middle = camera.sensor.center_px();
        for (name, per_px) in of_tilt_gradient(tilt_gradient) {
            let in_std_devs = [0, 1].map(|axis| per_px[axis] / tilt_gradient.std_dev_per_px[axis]);
            let axis = |a: &Prior| TILT_GRADIENT.iter().position(|name| a.quantity == *name);
            let of_prior = |a: &Prior| axis(a).map_or(0.0, |axis| in_std_devs[axis]);
            // Both discs grow with d.
            add(name, cost.priors.iter().map(of_prior).collect(), &|i, f| {
                let growth = (Vector2::from(own_centers[i]) - middle).dot(&Vector2::from(per_px));
                let [pupil, intercept, ..] = sensitivities(f);
                [0, 1, 2].map(|c| if c < 2 { (pupil[c] + intercept[c]) * growth } else { 0.0 })
            });
        }
    }
    add(BLUR, Vec::new(), &|i, f| of_blur_model(f, own_centers[i]));
    errors.extend(of_centroids(internal, features.len(), centers));
    Ok(errors)
}

/// Returns the model error of a corner, in proportion to its distance from the centre of its micro-image, px.
fn of_blur_model(feature: &BapFeature, own_center: [f64; 2]) -> [f64; 3] {
    let [u, v] = [feature.u_px - own_center[0], feature.v_px - own_center[1]];
    feature.sensitivities_px.map_or([0.0; 3], |_| [u * BLUR_MODEL, v * BLUR_MODEL, 0.0])
}

/// Returns the errors of the tilt gradient along both axes, px⁻¹: the own error of each axis, and the shared one.
fn of_tilt_gradient(tilt_gradient: &TiltGradient) -> [(&'static str, [f64; 2]); 3] {
    let own = |axis: usize| {
        let variance =
            tilt_gradient.std_dev_per_px[axis].powi(2) - tilt_gradient.shared_per_px[axis].powi(2);
        variance.max(0.0).sqrt()
    };
    [
        (TILT_GRADIENT[0], [own(0), 0.0]),
        (TILT_GRADIENT[1], [0.0, own(1)]),
        ("tilt gradient", tilt_gradient.shared_per_px),
    ]
}

/// Returns qᵢ by lens type, mm, and the derivative of the value of each prior by ln φ, in its σ. White images show the
/// product of φ and qᵢ = q'ᵢ − Δc/2, so the derivative of q'ᵢ is −qᵢ.
fn by_aperture_ratio(
    internal: &InternalParameters,
    priors: &[Prior],
    pixel_mm: f64,
) -> (Vec<f64>, Vec<f64>) {
    let half_pitch_mm = internal.micro_image_pitch_mm.unwrap_or(0.0) / 2.0;
    let q_mm: Vec<f64> = internal.q_prime_mm.iter().map(|q| q - half_pitch_mm).collect();
    let of_prior = |prior: &Prior| {
        let axis = TILT_GRADIENT.iter().position(|name| prior.quantity == *name);
        if let (Some(axis), Some(tilt_gradient)) = (axis, &internal.tilt_gradient) {
            return tilt_gradient.by_aperture_ratio_per_px[axis] / pixel_mm / prior.std_dev;
        }
        let lens_type = (0..q_mm.len()).find(|i| prior.quantity == intercept_name(*i));
        lens_type.map_or(0.0, |i| -q_mm[i] / prior.std_dev)
    };
    let of_priors = priors.iter().map(of_prior).collect();
    (q_mm, of_priors)
}

/// Returns the error of the shift of centroids by the angular response; `None` without an angular response or centres.
fn of_centroids(
    internal: &InternalParameters,
    features: usize,
    centers: &[MicroImageCenter],
) -> Option<SystematicError> {
    let fall_off = internal.fall_off.filter(|_| !centers.is_empty())?;
    let moved = |c: &MicroImageCenter| -> [f64; 2] {
        (fall_off.gradient(&Vector2::new(c.u_px, c.v_px)) * CENTROID_MODEL_PX2).into()
    };
    Some(SystematicError {
        source: CENTROIDS.to_owned(),
        features_px: vec![0.0; 3 * features],
        centers_px: centers.iter().flat_map(moved).collect(),
        priors: Vec::new(),
        in_priors: true,
    })
}

/// Returns σ of the radius of the pupil, of the angular response inside micro-images and of the aperture ratio,
/// relative, and of the variance of the point spread, px².
fn std_devs(internal: &InternalParameters) -> [f64; 4] {
    let pupil = internal.m_std_dev_mm.map_or(0.0, |std_dev| std_dev / internal.m_mm.abs());
    // Without an angular response there is no sensitivity either.
    let known = internal.fall_off.filter(|fall_off| fall_off.within_per_px2 != 0.0);
    let within = known
        .map_or(0.0, |fall_off| fall_off.within_std_dev_per_px2 / fall_off.within_per_px2.abs());
    let ratio = internal.aperture_ratio.map_or(0.0, |ratio| ratio.std_dev / ratio.value);
    let spread_px2 = internal.point_spread_px2.map_or(0.0, |spread| spread.std_dev);
    [pupil, within, ratio, spread_px2]
}
