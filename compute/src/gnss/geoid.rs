//! Heights of the geoid above the ellipsoid, from a table.
//!
//! The height above the geoid, the orthometric height, is H = h − N with the height h above the
//! ellipsoid and the geoid's height N, the undulation. N is interpolated bilinearly between the
//! four nodes around the position: with u and v, 0 to 1, from west to east and from south to north,
//! N = (1−u)(1−v)·N₀₀ + u(1−v)·N₁₀ + (1−u)v·N₀₁ + uv·N₁₁.

use super::Geodetic;

const FULL_TURN_DEG: f64 = 360.0;
/// Steps by which a position may be outside of the table and still counts as on its edge.
const EDGE: f64 = 1e-9;

/// Where the nodes of a table are.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct GeoidGrid {
    /// Latitude of the southernmost nodes (degrees).
    pub south_deg: f64,
    /// Longitude of the westernmost nodes, east positive (degrees).
    pub west_deg: f64,
    /// From one row to the next one in the north (degrees).
    pub latitude_step_deg: f64,
    /// From one column to the next one in the east (degrees).
    pub longitude_step_deg: f64,
    /// Number of rows, from south to north.
    pub rows: usize,
    /// Number of columns, from west to east.
    pub columns: usize,
}

/// A table of the geoid's heights above the ellipsoid of WGS 84.
#[derive(Clone, Debug, PartialEq)]
pub struct Geoid {
    grid: GeoidGrid,
    /// Row by row from the south, each from the west (m); not a number where the table has none.
    heights_m: Vec<f32>,
}

impl GeoidGrid {
    /// Number of nodes; `None` if there are more than any memory has.
    pub fn nodes(&self) -> Option<usize> {
        self.rows.checked_mul(self.columns)
    }

    /// Whether this is a grid on the Earth of at least two rows and columns.
    pub fn is_valid(&self) -> bool {
        let Self { south_deg, west_deg, latitude_step_deg, longitude_step_deg, .. } = *self;
        let extent_deg = |nodes: usize, step_deg: f64| nodes.saturating_sub(1) as f64 * step_deg;
        let north_deg = south_deg + extent_deg(self.rows, latitude_step_deg);
        let width_deg = extent_deg(self.columns, longitude_step_deg);
        2 <= self.rows
            && 2 <= self.columns
            && (0.0..=90.0).contains(&latitude_step_deg)
            && (0.0..=180.0).contains(&longitude_step_deg)
            && 0.0 < latitude_step_deg.min(longitude_step_deg)
            && (-90.0 - latitude_step_deg * EDGE..).contains(&south_deg)
            && (..=90.0 + latitude_step_deg * EDGE).contains(&north_deg)
            && (-FULL_TURN_DEG..=FULL_TURN_DEG).contains(&west_deg)
            && width_deg <= FULL_TURN_DEG + longitude_step_deg * EDGE
    }

    /// The row below a latitude, and the fraction of a step above it; `None` outside of the table.
    fn row(&self, latitude_deg: f64) -> Option<(usize, f64)> {
        cell((latitude_deg - self.south_deg) / self.latitude_step_deg, self.rows)
    }

    /// The columns west and east of a longitude, and the fraction of a step between them.
    fn columns(&self, longitude_deg: f64) -> Option<(usize, usize, f64)> {
        let turn = FULL_TURN_DEG / self.longitude_step_deg;
        let steps =
            (longitude_deg - self.west_deg).rem_euclid(FULL_TURN_DEG) / self.longitude_step_deg;
        // A position on the western edge may be rounded to a full turn.
        let steps = if turn - EDGE < steps { 0.0 } else { steps };
        let last = self.columns - 1;
        let is_around = (turn - self.columns as f64).abs() < EDGE;
        if is_around && last as f64 <= steps {
            return Some((last, 0, steps - last as f64));
        }
        cell(steps, self.columns).map(|(west, fraction)| (west, west + 1, fraction))
    }
}

/// The last node at or before a place among `nodes`, not the last of all, and the fraction of a
/// step behind it.
fn cell(steps: f64, nodes: usize) -> Option<(usize, f64)> {
    let last = (nodes - 1) as f64;
    if !(-EDGE..=last + EDGE).contains(&steps) {
        return None;
    }
    let steps = steps.clamp(0.0, last);
    let before = (steps as usize).min(nodes - 2);
    Some((before, steps - before as f64))
}

impl Geoid {
    /// A table with the heights of all nodes, row by row from the south, each from the west (m);
    /// not a number where the table has none. `None` if the grid is not valid or their number is
    /// another one.
    pub fn new(grid: GeoidGrid, heights_m: Vec<f32>) -> Option<Self> {
        let is_whole = grid.is_valid() && grid.nodes() == Some(heights_m.len());
        is_whole.then_some(Self { grid, heights_m })
    }

    /// The geoid's height above the ellipsoid (m); `None` where the table has none.
    pub fn height_m(&self, position: &Geodetic) -> Option<f64> {
        let (row, v) = self.grid.row(position.latitude_rad.to_degrees())?;
        let (west, east, u) = self.grid.columns(position.longitude_rad.to_degrees())?;
        let nodes = [
            ((1.0 - u) * (1.0 - v), row, west),
            (u * (1.0 - v), row, east),
            ((1.0 - u) * v, row + 1, west),
            (u * v, row + 1, east),
        ];
        // A node without height counts only if it has a weight.
        let weighted = nodes.into_iter().filter(|(weight, ..)| *weight != 0.0);
        let height_m: f64 = weighted
            .map(|(weight, row, column)| {
                weight * f64::from(self.heights_m[row * self.grid.columns + column])
            })
            .sum();
        height_m.is_finite().then_some(height_m)
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    fn geoid(south_west: (f64, f64), steps: (f64, f64), heights_m: &[&[f32]]) -> Geoid {
        let grid = GeoidGrid {
            south_deg: south_west.0,
            west_deg: south_west.1,
            latitude_step_deg: steps.0,
            longitude_step_deg: steps.1,
            rows: heights_m.len(),
            columns: heights_m[0].len(),
        };
        Geoid::new(grid, heights_m.concat()).unwrap()
    }

    fn at(geoid: &Geoid, latitude: f64, longitude: f64) -> Option<f64> {
        geoid.height_m(&Geodetic::from_degrees(latitude, longitude, 0.0))
    }

    /// A quarter of the way east and half of the way north of 40, 44 and 48, 60: 41 and 51, so 46.
    #[test]
    fn a_height_worked_by_hand() {
        let geoid = geoid((47.0, 8.0), (1.0, 2.0), &[&[40.0, 44.0], &[48.0, 60.0]]);
        assert!((at(&geoid, 47.5, 8.5).unwrap() - 46.0).abs() < 1e-9);
        for (latitude, longitude, height_m) in
            [(47.0, 8.0, 40.0), (47.0, 10.0, 44.0), (48.0, 8.0, 48.0), (48.0, 10.0, 60.0)]
        {
            assert!((at(&geoid, latitude, longitude).unwrap() - height_m).abs() < 1e-6);
        }
    }

    #[test]
    fn outside_and_in_holes_there_is_none() {
        let hole = f32::NAN;
        let rows: [&[f32]; 3] = [&[1.0, 2.0, 3.0], &[4.0, hole, 6.0], &[7.0, 8.0, 9.0]];
        let geoid = geoid((10.0, -1.0), (1.0, 1.0), &rows);
        for (latitude, longitude) in
            [(9.999, 0.0), (12.001, 0.0), (11.0, -1.001), (11.0, 1.001), (10.5, 0.5), (11.5, -0.5)]
        {
            assert_eq!(at(&geoid, latitude, longitude), None, "{latitude}, {longitude}");
        }
        assert!(at(&geoid, 12.0, -1.0).is_some());
    }

    /// Columns at 0°, 90°, 180° and 270°: −45° is between the last and the first.
    #[test]
    fn a_global_table_goes_around() {
        let row: &[f32] = &[10.0, 20.0, 30.0, 40.0];
        let geoid = geoid((-90.0, 0.0), (90.0, 90.0), &[row, row, row]);
        for (longitude, height_m) in
            [(-45.0, 25.0), (-180.0, 30.0), (180.0, 30.0), (-1e-15, 10.0), (-90.0, 40.0)]
        {
            let found = at(&geoid, 90.0, longitude).unwrap();
            assert!((found - height_m).abs() < 1e-9, "{longitude}: {found}");
        }
    }

    #[test]
    fn grids_that_are_none_are_refused() {
        let good = GeoidGrid {
            south_deg: -90.0,
            west_deg: 0.0,
            latitude_step_deg: 90.0,
            longitude_step_deg: 90.0,
            rows: 3,
            columns: 4,
        };
        assert!(Geoid::new(good, vec![0.0; 12]).is_some());
        assert!(Geoid::new(good, vec![0.0; 11]).is_none());
        for wrong in [
            GeoidGrid { rows: 1, ..good },
            GeoidGrid { rows: 4, ..good },
            GeoidGrid { columns: 6, ..good },
            GeoidGrid { south_deg: -91.0, ..good },
            GeoidGrid { west_deg: f64::NAN, ..good },
            GeoidGrid { latitude_step_deg: 0.0, ..good },
            GeoidGrid { longitude_step_deg: -90.0, ..good },
            GeoidGrid { latitude_step_deg: f64::NAN, ..good },
            GeoidGrid { rows: usize::MAX, columns: usize::MAX, ..good },
        ] {
            assert!(!wrong.is_valid(), "{wrong:?}");
        }
    }

    proptest! {
        /// A table of a plane gives the plane, wherever the position is and however west is
        /// counted.
        #[test]
        fn a_plane_is_interpolated_exactly(
            lat in 30.0..50.0,
            lon in -20.0..20.0,
            is_west_positive in any::<bool>(),
            slopes in (-2.0_f64..2.0, -2.0_f64..2.0),
        ) {
            let plane = |lat: f64, lon: f64| -> f64 { 30.0 + slopes.0 * lat + slopes.1 * lon };
            let grid = GeoidGrid {
                south_deg: 30.0,
                west_deg: if is_west_positive { 340.0 } else { -20.0 },
                latitude_step_deg: 2.5,
                longitude_step_deg: 4.0,
                rows: 9,
                columns: 11,
            };
            let node = |k: usize| {
                let (row, column) = ((k / 11) as f64, (k % 11) as f64);
                plane(30.0 + 2.5 * row, -20.0 + 4.0 * column) as f32
            };
            let geoid = Geoid::new(grid, (0..99).map(node).collect()).unwrap();
            let found = at(&geoid, lat, lon).unwrap();
            prop_assert!((found - plane(lat, lon)).abs() < 1e-4, "{found}");
        }

        /// An interpolated height is between those of the nodes, and the table goes around the
        /// Earth without a step.
        #[test]
        fn no_height_is_beyond_the_nodes(
            heights_m in proptest::collection::vec(-107.0_f32..86.0, 7 * 12),
            lat in -90.0..90.0,
            lon in -180.0..180.0,
        ) {
            let grid = GeoidGrid {
                south_deg: -90.0,
                west_deg: 0.0,
                latitude_step_deg: 30.0,
                longitude_step_deg: 30.0,
                rows: 7,
                columns: 12,
            };
            let (least, most) = (-107.0 - 1e-4, 86.0 + 1e-4);
            let geoid = Geoid::new(grid, heights_m).unwrap();
            let found = at(&geoid, lat, lon).unwrap();
            prop_assert!((least..=most).contains(&found));
            let (before, after) = (at(&geoid, lat, -1e-7).unwrap(), at(&geoid, lat, 1e-7).unwrap());
            prop_assert!((before - after).abs() < 1e-5);
        }
    }
}
