//! Any bytes after the title of a GnssLogger log, whole and split in two: no panic, and the same
//! epochs.
#![no_main]

use graphfix::formats::gnss_logger::Decoder;
use libfuzzer_sys::fuzz_target;

const TITLE: &[u8] = b"# Raw,TimeNanos,FullBiasNanos,BiasNanos,LeapSecond,\
    HardwareClockDiscontinuityCount,Svid,ConstellationType,State,ReceivedSvTimeNanos,\
    TimeOffsetNanos,Cn0DbHz,PseudorangeRateMetersPerSecond,AccumulatedDeltaRangeState,\
    AccumulatedDeltaRangeMeters,CarrierFrequencyHz,CodeType\n";

fuzz_target!(|data: &[u8]| {
    let (first, second) = data.split_at(data.len() / 2);
    let decoded = [&[data, &[]], &[first, second]].map(|chunks: &[&[u8]; 2]| {
        let (mut decoder, mut epochs) = (Decoder::new(), Vec::new());
        let outcome = [TITLE, chunks[0], chunks[1]]
            .iter()
            .try_for_each(|chunk| decoder.push(chunk, &mut epochs))
            .and_then(|()| decoder.finish(&mut epochs));
        (outcome.is_ok(), epochs.len())
    });
    assert_eq!(decoded[0], decoded[1]);
});
