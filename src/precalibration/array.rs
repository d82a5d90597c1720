//! The micro-image array of a white image.

use super::centroid::Blob;
use super::grid::MicroImageArray;
use super::indexing::Indexing;
use super::pattern::Pattern;
use crate::model::MicroImageCenter;

/// The micro-images of a white image.
#[derive(Debug, Clone, PartialEq)]
pub struct ArrayMeasurement {
    /// The regular grid.
    pub grid: MicroImageArray,
    /// Lens types as far as this image alone shows them.
    pub lens_types: LensTypes,
    /// The centres that agree with it.
    pub centers: Vec<MicroImageCenter>,
    /// How many micro-images gave no centre, by reason.
    pub left_out: LeftOutCenters,
}

impl ArrayMeasurement {
    /// An array that is known from elsewhere, with no uncertainty stated.
    #[must_use]
    pub fn of_grid(
        grid: MicroImageArray,
        centers: Vec<MicroImageCenter>,
        lens_types: usize,
    ) -> Self {
        Self {
            grid,
            lens_types: LensTypes::stated(lens_types.max(1)),
            centers,
            left_out: LeftOutCenters::default(),
        }
    }
}

/// Micro-images of the grid that gave no centre.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct LeftOutCenters {
    /// Their window is cut by the border of the image.
    pub cut: usize,
    /// Without light, or with much less than their neighbours.
    pub dark: usize,
    /// Saturated all over, so that no edge shows.
    pub saturated: usize,
    /// Far from the place that the others leave for them: dust, scratches, reflections.
    pub misplaced: usize,
}

/// Lens types as the micro-images show them.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct LensTypes {
    /// Number I of types that can be told apart: 1 or 3.
    pub types: usize,
    /// Least difference of two types' radii in the white image that tells them apart best, in its
    /// standard deviations; none for one type, or where radii were not measured.
    pub separation: Option<f64>,
    /// Part of all micro-images of the reference whose size is nearest to that of neighbours of their own
    /// lens type; none for one type, or where sizes were not measured.
    pub agreement: Option<f64>,
}

impl LensTypes {
    /// One type.
    pub const ONE: Self = Self::stated(1);

    /// A number of types that is known from elsewhere.
    #[must_use]
    pub const fn stated(types: usize) -> Self {
        Self { types, separation: None, agreement: None }
    }
}

/// The array, and how it was found.
pub(super) struct FoundArray {
    pub array: ArrayMeasurement,
    pub pattern: Pattern,
    /// The micro-images that have a centre in the array, in the same order.
    pub blobs: Vec<Blob>,
    pub indexing: Indexing,
}

impl FoundArray {
    /// Index (k, l) of a node of the pattern.
    pub fn index(&self, node: (i32, i32)) -> (i32, i32) {
        self.indexing.index(&self.pattern, node)
    }
}
