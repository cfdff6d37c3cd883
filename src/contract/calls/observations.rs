//! The stored epochs of a session as a RINEX file of observations.

use bytes::Bytes;
use futures::{Stream, stream};

use crate::contract::{Caller, Lease, Refusal, convert, v1};
use crate::formats::rinex::{ObservationHeader, ObservationWriter, RinexVersion};
use crate::keys::Pass;
use crate::refusal::Code;
use crate::session::ObservedEpochs;

use super::session_id;

/// Memory of a file that is being read: a page of epochs and its text (bytes).
const FILE_BYTES: usize = 4 << 20;

/// The stored epochs of a session as RINEX 3.05, in order of their numbers. They are read twice:
/// once before the answer begins, for the signals in the header, and once while it is sent.
///
/// # Errors
/// The session does not exist, a time is invalid, or the store fails.
pub async fn observations(
    caller: &Caller,
    request: v1::SessionObservationsRequest,
) -> Result<impl Stream<Item = Result<Bytes, Refusal>> + Send + use<>, Refusal> {
    let id = session_id(&request.session)?;
    let span = convert::span(request.from, request.to)?;
    Lease::current().map_or(Ok(()), |lease| lease.reserve(FILE_BYTES))?;
    let epochs = caller.sessions().observed(&id, span).await?;
    let header = header(epochs.clone()).await?;
    let writer = ObservationWriter::new(Vec::new(), &header).map_err(unwritable)?;
    let pass = Lease::current().and_then(|lease| lease.pass().cloned());
    let file = ObservationFile { epochs, writer, pass };
    Ok(stream::unfold(Some(file), |file| async move {
        let mut file = file?;
        match file.next().await {
            Ok(Some(bytes)) => Some((Ok(bytes), Some(file))),
            Ok(None) => None,
            Err(refusal) => Some((Err(refusal), None)),
        }
    }))
}

/// The header for these epochs: their signals, and the first time and position.
async fn header(mut epochs: ObservedEpochs) -> Result<ObservationHeader, Refusal> {
    let mut header = ObservationHeader::new(RinexVersion { major: 3, minor: 5 });
    header.marker.clone_from(&epochs.label);
    while let Some(page) = epochs.next().await? {
        for stored in &page {
            header.first_observation.get_or_insert(stored.epoch.time);
            let estimate = stored.solution.solution.estimate.as_ref();
            let position = estimate.map(|estimate| estimate.position);
            header.approximate_position = header.approximate_position.or(position);
            header.add_codes(&stored.epoch);
        }
    }
    header.codes.iter_mut().for_each(|codes| codes.sort_unstable());
    header.add_channels(&epochs.navigation);
    Ok(header)
}

/// A file that is being written.
struct ObservationFile {
    epochs: ObservedEpochs,
    writer: ObservationWriter<Vec<u8>>,
    /// The sender of the request. When the sender's key ends, the file ends, too.
    pass: Option<Pass>,
}

impl ObservationFile {
    /// The next bytes; `None` at the end.
    async fn next(&mut self) -> Result<Option<Bytes>, Refusal> {
        self.pass.as_ref().map_or(Ok(()), Pass::check)?;
        let Some(page) = self.epochs.next().await? else {
            let rest = self.writer.take();
            return Ok((!rest.is_empty()).then(|| rest.into()));
        };
        for stored in page {
            self.writer.write_what_fits(stored.epoch).map_err(unwritable)?;
        }
        Ok(Some(self.writer.take().into()))
    }
}

fn unwritable(error: impl std::fmt::Display) -> Refusal {
    Refusal::new(Code::Internal, format!("the file cannot be written: {error}"))
}
