//! Parts of one array of micro-lenses, known to different cameras.

use nalgebra::{Rotation3, Vector2, Vector3};

use super::camera::{MicroLensArray, PlenopticCamera};
use super::lattice::Lattice;

/// Largest distance between two parts of one array, in diameters of the array.
const DIAMETERS: i32 = 4;

impl PlenopticCamera {
    /// Returns this camera with the part of the array known to another one: another part of the same lattice, or one with other
    /// indices. t, D and d refer to the middle of that part, and the focal lengths have the order of its lens types. `None` if
    /// the two cannot be parts of one lattice.
    #[must_use]
    pub fn with_array_of(&self, other: &Self) -> Option<Self> {
        let (own, its) = (&self.lattice, &other.lattice);
        if own.kind() != its.kind() {
            return None;
        }
        let (k, l) = (its.columns / 2, its.rows / 2);
        let place = self.mla.in_pitches(other.mla.place_mm(its.node(k, l)));
        let (own_k, own_l) = nearest(own, place)?;
        let middle = own.node(own_k, own_l) - its.node(k, l);
        let mut camera = Self { lattice: *its, ..self.clone() };
        let (of_types, types) = (&self.mla.focal_lengths_mm, self.lens_types());
        // Three neighbours along a row always include all types.
        for (dk, dl) in (0..3).flat_map(|dk| (0..3).map(move |dl| (dk, dl))).filter(|_| types > 0) {
            let (own_k, own_l) = nearest(own, middle + its.node(k + dk, l + dl))?;
            camera.mla.focal_lengths_mm[its.lens_type(k + dk, l + dl, types)] =
                of_types[own.lens_type(own_k, own_l, types)];
        }
        let middle = self.mla.place_mm(middle);
        camera.mla.offset_mm = middle.xy();
        camera.mla.lens_to_mla_mm = -middle.z;
        camera.mla.mla_to_sensor_mm += self.mla.lens_to_mla_mm + middle.z;
        Some(camera)
    }
}

impl MicroLensArray {
    fn rotation(&self) -> Rotation3<f64> {
        let angles = self.rotation_rad;
        Rotation3::from_euler_angles(angles.x, angles.y, angles.z)
    }

    fn pitches_mm(&self) -> Vector2<f64> {
        self.pitch_mm * Vector2::new(1.0, self.pitch_ratio)
    }

    fn middle_mm(&self) -> Vector3<f64> {
        Vector3::new(self.offset_mm.x, self.offset_mm.y, -self.lens_to_mla_mm)
    }

    /// Returns the position in the camera frame of a point of the array, given in pitches from its middle.
    fn place_mm(&self, place: Vector2<f64>) -> Vector3<f64> {
        self.rotation() * place.component_mul(&self.pitches_mm()).push(0.0) + self.middle_mm()
    }

    /// Projects a point of the camera frame onto the array; returns its position in pitches.
    fn in_pitches(&self, point_mm: Vector3<f64>) -> Vector2<f64> {
        let in_array = self.rotation().inverse() * (point_mm - self.middle_mm());
        in_array.xy().component_div(&self.pitches_mm())
    }
}

/// Returns the node nearest to a position in pitches, on the lattice continued beyond the array; `None` if it is far away.
fn nearest(lattice: &Lattice, place: Vector2<f64>) -> Option<(i32, i32)> {
    let away = |(k, l): &(i32, i32)| (lattice.node(*k, *l) - place).norm_squared();
    let mut node = (lattice.columns / 2, lattice.rows / 2);
    for _ in 0..DIAMETERS * (lattice.columns + lattice.rows) {
        let around = |dk| (-1..=1).map(move |dl| (node.0 + dk, node.1 + dl));
        let next = (-1..=1).flat_map(around).min_by(|a, b| away(a).total_cmp(&away(b)))?;
        if away(&next) >= away(&node) {
            return Some(node);
        }
        node = next;
    }
    None
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::model::small_camera as camera;
    use crate::model::{Packing, Parity};

    /// Every micro-lens of a part is one of the whole, with the same position, focal length and distance to the sensor.
    #[test]
    fn a_part_of_an_array_has_the_micro_lenses_of_the_whole() {
        let mut whole = camera();
        whole.mla.rotation_rad = Vector3::new(0.002, -0.003, 0.01);
        for (parity, columns, rows, right, down) in [
            (Parity::Even, 20, 11, 5, 7),
            (Parity::Odd, 21, 14, -4, 2),
            (Parity::Odd, 60, 50, 0, 1),
        ] {
            let lattice = Lattice { packing: Packing::HexagonalRows(parity), columns, rows };
            let mut known = PlenopticCamera { lattice, ..whole.clone() };
            // The measured part is off by 0.1 pitches.
            let off = whole.lattice.node(20 + right, 18 + down) - lattice.node(10, 6);
            known.mla.offset_mm =
                whole.mla.place_mm(off).xy() + Vector2::new(0.1, -0.1) * whole.mla.pitch_mm;
            let part = whole.with_array_of(&known).unwrap();
            assert_eq!(part.lattice, lattice);
            let to_sensor =
                |camera: &PlenopticCamera| camera.mla.lens_to_mla_mm + camera.mla.mla_to_sensor_mm;
            assert!((to_sensor(&part) - to_sensor(&whole)).abs() < 1e-12);
            for (k, l) in (0..columns).flat_map(|k| (0..rows).map(move |l| (k, l))) {
                let point = part.mla.place_mm(lattice.node(k, l));
                let place = whole.mla.in_pitches(point);
                let (own_k, own_l) = nearest(&whole.lattice, place).unwrap();
                let own = whole.mla.place_mm(whole.lattice.node(own_k, own_l));
                assert!((own - point).norm() < 1e-9, "{k} {l}: {own} and not {point}");
                let focal = |camera: &PlenopticCamera, k, l| {
                    camera.mla.focal_lengths_mm[camera.lens_type(k, l)]
                };
                let (of_part, of_whole) = (focal(&part, k, l), focal(&whole, own_k, own_l));
                assert!((of_part - of_whole).abs() < 1e-15, "{k} {l}");
            }
        }
        assert_eq!(whole.with_array_of(&whole), Some(whole.clone()));
    }

    #[test]
    fn arrays_of_another_kind_or_far_away_have_no_part_in_common() {
        let whole = camera();
        let orthogonal = Lattice { packing: Packing::Orthogonal, ..whole.lattice };
        let mut other = PlenopticCamera { lattice: orthogonal, ..whole.clone() };
        assert_eq!(whole.with_array_of(&other), None);
        other.lattice = whole.lattice;
        other.mla.offset_mm.x = 1e3;
        assert_eq!(whole.with_array_of(&other), None);
    }
}
