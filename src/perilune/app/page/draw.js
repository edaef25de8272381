// Drawing: plots against time, the path, the ground track, a slice of the map. Nothing here asks for anything.
"use strict";
const Draw = (() => {
  const colours = new Map(); // until the scheme changes
  function css(name) {
    if (!colours.has(name)) { colours.set(name, getComputedStyle(document.documentElement).getPropertyValue(name).trim()); }
    return colours.get(name);
  }
  const PINS = [{ colour: "--pin1", dash: [7, 4] }, { colour: "--pin2", dash: [2, 3] }]; // of flights that are kept beside the one that moves
  const fine = (v) => v === null || v === undefined ? "none" : Math.abs(v) >= 1e5 || (v !== 0 && Math.abs(v) < 1e-3) ? v.toExponential(3) : String(+v.toPrecision(5));
  const plots = new Map();

  // One plot of several curves over a common x; kept and given new numbers as long as its curves are the same.
  // What is not on the screen waits until it is; a span below `least` is rounding, and looks like what it is: nothing.
  // Places and sizes are told by observers: to ask for them lays the page out again, each time that something was written.
  const later = new Map(), near = new Set(), sizes = new WeakMap();
  const due = (node) => { const work = later.get(node); later.delete(node); if (work) { work(); } };
  const places = new IntersectionObserver((found) => {
    for (const { target, isIntersecting } of found) { if (isIntersecting) { near.add(target); due(target); } else { near.delete(target); } }
  }, { rootMargin: "50px" });
  const measures = new ResizeObserver((found) => { for (const { target, contentRect } of found) { sizes.set(target, [contentRect.width, contentRect.height]); } });
  function whenSeen(node, work) { later.set(node, work); places.observe(node); if (near.has(node)) { due(node); } }
  function size(node) {
    if (!sizes.has(node)) { sizes.set(node, [node.clientWidth, node.clientHeight]); measures.observe(node); }
    return sizes.get(node);
  }
  addEventListener("beforeprint", () => { for (const node of [...later.keys()]) { due(node); } });

  // The range of a plot: a little more than what is drawn, and no less than says something.
  function room(low, high, least) {
    const most = Math.max(Math.abs(low), Math.abs(high)), span = Math.max(high - low, 1e-9 * most);
    if (high - low < 1e-9 * most && !least) { return [low - 0.1 * Math.abs(low) - 1e-9, high + 0.1 * Math.abs(high) + 1e-9]; }
    const more = Math.max(0.08 * span, 0.5 * (least - span), 1e-300);
    return [low - more, high + more];
  }
  // Ticks with as many digits as tell them apart; where that takes too many, how far each lies from the first.
  const short = (v, digits) => Math.abs(v) >= 1e5 || (v !== 0 && Math.abs(v) < 1e-3) ? v.toExponential(digits - 1).replace(/\.?0*e/, "e").replace("e+", "e") : String(+v.toPrecision(digits));
  function labels(ticks) {
    for (const digits of [4, 5, 6]) {
      const said = ticks.map((v) => short(v, digits));
      if (new Set(said).size === said.length && said.every((word) => word.length < 10)) { return said; }
    }
    return ticks.map((v, i) => i ? `+${short(v - ticks[0], 2)}` : short(v, 4));
  }

  // Curves over times of their own as uPlot takes them: over all times, undefined (which is no gap) at those of others.
  function joined(curves) {
    if (curves.length === 1) { return [curves[0].x, curves[0].values]; }
    const all = curves.flatMap((c, k) => c.x.map((t, i) => [t, k, i])).sort((a, b) => a[0] - b[0] || a[1] - b[1] || a[2] - b[2]);
    return [all.map((at) => at[0]), ...curves.map((c, k) => all.map((at) => at[1] === k ? c.values[at[2]] : undefined))];
  }
  // Curves are { x, values }: the first is the flight that moves, the others are pinned.
  function lines(box, key, title, unit, curves, height = 150, mark = null, least = 0) {
    box.style.minHeight = `${height}px`;
    whenSeen(box, () => drawn(box, key, title, unit, curves, height, mark, least));
  }
  function drawn(box, key, title, unit, curves, height, mark, least) {
    const known = plots.get(key), count = curves.length, width = size(box)[0] || 300, data = joined(curves);
    if (known && known.count === count && known.box === box) {
      known.mark = mark; known.least = least; known.plot.setData(data);
      if (known.width !== width) { known.width = width; known.plot.setSize({ width, height }); }
      return;
    }
    if (known) { known.plot.destroy(); }
    const ink = css("--soft"), grid = { stroke: css("--line"), width: 1 };
    const axis = { stroke: ink, grid, ticks: grid, font: "11px system-ui" }, wide = (_, said) => Math.max(66, 20 + 6.6 * Math.max(...(said || []).map((word) => word.length)));
    const entry = { count, box, width, mark, least };
    entry.plot = new uPlot({
      width, height, pxAlign: 0, title: unit ? `${title} [${unit}]` : title, scales: { x: { time: false }, y: { range: (_, low, high) => room(low, high, entry.least) } }, cursor: { points: { size: 5 } },
      legend: { show: false },
      axes: [{ ...axis, size: 26, values: (_, ticks) => labels(ticks) }, { ...axis, size: wide, space: 22, values: (_, ticks) => labels(ticks) }],
      series: [{}, ...curves.map((_, i) => ({ stroke: css(i ? PINS[i - 1].colour : "--go"), width: i ? 1.2 : 1.6, dash: i ? PINS[i - 1].dash : undefined, points: { show: false } }))],
      hooks: { draw: [(u) => {
        for (const point of entry.mark || []) {
          const px = u.valToPos(point[0], "x", true), py = u.valToPos(point[1], "y", true), c = u.ctx;
          c.save(); c.fillStyle = point[2] || css("--hot"); c.beginPath(); c.arc(px, py, 5 * devicePixelRatio, 0, 7); c.fill(); c.restore();
        }
      }] },
    }, data, box);
    entry.plot.root.setAttribute("role", "img"); entry.plot.root.setAttribute("aria-label", title);
    plots.set(key, entry);
  }
  function forget() { for (const entry of plots.values()) { entry.plot.destroy(); } plots.clear(); colours.clear(); }

  const el = (name, attributes, inside = "") => `<${name} ${Object.entries(attributes).map(([k, v]) => `${k}="${v}"`).join(" ")}>${inside}</${name}>`;
  const polyline = (points, more) => el("polyline", { points: points.map((p) => `${p[0].toFixed(1)},${p[1].toFixed(1)}`).join(" "), fill: "none", ...more });

  // The path over the limb (heights stretched) or over flat ground, of one flight or several.
  function path(box, flights) {
    const W = 560, H = 300, first = flights[0].phases.find((p) => p.way);
    if (!first) { box.innerHTML = "<p>This problem states no path in space.</p>"; return; }
    const limb = first.way.kind === "limb";
    const points = flights.map((f) => f.phases.filter((p) => p.way).map((p) => p.way.along.map((a, i) => [a, p.way.height[i], p.way.thrust ? [p.way.thrust[0][i], p.way.thrust[1][i]] : null])));
    const every = points.flat(2).filter((p) => p[0] !== null && p[1] !== null);
    const spanned = Math.max(...every.map((p) => p[0])) - Math.min(...every.map((p) => p[0]));
    const top = Math.max(1e-9, ...every.map((p) => p[1])), R = limb ? first.way.radius : 1;
    let place, ground, note, floor = Math.min(0, ...every.map((p) => p[1]));
    if (limb) {
      const round = spanned > 2, begin = Math.min(...every.map((p) => p[0])), end = begin + spanned;
      const stretch = round ? Math.max(1, Math.floor(0.25 * R / top)) : Math.max(1, Math.min(200, Math.floor(0.35 * R * spanned / top)));
      const at = (a, h) => { const r = R + stretch * h, b = round ? a - begin : a - 0.5 * (begin + end); return [r * Math.sin(b), r * Math.cos(b)]; };
      const edge = []; for (let i = 0; i <= 80; i++) { const extra = round ? 0 : 0.05 * spanned; edge.push(at(begin - extra + (round ? 2 * Math.PI : spanned + 2 * extra) * i / 80, 0)); }
      place = at; ground = edge; note = stretch > 1 ? `height × ${stretch}` : "";
    } else { place = (a, h) => [a, h]; ground = [[Math.min(...every.map((p) => p[0])), floor], [Math.max(...every.map((p) => p[0])), floor]]; note = ""; }
    const all = [...every.map((p) => place(p[0], p[1])), ...ground];
    const low = [Math.min(...all.map((p) => p[0])), Math.min(...all.map((p) => p[1]))], high = [Math.max(...all.map((p) => p[0])), Math.max(...all.map((p) => p[1]))];
    const k = Math.min((W - 40) / Math.max(high[0] - low[0], 1e-9), (H - 40) / Math.max(high[1] - low[1], 1e-9));
    const across = (W - k * (high[0] - low[0])) / 2, up = (H - k * (high[1] - low[1])) / 2;
    const screen = (p) => [across + k * (p[0] - low[0]), H - up - k * (p[1] - low[1])];
    let inside = polyline(ground.map(screen), { stroke: css("--body"), "stroke-width": 4 });
    flights.forEach((_, f) => points[f].forEach((leg) => {
      const seen = leg.filter((p) => p[0] !== null).map((p) => screen(place(p[0], p[1])));
      inside += polyline(seen, { stroke: css(f ? PINS[f - 1].colour : "--go"), "stroke-width": f ? 1.5 : 2.5, "stroke-dasharray": f ? PINS[f - 1].dash.join(" ") : "none" });
      if (f === 0) {
        leg.forEach((p, i) => {
          if (!p[2] || i % Math.max(1, Math.floor(leg.length / 14)) || Math.hypot(...p[2]) < 0.5) { return; }
          const here = place(p[0], p[1]), out = place(p[0], p[1] + 1), on = place(p[0] + 1e-4, p[1]);
          const unit = (v) => { const n = Math.hypot(...v) || 1; return [v[0] / n, v[1] / n]; };
          const o = unit([out[0] - here[0], out[1] - here[1]]), n = unit([on[0] - here[0], on[1] - here[1]]);
          const s = screen(here), d = [p[2][0] * o[0] + p[2][1] * n[0], p[2][0] * o[1] + p[2][1] * n[1]];
          inside += el("line", { x1: s[0], y1: s[1], x2: s[0] - 22 * d[0], y2: s[1] + 22 * d[1], stroke: css("--hot"), "stroke-width": 1.4 });
        });
        if (seen.length) { inside += el("circle", { cx: seen[0][0], cy: seen[0][1], r: 3, fill: css("--ink") }); }
      }
    }));
    inside += el("text", { x: 10, y: H - 8, fill: css("--soft"), "font-size": 12 }, note);
    box.innerHTML = el("svg", { viewBox: `0 0 ${W} ${H}`, xmlns: "http://www.w3.org/2000/svg", id: "path-svg" }, inside);
  }

  function canvas(node) {
    const ratio = devicePixelRatio || 1, [w, h] = size(node);
    if (node.width !== Math.round(w * ratio)) { node.width = Math.round(w * ratio); node.height = Math.round(h * ratio); }
    const c = node.getContext("2d"); c.setTransform(ratio, 0, 0, ratio, 0, 0); c.clearRect(0, 0, w, h); c.setLineDash([]);
    return [c, w, h];
  }

  // Longitudes and latitudes on a globe that is turned to the middle of the first track.
  function ground(node, flights, coasts) {
    const [c, w, h] = canvas(node), names = flights[0].views.ground, r = Math.min(w, h) / 2 - 8, t = Math.PI / 180;
    const [track, ...pinned] = flights.map((f) => f.phases.flatMap((p) => p.columns[names[0]] && p.columns[names[1]] ? p.columns[names[0]].values.map((v, i) => [v, p.columns[names[1]].values[i]]) : []).filter((p) => p[0] !== null));
    if (!track.length) { return; }
    const last = track[track.length - 1], mid = track[Math.floor(0.7 * track.length)] || last;
    const turned = ([lon, lat]) => {
      const a = (lon - mid[0]) * t, b = lat * t, b0 = mid[1] * t;
      return [w / 2 + r * Math.cos(b) * Math.sin(a), h / 2 - r * (Math.sin(b) * Math.cos(b0) - Math.cos(b) * Math.sin(b0) * Math.cos(a)), Math.sin(b) * Math.sin(b0) + Math.cos(b) * Math.cos(b0) * Math.cos(a) > 0];
    };
    const stroke = (points, colour, width, dash = []) => {
      c.strokeStyle = colour; c.lineWidth = width; c.setLineDash(dash); c.beginPath(); let down = false;
      for (const p of points.map(turned)) { if (p[2]) { down ? c.lineTo(p[0], p[1]) : c.moveTo(p[0], p[1]); } down = p[2]; }
      c.stroke();
    };
    c.fillStyle = css("--paper"); c.strokeStyle = css("--body"); c.lineWidth = 1; c.beginPath(); c.arc(w / 2, h / 2, r, 0, 7); c.fill(); c.stroke();
    for (let lon = -180; lon < 180; lon += 30) { stroke(Array.from({ length: 37 }, (_, i) => [lon, -90 + 5 * i]), css("--line"), 0.6); }
    for (let lat = -60; lat <= 60; lat += 30) { stroke(Array.from({ length: 73 }, (_, i) => [-180 + 5 * i, lat]), css("--line"), 0.6); }
    for (const line of coasts) { stroke(line, css("--soft"), 0.7); }
    pinned.forEach((points, k) => stroke(points, css(PINS[k].colour), 1.4, PINS[k].dash)); stroke(track, css("--go"), 2.2);
    const back = (px, py) => { // from the screen to longitude and latitude; null beside the globe
      const u = (px - w / 2) / r, v = (h / 2 - py) / r, q = 1 - u * u - v * v, b0 = mid[1] * t; if (q < 0) { return null; }
      const z = Math.sqrt(q), lat = Math.asin(v * Math.cos(b0) + z * Math.sin(b0)), lon = Math.atan2(u, z * Math.cos(b0) - v * Math.sin(b0));
      return [mid[0] + lon / t, lat / t];
    };
    const end = turned(last); if (end[2]) { c.fillStyle = css("--hot"); c.beginPath(); c.arc(end[0], end[1], 4, 0, 7); c.fill(); }
    return back;
  }

  // From above: east and north of flights, each to its site, which may have moved; the same numbers back from the screen.
  function plan(node, flights, sites, frame) {
    const [c, w, h] = canvas(node), tracks = flights.map((f, k) => [series(f, "east").map((v) => v + sites[k][0]), series(f, "north").map((v) => v + sites[k][1])]);
    const east = [...tracks.flatMap((t) => t[0]), ...sites.map((s) => s[0])], north = [...tracks.flatMap((t) => t[1]), ...sites.map((s) => s[1])];
    const box = frame || [Math.min(...east), Math.max(...east), Math.min(...north), Math.max(...north)];
    const span = Math.max(box[1] - box[0], box[3] - box[2]) * 1.35 || 1, k = Math.min(w, h) / span, mid = [(box[0] + box[1]) / 2, (box[2] + box[3]) / 2];
    const at = (e, n) => [w / 2 + k * (e - mid[0]), h / 2 - k * (n - mid[1])];
    c.strokeStyle = css("--line"); c.lineWidth = 1;
    const step = 10 ** Math.floor(Math.log10(span / 2)), first = (v) => Math.ceil(v / step) * step;
    for (let e = first(mid[0] - w / 2 / k); e < mid[0] + w / 2 / k; e += step) { c.beginPath(); c.moveTo(at(e, 0)[0], 0); c.lineTo(at(e, 0)[0], h); c.stroke(); }
    for (let n = first(mid[1] - h / 2 / k); n < mid[1] + h / 2 / k; n += step) { c.beginPath(); c.moveTo(0, at(0, n)[1]); c.lineTo(w, at(0, n)[1]); c.stroke(); }
    tracks.forEach((t, k) => {
      c.strokeStyle = css(k ? PINS[k - 1].colour : "--go"); c.lineWidth = k ? 1.4 : 2.2; c.setLineDash(k ? PINS[k - 1].dash : []);
      c.beginPath(); t[0].forEach((e, i) => { const p = at(e, t[1][i]); i ? c.lineTo(p[0], p[1]) : c.moveTo(p[0], p[1]); }); c.stroke();
    });
    const s = at(...sites[0]); c.fillStyle = css("--hot"); c.beginPath(); c.arc(s[0], s[1], 6, 0, 7); c.fill();
    return { box, step, back: (px, py) => [mid[0] + (px - w / 2) / k, mid[1] - (py - h / 2) / k] };
  }
  const series = (flight, name) => flight.phases.flatMap((p) => p.columns[name] ? p.columns[name].values : []);

  const ramp = (s) => { const stops = [[68, 1, 84], [59, 82, 139], [33, 145, 140], [94, 201, 98], [253, 231, 37]], x = Math.max(0, Math.min(3.9999, 4 * s)), i = Math.floor(x), f = x - i; return `rgb(${stops[i].map((v, j) => Math.round(v + f * (stops[i + 1][j] - v))).join(",")})`; };

  // A slice of the map by colour, or as a curve, with the present point on it; what the colours mean stands beside it.
  function slice(node, shown, at, sizes, sign, unit) {
    const along = shown.axes.length, [c, w, h] = canvas(node), left = 62, bottom = 34, W = w - left - (along > 1 ? 92 : 12), H = h - bottom - 10;
    const good = shown.objective.filter((v) => v !== null).map((v) => sign * v), least = Math.min(...good), most = Math.max(...good);
    const x = shown.along[0], nx = x.length, px = (v) => left + W * (v - x[0]) / (x[nx - 1] - x[0]), share = (v) => (sign * v - least) / (most - least || 1);
    c.font = "11px system-ui"; c.strokeStyle = css("--line");
    const text = (s, a, b, align = "center") => { c.textAlign = align; c.fillStyle = css("--soft"); c.fillText(s, a, b); };
    const [low, middle, high] = most > least ? labels([least, (least + most) / 2, most]) : [fine(least), "", ""];
    if (along === 1) {
      const py = (v) => 10 + H * (1 - share(v));
      c.strokeStyle = css("--go"); c.lineWidth = 1.8; c.beginPath(); let down = false;
      shown.objective.forEach((v, i) => { if (v !== null) { down ? c.lineTo(px(x[i]), py(v)) : c.moveTo(px(x[i]), py(v)); } down = v !== null; });
      c.stroke();
      if (good.length) { text(low, left - 6, 10 + H, "right"); text(high, left - 6, 18, "right"); }
      const v = shown.objective[Math.round((at[0] - x[0]) / (x[nx - 1] - x[0]) * (nx - 1))];
      if (v !== null && v !== undefined) { c.fillStyle = css("--hot"); c.beginPath(); c.arc(px(at[0]), py(v), 5, 0, 7); c.fill(); }
    } else {
      const y = shown.along[1], ny = y.length, py = (v) => 10 + H * (1 - (v - y[0]) / (y[ny - 1] - y[0]));
      for (let i = 0; i < nx; i++) { for (let j = 0; j < ny; j++) {
        const v = shown.objective[i * ny + j]; if (v === null) { continue; }
        c.fillStyle = ramp(share(v));
        c.fillRect(left + W * (i - 0.5) / (nx - 1), 10 + H * (1 - (j + 0.5) / (ny - 1)), W / (nx - 1) + 1, H / (ny - 1) + 1);
      } }
      c.clearRect(0, 0, left, h); c.clearRect(left + W, 0, w, h); c.clearRect(0, 10 + H, w, h); c.clearRect(0, 0, w, 10);
      text(fine(y[0] / sizes[1]), left - 6, 10 + H, "right"); text(fine(y[ny - 1] / sizes[1]), left - 6, 18, "right");
      if (good.length) {
        const bar = left + W + 12, top = 28, tall = 10 + H - top, rows = most > least ? Math.round(tall) : 0;
        for (let k = 0; k < rows; k++) { c.fillStyle = ramp(1 - k / (rows - 1)); c.fillRect(bar, top + k, 12, 1.5); }
        text(unit === "1" ? "" : `[${unit}]`, bar, 18, "left"); text(high, bar + 17, top + 8, "left"); text(middle, bar + 17, top + tall / 2 + 4, "left"); text(low, bar + 17, 10 + H, "left");
      }
      c.strokeStyle = "#fff"; c.fillStyle = css("--hot"); c.lineWidth = 2; c.beginPath(); c.arc(px(at[0]), py(at[1]), 6, 0, 7); c.fill(); c.stroke();
    }
    text(fine(x[0] / sizes[0]), left, h - 18, "left"); text(fine(x[nx - 1] / sizes[0]), left + W, h - 18, "right");
    return { px: (v) => x[0] + (v - left) / W * (x[nx - 1] - x[0]), py: (v) => shown.axes.length > 1 ? shown.along[1][0] + (1 - (v - 10) / H) * (shown.along[1][shown.along[1].length - 1] - shown.along[1][0]) : null };
  }

  return { lines, labels, path, ground, plan, series, slice, forget, whenSeen, fine, css };
})();
