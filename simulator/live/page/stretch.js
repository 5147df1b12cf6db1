// From digital numbers to brightness, as in the pictures of the reports (startracker/picture.py): the arcsinh of the signal
// in units of the noise, black two standard deviations below the sky.

const BLACK_SIGMA = 2, SOFT_SIGMA = 8, LEAST_RANGE_SIGMA = 25, WHITE_SHARE = 0.9995, FULL_SHARE = 0.8, MOST_SAMPLES = 500000;
const counts = new Uint32Array(65536), distances = new Uint32Array(131072);

/** Sky, white level and robust noise of an image of 16 bits; a frame filled to `saturation` is shown as white as it is. */
export function levelsOf(pixels, saturation) {
  counts.fill(0);
  const stride = Math.max(1, Math.floor(pixels.length / MOST_SAMPLES));
  let total = 0;
  for (let i = 0; i < pixels.length; i += stride, total++) counts[pixels[i]]++;
  const sky = quantile(counts, 0.5, total), top = quantile(counts, WHITE_SHARE, total);
  if (sky > FULL_SHARE * saturation) return { sky: 0, top: saturation, noise: saturation / LEAST_RANGE_SIGMA };
  const noise = 1.4826 * medianDistance(sky, total) || deviation(total) || 1;
  return { sky, top: Math.max(top, sky + LEAST_RANGE_SIGMA * noise), noise };
}

/** Quantile of a histogram of whole numbers, linear between neighbours as NumPy's. */
function quantile(histogram, share, total) {
  const rank = share * (total - 1), low = Math.floor(rank);
  let sum = 0, below = null;
  for (let value = 0; value < histogram.length; value++) {
    sum += histogram[value];
    if (below === null && sum > low) below = value;
    if (sum > Math.ceil(rank)) return below + (rank - low) * (value - below);
  }
  return below ?? 0;
}

/** Median distance from the sky, which is a multiple of one half. */
function medianDistance(sky, total) {
  distances.fill(0);
  for (let value = 0; value < 65536; value++) distances[Math.round(2 * Math.abs(value - sky))] += counts[value];
  return quantile(distances, 0.5, total) / 2;
}

function deviation(total) {
  let sum = 0, squares = 0;
  for (let value = 0; value < 65536; value++) {
    sum += value * counts[value];
    squares += value * value * counts[value];
  }
  return Math.sqrt(Math.max(0, squares / total - (sum / total) ** 2));
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
