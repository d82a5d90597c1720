//! Scalar relations of thin lenses, each with its equation of the paper.

use nalgebra::{Rotation3, Vector2, Vector3};

use crate::model::{Configuration, InternalParameters, PlenopticCamera};

/// Returns H, the image distance of a thin lens of focal length F whose object and image are h apart (paper, section 5.1): H =
/// |h/2 (1 − √(1 − 4F/h))|; F for h = ∞. All in mm.
///
/// The paper prints ± for the two configurations. With h > 0 the minus sign is the thin-lens equation itself and holds for
/// both; it gives the initial values of Table 1.
#[must_use]
pub fn focus_image_distance(focal_length: f64, focus_distance: f64) -> f64 {
    if focus_distance.is_infinite() {
        return focal_length;
    }
    // The smaller root of x² − h x + h F = 0, in a form without cancellation for large h.
    2.0 * focal_length / (1.0 + (1.0 - 4.0 * focal_length / focus_distance).sqrt())
}

/// Returns the initial D and d (paper, section 5.1), mm.
///
/// The main lens is focused at 2d behind the array (Galilean) or in front of it (Keplerian), D = H ∓ 2d, or on it (unfocused).
/// The slope of the micro-image radii gives m = dF/2D, Eq. (miradiusfnumbermc). Together they give d = 2mH/(F ± 4m); the paper
/// prints the Galilean case.
///
/// With the exit pupil at e_z, `exit_pupil`, m = d (F + e_z)/2(D + e_z) and d = 2m (H + e_z)/(F + e_z ± 4m).
#[must_use]
pub fn initial_distances(
    focal_length: f64,
    focus_distance: f64,
    m: f64,
    configuration: Configuration,
    exit_pupil: f64,
) -> (f64, f64) {
    let image_distance = focus_image_distance(focal_length, focus_distance);
    let side = match configuration {
        Configuration::Galilean => 2.0,
        Configuration::Keplerian => -2.0,
        Configuration::Unfocused => 0.0,
    };
    let mla_to_sensor =
        2.0 * m * (image_distance + exit_pupil) / (focal_length + exit_pupil + 2.0 * side * m);
    (image_distance - side * mla_to_sensor, mla_to_sensor)
}

/// Returns ΔC from Δc, Eq. (mlinterdist): ΔC = Δc · D/(D + d), where the distance D + e_z from exit pupil to array replaces D.
#[must_use]
pub fn micro_lens_pitch(micro_image_pitch: f64, pupil_to_mla: f64, mla_to_sensor: f64) -> f64 {
    micro_image_pitch * pupil_to_mla / (pupil_to_mla + mla_to_sensor)
}

/// Returns fᵢ = d ΔC/(2 q'ᵢ) (paper, section 5.1).
#[must_use]
pub fn micro_lens_focal_length(q_prime: f64, micro_lens_pitch: f64, mla_to_sensor: f64) -> f64 {
    mla_to_sensor * micro_lens_pitch / (2.0 * q_prime)
}

/// Returns the f-number of a stop as engraved (4, 5.6, 8, 11 …): N = √(2^AV) with the aperture value AV rounded to thirds
/// (paper, section 3.2).
#[must_use]
pub fn f_number_of_stop(stop: f64) -> f64 {
    let thirds = (2.0 * stop.log2() * 3.0).round();
    (thirds / 3.0 / 2.0).exp2()
}

/// Returns the tilt gradient ∇ ln d of the array of a known camera along u and v, 1/mm of the sensor: see [`TiltGradient`].
///
/// [`TiltGradient`]: crate::model::TiltGradient
#[must_use]
pub fn tilt_gradient_per_mm(camera: &PlenopticCamera) -> Vector2<f64> {
    let angles = camera.mla.rotation_rad;
    let normal = Rotation3::from_euler_angles(angles.x, angles.y, angles.z) * Vector3::z();
    // Micro-images lie further apart than their micro-lenses.
    let to_pupil = camera.pupil_to_mla_mm();
    let scale = to_pupil / (to_pupil + camera.mla.mla_to_sensor_mm);
    normal.xy() * (scale / (normal.z * camera.mla.mla_to_sensor_mm))
}

/// Returns Ω of a known camera: |m| = dpF/2(D + e_z), which is dF/2D with the pupil in the lens, and q'ᵢ = d ΔC/(2 fᵢ),
/// Eq. (miradiusfnumbermc), with Δc of Eq. (mlinterdist).
#[must_use]
pub fn internal_parameters(camera: &PlenopticCamera) -> InternalParameters {
    let (lens, mla) = (&camera.main_lens, &camera.mla);
    let exit_pupil_over_n = lens.pupil_magnification() * lens.focal_length_mm;
    let pitch_mm = mla.pitch_mm * mla.pitch_ratio.sqrt();
    let q_prime = |f: &f64| mla.mla_to_sensor_mm * pitch_mm / (2.0 * f);
    InternalParameters {
        m_mm: mla.mla_to_sensor_mm * exit_pupil_over_n / (2.0 * camera.pupil_to_mla_mm()),
        q_prime_mm: mla.focal_lengths_mm.iter().map(q_prime).collect(),
        micro_image_pitch_mm: Some(camera.micro_image_pitch_px() * camera.sensor.pixel_size_mm),
        m_std_dev_mm: None,
        q_prime_std_dev_mm: Vec::new(),
        pupil_growth: 0.0,
        fall_off: None,
        tilt_gradient: None,
        vignetting: None,
        point_spread_px2: camera.edge_spread.point_spread_px2,
        aperture_ratio: camera.edge_spread.aperture_ratio,
        opening: camera.edge_spread.opening,
        levels: None,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Rounding error of a few operations.
    const EXACT: f64 = 1e-12;

    #[test]
    fn image_distance_obeys_the_thin_lens_equation() {
        for h in [201.0, 450.0, 1000.0, 1e9] {
            let image = focus_image_distance(50.0, h);
            assert!((1.0 / image + 1.0 / (h - image) - 1.0 / 50.0).abs() < EXACT);
        }
        assert!((focus_image_distance(50.0, f64::INFINITY) - 50.0).abs() < EXACT);
    }

    #[test]
    fn initial_distances_obey_focus_and_slope() {
        let (f, focus_distance, m) = (50.0, 450.0, 0.14);
        let h = focus_image_distance(f, focus_distance);
        for (configuration, side) in [
            (Configuration::Galilean, 2.0),
            (Configuration::Keplerian, -2.0),
            (Configuration::Unfocused, 0.0),
        ] {
            for exit_pupil in [0.0, 7.0, -12.0] {
                let (lens_to_mla, mla_to_sensor) =
                    initial_distances(f, focus_distance, m, configuration, exit_pupil);
                assert!((lens_to_mla + side * mla_to_sensor - h).abs() < EXACT);
                let slope = mla_to_sensor * (f + exit_pupil) / (2.0 * (lens_to_mla + exit_pupil));
                assert!((slope - m).abs() < EXACT);
            }
        }
    }

    #[test]
    fn engraved_stops_are_rounded_powers() {
        for (stop, av) in [(1.4, 1.0), (2.8, 3.0), (4.0, 4.0), (5.6, 5.0), (11.0, 7.0), (22.0, 9.0)]
        {
            let expected = 2.0_f64.powf(av).sqrt();
            assert!((f_number_of_stop(stop) - expected).abs() < EXACT, "{stop}");
        }
        // A third of a stop below f/5.6.
        assert!((f_number_of_stop(6.3) - 2.0_f64.powf(16.0 / 3.0).sqrt()).abs() < EXACT);
    }

    /// Eq. (radiusfinal) at the slope 1 with the pitch of the same micro-lenses: d ΔC/2 (1/f − 1/d − 1/(D + e_z)).
    #[test]
    fn pupils_are_blurred_as_by_the_lens_equation_also_with_two_pitches() {
        let mut camera = crate::model::camera::small_camera();
        camera.mla.pitch_ratio = 1.01;
        let internal = internal_parameters(&camera);
        let (mla, half) = (&camera.mla, internal.micro_image_pitch_mm.unwrap() / 2.0);
        let radius = mla.pitch_mm * 1.01_f64.sqrt() / 2.0;
        for (q_prime, f) in internal.q_prime_mm.iter().zip(&mla.focal_lengths_mm) {
            let vergence = 1.0 / f - 1.0 / mla.mla_to_sensor_mm - 1.0 / camera.pupil_to_mla_mm();
            let expected = radius * mla.mla_to_sensor_mm * vergence;
            assert!((q_prime - half - expected).abs() < EXACT, "{q_prime} {half} {expected}");
        }
    }

    /// Table 1, column R12-A "Initial", to all printed digits.
    #[test]
    fn r12_a_starts_from_the_published_values() {
        let (lens_to_mla, mla_to_sensor) =
            initial_distances(50.0, 450.0, 0.140_595_540_400_431_76, Configuration::Galilean, 0.0);
        let pitch = micro_lens_pitch(0.128_221_631_892_887_07, lens_to_mla, mla_to_sensor);
        assert_eq!(format!("{lens_to_mla:.4}"), "56.6576");
        assert_eq!(format!("{:.3}", mla_to_sensor * 1e3), "318.632");
        assert_eq!(format!("{:.3}", pitch * 1e3), "127.505");
        let q = [0.035_135_191_355_331_4, 0.040_268_205_527_647, 0.036_822_146_226_151_445];
        let f = q.map(|q| format!("{:.3}", 1e3 * micro_lens_focal_length(q, pitch, mla_to_sensor)));
        assert_eq!(f, ["578.154", "504.456", "551.667"]);
    }
}
