/** The frame of the dashboard: navigation, theme, the state of the service, and the pages. */
import { render } from "preact";
import { useEffect, useState } from "preact/hooks";
import { type Readiness, SIGNED_OUT, type SignInState, readiness, signInState, signOut } from "./api";
import { type Live, useLive } from "./live";
import { ApiPage } from "./pages/api";
import { BasesPage } from "./pages/bases";
import { EphemeridesPage } from "./pages/ephemerides";
import { FleetPage } from "./pages/fleet";
import { HistoryPage } from "./pages/history";
import { JobPage } from "./pages/job";
import { JobsPage } from "./pages/jobs";
import { KeysPage } from "./pages/keys";
import { SessionPage } from "./pages/session";
import { SessionHistoryPage } from "./pages/session-history";
import { SignInPage } from "./pages/sign-in";
import { type Right, SignedIn } from "./rights";

const PAGES = [
  { path: "fleet", name: "Fleet", icon: "M4 18 10 9l5 6 5-9M4 18h.01M10 9h.01M15 15h.01M20 6h.01" },
  { path: "history", name: "History", icon: "M4 19.5h16M6.5 16v-4M11 16V8M15.5 16v-6M20 16V5" },
  { path: "jobs", name: "Jobs", icon: "M4 13v6.5h16V13M12 3.5V14M7.8 10 12 14.2 16.2 10" },
  { path: "bases", name: "Bases", icon: "M12 10v11M8 21h8M8.5 6.5a5 5 0 0 0 0 7M15.5 6.5a5 5 0 0 1 0 7M5.6 3.6a9 9 0 0 0 0 12.8M18.4 3.6a9 9 0 0 1 0 12.8" },
  { path: "ephemerides", name: "Ephemerides", icon: "M12 12m-3 0a3 3 0 1 0 6 0a3 3 0 1 0 -6 0M4 16c-2-4 2-10 8-12M20 8c2 4-2 10-8 12M20 8h.01M4 16h.01" },
  { path: "keys", name: "Keys", title: "Keys and quotas", icon: "M8 15m-4 0a4 4 0 1 0 8 0a4 4 0 1 0 -8 0M11 12l9-8.5M16.5 7l3 3M14 9.3l1.8 1.8" },
  { path: "api", name: "API", icon: "M8 7l-5 5 5 5M16 7l5 5-5 5M13.5 4l-3 16" },
];

/** Path for an address that cannot be decoded. No page has it. */
const NO_PAGE = [""];

/** The parts of the address after #. */
function partsOfAddress(): string[] {
  try {
    return decodeURIComponent(location.hash.replace(/^#\/?/, "")).split("/").filter(Boolean);
  } catch {
    return NO_PAGE; // URIError: a % that begins no character.
  }
}

/** The route is the part of the address after #. */
function useRoute(): string[] {
  const [route, setRoute] = useState(partsOfAddress);
  useEffect(() => {
    const changed = () => setRoute(partsOfAddress());
    window.addEventListener("hashchange", changed);
    return () => window.removeEventListener("hashchange", changed);
  }, []);
  return route.length ? route : ["fleet"];
}

type Theme = "system" | "light" | "dark";

function storedTheme(): Theme {
  const set = document.documentElement.dataset.theme;
  return set === "light" || set === "dark" ? set : "system";
}

function ThemeSwitch() {
  const [theme, setTheme] = useState<Theme>(storedTheme);
  const next: Record<Theme, Theme> = { system: "light", light: "dark", dark: "system" };
  const names: Record<Theme, string> = { system: "as the system", light: "light", dark: "dark" };
  const icons: Record<Theme, string> = {
    system: "M12 3a9 9 0 1 0 0 18zM12 3a9 9 0 0 1 0 18",
    light: "M12 8a4 4 0 1 0 0 8a4 4 0 0 0 0-8M12 2v2M12 20v2M2 12h2M20 12h2M5 5l1.4 1.4M17.6 17.6 19 19M19 5l-1.4 1.4M6.4 17.6 5 19",
    dark: "M20 14.5A8.5 8.5 0 0 1 9.5 4 8.5 8.5 0 1 0 20 14.5z",
  };
  const change = () => {
    const chosen = next[theme];
    if (chosen === "system") delete document.documentElement.dataset.theme;
    else document.documentElement.dataset.theme = chosen;
    try {
      localStorage.setItem("graphfix.theme", chosen);
    } catch {
      // Without storage the choice lasts as long as the page.
    }
    setTheme(chosen);
    document.dispatchEvent(new Event("graphfix:theme"));
  };
  return (
    <button type="button" class="quiet theme" onClick={change} aria-label={`Theme: ${names[theme]}. Change`} title={`Theme: ${names[theme]}`}>
      <Icon path={icons[theme]} fill={theme === "system"} />
      <span class="wide-only">{theme === "system" ? "System" : theme === "light" ? "Light" : "Dark"}</span>
    </button>
  );
}

function Icon({ path, fill = false }: { path: string; fill?: boolean }) {
  return (
    <svg class="icon" width="20" height="20" viewBox="0 0 24 24" aria-hidden="true">
      <path d={path} fill={fill ? "currentColor" : "none"} fill-opacity={fill ? 0.35 : undefined} stroke="currentColor" stroke-width="1.8" stroke-linecap="round" stroke-linejoin="round" />
    </svg>
  );
}

/** Whether the service can work; if not, why. */
function ServiceState({ service: { value, problem } }: { service: Live<Readiness> }) {
  if (problem) {
    return (
      <div class="banner bad" role="alert">
        <strong>The service does not answer.</strong> What you see is the last that arrived. {" "}
        <code>{problem.code}</code> The page tries again by itself; check that graphfix is running.
      </div>
    );
  }
  if (value && !value.ready) {
    return (
      <div class="banner bad" role="alert">
        <strong>{value.draining ? "The service is stopping." : "The service is not ready."}</strong> It takes no epochs now:
        {" "}{value.problems.join("; ")}. <a href="/readyz">Details</a>
      </div>
    );
  }
  return null;
}

function NodeName({ service: { value, problem } }: { service: Live<Readiness> }) {
  const ready = Boolean(value?.ready) && !problem;
  return (
    <p class="node" title={value?.node}>
      <span class={`lamp ${ready ? "good" : "bad"}`} aria-hidden="true" />
      {problem ? "No answer" : value ? (value.ready ? "Ready" : "Not ready") : "…"}
      {value && <span class="node-name">{value.node}</span>}
    </p>
  );
}

/**
 * The pages that the user may see. With the right read but not admin, the page of keys shows only
 * the quotas.
 */
function pagesOf(signedIn: SignInState | undefined): typeof PAGES {
  const has = (right: Right) => !signedIn?.needed || signedIn.rights.includes(right);
  if (has("admin")) return PAGES;
  const others = PAGES.filter(({ path }) => path !== "keys" || has("read"));
  return others.map((page) => (page.path === "keys" ? { ...page, name: "Quotas", title: "Quotas" } : page));
}

function Dashboard({ signedIn, onSignOut }: { signedIn?: SignInState; onSignOut: () => void }) {
  const [page, argument] = useRoute();
  const pages = pagesOf(signedIn);
  const service = useLive("readiness", readiness, 5000);
  const known = pages.find(({ path }) => path === page) ?? PAGES.find(({ path }) => path === page);
  const session = page === "sessions" && argument ? argument : undefined;
  const job = page === "jobs" && argument ? argument : undefined;
  useEffect(() => {
    // The pages of a session and a job name it themselves.
    if (!session && !job) document.title = `${known?.title ?? known?.name ?? "No such page"} · Graphfix`;
    document.getElementById("main")?.scrollTo(0, 0);
  }, [page, argument]);
  return (
    <div class="frame">
      <a class="skip" href="#main" onClick={(event) => { event.preventDefault(); document.getElementById("main")?.focus(); }}>Skip to content</a>
      <header class="side">
        <a class="brand" href="#/fleet">
          <svg width="30" height="30" viewBox="0 0 32 32" aria-hidden="true">
            <rect width="32" height="32" rx="7" fill="#0d2330" />
            <path d="M6 22 13 11l6 8 7-11" fill="none" stroke="#3fc1a0" stroke-width="2.4" stroke-linejoin="round" stroke-linecap="round" />
            <g fill="#e8f4f1"><circle cx="6" cy="22" r="2.6" /><circle cx="13" cy="11" r="2.6" /><circle cx="19" cy="19" r="2.6" /></g>
            <circle cx="26" cy="8" r="3.4" fill="#ffb547" />
          </svg>
          <span>Graphfix</span>
        </a>
        <nav aria-label="Pages">
          {pages.map(({ path, name, icon }) => (
            <a key={path} href={`#/${path}`} aria-current={path === page || (path === "fleet" && session) ? "page" : undefined}>
              <Icon path={icon} />
              <span>{name}</span>
            </a>
          ))}
        </nav>
        <div class="side-end">
          <NodeName service={service} />
          {signedIn?.key && (
            <button type="button" class="quiet" onClick={onSignOut} title={`Signed in with ${signedIn.key}, until ${signedIn.expiresUtc}`}>
              Sign out
            </button>
          )}
          <ThemeSwitch />
        </div>
      </header>
      <main id="main" tabIndex={0}>
        <ServiceState service={service} />
        {page === "fleet" && <FleetPage />}
        {session && <SessionPage key={session} id={session} />}
        {page === "history" && !argument && <HistoryPage />}
        {page === "history" && argument && <SessionHistoryPage key={argument} id={argument} />}
        {page === "jobs" && !job && <JobsPage />}
        {job && <JobPage key={job} id={job} />}
        {page === "bases" && <BasesPage />}
        {page === "ephemerides" && <EphemeridesPage />}
        {page === "keys" && <KeysPage />}
        {page === "api" && <ApiPage />}
        {!known && !session && (
          <div class="page"><h1>No such page</h1><p>Go to the <a href="#/fleet">fleet</a>.</p></div>
        )}
      </main>
    </div>
  );
}

/** The dashboard, or the page that asks for a key where calls need one. */
function Entrance() {
  const [state, setState] = useState<SignInState>();
  const [asked, setAsked] = useState(false);
  useEffect(() => {
    const look = async () => {
      try {
        setState(await signInState());
      } catch {
        // The dashboard shows that the service does not answer.
      }
      setAsked(true);
    };
    void look();
    document.addEventListener(SIGNED_OUT, look);
    return () => document.removeEventListener(SIGNED_OUT, look);
  }, []);
  const leave = async () => {
    try {
      setState(await signOut());
    } catch {
      document.dispatchEvent(new Event(SIGNED_OUT)); // The sign-in may have ended already.
    }
  };
  if (!asked) return <p class="boot">Graphfix</p>;
  if (state?.needed && !state.key) return <SignInPage onSignedIn={setState} />;
  return (
    <SignedIn.Provider value={state ?? { needed: false, rights: [] }}>
      <Dashboard signedIn={state} onSignOut={leave} />
    </SignedIn.Provider>
  );
}

const root = document.getElementById("app");
if (root) {
  root.textContent = "";
  render(<Entrance />, root);
}
