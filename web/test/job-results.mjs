// What the pages say of the result of a job: on what it rests, and that there is no position or no track.
import assert from "node:assert/strict";
import { mkdtempSync, readFileSync } from "node:fs";
import { tmpdir } from "node:os";
import { join } from "node:path";
import { FORMS, capture, checkAccessibility, open, run, serve } from "./harness.mjs";

const recording = mkdtempSync(join(tmpdir(), "graphfix-results-"));
const file = (name) => readFileSync(join(recording, name));

export async function jobResults() {
  run("simulate", "--scenario", "rtk-open", "--seed", "1", "--duration", "60", "--output", recording, "--force");
  const { address } = await serve();
  await addedInputsAreNamed(address);
  await withoutPositions(address);
  await withoutTrack(address);
}

/** Navigation data of one satellite, for some hours: too little for a position. */
function oneSatellite() {
  const [header, records] = String(file("navigation.rnx")).split(/(?<=END OF HEADER *\n)/);
  return `${header}${records.split("\n").slice(0, 8).join("\n")}\n`;
}

/** Creates a job from parts and options; returns its id. */
async function create(address, parts, options) {
  const form = new FormData();
  for (const [part, content, name] of parts) form.append(part, new Blob([content]), name);
  form.append("options", JSON.stringify(options));
  const answer = await fetch(`${address}/v1/jobs`, { method: "POST", body: form });
  assert.equal(answer.status, 201);
  return (await answer.json()).job;
}

/** Posts a body; returns the answer. */
async function post(address, path, type, body) {
  const answer = await fetch(`${address}${path}`, { method: "POST", headers: { "content-type": type }, body });
  assert(answer.ok, `${path}: ${answer.status}`);
  return answer.json();
}

/** Ephemerides and a base of the service are called by their part, and each is named once. */
async function addedInputsAreNamed(address) {
  const { base } = await post(address, "/v1/bases", "application/json", JSON.stringify({ label: "roof" }));
  await post(address, "/v1/navigation", "application/octet-stream", file("navigation.rnx"));
  await post(address, `/v1/bases/${base}/observations`, "application/octet-stream", file("base.obs"));
  const job = await create(address, [["rover", file("rover.obs"), "rover.obs"]], { mode: "rtk-fgo" });
  const page = await open(address, FORMS[0].options);
  await page.goto(`${address}/#/jobs/${job}`);
  const origin = page.locator("section[aria-label=Origin] li");
  await origin.first().waitFor({ timeout: 120_000 });
  const lines = await origin.allTextContents();
  const added = lines.filter((line) => line.includes("added by the service"));
  assert.equal(added.length, 2, lines.join("\n"));
  assert.match(added[0], /^navigation: the service's own ephemerides \(added by the service, not in the upload\)$/);
  assert.match(added[1], new RegExp(`^base: ${base}, .* from the rover: its stored epochs`));
  for (const fact of ["the service's own ephemerides", base]) {
    assert.equal(lines.filter((line) => line.includes(fact)).length, 1, `${fact} once: ${lines.join("\n")}`);
  }
  await checkAccessibility(page, "a job with inputs of the service");
  await page.context().close();
}

/** A job that ran to its end and positioned nothing does not look like one that did. */
async function withoutPositions(address) {
  const alone = (name, navigation) =>
    create(address, [["rover", file("rover.obs"), name], ["navigation", navigation, "navigation.rnx"]], { mode: "fgo" });
  const none = await alone("nowhere.obs", oneSatellite());
  const all = await alone("somewhere.obs", file("navigation.rnx"));
  for (const form of FORMS) {
    const page = await open(address, form.options);
    await page.goto(`${address}/#/jobs`);
    const row = page.locator(".job-row", { hasText: "nowhere.obs" });
    await row.getByText("No position").waitFor({ timeout: 120_000 });
    await row.getByText("61 epochs, none with a position, in ").waitFor();
    assert.equal(await row.getByText("Succeeded").count(), 0);
    const other = page.locator(".job-row", { hasText: "somewhere.obs" });
    await other.getByText("Succeeded").waitFor({ timeout: 120_000 });
    await other.getByText("61 epochs, all with a position, in ").waitFor();
    await capture(page, "jobs-without-position", form);
    await page.goto(`${address}/#/jobs/${none}`);
    await page.locator(".job-state", { hasText: "No position" }).waitFor();
    await page.locator(".note.warn", { hasText: "no epoch of 61 has a position" }).waitFor();
    await page.locator(".job-result .figure", { hasText: "With a position" }).getByText("none").waitFor();
    await page.locator("section[aria-label=Reasons]").getByText("EPHEMERIS_MISSING").waitFor();
    await capture(page, "job-without-position", form);
    await page.goto(`${address}/#/jobs/${all}`);
    await page.locator(".job-state", { hasText: "Succeeded" }).waitFor();
    await page.locator(".job-result .figure").first().waitFor();
    assert.equal(await page.locator(".note.warn").count(), 0);
    await page.context().close();
  }
}

/** Where there is no track, its place is not left empty; what is downloaded is said. */
async function withoutTrack(address) {
  const alone = (format, navigation) =>
    create(address, [["rover", file("rover.obs"), `${format}.obs`], ["navigation", navigation, "navigation.rnx"]], { mode: "fgo", format });
  const cases = [
    [await alone("rinex", file("navigation.rnx")), "This page reads no track from a result as rinex"],
    [await alone("csv", oneSatellite()), "so there is no track"],
    [await alone("rinex", oneSatellite()), "so there is no track"],
  ];
  for (const [i, [job, words]] of cases.entries()) {
    for (const form of FORMS) {
      const page = await open(address, form.options);
      await page.goto(`${address}/#/jobs/${job}`);
      await page.locator("section[aria-label=Statuses]").waitFor({ timeout: 120_000 });
      const notes = page.locator(".note");
      assert.match(await notes.allTextContents().then((all) => all.join()), new RegExp(words));
      assert.equal(await notes.count(), 1);
      assert((await notes.boundingBox()).height < 200, "the note is as high as its words");
      assert.equal(await page.locator(".job-map, .report-grid, .plots").count(), 0);
      await page.getByRole("link", { name: "Report as a page", exact: true }).waitFor();
      if (i === 0) await capture(page, "job-without-track", form);
      const arriving = page.waitForEvent("download");
      await page.getByRole("link", { name: "Download the report", exact: true }).click();
      assert.equal((await arriving).suggestedFilename(), `${job}-report.html`);
      await page.context().close();
    }
  }
}
