//! Effects of low-cost receivers and phones on measurements, beyond noise.
//!
//! They change a finished epoch and use their own random stream: without them the simulation keeps
//! its bits. Steered tags are part of [`ReceiverClock`](super::ReceiverClock).

use std::collections::BTreeMap;

use super::phase_truth::PhaseTruth;
use super::random::{GaussMarkov, Random, of_cell};
use crate::gnss::constants::SPEED_OF_LIGHT;
use crate::gnss::{
    Constellation, Cycles, Epoch, GpsTime, Navigation, Observation, ObservationCode, SatelliteId,
};

/// Correlation time of the rate error of false carrier phases (s): autocorrelation 0.37 after 1 s;
/// two phones have 0.2 to 0.6.
const PHASE_RATE_CORRELATION_S: f64 = 1.0;
/// Decimal logarithms of the smallest and largest outlier (m): 200 m to 100 km.
const WILD_EXPONENTS: (f64, f64) = (2.3, 5.0);
/// Purpose of the random number of a constellation's bias.
const INTER_SYSTEM_BIAS: u64 = 48;

/// Behaviour of a receiver beyond noise.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Oddities {
    /// Offset of the stated C/N0 (dB).
    pub cn0_offset_db: f64,
    /// Resolution of the stated C/N0 (dB); 0 for no rounding.
    pub cn0_step_db: f64,
    /// Largest bias between the pseudoranges of a constellation and of GPS (m).
    pub inter_system_bias_m: f64,
    /// Share of pseudoranges with an outlier of 200 m to 100 km.
    pub wild_share: f64,
    /// Time constant of carrier smoothing of pseudoranges (s); 0 for no smoothing.
    pub smoothing_s: f64,
    /// Share of Dopplers that repeat the previous value.
    pub stale_doppler_share: f64,
    /// Mean length of a carrier-phase arc (s); infinite: the arc lasts as long as the signal.
    pub arc_s: f64,
    /// Start of duty cycling after the first epoch (s): from then on each epoch starts new arcs.
    pub duty_cycle_from_s: f64,
    /// Share of arc ends that set the loss-of-lock indicator.
    pub arc_ends_reported: f64,
    /// Standard deviation of the rate error of false carrier phases (m/s); 0 for true phases.
    pub phase_rate_sigma_m_s: f64,
    /// Whether carrier phases are observed.
    pub has_phase: bool,
    /// Whether Dopplers are observed.
    pub has_doppler: bool,
    /// Whether C/N0 is observed.
    pub has_cn0: bool,
}

impl Oddities {
    /// An ordinary receiver.
    pub(crate) const fn none() -> Self {
        Self {
            cn0_offset_db: 0.0,
            cn0_step_db: 0.0,
            inter_system_bias_m: 0.0,
            wild_share: 0.0,
            smoothing_s: 0.0,
            stale_doppler_share: 0.0,
            arc_s: f64::INFINITY,
            duty_cycle_from_s: f64::INFINITY,
            arc_ends_reported: 1.0,
            phase_rate_sigma_m_s: 0.0,
            has_phase: true,
            has_doppler: true,
            has_cn0: true,
        }
    }
}

/// State of a signal between epochs.
#[derive(Clone, Debug)]
struct SignalMemory {
    last: GpsTime,
    doppler_hz: Option<f64>,
    /// Accumulated change of the ambiguity (cycles).
    shift_cycles: f64,
    rate: GaussMarkov,
    /// Accumulated error of a false carrier phase (m).
    phase_error_m: f64,
    smoothed: Option<Smoothed>,
}

/// A smoothed pseudorange and the carrier phase of the same epoch (m).
#[derive(Clone, Copy, Debug)]
struct Smoothed {
    pseudorange_m: f64,
    phase_m: f64,
    epochs: f64,
}

/// A receiver with its oddities and their state.
#[derive(Clone, Debug)]
pub(super) struct OddReceiver {
    oddities: Oddities,
    seed: u64,
    random: Random,
    first: Option<GpsTime>,
    signals: BTreeMap<(SatelliteId, ObservationCode), SignalMemory>,
}

impl OddReceiver {
    pub(super) fn new(oddities: Oddities, seed: u64, random: Random) -> Self {
        Self { oddities, seed, random, first: None, signals: BTreeMap::new() }
    }

    /// Changes an epoch and the truth of its carrier phases, which has the same order.
    pub(super) fn disturb(
        &mut self,
        epoch: &mut Epoch,
        phases: &mut [PhaseTruth],
        navigation: &Navigation,
    ) {
        let first = *self.first.get_or_insert(epoch.time);
        let sleeps = self.oddities.duty_cycle_from_s <= epoch.time - first;
        let time = epoch.time;
        for (observation, truth) in epoch.observations.iter_mut().zip(phases) {
            let key = (observation.satellite, observation.code);
            let random = &mut self.random;
            let memory = self.signals.entry(key).or_insert_with(|| SignalMemory {
                last: time,
                doppler_hz: None,
                shift_cycles: 0.0,
                rate: GaussMarkov::new(random),
                phase_error_m: 0.0,
                smoothed: None,
            });
            let elapsed_s = time - memory.last;
            memory.last = time;
            let channel = navigation.of(key.0).first().and_then(|e| e.glonass_channel());
            let Some(frequency_hz) = observation.signal().frequency_hz(channel) else { continue };
            let wavelength_m = SPEED_OF_LIGHT / frequency_hz;
            memory.smooth(observation, &self.oddities, elapsed_s, wavelength_m);
            let bias_m = self.oddities.inter_system_bias_m;
            disturb_code(observation, &self.oddities, random);
            if let Some(pseudorange_m) = &mut observation.pseudorange_m {
                *pseudorange_m += bias_m * bias_share(self.seed, key.0.constellation);
            }
            memory.disturb_phase(observation, &self.oddities, (elapsed_s, sleeps), random);
            memory.add_phase_error(observation, &self.oddities, (elapsed_s, wavelength_m), random);
            memory.repeat_doppler(observation, &self.oddities, random);
            truth.ambiguity_cycles += memory.shift_cycles;
            leave_out(observation, &self.oddities);
        }
    }
}

/// Bias of a constellation relative to the largest bias, −1 … 1; 0 for GPS and QZSS.
fn bias_share(seed: u64, constellation: Constellation) -> f64 {
    match constellation {
        Constellation::Gps | Constellation::Qzss => 0.0,
        _ => 2.0 * of_cell(seed, constellation.index() as i64, 0, INTER_SYSTEM_BIAS) - 1.0,
    }
}

/// Adds outliers to the pseudorange and changes the stated C/N0.
fn disturb_code(observation: &mut Observation, oddities: &Oddities, random: &mut Random) {
    if let Some(pseudorange_m) = &mut observation.pseudorange_m
        && random.chance(oddities.wild_share)
    {
        let far_m = 10_f64.powf(random.uniform(WILD_EXPONENTS.0, WILD_EXPONENTS.1));
        *pseudorange_m += if random.chance(0.5) { far_m } else { -far_m };
    }
    if let Some(cn0_db_hz) = &mut observation.cn0_db_hz {
        *cn0_db_hz += oddities.cn0_offset_db;
        if 0.0 < oddities.cn0_step_db {
            *cn0_db_hz = (*cn0_db_hz / oddities.cn0_step_db).round() * oddities.cn0_step_db;
        }
    }
}

fn leave_out(observation: &mut Observation, oddities: &Oddities) {
    if !oddities.has_phase {
        observation.carrier_phase = None;
        observation.loss_of_lock = false;
        observation.half_cycle = false;
    }
    if !oddities.has_doppler {
        observation.doppler_hz = None;
    }
    if !oddities.has_cn0 {
        observation.cn0_db_hz = None;
    }
}

impl SignalMemory {
    /// Smooths the pseudorange: P̂ = P/n + (1 − 1/n)·(P̂₋ + Δλφ), n at most the filter length.
    ///
    /// Source: Hatch (1982), *The synergism of GPS code and carrier measurements*.
    fn smooth(
        &mut self,
        observation: &mut Observation,
        oddities: &Oddities,
        elapsed_s: f64,
        wavelength_m: f64,
    ) {
        let (Some(pseudorange_m), Some(phase)) =
            (&mut observation.pseudorange_m, observation.carrier_phase)
        else {
            return;
        };
        if oddities.smoothing_s <= 0.0 {
            return;
        }
        let phase_m = phase.0 * wavelength_m;
        let goes_on = !observation.loss_of_lock && elapsed_s < oddities.smoothing_s;
        let length = (oddities.smoothing_s / elapsed_s.max(1e-3)).max(1.0);
        let smoothed = match self.smoothed.filter(|_| goes_on) {
            Some(before) => {
                let epochs = (before.epochs + 1.0).min(length);
                let carried_m = before.pseudorange_m + phase_m - before.phase_m;
                let smoothed_m = carried_m + (*pseudorange_m - carried_m) / epochs;
                Smoothed { pseudorange_m: smoothed_m, phase_m, epochs }
            }
            None => Smoothed { pseudorange_m: *pseudorange_m, phase_m, epochs: 1.0 },
        };
        *pseudorange_m = smoothed.pseudorange_m;
        self.smoothed = Some(smoothed);
    }

    /// Ends arcs at random and while the receiver is duty cycling.
    fn disturb_phase(
        &mut self,
        observation: &mut Observation,
        oddities: &Oddities,
        (elapsed_s, sleeps): (f64, bool),
        random: &mut Random,
    ) {
        let Some(phase) = &mut observation.carrier_phase else { return };
        let is_lost = random.chance(1.0 - (-elapsed_s / oddities.arc_s).exp());
        if is_lost || sleeps {
            self.shift_cycles += random.uniform(-1e4, 1e4).round();
            observation.loss_of_lock |= random.chance(oddities.arc_ends_reported);
        }
        phase.0 += self.shift_cycles;
    }

    /// Adds the accumulated error of a false carrier phase.
    fn add_phase_error(
        &mut self,
        observation: &mut Observation,
        oddities: &Oddities,
        (elapsed_s, wavelength_m): (f64, f64),
        random: &mut Random,
    ) {
        if oddities.phase_rate_sigma_m_s <= 0.0 {
            return;
        }
        let rate = self.rate.advance(elapsed_s, PHASE_RATE_CORRELATION_S, random);
        self.phase_error_m += oddities.phase_rate_sigma_m_s * rate * elapsed_s;
        if let Some(Cycles(cycles)) = &mut observation.carrier_phase {
            *cycles += self.phase_error_m / wavelength_m;
        }
    }

    fn repeat_doppler(
        &mut self,
        observation: &mut Observation,
        oddities: &Oddities,
        random: &mut Random,
    ) {
        if let Some(last) = self.doppler_hz
            && random.chance(oddities.stale_doppler_share)
        {
            observation.doppler_hz = Some(last);
        }
        self.doppler_hz = observation.doppler_hz;
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::simulation::{ReceiverErrors, Scenario, Simulator};

    /// Epochs of the noise-free scenario without and with oddities.
    fn pairs(oddities: Oddities) -> Vec<(Epoch, Epoch)> {
        let plain = Scenario { base: None, duration_s: 200.0, ..Scenario::clean() };
        let odd = Scenario { oddities: Some(oddities), ..plain.clone() };
        let epochs = |scenario| Simulator::new(scenario, 5).map(|epoch| epoch.rover);
        epochs(plain).zip(epochs(odd)).collect()
    }

    /// Differences of one quantity over all observations, odd less plain.
    fn differences(
        pairs: &[(Epoch, Epoch)],
        of: fn(&Observation) -> Option<f64>,
    ) -> Vec<(SatelliteId, f64)> {
        let both = pairs.iter().flat_map(|(a, b)| a.observations.iter().zip(&b.observations));
        both.filter_map(|(a, b)| Some((a.satellite, of(b)? - of(a)?))).collect()
    }

    #[test]
    fn no_oddities_leave_every_bit() {
        assert!(pairs(Oddities::none()).iter().all(|(plain, odd)| plain == odd));
    }

    #[test]
    fn biases_belong_to_constellations() {
        let odd = pairs(Oddities { inter_system_bias_m: 1_000.0, ..Oddities::none() });
        let mut seen = BTreeMap::new();
        for (satellite, bias_m) in differences(&odd, |o| o.pseudorange_m) {
            let first = *seen.entry(satellite.constellation).or_insert(bias_m);
            assert!((bias_m - first).abs() < 1e-6 && bias_m.abs() <= 1_000.0);
        }
        assert_eq!(seen[&Constellation::Gps], 0.0);
        assert!(10.0 < seen[&Constellation::Galileo].abs(), "{seen:?}");
    }

    #[test]
    fn wild_ranges_and_stale_dopplers_have_their_share() {
        let odd = Oddities { wild_share: 0.01, stale_doppler_share: 0.4, ..Oddities::none() };
        let odd = pairs(odd);
        let share = |differences: &[(SatelliteId, f64)]| {
            let changed = differences.iter().filter(|(_, change)| change.abs() > 1e-9).count();
            changed as f64 / differences.len() as f64
        };
        let wild = differences(&odd, |o| o.pseudorange_m);
        assert!((share(&wild) - 0.01).abs() < 0.003, "{}", share(&wild));
        assert!(wild.iter().all(|(_, off)| off.abs() < 1e-9 || 199.0 < off.abs()));
        let stale = share(&differences(&odd, |o| o.doppler_hz));
        assert!((stale - 0.4).abs() < 0.02, "{stale}");
    }

    /// Arcs of 4 s on average end with a flag and whole cycles.
    #[test]
    fn arcs_end() {
        let odd = pairs(Oddities { arc_s: 4.0, ..Oddities::none() });
        let flags = odd.iter().flat_map(|(_, odd)| odd.observations.iter().map(|o| o.loss_of_lock));
        let flags: Vec<_> = flags.collect();
        let share = flags.iter().filter(|flag| **flag).count() as f64 / flags.len() as f64;
        // 1 − e^(−1/4) = 0.221.
        assert!((share - 0.221).abs() < 0.02, "{share}");
        for (_, cycles) in differences(&odd, |o| o.carrier_phase.map(|phase| phase.0)) {
            assert!((cycles - cycles.round()).abs() < 1e-5, "{cycles}");
        }
    }

    #[test]
    fn a_sleeping_receiver_has_no_arcs_from_then_on() {
        let odd = Oddities { duty_cycle_from_s: 100.0, ..Oddities::none() };
        for (index, (plain, odd)) in pairs(odd).iter().enumerate() {
            let flagged = odd.observations.iter().filter(|o| o.loss_of_lock).count();
            match index < 100 {
                true => assert_eq!(plain, odd),
                false => assert_eq!(flagged, odd.observations.len()),
            }
        }
    }

    /// The rate error of false phases: the change of their error over one second.
    #[test]
    fn false_phases_drift() {
        let odd = pairs(Oddities { phase_rate_sigma_m_s: 0.4, ..Oddities::none() });
        let mut last = BTreeMap::new();
        let (mut squares, mut products, mut count) = (0.0, 0.0, 0.0);
        for (plain, odd) in &odd {
            for (a, b) in plain.observations.iter().zip(&odd.observations) {
                let Some(frequency_hz) = a.signal().frequency_hz(None) else { continue };
                let cycles = b.carrier_phase.unwrap().0 - a.carrier_phase.unwrap().0;
                let phase_error_m = cycles * SPEED_OF_LIGHT / frequency_hz;
                let (before_m, rate) =
                    last.insert((a.satellite, a.code), (phase_error_m, 0.0)).unwrap_or_default();
                let step = phase_error_m - before_m;
                last.insert((a.satellite, a.code), (phase_error_m, step));
                squares += step * step;
                products += step * rate;
                count += 1.0;
            }
        }
        let (sigma, correlation) = ((squares / count).sqrt(), products / squares);
        assert!((sigma - 0.4).abs() < 0.02, "{sigma}");
        // e^(−1).
        assert!((correlation - 0.368).abs() < 0.05, "{correlation}");
    }

    /// Smoothed less raw pseudorange, in deviations of the raw noise: with a gain of 1/20 the
    /// smoothed noise keeps 1/39 of the variance and 1/20 of it as covariance with the raw, so that
    /// the difference has 1 + 1/39 − 2/20 = 0.962².
    #[test]
    fn smoothing_takes_noise_away() {
        let errors = ReceiverErrors {
            code_multipath_m: 0.0,
            phase_multipath_m: 0.0,
            fading_db: 0.0,
            slips_per_hour: 0.0,
            ..ReceiverErrors::open_sky()
        };
        let noisy = |smoothing_s| {
            let oddities = Some(Oddities { smoothing_s, ..Oddities::none() });
            let rover_errors = Some(errors);
            let plain = Scenario { base: None, rover_errors, oddities, ..Scenario::clean() };
            Simulator::new(plain, 5).map(|epoch| epoch.rover)
        };
        let mut squares = Vec::new();
        for (raw, smooth) in noisy(0.0).zip(noisy(20.0)).skip(100) {
            for (a, b) in raw.observations.iter().zip(&smooth.observations) {
                let sigma_m = errors.code_m * 10_f64.powf((45.0 - a.cn0_db_hz.unwrap()) / 20.0);
                let off_m = b.pseudorange_m.unwrap() - a.pseudorange_m.unwrap();
                squares.push((off_m / sigma_m).powi(2));
            }
        }
        let sigma = (squares.iter().sum::<f64>() / squares.len() as f64).sqrt();
        assert!((sigma - 0.962).abs() < 0.03, "{sigma}");
    }

    #[test]
    fn what_is_not_observed_is_not_there() {
        let odd = Oddities { has_phase: false, has_doppler: false, ..Oddities::none() };
        for (_, odd) in pairs(Oddities { has_cn0: false, ..odd }) {
            for one in odd.observations {
                assert!(one.pseudorange_m.is_some() && one.carrier_phase.is_none());
                assert!(one.doppler_hz.is_none() && one.cn0_db_hz.is_none() && !one.loss_of_lock);
            }
        }
    }
}
