//! Draws the receiver of a drive, with its clock, errors and oddities, and a base.

use nalgebra::Vector3;

use crate::gnss::Enu;
use crate::gnss::constants::SPEED_OF_LIGHT;
use crate::simulation::oddities::Oddities;
use crate::simulation::random::Random;
use crate::simulation::scenario::{ReceiverClock, ReceiverErrors, Scenario, SecondBand};

use super::draws::log_uniform;

/// Resolution of the tags of phones (s).
pub(super) const TAG_STEP_S: f64 = 1e-7;

/// Kind of receiver.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum ReceiverKind {
    /// Two bands, patch antenna on the roof: u-blox F9P, NovAtel Flexpak6.
    TwoBands,
    /// One band: u-blox M8T.
    OneBand,
    /// L1 and L5 with short arcs.
    LowCost,
    /// A phone's chip and antenna.
    Phone,
}

/// Adds the receiver, its clock and oddities, and a base.
pub(super) fn equip(scenario: Scenario, receiver: ReceiverKind, random: &mut Random) -> Scenario {
    let in_city = scenario.city.is_some();
    let clock = clock(receiver, random);
    let errors = errors(receiver, in_city, random);
    let (frequencies, second_band) = match receiver {
        ReceiverKind::TwoBands => (2, SecondBand::L2),
        ReceiverKind::OneBand => (1, SecondBand::L2),
        ReceiverKind::LowCost => (2, SecondBand::L5),
        ReceiverKind::Phone => (if random.chance(0.5) { 2 } else { 1 }, SecondBand::L5),
    };
    let oddities = oddities(receiver, random);
    let has_base = receiver != ReceiverKind::Phone && random.chance(0.6);
    let far_m = log_uniform(random, 200.0, 15_000.0);
    let bearing = random.uniform(0.0, std::f64::consts::TAU);
    let base = Vector3::new(far_m * bearing.sin(), far_m * bearing.cos(), 20.0);
    Scenario {
        frequencies,
        second_band,
        rover_errors: Some(errors),
        base_errors: Some(ReceiverErrors::open_sky().slipping()),
        base: has_base.then_some(Enu(base)),
        oddities: Some(oddities),
        clock,
        ..scenario
    }
}

/// Oscillators of phones drift by up to 240 m/s, and their tags are steered in steps of 100 ns.
/// Other receivers set their clock back by a millisecond.
fn clock(receiver: ReceiverKind, random: &mut Random) -> ReceiverClock {
    let is_phone = receiver == ReceiverKind::Phone;
    let drift = log_uniform(random, 3.0, 240.0) / SPEED_OF_LIGHT;
    let nears_step = random.chance(0.3);
    ReceiverClock {
        offset_s: if nears_step && !is_phone { 5e-4 } else { 1e-5 },
        drift: if is_phone { drift } else { random.uniform(1e-8, 3e-7) },
        offset_walk_m: random.uniform(0.02, 0.1),
        drift_walk_m_s: random.uniform(0.01, 0.1),
        millisecond_jumps: !is_phone,
        tag_step_s: if is_phone { TAG_STEP_S } else { 0.0 },
        phase_follows_tag: random.chance(0.6),
    }
}

/// Noise at a received 45 dB-Hz. The antenna of a phone loses 6 to 14 dB against a patch on a roof.
fn errors(receiver: ReceiverKind, in_city: bool, random: &mut Random) -> ReceiverErrors {
    let base = if in_city { ReceiverErrors::urban() } else { ReceiverErrors::open_sky() };
    let (code_m, doppler_m_s, antenna_loss_db, slips_per_hour, threshold) = match receiver {
        ReceiverKind::TwoBands => ((0.25, 0.6), (0.015, 0.05), (0.0, 4.0), (0.5, 10.0), 22.0),
        ReceiverKind::OneBand => ((0.4, 1.0), (0.02, 0.06), (0.0, 6.0), (0.5, 20.0), 20.0),
        ReceiverKind::LowCost => ((0.3, 0.8), (0.02, 0.06), (2.0, 8.0), (2.0, 30.0), 18.0),
        ReceiverKind::Phone => ((0.8, 3.5), (0.018, 0.09), (6.0, 14.0), (5.0, 60.0), 14.0),
    };
    let mut within = |(low, high): (f64, f64)| log_uniform(random, low, high);
    let (code_m, doppler_m_s) = (within(code_m), within(doppler_m_s));
    let slips_per_hour = within(slips_per_hour);
    let code_multipath_m = base.code_multipath_m * within((0.6, 2.0));
    ReceiverErrors {
        code_m,
        doppler_m_s,
        phase_m: base.phase_m * within((0.7, 2.0)),
        code_multipath_m,
        antenna_loss_db: random.uniform(antenna_loss_db.0, antenna_loss_db.1),
        slips_per_hour,
        slips_reported: random.uniform(0.5, 0.95),
        half_cycle_s: random.uniform(0.5, 4.0),
        multipath_correlation_m: random.uniform(5.0, 40.0),
        fading_db: base.fading_db * random.uniform(0.6, 1.4),
        tracking_threshold_db_hz: threshold + random.uniform(-2.0, 3.0),
        ..base.slipping()
    }
}

/// Draws the oddities of a receiver.
fn oddities(receiver: ReceiverKind, random: &mut Random) -> Oddities {
    // C/N0 scales of manufacturers differ by ±4 dB; most receivers state whole decibels.
    let ordinary = Oddities {
        cn0_offset_db: random.uniform(-4.0, 4.0),
        cn0_step_db: if random.chance(0.6) { 1.0 } else { 0.0 },
        inter_system_bias_m: 30.0,
        ..Oddities::none()
    };
    match receiver {
        ReceiverKind::TwoBands => ordinary,
        ReceiverKind::OneBand => Oddities {
            smoothing_s: if random.chance(0.4) { random.uniform(5.0, 60.0) } else { 0.0 },
            ..ordinary
        },
        // A recorded receiver has a median of 4 s and quartiles of 2 and 13 s.
        ReceiverKind::LowCost => Oddities { arc_s: random.uniform(4.0, 15.0), ..ordinary },
        ReceiverKind::Phone => phone(ordinary, random),
    }
}

/// Recorded phones have biases between constellations up to 1,475 m, 0.6 to 1.5 % of outliers, 46 %
/// repeated Dopplers (one phone), phase rate errors of 0.2 to 0.7 m/s (two), no phases (one), no
/// Dopplers and C/N0 (one).
fn phone(ordinary: Oddities, random: &mut Random) -> Oddities {
    let mut one_in = |share: f64, low: f64, high: f64, else_is: f64| {
        let drawn = random.uniform(low, high);
        if random.chance(share) { drawn } else { else_is }
    };
    let inter_system_bias_m = one_in(0.5, 100.0, 1_500.0, 30.0);
    let wild_share = one_in(0.7, 0.001, 0.015, 0.0);
    let stale_doppler_share = one_in(0.25, 0.1, 0.5, 0.0);
    let duty_cycle_from_s = one_in(0.4, 0.0, 300.0, f64::INFINITY);
    let phase_rate_sigma_m_s = one_in(0.4, 0.2, 0.7, 0.0);
    let arc_s = one_in(0.5, 4.0, 60.0, f64::INFINITY);
    Oddities {
        inter_system_bias_m,
        wild_share,
        stale_doppler_share,
        arc_s,
        duty_cycle_from_s,
        arc_ends_reported: random.uniform(0.5, 1.0),
        phase_rate_sigma_m_s,
        has_phase: !random.chance(0.2),
        has_doppler: !random.chance(0.1),
        has_cn0: !random.chance(0.1),
        ..ordinary
    }
}
