//! The task of one stream: requests it, decodes it, pushes its data, and requests it again.

use std::collections::VecDeque;
use std::panic::AssertUnwindSafe;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::Duration;

use futures::FutureExt;
use tokio::sync::watch;
use tokio::time::{Instant, interval, sleep, timeout_at};

use crate::aiding::bases::BaseId;
use crate::aiding::{AidingDesk, AidingError, OF_BASE};
use crate::clock::{gps_time, unix_ms};
use crate::formats::receiver::{Decoder, Event, Station, TimeReference};
use crate::gnss::constants::SECONDS_PER_DAY;
use crate::gnss::{BaseSite, Ecef, Epoch, GpsTime, Navigation, PositionSource};
use crate::panics::words;

use super::health::{FeedHealth, FeedProblem, FeedState};
use super::ntrip::{self, NtripError, NtripStream, StreamRequest, position_sentence};
use super::stop::stopped;
use super::{Backoff, Connector, FeedOptions};

/// Most epochs that wait until the stream reports its station's position. Most streams report it
/// twice a minute.
const EARLY_EPOCHS: usize = 300;

/// The health and bases of a stream, shared between its task and the desk.
pub(super) struct StreamStatus {
    health: Mutex<FeedHealth>,
    bases: Mutex<Vec<FilledBase>>,
}

/// A base that a stream fills.
struct FilledBase {
    id: BaseId,
    /// Distance of the stream's station from the base's stated position (m).
    station_off_m: Option<f64>,
    /// Why the base refused the last data.
    refusal: Option<FeedProblem>,
}

impl FilledBase {
    const fn new(id: BaseId) -> Self {
        Self { id, station_off_m: None, refusal: None }
    }
}

impl StreamStatus {
    pub(super) fn new(base: Option<BaseId>) -> Self {
        let bases = Mutex::new(base.into_iter().map(FilledBase::new).collect());
        Self { health: Mutex::new(FeedHealth::new(unix_ms())), bases }
    }

    pub(super) fn add(&self, base: BaseId) {
        let mut bases = self.bases();
        if !bases.iter().any(|filled| filled.id == base) {
            bases.push(FilledBase::new(base));
        }
    }

    /// Removes a base; returns whether others remain.
    pub(super) fn remove(&self, base: &BaseId) -> bool {
        let mut bases = self.bases();
        bases.retain(|other| other.id != *base);
        !bases.is_empty()
    }

    pub(super) fn fills(&self, base: &BaseId) -> bool {
        self.bases().iter().any(|filled| filled.id == *base)
    }

    pub(super) fn health(&self) -> FeedHealth {
        self.lock().clone()
    }

    /// The health of the stream, with the refusals of `base`.
    pub(super) fn health_of(&self, base: &BaseId) -> FeedHealth {
        let mut health = self.health();
        if let Some(filled) = self.bases().iter().find(|filled| filled.id == *base) {
            health.station_off_m = filled.station_off_m;
            health.refusal = filled.refusal.clone().or(health.refusal);
        }
        health
    }

    /// Changes the status of a base, if the stream still fills it.
    fn update(&self, base: &BaseId, change: impl FnOnce(&mut FilledBase)) {
        if let Some(filled) = self.bases().iter_mut().find(|filled| filled.id == *base) {
            change(filled);
        }
    }

    fn lock(&self) -> MutexGuard<'_, FeedHealth> {
        self.health.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn bases(&self) -> MutexGuard<'_, Vec<FilledBase>> {
        self.bases.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

/// Data that the stream does not contain: its approximate time, and the rovers' position.
#[derive(Default)]
pub(super) struct StreamHints {
    pub(super) near: Option<GpsTime>,
    /// Position reported to the caster until the first rover is positioned.
    pub(super) position: Option<Ecef>,
    /// The base whose rovers' position is reported to the caster.
    pub(super) follows: Option<BaseId>,
    /// The source of its ephemerides, if the bases belong to a tenant other than the operator.
    pub(super) source: Option<Arc<str>>,
}

/// Epochs of a station at one position.
#[derive(Default)]
struct StationEpochs {
    /// The station message that preceded the epochs.
    station: Option<Station>,
    epochs: Vec<Epoch>,
}

/// The connector of a stream, the desk that it fills, and its timing.
pub(super) struct StreamMeans {
    pub(super) connector: Connector,
    pub(super) aiding: AidingDesk,
    pub(super) options: FeedOptions,
}

/// The state of a stream's task.
pub(super) struct Stream {
    request: StreamRequest,
    hints: StreamHints,
    /// Position and antenna of the station, once the stream has reported them.
    site: Option<BaseSite>,
    /// Epochs received before `site`. They wait, because bases without a position refuse them.
    early: VecDeque<Epoch>,
    status: Arc<StreamStatus>,
    connector: Connector,
    aiding: AidingDesk,
    options: FeedOptions,
    stopped: watch::Receiver<bool>,
}

impl Stream {
    /// A stream that is not requested yet.
    pub(super) fn new(
        request: StreamRequest,
        hints: StreamHints,
        status: Arc<StreamStatus>,
        means: StreamMeans,
        stopped: watch::Receiver<bool>,
    ) -> Self {
        let StreamMeans { connector, aiding, options } = means;
        Self {
            request,
            hints,
            site: None,
            early: VecDeque::new(),
            status,
            connector,
            aiding,
            options,
            stopped,
        }
    }

    /// Runs until stopped. Bytes already read are decoded and stored first.
    pub(super) async fn run(mut self) {
        let FeedOptions { delay, delay_ceiling, lasting_delay, lasting_ceiling, .. } = self.options;
        let mut passing = Backoff::new(delay, delay_ceiling);
        let mut lasting = Backoff::new(lasting_delay, lasting_ceiling);
        loop {
            let start = Instant::now();
            let Some(error) = self.until_it_ends().await else { return };
            let is_streaming = self.status.lock().state == FeedState::Streaming;
            if is_streaming && self.options.steady <= start.elapsed() {
                passing.reset();
                lasting.reset();
            }
            let delay = if error.is_lasting() {
                lasting.next(error.retry_after())
            } else {
                passing.next(error.retry_after())
            };
            self.log(&error, delay);
            tokio::select! {
                () = stopped(&mut self.stopped) => return,
                () = sleep(delay) => {}
            }
        }
    }

    /// Runs one connection, like [`Self::connect_and_listen`]. A panic ends only this connection.
    async fn until_it_ends(&mut self) -> Option<NtripError> {
        match AssertUnwindSafe(self.connect_and_listen()).catch_unwind().await {
            Ok(ended) => ended,
            Err(panic) => {
                let StreamRequest { caster, mountpoint, .. } = &self.request;
                let panic = words(&*panic);
                tracing::error!(%caster, %mountpoint, panic, "the reader of a stream panicked");
                Some(NtripError::Protocol { why: format!("its reader panicked: {panic}") })
            }
        }
    }

    /// Runs one connection; returns why it failed or ended, or `None` once stopped.
    async fn connect_and_listen(&mut self) -> Option<NtripError> {
        self.status.lock().enter(FeedState::Connecting, unix_ms());
        let sentence = self.rovers().map(sentence);
        let connecting = ntrip::connect(&self.connector, &self.request, sentence.as_deref());
        let connected = tokio::select! {
            () = stopped(&mut self.stopped) => return None,
            connected = connecting => connected,
        };
        match connected {
            Err(error) => Some(error),
            Ok(stream) => {
                let Self { request, .. } = &*self;
                let (caster, mountpoint) = (&request.caster, &request.mountpoint);
                tracing::info!(%caster, %mountpoint, "a caster's stream has started");
                self.status.lock().enter(FeedState::Streaming, unix_ms());
                self.listen(stream).await
            }
        }
    }

    async fn listen(&mut self, mut stream: NtripStream) -> Option<NtripError> {
        let FeedOptions { silence, no_epochs, position_interval, .. } = self.options;
        let mut decoder = Decoder::new(Some(TimeReference::Day(self.reference())));
        if self.hints.follows.is_some() {
            // A virtual base may have moved meanwhile.
            (self.site, self.early) = (None, VecDeque::new());
        }
        let reports_position = self.hints.position.is_some() || self.hints.follows.is_some();
        let mut sending = interval(position_interval);
        sending.tick().await; // The first report is part of the request.
        let (mut last_byte_at, mut last_epoch_at) = (Instant::now(), Instant::now());
        let (mut content, mut events) = (Vec::new(), Vec::new());
        loop {
            content.clear();
            let read = tokio::select! {
                () = stopped(&mut self.stopped) => return None,
                read = timeout_at(last_byte_at + silence, stream.read(&mut content)) => read,
                _ = sending.tick(), if reports_position => {
                    let Some(sentence) = self.rovers().map(sentence) else { continue };
                    match stream.send(&sentence).await {
                        Ok(()) => continue,
                        Err(error) => return Some(error),
                    }
                }
            };
            match read {
                Err(_) => return Some(NtripError::Silent { seconds: silence.as_secs() }),
                Ok(Err(error)) => return Some(error),
                Ok(Ok(())) => last_byte_at = Instant::now(),
            }
            decoder.learn_channels(&self.aiding.navigation.current().navigation);
            decoder.push(&content, &mut events);
            let epochs = self.take(&decoder, content.len(), std::mem::take(&mut events)).await;
            if 0 < epochs {
                last_epoch_at = Instant::now();
            } else if no_epochs < last_epoch_at.elapsed() {
                return Some(NtripError::NoEpochs { seconds: no_epochs.as_secs() });
            }
        }
    }

    /// Pushes decoded data; returns the number of epochs.
    async fn take(&mut self, decoder: &Decoder, bytes: usize, events: Vec<Event>) -> usize {
        let mut navigation = Navigation::default();
        let mut groups = vec![StationEpochs::default()];
        for event in events {
            match event {
                Event::Epoch(epoch) => {
                    groups.last_mut().expect("the list begins with one").epochs.push(epoch);
                }
                Event::Station(station) => {
                    groups.push(StationEpochs { station: Some(station), epochs: Vec::new() });
                }
                event => {
                    event.apply_to(&mut navigation);
                }
            }
        }
        let count = groups.iter().map(|group| group.epochs.len()).sum();
        let last = groups.iter().flat_map(|group| &group.epochs).last().map(|epoch| epoch.time);
        {
            let mut health = self.status.lock();
            health.bytes += bytes as u64;
            health.received_unix_ms = Some(unix_ms());
            health.epochs += count as u64;
            health.ephemerides += navigation.len() as u64;
            health.last_epoch = last.or(health.last_epoch);
            health.statistics = decoder.statistics().clone();
        }
        if navigation != Navigation::default() {
            let StreamRequest { caster, mountpoint, .. } = &self.request;
            let of_base = if self.status.bases().is_empty() { "" } else { OF_BASE };
            let named = || format!("{of_base}{caster}/{mountpoint}").into();
            let source: Arc<str> = self.hints.source.clone().unwrap_or_else(named);
            let pushed = self.aiding.navigation.push(navigation, &source).await;
            self.status.lock().refusal = pushed.as_ref().err().map(FeedProblem::from);
        }
        if self.hints.near.is_some() {
            // A recorded stream continues at this time after a reconnection.
            self.hints.near = last.or(self.hints.near);
        }
        for group in groups {
            self.push(group).await;
        }
        count
    }

    /// Pushes epochs to the bases. A station message applies to the epochs after it, because a
    /// virtual base moves. Until its first station message, a virtual base's epochs wait.
    async fn push(&mut self, StationEpochs { station, mut epochs }: StationEpochs) {
        let has_station = station.is_some();
        self.site = station.and_then(|station| station.site()).or(self.site.take());
        if self.site.is_none() {
            self.early.extend(epochs.iter().cloned());
            let surplus = self.early.len().saturating_sub(EARLY_EPOCHS);
            self.early.drain(..surplus);
            if self.hints.follows.is_some() {
                return;
            }
        } else if !self.early.is_empty() {
            epochs.splice(..0, self.early.drain(..));
        }
        if !has_station && epochs.is_empty() {
            return;
        }
        let bases: Vec<BaseId> =
            self.status.bases().iter().map(|filled| filled.id.clone()).collect();
        for base in &bases {
            self.fill(base, has_station, &epochs).await;
        }
    }

    /// Pushes epochs and position to one base. A position that the base's creator gave has
    /// priority.
    async fn fill(&self, base: &BaseId, has_station: bool, epochs: &[Epoch]) {
        let present = self.aiding.bases.site(base).ok().flatten();
        // A base that joined the stream later has missed earlier station messages.
        if let Some(site) = self.site.as_ref().filter(|_| has_station || present.is_none()) {
            let stated = present.filter(|site| site.source == PositionSource::Given);
            let point = site.antenna_reference_point();
            let off_m = stated.map(|site| site.antenna_reference_point().distance_m(point));
            self.status.update(base, |filled| filled.station_off_m = off_m);
            if off_m.is_none() && self.refuses(base, self.aiding.bases.set_site(base, site).await) {
                return;
            }
        }
        if !epochs.is_empty() {
            self.refuses(base, self.aiding.bases.push(base, epochs.to_vec()).await);
        }
    }

    /// Records whether a base refuses data, and why.
    fn refuses<T>(&self, base: &BaseId, outcome: Result<T, AidingError>) -> bool {
        let refusal = outcome.as_ref().err().map(FeedProblem::from);
        let is_refused = refusal.is_some();
        self.status.update(base, |filled| filled.refusal = refusal);
        is_refused
    }

    /// The rovers' position: the last one computed against the base, otherwise the stated one.
    fn rovers(&self) -> Option<Ecef> {
        let StreamHints { position, follows, .. } = &self.hints;
        follows.as_ref().and_then(|base| self.aiding.bases.rover(base)).or(*position)
    }

    /// A time within half a day of the stream's messages.
    fn reference(&self) -> GpsTime {
        let now = || gps_time(unix_ms());
        self.hints.near.unwrap_or_else(now)
    }

    fn log(&self, error: &NtripError, delay: Duration) {
        let now = unix_ms();
        let mut health = self.status.lock();
        health.enter(FeedState::Waiting, now);
        health.retry_unix_ms = Some(now + delay.as_millis() as i64);
        let StreamRequest { caster, mountpoint, .. } = &self.request;
        let code = error.code();
        // Logged once for each cause, not for each attempt.
        if health.problem.as_ref().is_none_or(|problem| problem.code != code) {
            tracing::warn!(%code, %caster, %mountpoint, %error, "a caster's stream is lost");
        }
        health.problem = Some(FeedProblem::from(error));
    }
}

/// The NMEA GGA sentence that reports a position to a caster.
fn sentence(position: Ecef) -> String {
    let geodetic = position.to_geodetic();
    let second_of_day = (unix_ms() / 1000).rem_euclid(SECONDS_PER_DAY as i64) as u32;
    let (latitude_deg, longitude_deg) =
        (geodetic.latitude_rad.to_degrees(), geodetic.longitude_rad.to_degrees());
    position_sentence(latitude_deg, longitude_deg, geodetic.height_m, second_of_day)
}
