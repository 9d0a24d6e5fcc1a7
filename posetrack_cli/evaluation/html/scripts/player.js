/* The 3D view with playback, rotation and zoom controls. */

const SPEEDS = [0.1, 0.25, 0.5, 1, 2, 4];
const TURN_PER_PIXEL = 0.01, TURN_PER_KEY = 0.12, ZOOM_PER_KEY = 1.15;

class Player {
  constructor(store, parent, remark) {
    Object.assign(this, { store, parent, remark, frame: 0, playing: false, pointers: new Map() });
    this.build();
    this.skeleton = new Skeleton(this.canvas);
    this.listen();
    this.showResult();
  }

  build() {
    const button = (text, label, kind = "") => makeElement("button", { type: "button", class: kind, "aria-label": label }, text);
    this.canvas = makeElement("canvas", {
      tabindex: "0", role: "application", "aria-describedby": "scene-keys",
      "aria-label": "3D view of estimate and ground truth, controlled by keys",
    });
    this.reading = makeElement("div", { class: "reading" });
    this.play = button("Play", "Play", "play");
    this.back = button("◀", "One frame back");
    this.forward = button("▶", "One frame forward");
    this.slider = makeElement("input", { type: "range", min: "0", step: "1", value: "0", "aria-label": "Frame" });
    this.speed = makeElement("select", {}, ...SPEEDS.map((speed) => makeElement("option", { value: speed }, `${speed}×`)));
    this.speed.value = "1";
    this.reset = button("Reset view", "Reset view");
    this.follow = makeElement("input", { type: "checkbox" });
    this.follow.checked = true;
    this.connect = makeElement("input", { type: "checkbox" });
    this.legend = makeElement("div", { class: "legend" });
    this.missing = makeMissing("");
    this.box = makeElement("div", { class: "scene" }, this.legend, this.canvas, this.reading,
      makeElement("div", { class: "controls" }, this.play, this.back, this.forward, this.slider),
      makeElement("div", { class: "controls" }, makeElement("label", {}, "Speed ", this.speed), this.reset,
        makeElement("label", {}, this.follow, " Follow"), makeElement("label", {}, this.connect, " Error lines")),
      makeElement("p", { class: "remark", id: "scene-keys" },
        "Drag to rotate, wheel or pinch to zoom. Keys: space plays, ← → step, Home and End jump, " +
        "Shift + arrows rotate, + and − zoom, 0 resets."));
    this.parent.append(this.missing, this.box);
  }

  listen() {
    this.play.addEventListener("click", () => this.toggle());
    this.back.addEventListener("click", () => this.step(-1));
    this.forward.addEventListener("click", () => this.step(1));
    this.slider.addEventListener("input", () => this.pause() || this.goTo(Number(this.slider.value)));
    this.reset.addEventListener("click", () => this.resetView());
    this.follow.addEventListener("change", () => this.redraw());
    this.connect.addEventListener("change", () => this.redraw());
    this.canvas.addEventListener("keydown", (event) => this.key(event));
    this.canvas.addEventListener("pointerdown", (event) => this.press(event));
    this.canvas.addEventListener("pointermove", (event) => this.drag(event));
    for (const end of ["pointerup", "pointercancel"]) this.canvas.addEventListener(end, (event) => this.pointers.delete(event.pointerId));
    this.canvas.addEventListener("wheel", (event) => this.wheel(event), { passive: false });
    this.store.on("result", () => this.showResult());
    this.store.on("now", (now) => this.followTime(now));
    new ResizeObserver(() => this.redraw()).observe(this.canvas);
    matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => this.redraw());
  }

  /* scene */

  showResult() {
    this.pause();
    const { result } = this.store;
    this.data = result?.scene ? new SceneData(result) : null;
    this.box.hidden = !this.data;
    this.missing.hidden = Boolean(this.data);
    this.remark.textContent = this.data ? sceneRemark(this.data) : "";
    if (!this.data) {
      this.missing.textContent = result?.frames ? "The result has neither points nor poses." : "No frames.";
      return;
    }
    this.canvas.className = colourClass(result.index);
    this.skeleton.setScene(this.data);
    this.slider.max = this.data.length - 1;
    this.showLegend(result);
    const { now } = this.store;
    this.show(now === null ? 0 : nearestIndex(this.data.times, now));
  }

  showLegend(result) {
    const key = (kind, text) => makeElement("span", {}, makeSwatch(kind, result.index), text);
    this.legend.replaceChildren(key("", "estimate"), this.data.truth ? key("truth solid", "ground truth") : makeElement("span", {}, "no ground truth"));
    this.connect.parentElement.hidden = !this.data.truth;
  }

  redraw() {
    if (!this.data) return;
    this.skeleton.follow = this.follow.checked;
    this.skeleton.connect = this.connect.checked;
    this.skeleton.draw(this.frame);
  }

  show(frame) {
    this.frame = Math.min(this.data.length - 1, Math.max(0, frame));
    this.slider.value = this.frame;
    const words = this.words();
    this.slider.setAttribute("aria-valuetext", words.map((word) => word.text).join(", "));
    this.reading.replaceChildren(...words.map(({ text, kind }) => makeElement("span", { class: kind ?? "" }, text)));
    this.redraw();
  }

  /** Frame number, time, status and errors of the current frame. */
  words() {
    const { result, at, times, readings } = this.data;
    const place = at[this.frame], state = result.state(place);
    const errors = readings.map((one) => ({ text: `${one.label} ${formatValue(unpack(one.value)[this.frame], one.unit)}` }));
    return [{ text: `frame ${result.frame(place)}` }, { text: formatTime(times[this.frame]) }, { text: state, kind: `state-${state}` }, ...errors];
  }

  /* playback */

  goTo(frame) {
    this.show(frame);
    this.store.set("now", this.data.times[this.frame]);
  }

  followTime(now) {
    if (!this.data || now === null) return;
    if (now !== this.data.times[this.frame]) {
      this.pause();
      this.show(nearestIndex(this.data.times, now));
    }
  }

  step(frames) {
    this.pause();
    if (this.data) this.goTo(this.frame + frames);
  }

  toggle() {
    if (this.playing) return this.pause();
    if (!this.data) return;
    if (this.frame === this.data.length - 1) this.goTo(0);
    this.playing = true;
    this.play.textContent = "Pause";
    this.play.setAttribute("aria-label", "Pause");
    this.clock = { time: this.data.times[this.frame], last: performance.now() };
    this.request = requestAnimationFrame((stamp) => this.tick(stamp));
  }

  pause() {
    cancelAnimationFrame(this.request);
    this.playing = false;
    this.play.textContent = "Play";
    this.play.setAttribute("aria-label", "Play");
  }

  tick(stamp) {
    if (!this.playing) return;
    this.clock.time += (Math.max(0, stamp - this.clock.last) / 1000) * Number(this.speed.value);
    this.clock.last = Math.max(stamp, this.clock.last);
    let next = this.frame;
    while (next < this.data.length - 1 && this.data.times[next + 1] <= this.clock.time) next++;
    if (next !== this.frame) this.goTo(next);
    if (next === this.data.length - 1) return this.pause();
    this.request = requestAnimationFrame((later) => this.tick(later));
  }

  /* view */

  resetView() {
    this.skeleton.view.reset();
    this.redraw();
  }

  turn(yaw, pitch) {
    this.skeleton.view.turn(yaw, pitch);
    this.redraw();
  }

  zoom(factor) {
    this.skeleton.view.scaleBy(factor);
    this.redraw();
  }

  press(event) {
    this.pointers.set(event.pointerId, event);
    this.canvas.setPointerCapture(event.pointerId);
  }

  drag(event) {
    const before = this.pointers.get(event.pointerId);
    if (!before) return;
    const spread = this.spread();
    this.pointers.set(event.pointerId, event);
    if (this.pointers.size > 1) {
      if (spread > 0) this.zoom(this.spread() / spread);
    } else {
      this.turn(TURN_PER_PIXEL * (event.clientX - before.clientX), TURN_PER_PIXEL * (event.clientY - before.clientY));
    }
  }

  /** Distance of two touch points. */
  spread() {
    const [a, b] = [...this.pointers.values()];
    return b ? Math.hypot(a.clientX - b.clientX, a.clientY - b.clientY) : 0;
  }

  wheel(event) {
    event.preventDefault();
    this.zoom(Math.exp(-0.0015 * Math.max(-200, Math.min(200, event.deltaY))));
  }

  key(event) {
    const action = event.shiftKey ? this.turningKeys()[event.key] ?? this.keys()[event.key] : this.keys()[event.key];
    if (!action || event.ctrlKey || event.metaKey || event.altKey) return;
    event.preventDefault();
    action();
  }

  keys() {
    return {
      " ": () => this.toggle(), ArrowLeft: () => this.step(-1), ArrowRight: () => this.step(1),
      Home: () => this.step(-Infinity), End: () => this.step(Infinity),
      "+": () => this.zoom(ZOOM_PER_KEY), "=": () => this.zoom(ZOOM_PER_KEY), "-": () => this.zoom(1 / ZOOM_PER_KEY),
      0: () => this.resetView(),
    };
  }

  turningKeys() {
    return {
      ArrowLeft: () => this.turn(-TURN_PER_KEY, 0), ArrowRight: () => this.turn(TURN_PER_KEY, 0),
      ArrowUp: () => this.turn(0, -TURN_PER_KEY), ArrowDown: () => this.turn(0, TURN_PER_KEY),
    };
  }
}

function sceneRemark({ scene, result, length }) {
  const which = scene.every === 1 ? `All ${length} frames` : `${length} of ${result.frames} frames (every ${ordinal(scene.every)}, those with pictures, and the worst)`;
  return `${which}; coordinates rounded to ${formatNumber(scene.stepMm)} mm. Orthographic view, initially from the camera (x right, y down, z forward).`;
}

function ordinal(number) {
  const ending = number % 100 > 10 && number % 100 < 14 ? "th" : { 1: "st", 2: "nd", 3: "rd" }[number % 10] ?? "th";
  return `${number}${ending}`;
}
