// One planner's episode: where the ego is at a step, and what was planned there.

import { clamp } from "./format.mjs";

const TYPES = { float32: Float32Array, int32: Int32Array, int16: Int16Array, uint8: Uint8Array };
const POSE_FIELDS = 4;
const ELLIPSE_FIELDS = 7;

/** Packed arrays by name: base64 of gzip, and where in the bytes which array begins. */
export async function unpack({ arrays, bytes }) {
  const buffer = await decompressed(Uint8Array.from(atob(bytes), (letter) => letter.charCodeAt(0)));
  const views = arrays.map(({ name, type, start, length }) => [name, new TYPES[type](buffer, start, length)]);
  return Object.fromEntries(views);
}

async function decompressed(bytes) {
  const stream = new Blob([bytes]).stream().pipeThrough(new DecompressionStream("gzip"));
  return new Response(stream).arrayBuffer();
}

/** Undo second differences along the first axis of an array [rows, columns], in place. */
function integrateTwice(values, columns) {
  for (let pass = 0; pass < 2; pass += 1) {
    for (let place = columns; place < values.length; place += 1) values[place] += values[place - columns];
  }
  return values;
}

/** A vehicle's place at a step, or null where it is not there. */
export function poseAt(poses, row) {
  const [x, y, heading, speed] = poses.subarray(row * POSE_FIELDS, (row + 1) * POSE_FIELDS);
  return Number.isNaN(x) ? null : { x, y, heading, speed };
}

/** Reads the arrays of an episode's description. */
export async function readEpisode(description) {
  const arrays = await unpack(description.arrays);
  const count = arrays.bundleStarts.at(-1);
  integrateTwice(arrays.bundlePoints, 2 * count);
  return new Episode(description, arrays, count);
}

export class Episode {
  constructor({ planner, color, outcome, steps, modes, sampled, pointsKept, unit }, arrays, count) {
    Object.assign(this, { planner, color, outcome, steps, modes, sampled, pointsKept, unit });
    this.arrays = arrays;
    this.count = count;
  }

  /** The ego's place; it stays where the episode has ended. */
  pose(step) {
    return poseAt(this.arrays.poses, clamp(step, 0, this.steps));
  }

  /** Where a view that follows the ego has its middle. */
  camera(step) {
    const place = 2 * clamp(step, 0, this.steps);
    return [...this.arrays.camera.subarray(place, place + 2)];
  }

  /** What the planner does at a step, or how the episode has ended. */
  state(step) {
    return step < this.steps ? `planning: ${this.modes[step]}` : this.outcome;
  }

  /** The planning cycle that is shown at a step: after the last one there is no other. */
  cycle(step) {
    return clamp(step, 0, this.steps - 1);
  }

  /** Points [x, y] of the driven way up to a step. */
  driven(step) {
    return Array.from({ length: clamp(step, 0, this.steps) + 1 }, (_, past) => {
      const { x, y } = this.pose(past);
      return [x, y];
    });
  }

  /** Points [x, y] of the chosen trajectory. */
  chosen(step) {
    const { chosen } = this.arrays;
    const length = chosen.length / this.steps;
    const start = this.cycle(step) * length;
    return Array.from({ length: length / 2 }, (_, point) => [chosen[start + 2 * point], chosen[start + 2 * point + 1]]);
  }

  /** Predicted ellipses: two standard deviations around where obstacles will be. */
  ellipses(step) {
    const { ellipses, ellipseStarts } = this.arrays;
    const cycle = this.cycle(step);
    const first = ellipseStarts[cycle];
    return Array.from({ length: ellipseStarts[cycle + 1] - first }, (_, place) => {
      const start = (first + place) * ELLIPSE_FIELDS;
      const [x, y, long, across, angle, obstacle, lead] = ellipses.subarray(start, start + ELLIPSE_FIELDS);
      return { x, y, long, across, angle, obstacle, lead };
    });
  }

  /** The sampled trajectories of a step that can be drawn: the range of their places in all cycles' bundles. */
  bundleRange(step) {
    const { bundleStarts } = this.arrays;
    const cycle = this.cycle(step);
    return { first: bundleStarts[cycle], end: bundleStarts[cycle + 1] };
  }

  /** Points [x, y] of a sampled trajectory at a step. */
  line(step, trajectory) {
    const { bundlePoints, chosen } = this.arrays;
    const start = (this.cycle(step) * chosen.length) / this.steps;
    return Array.from({ length: this.pointsKept }, (_, point) => {
      const x = 2 * point * this.count + trajectory;
      return [
        chosen[start] + this.unit * bundlePoints[x],
        chosen[start + 1] + this.unit * bundlePoints[x + this.count],
      ];
    });
  }

  /** Weighted cost of a sampled trajectory. */
  cost(trajectory) {
    return this.arrays.bundleCosts[trajectory];
  }

  /** A bit for each reason why a sampled trajectory is not driven. */
  failures(trajectory) {
    return this.arrays.bundleFailures[trajectory];
  }
}
