import assert from "node:assert/strict";
import { beforeEach, mock, test } from "node:test";
import { stopper } from "../src/dom.ts";

class FakeElement extends EventTarget {
  setAttribute(): void {}
  append(): void {}
}

/** As a browser says it, as far as a button reads it. */
function event(type: string, fields: object): Event {
  return Object.assign(new Event(type), fields);
}

let armed = true;
let pressed = 0;
let button: EventTarget;

/** A button that disarms at the press and arms at the click, as Disable and Enable do. */
beforeEach(() => {
  mock.timers.reset();
  mock.timers.enable({ apis: ["setTimeout"] });
  Object.assign(globalThis, {
    window: new EventTarget(),
    document: { createElement: () => new FakeElement() },
  });
  [armed, pressed] = [true, 0];
  button = stopper("", () => armed, () => {
    pressed++;
    armed = !armed;
  }) as unknown as EventTarget;
});

const down = (pointerId = 1) => button.dispatchEvent(event("pointerdown", { pointerId }));
const up = (pointerId = 1) => window.dispatchEvent(event("pointerup", { pointerId }));
const click = (detail = 1) => button.dispatchEvent(event("click", { detail }));

test("a press that disarms acts when the pointer goes down, and its click does nothing", () => {
  down();
  assert.deepEqual([armed, pressed], [false, 1]);
  up();
  click();
  assert.deepEqual([armed, pressed], [false, 1]);
  down();
  assert.equal(armed, false, "what begins waits for the click");
  up();
  click();
  assert.equal(armed, true);
});

test("the press that disarmed is not undone by its own click, however late it comes", () => {
  down();
  // Dragged off the button, and back, and let go after a while.
  mock.timers.tick(3000);
  up();
  click();
  assert.deepEqual([armed, pressed], [false, 1]);
});

test("let go elsewhere, without a click, the next click counts", () => {
  down();
  up();
  mock.timers.tick(600);
  click();
  assert.equal(armed, true);
});

test("a second finger on it does not make the first one's click enable", () => {
  down(1);
  down(2);
  up(2);
  mock.timers.tick(600);
  up(1);
  click();
  assert.deepEqual([armed, pressed], [false, 1]);
});

test("a key's click counts, also right after a press", () => {
  down();
  up();
  click(0);
  assert.equal(armed, true);
});
