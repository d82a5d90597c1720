//! A real lens: rays are traced through all its surfaces, from the sensor outwards.
//!
//! Distortion, curvature of the field, spherical aberration and coma, the position of the pupil and its aberration,
//! and vignetting by the rims of the lenses follow from refraction; nothing is taken from the model. The
//! camera frame has its origin at the image-side principal point H', from which the sensor is placed. Objects are placed by
//! their distance from the object-side principal plane H, as if they were in front of a thin lens at H'.

use nalgebra::{Matrix2, Point3, Vector2, Vector3};
use serde::Serialize;

use super::prescription::{Paraxial, Prescription};
use super::ray::Passage;
use super::ray::Ray;
use super::scene::PlacedTarget;
use crate::error::{Error, Result};

/// Figures of a real lens in terms of the model, for rays close to the axis or to the middle of the pupil. The true camera
/// has those of `all_light`; the others are for comparison.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct LensFigures {
    /// Focal length F, mm.
    pub focal_length_mm: f64,
    /// z of the object-side principal plane from the image-side one, mm. Object distances count from the object-side plane.
    pub object_side_principal_mm: f64,
    /// z of the entrance pupil from the object-side principal plane, mm: in the frame of the poses.
    pub entrance_pupil_mm: f64,
    /// z of the exit pupil, e_z, mm.
    pub exit_pupil_mm: f64,
    /// Pupil magnification p = 1 + e_z/F.
    pub pupil_magnification: f64,
    /// Distance of the object to which the following figures apply, mm.
    pub object_mm: f64,
    /// Field curvature κ + κ_m|M| close to the axis, 1/mm: the mean of the tangential and the sagittal one.
    pub field_curvature_per_mm: f64,
    /// Growth κ_m of the field curvature with |M|, 1/mm.
    pub field_curvature_growth_per_mm: f64,
    /// Radial distortion Q₁ + Q₁ₘ|M| close to the axis, mm⁻².
    pub q1_per_mm2: f64,
    /// Growth Q₁ₘ of the radial distortion with |M|, mm⁻².
    pub q1_growth_per_mm2: f64,
    /// Spherical aberration e_r of the exit pupil seen from the array, mm⁻¹.
    pub pupil_aberration_per_mm: f64,
    /// Figures for the light of the whole aperture.
    pub all_light: AllLight,
}

/// Figures of a real lens for the light that fills its aperture. With spherical aberration, its best focus lies elsewhere on the
/// chief ray than the paraxial image, at another magnification. So F and D differ, and the pupil's middle is the centroid of
/// the light.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct AllLight {
    /// Focal length F, mm.
    pub focal_length_mm: f64,
    /// Distance D to the array, mm.
    pub lens_to_mla_mm: f64,
    /// z of the exit pupil, e_z, mm.
    pub exit_pupil_mm: f64,
}

/// One surface, as a ray from the sensor meets it.
#[derive(Debug, Clone, Copy)]
struct Interface {
    /// z of the vertex, camera frame, mm.
    z: f64,
    /// Vertex off the optical axis, mm.
    vertex: Vector2<f64>,
    /// Curvature, 1/mm: positive if the centre lies towards the scene.
    curvature: f64,
    /// Refractive index on the sensor side over that on the scene side.
    ratio: f64,
    /// Square of the radius of the opening, mm².
    opening2: f64,
    /// True for the stop, which does not refract rays.
    is_stop: bool,
}

/// A real lens at a focal length and an f-number.
#[derive(Debug, Clone)]
pub(super) struct RealLens {
    /// Surfaces, from rear to front.
    interfaces: Vec<Interface>,
    /// Index of the stop in `interfaces`.
    stop: usize,
    focal_length: f64,
    /// z of the object-side principal plane H.
    object_side: f64,
    /// z of the entrance pupil from H.
    entrance_pupil: f64,
    /// Paraxial exit pupil.
    pub exit_pupil: Point3<f64>,
    pub exit_pupil_radius: f64,
}

/// A ray within the lens: a point and a unit vector.
#[derive(Clone, Copy)]
struct Inner {
    at: Vector3<f64>,
    towards: Vector3<f64>,
}

/// Steps of numerical derivatives: across the array, mm; of slopes.
const STEP_MM: f64 = 1e-3;
const STEP: f64 = 1e-4;
/// Height of the image off the axis at which figures are computed, in focal lengths: large against rounding errors, small
/// enough that the next order is negligible.
const FIGURES_HEIGHT: f64 = 0.04;
/// Ratio of the distances of the two objects from which the growth of field curvature and distortion is computed.
const FIGURES_FURTHER: f64 = 1.1;
/// Largest miss at which Newton's method ends, mm at the stop or at the object.
const FOUND_MM: f64 = 1e-9;
const NEWTON_STEPS: usize = 20;

impl RealLens {
    /// Creates the lens, scaled to a focal length, with the entrance pupil F/N.
    pub fn new(prescription: &Prescription, focal_length: f64, f_number: f64) -> Result<Self> {
        let paraxial = Paraxial::of(prescription)?;
        let scale = focal_length / paraxial.focal_length;
        let entrance_radius = focal_length / f_number / 2.0;
        let stop_radius = entrance_radius * paraxial.stop_magnification;
        let stop = prescription.stop();
        let widest = prescription.surfaces[stop].semi_diameter_mm * scale;
        if stop_radius > widest * (1.0 + 1e-9) {
            return Err(Error::invalid(format!(
                "the lens opens to f/{:.2}, but f/{f_number} is needed: stop it down, or give its \
                 stop a semi-diameter of {:.3} mm",
                f_number * stop_radius / widest,
                stop_radius / scale
            )));
        }
        let mut behind_first = 0.0;
        let mut interfaces = Vec::with_capacity(prescription.surfaces.len());
        for (i, surface) in prescription.surfaces.iter().enumerate() {
            let opening = if i == stop { stop_radius } else { surface.semi_diameter_mm * scale };
            interfaces.push(Interface {
                z: paraxial.z_mm(behind_first, focal_length),
                vertex: Vector2::from(surface.decentre_mm) * scale,
                curvature: -1.0 / (surface.radius_mm * scale),
                ratio: surface.index / prescription.index_before(i),
                opening2: opening * opening,
                is_stop: i == stop,
            });
            behind_first += surface.thickness_mm;
        }
        interfaces.reverse();
        Ok(Self {
            stop: interfaces.len() - 1 - stop,
            interfaces,
            focal_length,
            object_side: paraxial.z_mm(paraxial.front_principal, focal_length),
            entrance_pupil: (paraxial.front_principal - paraxial.entrance_pupil) * scale,
            exit_pupil: Point3::new(0.0, 0.0, paraxial.z_mm(paraxial.exit_pupil, focal_length)),
            exit_pupil_radius: entrance_radius * paraxial.pupil_magnification,
        })
    }

    /// Returns z of the last vertex, which is the nearest to the array.
    pub fn last_vertex_z(&self) -> f64 {
        self.interfaces[0].z
    }

    /// Returns the distance from H beyond which an object lies in front of the lens.
    pub fn nearest_object(&self) -> f64 {
        let front = self.interfaces.iter().map(|surface| surface.z).fold(f64::MIN, f64::max);
        front - self.object_side
    }

    /// Traces a ray through some of the surfaces; `None` if it misses one, is totally reflected, or (with
    /// `CLEAR`) is blocked by an opening.
    ///
    /// A sphere of curvature k with its vertex at the origin is k|x|² = 2z. Snell's law for unit vectors is
    /// d' = μd + (cos t − μ cos i) n, with cos²t = 1 − μ²(1 − cos²i).
    #[inline]
    fn through<const CLEAR: bool>(ray: &Ray, surfaces: &[Interface]) -> Option<Inner> {
        let mut towards = ray.slope.push(1.0);
        towards /= towards.norm();
        let mut at = ray.at_lens.push(0.0);
        for surface in surfaces {
            let k = surface.curvature;
            // The point where the ray meets the plane of the vertex, from the vertex.
            let start = at + towards * ((surface.z - at.z) / towards.z);
            let start = start.xy() - surface.vertex;
            let towards_center = towards.z - k * start.dot(&towards.xy());
            let square = start.norm_squared();
            if surface.is_stop {
                if CLEAR && square > surface.opening2 {
                    return None;
                }
                at = (start + surface.vertex).push(surface.z);
                continue;
            }
            let cos2 = towards_center * towards_center - k * k * square;
            if cos2 < 0.0 {
                return None;
            }
            let cos = cos2.sqrt();
            let hit = start.push(0.0) + towards * (k * square / (towards_center + cos));
            if CLEAR && hit.xy().norm_squared() > surface.opening2 {
                return None;
            }
            let normal = Vector3::new(-k * hit.x, -k * hit.y, 1.0 - k * hit.z);
            let inside2 = 1.0 - surface.ratio * surface.ratio * (1.0 - cos2);
            if inside2 < 0.0 {
                return None;
            }
            towards = towards * surface.ratio + normal * (inside2.sqrt() - surface.ratio * cos);
            at = hit + surface.vertex.push(surface.z);
        }
        Some(Inner { at, towards })
    }

    /// Returns the ray in front of the lens, in the frame of the poses.
    fn in_front(&self, inner: &Inner) -> Ray {
        let slope = inner.towards.xy() / inner.towards.z;
        Ray { at_lens: inner.at.xy() + slope * (self.object_side - inner.at.z), slope }
    }

    /// Returns the ray in front of the lens that continues a ray behind it; `None` if it is blocked.
    #[inline]
    pub fn object_ray(&self, ray: &Ray) -> Option<Ray> {
        Self::through::<true>(ray, &self.interfaces).map(|inner| self.in_front(&inner))
    }

    /// Returns true if a ray passes all openings.
    #[inline]
    pub fn passes(&self, ray: &Ray) -> bool {
        Self::through::<true>(ray, &self.interfaces).is_some()
    }

    /// Follows a ray to a board.
    #[inline]
    pub fn follow(&self, ray: &Ray, board: &PlacedTarget) -> Passage {
        match self.object_ray(ray) {
            None => Passage::Blocked,
            Some(outer) if board.depth(&outer) > 0.0 => Passage::Seen(outer),
            Some(_) => Passage::Away,
        }
    }

    /// Returns the slope of the ray from a point behind the lens through the middle of the stop.
    pub fn chief_slope(&self, from: &Point3<f64>) -> Option<Vector2<f64>> {
        self.stop_slope(from, &Vector2::zeros())
    }

    /// Returns the slope of the ray from a point behind the lens through a point of the stop, which is relative to its middle.
    fn stop_slope(&self, from: &Point3<f64>, place: &Vector2<f64>) -> Option<Vector2<f64>> {
        let surfaces = &self.interfaces[..=self.stop];
        let place = self.interfaces[self.stop].vertex + place;
        let at_stop = |slope: Vector2<f64>| {
            let inner = Self::through::<false>(&Ray::from(from, slope), surfaces)?;
            Some(inner.at.xy() - place)
        };
        newton(slope_towards(from, &self.exit_pupil), &at_stop).map(|(slope, _)| slope)
    }

    /// Returns the mean slope of the rays from a point behind the lens through all of the stop: the centroid of the area that
    /// its rim encloses.
    fn mean_slope(&self, from: &Point3<f64>) -> Option<Vector2<f64>> {
        let radius = self.interfaces[self.stop].opening2.sqrt();
        let slope = |turn: u32| {
            let angle = std::f64::consts::TAU * f64::from(turn) / f64::from(RIM);
            self.stop_slope(from, &(Vector2::new(angle.cos(), angle.sin()) * radius))
        };
        let rim: Vec<Vector2<f64>> = (0..RIM).map(slope).collect::<Option<_>>()?;
        let (mut area, mut moment) = (0.0, Vector2::zeros());
        for (a, b) in rim.iter().zip(rim.iter().cycle().skip(1)) {
            let twice = a.perp(b);
            area += twice;
            moment += (a + b) * twice / 3.0;
        }
        Some(moment / area)
    }

    /// Returns z of the focus of an object point on the axis for the zone of the pupil with the best focus, by rays through
    /// both ends of the zone in the exit pupil.
    fn zone_focus(&self, object_mm: f64) -> Option<f64> {
        let point = Point3::new(0.0, 0.0, object_mm);
        let ideal = point * (self.focal_length / (self.focal_length - object_mm));
        let height = ZONE.sqrt() * self.exit_pupil_radius;
        let slope = |height: f64| -> Option<f64> {
            let from = self.exit_pupil + Vector3::x() * height;
            let map = |slope| self.miss(&point, &from, slope);
            Some(newton(slope_towards(&from, &ideal), &map)?.0.x)
        };
        Some(self.exit_pupil.z - 2.0 * height / (slope(height)? - slope(-height)?))
    }

    /// Computes the figures for all light from objects at two distances.
    fn all_light(&self, objects_mm: [f64; 2], lens_to_mla_mm: f64) -> Option<AllLight> {
        let height = FIGURES_HEIGHT * self.focal_length;
        let slope = |height: f64| -> Option<f64> {
            Some(self.mean_slope(&Point3::new(height, 0.0, -lens_to_mla_mm))?.x)
        };
        let exit_pupil_mm = -lens_to_mla_mm - 2.0 * height / (slope(height)? - slope(-height)?);
        // The best focus lies on the chief ray of the paraxial image.
        let image = |object_mm: f64| -> Option<(f64, f64)> {
            let magnification = self.focal_length / (object_mm - self.focal_length);
            let (ideal, z) = (-magnification * object_mm, self.zone_focus(object_mm)?);
            Some((magnification * (exit_pupil_mm - z) / (exit_pupil_mm - ideal), z))
        };
        // An ideal lens has |m| = F/(Z − F) and z = −F (1 + |m|).
        let [near, far] = objects_mm;
        let (near_image, far_image) = (image(near)?, image(far)?);
        let focal_length_mm = (far - near) / (1.0 / far_image.0 - 1.0 / near_image.0);
        let moved = |(magnification, z): (f64, f64)| z + focal_length_mm * (1.0 + magnification);
        let lens_to_mla_mm = lens_to_mla_mm + f64::midpoint(moved(near_image), moved(far_image));
        Some(AllLight { focal_length_mm, lens_to_mla_mm, exit_pupil_mm })
    }

    /// Returns where the ray from a point behind the lens passes an object point; `None` if no ray leads there.
    fn miss(
        &self,
        point: &Point3<f64>,
        start: &Point3<f64>,
        slope: Vector2<f64>,
    ) -> Option<Vector2<f64>> {
        let inner = Self::through::<false>(&Ray::from(start, slope), &self.interfaces)?;
        Some(self.in_front(&inner).at(point.z) - point.xy().coords)
    }

    /// Returns the focus of the light of an object point that passes near `from`, a point behind the lens: the mean of the
    /// tangential and the sagittal focus, on the ray through `from`. `near` is a guess. `None` if the object point is not
    /// beyond F, or no ray leads there.
    pub fn image_from(
        &self,
        point: &Point3<f64>,
        near: &Point3<f64>,
        from: &Point3<f64>,
    ) -> Option<Point3<f64>> {
        if point.z <= self.focal_length {
            return None;
        }
        let miss = |start: &Point3<f64>, slope: Vector2<f64>| self.miss(point, start, slope);
        let (slope, by_slope) = newton(slope_towards(from, near), &|slope| miss(from, slope))?;
        let by_place = jacobian(Vector2::zeros(), STEP_MM, &|off: Vector2<f64>| {
            miss(&(from + off.push(0.0)), slope)
        })?;
        // Rays through `from` + δ that meet the object point have slopes smaller by Tδ. If the focus lies w in front of `from`,
        // T = 1/w in all directions.
        let turn = by_slope.try_inverse()? * by_place;
        let distance = 2.0 / turn.trace();
        distance.is_finite().then(|| from + slope.push(1.0) * distance)
    }

    /// Returns the image of an object point about the ray through the middle of the paraxial exit pupil.
    pub fn image_of(&self, point: &Point3<f64>) -> Option<Point3<f64>> {
        let magnification = self.focal_length / (self.focal_length - point.z);
        let ideal = Point3::from(point.coords * magnification);
        self.image_from(point, &ideal, &self.exit_pupil)
    }

    /// Computes the figures of the lens for objects at a distance, and an array at a distance.
    pub fn figures(&self, object_mm: f64, lens_to_mla_mm: f64) -> Option<LensFigures> {
        let height = FIGURES_HEIGHT * self.focal_length;
        let magnification = |object_mm: f64| self.focal_length / (self.focal_length - object_mm);
        let image = |height: f64, object_mm: f64| {
            self.image_of(&Point3::new(height / magnification(object_mm), 0.0, object_mm))
        };
        // Differences between both sides are right for decentred lenses too.
        let curvature = |object_mm: f64| -> Option<f64> {
            let sides = f64::midpoint(image(height, object_mm)?.z, image(-height, object_mm)?.z);
            Some((sides - image(0.0, object_mm)?.z) / height.powi(2))
        };
        let distortion = |object_mm: f64| -> Option<f64> {
            let across = image(height, object_mm)?.x - image(-height, object_mm)?.x;
            Some((across / (2.0 * height) - 1.0) / height.powi(2))
        };
        let slope = |height: f64| -> Option<f64> {
            Some(self.chief_slope(&Point3::new(height, 0.0, -lens_to_mla_mm))?.x)
        };
        let further_mm = object_mm * FIGURES_FURTHER;
        let [near, far] = [curvature(object_mm)?, curvature(further_mm)?];
        let [q1, q1_far] = [distortion(object_mm)?, distortion(further_mm)?];
        let less = magnification(further_mm) - magnification(object_mm);
        let by_height = (slope(height)? - slope(-height)?) / (2.0 * height);
        let crossing = -lens_to_mla_mm - 1.0 / by_height;
        Some(LensFigures {
            focal_length_mm: self.focal_length,
            object_side_principal_mm: self.object_side,
            entrance_pupil_mm: self.entrance_pupil,
            exit_pupil_mm: self.exit_pupil.z,
            pupil_magnification: 1.0 + self.exit_pupil.z / self.focal_length,
            object_mm,
            field_curvature_per_mm: near,
            field_curvature_growth_per_mm: (near - far) / less,
            q1_per_mm2: q1,
            q1_growth_per_mm2: (q1 - q1_far) / less,
            pupil_aberration_per_mm: (crossing - self.exit_pupil.z) / height.powi(2),
            all_light: self.all_light([object_mm, further_mm], lens_to_mla_mm)?,
        })
    }

    /// Returns the radius of a disc about the paraxial exit pupil that contains all rays which pass, from anywhere
    /// within `radius` of the axis at `z`. Off the axis the pupil moves, grows and is vignetted.
    pub fn reach(&self, radius: f64, z: f64) -> f64 {
        let step = self.exit_pupil_radius * REACH_STEP;
        let limit = 2.0 * self.exit_pupil_radius + REACH_FURTHER * self.focal_length;
        let pupil = &self.exit_pupil;
        let passes = |field: u32, turn: u32, distance: f64| {
            let x = radius * f64::from(field) / f64::from(REACH_FIELDS - 1);
            let from = Point3::new(x, 0.0, z);
            // One half of the directions is enough by symmetry.
            let (sin, cos) =
                (std::f64::consts::PI * f64::from(turn) / f64::from(REACH_TURNS - 1)).sin_cos();
            let aim = pupil + Vector3::new(cos, sin, 0.0) * distance;
            self.passes(&Ray::from(&from, slope_towards(&from, &aim)))
        };
        let furthest = |field: u32, turn: u32| {
            let outer = self.exit_pupil_radius.max(step);
            let mut distance = limit;
            while distance > outer && !passes(field, turn, distance) {
                distance -= step;
            }
            distance
        };
        let all =
            (0..REACH_FIELDS).flat_map(|field| (0..REACH_TURNS).map(move |turn| (field, turn)));
        all.map(|(field, turn)| furthest(field, turn)).fold(0.0, f64::max) + REACH_MARGIN * step
    }
}

/// Search for the reach of the pupil: step, in radii of the exit pupil; margin, in steps; start beyond the pupil's diameter,
/// in focal lengths; numbers of field points and of directions.
const REACH_STEP: f64 = 0.02;
const REACH_MARGIN: f64 = 2.0;
const REACH_FURTHER: f64 = 0.05;
const REACH_FIELDS: u32 = 9;
const REACH_TURNS: u32 = 13;

/// Square of the zone of the best focus over the squared radius of the pupil, as in the detection.
const ZONE: f64 = 2.0 / 3.0;
/// Number of points of the rim of the stop.
const RIM: u32 = 16;

/// Returns dx/dz and dy/dz from one point to another.
fn slope_towards(from: &Point3<f64>, to: &Point3<f64>) -> Vector2<f64> {
    let way = to - from;
    way.xy() / way.z
}

type Map<'a> = &'a dyn Fn(Vector2<f64>) -> Option<Vector2<f64>>;

/// Computes the derivatives of a map of the plane by central differences.
fn jacobian(at: Vector2<f64>, step: f64, map: Map) -> Option<Matrix2<f64>> {
    let column =
        |axis: Vector2<f64>| Some((map(at + axis * step)? - map(at - axis * step)?) / (2.0 * step));
    Some(Matrix2::from_columns(&[column(Vector2::x())?, column(Vector2::y())?]))
}

/// Finds the zero of a map of slopes to mm, and the derivatives there.
fn newton(start: Vector2<f64>, map: Map) -> Option<(Vector2<f64>, Matrix2<f64>)> {
    let mut slope = start;
    for _ in 0..NEWTON_STEPS {
        let miss = map(slope)?;
        let derivatives = jacobian(slope, STEP, map)?;
        if miss.norm() < FOUND_MM {
            return Some((slope, derivatives));
        }
        slope -= derivatives.try_inverse()? * miss;
    }
    None
}
