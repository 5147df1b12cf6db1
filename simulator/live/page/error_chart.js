// Errors about the three axes against the bound, over mission time; where the frame was not solved there is a gap.

import { SMALL, Surface, colour, label } from "./canvas.js";
import { duration, significant } from "./format.js";

const AXES = ["about x", "about y", "about the boresight, z"], NARROW_AXES = ["about x", "about y", "about z"];
const WINDOWS_S = [10, 30, 60, 300, 1800, 7200];
const LEFT = 52, RIGHT = 8, BOTTOM = 20, GAP = 22, TOP = 18, BIN_PX = 1, INTERVAL_MS = 50, MANY_ROWS = 5000;

export class ErrorChart {
  #log = false;
  #window = 60;
  #chosen = false;

  constructor(store) {
    this.store = store;
    this.surface = new Surface(document.getElementById("errors"), (context, w, h) => this.#draw(context, w, h), INTERVAL_MS);
    this.select = document.getElementById("window");
    for (const s of WINDOWS_S) this.select.add(new Option(s < 60 ? `${s} s` : s < 3600 ? `${s / 60} min` : `${s / 3600} h`, s));
    this.select.value = this.#window;
    this.select.addEventListener("change", () => {
      this.#window = Number(this.select.value);
      this.#chosen = true;
      this.surface.request();
    });
    document.getElementById("log").addEventListener("click", () => this.toggleLog());
    store.addEventListener("history", () => this.surface.request());
    store.addEventListener("welcome", () => this.#fitWindow());
  }

  toggleLog() {
    this.#log = !this.#log;
    document.getElementById("log").setAttribute("aria-pressed", this.#log);
    this.surface.request();
  }

  /** Slow cameras need a longer window: at least sixty frames, until someone chooses. */
  #fitWindow() {
    if (this.#chosen) return;
    const wanted = 60 * (this.store.welcome.step_s || 1);
    this.#window = WINDOWS_S.find((s) => s >= Math.max(wanted, 60)) ?? WINDOWS_S.at(-1);
    this.select.value = this.#window;
  }

  /** Rows of the window, the oldest first. */
  #rows() {
    const { history } = this.store, newest = history.last();
    if (!newest) return [];
    let first = history.length - 1;
    while (first > 0 && newest.x - history.at(first - 1).x <= this.#window) first--;
    return Array.from({ length: history.length - first }, (_, i) => history.at(first + i));
  }

  #draw(context, width, height) {
    const rows = this.#rows(), newest = rows.at(-1)?.x ?? 0;
    this.surface.interval = rows.length > MANY_ROWS ? 4 * INTERVAL_MS : INTERVAL_MS;
    const high = (height - TOP - BOTTOM - 2 * GAP) / 3;
    const x = (row) => width - RIGHT - ((newest - row.x) / this.#window) * (width - LEFT - RIGHT);
    context.font = SMALL;
    const said = [];
    for (let axis = 0; axis < 3; axis++) {
      const box = { left: LEFT, right: width - RIGHT, top: TOP + axis * (high + GAP), high };
      said.push(this.#strip(context, rows, axis, box, x));
    }
    this.#timeAxis(context, width, height);
    const text = said.join("; ");
    const output = document.getElementById("errors-text");
    if (rows.length && output.textContent !== text && Date.now() - (this.spoken ?? 0) > 5000) {
      output.textContent = text;
      this.surface.canvas.setAttribute("aria-label", `Attitude error over time. ${text}`);
      this.spoken = Date.now();
    }
  }

  #strip(context, rows, axis, box, x) {
    const scale = this.#log ? logScale(rows, axis, box) : linearScale(rows, axis, box);
    this.#frame(context, box, scale);
    context.save();
    context.beginPath();
    context.rect(box.left, box.top, box.right - box.left, box.high);
    context.clip();
    this.#gaps(context, rows, box, x);
    this.#bound(context, rows, axis, box, scale, x);
    this.#stated(context, rows, axis, scale, x);
    this.#curve(context, rows, axis, scale, x);
    context.restore();
    return this.#heading(context, rows, axis, box);
  }

  #frame(context, box, scale) {
    context.textBaseline = "middle";
    context.textAlign = "right";
    context.lineWidth = 1;
    for (const tick of scale.ticks) {
      const y = Math.round(scale.y(tick)) + 0.5;
      context.strokeStyle = colour(tick === 0 ? "edge" : "line");
      context.beginPath();
      context.moveTo(box.left, y);
      context.lineTo(box.right, y);
      context.stroke();
      context.fillStyle = colour("soft");
      context.fillText(significant(tick, 2), box.left - 6, y);
    }
    context.textAlign = "left";
  }

  /** Shade of the frames without a solution, and lines where time jumped. */
  #gaps(context, rows, box, x) {
    context.fillStyle = colour("soft");
    context.globalAlpha = 0.28;
    for (let i = 0; i < rows.length; i++) {
      if (rows[i].solved) continue;
      const from = i ? x(rows[i - 1]) : x(rows[i]) - 2;
      while (i + 1 < rows.length && !rows[i + 1].solved) i++;
      context.fillRect(from, box.top, Math.max(1, x(rows[i]) - from), box.high);
    }
    context.globalAlpha = 1;
    rows.forEach((row, i) => {
      const to = x(row), from = i ? x(rows[i - 1]) : to;
      if (row.jumped) {
        context.strokeStyle = colour("edge");
        context.setLineDash([2, 3]);
        context.beginPath();
        context.moveTo((from + to) / 2, box.top);
        context.lineTo((from + to) / 2, box.top + box.high);
        context.stroke();
        context.setLineDash([]);
      }
    });
  }

  #bound(context, rows, axis, box, scale, x) {
    const base = (value) => (this.#log ? box.top + box.high : scale.y(-value));
    context.fillStyle = context.strokeStyle = colour("green");
    for (const run of runs(rows, (row) => row.bound?.[axis])) {
      const up = run.map((row) => [x(row), scale.y(row.bound[axis])]);
      const down = run.map((row) => [x(row), base(row.bound[axis])]).reverse();
      context.globalAlpha = 0.2;
      context.beginPath();
      for (const point of [...up, ...down]) context.lineTo(...point);
      context.fill();
      context.globalAlpha = 1;
      context.lineWidth = 1.2;
      for (const edge of this.#log ? [up] : [up, down]) path(context, edge);
    }
  }

  #stated(context, rows, axis, scale, x) {
    context.strokeStyle = colour("orange");
    context.lineWidth = 1.4;
    context.setLineDash([5, 3]);
    for (const run of runs(rows, (row) => row.stated?.[axis])) {
      for (const sign of this.#log ? [1] : [1, -1]) path(context, run.map((row) => [x(row), scale.y(sign * row.stated[axis])]));
    }
    context.setLineDash([]);
  }

  #curve(context, rows, axis, scale, x) {
    context.strokeStyle = context.fillStyle = colour("blue");
    context.lineWidth = 1.6;
    const sparse = rows.length < 150;
    for (const run of runs(rows, (row) => row.error?.[axis])) {
      const points = run.map((row) => [x(row), scale.y(this.#log ? Math.abs(row.error[axis]) : row.error[axis])]);
      path(context, thinned(points));
      if (sparse || points.length === 1) for (const [u, v] of points) context.fillRect(u - 1.5, v - 1.5, 3, 3);
    }
  }

  /** Name of the axis with its figures; also what a screen reader is told. */
  #heading(context, rows, axis, box) {
    const errors = rows.map((row) => row.error?.[axis]).filter(Number.isFinite);
    const bounds = rows.map((row) => row.bound?.[axis]).filter(Number.isFinite);
    const rms = Math.sqrt(mean(errors.map((e) => e * e))), bound = Math.sqrt(mean(bounds.map((b) => b * b)));
    const y = box.top - 9, narrow = box.right - box.left < 330;
    context.textBaseline = "middle";
    context.textAlign = "left";
    context.font = `600 ${SMALL}`;
    label(context, `${narrow ? NARROW_AXES[axis] : AXES[axis]} (″)`, box.left, y, colour("text"), colour("card"));
    context.font = SMALL;
    context.textAlign = "right";
    const ratio = rms / bound;
    const times = bounds.length ? ` = ${significant(ratio, 2)} × bound` : "", size = bounds.length ? ` ${significant(bound, 3)}″` : "";
    const text = errors.length ? `rms ${significant(rms, 3)}″${times}${narrow ? "" : size}` : "no solution in the window";
    label(context, text, box.right, y, colour("soft"), colour("card"));
    context.textAlign = "left";
    return `${AXES[axis]}: ${text}`;
  }

  #timeAxis(context, width, height) {
    const step = this.#window / 6;
    context.fillStyle = colour("soft");
    context.textBaseline = "alphabetic";
    for (let k = 0; k <= 6; k += width < 420 ? 2 : 1) {
      const x = width - RIGHT - (k / 6) * (width - LEFT - RIGHT);
      context.textAlign = k === 0 ? "right" : "center";
      context.fillText(k ? `−${ago(k * step)}` : "newest", x, height - 5);
    }
    context.textAlign = "left";
  }
}

const mean = (values) => values.reduce((sum, value) => sum + value, 0) / values.length;
const ago = (s) => (s < 120 ? `${significant(s, 2)} s` : s < 7200 ? `${significant(s / 60, 2)} min` : duration(s));

/** Successive rows for which `value` is finite, without a jump of time within. */
function runs(rows, value) {
  const found = [];
  let run = [];
  for (const row of rows) {
    if (row.jumped && run.length) {
      found.push(run);
      run = [];
    }
    if (Number.isFinite(value(row))) run.push(row);
    else if (run.length) {
      found.push(run);
      run = [];
    }
  }
  return run.length ? [...found, run] : found;
}

/** Of many points in one column of the canvas, those that show: first, extremes and last. */
function thinned(points) {
  const shown = [];
  let column = null;
  const flush = () => column && shown.push(...[...new Set([column.first, column.low, column.high, column.last])].sort((a, b) => a[0] - b[0]));
  for (const point of points) {
    const key = Math.round(point[0] / BIN_PX);
    if (!column || column.key !== key) {
      flush();
      column = { key, first: point, low: point, high: point, last: point };
    } else {
      if (point[1] < column.low[1]) column.low = point;
      if (point[1] > column.high[1]) column.high = point;
      column.last = point;
    }
  }
  flush();
  return shown;
}

function path(context, points) {
  context.beginPath();
  for (const point of points) context.lineTo(...point);
  context.stroke();
}

/** A large bound or stated error does not flatten the errors: the scale holds the errors, and these up to four times as much. */
function extent(rows, axis) {
  const errors = rows.map((row) => Math.abs(row.error?.[axis] ?? NaN)).filter(Number.isFinite);
  const bounds = rows.flatMap((row) => [row.bound?.[axis], row.stated?.[axis]]).filter(Number.isFinite);
  const most = errors.length ? Math.max(...errors) : 0, bound = bounds.length ? Math.max(...bounds) : 0;
  return { most, bound, least: Math.min(...errors.filter((e) => e > 0), ...bounds, Infinity) };
}

function linearScale(rows, axis, box) {
  const { most, bound } = extent(rows, axis);
  const top = 1.1 * (Math.max(most, most ? Math.min(1.2 * bound, 4 * most) : 1.2 * bound) || 1);
  const unit = 10 ** Math.floor(Math.log10(top)), step = [0.5, 1, 2, 5].map((k) => k * unit).find((s) => top / s <= 2.2) ?? 10 * unit;
  const ticks = [];
  for (let k = -Math.floor(top / step); k <= Math.floor(top / step); k++) ticks.push(k * step);
  return { ticks, y: (value) => box.top + (box.high * (top - value)) / (2 * top) };
}

function logScale(rows, axis, box) {
  const { most, bound, least } = extent(rows, axis);
  const high = Math.ceil(Math.log10(1.3 * (Math.max(most, bound) || 1)));
  const low = Math.min(high - 2, Math.max(high - 5, Math.floor(Math.log10(Number.isFinite(least) ? least : 0.01))));
  const ticks = Array.from({ length: high - low + 1 }, (_, k) => 10 ** (low + k));
  return { ticks, y: (value) => box.top + (box.high * (high - Math.log10(Math.max(value, 1e-12)))) / (high - low) };
}
