//! Tables of the geoid, made up.

/// A GTX table of a plane. Its height is 46 m at 48° N 11° E, and changes by 2 m per degree north
/// and by −0.5 m per degree east. Rows are at 45° to 51° N and columns at 8° to 14° E, a degree
/// apart.
pub(crate) fn plane() -> Vec<u8> {
    let numbers = [45.0_f64, 8.0, 1.0, 1.0].map(f64::to_be_bytes).concat();
    let counts = [7_i32, 7].map(i32::to_be_bytes).concat();
    let places = (0..7).flat_map(|row| (0..7).map(move |column| (row, column)));
    let nodes = places.flat_map(|(row, column)| {
        let height_m = plane_height_m(45.0 + f64::from(row), 8.0 + f64::from(column));
        (height_m as f32).to_be_bytes()
    });
    numbers.into_iter().chain(counts).chain(nodes).collect()
}

/// The height of that plane (m).
pub(crate) fn plane_height_m(latitude_deg: f64, longitude_deg: f64) -> f64 {
    46.0 + 2.0 * (latitude_deg - 48.0) - 0.5 * (longitude_deg - 11.0)
}
