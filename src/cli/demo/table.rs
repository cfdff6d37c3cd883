//! The output of the demo: a live table, and percentiles at the end.

use std::io::Write;
use std::time::{Duration, Instant};

use super::fleet::{Report, Sky};
use crate::cli::output::say;

/// Interval between two drawings of the table.
const EVERY: Duration = Duration::from_millis(250);
/// Interval between two lines of output without a terminal.
const LINE_EVERY: Duration = Duration::from_secs(5);

/// The last report of each device, and all errors and latencies.
pub(super) struct Table {
    last: Vec<Option<Report>>,
    epochs: Vec<u32>,
    errors_m: [Vec<f64>; 2],
    latencies_ms: Vec<f64>,
    without_position: usize,
    /// Whether the table is drawn in place on a terminal.
    live: bool,
    drawn: Option<Instant>,
    shown: Instant,
}

impl Table {
    pub(super) fn new(devices: usize, live: bool) -> Self {
        Self {
            last: vec![None; devices],
            epochs: vec![0; devices],
            errors_m: [Vec::new(), Vec::new()],
            latencies_ms: Vec::new(),
            without_position: 0,
            live,
            drawn: None,
            shown: Instant::now(),
        }
    }

    /// Takes a report, and draws the table if it is due.
    pub(super) fn take(&mut self, report: Report) {
        match report.error_m {
            Some(error_m) => self.errors_m[report.sky as usize].push(error_m),
            None => self.without_position += 1,
        }
        self.latencies_ms.push(report.latency.as_secs_f64() * 1e3);
        let index = report.index;
        self.epochs[index] += 1;
        self.last[index] = Some(report);
        if self.live && self.drawn.is_none_or(|drawn| EVERY < drawn.elapsed()) {
            self.draw();
        } else if !self.live && LINE_EVERY < self.shown.elapsed() {
            self.shown = Instant::now();
            say!("{}", self.progress());
        }
    }

    fn progress(&self) -> String {
        let done: u32 = self.epochs.iter().sum();
        let latency = percentile(&self.latencies_ms, 0.5);
        format!("{done} epochs acknowledged, latency {latency:.1} ms (median)")
    }

    fn draw(&mut self) {
        let mut text = String::new();
        if self.drawn.is_some() {
            text += &format!("\x1b[{}A", self.last.len() + 2);
        }
        text += "\x1b[2Kdevice  sky    epoch  status  satellites  error (m)  latency (ms)\n";
        for (index, report) in self.last.iter().enumerate() {
            text += "\x1b[2K";
            text += &report.as_ref().map_or_else(
                || format!("{:<6}  setting off\n", index + 1),
                |report| row(report, self.epochs[index]),
            );
        }
        text += &format!("\x1b[2K{}\n", self.progress());
        let mut output = std::io::stdout().lock();
        // An error means that standard output is closed.
        output.write_all(text.as_bytes()).and_then(|()| output.flush()).ok();
        self.drawn = Some(Instant::now());
    }

    /// Prints the last table and the percentiles of the whole run.
    pub(super) fn summarise(&mut self) {
        if self.live {
            self.draw();
        }
        say!("\n{}", self.progress());
        say!("{:>24}  {:>8}  {:>8}  {:>8}", "", "50 %", "95 %", "max");
        let [open, urban] = &self.errors_m;
        for (name, values) in [
            ("error, open sky (m)", open),
            ("error, among houses (m)", urban),
            ("latency (ms)", &self.latencies_ms),
        ] {
            if !values.is_empty() {
                let [median, high, most] = [0.5, 0.95, 1.0].map(|p| percentile(values, p));
                say!("{name:>24}  {median:>8.2}  {high:>8.2}  {most:>8.2}");
            }
        }
        say!("errors are horizontal, against the simulated truth");
        say!("{} epochs without a position", self.without_position);
    }
}

fn row(report: &Report, epochs: u32) -> String {
    let sky = match report.sky {
        Sky::Open => "open",
        Sky::Urban => "urban",
    };
    let error = report.error_m.map_or_else(|| "-".to_owned(), |error_m| format!("{error_m:.2}"));
    let latency_ms = report.latency.as_secs_f64() * 1e3;
    format!(
        "{:<6}  {sky:<5}  {epochs:>5}  {:<6}  {:>10}  {error:>9}  {latency_ms:>12.1}\n",
        report.index + 1,
        report.status,
        report.satellites
    )
}

/// The nearest-rank percentile for a fraction (0 … 1); zero without values.
fn percentile(values: &[f64], share: f64) -> f64 {
    let mut sorted = values.to_vec();
    sorted.sort_by(f64::total_cmp);
    let rank = (share * sorted.len() as f64).ceil().max(1.0) as usize;
    sorted.get(rank - 1).copied().unwrap_or(0.0)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn percentiles_by_nearest_rank() {
        let values: Vec<f64> = (1..=20).rev().map(f64::from).collect();
        let [median, high, most] = [0.5, 0.95, 1.0].map(|p| percentile(&values, p));
        assert_eq!((median, high, most), (10.0, 19.0, 20.0));
        assert_eq!(percentile(&[], 0.5), 0.0);
    }
}
