/** How often each status was given, as bars. */
import { LOOKS, RANK, colourOf, lookState } from "../status";
import { Share, Symbol } from "../ui";
import type { FleetInterval, StatusCount } from "./api";

const total = (statuses: StatusCount[]): number => statuses.reduce((sum, { solutions }) => sum + solutions, 0);

/** The share of each status, as words and bars. */
export function StatusShares({ statuses }: { statuses: StatusCount[] }) {
  const all = total(statuses);
  return (
    <ul class="shares">
      {statuses.map(({ status, solutions }) => {
        const state = lookState(status);
        return <Share key={status} name={<><Symbol state={state} /> {LOOKS[state].name}</>} part={solutions / all} colour={colourOf(state)} hint={`${solutions} epochs`} />;
      })}
    </ul>
  );
}

const words = (statuses: StatusCount[]): string =>
  statuses.map(({ status, solutions }) => `${LOOKS[lookState(status)].name} ${Math.round((100 * solutions) / total(statuses))} %`).join(", ");

/** One bar with the shares of all statuses, the best at the left. */
export function StatusBar({ statuses }: { statuses: StatusCount[] }) {
  const all = total(statuses);
  let at = 0;
  return (
    <svg class="status-bar" viewBox="0 0 100 10" preserveAspectRatio="none" role="img" aria-label={words(statuses)}>
      {statuses.map(({ status, solutions }) => {
        const x = at;
        at += (100 * solutions) / all;
        return <rect key={status} x={x} width={at - x} height="10" fill={colourOf(lookState(status))}><title>{LOOKS[lookState(status)].name}</title></rect>;
      })}
    </svg>
  );
}

interface FleetBarsProps {
  intervals: FleetInterval[];
  /** Intervals of the whole span. */
  slots: number;
}

/** The shares of all statuses over time, the best at the bottom. */
export function FleetBars({ intervals, slots }: FleetBarsProps) {
  const last = intervals.at(-1);
  return (
    <svg class="fleet-bars" viewBox={`0 0 ${slots} 100`} preserveAspectRatio="none" role="img" aria-label={`Shares of the statuses over time; at the end ${last ? words(last.statuses) : "none"}`}>
      {intervals.map(({ index, statuses }) => {
        const all = total(statuses);
        let at = 100;
        const best = [...statuses].sort((a, b) => RANK[b.status] - RANK[a.status]);
        return best.map(({ status, solutions }) => {
          const height = (100 * solutions) / all;
          at -= height;
          return <rect key={`${index} ${status}`} x={index + 0.04} y={at} width="0.92" height={height} fill={colourOf(lookState(status))} />;
        });
      })}
    </svg>
  );
}

/** Sessions at work over time. */
export function SessionBars({ intervals, slots }: FleetBarsProps) {
  const most = Math.max(1, ...intervals.map(({ sessions }) => sessions));
  return (
    <svg class="session-bars" viewBox={`0 0 ${slots} 100`} preserveAspectRatio="none" role="img" aria-label={`Sessions at work over time, at most ${most}`}>
      {intervals.map(({ index, sessions }) => (
        <rect key={index} x={index + 0.04} y={100 - (100 * sessions) / most} width="0.92" height={(100 * sessions) / most} fill="currentColor" />
      ))}
    </svg>
  );
}
