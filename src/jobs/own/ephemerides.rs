//! The ephemerides to add to a job: those of the service, or files of archives.

use tokio::task::spawn_blocking;

use crate::feeds::{ArchivedFile, NavigationArchives, WebError};
use crate::formats::rinex::{read_navigation, write_navigation};
use crate::gnss::constants::SECONDS_PER_HOUR;
use crate::gnss::{CivilTime, Ephemeris, GpsTime, LeapSeconds, Navigation, TimeScale};
use crate::jobs::Failure;
use crate::recording::InForce;
use crate::refusal::Code;

use super::addresses::Addresses;
use super::background::in_background;

/// Name of the input with the service's ephemerides.
const OWN_NAVIGATION: &str = "the service's own ephemerides";
/// What helps a job whose files state no date and hold no ephemerides.
const DATE_REMEDY: &str =
    "give the part navigation, or near, a time within half a day of the first message";
/// Files are needed from this long before a recording, for ephemerides at its beginning (s).
const BEFORE_S: f64 = 2.0 * SECONDS_PER_HOUR;

/// A file of ephemerides: its name, its bytes and its content.
pub(super) type Ephemerides = (String, Vec<u8>, Navigation);

/// The files of ephemerides to add for a span of time, each with its name: those that the service
/// has (`now`), or those of the archives. Failures name the archives as `addresses` states.
///
/// # Errors
/// There are no ephemerides of that time, or they cannot be written.
pub(super) async fn chosen(
    now: &Navigation,
    archives: Option<&NavigationArchives>,
    span: Option<(GpsTime, GpsTime)>,
    addresses: Addresses,
) -> Result<Vec<Ephemerides>, Failure> {
    let mut own = now.clone();
    own.retain(Ephemeris::is_legacy);
    let in_force = span.map_or(InForce::Always, |span| InForce::of(&own, span));
    let mut problem = None;
    if in_force != InForce::Always
        && let (Some(span), Some(archives)) = (span, archives)
    {
        match archived(archives, span, addresses).await {
            Ok(files) if files.is_empty() => {}
            Ok(files) => return Ok(files),
            Err(why) => problem = Some(why),
        }
    }
    if own.is_empty() || in_force == InForce::Never {
        let failure = |message| Failure::new(Code::NavigationRequired, message, Some("navigation"));
        let Some((from, _)) = span else {
            let message = "the rover's messages do not state their date, and there are no \
                           ephemerides, neither in the files, nor here";
            return Err(failure(message.to_owned()).with_remedy(DATE_REMEDY));
        };
        let mut message =
            format!("there are no ephemerides of {from}: neither in the files, nor here");
        if let Some(problem) = problem {
            message = format!("{message} ({problem})");
        }
        return Err(failure(message));
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

/// The files of archives with ephemerides for a span of time.
///
/// # Errors
/// No archive could be asked, or none of the files can be read.
async fn archived(
    archives: &NavigationArchives,
    (from, until): (GpsTime, GpsTime),
    addresses: Addresses,
) -> Result<Vec<Ephemerides>, String> {
    let files = archives.files((from - BEFORE_S, until)).await;
    let unavailable = |error: WebError| addresses.failure("an archive of the service", &error);
    let (mut all, mut problem) = (Vec::new(), None);
    for file in files.map_err(unavailable)? {
        match spawn_blocking(move || read(file, addresses)).await {
            Ok(Ok(read)) => all.push(read),
            Ok(Err(why)) => problem = Some(why),
            Err(panic) => problem = Some(panic.to_string()),
        }
    }
    problem.filter(|_| all.is_empty()).map_or(Ok(all), Err)
}

fn read(file: ArchivedFile, addresses: Addresses) -> Result<Ephemerides, String> {
    let name = named(file.from);
    let shown = || addresses.file(&file.url, &name);
    let read = read_navigation(file.unpacked()).map_err(|error| format!("{}: {error}", shown()));
    let navigation = read?.0;
    match navigation.is_empty() {
        true => Err(format!("{}: the file has no ephemerides", shown())),
        false => Ok((name, file.content, navigation)),
    }
}

/// The name of the input with a file of an archive. Every user of the job sees it.
fn named(from: GpsTime) -> String {
    let CivilTime { year, month, day, hour, minute, .. } =
        from.to_civil(TimeScale::Gps, &LeapSeconds::table());
    format!(
        "an archive's ephemerides of {year:04}-{month:02}-{day:02} {hour:02}:{minute:02} GPS time"
    )
}
