//! What a calibration says of the widths of edges, in words.

use crate::calibration::{Calibration, Mode};
use crate::model::{FillFactor, PointSpread};
use crate::quantity::with_std_dev;

/// Which part of their pitch micro-lenses fill, and how sharp edges are: a sentence or two. Nothing where blur takes no
/// part, or where neither is known of a camera that was calibrated before.
pub(super) fn fill_factor_text(calibration: &Calibration) -> Option<String> {
    if calibration.options.mode == Mode::CornersOnly || calibration.camera.lens_types() == 0 {
        return None;
    }
    let edges = &calibration.camera.edge_spread;
    let known = |fill: FillFactor| {
        let (value, std_dev) = with_std_dev(fill.value, Some(fill.std_dev));
        format!("{value} ± {std_dev}")
    };
    let fill = match (edges.fill_factor, &calibration.fill) {
        (Some(fill), Some(_)) => format!("Micro-lenses fill {} of their pitch", known(fill)),
        (Some(fill), None) if fill.std_dev > 0.0 => {
            format!("Micro-lenses are taken to fill {} of their pitch", known(fill))
        }
        (Some(fill), None) => {
            format!("Micro-lenses are taken to fill {} of their pitch", fill.value)
        }
        (None, _) if calibration.m_mm.is_some() => {
            "The features do not state how wide their edges are: micro-lenses are taken to fill their whole pitch"
                .to_owned()
        }
        (None, _) => return None,
    };
    let of_spread = |spread: PointSpread| {
        let [px, std_dev] = spread.px();
        let (px, std_dev) = with_std_dev(px, Some(std_dev));
        format!("; edges have a point spread of {px} ± {std_dev} px")
    };
    let spread = edges.point_spread.filter(|spread| spread.std_dev_px2 > 0.0).map(of_spread);
    Some(format!("{fill}{}.", spread.unwrap_or_default()))
}
