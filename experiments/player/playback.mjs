// Time: which step is shown, and how it moves on.

import { clamp } from "./format.mjs";

export class Playback {
  /** `onChange` is called whenever the step, or whether it plays, has changed. */
  constructor(steps, stepSeconds, onChange) {
    Object.assign(this, { steps, stepSeconds, onChange });
    this.step = 0;
    this.speed = 1;
    this.isPlaying = false;
  }

  /** Show a step. */
  seek(step) {
    this.step = clamp(Math.round(step), 0, this.steps);
    this.progress = this.step;
    this.onChange();
  }

  /** Show a step that lies some steps away, and stop there. */
  move(steps) {
    this.pause();
    this.seek(this.step + steps);
  }

  toggle() {
    if (this.isPlaying) this.pause();
    else this.play();
  }

  /** Play on; from the start if the end is reached. */
  play() {
    this.isPlaying = true;
    this.seek(this.step === this.steps ? 0 : this.step);
    this.lastTime = null;
    requestAnimationFrame((time) => this.advance(time));
  }

  pause() {
    this.isPlaying = false;
    this.onChange();
  }

  advance(time) {
    if (!this.isPlaying) return;
    const seconds = this.lastTime === null ? 0 : (time - this.lastTime) / 1000;
    this.lastTime = time;
    this.progress = Math.min(this.progress + (this.speed * seconds) / this.stepSeconds, this.steps);
    const reached = Math.floor(this.progress + 1e-9);
    if (reached !== this.step) {
      this.step = reached;
      this.onChange();
    }
    if (reached === this.steps) this.pause();
    else requestAnimationFrame((next) => this.advance(next));
  }
}

/** Space plays and pauses; the arrow keys step, with shift by a second; Home and End go to the ends. */
export function listenToKeys(playback) {
  const second = Math.round(1 / playback.stepSeconds);
  const actions = {
    " ": () => playback.toggle(),
    ArrowLeft: (event) => playback.move(event.shiftKey ? -second : -1),
    ArrowRight: (event) => playback.move(event.shiftKey ? second : 1),
    Home: () => playback.move(-playback.steps),
    End: () => playback.move(playback.steps),
  };
  document.addEventListener("keydown", (event) => {
    if (!actions[event.key] || isForControl(event) || event.ctrlKey || event.altKey || event.metaKey) return;
    event.preventDefault();
    actions[event.key](event);
  });
  for (const kind of ["click", "change"]) document.addEventListener(kind, giveKeysBack);
}

/** Whether a key means something to the control that has the focus. */
function isForControl({ key, target }) {
  return target.matches("select") || (key === " " && target.matches("button, summary, [type=checkbox]"));
}

/** A control that was used with a pointer does not keep the keys for itself; an open list of choices does. */
function giveKeysBack({ type }) {
  const focused = document.activeElement;
  if (type === "click" && focused.matches("select")) return;
  if (!focused.matches(":focus-visible")) focused.blur();
}
