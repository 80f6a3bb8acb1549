"use strict";
// The way as it grows: position with its 95 % ellipse, heading, steps that may still be none, fixes; over tiles if any.

const METRES_PER_DEGREE = 111320;
const ELLIPSE_95 = Math.sqrt(5.991); // chi-square of two degrees of freedom

class LiveMap extends CanvasMap {
  constructor(canvas, onPlace) {
    super(canvas, name => getComputedStyle(document.documentElement).getPropertyValue(name).trim());
    this.onPlace = onPlace; // called with east, north where somebody says "I am here"
    this.follow = true;
    this.placing = false;
    this.way = null;
    this.tiles = "";
    this.images = new Map();
    matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => this.draw());
  }

  moved() { this.setFollow(false); }

  pressed(pixel) { if (this.placing) this.onPlace(...this.place(...pixel)); }

  setFollow(follow) {
    this.follow = follow;
    this.canvas.dispatchEvent(new Event("followed"));
    this.draw();
  }

  whole() {
    if (!this.way?.path.length) return;
    this.fit([0, ...this.way.path.map(row => row[1])], [0, ...this.way.path.map(row => row[2])], 10);
    this.setFollow(false);
  }

  show(way) {
    this.way = way;
    this.draw();
  }

  get position() {
    return this.way?.now ? this.way.now.position_m : this.way?.path.at(-1)?.slice(1, 3) ?? [0, 0];
  }

  paintBelow() {
    if (this.follow) [this.view.east, this.view.north] = this.position;
    if (this.way?.origin && this.tiles) this.paintTiles(this.way.origin);
  }

  paintAbove() {
    if (this.way) this.paintWay(this.way);
    if (this.placing) this.cross(this.size.map(v => v / 2), 14, this.colour("--wrong"));
  }

  paintWay(way) {
    const pen = this.pen, now = way.now, accent = this.colour("--accent");
    this.line(way.path.map(row => row[1]), way.path.map(row => row[2]), accent, 3);
    if (way.path.length) this.dot(way.path[0].slice(1, 3), 5, this.colour("--faint"));
    if (now?.provisional_steps.length) {
      const last = way.path.at(-1)?.slice(1, 3) ?? now.provisional_steps[0].position_m;
      const places = [last, ...now.provisional_steps.map(step => step.position_m)];
      pen.setLineDash([4, 5]);
      this.line(places.map(p => p[0]), places.map(p => p[1]), accent, 3);
      pen.setLineDash([]);
    }
    for (const fix of way.fixes) this.paintFix(fix);
    if (!now) return;
    const [[ee, en], [, nn]] = now.position_cov_m2;
    const mean = (ee + nn) / 2, root = Math.hypot((ee - nn) / 2, en);
    const axes = [mean + root, Math.max(mean - root, 0)].map(v => Math.sqrt(v) * ELLIPSE_95);
    this.ellipse(this.position, ...axes, 0.5 * Math.atan2(2 * en, ee - nn), 0.12, 0.7);
    this.walker(this.position, now.walking_heading_rad);
  }

  // A cross that is faint while the fix waits; red if it did not fit.
  paintFix({ place, outcome }) {
    const name = { waiting: "--faint", rejected: "--wrong", "nothing to compare": "--faint" }[outcome] ?? "--ink";
    this.cross(this.at(...place), 6, this.colour(name));
  }

  cross([x, y], size, colour) {
    const pen = this.pen;
    pen.strokeStyle = colour;
    pen.lineWidth = 2;
    pen.beginPath();
    pen.moveTo(x - size, y);
    pen.lineTo(x + size, y);
    pen.moveTo(x, y - size);
    pen.lineTo(x, y + size);
    pen.stroke();
  }

  // Raster tiles of Web Mercator under the way; metres of the plane at the origin are those of the map near it.
  paintTiles(origin) {
    const [latitude, longitude] = origin, cosine = Math.cos(latitude * Math.PI / 180), [width, height] = this.size;
    const ideal = Math.log2(this.view.scale * METRES_PER_DEGREE * 360 * cosine / 256);
    const z = Math.min(Math.max(Math.round(ideal), 1), 19), n = 2 ** z;
    const column = east => (longitude + east / (METRES_PER_DEGREE * cosine) + 180) / 360 * n;
    const row = north => {
      const angle = (latitude + north / METRES_PER_DEGREE) * Math.PI / 180;
      return (1 - Math.asinh(Math.tan(angle)) / Math.PI) / 2 * n;
    };
    const [west, north] = this.place(0, 0), [east, south] = this.place(width, height);
    const size = width / (column(east) - column(west));
    for (let i = Math.floor(column(west)); i <= column(east); i++) {
      for (let j = Math.floor(row(north)); j <= row(south); j++) {
        const image = this.tile(z, ((i % n) + n) % n, j);
        const x = (i - column(west)) * size, y = (j - row(north)) * size;
        if (image.complete && image.naturalWidth) this.pen.drawImage(image, x, y, size + 0.5, size + 0.5);
      }
    }
  }

  tile(z, x, y) {
    const address = this.tiles.replace("{z}", z).replace("{x}", x).replace("{y}", y);
    if (!this.images.has(address)) {
      if (this.images.size > 300) this.images.clear();
      const image = new Image();
      image.onload = () => this.draw();
      image.src = address;
      this.images.set(address, image);
    }
    return this.images.get(address);
  }
}
