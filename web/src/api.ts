/** The calls of the service that the dashboard uses, and their answers. */

export interface GpsTime {
  week: number;
  nsOfWeek: number;
}
export interface Geodetic {
  latitudeDeg: number;
  longitudeDeg: number;
  heightM: number;
}
export interface Ecef {
  xM: number;
  yM: number;
  zM: number;
}
export type StatusName = "NONE" | "SINGLE" | "FGO" | "EKF" | "FLOAT" | "FIXED" | "UNSPECIFIED";

export interface Head {
  session: string;
  label: string;
  mode: string;
  createdUtc: string;
  closed: boolean;
  lastSeq: number | null;
  lastTime: GpsTime | null;
  ageS: number | null;
  status: StatusName;
  position: Geodetic | null;
}
export interface Option {
  name: string;
  unit: string;
  value: string;
  default: string;
  meaning: string;
  allowed: string;
}
export interface Session {
  session: string;
  label: string;
  mode: string;
  profile: string;
  overrides: Record<string, string>;
  configuration: Option[];
  createdUtc: string;
  closed: boolean;
  durableThrough: number | null;
  base: string;
  bases: string[];
  antenna: string;
  retentionDays: number;
}
export interface Reason {
  code: string;
  message: string;
  remedy: string;
  values: Record<string, unknown>;
}
export interface Covariance {
  firstFirst: number;
  firstSecond: number;
  firstThird: number;
  secondSecond: number;
  secondThird: number;
  thirdThird: number;
}
export interface Solution {
  seq: number;
  revision: number;
  time: GpsTime;
  timeUtc: string;
  status: StatusName;
  position: { ecef: Ecef; geodetic: Geodetic; covarianceEnuM2: Covariance } | null;
  velocity: { eastMS: number; northMS: number; upMS: number } | null;
  dops: { gdop: number; pdop: number; hdop: number; vdop: number } | null;
  satellitesUsed: string[];
  reasons: Reason[];
  provenance: { version: string; configurationHash: string; base: { base: string } | null };
  relative: {
    lengthM: number;
    ageS: number;
    ambiguities: number;
    fixedAmbiguities: number;
    ratio: number | null;
    successRate: number | null;
    fixProbability: number | null;
  } | null;
  horizontalProtectionM: number | null;
  verticalProtectionM: number | null;
}
export interface Range {
  min: number;
  max: number;
  last: number;
}
export interface Interval {
  index: number;
  solutions: number;
  seq: number;
  time: GpsTime;
  timeUtc: string;
  status: StatusName;
  worstStatus: StatusName;
  bestStatus: StatusName;
  position: Geodetic | null;
  satellites: Range | null;
  heightM: Range | null;
  horizontalSigmaM: Range | null;
  verticalSigmaM: Range | null;
  horizontalProtectionM: Range | null;
  verticalProtectionM: Range | null;
  ageS: Range | null;
  ratio: Range | null;
}
export interface SeriesReason {
  code: string;
  remedy: string;
  solutions: number;
}
export interface Series {
  from: GpsTime | null;
  to: GpsTime | null;
  intervalLengthS: number;
  intervals: Interval[];
  solutions: number;
  reasons: SeriesReason[];
  statuses: { status: StatusName; solutions: number }[];
  nextPageToken: string;
}
export type Role = "USED" | "EXCLUDED" | "NO_EPHEMERIS" | "BELOW_MASK" | "SWITCHED_OFF" | "UNUSED";
export interface SatelliteView {
  satellite: string;
  role: Role;
  azimuthDeg: number | null;
  elevationDeg: number | null;
  residualM: number | null;
  sigmaM: number | null;
  slipped: boolean;
  halfCycle: boolean;
  signals: { code: string; cn0DbHz: number | null; carrierPhase: boolean }[];
}
export interface Explained {
  solutions: Solution[];
  satellites: SatelliteView[];
}
export interface Refusal {
  code: string;
  message: string;
  remedy: string;
}
export interface Feed {
  caster: string;
  mountpoint: string;
  state: string;
  sinceUtc: string;
  retryInS: number | null;
  problem: Refusal | null;
  refusal: Refusal | null;
  attempts: number;
  connections: number;
  bytes: number;
  silentS: number | null;
  epochs: number;
}
export interface Base {
  base: string;
  label: string;
  createdUtc: string;
  site: { antennaReferencePoint: Ecef; antenna: string; source: string } | null;
  epochs: number;
  lastTime: GpsTime | null;
  lastStoredUtc: string;
  ageS: number | null;
  satellites: number;
  positionCheck: { epochs: number; distanceM: number | null; verdict: string };
  feed: Feed | null;
  archive: {
    template: string;
    state: string;
    sinceUtc: string;
    retryInS: number | null;
    problem: Refusal | null;
    refusal: Refusal | null;
    missing: number;
    files: number;
    lastFile: string;
  } | null;
}
export interface Network {
  caster: string;
  state: string;
  sinceUtc: string;
  retryInS: number | null;
  problem: Refusal | null;
  refusal: Refusal | null;
  lastUtc: string;
  listed: number;
  usable: number;
  connected: number;
}
export interface NavigationStatus {
  satellites: {
    satellite: string;
    ephemerides: number;
    coveredFrom: GpsTime | null;
    coveredUntil: GpsTime | null;
    source: string;
  }[];
  ephemerides: number;
  ionosphereModels: string[];
  sources: {
    name: string;
    kind: string;
    state: string;
    sinceUtc: string;
    retryInS: number | null;
    problem: Refusal | null;
    ephemerides: number;
    lastUtc: string;
  }[];
}
export interface Readiness {
  node: string;
  ready: boolean;
  problems: string[];
  draining: boolean;
}

/** A refusal of the service, or a failure to reach it. */
export class Problem extends Error {
  constructor(
    readonly code: string,
    readonly detail: string,
    readonly remedy: string,
    readonly field = "",
    readonly requestId = "",
  ) {
    super(`${code}: ${detail}`);
  }
}

const UNREACHABLE = new Problem(
  "SERVICE_UNREACHABLE",
  "the service does not answer",
  "check that graphfix is running; this page tries again by itself",
);

/** The answer of a call as JSON; throws a `Problem`. */
export async function ask<T>(path: string, signal?: AbortSignal, init: RequestInit = {}): Promise<T> {
  let response: Response;
  try {
    const headers = { accept: "application/json", ...init.headers };
    response = await fetch(path, { ...init, signal, headers, credentials: "same-origin" });
  } catch (error) {
    if (signal?.aborted) throw error;
    throw UNREACHABLE;
  }
  const text = await response.text();
  return answered<T>(response.status, text, response.headers.get("x-request-id"));
}

/** The body of an answer as JSON; throws the `Problem` of a refusal. */
export function answered<T>(status: number, text: string, requestId: string | null): T {
  let body: unknown;
  try {
    body = JSON.parse(text);
  } catch {
    body = {};
  }
  if (200 <= status && status < 300) return body as T;
  if (status === 401) document.dispatchEvent(new Event(SIGNED_OUT));
  const { code, detail, remedy, field } = body as Record<string, string>;
  throw new Problem(
    code ?? `HTTP_${status}`,
    detail ?? `the service answered ${status}`,
    remedy ?? "try again; if it persists, look into the log of the service",
    field ?? "",
    requestId ?? "",
  );
}

/** Whatever was thrown, as a `Problem`. */
export const problemOf = (error: unknown): Problem =>
  error instanceof Problem ? error : new Problem("PAGE_FAILED", String(error), "reload the page, and report this");

/** The answer of a call that changes something. */
export const change = <T>(method: "POST" | "PUT" | "DELETE", path: string, body?: unknown): Promise<T> =>
  ask<T>(path, undefined, {
    method,
    headers: { ...csrfHeader(), ...(body === undefined ? {} : { "content-type": "application/json" }) },
    body: body === undefined ? undefined : JSON.stringify(body),
  });

/** Whether the service can do its work; an answer 503 is one, too. */
export async function readiness(signal?: AbortSignal): Promise<Readiness> {
  let response: Response;
  try {
    response = await fetch("/readyz", { signal });
  } catch (error) {
    if (signal?.aborted) throw error;
    throw UNREACHABLE;
  }
  try {
    return (await response.json()) as Readiness;
  } catch {
    throw UNREACHABLE; // An answer of something else, such as a proxy.
  }
}

/** Event: a call was refused because nobody is signed in, or no longer. */
export const SIGNED_OUT = "graphfix:signed-out";

/** Whether this browser is signed in, and whether it needs to be. */
export interface SignInState {
  needed: boolean;
  key?: string;
  rights: string[];
  csrfToken?: string;
  expiresUtc?: string;
}

/** The token that a change needs beside the cookie. Without the cookie it is worth nothing. */
let csrfToken = "";

/** The header of a change in a browser that is signed in by a cookie. */
export const csrfHeader = (): Record<string, string> => (csrfToken ? { "x-graphfix-csrf": csrfToken } : {});

function noted(state: SignInState): SignInState {
  csrfToken = state.csrfToken ?? "";
  return state;
}

export const signInState = async (signal?: AbortSignal) => noted(await ask<SignInState>("/v1/sign-in", signal));

/** Exchanges a key for a cookie that scripts cannot read. */
export const signIn = async (key: string) =>
  noted(
    await ask<SignInState>("/v1/sign-in", undefined, {
      method: "POST",
      headers: { authorization: `Bearer ${key}` },
    }),
  );

export const signOut = async () => noted(await change<SignInState>("DELETE", "/v1/sign-in"));

const path = encodeURIComponent;

/** All items of a list, page by page; `name` is the field that has them. */
export async function all<T>(list: string, name: string, pageSize: number, signal?: AbortSignal): Promise<T[]> {
  const items: T[] = [];
  let token = "";
  do {
    const page = await ask<Record<string, unknown>>(`${list}?pageSize=${pageSize}${token && `&pageToken=${path(token)}`}`, signal);
    items.push(...(page[name] as T[]));
    token = page.nextPageToken as string;
  } while (token);
  return items;
}

export const heads = (signal?: AbortSignal) => all<Head>("/v1/sessions:heads", "heads", 5000, signal);

export const session = (id: string, signal?: AbortSignal) =>
  ask<Session>(`/v1/sessions/${path(id)}`, signal);
export const closeSession = (id: string) => change<Session>("DELETE", `/v1/sessions/${path(id)}`);
export const deleteSession = (id: string) => change<Session>("DELETE", `/v1/sessions/${path(id)}?purge=true`);

export const explain = (id: string, seq: number | null, signal?: AbortSignal) =>
  ask<Explained>(`/v1/sessions/${path(id)}/epochs/${seq ?? "last"}`, signal);

export interface SeriesRequest {
  from?: string;
  to?: string;
  points: number;
  revisions: "first" | "last";
}

/** The residuals of an epoch's used satellites, each less the median of its constellation. */
export interface ResidualPoint {
  seq: number;
  time: GpsTime;
  timeUtc: string;
  satellites: number;
  /** Null where too few satellites have a residual. */
  rmsM: number | null;
  largestM: number | null;
  /** Empty if no satellite has a residual. */
  largestSatellite: string;
}

/** Epochs of a span, evenly spaced by number. */
export async function residuals(
  id: string,
  request: { from?: string; to?: string; points: number },
  signal?: AbortSignal,
): Promise<ResidualPoint[]> {
  const { points, ...bounds } = request;
  const query = new URLSearchParams({ points: String(points), ...bounds });
  const answer = await ask<{ points: ResidualPoint[] }>(`/v1/sessions/${path(id)}/solutions:residuals?${query}`, signal);
  return answer.points;
}

/** All pages of a series as one; pages that split an interval are joined. */
export async function series(
  id: string,
  request: SeriesRequest,
  signal?: AbortSignal,
): Promise<Series> {
  const query = new URLSearchParams({
    points: String(request.points),
    revisions: request.revisions,
    ...(request.from ? { from: request.from } : {}),
    ...(request.to ? { to: request.to } : {}),
  });
  let whole: Series | undefined;
  for (;;) {
    const page = await ask<Series>(`/v1/sessions/${path(id)}/solutions:series?${query}`, signal);
    whole = whole ? joined(whole, page) : page;
    if (!page.nextPageToken) return whole;
    query.set("pageToken", page.nextPageToken);
    // The span of the first page for all pages: an epoch that arrives meanwhile moves no interval.
    if (page.from) query.set("from", gpsText(page.from));
    if (page.to) query.set("to", gpsText(page.to));
  }
}

/** A time as the query parameters take it. */
export function gpsText(time: GpsTime): string {
  const whole = Math.floor(time.nsOfWeek / 1e9);
  const rest = String(time.nsOfWeek % 1e9).padStart(9, "0");
  return `${time.week}:${whole}.${rest}`;
}

function joined(before: Series, page: Series): Series {
  const intervals = [...before.intervals];
  const [first, ...others] = page.intervals;
  const last = intervals.at(-1);
  if (first && last && last.index === first.index) {
    intervals[intervals.length - 1] = { ...first, solutions: last.solutions + first.solutions };
    for (const name of RANGES) {
      const [a, b] = [last[name], first[name]];
      const range = a && b
        ? { min: Math.min(a.min, b.min), max: Math.max(a.max, b.max), last: b.last }
        : (b ?? a);
      intervals[intervals.length - 1][name] = range;
    }
  } else if (first) {
    intervals.push(first);
  }
  intervals.push(...others);
  const reasons = new Map(before.reasons.map((reason) => [reason.code, { ...reason }]));
  for (const reason of page.reasons) {
    const known = reasons.get(reason.code);
    if (known) known.solutions += reason.solutions;
    else reasons.set(reason.code, reason);
  }
  const sorted = [...reasons.values()].sort((a, b) => b.solutions - a.solutions);
  const statuses = new Map(before.statuses.map(({ status, solutions }) => [status, solutions]));
  for (const { status, solutions } of page.statuses) {
    statuses.set(status, (statuses.get(status) ?? 0) + solutions);
  }
  const byStatus = [...statuses].map(([status, solutions]) => ({ status, solutions }));
  return { ...page, statuses: byStatus, intervals, solutions: before.solutions + page.solutions, reasons: sorted };
}

const RANGES = [
  "satellites",
  "heightM",
  "horizontalSigmaM",
  "verticalSigmaM",
  "horizontalProtectionM",
  "verticalProtectionM",
  "ageS",
  "ratio",
] as const;

export async function bases(signal?: AbortSignal): Promise<{ bases: Base[]; networks: Network[] }> {
  const all: Base[] = [];
  let networks: Network[] = [];
  let token = "";
  do {
    const page = await ask<{ bases: Base[]; networks: Network[]; nextPageToken: string }>(
      `/v1/bases?pageSize=1000${token && `&pageToken=${path(token)}`}`,
      signal,
    );
    all.push(...page.bases);
    networks = page.networks;
    token = page.nextPageToken;
  } while (token);
  return { bases: all, networks };
}

export const navigation = (signal?: AbortSignal) => ask<NavigationStatus>("/v1/navigation", signal);
