//! The epochs of a base that are added to a job as a file.

use std::fmt::Display;
use std::vec::IntoIter;

use crate::aiding::bases::PastBase;
use crate::formats::rinex::{ObservationHeader, ObservationWriter, RinexVersion};
use crate::gnss::{BaseSite, CoordinateFrame, GpsTime, Navigation};
use crate::jobs::Failure;
use crate::refusal::Code;
use crate::store::StoredBaseEpoch;

use super::background::in_background;

/// Epochs of a base that are written in one chunk.
const EPOCHS_PER_PIECE: usize = 256;

/// The epochs of a base with its position and antenna.
pub(super) struct BaseEpochs {
    pub(super) name: String,
    pub(super) site: BaseSite,
    pub(super) epochs: Vec<StoredBaseEpoch>,
    pub(super) is_of_archive: bool,
    /// The frame that the base states.
    pub(super) frame: Option<CoordinateFrame>,
}

/// Whether the epochs of a base extend from the beginning to the end of a span.
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

/// The epochs of a base as a RINEX 3.05 file that is written in chunks.
pub(super) struct BaseText {
    /// `None` while a chunk is written.
    writer: Option<ObservationWriter<Vec<u8>>>,
    epochs: IntoIter<StoredBaseEpoch>,
    is_done: bool,
}

impl BaseText {
    /// Begins the file. The header has the codes of all epochs.
    ///
    /// # Errors
    /// It cannot be written.
    pub(super) async fn begin(base: BaseEpochs, navigation: &Navigation) -> Result<Self, Failure> {
        let BaseEpochs { name, site, epochs, .. } = base;
        let mut header = ObservationHeader::new(RinexVersion { major: 3, minor: 5 });
        header.marker = name.split([',', ':']).next().unwrap_or_default().to_owned();
        header.approximate_position = Some(site.marker);
        header.antenna = site.antenna;
        header.antenna_delta_hen_m = site.antenna_delta_hen_m;
        header.first_observation = epochs.first().map(|epoch| epoch.time);
        header.add_channels(navigation);
        in_background(move || {
            epochs.iter().for_each(|epoch| header.add_codes(&PastBase::decoded(epoch)));
            header.codes.iter_mut().for_each(|codes| codes.sort_unstable());
            let writer = ObservationWriter::new(Vec::new(), &header).map_err(unwritable)?;
            Ok(Self { writer: Some(writer), epochs: epochs.into_iter(), is_done: false })
        })
        .await
    }

    /// The next chunk; `None` at the end.
    ///
    /// # Errors
    /// An epoch cannot be written.
    pub(super) async fn next(&mut self) -> Result<Option<Vec<u8>>, Failure> {
        if self.is_done {
            return Ok(None);
        }
        let some: Vec<_> = self.epochs.by_ref().take(EPOCHS_PER_PIECE).collect();
        self.is_done = some.len() < EPOCHS_PER_PIECE;
        let mut writer = self.writer.take().expect("no piece is written");
        let (writer, piece) = in_background(move || {
            for epoch in &some {
                writer.write_what_fits(PastBase::decoded(epoch)).map_err(unwritable)?;
            }
            let piece = writer.take();
            Ok((writer, piece))
        })
        .await?;
        self.writer = Some(writer);
        Ok(Some(piece))
    }
}

fn unwritable(error: impl Display) -> Failure {
    Failure::new(Code::Internal, format!("writing the base's epochs: {error}"), None)
}
