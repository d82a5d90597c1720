//! What files that were written may not have: numbers that are not finite where there has to be one.

use std::path::Path;

use crate::hostile::verdict::not_finite;

/// Checks a file of a command by its kind.
pub fn check(name: &Path, bytes: &[u8]) -> Result<(), String> {
    let file = name.file_name().unwrap_or_default().to_string_lossy();
    match name.extension().and_then(|extension| extension.to_str()) {
        Some("ply") => check_ply(bytes),
        Some("npy") if file == "rays.npy" => check_rays(bytes),
        Some("json" | "js") => {
            let parsed = serde_json::from_slice::<serde_json::Value>(bytes);
            parsed.map(|_| ()).map_err(|e| format!("no JSON: {e}"))
        }
        Some("csv" | "svg" | "html" | "toml") => {
            let text = std::str::from_utf8(bytes).map_err(|e| format!("no text: {e}"))?;
            check_text(&file, text)
        }
        _ => Ok(()),
    }
    .map_err(|e| format!("{}: {e}", name.display()))
}

/// Checks a text.
pub fn check_text(name: &str, text: &str) -> Result<(), String> {
    let found = not_finite(text);
    found.map_or(Ok(()), |found| Err(format!("not a finite number in {name}: {found}")))
}

/// Points are finite, and as many as the header says.
fn check_ply(bytes: &[u8]) -> Result<(), String> {
    const END: &[u8] = b"end_header\n";
    let begin = bytes.windows(END.len()).position(|part| part == END).ok_or("no header")?;
    let header = std::str::from_utf8(&bytes[..begin]).map_err(|e| e.to_string())?;
    let floats: Vec<bool> = header
        .lines()
        .filter_map(|line| line.strip_prefix("property "))
        .map(|property| property.starts_with("float"))
        .collect();
    let count = header.lines().find_map(|line| line.strip_prefix("element vertex "));
    let count: usize = count.and_then(|n| n.parse().ok()).ok_or("no number of points")?;
    let numbers = bytes[begin + END.len()..].chunks(4);
    if numbers.len() != count * floats.len() {
        return Err(format!("{count} points of {} numbers are {}", floats.len(), numbers.len()));
    }
    for (number, is_float) in numbers.zip(floats.iter().cycle()) {
        let number = f32::from_le_bytes(number.try_into().map_err(|_| "it is cut off")?);
        if *is_float && !number.is_finite() {
            return Err(format!("a point with {number}"));
        }
    }
    Ok(())
}

/// A ray is of six finite numbers, or of none.
fn check_rays(bytes: &[u8]) -> Result<(), String> {
    let length = bytes.get(8..10).ok_or("no header")?;
    let begin = 10 + usize::from(u16::from_le_bytes([length[0], length[1]]));
    let (header, data) = bytes.split_at_checked(begin).ok_or("no header")?;
    let double = header.windows(3).any(|part| part == b"<f8");
    let numbers: Vec<f64> = if double {
        let number = |b: &[u8]| f64::from_le_bytes(b.try_into().unwrap_or_default());
        data.chunks(8).map(number).collect()
    } else {
        let number = |b: &[u8]| f32::from_le_bytes(b.try_into().unwrap_or_default());
        data.chunks(4).map(|b| f64::from(number(b))).collect()
    };
    for ray in numbers.chunks(6) {
        let finite = ray.iter().filter(|number| number.is_finite()).count();
        let length: f64 = ray.iter().skip(3).map(|x| x * x).sum();
        if ![0, 6].contains(&finite) || (finite == 6 && (length - 1.0).abs() > 1e-5) {
            return Err(format!("not a ray: {ray:?}"));
        }
    }
    Ok(())
}
