//! Findings about images, boards, cameras and results, in one form.
//!
//! A finding has a code, a severity, a subject, the measured values behind it, and a remedy. Checks (`crate::checks`)
//! create findings from measured values; stages return them; verdicts and tests use severities and codes.
//! The wording of all findings is the table in this file, and nowhere else.

use std::fmt;
use std::path::PathBuf;

use serde::ser::SerializeStruct;
use serde::{Serialize, Serializer};

use crate::quantity::{Estimate, counted, display_unit, fixed, fixed_signed};

/// Consequence of a finding for the camera.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum Severity {
    /// Worth knowing; the camera is not in doubt.
    Note,
    /// The camera is usable with care.
    Caution,
    /// The camera should not be used.
    Unusable,
}

/// Object that a finding is about.
#[derive(Debug, Clone, PartialEq, Eq, Default, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum Subject {
    /// The input or result as a whole.
    #[default]
    Whole,
    /// A file.
    File(PathBuf),
    /// A white image, by its name.
    Image(String),
    /// A frame of the board.
    Frame {
        /// Number of the frame.
        frame: u32,
        /// Name of its image, where it is known.
        #[serde(skip_serializing_if = "Option::is_none")]
        image: Option<String>,
        /// True if the frame is not used.
        left_out: bool,
    },
    /// A part of the work, such as `point clouds` or the name of a camera that is evaluated.
    Part(String),
}

/// Order in which the corners of a board may be numbered.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum CornerNumbering {
    /// row · columns + column, from 0: the order of features.
    RowByRow,
    /// column · rows + row, from 0.
    ColumnByColumn,
    /// Row by row, from 1.
    FromOne,
    /// Row by row, from -1.
    FromMinusOne,
}

impl CornerNumbering {
    /// All orders.
    pub const ALL: [Self; 4] =
        [Self::RowByRow, Self::ColumnByColumn, Self::FromOne, Self::FromMinusOne];

    fn words(self) -> &'static str {
        match self {
            Self::RowByRow => "row by row",
            Self::ColumnByColumn => "column by column (column · rows + row)",
            Self::FromOne => "from 1 on",
            Self::FromMinusOne => "from -1 on",
        }
    }
}

/// Term of the cost in which an evaluation differs from a problem.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub struct CostDifference {
    /// Option of a calibration that selects the term, as in `[calibration]` of a project file.
    pub option: &'static str,
    /// Term in the problem, in words.
    pub problem: String,
    /// Term in the evaluation, in words.
    pub here: String,
}

/// Statement about an input or a result.
#[derive(Debug, Clone, PartialEq)]
pub struct Finding {
    /// Consequence for the camera.
    pub severity: Severity,
    /// Object of the finding.
    pub subject: Subject,
    /// Kind of finding, with the measured values.
    pub issue: Issue,
    /// Importance among findings of the same severity: usually a measured value over its limit.
    pub weight: f64,
}

impl Finding {
    /// Creates a finding about the whole input or result.
    #[must_use]
    pub fn new(severity: Severity, issue: Issue) -> Self {
        Self { severity, subject: Subject::Whole, issue, weight: 1.0 }
    }

    /// Creates a note.
    #[must_use]
    pub fn note(issue: Issue) -> Self {
        Self::new(Severity::Note, issue)
    }

    /// Creates a finding that calls for care.
    #[must_use]
    pub fn caution(issue: Issue) -> Self {
        Self::new(Severity::Caution, issue)
    }

    /// Creates a finding after which the camera should not be used.
    #[must_use]
    pub fn unusable(issue: Issue) -> Self {
        Self::new(Severity::Unusable, issue)
    }

    /// Sets the subject.
    #[must_use]
    pub fn about(self, subject: Subject) -> Self {
        Self { subject, ..self }
    }

    /// Makes a white image the subject.
    #[must_use]
    pub fn about_image(self, name: &str) -> Self {
        self.about(Subject::Image(name.to_owned()))
    }

    /// Makes a frame the subject, with the name of its image.
    #[must_use]
    pub fn about_frame(self, frame: u32, image: Option<&str>) -> Self {
        self.about(Subject::Frame { frame, image: image.map(str::to_owned), left_out: false })
    }

    /// Creates a note that a frame is not used, with the reason.
    #[must_use]
    pub fn left_out(frame: u32, image: Option<&str>, issue: Issue) -> Self {
        let image = image.map(str::to_owned);
        Self::note(issue).about(Subject::Frame { frame, image, left_out: true })
    }

    /// Sets the weight.
    #[must_use]
    pub fn weighing(self, weight: f64) -> Self {
        Self { weight, ..self }
    }

    /// Returns the identifier of its kind, such as `bad-fit`: stable, for programs.
    #[must_use]
    pub fn code(&self) -> &'static str {
        self.issue.code()
    }

    /// Returns the remedy; empty if there is none.
    #[must_use]
    pub fn remedy(&self) -> String {
        self.issue.remedy()
    }

    /// Returns the message, without the remedy.
    #[must_use]
    pub fn message(&self) -> String {
        format!("{}{}", self.subject, self.issue)
    }
}

impl fmt::Display for Finding {
    /// Writes the message and the remedy.
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.message())?;
        match self.remedy() {
            remedy if remedy.is_empty() => Ok(()),
            remedy => write!(f, ": {remedy}"),
        }
    }
}

impl fmt::Display for Subject {
    /// Writes the beginning of a message, with a colon; nothing for the whole.
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Whole => Ok(()),
            Self::File(path) => write!(f, "{}: ", path.display()),
            Self::Image(name) | Self::Part(name) => write!(f, "{name}: "),
            Self::Frame { frame, image, left_out } => {
                write!(f, "frame {frame}")?;
                image.as_ref().map_or(Ok(()), |image| write!(f, " ({image})"))?;
                f.write_str(if *left_out { " is left out: " } else { ": " })
            }
        }
    }
}

impl Serialize for Finding {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        let mut fields = serializer.serialize_struct("Finding", 6)?;
        fields.serialize_field("code", self.code())?;
        fields.serialize_field("severity", &self.severity)?;
        fields.serialize_field("subject", &self.subject)?;
        fields.serialize_field("values", &self.issue)?;
        fields.serialize_field("text", &self.message())?;
        fields.serialize_field("remedy", &self.remedy())?;
        fields.end()
    }
}

/// Sorts findings by severity, then by weight, the heaviest first.
pub fn sort(findings: &mut [Finding]) {
    findings.sort_by(|a, b| b.severity.cmp(&a.severity).then(b.weight.total_cmp(&a.weight)));
}

/// Returns the heaviest severity among findings; `None` without any.
#[must_use]
pub fn worst(findings: &[Finding]) -> Option<Severity> {
    findings.iter().map(|finding| finding.severity).max()
}

/// Declares [`Issue`]: for each kind of finding its code, its measured values, its message, and its remedy.
macro_rules! issues {
    ($(
        $(#[$doc:meta])*
        $variant:ident $code:literal $({ $($field:ident: $type:ty),* $(,)? })?
            => $text:expr, $remedy:expr;
    )*) => {
        /// Kind of finding, with the measured values; units are in the names.
        #[derive(Debug, Clone, PartialEq, Serialize)]
        #[serde(untagged)]
        #[allow(missing_docs)] // of fields, whose names say what they are and in which unit
        pub enum Issue {
            $($(#[$doc])* $variant $({ $($field: $type),* })?,)*
        }

        impl Issue {
            /// Codes of all kinds, in the order of the table.
            pub const CODES: &'static [&'static str] = &[$($code),*];

            /// Returns the identifier of the kind of finding.
            #[must_use]
            pub fn code(&self) -> &'static str {
                match self {
                    $(Self::$variant { .. } => $code,)*
                }
            }

            /// Returns the remedy; empty if there is none.
            #[must_use]
            #[allow(unused_variables)] // most remedies need no values
            pub fn remedy(&self) -> String {
                match self {
                    $(Self::$variant $({ $($field),* })? => $remedy.to_string(),)*
                }
            }
        }

        impl fmt::Display for Issue {
            #[allow(unused_variables)] // values that only the remedy needs
            fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
                match self {
                    $(Self::$variant $({ $($field),* })? => f.write_str(&$text.to_string()),)*
                }
            }
        }
    };
}

const NONE: &str = "";
/// The remedy for images that were changed after the exposure.
const SAME_SETTINGS: &str = "take and export all images with the same settings, linear in light";
/// The remedy if two images of one camera do not coincide.
const NOTHING_MOVED: &str =
    "take both images as the camera delivers them, and move nothing in the camera between them";

issues! {
    // Files and images.

    /// Image files are JPEG.
    LossyCompression "lossy-compression" { images: usize, first: String } =>
        format!("{} in JPEG format (first: {first}): compression shifts and widens edges, and biases d, fᵢ and m by a per cent or more", counted(*images, "image")),
        "save the images in a lossless format (PNG, TIFF)";
    /// Image files declare samples that are not linear in light.
    ImageProfile "image-profile-not-linear" { images: usize, first: String, profile: String } =>
        format!("{} with a profile that declares samples not linear in light (first: {first}, {profile}); the samples are used unchanged", counted(*images, "image file")),
        "export the images without gamma or sRGB; if the samples are linear, remove the profile from the files";
    /// Image files declare that they are to be turned or mirrored.
    ImageOrientation "image-orientation" { images: usize, first: String, orientation: u64 } =>
        format!("{} with an orientation tag (first: {first}, orientation {orientation}); the pixels are used as stored", counted(*images, "image file")),
        "save all white images and boards in the orientation of the sensor, and do not rotate them with other software";
    /// Image files of one set have different orientation tags: number and name of the first for each orientation.
    OrientationsDiffer "image-orientations-differ" { groups: Vec<(u64, usize, String)> } =>
        format!("the images have different orientation tags ({}); the pixels are used as stored", orientations(groups)),
        "save all white images and boards in the orientation of the sensor: software may have rotated the pixels of some of them";
    /// TIFF files have several pages.
    SeveralPages "several-pages" { images: usize, first: String, pages: usize } =>
        format!("{} with several pages (first: {first}, {pages} pages); only the first page is read", counted(*images, "TIFF file")),
        "state pages in [images]: \"average\" for exposures of the same scene, or the number of a page";
    /// A page of TIFF files with several pages is chosen, or their mean.
    PagesUsed "pages-used" { images: usize, first: String, pages: usize, used: String } =>
        format!("{} with several pages (first: {first}, {pages} pages): {used}, as stated", counted(*images, "TIFF file")),
        NONE;
    /// A dark image is subtracted from all images.
    DarkSubtracted "dark-image-subtracted" { dark: String, pages: usize, mean: f64, scatter: f64, hot_pixels: usize } =>
        format!(
            "the dark image {dark} is subtracted from all images ({}, mean {mean:.2} grey levels, scatter between pixels {scatter:.2}, {})",
            counted(*pages, "page"), counted(*hot_pixels, "hot pixel")
        ),
        NONE;
    /// A maker's calibration has values that are not used.
    MakerValuesUnused "maker-values-unused" { distortion: Option<String>, rotation_rad: f64 } =>
        maker_values_text(distortion.as_deref(), *rotation_rad),
        "measure the array on a white image of the camera, and use the measured centres";
    /// A file was changed while it was read.
    FileChanged "file-changed" =>
        "the file changed during the run", "repeat the run";
    /// The pixels of an image that is stated to be grey alternate as behind a colour mosaic.
    ColorMosaic "color-mosaic" =>
        "its pixels alternate in brightness as behind a colour mosaic",
        "state the mosaic as the colour of the images, for example bayer-rggb";
    /// The two green pixels of a mosaic differ.
    WrongMosaic "wrong-mosaic" =>
        "the two green pixels of the mosaic differ", "state the mosaic of the camera";
    /// The work on a part was not possible; the rest went on.
    PartFailed "part-failed" { reason: String } =>
        reason, NONE;

    // White images.

    /// The samples are not linear in light.
    NotLinear "not-linear" { power: f64 } =>
        format!("the samples of the white images are not linear in light: light ≈ sample^{power:.1} (gamma or another tone curve)"),
        "switch off gamma, tone curves and sRGB in the camera and its software, and take or export all images again, boards included";
    /// The stated black level contradicts the darkness between micro-images.
    BlackLevelContradicted "black-level-contradicted" { stated: f64, image: String, measured: f64 } =>
        format!("the stated black level is {stated} grey levels, but the samples between the micro-images of {image} are {measured:.2}"),
        "correct black_level in [images], or remove it; take the dark image, if there is one, at the exposure time and gain of the white images";
    /// The black level cannot be measured.
    BlackLevelUnknown "black-level-unknown" =>
        "the black level cannot be measured: no white image is dark between its micro-images; a black level of 0 is assumed",
        "state dark (an image with the lens covered) or black_level (its mean sample) in [images], or add a white image at a larger f-number";
    /// The radius of micro-images contradicts the f-numbers of the other white images.
    FNumberContradicted "f-number-contradicted" { f_number: f64, radius_px: f64, expected_px: f64 } =>
        format!("the micro-images of type 1 at f/{f_number:.2} have a radius of {radius_px:.2} px, but the other white images predict {expected_px:.2} px"),
        "check its f-number, and that its contrast and black level are unchanged";
    /// A white image is left out, since its micro-images have the size of another f-number.
    FNumberLeftOut "f-number-left-out" { f_number: f64, looks_like: f64 } =>
        format!("its micro-images have the size for f/{looks_like:.2} instead of f/{f_number:.2}, if the other white images are right; the image is not used"),
        "check its f-number, that it is a white image of this camera, and that its contrast and black level are unchanged";
    /// A white image is left out, since its micro-images overlap.
    WhitesOverlap "overlapping-white-image" { f_number: f64, apart: f64 } =>
        format!("micro-images overlap at f/{f_number:.2}, so the image is not used to measure m and q'; they do not overlap from f/{apart:.1} upwards"),
        NONE;
    /// Micro-images of boards overlap.
    MicroImagesOverlap "micro-images-overlap" { f_number: f64, apart: f64, part: f64 } =>
        format!("the micro-images of the boards overlap at f/{f_number:.2} by {:.0} % of their radius: corners are measured only where a single micro-lens lights the sensor", 100.0 * part),
        format!("stop down: micro-images do not overlap from f/{apart:.1} upwards");
    /// The white images show other openings than stated.
    OpeningContradicted "opening-contradicted" { stated: &'static str, cell: &'static str, share: Estimate } =>
        format!("the openings of the micro-lenses are stated to be {}s, but white images show a cell share of {:.2} ± {:.2} instead (0 for discs, 1 for {}s)", stated, share.value, share.std_dev, cell),
        "leave out opening in [micro_lens_array], or correct it";
    /// The openings are neither discs nor cells.
    OpeningBetween "opening-between" { taken: &'static str, cell: &'static str, share: Estimate } =>
        format!("the openings of the micro-lenses are neither discs nor {}s: white images show a cell share of {:.2} ± {:.2} (0 for discs, 1 for {}s). They are taken for {}s, and fᵢ may be off by 2 %", cell, share.value, share.std_dev, cell, taken),
        "state the shape if it is known: opening in [micro_lens_array]";
    /// The white image of the boards was taken at another aperture than stated.
    ApertureContradicted "aperture-contradicted" { f_number: f64, radius_px: f64, expected_px: f64, looks_like: f64 } =>
        format!("the micro-images of type 1 at f/{f_number:.2} should have a radius of {expected_px:.2} px, but have {radius_px:.2} px, the radius at about f/{looks_like:.2}"),
        "check the f-number of the main lens (f_number): it applies to this image and to the boards";
    /// m and q' come from straight lines, since the light shows no discs.
    NoDiscs "no-discs" { m_error: f64, q_prime_error: f64 } =>
        format!("the light in the micro-images does not fit two discs (noise clipped at black, or a wide point spread): m and q' follow from the radii alone, and f-numbers that are wrong by 2 % change m by {:.0} % and q' by {:.0} %", 100.0 * m_error, 100.0 * q_prime_error),
        "expose the white images longer at a lower gain, keep their black level above 0, and check that they are sharp";
    /// The angular response of the pixels cannot be measured.
    ResponseUnknown "response-unknown" =>
        "the fall-off of light with its angle of incidence cannot be measured: cos⁴ is assumed, and corners far from the axis may be off by 0.1 px",
        "take white images without clipped samples";
    /// Micro-images at the corners of the image are not round.
    ObliquePupil "oblique-pupil" { narrower: f64 } =>
        format!("the micro-images at the corners of the image are {:.0} % narrower radially: the main lens vignettes there, so that e_r and Q1_m are held unless they have a prior, and distortion, field curvature and the tilt of the array can be off by several σ", 100.0 * narrower),
        "take boards and white images at a larger f-number, or keep boards away from the border of the image";
    /// Few micro-images have the size of their lens type.
    LensTypesDisagree "lens-types-disagree" { agreement: f64 } =>
        format!("only {:.0} % of the micro-images have the size of their lens type: the image is noisy or not white, or the types do not follow the lattice", 100.0 * agreement),
        NONE;
    /// Micro-images of one lens type alternate in size.
    AlternatingSizes "alternating-sizes" { apart: f64 } =>
        format!("its micro-images alternate in size by {:.1} %, as behind two types of micro-lenses, but arrays have one type or three", 100.0 * apart),
        "use a camera with one or three lens types: plenocal would average the focal lengths of two types";
    /// Neighbouring micro-images differ in brightness.
    NotWhite "not-white" { uneven: f64 } =>
        format!("{:.0} % of its micro-images differ clearly in brightness from their neighbours", 100.0 * uneven),
        "take a white image of a bright, uniform surface directly in front of the lens";
    /// The micro-images lie off a regular lattice.
    IrregularArray "irregular-array" { rms_px: f64, pitch_px: f64 } =>
        format!("its micro-images deviate from a regular grid by {rms_px:.2} px RMS, {:.1} % of their pitch: arrays are more regular", 100.0 * rms_px / pitch_px),
        "give a uniformly lit, unprocessed white image that is not a composite of several images";
    /// The lattice is longer along one direction.
    StretchedArray "stretched-array" { stretch: f64 } =>
        format!("its lattice is {:.2} % longer along one direction than across it, as if the pixels were not square", 100.0 * stretch),
        "give the images as the camera delivers them, and do not resize them";
    /// Many micro-images of the array are not used.
    MicroImagesLeftOut "micro-images-left-out" { dark: usize, misplaced: usize, all: usize } =>
        format!("{} of {all} micro-images are not used ({dark} dark, {misplaced} off the grid)", dark + misplaced),
        "if more than these show light, give a sharper, evenly lit white image";
    /// Most pixels of a white image are saturated.
    OverExposed "over-exposed" { full: f64 } =>
        format!("{:.0} % of its pixels are saturated", 100.0 * full),
        "reduce the exposure until the edges of the micro-images are visible";

    // Images of boards.

    /// A frame shows no board, or cannot be read.
    Unreadable "unreadable" { reason: String } =>
        reason, NONE;
    /// The samples were rounded to few levels.
    FewLevels "few-levels" { images: usize, fewest: u32, frames: Vec<u32> } =>
        format!("{} with few grey levels, in the worst case {fewest} (frames {}): rounding shifts edges", counted(*images, "board image"), list(frames)),
        "export the images with the full bit depth of the camera";
    /// Few frames for a calibration.
    FewBoards "few-boards" { frames: usize } =>
        format!("the calibration has only {}", counted(*frames, "frame")),
        "take ten frames or more, at several distances and tilts";
    /// The edges of one frame are wider than the others'.
    MotionBlur "motion-blur" { motion_px: f64 } =>
        format!("its edges are wider than in the other frames, equivalent to a motion of {motion_px:.1} px in the micro-images"),
        "hold board and camera still, or leave the frame out if it does not fit";
    /// No frame shows all sides of the board.
    BoardNeverWhole "board-never-whole" { columns: i32, rows: i32 } =>
        "no frame shows the board from its first to its last row and column",
        format!("check that it has {columns} x {rows} inner corners");
    /// These boards give another aperture ratio than the boards of the calibration.
    ApertureRatioOfOtherBoards "aperture-ratio-of-other-boards" { fitted_with: f64, estimated: Estimate } =>
        format!("the boards of the calibration give an aperture ratio of {fitted_with:.4}, but these boards give {estimated}"),
        "take all images with the same camera at the same settings";
    /// The light of boards differs from the white image in no single way.
    UnlikeWhite "unlike-white" =>
        "the distribution of light in the micro-images differs from the white image; possible causes: another f-number, a gamma, another black level, a shift, another size or another camera",
        SAME_SETTINGS;
    /// Boards have another black level than the white image.
    OtherBlackLevel "other-black-level" { difference: f64 } =>
        format!("the black level is {} than in the white image, by {:.1} % of a bright square", if *difference > 0.0 { "higher" } else { "lower" }, 100.0 * difference.abs()),
        SAME_SETTINGS;
    /// Boards have another tone curve than the white image.
    OtherToneCurve "other-tone-curve" { power: f64 } =>
        format!("the board images have another tone curve than the white image: light ≈ sample^{power:.2} (gamma, contrast or another tone curve)"),
        SAME_SETTINGS;
    /// Boards have another aperture than the white image.
    OtherAperture "other-aperture" { ratio: f64 } =>
        format!("the edges of the micro-images correspond to {ratio:.3} times the f-number of the white image"),
        "take the boards and their white image (devignetting) at the same f-number";
    /// Boards have another scale than the white image.
    OtherScale "other-scale" { scale: f64 } =>
        format!("the pitch of the micro-images is {:.2} % {} than in the white image: one of the images was resized, or has another focus or camera", 100.0 * scale.abs(), if *scale < 0.0 { "larger" } else { "smaller" }),
        NOTHING_MOVED;
    /// Boards are turned against the white image.
    OtherRotation "other-rotation" { angle_deg: f64 } =>
        format!("the micro-images are rotated by {angle_deg:.3} degrees relative to the white image"),
        NOTHING_MOVED;
    /// Boards are shifted against the white image.
    OtherOrigin "other-origin" { shift_px: [f64; 2] } =>
        format!("the micro-images are shifted by ({}, {}) px relative to the white image: a part of the camera has moved, or one of the images was cropped", fixed(shift_px[0], 2), fixed(shift_px[1], 2)),
        "take the white images with the camera in the same state as for the boards";

    // A frame without a board.

    /// Frame and white image differ in size.
    SizesDiffer "sizes-differ" { image_px: [usize; 2], white_px: [usize; 2] } =>
        format!("the image has {} x {} px, but the white image has {} x {} px", image_px[0], image_px[1], white_px[0], white_px[1]),
        NONE;
    /// The border cuts every micro-image.
    NoWholeMicroImage "no-whole-micro-image" =>
        "the image contains no complete micro-image: the white images are of another camera, or the array has too few micro-lenses",
        NONE;
    /// Micro-images are saturated in the white image.
    SaturatedWhite "saturated-white" { part: f64 } =>
        format!("{:.0} % of the micro-images are saturated in the white image", 100.0 * part),
        "take the white image with a shorter exposure";
    /// Micro-images are saturated in the frame.
    Saturated "saturated" { part: f64 } =>
        format!("{:.0} % of the micro-images are saturated", 100.0 * part), "reduce the exposure";
    /// Micro-images have too few pixels to fit a corner to.
    MicroImagesTooSmall "micro-images-too-small" { part: f64, pitch_px: f64 } =>
        format!("{:.0} % of the micro-images have too few bright pixels to fit a corner: a pitch of {pitch_px:.1} px is too small", 100.0 * part),
        NONE;
    /// Micro-images have no light in the white image.
    DarkWhite "dark-white" { part: f64 } =>
        format!("{:.0} % of the micro-images are dark in the white image: it is of another camera, or not a white image", 100.0 * part),
        NONE;
    /// No micro-image is usable, for one reason or another.
    NothingUsable "nothing-usable" =>
        "no micro-image can be used", NONE;
    /// Bright and dark squares do not differ.
    Uniform "uniform" =>
        "the image shows no board: its brightness is uniform",
        "remove the image from the boards if it is a white image; otherwise light the board more evenly and brighter";
    /// Too few corners were found for a board.
    TooFewCorners "too-few-corners" { corners: usize } =>
        format!("{corners} corners are too few for a board"), NONE;
    /// Boards of this size are not searched for.
    BoardSize "board-size" { columns: i32, rows: i32, fewest: usize, most: usize } =>
        format!("a board of {columns} x {rows} inner corners is not supported: a board has {fewest} to {most} inner corners"), NONE;
    /// Far more places look like corners than the board has.
    TooMuchTexture "too-much-texture" { places: usize, corners: usize } =>
        format!("{places} places look like corners, but the board has {corners}: the image contains too much texture"), NONE;
    /// No lattice has enough of the corners.
    NoLattice "no-lattice" =>
        "the corners do not form a lattice", NONE;
    /// The visible part may be one part of the board or another.
    SeveralPlaces "several-places" { corners: usize, elsewhere: usize } =>
        format!("{corners} corners match more than one part of the board ({elsewhere} match another part)"),
        "show more of the board or its edges, or correct its size";
    /// In some frames the board fills the view.
    ShiftedNumbers "shifted-numbers" { frames: Vec<u32> } =>
        format!("the board fills the view (frames {}): its corners are numbered up to a shift by whole squares and a quarter turn. The camera does not depend on these, but the poses of these frames do, and the board is taken to be flat", list(frames)),
        NONE;
    /// Too few of the corners in view were found.
    TooFewInView "too-few-in-view" { found: usize, in_view: usize } =>
        format!("only {found} of the {in_view} corners in view were found"), NONE;
    /// The board is larger than stated.
    BeyondBoard "beyond-board" { corners: usize, columns: i32, rows: i32 } =>
        format!("{corners} corners lie on the lattice beyond the board of {columns} x {rows} inner corners"),
        "correct the size of the board";
    /// A side of the board is in view, but none of its corners was found.
    SideMissing "side-missing" { side: &'static str, columns: i32, rows: i32 } =>
        format!("no corner of the {side} was found, although it is in view"),
        format!("check that the board has {columns} x {rows} inner corners, is not hidden there, and is as sharp as the white images");
    /// Many labelled corners were not found at the positions that their labels predict.
    LabelsLost "labels-lost" { lost: usize, labelled: usize } =>
        format!("{lost} of the {labelled} labelled corners were not found at their predicted positions: the labels are probably wrong"),
        "show more of the board, or take a sharper image";
    /// Too few corners were confirmed for a pose.
    TooFewForPose "too-few-for-pose" { corners: usize, fewest: usize } =>
        format!("the second pass found only {corners} corners of the board, but a pose needs {fewest}"), NONE;
    /// Another reason, in a frame with texture.
    Texture "texture" { reason: Box<Issue>, corners: usize } =>
        format!("{reason}; {corners} more corners are texture, not a board"), reason.remedy();

    // A frame without a pose.

    /// The caller left the frame out.
    Excluded "excluded" =>
        "excluded on request", NONE;
    /// The frame has too few corners for a pose.
    PoseTooFewCorners "pose-too-few-corners" { corners: usize, fewest: usize } =>
        format!("it shows only {}, but a pose needs {fewest}", counted(*corners, "corner")), NONE;
    /// The corners of the frame lie on one line.
    PoseCollinear "pose-collinear" =>
        "its corners lie on one line", NONE;
    /// `solvePnP` failed.
    PoseNotFound "pose-not-found" { reason: String } =>
        format!("solvePnP failed: {reason}"), NONE;
    /// No pose has the whole board beyond the focal plane.
    PoseBehindFocalPlane "pose-behind-focal-plane" =>
        "solvePnP found no pose with the whole board in front of the focal plane of the main lens", NONE;
    /// Poses are given, but none of this frame.
    PoseNotGiven "pose-not-given" =>
        "the poses that were given do not include this frame", NONE;
    /// Poses are given of frames that show no features.
    PosesOfNoFrame "poses-of-no-frame" { frames: Vec<u32> } =>
        format!("the input has poses of frames without features, which are not used: {}", list(frames)),
        "check that poses and features number the frames in the same way";

    // Calibrations.

    /// The corners of features are numbered in another order.
    NumberedOtherwise "numbered-otherwise" { numbering: CornerNumbering, misfit: f64, row_by_row: f64, columns: i32, rows: i32 } =>
        format!("the features seem to number the corners {}: a board of {columns} x {rows} corners then fits to {:.0} % of their spread, but with row · columns + column only to {:.0} %", numbering.words(), 100.0 * misfit, 100.0 * row_by_row),
        format!("number corners row by row from 0: corner = row · columns + column, with {columns} columns (cluster in the feature file); or correct columns and rows of the board");
    /// A solution was evaluated with a cost that differs from the problem beside it.
    OtherCost "other-cost" { problem: String, differences: Vec<CostDifference> } =>
        other_cost_text(problem, differences),
        "evaluate the solution with the cost of the problem";
    /// The calibration is not at a minimum.
    NotConverged "not-converged" =>
        "the calibration has not converged", NONE;
    /// Micro-image centres lie far from the grid; they are kept.
    OutlyingCenters "outlying-centers" { outliers: usize, centers: usize, grid_rms_px: f64 } =>
        format!("{outliers} of {centers} micro-image centres lie far from the grid ({grid_rms_px:.3} px RMS); all centres are used"),
        "choose a robust loss (loss) to reduce their weight";
    /// Features without σ lie far from their projections.
    OutlyingUnweighted "outlying-unweighted" { features: usize, all: usize, scale: f64 } =>
        format!("{features} of {all} features, which have no σ, lie more than 10 times as far from their projections as usual: the refinement is repeated with Huber's loss (scale {scale:.2}, from the residuals)"),
        "check these features in residuals.csv, or choose a loss";
    /// The array reaches far beyond the image.
    ArrayBeyondImage "array-beyond-image" { array: [i32; 2], extent_px: [f64; 2], image_px: [u32; 2] } =>
        format!("{} x {} micro-lenses cover {:.0} x {:.0} px, but the image has {} x {} px", array[0], array[1], extent_px[0], extent_px[1], image_px[0], image_px[1]),
        "check the size of the array: D, d, t_x and t_y refer to its middle";
    /// The observations do not determine all parameters.
    Undetermined "undetermined" { rank: usize, parameters: usize, names: Vec<String> } =>
        format!("the observations determine {rank} of {parameters} parameters; not determined: {}", if names.is_empty() { "some poses".to_owned() } else { names.join(", ") }),
        "fix parameters, or add frames at other distances and tilts, with features in every lens type";
    /// The calibration of the camera in use has not converged.
    CameraNotConverged "camera-not-converged" =>
        "the calibration of this camera has not converged", "calibrate it again";
    /// The calibration of the camera in use has not determined some parameters.
    CameraUndetermined "camera-undetermined" { names: Vec<String> } =>
        format!("the calibration of this camera has not determined {}", names.join(", ")),
        "calibrate it again with frames at other distances and tilts";
    /// The verdict on the calibration of the camera in use is "do not use".
    CameraNotToBeUsed "camera-not-to-be-used" { reasons: Vec<String> } =>
        format!("the verdict on the calibration of this camera is \"do not use\" ({})", reasons.join(", ")),
        "see its report, and calibrate it again";
    /// The micro-image centres of the camera in use differ from the white images.
    CentersContradicted "centers-contradicted" { rms_px: f64, shift_px: [f64; 2], pitch_px: f64 } =>
        format!("the micro-image centres of the camera and of the white images differ by {rms_px:.2} px RMS, including a shift of ({}, {}) px", fixed_signed(shift_px[0], 2), fixed_signed(shift_px[1], 2)),
        "use images of the calibrated camera, and do not crop, rotate or resize them; if array or sensor have moved, calibrate it again";
    /// The blur radii of the lens types differ between the camera in use and the white images.
    LensTypesContradicted "lens-types-contradicted" { white_images_px: Vec<f64>, camera_px: Vec<f64>, permuted: Option<Vec<usize>> } =>
        lens_types_text(white_images_px, camera_px, permuted.as_deref()),
        "use white images of the calibrated camera, with its lens types in the same order";
    /// The camera is used at another f-number than in its calibration.
    OtherFNumber "other-f-number" { camera: f64, boards: f64 } =>
        format!("the camera was calibrated at f/{camera:.2}, but is used at f/{boards:.2}: spherical aberration makes F and the blur depend on the aperture"),
        "calibrate it at the f-number of the images, or compare both f-numbers on boards";
    /// The blur radii of boards differ from the fixed camera.
    BlurContradicted "blur-contradicted" { rms_std_devs: f64 } =>
        format!("the blur radii of the boards and of the camera differ by {rms_std_devs:.0} σ RMS"),
        "check that these images are of this camera, and that f_1, f_2 … are in the order of the lens types";
    /// Boards fit a fixed camera best with squares of another size.
    SquaresContradicted "squares-contradicted" { fitted_mm: Estimate, square_mm: f64 } =>
        format!("the boards fit the camera best with squares of {fitted_mm} mm instead of {square_mm} mm"),
        "check the size of the squares (square_mm), and that the lens is focused as in the calibration of the camera";
    /// Rays or points lie far from the boards that the camera was calibrated with.
    BeyondBoards "beyond-boards" { beyond: usize, all: usize, near_mm: f64, far_mm: f64 } =>
        format!("{} far outside the range of the calibration boards ({near_mm:.0} to {far_mm:.0} mm): the errors of the camera grow there", if *all == 1 { "the distance is".to_owned() } else { format!("{beyond} of {all} distances are") }),
        "see σ by distance in the report of the calibration, or calibrate with boards at such distances";
    /// Virtual points name a micro-lens outside the array.
    OutsideArray "outside-array" { points: usize, first: usize } =>
        format!("{} at a micro-lens outside the array (first: point {first}), without a metric point", counted(*points, "virtual point")),
        "check that k and l count from 0 as in centers.csv of this camera";
    /// Virtual points lie far from the micro-image with their index.
    FarFromMicroImage "far-from-micro-image" { points: usize, first: usize, pitch_px: f64 } =>
        format!("{} more than a pitch ({pitch_px:.1} px) from the centre of the micro-image (k, l) (first: point {first})", counted(*points, "virtual point")),
        "check that k, l, u and v are of this camera, in px of the raw image, and not swapped";
    /// Virtual depths have a sign that images of the camera cannot have.
    DepthsOfOtherSign "depths-of-other-sign" { points: usize, first: usize, galilean: bool } =>
        format!("{} with the wrong sign (first: point {first}): the main lens of this {} camera forms its images {} the array", counted(*points, "virtual depth"), if *galilean { "Galilean" } else { "Keplerian" }, if *galilean { "behind" } else { "in front of" }),
        "check the sign: virtual depths are distances from the array, positive behind it";
    /// The σ of points is not known, since no σ of virtual depths is stated.
    PointsWithoutSigma "points-without-sigma" =>
        "the input states no σ of virtual depths: the points have no σ",
        "add a column std_nu, or state one σ for all points";
    /// The features of a corner contradict each other.
    CornersScatter "corners-scatter" { ratio: f64 } =>
        format!("the features of a corner scatter {ratio:.1} times as much about its point as their σ predicts"),
        "check that the features are of this camera, and that their indices count from 0 as in centers.csv";
    /// The arrays of two cameras are counted in different ways.
    CountedOtherwise "counted-otherwise" { first: String, second: String } =>
        format!("the cameras number their micro-lenses differently, the first on {first}, the second on {second}: they are compared by position, but cannot exchange features and centres"),
        NONE;
    /// Residuals are far larger than noise.
    BadFit "bad-fit" { rms_px: f64, micro_image_pitch_px: f64 } =>
        format!("the residuals of the features are {rms_px:.2} px RMS, a large part of the micro-image pitch ({micro_image_pitch_px:.1} px) and far above noise"),
        "check the board (columns, rows, square_mm), the sign of rho and the frames with large residuals";
    /// The camera does not explain the blur radii.
    UnexplainedBlur "unexplained-blur" { rms_px: f64, spread_px: f64 } =>
        format!("the residuals of the blur radii are {rms_px:.3} px RMS, but the radii vary only by {spread_px:.3} px: the camera does not explain them"),
        "check the sign of rho, the order of q', and that both belong to the same aperture ratio";
    /// The observations contradict a prior.
    PriorContradicted "prior-contradicted" { quantity: String, unit: &'static str, prior: Estimate, result: f64, source: String } =>
        prior_text(quantity, unit, prior, *result, source),
        prior_remedy(quantity);
    /// m of the white images and of the camera differ.
    SlopeContradicted "slope-contradicted" { error: f64 } =>
        format!("|m| of the white images and of the camera differ by {:.1} %: F, d and distances may be wrong by as much", 100.0 * error.abs()),
        "check the f-numbers (f_number), the pixel size (pixel_size_mm) and the size of the squares (square_mm)";
    /// Two lens types give different aperture ratios.
    ApertureRatiosDiffer "aperture-ratios-differ" { lens_types: [usize; 2], estimated: [Estimate; 2] } =>
        format!("the edges of lens type {} give an aperture ratio of {:.3} ± {:.3}, but type {} gives {:.3} ± {:.3}: all types have one ratio, so the focal lengths of both are biased", lens_types[0], estimated[0].value, estimated[0].std_dev, lens_types[1], estimated[1].value, estimated[1].std_dev),
        "check the white images, and that all files have the lens types in the same order";
    /// The board is bent so far that it should be replaced.
    WarpedBoard "warped-board" { bend_mm: f64, diagonal_mm: f64, estimated: bool } =>
        format!("the board is bent by {bend_mm:.2} mm, {:.1} % of its diagonal; its shape is {}, as a smooth bend that is the same in all frames", 100.0 * bend_mm / diagonal_mm, if *estimated { "estimated with the camera" } else { "taken as known" }),
        "use a flatter board";
    /// The squares of the board are oblong.
    StretchedBoard "stretched-board" { aspect: f64 } =>
        format!("the squares of the board are {:.1} % longer along {}: the mean of both sides is used, and an error of this mean scales F, d and all distances", 100.0 * aspect.abs(), if *aspect > 0.0 { "rows than along columns" } else { "columns than along rows" }),
        "measure both sides of the squares";
    /// The shape of the board could not be found, and it is taken to be flat.
    BoardShapeNotFound "board-shape-not-found" { reason: String } =>
        format!("the shape of the board could not be estimated, and a flat board is assumed: {reason}"),
        "if the board is flat, state it; otherwise check the board and the frames with large residuals";
    /// The shape of the board was found once, and refining it further failed.
    BoardShapeNotSettled "board-shape-not-settled" { reason: String } =>
        format!("the board is not flat; its shape is from a refinement with priors on a flat board, since a second one without these priors failed: {reason}"),
        "measure the shape of the board, and state it";
    /// The main lens is focused at another distance than stated.
    FocusDistance "focus-distance" { stated_mm: f64, by_boards_mm: f64 } =>
        format!("the boards show a focus distance of about {by_boards_mm:.0} mm instead of {stated_mm} mm; the calibration starts from it"),
        "check the focus distance (focus_distance_mm), the focal length (focal_length_mm) and the size of the squares (square_mm)";
    /// All boards are nearly parallel to the image plane.
    FrontoParallel "fronto-parallel" { largest_tilt_deg: f64 } =>
        format!("all boards are fronto-parallel (tilted by at most {largest_tilt_deg:.1} degrees): F and the distances of the boards can hardly be separated"),
        "add boards tilted by 20 to 40 degrees";

    // Residuals and coverage.

    /// Residuals are larger than the detection predicts.
    Scatter "scatter" { ratio: f64 } =>
        format!("the residuals are {ratio:.1} times as large as the detection predicts"),
        "check for images that are moved, blurred, sharpened, resized (pixel_size_mm) or at another f-number, and for frames of several cameras or focus settings";
    /// A frame does not fit the others.
    OutlyingFrame "outlying-frame" { frame: u32, residual_ratio: f64, parameter: Option<String>, std_devs: Option<f64>, unexpected: Option<f64> } =>
        outlying_frame_text(*residual_ratio, parameter.as_deref(), *std_devs, *unexpected),
        format!("exclude frame {frame}, or find out what moved");
    /// Features lie far from their projections.
    OutlyingFeatures "outlying-features" { outlying: usize, all: usize } =>
        format!("{outlying} of {all} features lie far from their projections"),
        "check these features in residuals.csv";
    /// The residuals have a pattern over the image.
    ImagePattern "image-pattern" { part: f64 } =>
        format!("the residuals have a systematic pattern over the image, {:.0} % of their size: the model is incomplete, or the board is not flat", 100.0 * part), NONE;
    /// The residuals grow with the distance from the centre of the micro-image.
    MicroImagePattern "micro-image-pattern" { part: f64 } =>
        format!("the residuals vary with the distance from the centre of the micro-image, by {:.0} % of their size: the corners are biased", 100.0 * part),
        "check for boards that are blurred, sharpened or at another f-number than the white images";
    /// One lens type has larger residuals than another.
    LensTypePattern "lens-type-pattern" { ratio: f64 } =>
        format!("the residuals of one lens type are {ratio:.1} times as large as of another"), NONE;
    /// Few frames.
    FewFrames "few-frames" { frames: usize } =>
        format!("{} cannot show the errors that all features of a frame share: σ treats all observations as independent", counted(*frames, "frame")),
        "take more frames";
    /// Few tilted boards.
    FewTilts "few-tilts" { tilted: usize, frames: usize } =>
        format!("only {tilted} of {frames} boards are tilted by more than 10 degrees: F and the distances of the boards can hardly be separated"),
        "add boards tilted by 20 to 40 degrees";
    /// All boards at nearly the same distance.
    OneDistance "one-distance" { ratio: f64 } =>
        format!("all boards are at nearly the same distance (the largest is {ratio:.2} times the smallest)"),
        "add boards at other distances";
    /// Boards in a part of the image only.
    Coverage "coverage" { part: f64 } =>
        format!("the boards cover only {:.0} % of the image", 100.0 * part),
        "add boards in the rest of the image";
    /// One frame has most of the information on a parameter.
    DominantFrame "dominant-frame" { frame: u32, parameter: String, share: f64 } =>
        format!("frame {frame} alone carries {:.0} % of the information on {parameter}", 100.0 * share),
        "add frames with similar poses";
    /// A parameter has a large σ.
    Uncertain "uncertain" { parameter: String, relative: f64 } =>
        format!("σ of {parameter} is {:.1} % of its value", 100.0 * relative),
        "add boards at other distances and tilts";

    // Evaluations.

    /// The poses of boards did not converge.
    PosesNotConverged "poses-not-converged" =>
        "the poses did not converge", NONE;
    /// No frame has enough points for a reconstruction.
    TooFewPoints "too-few-points" =>
        "no frame has enough points for a reconstruction", NONE;
    /// A model without some parameters did not converge.
    ModelNotConverged "model-not-converged" =>
        "the calibration has not converged; its results are from the last iteration", NONE;
    /// The moved board went the other way.
    StepsReversed "steps-reversed" =>
        "the board of the translation moved opposite to the sign of step_mm, which is negative towards the camera",
        "change the sign of step_mm, or the order of the images";
    /// One step of the moved board differs from the others.
    StepUneven "step-uneven" { from: u32, to: u32, ratio: f64 } =>
        format!("the step of the translation from frame {from} to {to} is {ratio:.2} times as long as the other steps"),
        "check whether an image is missing, repeated, or out of order";
    /// All steps of the moved board contradict the size of the squares.
    StepScale "step-scale" { ratio: f64, step_mm: f64, square_mm: f64 } =>
        step_scale_text(*ratio, *step_mm, *square_mm),
        "measure both, and correct one of them";
}

fn lens_types_text(white_px: &[f64], camera_px: &[f64], permuted: Option<&[usize]>) -> String {
    let row =
        |radii: &[f64]| radii.iter().map(|r| format!("{r:.2}")).collect::<Vec<_>>().join(", ");
    let order = permuted.map_or(String::new(), |order| {
        let order: Vec<String> = order.iter().map(ToString::to_string).collect();
        let order = order.join(", ");
        format!(": types {order} of the camera correspond to types 1, 2 … of the white images")
    });
    format!(
        "the blur radii of the lens types are {} px in the white images, but {} px in the camera{order}",
        row(white_px),
        row(camera_px)
    )
}

fn other_cost_text(problem: &str, differences: &[CostDifference]) -> String {
    let of = |d: &CostDifference| format!("{} in the problem, {} here", d.problem, d.here);
    let all: Vec<String> = differences.iter().map(of).collect();
    format!("the cost differs from the problem in {problem}: {}", all.join("; "))
}

/// Number of frames above which the others are only counted.
const MOST_LISTED: usize = 20;

/// Lists the numbers of frames, the first ones if there are many.
pub(crate) fn list(numbers: &[u32]) -> String {
    let first: Vec<String> = numbers.iter().take(MOST_LISTED).map(u32::to_string).collect();
    let more = numbers.len() - first.len();
    let and_more = if more > 0 { format!(" and {more} more") } else { String::new() };
    first.join(", ") + &and_more
}

fn prior_text(
    quantity: &str,
    unit: &'static str,
    prior: &Estimate,
    result: f64,
    source: &str,
) -> String {
    let (unit, factor) = display_unit(quantity, unit);
    let prior = prior.scaled(factor);
    let shown = Estimate::new(result * factor, prior.std_dev);
    let (result, _) = shown.text();
    format!(
        "{quantity} is {result} {unit}, but its prior is {prior} {unit} ({source}): they differ by {:+.1} σ",
        (shown.value - prior.value) / prior.std_dev
    )
}

/// Returns the remedy for a contradicted prior.
fn prior_remedy(quantity: &str) -> &'static str {
    match quantity {
        "F" | "D" => {
            "check the focal length (focal_length_mm), the size of the squares (square_mm), the \
             pixel size (pixel_size_mm) and, if stated, the position of the exit pupil"
        }
        "m" => {
            "check the f-numbers of the white images (f_number), the pixel size (pixel_size_mm), \
             the size of the squares (square_mm) and, if stated, the position of the exit pupil"
        }
        "u0" | "v0" => {
            "check whether the images are cropped; few tilted boards, or biased corners towards \
             the border, also shift the principal point"
        }
        "tilt_u" | "tilt_v" => {
            "check that the white images are of this camera and, if stated, the position of the \
             exit pupil; otherwise the corners are biased towards one side of the image"
        }
        _ => "check the value, its unit, and whether it applies to this camera and setting",
    }
}

/// Ratio of the residuals of a frame to the others' below which they are not mentioned.
const LARGER: f64 = 1.25;
/// Number of σ above which the σ of a parameter is meaningless, since it is hardly determined.
const MOST_STD_DEVS: f64 = 1e3;

fn outlying_frame_text(
    residual_ratio: f64,
    parameter: Option<&str>,
    std_devs: Option<f64>,
    unexpected: Option<f64>,
) -> String {
    let influence = parameter.zip(std_devs).zip(unexpected);
    let larger = residual_ratio > LARGER || influence.is_none();
    let mut reasons = Vec::new();
    if larger {
        reasons.push(format!(
            "its residuals are {residual_ratio:.1} times as large, as if board or camera had moved"
        ));
    }
    if let Some(((parameter, std_devs), unexpected)) = influence {
        reasons.push(if std_devs > MOST_STD_DEVS {
            format!("without it {parameter} is not determined")
        } else {
            format!(
                "without it {parameter} changes by {std_devs:.1} σ, {unexpected:.0} times as much as the other frames predict"
            )
        });
    }
    format!("it does not fit the other frames: {}", reasons.join(", and "))
}

fn step_scale_text(ratio: f64, step_mm: f64, square_mm: f64) -> String {
    format!(
        "the measured steps of the translation are {ratio:.3} times as long as stated: either the squares are {:.4} mm \
         instead of {square_mm} mm (square_mm), or the step is {:.4} mm instead of {step_mm} mm (step_mm)",
        square_mm / ratio,
        step_mm * ratio
    )
}

/// Lists the orientations of images.
fn orientations(groups: &[(u64, usize, String)]) -> String {
    let of = |(orientation, images, first): &(u64, usize, String)| {
        format!("orientation {orientation}: {}, first {first}", counted(*images, "image"))
    };
    groups.iter().map(of).collect::<Vec<_>>().join("; ")
}

fn maker_values_text(distortion: Option<&str>, rotation_rad: f64) -> String {
    let distortion = distortion.map(|function| format!("a distortion ({function})"));
    let rotation = (rotation_rad != 0.0)
        .then(|| format!("a rotation in addition to the lattice ({:.3} mrad)", 1e3 * rotation_rad));
    let values: Vec<String> = distortion.into_iter().chain(rotation).collect();
    format!(
        "the file states {}, which are not used: the errors of the centres grow with the distance from the middle of the image",
        values.join(" and ")
    )
}

#[cfg(test)]
mod tests {
    use std::collections::HashSet;

    use super::*;

    #[test]
    fn of_very_many_frames_the_first_are_listed() {
        assert_eq!(list(&[3, 7, 11]), "3, 7, 11");
        let all: Vec<u32> = (0..100_000).collect();
        let text = list(&all);
        assert!(text.starts_with("0, 1, 2, ") && text.ends_with(", 19 and 99980 more"), "{text}");
    }

    #[test]
    fn codes_are_unique_and_kebab_case() {
        let unique: HashSet<&&str> = Issue::CODES.iter().collect();
        assert_eq!(unique.len(), Issue::CODES.len());
        let is_kebab = |code: &&str| code.chars().all(|c| c.is_ascii_lowercase() || c == '-');
        assert!(Issue::CODES.iter().all(is_kebab));
    }

    #[test]
    fn a_finding_carries_code_severity_subject_values_text_and_remedy() {
        let finding =
            Finding::caution(Issue::MotionBlur { motion_px: 1.25 }).about_frame(3, Some("b3.png"));
        let begins = "frame 3 (b3.png): its edges are wider than in the other frames";
        assert!(finding.to_string().starts_with(begins), "{finding}");
        assert!(finding.to_string().ends_with("leave the frame out if it does not fit"));
        let document = serde_json::to_value(&finding).unwrap();
        assert_eq!(document["code"], "motion-blur");
        assert_eq!(document["severity"], "caution");
        assert_eq!(document["subject"]["frame"]["frame"], 3);
        assert_eq!(document["values"]["motion_px"], 1.25);
        assert!(!document["text"].as_str().unwrap().contains("hold board"));
        assert!(document["remedy"].as_str().unwrap().starts_with("hold board and camera still"));
    }

    #[test]
    fn the_heaviest_finding_is_first() {
        let of = |severity, weight| Finding::new(severity, Issue::NotConverged).weighing(weight);
        let mut all =
            [of(Severity::Note, 9.0), of(Severity::Caution, 1.0), of(Severity::Caution, 2.0)];
        sort(&mut all);
        let order = all.each_ref().map(|f| (f.severity, f.weight > 1.5));
        let expected =
            [(Severity::Caution, true), (Severity::Caution, false), (Severity::Note, true)];
        assert_eq!(order, expected);
        assert_eq!(worst(&all), Some(Severity::Caution));
        assert_eq!(worst(&[]), None);
    }

    #[test]
    fn frames_are_described_by_what_is_remarkable_about_them() {
        let moved = "its residuals are 2.0 times as large, as if board or camera had moved";
        let text = |ratio, std_devs: Option<f64>| {
            outlying_frame_text(ratio, std_devs.map(|_| "F"), std_devs, std_devs.map(|_| 6.2))
        };
        let begins = "it does not fit the other frames: ";
        assert_eq!(text(2.0, None), format!("{begins}{moved}"));
        let without = "without it F changes by 7.0 σ, 6 times as much as the other frames predict";
        assert_eq!(text(0.7, Some(7.0)), format!("{begins}{without}"));
        assert_eq!(text(2.0, Some(7.0)), format!("{begins}{moved}, and {without}"));
        assert_eq!(text(1.0, Some(1e9)), format!("{begins}without it F is not determined"));
    }
}
