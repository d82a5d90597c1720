//! The plateau of full pixels at the upper end of a histogram.
//!
//! Photon noise and the fall-off of light make the upper end of a histogram thin out over several grey
//! levels. Full pixels all have the same sample, up to the noise of the read-out: a spike with hardly
//! anything above it.

use super::{RawImage, Samples};

/// Widths of the plateau, in 255ths of the largest sample: for clipped samples, and for full wells with read-out
/// noise.
const WIDTHS: [f64; 2] = [1.0, 2.0];
/// Largest distance of the plateau below the largest sample, in 255ths of the largest sample.
const REACH: f64 = 6.0;
/// Number of steps of the search per 255th of the largest sample. A step is at least one grey level.
const STEPS: f64 = 4.0;
/// Least density of the plateau over the density of the samples just below, within twice its width.
const DENSER: f64 = 3.0;
/// Largest number of samples above the plateau, over the number in it: noise, and hot pixels.
const ABOVE: f64 = 0.1;
/// Least fraction of all samples in a plateau, and their least number.
const LEAST_PART: f64 = 1e-4;
const LEAST: f64 = 40.0;
/// Largest scatter of the samples of full pixels, in standard deviations.
const SCATTER: f64 = 3.0;
/// Lowest plateau, grey levels. With fewer levels every one of them is a spike.
const LOWEST: f64 = 64.0;
/// Largest number of rows in the histogram.
const ROWS: usize = 512;

/// The cumulative histogram of the samples in some rows.
struct Histogram {
    /// Number of samples below each grey level.
    below: Vec<f64>,
}

impl Histogram {
    fn of(raw: &RawImage) -> Self {
        #[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss)] // 16 bits
        let mut counts = vec![0_u32; raw.full_scale() as usize + 1];
        let per_row = raw.width * raw.color.samples();
        let step = raw.height.div_ceil(ROWS).max(1);
        let rows = (0..raw.height).step_by(step).map(|v| v * per_row..(v + 1) * per_row);
        for row in rows {
            match &raw.samples {
                Samples::Bits8(all) => all[row].iter().for_each(|&s| counts[usize::from(s)] += 1),
                Samples::Bits16(all) => all[row].iter().for_each(|&s| counts[usize::from(s)] += 1),
            }
        }
        let mut below = Vec::with_capacity(counts.len() + 1);
        let mut sum = 0.0;
        below.push(sum);
        for count in counts {
            sum += f64::from(count);
            below.push(sum);
        }
        Self { below }
    }

    fn all(&self) -> f64 {
        self.below.last().copied().unwrap_or_default()
    }

    /// Returns the number of samples from `low` up to, but without, `high`.
    fn count(&self, low: f64, high: f64) -> f64 {
        #[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss)] // cut to the range
        let below = |s: f64| self.below[(s.ceil().max(0.0) as usize).min(self.below.len() - 1)];
        below(high) - below(low)
    }

    /// Returns mean and standard deviation of the samples from `low` up to, but without, `high`.
    fn moments(&self, low: f64, high: f64) -> (f64, f64) {
        let (mut count, mut first, mut second) = (0.0, 0.0, 0.0);
        let mut sample = low.ceil().max(0.0);
        while sample < high {
            let here = self.count(sample, sample + 1.0);
            count += here;
            first += here * (sample - low);
            second += here * (sample - low).powi(2);
            sample += 1.0;
        }
        let mean = first / count;
        (low + mean, (second / count - mean * mean).max(0.0).sqrt())
    }
}

impl RawImage {
    /// Returns the sample from which pixels are full, by the plateau in the histogram of this image; `None`
    /// without a plateau.
    #[must_use]
    pub fn plateau(&self) -> Option<f64> {
        let histogram = Histogram::of(self);
        let least = (LEAST_PART * histogram.all()).max(LEAST);
        let largest =
            histogram.below.iter().rposition(|&below| histogram.all() - below >= least)?;
        let unit = (largest as f64 / 255.0).max(1.0);
        let step = (unit / STEPS).max(1.0);
        let is_plateau = |low: f64, width: f64| {
            let own = histogram.count(low, low + width);
            let before = histogram.count(low - 2.0 * width, low) / 2.0;
            let above = histogram.count(low + width, f64::INFINITY);
            // An image of one grey has no upper end.
            let has_darker = histogram.count(0.0, low) >= least;
            low > LOWEST && has_darker && own >= least.max(DENSER * before) && above <= ABOVE * own
        };
        let mut width_and_low = WIDTHS.into_iter().flat_map(|width| {
            let lows = std::iter::successors(Some(largest as f64), move |low| Some(low - step));
            let reached = move |low: &f64| largest as f64 - low <= REACH * unit;
            lows.take_while(reached).map(move |low| (width * unit, low))
        });
        let (width, low) = width_and_low.find(|(width, low)| is_plateau(*low, *width))?;
        let (mean, std_dev) = histogram.moments(low, low + width);
        Some((mean - SCATTER * std_dev).max(low))
    }

    /// Returns true if many samples are above this one.
    pub(super) fn exceeds(&self, sample: f64) -> bool {
        let histogram = Histogram::of(self);
        let unit = self.full_scale() / 255.0;
        histogram.count(sample + WIDTHS[1] * unit, f64::INFINITY) > LEAST_PART * histogram.all()
    }
}

#[cfg(test)]
mod tests {
    use super::super::Color;
    use super::*;

    /// Returns samples that thin out upwards over a tenth of the largest, cut at `full`, with some at
    /// `hot`.
    fn image(largest: f64, full: f64, hot: f64) -> RawImage {
        let sample = |i: usize| {
            let part = (i as f64 + 0.5) / 40_000.0;
            let sample =
                if i < 10 { hot } else { largest * (0.9 + 0.1 * (1.0 - (1.0 - part).sqrt())) };
            #[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss)] // 16 bits
            let sample = sample.min(full).round() as u16;
            sample
        };
        let samples = (0..40_000).map(sample);
        let samples = if largest < 256.0 {
            #[allow(clippy::cast_possible_truncation)] // 8 bits
            Samples::Bits8(samples.map(|s| s as u8).collect())
        } else {
            Samples::Bits16(samples.collect())
        };
        RawImage { width: 200, height: 200, color: Color::Grey, samples }
    }

    #[test]
    fn full_pixels_make_a_plateau_at_any_depth() {
        for (largest, full) in
            [(240.0, 230.0), (255.0, 245.0), (4200.0, 4095.0), (60_000.0, 58_000.0)]
        {
            let found = image(largest, full, full).plateau().unwrap();
            assert!((found - full).abs() <= 0.002 * full, "{found} for {full}");
        }
    }

    #[test]
    fn bright_samples_and_hot_pixels_make_none() {
        for (largest, hot) in [(240.0, 255.0), (4000.0, 4095.0), (60_000.0, 65_535.0)] {
            assert_eq!(image(largest, 65_535.0, hot).plateau(), None);
        }
        assert_eq!(image(20.0, 19.0, 19.0).plateau(), None);
        assert_eq!(image(240.0, 128.0, 128.0).plateau(), None);
    }

    /// The camera's saturation level holds unless the image exceeds it.
    #[test]
    fn an_image_without_full_pixels_takes_the_cameras_levels() {
        use crate::model::SampleLevels;
        let levels = SampleLevels {
            black_level: 10.0,
            saturation_level: Some(230.0),
            ..SampleLevels::full_range(8)
        };
        assert_eq!(image(220.0, 255.0, 0.0).range(Some(&levels)), (10.0, 230.0));
        assert_eq!(image(250.0, 255.0, 0.0).range(Some(&levels)), (10.0, 255.0));
        assert_eq!(image(250.0, 240.0, 240.0).range(Some(&levels)), (10.0, 240.0));
        let without_light = SampleLevels { black_level: 230.0, ..SampleLevels::full_range(8) };
        assert_eq!(image(250.0, 230.0, 230.0).range(Some(&without_light)), (230.0, 255.0));
    }
}
