/** Layers of maps: sessions and bases as symbols, tracks, ellipses. */
import { LOOKS, SHAPES, type State, colourOf, isDark } from "../status";
import { type Layer, type LonLat, type View, mercator } from "./view";

export interface Marker {
  id: string;
  at: LonLat;
  state: State;
  label: string;
}

const paths = new Map<string, Path2D>();
function shapePath(shape: keyof typeof SHAPES): Path2D {
  let path = paths.get(shape);
  if (!path) {
    path = new Path2D(SHAPES[shape]);
    paths.set(shape, path);
  }
  return path;
}

/** Draws the symbol of a state; `halo` sets it off from what is below. */
function symbol(g: CanvasRenderingContext2D, state: State, x: number, y: number, r: number, halo: string): void {
  const path = shapePath(LOOKS[state].shape);
  g.save();
  g.translate(x, y);
  g.scale(r, r);
  g.lineWidth = 3 / r;
  g.lineJoin = "round";
  g.strokeStyle = halo;
  g.stroke(path);
  g.fillStyle = colourOf(state);
  g.fill(path, "evenodd");
  g.restore();
}

const sprites = new Map<string, HTMLCanvasElement>();

/** The symbol as a picture: thousands of them are copied faster than drawn. */
function sprite(state: State, r: number, halo: string): { picture: HTMLCanvasElement; size: number } {
  const density = window.devicePixelRatio || 1;
  const size = 2 * (r + 3);
  const key = `${state} ${r} ${halo} ${density}`;
  let picture = sprites.get(key);
  if (!picture) {
    picture = document.createElement("canvas");
    picture.width = picture.height = Math.ceil(size * density);
    const g = picture.getContext("2d");
    if (g) {
      g.scale(density, density);
      symbol(g, state, size / 2, size / 2, r, halo);
    }
    sprites.set(key, picture);
  }
  return { picture, size };
}

/** What calls for a look is drawn last, on top. */
const ORDER: State[] = ["CLOSED", "NEW", "SINGLE", "FGO", "EKF", "FIXED", "FLOAT", "NONE", "LOST"];

/** The sessions of a fleet. */
export class Markers implements Layer {
  private readonly placed: { marker: Marker; x: number; y: number }[];
  /** The one that is pointed at. */
  selected: string | undefined;

  constructor(markers: Marker[]) {
    const sorted = [...markers].sort((a, b) => ORDER.indexOf(a.state) - ORDER.indexOf(b.state));
    this.placed = sorted.map((marker) => {
      const [x, y] = mercator(marker.at);
      return { marker, x, y };
    });
  }

  draw(g: CanvasRenderingContext2D, view: View): void {
    const halo = isDark() ? "#0b1218" : "#ffffff";
    const many = 400 < this.placed.length;
    const r = 4000 < this.placed.length ? 4 : many ? 5.5 : 8;
    const labels: { words: string; x: number; y: number }[] = [];
    for (const { marker, x, y } of this.placed) {
      const [px, py] = view.project(x, y);
      if (px < -20 || py < -20 || view.width + 20 < px || view.height + 20 < py) continue;
      const chosen = marker.id === this.selected;
      if (chosen) {
        g.strokeStyle = isDark() ? "#ffffff" : "#12212c";
        g.lineWidth = 2;
        g.beginPath();
        g.arc(px, py, r + 6, 0, 2 * Math.PI);
        g.stroke();
      }
      const { picture, size } = sprite(marker.state, r, halo);
      g.drawImage(picture, px - size / 2, py - size / 2, size, size);
      if (!many || chosen) labels.push({ words: marker.label, x: px + r + 5, y: py + 4 });
    }
    drawLabels(g, labels, halo, view.width);
  }

  hit(x: number, y: number, view: View): { id: string; distance: number } | undefined {
    let best: { id: string; distance: number } | undefined;
    for (const { marker, x: mx, y: my } of this.placed) {
      const [px, py] = view.project(mx, my);
      const distance = Math.hypot(px - x, py - y);
      if (distance < 14 && (!best || distance <= best.distance)) best = { id: marker.id, distance };
    }
    return best;
  }
}

/** Labels, each unless it would cover an earlier one. */
function drawLabels(g: CanvasRenderingContext2D, labels: { words: string; x: number; y: number }[], halo: string, edge: number): void {
  g.font = "600 12px ui-sans-serif, system-ui, sans-serif";
  const taken: [number, number, number, number][] = [];
  for (const { words, x: right, y } of labels.reverse()) {
    const width = g.measureText(words).width;
    // At the right edge of the map, labels stand to the left of their symbols.
    const x = edge < right + width ? right - width - 26 : right;
    const box: [number, number, number, number] = [x - 2, y - 12, x + width + 2, y + 4];
    if (taken.some((t) => t[0] < box[2] && box[0] < t[2] && t[1] < box[3] && box[1] < t[3])) continue;
    taken.push(box);
    g.lineWidth = 3;
    g.strokeStyle = halo;
    g.strokeText(words, x, y);
    g.fillStyle = isDark() ? "#dfe9ef" : "#1b2b36";
    g.fillText(words, x, y);
  }
}

/** Base stations. */
export class BaseMarkers implements Layer {
  constructor(private readonly bases: { id: string; at: LonLat; label: string }[]) {}

  draw(g: CanvasRenderingContext2D, view: View): void {
    const dark = isDark();
    const labels: { words: string; x: number; y: number }[] = [];
    for (const base of this.bases) {
      const [x, y] = view.at(base.at);
      if (x < -20 || y < -20 || view.width + 20 < x || view.height + 20 < y) continue;
      g.strokeStyle = dark ? "#0b1218" : "#ffffff";
      g.lineWidth = 5;
      mast(g, x, y);
      g.strokeStyle = dark ? "#cfe0ea" : "#26404f";
      g.lineWidth = 1.8;
      mast(g, x, y);
      labels.push({ words: base.label, x: x + 11, y: y + 4 });
    }
    drawLabels(g, labels, dark ? "#0b1218" : "#ffffff", view.width);
  }

  hit(x: number, y: number, view: View): { id: string; distance: number } | undefined {
    for (const base of this.bases) {
      const [px, py] = view.at(base.at);
      const distance = Math.hypot(px - x, py - y);
      if (distance < 12) return { id: base.id, distance };
    }
    return undefined;
  }
}

function mast(g: CanvasRenderingContext2D, x: number, y: number): void {
  g.beginPath();
  g.moveTo(x - 5, y + 8);
  g.lineTo(x, y - 5);
  g.lineTo(x + 5, y + 8);
  g.moveTo(x - 3, y + 3);
  g.lineTo(x + 3, y + 3);
  g.stroke();
  for (const r of [4, 8]) {
    g.beginPath();
    g.arc(x, y - 6, r, -0.75 * Math.PI, -0.25 * Math.PI);
    g.stroke();
  }
}

export interface TrackPoint {
  at: LonLat;
  state: State;
  seq: number;
}

interface LineStyle {
  line: string;
  width?: number;
  dash?: number[];
}

function drawLine(g: CanvasRenderingContext2D, view: View, placed: { x: number; y: number }[], { line, width = 1, dash = [] }: LineStyle): void {
  g.strokeStyle = line;
  g.lineWidth = width;
  g.lineJoin = "round";
  g.setLineDash(dash);
  g.beginPath();
  placed.forEach(({ x, y }, i) => {
    const [px, py] = view.project(x, y);
    if (i === 0) g.moveTo(px, py);
    else g.lineTo(px, py);
  });
  g.stroke();
  g.setLineDash([]);
}

/** Where the antenna was by another source: a line of which no point can be chosen. */
export class TruthTrack implements Layer {
  private readonly placed: { x: number; y: number }[];
  constructor(points: LonLat[]) {
    this.placed = points.map((point) => {
      const [x, y] = mercator(point);
      return { x, y };
    });
  }

  draw(g: CanvasRenderingContext2D, view: View): void {
    drawLine(g, view, this.placed, { line: isDark() ? "#d3f04f" : "#4f6f00", width: 2.2, dash: [7, 4] });
  }
}

/** A track, coloured by status, or as one line without symbols. */
export class Track implements Layer {
  private readonly placed: { x: number; y: number; point: TrackPoint }[];
  constructor(
    points: TrackPoint[],
    private readonly style: LineStyle & { dots: boolean },
  ) {
    this.placed = points.map((point) => {
      const [x, y] = mercator(point.at);
      return { x, y, point };
    });
  }

  draw(g: CanvasRenderingContext2D, view: View): void {
    drawLine(g, view, this.placed, this.style);
    if (!this.style.dots) return;
    // One path for each state: thousands of points at once.
    const byState = new Map<State, Path2D>();
    for (const { x, y, point } of this.placed) {
      const [px, py] = view.project(x, y);
      if (px < -9 || py < -9 || view.width + 9 < px || view.height + 9 < py) continue;
      let path = byState.get(point.state);
      if (!path) {
        path = new Path2D();
        byState.set(point.state, path);
      }
      path.addPath(shapePath(LOOKS[point.state].shape), new DOMMatrix([4.2, 0, 0, 4.2, px, py]));
    }
    for (const [state, path] of byState) {
      g.fillStyle = colourOf(state);
      g.fill(path);
    }
  }

  hit(x: number, y: number, view: View): { id: string; distance: number } | undefined {
    let best: { id: string; distance: number } | undefined;
    for (const { x: mx, y: my, point } of this.placed) {
      const [px, py] = view.project(mx, my);
      const distance = Math.hypot(px - x, py - y);
      if (distance < 14 && (!best || distance < best.distance)) {
        best = { id: String(point.seq), distance };
      }
    }
    return best;
  }
}

/** The chosen epoch: its position, error ellipse (95 %) and horizontal protection level. */
export class ChosenEpoch implements Layer {
  constructor(
    private readonly at: LonLat,
    private readonly state: State,
    private readonly covariance: { ee: number; en: number; nn: number },
    private readonly protectionM: number | null,
  ) {}

  draw(g: CanvasRenderingContext2D, view: View): void {
    const [x, y] = view.at(this.at);
    const scale = 1 / ((40_075_016.686 * Math.cos((this.at.lat * Math.PI) / 180)) / view.scale);
    const dark = isDark();
    const ink = dark ? "#ffffff" : "#0f2029";
    if (this.protectionM !== null && Number.isFinite(this.protectionM)) {
      g.strokeStyle = dark ? "#ff9d9d" : "#8c2f39";
      g.lineWidth = 1.5;
      g.setLineDash([6, 4]);
      g.beginPath();
      g.arc(x, y, this.protectionM * scale, 0, 2 * Math.PI);
      g.stroke();
      g.setLineDash([]);
    }
    const { ee, en, nn } = this.covariance;
    const mean = (ee + nn) / 2;
    const half = Math.hypot((ee - nn) / 2, en);
    const [a, b] = [Math.sqrt(mean + half), Math.sqrt(Math.max(0, mean - half))];
    const turn = 0.5 * Math.atan2(2 * en, ee - nn);
    g.beginPath();
    g.ellipse(x, y, CHI95 * a * scale, CHI95 * b * scale, -turn, 0, 2 * Math.PI);
    g.fillStyle = dark ? "rgba(255,255,255,.12)" : "rgba(15,32,41,.10)";
    g.fill();
    g.strokeStyle = ink;
    g.lineWidth = 1.5;
    g.stroke();
    symbol(g, this.state, x, y, 7, dark ? "#0b1218" : "#ffffff");
    g.strokeStyle = ink;
    g.lineWidth = 1.5;
    g.beginPath();
    for (const [dx, dy] of [[1, 0], [-1, 0], [0, 1], [0, -1]]) {
      g.moveTo(x + dx * 12, y + dy * 12);
      g.lineTo(x + dx * 20, y + dy * 20);
    }
    g.stroke();
  }
}

/** √χ² of two degrees of freedom at 95 %. */
const CHI95 = 2.4477;

/** A line from a base to its rover. */
export class BaselineLine implements Layer {
  constructor(
    private readonly from: LonLat,
    private readonly to: LonLat,
  ) {}

  draw(g: CanvasRenderingContext2D, view: View): void {
    g.strokeStyle = isDark() ? "#5f7c8c" : "#8aa3b0";
    g.setLineDash([3, 4]);
    g.lineWidth = 1.2;
    g.beginPath();
    g.moveTo(...view.at(this.from));
    g.lineTo(...view.at(this.to));
    g.stroke();
    g.setLineDash([]);
  }
}
