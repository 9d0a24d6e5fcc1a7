/* Orthographic camera of the 3D view, which orbits a centre. */

const MOST_PITCH = Math.PI / 2;
const ZOOM_LIMITS = [0.1, 20];

/**
 * The initial view is that of the recording camera: x right, y down, z forward. `yaw` and `pitch` (rad)
 * rotate it about the vertical and the horizontal axis.
 */
class CameraView {
  constructor() {
    this.reset();
  }

  reset() {
    Object.assign(this, { yaw: 0, pitch: 0, zoom: 1 });
  }

  turn(yaw, pitch) {
    this.yaw += yaw;
    this.pitch = Math.min(MOST_PITCH, Math.max(-MOST_PITCH, this.pitch + pitch));
  }

  scaleBy(factor) {
    this.zoom = Math.min(ZOOM_LIMITS[1], Math.max(ZOOM_LIMITS[0], this.zoom * factor));
  }

  /** Rotated coordinates of a vector: right, down, forward. */
  turned([x, y, z]) {
    const [cy, sy, cp, sp] = [Math.cos(this.yaw), Math.sin(this.yaw), Math.cos(this.pitch), Math.sin(this.pitch)];
    const right = cy * x + sy * z, away = cy * z - sy * x;
    return [right, cp * y - sp * away, sp * y + cp * away];
  }

  /** Pixel coordinates of a point, and its depth relative to the centre, mm. */
  project(point, centre, pixelsPerMm, width, height) {
    const [right, down, away] = this.turned(point.map((value, axis) => value - centre[axis]));
    const scale = pixelsPerMm * this.zoom;
    return [width / 2 + scale * right, height / 2 + scale * down, away];
  }
}
