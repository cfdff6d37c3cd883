//! ISG, the text format of the International Service for the Geoid, version 1 and 2: grids in
//! latitude and longitude.
//!
//! The header is between `begin_of_head` and `end_of_head`, with lines `key = value` or
//! `key : value`. Needed are `lat min`, `lat max`, `lon min`, `lon max`, `delta lat` and
//! `delta lon`, in degrees or as `35°00'30"`, `nrows` and `ncols`; `nodata` is the value of a node
//! without height. Then come the nodes (m), row by row from the north, each from the west.
//!
//! The limits are those of the outer nodes where they hold one node more than steps, as in version
//! 1 and in some files of version 2. Where they hold as many nodes as steps, the nodes are in the
//! centres of the cells, half a step inside.
//!
//! Source: ISG, *Format specification of ISG ASCII format*, versions 1.0 and 2.0.

use std::collections::HashMap;
use std::io::{BufRead, Read};

use crate::gnss::{Geoid, GeoidGrid};

use super::{GeoidError, checked, from_north};

/// Longest line (bytes), and most lines of the header and before it.
const LINE_MAX: usize = 1 << 20;
const HEADER_LINES_MAX: usize = 500;
const BEGIN: &str = "begin_of_head";
const END: &str = "end_of_head";
/// Largest difference between limits and steps, in steps.
const ROUNDING: f64 = 1e-3;
/// No geoid is farther from the ellipsoid (m).
const HEIGHT_MAX_M: f64 = 1000.0;

/// Whether bytes can begin such a file: text, with comments or the header.
pub(super) fn is_text(head: &[u8]) -> bool {
    let is_plain = |byte: &u8| matches!(byte, b'\t' | b'\n' | b'\r' | 0x20..=0x7e | 0x80..);
    let letters = head.iter().filter(|byte| byte.is_ascii_alphabetic()).count();
    head.iter().all(is_plain) && head.len() < 4 * letters.max(2)
}

/// The lines of a file with their numbers, from 1.
struct Lines<R> {
    input: R,
    number: usize,
}

impl<R: BufRead> Lines<R> {
    /// The next line; `None` at the end.
    fn next(&mut self) -> Result<Option<String>, GeoidError> {
        let mut bytes = Vec::new();
        self.number += 1;
        self.input.by_ref().take(LINE_MAX as u64 + 1).read_until(b'\n', &mut bytes)?;
        if LINE_MAX < bytes.len() {
            return Err(self.wrong("the line is too long"));
        }
        Ok((!bytes.is_empty()).then(|| String::from_utf8_lossy(&bytes).trim().to_owned()))
    }

    fn wrong(&self, message: &str) -> GeoidError {
        GeoidError::Line { line: self.number, message: message.to_owned() }
    }
}

/// Reads a table.
pub(super) fn read(input: impl BufRead) -> Result<Geoid, GeoidError> {
    let mut lines = Lines { input, number: 0 };
    let header = header(&mut lines)?;
    let grid = grid(&header).map_err(|message| lines.wrong(&message))?;
    let count = checked(&grid).map_err(|message| lines.wrong(&message))?;
    let no_height_m = header.get("nodata").and_then(|text| text.parse::<f64>().ok());
    let mut heights_m = Vec::new();
    while let Some(line) = lines.next()? {
        for text in line.split_whitespace() {
            let number = text.parse::<f64>().ok().filter(|number| number.is_finite());
            let number = number.ok_or_else(|| lines.wrong("this is not a row of numbers"))?;
            let is_none = no_height_m == Some(number);
            if !is_none && HEIGHT_MAX_M < number.abs() {
                return Err(lines.wrong(&format!("{number} m is not the height of a geoid")));
            }
            if heights_m.len() == count {
                return Err(lines.wrong(&format!("more numbers follow the {count} nodes")));
            }
            heights_m.push(if is_none { f32::NAN } else { number as f32 });
        }
    }
    if heights_m.len() != count {
        let message = format!("the file ends after {} of {count} nodes", heights_m.len());
        return Err(lines.wrong(&message));
    }
    let heights_m = from_north(heights_m, grid.columns);
    Ok(Geoid::new(grid, heights_m).expect("the grid is valid, and has as many nodes"))
}

/// The keys and values of the header.
fn header<R: BufRead>(lines: &mut Lines<R>) -> Result<HashMap<String, String>, GeoidError> {
    let (mut header, mut has_begun) = (HashMap::new(), false);
    while lines.number < HEADER_LINES_MAX {
        let Some(line) = lines.next()? else { break };
        if line.starts_with(END) && has_begun {
            return Ok(header);
        }
        if line.starts_with(BEGIN) {
            has_begun = true;
        } else if has_begun && let Some((key, value)) = line.split_once(['=', ':']) {
            header.insert(key.trim().to_lowercase(), value.trim().to_owned());
        }
    }
    Err(lines.wrong("there is no header from begin_of_head to end_of_head before it"))
}

/// The grid of a header, or what is wrong.
fn grid(header: &HashMap<String, String>) -> Result<GeoidGrid, String> {
    let text = |key: &str| {
        header.get(key).map(String::as_str).ok_or_else(|| format!("the header has no {key:?}"))
    };
    let degrees = |key: &str| {
        degrees(text(key)?).ok_or_else(|| format!("{key:?} is not an angle in degrees"))
    };
    let count = |key: &str| {
        text(key)?.parse::<usize>().map_err(|_| format!("{key:?} is not a whole number"))
    };
    for (key, needed) in [
        ("data format", "grid"),
        ("coord type", "geodetic"),
        ("data ordering", "n-to-s, w-to-e"),
        ("data units", "meters"),
    ] {
        if header.get(key).is_some_and(|value| value.to_lowercase() != needed) {
            return Err(format!("{key:?} is not {needed}, which is all that is read"));
        }
    }
    let (rows, columns) = (count("nrows")?, count("ncols")?);
    let (latitude_step_deg, longitude_step_deg) = (degrees("delta lat")?, degrees("delta lon")?);
    let limits =
        [degrees("lat min")?, degrees("lat max")?, degrees("lon min")?, degrees("lon max")?];
    let [south_deg, north_deg, west_deg, east_deg] = limits;
    let first = |(from, to): (f64, f64), step: f64, nodes: usize| {
        let steps = (to - from) / step - nodes as f64;
        match steps {
            _ if (steps + 1.0).abs() < ROUNDING => Some(from),
            _ if steps.abs() < ROUNDING => Some(from + step / 2.0),
            _ => None,
        }
    };
    let disagree = |key: &str| format!("{key:?}, its step and the number of nodes do not agree");
    Ok(GeoidGrid {
        south_deg: first((south_deg, north_deg), latitude_step_deg, rows)
            .ok_or_else(|| disagree("lat max"))?,
        west_deg: first((west_deg, east_deg), longitude_step_deg, columns)
            .ok_or_else(|| disagree("lon max"))?,
        latitude_step_deg,
        longitude_step_deg,
        rows,
        columns,
    })
}

/// Reads degrees as `35.5` or `35°30'00"`, with a sign (degrees).
fn degrees(text: &str) -> Option<f64> {
    if let Ok(degrees) = text.parse() {
        return Some(degrees);
    }
    let (sign, rest) = text.strip_prefix('-').map_or((1.0, text), |rest| (-1.0, rest));
    let parts = rest.split(['°', '\'', '"']).map(str::trim).filter(|part| !part.is_empty());
    let numbers: Vec<f64> = parts.map(|part| part.parse().ok()).collect::<Option<_>>()?;
    let is_part = |part: &f64| (0.0..60.0).contains(part);
    match numbers[..] {
        [degrees, minutes, seconds]
            if rest.contains('°') && is_part(&minutes) && is_part(&seconds) =>
        {
            Some(sign * (degrees + minutes / 60.0 + seconds / 3600.0))
        }
        _ => None,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::gnss::Geodetic;

    /// Rows at 36° and 35° N, columns at 139°, 140° and 141° E; one node without height.
    const FILE: &str = "A comment before the header\n\
        begin_of_head ===\n\
        model name     : Test\n\
        data format    : grid\n\
        coord type     : geodetic\n\
        lat min        =  35°00'00\"\n\
        lat max        =  36°00'00\"\n\
        lon min        = 139°00'00\"\n\
        lon max        = 141°00'00\"\n\
        delta lat      =   1°00'00\"\n\
        delta lon      =   1°00'00\"\n\
        nrows          =  2\n\
        ncols          =  3\n\
        nodata         = -9999.0000\n\
        ISG format     =  2.0\n\
        end_of_head ===\n\
        40.0 42.0 -9999.0000\n\
        30.0 32.0 36.0\n";

    fn at(geoid: &Geoid, latitude: f64, longitude: f64) -> Option<f64> {
        geoid.height_m(&Geodetic::from_degrees(latitude, longitude, 0.0))
    }

    fn refusal(text: &str) -> String {
        read(text.as_bytes()).unwrap_err().to_string()
    }

    /// The mean of 30, 32, 40 and 42 is 36.
    #[test]
    fn heights_worked_by_hand() {
        let geoid = read(FILE.as_bytes()).unwrap();
        assert!((at(&geoid, 35.5, 139.5).unwrap() - 36.0).abs() < 1e-9);
        assert!((at(&geoid, 36.0, 139.0).unwrap() - 40.0).abs() < 1e-9);
        assert_eq!(at(&geoid, 35.5, 140.5), None);
    }

    /// Version 1 writes degrees; where as many steps as nodes are between the limits, the nodes are
    /// in the middle of the cells.
    #[test]
    fn limits_are_of_nodes_or_of_cells() {
        let text = FILE
            .replace("36°00'00\"", "37.0000")
            .replace("141°00'00\"", "142")
            .replace("ISG format     =  2.0", "ISG format     =  1.0");
        let geoid = read(text.as_bytes()).unwrap();
        assert!((at(&geoid, 36.5, 139.5).unwrap() - 40.0).abs() < 1e-9);
        assert!((at(&geoid, 35.5, 141.5).unwrap() - 36.0).abs() < 1e-9);
        assert_eq!(at(&geoid, 35.2, 139.5), None);
    }

    #[test]
    fn angles_have_a_sign_for_all_parts() {
        assert_eq!(degrees("-16°30'36\""), Some(-16.51));
        assert_eq!(degrees("-0.25"), Some(-0.25));
        for wrong in ["", "x", "1°", "1°60'00\"", "1'2\"", "1°-2'3\"", "1 2 3"] {
            assert_eq!(degrees(wrong), None, "{wrong}");
        }
    }

    #[test]
    fn damage_is_named_by_line() {
        for (from, to, message) in [
            ("end_of_head", "end", "line 19: there is no header"),
            ("lat max ", "latmax ", "line 16: the header has no \"lat max\""),
            (
                "36°00",
                "38°00",
                "line 16: \"lat max\", its step and the number of nodes do not agree",
            ),
            ("nrows          =  2", "nrows = two", "line 16: \"nrows\" is not a whole number"),
            ("  1°00'00\"", "  0", "line 16: \"lat max\", its step"),
            ("geodetic", "projected", "line 16: \"coord type\" is not geodetic"),
            ("42.0", "4z", "line 17: this is not a row of numbers"),
            ("42.0", "4200", "line 17: 4200 m is not the height of a geoid"),
            ("36.0", "36.0 1.0", "line 18: more numbers follow the 6 nodes"),
            ("36.0\n", "", "line 19: the file ends after 5 of 6 nodes"),
        ] {
            let refused = refusal(&FILE.replacen(from, to, 1));
            assert!(refused.starts_with(message), "{from} {to}: {refused}");
        }
    }
}
