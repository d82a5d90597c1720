//! Completeness of the scans of JPEG files, from their Huffman codes (ITU-T T.81, annexes A and F).
//!
//! Decoders fill missing blocks with grey, as browsers do: a board would silently lose corners, and a white image micro-images.
//! Here codes are counted, and no sample is computed.

use super::jpeg::{Segment, segments};

const TABLES: u8 = 0xc4;
const RESTART_INTERVAL: u8 = 0xdd;
const START_OF_SCAN: u8 = 0xda;
/// Markers of frames with one pass over the image; only their scans are read here.
const SEQUENTIAL: [u8; 2] = [0xc0, 0xc1];
/// Number of samples along the edge of a block, and in a block.
const EDGE: usize = 8;
const BLOCK: usize = 64;
const LONGEST_CODE: usize = 16;
/// Symbols for a run of 16 zeros, and for the end of a block.
const ZEROS: u8 = 0xf0;
const END_OF_BLOCK: u8 = 0;

/// Symbols and lengths of codes, by the 16 bits that begin with a code; the length is 0 if no code fits.
type Table = Vec<(u8, u8)>;

/// Component of the image.
#[derive(Clone, Copy)]
struct Component {
    id: u8,
    /// Number of its blocks along u and along v in a unit of all components.
    blocks: [usize; 2],
}

#[derive(Default)]
struct State {
    size: [usize; 2],
    components: Vec<Component>,
    /// Tables of the first coefficient of blocks and of the others.
    tables: [[Table; 4]; 2],
    restart_interval: usize,
}

/// Returns true if the scans of a file contain all blocks of the image. Files with several passes over the image, and files
/// that are not understood, also return true: they are left to the decoder.
pub fn are_complete(bytes: &[u8]) -> bool {
    let mut state = State::default();
    for segment in segments(bytes) {
        let Segment { marker, content, after } = segment;
        let understood = match marker {
            TABLES => state.read_tables(content),
            RESTART_INTERVAL => state.read_interval(content),
            START_OF_SCAN if state.components.is_empty() => None,
            START_OF_SCAN => match state.scan(content) {
                Some(scan) if !scan.is_complete(after, state.restart_interval) => return false,
                Some(_) => Some(()),
                None => None,
            },
            frame if SEQUENTIAL.contains(&frame) => state.read_frame(content),
            _ => Some(()),
        };
        if understood.is_none() {
            return true;
        }
    }
    true
}

impl State {
    fn read_frame(&mut self, content: &[u8]) -> Option<()> {
        let edge = |at: usize| -> Option<usize> {
            Some(usize::from(u16::from_be_bytes(*content.get(at..)?.first_chunk()?)))
        };
        self.size = [edge(3)?, edge(1)?];
        let component = |c: &[u8]| Component {
            id: c[0],
            blocks: [usize::from(c[1] >> 4).max(1), usize::from(c[1] & 15).max(1)],
        };
        let count = usize::from(*content.get(5)?);
        self.components = content.get(6..6 + 3 * count)?.chunks_exact(3).map(component).collect();
        // The height may be stated in a later segment.
        self.size.iter().all(|edge| *edge > 0).then_some(())
    }

    fn read_interval(&mut self, content: &[u8]) -> Option<()> {
        self.restart_interval = usize::from(u16::from_be_bytes(*content.first_chunk()?));
        Some(())
    }

    fn read_tables(&mut self, mut content: &[u8]) -> Option<()> {
        while let Some((kind, after)) = content.split_first() {
            let (counts, after) = after.split_first_chunk::<LONGEST_CODE>()?;
            let count = counts.iter().map(|n| usize::from(*n)).sum();
            let (symbols, after) = after.split_at_checked(count)?;
            content = after;
            let place = self.tables.get_mut(usize::from(kind >> 4))?;
            *place.get_mut(usize::from(kind & 15))? = table(counts, symbols)?;
        }
        Some(())
    }

    /// Returns the tables of each block of a unit, and the number of units.
    fn scan(&self, content: &[u8]) -> Option<Scan<'_>> {
        let count = usize::from(*content.first()?);
        let largest = |axis: usize| self.components.iter().map(|c| c.blocks[axis]).max();
        let largest = [largest(0)?, largest(1)?];
        let mut blocks = Vec::new();
        let mut alone = largest;
        for chosen in content.get(1..1 + 2 * count)?.chunks_exact(2) {
            let component = self.components.iter().find(|c| c.id == chosen[0])?;
            let [dc, ac] = [chosen[1] >> 4, chosen[1] & 15].map(usize::from);
            let tables = [self.tables[0].get(dc)?, self.tables[1].get(ac)?];
            if tables.iter().any(|table| table.is_empty()) {
                return None;
            }
            alone = component.blocks;
            let of_unit = if count == 1 { 1 } else { component.blocks.iter().product() };
            blocks.extend(std::iter::repeat_n(tables, of_unit));
        }
        let along = |axis: usize| {
            if count == 1 {
                (self.size[axis] * alone[axis]).div_ceil(largest[axis]).div_ceil(EDGE)
            } else {
                self.size[axis].div_ceil(EDGE * largest[axis])
            }
        };
        Some(Scan { blocks, units: along(0) * along(1) })
    }
}

/// Fills the table with all sequences of 16 bits that begin with a code.
fn table(counts: &[u8; LONGEST_CODE], symbols: &[u8]) -> Option<Table> {
    let mut table = vec![(0, 0); 1 << LONGEST_CODE];
    let (mut code, mut next) = (0_usize, symbols.iter());
    for (length, count) in (1..).zip(counts) {
        for _ in 0..*count {
            let shift = LONGEST_CODE - length;
            let place = table.get_mut(code << shift..(code + 1) << shift)?;
            place.fill((*next.next()?, u8::try_from(length).ok()?));
            code += 1;
        }
        code <<= 1;
    }
    Some(table)
}

struct Scan<'a> {
    /// Tables of each block of a unit.
    blocks: Vec<[&'a Table; 2]>,
    units: usize,
}

impl Scan<'_> {
    fn is_complete(&self, data: &[u8], restart_interval: usize) -> bool {
        let mut bits = Bits { data, held: 0, count: 0 };
        for unit in 0..self.units {
            if restart_interval > 0 && unit > 0 && unit % restart_interval == 0 && !bits.restart() {
                return false;
            }
            if self.blocks.iter().any(|tables| pass_block(&mut bits, tables).is_none()) {
                return false;
            }
        }
        true
    }
}

/// Skips a block; `None` if its codes end early or are invalid.
fn pass_block(bits: &mut Bits, [dc, ac]: &[&Table; 2]) -> Option<()> {
    let size = bits.symbol(dc)?;
    bits.pass(size.into())?;
    let mut at = 1;
    while at < BLOCK {
        match bits.symbol(ac)? {
            END_OF_BLOCK => break,
            ZEROS => at += 16,
            // The end of several blocks at once, which does not occur in a file of one pass.
            symbol if symbol % 16 == 0 => return None,
            symbol => {
                at += usize::from(symbol >> 4) + 1;
                bits.pass((symbol & 15).into())?;
            }
        }
    }
    Some(())
}

/// Bits of a scan, up to the next marker.
struct Bits<'a> {
    data: &'a [u8],
    held: u64,
    count: usize,
}

impl Bits<'_> {
    fn fill(&mut self) {
        while self.count <= 48 {
            let byte = match self.data {
                [0xff, 0, rest @ ..] => {
                    self.data = rest;
                    0xff
                }
                [0xff, ..] | [] => return,
                [byte, rest @ ..] => {
                    self.data = rest;
                    *byte
                }
            };
            self.held = self.held << 8 | u64::from(byte);
            self.count += 8;
        }
    }

    fn symbol(&mut self, table: &Table) -> Option<u8> {
        if self.count < LONGEST_CODE {
            self.fill();
        }
        // Missing bits are set to 1, since no code consists of ones alone.
        let next = if self.count >= LONGEST_CODE {
            self.held >> (self.count - LONGEST_CODE)
        } else {
            let missing = LONGEST_CODE - self.count;
            self.held << missing | ((1 << missing) - 1)
        };
        let (symbol, length) = table[usize::try_from(next & 0xffff).unwrap_or_default()];
        self.count = self.count.checked_sub(length.into()).filter(|_| length > 0)?;
        Some(symbol)
    }

    fn pass(&mut self, bits: usize) -> Option<()> {
        if self.count < bits {
            self.fill();
        }
        self.count = self.count.checked_sub(bits)?;
        Some(())
    }

    /// Continues after a restart marker; returns false if there is none.
    fn restart(&mut self) -> bool {
        // All bits read so far belong to the interval before, since `fill` stops at a marker.
        self.fill();
        (self.held, self.count) = (0, 0);
        while let [0xff, 0xff, rest @ ..] = self.data {
            self.data = &self.data[..rest.len() + 2][1..];
        }
        match self.data {
            [0xff, 0xd0..=0xd7, rest @ ..] => {
                self.data = rest;
                true
            }
            _ => false,
        }
    }
}
