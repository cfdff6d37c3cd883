/**
 * The latest head of each session. A stream brings the heads; without a stream the page polls.
 *
 * Ages grow even if nothing arrives, so the page is drawn at least once a second. It is drawn at
 * most once a second, too: a fleet of ten thousand devices sends thousands of heads a second.
 */
import { useEffect, useState } from "preact/hooks";
import { type Head, type Problem, heads as headsOf } from "./api";
import { follow, polling } from "./live";

/** A session with its latest head. */
export interface Seen {
  head: Head;
  name: string;
  /** The text that the filter searches. */
  words: string;
  /** When the head arrived (ms since 1970). The age in the head holds for this time. */
  at: number;
  /** When the page last received a new epoch (ms since 1970); 0 before the first. */
  movedAt: number;
}

export interface Fleet {
  /** All sessions in order of their names; undefined before they have arrived. */
  list?: Seen[];
  /** The time for which states and ages are computed (ms since 1970). */
  now: number;
  problem?: Problem;
}

interface HeadsMessage {
  heads: Head[];
  gone: string[];
  complete: boolean;
}

const SHOW_MS = 1000;
/** Silence after which the stream counts as broken. The service sends something every 15 s. */
const SILENCE_MS = 40_000;
const ORDER = new Intl.Collator("en", { numeric: true });

/** Time between two polls (ms): longer for larger fleets. */
const pollMs = (sessions: number): number => (sessions < 500 ? 2000 : sessions < 3000 ? 5000 : 10_000);

/** The heads from the messages so far. */
class Heads {
  private all: Map<string, Seen> | undefined;
  /** The sessions of the first messages of a stream, until these messages are complete. */
  private fresh: Map<string, Seen> | undefined;
  /** Ids in the order of the names; undefined after a name has changed. */
  private order: string[] | undefined;
  private listed: Seen[] | undefined;

  /** A new stream begins. Its first messages contain all existing sessions. */
  begin(): void {
    this.fresh = new Map();
  }

  /** Takes a message; true if the first messages are now complete. */
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

  /** All sessions in the order of their names; undefined before the first messages are complete. */
  list(): Seen[] | undefined {
    const { all } = this;
    if (!all) return undefined;
    this.order ??= [...all.values()].sort((a, b) => ORDER.compare(a.name, b.name)).map(({ head }) => head.session);
    this.listed ??= this.order.flatMap((session) => all.get(session) ?? []);
    return this.listed;
  }
}

/** Follows the fleet, and shows it at least once a second. Returns a function that ends this. */
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
    // Other messages are shown when a second has passed.
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
