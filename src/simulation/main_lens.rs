//! The main lens as the tracer uses it. It takes a ray behind the lens, and returns the ray in front of it or blocks it.

use nalgebra::{Point3, Vector2, Vector3};

use super::prescription::Prescription;
#[cfg(test)]
use super::ray::Passage;
use super::ray::{Ray, Stop};
use super::real_lens::{LensFigures, RealLens};
use super::scene::PlacedTarget;
use super::thin_lens::{Aim, ThinMainLens};
use crate::error::{Error, Result};
use crate::model::{MainLens, PlenopticCamera, Sensor};

/// A main lens at an f-number.
#[derive(Debug, Clone)]
pub(super) struct Lens {
    pub optics: Optics,
    /// Paraxial exit pupil, from which the sizes of micro-images are computed.
    pub pupil: Stop,
    /// Opening that rays are drawn from. It contains all rays that pass.
    pub drawn: Stop,
}

#[derive(Debug, Clone)]
pub(super) enum Optics {
    Thin(ThinMainLens),
    Real(RealLens),
}

/// Largest distance of an exit pupil, mm. A pupil further away is equivalent to one at infinity.
const FURTHEST_MM: f64 = 1e6;
/// Tolerance for the camera's exit pupil against its prescription, relative to F.
const SAME_PUPIL: f64 = 1e-6;

impl Lens {
    /// Creates the thin lens of the camera, or a real lens with its focal length.
    pub fn new(
        camera: &PlenopticCamera,
        prescription: Option<&Prescription>,
        f_number: f64,
    ) -> Result<Self> {
        let lens = &camera.main_lens;
        let Some(prescription) = prescription else {
            let pupil = exit_pupil(lens, f_number)?;
            let thin = ThinMainLens::new(lens, pupil);
            return Ok(Self { optics: Optics::Thin(thin), pupil, drawn: pupil });
        };
        check_camera(camera, prescription)?;
        let real = RealLens::new(prescription, lens.focal_length_mm, f_number)?;
        let pupil = Stop::new(real.exit_pupil, real.exit_pupil_radius);
        let radius = real.reach(furthest_mm(camera), -camera.mla.lens_to_mla_mm);
        Ok(Self { optics: Optics::Real(real), pupil, drawn: Stop::new(pupil.center, radius) })
    }

    /// Returns the figures of a real lens for objects at a distance; `None` for a thin lens.
    pub fn figures(&self, object_mm: f64, lens_to_mla_mm: f64) -> Option<LensFigures> {
        let Optics::Real(real) = &self.optics else { return None };
        real.figures(object_mm, lens_to_mla_mm)
    }

    /// Returns the z that all micro-lenses must stay behind.
    pub fn rear_z(&self) -> f64 {
        let lens = match &self.optics {
            Optics::Thin(_) => 0.0,
            Optics::Real(real) => real.last_vertex_z(),
        };
        self.pupil.center.z.min(lens)
    }

    /// Returns the distance beyond which a board lies in front of the lens, mm.
    pub fn nearest_object(&self) -> f64 {
        match &self.optics {
            Optics::Thin(_) => 0.0,
            Optics::Real(real) => real.nearest_object(),
        }
    }

    /// Fails if distortion folds the image within the corners of the sensor. No object point has its image beyond the fold.
    pub fn check_distortion(&self, corners: &[Point3<f64>]) -> Result<()> {
        let Optics::Thin(thin) = &self.optics else { return Ok(()) };
        for corner in corners.iter().map(|corner| corner.xy().coords) {
            if let Some(part) = thin.first_fold(&corner) {
                return Err(Error::invalid(format!(
                    "the distortion folds the image at {:.2} mm from the axis, within the sensor: \
                     give smaller coefficients",
                    part * corner.norm()
                )));
            }
        }
        Ok(())
    }

    /// Returns true if a ray passes all openings of the lens.
    pub fn passes(&self, ray: &Ray) -> bool {
        match &self.optics {
            Optics::Thin(thin) => thin.pupil.passes(ray),
            Optics::Real(real) => real.passes(ray),
        }
    }

    /// Returns the data that the rays of a narrow bundle about `ray` share; `None` if the lens needs none, or if `ray` leads
    /// away from the board. The search starts from the result of a nearby ray, if given.
    pub fn aim(&self, ray: &Ray, board: &PlacedTarget, nearby: Option<&Aim>) -> Option<Aim> {
        let Optics::Thin(thin) = &self.optics else { return None };
        thin.aim(ray, board, nearby)
    }

    /// Follows a ray to a board, with the [`Lens::aim`] of its bundle.
    #[cfg(test)]
    pub fn follow(&self, ray: &Ray, aim: Option<&Aim>, board: &PlacedTarget) -> Passage {
        match &self.optics {
            Optics::Thin(thin) => thin.follow(ray, aim),
            Optics::Real(real) => real.follow(ray, board),
        }
    }

    /// Returns the image of a point about the middle of the pupil; `None` if the point is not beyond the focal length.
    pub fn image_of(&self, point: &Point3<f64>) -> Option<Point3<f64>> {
        match &self.optics {
            Optics::Thin(thin) => thin.image_of(point),
            Optics::Real(real) => real.image_of(point),
        }
    }

    /// Returns the image of a point, formed by the rays through `from`, a point behind the lens; `near` is [`Lens::image_of`]
    /// the point. A thin lens has one image for all rays.
    pub fn image_from(
        &self,
        point: &Point3<f64>,
        near: &Point3<f64>,
        from: &Point3<f64>,
    ) -> Option<Point3<f64>> {
        match &self.optics {
            Optics::Thin(_) => Some(*near),
            Optics::Real(real) => real.image_from(point, near, from),
        }
    }

    /// Returns the direction of the chief ray from a point behind the lens: to the middle of the exit pupil, or through the
    /// middle of the stop of a real lens. `None` if no ray leads there.
    pub fn chief_direction(&self, from: &Point3<f64>) -> Option<Vector3<f64>> {
        match &self.optics {
            Optics::Thin(_) => Some(self.pupil.center - from),
            Optics::Real(real) => real.chief_slope(from).map(|slope| slope.push(1.0)),
        }
    }
}

/// Fails if a camera states distortion, field curvature or an exit pupil that contradicts its prescription.
pub(super) fn check_camera(camera: &PlenopticCamera, prescription: &Prescription) -> Result<()> {
    let lens = &camera.main_lens;
    let corrected = lens.radial.iter().chain(&lens.tangential).any(|&c| c != 0.0);
    if corrected || lens.has_curved_field() {
        return Err(Error::invalid(
            "distortion and field curvature of a lens with a prescription follow from its \
             surfaces: set all of them to 0 in the camera",
        ));
    }
    let z = prescription.exit_pupil_z(lens.focal_length_mm)?;
    if (lens.exit_pupil_mm - Vector3::new(0.0, 0.0, z)).norm() > SAME_PUPIL * lens.focal_length_mm {
        return Err(Error::invalid(format!(
            "the exit pupil of the camera is at {:?} mm, but its lens has it at z = {z} mm: leave \
             it out",
            lens.exit_pupil_mm.as_slice()
        )));
    }
    Ok(())
}

/// Returns the distance of the furthest corner of the sensor from the axis, mm, or of the array if that is smaller.
fn furthest_mm(camera: &PlenopticCamera) -> f64 {
    let (mla, lattice) = (&camera.mla, &camera.lattice);
    let Sensor { width_px, height_px, pixel_size_mm } = camera.sensor;
    let [width, height] = [width_px, height_px].map(f64::from);
    let corners = [(0.0, 0.0), (width, 0.0), (0.0, height), (width, height)];
    let lens_from_camera = camera.main_lens.camera_from_lens().inverse();
    let from_axis =
        |x: f64, y: f64, z: f64| (lens_from_camera * Point3::new(x, y, z)).xy().coords.norm();
    let sensor_z = -mla.lens_to_mla_mm - mla.mla_to_sensor_mm;
    let of_sensor = corners.map(|(u, v)| {
        let place = (mla.principal_point_px - Vector2::new(u, v)) * pixel_size_mm;
        from_axis(place.x, place.y, sensor_z)
    });
    let ends = [(0, 0), (lattice.columns, 0), (0, lattice.rows), (lattice.columns, lattice.rows)];
    let of_array = ends.map(|(k, l)| {
        let node = lattice.node(k, l);
        let place = mla.offset_mm - mla.pitch_mm * Vector2::new(node.x, node.y);
        from_axis(place.x, place.y, -mla.lens_to_mla_mm)
    });
    // Micro-lenses that the sensor does not see have no effect.
    let furthest = |distances: [f64; 4]| distances.into_iter().fold(0.0, f64::max);
    furthest(of_sensor).min(furthest(of_array) + mla.pitch_mm)
}

/// Returns the exit pupil of the thin lens. The entrance pupil has the diameter F/N; the exit pupil is its image, p times as
/// wide.
fn exit_pupil(lens: &MainLens, f_number: f64) -> Result<Stop> {
    let place = lens.exit_pupil_mm;
    if let Some(far) = place.iter().find(|e| e.abs() > FURTHEST_MM) {
        return Err(Error::invalid(format!(
            "an exit pupil at {far} mm is not possible: it has to lie within {FURTHEST_MM} mm of the \
             main lens"
        )));
    }
    let radius = lens.focal_length_mm / f_number / 2.0 * lens.pupil_magnification();
    Ok(Stop::new(Point3::from(place), radius))
}
