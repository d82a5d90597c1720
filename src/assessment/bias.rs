//! Systematic errors of detected features: by position in the image, by distance from the centre of the
//! micro-image, by lens type.

use nalgebra::Vector2;

/// The error of a detected feature, with its position.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct FeatureError {
    /// Number of the frame.
    pub frame: u32,
    /// Position of the micro-image from the middle of the image, px.
    pub from_middle_px: Vector2<f64>,
    /// True position of the corner from the centre of its micro-image, px.
    pub from_center_px: Vector2<f64>,
    /// Lens type, from 0.
    pub lens_type: usize,
    /// Detected minus true position, px.
    pub error_px: Vector2<f64>,
    /// Detected minus true ρ, px.
    pub rho_error_px: f64,
}

/// The mean error of a class of features.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Bias {
    /// Mean distance of the features, px: from the middle of the image or of the micro-image.
    pub distance_px: f64,
    /// Mean error, px.
    pub mean_px: f64,
    /// Standard deviation of the mean error from the scatter of the errors, px.
    pub std_dev_px: f64,
    /// Number of features.
    pub count: usize,
}

/// Number of classes of distance, each with the same number of features.
const CLASSES: usize = 5;

/// Returns the mean error away from the middle of the image, by distance from the middle.
#[must_use]
pub fn by_place(errors: &[FeatureError]) -> Vec<Bias> {
    classes(errors, |e| along(&e.error_px, &e.from_middle_px))
}

/// Returns the mean error away from the centre of the micro-image, by distance from the centre, for one lens type.
#[must_use]
pub fn by_offset(errors: &[FeatureError], lens_type: usize) -> Vec<Bias> {
    let own: Vec<FeatureError> =
        errors.iter().copied().filter(|e| e.lens_type == lens_type).collect();
    classes(&own, |e| along(&e.error_px, &e.from_center_px))
}

/// Returns the mean error of ρ, by distance from the middle of the image.
#[must_use]
pub fn of_rho(errors: &[FeatureError]) -> Vec<Bias> {
    classes(errors, |e| (e.from_middle_px.norm(), e.rho_error_px))
}

/// Returns the relative excess of the distances of corners from the centres of their micro-images, and its standard
/// deviation. d of a calibrated camera has about the same error.
#[must_use]
pub fn outwards(errors: &[FeatureError]) -> (f64, f64) {
    let squares: f64 = errors.iter().map(|e| e.from_center_px.norm_squared()).sum();
    let along = |e: &FeatureError| e.error_px.dot(&e.from_center_px);
    let part = errors.iter().map(along).sum::<f64>() / squares;
    let left = |e: &FeatureError| along(e) - part * e.from_center_px.norm_squared();
    (part, errors.iter().map(|e| left(e).powi(2)).sum::<f64>().sqrt() / squares)
}

/// Returns the class with the largest absolute mean error.
#[must_use]
pub fn worst(classes: &[Bias]) -> Option<&Bias> {
    classes.iter().max_by(|a, b| a.mean_px.abs().total_cmp(&b.mean_px.abs()))
}

/// Returns the length of `from`, and the component of an error along it.
fn along(error: &Vector2<f64>, from: &Vector2<f64>) -> (f64, f64) {
    let distance = from.norm();
    (distance, error.dot(from) / distance.max(1e-9))
}

fn classes(errors: &[FeatureError], of: impl Fn(&FeatureError) -> (f64, f64)) -> Vec<Bias> {
    let mut all: Vec<(f64, f64)> = errors.iter().map(of).collect();
    all.sort_by(|a, b| a.0.total_cmp(&b.0));
    let class = |class: &[(f64, f64)]| {
        let count = class.len() as f64;
        let mean = |of: fn(&(f64, f64)) -> f64| class.iter().map(of).sum::<f64>() / count;
        let mean_px = mean(|x| x.1);
        let variance = class.iter().map(|x| (x.1 - mean_px).powi(2)).sum::<f64>() / count;
        Bias {
            distance_px: mean(|x| x.0),
            mean_px,
            std_dev_px: (variance / count).sqrt(),
            count: class.len(),
        }
    };
    all.chunks(all.len().div_ceil(CLASSES).max(1)).map(class).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The errors are 1e-5 of the distance from the middle, plus 0.01 of the distance from the centre for type 1 alone.
    #[test]
    fn biases_are_found_where_they_are() {
        let place = |i: i32| Vector2::new(f64::from(i % 40 - 20), f64::from(i / 40 - 20)) * 50.0;
        let offset = |i: i32| Vector2::new(f64::from(i % 7 - 3), f64::from(i % 11 - 5));
        let error = |i: i32| FeatureError {
            frame: 0,
            from_middle_px: place(i),
            from_center_px: offset(i),
            lens_type: usize::from(i % 2 == 1),
            error_px: place(i) * 1e-5 + offset(i) * if i % 2 == 1 { 0.01 } else { 0.0 },
            rho_error_px: 0.3,
        };
        let errors: Vec<FeatureError> = (0..1600).map(error).collect();
        for bias in by_place(&errors) {
            assert!((bias.mean_px - bias.distance_px * 1e-5).abs() < 2e-3, "{bias:?}");
        }
        for (lens_type, slope) in [(0, 0.0), (1, 0.01)] {
            for bias in by_offset(&errors, lens_type) {
                assert!((bias.mean_px - bias.distance_px * slope).abs() < 1e-3, "{bias:?}");
            }
        }
        let rho = of_rho(&errors);
        assert!((worst(&rho).unwrap().mean_px - 0.3).abs() < 1e-12 && rho.len() == 5);
    }
}
