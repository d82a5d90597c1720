//! Rays that reach the pixels of a micro-image, as a sum over nodes of the opening.
//!
//! A node is a normal distribution about a point w of the opening, with the variance c along an axis ([`super::quadrature`]). A
//! pixel collects light about its position p with the variance s², the sum of its square and the point spread. The points
//! y = p − q w in the pupil and o = p − ρ w in the sharp image are therefore normally distributed, with the variances s² + q² c
//! and s² + ρ² c and the covariance s² + ρ q c. The rim of the pupil truncates the distribution of y ([`Rim`]). The rest has
//! the part ⟨Φ⟩ of the light, a mean further inwards, a smaller variance, and a third moment; o follows by its covariance with
//! y. Edges of the board that are not sharp add the excess edge variance v to the variance of o.
//!
//! A corner of a checkerboard is the product of two steps from −1 to 1. Its mean over a node is the mean over a two-dimensional
//! normal distribution, with the terms of Edgeworth's series for the third moments and for the fourth cumulants of a square
//! pixel (across an edge at θ: −(sin⁴ θ + cos⁴ θ)/120). Derivatives neglect the third and fourth moments.

// Only functions inlined into a dispatched function are compiled for its registers.
#![allow(clippy::inline_always)]

use nalgebra::Vector2;
use pulp::{Arch, Simd, WithSimd};

use super::aberration::Bend;
use super::quadrature::Quadrature;
use super::response::{Obliquity, RayLight, Response};
use super::rim::{Cut, LEAST_PX2, Rim, Step};
use crate::model::Opening;
use crate::numerics::simd::Lanes;

/// Optics of a micro-image, which all of its rays share.
#[derive(Debug, Clone)]
pub(crate) struct Bundle {
    /// Blur radius ρ, px.
    rho: f32,
    /// Blur radius q of the pupil, px.
    q: f32,
    /// Radius a of the pupil, px.
    pupil: f32,
    /// Variance of a pixel with its point spread along an axis, px².
    pixel: f32,
    /// Excess edge variance v along an axis, px².
    wider: f32,
    /// Half the micro-image pitch, px, which converts w to px.
    half_pitch: f32,
    response: Response,
    bend: Bend<f32>,
    opening: Opening,
    /// Direction of the normal of a side of the opening: cosine and sine.
    normal: [f32; 2],
    quadrature: &'static Quadrature,
}

/// Corner of a checkerboard in the sharp image.
#[derive(Debug, Clone, Copy)]
pub(crate) struct CornerEdges {
    /// Position, px.
    pub place: Vector2<f64>,
    /// Directions of both edges, rad.
    pub angles: [f64; 2],
}

/// Quantities that the light of a corner depends on: the columns of [`CornerLight`], in this order.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Column {
    /// Mean of the product of both steps; the only column that is no derivative.
    Shape,
    /// Position of the corner along u and v, per px.
    U,
    V,
    /// Blur radius ρ, per px.
    BlurRadius,
    /// Excess edge variance v, per px².
    EdgeVariance,
    /// Blur radius q of the pupil with ρ held, per px.
    PupilBlurRadius,
    /// Radius a of the pupil, per px.
    Pupil,
    /// Variance of the point spread, per px².
    PointSpread,
    /// Decrease H of the angular response, per px⁻².
    FallOff,
    /// Aberrations over A, in the order of [`Bend`].
    Spherical,
    ComaU,
    ComaV,
    AstigmatismUU,
    AstigmatismUV,
}

/// Number of all columns, and of the columns up to the derivatives by position.
const COLUMNS: usize = 14;
const PLACE_COLUMNS: usize = 3;
/// Quantities that also change white light: q, a, the point spread and H.
const OF_LIGHT: [Column; 4] =
    [Column::PupilBlurRadius, Column::Pupil, Column::PointSpread, Column::FallOff];

/// Light of a corner relative to white light, by pixel, with its derivatives.
#[derive(Debug, Default)]
pub(crate) struct CornerLight {
    columns: [Vec<f32>; COLUMNS],
    /// Pixels that see only the first edge, only the second, and both, with the sign of the step that they do not see.
    on_edges: [Vec<(u32, f32)>; 3],
    /// Order in which the pixels are processed.
    order: Vec<(u32, u32)>,
}

impl CornerLight {
    /// Returns a column, by pixel.
    pub fn column(&self, column: Column) -> &[f32] {
        &self.columns[column as usize]
    }

    fn clear(&mut self, pixels: usize) {
        for column in &mut self.columns {
            column.clear();
            column.resize(pixels, 0.0);
        }
        for pixels in &mut self.on_edges {
            pixels.clear();
        }
    }
}

/// Values of the parameter `WHICH`: all derivatives, or only those by position.
const ALL: bool = true;
const OF_PLACE: bool = false;
/// Indices of [`CornerLight::on_edges`].
const FIRST: usize = 0;
const SECOND: usize = 1;
const BOTH: usize = 2;
/// Largest number of lanes of a register.
const MOST_LANES: usize = 16;
/// Distance from the blur of a pixel, in standard deviations, beyond which an edge has no effect on it.
const FAR: f32 = 3.0;
/// Distance inside the rim of the pupil, in standard deviations, from which the rim has no effect.
const WHOLE: f32 = 3.0;
/// Distance outside the rim, in standard deviations, beyond which no light is left: see [`Rim::cut`].
const NOTHING: f32 = 3.1;
/// Height of the strips in which pixels are processed together, px. Neighbours see the same nodes through the same part of the
/// pupil.
const STRIP_PX: f32 = 3.0;
/// Smallest white light, as a part of the whole, that a pixel is divided by.
const DARK: f32 = 1e-6;

impl Bundle {
    /// Creates the bundle of a point with the blur radius ρ, behind a pupil of radius a with the blur radius q, px. The
    /// variance of the point spread is along an axis, px².
    #[allow(clippy::cast_possible_truncation)] // single precision, as the light
    pub fn new(rho_px: f64, q_px: f64, pupil_px: f64, point_spread_px2: f64) -> Self {
        Self {
            rho: rho_px as f32,
            q: q_px as f32,
            pupil: pupil_px as f32,
            pixel: (1.0 / 12.0 + point_spread_px2) as f32,
            wider: 0.0,
            half_pitch: 0.0,
            response: Response::new(&Obliquity::default()),
            bend: Bend::none().in_single(),
            opening: Opening::Disc,
            normal: [1.0, 0.0],
            quadrature: Quadrature::of_blur(Opening::Disc, rho_px),
        }
    }

    /// Sets the opening of the micro-lens, with the direction of the normal of one of its sides, rad. Blur radii are half its
    /// width.
    #[allow(clippy::cast_possible_truncation)] // single precision, as the light
    pub fn through(self, opening: Opening, normal_rad: f64) -> Self {
        let normal = [normal_rad.cos() as f32, normal_rad.sin() as f32];
        let quadrature = Quadrature::of_blur(opening, self.rho.into());
        Self { opening, normal, quadrature, ..self }
    }

    /// Takes the fewest nodes, for positions to a few hundredths of a pixel.
    pub fn coarse(self) -> Self {
        Self { quadrature: Quadrature::coarsest(self.opening), ..self }
    }

    /// Sets the angular response.
    #[allow(clippy::cast_possible_truncation)] // single precision, as the light
    pub fn oblique(self, law: &Obliquity) -> Self {
        Self { half_pitch: law.half_pitch_px as f32, response: Response::new(law), ..self }
    }

    /// Sets the aberrations of the main lens.
    pub fn aberrated(self, bend: &Bend) -> Self {
        Self { bend: bend.in_single(), ..self }
    }

    /// Sets the excess edge variance along an axis, px².
    #[allow(clippy::cast_possible_truncation)] // single precision, as the light
    pub fn wider(self, px2: f64) -> Self {
        Self { wider: px2 as f32, ..self }
    }

    /// Computes the light of a corner at the pixel positions (x, y), and overwrites `light`.
    pub fn corner_light(&self, edges: &CornerEdges, x: &[f32], y: &[f32], light: &mut CornerLight) {
        light.clear(x.len());
        let edges = &Edges::new(edges);
        Arch::new().dispatch(OfCorner::<ALL> { bundle: self, edges, x, y, light });
    }

    /// Computes the light with derivatives by position alone; all others are 0.
    pub fn corner_shape(&self, edges: &CornerEdges, x: &[f32], y: &[f32], light: &mut CornerLight) {
        light.clear(x.len());
        let edges = &Edges::new(edges);
        Arch::new().dispatch(OfCorner::<OF_PLACE> { bundle: self, edges, x, y, light });
    }
}

/// Returns a key that orders pixels by strips, and from left to right in each.
#[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss)] // micro-images of some pixels
fn strip_place(x: f32, y: f32) -> u32 {
    let [strip, along] = [y / STRIP_PX, x].map(|x| (x + 4096.0).max(0.0) as u32);
    (strip << 16) | along
}

/// An edge of a corner.
#[derive(Clone, Copy)]
struct Edge {
    /// Sine and cosine of its direction.
    s: f32,
    c: f32,
    /// Fourth cumulant of points in a pixel across the edge, px⁴.
    fourth: f32,
}

/// The two edges of a corner.
struct Edges {
    place: [f32; 2],
    each: [Edge; 2],
    /// Cosine of the angle between them.
    cosine: f32,
    /// Mixed fourth cumulants of points in a pixel, px⁴, with the first edge three times, twice and once.
    mixed: [f32; 3],
}

impl Edges {
    #[allow(clippy::cast_possible_truncation)] // single precision, as the light
    fn new(corner: &CornerEdges) -> Self {
        let [[s1, c1], [s2, c2]] =
            corner.angles.map(|angle| [angle.sin() as f32, angle.cos() as f32]);
        // The cumulant along either axis of the pixel is −1/120, and the axes are independent.
        let fourth = |first: i32, second: i32| {
            -(s1.powi(first) * s2.powi(second) + c1.powi(first) * c2.powi(second)) / 120.0
        };
        Self {
            place: [corner.place.x as f32, corner.place.y as f32],
            each: [
                Edge { s: s1, c: c1, fourth: fourth(4, 0) },
                Edge { s: s2, c: c2, fourth: fourth(0, 4) },
            ],
            cosine: c1 * c2 + s1 * s2,
            mixed: [fourth(3, 1), fourth(2, 2), fourth(1, 3)],
        }
    }

    /// Returns the distances of a position from both edges.
    fn distances(&self, x: f32, y: f32) -> [f32; 2] {
        let (x, y) = (x - self.place[0], y - self.place[1]);
        self.each.map(|Edge { s, c, .. }| c * y - s * x)
    }
}

/// Second moments of a node, with covariances in standard deviations of the point in the pupil.
struct Moments {
    rim: Rim,
    /// Covariance of o with y, cov(o, y)/σ, and its derivatives by ρ, q and s².
    follows: f32,
    follows_by_rho: f32,
    follows_by_q: f32,
    follows_by_spread: f32,
    /// Variance of o along an axis, and one over its standard deviation.
    origin: f32,
    per_origin: f32,
    /// σ, 1/σ, and the derivative of σ² by q.
    spread: f32,
    per_spread: f32,
    variance_by_q: f32,
    /// Squared distance from the middle of the pupil, px², up to which its rim has no effect; negative if there is none.
    whole: f32,
    /// Square of the distance beyond which it leaves no light, px².
    none: f32,
}

impl Moments {
    fn new(bundle: &Bundle) -> Self {
        let Bundle { rho, q, pixel, wider, .. } = *bundle;
        let cell = bundle.quadrature.variance;
        let variance = pixel + q * q * cell;
        let per_spread = variance.sqrt().recip();
        let follows = (pixel + rho * q * cell) * per_spread;
        let by_variance = -0.5 * follows * per_spread * per_spread;
        let variance_by_q = 2.0 * q * cell;
        let inside = bundle.pupil - WHOLE * variance.sqrt();
        let outside = bundle.pupil + NOTHING * variance.sqrt();
        Self {
            rim: Rim::new(bundle.pupil, variance),
            follows,
            follows_by_rho: q * cell * per_spread,
            follows_by_q: rho * cell * per_spread + by_variance * variance_by_q,
            follows_by_spread: per_spread + by_variance,
            origin: pixel + wider + rho * rho * cell,
            per_origin: (pixel + wider + rho * rho * cell).max(LEAST_PX2).sqrt().recip(),
            spread: variance.sqrt(),
            per_spread,
            variance_by_q,
            whole: inside * inside.abs(),
            none: outside * outside,
        }
    }
}

struct OfCorner<'a, const WHICH: bool> {
    bundle: &'a Bundle,
    edges: &'a Edges,
    x: &'a [f32],
    y: &'a [f32],
    light: &'a mut CornerLight,
}

impl<const WHICH: bool> WithSimd for OfCorner<'_, WHICH> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) {
        let Self { bundle, edges, x, y, light } = self;
        let moments = Moments::new(bundle);
        // Beyond this distance from an edge, no ray of a pixel comes from its other side.
        let spread = moments.origin.sqrt() + moments.follows.abs();
        let reach = bundle.rho.abs() * bundle.quadrature.radius
            + FAR * spread
            + bundle.bend.largest(bundle.pupil);
        let CornerLight { columns, on_edges, order } = light;
        order.clear();
        order.extend((0_u32..).zip(x.iter().zip(y)).map(|(i, (&x, &y))| (strip_place(x, y), i)));
        order.sort_unstable();
        let shape = &mut columns[Column::Shape as usize];
        for &(_, pixel) in order.iter() {
            let i = pixel as usize;
            let [first, second] = edges.distances(x[i], y[i]);
            match [first.abs() > reach, second.abs() > reach] {
                [true, true] => shape[i] = first.signum() * second.signum(),
                [false, true] => on_edges[FIRST].push((pixel, second.signum())),
                [true, false] => on_edges[SECOND].push((pixel, first.signum())),
                [false, false] => on_edges[BOTH].push((pixel, 1.0)),
            }
        }
        for which in [FIRST, SECOND, BOTH] {
            let pixels = std::mem::take(&mut light.on_edges[which]);
            for some in pixels.chunks(S::F32_LANES) {
                let at = |of: &[f32]| {
                    let mut room = [0.0_f32; MOST_LANES];
                    for (place, (i, _)) in room.iter_mut().zip(some) {
                        *place = of[*i as usize];
                    }
                    Lanes::of(simd, simd.partial_load_f32s(&room[..S::F32_LANES]))
                };
                let columns = if which == BOTH {
                    of_corner::<S, WHICH, _>(simd, bundle, &moments, [at(x), at(y)], edges)
                } else {
                    let edge = &OneEdge { edge: edges.each[which], place: edges.place };
                    of_corner::<S, WHICH, _>(simd, bundle, &moments, [at(x), at(y)], edge)
                };
                let used = if WHICH == ALL { COLUMNS } else { PLACE_COLUMNS };
                let mut room = [0.0_f32; MOST_LANES];
                for (values, column) in columns.into_iter().zip(&mut light.columns).take(used) {
                    simd.partial_store_f32s(&mut room[..S::F32_LANES], values.register());
                    for (value, (i, sign)) in room.iter().zip(some) {
                        column[*i as usize] = value * sign;
                    }
                }
            }
            light.on_edges[which] = pixels;
        }
    }
}

/// Edges as a pixel sees them through a node.
struct Seen<S: Simd> {
    /// Mean of the product of their steps.
    shape: Lanes<S>,
    /// Derivatives by the position of the corner.
    by_u: Lanes<S>,
    by_v: Lanes<S>,
    /// Derivative by the variance of o in all directions.
    by_width: Lanes<S>,
    /// Derivative by the decrease of the variance across the rim of the pupil.
    by_narrower: Lanes<S>,
}

/// Points of the sharp image that the rays of a pixel through a node come from.
struct Rays<S: Simd> {
    /// Mean of o.
    mean: [Lanes<S>; 2],
    /// Variance of o along the rim, and its further decrease across the rim.
    variance: Lanes<S>,
    narrower: Lanes<S>,
    /// One over the standard deviation of o inside the rim.
    per_spread: Lanes<S>,
    /// Direction across the rim, outwards.
    outwards: [Lanes<S>; 2],
    cut: Cut<S>,
    /// Cube of cov(o, y)/σ.
    cubed: f32,
}

/// Steps in the sharp image.
trait Steps {
    /// Returns the light through a node. `INSIDE` is true if the rim of the pupil has no effect.
    fn seen<S: Simd, const INSIDE: bool>(&self, simd: S, rays: &Rays<S>) -> Seen<S>;
}

/// Single step: an edge far from the other one.
struct OneEdge {
    edge: Edge,
    place: [f32; 2],
}

/// Returns the components of the direction outwards across and along an edge, and the step of the edge, blurred by the rays.
#[inline(always)]
fn across<S: Simd, const INSIDE: bool>(
    simd: S,
    Edge { s, c, .. }: Edge,
    place: [f32; 2],
    rays: &Rays<S>,
) -> ([Lanes<S>; 2], Step<S>) {
    let [out_x, out_y] = rays.outwards;
    let (o_x, o_y) = (rays.mean[0] - place[0], rays.mean[1] - place[1]);
    let distance = o_y * c - o_x * s;
    if INSIDE {
        return ([out_x, out_y], Step::of_inverse(simd, distance, rays.per_spread));
    }
    let direction = [out_y * c - out_x * s, out_x * c + out_y * s];
    let variance = (rays.narrower * direction[0]).mul_from(direction[0], rays.variance);
    (direction, Step::new(simd, distance, variance))
}

impl Steps for OneEdge {
    #[inline(always)]
    fn seen<S: Simd, const INSIDE: bool>(&self, simd: S, rays: &Rays<S>) -> Seen<S> {
        let Self { edge, place } = *self;
        let ([n, t], step) = across::<S, INSIDE>(simd, edge, place, rays);
        let by_variance = step.second * 0.5;
        let (shape, by_narrower) = if INSIDE {
            (step.of_fourth_cumulant(edge.fourth), by_variance)
        } else {
            let third = rays.cut.third(rays.cubed, [n, t]);
            (step.of_cumulants(third, edge.fourth), by_variance * (n * n))
        };
        Seen {
            shape,
            by_u: step.first * edge.s,
            by_v: step.first * -edge.c,
            by_width: by_variance,
            by_narrower,
        }
    }
}

impl Steps for Edges {
    #[inline(always)]
    fn seen<S: Simd, const INSIDE: bool>(&self, simd: S, rays: &Rays<S>) -> Seen<S> {
        let Self { place, each: [first, second], cosine, mixed: [f31, f22, f13] } = *self;
        let ([n1, t1], a) = across::<S, INSIDE>(simd, first, place, rays);
        let ([n2, t2], b) = across::<S, INSIDE>(simd, second, place, rays);
        let (n11, n22, n12) = (n1 * n1, n2 * n2, n1 * n2);
        let (both, product) = if INSIDE {
            let product = a.of_fourth_cumulant(first.fourth) * b.of_fourth_cumulant(second.fourth);
            (rays.variance * cosine, product)
        } else {
            let [third_1, third_2, mixed_1, mixed_2] =
                rays.cut.thirds(rays.cubed, [n1, t1], [n2, t2]);
            let product = a.of_cumulants(third_1, first.fourth)
                * b.of_cumulants(third_2, second.fourth)
                + (mixed_1 * a.second * b.first + mixed_2 * a.first * b.second) * 0.5;
            (rays.variance * cosine - rays.narrower * n12, product)
        };
        let shape = product
            + both * a.first * b.first
            + (both * both * 0.5 + 0.25 * f22) * a.second * b.second
            + (a.third * b.first * f31 + a.first * b.third * f13) * (1.0 / 6.0);
        // Derivatives by the distances from both edges, and by their variances and covariance.
        let by_1 = a.first * b.value + both * a.second * b.first;
        let by_2 = a.value * b.first + both * a.first * b.second;
        let by_11 = (a.second * b.value + both * a.third * b.first) * 0.5;
        let by_22 = (a.value * b.second + both * a.first * b.third) * 0.5;
        let by_12 = a.first * b.first + both * a.second * b.second;
        let by_width = by_11 + by_22 + by_12 * cosine;
        Seen {
            shape,
            by_u: by_1 * first.s + by_2 * second.s,
            by_v: -(by_1 * first.c + by_2 * second.c),
            by_width,
            by_narrower: if INSIDE { by_width } else { by_11 * n11 + by_22 * n22 + by_12 * n12 },
        }
    }
}

/// Sums over the nodes, for some pixels.
struct NodeSums<S: Simd> {
    white: Lanes<S>,
    /// Derivatives of white light by the quantities of [`OF_LIGHT`].
    white_by: [Lanes<S>; OF_LIGHT.len()],
    columns: [Lanes<S>; COLUMNS],
}

/// Rays of some pixels through a node.
struct NodeRays<S: Simd> {
    ray: RayLight<S>,
    /// Weight of the node.
    weight: f32,
    /// Mean points in the pixel and in the opening; their brighter sides have more weight.
    p: [Lanes<S>; 2],
    w: [Lanes<S>; 2],
    /// Mean point in the pupil, and its squared distance from the middle.
    y: [Lanes<S>; 2],
    square: Lanes<S>,
}

/// Computes the columns of some pixels.
#[inline(always)]
fn of_corner<S: Simd, const WHICH: bool, E: Steps>(
    simd: S,
    bundle: &Bundle,
    moments: &Moments,
    [x, y]: [Lanes<S>; 2],
    edges: &E,
) -> [Lanes<S>; COLUMNS] {
    let Bundle { q, pixel, half_pitch, normal: [cos, sin], .. } = *bundle;
    let in_cell = bundle.quadrature.variance * half_pitch;
    let zero = Lanes::splat(simd, 0.0);
    let mut sums =
        NodeSums { white: zero, white_by: [zero; OF_LIGHT.len()], columns: [zero; COLUMNS] };
    for node in &bundle.quadrature.nodes {
        let [node_x, node_y] = [node.x * cos - node.y * sin, node.x * sin + node.y * cos];
        let ray = bundle.response.light(simd, [x + node_x * half_pitch, y + node_y * half_pitch]);
        // The brighter side of the pixel and of the node has more weight.
        let [by_x, by_y] = ray.gradient;
        let p = [by_x.mul_add_scalar(pixel, x), by_y.mul_add_scalar(pixel, y)];
        let w = [by_x * in_cell + node_x, by_y * in_cell + node_y];
        let y = [p[0] - w[0] * q, p[1] - w[1] * q];
        let square = y[0].mul_add(y[0], y[1] * y[1]);
        if square.smallest() > moments.none {
            continue;
        }
        let rays = NodeRays { ray, weight: node.weight, p, w, y, square };
        // Most points are so far inside the pupil that its rim has no effect.
        if square.largest() < moments.whole {
            sums.add::<WHICH, true, E>(simd, bundle, moments, &rays, edges);
        } else {
            sums.add::<WHICH, false, E>(simd, bundle, moments, &rays, edges);
        }
    }
    let NodeSums { white, white_by, mut columns } = sums;
    relative_to_white(&mut columns, white.max(Lanes::splat(simd, DARK)).recip(), &white_by);
    columns
}

impl<S: Simd> NodeSums<S> {
    /// Adds the light of some pixels through a node. `INSIDE` is true if the rim of the pupil has no effect.
    #[inline(always)]
    fn add<const WHICH: bool, const INSIDE: bool, E: Steps>(
        &mut self,
        simd: S,
        bundle: &Bundle,
        moments: &Moments,
        node: &NodeRays<S>,
        edges: &E,
    ) {
        let Bundle { rho, pixel, half_pitch, .. } = *bundle;
        let NodeRays { ray, weight, p: [p_x, p_y], w: [w_x, w_y], y: [y_x, y_y], square } = node;
        let (w_x, w_y) = (*w_x, *w_y);
        let cell = bundle.quadrature.variance;
        let follows = moments.follows;
        let (squared, cubed) = (follows * follows, follows * follows * follows);
        let (cut, outwards) = if INSIDE {
            (Cut::none(simd), [Lanes::splat(simd, 0.0); 2])
        } else {
            let from_middle = square.max(Lanes::splat(simd, 1e-6)).sqrt();
            let inverse = from_middle.recip();
            (moments.rim.cut(simd, from_middle), [*y_x * inverse, *y_y * inverse])
        };
        let light = if INSIDE { ray.light * *weight } else { ray.light * cut.visible * *weight };

        // The aberrations are taken at the mean point of the pupil that the light passes.
        let in_pupil = if INSIDE {
            [*y_x, *y_y]
        } else {
            let inwards = cut.mean * moments.spread;
            [*y_x - inwards * outwards[0], *y_y - inwards * outwards[1]]
        };
        let bent = bent(simd, &bundle.bend, in_pupil);
        let mut mean = [*p_x - w_x * rho, *p_y - w_y * rho];
        let inwards = cut.mean * follows;
        for i in 0..2 {
            mean[i] = mean[i] + bent[i];
            if !INSIDE {
                mean[i] = mean[i] - inwards * outwards[i];
            }
        }
        let origin = Lanes::splat(simd, moments.origin);
        let (variance, narrower) = if INSIDE {
            (origin, cut.narrower)
        } else {
            (origin - cut.sideways * squared, cut.narrower * squared)
        };
        let per_spread = Lanes::splat(simd, moments.per_origin);
        let rays = Rays { mean, variance, narrower, per_spread, outwards, cut, cubed };
        let Seen { shape, by_u, by_v, by_width, by_narrower } =
            edges.seen::<S, INSIDE>(simd, &rays);
        let cut = &rays.cut;
        let columns = &mut self.columns;
        self.white = self.white + light;
        columns[0] = light.mul_add(shape, columns[0]);
        columns[1] = light.mul_add(by_u, columns[1]);
        columns[2] = light.mul_add(by_v, columns[2]);
        if WHICH == OF_PLACE {
            return;
        }
        let by_place = [by_u, by_v];
        let by_within = ray.by_within.mul_add(
            shape,
            by_origin(by_place, ray.gradient_by_within) * (pixel - rho * cell * half_pitch),
        );
        let mut by_rho = by_origin(by_place, [-w_x, -w_y]) + by_width * (2.0 * rho * cell);
        let mut of_light = [by_width, by_within];
        if !INSIDE {
            let outwards = by_origin(by_place, outwards);
            // Derivative by the decreases of the variances that the rim causes.
            let by_cut = cut.sideways * by_width + cut.narrower * by_narrower;
            // Derivative by cov(o, y)/σ.
            let by_follows = -(outwards * cut.mean) - by_cut * (2.0 * follows);
            let by_distance = outwards * cut.mean_by_distance() * (-follows);
            by_rho = by_rho + by_follows * moments.follows_by_rho;
            // Derivatives of z by q, a and the point spread.
            let (z_by_pupil, z_by_variance) = moments.rim.derivatives(cut.distance);
            let z_by_q = (w_x * rays.outwards[0] + w_y * rays.outwards[1]) * moments.per_spread
                + z_by_variance * moments.variance_by_q;
            // λ is the derivative of ln ⟨Φ⟩.
            let light_by = [cut.mean * z_by_q, cut.mean * z_by_pupil, cut.mean * z_by_variance];
            let shape_by = [
                by_follows * moments.follows_by_q + by_distance * z_by_q,
                by_distance * z_by_pupil,
                by_follows * moments.follows_by_spread + by_distance * z_by_variance + by_width,
            ];
            let cut_by = [Column::PupilBlurRadius, Column::Pupil];
            for (k, column) in cut_by.into_iter().enumerate() {
                let column = &mut columns[column as usize];
                *column = light.mul_add(light_by[k].mul_add(shape, shape_by[k]), *column);
            }
            of_light[0] = light_by[2].mul_add(shape, shape_by[2]);
            for (sum, by) in self.white_by.iter_mut().zip(light_by) {
                *sum = light.mul_add(by, *sum);
            }
        }
        self.white_by[3] = light.mul_add(ray.by_within, self.white_by[3]);
        let values = [
            (Column::BlurRadius, by_rho),
            (Column::EdgeVariance, by_width),
            (Column::PointSpread, of_light[0]),
            (Column::FallOff, of_light[1]),
        ];
        for (column, value) in values {
            let column = &mut columns[column as usize];
            *column = light.mul_add(value, *column);
        }
        let by_bend = by_bend(&bundle.bend, in_pupil, by_place);
        for (column, value) in columns[Column::Spherical as usize..].iter_mut().zip(by_bend) {
            *column = light.mul_add(value, *column);
        }
    }
}

/// Divides sums of light by white light, which depends on the quantities of [`OF_LIGHT`] too.
#[inline(always)]
fn relative_to_white<S: Simd>(
    columns: &mut [Lanes<S>; COLUMNS],
    per_white: Lanes<S>,
    white_by: &[Lanes<S>; OF_LIGHT.len()],
) {
    for column in columns.iter_mut() {
        *column = *column * per_white;
    }
    let shape = columns[Column::Shape as usize];
    for k in 0..OF_LIGHT.len() {
        let column = &mut columns[OF_LIGHT[k] as usize];
        *column = (white_by[k] * per_white).mul_from(shape, *column);
    }
}

/// Returns E/A at a point of the pupil, px: see [`super::Aberration`].
#[inline(always)]
fn bent<S: Simd>(simd: S, bend: &Bend<f32>, [x, y]: [Lanes<S>; 2]) -> [Lanes<S>; 2] {
    let [spherical, coma_u, coma_v, uu, uv] = bend.coefficients.into();
    let square = x.mul_add(x, y * y);
    let along = x * coma_u + y * coma_v;
    let common = (square - bend.zone2) * spherical + (along + along);
    let [coma_u, coma_v, uu, uv] = [coma_u, coma_v, uu, uv].map(|value| Lanes::splat(simd, value));
    [
        x.mul_add(common + uu, square.mul_add(coma_u, y * uv)),
        y.mul_add(common - uu, square.mul_add(coma_v, x * uv)),
    ]
}

/// Returns the derivatives by the aberrations over A, in the order of [`Bend`], from the derivatives by the position of the
/// corner.
#[inline(always)]
fn by_bend<S: Simd>(
    bend: &Bend<f32>,
    [x, y]: [Lanes<S>; 2],
    [by_u, by_v]: [Lanes<S>; 2],
) -> [Lanes<S>; 5] {
    let square = x.mul_add(x, y * y);
    let (x_by_u, y_by_v) = (x * by_u, y * by_v);
    let radial = -(x_by_u + y_by_v);
    let twice = radial + radial;
    [
        radial * (square - bend.zone2),
        x * twice - square * by_u,
        y * twice - square * by_v,
        y_by_v - x_by_u,
        -(y * by_u + x * by_v),
    ]
}

/// Returns the derivative by a motion of the point o, from the derivatives by the position of the corner.
#[inline(always)]
fn by_origin<S: Simd>(by_place: [Lanes<S>; 2], moved: [Lanes<S>; 2]) -> Lanes<S> {
    -by_place[0].mul_add(moved[0], by_place[1] * moved[1])
}

#[cfg(test)]
mod tests {
    use nalgebra::{Matrix2, Matrix4, Vector4};

    use super::super::Aberration;
    use super::super::oracle::{Oracle, corners_at};
    use super::*;

    fn edges() -> CornerEdges {
        CornerEdges { place: Vector2::new(3.1, -2.4), angles: [0.35, 1.8] }
    }

    fn places(oracle: &Oracle) -> [Vec<f32>; 2] {
        #[allow(clippy::cast_possible_truncation)] // single precision, as the light
        [0, 1].map(|i| oracle.pixels().iter().map(|p| p[i] as f32).collect())
    }

    fn light(bundle: &Bundle, edges: &CornerEdges, [x, y]: &[Vec<f32>; 2]) -> CornerLight {
        let mut light = CornerLight::default();
        bundle.corner_light(edges, x, y, &mut light);
        light
    }

    /// Fits corners to exact light. Returns the mean outward error of position over several directions, px, and the errors of
    /// ln |ρ| alone, and of ln |ρ| and v together, with positions and levels free.
    fn errors(oracle: &Oracle, distance: f64) -> [f64; 4] {
        let (pixels, corners, places) = (oracle.pixels(), corners_at(distance), places(oracle));
        let exact: Vec<(f64, Vec<f64>)> =
            pixels.iter().map(|p| oracle.of_pixel(*p, &corners)).collect();
        let brightest = exact.iter().map(|(white, _)| *white).fold(0.0, f64::max);
        let (mut outwards, mut information, mut right) = (0.0, Matrix2::zeros(), Vector2::zeros());
        for (c, corner) in corners.iter().enumerate() {
            let light = light(&oracle.bundle(), corner, &places);
            let column = |column: Column, i: usize| f64::from(light.column(column)[i]);
            let (mut normal, mut first) = (Matrix4::zeros(), Vector4::zeros());
            let (mut mixed, mut own) = (nalgebra::Matrix4x2::zeros(), Matrix2::zeros());
            let mut second = Vector2::zeros();
            for (i, (white, sums)) in exact.iter().enumerate() {
                // The detection weights pixels in the same way.
                let part = white / brightest;
                if part < 0.06 {
                    continue;
                }
                let weight = part * part / (0.25 + part);
                let shape = column(Column::Shape, i);
                let row = Vector4::new(column(Column::U, i), column(Column::V, i), 1.0, shape);
                let wide =
                    Vector2::new(column(Column::BlurRadius, i), column(Column::EdgeVariance, i));
                let residual = sums[c] / white - shape;
                normal += row * row.transpose() * weight;
                first += row * residual * weight;
                mixed += row * wide.transpose() * weight;
                own += wide * wide.transpose() * weight;
                second += wide * residual * weight;
            }
            let inverse = normal.try_inverse().unwrap();
            let moved = inverse * first;
            outwards += moved.xy().dot(&corner.place) / distance / corners.len() as f64;
            information += own - mixed.transpose() * inverse * mixed;
            right += second - mixed.transpose() * moved;
        }
        let both = information.try_inverse().unwrap() * right;
        [outwards, right.x / information[(0, 0)] / oracle.rho, both.x / oracle.rho, both.y]
    }

    /// Checks the errors of corners and blur radii up to 4 px, for pupils that cut micro-images and for others.
    #[test]
    fn exact_light_has_the_place_and_the_blur_radius_that_it_has() {
        for (rho, q, pupil, of_pixels_per_px2) in [
            (-3.4, -4.19, 20.0, 0.0),
            (-4.2, -5.1, 6.48, 0.0),
            (-2.1, -4.2, 6.48, 0.0),
            (3.0, 4.0, 6.5, 0.0),
            (4.2, 5.1, 20.0, 1.5e-3),
            (1.0, 2.0, 7.5, 0.0),
        ] {
            for distance in [1.0, 3.0, 5.0] {
                let oracle = Oracle { rho, q, pupil, of_pixels_per_px2, ..Oracle::default() };
                let [outwards, known, free, wider] = errors(&oracle, distance);
                println!("{rho} {distance}: {outwards:.4} px, {known:.4} {free:.4} {wider:.4} px²");
                assert!(outwards.abs() < 0.004, "{outwards} px at {distance} for {rho}");
                assert!(known.abs() < 0.0025, "{known} at {distance} for {rho}");
                assert!(free.abs() < 0.0025, "{free} at {distance} for {rho}");
                assert!(wider.abs() < 0.02, "{wider} px² at {distance} for {rho}");
            }
        }
    }

    #[test]
    fn exact_light_of_hexagons_and_squares() {
        for (opening, rho, q, pupil, point_spread_px2) in [
            (Opening::Hexagon, -3.4, -4.19, 20.0, 0.0),
            (Opening::Hexagon, -4.2, -5.1, 6.48, 0.0),
            (Opening::Hexagon, 2.0, 3.0, 6.5, 0.25),
            (Opening::Square, -3.4, -4.19, 20.0, 0.0),
            (Opening::Square, -3.4, -4.19, 6.48, 0.16),
            (Opening::Square, 2.0, 3.0, 6.5, 0.0),
        ] {
            for distance in [1.0, 3.0, 5.0] {
                let normal_rad = 0.2;
                let oracle = Oracle {
                    rho,
                    q,
                    pupil,
                    point_spread_px2,
                    opening,
                    normal_rad,
                    of_pixel: if point_spread_px2 > 0.0 { 12 } else { 8 },
                    ..Oracle::default()
                };
                let [outwards, known, free, wider] = errors(&oracle, distance);
                println!(
                    "{opening:?} {rho} {distance}: {outwards:.4} px, {known:.4} {free:.4} {wider:.4} px²"
                );
                assert!(outwards.abs() < 0.005, "{outwards} px at {distance} for {opening:?}");
                assert!(known.abs() < 0.0025, "{known} at {distance} for {opening:?}");
                assert!(free.abs() < 0.0025, "{free} at {distance} for {opening:?}");
                assert!(wider.abs() < 0.02, "{wider} px² at {distance} for {opening:?}");
            }
        }
    }

    #[test]
    fn light_with_a_point_spread_too() {
        for (rho, q, pupil, point_spread_px2, limit) in [
            (-4.2, -5.1, 6.48, 0.09, 0.004),
            (-4.2, -5.1, 6.48, 0.25, 0.005),
            (-3.4, -4.19, 20.0, 1.0, 0.004),
            (-3.4, -4.19, 6.48, 1.0, 0.007),
            (2.0, 1.5, 9.0, 1.0, 0.004),
        ] {
            let of_pixel = if point_spread_px2 > 0.5 { 18 } else { 12 };
            let rings = 12;
            let oracle =
                Oracle { rho, q, pupil, point_spread_px2, of_pixel, rings, ..Oracle::default() };
            for distance in [1.0, 5.0] {
                let [outwards, known, free, wider] = errors(&oracle, distance);
                println!(
                    "{rho} {point_spread_px2} {distance}: {outwards:.4} px, {known:.4} {free:.4} {wider:.4} px²"
                );
                assert!(outwards.abs() < limit, "{outwards} px at {distance} for {rho}");
                assert!(known.abs() < 0.003, "{known} at {distance} for {rho}");
                assert!(wider.abs() < 0.06, "{wider} px² at {distance} for {rho}");
            }
        }
    }

    /// Column, step of its quantity, light with the quantity changed by a step, and largest relative error of the column.
    type Change<'a> = (Column, f64, &'a dyn Fn(f64) -> CornerLight, f64);

    /// Compares derivatives with differences of the light, as the root mean square over all pixels. They neglect third and
    /// fourth moments.
    #[test]
    fn derivatives_are_those_of_the_light() {
        let oracle = Oracle { point_spread_px2: 0.1, ..Oracle::default() };
        let places = places(&oracle);
        let zone2 = Aberration::none(Vector2::zeros(), oracle.pupil).zone_px2;
        let bend = |coefficients: [f64; 5]| Bend { zone2, coefficients: coefficients.into() };
        let known = [-5e-5, -1e-4, 7.5e-5, 8e-3, -6e-3];
        let all = |rho: f64, q: f64, pupil: f64, spread: f64, within: f64, wider: f64| {
            let law = Obliquity { within_per_px2: within, ..oracle.law() };
            Bundle::new(rho, q, pupil, spread).oblique(&law).aberrated(&bend(known)).wider(wider)
        };
        let Oracle { rho, q, pupil, .. } = oracle;
        let within = oracle.law().within_per_px2;
        let with = |by: [f64; 6]| {
            let [of_rho, of_q, of_pupil, of_spread, of_within, of_wider] = by;
            all(
                rho + of_rho,
                q + of_q,
                pupil + of_pupil,
                0.1 + of_spread,
                within + of_within,
                0.05 + of_wider,
            )
        };
        let aberrated = |i: usize, by: f64| {
            let mut coefficients = known;
            coefficients[i] += by;
            with([0.0; 6]).aberrated(&bend(coefficients))
        };
        let still = with([0.0; 6]);
        let found = light(&still, &edges(), &places);
        let moved = |by: Vector2<f64>| CornerEdges { place: edges().place + by, ..edges() };
        let one = |i: usize, step: f64| {
            let mut by = [0.0; 6];
            by[i] = step;
            with(by)
        };
        let changes: [Change; 13] = [
            (Column::U, 0.02, &|s| light(&still, &moved(Vector2::x() * s), &places), 0.03),
            (Column::V, 0.02, &|s| light(&still, &moved(Vector2::y() * s), &places), 0.03),
            (Column::BlurRadius, 0.02, &|s| light(&one(0, s), &edges(), &places), 0.05),
            (Column::PupilBlurRadius, 0.02, &|s| light(&one(1, s), &edges(), &places), 0.1),
            (Column::Pupil, 0.02, &|s| light(&one(2, s), &edges(), &places), 0.1),
            (Column::PointSpread, 0.01, &|s| light(&one(3, s), &edges(), &places), 0.1),
            (Column::FallOff, 2e-4, &|s| light(&one(4, s), &edges(), &places), 0.12),
            (Column::EdgeVariance, 0.01, &|s| light(&one(5, s), &edges(), &places), 0.1),
            (Column::Spherical, 1e-5, &|s| light(&aberrated(0, s), &edges(), &places), 0.05),
            (Column::ComaU, 4e-5, &|s| light(&aberrated(1, s), &edges(), &places), 0.05),
            (Column::ComaV, 4e-5, &|s| light(&aberrated(2, s), &edges(), &places), 0.05),
            (Column::AstigmatismUU, 1e-3, &|s| light(&aberrated(3, s), &edges(), &places), 0.05),
            (Column::AstigmatismUV, 1e-3, &|s| light(&aberrated(4, s), &edges(), &places), 0.05),
        ];
        for (column, step, changed, limit) in changes {
            let (more, less) = (changed(step), changed(-step));
            let (mut squares, mut errors) = (0.0, 0.0);
            for i in 0..places[0].len() {
                let shape = |light: &CornerLight| f64::from(light.column(Column::Shape)[i]);
                let expected = (shape(&more) - shape(&less)) / (2.0 * step);
                squares += expected * expected;
                errors += (f64::from(found.column(column)[i]) - expected).powi(2);
            }
            let part = (errors / squares).sqrt();
            println!("{column:?}: {part:.4}");
            assert!(part < limit, "{column:?}: {part} of its size");
        }
    }
}
