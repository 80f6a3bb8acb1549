"use strict";
// Contents of a report. One step is selected at a time. Only `show` updates it, on the map, in the table and in the
// charts over time. The workbench shows reports again and again in one page: `end` removes what is outside of their elements.
function showReport({ tracks, tiles, origin }) {
  const root = document.documentElement;
  const BOUT_PAUSE_S = 2.5; // a longer pause separates bouts; the speed between bouts is unknown
  const PLAY_S = 20;
  const leaving = new AbortController(), { signal } = leaving;
  let track = tracks[0], charts = [], isFollowing = false, playing = null;

  const map = new WayMap(byId("map"), k => show(k));
  map.tracks = tracks;
  map.lieOn(tiles, origin);
  map.whole();

  // --- texts ---------------------------------------------------------------------------------------------------------

  const number = (value, digits) => value === null || value === undefined ? "–" : value.toFixed(digits).replace(/^-(0\.?0*)$/, "$1");

  const degrees = value => `${number(value === null ? null : Math.round(value) % 360, 0)}°`;

  function rows(k) {
    const t = track, found = [
      ["step", `${t.number[k]} of ${t.n_steps}`],
      ["time", `${clock(t.time[k], 1)}`],
      ["length", `${number(t.length[k], 2)} m`],
      ["heading", degrees(t.heading[k])],
      ["speed", t.speed[k] === null ? "–" : `${number(t.speed[k], 2)} ± ${number(t.speed_std[k], 2)} m/s`],
      ["walked", `${number(t.walked[k], 1)} m`],
      ["east, north", `${number(t.east[k], 1)}, ${number(t.north[k], 1)} m`],
      ["standard deviation", `± ${number(t.std[k], 1)} m`],
    ];
    if (t.height) found.push(["height, floor", `${number(t.height[k], 1)} m, ${t.floor[k] ?? "unknown"}`]);
    if (t.places?.[k].length) found.push(["possible positions", t.places[k].map(([percent]) => `${percent} %`).join(", ")]);
    if (t.phone_n_steps) found.push(["steps by the phone", number(t.phone_n_steps[k], 0)]);
    if (t.phone_heading) found.push(["heading by the phone", degrees(t.phone_heading[k])]);
    if (t.from_truth) found.push(["position error", `${number(t.from_truth[k], 1)} m`]);
    return found;
  }

  function describe(k) {
    const table = byId("step"), bars = byId("probabilities");
    table.replaceChildren();
    bars.replaceChildren();
    if (k < 0) return;
    table.append(...rows(k).map(([name, value]) => element("tr", {}, element("th", {}, name), element("td", {}, value))));
    track.contexts.forEach((name, c) => {
      const percent = track.prob[c][k];
      if (percent < 1) return;
      const fill = element("i");
      Object.assign(fill.style, { width: `${percent}%`, background: track.context_colours[c] });
      bars.append(element("div", { className: "bar" }, element("span", {}, name), element("span", {}, fill), element("b", {}, `${percent} %`)));
    });
  }

  // --- selected time ------------------------------------------------------------------------------------------------

  // Index of the last step at or before a time, or 0.
  function stepAt(time) {
    let low = 0, high = track.time.length;
    while (low < high) {
      const middle = (low + high) >> 1;
      if (track.time[middle] <= time) low = middle + 1; else high = middle;
    }
    return Math.min(Math.max(low - 1, 0), track.time.length - 1);
  }

  function show(k, time = track.time[k]) {
    map.show(k);
    describe(k);
    if (k < 0) return;
    byId("time").value = time;
    byId("clock").textContent = `${clock(time, 1)} of ${clock(track.end_s, 0)}`;
    isFollowing = true;
    for (const chart of charts) chart.setCursor({ left: chart.valToPos(track.time[k], "x"), top: 0 });
    isFollowing = false;
  }

  function play() {
    if (playing) {
      cancelAnimationFrame(playing);
      playing = null;
    } else {
      const slider = byId("time"), begin = performance.now();
      const from = slider.value >= track.end_s - 0.5 ? track.start_s : Number(slider.value);
      const pace = Math.max((track.end_s - track.start_s) / PLAY_S / 1000, 0.002);
      const frame = now => {
        const time = Math.min(from + Math.max(now - begin, 0) * pace, track.end_s);
        show(stepAt(time), time);
        playing = time < track.end_s ? requestAnimationFrame(frame) : null;
        if (!playing) label();
      };
      playing = requestAnimationFrame(frame);
    }
    label();
  }

  function label() {
    byId("play").textContent = playing ? "❚❚" : "▶";
    byId("play").setAttribute("aria-label", playing ? "pause" : "play");
  }

  // --- charts over time ----------------------------------------------------------------------------------------------

  const axis = (values, size) => ({
    stroke: () => styleColour("--faint"), font: "12px system-ui, sans-serif", values, size,
    grid: { stroke: () => styleColour("--line"), width: 1 }, ticks: { show: false },
  });

  function chart(id, height, data, series, more = {}) {
    const place = byId(id);
    const { scale = {}, hooks = {}, bands = [], splits, yValues } = more;
    const made = new uPlot({
      width: Math.max(place.clientWidth, 50), height, series: [{}, ...series], bands,
      legend: { show: false },
      cursor: { y: false, points: { show: false }, drag: { x: true, y: false } },
      scales: { x: { time: false, range: (_, low, high) => high > low ? [low, high] : [track.start_s, track.end_s] },
        y: scale },
      axes: [
        { ...axis((_, at) => at.map(s => clock(s, s % 1 ? 1 : 0)), 30), space: 70,
          incrs: [0.5, 1, 2, 5, 10, 15, 30, 60, 120, 300, 600, 900, 1800, 3600, 7200, 14400, 28800, 86400] },
        { ...axis(yValues, 44), ...splits && { splits: () => splits } },
      ],
      hooks: {
        ...hooks,
        setCursor: [u => { if (!isFollowing && u.cursor.left >= 0) show(stepAt(u.posToVal(u.cursor.left, "x"))); }],
        setScale: [(u, key) => {
          if (key !== "x" || isFollowing) return;
          isFollowing = true;
          const { min, max } = u.scales.x;
          for (const other of charts) if (other !== u) other.setScale("x", { min, max });
          isFollowing = false;
        }],
      },
    }, data, place);
    // A double click shows the whole walk. The default of uPlot would show only the range of the steps.
    made.over.addEventListener("dblclick", () => made.setScale("x", { min: track.start_s, max: track.end_s }));
    return made;
  }

  const dots = paint => ({ paths: () => null, points: { show: true, size: 4, width: 0, fill: paint, stroke: paint } });
  const hidden = { stroke: "transparent", points: { show: false } };
  const drawn = name => ({ stroke: () => styleColour(name), width: 1.6, points: { show: false } });

  // Value and 95 % interval, interrupted at pauses between steps.
  function banded(middle, std, floor = -Infinity) {
    const data = [[], [], [], []];
    track.time.forEach((time, k) => {
      const pause = k && time - track.time[k - 1] > BOUT_PAUSE_S;
      if (pause) [(time + track.time[k - 1]) / 2, null, null, null].forEach((v, i) => data[i].push(v));
      const missing = middle[k] === null || std[k] === null, m = middle[k], h = 1.96 * std[k];
      [time, missing ? null : Math.max(m - h, floor), missing ? null : m + h, m].forEach((v, i) => data[i].push(v));
    });
    return data;
  }

  // Direction at the top and at the bottom of the chart of headings: the one near which the fewest steps are, because legs
  // in this direction leave the range of one turn. South, if there are none.
  function cutOf(headings) {
    const steps = headings.filter(v => v !== null), apart = (a, b) => Math.abs((a - b + 540) % 360 - 180);
    const near = cut => steps.filter(v => apart(v, cut) < 40).length;
    const cuts = Array.from({ length: 24 }, (_, k) => 15 * (k + 1)).sort((a, b) => apart(a, 180) - apart(b, 180));
    return cuts.map(cut => [near(cut), cut]).reduce((best, each) => each[0] < best[0] ? each : best)[1];
  }

  // Headings with whole turns added, so that the steps of one leg are drawn without a jump. A leg begins within half a turn
  // of `middle`, and may then leave this range by a quarter turn. The median of five steps ignores single odd steps.
  function unwrapped(headings, middle) {
    const near = (value, to) => to + ((value - to + 180) % 360 + 360) % 360 - 180, known = headings.filter(value => value !== null), drawn = [];
    for (const value of known) {
      const recent = drawn.slice(-5).sort((a, b) => a - b), leg = [drawn.at(-1), recent[recent.length >> 1]];
      const found = near(value, leg.find(each => each !== undefined && Math.abs(near(value, each) - each) < 45) ?? middle);
      const back = Math.abs(found - middle) > 270 ? near(value, middle) - found : 0; // with the steps of its leg before
      for (let k = drawn.length - 1; back && k >= 0 && Math.abs(drawn[k] - found) < 45; k--) drawn[k] += back;
      drawn.push(found + back);
    }
    let k = 0;
    return headings.map(value => value === null ? null : drawn[k++]);
  }

  const band = { bands: [{ series: [2, 1], fill: () => styleColour("--accent") + "33" }] };

  function paintWindows(u) {
    const { left, top, width, height } = u.bbox, pen = u.ctx, { start, end, prob } = track.windows;
    pen.save();
    pen.beginPath();
    pen.rect(left, top, width, height);
    pen.clip();
    start.forEach((_, w) => {
      const x = Math.round(u.valToPos(start[w], "x", true)), until = Math.round(u.valToPos(end[w], "x", true));
      if (until < left || x > left + width) return;
      let low = 0;
      prob.forEach((of_context, c) => {
        const high = low + of_context[w] / 100, y = u.valToPos(high, "y", true);
        pen.fillStyle = track.context_colours[c] ?? track.without_steps_colour;
        if (high > low) pen.fillRect(x, y, Math.max(until - x, 1), u.valToPos(low, "y", true) - y);
        low = high;
      });
    });
    pen.strokeStyle = styleColour("--ink");
    pen.lineWidth = Math.min(Math.max(width / track.time.length / 8, 0.2), 1) * (devicePixelRatio || 1);
    pen.beginPath();
    track.time.forEach(time => {
      const x = u.valToPos(time, "x", true);
      pen.moveTo(x, u.valToPos(1.05, "y", true));
      pen.lineTo(x, u.valToPos(1.14, "y", true));
    });
    pen.stroke();
    pen.restore();
  }

  function build() {
    for (const old of charts) old.destroy();
    charts = [];
    const t = track, share = { range: [0, 1.15] }, from0 = { range: (_, low, high) => [0, Math.max(high * 1.1, 0.5)] };
    document.querySelectorAll(".needs-steps").forEach(section => { section.hidden = !t.time.length; });
    byId("height").closest("section").hidden = !t.height;
    const made = [];
    if (t.windows.start.length) {
      const ends = [t.start_s, t.end_s];
      made.push(chart("contexts", 170, [ends, [null, null]], [hidden], { scale: share, hooks: { draw: [paintWindows] },
        splits: [0, 0.5, 1], yValues: (_, at) => at }));
    }
    if (t.time.length) {
      if (t.height) made.push(chart("height", 180, banded(t.height, t.height_std), [hidden, hidden, drawn("--accent")], band));
      made.push(chart("speed", 180, banded(t.speed, t.speed_std, 0), [hidden, hidden, drawn("--accent")], { ...band, scale: from0 }));
      const of = t.contexts.map((_, c) => t.groups.contexts.group.map((own, k) => own === c ? t.length[k] : null));
      made.push(chart("lengths", 180, [t.time, ...of], t.context_colours.map(dots), { scale: from0 }));
      const middle = cutOf(t.heading) - 180, headings = [t.phone_heading, t.heading].filter(Boolean).map(each => unwrapped(each, middle));
      const ends = [Math.min, Math.max].map((end, k) => headings.flat().filter(v => v !== null).reduce((a, b) => end(a, b), middle + (k ? 180 : -180)));
      const quarters = Array.from({ length: 11 }, (_, k) => 90 * (k - 5));
      made.push(chart("heading", 180, [t.time, ...headings],
        [...headings.slice(1).map(() => dots(() => styleColour("--faint"))), dots(() => styleColour("--accent"))],
        { scale: { range: [ends[0] - 10, ends[1] + 10] }, splits: quarters.filter(v => v >= ends[0] && v <= ends[1]),
          yValues: (_, at) => at.map(v => `${(v + 720) % 360}°`) }));
    }
    charts = made;
    isFollowing = true;
    for (const each of charts) each.setScale("x", { min: t.start_s, max: t.end_s });
    isFollowing = false;
  }

  // Times in the warnings show their place on the map. The first place of each warning has its number there.
  document.querySelectorAll(".doubt").forEach(list => {
    const own = tracks[list.closest("[data-track]").dataset.track];
    own.warnings = [];
    list.querySelectorAll("li").forEach((line, n) => {
      const parts = line.textContent.split(/((?:from|between|at) (\d+)(?:(?: to| and|, \d+)[^.]*?)? s\b)/i);
      line.replaceChildren(parts[0]);
      for (let k = 1; k < parts.length; k += 3) {
        const time = Number(parts[k + 1]);
        if (k === 1) own.warnings.push([n + 1, time]);
        line.append(element("button", { type: "button", onclick: () => {
          show(stepAt(time));
          byId("map").scrollIntoView({ block: "nearest" });
        } }, parts[k]), parts[k + 2]);
      }
    });
  });

  // --- choices -------------------------------------------------------------------------------------------------------

  function layers() {
    const all = {
      ellipses: ["95 % uncertainty", track.ellipses.length],
      truth: [track.truth?.points ? "waypoints (ground truth), aligned" : "ground truth, aligned", track.truth],
      GPS: ["locations of the phone, with their accuracies", track.gps],
      plan: ["floor plan", track.plan.length],
      places: ["possible positions", track.places],
      anchors: ["anchors of ranges", track.anchors],
      warnings: ["numbers of warnings", track.warnings?.length],
      "other tracks": ["other tracks", tracks.length > 1],
    };
    byId("layers").replaceChildren(...Object.entries(all).filter(([, [, isThere]]) => isThere).map(([name, [words]]) => {
      const tick = element("input", { type: "checkbox", name, checked: !map.hidden.has(name), onchange: () => {
        map.hidden[tick.checked ? "delete" : "add"](name);
        map.draw();
      } });
      return element("li", {}, element("label", {}, tick, words));
    }));
  }

  // Legend of the path colours, by storey or by context.
  function colours() {
    const list = byId("colours"), kinds = Object.keys(track.groups);
    const kind = kinds.includes(map.groups) ? map.groups : "contexts", { names, colours: of, group } = track.groups[kind];
    list.replaceChildren();
    if (kinds.length > 1) {
      const other = kinds.find(k => k !== kind);
      list.append(element("li", {}, element("button", { type: "button", onclick: () => {
        map.groups = other;
        map.draw();
        colours();
      } }, `by ${other}`)));
    }
    [...new Set(group)].sort((a, b) => a - b).forEach(g => {
      const key = element("span", { className: "key" });
      key.style.background = of[g];
      list.append(element("li", {}, key, names[g]));
    });
    list.append(...["○ start", "■ end"].map(words => element("li", {}, words)));
  }

  function choose(number) {
    track = tracks[number];
    map.chosen = number;
    document.querySelectorAll("[data-track]").forEach(part => { part.hidden = Number(part.dataset.track) !== number; });
    Object.assign(byId("time"), { min: track.start_s, max: track.end_s, disabled: !track.time.length });
    byId("play").disabled = !track.time.length;
    layers();
    colours();
    build();
    map.row = -1; // the row belongs to the previous track
    map.draw();
    show(track.time.length - 1, track.end_s);
  }

  const paint = () => {
    map.draw();
    for (const each of charts) each.redraw(false);
  };
  addEventListener("themed", paint, { signal });
  byId("closer").addEventListener("click", () => map.zoom(1.5));
  byId("farther").addEventListener("click", () => map.zoom(1 / 1.5));
  byId("whole").addEventListener("click", () => map.whole());
  byId("play").addEventListener("click", play);
  byId("time").addEventListener("input", event => {
    if (playing) play();
    show(stepAt(Number(event.target.value)), Number(event.target.value));
  });
  document.querySelectorAll("input[name=track]").forEach(input =>
    input.addEventListener("change", () => choose(Number(input.value))));

  const fit = () => charts.forEach(each => each.setSize({ width: each.root.parentElement.clientWidth, height: each.height }));
  const sizes = new ResizeObserver(fit);
  sizes.observe(byId("over-time"));
  let before = "light";
  addEventListener("beforeprint", () => {
    before = root.dataset.theme;
    root.classList.add("printed");
    setTheme("light");
    fit();
    map.leaflet.invalidateSize(); // draws immediately, before printing
  }, { signal });
  addEventListener("afterprint", () => {
    root.classList.remove("printed");
    setTheme(before);
    fit();
  }, { signal });

  choose(0);
  const end = () => {
    leaving.abort();
    sizes.disconnect();
    if (playing) play();
    charts.forEach(each => each.destroy());
    map.end();
  };
  return { map, show, stepAt, end, get time() { return Number(byId("time").value); } }; // for a page around it
}
if (byId("data")) window.report = showReport(JSON.parse(byId("data").textContent));
