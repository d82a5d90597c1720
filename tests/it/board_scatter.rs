//! How well the shape of a board comes out, over many cameras, boards and poses.

use nalgebra::{Translation3, UnitQuaternion, Vector3};
use plenocal::calibration::BoardModel;
use plenocal::model::{BoardShape, Parameter};
use rayon::prelude::*;

use crate::board::{Random, length_errors, scene};

/// Boards of one kind: what they are, how they stand, and errors that all corners of a frame share.
struct Kind {
    name: &'static str,
    draws: u64,
    shape: BoardShape,
    /// At one distance, filling the image, and hardly tilted.
    alike: bool,
    /// An astigmatic error over the board, px, another in each frame.
    shared_px: f64,
}

/// Errors of the shape when it was tried, with σ; which of it was found; errors of F, D and d in σ, and relative
/// with the shape as it was found and as it is.
struct Outcome {
    tried: Vec<(f64, f64)>,
    found: [bool; 4],
    lengths: [[(f64, f64); 3]; 2],
}

impl Kind {
    fn outcome(&self, seed: u64) -> Outcome {
        let mut scene = scene(seed);
        let mut random = Random::new(seed + 500);
        if self.alike {
            for pose in &mut scene.poses {
                let turn = UnitQuaternion::from_scaled_axis(Vector3::new(
                    0.15 * random.even(),
                    0.15 * random.even(),
                    0.05 * random.even(),
                ));
                let middle = turn * scene.board.middle_mm().coords;
                let place = Vector3::new(random.even(), random.even(), 88.0) - middle;
                pose.camera_from_board = Translation3::from(place) * turn;
            }
        }
        let mut observations = scene.observed(self.shape, 1000 + seed);
        let half = scene.board.middle_mm().coords;
        let mut of_frame = std::collections::BTreeMap::new();
        for f in &mut observations.features {
            let [a, b] = *of_frame
                .entry(f.frame)
                .or_insert_with(|| [random.normal(), random.normal()].map(|n| self.shared_px * n));
            let place = scene.board.point_mm(f.corner).coords - half;
            let (x, y) = (place.x / half.x, place.y / half.y);
            f.u_px += a * (x * x - y * y);
            f.v_px += b * x * y;
        }
        let of = |model: BoardModel| {
            let result = scene.calibrated(&observations, model);
            assert!(result.converged, "{}, seed {seed}", self.name);
            result
        };
        let (auto, known) = (of(BoardModel::Auto), of(BoardModel::Known(self.shape)));
        let tried = auto.board.tried().map(Option::unwrap);
        let error =
            |(p, (value, std_dev)): (Parameter, (f64, f64))| (value - self.shape.value(p), std_dev);
        Outcome {
            tried: Parameter::SHAPE.into_iter().zip(tried).map(error).collect(),
            found: auto.board.std_devs.map(|std_dev| std_dev.is_some()),
            lengths: [auto, known].map(|result| length_errors(&result, &scene.camera)),
        }
    }

    /// Draws boards, and returns scatter over σ of the shape and of F, D and d with the shape as it was found, and how often a
    /// bend and an aspect were found. Prints the row of the table that `make evidence` takes.
    fn draw(&self) -> ([f64; 4], [f64; 3], [f64; 2]) {
        let all: Vec<Outcome> =
            (0..self.draws).into_par_iter().map(|seed| self.outcome(seed)).collect();
        let count = all.len() as f64;
        let rms = |of: &dyn Fn(&Outcome) -> f64| {
            (all.iter().map(|o| of(o).powi(2)).sum::<f64>() / count).sqrt()
        };
        let ratios = std::array::from_fn(|i| rms(&|o| o.tried[i].0 / o.tried[i].1));
        let lengths = std::array::from_fn(|i| rms(&|o| o.lengths[0][i].0));
        let found = [0, 3].map(|i| all.iter().filter(|o| o.found[i]).count() as f64 / count);
        let [sag_x, sag_y, twist, aspect] = ratios;
        let [bends, aspects] = found.map(|part| 100.0 * part);
        let [with_found, with_true] = [0, 1].map(|m| 100.0 * rms(&|o| o.lengths[m][2].1));
        println!(
            "| {} ({} draws) | {sag_x:.2} | {sag_y:.2} | {twist:.2} | {aspect:.2} | {bends:.0} %, {aspects:.0} % \
             | {with_found:.2}, {with_true:.2} |",
            self.name, self.draws
        );
        (ratios, lengths, found)
    }
}

#[test]
#[ignore = "slow: 1000 calibrations; run by `make test-slow`"]
fn monte_carlo_of_boards() {
    let flat = BoardShape::default();
    let bent = BoardShape { sag_x_mm: 0.2, sag_y_mm: -0.1, twist_mm: 0.05, aspect: 1e-3 };
    let plain = Kind { name: "flat", draws: 200, shape: flat, alike: false, shared_px: 0.0 };
    let of = |name, draws, shape| Kind { name, draws, shape, ..plain };
    let slight = BoardShape { sag_x_mm: 0.05, ..flat };
    for (kind, expected) in [
        (of("flat", 200, flat), [0.0, 0.0]),
        (of("sag_x 0.05 mm", 40, slight), [1.0, 0.0]),
        (of("sags 0.2, −0.1 mm, twist 0.05 mm, aspect 0.001", 40, bent), [1.0, 1.0]),
        (of("aspect 0.001", 40, BoardShape { aspect: 1e-3, ..flat }), [0.0, 1.0]),
        (
            Kind {
                shared_px: 0.2,
                draws: 100,
                name: "flat, an error of 0.2 px in each frame",
                ..plain
            },
            [0.0, 0.0],
        ),
        (Kind { alike: true, draws: 40, name: "flat, all frames alike", ..plain }, [0.0, 0.0]),
        (Kind { alike: true, ..of("bent as above, all frames alike", 40, bent) }, [1.0, 1.0]),
    ] {
        let (ratios, lengths, found) = kind.draw();
        // σ is neither too small nor too large.
        for (ratio, parameter) in ratios.iter().zip(Parameter::SHAPE) {
            assert!((0.5..1.4).contains(ratio), "{}: {} {ratio}", kind.name, parameter.name());
        }
        assert!(
            lengths.iter().all(|ratio| (0.4..1.3).contains(ratio)),
            "{}: {lengths:?}",
            kind.name
        );
        for (found, expected) in found.into_iter().zip(expected) {
            assert!((found - expected).abs() <= 0.05, "{}: {found}", kind.name);
        }
    }
}
