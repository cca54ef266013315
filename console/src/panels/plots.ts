import type { Arm } from "../arm.ts";
import { Chart } from "../chart.ts";
import { h } from "../dom.ts";
import { Histogram, between, spread } from "../histogram.ts";
import { type Word, t } from "../i18n.ts";
import type { Link } from "../link.ts";
import { Recording } from "../recording.ts";
import { DEGREE, norm, rotationVector, subtract } from "../spatial.ts";
import { shorter } from "./jog.ts";

/** Upper bounds of the snapshot's histograms, ms. */
const WITHIN_MS = [0.25, 0.5, 1, 2, 4, 8, 16, 32, 50];

/** Of round trips. */
const ROUND_MS = [1, 2, 5, 10, 20, 50, 100, 200, 300];

const SAMPLE_MS = 50;
const DRAW_MS = 100;

/** Channels of a page's frames, as motion.ts and panels/device.ts number them. */
const CHANNELS = ["jog", "phone", "pad", "XR left", "XR right", "XR"];

/** What is drawn over time; `link`: null while a record is shown, which has no connection. */
type Kind = {
  word: Word;
  names: (arm: Arm) => string[];
  values: (arm: Arm, link: Link | null) => (number | null | undefined)[];
};

const ms = (seconds: number | null | undefined) =>
  seconds === null || seconds === undefined ? null : 1000 * seconds;

const KINDS: Record<string, Kind> = {
  joints: {
    word: "plotJoints",
    names: (arm) => (arm.joints?.names ?? []).map(shorter),
    values: (arm) => (arm.joints?.positions ?? []).map((each) => each / DEGREE),
  },
  rates: {
    word: "plotRates",
    names: (arm) => (arm.joints?.names ?? []).map(shorter),
    values: (arm) => (arm.joints?.velocities ?? []).map((each) => each / DEGREE),
  },
  tcp: {
    word: "plotTcp",
    names: () => ["x", "y", "z"],
    values: (arm) => (arm.measured?.position ?? []).map((each) => 1000 * each),
  },
  turn: {
    word: "plotTurn",
    names: () => ["rx", "ry", "rz"],
    values: ({ measured }) =>
      measured ? rotationVector(measured.orientation).map((each) => each / DEGREE) : [],
  },
  speed: {
    word: "plotSpeed",
    names: () => ["x", "y", "z", "|v|"],
    values: ({ twist }) =>
      twist ? [...twist.linear, norm(twist.linear)].map((each) => 1000 * each) : [],
  },
  error: {
    word: "plotError",
    names: () => ["ex", "ey", "ez", "|e|"],
    values: ({ measured, commanded, status }) => {
      if (!measured || !commanded || !status?.moving) return [0, 0, 0, 0];
      const error = subtract(commanded.position, measured.position);
      return [...error, norm(error)].map((each) => 1000 * each);
    },
  },
  force: {
    word: "plotForce",
    names: () => ["Fx", "Fy", "Fz", "|F|"],
    values: ({ wrench }) => (wrench ? [...wrench.force, norm(wrench.force)] : []),
  },
  torque: {
    word: "plotTorque",
    names: () => ["Mx", "My", "Mz"],
    values: ({ wrench }) => (wrench ? [...wrench.torque] : []),
  },
  axes: {
    word: "plotAxes",
    names: () => ["1", "2", "3", "4", "5", "6"],
    values: (arm) => arm.snapshot?.device?.axes ?? [],
  },
  cycle: {
    word: "plotCycleTime",
    names: () => ["p50", "p99"],
    values: ({ snapshot }) => [ms(snapshot?.loop?.tick_p50_s), ms(snapshot?.loop?.tick_p99_s)],
  },
  round: {
    word: "plotRound",
    names: () => ["ms"],
    values: (_arm, link) => [link?.roundTrips.newest],
  },
  input: {
    word: "plotInput",
    names: () => CHANNELS,
    values: (_arm, link) => CHANNELS.map((_, index) => link?.inputs.get(index + 1)?.rate_hz),
  },
  inputAge: {
    word: "plotInputAge",
    names: () => CHANNELS,
    values: (_arm, link) => CHANNELS.map((_, index) => link?.inputs.get(index + 1)?.age_ms),
  },
};

/** A chosen figure of the last minutes, and the histograms of times. */
export class PlotsPanel {
  readonly element: HTMLElement;
  private readonly chart: Chart;
  private readonly cycles = new Histogram(WITHIN_MS, "ms");
  private readonly ages = new Histogram(WITHIN_MS, "ms");
  private readonly rounds = new Histogram(ROUND_MS, "ms");
  private recordings = new Map<string, Recording>();
  private chosen = "joints";
  private arm: Arm | null = null;
  /** The time of what is shown, s: the page's, or a record's. */
  private clockS: () => number = () => performance.now() / 1000;
  private link: Link | null;

  /** `below`: further cards. */
  constructor(link: Link, ...below: HTMLElement[]) {
    this.link = link;
    const select = h("select", { "aria-label": t("plots") });
    for (const [key, kind] of Object.entries(KINDS)) {
      select.append(h("option", { value: key }, t(kind.word)));
    }
    select.addEventListener("change", () => {
      this.chosen = select.value;
      this.build();
    });
    this.chart = new Chart(select);
    const card = (word: Word, histogram: Histogram) =>
      h("section", { class: "card" }, h("h2", {}, t(word)), histogram.element);
    this.element = h(
      "div",
      { class: "panel" },
      h("section", { class: "card" }, this.chart.element),
      ...below,
      card("plotCycle", this.cycles),
      card("plotAges", this.ages),
      card("plotRounds", this.rounds),
    );
    setInterval(() => this.sample(), SAMPLE_MS);
    setInterval(() => this.draw(), DRAW_MS);
  }

  /** Show an arm from now on. `link`, `clockS`: see there; those of a record are others. */
  load(arm: Arm, link: Link | null = null, clockS: (() => number) | null = null): void {
    this.arm = arm;
    this.link = link;
    this.clockS = clockS ?? (() => performance.now() / 1000);
    this.recordings = new Map(
      Object.entries(KINDS).map(([key, kind]) => [key, new Recording(kind.names(arm))]),
    );
    this.build();
  }

  private sample(): void {
    const { arm, link } = this;
    if (!arm) return;
    const now = this.clockS();
    for (const [key, kind] of Object.entries(KINDS)) {
      this.recordings.get(key)?.add(now, kind.values(arm, link));
    }
  }

  private build(): void {
    const kind = KINDS[this.chosen];
    this.chart.show(this.recordings.get(this.chosen) ?? null, this.chosen, kind ? t(kind.word) : "");
  }

  private draw(): void {
    if (this.element.offsetParent === null) return;
    this.chart.draw();
    const loop = this.arm?.snapshot?.loop;
    this.cycles.draw(between(loop?.tick_within ?? [], loop?.cycles ?? 0));
    this.ages.draw(between(loop?.input_age_within ?? [], loop?.inputs ?? 0));
    this.rounds.draw(spread(this.link?.roundTrips.all ?? [], ROUND_MS));
  }
}
