//! Header of a navigation file.

use std::io::Read;

use super::ionosphere;
use crate::formats::rinex::fields::{columns, constellation, decimal};
use crate::formats::rinex::header_lines::{FirstLine, label, leap_seconds};
use crate::formats::rinex::lines::Lines;
use crate::formats::rinex::{RinexError, RinexVersion, SkipReason, Skipped};
use crate::gnss::{Constellation, KlobucharCoefficients, LeapSeconds, Navigation};

const COEFFICIENT_WIDTH: usize = 12;

/// Broadcast data of the header; α and β are separate lines and are paired at the end.
#[derive(Debug)]
pub(super) struct NavigationHeader {
    pub(super) version: RinexVersion,
    system: Option<Constellation>,
    leap_seconds: Option<i64>,
    gps: [Option<[f64; 4]>; 2],
    beidou: [Option<[f64; 4]>; 2],
    qzss: [Option<[f64; 4]>; 2],
    galileo: Option<[f64; 4]>,
}

impl NavigationHeader {
    pub(super) fn new(first: FirstLine) -> Self {
        Self {
            version: first.version,
            system: constellation(first.system),
            leap_seconds: None,
            gps: [None; 2],
            beidou: [None; 2],
            qzss: [None; 2],
            galileo: None,
        }
    }

    pub(super) fn read<R: Read>(
        &mut self,
        lines: &mut Lines<R>,
        skipped: &mut Skipped,
    ) -> Result<(), RinexError> {
        while let Some(line) = lines.next()? {
            match label(line) {
                b"END OF HEADER" => return Ok(()),
                label => {
                    if self.apply(label, line).is_none() {
                        skipped.note(SkipReason::MalformedHeaderRecord, lines.number());
                    }
                }
            }
        }
        Err(RinexError::Truncated { line: lines.number() })
    }

    fn apply(&mut self, label: &[u8], line: &[u8]) -> Option<()> {
        match label {
            b"ION ALPHA" => self.gps[0] = Some(coefficients(line, 2)?),
            b"ION BETA" => self.gps[1] = Some(coefficients(line, 2)?),
            b"IONOSPHERIC CORR" => {
                let values = coefficients(line, 5)?;
                match columns(line, 0, 4) {
                    b"GPSA" => self.gps[0] = Some(values),
                    b"GPSB" => self.gps[1] = Some(values),
                    b"BDSA" => self.beidou[0] = Some(values),
                    b"BDSB" => self.beidou[1] = Some(values),
                    b"QZSA" => self.qzss[0] = Some(values),
                    b"QZSB" => self.qzss[1] = Some(values),
                    b"GAL " => self.galileo = Some(values),
                    _ => {}
                }
            }
            b"LEAP SECONDS" => self.leap_seconds = leap_seconds(line, self.system)?,
            _ => {}
        }
        Some(())
    }

    pub(super) fn apply_to(&self, navigation: &mut Navigation) {
        navigation.klobuchar_gps = pair(self.gps);
        navigation.klobuchar_beidou = pair(self.beidou);
        navigation.klobuchar_qzss = pair(self.qzss);
        navigation.nequick = self.galileo.and_then(|[a, b, c, _]| ionosphere::nequick([a, b, c]));
        if let Some(count) = self.leap_seconds {
            navigation.leap_seconds = LeapSeconds::with_broadcast(count);
        }
    }
}

fn pair([alpha, beta]: [Option<[f64; 4]>; 2]) -> Option<KlobucharCoefficients> {
    ionosphere::klobuchar(alpha?, beta?)
}

/// Parses four numbers of twelve columns; blank ones are zero.
fn coefficients(line: &[u8], from: usize) -> Option<[f64; 4]> {
    let mut values = [0.0; 4];
    for (index, value) in values.iter_mut().enumerate() {
        let start = from + index * COEFFICIENT_WIDTH;
        *value = decimal(columns(line, start, start + COEFFICIENT_WIDTH))?.unwrap_or(0.0);
    }
    Some(values)
}
