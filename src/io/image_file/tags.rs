//! Tags of TIFF files, and of EXIF blocks of other files, which are TIFF files without an image
//! (<https://www.itu.int/itudoc/itu-t/com16/tiff-fx/docs/tiff6.pdf>, section 2).

use std::collections::HashSet;
use std::io::{Read, Seek, SeekFrom};

/// Numbers of tags.
pub mod tag {
    pub const SUBFILE_TYPE: u16 = 254;
    pub const WIDTH: u16 = 256;
    pub const HEIGHT: u16 = 257;
    pub const BITS: u16 = 258;
    pub const PHOTOMETRIC: u16 = 262;
    pub const ORIENTATION: u16 = 274;
    pub const SAMPLES_PER_PIXEL: u16 = 277;
    pub const COLOR_MAP: u16 = 320;
    pub const EXTRA_SAMPLES: u16 = 338;
    pub const SAMPLE_FORMAT: u16 = 339;
    pub const ICC_PROFILE: u16 = 34_675;
    pub const EXIF: u16 = 34_665;
    pub const EXIF_COLOR_SPACE: u16 = 40_961;
}

/// Largest number of pages; it limits the work for a damaged file.
const MOST_PAGES: usize = 100_000;
/// Largest size of a tag used here, bytes.
const LONGEST: u64 = 1 << 24;

/// Reader of the tags of a TIFF or `BigTIFF` file.
pub struct Tags<R> {
    file: R,
    big_endian: bool,
    /// True if offsets have 64 bits.
    wide: bool,
    /// Offset of the first page.
    first: u64,
}

/// Tag of a page.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Entry {
    tag: u16,
    kind: u16,
    count: u64,
    /// Offset of its value, or of the offset of the value.
    pub at: u64,
}

/// Tags of one page.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct Page(Vec<Entry>);

impl Page {
    /// Returns the tag with a number.
    pub fn entry(&self, tag: u16) -> Option<Entry> {
        self.0.iter().find(|entry| entry.tag == tag).copied()
    }
}

impl<R: Read + Seek> Tags<R> {
    /// Reads the header of a file; `None` if it is no TIFF file.
    pub fn of(file: R) -> Option<Self> {
        let mut tags = Self { file, big_endian: false, wide: false, first: 0 };
        let head = tags.bytes(0, 4)?;
        tags.big_endian = match &head[..2] {
            b"II" => false,
            b"MM" => true,
            _ => return None,
        };
        tags.first = match tags.number(&head[2..]) {
            42 => tags.number_at(4, 4)?,
            43 => {
                tags.wide = true;
                tags.number_at(8, 8)?
            }
            _ => return None,
        };
        Some(tags)
    }

    /// Reads the first page.
    pub fn first(&mut self) -> Option<Page> {
        self.page(self.first).map(|(page, _)| page)
    }

    /// Reads all pages that can be read.
    pub fn pages(&mut self) -> Vec<Page> {
        let (mut pages, mut seen, mut next) = (Vec::new(), HashSet::new(), self.first);
        while next != 0 && seen.insert(next) && pages.len() < MOST_PAGES {
            let Some((page, after)) = self.page(next) else { break };
            pages.push(page);
            next = after;
        }
        pages
    }

    /// Reads the page at the offset in a tag.
    pub fn page_at(&mut self, entry: Entry) -> Option<Page> {
        let offset = self.value(entry)?;
        self.page(offset).map(|(page, _)| page)
    }

    /// Reads the page at an offset, and returns the offset of the next one too.
    fn page(&mut self, offset: u64) -> Option<(Page, u64)> {
        let (counted, length, field) = if self.wide { (8, 20, 8) } else { (2, 12, 4) };
        let count = self.number_at(offset, counted)?;
        let begin = offset.checked_add(counted as u64)?;
        let size = count.checked_mul(length).filter(|size| *size <= LONGEST)?;
        let bytes = self.bytes(begin, usize::try_from(size).ok()?)?;
        let entries = bytes.chunks_exact(usize::try_from(length).ok()?).zip(0_u64..);
        let entry = |(bytes, i): (&[u8], u64)| Entry {
            tag: short(self.number(&bytes[..2])),
            kind: short(self.number(&bytes[2..4])),
            count: self.number(&bytes[4..4 + field]),
            at: begin + i * length + 4 + field as u64,
        };
        let page = Page(entries.map(entry).collect());
        // After the last page the offset may be missing.
        let next = self.number_at(begin + size, field).unwrap_or(0);
        Some((page, next))
    }

    /// Reads the first value of a tag of whole numbers.
    pub fn value(&mut self, entry: Entry) -> Option<u64> {
        self.values(entry)?.first().copied()
    }

    /// Reads the values of a tag of whole numbers.
    pub fn values(&mut self, entry: Entry) -> Option<Vec<u64>> {
        let size = size_of(entry.kind)?;
        let bytes = self.content(entry)?;
        Some(bytes.chunks_exact(size).map(|bytes| self.number(bytes)).collect())
    }

    /// Reads the bytes of a tag.
    pub fn content(&mut self, entry: Entry) -> Option<Vec<u8>> {
        let field = if self.wide { 8 } else { 4 };
        let size = entry.count.checked_mul(size_of(entry.kind)? as u64);
        let size = size.filter(|size| *size <= LONGEST)?;
        let at = if size <= field as u64 { entry.at } else { self.number_at(entry.at, field)? };
        self.bytes(at, usize::try_from(size).ok()?)
    }

    /// Returns the bytes of a number in the byte order of this file.
    pub fn encoded(&self, number: u16) -> [u8; 2] {
        if self.big_endian { number.to_be_bytes() } else { number.to_le_bytes() }
    }

    fn number_at(&mut self, at: u64, size: usize) -> Option<u64> {
        self.bytes(at, size).map(|bytes| self.number(&bytes))
    }

    fn number(&self, bytes: &[u8]) -> u64 {
        let add = |number: u64, byte: &u8| number << 8 | u64::from(*byte);
        if self.big_endian { bytes.iter().fold(0, add) } else { bytes.iter().rev().fold(0, add) }
    }

    fn bytes(&mut self, at: u64, size: usize) -> Option<Vec<u8>> {
        let end = self.file.seek(SeekFrom::End(0)).ok()?;
        if at.checked_add(size as u64)? > end {
            return None;
        }
        let mut bytes = vec![0; size];
        self.file.seek(SeekFrom::Start(at)).ok()?;
        self.file.read_exact(&mut bytes).ok()?;
        Some(bytes)
    }
}

/// Converts the number or the kind of a tag, which has two bytes.
fn short(number: u64) -> u16 {
    u16::try_from(number).unwrap_or_default()
}

/// Returns the size of a value of a kind, bytes; `None` unless the kind is a whole number or untyped bytes.
fn size_of(kind: u16) -> Option<usize> {
    match kind {
        1 | 2 | 6 | 7 => Some(1),
        3 | 8 => Some(2),
        4 | 9 | 13 => Some(4),
        16..=18 => Some(8),
        _ => None,
    }
}
