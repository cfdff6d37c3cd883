//! GeographicLib's tables: a binary PGM with two bytes a node, the higher first.
//!
//! The header is `P5`, comments of which `# Offset A` and `# Scale B` are needed, columns, rows and
//! 65535. Rows come from the north pole to the south pole, each from 0° to the east:
//! N = A + B·value (m).
//!
//! Source: Karney, *GeographicLib*, Geoid height, "The format of the geoid data files".

use std::io::{BufRead, Read};

use crate::gnss::{Geoid, GeoidGrid};

use super::{GeoidError, checked, from_north, nodes};

/// Longest line of the header (bytes), and most lines.
const LINE_MAX: usize = 1000;
const LINES_MAX: usize = 100;
/// The largest value of two bytes.
const VALUE_MAX: usize = 65_535;
/// Heights of any geoid are between these (m), and so is the offset.
const HEIGHT_MAX_M: f64 = 1000.0;

/// What the header says.
struct Header {
    offset_m: f64,
    scale_m: f64,
    columns: usize,
    rows: usize,
    /// Size of the header (bytes).
    bytes: u64,
    /// Number of its lines.
    lines: usize,
}

/// Reads a table.
pub(super) fn read(mut input: impl BufRead) -> Result<Geoid, GeoidError> {
    let header = Header::read(&mut input)?;
    let Header { offset_m, scale_m, columns, rows, bytes, lines } = header;
    let wrong = |message| GeoidError::Line { line: lines, message };
    let grid = GeoidGrid {
        south_deg: -90.0,
        west_deg: 0.0,
        latitude_step_deg: 180.0 / rows.saturating_sub(1).max(1) as f64,
        longitude_step_deg: 360.0 / columns.max(1) as f64,
        rows,
        columns,
    };
    let count = checked(&grid).map_err(wrong)?;
    let height_m = |node| (offset_m + scale_m * f64::from(u16::from_be_bytes(node))) as f32;
    let heights_m = from_north(nodes(&mut input, (count, bytes), height_m)?, columns);
    Ok(Geoid::new(grid, heights_m).expect("the grid is valid, and has as many nodes"))
}

impl Header {
    fn read(input: &mut impl BufRead) -> Result<Self, GeoidError> {
        let (mut offset_m, mut scale_m) = (None, None);
        let (mut numbers, mut bytes) = (Vec::new(), 0);
        for line in 1..=LINES_MAX {
            let wrong = |message: &str| GeoidError::Line { line, message: message.to_owned() };
            let mut text = Vec::new();
            bytes += input.by_ref().take(LINE_MAX as u64).read_until(b'\n', &mut text)? as u64;
            if text.pop() != Some(b'\n') {
                return Err(wrong("the header ends here, or the line is too long"));
            }
            let text = String::from_utf8_lossy(&text);
            let words: Vec<&str> = text.split_whitespace().collect();
            match (line, &words[..]) {
                (1, ["P5"]) => {}
                (1, _) => return Err(wrong("the first line is not P5")),
                (_, ["#", "Offset", value]) => {
                    let value = value.parse().ok().filter(|m: &f64| m.abs() <= HEIGHT_MAX_M);
                    offset_m = Some(value.ok_or_else(|| wrong("the offset is not a height"))?);
                }
                (_, ["#", "Scale", value]) => {
                    let value = value.parse().ok().filter(|m: &f64| 0.0 < *m && *m <= 1.0);
                    scale_m = Some(value.ok_or_else(|| wrong("the scale is not up to 1 m"))?);
                }
                (_, ["#", "Origin", origin @ ..]) if !matches!(origin, ["90N", "0E"]) => {
                    return Err(wrong("the table does not begin at 90N 0E"));
                }
                (_, []) => {}
                (_, [first, ..]) if first.starts_with('#') => {}
                (_, words) => {
                    let parsed: Result<Vec<usize>, _> = words.iter().map(|w| w.parse()).collect();
                    numbers.extend(parsed.map_err(|_| wrong("these are not whole numbers"))?);
                }
            }
            match (&numbers[..], offset_m, scale_m) {
                ([columns, rows, VALUE_MAX], Some(offset_m), Some(scale_m)) => {
                    let (columns, rows, lines) = (*columns, *rows, line);
                    return Ok(Self { offset_m, scale_m, columns, rows, bytes, lines });
                }
                ([_, _, VALUE_MAX], ..) => return Err(wrong("no Offset or no Scale is before it")),
                ([_, _, _, ..], ..) => return Err(wrong("the largest value is not 65535")),
                _ => {}
            }
        }
        let message = format!("the header is not complete after {LINES_MAX} lines");
        Err(GeoidError::Line { line: LINES_MAX, message })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::gnss::Geodetic;

    const HEAD: &str = "P5\n# Geoid file in PGM format\n# Offset -108\n# Scale 0.003\n\
                        # Origin 90N 0E\n4 3\n65535\n";

    /// Columns at 0°, 90°, 180°, 270°; rows at 90°, 0°, −90°.
    const VALUES: [u16; 12] =
        [40_000, 40_000, 40_000, 40_000, 1000, 2000, 3000, 4000, 500, 500, 500, 500];

    fn file(head: &str, values: &[u16]) -> Vec<u8> {
        let nodes = values.iter().flat_map(|value| value.to_be_bytes());
        head.bytes().chain(nodes).collect()
    }

    fn refusal(bytes: &[u8]) -> String {
        read(bytes).unwrap_err().to_string()
    }

    /// −108 m + 0.003 m·40 000 = 12 m at the north pole; at 0° N 90° E −108 m + 6 m = −102 m; at
    /// 45° N 315° E halfway between 12 m and the mean of −96 m (4000) and −105 m (1000): −44.25 m.
    #[test]
    fn heights_worked_by_hand() {
        let geoid = read(&file(HEAD, &VALUES)[..]).unwrap();
        for (latitude, longitude, height_m) in
            [(90.0, 33.0, 12.0), (0.0, 90.0, -102.0), (45.0, -45.0, -44.25), (-90.0, 0.0, -106.5)]
        {
            let found = geoid.height_m(&Geodetic::from_degrees(latitude, longitude, 0.0)).unwrap();
            assert!((found - height_m).abs() < 1e-5, "{latitude}, {longitude}: {found}");
        }
    }

    #[test]
    fn damage_is_named_by_line_or_byte() {
        let whole = file(HEAD, &VALUES);
        let cut = refusal(&whole[..whole.len() - 1]);
        assert_eq!(cut, format!("byte {}: the file ends after 11 of 12 nodes", whole.len() - 1));
        let longer = refusal(&[&whole[..], b"\n"].concat());
        assert_eq!(longer, format!("byte {}: more bytes follow the 12 nodes", whole.len()));
        for (from, to, message) in [
            ("P5", "P6", "line 1: the first line is not P5"),
            ("-108", "-1e8", "line 3: the offset is not a height"),
            ("0.003", "0", "line 4: the scale is not up to 1 m"),
            ("90N 0E", "90N 180W", "line 5: the table does not begin at 90N 0E"),
            ("4 3", "4 x", "line 6: these are not whole numbers"),
            ("65535", "255", "line 7: the largest value is not 65535"),
            ("# Scale", "# Scales", "line 7: no Offset or no Scale is before it"),
            ("4 3", "4 1", "line 7: 1 rows of 4 nodes with these steps are not on Earth"),
            (
                "4 3",
                "40000 20001",
                "line 7: 20001 rows of 40000 nodes are more than 40000000 together",
            ),
        ] {
            let changed = HEAD.replacen(from, to, 1);
            assert_eq!(refusal(&file(&changed, &VALUES)), message, "{from} {to}");
        }
        let endless = ["P5\n".to_owned(), "# a comment\n".repeat(200)].concat();
        assert_eq!(
            refusal(endless.as_bytes()),
            "line 100: the header is not complete after 100 lines"
        );
        let long = ["P5\n#".to_owned(), "x".repeat(2000)].concat();
        assert!(refusal(long.as_bytes()).starts_with("line 2: the header ends here"));
    }
}
