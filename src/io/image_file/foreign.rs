//! Files with images that are not read, and how to save their images instead.

use std::path::Path;

use super::raw::{is_raw, not_stated};
use crate::error::{Error, Result};

const RECORDING: &str = "a recording of Raytrix, whose format is not published: export its raw image as PNG or TIFF \
     with the software of the maker, not processed";
const PHOTO: &str = "a raw file of a photo camera: convert all images to TIFF with 'dcraw -D -4 -T -t 0', without \
     demosaicing and scaling";
const LYTRO: &str = "a file of a Lytro camera: unpack its raw image, and save it as PNG or TIFF with 16 bits, not \
     demosaiced";
const ARRAY: &str = "a file of arrays: save the image in it as PNG or TIFF with 8 or 16 bits";

/// Extensions of files with images that are not read.
const ENDINGS: [(&[&str], &str); 4] = [
    (&["ray"], RECORDING),
    (&["dng", "nef", "cr2", "cr3", "arw", "raf", "orf", "rw2", "pef"], PHOTO),
    (&["lfp", "lfr"], LYTRO),
    (&["h5", "hdf5", "hdf", "fits", "fit", "fts", "npy", "npz", "mat"], ARRAY),
];
/// First bytes of such files: HDF5, FITS, `NumPy`, MATLAB, Lytro.
const BEGINNINGS: [(&[u8], &str); 5] = [
    (b"\x89HDF\r\n\x1a\n", ARRAY),
    (b"SIMPLE  =", ARRAY),
    (b"\x93NUMPY", ARRAY),
    (b"MATLAB 5.0", ARRAY),
    (b"\x89LFP", LYTRO),
];

/// Returns what a file is and what to do, by its extension, if its images are not read.
pub fn by_name(path: &Path) -> Option<&'static str> {
    let ending = path.extension().unwrap_or_default().to_string_lossy().to_lowercase();
    let found = ENDINGS.iter().find(|(endings, _)| endings.contains(&ending.as_str()));
    found.map(|(_, what)| *what)
}

/// Returns an error with a remedy for a file whose images are not read, by its extension or its first bytes.
pub fn check(path: &Path, head: &[u8]) -> Result<()> {
    let by_content = || BEGINNINGS.iter().find(|(begin, _)| head.starts_with(begin));
    if let Some(what) = by_name(path).or_else(|| by_content().map(|(_, what)| *what)) {
        return Err(Error::invalid(format!("this is {what}")));
    }
    if is_raw(path) && image::guess_format(head).is_err() {
        return Err(not_stated());
    }
    Ok(())
}
