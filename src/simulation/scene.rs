//! The scene in front of the camera.

use nalgebra::{Isometry3, Point3, UnitQuaternion, Vector2, Vector3};

use super::board_texture::BoardTexture;
use super::ray::Ray;
use super::target::{Surface, Target};
use crate::error::{Error, Result};

/// The scene that an image shows.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Scene {
    /// White target of radiance 1 that fills the view.
    White,
    /// Checkerboard at `camera_from_board`.
    Board(Target, Isometry3<f64>),
}

/// A checkerboard in the camera frame, prepared for ray tracing.
#[derive(Debug, Clone)]
pub(super) struct PlacedTarget {
    pub texture: BoardTexture,
    origin: Point3<f64>,
    /// Board axes in units of a square.
    x: Vector3<f64>,
    y: Vector3<f64>,
    plane: BoardPlane,
    bent: Option<Bent>,
    /// Depth of the nearest point of the sheet.
    nearest: f64,
}

/// The plane of a board, or one that touches a bent board.
#[derive(Debug, Clone, Copy)]
pub(super) struct BoardPlane {
    normal: Vector3<f64>,
    /// Offset of the plane: its points X have normal · X = `offset`.
    offset: f64,
    /// Normal of the image of the plane behind the lens, whose points x have `image_normal · x = offset`.
    image_normal: Vector3<f64>,
    focal_length: f64,
}

/// The surface of a bent board in the camera frame.
#[derive(Debug, Clone, Copy)]
struct Bent {
    surface: Surface,
    rotation: UnitQuaternion<f64>,
}

/// Shift of image points from the points x of an ideal lens, mm: `across` to the side, and `along` + `gradient` · x along z.
/// For the point about which it is linearised, the shift along z is `nearer`.
#[derive(Debug, Clone, Copy)]
pub(super) struct ImageShift {
    pub across: Vector2<f64>,
    pub along: f64,
    pub gradient: Vector2<f64>,
    pub nearer: f64,
}

impl ImageShift {
    /// Returns the shift of an ideal lens.
    pub fn none() -> Self {
        Self { across: Vector2::zeros(), along: 0.0, gradient: Vector2::zeros(), nearer: 0.0 }
    }
}

/// The image of a board behind the lens, about one of its points. Its points x, moved back by `shift`, have
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
    /// Returns z where a ray behind the lens meets the image plane, and true if the ray leads to the board.
    #[inline(always)]
    #[allow(clippy::inline_always)] // compiled for the registers of loops over rays
    pub fn z(&self, ray: &Ray) -> (f64, bool) {
        let (start, slope) = (ray.at_lens - self.shift, ray.slope);
        let at = self.across.x * start.x + self.across.y * start.y;
        let z =
            (self.offset - at) / (self.across.x * slope.x + self.across.y * slope.y + self.along);
        (z, z < self.limit)
    }
}

impl PlacedTarget {
    /// Places the board. Fails unless the whole sheet lies beyond the focal length and shows its front.
    pub fn new(target: &Target, pose: &Isometry3<f64>, focal_length: f64) -> Result<Self> {
        target.validate()?;
        let normal = pose.rotation * Vector3::z();
        let sheet = target.sheet_mm();
        let nearest = sheet.iter().map(|p| (pose * p).z).fold(f64::MAX, f64::min);
        if !nearest.is_finite() || nearest <= 0.0 {
            return Err(Error::invalid(format!(
                "a part of the board is behind the camera (z = {nearest:.1} mm): move it along +z"
            )));
        }
        if nearest <= focal_length {
            return Err(Error::invalid(format!(
                "a part of the board is at {nearest:.1} mm, within the focal length of \
                 {focal_length} mm, where the main lens forms no real image: move it away"
            )));
        }
        if normal.dot(&pose.translation.vector) <= 0.0 {
            return Err(Error::invalid(
                "the camera sees the back of the board: its z axis has to point away from the camera",
            ));
        }
        let surface = target.surface();
        let shows_front = |(point, surface): (&Point3<f64>, &Surface)| {
            let slope = surface.slope(&point.coords.xy());
            let normal = pose.rotation * (-slope).push(1.0);
            normal.dot(&(pose * point).coords) > 0.0
        };
        let surfaces = surface.iter().cycle();
        if !sheet.iter().zip(surfaces).all(shows_front) {
            return Err(Error::invalid(
                "the camera sees the back of a part of the bent board: tilt or bend it less",
            ));
        }
        let stretch = target.stretch();
        let offset = normal.dot(&pose.translation.vector);
        Ok(Self {
            texture: BoardTexture::new(target),
            origin: Point3::from(pose.translation.vector),
            x: pose.rotation * Vector3::x() / (target.square_mm * stretch.x),
            y: pose.rotation * Vector3::y() / (target.square_mm * stretch.y),
            plane: BoardPlane::new(normal, offset, focal_length),
            bent: surface.map(|surface| Bent { surface, rotation: pose.rotation }),
            nearest,
        })
    }

    /// Fails if the sheet comes nearer than the front of the lens.
    pub fn check_in_front(&self, front: f64) -> Result<()> {
        if self.nearest > front {
            return Ok(());
        }
        Err(Error::invalid(format!(
            "a part of the board is at {:.1} mm, but the front of the main lens is at {front:.1} \
             mm: move it away",
            self.nearest
        )))
    }

    /// Returns the plane of the board; for a bent board, the plane without its bend.
    pub fn plane(&self) -> &BoardPlane {
        &self.plane
    }

    /// Returns true if the board is bent.
    pub fn is_bent(&self) -> bool {
        self.bent.is_some()
    }

    /// Returns the plane that touches a bent board where a ray in front of the lens meets it; `None` for a flat board,
    /// or if the ray misses it.
    pub fn tangent(&self, ray: &Ray) -> Option<BoardPlane> {
        let bent = self.bent.as_ref()?;
        let hit = bent.meet(self.on_plane(ray), ray)?;
        let place = bent.rotation.inverse() * hit;
        let normal = bent.rotation * (-bent.surface.slope(&place.xy())).push(1.0).normalize();
        let offset = normal.dot(&(self.origin + hit).coords);
        Some(BoardPlane::new(normal, offset, self.plane.focal_length))
    }

    /// Returns z where a ray in front of the lens meets the plane of the board.
    #[inline(always)]
    #[allow(clippy::inline_always)] // compiled for the registers of loops over rays
    pub fn depth(&self, ray: &Ray) -> f64 {
        let (normal, off) = (&self.plane.normal, self.origin.xy() - ray.at_lens);
        let across = normal.x * off.x + normal.y * off.y + normal.z * self.origin.z;
        across / (normal.x * ray.slope.x + normal.y * ray.slope.y + normal.z)
    }

    /// Returns the point where a ray in front of the lens meets the plane of the board, from corner 0.
    #[inline(always)]
    #[allow(clippy::inline_always)] // compiled for the registers of loops over rays
    fn on_plane(&self, ray: &Ray) -> Vector3<f64> {
        let depth = self.depth(ray);
        let at = ray.at(depth);
        Vector3::new(at.x - self.origin.x, at.y - self.origin.y, depth - self.origin.z)
    }

    /// Returns the point where a ray in front of the lens meets the board, camera frame; `None` if it misses a bent board.
    #[cfg(test)]
    pub fn hit(&self, ray: &Ray) -> Option<Point3<f64>> {
        let hit = self.on_plane(ray);
        let hit = self.bent.as_ref().map_or(Some(hit), |bent| bent.meet(hit, ray))?;
        Some(self.origin + hit)
    }

    /// Returns the radiance along a ray in front of the lens.
    pub fn radiance(&self, ray: &Ray) -> f64 {
        let Some(bent) = &self.bent else { return self.texture.radiance(self.place(ray)) };
        let hit = bent.meet(self.on_plane(ray), ray);
        hit.map_or(self.texture.background, |hit| self.texture.radiance(self.in_squares(&hit)))
    }

    /// Returns the position on the sheet where a ray in front of the lens meets the plane of the board, see [`BoardTexture`].
    #[inline(always)]
    #[allow(clippy::inline_always)] // compiled for the registers of loops over rays
    pub fn place(&self, ray: &Ray) -> Vector2<f64> {
        self.in_squares(&self.on_plane(ray))
    }

    #[inline(always)]
    #[allow(clippy::inline_always)] // compiled for the registers of loops over rays
    fn in_squares(&self, hit: &Vector3<f64>) -> Vector2<f64> {
        let along = |axis: &Vector3<f64>| axis.x * hit.x + axis.y * hit.y + axis.z * hit.z + 1.0;
        Vector2::new(along(&self.x), along(&self.y))
    }
}

impl BoardPlane {
    fn new(normal: Vector3<f64>, offset: f64, focal_length: f64) -> Self {
        // An object point X has its image x where X = x F/(z' + F), so n·X = c becomes
        // n·x − (c/F) z' = c.
        let image_normal = normal - Vector3::z() * (offset / focal_length);
        Self { normal, offset, image_normal, focal_length }
    }

    /// Returns the image of the plane, where distortion and field curvature move it by `shift`.
    pub fn image_plane(&self, shift: &ImageShift) -> ImagePlane {
        ImagePlane {
            shift: shift.across,
            across: self.image_normal.xy() - shift.gradient * self.image_normal.z,
            along: self.image_normal.z,
            offset: self.offset + self.image_normal.z * shift.along,
            limit: shift.nearer - self.focal_length,
        }
    }
}

impl Bent {
    /// Returns the point where a ray in front of the lens meets the surface, from corner 0, if the ray meets the plane of the
    /// board at `on_plane`.
    fn meet(&self, on_plane: Vector3<f64>, ray: &Ray) -> Option<Vector3<f64>> {
        let to_board = self.rotation.inverse();
        let towards = to_board * ray.slope.push(1.0);
        let place = (to_board * on_plane).xy();
        let hit = self.surface.meet(&place, &(towards.xy() / towards.z))?;
        Some(self.rotation * hit)
    }
}
