//! `.xyz` point clouds as written by RxLive.

use std::path::Path;

use super::read_text;
use crate::error::{Error, Result};
use crate::numerics::median;

/// Separators of columns: blanks, commas or semicolons. Columns after the third are colours.
const SEPARATORS: [char; 3] = [' ', ',', ';'];

/// Reads the median z of a point cloud: lines of x, y, z and further columns. Lines that begin with `#` or `//` are comments,
/// and a first line of words is a header.
///
/// An error names a line that is not a point, or states that there are no points.
pub fn read_point_cloud_distance(path: &Path) -> Result<f64> {
    let text = read_text(path)?;
    let mut depths = Vec::new();
    for (number, line) in text.lines().enumerate() {
        let line = line.trim();
        if line.is_empty() || line.starts_with('#') || line.starts_with("//") {
            continue;
        }
        let mut columns = line
            .split(|c: char| SEPARATORS.contains(&c) || c.is_whitespace())
            .filter(|column| !column.is_empty());
        let z = columns.nth(2).and_then(|column| column.parse::<f64>().ok());
        match z {
            Some(z) if z.is_finite() => depths.push(z),
            // Points without a depth are skipped.
            Some(_) => {}
            None if number == 0 => {}
            None => {
                return Err(Error::content(
                    path,
                    format!("line {} is not a point x y z: '{line}'", number + 1),
                ));
            }
        }
    }
    median(depths).ok_or_else(|| Error::content(path, "it contains no points"))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_median_depth_is_read() {
        let folder = tempfile::TempDir::new().unwrap();
        let path = folder.path().join("cloud.xyz");
        let distance = |text: &str| {
            std::fs::write(&path, text).unwrap();
            read_point_cloud_distance(&path)
        };
        let is = |text: &str, mm: f64| (distance(text).unwrap() - mm).abs() < 1e-12;
        assert!(is("# c\n1 2 3 255 0 0\n1\t2  5\n\n1,2,-4.5\n", 3.0));
        assert!(is("x y z\n0 0 7\n0 0 nan\n", 7.0));
        assert!(distance("1 2 3\n1 2\n").unwrap_err().to_string().contains("line 2"));
        assert!(distance("").unwrap_err().to_string().contains("no points"));
    }
}
