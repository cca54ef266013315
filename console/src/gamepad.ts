import type { Body } from "./frames.ts";

/** The button that has to be held: the left shoulder of the standard mapping. */
const DEAD_MAN = 4;
const LEFT_TRIGGER = 6;
const RIGHT_TRIGGER = 7;

/** The first pad with the standard mapping; browsers show none before a button of it was pressed. */
export function findPad(): Gamepad | null {
  return navigator.getGamepads?.().find((pad) => pad?.connected && pad.mapping === "standard") ?? null;
}

export function isHeld(pad: Gamepad): boolean {
  return pad.buttons[DEAD_MAN]?.pressed ?? false;
}

export function padBody(pad: Gamepad): Body {
  const [leftRight = 0, leftDown = 0, rightRight = 0, rightDown = 0] = pad.axes;
  let buttons = 0;
  pad.buttons.forEach((button, bit) => {
    if (button.pressed && bit < 32) buttons |= 1 << bit;
  });
  return {
    kind: "gamepad",
    sticks: [leftRight, leftDown, rightRight, rightDown],
    leftTrigger: pad.buttons[LEFT_TRIGGER]?.value ?? 0,
    rightTrigger: pad.buttons[RIGHT_TRIGGER]?.value ?? 0,
    buttons: buttons >>> 0,
  };
}
