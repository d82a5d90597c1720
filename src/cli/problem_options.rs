//! Options beside `--problem`: those that ask for another cost are refused.

use std::path::Path;

use plenocal::calibration::{
    BoardModel, CalibrationOptions, ExitPupil, FieldCurvature, Pitches, SolvedProblem,
};
use plenocal::io;
use plenocal::model::{BoardShape, Parameter};
use plenocal::solver::Prior;
use plenocal::{Error, Result};

use super::input::board_shape;

/// Files of a problem beside problem.json.
const FEATURES: &str = "features.csv";
const CENTERS: &str = "centers.csv";

/// What an option says of a cost, and where a problem says it.
struct Term {
    /// The field of the options.
    field: &'static str,
    flag: &'static str,
    file: &'static str,
    key: &'static str,
    /// Whether both say the same.
    agrees: bool,
}

/// What is given on the command line beside a problem.
pub(super) struct Beside<'a> {
    /// Files or sets of options, which a problem has.
    pub input: Option<String>,
    /// The options by flags alone.
    pub options: CalibrationOptions,
    /// Whether the flag of a field of the options was given.
    pub is_given: &'a dyn Fn(&str) -> bool,
    /// Whether there are to be default priors, if that is said.
    pub default_priors: Option<bool>,
    /// File with the shape of the board.
    pub board_shape: Option<&'a Path>,
}

/// An error if input is given that the problem has, or if a flag asks for another cost than that of the problem.
pub(super) fn refuse_other_cost(
    beside: &Beside,
    problem: &SolvedProblem,
    folder: &Path,
) -> Result<()> {
    if let Some(given) = &beside.input {
        return Err(Error::invalid(format!(
            "--problem has the observations, the board and the cost: leave {given} out"
        )));
    }
    let options = &beside.options;
    let terms = of_cost(options, problem).into_iter().chain(of_free_parameters(options, problem));
    let given = terms.filter(|term| (beside.is_given)(term.field));
    let of_priors = [
        ("--priors", agree_on_defaults(beside.default_priors, problem)),
        ("--prior", agree_on_stated(options, problem)),
    ];
    let of_priors = of_priors.map(|(flag, agrees)| Term {
        field: "priors",
        flag,
        file: io::PROBLEM,
        key: "priors",
        agrees,
    });
    let of_shape = Term {
        field: "board",
        flag: "--board-shape",
        file: io::PROBLEM,
        key: "board",
        agrees: agree_on_shape(beside.board_shape, problem)?,
    };
    match given.chain(of_priors).chain([of_shape]).find(|term| !term.agrees) {
        Some(Term { flag, file, key, .. }) => Err(Error::invalid(format!(
            "{flag} asks for another cost than that of the problem ({key} in {}): leave {flag} out",
            folder.join(file).display()
        ))),
        None => Ok(()),
    }
}

/// Loss, weights and observations.
fn of_cost(options: &CalibrationOptions, problem: &SolvedProblem) -> Vec<Term> {
    let cost = &problem.cost;
    let frames = problem.observations().frames();
    let is = |value: Option<f64>, of_problem: f64| value.is_some_and(|v| is_same(v, of_problem));
    let has_no_frame = !options.exclude_frames.iter().any(|frame| frames.contains(frame));
    // Which σ the observations of a problem had before, nobody knows.
    [
        ("loss", "--loss", io::PROBLEM, "loss.kind", options.loss == Some(cost.loss.kind)),
        (
            "loss_scale",
            "--loss-scale",
            io::PROBLEM,
            "loss.scale",
            is(options.loss_scale, cost.loss.scale),
        ),
        ("blur", "--blur", io::PROBLEM, "rho", options.has_rho() == cost.rho),
        (
            "prior_weight",
            "--prior-weight",
            io::PROBLEM,
            "prior_weight",
            is(options.prior_weight, cost.prior_weight),
        ),
        ("exclude_frames", "--exclude", FEATURES, "frame", has_no_frame),
        ("weights", "--weights", FEATURES, "std_u", false),
        ("uv_std_dev_px", "--uv-std-dev", FEATURES, "std_u", false),
        ("rho_std_dev_px", "--rho-std-dev", FEATURES, "std_rho", false),
        ("centers_std_dev_px", "--centers-std-dev", CENTERS, "std_dev", false),
    ]
    .map(|(field, flag, file, key, agrees)| Term { field, flag, file, key, agrees })
    .into()
}

/// What is estimated and what is held.
fn of_free_parameters(options: &CalibrationOptions, problem: &SolvedProblem) -> Vec<Term> {
    let holds = |parameter: Parameter| problem.holds(parameter);
    let curvature = [Parameter::FieldCurvature, Parameter::FieldCurvatureGrowth].map(holds);
    let holds_board = Parameter::SHAPE.into_iter().all(holds);
    let is_flat = holds_board && problem.board.shape == BoardShape::default();
    let keeps_pupil = matches!(options.exit_pupil, ExitPupil::At(_));
    let pupil_mm = problem.camera.main_lens.exit_pupil_mm.z;
    let same_pupil = match options.exit_pupil {
        ExitPupil::At(place_mm) => is_same(place_mm, pupil_mm),
        ExitPupil::Estimated => true,
    };
    [
        ("mode", "--mode", options.mode == problem.options(problem.board.shape).mode),
        ("fix", "--fix", options.fix.iter().all(|parameter| holds(*parameter))),
        ("pitches", "--pitches", (options.pitches == Pitches::One) == holds(Parameter::PitchRatio)),
        ("exit_pupil", "--exit-pupil", keeps_pupil == holds(Parameter::PupilZ) && same_pupil),
        (
            "field_curvature",
            "--field-curvature",
            curvature
                == match options.field_curvature {
                    FieldCurvature::Estimated => [false, false],
                    FieldCurvature::Constant => [false, true],
                    FieldCurvature::Flat => [true, true],
                },
        ),
        (
            "board",
            "--board",
            match options.board {
                BoardModel::Flat => is_flat,
                BoardModel::Bent => !holds_board,
                BoardModel::Auto | BoardModel::Known(_) => true,
            },
        ),
    ]
    .map(|(field, flag, agrees)| Term { field, flag, file: io::PROBLEM, key: "fixed", agrees })
    .into()
}

/// Whether the default priors are wanted where the problem has some of them, and not where it has none.
fn agree_on_defaults(wanted: Option<bool>, problem: &SolvedProblem) -> bool {
    let is_default = |prior: &Prior| ["F", "m", "u0", "v0"].contains(&prior.quantity.as_str());
    let has_some = problem.cost.priors.iter().any(is_default);
    wanted.is_none_or(|wanted| wanted == has_some)
}

/// Whether the problem has all priors that are stated, and none that is taken away.
fn agree_on_stated(options: &CalibrationOptions, problem: &SolvedProblem) -> bool {
    let of_problem =
        |quantity: &str| problem.cost.priors.iter().find(|prior| prior.quantity == quantity);
    let stated = options.priors.stated();
    let has = |wanted: &Prior| {
        of_problem(&wanted.quantity).is_some_and(|prior| {
            is_same(prior.value, wanted.value) && is_same(prior.std_dev, wanted.std_dev)
        })
    };
    let is_stated = |quantity: &str| stated.iter().any(|prior| prior.quantity == quantity);
    let mut removed = options.priors.quantities.keys().filter(|quantity| !is_stated(quantity));
    stated.iter().all(has) && removed.all(|quantity| of_problem(quantity).is_none())
}

/// Whether a shape of the board that is stated is that of a problem that holds it.
fn agree_on_shape(stated: Option<&Path>, problem: &SolvedProblem) -> Result<bool> {
    let is_held = Parameter::SHAPE.into_iter().all(|parameter| problem.holds(parameter));
    let shape = board_shape(stated.filter(|_| is_held), None, &problem.board.board)?;
    Ok(shape.is_none_or(|(shape, _)| shape == problem.board.shape))
}

fn is_same(a: f64, b: f64) -> bool {
    (a - b).abs() <= 1e-9 * a.abs().max(b.abs())
}
