/* Bar chart of the mean error and the 95th percentile of each joint or point of a result. */

const PART_ROW = 17, PART_TOP = 26;

class Parts {
  constructor(store, parent) {
    this.store = store;
    this.parent = parent;
    new ResizeObserver(() => parent.clientWidth !== this.width && this.show()).observe(parent);
    store.on("result", () => this.show());
    this.show();
  }

  show() {
    const { result } = this.store;
    this.width = this.parent.clientWidth;
    if (!result?.parts.length) {
      this.parent.replaceChildren(makeMissing("No ground truth with joints."));
    } else if (this.width) {
      const key = makeElement("p", { class: "remark" }, "Bar: mean; line: 95th percentile; mm.");
      this.parent.replaceChildren(makeElement("div", { class: "plot" }, this.drawing(result)), key);
    }
  }

  drawing({ parts, index, name }) {
    const left = 16 + 6.6 * Math.max(...parts.map((part) => part.label.length));
    const most = Math.max(...parts.map((part) => part.p95), 1e-9);
    const scale = new Scale([0, most], [left, this.width - 48]);
    const height = PART_TOP + PART_ROW * parts.length;
    const svg = makeSvg("svg", {
      role: "img", viewBox: `0 0 ${this.width} ${height}`, height, class: colourClass(index),
      "aria-label": `Mean error of ${parts.length} points of ${name}`,
    });
    const ticks = niceTicks(0, most, (this.width - left) / 70);
    tickTexts(ticks).forEach((text, i) => {
      const x = scale.at(ticks[i]);
      svg.append(makeSvg("line", { class: "grid", x1: x, x2: x, y1: PART_TOP - 6, y2: height }));
      svg.append(makeSvg("text", { x, y: PART_TOP - 11, "text-anchor": "middle" }, text));
    });
    parts.forEach((part, row) => svg.append(...this.row(part, scale, PART_TOP + PART_ROW * (row + 0.5))));
    return svg;
  }

  row(part, scale, y) {
    const end = scale.at(part.p95);
    return [
      makeSvg("text", { x: scale.range[0] - 8, y: y + 4, "text-anchor": "end" }, part.label),
      makeSvg("line", { class: "whisker", x1: scale.at(0), x2: end, y1: y, y2: y }),
      makeSvg("line", { class: "whisker", x1: end, x2: end, y1: y - 3, y2: y + 3 }),
      makeSvg("line", { class: "bar", x1: scale.at(0), x2: scale.at(part.mean), y1: y, y2: y }),
      makeSvg("text", { x: end + 6, y: y + 4 }, formatNumber(part.mean)),
    ];
  }
}
