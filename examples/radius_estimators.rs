//! Compares the estimators of micro-image radii on simulated white images from dark to four times
//! over-exposed: makes the table in docs/accuracy.md.
//!
//!     cargo run --release --example radius_estimators

use plenocal::Result;
use plenocal::image::Image;
use plenocal::model::optics;
use plenocal::precalibration::{PrecalibrationOptions, RadiusEstimator, White, precalibrate};
use plenocal::simulation::{DataSet, Imaging, Scene, Settings};

fn main() -> Result<()> {
    for name in ["r12-a", "keplerian"] {
        let settings = Settings::preset(name, &["rays=64".to_owned()])?;
        let sheet = settings.datasheet();
        let plan = DataSet::plan(&settings, None)?;
        let light: Vec<(f64, Image)> = plan
            .whites
            .iter()
            .map(|shot| {
                let tracer = settings.tracer(shot.f_number)?;
                Ok((shot.f_number, tracer.render(&Scene::White, settings.rays, 7, &|| ())?))
            })
            .collect::<Result<_>>()?;
        let truth = optics::internal_parameters(&settings.camera);
        println!("{name}: errors in %\n");
        println!("| exposure | m | q'1 | q'2 | q'3 | m, moments | q'1 | q'2 | q'3 |");
        println!("|---|---|---|---|---|---|---|---|---|");
        for exposure in [0.2, 0.4, 0.8, 1.2, 2.0, 3.0, 4.0] {
            let imaging = Imaging { exposure, gain: 1.0, ..settings.imaging };
            let whites = (1..)
                .zip(&light)
                .map(|(seed, (f_number, light))| {
                    let image = imaging.read_out(light, 0, seed)?;
                    Ok(White { name: format!("f/{f_number:.2}"), f_number: *f_number, image })
                })
                .collect::<Result<Vec<White>>>()?;
            let mut cells = vec![format!("{exposure}")];
            for estimator in [RadiusEstimator::Profile, RadiusEstimator::Moments] {
                let options = PrecalibrationOptions {
                    estimator,
                    ..PrecalibrationOptions::of_datasheet(&sheet)
                };
                let found = precalibrate(&whites, None, &options, &|| ())?.internal.parameters;
                let percent = |a: f64, b: f64| format!("{:+.2}", 100.0 * (a / b - 1.0));
                cells.push(percent(found.m_mm, truth.m_mm));
                let q = found.q_prime_mm.iter().zip(&truth.q_prime_mm);
                cells.extend(q.map(|(a, b)| percent(*a, *b)));
            }
            println!("| {} |", cells.join(" | "));
        }
        println!();
    }
    Ok(())
}
