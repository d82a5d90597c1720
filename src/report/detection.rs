//! Detected features as text and figures.

use std::fmt::Write as _;

use base64::Engine as _;
use base64::engine::general_purpose::STANDARD;
use image::codecs::jpeg::JpegEncoder;
use image::{GrayImage, Luma};

use super::table::{Table, table};
use crate::detection::{DetectedFrame, Detection};
use crate::error::{Error, Result};
use crate::image::RawImage;
use crate::model::Board;

/// What was found and what was dropped in each frame.
#[must_use]
pub fn detection_text(frames: &[DetectedFrame]) -> String {
    format!("{}\n\n{}", detection_table(frames), dropped_text(frames))
}

pub(super) fn detection_table(frames: &[DetectedFrame]) -> Table {
    let header = [
        "Frame",
        "Image",
        "Micro-images",
        "Corners",
        "Clusters",
        "Board",
        "Features",
        "Alone",
        "Off line",
        "Texture",
        "Off board",
        "Lost",
        "Unclear",
        "Misplaced",
        "Given up",
    ];
    let mut text = table(&header, &[1]);
    for frame in frames {
        let c = &frame.counts;
        let numbers = [
            c.looked_at - c.unusable,
            c.corners,
            c.clusters,
            c.board_corners,
            frame.features(),
            c.alone,
            c.off_line,
            c.texture,
            c.off_board,
            c.lost,
            c.unclear,
            c.misplaced,
            c.given_up,
        ];
        let mut cells = vec![frame.frame.to_string(), frame.name.clone()];
        cells.extend(numbers.iter().map(ToString::to_string));
        text.add_row(cells);
    }
    text
}

/// What the columns mean.
pub(super) fn dropped_text(frames: &[DetectedFrame]) -> String {
    let features: usize = frames.iter().map(DetectedFrame::features).sum();
    let with_features = frames.iter().filter(|frame| frame.features() > 0).count();
    format!(
        "{features} features in {with_features} of {} frames. Corners: corner observations found in \
         single micro-images. Board: labelled corners.\nDropped: alone (in no cluster), off the line of \
         their cluster, texture (a large cluster with hardly a line), off the board.\nSearched for again \
         where they are expected: board corners lost; micro-images unclear, with the corner misplaced, \
         or of a corner given up.",
        frames.len()
    )
}

/// Largest width of the picture under the features, px.
const PICTURE: usize = 1400;
/// Its JPEG quality, up to 100.
const QUALITY: u8 = 60;

/// A frame with its features as blur circles, coloured by corner, and the grid of the board.
#[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss)] // pixels
pub fn features_figure(image: &RawImage, detection: &Detection, board: &Board) -> Result<String> {
    let (width, height) = (image.width, image.height);
    let reduced = width.div_ceil(PICTURE).max(1);
    let grey = image.grey();
    let (columns, rows) = ((width / reduced).max(1), (height / reduced).max(1));
    let mut values = Vec::with_capacity(columns * rows);
    let mut sums = vec![0.0; width];
    for y in 0..rows {
        sums.fill(0.0);
        for row in grey.part(0, y * reduced, width, reduced).pixels.chunks_exact(width) {
            for (sum, pixel) in sums.iter_mut().zip(row) {
                *sum += pixel;
            }
        }
        let mean = |block: &[f32]| block.iter().sum::<f32>() / (reduced * reduced) as f32;
        values.extend(sums.chunks(reduced).take(columns).map(mean));
    }
    let brightest = values.iter().copied().fold(f32::MIN_POSITIVE, f32::max);
    let picture = GrayImage::from_fn(columns as u32, rows as u32, |x, y| {
        Luma([(values[y as usize * columns + x as usize] / brightest * 255.0) as u8])
    });
    let mut jpeg = Vec::new();
    JpegEncoder::new_with_quality(&mut jpeg, QUALITY)
        .encode_image(&picture)
        .map_err(|e| Error::invalid(format!("a figure could not be drawn: {e}")))?;
    let mut svg = format!(
        "<svg xmlns=\"http://www.w3.org/2000/svg\" width=\"{columns}\" height=\"{rows}\" \
         viewBox=\"-0.5 -0.5 {width} {height}\" role=\"img\">\n<title>Features of a frame</title>\n\
         <image x=\"-0.5\" y=\"-0.5\" width=\"{}\" height=\"{}\" \
         href=\"data:image/jpeg;base64,{}\"/>\n",
        columns * reduced,
        rows * reduced,
        STANDARD.encode(&jpeg)
    );
    let _ =
        writeln!(svg, "<g stroke=\"rgb(255,210,0)\" stroke-width=\"{reduced}\" opacity=\"0.8\">");
    let place = |column: i32, row: i32| detection.pinhole(f64::from(column), f64::from(row));
    for row in 0..board.rows {
        for column in 0..board.columns {
            let from = place(column, row);
            for (right, down) in [(1, 0), (0, 1)] {
                if column + right < board.columns && row + down < board.rows {
                    let to = place(column + right, row + down);
                    let _ = writeln!(
                        svg,
                        "<line x1=\"{:.1}\" y1=\"{:.1}\" x2=\"{:.1}\" y2=\"{:.1}\"/>",
                        from.x, from.y, to.x, to.y
                    );
                }
            }
        }
    }
    let first = place(0, 0);
    let _ = writeln!(
        svg,
        "</g>\n<circle cx=\"{:.1}\" cy=\"{:.1}\" r=\"{}\" fill=\"rgb(255,210,0)\"><title>corner \
         0</title></circle>\n<g fill=\"none\" stroke-width=\"0.6\">",
        first.x,
        first.y,
        4 * reduced
    );
    for f in &detection.features {
        // Neighbours on the board differ in hue.
        let hue = f.corner * 137 % 360;
        let _ = writeln!(
            svg,
            "<circle cx=\"{:.2}\" cy=\"{:.2}\" r=\"{:.2}\" stroke=\"hsl({hue},90%,60%)\"/>",
            f.u_px,
            f.v_px,
            f.rho_px.map_or(0.0, f64::abs).max(0.3)
        );
    }
    svg.push_str("</g>\n</svg>\n");
    Ok(svg)
}
