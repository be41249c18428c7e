// What the colours of the road view mean.

import { firstReason, FREE_COLOR } from "./bundle.mjs";

/** Entries of the legend: label, colour, and whether it is a line's. */
export function legendEntries(data, episodes, view, bundle) {
  const shown = episodes[view.shown];
  return [
    ...episodes.map(({ planner, color }) => area(episodes.length > 1 ? `ego, ${planner}` : "ego", color)),
    line("chosen trajectory", shown.color),
    ...bundleEntries(data, view, bundle, shown.sampled),
    line("reference path", data.colors.path),
    area("goal", data.colors.goal),
    ...trafficEntries(data.obstacles),
  ];
}

const area = (label, color) => ({ label, color, isLine: false });
const line = (label, color) => ({ label, color, isLine: true });

function bundleEntries({ costColors, infeasibleColor, reasons }, view, bundle, sampled) {
  if (view.bundle === "none") return [];
  if (view.bundle === "cost") {
    const gradient = `linear-gradient(90deg, ${costColors.join(", ")})`;
    return [line("feasible: cheap to dear", gradient), line("infeasible", infeasibleColor)];
  }
  const counts = reasons.map((_, place) => bundle.filter(({ failures }) => firstReason(failures) === place).length);
  const free = bundle.filter(({ failures }) => !failures).length;
  return [
    line(`feasible (${free})`, FREE_COLOR),
    ...reasons.map(({ label, color }, place) => line(`${label} (${counts[place]})`, color)),
    line(`leaves the path (${sampled - bundle.length}), not drawn`, "transparent"),
  ];
}

/** Kinds that share a colour share an entry. */
function trafficEntries(obstacles) {
  const kinds = new Map();
  const seen = obstacles.filter(({ isSeen }) => isSeen);
  for (const { kind, color } of seen) kinds.set(color, (kinds.get(color) ?? new Set()).add(kind));
  const entries = [...kinds].map(([color, names]) => area([...names].join(", "), color));
  return seen.length ? [...entries, area("predicted, 2σ", `${seen[0].color}40`)] : entries;
}

/** Put entries into a list element. */
export function fillLegend(list, entries) {
  const items = entries.map(({ label, color, isLine }) => {
    const item = document.createElement("li");
    const swatch = document.createElement("span");
    swatch.className = isLine ? "swatch line" : "swatch";
    swatch.style.background = color;
    item.append(swatch, label);
    return item;
  });
  list.replaceChildren(...items);
}
