/**
 * Live data: a value that is loaded again at an interval, or that a stream sends.
 *
 * Pages state what they want to see and not how it arrives. Only `follow` opens and closes streams,
 * so pages need no change when a stream replaces polling. A hidden page requests nothing. After a
 * failure the last value stays, with the problem beside it, and each next attempt waits longer.
 */
import { useEffect, useRef, useState } from "preact/hooks";
import { Problem, problemOf } from "./api";

export interface Live<T> {
  value?: T;
  /** Why the last attempt failed; undefined after a success. */
  problem?: Problem;
  /** When the value arrived (ms since 1970). */
  at: number;
}

const LONGEST_MS = 30_000;

/** Calls `load` now and at every interval; begins again when `key` changes. */
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
        const problem = problemOf(error);
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

/** Time until the next attempt after the service has refused a stream. */
const STREAM_AGAIN_MS = 30_000;
const POLL_MS = 1000;

/** How a page follows a stream of server-sent events. */
export interface Follower {
  /** For each name of an event, what takes its data. It returns true for the last event. */
  events: Record<string, (data: string) => boolean>;
  /** Called when a stream begins: the first stream, and each one after a break. */
  opened?: () => void;
  /**
   * Called while there is no stream, such as a poll. It returns the time until the next call (ms):
   * infinity if no more data will come, undefined after a failure. Without `instead` the browser
   * connects again after a break.
   */
  instead?: (signal: AbortSignal) => Promise<number | undefined>;
  /** Silence after which a stream counts as broken (ms). */
  silenceMs?: number;
}

/** Allowed silence at the beginning. It is shorter, to find a proxy that holds events back. */
const FIRST_SILENCE_MS = 8000;

/**
 * Opens a stream, closes it while the page is hidden, and opens it again. After a refusal the next
 * attempt comes when `STREAM_AGAIN_MS` have passed; with `instead`, also after every break. Returns
 * a function that ends all this.
 */
export function follow(path: string, { events, opened, instead, silenceMs }: Follower): () => void {
  const stop = new AbortController();
  let source: EventSource | undefined;
  let [timer, silence, failures, streamFrom, isOver] = [0, 0, 0, 0, false];

  const close = () => {
    source?.close();
    source = undefined;
    window.clearTimeout(timer);
    window.clearTimeout(silence);
  };
  const withoutStream = async () => {
    const ms = instead ? await instead(stop.signal) : STREAM_AGAIN_MS;
    if (stop.signal.aborted) return;
    failures = ms === undefined ? failures + 1 : 0;
    isOver ||= ms === Infinity;
    if (isOver) close();
    if (isOver || source) return;
    window.clearTimeout(timer);
    timer = window.setTimeout(begin, ms ?? Math.min(POLL_MS * 2 ** failures, LONGEST_MS));
  };
  const giveUp = () => {
    close();
    streamFrom = Date.now() + STREAM_AGAIN_MS;
    void withoutStream(); // This call finds the reason, and shows it.
  };
  const open = () => {
    const made = new EventSource(path);
    source = made;
    const wait = (ms: number) => {
      window.clearTimeout(silence);
      if (silenceMs) silence = window.setTimeout(giveUp, ms);
    };
    const broken = () => {
      if (source === made && (instead || made.readyState === EventSource.CLOSED)) giveUp();
    };
    wait(FIRST_SILENCE_MS);
    if (opened) made.addEventListener("open", opened);
    for (const [name, take] of Object.entries(events)) {
      made.addEventListener(name, ({ data }) => {
        if (source !== made) return;
        wait(silenceMs ?? 0);
        failures = 0;
        isOver = take(data);
        if (isOver) close();
      });
    }
    made.addEventListener("error", broken);
    made.addEventListener("end", broken);
  };
  const begin = () => {
    if (document.hidden || isOver || stop.signal.aborted || source) return;
    if (instead && Date.now() < streamFrom) void withoutStream();
    else open();
  };
  const wake = () => {
    close(); // A hidden page requests nothing.
    begin();
  };
  begin();
  document.addEventListener("visibilitychange", wake);
  return () => {
    stop.abort();
    close();
    document.removeEventListener("visibilitychange", wake);
  };
}

/** Polling for `instead`. `take` returns when to load again (ms). */
export const polling = <T>(
  load: (signal: AbortSignal) => Promise<T>,
  take: (value: T) => number,
  fail: (problem: Problem) => void,
) => async (signal: AbortSignal): Promise<number | undefined> => {
  try {
    const value = await load(signal);
    return signal.aborted ? 0 : take(value);
  } catch (error) {
    if (!signal.aborted) fail(problemOf(error));
    return undefined;
  }
};

/**
 * A value from server-sent events. `names` are the events that contain it. The stream ends after a
 * value that `isLast` accepts. Without a stream the page polls with `load`.
 */
export function useEvents<T>(
  path: string,
  names: string[],
  load: (signal: AbortSignal) => Promise<T>,
  isLast: (value: T) => boolean,
): Live<T> & { set: (value: T) => void } {
  const [state, setState] = useState<{ path: string; live: Live<T> }>({ path, live: { at: 0 } });
  const latest = useRef({ load, isLast });
  latest.current = { load, isLast };

  useEffect(() => {
    const take = (value: T): boolean => {
      setState({ path, live: { value, at: Date.now() } });
      return latest.current.isLast(value);
    };
    const fail = (problem: Problem) =>
      setState((before) => ({ path, live: { ...(before.path === path ? before.live : { at: 0 }), problem } }));
    const events = Object.fromEntries(names.map((name) => [name, (data: string) => take(JSON.parse(data) as T)]));
    const instead = polling((signal) => latest.current.load(signal), (value) => (take(value) ? Infinity : POLL_MS), fail);
    return follow(path, { events, instead });
  }, [path]);

  const set = (value: T) => setState({ path, live: { value, at: Date.now() } });
  return { ...(state.path === path ? state.live : { at: 0 }), set };
}

/**
 * Gives each event `name` of a stream to `take` while the page is visible. The browser connects
 * again after a break. After a refusal the next attempt comes later. The event `last` ends all.
 */
export function useMessages<T>(path: string, name: string, last: string, take: (message: T) => void): void {
  const latest = useRef(take);
  latest.current = take;
  useEffect(() => follow(path, {
    events: {
      [name]: (data) => {
        latest.current(JSON.parse(data) as T);
        return false;
      },
      [last]: () => true,
    },
  }), [path]);
}
