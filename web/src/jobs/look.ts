/** Recognises a file by its first bytes, to propose its role in a job. The service decides. */

export type Kind = "observations" | "navigation" | "log" | "phone" | "unknown";

export interface Look {
  kind: Kind;
  /** The kind of file in words, such as "RINEX 3.05 observations". */
  words: string;
  marker: string;
  /** Time of the first observation according to the header. */
  from: string;
  /** Whether the beginning of a receiver's log has ephemerides; false for other files. */
  hasEphemerides: boolean;
  /** Whether the file is a log of RTCM 3, which may not state its date. */
  isRtcm: boolean;
}

/** Number of bytes that are read: enough for a header of RINEX, or a minute of a receiver. */
const HEAD_BYTES = 512 << 10;
const NOTHING: Look = { kind: "unknown", words: "not recognised", marker: "", from: "", hasEphemerides: false, isRtcm: false };

/** Packed files that the service does not read. */
const PACKED = [
  { name: "file of compress (.Z)", magic: [0x1f, 0x9d] },
  { name: "zip archive", magic: [0x50, 0x4b, 0x03, 0x04] },
  { name: "7z archive", magic: [0x37, 0x7a, 0xbc, 0xaf] },
];

export async function look(file: File): Promise<Look> {
  const head = await headOf(file);
  if (head.length === 0) return { ...NOTHING, words: file.size === 0 ? "empty file" : NOTHING.words };
  const packed = PACKED.find(({ magic }) => magic.every((byte, i) => head[i] === byte));
  if (packed) return { ...NOTHING, words: `${packed.name}: unpack it first` };
  const text = new TextDecoder("latin1").decode(head.subarray(0, 64 << 10));
  return rinex(text) ?? phone(text) ?? receiver(head) ?? positions(text) ?? NOTHING;
}

/** The first bytes, unpacked if the file is gzip. */
async function headOf(file: File): Promise<Uint8Array> {
  const start = new Uint8Array(await file.slice(0, HEAD_BYTES).arrayBuffer());
  if (start[0] !== 0x1f || start[1] !== 0x8b || typeof DecompressionStream === "undefined") return start;
  const unpacked = new Uint8Array(HEAD_BYTES);
  let length = 0;
  const reader = new Blob([start]).stream().pipeThrough(new DecompressionStream("gzip")).getReader();
  try {
    while (length < HEAD_BYTES) {
      const { value, done } = await reader.read();
      if (done) break;
      const part = value.subarray(0, HEAD_BYTES - length);
      unpacked.set(part, length);
      length += part.length;
    }
    await reader.cancel();
  } catch {
    // The head of a packed file ends within a block.
  }
  return unpacked.subarray(0, length);
}

/** RINEX 2.10 to 4, and CRINEX, whose header follows two lines of its own. */
function rinex(text: string): Look | undefined {
  const lines = text.split(/\r?\n/, 600);
  const isCompact = lines[0]?.slice(60, 80).startsWith("CRINEX VERS") ?? false;
  const header = isCompact ? lines.slice(2) : lines;
  const first = header[0];
  if (!first?.slice(60, 80).startsWith("RINEX VERSION")) return undefined;
  const version = first.slice(0, 9).trim();
  const letter = first.charAt(20).toUpperCase();
  const value = (label: string) => header.find((line) => line.slice(60).startsWith(label))?.slice(0, 60).trim() ?? "";
  const isNavigation = letter === "N" || letter === "G" || letter === "H" || letter === "E";
  if (isNavigation) return { ...NOTHING, kind: "navigation", words: `RINEX ${version} navigation` };
  if (letter !== "O") return { ...NOTHING, words: `RINEX ${version}, neither observations nor navigation` };
  const [year, month, day, hour, minute] = value("TIME OF FIRST OBS").split(/\s+/).map((part) => part.replace(/\..*/, "").padStart(2, "0"));
  const from = minute ? `${year}-${month}-${day} ${hour}:${minute}` : "";
  return {
    ...NOTHING,
    kind: "observations",
    words: `${isCompact ? "CRINEX" : "RINEX"} ${version} observations`,
    marker: value("MARKER NAME"),
    from,
  };
}

function phone(text: string): Look | undefined {
  const isLog = /^(# ?Raw,|Raw,|# Header Description)/m.test(text) && /UtcTimeMillis|utcTimeMillis|ElapsedRealtimeMillis|Raw,\d/.test(text);
  return isLog ? { ...NOTHING, kind: "phone", words: "Android GnssLogger log" } : undefined;
}

/** Positions, as those of a truth file, which the page of a job takes. */
function positions(text: string): Look | undefined {
  const isTable = /^(seq,revision,)?(gps_week|tow_s)[,_]/.test(text) || /^% (GPST|program)/m.test(text);
  return isTable ? { ...NOTHING, words: "positions: compare with them on the page of the job, once it has ended" } : undefined;
}

/** Message numbers of RTCM 3 with ephemerides. */
const EPHEMERIDES = new Set([1019, 1020, 1041, 1042, 1044, 1045, 1046]);

/** UBX and RTCM 3: whole frames with a right checksum, with any other bytes between them. */
function receiver(bytes: Uint8Array): Look | undefined {
  let [ubx, rtcm, hasEphemerides] = [0, 0, false];
  for (let at = 0; at + 6 < bytes.length;) {
    let length = 0;
    if (bytes[at] === 0xb5 && bytes[at + 1] === 0x62) {
      length = (bytes[at + 4] | (bytes[at + 5] << 8)) + 8;
      if (isUbx(bytes.subarray(at, at + length), length)) {
        ubx += 1;
        hasEphemerides ||= bytes[at + 2] === 0x02 && bytes[at + 3] === 0x13;
        at += length;
        continue;
      }
    } else if (bytes[at] === 0xd3 && bytes[at + 1] < 4) {
      length = ((bytes[at + 1] << 8) | bytes[at + 2]) + 6;
      if (isRtcm(bytes.subarray(at, at + length), length)) {
        rtcm += 1;
        hasEphemerides ||= EPHEMERIDES.has((bytes[at + 3] << 4) | (bytes[at + 4] >> 4));
        at += length;
        continue;
      }
    }
    at += 1;
  }
  if (ubx === 0 && rtcm === 0) return undefined;
  const words = rtcm <= ubx ? "u-blox UBX log" : "RTCM 3 log";
  return { ...NOTHING, kind: "log", words: `${words}${hasEphemerides ? " with ephemerides" : ""}`, hasEphemerides, isRtcm: ubx < rtcm };
}

/** The checksum of UBX: Fletcher's, of eight bits. */
function isUbx(frame: Uint8Array, length: number): boolean {
  if (frame.length < length) return false;
  let [a, b] = [0, 0];
  for (const byte of frame.subarray(2, -2)) {
    a = (a + byte) & 0xff;
    b = (b + a) & 0xff;
  }
  return frame[length - 2] === a && frame[length - 1] === b;
}

/** The checksum of RTCM 3: CRC-24Q, which is zero over frame and checksum. */
function isRtcm(frame: Uint8Array, length: number): boolean {
  if (frame.length < length) return false;
  let crc = 0;
  for (const byte of frame) {
    crc ^= byte << 16;
    for (let bit = 0; bit < 8; bit += 1) crc = (crc << 1) ^ (crc & 0x800000 ? 0x1864cfb : 0);
  }
  return (crc & 0xffffff) === 0;
}

export type Role = "rover" | "rover+navigation" | "navigation" | "base" | "none";

export interface Entry {
  /** Distinguishes entries, because two files may have the same name. */
  id: number;
  file: File;
  /** Undefined until the first bytes are read. */
  look?: Look;
  role: Role;
  /** Whether the user has chosen the role. */
  chosen: boolean;
}

const BASE_NAME = /(^|[^a-z])(base|ref|reference|station|master)([^a-z]|$)/i;
const ROVER_NAME = /(^|[^a-z])(rover|rov|mobile|kinematic|gnss_log)([^a-z]|$)/i;
/** Long name of a file of a permanent station: site, monument, receiver, country, source. */
const STATION_NAME = /^[A-Z0-9]{4}\d{2}[A-Z]{3}_[RSU]_/i;

/** How much a file looks like a base's: lowest for a rover's. */
function baseness({ file: { name }, look }: Entry): number {
  if (BASE_NAME.test(name)) return 3;
  if (ROVER_NAME.test(name) || look?.kind === "phone") return -3;
  if (STATION_NAME.test(name)) return 2;
  return BASE_NAME.test(look?.marker ?? "") ? 1 : 0;
}

/** The entries with roles for those that the user has not chosen. */
export function withRoles(entries: Entry[]): Entry[] {
  const isTaken = (...roles: Role[]) => entries.some(({ chosen, role }) => chosen && roles.includes(role));
  const free = entries.filter(({ chosen, look }) => !chosen && look);
  const observed = free.filter(({ look }) => look?.kind !== "navigation" && look?.kind !== "unknown");
  const order = [...observed].sort((a, b) => baseness(a) - baseness(b) || a.id - b.id);
  const roles = new Map<number, Role>();
  const hasRover = isTaken("rover", "rover+navigation");
  const onlyBase = order.length === 1 && 3 <= baseness(order[0]);
  const rover = hasRover || onlyBase ? undefined : order.shift();
  const base = isTaken("base") ? undefined : order.pop();
  const hasNavigation = isTaken("navigation") || free.some(({ look }) => look?.kind === "navigation");
  if (rover) roles.set(rover.id, rover.look?.hasEphemerides && !hasNavigation ? "rover+navigation" : "rover");
  if (base) roles.set(base.id, "base");
  return entries.map((entry) => {
    if (entry.chosen || !entry.look) return entry;
    const standard = entry.look.kind === "navigation" ? "navigation" : "none";
    return { ...entry, role: roles.get(entry.id) ?? standard };
  });
}
