/** The track of a session as a file, in every format. */
import { useState } from "preact/hooks";
import { type Series, gpsText } from "../api";
import { FORMATS, RINEX } from "../formats";

interface DownloadProps {
  session: string;
  series: Series | undefined;
  /** The epochs that the map shows. */
  revision: "both" | "first" | "last";
}

/** Formats that tell the revisions of an epoch apart. */
const WITH_REVISIONS = new Set(["csv", "geojson", "parquet"]);

export function Download({ session, series, revision }: DownloadProps) {
  const [whole, setWhole] = useState(false);
  const of = `/v1/sessions/${encodeURIComponent(session)}`;
  const span = (parameters: URLSearchParams) => {
    if (!whole && series?.from && series.to) {
      parameters.set("from", gpsText(series.from));
      parameters.set("to", gpsText(series.to));
    }
    return parameters;
  };
  const query = (format: string) => {
    const both = WITH_REVISIONS.has(format) ? "all" : "last";
    return `${of}/track.${format}?${span(new URLSearchParams({ revisions: revision === "both" ? both : revision }))}`;
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
      <a class="quiet" href={`${of}/solutions?${span(new URLSearchParams({ format: RINEX.format }))}`} download title={RINEX.meaning}>{RINEX.name}</a>
    </div>
  );
}
