"use strict";
// Map in metres east and north, drawn by Leaflet, with grid and scale bar. Subclasses add the contents.

const ELLIPSE_CORNERS = 64; // the chords deviate by less than 0.2 % of the radius from the ellipse
// Objects on these maps do not react to clicks.
L.Path.mergeOptions({ interactive: false });
L.Marker.mergeOptions({ interactive: false, keyboard: false });
L.Polyline.mergeOptions({ smoothFactor: 0.5 });
L.Polygon.mergeOptions({ smoothFactor: 0 }); // no simplification, which would give ellipses corners
// Do not round to whole pixels, which would make curves jagged.
L.Map.include({ latLngToLayerPoint(place) { return this.project(place).subtract(this.getPixelOrigin()); } });
const NAVIGATION = {
  zoomSnap: 0, zoomDelta: 0.6, wheelPxPerZoomLevel: 120, keyboardPanDelta: 60, // finer steps than the defaults of Leaflet
  zoomControl: false, doubleClickZoom: false, attributionControl: false, // the pages have their own controls
};

// Coordinates of Leaflet: metres if there are no map tiles ...
const PLANE = {
  options: { crs: L.CRS.Simple, minZoom: -17, maxZoom: 8 }, // zoom levels are powers of two of pixels per metre
  at: (east, north) => L.latLng(north, east),
  place: ({ lat, lng }) => [lng, lat],
};

// ... and degrees on map tiles. Near the origin, a metre of the plane is a metre of WGS 84.
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

// A picture whose south-west, south-east and north-west corners can be anywhere: a floor plan may lie at an angle.
const PlacedPicture = L.ImageOverlay.extend({
  initialize(address, corners, options) {
    this.corners = corners;
    L.ImageOverlay.prototype.initialize.call(this, address, L.latLngBounds(corners), { className: "picture", pane: "tilePane", zIndex: 2, ...options });
  },
  _initImage() {
    L.ImageOverlay.prototype._initImage.call(this);
    this._image.transformTo = pixelOf => { // matrix from pixels of the picture to those of `pixelOf`
      const [sw, se, nw] = this.corners.map(pixelOf), { naturalWidth: w, naturalHeight: h } = this._image;
      return new DOMMatrix([(se.x - sw.x) / w, (se.y - sw.y) / w, (sw.x - nw.x) / h, (sw.y - nw.y) / h, nw.x, nw.y]);
    };
    this._image.addEventListener("load", () => { if (this._map) this._reset(); });
  },
  _put(pixelOf) { if (this._image.naturalWidth) this._image.style.transform = this._image.transformTo(pixelOf).toString(); },
  _reset() { this._put(place => this._map.latLngToLayerPoint(place)); },
  _animateZoom({ zoom, center }) { this._put(place => this._map._latLngToNewLayerPoint(place, zoom, center)); },
});

class PlaneMap {
  constructor(box) {
    this.box = box;
    this.frame = PLANE;
    const isCalm = matchMedia("(prefers-reduced-motion: reduce)").matches;
    const moves = { zoomAnimation: !isCalm, fadeAnimation: !isCalm, inertia: !isCalm };
    const padding = 0.5; // drawn margin relative to the map size, so that the path is visible while the map is dragged
    const renderer = L.canvas({ padding }), below = L.svg({ padding, pane: "squares" });
    this.above = L.svg({ padding, pane: "now" }); // separate renderer for frequent changes, so that other layers are not redrawn
    this.leaflet = L.map(box, { ...NAVIGATION, ...moves, ...PLANE.options, renderer }).setView(this.at(0, 0), Math.log2(10));
    if (isCalm) this.leaflet.panBy = (by, options) => L.Map.prototype.panBy.call(this.leaflet, by, { ...options, animate: false });
    this.leaflet.createPane("squares").style.zIndex = 150;
    this.leaflet.createPane("now").style.zIndex = 450;
    for (const each of [below, renderer, this.above]) each.addTo(this.leaflet);
    // After a jump, layers would lie between pixels until the next movement.
    this.leaflet.on("viewreset", () => this.leaflet.fire("moveend"));
    this.squares = L.polyline([], { renderer: below, className: "squares" }).addTo(this.leaflet);
    this.walker = this.mark(this.at(0, 0), "walker", "<svg viewBox='-12 -16 24 32'><path d='M0-15 9.5 11 0 5.5-9.5 11Z'/></svg>");
    this.bar = L.DomUtil.create("div", "bar-of-metres", box);
    L.DomUtil.create("div", "north", box).textContent = "N";
    this.leaflet.on("moveend", () => this.measure());
    this.sizes = new ResizeObserver(() => this.leaflet.invalidateSize());
    this.sizes.observe(box);
  }

  // Remove the map from the page, which keeps the box.
  end() {
    this.sizes.disconnect();
    this.leaflet.remove();
  }

  at(east, north) { return this.frame.at(east, north); }

  // Return east and north of a point of the box in pixels, by default of its centre.
  place(x = this.box.clientWidth / 2, y = this.box.clientHeight / 2) {
    return this.frame.place(this.leaflet.containerPointToLatLng([x, y]));
  }

  // Pixels per metre at the centre.
  get scale() {
    const [east, north] = this.place();
    return this.leaflet.project(this.at(east + 1, north)).x - this.leaflet.project(this.at(east, north)).x;
  }

  zoom(factor) { this.leaflet.zoomIn(Math.log2(factor)); }

  // Fit the view to these coordinates, with a minimum extent in metres.
  fit(easts, norths, least) {
    const reach = values => {
      const low = values.reduce((a, b) => Math.min(a, b)), high = values.reduce((a, b) => Math.max(a, b));
      const middle = (low + high) / 2, half = Math.max(high - low, least) * 0.56;
      return [middle - half, middle + half];
    };
    const [west, east] = reach(easts), [south, north] = reach(norths);
    this.leaflet.fitBounds([this.at(west, south), this.at(east, north)], { animate: false, reset: true });
  }

  // Change the coordinates of the map. The caller must add all layers again.
  lieIn(frame) {
    const [east, north] = this.place(), { scale } = this;
    this.frame = frame;
    Object.assign(this.leaflet.options, frame.options);
    this.leaflet.setView(this.at(east, north), 0, { reset: true });
    this.leaflet.setView(this.at(east, north), Math.log2(scale / this.scale), { reset: true });
  }

  // Lie on map tiles if their address and the geographic origin are known, else on the grid.
  lieOn(tiles, origin) {
    this.lieIn(tiles && origin ? world(origin) : PLANE);
    this.box.classList.toggle("has-tiles", Boolean(tiles && origin));
    this.ground?.remove();
    this.ground = null;
    this.credit?.remove();
    this.credit = null;
    if (!tiles || !origin) return;
    const host = new URL(tiles, location.href.replace(/[?#].*/, "")).hostname.replace("{s}.", "");
    const attribution = host.endsWith("openstreetmap.org") ? "© OpenStreetMap contributors" : host;
    this.credit = L.control.attribution({ prefix: false }).addTo(this.leaflet);
    this.ground = L.tileLayer(tiles, { maxNativeZoom: 19, maxZoom: 25, attribution }).addTo(this.leaflet);
  }

  // Return the corners of an ellipse. Half axes are in metres; the angle of the major axis is counter-clockwise from east.
  ellipse([east, north], major, minor, angle) {
    const cosine = Math.cos(angle), sine = Math.sin(angle);
    return Array.from({ length: ELLIPSE_CORNERS }, (_, k) => {
      const turn = 2 * Math.PI * k / ELLIPSE_CORNERS, a = major * Math.cos(turn), b = minor * Math.sin(turn);
      return this.at(east + a * cosine - b * sine, north + a * sine + b * cosine);
    });
  }

  // Return a marker of a fixed size in pixels, styled by its CSS class.
  mark(place, name, content = "", size = null) {
    const icon = L.divIcon({ className: name, html: content, iconSize: size && [size, size] });
    return L.marker(place, { icon });
  }

  // Place the arrow of the pedestrian, with a heading clockwise from north.
  stand(place, headingRad) {
    this.walker.setLatLng(place).addTo(this.leaflet);
    this.walker.getElement().firstChild.style.transform = `rotate(${headingRad}rad)`;
  }

  // Draw the grid and the scale bar.
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
