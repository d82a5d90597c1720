//! Why a frame is left out.

/// Why no board was found in a frame.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum Rejection {
    /// Frame and white image differ in size, (width, height) in px.
    #[error(
        "it has {} x {} px, but the white image has {} x {}", image.0, image.1, white.0, white.1
    )]
    Size {
        /// Of the frame.
        image: (usize, usize),
        /// Of the white image.
        white: (usize, usize),
    },
    /// The border cuts every micro-image.
    #[error(
        "no micro-image is whole in it: the white images are of another camera, or the array has too \
         few micro-lenses"
    )]
    NoWholeMicroImage,
    /// This part of the micro-images is saturated in the white image.
    #[error(
        "{:.0} % of the micro-images are saturated in the white image: take it with a shorter exposure",
        100.0 * part
    )]
    SaturatedWhite {
        /// From 0 to 1.
        part: f64,
    },
    /// This part of the micro-images is saturated in the frame.
    #[error("{:.0} % of the micro-images are saturated: the frame is over-exposed", 100.0 * part)]
    Saturated {
        /// From 0 to 1.
        part: f64,
    },
    /// This part of the micro-images has too few pixels to fit a corner to.
    #[error(
        "{:.0} % of the micro-images have too few pixels with light to hold a corner: at a pitch of \
         {micro_image_pitch_px:.1} px no corners can be found in them",
        100.0 * part
    )]
    TooSmall {
        /// From 0 to 1.
        part: f64,
        /// Distance Δc of neighbouring micro-image centres, px.
        micro_image_pitch_px: f64,
    },
    /// This part of the micro-images has no light in the white image.
    #[error(
        "{:.0} % of the micro-images are without light in the white image: it is of another camera, or \
         no white image",
        100.0 * part
    )]
    Dark {
        /// From 0 to 1.
        part: f64,
    },
    /// Every micro-image is unusable, for one reason or another.
    #[error("none of the micro-images can be used")]
    NothingUsable,
    /// Bright and dark squares do not differ.
    #[error("there is no board in it: all is of one brightness")]
    Uniform,
    /// Too few corners were found.
    #[error("{corners} corners are too few for a board")]
    TooFewCorners {
        /// Their number.
        corners: usize,
    },
    /// Boards of this size are not searched for.
    #[error(
        "a board of {columns} x {rows} inner corners cannot be found: it needs {fewest} to {most} of them"
    )]
    BoardSize {
        /// Columns of inner corners.
        columns: i32,
        /// Rows of inner corners.
        rows: i32,
        /// Fewest corners.
        fewest: usize,
        /// Most corners.
        most: usize,
    },
    /// Far more places look like corners than the board has.
    #[error(
        "{places} places look like corners, but the board has {corners}: the image is full of texture"
    )]
    TooMuchTexture {
        /// Their number.
        places: usize,
        /// Corners of the board.
        corners: usize,
    },
    /// No lattice has enough of the corners.
    #[error("the corners lie on no lattice")]
    NoLattice,
    /// What shows may be one part of the board or another.
    #[error(
        "{corners} corners could be more than one part of the board (as many as {elsewhere} at another \
         place): show more of it, or its edges, or correct its size"
    )]
    SeveralPlaces {
        /// Corners that were found at the best place.
        corners: usize,
        /// At the other.
        elsewhere: usize,
    },
    /// Too few of the corners that are in view were found.
    #[error("only {found} of the {in_view} corners in view were found")]
    TooFewInView {
        /// Corners found.
        found: usize,
        /// Corners in view.
        in_view: usize,
    },
    /// The board is larger than stated.
    #[error(
        "{corners} corners lie on the lattice beyond the board of {columns} x {rows} inner corners: \
         correct the size of the board"
    )]
    BeyondBoard {
        /// Corners beyond the board.
        corners: usize,
        /// Stated columns of inner corners.
        columns: i32,
        /// Stated rows of inner corners.
        rows: i32,
    },
    /// A side of the board is in view, but none of its corners was found.
    #[error(
        "no corner of the {side} shows, though it is in view: check that the board has {columns} x \
         {rows} inner corners and is not hidden there"
    )]
    SideMissing {
        /// First or last column or row.
        side: &'static str,
        /// Stated columns of inner corners.
        columns: i32,
        /// Stated rows of inner corners.
        rows: i32,
    },
    /// Many labelled corners were not found again where their labels put them.
    #[error(
        "{lost} of the {labelled} labelled corners were not found again where their labels put them, so the labels are \
         probably wrong: show more of the board, or take a sharper image"
    )]
    Lost {
        /// Corners not found again.
        lost: usize,
        /// Corners labelled.
        labelled: usize,
    },
    /// Too few corners were confirmed for a pose.
    #[error(
        "only {corners} corners of the board were found again in the second pass, but a pose takes \
         {fewest}"
    )]
    TooFewForPose {
        /// Corners found again.
        corners: usize,
        /// Fewest for a pose.
        fewest: usize,
    },
    /// Another reason, in a frame with texture.
    #[error("{reason}; {corners} more corners are texture, not a board")]
    Texture {
        /// Why the board was not found among the other corners.
        reason: Box<Self>,
        /// Corners of texture.
        corners: usize,
    },
}
