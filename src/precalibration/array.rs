//! Micro-image array of a white image.

use super::centroid::Blob;
use super::grid::MicroImageArray;
use super::indexing::Indexing;
use super::pattern::Pattern;
use crate::model::MicroImageCenter;

/// Micro-images of a white image.
#[derive(Debug, Clone, PartialEq)]
pub struct ArrayMeasurement {
    /// Regular grid of the array.
    pub grid: MicroImageArray,
    /// Lens types as far as this image alone shows them.
    pub lens_types: LensTypes,
    /// Centres that agree with the grid.
    pub centers: Vec<MicroImageCenter>,
    /// Numbers of micro-images that gave no centre, by reason.
    pub left_out: LeftOutCenters,
}

impl ArrayMeasurement {
    /// Creates an array that is known from elsewhere, without uncertainty of its lens types.
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

/// Numbers of micro-images of the grid that gave no centre.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct LeftOutCenters {
    /// Number of micro-images whose window is cut by the border of the image.
    pub cut: usize,
    /// Number of micro-images without light, or with much less light than their neighbours.
    pub dark: usize,
    /// Number of micro-images that are saturated all over, so that no edge shows.
    pub saturated: usize,
    /// Number of micro-images far from where the others predict them: dust, scratches, reflections.
    pub misplaced: usize,
}

/// Lens types as the micro-images show them.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct LensTypes {
    /// Number I of types that can be told apart: 1 or 3.
    pub types: usize,
    /// Least difference of the radii of two types, in its standard deviations, in the white image that separates them
    /// best; `None` for one type, or if radii were not measured.
    pub separation: Option<f64>,
    /// Fraction of all micro-images of the reference whose size is nearest to the size of neighbours of their own lens
    /// type; `None` for one type, or if sizes were not measured.
    pub agreement: Option<f64>,
    /// Difference of the radii of micro-images that alternate in size although they count as one type, relative to their mean:
    /// two lens types. `None` if they do not alternate.
    pub alternating: Option<f64>,
}

impl LensTypes {
    /// One type.
    pub const ONE: Self = Self::stated(1);

    /// Creates lens types whose number is known from elsewhere.
    #[must_use]
    pub const fn stated(types: usize) -> Self {
        Self { types, separation: None, agreement: None, alternating: None }
    }
}

/// Array, and how it was found.
pub(super) struct FoundArray {
    pub array: ArrayMeasurement,
    pub pattern: Pattern,
    /// Micro-images that have a centre in the array, in the same order.
    pub blobs: Vec<Blob>,
    pub indexing: Indexing,
}

impl FoundArray {
    /// Returns the index (k, l) of a node of the pattern.
    pub fn index(&self, node: (i32, i32)) -> (i32, i32) {
        self.indexing.index(&self.pattern, node)
    }
}
