//! Writes epochs as such a log.

use std::io::{self, Write};

use super::{signals, state};
use crate::gnss::constants::{BEIDOU_LAG_S, GLONASS_AHEAD_OF_UTC_S, NS_PER_SECOND, SPEED_OF_LIGHT};
use crate::gnss::{Constellation, Epoch, GpsTime, Navigation, Observation};

/// The columns of the app's version 3.1.
const TITLE: &str = "# Raw,utcTimeMillis,TimeNanos,LeapSecond,TimeUncertaintyNanos,FullBiasNanos,\
    BiasNanos,BiasUncertaintyNanos,DriftNanosPerSecond,DriftUncertaintyNanosPerSecond,\
    HardwareClockDiscontinuityCount,Svid,TimeOffsetNanos,State,ReceivedSvTimeNanos,\
    ReceivedSvTimeUncertaintyNanos,Cn0DbHz,PseudorangeRateMetersPerSecond,\
    PseudorangeRateUncertaintyMetersPerSecond,AccumulatedDeltaRangeState,\
    AccumulatedDeltaRangeMeters,AccumulatedDeltaRangeUncertaintyMeters,CarrierFrequencyHz,\
    CarrierCycles,CarrierPhase,CarrierPhaseUncertainty,MultipathIndicator,SnrInDb,\
    ConstellationType,AgcDb,BasebandCn0DbHz,FullInterSignalBiasNanos,\
    FullInterSignalBiasUncertaintyNanos,SatelliteInterSignalBiasNanos,\
    SatelliteInterSignalBiasUncertaintyNanos,CodeType,ChipsetElapsedRealtimeNanos";
/// Time that the phone's clock shows at the first epoch (ns).
const FIRST_CLOCK_NS: i64 = 1_000 * NS_PER_SECOND;
const NS_PER_MS: i64 = NS_PER_SECOND / 1000;
const WEEK_NS: i64 = 604_800 * NS_PER_SECOND;
const DAY_NS: i64 = 86_400 * NS_PER_SECOND;
/// 1970-01-01 to the GPS epoch (ms).
const UNIX_AT_GPS_EPOCH_MS: i64 = 315_964_800_000;

/// Writes a log of a phone whose clock differs from GPS time by whole milliseconds only.
///
/// ReceivedSvTimeNanos is an integer, 0.3 m. The rest of a pseudorange goes into TimeOffsetNanos,
/// so that a reader finds it again to a micrometre.
///
/// ```
/// use graphfix_compute::formats::gnss_logger::{LogReader, LogWriter};
/// use graphfix_compute::gnss::{Epoch, GpsTime};
/// use graphfix_compute::simulation::{Scenario, Simulator};
///
/// let simulator = Simulator::new(Scenario { duration_s: 1.0, ..Scenario::open_sky() }, 1);
/// let navigation = simulator.navigation().clone();
/// let mut writer = LogWriter::new(Vec::new(), &navigation)?;
/// for epoch in simulator {
///     assert_eq!(writer.write_epoch(&epoch.rover)?, epoch.rover.observations.len());
/// }
/// let log = writer.finish()?;
/// let (mut reader, mut epoch) = (LogReader::new(log.as_slice()), Epoch::new(GpsTime::EPOCH));
/// while reader.read_epoch(&mut epoch)? {
///     assert!(4 < epoch.observations.len());
/// }
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
#[derive(Debug)]
pub struct LogWriter<'a, W> {
    out: W,
    navigation: &'a Navigation,
    /// TimeNanos less GPS time (ns), known with the first epoch.
    full_bias_ns: Option<i64>,
    discontinuities: u32,
}

impl<'a, W: Write> LogWriter<'a, W> {
    /// Writes the header. `navigation` has the frequency channels of GLONASS.
    ///
    /// # Errors
    /// The output refuses the bytes.
    pub fn new(mut out: W, navigation: &'a Navigation) -> io::Result<Self> {
        let version = env!("CARGO_PKG_VERSION");
        writeln!(out, "# \n# Header Description:\n# \n# Version: graphfix {version}\n# ")?;
        writeln!(out, "{TITLE}\n# ")?;
        Ok(Self { out, navigation, full_bias_ns: None, discontinuities: 0 })
    }

    /// Writes the records of an epoch and returns their number: an observation without pseudorange,
    /// or of a GLONASS satellite without known channel, has none.
    ///
    /// # Errors
    /// The output refuses the bytes.
    pub fn write_epoch(&mut self, epoch: &Epoch) -> io::Result<usize> {
        self.discontinuities += u32::from(epoch.power_failure);
        let mut written = 0;
        for observation in &epoch.observations {
            written += usize::from(self.write_record(epoch.time, observation)?.is_some());
        }
        Ok(written)
    }

    /// Passes the remaining bytes to the output and returns it.
    ///
    /// # Errors
    /// The output refuses them.
    pub fn finish(mut self) -> io::Result<W> {
        self.out.flush()?;
        Ok(self.out)
    }

    fn write_record(&mut self, time: GpsTime, observation: &Observation) -> io::Result<Option<()>> {
        let satellite = observation.satellite;
        let ephemeris = self.navigation.satellites().find(|(known, _)| *known == satellite);
        let channel = ephemeris.and_then(|(_, list)| list.last()?.glonass_channel());
        let Some(frequency_hz) = observation.signal().frequency_hz(channel) else {
            return Ok(None);
        };
        let Some(range_m) = observation.pseudorange_m else { return Ok(None) };
        let (received_ns, offset_ns) = self.transmission_ns(time, satellite.constellation, range_m);
        let metres_per_cycle = SPEED_OF_LIGHT / frequency_hz;
        let rate_m_s = observation.doppler_hz.map(|doppler_hz| -doppler_hz * metres_per_cycle);
        let phase_m = observation.carrier_phase.map(|phase| phase.0 * metres_per_cycle);
        self.write_clock(time)?;
        write!(
            self.out,
            ",{},{offset_ns:?},{},{received_ns},10,{},{},{},{},{},{},",
            signals::svid(satellite),
            state::decoded(satellite.constellation),
            Field(observation.cn0_db_hz),
            Field(rate_m_s),
            Field(rate_m_s.map(|_| 0.1)),
            accumulated_state(observation),
            Field(Some(phase_m.unwrap_or(0.0))),
            Field(phase_m.map(|_| 0.01)),
        )?;
        let constellation = signals::constellation_type(satellite.constellation);
        let code = char::from(observation.code.attribute());
        writeln!(self.out, "{frequency_hz},,,,0,,{constellation},,,,,,,{code},")?;
        Ok(Some(()))
    }

    /// The fields of `GnssClock`, up to HardwareClockDiscontinuityCount.
    fn write_clock(&mut self, time: GpsTime) -> io::Result<()> {
        let bias_ns = *self.full_bias_ns.get_or_insert_with(|| {
            (FIRST_CLOCK_NS - time.as_ns()).div_euclid(NS_PER_MS) * NS_PER_MS
        });
        let clock_ns = time.as_ns() + bias_ns;
        let leap_s = self.navigation.leap_seconds.at(time);
        let utc_ms = time.as_ns() / NS_PER_MS - leap_s * 1000 + UNIX_AT_GPS_EPOCH_MS;
        let count = self.discontinuities;
        write!(self.out, "Raw,{utc_ms},{clock_ns},{leap_s},,{bias_ns},0.0,10.0,0.0,,{count}")
    }

    /// ReceivedSvTimeNanos and TimeOffsetNanos of a pseudorange.
    fn transmission_ns(
        &self,
        time: GpsTime,
        constellation: Constellation,
        range_m: f64,
    ) -> (i64, f64) {
        let (ahead_s, period_ns) = match constellation {
            Constellation::Gps | Constellation::Galileo | Constellation::Qzss => (0, WEEK_NS),
            Constellation::BeiDou => (-(BEIDOU_LAG_S as i64), WEEK_NS),
            Constellation::Glonass => {
                let leap_s = self.navigation.leap_seconds.at(time);
                (GLONASS_AHEAD_OF_UTC_S as i64 - leap_s, DAY_NS)
            }
        };
        let flight_ns = range_m / SPEED_OF_LIGHT * 1e9;
        let whole_ns = flight_ns.round();
        let sent_ns = time.as_ns() + ahead_s * NS_PER_SECOND - whole_ns as i64;
        (sent_ns.rem_euclid(period_ns), flight_ns - whole_ns)
    }
}

/// AccumulatedDeltaRangeState of an observation.
fn accumulated_state(observation: &Observation) -> i64 {
    let bit = |is_set: bool, bit: i64| if is_set { bit } else { 0 };
    bit(observation.carrier_phase.is_some(), state::ADR_VALID)
        | bit(observation.loss_of_lock, state::ADR_CYCLE_SLIP)
        | bit(!observation.half_cycle, state::ADR_HALF_CYCLE_RESOLVED)
        | state::ADR_HALF_CYCLE_REPORTED
}

/// A number that may be absent, with as many digits as it takes to read it back.
struct Field(Option<f64>);

impl std::fmt::Display for Field {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        self.0.map_or(Ok(()), |value| write!(f, "{value:?}"))
    }
}
