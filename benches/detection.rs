//! Speed of detection in a frame of an R12, after decoding.

use std::hint::black_box;
use std::time::Instant;

use plenocal::detection::{DepthEstimator, MicroImages, Search, detect_frame};
use plenocal::precalibration::{PrecalibrationOptions, White, precalibrate};
use plenocal::simulation::{DataSet, Settings, Shot};

const RUNS: usize = 7;
const FRAMES: usize = 3;

fn main() -> plenocal::Result<()> {
    let settings = Settings::preset("r12-a", &["rays=32".to_owned()])?;
    let data_set = DataSet::plan(&settings, None)?;
    let white = |shot: &Shot| {
        let image = shot.take(&settings, &|| ())?;
        Ok(White { name: String::new(), f_number: shot.f_number, image })
    };
    let whites = data_set.whites.iter().map(white).collect::<plenocal::Result<Vec<White>>>()?;
    let reference = white(&data_set.devignetting)?;
    let (sheet, board) = (settings.datasheet(), settings.target.board());
    let options = PrecalibrationOptions::of_datasheet(&sheet);
    let measured = precalibrate(&whites, Some(&reference), &options, &|| ())?;
    let micro_images = MicroImages::of_precalibration(&measured, &sheet)?;
    let estimator = DepthEstimator::Line;
    let search =
        Search { micro_images: &micro_images, board: &board, sensor: &sheet.sensor, estimator };
    println!("Detection in an R12 frame, {} cores:", rayon::current_num_threads());
    let white = reference.image.grey_between(micro_images.levels.as_ref());
    for (pose, shot) in data_set.subsets[0].iter().take(FRAMES) {
        let image = shot.take(&settings, &|| ())?;
        let detect = || {
            detect_frame(
                pose.frame,
                &image.grey_between(micro_images.levels.as_ref()),
                &white,
                &search,
            )
        };
        let features = detect().0.map_or(0, |detection| detection.features.len());
        let mut times: Vec<f64> = (0..RUNS)
            .map(|_| {
                let start = Instant::now();
                let _ = black_box(detect());
                start.elapsed().as_secs_f64()
            })
            .collect();
        times.sort_by(f64::total_cmp);
        println!("  {features:5} features  {:7.3} s", times[RUNS / 2]);
    }
    Ok(())
}
