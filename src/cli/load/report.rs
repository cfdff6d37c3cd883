//! The result of a load.

use std::time::Duration;

use serde::Serialize;

use crate::cli::Failure;
use crate::refusal::Code;

use super::LoadArguments;
use super::verification::Verified;
use crate::cli::output::{note, say};

/// Errors that are shown.
const SHOWN: usize = 10;

/// What is printed.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
#[serde(rename_all = "camelCase")]
pub(super) struct Report {
    devices: u32,
    /// Until all streams were open, before the first epoch was due (s).
    open_seconds: f64,
    /// From the first epoch on (s).
    seconds: f64,
    /// Acknowledged epochs.
    epochs: usize,
    epochs_per_second: f64,
    /// Median of the delays from when an epoch is due to its acknowledgement (ms).
    ack_p50_ms: f32,
    /// 99th percentile of them (ms).
    ack_p99_ms: f32,
    /// The longest one (ms).
    ack_max_ms: f32,
    /// Refused epochs, and devices that gave up.
    errors: usize,
    /// Epochs that were acknowledged and are not stored.
    lost: usize,
    /// Epochs that are stored twice.
    doubled: usize,
    /// Answers that were sent again after a break.
    repeated: usize,
    /// Epochs that were not acknowledged.
    unanswered: usize,
    /// Streams that ended before the device ended them.
    breaks: usize,
    /// Processor time of the service for an epoch (µs), if its process is known.
    #[serde(skip_serializing_if = "Option::is_none")]
    processor_us_per_epoch: Option<f64>,
    #[serde(skip)]
    first_errors: Vec<String>,
}

impl Report {
    pub(super) fn new(
        arguments: &LoadArguments,
        (opened, elapsed): (Duration, Duration),
        verified: Verified,
    ) -> Self {
        let Verified { mut delays_ms, errors, .. } = verified;
        delays_ms.sort_unstable_by(f32::total_cmp);
        let seconds = elapsed.as_secs_f64();
        Self {
            devices: arguments.devices,
            open_seconds: opened.as_secs_f64(),
            seconds,
            epochs: verified.epochs,
            epochs_per_second: verified.epochs as f64 / seconds,
            ack_p50_ms: quantile(&delays_ms, 0.5),
            ack_p99_ms: quantile(&delays_ms, 0.99),
            ack_max_ms: quantile(&delays_ms, 1.0),
            errors: errors.len(),
            lost: verified.lost,
            doubled: verified.doubled,
            repeated: verified.repeated,
            unanswered: verified.unanswered,
            breaks: verified.breaks,
            processor_us_per_epoch: None,
            first_errors: errors.into_iter().take(SHOWN).collect(),
        }
    }

    /// With the processor time of the service for all epochs (s).
    pub(super) fn with_processor_time(self, seconds: Option<f64>) -> Self {
        let epochs = self.epochs.max(1) as f64;
        Self { processor_us_per_epoch: seconds.map(|seconds| 1e6 * seconds / epochs), ..self }
    }

    pub(super) fn print(&self, as_json: bool) {
        for error in &self.first_errors {
            note!("{error}");
        }
        if as_json {
            say!("{}", serde_json::to_string(self).expect("numbers can be written as JSON"));
            return;
        }
        say!(
            "{} epochs of {} devices in {:.1} s: {:.0} a second",
            self.epochs,
            self.devices,
            self.seconds,
            self.epochs_per_second
        );
        say!(
            "acknowledged after {:.1} ms (median), {:.1} ms (99 %), {:.1} ms (longest)",
            self.ack_p50_ms,
            self.ack_p99_ms,
            self.ack_max_ms
        );
        say!(
            "{} errors, {} lost, {} doubled, {} unanswered, {} breaks",
            self.errors,
            self.lost,
            self.doubled,
            self.unanswered,
            self.breaks
        );
        if let Some(each_us) = self.processor_us_per_epoch {
            say!("{each_us:.1} µs of processor time of the service for an epoch");
        }
    }

    /// # Errors
    /// An epoch was refused, lost, doubled, or not answered.
    pub(super) fn check(&self) -> Result<(), Failure> {
        if [self.errors, self.lost, self.doubled, self.unanswered] == [0; 4] {
            return Ok(());
        }
        let message = format!(
            "{} errors, {} lost, {} doubled, {} unanswered",
            self.errors, self.lost, self.doubled, self.unanswered
        );
        Err(Failure::of(Code::LoadIncomplete, message))
    }
}

/// The quantile of sorted values, without interpolation; 0 for an empty list.
fn quantile(sorted: &[f32], share: f64) -> f32 {
    let index = (sorted.len() as f64 * share).ceil() as usize;
    sorted.get(index.saturating_sub(1)).copied().unwrap_or(0.0)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn quantiles() {
        let values: Vec<f32> = (1..=200).map(|value| value as f32).collect();
        assert_eq!([0.5, 0.99, 1.0].map(|share| quantile(&values, share)), [100.0, 198.0, 200.0]);
        assert_eq!(quantile(&[], 0.5), 0.0);
    }

    #[test]
    fn what_is_lost_or_unanswered_fails_the_command() {
        assert_eq!(Report::default().check(), Ok(()));
        for report in [
            Report { errors: 1, ..Report::default() },
            Report { lost: 1, ..Report::default() },
            Report { doubled: 1, ..Report::default() },
            Report { unanswered: 1, ..Report::default() },
        ] {
            let failure = report.check().unwrap_err();
            assert!(failure.to_string().starts_with("error[LOAD_INCOMPLETE]"), "{failure}");
        }
    }
}
