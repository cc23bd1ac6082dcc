//! Numbers of bytes as people write them: `500M`, `20G`, and back, in powers of 1024.

/// Suffixes and what they multiply by.
const UNITS: [(&str, u64); 5] = [("", 1), ("K", 1 << 10), ("M", 1 << 20), ("G", 1 << 30), ("T", 1 << 40)];

/// A number of bytes.
pub fn parse(text: &str) -> Result<u64, String> {
    let wrong = || format!("`{text}` is no size; write a number and perhaps K, M, G or T, for example 20G");
    let upper = text.trim().to_ascii_uppercase();
    let plain = upper.strip_suffix("IB").or(upper.strip_suffix('B')).unwrap_or(&upper);
    let digits = plain.trim_end_matches(|c: char| c.is_ascii_alphabetic());
    let unit = UNITS.iter().find(|(name, _)| *name == &plain[digits.len()..]).ok_or_else(wrong)?;
    let number: f64 = digits.trim().parse().map_err(|_| wrong())?;
    let bytes = number * unit.1 as f64;
    if (0.0..=9e18).contains(&bytes) { Ok(bytes as u64) } else { Err(wrong()) }
}

/// A number of bytes to three digits.
pub fn show(bytes: u64) -> String {
    let (name, unit) = UNITS.iter().rev().find(|(_, unit)| bytes >= *unit).copied().unwrap_or(UNITS[0]);
    let value = bytes as f64 / unit as f64;
    match name {
        "" => format!("{bytes} B"),
        _ if value < 10.0 => format!("{value:.2} {name}iB"),
        _ if value < 100.0 => format!("{value:.1} {name}iB"),
        _ => format!("{value:.0} {name}iB"),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sizes_are_read_and_shown() {
        for (text, bytes) in
            [("0", 0), ("17", 17), ("1k", 1024), ("20G", 20 << 30), ("1.5 MiB", 3 << 19), ("2TB", 2 << 40)]
        {
            assert_eq!(parse(text), Ok(bytes), "{text}");
        }
        for text in ["", "G", "-1", "1X", "nan", "1e30T", "inf", "é"] {
            assert!(parse(text).is_err(), "{text}");
        }
        let shown = [0, 1023, 1024, 1 << 20, 15 << 20, 500 << 20, 20 << 30].map(show);
        assert_eq!(shown, ["0 B", "1023 B", "1.00 KiB", "1.00 MiB", "15.0 MiB", "500 MiB", "20.0 GiB"]);
    }
}
