//! Traces rays from the sensor through micro-lenses and main lens into the scene.
//!
//! Nothing here knows the projection model of the C++ core: lenses bend rays, stops hold them back,
//! and blur, vignetting, overlap and the sizes of micro-images follow.

use nalgebra::{Point3, Vector2, Vector3};
use rayon::prelude::*;

use super::array::{MicroLens, MicroLenses};
use super::imperfections::{Dust, Imperfections};
use super::main_lens::{LocalDistortion, Ray, ThinMainLens};
use super::sampling::{RayPoint, RaySets, hash};
use super::scene::{PlacedTarget, Scene};
use crate::error::{Error, Result};
use crate::image::Image;
use crate::model::{InternalParameters, Lattice, PlenopticCamera, Sensor, positive};

/// A circular stop across the optical axis.
#[derive(Debug, Clone, Copy)]
pub(super) struct Stop {
    pub z: f64,
    pub radius: f64,
}

impl Stop {
    #[inline]
    fn passes(&self, ray: &Ray) -> bool {
        // A ray drawn on the rim may not fall off it by rounding.
        ray.at(self.z).norm_squared() <= self.radius * self.radius * (1.0 + 1e-9)
    }
}

/// A camera at one f-number, ready to take images.
#[derive(Debug)]
pub struct Tracer {
    sensor: Sensor,
    pub(super) lens: ThinMainLens,
    pub(super) focal_length: f64,
    pub(super) array: MicroLenses,
    pub(super) pupil: Stop,
    second_stop: Option<Stop>,
    dust: Dust,
    lattice: Lattice,
    types: usize,
    f_number: f64,
    lens_to_mla: f64,
}

/// Micro-images wider than this many pitches cover their neighbours' centres.
const LARGEST_RADIUS: f64 = 1.0;
/// Tilt changes the outline of a micro-image by less than this part; what is looked at in vain is
/// cheap.
const OUTLINE_MARGIN: f64 = 1.02;
/// The noise of more is below what a 16-bit sample can hold.
const MAX_RAYS: u32 = 1 << 14;
/// Half the diagonal of a pixel, px.
const HALF_DIAGONAL: f64 = std::f64::consts::FRAC_1_SQRT_2;

/// What one micro-lens does for one pixel, in local coordinates.
struct Bundle {
    /// Middle of the pixel, and the steps to its neighbours.
    pixel: Vector3<f64>,
    right: Vector3<f64>,
    down: Vector3<f64>,
    /// Rays are drawn on the stop of the micro-lens, or else on the pupil: on whichever is the
    /// smaller one, seen in the plane of the micro-lens.
    on_stop: bool,
    /// Area that the rays are drawn from, in the plane of the micro-lens.
    area: f64,
    /// Of the main lens for this bundle, if it leads to the board.
    local: Option<LocalDistortion>,
}

impl Tracer {
    /// The camera with its main lens at `f_number`; `seed` places what is placed by chance.
    pub fn new(
        camera: &PlenopticCamera,
        f_number: f64,
        imperfections: &Imperfections,
        seed: u64,
    ) -> Result<Self> {
        camera.validate()?;
        imperfections.validate(camera)?;
        positive(f_number, "the f-number")?;
        if camera.lens_types() == 0 {
            return Err(Error::invalid(
                "a simulation needs the focal lengths of the micro-lenses; for pinholes give one \
                 type and a fill factor well below 1",
            ));
        }
        let (focal_length, mla) = (camera.main_lens.focal_length_mm, &camera.mla);
        let exit_z = imperfections.exit_pupil_mm;
        // The cone of light on the axis stays that of a pupil F/N at the lens.
        let cone = 1.0 + exit_z / mla.lens_to_mla_mm;
        let mut array = MicroLenses::new(camera, imperfections.fill_factor);
        imperfections.kill(&mut array.lenses, seed);
        let tracer = Self {
            sensor: camera.sensor,
            lens: ThinMainLens::new(&camera.main_lens),
            focal_length,
            pupil: Stop { z: exit_z, radius: focal_length / f_number / 2.0 * cone },
            second_stop: imperfections
                .second_stop
                .map(|stop| Stop { z: stop.z_mm, radius: stop.diameter_mm / 2.0 }),
            dust: Dust::new(imperfections, &camera.sensor, seed),
            lattice: camera.lattice,
            types: camera.lens_types(),
            f_number,
            lens_to_mla: mla.lens_to_mla_mm,
            array,
        };
        tracer.check_geometry(f_number)?;
        tracer.check_distortion()?;
        Ok(tracer)
    }

    fn check_geometry(&self, f_number: f64) -> Result<()> {
        for lens in &self.array.lenses {
            let (k, l) = (lens.k, lens.l);
            if lens.center.z <= self.array.sensor_z {
                return Err(Error::invalid(format!(
                    "micro-lens ({k}, {l}) lies {:.3} mm behind the sensor: the array is tilted too \
                     much for its distance to the sensor",
                    self.array.sensor_z - lens.center.z
                )));
            }
            if lens.center.z >= self.pupil.z.min(0.0) {
                return Err(Error::invalid(format!(
                    "micro-lens ({k}, {l}) does not lie behind the main lens and its exit pupil"
                )));
            }
        }
        let radius = self.one_of_each_type().map(|lens| self.micro_image_radius_px(lens));
        let radius = radius.fold(0.0, f64::max);
        let pitch_px = self.micro_image_pitch_mm() / self.array.pixel_size;
        if radius > LARGEST_RADIUS * pitch_px {
            return Err(Error::invalid(format!(
                "at f/{f_number} micro-images have a radius of {radius:.1} px, but their centres are \
                 only {pitch_px:.1} px apart, so that every one covers its neighbours' centres: \
                 stop the main lens down"
            )));
        }
        Ok(())
    }

    /// An error if distortion folds the image before the corners of the sensor: then no object point
    /// has its image there.
    fn check_distortion(&self) -> Result<()> {
        let (right, bottom) = (self.sensor.width_px - 1, self.sensor.height_px - 1);
        for (u, v) in [(0, 0), (right, 0), (0, bottom), (right, bottom)] {
            let corner = self.array.on_sensor(f64::from(u), f64::from(v)).xy().coords;
            if let Some(part) = self.lens.first_fold(&corner) {
                return Err(Error::invalid(format!(
                    "the distortion folds the image {:.2} mm from the axis, within the sensor: the \
                     coefficients are too large",
                    part * corner.norm()
                )));
            }
        }
        Ok(())
    }

    /// Distance of neighbouring micro-image centres, as the exit pupil casts them, mm.
    fn micro_image_pitch_mm(&self) -> f64 {
        let to_pupil = self.pupil.z + self.lens_to_mla;
        let to_sensor = -self.lens_to_mla - self.array.sensor_z;
        self.array.pitch * (1.0 + to_sensor / to_pupil)
    }

    /// Ω as white images of this camera show it, imperfections included: the outer radius of the
    /// micro-images is the distance of pupil and stop of the micro-lens from each other, both seen
    /// on the sensor, and grows with the pupil. Of the ideal camera it is what the paper says.
    #[must_use]
    pub fn internal_parameters(&self) -> InternalParameters {
        let to_pupil = self.pupil.z + self.lens_to_mla;
        let to_sensor = -self.lens_to_mla - self.array.sensor_z;
        let pitch = self.micro_image_pitch_mm();
        let q_prime = |lens: &MicroLens| {
            let stop = lens.demagnification(to_sensor, to_pupil) * self.array.stop_radius;
            pitch / 2.0 - stop * to_sensor / to_pupil
        };
        InternalParameters {
            m_mm: self.pupil.radius * self.f_number * to_sensor / to_pupil,
            q_prime_mm: self.one_of_each_type().map(q_prime).collect(),
            micro_image_pitch_mm: Some(pitch),
        }
    }

    pub(super) fn micro_lens(&self, k: i32, l: i32) -> Option<&MicroLens> {
        if !self.lattice.contains(k, l) {
            return None;
        }
        self.array.lenses.get(usize::try_from(l * self.lattice.columns + k).ok()?)
    }

    fn one_of_each_type(&self) -> impl Iterator<Item = &MicroLens> {
        (0..self.types).filter_map(|t| self.array.lenses.iter().find(|lens| lens.lens_type == t))
    }

    /// The camera's sensor.
    #[must_use]
    pub fn sensor(&self) -> &Sensor {
        &self.sensor
    }

    /// Outer radius of a micro-image on white, px: where the last ray arrives, from one rim of the
    /// pupil through the other rim of the micro-lens.
    pub(super) fn micro_image_radius_px(&self, lens: &MicroLens) -> f64 {
        let to_sensor = lens.center.z - self.array.sensor_z;
        let to_pupil = self.pupil.z - lens.center.z;
        let stop = lens.demagnification(to_sensor, to_pupil).abs() * self.array.stop_radius;
        (stop + self.pupil.radius) * to_sensor / to_pupil / self.array.pixel_size
    }

    /// Irradiance (relative to the radiance of white: a solid angle) in the middle of the brightest
    /// type's micro-image, untilted and on the axis.
    #[must_use]
    pub fn reference_irradiance(&self) -> f64 {
        let middle = |lens: &MicroLens| {
            let to_sensor = lens.center.z - self.array.sensor_z;
            let to_pupil = self.pupil.z - lens.center.z;
            let demagnification = lens.demagnification(to_sensor, to_pupil).abs();
            let radius = (self.pupil.radius / demagnification).min(self.array.stop_radius);
            std::f64::consts::PI * (radius / to_sensor).powi(2)
        };
        self.one_of_each_type().map(middle).fold(0.0, f64::max)
    }

    /// Takes an image: irradiance of every pixel relative to [`Tracer::reference_irradiance`], from
    /// `rays` rays for every pixel through every micro-lens that reaches it. `progress` is told of
    /// every finished row. The same seed gives the same image, whatever the number of threads.
    pub fn render(
        &self,
        scene: &Scene,
        rays: u32,
        seed: u64,
        progress: &(dyn Fn() + Sync),
    ) -> Result<Image> {
        check_rays(rays)?;
        let board = self.place(scene)?;
        let (width, height) = (self.sensor.width_px as usize, self.sensor.height_px as usize);
        let by_row = self.micro_lenses_by_row();
        let sets = RaySets::new(rays);
        let scale = 1.0 / self.reference_irradiance();
        let mut pixels = vec![0.0_f32; width * height];
        pixels.par_chunks_mut(width).enumerate().for_each(|(v, row)| {
            let mut sums = vec![0.0; width];
            for &i in &by_row[v] {
                self.expose(i, v, board.as_ref(), &sets, seed, &mut sums);
            }
            for (pixel, sum) in row.iter_mut().zip(&sums) {
                #[allow(clippy::cast_possible_truncation)] // seven digits are enough
                let value = (sum * scale) as f32;
                *pixel = value;
            }
            progress();
        });
        Ok(Image { width, height, pixels })
    }

    fn place(&self, scene: &Scene) -> Result<Option<PlacedTarget>> {
        match scene {
            Scene::White => Ok(None),
            Scene::Board(target, pose) => {
                PlacedTarget::new(target, pose, self.focal_length).map(Some)
            }
        }
    }

    /// An error if the scene is one that no image can be taken of.
    pub(super) fn check_scene(&self, scene: &Scene) -> Result<()> {
        self.place(scene).map(drop)
    }

    /// Centre and radius (px) of what a micro-lens can reach.
    fn outline(&self, lens: &MicroLens) -> (Vector2<f64>, f64) {
        let pupil = Point3::new(0.0, 0.0, self.pupil.z);
        let center = self.array.to_pixel(&lens.center, &(pupil - lens.center)).coords;
        (center, self.micro_image_radius_px(lens) * OUTLINE_MARGIN + HALF_DIAGONAL)
    }

    /// For every row of the image the micro-lenses that reach it, in order.
    fn micro_lenses_by_row(&self) -> Vec<Vec<usize>> {
        let height = self.sensor.height_px as usize;
        let mut rows = vec![Vec::new(); height];
        for (i, lens) in self.array.lenses.iter().enumerate().filter(|(_, lens)| lens.alive) {
            let (center, radius) = self.outline(lens);
            for v in pixels_between(center.y - radius, center.y + radius, height) {
                rows[v].push(i);
            }
        }
        rows
    }

    /// Adds the light that comes through micro-lens `i` to the pixels of row `v`.
    fn expose(
        &self,
        i: usize,
        v: usize,
        board: Option<&PlacedTarget>,
        sets: &RaySets,
        seed: u64,
        sums: &mut [f64],
    ) {
        let lens = &self.array.lenses[i];
        let (center, radius) = self.outline(lens);
        let half = (radius * radius - (v as f64 - center.y).powi(2)).max(0.0).sqrt();
        for u in pixels_between(center.x - half, center.x + half, sums.len()) {
            let Some(bundle) = self.bundle(lens, u, v, board) else { continue };
            let points = sets.set(hash([seed, i as u64, u as u64, v as u64]));
            let light: f64 = if self.dust.touches(u, v) {
                let clear = |p: &&RayPoint| !self.dust.covers(u, v, p.pixel);
                points.iter().filter(clear).map(|p| self.light(lens, &bundle, p, board)).sum()
            } else {
                points.iter().map(|p| self.light(lens, &bundle, p, board)).sum()
            };
            sums[u] += light * bundle.area / points.len() as f64;
        }
    }

    /// The rays between a pixel and the pupil through one micro-lens; `None` if there are none.
    fn bundle(
        &self,
        lens: &MicroLens,
        u: usize,
        v: usize,
        board: Option<&PlacedTarget>,
    ) -> Option<Bundle> {
        let array = &self.array;
        let pixel = array.local(lens, &array.on_sensor(u as f64, v as f64));
        let pupil = array.local(lens, &Point3::new(0.0, 0.0, self.pupil.z));
        let (to_sensor, to_pupil) = (-pixel.z, pupil.z);
        let demagnification = lens.demagnification(to_sensor, to_pupil);
        // Everything in the plane of the micro-lens, times the demagnification, which may be 0.
        let place = pupil.xy() + pixel.xy() * (to_pupil / to_sensor);
        let stop = array.stop_radius * demagnification.abs();
        let pixel_reach = HALF_DIAGONAL * array.pixel_size * to_pupil / to_sensor;
        if place.norm() > (stop + self.pupil.radius + pixel_reach) * OUTLINE_MARGIN {
            return None;
        }
        let on_stop = stop <= self.pupil.radius;
        let radius =
            if on_stop { array.stop_radius } else { self.pupil.radius / demagnification.abs() };
        let local = board.and_then(|board| {
            // The ray through the middle of the pupil's picture, or its nearest point of the stop.
            let middle = if stop > 0.0 { place / demagnification } else { place };
            let within = (array.stop_radius / middle.norm()).min(1.0);
            let (ray, _) = self.through(lens, middle * within, &pixel);
            let about = |shift| Some(self.lens.about(ray.at(board.image_z(&ray, shift)?)));
            about(&about(&Vector2::zeros())?.shift())
        });
        let step = array.pixel_size;
        Some(Bundle {
            pixel,
            right: -array.axes.row(0).transpose() * step,
            down: -array.axes.row(1).transpose() * step,
            on_stop,
            area: std::f64::consts::PI * radius * radius,
            local,
        })
    }

    /// The ray from a point of the sensor through `on_lens` (both local) to the main lens, and the
    /// vector from sensor to micro-lens.
    #[inline]
    fn through(
        &self,
        lens: &MicroLens,
        on_lens: Vector2<f64>,
        pixel: &Vector3<f64>,
    ) -> (Ray, Vector3<f64>) {
        let inner = Vector3::new(on_lens.x - pixel.x, on_lens.y - pixel.y, -pixel.z);
        let outer = inner.xy() / inner.z - on_lens * lens.power;
        let direction = self.array.axes * Vector3::new(outer.x, outer.y, 1.0);
        let slope = direction.xy() / direction.z;
        let start = self.array.of_lens(lens, on_lens);
        (Ray { at_lens: start.xy().coords - slope * start.z, slope }, inner)
    }

    /// Whether a ray passes the exit pupil and the second stop.
    #[inline]
    pub(super) fn passes(&self, ray: &Ray) -> bool {
        self.pupil.passes(ray) && self.second_stop.is_none_or(|stop| stop.passes(ray))
    }

    /// Light along one ray of a bundle, per area of the micro-lens.
    #[inline]
    fn light(
        &self,
        lens: &MicroLens,
        bundle: &Bundle,
        point: &RayPoint,
        board: Option<&PlacedTarget>,
    ) -> f64 {
        let pixel = bundle.pixel + bundle.right * point.pixel[0] + bundle.down * point.pixel[1];
        let on_disc = Vector2::from(point.disc);
        let on_lens = if bundle.on_stop {
            on_disc * self.array.stop_radius
        } else {
            let aim = on_disc * self.pupil.radius;
            let aim = self.array.local(lens, &Point3::new(aim.x, aim.y, self.pupil.z));
            (aim.xy() - pixel.xy() * (aim.z / pixel.z)) / lens.demagnification(-pixel.z, aim.z)
        };
        let stop = self.array.stop_radius;
        if !bundle.on_stop && on_lens.norm_squared() > stop * stop {
            return 0.0;
        }
        let (ray, inner) = self.through(lens, on_lens, &pixel);
        if !self.passes(&ray) {
            return 0.0;
        }
        let radiance = board.map_or(1.0, |board| {
            let radiance = |local: &LocalDistortion| {
                let z = board.image_z(&ray, &local.shift())?;
                Some(board.radiance(&self.lens.object_ray(&ray, z, local)))
            };
            bundle.local.as_ref().and_then(radiance).unwrap_or_else(|| board.background())
        });
        // Irradiance through a small area of a plane parallel to the sensor: L cos⁴/distance².
        let z2 = inner.z * inner.z;
        let cos2 = z2 / inner.norm_squared();
        radiance * cos2 * cos2 / z2
    }
}

/// An error unless so many rays per pixel can be traced.
pub(super) fn check_rays(rays: u32) -> Result<()> {
    if (1..=MAX_RAYS).contains(&rays) {
        return Ok(());
    }
    Err(Error::invalid(format!("{rays} rays per pixel cannot be traced; give 1 to {MAX_RAYS}")))
}

/// Whole numbers between two positions, cut to those below `count`.
fn pixels_between(low: f64, high: f64, count: usize) -> std::ops::Range<usize> {
    #[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss)] // saturating, and cut below
    let (low, high) = (low.ceil().max(0.0) as usize, (high.floor() + 1.0).max(0.0) as usize);
    low..high.min(count).max(low)
}

#[cfg(test)]
mod tests;
