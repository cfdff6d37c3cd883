//! A simulated rover with its base, for tests without data.

use std::sync::LazyLock;

use graphfix::aiding::bases::{BaseId, NewBase};
use graphfix::config::{Mode, PositioningOptions, Profile};
use graphfix::formats::rinex::{ObservationHeader, ObservationWriter, RinexVersion};
use graphfix::gnss::{
    BaseSite, BaseStation, Constellation, Ecef, Ephemeris, Epoch, Geodetic, GpsTime, Navigation,
    PositionSource, Solution,
};
use graphfix::positioning::{Aiding, BaseAiding, Estimator};
use graphfix::session::SequencedEpoch;
use graphfix::simulation::{Scenario, Simulator};

pub(crate) struct Pair {
    /// Numbered from 1.
    pub(crate) rover: Vec<SequencedEpoch>,
    /// Epochs of the base at the rover's times.
    pub(crate) base: Vec<Epoch>,
    pub(crate) navigation: Navigation,
    /// Position of the base's antenna.
    pub(crate) position: Ecef,
    scenario: Scenario,
}

/// Two and a half minutes under open sky, an epoch a second, the base 8 km away.
pub(crate) static PAIR: LazyLock<Pair> =
    LazyLock::new(|| simulated(Scenario::by_name("rtk-open").unwrap().start));

/// The same for 20 s in Munich.
pub(crate) static MUNICH: LazyLock<Pair> = LazyLock::new(|| {
    let open = Scenario::by_name("rtk-open").unwrap();
    let origin = Geodetic::from_degrees(48.1, 11.5, 550.0);
    pair(Scenario { origin, duration_s: 19.0, ..open })
});

/// The same, starting at another time.
pub(crate) fn simulated(start: GpsTime) -> Pair {
    let open = Scenario::by_name("rtk-open").unwrap();
    pair(Scenario { start, duration_s: 149.0, ..open })
}

fn pair(scenario: Scenario) -> Pair {
    let simulator = Simulator::new(scenario.clone(), 1);
    let navigation = Navigation::clone(simulator.navigation());
    let position = simulator.base_position().unwrap();
    let (rover, base): (Vec<Epoch>, Vec<Epoch>) =
        simulator.map(|epoch| (epoch.rover, epoch.base.unwrap())).unzip();
    let number = |(index, epoch)| SequencedEpoch { seq: index as u64 + 1, epoch };
    let rover = rover.into_iter().enumerate().map(number).collect();
    Pair { rover, base, navigation, position, scenario }
}

impl Pair {
    /// The base with a stated position `off_m` east and as much north of the true one.
    pub(crate) fn new_base(&self, off_m: f64) -> NewBase {
        let frame = graphfix::gnss::LocalFrame::at(self.position);
        let there = graphfix::gnss::Enu(nalgebra::Vector3::new(off_m, off_m, 0.0));
        let marker = if off_m == 0.0 { self.position } else { frame.to_ecef(there) };
        let site = BaseSite {
            marker,
            antenna_delta_hen_m: [0.0; 3],
            antenna: String::new(),
            calibration: None,
            source: PositionSource::Given,
        };
        NewBase { label: "base".to_owned(), site: Some(site), ..NewBase::default() }
    }

    /// The base's observations at another position, at this distance from the origin, and that
    /// position.
    pub(crate) fn base_elsewhere(&self, distance_m: f64) -> (Vec<Epoch>, Ecef) {
        let simulator = Simulator::new(self.scenario.clone().with_baseline(distance_m), 1);
        let position = simulator.base_position().unwrap();
        (simulator.map(|epoch| epoch.base.unwrap()).collect(), position)
    }

    /// Answers of an estimator without a service, with all base epochs.
    pub(crate) fn solved(&self, mode: Mode, base: &BaseId) -> Vec<Solution> {
        let options = PositioningOptions::new(mode, Profile::General);
        let mut estimator = Estimator::new(options);
        let station =
            BaseStation { name: base.to_string(), antenna_reference_point: self.position };
        let mut given = 0;
        let answer = |rover: &SequencedEpoch| {
            let ahead = |base: &&Epoch| base.time - rover.epoch.time <= 0.02;
            let count = self.base[given..].iter().take_while(ahead).count();
            let epochs = &self.base[given..given + count];
            given += count;
            let base = Some(BaseAiding { station: &station, epochs });
            estimator.advance(&rover.epoch, &Aiding { navigation: &self.navigation, base })
        };
        self.rover.iter().map(answer).collect()
    }

    /// The rover's observations as a file.
    pub(crate) fn rover_file(&self) -> Vec<u8> {
        let epochs: Vec<Epoch> = self.rover.iter().map(|rover| rover.epoch.clone()).collect();
        self.file_of(&epochs, None)
    }

    /// The base's observations as a file whose header has a position.
    pub(crate) fn base_file(&self, position: Option<Ecef>) -> Vec<u8> {
        self.file_of(&self.base, position)
    }

    /// A file of some of them.
    pub(crate) fn file_of(&self, epochs: &[Epoch], position: Option<Ecef>) -> Vec<u8> {
        let mut codes = [const { Vec::new() }; Constellation::COUNT];
        for constellation in &self.scenario.constellations {
            codes[constellation.index()] = self.scenario.signals(*constellation).collect();
        }
        let channel = |list: &[Ephemeris]| {
            let first = list.first()?;
            Some((first.satellite().number, first.glonass_channel()?))
        };
        let header = ObservationHeader {
            approximate_position: position,
            antenna_delta_hen_m: [1.5, 0.0, 0.0],
            antenna: "IDEAL".to_owned(),
            glonass_channels: self
                .navigation
                .satellites()
                .filter_map(|(_, l)| channel(l))
                .collect(),
            codes,
            ..ObservationHeader::new(RinexVersion::new(3, 5))
        };
        let mut file = Vec::new();
        let mut writer = ObservationWriter::new(&mut file, &header).unwrap();
        epochs.iter().for_each(|epoch| writer.write_epoch(epoch).unwrap());
        writer.finish().unwrap();
        file
    }
}
