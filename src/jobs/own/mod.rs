//! Inputs that the service adds to a job: ephemerides and a base that the files of the job lack.
//!
//! The task that fetches inputs adds them before the job can run. First it reads the rover's file
//! for its times, in turns of the solver pool. An added file becomes an input like an uploaded one,
//! so that each run of the job computes with the same inputs.
//!
//! - **Ephemerides** in the receivers' own data come first: with them nothing is added, and the
//!   recording is positioned as by `graphfix solve`. Otherwise the service adds its present
//!   ephemerides, if they are in force all the time. Otherwise it adds the files of that time from
//!   the operator's archives; without such files its present ephemerides, if they are in force some
//!   of the time.
//! - **A base** is the one in the request, otherwise the nearest one. Its epochs are the stored
//!   ones of that time, or those of its archive's files.

mod addresses;
mod background;
mod base_epochs;
mod ephemerides;

use std::fs::File;
use std::sync::Arc;
use std::time::{Duration, Instant};

use tokio::runtime::Handle;
use tokio::task::spawn_blocking;
use tokio::time::timeout;

use crate::aiding::AidingDesk;
use crate::aiding::bases::{BaseFile, BaseId, PastBase};
use crate::feeds::{ArchiveTemplate, WebError, archived_files};
use crate::formats::receiver::TimeReference;
use crate::gnss::{Ecef, GpsTime, Navigation};
use crate::recording::{Input, RecordingError, Survey};
use crate::refusal::Code;
use crate::session::{BATCH_QUANTUM, SessionError};
use crate::store::{BaseChoice, StoreError, StoredBaseEpoch, StoredEpoch};
use crate::tenant::Tenant;

use super::JobError;
use super::arriving::{ArrivingFile, Upload};
use super::files::StoredFile;
use super::report::Failure;
use super::request::{JobInput, JobRequest, Part, Plan};
use super::run::failed;
use super::state::{Desk, LOOK, Running, unless_stopped};
use super::watched::Watched;

use addresses::Addresses;
use background::in_background;
use base_epochs::{BaseEpochs, BaseText, covers, named};
use ephemerides::chosen;

/// Most bases whose archives are asked for one job.
const ARCHIVES_MAX: usize = 5;

/// The work of adding inputs to a job.
pub(super) struct Adding<'a> {
    pub(super) desk: &'a Desk,
    pub(super) tenant: Tenant,
    pub(super) running: Arc<Running>,
    pub(super) upload: &'a mut Upload,
}

/// The content of the files of a recording.
struct Surveyed {
    /// Times of its first and last epoch; `None` if the files contain no date.
    span: Option<(GpsTime, GpsTime)>,
    /// The ephemerides in the files, otherwise those that the receivers have decoded.
    navigation: Navigation,
}

/// The files of a recording that are read on a blocking thread.
#[derive(Clone)]
struct Files {
    rover: Arc<File>,
    base: Option<Arc<File>>,
    navigation: Vec<Arc<File>>,
    unpacked_bytes: u64,
    reference: Option<TimeReference>,
}

impl Adding<'_> {
    /// Adds what the files of a job lack, if the service has it. Returns the added files; `None` if
    /// the job is stopped.
    ///
    /// # Errors
    /// The rover's file cannot be read, the service has no base or no ephemerides of its time, or
    /// the disk fails.
    pub(super) async fn add(
        mut self,
        request: &mut JobRequest,
    ) -> Result<Option<Vec<StoredFile>>, Failure> {
        let plan = self.desk.plan(request).map_err(|error| failed(&error))?;
        if !request.lacks_aiding(&plan.options) {
            return Ok(Some(Vec::new()));
        }
        let aiding = self.desk.aiding().await;
        let aiding = aiding.map_err(|error| Failure::of_session(&error.into()))?;
        if request.takes_stored_base(&plan.options) {
            return self.add_to_session(request, &plan, &aiding).await;
        }
        let files = self.opened(request, &plan).await?;
        let Some(Surveyed { span, navigation }) = self.surveyed(files.clone()).await? else {
            return Ok(None);
        };
        let mut added = Vec::new();
        let navigation = match request.lacks_navigation() && navigation.is_empty() {
            false => navigation,
            true => {
                let now = aiding.navigation.of(&self.tenant).current().navigation;
                let addresses = Addresses::of(&Tenant::operator(), &self.tenant);
                let chosen = chosen(&now, self.desk.archives.as_ref(), span, addresses);
                let Some(chosen) = self.awaited(chosen).await? else { return Ok(None) };
                let mut all = Navigation::default();
                for (name, content, navigation) in chosen? {
                    let part = Part::Navigation;
                    let mut file = self.begin(part).await?;
                    file.write(&content).await.map_err(|error| at_part(&error, part))?;
                    added.push(add_file(request, (part, &name), file).await?);
                    all.merge(navigation);
                }
                all
            }
        };
        if request.lacks_base(&plan.options) {
            let span = span.ok_or_else(|| no_base(request, "nothing dates the rover's epochs"))?;
            let position = self.position(files, navigation.clone()).await?;
            let choice = request.options.bases.clone();
            let found = self.base(choice, &plan, &aiding, (span, position));
            let Some(found) = self.awaited(found).await? else { return Ok(None) };
            let found = found.map_err(|why| no_base(request, &why))?;
            added.push(self.store_base(request, found, &navigation).await?);
        }
        Ok(Some(added))
    }

    /// Adds the files of a base's archive to a job over a session, if not all epochs of its time
    /// are stored. They may be missing because archives are asked only for times that rovers
    /// needed.
    async fn add_to_session(
        &mut self,
        request: &mut JobRequest,
        plan: &Plan,
        aiding: &AidingDesk,
    ) -> Result<Option<Vec<StoredFile>>, Failure> {
        let (source, session) = request
            .options
            .session
            .as_ref()
            .zip(request.session.as_ref())
            .expect("it takes a session's epochs");
        let store = &self.desk.store;
        let of_store = |error: StoreError| Failure::of_session(&error.into());
        let row = store.session(&self.tenant, &source.id).await.map_err(of_store)?;
        let id = source.id.clone();
        let row = row.ok_or_else(|| Failure::of_session(&SessionError::NotFound { id }))?;
        let (mut span, mut position) = (None, None);
        for number in [session.numbers.0, session.numbers.1] {
            let stored = store.epochs_after(row.key, number.checked_sub(1), 1).await;
            for StoredEpoch { epoch, solution, .. } in stored.map_err(of_store)? {
                let (from, _) = span.unwrap_or((epoch.time, epoch.time));
                span = Some((from, epoch.time));
                let estimate = solution.solution.estimate;
                position = position.or(estimate.map(|estimate| estimate.position));
            }
        }
        let Some(span) = span else { return Ok(Some(Vec::new())) };
        let choice = match &source.bases {
            BaseChoice::None => {
                let own = row.settings.base.try_map(|name| Ok::<_, Failure>(name.id.to_string()));
                own?
            }
            asked => asked.clone(),
        };
        let found = self.base(choice, plan, aiding, (span, position));
        let Some(found) = self.awaited(found).await? else { return Ok(None) };
        match found {
            Ok(found) if found.is_of_archive => {
                let navigation = aiding.navigation.of(&self.tenant).current().navigation;
                Ok(Some(vec![self.store_base(request, found, &navigation).await?]))
            }
            // The run uses the stored epochs.
            Ok(_) | Err(_) => Ok(Some(Vec::new())),
        }
    }

    /// Stores the epochs of a base as a file, and adds it to the inputs.
    async fn store_base(
        &mut self,
        request: &mut JobRequest,
        base: BaseEpochs,
        navigation: &Navigation,
    ) -> Result<StoredFile, Failure> {
        let (name, frame) = (base.name.clone(), base.frame);
        let mut file = self.begin(Part::Base).await?;
        let mut text = BaseText::begin(base, navigation).await?;
        while let Some(piece) = text.next().await? {
            file.write(&piece).await.map_err(|error| at_part(&error, Part::Base))?;
        }
        let stored = add_file(request, (Part::Base, &name), file).await?;
        for added in request.inputs.iter_mut().filter(|input| input.part == Part::Base) {
            added.frame = frame.map(|frame| frame.to_string());
        }
        Ok(stored)
    }

    async fn opened(&self, request: &JobRequest, plan: &Plan) -> Result<Files, Failure> {
        let files = self.desk.files().map_err(|error| failed(&error))?;
        let open = async |part: Part| {
            let mut opened = Vec::new();
            for input in request.inputs.iter().filter(|input| input.part == part) {
                let file = files.open_input(&input.hash, input.bytes).await;
                opened.push(Arc::new(file.map_err(|error| failed(&error))?));
            }
            Ok::<_, Failure>(opened)
        };
        let rover = open(Part::Rover).await?.pop();
        Ok(Files {
            rover: rover.expect("the plan has checked the parts"),
            base: open(Part::Base).await?.pop(),
            navigation: open(Part::Navigation).await?,
            unpacked_bytes: self.desk.limits.unpacked_bytes,
            reference: plan.reference,
        })
    }

    /// Reads the files, in turns; `None` if the job is stopped.
    async fn surveyed(&self, files: Files) -> Result<Option<Surveyed>, Failure> {
        let (lane, tenant, running) =
            (self.desk.lane.clone(), self.tenant.clone(), self.running.clone());
        let runtime = Handle::current();
        in_background(move || {
            let watched = Watched::default();
            let (rover, base, navigation) = files.inputs(&watched);
            let mut survey = None;
            loop {
                if running.is_stopped() {
                    return Ok(None);
                }
                let turn = runtime.block_on(async { timeout(LOOK, lane.turn(&tenant)).await });
                let Ok(_turn) = turn else { continue };
                let begun = Instant::now();
                let survey = match &mut survey {
                    Some(survey) => survey,
                    none => match Survey::open(&rover, base.as_ref(), &navigation, files.reference)
                    {
                        Ok(opened) => none.insert(opened),
                        // The added ephemerides may give the date.
                        Err(RecordingError::NoReferenceTime { .. }) => {
                            return Ok(Some(Surveyed {
                                span: None,
                                navigation: Navigation::default(),
                            }));
                        }
                        Err(error) => return Err(watched.failure(&error)),
                    },
                };
                while begun.elapsed() < BATCH_QUANTUM {
                    if !survey.step().map_err(|error| watched.failure(&error))? {
                        let (span, navigation) = (survey.span(), survey.navigation().clone());
                        return Ok(Some(Surveyed { span, navigation }));
                    }
                }
            }
        })
        .await
    }

    /// The position of the rover, if its file and these ephemerides give one.
    async fn position(
        &self,
        files: Files,
        navigation: Navigation,
    ) -> Result<Option<Ecef>, Failure> {
        in_background(move || {
            let watched = Watched::default();
            let (rover, _, named) = files.inputs(&watched);
            let found = Survey::open(&rover, None, &named, files.reference)
                .and_then(|survey| survey.position(&navigation));
            found.map_err(|error| watched.failure(&error))
        })
        .await
    }

    /// The epochs of the requested base, or of the nearest base that has any.
    ///
    /// # Errors
    /// No base has epochs of that time; the text gives the reason.
    async fn base(
        &self,
        choice: BaseChoice<String>,
        plan: &Plan,
        aiding: &AidingDesk,
        (span, position): ((GpsTime, GpsTime), Option<Ecef>),
    ) -> Result<BaseEpochs, String> {
        let choice = choice
            .try_map(|id| BaseId::parse(&id).ok_or_else(|| format!("there is no base {id:?}")))?;
        let (longest_m, age_s) = (plan.options.rtk.baseline_max_m, plan.options.rtk.base_age_max_s);
        let visible = aiding.bases.of(&self.tenant);
        let offers = visible.for_recording(&choice, position, longest_m);
        let offers = offers.map_err(|error| error.to_string())?;
        let (mut partial, mut asked, mut problem) = (None, 0, None);
        for offer in &offers {
            let (site, epochs) = offer.stored(span, age_s);
            let is_whole = covers(&epochs, span, age_s);
            if let Some(site) = site.filter(|_| !epochs.is_empty()) {
                let name = named(offer, "its stored epochs");
                let found =
                    BaseEpochs { frame: offer.frame(), name, site, epochs, is_of_archive: false };
                if is_whole {
                    return Ok(found);
                }
                partial.get_or_insert(found);
            }
            if let Some(template) = offer.archive().filter(|_| asked < ARCHIVES_MAX) {
                asked += 1;
                match self.archived(offer, template, (span, age_s), aiding).await {
                    Ok(Some(found)) => return Ok(found),
                    Ok(None) => {}
                    Err(text) => drop(problem.get_or_insert(text)),
                }
            }
        }
        partial.ok_or_else(|| {
            let (from, until) = span;
            let mut message = match offers.len() {
                0 => format!("no base of the service is within {:.0} km", longest_m / 1e3),
                _ => format!("no base of the service has epochs from {from} until {until}"),
            };
            if let Some(problem) = problem {
                message = format!("{message}; {problem}");
            }
            message
        })
    }

    /// The epochs in the files of a base's archive; `None` if the files have none of that time.
    async fn archived(
        &self,
        offer: &PastBase,
        template: &str,
        (span, age_s): ((GpsTime, GpsTime), f64),
        aiding: &AidingDesk,
    ) -> Result<Option<BaseEpochs>, String> {
        let addresses = Addresses::of(offer.tenant(), &self.tenant);
        let archive = format!("the archive of base {}", offer.id());
        let failed = |error: WebError| addresses.failure(&archive, &error);
        let template = ArchiveTemplate::new(template).map_err(|error| failed(error.into()))?;
        let connector = self.desk.connector.of(offer.tenant());
        let (begin, end) = PastBase::needed(span, age_s);
        let files = archived_files(&connector, &template, (begin, end)).await.map_err(failed)?;
        let limits = aiding.bases.file_limits();
        let (known, _) = offer.stored(span, age_s);
        let (mut epochs, mut site, urls) = (Vec::new(), known, files.len());
        for file in files {
            let shown = addresses.file(&file.url, &archive);
            let read = move || {
                let read = BaseFile::read(file.unpacked(), &limits);
                read.map_err(|error| format!("{shown}: {error}"))
            };
            let read = spawn_blocking(read).await.unwrap_or_else(|panic| Err(panic.to_string()));
            let BaseFile { epochs: all, site: stated, .. } = read?;
            site = site.or(stated);
            let is_wanted = |epoch: &StoredBaseEpoch| begin <= epoch.time && epoch.time <= end;
            epochs.extend(all.into_iter().filter(is_wanted));
            if limits.bytes < epochs.iter().map(StoredBaseEpoch::size).sum() {
                let limit = limits.bytes;
                return Err(format!("{archive}: the epochs need more than {limit} bytes"));
            }
        }
        epochs.sort_by_key(|epoch| epoch.time);
        epochs.dedup_by_key(|epoch| epoch.time);
        let what = match urls {
            1 => "a file of its archive".to_owned(),
            _ => format!("{urls} files of its archive"),
        };
        let name = named(offer, &what);
        Ok(site.filter(|_| !epochs.is_empty()).map(|site| BaseEpochs {
            name,
            site,
            epochs,
            is_of_archive: true,
            frame: offer.frame(),
        }))
    }

    /// The result of work that may ask archives; `None` if the job is stopped.
    ///
    /// # Errors
    /// It takes longer than the fetch of an input is allowed to take.
    async fn awaited<T>(&self, work: impl Future<Output = T>) -> Result<Option<T>, Failure> {
        let longest = Duration::from_secs(self.desk.limits.fetch_s);
        let done = unless_stopped(&self.running, timeout(longest, work)).await;
        done.transpose().map_err(|_| {
            let message = format!("the archives took longer than {} s", longest.as_secs());
            Failure::new(Code::HostSlow, message, None)
        })
    }

    /// Begins a file of a part.
    async fn begin(&mut self, part: Part) -> Result<ArrivingFile, Failure> {
        self.upload.begin_again().await.map_err(|error| at_part(&error, part))
    }
}

/// Stores a file and adds it to the inputs of a request.
async fn add_file(
    request: &mut JobRequest,
    (part, name): (Part, &str),
    file: ArrivingFile,
) -> Result<StoredFile, Failure> {
    let stored = file.finish().await.map_err(|error| at_part(&error, part))?;
    let (hash, bytes, name) = (stored.hash.clone(), stored.bytes, name.to_owned());
    request.add(JobInput { part, name, hash, bytes, is_own: true, url: None, frame: None });
    Ok(stored)
}

fn at_part(error: &JobError, part: Part) -> Failure {
    Failure::new(error.code(), error.to_string(), Some(part.name()))
}

impl Files {
    /// The inputs of the rover, of the base and of navigation data.
    fn inputs(&self, watched: &Watched) -> (Input, Option<Input>, Vec<Input>) {
        let input = |part: Part, file: &Arc<File>| {
            watched.input(file.clone(), self.unpacked_bytes, part, part.name())
        };
        let base = self.base.as_ref().map(|base| input(Part::Base, base));
        let navigation = self.navigation.iter().map(|file| input(Part::Navigation, file));
        (input(Part::Rover, &self.rover), base, navigation.collect())
    }
}

fn no_base(request: &JobRequest, why: &str) -> Failure {
    let message = format!("mode {} needs a base: {why}", request.options.mode);
    Failure::new(Code::BaseRequired, message, Some("base"))
}
