//! The simulated devices: each drives, observes and pushes epoch by epoch.

use std::f64::consts::{PI, TAU};
use std::sync::Arc;
use std::time::Duration;

use tokio::sync::mpsc;
use tokio::time::Instant;

use crate::cli::Failure;
use crate::cli::cargo::Epochs;
use crate::cli::connection::Connection;
use crate::cli::device_stream::{Acknowledged, DeviceStream};
use crate::contract::{convert, v1};
use crate::gnss::{Ecef, Geodetic, GpsTime, LocalFrame, Navigation};
use crate::simulation::{Scenario, SimulatedEpoch, Simulator};

/// Fraction of the drive after which the courier sends nothing more.
const LOST_AFTER: f64 = 0.4;
/// Distance of the first device from the middle of the fleet (m); the others are farther out.
const SPREAD_M: f64 = 900.0;
/// Length of a degree of latitude (m).
const DEGREE_M: f64 = 111_000.0;

/// Surroundings of a device.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Sky {
    Open,
    Urban,
}

/// The kind of a device. It decides how the device is positioned.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Kind {
    /// Relative to a base 8 km away, under open sky: mostly fixed.
    Surveyor,
    /// Factor graph among high buildings.
    Taxi,
    /// Relative to a base 3 km away, among high buildings: mostly float.
    Van,
    /// Single-point positioning under open sky.
    Tracker,
    /// A surveyor whose base sends nothing for a part of every minute and a half.
    Tractor,
    /// Factor graph under open sky; it sends nothing more after a fraction of the drive.
    Courier,
}

impl Kind {
    /// The kind of a device of the fleet.
    pub(super) const fn of(index: usize) -> Self {
        match index % 6 {
            0 => Self::Surveyor,
            1 => Self::Taxi,
            2 => Self::Van,
            3 => Self::Tracker,
            4 => Self::Tractor,
            _ => Self::Courier,
        }
    }

    pub(super) const fn sky(self) -> Sky {
        match self {
            Self::Taxi | Self::Van => Sky::Urban,
            Self::Surveyor | Self::Tracker | Self::Tractor | Self::Courier => Sky::Open,
        }
    }

    /// Name, mode and profile of its session.
    const fn session(self) -> (&'static str, &'static str, &'static str) {
        match self {
            Self::Surveyor => ("surveyor", "rtk-fgo", "general"),
            Self::Taxi => ("taxi", "fgo", "urban-vehicle"),
            Self::Van => ("delivery van", "rtk-fgo", "urban-vehicle"),
            Self::Tracker => ("tracker", "spp", "general"),
            Self::Tractor => ("tractor", "rtk-fgo", "general"),
            Self::Courier => ("courier", "fgo", "general"),
        }
    }

    fn scenario(self) -> Scenario {
        let without_base = |scenario: Scenario| Scenario { base: None, ..scenario };
        match self {
            Self::Surveyor | Self::Tractor => Scenario::rtk_open(),
            Self::Van => Scenario::rtk_canyon(),
            Self::Taxi => without_base(Scenario::urban_canyon()),
            Self::Tracker | Self::Courier => without_base(Scenario::open_sky()),
        }
    }

    /// Whether the base's epoch of this number reaches the service.
    const fn receives_base(self, number: usize) -> bool {
        !matches!(self, Self::Tractor) || number % 90 < 50
    }
}

/// Plan of one device's drive.
#[derive(Clone, Copy, Debug)]
pub(super) struct Plan {
    pub(super) index: usize,
    pub(super) seed: u64,
    /// Time tag of the first epoch.
    pub(super) start: GpsTime,
    /// Duration of the first part of the drive, which is reported (s).
    pub(super) duration_s: f64,
    /// Duration of the second part of the drive, in real time (s).
    pub(super) live_s: f64,
    /// Speed of the first part relative to real time.
    pub(super) speed: f64,
}

impl Plan {
    pub(super) const fn kind(&self) -> Kind {
        Kind::of(self.index)
    }

    fn scenario(&self) -> Scenario {
        let scenario = self.kind().scenario();
        // A spiral of the golden angle: no two devices are near each other.
        let (distance_m, angle) = (
            SPREAD_M * (self.index as f64 + 1.0).sqrt(),
            self.index as f64 * PI * (3.0 - 5_f64.sqrt()),
        );
        let (east_m, north_m) = (distance_m * (angle % TAU).sin(), distance_m * angle.cos());
        let Geodetic { latitude_rad, longitude_rad, height_m } = scenario.origin;
        let degree_rad = 1_f64.to_radians() / DEGREE_M;
        let origin = Geodetic {
            latitude_rad: latitude_rad + north_m * degree_rad,
            longitude_rad: longitude_rad + east_m * degree_rad / latitude_rad.cos(),
            height_m,
        };
        let is_lost = self.kind() == Kind::Courier;
        let duration_s = match is_lost {
            true => (self.duration_s * LOST_AFTER).floor(),
            false => self.duration_s + self.live_s,
        };
        Scenario { start: self.start, duration_s, origin, ..scenario }
    }

    /// Delay from the start until an epoch is due. The epoch is `elapsed_s` later than the first.
    fn due(&self, elapsed_s: f64) -> Duration {
        let fast_s = elapsed_s.min(self.duration_s);
        Duration::from_secs_f64(fast_s / self.speed + (elapsed_s - fast_s))
    }
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
    let scenario = plan.scenario();
    let interval_s = scenario.interval_s;
    let simulator = Simulator::with_navigation(scenario, plan.seed, navigation);
    let (name, mode, profile) = plan.kind().session();
    let label = format!("{name} {}", plan.index + 1);
    let base = match simulator.base_position() {
        Some(position) => connection.create_base(base_request(&label, position)).await?,
        None => String::new(),
    };
    let (mode, profile) = (mode.to_owned(), profile.to_owned());
    let new =
        v1::CreateSessionRequest { label, mode, profile, base: base.clone(), ..Default::default() };
    let session = connection.session(None, new).await?.session;
    let mut device = DeviceStream::new((&connection, Epochs), &session, v1::Answers::Full, 0);
    // Each device starts at another fraction of the interval, so that their pushes are spread.
    let fraction = plan.index as f64 * 0.618 % 1.0;
    let start = Instant::now() + Duration::from_secs_f64(interval_s / plan.speed).mul_f64(fraction);
    let mut reports = Some(reports);
    for (number, simulated) in simulator.enumerate() {
        let elapsed_s = number as f64 * interval_s;
        tokio::time::sleep_until(start + plan.due(elapsed_s)).await;
        if plan.duration_s < elapsed_s {
            reports = None; // The table is complete; the drive goes on.
        }
        let SimulatedEpoch { rover, base: observed, position, .. } = simulated;
        if let Some(observed) = observed.filter(|_| plan.kind().receives_base(number)) {
            connection.push_base(&base, vec![convert::epoch_message(0, &observed)]).await?;
        }
        let epoch = convert::epoch_message(number as u64 + 1, &rover);
        let (seq, request) = (epoch.seq, v1::StreamRequest { opening: None, epochs: vec![epoch] });
        device.send(request, 1, seq, Instant::now());
        let mut answers = Vec::new();
        device.settle(|answer| answers.push(answer)).await?;
        let Some(reports) = &reports else { continue };
        for report in answers.iter().flat_map(|answer| reports_of(&plan, answer, position)) {
            // An error means that the table is closed.
            reports.send(report).await.ok();
        }
    }
    Ok(())
}

/// The reports of an answer to one epoch.
fn reports_of<'a>(
    plan: &'a Plan,
    answer: &'a Acknowledged,
    truth: Ecef,
) -> impl Iterator<Item = Report> + 'a {
    let latency = answer.delays.first().copied().unwrap_or_default();
    let solutions = answer.results.iter().filter_map(|result| result.solution.as_ref());
    solutions.map(move |solution| report(plan, solution, truth, latency))
}

fn base_request(label: &str, Ecef(position): Ecef) -> v1::CreateBaseRequest {
    v1::CreateBaseRequest {
        label: format!("base of {label}"),
        marker: Some(v1::Ecef { x_m: position.x, y_m: position.y, z_m: position.z }),
        ..Default::default()
    }
}

fn report(plan: &Plan, solution: &v1::Solution, truth: Ecef, latency: Duration) -> Report {
    let error_m = solution.position.as_ref().and_then(|position| position.ecef).map(|ecef| {
        let position = Ecef::new(ecef.x_m, ecef.y_m, ecef.z_m);
        LocalFrame::at(truth).to_enu(position).0.xy().norm()
    });
    Report {
        index: plan.index,
        sky: plan.kind().sky(),
        status: solution.status().as_str_name().trim_start_matches("STATUS_"),
        satellites: solution.satellites_used.len(),
        error_m,
        latency,
    }
}
