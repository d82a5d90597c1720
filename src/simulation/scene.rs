//! What the camera looks at.

use nalgebra::{Isometry3, Point3, Vector2, Vector3};
use serde::{Deserialize, Serialize};

use super::ray::Ray;
use super::thin_lens::ImageShift;
use crate::error::{Error, Result};
use crate::model::{Board, positive};

/// A printed checkerboard: squares around its inner corners, a border, and the background. The square
/// diagonally before corner 0 is black. Radiances are relative to a white target.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Target {
    /// Inner corners along a row.
    pub columns: i32,
    /// Inner corners along a column.
    pub rows: i32,
    /// Side of a square, mm.
    pub square_mm: f64,
    /// Width of the white border around the squares, mm.
    pub border_mm: f64,
    /// Radiance of white squares and border.
    pub white: f64,
    /// Radiance of black squares.
    pub black: f64,
    /// Radiance of everything beyond the border.
    pub background: f64,
}

impl Target {
    /// The board by its inner corners.
    #[must_use]
    pub fn board(&self) -> Board {
        Board { columns: self.columns, rows: self.rows, square_mm: self.square_mm }
    }

    /// The four corners of the sheet in the board frame, mm.
    #[must_use]
    pub fn sheet_mm(&self) -> [Point3<f64>; 4] {
        let low = -self.square_mm - self.border_mm;
        let x = f64::from(self.columns) * self.square_mm + self.border_mm;
        let y = f64::from(self.rows) * self.square_mm + self.border_mm;
        [(low, low), (x, low), (low, y), (x, y)].map(|(x, y)| Point3::new(x, y, 0.0))
    }

    pub(super) fn validate(&self) -> Result<()> {
        self.board().validate()?;
        if !self.border_mm.is_finite() || self.border_mm < 0.0 {
            return Err(Error::invalid(format!(
                "the border of the target is {} mm wide; give 0 or more",
                self.border_mm
            )));
        }
        positive(self.white, "the radiance of the target's white")?;
        for (name, radiance) in [("black", self.black), ("background", self.background)] {
            if !(0.0..f64::INFINITY).contains(&radiance) {
                return Err(Error::invalid(format!(
                    "the radiance of the target's {name} is {radiance}; give 0 or more"
                )));
            }
        }
        if self.black >= self.white {
            return Err(Error::invalid(format!(
                "the target's black ({}) is not darker than its white ({})",
                self.black, self.white
            )));
        }
        Ok(())
    }
}

/// What an image shows.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Scene {
    /// A white target of radiance 1 that fills the view.
    White,
    /// A checkerboard at `camera_from_board`.
    Board(Target, Isometry3<f64>),
}

/// A checkerboard in the camera frame, prepared for ray tracing.
#[derive(Debug, Clone)]
pub(super) struct PlacedTarget {
    target: Target,
    origin: Point3<f64>,
    /// Board axes in units of a square.
    x: Vector3<f64>,
    y: Vector3<f64>,
    normal: Vector3<f64>,
    border: f64,
    focal_length: f64,
    /// Depth of the nearest corner of the sheet.
    nearest: f64,
    /// The plane of the board's image: points x with `image_normal · x = offset`.
    image_normal: Vector3<f64>,
    offset: f64,
}

/// The image of a board behind the lens about one of its points: points x, moved back by `shift`, with
/// `across` · x + `along` z = `offset`.
#[derive(Debug, Clone, Copy)]
pub(super) struct ImagePlane {
    shift: Vector2<f64>,
    across: Vector2<f64>,
    along: f64,
    offset: f64,
    /// z of the image of infinity.
    limit: f64,
}

impl ImagePlane {
    /// z where a ray behind the lens meets it; `None` if the ray leads away from the board.
    #[inline]
    pub fn z(&self, ray: &Ray) -> Option<f64> {
        let start = ray.at_lens - self.shift;
        let z =
            (self.offset - self.across.dot(&start)) / (self.across.dot(&ray.slope) + self.along);
        (z < self.limit).then_some(z)
    }
}

impl PlacedTarget {
    /// An error unless the whole sheet lies beyond the focal length and shows its front.
    pub fn new(target: &Target, pose: &Isometry3<f64>, focal_length: f64) -> Result<Self> {
        target.validate()?;
        let normal = pose.rotation * Vector3::z();
        let nearest = target.sheet_mm().map(|p| (pose * p).z).into_iter().fold(f64::MAX, f64::min);
        if !nearest.is_finite() || nearest <= 0.0 {
            return Err(Error::invalid(format!(
                "the board reaches behind the camera (z = {nearest:.1} mm): move it along +z"
            )));
        }
        if nearest <= focal_length {
            return Err(Error::invalid(format!(
                "the board comes as near as {nearest:.1} mm, within the focal length of \
                 {focal_length} mm, where the main lens forms no real image: move it away"
            )));
        }
        if normal.dot(&pose.translation.vector) <= 0.0 {
            return Err(Error::invalid(
                "the camera sees the back of the board: its z axis has to point away from the camera",
            ));
        }
        // An object point X has its image x where X = x F/(z' + F), so n·X = c becomes
        // n·x − (c/F) z' = c.
        let offset = normal.dot(&pose.translation.vector);
        Ok(Self {
            target: *target,
            origin: Point3::from(pose.translation.vector),
            x: pose.rotation * Vector3::x() / target.square_mm,
            y: pose.rotation * Vector3::y() / target.square_mm,
            normal,
            border: target.border_mm / target.square_mm,
            focal_length,
            nearest,
            image_normal: normal - Vector3::z() * (offset / focal_length),
            offset,
        })
    }

    /// An error if the sheet comes nearer than the front of the lens.
    pub fn check_in_front(&self, front: f64) -> Result<()> {
        if self.nearest > front {
            return Ok(());
        }
        Err(Error::invalid(format!(
            "the board comes as near as {:.1} mm, and the front of the main lens is at {front:.1} mm: move \
             it away",
            self.nearest
        )))
    }

    /// The image of the board where distortion and the curvature of the field move it by `shift`.
    pub fn image_plane(&self, shift: &ImageShift) -> ImagePlane {
        ImagePlane {
            shift: shift.across,
            across: self.image_normal.xy() - shift.gradient * self.image_normal.z,
            along: self.image_normal.z,
            offset: self.offset + self.image_normal.z * shift.along,
            limit: shift.nearer - self.focal_length,
        }
    }

    /// z where a ray in front of the lens meets the plane of the board.
    #[inline]
    pub fn depth(&self, ray: &Ray) -> f64 {
        let start = Point3::new(ray.at_lens.x, ray.at_lens.y, 0.0);
        self.normal.dot(&(self.origin - start)) / self.normal.dot(&ray.slope.push(1.0))
    }

    /// Radiance of the background.
    pub fn background(&self) -> f64 {
        self.target.background
    }

    /// Radiance along a ray in front of the lens.
    #[inline(always)]
    #[allow(clippy::inline_always)] // a board takes 10 % longer without
    pub fn radiance(&self, ray: &Ray) -> f64 {
        let depth = self.depth(ray);
        let hit = ray.at(depth).push(depth) - self.origin.coords;
        // In squares, the first one from 0 to 1.
        let (x, y) = (self.x.dot(&hit) + 1.0, self.y.dot(&hit) + 1.0);
        let (columns, rows) = (f64::from(self.target.columns + 1), f64::from(self.target.rows + 1));
        if (0.0..columns).contains(&x) && (0.0..rows).contains(&y) {
            #[allow(clippy::cast_possible_truncation)] // within the sheet
            let black = (x as i32 + y as i32) % 2 == 0;
            return if black { self.target.black } else { self.target.white };
        }
        let on_sheet = (-self.border..columns + self.border).contains(&x)
            && (-self.border..rows + self.border).contains(&y);
        if on_sheet { self.target.white } else { self.target.background }
    }
}
