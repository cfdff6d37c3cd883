//! Archives of ephemerides: one file per day, fetched again while it grows. Also the file addresses
//! of all archives.

use std::collections::BTreeMap;
use std::fmt;
use std::sync::Arc;
use std::time::Duration;

use tokio::sync::watch;
use tokio::time::sleep;

use crate::aiding::NavigationBroker;
use crate::clock::{gps_time, unix_ms};
use crate::formats::rinex::read_navigation;
use crate::formats::unpack_within;
use crate::gnss::constants::{NS_PER_SECOND, SECONDS_PER_DAY, SECONDS_PER_HOUR};
use crate::gnss::{CivilTime, GpsTime, LeapSeconds, Navigation, TimeScale};
use crate::refusal::Code;

use super::health::{FeedProblem, SourceHealth, SourceState};
use super::stop::stopped;
use super::web::{self, Fetched, Url, Validators, WebError};
use super::{Backoff, Connector, FetchError};

/// Largest file, packed and unpacked. Files of one day with all systems have 3 MB and 12 MB.
pub(super) const PACKED_LIMIT: usize = 32 << 20;
pub(super) const UNPACKED_LIMIT: u64 = 128 << 20;
/// Days whose files are fetched: today's file still grows, yesterday's may have been completed.
const DAYS: i64 = 2;
/// First and longest delay after a failure.
const DELAY: Duration = Duration::from_secs(30);
const DELAY_CEILING: Duration = Duration::from_secs(3600);

/// The address of an archive's files with placeholders for their time, such as
/// `https://archive.example.org/{yyyy}/{ddd}/BRDC00WRD_R_{yyyy}{ddd}0000_01D_MN.rnx.gz`.
///
/// `{yyyy}`, `{yy}`, `{mm}`, `{dd}`, `{ddd}` and `{hh}` are the year, its last two digits, the
/// month, the day of the month, the day of the year and the hour, all of GPS time. `{h}` is the
/// hour as a letter `a` to `x`, as in RINEX 2 file names; `{min}` is the start of the quarter of an
/// hour, `00` to `45`.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct ArchiveTemplate(String);

impl ArchiveTemplate {
    /// Reads a template.
    ///
    /// # Errors
    /// The address without its placeholders is not a valid URL.
    pub fn new(text: &str) -> Result<Self, FetchError> {
        let template = Self(text.to_owned());
        template.at(GpsTime::EPOCH).map(|_| template)
    }

    /// The URL of the file that contains `time`.
    ///
    /// # Errors
    /// It is not a valid URL; [`Self::new`] has excluded this.
    pub(crate) fn at(&self, time: GpsTime) -> Result<Url, FetchError> {
        let civil = time.to_civil(TimeScale::Gps, &LeapSeconds::table());
        let CivilTime { year, month, day, hour, minute, .. } = civil;
        let text = self.0.replace("{yyyy}", &format!("{year:04}"));
        let text = text.replace("{yy}", &format!("{:02}", year.rem_euclid(100)));
        let text = text.replace("{mm}", &format!("{month:02}"));
        let text = text.replace("{dd}", &format!("{day:02}"));
        let text = text.replace("{ddd}", &format!("{:03}", day_of_year(&civil)));
        let text = text.replace("{hh}", &format!("{hour:02}"));
        let text = text.replace("{h}", &char::from(b'a' + hour).to_string());
        let text = text.replace("{min}", &format!("{:02}", minute / 15 * 15));
        if text.contains(['{', '}']) {
            return Err(FetchError::UrlInvalid { text: self.0.clone() });
        }
        text.parse()
    }

    /// The time that one file covers (s), from the finest placeholder. `None` if the address does
    /// not identify a day of a year.
    pub(crate) fn period_s(&self) -> Option<i64> {
        let has = |placeholder| self.0.contains(placeholder);
        let has_day =
            (has("{yyyy}") || has("{yy}")) && (has("{ddd}") || has("{mm}") && has("{dd}"));
        match (has_day, has("{hh}") || has("{h}"), has("{min}")) {
            (true, true, true) => Some(900),
            (true, true, false) => Some(SECONDS_PER_HOUR as i64),
            (true, false, false) => Some(SECONDS_PER_DAY as i64),
            _ => None,
        }
    }

    /// The start of the time that the file with `time` covers, and its end, which is not included.
    pub(crate) fn span(&self, time: GpsTime) -> Option<(GpsTime, GpsTime)> {
        let period_ns = self.period_s()? * NS_PER_SECOND;
        let start_ns = time.as_ns().div_euclid(period_ns) * period_ns;
        Some((GpsTime::from_ns(start_ns), GpsTime::from_ns(start_ns + period_ns)))
    }
}

impl fmt::Display for ArchiveTemplate {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.0)
    }
}

fn day_of_year(civil: &CivilTime) -> i64 {
    let start =
        CivilTime { month: 1, day: 1, hour: 0, minute: 0, second: 0, nanosecond: 0, ..*civil };
    let leap = LeapSeconds::table();
    let ns = |civil: &CivilTime| GpsTime::from_civil(civil, TimeScale::Gps, &leap);
    let since = ns(civil).zip(ns(&start)).map(|(now, start)| now.as_ns() - start.as_ns());
    since.unwrap_or_default() / (SECONDS_PER_DAY as i64 * NS_PER_SECOND) + 1
}

/// The delays between the fetches of an archive.
struct Delays {
    waiting: Backoff,
    failing: Backoff,
}

impl Delays {
    fn new(interval: Duration) -> Self {
        let (waiting, failing) =
            (Backoff::new(interval, interval), Backoff::new(DELAY, DELAY_CEILING));
        Self { waiting, failing }
    }

    /// The delay after a success.
    fn succeeded(&mut self) -> Duration {
        self.failing.reset();
        self.waiting.next(None)
    }

    /// The delay after a failure, which grows with each failure in a row. The host may ask for a
    /// longer one.
    fn failed(&mut self, retry_after: Option<Duration>) -> Duration {
        self.failing.next(retry_after)
    }
}

/// The task that fetches an archive of ephemerides.
pub(super) struct Archive {
    pub(super) template: ArchiveTemplate,
    pub(super) interval: Duration,
    pub(super) connector: Connector,
    pub(super) navigation: NavigationBroker,
    pub(super) health: Arc<SourceHealth>,
    pub(super) stopped: watch::Receiver<bool>,
}

impl Archive {
    /// Runs until stopped. A file being read is finished first.
    pub(super) async fn run(mut self) {
        let mut known: BTreeMap<Url, Validators> = BTreeMap::new();
        let mut delays = Delays::new(self.interval);
        loop {
            self.health.enter(SourceState::Fetching, unix_ms());
            let mut stopping = self.stopped.clone();
            let fetched = tokio::select! {
                () = stopped(&mut stopping) => return,
                fetched = self.fetch(&mut known) => fetched,
            };
            let delay = match fetched {
                Ok(()) => {
                    self.health.succeeded(unix_ms());
                    delays.succeeded()
                }
                Err((problem, retry_after)) => {
                    self.health.failed(problem, unix_ms());
                    delays.failed(retry_after)
                }
            };
            self.health.wait(delay, unix_ms());
            tokio::select! {
                () = stopped(&mut self.stopped) => return,
                () = sleep(delay) => {}
            }
        }
    }

    /// Fetches the files of the last days. One of them is enough: today's file may not exist yet.
    async fn fetch(
        &self,
        known: &mut BTreeMap<Url, Validators>,
    ) -> Result<(), (FeedProblem, Option<Duration>)> {
        let now = gps_time(unix_ms());
        let mut urls = Vec::new();
        for days in 0..DAYS {
            let url = self.template.at(now - SECONDS_PER_DAY * days as f64);
            let url = url.map_err(|error| (FeedProblem::from(&WebError::from(error)), None))?;
            if !urls.contains(&url) {
                urls.push(url);
            }
        }
        known.retain(|url, _| urls.contains(url));
        let mut missing = None;
        let mut found = false;
        for url in urls {
            let before = known.get(&url).cloned().unwrap_or_default();
            match web::fetch(&self.connector, &url, &before, PACKED_LIMIT).await {
                Ok(Fetched::Unchanged { .. }) => found = true,
                Ok(Fetched::New { content, validators, .. }) => {
                    self.take(&url, content).await.map_err(|problem| (problem, None))?;
                    known.insert(url, validators);
                    found = true;
                }
                Err(error @ WebError::NotFound { .. }) => {
                    missing.get_or_insert((FeedProblem::from(&error), None));
                }
                Err(error) => return Err((FeedProblem::from(&error), error.retry_after())),
            }
        }
        missing.filter(|_| !found).map_or(Ok(()), Err)
    }

    async fn take(&self, url: &Url, content: Vec<u8>) -> Result<(), FeedProblem> {
        let reading = tokio::task::spawn_blocking(move || read(&content));
        let read = reading.await.unwrap_or_else(|panic| Err(panic.to_string()));
        let navigation = read.map_err(|message| FeedProblem {
            code: Code::FileUnreadable,
            message: format!("{url}: {message}"),
        })?;
        // Everybody who uses the ephemerides sees their source.
        let source = url.without_query();
        let pushed = self.navigation.push(navigation, &source).await;
        let pushed = pushed.map_err(|error| FeedProblem::from(&error))?;
        self.health.add(pushed.new as u64);
        let (received, new) = (pushed.received, pushed.new);
        tracing::info!(url = source, received, new, "ephemerides fetched");
        Ok(())
    }
}

fn read(content: &[u8]) -> Result<Navigation, String> {
    let text = unpack_within(content, UNPACKED_LIMIT);
    read_navigation(text).map(|(navigation, _)| navigation).map_err(|e| e.to_string())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_archive_is_fetched_at_an_interval_and_after_growing_delays_while_it_fails() {
        let interval = Duration::from_secs(7200);
        let (mut delays, mut longest) = (Delays::new(interval), DELAY);
        for _ in 0..10 {
            let delay = delays.failed(None);
            assert!(longest / 2 <= delay && delay <= longest, "{delay:?} of {longest:?}");
            longest = (2 * longest).min(DELAY_CEILING);
        }
        let asked = Duration::from_secs(9000);
        assert!(asked <= delays.failed(Some(asked)));
        for _ in 0..3 {
            let delay = delays.succeeded();
            assert!(interval / 2 <= delay && delay <= interval, "{delay:?}");
        }
        assert!(delays.failed(None) <= DELAY, "the delays begin again after a success");
    }

    #[test]
    fn templates_name_the_file_of_a_day() {
        let template =
            ArchiveTemplate::new("https://a.example/{yyyy}/{ddd}/b{ddd}{hh}.{yy}n?{mm}-{dd}");
        // 2024-12-31T23:59:42, day 366 of a leap year: week 2347, Tuesday.
        let time = GpsTime::from_week_seconds(2347, 3.0 * 86_400.0 - 18.0);
        let url = template.unwrap().at(time).unwrap();
        assert_eq!(url.to_string(), "https://a.example:443/2024/366/b36623.24n?12-31");
        for wrong in ["https://a.example/{year}", "file:///etc/passwd", "https://a.example/{yyyy"] {
            assert!(ArchiveTemplate::new(wrong).is_err(), "{wrong}");
        }
    }

    #[test]
    fn templates_know_the_time_of_one_file() {
        let template =
            |path: &str| ArchiveTemplate::new(&format!("https://a.example/{path}")).unwrap();
        // 2024-12-31T23:59:42.
        let time = GpsTime::from_week_seconds(2347, 3.0 * 86_400.0 - 18.0);
        for (path, name, period_s) in [
            ("site{ddd}0.{yy}d.Z", "/site3660.24d.Z", 86_400),
            ("{yyyy}{mm}{dd}.crx", "/20241231.crx", 86_400),
            ("site{ddd}{h}.{yy}o", "/site366x.24o", 3600),
            ("{yyyy}{ddd}{hh}00_01H", "/20243662300_01H", 3600),
            ("site{ddd}{h}{min}.{yy}o", "/site366x45.24o", 900),
        ] {
            assert_eq!(template(path).at(time).unwrap().path, name);
            let (from, until) = template(path).span(time).unwrap();
            assert_eq!(
                (template(path).period_s(), until - from),
                (Some(period_s), period_s as f64)
            );
            assert!(from <= time && time < until && template(path).span(until).unwrap().0 == until);
        }
        for path in ["latest.obs", "{hh}.obs", "{yyyy}{dd}", "{ddd}{hh}.o", "{yy}{ddd}{min}"] {
            assert_eq!(template(path).period_s(), None, "{path}");
        }
    }
}
