//! Rendering of images: the light along all rays from the pixels through the micro-lenses.

use nalgebra::{Vector2, Vector3};
use rayon::prelude::*;

use super::array::MicroLens;
use super::main_lens::Optics;
use super::ray::Ray;
use super::rays::{Block, Bundle, BundleIntegral, BundleTarget, Draw};
use super::sampling::{RaySets, hash};
use super::scene::{PlacedTarget, Scene};
use super::spread::{Footprint, half_width_px};
use super::thin_lens::Aim;
use super::tracer::{Tracer, check_rays};
use super::window::Window;
use crate::error::Result;
use crate::image::Image;

/// Margin of the outline of a micro-image. Tilt changes the outline by less than this; testing a few pixels too many is
/// cheap.
const OUTLINE_MARGIN: f64 = 1.02;

/// Number of neighbouring pixels that are tested together for one radiance.
const SIDE_BY_SIDE: usize = 8;
/// Bounds on the region of the board that a bundle reaches: the distances of the rays from the ends of the pixels and through
/// the rim of the micro-lens, times this factor, plus a number of squares. (In perspective, one side of a bundle reaches
/// further than the other: by 40 % if the depth of the board changes by a third across it.)
const SURELY: f64 = 1.4;
const SURELY_SQUARES: f64 = 0.01;

impl Tracer {
    /// Renders an image: the irradiance of every pixel relative to [`Tracer::reference_irradiance`], from
    /// `rays` rays for every pixel through every micro-lens that reaches it. `progress` is called after
    /// every finished row. The same seed gives the same image, for any number of threads.
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
        let array = &self.array;
        let sets = RaySets::new(rays, &Footprint::new(self.point_spread_px))
            .through(array.opening, array.normal_rad);
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

    /// Returns centre and radius (px) of the disc that light through a micro-lens can reach.
    pub(super) fn outline(&self, lens: &MicroLens) -> (Vector2<f64>, f64) {
        let center =
            self.array.to_pixel(&lens.center, &(self.lens.drawn.center - lens.center)).coords;
        (center, self.micro_image_radius_px(lens) * OUTLINE_MARGIN + self.pixel_reach_px())
    }

    /// Returns the largest distance from the middle of a pixel at which light that it records would arrive without point
    /// spread, px.
    fn pixel_reach_px(&self) -> f64 {
        half_width_px(self.point_spread_px) * std::f64::consts::SQRT_2
    }

    /// Returns, for every row of the image, the micro-lenses that reach it, in order.
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

    /// Adds the light through micro-lens `i` to the pixels of row `v`.
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
        let pixels = pixels_between(center.x - half, center.x + half, sums.len());
        let mut block = Block::new();
        for first in pixels.clone().step_by(SIDE_BY_SIDE) {
            let some = first..(first + SIDE_BY_SIDE).min(pixels.end);
            let middle = Vector2::new((some.start + some.end - 1) as f64 / 2.0, v as f64);
            let ray = self.between(lens, middle, Vector2::zeros());
            let aim = board.and_then(|board| self.lens.aim(&ray, board, None));
            let sees = match (board, &aim) {
                (None, _) => BundleTarget::Plain(1.0),
                (Some(board), None) => BundleTarget::Board(board),
                (Some(board), Some(aim)) => {
                    let plain = self.plain(lens, (middle, some.len()), aim, board);
                    plain.map_or(BundleTarget::Board(board), BundleTarget::Plain)
                }
            };
            for u in some {
                let aims_at =
                    if let BundleTarget::Board(board) = sees { Some(board) } else { None };
                let Some(bundle) = self.bundle(lens, u, v, aims_at, aim.as_ref()) else { continue };
                let set = sets.set(hash([seed, i as u64, u as u64, v as u64]));
                let block = &mut block;
                let gathering = BundleIntegral {
                    tracer: self,
                    lens,
                    bundle: &bundle,
                    set,
                    at: [u, v],
                    sees,
                    block,
                };
                sums[u] += gathering.light();
            }
        }
    }

    /// Returns the ray from a point of the image, px, through a point on a micro-lens, local, to the main lens.
    pub(super) fn between(
        &self,
        lens: &MicroLens,
        place: Vector2<f64>,
        on_lens: Vector2<f64>,
    ) -> Ray {
        let pixel = self.array.local(lens, &self.array.on_sensor(place.x, place.y));
        self.through(lens, on_lens, &pixel)
    }

    /// Returns the radiance that all rays from `pixels` neighbouring pixels, with the middle `middle`, see through a micro-lens
    /// and a thin main lens, if they certainly see one square, the border or the background of a flat board; `None` otherwise.
    /// `aim` belongs to the ray from the middle of the pixels through the middle of the micro-lens.
    pub(super) fn plain(
        &self,
        lens: &MicroLens,
        (middle, pixels): (Vector2<f64>, usize),
        aim: &Aim,
        board: &PlacedTarget,
    ) -> Option<f64> {
        let Optics::Thin(thin) = &self.lens.optics else { return None };
        if board.is_bent() {
            return None;
        }
        let none = Vector2::zeros();
        let [half_width, half_height] =
            [pixels as f64 / 2.0, 0.5].map(|half| half - 0.5 + self.pixel_reach_px());
        let place = |off_px: Vector2<f64>, on_lens: Vector2<f64>| {
            let ray = self.between(lens, middle + off_px, on_lens);
            let (outer, meets) = thin.object_ray(&ray, aim, thin.moves);
            meets.then(|| board.place(&outer))
        };
        let at = place(none, none)?;
        let mut reach = Vector2::repeat(SURELY_SQUARES);
        for axis in [Vector2::x(), Vector2::y()] {
            let half_px = axis.x * half_width + axis.y * half_height;
            let ends = [(axis * half_px, none), (none, axis * self.array.opening_reach)];
            for (off_px, on_lens) in ends {
                reach += (place(off_px, on_lens)? - at).abs() * SURELY;
            }
        }
        board.texture.radiance_between(&(at - reach), &(at + reach))
    }

    /// Returns the rays between a pixel and the pupil through one micro-lens; `None` if there are none. The search for
    /// their aim starts from the aim of a nearby ray, if given.
    pub(super) fn bundle(
        &self,
        lens: &MicroLens,
        u: usize,
        v: usize,
        board: Option<&PlacedTarget>,
        nearby: Option<&Aim>,
    ) -> Option<Bundle> {
        let array = &self.array;
        let pixel = array.local(lens, &array.on_sensor(u as f64, v as f64));
        let draw = self.draw(lens, &pixel, self.pixel_reach_px())?;
        let aim = board.and_then(|board| {
            // The ray through the middle of the projected pupil, or through the nearest point of the opening.
            let within = (array.opening_radius / draw.middle.norm()).min(1.0);
            let ray = self.through(lens, draw.middle * within, &pixel);
            self.lens.aim(&ray, board, nearby)
        });
        let [right, down] = array.pixel_steps();
        Some(Bundle { pixel, right, down, draw, aim })
    }

    /// Returns the region from which rays are drawn to all points within a distance of a point on the sensor (local); `None` if
    /// no ray through the micro-lens leads there.
    #[inline]
    pub(super) fn draw(
        &self,
        lens: &MicroLens,
        pixel: &Vector3<f64>,
        reach_px: f64,
    ) -> Option<Draw> {
        let array = &self.array;
        let drawn = &self.lens.drawn;
        let pupil = array.local(lens, &drawn.center);
        let (to_sensor, to_pupil) = (-pixel.z, pupil.z);
        let demagnification = lens.demagnification(to_sensor, to_pupil);
        // All lengths are in the plane of the micro-lens, times the demagnification, which may be 0.
        let place = pupil.xy() + pixel.xy() * (to_pupil / to_sensor);
        let stop = array.opening_reach * demagnification.abs();
        let pixel_reach = reach_px * array.pixel_size * to_pupil / to_sensor;
        if place.norm() > (stop + drawn.radius + pixel_reach) * OUTLINE_MARGIN {
            return None;
        }
        let on_opening = stop <= drawn.radius;
        let radius =
            if on_opening { array.opening_reach } else { drawn.radius / demagnification.abs() };
        // The other disc, in units of the disc that rays are drawn from.
        let window = if on_opening {
            let reach = (drawn.radius + pixel_reach) * OUTLINE_MARGIN;
            Window::about(place / (demagnification * array.opening_reach), reach / stop)
        } else {
            let reach = (stop + pixel_reach) * OUTLINE_MARGIN;
            let place = (array.axes * place.push(0.0)).xy();
            Window::about(-place / drawn.radius, reach / drawn.radius)
        };
        let opening = array.opening;
        let area = match window {
            Window::Disc if on_opening => opening.area() / opening.reach().powi(2),
            _ => window.area(),
        } * radius
            * radius;
        let middle = if stop > 0.0 { place / demagnification } else { place };
        Some(Draw { on_opening, window, area, middle })
    }

    /// Returns the ray from a point of the sensor through `on_lens` (both local) to the main lens.
    #[inline(always)]
    #[allow(clippy::inline_always)] // compiled for the registers of loops over rays
    pub(super) fn through(
        &self,
        lens: &MicroLens,
        on_lens: Vector2<f64>,
        pixel: &Vector3<f64>,
    ) -> Ray {
        // The ray comes from the pixel; the lens subtracts x/f from its slopes.
        let outer = (pixel.xy() - on_lens) * pixel.z.recip() - on_lens * lens.power;
        let axes = &self.array.axes;
        let along =
            |row: usize| axes[(row, 0)] * outer.x + axes[(row, 1)] * outer.y + axes[(row, 2)];
        let on_plane =
            |row: usize| lens.center[row] + axes[(row, 0)] * on_lens.x + axes[(row, 1)] * on_lens.y;
        let slope = Vector2::new(along(0), along(1)) * along(2).recip();
        Ray { at_lens: Vector2::new(on_plane(0), on_plane(1)) - slope * on_plane(2), slope }
    }

    /// Returns the point where the ray from a point of the sensor to `aim` crosses the micro-lens. `aim` counts from the middle
    /// of the opening that rays are drawn from.
    #[inline(always)]
    #[allow(clippy::inline_always)] // compiled for the registers of loops over rays
    pub(super) fn towards_pupil(
        &self,
        lens: &MicroLens,
        pixel: &Vector3<f64>,
        aim: Vector2<f64>,
    ) -> Vector2<f64> {
        let (axes, to) = (&self.array.axes, self.lens.drawn.center - lens.center);
        let (x, y) = (to.x + aim.x, to.y + aim.y);
        let local = |column: usize| {
            axes[(0, column)] * x + axes[(1, column)] * y + axes[(2, column)] * to.z
        };
        let z = local(2);
        let seen = Vector2::new(local(0), local(1)) - pixel.xy() * (z / pixel.z);
        seen * lens.demagnification(-pixel.z, z).recip()
    }
}

/// Returns the integers between two positions, limited to 0 up to `count`.
fn pixels_between(low: f64, high: f64, count: usize) -> std::ops::Range<usize> {
    #[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss)] // saturating, and cut below
    let (low, high) = (low.ceil().max(0.0) as usize, (high.floor() + 1.0).max(0.0) as usize);
    low..high.min(count).max(low)
}
