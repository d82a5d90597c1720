//! The micro-lens array as the tracer sees it: thin lenses in one tilted plane.
//!
//! The tracer works in the lens frame, with z along the optical axis. Array and sensor are turned in it together if the main
//! lens is tilted.

use nalgebra::{Isometry3, Matrix3, Point2, Point3, Rotation3, UnitQuaternion, Vector2, Vector3};

use crate::model::{Opening, PlenopticCamera};

/// One micro-lens.
#[derive(Debug, Clone)]
pub(super) struct MicroLens {
    pub k: i32,
    pub l: i32,
    pub lens_type: usize,
    /// Centre C of the micro-lens, lens frame.
    pub center: Point3<f64>,
    /// Refractive power 1/f.
    pub power: f64,
    /// False for a dead micro-lens, which blocks all light.
    pub alive: bool,
}

impl MicroLens {
    /// Returns the size of a pupil over its projection onto the plane of the micro-lens, seen from a point of the sensor;
    /// negative if the projection is inverted.
    #[inline]
    pub fn demagnification(&self, to_sensor: f64, to_pupil: f64) -> f64 {
        1.0 + to_pupil * (1.0 / to_sensor - self.power)
    }
}

/// The array in front of the sensor. "Local" coordinates of a micro-lens have their origin at its centre and the axes of
/// the array, with z towards the main lens.
#[derive(Debug, Clone)]
pub(super) struct MicroLenses {
    pub lenses: Vec<MicroLens>,
    /// Axes of the array as columns, in the lens frame.
    pub axes: Matrix3<f64>,
    /// Pitch ΔC along x.
    pub pitch: f64,
    /// Half the width of the openings.
    pub opening_radius: f64,
    pub opening: Opening,
    /// Radius of the circle about an opening.
    pub opening_reach: f64,
    /// Direction of the normal of one of its sides, local, and the normals of its pairs of parallel sides; 0 for a disc.
    pub normal_rad: f64,
    normals: [Vector2<f64>; 3],
    /// Diameter of the openings over the pitch.
    pub aperture_ratio: f64,
    /// Distance of the sensor from the main lens along the normal of the sensor.
    lens_to_sensor: f64,
    pub pixel_size: f64,
    principal_point: Vector2<f64>,
    lens_from_camera: Rotation3<f64>,
}

impl MicroLenses {
    /// Creates the array with openings whose width is `aperture_ratio` times the pitch.
    pub fn new(camera: &PlenopticCamera, opening: Opening, aperture_ratio: f64) -> Self {
        let mla = &camera.mla;
        let normal_rad = Opening::normal_rad(camera.lattice.kind(), 0.0);
        let opening_radius = aperture_ratio * mla.pitch_mm * mla.pitch_ratio.sqrt() / 2.0;
        let [x, y, z] = mla.rotation_rad.into();
        let lens_from_camera = camera.main_lens.camera_from_lens().inverse();
        let axes = lens_from_camera * Rotation3::from_euler_angles(x, y, z);
        let origin =
            lens_from_camera * Point3::new(mla.offset_mm.x, mla.offset_mm.y, -mla.lens_to_mla_mm);
        let lattice = &camera.lattice;
        let lens = |k, l| {
            let node = lattice.node(k, l);
            // The image is stored upright, so it runs against x and y of the camera.
            let place = -mla.pitch_mm * Vector3::new(node.x, mla.pitch_ratio * node.y, 0.0);
            let lens_type = camera.lens_type(k, l);
            MicroLens {
                k,
                l,
                lens_type,
                center: origin + axes * place,
                power: 1.0 / mla.focal_lengths_mm[lens_type],
                alive: true,
            }
        };
        let lenses = (0..lattice.rows)
            .flat_map(|l| (0..lattice.columns).map(move |k| (k, l)))
            .map(|(k, l)| lens(k, l))
            .collect();
        Self {
            lenses,
            axes: axes.into_inner(),
            pitch: mla.pitch_mm,
            aperture_ratio,
            opening_radius,
            opening,
            opening_reach: opening_radius * opening.reach(),
            normal_rad,
            normals: opening.normals(normal_rad),
            lens_to_sensor: mla.lens_to_mla_mm + mla.mla_to_sensor_mm,
            pixel_size: camera.sensor.pixel_size_mm,
            principal_point: mla.principal_point_px,
            lens_from_camera,
        }
    }

    /// Returns true if a ray through a point of the circle about the opening (local) passes the opening.
    #[inline(always)]
    #[allow(clippy::inline_always)] // compiled for the registers of loops over rays
    pub fn is_open(&self, on_lens: Vector2<f64>) -> bool {
        let [a, b, c] = self.normals.map(|normal| normal.dot(&on_lens).abs());
        a.max(b).max(c) <= self.opening_radius
    }

    /// Converts a pose from the camera frame to the lens frame.
    pub fn in_lens_frame(&self, camera_from_board: &Isometry3<f64>) -> Isometry3<f64> {
        UnitQuaternion::from_rotation_matrix(&self.lens_from_camera) * camera_from_board
    }

    /// Converts a vector from the lens frame to the camera frame.
    pub fn in_camera_frame(&self, vector: &Vector3<f64>) -> Vector3<f64> {
        self.lens_from_camera.inverse_transform_vector(vector)
    }

    /// Returns the distance of a point from the sensor, along its normal.
    #[inline]
    pub fn to_sensor_mm(&self, point: &Point3<f64>) -> f64 {
        self.lens_from_camera.inverse_transform_point(point).z + self.lens_to_sensor
    }

    /// Converts a point of the lens frame to local coordinates of a micro-lens.
    #[inline]
    pub fn local(&self, lens: &MicroLens, point: &Point3<f64>) -> Vector3<f64> {
        self.axes.tr_mul(&(point - lens.center))
    }

    /// Converts a point in the plane of the micro-lenses from local coordinates to the lens frame.
    #[inline]
    pub fn of_lens(&self, lens: &MicroLens, on_lens: Vector2<f64>) -> Point3<f64> {
        lens.center + self.axes.column(0) * on_lens.x + self.axes.column(1) * on_lens.y
    }

    /// Returns the point of the sensor at a pixel position.
    #[inline]
    pub fn on_sensor(&self, u: f64, v: f64) -> Point3<f64> {
        let place = (self.principal_point - Vector2::new(u, v)) * self.pixel_size;
        self.lens_from_camera * Point3::new(place.x, place.y, -self.lens_to_sensor)
    }

    /// Returns the steps from a pixel to its neighbours on the right and below, local.
    #[inline]
    pub fn pixel_steps(&self) -> [Vector3<f64>; 2] {
        [Vector3::x(), Vector3::y()]
            .map(|axis| self.axes.tr_mul(&(self.lens_from_camera * -axis)) * self.pixel_size)
    }

    /// Returns the pixel position where the line through `point` along `direction` meets the sensor.
    pub fn to_pixel(&self, point: &Point3<f64>, direction: &Vector3<f64>) -> Point2<f64> {
        let (point, direction) =
            (self.lens_from_camera.inverse_transform_point(point), self.in_camera_frame(direction));
        let hit = point + direction * ((-self.lens_to_sensor - point.z) / direction.z);
        Point2::from(self.principal_point - hit.xy().coords / self.pixel_size)
    }

    /// Returns the pixel position where the ray through `on_lens` (local) and `point` (lens frame, on the scene side of the
    /// array) meets the sensor.
    pub fn to_sensor(
        &self,
        lens: &MicroLens,
        on_lens: Vector2<f64>,
        point: &Point3<f64>,
    ) -> Point2<f64> {
        let target = self.local(lens, point);
        // On the sensor side, the slope is larger by x/f.
        let outer = (target.xy() - on_lens) / target.z;
        let inner = outer + on_lens * lens.power;
        let direction = self.axes * Vector3::new(inner.x, inner.y, 1.0);
        self.to_pixel(&self.of_lens(lens, on_lens), &direction)
    }
}
