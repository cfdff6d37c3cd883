/** The time series of a session or a job: status, precision, satellites, height, ratio, age. */
import type { ComponentChildren } from "preact";
import type { GpsTime, Interval } from "./api";
import { AMBER, BLUE, Chart, GREEN, ROSE, StatusStrip, metres } from "./chart";
import { LOOKS, lookState } from "./status";
import { count, duration, unixS, utc } from "./time";
import { Loading } from "./ui";

interface PlotsProps {
  series: { intervals: Interval[]; intervalLengthS: number; solutions: number } | undefined;
  selected: number | undefined;
  onPick: (seq: number) => void;
  onZoom: (from: GpsTime, to: GpsTime) => void;
  /** What a user can do in the plots. */
  hint?: string;
  /** Further charts. */
  children?: ComponentChildren;
}

export function Plots({ series, selected, onPick, onZoom, hint = "Drag to zoom, click to choose an epoch. ", children }: PlotsProps) {
  if (!series) return <section class="card"><h2>Over time</h2><Loading what="the time series" /></section>;
  const { intervals, intervalLengthS, solutions } = series;
  if (intervals.length === 0) return <section class="card"><h2>Over time</h2><p>No epoch in this span of time.</p></section>;
  const common = { intervals, intervalS: intervalLengthS, selected, onPick, onZoom };
  type Value = "ageS" | "ratio" | "horizontalProtectionM" | "horizontalSigmaM" | "verticalSigmaM";
  const has = (name: Value) => intervals.some((interval) => interval[name] !== null);
  const exact = (v: number) => `${v.toFixed(2)} m`;
  return (
    <section class="card plots">
      <div class="card-head">
        <h2>Over time</h2>
        <span class="small">{count(solutions)} epochs{intervals.length < solutions && `, thinned to ${count(intervals.length)} intervals of ${duration(intervalLengthS)}: line is the last value, band the extremes`}. {hint}Times are UTC.</span>
      </div>
      <Scrubber intervals={intervals} selected={selected} onPick={onPick} />
      <div class="chart"><figcaption><strong>Status</strong><span class="small">higher is better; the bar is the worst of its interval</span></figcaption><StatusStrip {...common} /></div>
      {has("horizontalSigmaM") && <Chart {...common} title="Precision" log format={metres} height={160} lines={[
        ...(has("horizontalProtectionM") ? [{ name: "protection H", colour: ROSE, value: (i: Interval) => i.horizontalProtectionM, dash: [5, 4] }] : []),
        ...(has("verticalSigmaM") ? [{ name: "σ vertical", colour: AMBER, value: (i: Interval) => i.verticalSigmaM }] : []),
        { name: "σ horizontal", colour: BLUE, value: (i) => i.horizontalSigmaM },
      ]} />}
      <div class="plot-pairs">
        <Chart {...common} title="Satellites" whole least={4} format={(v) => String(Math.round(v))} lines={[{ name: "used", colour: GREEN, value: (i) => i.satellites }]} />
        <Chart {...common} title="Height" least={0.5} format={exact} lines={[{ name: "above the ellipsoid", colour: BLUE, value: (i) => i.heightM }]} />
        {has("ratio") && <Chart {...common} title="Ratio" log format={(v) => String(+v.toPrecision(3))} lines={[{ name: "second-best to best integers", colour: GREEN, value: (i) => i.ratio }]} />}
        {has("ageS") && <Chart {...common} title="Age of corrections" positive least={2} format={(v) => `${+v.toFixed(1)} s`} lines={[{ name: "base epoch", colour: AMBER, value: (i) => i.ageS }]} />}
        {children}
      </div>
    </section>
  );
}

/** Chooses an epoch along the time of the plots, also by keys. */
function Scrubber({ intervals, selected, onPick }: { intervals: Interval[]; selected: number | undefined; onPick: (seq: number) => void }) {
  const found = selected === undefined ? -1 : intervals.findIndex(({ seq }) => selected <= seq);
  const at = found < 0 ? intervals.length - 1 : found;
  const { seq, time, status } = intervals[at];
  const words = `epoch ${count(seq)}, ${utc(unixS(time))} UTC, ${LOOKS[lookState(status)].name}`;
  return (
    <label class="scrub">Epoch
      <input
        type="range" min={0} max={intervals.length - 1} value={at} title={words} aria-valuetext={words}
        onInput={({ currentTarget }) => onPick(intervals[Number(currentTarget.value)].seq)}
      />
    </label>
  );
}
