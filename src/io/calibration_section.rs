//! `[calibration]` of a project file, and the same from the command line.

use std::collections::BTreeMap;
use std::str::FromStr;

use serde::Deserialize;

use crate::calibration::{BoardModel, CalibrationOptions, Mode, Weights};
use crate::error::{Error, Result};
use crate::solver::{Anchor, Loss, LossKind};

/// `[calibration.anchors]`: quantities with what is known of them.
#[derive(Debug, Clone, PartialEq, Default, Deserialize)]
pub struct AnchorsSection {
    /// Whether there are the default anchors too.
    pub default: Option<bool>,
    /// By quantity: an intrinsic parameter, or `m`.
    #[serde(flatten)]
    pub quantities: BTreeMap<String, AnchorEntry>,
}

/// What is known of a quantity.
#[derive(Debug, Clone, Copy, PartialEq, Deserialize)]
#[serde(untagged, expecting = "an anchor is { value = …, std_dev = … } or \"none\"")]
pub enum AnchorEntry {
    /// A value.
    Known(AnchorValue),
    /// Nothing: no default anchor either.
    Nothing(NoAnchor),
}

/// A value with its σ, in the unit of the parameter in `camera.json` (mm, rad, px).
#[derive(Debug, Clone, Copy, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct AnchorValue {
    /// The value.
    pub value: f64,
    /// Its σ.
    pub std_dev: f64,
}

/// The word `none`.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum NoAnchor {
    /// No anchor.
    None,
}

impl AnchorsSection {
    /// These anchors, and of other quantities those of `other`; without default anchors, these alone.
    fn or(mut self, other: Self) -> Self {
        if self.default == Some(false) {
            return self;
        }
        self.default = self.default.or(other.default);
        for (quantity, entry) in other.quantities {
            self.quantities.entry(quantity).or_insert(entry);
        }
        self
    }

    /// Adds an anchor as it is written on the command line: `F=50:0.5` is 50 ± 0.5, `F=50:1%` has a
    /// relative σ, and `F=none` is no anchor.
    pub fn add_text(&mut self, text: &str) -> Result<()> {
        let entry = text.split_once('=').and_then(|(quantity, known)| {
            let entry = match known.trim() {
                "none" => AnchorEntry::Nothing(NoAnchor::None),
                known => {
                    let (value, std_dev) = known.split_once(':')?;
                    let value: f64 = value.trim().parse().ok()?;
                    let std_dev = match std_dev.trim().strip_suffix('%') {
                        Some(percent) => value.abs() * percent.trim().parse::<f64>().ok()? / 100.0,
                        None => std_dev.trim().parse().ok()?,
                    };
                    AnchorEntry::Known(AnchorValue { value, std_dev })
                }
            };
            Some((quantity.trim().to_owned(), entry))
        });
        let Some((quantity, entry)) = entry else {
            return Err(Error::invalid(format!(
                "'{text}' is not an anchor: write NAME=VALUE:SIGMA as in F=50:0.5 or F=50:1%, or \
                 NAME=none"
            )));
        };
        match self.quantities.insert(quantity, entry) {
            None => Ok(()),
            Some(_) => Err(Error::invalid(format!("'{text}' anchors a quantity a second time"))),
        }
    }

    /// Whether a value is stated for a quantity.
    fn knows(&self, quantity: &str) -> bool {
        matches!(self.quantities.get(quantity), Some(AnchorEntry::Known(_)))
    }

    fn add_to(&self, options: &mut CalibrationOptions) {
        options.default_anchors = self.default.unwrap_or(true);
        for (quantity, entry) in &self.quantities {
            match *entry {
                AnchorEntry::Known(AnchorValue { value, std_dev }) => {
                    options.cost.anchors.push(Anchor {
                        quantity: quantity.clone(),
                        value,
                        std_dev,
                    });
                }
                AnchorEntry::Nothing(NoAnchor::None) => options.not_anchored.push(quantity.clone()),
            }
        }
    }
}

/// One micro-lens pitch or one for each axis.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Pitches {
    /// One for both axes (the paper).
    One,
    /// One along x, one along y.
    Two,
}

/// Where the exit pupil of the main lens is: `estimated`, `at-lens`, or e_z in mm.
#[derive(Debug, Clone, Copy, PartialEq, Deserialize)]
#[serde(try_from = "ExitPupilText")]
pub enum ExitPupil {
    /// Estimated.
    Estimated,
    /// At this e_z, mm; at 0 in the paper.
    At(f64),
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
            "at-lens" => Ok(Self::At(0.0)),
            number => match number.parse() {
                Ok(place) if f64::is_finite(place) => Ok(Self::At(place)),
                _ => Err(Error::invalid(format!(
                    "'{text}' is no place for the exit pupil: write estimated, at-lens, or its \
                     distance from the lens in mm, negative towards the array"
                ))),
            },
        }
    }
}

/// Where the focal lengths of the micro-lenses come from.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Blur {
    /// From q'ᵢ of the white images.
    WhiteImages,
    /// From ρ of every feature: the paper.
    Features,
}

/// What the board is taken for.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum BoardChoice {
    /// Flat, unless the frames show that it is not.
    Auto,
    /// Flat: the paper.
    Flat,
    /// Bent and stretched, by what comes out.
    Bent,
}

impl From<BoardChoice> for BoardModel {
    fn from(choice: BoardChoice) -> Self {
        match choice {
            BoardChoice::Auto => Self::Auto,
            BoardChoice::Flat => Self::Flat,
            BoardChoice::Bent => Self::Bent,
        }
    }
}

/// The curvature of the field.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum FieldCurvature {
    /// Estimated.
    Estimated,
    /// Estimated, the same at all distances.
    Constant,
    /// None: the paper.
    Flat,
}

/// A set of options with one name; options that are given beside it take precedence.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Method {
    /// Everything that plenocal knows: weights, priors, a robust loss, and effects that the paper's camera lacks.
    Full,
    /// The method of the paper: unit weights, no loss, no priors, the exit pupil in the lens, a flat field, a flat
    /// board, focal lengths from ρ.
    Paper,
}

/// `[calibration]`: everything is optional; the command line takes precedence.
#[derive(Debug, Clone, PartialEq, Default, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct CalibrationSection {
    /// The set of options to begin with.
    pub method: Option<Method>,
    /// What is estimated.
    pub mode: Option<Mode>,
    /// One pitch or two.
    pub pitches: Option<Pitches>,
    /// Where the exit pupil is.
    pub exit_pupil: Option<ExitPupil>,
    /// The curvature of the field.
    pub field_curvature: Option<FieldCurvature>,
    /// What the board is taken for.
    pub board: Option<BoardChoice>,
    /// Where the focal lengths of the micro-lenses come from.
    pub blur: Option<Blur>,
    /// Parameters that keep their value.
    pub fix: Option<Vec<String>>,
    /// What is known beforehand.
    pub anchors: Option<AnchorsSection>,
    /// w of the anchors, measured if not given.
    pub anchor_weight: Option<f64>,
    /// Weights of observations.
    pub weights: Option<Weights>,
    /// Frames that are not used.
    pub exclude_frames: Option<Vec<u32>>,
    /// σ of u and v, px.
    pub uv_std_dev_px: Option<f64>,
    /// σ of ρ, px.
    pub rho_std_dev_px: Option<f64>,
    /// σ of the centres, px.
    pub centers_std_dev_px: Option<f64>,
    /// Robust loss; chosen by the observations if not given.
    pub loss: Option<LossKind>,
    /// Its scale, standard deviations.
    pub loss_scale: Option<f64>,
    /// Maximum number of iterations.
    pub max_iterations: Option<usize>,
    /// Threads.
    pub threads: Option<usize>,
}

impl CalibrationSection {
    /// These options; where they say nothing, those of `other`.
    #[must_use]
    pub fn or(self, other: Self) -> Self {
        Self {
            method: self.method.or(other.method),
            mode: self.mode.or(other.mode),
            pitches: self.pitches.or(other.pitches),
            exit_pupil: self.exit_pupil.or(other.exit_pupil),
            field_curvature: self.field_curvature.or(other.field_curvature),
            board: self.board.or(other.board),
            blur: self.blur.or(other.blur),
            fix: self.fix.or(other.fix),
            anchors: match (self.anchors, other.anchors) {
                (Some(own), Some(other)) => Some(own.or(other)),
                (own, other) => own.or(other),
            },
            anchor_weight: self.anchor_weight.or(other.anchor_weight),
            weights: self.weights.or(other.weights),
            exclude_frames: self.exclude_frames.or(other.exclude_frames),
            uv_std_dev_px: self.uv_std_dev_px.or(other.uv_std_dev_px),
            rho_std_dev_px: self.rho_std_dev_px.or(other.rho_std_dev_px),
            centers_std_dev_px: self.centers_std_dev_px.or(other.centers_std_dev_px),
            loss: self.loss.or(other.loss),
            loss_scale: self.loss_scale.or(other.loss_scale),
            max_iterations: self.max_iterations.or(other.max_iterations),
            threads: self.threads.or(other.threads),
        }
    }

    /// The options that make up a method.
    #[must_use]
    pub fn of_method(method: Method) -> Self {
        match method {
            Method::Full => Self::default(),
            Method::Paper => Self {
                exit_pupil: Some(ExitPupil::At(0.0)),
                field_curvature: Some(FieldCurvature::Flat),
                board: Some(BoardChoice::Flat),
                blur: Some(Blur::Features),
                anchors: Some(AnchorsSection { default: Some(false), quantities: BTreeMap::new() }),
                weights: Some(Weights::Unit),
                loss: Some(LossKind::None),
                ..Self::default()
            },
        }
    }

    /// The options of the calibration: those given, then those of the method, then the defaults.
    #[must_use]
    pub fn options(&self) -> CalibrationOptions {
        let of_method = Self::of_method(self.method.unwrap_or(Method::Full));
        self.clone().or(of_method).filled_in()
    }

    fn filled_in(&self) -> CalibrationOptions {
        let mode = self.mode.unwrap_or_default();
        let mut options = CalibrationOptions { mode, ..CalibrationOptions::default() };
        let fixed = &mut options.cost.fixed;
        if self.pitches == Some(Pitches::Two) {
            fixed.retain(|name| name != "dC_ratio");
        }
        if let Some(ExitPupil::At(place)) = self.exit_pupil {
            options.exit_pupil_mm = Some(place);
            fixed.push("e_z".to_owned());
        }
        if self.field_curvature == Some(FieldCurvature::Flat) {
            options.field_curvature_per_mm = Some(0.0);
            fixed.push("kappa".to_owned());
        }
        if self.field_curvature.is_some_and(|curvature| curvature != FieldCurvature::Estimated) {
            options.field_curvature_growth_per_mm = Some(0.0);
            fixed.push("kappa_m".to_owned());
        }
        // What is known of them makes them parameters: images alone hardly determine them.
        let anchored = |name: &str| self.anchors.as_ref().is_some_and(|a| a.knows(name));
        options.cost.fixed.retain(|name| !(["e_x", "e_y"].contains(&&**name) && anchored(name)));
        options.cost.fixed.extend(self.fix.iter().flatten().cloned());
        options.board = self.board.map_or(options.board, BoardModel::from);
        options.cost.rho = self.blur == Some(Blur::Features);
        options.weights = self.weights.unwrap_or_default();
        options.anchor_weight = self.anchor_weight;
        options.automatic_loss = self.loss.is_none();
        if let Some(anchors) = &self.anchors {
            anchors.add_to(&mut options);
        }
        let cost = &mut options.cost;
        for (value, target) in [
            (self.uv_std_dev_px, &mut cost.uv_std_dev_px),
            (self.rho_std_dev_px, &mut cost.rho_std_dev_px),
            (self.centers_std_dev_px, &mut cost.centers_std_dev_px),
        ] {
            *target = value.unwrap_or(*target);
        }
        cost.loss = Loss {
            kind: self.loss.unwrap_or(LossKind::None),
            scale: self.loss_scale.unwrap_or(1.0),
        };
        options.exclude_frames = self.exclude_frames.clone().unwrap_or_default();
        let solver = &mut options.solver;
        solver.max_iterations = self.max_iterations.unwrap_or(solver.max_iterations);
        solver.threads = self.threads.unwrap_or(solver.threads);
        options
    }
}
