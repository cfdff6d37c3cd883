//! Observations of a receiver.

use super::{GpsTime, ObservationCode, Odometry, SatelliteId, Signal};

/// A length (m): a type of its own where metres and cycles could be swapped.
#[derive(Clone, Copy, Debug, PartialEq, PartialOrd)]
pub(crate) struct Meters(pub f64);

/// Carrier phase (cycles): receivers give cycles, estimators use metres.
#[derive(Clone, Copy, Debug, PartialEq, PartialOrd)]
pub struct Cycles(pub f64);

impl Cycles {
    /// Largest phase that is used (cycles). Receivers begin to count at any value, but above this
    /// limit an `f64` does not resolve 0.01 cycles.
    pub const LIMIT: f64 = 1e13;

    /// Whether the phase is a number within the limit.
    pub(crate) fn is_resolved(self) -> bool {
        self.0.abs() <= Self::LIMIT
    }

    /// The same phase as a length, λφ.
    pub(crate) fn to_meters(self, wavelength: Meters) -> Meters {
        Meters(self.0 * wavelength.0)
    }
}

/// One signal of one satellite at one epoch.
///
/// Signs as in RINEX: for an approaching satellite Doppler is positive and the phase falls.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Observation {
    /// The observed satellite.
    pub satellite: SatelliteId,
    /// Observation code: band and tracking attribute.
    pub code: ObservationCode,
    /// Loss-of-lock indicator: a cycle slip was possible since the previous epoch.
    pub loss_of_lock: bool,
    /// The carrier phase may be off by half a cycle.
    pub half_cycle: bool,
    /// Pseudorange (m).
    pub pseudorange_m: Option<f64>,
    /// Carrier phase (cycles).
    pub carrier_phase: Option<Cycles>,
    /// Doppler (Hz), positive for an approaching satellite.
    pub doppler_hz: Option<f64>,
    /// Carrier-to-noise density C/N0 (dB-Hz).
    pub cn0_db_hz: Option<f64>,
}

impl Observation {
    /// An observation of `satellite` under `code` without measurements.
    pub const fn empty(satellite: SatelliteId, code: ObservationCode) -> Self {
        Self {
            satellite,
            code,
            loss_of_lock: false,
            half_cycle: false,
            pseudorange_m: None,
            carrier_phase: None,
            doppler_hz: None,
            cn0_db_hz: None,
        }
    }

    /// The observed signal: constellation and code.
    pub const fn signal(&self) -> Signal {
        Signal::of(self.satellite, self.code)
    }

    /// Whether there is no measurement.
    pub(crate) const fn is_empty(&self) -> bool {
        self.pseudorange_m.is_none()
            && self.carrier_phase.is_none()
            && self.doppler_hz.is_none()
            && self.cn0_db_hz.is_none()
    }
}

/// All observations of one receiver at one receiver time.
#[derive(Clone, Debug, PartialEq)]
pub struct Epoch {
    /// The receiver's time tag: the true time of reception plus the receiver's clock error.
    pub time: GpsTime,
    /// The receiver lost power since the previous epoch (RINEX epoch flag 1).
    pub power_failure: bool,
    /// Observations, grouped by satellite. A signal appears at most once.
    pub observations: Vec<Observation>,
    /// Displacement since the previous epoch, measured by another sensor.
    pub odometry: Option<Odometry>,
}

impl Epoch {
    /// An epoch without observations.
    pub const fn new(time: GpsTime) -> Self {
        Self { time, power_failure: false, observations: Vec::new(), odometry: None }
    }

    /// The observations of each satellite, in the epoch's order.
    pub fn by_satellite(&self) -> impl Iterator<Item = (SatelliteId, &[Observation])> {
        self.observations.chunk_by(|a, b| a.satellite == b.satellite).map(|c| (c[0].satellite, c))
    }
}
