import { button, h, section, setText } from "../dom.ts";
import { t } from "../i18n.ts";
import type { Link } from "../link.ts";
import type { Replay } from "../replay.ts";

/** How often the server is asked while the list can be seen. */
const LOOK_MS = 2000;

const SPEEDS = [0.1, 0.25, 0.5, 1, 2, 4, 8, 16];

type Present = { name: string; seconds: number; bytes: number; messages: number; dropped: number };
type Kept = { name: string; bytes: number; changed_s: number };
type Table = { recording?: Present; ended: string; records: Kept[] };

/** Bytes as people read them. */
export function size(bytes: number): string {
  const units = ["B", "kB", "MB", "GB", "TB"];
  let unit = 0;
  let value = bytes;
  while (value >= 1000 && unit < units.length - 1) {
    value /= 1000;
    unit += 1;
  }
  return `${value.toFixed(unit && value < 10 ? 1 : 0)} ${units[unit]}`;
}

/** Minutes, seconds and tenths. */
export function clock(seconds: number): string {
  const tenths = Math.round(Math.max(0, seconds) * 10);
  const rest = ((tenths % 600) / 10).toFixed(1).padStart(4, "0");
  return `${Math.floor(tenths / 600)}:${rest}`;
}

/** The records of the server's machine: make one, and look at one. */
export class RecordsCard {
  readonly element: HTMLElement;
  private readonly note = h("p", { class: "hint", role: "status" });
  private readonly list = h("ul", { class: "rows" });
  private readonly make: HTMLButtonElement;
  private readonly link: Link;
  private readonly replay: Replay;
  private table: Table | null = null;
  private refusal = "";
  private asking = false;

  constructor(link: Link, replay: Replay) {
    [this.link, this.replay] = [link, replay];
    this.make = button(t("record"), () => void this.ask(this.table?.recording ? "finish" : "record"));
    this.make.className = "record";
    this.element = section(
      "records",
      h("div", { class: "row" }, this.make, button(t("update"), () => void this.ask("list"))),
      this.note,
      this.list,
    );
    setInterval(() => this.look(), LOOK_MS);
  }

  private look(): void {
    if (this.element.offsetParent && !this.asking && this.link.state === "live") {
      void this.ask("list", false);
    }
  }

  private async ask(what: "list" | "record" | "finish", said = true): Promise<void> {
    this.asking = true;
    if (said) this.replay.over = "";
    if (what !== "list") setText(this.note, t("asking"));
    try {
      this.table = (await this.link.ask("cardan.records", { do: what })) as unknown as Table;
      if (said) this.refusal = "";
    } catch (error) {
      if (said || !this.table) this.refusal = (error as Error).message;
    }
    this.asking = false;
    this.show();
  }

  /** Bring it up to date. */
  show(): void {
    const { recording, ended, records } = this.table ?? { ended: "", records: [] };
    setText(this.make, t(recording ? "recordEnd" : "record"));
    this.make.setAttribute("aria-pressed", String(Boolean(recording)));
    this.make.disabled = this.link.hello?.role === "viewer";
    const present = recording
      ? `${recording.name}: ${clock(recording.seconds)}, ${size(recording.bytes)}, ${recording.messages} ${t("messages")}` +
        (recording.dropped ? `, ${recording.dropped} ${t("droppedMessages")}` : "")
      : ended || t("recordsHelp");
    setText(this.note, this.refusal || this.replay.over || present);
    const shown = this.replay.name;
    const key = JSON.stringify([records, recording?.name, shown]);
    if (this.list.dataset["key"] === key) return;
    this.list.dataset["key"] = key;
    this.list.replaceChildren(
      ...records
        .filter((each) => each.name !== recording?.name)
        .map((each) =>
          h(
            "li",
            {},
            h("span", {}, h("b", {}, each.name), h("small", {}, size(each.bytes))),
            button(t("watch"), () => this.replay.show(each.name), {
              "aria-label": `${t("watch")} ${each.name}`,
              disabled: each.name === shown,
            }),
          ),
        ),
    );
  }
}

/** Where one is in a record: a time bar, pause, speed. */
export function replayBar(replay: Replay): { element: HTMLElement; refresh: () => void } {
  const says = h("span", { class: "replay-says", role: "status" });
  const time = h("output", {});
  const bar = h("input", { type: "range", min: 0, step: 0.01, "aria-label": t("timeBar") });
  bar.addEventListener("input", () => replay.seek(Number(bar.value)));
  const pause = button(t("play"), () => replay.play(!replay.playing));
  const speed = h("select", { "aria-label": t("replaySpeed") });
  speed.append(...SPEEDS.map((each) => h("option", { value: each }, `×${each}`)));
  speed.addEventListener("change", () => replay.speed(Number(speed.value)));
  const arms = h("select", { "aria-label": t("arm") });
  arms.addEventListener("change", () => replay.choose(arms.value));
  const close = button(t("replayClose"), () => replay.close());
  const element = h(
    "div",
    { class: "replay-bar", hidden: true },
    says,
    h("div", { class: "row" }, pause, bar, time),
    h("div", { class: "row" }, speed, arms, close),
  );
  const refresh = () => {
    element.hidden = !replay.open;
    const about = replay.about;
    const early = about?.cut_off ? ` · ${t("cutOff")}` : "";
    const damaged = about?.damage ? ` · ${t("damaged")}` : "";
    setText(says, about ? `${t("replayShown")}${early}${damaged}` : t("reading"));
    const whole = about?.duration_s ?? 0;
    bar.max = String(whole);
    bar.value = String(replay.atS);
    bar.disabled = pause.disabled = speed.disabled = !about;
    bar.setAttribute("aria-valuetext", `${clock(replay.atS)} / ${clock(whole)}`);
    setText(time, `${clock(replay.atS)} / ${clock(whole)}`);
    setText(pause, t(replay.playing ? "pause" : "play"));
    speed.value = String(replay.rate);
    arms.hidden = replay.arms.length < 2;
    if (arms.childElementCount !== replay.arms.length) {
      arms.replaceChildren(...replay.arms.map((name) => h("option", { value: name }, name)));
    }
    if (replay.arm) arms.value = replay.arm.name;
  };
  return { element, refresh };
}
