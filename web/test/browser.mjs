// The dashboard in a real browser: a fleet goes live, a session is inspected, an error is shown as
// one, no page logs an error, asks another host or has a serious fault of accessibility.
//
//   node test/browser.mjs GRAPHFIX [FOLDER]
//
// GRAPHFIX is the program; screenshots of each page (light, dark, phone) go to FOLDER.
import assert from "node:assert/strict";
import { spawn } from "node:child_process";
import { existsSync, mkdirSync, mkdtempSync, readFileSync } from "node:fs";
import { createServer } from "node:net";
import { tmpdir } from "node:os";
import { dirname, join } from "node:path";
import { fileURLToPath } from "node:url";
import { chromium } from "playwright-core";

const here = dirname(fileURLToPath(import.meta.url));
const [program, folder = mkdtempSync(join(tmpdir(), "graphfix-screens-"))] = process.argv.slice(2);
assert(program, "name the program: node test/browser.mjs target/release/graphfix");
mkdirSync(folder, { recursive: true });
const axe = readFileSync(join(here, "../node_modules/axe-core/axe.min.js"), "utf8");
const executablePath = ["/usr/bin/chromium", "/usr/bin/chromium-browser"].find(existsSync);
assert(executablePath, "Chromium is needed: apt-get install chromium");

const started = [];
const stopAll = () => started.forEach((process) => process.kill("SIGTERM"));

/** Starts the program and waits until a line of its output names an address. */
function start(args, pattern) {
  const child = spawn(program, args, { stdio: ["ignore", "pipe", "pipe"] });
  started.push(child);
  return new Promise((resolve, reject) => {
    let text = "";
    const read = (chunk) => {
      text += chunk;
      const found = text.match(pattern);
      if (found) resolve({ child, address: found[1] });
    };
    child.stdout.on("data", read);
    child.stderr.on("data", read);
    child.on("exit", (code) => reject(new Error(`${args[0]} ended with ${code}: ${text}`)));
  });
}

const freePort = () => new Promise((resolve) => {
  const server = createServer().listen(0, "127.0.0.1", () => {
    const { port } = server.address();
    server.close(() => resolve(port));
  });
});

async function until(what, seconds, condition) {
  const end = Date.now() + seconds * 1000;
  for (;;) {
    const value = await condition();
    if (value) return value;
    assert(Date.now() < end, `not within ${seconds} s: ${what}`);
    await new Promise((resolve) => setTimeout(resolve, 200));
  }
}

const browser = await chromium.launch({ executablePath, args: ["--no-sandbox"] });
const complaints = [];

/** A page that notes each error of the console and each request to another host. */
async function open(address, options, expected = []) {
  const context = await browser.newContext({ reducedMotion: "reduce", ...options });
  const page = await context.newPage();
  const allowed = (text) => expected.some((part) => text.includes(part));
  page.on("console", (message) => {
    const text = `${message.text()} (${message.location().url})`;
    if (["error", "warning"].includes(message.type()) && !allowed(text)) complaints.push(`${page.url()}: ${text}`);
  });
  page.on("pageerror", (error) => complaints.push(`${page.url()}: ${error.stack}`));
  page.on("request", (request) => {
    if (!request.url().startsWith(address)) complaints.push(`${page.url()} asks ${request.url()}`);
  });
  return page;
}

/** Serious faults that axe-core finds. */
async function checkAccessibility(page, name) {
  // The page's policy forbids scripts of others, so axe comes in by the debugger.
  await page.evaluate(axe);
  const found = await page.evaluate(() => globalThis.axe.run(document, {
    runOnly: ["wcag2a", "wcag2aa", "wcag21a", "wcag21aa", "best-practice"],
  }));
  const serious = found.violations.filter(({ impact }) => impact === "serious" || impact === "critical");
  const words = serious.map(({ id, help, nodes }) => `${id} (${help}): ${nodes.slice(0, 3).map(({ html }) => html.slice(0, 160)).join(" | ")}`);
  assert.deepEqual(words, [], `${name}: serious faults of accessibility`);
}

const FORMS = [
  { name: "light", options: { colorScheme: "light", viewport: { width: 1440, height: 900 } } },
  { name: "dark", options: { colorScheme: "dark", viewport: { width: 1440, height: 900 } } },
  { name: "phone", options: { colorScheme: "dark", viewport: { width: 390, height: 844 }, deviceScaleFactor: 2, isMobile: true, hasTouch: true } },
];

async function heads(address) {
  const answer = await fetch(`${address}/v1/sessions:heads`);
  return (await answer.json()).heads;
}

async function fleetGoesLive(address) {
  const page = await open(address, FORMS[0].options);
  await page.goto(address);
  await page.locator("a.device").first().waitFor();
  await until("six devices are listed", 20, async () => (await page.locator("a.device").count()) === 6);
  await page.locator(".chip", { hasText: "Fixed" }).waitFor({ timeout: 90_000 });
  await page.locator(".lost", { hasText: "courier 6" }).waitFor({ timeout: 90_000 });
  // Numbers move without a reload.
  const numbers = () => page.locator(".device-mode").allTextContents();
  const before = await numbers();
  await until("the epochs of the list rise", 15, async () => (await numbers()).join() !== before.join());
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

async function sessionIsInspected(address) {
  const surveyor = (await heads(address)).find(({ label }) => label.startsWith("surveyor"));
  const page = await open(address, FORMS[0].options);
  await page.goto(`${address}/#/sessions/${surveyor.session}`);
  await page.locator(".badge-large", { hasText: "Fixed" }).waitFor({ timeout: 60_000 });
  await page.locator(".uplot").first().waitFor();
  assert(5 < await page.locator(".sky circle[stroke]").count(), "the sky has satellites");
  const used = await page.locator(".sky-card tbody tr:not(.unused)").count();
  assert(5 < used, `${used} satellites are used`);
  // A click in a plot chooses an epoch, which then stays.
  const plot = page.locator(".plots .u-over").nth(1);
  await plot.scrollIntoViewIfNeeded();
  await plot.click({ position: { x: 200, y: 40 } });
  await page.locator(".chosen", { hasText: "Epoch" }).waitFor();
  const chosen = await page.locator(".chosen").textContent();
  await page.waitForTimeout(2500);
  assert.equal(await page.locator(".chosen").textContent(), chosen);
  await page.getByRole("button", { name: "Follow the last" }).click();
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
  await other.context().close();
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

/** Empty pages tell what to do; a service that ends is seen. */
async function emptyServiceTeaches() {
  const port = await freePort();
  const database = `sqlite://${join(mkdtempSync(join(tmpdir(), "graphfix-empty-")), "graphfix.db")}`;
  const { child, address } = await start(["serve", "--listen", `127.0.0.1:${port}`, "--database", database], /(http:\/\/127\.0\.0\.1:\d+)/);
  const page = await open(address, FORMS[0].options, ["ERR_CONNECTION_REFUSED", "ERR_CONNECTION_RESET", "ERR_EMPTY_RESPONSE", "503"]);
  for (const [path, words] of [["fleet", "No session yet"], ["bases", "No base station yet"], ["ephemerides", "No ephemeris yet"]]) {
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

async function screenshots(address) {
  const surveyor = (await heads(address)).find(({ label }) => label.startsWith("surveyor"));
  const van = (await heads(address)).find(({ label }) => label.startsWith("delivery van"));
  const pages = [
    ["fleet", "#/fleet", "a.device"], ["session", `#/sessions/${surveyor.session}`, ".uplot"],
    ["session-float", `#/sessions/${van.session}`, ".uplot"], ["bases", "#/bases", ".base"],
    ["ephemerides", "#/ephemerides", ".coverage"], ["api", "#/api", ".copyable"],
  ];
  for (const { name: form, options } of FORMS) {
    for (const [name, path, sign] of pages) {
      const page = await open(address, options);
      await page.goto(`${address}/${path}`);
      await page.locator(sign).first().waitFor();
      await page.waitForTimeout(1500);
      await checkAccessibility(page, `${name}, ${form}`);
      await page.screenshot({ path: join(folder, `${name}-${form}.png`) });
      // The whole page, whose main part scrolls by itself.
      const height = await page.evaluate(() => document.getElementById("main").scrollHeight);
      if (options.viewport.height < height) {
        await page.setViewportSize({ width: options.viewport.width, height: Math.min(6000, height + 120) });
        await page.waitForTimeout(400);
        await page.screenshot({ path: join(folder, `${name}-${form}-whole.png`) });
      }
      const wide = await page.evaluate(() => document.documentElement.scrollWidth - innerWidth);
      assert(wide <= 0, `${name}, ${form}: the page is ${wide} px too wide`);
      await page.context().close();
    }
  }
}

try {
  const { address } = await start(["demo", "--duration", "240", "--speed", "20"], /(http:\/\/127\.0\.0\.1:\d+)/);
  await fleetGoesLive(address);
  await sessionIsInspected(address);
  await errorsAreShown(address);
  await screenshots(address);
  await emptyServiceTeaches();
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
