import { type Language, preferredLanguage, t } from "./i18n.ts";
import type { Vec3 } from "./spatial.ts";

/** What the picture has beside the robot. */
export const PARTS = [
  "ghost",
  "tcp",
  "commanded",
  "trail",
  "force",
  "axes",
  "workspace",
  "obstacles",
  "visuals",
  "capsules",
] as const;
export type Part = (typeof PARTS)[number];

export type Theme = "auto" | "light" | "dark";
export type Named = { name: string; joints: number[] };

/** What this browser keeps. None of it moves anything. */
export type Settings = {
  language: Language;
  theme: Theme;
  arm: string;
  /** Who is at this browser, for others. */
  person: string;
  /** Speed override, %. */
  speed: number;
  stepMm: number;
  /** By the arm's name. */
  named: Record<string, Named[]>;
  phoneTopic: string;
  padTopic: string;
  xrTopic: string;
  imuTopic: string;
  camera: Vec3 | null;
  /** What of the picture is not shown. */
  hides: Part[];
};

/** Characters of a pose's name. */
export const LONGEST_NAME = 40;

/** Characters of a person's name, as the server takes it. */
export const LONGEST_PERSON = 30;

const KEY = "cardan-console";

const DEFAULTS: Settings = {
  language: "en",
  theme: "auto",
  arm: "",
  person: "",
  speed: 20,
  stepMm: 5,
  named: {},
  phoneTopic: "/phone",
  padTopic: "/joy",
  xrTopic: "/xr",
  imuTopic: "/phone/imu",
  camera: null,
  hides: ["capsules"],
};

/** Named poses of a file, each with so many joints; raises an Error that says what is wrong in it. */
export function parseNamed(text: string, joints: number): Named[] {
  const wrong = `${t("noPoses")} ${joints}`;
  let found: unknown;
  try {
    found = JSON.parse(text);
  } catch {
    throw new Error(wrong);
  }
  if (!Array.isArray(found)) throw new Error(wrong);
  return found.map((each: Partial<Named> | null) => {
    const { name, joints: values } = each ?? {};
    const named = typeof name === "string" && name !== "" && name.length <= LONGEST_NAME;
    if (!named || !Array.isArray(values) || values.length !== joints) throw new Error(wrong);
    if (!values.every((value) => Number.isFinite(value))) throw new Error(wrong);
    return { name, joints: [...values] };
  });
}

/** What is kept; defaults for what is not, or cannot be read. */
export function loadSettings(): Settings {
  try {
    const kept = JSON.parse(localStorage.getItem(KEY) ?? "{}") as Partial<Settings>;
    return { ...DEFAULTS, language: preferredLanguage(), ...kept };
  } catch {
    return { ...DEFAULTS, language: preferredLanguage() };
  }
}

export function saveSettings(settings: Settings): void {
  try {
    localStorage.setItem(KEY, JSON.stringify(settings));
  } catch {
    // A browser that keeps nothing works all the same.
  }
}
