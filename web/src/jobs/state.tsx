/** The state of a job, in words and as a lamp. */
import { clock, duration, utc } from "../time";
import { type Health, Lamp } from "../ui";
import type { Job, JobState } from "./api";

const LOOKS: Record<JobState, { health: Health; words: string }> = {
  QUEUED: { health: "idle", words: "Waits" },
  RUNNING: { health: "busy", words: "Runs" },
  SUCCEEDED: { health: "good", words: "Succeeded" },
  FAILED: { health: "bad", words: "Failed" },
  CANCELLED: { health: "idle", words: "Cancelled" },
};

export function JobLamp({ state }: { state: JobState }) {
  const { health, words } = LOOKS[state];
  return <Lamp health={health} words={words} />;
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
  return duration(Math.max(0, end - Date.parse(startedUtc)) / 1000);
}

export const left = (s: number | null): string => (s === null ? "" : s < 1 ? "nearly done" : `${duration(s)} left`);
