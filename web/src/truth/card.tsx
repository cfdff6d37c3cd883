/** Positions against a truth file that the user gives: the errors over time, and their figures. */
import { useMemo, useRef, useState } from "preact/hooks";
import { type GpsTime, Problem } from "../api";
import { AMBER, BLUE, Chart, metres, pointInterval } from "../chart";
import { type Layer, truthTrack } from "../map/layers";
import { bytes, count, gpsTime, length, utc } from "../time";
import { Figure, ProblemBox, Segments } from "../ui";
import { type Epoch, type EpochError, type TruthRow, errorsOf, grouped, lonLatOf, readTruth, statisticsOf, trackOf, weekOf } from "./compare";

export interface Truth {
  name: string;
  rows: TruthRow[];
}

/** Positions that are compared, under the name of their revision. */
export interface Compared {
  name: string;
  epochs: Epoch[];
}

interface TruthCardProps {
  compared: Compared[];
  truth: Truth | undefined;
  onTruth: (truth: Truth | undefined) => void;
  /** Which positions of the span are compared, if not all. */
  thinning?: string;
  selected: number | undefined;
  onPick: (seq: number) => void;
  onZoom: (from: GpsTime, to: GpsTime) => void;
}

/** The smallest error in the chart: a logarithmic axis has no zero (m). */
const LEAST_M = 1e-4;
/** Points of the chart and of the track. */
const POINTS = 1200;
/** Largest file that is read (bytes). */
const READ_BYTES = 200_000_000;
const REMEDY = "give week, seconds of week and three coordinates, as truth.csv of graphfix simulate has them, or a file of positions";

/** Reads a file; throws a `Problem`. */
async function truthOf(file: File, unknownWeek: number): Promise<Truth> {
  if (READ_BYTES < file.size) {
    throw new Problem("TRUTH_TOO_LARGE", `${file.name} has ${bytes(file.size)}; at most ${bytes(READ_BYTES)} are read`, "cut the file to the span of the positions");
  }
  try {
    return { name: file.name, rows: readTruth(await file.text(), unknownWeek) };
  } catch (error) {
    throw new Problem("TRUTH_UNREADABLE", `${file.name}: ${error instanceof Error ? error.message : error}`, REMEDY);
  }
}

export function TruthCard({ compared, truth, onTruth, thinning, ...chart }: TruthCardProps) {
  const [problem, setProblem] = useState<Problem>();
  const [over, setOver] = useState(false);
  const [name, setName] = useState(compared[0]?.name);
  const input = useRef<HTMLInputElement>(null);
  const epochs = (compared.find((other) => other.name === name) ?? compared[0])?.epochs ?? [];
  const take = async (file: File | undefined) => {
    if (!file) return;
    setProblem(undefined);
    try {
      onTruth(await truthOf(file, weekOf(epochs[0]?.unix ?? Date.now() / 1000)));
    } catch (error) {
      setProblem(error as Problem);
      onTruth(undefined);
    }
  };
  const drop = (event: DragEvent) => {
    event.preventDefault();
    setOver(false);
    void take(event.dataTransfer?.files[0]);
  };
  return (
    <section
      class={`card truth ${over ? "over" : ""}`} aria-label="Truth" onDrop={drop} onDragLeave={() => setOver(false)}
      onDragOver={(event) => { event.preventDefault(); setOver(true); }}
    >
      <div class="card-head">
        <h2>Truth</h2>
        {truth && 1 < compared.length && <Segments label="Compared positions" value={name} onChange={setName} options={compared.map((other) => ({ value: other.name, name: other.name }))} />}
      </div>
      <p class="truth-file">
        <button type="button" class="quiet" onClick={() => input.current?.click()}>{truth ? "Another truth file" : "Compare with a truth file"}</button>
        {truth && <button type="button" class="quiet" onClick={() => onTruth(undefined)}>Remove {truth.name}</button>}
        <span class="small">Choose it or drop it here: a truth.csv, CSV of Graphfix, .pos, GeoJSON, KML, GPX or NMEA. It stays in this browser; nothing is uploaded.</span>
        <input
          ref={input} type="file" class="visually-hidden" tabIndex={-1} aria-label="Truth file"
          onChange={({ currentTarget }) => { void take(currentTarget.files?.[0]); currentTarget.value = ""; }}
        />
      </p>
      {problem && <ProblemBox problem={problem} what="The truth file cannot be used" />}
      {truth && <Comparison epochs={epochs} truth={truth} thinning={thinning} {...chart} />}
    </section>
  );
}

type ComparisonProps = Omit<TruthCardProps, "compared" | "truth" | "onTruth"> & { epochs: Epoch[]; truth: Truth };

function Comparison({ epochs, truth, thinning, selected, onPick, onZoom }: ComparisonProps) {
  const errors = useMemo(() => errorsOf(epochs, truth.rows), [epochs, truth]);
  const statistics = useMemo(() => statisticsOf(errors), [errors]);
  if (!statistics) return <NoMatch epochs={epochs} truth={truth} />;
  return (
    <>
      <dl class="figures">
        <Figure name="Epochs compared" value={`${count(statistics.epochs)} of ${count(epochs.length)}`} hint="with a truth within 50 ms, or between two truths at most 2 s apart" />
        <Figure name="Horizontal mean" value={length(statistics.meanM)} />
        <Figure name="Horizontal 95 %" value={length(statistics.p95M)} hint="95 % of the horizontal errors are at most this" />
        <Figure name="Horizontal max" value={length(statistics.maxM)} />
      </dl>
      <p class="small">Of the span that is shown{thinning ? `, ${thinning}` : ""}.</p>
      <ErrorChart errors={errors} selected={selected} onPick={onPick} onZoom={onZoom} />
    </>
  );
}

function NoMatch({ epochs, truth: { name, rows } }: { epochs: Epoch[]; truth: Truth }) {
  const span = (list: { unix: number }[]) => `${utc(list[0].unix)} to ${utc(list[list.length - 1].unix)} UTC`;
  return (
    <p class="note warn" role="status">
      No position has a truth at its time. {name} is from {span(rows)}{epochs.length > 0 && `, the positions are from ${span(epochs)}`}.
    </p>
  );
}

interface ErrorChartProps {
  errors: EpochError[];
  selected: number | undefined;
  onPick: (seq: number) => void;
  onZoom: (from: GpsTime, to: GpsTime) => void;
}

function ErrorChart({ errors, ...chart }: ErrorChartProps) {
  const groups = useMemo(() => grouped(errors, POINTS), [errors]);
  const intervals = useMemo(() => groups.map((group, i) => {
    const { seq, unix } = group[group.length - 1];
    return pointInterval(seq, gpsTime(unix), i);
  }), [groups]);
  const range = (index: number, value: (error: EpochError) => number) => {
    const values = groups[index]?.map((error) => Math.max(LEAST_M, Math.abs(value(error))));
    return values ? { min: Math.min(...values), max: Math.max(...values), last: values[values.length - 1] } : null;
  };
  return (
    <Chart
      {...chart} title="Error" log format={metres} height={160} intervals={intervals} intervalS={1}
      lines={[
        { name: "vertical, absolute", colour: AMBER, value: ({ index }) => range(index, ({ verticalM }) => verticalM) },
        { name: "horizontal", colour: BLUE, value: ({ index }) => range(index, ({ horizontalM }) => horizontalM) },
      ]}
    />
  );
}

/** The track of the truth in the span of these positions, as a layer of a map. */
export function truthLayer({ rows }: Truth, [first, ...others]: { unix: number }[]): Layer {
  const [from, to] = first ? [first.unix, (others.at(-1) ?? first).unix] : [0, 0];
  return truthTrack(trackOf(rows, from, to, POINTS).map(({ at }) => lonLatOf(at)));
}

export function TruthLegend({ truth }: { truth: Truth | undefined }) {
  return truth ? <span><i class="truth-stroke" />truth</span> : null;
}
