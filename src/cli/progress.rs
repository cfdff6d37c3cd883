//! Speed and progress of a file that is played.

use std::io::IsTerminal;
use std::time::{Duration, Instant};

use crate::contract::v1;

use super::device::Pushed;

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

/// Counts, shown each second on a terminal and at the end.
pub(super) struct Progress {
    start: Instant,
    shown: Instant,
    terminal: bool,
    pub(super) skipped: u64,
    acknowledged: u64,
    positioned: u64,
    recovered: u64,
    retries: usize,
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
            recovered: 0,
            retries: 0,
            refused: 0,
        }
    }

    pub(super) fn count(&mut self, pushed: &Pushed) {
        let with_position = |solution: &&v1::Solution| solution.position.is_some();
        self.acknowledged += pushed.solutions.len() as u64;
        self.positioned += pushed.solutions.iter().filter(with_position).count() as u64;
        self.recovered += pushed.recovered as u64;
        self.retries += pushed.retries;
        for (seq, words) in &pushed.refusals {
            if self.refused < 10 {
                eprintln!("epoch {seq} refused: {words}");
            }
            self.refused += 1;
        }
        if self.terminal && Duration::from_secs(1) < self.shown.elapsed() {
            self.shown = Instant::now();
            eprint!("\r{}", self.line());
        }
    }

    fn rate(&self) -> f64 {
        self.acknowledged as f64 / self.start.elapsed().as_secs_f64().max(1e-9)
    }

    fn line(&self) -> String {
        format!("{} epochs acknowledged, {:.0} a second", self.acknowledged, self.rate())
    }

    pub(super) fn close(&self) {
        if self.terminal {
            eprintln!();
        }
        println!(
            "{}, {:.1} s; {} with a position, {} skipped as stored, {} found stored after a break, \
             {} refused, {} retries",
            self.line(),
            self.start.elapsed().as_secs_f64(),
            self.positioned,
            self.skipped,
            self.recovered,
            self.refused,
            self.retries
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
