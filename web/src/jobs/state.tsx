/** The state of a job, in words and as a lamp. */
import { clock, count, duration, utc } from "../time";
import { type Health, Lamp } from "../ui";
import type { Job, JobState } from "./api";

const LOOKS: Record<JobState, { health: Health; words: string }> = {
  QUEUED: { health: "idle", words: "Waits" },
  RUNNING: { health: "busy", words: "Runs" },
  SUCCEEDED: { health: "good", words: "Succeeded" },
  FAILED: { health: "bad", words: "Failed" },
  CANCELLED: { health: "idle", words: "Cancelled" },
};

/** Whether a job has succeeded, and none of its epochs has a position. */
export const isWithoutPosition = ({ state, progress }: Job): boolean => state === "SUCCEEDED" && progress.answered === 0;

export function JobLamp({ job }: { job: Job }) {
  const { health, words } = LOOKS[job.state];
  if (isWithoutPosition(job)) return <Lamp health="warn" words={job.progress.epochs === 0 ? "No epoch" : "No position"} />;
  return <Lamp health={health} words={words} />;
}

/** How many epochs there are, and how many of them have a position. */
export function tallyOf({ progress: { epochs, answered } }: Job): string {
  if (epochs === 0) return "no epoch";
  const positioned = answered === 0 ? "none" : answered === epochs ? "all" : count(answered);
  return `${count(epochs)} ${epochs === 1 ? "epoch" : "epochs"}, ${positioned} with a position`;
}

/** What people call a job: the name of its rover's file. */
export const nameOf = ({ inputs, job }: Job): string => inputs.find(({ part }) => part === "rover")?.name || job.slice(0, 12);

export const answerOf = ({ options: { smoothed, batch } }: Job): string => (batch ? "batch" : smoothed ? "smoothed" : "causal");

/** An RFC 3339 time: of today as a clock, otherwise with its date, UTC. */
export function when(text: string): string {
  const unix = Date.parse(text) / 1000;
  return Math.abs(Date.now() / 1000 - unix) < 43_200 ? clock(unix) : utc(unix).slice(0, 16);
}

/** How long the run has taken, or takes so far. */
export function ranFor({ startedUtc, endedUtc }: Job): string {
  if (!startedUtc) return "–";
  const end = endedUtc ? Date.parse(endedUtc) : Date.now();
  return runTime(Math.max(0, end - Date.parse(startedUtc)) / 1000);
}

/** The time of a run. */
export const runTime = (s: number): string => (s < 0.1 ? "less than 0.1 s" : duration(s));

export const left = (s: number | null): string => (s === null ? "" : s < 1 ? "nearly done" : `${duration(s)} left`);
