//! Navigation: uploads and status.

use crate::aiding::{NavigationStatus, SatelliteCoverage};
use crate::contract::{Caller, Refusal, v1};
use crate::formats::rinex;
use crate::refusal::Code;

use super::feeds;
use super::upload::{read_file, read_text};

/// Memory for one ephemeris of each satellite of all constellations (bytes).
const MEMORY_OF_NUMBER: usize = 200 * 320;

/// Reads a RINEX navigation file and stores its ephemerides.
///
/// # Errors
/// The file is not readable or exceeds a limit, or the store fails.
pub async fn push(
    caller: &Caller,
    request: v1::PushNavigationRequest,
) -> Result<v1::PushNavigationResponse, Refusal> {
    caller.noted("Navigation.Push", "", pushed(caller, request).await).await
}

async fn pushed(
    caller: &Caller,
    request: v1::PushNavigationRequest,
) -> Result<v1::PushNavigationResponse, Refusal> {
    let limits = caller.limits();
    let (bytes_max, most) = (limits.decompressed_bytes, limits.ephemerides_per_satellite);
    let read = move || {
        let upload = read_text(&request.content, bytes_max, |text| {
            rinex::read_navigation_within(text, most)
        })?;
        match upload.is_cut() && upload.content.0.is_empty() {
            true => Err(upload.blamed(Refusal::new(Code::RinexTruncated, "no ephemeris"))),
            false => Ok(upload),
        }
    };
    let upload = read_file(caller, most * MEMORY_OF_NUMBER, read).await?;
    let mut skipped = upload.skipped(&upload.content.1);
    let (navigation, _) = upload.content;
    let counts = caller.navigation().push(navigation).await?;
    if 0 < counts.left_out {
        skipped.push(v1::Skipped {
            what: "ephemerides that contradict data of higher trust, or for which the satellite \
                   has no room (limits.ephemerides_per_satellite)"
                .to_owned(),
            count: counts.left_out as u64,
            first_line: 0,
        });
    }
    let change = format!("{} ephemerides, {} of them new", counts.received, counts.new);
    caller.note("Navigation.Push", change).await?;
    Ok(v1::PushNavigationResponse {
        ephemerides: counts.received as u64,
        new_ephemerides: counts.new as u64,
        skipped,
    })
}

/// The satellites with usable ephemerides, and the sources of ephemerides.
pub fn status(caller: &Caller) -> v1::NavigationStatusResponse {
    let status = caller.navigation().status();
    v1::NavigationStatusResponse {
        ephemerides: status.ephemerides as u64,
        ionosphere_models: ionosphere_models(&status),
        satellites: status.satellites.iter().map(coverage).collect(),
        sources: caller
            .feeds()
            .navigation_sources()
            .into_iter()
            .map(feeds::source_message)
            .collect(),
    }
}

fn coverage(coverage: &SatelliteCoverage) -> v1::SatelliteCoverage {
    v1::SatelliteCoverage {
        satellite: coverage.satellite.to_string(),
        ephemerides: coverage.ephemerides as u32,
        covered_from: coverage.usable.map(|(from, _)| from.into()),
        covered_until: coverage.usable.map(|(_, until)| until.into()),
        source: coverage.source.clone(),
    }
}

fn ionosphere_models(status: &NavigationStatus) -> Vec<String> {
    let held = [
        (status.klobuchar_gps, "klobuchar-gps"),
        (status.klobuchar_beidou, "klobuchar-beidou"),
        (status.klobuchar_qzss, "klobuchar-qzss"),
        (status.nequick, "nequick-g"),
    ];
    held.into_iter().filter(|(held, _)| *held).map(|(_, name)| name.to_owned()).collect()
}
