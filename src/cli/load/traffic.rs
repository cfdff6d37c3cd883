//! What the devices of a load send: one simulated drive, as epochs or as the bytes of a receiver.

use bytes::Bytes;

use crate::cli::Failure;
use crate::cli::connection::Connection;
use crate::clock;
use crate::config::Mode;
use crate::contract::{convert, v1};
use crate::formats::receiver::RawxWriter;
use crate::formats::rinex::write_navigation;
use crate::gnss::{Band, Ecef, GpsTime, LeapSeconds, Observation, Signal};
use crate::refusal::Code;
use crate::simulation::{Scenario, Simulator};

use super::schedule::Schedule;

/// Number of different epochs of the drive at which the devices begin.
const OFFSETS: usize = 60;
/// Epochs of a base in one push.
const BASE_BATCH: usize = 200;
const SEED: u64 = 1;

/// The content of the messages, by epoch.
pub(super) enum Content {
    Epochs(Vec<v1::Epoch>),
    /// Frames of UBX-RXM-RAWX.
    Raw(Vec<Bytes>),
}

/// The observations that all devices and their base send.
pub(super) struct Traffic {
    pub(super) content: Content,
    /// RINEX navigation file.
    navigation: Bytes,
    /// Epochs and position of the base; `None` for modes that use none.
    base: Option<(Vec<v1::Epoch>, Ecef)>,
    observations: usize,
    has_one_band: bool,
}

impl Traffic {
    /// Simulates the drive. Its last epoch is about now, so that no device sends from the future.
    ///
    /// # Errors
    /// The navigation data cannot be written.
    pub(super) fn simulate(
        mode: Mode,
        (raw, has_one_band): (bool, bool),
        schedule: Schedule,
    ) -> Result<Self, Failure> {
        let epochs = schedule.epochs + OFFSETS;
        let duration_s = schedule.interval_s * epochs as f64;
        let scenario = match mode.is_relative() {
            true => Scenario::rtk_open(),
            false => Scenario { base: None, ..Scenario::open_sky() },
        };
        let now_ms = clock::unix_ms() / 1000 * 1000;
        let start = GpsTime::from_unix_ms(now_ms, &LeapSeconds::table()) + -duration_s;
        let scenario = Scenario { start, duration_s, interval_s: schedule.interval_s, ..scenario };
        let simulator = Simulator::new(scenario, SEED);
        let mut navigation = Vec::new();
        write_navigation(&mut navigation, simulator.navigation())
            .map_err(|error| Failure::new(Code::Internal, error, "report this"))?;
        let base_position = simulator.base_position();
        let (mut rover, mut base) = (Vec::new(), Vec::new());
        for mut simulated in simulator.take(epochs) {
            if has_one_band {
                simulated.rover.observations.retain(is_on_l1);
            }
            rover.push(simulated.rover);
            base.extend(simulated.base.map(|epoch| convert::epoch_message(0, &epoch)));
        }
        let observations = rover.iter().map(|epoch| epoch.observations.len()).sum();
        let content = match raw {
            false => {
                let messages = rover.iter().map(|epoch| convert::epoch_message(0, epoch));
                Content::Epochs(messages.collect())
            }
            true => {
                let mut writer = RawxWriter::default();
                Content::Raw(rover.iter().map(|epoch| writer.frame(epoch).into()).collect())
            }
        };
        let base = base_position.map(|position| (base, position));
        Ok(Self { content, navigation: navigation.into(), base, observations, has_one_band })
    }

    /// A description of the messages, for people.
    pub(super) fn description(&self) -> String {
        let (what, count) = match &self.content {
            Content::Epochs(epochs) => ("messages", epochs.len()),
            Content::Raw(frames) => ("frames of UBX-RXM-RAWX", frames.len()),
        };
        let mean = self.observations as f64 / count as f64;
        let bands = if self.has_one_band { "one band" } else { "two bands" };
        format!("{what} of {mean:.1} observations on {bands}")
    }

    /// Index of the first epoch that a device sends.
    pub(super) const fn offset(&self, device: usize) -> usize {
        device % OFFSETS
    }

    /// Pushes ephemerides, and creates and fills the base. Returns the base's id, which is empty
    /// without one.
    ///
    /// # Errors
    /// The service refuses them, or does not answer.
    pub(super) async fn prepare(&self, connection: &Connection) -> Result<String, Failure> {
        connection.push_navigation_bytes(self.navigation.clone()).await?;
        let Some((epochs, Ecef(position))) = &self.base else { return Ok(String::new()) };
        let request = v1::CreateBaseRequest {
            label: "base of load".to_owned(),
            marker: Some(v1::Ecef { x_m: position.x, y_m: position.y, z_m: position.z }),
            ..Default::default()
        };
        let base = connection.create_base(request).await?;
        for epochs in epochs.chunks(BASE_BATCH) {
            connection.push_base(&base, epochs.to_vec()).await?;
        }
        Ok(base)
    }
}

fn is_on_l1(observation: &Observation) -> bool {
    Signal::of(observation.satellite, observation.code).band() == Some(Band::L1)
}
