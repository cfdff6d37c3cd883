/** Time series with uPlot: the last value of each interval as a line, its extremes as a band. */
import { useEffect, useRef } from "preact/hooks";
import uPlot from "uplot";
import type { GpsTime, Interval, Range } from "./api";
import { RANK, colourOf, isDark, lookState } from "./status";
import { gpsTime, unixS } from "./time";

export interface Line {
  name: string;
  colour: [dark: string, light: string];
  value: (interval: Interval) => Range | null;
  dash?: number[];
}

interface ChartProps {
  title: string;
  intervals: Interval[];
  intervalS: number;
  lines: Line[];
  format: (value: number) => string;
  log?: boolean;
  /** Least extent of the vertical axis. */
  least?: number;
  whole?: boolean;
  /** Values are never negative. */
  positive?: boolean;
  selected?: number;
  height?: number;
  onPick: (seq: number) => void;
  onZoom: (from: GpsTime, to: GpsTime) => void;
}

/** A point in time in the form of an interval of one solution, for charts of other values. */
export function pointInterval(seq: number, time: GpsTime, index: number): Interval {
  const status = "UNSPECIFIED" as const;
  return {
    index, solutions: 1, seq, time, timeUtc: "", status, worstStatus: status, bestStatus: status,
    position: null, satellites: null, heightM: null, horizontalSigmaM: null, verticalSigmaM: null,
    horizontalProtectionM: null, verticalProtectionM: null, ageS: null, ratio: null,
  };
}

/** A single value as a range; null for a missing value. */
export const only = (value: number | null | undefined): Range | null =>
  value === null || value === undefined ? null : { min: value, max: value, last: value };

/** A length for an axis. */
export const metres = (v: number): string =>
  Math.abs(v) < 0.1 ? `${+(v * 1000).toPrecision(3)} mm` : Math.abs(v) < 1000 ? `${+v.toPrecision(3)} m` : `${+(v / 1000).toPrecision(3)} km`;

export const BLUE: Line["colour"] = ["#6cc4f5", "#0b76b8"];
export const AMBER: Line["colour"] = ["#f0b429", "#a86400"];
export const ROSE: Line["colour"] = ["#ff9d9d", "#8c2f39"];
export const GREEN: Line["colour"] = ["#2bc79b", "#00785a"];

const SYNC = uPlot.sync("session");
const AXIS_PX = 62;
const FONT = "11px ui-sans-serif, system-ui, sans-serif";

/** Text and lines of the axes. */
const ink = () => (isDark() ? "#8da3b2" : "#51626e");
const rule = () => (isDark() ? "#1e2e39" : "#e1e9ec");

function frame(props: ChartProps, latest: () => ChartProps): Partial<uPlot.Options> {
  return {
    height: props.height ?? 130,
    legend: { show: false },
    padding: [6, 24, 0, 0],
    tzDate: (ts) => uPlot.tzDate(new Date(ts * 1000), "Etc/UTC"),
    cursor: {
      sync: { key: SYNC.key },
      y: false,
      points: { size: 7 },
      drag: { x: true, y: false, dist: 8, setScale: false },
    },
    hooks: {
      setSelect: [
        (plot) => {
          if (plot.select.width < 8) return;
          const [from, to] = [plot.select.left, plot.select.left + plot.select.width].map((px) => plot.posToVal(px, "x"));
          plot.setSelect({ left: 0, top: 0, width: 0, height: 0 }, false);
          if (plot.root.matches(":hover")) latest().onZoom(gpsTime(from), gpsTime(to));
        },
      ],
      draw: [(plot) => drawSelected(plot, latest())],
    },
  };
}

/** A click that is no drag chooses the epoch below it. */
function choosesOnClick(plot: uPlot, latest: () => ChartProps): void {
  let pressed = 0;
  plot.over.addEventListener("pointerdown", (event) => {
    pressed = event.clientX;
  });
  plot.over.addEventListener("pointerup", (event) => {
    if (5 < Math.abs(event.clientX - pressed)) return;
    const { left } = plot.over.getBoundingClientRect();
    const interval = latest().intervals[plot.posToIdx(event.clientX - left)];
    if (interval) latest().onPick(interval.seq);
  });
}

function drawSelected(plot: uPlot, { intervals, selected }: ChartProps): void {
  const at = intervals.find(({ seq }) => selected !== undefined && selected <= seq);
  if (!at || selected === undefined) return;
  const x = Math.round(plot.valToPos(unixS(at.time), "x", true)) + 0.5;
  const g = plot.ctx;
  g.save();
  g.strokeStyle = isDark() ? "#ffffff" : "#12212c";
  g.lineWidth = devicePixelRatio;
  g.beginPath();
  g.moveTo(x, plot.bbox.top);
  g.lineTo(x, plot.bbox.top + plot.bbox.height);
  g.stroke();
  g.restore();
}

const timeAxis = (size = 26): uPlot.Axis => ({
  stroke: ink, grid: { stroke: rule, width: 1 }, ticks: { show: false }, size, font: FONT, space: 90,
  values: (_plot, splits, _axis, _space, step) => splits.map((s) => {
    const text = new Date(s * 1000).toISOString();
    if (86_400 <= step) return text.slice(5, 10);
    return step < 1 ? text.slice(17, 21) : step < 60 ? text.slice(11, 19) : text.slice(11, 16);
  }),
});

/** Times of the intervals, and a gap where one interval or more has no solution. */
function columns(props: ChartProps): (number | null)[][] {
  const times = props.intervals.map(({ time }) => unixS(time));
  const data: (number | null)[][] = [times];
  for (const line of props.lines) {
    const ranges = props.intervals.map(line.value);
    const bound = (value: number | undefined) =>
      value === undefined || (props.log && value <= 0) ? null : value;
    data.push(ranges.map((range) => bound(range?.max)), ranges.map((range) => bound(range?.min)), ranges.map((range) => bound(range?.last)));
  }
  return data;
}

export function Chart(props: ChartProps) {
  const box = useRef<HTMLDivElement>(null);
  const plot = useRef<uPlot | null>(null);
  const latest = useRef(props);
  latest.current = props;
  const theme = isDark();

  useEffect(() => {
    const { current } = box;
    if (!current) return undefined;
    const series: uPlot.Series[] = [{}];
    const bands: uPlot.Band[] = [];
    const gaps: uPlot.Series.GapsRefiner = (_u, _s, i0, i1, found) => [...found, ...breaks(latest.current, i0, i1, plot.current)];
    for (const line of props.lines) {
      const colour = line.colour[theme ? 0 : 1];
      const i = series.length;
      const edge: uPlot.Series = { stroke: "transparent", width: 0, points: { show: false }, gaps };
      series.push(edge, { ...edge }, { stroke: colour, width: 1.6, dash: line.dash, points: { show: false }, gaps });
      bands.push({ series: [i, i + 1], fill: `${colour}38` });
    }
    const made = new uPlot(
      {
        width: Math.max(200, current.clientWidth),
        ...frame(props, () => latest.current),
        series,
        bands,
        scales: {
          x: { time: true },
          y: {
            distr: props.log ? 3 : 1,
            range: props.log ? undefined : (_u, low, high) => extent(low ?? 0, high ?? 1, props),
          },
        },
        axes: [
          timeAxis(),
          {
            stroke: ink, grid: { stroke: rule, width: 1 }, ticks: { show: false }, size: AXIS_PX, font: FONT, space: 26,
            values: (_u, splits) => splits.map((v) => (v === null ? "" : props.format(v))),
          },
        ],
      } as uPlot.Options,
      columns(props) as uPlot.AlignedData,
      current,
    );
    plot.current = made;
    choosesOnClick(made, () => latest.current);
    SYNC.sub(made);
    const sized = new ResizeObserver(() => made.setSize({ width: Math.max(200, current.clientWidth), height: props.height ?? 130 }));
    sized.observe(current);
    return () => {
      sized.disconnect();
      SYNC.unsub(made);
      made.destroy();
      plot.current = null;
    };
  }, [theme, props.title]);

  useEffect(() => {
    plot.current?.setData(columns(props) as uPlot.AlignedData);
  }, [props.intervals]);
  useEffect(() => plot.current?.redraw(false), [props.selected]);

  const last = props.intervals.at(-1);
  const words = props.lines.map((line) => {
    const range = last && line.value(last);
    return `${line.name} ${range ? props.format(range.last) : "–"}`;
  });
  return (
    <figure class="chart">
      <figcaption>
        <strong>{props.title}</strong>
        {props.lines.map((line, i) => (
          <span key={line.name} class="key">
            <i class={line.dash ? "dashed" : ""} style={{ color: line.colour[theme ? 0 : 1] }} />{words[i]}
          </span>
        ))}
      </figcaption>
      <div ref={box} role="img" aria-label={`${props.title} over time; at the end ${words.join(", ")}`} />
    </figure>
  );
}

/** The ranges (px) between two solutions that are more than three intervals apart. */
function breaks(props: ChartProps, i0: number, i1: number, plot: uPlot | null): [number, number][] {
  if (!plot) return [];
  const found: [number, number][] = [];
  const { intervals } = props;
  const steps = intervals.slice(1).map((interval, i) => unixS(interval.time) - unixS(intervals[i].time));
  const usual = [...steps].sort((a, b) => a - b)[steps.length >> 1] ?? 1;
  for (let i = Math.max(1, i0 + 1); i <= i1 && i < intervals.length; i += 1) {
    if (steps[i - 1] <= 3 * usual) continue;
    const pixels = [intervals[i - 1], intervals[i]].map(({ time }) => Math.round(plot.valToPos(unixS(time), "x", true)));
    found.push([pixels[0], pixels[1]]);
  }
  return found;
}

function extent(low: number, high: number, { least = 0.01, whole, positive }: ChartProps): [number, number] {
  const middle = (low + high) / 2;
  const half = Math.max((high - low) / 2, least / 2) * 1.1;
  if (whole) return [Math.max(0, Math.floor(middle - half)), Math.ceil(middle + half)];
  return [positive ? Math.max(0, middle - half) : middle - half, middle + half];
}

/** The status over time: the worst of each interval above, the last below. */
export function StatusStrip(props: Omit<ChartProps, "lines" | "format" | "title">) {
  const box = useRef<HTMLDivElement>(null);
  const plot = useRef<uPlot | null>(null);
  const whole: ChartProps = { ...props, title: "Status", lines: [], format: String, height: 62 };
  const latest = useRef(whole);
  latest.current = whole;
  const theme = isDark();

  useEffect(() => {
    const { current } = box;
    if (!current) return undefined;
    const base = frame(latest.current, () => latest.current);
    const made = new uPlot(
      {
        ...base,
        width: Math.max(200, current.clientWidth),
        height: 62,
        series: [{}, { stroke: "transparent", points: { show: false } }],
        scales: { x: { time: true }, y: { range: [0, 1] } },
        axes: [timeAxis(), { size: AXIS_PX, grid: { show: false }, ticks: { show: false }, values: () => [] }],
        hooks: { ...base.hooks, draw: [(plot) => drawStrip(plot, latest.current), (plot) => drawSelected(plot, latest.current)] },
      } as uPlot.Options,
      [[], []],
      current,
    );
    plot.current = made;
    choosesOnClick(made, () => latest.current);
    SYNC.sub(made);
    const sized = new ResizeObserver(() => made.setSize({ width: Math.max(200, current.clientWidth), height: 62 }));
    sized.observe(current);
    return () => {
      sized.disconnect();
      SYNC.unsub(made);
      made.destroy();
      plot.current = null;
    };
  }, [theme]);
  useEffect(() => {
    const times = props.intervals.map(({ time }) => unixS(time));
    plot.current?.setData([times, times.map(() => 0.5)]);
  }, [props.intervals, theme]);
  useEffect(() => plot.current?.redraw(false), [props.selected]);
  return <div ref={box} role="img" aria-label="Status over time, the worst of each interval" />;
}

function drawStrip(plot: uPlot, { intervals, intervalS }: ChartProps): void {
  const g = plot.ctx;
  const { top, height, left, width } = plot.bbox;
  g.save();
  g.beginPath();
  g.rect(left, top, width, height);
  g.clip();
  intervals.forEach((interval, i) => {
    const at = unixS(interval.time);
    const next = intervals[i + 1] ? unixS(intervals[i + 1].time) : at + intervalS;
    // A pause longer than a few intervals stays empty in the strip.
    const until = next - at < 4 * Math.max(intervalS, 1) ? next : at + Math.max(intervalS, 1);
    const x = plot.valToPos(at, "x", true);
    const w = Math.max(1, plot.valToPos(until, "x", true) - x + 0.6);
    const worst = RANK[interval.worstStatus];
    g.fillStyle = colourOf(lookState(interval.worstStatus));
    // Higher bars are better, so that no colour is needed to read them.
    const bar = height * (0.25 + 0.15 * worst);
    g.fillRect(x, top + height - bar, w, bar);
    if (interval.worstStatus !== interval.bestStatus) {
      const best = height * (0.25 + 0.15 * RANK[interval.bestStatus]);
      g.fillStyle = colourOf(lookState(interval.bestStatus));
      g.fillRect(x, top + height - best, w, 3 * devicePixelRatio);
    }
  });
  g.restore();
}

