//! Epochs of a file without those dated in the future.
//!
//! A receiver may write an epoch with a wrong time. If that is earlier than the epochs before, the
//! epoch repeats an answer. If it is later, all epochs after it would, until the file reaches that
//! time. So an epoch is left out if both epochs after it, by themselves, go on from the epoch
//! before it.

use std::collections::VecDeque;

use crate::gnss::{Epoch, GpsTime};

use super::RecordingError;

/// Number of epochs that decide about the one before them.
const WITNESSES: usize = 2;

/// Epochs read ahead; each with what its reader knew at its time.
#[derive(Debug)]
pub(super) struct EpochOrder<T> {
    ahead: VecDeque<(Epoch, T)>,
    /// Latest time that was given out.
    last: Option<GpsTime>,
    /// Whether the file has ended.
    has_ended: bool,
    /// Why the rest of the file cannot be read.
    error: Option<RecordingError>,
    left_out: u64,
}

impl<T> Default for EpochOrder<T> {
    fn default() -> Self {
        Self { ahead: VecDeque::new(), last: None, has_ended: false, error: None, left_out: 0 }
    }
}

impl<T> EpochOrder<T> {
    /// The next epoch, written to `epoch`, and what belongs to it; `None` at the end. `read` reads
    /// the next epoch of the file.
    ///
    /// # Errors
    /// That of `read`, after the epochs before it.
    pub(super) fn next(
        &mut self,
        epoch: &mut Epoch,
        mut read: impl FnMut(&mut Epoch) -> Result<Option<T>, RecordingError>,
    ) -> Result<Option<T>, RecordingError> {
        loop {
            while self.ahead.len() <= WITNESSES && !self.has_ended {
                let mut next = Epoch::new(epoch.time);
                std::mem::swap(&mut next.observations, &mut epoch.observations);
                match read(&mut next) {
                    Ok(Some(known)) => self.ahead.push_back((next, known)),
                    Ok(None) => self.has_ended = true,
                    Err(error) => (self.has_ended, self.error) = (true, Some(error)),
                }
            }
            let Some((next, known)) = self.ahead.pop_front() else {
                return self.error.take().map_or(Ok(None), Err);
            };
            if self.is_refuted(next.time) {
                self.left_out += 1;
                continue;
            }
            self.last = self.last.max(Some(next.time));
            *epoch = next;
            return Ok(Some(known));
        }
    }

    /// Whether the epochs ahead go on from the last one, and are before `time`.
    fn is_refuted(&self, time: GpsTime) -> bool {
        let goes_on = |(epoch, _): &(Epoch, T)| {
            epoch.time < time && self.last.is_none_or(|last| last < epoch.time)
        };
        self.ahead.len() == WITNESSES && self.ahead.iter().all(goes_on)
    }

    /// Number of epochs left out.
    pub(super) const fn left_out(&self) -> u64 {
        self.left_out
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn at(second: i32) -> GpsTime {
        GpsTime::from_week_seconds(2200, f64::from(second))
    }

    /// The seconds that are given out of a file with these, the number left out, and whether an
    /// error follows if one ends the file.
    fn given(seconds: &[i32], is_damaged: bool) -> (Vec<i32>, u64, bool) {
        let (mut file, mut order) = (seconds.iter(), EpochOrder::default());
        let mut read = |epoch: &mut Epoch| {
            let Some(second) = file.next() else {
                let refusal = RecordingError::NoEpochs { name: "rover".to_owned() };
                return if is_damaged { Err(refusal) } else { Ok(None) };
            };
            epoch.time = at(*second);
            Ok(Some(*second))
        };
        let (mut epoch, mut given) = (Epoch::new(GpsTime::EPOCH), Vec::new());
        let has_failed = loop {
            match order.next(&mut epoch, &mut read) {
                Ok(Some(second)) => {
                    assert_eq!(epoch.time, at(second));
                    given.push(second);
                }
                Ok(None) => break false,
                Err(_) => break true,
            }
        };
        assert!(order.next(&mut epoch, &mut read).unwrap().is_none());
        (given, order.left_out(), has_failed)
    }

    #[test]
    fn an_epoch_dated_in_the_future_is_left_out() {
        for (seconds, expected) in [
            (&[10, 1000, 11, 12][..], &[10, 11, 12][..]),
            (&[1000, 10, 11, 12], &[10, 11, 12]),
            (&[10, 11, 1000, 12, 13, 2000, 14, 15], &[10, 11, 12, 13, 14, 15]),
        ] {
            let left_out = (seconds.len() - expected.len()) as u64;
            assert_eq!(given(seconds, false), (expected.to_vec(), left_out, false));
        }
    }

    /// Epochs that are repeated, out of order, or of an earlier recording stay, and so does what
    /// only one epoch refutes.
    #[test]
    fn all_others_stay() {
        for seconds in [
            &[][..],
            &[10],
            &[10, 11, 12],
            &[10, 11, 11, 11, 12],
            &[10, 12, 11, 13],
            &[10, 11, 12, 10, 11, 12, 13],
            &[10, 11, 1, 2, 3],
            &[10, 1000, 11],
        ] {
            assert_eq!(given(seconds, false), (seconds.to_vec(), 0, false));
        }
    }

    #[test]
    fn an_error_follows_the_epochs_before_it() {
        assert_eq!(given(&[10, 1000, 11, 12], true), (vec![10, 11, 12], 1, true));
        assert_eq!(given(&[], true), (vec![], 0, true));
    }
}
