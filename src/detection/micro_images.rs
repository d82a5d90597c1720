//! Micro-images, described by the pre-calibration.

use nalgebra::Vector2;

use super::MicroOptics;
use crate::checks::whites::TOUCHING;
use crate::error::{Error, Result};
use crate::model::{
    Configuration, Datasheet, FallOff, InternalParameters, LatticeKind, MicroImageCenter, Opening,
    ROW_DISTANCE, SampleLevels, Sensor, TiltGradient, check_array_size, check_centers,
    growth_per_px, optics,
};
use crate::optics::Obliquity;
use crate::optics::aberration::AberrationEstimate;
use crate::precalibration::{MicroImageArray, Precalibration, check_stated_pitch, fit_grid};
use crate::quantity::Estimate;

/// Positions of micro-images, and the blur of points in them.
#[derive(Debug, Clone, PartialEq)]
pub struct MicroImages {
    /// The grid.
    pub grid: MicroImageArray,
    /// Configuration of the camera.
    pub configuration: Configuration,
    /// Centres of all nodes of the lattice, row by row, px.
    centers: Vec<Vector2<f64>>,
    /// Radius a of the pupil in the middle of the image, where m and q'ᵢ are measured, px.
    pupil_px: f64,
    /// q'ᵢ in the middle of the image, px.
    q_prime_px: Vec<f64>,
    /// Aperture ratio φ.
    aperture_ratio: f64,
    opening: Opening,
    /// Standard deviation of φ, if other boards have determined it.
    settled: Option<f64>,
    /// Aberrations of the main lens, if other boards have determined them.
    aberration: Option<AberrationEstimate>,
    /// Variance of the point spread along an axis, px².
    point_spread_px2: f64,
    /// Black and saturation level of the images, if they are known.
    pub levels: Option<SampleLevels>,
    /// Middle of the image, px.
    middle: Vector2<f64>,
    /// Angular response over the image.
    fall_off: FallOff,
    /// Angular response in the middle of the image.
    in_the_middle: Obliquity,
    /// Tilt gradient of the array, if it was measured.
    tilt_gradient: Option<TiltGradient>,
    /// Ratio (D + d)/d.
    lens_to_sensor: f64,
    /// Gradient of ln d, 1/px.
    growth_per_px: Vector2<f64>,
}

/// Largest radius of discs of light and blur, in pitches.
const MOST_PITCHES: f64 = 10.0;
/// Difference of d/f from 1 below which a camera is unfocused; focused ones differ by a tenth and more.
const UNFOCUSED: f64 = 0.03;
/// Largest relative change of d from the middle of the image to a corner, if the array was meant to be parallel to the sensor.
const MOST_GROWTH: f64 = 0.3;

/// Returns an error for a camera whose micro-lenses focus at infinity.
pub fn check_configuration(sheet: &Datasheet) -> Result<()> {
    if sheet.configuration == Configuration::Unfocused { Err(unfocused("stated")) } else { Ok(()) }
}

/// Returns an error if the discs of the white images belong to an unfocused camera: d/fᵢ = 2q'ᵢ/ΔC.
fn check_in_focus(internal: &InternalParameters, pitch_mm: f64) -> Result<()> {
    let in_focus = |q: &f64| (2.0 * q / pitch_mm - 1.0).abs() < UNFOCUSED;
    if internal.q_prime_mm.iter().all(in_focus) { Err(unfocused("measured")) } else { Ok(()) }
}

fn unfocused(how: &str) -> Error {
    Error::invalid(format!(
        "the camera is {how} to be unfocused (f = d): its micro-images show no corners of a board, \
         so only its white images can be measured. Calibrate it with software that detects corners \
         in sub-aperture images"
    ))
}

impl MicroImages {
    /// Creates the micro-images from a pre-calibration, at the f-number N of the boards. Micro-images without a measured centre
    /// are where the grid predicts them.
    ///
    /// If the array is tilted against the sensor, d changes across it, and a and q'ᵢ in proportion: both are d times an angle
    /// that stays the same. The change follows from the measured tilt gradient and from the perspective of the grid,
    /// t = ∇d/(D + d), with the D and d that the refinement starts with.
    pub fn new(
        grid: &MicroImageArray,
        centers: &[MicroImageCenter],
        internal: &InternalParameters,
        sheet: &Datasheet,
    ) -> Result<Self> {
        let pixel_size_mm = sheet.sensor.pixel_size_mm;
        if internal.q_prime_mm.is_empty() {
            return Err(Error::invalid(
                "the pre-calibration has no lens types: repeat it with white images at several \
                 f-numbers",
            ));
        }
        let pupil_px = internal.pupil_radius_mm(sheet.f_number) / pixel_size_mm;
        let sizes = internal.q_prime_mm.iter().map(|q| q / pixel_size_mm);
        for size in sizes.chain(std::iter::once(pupil_px)) {
            if size.is_nan() || size.abs() > MOST_PITCHES * grid.pitch_px {
                return Err(Error::invalid(format!(
                    "the internal parameters predict discs of {size:.1} px in micro-images with a \
                     pitch of {:.1} px: they are of another camera, or not in mm",
                    grid.pitch_px
                )));
            }
        }
        check_configuration(sheet)?;
        let (lens_to_mla, mla_to_sensor) = optics::initial_distances(
            sheet.focal_length_mm,
            sheet.focus_distance_mm,
            internal.m_mm.abs(),
            sheet.configuration,
            0.0,
        );
        check_in_focus(
            internal,
            grid.pitch_px * pixel_size_mm * lens_to_mla / (lens_to_mla + mla_to_sensor),
        )?;
        let lens_to_sensor_px = (lens_to_mla + mla_to_sensor) / pixel_size_mm;
        let (mla_to_sensor_px, middle) = (mla_to_sensor / pixel_size_mm, sheet.sensor.center_px());
        let cos4 = || FallOff::cos4(mla_to_sensor_px, lens_to_sensor_px, middle);
        let (fall_off, aperture_ratio) =
            (internal.fall_off.unwrap_or_else(cos4), internal.aperture_ratio());
        let (within, half_pitch_px) =
            (fall_off.within_per_px2, grid.pitch_px / 2.0 * aperture_ratio);
        let mut micro_images = Self {
            grid: *grid,
            configuration: sheet.configuration,
            centers: grid.all_centers(centers),
            pupil_px,
            q_prime_px: internal.q_prime_mm.iter().map(|q| q / pixel_size_mm).collect(),
            aperture_ratio,
            opening: internal.opening,
            settled: None,
            aberration: None,
            point_spread_px2: internal.point_spread_px2(),
            levels: internal.levels,
            middle,
            in_the_middle: Obliquity::in_the_middle(within, mla_to_sensor_px, half_pitch_px),
            fall_off,
            tilt_gradient: internal.tilt_gradient,
            lens_to_sensor: lens_to_sensor_px / mla_to_sensor_px,
            growth_per_px: Vector2::zeros(),
        };
        let most = micro_images.find_growth();
        if most.is_nan() || most > MOST_GROWTH {
            return Err(Error::invalid(format!(
                "the perspective of the micro-image centres implies an array that is {:.0} % \
                 further from the sensor at a corner of the image than in the middle: the centres \
                 are not of one flat array, or the focal length is wrong",
                100.0 * most
            )));
        }
        Ok(micro_images)
    }

    /// Computes the gradient of ln d over the image, and returns the largest relative change of d.
    fn find_growth(&mut self) -> f64 {
        let perspective_per_px = &self.grid.perspective_per_px;
        self.growth_per_px =
            growth_per_px(self.tilt_gradient.as_ref(), perspective_per_px, self.lens_to_sensor);
        self.growth_per_px.abs().dot(&self.middle)
    }

    /// Returns the centre of a micro-image, px.
    #[must_use]
    pub fn center(&self, k: i32, l: i32) -> Vector2<f64> {
        match self.grid.lattice.index(k, l) {
            Some(index) => self.centers[index],
            None => self.grid.center_of(k, l),
        }
    }

    /// Creates the micro-images of a camera from its white images.
    pub fn of_precalibration(measured: &Precalibration, sheet: &Datasheet) -> Result<Self> {
        let Precalibration { array, internal, .. } = measured;
        Self::new(&array.grid, &array.centers, &internal.parameters, sheet)
    }

    /// Creates the micro-images from earlier measurements; an error if they are not of this camera.
    pub fn of_measurements(
        centers: &[MicroImageCenter],
        internal: &InternalParameters,
        sheet: &Datasheet,
    ) -> Result<Self> {
        let (columns, rows) = sheet.array_size_by(centers);
        check_array_size(columns, rows)?;
        check_centers(centers, &sheet.sensor, (columns, rows))?;
        let grid = fit_grid(centers, sheet.lattice_kind, columns, rows)?;
        internal.validate(sheet.lens_types)?;
        check_stated_pitch(sheet, internal, &grid)?;
        Self::new(&grid, centers, internal, sheet)
    }

    /// Returns the micro-images with another aperture ratio φ. The discs of white images, and with them φqᵢ, stay the same all
    /// over the image.
    #[must_use]
    pub fn with_aperture_ratio(&self, aperture_ratio: f64) -> Self {
        let (half_pitch, change) = (self.grid.pitch_px / 2.0, self.aperture_ratio / aperture_ratio);
        let of_type = |q_prime: &f64| half_pitch + (q_prime - half_pitch) * change;
        let q_prime_px = self.q_prime_px.iter().map(of_type).collect();
        let in_the_middle =
            Obliquity { half_pitch_px: half_pitch * aperture_ratio, ..self.in_the_middle };
        let tilt_gradient =
            self.tilt_gradient.map(|tilt_gradient| tilt_gradient.with_aperture_ratio(-change.ln()));
        let mut other =
            Self { q_prime_px, aperture_ratio, in_the_middle, tilt_gradient, ..self.clone() };
        other.find_growth();
        other
    }

    /// Returns the micro-images with the aperture ratio that other boards of this camera have shown. It is not estimated again
    /// from the boards in its images.
    #[must_use]
    pub fn settled_at(&self, ratio: &Estimate) -> Self {
        Self { settled: Some(ratio.std_dev), ..self.with_aperture_ratio(ratio.value) }
    }

    /// Returns the micro-images with the aberrations of the main lens that other boards of this camera have shown. They are not
    /// estimated again from the boards in its images.
    pub(super) fn with_aberration(self, aberration: &AberrationEstimate) -> Self {
        Self { aberration: Some(*aberration), ..self }
    }

    /// Returns the aberrations of the main lens, if other boards have shown them.
    pub(super) fn aberration(&self) -> Option<AberrationEstimate> {
        self.aberration
    }

    /// Returns σ of the aperture ratio, if other boards have shown it.
    pub(super) fn settled(&self) -> Option<f64> {
        self.settled
    }

    /// Returns the aperture ratio φ.
    #[must_use]
    pub fn aperture_ratio(&self) -> f64 {
        self.aperture_ratio
    }

    /// Returns the variance of the point spread along an axis, px².
    #[must_use]
    pub fn point_spread_px2(&self) -> f64 {
        self.point_spread_px2
    }

    /// Returns the middle of the image, px.
    pub(super) fn middle(&self) -> Vector2<f64> {
        self.middle
    }

    /// Returns the radius a of the pupil in the middle of the image, px.
    pub(super) fn pupil_px(&self) -> f64 {
        self.pupil_px
    }

    /// Returns the optics of a micro-image.
    #[must_use]
    pub fn optics(&self, k: i32, l: i32) -> MicroOptics {
        let lens_type = self.grid.lattice.lens_type(k, l, self.q_prime_px.len());
        self.optics_at(&self.center(k, l), lens_type)
    }

    /// Returns the outer radius of the largest white micro-images in the middle of the image, px, at most half the pitch.
    pub(super) fn largest_outer_radius_px(&self) -> f64 {
        let radii = self.all_optics_at(&self.middle).map(|optics| optics.outer_radius_px());
        radii.fold(0.0, f64::max).min(self.grid.pitch_px / 2.0)
    }

    /// Returns the optics of micro-lenses at a position in the image, by type.
    pub(super) fn all_optics_at(&self, place: &Vector2<f64>) -> impl Iterator<Item = MicroOptics> {
        (0..self.q_prime_px.len()).map(|lens_type| self.optics_at(place, lens_type))
    }

    fn optics_at(&self, place: &Vector2<f64>, lens_type: usize) -> MicroOptics {
        let from_middle = place - self.middle;
        let growth = self.growth_per_px.dot(&from_middle);
        let half_pitch_px = self.grid.pitch_px / 2.0;
        // Neighbours may be of any type.
        let blur_px = |q_prime: &f64| {
            (self.aperture_ratio * (q_prime * (1.0 + growth) - half_pitch_px)).abs()
        };
        let widest_px = self.q_prime_px.iter().map(blur_px).fold(0.0, f64::max);
        let outer_px = self.pupil_px * (1.0 + growth) + widest_px;
        let overlap_px = (outer_px - (1.0 + TOUCHING) * half_pitch_px).max(0.0);
        MicroOptics {
            lens_type,
            pupil_px: self.pupil_px * (1.0 + growth),
            q_prime_px: self.q_prime_px[lens_type] * (1.0 + growth),
            half_pitch_px,
            alone_px: (half_pitch_px - overlap_px).max(0.0),
            aperture_ratio: self.aperture_ratio,
            opening: self.opening,
            normal_rad: Opening::normal_rad(
                self.grid.lattice.packing.kind(),
                self.grid.rotation_rad,
            ),
            obliquity: Obliquity {
                gradient_per_px: self.fall_off.gradient(place),
                ..self.in_the_middle
            },
            growth,
        }
    }

    /// Returns true if a position is in micro-images on the sensor, at least `margin_px` within the border of both: the array
    /// may be smaller than the sensor.
    #[must_use]
    pub fn show(&self, place: &Vector2<f64>, sensor: &Sensor, margin_px: f64) -> bool {
        let grid = &self.grid;
        let turn = nalgebra::Rotation2::new(-grid.rotation_rad);
        let at = turn * (place - grid.center_px);
        // Nodes lie about the middle of their bounding box. The first one reaches its border, or the first two if every second
        // one is shifted.
        let (right, below) = (1.min(grid.lattice.columns - 1), 1.min(grid.lattice.rows - 1));
        let outermost =
            [(0, 0), (right, 0), (0, below)].map(|(k, l)| grid.lattice.node(k, l).abs());
        let reach = outermost.iter().fold(Vector2::zeros(), |a: Vector2<f64>, b| a.sup(b));
        let inside = (reach + Vector2::repeat(0.5)) * grid.pitch_px - at.abs();
        let margin = Vector2::repeat(margin_px);
        let (low, high) = (place - margin, place + margin);
        inside.min() >= margin_px
            && sensor.contains(low.x, low.y)
            && sensor.contains(high.x, high.y)
    }

    /// Returns the micro-images whose centre is up to `reach` from a position, px.
    #[must_use]
    pub fn about(&self, place: &Vector2<f64>, reach: f64) -> Vec<(i32, i32)> {
        let lattice = &self.grid.lattice;
        let from_middle = (place - self.grid.center_px) / self.grid.pitch_px;
        let turn = nalgebra::Rotation2::new(-self.grid.rotation_rad);
        let at = turn * from_middle;
        let middle = lattice.node(0, 0);
        // Rows of a hexagonal lattice are closer than a pitch, and shifted by up to half of it.
        let wide = reach / self.grid.pitch_px / ROW_DISTANCE + 1.5;
        #[allow(clippy::cast_possible_truncation)] // indices of a lattice
        let range = |at: f64, first: f64, spacing: f64, count: i32| {
            let index = (at - first) / spacing;
            ((index - wide).floor() as i32).max(0)..=((index + wide).ceil() as i32).min(count - 1)
        };
        let (along_u, along_v) = match lattice.kind() {
            LatticeKind::Orthogonal => (1.0, 1.0),
            LatticeKind::HexagonalRows => (1.0, ROW_DISTANCE),
            LatticeKind::HexagonalColumns => (ROW_DISTANCE, 1.0),
        };
        let columns = range(at.x, middle.x, along_u, lattice.columns);
        range(at.y, middle.y, along_v, lattice.rows)
            .flat_map(|l| columns.clone().map(move |k| (k, l)))
            .filter(|&(k, l)| (self.center(k, l) - place).norm() <= reach)
            .collect()
    }
}

#[cfg(test)]
pub(super) mod tests {
    use super::*;
    use crate::model::{Lattice, Packing};

    /// Returns three by three micro-images about the middle of an image of 61 x 61 px.
    pub fn micro_images(pitch_px: f64) -> MicroImages {
        let sheet = Datasheet {
            sensor: Sensor { width_px: 61, height_px: 61, pixel_size_mm: 0.0055 },
            focal_length_mm: 16.0,
            focus_distance_mm: 120.0,
            f_number: 4.0,
            configuration: Configuration::Galilean,
            lattice_kind: LatticeKind::Orthogonal,
            array_size: Some((3, 3)),
            lens_types: 1,
            micro_image_pitch_px: None,
            opening: None,
        };
        let internal = InternalParameters {
            m_mm: 0.5 * pitch_px * 0.0055,
            q_prime_mm: vec![0.875 * pitch_px * 0.0055],
            micro_image_pitch_mm: None,
            m_std_dev_mm: None,
            q_prime_std_dev_mm: Vec::new(),
            pupil_growth: 0.0,
            fall_off: None,
            tilt_gradient: None,
            vignetting: None,
            point_spread_px2: None,
            aperture_ratio: None,
            opening: Opening::Disc,
            levels: None,
        };
        let grid = MicroImageArray {
            lattice: Lattice { packing: Packing::Orthogonal, columns: 3, rows: 3 },
            pitch_px,
            rotation_rad: 0.0,
            center_px: Vector2::new(30.0, 30.0),
            perspective_per_px: Vector2::zeros(),
            rms_px: 0.0,
            outliers: 0,
        };
        MicroImages::new(&grid, &[], &internal, &sheet).unwrap()
    }

    #[test]
    fn light_of_neighbours_is_left_out_where_micro_images_overlap() {
        let touching = micro_images(16.0);
        // Outer radii are 8 px, half the pitch.
        assert!((touching.optics(1, 1).reach_px() - 8.0).abs() < 1e-9);
        let wider = |pupil_px: f64| MicroImages { pupil_px, ..touching.clone() };
        // An excess of 2 % of half the pitch, 9.2 px, counts as touching.
        let overlapping = wider(3.2).optics(1, 1);
        assert!((overlapping.outer_radius_px() - 9.2).abs() < 1e-9, "{overlapping:?}");
        assert!((overlapping.reach_px() - (8.0 - (9.2 - 8.16))).abs() < 1e-9, "{overlapping:?}");
        assert!((overlapping.lit_px(0.0) - overlapping.reach_px()).abs() < 1e-9);
        assert!(wider(20.0).optics(1, 1).reach_px() <= 0.0);
    }

    /// The array may be smaller than the sensor.
    #[test]
    fn in_view_is_what_the_micro_images_show() {
        let micro_images = micro_images(16.0);
        let large = Sensor { width_px: 61, height_px: 61, pixel_size_mm: 0.0055 };
        let small = Sensor { height_px: 41, ..large };
        let shows = |u: f64, v: f64, sensor: &Sensor, margin_px: f64| {
            micro_images.show(&Vector2::new(u, v), sensor, margin_px)
        };
        // Micro-images extend 24 px to every side of (30, 30).
        assert!(shows(53.0, 30.0, &large, 0.0) && !shows(55.0, 30.0, &large, 0.0));
        assert!(shows(7.0, 7.0, &large, 0.5) && !shows(7.0, 7.0, &large, 2.0));
        assert!(shows(30.0, 53.0, &large, 0.0) && !shows(30.0, 53.0, &small, 0.0));
        assert!(!shows(f64::NAN, 30.0, &large, 0.0));
    }
}
