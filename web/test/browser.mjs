// The dashboard in a real browser: a fleet goes live, a session is inspected, an error is shown as
// one, no page logs an error, asks another host or has a serious fault of accessibility.
//
//   node test/browser.mjs GRAPHFIX [FOLDER]
//
// GRAPHFIX is the program; screenshots of each page (light, dark, phone) go to FOLDER.
import assert from "node:assert/strict";
import { readFileSync } from "node:fs";
import { join } from "node:path";
import {
  FORMS, browser, capture, checkAccessibility, complaints, folder, open, run, serve, start, started, stopAll, until,
} from "./harness.mjs";
import { foreign } from "./foreign.mjs";
import { jobResults } from "./job-results.mjs";
import { jobs } from "./jobs.mjs";
import { keys } from "./keys.mjs";
import { delays, tiles } from "./live.mjs";
import { truths } from "./truth.mjs";

async function heads(address) {
  const answer = await fetch(`${address}/v1/sessions:heads`);
  return (await answer.json()).heads;
}

async function fleetGoesLive(address) {
  const page = await open(address, FORMS[0].options);
  const asked = [];
  page.on("request", (request) => asked.push(new URL(request.url()).pathname));
  await page.goto(address);
  await page.locator("a.device").first().waitFor();
  await until("six devices are listed", 20, async () => (await page.locator("a.device").count()) === 6);
  await page.locator(".chip", { hasText: "Fixed" }).waitFor({ timeout: 90_000 });
  await page.locator(".lost", { hasText: "courier 6" }).waitFor({ timeout: 90_000 });
  await epochsRise(page);
  await mapMovesByKeys(page);
  assert(asked.includes("/v1/sessions:watch") && !asked.includes("/v1/sessions:heads"), "the page watches, and does not poll");
  // Filters by status and by text.
  await page.locator(".chip", { hasText: "Lost" }).click();
  await until("only the lost device is listed", 5, async () => (await page.locator("a.device").count()) === 1);
  await page.locator(".chip", { hasText: "Lost" }).click();
  await page.getByRole("searchbox").fill("tractor");
  await until("only the tractor is listed", 5, async () => (await page.locator("a.device").count()) === 1);
  await page.getByRole("searchbox").fill("");
  // By keys alone: from the list into a session.
  await page.locator("a.device").first().focus();
  await page.keyboard.press("ArrowDown");
  await page.keyboard.press("Enter");
  await page.locator(".session-title h1").waitFor();
  const paint = await page.evaluate(() => performance.getEntriesByName("first-contentful-paint")[0].startTime);
  assert(paint < 1000, `the first paint takes ${paint} ms`);
  console.log(`first contentful paint after ${paint.toFixed(0)} ms`);
  await page.context().close();
}

/** Keys zoom the map, which then stays as it is while the fleet moves, until all is shown again. */
async function mapMovesByKeys(page) {
  const scale = () => page.locator(".map .ol-scale-line-inner").textContent();
  const before = await scale();
  // A pointer that passes over the map does not move it: it still follows the fleet when its size changes.
  await page.locator(".map").hover();
  await page.setViewportSize({ width: 700, height: 500 });
  await until("a smaller map shows all", 5, async () => (await scale()) !== before);
  const small = await scale();
  await page.setViewportSize(FORMS[0].options.viewport);
  await until("a larger map is filled", 5, async () => (await scale()) !== small);
  const near = await atRest(scale);
  await page.locator(".map").focus();
  await page.keyboard.press("-");
  await page.keyboard.press("-");
  await until("the map shows more", 5, async () => (await scale()) !== near);
  const far = await atRest(scale);
  await epochsRise(page);
  assert.equal(await scale(), far, "the map stays where the user has moved it");
  await page.keyboard.press("0");
  await until("the map shows all", 5, async () => (await scale()) !== far);
}

/** A map without an area is not drawn, and nothing is logged; it is drawn whenever it has one. */
async function mapWaitsForItsArea(address) {
  const page = await open(address, FORMS[2].options);
  await page.addInitScript(() => {
    const flat = new CSSStyleSheet();
    flat.replaceSync(".map-card.low .map { height: 0; min-height: 0; }");
    document.adoptedStyleSheets = [flat];
    globalThis.flatten = (isFlat) => { document.adoptedStyleSheets = isFlat ? [flat] : []; };
  });
  await page.goto(`${address}/#/bases`);
  await page.locator(".map-card.low .map").waitFor({ state: "attached" });
  const canvases = page.locator(".map-card.low canvas");
  await page.waitForTimeout(500);
  for (const isFlat of [true, false, true, false]) {
    await page.evaluate((isFlat) => globalThis.flatten(isFlat), isFlat);
    await until(`a ${isFlat ? "flat map is not" : "map is"} drawn`, 10, async () => (await canvases.count() === 0) === isFlat);
  }
  await until("the map has its scale", 10, async () => /\d+ k?m/.test(await page.locator(".low .ol-scale-line-inner").textContent()));
  await page.context().close();
}

/** What is read, once it has been the same for a second: a key of the map takes effect with animation, at a later frame. */
async function atRest(read) {
  let last = await read();
  for (let same = 0; same < 10; ) {
    await new Promise((resolve) => setTimeout(resolve, 100));
    const now = await read();
    same = now === last ? same + 1 : 0;
    last = now;
  }
  return last;
}

/** Numbers move without a reload. */
async function epochsRise(page) {
  const numbers = () => page.locator(".device-mode").allTextContents();
  const before = await numbers();
  await until("the epochs of the list rise", 15, async () => (await numbers()).join() !== before.join());
}

/** No stream can be had: the fleet is polled. */
async function fleetWithoutStream(address) {
  const page = await open(address, FORMS[0].options, ["ERR_FAILED"]);
  await page.route("**/v1/sessions:watch", (route) => route.abort());
  await page.goto(address);
  await until("six devices are listed", 20, async () => (await page.locator("a.device").count()) === 6);
  await epochsRise(page);
  await page.context().close();
}

async function sessionIsInspected(address) {
  const surveyor = (await heads(address)).find(({ label }) => label.startsWith("surveyor"));
  const page = await open(address, FORMS[0].options);
  await page.goto(`${address}/#/sessions/${surveyor.session}`);
  await page.locator(".badge-large", { hasText: "Fixed" }).waitFor({ timeout: 60_000 });
  await page.locator(".uplot").first().waitFor();
  assert(5 < await page.locator(".sky circle[stroke]").count(), "the sky has satellites");
  const used = await page.locator(".sky-card tbody tr:not(.unused)").count();
  assert(5 < used, `${used} satellites are used`);
  await page.locator(".chart", { hasText: "Residuals" }).locator(".key", { hasText: /rms of the pseudoranges \d/ }).waitFor();
  // A click in a plot chooses an epoch, which then stays.
  const plot = page.locator(".plots .u-over").nth(1);
  await plot.scrollIntoViewIfNeeded();
  await plot.click({ position: { x: 200, y: 40 } });
  await page.locator(".chosen", { hasText: "Epoch" }).waitFor();
  const chosen = await page.locator(".chosen").textContent();
  await page.waitForTimeout(2500);
  assert.equal(await page.locator(".chosen").textContent(), chosen);
  await page.getByRole("button", { name: "Follow the last" }).click();
  // So do keys, by the slider above the plots.
  await page.getByRole("slider", { name: "Epoch" }).focus();
  await page.keyboard.press("ArrowLeft");
  await page.locator(".chosen", { hasText: "Epoch" }).waitFor();
  await page.getByRole("button", { name: "Follow the last" }).click();
  // The window itself does not scroll: all of the page is inside main.
  const excess = () => page.evaluate(() => document.documentElement.scrollHeight - innerHeight);
  assert.equal(await excess(), 0, "the window is longer than its frame");
  assert.match(await page.title(), /^surveyor.* · Graphfix$/);
  // Dragging zooms the series.
  await plot.scrollIntoViewIfNeeded();
  const box = await plot.boundingBox();
  await page.mouse.move(box.x + 150, box.y + 40);
  await page.mouse.down();
  await page.mouse.move(box.x + 420, box.y + 40, { steps: 5 });
  await page.mouse.up();
  await page.getByRole("button", { name: "Zoomed" }).waitFor();
  await page.context().close();

  // A device that is not fixed says why, with a remedy.
  const van = (await heads(address)).find(({ label }) => label.startsWith("delivery van"));
  const other = await open(address, FORMS[0].options);
  await other.goto(`${address}/#/sessions/${van.session}`);
  await other.locator(".why .reasons li").first().waitFor({ timeout: 30_000 });
  // The page of a lost device says so before what limited its last epoch.
  const lost = (await heads(address)).find(({ label }) => label.startsWith("courier 6"));
  await other.goto(`${address}/#/sessions/${lost.session}`);
  await other.locator(".why .note", { hasText: "The device is lost" }).waitFor({ timeout: 90_000 });
  await other.context().close();
}

/** The track of a session in each format, as its page links it. */
async function tracksAreDownloaded(address) {
  const surveyor = (await heads(address)).find(({ label }) => label.startsWith("surveyor"));
  const page = await open(address, FORMS[0].options);
  await page.goto(`${address}/#/sessions/${surveyor.session}`);
  await page.locator(".uplot").first().waitFor({ timeout: 30_000 });
  for (const [name, sign] of [[".pos", "% program"], ["CSV", "seq,revision,"], ["GeoJSON", "FeatureCollection"], ["KML", "<kml"], ["GPX", "<gpx"], ["NMEA", "$GNGGA"], ["RINEX", "OBSERVATION DATA"]]) {
    const arriving = page.waitForEvent("download");
    await page.locator(".download a", { hasText: name }).click();
    const text = readFileSync(await (await arriving).path(), "utf8");
    assert(text.includes(sign) && 1000 < text.length, `${name}: ${text.slice(0, 80)}`);
  }
  await page.context().close();
}

/** A month of the fleet, a session of it, and the way from one to the other. */
async function historyIsShown(address) {
  const page = await open(address, FORMS[0].options);
  await page.goto(`${address}/#/history`);
  await page.locator(".fleet-bars rect").first().waitFor({ timeout: 30_000 });
  const row = page.locator(".history tbody tr", { hasText: "surveyor" });
  await row.waitFor();
  await page.getByRole("button", { name: "30 days" }).click();
  await page.getByText("intervals of 6 h").waitFor();
  const { statuses } = await (await fetch(`${address}/v1/history/fleet`)).json();
  const epochs = statuses.reduce((sum, { solutions }) => sum + solutions, 0);
  assert(100 < epochs, `${epochs} epochs of the fleet`);
  await row.locator("a").click();
  await page.getByRole("heading", { name: "surveyor" }).waitFor();
  await page.locator(".plots .uplot").first().waitFor();
  await page.locator(".shares li", { hasText: "Fixed" }).waitFor();
  await page.context().close();
}

/** The demo has a recording as a job. */
async function demoHasAJob(address) {
  const page = await open(address, FORMS[0].options);
  await page.goto(`${address}/#/jobs`);
  await page.locator(".job-row", { hasText: "street.obs" }).getByText("Succeeded").waitFor({ timeout: 120_000 });
  await page.context().close();
}

async function errorsAreShown(address) {
  const page = await open(address, FORMS[0].options, ["404"]);
  await page.goto(`${address}/#/sessions/ses_00000000000000000000000000`);
  const problem = page.locator(".problem");
  await problem.waitFor();
  const text = await problem.textContent();
  assert.match(text, /SESSION_NOT_FOUND/);
  assert.match(text, /Create a session, or check the id\./);
  await checkAccessibility(page, "error");
  await page.screenshot({ path: join(folder, "error-light.png") });
  await page.context().close();
}

/** An address that is no page's, or cannot be decoded, says so; the next address is shown. */
async function unknownAddressesAreShown(address) {
  const page = await open(address, FORMS[0].options);
  const heading = (name) => page.getByRole("heading", { level: 1, name }).waitFor();
  for (const path of ["#/nowhere", "#/%", "#/jobs/%E0%A4%A"]) {
    await page.goto(`${address}/${path}`);
    await heading("No such page");
    await page.goto(`${address}/#/api`);
    await heading("API");
  }
  // Also as the first address.
  await page.goto(`${address}/#/%`);
  await page.reload();
  await heading("No such page");
  await page.getByRole("link", { name: "fleet", exact: true }).click();
  await heading("Fleet");
  await page.context().close();
}

/** Empty pages tell what to do; a service that ends is seen. */
async function emptyServiceTeaches() {
  const { child, address } = await serve();
  const page = await open(address, FORMS[0].options, ["ERR_CONNECTION_REFUSED", "ERR_CONNECTION_RESET", "ERR_EMPTY_RESPONSE", "503"]);
  for (const [path, words] of [["fleet", "No session yet"], ["bases", "No base station yet"], ["ephemerides", "No ephemeris yet"], ["jobs", "No job yet"], ["history", "No epoch in this span of time"]]) {
    await page.goto(`${address}/#/${path}`);
    await page.getByRole("heading", { name: words }).waitFor();
    await checkAccessibility(page, `${path} without data`);
    await page.screenshot({ path: join(folder, `${path}-empty.png`) });
  }
  child.removeAllListeners("exit");
  child.kill("SIGTERM");
  await page.locator(".banner.bad").waitFor({ timeout: 30_000 });
  await page.screenshot({ path: join(folder, "not-ready.png") });
  await page.context().close();
}

/** A service with keys: a key is exchanged for a cookie, by the keyboard alone, and kept nowhere. */
async function signInIsAsked() {
  const { address, database } = await serve();
  const keys = (...words) => run("keys", "--database", database, ...words);
  const [, id, key] = keys("create", "--right", "read,operate").match(/^(key_\S+)[^]*\n(gfx_\S+)\n$/);
  await until("the key is in force", 10, async () => (await fetch(`${address}/v1/sessions`)).status === 401);
  for (const form of FORMS) {
    const page = await open(address, form.options);
    await page.goto(address);
    await page.getByRole("heading", { name: "Sign in" }).waitFor();
    await capture(page, "sign-in", form);
    await page.context().close();
  }

  // 409: the session of this test has no epoch.
  const page = await open(address, FORMS[0].options, ["401", "403", "409"]);
  const asked = () => page.getByRole("heading", { name: "Sign in" }).waitFor();
  const served = () => page.getByRole("heading", { name: "No session yet" }).waitFor();
  const submit = async (text) => {
    await until("the field has the focus", 5, () => page.evaluate(() => document.activeElement?.id === "key"));
    await page.keyboard.type(text);
    await page.keyboard.press("Enter");
  };
  await page.goto(address);
  await asked();
  await submit(`gfx_${"0".repeat(64)}`);
  await page.locator(".problem", { hasText: "KEY_INVALID" }).waitFor();
  await checkAccessibility(page, "a wrong key");
  await submit(key);
  await served();
  const kept = await page.evaluate(() => [
    document.documentElement.outerHTML, document.cookie, JSON.stringify(localStorage), JSON.stringify(sessionStorage), location.href,
  ].join("\n"));
  assert(!kept.includes(key.slice(4)) && !kept.includes("graphfix_sign_in"), "the page has the key or the cookie");
  await page.reload();
  await served();
  // Another page of the browser is signed in, too; a change needs the token.
  const refused = await page.evaluate(async () => {
    const answer = await fetch("/v1/sessions", { method: "POST", headers: { "content-type": "application/json" }, body: "{}" });
    return (await answer.json()).code;
  });
  assert.equal(refused, "CSRF_TOKEN_INVALID");
  await page.getByRole("button", { name: "Sign out" }).focus();
  await page.keyboard.press("Enter");
  await asked();
  const status = await page.evaluate(async () => (await fetch("/v1/sessions")).status);
  assert.equal(status, 401, "the cookie is worth nothing any more");
  // A session is refused without its key, and shown with it.
  const body = JSON.stringify({ label: "behind a key" });
  const headers = { authorization: `Bearer ${key}`, "content-type": "application/json" };
  const { session } = await (await fetch(`${address}/v1/sessions`, { method: "POST", headers, body })).json();
  await page.goto(`${address}/#/sessions/${session}`);
  await asked();
  assert(!(await page.content()).includes("behind a key"), "the session is shown without a key");
  await submit(key);
  await page.getByRole("heading", { name: "behind a key" }).waitFor();
  await page.getByRole("button", { name: "Sign out" }).click();
  await asked();
  await page.goto(`${address}/#/bases`);
  // A key that is revoked ends the sign-in, and the page asks again.
  await submit(key);
  await page.getByRole("heading", { name: "No base station yet" }).waitFor();
  keys("revoke", id);
  await asked();
  await page.context().close();
}

/** The track lies within its map, and takes 30 % of its width or more. */
async function trackIsFramed(page, form) {
  const framed = () => page.evaluate(() => {
    const parts = [];
    for (const canvas of document.querySelectorAll(".map canvas")) {
      const { width, height } = canvas;
      const pixels = canvas.getContext("2d").getImageData(0, 0, width, height).data;
      for (let i = 0; i < pixels.length; i += 4) {
        // Green, as a fixed position is in both themes.
        const [r, g, b] = pixels.subarray(i, i + 3);
        if (pixels[i + 3] === 255 && r + 60 < g && b + 20 < g) parts.push([((i / 4) % width) / width, Math.floor(i / 4 / width) / height]);
      }
    }
    const [x, y] = [0, 1].map((n) => parts.map((at) => at[n])).map((values) => values.sort((a, b) => a - b));
    return { count: parts.length, x: [x[0], x.at(-1)], y: [y[0], y.at(-1)] };
  });
  await until(`the track is framed, ${form}`, 10, async () => {
    const { count, x, y } = await framed();
    return 100 < count && 0.02 < x[0] && x[1] < 0.98 && 0.02 < y[0] && y[1] < 0.98 && 0.3 < x[1] - x[0];
  });
}

async function screenshots(address) {
  const surveyor = (await heads(address)).find(({ label }) => label.startsWith("surveyor"));
  const van = (await heads(address)).find(({ label }) => label.startsWith("delivery van"));
  const pages = [
    ["fleet", "#/fleet", "a.device"], ["session", `#/sessions/${surveyor.session}`, ".uplot"],
    ["session-float", `#/sessions/${van.session}`, ".uplot"], ["bases", "#/bases", ".base"],
    ["history", "#/history", ".fleet-bars rect"], ["session-history", `#/history/${surveyor.session}`, ".uplot"],
    ["ephemerides", "#/ephemerides", ".coverage"], ["api", "#/api", ".copyable"],
  ];
  for (const form of FORMS) {
    for (const [name, path, sign] of pages) {
      // Pixels are read by the test alone.
      const page = await open(address, form.options, ["willReadFrequently"]);
      await page.goto(`${address}/${path}`);
      await page.locator(sign).first().waitFor();
      await page.waitForTimeout(1500);
      if (name === "session") await trackIsFramed(page, form.name);
      await capture(page, name, form);
      await page.context().close();
    }
  }
}

try {
  const { address } = await start(["demo", "--duration", "240", "--speed", "20"], /(http:\/\/127\.0\.0\.1:\d+)/);
  await fleetGoesLive(address);
  await fleetWithoutStream(address);
  await sessionIsInspected(address);
  await errorsAreShown(address);
  await unknownAddressesAreShown(address);
  await mapWaitsForItsArea(address);
  await tracksAreDownloaded(address);
  await demoHasAJob(address);
  await historyIsShown(address);
  await screenshots(address);
  await emptyServiceTeaches();
  await signInIsAsked();
  await jobs();
  await jobResults();
  await keys();
  await foreign();
  await truths();
  await delays();
  await tiles();
  assert.deepEqual(complaints, [], "errors of the console, or requests to other hosts");
  console.log(`the dashboard works; screenshots are in ${folder}`);
} catch (error) {
  console.error(error);
  if (complaints.length) console.error(complaints.join("\n"));
  process.exitCode = 1;
} finally {
  started.forEach((child) => child.removeAllListeners("exit"));
  stopAll();
  await browser.close();
}
