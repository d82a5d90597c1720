//! The thin main lens at z = 0, with lateral distortion and a curved field.

use nalgebra::{Matrix2, Point3, Vector2};

#[cfg(test)]
use super::ray::Passage;
use super::ray::{Ray, Stop};
use super::scene::{BoardPlane, ImagePlane, ImageShift, PlacedTarget};
use crate::model::MainLens;

#[derive(Debug, Clone)]
pub(super) struct ThinMainLens {
    lens: MainLens,
    distorts: bool,
    /// True if image points differ from the image points of an ideal lens.
    pub moves: bool,
    pub pupil: Stop,
    /// Refractive power 1/F.
    power: f64,
}

/// Distortion, linearised about the image point of one ray of a narrow bundle. Other rays start from it; one Newton step with
/// this Jacobian then leaves an error of third order in the width of the bundle.
#[derive(Debug, Clone, Copy)]
struct LocalDistortion {
    distorted: Vector2<f64>,
    undistorted: Vector2<f64>,
    inverse: Matrix2<f64>,
    /// Shift of image points near this one from the ideal ones.
    shift: ImageShift,
}

/// Data that the rays of a narrow bundle share, if they lead to the board.
#[derive(Debug, Clone, Copy)]
pub(super) struct Aim {
    local: LocalDistortion,
    plane: ImagePlane,
}

/// Number of points checked from the axis to a corner of the image.
const FOLD_STEPS: u32 = 32;
/// Tolerance of an image point, mm: far below a pixel.
const FOUND_MM: f64 = 1e-6;
/// Largest number of Newton steps. With a distortion small against its argument, each gains five digits.
const NEWTON_STEPS: usize = 4;
/// Miss before a Newton step, mm, below which the step is the last.
const NEAR_MM: f64 = 1e-7;

impl ThinMainLens {
    pub fn new(lens: &MainLens, pupil: Stop) -> Self {
        let distorts = lens.radial.iter().chain(&lens.tangential).any(|&c| c != 0.0);
        let moves = distorts || lens.field_curvature_per_mm != 0.0;
        Self { lens: *lens, distorts, moves, pupil, power: 1.0 / lens.focal_length_mm }
    }

    /// Returns the point where all rays of an object point meet behind the lens; `None` if the object point is not beyond F.
    pub fn image_of(&self, point: &Point3<f64>) -> Option<Point3<f64>> {
        if point.z <= self.lens.focal_length_mm {
            return None;
        }
        let magnification = -self.lens.focal_length_mm / (point.z - self.lens.focal_length_mm);
        let ideal = point.xy().coords * magnification;
        let z = point.z * magnification + self.nearer_mm(ideal);
        Some(Point3::from((ideal + self.distortion_mm(ideal)).push(z)))
    }

    /// Returns the distance κ|x|² by which the image of a point lies nearer to the lens than the image x of an ideal lens, both
    /// in mm.
    #[inline(always)]
    #[allow(clippy::inline_always)] // compiled for the registers of loops over rays
    fn nearer_mm(&self, x: Vector2<f64>) -> f64 {
        self.lens.field_curvature_per_mm * (x.x * x.x + x.y * x.y)
    }

    /// Returns the shift of an ideal image point due to distortion, both in mm in the camera frame
    /// (Brown-Conrady; paper, section 2.1). It is independent of the core's distortion, so that tests compare the two.
    #[inline(always)]
    #[allow(clippy::inline_always)] // compiled for the registers of loops over rays
    fn distortion_mm(&self, x: Vector2<f64>) -> Vector2<f64> {
        let [q1, q2, q3] = self.lens.radial;
        let [p1, p2] = self.lens.tangential;
        let r2 = x.x * x.x + x.y * x.y;
        let radial = ((q3 * r2 + q2) * r2 + q1) * r2;
        // P1 (r² + 2x²) + 2 P2 x y = P1 r² + 2x (P1 x + P2 y), and the same along y.
        let factor = radial + 2.0 * (p1 * x.x + p2 * x.y);
        Vector2::new(x.x * factor + p1 * r2, x.y * factor + p2 * r2)
    }

    fn distortion_jacobian(&self, x: Vector2<f64>) -> Matrix2<f64> {
        let [q1, q2, q3] = self.lens.radial;
        let p = Vector2::from(self.lens.tangential);
        let r2 = x.norm_squared();
        let radial = ((q3 * r2 + q2) * r2 + q1) * r2;
        let growth = 2.0 * ((3.0 * q3 * r2 + 2.0 * q2) * r2 + q1);
        Matrix2::identity() * (radial + 2.0 * p.dot(&x))
            + x * x.transpose() * growth
            + (x * p.transpose() + p * x.transpose()) * 2.0
    }

    /// Returns the fraction (0 to 1) of the way from the axis to an image point at which distortion folds the
    /// image; `None` if it does not.
    pub fn first_fold(&self, distorted: &Vector2<f64>) -> Option<f64> {
        (1..=FOLD_STEPS).map(|step| f64::from(step) / f64::from(FOLD_STEPS)).find(|&part| {
            let local = self.about(distorted * part, distorted * part);
            let ideal = local.undistorted;
            let miss = ideal + self.distortion_mm(ideal) - local.distorted;
            let jacobian = Matrix2::identity() + self.distortion_jacobian(ideal);
            // A fold reverses one direction; the negated test counts NaN as a fold too.
            !(miss.norm() < FOUND_MM && jacobian.determinant() > 0.0 && jacobian.trace() > 0.0)
        })
    }

    /// Linearises the distortion about a point of image space. The search starts from a guess.
    fn about(&self, distorted: Vector2<f64>, guess: Vector2<f64>) -> LocalDistortion {
        let mut undistorted = guess;
        let mut inverse = Matrix2::identity();
        if self.distorts {
            for _ in 0..NEWTON_STEPS {
                let miss = undistorted + self.distortion_mm(undistorted) - distorted;
                let jacobian = Matrix2::identity() + self.distortion_jacobian(undistorted);
                inverse = jacobian.try_inverse().unwrap_or_else(Matrix2::identity);
                undistorted -= inverse * miss;
                if miss.norm_squared() < NEAR_MM * NEAR_MM {
                    break;
                }
            }
        } else {
            undistorted = distorted;
        }
        let nearer = self.nearer_mm(undistorted);
        let gradient = undistorted * (2.0 * self.lens.field_curvature_per_mm);
        let shift = ImageShift {
            across: distorted - undistorted,
            along: nearer - gradient.dot(&undistorted),
            gradient,
            nearer,
        };
        LocalDistortion { distorted, undistorted, inverse, shift }
    }

    /// Returns the data that the rays about `ray` share; `None` if it leads away from the board. The search
    /// starts from the result of a nearby ray, if given.
    pub fn aim(&self, ray: &Ray, board: &PlacedTarget, nearby: Option<&Aim>) -> Option<Aim> {
        let aim = self.aim_at(ray, board.plane(), nearby)?;
        if !board.is_bent() {
            return Some(aim);
        }
        // The image of a bent board is a plane within the bundle.
        let (outer, meets) = self.object_ray(ray, &aim, self.moves);
        if !meets {
            return None;
        }
        match board.tangent(&outer) {
            Some(plane) => self.aim_at(ray, &plane, Some(&aim)),
            None => Some(aim),
        }
    }

    fn aim_at(&self, ray: &Ray, board: &BoardPlane, nearby: Option<&Aim>) -> Option<Aim> {
        let at = |shift: &ImageShift| {
            let (z, meets) = board.image_plane(shift).z(ray);
            meets.then(|| ray.at(z))
        };
        let without = || at(&ImageShift::none()).map(|at| self.about(at, at));
        // A search that did not converge gives no start.
        let nearby = nearby.filter(|nearby| nearby.local.undistorted.iter().all(|x| x.is_finite()));
        let start = nearby.map_or_else(without, |nearby| Some(nearby.local))?;
        let at = at(&start.shift)?;
        let local = self.about(at, start.undistorted + start.inverse * (at - start.distorted));
        Some(Aim { local, plane: board.image_plane(&local.shift) })
    }

    /// Returns the ray in front of the lens that continues `ray` behind it, for the board that it aims at, and true if it leads
    /// to the board. `moves` is [`ThinMainLens::moves`], as a constant for the compiler.
    #[inline(always)]
    #[allow(clippy::inline_always)] // compiled for the registers of loops over rays
    pub fn object_ray(&self, ray: &Ray, aim: &Aim, moves: bool) -> (Ray, bool) {
        let (z, meets) = aim.plane.z(ray);
        (self.refracted(ray, z, &aim.local, moves), meets)
    }

    /// Returns the ray in front of the lens that continues `ray` behind it, for an object whose image lies at
    /// `image_z`.
    ///
    /// A ray aims at an image point. With an ideal lens it would aim at the point that distortion and
    /// field curvature move to this image point. The thin lens refracts that ray: it subtracts x/F from the
    /// slope.
    #[inline(always)]
    #[allow(clippy::inline_always)] // compiled for the registers of loops over rays
    fn refracted(&self, ray: &Ray, image_z: f64, local: &LocalDistortion, moves: bool) -> Ray {
        let mut slope = ray.slope;
        if moves {
            let target = ray.at(image_z);
            let near = local.undistorted + times(&local.inverse, target - local.distorted);
            let miss = near + self.distortion_mm(near) - target;
            let ideal = near - times(&local.inverse, miss);
            slope = (ideal - ray.at_lens) * (image_z - self.nearer_mm(ideal)).recip();
        }
        Ray { at_lens: ray.at_lens, slope: slope - ray.at_lens * self.power }
    }

    /// Follows a ray to the board that it aims at.
    #[cfg(test)]
    pub fn follow(&self, ray: &Ray, aim: Option<&Aim>) -> Passage {
        if !self.pupil.passes(ray) {
            return Passage::Blocked;
        }
        match aim.map(|aim| self.object_ray(ray, aim, self.moves)) {
            Some((outer, true)) => Passage::Seen(outer),
            _ => Passage::Away,
        }
    }
}

/// Multiplies a matrix and a vector, in a form that the compiler evaluates for several rays at once.
#[inline(always)]
#[allow(clippy::inline_always)] // compiled for the registers of loops over rays
fn times(m: &Matrix2<f64>, v: Vector2<f64>) -> Vector2<f64> {
    Vector2::new(m[(0, 0)] * v.x + m[(0, 1)] * v.y, m[(1, 0)] * v.x + m[(1, 1)] * v.y)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn thin(lens: &MainLens) -> ThinMainLens {
        ThinMainLens::new(lens, Stop::new(Point3::origin(), 5.0))
    }

    fn lens() -> ThinMainLens {
        thin(&MainLens {
            radial: [-4e-5, 2e-7, 1e-10],
            tangential: [3e-5, -2e-5],
            field_curvature_per_mm: 6e-3,
            ..MainLens::thin(50.0)
        })
    }

    /// Rays from one object point through any point of the lens meet in its image, and they lead back to the object point.
    #[test]
    fn rays_lead_back_to_their_object_point() {
        let lens = lens();
        let point = Point3::new(40.0, -25.0, 300.0);
        let image = lens.image_of(&point).unwrap();
        for (x, y) in [(0.0, 0.0), (6.0, 0.0), (-3.0, 5.0), (0.5, -6.0)] {
            let at_lens = Vector2::new(x, y);
            let ray = Ray { at_lens, slope: (image.xy().coords - at_lens) / image.z };
            let local = lens.about(image.xy().coords, image.xy().coords);
            let hit = lens.refracted(&ray, image.z, &local, lens.moves).at(point.z);
            assert!((hit - point.xy().coords).norm() < 1e-9, "{hit} through {at_lens}");
        }
    }

    /// The paper's formula with numbers: r² = 5, x = 1, y = 2.
    #[test]
    fn distortion_is_that_of_the_paper() {
        let lens = thin(&MainLens {
            radial: [1e-3, 1e-4, 1e-5],
            tangential: [1e-2, 1e-3],
            ..MainLens::thin(50.0)
        });
        let shift = lens.distortion_mm(Vector2::new(1.0, 2.0));
        let radial = 5e-3 + 25e-4 + 125e-5;
        let expected = Vector2::new(
            radial + 1e-2 * (5.0 + 2.0) + 2.0 * 1e-3 * 2.0,
            2.0 * radial + 1e-3 * (5.0 + 8.0) + 2.0 * 1e-2 * 2.0,
        );
        assert!((shift - expected).norm() < 1e-15);
    }

    #[test]
    fn jacobian_is_the_derivative() {
        let (lens, x, step) = (lens(), Vector2::new(3.0, -7.0), 1e-6);
        for (axis, column) in
            [Vector2::x(), Vector2::y()].into_iter().zip(lens.distortion_jacobian(x).column_iter())
        {
            let difference =
                lens.distortion_mm(x + axis * step) - lens.distortion_mm(x - axis * step);
            assert!((difference / (2.0 * step) - column).norm() < 1e-9);
        }
    }
}
