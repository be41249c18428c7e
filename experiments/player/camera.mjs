// Which stretch of the world the road view shows.

import { clamp } from "./format.mjs";

const SHOWN_WIDTH = 70;
const SHOWN_HEIGHT = 50;
const SMALLEST_SCALE = 0.5;
const LARGEST_SCALE = 120;

/** Metres to CSS pixels and back; y points up in the world and down on the screen. */
export class Camera {
  constructor() {
    this.center = [0, 0];
    this.zoom = 1;
    this.width = 1;
    this.height = 1;
  }

  /** Pixels per metre: at zoom 1 a whole junction fits. */
  get scale() {
    return this.zoom * Math.max(this.width / SHOWN_WIDTH, this.height / SHOWN_HEIGHT);
  }

  resize(width, height) {
    this.width = width;
    this.height = height;
  }

  toScreen([x, y]) {
    const { scale } = this;
    return [this.width / 2 + (x - this.center[0]) * scale, this.height / 2 - (y - this.center[1]) * scale];
  }

  toWorld([x, y]) {
    const { scale } = this;
    return [this.center[0] + (x - this.width / 2) / scale, this.center[1] - (y - this.height / 2) / scale];
  }

  /** Let the context's units be metres. */
  apply(context) {
    const { scale } = this;
    context.translate(this.width / 2, this.height / 2);
    context.scale(scale, -scale);
    context.translate(-this.center[0], -this.center[1]);
  }

  pan(dx, dy) {
    this.center = [this.center[0] - dx / this.scale, this.center[1] + dy / this.scale];
  }

  /** Zoom by a factor around a point of the screen, or around the middle. */
  zoomBy(factor, point = null) {
    const fixed = point && this.toWorld(point);
    const atOne = this.scale / this.zoom;
    this.zoom = clamp(this.zoom * factor, SMALLEST_SCALE / atOne, LARGEST_SCALE / atOne);
    if (!fixed) return;
    const [x, y] = this.toScreen(fixed);
    this.pan(point[0] - x, point[1] - y);
  }
}
