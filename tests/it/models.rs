//! Whether a group of parameters is said to be worth what it is.

use plenocal::calibration::{Calibration, CalibrationOptions};
use plenocal::evaluation::{Group, ModelComparison, WithoutGroup, Worth, compare_models};
use plenocal::model::{Noise, Observations, PlenopticCamera};
use plenocal::solver::synthesize;

use crate::support::{anchored, board, datasheet_start, run, shipped_observations, true_camera};
use crate::uncertainty::sixteen_poses;

const FOLDS: usize = 5;

fn compared(calibration: &Calibration) -> ModelComparison {
    let result = compare_models(calibration, &board(), FOLDS, &|| ()).unwrap();
    assert_eq!(result.problems, Vec::<String>::new());
    for g in &result.groups {
        println!(
            "{} {:?} {:?} {:?} {:?} {} conv {}",
            g.group,
            g.mean_growth(),
            g.worth(),
            g.cost_growth,
            g.focal_length_change,
            g.pattern,
            g.converged
        );
    }
    println!("{}", result.mean_error());
    result
}

#[test]
fn the_shipped_camera() {
    let t = std::time::Instant::now();
    let c = run(&datasheet_start(), &shipped_observations(), &anchored());
    println!("{:?}", t.elapsed());
    let t = std::time::Instant::now();
    compared(&c);
    println!("{:?}", t.elapsed());
}
