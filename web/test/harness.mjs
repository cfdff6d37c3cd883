// What the browser tests share: the program, pages that note each complaint, accessibility.
import assert from "node:assert/strict";
import { execFileSync, spawn } from "node:child_process";
import { existsSync, mkdirSync, mkdtempSync, readFileSync } from "node:fs";
import { createServer } from "node:net";
import { tmpdir } from "node:os";
import { dirname, join } from "node:path";
import { fileURLToPath } from "node:url";
import { chromium } from "playwright-core";

const here = dirname(fileURLToPath(import.meta.url));
export const [program, folder = mkdtempSync(join(tmpdir(), "graphfix-screens-"))] = process.argv.slice(2);
assert(program, "name the program: node test/browser.mjs target/release/graphfix");
mkdirSync(folder, { recursive: true });
const axe = readFileSync(join(here, "../node_modules/axe-core/axe.min.js"), "utf8");
const executablePath = ["/usr/bin/chromium", "/usr/bin/chromium-browser"].find(existsSync);
assert(executablePath, "Chromium is needed: apt-get install chromium");

export const started = [];
export const stopAll = () => started.forEach((process) => process.kill("SIGTERM"));

/** Starts the program and waits until a line of its output names an address. */
export function start(args, pattern) {
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

export const freePort = () => new Promise((resolve) => {
  const server = createServer().listen(0, "127.0.0.1", () => {
    const { port } = server.address();
    server.close(() => resolve(port));
  });
});

export async function until(what, seconds, condition) {
  const end = Date.now() + seconds * 1000;
  for (;;) {
    const value = await condition();
    if (value) return value;
    assert(Date.now() < end, `not within ${seconds} s: ${what}`);
    await new Promise((resolve) => setTimeout(resolve, 200));
  }
}

export const browser = await chromium.launch({ executablePath, args: ["--no-sandbox"] });
export const complaints = [];

/** A page that notes each error of the console and each request to another host. */
export async function open(address, options, expected = []) {
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
export async function checkAccessibility(page, name) {
  // The page's policy forbids scripts of others, so axe comes in by the debugger.
  await page.evaluate(axe);
  const found = await page.evaluate(() => globalThis.axe.run(document, {
    runOnly: ["wcag2a", "wcag2aa", "wcag21a", "wcag21aa", "best-practice"],
  }));
  const serious = found.violations.filter(({ impact }) => impact === "serious" || impact === "critical");
  const words = serious.map(({ id, help, nodes }) => `${id} (${help}): ${nodes.slice(0, 3).map(({ html }) => html.slice(0, 160)).join(" | ")}`);
  assert.deepEqual(words, [], `${name}: serious faults of accessibility`);
}

export const FORMS = [
  { name: "light", options: { colorScheme: "light", viewport: { width: 1440, height: 900 } } },
  { name: "dark", options: { colorScheme: "dark", viewport: { width: 1440, height: 900 } } },
  { name: "phone", options: { colorScheme: "dark", viewport: { width: 390, height: 844 }, deviceScaleFactor: 2, isMobile: true, hasTouch: true } },
];


/** A service on a fresh database. */
export async function serve(...more) {
  const port = await freePort();
  const database = `sqlite://${join(mkdtempSync(join(tmpdir(), "graphfix-test-")), "graphfix.db")}`;
  const { child, address } = await start(["serve", "--listen", `127.0.0.1:${port}`, "--database", database, ...more], /(http:\/\/127\.0\.0\.1:\d+)/);
  return { child, address, database };
}

/** What the program prints. */
export const run = (...words) => execFileSync(program, words, { encoding: "utf8" });

/** Checks how a page looks in one form, and takes its picture; a long page twice. */
export async function capture(page, name, { name: form, options }) {
  await checkAccessibility(page, `${name}, ${form}`);
  await page.screenshot({ path: join(folder, `${name}-${form}.png`) });
  const wide = await page.evaluate(() => document.documentElement.scrollWidth - innerWidth);
  assert(wide <= 0, `${name}, ${form}: the page is ${wide} px too wide`);
  // The whole page, whose main part scrolls by itself.
  const height = await page.evaluate(() => document.getElementById("main")?.scrollHeight ?? 0);
  if (options.viewport.height < height) {
    await page.setViewportSize({ width: options.viewport.width, height: Math.min(6000, height + 120) });
    await page.waitForTimeout(400);
    await page.screenshot({ path: join(folder, `${name}-${form}-whole.png`) });
    await page.setViewportSize(options.viewport);
  }
}
