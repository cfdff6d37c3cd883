/** Base stations and casters with their health. */
import { useMemo } from "preact/hooks";
import { type Base, type Network, type Refusal, bases } from "../api";
import { useLive } from "../live";
import { baseStations } from "../map/layers";
import { Map2d } from "../map/map";
import { ago, bytes, count, duration, length } from "../time";
import { Because, Copyable, Empty, type Health, Lamp, Loading, ProblemBox, useTheme } from "../ui";
import { siteOf } from "./site";

/** Age of the newest epoch after which a base counts as silent (s). */
const SILENT_S = 30;

function health(base: Base): { health: Health; words: string } {
  const state = base.feed?.state ?? base.archive?.state;
  const problem = base.feed?.problem ?? base.archive?.problem;
  if (base.positionCheck.verdict === "REFUSED") return { health: "bad", words: "position refused" };
  if (base.positionCheck.verdict === "DOUBTFUL") return { health: "warn", words: "position doubtful" };
  if (state === "WAITING") return { health: "bad", words: problem ? "failing" : "waiting" };
  if (state === "IDLE") return { health: "idle", words: "idle: no rover needs it" };
  if (state === "CONNECTING" || state === "FETCHING") return { health: "warn", words: state.toLowerCase() };
  if (base.epochs === 0) return { health: "idle", words: "no epoch yet" };
  if (base.feed && SILENT_S < (base.feed.silentS ?? Infinity)) return { health: "bad", words: "silent" };
  if (!base.archive && SILENT_S < (base.ageS ?? Infinity)) return { health: "warn", words: "silent" };
  return { health: "good", words: base.archive ? "current" : "receiving" };
}

export function BasesPage() {
  const theme = useTheme();
  const live = useLive("bases", bases, 3000);
  const sites = useMemo(() => sitesOf(live.value?.bases ?? []), [live.value]);
  const layers = useMemo(() => [baseStations(sites)], [sites, theme]);
  const frame = useMemo(() => sites.map(({ at }) => at), [sites]);
  if (!live.value) {
    return <div class="page"><h1>Bases</h1>{live.problem ? <ProblemBox problem={live.problem} what="The bases cannot be loaded" /> : <Loading what="the bases" />}</div>;
  }
  const { bases: list, networks } = live.value;
  const reveal = (id: string | undefined) => document.getElementById(id ?? "")?.scrollIntoView({ block: "center" });
  return (
    <div class="page">
      <h1>Bases <span class="count">{count(list.length)}</span></h1>
      {live.problem && <ProblemBox problem={live.problem} what="The bases are not up to date" />}
      {list.length === 0 && networks.length === 0 && <NoBases />}
      {sites.length > 0 && (
        <section class="card map-card low" aria-label="Map">
          <Map2d label="Map of the bases" layers={layers} frame={frame} frameKey="bases" smallestM={2000} calmWheel onPick={reveal} />
        </section>
      )}
      <div class="cards">{list.map((base) => <BaseCard key={base.base} base={base} />)}</div>
      {networks.length > 0 && (
        <>
          <h2>Networks</h2>
          <p class="small">Casters whose nearest stream is connected while a rover needs it.</p>
          <div class="cards">{networks.map((network) => <NetworkCard key={network.caster} network={network} />)}</div>
        </>
      )}
    </div>
  );
}

function sitesOf(list: Base[]) {
  return list.flatMap((base) => {
    const at = siteOf(base);
    return at ? [{ id: base.base, at, label: base.label || base.base.slice(0, 10) }] : [];
  });
}

function BaseCard({ base }: { base: Base }) {
  const { health: state, words } = health(base);
  const site = siteOf(base);
  const { distanceM, verdict, epochs } = base.positionCheck;
  const refusals = [base.feed?.problem, base.feed?.refusal, base.archive?.problem, base.archive?.refusal];
  const troubled = refusals.filter((refusal): refusal is Refusal => Boolean(refusal));
  const source = base.feed ? `caster ${base.feed.caster} / ${base.feed.mountpoint}` : base.archive ? `archive ${base.archive.template}` : "uploads and pushes";
  return (
    <article class="card base" id={base.base}>
      <div class="card-head"><h2>{base.label || "Base"}</h2><Lamp health={state} words={words} /></div>
      <p class="small id"><code>{base.base}</code></p>
      <dl class="rows">
        <dt>Newest epoch</dt><dd>{base.ageS === null ? "none" : `stored ${ago(base.ageS)}`}</dd>
        <dt>Satellites</dt><dd>{base.satellites}</dd>
        <dt>Stored epochs</dt><dd>{count(base.epochs)}</dd>
        <dt>Position</dt>
        <dd>{site ? `${site.lat.toFixed(6)}°, ${site.lon.toFixed(6)}°, ${site.heightM.toFixed(1)} m` : "unknown yet"}{base.site && ` (${base.site.source})`}</dd>
        <dt>Checked</dt>
        <dd>{epochs === 0 ? "not yet: needs ephemerides" : `${verdict.toLowerCase()}: ${length(distanceM)} from its own single points`}</dd>
        {base.site?.antenna && <><dt>Antenna</dt><dd>{base.site.antenna}</dd></>}
        <dt>Source</dt><dd class="break">{source}</dd>
        {base.feed && <><dt>Connection</dt><dd>{base.feed.state.toLowerCase()} since {since(base.feed.sinceUtc)}, {count(base.feed.connections)} of {count(base.feed.attempts)} requests granted, {bytes(base.feed.bytes)}</dd></>}
        {base.feed?.retryInS != null && <><dt>Next attempt</dt><dd>in {duration(base.feed.retryInS)}</dd></>}
        {base.archive && <><dt>Files</dt><dd>{count(base.archive.files)} fetched, {count(base.archive.missing)} missing</dd></>}
        {base.archive?.retryInS != null && <><dt>Next attempt</dt><dd>in {duration(base.archive.retryInS)}</dd></>}
      </dl>
      {troubled.map((refusal) => <Because key={refusal.code} refusal={refusal} tone={state === "bad" ? "bad" : "warn"} />)}
    </article>
  );
}

function NetworkCard({ network }: { network: Network }) {
  const troubled = [network.problem, network.refusal].filter((refusal): refusal is Refusal => Boolean(refusal));
  return (
    <article class="card">
      <div class="card-head"><h2 class="break">{network.caster}</h2><Lamp health={network.state === "CURRENT" ? "good" : network.state === "WAITING" ? "bad" : "warn"} words={network.state.toLowerCase()} /></div>
      <dl class="rows">
        <dt>Streams</dt><dd>{count(network.usable)} of {count(network.listed)} usable</dd>
        <dt>Connected</dt><dd>{count(network.connected)}</dd>
        <dt>Table</dt><dd>{network.lastUtc ? `received ${since(network.lastUtc)} ago` : "not received yet"}</dd>
        {network.retryInS !== null && <><dt>Next attempt</dt><dd>in {duration(network.retryInS)}</dd></>}
      </dl>
      {troubled.map((refusal) => <Because key={refusal.code} refusal={refusal} tone="bad" />)}
    </article>
  );
}

const since = (utc: string): string => duration(Math.max(0, (Date.now() - Date.parse(utc)) / 1000));

function NoBases() {
  const origin = location.origin;
  return (
    <Empty title="No base station yet">
      <p>Modes rtk-fgo and rtk-ekf position relative to a base. Create one from a caster's stream, or upload a file:</p>
      <Copyable label="A base from an NTRIP caster" text={`curl ${origin}/v1/bases -H 'content-type: application/json' \\\n  -d '{"ntrip": {"caster": "ntrip://caster.example.org:2101", "mountpoint": "ROOF0", "user": "me", "password": "…"}}'`} />
      <Copyable label="A base from a file" text={`curl ${origin}/v1/bases -H 'content-type: application/json' -d '{"label": "roof"}'\ncurl ${origin}/v1/bases/bas_…/observations -H 'content-type: application/octet-stream' --data-binary @base.obs`} />
      <p>The service connects only to hosts that the operator lists: <code>graphfix serve --fetch-host caster.example.org</code>.</p>
    </Empty>
  );
}

