//! The light of micro-images by distance from their centres, without what is clipped.

use super::profile::{BIN_PX, Bin, Profile};

/// Fewest samples in a bin for a standard deviation worth having.
const FEWEST: f64 = 8.0;
/// Samples above this part of full scale may be clipped and are left out, and so are bins with more than
/// this part of them: fewer are hot pixels.
const CLIPPED: f64 = 0.97;
const HOT: f64 = 0.01;
/// Where noise is clipped at 0, bins with more than this part of their samples there are brighter than
/// their light, and left out. An image with a black level has none.
const BLACK: f64 = 0.02;
/// Rounding makes black brighter by less than this part of a grey level.
const ROUNDED: f64 = 0.1;
/// Only light up to this part of the brightest is fitted: the outer radius shows at the edge, across
/// which the effect of oblique rays changes little.
const OUTER_LIGHT: f64 = 0.5;

/// Collects samples into a profile.
#[derive(Debug)]
pub(super) struct Stack {
    bins: Vec<Sums>,
    /// The light of a sample of 0.
    floor: f64,
    /// The smallest light above it: a grey level, at most.
    level: f64,
}

/// Sums over the samples of a bin that are not clipped at white: their number, distances, light, its
/// square; the number of the others; and of those that may be clipped at black.
type Sums = [f64; 6];

impl Stack {
    /// For distances up to `reach`, px, of light that is clipped at `floor`.
    pub fn new(reach: f64, floor: f64) -> Self {
        #[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss)] // a few pixels
        let bins = (reach / BIN_PX).ceil() as usize;
        Self { bins: vec![[0.0; 6]; bins], floor, level: f64::INFINITY }
    }

    #[inline]
    pub fn add(&mut self, radius: f64, light: f64) {
        #[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss)] // a distance
        let bin = (radius / BIN_PX) as usize;
        let above = light - self.floor;
        if above > 0.0 && above < self.level {
            self.level = above;
        }
        if let Some(bin) = self.bins.get_mut(bin) {
            if light > CLIPPED {
                bin[4] += 1.0;
                return;
            }
            bin[0] += 1.0;
            bin[1] += radius;
            bin[2] += light;
            bin[3] += light * light;
            bin[5] += f64::from(u8::from(above <= 0.0));
        }
    }

    /// The profile, without what noise about black spoils unless no edge is left then.
    pub fn profile(&self) -> Profile {
        let without = self.noise_is_clipped().then(|| self.bins_with(BLACK));
        without.filter(Profile::shows_an_edge).unwrap_or_else(|| self.bins_with(1.0))
    }

    /// The bins with at most this part of their samples at black.
    fn bins_with(&self, most_black: f64) -> Profile {
        let bin = |&[count, radius, light, square, white, black]: &Sums| {
            let mean = light / count;
            let variance = (square / count - mean * mean).max(0.0);
            let hot = HOT * (count + white);
            (count >= FEWEST && white <= hot && black <= most_black * count).then(|| Bin {
                radius: radius / count,
                light: mean,
                std_dev: (variance / count).sqrt(),
            })
        };
        let bins: Vec<Bin> = self.bins.iter().filter_map(bin).collect();
        let clipped = self.bins.iter().any(|bin| bin[4] > HOT * (bin[0] + bin[4]));
        let brightest = bins.iter().map(|bin| bin.light).fold(0.0, f64::max);
        let limit = OUTER_LIGHT * if clipped { 1.0 } else { brightest };
        let (bins, bright) = bins.into_iter().partition(|bin| bin.light <= limit);
        Profile { bins, bright, ..Profile::default() }
    }

    /// Whether noise about black is clipped by enough to matter: the darkest bins are brighter than rounding makes them.
    fn noise_is_clipped(&self) -> bool {
        let filled = || self.bins.iter().filter(|bin| bin[0] >= FEWEST);
        let darkest = filled().map(|bin| bin[2] / bin[0]).fold(f64::INFINITY, f64::min);
        let clipped = filled().any(|bin| (BLACK..1.0 - BLACK).contains(&(bin[5] / bin[0])));
        clipped && darkest - self.floor > ROUNDED * self.level
    }
}
