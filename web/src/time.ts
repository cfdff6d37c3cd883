/** Times, lengths and angles as people read them. */
import type { GpsTime } from "./api";

const WEEK_S = 604_800;
const GPS_EPOCH_UNIX_S = 315_964_800;

/** Seconds between GPS time and UTC, from an answer that gives both. */
let leapSeconds = 18;

/** Learns the leap seconds from a time that the service gives in both scales. */
export function learnLeapSeconds(time: GpsTime, utc: string): void {
  const difference = gpsUnixS(time) - Date.parse(utc) / 1000;
  if (Number.isFinite(difference)) leapSeconds = Math.round(difference);
}

/** Leap seconds and the time from which they hold (s since 1970, UTC), the newest first. */
const LEAPS = [[1_483_228_800, 18], [1_435_708_800, 17], [1_341_100_800, 16], [1_230_768_000, 15], [1_136_073_600, 14]];


const gpsUnixS = (time: GpsTime): number =>
  GPS_EPOCH_UNIX_S + time.week * WEEK_S + time.nsOfWeek / 1e9;

/** Week and seconds of week of a recording as seconds since 1970, UTC, with the leap seconds of then. */
export function recordedUnixS(week: number, seconds: number): number {
  const gps = GPS_EPOCH_UNIX_S + week * WEEK_S + seconds;
  return gps - (LEAPS.find(([from]) => from <= gps)?.[1] ?? 13);
}

/** Seconds since 1970, UTC. */
export const unixS = (time: GpsTime): number => gpsUnixS(time) - leapSeconds;

/** A UTC time in seconds since 1970 as GPS time. */
export function gpsTime(unix: number): GpsTime {
  const total = unix + leapSeconds - GPS_EPOCH_UNIX_S;
  const week = Math.floor(total / WEEK_S);
  return { week, nsOfWeek: Math.round((total - week * WEEK_S) * 1e3) * 1e6 };
}

/** A duration in its largest fitting unit. */
export function duration(s: number): string {
  const a = Math.abs(s);
  if (a < 9.95) return `${s.toFixed(1)} s`;
  if (a < 120) return `${Math.round(s)} s`;
  if (a < 7200) return `${Math.round(s / 60)} min`;
  if (a < 172_800) return `${Math.round(s / 3600)} h`;
  return `${Math.round(s / 86_400)} d`;
}

/** How long ago something was; a device whose clock is ahead is now. */
export const ago = (s: number): string => (s < 1.5 ? "now" : `${duration(s)} ago`);

export function length(m: number | null | undefined): string {
  if (m === null || m === undefined || !Number.isFinite(m)) return "–";
  const a = Math.abs(m);
  if (a < 0.0995) return `${(m * 1000).toFixed(0)} mm`;
  if (a < 9.995) return `${m.toFixed(2)} m`;
  if (a < 999.5) return `${m.toFixed(1)} m`;
  if (a < 99_950) return `${(m / 1000).toFixed(2)} km`;
  return `${Math.round(m / 1000)} km`;
}

export const utc = (unix: number): string =>
  new Date(unix * 1000).toISOString().slice(0, 19).replace("T", " ");
export const clock = (unix: number): string => new Date(unix * 1000).toISOString().slice(11, 19);

export function count(n: number): string {
  return n.toLocaleString("en-GB").replace(/,/g, "\u202f");
}

export function bytes(n: number): string {
  const units = ["B", "kB", "MB", "GB", "TB"];
  let unit = 0;
  while (999.5 <= n && unit < units.length - 1) {
    n /= 1000;
    unit += 1;
  }
  return `${unit === 0 ? n : n.toFixed(1)} ${units[unit]}`;
}
