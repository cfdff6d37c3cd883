/** How the dashboard shows the state of a session: a colour, a shape and words. */
import type { Head, StatusName } from "./api";

export type State = Exclude<StatusName, "UNSPECIFIED"> | "LOST" | "NEW" | "CLOSED";

export interface Look {
  name: string;
  meaning: string;
  shape: "disc" | "triangle" | "diamond" | "pentagon" | "square" | "cross" | "ring" | "dot" | "bar";
  /** Colours for the dark and the light theme that colour-blind people can tell apart. */
  dark: string;
  light: string;
}

/** The states from best to worst, then those that are not live. Colours after Okabe and Ito. */
export const LOOKS: Record<State, Look> = {
  FIXED: { name: "Fixed", meaning: "relative to a base, integer ambiguities: centimetres", shape: "disc", dark: "#2bc79b", light: "#00785a" },
  FLOAT: { name: "Float", meaning: "relative to a base, real-valued ambiguities: decimetres", shape: "triangle", dark: "#f0b429", light: "#a86400" },
  FGO: { name: "FGO", meaning: "factor graph over a window of epochs", shape: "diamond", dark: "#6cc4f5", light: "#0b76b8" },
  EKF: { name: "EKF", meaning: "extended Kalman filter over all epochs", shape: "pentagon", dark: "#9aa7ff", light: "#4450c8" },
  SINGLE: { name: "Single", meaning: "single-point position of one epoch", shape: "square", dark: "#e08fc0", light: "#a8327c" },
  NONE: { name: "No position", meaning: "epochs arrive, and no position can be computed", shape: "cross", dark: "#ff7a45", light: "#c23a00" },
  LOST: { name: "Lost", meaning: "no epoch has arrived for longer than the chosen time", shape: "ring", dark: "#ff9d9d", light: "#8c2f39" },
  NEW: { name: "No epoch", meaning: "created, and no epoch has arrived yet", shape: "dot", dark: "#9fb3c4", light: "#5a6b7a" },
  CLOSED: { name: "Closed", meaning: "takes no more epochs; its solutions stay readable", shape: "bar", dark: "#8496a5", light: "#667684" },
};
export const STATES = Object.keys(LOOKS) as State[];

/** The state of a session; `lostAfterS` is the silence after which a device counts as lost. */
export function stateOf(head: Head, lostAfterS: number): State {
  if (head.closed) return "CLOSED";
  if (head.ageS === null || head.status === "UNSPECIFIED") return "NEW";
  if (lostAfterS < head.ageS) return "LOST";
  return head.status;
}

const LOST_KEY = "graphfix.lostAfter";
const LOST_AFTER_S = 60;

/** The silence after which a device counts as lost (s), as chosen on the fleet's page. */
export function lostAfterS(): number {
  try {
    return Number(localStorage.getItem(LOST_KEY)) || LOST_AFTER_S;
  } catch {
    return LOST_AFTER_S;
  }
}

export function setLostAfterS(s: number): void {
  try {
    localStorage.setItem(LOST_KEY, String(s));
  } catch {
    // Without storage the choice lasts as long as the page.
  }
}

/** The order of statuses from none to best, for strips and bands. */
export const RANK: Record<StatusName, number> = {
  UNSPECIFIED: 0, NONE: 0, SINGLE: 1, EKF: 2, FGO: 3, FLOAT: 4, FIXED: 5,
};

export function isDark(): boolean {
  const chosen = document.documentElement.dataset.theme;
  return chosen ? chosen === "dark" : matchMedia("(prefers-color-scheme: dark)").matches;
}

export const colourOf = (state: State, dark = isDark()): string => LOOKS[state][dark ? "dark" : "light"];

export const lookState = (status: StatusName): State => (status === "UNSPECIFIED" ? "NEW" : status);

/** The outline of a shape in a square from −1 to 1, as an SVG path. */
export const SHAPES: Record<Look["shape"], string> = {
  disc: "M-.8 0a.8 .8 0 1 0 1.6 0a.8 .8 0 1 0 -1.6 0z",
  triangle: "M0 -.95L.92 .7L-.92 .7z",
  diamond: "M0 -1L.85 0L0 1L-.85 0z",
  pentagon: "M0 -.92L.9 -.22L.55 .8L-.55 .8L-.9 -.22z",
  square: "M-.72 -.72H.72V.72H-.72z",
  cross: "M-.85 -.55L-.55 -.85L0 -.3L.55 -.85L.85 -.55L.3 0L.85 .55L.55 .85L0 .3L-.55 .85L-.85 .55L-.3 0z",
  ring: "M-.9 0a.9 .9 0 1 0 1.8 0a.9 .9 0 1 0 -1.8 0zM-.5 0a.5 .5 0 1 1 1 0a.5 .5 0 1 1 -1 0z",
  dot: "M-.4 0a.4 .4 0 1 0 .8 0a.4 .4 0 1 0 -.8 0z",
  bar: "M-.8 -.25H.8V.25H-.8z",
};

/** Constellations by the letter of their satellites. */
export const CONSTELLATIONS: Record<string, { name: string; dark: string; light: string }> = {
  G: { name: "GPS", dark: "#6cc4f5", light: "#0b76b8" },
  E: { name: "Galileo", dark: "#f0b429", light: "#a86400" },
  C: { name: "BeiDou", dark: "#ff7a45", light: "#c23a00" },
  R: { name: "GLONASS", dark: "#2bc79b", light: "#00785a" },
  J: { name: "QZSS", dark: "#e08fc0", light: "#a8327c" },
};
export const constellationColour = (letter: string, dark = isDark()): string =>
  CONSTELLATIONS[letter]?.[dark ? "dark" : "light"] ?? (dark ? "#9fb3c4" : "#5a6b7a");
