// Positions against a truth file, of a session and of a job; and their ends.
import assert from "node:assert/strict";
import { mkdtempSync, readFileSync, writeFileSync } from "node:fs";
import { tmpdir } from "node:os";
import { join } from "node:path";
import { FORMS, capture, checkAccessibility, open, run, serve, until } from "./harness.mjs";

const recording = mkdtempSync(join(tmpdir(), "graphfix-truth-"));
const file = (name) => join(recording, name);
const truth = file("truth.csv");

export async function truths() {
  run("simulate", "--scenario", "urban-canyon", "--seed", "1", "--duration", "120", "--output", recording, "--force");
  const { address } = await serve();
  const files = ["--rover", file("rover.obs"), "--nav", file("navigation.rnx")];
  run("stream", ...files, "--mode", "fgo", "--server", address, "--speed", "max");
  const { heads: [{ session }] } = await (await fetch(`${address}/v1/sessions:heads`)).json();
  const sessionPath = `${address}/#/sessions/${session}`;
  await ofASession(address, session, sessionPath);
  const jobPath = await ofAJob(address);
  await pictures(address, sessionPath);
  await aJobIsDeleted(address, jobPath);
  await aSessionEnds(address, session, sessionPath);
}

const give = (page, given) => page.getByLabel("Truth file").setInputFiles(given);
const text = (name, content) => ({ name, mimeType: "text/csv", buffer: Buffer.from(content) });
const figures = (page) => page.locator(".truth .figures").textContent();

/** A length as the page writes it. */
const metres = (m) => (m < 0.0995 ? `${(m * 1000).toFixed(0)} mm` : `${m.toFixed(2)} m`);

/** What `graphfix evaluate` finds in the same positions. */
function expected(solution) {
  const { err2d: { n, mean, p95, max } } = JSON.parse(run("evaluate", "--solution", solution, "--truth", truth, "--json"));
  return { n, words: `Horizontal mean${metres(mean)}Horizontal 95 %${metres(p95)}Horizontal max${metres(max)}` };
}

async function ofASession(address, session, path) {
  const page = await open(address, FORMS[0].options);
  const changes = [];
  page.on("request", (request) => request.method() !== "GET" && changes.push(request.url()));
  await page.goto(path);
  const chooser = page.waitForEvent("filechooser");
  await page.getByRole("button", { name: "Compare with a truth file" }).click();
  // Files that are no truth, each with the line at fault.
  await (await chooser).setFiles(text("notes.csv", "gps_week,tow,x_m,y_m,z_m\n2399,367200,1,2,3\n2399,367201,north,2,3\n"));
  await page.locator(".truth .problem", { hasText: /notes\.csv: line 3: "2399,367201,north,2,3" does not have five numbers/ }).waitFor();
  await checkAccessibility(page, "a wrong truth file");
  await give(page, text("a.pos", "% program: x\n2399 367200.000 22.3 114.1\n"));
  await page.locator(".truth .problem", { hasText: /a\.pos: line 2: / }).waitFor();
  await give(page, text("empty.csv", "gps_week,tow,x_m,y_m,z_m\n"));
  await page.locator(".truth .problem", { hasText: "no line with a position" }).waitFor();
  // A truth of another day has nothing to compare.
  await give(page, text("other.csv", "2390,1000,22.3,114.1,5\n2390,1001,22.3,114.1,5\n"));
  await page.locator(".truth .note", { hasText: "No position has a truth at its time" }).waitFor();

  const track = await fetch(`${address}/v1/sessions/${session}/track.csv?revisions=first`);
  const causal = file("causal.csv");
  writeFileSync(causal, await track.text());
  const { n, words } = expected(causal);
  await give(page, truth);
  await page.locator(".truth .uplot").waitFor();
  assert.equal(await figures(page), `Epochs compared${n} of ${n}${words}`);
  await page.locator(".map-legend", { hasText: "truth" }).waitFor();
  // The week may be unknown, and a truth of every other second is interpolated.
  const lines = readFileSync(truth, "utf8").trim().split("\n");
  const sparse = lines.filter((_, i) => i === 0 || i % 2 === 1).map((line) => line.replace(/^\d+/, "-1"));
  await give(page, text("sparse.csv", sparse.join("\n")));
  await page.getByRole("button", { name: "Remove sparse.csv" }).waitFor();
  assert.match(await figures(page), new RegExp(`^Epochs compared${n} of ${n}`));
  // The positions against themselves.
  await give(page, causal);
  await page.getByRole("button", { name: "Remove causal.csv" }).waitFor();
  assert.match(await figures(page), /Horizontal max0 mm$/);
  await page.getByRole("button", { name: "Revised" }).last().click();
  await until("revised positions differ", 5, async () => !/Horizontal max0 mm$/.test(await figures(page)));
  // A click in the chart chooses an epoch, there and in the residuals.
  for (const title of ["Error", "Residuals"]) {
    const plot = page.locator(".chart", { hasText: title }).locator(".u-over");
    await plot.scrollIntoViewIfNeeded();
    await plot.click({ position: { x: 150, y: 40 } });
    await page.locator(".chosen", { hasText: "Epoch" }).waitFor();
    await page.getByRole("button", { name: "Follow the last" }).click();
  }
  await page.getByRole("button", { name: "Remove causal.csv" }).click();
  assert.equal(await page.locator(".truth .uplot").count(), 0);
  assert.deepEqual(changes, [], "nothing is uploaded");
  await page.context().close();
}

async function ofAJob(address) {
  const form = new FormData();
  for (const [part, name] of [["rover", "rover.obs"], ["navigation", "navigation.rnx"]]) {
    form.append(part, new Blob([readFileSync(file(name))]), name);
  }
  form.append("options", JSON.stringify({ mode: "fgo", format: "csv" }));
  const { job } = await (await fetch(`${address}/v1/jobs`, { method: "POST", body: form })).json();
  const page = await open(address, FORMS[0].options);
  const path = `${address}/#/jobs/${job}`;
  await page.goto(path);
  await page.locator(".truth").waitFor({ timeout: 60_000 });
  const result = file("result.csv");
  writeFileSync(result, await (await fetch(`${address}/v1/jobs/${job}/result`)).text());
  const { n, words } = expected(result);
  // Dropped, as a file manager does.
  const transfer = await page.evaluateHandle((content) => {
    const transfer = new DataTransfer();
    transfer.items.add(new File([content], "truth.csv"));
    return transfer;
  }, readFileSync(truth, "utf8"));
  await page.dispatchEvent(".truth", "drop", { dataTransfer: transfer });
  await page.locator(".truth .uplot").waitFor();
  assert.equal(await figures(page), `Epochs compared${n} of ${n}${words}`);
  await page.locator(".job-map .map-legend", { hasText: "truth" }).waitFor();
  await page.context().close();
  return path;
}

async function pictures(address, path) {
  for (const form of FORMS) {
    const page = await open(address, form.options);
    await page.goto(path);
    await give(page, truth);
    await page.locator(".truth .uplot").waitFor();
    await page.waitForTimeout(300);
    await capture(page, "session-truth", form);
    await page.context().close();
  }
}

const button = (page, name) => page.getByRole("button", { name });

async function aJobIsDeleted(address, path) {
  const page = await open(address, FORMS[0].options);
  await page.goto(path);
  await button(page, "Delete: rover.obs").click();
  await page.locator(".sure", { hasText: "lost for good" }).waitFor();
  await button(page, "Keep it").click();
  await button(page, "Delete: rover.obs").click();
  await button(page, "Delete it").click();
  await page.getByRole("heading", { name: "No job yet" }).waitFor();
  assert.deepEqual((await (await fetch(`${address}/v1/jobs`)).json()).jobs, []);
  await page.context().close();
}

async function aSessionEnds(address, session, path) {
  // 404: what the page asks while the session is deleted.
  const page = await open(address, FORMS[0].options, ["404"]);
  const fleet = await open(address, FORMS[0].options);
  await fleet.goto(address);
  await fleet.locator("a.device", { hasText: "rover.obs" }).waitFor();
  await page.goto(path);
  const of = async () => (await fetch(`${address}/v1/sessions/${session}`)).json();
  await button(page, "Close: rover.obs").click();
  await page.locator(".sure", { hasText: "Its solutions stay" }).waitFor();
  await checkAccessibility(page, "a session to be closed");
  assert.equal((await of()).closed, false, "nothing happens without the second click");
  await button(page, "Close it").click();
  await page.locator(".session-title .badge", { hasText: "Closed" }).waitFor();
  assert.equal((await of()).closed, true);
  assert.equal(await button(page, "Close: rover.obs").count(), 0);
  await button(page, "Delete for good: rover.obs").click();
  await button(page, "Delete it").click();
  await page.getByRole("heading", { name: "No session yet" }).waitFor();
  assert.equal((await of()).code, "SESSION_NOT_FOUND");
  await fleet.getByRole("heading", { name: "No session yet" }).waitFor();
  await fleet.context().close();
  await page.context().close();
}
