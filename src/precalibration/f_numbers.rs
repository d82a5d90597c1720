//! Check of the f-numbers of white images: micro-images grow in a straight line with 1/N, Eq. (miradiusfnumber).

use super::internal::{RadiusMeasurement, fit_internal};
use super::options::White;
use crate::checks::whites::TOUCHING;
use crate::error::{Error, Result};
use crate::finding::{Finding, Issue};
use crate::model::Configuration;

/// Relative deviation of a radius from the prediction of the other f-numbers that shows a wrong f-number: half a stop
/// at f/4 changes a radius by 10 %.
const CONTRADICTION: f64 = 0.05;
/// Smaller deviation that is enough if it is also this many times the root mean square deviation of the others from
/// their lines: f/9 for f/8.
const NOTICEABLE: f64 = 0.01;
const OUT_OF_LINE: f64 = 8.0;
/// Fewest white images for a comparison of explanations. Only with more do the others show how straight their lines
/// are.
const FEWEST_TO_JUDGE: usize = 4;
/// Fewest white images that measure m and q' without one whose micro-images overlap.
const FEWEST_WITHOUT_OVERLAP: usize = 2;
/// Root mean square deviation of radii from straight lines, relative, up to which they are on the lines.
const STRAIGHT: f64 = 0.01;
/// Ratio of these deviations above which one explanation is better than another.
const BETTER: f64 = 2.0;

/// Returns the f-number from which on micro-images do not overlap by more than [`TOUCHING`]; `None` if they overlap at every
/// f-number. `slope_px` is the radius of the pupil times the f-number, `widest_px` the largest blur radius of the pupil.
pub(super) fn apart(slope_px: f64, widest_px: f64, half_pitch_px: f64) -> Option<f64> {
    let room = (1.0 + TOUCHING) * half_pitch_px - widest_px;
    (room > 0.0).then(|| slope_px / room)
}

/// A white image in doubt: its micro-images overlap, or its f-number contradicts the others.
pub(super) struct Doubt {
    /// Index of the white image.
    pub white: usize,
    /// F-number of the size of its micro-images, by lines through the other images, if the image is to be left out.
    pub f_number: Option<f64>,
    /// Finding for the user.
    pub finding: Finding,
}

/// Finds the white image with the widest micro-images if these overlap, or else the one that contradicts the others, if one
/// does. Returns an error if the f-numbers fit in another order: micro-images are larger at a smaller f-number.
pub(super) fn doubtful(
    whites: &[White],
    radii: &[RadiusMeasurement],
    (types, half_pitch_px): (usize, f64),
    configuration: Configuration,
) -> Result<Option<Doubt>> {
    let sizes = Sizes { whites, radii, types, configuration };
    let stated: Vec<f64> = whites.iter().map(|white| white.f_number).collect();
    if let Some(doubt) = sizes.overlapping(&stated, half_pitch_px) {
        return Ok(Some(doubt));
    }
    let without: Vec<Option<Lines>> =
        (0..whites.len()).map(|i| sizes.lines(&stated, |other| other != i)).collect();
    let contradicts = |i: usize| {
        let off = sizes.off(i, without[i].as_ref()?).abs();
        let usual = without[i].as_ref()?.off;
        let noticed = off > CONTRADICTION
            || whites.len() > FEWEST_TO_JUDGE && off > NOTICEABLE.max(OUT_OF_LINE * usual);
        noticed.then_some((i, off))
    };
    let worst = (0..whites.len()).filter_map(contradicts).max_by(|a, b| a.1.total_cmp(&b.1));
    let Some((worst, _)) = worst.filter(|_| whites.len() > 2) else { return Ok(None) };

    let off = |i: &usize| without[*i].as_ref().map_or(f64::INFINITY, |lines| lines.off);
    let mut order: Vec<usize> = (0..whites.len()).collect();
    order.sort_by(|a, b| off(a).total_cmp(&off(b)));
    let (best, next) = (order[0], order[1]);
    let by_size = sizes.by_size(&stated);
    if let Some(lines) = sizes.lines(&by_size, |_| true)
        && by_size != stated
        && lines.off < STRAIGHT
        && (whites.len() < FEWEST_TO_JUDGE || lines.off < BETTER * off(&best))
    {
        return Err(sizes.in_another_order(&by_size));
    }
    if whites.len() >= FEWEST_TO_JUDGE && off(&best) < STRAIGHT && BETTER * off(&best) < off(&next)
    {
        return Ok(without[best].as_ref().map(|lines| sizes.misfit(best, lines)));
    }
    let finding = without[worst].as_ref().map(|lines| {
        let (f_number, radius_px) = (stated[worst], sizes.of(worst)[0].radius_px);
        let expected_px = lines.radius(f_number, 0);
        Finding::caution(Issue::FNumberContradicted { f_number, radius_px, expected_px })
            .about_image(&whites[worst].name)
    });
    Ok(finding.map(|finding| Doubt { white: worst, f_number: None, finding }))
}

/// Lines ϱ = m/N + |qᵢ|, px.
struct Lines {
    m: f64,
    q: Vec<f64>,
    /// Root mean square deviation of the radii, relative to their mean.
    off: f64,
}

impl Lines {
    fn radius(&self, f_number: f64, lens_type: usize) -> f64 {
        self.m / f_number + self.q[lens_type]
    }
}

/// Sizes of the micro-images in white images; `radii` are in the order of the images.
struct Sizes<'a> {
    whites: &'a [White],
    radii: &'a [RadiusMeasurement],
    types: usize,
    configuration: Configuration,
}

impl Sizes<'_> {
    fn of(&self, white: usize) -> &[RadiusMeasurement] {
        &self.radii[white * self.types..(white + 1) * self.types]
    }

    fn mean(&self, white: usize) -> f64 {
        self.of(white).iter().map(|m| m.radius_px).sum::<f64>() / self.types as f64
    }

    /// Fits lines to the radii of some of the images, with these f-numbers.
    fn lines(&self, f_numbers: &[f64], takes_part: impl Fn(usize) -> bool) -> Option<Lines> {
        let kept = (0..self.whites.len()).filter(|i| takes_part(*i));
        let mut all: Vec<RadiusMeasurement> = kept
            .flat_map(|i| self.of(i).iter().map(move |m| (i, m)))
            .map(|(i, m)| RadiusMeasurement { f_number: f_numbers[i], ..m.clone() })
            .collect();
        let fit = fit_internal(&mut all, self.types, 1.0, 0.0, self.configuration)?;
        let side = if self.configuration == Configuration::Keplerian { 1.0 } else { -1.0 };
        let mean = all.iter().map(|m| m.radius_px).sum::<f64>() / all.len() as f64;
        let q = fit.parameters.q_prime_mm.iter().map(|q| side * q).collect();
        Some(Lines { m: fit.parameters.m_mm, q, off: fit.rms_px / mean })
    }

    /// Returns the mean relative deviation of the radii of an image.
    fn off(&self, white: usize, lines: &Lines) -> f64 {
        let f_number = self.whites[white].f_number;
        let off = |m: &RadiusMeasurement| m.radius_px / lines.radius(f_number, m.lens_type) - 1.0;
        self.of(white).iter().map(off).sum::<f64>() / self.types as f64
    }

    /// Returns the stated f-numbers in the order of the sizes.
    fn by_size(&self, stated: &[f64]) -> Vec<f64> {
        let mut images: Vec<usize> = (0..stated.len()).collect();
        images.sort_by(|a, b| self.mean(*b).total_cmp(&self.mean(*a)));
        let mut sorted = stated.to_vec();
        sorted.sort_by(f64::total_cmp);
        let mut assigned = stated.to_vec();
        for (image, f_number) in images.into_iter().zip(sorted) {
            assigned[image] = f_number;
        }
        assigned
    }

    /// Returns the white image at the smallest f-number if its micro-images overlap, as measured and as those at larger f-numbers
    /// predict.
    fn overlapping(&self, stated: &[f64], half_pitch_px: f64) -> Option<Doubt> {
        let mut f_numbers = stated.to_vec();
        f_numbers.sort_by(f64::total_cmp);
        f_numbers.dedup();
        let white = (0..stated.len()).min_by(|a, b| stated[*a].total_cmp(&stated[*b]))?;
        // Micro-images may overlap at the next f-numbers too.
        let without = 1..=f_numbers.len().saturating_sub(FEWEST_WITHOUT_OVERLAP);
        let lines = without
            .filter_map(|count| self.lines(stated, |i| stated[i] >= f_numbers[count]))
            .find(|lines| lines.off < STRAIGHT)?;
        let (f_number, widest) = (stated[white], lines.q.iter().copied().fold(0.0, f64::max));
        // If the stated f-number is too small, only the predicted radius exceeds half the pitch.
        let seen = self.of(white).iter().map(|m| m.radius_px).fold(0.0, f64::max);
        let is_wide = (lines.m / f_number + widest).min(seen) > (1.0 + TOUCHING) * half_pitch_px;
        let apart = apart(lines.m, widest, half_pitch_px)?;
        let finding = Finding::note(Issue::WhitesOverlap { f_number, apart })
            .about_image(&self.whites[white].name);
        is_wide.then_some(Doubt { white, f_number: Some(f_number), finding })
    }

    fn in_another_order(&self, by_size: &[f64]) -> Error {
        #[allow(clippy::float_cmp)] // the same numbers, in another order
        let is_other = |(white, n): &(&White, &f64)| white.f_number != **n;
        let images = self.whites.iter().zip(by_size).filter(is_other);
        let list: Vec<String> = images
            .map(|(white, n)| format!("{} f/{n:.2} and not f/{:.2}", white.name, white.f_number))
            .collect();
        Error::invalid(format!(
            "the f-numbers of white images are swapped: by the size of the micro-images {}. \
             Correct their f-numbers",
            list.join(", ")
        ))
    }

    fn misfit(&self, white: usize, lines: &Lines) -> Doubt {
        let own = self.of(white);
        let f_number = |m: &RadiusMeasurement| lines.m / (m.radius_px - lines.q[m.lens_type]);
        let looks_like = own.iter().map(f_number).sum::<f64>() / self.types as f64;
        let White { name, f_number, .. } = &self.whites[white];
        let issue = Issue::FNumberLeftOut { f_number: *f_number, looks_like };
        let finding = Finding::caution(issue).about_image(name);
        Doubt { white, f_number: Some(looks_like), finding }
    }
}
