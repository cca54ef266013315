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

/** Armed, and nothing was held for so long: a page that nobody uses leaves the arm to others. */
export const IDLE_MS = 180_000;

/** How often frames go out that hold nothing, so that the server knows that the operator is free. */
const REST_MS = 200;

export type End =
  | "released"
  | "canceled"
  | "left"
  | "chord"
  | "moved"
  | "hung"
  | "blur"
  | "hidden"
  | "closed"
  | "stalled"
  | "slow"
  | "refused"
  | "stopped"
  | "idle"
  | "arrived";

/** After these the page is disarmed: re-arm to go on. */
const DISARMING: ReadonlySet<End> = new Set([
  "hidden",
  "closed",
  "stalled",
  "hung",
  "slow",
  "stopped",
  "idle",
]);

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

  /** Re-arm, with nothing held. */
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
 * `end` is told once why it ended, and `moves` of each thing that the person does meanwhile: the
 * pointer moves, or the key repeats itself. */
export function whileHeld(
  element: HTMLElement,
  begin: () => boolean,
  end: (why: End) => void,
  moves: () => void = () => {},
): void {
  let pointer: { id: number; x: number; y: number; mouse: boolean; onIt: boolean } | null = null;
  let key = false;
  let watch: ReturnType<typeof setInterval> | undefined;
  const over = (why: End) => {
    if (!pointer && !key) return;
    const captured = pointer?.id;
    pointer = null;
    key = false;
    clearInterval(watch);
    element.classList.remove("held");
    element.removeAttribute("aria-pressed");
    if (captured !== undefined && element.hasPointerCapture(captured)) {
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
  const isOn = (x: number, y: number): boolean => element.contains(document.elementFromPoint(x, y));
  const isInside = (x: number, y: number): boolean => {
    const box = element.getBoundingClientRect();
    return (
      x > box.left - MARGIN_PX &&
      x < box.right + MARGIN_PX &&
      y > box.top - MARGIN_PX &&
      y < box.bottom + MARGIN_PX
    );
  };
  // The pointer rests and the page does not: something lies over the control, or it went elsewhere.
  const look = () => {
    if (!pointer) return;
    const { x, y, onIt } = pointer;
    if (!isInside(x, y) || (onIt && !isOn(x, y))) over("moved");
  };

  element.classList.add("hold");
  element.addEventListener("pointerdown", (event) => {
    if (event.button !== 0 || event.buttons !== 1 || pointer || key) return;
    if (!event.isTrusted || !start()) return;
    const { pointerId: id, clientX: x, clientY: y } = event;
    pointer = { id, x, y, mouse: event.pointerType === "mouse", onIt: isOn(x, y) };
    element.setPointerCapture(id);
    watch = setInterval(look, FRAME_MS);
  });
  // Of a mouse with several buttons down, browsers say pointerup for the last one only: which are
  // down is in every event, wherever on the page it is.
  const buttons = (event: MouseEvent) => {
    if (event.buttons === 1) return;
    over((event.buttons & 1) === 0 ? "released" : "chord");
  };
  for (const name of ["pointerdown", "pointermove", "pointerup", "pointercancel"] as const) {
    listen(name, (event) => {
      if (event.pointerId !== pointer?.id) return;
      if (name === "pointercancel") return over("canceled");
      buttons(event);
      if (!pointer) return;
      const { clientX: x, clientY: y } = event;
      if (!isInside(x, y)) return over("left");
      if (event.isTrusted && (x !== pointer.x || y !== pointer.y)) moves();
      pointer = { ...pointer, x, y, onIt: isOn(x, y) };
    });
  }
  for (const name of ["mousedown", "mouseup"] as const) {
    listen(name, (event) => pointer?.mouse && buttons(event));
  }
  element.addEventListener("lostpointercapture", (event) => {
    if (event.pointerId === pointer?.id) over("canceled");
  });
  element.addEventListener("keydown", (event) => {
    if (!KEYS.has(event.key)) return;
    event.preventDefault();
    if (event.repeat && event.isTrusted && key) moves();
    if (event.repeat || !event.isTrusted || pointer || key) return;
    key = start();
  });
  // A key may go up as another one: with AltGr down, Space ends as a no-break space, and some
  // keyboards do not say which key it was. Any key that goes up ends it, wherever the focus is.
  listen("keyup", () => key && over("released"));
  element.addEventListener("blur", () => over("blur"));
  // Chromium holds all timers back for 100 ms after a touch that may become a gesture of its own: no
  // frame would go out, and the arm's stream be silent.
  element.addEventListener("touchstart", (event) => event.preventDefault(), { passive: false });
  element.addEventListener("contextmenu", (event) => event.preventDefault());
  element.addEventListener("dragstart", (event) => event.preventDefault());
  // Whatever ends the hold of the page lets go of its control, too.
  element.addEventListener("let-go", () => over("released"));
  listen("contextmenu", () => over("canceled"));
  window.addEventListener("blur", () => over("blur"));
  window.addEventListener("resize", () => over("moved"));
  window.addEventListener("orientationchange", () => over("moved"));
  // The keyboard of a phone, which leaves the window as large as it was.
  window.visualViewport?.addEventListener("resize", () => over("moved"));
}

/** Hear an event of the window before any element does, so that none can keep it back. */
function listen<K extends keyof WindowEventMap>(
  name: K,
  heard: (event: WindowEventMap[K]) => unknown,
): void {
  window.addEventListener(name, (event) => void heard(event), { capture: true });
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
