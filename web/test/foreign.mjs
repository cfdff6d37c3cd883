// Pages of another host: one that is listed for a tenant calls with a key of the tenant, and reads answers, refusals and
// events; with a key of another tenant, and from a page that is not listed, nothing is read.
import assert from "node:assert/strict";
import { mkdtempSync, writeFileSync } from "node:fs";
import { createServer } from "node:http";
import { tmpdir } from "node:os";
import { join } from "node:path";
import { FORMS, browser, freePort, run, serve, until } from "./harness.mjs";

/** A host with one empty page. Returns its origin, and how to end it. */
async function host() {
  const port = await freePort();
  const server = createServer((_, answer) => answer.setHeader("content-type", "text/html").end("<!doctype html><title>a fleet</title>"));
  await new Promise((resolve) => server.listen(port, "127.0.0.1", resolve));
  return { origin: `http://127.0.0.1:${port}`, end: () => server.close() };
}

/** Calls from the page: status and code, or the name of what the browser throws. */
const call = (page, url, key, method, content) => page.evaluate(async ([url, key, method, content]) => {
  const headers = { authorization: `Bearer ${key}`, ...(content && { "content-type": "application/json", "idempotency-key": "a" }) };
  try {
    const answer = await fetch(url, { method, headers, body: content && JSON.stringify(content) });
    const { code, session } = await answer.json();
    return { status: answer.status, code, session, request: Boolean(answer.headers.get("x-request-id")) };
  } catch (error) {
    return { thrown: error.name };
  }
}, [url, key, method, content]);

export async function foreign() {
  const [listed, other] = [await host(), await host()];
  const configuration = join(mkdtempSync(join(tmpdir(), "graphfix-cors-")), "graphfix.toml");
  writeFileSync(configuration, `[cors]\nacme = ["${listed.origin}"]\n`);
  const { address, database } = await serve("--config", configuration);
  const key = (tenant) => run("keys", "create", "--database", database, "--tenant", tenant, "--right", "device,read,operate").match(/gfx_\S+/)[0];
  const [acme, another] = [key("acme"), key("another")];
  await until("every call needs a key", 5, async () => (await fetch(`${address}/v1/sessions`)).status === 401);
  const context = await browser.newContext(FORMS[0].options);
  const page = await context.newPage();

  await page.goto(listed.origin);
  const created = await call(page, `${address}/v1/sessions`, acme, "POST", { label: "of a page" });
  assert.deepEqual([created.status, created.request], [201, true], JSON.stringify(created));
  const refused = await call(page, `${address}/v1/sessions`, another, "GET");
  assert.deepEqual([refused.status, refused.code], [403, "ORIGIN_REFUSED"]);
  const unknown = await call(page, `${address}/v1/sessions`, "gfx_none", "GET");
  assert.equal(unknown.status, 401);
  const first = await page.evaluate(async ([url, key]) => {
    const answer = await fetch(url, { headers: { authorization: `Bearer ${key}` } });
    const reader = answer.body.getReader();
    const { value } = await reader.read();
    await reader.cancel();
    return new TextDecoder().decode(value);
  }, [`${address}/v1/sessions:watch`, acme]);
  assert.match(first, /event: |data: |: /);

  await page.goto(other.origin);
  for (const method of ["GET", "POST"]) {
    const kept = await call(page, `${address}/v1/sessions`, acme, method, method === "POST" ? { label: "b" } : undefined);
    assert.deepEqual(kept, { thrown: "TypeError" }, "the browser lets the page read nothing");
  }
  const sessions = await (await fetch(`${address}/v1/sessions`, { headers: { authorization: `Bearer ${acme}` } })).json();
  assert.equal(sessions.sessions.length, 1, "the page that is not listed has created none");
  await context.close();
  listed.end();
  other.end();
}
