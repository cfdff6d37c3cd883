//! Variances of single differences.

use crate::config::PositioningOptions;
use crate::gnss::Constellation;
use crate::gnss::constants::GPS_L1_HZ;
use crate::models::weights::{Cn0Term, ElevationTerm, MeasurementWeights};
use crate::positioning::measurements::constellation_factor;

/// Random drift of a satellite's clock from its broadcast polynomial (m/s): 5·10⁻¹² of the speed of
/// light, the default clock stability of RTKLIB's manual 2.4.2, section 3.5 (`stats-clkstab`).
const CLOCK_WANDER_M_S: f64 = 1.5e-3;
/// Base epochs closer than this are simultaneous with the rover's (s).
const SAME_INSTANT_S: f64 = 0.1;

/// Variances of single differences between two receivers at one time.
#[derive(Clone, Copy, Debug)]
pub(super) struct DifferenceVariances {
    pseudorange: MeasurementWeights,
    carrier: MeasurementWeights,
    /// Variance of the satellite's clock (m²).
    clock_m2: f64,
    /// Standard deviation of the differential ionospheric delay at the zenith on L1 (m).
    ionosphere_m: f64,
}

/// Properties of a pair of observations that its variance depends on.
#[derive(Clone, Copy, Debug)]
pub(super) struct PairQuality {
    pub(super) constellation: Constellation,
    pub(super) frequency_hz: f64,
    pub(super) elevation_rad: f64,
    /// C/N0 at the rover relative to its strongest signals, and at the base relative to
    /// 42 dB-Hz (dB).
    pub(super) relative_cn0_db: [Option<f64>; 2],
}

impl DifferenceVariances {
    /// Variances for a baseline of this length (m) and a base epoch of this age (s).
    ///
    /// σ² = σ²_rover + σ²_base + (g·d/sin E·(f_L1/f)²)² + (1.5 mm/s · age)²
    ///
    /// g is the gradient of the vertical ionospheric delay: 1 to 4 mm/km on quiet days at mid
    /// latitudes (Lee, Pullen, Datta-Barua & Enge 2007, *Assessment of ionosphere spatial
    /// decorrelation for GPS-based aircraft landing systems*, J. Aircraft 44).
    pub(super) fn new(options: &PositioningOptions, baseline_m: f64, age_s: f64) -> Self {
        let (pseudorange_m, carrier_m) =
            (options.rtk.pseudorange_sigma_m, options.rtk.carrier_sigma_m);
        let old_s = if age_s.abs() < SAME_INSTANT_S { 0.0 } else { age_s };
        Self {
            pseudorange: weights(0.0, pseudorange_m, options.rtk.pseudorange_cn0_sigma_m),
            carrier: weights(carrier_m, carrier_m, options.rtk.carrier_cn0_sigma_m),
            clock_m2: (CLOCK_WANDER_M_S * old_s).powi(2),
            ionosphere_m: options.rtk.ionosphere_gradient * baseline_m,
        }
    }

    /// Variance of a single-differenced pseudorange (m²).
    pub(super) fn pseudorange_m2(&self, pair: &PairQuality) -> f64 {
        let receivers = self.receivers_m2(&self.pseudorange, pair);
        constellation_factor(pair.constellation) * receivers + self.path_m2(pair)
    }

    /// Variance of a single-differenced carrier phase (m²).
    pub(super) fn carrier_m2(&self, pair: &PairQuality) -> f64 {
        self.receivers_m2(&self.carrier, pair) + self.path_m2(pair)
    }

    fn receivers_m2(&self, weights: &MeasurementWeights, pair: &PairQuality) -> f64 {
        let relative = pair.relative_cn0_db.iter();
        relative.map(|cn0_db| weights.variance_m2(pair.elevation_rad, *cn0_db)).sum()
    }

    fn path_m2(&self, pair: &PairQuality) -> f64 {
        let scale = (GPS_L1_HZ / pair.frequency_hz).powi(2) / pair.elevation_rad.sin();
        (self.ionosphere_m * scale).powi(2) + self.clock_m2
    }
}

/// a² + b²/sin²E + u²·10^(−S/10), S the relative C/N0 (dB); the last term is zero without C/N0.
fn weights(a_m: f64, b_m: f64, cn0_sigma_m: f64) -> MeasurementWeights {
    MeasurementWeights {
        elevation: ElevationTerm::InverseSineSquared { a_m, b_m },
        cn0: Cn0Term::SigmaEpsilon { v_m2: 0.0, c_m2_hz: cn0_sigma_m.powi(2) },
        cn0_if_missing_db_hz: f64::INFINITY,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::config::{Mode, Profile};

    fn quality(elevation_deg: f64) -> PairQuality {
        PairQuality {
            constellation: Constellation::Gps,
            frequency_hz: GPS_L1_HZ,
            elevation_rad: f64::to_radians(elevation_deg),
            relative_cn0_db: [None; 2],
        }
    }

    /// 30°: two receivers of 3² + 3²/(1/4) mm² each, and 2 mm/km over 5 km by 1/sin E.
    #[test]
    fn carrier_worked_by_hand() {
        let mut options = PositioningOptions::new(Mode::RtkFgo, Profile::General);
        (options.rtk.carrier_sigma_m, options.rtk.ionosphere_gradient) = (3e-3, 2e-6);
        let near = DifferenceVariances::new(&options, 0.0, 0.05).carrier_m2(&quality(30.0));
        assert!((near - 2.0 * 45e-6).abs() < 1e-12, "{near}");
        let far = DifferenceVariances::new(&options, 5e3, 10.0).carrier_m2(&quality(30.0));
        assert!((far - near - 0.02_f64.powi(2) - 0.015_f64.powi(2)).abs() < 1e-12, "{far}");
    }
}
