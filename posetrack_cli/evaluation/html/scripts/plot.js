/* Line plot with axes, bands, spans, a cursor with a read-out, and zoom in time. */

const DRAG_PIXELS = 5;
let plotCount = 0;

/**
 * Options: label (for screen readers), xTitle, yTitle, height, fromZero, xDomain (a function), yDomain, yText,
 * lines [{x, y, half, kind, index, name, unit, gaps, frameOf}], spans [{kind, from, to}],
 * (optionally with noteOf(i) for the read-out and radius, px, of its spots), diagonal [from, to],
 * rasters [{index, name, spans}], title(x) of the read-out, onPick(x), store (for a time axis).
 */
class Plot {
  constructor(parent, options) {
    this.options = { height: 240, spans: [], rasters: [], fromZero: false, ...options };
    this.clip = `plot-clip-${plotCount++}`;
    this.box = makeElement("div", {
      class: "plot", tabindex: "0", role: "application", "aria-label": `${this.options.label}. Arrow keys move the cursor.`,
    });
    this.svg = makeSvg("svg", { role: "img", "aria-label": this.options.label, height: this.options.height });
    this.tip = makeElement("div", { class: "tip", role: "status", hidden: true });
    this.reset = makeElement("button", { type: "button", class: "reset", hidden: true }, "Whole time");
    this.box.append(this.svg, this.reset, this.tip);
    parent.append(this.box);
    this.listen();
    this.draw();
  }

  /** Replaces the lines. */
  update(options) {
    Object.assign(this.options, options);
    this.hideTip();
    this.draw();
  }

  listen() {
    const { store } = this.options;
    this.observer = new ResizeObserver(() => this.box.clientWidth !== this.width && this.draw());
    this.observer.observe(this.box);
    this.endings = store
      ? [store.on("window", () => this.draw()), store.on("now", () => this.placeNow())]
      : [];
    this.reset.addEventListener("click", () => store?.set("window", null));
    this.svg.addEventListener("pointerdown", (event) => this.press(event));
    this.svg.addEventListener("pointermove", (event) => this.move(event));
    this.svg.addEventListener("pointerup", (event) => this.release(event));
    this.svg.addEventListener("pointerleave", () => this.pressed === undefined && this.hideTip());
    this.svg.addEventListener("pointercancel", () => this.endSelection());
    this.svg.addEventListener("dblclick", () => store?.set("window", null));
    this.box.addEventListener("keydown", (event) => this.key(event));
    this.box.addEventListener("blur", () => this.hideTip());
  }

  dispose() {
    this.observer.disconnect();
    this.endings.forEach((end) => end());
    this.box.remove();
  }

  get xDomain() {
    const { store, xDomain } = this.options;
    return store?.window ?? xDomain();
  }

  /* drawing */

  draw() {
    const width = this.box.clientWidth;
    if (!width) return;
    this.width = width;
    const { height } = this.options;
    const [yTicks, yTexts] = this.prepareY(height);
    const left = 16 + 7 * Math.max(...yTexts.map((text) => text.length));
    const right = width - PLOT_MARGIN.right;
    this.xs = new Scale(this.xDomain, [left, right]);
    this.svg.replaceChildren(
      this.clipPath(left, width, height),
      ...yAxis(this.ys, left, right, yTicks, yTexts, this.options.yTitle),
      ...xAxis(this.xs, height, this.options.xTitle),
      makeSvg("g", { "clip-path": `url(#${this.clip})` }, ...this.spanShapes(), ...this.diagonalShapes(), ...this.lineShapes()),
    );
    this.svg.setAttribute("viewBox", `0 0 ${width} ${height}`);
    this.nowLine = this.verticalLine("now");
    this.cursor = makeSvg("g", { visibility: "hidden" });
    this.selection = makeSvg("rect", { class: "selection", y: PLOT_MARGIN.top, visibility: "hidden" });
    this.selection.setAttribute("height", height - PLOT_MARGIN.top - PLOT_MARGIN.bottom);
    this.svg.append(this.nowLine, this.cursor, this.selection);
    this.reset.hidden = !this.options.store?.window;
    this.placeNow();
  }

  prepareY(height) {
    const { lines, fromZero, yDomain, yText } = this.options;
    const [low, high] = valueExtent(lines, this.xDomain);
    const room = Math.min(typicalHalfWidth(lines), 3 * (high - low) || Infinity);
    const domain = yDomain ?? paddedDomain(low - (room || 0), high + (room || 0), fromZero);
    this.ys = new Scale(domain, [height - PLOT_MARGIN.bottom, PLOT_MARGIN.top]);
    const ticks = niceTicks(domain[0], domain[1], height / 48);
    return [ticks, yText ? ticks.map(yText) : tickTexts(ticks)];
  }

  clipPath(left, width, height) {
    const rect = makeSvg("rect", {
      x: left, y: PLOT_MARGIN.top - 1, width: Math.max(0, width - left - PLOT_MARGIN.right + 1),
      height: height - PLOT_MARGIN.top - PLOT_MARGIN.bottom + 2,
    });
    return makeSvg("clipPath", { id: this.clip }, rect);
  }

  spanShapes() {
    const { spans, rasters, height } = this.options;
    const full = height - PLOT_MARGIN.top - PLOT_MARGIN.bottom;
    const strip = Math.min(6, full / 3 / Math.max(1, rasters.length));
    const shape = (kind, from, to, top, tall) => {
      const x = this.xs.at(from);
      return makeSvg("rect", { class: kind, x, y: top, width: Math.max(1.5, this.xs.at(to) - x), height: tall });
    };
    const shown = spans.map((one) => shape(one.kind, one.from, one.to, PLOT_MARGIN.top, full));
    rasters.forEach(({ index, spans: lost }, place) => {
      const top = PLOT_MARGIN.top + place * strip;
      lost.forEach(([from, to]) => shown.push(shape(`lost raster ${colourClass(index)}`, from, to, top, strip - 1)));
    });
    return shown;
  }

  /** The line y = x. */
  diagonalShapes() {
    if (!this.options.diagonal) return [];
    const [low, high] = this.options.diagonal;
    return [makeSvg("line", {
      class: "diagonal", x1: this.xs.at(low), x2: this.xs.at(high), y1: this.ys.at(low), y2: this.ys.at(high),
    })];
  }

  lineShapes() {
    const bands = [], paths = [];
    const faded = this.options.lines.filter((line) => line.faded);
    for (const line of [...this.options.lines.filter((one) => !one.faded), ...faded]) {  // drawn in reverse order, so that the first line is on top
      const wide = (line.gaps ?? []).filter(([from, to]) => this.xs.at(to) - this.xs.at(from) >= 2);
      const runs = unbrokenRuns(line.x, line.y, visibleRange(line.x, this.xs.domain), wide);
      const colour = colourClass(line.index ?? 0);
      if (line.half) {
        const d = bandPath(this.xs, this.ys, line.x, line.y, line.half, runs);
        bands.push(makeSvg("path", { class: `band ${colour}`, d }));
      }
      const d = linePath(this.xs, this.ys, line.x, line.y, runs);
      paths.unshift(makeSvg("path", { class: `line ${line.kind ?? ""} ${line.faded ? "faded" : ""} ${colour}`, d, "stroke-dasharray": line.kind === "truth" ? null : dashes(line.index ?? 0) }));
    }
    return [...bands, ...paths, ...this.options.lines.flatMap((line) => this.spotShapes(line))];
  }

  /** Spots on the points of a line with radii. */
  spotShapes(line) {
    if (!line.radius) return [];
    const kind = `spot ${line.kind ?? ""} ${line.faded ? "faded" : ""} ${colourClass(line.index ?? 0)}`;
    return Array.from(line.radius, (r, i) => makeSvg("circle", { class: kind, r, cx: this.xs.at(line.x[i]), cy: this.ys.at(line.y[i]) }));
  }

  verticalLine(kind) {
    return makeSvg("line", {
      class: kind, y1: PLOT_MARGIN.top, y2: this.options.height - PLOT_MARGIN.bottom, visibility: "hidden",
    });
  }

  /** Marks the current time of the 3D view. */
  placeNow() {
    const now = this.options.store?.now;
    if (!this.nowLine) return;
    const shown = now !== null && now !== undefined && now >= this.xs.domain[0] && now <= this.xs.domain[1];
    this.nowLine.setAttribute("visibility", shown ? "visible" : "hidden");
    if (shown) this.nowLine.setAttribute("transform", `translate(${this.xs.at(now).toFixed(1)} 0)`);
  }

  /* pointer and keys */

  valueAt(event) {
    const box = this.svg.getBoundingClientRect();
    const [left, right] = this.xs.range;
    return this.xs.inverse(Math.min(right, Math.max(left, event.clientX - box.left)));
  }

  press(event) {
    this.pressed = event.pointerType === "touch" ? undefined : { x: this.valueAt(event), at: event.clientX };
    if (this.pressed && this.options.store) this.svg.setPointerCapture(event.pointerId);
    this.showTip(this.valueAt(event), this.heightOf(event));
  }

  heightOf(event) {
    return event.clientY - this.svg.getBoundingClientRect().top;
  }

  move(event) {
    const value = this.valueAt(event);
    const dragged = this.pressed && Math.abs(event.clientX - this.pressed.at) > DRAG_PIXELS;
    if (!dragged || !this.options.store) return this.showTip(value, this.heightOf(event));
    const [from, to] = [this.pressed.x, value].sort((a, b) => a - b).map((x) => this.xs.at(x));
    this.selection.setAttribute("x", from);
    this.selection.setAttribute("width", to - from);
    this.selection.setAttribute("visibility", "visible");
    this.hideTip();
  }

  release(event) {
    const value = this.valueAt(event);
    const dragged = this.pressed && Math.abs(event.clientX - this.pressed.at) > DRAG_PIXELS;
    const from = this.pressed?.x;
    this.endSelection();
    if (dragged && this.options.store) {
      this.options.store.set("window", [Math.min(from, value), Math.max(from, value)]);
    } else {
      this.options.onPick?.(this.nearest(value) ?? value);
    }
  }

  endSelection() {
    this.pressed = undefined;
    this.selection?.setAttribute("visibility", "hidden");
  }

  key(event) {
    if (event.target !== this.box) return;
    const points = this.options.lines[0]?.x ?? [];
    const last = points.length - 1;
    const place = this.cursorAt === undefined ? -1 : nearestIndex(points, this.cursorAt);
    const step = event.shiftKey ? Math.max(1, Math.round(points.length / 50)) : 1;
    const along = (by) => {
      let at = place + by;
      while (points[at] === points[place] && at > 0 && at < last) at += Math.sign(by);  // curves can have vertical segments
      return at;
    };
    const next = { ArrowLeft: place < 0 ? last : along(-step), ArrowRight: along(step), Home: 0, End: last }[event.key];
    if (next !== undefined && last >= 0) {
      event.preventDefault();
      this.showTip(points[Math.min(last, Math.max(0, next))]);
    } else if (event.key === "Enter" && this.cursorAt !== undefined) {
      this.options.onPick?.(this.cursorAt);
    } else if (event.key === "Escape") {
      this.hideTip();
      this.options.store?.set("window", null);
    }
  }

  /** The x value of the nearest point of all lines. */
  nearest(value) {
    const places = this.options.lines.filter((line) => line.x.length).map((line) => line.x[nearestIndex(line.x, value)]);
    places.sort((a, b) => Math.abs(a - value) - Math.abs(b - value));
    return places[0];
  }

  /** Shows the values at x; of many lines, those nearest to the pointer. */
  showTip(value, height) {
    const at = this.nearest(value);
    if (at === undefined || !this.xs) return;
    this.cursorAt = at;
    const hits = this.options.lines.map((line) => ({ line, i: nearestIndex(line.x, at) })).filter(({ i }) => i >= 0);
    const shown = nearestHits(hits, this.ys, height);
    this.cursor.replaceChildren(...cursorShapes(shown, this.xs, this.ys, this.xs.at(at)));
    this.cursor.setAttribute("visibility", "visible");
    fillReadout(this.tip, this.options.title(at), shown, hits.length - shown.length);
    placeReadout(this.tip, this.xs.at(at), this.width);
  }

  hideTip() {
    this.cursorAt = undefined;
    this.tip.hidden = true;
    this.cursor?.setAttribute("visibility", "hidden");
  }
}
