/** The sky above a receiver, and its satellites as a table: who is used, and who is not and why. */
import type { SatelliteView } from "./api";
import { CONSTELLATIONS, constellationColour } from "./status";
import { length } from "./time";

const R = 140;
/** Residual (standard deviations) from which robust kernels clearly reduce a weight. */
const CONTRADICTS = 3;
/** C/N0 of empty and of full bars and discs (dB-Hz). */
const [WEAK, STRONG] = [20, 52];

export const cn0Of = (view: SatelliteView): number | undefined =>
  view.signals.reduce<number | undefined>(
    (best, { cn0DbHz }) => (cn0DbHz === null ? best : Math.max(best ?? 0, cn0DbHz)),
    undefined,
  );

const strength = (cn0: number): number => Math.max(0, Math.min(1, (cn0 - WEAK) / (STRONG - WEAK)));

const normalized = (view: SatelliteView): number | undefined =>
  view.residualM === null || view.sigmaM === null || view.sigmaM === 0 ? undefined : view.residualM / view.sigmaM;

const contradicts = (view: SatelliteView): boolean =>
  view.role === "USED" && CONTRADICTS < Math.abs(normalized(view) ?? 0);

/** Remarks about a satellite; empty if it is used like the others. */
export function remarks(view: SatelliteView): { words: string; tone: string }[] {
  const list: { words: string; tone: string }[] = [];
  const sigmas = normalized(view);
  if (view.role === "EXCLUDED") list.push({ words: "left out: contradicts the others", tone: "bad" });
  if (view.role === "NO_EPHEMERIS") list.push({ words: "left out: no ephemeris", tone: "warn" });
  if (view.role === "BELOW_MASK") list.push({ words: "left out: below the elevation mask", tone: "" });
  if (view.role === "SWITCHED_OFF") list.push({ words: "switched off by the configuration", tone: "" });
  if (view.role === "UNUSED") list.push({ words: "not used: weak, without pseudorange, or not seen by the base", tone: "" });
  if (contradicts(view)) list.push({ words: `down-weighted: ${Math.abs(sigmas ?? 0).toFixed(1)} σ off`, tone: "warn" });
  if (view.slipped) list.push({ words: "cycle slip", tone: "warn" });
  if (view.halfCycle) list.push({ words: "half cycle open", tone: "warn" });
  return list;
}

export function SkyPlot({ satellites }: { satellites: SatelliteView[] }) {
  const up = satellites.filter((view) => view.azimuthDeg !== null && view.elevationDeg !== null && 0 <= view.elevationDeg);
  return (
    <svg class="sky" viewBox="-172 -164 344 328" role="img" aria-label={`Sky plot of ${up.length} satellites; the table lists them`}>
      {[0, 30, 60].map((elevation) => <circle key={elevation} class="sky-ring" r={R * (1 - elevation / 90)} />)}
      <path class="sky-ring" d={`M0 ${-R}V${R}M${-R} 0H${R}`} />
      {[30, 60].map((elevation) => <text key={elevation} class="sky-text" x="3" y={-R * (1 - elevation / 90) - 3}>{elevation}°</text>)}
      {([["N", 0, -R - 8], ["E", R + 12, 5], ["S", 0, R + 18], ["W", -R - 12, 5]] as const).map(([name, x, y]) => (
        <text key={name} class="sky-wind" x={x} y={y}>{name}</text>
      ))}
      {up.map((view) => <Dot key={view.satellite} view={view} />)}
    </svg>
  );
}

function Dot({ view }: { view: SatelliteView }) {
  const r = R * (1 - (view.elevationDeg ?? 0) / 90);
  const azimuth = ((view.azimuthDeg ?? 0) * Math.PI) / 180;
  const [x, y] = [r * Math.sin(azimuth), -r * Math.cos(azimuth)];
  const cn0 = cn0Of(view);
  const used = view.role === "USED";
  const colour = constellationColour(view.satellite[0]);
  const size = 4 + 5 * (cn0 === undefined ? 0.3 : strength(cn0));
  const said = remarks(view).map(({ words }) => words).join(", ");
  const troubled = view.role === "EXCLUDED" || view.slipped || view.halfCycle || contradicts(view);
  return (
    <g transform={`translate(${x.toFixed(1)} ${y.toFixed(1)})`}>
      <title>{`${view.satellite} · ${cn0?.toFixed(0) ?? "–"} dB-Hz · ${view.elevationDeg?.toFixed(0)}° up${said && ` · ${said}`}`}</title>
      {troubled && <circle class="sky-trouble" r={size + 3.5} />}
      <circle r={size} fill={used ? colour : "transparent"} stroke={colour} stroke-width="1.8" />
      {view.role === "EXCLUDED" && <path class="sky-cross" d="M-4 -4L4 4M4 -4L-4 4" />}
      <text class="sky-name" x="0" y={size + 11}>{view.satellite}</text>
    </g>
  );
}

export function SkyLegend({ satellites }: { satellites: SatelliteView[] }) {
  const letters = [...new Set(satellites.map(({ satellite }) => satellite[0]))];
  return (
    <p class="sky-legend">
      {letters.map((letter) => (
        <span key={letter}><i class="dot" style={{ background: constellationColour(letter) }} />{CONSTELLATIONS[letter]?.name ?? letter}</span>
      ))}
      <span><i class="dot hollow" />not used</span>
      <span><i class="dot trouble" />slipped, down-weighted or left out</span>
      <span>larger: stronger signal</span>
    </p>
  );
}

export function SatelliteTable({ satellites }: { satellites: SatelliteView[] }) {
  const rank = (view: SatelliteView) => (remarks(view).some(({ tone }) => tone) ? 0 : view.role === "USED" ? 1 : 2);
  const sorted = [...satellites].sort((a, b) => rank(a) - rank(b) || (b.elevationDeg ?? -90) - (a.elevationDeg ?? -90));
  return (
    <div class="table-box satellites" tabIndex={0} role="region" aria-label="Satellites">
      <table>
        <thead>
          <tr><th scope="col">Satellite</th><th scope="col" class="number" title="Elevation and azimuth">El · Az</th><th scope="col">C/N0 (dB-Hz)</th><th scope="col" class="number" title="Pseudorange minus model at the position, against the median of the constellation">Residual</th><th scope="col">Remark</th></tr>
        </thead>
        <tbody>
          {sorted.map((view) => (
            <tr key={view.satellite} class={view.role === "USED" ? "" : "unused"}>
              <th scope="row"><i class={`dot ${view.role === "USED" ? "" : "hollow"}`} style={view.role === "USED" ? { background: constellationColour(view.satellite[0]) } : { borderColor: constellationColour(view.satellite[0]) }} />{view.satellite}</th>
              <td class="number">{view.elevationDeg === null ? "–" : `${view.elevationDeg.toFixed(0)}° · ${view.azimuthDeg?.toFixed(0)}°`}</td>
              <td><Bars view={view} /></td>
              <td class="number">{length(view.residualM)}</td>
              <td>{remarks(view).map(({ words, tone }) => <span key={words} class={`tag ${tone}`}>{words}</span>)}</td>
            </tr>
          ))}
        </tbody>
      </table>
    </div>
  );
}

function Bars({ view }: { view: SatelliteView }) {
  return (
    <span class="bars">
      {view.signals.filter(({ cn0DbHz }) => cn0DbHz !== null).map(({ code, cn0DbHz }) => (
        <span key={code} class="bar-pair" title={`${code}: ${cn0DbHz?.toFixed(1)} dB-Hz`}>
          <span class="bar-code">{code}</span>
          <svg width="54" height="8" viewBox="0 0 54 8" aria-hidden="true">
            <rect width="54" height="8" rx="2" class="bar-back" />
            <rect width={54 * strength(cn0DbHz ?? 0)} height="8" rx="2" fill={constellationColour(view.satellite[0])} />
          </svg>
          <span class="bar-value">{cn0DbHz?.toFixed(0)}</span>
        </span>
      ))}
    </span>
  );
}
