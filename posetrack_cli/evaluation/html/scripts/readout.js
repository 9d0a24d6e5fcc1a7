/* Read-out of a plot's cursor: a line, spots on the curves, and a box with time, frame and values. */

const MOST_READOUT_ROWS = 10;
const READOUT_DISTANCE = 14;

/** Limits many hits {line, i} to those nearest to a height, px, or to the first ones without a height. */
function nearestHits(hits, scale, height) {
  if (hits.length <= MOST_READOUT_ROWS) return hits;
  const away = ({ line, i }) => (height === undefined ? 0 : Math.abs(scale.at(line.y[i]) - height));
  const nearest = [...hits].sort((a, b) => away(a) - away(b)).slice(0, MOST_READOUT_ROWS);
  return hits.filter((hit) => nearest.includes(hit));
}

/** The line of the cursor, and a spot on each curve with a value there. */
function cursorShapes(hits, xs, ys, x) {
  const spots = hits.filter(({ line, i }) => Number.isFinite(line.y[i])).map(({ line, i }) => makeSvg("circle", {
    class: `spot ${line.kind ?? ""} ${colourClass(line.index ?? 0)}`, r: 3.5, cx: xs.at(line.x[i]), cy: ys.at(line.y[i]),
  }));
  return [makeSvg("line", { class: "cursor", x1: x, x2: x, y1: ys.range[1], y2: ys.range[0] }), ...spots];
}

/** Title, a row per hit, and the number of hidden hits. A common frame number is shown in the title. */
function fillReadout(box, title, hits, rest) {
  const frames = [...new Set(hits.flatMap(({ line, i }) => (line.frameOf ? [line.frameOf(i)] : [])))];
  box.replaceChildren(
    makeElement("div", {}, title, ...(frames.length === 1 ? [frameText(frames[0])] : [])),
    ...hits.map((hit) => readoutRow(hit, frames.length > 1)),
    ...(rest ? [makeElement("div", { class: "unit" }, `and ${rest} more`)] : []),
  );
  box.hidden = false;
}

function readoutRow({ line, i }, withFrame) {
  const half = line.half && Number.isFinite(line.half[i]) ? ` ± ${formatNumber(line.half[i])}` : "";
  const value = `${formatNumber(line.y[i])}${half}${line.unit ? ` ${line.unit}` : ""}`;
  const frame = withFrame && line.frameOf ? frameText(line.frameOf(i)) : "";
  const note = line.noteOf ? makeElement("span", { class: "unit" }, line.noteOf(i)) : "";
  const swatch = makeSwatch(line.kind ?? "", line.index ?? 0);
  return makeElement("div", {}, swatch, makeElement("bdi", {}, line.name), frame, makeElement("b", {}, value), note);
}

function frameText(frame) {
  return makeElement("span", { class: "unit" }, `frame ${frame}`);
}

/** Places the box next to the cursor, on the side with enough space. */
function placeReadout(box, x, width) {
  const own = box.offsetWidth;
  const left = x + READOUT_DISTANCE + own <= width ? x + READOUT_DISTANCE : x - READOUT_DISTANCE - own;
  box.style.left = `${Math.max(0, Math.min(left, width - own))}px`;
  box.style.top = `${PLOT_MARGIN.top + 4}px`;
}
