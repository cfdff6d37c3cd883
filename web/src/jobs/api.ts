/** The calls of batch jobs, and their answers. */
import {
  type Ecef, type GpsTime, Problem, type Refusal, SIGNED_OUT, answered, ask, change, csrfHeader, problemOf,
} from "../api";

export type JobState = "QUEUED" | "RUNNING" | "SUCCEEDED" | "FAILED" | "CANCELLED";
export type Part = "rover" | "navigation" | "base";

export interface JobOptions {
  mode: string;
  profile: string;
  overrides: Record<string, string>;
  smoothed: boolean;
  batch: boolean;
  basePosition?: Ecef | null;
  basePositionFromHeader: boolean;
  format: string;
  near?: GpsTime | null;
}
export interface JobInput {
  part: Part;
  name: string;
  hash: string;
  bytes: number;
  own: boolean;
}
export interface Job {
  job: string;
  state: JobState;
  options: JobOptions;
  inputs: JobInput[];
  createdUtc: string;
  startedUtc: string;
  endedUtc: string;
  expiresUtc: string;
  progress: {
    percent: number;
    epochs: number;
    answered: number;
    epochsPerSecond: number | null;
    remainingS: number | null;
  };
  resultBytes: number | null;
  failure: (Refusal & { field: string }) | null;
}
export interface JobCount {
  name: string;
  epochs: number;
  /** What to do about the reason; empty for a status. */
  remedy: string;
}
export interface JobReport {
  job: string;
  version: string;
  configurationHash: string;
  epochs: number;
  answered: number;
  seconds: number;
  statuses: JobCount[];
  reasons: JobCount[];
  provenance: string[];
  skipped: string[];
}

const path = encodeURIComponent;

export const hasEnded = ({ state }: Job): boolean => state !== "QUEUED" && state !== "RUNNING";

/** The newest jobs, at least `wanted` if there are so many; and whether there are more. */
export async function jobs(wanted: number, signal?: AbortSignal): Promise<{ jobs: Job[]; more: boolean }> {
  const all: Job[] = [];
  let token = "";
  do {
    const page = await ask<{ jobs: Job[]; nextPageToken: string }>(
      `/v1/jobs?pageSize=${Math.min(1000, wanted - all.length)}${token && `&pageToken=${path(token)}`}`,
      signal,
    );
    all.push(...page.jobs);
    token = page.nextPageToken;
  } while (token && all.length < wanted);
  return { jobs: all, more: token !== "" };
}

export const job = (id: string, signal?: AbortSignal) => ask<Job>(`/v1/jobs/${path(id)}`, signal);
export const report = (id: string, signal?: AbortSignal) => ask<JobReport>(`/v1/jobs/${path(id)}/report`, signal);
export const cancel = (id: string) => change<Job>("DELETE", `/v1/jobs/${path(id)}`);
export const remove = (id: string) => change<Job>("DELETE", `/v1/jobs/${path(id)}?purge=true`);
export const resultPath = (id: string): string => `/v1/jobs/${path(id)}/result`;
/** The report as a page that needs no other file. */
export const reportPagePath = (id: string): string => `/v1/jobs/${path(id)}/report?format=html`;
export const eventsPath = (id: string): string => `/v1/jobs/${path(id)}/events`;

export interface Sending {
  /** The job, or a `Problem`. */
  done: Promise<Job>;
  abort: () => void;
}

/** A new id for a request, so that repeating the request makes no second job. */
export function requestName(): string {
  const bytes = crypto.getRandomValues(new Uint8Array(16));
  return [...bytes].map((byte) => byte.toString(16).padStart(2, "0")).join("");
}

/**
 * Sends files and options as a job. `onProgress` gets the fraction of the bytes that are sent.
 * This is an XMLHttpRequest, because `fetch` does not report the progress of an upload.
 */
export function send(
  files: { part: Part; file: File }[],
  options: JobOptions,
  name: string,
  onProgress: (fraction: number) => void,
): Sending {
  const form = new FormData();
  form.append("options", JSON.stringify(options));
  files.forEach(({ part, file }) => form.append(part, file, file.name));
  const request = new XMLHttpRequest();
  const done = new Promise<Job>((resolve, reject) => {
    request.open("POST", "/v1/jobs");
    request.setRequestHeader("accept", "application/json");
    request.setRequestHeader("idempotency-key", name);
    Object.entries(csrfHeader()).forEach(([header, value]) => request.setRequestHeader(header, value));
    request.upload.onprogress = ({ loaded, total }) => onProgress(loaded / Math.max(1, total));
    request.onload = () => {
      try {
        resolve(answered<Job>(request.status, request.responseText, request.getResponseHeader("x-request-id")));
      } catch (error) {
        reject(problemOf(error));
      }
    };
    request.onabort = () => reject(new Problem("UPLOAD_CANCELLED", "the upload was cancelled", "start the job again"));
    request.onerror = () => {
      document.dispatchEvent(new Event(SIGNED_OUT)); // Asks who is signed in; perhaps nobody is any more.
      reject(new Problem(
        "UPLOAD_BROKEN",
        "the connection broke off, or a file was changed or removed, before all files had arrived",
        "check that the service runs and the files are there, and start the job again; what had arrived is no second job",
      ));
    };
    request.send(form);
  });
  return { done, abort: () => request.abort() };
}
