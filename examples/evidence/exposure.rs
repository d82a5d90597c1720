//! Estimators of micro-image radii, on white images from dark to four times over-exposed.

use plenocal::Result;
use plenocal::image::Image;
use plenocal::precalibration::{PrecalibrationOptions, RadiusEstimator, White, precalibrate};
use plenocal::quantity::fixed;
use plenocal::simulation::{DataSet, Imaging, Scene, Settings};

use crate::sets::{Extent, Set, seeds, set, step};
use crate::text::{Table, signed};

const SETS: [Set; 2] = [set("`r12-a`", "r12-a", &[]), set("`keplerian`", "keplerian", &[])];
const SEED: u64 = 7401;
/// Exposures; at 1 the middle of the brightest micro-image just fills a pixel.
const EXPOSURES: [f64; 7] = [0.2, 0.4, 0.8, 1.2, 2.0, 3.0, 4.0];

/// Compares the estimators.
pub fn estimators(extent: &Extent) -> Result<Vec<String>> {
    let mut table = Table::new(&[
        "set",
        "exposure",
        "m",
        "q'₁",
        "q'₂",
        "q'₃",
        "m, moments",
        "q'₁",
        "q'₂",
        "q'₃",
    ]);
    let exposures = if extent.quick { &EXPOSURES[2..4] } else { &EXPOSURES };
    for (set, settings) in extent.settings(&SETS, SEED)? {
        step(set.name);
        let light = light(&settings)?;
        for exposure in exposures {
            step(&format!("exposure {exposure}"));
            let errors = errors(&settings, &light, *exposure)?;
            let first = [set.name.to_owned(), fixed(*exposure, 1)];
            table.row(first.into_iter().chain(errors));
        }
    }
    Ok(vec![table.with(&seeds(&SETS, SEED))])
}

/// Renders the light of the white images, by f-number.
fn light(settings: &Settings) -> Result<Vec<(f64, Image)>> {
    let plan = DataSet::plan(settings, None)?;
    let render = |f_number: f64| {
        let tracer = settings.tracer(f_number)?;
        let light = tracer.render(&Scene::White, settings.rays, settings.seed, &|| ())?;
        Ok((f_number, light))
    };
    plan.whites.iter().map(|shot| render(shot.f_number)).collect()
}

/// Returns the errors in per cent of m and q'ᵢ by both estimators.
fn errors(settings: &Settings, light: &[(f64, Image)], exposure: f64) -> Result<Vec<String>> {
    let sheet = settings.datasheet();
    let truth = settings.tracer(settings.board_f_number())?.internal_parameters();
    let imaging = Imaging { exposure, gain: 1.0, ..settings.imaging };
    let white = |(number, (f_number, light)): (u64, &(f64, Image))| {
        let image = imaging.read_out(light, settings.seed, number)?;
        Ok(White { name: format!("f/{f_number:.2}"), f_number: *f_number, image })
    };
    let whites = (1..).zip(light).map(white).collect::<Result<Vec<White>>>()?;
    let mut cells = Vec::new();
    for estimator in [RadiusEstimator::Profile, RadiusEstimator::Moments] {
        let options =
            PrecalibrationOptions { estimator, ..PrecalibrationOptions::of_datasheet(&sheet) };
        let found = precalibrate(&whites, None, &options, &|| ())?.internal.parameters;
        let q_prime = found.q_prime_mm.iter().zip(&truth.q_prime_mm);
        let all = [(&found.m_mm, &truth.m_mm)].into_iter().chain(q_prime);
        cells.extend(all.map(|(found, truth)| signed(100.0 * (found / truth - 1.0), 2)));
    }
    Ok(cells)
}
