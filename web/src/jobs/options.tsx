/** What a job computes: mode, profile, kind of answer, format, base position. */
import type { Ecef } from "../api";
import { FORMATS, RINEX } from "../formats";
import { gpsTime } from "../time";
import { Problem } from "../api";
import type { JobOptions } from "./api";

/** The formats of a result. */
const RESULTS = [...FORMATS, RINEX];

export type Answer = "causal" | "smoothed" | "batch";
export type BaseFrom = "any" | "header" | "ecef" | "geodetic";

/** The form as the user has filled it in. A choice that is undefined follows from the files. */
export interface Choices {
  mode?: string;
  profile?: string;
  answer?: Answer;
  format: string;
  baseFrom: BaseFrom;
  /** X, Y, Z (m), or latitude, longitude (degrees) and height (m), as typed. */
  base: [string, string, string];
  /** Date of the recording, `YYYY-MM-DD`; empty for that of the navigation data. */
  date: string;
  /** Overrides, one `name=value` a line. */
  overrides: string;
}

export const NO_CHOICES: Choices = { format: "pos", baseFrom: "any", base: ["", "", ""], date: "", overrides: "" };

export const MODES = [
  { mode: "rtk-fgo", name: "RTK", meaning: "relative to a base, with integer ambiguities: centimetres", relative: true, window: true },
  { mode: "rtk-ekf", name: "RTK, filter", meaning: "relative to a base; the comparator of rtk-fgo", relative: true, window: false },
  { mode: "fgo", name: "factor graph", meaning: "a window of epochs without a base: decimetres to metres", relative: false, window: true },
  { mode: "ekf", name: "Kalman filter", meaning: "without a base; the comparator of fgo", relative: false, window: false },
  { mode: "spp", name: "single point", meaning: "each epoch by itself, without a base: metres", relative: false, window: false },
];
export const PROFILES = [
  { profile: "general", meaning: "any receiver, any motion" },
  { profile: "urban-vehicle", meaning: "a car among buildings" },
  { profile: "static", meaning: "a receiver at rest" },
  { profile: "phone", meaning: "a phone's chip and antenna" },
  { profile: "paper", meaning: "the settings of Wen & Hsu 2021" },
];
const ANSWERS: { answer: Answer; name: string; meaning: string }[] = [
  { answer: "smoothed", name: "Smoothed", meaning: "each epoch with those of its window behind it" },
  { answer: "causal", name: "Causal", meaning: "each epoch as a device in the field would have got it" },
  { answer: "batch", name: "Batch", meaning: "all epochs at once, at the end; slow for long files" },
];

/** Properties of the files that decide the defaults. */
export interface Files {
  hasBase: boolean;
  isPhone: boolean;
  isRtcm: boolean;
}

export interface Settled {
  mode: string;
  profile: string;
  answer: Answer;
}

/** The choices of the user; where there is none, the default for these files. */
export function settled(choices: Choices, files: Files): Settled {
  const mode = choices.mode ?? (files.hasBase ? "rtk-fgo" : "fgo");
  const hasWindow = MODES.find((known) => known.mode === mode)?.window ?? false;
  return {
    mode,
    profile: choices.profile ?? (files.isPhone ? "phone" : "general"),
    answer: hasWindow ? (choices.answer ?? "smoothed") : "causal",
  };
}

const A = 6_378_137;
const E2 = (1 / 298.257_223_563) * (2 - 1 / 298.257_223_563);

/** A geodetic position on WGS 84 as ECEF (m). */
function ecefOf(latDeg: number, lonDeg: number, heightM: number): Ecef {
  const [lat, lon] = [(latDeg * Math.PI) / 180, (lonDeg * Math.PI) / 180];
  const n = A / Math.sqrt(1 - E2 * Math.sin(lat) ** 2);
  const p = (n + heightM) * Math.cos(lat);
  return { xM: p * Math.cos(lon), yM: p * Math.sin(lon), zM: (n * (1 - E2) + heightM) * Math.sin(lat) };
}

/** The options of the request; throws a `Problem` for a mistake that the form can find. */
export function optionsOf(choices: Choices, { mode, profile, answer }: Settled): JobOptions {
  const wrong = (field: string, detail: string, remedy: string) => new Problem("INVALID_FIELD", detail, remedy, `options.${field}`);
  const overrides: Record<string, string> = {};
  for (const line of choices.overrides.split("\n").map((line) => line.trim()).filter(Boolean)) {
    const at = line.indexOf("=");
    if (at < 1) throw wrong("overrides", `“${line}” is not of the form name=value`, "write one option a line, such as elevation_mask_deg=10");
    overrides[line.slice(0, at).trim()] = line.slice(at + 1).trim();
  }
  const isRelative = MODES.find((known) => known.mode === mode)?.relative ?? false;
  let basePosition: Ecef | undefined;
  if (isRelative && (choices.baseFrom === "ecef" || choices.baseFrom === "geodetic")) {
    const values = choices.base.map((text) => (text.trim() === "" ? NaN : Number(text.trim().replace(",", "."))));
    if (!values.every(Number.isFinite)) throw wrong("basePosition", "the base's position needs three numbers", "fill in all three, or take the position from its file");
    const [a, b, c] = values;
    const isLatitude = choices.baseFrom === "ecef" || Math.abs(a) <= 90;
    if (!isLatitude) throw wrong("basePosition", `${a}° is not a latitude`, "give latitude, longitude and height in this order");
    basePosition = choices.baseFrom === "ecef" ? { xM: a, yM: b, zM: c } : ecefOf(a, b, c);
  }
  return {
    mode, profile, overrides, format: choices.format,
    smoothed: answer === "smoothed",
    batch: answer === "batch",
    basePositionFromHeader: isRelative && choices.baseFrom === "header",
    ...(basePosition ? { basePosition } : {}),
    // Noon, because the first message of the recording must be within half a day of this time.
    ...(choices.date ? { near: gpsTime(Date.parse(`${choices.date}T12:00:00Z`) / 1000) } : {}),
  };
}

interface OptionsFormProps {
  choices: Choices;
  files: Files;
  onChange: (choices: Choices) => void;
}

export function OptionsForm({ choices, files, onChange }: OptionsFormProps) {
  const { mode, profile, answer } = settled(choices, files);
  const known = MODES.find((entry) => entry.mode === mode);
  const set = (change: Partial<Choices>) => onChange({ ...choices, ...change });
  const coordinates = choices.baseFrom === "ecef" ? ["X (m)", "Y (m)", "Z (m)"] : ["Latitude (°)", "Longitude (°)", "Height (m)"];
  return (
    <div class="job-options">
      <label class="field">
        <span>Mode</span>
        <select name="mode" value={mode} onChange={({ currentTarget }) => set({ mode: currentTarget.value })}>
          {MODES.map((entry) => <option key={entry.mode} value={entry.mode}>{entry.mode} – {entry.name}</option>)}
        </select>
        <small>{known?.meaning}</small>
      </label>
      <label class="field">
        <span>Answers</span>
        <select name="answer" value={answer} disabled={!known?.window} onChange={({ currentTarget }) => set({ answer: currentTarget.value as Answer })}>
          {ANSWERS.map((entry) => <option key={entry.answer} value={entry.answer}>{entry.name}</option>)}
        </select>
        <small>{known?.window ? ANSWERS.find((entry) => entry.answer === answer)?.meaning : "this mode has no window to smooth in"}</small>
      </label>
      <label class="field">
        <span>Profile</span>
        <select name="profile" value={profile} onChange={({ currentTarget }) => set({ profile: currentTarget.value })}>
          {PROFILES.map((entry) => <option key={entry.profile} value={entry.profile}>{entry.profile}</option>)}
        </select>
        <small>{PROFILES.find((entry) => entry.profile === profile)?.meaning}</small>
      </label>
      <label class="field">
        <span>Format of the result</span>
        <select name="format" value={choices.format} onChange={({ currentTarget }) => set({ format: currentTarget.value })}>
          {RESULTS.map(({ format, name }) => <option key={format} value={format}>{name}</option>)}
        </select>
        <small>{RESULTS.find(({ format }) => format === choices.format)?.meaning}</small>
      </label>
      {known?.relative && (
        <label class="field">
          <span>Position of the base</span>
          <select name="base" value={choices.baseFrom} onChange={({ currentTarget }) => set({ baseFrom: currentTarget.value as BaseFrom })}>
            <option value="any">its file, or estimated</option>
            <option value="header">its file, or refuse</option>
            <option value="geodetic">latitude, longitude …</option>
            <option value="ecef">X, Y, Z</option>
          </select>
          <small>{choices.baseFrom === "any" ? "the report says which; an estimate may be metres off" : choices.baseFrom === "header" ? "header, or messages 1005 and 1006" : "of its marker, WGS 84"}</small>
        </label>
      )}
      {known?.relative && (choices.baseFrom === "ecef" || choices.baseFrom === "geodetic") && (
        <fieldset class="field triple">
          <legend>Coordinates of the base</legend>
          {coordinates.map((name, i) => (
            <label key={name}><span>{name}</span>
              <input inputMode="decimal" value={choices.base[i]} onInput={({ currentTarget }) => set({ base: choices.base.map((old, k) => (k === i ? currentTarget.value : old)) as Choices["base"] })} />
            </label>
          ))}
        </fieldset>
      )}
      <details class="field more">
        <summary>More options</summary>
        <label class="field">
          <span>Date of the recording (UTC)</span>
          <input type="date" value={choices.date} onInput={({ currentTarget }) => set({ date: currentTarget.value })} />
          <small>{files.isRtcm ? "RTCM 3 may not state its date: give it unless the navigation data is of that day" : "only for RTCM 3 logs that do not state it"}</small>
        </label>
        <label class="field">
          <span>Overrides</span>
          <textarea rows={3} spellcheck={false} value={choices.overrides} placeholder="elevation_mask_deg=10" onInput={({ currentTarget }) => set({ overrides: currentTarget.value })} />
          <small>one name=value a line; <code>graphfix config</code> lists all options</small>
        </label>
      </details>
    </div>
  );
}
