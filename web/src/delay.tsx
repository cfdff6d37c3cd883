/** The delays of a session's epochs: from the time tag to when this page has the stored answer. */
import { useState } from "preact/hooks";
import type { GpsTime, Solution } from "./api";
import { Chart, only, pointInterval } from "./chart";
import { useMessages } from "./live";
import { unixS } from "./time";

/** Number of epochs that are shown. */
const KEPT = 3600;
/** Outside these delays (s) the time tags are not from now: a recording, or a wrong clock. */
const [LEAST_S, MOST_S] = [-30, 600];
const VIOLET: [string, string] = ["#c3a6ff", "#6a3fb5"];

interface Delay {
  seq: number;
  time: GpsTime;
  seconds: number;
}

interface DelaysProps {
  id: string;
  selected: number | undefined;
  onPick: (seq: number) => void;
  onZoom: (from: GpsTime, to: GpsTime) => void;
}

const seconds = (s: number): string => (Math.abs(s) < 1 ? `${Math.round(s * 1000)} ms` : `${s.toFixed(1)} s`);

/** The quantile: a fraction `part` of the sorted delays does not exceed it. */
const quantile = (sorted: number[], part: number): number => sorted[Math.min(sorted.length - 1, Math.floor(part * sorted.length))];

export function Delays({ id, selected, onPick, onZoom }: DelaysProps) {
  const [delays, setDelays] = useState<Delay[]>([]);
  useMessages<{ solutions: Solution[] }>(`/v1/sessions/${id}/solutions:watch?revisions=first`, "solutions", "closed", ({ solutions }) => {
    const now = Date.now() / 1000;
    const arrived = solutions.map(({ seq, time }) => ({ seq, time, seconds: now - unixS(time) }));
    if (arrived.length) setDelays((before) => [...before, ...arrived].slice(-KEPT));
  });
  const latest = delays.at(-1);
  const isOfNow = latest && LEAST_S < latest.seconds && latest.seconds < MOST_S;
  const shown = delays.filter((delay) => LEAST_S < delay.seconds && delay.seconds < MOST_S);
  const sorted = shown.map((delay) => delay.seconds).sort((a, b) => a - b);
  const bySeq = new Map(shown.map((delay) => [delay.seq, delay.seconds]));
  return (
    <section class="card delays" aria-label="Delay">
      <div class="card-head">
        <h2>Delay</h2>
        <span class="small">
          From an epoch's time tag until this page has its stored answer, while it is open and by this computer's clock.
          {1 < sorted.length && ` Median ${seconds(quantile(sorted, 0.5))}, 95 % within ${seconds(quantile(sorted, 0.95))}.`}
        </span>
      </div>
      {!latest && <p class="small">Waiting for the next epoch.</p>}
      {latest && !isOfNow && <p class="small">The time tags of these epochs are not of now, so there is no delay to state.</p>}
      {isOfNow && 1 < shown.length && (
        <Chart
          title="Delay" intervals={shown.map(({ seq, time }, i) => pointInterval(seq, time, i))} intervalS={1} selected={selected} onPick={onPick} onZoom={onZoom}
          least={0.2} format={seconds} lines={[{ name: "time tag to page", colour: VIOLET, value: ({ seq }) => only(bySeq.get(seq)) }]}
        />
      )}
    </section>
  );
}
