//! The simulation: calibration from the traced truth, presets, imperfections.

use plenocal::calibration::{Calibration, Start, calibrate};
use plenocal::image::Image;
use plenocal::model::{BapFeature, FramePose, NoiseSource, Observations, Opening, optics};
use plenocal::simulation::{
    DataSet, FallOffLaw, Imperfections, PRESETS, Scene, SecondStop, Settings, simulate,
};

use crate::support::{options, pairs, preset};

/// A normal variable exceeds this once in 16 000 draws; about a hundred are tested.
const FOUR_SIGMA: f64 = 4.0;
const NOISE_AGREEMENT: f64 = 0.05;
/// Corners with less light are left out.
const HALF_VISIBLE: f64 = 0.5;

fn calibration_poses(settings: &Settings) -> Vec<FramePose> {
    DataSet::plan(settings, None).unwrap().subsets[0].iter().map(|&(pose, _)| pose).collect()
}

/// Calibrates from the traced truth with noise, starting from datasheet and closed-form internal
/// parameters.
fn calibrated(settings: &Settings) -> Calibration {
    let tracer = settings.tracer(settings.board_f_number()).unwrap();
    let mut source = NoiseSource::new(&settings.observation_noise, 5).unwrap();
    let features: Vec<BapFeature> = calibration_poses(settings)
        .iter()
        .flat_map(|pose| tracer.features(pose.frame, &settings.target, &pose.camera_from_board))
        .filter(|f| f.visible >= HALF_VISIBLE)
        .map(|f| source.feature(&f.feature))
        .collect();
    // Noise may move centres right at the border out of the image.
    let inside = |u: f64, size: u32| (1.0..f64::from(size) - 2.0).contains(&u);
    let sensor = &settings.camera.sensor;
    let centers = tracer
        .centers()
        .into_iter()
        .map(|c| source.center(&c.center))
        .filter(|c| inside(c.u_px, sensor.width_px) && inside(c.v_px, sensor.height_px))
        .collect();
    let observations = Observations { centers, features, ..Observations::default() };
    let start =
        Start::Datasheet(settings.datasheet(), optics::internal_parameters(&settings.camera));
    calibrate(&start, &settings.target.board(), &observations, &options(), &mut |_| true).unwrap()
}

/// The traced observations do not depend on the model that is fitted to them.
fn assert_recovered(name: &str) {
    let settings = preset(name, &[]);
    let calibration = calibrated(&settings);
    assert!(calibration.converged, "{name}");
    assert_eq!(calibration.left_out, [], "{name}");
    let std_devs = calibration.uncertainty.intrinsic_std_devs(3);
    for ((parameter, value, truth), std_dev) in
        pairs(&calibration.camera, &settings.camera).iter().zip(std_devs)
    {
        // The pitch ratio is fixed.
        let Some(s) = std_dev else { continue };
        let off = (value - truth).abs() / s;
        assert!(off < FOUR_SIGMA, "{name}, {parameter}: {value} ± {s} for {truth}");
    }
    for (i, (pose, truth)) in calibration.poses.iter().zip(calibration_poses(&settings)).enumerate()
    {
        let off =
            pose.camera_from_board.translation.vector - truth.camera_from_board.translation.vector;
        let [.., x, y, z] = calibration.uncertainty.pose_std_devs(i);
        for (off, s) in off.iter().zip([x, y, z]) {
            assert!(off.abs() < FOUR_SIGMA * s, "{name}, frame {i}: {off} ± {s} mm");
        }
    }
    let noise = &settings.observation_noise;
    for (measured, truth) in calibration.uncertainty.residual_std_dev_px.into_iter().zip([
        noise.uv_px,
        noise.rho_px,
        noise.centers_px,
    ]) {
        assert!((measured / truth - 1.0).abs() < NOISE_AGREEMENT, "{name}: {measured} px");
    }
}

#[test]
fn the_small_camera_is_recovered() {
    assert_recovered("mini");
}

/// The initial tilt of one board has the wrong sign, which has to be detected.
#[test]
fn the_keplerian_camera_is_recovered() {
    assert_recovered("keplerian");
}

#[test]
fn the_r12_a_is_recovered() {
    assert_recovered("r12-a");
}

#[test]
fn the_r12_b_is_recovered() {
    assert_recovered("r12-b");
}

#[test]
fn the_r12_c_is_recovered() {
    assert_recovered("r12-c");
}

#[test]
fn every_preset_gives_a_data_set_without_imperfections_but_those_of_real_lenses() {
    for preset in PRESETS.iter().filter(|preset| !preset.name.starts_with("real")) {
        let settings = Settings::preset(preset.name, &[]).unwrap();
        DataSet::plan(&settings, None).unwrap();
        let mut imperfections = settings.imperfections;
        if settings.prescription.is_some() {
            assert_eq!(imperfections.fall_off, FallOffLaw::HalfResponseDeg(25.0));
            imperfections.fall_off = FallOffLaw::Cos4;
            let stated = settings.engraved_focal_length_mm;
            let off = stated / settings.camera.main_lens.focal_length_mm - 1.0;
            assert!((off.abs() - 0.02).abs() < 1e-3, "{}: {off}", preset.name);
        }
        assert_eq!(imperfections, Imperfections::default(), "{}", preset.name);
    }
}

/// What is engraved on the lens is off by 2 %, and the board is neither flat nor exact.
#[test]
fn presets_of_real_cameras_have_what_a_careful_shoot_has() {
    for name in ["real-a", "real-b"] {
        let few = ["boards.calibration=1", "boards.evaluation=1", "translation.images=1"];
        let settings = preset(name, &few);
        let data_set = DataSet::plan(&settings, None).unwrap();
        let camera = &settings.camera;
        let sheet = settings.datasheet();
        let off = [
            sheet.focal_length_mm / camera.main_lens.focal_length_mm,
            sheet.f_number / settings.board_f_number(),
        ];
        assert!(off.iter().all(|o| (0.015..0.025).contains(&(o - 1.0).abs())), "{name}: {off:?}");
        for shot in data_set.whites.iter().chain([&data_set.devignetting]) {
            let off = shot.f_number / shot.stated_f_number - 1.0;
            assert!((0.005..0.025).contains(&off.abs()), "{name}: {off}");
        }
        let imperfections = settings.imperfections;
        assert!(imperfections.point_spread_px > 0.3 && imperfections.aperture_ratio < 1.0);
        assert!(imperfections.dead_micro_lenses > 0 && imperfections.dust_specks > 0);
        let (imaging, target) = (&settings.imaging, &settings.target);
        assert!(imaging.black_level > 0.0 && imaging.crosstalk > 0.0 && imaging.hot_pixels > 0);
        let brightest = imaging.exposure + imaging.black_level;
        assert!((brightest..1.0).contains(&imaging.saturation), "{name}: {brightest}");
        let [x, y] = target.sag_mm;
        assert!([x, y, target.twist_mm, target.aspect].iter().all(|shape| shape.abs() > 0.0));
        assert!(settings.prescription.is_some());
    }
}

/// The truth of a simulation with a real lens: F, D and the exit pupil for all light in the camera, and the paraxial figures
/// beside it. Spherical aberration makes F 0.2 % shorter.
#[test]
fn a_real_lens_has_its_own_truth() {
    let few = ["rays=1", "boards.calibration=2", "boards.evaluation=0", "translation.images=0"];
    let settings = preset("mini-double-gauss", &few);
    let simulated = simulate(&settings, None, &(), &mut |_, _, _| Ok(())).unwrap();
    let (camera, figures) = (simulated.truth.camera, simulated.truth.main_lens.unwrap());
    let lens = camera.main_lens;
    assert_eq!((lens.radial, lens.field_curvature_per_mm), ([0.0; 3], 0.0));
    assert!((figures.pupil_magnification - 1.1464).abs() < 1e-4);
    let paraxial = settings.camera.main_lens;
    assert!((figures.focal_length_mm - paraxial.focal_length_mm).abs() < 1e-12);
    assert!((figures.exit_pupil_mm - paraxial.exit_pupil_mm.z).abs() < 1e-9);
    let shorter = 1.0 - lens.focal_length_mm / paraxial.focal_length_mm;
    assert!((0.001..0.003).contains(&shorter), "{shorter}");
    let pupil = lens.exit_pupil_mm.z - paraxial.exit_pupil_mm.z;
    assert!((-0.3..-0.05).contains(&pupil), "{pupil}");
    assert!((figures.all_light.lens_to_mla_mm - camera.mla.lens_to_mla_mm).abs() < 1e-12);
    assert!(figures.field_curvature_per_mm > 0.01, "{figures:?}");
    // Corners are seen up to the border, where their light is still most of it.
    let [calibration, ..] = &simulated.truth.features;
    assert!(calibration.len() > 200 && simulated.truth.centers.len() > 1500);
    assert!(calibration.iter().filter(|f| f.visible > HALF_VISIBLE).count() > 200);
}

#[test]
fn a_preset_with_an_orthogonal_array_gives_a_data_set() {
    let square = preset("lytro-like", &["camera.micro_lens_array.lattice=orthogonal"]);
    DataSet::plan(&square, None).unwrap();
}

#[test]
fn the_r12_a_is_that_of_table_1_of_the_paper() {
    let a = preset("r12-a", &[]).camera;
    assert_eq!((a.sensor.width_px, a.sensor.height_px), (4080, 3068));
    assert_eq!((a.lattice.columns, a.lattice.rows), (176, 152));
    assert_eq!(
        format!("{:.3} {:.3}", a.main_lens.focal_length_mm, a.mla.lens_to_mla_mm),
        "49.720 56.696"
    );
}

/// The small camera with imperfections.
fn imperfect(imperfections: Imperfections) -> Settings {
    Settings { imperfections, ..preset("mini", &["rays=16"]) }
}

/// Its white image at f/4.
fn white(imperfections: Imperfections) -> Image {
    imperfect(imperfections).tracer(4.0).unwrap().render(&Scene::White, 16, 1, &|| ()).unwrap()
}

fn light(image: &Image) -> f64 {
    image.pixels.iter().map(|&p| f64::from(p)).sum()
}

#[test]
fn dead_micro_lenses_give_no_light() {
    let dead = Imperfections { dead_micro_lenses: 159, ..Imperfections::default() };
    let part = light(&white(dead)) / light(&white(Imperfections::default()));
    assert!((part - 0.9).abs() < 0.01, "a tenth of the micro-lenses is dead: {part}");
}

/// Light of a white image, not scaled by the exposure.
fn flux(imperfections: Imperfections) -> f64 {
    let reference = imperfect(imperfections).tracer(4.0).unwrap().reference_irradiance();
    light(&white(imperfections)) * reference
}

/// All light passes the opening of some micro-lens. Where this opening is smaller than the projected
/// pupil, as at f/4, the reference is proportional to its area too.
#[test]
fn the_aperture_ratio_scales_the_light_by_its_square() {
    let stopped = Imperfections { aperture_ratio: 0.8, ..Imperfections::default() };
    let part = flux(stopped) / flux(Imperfections::default());
    assert!((part / 0.64 - 1.0).abs() < 0.02, "0.8² of the light: {part}");
}

/// A hexagon has 2√3/π of the area of its inscribed disc.
#[test]
fn a_hexagonal_opening_has_the_light_of_its_area() {
    // Smaller ones keep micro-images apart.
    let disc = Imperfections { aperture_ratio: 0.8, ..Imperfections::default() };
    let hexagon = Imperfections { opening: Opening::Hexagon, ..disc };
    let part = flux(hexagon) / flux(disc);
    assert!((part / (12.0_f64.sqrt() / std::f64::consts::PI) - 1.0).abs() < 0.01, "{part}");
}

/// Specks with radii from 1.25 to 5 px cover 34 px on average, some of which are dark anyway.
#[test]
fn dust_darkens_what_it_covers() {
    let ideal = white(Imperfections::default());
    let dusty = white(Imperfections { dust_specks: 40, ..Imperfections::default() });
    let dark = dusty.pixels.iter().zip(&ideal.pixels).filter(|(d, i)| **d < 0.5 * **i).count();
    assert!((400..3000).contains(&dark), "{dark} pixels are covered");
    assert!(dusty.pixels.iter().zip(&ideal.pixels).all(|(d, i)| d <= &(i + 1e-6)));
}

/// A rim half way to the array, with three quarters of the diameter of the pupil.
#[test]
fn a_second_stop_darkens_the_border_and_not_the_middle() {
    let rim = SecondStop { z_mm: -9.0, diameter_mm: 3.0 };
    let ideal = white(Imperfections::default());
    let vignetted = white(Imperfections { second_stop: Some(rim), ..Imperfections::default() });
    let near = |image: &Image, u: usize, v: usize| -> f32 {
        (v - 20..v + 20)
            .flat_map(|v| (u - 20..u + 20).map(move |u| (u, v)))
            .map(|(u, v)| image.at(u, v))
            .sum()
    };
    assert!(near(&vignetted, 520, 362) > 0.95 * near(&ideal, 520, 362));
    assert!(near(&vignetted, 30, 30) < 0.6 * near(&ideal, 30, 30));
}

/// Micro-image centres are projected from the exit pupil. If it lies half way to the array, the pitch
/// grows by d (1/(D/2) − 1/D).
#[test]
fn the_exit_pupil_sets_the_pitch_of_the_micro_images() {
    let mla = preset("mini", &[]).camera.mla;
    let (d, lens) = (mla.mla_to_sensor_mm, mla.lens_to_mla_mm);
    // The distance between two columns.
    let width = |exit_pupil: f64| {
        let place = format!("camera.main_lens.exit_pupil_mm=[0, 0, {exit_pupil}]");
        let centers = preset("mini", &[&place]).tracer(4.0).unwrap().centers();
        let [a, b] = [2, 40].map(|k| {
            let found = centers.iter().find(|c| (c.center.k, c.center.l) == (k, 18));
            found.unwrap().center.u_px
        });
        b - a
    };
    let growth = width(-lens / 2.0) / width(0.0);
    let expected = (1.0 + 2.0 * d / lens) / (1.0 + d / lens);
    // The array is tilted by a milliradian.
    assert!((growth - expected).abs() < 1e-4, "{growth} for {expected}");
}
