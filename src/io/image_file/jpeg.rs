//! Segments of JPEG files (ITU-T T.81, annex B).

/// First bytes of a JPEG file.
pub const MAGIC: &[u8] = &[0xff, 0xd8];
const END_OF_IMAGE: u8 = 0xd9;
const START_OF_SCAN: u8 = 0xda;

/// Marker with its content.
#[derive(Clone, Copy)]
pub struct Segment<'a> {
    pub marker: u8,
    pub content: &'a [u8],
    /// Rest of the file after the segment.
    pub after: &'a [u8],
}

/// Returns the complete segments, including the end of the image. Data between them, the scans, are skipped.
pub fn segments(bytes: &[u8]) -> impl Iterator<Item = Segment<'_>> {
    let mut rest = bytes.strip_prefix(MAGIC).unwrap_or_default();
    std::iter::from_fn(move || {
        loop {
            let at = rest.windows(2).position(|pair| pair[0] == 0xff && pair[1] != 0xff)?;
            let (&marker, after) = rest[at + 1..].split_first()?;
            let (content, after) = match marker {
                // Escaped bytes 255 of a scan, and markers without content.
                0x00 | 0x01 | 0xd0..=0xd8 => {
                    rest = after;
                    continue;
                }
                END_OF_IMAGE => (&after[..0], &after[..0]),
                _ => {
                    let length = usize::from(u16::from_be_bytes(*after.first_chunk()?));
                    let (content, after) = after.split_at_checked(length.max(2))?;
                    (&content[2..], after)
                }
            };
            rest = after;
            return Some(Segment { marker, content, after });
        }
    })
}

/// Returns the segments before the first scan.
pub fn header(bytes: &[u8]) -> impl Iterator<Item = Segment<'_>> {
    segments(bytes).take_while(|segment| segment.marker != START_OF_SCAN)
}

/// Returns true if the file contains the end of the image.
pub fn is_whole(bytes: &[u8]) -> bool {
    segments(bytes).any(|segment| segment.marker == END_OF_IMAGE)
}
