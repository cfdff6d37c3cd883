/** The file of a job's positions, read line by line into columns, and thinned for maps and plots. */
import { type Interval, type Range, type StatusName, answered } from "../api";
import { RANK } from "../status";
import { gpsTime, recordedUnixS } from "../time";

/** One epoch of a result. A value that the format does not have is NaN. */
export interface Row {
  /** Seconds since 1970, UTC. */
  unix: number;
  status: StatusName;
  latDeg: number;
  lonDeg: number;
  heightM: number;
  satellites: number;
  sigmaEastM: number;
  sigmaNorthM: number;
  sigmaUpM: number;
  /** Covariance of east and north (m²). */
  eastNorthM2: number;
  ageS: number;
  ratio: number;
  horizontalProtectionM: number;
  verticalProtectionM: number;
}

const EMPTY: Row = {
  unix: NaN, status: "NONE", latDeg: NaN, lonDeg: NaN, heightM: NaN, satellites: NaN, sigmaEastM: NaN, sigmaNorthM: NaN,
  sigmaUpM: NaN, eastNorthM2: NaN, ageS: NaN, ratio: NaN, horizontalProtectionM: NaN, verticalProtectionM: NaN,
};

/** Reads a line; undefined if the line is no epoch. */
type Parser = (line: string) => Row | undefined;

const number = (text: string | undefined): number => (text === undefined || text === "" ? NaN : Number(text));

function posParser(other: StatusName): Parser {
  return (line) => {
    if (line.startsWith("%")) return undefined;
    const [week, tow, lat, lon, height, quality, satellites, sdn, sde, sdu, sdne, , , age, ratio] = line.trim().split(/\s+/).map(Number);
    if (!Number.isFinite(height)) return undefined;
    const isRelative = quality === 1 || quality === 2;
    return {
      ...EMPTY, unix: recordedUnixS(week, tow), status: quality === 1 ? "FIXED" : quality === 2 ? "FLOAT" : other, latDeg: lat, lonDeg: lon, heightM: height,
      satellites, sigmaNorthM: sdn, sigmaEastM: sde, sigmaUpM: sdu, eastNorthM2: Math.sign(sdne) * sdne * sdne,
      ageS: isRelative ? age : NaN, ratio: 0 < ratio ? ratio : NaN,
    };
  };
}

function csvParser(): Parser {
  let columns: Map<string, number> | undefined;
  return (line) => {
    if (!columns) {
      columns = new Map(line.split(",").map((name, i) => [name, i]));
      return undefined;
    }
    // Quoted reasons may have commas, so they are removed. No column that is read is quoted.
    const fields = line.replace(/"[^"]*"/g, "").split(",");
    const value = (name: string) => number(fields[columns?.get(name) ?? -1]);
    if (fields.length < 5) return undefined;
    return {
      unix: recordedUnixS(value("gps_week"), value("tow_s")), status: fields[columns.get("status") ?? 2] as StatusName,
      latDeg: value("latitude_deg"), lonDeg: value("longitude_deg"), heightM: value("height_m"), satellites: value("satellites"),
      sigmaEastM: Math.sqrt(value("var_e_m2")), sigmaNorthM: Math.sqrt(value("var_n_m2")), sigmaUpM: Math.sqrt(value("var_u_m2")),
      eastNorthM2: value("cov_en_m2"), ageS: value("age_s"), ratio: value("ratio"),
      horizontalProtectionM: value("hpl_m"), verticalProtectionM: value("vpl_m"),
    };
  };
}

const geojsonParser = (): Parser => (line) => {
  if (!line.includes('"kind":"position"')) return undefined;
  const { geometry, properties } = JSON.parse(line.replace(/,$/, "")) as { geometry: { coordinates: number[] }; properties: Record<string, unknown> };
  const value = (name: string) => (typeof properties[name] === "number" ? (properties[name] as number) : NaN);
  const [lonDeg, latDeg, heightM] = geometry.coordinates;
  return {
    ...EMPTY, unix: Date.parse(String(properties.time)) / 1000, status: properties.status as StatusName, latDeg, lonDeg, heightM,
    satellites: value("satellites"), sigmaEastM: value("sdEastM"), sigmaNorthM: value("sdNorthM"), sigmaUpM: value("sdUpM"),
    horizontalProtectionM: value("horizontalProtectionM"), verticalProtectionM: value("verticalProtectionM"),
  };
};

const KML_POINT = /<name>(\w+)<\/name><description>(\d+) satellites; sd east ([\d.]+) m, north ([\d.]+) m, up ([\d.]+) m.*<when>([^<]+)<.*<Point><coordinates>([^<]+)</;

const kmlParser = (): Parser => (line) => {
  const found = KML_POINT.exec(line);
  if (!found) return undefined;
  const [, status, satellites, east, north, up, when, coordinates] = found;
  const [lonDeg, latDeg, heightM] = coordinates.split(",").map(Number);
  return {
    ...EMPTY, unix: Date.parse(when) / 1000, status: status as StatusName, latDeg, lonDeg, heightM,
    satellites: Number(satellites), sigmaEastM: Number(east), sigmaNorthM: Number(north), sigmaUpM: Number(up),
  };
};

const gpxParser = (): Parser => (line) => {
  const at = /<trkpt lat="([^"]+)" lon="([^"]+)">/.exec(line);
  if (!at) return undefined;
  const element = (name: string) => new RegExp(`<${name}>([^<]*)<`).exec(line)?.[1];
  return {
    ...EMPTY, unix: Date.parse(element("time") ?? "") / 1000, status: (element("type") ?? "NONE") as StatusName,
    latDeg: Number(at[1]), lonDeg: Number(at[2]), heightM: number(element("ele")), satellites: number(element("sat")), ageS: number(element("ageofdgpsdata")),
  };
};

/** In NMEA, GGA begins an epoch and RMC has its date. GST has its deviations and ends it. */
function nmeaParser(other: StatusName): Parser {
  let row: Row = EMPTY;
  let timeS = 0;
  const angle = (text: string, hemisphere: string) => {
    const point = text.indexOf(".");
    const degrees = Number(text.slice(0, point - 2)) + Number(text.slice(point - 2)) / 60;
    return hemisphere === "S" || hemisphere === "W" ? -degrees : degrees;
  };
  return (line) => {
    const [sentence] = line.split("*");
    const f = sentence.split(",");
    if (f[0].endsWith("GGA")) {
      timeS = Number(f[1].slice(0, 2)) * 3600 + Number(f[1].slice(2, 4)) * 60 + Number(f[1].slice(4));
      const quality = Number(f[6]);
      const status = quality === 4 ? "FIXED" : quality === 5 ? "FLOAT" : quality === 0 ? "NONE" : other;
      row = { ...EMPTY, status, satellites: number(f[7]), heightM: number(f[9]), ageS: number(f[13]) };
      if (f[2] && f[4]) row = { ...row, latDeg: angle(f[2], f[3]), lonDeg: angle(f[4], f[5]) };
    } else if (f[0].endsWith("RMC") && f[9]) {
      const [day, month, year] = [0, 2, 4].map((at) => Number(f[9].slice(at, at + 2)));
      row = { ...row, unix: Date.UTC((year < 80 ? 2000 : 1900) + year, month - 1, day) / 1000 + timeS };
    } else if (f[0].endsWith("GST") && Number.isFinite(row.unix)) {
      return { ...row, sigmaNorthM: number(f[6]), sigmaEastM: number(f[7]), sigmaUpM: number(f[8]) };
    }
    return undefined;
  };
}

/** Makes the parser for the lines of each format. */
export const PARSERS: Record<string, (other: StatusName) => Parser> = {
  pos: posParser, csv: csvParser, geojson: geojsonParser, kml: kmlParser, gpx: gpxParser, nmea: nmeaParser,
};

/** The rows of a result. `other` is the status of rows whose format has no name for it. */
export async function load(path: string, format: string, other: StatusName, signal: AbortSignal): Promise<Row[]> {
  const response = await fetch(path, { signal, credentials: "same-origin" });
  if (!response.ok || !response.body) {
    return answered<Row[]>(response.status, await response.text(), response.headers.get("x-request-id"));
  }
  const parse = PARSERS[format]?.(other);
  if (!parse) return [];
  const rows: Row[] = [];
  const reader = response.body.pipeThrough(new TextDecoderStream()).getReader();
  let rest = "";
  for (;;) {
    const { value, done } = await reader.read();
    const lines = (rest + (value ?? "")).split("\n");
    rest = done ? "" : (lines.pop() ?? "");
    for (const line of lines) {
      const row = line.length === 0 ? undefined : parse(line);
      if (row && Number.isFinite(row.unix)) rows.push(row);
    }
    if (done) return rows;
  }
}

export interface Thinned {
  intervals: Interval[];
  intervalLengthS: number;
  solutions: number;
}

/** Intervals of equal length between two times, as the service thins a session. `seq` is the number of a row from 1. */
export function thinned(rows: Row[], points: number, from = -Infinity, to = Infinity): Thinned {
  const inside = rows.flatMap((row, i) => (from <= row.unix && row.unix <= to ? [{ row, seq: i + 1 }] : []));
  if (inside.length === 0) return { intervals: [], intervalLengthS: 0, solutions: 0 };
  const start = inside[0].row.unix;
  const span = inside[inside.length - 1].row.unix - start;
  const lengthS = Math.max(span / points, 1e-3);
  const intervals: Interval[] = [];
  let group: { row: Row; seq: number }[] = [];
  const close = (index: number) => {
    if (group.length) intervals.push(interval(index, group));
    group = [];
  };
  let index = 0;
  for (const entry of inside) {
    const own = Math.min(points - 1, Math.floor((entry.row.unix - start) / lengthS));
    if (own !== index) close(index);
    index = own;
    group.push(entry);
  }
  close(index);
  return { intervals, intervalLengthS: lengthS, solutions: inside.length };
}

function interval(index: number, group: { row: Row; seq: number }[]): Interval {
  const { row, seq } = group[group.length - 1];
  const range = (value: (row: Row) => number): Range | null => {
    const values = group.map(({ row }) => value(row)).filter(Number.isFinite);
    return values.length ? { min: Math.min(...values), max: Math.max(...values), last: values[values.length - 1] } : null;
  };
  const byRank = group.map(({ row }) => row.status).sort((a, b) => RANK[a] - RANK[b]);
  return {
    index, seq, solutions: group.length, time: gpsTime(row.unix), timeUtc: new Date(row.unix * 1000).toISOString(),
    status: row.status, worstStatus: byRank[0], bestStatus: byRank[byRank.length - 1],
    position: Number.isFinite(row.latDeg) ? { latitudeDeg: row.latDeg, longitudeDeg: row.lonDeg, heightM: row.heightM } : null,
    satellites: range((row) => row.satellites), heightM: range((row) => row.heightM),
    horizontalSigmaM: range(horizontalSigma), verticalSigmaM: range((row) => row.sigmaUpM),
    horizontalProtectionM: range((row) => row.horizontalProtectionM), verticalProtectionM: range((row) => row.verticalProtectionM),
    ageS: range((row) => row.ageS), ratio: range((row) => row.ratio),
  };
}

/** Standard deviation along the worst horizontal direction (m). */
export function horizontalSigma({ sigmaEastM, sigmaNorthM, eastNorthM2 }: Row): number {
  const [ee, nn] = [sigmaEastM ** 2, sigmaNorthM ** 2];
  const en = Number.isFinite(eastNorthM2) ? eastNorthM2 : 0;
  return Math.sqrt((ee + nn) / 2 + Math.hypot((ee - nn) / 2, en));
}
