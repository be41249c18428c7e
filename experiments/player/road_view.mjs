// The road from above: surface, goal, traffic with predictions, sampled trajectories, the chosen one, egos.

import { bundleAt, describeTrajectory, drawBundle, nearestTrajectory } from "./bundle.mjs";
import { Camera } from "./camera.mjs";
import { fill, linesPath, prepare, ringsPath, stroke } from "./canvas.mjs";
import { poseAt } from "./episode.mjs";
import { formatNumber } from "./format.mjs";

const NEAR = 8;
const ELLIPSE_ALPHA = 0.3;

export class RoadView {
  constructor(canvas, data, episodes, tracks) {
    Object.assign(this, { canvas, data, episodes, tracks });
    this.camera = new Camera();
    const { surface, goal, borders, path } = data.surroundings;
    this.paths = {
      surface: ringsPath(surface),
      goal: ringsPath(goal),
      borders: linesPath(borders),
      reference: linesPath([path]),
    };
  }

  /** Draw a step: `view` says which episode's plan is shown, how its bundle is coloured, and whether to follow. */
  draw(step, view) {
    const { context, width, height } = prepare(this.canvas);
    this.camera.resize(width, height);
    const shown = this.episodes[view.shown];
    if (view.follow) this.camera.center = shown.camera(step);
    this.showBundle(shown, step);
    context.fillStyle = this.data.colors.offRoad;
    context.fillRect(0, 0, width, height);
    context.save();
    this.camera.apply(context);
    const pixel = 1 / this.camera.scale;
    this.drawSurroundings(context, pixel);
    drawBundle(context, this.bundle, view.bundle, this.data, pixel);
    this.drawEllipses(context, shown.ellipses(step));
    this.drawTraffic(context, step, pixel);
    this.drawEgos(context, step, view.shown, pixel);
    this.drawChosen(context, shown, step, pixel);
    context.restore();
    drawScaleBar(context, this.camera, width, height);
  }

  showBundle(episode, step) {
    const cycle = episode.cycle(step);
    if (this.bundleOf === episode && this.bundleCycle === cycle) return;
    [this.bundleOf, this.bundleCycle, this.bundle] = [episode, cycle, bundleAt(episode, step)];
  }

  drawSurroundings(context, pixel) {
    const { colors } = this.data;
    fill(context, this.paths.surface, colors.surface);
    stroke(context, this.paths.borders, "#ffffff", pixel);
    stroke(context, this.paths.surface, colors.edge, pixel);
    fill(context, this.paths.goal, colors.goal, 0.25);
    stroke(context, this.paths.goal, colors.goal, pixel);
    stroke(context, this.paths.reference, colors.path, pixel, { dash: [6 * pixel, 4 * pixel] });
  }

  drawEllipses(context, ellipses) {
    for (const { x, y, long, across, angle, obstacle, lead } of ellipses) {
      const path = new Path2D();
      path.ellipse(x, y, long, across, angle, 0, 2 * Math.PI);
      fill(context, path, this.data.obstacles[obstacle].color, ELLIPSE_ALPHA * (1 - lead));
    }
  }

  drawTraffic(context, step, pixel) {
    for (const { pose, size } of this.traffic(step)) drawBox(context, pose, size, size.color, pixel);
  }

  drawEgos(context, step, shown, pixel) {
    const order = [...this.episodes.keys()].sort((one, other) => (one === shown) - (other === shown));
    for (const place of order) {
      const episode = this.episodes[place];
      stroke(context, linesPath([episode.driven(step)]), episode.color, 1.5 * pixel, { alpha: 0.7 });
      drawBox(context, episode.pose(step), this.data.ego, episode.color, pixel);
    }
  }

  drawChosen(context, episode, step, pixel) {
    const path = linesPath([episode.chosen(step)]);
    stroke(context, path, "#ffffff", 4 * pixel);
    stroke(context, path, episode.color, 2.2 * pixel);
  }

  /** The obstacles that are there at a step: pose and description. */
  traffic(step) {
    const { obstacles } = this.data;
    return obstacles
      .map((size, place) => ({ size, pose: poseAt(this.tracks.poses, step * obstacles.length + place) }))
      .filter(({ pose }) => pose);
  }

  /** What is told of what lies at a point of the screen; null where there is nothing. */
  describe(point, step, view) {
    const place = this.camera.toWorld(point);
    const ego = this.episodes.find((episode) => isInside(place, episode.pose(step), this.data.ego));
    if (ego) return describeVehicle(`ego, ${ego.planner}`, ego.pose(step));
    const other = this.traffic(step).find(({ pose, size }) => isInside(place, pose, size));
    if (other) return describeVehicle(other.size.kind, other.pose);
    if (view.bundle === "none") return null;
    const nearest = nearestTrajectory(this.bundle, place, NEAR / this.camera.scale);
    return nearest ? describeTrajectory(nearest, this.bundle, this.data.reasons) : null;
  }
}

function describeVehicle(name, { speed }) {
  return `${name}\n${formatNumber(speed)} m/s, ${(3.6 * speed).toFixed(0)} km/h`;
}

function isInside([x, y], pose, { length, width }) {
  const [dx, dy] = [x - pose.x, y - pose.y];
  const [cos, sin] = [Math.cos(pose.heading), Math.sin(pose.heading)];
  return Math.abs(dx * cos + dy * sin) <= length / 2 && Math.abs(dy * cos - dx * sin) <= width / 2;
}

function drawBox(context, { x, y, heading }, { length, width }, color, pixel) {
  context.save();
  context.translate(x, y);
  context.rotate(heading);
  const path = new Path2D();
  path.rect(-length / 2, -width / 2, length, width);
  fill(context, path, color);
  stroke(context, path, "#ffffff", pixel);
  context.restore();
}

function drawScaleBar(context, camera, width, height) {
  const metres = [1, 2, 5, 10, 20, 50, 100].find((length) => length * camera.scale > 50) ?? 100;
  const [right, bottom, long] = [width - 12, height - 12, metres * camera.scale];
  context.fillStyle = "#1b1f24";
  context.fillRect(right - long, bottom, long, 2);
  context.font = "11px system-ui, sans-serif";
  context.textAlign = "right";
  context.fillText(`${metres} m`, right, bottom - 4);
}
