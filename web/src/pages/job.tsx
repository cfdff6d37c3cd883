/** One job: its progress while it runs, then its report and its track, or why it has failed. */
import { useEffect, useMemo, useState } from "preact/hooks";
import { type GpsTime, Problem, type StatusName } from "../api";
import { type Job, type JobReport, eventsPath, hasEnded, job as jobOf, remove, report as reportOf, reportPagePath, resultPath } from "../jobs/api";
import { Bar, setDraft } from "../jobs/new";
import { PARSERS, type Row, horizontalSigma, load, thinned } from "../jobs/result";
import { JobLamp, answerOf, isWithoutPosition, left, nameOf, ranFor, runTime, when } from "../jobs/state";
import { useEvents, useLive } from "../live";
import { type Layer, type TrackPoint, chosenEpoch, track } from "../map/layers";
import { Map2d } from "../map/map";
import { Plots } from "../plots";
import { useRight } from "../rights";
import { LOOKS, colourOf, isDark, lookState } from "../status";
import { bytes, count, duration, length, unixS, utc } from "../time";
import { type Truth, TruthCard, TruthLegend, truthLayer } from "../truth/card";
import type { Epoch } from "../truth/compare";
import { Badge, Confirm, Figure, Loading, ProblemBox, Share, Symbol, sentence, useTheme, useTitle } from "../ui";
import { CancelJob } from "./jobs";

/** Points of the track and of plots. */
const POINTS = 1200;
/** A larger result is read for its track only after the user has asked for it (bytes). */
const READ_BYTES = 24_000_000;

export function JobPage({ id }: { id: string }) {
  useTheme();
  const live = useEvents<Job>(eventsPath(id), ["job", "ended"], (signal) => jobOf(id, signal), hasEnded);
  const mayOperate = useRight("operate");
  const job = live.value;
  useTitle(job ? `Job ${nameOf(job)}` : "Job");
  if (!job) {
    return (
      <div class="page">
        <p class="crumb"><a href="#/jobs">← Jobs</a></p>
        {live.problem ? <ProblemBox problem={live.problem} what="The job cannot be shown" /> : <Loading what="the job" />}
      </div>
    );
  }
  return (
    <div class="page job">
      <header>
        <p class="crumb"><a href="#/jobs">← Jobs</a></p>
        <div class="title-row">
          <h1 class="break">{nameOf(job)}</h1>
          <span class="badge-large job-state" role="status"><JobLamp job={job} /></span>
          <span class="small"><b>{job.options.mode}</b> · {answerOf(job)} · profile {job.options.profile}</span>
        </div>
        <p class="small id"><code>{job.job}</code></p>
      </header>
      {live.problem && <ProblemBox problem={live.problem} what="The job is not up to date" />}
      {!hasEnded(job) && <Running job={job} mayOperate={mayOperate} onCancelled={live.set} />}
      {job.state === "FAILED" && job.failure && (
        <ProblemBox problem={new Problem(job.failure.code, job.failure.message, job.failure.remedy, job.failure.field)} what="The job has failed" />
      )}
      {job.state === "CANCELLED" && <p class="note">The job was cancelled {when(job.endedUtc)} UTC, after {count(job.progress.epochs)} epochs. It has no result.</p>}
      {job.state === "SUCCEEDED" && <Succeeded job={job} />}
      <Request job={job} />
      {mayOperate && (
        <div class="acts">
          <a class="quiet" href="#/jobs" onClick={() => setDraft(draftOf(job))}>A new job with these options</a>
          {hasEnded(job) && <DeleteJob job={job} />}
        </div>
      )}
    </div>
  );
}

function DeleteJob({ job }: { job: Job }) {
  const act = async () => {
    await remove(job.job);
    location.hash = "#/jobs";
  };
  return (
    <Confirm words="Delete" name={nameOf(job)} yes="Delete it" no="Keep it" failed="The job was not deleted" act={act}>
      Its files{job.state === "SUCCEEDED" ? ", result and report" : ""} are lost for good.
    </Confirm>
  );
}

function Running({ job, mayOperate, onCancelled }: { job: Job; mayOperate: boolean; onCancelled: (job: Job) => void }) {
  const { percent, epochs, answered, epochsPerSecond, remainingS } = job.progress;
  return (
    <section class="card running" aria-label="Progress">
      <Bar percent={percent} label="Progress of the job" />
      {job.state === "QUEUED"
        ? <p>It waits: jobs run in the order of their arrival. This page follows it by itself.</p>
        : (
          <dl class="figures">
            <Figure name="Read" value={`${percent.toFixed(1)} %`} hint="part of the rover's file" />
            <Figure name="Epochs" value={count(epochs)} />
            <Figure name="With a position" value={count(answered)} />
            <Figure name="Rate" value={epochsPerSecond === null ? "–" : `${count(Math.round(epochsPerSecond))} epochs/s`} />
            <Figure name="Left" value={remainingS === null ? "–" : left(remainingS).replace(" left", "")} hint="estimated" />
          </dl>
        )}
      {mayOperate && <CancelJob job={job} onCancelled={onCancelled} />}
    </section>
  );
}

function Succeeded({ job }: { job: Job }) {
  const { value: report, problem } = useLive(`report:${job.job}`, (signal) => reportOf(job.job, signal), Infinity);
  return (
    <>
      {isWithoutPosition(job) && <WithoutPosition job={job} />}
      <section class="card job-result" aria-label="Result">
        {report && <Summary job={job} report={report} />}
        <div class="job-take">
          <a class="primary" href={resultPath(job.job)} download>Download {job.options.format}{job.resultBytes !== null && `, ${bytes(job.resultBytes)}`}</a>
          <span class="job-report">
            <a class="quiet" href={reportPagePath(job.job)} target="_blank" rel="noopener">Report as a page</a>
            <a class="quiet" href={reportPagePath(job.job)} download={`${job.job}-report.html`}>Download the report</a>
          </span>
          <span class="small">kept until {utc(Date.parse(job.expiresUtc) / 1000).slice(0, 16)} UTC</span>
        </div>
      </section>
      {problem && <ProblemBox problem={problem} what="The report cannot be loaded" />}
      {!report && !problem && <Loading what="the report" />}
      {report && <Result job={job} report={report} />}
    </>
  );
}

/** A job that succeeded without any position. */
function WithoutPosition({ job: { progress: { epochs } } }: { job: Job }) {
  return (
    <p class="note warn" role="note">
      {epochs === 0
        ? "The job ran to its end, but there is no epoch in the file."
        : `The job ran to its end, but no epoch of ${count(epochs)} has a position, so there is no track. “What limits them” says why, and what to do.`}
    </p>
  );
}

const part = (epochs: number, of: number): string => (of === 0 ? "–" : `${((epochs / of) * 100).toFixed(epochs === of || epochs === 0 ? 0 : 1)} %`);

function Summary({ job, report: { epochs, answered, statuses, seconds, version, configurationHash } }: { job: Job; report: JobReport }) {
  const fixed = statuses.find(({ name }) => name === "FIXED")?.epochs ?? 0;
  return (
    <dl class="figures">
      <Figure name="Epochs" value={count(epochs)} />
      <Figure name="With a position" value={answered === 0 && 0 < epochs ? "none" : part(answered, epochs)} hint={`${count(answered)} of ${count(epochs)}`} />
      {job.options.mode.startsWith("rtk") && <Figure name="Fixed" value={part(fixed, epochs)} hint="with integer ambiguities: centimetres" />}
      <Figure name="Time of the run" value={runTime(seconds)} />
      <Figure name="Rate" value={0 < seconds ? `${count(Math.round(epochs / seconds))} epochs/s` : "–"} />
      <Figure name="Computed by" value={`Graphfix ${version}`} />
      <Figure name="Configuration" value={<code>{configurationHash.slice(0, 12)}</code>} hint={configurationHash} />
    </dl>
  );
}

/** Statuses, reasons, and what the positions rest on. */
function ReportView({ job, report: { epochs, statuses, reasons, provenance, skipped } }: { job: Job; report: JobReport }) {
  const warnings = provenance.filter((line) => line.startsWith("warning: "));
  const others = provenance.filter((line) => !line.startsWith("warning: "));
  return (
    <div>
      {warnings.map((line) => <p key={line} class="note warn" role="note">{sentence(line.replace("warning: ", ""))}</p>)}
      <section class="card" aria-label="Statuses">
        <h2>Statuses</h2>
        {epochs === 0 && <p>There is no epoch in the file.</p>}
        <ul class="shares">
          {byRank(statuses).map(({ name, epochs: of }) => {
            const state = lookState(name as StatusName);
            return <Share key={name} name={<><Symbol state={state} size={12} /> {LOOKS[state].name} <span class="small">{count(of)}</span></>} part={of / epochs} colour={colourOf(state)} hint={LOOKS[state].meaning} />;
          })}
        </ul>
      </section>
      <section class="card" aria-label="Reasons">
        <h2>What limits them</h2>
        {reasons.length === 0 && <p class="good">Nothing: no epoch has a limiting reason.</p>}
        <ul class="shares">
          {[...reasons].sort((a, b) => b.epochs - a.epochs).map(({ name, epochs: of, remedy }) => (
            <Share key={name} name={<><code>{name}</code> <span class="small">{count(of)}</span>{remedy && <span class="share-remedy">{sentence(remedy)}</span>}</>} part={of / epochs} />
          ))}
        </ul>
      </section>
      <section class="card" aria-label="Origin">
        <h2>What they rest on</h2>
        <ul class="lines">
          {others.map((line) => <li key={line}>{line}{isOfAdded(job, line) && " (added by the service, not in the upload)"}</li>)}
          {others.length === 0 && <li>the uploaded files alone, without a base</li>}
        </ul>
        {skipped.length > 0 && (
          <details>
            <summary><h3>Skipped of the files: {count(skipped.length)} {skipped.length === 1 ? "kind" : "kinds"}</h3></summary>
            <ul class="lines">{skipped.map((line) => <li key={line}>{line}</li>)}</ul>
          </details>
        )}
      </section>
    </div>
  );
}

/**
 * Whether a line of the report names an input that the service added. Such a line has the part and
 * the name of the input, and for a base also its frame.
 */
const isOfAdded = ({ inputs }: Job, line: string): boolean => inputs.some(({ part, name, own }) => own && line.startsWith(`${part}: ${name}`));

const byRank = (statuses: JobReport["statuses"]): JobReport["statuses"] => {
  const order = Object.keys(LOOKS);
  return [...statuses].sort((a, b) => order.indexOf(a.name) - order.indexOf(b.name));
};

/** Track and plots, read from the file of positions. */
function Result({ job, report }: { job: Job; report: JobReport }) {
  const size = job.resultBytes ?? 0;
  const hasTrack = job.options.format in PARSERS && 0 < report.answered;
  const [wanted, setWanted] = useState(hasTrack && size <= READ_BYTES);
  const [rows, setRows] = useState<Row[]>();
  const [problem, setProblem] = useState<Problem>();
  const [zoom, setZoom] = useState<[number, number]>();
  const [chosen, setChosen] = useState<number>();
  const [truth, setTruth] = useState<Truth>();
  useEffect(() => {
    if (!wanted) return undefined;
    const stop = new AbortController();
    // Some formats have one quality for all positions that are neither fixed nor float.
    const unnamed = report.statuses.filter(({ name }) => !["FIXED", "FLOAT", "NONE"].includes(name)).sort((a, b) => b.epochs - a.epochs);
    load(resultPath(job.job), job.options.format, (unnamed[0]?.name ?? "SINGLE") as StatusName, stop.signal).then(setRows, (error) => {
      if (!stop.signal.aborted) setProblem(error instanceof Problem ? error : new Problem("RESULT_UNREADABLE", String(error), "download the file instead"));
    });
    return () => stop.abort();
  }, [wanted]);
  const series = useMemo(() => rows && thinned(rows, POINTS, ...(zoom ?? [])), [rows, zoom]);
  const compared = useMemo(() => [{ name: "Result", epochs: epochsOf(rows ?? [], zoom) }], [rows, zoom]);
  const chart = { selected: chosen, onPick: setChosen, onZoom: (from: GpsTime, to: GpsTime) => setZoom([unixS(from), unixS(to)]) };
  const row = chosen === undefined ? undefined : rows?.[chosen - 1];
  if (!hasTrack) {
    return (
      <>
        {0 < report.answered && <p class="note">This page reads no track from a result as {job.options.format}: the <a href={reportPagePath(job.job)} target="_blank" rel="noopener">report as a page</a> shows it.</p>}
        <div class="report-alone"><ReportView job={job} report={report} /></div>
      </>
    );
  }
  return (
    <>
      <div class="report-grid">
        <div class="report-track">
          {!wanted && <p><button type="button" class="quiet" onClick={() => setWanted(true)}>Show the track ({bytes(size)} to read)</button></p>}
          {problem && <ProblemBox problem={problem} what="The track cannot be shown" />}
          {wanted && !rows && !problem && <Loading what="the track" />}
          {rows?.length === 0 && <p class="note">The result has no position that this page can read.</p>}
          {series && series.solutions > 0 && <ResultMap series={series} row={row} truth={truth} frameKey={`${job.job}:${zoom?.join()}`} onPick={setChosen} />}
        </div>
        <ReportView job={job} report={report} />
      </div>
      {row && <Chosen row={row} number={chosen ?? 0} onClose={() => setChosen(undefined)} />}
      {zoom && <p><button type="button" class="quiet" onClick={() => setZoom(undefined)}>Show the whole recording</button></p>}
      {series && series.solutions > 0 && (
        <>
          <Plots series={series} {...chart} />
          <TruthCard compared={compared} truth={truth} onTruth={setTruth} {...chart} />
        </>
      )}
    </>
  );
}

/** The positions in a span of time, or all without a span. */
const epochsOf = (rows: Row[], [from, to] = [-Infinity, Infinity]): Epoch[] =>
  rows.flatMap((row, i) => (from <= row.unix && row.unix <= to && Number.isFinite(row.latDeg) ? [{ seq: i + 1, unix: row.unix, latDeg: row.latDeg, lonDeg: row.lonDeg, heightM: row.heightM }] : []));

interface ResultMapProps {
  series: ReturnType<typeof thinned>;
  row: Row | undefined;
  truth: Truth | undefined;
  frameKey: string;
  onPick: (seq: number) => void;
}

function ResultMap({ series, row, truth, frameKey, onPick }: ResultMapProps) {
  const points = useMemo(() => series.intervals.flatMap(({ position, status, seq }): TrackPoint[] =>
    position ? [{ at: { lon: position.longitudeDeg, lat: position.latitudeDeg }, state: lookState(status), seq }] : []), [series]);
  const frame = useMemo(() => points.map(({ at }) => at), [points]);
  const theme = isDark();
  const layers = useMemo(() => {
    const list: Layer[] = [track(points, { color: theme ? "#3d5566" : "#b4c6d0", width: 1 }, true)];
    if (truth) list.push(truthLayer(truth, series.intervals.map(({ time }) => ({ unix: unixS(time) }))));
    if (row && Number.isFinite(row.latDeg)) {
      const known = (value: number) => (Number.isFinite(value) ? value : 0);
      const covariance = { ee: known(row.sigmaEastM) ** 2, en: known(row.eastNorthM2), nn: known(row.sigmaNorthM) ** 2 };
      const protection = Number.isFinite(row.horizontalProtectionM) ? row.horizontalProtectionM : null;
      list.push(chosenEpoch({ lon: row.lonDeg, lat: row.latDeg }, lookState(row.status), covariance, protection));
    }
    return list;
  }, [points, row, truth, theme]);
  const states = [...new Set(points.map(({ state }) => state))];
  return (
    <section class="card map-card job-map" aria-label="Track">
      <div class="card-head"><h2>Track</h2><span class="small">Click a point for its epoch</span></div>
      <Map2d label="Map of the track" layers={layers} frame={frame} frameKey={frameKey} smallestM={2} anchor={points[0]?.at} calmWheel onPick={(picked) => { if (picked) onPick(Number(picked)); }} />
      <p class="map-legend">
        {states.map((state) => <span key={state}><Symbol state={state} size={11} />{LOOKS[state].name}</span>)}
        <TruthLegend truth={truth} />
        {row && Number.isFinite(row.sigmaEastM) && <span><i class="oval" />95 % error ellipse</span>}
      </p>
    </section>
  );
}

function Chosen({ row, number, onClose }: { row: Row; number: number; onClose: () => void }) {
  const known = (value: number, text: (value: number) => string) => (Number.isFinite(value) ? text(value) : "–");
  return (
    <section class="card" aria-label={`Position ${number}`}>
      <div class="card-head"><h2>Position {count(number)}</h2><button type="button" class="quiet" onClick={onClose}>Close</button></div>
      <dl class="figures">
        <Figure name="Status" value={<Badge state={lookState(row.status)} />} />
        <Figure name="Time (UTC)" value={utc(row.unix)} />
        <Figure name="Satellites" value={known(row.satellites, String)} />
        <Figure name="σ horizontal" value={length(horizontalSigma(row))} />
        <Figure name="σ vertical" value={length(row.sigmaUpM)} />
        {Number.isFinite(row.ratio) && <Figure name="Ratio" value={row.ratio.toFixed(1)} />}
        {Number.isFinite(row.ageS) && <Figure name="Age of base" value={duration(row.ageS)} />}
        <Figure name="Latitude, longitude" value={known(row.latDeg, () => `${row.latDeg.toFixed(8)}°, ${row.lonDeg.toFixed(8)}°`)} />
        <Figure name="Height" value={known(row.heightM, (m) => `${m.toFixed(3)} m`)} hint="above the ellipsoid" />
      </dl>
    </section>
  );
}

/** The options of the job. */
function Request({ job }: { job: Job }) {
  const { options } = job;
  const overrides = Object.entries(options.overrides);
  return (
    <details class="card details" open={!hasEnded(job) || job.state === "FAILED"}>
      <summary><h2>Files and options</h2></summary>
      <div class="table-box" tabIndex={0} role="region" aria-label="Files">
        <table>
          <thead><tr><th scope="col">Part</th><th scope="col">File</th><th scope="col" class="number">Size</th><th scope="col">BLAKE3</th></tr></thead>
          <tbody>
            {job.inputs.map(({ part, name, bytes: size, hash, own }, i) => (
              <tr key={`${part}${i}`}><th scope="row">{part}</th><td>{name}{own && <span class="tag">added</span>}</td><td class="number">{bytes(size)}</td><td><code title={hash}>{hash.slice(0, 12)}</code></td></tr>
            ))}
          </tbody>
        </table>
      </div>
      <dl class="figures">
        <Figure name="Mode" value={options.mode} />
        <Figure name="Profile" value={options.profile} />
        <Figure name="Answers" value={answerOf(job)} />
        <Figure name="Format" value={options.format} />
        <Figure name="Arrived (UTC)" value={when(job.createdUtc)} />
        {job.startedUtc && <Figure name="Began (UTC)" value={when(job.startedUtc)} />}
        {job.endedUtc && <Figure name="Ended (UTC)" value={`${when(job.endedUtc)}, after ${ranFor(job)}`} />}
        {options.basePosition && <Figure name="Base (ECEF)" value={[options.basePosition.xM, options.basePosition.yM, options.basePosition.zM].map((m) => m.toFixed(4)).join(", ")} />}
        {overrides.map(([name, value]) => <Figure key={name} name={name} value={value} />)}
      </dl>
    </details>
  );
}

function draftOf({ options }: Job) {
  const { basePosition: base } = options;
  return {
    mode: options.mode,
    profile: options.profile,
    answer: options.batch ? ("batch" as const) : options.smoothed ? ("smoothed" as const) : ("causal" as const),
    format: options.format,
    baseFrom: base ? ("ecef" as const) : options.basePositionFromHeader ? ("header" as const) : ("any" as const),
    base: (base ? [base.xM, base.yM, base.zM].map(String) : ["", "", ""]) as [string, string, string],
    date: "",
    overrides: Object.entries(options.overrides).map(([name, value]) => `${name}=${value}`).join("\n"),
  };
}
