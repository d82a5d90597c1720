//! The simulation as one stage: from settings to images, their truth, and observations drawn from it.

use super::data_set::{Content, DataSet, Shot};
use super::real_lens::LensFigures;
use super::settings::Settings;
use super::tracer::Tracer;
use super::truth::{TrueCenter, TrueFeature};
use crate::error::Result;
use crate::image::RawImage;
use crate::model::{
    EdgeSpread, FramePose, InternalParameters, MicroImageCenter, NoiseSource, Observations,
    PlenopticCamera,
};
use crate::quantity::Estimate;

/// Progress of a simulation.
pub trait Progress: Sync {
    /// Called at the start of every image.
    fn image(&self, content: Content);
    /// Called after every row of it.
    fn row(&self);
}

/// Ignores the progress.
impl Progress for () {
    fn image(&self, _: Content) {}
    fn row(&self) {}
}

/// The truth of a simulated data set.
///
/// q'ᵢ and ρ are those of micro-lenses whose openings are as wide as their pitch; with an aperture ratio below 1 micro-images
/// and blur are smaller.
#[derive(Debug, Clone, PartialEq)]
pub struct Truth {
    /// The camera. That of a real lens has F and the exit pupil for rays close to the axis, and neither
    /// distortion nor a curved field: no value of these is its true one.
    pub camera: PlenopticCamera,
    /// What a real lens comes to close to the axis.
    pub main_lens: Option<LensFigures>,
    /// m and q'ᵢ.
    pub internal: InternalParameters,
    /// Centres of all micro-images, dead micro-lenses included.
    pub centers: Vec<TrueCenter>,
    /// Features by subset, in the order of [`Subset::ALL`](crate::model::Subset::ALL).
    pub features: [Vec<TrueFeature>; 3],
}

/// A simulated data set without its images.
#[derive(Debug, Clone, PartialEq)]
pub struct Simulated {
    /// Which images it consists of, and where the boards are.
    pub data_set: DataSet,
    /// Its truth.
    pub truth: Truth,
    /// Centres, and the features of the calibration boards with at least half of their light visible, all
    /// with noise. No features if there are no calibration boards.
    pub observed: Observations,
}

/// Features with a smaller fraction of their light visible are not observed.
const OBSERVABLE: f64 = 0.5;

/// Plans a data set, computes its truth, takes its images one by one, and passes each to `receive`,
/// since all of them may not fit into memory together.
///
/// The calibration boards are at `poses` if given, else at random poses. The same settings
/// give the same data set. An error if the settings are impossible, or from `receive`.
pub fn simulate(
    settings: &Settings,
    poses: Option<Vec<FramePose>>,
    progress: &dyn Progress,
    receive: &mut dyn FnMut(Content, &Shot, RawImage) -> Result<()>,
) -> Result<Simulated> {
    let _span = tracing::info_span!("simulation").entered();
    let data_set = DataSet::plan(settings, poses)?;
    let tracer = settings.tracer(settings.board_f_number())?;
    let truth = truth(settings, &data_set, &tracer);
    let observed = observed(settings, &truth)?;
    for (content, shot) in data_set.contents() {
        progress.image(content);
        receive(content, shot, shot.take(settings, &|| progress.row())?)?;
    }
    Ok(Simulated { data_set, truth, observed })
}

fn truth(settings: &Settings, data_set: &DataSet, tracer: &Tracer) -> Truth {
    let [near, far] = settings.boards.depth_mm;
    let features = data_set.subsets.each_ref().map(|boards| {
        let of_board = |(pose, _): &(FramePose, Shot)| {
            tracer.features(pose.frame, &settings.target, &pose.camera_from_board)
        };
        boards.iter().flat_map(of_board).collect()
    });
    let internal = tracer.internal_parameters();
    // A pixel gives to two neighbours at a distance of 1 along each axis.
    let Settings { imperfections, imaging, .. } = settings;
    let variance_px2 = imperfections.point_spread_px.powi(2) + 2.0 * imaging.crosstalk;
    let edge_spread = EdgeSpread {
        aperture_ratio: internal.aperture_ratio,
        point_spread_px2: Some(Estimate::exact(variance_px2)),
    };
    Truth {
        camera: PlenopticCamera { edge_spread, ..settings.camera.clone() },
        main_lens: tracer.lens.figures(f64::midpoint(near, far)),
        internal,
        centers: tracer.centers(),
        features,
    }
}

fn observed(settings: &Settings, truth: &Truth) -> Result<Observations> {
    let mut source = NoiseSource::new(&settings.observation_noise, settings.seed)?;
    let [calibration, ..] = &truth.features;
    let visible = calibration.iter().filter(|f| f.visible >= OBSERVABLE);
    let features = visible.map(|f| source.feature(&f.feature)).collect();
    let alive = truth.centers.iter().filter(|c| c.alive).map(|c| source.center(&c.center));
    let in_image = |c: &MicroImageCenter| settings.camera.sensor.contains(c.u_px, c.v_px);
    Ok(Observations { centers: alive.filter(in_image).collect(), features })
}
