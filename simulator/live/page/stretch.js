// From digital numbers to brightness, as in the pictures of the reports (startracker/picture.py): the arcsinh of the signal
// in units of the noise, black two standard deviations below the sky.

const BLACK_SIGMA = 2, SOFT_SIGMA = 8, LEAST_RANGE_SIGMA = 25, WHITE_SHARE = 0.9995, FULL_SHARE = 0.8;
const counts = new Uint32Array(65536);

/** Sky, white level and robust noise of an image of 16 bits; a frame filled to `saturation` is shown as white as it is. */
export function levelsOf(pixels, saturation) {
  counts.fill(0);
  const stride = Math.max(1, Math.floor(pixels.length / 500000));
  let total = 0;
  for (let i = 0; i < pixels.length; i += stride, total++) counts[pixels[i]]++;
  const sky = quantile(0.5, total), top = quantile(WHITE_SHARE, total);
  if (sky > FULL_SHARE * saturation) return { sky: 0, top: saturation, noise: saturation / LEAST_RANGE_SIGMA };
  const noise = 1.4826 * medianDistance(sky, total) || 1;
  return { sky, top: Math.max(top, sky + LEAST_RANGE_SIGMA * noise), noise };
}

function quantile(share, total) {
  let sum = 0;
  for (let value = 0; value < 65536; value++) {
    sum += counts[value];
    if (sum >= share * total) return value;
  }
  return 65535;
}

function medianDistance(centre, total) {
  let sum = counts[centre];
  for (let distance = 0; distance < 65536; distance++) {
    if (distance) sum += (counts[centre - distance] ?? 0) + (counts[centre + distance] ?? 0);
    if (2 * sum >= total) {
      const inside = distance ? sum - (counts[centre - distance] ?? 0) - (counts[centre + distance] ?? 0) : 0;
      const share = (total / 2 - inside) / Math.max(1, sum - inside); // within the step: digital numbers are coarse
      return Math.max(0, distance - 0.5) + share * (distance ? 1 : 0.5);
    }
  }
  return 0;
}

/** Table of grey values as little-endian RGBA words, one for each digital number. */
export function tableOf({ sky, top, noise }) {
  const table = new Uint32Array(65536);
  const black = sky - BLACK_SIGMA * noise, soft = SOFT_SIGMA * noise, white = Math.asinh((top - black) / soft);
  for (let value = 0; value < 65536; value++) {
    const signal = Math.min(Math.max(value - black, 0), top - black);
    const grey = Math.round((255 * Math.asinh(signal / soft)) / white);
    table[value] = 0xff000000 | (grey << 16) | (grey << 8) | grey;
    if (value > top) {
      table.fill(table[value], value);
      break;
    }
  }
  return table;
}

/** Pixels of a frame message as Uint16Array; null for a format the page does not show. */
export function pixelsOf(frame) {
  const bytes = frame.data;
  if (frame.format !== "raw16" || bytes.byteLength !== 2 * frame.width * frame.height) return null;
  return new Uint16Array(bytes); // little-endian, as every machine with a browser
}
