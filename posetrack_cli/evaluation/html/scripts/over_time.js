/* Plot of errors and other quantities of all results over time; lost frames are shaded. */

const MEAN_ERROR = "joint_error_mm", LARGEST_ERROR = "largest_joint_error_mm", BOTH_ERRORS = "both";
const MOST_PAIRED_RESULTS = 3;

class OverTime {
  constructor(store, select, parent) {
    this.store = store;
    this.select = select;
    this.parent = parent;
    this.hidden = new Set();
    const choices = this.choices();
    if (!choices.length) {
      select.parentElement.hidden = true;
      parent.append(makeMissing(store.results.some((result) => result.frames) ? "No per-frame values." : "No frames."));
      return;
    }
    select.append(...choices.map(([value, text]) => makeElement("option", { value }, text)));
    select.value = choices[0][0] === BOTH_ERRORS && store.results.length > MOST_PAIRED_RESULTS ? MEAN_ERROR : choices[0][0];
    select.addEventListener("change", () => this.show());
    this.legend = makeElement("div", { class: "legend" });
    parent.append(this.legend);
    store.on("result", () => this.show());
    this.show();
  }

  /** Quantities of all results in catalogue order; mean and largest error together come first. */
  choices() {
    const found = new Map();
    for (const result of this.store.results) {
      for (const [name, one] of Object.entries(result.quantities)) found.set(name, axisTitle(one.label, one.unit));
    }
    const both = found.has(MEAN_ERROR) && found.has(LARGEST_ERROR);
    const errors = [...found].filter(([name]) => name === MEAN_ERROR);
    const others = [...found].filter(([name]) => name !== MEAN_ERROR);
    return [...(both ? [[BOTH_ERRORS, "joint error, mean and largest, mm"]] : []), ...errors, ...others];
  }

  get names() {
    return this.select.value === BOTH_ERRORS ? [MEAN_ERROR, LARGEST_ERROR] : [this.select.value];
  }

  show() {
    this.showLegend();
    const options = { ...this.content(), yTitle: this.select.selectedOptions[0].textContent };
    if (this.plot) return this.plot.update(options);
    const { store } = this;
    this.plot = new Plot(this.parent, {
      ...options, store, height: 300, label: "Plot of a quantity over time", xDomain: () => paddedSpan(store.span),
      xTitle: timeTitle(store), title: formatTime, onPick: (time) => store.set("now", time),
    });
  }

  content() {
    const single = this.store.results.length === 1;
    const shown = this.store.results.filter((result) => !this.hidden.has(result.index));
    const lines = shown.flatMap((result) => this.names.flatMap((name, i) => this.line(result, name, i)));
    const spans = single ? [...spansOf(shown[0], "gaps", "gap"), ...spansOf(shown[0], "lost", "lost")] : [];
    const rasters = single ? [] : shown.filter((result) => result.lost.length).map((result) => ({ index: result.index, spans: result.lost }));
    return { lines, spans, rasters, fromZero: true };
  }

  line(result, name, place) {
    const one = result.quantities[name];
    if (!one) return [];
    const at = unpack(one.at);
    const kinds = { [MEAN_ERROR]: "mean", [LARGEST_ERROR]: "largest" };
    const both = this.names.length > 1;
    const alone = this.store.results.length === 1;
    return [{
      x: result.times(one), y: unpack(one.value), unit: one.unit, index: result.index, gaps: result.gaps,
      kind: both && place ? "thin" : "", faded: stepsBack(this.store, result),
      name: [alone ? "" : result.name, both ? kinds[name] : alone ? one.label : ""].filter(Boolean).join(", "),
      frameOf: (i) => result.frame(at[i]),
    }];
  }

  showLegend() {
    const { results } = this.store;
    const keys = results.length === 1 ? this.plainKeys(results[0]) : results.map((result) => this.toggle(result));
    if (results.length > 1 && results.some((result) => result.lost.length)) keys.push(makeElement("span", {}, "bars above: lost frames"));
    if (results.length > 1 && this.names.length > 1) keys.push(makeElement("span", {}, "thin: largest"));
    this.legend.replaceChildren(...keys);
  }

  plainKeys(result) {
    const key = (kind, text) => makeElement("span", {}, makeSwatch(kind, result.index), text);
    const lines = this.names.length > 1 ? [key("", "mean of the joints"), key("thin", "largest (thin line)")] : [];
    return [
      ...lines,
      ...(result.lost.length ? [key("lost", "lost")] : []),
      ...(result.gaps.length ? [key("gap", "missing frames")] : []),
    ];
  }

  toggle(result) {
    const box = makeElement("input", { type: "checkbox" });
    box.checked = !this.hidden.has(result.index);
    box.addEventListener("change", () => {
      if (box.checked) this.hidden.delete(result.index); else this.hidden.add(result.index);
      this.plot.update(this.content());
    });
    return makeElement("label", {}, box, makeSwatch("", result.index), makeElement("bdi", {}, result.name));
  }
}

function spansOf(result, field, kind) {
  return result[field].map(([from, to]) => ({ kind, from, to }));
}

/** A time span, padded if it is empty. */
function paddedSpan([from, to]) {
  return to > from ? [from, to] : [from - 0.5, to + 0.5];
}

function timeTitle(store) {
  if (store.results.length < 2 || store.sharedTime) return "time since the first frame, s";
  return "time since the first frame of each result, s";
}
