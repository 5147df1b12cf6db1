// The stimulator's page: full screen, at the display's refresh rate, fed by the channel `stimulus`.

import { Connection } from "./connection.js";
import { Schedule, Screen } from "./stimulator_screen.js";

const REPORT_MS = 1000, REFRESHES = 32;

class Feed extends Connection {
  /** Always, also hidden: a display behind a collimator has no one who looks at it. */
  subscribe() {
    if (!this.open) return;
    this.request({ type: "subscribe", channels: ["stimulus"], frame_format: "none", every: 1 }).catch(() => {});
  }
}

const element = (id) => document.getElementById(id);
const delay = Number(new URLSearchParams(location.search).get("delay_ms") ?? 50);
const screen = new Screen(element("screen"));
const schedule = new Schedule({ delayMs: Number.isFinite(delay) ? delay : 50 });
const feed = new Feed(new URL("ws", location.href.replace(/^http/, "ws")).href);
const refreshes = [];
let newest = null, reported = 0;

/** Median time between refreshes, ms; a page that is held up does not change it. */
function period(now) {
  refreshes.push(now);
  if (refreshes.length > REFRESHES + 1) refreshes.shift();
  const steps = refreshes.slice(1).map((time, n) => time - refreshes[n]).sort((a, b) => a - b);
  return steps[steps.length >> 1] ?? 1000 / 60;
}

function refresh(now) {
  const periodMs = period(now);
  const picture = schedule.next(now, periodMs);
  if (picture) {
    screen.resize(newest.width, newest.height);
    screen.show(picture);
  }
  if (now - reported > REPORT_MS && feed.open && newest) {
    reported = now;
    const { shown, late } = schedule;
    feed.request({ type: "shown", shown, late }).catch(() => {});
    tell(periodMs);
  }
  requestAnimationFrame(refresh);
}

function tell(periodMs) {
  const { shown, late, skipped } = schedule;
  element("counts").textContent =
    `${newest.stars} stars, ${newest.clipped} clipped, ${newest.faint} too faint · ${shown} pictures shown, ` +
    `${late} late, ${skipped} more than the display's ${(1000 / periodMs).toFixed(1)} Hz`;
  const width = Math.round(window.screen.width * devicePixelRatio), height = Math.round(window.screen.height * devicePixelRatio);
  const fits = width === newest.width && height === newest.height;
  element("fit").textContent = fits ? "" : `This screen has ${width}×${height} pixels, the calibrated display ${newest.width}×${newest.height}.`;
}

const LINKS = { connecting: () => "Connecting …", open: () => "Connected.", lost: ({ reason }) => `Connection lost. ${reason ?? ""}` };

feed.addEventListener("link", ({ detail }) => { element("link").textContent = LINKS[detail.state](detail); });
feed.addEventListener("welcome", ({ detail }) => {
  if (!detail.channels.includes("stimulus")) element("link").textContent = "The server has no display: boresight serve … --stimulator stimulator.yaml";
});
feed.addEventListener("stimulus", ({ detail }) => {
  newest = detail;
  schedule.add(detail, performance.now());
});
element("full").addEventListener("click", () => document.documentElement.requestFullscreen());
document.addEventListener("fullscreenchange", () => hide(Boolean(document.fullscreenElement)));
document.addEventListener("keydown", ({ key, ctrlKey, metaKey }) => {
  if (ctrlKey || metaKey) return;
  if (key === "f" || key === "F") document.documentElement.requestFullscreen();
  if (key === "h" || key === "H") hide(!element("panel").hidden);
});

function hide(hidden) {
  element("panel").hidden = hidden;
  document.documentElement.classList.toggle("bare", hidden);
}

window.stimulator = { schedule, screen, get index() { return schedule.index; } };
feed.start();
requestAnimationFrame(refresh);
