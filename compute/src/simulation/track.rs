//! A tracked signal: its strength, its slips and its errors.

use super::city::Arrival;
use super::random::{GaussMarkov, Random};
use super::scenario::ReceiverErrors;
use crate::gnss::GpsTime;
use crate::gnss::constants::SECONDS_PER_HOUR;
use crate::models::LookAngles;

/// C/N0 to which the standard deviations of errors refer (dB-Hz).
const REFERENCE_CN0: f64 = 45.0;
/// C/N0 at the zenith (dB-Hz), and the loss towards the horizon (dB).
const ZENITH_CN0: f64 = 48.0;
const HORIZON_LOSS_DB: f64 = 14.0;
/// Share of the multipath error of a direct signal without a reflection.
const CALM_SHARE: f64 = 0.25;
/// Largest carrier multipath: a quarter of a wavelength.
const PHASE_MULTIPATH_LIMIT: f64 = 0.25;

/// Reception of a signal at an epoch.
pub(super) struct Reception<'a> {
    pub(super) time: GpsTime,
    pub(super) look: &'a LookAngles,
    pub(super) arrival: &'a Arrival,
    pub(super) errors: Option<&'a ReceiverErrors>,
}

/// State of a satellite between epochs.
#[derive(Clone, Debug)]
pub(super) struct Track {
    /// Time before which the satellite is not checked again.
    pub(super) asleep_until: GpsTime,
    /// Start of the present kind of reception; `None` without reception.
    pub(super) since: Option<GpsTime>,
    pub(super) is_reflected: bool,
    /// Integer ambiguity of each signal (cycles).
    pub(super) ambiguities: [f64; 2],
    /// Unresolved half cycle of each signal, 0 or ½ (cycles), and until when.
    pub(super) half_cycles: [f64; 2],
    pub(super) resolved_at: [GpsTime; 2],
    pub(super) lost_lock: [bool; 2],
    pub(super) multipath: [GaussMarkov; 2],
    pub(super) phase_multipath: [GaussMarkov; 2],
    pub(super) fading: GaussMarkov,
}

/// Measurements of one signal in metres; Doppler positive on approach, as in RINEX.
pub(super) struct Measured {
    pub(super) wavelength_m: f64,
    /// Factor of the code's noise and multipath; smaller for a faster code.
    pub(super) code_scale: f64,
    pub(super) pseudorange_m: f64,
    pub(super) phase_m: f64,
    pub(super) doppler_m_s: f64,
}

impl Track {
    pub(super) fn new(random: &mut Random) -> Self {
        let mut process = || GaussMarkov::new(random);
        Self {
            asleep_until: GpsTime::EPOCH,
            since: None,
            is_reflected: false,
            ambiguities: [0.0; 2],
            half_cycles: [0.0; 2],
            resolved_at: [GpsTime::EPOCH; 2],
            lost_lock: [false; 2],
            multipath: [process(), process()],
            phase_multipath: [process(), process()],
            fading: process(),
        }
    }

    /// Propagates the slow processes; returns the C/N0 of the first signal (dB-Hz).
    pub(super) fn advance(
        &mut self,
        (elapsed_s, way_m): (f64, f64),
        reception: &Reception<'_>,
        random: &mut Random,
    ) -> f64 {
        let Reception { look, arrival, errors, .. } = *reception;
        let lost_db = HORIZON_LOSS_DB * (1.0 - look.elevation_rad.sin()).powi(2);
        let reflection_db = match arrival {
            Arrival::Reflected(reflection) => reflection.loss_db,
            Arrival::Diffracted(bent) => bent.loss_db,
            Arrival::Direct { .. } | Arrival::Blocked => 0.0,
        };
        let clear_db = ZENITH_CN0 - lost_db - reflection_db;
        let Some(errors) = errors else {
            return clear_db;
        };
        let clear_db = clear_db - errors.antenna_loss_db;
        // Reflectors pass by as the antenna moves.
        let passed_s = way_m / errors.multipath_correlation_m * errors.multipath_correlation_s;
        for process in self.multipath.iter_mut().chain(&mut self.phase_multipath) {
            process.advance(elapsed_s + passed_s, errors.multipath_correlation_s, random);
        }
        let fading = self.fading.advance(elapsed_s, errors.fading_correlation_s, random);
        clear_db + errors.fading_db * fading
    }

    /// Whether there are measurements; a change of reception starts new ambiguities.
    pub(super) fn is_received(
        &mut self,
        reception: &Reception<'_>,
        cn0: f64,
        is_first: bool,
        random: &mut Random,
    ) -> bool {
        let Reception { time, arrival, errors, .. } = *reception;
        let threshold = errors.map_or(f64::NEG_INFINITY, |e| e.tracking_threshold_db_hz);
        if matches!(arrival, Arrival::Blocked) || cn0 < threshold {
            self.since = None;
            return false;
        }
        let is_reflected = matches!(arrival, Arrival::Reflected(_));
        let continues = self.since.is_some() && self.is_reflected == is_reflected;
        if !continues {
            let was_tracked = self.since.is_some();
            self.begin_arc(time, errors, random);
            // The loops keep a signal whose path changes only, and one tracked before the
            // simulation began. Other signals are acquired again.
            let stays = was_tracked || is_first;
            self.since = Some(if stays { GpsTime::EPOCH } else { time });
            self.is_reflected = is_reflected;
        } else if let Some(errors) = errors {
            self.slip(time, cn0, errors, random);
        }
        let wait_s = errors.map_or(0.0, |e| e.reacquisition_s);
        self.since.is_some_and(|since| wait_s <= time - since)
    }

    fn begin_arc(&mut self, time: GpsTime, errors: Option<&ReceiverErrors>, random: &mut Random) {
        self.ambiguities = self.ambiguities.map(|_| random.uniform(-1e5, 1e5).round());
        self.lost_lock = [true; 2];
        for index in 0..self.ambiguities.len() {
            self.lose_half_cycle(index, time, errors, random);
        }
    }

    /// After a loss of lock the half cycle is unresolved for a while.
    fn lose_half_cycle(
        &mut self,
        index: usize,
        time: GpsTime,
        errors: Option<&ReceiverErrors>,
        random: &mut Random,
    ) {
        let Some(errors) = errors.filter(|errors| 0.0 < errors.half_cycle_s) else { return };
        self.resolved_at[index] = time + random.uniform(0.2, 1.8) * errors.half_cycle_s;
        self.half_cycles[index] = if random.chance(0.5) { 0.5 } else { 0.0 };
    }

    /// Adds random slips, more often for weak signals.
    fn slip(&mut self, time: GpsTime, cn0: f64, errors: &ReceiverErrors, random: &mut Random) {
        let per_second =
            errors.slips_per_hour / SECONDS_PER_HOUR * 10_f64.powf((REFERENCE_CN0 - cn0) / 10.0);
        match errors.slips_together {
            true => {
                if random.chance(per_second.min(0.5)) {
                    let cycles = slip_cycles(errors, random);
                    self.ambiguities = self.ambiguities.map(|ambiguity| ambiguity + cycles);
                    let is_reported = random.chance(errors.slips_reported);
                    self.lost_lock = self.lost_lock.map(|lost| lost || is_reported);
                }
            }
            false => {
                for index in 0..self.ambiguities.len() {
                    if random.chance(per_second.min(0.5)) {
                        self.ambiguities[index] += slip_cycles(errors, random);
                        if random.chance(errors.slips_reported) {
                            self.lost_lock[index] = true;
                            self.lose_half_cycle(index, time, Some(errors), random);
                        }
                    }
                }
            }
        }
    }

    /// Adds reflection, multipath and noise.
    pub(super) fn disturb(
        &self,
        ideal: Measured,
        index: usize,
        cn0: f64,
        reception: &Reception<'_>,
        random: &mut Random,
    ) -> Measured {
        let Reception { look, arrival, errors, .. } = *reception;
        let (excess_m, excess_rate_m_s) = match arrival {
            Arrival::Reflected(reflection) => (reflection.excess_m, reflection.excess_rate_m_s),
            // The excess is centimetres; its rate is below the noise.
            Arrival::Diffracted(bent) => (bent.excess_m, 0.0),
            Arrival::Direct { .. } | Arrival::Blocked => (0.0, 0.0),
        };
        let Measured { wavelength_m, code_scale, pseudorange_m, phase_m, doppler_m_s } = ideal;
        let late = Measured {
            wavelength_m,
            code_scale,
            pseudorange_m: pseudorange_m + excess_m,
            phase_m: phase_m + excess_m,
            doppler_m_s: doppler_m_s - excess_rate_m_s,
        };
        let Some(errors) = errors else {
            return late;
        };
        let share = match arrival {
            Arrival::Direct { reflected: true }
            | Arrival::Reflected(_)
            | Arrival::Diffracted(_) => 1.0,
            Arrival::Direct { reflected: false } | Arrival::Blocked => CALM_SHARE,
        };
        let low = share * look.elevation_rad.cos();
        let thermal = 10_f64.powf((REFERENCE_CN0 - cn0) / 20.0);
        let limit_m = PHASE_MULTIPATH_LIMIT * wavelength_m;
        let phase_multipath_m =
            errors.phase_multipath_m * low * self.phase_multipath[index].value();
        let multipath_m = errors.code_multipath_m * low * self.multipath[index].value();
        Measured {
            wavelength_m,
            code_scale,
            pseudorange_m: late.pseudorange_m
                + code_scale * multipath_m
                + code_scale * (errors.code_m * thermal * random.normal()),
            phase_m: late.phase_m
                + phase_multipath_m.clamp(-limit_m, limit_m)
                + errors.phase_m * thermal * random.normal(),
            doppler_m_s: late.doppler_m_s + errors.doppler_m_s * thermal * random.normal(),
        }
    }
}

/// Number of cycles of a slip.
fn slip_cycles(errors: &ReceiverErrors, random: &mut Random) -> f64 {
    let cycles = random.uniform(errors.slip_cycles.0, errors.slip_cycles.1).round();
    if random.chance(0.5) { cycles } else { -cycles }
}
