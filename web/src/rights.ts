/** Who uses the page, and what they may do. */
import { createContext } from "preact";
import { useContext } from "preact/hooks";
import type { SignInState } from "./api";

export type Right = "device" | "read" | "operate" | "admin";

/** The rights of keys, and what each is for. */
export const RIGHTS: { right: Right; meaning: string }[] = [
  { right: "device", meaning: "a receiver: sends observations, lists nothing" },
  { right: "read", meaning: "a dashboard: reads everything but keys" },
  { right: "operate", meaning: "changes sessions, bases, navigation data and jobs" },
  { right: "admin", meaning: "creates and revokes keys" },
];

export const SignedIn = createContext<SignInState>({ needed: false, rights: [] });

/** Whether the user has a right. Without keys everybody on this machine has all rights. */
export function useRight(right: Right): boolean {
  const { needed, rights } = useContext(SignedIn);
  return !needed || rights.includes(right);
}
