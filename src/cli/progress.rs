//! Speed and progress of a file that is played.

use std::io::IsTerminal;
use std::time::{Duration, Instant};

use crate::contract::v1;

use super::Failure;
use super::cargo::Cargo;
use super::device_stream::{Acknowledged, DeviceStream, Next};
use super::output::{note, say};

/// The speed at which a file is played.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Speed {
    Factor(f64),
    Max,
}

/// Parses a speed.
pub(super) fn parse_speed(text: &str) -> Result<Speed, String> {
    match text.parse::<f64>() {
        _ if text == "max" => Ok(Speed::Max),
        Ok(factor) if factor.is_finite() && 0.0 < factor => Ok(Speed::Factor(factor)),
        _ => Err("not a positive number or max".to_owned()),
    }
}

/// Counts of a played file. It shows them each second on a terminal, or each ten seconds as a line
/// elsewhere, and at the end.
pub(super) struct Progress {
    start: Instant,
    shown: Instant,
    terminal: bool,
    pub(super) skipped: u64,
    acknowledged: u64,
    positioned: u64,
    breaks: usize,
    refused: u64,
}

impl Progress {
    pub(super) fn start() -> Self {
        let now = Instant::now();
        let terminal = std::io::stderr().is_terminal();
        Self {
            start: now,
            shown: now,
            terminal,
            skipped: 0,
            acknowledged: 0,
            positioned: 0,
            breaks: 0,
            refused: 0,
        }
    }

    fn count(&mut self, acknowledged: Acknowledged) {
        for result in acknowledged.results {
            match result.refusal {
                None => self.acknowledged += 1,
                Some(refusal) => self.refuse(result.seq, &refusal),
            }
            let has_position = result.summary.is_some_and(|summary| summary.position.is_some());
            self.positioned += u64::from(has_position);
        }
        if self.interval() < self.shown.elapsed() {
            self.shown = Instant::now();
            match self.terminal {
                true => eprint!("\r{}", self.line()),
                false => note!("{}", self.line()),
            }
        }
    }

    const fn interval(&self) -> Duration {
        Duration::from_secs(if self.terminal { 1 } else { 10 })
    }

    /// Counts a refused epoch, and shows the first ones.
    fn refuse(&mut self, seq: u64, refusal: &v1::Refusal) {
        if self.refused < 10 {
            note!("epoch {seq} refused: {}: {}", refusal.code, refusal.message);
        }
        self.refused += 1;
    }

    /// Counts answers until `due`.
    ///
    /// # Errors
    /// The service refuses the stream, or does not answer again.
    pub(super) async fn until<C: Cargo>(
        &mut self,
        device: &mut DeviceStream<C>,
        due: tokio::time::Instant,
    ) -> Result<(), Failure> {
        while let Next::Acknowledged(acknowledged) = device.next(Some(due)).await? {
            self.count(acknowledged);
        }
        Ok(())
    }

    /// Counts answers until more should be sent.
    ///
    /// # Errors
    /// The service refuses the stream, or does not answer again.
    pub(super) async fn until_room<C: Cargo>(
        &mut self,
        device: &mut DeviceStream<C>,
    ) -> Result<(), Failure> {
        while !device.has_room() {
            if let Next::Acknowledged(acknowledged) = device.next(None).await? {
                self.count(acknowledged);
            }
        }
        Ok(())
    }

    /// Counts answers until everything is durable.
    ///
    /// # Errors
    /// The service refuses the stream, or does not answer again.
    pub(super) async fn end<C: Cargo>(&mut self, device: DeviceStream<C>) -> Result<(), Failure> {
        let breaks = device.close(|acknowledged| self.count(acknowledged)).await?;
        self.breaks += breaks;
        Ok(())
    }

    fn rate(&self) -> f64 {
        self.acknowledged as f64 / self.start.elapsed().as_secs_f64().max(1e-9)
    }

    fn line(&self) -> String {
        format!("{} epochs acknowledged, {:.0} a second", self.acknowledged, self.rate())
    }

    pub(super) fn close(&self) {
        if self.terminal {
            note!();
        }
        say!(
            "{}, {:.1} s; {} with a position, {} skipped as stored, {} refused, {} breaks",
            self.line(),
            self.start.elapsed().as_secs_f64(),
            self.positioned,
            self.skipped,
            self.refused,
            self.breaks
        );
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn speeds() {
        assert_eq!(parse_speed("max"), Ok(Speed::Max));
        assert_eq!(parse_speed("10"), Ok(Speed::Factor(10.0)));
        for wrong in ["0", "-1", "fast", "inf", "nan"] {
            assert!(parse_speed(wrong).is_err(), "{wrong}");
        }
    }
}
