import { button, h, section, setText } from "../dom.ts";
import { t } from "../i18n.ts";
import type { Link, Order } from "../link.ts";

/** How long a button that stops something waits for the second press. */
const SURE_MS = 3000;

/** How often a demo that runs is asked after. */
const LOOK_MS = 1500;

/** A session or a server of the daemon, as `cardan daemon ps --json` has it. */
export type Unit = {
  name: string;
  kind: string;
  state: string;
  since_s: number;
  reason: string;
  why?: string;
  phase?: string;
  authority?: string;
  server?: string;
  endpoint?: string;
};

/** What the doctor found, worst first; docs/troubleshooting.md. */
type Finding = { level: string; group: string; code: string; what: string; why: string; mend: string };

type Demos = {
  demos: { name: string; what: string }[];
  name: string;
  running: boolean;
  seconds?: number;
  said: string[];
};

/** Seconds as people say them: 40 s, 5 min, 3 h. */
export function span(seconds: number): string {
  if (seconds < 120) return `${Math.round(seconds)} s`;
  return seconds < 7200 ? `${Math.round(seconds / 60)} min` : `${Math.round(seconds / 3600)} h`;
}

/** What there is to say of a session or a server, in one line. */
export function about(unit: Unit): string {
  const runs = unit.state === "running";
  return [
    unit.kind === "server" ? `server ${unit.server ?? ""}`.trim() : unit.kind,
    `${unit.state} ${span(unit.since_s)}`,
    runs ? unit.phase : "",
    runs && unit.authority ? `${t("authority")}: ${unit.authority}` : "",
    unit.reason || unit.why,
    runs ? unit.endpoint : "",
  ]
    .filter(Boolean)
    .join(" · ");
}

/** What the server's daemon runs, its demos, and what its doctor says. Nothing is asked unless one
 * wants it: each answer costs the server a process. */
export class ProgramsPanel {
  readonly elements: HTMLElement[];
  private readonly list = h("ul", { class: "rows" });
  private readonly note = h("p", { class: "hint", role: "status" });
  private readonly link: Link;

  constructor(link: Link) {
    this.link = link;
    this.elements = [
      section(
        "programs",
        h("div", { class: "row" }, button(t("list"), () => void this.show())),
        this.note,
        this.list,
      ),
      this.demos(),
      this.doctor(),
    ];
  }

  private async show(): Promise<void> {
    const units = await asked(this.note, () => this.link.order("list"));
    if (!Array.isArray(units)) return;
    if (!units.length) setText(this.note, t("programsNone"));
    this.list.replaceChildren(...(units as Unit[]).map((unit) => this.row(unit)));
  }

  private row(unit: Unit): HTMLElement {
    const order = (what: Order) => () =>
      void asked(this.note, () => this.link.order(what, unit.name)).then((done) =>
        done === null ? undefined : this.show(),
      );
    const runs = unit.state === "running" || unit.state === "waiting";
    return h(
      "li",
      { "data-state": unit.state },
      h("span", {}, h("b", {}, unit.name), h("small", {}, about(unit))),
      runs ? twice(t("finish"), order("stop")) : button(t("start"), order("start")),
      runs ? twice(t("restart"), order("restart")) : null,
    );
  }

  private demos(): HTMLElement {
    const select = h("select", { "aria-label": t("demos"), hidden: true });
    const what = h("p", { class: "hint" });
    const note = h("p", { class: "hint", role: "status" }, t("demosHelp"));
    const said = h("pre", { class: "said", hidden: true, tabindex: 0 });
    let table: Demos | null = null;
    let asking = false;
    const describe = () =>
      setText(what, table?.demos.find((each) => each.name === select.value)?.what ?? "");
    const ask = async (order: "list" | "start" | "stop") => {
      asking = true;
      const found = await asked(note, () =>
        this.link.ask("cardan.demo", { do: order, name: select.value }),
      );
      asking = false;
      if (found !== null) show(found as unknown as Demos);
    };
    const show = (found: Demos) => {
      table = found;
      if (!select.childElementCount) {
        select.append(...found.demos.map(({ name }) => h("option", { value: name }, name)));
        select.value = found.name || (found.demos[0]?.name ?? "");
        select.hidden = false;
      }
      describe();
      setText(start, t(found.running ? "finish" : "start"));
      const present = found.running ? `${found.name} · ${span(found.seconds ?? 0)}` : "";
      setText(note, present || t("demosHelp"));
      said.hidden = !found.said.length;
      setText(said, found.said.join("\n"));
      said.scrollTop = said.scrollHeight;
    };
    const start = button(t("list"), () => {
      void ask(!table ? "list" : table.running ? "stop" : "start");
    });
    select.addEventListener("change", describe);
    setInterval(() => {
      if (table?.running && !asking && start.offsetParent) void ask("list");
    }, LOOK_MS);
    return section("demos", h("div", { class: "row" }, select, start), what, note, said);
  }

  private doctor(): HTMLElement {
    const note = h("p", { class: "hint", role: "status" });
    const findings = h("ul", { class: "rows" });
    const examine = async () => {
      const report = await asked(note, () => this.link.order("doctor"));
      if (!report) return;
      const found = (report as { findings: Finding[] }).findings;
      const amiss = found.filter((each) => each.level !== "good").length;
      setText(note, amiss ? `${amiss} ${t("toMend")}` : t("allWell"));
      findings.replaceChildren(
        ...found.map((each) =>
          h(
            "li",
            { "data-level": each.level },
            h("i", { class: "mark-of", "aria-hidden": "true" }, each.level === "good" ? "✓" : "!"),
            h(
              "span",
              {},
              h("b", {}, each.what),
              h("small", {}, [each.level, each.group, each.why].filter(Boolean).join(" · ")),
              each.mend ? h("code", {}, each.mend) : null,
            ),
          ),
        ),
      );
    };
    return section(
      "doctor",
      h("div", { class: "row" }, button(t("examine"), () => void examine())),
      note,
      findings,
    );
  }
}

/** Its answer; null where it was refused, which the note tells. */
async function asked(note: HTMLElement, ask: () => Promise<unknown>): Promise<unknown> {
  setText(note, t("asking"));
  try {
    const result = await ask();
    setText(note, typeof result === "string" ? result : "");
    return result;
  } catch (error) {
    setText(note, (error as Error).message);
    return null;
  }
}

/** A button that acts when it is pressed a second time. */
function twice(label: string, press: () => void): HTMLButtonElement {
  let waits: ReturnType<typeof setTimeout> | undefined;
  const calm = () => {
    waits = undefined;
    element.textContent = label;
  };
  const element = button(label, () => {
    if (waits !== undefined) {
      clearTimeout(waits);
      calm();
      press();
      return;
    }
    element.textContent = t("sure");
    waits = setTimeout(calm, SURE_MS);
  });
  return element;
}
