/* The axes of a plot: grid lines, ticks, titles with units. */

const PLOT_MARGIN = { top: 24, right: 14, bottom: 36 };
const PIXELS_PER_TICK = 62;

/** Grid lines with values on the left and the title above. */
function yAxis(scale, left, right, ticks, texts, title) {
  const shapes = ticks.flatMap((tick, i) => {
    const y = scale.at(tick);
    return [
      makeSvg("line", { class: "grid", x1: left, x2: right, y1: y, y2: y }),
      makeSvg("text", { x: left - 7, y: y + 4, "text-anchor": "end" }, texts[i]),
    ];
  });
  return [...shapes, makeSvg("text", { class: "axis-title", x: 0, y: 12 }, title)];
}

/** A line with ticks below it and the title at its end. */
function xAxis(scale, height, title) {
  const bottom = height - PLOT_MARGIN.bottom, [left, right] = scale.range;
  const ticks = niceTicks(...scale.domain, (right - left) / PIXELS_PER_TICK);
  const shapes = tickTexts(ticks).flatMap((text, i) => {
    const x = scale.at(ticks[i]);
    return [
      makeSvg("line", { class: "axis", x1: x, x2: x, y1: bottom, y2: bottom + 4 }),
      makeSvg("text", { x, y: bottom + 16, "text-anchor": "middle" }, text),
    ];
  });
  return [
    ...shapes,
    makeSvg("line", { class: "axis", x1: left, x2: right, y1: bottom, y2: bottom }),
    makeSvg("text", { class: "axis-title", x: right, y: height - 4, "text-anchor": "end" }, title),
  ];
}
