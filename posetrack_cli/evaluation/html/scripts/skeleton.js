/* Drawing of a scene on a canvas: skeletons of estimate and ground truth, scale bar, camera axes. */

const VIEW_FILL = 0.46;  /* visible radius as a fraction of the shorter side of the canvas */
const AXIS_NAMES = ["x", "y", "z"];

class Skeleton {
  constructor(canvas) {
    this.canvas = canvas;
    this.view = new CameraView();
    this.follow = true;
    this.connect = false;
  }

  /** Sets the scene; null clears the canvas. */
  setScene(data) {
    this.data = data;
  }

  draw(frame) {
    const { canvas, data } = this;
    const { clientWidth: width, clientHeight: height } = canvas;
    if (!width || !height) return;
    const ratio = window.devicePixelRatio || 1;
    canvas.width = Math.round(width * ratio);
    canvas.height = Math.round(height * ratio);
    this.context = canvas.getContext("2d");
    this.context.scale(ratio, ratio);
    this.readColours();
    canvas.projected = { estimate: [], truth: [] };
    if (!data) return;
    this.size = [width, height];
    this.centre = (this.follow && data.centroid(frame)) || data.centre;
    this.pixelsPerMm = (VIEW_FILL * Math.min(width, height)) / (this.follow ? data.radius.hand : data.radius.path);
    const seen = { estimate: this.projected("estimate", frame), truth: this.projected("truth", frame) };
    const isLost = data.result.state(data.at[frame]) === "lost";
    if (this.connect) this.drawConnections(seen);
    this.drawFigures(seen, isLost);
    this.drawScaleBar();
    this.drawAxes();
    canvas.projected = seen;
  }

  readColours() {
    const style = getComputedStyle(this.canvas);
    const colour = (name) => style.getPropertyValue(name).trim();
    this.colours = { estimate: colour("--c"), truth: colour("--truth"), soft: colour("--soft"), panel: colour("--panel") };
  }

  project(point) {
    return this.view.project(point, this.centre, this.pixelsPerMm, ...this.size);
  }

  projected(which, frame) {
    return this.data.points(which, frame).map((point) => point && this.project(point));
  }

  /** Bones and joints of both skeletons, drawn from back to front. */
  drawFigures(seen, isLost) {
    const shapes = ["truth", "estimate"].flatMap((which) => this.shapes(which, seen[which]));
    shapes.sort((a, b) => b.away - a.away);
    this.context.lineCap = "round";
    for (const { which, draw } of shapes) {
      this.context.globalAlpha = which === "estimate" && isLost ? 0.45 : 1;
      draw();
    }
    this.context.globalAlpha = 1;
  }

  shapes(which, points) {
    const { count, edges, drawn } = this.data;
    const shapes = [];
    const width = which === "estimate" ? 4 : 2;
    for (const [from, to] of edges) {
      const [a, b] = [points[from], points[to]];
      if (a && b) shapes.push({ which, away: (a[2] + b[2]) / 2, draw: () => this.line(a, b, this.colours[which], width) });
    }
    points.slice(0, count).forEach((point) => {
      if (point) shapes.push({ which, away: point[2] - 0.5, draw: () => this.dot(point, which) });
    });
    if (drawn > count && points[count]) shapes.push(...this.axisShapes(which, points.slice(count), width));
    return shapes;
  }

  /** Axes of a pose with labels at their ends. */
  axisShapes(which, [origin, ...ends], width) {
    return ends.flatMap((end, axis) => (end ? [{
      which, away: (origin[2] + end[2]) / 2,
      draw: () => {
        this.line(origin, end, this.colours[which], width * 0.75);
        if (which === "estimate") this.label(AXIS_NAMES[axis], end[0] + 5, end[1] + 4, this.colours[which]);
      },
    }] : []));
  }

  line([x0, y0], [x1, y1], colour, width) {
    const { context } = this;
    context.strokeStyle = colour;
    context.lineWidth = width;
    context.beginPath();
    context.moveTo(x0, y0);
    context.lineTo(x1, y1);
    context.stroke();
  }

  dot([x, y], which) {
    const { context } = this;
    context.beginPath();
    context.arc(x, y, which === "estimate" ? 4.2 : 2.8, 0, 2 * Math.PI);
    context.fillStyle = which === "estimate" ? this.colours.estimate : this.colours.panel;
    context.fill();
    context.strokeStyle = which === "estimate" ? this.colours.panel : this.colours.truth;
    context.lineWidth = 1.2;
    context.stroke();
  }

  label(text, x, y, colour) {
    this.context.font = "12px system-ui, sans-serif";
    this.context.fillStyle = colour;
    this.context.fillText(text, x, y);
  }

  drawConnections({ estimate, truth }) {
    this.context.setLineDash([2, 3]);
    estimate.slice(0, this.data.count).forEach((point, i) => {
      if (point && truth[i]) this.line(point, truth[i], this.colours.soft, 1);
    });
    this.context.setLineDash([]);
  }

  drawScaleBar() {
    const perMm = this.pixelsPerMm * this.view.zoom;
    const mm = roundBelow(110 / perMm);
    const [left, y] = [14, this.size[1] - 16];
    const end = left + mm * perMm;
    this.line([left, y], [end, y], this.colours.soft, 1.5);
    this.line([left, y - 4], [left, y + 4], this.colours.soft, 1.5);
    this.line([end, y - 4], [end, y + 4], this.colours.soft, 1.5);
    this.label(`${mm} mm`, left, y - 9, this.colours.soft);
  }

  /** The camera axes, rotated like the scene. */
  drawAxes() {
    const [x, y] = [this.size[0] - 44, this.size[1] - 44];
    AXIS_NAMES.forEach((name, axis) => {
      const [right, down] = this.view.turned([0, 1, 2].map((other) => (other === axis ? 1 : 0)));
      this.line([x, y], [x + 24 * right, y + 24 * down], this.colours.soft, 1.5);
      const seen = Math.hypot(right, down) > 0.2;  // the label of an axis that points at the viewer is placed next to it
      this.label(name, x + (seen ? 33 * right : -9) - 3, y + (seen ? 33 * down : -9) + 4, this.colours.soft);
    });
  }
}
