//! The demo's batch job: the recording of a drive between high buildings, sent as files.

use std::sync::Arc;

use crate::cli::Failure;
use crate::cli::connection::{Connection, JobFile};
use crate::cli::simulate;
use crate::contract::v1;
use crate::formats::rinex::{ObservationWriter, RinexWriteError};
use crate::gnss::{GpsTime, Navigation};
use crate::refusal::Code;
use crate::simulation::{Scenario, Simulator};

/// Duration of the recording, which ends at the start of the fleet (s).
const DURATION_S: f64 = 900.0;

/// Simulates the recording and sends it; returns the id of the job.
///
/// # Errors
/// The service refuses it.
pub(super) async fn submit(
    connection: Connection,
    end: GpsTime,
    seed: u64,
    navigation: Arc<Navigation>,
) -> Result<String, Failure> {
    let simulated = tokio::task::spawn_blocking(move || files(end, seed, navigation));
    let failed = |error: &dyn std::error::Error| Failure::new(Code::Internal, error, "report this");
    let files = simulated.await.map_err(|panic| failed(&panic))?;
    let options = v1::JobOptions {
        mode: "rtk-fgo".to_owned(),
        smoothed: true,
        format: "csv".to_owned(),
        ..Default::default()
    };
    connection.create_job(options, files.map_err(|error| failed(&error))?).await
}

/// Observations of the rover and its base in RINEX 3. The service has the ephemerides.
fn files(
    end: GpsTime,
    seed: u64,
    navigation: Arc<Navigation>,
) -> Result<Vec<JobFile>, RinexWriteError> {
    let scenario =
        Scenario { start: end + -DURATION_S, duration_s: DURATION_S, ..Scenario::rtk_canyon() };
    let simulator = Simulator::with_navigation(scenario.clone(), seed, navigation.clone());
    let position = simulator.base_position();
    let writer = |name, position| {
        let header = simulate::header(name, &scenario, position, &navigation);
        ObservationWriter::new(Vec::new(), &header)
    };
    let (mut rover, mut base) = (writer("rover", None)?, writer("base", position)?);
    for epoch in simulator {
        rover.write_epoch(&epoch.rover)?;
        if let Some(observed) = &epoch.base {
            base.write_epoch(observed)?;
        }
    }
    let file = |part, name, content| JobFile { part, name, content };
    Ok(vec![file("rover", "street.obs", rover.finish()?), file("base", "roof.obs", base.finish()?)])
}
