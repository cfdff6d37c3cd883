//! Goldens of positions relative to a base on real and simulated recordings.

use std::path::Path;

use graphfix::config::{Mode, PositioningOptions, Profile};
use graphfix::evaluation::ErrorStatistics;
use graphfix::formats::truth;
use graphfix::gnss::constants::SPEED_OF_LIGHT;
use graphfix::gnss::{BaseStation, Ecef, Epoch, GpsTime, LocalFrame, Navigation, Reason};
use graphfix::gnss::{Constellation, Ephemeris, SatelliteId, Signal, Solution, Status};
use graphfix::models::select_ephemeris;
use graphfix::positioning::{Aiding, BaseAiding, Batch, Estimator};
use graphfix::simulation::{Scenario, Simulator};

use super::measured::{self, near, near_count};
use crate::support::data;
use crate::support::reading::{self, epochs, open};

/// A rover's recording with its base's and the navigation data of both.
struct Pair {
    navigation: Navigation,
    rover: Vec<Epoch>,
    base: Vec<Epoch>,
    station: BaseStation,
}

impl Pair {
    fn read(folder: &Path, rover: &str, base: &str, navigation: &[&str], at: Ecef) -> Self {
        Self {
            navigation: reading::navigation(folder, navigation),
            rover: epochs(&folder.join(rover)),
            base: epochs(&folder.join(base)),
            station: BaseStation { name: base.to_owned(), antenna_reference_point: at },
        }
    }

    /// Gives `take` each rover epoch, with the base epochs since the previous one as aiding.
    fn give(&self, mut take: impl FnMut(&Epoch, &Aiding<'_>)) {
        let mut given = 0;
        for epoch in &self.rover {
            let ahead = |base: &&Epoch| base.time - epoch.time <= 0.02;
            let count = self.base[given..].iter().take_while(ahead).count();
            let epochs = &self.base[given..given + count];
            given += count;
            let base = Some(BaseAiding { station: &self.station, epochs });
            take(epoch, &Aiding { navigation: &self.navigation, base });
        }
    }

    fn causal(&self, options: &PositioningOptions) -> Vec<Solution> {
        let mut estimator = Estimator::new(options.clone());
        let mut solutions = Vec::new();
        self.give(|epoch, aiding| solutions.push(estimator.advance(epoch, aiding)));
        solutions
    }

    /// The answer to each epoch when it leaves the window. Checks that the first answers are those
    /// of `causal`.
    fn smoothed(&self, options: &PositioningOptions, causal: &[Solution]) -> Vec<Solution> {
        let mut estimator = Estimator::revising(options.clone());
        let (mut solutions, mut first) = (Vec::new(), causal.iter());
        self.give(|epoch, aiding| {
            assert_eq!(Some(&estimator.advance(epoch, aiding)), first.next());
            solutions.extend(estimator.take_revisions());
        });
        solutions.extend(estimator.finish());
        solutions
    }

    fn batch(&self, options: &PositioningOptions) -> Vec<Solution> {
        let mut batch = Batch::new(options.clone());
        self.give(|epoch, aiding| batch.push(epoch, aiding));
        batch.finish()
    }
}

fn general() -> PositioningOptions {
    PositioningOptions::new(Mode::RtkFgo, Profile::General)
}

fn filter() -> PositioningOptions {
    PositioningOptions::new(Mode::RtkEkf, Profile::General)
}

fn paper() -> PositioningOptions {
    PositioningOptions::new(Mode::RtkFgo, Profile::Paper)
}

fn hers_hert() -> Option<Pair> {
    let folder = data::set("hers-hert")?;
    let at = Ecef::new(4_033_460.753_1, 23_538.016_2, 4_924_318.388_1);
    Some(Pair::read(&folder, "hers0010.18O", "hert0010.18O", &["brdc0010.18n"], at))
}

/// Chi-square limit of two degrees of freedom at 95 %.
const ELLIPSE_95: f64 = 5.991;
const HERS: Ecef = Ecef::new(4_033_469.933_7, 23_673.103_1, 4_924_301.443_3);

/// East, north and up of each solution less the truth (m).
fn errors_m(solutions: &[Solution], truth: impl Fn(GpsTime) -> Ecef) -> Vec<[f64; 3]> {
    let error = |solution: &Solution| {
        let estimate = solution.estimate.as_ref().expect("every epoch is answered");
        let enu = LocalFrame::at(truth(solution.time)).to_enu(estimate.position).0;
        [enu.x, enu.y, enu.z]
    };
    solutions.iter().map(error).collect()
}

fn fixed(solutions: &[Solution]) -> usize {
    solutions.iter().filter(|solution| solution.status == Status::Fixed).count()
}

/// A day with an epoch every 30 s, on a baseline of 136 m. 99.9 % of the epochs are fixed, and no
/// fix is 3 cm off. The horizontal rms error is below 4 mm against IGS coordinates. The height is
/// not checked: it is 6 cm off because antenna models are not applied. The filter gives the same,
/// with a few fixes less.
#[test]
fn a_day_of_two_reference_stations_is_fixed_throughout() {
    let Some(pair) = hers_hert() else { return };
    for (options, least) in [(general(), 2877), (filter(), 2873)] {
        is_fixed_throughout(&pair.causal(&options), least);
    }
}

fn is_fixed_throughout(solutions: &[Solution], least: usize) {
    let errors = errors_m(solutions, |_| HERS);
    assert_eq!(solutions.len(), 2880);
    assert!(least <= fixed(solutions), "{} fixed", fixed(solutions));
    let is_fixed = |at: &(&Solution, &[f64; 3])| at.0.status == Status::Fixed;
    let of_fixes = solutions.iter().zip(&errors).filter(is_fixed);
    let errors_m: Vec<f64> = of_fixes.map(|(_, e)| e[0].hypot(e[1])).collect();
    assert!(errors_m.iter().all(|error_m| *error_m < 0.03));
    let square: f64 = errors_m.iter().map(|error_m| error_m.powi(2)).sum();
    let rms_m = (square / errors_m.len() as f64).sqrt();
    assert!(rms_m < 0.004, "{rms_m}");
}

/// One frequency: the first minutes are float, and no fix is more than 10 cm off. If ambiguities
/// restart at each epoch, few epochs are fixed, and no fix is more than 10 cm off either.
#[test]
fn one_frequency_is_fixed_and_never_wrong() {
    let Some(pair) = hers_hert() else { return };
    for (single_epoch, measured) in
        [("false", measured::HERS_L1), ("true", measured::HERS_L1_SINGLE_EPOCH)]
    {
        let mut options = general();
        options.set("frequencies", "L1").unwrap();
        options.set("ambiguity.single_epoch", single_epoch).unwrap();
        let solutions = pair.causal(&options);
        let errors = errors_m(&solutions, |_| HERS);
        let is_fixed = |solution: &Solution| solution.status == Status::Fixed;
        let wrong =
            solutions.iter().zip(&errors).filter(|(s, e)| is_fixed(s) && 0.1 < e[0].hypot(e[1]));
        assert_eq!(wrong.count(), 0);
        near_count(fixed(&solutions), measured);
    }
}

/// A drive among towers, 4 km from its base, without truth. Epochs that are fixed in their first
/// answer agree with the batch within 10 cm. Both use the same integers, so this shows agreement
/// and not correctness.
#[test]
fn a_drive_among_towers_is_fixed_where_it_can_be() {
    let Some(folder) = data::set("klt-2021") else { return };
    let at = Ecef::new(-2_414_266.919_7, 5_386_768.986_8, 2_407_460.031_4);
    let rover = "20210610.klt1.ublox.f9p.obs";
    let pair = Pair::read(&folder, rover, "hksc1610.obs", &["hksc1610.nav"], at);
    let (causal, batch) = (pair.causal(&general()), pair.batch(&general()));
    assert_eq!((causal.len(), batch.len()), (205, 205));
    near_count(fixed(&causal), measured::KLT);
    for (at_once, later) in causal.iter().zip(&batch).filter(|(s, _)| s.status == Status::Fixed) {
        let place = |solution: &Solution| solution.estimate.as_ref().unwrap().position;
        let apart = LocalFrame::at(place(later)).to_enu(place(at_once)).0;
        assert!(apart.x.hypot(apart.y) < 0.1, "{:?}: {apart}", later.time);
    }
}

/// A walk with one frequency and a base with gaps. Most of the epochs with truth are fixed, and no
/// fix is more than 10 cm off. The limit allows for the truth, which is rounded to a grid of 2 cm
/// and up to 13 ms late.
#[test]
fn a_walk_on_one_frequency_is_fixed_and_never_wrong() {
    let Some(folder) = data::set("galway-walk") else { return };
    let at = Ecef::new(3_774_085.645_6, -601_662.576_9, 5_089_316.397);
    let [rover, base] = ["rover-20181004-1532.obs.gz", "base-20181004-1452.obs.gz"];
    let pair = Pair::read(&folder, rover, base, &["rover-20181004-1532.ubx.nav"], at);
    let rows = truth::read(open(&folder.join("truth.csv")), 2021).unwrap();
    let position = |time: GpsTime| {
        rows.iter().find(|row| (row.time - time).abs() < 0.05).map(|row| row.position)
    };
    let solutions = pair.causal(&general());
    let known: Vec<Solution> =
        solutions.into_iter().filter(|solution| position(solution.time).is_some()).collect();
    assert_eq!(known.len(), 552);
    near_count(fixed(&known), measured::GALWAY_WALK);
    let errors = errors_m(&known, |time| position(time).unwrap());
    for (solution, e) in known.iter().zip(&errors).filter(|(s, _)| s.status == Status::Fixed) {
        assert!(e[0].hypot(e[1]) < 0.1, "{:?}: {e:?}", solution.time);
    }
}

/// The published estimator on a static pair, causal and in batch. The position is good to a metre
/// and few epochs are fixed. Table 2 of Wen & Hsu (2021) is similar: 3.8 % are fixed, and the mean
/// error is 0.64 m.
#[test]
fn the_published_estimator_gives_what_it_can() {
    let Some(folder) = data::set("galway-static") else { return };
    let at = Ecef::new(3_774_089.212, -601_661.615_7, 5_089_321.247_4);
    let [rover, base] = ["rover-20181004-1237.obs.gz", "base-20181004-1236.obs.gz"];
    let pair = Pair::read(&folder, rover, base, &["rover-20181004-1237.ubx.nav"], at);
    let rows = truth::read(open(&folder.join("truth.csv")), 2021).unwrap();
    let position = |time: GpsTime| {
        rows.iter().find(|row| (row.time - time).abs() < 0.05).map(|row| row.position)
    };
    for (solutions, [mean_m, share]) in [
        (pair.causal(&paper()), measured::GALWAY_PAPER_AT_ONCE),
        (pair.batch(&paper()), measured::GALWAY_PAPER_BATCH),
    ] {
        assert_eq!(solutions.len(), 1202);
        assert!(solutions.windows(2).all(|pair| pair[0].time < pair[1].time));
        let known: Vec<Solution> =
            solutions.into_iter().filter(|solution| position(solution.time).is_some()).collect();
        let errors = errors_m(&known, |time| position(time).unwrap());
        let sum_m: f64 = errors.iter().map(|e| e[0].hypot(e[1])).sum();
        let count = known.len() as f64;
        near(&[
            ("mean (m)", sum_m / count, mean_m, 0.03 * mean_m),
            ("share fixed", fixed(&known) as f64 / count, share, 0.005),
        ]);
    }
}

/// Two static pairs on GPS's first frequency. One is fixed from the third epoch on and the other
/// from the second, and no fix is wrong. The truth of the first pair is its own position by both
/// frequencies.
#[test]
fn the_first_fix_on_one_frequency_is_soon() {
    let mut alone = general();
    alone.set("frequencies", "L1").unwrap();
    alone.set("systems", "G").unwrap();
    if let Some(folder) = data::set("geonet") {
        let at = Ecef::new(-3_978_241.958, 3_382_840.234, 3_649_900.853);
        let pair = Pair::read(&folder, "07590920.05o", "30400920.05o", &["30400920.05n"], at);
        let (both, solutions) = (pair.causal(&general()), pair.causal(&alone));
        assert_eq!(fixed(&both), 120);
        assert!(117 <= fixed(&solutions), "{} fixed", fixed(&solutions));
        let place = |solution: &Solution| solution.estimate.as_ref().unwrap().position;
        for (two, one) in both.iter().zip(&solutions).filter(|(_, s)| s.status == Status::Fixed) {
            let apart = LocalFrame::at(place(two)).to_enu(place(one)).0;
            assert!(apart.x.hypot(apart.y) < 0.05, "{:?}: {apart}", one.time);
        }
    }
    if let Some(folder) = data::set("meijo-static") {
        let base = Ecef::new(-3_817_681.121_3, 3_562_839.431_1, 3_650_159.159_3);
        let truth = Ecef::new(-3_817_681.380_7, 3_562_839.978_5, 3_650_158.376_0);
        let pair = Pair::read(&folder, "rover.obs", "base.obs", &["base.nav"], base);
        let solutions = pair.causal(&alone);
        assert!(298 <= fixed(&solutions), "{} fixed", fixed(&solutions));
        let errors = errors_m(&solutions, |_| truth);
        let fixes = solutions.iter().zip(&errors).filter(|(s, _)| s.status == Status::Fixed);
        assert!(fixes.into_iter().all(|(_, e)| e[0].hypot(e[1]) < 0.03));
    }
}

/// The filter on one frequency: no fix is more than 10 cm off.
#[test]
fn the_filter_is_never_wrong_on_one_frequency() {
    let Some(pair) = hers_hert() else { return };
    let mut options = filter();
    options.set("frequencies", "L1").unwrap();
    let solutions = pair.causal(&options);
    let errors = errors_m(&solutions, |_| HERS);
    let is_wrong =
        |(s, e): &(&Solution, &[f64; 3])| s.status == Status::Fixed && 0.1 < e[0].hypot(e[1]);
    assert_eq!(solutions.iter().zip(&errors).filter(is_wrong).count(), 0);
    near_count(fixed(&solutions), measured::HERS_L1_FILTER);
}

/// Later epochs determine the integers of float epochs, when these leave the window and in the
/// batch: the first minutes belong to the same arcs as the next ones. No fix is more than 3 cm off.
/// Every epoch is answered once and in order. An epoch whose first answer is fixed stays fixed.
#[test]
fn later_epochs_fix_earlier_ones() {
    let Some(pair) = hers_hert() else { return };
    let mut options = general();
    options.set("frequencies", "L1").unwrap();
    let causal = pair.causal(&options);
    let smoothed = pair.smoothed(&options, &causal);
    let batch = pair.batch(&options);
    for later in [&smoothed, &batch] {
        assert!(later.iter().map(|s| s.time).eq(causal.iter().map(|s| s.time)));
        let is_fixed = |s: &Solution| s.status == Status::Fixed;
        assert!(later.iter().zip(&causal).all(|(later, s)| is_fixed(later) || !is_fixed(s)));
        let errors = errors_m(later, |_| HERS);
        let fixes = later.iter().zip(&errors).filter(|(s, _)| is_fixed(s));
        assert!(fixes.into_iter().all(|(_, e)| e[0].hypot(e[1]) < 0.03));
    }
    assert_eq!(causal[0].status, Status::Float);
    assert!(fixed(&causal) < fixed(&smoothed), "{} fixed", fixed(&smoothed));
    assert_eq!(fixed(&batch), 2880);
    let square = |s: &[Solution]| errors_m(s, |_| HERS).iter().map(|e| e[2].powi(2)).sum::<f64>();
    assert!(square(&batch) < square(&smoothed) && square(&smoothed) < square(&causal));
}

/// Some epochs have no base, between others that have one. Each is answered once, in order.
#[test]
fn revisions_pass_over_a_missing_base() {
    let Some(mut pair) = hers_hert() else { return };
    pair.rover.truncate(200);
    let begin = pair.rover[60].time;
    for gap_s in [120.0, 1_800.0] {
        pair.base.retain(|epoch| !(0.0..gap_s).contains(&(epoch.time - begin)));
        let causal = pair.causal(&general());
        let batch = pair.batch(&general());
        for later in [pair.smoothed(&general(), &causal), batch] {
            assert!(later.iter().map(|s| s.time).eq(pair.rover.iter().map(|epoch| epoch.time)));
            for (later, first) in later.iter().zip(&causal) {
                assert_eq!(later.status == Status::Fgo, first.status == Status::Fgo);
            }
        }
        assert!(causal.iter().any(|solution| solution.status == Status::Fgo));
    }
}

/// Six drives in streets. Some epochs are fixed in their first answer, more when they leave the
/// window, and most in the batch. At most 1 % of the fixes are more than 10 cm off.
/// `examples/rtk_campaign.rs` has more drives.
#[test]
fn the_canyon_is_seldom_fixed_wrongly() {
    let (mut all, mut fixed, mut wrong, mut stated_wrong) = (0, [0; 3], [0; 3], [0.0; 3]);
    let (mut float, mut inside) = (0, 0);
    for seed in 1..=6 {
        let simulator = Simulator::new(Scenario::rtk_canyon(), seed);
        let navigation = simulator.navigation().clone();
        let antenna_reference_point = simulator.base_position().unwrap();
        let station = BaseStation { name: "base".to_owned(), antenna_reference_point };
        let (mut estimator, mut batch) = (Estimator::revising(general()), Batch::new(general()));
        let (mut causal, mut smoothed, mut truth) = (Vec::new(), Vec::new(), Vec::new());
        for epoch in simulator {
            let base = Some(BaseAiding { station: &station, epochs: epoch.base.as_slice() });
            let aiding = Aiding { navigation: &navigation, base };
            causal.push(estimator.advance(&epoch.rover, &aiding));
            smoothed.extend(estimator.take_revisions());
            batch.push(&epoch.rover, &aiding);
            truth.push(epoch.position);
        }
        smoothed.extend(estimator.finish());
        all += truth.len();
        for (kind, solutions) in [causal, smoothed, batch.finish()].iter().enumerate() {
            assert_eq!(solutions.len(), truth.len());
            for (solution, truth) in solutions.iter().zip(&truth) {
                let estimate = solution.estimate.as_ref().unwrap();
                let frame = LocalFrame::at(*truth);
                let error_m = frame.to_enu(estimate.position).0.xy();
                if solution.status == Status::Fixed {
                    let probability = estimate.relative.as_ref().unwrap().fix_probability;
                    fixed[kind] += 1;
                    wrong[kind] += usize::from(0.1 < error_m.norm());
                    stated_wrong[kind] += 1.0 - probability.unwrap();
                } else if kind == 0 {
                    let stated = frame.covariance_to_enu(&estimate.covariance);
                    let inverse = stated.fixed_view::<2, 2>(0, 0).try_inverse().unwrap();
                    float += 1;
                    inside += usize::from(error_m.dot(&(inverse * error_m)) < ELLIPSE_95);
                }
            }
        }
    }
    let fixed_percent = 100.0 * fixed[0] as f64 / all as f64;
    let wrong_percent = 100.0 * wrong[0] as f64 / fixed[0] as f64;
    let stated_percent = 100.0 * stated_wrong[0] / fixed[0] as f64;
    let inside_percent = 100.0 * inside as f64 / float as f64;
    near(&[
        ("fixed (%)", fixed_percent, measured::CANYON_FIXED_PERCENT, 2.0),
        // A tolerance of six fixes in about 2800.
        ("wrong (%)", wrong_percent, measured::CANYON_WRONG_PERCENT, 0.2),
        ("stated wrong (%)", stated_percent, measured::CANYON_STATED_WRONG_PERCENT, 0.1),
        ("float inside (%)", inside_percent, measured::CANYON_FLOAT_INSIDE_PERCENT, 2.0),
    ]);
    assert!(fixed[0] < fixed[1] && fixed[1] < fixed[2], "{fixed:?} of {all} fixed");
    let is_rare = |(wrong, fixed): (&usize, &usize)| 100 * wrong <= *fixed;
    assert!(wrong.iter().zip(&fixed).all(is_rare), "{wrong:?} of {fixed:?} wrong");
}

/// Three drives in streets, causal and smoothed: epochs without integers, against the graph without
/// a base on the same epochs. With the base the mean error is less than a third, and the error at
/// 95 % is less than 40 %.
#[test]
fn a_base_is_worth_something_without_integers() {
    let (mut own_m, mut alone_m) = ([const { Vec::new() }; 2], [const { Vec::new() }; 2]);
    for seed in 1..=3 {
        let simulator = Simulator::new(Scenario::rtk_canyon(), seed);
        let navigation = simulator.navigation().clone();
        let antenna_reference_point = simulator.base_position().unwrap();
        let station = BaseStation { name: "base".to_owned(), antenna_reference_point };
        let mut estimator = Estimator::revising(general());
        let mut alone = Estimator::new(PositioningOptions::new(Mode::Fgo, Profile::General));
        let (mut causal, mut smoothed, mut others) = (Vec::new(), Vec::new(), Vec::new());
        for epoch in simulator {
            let base = Some(BaseAiding { station: &station, epochs: epoch.base.as_slice() });
            causal.push(estimator.advance(&epoch.rover, &Aiding { navigation: &navigation, base }));
            smoothed.extend(estimator.take_revisions());
            let other = alone.advance(&epoch.rover, &Aiding::alone(&navigation));
            others.push((epoch.position, other.estimate.unwrap().position));
        }
        smoothed.extend(estimator.finish());
        for (kind, solutions) in [causal, smoothed].into_iter().enumerate() {
            assert_eq!(solutions.len(), others.len());
            for (solution, (truth, other)) in solutions.into_iter().zip(&others) {
                let error_m = |at| LocalFrame::at(*truth).to_enu(at).0.xy().norm();
                if solution.status != Status::Fixed {
                    assert_eq!(solution.status, Status::Float);
                    own_m[kind].push(error_m(solution.estimate.unwrap().position));
                    alone_m[kind].push(error_m(*other));
                }
            }
        }
    }
    for (own_m, alone_m) in own_m.iter().zip(&alone_m) {
        let [own, alone] = [own_m, alone_m].map(|errors| ErrorStatistics::of(errors).unwrap());
        assert!(3.0 * own.mean < alone.mean && 2.5 * own.p95 < alone.p95, "{own:?}, {alone:?}");
    }
}

/// Without a search for integers every epoch is float, in the graph and in the filter, and no
/// reason states that a fix was refused.
#[test]
fn integers_that_are_not_asked_for_are_not_searched() {
    for mut options in [general(), filter()] {
        options.set("ambiguity.resolve", "off").unwrap();
        let simulator = Simulator::new(
            Scenario { duration_s: 20.0, ..Scenario::by_name("rtk-open").unwrap() },
            3,
        );
        let navigation = simulator.navigation().clone();
        let antenna_reference_point = simulator.base_position().unwrap();
        let station = BaseStation { name: "base".to_owned(), antenna_reference_point };
        let mut estimator = Estimator::new(options);
        for (index, epoch) in simulator.enumerate() {
            let base = Some(BaseAiding { station: &station, epochs: epoch.base.as_slice() });
            let aiding = Aiding { navigation: &navigation, base };
            let solution = estimator.advance(&epoch.rover, &aiding);
            assert_eq!(solution.status, Status::Float);
            assert!(!solution.reasons.contains(&Reason::FixRejected), "{:?}", solution.reasons);
            let relative = solution.estimate.unwrap().relative.unwrap();
            // In the first epoch the half cycles of all phases are unknown, so there is no
            // ambiguity to estimate.
            let is_estimated = index == 0 || 10 < relative.ambiguities;
            assert!(relative.fixed_ambiguities == 0 && is_estimated, "{relative:?}");
        }
    }
}

/// The integers of GLONASS, each with its own wavelength, are found together with those of GPS.
/// This also works if the delays of the two receivers differ by 3 cm per channel, as between some
/// makers.
#[test]
fn integers_of_glonass_are_found() {
    for (slope_m, least) in [(0.0, 50), (0.03, 1)] {
        let constellations = vec![Constellation::Gps, Constellation::Glonass];
        let open = Scenario::by_name("rtk-open").unwrap();
        let simulator = Simulator::new(Scenario { constellations, duration_s: 300.0, ..open }, 2);
        let navigation = simulator.navigation().clone();
        let antenna_reference_point = simulator.base_position().unwrap();
        let station = BaseStation { name: "base".to_owned(), antenna_reference_point };
        let mut estimator = Estimator::new(general());
        let (mut fixed, mut beyond_gps) = (0, 0);
        for mut epoch in simulator {
            shift_channels(&mut epoch.rover, &navigation, slope_m);
            let base = Some(BaseAiding { station: &station, epochs: epoch.base.as_slice() });
            let aiding = Aiding { navigation: &navigation, base };
            let solution = estimator.advance(&epoch.rover, &aiding);
            let estimate = solution.estimate.as_ref().unwrap();
            if solution.status != Status::Fixed {
                continue;
            }
            let error = LocalFrame::at(epoch.position).to_enu(estimate.position).0.xy().norm();
            assert!(error < 0.1, "{error} m off");
            fixed += 1;
            beyond_gps += usize::from(is_fixed_beyond_gps(&solution));
        }
        assert!(250 < fixed && least <= beyond_gps, "{slope_m} m: {fixed} fixed, {beyond_gps}");
    }
}

/// In each epoch one pseudorange is a millisecond off. At most two fixes are lost. The position is
/// the same to a millimetre, and the time of reception to a tenth of a microsecond.
#[test]
fn a_wild_pseudorange_moves_no_fix() {
    let mut turn = 0;
    let disturbed = answers_of_a_rover(&mut |epoch, _| {
        let count = epoch.observations.len();
        let range_m = epoch.observations[turn % count].pseudorange_m.as_mut();
        range_m.into_iter().for_each(|range_m| *range_m += 1e-3 * SPEED_OF_LIGHT);
        turn += 7;
    });
    let clean = answers_of_a_rover(&mut |_, _| {});
    let is_fixed = |solution: &Solution| solution.status == Status::Fixed;
    assert!(250 < fixed(&clean) && fixed(&clean) <= fixed(&disturbed) + 2, "{}", fixed(&disturbed));
    for (a, b) in clean.iter().zip(&disturbed).filter(|(a, b)| is_fixed(a) && is_fixed(b)) {
        let place = |solution: &Solution| solution.estimate.as_ref().unwrap().position;
        let apart_m = place(a).distance_m(place(b));
        assert!(apart_m < 1e-3, "{:?}: {apart_m} m apart", a.time);
        let received = |solution: &Solution| solution.estimate.as_ref().unwrap().reception_time;
        let apart_s = received(a) - received(b);
        assert!(apart_s.abs() < 1e-7, "{:?}: {apart_s} s apart", a.time);
    }
}

/// One satellite in each epoch has phases of 10¹⁶ cycles, which no `f64` resolves, as UBX and RINEX
/// can contain. They are not used, and the others are fixed.
#[test]
fn phases_beyond_resolution_block_no_fix() {
    let disturbed = answers_of_a_rover(&mut |epoch, _| {
        let wild = epoch.observations[0].satellite;
        let of_wild = epoch.observations.iter_mut().filter(|o| o.satellite == wild);
        of_wild.filter_map(|o| o.carrier_phase.as_mut()).for_each(|phase| phase.0 += 1e16);
    });
    assert!(250 < fixed(&disturbed), "{}", fixed(&disturbed));
}

/// The receiver's clock steps by a millisecond, and its phases continue without a step. Ten seconds
/// later all phases lose lock. The integers of GLONASS are found as before.
#[test]
fn phases_that_run_on_over_a_step_of_the_clock_keep_their_integers() {
    let mut count = 0;
    let stepped = answers_of_a_rover(&mut |epoch, navigation| {
        count += 1;
        if 100 < count {
            step_clock(epoch, navigation, 1e-3);
        }
        for observation in &mut epoch.observations {
            observation.loss_of_lock |= count == 110;
        }
    });
    let beyond_gps = stepped[150..].iter().filter(|solution| is_fixed_beyond_gps(solution));
    let (late, beyond_gps) = (fixed(&stepped[150..]), beyond_gps.count());
    assert!(140 < late && 50 <= beyond_gps, "{late} fixed, {beyond_gps} with GLONASS");
}

/// A receiver whose clock is ahead samples earlier: P − Ṗ·Δ + c·Δ, and phases λφ − Ṗ·Δ.
fn step_clock(epoch: &mut Epoch, navigation: &Navigation, ahead_s: f64) {
    for observation in &mut epoch.observations {
        let ephemeris = select_ephemeris(navigation, observation.satellite, epoch.time);
        let signal = Signal::of(observation.satellite, observation.code);
        let channel = ephemeris.and_then(Ephemeris::glonass_channel);
        let wavelength_m = SPEED_OF_LIGHT / signal.frequency_hz(channel).unwrap();
        let earlier_m = -wavelength_m * observation.doppler_hz.unwrap() * ahead_s;
        let range_m = observation.pseudorange_m.as_mut();
        range_m.into_iter().for_each(|m| *m += SPEED_OF_LIGHT * ahead_s - earlier_m);
        let phase = observation.carrier_phase.as_mut();
        phase.into_iter().for_each(|phase| phase.0 -= earlier_m / wavelength_m);
    }
}

/// Five minutes of a simulated rover with GPS and GLONASS, each epoch disturbed.
fn answers_of_a_rover(disturb: &mut dyn FnMut(&mut Epoch, &Navigation)) -> Vec<Solution> {
    let constellations = vec![Constellation::Gps, Constellation::Glonass];
    let open = Scenario::by_name("rtk-open").unwrap();
    let simulator = Simulator::new(Scenario { constellations, duration_s: 300.0, ..open }, 2);
    let navigation = simulator.navigation().clone();
    let antenna_reference_point = simulator.base_position().unwrap();
    let station = BaseStation { name: "base".to_owned(), antenna_reference_point };
    let mut estimator = Estimator::new(general());
    let answers = simulator.map(|mut epoch| {
        disturb(&mut epoch.rover, &navigation);
        let base = Some(BaseAiding { station: &station, epochs: epoch.base.as_slice() });
        estimator.advance(&epoch.rover, &Aiding { navigation: &navigation, base })
    });
    answers.collect()
}

/// Whether a solution is fixed with more integers than the differences of GPS on two bands: some
/// integers are then of GLONASS.
fn is_fixed_beyond_gps(solution: &Solution) -> bool {
    let estimate = solution.estimate.as_ref().unwrap();
    let is_gps = |satellite: &&SatelliteId| satellite.constellation == Constellation::Gps;
    // Two bands, each with a reference satellite.
    let of_gps = 2 * (estimate.satellites_used.iter().filter(is_gps).count() - 1);
    let relative = estimate.relative.as_ref().unwrap();
    solution.status == Status::Fixed && of_gps < relative.fixed_ambiguities
}

/// Delays the phases of GLONASS by `slope_m` times the channel number.
fn shift_channels(epoch: &mut Epoch, navigation: &Navigation, slope_m: f64) {
    for observation in &mut epoch.observations {
        let ephemeris = select_ephemeris(navigation, observation.satellite, epoch.time);
        let Some(channel) = ephemeris.and_then(Ephemeris::glonass_channel) else { continue };
        let signal = Signal::of(observation.satellite, observation.code);
        let wavelength_m = SPEED_OF_LIGHT / signal.frequency_hz(Some(channel)).unwrap();
        let cycles = f64::from(channel) * slope_m / wavelength_m;
        observation.carrier_phase.iter_mut().for_each(|phase| phase.0 += cycles);
    }
}

/// On a baseline of 8 km under an ionosphere with a gradient, fixes are biased by some centimetres
/// for minutes. The covariance states errors of about this size.
#[test]
fn fixes_state_what_the_ionosphere_leaves() {
    let simulator = Simulator::new(Scenario::by_name("rtk-open").unwrap(), 1);
    let navigation = simulator.navigation().clone();
    let antenna_reference_point = simulator.base_position().unwrap();
    let station = BaseStation { name: "base".to_owned(), antenna_reference_point };
    let mut estimator = Estimator::new(general());
    let (mut fixed, mut inside, mut squares) = (0, 0, 0.0);
    for epoch in simulator {
        let base = Some(BaseAiding { station: &station, epochs: epoch.base.as_slice() });
        let solution = estimator.advance(&epoch.rover, &Aiding { navigation: &navigation, base });
        if solution.status != Status::Fixed {
            continue;
        }
        let estimate = solution.estimate.unwrap();
        let frame = LocalFrame::at(epoch.position);
        let error = frame.to_enu(estimate.position).0.xy();
        let covariance = frame.rotation * estimate.covariance * frame.rotation.transpose();
        let inverse = covariance.fixed_view::<2, 2>(0, 0).try_inverse().unwrap();
        let square = error.dot(&(inverse * error));
        fixed += 1;
        inside += usize::from(square < ELLIPSE_95);
        squares += 0.5 * square;
    }
    let normalised = (squares / fixed as f64).sqrt();
    assert!(500 < fixed && 9 * fixed <= 10 * inside, "{inside} of {fixed} inside");
    assert!((0.3..=1.5).contains(&normalised), "{normalised}");
}

/// Signals of a hardware simulator, on a baseline of 2 km. The errors of 2 mm come from the
/// rounding of phases and from the troposphere.
#[test]
fn simulated_signals_are_fixed_to_millimetres() {
    [general(), filter()].iter().for_each(spirent_is_fixed_to_millimetres);
}

fn spirent_is_fixed_to_millimetres(options: &PositioningOptions) {
    let Some(folder) = data::set("spirent-rtk") else { return };
    let at = Ecef::new(4_157_177.065_801_87, 671_230.476_590_636, 4_774_767.031_055_44);
    let navigation = ["RINEX_GN_Spirent.23N", "RINEX_EN_Spirent.23L"];
    let base = "Base-static_MO_Spirent.obs";
    let still = "Rover-static-2km-east_MO_Spirent.obs";
    let solutions = Pair::read(&folder, still, base, &navigation, at).causal(options);
    let truth = Ecef::new(4_156_857.119_592_9, 673_209.028_774_142, 4_774_767.031_055_44);
    assert_eq!((solutions.len(), fixed(&solutions)), (601, 601));
    let far = |e: &[f64; 3]| 0.0025 < e.iter().map(|m| m * m).sum::<f64>().sqrt();
    assert!(!errors_m(&solutions, |_| truth).iter().any(far));

    let moving = "Rover-dynamic_MO_Spirent.obs";
    let solutions = Pair::read(&folder, moving, base, &navigation, at).causal(options);
    let week = solutions[0].time.week();
    let track = truth::read(open(&folder.join("truth-dynamic.csv")), week).unwrap();
    let at = |time: GpsTime| {
        let found = track.iter().find(|row| (row.time - time).abs() < 1e-3);
        found.expect("truth is at every epoch").position
    };
    assert_eq!((solutions.len(), fixed(&solutions)), (601, 601));
    assert!(!errors_m(&solutions, at).iter().any(far));
}

/// Half an hour without a base: the graph or the filter without a base answers, with the reason.
/// Epochs are fixed again within a minute of the base's return.
#[test]
fn a_missing_base_is_said_and_survived() {
    for (options, alone) in [(general(), Status::Fgo), (filter(), Status::Ekf)] {
        is_survived(&options, alone);
    }
}

fn is_survived(options: &PositioningOptions, alone: Status) {
    let Some(mut pair) = hers_hert() else { return };
    pair.rover.truncate(300);
    let begin = pair.rover[100].time;
    pair.base.retain(|epoch| !(0.0..1_800.0).contains(&(epoch.time - begin)));
    let solutions = pair.causal(options);
    let is_stale = |reason: &Reason| matches!(reason, Reason::BaseStale { .. });
    for (k, solution) in solutions.iter().enumerate() {
        // The base epoch before the gap is used until it is 30 s old.
        let is_gone = (101..160).contains(&k);
        let expected = if is_gone { alone } else { Status::Fixed };
        // All arcs begin again with the base: two epochs may pass before they are fixed.
        let is_new = (160..162).contains(&k) && solution.status == Status::Float;
        assert!(solution.status == expected || is_new, "epoch {k}: {:?}", solution.reasons);
        assert_eq!(solution.reasons.iter().any(is_stale), is_gone, "epoch {k}");
    }
}

/// A base whose stated position is 150 m off is refused; one that is 20 m off is reported as
/// doubtful.
#[test]
fn a_wrong_base_position_is_refused_or_doubted() {
    let Some(mut pair) = hers_hert() else { return };
    pair.rover.truncate(20);
    let right = pair.station.antenna_reference_point;
    for (off_m, status) in [(150.0, Status::Fgo), (20.0, Status::Fixed)] {
        pair.station.antenna_reference_point = Ecef(right.0 + nalgebra::Vector3::x() * off_m);
        for solution in pair.causal(&general()) {
            assert_eq!(solution.status, status, "{off_m} m off");
            let doubt = |reason: &Reason| match reason {
                Reason::BasePositionDoubtful { distance_m } => (distance_m - off_m).abs() < 10.0,
                _ => false,
            };
            assert!(solution.reasons.iter().any(doubt), "{:?}", solution.reasons);
        }
    }
}

/// An estimator that is stored and restored after every epoch gives the same bits as one that is
/// not, also while the base is missing.
#[test]
fn a_restored_estimator_goes_on_with_the_same_bits() {
    for (options, alone) in
        [(general(), Status::Fgo), (filter(), Status::Ekf), (paper(), Status::Fgo)]
    {
        goes_on_with_the_same_bits(options, alone);
    }
}

fn goes_on_with_the_same_bits(options: PositioningOptions, alone: Status) {
    let Some(mut pair) = hers_hert() else { return };
    pair.rover.truncate(90);
    pair.base.drain(30..36);
    let (mut whole, mut restored) =
        (Estimator::revising(options.clone()), Estimator::revising(options.clone()));
    let (mut states, mut revised) = (Vec::new(), 0);
    pair.give(|epoch, aiding| {
        restored = Estimator::restore(options.clone(), &restored.snapshot()).unwrap();
        let expected = (whole.advance(epoch, aiding), whole.take_revisions());
        let answer = (restored.advance(epoch, aiding), restored.take_revisions());
        assert_eq!(format!("{answer:?}"), format!("{expected:?}"), "epoch {}", states.len());
        assert_eq!(restored.oldest_unrevised(), whole.oldest_unrevised());
        states.push(answer.0.status);
        revised += answer.1.len();
    });
    assert!(states.contains(&Status::Fixed) && states.contains(&alone), "{states:?}");
    let left = restored.finish();
    assert_eq!(format!("{left:?}"), format!("{:?}", whole.finish()));
    let has_window = options.mode.has_window();
    assert_eq!(revised + left.len(), if has_window { states.len() } else { 0 });
}
