//! Tables of the geoid's heights, in the plain formats that are in use; content decides which.
//!
//! - **PGM** of GeographicLib: `egm84-15.pgm` to `egm2008-2_5.pgm`, the whole Earth.
//! - **GTX** of NOAA's VDatum and PROJ: `egm96_15.gtx`, and regions.
//! - **ISG**, version 1 and 2, of the International Service for the Geoid: grids in latitude and
//!   longitude.
//!
//! A table is kept in memory, four bytes a node. Tables of more than 40 million nodes are
//! refused: the finest that is read of the whole Earth has 2.5'.

mod gtx;
mod isg;
mod pgm;

use std::io::{self, BufRead, Cursor, Read};

use crate::gnss::{Geoid, GeoidGrid};

/// Most nodes of a table: 160 MB.
const NODES_MAX: usize = 40_000_000;

/// Bytes at the beginning that tell the format.
const HEAD_BYTES: usize = 256;

/// Why a table cannot be read.
#[derive(Debug, thiserror::Error)]
pub enum GeoidError {
    /// The input fails.
    #[error("{0}")]
    Unreadable(#[from] io::Error),
    /// The content is none of the formats.
    #[error("it is no table of the geoid: neither PGM nor GTX nor ISG")]
    Unknown,
    /// A line of text is wrong.
    #[error("line {line}: {message}")]
    Line {
        /// Number of the line, from 1.
        line: usize,
        /// What is wrong.
        message: String,
    },
    /// Bytes are wrong.
    #[error("byte {byte}: {message}")]
    Byte {
        /// Number of bytes before them.
        byte: u64,
        /// What is wrong.
        message: String,
    },
}

/// Reads a table in one of the formats.
///
/// # Errors
/// The input fails, is none of the formats, is damaged, or has too many nodes.
pub fn read(mut input: impl BufRead) -> Result<Geoid, GeoidError> {
    // A buffer may have fewer bytes, as that of a file that may have been packed.
    let head = block(&mut input, HEAD_BYTES)?;
    let whole = Cursor::new(head.clone()).chain(input);
    match &head[..] {
        [b'P', b'5', ..] => pgm::read(whole),
        head if isg::is_text(head) => isg::read(whole),
        // GTX has no mark.
        [_, _, _, _, _, _, _, _, ..] => gtx::read(whole),
        _ => Err(GeoidError::Unknown),
    }
}

/// The table of a grid, or what is wrong with the grid.
fn checked(grid: &GeoidGrid) -> Result<usize, String> {
    let GeoidGrid { rows, columns, .. } = *grid;
    let nodes = grid.nodes().filter(|nodes| *nodes <= NODES_MAX);
    let nodes = nodes.ok_or_else(|| {
        format!("{rows} rows of {columns} nodes are more than {NODES_MAX} together")
    })?;
    match grid.is_valid() {
        true => Ok(nodes),
        false => Err(format!("{rows} rows of {columns} nodes with these steps are not on Earth")),
    }
}

/// Reads `bytes` bytes, or as many as there are.
fn block(input: &mut impl BufRead, bytes: usize) -> io::Result<Vec<u8>> {
    let mut block = Vec::new();
    input.take(bytes as u64).read_to_end(&mut block)?;
    Ok(block)
}

/// Reads nodes of `N` bytes, after `before` bytes, through the end of the input.
fn nodes<const N: usize>(
    input: &mut impl BufRead,
    (count, before): (usize, u64),
    height_m: impl Fn([u8; N]) -> f32,
) -> Result<Vec<f32>, GeoidError> {
    /// Nodes that are read at a time, so that a file that claims more than it has takes no memory.
    const AT_A_TIME: usize = 1 << 16;
    let mut heights_m = Vec::new();
    while heights_m.len() < count {
        let asked = AT_A_TIME.min(count - heights_m.len());
        let bytes = block(input, asked * N)?;
        let (whole, rest) = bytes.as_chunks::<N>();
        heights_m.extend(whole.iter().map(|node| height_m(*node)));
        if whole.len() < asked {
            let end = before + (heights_m.len() * N + rest.len()) as u64;
            let message = format!("the file ends after {} of {count} nodes", heights_m.len());
            return Err(GeoidError::Byte { byte: end, message });
        }
    }
    match input.fill_buf()? {
        [] => Ok(heights_m),
        _ => {
            let message = format!("more bytes follow the {count} nodes");
            Err(GeoidError::Byte { byte: before + (count * N) as u64, message })
        }
    }
}

/// The table in the order of its rows from the south, if they come from the north.
fn from_north(mut heights_m: Vec<f32>, columns: usize) -> Vec<f32> {
    let rows = heights_m.len() / columns;
    for row in 0..rows / 2 {
        let (south, north) = heights_m.split_at_mut((rows - 1 - row) * columns);
        south[row * columns..(row + 1) * columns].swap_with_slice(&mut north[..columns]);
    }
    heights_m
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    #[test]
    fn rows_from_the_north_are_turned() {
        assert_eq!(
            from_north(vec![5.0, 6.0, 3.0, 4.0, 1.0, 2.0], 2),
            [1.0, 2.0, 3.0, 4.0, 5.0, 6.0]
        );
        assert_eq!(from_north(vec![3.0, 4.0, 1.0, 2.0], 2), [1.0, 2.0, 3.0, 4.0]);
    }

    /// A reader of files that may be packed has two bytes in its first buffer.
    #[test]
    fn packed_tables_are_read() {
        let numbers = [47.0_f64, 8.0, 1.0, 1.0].map(f64::to_be_bytes).concat();
        let counts = [2_i32, 2].map(i32::to_be_bytes).concat();
        let nodes = [46.0_f32; 4].map(f32::to_be_bytes).concat();
        let table = [numbers, counts, nodes].concat();
        let mut packed = flate2::write::GzEncoder::new(Vec::new(), Default::default());
        std::io::Write::write_all(&mut packed, &table).unwrap();
        let packed = packed.finish().unwrap();
        let read_of = |bytes: &[u8]| read(crate::formats::decompress(bytes)).unwrap();
        assert_eq!(read_of(&packed), read_of(&table));
    }

    #[test]
    fn other_files_are_told_from_tables() {
        for other in [&b""[..], b"short", b"PK\x03\x04 a packed file", b"{\"type\": \"Topology\"}"]
        {
            assert!(read(other).is_err(), "{other:?}");
        }
        let unknown = read(&b"\x01\x02\x03"[..]).unwrap_err();
        assert!(matches!(unknown, GeoidError::Unknown), "{unknown}");
    }

    proptest! {
        /// No bytes panic, and none take much memory.
        #[test]
        fn any_bytes_are_read_or_refused(
            head in prop_oneof![Just(""), Just("P5\n"), Just("begin_of_head\n")],
            bytes in proptest::collection::vec(any::<u8>(), 0..300),
        ) {
            read(&[head.as_bytes(), &bytes].concat()[..]).ok();
        }
    }
}
