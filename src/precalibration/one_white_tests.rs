//! The point spread that single white images of real cameras show. A pre-calibration takes it from several f-numbers; one
//! image shows the discs of each lens type, with edges that no overlap of discs has.

use std::path::Path;

use super::array::found_array;
use super::profile::Profile;
use super::radii::{REACH, middle_nodes, profile_at};
use super::samples::middle_of;
use super::seen::Seen;
use crate::io::read_image;
use crate::vignetting::{Obliquity, Pixel};

/// Steps of the variance, px².
const STEP: f64 = 0.2;
/// Their number.
const STEPS: u32 = 80;

/// Discs that fit the light of each type best for one variance of the point spread, px², and the sum of squares.
fn fitted(profiles: &[Profile], pitch: f64, variance: f64) -> Option<(Vec<[f64; 2]>, f64)> {
    let pixel = Pixel::new(variance);
    let mut sum = 0.0;
    let mut discs = Vec::new();
    for profile in profiles {
        let edge = profile.fit(REACH * pitch, &pixel)?;
        let seen = Seen::new(&pixel, profile.furthest_px());
        let radii = [f64::midpoint(edge.outer, edge.inner), f64::midpoint(edge.outer, -edge.inner)];
        let residuals = profile.residuals_of_discs(radii, &Obliquity::default(), &seen)?;
        sum += residuals.iter().map(|r| r * r).sum::<f64>();
        discs.push([edge.outer, edge.inner]);
    }
    Some((discs, sum))
}

/// The variance with its σ by the scatter of the residuals, px².
fn point_spread(name: &str) -> [f64; 2] {
    let folder = std::env::var_os("PLENOCAL_WHITES").expect("PLENOCAL_WHITES is set");
    let raw = read_image(&Path::new(&folder).join(name), None).unwrap();
    let grey = raw.grey();
    let found = found_array(&grey, None, None).unwrap();
    let nodes = middle_nodes(&found, grey.size(), found.array.lens_types.types);
    let (part, pattern) = middle_of(&grey, &found.pattern, &nodes);
    let profile = |nodes: &Vec<(i32, i32)>| {
        profile_at((&part, f64::NEG_INFINITY), &pattern, nodes).whole(0.5 * pattern.pitch())
    };
    let profiles: Vec<Profile> = nodes.iter().map(profile).collect();
    let bins: usize = profiles.iter().map(|profile| profile.bins.len()).sum();
    let of = |i: u32| fitted(&profiles, pattern.pitch(), f64::from(i) * STEP);
    let sums: Vec<f64> = (0..STEPS).map(|i| of(i).map_or(f64::INFINITY, |(_, sum)| sum)).collect();
    let best = (0..sums.len()).min_by(|a, b| sums[*a].total_cmp(&sums[*b])).unwrap();
    let scatter = (sums[best] / bins as f64).max(1.0);
    // Where the sum grows by one, by the parabola through neighbours far enough for noise.
    let best = best.clamp(5, STEPS as usize - 6);
    let [below, above] = [best - 5, best + 5];
    let bend = (sums[below] - 2.0 * sums[best] + sums[above]) / (5.0 * STEP).powi(2);
    let std_dev = (2.0 * scatter / bend).sqrt();
    #[allow(clippy::cast_possible_truncation)] // below STEPS
    let discs = [0, best as u32].map(|i| of(i).unwrap().0);
    println!(
        "{name}: {} types, pitch {:.2} px, point spread² {:.2} ± {std_dev:.2} px² ({:.2} px); sum of squares {:.1} for {:.1} \
         without, {bins} bins; outer and inner radii {:.2?}, without {:.2?}",
        profiles.len(),
        pattern.pitch(),
        best as f64 * STEP,
        (best as f64 * STEP).sqrt(),
        sums[best],
        sums[0],
        discs[1],
        discs[0]
    );
    [best as f64 * STEP, std_dev]
}

#[test]
#[cfg_attr(not(plenocal_whites), ignore = "set PLENOCAL_WHITES to the folder of real white images")]
fn edges_of_real_micro_images_are_wider_than_ideal_ones() {
    for name in ["origami-pseudo-white.png", "thorlabs-square-white.png", "square-white2500.bmp"] {
        let [variance, std_dev] = point_spread(name);
        assert!(variance > 5.0 * std_dev, "{name}: {variance} ± {std_dev} px²");
    }
}
