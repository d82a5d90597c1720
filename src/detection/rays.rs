//! The rays that arrive at the pixels of a micro-image, and means over them.

// Only what is inlined into a dispatched function is compiled for its registers.
#![allow(clippy::inline_always)]

use pulp::Simd;

use super::patch::Patch;
use super::simd::Lanes;
use crate::vignetting::{POINTS, ROOM};

/// The rays that arrive at the pixels of a micro-image.
#[derive(Debug)]
pub(super) enum Rays {
    /// A single one at each pixel (x, y): steps rise over 1 px to either side.
    Sharp { x: Vec<f32>, y: Vec<f32> },
    /// Those through all points of the micro-lens, by pixel.
    Blurred(Vec<PixelRays>),
}

/// What the points of the micro-lens show to a pixel. Those in the room behind the [`POINTS`] show nothing: the step that
/// they see is 0.
#[derive(Debug, Clone, Copy)]
pub(super) struct PixelRays {
    /// Where in the sharp and straightened image the light comes from, p − ρ w + E/A: (x, y) from the centre of the
    /// micro-image, px.
    pub origin_x: [f32; ROOM],
    pub origin_y: [f32; ROOM],
    /// Where in the pupil, p − qᵢ w.
    pub pupil_x: [f32; ROOM],
    pub pupil_y: [f32; ROOM],
    /// One over half the width over which a step rises by what the point leaves out, which is the extent of its cell and of
    /// the pixel, px⁻¹.
    pub inverse_width: [f32; ROOM],
}

/// Some rays: as [`PixelRays`].
#[derive(Clone, Copy)]
pub(super) struct RayLanes<S: Simd> {
    pub origin: [Lanes<S>; 2],
    pub pupil: [Lanes<S>; 2],
    pub inverse_width: Lanes<S>,
}

/// K numbers for each ray.
pub(super) trait OfRays<S: Simd, const K: usize> {
    /// Of some rays.
    fn of_rays(&self, rays: &RayLanes<S>) -> [Lanes<S>; K];
}

impl Default for Rays {
    /// None.
    fn default() -> Self {
        Self::Blurred(Vec::new())
    }
}

impl Rays {
    /// For steps of unknown width, without blur.
    pub fn sharp(patch: &Patch) -> Self {
        Self::Sharp { x: patch.x.clone(), y: patch.y.clone() }
    }

    /// Number of pixels.
    pub fn len(&self) -> usize {
        match self {
            Self::Sharp { x, .. } => x.len(),
            Self::Blurred(of_pixels) => of_pixels.len(),
        }
    }

    /// Puts those of every n-th pixel in the place of others: see [`Patch::thinned`].
    pub fn thin(&self, n: usize, few: &mut Self) {
        *few = match self {
            Self::Blurred(all) => {
                let mut kept = few.take();
                kept.clear();
                kept.extend(all.iter().step_by(n));
                Self::Blurred(kept)
            }
            Self::Sharp { x, y } => {
                let of = |all: &[f32]| all.iter().step_by(n).copied().collect();
                Self::Sharp { x: of(x), y: of(y) }
            }
        };
    }

    /// Memory to use again: the blurred rays, or none.
    pub fn take(&mut self) -> Vec<PixelRays> {
        match std::mem::take(self) {
            Self::Blurred(all) => all,
            Self::Sharp { .. } => Vec::new(),
        }
    }

    /// Means over the rays of each pixel, in rows as long as there are pixels.
    #[inline(always)]
    pub fn means<S: Simd, const K: usize>(
        &self,
        simd: S,
        of: &impl OfRays<S, K>,
        rows: &mut [&mut [f32]; K],
    ) {
        match self {
            Self::Sharp { x, y } => {
                let one = Lanes::splat(simd, 1.0);
                for first in (0..x.len()).step_by(S::F32_LANES) {
                    let last = (first + S::F32_LANES).min(x.len());
                    let x = Lanes::of(simd, simd.partial_load_f32s(&x[first..last]));
                    let y = Lanes::of(simd, simd.partial_load_f32s(&y[first..last]));
                    let rays = RayLanes { origin: [x, y], pupil: [x, y], inverse_width: one };
                    let means = of.of_rays(&rays);
                    for k in 0..K {
                        let row = &mut rows[k][first..last];
                        simd.partial_store_f32s(row, means[k].register());
                    }
                }
            }
            Self::Blurred(of_pixels) => {
                let share = 1.0 / POINTS as f32;
                for (i, rays) in of_pixels.iter().enumerate() {
                    let mut sums = [Lanes::splat(simd, 0.0); K];
                    for chunk in 0..ROOM / S::F32_LANES {
                        let of_rays = of.of_rays(&rays.lanes(simd, chunk));
                        for k in 0..K {
                            sums[k] = sums[k] + of_rays[k];
                        }
                    }
                    for k in 0..K {
                        rows[k][i] = sums[k].sum() * share;
                    }
                }
            }
        }
    }
}

impl PixelRays {
    pub const NONE: Self = Self {
        origin_x: [0.0; ROOM],
        origin_y: [0.0; ROOM],
        pupil_x: [0.0; ROOM],
        pupil_y: [0.0; ROOM],
        inverse_width: [0.0; ROOM],
    };

    #[inline(always)]
    fn lanes<S: Simd>(&self, simd: S, chunk: usize) -> RayLanes<S> {
        RayLanes {
            origin: [lanes(simd, &self.origin_x, chunk), lanes(simd, &self.origin_y, chunk)],
            pupil: [lanes(simd, &self.pupil_x, chunk), lanes(simd, &self.pupil_y, chunk)],
            inverse_width: lanes(simd, &self.inverse_width, chunk),
        }
    }
}

#[inline(always)]
fn lanes<S: Simd>(simd: S, values: &[f32; ROOM], chunk: usize) -> Lanes<S> {
    const { assert!(ROOM.is_multiple_of(S::F32_LANES), "room for points fills registers") }
    Lanes::of(simd, S::as_simd_f32s(values).0[chunk])
}
