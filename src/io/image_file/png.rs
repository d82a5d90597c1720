//! Chunks of PNG files (<https://www.w3.org/TR/png/>).

/// First bytes of a PNG file.
const MAGIC: &[u8] = b"\x89PNG\r\n\x1a\n";

/// Returns names and contents of the complete chunks, in order.
pub fn chunks(bytes: &[u8]) -> impl Iterator<Item = ([u8; 4], &[u8])> {
    let mut rest = bytes.strip_prefix(MAGIC).unwrap_or_default();
    std::iter::from_fn(move || {
        let (length, after) = rest.split_first_chunk::<4>()?;
        let (name, after) = after.split_first_chunk::<4>()?;
        let length = usize::try_from(u32::from_be_bytes(*length)).ok()?;
        let (content, after) = after.split_at_checked(length)?;
        // Skips the checksum.
        let (_, after) = after.split_first_chunk::<4>()?;
        rest = after;
        Some((*name, content))
    })
}

/// Returns true if the file contains its last chunk.
pub fn is_whole(bytes: &[u8]) -> bool {
    chunks(bytes).any(|(name, _)| &name == b"IEND")
}
