//! Every micro-image as the pre-calibration describes it.

use nalgebra::Vector2;

use super::MicroOptics;
use crate::error::{Error, Result};
use crate::model::{
    Configuration, Datasheet, FallOff, InternalParameters, LatticeKind, MicroImageCenter,
    ROW_DISTANCE, SampleLevels, Sensor, TiltGradient, check_array_size, check_centers,
    growth_per_px, optics,
};
use crate::optics::Obliquity;
use crate::precalibration::{MicroImageArray, Precalibration, check_stated_pitch, fit_grid};
use crate::quantity::Estimate;

/// Where micro-images are, and how points are blurred in them.
#[derive(Debug, Clone, PartialEq)]
pub struct MicroImages {
    /// The grid.
    pub grid: MicroImageArray,
    /// Behind or before the array.
    pub configuration: Configuration,
    /// Of all nodes of the lattice, row by row, px.
    centers: Vec<Vector2<f64>>,
    /// a in the middle of the image, where m and q'ᵢ are measured, px.
    pupil_px: f64,
    /// q'ᵢ there, px.
    q_prime_px: Vec<f64>,
    /// φ, the aperture ratio.
    aperture_ratio: f64,
    /// σ of φ, if other boards have shown it.
    settled: Option<f64>,
    /// Variance of the point spread along an axis, px².
    point_spread_px2: f64,
    /// Black and saturation level of the images, where they are known.
    pub levels: Option<SampleLevels>,
    /// The middle of the image, px.
    middle: Vector2<f64>,
    /// The fall-off of light.
    fall_off: FallOff,
    /// The angles at which light arrives in the middle of the image.
    in_the_middle: Obliquity,
    /// The tilt gradient of the array, where it was measured.
    tilt_gradient: Option<TiltGradient>,
    /// (D + d)/d.
    lens_to_sensor: f64,
    /// Gradient of ln d, 1/px.
    growth_per_px: Vector2<f64>,
}

/// Discs of light and blur are smaller than this many pitches.
const MOST_PITCHES: f64 = 10.0;
/// d/f of an unfocused camera is within this of 1; that of focused ones differs by a tenth and more.
const UNFOCUSED: f64 = 0.03;
/// d changes less than this across an array that was meant to be parallel to the sensor.
const MOST_GROWTH: f64 = 0.3;

/// An error for a camera whose micro-lenses focus at infinity.
pub fn check_configuration(sheet: &Datasheet) -> Result<()> {
    if sheet.configuration == Configuration::Unfocused { Err(unfocused("stated")) } else { Ok(()) }
}

/// An error if the discs of the white images are those of an unfocused camera: d/fᵢ = 2q'ᵢ/ΔC.
fn check_in_focus(internal: &InternalParameters, pitch_mm: f64) -> Result<()> {
    let in_focus = |q: &f64| (2.0 * q / pitch_mm - 1.0).abs() < UNFOCUSED;
    if internal.q_prime_mm.iter().all(in_focus) { Err(unfocused("measured")) } else { Ok(()) }
}

fn unfocused(how: &str) -> Error {
    Error::invalid(format!(
        "the camera is {how} to be unfocused (f = d): each of its micro-images shows one place of the scene, seen \
         through all of the pupil, and no corner of a board. Corners are found in micro-images, so only focused \
         cameras can be calibrated; white images of this one can be measured all the same. Calibrate it with \
         software that finds corners in sub-aperture images"
    ))
}

impl MicroImages {
    /// From a pre-calibration, at the f-number N of the boards. Micro-images without a measured centre
    /// are where the grid puts them.
    ///
    /// Where the array is tilted against the sensor, d changes across it, and a and q'ᵢ in proportion: both
    /// are d times an angle that stays the same. How much follows from the perspective of the grid,
    /// t = ∇d/(D + d), with D and d as the refinement starts with them.
    pub fn new(
        grid: &MicroImageArray,
        centers: &[MicroImageCenter],
        internal: &InternalParameters,
        sheet: &Datasheet,
    ) -> Result<Self> {
        let pixel_size_mm = sheet.sensor.pixel_size_mm;
        if internal.q_prime_mm.is_empty() {
            return Err(Error::invalid(
                "the pre-calibration has no lens types: it takes white images at several f-numbers",
            ));
        }
        let pupil_px = internal.pupil_radius_mm(sheet.f_number) / pixel_size_mm;
        let sizes = internal.q_prime_mm.iter().map(|q| q / pixel_size_mm);
        for size in sizes.chain(std::iter::once(pupil_px)) {
            if size.is_nan() || size.abs() > MOST_PITCHES * grid.pitch_px {
                return Err(Error::invalid(format!(
                    "the internal parameters make discs of {size:.1} px in micro-images with a pitch of \
                     {:.1} px: they are of another camera, or not in mm",
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
            settled: None,
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
                "the micro-images lie in such a perspective that the array would be {:.0} % further from the sensor \
                 at a corner of the image than in the middle: the centres are not of one flat array, or the focal \
                 length is wrong",
                100.0 * most
            )));
        }
        Ok(micro_images)
    }

    /// Finds how d grows over the image; how much it grows at most.
    fn find_growth(&mut self) -> f64 {
        let perspective_per_px = &self.grid.perspective_per_px;
        self.growth_per_px =
            growth_per_px(self.tilt_gradient.as_ref(), perspective_per_px, self.lens_to_sensor);
        self.growth_per_px.abs().dot(&self.middle)
    }

    /// Centre of a micro-image, px.
    #[must_use]
    pub fn center(&self, k: i32, l: i32) -> Vector2<f64> {
        match self.grid.lattice.index(k, l) {
            Some(index) => self.centers[index],
            None => self.grid.center_of(k, l),
        }
    }

    /// The micro-images of a camera as its white images show them.
    pub fn of_precalibration(measured: &Precalibration, sheet: &Datasheet) -> Result<Self> {
        let Precalibration { array, internal, .. } = measured;
        Self::new(&array.grid, &array.centers, &internal.parameters, sheet)
    }

    /// From what was measured before; an error if it is not of this camera.
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

    /// The same with another aperture ratio φ; the discs of white images, and with them φqᵢ, stay as they are all over the
    /// image.
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

    /// The same with the aperture ratio that other boards of this camera have shown: those in its images are not asked for it.
    #[must_use]
    pub fn settled_at(&self, ratio: &Estimate) -> Self {
        Self { settled: Some(ratio.std_dev), ..self.with_aperture_ratio(ratio.value) }
    }

    /// σ of the aperture ratio, if it is that which other boards have shown.
    pub(super) fn settled(&self) -> Option<f64> {
        self.settled
    }

    /// φ, the aperture ratio.
    #[must_use]
    pub fn aperture_ratio(&self) -> f64 {
        self.aperture_ratio
    }

    /// Variance of the point spread along an axis, px².
    #[must_use]
    pub fn point_spread_px2(&self) -> f64 {
        self.point_spread_px2
    }

    /// The middle of the image, px.
    pub(super) fn middle(&self) -> Vector2<f64> {
        self.middle
    }

    /// a in the middle of the image, px.
    pub(super) fn pupil_px(&self) -> f64 {
        self.pupil_px
    }

    /// How the micro-lens of a micro-image blurs.
    #[must_use]
    pub fn optics(&self, k: i32, l: i32) -> MicroOptics {
        let lens_type = self.grid.lattice.lens_type(k, l, self.q_prime_px.len());
        self.optics_at(&self.center(k, l), lens_type)
    }

    /// Outer radius of the largest white micro-images in the middle of the image, but not beyond their
    /// neighbours, px.
    pub(super) fn largest_outer_radius_px(&self) -> f64 {
        let radii = self.all_optics_at(&self.middle).map(|optics| optics.outer_radius_px());
        radii.fold(0.0, f64::max).min(self.grid.pitch_px / 2.0)
    }

    /// How micro-lenses blur at a place in the image, by type.
    pub(super) fn all_optics_at(&self, place: &Vector2<f64>) -> impl Iterator<Item = MicroOptics> {
        (0..self.q_prime_px.len()).map(|lens_type| self.optics_at(place, lens_type))
    }

    fn optics_at(&self, place: &Vector2<f64>, lens_type: usize) -> MicroOptics {
        let from_middle = place - self.middle;
        let growth = self.growth_per_px.dot(&from_middle);
        MicroOptics {
            lens_type,
            pupil_px: self.pupil_px * (1.0 + growth),
            q_prime_px: self.q_prime_px[lens_type] * (1.0 + growth),
            half_pitch_px: self.grid.pitch_px / 2.0,
            aperture_ratio: self.aperture_ratio,
            obliquity: Obliquity {
                gradient_per_px: self.fall_off.gradient(place),
                ..self.in_the_middle
            },
            growth,
        }
    }

    /// Whether a place is in micro-images on the sensor, at least `margin_px` within the border of both: the
    /// array may be smaller than the sensor.
    #[must_use]
    pub fn show(&self, place: &Vector2<f64>, sensor: &Sensor, margin_px: f64) -> bool {
        let grid = &self.grid;
        let turn = nalgebra::Rotation2::new(-grid.rotation_rad);
        let at = turn * (place - grid.center_px);
        // Nodes lie about the middle of their bounding box, which the first one reaches, or the first
        // two where every second is shifted.
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

    /// Micro-images whose centre is up to `reach` from a place, px.
    #[must_use]
    pub fn about(&self, place: &Vector2<f64>, reach: f64) -> Vec<(i32, i32)> {
        let lattice = &self.grid.lattice;
        let from_middle = (place - self.grid.center_px) / self.grid.pitch_px;
        let turn = nalgebra::Rotation2::new(-self.grid.rotation_rad);
        let at = turn * from_middle;
        let middle = lattice.node(0, 0);
        // Rows of a hexagonal lattice are closer than a pitch, and shifted by up to half a one.
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

    /// Three by three micro-images about the middle of an image of 61 x 61 px.
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
        };
        let internal = InternalParameters {
            m_mm: 0.5 * pitch_px * 0.0055,
            q_prime_mm: vec![0.9 * pitch_px * 0.0055],
            micro_image_pitch_mm: None,
            m_std_dev_mm: None,
            q_prime_std_dev_mm: Vec::new(),
            pupil_growth: 0.0,
            fall_off: None,
            tilt_gradient: None,
            point_spread_px2: None,
            aperture_ratio: None,
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

    /// The array may be smaller than the sensor.
    #[test]
    fn in_view_is_what_the_micro_images_show() {
        let micro_images = micro_images(16.0);
        let large = Sensor { width_px: 61, height_px: 61, pixel_size_mm: 0.0055 };
        let small = Sensor { height_px: 41, ..large };
        let shows = |u: f64, v: f64, sensor: &Sensor, margin_px: f64| {
            micro_images.show(&Vector2::new(u, v), sensor, margin_px)
        };
        // 24 px to every side of (30, 30).
        assert!(shows(53.0, 30.0, &large, 0.0) && !shows(55.0, 30.0, &large, 0.0));
        assert!(shows(7.0, 7.0, &large, 0.5) && !shows(7.0, 7.0, &large, 2.0));
        assert!(shows(30.0, 53.0, &large, 0.0) && !shows(30.0, 53.0, &small, 0.0));
        assert!(!shows(f64::NAN, 30.0, &large, 0.0));
    }
}
