/** The calls of the history, and their answers. */
import { type Geodetic, type GpsTime, type Interval, type Range, type StatusName, ask, gpsText } from "../api";
import { gpsTime } from "../time";

export interface StatusCount {
  status: StatusName;
  solutions: number;
}
export interface FleetInterval {
  index: number;
  sessions: number;
  statuses: StatusCount[];
  horizontalSigmaMeanM: number | null;
  satellitesMean: number | null;
  ageMeanS: number | null;
}
export interface FleetHistory {
  from: GpsTime;
  to: GpsTime;
  intervalLengthS: number;
  statuses: StatusCount[];
  intervals: FleetInterval[];
}
export interface SessionSummary {
  session: string;
  label: string;
  mode: string;
  closed: boolean;
  firstTime: GpsTime;
  lastTime: GpsTime;
  solutions: number;
  statuses: StatusCount[];
  horizontalSigmaMaxM: number | null;
  horizontalSigmaMeanM: number | null;
  satellitesMean: number | null;
  ageMeanS: number | null;
}
interface HistoryInterval {
  index: number;
  solutions: number;
  firstTime: GpsTime;
  seq: number;
  status: StatusName;
  worstStatus: StatusName;
  bestStatus: StatusName;
  position: Geodetic | null;
  heightM: Range | null;
  horizontalSigmaM: Range | null;
  satellites: Range | null;
  ageS: Range | null;
}
export interface SessionHistory {
  from: GpsTime | null;
  to: GpsTime | null;
  intervalLengthS: number;
  rollupLengthS: number;
  solutions: number;
  statuses: StatusCount[];
  intervals: Interval[];
}

export type Span = "day" | "week" | "month";
export const SPANS: { value: Span; name: string; days: number; points: number }[] = [
  { value: "day", name: "Day", days: 1, points: 25 },
  { value: "week", name: "Week", days: 7, points: 57 },
  { value: "month", name: "30 days", days: 30, points: 121 },
];

/** Begin and end of a span that ends now, as query parameters. */
function asked(span: Span, points?: number): URLSearchParams {
  const now = Date.now() / 1000;
  const days = SPANS.find(({ value }) => value === span)?.days ?? 1;
  const query = new URLSearchParams({ from: gpsText(gpsTime(now - 86_400 * days)), to: gpsText(gpsTime(now)) });
  if (points) query.set("points", String(points));
  return query;
}

export const fleetHistory = (span: Span, signal?: AbortSignal) =>
  ask<FleetHistory>(`/v1/history/fleet?${asked(span, SPANS.find(({ value }) => value === span)?.points)}`, signal);

/** Most requests for one list. It may have too few sessions then: most have no history. */
const REQUESTS = 20;

/** Sessions, at least as many as wanted if there are so many; and whether there may be more. */
export async function sessionHistories(span: Span, wanted: number, signal?: AbortSignal): Promise<{ sessions: SessionSummary[]; more: boolean }> {
  const query = asked(span);
  query.set("pageSize", "500");
  const sessions: SessionSummary[] = [];
  for (let request = 0; request < REQUESTS; request += 1) {
    const page = await ask<{ sessions: SessionSummary[]; nextPageToken: string }>(`/v1/history/sessions?${query}`, signal);
    sessions.push(...page.sessions);
    if (!page.nextPageToken || wanted < sessions.length) return { sessions: sessions.slice(0, wanted), more: wanted < sessions.length };
    query.set("pageToken", page.nextPageToken);
  }
  return { sessions, more: true };
}

/** The history of a session, as the intervals of a series. */
export async function sessionHistory(id: string, span: Span, signal?: AbortSignal): Promise<SessionHistory> {
  const answer = await ask<Omit<SessionHistory, "intervals"> & { intervals: HistoryInterval[] }>(
    `/v1/history/sessions/${encodeURIComponent(id)}?${asked(span, 1500)}`,
    signal,
  );
  const intervals = answer.intervals.map((interval) => ({
    ...interval,
    time: interval.firstTime,
    timeUtc: "",
    verticalSigmaM: null,
    horizontalProtectionM: null,
    verticalProtectionM: null,
    ratio: null,
  }));
  return { ...answer, intervals };
}
