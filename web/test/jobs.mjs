// Batch jobs in a browser: from drop to report, by the keyboard, refused, failed, cancelled.
import assert from "node:assert/strict";
import { mkdtempSync, readFileSync, statSync, writeFileSync } from "node:fs";
import { tmpdir } from "node:os";
import { basename, join } from "node:path";
import { gzipSync } from "node:zlib";
import { FORMS, capture, checkAccessibility, open, run, serve, until } from "./harness.mjs";

const recording = mkdtempSync(join(tmpdir(), "graphfix-recording-"));
const file = (name) => join(recording, name);

export async function jobs() {
  run("simulate", "--scenario", "rtk-open", "--seed", "1", "--duration", "180", "--output", recording, "--force");
  writeFileSync(file("notes.txt"), "the antenna stood on the wall\n");
  const { address } = await serve();
  await fromDropToReport(address);
  await rolesFollowTheContent(address);
  await everyFormatIsShown(address);
  await byTheKeyboard(address);
  await refusalsAndFailures(address);
  await withoutEvents(address);
  await uploadsAreCancelled(address);
  await jobsAreCancelled(address);
  await pictures(address);
}

/** Drops files as a file manager does. */
async function drop(page, names) {
  const content = names.map((name) => ({ name: basename(name), base64: readFileSync(name).toString("base64") }));
  const transfer = await page.evaluateHandle((content) => {
    const transfer = new DataTransfer();
    for (const { name, base64 } of content) {
      const bytes = Uint8Array.from(atob(base64), (letter) => letter.charCodeAt(0));
      transfer.items.add(new File([bytes], name));
    }
    return transfer;
  }, content);
  await page.locator(".new-job").waitFor();
  await until("the page takes files", 30, async () => {
    await page.dispatchEvent("main", "dragover", { dataTransfer: transfer });
    return 0 < await page.locator(".new-job.over").count();
  });
  await page.dispatchEvent("main", "drop", { dataTransfer: transfer });
}

const role = (page, name) => page.getByLabel(`Role of ${name}`);
const hasRole = (page, name, expected) =>
  until(`${name} is ${expected}`, 10, async () => (await role(page, name).inputValue()) === expected);
const mode = (page) => page.locator("select[name=mode]");
const submit = (page) => page.getByRole("button", { name: "Start the job" });
const onJob = (page) => page.waitForURL(/#\/jobs\/job_/, { timeout: 30_000 });
const succeeded = (page) => page.locator(".job-state", { hasText: "Succeeded" }).waitFor({ timeout: 120_000 });

async function fromDropToReport(address) {
  const page = await open(address, FORMS[0].options);
  await page.goto(`${address}/#/jobs`);
  await page.getByRole("heading", { name: "No job yet" }).waitFor();
  await drop(page, ["base.obs", "navigation.rnx", "rover.obs", "notes.txt"].map(file));
  // What each file is, is told by its content and name.
  for (const [name, expected] of [["base.obs", "base"], ["navigation.rnx", "navigation"], ["rover.obs", "rover"], ["notes.txt", "none"]]) {
    await hasRole(page, name, expected);
  }
  assert.match(await page.locator(".job-files").textContent(), /RINEX 3\.05 observations · ROVER/);
  assert.equal(await mode(page).inputValue(), "rtk-fgo");
  // Roles can be changed; the mode follows while the user has not chosen it.
  await role(page, "base.obs").selectOption("none");
  assert.equal(await mode(page).inputValue(), "fgo");
  await role(page, "base.obs").selectOption("rover");
  await hasRole(page, "rover.obs", "base");
  await role(page, "base.obs").selectOption("base");
  await hasRole(page, "rover.obs", "rover");
  assert.equal(await mode(page).inputValue(), "rtk-fgo");
  await page.getByRole("button", { name: "Remove notes.txt" }).click();

  const asked = [];
  page.on("request", (request) => asked.push(`${request.method()} ${new URL(request.url()).pathname}`));
  await submit(page).click();
  await onJob(page);
  const id = page.url().split("/").at(-1);
  await succeeded(page);
  assert(asked.includes(`GET /v1/jobs/${id}/events`), "the page follows the events");
  assert(!asked.includes(`GET /v1/jobs/${id}`), "the page does not poll beside them");
  // The report, and what the file of positions has.
  const shares = page.locator("section[aria-label=Statuses] li");
  await shares.first().waitFor();
  assert.match(await shares.allTextContents().then((all) => all.join()), /Fixed 1\d\d/);
  assert.match(await page.locator("section[aria-label=Origin]").textContent(), /base: marker at .* from its header/);
  await page.locator(".uplot").first().waitFor();
  assert.match(await page.locator(".plots .card-head").textContent(), /181 epochs/);
  const plot = page.locator(".plots .u-over").nth(1);
  await plot.scrollIntoViewIfNeeded();
  await plot.click({ position: { x: 200, y: 40 } });
  await page.getByRole("heading", { name: /^Position \d+$/ }).waitFor();
  const arriving = page.waitForEvent("download");
  await page.getByRole("link", { name: /^Download pos/ }).click();
  const result = await (await arriving).path();
  const job = await (await fetch(`${address}/v1/jobs/${id}`)).json();
  assert.equal(statSync(result).size, job.resultBytes);
  assert(job.options.smoothed, "smoothed unless chosen otherwise");
  const link = page.getByRole("link", { name: "Report as a page", exact: true });
  await reportIsAPage(address, await link.getAttribute("href"));
  await page.goto(`${address}/#/jobs`);
  await page.locator(".job-row", { hasText: "rover.obs" }).getByText("Succeeded").waitFor();
  // The same options for another recording.
  await page.locator(".job-row a").first().click();
  await page.getByRole("link", { name: "A new job with these options" }).click();
  await drop(page, [file("rover.obs")]);
  await until("the mode is that of the job", 10, async () => (await mode(page).inputValue()) === "rtk-fgo");
  assert.match(await page.locator("#job-missing").textContent(), /rtk-fgo needs the file of a base/);
  await page.context().close();
}

/** The report as a page, in each form, light and dark. */
async function reportIsAPage(address, path) {
  for (const form of FORMS) {
    const page = await open(address, form.options);
    await page.goto(`${address}${path}`);
    await page.getByRole("img", { name: "Height over time" }).waitFor();
    await capture(page, "report", form);
    await page.context().close();
  }
}

/** A frame of UBX with its checksum. */
function ubx(group, number, payload) {
  const frame = [group, number, payload.length & 0xff, payload.length >> 8, ...payload];
  let [a, b] = [0, 0];
  for (const byte of frame) [a, b] = [(a + byte) & 0xff, (b + a + byte) & 0xff];
  return Buffer.from([0xb5, 0x62, ...frame, a, b]);
}

/** What files of other kinds are taken for. */
async function rolesFollowTheContent(address) {
  const page = await open(address, FORMS[0].options);
  run("simulate", "--scenario", "open-sky", "--seed", "3", "--duration", "30", "--format", "gnss-logger", "--output", join(recording, "phone"), "--force");
  const rinex = readFileSync(file("rover.obs"));
  // The antenna of the reference station of RTCM 3 (message 1005), from its specification.
  const station = Buffer.from("d300133ed7d30202980edeef34b4bd62ac0941986f33360b98", "hex");
  const given = (name, buffer) => ({ name, mimeType: "application/octet-stream", buffer });
  const cases = [
    [[given("HERS00GBR_R_20180010000_01D_30S_MO.rnx.gz", gzipSync(rinex)), given("a.obs", rinex)], ["base RINEX 3.05", "rover RINEX 3.05"]],
    [[given("a.log", Buffer.concat([ubx(2, 0x15, [0, 0]), ubx(2, 0x13, [0, 0, 0])]))], ["rover+navigation u-blox UBX log with ephemerides"]],
    [[given("a.log", Buffer.concat([ubx(2, 0x15, [0, 0]), ubx(2, 0x13, [0])])), given("b.nav", readFileSync(file("navigation.rnx")))], ["rover u-blox", "navigation RINEX 3.05 navigation"]],
    [[given("roof.bin", station), given("rover.ubx", ubx(2, 0x15, [0]))], ["base RTCM 3 log", "rover u-blox"]],
    [[given("log.txt", readFileSync(join(recording, "phone", "gnss_log.txt")))], ["rover Android GnssLogger log"]],
    [[given("a.Z", Buffer.from([0x1f, 0x9d, 0x90, 1, 2, 3, 4, 5])), given("noise", Buffer.alloc(300_000, 0xd3))], ["none file of compress", "none not recognised"]],
  ];
  for (const [files, expected] of cases) {
    await page.goto(`${address}/#/bases`); // Leaves the form, which forgets its files.
    await page.getByRole("heading", { name: "No base station yet" }).waitFor();
    await page.goto(`${address}/#/jobs`);
    await page.locator("input[type=file]").setInputFiles(files);
    for (const [i, words] of expected.entries()) {
      const row = page.locator(".job-files li").nth(i);
      const found = async () => `${await row.locator("select").inputValue()} ${await row.locator(".file-look").textContent()}`;
      await until(`${files[i].name} is ${words}`, 10, async () => (await found()).startsWith(words));
    }
  }
  await page.locator("input[type=file]").setInputFiles([given("log.txt", readFileSync(join(recording, "phone", "gnss_log.txt")))]);
  await until("the profile is that of phones", 10, async () => (await page.locator("select[name=profile]").inputValue()) === "phone");
  await page.context().close();
}

/** The track of a result is read from each format; the counts are those of the report. */
async function everyFormatIsShown(address) {
  const page = await open(address, FORMS[0].options);
  for (const format of ["pos", "csv", "geojson", "kml", "gpx", "nmea"]) {
    const form = new FormData();
    for (const part of ["rover", "base"]) form.append(part, new Blob([readFileSync(file(`${part}.obs`))]), `${format}.obs`);
    form.append("navigation", new Blob([readFileSync(file("navigation.rnx"))]), "navigation.rnx");
    form.append("options", JSON.stringify({ mode: "rtk-fgo", format }));
    const { job } = await (await fetch(`${address}/v1/jobs`, { method: "POST", body: form })).json();
    await page.goto(`${address}/#/jobs/${job}`);
    await succeeded(page);
    await page.locator(".uplot").first().waitFor();
    assert.match(await page.locator(".plots .card-head").textContent(), /181 epochs/, format);
    const legend = await page.locator(".job-map .map-legend").textContent();
    assert(legend.includes("Fixed") && legend.includes("Float"), `${format}: ${legend}`);
    // The same first epoch, whatever its format.
    await page.locator(".plots .u-over").first().click({ position: { x: 1, y: 20 } });
    const figures = await page.locator("section[aria-label^=Position] .figures").textContent();
    assert.match(figures, /Time \(UTC\)2026-01-01 05:59:42/, format);
    assert.match(figures, /Latitude, longitude22\.\d{8}°, 114\.\d{8}°/, format);
    assert.equal(/σ horizontal\d/.test(figures), format !== "gpx", `${format}: ${figures}`);
  }
  await page.context().close();
}

async function byTheKeyboard(address) {
  const page = await open(address, FORMS[0].options);
  await page.goto(`${address}/#/jobs`);
  await page.locator(".job-row").first().waitFor();
  page.on("filechooser", () => {}); // The browser shows none from now on, however busy it is.
  const focused = () => page.evaluate(() => document.activeElement?.textContent ?? "");
  const tabTo = async (words) => {
    for (let i = 0; i < 60; i += 1) {
      await page.keyboard.press("Tab");
      if ((await focused()).trim() === words) return;
    }
    assert.fail(`no way to ${words} by the Tab key`);
  };
  await tabTo("choose files");
  const chooser = page.waitForEvent("filechooser");
  await page.keyboard.press("Enter");
  await (await chooser).setFiles([file("rover.obs"), file("navigation.rnx")]);
  await hasRole(page, "rover.obs", "rover");
  await page.locator("select[name=format]").focus();
  await page.keyboard.press("g"); // GeoJSON
  await tabTo("Start the job");
  await page.keyboard.press("Enter");
  await onJob(page);
  await succeeded(page);
  await page.locator(".uplot").first().waitFor();
  assert.match(await page.locator(".job").textContent(), /fgo · smoothed[^]*geojson/);
  await page.context().close();
}

async function refusalsAndFailures(address) {
  const page = await open(address, FORMS[0].options, ["400", "404"]);
  await page.goto(`${address}/#/jobs`);
  await drop(page, [file("rover.obs"), file("navigation.rnx")]);
  await hasRole(page, "rover.obs", "rover");
  await page.getByText("More options").click();
  await page.getByLabel("Overrides").fill("no_such_option=1");
  await submit(page).click();
  const problem = page.locator(".problem");
  await problem.waitFor();
  const text = await problem.textContent();
  assert.match(text, /UNKNOWN_OPTION/);
  assert.match(text, /field options/);
  assert(20 < (await problem.locator(".remedy").textContent()).length, "a remedy");
  await checkAccessibility(page, "a refused job");
  // What the user has filled in stays.
  await page.getByLabel("Overrides").fill("elevation_mask_deg=12");
  await submit(page).click();
  await onJob(page);
  await succeeded(page);

  // A file that is no recording, in a role that the user has insisted on.
  await page.goto(`${address}/#/jobs`);
  await drop(page, [file("notes.txt"), file("navigation.rnx")]);
  await hasRole(page, "navigation.rnx", "navigation");
  await role(page, "notes.txt").selectOption("rover");
  await submit(page).click();
  await onJob(page);
  await page.locator(".job-state", { hasText: "Failed" }).waitFor({ timeout: 60_000 });
  const failure = await page.locator(".problem").textContent();
  assert.match(failure, /FILE_NOT_UNDERSTOOD · field rover/);
  for (const form of FORMS) {
    const other = await open(address, form.options);
    await other.goto(page.url());
    await other.locator(".problem").waitFor();
    await capture(other, "job-failed", form);
    await other.context().close();
  }
  await page.goto(`${address}/#/jobs/job_00000000000000000000000000000000`);
  await page.locator(".problem", { hasText: "JOB_NOT_FOUND" }).waitFor();
  await page.context().close();
}

/** A proxy that lets no events through: the page polls. */
async function withoutEvents(address) {
  const page = await open(address, FORMS[0].options, ["ERR_FAILED"]);
  await page.route("**/events", (route) => route.abort());
  await page.goto(`${address}/#/jobs`);
  await drop(page, [file("rover.obs"), file("navigation.rnx")]);
  await hasRole(page, "rover.obs", "rover");
  await submit(page).click();
  await onJob(page);
  await succeeded(page);
  await page.context().close();
}

async function uploadsAreCancelled(address) {
  const before = (await (await fetch(`${address}/v1/jobs`)).json()).jobs.length;
  const page = await open(address, FORMS[0].options);
  await page.goto(`${address}/#/jobs`);
  const network = await page.context().newCDPSession(page);
  const slow = { offline: false, latency: 0, downloadThroughput: -1, uploadThroughput: 40_000 };
  await drop(page, [file("rover.obs"), file("navigation.rnx")]);
  await hasRole(page, "rover.obs", "rover");
  await network.send("Network.emulateNetworkConditions", slow);
  await submit(page).click();
  const bar = page.getByRole("progressbar", { name: "Upload" });
  await bar.waitFor();
  await until("the upload moves", 30, async () => 0 < Number(await bar.getAttribute("aria-valuenow")));
  await checkAccessibility(page, "an upload");
  await page.getByRole("button", { name: "Cancel the upload" }).click();
  await submit(page).waitFor();
  assert.equal(await page.locator(".problem").count(), 0);
  assert.equal(await role(page, "rover.obs").inputValue(), "rover", "the files stay");
  await page.context().close();
  const after = (await (await fetch(`${address}/v1/jobs`)).json()).jobs.length;
  assert.equal(after, before, "a cancelled upload is no job");
}

/** Cancels a job that waits behind others, on its page and in the list. */
async function jobsAreCancelled(address) {
  const long = mkdtempSync(join(tmpdir(), "graphfix-long-"));
  run("simulate", "--scenario", "rtk-open", "--seed", "2", "--duration", "3600", "--output", long, "--force");
  const form = new FormData();
  for (const [part, name] of [["rover", "rover.obs"], ["base", "base.obs"], ["navigation", "navigation.rnx"]]) {
    form.append(part, new Blob([readFileSync(join(long, name))]), name);
  }
  // Each epoch is smoothed by the thousand behind it: a job takes many times as long as the steps below.
  const overrides = { window_s: "1000", window_epochs_max: "1000" };
  form.append("options", JSON.stringify({ mode: "rtk-fgo", smoothed: true, overrides }));
  const post = async () => (await (await fetch(`${address}/v1/jobs`, { method: "POST", body: form })).json()).job;
  const all = [];
  for (let i = 0; i < 10; i += 1) all.push(await post());
  const page = await open(address, FORMS[0].options);
  await page.goto(`${address}/#/jobs`);
  await page.locator(".job-row", { hasText: "Runs" }).first().waitFor();
  for (const shape of FORMS) {
    const other = await open(address, shape.options);
    await other.goto(`${address}/#/jobs`);
    await other.locator(".job-row", { hasText: "Runs" }).first().waitFor();
    await capture(other, "jobs-running", shape);
    await other.context().close();
  }
  const last = page.locator(".job-row").first();
  await last.getByRole("button", { name: /^Cancel/ }).click();
  await last.getByText("Cancelled").waitFor();
  await page.goto(`${address}/#/jobs/${all.at(-2)}`);
  await page.getByRole("button", { name: /^Cancel/ }).click();
  await page.locator(".job-state", { hasText: "Cancelled" }).waitFor();
  await page.locator(".note", { hasText: "It has no result" }).waitFor();
  for (const job of all) await fetch(`${address}/v1/jobs/${job}`, { method: "DELETE" });
  await page.context().close();
}

async function pictures(address) {
  const { jobs } = await (await fetch(`${address}/v1/jobs`)).json();
  const done = jobs.find(({ state, options }) => state === "SUCCEEDED" && options.mode === "rtk-fgo");
  for (const form of FORMS) {
    const page = await open(address, form.options);
    await page.goto(`${address}/#/jobs`);
    await page.locator(".job-row").first().waitFor();
    await capture(page, "jobs", form);
    await drop(page, ["base.obs", "navigation.rnx", "rover.obs", "notes.txt"].map(file));
    await hasRole(page, "rover.obs", "rover");
    await capture(page, "jobs-new", form);
    await page.goto(`${address}/#/jobs/${done.job}`);
    await page.getByLabel("Truth file").setInputFiles(file("truth.csv"));
    await page.locator(".truth .uplot").waitFor();
    await page.waitForTimeout(500);
    await capture(page, "job", form);
    await page.context().close();
  }
}
