/* The 3D scene of a result: points by frame, and their extent. */

const MISSING_STEP = -32768;
const MOST_REACH = 1.5;  /* limit of the view in units of the true extent; estimates farther away can be outside */

class SceneData {
  constructor(result) {
    const scene = result.scene;
    Object.assign(this, { result, scene, count: scene.pointCount, edges: scene.edges, readings: scene.readings });
    this.at = unpack(scene.at);
    this.estimate = unpack(scene.estimate);
    this.truth = scene.truth && unpack(scene.truth);
    this.length = this.at.length;
    this.drawn = this.estimate.length / (3 * this.length);
    this.times = result.times(scene);
    this.centre = this.middle();
    this.radius = { hand: this.handRadius(), path: this.pathRadius() };
  }

  /** The points of a frame, mm, camera axes; null for unknown points. */
  points(which, frame) {
    const values = this[which];
    if (!values) return [];
    const { origin, stepMm } = this.scene;
    return Array.from({ length: this.drawn }, (_, point) => {
      const start = 3 * (frame * this.drawn + point);
      if (values[start] === MISSING_STEP) return null;
      return origin.map((value, axis) => value + stepMm * values[start + axis]);
    });
  }

  /** Mean of the known points of the ground truth, else of the estimate; null without points. */
  centroid(frame) {
    for (const which of ["truth", "estimate"]) {
      const known = this.points(which, frame).filter((point) => point);
      if (known.length) return [0, 1, 2].map((axis) => known.reduce((sum, point) => sum + point[axis], 0) / known.length);
    }
    return null;
  }

  /** A sample of the frames for computing the extent. */
  sample() {
    const step = Math.max(1, Math.floor(this.length / 200));
    return Array.from({ length: Math.ceil(this.length / step) }, (_, i) => i * step);
  }

  middle() {
    const centres = this.sample().map((frame) => this.centroid(frame)).filter((centre) => centre);
    return [0, 1, 2].map((axis) => {
      const values = centres.map((centre) => centre[axis]);
      return values.length ? (Math.min(...values) + Math.max(...values)) / 2 : 0;
    });
  }

  /** The visible radius; estimates that are far off have limited influence. */
  handRadius() {
    const reference = this.reach(this.truth ? ["truth"] : ["estimate"]) || this.reach(["estimate"]);
    return Math.min(this.reach(["truth", "estimate"]), MOST_REACH * reference) || 100;
  }

  /** The largest distance of a point from the centroid of its frame, without lost estimates. */
  reach(which) {
    const radii = this.sample().map((frame) => {
      const centre = this.centroid(frame);
      const lost = this.result.state(this.at[frame]) === "lost";
      const known = which.flatMap((one) => (lost && this.truth && one === "estimate" ? [] : this.points(one, frame))).filter((point) => point);
      return Math.max(0, ...known.map((point) => Math.hypot(...point.map((value, axis) => value - centre[axis]))));
    });
    return Math.max(0, ...radii);
  }

  pathRadius() {
    const centres = this.sample().map((frame) => this.centroid(frame)).filter((centre) => centre);
    const reach = centres.map((centre) => Math.hypot(...centre.map((value, axis) => value - this.centre[axis])));
    return Math.max(0, ...reach) + this.handRadius();
  }
}
