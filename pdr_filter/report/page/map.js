"use strict";
// The way of a report, with what lies beside and below it.

class WayMap extends CanvasMap {
  constructor(canvas, colour, onStep) {
    super(canvas, colour);
    this.onStep = onStep; // called with the number of the step that somebody points at
    this.hidden = new Set(); // layers
    this.tracks = [];
    this.chosen = 0;
    this.groups = "floors"; // by what steps are coloured, if there is more than one
    this.row = -1; // the last step that is shown in full
    this.isWhole = true;
    canvas.addEventListener("dblclick", () => this.whole());
    canvas.addEventListener("keydown", event => {
      if (event.key !== "0") return;
      this.whole();
      event.preventDefault();
    });
  }

  get track() { return this.tracks[this.chosen]; }

  resized() { if (this.isWhole) this.whole(); else this.draw(); }

  moved() { this.isWhole = false; }

  zoomed() { this.isWhole = false; }

  pressed(pixel) { this.point(pixel, 40); }

  pointed(pixel) { this.point(pixel, 40); }

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
    this.fit(easts, norths, 4);
    this.isWhole = true;
    this.draw();
  }

  paintBelow() { if (!this.hidden.has("plan")) this.paintPlan(); }

  paintAbove() {
    const shown = name => !this.hidden.has(name);
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
    if (major[k] !== null) this.ellipse([east[k], north[k]], major[k], minor[k], angle[k], fill, edge);
  }

  paintNow(track) {
    this.paintEllipse(this.row, 0.16, 0.9);
    this.walker([track.east[this.row], track.north[this.row]], track.heading[this.row] * Math.PI / 180);
  }
}
