//! The simulated devices: each drives, observes and pushes epoch by epoch.

use std::sync::Arc;
use std::time::Duration;

use tokio::sync::mpsc;
use tokio::time::Instant;

use crate::cli::Failure;
use crate::cli::device::Connection;
use crate::contract::{convert, v1};
use crate::gnss::{Ecef, LocalFrame, Navigation};
use crate::simulation::{Scenario, Simulator};

/// Surroundings of a device.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Sky {
    Open,
    Urban,
}

/// Plan of one device's drive.
#[derive(Clone, Copy, Debug)]
pub(super) struct Plan {
    pub(super) index: usize,
    pub(super) sky: Sky,
    pub(super) seed: u64,
    pub(super) duration_s: f64,
    /// Speed relative to real time.
    pub(super) speed: f64,
}

/// The result of one epoch.
#[derive(Clone, Debug)]
pub(super) struct Report {
    pub(super) index: usize,
    pub(super) sky: Sky,
    /// The service's name of the status.
    pub(super) status: &'static str,
    pub(super) satellites: usize,
    /// Horizontal error against the truth (m), if there is a position.
    pub(super) error_m: Option<f64>,
    /// Time from sending to the durable answer.
    pub(super) latency: Duration,
}

/// Drives to the end of the plan and pushes each epoch when it is due.
pub(super) async fn drive(
    plan: Plan,
    navigation: Arc<Navigation>,
    connection: Connection,
    reports: mpsc::Sender<Report>,
) -> Result<(), Failure> {
    let (scenario, name, mode, profile) = match plan.sky {
        Sky::Open => (Scenario::open_sky(), "open", "spp", "general"),
        Sky::Urban => (Scenario::urban_canyon(), "urban", "fgo", "urban-vehicle"),
    };
    let scenario = Scenario { duration_s: plan.duration_s, base: None, ..scenario };
    let interval = Duration::from_secs_f64(scenario.interval_s / plan.speed);
    let simulator = Simulator::with_navigation(scenario, plan.seed, navigation);
    let label = format!("demo {} {name}", plan.index + 1);
    let (mode, profile) = (mode.to_owned(), profile.to_owned());
    let new = v1::CreateSessionRequest { label, mode, profile, ..Default::default() };
    let mut device = connection.open(None, new).await?;
    // Each device starts at another fraction of the interval, so that their pushes are spread.
    let start = Instant::now() + interval.mul_f64(plan.index as f64 * 0.618 % 1.0);
    for (number, simulated) in simulator.enumerate() {
        tokio::time::sleep_until(start + interval * number as u32).await;
        let epoch = convert::epoch_message(number as u64 + 1, &simulated.rover);
        let sent = Instant::now();
        let pushed = device.push(vec![epoch]).await?;
        let latency = sent.elapsed();
        for solution in &pushed.solutions {
            let report = report(&plan, solution, simulated.position, latency);
            // An error means that nobody watches any more.
            reports.send(report).await.ok();
        }
    }
    Ok(())
}

fn report(plan: &Plan, solution: &v1::Solution, truth: Ecef, latency: Duration) -> Report {
    let error_m = solution.position.as_ref().and_then(|position| position.ecef).map(|ecef| {
        let position = Ecef::new(ecef.x_m, ecef.y_m, ecef.z_m);
        LocalFrame::at(truth).to_enu(position).0.xy().norm()
    });
    Report {
        index: plan.index,
        sky: plan.sky,
        status: solution.status().as_str_name().trim_start_matches("STATUS_"),
        satellites: solution.satellites_used.len(),
        error_m,
        latency,
    }
}
