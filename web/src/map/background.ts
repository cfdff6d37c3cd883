/** The background of maps: tiles or coast lines, and a graticule or a grid in metres. */
import type { FrameState } from "ol/Map";
import { degreesToStringHDMS } from "ol/coordinate";
import GeoJSON from "ol/format/GeoJSON";
import type BaseLayer from "ol/layer/Base";
import Graticule from "ol/layer/Graticule";
import Layer from "ol/layer/Layer";
import TileLayer from "ol/layer/Tile";
import VectorLayer from "ol/layer/Vector";
import VectorSource from "ol/source/Vector";
import XYZ from "ol/source/XYZ";
import Fill from "ol/style/Fill";
import Stroke from "ol/style/Stroke";
import Style from "ol/style/Style";
import Text from "ol/style/Text";
import { isDark } from "../status";
import { type LonLat, projected, stretch } from "./layers";

declare const LAND_PATH: string;

/** Smallest distance between two lines (px). */
const SPACING_PX = 90;
const FONT = "11px ui-sans-serif, system-ui, sans-serif";
/** Below this resolution (m/px at the equator) coast lines to a tenth of a degree mislead. */
const LAND_FROM = 2500;
/** From this resolution on (m/px on the ground) a grid in metres is of no use. */
const GRID_TO = 200;
/** Level of the deepest tiles, and how far they are enlarged. Closer, only the grid is drawn. */
const DEEPEST = 19;
const STRETCH = 8;

/** The operator's tiles: the URL in the page, or nothing. */
const meta = document.querySelector<HTMLMetaElement>('meta[name="graphfix-tiles"]');
const TILES = meta?.content ?? "";
export const ATTRIBUTION = (TILES && meta?.dataset.attribution) || "";

interface Colours {
  land: string;
  coast: string;
  line: string;
  axis: string;
  text: string;
  halo: string;
}
const DARK: Colours = { land: "#17242d", coast: "#2b404d", line: "#1b2a34", axis: "#35505f", text: "#8da3b2", halo: "#0d161d" };
const LIGHT: Colours = { land: "#fdfdfb", coast: "#b9cbd2", line: "#d7e2e6", axis: "#a9bfc8", text: "#51626e", halo: "#eef4f6" };

/** The coast lines for all maps: they are read once. */
let land: VectorSource | undefined;
let tiles: XYZ | undefined;

/**
 * The layers below those of a page, in the colours of the present theme. `anchor` is the origin of
 * a grid in metres.
 */
export function background(anchor: LonLat | undefined): BaseLayer[] {
  const colours = isDark() ? DARK : LIGHT;
  land ??= new VectorSource({ url: LAND_PATH, format: new GeoJSON() });
  const layers: BaseLayer[] = [new VectorLayer({
    source: land,
    minResolution: LAND_FROM,
    style: new Style({ fill: new Fill({ color: colours.land }), stroke: new Stroke({ color: colours.coast, width: 1 }) }),
  })];
  const gridTo = anchor ? GRID_TO * stretch(anchor) : 0;
  if (TILES) {
    tiles ??= new XYZ({ url: TILES, maxZoom: DEEPEST, attributions: ATTRIBUTION, referrerPolicy: "origin" });
    const nearest = (tiles.getTileGrid()?.getResolution(DEEPEST) ?? 0) / STRETCH;
    layers.push(new TileLayer({ source: tiles, minResolution: nearest }));
    layers.push(anchor ? new LocalGrid(anchor, colours, nearest) : graticule(colours, 0, nearest));
  } else {
    if (anchor) layers.push(new LocalGrid(anchor, colours, gridTo));
    layers.push(graticule(colours, gridTo, Infinity));
  }
  return layers;
}

/** Steps of the graticule (degrees): degrees, then minutes, seconds and parts of seconds. */
const STEPS = [
  45, 30, 15, 10, 5, 2, 1, 1 / 2, 1 / 6, 1 / 12, 1 / 30, 1 / 60, 1 / 120, 1 / 360, 1 / 720, 1 / 1800, 1 / 3600,
  1 / 7200, 1 / 18_000, 1 / 36_000, 1 / 72_000, 1 / 180_000, 1 / 360_000,
];

/** Degrees, with the minutes and seconds that are not zero. */
const degreesOf = (degrees: number, hemispheres: string): string =>
  degreesToStringHDMS(hemispheres, degrees, 2).replace(/\.00″/, "″").replace(/ 00″/, "").replace(/ 00′(?! \d)/, "");

function graticule(colours: Colours, minResolution: number, maxResolution: number): Graticule {
  const label = (align: Partial<ConstructorParameters<typeof Text>[0]>) => new Text({
    font: FONT,
    fill: new Fill({ color: colours.text }),
    stroke: new Stroke({ color: colours.halo, width: 3 }),
    ...align,
  });
  return new Graticule({
    strokeStyle: new Stroke({ color: colours.line, width: 1 }),
    targetSize: SPACING_PX,
    intervals: STEPS,
    showLabels: true,
    wrapX: false,
    lonLabelPosition: 1,
    lonLabelStyle: label({ textAlign: "left", textBaseline: "top", offsetX: 4, offsetY: 6 }),
    lonLabelFormatter: (degrees) => degreesOf(degrees, "EW"),
    latLabelPosition: 0,
    latLabelStyle: label({ textAlign: "left", textBaseline: "bottom", offsetX: 6, offsetY: -3 }),
    latLabelFormatter: (degrees) => degreesOf(degrees, "NS"),
    minResolution,
    maxResolution,
  });
}

/** A grid in metres east and north of an anchor. */
class LocalGrid extends Layer {
  private readonly canvas = document.createElement("canvas");

  constructor(
    private readonly anchor: LonLat,
    private readonly colours: Colours,
    maxResolution: number,
  ) {
    super({ maxResolution });
    Object.assign(this.canvas.style, { position: "absolute", width: "100%", height: "100%" });
  }

  override render({ size: [width, height], pixelRatio, viewState: { center, resolution } }: FrameState): HTMLElement {
    this.canvas.width = Math.round(width * pixelRatio);
    this.canvas.height = Math.round(height * pixelRatio);
    const g = this.canvas.getContext("2d");
    if (!g) return this.canvas;
    g.save();
    g.scale(pixelRatio, pixelRatio);
    g.font = FONT;
    const perPixel = resolution / stretch(this.anchor);
    const step = roundUp(SPACING_PX * perPixel);
    const [x, y] = projected(this.anchor);
    const [x0, y0] = [width / 2 + (x - center[0]) / resolution, height / 2 + (center[1] - y) / resolution];
    const label = (n: number, [positive, negative]: string) =>
      n === 0 ? "0" : `${metres(Math.abs(n * step), step)} ${n < 0 ? negative : positive}`;
    for (let n = Math.ceil((-x0 * perPixel) / step); n * step <= (width - x0) * perPixel; n += 1) {
      const x = Math.round(x0 + (n * step) / perPixel) + 0.5;
      this.line(g, [x, 0], [x, height], n === 0);
      if (x < width - 100) this.text(g, label(n, "EW"), x + 4, 14);
    }
    for (let n = Math.ceil(((y0 - height) * perPixel) / step); n * step <= y0 * perPixel; n += 1) {
      const y = Math.round(y0 - (n * step) / perPixel) + 0.5;
      this.line(g, [0, y], [width, y], n === 0);
      if (24 < y && y < height - 34) this.text(g, label(n, "NS"), 6, y - 5);
    }
    g.restore(); // The next layer may draw on this canvas, too.
    return this.canvas;
  }

  private line(g: CanvasRenderingContext2D, from: [number, number], to: [number, number], isAxis: boolean): void {
    g.strokeStyle = isAxis ? this.colours.axis : this.colours.line;
    g.lineWidth = 1;
    g.beginPath();
    g.moveTo(...from);
    g.lineTo(...to);
    g.stroke();
  }

  private text(g: CanvasRenderingContext2D, words: string, x: number, y: number): void {
    g.lineWidth = 3;
    g.strokeStyle = this.colours.halo;
    g.strokeText(words, x, y);
    g.fillStyle = this.colours.text;
    g.fillText(words, x, y);
  }
}

/** The smallest of 1, 2 and 5 times a power of ten that is no smaller. */
function roundUp(value: number): number {
  const power = 10 ** Math.floor(Math.log10(value));
  return [1, 2, 5, 10].map((factor) => factor * power).find((step) => value <= step * 1.000_001) ?? power * 10;
}

function metres(m: number, step: number): string {
  if (1000 <= step) return `${Math.round(m / 1000)} km`;
  if (1 <= step) return `${Math.round(m)} m`;
  if (0.01 <= step) return `${(m * 100).toFixed(0)} cm`;
  return `${(m * 1000).toFixed(0)} mm`;
}
