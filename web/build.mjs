// Builds the dashboard: src/ -> dist/, which the Rust build embeds.
//
// Names in dist/assets carry the hash of their content, so that browsers may keep them for ever.
// The same sources and lock file give the same bytes.
import { build } from "esbuild";
import { createHash } from "node:crypto";
import { mkdirSync, readFileSync, readdirSync, rmSync, writeFileSync } from "node:fs";
import { dirname, join } from "node:path";
import { fileURLToPath } from "node:url";

const here = dirname(fileURLToPath(import.meta.url));
const dist = join(here, process.argv[2] ?? "dist");
rmSync(dist, { recursive: true, force: true });
mkdirSync(join(dist, "assets"), { recursive: true });

/** Writes an asset under a name with its hash; returns its path on the service. */
function asset(name, extension, content) {
  const hash = createHash("sha256").update(content).digest("hex").slice(0, 12);
  const file = `${name}-${hash}.${extension}`;
  writeFileSync(join(dist, "assets", file), content);
  return `/assets/${file}`;
}

/** Coast lines from TopoJSON as GeoJSON, to a tenth of a degree. */
function coastLines() {
  const path = join(here, "node_modules/world-atlas/land-110m.json");
  const { arcs, objects, transform } = JSON.parse(readFileSync(path, "utf8"));
  const [kx, ky] = transform.scale;
  const [x0, y0] = transform.translate;
  const decoded = arcs.map((arc) => {
    let [x, y] = [0, 0];
    return arc.map(([dx, dy]) => {
      x += dx;
      y += dy;
      return [Math.round((x * kx + x0) * 10) / 10, Math.round((y * ky + y0) * 10) / 10];
    });
  });
  const arcOf = (index) => (index < 0 ? [...decoded[~index]].reverse() : decoded[index]);
  const polygons = objects.land.geometries.flatMap((geometry) =>
    geometry.type === "Polygon" ? [geometry.arcs] : geometry.arcs,
  );
  const coordinates = polygons.flatMap((polygon) => copies(polygon.map((ring) => unrolled(ring.flatMap(arcOf)))));
  return JSON.stringify({ type: "MultiPolygon", coordinates });
}

/** A ring without jumps from 180 degrees east to 180 degrees west. */
function unrolled(ring) {
  const points = [];
  for (const [lon, lat] of ring) {
    const before = points.at(-1)?.[0] ?? lon;
    points.push([Math.round((lon + 360 * Math.round((before - lon) / 360)) * 10) / 10, lat]);
  }
  const [first, last] = [points[0], points.at(-1)];
  // A ring around the pole is closed there.
  if (180 < Math.abs(first[0] - last[0])) points.push([last[0], -90], [first[0], -90], first);
  return points;
}

/** A polygon, and what of it lies beyond 180 degrees once more at the other side of the map. */
function copies(polygon) {
  const lons = polygon[0].map(([lon]) => lon);
  const shifted = (by) => polygon.map((ring) => ring.map(([lon, lat]) => [Math.round((lon + by) * 10) / 10, lat]));
  if (180 < Math.max(...lons)) return [polygon, shifted(-360)];
  if (Math.min(...lons) < -180) return [polygon, shifted(360)];
  return [polygon];
}

/** What the bundles contain, and the coast lines. */
const libraries = new Set(["world-atlas"]);

async function bundle(entry, options) {
  const result = await build({
    absWorkingDir: here,
    entryPoints: [entry],
    bundle: true,
    minify: true,
    write: false,
    charset: "utf8",
    target: ["es2022"],
    legalComments: "none",
    logLevel: "warning",
    metafile: true,
    ...options,
  });
  for (const input of Object.keys(result.metafile.inputs)) {
    const library = input.match(/^node_modules\/((?:@[^/]+\/)?[^/]+)\//);
    if (library) libraries.add(library[1]);
  }
  return result.outputFiles[0].text;
}

const land = asset("land", "json", coastLines());
const define = { LAND_PATH: JSON.stringify(land) };
const jsx = { jsx: "automatic", jsxImportSource: "preact" };
const script = asset("app", "js", await bundle("src/main.tsx", { define, format: "esm", ...jsx }));
const theme = asset("theme", "js", await bundle("src/theme.ts", { format: "iife" }));
const style = asset("app", "css", await bundle("src/style.css", {}));
const icon = asset("icon", "svg", readFileSync(join(here, "src/icon.svg")));

const licences = [...libraries].sort().map((name) => {
  const folder = join(here, "node_modules", name);
  const { version, license } = JSON.parse(readFileSync(join(folder, "package.json"), "utf8"));
  const file = readdirSync(folder).find((file) => /^licen[cs]e(\.md)?$/i.test(file));
  return `${name} ${version} (${license})\n\n${readFileSync(join(folder, file), "utf8").trim()}\n`;
});
const preamble = "The dashboard contains these libraries and data. The coast lines of world-atlas are made\n" +
  "with Natural Earth, which is in the public domain.\n\n";
writeFileSync(join(dist, "licences.txt"), preamble + licences.join(`\n${"-".repeat(80)}\n\n`));

const page = readFileSync(join(here, "src/index.html"), "utf8")
  .replace("{{theme}}", theme)
  .replace("{{script}}", script)
  .replace("{{style}}", style)
  .replace("{{icon}}", icon);
writeFileSync(join(dist, "index.html"), page);
