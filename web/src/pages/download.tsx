/** The track of a session as a file, in every format. */
import { useState } from "preact/hooks";
import { type Series, gpsText } from "../api";
import { FORMATS } from "../formats";

interface DownloadProps {
  session: string;
  series: Series | undefined;
  /** What the map shows. */
  revision: "both" | "first" | "last";
}

/** Formats that tell the revisions of an epoch apart. */
const WITH_REVISIONS = new Set(["csv", "geojson"]);

export function Download({ session, series, revision }: DownloadProps) {
  const [whole, setWhole] = useState(false);
  const query = (format: string) => {
    const both = WITH_REVISIONS.has(format) ? "all" : "last";
    const parameters = new URLSearchParams({ revisions: revision === "both" ? both : revision });
    if (!whole && series?.from && series.to) {
      parameters.set("from", gpsText(series.from));
      parameters.set("to", gpsText(series.to));
    }
    return `/v1/sessions/${encodeURIComponent(session)}/track.${format}?${parameters}`;
  };
  return (
    <div class="download">
      <label>Download <select value={whole ? "whole" : "span"} onChange={({ currentTarget }) => setWhole(currentTarget.value === "whole")}>
        <option value="span">the span shown</option>
        <option value="whole">the whole session</option>
      </select> as</label>
      {FORMATS.map(({ format, name, meaning }) => (
        <a key={format} class="quiet" href={query(format)} download title={meaning}>{name}</a>
      ))}
    </div>
  );
}
