/** The fleet: counts by status, a list of any length, and a map. */
import { useEffect, useMemo, useRef, useState } from "preact/hooks";
import { bases } from "../api";
import { type Fleet, type Seen, useFleet } from "../fleet";
import { useLive } from "../live";
import { baseStations, ringAround, sessions } from "../map/layers";
import { Map2d } from "../map/map";
import { LOOKS, STATES, type State, lostAfterS, setLostAfterS, stateOf } from "../status";
import { ago, count, duration } from "../time";
import { Badge, Copyable, Empty, Loading, ProblemBox, Symbol, useTheme } from "../ui";
import { siteOf } from "./site";

const ROW_PX = 56;
/** Silence after which a device counts as lost (s). */
const LOST_CHOICES = [10, 60, 600, 3600];
/** Number of lost devices whose names are shown. */
const NAMED = 6;

/** A session with its present state. */
interface Device extends Seen {
  state: State;
  /** Seconds since its last epoch; null before the first. */
  ageS: number | null;
  /** Whether epochs arrive, even with old time tags. */
  isArriving: boolean;
}

/**
 * The sessions with their states. A device is not lost while its epochs arrive, even if their time
 * tags are old: it sends epochs of an outage, or plays a recording.
 */
function devicesOf({ list = [], now }: Fleet, lostAfterS: number): Device[] {
  return list.map((seen) => {
    const { head, at, movedAt } = seen;
    const ageS = head.ageS === null ? null : head.ageS + Math.max(0, now - at) / 1000;
    const isArriving = movedAt !== 0 && now - movedAt < lostAfterS * 1000;
    return { ...seen, ageS, isArriving, state: stateOf({ ...head, ageS }, isArriving ? Infinity : lostAfterS) };
  });
}

export function FleetPage() {
  useTheme();
  const fleet = useFleet();
  const stations = useLive("fleet-bases", bases, 15_000);
  const [lostAfter, setLostAfter] = useState(lostAfterS);
  const [text, setText] = useState("");
  const [chosen, setChosen] = useState<ReadonlySet<State>>(new Set());
  const [hovered, setHovered] = useState<string>();
  const devices = useMemo(() => devicesOf(fleet, lostAfter), [fleet, lostAfter]);

  const counts = useMemo(() => {
    const counts = new Map<State, number>();
    for (const { state } of devices) counts.set(state, (counts.get(state) ?? 0) + 1);
    return counts;
  }, [devices]);
  const shown = useMemo(() => {
    const wanted = text.trim().toLowerCase();
    return devices
      .filter(({ state, words }) => (chosen.size === 0 || chosen.has(state)) && words.includes(wanted))
      .sort((a, b) => urgency(a.state) - urgency(b.state)); // Then by name.
  }, [devices, text, chosen]);

  const sites = useMemo(() => (stations.value?.bases ?? []).flatMap((base) => {
    const at = siteOf(base);
    return at ? [{ id: `base:${base.base}`, at, label: base.label || "base" }] : [];
  }), [stations.value]);

  const toggle = (state: State) => {
    const next = new Set(chosen);
    if (!next.delete(state)) next.add(state);
    setChosen(next);
  };
  const choose = (s: number) => {
    setLostAfterS(s);
    setLostAfter(s);
  };

  if (!fleet.list) {
    return (
      <div class="page">
        <h1>Fleet</h1>
        {fleet.problem ? <ProblemBox problem={fleet.problem} what="The fleet cannot be loaded" /> : <Loading what="the fleet" />}
      </div>
    );
  }
  if (devices.length === 0) return <NoSessions />;
  return (
    <div class="fleet">
      <div class="fleet-top">
        <div class="title-row">
          <h1>Fleet <span class="count">{count(devices.length)} {devices.length === 1 ? "session" : "sessions"}</span></h1>
          <label class="lost-after">Lost after{" "}
            <select value={lostAfter} onChange={(event) => choose(Number(event.currentTarget.value))}>
              {LOST_CHOICES.map((s) => <option key={s} value={s}>{duration(s)}</option>)}
            </select>
          </label>
        </div>
        {fleet.problem && <ProblemBox problem={fleet.problem} what="The fleet is not up to date" />}
        <div class="chips" role="group" aria-label="Filter by status; the symbols are those of the map">
          {STATES.filter((state) => counts.has(state) || chosen.has(state)).map((state) => (
            <button key={state} type="button" class="chip" aria-pressed={chosen.has(state)} title={LOOKS[state].meaning} onClick={() => toggle(state)}>
              <Symbol state={state} size={15} />
              <span>{LOOKS[state].name}</span>
              <b>{count(counts.get(state) ?? 0)}</b>
            </button>
          ))}
          {chosen.size > 0 && <button type="button" class="quiet" onClick={() => setChosen(new Set())}>Show all</button>}
        </div>
        <LostDevices devices={devices.filter(({ state }) => state === "LOST")} onAll={() => setChosen(new Set(["LOST"]))} />
      </div>
      <div class="fleet-body">
        <section class="fleet-list" aria-label="Sessions">
          <div class="search">
            <input type="search" placeholder="Find by name, id or mode" aria-label="Find by name, id or mode" value={text} onInput={(event) => setText(event.currentTarget.value)} />
            <span class="small" role="status">{count(shown.length)} of {count(devices.length)}</span>
          </div>
          <List devices={shown} lostAfterS={lostAfter} hovered={hovered} />
        </section>
        <FleetMap devices={shown} sites={sites} lostAfterS={lostAfter} hovered={hovered} onHover={setHovered} />
      </div>
    </div>
  );
}

/** The order of the counts: states that need attention first, those that are not live last. */
const urgency = (state: State): number =>
  state === "LOST" || state === "NONE" ? 0 : state === "NEW" || state === "CLOSED" ? 2 : 1;

function LostDevices({ devices, onAll }: { devices: Device[]; onAll: () => void }) {
  if (devices.length === 0) return null;
  const sorted = [...devices].sort((a, b) => (a.ageS ?? 0) - (b.ageS ?? 0));
  return (
    <p class="lost" role="status">
      <Symbol state="LOST" size={16} />
      <strong>{devices.length === 1 ? "One device is lost:" : `${count(devices.length)} devices are lost:`}</strong>
      {sorted.slice(0, NAMED).map(({ head, name, ageS }) => (
        <a key={head.session} href={`#/sessions/${head.session}`}>{name} <span class="small">{ago(ageS ?? 0)}</span></a>
      ))}
      {NAMED < devices.length && <button type="button" class="quiet" onClick={onAll}>and {count(devices.length - NAMED)} more</button>}
    </p>
  );
}

/** A list of any length: the page contains only the visible rows. */
function List({ devices, lostAfterS, hovered }: { devices: Device[]; lostAfterS: number; hovered?: string }) {
  const box = useRef<HTMLDivElement>(null);
  const [top, setTop] = useState(0);
  const [height, setHeight] = useState(600);
  useEffect(() => {
    if (!box.current) return undefined;
    const sized = new ResizeObserver(([entry]) => setHeight(entry.contentRect.height));
    sized.observe(box.current);
    return () => sized.disconnect();
  }, []);
  const first = Math.max(0, Math.floor(top / ROW_PX) - 6);
  const rows = devices.slice(first, first + Math.ceil(height / ROW_PX) + 12);
  const key = (event: KeyboardEvent) => {
    const links = [...(box.current?.querySelectorAll<HTMLAnchorElement>("a.device") ?? [])];
    const at = links.indexOf(document.activeElement as HTMLAnchorElement);
    const step = event.key === "ArrowDown" ? 1 : event.key === "ArrowUp" ? -1 : 0;
    if (step === 0 || at < 0) return;
    event.preventDefault();
    links[at + step]?.focus();
  };
  return (
    <div class="scroll" ref={box} onScroll={(event) => setTop(event.currentTarget.scrollTop)} onKeyDown={key}>
      <ul style={{ height: `${devices.length * ROW_PX}px` }}>
        {rows.map((device, i) => (
          <li key={device.head.session} style={{ transform: `translateY(${(first + i) * ROW_PX}px)` }}>
            <Row device={device} lostAfterS={lostAfterS} hovered={device.head.session === hovered} />
          </li>
        ))}
      </ul>
      {devices.length === 0 && <p class="nothing">No session matches the filter.</p>}
    </div>
  );
}

/** The time of a device's last epoch. */
const ageOf = ({ ageS, isArriving }: Device, lostAfterS: number): string =>
  ageS === null ? "–" : isArriving && lostAfterS < ageS ? "receiving" : ago(ageS);

function Row({ device, lostAfterS, hovered }: { device: Device; lostAfterS: number; hovered: boolean }) {
  const { head, state, name } = device;
  return (
    <a class={`device ${hovered ? "hovered" : ""}`} href={`#/sessions/${head.session}`}>
      <Symbol state={state} size={18} />
      <span class="device-name">{name}</span>
      <span class="device-mode">{head.mode}{head.lastSeq !== null && ` · epoch ${count(head.lastSeq)}`}</span>
      <span class="device-state">{LOOKS[state].name}</span>
      <span class="device-age">{ageOf(device, lostAfterS)}</span>
    </a>
  );
}

interface FleetMapProps {
  devices: Device[];
  sites: { id: string; at: { lon: number; lat: number }; label: string }[];
  lostAfterS: number;
  hovered?: string;
  onHover: (id: string | undefined) => void;
}

function FleetMap({ devices, sites, lostAfterS, hovered, onHover }: FleetMapProps) {
  const theme = useTheme();
  const placed = useMemo(() => devices.flatMap(({ head: { session, position }, state, name }) =>
    position ? [{ id: session, at: { lon: position.longitudeDeg, lat: position.latitudeDeg }, state, label: name }] : [],
  ), [devices]);
  const frame = useMemo(() => (placed.length ? placed : sites).map(({ at }) => at), [placed, sites]);
  const below = useMemo(() => baseStations(sites), [sites, theme]);
  const above = useMemo(() => sessions(placed), [placed, theme]);
  const marked = placed.find(({ id }) => id === hovered);
  const ring = useMemo(() => (marked ? [ringAround(marked, placed.length)] : []), [marked, theme]);
  const layers = useMemo(() => [below, above, ...ring], [below, above, ring]);
  const pick = (id: string | undefined) => {
    if (id && !id.startsWith("base:")) location.hash = `#/sessions/${id}`;
    else if (id) location.hash = "#/bases";
  };
  const device = hovered ? devices.find(({ head }) => head.session === hovered) : undefined;
  return (
    <Map2d label="Map of the fleet" layers={layers} frame={frame} frameKey="fleet" smallestM={400} onPick={pick} onHover={onHover}>
      {device && (
        <div class="map-note"><Badge state={device.state} /> <b>{device.name}</b> <span class="small">{device.head.mode} · {ageOf(device, lostAfterS)}</span></div>
      )}
      {placed.length === 0 && <div class="map-note">No session has a position yet.</div>}
    </Map2d>
  );
}

function NoSessions() {
  const origin = location.origin;
  return (
    <div class="page">
      <h1>Fleet</h1>
      <Empty title="No session yet">
        <p>A session is one receiver. Push ephemerides, then play a receiver's file or let a device stream:</p>
        <Copyable label="Push ephemerides" text={`curl ${origin}/v1/navigation -H 'content-type: application/octet-stream' --data-binary @FILE.nav`} />
        <Copyable label="Play a receiver's file" text={`graphfix stream --rover FILE.obs --server ${origin} --mode fgo --speed 10`} />
        <p>No data at hand? <code>graphfix simulate --scenario urban-canyon --output sim</code> makes some, and <code>graphfix demo</code> shows a whole fleet. The <a href="#/api">API page</a> has more.</p>
      </Empty>
    </div>
  );
}

