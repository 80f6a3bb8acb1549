"use strict";
// A plane on a canvas that is moved and zoomed, metres east and north with a grid. What lies on it is for who extends it.

class CanvasMap {
  constructor(canvas, colour) {
    this.canvas = canvas;
    this.colour = colour; // of a name in the style
    this.view = { east: 0, north: 0, scale: 10 }; // of the middle; pixels per metre
    this.listen();
    new ResizeObserver(() => this.resized()).observe(canvas);
  }

  // What others do when somebody moves or zooms, presses, points; when the canvas has another size; under and over the grid.
  moved() {}
  zoomed() {}
  pressed() {}
  pointed() {}
  resized() { this.draw(); }
  paintBelow() {}
  paintAbove() {}

  get size() { return [this.canvas.clientWidth, this.canvas.clientHeight]; }

  listen() {
    const canvas = this.canvas, touching = new Map();
    let way = 0;
    canvas.addEventListener("pointerdown", event => {
      canvas.setPointerCapture(event.pointerId);
      touching.set(event.pointerId, [event.offsetX, event.offsetY]);
      way = 0;
    });
    canvas.addEventListener("pointermove", event => {
      const now = [event.offsetX, event.offsetY], before = touching.get(event.pointerId);
      if (!before) return this.pointed(now);
      way += Math.hypot(now[0] - before[0], now[1] - before[1]);
      const other = [...touching].find(([id]) => id !== event.pointerId)?.[1];
      if (other) {
        const apart = p => Math.hypot(p[0] - other[0], p[1] - other[1]);
        this.zoom(apart(now) / Math.max(apart(before), 1), other);
      } else if (way > 5) {
        this.pan(now[0] - before[0], now[1] - before[1]);
      }
      touching.set(event.pointerId, now);
    });
    canvas.addEventListener("pointerup", event => {
      touching.delete(event.pointerId);
      if (way <= 5) this.pressed([event.offsetX, event.offsetY]);
    });
    canvas.addEventListener("pointercancel", event => touching.delete(event.pointerId));
    canvas.addEventListener("wheel", event => {
      event.preventDefault();
      this.zoom(1.2 ** -Math.sign(event.deltaY), [event.offsetX, event.offsetY]);
    }, { passive: false });
    canvas.addEventListener("keydown", event => {
      const by = { ArrowLeft: [60, 0], ArrowRight: [-60, 0], ArrowUp: [0, 60], ArrowDown: [0, -60] }[event.key];
      if (event.ctrlKey || event.metaKey || event.altKey) return;
      if (by) this.pan(...by);
      else if (event.key === "+" || event.key === "=") this.zoom(1.5);
      else if (event.key === "-") this.zoom(1 / 1.5);
      else return;
      event.preventDefault();
    });
  }

  // Drag what is shown by so many pixels.
  pan(x, y) {
    this.view.east -= x / this.view.scale;
    this.view.north += y / this.view.scale;
    this.moved();
    this.draw();
  }

  // The place under the pixel stays where it is.
  zoom(factor, pixel = this.size.map(v => v / 2)) {
    const [east, north] = this.place(...pixel);
    this.view.scale = Math.min(Math.max(this.view.scale * factor, 1e-5), 1000);
    const now = this.place(...pixel);
    this.view.east += east - now[0];
    this.view.north += north - now[1];
    this.zoomed();
    this.draw();
  }

  // Show all of these, and so many metres at least.
  fit(easts, norths, least) {
    const [low, high] = [easts, norths].map(v => [v.reduce((a, b) => Math.min(a, b)), v.reduce((a, b) => Math.max(a, b))]);
    const [width, height] = this.size, room = v => Math.max(v[1] - v[0], least) * 1.12;
    this.view = { east: (low[0] + low[1]) / 2, north: (high[0] + high[1]) / 2,
      scale: Math.max(Math.min(width / room(low), height / room(high)), 1e-5) };
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
    this.paintBelow();
    this.paintGrid(width, height);
    this.paintAbove();
  }

  line(east, north, colour, width, from = 0, to = east.length) {
    const pen = this.pen;
    pen.strokeStyle = colour;
    pen.lineWidth = width;
    pen.beginPath();
    for (let k = from; k < to; k++) pen[k > from ? "lineTo" : "moveTo"](...this.at(east[k], north[k]));
    pen.stroke();
  }

  dot(place, radius, colour) {
    const pen = this.pen;
    pen.fillStyle = colour;
    pen.beginPath();
    pen.arc(...this.at(...place), radius, 0, 7);
    pen.fill();
  }

  // Half axes in metres; the angle of the major one, counter-clockwise from east.
  ellipse(place, major, minor, angle, fill, edge) {
    const pen = this.pen, { scale } = this.view;
    pen.beginPath();
    pen.ellipse(...this.at(...place), major * scale, minor * scale, -angle, 0, 7);
    pen.fillStyle = pen.strokeStyle = this.colour("--accent");
    pen.lineWidth = 1.2;
    pen.globalAlpha = fill;
    pen.fill();
    pen.globalAlpha = edge;
    pen.stroke();
    pen.globalAlpha = 1;
  }

  // Somebody who is there and walks this way, clockwise from north.
  walker(place, headingRad) {
    const pen = this.pen;
    pen.save();
    pen.translate(...this.at(...place));
    pen.rotate(headingRad);
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
}
