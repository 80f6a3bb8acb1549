"use strict";
// The map: path, position with its 95 % ellipse, heading, fixes; metres east and north of the start, or over tiles.

const METRES_PER_DEGREE = 111320;
const ELLIPSE_95 = Math.sqrt(5.991); // chi-square of two degrees of freedom

class WayMap {
  constructor(canvas, onPlace) {
    this.canvas = canvas;
    this.onPlace = onPlace; // called with east, north where somebody says "I am here"
    this.view = { east: 0, north: 0, scale: 12 }; // of the middle; pixels per metre
    this.follow = true;
    this.placing = false;
    this.way = null;
    this.tiles = "";
    this.images = new Map();
    this.listen();
    new ResizeObserver(() => this.draw()).observe(canvas);
    matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => this.draw());
  }

  listen() {
    const canvas = this.canvas;
    const touching = new Map();
    let moved = 0;
    canvas.addEventListener("pointerdown", event => {
      canvas.setPointerCapture(event.pointerId);
      touching.set(event.pointerId, [event.offsetX, event.offsetY]);
      moved = 0;
    });
    canvas.addEventListener("pointermove", event => {
      const before = touching.get(event.pointerId);
      if (!before) return;
      const now = [event.offsetX, event.offsetY];
      const others = [...touching].filter(([id]) => id !== event.pointerId).map(([, place]) => place);
      const step = Math.hypot(now[0] - before[0], now[1] - before[1]);
      moved += step;
      if (others.length) {
        const apart = p => Math.hypot(p[0] - others[0][0], p[1] - others[0][1]);
        this.zoom(apart(now) / Math.max(apart(before), 1));
      } else if (moved > 6) {
        this.pan(before[0] - now[0], before[1] - now[1]);
      }
      touching.set(event.pointerId, now);
    });
    canvas.addEventListener("pointerup", event => {
      touching.delete(event.pointerId);
      if (moved <= 6 && this.placing) this.onPlace(...this.place(event.offsetX, event.offsetY));
    });
    canvas.addEventListener("pointercancel", event => touching.delete(event.pointerId));
    canvas.addEventListener("wheel", event => {
      event.preventDefault();
      this.zoom(event.deltaY < 0 ? 1.2 : 1 / 1.2);
    }, { passive: false });
  }

  pan(x, y) {
    this.setFollow(false);
    this.view.east += x / this.view.scale;
    this.view.north -= y / this.view.scale;
    this.draw();
  }

  zoom(factor) {
    this.view.scale = Math.min(Math.max(this.view.scale * factor, 0.01), 400);
    this.draw();
  }

  setFollow(follow) {
    this.follow = follow;
    this.canvas.dispatchEvent(new Event("followed"));
    this.draw();
  }

  whole() {
    if (!this.way || !this.way.path.length) return;
    const easts = [0, ...this.way.path.map(row => row[1])], norths = [0, ...this.way.path.map(row => row[2])];
    const low = [Math.min(...easts), Math.min(...norths)], high = [Math.max(...easts), Math.max(...norths)];
    const { clientWidth: width, clientHeight: height } = this.canvas;
    this.view.east = (low[0] + high[0]) / 2;
    this.view.north = (low[1] + high[1]) / 2;
    this.view.scale = Math.min(width / (high[0] - low[0] + 10), height / (high[1] - low[1] + 10), 40);
    this.setFollow(false);
  }

  show(way) {
    this.way = way;
    this.draw();
  }

  // Pixels of a place, and back.
  at(east, north) {
    const { clientWidth: width, clientHeight: height } = this.canvas;
    return [width / 2 + (east - this.view.east) * this.view.scale, height / 2 - (north - this.view.north) * this.view.scale];
  }

  place(x, y) {
    const { clientWidth: width, clientHeight: height } = this.canvas;
    return [this.view.east + (x - width / 2) / this.view.scale, this.view.north - (y - height / 2) / this.view.scale];
  }

  draw() {
    if (this.waits) return;
    this.waits = true;
    requestAnimationFrame(() => { this.waits = false; this.paint(); });
  }

  paint() {
    const canvas = this.canvas, ratio = devicePixelRatio || 1;
    const width = canvas.clientWidth, height = canvas.clientHeight;
    if (!width || !height) return;
    if (canvas.width !== Math.round(width * ratio) || canvas.height !== Math.round(height * ratio)) {
      canvas.width = Math.round(width * ratio);
      canvas.height = Math.round(height * ratio);
    }
    const style = getComputedStyle(document.documentElement);
    const colour = name => style.getPropertyValue(name).trim();
    const pen = canvas.getContext("2d");
    pen.setTransform(ratio, 0, 0, ratio, 0, 0);
    pen.fillStyle = colour("--paper");
    pen.fillRect(0, 0, width, height);
    const way = this.way;
    const position = way && (way.now ? way.now.position_m : way.path.length ? way.path.at(-1).slice(1, 3) : [0, 0]);
    if (this.follow && position) [this.view.east, this.view.north] = position;
    if (way && way.origin && this.tiles) this.paintTiles(pen, way.origin, width, height);
    this.paintGrid(pen, colour, width, height);
    if (way) this.paintWay(pen, colour, way, position);
    if (this.placing) this.paintCross(pen, colour, width / 2, height / 2);
  }

  paintGrid(pen, colour, width, height) {
    const target = 90 / this.view.scale, power = 10 ** Math.floor(Math.log10(target));
    const step = [1, 2, 5, 10].map(n => n * power).find(n => n >= target);
    pen.strokeStyle = colour("--line");
    pen.lineWidth = 1;
    pen.beginPath();
    const [west, north] = this.place(0, 0), [east, south] = this.place(width, height);
    for (let e = Math.ceil(west / step) * step; e < east; e += step) {
      const [x] = this.at(e, 0);
      pen.moveTo(x, 0);
      pen.lineTo(x, height);
    }
    for (let n = Math.ceil(south / step) * step; n < north; n += step) {
      const [, y] = this.at(0, n);
      pen.moveTo(0, y);
      pen.lineTo(width, y);
    }
    pen.stroke();
    pen.strokeStyle = pen.fillStyle = colour("--ink");
    pen.lineWidth = 2;
    pen.beginPath();
    pen.moveTo(12, height - 12);
    pen.lineTo(12 + step * this.view.scale, height - 12);
    pen.stroke();
    pen.font = "13px system-ui, sans-serif";
    pen.fillText(`${step >= 1000 ? step / 1000 + " km" : step + " m"}`, 14, height - 18);
  }

  paintWay(pen, colour, way, position) {
    const dot = (place, radius, fill) => {
      pen.fillStyle = fill;
      pen.beginPath();
      pen.arc(...this.at(...place), radius, 0, 2 * Math.PI);
      pen.fill();
    };
    pen.lineWidth = 3;
    pen.lineJoin = "round";
    pen.strokeStyle = colour("--accent");
    pen.beginPath();
    way.path.forEach((row, i) => pen[i ? "lineTo" : "moveTo"](...this.at(row[1], row[2])));
    pen.stroke();
    if (way.path.length) dot(way.path[0].slice(1, 3), 5, colour("--faint"));
    const now = way.now;
    if (now && now.provisional_steps.length) {
      pen.setLineDash([4, 5]);
      pen.beginPath();
      const last = way.path.length ? way.path.at(-1).slice(1, 3) : now.provisional_steps[0].position_m;
      pen.moveTo(...this.at(...last));
      now.provisional_steps.forEach(step => pen.lineTo(...this.at(...step.position_m)));
      pen.stroke();
      pen.setLineDash([]);
    }
    for (const fix of way.fixes) {
      pen.strokeStyle = colour("--wrong");
      this.paintCross(pen, colour, ...this.at(...fix), 6);
    }
    if (!now) return;
    const [[ee, en], [, nn]] = now.position_cov_m2;
    const mean = (ee + nn) / 2, root = Math.hypot((ee - nn) / 2, en);
    const [x, y] = this.at(...position), scale = this.view.scale * ELLIPSE_95;
    pen.beginPath();
    pen.ellipse(x, y, Math.sqrt(mean + root) * scale, Math.sqrt(Math.max(mean - root, 0)) * scale,
      -0.5 * Math.atan2(2 * en, ee - nn), 0, 2 * Math.PI);
    pen.globalAlpha = 0.12;
    pen.fillStyle = colour("--accent");
    pen.fill();
    pen.globalAlpha = 0.7;
    pen.lineWidth = 1.5;
    pen.strokeStyle = colour("--accent");
    pen.stroke();
    pen.globalAlpha = 1;
    dot(position, 7, colour("--ink"));
    pen.save();
    pen.translate(x, y);
    pen.rotate(now.walking_heading_rad);
    pen.fillStyle = colour("--ink");
    pen.beginPath();
    pen.moveTo(0, -22);
    pen.lineTo(7, -9);
    pen.lineTo(-7, -9);
    pen.closePath();
    pen.fill();
    pen.restore();
  }

  paintCross(pen, colour, x, y, size = 14) {
    pen.strokeStyle = colour("--wrong");
    pen.lineWidth = 2;
    pen.beginPath();
    pen.moveTo(x - size, y);
    pen.lineTo(x + size, y);
    pen.moveTo(x, y - size);
    pen.lineTo(x, y + size);
    pen.stroke();
  }

  // Raster tiles of Web Mercator under the way; metres of the plane at the origin are those of the map near it.
  paintTiles(pen, origin, width, height) {
    const [latitude, longitude] = origin, cosine = Math.cos(latitude * Math.PI / 180);
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
        if (image && image.complete && image.naturalWidth) pen.drawImage(image, x, y, size + 0.5, size + 0.5);
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
