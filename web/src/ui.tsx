/** Parts that several pages use. */
import type { ComponentChildren } from "preact";
import { useEffect, useRef, useState } from "preact/hooks";
import { type Problem, type Reason, type Refusal, problemOf } from "./api";
import { LOOKS, SHAPES, type State, colourOf, isDark } from "./status";

/** Draws again when the theme changes, for colours that scripts set. */
export function useTheme(): boolean {
  const [, redraw] = useState(0);
  useEffect(() => {
    const changed = () => redraw((n) => n + 1);
    const scheme = matchMedia("(prefers-color-scheme: dark)");
    scheme.addEventListener("change", changed);
    document.addEventListener("graphfix:theme", changed);
    return () => {
      scheme.removeEventListener("change", changed);
      document.removeEventListener("graphfix:theme", changed);
    };
  }, []);
  return isDark();
}

/** The symbol of a state, as on maps. */
export function Symbol({ state, size = 14 }: { state: State; size?: number }) {
  return (
    <svg class="symbol" width={size} height={size} viewBox="-1.1 -1.1 2.2 2.2" aria-hidden="true">
      <path d={SHAPES[LOOKS[state].shape]} fill={colourOf(state)} fill-rule="evenodd" />
    </svg>
  );
}

export function Badge({ state, large = false }: { state: State; large?: boolean }) {
  return (
    <span class={`badge ${large ? "badge-large" : ""}`} title={LOOKS[state].meaning}>
      <Symbol state={state} size={large ? 18 : 13} />
      {LOOKS[state].name}
    </span>
  );
}

/** A failed call: what is wrong, its code, and what to do. */
export function ProblemBox({ problem, what }: { problem: Problem; what: string }) {
  return (
    <section class="problem" role="alert">
      <strong>{what}</strong>
      <p>{problem.detail}</p>
      <p class="remedy">{sentence(problem.remedy)}</p>
      <p class="small">
        <code>{problem.code}</code>
        {problem.field && <> · field <code>{problem.field}</code></>}
        {problem.requestId && <> · request <code>{problem.requestId}</code></>}
      </p>
    </section>
  );
}

/** A refusal or reason in a row. */
export function Because({ refusal, tone = "warn" }: { refusal: Refusal | Reason; tone?: string }) {
  return (
    <div class={`because ${tone}`}>
      <code>{refusal.code}</code>
      <span>{values(refusal.message)}</span>
      <span class="remedy">{sentence(refusal.remedy)}</span>
    </div>
  );
}

/** The values of a reason's message, without its code, which stands beside. */
const values = (message: string): string =>
  message.replace(/^[A-Z_]+/, "").replace(/^\{(.*)\}$/, "$1").replace(/^\[(.*)\]$/, "$1");

/** The title of the page in the browser's tab. */
export function useTitle(name: string): void {
  useEffect(() => {
    document.title = `${name} · Graphfix`;
  }, [name]);
}

export function sentence(words: string): string {
  const first = words.charAt(0).toUpperCase() + words.slice(1);
  return /[.!?]$/.test(first) ? first : `${first}.`;
}

export function Empty({ title, children }: { title: string; children: ComponentChildren }) {
  return (
    <section class="empty">
      <svg width="56" height="56" viewBox="0 0 32 32" aria-hidden="true">
        <path d="M6 22 13 11l6 8 7-11" fill="none" stroke="currentColor" stroke-width="1.6" stroke-dasharray="2 2" />
        <g fill="currentColor"><circle cx="6" cy="22" r="2" /><circle cx="13" cy="11" r="2" /><circle cx="19" cy="19" r="2" /><circle cx="26" cy="8" r="2.6" /></g>
      </svg>
      <h2>{title}</h2>
      {children}
    </section>
  );
}

/** A block of a command or example with a button that copies it. */
export function Copyable({ text, label }: { text: string; label: string }) {
  const [words, setWords] = useState("Copy");
  const block = useRef<HTMLPreElement>(null);
  const copy = async () => {
    try {
      await navigator.clipboard.writeText(text);
      setWords("Copied");
    } catch {
      // Browsers copy only on pages with TLS or of this machine.
      if (block.current) getSelection()?.selectAllChildren(block.current);
      setWords("Selected: press Ctrl+C");
    }
    window.setTimeout(() => setWords("Copy"), 2500);
  };
  return (
    <div class="copyable">
      <pre ref={block} tabIndex={0} aria-label={label}>{text}</pre>
      <button type="button" class="quiet" onClick={copy} aria-label={words === "Copy" ? `Copy: ${label}` : words}>
        {words}
      </button>
    </div>
  );
}

interface ConfirmProps {
  /** The text of the button. */
  words: string;
  /** The name of what the act changes. */
  name: string;
  /** The texts of the two buttons for the second click. */
  yes: string;
  no: string;
  /** What failed; shown above the reason. */
  failed: string;
  /** The text in place of the button after the act. */
  done?: string;
  act: () => Promise<unknown>;
  /** What the user loses by the act. */
  children: ComponentChildren;
}

/**
 * A button for an act that cannot be undone. It asks for a second click, and says what the user
 * loses.
 */
export function Confirm({ words, name, yes, no, failed, done, act, children }: ConfirmProps) {
  const [state, setState] = useState<"idle" | "asked" | "busy" | "done">("idle");
  const [problem, setProblem] = useState<Problem>();
  const sure = useRef<HTMLButtonElement>(null);
  useEffect(() => {
    if (state === "asked") sure.current?.focus();
  }, [state]);
  const confirmed = async () => {
    setState("busy");
    setProblem(undefined);
    try {
      await act();
      setState("done");
    } catch (error) {
      setProblem(problemOf(error));
      setState("idle");
    }
  };
  if (state === "done") return <span class="small" role="status">{done}</span>;
  return (
    <div class="confirm">
      {state !== "asked" && <button type="button" class="quiet" aria-disabled={state === "busy"} onClick={() => state === "idle" && setState("asked")} aria-label={`${words}: ${name}`}>{words}</button>}
      {state === "asked" && (
        <div class="sure" role="group" aria-label={`${words}: ${name}?`}>
          <span class="small">{children}</span>
          <button type="button" class="danger" ref={sure} onClick={confirmed}>{yes}</button>
          <button type="button" class="quiet" onClick={() => setState("idle")}>{no}</button>
        </div>
      )}
      {problem && <ProblemBox problem={problem} what={failed} />}
    </div>
  );
}

export function Loading({ what }: { what: string }) {
  return <p class="loading" role="status">Loading {what} …</p>;
}

export function Figure({ name, value, hint, tone }: { name: string; value: ComponentChildren; hint?: string; tone?: string }) {
  return (
    <div class={`figure ${tone ?? ""}`} title={hint}>
      <dt>{name}</dt>
      <dd>{value}</dd>
    </div>
  );
}

/** A choice of one among few. */
export function Segments<T extends string>(props: {
  label: string;
  value: T;
  options: { value: T; name: string }[];
  onChange: (value: T) => void;
}) {
  return (
    <div class="segments" role="group" aria-label={props.label}>
      {props.options.map(({ value, name }) => (
        <button key={value} type="button" aria-pressed={value === props.value} onClick={() => props.onChange(value)}>
          {name}
        </button>
      ))}
    </div>
  );
}

/** A part of a whole, as a bar. */
export function Share({ name, part, colour, hint }: { name: ComponentChildren; part: number; colour?: string; hint?: string }) {
  const percent = part === 0 ? "0 %" : part < 0.01 ? "< 1 %" : 0.995 <= part && part < 1 ? "> 99 %" : `${Math.round(part * 100)} %`;
  return (
    <li title={hint}>
      <span class="share-name">{name}</span>
      <span class="share-part">{percent}</span>
      <svg class="share-bar" viewBox="0 0 100 4" preserveAspectRatio="none" aria-hidden="true">
        <rect width="100" height="4" class="bar-back" />
        <rect width={Math.max(0.6, part * 100)} height="4" fill={colour ?? "currentColor"} />
      </svg>
    </li>
  );
}

export type Health = "good" | "warn" | "bad" | "idle" | "busy";

const HEALTH: Record<Health, { words: string; path: string }> = {
  good: { words: "Good", path: "M3 8.5 6.5 12 13 4.5" },
  warn: { words: "Attention", path: "M8 3v6M8 12v.6" },
  bad: { words: "Failing", path: "M4 4l8 8M12 4l-8 8" },
  idle: { words: "Idle", path: "M4 8h8" },
  busy: { words: "Busy", path: "M8 2.5A5.5 5.5 0 1 1 3 5.6" },
};

/** A state by colour, shape and words. */
export function Lamp({ health, words }: { health: Health; words?: string }) {
  return (
    <span class={`health ${health}`}>
      <svg width="14" height="14" viewBox="0 0 16 16" aria-hidden="true"><path d={HEALTH[health].path} fill="none" stroke="currentColor" stroke-width="2.4" stroke-linecap="round" /></svg>
      {words ?? HEALTH[health].words}
    </span>
  );
}
