/** Which satellites have ephemerides, and for how long. */
import { type NavigationStatus, navigation } from "../api";
import { useLive } from "../live";
import { CONSTELLATIONS, constellationColour } from "../status";
import { clock, count, duration, unixS, utc } from "../time";
import { Because, Copyable, Empty, Lamp, Loading, ProblemBox, useTheme } from "../ui";

const HOUR = 3600;
/** The span that the bars show around now (s). */
const [BEFORE, AFTER] = [2 * HOUR, 6 * HOUR];
/** Coverage that ends within this time is about to end (s). */
const SOON = 0.5 * HOUR;

type Coverage = NavigationStatus["satellites"][number];
type Validity = "covered" | "soon" | "expired" | "later" | "unhealthy";

function validity({ coveredFrom, coveredUntil }: Coverage, now: number): Validity {
  if (!coveredFrom || !coveredUntil) return "unhealthy";
  if (unixS(coveredUntil) < now) return "expired";
  if (now < unixS(coveredFrom)) return "later";
  return unixS(coveredUntil) < now + SOON ? "soon" : "covered";
}

export function EphemeridesPage() {
  useTheme();
  const live = useLive("navigation", navigation, 10_000);
  if (!live.value) {
    return <div class="page"><h1>Ephemerides</h1>{live.problem ? <ProblemBox problem={live.problem} what="The ephemerides cannot be loaded" /> : <Loading what="the ephemerides" />}</div>;
  }
  const now = Date.now() / 1000;
  const { satellites, sources, ephemerides, ionosphereModels } = live.value;
  const letters = Object.keys(CONSTELLATIONS).filter((letter) => satellites.some(({ satellite }) => satellite[0] === letter));
  const covered = satellites.filter((satellite) => ["covered", "soon"].includes(validity(satellite, now)));
  return (
    <div class="page">
      <h1>Ephemerides <span class="count">{count(covered.length)} of {count(satellites.length)} satellites covered now</span></h1>
      {live.problem && <ProblemBox problem={live.problem} what="The ephemerides are not up to date" />}
      {satellites.length === 0 && <NoEphemerides />}
      {satellites.length > 0 && covered.length === 0 && (
        <p class="banner">No ephemeris is valid now. Recordings of their own time are positioned all the same: they cover {span(satellites)}.</p>
      )}
      <div class="totals">
        {letters.map((letter) => {
          const own = satellites.filter(({ satellite }) => satellite[0] === letter);
          const good = own.filter((satellite) => ["covered", "soon"].includes(validity(satellite, now)));
          return (
            <div key={letter} class="card total">
              <b><i class="dot" style={{ background: constellationColour(letter) }} />{CONSTELLATIONS[letter].name}</b>
              <span class="big">{good.length}<small> of {own.length}</small></span>
              <span class="small">covered now</span>
            </div>
          );
        })}
        {satellites.length > 0 && (
          <div class="card total">
            <b>In force</b><span class="big">{count(ephemerides)}</span>
            <span class="small">ephemerides; ionosphere: {ionosphereModels.join(", ") || "no model"}</span>
          </div>
        )}
      </div>
      {letters.map((letter) => <Constellation key={letter} letter={letter} satellites={satellites.filter(({ satellite }) => satellite[0] === letter)} now={now} pivot={covered.length ? now : start(satellites)} />)}
      {sources.length > 0 && (
        <section class="card">
          <h2>Sources of the operator</h2>
          {sources.map((source) => (
            <div key={source.name} class="source">
              <Lamp health={["CURRENT", "STREAMING"].includes(source.state) ? "good" : source.state === "WAITING" ? "bad" : "warn"} words={source.state.toLowerCase()} />
              <code class="break">{source.name}</code>
              <span class="small">{source.kind}, {count(source.ephemerides)} ephemerides{source.lastUtc && `, last at ${source.lastUtc.slice(11, 19)} UTC`}{source.retryInS !== null && `, next attempt in ${duration(source.retryInS)}`}</span>
              {source.problem && <Because refusal={source.problem} tone="bad" />}
            </div>
          ))}
        </section>
      )}
    </div>
  );
}

function span(satellites: Coverage[]): string {
  const from = Math.min(...satellites.map(({ coveredFrom }) => (coveredFrom ? unixS(coveredFrom) : Infinity)));
  const until = Math.max(...satellites.map(({ coveredUntil }) => (coveredUntil ? unixS(coveredUntil) : -Infinity)));
  return Number.isFinite(from) && Number.isFinite(until) ? `${utc(from)} to ${utc(until)} UTC` : "no healthy time";
}

const WORDS: Record<Validity, string> = {
  covered: "valid", soon: "ends soon", expired: "expired", later: "valid later", unhealthy: "no healthy one",
};

/** Where the bars begin if nothing is valid now: near the first ephemeris. */
const start = (satellites: Coverage[]): number =>
  Math.min(...satellites.map(({ coveredFrom }) => (coveredFrom ? unixS(coveredFrom) : Infinity))) + HOUR;

interface ConstellationProps {
  letter: string;
  satellites: Coverage[];
  now: number;
  /** The time at a quarter of the bars. */
  pivot: number;
}

function Constellation({ letter, satellites, now, pivot }: ConstellationProps) {
  const x = (time: number) => Math.max(0, Math.min(1, (time - pivot + BEFORE) / (BEFORE + AFTER))) * 100;
  const hours = [-1, 0, 1, 2, 3, 4, 5];
  return (
    <section class="card coverage" aria-label={CONSTELLATIONS[letter].name}>
      <div class="card-head">
        <h2><i class="dot" style={{ background: constellationColour(letter) }} />{CONSTELLATIONS[letter].name}</h2>
        <span class="small">{pivot === now ? `bars from ${clock(now - BEFORE)} to ${clock(now + AFTER)}, now is ${clock(now)} UTC` : `bars from ${utc(pivot - BEFORE)} UTC, 8 h`}</span>
      </div>
      <ul class="coverage-rows">
        {satellites.map((one) => {
          const state = validity(one, now);
          const until = one.coveredUntil ? unixS(one.coveredUntil) - now : 0;
          const words = state === "covered" || state === "soon" ? `${duration(until)} left` : WORDS[state];
          const [from, to] = one.coveredFrom && one.coveredUntil ? [x(unixS(one.coveredFrom)), x(unixS(one.coveredUntil))] : [0, 0];
          return (
            <li key={one.satellite} title={`${one.satellite}: ${WORDS[state]}, ${one.ephemerides} ephemerides, source ${one.source}`}>
              <span class="sat">{one.satellite}</span>
              <svg class="coverage-bar" viewBox="0 0 100 10" preserveAspectRatio="none" aria-hidden="true">
                <rect width="100" height="10" class="bar-back" />
                {hours.map((hour) => <rect key={hour} class="hour" x={x(pivot + hour * HOUR) - 0.1} width="0.2" height="10" />)}
                <rect class={`valid ${state}`} x={from} y="2.5" width={Math.max(0, to - from)} height="5" fill={constellationColour(letter)} />
                {pivot === now && <rect class="now" x={x(now) - 0.3} width="0.6" height="10" />}
              </svg>
              <span class={`left ${state}`}>{words}</span>
            </li>
          );
        })}
      </ul>
    </section>
  );
}

function NoEphemerides() {
  const origin = location.origin;
  return (
    <Empty title="No ephemeris yet">
      <p>Without ephemerides no satellite has a position, and every answer is <b>NONE</b>. Push a RINEX navigation file, or let the service fetch them:</p>
      <Copyable label="Push a navigation file" text={`curl ${origin}/v1/navigation -H 'content-type: application/octet-stream' --data-binary @FILE.nav`} />
      <Copyable label="Fetch from an archive" text={"graphfix serve --nav-archive 'https://archive.example.org/{yyyy}/{ddd}/BRDC00WRD_R_{yyyy}{ddd}0000_01D_MN.rnx.gz'"} />
    </Empty>
  );
}
