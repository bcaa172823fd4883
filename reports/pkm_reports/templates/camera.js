// An orthographic camera: points in mm, base frame, to pixels. Azimuth and elevation in degrees.
class Camera {
  constructor(points) {
    this.home = {azimuth: -58, elevation: 20};
    Object.assign(this, this.home);
    this.zoom = 1;
    this.frame(points);
  }

  // Look at the middle of these points, so that all of them fit.
  frame(points) {
    const low = [0, 1, 2].map(k => Math.min(...points.map(p => p[k])));
    const high = [0, 1, 2].map(k => Math.max(...points.map(p => p[k])));
    this.centre = low.map((v, k) => (v + high[k]) / 2);
    this.radius = Math.max(1, Math.hypot(...low.map((v, k) => high[k] - v)) / 2);
    this.zoom = 1;
  }

  size(width, height) {
    this.width = width;
    this.height = height;
  }

  turn(azimuth, elevation) {
    this.azimuth = ((azimuth + 180) % 360 + 360) % 360 - 180;
    this.elevation = Math.max(-90, Math.min(90, elevation));
  }

  // Pixels right of the left edge and below the upper one, and the depth towards the viewer, mm.
  project(point) {
    const a = this.azimuth * Math.PI / 180, e = this.elevation * Math.PI / 180;
    const [x, y, z] = point.map((v, k) => v - this.centre[k]);
    const right = -x * Math.sin(a) + y * Math.cos(a);
    const towards = x * Math.cos(a) + y * Math.sin(a);
    const up = -towards * Math.sin(e) + z * Math.cos(e);
    const scale = this.zoom * 0.46 * Math.min(this.width, this.height) / this.radius;
    return [this.width / 2 + scale * right, this.height / 2 - scale * up, towards * Math.cos(e) + z * Math.sin(e)];
  }
}
