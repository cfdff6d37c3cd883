/** The history of the fleet over a day, a week or a month. */
import { useState } from "preact/hooks";
import { FleetBars, SessionBars, StatusBar, StatusShares } from "../history/bars";
import { type FleetHistory, SPANS, type SessionSummary, type Span, fleetHistory, sessionHistories } from "../history/api";
import { useLive } from "../live";
import { count, duration, length, unixS, utc } from "../time";
import { Empty, Figure, Loading, ProblemBox, Segments, useTheme } from "../ui";

/** Sessions that the list shows at first, and more at each request. */
const STEP = 100;
const AGAIN_MS = 30_000;

/** The choice of a span, which the pages of the history have in common. */
export function SpanChoice({ span, onChange }: { span: Span; onChange: (span: Span) => void }) {
  return <Segments label="Span of time" value={span} options={SPANS} onChange={onChange} />;
}

export function HistoryPage() {
  useTheme();
  const [span, setSpan] = useState<Span>("day");
  const [wanted, setWanted] = useState(STEP);
  const fleet = useLive(`fleet history:${span}`, (signal) => fleetHistory(span, signal), AGAIN_MS);
  const list = useLive(`histories:${span}:${wanted}`, (signal) => sessionHistories(span, wanted, signal), AGAIN_MS);
  const problem = fleet.problem ?? list.problem;
  return (
    <div class="page history">
      <div class="title-row"><h1>History</h1><SpanChoice span={span} onChange={setSpan} /></div>
      {problem && <ProblemBox problem={problem} what={fleet.value ? "The history is not up to date" : "The history cannot be loaded"} />}
      {!fleet.value && !problem && <Loading what="the history" />}
      {fleet.value && fleet.value.intervals.length === 0 && <NoHistory />}
      {fleet.value && fleet.value.intervals.length > 0 && <OverTime fleet={fleet.value} />}
      {list.value && list.value.sessions.length > 0 && (
        <section class="card" aria-label="Sessions with epochs in this span">
          <h2>Sessions</h2>
          <Sessions sessions={list.value.sessions} />
          {list.value.more && <p><button type="button" class="quiet" onClick={() => setWanted(wanted + STEP)}>Show more</button></p>}
        </section>
      )}
    </div>
  );
}

/** Intervals begin at full hours of GPS time, some seconds before those of UTC. */
const minute = (unix: number): string => utc(60 * Math.round(unix / 60));

function OverTime({ fleet }: { fleet: FleetHistory }) {
  const { intervals, intervalLengthS, statuses } = fleet;
  const [begin, end] = [unixS(fleet.from), unixS(fleet.to)];
  const slots = Math.max(1, Math.round((end - begin) / intervalLengthS));
  const solutions = statuses.reduce((sum, { solutions }) => sum + solutions, 0);
  const most = Math.max(...intervals.map(({ sessions }) => sessions));
  const last = intervals[intervals.length - 1];
  return (
    <section class="card" aria-label="Fleet over time">
      <div class="card-head">
        <h2>Fleet over time</h2>
        <span class="small">immediate answers in intervals of {duration(intervalLengthS)}, {minute(begin).slice(0, 16)} to {minute(end).slice(0, 16)} UTC</span>
      </div>
      <dl class="figures">
        <Figure name="Epochs" value={count(solutions)} />
        <Figure name="Sessions at work, at most" value={count(most)} hint="in one hour" />
        <Figure name="Mean σ horizontal, last interval" value={length(last.horizontalSigmaMeanM)} />
        <Figure name="Mean satellites, last interval" value={last.satellitesMean === null ? "–" : last.satellitesMean.toFixed(1)} />
      </dl>
      <div class="history-grid">
        <div>
          <h3>Status</h3>
          <FleetBars intervals={intervals} slots={slots} />
          <h3>Sessions at work <span class="small">the highest bar is {count(most)}</span></h3>
          <SessionBars intervals={intervals} slots={slots} />
          <p class="ends small"><span>{minute(begin).slice(5, 16)}</span><span>{minute(end).slice(5, 16)}</span></p>
        </div>
        <div><h3>Of all epochs</h3><StatusShares statuses={statuses} /></div>
      </div>
    </section>
  );
}

function Sessions({ sessions }: { sessions: SessionSummary[] }) {
  return (
    <div class="table-box" tabIndex={0} role="region" aria-label="Table of sessions">
      <table>
        <thead><tr><th scope="col">Session</th><th scope="col">Status</th><th scope="col" class="number">Epochs</th><th scope="col" class="number">σ horizontal, mean</th><th scope="col" class="number">largest</th><th scope="col" class="number">Satellites</th><th scope="col" class="number">Age</th><th scope="col">Last epoch</th></tr></thead>
        <tbody>
          {sessions.map((one) => (
            <tr key={one.session}>
              <th scope="row"><a href={`#/history/${one.session}`}>{one.label || one.session}</a> <span class="small">{one.mode}</span></th>
              <td><StatusBar statuses={one.statuses} /></td>
              <td class="number">{count(one.solutions)}</td>
              <td class="number">{length(one.horizontalSigmaMeanM)}</td>
              <td class="number">{length(one.horizontalSigmaMaxM)}</td>
              <td class="number">{one.satellitesMean === null ? "–" : one.satellitesMean.toFixed(1)}</td>
              <td class="number">{one.ageMeanS === null ? "–" : duration(one.ageMeanS)}</td>
              <td class="number">{utc(unixS(one.lastTime)).slice(0, 16)}</td>
            </tr>
          ))}
        </tbody>
      </table>
    </div>
  );
}

function NoHistory() {
  return (
    <Empty title="No epoch in this span of time">
      <p>The history counts epochs by their own time, hour by hour, since the service keeps one. Choose a longer span, or see the <a href="#/fleet">fleet</a>: what is older can be read on the page of each session.</p>
    </Empty>
  );
}
