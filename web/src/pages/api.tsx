/** Links to the description of the API, and first calls with the address of this service. */
import { useContext } from "preact/hooks";
import { SignedIn } from "../rights";
import { Copyable } from "../ui";

export function ApiPage() {
  const { origin, host } = location;
  const { needed } = useContext(SignedIn);
  // The key stays in the shell, so that nothing secret is copied from here.
  const key = needed ? ' -H "authorization: Bearer $GRAPHFIX_KEY"' : "";
  const json = `${key} -H 'content-type: application/json'`;
  const bytes = `${key} -H 'content-type: application/octet-stream'`;
  const tls = origin.startsWith("https:") ? "" : " -plaintext";
  const port = host.includes(":") ? host : `${host}:${tls ? 80 : 443}`;
  const grpcurl = `grpcurl${tls}${key}`;
  return (
    <div class="page api">
      <h1>API</h1>
      <p class="lead">One port serves gRPC, HTTP/1.1 and HTTP/2. Every gRPC call of <code>graphfix.v1</code> has a REST twin with the same names.</p>
      <div class="cards links">
        <a class="card link" href="/docs/"><h2>REST, to read and to try</h2><p>Every call with its parameters and answers</p></a>
        <a class="card link" href="/openapi.json"><h2>openapi.json</h2><p>The same as OpenAPI 3.1, for generators of clients</p></a>
        <a class="card link" href="/readyz"><h2>readyz</h2><p>Whether epochs can be taken and committed, and if not, why</p></a>
        <a class="card link" href="/metrics"><h2>metrics</h2><p>Counters and gauges of the service, for Prometheus</p></a>
        <a class="card link" href="/licences.txt"><h2>Licences</h2><p>Of the libraries in this dashboard</p></a>
      </div>
      {needed && <p class="note">Calls need a key. The examples take it from the shell: <code>export GRAPHFIX_KEY=gfx_…</code></p>}
      <section class="card">
        <h2>A recording</h2>
        <h3>Files of a rover and its base, positioned in the background</h3>
        <Copyable label="Start a job" text={`curl ${origin}/v1/jobs${key} \\\n  -F rover=@rover.obs -F navigation=@navigation.rnx -F base=@base.obs \\\n  -F 'options={"mode": "rtk-fgo", "smoothed": true, "format": "kml"}'`} />
        <Copyable label="Follow a job and fetch what came of it" text={`# state and progress as they change\ncurl -N ${origin}/v1/jobs/job_…/events${key}\n# the file of positions; statuses, reasons, and what they rest on\ncurl -O -J ${origin}/v1/jobs/job_…/result${key}\ncurl ${origin}/v1/jobs/job_…/report${key}`} />
      </section>
      <section class="card">
        <h2>A device</h2>
        <h3>Ephemerides, then a receiver's file as a device would send it</h3>
        <Copyable label="Push ephemerides and play a file" text={`curl ${origin}/v1/navigation${bytes} \\\n  --data-binary @FILE.nav\ngraphfix stream --rover FILE.obs --server ${origin} --mode fgo --speed 10`} />
        <h3>A session by hand</h3>
        <Copyable label="Create a session" text={`curl ${origin}/v1/sessions${json} \\\n  -d '{"label": "rover", "mode": "fgo"}'`} />
      </section>
      <section class="card">
        <h2>What is stored</h2>
        <h3>Positions of a session</h3>
        <Copyable label="Read solutions" text={`curl '${origin}/v1/sessions/ses_…/solutions?pageSize=2'${key}\n# a day thinned for a plot\ncurl '${origin}/v1/sessions/ses_…/solutions:series?points=100'${key}\n# why the last epoch is what it is\ncurl '${origin}/v1/sessions/ses_…/epochs/last'${key}\n# as a file; .pos, .csv, .geojson, .gpx and .nmea too\ncurl -O -J '${origin}/v1/sessions/ses_…/track.kml'${key}`} />
        <h3>Live, and the fleet at a glance</h3>
        <Copyable label="Watch a session, and the latest of all" text={`# solutions as they are committed, as server-sent events\ncurl -N '${origin}/v1/sessions/ses_…/solutions:watch'${key}\n# the latest status and position of all sessions\ncurl '${origin}/v1/sessions:heads'${key}\n# the same as it changes\ncurl -N '${origin}/v1/sessions:watch'${key}`} />
      </section>
      <section class="card">
        <h2>gRPC</h2>
        <p>Reflection and health are on; the schema is in <code>proto/graphfix/v1</code>.</p>
        <Copyable label="List the gRPC services" text={`${grpcurl} ${port} list\n${grpcurl} ${port} describe graphfix.v1.Solutions\n${grpcurl} -d '{"label": "rover", "mode": "spp"}' ${port} graphfix.v1.Sessions/Create`} />
      </section>
      <section class="card">
        <h2>When a call is refused</h2>
        <p>REST answers a problem document (RFC 9457), gRPC a status with <code>ErrorInfo</code>. Both have the same stable <code>code</code> and a <code>remedy</code>; this page shows them the same way. An epoch without position is not a refusal: its status is <code>NONE</code>, and its <code>reasons</code> say why.</p>
        <Copyable label="A refusal" text={`curl ${origin}/v1/sessions/ses_0${key}`} />
      </section>
    </div>
  );
}
