//! Renders images: the light along all rays from the pixels through the micro-lenses.

use nalgebra::{Vector2, Vector3};
use rayon::prelude::*;

use super::array::MicroLens;
use super::main_lens::{Optics, Passage, Refracts};
use super::ray::Ray;
use super::sampling::{RayPoint, RaySets, hash};
use super::scene::{PlacedTarget, Scene};
use super::spread::{Footprint, half_width_px};
use super::thin_lens::Aim;
use super::tracer::{Tracer, check_rays};
use super::window::Window;
use crate::error::Result;
use crate::image::Image;

/// Tilt changes the outline of a micro-image by less than this fraction; testing a few pixels too
/// many is cheap.
const OUTLINE_MARGIN: f64 = 1.02;

/// The rays between one pixel and one micro-lens, in local coordinates.
pub(super) struct Bundle {
    /// Middle of the pixel, and the steps to its neighbours.
    pub pixel: Vector3<f64>,
    pub right: Vector3<f64>,
    pub down: Vector3<f64>,
    /// Where its rays are drawn.
    pub draw: Draw,
    /// What its rays have in common behind a thin main lens, if they lead to the board.
    pub aim: Option<Aim>,
}

/// From where the rays to a place on the sensor, or to a pixel, are drawn.
pub(super) struct Draw {
    /// Whether rays are drawn on the opening of the micro-lens, or else on the pupil: on whichever is
    /// smaller, projected onto the plane of the micro-lens.
    pub on_opening: bool,
    /// Which part of it.
    pub window: Window,
    /// Area of that part, in the plane of the micro-lens.
    pub area: f64,
    /// The middle of the pupil, projected onto the plane of the micro-lens.
    middle: Vector2<f64>,
}

impl Tracer {
    /// Renders an image: irradiance of every pixel relative to [`Tracer::reference_irradiance`], from
    /// `rays` rays for every pixel through every micro-lens that reaches it. `progress` is called after
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
        let (width, height) = (self.sensor().width_px as usize, self.sensor().height_px as usize);
        let by_row = self.micro_lenses_by_row();
        let sets = RaySets::new(rays, &Footprint::new(self.point_spread_px));
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

    /// Centre and radius (px) of the disc that light through a micro-lens can reach.
    pub(super) fn outline(&self, lens: &MicroLens) -> (Vector2<f64>, f64) {
        let center =
            self.array.to_pixel(&lens.center, &(self.lens.drawn.center - lens.center)).coords;
        (center, self.micro_image_radius_px(lens) * OUTLINE_MARGIN + self.pixel_reach_px())
    }

    /// Largest distance from the middle of a pixel at which light would arrive that it records, px.
    fn pixel_reach_px(&self) -> f64 {
        half_width_px(self.point_spread_px) * std::f64::consts::SQRT_2
    }

    /// For every row of the image the micro-lenses that reach it, in order.
    fn micro_lenses_by_row(&self) -> Vec<Vec<usize>> {
        let height = self.sensor().height_px as usize;
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
            let light = match &self.lens.optics {
                Optics::Thin(thin) => self.gather(thin, lens, &bundle, points, [u, v], board),
                Optics::Real(real) => self.gather(real, lens, &bundle, points, [u, v], board),
            };
            sums[u] += light / points.len() as f64;
        }
    }

    /// The light along all rays of a bundle, but those that dust on pixel (u, v) stops, times the area that
    /// they are drawn from.
    fn gather<L: Refracts>(
        &self,
        optics: &L,
        lens: &MicroLens,
        bundle: &Bundle,
        points: &[RayPoint],
        [u, v]: [usize; 2],
        board: Option<&PlacedTarget>,
    ) -> f64 {
        let board = board.map(|board| (board, bundle.aim.as_ref()));
        let place =
            |p: &RayPoint| bundle.pixel + bundle.right * p.pixel[0] + bundle.down * p.pixel[1];
        let light = |p: &RayPoint| self.light(optics, lens, &place(p), &bundle.draw, p, board);
        // Over the reach of a point spread the overlap of both openings changes much: every ray has its own.
        let spread_light = |p: &RayPoint| {
            let pixel = place(p);
            let draw = self.draw(lens, &pixel, 0.0)?;
            Some(self.light(optics, lens, &pixel, &draw, p, board) * draw.area)
        };
        let dusty = self.dust.touches(u, v);
        let clear = |p: &&RayPoint| !(dusty && self.dust.covers(u, v, p.pixel));
        if self.point_spread_px > 0.0 {
            points.iter().filter(clear).filter_map(spread_light).sum()
        } else if dusty {
            points.iter().filter(clear).map(light).sum::<f64>() * bundle.draw.area
        } else {
            points.iter().map(light).sum::<f64>() * bundle.draw.area
        }
    }

    /// The rays between a pixel and the pupil through one micro-lens; `None` if there are none.
    pub(super) fn bundle(
        &self,
        lens: &MicroLens,
        u: usize,
        v: usize,
        board: Option<&PlacedTarget>,
    ) -> Option<Bundle> {
        let array = &self.array;
        let pixel = array.local(lens, &array.on_sensor(u as f64, v as f64));
        let draw = self.draw(lens, &pixel, self.pixel_reach_px())?;
        let aim = board.and_then(|board| {
            // The ray through the middle of the projected pupil, or the nearest point of the opening.
            let within = (array.opening_radius / draw.middle.norm()).min(1.0);
            let (ray, _) = self.through(lens, draw.middle * within, &pixel);
            self.lens.aim(&ray, board)
        });
        let step = array.pixel_size;
        Some(Bundle {
            pixel,
            right: -array.axes.row(0).transpose() * step,
            down: -array.axes.row(1).transpose() * step,
            draw,
            aim,
        })
    }

    /// Where rays are drawn to all places within a reach of one on the sensor (local); `None` if no ray
    /// through the micro-lens leads there.
    #[inline]
    fn draw(&self, lens: &MicroLens, pixel: &Vector3<f64>, reach_px: f64) -> Option<Draw> {
        let array = &self.array;
        let drawn = &self.lens.drawn;
        let pupil = array.local(lens, &drawn.center);
        let (to_sensor, to_pupil) = (-pixel.z, pupil.z);
        let demagnification = lens.demagnification(to_sensor, to_pupil);
        // All in the plane of the micro-lens, times the demagnification, which may be 0.
        let place = pupil.xy() + pixel.xy() * (to_pupil / to_sensor);
        let stop = array.opening_radius * demagnification.abs();
        let pixel_reach = reach_px * array.pixel_size * to_pupil / to_sensor;
        if place.norm() > (stop + drawn.radius + pixel_reach) * OUTLINE_MARGIN {
            return None;
        }
        let on_opening = stop <= drawn.radius;
        let radius =
            if on_opening { array.opening_radius } else { drawn.radius / demagnification.abs() };
        // The other disc, in units of the one that rays are drawn from.
        let window = if on_opening {
            let reach = (drawn.radius + pixel_reach) * OUTLINE_MARGIN;
            Window::about(place / (demagnification * array.opening_radius), reach / stop)
        } else {
            let reach = (stop + pixel_reach) * OUTLINE_MARGIN;
            let place = (array.axes * place.push(0.0)).xy();
            Window::about(-place / drawn.radius, reach / drawn.radius)
        };
        let area = window.area() * radius * radius;
        let middle = if stop > 0.0 { place / demagnification } else { place };
        Some(Draw { on_opening, window, area, middle })
    }

    /// The ray from a point of the sensor through `on_lens` (both local) to the main lens, and the
    /// vector from sensor to micro-lens.
    #[inline]
    pub(super) fn through(
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

    /// Light along one ray to a place on the sensor (local), per unit area of the micro-lens.
    #[inline]
    fn light<L: Refracts>(
        &self,
        optics: &L,
        lens: &MicroLens,
        pixel: &Vector3<f64>,
        draw: &Draw,
        point: &RayPoint,
        board: Option<(&PlacedTarget, Option<&Aim>)>,
    ) -> f64 {
        let Some(on_disc) = draw.window.place(point) else { return 0.0 };
        let on_lens = if draw.on_opening {
            on_disc * self.array.opening_radius
        } else {
            let drawn = &self.lens.drawn;
            let aim = drawn.center + (on_disc * drawn.radius).push(0.0);
            let aim = self.array.local(lens, &aim);
            (aim.xy() - pixel.xy() * (aim.z / pixel.z)) / lens.demagnification(-pixel.z, aim.z)
        };
        let stop = self.array.opening_radius;
        if !draw.on_opening && on_lens.norm_squared() > stop * stop {
            return 0.0;
        }
        let (ray, inner) = self.through(lens, on_lens, pixel);
        if !self.passes_second(&ray) {
            return 0.0;
        }
        let radiance = match board {
            None if optics.passes(&ray) => 1.0,
            None => return 0.0,
            Some((board, aim)) => match optics.follow(&ray, aim, board) {
                Passage::Blocked => return 0.0,
                Passage::Away => board.background(),
                Passage::Seen(outer) => board.radiance(&outer),
            },
        };
        self.fall_off.light(radiance, &inner, self.mla_to_sensor)
    }
}

/// Integers between two positions, limited to 0 up to `count`.
fn pixels_between(low: f64, high: f64, count: usize) -> std::ops::Range<usize> {
    #[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss)] // saturating, and cut below
    let (low, high) = (low.ceil().max(0.0) as usize, (high.floor() + 1.0).max(0.0) as usize);
    low..high.min(count).max(low)
}
