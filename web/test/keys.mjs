// Keys and quotas in a browser: the first key, others, their end, and who does not see them.
import assert from "node:assert/strict";
import { FORMS, capture, checkAccessibility, open, run, serve, until } from "./harness.mjs";

const status = async (address, key, path = "/v1/sessions") =>
  (await fetch(`${address}${path}`, { headers: { authorization: `Bearer ${key}` } })).status;
const row = (page, label) => page.locator(".key-row", { hasText: label });

/** Creates a key with these rights by the form; returns its secret. */
async function create(page, label, rights) {
  const form = page.getByRole("form", { name: "New key" });
  await form.getByLabel("Label").fill(label);
  for (const right of ["device", "read", "operate", "admin"]) {
    const box = form.getByRole("checkbox", { name: new RegExp(`^${right}`) });
    if (await box.isEnabled()) await box.setChecked(rights.includes(right));
  }
  await form.getByRole("button", { name: /^Create/ }).click();
  return secretOf(page, label);
}

async function secretOf(page, label) {
  const box = page.locator(".secret", { hasText: label });
  await box.waitFor();
  await until("the secret has the focus", 5, () => page.evaluate(() => document.activeElement?.classList.contains("secret")));
  const secret = await box.locator("pre").textContent();
  assert.match(secret, /^gfx_[0-9a-f]{64}$/);
  return secret;
}

const stored = (page) => page.getByRole("button", { name: "I have stored it" }).click();

async function signIn(page, key) {
  await page.getByRole("heading", { name: "Sign in" }).waitFor();
  await page.locator("#key").fill(key);
  await page.keyboard.press("Enter");
}

const card = (page, tenant) => page.locator(".tenant", { hasText: tenant });

/** The quotas of a tenant: changed, used up, changed by somebody else meanwhile, and as the tenant sees them. */
async function quotas(page, address, database, admin) {
  const own = run("keys", "create", "--database", database, "--tenant", "acme", "--right", "operate,admin", "--label", "acme").match(/gfx_\S+/)[0];
  const call = async (key, path, method = "GET", body = undefined) => {
    const headers = { authorization: `Bearer ${key}`, "content-type": "application/json" };
    return (await fetch(`${address}${path}`, { method, headers, body: body && JSON.stringify(body) })).json();
  };
  const of = async () => (await call(admin, "/v1/tenants/acme")).quotas;
  await call(own, "/v1/sessions", "POST", { label: "rover" });
  await page.reload();
  await card(page, "acme").getByText("1, no limit").waitFor();
  const form = page.getByRole("form", { name: "Quotas of acme" });
  const change = () => page.getByRole("button", { name: "Change the quotas of acme" }).click();
  const set = () => form.getByRole("button", { name: "Set the quotas" }).click();
  await change();
  await form.getByLabel(/^Sessions/).fill("1");
  await form.getByLabel(/^Stored/).fill("0.5");
  await checkAccessibility(page, "quotas to be changed");
  await set();
  await card(page, "acme").getByText("1 of 1").waitFor();
  await card(page, "acme").getByText("used up").waitFor();
  assert.deepEqual(await of(), { sessions: 1, epochsPerS: null, cpuSPerMinute: null, storedBytes: 500_000_000, jobBytes: null });
  // Somebody else changes them while the form is open.
  await change();
  await call(admin, "/v1/tenants/acme", "PUT", { quotas: { sessions: 7 } });
  await form.getByLabel(/^Sessions/).fill("");
  await set();
  await form.locator(".problem", { hasText: "ETAG_MISMATCH" }).waitFor();
  assert.equal((await of()).sessions, 7);
  await page.reload();
  await card(page, "acme").getByText("1 of 7").waitFor();
  await change();
  await form.getByLabel(/^Sessions/).fill("");
  await set();
  await card(page, "acme").getByText("1, no limit").waitFor();
  await call(admin, "/v1/tenants/acme", "PUT", { quotas: { sessions: 1, epochsPerS: 200 } });
  // The tenant sees its own, and cannot change them.
  const other = await open(address, FORMS[0].options, ["401"]);
  await other.goto(`${address}/#/keys`);
  await signIn(other, own);
  await card(other, "acme").getByText("1 of 1").waitFor();
  assert.equal(await other.locator(".tenant").count(), 1);
  assert.equal(await other.getByRole("button", { name: /^Change the quotas/ }).count(), 0);
  await other.context().close();
}

export async function keys() {
  const { address, database } = await serve();
  const page = await open(address, FORMS[0].options, ["401", "403", "409", "412"]);
  page.on("filechooser", () => {}); // The browser shows none from now on, however busy it is.
  await page.goto(`${address}/#/keys`);
  await page.locator(".note.warn", { hasText: "No key exists" }).waitFor();
  await checkAccessibility(page, "no keys");
  // The first key locks the service, and the page goes on with it.
  const admin = await create(page, "operator", ["read", "operate", "admin"]);
  await page.getByRole("button", { name: "Sign out" }).waitFor();
  await row(page, "operator").getByText("yours").waitFor();
  assert.equal((await fetch(`${address}/v1/sessions`)).status, 401, "every call needs a key now");
  await checkAccessibility(page, "a new key");
  await stored(page);
  const kept = await page.evaluate(() => [
    document.documentElement.outerHTML, document.cookie, JSON.stringify(localStorage), JSON.stringify(sessionStorage), location.href,
  ].join("\n"));
  assert(!kept.includes(admin.slice(4)), "the page keeps the secret");

  const device = await create(page, "rovers", ["device"]);
  await stored(page);
  await quotas(page, address, database, admin);
  const reader = await create(page, "wall display", ["read"]);
  await stored(page);
  assert.deepEqual([await status(address, device), await status(address, reader)], [403, 200]);

  // Rotated: the new one works, the old one until it is revoked.
  await page.getByRole("button", { name: "Rotate rovers" }).click();
  const rotated = await secretOf(page, "rovers");
  assert.notEqual(rotated, device);
  assert.deepEqual([await status(address, device), await status(address, rotated)], [403, 403]);
  await page.getByRole("button", { name: "Revoke the old one: rovers" }).click();
  await page.getByRole("button", { name: "Revoke it" }).click();
  await page.locator(".secret").getByText("Revoked.").waitFor();
  await until("the old one is refused", 5, async () => (await status(address, device)) === 401);
  assert.equal(await status(address, rotated), 403);
  await stored(page);
  await until("one key of rovers is in force", 10, async () => (await row(page, "rovers").count()) === 1);
  await page.getByRole("button", { name: /^Show 1 revoked/ }).click();
  await page.locator(".key-row", { hasText: "revoked" }).waitFor();

  // Another mind: nothing happens without the second click.
  await row(page, "wall display").getByRole("button", { name: /^Revoke/ }).click();
  await page.getByRole("button", { name: "Keep it" }).click();
  assert.equal(await status(address, reader), 200);

  for (const form of FORMS) {
    const other = await open(address, form.options);
    await other.goto(`${address}/#/keys`);
    await signIn(other, admin);
    await row(other, "operator").waitFor();
    await other.getByRole("button", { name: /^Show 1 revoked/ }).click();
    await capture(other, "keys", form);
    await other.context().close();
  }

  // A reader finds the quotas, and sees neither keys nor forms.
  const display = await open(address, FORMS[0].options, ["401"]);
  await display.goto(address);
  await signIn(display, reader);
  await display.getByRole("link", { name: "Quotas", exact: true }).click();
  await display.getByRole("heading", { level: 1, name: "Quotas" }).waitFor();
  await card(display, "acme").waitFor();
  assert.equal(await display.title(), "Quotas · Graphfix");
  assert.equal(await display.locator(".problem, .key-row, .new-key").count(), 0);
  assert.equal(await display.getByRole("button", { name: /^Change the quotas/ }).count(), 0);
  assert.equal(await display.getByRole("link", { name: "Keys" }).count(), 0);
  await checkAccessibility(display, "keys without the right");
  await display.goto(`${address}/#/jobs`);
  await display.locator(".note", { hasText: "operate" }).waitFor();
  assert.equal(await display.locator(".new-job").count(), 0);
  // A key that may read nothing is told so, and has no such link.
  const sender = await open(address, FORMS[0].options, ["401", "403"]);
  await sender.goto(`${address}/#/keys`);
  await signIn(sender, rotated);
  await sender.locator(".problem", { hasText: "RIGHT_MISSING" }).waitFor();
  assert.equal(await sender.getByRole("link", { name: /Keys|Quotas/ }).count(), 0);
  await sender.context().close();
  // The reader's key ends: the page asks for another.
  await row(page, "wall display").getByRole("button", { name: /^Revoke/ }).click();
  await page.getByRole("button", { name: "Revoke it" }).click();
  await display.getByRole("heading", { name: "Sign in" }).waitFor({ timeout: 30_000 });
  await display.context().close();

  // A job of somebody who is signed in: the upload brings the token, too.
  await page.goto(`${address}/#/jobs`);
  const chooser = page.waitForEvent("filechooser");
  await page.getByRole("button", { name: "choose files" }).click();
  await (await chooser).setFiles([{ name: "rover.txt", mimeType: "text/plain", buffer: Buffer.from("no recording\n") }, { name: "brdc.nav", mimeType: "text/plain", buffer: Buffer.from("none\n") }]);
  await page.getByLabel("Role of rover.txt").selectOption("rover");
  await page.getByLabel("Role of brdc.nav").selectOption("navigation");
  await page.getByRole("button", { name: "Start the job" }).click();
  await page.locator(".job-state", { hasText: "Failed" }).waitFor({ timeout: 30_000 });

  // One's own key, the last with admin.
  await page.goto(`${address}/#/keys`);
  await row(page, "operator").getByRole("button", { name: /^Revoke/ }).click();
  await page.locator(".sure", { hasText: "you are signed out" }).waitFor();
  await page.getByRole("button", { name: "Revoke it" }).click();
  await page.getByRole("heading", { name: "Sign in" }).waitFor();
  await page.context().close();
}
