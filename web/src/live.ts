/**
 * The one source of live data: a value that is loaded again at an interval.
 *
 * Pages name what they want to see, not how it arrives, so a stream can take the place of polling
 * here alone. A hidden page asks for nothing. After a failure the last value stays, with the
 * problem beside it, and the next attempt comes later each time.
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

/** Time after which a stream of events that was refused is tried again. */
const STREAM_AGAIN_MS = 30_000;
const POLL_MS = 1000;

/**
 * A value that server-sent events bring: `names` are the events that have it, and the last of them
 * ends the stream. Where no stream can be had, `load` polls.
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
    const stop = new AbortController();
    let source: EventSource | undefined;
    let [timer, failures, streamFrom, isDone] = [0, 0, 0, false];

    const take = (value: T) => {
      failures = 0;
      isDone = latest.current.isLast(value);
      setState({ path, live: { value, at: Date.now() } });
    };
    const close = () => {
      source?.close();
      source = undefined;
      window.clearTimeout(timer);
    };
    const poll = async () => {
      try {
        const value = await latest.current.load(stop.signal);
        if (!stop.signal.aborted) take(value);
      } catch (error) {
        if (stop.signal.aborted) return;
        const problem = problemOf(error);
        setState((before) => ({ path, live: { ...(before.path === path ? before.live : { at: 0 }), problem } }));
        failures += 1;
      }
      close();
      timer = window.setTimeout(begin, Math.min(POLL_MS * 2 ** failures, LONGEST_MS));
    };
    const begin = () => {
      if (document.hidden || isDone || stop.signal.aborted || source) return;
      if (Date.now() < streamFrom) {
        void poll();
        return;
      }
      const opened = new EventSource(path);
      source = opened;
      for (const name of names) {
        opened.addEventListener(name, ({ data }) => {
          take(JSON.parse(data) as T);
          if (isDone) close();
        });
      }
      const broken = () => {
        if (source !== opened) return;
        close();
        streamFrom = Date.now() + STREAM_AGAIN_MS;
        void poll(); // Which finds out why, and shows it.
      };
      opened.addEventListener("error", broken);
      opened.addEventListener("end", broken);
    };
    const wake = () => {
      close(); // A hidden page asks for nothing.
      begin();
    };
    begin();
    document.addEventListener("visibilitychange", wake);
    return () => {
      stop.abort();
      close();
      document.removeEventListener("visibilitychange", wake);
    };
  }, [path]);

  const set = (value: T) => setState({ path, live: { value, at: Date.now() } });
  return { ...(state.path === path ? state.live : { at: 0 }), set };
}

/**
 * Gives each event `name` of a stream to `take`, while the page is seen. The browser asks again
 * after a break; after a refusal a later try does. The event `last` ends it.
 */
export function useMessages<T>(path: string, name: string, last: string, take: (message: T) => void): void {
  const latest = useRef(take);
  latest.current = take;
  useEffect(() => {
    let source: EventSource | undefined;
    let [timer, isOver] = [0, false];
    const close = () => {
      source?.close();
      source = undefined;
      window.clearTimeout(timer);
    };
    const begin = () => {
      if (document.hidden || isOver || source) return;
      const opened = new EventSource(path);
      source = opened;
      opened.addEventListener(name, ({ data }) => latest.current(JSON.parse(data) as T));
      opened.addEventListener(last, () => {
        isOver = true;
        close();
      });
      opened.addEventListener("error", () => {
        if (source !== opened || opened.readyState !== EventSource.CLOSED) return;
        close();
        timer = window.setTimeout(begin, STREAM_AGAIN_MS);
      });
    };
    const wake = () => {
      close(); // A hidden page asks for nothing.
      begin();
    };
    begin();
    document.addEventListener("visibilitychange", wake);
    return () => {
      close();
      document.removeEventListener("visibilitychange", wake);
    };
  }, [path]);
}
