/** How well the pseudoranges agree with the positions, over time. */
import { useMemo } from "preact/hooks";
import type { GpsTime, ResidualPoint } from "./api";
import { BLUE, Chart, ROSE, metres, only, pointInterval } from "./chart";

interface ResidualsProps {
  points: ResidualPoint[];
  selected: number | undefined;
  onPick: (seq: number) => void;
  onZoom: (from: GpsTime, to: GpsTime) => void;
}

export function Residuals({ points, selected, onPick, onZoom }: ResidualsProps) {
  const intervals = useMemo(() => points.map(({ seq, time }, i) => pointInterval(seq, time, i)), [points]);
  const largest = (i: number): number | undefined => {
    const value = points[i]?.largestM;
    return value === null || value === undefined ? undefined : Math.abs(value);
  };
  const satellite = points.at(-1)?.largestSatellite;
  if (!points.some(({ rmsM }) => typeof rmsM === "number")) return null;
  return (
    <Chart
      title="Residuals" log format={metres} intervals={intervals} intervalS={1} selected={selected} onPick={onPick} onZoom={onZoom}
      lines={[
        { name: `largest${satellite ? ` (${satellite})` : ""}`, colour: ROSE, value: ({ index }) => only(largest(index)), dash: [5, 4] },
        { name: "rms of the pseudoranges", colour: BLUE, value: ({ index }) => only(points[index]?.rmsM) },
      ]}
    />
  );
}
