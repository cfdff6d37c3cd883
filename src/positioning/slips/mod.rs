//! Cycle slips: which carrier phases share an ambiguity.
//!
//! A [`SlipTracker`] follows the phases of one receiver; rover and base have one each. It gives
//! every phase an *arc*, a number that no other arc of the tracker ever has: two phases of one
//! satellite and code have the same ambiguity if they have the same arc. Detectors, each reported
//! by its [`SlipCause`]:
//!
//! - loss-of-lock indicator, half-cycle flag and power failure, as the receiver says;
//! - a gap, where nothing bridges it;
//! - geometry-free combination and Melbourne–Wübbena, between the signals of one satellite;
//! - Doppler against phase;
//! - time-differenced residuals, between all satellites: it alone sees a slip of one cycle on a
//!   single frequency, and where it says that a phase goes on, the doubts of Melbourne–Wübbena and
//!   Doppler, which code multipath and jerk also raise, end no arc.
//!
//! The state is plain and bounded; the same epochs give the same arcs.

mod causes;
mod combinations;
mod doppler;
mod time_difference;
mod track;

use crate::gnss::constants::SPEED_OF_LIGHT;
use crate::gnss::{
    Cycles, Ecef, Ephemeris, Epoch, GpsTime, LocalFrame, Meters, Navigation, Observation,
    ObservationCode, SatelliteId,
};
use crate::models::troposphere::{Mapping, Troposphere};
use crate::models::{SatelliteState, look_angles, select_ephemeris, state_at_transmission};

pub use causes::{SlipCause, SlipCauses};
pub use track::AntennaPosition;

use time_difference::Row;
use track::{Candidate, Odometer, Sample, Sight, Track, Trend, Verdict};

/// A signal unseen for longer than this, and than 2.5 intervals, begins anew unless proven (s).
const GAP_S: f64 = 10.0;
const GAP_INTERVALS: f64 = 2.5;
/// A signal unseen for longer is forgotten (s).
const FORGOTTEN_S: f64 = 1_800.0;
/// Signals of an epoch, and histories kept; more than receivers track.
const SIGNALS_LIMIT: usize = 1_024;
/// Relative humidity of the standard atmosphere, 0 … 1.
const RELATIVE_HUMIDITY: f64 = 0.7;

/// A satellite as an epoch saw it.
#[derive(Clone, Copy, Debug)]
pub struct KnownSatellite<'a> {
    /// The ephemeris in use.
    pub ephemeris: &'a Ephemeris,
    /// Its state at transmission.
    pub state: SatelliteState,
    /// The pseudorange that gave the time of transmission (m).
    pub pseudorange_m: f64,
}

impl<'a> KnownSatellite<'a> {
    /// The satellites of an epoch that have an ephemeris and a pseudorange, in the epoch's order.
    pub fn of_epoch(epoch: &Epoch, navigation: &'a Navigation) -> Vec<Self> {
        let known = epoch.by_satellite().filter_map(|(satellite, observations)| {
            let ephemeris = select_ephemeris(navigation, satellite, epoch.time)?;
            let measured = |o: &Observation| o.pseudorange_m.filter(|range_m| range_m.is_finite());
            let pseudorange_m = observations.iter().find_map(measured)?;
            let state = state_at_transmission(ephemeris, epoch.time, pseudorange_m);
            Some(Self { ephemeris, state, pseudorange_m })
        });
        known.collect()
    }
}

/// The arc to which a carrier phase belongs.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PhaseArc {
    /// The satellite.
    pub satellite: SatelliteId,
    /// Its observation code.
    pub code: ObservationCode,
    /// The arc's number; phases of one arc share an ambiguity.
    pub number: u32,
    /// Tag of the arc's first phase.
    pub since: GpsTime,
    /// The ambiguity may be off an integer by a half.
    pub half_cycle: bool,
    /// The arc begins with this epoch: for the causes below, or with the signal itself.
    pub begins: bool,
    /// What the detectors found at this epoch, whether or not it ended an arc.
    pub causes: SlipCauses,
}

/// Whether an antenna stands on a marker or moves.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum AntennaMotion {
    /// It stands.
    Static,
    /// It may move.
    Moving,
}

/// Follows the carrier phases of one receiver.
#[derive(Debug)]
pub struct SlipTracker {
    progress: Progress,
    /// By satellite and code.
    tracks: Vec<Track>,
    /// Of the last epoch, by satellite and code.
    arcs: Vec<PhaseArc>,
    // Memory that is used again.
    candidates: Vec<Candidate>,
    rows: Vec<Row>,
    scratch: Vec<f64>,
}

/// How far a tracker has come.
#[derive(Clone, Copy, Debug)]
struct Progress {
    motion: AntennaMotion,
    last: Option<GpsTime>,
    /// Shortest time between two epochs so far (s).
    interval_s: f64,
    next_arc: u32,
    /// Sum of what the receiver's clock stepped in the pseudoranges alone (m).
    code_offset_m: f64,
    odometer: Odometer,
}

impl Clone for SlipTracker {
    fn clone(&self) -> Self {
        let mut clone = Self::new(self.progress.motion);
        clone.clone_from(self);
        clone
    }

    fn clone_from(&mut self, source: &Self) {
        self.progress = source.progress;
        self.tracks.clone_from(&source.tracks);
        self.arcs.clone_from(&source.arcs);
    }
}

impl SlipTracker {
    /// A tracker that has seen nothing.
    pub fn new(motion: AntennaMotion) -> Self {
        let progress = Progress {
            motion,
            last: None,
            interval_s: f64::INFINITY,
            next_arc: 1,
            code_offset_m: 0.0,
            odometer: Odometer::default(),
        };
        Self {
            progress,
            tracks: Vec::new(),
            arcs: Vec::new(),
            candidates: Vec::new(),
            rows: Vec::new(),
            scratch: Vec::new(),
        }
    }

    /// Takes over the next epoch; [`arcs`](Self::arcs) then names its arcs.
    ///
    /// `satellites` are those of the epoch that are known (for all: [`KnownSatellite::of_epoch`]);
    /// GLONASS phases without one have no frequency and get no arc. Without `antenna`, and with too
    /// few satellites, time-differenced residuals stay untested; a position off by 10 m does for
    /// intervals of some seconds. An epoch that is not later than the last one gets no arcs and
    /// changes nothing.
    pub fn advance(
        &mut self,
        epoch: &Epoch,
        satellites: &[KnownSatellite<'_>],
        antenna: Option<AntennaPosition>,
    ) {
        self.arcs.clear();
        if self.progress.last.is_some_and(|last| epoch.time <= last) {
            return;
        }
        if let Some(last) = self.progress.last {
            self.progress.interval_s = self.progress.interval_s.min(epoch.time - last);
        }
        self.gather(epoch, satellites, antenna);
        self.hear_receiver(epoch);
        let step_m = combinations::code_step_m(
            &self.candidates,
            &self.tracks,
            self.progress.last,
            &mut self.scratch,
        );
        self.progress.code_offset_m += step_m;
        let step = antenna.and_then(|antenna| self.time_difference(antenna));
        self.compare_signals();
        let is_static = self.progress.motion == AntennaMotion::Static;
        doppler::compare(&mut self.candidates, &self.tracks, is_static, &mut self.scratch);
        self.mark_gaps();
        self.settle(epoch, antenna.zip(step));
    }

    /// The arcs of the last epoch's carrier phases, by satellite and code.
    pub fn arcs(&self) -> &[PhaseArc] {
        &self.arcs
    }

    /// The arc of one carrier phase of the last epoch.
    pub fn arc(&self, satellite: SatelliteId, code: ObservationCode) -> Option<&PhaseArc> {
        let found = self.arcs.binary_search_by_key(&(satellite, code), |a| (a.satellite, a.code));
        found.ok().map(|index| &self.arcs[index])
    }

    /// The epoch's carrier phases by satellite and code, each with its history.
    fn gather(
        &mut self,
        epoch: &Epoch,
        satellites: &[KnownSatellite<'_>],
        antenna: Option<AntennaPosition>,
    ) {
        self.candidates.clear();
        let surroundings = antenna.map(|antenna| Surroundings::at(antenna.position, epoch.time));
        for (satellite, observations) in epoch.by_satellite() {
            let known = satellites.iter().find(|known| known.ephemeris.satellite() == satellite);
            let sight = known.zip(surroundings.as_ref()).map(|(known, around)| around.sight(known));
            let channel = known.and_then(|known| known.ephemeris.glonass_channel());
            for observation in observations {
                let sample = sample(epoch.time, observation, channel, sight.flatten());
                let room = self.candidates.len() < SIGNALS_LIMIT;
                let Some(sample) = sample.filter(|_| room) else { continue };
                let track = self.track_of(sample.satellite, sample.code);
                if let (Some(track), Some(known)) = (track, known) {
                    follow_issue(&mut self.tracks[track].last, known);
                }
                let (causes, verdict) = (SlipCauses::default(), Verdict::Untested);
                self.candidates.push(Candidate { sample, track, causes, verdict, miss_m: 0.0 });
            }
        }
        self.candidates.sort_by_key(|c| (c.sample.satellite, c.sample.code));
        self.candidates.dedup_by_key(|c| (c.sample.satellite, c.sample.code));
    }

    fn track_of(&self, satellite: SatelliteId, code: ObservationCode) -> Option<usize> {
        let key = |track: &Track| (track.last.satellite, track.last.code);
        self.tracks.binary_search_by_key(&(satellite, code), key).ok()
    }

    /// What the receiver itself says.
    fn hear_receiver(&mut self, epoch: &Epoch) {
        for observation in epoch.observations.iter().filter(|o| o.carrier_phase.is_none()) {
            let track = self.track_of(observation.satellite, observation.code);
            if let Some(track) = track.filter(|_| observation.loss_of_lock) {
                self.tracks[track].was_lost = true;
            }
        }
        for candidate in &mut self.candidates {
            let track = candidate.track.map(|track| &self.tracks[track]);
            if epoch.power_failure {
                candidate.causes.insert(SlipCause::PowerFailure);
            }
            if candidate.sample.loss_of_lock || track.is_some_and(|track| track.was_lost) {
                candidate.causes.insert(SlipCause::LossOfLock);
            }
            if track.is_some_and(|track| track.last.half_cycle != candidate.sample.half_cycle) {
                candidate.causes.insert(SlipCause::HalfCycle);
            }
        }
        if epoch.power_failure {
            // Signals that are missing now come back under the new power.
            self.tracks.iter_mut().for_each(|track| track.was_lost = true);
        }
    }

    /// Tests the phases against one another; returns displacement and clock change.
    fn time_difference(&mut self, antenna: AntennaPosition) -> Option<nalgebra::Vector4<f64>> {
        let step = time_difference::test(
            &mut self.candidates,
            &self.tracks,
            self.progress.last,
            antenna,
            self.progress.motion == AntennaMotion::Static,
            &mut self.rows,
        );
        let odometer = &mut self.progress.odometer;
        let Some(step) = step else {
            *odometer = Odometer { run: odometer.run.wrapping_add(1), ..Odometer::default() };
            return None;
        };
        odometer.moved_m += step.xyz();
        odometer.clock_m += step.w;
        let (candidates, tracks) = (&mut self.candidates, &self.tracks);
        time_difference::test_returned(candidates, tracks, self.progress.last, antenna, odometer);
        Some(step)
    }

    /// Compares the signals of each satellite.
    fn compare_signals(&mut self) {
        let (tracks, code_offset_m) = (&self.tracks, self.progress.code_offset_m);
        let same = |a: &Candidate, b: &Candidate| a.sample.satellite == b.sample.satellite;
        for group in self.candidates.chunk_by_mut(same) {
            combinations::geometry_free(group, tracks);
            combinations::melbourne_wuebbena(group, tracks, code_offset_m);
            time_difference::excuse_common(group);
        }
    }

    /// Marks signals that were away for long, unless the other satellites vouch for them.
    fn mark_gaps(&mut self) {
        let longest_s = GAP_S.max(GAP_INTERVALS * self.progress.interval_s);
        for candidate in &mut self.candidates {
            let Some(track) = candidate.continued(&self.tracks) else { continue };
            let elapsed_s = candidate.sample.time - track.last.time;
            if longest_s < elapsed_s && candidate.verdict != Verdict::Continues {
                candidate.causes.insert(SlipCause::Gap);
            }
        }
    }

    /// Names the arcs and keeps what the next epoch needs.
    fn settle(&mut self, epoch: &Epoch, step: Option<(AntennaPosition, nalgebra::Vector4<f64>)>) {
        let mut pairings = Vec::with_capacity(self.candidates.len());
        let same = |a: &Candidate, b: &Candidate| a.sample.satellite == b.sample.satellite;
        for group in self.candidates.chunk_by(same) {
            let goes_on = |index: usize| !ends_arc(&group[index]);
            let put = |_, pairing| pairings.push(pairing);
            combinations::next_pairings(
                group,
                &self.tracks,
                goes_on,
                self.progress.code_offset_m,
                put,
            );
        }
        let known = self.tracks.len();
        for (index, pairing) in pairings.into_iter().enumerate() {
            let candidate = self.candidates[index];
            let begins = candidate.track.is_none() || ends_arc(&candidate);
            let mut next = self.next_track(&candidate, begins, step);
            next.pairing = pairing;
            self.arcs.push(PhaseArc {
                satellite: next.last.satellite,
                code: next.last.code,
                number: next.arc,
                since: next.since,
                half_cycle: next.last.half_cycle,
                begins,
                causes: candidate.causes,
            });
            match candidate.track {
                Some(track) => self.tracks[track] = next,
                None => self.tracks.push(next),
            }
        }
        if known < self.tracks.len() {
            self.tracks.sort_by_key(|track| (track.last.satellite, track.last.code));
        }
        self.tracks.retain(|track| epoch.time - track.last.time <= FORGOTTEN_S);
        if SIGNALS_LIMIT < self.tracks.len() {
            self.tracks.retain(|track| track.last.time == epoch.time);
        }
        self.progress.last = Some(epoch.time);
    }

    fn next_track(
        &mut self,
        candidate: &Candidate,
        begins: bool,
        step: Option<(AntennaPosition, nalgebra::Vector4<f64>)>,
    ) -> Track {
        let before = candidate.track.map(|track| &self.tracks[track]);
        let mut trend = before.map_or(Trend::new(), |track| track.trend);
        let seen_last = before.filter(|track| Some(track.last.time) == self.progress.last);
        if let (Some(track), Some((antenna, step))) = (seen_last, step)
            && let Some((drift_m, noise_m2)) =
                time_difference::drift(candidate, track, antenna, &step)
        {
            let elapsed_s = candidate.sample.time - track.last.time;
            match (candidate.verdict, begins) {
                (Verdict::Slipped | Verdict::Shared, _) => {
                    trend.doubt(drift_m, noise_m2, elapsed_s)
                }
                (_, true) => {}
                (_, false) => trend.learn(drift_m, noise_m2, elapsed_s),
            }
        }
        let (arc, since) = match before.filter(|_| !begins) {
            Some(track) => (track.arc, track.since),
            None => {
                self.progress.next_arc = self.progress.next_arc.wrapping_add(1);
                (self.progress.next_arc.wrapping_sub(1), candidate.sample.time)
            }
        };
        let (last, odometer) = (candidate.sample, self.progress.odometer);
        Track { last, arc, since, was_lost: false, odometer, trend, pairing: None }
    }
}

/// Whether the causes found end the arc.
fn ends_arc(candidate: &Candidate) -> bool {
    let is_proven = candidate.verdict == Verdict::Continues;
    candidate.causes.iter().any(|cause| match cause {
        SlipCause::MelbourneWuebbena | SlipCause::Doppler => !is_proven,
        SlipCause::TimeDifference => candidate.verdict == Verdict::Slipped,
        _ => true,
    })
}

/// A carrier phase with its frequency; `None` for what cannot be used.
fn sample(
    time: GpsTime,
    observation: &Observation,
    channel: Option<i8>,
    sight: Option<Sight>,
) -> Option<Sample> {
    let phase = observation.carrier_phase.filter(|phase| phase.0.is_finite())?;
    let frequency_hz = observation.signal().frequency_hz(channel)?;
    let wavelength_m = SPEED_OF_LIGHT / frequency_hz;
    let length_m = |cycles: f64| Cycles(cycles).to_meters(Meters(wavelength_m)).0;
    let finite = |value: Option<f64>| value.filter(|value| value.is_finite());
    Some(Sample {
        satellite: observation.satellite,
        code: observation.code,
        time,
        frequency_hz,
        wavelength_m,
        phase_m: length_m(phase.0),
        pseudorange_m: finite(observation.pseudorange_m),
        range_rate_m_s: finite(observation.doppler_hz).map(|doppler_hz| length_m(-doppler_hz)),
        cn0_db_hz: finite(observation.cn0_db_hz),
        half_cycle: observation.half_cycle,
        loss_of_lock: observation.loss_of_lock,
        sight,
    })
}

/// What surrounds the antenna.
struct Surroundings {
    frame: LocalFrame,
    troposphere: Option<Troposphere>,
}

impl Surroundings {
    fn at(position: Ecef, time: GpsTime) -> Self {
        let geodetic = position.to_geodetic();
        let humidity = RELATIVE_HUMIDITY;
        let troposphere = Troposphere::saastamoinen(&geodetic, time, humidity, Mapping::Niell);
        Self { frame: LocalFrame::at(position), troposphere }
    }

    /// The satellite above the horizon.
    fn sight(&self, known: &KnownSatellite<'_>) -> Option<Sight> {
        let look = look_angles(&self.frame, known.state.position);
        let troposphere = self.troposphere.as_ref().filter(|_| 0.0 < look.elevation_rad)?;
        Some(Sight {
            position: known.state.position,
            clock_m: known.state.clock_m,
            troposphere_m: troposphere.slant_delay_m(look.elevation_rad),
            pseudorange_m: known.pseudorange_m,
            issue: issue(known.ephemeris),
        })
    }
}

fn issue(ephemeris: &Ephemeris) -> (GpsTime, GpsTime, u32) {
    (ephemeris.toe(), ephemeris.toc(), ephemeris.issue())
}

/// Puts the last state of a satellite on the ephemeris now in use, whose orbit and clock may be
/// metres from those of the one before.
fn follow_issue(last: &mut Sample, known: &KnownSatellite<'_>) {
    let Some(sight) = &mut last.sight else { return };
    if sight.issue != issue(known.ephemeris) {
        let state = state_at_transmission(known.ephemeris, last.time, sight.pseudorange_m);
        sight.position = state.position;
        sight.clock_m = state.clock_m;
        sight.issue = issue(known.ephemeris);
    }
}
