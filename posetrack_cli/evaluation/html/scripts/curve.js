/* Error curve: share of frames whose largest, or mean, joint error is below D. */

const CURVES = { share: "largest joint error", meanShare: "mean joint error" };

function showCurve(store, select, parent) {
  select.append(...Object.entries(CURVES).map(([value, text]) => makeElement("option", { value }, text)));
  const curves = () => store.results.filter((result) => result.curve).map((result) => ({
    x: result.curve.thresholds, y: result.curve[select.value].map((share) => 100 * share), unit: "%",
    index: result.index, name: result.name, faded: stepsBack(store, result),
  }));
  const lines = curves();
  if (!lines.length) {
    select.parentElement.hidden = true;
    parent.append(makeMissing("No ground truth with joints."));
    return;
  }
  if (store.results.length > 1) {
    parent.append(makeElement("div", { class: "legend" }, ...lines.map((line) =>
      makeElement("span", {}, makeSwatch("", line.index), makeElement("bdi", {}, line.name)))));
  }
  const last = Math.max(...lines.map((line) => line.x[line.x.length - 1]));
  const plot = new Plot(parent, {
    lines, height: 300, label: "Plot of the share of frames whose joint error is below D",
    xDomain: () => [0, last || 1], yDomain: [0, 102], yText: (tick) => `${tick}`, xTitle: "D, mm", yTitle: "frames, %",
    title: (x) => `D = ${formatValue(x, "mm")}`,
  });
  store.on("result", () => plot.update({ lines: curves() }));
  select.addEventListener("change", () => plot.update({ lines: curves() }));
  parent.append(makeElement("p", { class: "remark" },
    "Share of the expected frames whose error is below D. Missed frames count as above D."));
}
