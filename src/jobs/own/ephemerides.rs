//! The ephemerides to add to a job: those that the service has, or files of archives.

use crate::feeds::{ArchivedFile, NavigationArchives};
use crate::formats::rinex::{read_navigation, write_navigation};
use crate::formats::unpack_within;
use crate::gnss::constants::SECONDS_PER_HOUR;
use crate::gnss::{Ephemeris, GpsTime, Navigation};
use crate::jobs::Failure;
use crate::recording::InForce;
use crate::refusal::Code;

use super::UNPACKED_LIMIT;
use super::background::in_background;

/// Name of the input with the ephemerides that the service has.
const OWN_NAVIGATION: &str = "the service's own ephemerides";
/// Files of this much time before a recording may have ephemerides for its begin (s).
const BEFORE_S: f64 = 2.0 * SECONDS_PER_HOUR;

/// The files of ephemerides to add for a span of time, each with its name: those that the service
/// has `now`, or those of the archives.
pub(super) async fn chosen(
    now: &Navigation,
    archives: Option<&NavigationArchives>,
    span: Option<(GpsTime, GpsTime)>,
) -> Result<Vec<(String, Vec<u8>, Navigation)>, Failure> {
    let mut own = now.clone();
    own.retain(Ephemeris::is_legacy);
    let in_force = span.map_or(InForce::Always, |span| InForce::of(&own, span));
    let mut problem = None;
    if in_force != InForce::Always
        && let (Some((from, until)), Some(archives)) = (span, archives)
    {
        match archives.files((from - BEFORE_S, until)).await {
            Err(error) => problem = Some(error.to_string()),
            Ok(files) => {
                let mut read = Vec::new();
                for ArchivedFile { url, content } in files {
                    match in_background(move || Ok(read_file(content))).await? {
                        Ok((content, navigation)) => {
                            read.push((url.to_string(), content, navigation));
                        }
                        Err(why) => problem = Some(format!("{url}: {why}")),
                    }
                }
                if !read.is_empty() {
                    return Ok(read);
                }
            }
        }
    }
    if own.is_empty() || in_force == InForce::Never {
        let of = span.map_or_else(String::new, |(from, _)| format!(" of {from}"));
        let mut message = format!("there are no ephemerides{of}: neither in the files, nor here");
        if let Some(problem) = problem {
            message = format!("{message} ({problem})");
        }
        return Err(Failure::new(Code::NavigationRequired, message, Some("navigation")));
    }
    in_background(move || {
        let mut content = Vec::new();
        match write_navigation(&mut content, &own) {
            Ok(()) => Ok(vec![(OWN_NAVIGATION.to_owned(), content, own)]),
            Err(error) => {
                let message = format!("writing the service's ephemerides: {error}");
                Err(Failure::new(Code::Internal, message, None))
            }
        }
    })
    .await
}

/// The bytes of a file and the ephemerides in it.
fn read_file(content: Vec<u8>) -> Result<(Vec<u8>, Navigation), String> {
    let read = read_navigation(unpack_within(&content, UNPACKED_LIMIT));
    let navigation = read.map_err(|error| error.to_string())?.0;
    match navigation.is_empty() {
        true => Err("the file has no ephemerides".to_owned()),
        false => Ok((content, navigation)),
    }
}
