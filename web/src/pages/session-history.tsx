/** The history of one session over a day, a week or a month. */
import { useState } from "preact/hooks";
import { session } from "../api";
import { StatusShares } from "../history/bars";
import { type Span, sessionHistory } from "../history/api";
import { useLive } from "../live";
import { Plots } from "../plots";
import { duration } from "../time";
import { Empty, Loading, ProblemBox, useTheme } from "../ui";
import { SpanChoice } from "./history";

const AGAIN_MS = 30_000;

export function SessionHistoryPage({ id }: { id: string }) {
  useTheme();
  const [span, setSpan] = useState<Span>("day");
  const known = useLive(`session:${id}`, (signal) => session(id, signal), AGAIN_MS);
  const live = useLive(`history:${id}:${span}`, (signal) => sessionHistory(id, span, signal), AGAIN_MS);
  const history = live.value;
  const problem = known.problem ?? live.problem;
  return (
    <div class="page history">
      <div>
        <p class="crumb"><a href="#/history">← History</a></p>
        <div class="title-row"><h1>{known.value?.label || id}</h1><SpanChoice span={span} onChange={setSpan} /><a href={`#/sessions/${id}`}>Open the session</a></div>
      </div>
      {problem && <ProblemBox problem={problem} what={history ? "The history is not up to date" : "The history cannot be loaded"} />}
      {!history && !problem && <Loading what="the history" />}
      {history && history.intervals.length === 0 && <Empty title="No epoch in this span of time"><p>Choose a longer span, or open the session.</p></Empty>}
      {history && history.intervals.length > 0 && (
        <>
          <section class="card">
            <div class="card-head"><h2>Status of all epochs</h2><span class="small">immediate answers, summed over {duration(history.rollupLengthS)}</span></div>
            <StatusShares statuses={history.statuses} />
          </section>
          <Plots series={history} selected={undefined} onPick={() => undefined} onZoom={() => undefined} hint="" />
        </>
      )}
    </div>
  );
}
