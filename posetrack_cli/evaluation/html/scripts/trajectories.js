/* Plots of selected components of a result over time: estimate, ground truth and 90 % band. */

class Trajectories {
  constructor(store, select, legend, parent) {
    Object.assign(this, { store, select, legend, parent, plots: [] });
    select.addEventListener("change", () => this.show());
    store.on("result", () => this.fillChoices());
    this.fillChoices();
  }

  /** Groups of components of the selected result; the selected group is kept if possible. */
  fillChoices() {
    const { result } = this.store;
    const chosen = this.select.value;
    const groups = [...new Set(result?.components.map((one) => one.group) ?? [])];
    this.select.replaceChildren(...groups.map((group) => makeElement("option", { value: group }, group)));
    if (groups.includes(chosen)) this.select.value = chosen;
    this.select.parentElement.hidden = !groups.length;
    this.show();
  }

  show() {
    const { result } = this.store;
    this.plots.forEach((plot) => plot.dispose());
    const shown = result?.components.filter((one) => one.group === this.select.value) ?? [];
    this.parent.replaceChildren(...(shown.length ? [] : [makeMissing("No trajectory.")]));
    this.plots = shown.map((one) => this.plot(result, one));
    this.showLegend(result, shown);
  }

  plot(result, one) {
    const { store } = this;
    const x = result.times(one), at = unpack(one.at), { gaps, index } = result;
    const estimate = {
      x, y: unpack(one.estimate), half: one.halfWidth && unpack(one.halfWidth), unit: one.unit, index, gaps,
      name: "estimate", frameOf: (i) => result.frame(at[i]),
    };
    const truth = one.truth && { x, y: unpack(one.truth), unit: one.unit, index, gaps, name: "ground truth", kind: "truth" };
    return new Plot(this.parent, {
      lines: truth ? [estimate, truth] : [estimate], spans: [...spansOf(result, "gaps", "gap"), ...spansOf(result, "lost", "lost")],
      store, height: 210, label: `Plot of ${one.group}, ${one.label}, over time`, yTitle: axisTitle(one.label, one.unit),
      xTitle: "time, s", xDomain: () => paddedSpan(result.span ?? [0, 1]), title: formatTime,
      onPick: (time) => store.set("now", time),
    });
  }

  showLegend(result, shown) {
    const key = (kind, text) => makeElement("span", {}, makeSwatch(kind, result.index), text);
    this.legend.replaceChildren(...(shown.length ? [
      key("", "estimate"),
      ...(shown.some((one) => one.truth) ? [key("truth", "ground truth")] : [makeElement("span", {}, "no ground truth")]),
      ...(shown.some((one) => one.halfWidth) ? [key("band", "90 % band")] : [makeElement("span", {}, "no variance")]),
      ...(result.lost.length ? [key("lost", "lost")] : []),
    ] : []));
  }
}
