/* Linear scales and their ticks. */

/** About `count` multiples of 1, 2 or 5 times a power of ten in [low, high]. */
function niceTicks(low, high, count) {
  const raw = (high - low) / Math.max(1, count);
  if (!(raw > 0)) return [low];
  const power = 10 ** Math.floor(Math.log10(raw));
  const step = power * ([1, 2, 5].find((factor) => factor * power >= raw * 0.999) ?? 10);
  const ticks = [];
  for (let i = Math.ceil(low / step - 1e-9); i * step <= high + 1e-9 * step; i++) ticks.push(i * step);
  return ticks;
}

/** The largest 1, 2 or 5 times a power of ten that does not exceed a value. */
function roundBelow(value) {
  const power = 10 ** Math.floor(Math.log10(value));
  return [5, 2, 1].find((factor) => factor * power <= value) * power;
}

/** Ticks as text, with the number of digits that their distance requires. */
function tickTexts(ticks) {
  const step = ticks.length > 1 ? ticks[1] - ticks[0] : Math.abs(ticks[0]) || 1;
  const digits = Math.min(8, Math.max(0, -Math.floor(Math.log10(step) + 1e-9)));
  const large = Math.max(...ticks.map(Math.abs)) >= 1e6;
  return ticks.map((tick) => (large ? tick.toExponential(2) : (tick || 0).toFixed(digits)).replace("-", "−"));
}

/** Maps [d0, d1] to [r0, r1]. */
class Scale {
  constructor(domain, range) {
    this.domain = domain;
    this.range = range;
    this.factor = (range[1] - range[0]) / (domain[1] - domain[0]);
  }

  at(value) {
    return this.range[0] + (value - this.domain[0]) * this.factor;
  }

  inverse(pixel) {
    return this.domain[0] + (pixel - this.range[0]) / this.factor;
  }
}

/** A padded domain that is not empty; starts at zero if requested and no value is negative. */
function paddedDomain(low, high, fromZero) {
  if (!(high >= low)) return [0, 1];
  const air = high > low ? 0.05 * (high - low) : 0.5 * Math.abs(high) || 1;
  return [fromZero && low >= 0 ? 0 : low - air, high + air];
}
