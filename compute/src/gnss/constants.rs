//! Physical and defining constants, each written once.
//!
//! Sources: IS-GPS-200N (2022), Galileo OS SIS ICD 2.1 (2023), BDS-SIS-ICD-B1I-3.0 (2019),
//! GLONASS ICD L1/L2 5.1 (2008), IS-QZSS-PNT-005 (2023).

/// Speed of light in vacuum (m/s); IS-GPS-200N, 20.3.4.3, and every other ICD.
pub const SPEED_OF_LIGHT: f64 = 299_792_458.0;
/// Distance that light covers in a millisecond (m): receivers step their clocks by it.
pub(crate) const LIGHT_MILLISECOND_M: f64 = SPEED_OF_LIGHT * 1e-3;
/// Carrier frequency of GPS L1, Galileo E1, BeiDou B1C and QZSS L1 (Hz); IS-GPS-200N, 3.3.1.1.
pub(crate) const GPS_L1_HZ: f64 = 1_575.42e6;

/// Earth rotation rate of WGS 84 (rad/s); IS-GPS-200N, table 20-IV.
pub(crate) const EARTH_ROTATION_RATE: f64 = 7.292_115_146_7e-5;
/// Earth rotation rate of CGCS2000 (rad/s); BDS-SIS-ICD-B1I-3.0, table 5-11.
pub const EARTH_ROTATION_RATE_BEIDOU: f64 = 7.292_115_0e-5;
/// Earth rotation rate of PZ-90.02 (rad/s); GLONASS ICD 5.1, table 3.2.
pub(crate) const EARTH_ROTATION_RATE_GLONASS: f64 = 7.292_115e-5;

/// Earth's gravitational constant for GPS and QZSS (m³/s²); IS-GPS-200N, table 20-IV.
pub(crate) const GRAVITATIONAL_CONSTANT_GPS: f64 = 3.986_005e14;
/// Earth's gravitational constant for Galileo (m³/s²); Galileo OS SIS ICD 2.1, table 68.
pub(crate) const GRAVITATIONAL_CONSTANT_GALILEO: f64 = 3.986_004_418e14;
/// Earth's gravitational constant for BeiDou (m³/s²); BDS-SIS-ICD-B1I-3.0, table 5-11.
pub(crate) const GRAVITATIONAL_CONSTANT_BEIDOU: f64 = 3.986_004_418e14;
/// Earth's gravitational constant for GLONASS (m³/s²); GLONASS ICD 5.1, table 3.2.
pub(crate) const GRAVITATIONAL_CONSTANT_GLONASS: f64 = 3.986_004_418e14;

/// Semi-major axis of WGS 84 (m).
pub(crate) const WGS84_SEMI_MAJOR_AXIS: f64 = 6_378_137.0;
/// Flattening of WGS 84.
pub(crate) const WGS84_FLATTENING: f64 = 1.0 / 298.257_223_563;
/// First eccentricity squared of WGS 84, e² = f(2 − f).
pub(crate) const WGS84_ECCENTRICITY_SQUARED: f64 = WGS84_FLATTENING * (2.0 - WGS84_FLATTENING);

/// Seconds in an hour.
pub const SECONDS_PER_HOUR: f64 = 3_600.0;
/// Seconds in a day without leap second.
pub const SECONDS_PER_DAY: f64 = 24.0 * SECONDS_PER_HOUR;
/// Seconds in a GPS week.
pub const SECONDS_PER_WEEK: f64 = 7.0 * SECONDS_PER_DAY;
/// Nanoseconds in a second.
pub const NS_PER_SECOND: i64 = 1_000_000_000;

/// GPS week in which Galileo's week 0 begins; Galileo OS SIS ICD 2.1, 5.1.2.
pub(crate) const GALILEO_FIRST_WEEK: i32 = 1024;
/// GPS week in which BeiDou's week 0 begins, 2006-01-01; BDS-SIS-ICD-B1I-3.0, 3.3.
pub(crate) const BEIDOU_FIRST_WEEK: i32 = 1356;
/// GPS time minus BeiDou time (s): the leap seconds between their starts.
pub(crate) const BEIDOU_LAG_S: f64 = 14.0;
/// GLONASS time minus UTC (s); GLONASS ICD 5.1, 3.3.3.
pub(crate) const GLONASS_AHEAD_OF_UTC_S: f64 = 3.0 * SECONDS_PER_HOUR;
