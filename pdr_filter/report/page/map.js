"use strict";
// The way on a canvas that is moved and zoomed: metres east and north, with what lies beside and below it.

class WayMap {
  constructor(canvas, colour, onStep) {
    this.canvas = canvas;
    this.colour = colour; // of a name in the style
    this.onStep = onStep; // called with the number of the step that somebody points at
    this.view = { east: 0, north: 0, scale: 10 }; // of the middle; pixels per metre
    this.hidden = new Set(); // layers
    this.tracks = [];
    this.chosen = 0;
    this.groups = "floors"; // by what steps are coloured, if there is more than one
    this.row = -1; // the last step that is shown in full
    this.isWhole = true;
    this.listen();
    new ResizeObserver(() => (this.isWhole ? this.whole() : this.draw())).observe(canvas);
  }

  get track() { return this.tracks[this.chosen]; }

  get size() { return [this.canvas.clientWidth, this.canvas.clientHeight]; }

  listen() {
    const canvas = this.canvas, touching = new Map();
    let moved = 0;
    canvas.addEventListener("pointerdown", event => {
      canvas.setPointerCapture(event.pointerId);
      touching.set(event.pointerId, [event.offsetX, event.offsetY]);
      moved = 0;
    });
    canvas.addEventListener("pointermove", event => {
      const now = [event.offsetX, event.offsetY], before = touching.get(event.pointerId);
      if (!before) return this.point(now, 40);
      moved += Math.hypot(now[0] - before[0], now[1] - before[1]);
      const other = [...touching].find(([id]) => id !== event.pointerId)?.[1];
      if (other) {
        const apart = p => Math.hypot(p[0] - other[0], p[1] - other[1]);
        this.zoom(apart(now) / Math.max(apart(before), 1), other);
      } else if (moved > 5) {
        this.pan(now[0] - before[0], now[1] - before[1]);
      }
      touching.set(event.pointerId, now);
    });
    canvas.addEventListener("pointerup", event => {
      touching.delete(event.pointerId);
      if (moved <= 5) this.point([event.offsetX, event.offsetY], 40);
    });
    canvas.addEventListener("pointercancel", event => touching.delete(event.pointerId));
    canvas.addEventListener("dblclick", () => this.whole());
    canvas.addEventListener("wheel", event => {
      event.preventDefault();
      this.zoom(1.2 ** -Math.sign(event.deltaY), [event.offsetX, event.offsetY]);
    }, { passive: false });
    canvas.addEventListener("keydown", event => {
      const by = { ArrowLeft: [60, 0], ArrowRight: [-60, 0], ArrowUp: [0, 60], ArrowDown: [0, -60] }[event.key];
      if (by) this.pan(...by);
      else if (event.key === "+" || event.key === "=") this.zoom(1.5);
      else if (event.key === "-") this.zoom(1 / 1.5);
      else if (event.key === "0") this.whole();
      else return;
      event.preventDefault();
    });
  }

  // The step nearest to a pixel, unless all are farther from it than so many pixels.
  point(pixel, within) {
    const { east, north } = this.track;
    let best = -1, least = within ** 2;
    for (let k = 0; k < east.length; k++) {
      const [x, y] = this.at(east[k], north[k]), apart = (x - pixel[0]) ** 2 + (y - pixel[1]) ** 2;
      if (apart <= least) [best, least] = [k, apart];
    }
    if (best >= 0) this.onStep(best);
  }

  pan(x, y) {
    this.isWhole = false;
    this.view.east -= x / this.view.scale;
    this.view.north += y / this.view.scale;
    this.draw();
  }

  // The place under the pixel stays where it is.
  zoom(factor, pixel = this.size.map(v => v / 2)) {
    this.isWhole = false;
    const [east, north] = this.place(...pixel);
    this.view.scale = Math.min(Math.max(this.view.scale * factor, 1e-5), 1000);
    const now = this.place(...pixel);
    this.view.east += east - now[0];
    this.view.north += north - now[1];
    this.draw();
  }

  whole() {
    const easts = [], norths = [];
    const add = (east, north, reach = 0) => {
      easts.push(east - reach, east + reach);
      norths.push(north - reach, north + reach);
    };
    for (const track of this.tracks) {
      add(...track.start);
      track.east.forEach((east, k) => add(east, track.north[k]));
      if (!this.hidden.has("ellipses")) track.ellipses.forEach(k => add(track.east[k], track.north[k], track.major[k]));
      if (track.truth && !this.hidden.has("truth")) track.truth.east.forEach((east, k) => add(east, track.truth.north[k]));
    }
    const [low, high] = [easts, norths].map(v => v.reduce((a, b) => Math.min(a, b)))
      .map((v, i) => [v, [easts, norths][i].reduce((a, b) => Math.max(a, b))]);
    const [width, height] = this.size, room = v => Math.max(v[1] - v[0], 4) * 1.12;
    this.view = { east: (low[0] + low[1]) / 2, north: (high[0] + high[1]) / 2,
      scale: Math.max(Math.min(width / room(low), height / room(high)), 1e-5) };
    this.isWhole = true;
    this.draw();
  }

  // Pixels of a place, and back.
  at(east, north) {
    const [width, height] = this.size, { scale } = this.view;
    return [width / 2 + (east - this.view.east) * scale, height / 2 - (north - this.view.north) * scale];
  }

  place(x, y) {
    const [width, height] = this.size, { scale } = this.view;
    return [this.view.east + (x - width / 2) / scale, this.view.north - (y - height / 2) / scale];
  }

  draw() {
    if (this.waits) return;
    this.waits = true;
    requestAnimationFrame(() => { this.waits = false; this.paint(); });
  }

  paint() {
    const canvas = this.canvas, ratio = devicePixelRatio || 1, [width, height] = this.size;
    if (!width || !height) return;
    canvas.width = Math.round(width * ratio);
    canvas.height = Math.round(height * ratio);
    const pen = this.pen = canvas.getContext("2d");
    pen.setTransform(ratio, 0, 0, ratio, 0, 0);
    pen.fillStyle = this.colour("--paper");
    pen.fillRect(0, 0, width, height);
    pen.lineJoin = pen.lineCap = "round";
    const shown = name => !this.hidden.has(name);
    if (shown("plan")) this.paintPlan();
    this.paintGrid(width, height);
    const track = this.track;
    if (track.gps && shown("GPS")) this.paintGps(track.gps);
    if (shown("ellipses")) track.ellipses.forEach(k => this.paintEllipse(k, 0.08, 0.45));
    if (shown("other tracks")) {
      this.tracks.filter(t => t !== track).forEach(t => this.line([t.start[0], ...t.east], [t.start[1], ...t.north], t.colour, 2));
    }
    this.paintWay(track);
    if (track.truth && shown("truth")) this.paintTruth(track.truth);
    this.paintEnds(track);
    if (this.row >= 0 && this.row < track.east.length) this.paintNow(track);
  }

  line(east, north, colour, width, from = 0, to = east.length) {
    const pen = this.pen;
    pen.strokeStyle = colour;
    pen.lineWidth = width;
    pen.beginPath();
    for (let k = from; k < to; k++) pen[k > from ? "lineTo" : "moveTo"](...this.at(east[k], north[k]));
    pen.stroke();
  }

  paintPlan() {
    const pen = this.pen;
    pen.globalAlpha = Number(this.colour("--plan")); // its colours are made for white paper
    for (const { fill, edge, rings } of this.track.plan) {
      pen.beginPath();
      for (const ring of rings) {
        ring.forEach((place, k) => pen[k ? "lineTo" : "moveTo"](...this.at(...place)));
        if (fill) pen.closePath();
      }
      pen.fillStyle = fill;
      if (fill) pen.fill("evenodd");
      pen.strokeStyle = edge;
      pen.lineWidth = 1.2;
      pen.stroke();
    }
    pen.globalAlpha = 1;
  }

  paintGrid(width, height) {
    const pen = this.pen, target = 90 / this.view.scale, power = 10 ** Math.floor(Math.log10(target));
    const step = [1, 2, 5, 10].map(n => n * power).find(n => n >= target * 0.999);
    const [west, north] = this.place(0, 0), [east, south] = this.place(width, height);
    const unit = step >= 1000 ? [1000, " km"] : [1, " m"];
    const label = v => `${Number((v / unit[0]).toPrecision(6))}${unit[1]}`;
    pen.strokeStyle = this.colour("--line");
    pen.fillStyle = this.colour("--faint");
    pen.font = "12px system-ui, sans-serif";
    pen.lineWidth = 1;
    pen.beginPath();
    for (let i = Math.ceil(west / step); i * step < east; i++) {
      const [x] = this.at(i * step, 0);
      pen.moveTo(x, 0);
      pen.lineTo(x, height);
      if (x > 60 && x < width - 40) pen.fillText(label(i * step), x + 4, height - 6);
    }
    for (let i = Math.ceil(south / step); i * step < north; i++) {
      const [, y] = this.at(0, i * step);
      pen.moveTo(0, y);
      pen.lineTo(width, y);
      if (y > 60 && y < height - 24) pen.fillText(label(i * step), 6, y - 4);
    }
    pen.stroke();
    // An arrow to the north of the track.
    pen.strokeStyle = pen.fillStyle = this.colour("--faint");
    pen.fillText("N", 14, 20);
    pen.lineWidth = 1.5;
    pen.beginPath();
    pen.moveTo(18.5, 44);
    pen.lineTo(18.5, 26);
    pen.moveTo(14.5, 31);
    pen.lineTo(18.5, 25);
    pen.lineTo(22.5, 31);
    pen.stroke();
  }

  paintGps({ east, north, accuracy }) {
    const pen = this.pen;
    pen.strokeStyle = pen.fillStyle = this.colour("--gps");
    east.forEach((_, k) => {
      const [x, y] = this.at(east[k], north[k]);
      pen.globalAlpha = 0.12;
      pen.lineWidth = 1;
      pen.beginPath();
      pen.arc(x, y, (accuracy[k] ?? 0) * this.view.scale, 0, 7);
      pen.stroke();
      pen.globalAlpha = 0.8;
      pen.beginPath();
      pen.arc(x, y, 2, 0, 7);
      pen.fill();
    });
    pen.globalAlpha = 1;
  }

  paintTruth({ east, north, points }) {
    const pen = this.pen;
    pen.setLineDash([5, 5]);
    this.line(east, north, this.colour("--truth"), 1.5);
    pen.setLineDash([]);
    if (!points) return;
    pen.fillStyle = this.colour("--truth");
    east.forEach((_, k) => {
      const [x, y] = this.at(east[k], north[k]);
      pen.fillRect(x - 3, y - 3, 6, 6);
    });
  }

  // Every step in the colour of its group; those after the shown time are faint.
  paintWay(track) {
    const east = [track.start[0], ...track.east], north = [track.start[1], ...track.north];
    const { group, colours } = track.groups[this.groups] ?? track.groups.contexts;
    const until = Math.min(this.row + 1, group.length), pen = this.pen;
    this.line(east, north, this.colour("--ink"), 5, 0, until + 1);
    for (const [from, to, alpha] of [[until, group.length, 0.3], [0, until, 1]]) {
      pen.globalAlpha = alpha;
      for (let k = from; k < to;) {
        let end = k + 1;
        while (end < to && group[end] === group[k]) end++;
        this.line(east, north, colours[group[k]], 3.4, k, end + 1);
        k = end;
      }
    }
    pen.globalAlpha = 1;
  }

  paintEnds(track) {
    const pen = this.pen, [x, y] = this.at(...track.start);
    pen.lineWidth = 2;
    pen.strokeStyle = this.colour("--ink");
    pen.fillStyle = this.colour("--paper");
    pen.beginPath();
    pen.arc(x, y, 5, 0, 7);
    pen.fill();
    pen.stroke();
    if (!track.east.length) return;
    const [a, b] = this.at(track.east.at(-1), track.north.at(-1));
    pen.fillStyle = this.colour("--ink");
    pen.fillRect(a - 4.5, b - 4.5, 9, 9);
  }

  paintEllipse(k, fill, edge) {
    const { east, north, major, minor, angle } = this.track;
    this.ellipse(east[k], north[k], major[k], minor[k], angle[k], "--accent", fill, edge);
  }

  ellipse(east, north, major, minor, angle, colour, fill, edge) {
    if (major === null) return;
    const pen = this.pen, { scale } = this.view;
    pen.beginPath();
    pen.ellipse(...this.at(east, north), major * scale, minor * scale, -angle, 0, 7);
    pen.fillStyle = pen.strokeStyle = this.colour(colour);
    pen.lineWidth = 1.2;
    pen.globalAlpha = fill;
    pen.fill();
    pen.globalAlpha = edge;
    pen.stroke();
    pen.globalAlpha = 1;
  }

  // Where on the plan the walk may be, if in several places, with how probable each is.
  paintPlaces(places) {
    const pen = this.pen;
    pen.setLineDash([6, 4]);
    for (const [, ...shape] of places) this.ellipse(...shape, "--wrong", 0.05, 1);
    pen.setLineDash([]);
    pen.font = "bold 13px system-ui, sans-serif";
    pen.textAlign = "center";
    pen.lineWidth = 4;
    for (const [percent, east, north] of places) {
      const [x, y] = this.at(east, north);
      pen.strokeStyle = this.colour("--paper");
      pen.strokeText(`${percent} %`, x, y + 26);
      pen.fillStyle = this.colour("--wrong");
      pen.fillText(`${percent} %`, x, y + 26);
    }
    pen.textAlign = "start";
  }

  paintNow(track) {
    const k = this.row, pen = this.pen;
    this.paintEllipse(k, 0.16, 0.9);
    if (track.places && !this.hidden.has("places")) this.paintPlaces(track.places[k]);
    pen.save();
    pen.translate(...this.at(track.east[k], track.north[k]));
    pen.rotate(track.heading[k] * Math.PI / 180);
    pen.fillStyle = this.colour("--ink");
    pen.strokeStyle = this.colour("--paper");
    pen.lineWidth = 1.5;
    pen.beginPath();
    pen.moveTo(0, -22);
    pen.lineTo(7, -9);
    pen.arc(0, 0, 7, -0.6, Math.PI + 0.6);
    pen.lineTo(-7, -9);
    pen.closePath();
    pen.fill();
    pen.stroke();
    pen.restore();
  }
}
