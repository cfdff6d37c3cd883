/**
 * The one source of live data: a value that is loaded again at an interval.
 *
 * Pages name what they want to see, not how it arrives, so a stream can take the place of polling
 * here alone. A hidden page asks for nothing. After a failure the last value stays, with the
 * problem beside it, and the next attempt comes later each time.
 */
import { useEffect, useRef, useState } from "preact/hooks";
import { Problem } from "./api";

export interface Live<T> {
  value?: T;
  /** Why the last attempt failed; undefined after a success. */
  problem?: Problem;
  /** When the value arrived (ms since 1970). */
  at: number;
}

const LONGEST_MS = 30_000;

/** `load` now and at every interval; from the beginning when `key` changes. */
export function useLive<T>(
  key: string,
  load: (signal: AbortSignal) => Promise<T>,
  intervalMs: number | ((value: T) => number),
): Live<T> {
  const [state, setState] = useState<{ key: string; live: Live<T> }>({ key, live: { at: 0 } });
  const latest = useRef({ load, intervalMs });
  latest.current = { load, intervalMs };

  useEffect(() => {
    const stop = new AbortController();
    let timer = 0;
    let failures = 0;

    let running = false;

    const attempt = async () => {
      if (document.hidden || running) return;
      running = true;
      const { load, intervalMs } = latest.current;
      let delay: number;
      try {
        const loaded = await load(stop.signal);
        failures = 0;
        if (stop.signal.aborted) return;
        setState({ key, live: { value: loaded, at: Date.now() } });
        delay = typeof intervalMs === "number" ? intervalMs : intervalMs(loaded);
      } catch (error) {
        if (stop.signal.aborted) return;
        const problem = error instanceof Problem
          ? error
          : new Problem("PAGE_FAILED", String(error), "reload the page, and report this");
        setState((before) => ({ key, live: { ...(before.key === key ? before.live : { at: 0 }), problem } }));
        failures += 1;
        delay = Math.min(1000 * 2 ** failures, LONGEST_MS);
      }
      running = false;
      if (Number.isFinite(delay)) timer = window.setTimeout(attempt, delay);
    };
    const wake = () => {
      window.clearTimeout(timer);
      void attempt();
    };
    void attempt();
    document.addEventListener("visibilitychange", wake);
    return () => {
      stop.abort();
      window.clearTimeout(timer);
      document.removeEventListener("visibilitychange", wake);
    };
  }, [key]);

  return state.key === key ? state.live : { at: 0 };
}
