//! Speed of the ray tracer: seconds for an image of a small camera and of an R12.

use std::time::Instant;

use plenocal::simulation::{DataSet, Settings, Shot};

fn seconds(settings: &Settings, shot: &Shot, threads: usize, runs: usize) -> f64 {
    let pool = rayon::ThreadPoolBuilder::new()
        .num_threads(threads)
        .build()
        .expect("threads can be started");
    let mut times: Vec<f64> = (0..runs)
        .map(|_| {
            let start = Instant::now();
            pool.install(|| shot.take(settings, &|| ())).expect("images of presets can be taken");
            start.elapsed().as_secs_f64()
        })
        .collect();
    times.sort_by(f64::total_cmp);
    times[runs / 2]
}

fn main() -> plenocal::Result<()> {
    println!("Simulation, {} cores, median:", rayon::current_num_threads());
    for (name, runs) in [("mini", 7), ("r12-a", 1)] {
        let settings = Settings::preset(name, &["rays=64".to_owned()])?;
        let data_set = DataSet::plan(&settings, None)?;
        let sensor = settings.camera.sensor;
        println!("  {name}: {} x {} px, 64 rays per pixel", sensor.width_px, sensor.height_px);
        for (what, shot) in
            [("white, f/4", &data_set.whites[0]), ("board, f/4", &data_set.subsets[0][0].1)]
        {
            let all = rayon::current_num_threads();
            let (one, all) =
                (seconds(&settings, shot, 1, runs), seconds(&settings, shot, all, runs));
            let ratio = one / all;
            println!(
                "    {what}  {all:7.2} s   (one thread {one:6.2} s, {ratio:.2} times as long)"
            );
        }
    }
    Ok(())
}
