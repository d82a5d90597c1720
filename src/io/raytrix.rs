//! Raytrix' `RayCalibData` (XML): the micro-image array as its maker measured it.
//!
//! Positions count from the middle of the image, y upwards, in units of the pitch ("lens") but for
//! the offset, which is in px.

use std::path::Path;

use nalgebra::{Matrix2, Vector2};
use roxmltree::{Document, Node};

use super::read_text;
use crate::error::{Error, Result};
use crate::lattice::LatticeKind;
use crate::observations::MicroImageCenter;
use crate::precalibration::lattice_centers;

/// A micro-image array from a `RayCalibData` file.
#[derive(Debug, Clone, PartialEq)]
pub struct RaytrixCalibration {
    /// Packing.
    pub kind: LatticeKind,
    /// Distance of neighbouring centres, px.
    pub pitch_px: f64,
    /// Rotation of the lattice in the image, rad, from u towards v.
    pub rotation_rad: f64,
    /// Number of lens types.
    pub lens_types: usize,
    /// Middle of lens (0, 0) from the middle of the image, px, v downwards.
    offset_px: Vector2<f64>,
    /// Steps to the next lenses, px, v downwards.
    steps_px: Matrix2<f64>,
    /// Colour of each lens type, see [`RaytrixCalibration::lens_type`].
    colors: Vec<i32>,
}

/// Reads a `RayCalibData` file.
pub fn read_raytrix(path: &Path) -> Result<RaytrixCalibration> {
    let text = read_text(path)?;
    let document = Document::parse(&text)
        .map_err(|e| Error::content(path, format!("this is not valid XML: {e}")))?;
    calibration(document.root_element()).map_err(|e| e.in_file(path))
}

fn calibration(root: Node) -> Result<RaytrixCalibration> {
    if !root.has_tag_name("RayCalibData") {
        return Err(Error::invalid(format!(
            "this is not Raytrix' calibration: its root is <{}>, not <RayCalibData>",
            root.tag_name().name()
        )));
    }
    let pitch_px = number(child(root, "diameter")?)?;
    if !(pitch_px.is_finite() && pitch_px > 0.0) {
        return Err(Error::invalid(format!("the diameter is {pitch_px} px")));
    }
    let (x, y) = (vector(child(root, "lens_base_x")?)?, vector(child(root, "lens_base_y")?)?);
    let base = Matrix2::from_columns(&[x, y]);
    let to_nodes = base.try_inverse().ok_or_else(|| {
        Error::invalid("lens_base_x and lens_base_y point the same way, which makes no lattice")
    })?;
    let angle = (x.dot(&y) / (x.norm() * y.norm())).clamp(-1.0, 1.0).acos().to_degrees();
    // Straight rows along the image's rows turn by less than a twelfth, else they are columns.
    let turned = |step: Vector2<f64>, period: f64| {
        let angle = step.y.atan2(step.x);
        angle - (angle / period).round() * period
    };
    let right = std::f64::consts::FRAC_PI_2;
    let (kind, rotation) = if (angle - 90.0).abs() < 1.0 {
        (LatticeKind::Orthogonal, turned(x, right))
    } else if (angle - 60.0).abs() < 1.0 || (angle - 120.0).abs() < 1.0 {
        let sixth = std::f64::consts::FRAC_PI_3;
        let of_rows = turned(x, sixth);
        if of_rows.abs() < sixth / 4.0 {
            (LatticeKind::HexagonalRows, of_rows)
        } else {
            (LatticeKind::HexagonalColumns, turned(Vector2::new(x.y, -x.x), sixth))
        }
    } else {
        return Err(Error::invalid(format!(
            "the lattice's steps are {angle:.1} degrees apart: neither hexagonal nor square"
        )));
    };
    let types: Vec<Node> = root.children().filter(|node| node.has_tag_name("lens_type")).collect();
    let color = |node: &Node| {
        let offset = to_nodes * vector(child(*node, "offset")?)?;
        #[allow(clippy::cast_possible_truncation)] // a few lenses
        let (i, j) = (offset.x.round() as i32, offset.y.round() as i32);
        Ok((i - j).rem_euclid(3))
    };
    let upwards = Matrix2::new(1.0, 0.0, 0.0, -1.0);
    let offset = child(root, "offset")?;
    Ok(RaytrixCalibration {
        kind,
        pitch_px,
        // From y upwards to v downwards.
        rotation_rad: -rotation,
        lens_types: types.len(),
        offset_px: upwards * vector(offset)?,
        steps_px: upwards * base * pitch_px,
        colors: types.iter().map(color).collect::<Result<_>>()?,
    })
}

fn child<'a>(node: Node<'a, 'a>, name: &str) -> Result<Node<'a, 'a>> {
    node.children()
        .find(|child| child.has_tag_name(name))
        .ok_or_else(|| Error::invalid(format!("there is no <{name}> in it")))
}

fn number(node: Node) -> Result<f64> {
    let text = node.text().unwrap_or_default().trim();
    text.parse::<f64>().ok().filter(|value| value.is_finite()).ok_or_else(|| {
        Error::invalid(format!("<{}> is '{text}', not a number", node.tag_name().name()))
    })
}

fn vector(node: Node) -> Result<Vector2<f64>> {
    let part = |name| number(child(node, name)?);
    Ok(Vector2::new(part("x")?, part("y")?))
}

impl RaytrixCalibration {
    /// From a position of an image of so many pixels to the nearest centre, px.
    #[must_use]
    pub fn nearest_center(&self, width: u32, height: u32, p: Vector2<f64>) -> Vector2<f64> {
        let (node, from_first) = self.nearest(width, height, p);
        self.steps_px * node - from_first
    }

    /// All centres in an image of so many pixels, with the number of their lens type in the file (from
    /// 0; `None` if it names none).
    pub fn centers(
        &self,
        width: u32,
        height: u32,
    ) -> Result<Vec<(MicroImageCenter, Option<usize>)>> {
        let origin = Self::middle(width, height) + self.offset_px;
        let (_, centers) = lattice_centers((width, height), &origin, &self.steps_px)?;
        let typed =
            |c: MicroImageCenter| (c, self.lens_type(width, height, Vector2::new(c.u_px, c.v_px)));
        Ok(centers.into_iter().map(typed).collect())
    }

    fn middle(width: u32, height: u32) -> Vector2<f64> {
        Vector2::new(f64::from(width) - 1.0, f64::from(height) - 1.0) / 2.0
    }

    /// Lens type (from 0) of the centre nearest to a position; `None` if the file names no types.
    #[must_use]
    pub fn lens_type(&self, width: u32, height: u32, p: Vector2<f64>) -> Option<usize> {
        let (node, _) = self.nearest(width, height, p);
        #[allow(clippy::cast_possible_truncation)] // indices of lenses
        let color = (node.x - node.y).rem_euclid(3.0).round() as i32 % 3;
        self.colors.iter().position(|&c| c == color)
    }

    /// The nearest node, and the position from node (0, 0).
    fn nearest(&self, width: u32, height: u32, p: Vector2<f64>) -> (Vector2<f64>, Vector2<f64>) {
        let from_first = p - Self::middle(width, height) - self.offset_px;
        let place = self.steps_px.try_inverse().unwrap_or_else(Matrix2::zeros) * from_first;
        // On a hexagonal lattice rounding is not always nearest; look around.
        let rounded = place.map(f64::round);
        let around = (-1..=1).flat_map(|i| (-1..=1).map(move |j| (f64::from(i), f64::from(j))));
        let nearest = around
            .map(|(i, j)| rounded + Vector2::new(i, j))
            .min_by(|a, b| {
                let off = |n: &Vector2<f64>| (self.steps_px * n - from_first).norm_squared();
                off(a).total_cmp(&off(b))
            })
            .unwrap_or(rounded);
        (nearest, from_first)
    }
}
