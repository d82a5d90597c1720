//! A simulated camera as its user has it: images, and what the stages find in them, as `plenocal run` does it.

use plenocal::assessment::{
    Candidate, Evaluation, EvaluationInput, Folds, ParameterError, PosePairs, evaluate,
    parameter_errors,
};
use plenocal::calibration::{Calibration, CalibrationOptions, Start, calibrate};
use plenocal::detection::{
    BoardImage, DepthEstimator, DetectedBoards, MicroImages, Search, detect,
};
use plenocal::model::{
    BapFeature, Board, BoardShape, Datasheet, FramePose, InternalParameters, Observations, Opening,
    Subset,
};
use plenocal::precalibration::{Precalibration, PrecalibrationOptions, White, precalibrate};
use plenocal::simulation::{DataSet, Settings, Shot};
use plenocal::{Error, Estimate, Result};

/// White images of a camera, with their pre-calibration. Images of boards are taken when they are searched: all of them would
/// take a gigabyte.
pub struct Shoot {
    pub settings: Settings,
    pub sheet: Datasheet,
    pub board: Board,
    pub measured: Precalibration,
    data_set: DataSet,
    reference: White,
}

/// Takes a white image.
fn white(settings: &Settings, name: String, shot: &Shot) -> Result<White> {
    Ok(White { name, f_number: shot.stated_f_number, image: shot.take(settings, &|| ())? })
}

impl Shoot {
    /// Takes the white images, and measures them.
    pub fn of(settings: Settings) -> Result<Self> {
        Self::stated(settings, None)
    }

    /// Takes the white images, and measures them with this shape of the openings, if it is stated.
    pub fn stated(settings: Settings, opening: Option<Opening>) -> Result<Self> {
        let data_set = DataSet::plan(&settings, None)?;
        let numbered = data_set.whites.iter().enumerate();
        let whites = numbered
            .map(|(i, shot)| white(&settings, format!("white {i}"), shot))
            .collect::<Result<Vec<White>>>()?;
        let reference = white(&settings, "devignetting".to_owned(), &data_set.devignetting)?;
        let sheet = Datasheet { opening, ..settings.datasheet() };
        let board = settings.target.board();
        let options = PrecalibrationOptions::of_datasheet(&sheet);
        let measured = precalibrate(&whites, Some(&reference), &options, &|| ())?;
        Ok(Self { settings, sheet, board, measured, data_set, reference })
    }

    /// Returns the true internal parameters.
    pub fn truth(&self) -> Result<InternalParameters> {
        Ok(self.settings.tracer(self.settings.board_f_number())?.internal_parameters())
    }

    /// Returns |m| of the white images.
    pub fn m_mm(&self) -> Estimate {
        let found = &self.measured.internal.parameters;
        Estimate::new(found.m_mm, found.m_std_dev_mm.unwrap_or(f64::NAN))
    }

    /// Returns q'ᵢ of the white images.
    pub fn q_prime_mm(&self) -> Vec<Estimate> {
        let found = &self.measured.internal.parameters;
        let values = found.q_prime_mm.iter().zip(&found.q_prime_std_dev_mm);
        values.map(|(value, std_dev)| Estimate::new(*value, *std_dev)).collect()
    }

    /// Searches the boards of a subset.
    fn search(&self, subset: Subset, micro_images: &MicroImages) -> Result<DetectedBoards> {
        let search = Search {
            micro_images,
            board: &self.board,
            sensor: &self.sheet.sensor,
            estimator: DepthEstimator::Line,
        };
        let image = |(pose, shot): &(FramePose, Shot)| {
            let (frame, shot, settings) = (pose.frame, *shot, &self.settings);
            BoardImage::read_by(frame, format!("frame {frame}"), move || {
                shot.take(settings, &|| ())
            })
        };
        let images: Vec<BoardImage> = self.poses(subset).iter().map(image).collect();
        detect(&images, &self.reference.image, &search, subset, &|_, _| Ok(()))
    }

    /// Finds the boards of the calibration.
    pub fn boards(&self) -> Result<DetectedBoards> {
        let micro_images = MicroImages::of_precalibration(&self.measured, &self.sheet)?;
        self.search(Subset::Calibration, &micro_images)
    }

    /// Finds other boards, with the aperture ratio and the aberrations that the boards of the calibration show.
    pub fn other_boards(&self, subset: Subset, found: &DetectedBoards) -> Result<Vec<BapFeature>> {
        let micro_images = MicroImages::of_precalibration(&self.measured, &self.sheet)?;
        Ok(self.search(subset, &found.known_in(&micro_images))?.features())
    }

    fn poses(&self, subset: Subset) -> &[(FramePose, Shot)] {
        &self.data_set.subsets[subset as usize]
    }

    /// Returns the true poses of the boards of a subset.
    pub fn true_poses(&self, subset: Subset) -> Vec<FramePose> {
        self.poses(subset).iter().map(|(pose, _)| *pose).collect()
    }
}

/// Camera calibrated from simulated images.
pub struct Calibrated {
    pub shoot: Shoot,
    pub boards: DetectedBoards,
    pub start: Start,
    pub observations: Observations,
    pub calibration: Calibration,
}

impl Calibrated {
    /// Takes the images of a camera, and calibrates it.
    pub fn of(settings: Settings, options: &CalibrationOptions) -> Result<Self> {
        Self::of_shoot(Shoot::of(settings)?, options)
    }

    /// Calibrates the camera of white images.
    pub fn of_shoot(shoot: Shoot, options: &CalibrationOptions) -> Result<Self> {
        let not_converged = || Error::invalid("the calibration has not converged");
        Self::of_shoot_if_converged(shoot, options)?.ok_or_else(not_converged)
    }

    /// Takes the images of a camera, and calibrates it; `None` if the calibration does not converge.
    pub fn if_converged(settings: Settings, options: &CalibrationOptions) -> Result<Option<Self>> {
        Self::of_shoot_if_converged(Shoot::of(settings)?, options)
    }

    fn of_shoot_if_converged(shoot: Shoot, options: &CalibrationOptions) -> Result<Option<Self>> {
        let boards = shoot.boards()?;
        let lattice = &shoot.measured.array.grid.lattice;
        let sheet = Datasheet { array_size: Some((lattice.columns, lattice.rows)), ..shoot.sheet };
        let start = Start::Datasheet(sheet, shoot.measured.internal.parameters.clone());
        let centers = shoot.measured.array.centers.clone();
        let observations = boards.observations(centers);
        let calibration = calibrate(&start, &shoot.board, &observations, options, &mut |_| true)?;
        let converged = calibration.converged;
        Ok(converged.then_some(Self { shoot, boards, start, observations, calibration }))
    }

    /// Calibrates from the same observations with other options.
    pub fn again(&self, options: &CalibrationOptions) -> Result<Calibration> {
        calibrate(&self.start, &self.shoot.board, &self.observations, options, &mut |_| true)
    }

    /// Returns the errors of the parameters of a calibration.
    pub fn errors(&self, calibration: &Calibration) -> Result<Vec<ParameterError>> {
        let std_devs = calibration.uncertainty.intrinsic_std_devs(calibration.camera.lens_types());
        parameter_errors(&self.shoot.settings.true_camera()?, &calibration.camera, &std_devs)
    }

    /// Evaluates calibrations on the other boards. The cross-validation has so many folds, if there are any.
    pub fn evaluation(&self, calibrations: &[&Calibration], folds: usize) -> Result<Evaluation> {
        let shoot = &self.shoot;
        let of = |subset: Subset| shoot.other_boards(subset, &self.boards);
        let candidates: Vec<Candidate> = calibrations.iter().map(|c| candidate(c)).collect();
        let mut input = EvaluationInput::new(shoot.board);
        input.evaluation = of(Subset::Evaluation)?;
        let step_mm = shoot.settings.translation.step_mm;
        input.translation = Some((of(Subset::Translation)?, step_mm));
        input.truth = Some(shoot.settings.true_camera()?);
        input.true_board = Some(BoardShape::default());
        input.evaluation_poses = Some(shoot.true_poses(Subset::Evaluation));
        input.poses.push(PosePairs {
            name: Subset::Calibration.name().to_owned(),
            truth: shoot.true_poses(Subset::Calibration),
            found: calibrations[0].poses.clone(),
        });
        let options = calibrations[0].options.with_decision(candidates[0].shape_std_devs);
        input.folds = (folds > 1).then(|| Folds {
            start: self.start.clone(),
            observations: self.observations.clone(),
            options,
            count: folds,
        });
        Ok(evaluate(&candidates, &input, &|| ()))
    }
}

fn candidate(calibration: &Calibration) -> Candidate {
    Candidate {
        name: String::new(),
        std_devs: calibration.uncertainty.intrinsic_std_devs(calibration.camera.lens_types()),
        board_shape: calibration.board.bent.shape,
        shape_std_devs: calibration.board.std_devs,
        camera: calibration.camera.clone(),
    }
}

/// Returns the error of a parameter.
///
/// # Panics
/// If the camera has no such parameter.
pub fn error_of<'a>(errors: &'a [ParameterError], name: &str) -> &'a ParameterError {
    errors.iter().find(|error| error.name == name).expect("cameras have the parameter")
}

/// Returns a parameter as an estimate; σ is not a number if it is not known.
pub fn estimate_of(error: &ParameterError) -> Estimate {
    Estimate::new(error.estimate, error.std_dev.unwrap_or(f64::NAN))
}
