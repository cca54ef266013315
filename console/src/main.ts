import { Arm, findArms } from "./arm.ts";
import { button, choice, fixed, h, setText, stopper } from "./dom.ts";
import { Codes } from "./codes.ts";
import { Goal } from "./goal.ts";
import { type Word, setLanguage, t } from "./i18n.ts";
import { deviceWay, quality } from "./latency.ts";
import { Link } from "./link.ts";
import { Motion } from "./motion.ts";
import { GoalPanel, shown as inWords } from "./panels/goal.ts";
import { DevicePanel } from "./panels/device.ts";
import { JogPanel } from "./panels/jog.ts";
import { PlotsPanel } from "./panels/plots.ts";
import { RecordsCard, replayBar } from "./panels/records.ts";
import { SensorsPanel } from "./panels/sensors.ts";
import { SetupPanel } from "./panels/setup.ts";
import { Replay } from "./replay.ts";
import { Rosbridge } from "./rosbridge.ts";
import type { Scene, View } from "./scene.ts";
import { loadSettings, saveSettings } from "./settings.ts";
import { giveToken, takeToken } from "./token.ts";
import { why } from "./why.ts";

/** How often what stands there in words and numbers is brought up to date. */
const REFRESH_MS = 100;

/** How often the bus is asked which arms there are. */
const LOOK_MS = 2000;

/** A page that is not drawn after so long is hidden. */
const HIDDEN_MS = 500;

/** Where no arm is found in this time the picture is made without one. */
const NO_ARM_MS = 1500;

const JOG_CHANNEL = 1;

/** How the names of pages begin, as sources of an arm. */
const PAGES = "console ";

const settings = loadSettings();
setLanguage(settings.language);
document.documentElement.lang = settings.language;
document.title = t("title");

const keep = () => {
  saveSettings(settings);
  applyTheme();
};

function applyTheme(): void {
  if (settings.theme === "auto") delete document.documentElement.dataset["theme"];
  else document.documentElement.dataset["theme"] = settings.theme;
}
applyTheme();

// -- the page -------------------------------------------------------------------------------------

const armSelect = h("select", { "aria-label": t("arm"), class: "arm-select" });
const linkChip = h("details", { class: "chip link" });
const linkText = h("span");
const linkFigures = h("dl");
linkChip.append(h("summary", {}, h("i", { class: "dot", "aria-hidden": "true" }), linkText), linkFigures);
const authorityText = h("span", { class: "who" });
const release = stopper(t("release"), () => true, () => void motion.release(), {
  title: t("releaseHelp"),
  class: "quiet",
});
const askButton = button(t("askFor"), () => motion.askFor(arm?.status?.authority ?? ""), {
  title: t("askForHelp"),
  class: "quiet",
});
const authority = h(
  "div",
  { class: "chip authority" },
  h("span", { class: "owner" }, h("span", { class: "caption" }, t("authority")), authorityText),
  release,
  askButton,
);
const requesterText = h("span");
const requester = h(
  "div",
  { class: "requester", role: "alert", hidden: true },
  requesterText,
  stopper(t("handOver"), () => true, () => void answer(true)),
  button(t("keep"), () => void answer(false)),
);
const tokenInput = h("input", { type: "password", autocomplete: "off", spellcheck: "false" });
const tokenForm = h(
  "form",
  { class: "token", hidden: true },
  h("label", { class: "field" }, h("span", {}, t("token")), tokenInput),
  h("button", { type: "submit" }, t("enter")),
);
tokenForm.addEventListener("submit", (event) => {
  event.preventDefault();
  if (tokenInput.value.trim()) giveToken(tokenInput.value.trim());
});
const whyText = h("span");
const whyLine = h("p", { class: "why", role: "status", "aria-live": "polite" }, whyText);
whyLine.addEventListener("click", () => whyLine.toggleAttribute("data-whole"));
const picture = h("div", { class: "picture" });
const readout = h("div", { class: "readout", "aria-hidden": "true" });
const stopButton = stopper("", () => true, () => void stop(), {
  class: "stop",
  "aria-keyshortcuts": "Escape",
});
const stopLabel = h("b", {}, t("stop"));
stopButton.append(stopLabel, h("kbd", { "aria-hidden": "true" }, t("stopHint")));
const enableButton = stopper(t("enable"), () => motion.holding.armed, () => void enable(), {
  class: "enable",
});

const address = new URL("/ws", location.href);
address.protocol = location.protocol === "https:" ? "wss:" : "ws:";
const token = takeToken();
if (token) address.searchParams.set("t", token);

const link = new Link(new Rosbridge(address.href));
link.name(settings.person);
const codes = new Codes(async (text) => {
  const answer = await link.ask("cardan.codes", { text: text.slice(0, 1000) });
  return answer["codes"] as string[];
});
const motion = new Motion(link);
/** Null until it is loaded, and where there is no WebGL. */
let scene: Scene | null = null;
/** Whether it is known which. */
let pictured = false;
const theScene = () => scene;
let tab: Word = "move";
let arm: Arm | null = null;
let tellArmChosen: () => void = () => {};
const armChosen = new Promise<void>((resolve) => {
  tellArmChosen = resolve;
});
let goal: Goal | null = null;

const jog = new JogPanel(motion, () => arm, theScene, settings, keep);
const goalPanel = new GoalPanel(motion, theScene, settings, keep);
const replay = new Replay(link);
const records = new RecordsCard(link, replay);
const plots = new PlotsPanel(link, records.element);
const sensors = new SensorsPanel(link, address.href, settings, keep);
const device = new DevicePanel(link, settings, keep);
const setup = new SetupPanel(link, settings, keep, (part, on) => scene?.show(part, on));

const TABS: [Word, HTMLElement][] = [
  ["move", jog.element],
  ["goal", goalPanel.element],
  ["plots", plots.element],
  ["sensors", sensors.element],
  ["device", device.element],
  ["setup", setup.element],
];
const tabList = h("div", { class: "tabs", role: "tablist" });
const panels = h("div", { class: "panels" });
for (const [word, element] of TABS) {
  element.id = `panel-${word}`;
  element.setAttribute("role", "tabpanel");
  element.setAttribute("aria-labeledby", `tab-${word}`);
  element.tabIndex = 0;
  panels.append(element);
  tabList.append(
    button(t(word), () => showTab(word), {
      id: `tab-${word}`,
      role: "tab",
      "aria-controls": `panel-${word}`,
    }),
  );
}
tabList.addEventListener("keydown", (event) => {
  const step = { ArrowLeft: -1, ArrowRight: 1 }[event.key];
  if (!step) return;
  const at = TABS.findIndex(([word]) => document.activeElement?.id === `tab-${word}`);
  const next = TABS[(at + step + TABS.length) % TABS.length];
  if (next) showTab(next[0]);
  document.getElementById(`tab-${next?.[0]}`)?.focus();
});

function showTab(chosen: Word): void {
  tab = chosen;
  gizmoBar.hidden = chosen !== "goal";
  scene?.edit(chosen === "goal");
  for (const [word, element] of TABS) {
    element.hidden = word !== chosen;
    const tab = document.getElementById(`tab-${word}`);
    tab?.setAttribute("aria-selected", String(word === chosen));
    if (tab) tab.tabIndex = word === chosen ? 0 : -1;
  }
  if (chosen === "sensors") sensors.shown();
}

const VIEWS: View[] = ["iso", "front", "side", "top"];
const viewBar = h(
  "div",
  { class: "view-bar" },
  ...VIEWS.map((view) => button(t(view), () => scene?.look(view), { class: "quiet" })),
  button(t("trail"), () => scene?.clearTrail(), { class: "quiet", title: t("clear") }),
);
const timeBar = replayBar(replay);
const gizmoBar = choice<"translate" | "rotate">(
  t("gizmo"),
  [
    ["translate", t("translation")],
    ["rotate", t("rotation")],
  ],
  "translate",
  (mode) => scene?.setGizmo(mode, mode === "rotate" ? "local" : "world"),
);
gizmoBar.classList.add("gizmo-bar");

document.body.append(
  h(
    "header",
    {},
    h("h1", {}, "Cardan"),
    armSelect,
    h("span", { class: "spring" }),
    authority,
    linkChip,
  ),
  h("div", { class: "lines" }, whyLine, tokenForm, requester),
  h(
    "main",
    {},
    h("section", { class: "view", "aria-label": t("view") }, picture, readout, h("div", { class: "view-tools" }, viewBar, gizmoBar), timeBar.element),
    h("section", { class: "controls", "aria-label": t("controls") }, tabList, panels),
  ),
  h("footer", { class: "dock" }, enableButton, stopButton),
);
showTab("move");

/** The picture comes last: what stops and moves is drawn, and has its arm, before it. */
async function makeScene(): Promise<void> {
  await Promise.all([drawn(), Promise.race([armChosen, later(NO_ARM_MS)])]);
  try {
    const { Scene } = await import("./scene.ts");
    const { Meshes } = await import("./visuals.ts");
    const made = new Scene(picture, t("picture3d"), new Meshes(token));
    made.onDrag = (pose) => goal?.setPose(pose);
    made.beforeDraw = () => {
      const shown = replay.open ? replay.arm : arm;
      if (shown) made.follow(shown);
    };
    for (const part of settings.hides) made.show(part, false);
    made.edit(tab === "goal");
    scene = made;
  } catch {
    picture.append(h("p", { class: "hint" }, t("no3d")));
  }
  pictured = true;
  const shown = replay.open ? replay.arm : arm;
  if (shown?.description) shown.onDescription();
  shown?.onState();
}
void makeScene();

/** Resolves when the browser has drawn the page; soon where it draws nothing, as it is hidden. */
function drawn(): Promise<void> {
  const frames = new Promise<void>((resolve) => {
    requestAnimationFrame(() => requestAnimationFrame(() => setTimeout(resolve)));
  });
  return Promise.race([frames, later(HIDDEN_MS)]);
}

function later(ms: number): Promise<void> {
  return new Promise((resolve) => {
    setTimeout(resolve, ms);
  });
}

// -- arms -----------------------------------------------------------------------------------------

function choose(name: string): void {
  arm?.close();
  const chosen = new Arm(link, name);
  arm = chosen;
  motion.choose(chosen);
  tellArmChosen();
  scene?.empty();
  goal = null;
  let loaded = false;
  let described = false;
  let moved = false;
  chosen.onDescription = () => {
    described = true;
    if (!replay.open) {
      scene?.load(chosen.description);
      scene?.surround(chosen);
    }
  };
  chosen.onSceneDescription = () => {
    if (!replay.open) scene?.surround(chosen);
    if (goal) goalPanel.surround();
  };
  chosen.onStop = (by) => {
    motion.stopped(by);
    device.halt();
  };
  chosen.onState = () => {
    if (replay.open) return;
    scene?.news(chosen);
    const moves = chosen.status?.moving || chosen.status?.phase === "braking";
    if (moved && !moves) goal?.rested();
    moved = Boolean(moves);
    // Sliders need the joints' names, and their limits, which the description has.
    if (loaded || !pictured || !chosen.joints || (scene && !described)) return;
    loaded = true;
    goal = new Goal(chosen, scene);
    jog.load();
    goalPanel.load(chosen, goal);
    plots.load(chosen, link);
    setup.load(chosen);
  };
  settings.arm = name;
  keep();
}

async function look(): Promise<void> {
  if (!link.bridge.live) return;
  const names = await findArms(link).catch(() => null);
  if (names === null) return;
  const shown = [...armSelect.options].map((each) => each.value);
  if (arm && !names.includes(arm.name)) names.unshift(arm.name);
  if (names.join() !== shown.join()) {
    armSelect.replaceChildren(...names.map((name) => h("option", { value: name }, name)));
  }
  armSelect.hidden = names.length === 0;
  if (!arm && names.length) {
    choose(names.includes(settings.arm) ? settings.arm : (names[0] ?? ""));
  }
  if (arm) armSelect.value = arm.name;
}
armSelect.hidden = true;
armSelect.addEventListener("change", () => choose(armSelect.value));
setInterval(() => void look(), LOOK_MS);

/** A record is shown instead of the arm: nothing of the page moves anything until it is closed. */
replay.onArm = () => {
  const { open, arm: recorded } = replay;
  document.body.toggleAttribute("data-replay", open);
  for (const panel of [jog, goalPanel, device, setup]) panel.element.inert = open;
  if (!open) {
    if (arm) choose(arm.name);
    return;
  }
  motion.disarm();
  device.stop();
  if (!recorded) return;
  let loaded = false;
  recorded.onDescription = () => {
    scene?.load(recorded.description);
    void scene?.dress(recorded);
  };
  recorded.onSceneDescription = () => void scene?.dress(recorded);
  recorded.onState = () => {
    scene?.news(recorded);
    if (loaded || !recorded.joints) return;
    loaded = true;
    plots.load(recorded, null, () => replay.atS);
  };
};
replay.onChange = () => {
  timeBar.refresh();
  records.show();
};

motion.onChange = showMotion;

/** What a person has to see at once: whether something may move, and whether it is held. */
function showMotion(): void {
  const { armed, held } = motion.holding;
  document.body.dataset["state"] = held ? "held" : armed ? "armed" : "watching";
  setText(enableButton, t(armed ? "disable" : "enable"));
  enableButton.setAttribute("aria-pressed", String(armed));
  if (scene) scene.hurried = armed;
}

// -- what moves and stops -------------------------------------------------------------------------

async function enable(): Promise<void> {
  if (motion.holding.armed) motion.disarm();
  else if (!replay.open) await motion.enable();
}

async function answer(hands: boolean): Promise<void> {
  const why = await motion.answer(hands);
  if (why) motion.refused = why;
}

let stopShown: ReturnType<typeof setTimeout> | undefined;

async function stop(): Promise<void> {
  motion.stopped("");
  device.halt();
  stopLabel.textContent = t("stopping");
  stopButton.classList.remove("failed");
  try {
    if (!arm) throw new Error(t("noArms"));
    await arm.stop();
    stopLabel.textContent = t("stopped");
  } catch {
    stopLabel.textContent = t("stopFailed");
    stopButton.classList.add("failed");
  }
  clearTimeout(stopShown);
  stopShown = setTimeout(() => {
    stopLabel.textContent = t("stop");
    stopButton.classList.remove("failed");
  }, 2500);
}

window.addEventListener("keydown", (event) => {
  if (event.key === "Escape") void stop();
});

// -- words and numbers ----------------------------------------------------------------------------

const ms = (value: number | null | undefined) =>
  value === null || value === undefined ? "–" : `${value.toFixed(value < 10 ? 1 : 0)} ms`;

let live = false;

function refresh(): void {
  if (!live && link.bridge.live) void look();
  live = link.bridge.live;
  const now = performance.now();
  const ageMs = arm ? now - arm.heardMs : Infinity;
  const median = link.roundTrips.median;
  const facts = why({
    link: link.state,
    hasToken: token !== "",
    chosen: arm !== null,
    stateAgeMs: ageMs,
    roundTripMs: link.roundTrips.recent,
    role: link.hello?.role ?? "",
    source: link.hello?.source ?? "",
    asked: motion.lease.asked,
    armed: motion.holding.armed,
    held: motion.holding.held,
    leftS: link.inputs.get(JOG_CHANNEL)?.left_s ?? null,
    ended: motion.holding.ended,
    stoppedBy: motion.stoppedBy,
    refused: motion.refused,
    snapshot: arm?.snapshot ?? null,
    status: arm?.status ?? null,
  });
  const told = facts.level === "warn" || facts.level === "bad" ? codes.shown(facts.text) : facts.text;
  setText(whyText, replay.open ? t("replayWhy") : told);
  whyLine.dataset["level"] = replay.open ? "note" : facts.level;

  linkChip.dataset["quality"] = link.state === "live" ? quality(median, ageMs) : "bad";
  setText(linkText, link.state === "live" ? ms(median) : t("link"));
  if (linkChip.open) showFigures(ageMs);
  showAuthority();

  tokenForm.hidden = link.state !== "refused";

  showMotion();
  document.body.dataset["link"] = link.state;
  enableButton.disabled = replay.open || !arm || link.state !== "live" || link.hello?.role === "viewer";

  showReadout();
  for (const panel of [jog, goalPanel, sensors, device, setup]) {
    if (!panel.element.hidden) panel.refresh();
  }
}

function showFigures(ageMs: number): void {
  const input = link.inputs.get(JOG_CHANNEL);
  const p99 = arm?.snapshot?.loop?.tick_p99_s;
  const dropped = link.dropped + Object.values(input?.dropped ?? {}).reduce((a, b) => a + b, 0);
  const rows: [Word, string][] = [
    ["roundTrip", ms(link.roundTrips.median)],
    ["worst", ms(link.roundTrips.worst)],
    ["stateAge", Number.isFinite(ageMs) ? ms(ageMs) : "–"],
    ["inputRate", input ? `${input.rate_hz.toFixed(0)} 1/s` : "–"],
    ["dropped", String(dropped)],
    ["cycleP99", ms(p99 === null || p99 === undefined ? null : 1000 * p99)],
  ];
  const way = deviceWay(arm?.snapshot?.device?.metrics ?? {});
  if (way) rows.push(["deviceWay", way]);
  if (linkFigures.childElementCount !== 2 * rows.length) {
    linkFigures.replaceChildren(...rows.flatMap(([word]) => [h("dt", {}, t(word)), h("dd")]));
  }
  linkFigures.querySelectorAll("dd").forEach((each, index) => setText(each, rows[index]?.[1] ?? ""));
}

function showAuthority(): void {
  const owner = arm?.status?.authority ?? "";
  const own = owner !== "" && owner === link.hello?.source;
  const since = arm?.snapshot?.arm?.authority_s;
  const time = owner && since ? ` · ${since.toFixed(0)} s` : "";
  const who = (own ? t("you") : owner || t("nobody")) + time;
  setText(authorityText, who);
  authorityText.title = who;
  authority.dataset["owner"] = own ? "own" : owner ? "other" : "nobody";
  release.hidden = !own;
  const { lease } = motion;
  // Others are no people who could answer: a device lets go, and a program ends.
  askButton.hidden = own || !owner.startsWith(PAGES) || link.hello?.role === "viewer";
  askButton.disabled = lease.asked === "waiting";
  setText(askButton, lease.asked ? t(`asked_${lease.asked}`) : t("askFor"));
  requester.hidden = lease.requester === "";
  if (lease.requester) setText(requesterText, `${lease.requester} ${t("asksForIt")}`);
}

function showReadout(): void {
  const shown = replay.open ? replay.arm : arm;
  const lines: string[] = [];
  if (shown?.measured) {
    const [x, y, z, ...turn] = inWords(shown.measured).map((each) => fixed(each, 1));
    const [roll, pitch, yaw] = turn;
    lines.push(`X ${x} mm   Y ${y} mm   Z ${z} mm`, `Roll ${roll}°   Pitch ${pitch}°   Yaw ${yaw}°`);
  }
  const clearance = shown?.snapshot?.arm?.clearance_m;
  if (clearance !== null && clearance !== undefined) {
    lines.push(`${t("clearance")} ${(1000 * clearance).toFixed(0)} mm`);
  }
  setText(readout, lines.join("\n"));
}

setInterval(refresh, REFRESH_MS);
refresh();
