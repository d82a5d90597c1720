//! The prescription of a real lens: its surfaces, as in a patent or a textbook, and its paraxial optics: focal length,
//! principal planes and pupils.

use std::fmt;

use nalgebra::{Matrix2, Vector2};
use serde::de::value::MapAccessDeserializer;
use serde::de::{MapAccess, Visitor};
use serde::{Deserialize, Deserializer, Serialize};

use crate::error::{Error, Result};
use crate::model::positive;

/// The surfaces of a lens in air, from front to rear. The lens is scaled to the focal length of the camera, so the unit of
/// length is arbitrary.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Prescription {
    /// Refracting surfaces, and the stop.
    pub surfaces: Vec<Surface>,
}

/// A sphere or plane about the optical axis.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Surface {
    /// Radius of curvature, mm: positive if the centre lies on the side of the image, `inf` for a plane.
    #[serde(default = "flat")]
    pub radius_mm: f64,
    /// Distance to the next surface along the axis, mm; ignored for the last surface.
    #[serde(default)]
    pub thickness_mm: f64,
    /// Refractive index behind the surface; 1 for air.
    #[serde(default = "air")]
    pub index: f64,
    /// Half the diameter of the opening, mm; for the stop, with the lens fully open.
    pub semi_diameter_mm: f64,
    /// Place of the vertex off the optical axis, along x and y of the lens frame, mm: an error of the mount.
    #[serde(default, skip_serializing_if = "is_centred")]
    pub decentre_mm: [f64; 2],
    /// True for the stop, which is a plane within one medium.
    #[serde(default, skip_serializing_if = "std::ops::Not::not")]
    pub stop: bool,
}

fn is_centred(decentre_mm: &[f64; 2]) -> bool {
    decentre_mm.iter().all(|x| x.abs() <= 0.0)
}

fn flat() -> f64 {
    f64::INFINITY
}

fn air() -> f64 {
    1.0
}

macro_rules! lenses {
    ($($name:literal),*) => {
        [$(($name, include_str!(concat!("../../data/lenses/", $name, ".toml")))),*]
    };
}

/// Lenses that come with plenocal, by name: files in `data/lenses`.
const LENSES: [(&str, &str); 7] = lenses![
    "double-gauss",
    "telephoto",
    "petzval",
    "triplet",
    "tessar",
    "retrofocus",
    "near-telecentric"
];
/// Largest decentre over the semi-diameter: the tracer searches for rays as if the lens were centred, with a margin of 4 %.
const MOST_DECENTRE: f64 = 0.02;
/// Largest refractive index, above the index of any glass.
const MAX_INDEX: f64 = 4.0;

impl Prescription {
    /// Returns a lens that comes with plenocal.
    pub fn named(name: &str) -> Result<Self> {
        let Some((_, text)) = LENSES.iter().find(|(known, _)| *known == name) else {
            let names = LENSES.map(|(name, _)| name).join(", ");
            return Err(Error::invalid(format!(
                "there is no lens '{name}': give one of {names}, or a file that ends in .toml"
            )));
        };
        Self::from_toml(text).map_err(|e| Error::invalid(format!("the lens {name}: {e}")))
    }

    /// Reads a prescription from the text of its file: `surfaces`, each with `radius_mm`, `thickness_mm`, `index`,
    /// `semi_diameter_mm`, `decentre_mm`, or `stop = true`.
    pub fn from_toml(text: &str) -> Result<Self> {
        let prescription: Self = toml::from_str(text)
            .map_err(|e| Error::invalid(format!("not a valid prescription of a lens: {e}")))?;
        prescription.validate()?;
        Ok(prescription)
    }

    /// Returns e_z of the lens scaled to a focal length, mm: the paraxial exit pupil, which the camera has too.
    pub fn exit_pupil_z(&self, focal_length_mm: f64) -> Result<f64> {
        let paraxial = Paraxial::of(self)?;
        Ok(paraxial.z_mm(paraxial.exit_pupil, focal_length_mm))
    }

    /// Returns the index of the stop.
    pub(super) fn stop(&self) -> usize {
        self.surfaces.iter().position(|surface| surface.stop).unwrap_or_default()
    }

    /// Returns the refractive index in front of a surface.
    pub(super) fn index_before(&self, surface: usize) -> f64 {
        surface.checked_sub(1).map_or(1.0, |i| self.surfaces[i].index)
    }

    /// Returns an error that names the impossible value.
    #[allow(clippy::float_cmp)] // an index is stated
    pub fn validate(&self) -> Result<()> {
        for (i, surface) in self.surfaces.iter().enumerate() {
            self.validate_surface(i, surface)
                .map_err(|e| Error::invalid(format!("surface {} of the lens: {e}", i + 1)))?;
        }
        let stops = self.surfaces.iter().filter(|surface| surface.stop).count();
        if stops != 1 {
            return Err(Error::invalid(format!(
                "the lens has {stops} stops: set stop = true in one of its surfaces"
            )));
        }
        if self.surfaces.last().is_some_and(|last| last.index != 1.0) {
            return Err(Error::invalid("the lens does not end in air: set its last index to 1"));
        }
        Paraxial::of(self)?;
        Ok(())
    }

    #[allow(clippy::float_cmp)] // indices are stated
    fn validate_surface(&self, i: usize, surface: &Surface) -> Result<()> {
        positive(surface.semi_diameter_mm, "its semi-diameter (mm)")?;
        if surface.radius_mm.is_nan() || surface.radius_mm.abs() < surface.semi_diameter_mm {
            return Err(Error::invalid(format!(
                "a sphere of radius {} mm cannot have a semi-diameter of {} mm",
                surface.radius_mm, surface.semi_diameter_mm
            )));
        }
        let most_mm = MOST_DECENTRE * surface.semi_diameter_mm;
        if !surface.decentre_mm.iter().all(|x| x.abs() <= most_mm) {
            let [x, y] = surface.decentre_mm;
            return Err(Error::invalid(format!(
                "its vertex is ({x}, {y}) mm off the axis (decentre_mm): give at most {most_mm:.3} mm, \
                 2 % of its semi-diameter"
            )));
        }
        if !(0.0..f64::INFINITY).contains(&surface.thickness_mm) {
            return Err(Error::invalid(format!(
                "the distance to the next surface is {} mm: give 0 or more",
                surface.thickness_mm
            )));
        }
        if !(1.0..=MAX_INDEX).contains(&surface.index) {
            return Err(Error::invalid(format!(
                "a refractive index of {} is not possible: give 1 to {MAX_INDEX}",
                surface.index
            )));
        }
        if surface.stop && (surface.radius_mm.is_finite() || surface.index != self.index_before(i))
        {
            return Err(Error::invalid(
                "the stop has to be a plane within one medium: leave out its radius, and give it \
                 the index of the surface before it",
            ));
        }
        Ok(())
    }
}

/// Reads a prescription from a file of settings: a name, or surfaces.
impl<'de> Deserialize<'de> for Prescription {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> std::result::Result<Self, D::Error> {
        deserializer.deserialize_any(NameOrSurfaces)
    }
}

struct NameOrSurfaces;

impl<'de> Visitor<'de> for NameOrSurfaces {
    type Value = Prescription;

    fn expecting(&self, out: &mut fmt::Formatter) -> fmt::Result {
        write!(out, "the name of a lens, a file that ends in .toml, or a table with surfaces")
    }

    fn visit_str<E: serde::de::Error>(self, name: &str) -> std::result::Result<Prescription, E> {
        Prescription::named(name).map_err(E::custom)
    }

    fn visit_map<A: MapAccess<'de>>(self, map: A) -> std::result::Result<Prescription, A::Error> {
        #[derive(Deserialize)]
        #[serde(deny_unknown_fields)]
        struct Fields {
            surfaces: Vec<Surface>,
        }
        let Fields { surfaces } = Fields::deserialize(MapAccessDeserializer::new(map))?;
        Ok(Prescription { surfaces })
    }
}

/// Paraxial figures of a lens in air. Positions are distances behind the first vertex, in the unit of the prescription;
/// negative in front of it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Paraxial {
    pub focal_length: f64,
    /// Front principal plane H, from which object distances count.
    pub front_principal: f64,
    /// Rear principal plane H', from which image distances count.
    pub rear_principal: f64,
    pub entrance_pupil: f64,
    pub exit_pupil: f64,
    /// Pupil magnification p: ratio of the diameters of exit pupil and entrance pupil.
    pub pupil_magnification: f64,
    /// Ratio of the diameters of stop and entrance pupil.
    pub stop_magnification: f64,
}

impl Paraxial {
    /// Computes the figures. Fails if the lens does not form real images of far objects, or its exit pupil is inverted.
    pub fn of(lens: &Prescription) -> Result<Self> {
        let (stop, count) = (lens.stop(), lens.surfaces.len());
        let length: f64 =
            lens.surfaces[..count.saturating_sub(1)].iter().map(|s| s.thickness_mm).sum();
        // Matrices act on (height, index times slope): (1 t/n; 0 1) for a distance, and
        // (1 0; −(n'−n)/R 1) for a surface. The determinant is 1.
        let between = |first: usize, end: usize| {
            (first..end).fold(Matrix2::identity(), |before, i| {
                let surface = &lens.surfaces[i];
                let power = (surface.index - lens.index_before(i)) / surface.radius_mm;
                let distance =
                    if i + 1 < count { surface.thickness_mm / surface.index } else { 0.0 };
                Matrix2::new(1.0, distance, 0.0, 1.0) * Matrix2::new(1.0, 0.0, -power, 1.0) * before
            })
        };
        let (front, rear) = (between(0, stop), between(stop, count));
        let whole = rear * front;
        let focal_length = -1.0 / whole[(1, 0)];
        if !(focal_length > 0.0 && focal_length.is_finite()) {
            return Err(Error::invalid(
                "the focal length of the lens is not positive: check the signs of the radii, which \
                 are positive if the centre lies on the image side",
            ));
        }
        // The middle of the stop, seen through the rear group and through the front group.
        let seen = rear * Vector2::new(0.0, 1.0);
        let paraxial = Self {
            focal_length,
            front_principal: (1.0 - whole[(1, 1)]) * focal_length,
            rear_principal: length - (1.0 - whole[(0, 0)]) * focal_length,
            entrance_pupil: front[(0, 1)] / front[(0, 0)],
            exit_pupil: length - seen.x / seen.y,
            pupil_magnification: front[(0, 0)] / seen.y,
            stop_magnification: front[(0, 0)].abs(),
        };
        let pupil = paraxial.pupil_magnification;
        if !(pupil > 0.0 && pupil.is_finite() && paraxial.stop_magnification > 0.0) {
            return Err(Error::invalid(format!(
                "the exit pupil of the lens is {pupil} times its entrance pupil: the stop is imaged upside \
                 down or to infinity, which cannot be simulated; move it"
            )));
        }
        Ok(paraxial)
    }

    /// Returns z in mm, from H' and positive towards the scene, of a position behind the first vertex, for the lens scaled to a
    /// focal length.
    pub fn z_mm(&self, place: f64, focal_length_mm: f64) -> f64 {
        (self.rear_principal - place) * focal_length_mm / self.focal_length
    }
}
