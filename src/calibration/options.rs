//! Options of a calibration: one struct for the library, `[calibration]` of a project file, and the command line.

use std::collections::BTreeMap;
use std::str::FromStr;

use clap::{Args, ValueEnum};
use serde::{Deserialize, Serialize};
use toml::Table;

use super::start::Start;
use crate::checks::whites::vignettes;
use crate::error::{Error, Result};
use crate::model::{BoardShape, FramePose, Parameter, SHAPE, positive};
use crate::quantity::Estimate;
use crate::solver::{CostOptions, Loss, LossKind, Prior, SolverOptions, names};
use crate::table::merge;

/// Named set of options. Options that are stated beside it take precedence.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Deserialize, ValueEnum)]
#[serde(rename_all = "kebab-case")]
pub enum Method {
    /// Weights, priors, a robust loss, and effects that the paper's camera lacks.
    #[default]
    Full,
    /// Unit weights, no loss, no priors, exit pupil in the lens, flat field, flat board, blur from features.
    Paper,
}

/// Quantities to estimate.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize, ValueEnum)]
#[serde(rename_all = "kebab-case")]
pub enum Mode {
    /// Camera and poses, from (u, v), the centres, and q' or rho (--blur).
    #[default]
    Full,
    /// Camera with pinholes (I = 0), and poses, from (u, v) and the centres: Noury et al. 2017.
    CornersOnly,
    /// Poses, with the camera fixed.
    PosesOnly,
}

/// Shape of the board.
#[derive(Debug, Clone, Copy, PartialEq, Default, Deserialize, ValueEnum)]
#[serde(rename_all = "kebab-case")]
pub enum BoardModel {
    /// Flat board, unless the frames show that it is bent or stretched.
    #[default]
    Auto,
    /// Flat board (the paper).
    Flat,
    /// Bent and stretched board, whose shape is estimated.
    Bent,
    /// Board of this known shape.
    #[serde(skip)]
    #[value(skip)]
    Known(BoardShape),
}

/// Weights of observations.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Deserialize, ValueEnum)]
#[serde(rename_all = "kebab-case")]
pub enum Weights {
    /// Weight of each observation by its own standard deviation, if the file states one.
    #[default]
    Own,
    /// Equal weights for all observations of a kind (the paper).
    Unit,
}

/// Number of micro-lens pitches.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Deserialize, ValueEnum)]
#[serde(rename_all = "kebab-case")]
pub enum Pitches {
    /// One pitch for both axes (the paper).
    #[default]
    One,
    /// One pitch along x and one along y.
    Two,
}

/// Distortion of the main lens.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Deserialize, ValueEnum)]
#[serde(rename_all = "kebab-case")]
pub enum Distortion {
    /// Estimated, together with its growth with the magnification.
    #[default]
    Estimated,
    /// Estimated, and constant over distance (the paper).
    Constant,
}

/// Angle between the optical axis and the normal of the sensor.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Deserialize, ValueEnum)]
#[serde(rename_all = "kebab-case")]
pub enum LensTilt {
    /// Estimated.
    #[default]
    Estimated,
    /// None (the paper).
    None,
}

/// Curvature of the field.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Deserialize, ValueEnum)]
#[serde(rename_all = "kebab-case")]
pub enum FieldCurvature {
    /// Estimated, together with its growth with the magnification.
    #[default]
    Estimated,
    /// Estimated, and constant over distance.
    Constant,
    /// Flat field (the paper).
    Flat,
}

/// Source of the focal lengths of the micro-lenses.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Deserialize, ValueEnum)]
#[serde(rename_all = "kebab-case")]
pub enum Blur {
    /// Values of q' from the white images.
    #[default]
    WhiteImages,
    /// Values of rho of every feature (the paper).
    Features,
}

/// Position of the exit pupil on the axis of the main lens: `estimated`, `at-lens`, or `e_z` in mm.
#[derive(Debug, Clone, Copy, PartialEq, Default, Deserialize)]
#[serde(try_from = "ExitPupilText")]
pub enum ExitPupil {
    /// Estimated position.
    #[default]
    Estimated,
    /// Fixed position `e_z`, mm; 0 in the paper.
    At(f64),
}

impl ExitPupil {
    /// Exit pupil of the paper: in the lens, without aberration.
    pub const AT_LENS: Self = Self::At(0.0);
}

#[derive(Deserialize)]
#[serde(untagged, expecting = "exit_pupil is \"estimated\", \"at-lens\", or e_z in mm")]
enum ExitPupilText {
    Number(f64),
    Word(String),
}

impl TryFrom<ExitPupilText> for ExitPupil {
    type Error = Error;

    fn try_from(text: ExitPupilText) -> Result<Self> {
        match text {
            ExitPupilText::Number(place) => Ok(Self::At(place)),
            ExitPupilText::Word(word) => word.parse(),
        }
    }
}

impl FromStr for ExitPupil {
    type Err = Error;

    fn from_str(text: &str) -> Result<Self> {
        match text {
            "estimated" => Ok(Self::Estimated),
            "at-lens" => Ok(Self::AT_LENS),
            number => match number.parse() {
                Ok(place) if f64::is_finite(place) => Ok(Self::At(place)),
                _ => Err(Error::invalid(format!(
                    "'{text}' is not a position of the exit pupil: write estimated, at-lens, or \
                     its distance from the lens in mm, negative towards the array"
                ))),
            },
        }
    }
}

/// Prior knowledge of a camera: default priors and stated ones.
#[derive(Debug, Clone, PartialEq, Deserialize)]
pub struct Priors {
    /// True if the default priors, of datasheet, white images and sensor, are used.
    #[serde(default = "wanted")]
    pub default: bool,
    /// Stated priors by quantity: a parameter of camera or board, `m`, a component of the tilt gradient, or a q'ᵢ. They
    /// replace the default ones.
    #[serde(flatten)]
    pub quantities: BTreeMap<String, StatedPrior>,
}

fn wanted() -> bool {
    true
}

impl Default for Priors {
    fn default() -> Self {
        Self { default: true, quantities: BTreeMap::new() }
    }
}

/// A stated prior.
#[derive(Debug, Clone, Copy, PartialEq, Deserialize)]
#[serde(untagged, expecting = "a prior is { value = …, std_dev = … } or \"none\"")]
pub enum StatedPrior {
    /// Value and σ, in the unit of the parameter in `camera.json` (mm, rad, px).
    Known(Estimate),
    /// No prior, not even the default one.
    Nothing(NoPrior),
}

/// The word `none`.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum NoPrior {
    /// No prior.
    None,
}

impl Priors {
    /// States the value of a quantity.
    pub fn state(&mut self, quantity: &str, value: f64, std_dev: f64) {
        let known = StatedPrior::Known(Estimate { value, std_dev });
        self.quantities.insert(quantity.to_owned(), known);
    }

    /// Removes the default prior of a quantity.
    pub fn remove(&mut self, quantity: &str) {
        self.quantities.insert(quantity.to_owned(), StatedPrior::Nothing(NoPrior::None));
    }

    /// Parses priors as they are written on the command line: `F=50:0.5` is 50 ± 0.5, `F=50:1%` has a relative σ, and
    /// `F=none` removes a default prior.
    ///
    /// Returns an error if a text is none of these, or if two texts name one quantity.
    pub fn state_all(&mut self, texts: &[String]) -> Result<()> {
        let mut named = Vec::new();
        for text in texts {
            let Some((quantity, prior)) = parsed(text) else {
                return Err(Error::invalid(format!(
                    "'{text}' is not a prior: write NAME=VALUE:SIGMA as in F=50:0.5 or F=50:1%, or \
                     NAME=none for no prior"
                )));
            };
            if named.contains(&quantity) {
                return Err(Error::invalid(format!(
                    "'{text}' is a second prior on the same quantity: remove one of them"
                )));
            }
            self.quantities.insert(quantity.clone(), prior);
            named.push(quantity);
        }
        Ok(())
    }

    /// Returns the stated values.
    #[must_use]
    pub fn stated(&self) -> Vec<Prior> {
        let known = |(quantity, stated): (&String, &StatedPrior)| match *stated {
            StatedPrior::Known(Estimate { value, std_dev }) => {
                Some(Prior { quantity: quantity.clone(), value, std_dev })
            }
            StatedPrior::Nothing(NoPrior::None) => None,
        };
        self.quantities.iter().filter_map(known).collect()
    }

    /// Returns true if a value is stated for a quantity.
    pub(super) fn knows(&self, quantity: &str) -> bool {
        matches!(self.quantities.get(quantity), Some(StatedPrior::Known(_)))
    }

    /// Returns true if a quantity has its default prior.
    pub(super) fn is_default(&self, quantity: &str) -> bool {
        self.default && !self.quantities.contains_key(quantity)
    }
}

/// Parses quantity and prior of a text such as `F=50:1%`. Returns `None` if it is not one.
fn parsed(text: &str) -> Option<(String, StatedPrior)> {
    let (quantity, known) = text.split_once('=')?;
    let prior = match known.trim() {
        "none" => StatedPrior::Nothing(NoPrior::None),
        known => {
            let (value, std_dev) = known.split_once(':')?;
            let value: f64 = value.trim().parse().ok()?;
            let std_dev = match std_dev.trim().strip_suffix('%') {
                Some(percent) => value.abs() * percent.trim().parse::<f64>().ok()? / 100.0,
                None => std_dev.trim().parse().ok()?,
            };
            StatedPrior::Known(Estimate { value, std_dev })
        }
    };
    Some((quantity.trim().to_owned(), prior))
}

/// Options of a calibration. Their docs are the help of the command line.
// Parameter names in the help are not code.
#[allow(clippy::doc_markdown)]
#[derive(Debug, Clone, PartialEq, Deserialize, Args)]
#[serde(default, deny_unknown_fields)]
pub struct CalibrationOptions {
    /// Frames to leave out, e.g. 3,7 or 0-4,7.
    #[arg(long = "exclude", alias = "exclude-frames", value_name = "LIST", value_parser = frame_list)]
    // The full path of the type makes clap take the list as one value of the flag.
    pub exclude_frames: ::std::vec::Vec<u32>,
    /// Quantities to estimate [default: full].
    #[arg(long)]
    pub mode: Mode,
    /// One micro-lens pitch, or one along x and one along y [default: one].
    #[arg(long)]
    pub pitches: Pitches,
    /// Position of the exit pupil on the axis of the main lens: estimated; at-lens, without aberration (the paper); or
    /// fixed at a distance from the lens in mm, negative towards the array [default: estimated].
    #[arg(long, value_name = "PLACE")]
    pub exit_pupil: ExitPupil,
    /// Radial distortion over distance [default: estimated].
    #[arg(long)]
    pub distortion: Distortion,
    /// Tilt of the optical axis against the normal of the sensor [default: estimated].
    #[arg(long)]
    pub lens_tilt: LensTilt,
    /// Curvature of the images of a plane [default: estimated].
    #[arg(long)]
    pub field_curvature: FieldCurvature,
    /// Shape of the board [default: auto].
    #[arg(long)]
    pub board: BoardModel,
    /// Parameters that keep their initial value, e.g. F,Q3. The parameters are F, Q1 to Q3, Q1_m, P1, P2, kappa, kappa_m,
    /// omega_x, omega_y, e_z, e_r, u0, v0, d, theta_x to theta_z, t_x, t_y, D, dC, f_1 to f_3, and of the board sag_x, sag_y,
    /// twist, aspect. (e_x and e_y are 0 unless they have a prior, and dC_ratio is fixed unless --pitches two.)
    #[arg(long, value_name = "LIST", value_delimiter = ',')]
    pub fix: Vec<Parameter>,
    /// Prior knowledge: `[calibration.priors]`, --priors and --prior.
    #[arg(skip)]
    pub priors: Priors,
    /// Weight of the priors against observations, whose errors are not independent: a factor on the squared residuals
    /// of the priors [default: measured, see calibration.json].
    #[arg(long, alias = "anchor-weight", value_name = "W")]
    pub prior_weight: Option<f64>,
    /// Weights of observations [default: own].
    #[arg(long)]
    pub weights: Weights,
    /// Source of the focal lengths of the micro-lenses [default: white-images].
    #[arg(long)]
    pub blur: Blur,
    /// Standard deviation of u and v of a feature, px [default: 1]. If the file states one for each feature, this value
    /// multiplies it; so do the next two options.
    #[arg(long = "uv-std-dev", value_name = "PX")]
    pub uv_std_dev_px: f64,
    /// Standard deviation of rho, px [default: 1].
    #[arg(long = "rho-std-dev", value_name = "PX")]
    pub rho_std_dev_px: f64,
    /// Standard deviation of u and v of a micro-image centre, px [default: 1].
    #[arg(long = "centers-std-dev", value_name = "PX")]
    pub centers_std_dev_px: f64,
    /// Robust loss on the norm of every observation's residual [default: huber with a scale of 4 if every feature has a
    /// standard deviation of its own; otherwise none or, with outliers, huber].
    #[arg(long)]
    pub loss: Option<LossKind>,
    /// Residual beyond which the loss acts, in standard deviations [default: 1].
    #[arg(long, value_name = "N")]
    pub loss_scale: Option<f64>,
    /// Maximum number of iterations [default: 200].
    #[arg(long, value_name = "N")]
    pub max_iterations: usize,
    /// Threads of the solver; any number gives the same results to the last bit [default: all cores].
    #[arg(long, value_name = "N")]
    pub threads: usize,
    /// True if the solver jumps to the extrapolated limit of its steps when they converge slowly; if false, Ceres does
    /// all the work.
    #[arg(skip)]
    pub extrapolate: bool,
    /// Initial poses of boards; the poses of other frames are found.
    #[arg(skip)]
    #[serde(skip)]
    pub poses: Vec<FramePose>,
}

impl Default for CalibrationOptions {
    fn default() -> Self {
        let (cost, solver) = (CostOptions::default(), SolverOptions::default());
        Self {
            exclude_frames: Vec::new(),
            mode: Mode::default(),
            pitches: Pitches::default(),
            exit_pupil: ExitPupil::default(),
            distortion: Distortion::default(),
            lens_tilt: LensTilt::default(),
            field_curvature: FieldCurvature::default(),
            board: BoardModel::default(),
            fix: Vec::new(),
            priors: Priors::default(),
            prior_weight: None,
            weights: Weights::default(),
            blur: Blur::default(),
            uv_std_dev_px: cost.uv_std_dev_px,
            rho_std_dev_px: cost.rho_std_dev_px,
            centers_std_dev_px: cost.centers_std_dev_px,
            loss: None,
            loss_scale: None,
            max_iterations: solver.max_iterations,
            threads: solver.threads,
            extrapolate: solver.extrapolate,
            poses: Vec::new(),
        }
    }
}

/// Parameters of effects that move features and centres by a few tenths of a pixel. Errors of other origin would act on them.
pub(super) const SMALL_TERMS: [Parameter; 2] =
    [Parameter::Radial1Growth, Parameter::PupilAberration];
/// Tilt of the main lens.
pub(super) const LENS_TILT: [Parameter; 2] = [Parameter::LensRotationX, Parameter::LensRotationY];

/// Method of the paper, as `[calibration]` of a project file would state it.
const PAPER: &str = "
exit_pupil = \"at-lens\"
distortion = \"constant\"
lens_tilt = \"none\"
field_curvature = \"flat\"
board = \"flat\"
blur = \"features\"
weights = \"unit\"
loss = \"none\"
priors.default = false
";

impl CalibrationOptions {
    /// Returns the options for the calibration of the paper: every observation has the same weight, no loss, no priors,
    /// the exit pupil in the lens, constant distortion, a lens without tilt, a flat field, f from ρ, a flat board.
    // The text is constant.
    #[allow(clippy::missing_panics_doc)]
    #[must_use]
    pub fn paper() -> Self {
        toml::from_str(PAPER).expect("the method of the paper consists of options")
    }

    /// Reads `[calibration]` of a project file: the options of its `method`, overridden by those beside it.
    ///
    /// Returns an error that names the option if one is unknown or has an impossible value.
    pub(crate) fn from_table(mut stated: Table) -> Result<Self> {
        for (earlier, name) in [("anchors", "priors"), ("anchor_weight", "prior_weight")] {
            rename(&mut stated, earlier, name);
        }
        if let Some(toml::Value::Table(priors)) = stated.get_mut("priors") {
            for (earlier, name) in [("lean_u", "tilt_u"), ("lean_v", "tilt_v")] {
                rename(priors, earlier, name);
            }
        }
        let method = stated.remove("method").map(Method::deserialize).transpose();
        let method = method.map_err(|e| Error::invalid(format!("method: {}", e.message())))?;
        let mut options = match method.unwrap_or_default() {
            Method::Full => Table::new(),
            Method::Paper => PAPER.parse().expect("the method of the paper is TOML"),
        };
        merge(&mut options, stated);
        serde_path_to_error::deserialize(options).map_err(|e| {
            let mut message = e.inner().message().to_owned();
            if message.starts_with("unknown field") {
                // The method is not a field, but may stand among the fields.
                message = message.replacen("one of ", "one of `method`, ", 1);
            }
            Error::invalid(format!("{}: {message}", e.path()))
        })
    }

    /// Returns an error that names an impossible number.
    pub(crate) fn check_numbers(&self) -> Result<()> {
        for (std_dev, name) in [
            (self.uv_std_dev_px, "(u, v) (uv_std_dev_px)"),
            (self.rho_std_dev_px, "rho (rho_std_dev_px)"),
            (self.centers_std_dev_px, "the centres (centers_std_dev_px)"),
        ] {
            positive(std_dev, &format!("the standard deviation of {name}"))?;
            if std_dev < LEAST_STD_DEV_PX {
                return Err(Error::invalid(format!(
                    "the standard deviation of {name} is {std_dev} px, but has to be at least \
                     {LEAST_STD_DEV_PX} px: state the noise of your observations, or leave it out"
                )));
            }
        }
        positive(self.loss_scale.unwrap_or(1.0), "the scale of the loss (loss_scale)")?;
        positive(self.prior_weight.unwrap_or(1.0), "the weight of the priors (prior_weight)")?;
        if self.max_iterations == 0 {
            return Err(Error::invalid("max_iterations is 0, but has to be at least 1"));
        }
        if self.threads == 0 {
            return Err(Error::invalid("threads is 0, but has to be at least 1"));
        }
        Ok(())
    }

    /// Returns the cost without default priors.
    pub(super) fn cost(&self) -> CostOptions {
        CostOptions {
            uv_std_dev_px: self.uv_std_dev_px,
            rho_std_dev_px: self.rho_std_dev_px,
            centers_std_dev_px: self.centers_std_dev_px,
            rho: self.has_rho(),
            loss: Loss {
                kind: self.loss.unwrap_or(LossKind::None),
                scale: self.loss_scale.unwrap_or(1.0),
            },
            fixed: names(&self.fixed()),
            priors: self.priors.stated(),
            ..CostOptions::default()
        }
    }

    /// Returns true if the ρ of features is in the cost.
    #[must_use]
    pub fn has_rho(&self) -> bool {
        self.blur == Blur::Features
    }

    /// Returns the parameters of camera and board that keep their value.
    pub(super) fn fixed(&self) -> Vec<Parameter> {
        let implied = [
            (Parameter::PitchRatio, self.pitches == Pitches::One),
            (Parameter::PupilZ, matches!(self.exit_pupil, ExitPupil::At(_))),
            (Parameter::PupilAberration, self.exit_pupil == ExitPupil::AT_LENS),
            (Parameter::Radial1Growth, self.distortion == Distortion::Constant),
            (Parameter::LensRotationX, self.lens_tilt == LensTilt::None),
            (Parameter::LensRotationY, self.lens_tilt == LensTilt::None),
            (Parameter::FieldCurvature, self.field_curvature == FieldCurvature::Flat),
            (Parameter::FieldCurvatureGrowth, self.field_curvature != FieldCurvature::Estimated),
            // Images alone hardly determine these, so they are free only if they have a prior.
            (Parameter::PupilX, !self.priors.knows("e_x")),
            (Parameter::PupilY, !self.priors.knows("e_y")),
        ];
        let implied = implied.into_iter().filter(|(_, fixed)| *fixed);
        implied.map(|(parameter, _)| parameter).chain(self.fix.iter().copied()).collect()
    }

    /// Returns these options for a start. If white images show that the main lens vignettes, the centroid of a micro-image is not
    /// the image of the pupil's centre, and small terms without a stated prior keep their value.
    pub(super) fn of_start(&self, start: &Start) -> Self {
        let mut options = self.clone();
        if start.internal().is_some_and(|internal| vignettes(internal.vignetting)) {
            let is_held =
                |term: &&Parameter| !self.priors.knows(term.name()) && !self.fix.contains(term);
            options.fix.extend(SMALL_TERMS.iter().filter(is_held));
        }
        options
    }

    /// Returns e_z if it is stated, mm.
    pub(super) fn exit_pupil_mm(&self) -> Option<f64> {
        match self.exit_pupil {
            ExitPupil::At(place) => Some(place),
            ExitPupil::Estimated => None,
        }
    }

    /// Returns the options of the solver.
    pub(super) fn solver(&self) -> SolverOptions {
        SolverOptions {
            max_iterations: self.max_iterations,
            threads: self.threads,
            extrapolate: self.extrapolate,
            ..SolverOptions::default()
        }
    }

    /// Returns these options for a calibration from corners only, without the options for the focal lengths of
    /// micro-lenses.
    #[must_use]
    pub fn of_corners_only(&self) -> Self {
        let mut options = Self { mode: Mode::CornersOnly, ..self.clone() };
        options.fix.retain(|parameter| !parameter.is_of_micro_lenses());
        let is_of_micro_lenses =
            |name: &String| name.parse().is_ok_and(Parameter::is_of_micro_lenses);
        options.priors.quantities.retain(|name, _| !is_of_micro_lenses(name));
        options
    }

    /// Returns these options for the poses alone, with a board of this shape. Options of camera and board are left out,
    /// since both are then fixed.
    #[must_use]
    pub fn of_poses_only(&self, shape: BoardShape) -> Self {
        Self {
            mode: Mode::PosesOnly,
            board: BoardModel::Known(shape),
            exit_pupil: ExitPupil::Estimated,
            field_curvature: FieldCurvature::Estimated,
            distortion: Distortion::Estimated,
            lens_tilt: LensTilt::Estimated,
            priors: Priors { default: self.priors.default, ..Priors::default() },
            ..self.clone()
        }
    }

    /// Returns these options with the decision of a calibration whether the board is flat, if they leave it open. The
    /// board is then bent in the parameters of its shape that have a σ, or flat.
    #[must_use]
    pub fn with_decision(&self, shape_std_devs: [Option<f64>; SHAPE]) -> Self {
        let mut decided = self.clone();
        if self.board != BoardModel::Auto {
            return decided;
        }
        let kept = Parameter::SHAPE.into_iter().zip(shape_std_devs);
        let kept: Vec<Parameter> =
            kept.filter(|(_, std_dev)| std_dev.is_none()).map(|(p, _)| p).collect();
        decided.board = if kept.len() == SHAPE { BoardModel::Flat } else { BoardModel::Bent };
        if decided.board == BoardModel::Bent {
            let new = kept.into_iter().filter(|parameter| !self.fix.contains(parameter));
            decided.fix.extend(new);
        }
        decided
    }

    /// Returns the initial or fixed shape of the board.
    pub(super) fn known_shape(&self) -> BoardShape {
        match self.board {
            BoardModel::Known(shape) => shape,
            BoardModel::Auto | BoardModel::Flat | BoardModel::Bent => BoardShape::default(),
        }
    }

    /// Returns true if the board keeps a parameter of its shape.
    pub(super) fn keeps(&self, quantity: &str) -> bool {
        let known = matches!(self.board, BoardModel::Flat | BoardModel::Known(_));
        known && Parameter::SHAPE.iter().any(|parameter| parameter.name() == quantity)
    }

    /// Returns an error that names an impossible option, or one that does not fit this start.
    pub(super) fn validate(&self, start: &Start) -> Result<()> {
        if self.mode == Mode::PosesOnly && matches!(start, Start::Datasheet(..)) {
            return Err(Error::NotCalibrated);
        }
        let stated = self.exit_pupil != ExitPupil::Estimated
            || self.distortion != Distortion::Estimated
            || self.lens_tilt != LensTilt::Estimated
            || self.field_curvature != FieldCurvature::Estimated;
        if self.mode == Mode::PosesOnly && stated {
            return Err(Error::invalid(
                "the camera is fixed if only poses are estimated: leave out its exit pupil, distortion, \
                 tilt and field curvature (exit_pupil, distortion, lens_tilt, field_curvature)",
            ));
        }
        if self.mode == Mode::PosesOnly && self.board == BoardModel::Bent {
            return Err(Error::invalid(
                "the shape of a bent board (board = \"bent\") is only estimated together with a \
                 camera: give the shape from that calibration",
            ));
        }
        let is_fixed = |parameter: &Parameter| self.fix.contains(parameter);
        if self.board == BoardModel::Bent && Parameter::SHAPE.iter().all(is_fixed) {
            return Err(Error::invalid(format!(
                "the shape of a bent board (board = \"bent\") is to be estimated, but {} are \
                 fixed: free one of them, or set board = \"flat\"",
                Parameter::SHAPE.map(Parameter::name).join(", ")
            )));
        }
        self.check_numbers()?;
        if self.mode == Mode::Full && !self.has_rho() && (self.rho_std_dev_px - 1.0).abs() > 0.0 {
            return Err(Error::invalid(
                "a standard deviation of rho is given, but rho is not used: use it (blur = \
                 \"features\"), or leave the standard deviation out",
            ));
        }
        if self.loss_scale.is_some() && matches!(self.loss, None | Some(LossKind::None)) {
            return Err(Error::invalid(
                "a loss scale is given without a loss: add loss = \"huber\" or \"cauchy\"",
            ));
        }
        let known = Parameter::shared(start.lens_types());
        if let Some(parameter) = self.fix.iter().find(|parameter| !known.contains(parameter)) {
            return Err(Error::invalid(format!(
                "the parameter '{parameter}' does not exist and cannot be fixed; this camera has \
                 {}",
                names(&known).join(", ")
            )));
        }
        Ok(())
    }
}

/// Parses frames from the command line: numbers and ranges of them, separated by commas.
pub fn frame_list(text: &str) -> std::result::Result<Vec<u32>, String> {
    const MOST: u32 = 100_000;
    let wrong = || {
        format!("'{text}' is not a list of frames: write numbers and ranges, such as 3,7 or 0-4,7")
    };
    let mut frames = Vec::new();
    for part in text.split(',').map(str::trim) {
        let (first, last) = part.split_once('-').unwrap_or((part, part));
        let number = |text: &str| text.trim().parse::<u32>().map_err(|_| wrong());
        let (first, last) = (number(first)?, number(last)?);
        if first > last || last - first > MOST {
            return Err(wrong());
        }
        frames.extend(first..=last);
    }
    Ok(frames)
}

/// Smallest standard deviation of a position, px. Nobody measures better, and squared weights would overflow.
const LEAST_STD_DEV_PX: f64 = 1e-6;

/// Renames a key of a table.
fn rename(table: &mut Table, earlier: &str, name: &str) {
    if let Some(value) = table.remove(earlier) {
        table.entry(name).or_insert(value);
    }
}

#[cfg(test)]
mod tests {
    use toml::Value;

    use super::*;
    use crate::detection::DepthEstimator;
    use crate::image::Color;
    use crate::model::Subset;
    use crate::precalibration::RadiusEstimator;

    fn of(text: &str) -> CalibrationOptions {
        CalibrationOptions::from_table(text.parse().unwrap()).unwrap()
    }

    #[test]
    fn options_beside_a_method_take_precedence() {
        assert_eq!(of(""), CalibrationOptions::default());
        assert_eq!(of("method = \"paper\""), CalibrationOptions::paper());
        let mixed =
            of("method = \"paper\"\nloss = \"huber\"\npriors.F = { value = 50, std_dev = 1 }");
        assert_eq!(mixed.loss, Some(LossKind::Huber));
        assert!(mixed.priors.knows("F") && !mixed.priors.default);
        assert_eq!(mixed.board, BoardModel::Flat);
        let earlier = of(
            "method = \"paper\"\nanchor_weight = 2\nanchors.lean_u = { value = 0, std_dev = 1 }",
        );
        assert_eq!(earlier.prior_weight, Some(2.0));
        assert!(earlier.priors.knows("tilt_u") && !earlier.priors.default);
    }

    #[test]
    fn errors_name_the_option() {
        for (text, words) in [
            ("method = \"other\"", "method: unknown variant `other`"),
            ("methd = \"paper\"", "unknown field `methd`, expected one of `method`, `exclude"),
            ("loss = \"hubr\"", "loss: 'hubr' is not a loss"),
            ("mode = \"x\"", "mode: unknown variant `x`, expected one of `full`"),
            ("max_iterations = -1", "max_iterations: "),
            ("priors.F = 3", "priors"),
        ] {
            let error = CalibrationOptions::from_table(text.parse().unwrap()).unwrap_err();
            assert!(error.to_string().contains(words), "{error}");
        }
    }

    #[test]
    fn priors_are_read_as_they_are_written_on_the_command_line() {
        let mut priors = Priors::default();
        let texts = ["F=50:1%", "u0=none", "d = 1:0.1"].map(str::to_owned);
        priors.state_all(&texts).unwrap();
        let found: Vec<(String, f64, f64)> =
            priors.stated().into_iter().map(|a| (a.quantity, a.value, a.std_dev)).collect();
        assert_eq!(found, [("F".to_owned(), 50.0, 0.5), ("d".to_owned(), 1.0, 0.1)]);
        assert!(!priors.is_default("u0") && priors.is_default("v0"));
        for wrong in ["F", "F=50", "F=50:x"] {
            assert!(priors.state_all(&[wrong.to_owned()]).is_err(), "{wrong}");
        }
        assert!(priors.state_all(&["F=1:1".to_owned(), "F=2:1".to_owned()]).is_err());
    }

    fn is_read<T: ValueEnum + for<'a> Deserialize<'a> + PartialEq>() {
        for value in T::value_variants() {
            let name = value.to_possible_value().expect("it is not skipped").get_name().to_owned();
            let read: T = Value::String(name.clone()).try_into().expect("it is a name");
            assert!(read == *value, "{name}");
        }
    }

    #[test]
    fn choices_have_one_name_in_files_and_on_the_command_line() {
        is_read::<Method>();
        is_read::<Mode>();
        is_read::<BoardModel>();
        is_read::<Weights>();
        is_read::<Pitches>();
        is_read::<FieldCurvature>();
        is_read::<Blur>();
        is_read::<LossKind>();
        is_read::<Subset>();
        is_read::<DepthEstimator>();
        is_read::<RadiusEstimator>();
        is_read::<Color>();
    }
}
