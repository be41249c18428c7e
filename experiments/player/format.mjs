// Numbers as people read them, and where an axis has its ticks.

export const clamp = (value, low, high) => Math.min(Math.max(value, low), high);

/** A number with about three digits; "–" for none. */
export function formatNumber(value) {
  if (value === null || value === undefined) return "–";
  if (value === 0) return "0";
  const size = Math.abs(value);
  if (size < 0.001 || size >= 1e5) return value.toExponential(1);
  return value.toFixed(size < 0.1 ? 4 : size < 10 ? 2 : size < 1000 ? 1 : 0);
}

/** A number with two decimals; "–" for none. */
export function formatPlain(value) {
  if (value === null || value === undefined) return "–";
  return (Math.abs(value) < 0.005 ? 0 : value).toFixed(2);
}

/** A time with one decimal, in seconds. */
export const formatTime = (seconds) => `${seconds.toFixed(1)} s`;

/** Ticks at 1, 2 or 5 times a power of ten, at most `most` of them. */
export function linearTicks(low, high, most) {
  const rough = (high - low) / most;
  const power = 10 ** Math.floor(Math.log10(rough));
  const stride = power * [1, 2, 5, 10].find((factor) => factor * power >= rough);
  const ticks = [];
  for (let place = Math.ceil(low / stride); place * stride <= high; place += 1) ticks.push(place * stride);
  return ticks;
}

/** Ticks at powers of ten, at most `most` of them. */
export function logTicks(low, high, most) {
  const first = Math.ceil(Math.log10(low));
  const last = Math.floor(Math.log10(high));
  const stride = Math.max(1, Math.ceil((last - first + 1) / most));
  const ticks = [];
  for (let power = first; power <= last; power += stride) ticks.push(10 ** power);
  return ticks;
}

/** What stands at a tick: 0.1, 10, 1000 as they are, smaller and larger ones as 1e-7. */
export function formatTick(value) {
  const size = Math.abs(value);
  if (value === 0 || (size >= 0.01 && size < 1e5)) return String(Number(value.toPrecision(6)));
  return value.toExponential(0).replace("+", "");
}
