// The sampled trajectories of one planning cycle: their order by cost, their colours, which one is near a point.

import { linesPath, stroke } from "./canvas.mjs";
import { formatNumber } from "./format.mjs";

const COLLIDES = 1;
export const FREE_COLOR = "#2e9e6b";

/** Trajectories of a step: points, cost, failures; rank among the feasible ones from the cheapest, 0, or null. */
export function bundleAt(episode, step) {
  const { first, end } = episode.bundleRange(step);
  const bundle = Array.from({ length: end - first }, (_, place) => ({
    points: episode.line(step, first + place),
    cost: episode.cost(first + place),
    failures: episode.failures(first + place),
    rank: null,
  }));
  feasibleOf(bundle)
    .sort((one, other) => one.cost - other.cost)
    .forEach((trajectory, rank) => (trajectory.rank = rank));
  return bundle;
}

/** Those that can be driven; some of them were found to collide. */
export const feasibleOf = (bundle) => bundle.filter(({ failures }) => (failures & ~COLLIDES) === 0);

/** The first reason why a trajectory is not driven, as a place in the table of reasons; -1 if there is none. */
export const firstReason = (failures) => (failures ? Math.log2(failures & -failures) : -1);

/** Draws a bundle by cost or by reason, in a context whose units are metres. */
export function drawBundle(context, bundle, mode, data, pixel) {
  if (mode === "cost") drawByCost(context, bundle, data, pixel);
  if (mode === "reason") drawByReason(context, bundle, data, pixel);
}

function drawByCost(context, bundle, { costColors, infeasibleColor }, pixel) {
  const infeasible = bundle.filter(({ rank }) => rank === null);
  strokeAll(context, infeasible, infeasibleColor, 0.6 * pixel, 0.3);
  const feasible = feasibleOf(bundle);
  const shades = costColors.length;
  const shade = ({ rank }) => Math.floor((rank / Math.max(feasible.length - 1, 1)) * (shades - 1));
  for (const [place, color] of [...costColors.entries()].reverse()) {
    strokeAll(context, feasible.filter((one) => shade(one) === place), color, pixel, 0.7);
  }
}

function drawByReason(context, bundle, { reasons }, pixel) {
  for (const [place, { color }] of [...reasons.entries()].reverse()) {
    strokeAll(context, bundle.filter(({ failures }) => firstReason(failures) === place), color, 0.8 * pixel, 0.45);
  }
  strokeAll(context, bundle.filter(({ failures }) => !failures), FREE_COLOR, pixel, 0.7);
}

function strokeAll(context, trajectories, color, width, alpha) {
  stroke(context, linesPath(trajectories.map(({ points }) => points)), color, width, { alpha });
}

/** The trajectory nearest to a point, of those within a distance; undefined without one. */
export function nearestTrajectory(bundle, point, within) {
  let nearest;
  let least = within;
  for (const trajectory of bundle) {
    const distance = distanceToLine(trajectory.points, point);
    if (distance < least) [nearest, least] = [trajectory, distance];
  }
  return nearest;
}

function distanceToLine(points, point) {
  let least = Infinity;
  for (let place = 1; place < points.length; place += 1) {
    least = Math.min(least, distanceToSegment(points[place - 1], points[place], point));
  }
  return least;
}

function distanceToSegment([ax, ay], [bx, by], [x, y]) {
  const [dx, dy] = [bx - ax, by - ay];
  const square = dx * dx + dy * dy;
  const share = square ? Math.min(Math.max(((x - ax) * dx + (y - ay) * dy) / square, 0), 1) : 0;
  return Math.hypot(x - ax - share * dx, y - ay - share * dy);
}

/** What is told of a trajectory: cost and rank, and why it is not driven. */
export function describeTrajectory({ cost, failures, rank }, bundle, reasons) {
  const failed = reasons.filter((_, bit) => failures & (1 << bit)).map(({ label }) => label);
  if (rank === null) return `trajectory: infeasible\nreason: ${failed.join(", ")}`;
  const place = `${rank + 1} of ${feasibleOf(bundle).length} feasible`;
  return [`trajectory: cost ${formatNumber(cost)}`, `in order of cost: ${place}`, ...failed].join("\n");
}
