/**
 * Layers of maps: sessions and bases as symbols, tracks, ellipses.
 *
 * A layer has the colours of the theme it was made in. Its features have ids if they can be picked.
 */
import Feature from "ol/Feature";
import LineString from "ol/geom/LineString";
import Point from "ol/geom/Point";
import Polygon from "ol/geom/Polygon";
import VectorLayer from "ol/layer/Vector";
import { fromLonLat } from "ol/proj";
import VectorSource from "ol/source/Vector";
import CircleStyle from "ol/style/Circle";
import Fill from "ol/style/Fill";
import Stroke from "ol/style/Stroke";
import Style from "ol/style/Style";
import Text from "ol/style/Text";
import { type State, isDark } from "../status";
import { baseIcon, halo, ink, stateIcon } from "./symbols";

export type Layer = VectorLayer<VectorSource>;

export interface LonLat {
  lon: number;
  lat: number;
}

export const projected = ({ lon, lat }: LonLat): number[] => fromLonLat([lon, lat]);

/** Factor by which a length on the ground is longer on the map (Web Mercator). */
export const stretch = ({ lat }: LonLat): number => 1 / Math.cos((lat * Math.PI) / 180);

function layerOf(features: Feature[], declutter = false): Layer {
  return new VectorLayer({ source: new VectorSource({ features, wrapX: false }), declutter });
}

function placed(at: LonLat, id?: string): Feature {
  const feature = new Feature(new Point(projected(at)));
  feature.setId(id);
  return feature;
}

function labelled(words: string, right: number): Text {
  return new Text({
    text: words,
    font: "600 12px ui-sans-serif, system-ui, sans-serif",
    textAlign: "left",
    offsetX: right,
    fill: new Fill({ color: isDark() ? "#dfe9ef" : "#1b2b36" }),
    stroke: new Stroke({ color: halo(), width: 3 }),
  });
}

export interface Marker {
  id: string;
  at: LonLat;
  state: State;
  label: string;
}

/** The order of drawing: states that need attention are last, on top. */
const ORDER: State[] = ["CLOSED", "NEW", "SINGLE", "FGO", "EKF", "FIXED", "FLOAT", "NONE", "LOST"];
/** Up to `LABELLED` sessions each has a label. From `CROWD` on symbols are the smallest. */
const LABELLED = 400;
const CROWD = 4000;

const radiusOf = (count: number): number => (CROWD < count ? 4 : LABELLED < count ? 5.5 : 8);

/** The sessions of a fleet. */
export function sessions(markers: Marker[]): Layer {
  const radius = radiusOf(markers.length);
  const symbols = new Map<State, Style>();
  const styleOf = ({ state, label }: Marker): Style => {
    if (markers.length <= LABELLED) return new Style({ image: stateIcon(state, radius, "halo"), text: labelled(label, radius + 5) });
    const style = symbols.get(state) ?? new Style({ image: stateIcon(state, radius, "halo") });
    symbols.set(state, style);
    return style;
  };
  const sorted = [...markers].sort((a, b) => ORDER.indexOf(a.state) - ORDER.indexOf(b.state));
  const features = sorted.map((marker) => {
    const feature = placed(marker.at, marker.id);
    feature.setStyle(styleOf(marker));
    return feature;
  });
  return layerOf(features, markers.length <= LABELLED);
}

/** A ring around the session under the pointer. It has a label if the sessions have none. */
export function ringAround({ at, label }: Marker, count: number): Layer {
  const radius = radiusOf(count);
  const feature = placed(at);
  feature.setStyle(new Style({
    image: new CircleStyle({ radius: radius + 6, stroke: new Stroke({ color: ink(), width: 2 }) }),
    text: LABELLED < count ? labelled(label, radius + 10) : undefined,
  }));
  return layerOf([feature]);
}

/** Base stations. */
export function baseStations(bases: { id: string; at: LonLat; label: string }[]): Layer {
  const features = bases.map(({ id, at, label }) => {
    const feature = placed(at, id);
    feature.setStyle(new Style({ image: baseIcon(), text: labelled(label, 11) }));
    return feature;
  });
  return layerOf(features, true);
}

function lineOf(points: LonLat[], stroke: Stroke): Feature {
  const feature = new Feature(new LineString(points.map(projected)));
  feature.setStyle(new Style({ stroke }));
  return feature;
}

/** The true track from another source: a line whose points cannot be picked. */
export function truthTrack(points: LonLat[]): Layer {
  return layerOf([lineOf(points, new Stroke({ color: isDark() ? "#d3f04f" : "#4f6f00", width: 2.2, lineDash: [7, 4] }))]);
}

export interface TrackPoint {
  at: LonLat;
  state: State;
  seq: number;
}

/** A line through a track, and its points by status if they can be picked. */
export function track(points: TrackPoint[], line: { color: string; width: number }, hasPoints: boolean): Layer {
  const features = [lineOf(points.map(({ at }) => at), new Stroke(line))];
  if (hasPoints) {
    const symbols = new Map<State, Style>();
    for (const { at, state, seq } of points) {
      const style = symbols.get(state) ?? new Style({ image: stateIcon(state, 4.2, "plain") });
      symbols.set(state, style);
      const feature = placed(at, String(seq));
      feature.setStyle(style);
      features.push(feature);
    }
  }
  return layerOf(features);
}

/** √χ² of two degrees of freedom at 95 %. */
const CHI95 = 2.4477;
/** Corners of an ellipse. */
const CORNERS = 90;

/** An ellipse with half axes (m); the first is turned from east to north (rad). */
function ellipse(at: LonLat, a: number, b: number, turn: number): Polygon {
  const [x, y] = projected(at);
  const [cos, sin] = [Math.cos(turn) * stretch(at), Math.sin(turn) * stretch(at)];
  const ring = Array.from({ length: CORNERS + 1 }, (_, i) => {
    const angle = (2 * Math.PI * i) / CORNERS;
    const [u, v] = [a * Math.cos(angle), b * Math.sin(angle)];
    return [x + u * cos - v * sin, y + u * sin + v * cos];
  });
  return new Polygon([ring]);
}

/** The chosen epoch: its position, error ellipse (95 %) and horizontal protection level. */
export function chosenEpoch(at: LonLat, state: State, covariance: { ee: number; en: number; nn: number }, protectionM: number | null): Layer {
  const dark = isDark();
  const features: Feature[] = [];
  if (protectionM !== null && Number.isFinite(protectionM)) {
    const level = new Feature(ellipse(at, protectionM, protectionM, 0));
    level.setStyle(new Style({ stroke: new Stroke({ color: dark ? "#ff9d9d" : "#8c2f39", width: 1.5, lineDash: [6, 4] }) }));
    features.push(level);
  }
  const { ee, en, nn } = covariance;
  const mean = (ee + nn) / 2;
  const half = Math.hypot((ee - nn) / 2, en);
  const [a, b] = [Math.sqrt(mean + half), Math.sqrt(Math.max(0, mean - half))];
  const likely = new Feature(ellipse(at, CHI95 * a, CHI95 * b, 0.5 * Math.atan2(2 * en, ee - nn)));
  likely.setStyle(new Style({
    stroke: new Stroke({ color: ink(), width: 1.5 }),
    fill: new Fill({ color: dark ? "rgba(255,255,255,.12)" : "rgba(15,32,41,.10)" }),
  }));
  const position = placed(at);
  position.setStyle(new Style({ image: stateIcon(state, 7, "cross-hairs") }));
  return layerOf([...features, likely, position]);
}

/** A line from a base to its rover. */
export function baseline(from: LonLat, to: LonLat): Layer {
  return layerOf([lineOf([from, to], new Stroke({ color: isDark() ? "#5f7c8c" : "#8aa3b0", width: 1.2, lineDash: [3, 4] }))]);
}
