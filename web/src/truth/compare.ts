/**
 * Positions against a truth file: reading it, the errors, and their statistics. Nothing here asks
 * the service, so the file stays in the browser.
 *
 * Times and statistics are those of `graphfix evaluate`, with wider tolerances.
 */
import { PARSERS, type Row } from "../jobs/result";
import { gpsTime, recordedUnixS } from "../time";

type Vector = [number, number, number];

/** A true position of the antenna. */
export interface TruthRow {
  /** Seconds since 1970, UTC. */
  unix: number;
  /** ECEF (m). */
  at: Vector;
}

/** A position to judge. */
export interface Epoch {
  seq: number;
  unix: number;
  latDeg: number;
  lonDeg: number;
  heightM: number;
}

export interface EpochError {
  seq: number;
  unix: number;
  horizontalM: number;
  /** Positive above the truth. */
  verticalM: number;
}

export interface Statistics {
  epochs: number;
  meanM: number;
  p95M: number;
  maxM: number;
}

/** Largest difference of time to the nearest truth, where none can be interpolated (s). */
const TOLERANCE_S = 0.05;
/** Longest gap of the truth that is interpolated (s). */
const GAP_S = 2;
/** A line in a message is cut to this length. */
const QUOTED = 60;

/** Why a file cannot be read as a truth, with the wrong line. */
export class TruthError extends Error {}

const atFault = (number: number, line: string, why: string): TruthError =>
  new TruthError(`line ${number}: ${JSON.stringify(line.slice(0, QUOTED))} ${why}`);

/** Reads a truth file of any format, sorted by time. Week −1 stands for `unknownWeek`. */
export function readTruth(text: string, unknownWeek: number): TruthRow[] {
  const lines = text.replace(/^\ufeff/, "").split(/\r?\n/);
  const format = formatOf(lines);
  const rows = format === "csv" ? readCsv(lines, unknownWeek) : readAs(format, lines);
  if (rows.length === 0) throw new TruthError("it has no line with a position");
  return inOrder(rows);
}

/** The format of a file, by its first line that is no comment. */
function formatOf(lines: string[]): string {
  const first = lines.find((line) => line.trim() !== "" && !/^[#%]/.test(line)) ?? "";
  if (first.startsWith("{")) return "geojson";
  if (first.startsWith("$")) return "nmea";
  if (first.startsWith("<")) return lines.slice(0, 20).some((line) => line.includes("<gpx")) ? "gpx" : "kml";
  return /[,;]/.test(first) ? "csv" : "pos";
}

/** Reads a format of results. */
function readAs(format: string, lines: string[]): TruthRow[] {
  const parse = PARSERS[format]("SINGLE");
  return lines.flatMap((line, i) => {
    const row = line === "" ? undefined : parsed(parse, line, i + 1);
    if (!row && format === "pos" && line.trim() !== "" && !line.startsWith("%")) {
      throw atFault(i + 1, line, "is not week, seconds of week, latitude, longitude and height");
    }
    if (!row || !Number.isFinite(row.latDeg)) return [];
    if (![row.unix, row.lonDeg, row.heightM].every(Number.isFinite)) throw atFault(i + 1, line, "has no time or no position");
    return [{ unix: row.unix, at: ecef(row.latDeg, row.lonDeg, row.heightM) }];
  });
}

function parsed(parse: (line: string) => Row | undefined, line: string, number: number): Row | undefined {
  try {
    return parse(line);
  } catch {
    throw atFault(number, line, "cannot be read");
  }
}

/** The columns of a CSV that have week, seconds of week and the three coordinates. */
interface Columns {
  places: number[];
  /** Whether coordinates are ECEF: from the title, or undefined until the first row is read. */
  isEcef?: boolean;
  /** Whether rows without a position are allowed, as in a file of solutions. */
  mayBeEmpty: boolean;
}

/** The columns of a file without a title, and of one that `graphfix simulate` has written. */
const PLAIN: Columns = { places: [0, 1, 2, 3, 4], mayBeEmpty: false };
/** Coordinates above this are metres, not degrees. */
const LARGEST_ANGLE = 1000;
const LARGEST_WEEK = 9999;

function readCsv(lines: string[], unknownWeek: number): TruthRow[] {
  let columns: Columns | undefined;
  const rows: TruthRow[] = [];
  lines.forEach((line, i) => {
    if (line.trim() === "" || /^[#%]/.test(line)) return;
    // Quoted reasons may have commas, so they are removed. No column that is read is quoted.
    const fields = line.replace(/"[^"]*"/g, "").split(/[,;]/).map((field) => field.trim());
    const isTitle = !columns && fields.some((field) => /^[a-z]/i.test(field));
    if (isTitle) columns = columnsOf(fields);
    columns ??= { ...PLAIN };
    const row = isTitle ? undefined : csvRow(fields, columns, unknownWeek, (why) => atFault(i + 1, line, why));
    if (row) rows.push(row);
  });
  return rows;
}

/** The columns that a title names. Files of solutions have column names of their own. */
function columnsOf(titles: string[]): Columns {
  const low = titles.map((title) => title.toLowerCase());
  const named = ["gps_week", "tow_s", "latitude_deg", "longitude_deg", "height_m"].map((name) => low.indexOf(name));
  if (named.every((place) => 0 <= place)) return { places: named, isEcef: false, mayBeEmpty: true };
  const isEcef = low.some((name) => ["x", "x_m", "ecef_x", "x_ecef"].includes(name));
  const isGeodetic = low.some((name) => name.startsWith("lat"));
  return { ...PLAIN, isEcef: isEcef || (isGeodetic ? false : undefined) };
}

function csvRow(fields: string[], columns: Columns, unknownWeek: number, fault: (why: string) => TruthError): TruthRow | undefined {
  const texts = columns.places.map((place) => fields[place] ?? "");
  if (columns.mayBeEmpty && texts.slice(2).every((text) => text === "")) return undefined;
  const values = texts.map((text) => (text === "" ? NaN : Number(text)));
  if (!values.every(Number.isFinite)) throw fault("does not have five numbers: week, seconds of week, and three coordinates");
  const [week, tow, a, b, c] = values;
  if (LARGEST_WEEK < Math.abs(week)) throw fault("does not begin with a GPS week; use -1 if it is unknown");
  columns.isEcef ??= LARGEST_ANGLE < Math.abs(a);
  if (!columns.isEcef && (90 < Math.abs(a) || 360 < Math.abs(b))) throw fault("has no latitude and longitude in degrees");
  return { unix: recordedUnixS(week < 0 ? unknownWeek : week, tow), at: columns.isEcef ? [a, b, c] : ecef(a, b, c) };
}

/** Rows sorted by time. Of rows with one time the last counts, because a revision comes later. */
function inOrder(rows: TruthRow[]): TruthRow[] {
  const byTime = new Map(rows.map((row) => [Math.round(row.unix * 1000), row]));
  return [...byTime.values()].sort((a, b) => a.unix - b.unix);
}

/** The first row at this time or later. */
function indexAt(truth: TruthRow[], unix: number): number {
  let [low, high] = [0, truth.length];
  while (low < high) {
    const middle = (low + high) >> 1;
    if (truth[middle].unix < unix) low = middle + 1;
    else high = middle;
  }
  return low;
}

/** The true position at a time: interpolated between two rows, or that of the nearest row. */
export function truthAt(truth: TruthRow[], unix: number): Vector | undefined {
  const next = indexAt(truth, unix);
  const [before, after] = [truth[next - 1], truth[next]];
  if (before && after && after.unix - before.unix <= GAP_S) {
    const part = (unix - before.unix) / (after.unix - before.unix);
    return before.at.map((value, i) => value + part * (after.at[i] - value)) as Vector;
  }
  const distance = (row: TruthRow | undefined) => (row ? Math.abs(row.unix - unix) : Infinity);
  const nearest = distance(before) < distance(after) ? before : after;
  return distance(nearest) <= TOLERANCE_S ? nearest.at : undefined;
}

/** The errors of the epochs that have a truth. */
export function errorsOf(epochs: Epoch[], truth: TruthRow[]): EpochError[] {
  return epochs.flatMap(({ seq, unix, latDeg, lonDeg, heightM }) => {
    const at = truthAt(truth, unix);
    if (!at) return [];
    const [x, y, z] = ecef(latDeg, lonDeg, heightM);
    const [east, north, up] = enu([x - at[0], y - at[1], z - at[2]], latDeg, lonDeg);
    return [{ seq, unix, horizontalM: Math.hypot(east, north), verticalM: up }];
  });
}

/** Statistics of the horizontal errors; undefined without errors. */
export function statisticsOf(errors: EpochError[]): Statistics | undefined {
  if (errors.length === 0) return undefined;
  const sorted = errors.map(({ horizontalM }) => horizontalM).sort((a, b) => a - b);
  const meanM = sorted.reduce((sum, value) => sum + value, 0) / sorted.length;
  return { epochs: sorted.length, meanM, p95M: percentile(sorted, 95), maxM: sorted[sorted.length - 1] };
}

/** The quantile by linear interpolation: definition 7 of Hyndman & Fan (1996). */
function percentile(sorted: number[], percent: number): number {
  const rank = (percent / 100) * (sorted.length - 1);
  const below = Math.floor(rank);
  const above = Math.min(below + 1, sorted.length - 1);
  return sorted[below] + (sorted[above] - sorted[below]) * (rank - below);
}

/** Neighbouring errors in groups, so that a chart has at most `points` groups. */
export function grouped<T>(all: T[], points: number): T[][] {
  const size = Math.max(1, Math.ceil(all.length / points));
  return Array.from({ length: Math.ceil(all.length / size) }, (_, i) => all.slice(i * size, (i + 1) * size));
}

/** The rows of a span of time, thinned to at most `points`. */
export function trackOf(truth: TruthRow[], from: number, to: number, points: number): TruthRow[] {
  const inside = truth.slice(indexAt(truth, from), indexAt(truth, to + TOLERANCE_S));
  return grouped(inside, points).map((group) => group[0]);
}

/** The GPS week of a time, for truth files without a week. */
export const weekOf = (unix: number): number => gpsTime(unix).week;

const RAD = Math.PI / 180;
/** WGS 84: semi-major axis (m), and first eccentricity squared. */
const AXIS_M = 6_378_137;
const E2 = 6.694_379_990_141_316e-3;

function ecef(latDeg: number, lonDeg: number, heightM: number): Vector {
  const [lat, lon] = [latDeg * RAD, lonDeg * RAD];
  const n = AXIS_M / Math.sqrt(1 - E2 * Math.sin(lat) ** 2);
  const r = (n + heightM) * Math.cos(lat);
  return [r * Math.cos(lon), r * Math.sin(lon), (n * (1 - E2) + heightM) * Math.sin(lat)];
}

/** A difference of ECEF positions as east, north and up. */
function enu([x, y, z]: Vector, latDeg: number, lonDeg: number): Vector {
  const [lat, lon] = [latDeg * RAD, lonDeg * RAD];
  const out = Math.cos(lon) * x + Math.sin(lon) * y;
  return [Math.cos(lon) * y - Math.sin(lon) * x, Math.cos(lat) * z - Math.sin(lat) * out, Math.cos(lat) * out + Math.sin(lat) * z];
}

/** Longitude and latitude of an ECEF position (degrees), for maps. */
export function lonLatOf([x, y, z]: Vector): { lon: number; lat: number } {
  const p = Math.hypot(x, y);
  let lat = Math.atan2(z, p * (1 - E2));
  // Each iteration reduces the error about a hundredfold.
  for (let i = 0; i < 4; i += 1) {
    const n = AXIS_M / Math.sqrt(1 - E2 * Math.sin(lat) ** 2);
    lat = Math.atan2(z + E2 * n * Math.sin(lat), p);
  }
  return { lon: Math.atan2(y, x) / RAD, lat: lat / RAD };
}
