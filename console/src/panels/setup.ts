import type { Arm } from "../arm.ts";
import { check, choice, h, section, setText } from "../dom.ts";
import { LANGUAGES, type Language, parameterWord, t } from "../i18n.ts";
import type { Link } from "../link.ts";
import { ProgramsPanel } from "./programs.ts";
import { LONGEST_PERSON, PARTS, type Part, type Settings, type Theme } from "../settings.ts";

/** rcl_interfaces/ParameterType of those that are set here. */
const [DOUBLE, TEXT] = [3, 4];

type Value = { type: number; double_value: number; string_value: string };
type Descriptor = {
  name: string;
  type: number;
  description: string;
  additional_constraints: string;
  floating_point_range: { from_value: number; to_value: number }[];
};

/** Parameters of the arm with their ranges, and how the page looks. */
export class SetupPanel {
  readonly element: HTMLElement;
  private readonly parameters = h("div", { class: "parameters" });
  private readonly server = h("p", { class: "hint" });
  private readonly told = h("p", { class: "hint told" });
  private readonly toldCard = section("robotTold", this.told);
  private readonly link: Link;
  private arm: Arm | null = null;

  constructor(
    link: Link,
    settings: Settings,
    changed: () => void,
    show: (part: Part, on: boolean) => void,
  ) {
    this.link = link;
    const person = h("input", {
      type: "text",
      maxlength: LONGEST_PERSON,
      value: settings.person,
      autocomplete: "nickname",
      title: t("personHelp"),
    });
    person.addEventListener("change", () => {
      settings.person = person.value.trim();
      changed();
      link.name(settings.person);
    });
    this.element = h(
      "div",
      { class: "panel" },
      section("parameters", this.parameters),
      ...new ProgramsPanel(link).elements,
      section(
        "appearance",
        h("label", { class: "field" }, t("person"), person),
        choice<Language>(
          t("language"),
          Object.entries(LANGUAGES) as [Language, string][],
          settings.language,
          (value) => {
            settings.language = value;
            changed();
            location.reload();
          },
        ),
        choice<Theme>(
          t("theme"),
          [
            ["auto", t("auto")],
            ["light", t("light")],
            ["dark", t("dark")],
          ],
          settings.theme,
          (value) => {
            settings.theme = value;
            changed();
          },
        ),
      ),
      section(
        "shown",
        ...PARTS.map((part) =>
          check(t(`shown_${part}`), !settings.hides.includes(part), (on) => {
            settings.hides = PARTS.filter((each) => (each === part ? !on : settings.hides.includes(each)));
            changed();
            show(part, on);
          }),
        ),
      ),
      section("server", this.server),
      this.toldCard,
    );
  }

  load(arm: Arm): void {
    this.arm = arm;
    void this.read(arm);
  }

  refresh(): void {
    this.showTold();
    const hello = this.link.hello;
    setText(
      this.server,
      hello ? `Cardan ${hello.version} · ${t("role")} ${hello.role} · ${hello.source}` : "–",
    );
  }

  /** What is told of a robot that may be ready keeps nothing from moving: it is not the reason line's. */
  private showTold(): void {
    const around = this.arm?.sceneDescription;
    const parts = [around?.links_without_body ?? "", around?.visuals_left_out ?? ""];
    const told = [...parts, ...(this.arm?.snapshot?.diagnosis ?? [])].filter(Boolean);
    this.toldCard.hidden = told.length === 0;
    setText(this.told, told.join("\n"));
  }

  private async read(arm: Arm): Promise<void> {
    const call = this.link.bridge.call.bind(this.link.bridge);
    try {
      const listed = await call(`${arm.name}/list_parameters`, {});
      const { names } = listed["result"] as { names: string[] };
      const told = await call(`${arm.name}/describe_parameters`, { names });
      const present = await call(`${arm.name}/get_parameters`, { names });
      if (arm !== this.arm) return;
      const values = present["values"] as Value[];
      this.parameters.replaceChildren(
        ...(told["descriptors"] as Descriptor[]).map((each, index) =>
          this.row(arm, each, values[index]),
        ),
      );
    } catch (error) {
      this.parameters.replaceChildren((error as Error).message);
    }
  }

  private row(arm: Arm, about: Descriptor, value: Value | undefined): HTMLElement {
    const note = h("span", { class: "hint", role: "status" });
    const range = about.floating_point_range[0];
    const input =
      about.type === TEXT
        ? h("select", {}, ...options(about, value?.string_value ?? ""))
        : h("input", {
            type: "number",
            inputmode: "decimal",
            step: "any",
            min: range?.from_value ?? null,
            max: range?.to_value ?? null,
            value: value?.double_value ?? "",
          });
    input.addEventListener("change", () => void this.set(arm, about, input.value, note));
    const limits = range ? `${range.from_value} … ${range.to_value}` : about.additional_constraints;
    return h(
      "label",
      { class: "parameter", title: hint(about) },
      h("span", {}, h("b", {}, inWords(about)), h("small", {}, about.name)),
      h("span", { class: "parameter-value" }, input, h("small", {}, about.type === TEXT ? "" : limits), note),
    );
  }

  private async set(arm: Arm, about: Descriptor, text: string, note: HTMLElement): Promise<void> {
    const value =
      about.type === TEXT
        ? { type: TEXT, string_value: text }
        : { type: DOUBLE, double_value: Number(text) };
    try {
      const answer = await arm.setParameters([{ name: about.name, value }]);
      const [result] = answer["results"] as { successful: boolean; reason: string }[];
      setText(note, result?.successful ? "✓" : (result?.reason ?? "?"));
    } catch (error) {
      setText(note, (error as Error).message);
    }
  }
}

/** Its name in words, with its unit, which ends its description. */
function inWords({ name, description }: Descriptor): string {
  const unit = /, ((?:m|rad|ms|s)(?:\/s[²³]?)?)$/.exec(description)?.[1];
  const word = parameterWord(name) ?? name.replaceAll("_", " ");
  return unit ? `${word}, ${unit}` : word;
}

function hint({ name, description, additional_constraints: allowed }: Descriptor): string {
  return [`${name}: ${description}`, allowed].filter(Boolean).join("; ");
}

/** The words that the constraints of a parameter name: "one of base, tcp". */
function options(about: Descriptor, present: string): HTMLOptionElement[] {
  const words = about.additional_constraints.replace(/^one of /, "").split(", ");
  return words.map((word) => h("option", { value: word, selected: word === present }, word));
}
