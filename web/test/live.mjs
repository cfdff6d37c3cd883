// What the dashboard shows of the present and of other hosts: the delay of epochs, tiles of maps.
import assert from "node:assert/strict";
import { mkdtempSync, writeFileSync } from "node:fs";
import { createServer } from "node:http";
import { tmpdir } from "node:os";
import { join } from "node:path";
import { FORMS, capture, complaints, open, serve, until } from "./harness.mjs";

/** 1980-01-06 in Unix time, less the leap seconds since then (s). */
const GPS_EPOCH_S = 315_964_800 - 18;
const WEEK_S = 604_800;
/** A picture of one pixel. */
const PIXEL = Buffer.from("iVBORw0KGgoAAAANSUhEUgAAAAEAAAABCAYAAAAfFcSJAAAADUlEQVR42mNkYPj/HwADBwIAMCbHYQAAAABJRU5ErkJggg==", "base64");

const json = { "content-type": "application/json" };

async function newSession(address) {
  const answer = await fetch(`${address}/v1/sessions`, { method: "POST", headers: json, body: JSON.stringify({ label: "rover" }) });
  return (await answer.json()).session;
}

/** Pushes an epoch without a position, with a time tag of `agoS` before now. */
async function push(address, session, seq, agoS) {
  const gps = Date.now() / 1000 - GPS_EPOCH_S - agoS;
  const time = { week: Math.floor(gps / WEEK_S), nsOfWeek: Math.round((gps % WEEK_S) * 1e9) };
  const observations = [{ satellite: "G05", code: "1C", pseudorangeM: 22_000_000 }];
  const body = JSON.stringify({ epochs: [{ seq, time, observations }] });
  const answer = await fetch(`${address}/v1/sessions/${session}/epochs`, { method: "POST", headers: json, body });
  assert.equal(answer.status, 200, await answer.text());
}

/** The delay of epochs that arrive while the page is open. */
export async function delays() {
  const { address } = await serve();
  const session = await newSession(address);
  await push(address, session, 1, 3600);
  const page = await open(address, FORMS[0].options);
  await page.goto(`${address}/#/sessions/${session}`);
  const card = page.locator(".delays");
  await card.getByText("Waiting for the next epoch.").waitFor();
  await page.waitForTimeout(500);
  await push(address, session, 2, 1800);
  await card.getByText("not of now").waitFor();
  for (let seq = 3; seq < 9; seq += 1) {
    await push(address, session, seq, 2);
    await page.waitForTimeout(300);
  }
  await card.locator(".uplot").waitFor();
  const words = await card.locator(".card-head").textContent();
  const median = Number(words.match(/Median ([\d.]+) s/)?.[1]);
  assert(2 <= median && median < 5, `the epochs are 2 s old when they are sent: ${words}`);
  await capture(page, "delay", FORMS[0]);
  await page.context().close();
}

/** Tiles of the host that the operator names, and of no other; whose they are is shown. */
export async function tiles() {
  const asked = [];
  const host = createServer((request, response) => {
    asked.push({ path: request.url, referer: request.headers.referer });
    response.writeHead(200, { "content-type": "image/png" }).end(PIXEL);
  });
  await new Promise((resolve) => host.listen(0, "127.0.0.1", resolve));
  const { port } = host.address();
  const configuration = join(mkdtempSync(join(tmpdir(), "graphfix-tiles-")), "graphfix.toml");
  const template = `http://127.0.0.1:${port}/{z}/{x}/{y}.png`;
  writeFileSync(configuration, `[dashboard]\ntiles = "${template}"\nattribution = "© Tiles & Co"\n`);
  const { address } = await serve("--config", configuration);
  const session = await newSession(address);
  await push(address, session, 1, 2);
  const page = await open(address, FORMS[0].options);
  await page.goto(`${address}/#/fleet`);
  await page.locator(".map-attribution", { hasText: "© Tiles & Co" }).waitFor();
  await until("tiles are asked for", 10, () => 0 < asked.length);
  await page.waitForTimeout(500);
  for (const { path, referer } of asked) {
    assert.match(path, /^\/\d+\/\d+\/\d+\.png$/);
    assert.equal(referer, `${address}/`, "the host of tiles learns no more than the service's address");
  }
  await capture(page, "tiles", FORMS[0]);
  await page.context().close();
  host.close();
  // The tiles are what the page asked another host for.
  for (let i = complaints.length - 1; 0 <= i; i -= 1) {
    if (complaints[i].includes(` asks http://127.0.0.1:${port}/`)) complaints.splice(i, 1);
  }
}
