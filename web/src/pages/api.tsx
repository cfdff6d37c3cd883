/** Where the API is described, and first calls with this service's own address. */
import { Copyable } from "../ui";

export function ApiPage() {
  const { origin, host } = location;
  return (
    <div class="page api">
      <h1>API</h1>
      <p class="lead">One port serves gRPC, HTTP/1.1 and HTTP/2. Every gRPC call of <code>graphfix.v1</code> has a REST twin with the same names.</p>
      <div class="cards links">
        <a class="card link" href="/docs/"><h2>REST, to read and to try</h2><p>Every call with its parameters and answers</p></a>
        <a class="card link" href="/openapi.json"><h2>openapi.json</h2><p>The same as OpenAPI 3.1, for generators of clients</p></a>
        <a class="card link" href="/readyz"><h2>readyz</h2><p>Whether epochs can be taken and committed, and if not, why</p></a>
        <a class="card link" href="/licences.txt"><h2>Licences</h2><p>Of the libraries in this dashboard</p></a>
      </div>
      <section class="card">
        <h2>First calls</h2>
        <h3>Ephemerides, then a receiver's file as a device would send it</h3>
        <Copyable label="Push ephemerides and play a file" text={`curl ${origin}/v1/navigation -H 'content-type: application/octet-stream' --data-binary @FILE.nav\ngraphfix stream --rover FILE.obs --server ${origin} --mode fgo --speed 10`} />
        <h3>A session by hand</h3>
        <Copyable label="Create a session" text={`curl ${origin}/v1/sessions -H 'content-type: application/json' -d '{"label": "rover", "mode": "fgo"}'`} />
        <h3>Its positions</h3>
        <Copyable label="Read solutions" text={`curl '${origin}/v1/sessions/ses_…/solutions?pageSize=2'\ncurl '${origin}/v1/sessions/ses_…/solutions:series?points=100'     # a day thinned for a plot\ncurl '${origin}/v1/sessions/ses_…/epochs/last'                     # why the last epoch is what it is`} />
        <h3>The fleet at a glance</h3>
        <Copyable label="Latest status and position of all sessions" text={`curl '${origin}/v1/sessions:heads'`} />
      </section>
      <section class="card">
        <h2>gRPC</h2>
        <p>Reflection and health are on; the schema is in <code>proto/graphfix/v1</code>.</p>
        <Copyable label="List the gRPC services" text={`grpcurl -plaintext ${host} list\ngrpcurl -plaintext ${host} describe graphfix.v1.Solutions\ngrpcurl -plaintext -d '{"label": "rover", "mode": "spp"}' ${host} graphfix.v1.Sessions/Create`} />
      </section>
      <section class="card">
        <h2>When a call is refused</h2>
        <p>REST answers a problem document (RFC 9457), gRPC a status with <code>ErrorInfo</code>. Both have the same stable <code>code</code> and a <code>remedy</code>; this page shows them the same way. An epoch without position is not a refusal: its status is <code>NONE</code>, and its <code>reasons</code> say why.</p>
        <Copyable label="A refusal" text={`curl ${origin}/v1/sessions/ses_0`} />
      </section>
    </div>
  );
}
