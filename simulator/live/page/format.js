// Numbers as the page writes them. A missing value is an en dash.

const NONE = "–";
const known = (value) => typeof value === "number" && Number.isFinite(value);

/** `value` with about `digits` significant digits, without an exponent between 1e-4 and 1e6. */
export function significant(value, digits = 3) {
  if (!known(value)) return NONE;
  if (value === 0) return "0";
  const size = Math.abs(value);
  if (size < 1e-4 || size >= 1e6) return value.toExponential(Math.max(0, digits - 1)).replace("e+", "e").replace("-", "−");
  const decimals = Math.max(0, digits - 1 - Math.floor(Math.log10(size)));
  return minus(value.toFixed(Math.min(decimals, 8)));
}

export const minus = (text) => String(text).replace("-", "−");
export const fixed = (value, decimals) => (known(value) ? minus(value.toFixed(decimals)) : NONE);

/** Right ascension as 05h 14m 32.3s. */
export function hours(raDeg, decimals = 1) {
  if (!known(raDeg)) return NONE;
  const unit = 10 ** decimals, seconds = Math.round((((raDeg % 360) + 360) % 360) * 240 * unit) % (86400 * unit);
  const h = Math.floor(seconds / (3600 * unit)), m = Math.floor(seconds / (60 * unit)) % 60;
  const s = (seconds % (60 * unit)) / unit;
  return `${two(h)}h ${two(m)}m ${s.toFixed(decimals).padStart(decimals ? 3 + decimals : 2, "0")}s`;
}

/** Declination as −08° 12′ 06″. */
export function degrees(decDeg, decimals = 0) {
  if (!known(decDeg)) return NONE;
  const unit = 10 ** decimals, seconds = Math.round(Math.abs(decDeg) * 3600 * unit);
  const d = Math.floor(seconds / (3600 * unit)), m = Math.floor(seconds / (60 * unit)) % 60;
  const s = ((seconds % (60 * unit)) / unit).toFixed(decimals).padStart(decimals ? 3 + decimals : 2, "0");
  return `${decDeg < 0 ? "−" : "+"}${two(d)}° ${two(m)}′ ${s}″`;
}

/** Seconds of the mission as 1 h 02 min 03.4 s. */
export function duration(seconds) {
  if (!known(seconds)) return NONE;
  const tenths = Math.round(Math.abs(seconds) * 10);
  const h = Math.floor(tenths / 36000), m = Math.floor(tenths / 600) % 60, s = (tenths % 600) / 10;
  const text = h ? `${h} h ${two(m)} min ${s.toFixed(1).padStart(4, "0")} s` : m ? `${m} min ${s.toFixed(1).padStart(4, "0")} s` : `${s.toFixed(1)} s`;
  return (seconds < 0 ? "−" : "") + text;
}

/** Words of a status: too_few_stars as "too few stars". */
export const words = (name) => String(name ?? "").replaceAll("_", " ");

const two = (value) => String(value).padStart(2, "0");
