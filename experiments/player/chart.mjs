// A chart of curves over time, with a cursor.

import { linesPath, prepare, stroke } from "./canvas.mjs";
import { clamp, formatNumber, formatPlain, formatTick, formatTime, linearTicks, logTicks } from "./format.mjs";

const MARGIN = { left: 44, right: 8, top: 7, bottom: 16 };
const RULE = "#e3e6e8";
const QUIET = "#5b6570";
const CURSOR = "#1b1f24";

export class Chart {
  /** `onPick` is called with a step when the chart is pressed, `onHover` with a step or null. */
  constructor(description, { steps, stepSeconds }, { onPick, onHover }) {
    Object.assign(this, description, { steps, stepSeconds });
    this.element = document.createElement("article");
    this.element.className = "chart";
    this.canvas = document.createElement("canvas");
    this.element.append(this.makeHeading(), this.canvas);
    this.listen(onPick, onHover);
  }

  makeHeading() {
    const heading = document.createElement("div");
    heading.className = "values";
    const title = document.createElement("b");
    title.textContent = this.unit ? `${this.title} [${this.unit}]` : this.title;
    heading.append(title, ...this.makeEntries());
    return heading;
  }

  /** One entry per label: the marks of its lines, and a place for their values, one per planner. */
  makeEntries() {
    const labels = [...new Set(this.lines.map(({ label }) => label))];
    this.readings = [];
    return labels.map((wanted) => {
      const lines = this.lines.filter(({ label }) => label === wanted);
      const [entry, reading] = ["span", "span"].map((name) => document.createElement(name));
      entry.append(...lines.map(makeMark), `${wanted} `, reading);
      entry.title = lines.map(({ planner }) => planner).join(" / ");
      this.readings.push({ reading, lines });
      return entry;
    });
  }

  listen(onPick, onHover) {
    const stepOf = ({ clientX }) => this.stepAt(clientX - this.canvas.getBoundingClientRect().left);
    this.canvas.addEventListener("pointerdown", (event) => {
      this.canvas.setPointerCapture(event.pointerId);
      onPick(stepOf(event));
    });
    this.canvas.addEventListener("pointermove", (event) => {
      if (event.buttons) onPick(stepOf(event));
      else onHover(stepOf(event));
    });
    this.canvas.addEventListener("pointerleave", () => onHover(null));
  }

  /** The step at a distance from the canvas's left edge, in pixels. */
  stepAt(x) {
    const inner = this.canvas.clientWidth - MARGIN.left - MARGIN.right;
    return Math.round(clamp((x - MARGIN.left) / inner, 0, 1) * this.steps);
  }

  /** Draw everything; what comes after `step` is faint, the cursor and the readings are at `hovered` if there is one. */
  draw(step, hovered) {
    const { context, width, height } = prepare(this.canvas);
    this.frame = { left: MARGIN.left, right: width - MARGIN.right, top: MARGIN.top, bottom: height - MARGIN.bottom };
    this.drawAxes(context);
    this.drawLines(context, this.steps, 0.25);
    this.drawLines(context, step, 1);
    this.drawCursor(context, step, CURSOR);
    if (hovered !== null) this.drawCursor(context, hovered, QUIET, [3, 3]);
    this.showReadings(hovered ?? step);
  }

  x(step) {
    const { left, right } = this.frame;
    return left + (step / Math.max(this.steps, 1)) * (right - left);
  }

  y(value) {
    const [low, high] = this.limits.map((limit) => this.onAxis(limit));
    const { top, bottom } = this.frame;
    return bottom - ((this.onAxis(value) - low) / (high - low)) * (bottom - top);
  }

  /** What has no logarithm lies far below the axis. */
  onAxis(value) {
    return this.log ? Math.log10(Math.max(value, Number.MIN_VALUE)) : value;
  }

  drawAxes(context) {
    const { left, right, top, bottom } = this.frame;
    context.font = "10px system-ui, sans-serif";
    context.fillStyle = QUIET;
    const grid = new Path2D();
    context.textAlign = "right";
    context.textBaseline = "middle";
    const ticks = (this.log ? logTicks : linearTicks)(...this.limits, 4);
    for (const tick of ticks) {
      const y = this.y(tick);
      context.fillText(formatTick(tick), left - 5, y);
      grid.moveTo(left, y);
      grid.lineTo(right, y);
    }
    context.textAlign = "center";
    context.textBaseline = "alphabetic";
    for (const seconds of linearTicks(0, this.steps * this.stepSeconds, 6)) {
      const x = this.x(seconds / this.stepSeconds);
      context.fillText(formatTick(seconds), x, bottom + 12);
      grid.moveTo(x, top);
      grid.lineTo(x, bottom);
    }
    stroke(context, grid, RULE, 1);
  }

  /** Curves up to a step; those that are wider come first, below the others. */
  drawLines(context, until, alpha) {
    const { left, right, top, bottom } = this.frame;
    context.save();
    context.beginPath();
    context.rect(left, top - 2, right - left + 2, bottom - top + 4);
    context.clip();
    for (const { values, color, dashed, width } of [...this.lines].sort((one, other) => other.width - one.width)) {
      stroke(context, this.curve(values.slice(0, until + 1)), color, width, { dash: dashed ? [4, 3] : [], alpha });
    }
    context.restore();
  }

  /** The path of values; there are gaps where there is none. */
  curve(values) {
    const path = new Path2D();
    let isDown = false;
    values.forEach((value, step) => {
      if (value !== null) path[isDown ? "lineTo" : "moveTo"](this.x(step), this.y(value));
      isDown = value !== null;
    });
    return path;
  }

  drawCursor(context, step, color, dash = []) {
    const { left, right, top, bottom } = this.frame;
    const x = this.x(step);
    stroke(context, linesPath([[[x, top], [x, bottom]]]), color, 1, { dash });
    if (!dash.length) return;
    context.textAlign = x < (left + right) / 2 ? "left" : "right";
    context.fillText(formatTime(step * this.stepSeconds), x + (x < (left + right) / 2 ? 4 : -4), top + 9);
  }

  showReadings(step) {
    const format = this.log ? formatNumber : formatPlain;
    for (const { reading, lines } of this.readings) {
      reading.textContent = lines.map(({ values }) => format(values[step])).join(" / ");
    }
  }
}

function makeMark({ color, dashed }) {
  const mark = document.createElement("i");
  mark.style.borderColor = color;
  mark.classList.toggle("dashed", dashed);
  return mark;
}
