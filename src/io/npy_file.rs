//! `.npy`: arrays in the format of NumPy, version 1.0
//! (<https://numpy.org/doc/stable/reference/generated/numpy.lib.format.html>).

use std::io::{self, Write};

/// Header that precedes the numbers of an array.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct NpyHeader(String);

/// Alignment of the header, bytes.
const ALIGNMENT: usize = 64;
const MAGIC: &[u8] = b"\x93NUMPY\x01\x00";

impl NpyHeader {
    /// Creates the header for floating-point numbers of 64 or 32 bits, little-endian, row by row.
    #[must_use]
    pub fn floats(double: bool, shape: &[usize]) -> Self {
        Self::of(if double { "<f8" } else { "<f4" }, shape)
    }

    /// Creates the header for whole numbers of 32 bits, little-endian, row by row.
    #[must_use]
    pub fn integers(shape: &[usize]) -> Self {
        Self::of("<i4", shape)
    }

    fn of(kind: &str, shape: &[usize]) -> Self {
        let sizes: Vec<String> = shape.iter().map(ToString::to_string).collect();
        let text = format!(
            "{{'descr': '{kind}', 'fortran_order': False, 'shape': ({},), }}",
            sizes.join(", ")
        );
        // The header includes the two bytes of its length and a final line break.
        let length = MAGIC.len() + 2 + text.len() + 1;
        let padding = " ".repeat(length.next_multiple_of(ALIGNMENT) - length);
        Self(format!("{text}{padding}\n"))
    }

    /// Writes the header; the caller writes the numbers.
    pub fn write(&self, out: &mut dyn Write) -> io::Result<()> {
        out.write_all(MAGIC)?;
        let length = u16::try_from(self.0.len()).map_err(io::Error::other)?;
        out.write_all(&length.to_le_bytes())?;
        out.write_all(self.0.as_bytes())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_header_is_as_the_format_has_it() {
        let mut bytes = Vec::new();
        NpyHeader::floats(false, &[3, 4, 6]).write(&mut bytes).unwrap();
        assert_eq!(&bytes[..8], b"\x93NUMPY\x01\x00");
        assert_eq!(bytes.len() % 64, 0);
        let length = usize::from(u16::from_le_bytes([bytes[8], bytes[9]]));
        assert_eq!(length, bytes.len() - 10);
        let text = std::str::from_utf8(&bytes[10..]).unwrap();
        assert!(
            text.starts_with("{'descr': '<f4', 'fortran_order': False, 'shape': (3, 4, 6,), } ")
        );
        assert!(text.ends_with('\n'));
    }
}
