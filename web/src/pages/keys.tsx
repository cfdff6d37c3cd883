/** Keys for administrators, and quotas: who may call what, and how much. */
import { useContext, useEffect, useRef, useState } from "preact/hooks";
import { Problem, SIGNED_OUT, all, change, problemOf, signIn } from "../api";
import { useLive } from "../live";
import { Quotas } from "../quotas";
import { RIGHTS, type Right, SignedIn, useRight } from "../rights";
import { ago, count, duration } from "../time";
import { Confirm, Copyable, Lamp, Loading, ProblemBox } from "../ui";

interface Key {
  key: string;
  label: string;
  tenant: string;
  rights: Right[];
  createdUtc: string;
  expiresUtc?: string | null;
  revokedUtc?: string | null;
  lastUsedUtc?: string | null;
}
interface Created {
  key: Key;
  secret: string;
}

const DAY_S = 86_400;
const LIFETIMES = [
  { days: 0, name: "until it is revoked" },
  { days: 1, name: "a day" },
  { days: 7, name: "a week" },
  { days: 30, name: "30 days" },
  { days: 90, name: "90 days" },
  { days: 365, name: "a year" },
];

const keys = (signal?: AbortSignal) => all<Key>("/v1/keys", "keys", 1000, signal);

const isInForce = ({ revokedUtc, expiresUtc }: Key): boolean => !revokedUtc && !(expiresUtc && Date.parse(expiresUtc) <= Date.now());
const agoOf = (utc: string): string => ago((Date.now() - Date.parse(utc)) / 1000);

export function KeysPage() {
  const mayAdmin = useRight("admin");
  const { needed, key: own, rights } = useContext(SignedIn);
  if (!mayAdmin && rights.includes("read")) {
    return (
      <div class="page keys">
        <h1>Quotas</h1>
        <p class="note">Your key shows quotas. To see and make keys, sign in with a key that has the right <code>admin</code>.</p>
        <Quotas title="Tenants" />
      </div>
    );
  }
  if (!mayAdmin) {
    return (
      <div class="page keys">
        <h1>Keys and quotas</h1>
        <ProblemBox problem={new Problem("RIGHT_MISSING", `your key has the ${rights.length === 1 ? "right" : "rights"} ${rights.join(", ")}; this page needs admin for keys, and read for quotas`, "sign out, and sign in with a key that has the right read or admin")} what="Keys and quotas are not shown" />
      </div>
    );
  }
  return <Administration needed={needed} own={own} />;
}

function Administration({ needed, own }: { needed: boolean; own: string | undefined }) {
  const [version, setVersion] = useState(0);
  const [created, setCreated] = useState<Created & { replaces?: Key }>();
  const [showEnded, setShowEnded] = useState(false);
  const live = useLive(`keys:${version}`, keys, 10_000);
  const last = useRef<Key[]>([]);
  last.current = live.value ?? last.current;
  const list = last.current;
  const again = () => setVersion((n) => n + 1);
  const inForce = list.filter(isInForce);
  const ended = list.length - inForce.length;
  const made = async (result: Created, replaces?: Key) => {
    setCreated({ ...result, replaces });
    if (!needed) {
      // The first key: from now on this page needs it, too.
      await signIn(result.secret).catch(() => undefined);
      document.dispatchEvent(new Event(SIGNED_OUT));
    }
    again();
  };
  return (
    <div class="page keys">
      <h1>Keys and quotas</h1>
      {!needed && (
        <p class="note warn">No key exists: the service serves this machine only, and everybody on it may do everything. <strong>From the first key on every call needs one, for good.</strong> The first one has the right <code>admin</code>, and this page signs in with it.</p>
      )}
      {created && <Secret created={created} onClose={() => setCreated(undefined)} onRevoked={again} />}
      <NewKey isFirst={!needed} onCreated={made} />
      {live.problem && <ProblemBox problem={live.problem} what={list.length ? "The list is not up to date" : "The keys cannot be loaded"} />}
      {!live.value && list.length === 0 && !live.problem && <Loading what="the keys" />}
      {list.length > 0 && (
        <section aria-label="All keys">
          <h2>Keys <span class="count">{count(inForce.length)}</span></h2>
          <ul class="key-list">
            {(showEnded ? list : inForce).map((key) => (
              <KeyRow key={key.key} of={key} isOwn={key.key === own} isLastAdmin={key.rights.includes("admin") && inForce.filter(({ rights }) => rights.includes("admin")).length === 1} onChanged={again} onReplaced={(result) => made(result, key)} />
            ))}
          </ul>
          {ended > 0 && <p><button type="button" class="quiet" aria-pressed={showEnded} onClick={() => setShowEnded(!showEnded)}>{showEnded ? "Hide" : "Show"} {count(ended)} revoked or expired</button></p>}
        </section>
      )}
      <Quotas />
    </div>
  );
}

/** The secret of a new key, which is shown once. */
function Secret({ created: { key, secret, replaces }, onClose, onRevoked }: { created: Created & { replaces?: Key }; onClose: () => void; onRevoked: () => void }) {
  const box = useRef<HTMLElement>(null);
  useEffect(() => box.current?.focus(), [key.key]);
  return (
    <section class="card secret" ref={box} tabIndex={-1} aria-label="The secret of the new key">
      <h2>The secret of {key.label ? `“${key.label}”` : "the new key"}</h2>
      <p><strong>It is shown only now.</strong> The service keeps a hash of it, and nobody can read it again. Clients send it as <code>authorization: Bearer …</code>, programs of Graphfix take it from <code>GRAPHFIX_KEY</code>.</p>
      <Copyable label="Secret" text={secret} />
      {replaces && (
        <div class="replaces">
          <p>It replaces {replaces.label ? `“${replaces.label}”` : <code>{replaces.key}</code>}, which stays in force until you revoke it: first give the new one to its clients.</p>
          <Revoke of={replaces} isOwn={false} isLastAdmin={false} onRevoked={onRevoked} words="Revoke the old one" />
        </div>
      )}
      <p><button type="button" class="quiet" onClick={onClose}>I have stored it</button></p>
    </section>
  );
}

function NewKey({ isFirst, onCreated }: { isFirst: boolean; onCreated: (created: Created) => Promise<void> }) {
  const standard: Right[] = isFirst ? ["read", "operate", "admin"] : ["device"];
  const [label, setLabel] = useState("");
  const [rights, setRights] = useState<Right[]>(standard);
  const [days, setDays] = useState(0);
  const [problem, setProblem] = useState<Problem>();
  const [busy, setBusy] = useState(false);
  useEffect(() => setRights(standard), [isFirst]);
  const submit = async (event: Event) => {
    event.preventDefault();
    if (busy || rights.length === 0) return;
    setBusy(true);
    setProblem(undefined);
    try {
      const lifetimeS = days === 0 ? undefined : days * DAY_S;
      await onCreated(await change<Created>("POST", "/v1/keys", { label: label.trim(), rights, lifetimeS }));
      setLabel("");
      setRights(["device"]);
      setDays(0);
    } catch (error) {
      setProblem(problemOf(error));
    }
    setBusy(false);
  };
  const toggle = (right: Right) => setRights(rights.includes(right) ? rights.filter((other) => other !== right) : [...rights, right]);
  return (
    <form class="card new-key" onSubmit={submit} aria-label="New key">
      <h2>New key</h2>
      <label class="field"><span>Label</span>
        <input name="label" value={label} maxLength={200} autocomplete="off" placeholder="who uses it" onInput={({ currentTarget }) => setLabel(currentTarget.value)} />
      </label>
      <fieldset class="field">
        <legend>Rights</legend>
        {RIGHTS.map(({ right, meaning }) => (
          <label key={right} class="check"><input type="checkbox" checked={rights.includes(right)} disabled={isFirst && right === "admin"} onChange={() => toggle(right)} /> <b>{right}</b> <span class="small">{meaning}</span></label>
        ))}
      </fieldset>
      <label class="field"><span>In force</span>
        <select value={String(days)} onChange={({ currentTarget }) => setDays(Number(currentTarget.value))}>
          {LIFETIMES.map(({ days, name }) => <option key={days} value={String(days)}>{name}</option>)}
        </select>
      </label>
      {problem && <ProblemBox problem={problem} what="No key was made" />}
      <p class="submit">
        <button type="submit" class="primary" aria-disabled={busy || rights.length === 0}>{isFirst ? "Create the first key" : "Create the key"}</button>
        {rights.length === 0 && <span class="small">Choose at least one right.</span>}
      </p>
    </form>
  );
}

interface KeyRowProps {
  of: Key;
  isOwn: boolean;
  isLastAdmin: boolean;
  onChanged: () => void;
  onReplaced: (created: Created) => Promise<void>;
}

function KeyRow({ of: key, isOwn, isLastAdmin, onChanged, onReplaced }: KeyRowProps) {
  const [problem, setProblem] = useState<Problem>();
  const [busy, setBusy] = useState(false);
  const replace = async () => {
    if (busy) return;
    setBusy(true);
    try {
      const spanS = key.expiresUtc ? Math.max(DAY_S, Math.round((Date.parse(key.expiresUtc) - Date.parse(key.createdUtc)) / 1000)) : undefined;
      await onReplaced(await change<Created>("POST", "/v1/keys", { label: key.label, rights: key.rights, lifetimeS: spanS }));
    } catch (error) {
      setProblem(problemOf(error));
    }
    setBusy(false);
  };
  const name = key.label || key.key.slice(0, 12);
  return (
    <li class="card key-row">
      <div class="key-what">
        <span class="key-name">{key.label || "Without a label"}{isOwn && <span class="tag">yours</span>}</span>
        <code class="small break">{key.key}</code>
      </div>
      <div>{key.rights.map((right) => <span key={right} class="tag">{right}</span>)}</div>
      <dl class="key-times">
        <div><dt>Tenant</dt><dd>{key.tenant}</dd></div>
        <div><dt>Created</dt><dd title={key.createdUtc}>{agoOf(key.createdUtc)}</dd></div>
        <div><dt>Last use</dt><dd title={key.lastUsedUtc ?? undefined}>{key.lastUsedUtc ? agoOf(key.lastUsedUtc) : "never"}</dd></div>
        <div><dt>State</dt><dd><KeyLamp of={key} /></dd></div>
      </dl>
      {isInForce(key) && (
        <div class="key-acts">
          <button type="button" class="quiet" aria-disabled={busy} onClick={replace} aria-label={`Rotate ${name}`} title="Make a new key with the same rights; then revoke this one">Rotate</button>
          <Revoke of={key} isOwn={isOwn} isLastAdmin={isLastAdmin} onRevoked={onChanged} />
        </div>
      )}
      {problem && <ProblemBox problem={problem} what="No new key was made" />}
    </li>
  );
}

function KeyLamp({ of: { revokedUtc, expiresUtc } }: { of: Key }) {
  if (revokedUtc) return <span title={revokedUtc}><Lamp health="bad" words={`revoked ${agoOf(revokedUtc)}`} /></span>;
  if (!expiresUtc) return <Lamp health="good" words="does not expire" />;
  const leftS = (Date.parse(expiresUtc) - Date.now()) / 1000;
  const words = leftS <= 0 ? `expired ${ago(-leftS)}` : `expires in ${duration(leftS)}`;
  return <span title={expiresUtc}><Lamp health={leftS <= 0 ? "bad" : leftS < 7 * DAY_S ? "warn" : "good"} words={words} /></span>;
}

interface RevokeProps {
  of: Key;
  isOwn: boolean;
  isLastAdmin: boolean;
  onRevoked: () => void;
  words?: string;
}

/** Revokes after a second click, because nothing brings a key back. */
function Revoke({ of: key, isOwn, isLastAdmin, onRevoked, words = "Revoke" }: RevokeProps) {
  const revoke = async () => {
    await change<Key>("DELETE", `/v1/keys/${encodeURIComponent(key.key)}`);
    onRevoked();
  };
  return (
    <Confirm words={words} name={key.label || key.key.slice(0, 12)} yes="Revoke it" no="Keep it" failed="The key was not revoked" done="Revoked." act={revoke}>
      Its clients are refused at once, for good.{isOwn && " It is yours: you are signed out."}
      {isLastAdmin && " It is the last one with admin: from then on only the command line makes keys."}
    </Confirm>
  );
}
