"use strict";
// A map of a plane, metres east and north, by Leaflet: squares and a bar to measure by. What lies on it is for who
// extends it.

const ELLIPSE_CORNERS = 64; // the chords are then within 0.1 % of the curve
// Nothing that lies on these maps is pressed.
L.Path.mergeOptions({ interactive: false });
L.Marker.mergeOptions({ interactive: false, keyboard: false });
L.Polyline.mergeOptions({ smoothFactor: 0.5 });
L.Polygon.mergeOptions({ smoothFactor: 0 }); // otherwise ellipses have corners
// Whole pixels make a curve crooked.
L.Map.include({ latLngToLayerPoint(place) { return this.project(place).subtract(this.getPixelOrigin()); } });
const NAVIGATION = {
  zoomSnap: 0, zoomDelta: 0.6, wheelPxPerZoomLevel: 120, keyboardPanDelta: 60, // a bit nearer or farther
  zoomControl: false, doubleClickZoom: false, attributionControl: false, // pages have their own
};

// What Leaflet reckons with: metres where nothing lies below the way, ...
const PLANE = {
  options: { crs: L.CRS.Simple, minZoom: -17, maxZoom: 8 }, // pixels per metre are a power of two
  at: (east, north) => L.latLng(north, east),
  place: ({ lat, lng }) => [lng, lat],
};

// ... degrees where there are tiles. Near the origin a metre of the plane is one of WGS 84.
function world([latitude, longitude]) {
  const a = 6378137, e2 = 0.00669437999014, sine = Math.sin(latitude * Math.PI / 180), w = 1 - e2 * sine ** 2;
  const northPerDegree = Math.PI / 180 * a * (1 - e2) / w ** 1.5;
  const eastPerDegree = Math.PI / 180 * a * Math.sqrt((1 - sine ** 2) / w);
  return {
    options: { crs: L.CRS.EPSG3857, minZoom: 0, maxZoom: 25 },
    at: (east, north) => L.latLng(latitude + north / northPerDegree, longitude + east / eastPerDegree),
    place: ({ lat, lng }) => [(lng - longitude) * eastPerDegree, (lat - latitude) * northPerDegree],
  };
}

class PlaneMap {
  constructor(box, colour) {
    this.box = box;
    this.colour = colour; // of a name in the style
    this.frame = PLANE;
    const isCalm = matchMedia("(prefers-reduced-motion: reduce)").matches;
    const moves = { zoomAnimation: !isCalm, fadeAnimation: !isCalm, inertia: !isCalm };
    const padding = 0.5; // of the map's size on each side, so that there is a way where somebody drags to
    const renderer = L.canvas({ padding }), below = L.svg({ padding, pane: "squares" });
    this.above = L.svg({ padding, pane: "now" }); // of what changes often: nothing else is drawn again
    this.leaflet = L.map(box, { ...NAVIGATION, ...moves, ...PLANE.options, renderer }).setView(this.at(0, 0), Math.log2(10));
    if (isCalm) this.leaflet.panBy = (by, options) => L.Map.prototype.panBy.call(this.leaflet, by, { ...options, animate: false });
    this.leaflet.createPane("squares").style.zIndex = 150;
    this.leaflet.createPane("now").style.zIndex = 450;
    for (const each of [below, renderer, this.above]) each.addTo(this.leaflet);
    // A jump leaves them between pixels until something moves.
    this.leaflet.on("viewreset", () => this.leaflet.fire("moveend"));
    this.squares = L.polyline([], { renderer: below, className: "squares" }).addTo(this.leaflet);
    this.walker = this.mark(this.at(0, 0), "walker", "<svg viewBox='-12 -16 24 32'><path d='M0-15 9.5 11 0 5.5-9.5 11Z'/></svg>");
    this.bar = L.DomUtil.create("div", "bar-of-metres", box);
    L.DomUtil.create("div", "north", box).textContent = "N";
    this.leaflet.on("moveend", () => this.measure());
    new ResizeObserver(() => this.leaflet.invalidateSize()).observe(box);
  }

  at(east, north) { return this.frame.at(east, north); }

  // East and north of a place in the box, the middle of it at first.
  place(x = this.box.clientWidth / 2, y = this.box.clientHeight / 2) {
    return this.frame.place(this.leaflet.containerPointToLatLng([x, y]));
  }

  // Pixels per metre in the middle.
  get scale() {
    const [east, north] = this.place();
    return this.leaflet.project(this.at(east + 1, north)).x - this.leaflet.project(this.at(east, north)).x;
  }

  zoom(factor) { this.leaflet.zoomIn(Math.log2(factor)); }

  // Show all of these, and so many metres at least.
  fit(easts, norths, least) {
    const reach = values => {
      const low = values.reduce((a, b) => Math.min(a, b)), high = values.reduce((a, b) => Math.max(a, b));
      const middle = (low + high) / 2, half = Math.max(high - low, least) * 0.56;
      return [middle - half, middle + half];
    };
    const [west, east] = reach(easts), [south, north] = reach(norths);
    this.leaflet.fitBounds([this.at(west, south), this.at(east, north)], { animate: false, reset: true });
  }

  // From now on in another frame; what lies on the map must be put there again.
  lieIn(frame) {
    const [east, north] = this.place(), { scale } = this;
    this.frame = frame;
    Object.assign(this.leaflet.options, frame.options);
    this.leaflet.setView(this.at(east, north), 0, { reset: true });
    this.leaflet.setView(this.at(east, north), Math.log2(scale / this.scale), { reset: true });
  }

  // Whose tiles they are stands on the map.
  tilesOf(address) {
    const host = new URL(address, location.href.replace(/[?#].*/, "")).hostname.replace("{s}.", "");
    const attribution = host.endsWith("openstreetmap.org") ? "© OpenStreetMap contributors" : host;
    L.control.attribution({ prefix: false }).addTo(this.leaflet);
    return L.tileLayer(address, { maxNativeZoom: 19, maxZoom: 25, attribution });
  }

  // Half axes in metres; the angle of the major one, counter-clockwise from east.
  ellipse([east, north], major, minor, angle) {
    const cosine = Math.cos(angle), sine = Math.sin(angle);
    return Array.from({ length: ELLIPSE_CORNERS }, (_, k) => {
      const turn = 2 * Math.PI * k / ELLIPSE_CORNERS, a = major * Math.cos(turn), b = minor * Math.sin(turn);
      return this.at(east + a * cosine - b * sine, north + a * sine + b * cosine);
    });
  }

  // Something of a size on the screen; its style is that of the class.
  mark(place, name, content = "", size = null) {
    const icon = L.divIcon({ className: name, html: content, iconSize: size && [size, size] });
    return L.marker(place, { icon });
  }

  // Somebody is there and walks this way, clockwise from north.
  stand(place, headingRad) {
    this.walker.setLatLng(place).addTo(this.leaflet);
    this.walker.getElement().firstChild.style.transform = `rotate(${headingRad}rad)`;
  }

  // Squares, and how many metres one is wide.
  measure() {
    const { scale } = this, { x: width, y: height } = this.leaflet.getSize();
    const target = 60 / scale, power = 10 ** Math.floor(Math.log10(target));
    const step = [1, 2, 5, 10].map(n => n * power).find(n => n >= target * 0.999);
    this.bar.textContent = step >= 1000 ? `${step / 1000} km` : `${Number(step.toPrecision(1))} m`;
    this.bar.style.width = `${step * scale}px`;
    const [west, north] = this.place(-width / 2, -height / 2), [east, south] = this.place(1.5 * width, 1.5 * height);
    const lines = [];
    for (let i = Math.ceil(west / step); i * step < east; i++) lines.push([this.at(i * step, south), this.at(i * step, north)]);
    for (let i = Math.ceil(south / step); i * step < north; i++) lines.push([this.at(west, i * step), this.at(east, i * step)]);
    this.squares.setLatLngs(lines);
  }
}
