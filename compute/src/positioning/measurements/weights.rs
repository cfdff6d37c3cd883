//! The variance of a pseudorange as the receiver measures it: noise and multipath.

use crate::config::{PositioningOptions, REFERENCE_CN0_DB_HZ, WeightModel};
use crate::gnss::Constellation;
use crate::models::weights::{Cn0Term, ElevationTerm, MeasurementWeights};

/// RTKLIB 2.4's code noise: 0.3 m and 0.3 m/√sin E.
const RTKLIB_NOISE_M: f64 = 0.3;
/// Half of the width of the LNAV code bias between P(Y) and C/A, which is not corrected (m);
/// RTKLIB's `ERR_CBIAS`.
const CODE_BIAS_M: f64 = 0.3;
/// RTKLIB's factor on the standard deviation of GLONASS.
const GLONASS_FACTOR: f64 = 1.5;

/// Receiver noise and multipath of pseudoranges under `options`.
///
/// `cn0-elevation`: σ² = s²/sin²E + u²·10^(−(S−42)/10), s and u from the options, S the C/N0. The
/// first term is multipath that grows towards the horizon. The second is thermal noise and, where
/// buildings weaken a signal, the multipath that comes with it.
///
/// `gogps`: σ² = 1/sin²E times goGPS's factor of C/N0 (m²), which is the whole variance.
///
/// `rtklib`: σ² = 0.3² + 0.3²/sin E, and 0.3² for code biases.
pub(crate) fn receiver_weights(options: &PositioningOptions) -> MeasurementWeights {
    match options.weighting {
        WeightModel::Rtklib => MeasurementWeights {
            elevation: ElevationTerm::InverseSine {
                a_m: RTKLIB_NOISE_M.hypot(CODE_BIAS_M),
                b_m: RTKLIB_NOISE_M,
            },
            cn0: Cn0Term::None,
            cn0_if_missing_db_hz: REFERENCE_CN0_DB_HZ,
        },
        WeightModel::GoGps => MeasurementWeights {
            elevation: ElevationTerm::InverseSineSquared { a_m: 0.0, b_m: 1.0 },
            cn0: Cn0Term::gogps(),
            cn0_if_missing_db_hz: REFERENCE_CN0_DB_HZ,
        },
        WeightModel::Cn0Elevation => MeasurementWeights {
            elevation: ElevationTerm::InverseSineSquared {
                a_m: 0.0,
                b_m: options.pseudorange_sigma_m,
            },
            cn0: Cn0Term::SigmaEpsilon {
                v_m2: 0.0,
                c_m2_hz: options.cn0_sigma_m.powi(2) * 10_f64.powf(REFERENCE_CN0_DB_HZ / 10.0),
            },
            // Without C/N0 the second term is left out.
            cn0_if_missing_db_hz: f64::INFINITY,
        },
    }
}

/// Factor on the receiver's variance of a constellation's code.
pub(crate) const fn constellation_factor(constellation: Constellation) -> f64 {
    match constellation {
        // Half the chip rate of GPS, and inter-channel biases of FDMA.
        Constellation::Glonass => GLONASS_FACTOR * GLONASS_FACTOR,
        _ => 1.0,
    }
}
