/** Batch jobs: a new one from dropped files, and the list of all. */
import { useState } from "preact/hooks";
import { type Problem, problemOf } from "../api";
import { type Job, cancel, hasEnded, jobs, resultPath } from "../jobs/api";
import { Bar, NewJob } from "../jobs/new";
import { JobLamp, answerOf, left, nameOf, ranFor, tallyOf, when } from "../jobs/state";
import { useLive } from "../live";
import { useRight } from "../rights";
import { bytes, count } from "../time";
import { Copyable, Empty, Loading, ProblemBox } from "../ui";

/** Jobs that the list shows at first, and more at each request. */
const STEP = 50;

export function JobsPage() {
  const [wanted, setWanted] = useState(STEP);
  const mayOperate = useRight("operate");
  const live = useLive(`jobs:${wanted}`, (signal) => jobs(wanted, signal), ({ jobs }) => (jobs.every(hasEnded) ? 10_000 : 1500));
  const created = ({ job }: Job) => {
    location.hash = `#/jobs/${job}`;
  };
  const list = live.value?.jobs;
  return (
    <div class="page jobs">
      <h1>Jobs</h1>
      <p class="lead">Files of a recording, positioned by the service in the background as <code>graphfix solve</code> would.</p>
      {mayOperate
        ? <NewJob onCreated={created} />
        : <p class="note">Your key shows jobs. To start one, sign in with a key that has the right <code>operate</code>.</p>}
      {live.problem && <ProblemBox problem={live.problem} what={list ? "The list is not up to date" : "The jobs cannot be loaded"} />}
      {!list && !live.problem && <Loading what="the jobs" />}
      {list?.length === 0 && <NoJobs />}
      {list && list.length > 0 && (
        <section aria-label="All jobs">
          <ul class="job-list">{list.map((job) => <JobRow key={job.job} job={job} mayOperate={mayOperate} />)}</ul>
          {live.value?.more && <p><button type="button" class="quiet" onClick={() => setWanted(wanted + STEP)}>Show more</button></p>}
        </section>
      )}
    </div>
  );
}

function JobRow({ job, mayOperate }: { job: Job; mayOperate: boolean }) {
  const { percent, epochs, epochsPerSecond, remainingS } = job.progress;
  const result = `${job.options.format}${job.resultBytes === null ? "" : `, ${bytes(job.resultBytes)}`}`;
  return (
    <li class="card job-row">
      <JobLamp job={job} />
      <div class="job-what">
        <a href={`#/jobs/${job.job}`}>{nameOf(job)}</a>
        <span class="small">{job.options.mode} · {answerOf(job)} · {job.options.format} · {when(job.createdUtc)}</span>
      </div>
      <div class="job-how small">
        {job.state === "RUNNING" && <Bar percent={percent} label={`Progress of ${nameOf(job)}`} />}
        {job.state === "QUEUED" && "waits for the jobs before it"}
        {job.state === "RUNNING" && <span>{percent.toFixed(0)} % · {count(epochs)} epochs{epochsPerSecond !== null && ` · ${count(Math.round(epochsPerSecond))}/s`} {remainingS !== null && `· ${left(remainingS)}`}</span>}
        {job.state === "SUCCEEDED" && <span>{tallyOf(job)}, in {ranFor(job)}</span>}
        {job.state === "FAILED" && <span class="break"><code>{job.failure?.code}</code> {job.failure?.message}</span>}
      </div>
      <div class="job-acts">
        {job.state === "SUCCEEDED" && <a class="quiet" href={resultPath(job.job)} download aria-label={`${result}: result of ${nameOf(job)}`}>{result}</a>}
        {!hasEnded(job) && mayOperate && <CancelJob job={job} />}
      </div>
    </li>
  );
}

/** Cancels a job; the list or the events then show it. */
export function CancelJob({ job, onCancelled }: { job: Job; onCancelled?: (job: Job) => void }) {
  const [problem, setProblem] = useState<Problem>();
  const [busy, setBusy] = useState(false);
  const act = async () => {
    if (busy) return;
    setBusy(true);
    try {
      const cancelled = await cancel(job.job);
      onCancelled?.(cancelled);
    } catch (error) {
      setProblem(problemOf(error));
    }
    setBusy(false);
  };
  const words = busy ? "Cancelling …" : "Cancel";
  return (
    <>
      <button type="button" class="quiet" aria-disabled={busy} onClick={act} aria-label={`${words} ${nameOf(job)}`}>{words}</button>
      {problem && <ProblemBox problem={problem} what="The job was not cancelled" />}
    </>
  );
}

function NoJobs() {
  const { origin } = location;
  return (
    <Empty title="No job yet">
      <p>Drop the files of a recording above, or send them from a script:</p>
      <Copyable label="A job by curl" text={`curl ${origin}/v1/jobs -F rover=@rover.obs \\\n  -F navigation=@navigation.rnx -F base=@base.obs \\\n  -F 'options={"mode": "rtk-fgo", "smoothed": true}'`} />
      <p>Without a recording at hand, simulate one:</p>
      <Copyable label="A simulated recording" text="graphfix simulate --scenario rtk-open --seed 1 --output rtk" />
    </Empty>
  );
}
