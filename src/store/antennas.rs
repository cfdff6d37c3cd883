//! Calibrations of antennas, stored for replay.
//!
//! A calibration is stored under the hash of its content when a session or a base begins to use it.
//! It is never changed or removed, so replay does not need the file that it came from.

use std::collections::BTreeMap;
use std::sync::Arc;

use crate::gnss::AntennaCalibration;

use super::codec::{decode_calibration, encode_calibration};
use super::pool::{reading, writing};
use super::{Store, StoreError};

/// An antenna as a session's settings name it.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct AntennaName {
    /// Type and radome.
    pub name: String,
    /// Hash of its calibration.
    pub calibration: Arc<str>,
}

impl AntennaName {
    /// The name of a calibrated antenna.
    pub(crate) fn of(calibration: &AntennaCalibration) -> Self {
        let AntennaCalibration { antenna, radome, .. } = calibration;
        let name = format!("{antenna} {radome}");
        Self { name, calibration: calibration_hash(calibration).into() }
    }
}

/// The hash of a calibration's content: type, radome, serial number and every phase centre.
pub(super) fn calibration_hash(calibration: &AntennaCalibration) -> String {
    blake3::hash(&encode_calibration(calibration)).to_hex().to_string()
}

impl Store {
    /// Stores a calibration under its hash. Equal hashes mean equal calibrations.
    ///
    /// # Errors
    /// The database fails.
    pub(crate) async fn keep_calibration(
        &self,
        calibration: &AntennaCalibration,
    ) -> Result<(), StoreError> {
        let content = encode_calibration(calibration);
        let stored = writing!(&self.pool, pool => sqlx::query(
            "INSERT INTO antenna_calibrations (hash, content)
             VALUES ($1, $2) ON CONFLICT (hash) DO NOTHING",
        )
        .bind(calibration_hash(calibration))
        .bind(&content[..])
        .execute(pool)
        .await
        .map(drop));
        stored.map_err(StoreError::database("storing an antenna's calibration"))
    }

    /// The calibration of a hash.
    ///
    /// # Errors
    /// No calibration has this hash, its content is corrupt, or the database fails.
    pub(crate) async fn calibration(&self, hash: &str) -> Result<AntennaCalibration, StoreError> {
        let row: Result<Option<(Vec<u8>,)>, _> = reading!(&self.pool, pool => {
            let sql = "SELECT content FROM antenna_calibrations WHERE hash = $1";
            sqlx::query_as(sql).bind(hash).fetch_optional(pool).await
        });
        let row = row.map_err(StoreError::database("reading an antenna's calibration"))?;
        let (content,) = row.ok_or_else(|| StoreError::CorruptText {
            what: "antenna calibration",
            why: format!("none has the hash {hash:?}"),
        })?;
        decode_calibration(&content).map_err(StoreError::corrupt("antenna calibration"))
    }

    /// Every calibration by its hash.
    pub(super) async fn calibrations(
        &self,
    ) -> Result<BTreeMap<String, Arc<AntennaCalibration>>, StoreError> {
        let rows: Result<Vec<(String, Vec<u8>)>, _> = reading!(&self.pool, pool => {
            let sql = "SELECT hash, content FROM antenna_calibrations";
            sqlx::query_as(sql).fetch_all(pool).await
        });
        let rows = rows.map_err(StoreError::database("reading calibrations of antennas"))?;
        let read = |(hash, content): (String, Vec<u8>)| {
            let calibration = decode_calibration(&content);
            let corrupt = StoreError::corrupt("antenna calibration");
            Ok((hash, Arc::new(calibration.map_err(corrupt)?)))
        };
        rows.into_iter().map(read).collect()
    }
}
