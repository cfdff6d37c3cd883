/**
 * A map on a canvas in double precision: Web Mercator from the whole world to millimetres.
 *
 * It moves by pointer, fingers, wheel and keys. What it shows are layers; what lies below them is a
 * graticule or, for a local map, a grid in metres from an anchor.
 */
import { drawBackground } from "./background";

export interface LonLat {
  lon: number;
  lat: number;
}

export interface Layer {
  draw(g: CanvasRenderingContext2D, view: View): void;
  /** What is at a point of the canvas, and how far from it (px). */
  hit?(x: number, y: number, view: View): { id: string; distance: number } | undefined;
}

export interface MapOptions {
  /** Draw a grid in metres from this point instead of meridians and parallels. */
  anchor?: LonLat;
  onPick?(id: string | undefined): void;
  onHover?(id: string | undefined, x: number, y: number): void;
  /** Zoom by the wheel only while the map has the focus, so that the page can be scrolled. */
  calmWheel?: boolean;
}

const EARTH_M = 40_075_016.686;
const RAD = Math.PI / 180;
/** Distance at which a pointer still picks (px). */
const REACH = 14;

export const mercator = ({ lon, lat }: LonLat): [number, number] => {
  const bounded = Math.max(-85.05, Math.min(85.05, lat));
  return [lon / 360 + 0.5, 0.5 - Math.asinh(Math.tan(bounded * RAD)) / (2 * Math.PI)];
};
export const lonLat = (x: number, y: number): LonLat => ({
  lon: (x - 0.5) * 360,
  lat: Math.atan(Math.sinh((0.5 - y) * 2 * Math.PI)) / RAD,
});

/** Where the canvas looks. */
export class View {
  x = 0.5;
  y = 0.45;
  /** Size of the world (px). */
  scale = 512;
  width = 1;
  height = 1;

  project(x: number, y: number): [number, number] {
    return [(x - this.x) * this.scale + this.width / 2, (y - this.y) * this.scale + this.height / 2];
  }
  at(point: LonLat): [number, number] {
    const [x, y] = mercator(point);
    return this.project(x, y);
  }
  unproject(px: number, py: number): [number, number] {
    return [(px - this.width / 2) / this.scale + this.x, (py - this.height / 2) / this.scale + this.y];
  }
  /** Length of a pixel on the ground at the centre (m). */
  get metresPerPixel(): number {
    const { lat } = lonLat(0, this.y);
    return (EARTH_M * Math.cos(lat * RAD)) / this.scale;
  }
}

export class MapCanvas {
  readonly view = new View();
  private layers: Layer[] = [];
  private frame = 0;
  private bounds: [number, number, number, number] | undefined;
  private touched = false;
  private readonly pointers = new Map<number, { x: number; y: number }>();
  private pressed: { x: number; y: number } | undefined;
  private readonly sized: ResizeObserver;
  private readonly scheme = matchMedia("(prefers-color-scheme: dark)");

  constructor(
    private readonly box: HTMLElement,
    private readonly canvas: HTMLCanvasElement,
    public options: MapOptions,
  ) {
    this.sized = new ResizeObserver(() => this.resize());
    this.sized.observe(box);
    box.addEventListener("pointerdown", this.down);
    box.addEventListener("pointermove", this.move);
    box.addEventListener("pointerup", this.up);
    box.addEventListener("pointercancel", this.up);
    box.addEventListener("pointerleave", this.leave);
    box.addEventListener("wheel", this.wheel, { passive: false });
    box.addEventListener("keydown", this.key);
    this.scheme.addEventListener("change", this.redraw);
    document.addEventListener("graphfix:theme", this.redraw);
    this.resize();
  }

  remove(): void {
    this.sized.disconnect();
    cancelAnimationFrame(this.frame);
    this.scheme.removeEventListener("change", this.redraw);
    document.removeEventListener("graphfix:theme", this.redraw);
  }

  show(layers: Layer[]): void {
    this.layers = layers;
    this.redraw();
  }

  /** Shows these points whole, unless the user has moved the map since. */
  frameOn(points: LonLat[], smallestM: number, force = false): void {
    if (points.length === 0) return;
    const all = points.map(mercator);
    let [left, top, right, bottom] = [Infinity, Infinity, -Infinity, -Infinity];
    for (const [x, y] of all) {
      left = Math.min(left, x);
      right = Math.max(right, x);
      top = Math.min(top, y);
      bottom = Math.max(bottom, y);
    }
    const { lat } = lonLat(0, (top + bottom) / 2);
    const least = smallestM / (EARTH_M * Math.cos(lat * RAD));
    const grow = (a: number, b: number): [number, number] =>
      b - a < least ? [(a + b - least) / 2, (a + b + least) / 2] : [a, b];
    [left, right] = grow(left, right);
    [top, bottom] = grow(top, bottom);
    this.bounds = [left, top, right, bottom];
    if (force) this.touched = false;
    if (!this.touched) this.fit();
  }

  fit(): void {
    this.touched = false;
    if (!this.bounds) return;
    const [left, top, right, bottom] = this.bounds;
    const { view } = this;
    view.x = (left + right) / 2;
    view.y = (top + bottom) / 2;
    // Room for the buttons and labels at the right, and for the scale at the bottom.
    const [wide, high] = [Math.max(80, view.width - 190), Math.max(60, view.height - 110)];
    this.setScale(Math.min(wide / (right - left), high / (bottom - top)));
    view.x += 25 / view.scale;
    view.y += 5 / view.scale;
    this.redraw();
  }

  centre(point: LonLat): void {
    [this.view.x, this.view.y] = mercator(point);
    this.touched = true;
    this.redraw();
  }

  zoom(factor: number, px = this.view.width / 2, py = this.view.height / 2): void {
    const [x, y] = this.view.unproject(px, py);
    this.setScale(this.view.scale * factor);
    this.view.x = x - (px - this.view.width / 2) / this.view.scale;
    this.view.y = y - (py - this.view.height / 2) / this.view.scale;
    this.touched = true;
    this.redraw();
  }

  private pan(dx: number, dy: number): void {
    this.view.x -= dx / this.view.scale;
    this.view.y = Math.max(0, Math.min(1, this.view.y - dy / this.view.scale));
    this.touched = true;
    this.redraw();
  }

  private setScale(scale: number): void {
    const least = Math.max(256, this.view.height * 0.7);
    this.view.scale = Math.max(least, Math.min(EARTH_M / 0.001, scale));
  }

  readonly redraw = (): void => {
    cancelAnimationFrame(this.frame);
    this.frame = requestAnimationFrame(() => this.draw());
  };

  private resize(): void {
    const { width, height } = this.box.getBoundingClientRect();
    if (width < 2 || height < 2) return;
    const density = window.devicePixelRatio || 1;
    this.canvas.width = Math.round(width * density);
    this.canvas.height = Math.round(height * density);
    this.view.width = width;
    this.view.height = height;
    if (this.touched) this.redraw();
    else this.fit();
    this.draw();
  }

  private draw(): void {
    const g = this.canvas.getContext("2d");
    if (!g) return;
    const density = window.devicePixelRatio || 1;
    g.setTransform(density, 0, 0, density, 0, 0);
    g.clearRect(0, 0, this.view.width, this.view.height);
    drawBackground(g, this.view, this.options.anchor, this.redraw);
    for (const layer of this.layers) layer.draw(g, this.view);
  }

  private picked(x: number, y: number): string | undefined {
    let best: { id: string; distance: number } | undefined;
    for (const layer of this.layers) {
      const hit = layer.hit?.(x, y, this.view);
      if (hit && hit.distance <= REACH && (!best || hit.distance < best.distance)) best = hit;
    }
    return best?.id;
  }

  private local(event: PointerEvent | WheelEvent): { x: number; y: number } {
    const { left, top } = this.box.getBoundingClientRect();
    return { x: event.clientX - left, y: event.clientY - top };
  }

  private readonly down = (event: PointerEvent): void => {
    if ((event.target as Element).closest("button")) return;
    this.box.setPointerCapture(event.pointerId);
    const at = this.local(event);
    this.pointers.set(event.pointerId, at);
    this.pressed = this.pointers.size === 1 ? at : undefined;
  };

  private readonly move = (event: PointerEvent): void => {
    const at = this.local(event);
    const before = this.pointers.get(event.pointerId);
    if (!before) {
      if (event.pointerType === "mouse") this.options.onHover?.(this.picked(at.x, at.y), at.x, at.y);
      return;
    }
    const others = [...this.pointers].filter(([id]) => id !== event.pointerId).map(([, p]) => p);
    this.pointers.set(event.pointerId, at);
    if (others.length === 0) {
      this.pan(at.x - before.x, at.y - before.y);
    } else {
      const [other] = others;
      const spread = (p: { x: number; y: number }) => Math.hypot(p.x - other.x, p.y - other.y);
      this.pan((at.x - before.x) / 2, (at.y - before.y) / 2);
      this.zoom(Math.max(0.5, Math.min(2, spread(at) / Math.max(1, spread(before)))),
        (at.x + other.x) / 2, (at.y + other.y) / 2);
    }
    if (this.pressed && 5 < Math.hypot(at.x - this.pressed.x, at.y - this.pressed.y)) {
      this.pressed = undefined;
    }
  };

  private readonly up = (event: PointerEvent): void => {
    this.pointers.delete(event.pointerId);
    if (this.pressed && event.type === "pointerup") {
      this.options.onPick?.(this.picked(this.pressed.x, this.pressed.y));
    }
    this.pressed = undefined;
  };

  private readonly leave = (): void => this.options.onHover?.(undefined, 0, 0);

  private readonly wheel = (event: WheelEvent): void => {
    const focused = this.box.contains(document.activeElement);
    if (this.options.calmWheel && !focused && !event.ctrlKey) return;
    event.preventDefault();
    const { x, y } = this.local(event);
    const lines = event.deltaMode === 1 ? 24 : 1;
    this.zoom(2 ** (-event.deltaY * lines * (event.ctrlKey ? 0.01 : 0.0025)), x, y);
  };

  private readonly key = (event: KeyboardEvent): void => {
    const step = event.shiftKey ? 200 : 60;
    const moves: Record<string, () => void> = {
      ArrowLeft: () => this.pan(step, 0),
      ArrowRight: () => this.pan(-step, 0),
      ArrowUp: () => this.pan(0, step),
      ArrowDown: () => this.pan(0, -step),
      "+": () => this.zoom(1.6),
      "=": () => this.zoom(1.6),
      "-": () => this.zoom(1 / 1.6),
      "0": () => this.fit(),
    };
    const act = moves[event.key];
    if (!act || event.ctrlKey || event.metaKey || event.altKey) return;
    event.preventDefault();
    act();
  };
}
