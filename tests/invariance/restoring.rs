//! Estimators that are stored and restored give the same bits, in every mode and at every epoch.

use std::sync::LazyLock;

use graphfix::config::{Mode, PositioningOptions, Profile};
use graphfix::gnss::{Epoch, Navigation, Solution};
use graphfix::positioning::{Aiding, Estimator};
use graphfix::snapshot::SnapshotError;
use proptest::prelude::*;

use crate::support::data;
use crate::support::recording::Recording;

/// A drive through a canyon with what restarts a window, and with what just does not: gaps above
/// and below the limit, epochs with few satellites and without any.
fn eventful_drive(epochs: usize) -> Option<Recording> {
    let folder = data::set("tst-2019")?;
    let files = ["hksc1180.19n", "hksc1180.19b"];
    let mut recording = Recording::read(&folder, "COM3_190428_124409.obs", &files);
    recording.epochs.retain(|epoch| 46_701.0 <= epoch.time.seconds_of_week());
    for epoch in &mut recording.epochs[36..39] {
        epoch.observations.retain(|observation| observation.satellite.number < 8);
    }
    recording.epochs[44].observations.clear();
    recording.epochs.drain(60..90);
    recording.epochs.drain(75..200);
    recording.epochs.truncate(epochs);
    Some(recording)
}

/// The answer and the revisions of an epoch as text, which shows every bit.
fn answers(estimator: &mut Estimator, epoch: &Epoch, navigation: &Navigation) -> String {
    let now: Solution = estimator.advance(epoch, &Aiding::alone(navigation));
    format!("{now:?} {:?}", estimator.take_revisions())
}

/// An estimator that is restored after each epoch and one that never is give the same answers and
/// the same revisions, also at the end.
#[test]
fn an_estimator_restored_after_every_epoch_answers_alike() {
    let Some(recording) = eventful_drive(120) else { return };
    for mode in Mode::ALL {
        for profile in Profile::ALL {
            let options = PositioningOptions::new(*mode, *profile);
            let mut whole = Estimator::revising(options.clone());
            let mut restored = Estimator::revising(options.clone());
            for (index, epoch) in recording.epochs.iter().enumerate() {
                let snapshot = restored.snapshot();
                restored = Estimator::restore(options.clone(), &snapshot).unwrap();
                assert_eq!(restored.snapshot(), snapshot);
                let expected = answers(&mut whole, epoch, &recording.navigation);
                let answer = answers(&mut restored, epoch, &recording.navigation);
                assert_eq!(answer, expected, "{mode:?} {profile:?} epoch {index}");
            }
            assert_eq!(restored.oldest_unrevised(), whole.oldest_unrevised());
            assert_eq!(format!("{:?}", restored.finish()), format!("{:?}", whole.finish()));
        }
    }
}

#[test]
fn a_snapshot_of_other_options_is_refused() {
    let Some(recording) = eventful_drive(40) else { return };
    let options = PositioningOptions::new(Mode::Fgo, Profile::UrbanVehicle);
    let mut estimator = Estimator::new(options);
    for epoch in &recording.epochs {
        answers(&mut estimator, epoch, &recording.navigation);
    }
    let snapshot = estimator.snapshot();
    for other in [
        PositioningOptions::new(Mode::Spp, Profile::UrbanVehicle),
        PositioningOptions::new(Mode::Fgo, Profile::Paper),
    ] {
        let error = Estimator::restore(other, &snapshot).unwrap_err();
        assert!(matches!(error, SnapshotError::Invalid { .. }), "{error}");
    }
}

/// A snapshot with changed bytes and the hash of these bytes. Only a fault of the program could
/// write such a snapshot.
fn resealed(mut bytes: Vec<u8>, changes: &[(prop::sample::Index, u8)]) -> Vec<u8> {
    bytes.truncate(bytes.len() - 8);
    for (place, byte) in changes {
        let place = 2 + place.index(bytes.len() - 2);
        bytes[place] = *byte;
    }
    let hash = blake3::hash(&bytes);
    bytes.extend_from_slice(&hash.as_bytes()[..8]);
    bytes
}

/// A snapshot of each mode's estimator after some epochs. Empty without the data.
static SNAPSHOTS: LazyLock<Vec<(Mode, Vec<u8>)>> = LazyLock::new(|| {
    let Some(recording) = eventful_drive(34) else { return Vec::new() };
    let of_mode = |mode: &Mode| {
        let mut estimator = Estimator::new(PositioningOptions::new(*mode, Profile::General));
        for epoch in &recording.epochs {
            answers(&mut estimator, epoch, &recording.navigation);
        }
        (*mode, estimator.snapshot())
    };
    Mode::ALL.iter().map(of_mode).collect()
});

proptest! {
    #![proptest_config(ProptestConfig::with_cases(512))]

    /// Corrupt snapshots are refused or read as other snapshots; they never cause a panic.
    #[test]
    fn corrupt_snapshots_never_panic(
        mode in prop::sample::select(Mode::ALL),
        changes in prop::collection::vec((any::<prop::sample::Index>(), any::<u8>()), 1..8),
    ) {
        let options = PositioningOptions::new(mode, Profile::General);
        let of_mode = SNAPSHOTS.iter().find(|(of, _)| *of == mode);
        let Some((_, snapshot)) = of_mode else { return Ok(()) };
        let mut broken = snapshot.clone();
        let (place, byte) = &changes[0];
        let place = place.index(broken.len());
        broken[place] = byte.wrapping_add(u8::from(*byte == broken[place]));
        prop_assert_eq!(
            Estimator::restore(options.clone(), &broken).unwrap_err(),
            SnapshotError::Corrupt
        );
        let changed = resealed(snapshot.clone(), &changes);
        if let Ok(other) = Estimator::restore(options.clone(), &changed) {
            let again = Estimator::restore(options, &other.snapshot());
            prop_assert!(again.is_ok());
        }
    }
}
