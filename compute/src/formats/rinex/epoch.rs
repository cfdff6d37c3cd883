//! Reads the next epoch, by the rules of the file's version.

use std::io::BufRead;

use super::{ObservationReader, RinexError};
use crate::gnss::Epoch;

impl<R: BufRead> ObservationReader<R> {
    /// Reads the next epoch into `epoch`, reusing its memory; `false` at the end.
    ///
    /// Observations are in the file's order, grouped by satellite.
    ///
    /// # Errors
    /// Only if the rest of the file cannot be read. Damaged records are skipped and noted.
    pub fn read_epoch(&mut self, epoch: &mut Epoch) -> Result<bool, RinexError> {
        if let Some(mut state) = self.compact.take() {
            let outcome = self.read_compact_epoch(&mut state, epoch);
            self.compact = Some(state);
            outcome
        } else if self.state.header.version.major == 2 {
            self.read_epoch2(epoch)
        } else {
            self.read_epoch3(epoch)
        }
    }
}
