// What the page of a job says of its result: on what it rests.
import assert from "node:assert/strict";
import { mkdtempSync, readFileSync } from "node:fs";
import { tmpdir } from "node:os";
import { join } from "node:path";
import { FORMS, checkAccessibility, open, run, serve } from "./harness.mjs";

const recording = mkdtempSync(join(tmpdir(), "graphfix-results-"));
const file = (name) => readFileSync(join(recording, name));

export async function jobResults() {
  run("simulate", "--scenario", "rtk-open", "--seed", "1", "--duration", "60", "--output", recording, "--force");
  const { address } = await serve();
  await addedInputsAreNamed(address);
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
