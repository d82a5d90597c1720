//! Chunks of PNG files (<https://www.w3.org/TR/png/>).

/// What a PNG file begins with.
const MAGIC: &[u8] = b"\x89PNG\r\n\x1a\n";

/// Names and contents of the chunks that are whole, in order.
pub fn chunks(bytes: &[u8]) -> impl Iterator<Item = ([u8; 4], &[u8])> {
    let mut rest = bytes.strip_prefix(MAGIC).unwrap_or_default();
    std::iter::from_fn(move || {
        let (length, after) = rest.split_first_chunk::<4>()?;
        let (name, after) = after.split_first_chunk::<4>()?;
        let length = usize::try_from(u32::from_be_bytes(*length)).ok()?;
        let (content, after) = after.split_at_checked(length)?;
        // The checksum.
        let (_, after) = after.split_first_chunk::<4>()?;
        rest = after;
        Some((*name, content))
    })
}

/// Whether the file goes on to its last chunk.
pub fn is_whole(bytes: &[u8]) -> bool {
    chunks(bytes).any(|(name, _)| &name == b"IEND")
}
