//! Station messages 1005 to 1008, 1033 and 1230, and the times of 1013 and 1029.

use crate::formats::binary::{Bits, Clock, Refusal};
use nalgebra::Vector3;

use crate::gnss::constants::SECONDS_PER_DAY;
use crate::gnss::{BaseSite, Ecef, Enu, GpsTime, LocalFrame, PositionSource};

const COORDINATE_UNIT_M: f64 = 1e-4;
const BIAS_UNIT_M: f64 = 0.02;
/// Value of a missing GLONASS bias.
const NO_BIAS: i64 = -(1 << 15);
/// Longest descriptor (characters); DF029.
const DESCRIPTOR_LIMIT: u64 = 31;
/// Modified Julian day of 1980-01-06, where GPS time starts.
const GPS_EPOCH_MJD: i64 = 44_244;
const DAY_S: i64 = SECONDS_PER_DAY as i64;

/// The transmitting station, as described by its messages so far.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Station {
    /// Reference station number (DF003).
    pub id: u16,
    /// Antenna reference point, ECEF (m).
    pub antenna_reference_point: Option<Ecef>,
    /// Whether the station is virtual: a point for which a network computes data (DF141).
    pub is_virtual: bool,
    /// Antenna reference point above the marker (m), from 1006.
    pub antenna_height_m: Option<f64>,
    /// IGS name of antenna and radome; empty if unknown.
    pub antenna: String,
    /// Serial number of the antenna; empty if unknown.
    pub antenna_serial: String,
    /// Receiver type; empty if unknown.
    pub receiver: String,
    /// Firmware of the receiver; empty if unknown.
    pub receiver_firmware: String,
    /// Serial number of the receiver; empty if unknown.
    pub receiver_serial: String,
    /// GLONASS code-phase biases of 1C, 1P, 2C and 2P (m), from 1230.
    pub glonass_biases_m: [Option<f64>; 4],
}

impl Station {
    /// The station's position, once a message has given it.
    pub fn site(&self) -> Option<BaseSite> {
        let point = self.antenna_reference_point?;
        let height_m = self.antenna_height_m.unwrap_or(0.0);
        let below = Enu(Vector3::new(0.0, 0.0, -height_m));
        Some(BaseSite {
            marker: LocalFrame::at(point).to_ecef(below),
            antenna_delta_hen_m: [height_m, 0.0, 0.0],
            antenna: self.antenna.clone(),
            calibration: None,
            source: PositionSource::Message,
        })
    }

    /// Applies a message; another station number clears the description.
    pub(super) fn update(&mut self, number: u16, mut bits: Bits<'_>) -> Result<(), Refusal> {
        let id = bits.unsigned(12) as u16;
        let mut updated = if id == self.id { self.clone() } else { Self::default() };
        updated.id = id;
        match number {
            1005 | 1006 => updated.read_position(&mut bits, number == 1006),
            1230 => updated.read_biases(&mut bits),
            _ => updated.read_descriptors(&mut bits, number)?,
        }
        bits.require_sound()?;
        *self = updated;
        Ok(())
    }

    fn read_position(&mut self, bits: &mut Bits<'_>, has_height: bool) {
        // Realisation year and the constellations in use.
        bits.skip(6 + 3);
        self.is_virtual = bits.flag();
        let x = bits.signed_scaled(38, COORDINATE_UNIT_M);
        bits.skip(2);
        let y = bits.signed_scaled(38, COORDINATE_UNIT_M);
        bits.skip(2);
        let z = bits.signed_scaled(38, COORDINATE_UNIT_M);
        // A station that does not know its position sends zeros.
        let is_known = [x, y, z] != [0.0; 3];
        self.antenna_reference_point = is_known.then(|| Ecef::new(x, y, z));
        if has_height {
            self.antenna_height_m = Some(bits.scaled(16, COORDINATE_UNIT_M));
        }
    }

    fn read_descriptors(&mut self, bits: &mut Bits<'_>, number: u16) -> Result<(), Refusal> {
        self.antenna = text(bits)?;
        // Antenna setup number.
        bits.skip(8);
        if number != 1007 {
            self.antenna_serial = text(bits)?;
        }
        if number == 1033 {
            self.receiver = text(bits)?;
            self.receiver_firmware = text(bits)?;
            self.receiver_serial = text(bits)?;
        }
        Ok(())
    }

    fn read_biases(&mut self, bits: &mut Bits<'_>) {
        bits.skip(1 + 3);
        let given = [bits.flag(), bits.flag(), bits.flag(), bits.flag()];
        self.glonass_biases_m = given.map(|is_given| {
            let value = is_given.then(|| bits.signed(16));
            value.filter(|value| *value != NO_BIAS).map(|value| value as f64 * BIAS_UNIT_M)
        });
    }
}

/// Reads a count and that many characters of ISO 8859-1, without surrounding blanks.
fn text(bits: &mut Bits<'_>) -> Result<String, Refusal> {
    let length = bits.unsigned(8);
    if DESCRIPTOR_LIMIT < length {
        return Err(Refusal::Truncated);
    }
    let text: String = (0..length).map(|_| char::from(bits.unsigned(8) as u8)).collect();
    Ok(text.trim_matches(|c: char| c.is_whitespace() || c == '\0').to_owned())
}

/// Sets the clock from 1013 or 1029, which carry a complete time (modified Julian day and second of
/// day, UTC), if no time is known yet.
pub(super) fn take_time(mut bits: Bits<'_>, clock: &mut Clock) -> Result<(), Refusal> {
    bits.skip(12);
    let (day, second) = (bits.unsigned(16) as i64, bits.unsigned(17) as i64);
    bits.require_sound()?;
    let label_s = (day - GPS_EPOCH_MJD) * DAY_S + second;
    if day < GPS_EPOCH_MJD || DAY_S < second {
        return Err(Refusal::InvalidTime);
    }
    if clock.time().is_none() {
        let without_leap = GpsTime::from_ns(label_s * 1_000_000_000);
        clock.set(without_leap + clock.leap_seconds().at(without_leap) as f64);
    }
    Ok(())
}
