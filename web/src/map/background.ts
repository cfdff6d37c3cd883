/** What lies below a map's layers: tiles or coast lines, a graticule or a grid in metres, and a scale. */
import { isDark } from "../status";
import { drawTiles } from "./tiles";
import { type LonLat, type View, lonLat, mercator } from "./view";

declare const LAND_PATH: string;

const RAD = Math.PI / 180;
const EARTH_M = 40_075_016.686;
/** Smallest distance between two lines (px). */
const SPACING = 90;
/** Size of the world (px) beyond which coast lines to a tenth of a degree mislead. */
const LAND_FADES = 16_000;

interface Colours {
  sea: string;
  land: string;
  coast: string;
  line: string;
  axis: string;
  text: string;
}
const DARK: Colours = { sea: "#0d161d", land: "#17242d", coast: "#2b404d", line: "#1b2a34", axis: "#35505f", text: "#8da3b2" };
const LIGHT: Colours = { sea: "#eef4f6", land: "#fdfdfb", coast: "#b9cbd2", line: "#d7e2e6", axis: "#a9bfc8", text: "#51626e" };

/** Coast lines as rings of Mercator coordinates; loaded when a map first shows them. */
let land: [number, number][][] | undefined;
let loading: Promise<void> | undefined;
const waiting = new Set<() => void>();

function loadLand(redraw: () => void): void {
  waiting.add(redraw);
  loading ??= fetch(LAND_PATH)
    .then((answer) => answer.json() as Promise<number[][]>)
    .then((rings) => {
      land = rings.map(unrolled);
      for (const draw of waiting) draw();
      waiting.clear();
    })
    .catch(() => {
      loading = undefined; // The map works without; the next drawing tries again.
    });
}

/** A ring of tenths of degrees in Mercator coordinates, without jumps from one side to the other. */
function unrolled(ring: number[]): [number, number][] {
  const points: LonLat[] = [];
  for (let i = 0; i + 1 < ring.length; i += 2) {
    let lon = ring[i] / 10;
    const before = points.at(-1)?.lon ?? lon;
    lon += 360 * Math.round((before - lon) / 360);
    points.push({ lon, lat: ring[i + 1] / 10 });
  }
  const [first, last] = [points[0], points[points.length - 1]];
  // A ring around the pole is closed there.
  if (180 < Math.abs(first.lon - last.lon)) points.push({ lon: last.lon, lat: -90 }, { lon: first.lon, lat: -90 });
  return points.map(mercator);
}

export function drawBackground(
  g: CanvasRenderingContext2D,
  view: View,
  anchor: LonLat | undefined,
  redraw: () => void,
): void {
  const colours = isDark() ? DARK : LIGHT;
  g.fillStyle = colours.sea;
  g.fillRect(0, 0, view.width, view.height);
  if (view.scale < LAND_FADES) {
    if (land) drawLand(g, view, colours);
    else loadLand(redraw);
  }
  g.lineWidth = 1;
  g.font = "11px ui-sans-serif, system-ui, sans-serif";
  if (drawTiles(g, view, redraw)) {
    drawScale(g, view, colours);
    return;
  }
  if (anchor && view.metresPerPixel < 200) drawGrid(g, view, anchor, colours);
  else drawGraticule(g, view, colours);
  drawScale(g, view, colours);
}

function drawLand(g: CanvasRenderingContext2D, view: View, colours: Colours): void {
  g.globalAlpha = Math.min(1, (LAND_FADES - view.scale) / (LAND_FADES * 0.4));
  g.beginPath();
  for (const shift of [-1, 0, 1]) {
    const [left] = view.project(shift, 0);
    if (view.width < left || left + view.scale < 0) continue;
    for (const ring of land ?? []) {
      ring.forEach(([x, y], i) => {
        const [px, py] = view.project(x + shift, y);
        if (i === 0) g.moveTo(px, py);
        else g.lineTo(px, py);
      });
      g.closePath();
    }
  }
  g.fillStyle = colours.land;
  g.fill();
  g.strokeStyle = colours.coast;
  g.stroke();
  g.globalAlpha = 1;
}

/** Steps of the graticule (degrees): whole and parts of degrees, then minutes and seconds. */
const STEPS = [
  45, 30, 15, 10, 5, 2, 1, 1 / 2, 1 / 4, 1 / 6, 1 / 12, 1 / 30, 1 / 60, 1 / 120, 1 / 240, 1 / 360,
  1 / 720, 1 / 1800, 1 / 3600, 1 / 7200, 1 / 18_000, 1 / 36_000,
];

function drawGraticule(g: CanvasRenderingContext2D, view: View, colours: Colours): void {
  const perDegree = view.scale / 360;
  const step = [...STEPS].reverse().find((step) => SPACING <= step * perDegree) ?? STEPS[0];
  const [left, top] = view.unproject(0, 0);
  const [right, bottom] = view.unproject(view.width, view.height);
  const [from, to] = [lonLat(left, bottom), lonLat(right, top)];
  const label = (degrees: number, positive: string, negative: string) =>
    angle(Math.abs(degrees), step) + (Math.abs(degrees) < 1e-9 ? "" : degrees < 0 ? negative : positive);
  for (let n = Math.ceil(from.lon / step); n <= Math.floor(to.lon / step); n += 1) {
    const [x] = view.at({ lon: n * step, lat: 0 });
    line(g, x, 0, x, view.height, n === 0 ? colours.axis : colours.line);
    const lon = ((((n * step + 180) % 360) + 360) % 360) - 180;
    if (x < view.width - 120) text(g, label(lon, " E", " W"), x + 4, 14, colours);
  }
  for (let n = Math.ceil(from.lat / step); n <= Math.floor(to.lat / step); n += 1) {
    const [, y] = view.at({ lon: 0, lat: n * step });
    line(g, 0, y, view.width, y, n === 0 ? colours.axis : colours.line);
    if (24 < y) text(g, label(n * step, " N", " S"), 6, y - 5, colours);
  }
}

/** Degrees, with the minutes and seconds that the step needs. */
function angle(degrees: number, step: number): string {
  if (0.999 < step) return `${Math.round(degrees)}°`;
  const seconds = Math.round(degrees * 36_000) / 10;
  const [d, m] = [Math.floor(seconds / 3600), Math.floor((seconds % 3600) / 60)];
  const s = seconds % 60;
  const two = (n: number) => String(n).padStart(2, "0");
  if (1 / 61 < step) return `${d}° ${two(m)}′`;
  return `${d}° ${two(m)}′ ${step < 1 / 3601 ? s.toFixed(1).padStart(4, "0") : two(Math.round(s))}″`;
}

/** A grid in metres east and north of an anchor. */
function drawGrid(g: CanvasRenderingContext2D, view: View, anchor: LonLat, colours: Colours): void {
  const perPixel = (EARTH_M * Math.cos(anchor.lat * RAD)) / view.scale;
  const step = round(SPACING * perPixel);
  const [x0, y0] = view.at(anchor);
  const label = (m: number, direction: string) => `${metres(m, step)} ${direction}`;
  for (let n = Math.ceil((-x0 * perPixel) / step); n * step <= (view.width - x0) * perPixel; n += 1) {
    const x = x0 + (n * step) / perPixel;
    line(g, x, 0, x, view.height, n === 0 ? colours.axis : colours.line);
    if (x < view.width - 100) text(g, n === 0 ? "0" : label(Math.abs(n * step), n < 0 ? "W" : "E"), x + 4, 14, colours);
  }
  const lowest = Math.ceil(((y0 - view.height) * perPixel) / step);
  for (let n = lowest; n * step <= y0 * perPixel; n += 1) {
    const y = y0 - (n * step) / perPixel;
    line(g, 0, y, view.width, y, n === 0 ? colours.axis : colours.line);
    if (24 < y && y < view.height - 34) text(g, n === 0 ? "0" : label(Math.abs(n * step), n < 0 ? "S" : "N"), 6, y - 5, colours);
  }
}

/** The smallest of 1, 2 and 5 times a power of ten that is no smaller. */
function round(value: number): number {
  const power = 10 ** Math.floor(Math.log10(value));
  return [1, 2, 5, 10].map((factor) => factor * power).find((step) => value <= step * 1.000_001) ?? power * 10;
}

function metres(m: number, step: number): string {
  if (1000 <= step) return `${Math.round(m / 1000)} km`;
  if (1 <= step) return `${Math.round(m)} m`;
  if (0.01 <= step) return `${(m * 100).toFixed(0)} cm`;
  return `${(m * 1000).toFixed(0)} mm`;
}

function drawScale(g: CanvasRenderingContext2D, view: View, colours: Colours): void {
  const length = round(70 * view.metresPerPixel);
  const width = length / view.metresPerPixel;
  const [x, y] = [14.5, view.height - 14.5];
  g.strokeStyle = colours.text;
  g.lineWidth = 1.5;
  g.beginPath();
  g.moveTo(x, y - 6);
  g.lineTo(x, y);
  g.lineTo(x + width, y);
  g.lineTo(x + width, y - 6);
  g.stroke();
  g.lineWidth = 1;
  text(g, metres(length, length), x + 5, y - 5, colours);
}

function line(g: CanvasRenderingContext2D, x1: number, y1: number, x2: number, y2: number, colour: string): void {
  g.strokeStyle = colour;
  g.beginPath();
  g.moveTo(Math.round(x1) + 0.5, Math.round(y1) + 0.5);
  g.lineTo(Math.round(x2) + 0.5, Math.round(y2) + 0.5);
  g.stroke();
}

function text(g: CanvasRenderingContext2D, words: string, x: number, y: number, colours: Colours): void {
  g.lineWidth = 3;
  g.strokeStyle = colours.sea;
  g.strokeText(words, x, y);
  g.lineWidth = 1;
  g.fillStyle = colours.text;
  g.fillText(words, x, y);
}
