//! Cycle-slip detectors, one by one: on simulated slips, whose truth is known, and on real arcs.

use std::collections::BTreeMap;
use std::path::Path;

use graphfix::gnss::{
    Ecef, Ephemeris, Epoch, GlonassEphemeris, Navigation, Observation, SatelliteId,
};
use graphfix::models::{look_angles, select_ephemeris, state_at_transmission};
use graphfix::positioning::{
    AntennaMotion, AntennaPosition, KnownSatellite, PhaseArc, SlipCause, SlipTracker,
};
use graphfix::simulation::{PhaseTruth, ReceiverErrors, Scenario, Simulator};

use crate::support::data;
use crate::support::reading;

/// One carrier phase with its arc, and the one before it of the same signal.
struct Seen {
    arc: PhaseArc,
    observation: Observation,
    truth: PhaseTruth,
    before: Option<(PhaseArc, Observation, PhaseTruth)>,
}

impl Seen {
    fn slip_cycles(&self) -> f64 {
        self.before
            .map_or(0.0, |(_, _, before)| self.truth.ambiguity_cycles - before.ambiguity_cycles)
    }

    fn found(&self, cause: SlipCause) -> bool {
        self.arc.causes.contains(cause)
    }
}

/// Follows a simulated rover whose position is known to some metres.
fn follow(scenario: Scenario, seed: u64) -> Vec<Seen> {
    let simulator = Simulator::new(scenario, seed);
    let navigation = simulator.navigation().clone();
    let mut tracker = SlipTracker::new(AntennaMotion::Moving);
    let mut last = BTreeMap::new();
    let mut seen = Vec::new();
    for epoch in simulator {
        let satellites = KnownSatellite::of_epoch(&epoch.rover, &navigation);
        tracker.advance(&epoch.rover, &satellites, Some(near(epoch.position)));
        assert_eq!(tracker.arcs().len(), epoch.rover.observations.len());
        for (observation, truth) in epoch.rover.observations.iter().zip(&epoch.rover_phases) {
            let key = (observation.satellite, observation.code);
            let arc = *tracker.arc(key.0, key.1).unwrap();
            let (observation, truth) = (*observation, *truth);
            let before = last.insert(key, (arc, observation, truth));
            seen.push(Seen { arc, observation, truth, before });
        }
    }
    seen
}

/// Five metres off.
fn near(position: Ecef) -> AntennaPosition {
    let off = nalgebra::Vector3::new(3.0, -2.0, 3.0);
    AntennaPosition { position: Ecef(position.0 + off), sigma_m: 5.0 }
}

fn quiet(minutes: f64) -> Scenario {
    let errors = ReceiverErrors { slips_per_hour: 0.0, ..ReceiverErrors::open_sky() };
    Scenario {
        duration_s: 60.0 * minutes,
        rover_errors: Some(errors),
        base: None,
        ..Scenario::open_sky()
    }
}

/// Epochs to be tampered with, and what is known of the sky.
struct Recording {
    epochs: Vec<Epoch>,
    positions: Vec<Ecef>,
    navigation: Navigation,
}

impl Recording {
    fn simulated(scenario: Scenario, seed: u64) -> Self {
        let simulator = Simulator::new(scenario, seed);
        let navigation = (**simulator.navigation()).clone();
        let (epochs, positions) = simulator.map(|epoch| (epoch.rover, epoch.position)).unzip();
        Self { epochs, positions, navigation }
    }

    /// The lowest satellite at an epoch, by a constellation's letter.
    fn lowest(&self, index: usize, letter: char) -> SatelliteId {
        let frame = graphfix::gnss::LocalFrame::at(self.positions[index]);
        let epoch = &self.epochs[index];
        let elevation = |satellite: &SatelliteId| {
            let ephemeris = select_ephemeris(&self.navigation, *satellite, epoch.time).unwrap();
            let state = state_at_transmission(ephemeris, epoch.time, 2.3e7);
            look_angles(&frame, state.position).elevation_rad
        };
        let satellites = epoch.by_satellite().map(|(satellite, _)| satellite);
        let own = satellites.filter(|satellite| satellite.constellation.letter() == letter);
        own.min_by(|a, b| elevation(a).total_cmp(&elevation(b))).unwrap()
    }

    /// Adds cycles to a satellite's phases from an epoch on, in the order of its signals.
    fn slip(&mut self, from: usize, satellite: SatelliteId, cycles: &[f64]) {
        for epoch in &mut self.epochs[from..] {
            let own = epoch.observations.iter_mut().filter(|o| o.satellite == satellite);
            for (observation, cycles) in own.zip(cycles) {
                observation.carrier_phase.as_mut().unwrap().0 += cycles;
            }
        }
    }

    /// Arcs epoch by epoch, with the antenna known or not.
    fn follow(&self, is_known: bool) -> Vec<Vec<PhaseArc>> {
        let mut tracker = SlipTracker::new(AntennaMotion::Moving);
        let step = |(epoch, position): (&Epoch, &Ecef)| {
            let satellites = KnownSatellite::of_epoch(epoch, &self.navigation);
            tracker.advance(epoch, &satellites, is_known.then(|| near(*position)));
            tracker.arcs().to_vec()
        };
        self.epochs.iter().zip(&self.positions).map(step).collect()
    }
}

/// Epoch, satellite and code of all that a cause was found for.
fn findings(arcs: &[Vec<PhaseArc>], cause: SlipCause) -> Vec<(usize, String)> {
    let of_epoch = |(index, arcs): (usize, &Vec<PhaseArc>)| {
        let found = arcs.iter().filter(|arc| arc.causes.contains(cause));
        found.map(|arc| (index, format!("{}{}", arc.satellite, arc.code))).collect::<Vec<_>>()
    };
    arcs.iter().enumerate().flat_map(of_epoch).collect()
}

#[test]
fn what_the_receiver_announces_ends_arcs() {
    let seen = follow(Scenario { base: None, ..Scenario::rtk_canyon() }, 3);
    let (mut lost, mut changed, mut kept) = (0, 0, 0);
    for one in &seen {
        let Some((arc, observation, _)) = one.before else { continue };
        assert_eq!(one.found(SlipCause::LossOfLock), one.observation.loss_of_lock);
        let half_cycle = (observation.half_cycle, one.observation.half_cycle);
        assert_eq!(one.found(SlipCause::HalfCycle), half_cycle.0 != half_cycle.1);
        assert_eq!(one.arc.half_cycle, half_cycle.1);
        assert_eq!(one.arc.begins, one.arc.number != arc.number);
        if one.observation.loss_of_lock || half_cycle.0 != half_cycle.1 {
            assert!(one.arc.begins);
            lost += usize::from(one.observation.loss_of_lock);
            changed += usize::from(half_cycle.0 != half_cycle.1);
        } else {
            kept += usize::from(half_cycle == (true, true) && !one.arc.begins);
        }
    }
    assert!(300 < lost && 300 < changed && 1_000 < kept, "{lost} {changed} {kept}");
}

/// One cycle on a single frequency, unannounced: all of those below 15° are found, nothing else.
#[test]
fn time_differences_find_single_cycles_at_low_elevation() {
    let errors = ReceiverErrors {
        slips_per_hour: 6.0,
        slips_reported: 0.0,
        slip_cycles: (1.0, 1.0),
        ..ReceiverErrors::open_sky()
    };
    let scenario = Scenario { rover_errors: Some(errors), frequencies: 1, ..quiet(20.0) };
    let (mut low, mut slips, mut found, mut false_alarms) = (0, 0, 0, 0);
    for one in follow(scenario, 11).iter().filter(|one| one.before.is_some()) {
        let announced = one.observation.loss_of_lock;
        let is_found = one.found(SlipCause::TimeDifference) && one.arc.begins;
        if one.slip_cycles() != 0.0 && !announced {
            slips += 1;
            low += usize::from(one.truth.elevation_rad < 15_f64.to_radians());
            found += usize::from(is_found);
        } else {
            false_alarms += usize::from(is_found);
        }
    }
    assert!(50 < low, "{low} slips below 15 degrees");
    assert_eq!((found, false_alarms), (slips, 0));
}

/// One cycle on both frequencies moves L1 − L2 by 5.4 cm: seen without any position.
#[test]
fn geometry_free_finds_one_cycle_on_both() {
    let mut recording = Recording::simulated(quiet(4.0), 5);
    assert_eq!(findings(&recording.follow(false), SlipCause::GeometryFree), []);
    let satellite = recording.lowest(120, 'G');
    recording.slip(120, satellite, &[1.0, 1.0]);
    let arcs = recording.follow(false);
    let both = [(120, format!("{satellite}1C")), (120, format!("{satellite}2L"))];
    assert_eq!(findings(&arcs, SlipCause::GeometryFree), both);
    // Where the others are asked too they name the one that slipped, and the other goes on.
    let mut recording = Recording::simulated(quiet(4.0), 5);
    recording.slip(120, satellite, &[0.0, 1.0]);
    let arcs = recording.follow(true);
    assert_eq!(findings(&arcs, SlipCause::GeometryFree), both[1..]);
    let begun = arcs[120].iter().filter(|arc| arc.begins).count();
    assert_eq!(begun, 1);
}

/// 77 cycles of L1 are 60 of L2: the wide lane moves by 17, their difference not at all. A
/// pseudorange that jumps alone is doubted too, but its phases, proven by the others, go on.
#[test]
fn melbourne_wuebbena_finds_what_geometry_free_cannot() {
    let recording = || Recording::simulated(quiet(4.0), 6);
    let mut slipped = recording();
    let satellite = slipped.lowest(120, 'G');
    slipped.slip(120, satellite, &[77.0, 60.0]);
    let arcs = slipped.follow(false);
    let both = vec![(120, format!("{satellite}1C")), (120, format!("{satellite}2L"))];
    assert_eq!(findings(&arcs, SlipCause::GeometryFree), []);
    let found = findings(&arcs, SlipCause::MelbourneWuebbena);
    assert_eq!(found.iter().filter(|(at, _)| *at == 120).cloned().collect::<Vec<_>>(), both);
    assert!(arcs[120].iter().all(|arc| arc.begins == (arc.satellite == satellite)));

    let mut reflected = recording();
    let own = reflected.epochs[120].observations.iter_mut().find(|o| o.satellite == satellite);
    *own.unwrap().pseudorange_m.as_mut().unwrap() += 40.0;
    let arcs = reflected.follow(true);
    let found = findings(&arcs, SlipCause::MelbourneWuebbena);
    assert!(both.iter().all(|one| found.contains(one)), "{found:?}");
    assert!(arcs[120].iter().all(|arc| !arc.begins));
}

/// Five cycles against the Doppler, no position and one frequency; and a clock that steps by
/// milliseconds, in code and phase alike or in the code alone, is no slip of anything.
#[test]
fn doppler_finds_cycles_and_no_clock_steps() {
    let scenario = Scenario { frequencies: 1, ..quiet(4.0) };
    let mut slipped = Recording::simulated(scenario.clone(), 7);
    let satellite = slipped.lowest(120, 'E');
    slipped.slip(120, satellite, &[5.0]);
    let found = findings(&slipped.follow(false), SlipCause::Doppler);
    assert_eq!(found, [(120, format!("{satellite}1C"))]);

    let two = Scenario { frequencies: 2, ..scenario.clone() };
    let begun = |recording: &Recording, is_known| {
        let of_epoch = |arcs: &Vec<PhaseArc>| arcs.iter().filter(|arc| arc.begins).count();
        recording.follow(is_known)[120..].iter().map(of_epoch).sum::<usize>()
    };
    let steady =
        [true, false].map(|is_known| begun(&Recording::simulated(two.clone(), 7), is_known));
    for in_phase in [true, false] {
        let mut stepped = Recording::simulated(two.clone(), 7);
        for epoch in &mut stepped.epochs[120..] {
            for observation in &mut epoch.observations {
                *observation.pseudorange_m.as_mut().unwrap() += 299_792.458;
                if !in_phase {
                    continue;
                }
                let ephemeris = &stepped.navigation.of(observation.satellite)[0];
                let signal = observation.signal();
                let hz = signal.frequency_hz(ephemeris.glonass_channel()).unwrap();
                observation.carrier_phase.as_mut().unwrap().0 += 1e-3 * hz;
            }
            // The tag is off by as much, as it is when a receiver steps its clock.
            if in_phase {
                epoch.time = epoch.time + 1e-3;
            }
        }
        assert_eq!([true, false].map(|is_known| begun(&stepped, is_known)), steady, "{in_phase}");
    }
    assert_eq!(steady[0], 0);
}

/// A satellite away for 5 s is vouched for by the others' displacements; away for 20 s without a
/// known antenna it begins anew, and so does what slipped while away.
#[test]
fn gaps_are_bridged_only_by_proof() {
    let scenario = Scenario { frequencies: 1, ..quiet(4.0) };
    let hidden = |seconds: usize, cycles: f64| {
        let mut recording = Recording::simulated(scenario.clone(), 8);
        let satellite = recording.lowest(120, 'C');
        for epoch in &mut recording.epochs[120 - seconds..120] {
            epoch.observations.retain(|o| o.satellite != satellite);
        }
        recording.slip(120, satellite, &[cycles]);
        (recording, satellite)
    };
    for (seconds, cycles, is_known, cause) in [
        (5, 0.0, true, None),
        (5, 0.0, false, None),
        (5, 1.0, true, Some(SlipCause::TimeDifference)),
        (20, 0.0, false, Some(SlipCause::Gap)),
    ] {
        let (recording, satellite) = hidden(seconds, cycles);
        let arcs = recording.follow(is_known);
        let arc = arcs[120].iter().find(|arc| arc.satellite == satellite).unwrap();
        assert_eq!(arc.causes.iter().next(), cause, "{seconds} s, {cycles}, {is_known}");
        assert_eq!(arc.begins, cause.is_some());
    }
}

/// The order of satellites, a copy on the way and a repeated epoch change no arc; no two arcs of
/// different signals share a number.
#[test]
fn arcs_do_not_depend_on_order_or_copies() {
    let recording = Recording::simulated(Scenario { base: None, ..Scenario::rtk_canyon() }, 9);
    let straight = recording.follow(true);
    let mut owners = BTreeMap::new();
    for arc in straight.iter().flatten() {
        let owner = (arc.satellite, arc.code);
        assert_eq!(*owners.entry(arc.number).or_insert(owner), owner);
    }
    let mut tracker = SlipTracker::new(AntennaMotion::Moving);
    for (index, epoch) in recording.epochs.iter().enumerate() {
        let mut turned = epoch.clone();
        turned.observations.reverse();
        let satellites = KnownSatellite::of_epoch(&turned, &recording.navigation);
        let antenna = Some(near(recording.positions[index]));
        tracker.advance(&turned, &satellites, antenna);
        let key = |arc: &PhaseArc| (arc.satellite, arc.code, arc.since, arc.begins, arc.causes);
        let (a, b) = (tracker.arcs().iter().map(key), straight[index].iter().map(key));
        assert!(a.eq(b), "epoch {index}");
        let mut copy = tracker.clone();
        copy.advance(&turned, &satellites, antenna);
        assert!(copy.arcs().is_empty(), "a repeated epoch got arcs");
        tracker = tracker.clone();
    }
}

/// Arcs of a file with one satellite, of which nothing but the channel is known.
fn lonely(path: &Path, channel: Option<i8>) -> Vec<Vec<PhaseArc>> {
    let epochs = reading::epochs(path);
    let ephemeris = channel.map(|channel| glonass(&epochs[0], channel));
    let mut tracker = SlipTracker::new(AntennaMotion::Static);
    let step = |epoch: &Epoch| {
        let known = ephemeris.as_ref().map(|ephemeris| KnownSatellite {
            ephemeris,
            state: state_at_transmission(ephemeris, epoch.time, 2.1e7),
            pseudorange_m: 2.1e7,
        });
        tracker.advance(epoch, known.as_slice(), None);
        tracker.arcs().to_vec()
    };
    epochs.iter().map(step).collect()
}

/// An orbit that nobody asks about; what counts is the channel.
fn glonass(epoch: &Epoch, channel: i8) -> Ephemeris {
    Ephemeris::Glonass(GlonassEphemeris {
        satellite: epoch.observations[0].satellite,
        toe: epoch.time,
        transmission_time: None,
        position_m: nalgebra::Vector3::new(2.55e7, 0.0, 0.0),
        velocity_m_s: nalgebra::Vector3::new(0.0, 3_000.0, 0.0),
        acceleration_m_s2: nalgebra::Vector3::zeros(),
        clock_bias_s: 0.0,
        gamma: 0.0,
        delta_tau_s: None,
        channel,
        health: 0,
        accuracy_m: None,
        age_days: 0,
    })
}

/// Arcs that were made to test editors of cycle slips: one satellite each, slips unannounced.
#[test]
fn real_arcs_made_for_editors() {
    let Some(folder) = data::set("formats/nasty-obs") else { return };
    // GLONASS 3 (channel 5): L1 − L2 drifts by −7 to −3 cm an epoch, except for −2.9 and −1.5 m at
    // epochs 4 and 5, which the receiver announces, −0.19 m at 6 and 7, as its L2 settles, with
    // what that leaves of the trend at 8 and 9, and +4.24 m at 21, where the wide lane jumps by 20
    // cycles. At 215 the multipath of weak pseudoranges moves the wide lane by one.
    let arcs = lonely(&folder.join("gnsstk_test_dfix_job4131.ed.obs"), Some(5));
    let epochs = |cause| {
        let of_first = findings(&arcs, cause).into_iter().filter(|(_, signal)| signal == "R031P");
        of_first.map(|(epoch, _)| epoch).collect::<Vec<_>>()
    };
    assert_eq!(epochs(SlipCause::GeometryFree), [6, 7, 8, 9, 21]);
    assert_eq!(epochs(SlipCause::MelbourneWuebbena), [21, 215]);
    let flags = findings(&arcs, SlipCause::LossOfLock);
    assert_eq!(flags, [(4, "R032P".to_owned()), (5, "R032P".to_owned())]);

    let arcs = lonely(&folder.join("gnsstk_test_dfix_txau047.ed.12o"), None);
    assert_eq!(findings(&arcs, SlipCause::LossOfLock).len(), 20);
    assert_eq!(findings(&arcs, SlipCause::GeometryFree), []);
    assert_eq!(findings(&arcs, SlipCause::Gap), []);
    // GPS 15: one doubt a minute after the arc began, with L2 at 20 dB-Hz, and then none.
    let wide = findings(&arcs, SlipCause::MelbourneWuebbena);
    assert_eq!(wide, [(13, "G151C".to_owned()), (13, "G152W".to_owned())]);
}

/// The deep canyon: the receiver announces most; what is found beyond that is counted.
#[test]
fn canyon_of_hong_kong() {
    let Some(folder) = data::set("tst-2019") else { return };
    let navigation = reading::navigation(&folder, &["hksc1180.19n", "hksc1180.19b"]);
    let mut tracker = SlipTracker::new(AntennaMotion::Moving);
    // The header's position: within the two kilometres of the drive.
    let position = Ecef::new(-2_419_215.886_5, 5_385_498.560_3, 2_405_403.631_4);
    let antenna = Some(AntennaPosition { position, sigma_m: 1_000.0 });
    let mut counts = BTreeMap::new();
    for epoch in reading::epochs(&folder.join("COM3_190428_124409.obs")) {
        let satellites = KnownSatellite::of_epoch(&epoch, &navigation);
        tracker.advance(&epoch, &satellites, antenna);
        for arc in tracker.arcs() {
            *counts.entry("phases").or_insert(0) += 1;
            *counts.entry("new arc").or_insert(0) += usize::from(arc.begins);
            for cause in arc.causes.iter() {
                *counts.entry(cause.name()).or_insert(0) += 1;
            }
        }
    }
    // Every flag of the receiver's, and little that it did not announce.
    assert_eq!((counts["phases"], counts["loss-of-lock"]), (15_740, 2_288));
    assert_eq!(counts["half-cycle"], 673);
    assert!(counts["doppler"] < 50 && 0 < counts["doppler"], "{counts:?}");
    assert!(counts["time-difference"] < 20 && 0 < counts["time-difference"], "{counts:?}");
    assert!(counts["new arc"] < 2_600, "{counts:?}");
}
