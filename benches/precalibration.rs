//! Speed of the pre-calibration of an R12's white images, compared with the time to decode them.

use std::hint::black_box;
use std::path::{Path, PathBuf};
use std::time::Instant;

use plenocal::image::Color;
use plenocal::io::{read_image, write_png};
use plenocal::precalibration::{PrecalibrationOptions, White, measure_array, precalibrate};
use plenocal::simulation::{DataSet, Settings};
use rayon::prelude::*;

const RUNS: usize = 7;

/// Median, s.
fn median(mut work: impl FnMut()) -> f64 {
    let mut times: Vec<f64> = (0..RUNS)
        .map(|_| {
            let start = Instant::now();
            work();
            start.elapsed().as_secs_f64()
        })
        .collect();
    times.sort_by(f64::total_cmp);
    times[RUNS / 2]
}

fn read(paths: &[(f64, PathBuf)]) -> Vec<White> {
    let white = |(f_number, path): &(f64, PathBuf)| {
        let raw = read_image(path, Some(Color::Grey)).expect("the image was written");
        White { name: path.display().to_string(), f_number: *f_number, image: raw }
    };
    paths.par_iter().map(white).collect()
}

fn main() -> plenocal::Result<()> {
    let settings = Settings::preset("r12-a", &["rays=16".to_owned()])?;
    let folder = std::env::temp_dir().join(format!("plenocal-bench-{}", std::process::id()));
    std::fs::create_dir_all(&folder).expect("a folder for temporary files");
    let mut paths = Vec::new();
    for shot in &DataSet::plan(&settings, None)?.whites {
        let path = Path::new(&folder).join(format!("{}.png", shot.number));
        let mut file = std::fs::File::create(&path).expect("a temporary file");
        write_png(&mut file, &shot.take(&settings, &|| ())?).expect("a temporary file");
        paths.push((shot.f_number, path));
    }
    let sheet = settings.datasheet();
    let options = PrecalibrationOptions::of_datasheet(&sheet);
    println!(
        "Pre-calibration of five R12 white images (8-bit grey PNG), {} cores:",
        rayon::current_num_threads()
    );
    let decoding = median(|| {
        paths.par_iter().for_each(|(_, path)| {
            black_box(read_image(path, Some(Color::Grey)).expect("the image was written"));
        });
    });
    let whites = read(&paths);
    let array = median(|| {
        black_box(measure_array(&whites[0].image, None).expect("an array"));
    });
    let whole = median(|| {
        let whites = read(&paths);
        black_box(precalibrate(&whites, None, &options, &|| ()).expect("white images"));
    });
    println!("  decoding alone                 {decoding:7.3} s");
    println!("  centres and grid of one image  {array:7.3} s");
    println!(
        "  the whole stage and decoding   {whole:7.3} s, {:.2} times decoding",
        whole / decoding
    );
    std::fs::remove_dir_all(&folder).expect("the folder can be removed");
    Ok(())
}
