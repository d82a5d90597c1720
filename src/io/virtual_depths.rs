//! Virtual depths of other software: CSV of single points, and maps.

use std::fmt;
use std::fs::File;
use std::io::{self, BufReader, Chain, Cursor, ErrorKind, Read};
use std::path::{Path, PathBuf};
use std::time::Instant;

use tracing::info;

use super::image_file::image_of;
use super::observations_file::read_virtual_rows;
use super::{open, record_read};
use crate::error::{Error, Result};
use crate::image::{Color, RawImage, Samples};
use crate::solver::VirtualPoint;

/// Map of virtual depths, read piece by piece: the whole map, with a point for each pixel of a large sensor, would take tens of
/// gigabytes.
#[derive(Debug)]
pub struct DepthMap {
    /// Columns, px.
    pub width: usize,
    /// Rows, px.
    pub height: usize,
    path: PathBuf,
    depths: Depths,
    /// Number of pixels read so far.
    read: usize,
}

enum Depths {
    /// Numbers of this size, bytes, in a file.
    Numbers(NpyFile, usize),
    /// Grey levels with offset and factor of their scale.
    Levels(RawImage, [f64; 2]),
}

/// File from its beginning, whose first bytes have already been read.
type NpyFile = BufReader<Chain<Cursor<Vec<u8>>, File>>;

impl fmt::Debug for Depths {
    fn fmt(&self, out: &mut fmt::Formatter) -> fmt::Result {
        out.write_str(match self {
            Self::Numbers(..) => "numbers",
            Self::Levels(..) => "levels",
        })
    }
}

impl DepthMap {
    /// Reads ν of the next pixels, row by row and at most `most`; NaN for a pixel without one. The result is empty after the
    /// last pixel.
    ///
    /// An error if the file has more or fewer numbers than its shape states.
    pub fn next(&mut self, most: usize) -> Result<Vec<f64>> {
        // An overflow of this product was refused when the header was read.
        let left = self.width * self.height - self.read;
        let count = most.min(left);
        let begin = self.read;
        self.read += count;
        match &mut self.depths {
            Depths::Numbers(file, size) => {
                let depths = next_numbers(file, *size, count, count == left);
                depths.map_err(|e| e.of_file(&self.path))
            }
            Depths::Levels(image, scale) => Ok(depths_of_levels(image, *scale, begin, count)),
        }
    }
}

/// Content of a file of virtual depths.
#[derive(Debug)]
pub enum VirtualDepths {
    /// One point in each line of a CSV file.
    Points(Vec<VirtualPoint>),
    /// Depths by pixel, from a `.npy` file of numbers or from an image.
    Map(DepthMap),
    /// Features in a CSV file without depths, from which points are triangulated.
    Features,
}

/// First bytes of a `.npy` file.
const NPY: &[u8] = b"\x93NUMPY";
/// Error for a table that has neither virtual depths nor features.
const NEITHER: &str = "this table has no column nu (virtual depths: k,l,u,v,nu) and no column cluster (features: \
                       k,l,u,v,cluster,frame)";
/// Error for an image without a scale.
const LEVELS: &str = "the scale of its grey levels is not known: give A and B, with virtual depth \
                      = A + B · grey level";
/// Error for an image with three channels.
const CHANNELS: &str = "this image has three channels, but a map of virtual depths needs one: save \
                        it with one channel";

/// Reads virtual depths. In an image, the depth is `scale[0]` + `scale[1]` times the grey level of the file, and level 0 means
/// no depth. `std_dev` (u, v and ν) replaces σ that a CSV file does not state.
///
/// An error states what is wrong in the file, or that it is an image without a given scale.
pub fn read_virtual_depths(
    path: &Path,
    scale: Option<[f64; 2]>,
    std_dev: [f64; 3],
) -> Result<VirtualDepths> {
    let begun = Instant::now();
    let unreadable = |source| Error::Read { path: path.to_owned(), source };
    let mut file = open(path).map_err(unreadable)?;
    let mut bytes = Vec::new();
    (&mut file).take(NPY.len() as u64).read_to_end(&mut bytes).map_err(unreadable)?;
    if bytes.starts_with(NPY) {
        let file = BufReader::new(Cursor::new(bytes).chain(file));
        return npy_map(path, file).map(VirtualDepths::Map).map_err(|e| e.of_file(path));
    }
    file.read_to_end(&mut bytes).map_err(unreadable)?;
    record_read(path, bytes.len() as u64, begun);
    let first_line = bytes.split(|b| *b == b'\n').next().unwrap_or_default();
    // The reader of CSV refuses other separators with a remedy.
    let names: Vec<&str> = std::str::from_utf8(first_line)
        .unwrap_or_default()
        .trim_start_matches('\u{feff}')
        .split([',', ';', '\t'])
        .map(str::trim)
        .collect();
    if names.contains(&"k") {
        if names.contains(&"nu") {
            return read_virtual_rows(path, &bytes, std_dev).map(VirtualDepths::Points);
        }
        if !names.contains(&"cluster") {
            return Err(Error::content(path, NEITHER));
        }
        return Ok(VirtualDepths::Features);
    }
    let image = image_of(&bytes, Some(Color::Grey)).map_err(|e| e.in_file(path))?;
    if image.color != Color::Grey {
        return Err(Error::content(path, CHANNELS));
    }
    let scale = scale.ok_or_else(|| Error::content(path, LEVELS))?;
    Ok(VirtualDepths::Map(DepthMap {
        width: image.width,
        height: image.height,
        path: path.to_owned(),
        depths: Depths::Levels(image, scale),
        read: 0,
    }))
}

fn depths_of_levels(
    image: &RawImage,
    [offset, factor]: [f64; 2],
    begin: usize,
    count: usize,
) -> Vec<f64> {
    let depth = |level: f64| if level > 0.0 { offset + factor * level } else { f64::NAN };
    let pixels = begin..begin + count;
    match &image.samples {
        Samples::Bits8(levels) => levels[pixels].iter().map(|l| depth(f64::from(*l))).collect(),
        Samples::Bits16(levels) => levels[pixels].iter().map(|l| depth(f64::from(*l))).collect(),
    }
}

/// Reason why a `.npy` file cannot be used.
enum NpyError {
    Read(io::Error),
    Content(&'static str),
}

impl NpyError {
    fn of_file(self, path: &Path) -> Error {
        match self {
            Self::Read(source) => Error::Read { path: path.to_owned(), source },
            Self::Content(what) => Error::content(path, format!("this .npy file {what}")),
        }
    }
}

impl From<io::Error> for NpyError {
    fn from(error: io::Error) -> Self {
        match error.kind() {
            ErrorKind::UnexpectedEof => Self::Content("is cut off: copy or save it again"),
            _ => Self::Read(error),
        }
    }
}

/// Largest size of the header, bytes.
const LONGEST_HEADER: usize = 1 << 16;

/// Opens the map in a `.npy` file with two dimensions, `<f4` or `<f8`, in C order.
fn npy_map(path: &Path, mut file: NpyFile) -> std::result::Result<DepthMap, NpyError> {
    let wrong = |what: &'static str| NpyError::Content(what);
    let mut begin = [0; 8];
    file.read_exact(&mut begin)?;
    let mut length = [0; 4];
    match begin[6] {
        1 => file.read_exact(&mut length[..2])?,
        2 | 3 => file.read_exact(&mut length)?,
        _ => return Err(wrong("has an unknown version: save it with numpy.save")),
    }
    let length = u32::from_le_bytes(length) as usize;
    if length > LONGEST_HEADER {
        return Err(wrong("has too long a header: save only the array, with numpy.save"));
    }
    let mut header = vec![0; length];
    file.read_exact(&mut header)?;
    let header = std::str::from_utf8(&header)
        .map_err(|_| wrong("has a header that is not text: save it again with numpy.save"))?;
    let value = |key: &str| {
        let at = header.find(&format!("'{key}':"))? + key.len() + 3;
        Some(header[at..].trim_start())
    };
    let size = match value("descr").unwrap_or_default() {
        kind if kind.starts_with("'<f4'") => 4,
        kind if kind.starts_with("'<f8'") => 8,
        _ => {
            return Err(wrong(
                "does not have floating-point numbers, '<f4' or '<f8': save depths.astype('<f4')",
            ));
        }
    };
    if !value("fortran_order").is_some_and(|order| order.starts_with("False")) {
        return Err(wrong("is in Fortran order: save numpy.ascontiguousarray of the array"));
    }
    let shape = value("shape").and_then(|shape| shape.strip_prefix('(')?.split_once(')'));
    let (shape, _) = shape.unwrap_or_default();
    // A comma may end the list.
    let sizes = shape.trim_end_matches([',', ' ']).split(',').map(|n| n.trim().parse().ok());
    let sizes: Option<Vec<usize>> = sizes.collect();
    let Some([height, width]) = sizes.as_deref() else {
        return Err(wrong(
            "does not have two dimensions, height and width: save one map, for example depths[0] \
             of a stack",
        ));
    };
    let bytes = width.checked_mul(*height).and_then(|count| count.checked_mul(size));
    match bytes {
        Some(1..) => {}
        Some(0) => return Err(wrong("has no pixels: save a map with pixels")),
        None => return Err(wrong(OTHER_SHAPE)),
    }
    info!("{} is read piece by piece: {width} x {height} numbers of {size} bytes", path.display());
    let depths = Depths::Numbers(file, size);
    Ok(DepthMap { width: *width, height: *height, path: path.to_owned(), depths, read: 0 })
}

const OTHER_SHAPE: &str =
    "does not have as many numbers as its shape says: copy it again, or save it with numpy.save";

/// Reads the next numbers of a file; an error if data follow the last ones.
fn next_numbers(
    file: &mut NpyFile,
    size: usize,
    count: usize,
    are_last: bool,
) -> std::result::Result<Vec<f64>, NpyError> {
    let mut bytes = Vec::new();
    file.by_ref().take((count * size) as u64).read_to_end(&mut bytes)?;
    if bytes.len() != count * size || (are_last && file.read(&mut [0])? > 0) {
        return Err(NpyError::Content(OTHER_SHAPE));
    }
    let number = |number: &[u8]| match number {
        [a, b, c, d] => f64::from(f32::from_le_bytes([*a, *b, *c, *d])),
        number => f64::from_le_bytes(number.try_into().unwrap_or_default()),
    };
    Ok(bytes.chunks_exact(size).map(number).collect())
}
