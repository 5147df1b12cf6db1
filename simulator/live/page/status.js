// The status line: one verdict in words and sign, the counts, and the solution's figures.

import { degrees, duration, fixed, hours, significant, words } from "./format.js";
import { ARCSEC } from "./vectors.js";

const byId = (id) => document.getElementById(id);

export class Status {
  #waiting = false;
  #missed = 0;

  constructor(store) {
    this.store = store;
    this.since = Date.now();
    for (const type of ["welcome", "link", "state", "solution", "truth", "frame"]) store.addEventListener(type, () => this.#request());
    store.addEventListener("frame", () => (this.#missed += store.frame.missed ?? 0));
    store.addEventListener("welcome", () => (this.#missed = 0));
    setInterval(() => store.link.state !== "open" && this.#request(), 500);
    store.addEventListener("link", () => (this.since = Date.now()));
  }

  #request() {
    if (this.#waiting) return;
    this.#waiting = true;
    requestAnimationFrame(() => {
      this.#waiting = false;
      this.#show();
    });
  }

  #show() {
    const { welcome, state, truth, solution, frame } = this.store;
    const [tone, text] = this.#verdict();
    byId("verdict").dataset.tone = tone;
    put("verdict-text", text);
    put("retry", this.#countdown());
    if (welcome) put("scenario", welcome.scenario);
    const now = frame ?? truth ?? solution;
    if (now) put("clock", `T+${duration(now.t_s)} · ${String(now.time).replace("T", " ").slice(0, 21)} UTC`);
    put("count-rate", fixed(state?.frame_rate_hz, 1));
    put("count-latency", solution?.latency_ms == null ? "–" : `${significant(solution.latency_ms, 2)} ms`);
    put("count-late", state?.late_frames ?? "–");
    put("count-missed", this.#missed);
    put("count-clients", state?.clients ?? "–");
    this.#figures(solution);
  }

  /** Tone and words. */
  #verdict() {
    const { link, state, solution, truth, solved, blinded } = this.store;
    if (link.state === "lost") {
      return ["bad", `Connection lost${link.reason ? ` (${link.reason})` : ""}`];
    }
    if (link.state !== "open") return ["wait", "Connecting …"];
    const held = state?.paused ? " · paused" : "";
    if (blinded) return ["bad", `Blinded${solution?.mode === "coasting" ? ", coasting" : ""}${held}`];
    if (!solution) return ["wait", state?.source === "external" ? "Waiting for an attitude from outside" : `Waiting for the first frame${held}`];
    if (!solved) return ["bad", `Lost: ${words(solution.status)}${solution.mode === "coasting" ? ", coasting" : ""}${held}`];
    if (truth?.index === solution.index) {
      if (truth.misidentified) return ["bad", `Solved, but a star is misidentified${held}`];
      if (truth.wrong) return ["bad", `Solved, but inconsistent and beyond the specification${held}`];
      if (truth.inconsistent) return ["warn", `Solved, but inconsistent with its covariance${held}`];
    }
    if (solution.mode === "lost_in_space") return ["warn", `Solved from the whole sky (lost in space)${held}`];
    return ["good", `${solution.mode === "tracking" ? "Tracking" : `Solved, ${words(solution.mode)}`}${held}`];
  }

  /** Beside the verdict, since a screen reader need not say every second. */
  #countdown() {
    const { link } = this.store;
    if (link.state !== "lost") return "";
    return `next try in ${Math.max(0, Math.ceil(link.wait_s - (Date.now() - this.since) / 1000))} s`;
  }

  #figures(solution) {
    const solved = Boolean(solution?.quaternion); // of the filter, also while it coasts
    put("sol-ra", solved ? hours(solution.ra_deg, 2) : "–");
    put("sol-dec", solved ? degrees(solution.dec_deg, 1) : "–");
    put("sol-roll", solved ? `${fixed(solution.roll_deg, 3)}°` : "–");
    const found = solution?.detections.length ?? 0, stars = solution?.stars ?? [];
    put("sol-stars", solution ? `${stars.length} of ${found}` : "–");
    const rms = Math.sqrt(stars.reduce((sum, star) => sum + star.residual_px ** 2, 0) / stars.length);
    put("sol-residual", this.store.solved && Number.isFinite(rms) ? `${significant(rms, 2)} px` : "–");
    const c = solved ? solution.covariance_rad2 : null;
    const cross = c ? Math.sqrt((c[0][0] + c[1][1]) / 2) / ARCSEC : NaN, about = c ? Math.sqrt(c[2][2]) / ARCSEC : NaN;
    put("sol-sigma", c ? `${significant(cross, 2)}″ / ${significant(about, 2)}″` : "–");
  }
}

function put(id, value) {
  const node = byId(id), text = String(value);
  if (node.textContent !== text) node.textContent = text;
}
