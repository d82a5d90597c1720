//! Problem that a calibration has solved, for other programs to solve it too.

use std::collections::{BTreeMap, BTreeSet};

use nalgebra::Point3;

use crate::calibration::frames::{ALIKE_RAD, solver_features};
use crate::calibration::{
    Blur, BoardModel, Calibration, CalibrationOptions, Mode, Pitches, Priors,
};
use crate::finding::CostDifference;
use crate::model::{
    BapFeature, BentBoard, Board, BoardShape, FramePose, MicroImageCenter, Observations, Parameter,
    PlenopticCamera,
};
use crate::quantity::{Estimate, significant};
use crate::solver::{CostOptions, LossKind, Prior};

/// Relative difference below which numbers of two costs are the same: they may have been written with fewer digits.
const SAME: f64 = 1e-6;

/// Complete least-squares problem that [`calibrate`](crate::calibration::calibrate) has minimised.
#[derive(Debug, Clone, PartialEq)]
pub struct SolvedProblem {
    /// Initial camera.
    pub camera: PlenopticCamera,
    /// Initial poses of the boards. A board that turned out to be tilted the other way has its final pose: from its
    /// first pose no solver finds back.
    pub poses: Vec<FramePose>,
    /// Board, with its initial or fixed shape.
    pub board: BentBoard,
    /// Features of the boards.
    pub features: Vec<ProblemFeature>,
    /// Micro-image centres, with their σ in the cost.
    pub centers: Vec<MicroImageCenter>,
    /// Cost, with all priors and their weight. Its factors on σ are 1.
    pub cost: CostOptions,
    /// Value of the cost where the calibration ended.
    pub minimum: f64,
}

/// A feature of a problem.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ProblemFeature {
    /// Observed feature.
    pub feature: BapFeature,
    /// Position of its corner on the flat board, mm.
    pub board_point_mm: Point3<f64>,
    /// σ of u, v and ρ in the cost, with the factors of the options. σ of ρ is multiplied by √n for the n features of a
    /// corner, which share one blur.
    pub std_dev_px: [f64; 3],
}

impl SolvedProblem {
    /// Creates the problem of a calibration that was made with this board.
    #[must_use]
    pub fn of(calibration: &Calibration, board: &Board) -> Self {
        let Calibration { cost, options, refinement, reprojection, .. } = calibration;
        let observed: Vec<BapFeature> = reprojection.features.iter().map(|f| f.feature).collect();
        let factors = [cost.uv_std_dev_px, cost.uv_std_dev_px, cost.rho_std_dev_px];
        let rows = solver_features(&observed, &calibration.poses, board);
        let features = observed.iter().zip(&rows).map(|(&feature, row)| ProblemFeature {
            feature,
            board_point_mm: row.board_point_mm.into(),
            std_dev_px: std::array::from_fn(|i| factors[i] * row.std_dev_px[i]),
        });
        let of_center = |center: &MicroImageCenter| MicroImageCenter {
            std_dev_px: Some(cost.centers_std_dev_px * center.std_dev_px.unwrap_or(1.0)),
            ..*center
        };
        let start = |(&first, &last): (&FramePose, &FramePose)| {
            let turned =
                first.camera_from_board.rotation.angle_to(&last.camera_from_board.rotation);
            if turned > ALIKE_RAD { last } else { first }
        };
        Self {
            camera: calibration.initial.clone(),
            poses: calibration.initial_poses.iter().zip(&calibration.poses).map(start).collect(),
            board: BentBoard { board: *board, shape: options.known_shape() },
            features: features.collect(),
            centers: reprojection.centers.iter().map(|c| of_center(&c.center)).collect(),
            cost: CostOptions {
                uv_std_dev_px: 1.0,
                rho_std_dev_px: 1.0,
                centers_std_dev_px: 1.0,
                ..cost.clone()
            },
            minimum: refinement.cost,
        }
    }

    /// Returns the observations, with their σ in the cost.
    #[must_use]
    pub fn observations(&self) -> Observations {
        let mut of_corner: BTreeMap<(u32, i32), f64> = BTreeMap::new();
        for ProblemFeature { feature, .. } in &self.features {
            *of_corner.entry((feature.frame, feature.corner)).or_default() += 1.0;
        }
        let feature = |of: &ProblemFeature| {
            let ([u, v, rho], feature) = (of.std_dev_px, of.feature);
            let count = of_corner[&(feature.frame, feature.corner)];
            // The conversion for the solver multiplies by √n again.
            let rho_std_dev_px = Some(rho / count.sqrt());
            BapFeature { std_dev_px: Some([u, v]), rho_std_dev_px, ..feature }
        };
        Observations {
            features: self.features.iter().map(feature).collect(),
            centers: self.centers.clone(),
            ..Observations::default()
        }
    }

    /// Returns the options of a calibration with this cost. `shape` is the shape of the board if it is held.
    #[must_use]
    pub fn options(&self, shape: BoardShape) -> CalibrationOptions {
        let CostOptions { rho, loss, priors, prior_weight, .. } = &self.cost;
        let lens_types = self.camera.lens_types();
        let holds_camera = Parameter::intrinsic(lens_types).iter().all(|p| self.holds(*p));
        let mode = match (holds_camera, lens_types) {
            (true, _) => Mode::PosesOnly,
            (false, 0) => Mode::CornersOnly,
            (false, _) => Mode::Full,
        };
        let holds_board = Parameter::SHAPE.iter().all(|p| self.holds(*p));
        let mut stated = Priors { default: false, ..Priors::default() };
        for Prior { quantity, value, std_dev } in priors {
            stated.state(quantity, *value, *std_dev);
        }
        CalibrationOptions {
            mode,
            pitches: Pitches::Two,
            board: if holds_board { BoardModel::Known(shape) } else { BoardModel::Bent },
            fix: self.cost.fixed.iter().filter_map(|name| name.parse().ok()).collect(),
            priors: stated,
            prior_weight: Some(*prior_weight),
            blur: if *rho { Blur::Features } else { Blur::WhiteImages },
            loss: Some(loss.kind),
            loss_scale: Some(loss.scale),
            ..CalibrationOptions::default()
        }
    }

    /// Returns true if a parameter of camera or board keeps its value.
    #[must_use]
    pub fn holds(&self, parameter: Parameter) -> bool {
        self.cost.fixed.iter().any(|name| name == parameter.name())
    }

    /// Returns the terms in which the cost of an evaluation differs from this one.
    #[must_use]
    pub fn differences(&self, here: &Self) -> Vec<CostDifference> {
        let differing = |option: &'static str, words: &dyn Fn(&Self) -> String| {
            let (problem, here) = (words(self), words(here));
            (problem != here).then_some(CostDifference { option, problem, here })
        };
        let terms = [
            differing("loss", &Self::loss_words),
            differing("blur", &|of| {
                if of.cost.rho { "residuals of ρ" } else { "no residuals of ρ" }.to_owned()
            }),
            differing("board", &Self::board_words),
        ];
        terms
            .into_iter()
            .flatten()
            .chain(self.held_differently(here))
            .chain(self.prior_differences(here))
            .chain(self.observation_differences(here))
            .collect()
    }

    fn loss_words(&self) -> String {
        match self.cost.loss.kind {
            LossKind::None => "loss none".to_owned(),
            kind => format!("loss {} {}", kind.name(), self.cost.loss.scale),
        }
    }

    fn board_words(&self) -> String {
        let BentBoard { board: Board { columns, rows, square_mm }, shape } = self.board;
        let bent: Vec<String> = Parameter::SHAPE
            .iter()
            .filter(|parameter| shape.value(**parameter).abs() > 0.0)
            .map(|parameter| format!("{parameter} = {:.4}", shape.value(*parameter)))
            .collect();
        let shape = if bent.is_empty() { "flat".to_owned() } else { bent.join(", ") };
        format!("a board of {columns} x {rows} corners with squares of {square_mm} mm ({shape})")
    }

    /// Returns the parameters that one cost holds and the other leaves free.
    fn held_differently(&self, here: &Self) -> Vec<CostDifference> {
        let lens_types = self.camera.lens_types();
        let all = Parameter::shared(lens_types);
        let held_by = |one: &Self, other: &Self| -> Vec<&str> {
            let only = all.iter().filter(|p| one.holds(**p) && !other.holds(**p));
            only.map(|p| p.name()).collect()
        };
        let difference = |names: Vec<&str>, [problem, here]: [&str; 2]| {
            let names = names.join(", ");
            (!names.is_empty()).then(|| CostDifference {
                option: "fix",
                problem: format!("{names} {problem}"),
                here: format!("{names} {here}"),
            })
        };
        let of_problem = difference(held_by(self, here), ["held", "free"]);
        let of_here = difference(held_by(here, self), ["free", "held"]);
        of_problem.into_iter().chain(of_here).collect()
    }

    fn prior_differences(&self, here: &Self) -> Vec<CostDifference> {
        let option = "priors";
        let of = |problem: &Self| -> BTreeMap<String, Estimate> {
            let known =
                |p: &Prior| (p.quantity.clone(), Estimate { value: p.value, std_dev: p.std_dev });
            problem.cost.priors.iter().map(known).collect()
        };
        let (problem_has, here_has) = (of(self), of(here));
        let only = |a: &BTreeMap<String, Estimate>, b: &BTreeMap<String, Estimate>| {
            let names: Vec<String> = a.keys().filter(|q| !b.contains_key(*q)).cloned().collect();
            (!names.is_empty()).then(|| names.join(", "))
        };
        let mut differences = Vec::new();
        if let Some(names) = only(&problem_has, &here_has) {
            let (problem, here) = (format!("priors on {names}"), format!("none on {names}"));
            differences.push(CostDifference { option, problem, here });
        }
        if let Some(names) = only(&here_has, &problem_has) {
            let (problem, here) = (format!("no priors on {names}"), format!("priors on {names}"));
            differences.push(CostDifference { option, problem, here });
        }
        for (quantity, there) in &problem_has {
            let Some(known) = here_has.get(quantity) else { continue };
            if !is_same(there.value, known.value) || !is_same(there.std_dev, known.std_dev) {
                let words = |prior: &Estimate| format!("the prior {quantity} = {prior}");
                differences.push(CostDifference {
                    option,
                    problem: words(there),
                    here: words(known),
                });
            }
        }
        let weights = [self, here].map(|of| of.cost.prior_weight);
        let have_priors = !problem_has.is_empty() && !here_has.is_empty();
        if have_priors && !is_same(weights[0], weights[1]) {
            let [problem, here] = weights.map(|weight| format!("a prior weight of {weight:.6}"));
            differences.push(CostDifference { option: "prior_weight", problem, here });
        }
        differences
    }

    fn observation_differences(&self, here: &Self) -> Vec<CostDifference> {
        let difference = |option: &'static str, [problem, here]: [String; 2]| {
            vec![CostDifference { option, problem, here }]
        };
        let key = |of: &ProblemFeature| {
            let BapFeature { frame, corner, k, l, .. } = of.feature;
            (frame, corner, k, l)
        };
        let keys = |of: &Self| of.features.iter().map(key).collect::<BTreeSet<_>>();
        if keys(self) != keys(here) {
            let words = |of: &Self| {
                let frames: BTreeSet<u32> = of.features.iter().map(|f| f.feature.frame).collect();
                format!("{} features of {} frames", of.features.len(), frames.len())
            };
            let words = [words(self), words(here)];
            let same = words[0] == words[1];
            return difference(
                "features",
                words.map(|w| if same { format!("{w}, others") } else { w }),
            );
        }
        let mut all = Vec::new();
        let there: BTreeMap<_, &ProblemFeature> =
            self.features.iter().map(|f| (key(f), f)).collect();
        let pairs = || here.features.iter().map(|f| (there[&key(f)], f));
        let moved = pairs()
            .map(|(a, b)| (a.feature.u_px - b.feature.u_px).hypot(a.feature.v_px - b.feature.v_px));
        let moved_px = moved.fold(0.0, f64::max);
        if moved_px > SAME {
            all.extend(difference(
                "features",
                [
                    "u, v of its features.csv".to_owned(),
                    format!(
                        "other positions, with differences of up to {} px",
                        significant(moved_px, 2)
                    ),
                ],
            ));
        }
        let mean = |of: &Self, i: usize| {
            let sum: f64 = of.features.iter().map(|f| f.std_dev_px[i]).sum();
            sum / of.features.len() as f64
        };
        for (name, components) in [("(u, v)", 0..2), ("ρ", 2..3)] {
            let counts = name != "ρ" || (self.cost.rho && here.cost.rho);
            let differ =
                |i: usize| pairs().any(|(a, b)| !is_same(a.std_dev_px[i], b.std_dev_px[i]));
            let first = components.start;
            if counts && components.into_iter().any(differ) {
                let words = |of: &Self| format!("mean σ of {name} {:.4} px", mean(of, first));
                all.extend(difference("weights", [words(self), words(here)]));
            }
        }
        let centers = |of: &Self| format!("{} centres", of.centers.len());
        if self.centers.len() == here.centers.len() {
            let std_dev = |of: &Self| {
                let sum: f64 = of.centers.iter().map(|c| c.std_dev_px.unwrap_or(1.0)).sum();
                sum / of.centers.len().max(1) as f64
            };
            if !is_same(std_dev(self), std_dev(here)) {
                let words = |of: &Self| format!("mean σ of centres {:.4} px", std_dev(of));
                all.extend(difference("weights", [words(self), words(here)]));
            }
        } else {
            all.extend(difference("centers", [centers(self), centers(here)]));
        }
        all
    }
}

fn is_same(a: f64, b: f64) -> bool {
    (a - b).abs() <= SAME * a.abs().max(b.abs())
}
