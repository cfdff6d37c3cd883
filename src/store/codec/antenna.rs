//! Calibrations of antennas as bytes.

use crate::gnss::{AntennaCalibration, PhaseCentrePattern};

use super::CodecError;
use super::bytes::{Decoder, Encoder, constellation_number};

const VERSION: u8 = 1;

/// The bytes of a calibration.
pub(in crate::store) fn encode_calibration(calibration: &AntennaCalibration) -> Vec<u8> {
    let mut out = Encoder::new(VERSION, 4096);
    let AntennaCalibration { antenna, radome, serial, patterns } = calibration;
    [antenna, radome, serial].into_iter().for_each(|text| out.text(text));
    out.count(patterns.len());
    for pattern in patterns {
        out.u8(constellation_number(pattern.constellation));
        out.u8(pattern.band_digit);
        out.vector(&pattern.offset_m);
        out.f64(pattern.first_zenith_rad);
        out.f64(pattern.zenith_step_rad);
        encode_row(&mut out, &pattern.variations_m);
        out.count(pattern.azimuth_variations_m.len());
        pattern.azimuth_variations_m.iter().for_each(|row| encode_row(&mut out, row));
    }
    out.finish()
}

fn encode_row(out: &mut Encoder, row: &[f64]) {
    out.count(row.len());
    row.iter().for_each(|value| out.f64(*value));
}

/// The calibration of the bytes.
pub(in crate::store) fn decode_calibration(bytes: &[u8]) -> Result<AntennaCalibration, CodecError> {
    let mut input = Decoder::new(bytes, VERSION)?;
    let (antenna, radome) = (input.text()?.to_owned(), input.text()?.to_owned());
    let serial = input.text()?.to_owned();
    let count = input.count("number of frequencies")?;
    let patterns = (0..count).map(|_| decode_pattern(&mut input)).collect::<Result<_, _>>()?;
    input.finish()?;
    Ok(AntennaCalibration { antenna, radome, serial, patterns })
}

fn decode_pattern(input: &mut Decoder<'_>) -> Result<PhaseCentrePattern, CodecError> {
    Ok(PhaseCentrePattern {
        constellation: input.constellation()?,
        band_digit: input.u8()?,
        offset_m: input.vector()?,
        first_zenith_rad: input.f64()?,
        zenith_step_rad: input.f64()?,
        variations_m: decode_row(input)?,
        azimuth_variations_m: {
            let count = input.count("number of azimuths")?;
            (0..count).map(|_| decode_row(input)).collect::<Result<_, _>>()?
        },
    })
}

fn decode_row(input: &mut Decoder<'_>) -> Result<Vec<f64>, CodecError> {
    let count = input.count("number of zenith angles")?;
    (0..count).map(|_| input.f64()).collect()
}
