//! Traces rays from the sensor through micro-lenses and main lens into the scene.
//!
//! The tracer does not use the projection model of the C++ core: lenses refract rays and openings block
//! them. Blur, vignetting, overlap and the sizes of micro-images follow.

use nalgebra::Point3;

use super::array::{MicroLens, MicroLenses};
use super::imperfections::{Dust, FallOffLaw, Imperfections};
use super::main_lens::Lens;
use super::prescription::Prescription;
use super::ray::{Ray, Stop};
use super::scene::{PlacedTarget, Scene};
use crate::error::{Error, Result};
use crate::model::{InternalParameters, Lattice, PlenopticCamera, Sensor, positive};
use crate::quantity::Estimate;

/// A camera at one f-number, ready to take images.
#[derive(Debug)]
pub struct Tracer {
    sensor: Sensor,
    pub(super) lens: Lens,
    pub(super) focal_length: f64,
    pub(super) array: MicroLenses,
    pub(super) second_stop: Option<Stop>,
    pub(super) dust: Dust,
    pub(super) fall_off: FallOffLaw,
    pub(super) point_spread_px: f64,
    lattice: Lattice,
    types: usize,
    f_number: f64,
    lens_to_mla: f64,
    pub(super) mla_to_sensor: f64,
}

/// Largest radius of a micro-image, in pitches. Larger micro-images cover the centres of their neighbours.
const LARGEST_RADIUS: f64 = 1.0;
/// Largest number of rays. More would lower the noise below the resolution of a 16-bit sample.
const MAX_RAYS: u32 = 1 << 14;

impl Tracer {
    /// Creates the camera with its main lens at `f_number`; `seed` sets the random positions.
    pub fn new(
        camera: &PlenopticCamera,
        f_number: f64,
        imperfections: &Imperfections,
        seed: u64,
    ) -> Result<Self> {
        Self::with_lens(camera, None, f_number, imperfections, seed)
    }

    /// Creates the camera with a real main lens if a prescription is given. The prescription is scaled to the camera's F, and
    /// the camera has its exit pupil, without distortion and field curvature.
    pub fn with_lens(
        camera: &PlenopticCamera,
        prescription: Option<&Prescription>,
        f_number: f64,
        imperfections: &Imperfections,
        seed: u64,
    ) -> Result<Self> {
        camera.validate()?;
        imperfections.validate(camera)?;
        positive(f_number, "the f-number")?;
        if camera.lens_types() == 0 {
            return Err(Error::invalid(
                "a simulation needs the focal lengths of the micro-lenses: for pinholes give one \
                 type and an aperture ratio well below 1",
            ));
        }
        let (focal_length, mla) = (camera.main_lens.focal_length_mm, &camera.mla);
        let mut array =
            MicroLenses::new(camera, imperfections.opening, imperfections.aperture_ratio);
        imperfections.kill(&mut array.lenses, seed);
        let tracer = Self {
            sensor: camera.sensor,
            lens: Lens::new(camera, prescription, f_number)?,
            focal_length,
            second_stop: imperfections
                .second_stop
                .map(|stop| Stop::new(Point3::new(0.0, 0.0, stop.z_mm), stop.diameter_mm / 2.0)),
            dust: Dust::new(imperfections, &camera.sensor, seed),
            fall_off: imperfections.fall_off,
            point_spread_px: imperfections.point_spread_px,
            lattice: camera.lattice,
            types: camera.lens_types(),
            f_number,
            lens_to_mla: mla.lens_to_mla_mm,
            mla_to_sensor: mla.mla_to_sensor_mm,
            array,
        };
        tracer.check_geometry(f_number)?;
        tracer.check_distortion()?;
        Ok(tracer)
    }

    fn check_geometry(&self, f_number: f64) -> Result<()> {
        for lens in &self.array.lenses {
            let (k, l) = (lens.k, lens.l);
            let to_sensor = self.array.to_sensor_mm(&lens.center);
            if to_sensor <= 0.0 {
                return Err(Error::invalid(format!(
                    "micro-lens ({k}, {l}) lies {:.3} mm behind the sensor: give the array a \
                     smaller tilt or a larger distance from the sensor",
                    -to_sensor
                )));
            }
            if lens.center.z >= self.lens.rear_z() {
                return Err(Error::invalid(format!(
                    "micro-lens ({k}, {l}) does not lie behind the main lens and its exit pupil: give \
                     a smaller tilt, or a larger D"
                )));
            }
        }
        let radius = self.one_of_each_type().map(|lens| self.micro_image_radius_px(lens));
        let radius = radius.fold(0.0, f64::max);
        let pitch_px = self.micro_image_pitch_mm() / self.array.pixel_size;
        if radius > LARGEST_RADIUS * pitch_px {
            return Err(Error::invalid(format!(
                "at f/{f_number} micro-images have a radius of {radius:.1} px, but a pitch of only \
                 {pitch_px:.1} px, so each covers the centres of its neighbours: stop the main \
                 lens down"
            )));
        }
        Ok(())
    }

    fn check_distortion(&self) -> Result<()> {
        let (right, bottom) = (self.sensor.width_px - 1, self.sensor.height_px - 1);
        let corners = [(0, 0), (right, 0), (0, bottom), (right, bottom)];
        self.lens.check_distortion(
            &corners.map(|(u, v)| self.array.on_sensor(f64::from(u), f64::from(v))),
        )
    }

    /// Returns the distance between neighbouring micro-image centres, as projected from the exit pupil, mm.
    fn micro_image_pitch_mm(&self) -> f64 {
        let to_pupil = self.lens.pupil.center.z + self.lens_to_mla;
        let to_sensor = self.mla_to_sensor;
        self.array.pitch * (1.0 + to_sensor / to_pupil)
    }

    /// Returns the internal parameters Ω of this camera, with its aperture ratio. The outer radius of a micro-image combines
    /// the radii of the pupil and of the opening of the micro-lens, both projected onto the sensor, and grows with the pupil.
    /// q'ᵢ holds for openings as wide as the pitch. The parameters agree with the paper.
    #[must_use]
    pub fn internal_parameters(&self) -> InternalParameters {
        let to_pupil = self.lens.pupil.center.z + self.lens_to_mla;
        let to_sensor = self.mla_to_sensor;
        let pitch = self.micro_image_pitch_mm();
        let q_prime = |lens: &MicroLens| {
            let stop = lens.demagnification(to_sensor, to_pupil) * self.array.opening_radius
                / self.array.aperture_ratio;
            pitch / 2.0 - stop * to_sensor / to_pupil
        };
        InternalParameters {
            m_mm: self.lens.pupil.radius * self.f_number * to_sensor / to_pupil,
            q_prime_mm: self.one_of_each_type().map(q_prime).collect(),
            micro_image_pitch_mm: Some(pitch),
            m_std_dev_mm: None,
            q_prime_std_dev_mm: Vec::new(),
            pupil_growth: 0.0,
            fall_off: None,
            tilt_gradient: None,
            vignetting: None,
            point_spread_px2: None,
            aperture_ratio: Some(Estimate::exact(self.array.aperture_ratio)),
            opening: self.array.opening,
            levels: None,
        }
    }

    pub(super) fn micro_lens(&self, k: i32, l: i32) -> Option<&MicroLens> {
        self.array.lenses.get(self.lattice.index(k, l)?)
    }

    fn one_of_each_type(&self) -> impl Iterator<Item = &MicroLens> {
        (0..self.types).filter_map(|t| self.array.lenses.iter().find(|lens| lens.lens_type == t))
    }

    /// Returns the camera's sensor.
    #[must_use]
    pub fn sensor(&self) -> &Sensor {
        &self.sensor
    }

    /// Returns the outer radius of a micro-image of a white image, px: the distance of the outermost ray, from one
    /// edge of the pupil through the opposite edge of the micro-lens.
    pub(super) fn micro_image_radius_px(&self, lens: &MicroLens) -> f64 {
        let to_sensor = self.array.to_sensor_mm(&lens.center);
        let to_pupil = self.lens.pupil.center.z - lens.center.z;
        let stop = lens.demagnification(to_sensor, to_pupil).abs() * self.array.opening_reach;
        (stop + self.lens.drawn.radius) * to_sensor / to_pupil / self.array.pixel_size
    }

    /// Returns the irradiance (over the radiance of white: a solid angle) in the middle of a micro-image of
    /// the brightest type, untilted and on the axis.
    #[must_use]
    pub fn reference_irradiance(&self) -> f64 {
        let middle = |lens: &MicroLens| {
            let to_sensor = self.array.to_sensor_mm(&lens.center);
            let to_pupil = self.lens.pupil.center.z - lens.center.z;
            let demagnification = lens.demagnification(to_sensor, to_pupil).abs();
            let pupil = self.lens.pupil.radius / demagnification;
            let of_disc = |(radius, weight): &(f64, f64)| {
                weight * pupil.min(radius * self.array.opening_radius).powi(2)
            };
            let square: f64 = self.array.opening.discs().iter().map(of_disc).sum();
            std::f64::consts::PI * square / to_sensor.powi(2)
        };
        self.one_of_each_type().map(middle).fold(0.0, f64::max)
    }

    pub(super) fn place(&self, scene: &Scene) -> Result<Option<PlacedTarget>> {
        match scene {
            Scene::White => Ok(None),
            Scene::Board(target, pose) => {
                let pose = self.array.in_lens_frame(pose);
                let board = PlacedTarget::new(target, &pose, self.focal_length)?;
                board.check_in_front(self.lens.nearest_object())?;
                Ok(Some(board))
            }
        }
    }

    /// Fails if no image can be taken of the scene.
    pub(super) fn check_scene(&self, scene: &Scene) -> Result<()> {
        self.place(scene).map(drop)
    }

    /// Returns true if a ray passes the main lens and the second stop.
    #[inline]
    pub(super) fn passes(&self, ray: &Ray) -> bool {
        self.passes_second(ray) && self.lens.passes(ray)
    }

    #[inline]
    pub(super) fn passes_second(&self, ray: &Ray) -> bool {
        self.second_stop.is_none_or(|stop| stop.passes(ray))
    }
}

/// Fails unless this number of rays per pixel can be traced.
pub(super) fn check_rays(rays: u32) -> Result<()> {
    if (1..=MAX_RAYS).contains(&rays) {
        return Ok(());
    }
    Err(Error::invalid(format!("{rays} rays per pixel cannot be traced: give 1 to {MAX_RAYS}")))
}
