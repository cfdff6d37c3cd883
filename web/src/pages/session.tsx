/** One session: its track, its quality over time, its sky, and why it is not better. */
import { useMemo, useRef, useState } from "preact/hooks";
import {
  type Base, type Explained, type GpsTime, type Interval, type Series, type Session, type Solution,
  bases, closeSession, deleteSession, explain, gpsText, residuals, series, session,
} from "../api";
import { Delays } from "../delay";
import { Plots } from "../plots";
import { type Live, useLive } from "../live";
import { type Layer, type LonLat, type TrackPoint, baseStations, baseline, chosenEpoch, track } from "../map/layers";
import { Map2d } from "../map/map";
import { Residuals } from "../residuals";
import { useRight } from "../rights";
import { SatelliteTable, SkyLegend, SkyPlot } from "../sky";
import { LOOKS, type State, colourOf, isDark, lookState, lostAfterS } from "../status";
import { ago, count, duration, gpsTime, learnLeapSeconds, length, recordedUnixS, unixS, utc } from "../time";
import { type Truth, TruthCard, TruthLegend, truthLayer } from "../truth/card";
import type { Epoch } from "../truth/compare";
import { Badge, Because, Confirm, Copyable, Empty, Figure, Loading, ProblemBox, Segments, Share, Symbol, sentence, useTheme, useTitle } from "../ui";
import { Download } from "./download";
import { siteOf } from "./site";

type Span = "600" | "3600" | "86400" | "all";
type Zoom = { from: GpsTime; to: GpsTime };
type Revision = "both" | "first" | "last";

/** Points of a series: more than a screen has columns, and few enough to load at once. */
const POINTS = 1200;
/** Number of epochs whose residuals are shown. The service computes them at each request. */
const RESIDUAL_POINTS = 200;

interface Tracks {
  causal: Series;
  revised: Series;
}

const isRelative = (mode: string): boolean => mode.startsWith("rtk");

export function SessionPage({ id }: { id: string }) {
  useTheme();
  const [chosen, setChosen] = useState<number>();
  const [span, setSpan] = useState<Span>("3600");
  const [zoom, setZoom] = useState<Zoom>();
  const [truth, setTruth] = useState<Truth>();
  const [isClosed, setIsClosed] = useState(false);
  const about = useLive(`session:${id}`, (signal) => session(id, signal), 10_000);
  const closed = isClosed || (about.value?.closed ?? false);
  const last = useLive(`last:${id}`, (signal) => explain(id, null, signal), closed ? 30_000 : 1500);
  const epoch = useLive(
    `epoch:${id}:${chosen ?? "last"}`,
    async (signal) => (chosen === undefined ? undefined : explain(id, chosen, signal)),
    Infinity,
  );
  const stations = useLive("session-bases", bases, 30_000);
  const latest = last.value?.solutions[0];
  if (latest) learnLeapSeconds(latest.time, latest.timeUtc);
  const shownSpan = { id, span, zoom, latest, closed };
  const tracks = useTracks(shownSpan);
  const points = useResiduals(shownSpan);
  const zoomTo = (from: GpsTime, to: GpsTime) => setZoom({ from, to });
  const chart = { selected: chosen, onPick: setChosen, onZoom: zoomTo };
  const arrival = useArrival(latest);
  useTitle(about.value?.label || `Session ${id.slice(0, 12)}`);

  if (!about.value) {
    return (
      <div class="page">
        <p><a href="#/fleet">← Fleet</a></p>
        {about.problem ? <ProblemBox problem={about.problem} what="The session cannot be shown" /> : <Loading what="the session" />}
      </div>
    );
  }
  const shown = chosen === undefined ? last.value : epoch.value;
  const isLost = !closed && lostAfterS() < arrival.ageS;
  const isEmpty = last.problem?.code === "SESSION_EMPTY";
  return (
    <div class="page session">
      <Title about={about.value} closed={closed} latest={latest} isLost={isLost} arrival={arrival} />
      {about.problem && <ProblemBox problem={about.problem} what="The session is not up to date" />}
      {last.problem && !isEmpty && <ProblemBox problem={last.problem} what="The last epoch cannot be loaded" />}
      {isEmpty ? <NoEpochs id={id} /> : (
        <>
          <div class="session-tools">
            <Segments<Span | "zoom">
              label="Span of time"
              value={zoom ? "zoom" : span}
              options={[
                { value: "600", name: "10 min" }, { value: "3600", name: "1 h" }, { value: "86400", name: "24 h" }, { value: "all", name: "All" },
                ...(zoom ? [{ value: "zoom" as const, name: "Zoomed" }] : []),
              ]}
              onChange={(value) => { setZoom(undefined); if (value !== "zoom") setSpan(value); }}
            />
            {chosen === undefined
              ? <span class="small">Following the last epoch. Choose another on the map, in a plot, or with the slider above the plots.</span>
              : <span class="chosen">Epoch {count(chosen)} <button type="button" class="quiet" onClick={() => setChosen(undefined)}>Follow the last</button></span>}
          </div>
          {epoch.problem && <ProblemBox problem={epoch.problem} what={`Epoch ${chosen} cannot be shown`} />}
          <Figures solution={newest(shown)} />
          <div class="session-grid">
            <SessionMap id={id} tracks={tracks.value} shown={shown} bases={stations.value?.bases ?? []} truth={truth} onPick={setChosen} spanKey={`${id}:${span}:${zoom ? gpsText(zoom.from) : ""}`} />
            <Why about={about.value} shown={shown} tracks={tracks.value} lostForS={isLost ? arrival.ageS : undefined} />
          </div>
          {tracks.problem && <ProblemBox problem={tracks.problem} what="The time series cannot be loaded" />}
          {points.problem && <ProblemBox problem={points.problem} what="The residuals cannot be loaded" />}
          <Plots series={tracks.value?.causal} {...chart}>
            {points.value && <Residuals points={points.value} {...chart} />}
          </Plots>
          {tracks.value && <SessionTruth tracks={tracks.value} truth={truth} onTruth={setTruth} {...chart} />}
          {!closed && <Delays id={id} {...chart} />}
          <Sky shown={shown} />
          <Details about={about.value} solution={newest(shown)} />
        </>
      )}
      <Acts about={about.value} closed={closed} onClosed={() => setIsClosed(true)} />
    </div>
  );
}

/** A span of a session that is shown. */
interface ShownSpan {
  id: string;
  span: Span;
  zoom: Zoom | undefined;
  latest: Solution | undefined;
  closed: boolean;
}
interface Bounds {
  from?: string;
  to?: string;
}

/** Data of a span of time, loaded again and again. The slower a call, the longer the pause. */
function useOfSpan<T>(what: string, { id, span, zoom, latest, closed }: ShownSpan, load: (bounds: Bounds, signal: AbortSignal) => Promise<T>): Live<T> {
  const end = useRef<Solution | undefined>(undefined);
  end.current = latest;
  const took = useRef(0);
  const key = zoom ? `${gpsText(zoom.from)}-${gpsText(zoom.to)}` : span;
  return useLive<T>(
    `${what}:${id}:${key}:${latest ? "" : "waits"}`,
    async (signal) => {
      const begun = performance.now();
      const bounds: Bounds = {};
      if (zoom) {
        bounds.from = gpsText(zoom.from);
        bounds.to = gpsText(zoom.to);
      } else if (span !== "all" && end.current) {
        bounds.from = gpsText(gpsTime(unixS(end.current.time) - Number(span)));
      }
      const loaded = await load(bounds, signal);
      took.current = performance.now() - begun;
      return loaded;
    },
    () => (closed || zoom ? 60_000 : Math.max(3000, 15 * took.current)),
  );
}

/** The causal and the revised series of a span of time. */
const useTracks = (span: ShownSpan): Live<Tracks> =>
  useOfSpan("tracks", span, async (bounds, signal) => {
    const [causal, revised] = await Promise.all(
      (["first", "last"] as const).map((revisions) => series(span.id, { ...bounds, points: POINTS, revisions }, signal)),
    );
    return { causal, revised };
  });

/** Residuals of epochs of a span of time. */
const useResiduals = (span: ShownSpan) =>
  useOfSpan("residuals", span, (bounds, signal) => residuals(span.id, { ...bounds, points: RESIDUAL_POINTS }, signal));

const newest = (shown: Explained | undefined): Solution | undefined => shown?.solutions.at(-1);

/** Whether epochs arrive now, and for how long none has (s): 0 while they do, or before the first. */
interface Arrival {
  arriving: boolean;
  ageS: number;
}

function useArrival(latest: Solution | undefined): Arrival {
  const arrivals = useRef({ seq: latest?.seq, at: 0 });
  if (latest && arrivals.current.seq !== latest.seq) {
    arrivals.current = { seq: latest.seq, at: arrivals.current.seq === undefined ? 0 : Date.now() };
  }
  const arriving = Date.now() - arrivals.current.at < 10_000;
  return { arriving, ageS: arriving || !latest ? 0 : Date.now() / 1000 - unixS(latest.time) };
}

interface TitleProps {
  about: Session;
  closed: boolean;
  latest: Solution | undefined;
  isLost: boolean;
  arrival: Arrival;
}

function Title({ about, closed, latest, isLost, arrival: { arriving } }: TitleProps) {
  const age = latest ? Date.now() / 1000 - unixS(latest.time) : undefined;
  const state: State = closed ? "CLOSED" : !latest ? "NEW" : isLost ? "LOST" : lookState(latest.status);
  return (
    <header class="session-title">
      <p class="crumb"><a href="#/fleet">← Fleet</a> · <a href={`#/history/${about.session}`}>History</a></p>
      <div class="title-row">
        <h1>{about.label || "Session"}</h1>
        <Badge state={state} large />
        <span class="small">{age === undefined ? "no epoch yet" : arriving && 60 < age ? "receiving epochs of the past" : `last epoch ${ago(age)}`} · <b>{about.mode}</b> · profile {about.profile}</span>
      </div>
      <p class="small id"><code>{about.session}</code></p>
    </header>
  );
}

function Figures({ solution }: { solution: Solution | undefined }) {
  if (!solution) return null;
  const { position, relative } = solution;
  const cov = position?.covarianceEnuM2;
  const mean = cov ? (cov.firstFirst + cov.secondSecond) / 2 : 0;
  const sigmaH = cov ? Math.sqrt(mean + Math.hypot((cov.firstFirst - cov.secondSecond) / 2, cov.firstSecond)) : undefined;
  return (
    <dl class="figures">
      <Figure name="Status" value={<Badge state={lookState(solution.status)} />} />
      <Figure name="Satellites" value={solution.satellitesUsed.length} hint="satellites whose measurements determine the position" />
      <Figure name="σ horizontal" value={length(sigmaH)} hint="standard deviation along the worst horizontal direction" />
      <Figure name="σ vertical" value={length(cov && Math.sqrt(cov.thirdThird))} />
      <Figure name="Protection H · V" value={`${length(solution.horizontalProtectionM)} · ${length(solution.verticalProtectionM)}`} hint="distances that the error exceeds with at most the stated risk" />
      {relative && <Figure name="Ratio" value={relative.ratio === null ? "–" : relative.ratio.toFixed(1)} hint="second-best to best integers" />}
      {relative && <Figure name="Ambiguities" value={`${relative.fixedAmbiguities} of ${relative.ambiguities} fixed`} />}
      {relative && <Figure name="Age of base" value={duration(relative.ageS)} />}
      {relative && <Figure name="Baseline" value={length(relative.lengthM)} />}
      {solution.dops && <Figure name="PDOP" value={solution.dops.pdop.toFixed(1)} />}
      {position && <Figure name="Latitude, longitude" value={`${position.geodetic.latitudeDeg.toFixed(8)}°, ${position.geodetic.longitudeDeg.toFixed(8)}°`} />}
      {position && <Figure name="Height" value={`${position.geodetic.heightM.toFixed(3)} m`} hint="above the ellipsoid" />}
      <Figure name="Time (UTC)" value={utc(unixS(solution.time))} />
    </dl>
  );
}

const place = (interval: Interval): LonLat | undefined =>
  interval.position ? { lon: interval.position.longitudeDeg, lat: interval.position.latitudeDeg } : undefined;

function pointsOf(series: Series): TrackPoint[] {
  return series.intervals.flatMap((interval) => {
    const at = place(interval);
    return at ? [{ at, state: lookState(interval.status), seq: interval.seq }] : [];
  });
}

/** The last position of each interval, which is compared with the truth. */
const epochsOf = ({ intervals }: Series): Epoch[] =>
  intervals.flatMap(({ seq, time, position }) => {
    if (!position) return [];
    const { latitudeDeg: latDeg, longitudeDeg: lonDeg, heightM } = position;
    return [{ seq, unix: recordedUnixS(time.week, time.nsOfWeek / 1e9), latDeg, lonDeg, heightM }];
  });

interface SessionTruthProps {
  tracks: Tracks;
  truth: Truth | undefined;
  onTruth: (truth: Truth | undefined) => void;
  selected: number | undefined;
  onPick: (seq: number) => void;
  onZoom: (from: GpsTime, to: GpsTime) => void;
}

function SessionTruth({ tracks: { causal, revised }, ...others }: SessionTruthProps) {
  const compared = useMemo(() => [{ name: "Causal", epochs: epochsOf(causal) }, { name: "Revised", epochs: epochsOf(revised) }], [causal, revised]);
  const isThinned = causal.intervals.length < causal.solutions;
  const thinning = isThinned ? `thinned: the last position of each ${duration(causal.intervalLengthS)}; zoom in for all` : undefined;
  return <TruthCard compared={compared} thinning={thinning} {...others} />;
}

interface SessionMapProps {
  id: string;
  tracks: Tracks | undefined;
  shown: Explained | undefined;
  bases: Base[];
  truth: Truth | undefined;
  spanKey: string;
  onPick: (seq: number) => void;
}

function SessionMap({ id, tracks, shown, bases, truth, spanKey, onPick }: SessionMapProps) {
  const [revision, setRevision] = useState<Revision>("both");
  const causal = useMemo(() => (tracks ? pointsOf(tracks.causal) : []), [tracks]);
  const revised = useMemo(() => (tracks ? pointsOf(tracks.revised) : []), [tracks]);
  const anchor = useRef<LonLat | undefined>(undefined);
  anchor.current ??= causal[0]?.at;
  const theme = isDark();
  const layers = useMemo(() => {
    const solution = revision === "first" ? shown?.solutions[0] : newest(shown);
    const line = theme ? "#3d5566" : "#b4c6d0";
    const list: Layer[] = [];
    const base = bases.find(({ base }) => base === solution?.provenance.base?.base);
    const site = base && siteOf(base);
    const at = solution?.position && { lon: solution.position.geodetic.longitudeDeg, lat: solution.position.geodetic.latitudeDeg };
    if (site && at) list.push(baseline(site, at));
    if (site && base) list.push(baseStations([{ id: base.base, at: site, label: base.label || "base" }]));
    // With few points per time a straight line is not the way that the antenna took.
    const coarse = 4 < (tracks?.causal.intervalLengthS ?? 0);
    const strong = theme ? "#c9d8e2" : "#33505f";
    if (revision === "both") list.push(track(revised, { color: coarse ? line : strong, width: coarse ? 1 : 1.6 }, false));
    if (revision !== "last") list.push(track(causal, { color: revision === "both" ? "transparent" : line, width: 1 }, true));
    if (revision === "last") list.push(track(revised, { color: line, width: 1 }, true));
    if (truth && tracks) list.push(truthLayer(truth, epochsOf(tracks.causal)));
    const cov = solution?.position?.covarianceEnuM2;
    if (solution && at && cov) {
      list.push(chosenEpoch(at, lookState(solution.status), { ee: cov.firstFirst, en: cov.firstSecond, nn: cov.secondSecond }, solution.horizontalProtectionM));
    }
    return list;
  }, [causal, revised, revision, shown, bases, truth, theme]);
  const states = [...new Set(causal.map(({ state }) => state))];
  const frame = useMemo(() => causal.map(({ at }) => at), [causal]);
  return (
    <section class="card map-card" aria-label="Track">
      <div class="card-head">
        <h2>Track</h2>
        <Segments<Revision> label="Revision" value={revision} onChange={setRevision} options={[{ value: "both", name: "Both" }, { value: "first", name: "Causal" }, { value: "last", name: "Revised" }]} />
      </div>
      <Map2d label="Map of the track" layers={layers} frame={frame} frameKey={spanKey} smallestM={2} anchor={anchor.current} calmWheel onPick={(picked) => { if (picked && /^\d+$/.test(picked)) onPick(Number(picked)); }}>
        {tracks && frame.length === 0 && <div class="map-note">No position in this span of time.</div>}
      </Map2d>
      <p class="map-legend">
        {states.map((state) => <span key={state}><Symbol state={state} size={11} />{LOOKS[state].name}</span>)}
        {revision === "both" && <span><i class="stroke" />revised, smoothed by later epochs</span>}
        <TruthLegend truth={truth} />
        <span><i class="oval" />95 % error ellipse</span>
        <span><i class="dashed-ring" />protection level</span>
      </p>
      <Download session={id} series={tracks?.causal} revision={revision} />
    </section>
  );
}

interface WhyProps {
  about: Session;
  shown: Explained | undefined;
  tracks: Tracks | undefined;
  /** For how long a lost device has sent nothing (s). */
  lostForS: number | undefined;
}

function Why({ about, shown, tracks, lostForS }: WhyProps) {
  const solution = shown?.solutions[0];
  const best = isRelative(about.mode) ? "FIXED" : undefined;
  const title = best && solution?.status !== "FIXED" ? "Why not fixed" : "What limits it";
  const over = tracks?.causal;
  return (
    <section class="card why" tabIndex={0} aria-label={title}>
      <h2>{title}</h2>
      {lostForS !== undefined && (
        <p class="note warn" role="note">The device is lost: its last epoch is {ago(lostForS)}. If it should send now, check its power, its network and its key. What follows is of the epoch shown.</p>
      )}
      {!solution && <Loading what="the epoch" />}
      {solution && solution.reasons.length === 0 && (
        <p class="good">{solution.status === "FIXED" ? "Nothing: the integers are fixed." : "Nothing: this epoch has no limiting reason."}</p>
      )}
      {solution?.reasons.map((reason) => <Because key={reason.code} refusal={reason} tone={solution.status === "NONE" ? "bad" : "warn"} />)}
      {!best && solution && <p class="small">Mode <b>{about.mode}</b> positions without a base. For centimetres, change the session to <b>rtk-fgo</b> and name a base.</p>}
      {over && 0 < over.solutions && (
        <>
          <h3>In this span of time</h3>
          <ul class="shares">
            {over.statuses.map(({ status, solutions }) => (
              <Share key={status} name={<><Symbol state={lookState(status)} size={12} /> {LOOKS[lookState(status)].name}</>} part={solutions / over.solutions} colour={colourOf(lookState(status))} />
            ))}
          </ul>
          {over.reasons.length > 0 && (
            <ul class="shares reasons">
              {over.reasons.slice(0, 6).map(({ code, remedy, solutions }) => (
                <Share key={code} name={<code>{code}</code>} part={solutions / over.solutions} hint={sentence(remedy)} />
              ))}
            </ul>
          )}
        </>
      )}
    </section>
  );
}

function Sky({ shown }: { shown: Explained | undefined }) {
  const satellites = shown?.satellites ?? [];
  const used = satellites.filter(({ role }) => role === "USED").length;
  return (
    <section class="card sky-card">
      <div class="card-head">
        <h2>Sky</h2>
        <span class="small">{used} of {satellites.length} observed satellites are used{shown && ` in epoch ${count(shown.solutions[0]?.seq ?? 0)}`}</span>
      </div>
      {satellites.length === 0 ? <p>No satellite is observed in this epoch.</p> : (
        <div class="sky-grid">
          <div><SkyPlot satellites={satellites} /><SkyLegend satellites={satellites} /></div>
          <SatelliteTable satellites={satellites} />
        </div>
      )}
    </section>
  );
}

function Details({ about, solution }: { about: Session; solution: Solution | undefined }) {
  const changed = about.configuration.filter(({ name }) => name in about.overrides);
  return (
    <details class="card details">
      <summary><h2>Configuration and origin</h2></summary>
      <dl class="figures">
        <Figure name="Mode" value={about.mode} />
        <Figure name="Profile" value={about.profile} />
        <Figure name="Base" value={about.base || (about.bases.length ? `nearest of ${about.bases.length}` : "none")} />
        <Figure name="Antenna" value={about.antenna || "not corrected"} />
        <Figure name="Retention" value={about.retentionDays === 0 ? "for ever" : `${about.retentionDays} d`} />
        <Figure name="Created (UTC)" value={about.createdUtc.slice(0, 19).replace("T", " ")} />
        <Figure name="Durable through" value={about.durableThrough === null ? "–" : count(about.durableThrough)} />
        {solution && <Figure name="Computed by" value={`Graphfix ${solution.provenance.version}`} />}
      </dl>
      {changed.length > 0 && <h3>Differs from the profile</h3>}
      {changed.length > 0 && <Options options={changed} />}
      <h3>All options in force</h3>
      <Options options={about.configuration} />
    </details>
  );
}

function Options({ options }: { options: Session["configuration"] }) {
  return (
    <div class="table-box options" tabIndex={0} role="region" aria-label="Options">
      <table>
        <thead><tr><th scope="col">Option</th><th scope="col">Value</th><th scope="col">Meaning</th></tr></thead>
        <tbody>
          {options.map(({ name, value, unit, meaning, default: standard }) => (
            <tr key={name}><th scope="row"><code>{name}</code></th><td>{value === standard ? value : <b>{value}</b>} {unit}</td><td>{meaning}</td></tr>
          ))}
        </tbody>
      </table>
    </div>
  );
}

/** The button that closes a session, for users with the right to do so. */
function Acts({ about: { session, label }, closed, onClosed }: { about: Session; closed: boolean; onClosed: () => void }) {
  const mayOperate = useRight("operate");
  if (!mayOperate) return null;
  const name = label || session.slice(0, 12);
  const close = async () => {
    await closeSession(session);
    onClosed();
  };
  const remove = async () => {
    await deleteSession(session);
    location.hash = "#/fleet";
  };
  return (
    <div class="acts">
      {!closed && (
        <Confirm words="Close" name={name} yes="Close it" no="Keep it open" failed="The session was not closed" act={close}>
          It takes no more epochs, for good: its device is refused. Its solutions stay.
        </Confirm>
      )}
      <Confirm words="Delete for good" name={name} yes="Delete it" no="Keep it" failed="The session was not deleted" act={remove}>
        Its epochs, solutions and observations are lost for good{closed ? "" : ", and its device is refused"}.
      </Confirm>
    </div>
  );
}

function NoEpochs({ id }: { id: string }) {
  return (
    <Empty title="No epoch yet">
      <p>The session is open and waits for its receiver. Play a receiver's file into it:</p>
      <Copyable label="Play a file into the session" text={`graphfix stream --session ${id} --rover FILE.obs --server ${location.origin}`} />
    </Empty>
  );
}
