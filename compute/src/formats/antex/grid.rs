//! The offset and variations of an antenna's phase centre on one frequency.

use std::io::BufRead;

use nalgebra::Vector3;

use super::AntexError;
use super::lines::Lines;
use crate::gnss::{Constellation, PhaseCentrePattern};

const MILLIMETRE_M: f64 = 1e-3;
/// Largest offset of an antenna (m); those of satellites are below 3 m.
const OFFSET_LIMIT_M: f64 = 100.0;

/// The offset of a frequency from the antenna reference point, north, east, up (m).
pub(super) fn offset_m<R: BufRead>(lines: &Lines<R>) -> Result<Vector3<f64>, AntexError> {
    let number = |at: usize| lines.number_in(10 * at, 10 * at + 10);
    let read = || Some(Vector3::new(number(0)?, number(1)?, number(2)?) * MILLIMETRE_M);
    let offset_m = read().filter(|offset_m| offset_m.amax() <= OFFSET_LIMIT_M);
    offset_m.ok_or(lines.malformed("NORTH / EAST / UP", "not three numbers of millimetres"))
}

/// The offset and variations of one frequency.
pub(super) struct Grid {
    zeniths: usize,
    first_zenith_rad: f64,
    zenith_step_rad: f64,
    azimuth_step_deg: f64,
    pub(super) offset_m: Option<Vector3<f64>>,
    variations_m: Option<Vec<f64>>,
    azimuth_variations_m: Vec<Vec<f64>>,
}

impl Grid {
    const LABEL: &str = "START OF FREQUENCY";

    pub(super) fn new([first, last, step]: [f64; 3], azimuth_step_deg: f64) -> Self {
        Self {
            zeniths: ((last - first) / step).round() as usize + 1,
            first_zenith_rad: first.to_radians(),
            zenith_step_rad: step.to_radians(),
            azimuth_step_deg,
            offset_m: None,
            variations_m: None,
            azimuth_variations_m: Vec::new(),
        }
    }

    /// Reads `NOAZI` or an azimuth in eight columns, and the variations that follow.
    pub(super) fn read_row<R: BufRead>(&mut self, lines: &Lines<R>) -> Result<(), AntexError> {
        let head = lines.columns(0, 8);
        if head == "NOAZI" {
            let twice = lines.malformed(Self::LABEL, "NOAZI appears twice");
            return match self.variations_m.replace(self.values(lines)?) {
                None => Ok(()),
                Some(_) => Err(twice),
            };
        }
        let azimuth_deg = self.azimuth_step_deg * self.azimuth_variations_m.len() as f64;
        let is_next = head.parse::<f64>().is_ok_and(|read| (read - azimuth_deg).abs() < 1e-6);
        if self.azimuth_step_deg == 0.0 || !is_next || 360.0 + 1e-6 < azimuth_deg {
            return Err(lines.malformed(Self::LABEL, "neither NOAZI nor the next azimuth"));
        }
        self.azimuth_variations_m.push(self.values(lines)?);
        Ok(())
    }

    fn values<R: BufRead>(&self, lines: &Lines<R>) -> Result<Vec<f64>, AntexError> {
        let value = |at: usize| lines.number_in(8 + 8 * at, 16 + 8 * at).map(|v| v * MILLIMETRE_M);
        let values: Option<Vec<f64>> = (0..self.zeniths).map(value).collect();
        let is_all = lines.columns(8 + 8 * self.zeniths, usize::MAX).is_empty();
        let values = values.filter(|_| is_all);
        values.ok_or(lines.malformed(Self::LABEL, "not one variation for each zenith angle"))
    }

    /// `None` for a frequency of an unknown system.
    pub(super) fn finish<R: BufRead>(
        self,
        lines: &Lines<R>,
        code: &str,
    ) -> Result<Option<PhaseCentrePattern>, AntexError> {
        let missing = |reason| lines.malformed("END OF FREQUENCY", reason);
        let offset_m = self.offset_m.ok_or(missing("NORTH / EAST / UP is missing"))?;
        let variations_m = self.variations_m.ok_or(missing("NOAZI is missing"))?;
        let rows = match self.azimuth_step_deg {
            0.0 => 0,
            step => (360.0 / step).round() as usize + 1,
        };
        if self.azimuth_variations_m.len() != rows {
            return Err(missing("some azimuths are missing"));
        }
        let mut letters = code.chars();
        let letter = letters.next().unwrap_or(' ');
        let band_digit = letters.as_str().trim().parse().ok().filter(|d| (1..=9).contains(d));
        let band_digit = band_digit.ok_or(missing("its code is not a letter and a number"))?;
        Ok(Constellation::from_letter(letter).map(|constellation| PhaseCentrePattern {
            constellation,
            band_digit,
            offset_m,
            first_zenith_rad: self.first_zenith_rad,
            zenith_step_rad: self.zenith_step_rad,
            variations_m,
            azimuth_variations_m: self.azimuth_variations_m,
        }))
    }
}
