//! The light along all rays between a pixel and a micro-lens.
//!
//! Rays pass the stages in blocks. Each stage is a loop over short equations without branches, which the compiler turns into
//! operations on several rays at once.

// Only functions inlined into a dispatched one are compiled for its registers, and only loops of a constant number of rounds.
#![allow(clippy::inline_always, clippy::needless_range_loop)]

use std::ops::Range;

use nalgebra::{Vector2, Vector3};
use pulp::{Arch, NullaryFnOnce};

use super::array::MicroLens;
use super::imperfections::FallOffLaw;
use super::main_lens::Optics;
use super::ray::{Passage, Ray};
use super::real_lens::RealLens;
use super::sampling::{BLOCK, Points, RaySet};
use super::scene::PlacedTarget;
use super::thin_lens::{Aim, ThinMainLens};
use super::tracer::Tracer;
use super::window::Window;
use crate::model::Opening;

/// The rays between one pixel and one micro-lens, in local coordinates.
pub(super) struct Bundle {
    /// Middle of the pixel, and the steps to its neighbours.
    pub pixel: Vector3<f64>,
    pub right: Vector3<f64>,
    pub down: Vector3<f64>,
    /// Region from which the rays are drawn.
    pub draw: Draw,
    /// Data that the rays share behind a thin main lens, if they lead to the board.
    pub aim: Option<Aim>,
}

/// The region from which the rays to a point of the sensor, or to a pixel, are drawn.
pub(super) struct Draw {
    /// True if rays are drawn from the opening of the micro-lens, false if from the pupil: the smaller of both, projected onto
    /// the plane of the micro-lens.
    pub on_opening: bool,
    /// Part of the opening or the pupil.
    pub window: Window,
    /// Area of this part in the plane of the micro-lens.
    pub area: f64,
    /// Middle of the pupil, projected onto the plane of the micro-lens.
    pub middle: Vector2<f64>,
}

/// A block of rays, whose memory is reused.
pub(super) struct Block {
    /// Points on the sensor, local to the micro-lens.
    pixel: [[f64; BLOCK]; 3],
    /// Points on the micro-lens, local.
    on_lens: [[f64; BLOCK]; 2],
    /// Rays between micro-lens and main lens: the points where they cross z = 0, and their slopes.
    at_lens: [[f64; BLOCK]; 2],
    slope: [[f64; BLOCK]; 2],
    /// Light of the rays: at first the area that each is drawn from; 0 for a blocked ray.
    light: [f64; BLOCK],
}

/// The integral of the light over the rays of a bundle.
pub(super) struct BundleIntegral<'a> {
    pub tracer: &'a Tracer,
    pub lens: &'a MicroLens,
    pub bundle: &'a Bundle,
    pub set: RaySet<'a>,
    /// Column u and row v of the pixel.
    pub at: [usize; 2],
    pub sees: BundleTarget<'a>,
    /// Memory for the rays.
    pub block: &'a mut Block,
}

/// The scene that the rays of a bundle see if they pass the main lens.
#[derive(Clone, Copy)]
pub(super) enum BundleTarget<'a> {
    /// One radiance for all rays.
    Plain(f64),
    /// Board and background.
    Board(&'a PlacedTarget),
}

impl BundleIntegral<'_> {
    /// Returns the mean of the rays' light, each times the area that it is drawn from. Rays that dust blocks count as 0.
    pub fn light(self) -> f64 {
        Arch::new().dispatch(self)
    }
}

impl NullaryFnOnce for BundleIntegral<'_> {
    type Output = f64;

    #[inline(always)]
    fn call(self) -> f64 {
        let Self { tracer, lens, bundle, set, at: [u, v], sees, block } = self;
        let dusty = tracer.dust.touches(u, v);
        let mut sums = [0.0; BLOCK];
        for index in 0..set.blocks() {
            let points = set.block(index);
            block.start(&points, bundle);
            if dusty {
                block.clear_of_dust(tracer, &points, [u, v]);
            }
            if tracer.point_spread_px > 0.0 {
                block.draw_each(tracer, lens, &points);
            } else {
                block.draw_all(tracer, lens, &bundle.draw, &points);
            }
            block.refract(tracer, lens);
            if let Some(stop) = tracer.second_stop {
                block.keep(|ray| stop.passes(ray));
            }
            match (&tracer.lens.optics, sees) {
                (Optics::Thin(thin), BundleTarget::Plain(radiance)) => {
                    let pupil = thin.pupil;
                    block.keep(|ray| pupil.passes(ray));
                    block.see_plain(radiance);
                }
                (Optics::Thin(thin), BundleTarget::Board(board)) => {
                    block.see_through_thin(thin, bundle.aim.as_ref(), board);
                }
                (Optics::Real(real), BundleTarget::Plain(radiance)) => {
                    block.pass_real(real);
                    block.see_plain(radiance);
                }
                (Optics::Real(real), BundleTarget::Board(board)) => {
                    block.see_through_real(real, board);
                }
            }
            block.fall_off(tracer.fall_off, tracer.mla_to_sensor);
            for i in 0..BLOCK {
                sums[i] += block.light[i];
            }
        }
        sums.iter().sum::<f64>() / set.rays() as f64
    }
}

impl Block {
    /// Creates a block without rays.
    pub fn new() -> Self {
        let none = [0.0; BLOCK];
        Self {
            pixel: [none; 3],
            on_lens: [none; 2],
            at_lens: [none; 2],
            slope: [none; 2],
            light: none,
        }
    }

    /// Starts the rays from their points in a pixel.
    #[inline(always)]
    fn start(&mut self, points: &Points, bundle: &Bundle) {
        self.light = *points.share();
        for i in 0..BLOCK {
            let [x, y] = points.pixel(i);
            for axis in 0..3 {
                self.pixel[axis][i] =
                    bundle.pixel[axis] + bundle.right[axis] * x + bundle.down[axis] * y;
            }
        }
    }

    #[inline(always)]
    fn pixel(&self, i: usize) -> Vector3<f64> {
        Vector3::new(self.pixel[0][i], self.pixel[1][i], self.pixel[2][i])
    }

    #[inline(always)]
    fn ray(&self, i: usize) -> Ray {
        Ray {
            at_lens: Vector2::new(self.at_lens[0][i], self.at_lens[1][i]),
            slope: Vector2::new(self.slope[0][i], self.slope[1][i]),
        }
    }

    #[inline(always)]
    fn set_ray(&mut self, i: usize, ray: &Ray) {
        self.at_lens[0][i] = ray.at_lens.x;
        self.at_lens[1][i] = ray.at_lens.y;
        self.slope[0][i] = ray.slope.x;
        self.slope[1][i] = ray.slope.y;
    }

    #[inline(never)]
    fn clear_of_dust(&mut self, tracer: &Tracer, points: &Points, [u, v]: [usize; 2]) {
        for i in 0..BLOCK {
            if tracer.dust.covers(u, v, points.pixel(i)) {
                self.light[i] = 0.0;
            }
        }
    }

    /// Draws the rays from a separate region each. Within the reach of a point spread, the overlap of opening and pupil changes
    /// too much for one common region.
    #[inline(always)]
    fn draw_each(&mut self, tracer: &Tracer, lens: &MicroLens, points: &Points) {
        for i in 0..BLOCK {
            match tracer.draw(lens, &self.pixel(i), 0.0) {
                Some(draw) => self.draw(tracer, lens, &draw, points, i..i + 1),
                None => self.light[i] = 0.0,
            }
        }
    }

    #[inline(always)]
    fn draw_all(&mut self, tracer: &Tracer, lens: &MicroLens, draw: &Draw, points: &Points) {
        self.draw(tracer, lens, draw, points, 0..BLOCK);
    }

    /// Draws the points on the micro-lens. Each kind of window has its own loop.
    #[inline(always)]
    fn draw(
        &mut self,
        tracer: &Tracer,
        lens: &MicroLens,
        draw: &Draw,
        points: &Points,
        which: Range<usize>,
    ) {
        let array = &tracer.array;
        let radius = if draw.on_opening { array.opening_reach } else { tracer.lens.drawn.radius };
        match draw.window {
            Window::Disc if draw.on_opening => {
                for i in which.clone() {
                    let place = points.opening(i) * radius;
                    (self.on_lens[0][i], self.on_lens[1][i]) = (place.x, place.y);
                    self.light[i] *= draw.area;
                }
            }
            Window::Disc => self.place(Window::Disc, (radius, draw.area), points, which.clone()),
            Window::Rectangle { along, low, high, half } => {
                let window = Window::Rectangle { along, low, high, half };
                self.place(window, (radius, draw.area), points, which.clone());
            }
        }
        if !draw.on_opening {
            for i in which.clone() {
                let aim = Vector2::new(self.on_lens[0][i], self.on_lens[1][i]);
                let on_lens = tracer.towards_pupil(lens, &self.pixel(i), aim);
                self.on_lens[0][i] = on_lens.x;
                self.on_lens[1][i] = on_lens.y;
                let inside = on_lens.norm_squared() <= array.opening_reach.powi(2);
                self.light[i] = if inside { self.light[i] } else { 0.0 };
            }
        }
        if array.opening != Opening::Disc {
            for i in which {
                let open = array.is_open(Vector2::new(self.on_lens[0][i], self.on_lens[1][i]));
                self.light[i] = if open { self.light[i] } else { 0.0 };
            }
        }
    }

    /// Draws points in a window of a disc of a given radius; `area` is the area of the whole window.
    #[inline(always)]
    fn place(
        &mut self,
        window: Window,
        (radius, area): (f64, f64),
        points: &Points,
        which: Range<usize>,
    ) {
        for i in which {
            let (place, inside) = window.place(points.disc(i), points.square(i));
            self.on_lens[0][i] = place.x * radius;
            self.on_lens[1][i] = place.y * radius;
            self.light[i] = if inside { self.light[i] * area } else { 0.0 };
        }
    }

    /// Computes the rays between micro-lens and main lens.
    #[inline(always)]
    fn refract(&mut self, tracer: &Tracer, lens: &MicroLens) {
        for i in 0..BLOCK {
            let on_lens = Vector2::new(self.on_lens[0][i], self.on_lens[1][i]);
            let ray = tracer.through(lens, on_lens, &self.pixel(i));
            self.set_ray(i, &ray);
        }
    }

    /// Blocks the rays that do not pass.
    #[inline(always)]
    fn keep(&mut self, passes: impl Fn(&Ray) -> bool) {
        for i in 0..BLOCK {
            self.light[i] = if passes(&self.ray(i)) { self.light[i] } else { 0.0 };
        }
    }

    #[inline(always)]
    fn see_through_thin(&mut self, thin: &ThinMainLens, aim: Option<&Aim>, board: &PlacedTarget) {
        let pupil = thin.pupil;
        self.keep(|ray| pupil.passes(ray));
        match aim {
            Some(aim) if thin.moves => self.see_board(thin, aim, true, board),
            Some(aim) => self.see_board(thin, aim, false, board),
            None => self.see_plain(board.texture.background),
        }
    }

    #[inline(always)]
    fn see_plain(&mut self, radiance: f64) {
        for i in 0..BLOCK {
            self.light[i] *= radiance;
        }
    }

    /// Multiplies the light of the rays that pass the lens by the radiance of board or background.
    #[inline(always)]
    fn see_board(&mut self, thin: &ThinMainLens, aim: &Aim, moves: bool, board: &PlacedTarget) {
        let (mut meeting, mut radiance) = ([0.0; BLOCK], [0.0; BLOCK]);
        for i in 0..BLOCK {
            let (outer, meets) = thin.object_ray(&self.ray(i), aim, moves);
            self.set_ray(i, &outer);
            meeting[i] = if meets { 1.0 } else { 0.0 };
        }
        if board.is_bent() {
            for i in 0..BLOCK {
                radiance[i] = board.radiance(&self.ray(i));
            }
        } else {
            // A copy keeps both radiances in registers.
            let texture = board.texture;
            for i in 0..BLOCK {
                radiance[i] = texture.radiance(board.place(&self.ray(i)));
            }
        }
        for i in 0..BLOCK {
            let background = board.texture.background;
            self.light[i] *= if meeting[i] > 0.0 { radiance[i] } else { background };
        }
    }

    #[inline(never)]
    fn pass_real(&mut self, real: &RealLens) {
        for i in 0..BLOCK {
            if self.light[i] > 0.0 && !real.passes(&self.ray(i)) {
                self.light[i] = 0.0;
            }
        }
    }

    #[inline(never)]
    fn see_through_real(&mut self, real: &RealLens, board: &PlacedTarget) {
        for i in 0..BLOCK {
            if self.light[i] > 0.0 {
                self.light[i] *= match real.follow(&self.ray(i), board) {
                    Passage::Blocked => 0.0,
                    Passage::Away => board.texture.background,
                    Passage::Seen(outer) => board.radiance(&outer),
                };
            }
        }
    }

    /// Multiplies the light by the angular response at its angle of incidence. Each law has its own loop.
    #[inline(always)]
    fn fall_off(&mut self, law: FallOffLaw, distance: f64) {
        match law {
            FallOffLaw::Cos4 => self.fall_off_by(FallOffLaw::Cos4, distance),
            FallOffLaw::None => self.fall_off_by(FallOffLaw::None, distance),
            FallOffLaw::HalfResponseDeg(angle) => {
                self.fall_off_by(FallOffLaw::HalfResponseDeg(angle), distance);
            }
        }
    }

    #[inline(always)]
    fn fall_off_by(&mut self, law: FallOffLaw, distance: f64) {
        for i in 0..BLOCK {
            let inner = Vector3::new(
                self.on_lens[0][i] - self.pixel[0][i],
                self.on_lens[1][i] - self.pixel[1][i],
                -self.pixel[2][i],
            );
            self.light[i] = law.light(self.light[i], &inner, distance);
        }
    }
}
