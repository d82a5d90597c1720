//! `.ply`: point clouds with properties, in the binary form (Turk, *The PLY Polygon File Format*, 1994).

use std::io::{self, Write};

/// A property of all points.
#[derive(Debug, Clone, PartialEq)]
pub enum PlyColumn<'a> {
    /// Numbers of 32 bits.
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
}

/// Writes points with these properties, `x`, `y` and `z` among them; all have the same length.
pub fn write_ply(out: &mut dyn Write, comment: &str, columns: &[PlyColumn]) -> io::Result<()> {
    let count = columns.first().map_or(0, PlyColumn::len);
    writeln!(
        out,
        "ply\nformat binary_little_endian 1.0\ncomment {comment}\nelement vertex {count}"
    )?;
    for column in columns {
        match column {
            PlyColumn::Float(name, _) => writeln!(out, "property float {name}")?,
            PlyColumn::Int(name, _) => writeln!(out, "property int {name}")?,
        }
    }
    writeln!(out, "end_header")?;
    for i in 0..count {
        for column in columns {
            match column {
                #[allow(clippy::cast_possible_truncation)] // as documented
                PlyColumn::Float(_, values) => out.write_all(&(values[i] as f32).to_le_bytes())?,
                PlyColumn::Int(_, values) => out.write_all(&values[i].to_le_bytes())?,
            }
        }
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn points_follow_their_header() {
        let mut bytes = Vec::new();
        let columns = [PlyColumn::Float("x", vec![1.5, -2.0]), PlyColumn::Int("frame", vec![7, 8])];
        write_ply(&mut bytes, "mm", &columns).unwrap();
        let header = "ply\nformat binary_little_endian 1.0\ncomment mm\nelement vertex 2\nproperty float x\n\
                      property int frame\nend_header\n";
        assert!(bytes.starts_with(header.as_bytes()));
        let data = &bytes[header.len()..];
        let expected: Vec<u8> = [1.5_f32.to_le_bytes(), 7_i32.to_le_bytes()]
            .concat()
            .into_iter()
            .chain([(-2.0_f32).to_le_bytes(), 8_i32.to_le_bytes()].concat())
            .collect();
        assert_eq!(data, expected);
    }
}
