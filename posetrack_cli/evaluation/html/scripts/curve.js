/* The field's curve: share of frames whose largest joint error is below D. */

function showCurve(store, parent) {
  const curves = () => store.results.filter((result) => result.curve).map((result) => ({
    x: result.curve.thresholds, y: result.curve.share.map((share) => 100 * share), unit: "%", index: result.index,
    name: result.name, faded: stepsBack(store, result),
  }));
  const lines = curves();
  if (!lines.length) {
    parent.append(makeMissing("No truth with joints, so no errors to count."));
    return;
  }
  if (store.results.length > 1) {
    parent.append(makeElement("div", { class: "legend" }, ...lines.map((line) =>
      makeElement("span", {}, makeSwatch("", line.index), makeElement("bdi", {}, line.name)))));
  }
  const last = Math.max(...lines.map((line) => line.x[line.x.length - 1]));
  const plot = new Plot(parent, {
    lines, height: 300, label: "Plot of the share of frames whose largest joint error is below D",
    xDomain: () => [0, last || 1], yDomain: [0, 102], yText: (tick) => `${tick}`, xTitle: "D, mm", yTitle: "frames, %",
    title: (x) => `D = ${formatValue(x, "mm")}`,
  });
  store.on("result", () => plot.update({ lines: curves() }));
  parent.append(makeElement("p", { class: "remark" },
    "Share of the frames due whose largest joint error is below D. Frames that the result left out count as not below."));
}
