//! Scratch.
use plenocal::io::read_image;
use plenocal::precalibration::measure_array;
use std::path::Path;
fn main() {
    for path in std::env::args().skip(1) {
        let t0 = std::time::Instant::now();
        let raw = read_image(Path::new(&path), None).unwrap();
        let t1 = std::time::Instant::now();
        let image = raw.to_grey();
        let t2 = std::time::Instant::now();
        let r = measure_array(&image);
        let t3 = std::time::Instant::now();
        println!("{path}: decode {:?} grey {:?} measure {:?}", t1 - t0, t2 - t1, t3 - t2);
        match r {
            Ok(m) => println!(
                "{:?}\n{} centers {:?} median sd {:?}",
                m.grid,
                m.centers.len(),
                m.left_out,
                {
                    let mut s = m.std_devs_px.clone();
                    s.sort_by(f64::total_cmp);
                    s[s.len() / 2]
                }
            ),
            Err(e) => println!("{e}"),
        }
    }
}
