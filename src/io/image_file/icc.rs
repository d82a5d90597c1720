//! ICC profiles: declared tone curves of samples (ICC.1:2022, sections 7 and 10).

/// Tags of the tone curves from samples to light: red, green, blue and grey.
const CURVES: [&[u8]; 4] = [b"rTRC", b"gTRC", b"bTRC", b"kTRC"];
/// Offset of the table of tags, and size of one of its entries, bytes.
const TABLE: usize = 128;
const ENTRY: usize = 12;
/// Largest number of tags.
const MOST: usize = 100;
/// Largest deviation of a straight curve from a straight line, as a fraction of full scale.
const STRAIGHT: f64 = 0.01;

/// Describes the tone curve of a profile, such as "ICC profile sRGB"; `None` if it is linear or not stated.
pub fn curve(profile: &[u8]) -> Option<String> {
    let count = number(profile, TABLE)?.min(MOST);
    let tag = |i: usize| -> Option<&[u8]> {
        let at = TABLE + 4 + i * ENTRY;
        let name = profile.get(at..at + 4)?;
        let (offset, size) = (number(profile, at + 4)?, number(profile, at + 8)?);
        let content = profile.get(offset..offset.checked_add(size)?)?;
        CURVES.contains(&name).then_some(content)
    };
    let curve = (0..count).filter_map(tag).find_map(bent)?;
    let wide: Vec<u8> = b"sRGB".iter().flat_map(|letter| [0, *letter]).collect();
    let names_srgb = [b"sRGB", &wide[..]]
        .iter()
        .any(|name| profile.windows(name.len()).any(|found| found == *name));
    Some(format!("ICC profile {}", if names_srgb { "sRGB" } else { &curve }))
}

/// Describes a curve that is not straight; `None` if it is straight.
fn bent(curve: &[u8]) -> Option<String> {
    let tone_curve = || "with a tone curve".to_owned();
    let power =
        |gamma: f64| ((gamma - 1.0).abs() > STRAIGHT).then(|| format!("with gamma {gamma:.2}"));
    match curve.get(..4)? {
        b"curv" => {
            let count = number(curve, 8)?;
            let values = curve.get(12..)?.chunks_exact(2).take(count);
            let values: Vec<f64> =
                values.map(|v| f64::from(u16::from_be_bytes([v[0], v[1]]))).collect();
            match values[..] {
                [] => None,
                [gamma] => power(gamma / 256.0),
                _ => {
                    let last = (values.len() - 1) as f64;
                    let off = |(i, value): (usize, &f64)| i as f64 / last - value / 65_535.0;
                    let is_bent = values.iter().enumerate().any(|at| off(at).abs() > STRAIGHT);
                    is_bent.then(tone_curve)
                }
            }
        }
        b"para" => {
            let kind = u16::from_be_bytes(*curve.get(8..)?.first_chunk()?);
            let gamma = i32::from_be_bytes(*curve.get(12..)?.first_chunk()?);
            let gamma = power(f64::from(gamma) / 65_536.0)?;
            Some(if kind == 0 { gamma } else { tone_curve() })
        }
        _ => None,
    }
}

fn number(bytes: &[u8], at: usize) -> Option<usize> {
    usize::try_from(u32::from_be_bytes(*bytes.get(at..)?.first_chunk()?)).ok()
}
