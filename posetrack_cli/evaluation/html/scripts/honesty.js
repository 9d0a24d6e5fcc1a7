/* Reliability diagram and ROC curve of the confidence. */

const HONESTY_HEIGHT = 300;
const LARGEST_SPOT = 8, SMALLEST_SPOT = 2;
const PERCENT_AXES = { height: HONESTY_HEIGHT, xDomain: () => [-2, 102], yDomain: [-4, 104], diagonal: [0, 100], yText: (tick) => `${tick}` };

/** Results and pools with judged frames; pools use the line style of ground truth. */
function judgedOnes(store) {
  const results = store.results.map((result) => ({
    index: result.index, name: result.name, honesty: result.honesty, faded: stepsBack(store, result),
  }));
  const pools = store.pools.map((pool) => ({ index: 0, name: pool.name, honesty: pool.honesty, kind: "truth solid" }));
  return [...results, ...pools].filter((one) => one.honesty);
}

function showHonesty(store, reliabilityParent, rocParent) {
  showPercentPlot(store, reliabilityParent, reliabilityLine, {
    label: "Reliability diagram: share of correct frames over confidence",
    xTitle: "confidence, %", yTitle: "correct frames, %", title: (x) => `confidence ${formatValue(x, "%")}`,
  }, "Each point is one of ten confidence bins; its size shows the number of frames. Dashed: perfect calibration.");
  showPercentPlot(store, rocParent, rocLine, {
    label: "ROC curve: share of correct over share of wrong frames kept",
    xTitle: "wrong frames kept, %", yTitle: "correct frames kept, %", title: (x) => `${formatValue(x, "%")} of the wrong frames kept`,
  }, "Frames kept when those below a confidence threshold are dropped. Dashed: chance level.");
}

function showPercentPlot(store, parent, lineOf, options, remark) {
  const lines = () => judgedOnes(store).map(lineOf).filter((line) => line);
  const first = lines();
  if (!first.length) {
    const judged = judgedOnes(store).length > 0;
    parent.append(makeMissing(judged ? "All frames are correct, or all are wrong." : "No ground truth."));
    return;
  }
  if (first.length > 1) {
    parent.append(makeElement("div", { class: "legend" }, ...first.map((line) =>
      makeElement("span", {}, makeSwatch(line.kind ?? "", line.index), makeElement("bdi", {}, line.name)))));
  }
  const plot = new Plot(parent, { ...PERCENT_AXES, ...options, lines: first });
  store.on("result", () => plot.update({ lines: lines() }));
  parent.append(makeElement("p", { class: "remark" }, remark));
}

const percent = (share) => 100 * share;

function reliabilityLine({ honesty, ...line }) {
  const most = Math.max(...honesty.count);
  return {
    ...line, x: honesty.confidence.map(percent), y: honesty.right.map(percent), unit: "%",
    radius: honesty.count.map((count) => Math.max(SMALLEST_SPOT, LARGEST_SPOT * Math.sqrt(count / most))),
    noteOf: (i) => `of ${honesty.count[i]} frames`,
  };
}

function rocLine({ honesty: { roc }, ...line }) {
  if (!roc) return null;
  return {
    ...line, x: roc.wrongKept.map(percent), y: roc.rightKept.map(percent), unit: "%",
    name: `${line.name} (area ${roc.area.toFixed(3)})`,
    noteOf: (i) => (roc.confidence[i] === null ? "none kept" : `confidence ≥ ${formatNumber(roc.confidence[i])}`),
  };
}
