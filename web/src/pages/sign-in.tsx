/** Asks for a key, and exchanges it for a cookie. The page never keeps the key. */
import { useEffect, useRef, useState } from "preact/hooks";
import { type Problem, type SignInState, problemOf, signIn } from "../api";
import { ProblemBox } from "../ui";

export function SignInPage({ onSignedIn }: { onSignedIn: (state: SignInState) => void }) {
  const field = useRef<HTMLInputElement>(null);
  const [problem, setProblem] = useState<Problem>();
  const [busy, setBusy] = useState(false);
  useEffect(() => {
    document.title = "Sign in · Graphfix";
    field.current?.focus();
  }, []);
  const submit = async (event: Event) => {
    event.preventDefault();
    const input = field.current;
    const key = input?.value.trim();
    if (!input || !key || busy) return;
    input.value = "";
    setBusy(true);
    try {
      onSignedIn(await signIn(key));
    } catch (error) {
      setProblem(problemOf(error));
      input.focus();
    }
    setBusy(false);
  };
  return (
    <main class="sign-in">
      <form class="card" onSubmit={submit}>
        <h1>Sign in to Graphfix</h1>
        <label for="key">Key</label>
        <input ref={field} id="key" type="password" autocomplete="off" spellcheck={false} required aria-describedby="key-hint" />
        <button type="submit" class="primary" aria-disabled={busy}>{busy ? "Signing in …" : "Sign in"}</button>
        {problem && <ProblemBox problem={problem} what="The key was refused." />}
        <p id="key-hint" class="small">
          A key with the right <code>read</code>; the operator creates one by <code>graphfix keys create --right read</code>.
          This page exchanges it for a cookie that lasts twelve hours, and does not keep it.
        </p>
      </form>
    </main>
  );
}
