//! Base stations.

use std::mem;

use crate::aiding::bases::{
    BaseEpochRefusal, BaseFile, BaseId, BaseInfo, BasePositionCheck, BasePositionVerdict, BasePush,
    CommittedEpoch, NewBase,
};
use crate::clock::unix_ms;
use crate::contract::reason::reason;
use crate::contract::{Caller, Lease, Refusal, convert, finished, texts, v1};
use crate::gnss::{BaseSite, CoordinateFrame, Ecef, Epoch, GpsTime, PositionSource, Reason};
use crate::refusal::Code;

use super::feeds;
use super::paging::{PAGE_BYTES, Pages, Reading};
use super::positioning::{Numbered, epochs};
use super::upload::{read_file, read_text};
use super::{base_id, named_request, named_request_by, page_size, timestamp, utc};

/// Bases on a page if the request gives no size.
const PAGE: usize = 100;
/// Most bases on a page.
const PAGE_LIMIT: usize = 1000;
/// Memory of a base of the service while a page is chosen (bytes).
const LISTED_BYTES: usize = 1024;
/// Memory of a base on a page, its message and its JSON (bytes).
const BASE_BYTES: usize = 16 << 10;
const _: () = assert!(PAGE_BYTES / BASE_BYTES == 512, "proto/ and docs/api.md state it");
/// Possible distances of a base from the centre of the Earth (m): from the lowest ground at the
/// poles to the highest mountain.
const RADII_M: std::ops::RangeInclusive<f64> = 6.35e6..=6.39e6;
/// Longest distance between antenna and marker along each axis (m).
const DELTA_MAX_M: f64 = 1000.0;

/// Creates a base. Returns it, and whether it is new: a repetition of a named request returns the
/// base that the first one has created.
///
/// # Errors
/// The position, stream or archive is invalid, the limit of bases is reached, a request with this
/// name had other content, or the store fails.
pub async fn create(
    caller: &Caller,
    request: v1::CreateBaseRequest,
) -> Result<(v1::Base, bool), Refusal> {
    // A base that is stored must get into the memory, and its stream must begin.
    let caller = caller.clone();
    let act = async move {
        let created = created(&caller, request).await;
        caller.noted("Bases.Create", "", created).await
    };
    finished(act).await
}

async fn created(
    caller: &Caller,
    mut request: v1::CreateBaseRequest,
) -> Result<(v1::Base, bool), Refusal> {
    let name = mem::take(&mut request.request_id);
    let named = match request.ntrip.as_ref().is_some_and(|source| !source.password.is_empty()) {
        false => named_request(name, &request)?,
        true => {
            caller.check_secret("ntrip.password")?;
            named_request_by(name, &request, |content| caller.secrets().hash(content))?
        }
    };
    texts::check_label(&request.label)?;
    texts::check("antenna", &request.antenna, texts::ANTENNA_MAX)?;
    let site = site(&request)?;
    if request.ntrip.is_some() && request.archive.is_some() {
        let message = "a base is filled by a caster's stream or by an archive, not by both";
        return Err(Refusal::new(Code::InvalidField, message).at("archive"));
    }
    let feed = request.ntrip.map(|source| feeds::source(caller, source)).transpose()?;
    let archive = request.archive.map(|source| feeds::archive(caller, source)).transpose()?;
    let frame = frame(&request.frame, request.frame_epoch_year)?;
    let new = NewBase { label: request.label, site, feed, archive, frame };
    let (created, is_new) = caller.bases().create(new, named, &caller.author()).await?;
    if let Some(id) = BaseId::parse(&created.name.id) {
        // A repetition starts what the first request did not, because its commit had no answer.
        let feeds = caller.feeds();
        if let Some(feed) = created.feed.as_ref().filter(|_| feeds.health(&id).is_none()) {
            feeds.start(&id, feed)?;
        }
        let archive = created.archive.as_deref();
        if let Some(archive) = archive.filter(|_| feeds.archive_health(&id).is_none()) {
            feeds.fill(&id, archive)?;
        }
    }
    Ok((message(caller, &created), is_new))
}

/// A base with its health.
///
/// # Errors
/// The base does not exist.
pub async fn get(caller: &Caller, request: v1::GetBaseRequest) -> Result<v1::Base, Refusal> {
    let id = base_id(&request.base)?;
    Ok(message(caller, &caller.bases().get(&id).await?))
}

/// A page of bases in order of id.
///
/// # Errors
/// The page token or size is invalid.
pub async fn list(
    caller: &Caller,
    mut request: v1::ListBasesRequest,
) -> Result<v1::ListBasesResponse, Refusal> {
    let size = page_size(mem::take(&mut request.page_size), PAGE);
    let token = mem::take(&mut request.page_token);
    let pages = Pages::of("Bases/List", &request, &token)?;
    let mut reading = Reading::of(&pages, (size, PAGE_LIMIT), BASE_BYTES)?;
    let all_bytes = caller.limits().bases * LISTED_BYTES;
    Lease::current().map_or(Ok(()), |lease| lease.reserve(all_bytes))?;
    let mut bases = caller.bases().list().await;
    bases.retain(|base| pages.after().is_none_or(|after| after < &*base.name.id));
    let mut rest = &*bases;
    while let Some(count) = reading.batch()? {
        let (batch, later) = rest.split_at(count.min(rest.len()));
        let last = batch.last().filter(|_| !later.is_empty());
        let next = last.map(|base| base.name.id.to_string());
        reading.add(batch.iter().map(|base| message(caller, base)), next);
        rest = later;
    }
    let (bases, next) = reading.end();
    Ok(v1::ListBasesResponse {
        next_page_token: pages.token(next),
        bases,
        networks: caller.feeds().networks().iter().map(feeds::network_message).collect(),
    })
}

/// Deletes a base with its epochs.
///
/// # Errors
/// The base does not exist, or an open session uses it.
pub async fn delete(
    caller: &Caller,
    request: v1::DeleteBaseRequest,
) -> Result<v1::DeleteBaseResponse, Refusal> {
    let (caller, base) = (caller.clone(), request.base);
    let act = async move {
        let deleted = deleted(&caller, &base).await;
        caller.noted("Bases.Delete", &base, deleted).await
    };
    finished(act).await
}

async fn deleted(caller: &Caller, base: &str) -> Result<v1::DeleteBaseResponse, Refusal> {
    let id = base_id(base)?;
    caller.bases().delete(&id, &caller.author()).await?;
    caller.feeds().stop(&id);
    Ok(v1::DeleteBaseResponse {})
}

/// Stores epochs of a base; returns when they are committed.
///
/// # Errors
/// An epoch is malformed, the position of the base is unknown or wrong, or the store fails. If
/// every epoch is refused, the error is the refusal of the first one.
pub async fn push_epochs(
    caller: &Caller,
    request: v1::PushBaseEpochsRequest,
) -> Result<v1::PushBaseEpochsResponse, Refusal> {
    let id = base_id(&request.base)?;
    let epochs = epochs(request.epochs, &caller.limits().intake(), Numbered::No)?;
    let epochs: Vec<Epoch> = epochs.into_iter().map(|sequenced| sequenced.epoch).collect();
    let times: Vec<GpsTime> = epochs.iter().map(|epoch| epoch.time).collect();
    let BasePush { outcomes, check } = caller.bases().push(&id, epochs).await?;
    if let (true, Some(Err(first))) = (outcomes.iter().all(Result::is_err), outcomes.first()) {
        return Err(Refusal::from(first.clone()).within("epochs[0]"));
    }
    let results = times.into_iter().zip(outcomes).enumerate();
    Ok(v1::PushBaseEpochsResponse {
        results: results.map(|(index, (time, outcome))| result(index, time, outcome)).collect(),
        warnings: warnings(&check),
    })
}

/// Reads a RINEX observation file of a base; returns when its epochs are committed.
///
/// # Errors
/// The file is not readable or exceeds a limit, the position of the base is unknown or wrong, or
/// the store fails.
pub async fn upload(
    caller: &Caller,
    request: v1::UploadBaseRequest,
) -> Result<v1::UploadBaseResponse, Refusal> {
    let id = base_id(&request.base)?;
    let bytes_max = caller.limits().decompressed_bytes;
    let (content, limits) = (request.content, caller.base_file_limits());
    let read = move || read_text(&content, bytes_max, |text| BaseFile::read(text, &limits));
    let upload = read_file(caller, limits.bytes, read).await?;
    if upload.content.epochs.is_empty() {
        return Err(upload.blamed(Refusal::new(Code::NoEpochs, "the file holds no epoch")));
    }
    let skipped = upload.skipped(&upload.content.skipped);
    let BaseFile { epochs, site, .. } = upload.content;
    let push = caller.bases().upload(&id, epochs, site.as_ref()).await?;
    let refused = push.outcomes.iter().filter_map(|outcome| outcome.as_ref().err());
    let is_new = |outcome: &&Result<CommittedEpoch, BaseEpochRefusal>| {
        outcome.as_ref().is_ok_and(|held| !held.resent)
    };
    Ok(v1::UploadBaseResponse {
        epochs: push.outcomes.len() as u64,
        new_epochs: push.outcomes.iter().filter(is_new).count() as u64,
        refused_epochs: refused.clone().count() as u64,
        first_refusal: refused.map(|r| convert::refusal(&r.clone().into())).next(),
        skipped,
        warnings: warnings(&push.check),
    })
}

/// Reads and checks the frame of a base's coordinates; `None` if it is unknown.
fn frame(name: &str, epoch_year: Option<f64>) -> Result<Option<CoordinateFrame>, Refusal> {
    let refused =
        |field: &str, message: String| Err(Refusal::new(Code::InvalidField, message).at(field));
    if let Some(year) = epoch_year {
        if name.is_empty() {
            return refused("frameEpochYear", "the epoch needs a frame".to_owned());
        }
        if !CoordinateFrame::EPOCH_YEARS.contains(&year) {
            return refused("frameEpochYear", format!("{year} is not a year from 1980 to 2100"));
        }
    }
    match CoordinateFrame::named(name, epoch_year) {
        None if name.is_empty() => Ok(None),
        None => {
            let (given, known) = (texts::brief(name), CoordinateFrame::NAMES.join(", "));
            refused("frame", format!("{given:?} is not a known frame; known are {known}"))
        }
        frame => Ok(frame),
    }
}

/// Reads and checks the position of a new base; `None` if its files or stream will give it.
fn site(request: &v1::CreateBaseRequest) -> Result<Option<BaseSite>, Refusal> {
    let refused =
        |field: &str, message: String| Refusal::new(Code::InvalidField, message).at(field);
    let delta: &[f64] = &request.antenna_delta_hen_m;
    let Some(marker) = &request.marker else {
        if !delta.is_empty() {
            let message = "the offset of the antenna needs a marker";
            return Err(refused("antennaDeltaHenM", message.to_owned()));
        }
        return Ok(None);
    };
    let marker = Ecef::new(marker.x_m, marker.y_m, marker.z_m);
    let radius_m = marker.0.norm();
    if !RADII_M.contains(&radius_m) {
        let message = format!("it is {radius_m:.0} m from the centre of the Earth");
        return Err(refused("marker", message));
    }
    let is_near = delta.iter().all(|axis| axis.abs() <= DELTA_MAX_M);
    let antenna_delta_hen_m = match delta {
        [] => [0.0; 3],
        [height, east, north] if is_near => [*height, *east, *north],
        _ => {
            let message = format!("{delta:?} is not height, east, north within {DELTA_MAX_M} m");
            return Err(refused("antennaDeltaHenM", message));
        }
    };
    let antenna = request.antenna.clone();
    let (calibration, source) = (None, PositionSource::Given);
    Ok(Some(BaseSite { marker, antenna_delta_hen_m, antenna, calibration, source }))
}

fn result(
    index: usize,
    time: GpsTime,
    outcome: Result<CommittedEpoch, BaseEpochRefusal>,
) -> v1::BaseEpochResult {
    let mut message = v1::BaseEpochResult { time: Some(time.into()), ..Default::default() };
    match outcome {
        Ok(held) => (message.number, message.resent) = (Some(held.number), held.resent),
        Err(refusal) => {
            let refusal = Refusal::from(refusal).within(&format!("epochs[{index}]"));
            message.refusal = Some(convert::refusal(&refusal));
        }
    }
    message
}

fn warnings(check: &BasePositionCheck) -> Vec<v1::Reason> {
    let doubtful_m =
        check.distance_m().filter(|_| BasePositionVerdict::Doubtful <= check.verdict());
    let warning = doubtful_m.map(|distance_m| Reason::BasePositionDoubtful { distance_m });
    warning.iter().map(reason).collect()
}

/// The verdict as the API writes it.
const fn verdict_text(verdict: BasePositionVerdict) -> &'static str {
    match verdict {
        BasePositionVerdict::Unchecked => "UNCHECKED",
        BasePositionVerdict::Agrees => "AGREES",
        BasePositionVerdict::Doubtful => "DOUBTFUL",
        BasePositionVerdict::Refused => "REFUSED",
    }
}

/// A base as the caller sees it. Only the tenant that owns a base sees its stream and archive.
fn message(caller: &Caller, info: &BaseInfo) -> v1::Base {
    let is_own = info.tenant == *caller.tenant();
    let age_s = info.stored_unix_ms.map(|stored| (unix_ms() - stored) as f64 / 1e3);
    v1::Base {
        feed: info
            .feed
            .as_ref()
            .filter(|_| is_own)
            .map(|feed| feeds::message(caller, &info.name.id, feed)),
        archive: info
            .archive
            .as_ref()
            .filter(|_| is_own)
            .map(|template| feeds::archive_message(caller, &info.name.id, template)),
        base: info.name.id.to_string(),
        label: info.label.clone(),
        created_utc: utc(info.created_unix_ms),
        site: info.site.as_ref().map(site_message),
        epochs: info.epochs as u64,
        first_time: info.span.map(|(first, _)| first.into()),
        last_time: info.span.map(|(_, last)| last.into()),
        last_stored_utc: info.stored_unix_ms.map(utc).unwrap_or_default(),
        age_s: age_s.map(|age_s| age_s.max(0.0)),
        satellites: info.satellites as u32,
        position_check: Some(v1::PositionCheck {
            epochs: info.check.epochs,
            distance_m: info.check.distance_m(),
            verdict: verdict_text(info.check.verdict()).to_owned(),
        }),
        frame: info.frame.map(|frame| frame.name.to_owned()).unwrap_or_default(),
        frame_epoch_year: info.frame.and_then(|frame| frame.epoch_year),
        create_time: timestamp(info.created_unix_ms),
        last_stored_time: info.stored_unix_ms.and_then(timestamp),
    }
}

fn site_message(site: &BaseSite) -> v1::BaseSite {
    let ecef = |Ecef(p): Ecef| v1::Ecef { x_m: p.x, y_m: p.y, z_m: p.z };
    v1::BaseSite {
        marker: Some(ecef(site.marker)),
        antenna_delta_hen_m: site.antenna_delta_hen_m.to_vec(),
        antenna_reference_point: Some(ecef(site.antenna_reference_point())),
        antenna: site.antenna.clone(),
        source: site.source.name().to_owned(),
        antenna_calibrated: site.calibration.is_some(),
    }
}
