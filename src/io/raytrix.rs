//! Raytrix' `RayCalibData` (XML): the micro-image array measured by the maker.
//!
//! Positions are measured from the middle of the image, y upwards, in units of the pitch ("lens"),
//! except for the offset, which is in px.

use std::f64::consts::{FRAC_PI_2, FRAC_PI_6};
use std::path::Path;

use nalgebra::{Matrix2, Vector2};
use roxmltree::{Document, Node};

use super::read_text;
use crate::error::{Error, Result};
use crate::finding::{Finding, Issue};
use crate::model::{LatticeKind, MOST_PIXELS, MicroImageCenter, check_lens_types};
use crate::precalibration::{lattice_centers, lattice_orientation};

/// Micro-image array from a `RayCalibData` file.
#[derive(Debug, Clone, PartialEq)]
pub struct RaytrixCalibration {
    /// Packing.
    pub kind: LatticeKind,
    /// Distance between neighbouring centres, px.
    pub pitch_px: f64,
    /// Rotation of the lattice in the image, rad, from u towards v.
    pub rotation_rad: f64,
    /// Number of lens types; one if the file names none.
    pub lens_types: usize,
    /// Position of lens (0, 0) relative to the middle of the image, px, v downwards.
    offset_px: Vector2<f64>,
    /// Steps to two neighbours, 60 degrees apart on a hexagonal lattice, px, v downwards.
    steps_px: Matrix2<f64>,
    /// Colours of the lens types if there are several, see [`color`].
    colors: Vec<i32>,
    /// Values of the file about the array that are not used.
    unused: Unused,
}

/// Values of a file that are not used, since their reference or their sign is not known.
#[derive(Debug, Clone, PartialEq, Default)]
struct Unused {
    /// Name of a distortion with parameters that are not 0.
    distortion: Option<String>,
    /// Rotation in addition to the rotation of the lattice, rad.
    rotation_rad: f64,
}

/// Least rotation that is not rounding; it moves points at the border of a large image by 0.05 px.
const LEAST_ROTATION_RAD: f64 = 1e-5;

impl Unused {
    fn of(root: Node, kind: LatticeKind, lattice_rad: f64) -> Self {
        let in_root = |name: &str| root.children().find(|child| child.has_tag_name(name));
        let text = |node: Node, name: &str| {
            let inner = node.children().find(|child| child.has_tag_name(name));
            inner.and_then(|node| node.text()).unwrap_or_default().trim().to_owned()
        };
        let distortion = in_root("distortion").and_then(|node| {
            let all = text(node, "parameter");
            let stated = all.split(';').filter_map(|number| number.trim().parse::<f64>().ok());
            (stated.into_iter().any(|number| number != 0.0)).then(|| text(node, "function"))
        });
        // The stated rotation of a hexagonal lattice may refer to one of six directions along rows, or of six between them. In
        // the file, y is upwards, so that its angles have the opposite sign.
        let stated = in_root("rotation").and_then(|node| number(node).ok()).unwrap_or(0.0);
        let symmetry = if kind == LatticeKind::Orthogonal { FRAC_PI_2 } else { FRAC_PI_6 };
        let beside = stated + lattice_rad;
        let rotation_rad = beside - (beside / symmetry).round() * symmetry;
        let is_some = rotation_rad.is_finite() && rotation_rad.abs() > LEAST_ROTATION_RAD;
        Self { distortion, rotation_rad: if is_some { rotation_rad } else { 0.0 } }
    }
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
            "this is not a Raytrix calibration: its root is <{}>, not <RayCalibData>. XML files of other cameras, such as TSPC, \
             are not read: measure the array on a white image",
            root.tag_name().name()
        )));
    }
    let unit_px = number(child(root, "diameter")?)?;
    if unit_px <= 0.0 {
        return Err(Error::invalid(format!(
            "the diameter is {unit_px} px: give the pitch of the micro-images, which is positive"
        )));
    }
    let (x, y) = (vector(child(root, "lens_base_x")?)?, vector(child(root, "lens_base_y")?)?);
    let base = Matrix2::from_columns(&[x, y]);
    if !base.is_invertible() {
        return Err(Error::invalid(
            "lens_base_x and lens_base_y are parallel and do not span a lattice",
        ));
    }
    let upwards = Matrix2::new(1.0, 0.0, 0.0, -1.0);
    let (kind, rotation_rad, steps_px) = lattice_orientation(&(upwards * base * unit_px))?;
    let to_nodes = steps_px.try_inverse().unwrap_or_else(Matrix2::zeros) * upwards * unit_px;
    let colors = type_colors(root, kind, &to_nodes)?;
    let offset = child(root, "offset")?;
    Ok(RaytrixCalibration {
        kind,
        pitch_px: steps_px.column(0).norm(),
        rotation_rad,
        lens_types: colors.len().max(1),
        offset_px: upwards * vector(offset)?,
        steps_px,
        colors,
        unused: Unused::of(root, kind, rotation_rad),
    })
}

/// Largest deviation of the offset of a lens type from a whole number of steps, in steps.
const ON_NODE: f64 = 0.1;

/// Returns the colours of the lens types of a file in its order, if there are several.
fn type_colors(root: Node, kind: LatticeKind, to_nodes: &Matrix2<f64>) -> Result<Vec<i32>> {
    let types: Vec<Node> = root.children().filter(|node| node.has_tag_name("lens_type")).collect();
    check_lens_types(types.len(), kind)
        .map_err(|e| Error::invalid(format!("<lens_type> appears {} times: {e}", types.len())))?;
    if types.len() < 2 {
        return Ok(Vec::new());
    }
    let mut colors = Vec::new();
    for (i, node) in types.into_iter().enumerate() {
        let offset = vector(child(node, "offset")?)?;
        let steps = to_nodes * offset;
        let node = steps.map(f64::round);
        let color = color(&node);
        if (steps - node).amax() > ON_NODE || colors.contains(&color) {
            return Err(Error::invalid(format!(
                "the offset ({}, {}) of <lens_type> {} points to no lens, or to a lens of an \
                 earlier type: correct it, so that the types belong to three neighbours",
                offset.x,
                offset.y,
                i + 1
            )));
        }
        colors.push(color);
    }
    Ok(colors)
}

/// Returns the colour (0 to 2) of a node in steps to neighbours 60 degrees apart; neighbours have different colours.
#[allow(clippy::cast_possible_truncation)] // from 0 to 2
fn color(node: &Vector2<f64>) -> i32 {
    (node.x - node.y).rem_euclid(3.0) as i32
}

fn child<'a>(node: Node<'a, 'a>, name: &str) -> Result<Node<'a, 'a>> {
    node.children()
        .find(|child| child.has_tag_name(name))
        .ok_or_else(|| Error::invalid(format!("it has no <{name}>")))
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
    /// Returns findings about values of the file that are not used.
    #[must_use]
    pub fn findings(&self) -> Vec<Finding> {
        let Unused { distortion, rotation_rad } = self.unused.clone();
        let is_some = distortion.is_some() || rotation_rad != 0.0;
        let issue = is_some.then_some(Issue::MakerValuesUnused { distortion, rotation_rad });
        issue.into_iter().map(Finding::caution).collect()
    }

    /// Estimates the number of centres in an image of this size, px. An error if it has more pixels than any sensor.
    pub fn number_of_centers(&self, width: u16, height: u16) -> Result<f64> {
        if u64::from(width) * u64::from(height) > MOST_PIXELS {
            return Err(Error::invalid(format!("the limit is {MOST_PIXELS} pixels")));
        }
        Ok(f64::from(width) * f64::from(height) / self.steps_px.determinant().abs())
    }

    /// Returns all centres in an image of this size, px. Errors are the same as in [`Self::number_of_centers`].
    pub fn centers(&self, width: u16, height: u16) -> Result<Vec<MicroImageCenter>> {
        self.number_of_centers(width, height)?;
        let origin = Self::middle(width, height) + self.offset_px;
        lattice_centers((width, height), &origin, &self.steps_px)
    }

    fn middle(width: u16, height: u16) -> Vector2<f64> {
        Vector2::new(f64::from(width) - 1.0, f64::from(height) - 1.0) / 2.0
    }

    /// Returns the lens type, from 0 in the order of the file, of the centre nearest to a position in an image of this size,
    /// px.
    #[must_use]
    pub fn lens_type(&self, width: u16, height: u16, p: Vector2<f64>) -> usize {
        let color = color(&self.nearest(width, height, p));
        self.colors.iter().position(|&c| c == color).unwrap_or(0)
    }

    /// Returns the nearest node.
    fn nearest(&self, width: u16, height: u16, p: Vector2<f64>) -> Vector2<f64> {
        let from_first = p - Self::middle(width, height) - self.offset_px;
        let place = self.steps_px.try_inverse().unwrap_or_else(Matrix2::zeros) * from_first;
        // On a hexagonal lattice rounding does not always give the nearest node, so its neighbours are tried too.
        let rounded = place.map(f64::round);
        let around = (-1..=1).flat_map(|i| (-1..=1).map(move |j| (f64::from(i), f64::from(j))));
        around
            .map(|(i, j)| rounded + Vector2::new(i, j))
            .min_by(|a, b| {
                let off = |n: &Vector2<f64>| (self.steps_px * n - from_first).norm_squared();
                off(a).total_cmp(&off(b))
            })
            .unwrap_or(rounded)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::precalibration::fit_grid;

    /// Creates a file of a lattice rotated by `turned` degrees, with y upwards, and with lens types at these steps along the
    /// first base.
    fn file(turned: f64, between: f64, types: &[f64]) -> String {
        let step = |degrees: f64| {
            let (y, x) = degrees.to_radians().sin_cos();
            format!("<x>{x}</x><y>{y}</y>")
        };
        let lens_type = |&i: &f64| {
            let (y, x) = turned.to_radians().sin_cos();
            format!("<lens_type><offset><x>{}</x><y>{}</y></offset></lens_type>", i * x, i * y)
        };
        format!(
            "<RayCalibData><offset><x>3.5</x><y>-2.25</y></offset><diameter>23.5</diameter>\
             <lens_base_x>{}</lens_base_x><lens_base_y>{}</lens_base_y>{}</RayCalibData>",
            step(turned),
            step(turned + between),
            types.iter().map(lens_type).collect::<String>(),
        )
    }

    fn read(text: &str) -> Result<RaytrixCalibration> {
        calibration(Document::parse(text).unwrap().root_element())
    }

    #[test]
    fn turned_lattices_are_read_in_either_packing() {
        use LatticeKind::{HexagonalColumns, HexagonalRows, Orthogonal};
        // The sign of a rotation differs, since y is upwards and v downwards.
        for (turned, between, kind, rotation) in [
            (4.0, 60.0, HexagonalRows, -4.0),
            (-3.0, 60.0, HexagonalRows, 3.0),
            (0.0, 120.0, HexagonalRows, 0.0),
            (1.5, -120.0, HexagonalRows, -1.5),
            (92.0, -60.0, HexagonalColumns, -2.0),
            (86.5, -60.0, HexagonalColumns, 3.5),
            (2.5, 90.0, Orthogonal, -2.5),
        ] {
            let types: &[f64] = if kind == Orthogonal { &[0.0] } else { &[0.0, 1.0, 2.0] };
            let maker = read(&file(turned, between, types)).unwrap();
            assert_eq!(maker.lens_types, types.len());
            assert_eq!(maker.kind, kind, "{turned} degrees");
            let off = maker.rotation_rad.to_degrees() - rotation;
            assert!(off.abs() < 1e-9, "{turned} degrees: off by {off}");
            let places = maker.centers(600, 500).unwrap();
            let count =
                |index: fn(&MicroImageCenter) -> i32| places.iter().map(index).max().unwrap() + 1;
            let grid = fit_grid(&places, kind, count(|c| c.k), count(|c| c.l)).unwrap();
            assert!((grid.pitch_px - 23.5).abs() < 1e-9 && grid.rms_px < 1e-9);
            assert!((grid.rotation_rad - maker.rotation_rad).abs() < 1e-12, "{turned} degrees");
            // Lens (0, 0) is to the right of the middle, and below it since y is negative.
            let first = Vector2::new(299.5 + 3.5, 249.5 + 2.25);
            let step = Vector2::new(turned.to_radians().cos(), -turned.to_radians().sin()) * 23.5;
            let at = |c: &MicroImageCenter| Vector2::new(c.u_px, c.v_px);
            for (i, lens_type) in [(0.0, 0), (1.0, 1), (2.0, 2), (3.0, 0)] {
                let place = first + step * i;
                assert!(places.iter().any(|c| (at(c) - place).norm() < 1e-9));
                let near = place + Vector2::new(4.0, -5.0);
                let expected = if kind == Orthogonal { 0 } else { lens_type };
                assert_eq!(maker.lens_type(600, 500, near), expected, "{turned} degrees");
            }
            for (n, a) in places.iter().enumerate().filter(|_| kind != Orthogonal) {
                for b in places[..n].iter().filter(|b| (at(a) - at(b)).norm() < 1.1 * 23.5) {
                    let of = |c| maker.lens_type(600, 500, at(c));
                    assert_ne!(of(a), of(b), "{turned}, {between} degrees: {a:?} and {b:?}");
                }
            }
        }
    }

    #[test]
    fn without_types_or_with_one_there_is_one_type() {
        for types in [&[][..], &[1.0]] {
            let maker = read(&file(0.0, 60.0, types)).unwrap();
            assert_eq!(maker.lens_types, 1);
            let centers = maker.centers(600, 500).unwrap();
            let of = |c: &MicroImageCenter| maker.lens_type(600, 500, Vector2::new(c.u_px, c.v_px));
            assert!(centers.iter().all(|c| of(c) == 0));
        }
    }

    #[test]
    fn images_are_not_larger_than_sensors() {
        let maker = read(&file(0.0, 60.0, &[0.0, 1.0, 2.0])).unwrap();
        let error = maker.centers(65_535, 65_535).unwrap_err().to_string();
        assert!(error.contains("268435456 pixels"), "{error}");
        let (about, count) =
            (maker.number_of_centers(600, 500).unwrap(), maker.centers(600, 500).unwrap().len());
        assert!((about / count as f64 - 1.0).abs() < 0.1, "{about} {count}");
    }

    #[test]
    fn what_is_not_used_is_told() {
        let three = [0.0, 1.0, 2.0];
        let of = |turned: f64, more: &str| {
            let file = file(turned, 60.0, &three);
            let maker = read(&file.replace("</RayCalibData>", &format!("{more}</RayCalibData>")));
            maker.unwrap().findings().into_iter().map(|finding| finding.issue).collect::<Vec<_>>()
        };
        let distortion = |function: &str, parameters: &str| {
            format!(
                "<distortion><function>{function}</function><parameter>{parameters}</parameter></distortion>"
            )
        };
        let issue = |distortion: Option<&str>, rotation_rad: f64| {
            vec![Issue::MakerValuesUnused {
                distortion: distortion.map(str::to_owned),
                rotation_rad,
            }]
        };
        assert_eq!(of(0.0, &distortion("constant", "0")), []);
        assert_eq!(of(0.0, &distortion("Brown", "-0.001;0.0007")), issue(Some("Brown"), 0.0));
        // The rotation of the lattice itself is no additional value.
        assert_eq!(of(0.0, "<rotation>0.000005</rotation>"), []);
        assert_eq!(of(90.0, "<rotation>1.570796370506</rotation>"), []);
        let [Issue::MakerValuesUnused { distortion: None, rotation_rad }] =
            of(0.0, "<rotation>0.0007</rotation>")[..]
        else {
            panic!("a rotation is not told")
        };
        assert!((rotation_rad - 7e-4).abs() < 1e-9, "{rotation_rad}");
    }

    #[test]
    fn other_files_are_refused_with_a_reason() {
        let three = [0.0, 1.0, 2.0];
        let good = file(0.0, 60.0, &three);
        for (text, words) in [
            ("<Settings/>".to_owned(), "its root is <Settings>"),
            (good.replace("23.5", "-1"), "the diameter is -1 px"),
            (good.replace("23.5", "wide"), "<diameter> is 'wide'"),
            (good.replace("<y>-2.25</y>", ""), "it has no <y>"),
            (file(0.0, 0.0, &three), "are parallel"),
            (file(0.0, 75.0, &three), "neither a hexagonal nor a square lattice"),
            (file(0.0, 60.0, &[0.0, 1.0]), "<lens_type> appears 2 times"),
            (file(0.0, 90.0, &three), "<lens_type> appears 3 times"),
            (file(0.0, 60.0, &[0.0, 1.0, 4.0]), "<lens_type> 3 points to no lens, or to a lens"),
            (file(0.0, 60.0, &[0.0, 0.5, 2.0]), "<lens_type> 2 points to no lens"),
        ] {
            let error = read(&text).unwrap_err().to_string();
            assert!(error.contains(words), "{error}");
        }
    }
}
