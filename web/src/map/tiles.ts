/** Tiles of a host that the operator names, below a map. Without one there are none. */
import type { View } from "./view";

/** What the service has written into the page: a URL with {z}, {x} and {y}, and whose map it is. */
const meta = document.querySelector<HTMLMetaElement>('meta[name="graphfix-tiles"]');
const TEMPLATE = meta?.content ?? "";
export const ATTRIBUTION = (TEMPLATE && meta?.dataset.attribution) || "";

/** Width and height of a tile (px). */
const SIZE = 256;
const DEEPEST = 19;
/** How far the deepest tiles are enlarged; closer there is the grid alone. */
const STRETCH = 8;
/** Tiles in memory. */
const KEPT = 300;

/** By URL, the one that was needed last at the end. */
const tiles = new Map<string, HTMLImageElement>();

function tile(z: number, x: number, y: number, redraw: () => void): HTMLImageElement {
  const values: Record<string, number> = { z, x, y };
  const url = TEMPLATE.replace(/\{([zxy])\}/g, (_, name: string) => String(values[name]));
  let picture = tiles.get(url);
  if (picture) {
    tiles.delete(url);
  } else {
    picture = new Image();
    // Hosts of tiles ask whose page theirs are on; no more than that is said.
    picture.referrerPolicy = "origin";
    picture.addEventListener("load", redraw);
    picture.src = url;
  }
  tiles.set(url, picture);
  for (const [oldest] of tiles) {
    if (tiles.size <= KEPT) break;
    tiles.delete(oldest);
  }
  return picture;
}

/** Draws the tiles of a view. Returns whether there are any for it. */
export function drawTiles(g: CanvasRenderingContext2D, view: View, redraw: () => void): boolean {
  if (!TEMPLATE) return false;
  const z = Math.max(0, Math.min(DEEPEST, Math.round(Math.log2(view.scale / SIZE))));
  const count = 2 ** z;
  const size = view.scale / count;
  if (STRETCH * SIZE < size) return false;
  const [left, top] = view.unproject(0, 0).map((v) => Math.floor(v * count));
  const [right, bottom] = view.unproject(view.width, view.height).map((v) => Math.floor(v * count));
  for (let y = Math.max(0, top); y <= Math.min(count - 1, bottom); y += 1) {
    for (let x = left; x <= right; x += 1) {
      const picture = tile(z, ((x % count) + count) % count, y, redraw);
      if (!picture.complete || picture.naturalWidth === 0) continue;
      const [x1, y1] = view.project(x / count, y / count).map(Math.floor);
      const [x2, y2] = view.project((x + 1) / count, (y + 1) / count).map(Math.floor);
      g.drawImage(picture, x1, y1, x2 - x1, y2 - y1);
    }
  }
  return true;
}
