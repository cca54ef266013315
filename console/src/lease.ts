/** The authority over an arm between people: who asks whom for it, and what became of that. It is given
 * by who has it alone, by a verb of the arm, and seen in the arm's status. */

/** A request that has no answer for longer is over. */
export const ASKED_MS = 20_000;

/** Of who has it without moving: well below the arm's own 2 s, after which it is free. */
export const RENEW_MS = 500;

/** Who was handed it keeps it for so long before motion has to be enabled. */
export const GRACE_MS = 20_000;

/** A message of the arm's topic authority/request. */
export type AuthorityRequest = { source: string; owner: string; answer: string };

export type Asked = "" | "waiting" | "refused" | "silent" | "given";

export class Lease {
  /** Who asks us for it; empty: nobody. */
  requester = "";
  /** What became of our own request. */
  asked: Asked = "";
  private askedMs = -Infinity;
  private requesterMs = -Infinity;
  private graceMs = -Infinity;

  /** We have asked. */
  ask(nowMs: number): void {
    [this.asked, this.askedMs] = ["waiting", nowMs];
  }

  /** Somebody asked, or was answered; `own`: our name. */
  heard({ source, owner, answer }: AuthorityRequest, own: string, nowMs: number): void {
    if (owner === own && !answer) [this.requester, this.requesterMs] = [source, nowMs];
    if (source === own && answer && this.asked === "waiting") {
      [this.asked, this.askedMs] = ["refused", nowMs];
    }
  }

  /** The request to us is answered. */
  answered(): void {
    this.requester = "";
  }

  /** Time goes by; `owner`: who has it now. */
  look(owner: string, own: string, nowMs: number): void {
    if (owner !== own || nowMs - this.requesterMs > ASKED_MS) this.requester = "";
    if (this.asked === "waiting" && own && owner === own) {
      [this.asked, this.askedMs, this.graceMs] = ["given", nowMs, nowMs + GRACE_MS];
    }
    if (!this.asked || nowMs - this.askedMs <= ASKED_MS) return;
    // That nobody has answered is shown for as long, too.
    if (this.asked === "waiting") [this.asked, this.askedMs] = ["silent", nowMs];
    else this.asked = "";
  }

  /** Whether it was handed to us a moment ago, and motion is not enabled yet. */
  isNew(nowMs: number): boolean {
    return nowMs < this.graceMs;
  }

  /** It is used, or given up. */
  settle(): void {
    [this.asked, this.requester, this.graceMs] = ["", "", -Infinity];
  }
}
