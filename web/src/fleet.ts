/**
 * The latest of all sessions, by a watch; where no stream can be had, by polling.
 *
 * The ages grow while nothing arrives, so the page is given the time at least once a second, and at
 * most that often: a fleet of ten thousand devices brings thousands of heads a second.
 */
import { useEffect, useState } from "preact/hooks";
import { type Head, type Problem, heads as headsOf } from "./api";
import { follow, polling } from "./live";

/** A session as it was last seen. */
export interface Seen {
  head: Head;
  name: string;
  /** What the text filter looks into. */
  words: string;
  /** When the head arrived: its age counts on from then (ms since 1970). */
  at: number;
  /** When a new epoch last arrived while the page looked on (ms since 1970); 0 before. */
  movedAt: number;
}

export interface Fleet {
  /** All sessions in order of their names; undefined before they have arrived. */
  list?: Seen[];
  /** The time for which states and ages are (ms since 1970). */
  now: number;
  problem?: Problem;
}

interface HeadsMessage {
  heads: Head[];
  gone: string[];
  complete: boolean;
}

const SHOW_MS = 1000;
/** The service says something every 15 s. */
const SILENCE_MS = 40_000;
const ORDER = new Intl.Collator("en", { numeric: true });

/** Polls come less often for larger fleets (ms). */
const pollMs = (sessions: number): number => (sessions < 500 ? 2000 : sessions < 3000 ? 5000 : 10_000);

/** What the messages of a watch have brought so far. */
class Heads {
  private all: Map<string, Seen> | undefined;
  /** The first messages of a stream until they are complete. */
  private fresh: Map<string, Seen> | undefined;
  /** Ids in order of the names, until a name changes. */
  private order: string[] | undefined;
  private listed: Seen[] | undefined;

  /** A stream begins: its first messages have all sessions that exist. */
  begin(): void {
    this.fresh = new Map();
  }

  /** Takes a message; true if it has completed the first ones. */
  take({ heads, gone, complete }: HeadsMessage): boolean {
    const into = this.fresh ?? this.all ?? new Map<string, Seen>();
    const now = Date.now();
    for (const head of heads) into.set(head.session, this.seen(head, now));
    for (const session of gone) {
      if (into.delete(session)) this.order = undefined;
    }
    this.listed = undefined;
    if (!this.fresh || !complete) return false;
    this.all = this.fresh;
    this.fresh = this.order = undefined;
    return true;
  }

  private seen(head: Head, now: number): Seen {
    const before = this.all?.get(head.session);
    const hasMoved = before !== undefined && before.head.lastSeq !== head.lastSeq;
    const name = head.label || head.session.slice(0, 12);
    if (before?.name !== name) this.order = undefined;
    const words = `${head.label} ${head.session} ${head.mode}`.toLowerCase();
    return { head, name, words, at: now, movedAt: hasMoved ? now : (before?.movedAt ?? 0) };
  }

  /** All in order of their names; undefined before they are complete. */
  list(): Seen[] | undefined {
    const { all } = this;
    if (!all) return undefined;
    this.order ??= [...all.values()].sort((a, b) => ORDER.compare(a.name, b.name)).map(({ head }) => head.session);
    this.listed ??= this.order.flatMap((session) => all.get(session) ?? []);
    return this.listed;
  }
}

/** Follows the fleet, and shows it at least once a second. Returns what ends it. */
function followFleet(onFleet: (fleet: Fleet) => void): () => void {
  const heads = new Heads();
  let [timer, shownAt] = [0, 0];
  let problem: Problem | undefined;

  const show = () => {
    window.clearTimeout(timer);
    timer = window.setTimeout(show, SHOW_MS);
    if (document.hidden) return;
    shownAt = Date.now();
    onFleet({ list: heads.list(), now: shownAt, problem });
  };
  const take = (message: HeadsMessage) => {
    problem = undefined;
    // Others wait for their second.
    if (heads.take(message) || shownAt + SHOW_MS <= Date.now()) show();
    return false;
  };
  const poll = polling(
    headsOf,
    (list) => {
      heads.begin();
      take({ heads: list, gone: [], complete: true });
      return pollMs(list.length);
    },
    (failure) => {
      problem = failure;
      show();
    },
  );
  const end = follow("/v1/sessions:watch", {
    opened: () => heads.begin(),
    events: { heads: (data) => take(JSON.parse(data) as HeadsMessage) },
    instead: poll,
    silenceMs: SILENCE_MS,
  });
  show();
  return () => {
    end();
    window.clearTimeout(timer);
  };
}

export function useFleet(): Fleet {
  const [fleet, setFleet] = useState<Fleet>({ now: 0 });
  useEffect(() => followFleet(setFleet), []);
  return fleet;
}
