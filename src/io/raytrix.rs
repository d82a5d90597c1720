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
use crate::precalibration::{lattice_centers, lattice_orientation};

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
    let upwards = Matrix2::new(1.0, 0.0, 0.0, -1.0);
    let steps_px = upwards * base * pitch_px;
    let (kind, rotation_rad) = lattice_orientation(&steps_px)?;
    let types: Vec<Node> = root.children().filter(|node| node.has_tag_name("lens_type")).collect();
    let color = |node: &Node| {
        let offset = to_nodes * vector(child(*node, "offset")?)?;
        #[allow(clippy::cast_possible_truncation)] // a few lenses
        let (i, j) = (offset.x.round() as i32, offset.y.round() as i32);
        Ok((i - j).rem_euclid(3))
    };
    let offset = child(root, "offset")?;
    Ok(RaytrixCalibration {
        kind,
        pitch_px,
        rotation_rad,
        lens_types: types.len(),
        offset_px: upwards * vector(offset)?,
        steps_px,
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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::precalibration::fit_grid;

    /// A file of a lattice turned by so many degrees, seen with y upwards.
    fn file(turned: f64, between: f64) -> String {
        let step = |degrees: f64| {
            let (y, x) = degrees.to_radians().sin_cos();
            format!("<x>{x}</x><y>{y}</y>")
        };
        let lens_type = |i: f64| {
            let (y, x) = turned.to_radians().sin_cos();
            format!("<lens_type><offset><x>{}</x><y>{}</y></offset></lens_type>", i * x, i * y)
        };
        format!(
            "<RayCalibData><offset><x>3.5</x><y>-2.25</y></offset><diameter>23.5</diameter>\
             <lens_base_x>{}</lens_base_x><lens_base_y>{}</lens_base_y>{}{}{}</RayCalibData>",
            step(turned),
            step(turned + between),
            lens_type(0.0),
            lens_type(1.0),
            lens_type(2.0),
        )
    }

    fn read(text: &str) -> Result<RaytrixCalibration> {
        calibration(Document::parse(text).unwrap().root_element())
    }

    #[test]
    fn turned_lattices_are_read_in_either_packing() {
        use LatticeKind::{HexagonalColumns, HexagonalRows, Orthogonal};
        // Turned with y upwards, the rotation left is one back with v downwards.
        for (turned, between, kind, rotation) in [
            (4.0, 60.0, HexagonalRows, -4.0),
            (-3.0, 60.0, HexagonalRows, 3.0),
            (0.0, 120.0, HexagonalRows, 0.0),
            (92.0, -60.0, HexagonalColumns, -2.0),
            (86.5, -60.0, HexagonalColumns, 3.5),
            (2.5, 90.0, Orthogonal, -2.5),
        ] {
            let maker = read(&file(turned, between)).unwrap();
            assert_eq!(maker.kind, kind, "{turned} degrees");
            let off = maker.rotation_rad.to_degrees() - rotation;
            assert!(off.abs() < 1e-9, "{turned} degrees: off by {off}");
            let centers = maker.centers(600, 500).unwrap();
            let places: Vec<MicroImageCenter> = centers.iter().map(|&(c, _)| c).collect();
            let count =
                |index: fn(&MicroImageCenter) -> i32| places.iter().map(index).max().unwrap() + 1;
            let grid = fit_grid(&places, kind, count(|c| c.k), count(|c| c.l)).unwrap();
            assert!((grid.pitch_px - 23.5).abs() < 1e-9 && grid.rms_px < 1e-9);
            assert!((grid.rotation_rad - maker.rotation_rad).abs() < 1e-12, "{turned} degrees");
            // Lens (0, 0) is to the right of the middle, and below it as y is negative.
            let first = Vector2::new(299.5 + 3.5, 249.5 + 2.25);
            let step = Vector2::new(turned.to_radians().cos(), -turned.to_radians().sin()) * 23.5;
            for (i, lens_type) in [(0.0, 0), (1.0, 1), (2.0, 2), (3.0, 0)] {
                let place = first + step * i;
                let near = place + Vector2::new(4.0, -5.0);
                assert!((maker.nearest_center(600, 500, near) - (place - near)).norm() < 1e-9);
                assert_eq!(maker.lens_type(600, 500, near), Some(lens_type), "{turned} degrees");
            }
        }
    }

    #[test]
    fn files_of_something_else_are_refused_in_words() {
        let good = file(0.0, 60.0);
        for (text, words) in [
            ("<Settings/>".to_owned(), "its root is <Settings>"),
            (good.replace("23.5", "-1"), "the diameter is -1 px"),
            (good.replace("23.5", "wide"), "<diameter> is 'wide'"),
            (good.replace("<y>-2.25</y>", ""), "there is no <y> in it"),
            (file(0.0, 0.0), "point the same way"),
            (file(0.0, 75.0), "neither a hexagonal nor a square lattice"),
        ] {
            let error = read(&text).unwrap_err().to_string();
            assert!(error.contains(words), "{error}");
        }
    }
}
