//! Pictures to look into: images of the camera with what was found in them, for a page.

use std::collections::BTreeMap;

use base64::Engine as _;
use base64::engine::general_purpose::STANDARD;
use flate2::Compression;
use flate2::write::DeflateEncoder;
use serde::Serialize;
use serde_json::json;

use super::drawing::{Color, TYPE_COLORS};
use super::figures::board_lines;
use super::photograph::Photograph;
use super::tree::Part;
use crate::calibration::OutlyingFeature;
use crate::detection::DetectedFrame;
use crate::error::{Error, Result};
use crate::finding::Finding;
use crate::model::{BapFeature, Board, FeatureResidual, MicroImageCenter};
use crate::precalibration::{ArrayMeasurement, Precalibration};

/// Pictures of which a page shows one at a time.
#[derive(Debug, Clone, PartialEq, Serialize)]
struct Pictures {
    /// Pictures in the order of their list.
    pictures: Vec<Picture>,
    /// Micro-images of all pictures: k, l, u and v of their centres, and their lens type.
    centers: String,
    /// Distance between micro-images, px.
    pitch_px: f64,
    /// Colours of the lens types.
    colors: Vec<String>,
}

/// An image of the camera with what was found in it.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Picture {
    /// Name of its group in the list.
    group: String,
    /// Name in the list.
    name: String,
    /// Width and height of the image, px.
    size: [usize; 2],
    /// Reduced image, as a JPEG file in Base64.
    jpeg: String,
    /// Address of the image itself, relative to the page; `None` if a browser cannot show it.
    image: Option<String>,
    /// Factor that makes the image itself as bright as its picture.
    gain: f64,
    /// Radii of the micro-images by lens type, px.
    radii_px: Vec<f64>,
    /// Lines of the board: u and v of points, px.
    board: Vec<Vec<[f64; 2]>>,
    /// Number of corners along a row of the board.
    columns: i32,
    /// RMS of the residuals, px; `None` without residuals.
    rms_px: Option<f64>,
    /// Features; see [`features`].
    features: String,
    /// Findings about the image.
    findings: Vec<Pin>,
}

/// A finding, with its position if it has one.
#[derive(Debug, Clone, PartialEq, Serialize)]
struct Pin {
    text: String,
    at: Option<[f64; 2]>,
    /// Board corner that it concerns.
    corner: Option<i32>,
}

/// Where a picture is listed, and the image that it is of.
#[derive(Debug, Clone)]
pub struct PictureSource<'a> {
    /// Name of its group in the list.
    pub group: &'a str,
    /// The picture.
    pub photograph: &'a Photograph,
    /// Address of the image itself, relative to the page; `None` if a browser cannot show it.
    pub image: Option<String>,
    /// Radii of the micro-images by lens type, px.
    pub radii_px: &'a [f64],
}

impl Picture {
    fn of(source: PictureSource, name: String, findings: Vec<Pin>) -> Result<Self> {
        let small = source.photograph.small();
        Ok(Self {
            group: source.group.to_owned(),
            name,
            size: small.image_px,
            jpeg: STANDARD.encode(small.small_jpeg()?),
            image: source.image,
            gain: f64::from(1.0 / small.brightest),
            radii_px: source.radii_px.iter().map(|r| rounded(*r)).collect(),
            board: Vec::new(),
            columns: 0,
            rms_px: None,
            features: packed(&[])?,
            findings,
        })
    }

    /// Creates a picture of a white image.
    pub fn of_white(source: PictureSource, name: &str, findings: &[Finding]) -> Result<Self> {
        Self::of(source, name.to_owned(), pins(findings))
    }

    /// Creates a picture of a frame of the board. `residuals` may be of other frames, too.
    pub fn of_board(
        source: PictureSource,
        frame: &DetectedFrame,
        board: &Board,
        residuals: &[FeatureResidual],
        findings: &[Finding],
        outlying: &[OutlyingFeature],
    ) -> Result<Self> {
        let own = |feature: &BapFeature| feature.frame == frame.frame;
        let mut pins = pins(findings);
        pins.extend(outlying.iter().filter(|o| own(&o.residual.feature)).map(outlier));
        let picture = Self::of(source, format!("{}: {}", frame.frame, frame.name), pins)?;
        let Ok(detection) = &frame.result else { return Ok(picture) };
        let residuals: Vec<&FeatureResidual> =
            residuals.iter().filter(|r| own(&r.feature)).collect();
        let squares: f64 = residuals.iter().map(|r| r.du_px.powi(2) + r.dv_px.powi(2)).sum();
        let rms_px = (!residuals.is_empty()).then(|| (squares / residuals.len() as f64).sqrt());
        let lines = board_lines(detection, board);
        let lines = lines.map(|line| line.iter().map(|p| [rounded(p.x), rounded(p.y)]).collect());
        Ok(Self {
            board: lines.collect(),
            columns: board.columns,
            rms_px: rms_px.map(|rms| (rms * 1e4).round() / 1e4),
            features: features(&detection.features, &residuals)?,
            ..picture
        })
    }
}

/// Returns the pictures of a camera as a part of a report.
pub fn pictures_part(pictures: Vec<Picture>, whites: &Precalibration) -> Result<Part> {
    let colors = TYPE_COLORS.into_iter().take(whites.lens_types.types);
    Ok(Part::Pictures(json!(Pictures {
        pictures,
        centers: centers(&whites.array, whites.lens_types.types)?,
        pitch_px: rounded(whites.array.grid.pitch_px),
        colors: colors.map(Color::hex).collect(),
    })))
}

fn pins(findings: &[Finding]) -> Vec<Pin> {
    let pin = |finding: &Finding| Pin { text: finding.to_string(), at: None, corner: None };
    findings.iter().map(pin).collect()
}

fn outlier(o: &OutlyingFeature) -> Pin {
    let f = &o.residual.feature;
    let text = format!(
        "outlying feature of corner {} in micro-image ({}, {}): {:.2} px off, {:.0} σ",
        f.corner, f.k, f.l, o.distance_px, o.std_devs
    );
    Pin { text, at: Some([rounded(f.u_px), rounded(f.v_px)]), corner: Some(f.corner) }
}

fn rounded(px: f64) -> f64 {
    (px * 100.0).round() / 100.0
}

/// Column of whole numbers; a value may be missing.
type Numbers = Vec<Option<i64>>;

/// Packs columns of numbers: differences to the number before, as JSON, compressed (DEFLATE), in Base64.
fn packed(columns: &[Numbers]) -> Result<String> {
    let differences = |column: &Numbers| -> Numbers {
        let mut before = 0;
        let mut difference = |value: i64| value - std::mem::replace(&mut before, value);
        column.iter().map(|value| value.map(&mut difference)).collect()
    };
    let columns: Vec<Numbers> = columns.iter().map(differences).collect();
    let mut encoder = DeflateEncoder::new(Vec::new(), Compression::default());
    let failed = |e: std::io::Error| Error::invalid(format!("a figure could not be drawn: {e}"));
    serde_json::to_writer(&mut encoder, &columns).map_err(|e| failed(e.into()))?;
    Ok(STANDARD.encode(encoder.finish().map_err(failed)?))
}

#[allow(clippy::cast_possible_truncation)] // px
fn in_parts(px: f64, per_px: f64) -> Option<i64> {
    px.is_finite().then(|| (px * per_px).round() as i64)
}

fn hundredths(px: f64) -> Option<i64> {
    in_parts(px, 100.0)
}

fn thousandths(px: f64) -> Option<i64> {
    in_parts(px, 1000.0)
}

fn centers(array: &ArrayMeasurement, types: usize) -> Result<String> {
    let lattice = &array.grid.lattice;
    let of = |value: &dyn Fn(&MicroImageCenter) -> Option<i64>| -> Numbers {
        array.centers.iter().map(value).collect()
    };
    packed(&[
        of(&|c| Some(c.k.into())),
        of(&|c| Some(c.l.into())),
        of(&|c| hundredths(c.u_px)),
        of(&|c| hundredths(c.v_px)),
        of(&|c| i64::try_from(lattice.lens_type(c.k, c.l, types)).ok()),
    ])
}

/// Packs features: corner, k, l; u, v, ρ in hundredths of a pixel; their σ, then their residuals, in thousandths.
fn features(features: &[BapFeature], residuals: &[&FeatureResidual]) -> Result<String> {
    let key = |f: &BapFeature| (f.corner, f.k, f.l);
    let of_feature: BTreeMap<_, &FeatureResidual> =
        residuals.iter().map(|r| (key(&r.feature), *r)).collect();
    let of = |value: &dyn Fn(&BapFeature) -> Option<i64>| -> Numbers {
        features.iter().map(value).collect()
    };
    let residual = |f: &BapFeature| of_feature.get(&key(f)).copied();
    packed(&[
        of(&|f| Some(f.corner.into())),
        of(&|f| Some(f.k.into())),
        of(&|f| Some(f.l.into())),
        of(&|f| hundredths(f.u_px)),
        of(&|f| hundredths(f.v_px)),
        of(&|f| hundredths(f.rho_px?)),
        of(&|f| thousandths(f.std_dev_px?[0])),
        of(&|f| thousandths(f.std_dev_px?[1])),
        of(&|f| thousandths(f.rho_std_dev_px?)),
        of(&|f| thousandths(residual(f)?.du_px)),
        of(&|f| thousandths(residual(f)?.dv_px)),
        of(&|f| thousandths(residual(f)?.drho_px?)),
    ])
}

#[cfg(test)]
mod tests {
    use std::io::Read as _;

    use super::*;

    #[test]
    fn packed_numbers_are_differences() {
        let packed = packed(&[vec![Some(5), Some(7), None, Some(4)], vec![]]).unwrap();
        let mut text = String::new();
        let bytes = STANDARD.decode(packed).unwrap();
        flate2::read::DeflateDecoder::new(&*bytes).read_to_string(&mut text).unwrap();
        assert_eq!(text, "[[5,2,null,-3],[]]");
    }
}
