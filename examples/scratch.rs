//! Scratch.
use plenocal::camera::Configuration;
use plenocal::io::*;
use plenocal::observations::MicroImageCenter;
use plenocal::precalibration::*;
use std::collections::HashMap;
use std::path::Path;
fn main() {
    for dir in std::env::args().skip(1) {
        let dir = Path::new(&dir);
        let project = Project::read(&dir.join("project.toml")).unwrap();
        let sheet = project.datasheet().unwrap().unwrap();
        let images = project.images.unwrap();
        let whites: Vec<White> = images
            .whites
            .iter()
            .map(|w| White {
                name: w.image.display().to_string(),
                f_number: w.f_number,
                image: read_image(&w.image, Some(images.color)).unwrap().to_grey(),
            })
            .collect();
        let devig = images.devignetting.map(|p| White {
            name: "devig".into(),
            f_number: sheet.f_number,
            image: read_image(&p, Some(images.color)).unwrap().to_grey(),
        });
        let truth = read_camera(&dir.join("truth/camera.json")).unwrap();
        let omega = plenocal::optics::internal_parameters(&truth);
        let centers = read_centers(&dir.join("truth/centers.csv")).unwrap();
        let _ = Configuration::Galilean;
        for estimator in [RadiusEstimator::Profile, RadiusEstimator::Moments] {
            let options = PrecalibrationOptions {
                pixel_size_mm: sheet.sensor.pixel_size_mm,
                configuration: sheet.configuration,
                array_size: Some((sheet.columns, sheet.rows)),
                estimator,
            };
            let t = std::time::Instant::now();
            let p = precalibrate(&whites, devig.as_ref(), &options, &|| ()).unwrap();
            println!("{:?} in {:?}", estimator, t.elapsed());
            println!(
                "{:?} {:?} corr {:.2e} {:?}",
                p.array.grid, p.array.left_out, p.pitch_correction, p.lens_types
            );
            println!(
                "m {:.3} ± {:.3} of {:.3} µm: {:+.2} %",
                p.internal.parameters.m_mm * 1e3,
                p.internal.m_std_dev_mm * 1e3,
                omega.m_mm * 1e3,
                100.0 * (p.internal.parameters.m_mm / omega.m_mm - 1.0)
            );
            for (i, q) in p.internal.parameters.q_prime_mm.iter().enumerate() {
                println!(
                    "q {:.3} ± {:.3} of {:.3} µm: {:+.2} %",
                    q * 1e3,
                    p.internal.q_prime_std_dev_mm[i] * 1e3,
                    omega.q_prime_mm[i] * 1e3,
                    100.0 * (q / omega.q_prime_mm[i] - 1.0)
                );
            }
            let half = omega.micro_image_pitch_mm.unwrap() / 2.0;
            for r in &p.radii {
                let t = omega.m_mm / r.f_number + (half - omega.q_prime_mm[r.lens_type]).abs();
                print!(
                    "[{:.1} {} {:.3}±{:.3} {:+.3}] ",
                    r.f_number,
                    r.lens_type,
                    r.radius_px,
                    r.std_dev_px,
                    r.radius_px - t / sheet.sensor.pixel_size_mm
                );
            }
            println!("\n{:?}", p.warnings);
            let lut: HashMap<(i32, i32), MicroImageCenter> =
                centers.iter().map(|c| ((c.k, c.l), *c)).collect();
            let mut s = 0.0;
            let mut n = 0.0;
            let mut w = 0.0f64;
            for c in &p.array.centers {
                let t = lut[&(c.k, c.l)];
                let d = (t.u_px - c.u_px).hypot(t.v_px - c.v_px);
                s += d * d;
                n += 1.0;
                w = w.max(d);
            }
            let tg = fit_grid(
                &centers,
                p.array.grid.lattice.kind,
                p.array.grid.lattice.columns,
                p.array.grid.lattice.rows,
            )
            .unwrap();
            println!(
                "centres rms {:.4} max {:.3}; pitch {:.2e}, rotation {:.2e}",
                f64::sqrt(s / n),
                w,
                p.array.grid.pitch_px / tg.pitch_px - 1.0,
                p.array.grid.rotation_rad - tg.rotation_rad
            );
        }
    }
}
