import type { Snapshot, Status } from "./arm.ts";
import type { End } from "./hold.ts";
import { type Word, t } from "./i18n.ts";
import type { Asked } from "./lease.ts";
import { SLOW_MS } from "./latency.ts";
import type { LinkState } from "./rosbridge.ts";

export type Level = "ok" | "note" | "warn" | "bad";
export type Why = { level: Level; text: string };

/** All that decides whether an arm moves, as the page knows it. */
export type Facts = {
  link: LinkState;
  /** Whether a token was given to the page. */
  hasToken: boolean;
  chosen: boolean;
  stateAgeMs: number;
  roundTripMs: number | null;
  role: string;
  source: string;
  /** What became of our request for the authority. */
  asked: Asked;
  armed: boolean;
  held: boolean;
  /** The hold ends after so long unless who holds moves, s; null: nothing is held. */
  leftS: number | null;
  ended: End | "";
  /** The source that stopped the arm last; empty: none has, or this page did. */
  stoppedBy: string;
  /** Why the server or the arm took the newest hold away; empty: it did not. */
  refused: string;
  snapshot: Snapshot | null;
  status: Status | null;
};

/** State that is older is not the arm's any more. */
export const SILENT_MS = 1500;

/** The end of a hold is announced so long before, s. */
const ENDS_SOON_S = 4;

/** Why it does not move, or what it does, in one line: the nearest cause first. */
export function why(facts: Facts): Why {
  const { snapshot, status } = facts;
  if (facts.link === "connecting") return { level: "warn", text: t("connecting") };
  if (facts.link === "lost") return { level: "bad", text: t("lost") };
  if (facts.link === "refused") {
    return { level: "bad", text: t(facts.hasToken ? "wrongToken" : "noToken") };
  }
  if (!facts.chosen) return { level: "note", text: `${t("noArms")}. ${t("noArmsHelp")}` };
  if (facts.stateAgeMs > SILENT_MS) return { level: "bad", text: t("silent") };
  if (snapshot?.finished) {
    return { level: "bad", text: [t("ended"), snapshot.error].filter(Boolean).join(": ") };
  }
  const stands = [...(snapshot?.diagnosis ?? []), snapshot?.robot?.hold_reason].find(Boolean);
  if (status && !status.ready) {
    const because = status.message || stands;
    return { level: "bad", text: because ? `${t("notReady")}: ${because}` : t("notReady") };
  }
  if (facts.refused) return { level: "bad", text: refusal(facts.refused) };
  if (facts.held && facts.leftS !== null && facts.leftS <= ENDS_SOON_S) {
    return { level: "warn", text: `${t("endsSoon")} ${Math.ceil(facts.leftS)} s` };
  }
  if (status?.moving) return { level: limited(facts) ? "warn" : "ok", text: moves(facts) };
  if (facts.held && limited(facts)) return { level: "warn", text: limited(facts) };
  const message = status?.message || snapshot?.arm?.message;
  if (message) return { level: "warn", text: message };
  const hold = snapshot?.robot?.hold_reason;
  if (hold) return { level: "warn", text: hold };
  if (status?.authority && status.authority !== facts.source) {
    return { level: "note", text: `${status.authority} ${t("hasAuthority")}` };
  }
  if (facts.asked === "given" && !facts.armed) return { level: "note", text: t("given") };
  if (facts.role === "viewer") return { level: "note", text: t("viewer") };
  if (facts.roundTripMs !== null && facts.roundTripMs > SLOW_MS) {
    return { level: "bad", text: `${t("tooSlow")}: ${facts.roundTripMs.toFixed(0)} ms` };
  }
  if (facts.ended && facts.ended !== "released" && !facts.held) {
    const word = `end_${facts.ended}` satisfies Word;
    const level = facts.ended === "arrived" ? "ok" : "warn";
    const by = facts.ended === "stopped" && facts.stoppedBy ? ` (${facts.stoppedBy})` : "";
    return { level, text: `${t("holdEnded")}: ${t(word)}${by}` };
  }
  if (facts.armed) return { level: "ok", text: t("ready") };
  return { level: "note", text: t("notEnabled") };
}

/** The arm's word for a command that came too late, as people have to hear it. */
const SILENT = /the stream was silent for/;

function refusal(why: string): string {
  return SILENT.test(why) ? t("cameLate") : why;
}

function limited({ snapshot, status }: Facts): string {
  const limits = status?.limits.length ? status.limits : (snapshot?.arm?.limits_in_words ?? []);
  if (limits.length) return `${t("limitedBy")} ${limits.join(", ")}`;
  return snapshot?.arm?.at_workspace_limit ? t("atWall") : "";
}

function moves(facts: Facts): string {
  const { snapshot, status } = facts;
  const who = status?.authority === facts.source ? t("you") : status?.authority;
  const share = snapshot?.arm?.path_speed;
  const slow =
    share !== null && share !== undefined && share < 0.99
      ? `${t("slowed")} ${(100 * share).toFixed(0)} %`
      : "";
  const head = who ? `${t("moving")} (${who})` : t("moving");
  return [head, limited(facts), slow].filter(Boolean).join(" · ");
}
