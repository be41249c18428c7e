// The page: reads the data, builds the views, and keeps them at the same time.

import { Chart } from "./chart.mjs";
import { readEpisode, unpack } from "./episode.mjs";
import { formatTime } from "./format.mjs";
import { listenToGestures } from "./gestures.mjs";
import { fillLegend, legendEntries } from "./legend.mjs";
import { listenToKeys, Playback } from "./playback.mjs";
import { RoadView } from "./road_view.mjs";

const NARROW = "(max-width: 760px)";
const TOOLTIP_DISTANCE = 14;
const element = (id) => document.getElementById(id);

class Player {
  constructor(data, episodes, tracks) {
    Object.assign(this, { data, episodes });
    this.view = { shown: 0, bundle: element("bundle").value, follow: true };
    this.hovered = null;
    this.pointed = null;
    this.playback = new Playback(data.steps, data.stepSeconds, () => this.refresh());
    this.road = new RoadView(element("road"), data, episodes, tracks);
    const chartEvents = {
      onPick: (step) => this.playback.seek(step),
      onHover: (step) => this.set(() => (this.hovered = step)),
    };
    this.charts = data.charts.map((chart) => new Chart(chart, data, chartEvents));
    element("charts").append(...this.charts.map((chart) => chart.element));
  }

  start() {
    element("name").textContent = this.data.name;
    element("legend").open = !window.matchMedia(NARROW).matches;
    this.startTransport();
    this.startOptions();
    this.startGestures();
    listenToKeys(this.playback);
    new ResizeObserver(() => this.refresh()).observe(document.body);
    this.refresh();
  }

  startTransport() {
    const { playback } = this;
    element("play").addEventListener("click", () => playback.toggle());
    element("back").addEventListener("click", () => playback.move(-1));
    element("forward").addEventListener("click", () => playback.move(1));
    element("scrub").max = playback.steps;
    element("scrub").addEventListener("input", (event) => playback.seek(Number(event.target.value)));
    element("speed").addEventListener("change", (event) => (playback.speed = Number(event.target.value)));
  }

  startOptions() {
    const { view } = this;
    const names = this.episodes.map(({ planner }, place) => new Option(planner, place));
    element("shown").append(...names);
    element("shown-choice").hidden = names.length < 2;
    element("shown").addEventListener("change", ({ target }) => this.set(() => (view.shown = Number(target.value))));
    element("bundle").addEventListener("change", ({ target }) => this.set(() => (view.bundle = target.value)));
    element("follow").addEventListener("change", ({ target }) => this.set(() => (view.follow = target.checked)));
  }

  startGestures() {
    const { camera } = this.road;
    listenToGestures(element("road"), {
      onPan: (dx, dy) => this.set(() => this.leaveEgo() || camera.pan(dx, dy)),
      onZoom: (factor, point) => this.set(() => camera.zoomBy(factor, this.view.follow ? null : point)),
      onPoint: (point) => this.set(() => (this.pointed = point)),
    });
  }

  leaveEgo() {
    this.view.follow = false;
    element("follow").checked = false;
  }

  set(change) {
    change();
    this.refresh();
  }

  /** Draw with the next frame; however much has changed until then, once. */
  refresh() {
    if (this.isWaiting) return;
    this.isWaiting = true;
    requestAnimationFrame(() => {
      this.isWaiting = false;
      this.draw();
    });
  }

  draw() {
    const { step, isPlaying } = this.playback;
    this.road.draw(step, this.view);
    for (const chart of this.charts) chart.draw(step, this.hovered);
    fillLegend(element("legend-entries"), legendEntries(this.data, this.episodes, this.view, this.road.bundle));
    this.showTime(step, isPlaying);
    this.showTooltip(step);
  }

  showTime(step, isPlaying) {
    const { stepSeconds, steps } = this.data;
    element("scrub").value = step;
    element("clock").value = `${(step * stepSeconds).toFixed(1)} / ${formatTime(steps * stepSeconds)}`;
    element("play").textContent = isPlaying ? "❚❚" : "▶";
    element("play").setAttribute("aria-label", isPlaying ? "Pause" : "Play");
    const states = this.episodes.map((episode) => `${episode.planner} – ${episode.state(step)}`);
    element("status").textContent = states.join(" · ");
  }

  showTooltip(step) {
    const tooltip = element("tooltip");
    const text = this.pointed && this.road.describe(this.pointed, step, this.view);
    tooltip.hidden = !text;
    if (!text) return;
    tooltip.textContent = text;
    const { clientWidth, clientHeight } = element("stage");
    const [x, y] = this.pointed;
    const left = x + TOOLTIP_DISTANCE + tooltip.offsetWidth < clientWidth ? x + TOOLTIP_DISTANCE : x - tooltip.offsetWidth;
    const top = Math.min(y + TOOLTIP_DISTANCE, clientHeight - tooltip.offsetHeight);
    tooltip.style.left = `${Math.max(left, 0)}px`;
    tooltip.style.top = `${Math.max(top, 0)}px`;
  }
}

async function open() {
  const data = JSON.parse(element("data").textContent);
  const [tracks, ...episodes] = await Promise.all([unpack(data.tracks), ...data.episodes.map(readEpisode)]);
  new Player(data, episodes, tracks).start();
  document.body.dataset.ready = "true";
}

open().catch((error) => {
  element("status").textContent = `This page cannot be shown in this browser: ${error.message}`;
  throw error;
});
