/** Parts that several pages use. */
import type { ComponentChildren } from "preact";
import { useEffect, useState } from "preact/hooks";
import type { Problem, Reason, Refusal } from "./api";
import { LOOKS, SHAPES, type State, colourOf } from "./status";

/** Draws again when the theme changes, for colours that scripts set. */
export function useTheme(): void {
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
  const [copied, setCopied] = useState(false);
  const copy = async () => {
    try {
      await navigator.clipboard.writeText(text);
      setCopied(true);
      window.setTimeout(() => setCopied(false), 1600);
    } catch {
      setCopied(false); // Without the right to copy, the text can be selected.
    }
  };
  return (
    <div class="copyable">
      <pre tabIndex={0} aria-label={label}>{text}</pre>
      <button type="button" class="quiet" onClick={copy} aria-label={`Copy: ${label}`}>
        {copied ? "Copied" : "Copy"}
      </button>
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
