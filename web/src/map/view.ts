/** A map of OpenLayers as the dashboard uses it: what it frames, how it moves, what is picked. */
import type { Coordinate } from "ol/coordinate";
import OlMap from "ol/Map";
import View from "ol/View";
import ScaleLine from "ol/control/ScaleLine";
import type { Condition } from "ol/events/condition";
import { type Extent, boundingExtent, buffer, getCenter, getHeight, getWidth } from "ol/extent";
import { defaults } from "ol/interaction/defaults";
import DragPan from "ol/interaction/DragPan";
import KeyboardPan from "ol/interaction/KeyboardPan";
import KeyboardZoom from "ol/interaction/KeyboardZoom";
import MouseWheelZoom from "ol/interaction/MouseWheelZoom";
import type BaseLayer from "ol/layer/Base";
import { toLonLat } from "ol/proj";
import { type Layer, type LonLat, projected, stretch } from "./layers";

/** Largest distance between the pointer and what it picks (px). */
const REACH_PX = 14;
/** Margins around the framed points for buttons and scale: top, right, bottom, left (px). */
const ROOM_PX = [50, 120, 60, 70];

/** The keys that move the map. */
const MOVING = new Set(["ArrowLeft", "ArrowRight", "ArrowUp", "ArrowDown", "+", "-"]);

/**
 * How a map moves: at once for users who want no motion, else with inertia. `wheel` decides which
 * turns of the wheel zoom.
 */
function interactions(wheel: Condition) {
  const isStill = matchMedia("(prefers-reduced-motion: reduce)").matches;
  const duration = isStill ? 0 : undefined;
  const common = defaults({
    altShiftDragRotate: false, pinchRotate: false, mouseWheelZoom: false,
    dragPan: !isStill, keyboard: !isStill, zoomDuration: duration,
  });
  common.push(new MouseWheelZoom({ condition: wheel, duration }));
  return isStill ? common.extend([new DragPan(), new KeyboardPan({ duration }), new KeyboardZoom({ duration })]) : common;
}

export interface MapOptions {
  onPick?(id: string | undefined): void;
  onHover?(id: string | undefined): void;
  /** Zoom by the wheel only while the map has the focus, so that the page can be scrolled. */
  calmWheel?: boolean;
}

export class MapView {
  options: MapOptions = {};
  private readonly map: OlMap;
  private readonly view = new View({ center: [0, 0], zoom: 1 });
  private layers: Layer[] = [];
  private below: BaseLayer[] = [];
  /** The area to keep in view until the user moves the map. */
  private framed: Extent | undefined;
  private moved = false;
  private readonly area: ResizeObserver;

  constructor(box: HTMLElement, target: HTMLElement) {
    // This observer is made before that of the map, so that it is called first.
    this.area = new ResizeObserver(() => this.drawInto(target));
    this.map = new OlMap({
      keyboardEventTarget: box,
      view: this.view,
      controls: [new ScaleLine({ minWidth: 70 })],
      interactions: interactions(({ type, originalEvent }) => {
        // OpenLayers calls this for events of every kind.
        const zooms = type === "wheel" && (!this.options.calmWheel || box.contains(document.activeElement) || (originalEvent as WheelEvent).ctrlKey);
        this.moved ||= zooms;
        return zooms;
      }),
    });
    const moves = () => {
      this.moved = true;
    };
    this.map.on("pointerdrag", moves);
    this.map.on("dblclick", moves);
    this.map.on("change:size", () => {
      if (!this.moved) this.fit();
    });
    this.map.on("click", ({ coordinate }) => this.options.onPick?.(this.picked(coordinate)));
    this.map.on("pointermove", ({ coordinate, dragging, originalEvent }) => {
      if (dragging || !(originalEvent instanceof PointerEvent) || originalEvent.pointerType !== "mouse") return;
      const id = this.picked(coordinate);
      box.classList.toggle("can-pick", id !== undefined);
      this.options.onHover?.(id);
    });
    target.addEventListener("pointerleave", () => this.options.onHover?.(undefined));
    box.addEventListener("keydown", ({ key, ctrlKey, metaKey, altKey }) => {
      if (ctrlKey || metaKey || altKey) return;
      if (MOVING.has(key)) moves();
      if (key === "0") this.fit();
    });
    this.area.observe(target);
    this.drawInto(target);
  }

  /**
   * Puts the map into its element while the element has an area. Without an area OpenLayers draws
   * nothing and warns in the console.
   */
  private drawInto(target: HTMLElement): void {
    const hasArea = 0 < target.offsetWidth && 0 < target.offsetHeight;
    this.map.setTarget(hasArea ? target : undefined);
  }

  remove(): void {
    this.area.disconnect();
    this.showBelow([]);
    this.map.setTarget(undefined);
    this.map.dispose();
  }

  /** Shows the layers of a page, the last one on top. Layers that stay are not drawn anew. */
  show(layers: Layer[]): void {
    this.replace(this.layers, layers, 0);
    this.layers = layers;
  }

  /**
   * Shows the layers of the background. It disposes of those that were there before: their sources
   * live longer and would keep them in memory.
   */
  showBelow(below: BaseLayer[]): void {
    this.replace(this.below, below, -below.length);
    for (const layer of this.below) if (!below.includes(layer)) layer.dispose();
    this.below = below;
  }

  private replace(before: BaseLayer[], after: BaseLayer[], lowest: number): void {
    for (const layer of before) if (!after.includes(layer)) this.map.removeLayer(layer);
    after.forEach((layer, i) => {
      layer.setZIndex(lowest + i);
      if (!before.includes(layer)) this.map.addLayer(layer);
    });
  }

  /**
   * Moves the view so that all these points are in it, and at least `smallestM`. Does nothing if
   * the user has moved the map, unless `force` is set.
   */
  frame(points: LonLat[], smallestM: number, force: boolean): void {
    if (points.length === 0) return;
    const extent = boundingExtent(points.map(projected));
    const [lon, lat] = toLonLat(getCenter(extent));
    const missing = smallestM * stretch({ lon, lat }) - Math.max(getWidth(extent), getHeight(extent));
    this.framed = buffer(extent, Math.max(0, missing / 2));
    if (force || !this.moved) this.fit();
  }

  fit(): void {
    this.moved = false;
    const [width, height] = this.map.getSize() ?? [0, 0];
    if (!this.framed || width < 2 || height < 2) return;
    // On a small map the margins take at most half of each side.
    const [top, right, bottom, left] = ROOM_PX;
    const [across, up] = [Math.min(1, width / 2 / (left + right)), Math.min(1, height / 2 / (top + bottom))];
    // The size is given, because the view may not know the size of its map yet.
    const size = [width, height];
    this.view.fit(this.framed, { size, padding: [top * up, right * across, bottom * up, left * across] });
  }

  /** Zooms in by a number of levels. Each level doubles the scale. */
  zoom(levels: number): void {
    this.moved = true;
    this.view.adjustZoom(levels);
  }

  /** The id of the nearest feature that has one, if it is within reach. */
  private picked(coordinate: Coordinate): string | undefined {
    let best: string | undefined;
    let nearest = REACH_PX * (this.view.getResolution() ?? 0);
    for (const layer of this.layers) {
      const feature = layer.getSource()?.getClosestFeatureToCoordinate(coordinate, (feature) => feature.getId() !== undefined);
      const [x, y] = feature?.getGeometry()?.getClosestPoint(coordinate) ?? [Infinity, Infinity];
      const distance = Math.hypot(x - coordinate[0], y - coordinate[1]);
      if (nearest < distance) continue;
      best = String(feature?.getId());
      nearest = distance;
    }
    return best;
  }
}
