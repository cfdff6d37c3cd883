//! GTX, the grids of NOAA's VDatum that PROJ reads: big endian throughout.
//!
//! The header has 40 bytes: latitude and longitude of the south-western node, the steps of latitude
//! and longitude (degrees, four numbers of eight bytes), and the numbers of rows and columns (four
//! bytes each). The nodes follow, numbers of four bytes (m), row by row from the south, each from
//! the west; −88.8888 where there is no height.
//!
//! Source: NOAA, *VDatum*, "gtx format"; PROJ, *Vertical grid shift*.

use std::io::BufRead;

use crate::gnss::{Geoid, GeoidGrid};

use super::{GeoidError, block, checked, nodes};

const HEADER_BYTES: usize = 40;
/// Where the numbers of rows and columns are (byte).
const COUNTS: usize = 32;
/// A node without height (m).
const NO_HEIGHT_M: f32 = -88.8888;
/// Its rounding.
const NO_HEIGHT_ROUNDING_M: f32 = 1e-4;
/// No geoid is farther from the ellipsoid (m).
const HEIGHT_MAX_M: f32 = 1000.0;

/// Reads a table.
pub(super) fn read(mut input: impl BufRead) -> Result<Geoid, GeoidError> {
    let header = block(&mut input, HEADER_BYTES)?;
    let wrong = |byte: usize, message| GeoidError::Byte { byte: byte as u64, message };
    let Ok(header) = <[u8; HEADER_BYTES]>::try_from(&header[..]) else {
        return Err(wrong(header.len(), "the file ends within a header of GTX".to_owned()));
    };
    let (numbers, _) = header[..COUNTS].as_chunks::<8>();
    let (counts, _) = header[COUNTS..].as_chunks::<4>();
    let number = |index: usize| f64::from_be_bytes(numbers[index]);
    let count = |index: usize| usize::try_from(i32::from_be_bytes(counts[index])).unwrap_or(0);
    let grid = GeoidGrid {
        south_deg: number(0),
        west_deg: number(1),
        latitude_step_deg: number(2),
        longitude_step_deg: number(3),
        rows: count(0),
        columns: count(1),
    };
    let count = checked(&grid).map_err(|message| wrong(0, message))?;
    let heights_m = nodes(&mut input, (count, HEADER_BYTES as u64), |node| {
        let height_m = f32::from_be_bytes(node);
        let is_none = (height_m - NO_HEIGHT_M).abs() < NO_HEIGHT_ROUNDING_M;
        if is_none { f32::NAN } else { height_m }
    })?;
    if let Some(node) = heights_m.iter().position(|height_m| HEIGHT_MAX_M < height_m.abs()) {
        let message = format!("{} m is not the height of a geoid", heights_m[node]);
        return Err(wrong(HEADER_BYTES + 4 * node, message));
    }
    Ok(Geoid::new(grid, heights_m).expect("the grid is valid, and has as many nodes"))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::gnss::Geodetic;

    fn file(numbers: [f64; 4], counts: [i32; 2], heights_m: &[f32]) -> Vec<u8> {
        let numbers = numbers.iter().flat_map(|number| number.to_be_bytes());
        let counts = counts.iter().flat_map(|count| count.to_be_bytes());
        let nodes = heights_m.iter().flat_map(|height_m| height_m.to_be_bytes());
        numbers.chain(counts).chain(nodes).collect()
    }

    const CORNER: [f64; 4] = [47.0, 8.0, 0.5, 1.0];
    const HEIGHTS_M: [f32; 6] = [46.0, 47.0, 48.0, 50.0, 51.0, -88.8888];

    fn refusal(bytes: &[u8]) -> String {
        read(bytes).unwrap_err().to_string()
    }

    /// Rows at 47° and 47.5° N, columns at 8°, 9° and 10° E. In the middle of the first four nodes
    /// is their mean, (46 + 47 + 50 + 51)/4 = 48.5 m; the last node is none.
    #[test]
    fn heights_worked_by_hand() {
        let geoid = read(&file(CORNER, [2, 3], &HEIGHTS_M)[..]).unwrap();
        let at =
            |latitude, longitude| geoid.height_m(&Geodetic::from_degrees(latitude, longitude, 0.0));
        for (latitude, longitude, height_m) in
            [(47.25, 8.5, 48.5), (47.0, 8.0, 46.0), (47.5, 8.5, 50.5)]
        {
            let found = at(latitude, longitude).unwrap();
            assert!((found - height_m).abs() < 1e-6, "{latitude}, {longitude}: {found}");
        }
        assert_eq!([at(47.25, 9.5), at(46.9, 8.5), at(47.25, 7.9), at(47.25, 188.5)], [None; 4]);
    }

    #[test]
    fn damage_is_named_by_byte() {
        let whole = file(CORNER, [2, 3], &HEIGHTS_M);
        assert_eq!(refusal(&whole[..39]), "byte 39: the file ends within a header of GTX");
        assert_eq!(refusal(&whole[..50]), "byte 50: the file ends after 2 of 6 nodes");
        let longer = refusal(&[&whole[..], &[0; 4]].concat());
        assert_eq!(longer, "byte 64: more bytes follow the 6 nodes");
        let high = file(CORNER, [2, 3], &[46.0, 1e20, 46.0, 46.0, 46.0, 46.0]);
        assert!(refusal(&high).starts_with("byte 44: 100000000"), "{}", refusal(&high));
        for (numbers, counts) in [
            ([f64::NAN, 8.0, 0.5, 1.0], [2, 3]),
            ([47.0, 8.0, -0.5, 1.0], [2, 3]),
            ([47.0, 8.0, 0.5, 300.0], [2, 3]),
            ([90.0, 8.0, 0.5, 1.0], [2, 3]),
            (CORNER, [-2, 3]),
            (CORNER, [i32::MAX, i32::MAX]),
        ] {
            let refused = refusal(&file(numbers, counts, &HEIGHTS_M));
            assert!(refused.starts_with("byte 0: "), "{refused}");
        }
    }
}
