//! The results of an ideal detector, by tracing rays forwards from points of the board.

use nalgebra::{Isometry3, Point2, Point3, Vector2};
use rayon::prelude::*;

use super::array::MicroLens;
use super::ray::Ray;
use super::target::Target;
use super::tracer::Tracer;
use crate::model::{BapFeature, MicroImageCenter};

/// The light of one point in space on the sensor behind one micro-lens.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Spot {
    /// Mean of the rays through the rim of the micro-lens, px.
    pub center_px: Point2<f64>,
    /// Mean distance of these rays from the mean, px, with the sign of ρ: positive if they cross in front of the sensor.
    pub radius_px: f64,
    /// Fraction of the light that passes the pupil and all stops.
    pub visible: f64,
}

/// Centre of a micro-image.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct TrueCenter {
    /// Indices and position.
    pub center: MicroImageCenter,
    /// Index of the lens type, from 0.
    pub lens_type: usize,
    /// False for a dead micro-lens, which has no micro-image.
    pub alive: bool,
}

/// A board corner in a micro-image.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct TrueFeature {
    /// Feature without noise. Its ρ holds for an opening as wide as the pitch.
    pub feature: BapFeature,
    /// Fraction of its light that passes the pupil and all stops, above 0.
    pub visible: f64,
}

/// Number of rays through the rim of a micro-lens. Their mean is exact for any even number.
const RIM_RAYS: u32 = 32;
/// Largest distance between a micro-image centre and the image of a corner about the middle of the pupil, in radii of the
/// micro-image, at which the micro-image may show the corner.
const NEAR: f64 = 1.5;
/// Number of rings of rays that measure the visible fraction, with equal areas and equal numbers of rays.
const RINGS: u32 = 8;

impl Tracer {
    /// Returns the spot that a point in the camera frame forms through micro-lens (k, l); `None` if the point is
    /// not beyond the focal length, or there is no such micro-lens.
    #[must_use]
    pub fn spot(&self, point: &Point3<f64>, k: i32, l: i32) -> Option<Spot> {
        let lens = self.micro_lens(k, l)?;
        let point = &(self.array.in_lens_frame(&Isometry3::identity()) * point);
        let image = self.lens.image_from(point, &self.lens.image_of(point)?, &lens.center)?;
        Some(self.spot_of_image(&image, lens))
    }

    fn spot_of_image(&self, image: &Point3<f64>, lens: &MicroLens) -> Spot {
        let rim = directions(RIM_RAYS);
        let hit = |direction: &Vector2<f64>| {
            self.array.to_sensor(lens, direction * self.array.opening_radius, image)
        };
        let hits: Vec<Point2<f64>> = rim.iter().map(hit).collect();
        let rays = f64::from(RIM_RAYS);
        let center = Point2::from(hits.iter().map(|p| p.coords).sum::<Vector2<f64>>() / rays);
        // The image is upright: a ray through the rim of the lens at +x arrives at u + ρ.
        let radius = rim.iter().zip(&hits).map(|(direction, hit)| {
            let outwards = self.array.of_lens(lens, *direction) - lens.center;
            self.array.in_camera_frame(&outwards).xy().dot(&(hit - center))
        });
        Spot {
            center_px: center,
            radius_px: radius.sum::<f64>() / rays,
            visible: self.visible(image, lens),
        }
    }

    fn visible(&self, image: &Point3<f64>, lens: &MicroLens) -> f64 {
        let ring = |ring: u32| {
            let radius = ((f64::from(ring) + 0.5) / f64::from(RINGS)).sqrt();
            directions(RIM_RAYS).into_iter().map(move |direction| direction * radius)
        };
        let passes = |on_lens: &Vector2<f64>| {
            let start = self.array.of_lens(lens, on_lens * self.array.opening_radius);
            let towards = image - start;
            let slope = towards.xy() / towards.z;
            self.passes(&Ray::from(&start, slope))
        };
        let all = (0..RINGS).flat_map(ring);
        all.filter(passes).count() as f64 / f64::from(RINGS * RIM_RAYS)
    }

    /// Returns the centre of a micro-image: the ray from the middle of the exit pupil, or of the stop of a real lens,
    /// through the middle of the micro-lens. `None` if no ray of the lens leads there.
    fn micro_image_center(&self, lens: &MicroLens) -> Option<Point2<f64>> {
        let direction = self.lens.chief_direction(&lens.center)?;
        Some(self.array.to_pixel(&lens.center, &direction))
    }

    /// Returns centre and type of every micro-image whose centre lies in the image, including dead micro-lenses.
    #[must_use]
    pub fn centers(&self) -> Vec<TrueCenter> {
        self.array
            .lenses
            .iter()
            .filter_map(|lens| Some((lens, self.micro_image_center(lens)?)))
            .filter(|&(_, p)| self.sensor().contains(p.x, p.y))
            .map(|(lens, p)| TrueCenter {
                center: MicroImageCenter {
                    k: lens.k,
                    l: lens.l,
                    u_px: p.x,
                    v_px: p.y,
                    std_dev_px: None,
                },
                lens_type: lens.lens_type,
                alive: lens.alive,
            })
            .collect()
    }

    /// Returns every corner of the board, at its true position, in every micro-image that some of its light reaches, if the
    /// position lies in the image and within the outer radius of the micro-image.
    #[must_use]
    pub fn features(
        &self,
        frame: u32,
        target: &Target,
        camera_from_board: &Isometry3<f64>,
    ) -> Vec<TrueFeature> {
        let lens_from_board = self.array.in_lens_frame(camera_from_board);
        let centers: Vec<_> = self
            .array
            .lenses
            .iter()
            .filter(|lens| lens.alive)
            .filter_map(|lens| {
                Some((lens, self.micro_image_center(lens)?, self.micro_image_radius_px(lens)))
            })
            .collect();
        (0..target.board().corners())
            .into_par_iter()
            .flat_map_iter(|corner| {
                let point = lens_from_board * target.corner_mm(corner);
                let near = self.lens.image_of(&point);
                let seen = |&(lens, center, radius): &(&MicroLens, Point2<f64>, f64)| {
                    let at = |image: Point3<f64>| {
                        self.array.to_pixel(&lens.center, &(image - lens.center))
                    };
                    if (at(near?) - center).norm() > radius * NEAR {
                        return None;
                    }
                    let image = self.lens.image_from(&point, &near?, &lens.center)?;
                    let p = at(image);
                    if (p - center).norm() > radius || !self.sensor().contains(p.x, p.y) {
                        return None;
                    }
                    let spot = self.spot_of_image(&image, lens);
                    let feature = BapFeature {
                        frame,
                        corner,
                        k: lens.k,
                        l: lens.l,
                        u_px: spot.center_px.x,
                        v_px: spot.center_px.y,
                        rho_px: Some(spot.radius_px / self.array.aperture_ratio),
                        std_dev_px: None,
                        rho_std_dev_px: None,
                        correlation: 0.0,
                        sensitivities_px: None,
                        blur: None,
                    };
                    Some(TrueFeature { feature, visible: spot.visible })
                };
                let features: Vec<_> = centers.iter().filter_map(seen).collect();
                features.into_iter().filter(|f| f.visible > 0.0)
            })
            .collect()
    }
}

/// Returns unit vectors, evenly spaced around the circle.
fn directions(count: u32) -> Vec<Vector2<f64>> {
    let turn = std::f64::consts::TAU / f64::from(count);
    (0..count).map(|i| (f64::from(i) * turn).sin_cos()).map(|(s, c)| Vector2::new(c, s)).collect()
}
