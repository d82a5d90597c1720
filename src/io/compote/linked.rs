//! COMPOTE's binary observations: a gzip stream of three sections, centres, corners and features,
//! each a little-endian u64 count followed by packed records.

use std::io::Read;

use flate2::read::MultiGzDecoder;

use crate::error::{Error, Result};
use crate::model::{BapFeature, MicroImageCenter, Observations};

/// Bytes of a centre (k, l: i32; u, v: f64).
const CENTER_BYTES: usize = 24;
/// Bytes of a corner or feature (k, l: i32; u, v, rho: f64; cluster, frame: i32).
const FEATURE_BYTES: usize = 40;
/// Largest number of bytes after decompression; a larger file is damaged or hostile.
const MAX_BYTES: u64 = 1 << 28;

/// Returns true if the bytes begin like a gzip stream.
pub(in crate::io) fn is_linked_observations(bytes: &[u8]) -> bool {
    bytes.starts_with(&[0x1f, 0x8b])
}

/// Reads the observations in a gzip stream.
pub(in crate::io) fn linked_observations(bytes: &[u8]) -> Result<Observations> {
    let mut data = Vec::new();
    MultiGzDecoder::new(bytes).take(MAX_BYTES + 1).read_to_end(&mut data).map_err(|e| {
        Error::invalid(format!("the gzip stream is damaged or cut short ({e}); copy it again"))
    })?;
    if data.len() as u64 > MAX_BYTES {
        return Err(Error::invalid(format!(
            "it unpacks to more than {} MB, the limit for observations",
            MAX_BYTES >> 20
        )));
    }
    sections(&data)
}

/// Reads centres, corners and features.
fn sections(data: &[u8]) -> Result<Observations> {
    let mut rest = data;
    let centers: Vec<MicroImageCenter> = section(&mut rest, "centres", CENTER_BYTES, |r| {
        Ok(MicroImageCenter {
            k: i32_at(r, 0),
            l: i32_at(r, 4),
            u_px: f64_at(r, 8)?,
            v_px: f64_at(r, 16)?,
            std_dev_px: None,
        })
    })?;
    let feature = |r: &[u8]| {
        let frame = i32_at(r, 36);
        Ok(BapFeature {
            k: i32_at(r, 0),
            l: i32_at(r, 4),
            u_px: f64_at(r, 8)?,
            v_px: f64_at(r, 16)?,
            rho_px: Some(f64_at(r, 24)?),
            std_dev_px: None,
            rho_std_dev_px: None,
            correlation: 0.0,
            sensitivities_px: None,
            blur: None,
            corner: i32_at(r, 32),
            frame: u32::try_from(frame)
                .map_err(|_| Error::invalid(format!("a feature has the frame number {frame}")))?,
        })
    };
    let corners = section(&mut rest, "corners", FEATURE_BYTES, feature)?;
    if !corners.is_empty() {
        return Err(Error::invalid(format!(
            "{} features have no board corner: give linked features (COMPOTE's .bin.gz)",
            corners.len()
        )));
    }
    let features = section(&mut rest, "features", FEATURE_BYTES, feature)?;
    if !rest.is_empty() {
        return Err(Error::invalid(format!(
            "{} bytes follow the last section: this is not a file of linked observations",
            rest.len()
        )));
    }
    Ok(Observations { centers, features, ..Observations::default() })
}

fn section<T>(
    rest: &mut &[u8],
    name: &str,
    record_bytes: usize,
    parse: impl Fn(&[u8]) -> Result<T>,
) -> Result<Vec<T>> {
    let short = || Error::invalid(format!("the file ends within the section of {name}"));
    let (count, after) = rest.split_first_chunk::<8>().ok_or_else(short)?;
    let size = usize::try_from(u64::from_le_bytes(*count))
        .ok()
        .and_then(|count| count.checked_mul(record_bytes))
        .filter(|&size| size <= after.len())
        .ok_or_else(short)?;
    let (records, after) = after.split_at(size);
    *rest = after;
    records.chunks_exact(record_bytes).map(parse).collect()
}

fn bytes_at<const N: usize>(record: &[u8], offset: usize) -> [u8; N] {
    std::array::from_fn(|i| record[offset + i])
}

fn i32_at(record: &[u8], offset: usize) -> i32 {
    i32::from_le_bytes(bytes_at(record, offset))
}

/// Reads a number; an error if it is not finite.
fn f64_at(record: &[u8], offset: usize) -> Result<f64> {
    let value = f64::from_le_bytes(bytes_at(record, offset));
    if value.is_finite() {
        return Ok(value);
    }
    Err(Error::invalid(format!(
        "the observation of micro-image ({}, {}) contains {value}, which is not a finite number",
        i32_at(record, 0),
        i32_at(record, 4)
    )))
}
