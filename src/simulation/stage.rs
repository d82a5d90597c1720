//! The simulation as one stage: from settings to images, truth, and observations drawn from the truth.

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
    /// Called after every row of the image.
    fn row(&self);
}

/// Ignores the progress.
impl Progress for () {
    fn image(&self, _: Content) {}
    fn row(&self) {}
}

/// The truth of a simulated data set.
///
/// q'ᵢ and ρ hold for micro-lenses whose openings are as wide as their pitch. With an aperture ratio below 1, micro-images
/// and blur are smaller.
#[derive(Debug, Clone, PartialEq)]
pub struct Truth {
    /// True camera. With a real lens, it has F, D and the exit pupil of [all light](super::AllLight), and neither distortion nor
    /// field curvature, which have no true value.
    pub camera: PlenopticCamera,
    /// Figures of a real lens.
    pub main_lens: Option<LensFigures>,
    /// Internal parameters m and q'ᵢ.
    pub internal: InternalParameters,
    /// Centres of all micro-images, dead micro-lenses included.
    pub centers: Vec<TrueCenter>,
    /// Features by subset, in the order of [`Subset::ALL`](crate::model::Subset::ALL).
    pub features: [Vec<TrueFeature>; 3],
}

/// A simulated data set without its images.
#[derive(Debug, Clone, PartialEq)]
pub struct Simulated {
    /// Images of the data set, and the poses of the boards.
    pub data_set: DataSet,
    /// Truth of the data set.
    pub truth: Truth,
    /// Centres, and the features of the calibration boards with at least half of their light visible, with noise. It has no
    /// features if there are no calibration boards.
    pub observed: Observations,
}

/// Least visible fraction of the light of an observed feature.
const OBSERVABLE: f64 = 0.5;

/// Plans a data set, computes its truth, takes its images one by one, and passes each to `receive`,
/// since all of them may not fit into memory together.
///
/// The calibration boards are at `poses` if given, else at random poses. The same settings
/// give the same data set. Fails if the settings are impossible, or if `receive` fails.
pub fn simulate(
    settings: &Settings,
    poses: Option<Vec<FramePose>>,
    progress: &dyn Progress,
    receive: &mut dyn FnMut(Content, &Shot, RawImage) -> Result<()>,
) -> Result<Simulated> {
    let _span = tracing::info_span!("simulation").entered();
    let data_set = DataSet::plan(settings, poses)?;
    let tracer = settings.tracer(settings.board_f_number())?;
    let truth = truth(settings, &data_set, &tracer)?;
    let observed = observed(settings, &truth)?;
    for (content, shot) in data_set.contents() {
        progress.image(content);
        receive(content, shot, shot.take(settings, &|| progress.row())?)?;
    }
    Ok(Simulated { data_set, truth, observed })
}

fn truth(settings: &Settings, data_set: &DataSet, tracer: &Tracer) -> Result<Truth> {
    let features = data_set.subsets.each_ref().map(|boards| {
        let of_board = |(pose, _): &(FramePose, Shot)| {
            tracer.features(pose.frame, &settings.target, &pose.camera_from_board)
        };
        boards.iter().flat_map(of_board).collect()
    });
    let internal = tracer.internal_parameters();
    // Along each axis, a pixel gives light to two neighbours at a distance of 1 px.
    let Settings { imperfections, imaging, .. } = settings;
    let variance_px2 = imperfections.point_spread_px.powi(2) + 2.0 * imaging.crosstalk;
    let edge_spread = EdgeSpread {
        aperture_ratio: internal.aperture_ratio,
        opening: internal.opening,
        point_spread_px2: Some(Estimate::exact(variance_px2)),
    };
    Ok(Truth {
        camera: PlenopticCamera { edge_spread, ..settings.true_camera()? },
        main_lens: settings.lens_figures()?,
        internal,
        centers: tracer.centers(),
        features,
    })
}

fn observed(settings: &Settings, truth: &Truth) -> Result<Observations> {
    let mut source = NoiseSource::new(&settings.observation_noise, settings.seed)?;
    let [calibration, ..] = &truth.features;
    let visible = calibration.iter().filter(|f| f.visible >= OBSERVABLE);
    let features = visible.map(|f| source.feature(&f.feature)).collect();
    let alive = truth.centers.iter().filter(|c| c.alive).map(|c| source.center(&c.center));
    let in_image = |c: &MicroImageCenter| settings.camera.sensor.contains(c.u_px, c.v_px);
    let centers = alive.filter(in_image).collect();
    Ok(Observations { centers, features, ..Observations::default() })
}
