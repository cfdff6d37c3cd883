//! Variances of measurements.
//!
//! One function of elevation and C/N0, [`MeasurementWeights::variance_m2`]; published models are
//! choices of its parameters. It covers the receiver's noise and multipath only. Orbit and clock
//! ([`ephemeris_variance_m2`]), troposphere and ionosphere add their variances.

use crate::gnss::{Constellation, Ephemeris, NO_PREDICTION_M, NavigationMessage};

/// Dependence of the variance on elevation.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) enum ElevationTerm {
    /// a² + b²/sin²E (m²): the cosecant model.
    InverseSineSquared {
        /// Part independent of elevation (m).
        a_m: f64,
        /// Part at the zenith that grows towards the horizon (m).
        b_m: f64,
    },
    /// a² + b²/sin E (m²): RTKLIB's model, manual 2.4.2, (E.6.24).
    ///
    /// RTKLIB's defaults for pseudoranges are a = b = 0.3 m: 0.003 m times the code/phase ratio of
    /// 100; for GLONASS σ is 1.5 times that.
    InverseSine {
        /// Part independent of elevation (m).
        a_m: f64,
        /// Part at the zenith that grows towards the horizon (m).
        b_m: f64,
    },
}

/// Dependence of the variance on C/N0.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) enum Cn0Term {
    /// None: factor 1, or 0 m² where it is added.
    None,
    /// V + C·10^(−S/10) (m²): Hartinger & Brunner (1999), *Variances of GPS phase observations: the
    /// SIGMA-ε model*, GPS Solutions 2(4); Wieser (2007) with V. Added to the elevation term.
    SigmaEpsilon {
        /// V (m²).
        v_m2: f64,
        /// C (m²·Hz).
        c_m2_hz: f64,
    },
    /// goGPS's factor on the elevation term:
    /// 10^(−(S−T)/a)·[(A/10^(−(F−T)/a) − 1)·(S−T)/(F−T) + 1] below T, else 1; it is A at S = F.
    ///
    /// Realini & Reguzzoni (2013), *goGPS: open source software for enhancing the accuracy of
    /// low-cost receivers by single-frequency relative kinematic positioning*, Meas. Sci. Technol.
    /// 24; Herrera et al. (2016), *goGPS: open-source MATLAB software*, GPS Solutions 20.
    GoGps {
        /// T: C/N0 above which the factor is 1 (dB-Hz).
        threshold_db_hz: f64,
        /// F: C/N0 at which the factor is A (dB-Hz).
        reference_db_hz: f64,
        /// A: factor at F.
        factor: f64,
        /// a: decay (dB-Hz).
        decay_db_hz: f64,
    },
}

impl Cn0Term {
    /// goGPS's own parameters: T = 50, F = 10, A = 30, a = 30. Its variants for Hong Kong use them
    /// too.
    pub(crate) const fn gogps() -> Self {
        Self::GoGps {
            threshold_db_hz: 50.0,
            reference_db_hz: 10.0,
            factor: 30.0,
            decay_db_hz: 30.0,
        }
    }
}

/// Model of a measurement's variance by elevation and C/N0.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct MeasurementWeights {
    /// Term that depends on elevation.
    pub elevation: ElevationTerm,
    /// Term that depends on C/N0.
    pub cn0: Cn0Term,
    /// C/N0 assumed where a receiver reports none (dB-Hz).
    pub cn0_if_missing_db_hz: f64,
}

/// Lowest elevation of the model (rad), 1°: 1/sin E is unbounded at the horizon.
const ELEVATION_MIN_RAD: f64 = 0.017_453_292_519_943_295;

impl MeasurementWeights {
    /// Variance (m² for a pseudorange) at an elevation (rad) and C/N0 (dB-Hz).
    pub(crate) fn variance_m2(&self, elevation_rad: f64, cn0_db_hz: Option<f64>) -> f64 {
        let elevation = self.elevation.variance_m2(elevation_rad);
        let s = cn0_db_hz.unwrap_or(self.cn0_if_missing_db_hz);
        match self.cn0 {
            Cn0Term::None => elevation,
            Cn0Term::SigmaEpsilon { v_m2, c_m2_hz } => elevation + v_m2 + c_m2_hz * decibel(-s),
            Cn0Term::GoGps { threshold_db_hz, reference_db_hz, factor, decay_db_hz } => {
                let below = s - threshold_db_hz;
                if 0.0 <= below {
                    return elevation;
                }
                let reference = reference_db_hz - threshold_db_hz;
                let decay = |db: f64| decibel(-10.0 * db / decay_db_hz);
                let line = (factor / decay(reference) - 1.0) * below / reference + 1.0;
                elevation * decay(below) * line
            }
        }
    }
}

impl ElevationTerm {
    fn variance_m2(&self, elevation_rad: f64) -> f64 {
        let sin = elevation_rad.max(ELEVATION_MIN_RAD).sin();
        match *self {
            Self::InverseSineSquared { a_m, b_m } => a_m * a_m + b_m * b_m / (sin * sin),
            Self::InverseSine { a_m, b_m } => a_m * a_m + b_m * b_m / sin,
        }
    }
}

/// 10^(x/10), by `exp`: several times faster than `powf`.
fn decibel(x: f64) -> f64 {
    (x * (std::f64::consts::LN_10 / 10.0)).exp()
}

/// Upper bounds of the URA index 0 … 14 (m); IS-GPS-200N, 20.3.3.3.1.3, and
/// BDS-SIS-ICD-B1I-3.0, 5.2.4.5.
const URA_BOUNDS_M: [f64; 15] = [
    2.4,
    3.4,
    4.85,
    6.85,
    9.65,
    13.65,
    24.0,
    48.0,
    96.0,
    192.0,
    384.0,
    768.0,
    1_536.0,
    3_072.0,
    NO_PREDICTION_M,
];
/// Accuracy of a healthy satellite whose ephemeris states none (m): the bound of URA index 0, which
/// RTKLIB takes for an accuracy of zero. It is what most GPS satellites broadcast.
const UNSTATED_M: f64 = URA_BOUNDS_M[0];
/// GLONASS-M's orbit and clock where F_T is not given (m), as RTKLIB's `ERREPH_GLO`.
const UNSTATED_GLONASS_M: f64 = 5.0;
/// SISA of index 107 (m), which Galileo broadcasts for its satellites in normal operation.
const USUAL_SISA_M: f64 = 3.12;

/// Largest accuracy that messages of satellites in normal operation state, and the range error of
/// orbit and clock that these have (m).
///
/// In the navigation files of docs/accuracy.md nearly all satellites have a URA index of 0 to 2,
/// and those of Galileo a SISA of at most 3.12 m. Errors: Montenbruck, Steigenberger & Hauschild
/// (2018), *Multi-GNSS signal-in-space range error assessment*, Adv. Space Res. 61.
pub(crate) const fn normal_operation_m(constellation: Constellation) -> (f64, f64) {
    match constellation {
        Constellation::Gps | Constellation::Qzss => (URA_BOUNDS_M[2], 0.6),
        Constellation::BeiDou => (URA_BOUNDS_M[2], 1.0),
        Constellation::Galileo => (USUAL_SISA_M, 0.2),
        Constellation::Glonass => (UNSTATED_GLONASS_M, 2.0),
    }
}

/// Variance of a range due to the broadcast orbit and clock (m²).
///
/// The square of the broadcast accuracy; for a URA index (LNAV, D1, D2) the square of the upper
/// bound of its interval.
pub(crate) fn ephemeris_variance_m2(ephemeris: &Ephemeris) -> f64 {
    use NavigationMessage as M;
    let sigma_m = match ephemeris {
        Ephemeris::Glonass(e) => e.accuracy_m.unwrap_or(UNSTATED_GLONASS_M),
        Ephemeris::Keplerian(e) => match (e.message, e.accuracy_m) {
            (_, None) => UNSTATED_M,
            (M::Lnav | M::D1 | M::D2, Some(nominal_m)) => ura_bound_m(nominal_m),
            (_, Some(stated_m)) => stated_m,
        },
    };
    sigma_m * sigma_m
}

fn ura_bound_m(nominal_m: f64) -> f64 {
    URA_BOUNDS_M.into_iter().find(|bound| nominal_m <= *bound).unwrap_or(NO_PREDICTION_M)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::models::sample;

    fn weights(elevation: ElevationTerm, cn0: Cn0Term) -> MeasurementWeights {
        MeasurementWeights { elevation, cn0, cn0_if_missing_db_hz: 30.0 }
    }

    fn near(value: f64, expected: f64) {
        assert!((value / expected - 1.0).abs() < 1e-9, "{value}, not {expected}");
    }

    /// sin 30° = 1/2: 0.3² + 0.4²/(1/4) and 0.3² + 0.3²/(1/2).
    #[test]
    fn elevation_terms_worked_by_hand() {
        let low = 30.0_f64.to_radians();
        let squared = ElevationTerm::InverseSineSquared { a_m: 0.3, b_m: 0.4 };
        near(weights(squared, Cn0Term::None).variance_m2(low, None), 0.73);
        let rtklib = ElevationTerm::InverseSine { a_m: 0.3, b_m: 0.3 };
        near(weights(rtklib, Cn0Term::None).variance_m2(low, Some(20.0)), 0.27);
        assert!(weights(squared, Cn0Term::None).variance_m2(-0.2, None).is_finite());
    }

    /// C·10^(−4) at 40 dB-Hz; the value for signals without C/N0 is that of 30 dB-Hz.
    #[test]
    fn sigma_epsilon_worked_by_hand() {
        let term = Cn0Term::SigmaEpsilon { v_m2: 0.25, c_m2_hz: 1e4 };
        let model = weights(ElevationTerm::InverseSine { a_m: 0.0, b_m: 0.0 }, term);
        near(model.variance_m2(1.0, Some(40.0)), 1.25);
        near(model.variance_m2(1.0, None), 10.25);
    }

    /// Expected values: goGPS's factor computed in Python from the published formula.
    #[test]
    fn gogps_worked_apart() {
        let cosecant = ElevationTerm::InverseSineSquared { a_m: 0.0, b_m: 1.0 };
        let model = weights(cosecant, Cn0Term::gogps());
        let zenith = std::f64::consts::FRAC_PI_2;
        near(model.variance_m2(zenith, Some(10.0)), 30.0);
        near(model.variance_m2(zenith, None), 5.552_446_451_854_215);
        near(model.variance_m2(30.0_f64.to_radians(), Some(40.0)), 9.463_304_070_095_655);
        near(model.variance_m2(zenith, Some(50.0)), 1.0);
        near(model.variance_m2(zenith, Some(55.0)), 1.0);
    }

    #[test]
    fn ephemeris_variances() {
        let mut gps = sample::gps();
        let variance = |e: &crate::gnss::KeplerianEphemeris| {
            ephemeris_variance_m2(&Ephemeris::Keplerian(e.clone()))
        };
        // URA index 0 is written as 2.0 m and bounded by 2.4 m.
        near(variance(&gps), 2.4 * 2.4);
        gps.accuracy_m = None;
        near(variance(&gps), 2.4 * 2.4);
        gps.accuracy_m = Some(NO_PREDICTION_M);
        near(variance(&gps), 6_144.0 * 6_144.0);
        let mut galileo = sample::galileo();
        galileo.accuracy_m = Some(3.12);
        near(variance(&galileo), 3.12 * 3.12);
        galileo.accuracy_m = Some(NO_PREDICTION_M);
        near(variance(&galileo), 6_144.0 * 6_144.0);
        near(ephemeris_variance_m2(&Ephemeris::Glonass(sample::glonass())), 25.0);
    }
}
