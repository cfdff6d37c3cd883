//! The epochs of a base that are added to a job as a file.

use crate::aiding::bases::PastBase;
use crate::formats::rinex::{ObservationHeader, ObservationWriter, RinexVersion};
use crate::gnss::{BaseSite, GpsTime, Navigation};
use crate::jobs::Failure;
use crate::refusal::Code;
use crate::store::StoredBaseEpoch;

use super::background::in_background;

/// Epochs of a base that are written at a time.
const EPOCHS_PER_PIECE: usize = 256;

/// The epochs of a base with its position and antenna.
pub(super) struct BaseEpochs {
    pub(super) name: String,
    pub(super) site: BaseSite,
    pub(super) epochs: Vec<StoredBaseEpoch>,
    pub(super) is_of_archive: bool,
}

/// Whether a base has epochs from the begin to the end of a span.
pub(super) fn covers(
    epochs: &[StoredBaseEpoch],
    (from, until): (GpsTime, GpsTime),
    age_s: f64,
) -> bool {
    let near = |epoch: Option<&StoredBaseEpoch>, time: GpsTime| {
        epoch.is_some_and(|epoch| (epoch.time - time).abs() <= age_s)
    };
    near(epochs.first(), from) && near(epochs.last(), until)
}

/// The name of the input of a base.
pub(super) fn named(offer: &PastBase, what: &str) -> String {
    let distance = offer.distance_m.map(|m| format!(", {:.1} km from the rover", m / 1e3));
    format!("{}{}: {what}", offer.id(), distance.unwrap_or_default())
}

/// The epochs of a base as RINEX 3.05, in pieces.
pub(super) async fn written(
    name: &str,
    site: &BaseSite,
    epochs: Vec<StoredBaseEpoch>,
    navigation: &Navigation,
) -> Result<Vec<Vec<u8>>, Failure> {
    let mut header = ObservationHeader::new(RinexVersion { major: 3, minor: 5 });
    header.marker = name.split([',', ':']).next().unwrap_or_default().to_owned();
    header.approximate_position = Some(site.marker);
    header.antenna.clone_from(&site.antenna);
    header.antenna_delta_hen_m = site.antenna_delta_hen_m;
    header.first_observation = epochs.first().map(|epoch| epoch.time);
    header.add_channels(navigation);
    in_background(move || {
        let failed = |error: &dyn std::fmt::Display| {
            Failure::new(Code::Internal, format!("writing the base's epochs: {error}"), None)
        };
        let decoded = || epochs.iter().map(PastBase::decoded);
        decoded().for_each(|epoch| header.add_codes(&epoch));
        header.codes.iter_mut().for_each(|codes| codes.sort_unstable());
        let writer = ObservationWriter::new(Vec::new(), &header);
        let mut writer = writer.map_err(|error| failed(&error))?;
        let mut pieces = Vec::new();
        for (index, epoch) in decoded().enumerate() {
            writer.write_what_fits(epoch).map_err(|error| failed(&error))?;
            if (index + 1).is_multiple_of(EPOCHS_PER_PIECE) {
                pieces.push(writer.take());
            }
        }
        pieces.push(writer.take());
        Ok(pieces)
    })
    .await
}
