//! ANTEX files of invented antennas.

/// Invented antennas, each with the same phase centre on all frequencies, without variations.
pub(crate) fn antex(antennas: &[(&str, &str)]) -> String {
    let record = |contents: &str, label: &str| format!("{contents:<60}{label}\n");
    let zeros: String = (0..=18).map(|_| format!("{:8.2}", 0.0)).collect();
    let mut file = record(&format!("{:>8}{:12}M", "1.4", ""), "ANTEX VERSION / SYST");
    file += &record("A", "PCV TYPE / REFANT");
    file += &record("", "END OF HEADER");
    for (antenna, offset) in antennas {
        file += &record("", "START OF ANTENNA");
        file += &record(&format!("{antenna:<16}{:<4}", "NONE"), "TYPE / SERIAL NO");
        file += &record("     0.0", "DAZI");
        file += &record("     0.0  90.0   5.0", "ZEN1 / ZEN2 / DZEN");
        file += &record("     1", "# OF FREQUENCIES");
        file += &record("   G01", "START OF FREQUENCY");
        file += &record(offset, "NORTH / EAST / UP");
        file += &format!("   NOAZI{zeros}\n");
        file += &record("   G01", "END OF FREQUENCY");
        file += &record("", "END OF ANTENNA");
    }
    file
}
