//! Snapshots of the types that several estimators use.
//!
//! # A new mode
//! [`crate::positioning::EstimatorState::snapshot`] writes the fields of the state, each type next
//! to its definition. To add a mode: give its state `state_fields!`, with a check of every index in
//! it; implement `Engine` for it; add it to the table in `estimator`. If fields of an existing mode
//! change, raise `LAYOUT` there.

use crate::config::IonosphereModel;
use crate::gnss::{
    Band, BaseEpochIssue, Constellation, Cycles, Dops, Ecef, EphemerisIssue, Epoch, GpsTime,
    LocalFrame, Observation, ObservationCode, Odometry, OdometryFrame, Protection, Provenance,
    Reason, RelativeEstimate, SatelliteId, Solution, SolutionEstimate, Status, Velocity,
};
use crate::snapshot::{Snapshot, SnapshotError, SnapshotReader, SnapshotWriter};
use crate::snapshot::{snapshot_fields, snapshot_variants};

snapshot_fields!(LocalFrame { origin, rotation });
snapshot_fields!(EphemerisIssue { satellite, toe, issue });
snapshot_fields!(Epoch { time, power_failure, observations, odometry });
snapshot_fields!(Odometry { interval_s, frame, displacement_m, covariance });
snapshot_variants!(OdometryFrame {
    0 => Ecef {},
    1 => Enu {},
    2 => Body { heading_rad, heading_sigma_rad },
});
snapshot_fields!(Observation {
    satellite,
    code,
    pseudorange_m,
    carrier_phase,
    doppler_hz,
    cn0_db_hz,
    loss_of_lock,
    half_cycle,
});

snapshot_variants!(Reason {
    0 => EphemerisMissing { satellites },
    1 => TooFewSatellites { used, needed },
    2 => GeometryTooWeak { gdop },
    3 => NoRedundancy {},
    4 => ResidualsTooLarge { ratio },
    5 => SatellitesExcluded { satellites },
    6 => NotConverged {},
    7 => IonosphereFallback { used },
    8 => BaseMissing {},
    9 => BaseStale { age_s },
    10 => BasePositionDoubtful { distance_m },
    11 => BaselineTooLong { length_m },
    12 => TooFewCommonSatellites { used, needed },
    13 => RatioBelowThreshold { ratio, threshold },
    14 => SuccessRateTooLow { success_rate },
    15 => FixRejected {},
    16 => HalfCycleUnresolved { satellites },
    17 => CycleSlips { satellites },
    18 => StartUnproven { age_s },
    19 => OdometryUnused { interval_s },
    20 => FixImprecise { sigma_m },
    21 => BaseMoved { distance_m },
    22 => BaseChanged { distance_m },
    23 => EpochRepeated { behind_s },
    24 => ProtectionLimitExceeded { level_m, limit_m },
    26 => EstimatorFailed {},
});

snapshot_fields!(Protection { horizontal_m, vertical_m });
snapshot_fields!(Solution { time, status, estimate, protection, reasons, provenance });
snapshot_fields!(Provenance { ephemerides, base });
snapshot_fields!(BaseEpochIssue { base, time });
snapshot_fields!(SolutionEstimate {
    position,
    covariance,
    velocity,
    clock_m,
    inter_system_biases_m,
    reception_time,
    dops,
    satellites_used,
    relative,
});
snapshot_fields!(Velocity { velocity_m_s, covariance, clock_drift_m_s });
snapshot_fields!(Dops { gdop, pdop, hdop, vdop, tdop });
snapshot_fields!(RelativeEstimate {
    baseline_m,
    age_s,
    ambiguities,
    fixed_ambiguities,
    ratio,
    success_rate,
    fix_probability,
});

impl Snapshot for Status {
    fn save(&self, writer: &mut SnapshotWriter) {
        let place = Self::ALL.iter().position(|status| status == self);
        place.expect("every status is in the list").save(writer);
    }

    fn load(reader: &mut SnapshotReader<'_>) -> Result<Self, SnapshotError> {
        let status = Self::ALL.get(usize::load(reader)?).copied();
        status.ok_or_else(|| reader.invalid("status"))
    }
}

impl Snapshot for Constellation {
    fn save(&self, writer: &mut SnapshotWriter) {
        self.index().save(writer);
    }

    fn load(reader: &mut SnapshotReader<'_>) -> Result<Self, SnapshotError> {
        let constellation = Self::ALL.get(usize::load(reader)?).copied();
        constellation.ok_or_else(|| reader.invalid("constellation"))
    }
}

/// The name of an ionosphere model, the only text in a reason.
impl Snapshot for &'static str {
    fn save(&self, writer: &mut SnapshotWriter) {
        let place = IonosphereModel::ALL.iter().position(|model| model.name() == *self);
        place.expect("a model has the name").save(writer);
    }

    fn load(reader: &mut SnapshotReader<'_>) -> Result<Self, SnapshotError> {
        let model = IonosphereModel::ALL.get(usize::load(reader)?);
        model.map(|model| model.name()).ok_or_else(|| reader.invalid("ionosphere model"))
    }
}

impl Snapshot for GpsTime {
    fn save(&self, writer: &mut SnapshotWriter) {
        self.as_ns().save(writer);
    }

    fn load(reader: &mut SnapshotReader<'_>) -> Result<Self, SnapshotError> {
        i64::load(reader).map(Self::from_ns)
    }
}

impl Snapshot for Ecef {
    fn save(&self, writer: &mut SnapshotWriter) {
        self.0.save(writer);
    }

    fn load(reader: &mut SnapshotReader<'_>) -> Result<Self, SnapshotError> {
        Snapshot::load(reader).map(Self)
    }
}

impl Snapshot for Cycles {
    fn save(&self, writer: &mut SnapshotWriter) {
        writer.f64(self.0);
    }

    fn load(reader: &mut SnapshotReader<'_>) -> Result<Self, SnapshotError> {
        reader.f64().map(Self)
    }
}

impl Snapshot for Band {
    fn save(&self, writer: &mut SnapshotWriter) {
        let place = Self::ALL.iter().position(|band| band == self);
        place.expect("every band is in the list").save(writer);
    }

    fn load(reader: &mut SnapshotReader<'_>) -> Result<Self, SnapshotError> {
        let band = Self::ALL.get(usize::load(reader)?).copied();
        band.ok_or_else(|| reader.invalid("band"))
    }
}

impl Snapshot for SatelliteId {
    fn save(&self, writer: &mut SnapshotWriter) {
        self.constellation.index().save(writer);
        self.number.save(writer);
    }

    fn load(reader: &mut SnapshotReader<'_>) -> Result<Self, SnapshotError> {
        let constellation = Constellation::ALL.get(usize::load(reader)?).copied();
        let number = u8::load(reader)?;
        let satellite = constellation.and_then(|system| Self::new(system, number));
        satellite.ok_or_else(|| reader.invalid("satellite"))
    }
}

impl Snapshot for ObservationCode {
    fn save(&self, writer: &mut SnapshotWriter) {
        writer.u8(self.band_digit());
        writer.u8(self.attribute());
    }

    fn load(reader: &mut SnapshotReader<'_>) -> Result<Self, SnapshotError> {
        let (band, attribute) = (reader.u8()?, reader.u8()?);
        let code = Self::new(band.saturating_add(b'0'), attribute);
        code.ok_or_else(|| reader.invalid("observation code"))
    }
}
