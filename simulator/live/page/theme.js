// Light, dark, or as the system prefers; remembered by the browser.

import { recolour } from "./canvas.js";

const THEMES = ["auto", "light", "dark"], KEY = "boresight-theme";

export class Theme {
  constructor() {
    this.button = document.getElementById("theme");
    this.button.addEventListener("click", () => this.next());
    matchMedia("(prefers-color-scheme: dark)").addEventListener("change", recolour);
    this.#set(remembered() ?? "auto");
  }

  next() {
    this.#set(THEMES[(THEMES.indexOf(this.name) + 1) % THEMES.length]);
  }

  #set(name) {
    this.name = THEMES.includes(name) ? name : "auto";
    if (this.name === "auto") delete document.documentElement.dataset.theme;
    else document.documentElement.dataset.theme = this.name;
    this.button.textContent = `Theme: ${this.name}`;
    try {
      localStorage.setItem(KEY, this.name);
    } catch {
      // storage is denied: the choice lasts as long as the page
    }
    recolour();
  }
}

function remembered() {
  try {
    return localStorage.getItem(KEY);
  } catch {
    return null;
  }
}
