/** The symbols of states and bases, as pictures that a map copies thousands of times. */
import Icon from "ol/style/Icon";
import { LOOKS, SHAPES, type State, colourOf, isDark } from "../status";

/** The outline that makes symbols and labels visible on any background. */
export const halo = (): string => (isDark() ? "#0b1218" : "#ffffff");

/** The strokes that stand out most. */
export const ink = (): string => (isDark() ? "#ffffff" : "#0f2029");

/** Length of cross hairs from the position (px). */
const HAIRS_PX = 20;

const icons = new Map<string, Icon>();

/** How much a symbol stands out: one of many, one alone, or the chosen one. */
export type Emphasis = "plain" | "halo" | "cross-hairs";

/** The symbol of a state with a radius (px). */
export function stateIcon(state: State, radius: number, emphasis: Emphasis): Icon {
  const isChosen = emphasis === "cross-hairs";
  return icon(`${state} ${radius} ${emphasis}`, isChosen ? HAIRS_PX + 1 : radius + 3, (g) => {
    if (isChosen) crossHairs(g);
    g.scale(radius, radius);
    const path = new Path2D(SHAPES[LOOKS[state].shape]);
    if (emphasis !== "plain") {
      g.lineWidth = 3 / radius;
      g.lineJoin = "round";
      g.strokeStyle = halo();
      g.stroke(path);
    }
    g.fillStyle = colourOf(state);
    g.fill(path, "evenodd");
  });
}

function crossHairs(g: CanvasRenderingContext2D): void {
  g.strokeStyle = ink();
  g.lineWidth = 1.5;
  g.beginPath();
  for (const [dx, dy] of [[1, 0], [-1, 0], [0, 1], [0, -1]]) {
    g.moveTo(dx * 12, dy * 12);
    g.lineTo(dx * HAIRS_PX, dy * HAIRS_PX);
  }
  g.stroke();
}

/** A mast with two waves, the symbol of a base. */
export function baseIcon(): Icon {
  return icon("base", 16, (g) => {
    for (const [colour, width] of [[halo(), 5], [isDark() ? "#cfe0ea" : "#26404f", 1.8]] as const) {
      g.strokeStyle = colour;
      g.lineWidth = width;
      mast(g);
    }
  });
}

function mast(g: CanvasRenderingContext2D): void {
  g.beginPath();
  g.moveTo(-5, 8);
  g.lineTo(0, -5);
  g.lineTo(5, 8);
  g.moveTo(-3, 3);
  g.lineTo(3, 3);
  g.stroke();
  for (const r of [4, 8]) {
    g.beginPath();
    g.arc(0, -6, r, -0.75 * Math.PI, -0.25 * Math.PI);
    g.stroke();
  }
}

/** A picture of `2 * reach` px, drawn once for each theme and pixel density of the screen. */
function icon(name: string, reach: number, draw: (g: CanvasRenderingContext2D) => void): Icon {
  const density = window.devicePixelRatio || 1;
  const key = `${name} ${halo()} ${density}`;
  let made = icons.get(key);
  if (!made) {
    const img = document.createElement("canvas");
    img.width = img.height = Math.ceil(2 * reach * density);
    const g = img.getContext("2d");
    if (g) {
      g.scale(density, density);
      g.translate(reach, reach);
      draw(g);
    }
    // Labels keep clear of labels only: no symbol is left out.
    made = new Icon({ img, scale: 1 / density, declutterMode: "none" });
    icons.set(key, made);
  }
  return made;
}
