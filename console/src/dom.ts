import { type Word, t } from "./i18n.ts";

type Child = Node | string | null | undefined;
type Properties = Record<string, string | number | boolean | ((event: Event) => void) | null>;

/** An element: `on…` are listeners, `true` an attribute without a value, false and null none. */
export function h<K extends keyof HTMLElementTagNameMap>(
  tag: K,
  properties: Properties = {},
  ...children: Child[]
): HTMLElementTagNameMap[K] {
  const element = document.createElement(tag);
  for (const [name, value] of Object.entries(properties)) {
    if (typeof value === "function") element.addEventListener(name.slice(2), value);
    else if (value !== false && value !== null) {
      element.setAttribute(name, value === true ? "" : String(value));
    }
  }
  element.append(...children.filter((each) => each !== null && each !== undefined));
  return element;
}

export function button(
  label: string,
  press: () => void,
  properties: Properties = {},
): HTMLButtonElement {
  return h("button", { type: "button", onclick: () => press(), ...properties }, label);
}

/** The click that follows a press comes so soon after it was let go. */
const CLICK_MS = 500;

/** A button that stops or ends something. While `ends()`, `press` is called when any pointer goes
 * down on it: also the second finger, of which browsers make no click while the first one is held.
 * Keys act, too; and a click, which alone begins something. */
export function stopper(
  label: string,
  ends: () => boolean,
  press: () => void,
  properties: Properties = {},
): HTMLButtonElement {
  const element = h("button", { type: "button", ...properties }, label);
  let done = false;
  const pointers = new Set<number>();
  let forget: ReturnType<typeof setTimeout> | undefined;
  element.addEventListener("pointerdown", (event) => {
    clearTimeout(forget);
    const acts = ends();
    // One that comes while another is down takes nothing back: the first one's click is to come.
    done = acts || (done && pointers.size > 0);
    pointers.add(event.pointerId);
    if (acts) press();
  });
  // Wherever it goes up: one that left the button and came back makes a click, too.
  for (const name of ["pointerup", "pointercancel"] as const) {
    window.addEventListener(name, (event) => {
      if (!pointers.delete(event.pointerId) || pointers.size > 0) return;
      clearTimeout(forget);
      forget = setTimeout(() => {
        done = false;
      }, CLICK_MS);
    });
  }
  element.addEventListener("click", (event) => {
    // A key's click has no count of presses.
    if (!done || event.detail === 0) press();
    done = false;
  });
  return element;
}

export function section(title: Word, ...children: Child[]): HTMLElement {
  return h("section", { class: "card" }, h("h2", {}, t(title)), ...children);
}

/** A switch with its word. */
export function check(label: string, present: boolean, changed: (on: boolean) => void): HTMLElement {
  const input = h("input", { type: "checkbox", checked: present });
  input.addEventListener("change", () => changed(input.checked));
  return h("label", { class: "check" }, input, h("span", {}, label));
}

/** One of several, as radio buttons that look like one bar. */
export function choice<V extends string>(
  label: string,
  values: readonly (readonly [V, string])[],
  present: V,
  chosen: (value: V) => void,
): HTMLElement {
  const name = `choice-${++choices}`;
  const bar = h("div", { class: "choice", role: "radiogroup", "aria-label": label });
  for (const [value, text] of values) {
    const input = h("input", { type: "radio", name, value, checked: value === present });
    input.addEventListener("change", () => chosen(value));
    bar.append(h("label", {}, input, h("span", {}, text)));
  }
  return bar;
}

let choices = 0;

export type SliderOptions = {
  label: string;
  min: number;
  max: number;
  step: number;
  value: number;
  unit: string;
  digits: number;
  /** Whether its ends are written below its label. */
  ends?: boolean;
  /** What is written below its label of a value. */
  says?: (value: number) => string;
  class?: string;
  change: (value: number) => void;
};

/** A slider with its number, which can be typed, too. */
export class Slider {
  readonly element: HTMLElement;
  private readonly range: HTMLInputElement;
  private readonly number: HTMLInputElement;
  private readonly mark: HTMLElement;
  private readonly note = h("small");
  private readonly options: SliderOptions;

  constructor(options: SliderOptions) {
    this.options = options;
    const { label, min, max, step, unit } = options;
    const common = { min, max, step };
    this.range = h("input", { type: "range", "aria-label": label, ...common });
    this.number = h("input", {
      type: "number",
      inputmode: "decimal",
      "aria-label": `${label}, ${unit}`,
      ...common,
      step: "any",
    });
    this.mark = h("i", { class: "mark", "aria-hidden": "true" });
    this.range.addEventListener("input", () => this.changed(this.range));
    this.number.addEventListener("change", () => this.changed(this.number));
    this.element = h(
      "div",
      { class: `slider ${options.class ?? ""}`.trim() },
      h(
        "span",
        { class: "slider-label" },
        label,
        options.ends ? h("small", {}, `${min} … ${max}`) : null,
        options.says ? this.note : null,
      ),
      h("span", { class: "track" }, this.mark, this.range),
      h("span", { class: "slider-number" }, this.number, h("span", { class: "unit" }, unit)),
    );
    this.set(options.value);
  }

  /** Show a value that something else has set. */
  set(given: number): void {
    const value = Number(given.toFixed(6)) || 0;
    const shown = fixed(value, this.options.digits);
    this.range.value = String(value);
    if (document.activeElement !== this.number) {
      this.number.value = shown;
    }
    const told = this.options.says?.(value) ?? "";
    setText(this.note, told);
    const more = told ? `, ${told}` : "";
    this.range.setAttribute("aria-valuetext", `${shown} ${this.options.unit}${more}`);
  }

  /** Where the robot is, as a mark on the track. */
  setMeasured(value: number): void {
    const { min, max } = this.options;
    const share = Math.max(0, Math.min(1, (value - min) / (max - min)));
    this.mark.style.setProperty("--at", share.toFixed(4));
  }

  private changed(input: HTMLInputElement): void {
    const { min, max, change } = this.options;
    const value = Number(input.value);
    if (!Number.isFinite(value) || input.value === "") return;
    const kept = Math.max(min, Math.min(max, value));
    this.set(kept);
    change(kept);
  }
}

/** A number with so many digits, and never "-0.0". */
export function fixed(value: number, digits: number): string {
  return value.toFixed(digits).replace(/^-(?=[0.]+$)/, "");
}

/** Set text only where it differs, so that screen readers and the layout are left alone. */
export function setText(element: Element, text: string): void {
  if (element.textContent !== text) element.textContent = text;
}
