import type { Body } from "./frames.ts";

/** Hold to move: the only way in which this page moves anything.
 *
 * A frame goes out each FRAME_MS, and each says again whether the hold is held. A hold is ended by
 * all that can end it; nothing but a new press begins one. */
export const FRAME_MS = 20;

/** The page stood still for longer: what is held was not watched, and is over. */
export const STALL_MS = 150;

/** Of the pointer beyond the control's edge, CSS pixels. */
const MARGIN_PX = 32;

/** Armed, and nothing was held for so long: whoever went away leaves the arm to others. */
export const IDLE_MS = 180_000;

/** How often frames go out that hold nothing, so that the server knows that the hand is free. */
const REST_MS = 200;

export type End =
  | "released"
  | "cancelled"
  | "left"
  | "blur"
  | "hidden"
  | "closed"
  | "stalled"
  | "slow"
  | "refused"
  | "stopped"
  | "idle"
  | "arrived";

/** After these the page is disarmed: going on takes the deliberate act again. */
const DISARMING: ReadonlySet<End> = new Set(["hidden", "closed", "stalled", "slow", "stopped", "idle"]);

/** What a control asks for now; null: it has arrived, and the hold is over. */
export type Asks = (nowMs: number) => Body | null;

export type Sent = { body: Body; hold: boolean };

/** The state of the one hold of the page, without a browser. */
export class Holding {
  armed = false;
  /** Why the last hold ended. */
  ended: End | "" = "";
  onChange: () => void = () => {};
  private asks: Asks | null = null;
  private last: Body = { kind: "jog twist", linear: [0, 0, 0], angular: [0, 0, 0], frame: "base" };
  private lastMs = -Infinity;
  private lastSentMs = -Infinity;
  private usedMs = -Infinity;
  private letGo = false;

  get held(): boolean {
    return this.asks !== null;
  }

  /** The deliberate act, with nothing held. */
  arm(nowMs: number): void {
    this.end("released");
    this.armed = true;
    this.lastMs = this.usedMs = nowMs;
    this.letGo = true;
    this.onChange();
  }

  disarm(): void {
    this.end("released");
    this.armed = false;
    this.onChange();
  }

  /** A control is pressed; false: nothing may move now, or another one is held. */
  press(asks: Asks, nowMs: number): boolean {
    if (!this.armed || this.held) return false;
    this.asks = asks;
    this.lastMs = nowMs;
    this.lastSentMs = -Infinity;
    this.ended = "";
    this.onChange();
    return true;
  }

  end(why: End): void {
    const held = this.held;
    if (held) {
      this.asks = null;
      this.ended = why;
      this.letGo = true;
    }
    const disarms = this.armed && DISARMING.has(why);
    if (disarms) {
      this.armed = false;
      this.ended = why;
    }
    if (held || disarms) this.onChange();
  }

  /** The frame that is due, if one is. */
  tick(nowMs: number): Sent | null {
    const still = nowMs - this.lastMs > STALL_MS;
    this.lastMs = nowMs;
    if (still && this.held) this.end("stalled");
    if (this.held) this.usedMs = nowMs;
    else if (this.armed && nowMs - this.usedMs > IDLE_MS) this.end("idle");
    if (this.asks) {
      const body = this.asks(nowMs);
      if (body) {
        this.last = body;
        this.lastSentMs = nowMs;
        return { body, hold: true };
      }
      this.end("arrived");
    }
    if (!this.letGo && !(this.armed && nowMs - this.lastSentMs >= REST_MS)) return null;
    this.letGo = false;
    this.lastSentMs = nowMs;
    return { body: atRest(this.last), hold: false };
  }
}

/** The same frame without motion. */
export function atRest(body: Body): Body {
  if (body.kind === "jog twist") return { ...body, linear: [0, 0, 0], angular: [0, 0, 0] };
  if (body.kind === "jog joints") return { ...body, rates: body.rates.map(() => 0) };
  return body;
}

const KEYS: ReadonlySet<string> = new Set([" ", "Enter"]);

/** Make `element` hold while it is pressed, by a pointer or a key: `begin` is asked at the press;
 * `end` is told once why it ended. */
export function whileHeld(
  element: HTMLElement,
  begin: () => boolean,
  end: (why: End) => void,
): void {
  let pointer: number | null = null;
  let key: string | null = null;
  const over = (why: End) => {
    if (pointer === null && key === null) return;
    const captured = pointer;
    pointer = null;
    key = null;
    element.classList.remove("held");
    element.removeAttribute("aria-pressed");
    if (captured !== null && element.hasPointerCapture(captured)) {
      element.releasePointerCapture(captured);
    }
    end(why);
  };
  const start = (): boolean => {
    if (!begin()) {
      navigator.vibrate?.(60);
      return false;
    }
    element.classList.add("held");
    element.setAttribute("aria-pressed", "true");
    return true;
  };

  element.classList.add("hold");
  element.addEventListener("pointerdown", (event) => {
    if (event.button !== 0 || pointer !== null || key !== null) return;
    if (!event.isTrusted || !start()) return;
    pointer = event.pointerId;
    element.setPointerCapture(event.pointerId);
  });
  element.addEventListener("pointermove", (event) => {
    if (event.pointerId !== pointer) return;
    const box = element.getBoundingClientRect();
    const inside =
      event.clientX > box.left - MARGIN_PX &&
      event.clientX < box.right + MARGIN_PX &&
      event.clientY > box.top - MARGIN_PX &&
      event.clientY < box.bottom + MARGIN_PX;
    if (!inside) over("left");
  });
  const ends: [keyof HTMLElementEventMap, End][] = [
    ["pointerup", "released"],
    ["pointercancel", "cancelled"],
    ["lostpointercapture", "cancelled"],
  ];
  for (const [name, why] of ends) {
    element.addEventListener(name, (event) => {
      if ((event as PointerEvent).pointerId === pointer) over(why);
    });
  }
  element.addEventListener("keydown", (event) => {
    if (!KEYS.has(event.key)) return;
    event.preventDefault();
    if (event.repeat || !event.isTrusted || pointer !== null || key !== null) return;
    if (start()) key = event.key;
  });
  element.addEventListener("keyup", (event) => {
    if (event.key === key) over("released");
  });
  element.addEventListener("blur", () => over("blur"));
  // Chromium holds all timers back for 100 ms after a touch that may become a gesture of its own: no
  // frame would go out, and the arm's stream be silent.
  element.addEventListener("touchstart", (event) => event.preventDefault(), { passive: false });
  element.addEventListener("contextmenu", (event) => event.preventDefault());
  element.addEventListener("dragstart", (event) => event.preventDefault());
  // Whatever ends the hold of the page lets go of its control, too.
  element.addEventListener("let-go", () => over("released"));
  window.addEventListener("blur", () => over("blur"));
}

/** Let go of every control that is pressed. */
export function letGoOfAll(): void {
  for (const each of document.querySelectorAll(".held")) each.dispatchEvent(new Event("let-go"));
}

/** End the hold by all that may happen to a page. */
export function endWithPage(end: (why: End) => void): void {
  window.addEventListener("blur", () => end("blur"));
  window.addEventListener("pagehide", () => end("hidden"));
  document.addEventListener("freeze", () => end("hidden"));
  document.addEventListener("visibilitychange", () => {
    if (document.visibilityState === "hidden") end("hidden");
  });
}
