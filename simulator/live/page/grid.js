// The grid of right ascension and declination in the frame, from the solved attitude.

import { SMALL, label } from "./canvas.js";
import { DEG, directionOf, radecOf, turned, turnedBack } from "./vectors.js";

const STEPS_DEG = [0.1, 0.2, 0.5, 1, 2, 5, 10, 15, 30], LINES = 5, HALO = "rgb(5 7 10 / 0.85)", COLOUR = "#3cc79a";
const HOUR_STEPS_DEG = [0.25, 0.5, 1.25, 2.5, 5, 7.5, 15, 30, 45, 90]; // 1, 2, 5, 10, 20, 30 minutes of time, 1, 2, 3, 6 hours

/** Draw the grid; `at` maps detector pixels to the canvas, of the given size. */
export function drawGrid(context, attitude, lens, at, size) {
  const centre = turnedBack(attitude, [0, 0, 1]), [ra0, dec0] = radecOf(centre);
  const corner = lens.directionOf(0, 0), radius = Math.acos(Math.min(1, corner[2])) / DEG;
  const across = (2 * radius) / Math.SQRT2;
  const decStep = STEPS_DEG.find((step) => across / step <= LINES) ?? 30;
  const low = Math.max(-90, dec0 - radius), high = Math.min(90, dec0 + radius);
  const polar = Math.max(Math.abs(low), Math.abs(high)) > 85;
  const width = polar ? 180 : Math.min(180, radius / Math.cos(Math.max(Math.abs(low), Math.abs(high)) * DEG));
  const raStep = polar ? 30 : HOUR_STEPS_DEG.find((step) => across / Math.cos(dec0 * DEG) / step <= LINES) ?? 90;
  const draw = (points, text) => line(context, points, attitude, lens, at, size, text);
  context.font = SMALL;
  for (let dec = Math.ceil(low / decStep) * decStep; dec <= high; dec += decStep) {
    if (Math.abs(dec) > 89.9) continue;
    draw(range(ra0 - width, ra0 + width, 60).map((ra) => directionOf(ra, dec)), decText(dec, decStep));
  }
  for (let ra = Math.ceil((ra0 - width) / raStep) * raStep; ra < ra0 + width; ra += raStep) {
    draw(range(low, high, 40).map((dec) => directionOf(ra, dec)), raText(ra));
  }
}

const range = (from, to, count) => Array.from({ length: count + 1 }, (_, i) => from + ((to - from) * i) / count);

function decText(dec, step) {
  const minutes = Math.round(Math.abs(dec) * 60), sign = dec < -1e-9 ? "−" : "+";
  return `${sign}${Math.floor(minutes / 60)}°${step < 1 ? ` ${minutes % 60}′` : ""}`;
}

function raText(raDeg) {
  const minutes = ((Math.round(raDeg * 4) % 1440) + 1440) % 1440;
  return `${Math.floor(minutes / 60)}h${minutes % 60 ? ` ${minutes % 60}m` : ""}`;
}

/** One line, and its label at the first point well inside the canvas. */
function line(context, directions, attitude, lens, at, [width, height], text) {
  let before = null, place = null;
  context.lineWidth = 1;
  context.strokeStyle = "rgb(60 199 154 / 0.6)";
  context.beginPath();
  for (const direction of directions) {
    const pixel = lens.pixelOf(turned(attitude, direction));
    const here = pixel && at(...pixel);
    if (here && before) {
      context.moveTo(...before);
      context.lineTo(...here);
      place ??= entry(before, here, width, height);
    }
    before = here;
  }
  context.stroke();
  if (!place) return;
  context.textBaseline = "middle";
  const long = context.measureText(text).width;
  label(context, text, Math.min(Math.max(place[0] - long / 2, 4), width - long - 4), Math.min(Math.max(place[1], 9), height - 9), COLOUR, HALO);
}

/** Where a segment comes inside the canvas; null if it does not. */
function entry(from, to, width, height) {
  const inside = ([x, y]) => x >= 0 && y >= 0 && x <= width && y <= height;
  if (!inside(to)) return null;
  if (inside(from)) return to;
  let [a, b] = [from, to];
  for (let i = 0; i < 12; i++) {
    const middle = [(a[0] + b[0]) / 2, (a[1] + b[1]) / 2];
    if (inside(middle)) b = middle;
    else a = middle;
  }
  return b;
}
