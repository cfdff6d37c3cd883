/** A new job: files by drag and drop or chosen, their roles, options, and the upload. */
import { useEffect, useRef, useState } from "preact/hooks";
import { Problem, navigation, problemOf } from "../api";
import { bytes, duration } from "../time";
import { ProblemBox } from "../ui";
import { type Job, type Part, type Sending, requestName, send } from "./api";
import { type Entry, type Look, type Role, look, withRoles } from "./look";
import { type Choices, MODES, NO_CHOICES, OptionsForm, optionsOf, settled } from "./options";

const ROLES: { role: Role; name: string }[] = [
  { role: "rover", name: "Rover" },
  { role: "rover+navigation", name: "Rover and navigation" },
  { role: "navigation", name: "Navigation" },
  { role: "base", name: "Base" },
  { role: "none", name: "Leave out" },
];
const UNREADABLE: Look = { kind: "unknown", words: "cannot be read", marker: "", from: "", hasEphemerides: false, isRtcm: false };

interface Progress {
  fraction: number;
  begun: number;
}

/** Choices that another page has left for the next new job. */
let draft: Choices | undefined;
export const setDraft = (choices: Choices): void => {
  draft = choices;
};

export function NewJob({ onCreated }: { onCreated: (job: Job) => void }) {
  const [entries, setEntries] = useState<Entry[]>([]);
  const [choices, setChoices] = useState<Choices>(() => draft ?? NO_CHOICES);
  const [problem, setProblem] = useState<Problem>();
  const [progress, setProgress] = useState<Progress>();
  const [said, setSaid] = useState("");
  const sending = useRef<Sending | undefined>(undefined);
  const name = useRef({ of: "", name: "" });
  const next = useRef(1);

  useEffect(() => {
    draft = undefined;
    return () => sending.current?.abort();
  }, []);

  const add = (files: File[]) => {
    if (files.length === 0) return;
    const added = files.map((file): Entry => ({ id: next.current++, file, role: "none", chosen: false }));
    setProblem(undefined);
    setSaid(`${files.length === 1 ? files[0].name : `${files.length} files`} added`);
    setEntries((before) => [...before, ...added]);
    for (const { id, file } of added) {
      void look(file).catch(() => UNREADABLE).then((found) => {
        setEntries((before) => withRoles(before.map((entry) => (entry.id === id ? { ...entry, look: found } : entry))));
      });
    }
  };
  const remove = (id: number) => setEntries((before) => withRoles(before.filter((entry) => entry.id !== id)));
  const setRole = (id: number, role: Role) => {
    const isOnly = role === "rover" || role === "rover+navigation" || role === "base";
    setEntries((before) => withRoles(before.map((entry) => {
      if (entry.id === id) return { ...entry, role, chosen: true };
      // The file that had this role gets another role.
      const same = role === "base" ? entry.role === "base" : entry.role.startsWith("rover");
      return isOnly && same ? { ...entry, chosen: false } : entry;
    })));
  };
  const isOver = useDrop(add, progress !== undefined);

  const parts = entries.flatMap(({ role, file }) =>
    role === "none" ? [] : (role.split("+") as Part[]).map((part) => ({ part, file })));
  const has = (part: Part) => parts.some((entry) => entry.part === part);
  const used = entries.filter(({ role }) => role !== "none");
  const files = {
    hasBase: has("base"),
    isPhone: used.some(({ role, look }) => role.startsWith("rover") && look?.kind === "phone"),
    isRtcm: used.some(({ look }) => look?.isRtcm),
  };
  const isLooking = entries.some(({ look }) => !look);
  const { mode } = settled(choices, files);
  const needsBase = (MODES.find((known) => known.mode === mode)?.relative ?? false) && !files.hasBase;
  const missing = !has("rover") ? "the rover's file is missing" : needsBase ? `mode ${mode} needs the file of a base` : undefined;

  const submit = async (event: Event) => {
    event.preventDefault();
    if (missing || isLooking || progress) return;
    setProblem(undefined);
    try {
      const options = optionsOf(choices, settled(choices, files));
      // The same request keeps its id, so that repeating a broken upload makes no second job.
      const of = JSON.stringify([options, parts.map(({ part, file }) => [part, file.name, file.size, file.lastModified])]);
      if (name.current.of !== of) name.current = { of, name: requestName() };
      const begun = performance.now();
      setProgress({ fraction: 0, begun });
      sending.current = send(parts, options, name.current.name, (fraction) => setProgress({ fraction, begun }));
      const job = await sending.current.done;
      onCreated(job);
    } catch (error) {
      const found = problemOf(error);
      if (found.code !== "UPLOAD_CANCELLED") setProblem(found);
      setProgress(undefined);
    }
    sending.current = undefined;
  };

  const total = parts.reduce((sum, { file }) => sum + file.size, 0);
  return (
    <form class={`card new-job ${isOver ? "over" : ""}`} onSubmit={submit} aria-label="New job">
      <DropZone add={add} isEmpty={entries.length === 0} disabled={progress !== undefined} />
      <p class="visually-hidden" role="status">{said}</p>
      {entries.length > 0 && (
        <>
          <ul class="job-files" aria-label="Files">
            {entries.map((entry) => (
              <FileRow key={entry.id} entry={entry} disabled={progress !== undefined} problem={problem} onRole={(role) => setRole(entry.id, role)} onRemove={() => remove(entry.id)} />
            ))}
          </ul>
          {has("rover") && !has("navigation") && <OwnNavigation />}
          <OptionsForm choices={choices} files={files} onChange={(choices) => { setChoices(choices); setProblem(undefined); }} />
        </>
      )}
      {problem && <ProblemBox problem={problem} what="No job was made" />}
      {entries.length > 0 && (progress
        ? <UploadProgress progress={progress} total={total} onCancel={() => sending.current?.abort()} />
        : (
          <p class="submit">
            <button type="submit" class="primary" aria-disabled={Boolean(missing) || isLooking} aria-describedby="job-missing">Start the job</button>
            <span id="job-missing" class="small">{missing ? `Not yet: ${missing}.` : isLooking ? "Looking at the files …" : `${bytes(total)} to upload.`}</span>
          </p>
        ))}
    </form>
  );
}

/** Files that are dropped anywhere on the page. */
function useDrop(add: (files: File[]) => void, disabled: boolean): boolean {
  const [isOver, setOver] = useState(false);
  const latest = useRef({ add, disabled });
  latest.current = { add, disabled };
  useEffect(() => {
    const brings = (event: DragEvent) => event.dataTransfer?.types.includes("Files") ?? false;
    const over = (event: DragEvent) => {
      if (!brings(event)) return;
      event.preventDefault();
      if (event.dataTransfer) event.dataTransfer.dropEffect = latest.current.disabled ? "none" : "copy";
      setOver(!latest.current.disabled);
    };
    const leave = (event: DragEvent) => {
      if (!event.relatedTarget) setOver(false);
    };
    const drop = (event: DragEvent) => {
      if (!brings(event)) return;
      event.preventDefault(); // Otherwise the browser opens the file.
      setOver(false);
      if (!latest.current.disabled) latest.current.add([...(event.dataTransfer?.files ?? [])]);
    };
    const events = { dragover: over, dragleave: leave, drop };
    Object.entries(events).forEach(([name, act]) => window.addEventListener(name, act as EventListener));
    return () => Object.entries(events).forEach(([name, act]) => window.removeEventListener(name, act as EventListener));
  }, []);
  return isOver;
}

function DropZone({ add, isEmpty, disabled }: { add: (files: File[]) => void; isEmpty: boolean; disabled: boolean }) {
  const input = useRef<HTMLInputElement>(null);
  return (
    <div class={`drop ${isEmpty ? "drop-empty" : ""}`}>
      <svg width="34" height="34" viewBox="0 0 24 24" aria-hidden="true"><path d="M12 15V4M7.5 8 12 3.5 16.5 8M4 15v4.5h16V15" fill="none" stroke="currentColor" stroke-width="1.7" stroke-linecap="round" stroke-linejoin="round" /></svg>
      <div>
        <p><strong>{isEmpty ? "Drop the files of a recording here" : "Drop more files"}</strong> or{" "}
          <button type="button" class="quiet" disabled={disabled} onClick={() => input.current?.click()}>choose files</button>
        </p>
        {isEmpty && <p class="small">The rover's observations; navigation data, unless the service has it; for centimetres the observations of a base. RINEX, CRINEX, UBX, RTCM 3 or an Android GnssLogger log, plain or gzip: what each is, is told by its content.</p>}
      </div>
      <input ref={input} class="visually-hidden" type="file" multiple tabIndex={-1} aria-label="Files of the recording" onChange={({ currentTarget }) => { add([...(currentTarget.files ?? [])]); currentTarget.value = ""; }} />
    </div>
  );
}

interface FileRowProps {
  entry: Entry;
  disabled: boolean;
  problem: Problem | undefined;
  onRole: (role: Role) => void;
  onRemove: () => void;
}

function FileRow({ entry: { file, look, role }, disabled, problem, onRole, onRemove }: FileRowProps) {
  const atFault = problem?.field !== "" && role.split("+").includes(problem?.field ?? "-");
  return (
    <li class={`${role === "none" ? "left-out" : ""} ${atFault ? "at-fault" : ""}`}>
      <span class="file-name">{file.name}</span>
      <span class="file-look small">
        {look ? look.words : "Looking at it …"}{look?.marker && ` · ${look.marker}`}{look?.from && ` · from ${look.from}`} · {bytes(file.size)}
      </span>
      <label class="file-role"><span class="visually-hidden">Role of {file.name}</span>
        <select value={role} disabled={disabled} onChange={({ currentTarget }) => onRole(currentTarget.value as Role)}>
          {ROLES.map((known) => <option key={known.role} value={known.role}>{known.name}</option>)}
        </select>
      </label>
      <button type="button" class="quiet icon-only" disabled={disabled} onClick={onRemove} aria-label={`Remove ${file.name}`} title="Remove">
        <svg width="14" height="14" viewBox="0 0 16 16" aria-hidden="true"><path d="M4 4l8 8M12 4l-8 8" fill="none" stroke="currentColor" stroke-width="2" stroke-linecap="round" /></svg>
      </button>
    </li>
  );
}

/** States what ephemerides the service has, if no file of navigation data is given. */
function OwnNavigation() {
  const [ephemerides, setEphemerides] = useState<number>();
  useEffect(() => {
    const stop = new AbortController();
    // If this call fails, the service reports missing data after the upload.
    navigation(stop.signal).then((status) => setEphemerides(status.ephemerides), () => undefined);
    return () => stop.abort();
  }, []);
  if (ephemerides === 0) {
    return <p class="note warn" role="status">No navigation file is among these, and the service has no ephemerides now: add one of the same day, unless an archive of the service has it.</p>;
  }
  return <p class="note">No navigation file is among these: the service takes ephemerides of its own, or of its archives, for that day.</p>;
}

function UploadProgress({ progress: { fraction, begun }, total, onCancel }: { progress: Progress; total: number; onCancel: () => void }) {
  const elapsedS = (performance.now() - begun) / 1000;
  const percent = Math.floor(fraction * 100);
  const left = 0.02 < fraction && 1 < elapsedS ? (elapsedS * (1 - fraction)) / fraction : undefined;
  const words = fraction < 1
    ? `${bytes(fraction * total)} of ${bytes(total)}${left === undefined ? "" : `, ${duration(left)} left`}`
    : "All bytes are sent; the service checks the request …";
  return (
    <div class="uploading">
      <Bar percent={percent} label="Upload" />
      <span class="small">{words}</span>
      <button type="button" class="quiet" onClick={onCancel}>Cancel the upload</button>
    </div>
  );
}

/** A bar of progress. */
export function Bar({ percent, label }: { percent: number; label: string }) {
  return (
    <div class="bar" role="progressbar" aria-label={label} aria-valuemin={0} aria-valuemax={100} aria-valuenow={Math.round(percent)}>
      <svg width="100%" height="8" aria-hidden="true"><rect class="bar-back" width="100%" height="8" rx="4" /><rect class="bar-done" width={`${Math.max(0, Math.min(100, percent))}%`} height="8" rx="4" /></svg>
    </div>
  );
}
