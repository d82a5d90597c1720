//! Turns virtual depths into metric points: what a stack does with a calibrated camera.
//!
//!     cargo run --release --example metric_points -- camera.json depths.csv > points.csv
//!
//! depths.csv has the columns k, l, u, v, nu: pixel (u, v) of micro-image (k, l) shows something at the virtual depth nu.
//! Points are in the camera frame, mm.

use std::path::Path;

use plenocal::io::{VirtualDepths, read_camera, read_virtual_depths};
use plenocal::solver::metric_points;
use plenocal::{Error, Result};

fn main() -> Result<()> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let [camera, depths] = &arguments[..] else {
        return Err(Error::invalid("usage: metric_points camera.json depths.csv"));
    };
    let camera = read_camera(Path::new(camera))?;
    let VirtualDepths::Points(seen) = read_virtual_depths(Path::new(depths), None, [0.0; 3])?
    else {
        return Err(Error::invalid("the depths are not a CSV file of k, l, u, v, nu"));
    };
    println!("x,y,z");
    for point in metric_points(&camera, &seen)?.into_iter().flatten() {
        let [x, y, z] = point.point_mm;
        println!("{x:.6},{y:.6},{z:.6}");
    }
    Ok(())
}
