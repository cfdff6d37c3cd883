/** Quotas of tenants beside what they use. The operator changes them. */
import { useState } from "preact/hooks";
import { type Problem, all, change, problemOf } from "./api";
import { useLive } from "./live";
import { useRight } from "./rights";
import { bytes, count } from "./time";
import { Lamp, Loading, ProblemBox, Share } from "./ui";

type Name = "sessions" | "epochsPerS" | "cpuSPerMinute" | "storedBytes" | "jobBytes";
interface Tenant {
  tenant: string;
  createdUtc: string;
  /** Null: no limit. */
  quotas: Record<Name, number | null>;
  /** Null: it cannot be counted at present. */
  used: Record<Name, number> | null;
  etag: string;
}

interface Kind {
  name: Name;
  words: string;
  /** The unit in the form. */
  unit: string;
  text: (value: number) => string;
  /** The value of the quota for 1 in the form. */
  factor: number;
  isWhole: boolean;
}

const perTime = (value: number): string => count(+value.toPrecision(3));
const KINDS: Kind[] = [
  { name: "sessions", words: "Sessions", unit: "stored, open and closed", text: count, factor: 1, isWhole: true },
  { name: "epochsPerS", words: "Epochs", unit: "a second", text: (n) => `${perTime(n)} /s`, factor: 1, isWhole: false },
  { name: "cpuSPerMinute", words: "Processor time", unit: "seconds a minute", text: (n) => `${perTime(n)} s/min`, factor: 1, isWhole: false },
  { name: "storedBytes", words: "Stored", unit: "GB of epochs and solutions", text: bytes, factor: 1e9, isWhole: true },
  { name: "jobBytes", words: "Files of jobs", unit: "GB of inputs and results", text: bytes, factor: 1e9, isWhole: true },
];
/** Fraction of a quota from which on it is nearly used up. */
const NEARLY = 0.9;
/** The operator's tenant: only the operator's keys see it. */
const OPERATOR = "default";

const tenants = (signal?: AbortSignal) => all<Tenant>("/v1/tenants", "tenants", 1000, signal);

export function Quotas({ title = "Quotas" }: { title?: string }) {
  const [changed, setChanged] = useState<Tenant>();
  const live = useLive("tenants", tenants, 5000);
  const mayAdmin = useRight("admin");
  const list = live.value?.map((tenant) => (isNewer(changed, tenant) ? changed : tenant));
  const mayChange = mayAdmin && Boolean(list?.some(({ tenant }) => tenant === OPERATOR));
  return (
    <section class="quotas" aria-label="Quotas">
      <h2>{title}</h2>
      <p class="small">What each tenant may use, and what it uses. {mayChange ? "A change is in force at once." : "The operator sets them."}</p>
      {live.problem && <ProblemBox problem={live.problem} what={list ? "The quotas are not up to date" : "The quotas cannot be loaded"} />}
      {!list && !live.problem && <Loading what="the quotas" />}
      {list && <div class="cards">{list.map((tenant) => <TenantCard key={tenant.tenant} of={tenant} mayChange={mayChange} onChanged={setChanged} />)}</div>}
    </section>
  );
}

/** Whether the answer to a change is newer than what was read. Etags are increasing numbers. */
const isNewer = (changed: Tenant | undefined, read: Tenant): changed is Tenant =>
  changed !== undefined && changed.tenant === read.tenant && Number(read.etag) < Number(changed.etag);

function TenantCard({ of: tenant, mayChange, onChanged }: { of: Tenant; mayChange: boolean; onChanged: (tenant: Tenant) => void }) {
  const [isOpen, setIsOpen] = useState(false);
  const most = Math.max(...KINDS.map(({ name }) => partOf(tenant, name) ?? 0));
  const changed = (answer: Tenant) => {
    onChanged(answer);
    setIsOpen(false);
  };
  return (
    <article class="card tenant">
      <div class="card-head">
        <h3 class="break">{tenant.tenant}{tenant.tenant === OPERATOR && <span class="tag">operator</span>}</h3>
        {NEARLY < most && <Lamp health={most < 1 ? "warn" : "bad"} words={most < 1 ? "nearly used up" : "used up"} />}
      </div>
      {isOpen
        ? <QuotaForm of={tenant} onChanged={changed} onClose={() => setIsOpen(false)} />
        : <ul class="shares">{KINDS.map((kind) => <QuotaRow key={kind.name} of={tenant} kind={kind} />)}</ul>}
      {mayChange && !isOpen && <p><button type="button" class="quiet" onClick={() => setIsOpen(true)} aria-label={`Change the quotas of ${tenant.tenant}`}>Change</button></p>}
    </article>
  );
}

/** The used fraction of a quota; undefined without a limit, and if the use is unknown. */
function partOf({ quotas, used }: Tenant, name: Name): number | undefined {
  const quota = quotas[name];
  if (quota === null || quota === undefined) return undefined;
  return quota === 0 ? 1 : used ? used[name] / quota : undefined;
}

function QuotaRow({ of: tenant, kind: { name, words, text } }: { of: Tenant; kind: Kind }) {
  const part = partOf(tenant, name);
  const quota = tenant.quotas[name];
  const limit = quota === null || quota === undefined ? "no limit" : `of ${text(quota)}`;
  const use = tenant.used ? text(tenant.used[name]) : "unknown";
  if (part === undefined) return <li><span class="share-name">{words} <span class="small">{use}, {limit}</span></span></li>;
  const colour = part <= NEARLY ? "var(--accent)" : part < 1 ? "var(--warn)" : "var(--bad)";
  return <Share name={<>{words} <span class="small">{use} of {text(tenant.quotas[name] ?? 0)}</span></>} part={part} colour={colour} />;
}

interface QuotaFormProps {
  of: Tenant;
  onChanged: (tenant: Tenant) => void;
  onClose: () => void;
}

/** The form of all quotas of a tenant: one request sets them together. */
function QuotaForm({ of: { tenant, quotas, etag }, onChanged, onClose }: QuotaFormProps) {
  const [texts, setTexts] = useState(() => Object.fromEntries(KINDS.map(({ name, factor }) => [name, quotas[name] === null ? "" : String(quotas[name] / factor)])) as Record<Name, string>);
  // The etag of what the form shows. Another user may have changed the quotas since.
  const [readAs] = useState(etag);
  const [problem, setProblem] = useState<Problem>();
  const [busy, setBusy] = useState(false);
  const submit = async (event: Event) => {
    event.preventDefault();
    if (busy) return;
    setBusy(true);
    setProblem(undefined);
    try {
      onChanged(await change<Tenant>("PUT", `/v1/tenants/${encodeURIComponent(tenant)}`, { quotas: quotasOf(texts), etag: readAs }));
      return;
    } catch (error) {
      setProblem(problemOf(error));
    }
    setBusy(false);
  };
  return (
    <form class="quota-form" onSubmit={submit} aria-label={`Quotas of ${tenant}`}>
      {KINDS.map(({ name, words, unit, factor, isWhole }) => (
        <label key={name} class="field"><span>{words}</span>
          <input
            name={name} type="number" min="0" step={isWhole && factor === 1 ? 1 : "any"} value={texts[name]} placeholder="no limit" autocomplete="off"
            onInput={({ currentTarget }) => setTexts((before) => ({ ...before, [name]: currentTarget.value }))}
          />
          <small>{unit}</small>
        </label>
      ))}
      <p class="small">An empty field is no limit.</p>
      {problem && <ProblemBox problem={problem} what="The quotas were not changed" />}
      <p class="submit">
        <button type="submit" class="primary" aria-disabled={busy}>Set the quotas</button>
        <button type="button" class="quiet" onClick={onClose}>Leave them</button>
      </p>
    </form>
  );
}

/** The quotas in the form. An empty field is left out of the request, which ends that quota. */
function quotasOf(texts: Record<Name, string>): Partial<Record<Name, number>> {
  const given = KINDS.filter(({ name }) => texts[name].trim() !== "");
  return Object.fromEntries(given.map(({ name, factor, isWhole }) => {
    const value = Number(texts[name]) * factor;
    return [name, isWhole ? Math.round(value) : value];
  }));
}
