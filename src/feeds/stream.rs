//! One stream: asked for, decoded, handed on, and asked for again.

use std::collections::VecDeque;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::Duration;

use tokio::sync::watch;
use tokio::time::{Instant, interval, sleep, timeout_at};

use crate::aiding::AidingDesk;
use crate::aiding::bases::BaseId;
use crate::clock::{gps_time, unix_ms};
use crate::formats::receiver::{Decoder, Event, Station, TimeReference};
use crate::gnss::{BaseSite, Ecef, Epoch, GpsTime, Navigation, PositionSource};

use super::health::{FeedHealth, FeedProblem, FeedState};
use super::ntrip::{self, NtripError, NtripStream, StreamRequest, position_sentence};
use super::stop::stopped;
use super::{Backoff, Connector, FeedOptions};

/// Epochs kept until the stream tells where its station stands, which most do twice a minute.
const EARLY_EPOCHS: usize = 300;

/// What the desk and the task of a stream share.
pub(super) struct Shared {
    health: Mutex<FeedHealth>,
    bases: Mutex<Vec<BaseId>>,
}

impl Shared {
    pub(super) fn new(base: Option<BaseId>) -> Self {
        let bases = Mutex::new(base.into_iter().collect());
        Self { health: Mutex::new(FeedHealth::new(unix_ms())), bases }
    }

    pub(super) fn add(&self, base: BaseId) {
        let mut bases = self.bases();
        if !bases.contains(&base) {
            bases.push(base);
        }
    }

    /// Takes a base out; whether another remains.
    pub(super) fn remove(&self, base: &BaseId) -> bool {
        let mut bases = self.bases();
        bases.retain(|other| other != base);
        !bases.is_empty()
    }

    pub(super) fn fills(&self, base: &BaseId) -> bool {
        self.bases().contains(base)
    }

    pub(super) fn health(&self) -> FeedHealth {
        self.note().clone()
    }

    fn note(&self) -> MutexGuard<'_, FeedHealth> {
        self.health.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn bases(&self) -> MutexGuard<'_, Vec<BaseId>> {
        self.bases.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

/// What a stream is dated near and its caster told, where it needs that.
#[derive(Default)]
pub(super) struct Told {
    pub(super) near: Option<GpsTime>,
    /// The rovers' place until one of them is known.
    pub(super) position: Option<Ecef>,
    /// The base whose rovers' place it is.
    pub(super) follows: Option<BaseId>,
}

/// Epochs that a station observed at one place.
#[derive(Default)]
struct Run {
    /// What the stream told of the station just before them.
    station: Option<Station>,
    epochs: Vec<Epoch>,
}

/// What a stream's task works with.
pub(super) struct Stream {
    request: StreamRequest,
    told: Told,
    /// Where the station stands, once the stream has told.
    site: Option<BaseSite>,
    /// Epochs that came before that, which a base takes only then.
    early: VecDeque<Epoch>,
    shared: Arc<Shared>,
    connector: Connector,
    aiding: AidingDesk,
    options: FeedOptions,
    stopped: watch::Receiver<bool>,
}

impl Stream {
    /// A stream that is not asked for yet.
    pub(super) const fn new(
        request: StreamRequest,
        told: Told,
        shared: Arc<Shared>,
        connector: Connector,
        aiding: AidingDesk,
        options: FeedOptions,
        stopped: watch::Receiver<bool>,
    ) -> Self {
        Self {
            request,
            told,
            site: None,
            early: VecDeque::new(),
            shared,
            connector,
            aiding,
            options,
            stopped,
        }
    }

    /// Runs until it is stopped. It stops between pieces: what came is stored.
    pub(super) async fn run(mut self) {
        let FeedOptions { delay, delay_ceiling, lasting_delay, lasting_ceiling, .. } = self.options;
        let mut passing = Backoff::new(delay, delay_ceiling);
        let mut lasting = Backoff::new(lasting_delay, lasting_ceiling);
        loop {
            let start = Instant::now();
            let Some(error) = self.connect_and_listen().await else { return };
            let is_streaming = self.shared.note().state == FeedState::Streaming;
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

    /// Why the stream was refused or ended; `None` once it is stopped.
    async fn connect_and_listen(&mut self) -> Option<NtripError> {
        self.shared.note().enter(FeedState::Connecting, unix_ms());
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
                tracing::info!(%caster, %mountpoint, "a caster's stream comes");
                self.shared.note().enter(FeedState::Streaming, unix_ms());
                self.listen(stream).await
            }
        }
    }

    async fn listen(&mut self, mut stream: NtripStream) -> Option<NtripError> {
        let FeedOptions { silence, no_epochs, position_interval, .. } = self.options;
        let mut decoder = Decoder::new(Some(TimeReference::Day(self.reference())));
        if self.told.follows.is_some() {
            // A virtual base may have another place now.
            (self.site, self.early) = (None, VecDeque::new());
        }
        let tells = self.told.position.is_some() || self.told.follows.is_some();
        let mut sending = interval(position_interval);
        sending.tick().await; // The first is sent with the request.
        let (mut heard, mut useful) = (Instant::now(), Instant::now());
        let (mut content, mut events) = (Vec::new(), Vec::new());
        loop {
            content.clear();
            let read = tokio::select! {
                () = stopped(&mut self.stopped) => return None,
                read = timeout_at(heard + silence, stream.read(&mut content)) => read,
                _ = sending.tick(), if tells => {
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
                Ok(Ok(())) => heard = Instant::now(),
            }
            decoder.learn_channels(&self.aiding.navigation.current().navigation);
            decoder.push(&content, &mut events);
            let epochs = self.take(&decoder, content.len(), std::mem::take(&mut events)).await;
            if 0 < epochs {
                useful = Instant::now();
            } else if no_epochs < useful.elapsed() {
                return Some(NtripError::NoEpochs { seconds: no_epochs.as_secs() });
            }
        }
    }

    /// Hands on what came; returns how many epochs it is.
    async fn take(&mut self, decoder: &Decoder, bytes: usize, events: Vec<Event>) -> usize {
        let mut navigation = Navigation::default();
        let mut runs = vec![Run::default()];
        for event in events {
            match event {
                Event::Epoch(epoch) => {
                    runs.last_mut().expect("it begins with one").epochs.push(epoch);
                }
                Event::Station(station) => {
                    runs.push(Run { station: Some(station), epochs: Vec::new() });
                }
                event => {
                    event.apply_to(&mut navigation);
                }
            }
        }
        let count = runs.iter().map(|run| run.epochs.len()).sum();
        let last = runs.iter().flat_map(|run| &run.epochs).last().map(|epoch| epoch.time);
        {
            let mut health = self.shared.note();
            health.bytes += bytes as u64;
            health.heard_unix_ms = Some(unix_ms());
            health.epochs += count as u64;
            health.ephemerides += navigation.len() as u64;
            health.last_epoch = last.or(health.last_epoch);
            health.statistics = decoder.statistics().clone();
        }
        if navigation != Navigation::default() {
            let StreamRequest { caster, mountpoint, .. } = &self.request;
            let source = format!("{caster}/{mountpoint}");
            if let Err(error) = self.aiding.navigation.push(navigation, &source).await {
                self.shared.note().refusal = Some(FeedProblem::from(&error));
            }
        }
        if self.told.near.is_some() {
            self.told.near = last.or(self.told.near); // A stream that is played goes on from here.
        }
        for run in runs {
            self.hand_on(run).await;
        }
        count
    }

    /// Hands epochs on to the bases. Those before a message of the station are of the place that
    /// it had until then: a virtual base moves. Those of one wait until its place is told.
    async fn hand_on(&mut self, Run { station, mut epochs }: Run) {
        let is_told = station.is_some();
        self.site = station.and_then(|station| station.site()).or(self.site.take());
        if self.site.is_none() {
            self.early.extend(epochs.iter().cloned());
            let surplus = self.early.len().saturating_sub(EARLY_EPOCHS);
            self.early.drain(..surplus);
            if self.told.follows.is_some() {
                return;
            }
        } else if !self.early.is_empty() {
            epochs.splice(..0, self.early.drain(..));
        }
        if !is_told && epochs.is_empty() {
            return;
        }
        let bases = self.shared.bases().clone();
        for base in &bases {
            self.fill(base, is_told, &epochs).await;
        }
    }

    /// Hands a base what came of it. Where its owner has said where it stands, that holds.
    async fn fill(&self, base: &BaseId, is_told: bool, epochs: &[Epoch]) {
        let held = self.aiding.bases.site(base).ok().flatten();
        // A base that came to the stream later has not heard what was told before.
        if let Some(site) = self.site.as_ref().filter(|_| is_told || held.is_none()) {
            let stated = held.filter(|site| site.source == PositionSource::Given);
            let point = site.antenna_reference_point();
            let off_m = stated.map(|site| site.antenna_reference_point().distance_m(point));
            self.shared.note().station_off_m = off_m;
            if off_m.is_none() && self.refuses(self.aiding.bases.place(base, site).await) {
                return;
            }
        }
        if !epochs.is_empty() {
            self.refuses(self.aiding.bases.push(base, epochs.to_vec()).await);
        }
    }

    /// Notes why a base does not take what came, or that it does.
    fn refuses<T>(&self, outcome: Result<T, crate::aiding::AidingError>) -> bool {
        let refusal = outcome.as_ref().err().map(FeedProblem::from);
        let is_refused = refusal.is_some();
        self.shared.note().refusal = refusal;
        is_refused
    }

    /// Where the rovers are: where one of them was last, else as stated.
    fn rovers(&self) -> Option<Ecef> {
        let Told { position, follows, .. } = &self.told;
        follows.as_ref().and_then(|base| self.aiding.bases.rover(base)).or(*position)
    }

    /// Within half a day of what comes.
    fn reference(&self) -> GpsTime {
        let now = || gps_time(unix_ms());
        self.told.near.unwrap_or_else(now)
    }

    fn log(&self, error: &NtripError, delay: Duration) {
        let now = unix_ms();
        let mut health = self.shared.note();
        health.enter(FeedState::Waiting, now);
        health.retry_unix_ms = Some(now + delay.as_millis() as i64);
        let StreamRequest { caster, mountpoint, .. } = &self.request;
        let code = error.code();
        // Once for each cause, not for each attempt.
        if health.problem.as_ref().is_none_or(|problem| problem.code != code) {
            tracing::warn!(code, %caster, %mountpoint, %error, "a caster's stream is lost");
        }
        health.problem = Some(FeedProblem::from(error));
    }
}

/// The sentence that tells a caster a place.
fn sentence(position: Ecef) -> String {
    let place = position.to_geodetic();
    let second_of_day = (unix_ms() / 1000).rem_euclid(86_400) as u32;
    let (latitude_deg, longitude_deg) =
        (place.latitude_rad.to_degrees(), place.longitude_rad.to_degrees());
    position_sentence(latitude_deg, longitude_deg, place.height_m, second_of_day)
}
