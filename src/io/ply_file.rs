//! `.ply`: point clouds with properties, in the binary form (Turk, *The PLY Polygon File Format*, 1994).

use std::io::{self, Seek, SeekFrom, Write};

/// Property of all points.
#[derive(Debug, Clone, PartialEq)]
pub enum PlyColumn<'a> {
    /// Floating-point numbers of 32 bits.
    Float(&'a str, Vec<f64>),
    /// Whole numbers of 32 bits.
    Int(&'a str, Vec<i32>),
}

impl PlyColumn<'_> {
    fn len(&self) -> usize {
        match self {
            Self::Float(_, values) => values.len(),
            Self::Int(_, values) => values.len(),
        }
    }

    fn property(&self) -> String {
        match self {
            Self::Float(name, _) => format!("property float {name}\n"),
            Self::Int(name, _) => format!("property int {name}\n"),
        }
    }
}

/// Writer of points piece by piece. Their number is known only at the end, when the header is written again.
#[derive(Debug)]
pub struct PlyWriter<W: Write + Seek> {
    out: W,
    comment: String,
    properties: Option<String>,
    /// Length of the header.
    length: usize,
    count: u64,
}

/// Digits of the number of points and blanks after the comment: the header keeps its length while the number grows.
const DIGITS: usize = 20;

impl<W: Write + Seek> PlyWriter<W> {
    /// Creates a writer.
    pub fn new(out: W, comment: &str) -> Self {
        Self { out, comment: comment.to_owned(), properties: None, length: 0, count: 0 }
    }

    fn header(&self) -> String {
        let (comment, count) = (&self.comment, self.count.to_string());
        let blanks = " ".repeat(DIGITS - count.len());
        format!(
            "ply\nformat binary_little_endian 1.0\ncomment {comment}{blanks}\nelement vertex {count}\n{}end_header\n",
            self.properties.as_deref().unwrap_or_default()
        )
    }

    /// Writes further points with these properties, including `x`, `y` and `z`. All columns have the same length, and all
    /// pieces the same names.
    pub fn write(&mut self, columns: &[PlyColumn]) -> io::Result<()> {
        if self.properties.is_none() {
            self.properties = Some(columns.iter().map(PlyColumn::property).collect());
            let header = self.header();
            self.length = header.len();
            self.out.write_all(header.as_bytes())?;
        }
        let count = columns.first().map_or(0, PlyColumn::len);
        for i in 0..count {
            for column in columns {
                let bytes = match column {
                    #[allow(clippy::cast_possible_truncation)] // as documented
                    PlyColumn::Float(_, values) => (values[i] as f32).to_le_bytes(),
                    PlyColumn::Int(_, values) => values[i].to_le_bytes(),
                };
                self.out.write_all(&bytes)?;
            }
        }
        self.count += count as u64;
        Ok(())
    }

    /// Returns the underlying output.
    pub fn get_ref(&self) -> &W {
        &self.out
    }

    /// Writes the number of points, and returns the underlying output, also with an error.
    pub fn finish(mut self) -> std::result::Result<W, (W, io::Error)> {
        match self.write_count() {
            Ok(()) => Ok(self.out),
            Err(error) => Err((self.out, error)),
        }
    }

    fn write_count(&mut self) -> io::Result<()> {
        let header = self.header();
        debug_assert!(
            self.count == 0 || header.len() == self.length,
            "points would be overwritten"
        );
        self.out.rewind()?;
        self.out.write_all(header.as_bytes())?;
        self.out.seek(SeekFrom::End(0)).map(|_| ())
    }
}

#[cfg(test)]
mod tests {
    use std::io::Cursor;

    use super::*;

    #[test]
    fn points_follow_their_header() {
        let mut ply = PlyWriter::new(Cursor::new(Vec::new()), "mm");
        for (x, frame) in [(vec![1.5, -2.0], vec![7, 8]), (vec![0.25; 10], vec![9; 10])] {
            ply.write(&[PlyColumn::Float("x", x), PlyColumn::Int("frame", frame)]).unwrap();
        }
        let bytes = ply.finish().unwrap().into_inner();
        let header = "ply\nformat binary_little_endian 1.0\ncomment mm                  \nelement vertex 12\n\
                      property float x\nproperty int frame\nend_header\n";
        assert_eq!(String::from_utf8_lossy(&bytes[..header.len()]), header);
        let data = &bytes[header.len()..];
        let expected: Vec<u8> = [1.5_f32.to_le_bytes(), 7_i32.to_le_bytes()]
            .concat()
            .into_iter()
            .chain([(-2.0_f32).to_le_bytes(), 8_i32.to_le_bytes()].concat())
            .chain([0.25_f32.to_le_bytes(), 9_i32.to_le_bytes()].concat().repeat(10))
            .collect();
        assert_eq!(data, expected);
    }
}
