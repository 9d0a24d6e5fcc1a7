/* Access to the embedded data; arrays are decoded on first use. */

const ARRAY_TYPES = { u1: Uint8Array, i2: Int16Array, i4: Int32Array, u4: Uint32Array, f4: Float32Array };
const STATE_NAMES = ["tracking", "lost", "reinitialised"];
const decodedArrays = new WeakMap();

/** Returns the typed array of a packed array. */
function unpack(packed) {
  let array = decodedArrays.get(packed);
  if (!array) {
    const text = atob(packed.data);
    const bytes = new Uint8Array(text.length);
    for (let i = 0; i < text.length; i++) bytes[i] = text.charCodeAt(i);
    array = new ARRAY_TYPES[packed.type](bytes.buffer);
    decodedArrays.set(packed, array);
  }
  return array;
}

/** A result; its lines refer to frames by their index in the table of kept frames. */
class Result {
  constructor(data, index, tickSeconds) {
    Object.assign(this, data);
    this.index = index;
    this.tickSeconds = tickSeconds;
  }

  /** Time of a kept frame, s. */
  time(place) {
    return unpack(this.kept.ticks)[place] * this.tickSeconds;
  }

  /** Number of a kept frame in the recording. */
  frame(place) {
    return unpack(this.kept.frames)[place];
  }

  /** Status of a kept frame. */
  state(place) {
    return STATE_NAMES[unpack(this.kept.states)[place]];
  }

  /** First and last time, s; null for an empty result. */
  get span() {
    const ticks = unpack(this.kept.ticks);
    return ticks.length ? [this.time(0), this.time(ticks.length - 1)] : null;
  }

  /** Times, s, of the frames of a line. */
  times(line) {
    if (!line.times) {
      const ticks = unpack(this.kept.ticks);
      line.times = Float64Array.from(unpack(line.at), (place) => ticks[place] * this.tickSeconds);
    }
    return line.times;
  }
}

/** Index of the value nearest to x in an increasing array; -1 if it is empty. */
function nearestIndex(values, x) {
  let low = 0, high = values.length - 1;
  if (high < 0) return -1;
  while (high - low > 1) {
    const middle = (low + high) >> 1;
    if (values[middle] < x) low = middle; else high = middle;
  }
  return x - values[low] <= values[high] - x ? low : high;
}

/** Shared state of the page: selected result, current time, visible time span. Notifies listeners of changes. */
class Store {
  constructor(results) {
    this.results = results;
    this.result = results[0] ?? null;
    this.now = null;
    this.window = null;
    this.listeners = { result: [], now: [], window: [] };
  }

  /** Adds a listener; returns a function that removes it. */
  on(what, listener) {
    this.listeners[what].push(listener);
    return () => {
      this.listeners[what] = this.listeners[what].filter((other) => other !== listener);
    };
  }

  set(what, value) {
    if (this[what] === value) return;
    this[what] = value;
    for (const listener of this.listeners[what]) listener(value);
  }

  /** Time span of all results, s. */
  get span() {
    const spans = this.results.map((result) => result.span).filter((span) => span);
    if (!spans.length) return [0, 1];
    return [Math.min(...spans.map((span) => span[0])), Math.max(...spans.map((span) => span[1]))];
  }
}
