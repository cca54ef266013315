import { button, h, section, setText, stopper } from "../dom.ts";
import { findPad, isHeld, padBody } from "../gamepad.ts";
import { OperatorDevice } from "../operator_device.ts";
import type { Body, XrPart } from "../frames.ts";
import { STALL_MS, whileHeld } from "../hold.ts";
import { t } from "../i18n.ts";
import type { Link } from "../link.ts";
import { BUTTONS, PhoneSensors } from "../phone.ts";
import type { Settings } from "../settings.ts";
import { startXr, xrMode } from "../xr.ts";

const CHANNELS = { phone: 2, pad: 3, left: 4, right: 5, viewer: 6 } as const;

/** The second finger's way that counts as 1: a third of the screen's shorter side. */
const DRAG_SHARE = 1 / 3;

/** This device as an operator device: phone, gamepad, headset. */
export class DevicePanel {
  readonly element: HTMLElement;
  private readonly link: Link;
  private readonly settings: Settings;
  private readonly keep: () => void;
  private readonly refreshes: (() => void)[] = [];
  private readonly stops: (() => void)[] = [];
  private readonly devices: OperatorDevice[] = [];

  constructor(link: Link, settings: Settings, keep: () => void) {
    [this.link, this.settings, this.keep] = [link, settings, keep];
    this.element = h("div", { class: "panel" }, this.phone(), this.pad(), this.xr());
    link.onFeedback = (_channel, intensity) => {
      if (intensity > 0) navigator.vibrate?.(Math.round(60 * intensity));
    };
  }

  refresh(): void {
    for (const each of this.refreshes) each();
  }

  /** The arm was stopped: what they hold has to be let go and held anew. */
  halt(): void {
    for (const each of this.devices) each.holding.end("stopped");
  }

  /** None of them is an operator device any more. */
  stop(): void {
    for (const each of this.stops) each();
  }

  private phone(): HTMLElement {
    const sensors = new PhoneSensors();
    const device = new OperatorDevice(CHANNELS.phone, this.link, () => sensors.body());
    const note = h("p", { class: "hint", role: "status" });
    const pad = h("button", { type: "button", class: "clutch" }, t("clutch"));
    whileHeld(
      pad,
      () => device.press(),
      (why) => {
        sensors.letGo();
        device.holding.end(why);
      },
    );
    secondFinger(pad, (right, up) => sensors.drag(right, up));
    const align = button(t("align"), () => {}, { title: t("alignHelp") });
    whileHeld(
      align,
      () => {
        sensors.buttons |= BUTTONS.align;
        return device.open;
      },
      () => {
        sensors.buttons &= ~BUTTONS.align;
      },
    );
    this.devices.push(device);
    const start = stopper(t("start"), () => device.open, () => void toggle());
    const end = () => {
      if (!device.open) return;
      device.stop();
      sensors.stop();
      setText(note, t("phoneHelp"));
    };
    this.stops.push(end);
    const toggle = async () => {
      if (device.open) {
        end();
        return;
      }
      if (!isSecureContext) {
        setText(note, t("needsHttps"));
        return;
      }
      // The permission has to be asked for in the click itself.
      if (!(await sensors.start())) {
        sensors.stop();
        setText(note, t("noSensor"));
        return;
      }
      setText(note, (await device.start({ device: this.settings.phoneTopic })) || t("sensorsRun"));
    };
    this.refreshes.push(() => {
      setText(start, t(device.open ? "finish" : "start"));
      pad.disabled = !device.open;
      align.disabled = !device.open;
      const input = this.link.inputs.get(CHANNELS.phone);
      if (device.open && input) {
        setText(note, input.why || `${t("inputRate")} ${input.rate_hz.toFixed(0)} 1/s`);
      }
    });
    setText(note, t("phoneHelp"));
    return section(
      "phone",
      this.topic("phoneTopic"),
      h("div", { class: "row" }, start, align),
      note,
      pad,
    );
  }

  private pad(): HTMLElement {
    const now = (): Body | null => {
      const pad = findPad();
      return pad ? padBody(pad) : null;
    };
    const device = new OperatorDevice(CHANNELS.pad, this.link, now);
    const note = h("p", { class: "hint", role: "status" });
    const poll = () => {
      if (!device.open) return;
      const pad = findPad();
      device.setHeld(pad !== null && isHeld(pad));
      requestAnimationFrame(poll);
    };
    this.stops.push(() => device.stop());
    this.devices.push(device);
    const toggle = () => {
      if (device.open) device.stop();
      else void device.start({ joy: this.settings.padTopic }).then(() => requestAnimationFrame(poll));
    };
    const start = stopper(t("start"), () => device.open, toggle);
    this.refreshes.push(() => {
      setText(start, t(device.open ? "finish" : "start"));
      const pad = findPad();
      start.disabled = !pad && !device.open;
      const input = this.link.inputs.get(CHANNELS.pad);
      setText(note, device.note || (device.open && input?.why) || (pad ? `${pad.id} · ${t("padHelp")}` : t("padNone")));
    });
    return section("pad", this.topic("padTopic"), h("div", { class: "row" }, start), note);
  }

  private xr(): HTMLElement {
    const states = new Map<XrPart, { body: Body; atMs: number }>();
    // A device that the session tells nothing of any more is none: its last place says nothing.
    const present = (part: XrPart): Body | null => {
      const state = states.get(part);
      return state && performance.now() - state.atMs <= STALL_MS ? state.body : null;
    };
    const devices = new Map<XrPart, OperatorDevice>(
      (["left", "right", "viewer"] as const).map((part) => [
        part,
        new OperatorDevice(CHANNELS[part], this.link, () => present(part)),
      ]),
    );
    const note = h("p", { class: "hint", role: "status" }, t("xrNone"));
    let touched = false;
    const overlay = h("div", { class: "xr-overlay", hidden: true });
    const clutch = h("button", { type: "button", class: "clutch" }, t("clutch"));
    whileHeld(
      clutch,
      () => {
        touched = true;
        return true;
      },
      () => {
        touched = false;
      },
    );
    let aligning = false;
    const align = h("button", { type: "button", title: t("alignHelp") }, t("align"));
    whileHeld(
      align,
      () => {
        aligning = true;
        return true;
      },
      () => {
        aligning = false;
      },
    );
    let end: (() => void) | null = null;
    this.stops.push(() => end?.());
    overlay.append(clutch, align, stopper(t("finish"), () => true, () => end?.()));
    this.devices.push(...devices.values());
    const over = () => {
      end = null;
      overlay.hidden = true;
      states.clear();
      for (const each of devices.values()) each.stop();
    };
    const start = button(t("start"), () => void begin(), { disabled: true });
    const begin = async () => {
      try {
        const mode = await xrMode();
        if (!mode) return;
        for (const each of devices.values()) each.note = "";
        end = await startXr(
          mode,
          overlay,
          () => touched,
          () => aligning,
          (all) => {
            const atMs = performance.now();
            for (const each of all) {
              states.set(each.part, { body: each.body, atMs });
              const device = devices.get(each.part);
              if (!device) continue;
              device.tracking = each.tracking;
              // What the server refuses is not asked for again at each frame.
              if (!device.open && !device.note) {
                void device.start({ device: this.settings.xrTopic }).then((why) => {
                  if (why) setText(note, why);
                });
              }
              device.setHeld(each.held);
            }
          },
          over,
        );
        overlay.hidden = false;
      } catch (error) {
        setText(note, (error as Error).message);
      }
    };
    void xrMode().then((mode) => {
      start.disabled = mode === null;
      setText(note, mode ?? (isSecureContext ? t("xrNone") : t("needsHttps")));
    });
    return section("xr", this.topic("xrTopic"), h("div", { class: "row" }, start), note, overlay);
  }

  private topic(key: "phoneTopic" | "padTopic" | "xrTopic"): HTMLElement {
    const input = h("input", { type: "text", value: this.settings[key], spellcheck: "false" });
    input.addEventListener("change", () => {
      this.settings[key] = input.value;
      this.keep();
    });
    return h("label", { class: "field" }, h("span", {}, t("topic")), input);
  }
}

/** A second finger on the pad: how far it is from where it was put down, right and up. */
function secondFinger(pad: HTMLElement, moved: (right: number, up: number) => void): void {
  let first: number | null = null;
  let second: { id: number; x: number; y: number } | null = null;
  const away = (event: PointerEvent) => {
    if (event.pointerId === first) first = null;
    if (event.pointerId === second?.id) {
      second = null;
      moved(0, 0);
    }
  };
  pad.addEventListener("pointerdown", (event) => {
    if (first === null) first = event.pointerId;
    else if (second === null) second = { id: event.pointerId, x: event.clientX, y: event.clientY };
  });
  pad.addEventListener("pointermove", (event) => {
    if (event.pointerId !== second?.id) return;
    const one = DRAG_SHARE * Math.min(innerWidth, innerHeight);
    const clip = (value: number) => Math.max(-1, Math.min(1, value / one));
    moved(clip(event.clientX - second.x), clip(second.y - event.clientY));
  });
  for (const name of ["pointerup", "pointercancel", "lostpointercapture"] as const) {
    pad.addEventListener(name, away);
  }
}
