import { CameraView } from "../camera.ts";
import { Chart, save } from "../chart.ts";
import { button, h, section, setText } from "../dom.ts";
import { OperatorDevice } from "../operator_device.ts";
import { t } from "../i18n.ts";
import type { Link } from "../link.ts";
import { PhoneSensors } from "../phone.ts";
import { freshness } from "../picture_age.ts";
import { Recording } from "../recording.ts";
import { type Quantity, SENSORS } from "../sensor.ts";
import type { Settings } from "../settings.ts";
import { Sound, say } from "../sound.ts";

/** The channel of the phone's own sensors. */
const CHANNEL = 7;

const AGES = { fresh: "pictureAge", old: "pictureOld", gone: "pictureGone" } as const;

const SAMPLE_MS = 20;
const DRAW_MS = 100;

/** How often it is looked which sensors and cameras there are, while they can be seen. */
const LOOK_MS = 3000;

/** Sensors on the bus, this phone as one of them, cameras, and sound. */
export class SensorsPanel {
  readonly element: HTMLElement;
  private readonly link: Link;
  private readonly settings: Settings;
  private readonly keep: () => void;
  private readonly refreshes: (() => void)[] = [];
  private readonly looks: (() => Promise<void>)[] = [];

  /** `address`: of the server's socket. */
  constructor(link: Link, address: string, settings: Settings, keep: () => void) {
    [this.link, this.settings, this.keep] = [link, settings, keep];
    this.element = h(
      "div",
      { class: "panel" },
      this.plots(),
      this.camera(address),
      this.phone(),
      this.sound(),
    );
    setInterval(() => {
      if (this.element.offsetParent && link.state === "live") {
        for (const look of this.looks) void look().catch(() => {});
      }
    }, LOOK_MS);
  }

  /** It has come into sight. */
  shown(): void {
    if (this.link.state === "live") for (const look of this.looks) void look().catch(() => {});
  }

  refresh(): void {
    for (const each of this.refreshes) each();
  }

  private plots(): HTMLElement {
    const select = h("select", { "aria-label": t("sensors") });
    const chart = new Chart(select);
    const note = h("p", { class: "hint", role: "status" }, t("sensorsNone"));
    let chosen = "";
    let recording: Recording | null = null;
    let end = () => {};
    const choose = (value: string) => {
      end();
      chosen = value;
      const [topic = "", type = "", key = ""] = value.split(" ");
      const quantity = SENSORS[type]?.find((each) => each.key === key);
      if (!quantity) return;
      const kept = new Recording(quantity.names);
      recording = kept;
      end = this.link.bridge.subscribe(
        topic,
        type,
        (message) => kept.add(performance.now() / 1000, quantity.values(message)),
        SAMPLE_MS,
      );
      chart.show(kept, key, `${t(quantity.label)} · ${topic}`);
    };
    select.addEventListener("change", () => choose(select.value));
    const option = (topic: string, type: string, { key, label }: Quantity) =>
      h("option", { value: `${topic} ${type} ${key}` }, `${topic} · ${t(label)}`);
    this.looks.push(async () => {
      const found: HTMLOptionElement[] = [];
      for (const [type, quantities] of Object.entries(SENSORS)) {
        const { topics } = await this.link.bridge.call("/rosapi/topics_for_type", { type });
        for (const topic of [...(topics as string[])].sort()) {
          found.push(...quantities.map((each) => option(topic, type, each)));
        }
      }
      const values = found.map((each) => each.value);
      // What is drawn stays in the list though nobody publishes it any more.
      if (chosen && !values.includes(chosen)) {
        found.unshift(h("option", { value: chosen }, chosen.split(" ")[0]));
        values.unshift(chosen);
      }
      if (values.join() !== [...select.options].map((each) => each.value).join()) {
        select.replaceChildren(...found);
        select.value = chosen;
      }
      note.hidden = found.length > 0;
      if (!chosen && values[0]) {
        choose(values[0]);
        select.value = values[0];
      }
    });
    setInterval(() => {
      if (recording && this.element.offsetParent) chart.draw();
    }, DRAW_MS);
    return section("sensors", note, chart.element);
  }

  private camera(address: string): HTMLElement {
    const image = h("img", { class: "camera", alt: t("cameraPicture") });
    const age = h("figcaption", {});
    const figure = h("figure", { class: "sight", hidden: true }, image, age);
    const note = h("p", { class: "hint", role: "status" });
    const select = h("select", { "aria-label": t("camera"), hidden: true });
    const view = new CameraView(address, image);
    view.onSay = (why) => setText(note, why);
    const start = button(t("start"), () => {
      if (view.open) view.stop();
      else {
        setText(note, "");
        view.start(Number(select.value));
      }
    });
    select.addEventListener("change", () => {
      if (view.open) view.start(Number(select.value));
    });
    this.looks.push(async () => {
      const { cameras } = await this.link.ask("cardan.camera", { do: "list" });
      const names = cameras as string[];
      if (select.childElementCount !== names.length) {
        select.replaceChildren(...names.map((name, value) => h("option", { value }, name)));
      }
      select.hidden = names.length < 1;
      if (!names.length) setText(note, t("cameraNone"));
      else if (note.textContent === t("cameraNone")) setText(note, "");
    });
    this.refreshes.push(() => {
      setText(start, t(view.open ? "finish" : "start"));
      start.disabled = !view.open && select.childElementCount === 0;
      figure.hidden = !view.open;
      const seconds = view.ageMs / 1000;
      const fresh = freshness(view.ageMs);
      figure.dataset.age = fresh;
      const digits = fresh === "gone" ? 0 : fresh === "old" ? 1 : 2;
      setText(age, `${t(AGES[fresh])} ${seconds.toFixed(digits)} s`);
    });
    document.addEventListener("visibilitychange", () => {
      if (document.visibilityState === "hidden") view.stop();
    });
    return section("camera", h("div", { class: "row" }, select, start), note, figure);
  }

  /** The sensors of this device, published while its person asks for that. */
  private phone(): HTMLElement {
    const sensors = new PhoneSensors();
    const device = new OperatorDevice(CHANNEL, this.link, () => sensors.body());
    const note = h("p", { class: "hint", role: "status" }, t("imuHelp"));
    const end = () => {
      device.stop();
      sensors.stop();
      setText(note, t("imuHelp"));
    };
    const begin = async () => {
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
      const why = await device.start({ imu: this.settings.imuTopic });
      if (!why) return;
      sensors.stop();
      setText(note, why);
    };
    const start = button(t("publish"), () => void (device.open ? end() : begin()));
    const topic = h("input", { type: "text", value: this.settings.imuTopic, spellcheck: "false" });
    topic.addEventListener("change", () => {
      this.settings.imuTopic = topic.value;
      this.keep();
    });
    this.refreshes.push(() => {
      setText(start, t(device.open ? "finish" : "publish"));
      start.setAttribute("aria-pressed", String(device.open));
      const input = this.link.inputs.get(CHANNEL);
      if (device.open && input) {
        setText(note, `${this.settings.imuTopic} · ${t("inputRate")} ${input.rate_hz.toFixed(0)} 1/s`);
      }
    });
    return section(
      "imu",
      h("label", { class: "field" }, h("span", {}, t("imuTopic")), topic),
      h("div", { class: "row" }, start),
      note,
    );
  }

  private sound(): HTMLElement {
    const sound = new Sound();
    const note = h("p", { class: "hint", role: "status" });
    const tell = (error: unknown) => setText(note, `${t("soundNot")}: ${(error as Error).message}`);
    const file = h("input", { type: "file", accept: "audio/*", "aria-label": t("soundFile") });
    const play = button(t("play"), () => {
      if (sound.plays) {
        sound.silence();
        return;
      }
      setText(note, "");
      const chosen = file.files?.[0] ?? sound.recorded;
      if (chosen) sound.play(chosen).catch(tell);
    });
    const record = button(t("soundRecord"), () => {
      setText(note, "");
      if (sound.records) sound.finish();
      else sound.record().catch(tell);
    });
    const keep = button(t("save"), () => {
      if (sound.recorded) save(sound.recorded, `cardan-sound.${ending(sound.recorded.type)}`);
    });
    file.addEventListener("change", () => sound.onChange());
    sound.onChange = () => {
      const { plays, records, recorded } = sound;
      setText(play, t(plays ? "finish" : "play"));
      play.disabled = !plays && !recorded && !file.files?.length;
      setText(record, t(records ? "finish" : "soundRecord"));
      record.setAttribute("aria-pressed", String(records));
      keep.disabled = !recorded;
    };
    sound.onChange();
    record.disabled = !Sound.canRecord;
    const text = h("input", { type: "text", "aria-label": t("sayText"), value: "" });
    const speak = button(t("say"), () => {
      if (text.value) say(text.value, document.documentElement.lang);
    });
    speak.disabled = text.disabled = !Sound.canSpeak;
    const missing = [!Sound.canRecord && t("noMicrophone"), !Sound.canSpeak && t("noSpeech")];
    setText(note, missing.filter(Boolean).join(" "));
    return section(
      "sound",
      file,
      h("div", { class: "row" }, play, record, keep),
      h("div", { class: "row" }, text, speak),
      note,
    );
  }
}

/** "webm" of "audio/webm;codecs=opus". */
export function ending(type: string): string {
  return /^audio\/([a-z0-9]+)/.exec(type)?.[1] ?? "audio";
}
