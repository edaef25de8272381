// The page: what is moved is asked for, and what comes is shown. Only the newest answer counts.
"use strict";
(() => {
  const $ = (id) => document.getElementById(id), HOT = 60, DECIMAL = /^[-+]?(\d+\.?\d*|\.\d+)(e[-+]?\d+)?$/i, UNPROVED = "stored without a proof to level 3";
  const state = { knobs: [], values: {}, first: {}, number: 0, shown: -1, flight: null, pins: [], past: [], ahead: [], slice: null, family: null, frames: 0, asked: 0, maximised: "", unlinked: "" };
  window.perilune = state; // for who looks, and for tests
  const frozen = window.PERILUNE_FROZEN || null;
  let socket = null, waiting = [], again = false, dirty = false;

  const text = (node, said) => { node.textContent = said; };
  const called = (flight, name) => flight.labels[name] || name.replaceAll("_", " ");
  const told = (v, unit) => `${Draw.fine(v)}${unit && unit !== "1" ? " " + unit : ""}`;
  const numeral = (v) => v !== 0 && !(Math.abs(v) >= 1e-4 && Math.abs(v) < 1e8) ? v.toExponential(6).replace(/\.?0*e\+?/, "e") : String(+v.toPrecision(7)); // as a field has room for
  function result({ value, unit }) {
    const [v, said] = unit === "rad" ? [value * 180 / Math.PI, "deg"] : [value, unit];
    return value === null ? "none" : `${numeral(v)} ${said === "1" ? "" : said}`.trim();
  }

  // -- asking ---------------------------------------------------------------------------------------------------
  function ask() {
    state.number += 1; state.asked = performance.now();
    if (frozen) { frozen.answer(state.number, state.values, receive); return; }
    if (!socket || socket.readyState !== 1) { return; }
    if (waiting.length > 1) { again = true; return; } // one is computed and one waits: only the newest follows
    waiting.push(state.number); again = false;
    socket.send(JSON.stringify({ number: state.number, values: state.values, slice: axes() }));
  }
  function receive(said) {
    if (said.type === "hello") { state.client = said.client; begin(said); return; }
    if (said.type === "progress") { // what takes long makes way for what is newer
      if (said.number >= state.shown) { state.doing = said; dirty = true; }
      if (again) { waiting = waiting.slice(0, 1); }
    }
    if (said.type === "notice") { state.notice = said.words; dirty = true; }
    if (["flight", "refusal", "fault", "slice", "family", "compared", "proof", "notice"].includes(said.type)) { state.doing = null; }
    if (said.type === "flight" || said.type === "refusal" || said.type === "fault") { waiting = waiting.filter((number) => number > said.number); }
    if (said.number < state.shown) { if (again) { ask(); } return; } // of before what was refused as no request at all
    if (said.type === "flight") { state.flight = said; state.shown = said.number; state.frames += 1; state.family = null; state.refused = null; state.notice = ""; dirty = true; }
    if (said.type === "refusal" || said.type === "fault") { state.refused = said; state.shown = said.number ?? state.number; dirty = true; }
    if (said.type === "family") { state.family = said; dirty = true; }
    if (said.type === "slice") { state.slice = said; dirty = true; }
    if (said.type === "compared" && said.number === state.shown) { state.flight.compared = said.words; if (said.extremals) { state.flight.extremals = said.extremals; state.flight.roots = said.roots; } dirty = true; }
    if (said.type === "proof" && said.number === state.shown && !again) { state.flight.proof = said.proof; state.flight.proved = said; dirty = true; }
    if (again) { ask(); }
    if (dirty) { dirty = false; requestAnimationFrame(show); }
  }
  function connect() {
    if (frozen) { receive({ type: "hello", ...frozen.hello }); return; }
    socket = new WebSocket(location.href.replace(/^http/, "ws").replace(/[?#].*$/, "").replace(/\/(index\.html)?$/, "") + "/live");
    socket.onmessage = (event) => receive(JSON.parse(event.data));
    socket.onclose = ({ reason }) => { state.ended = `${reason ? `The program has closed this page: ${reason}` : "The program has ended, or too many pages are open"}: start perilune explore again, and reload.`; show(); };
  }

  // -- parameters -----------------------------------------------------------------------------------------------
  function begin(said) {
    document.title = `${said.title} · perilune`; text($("title"), said.title); state.knobs = said.knobs; state.coasts = said.coasts || []; state.maximised = said.maximised;
    text($("stored"), said.stored ? `A page in a file: ${said.stored}.` : "");
    for (const knob of said.knobs) { state.first[knob.name] = knob.value; }
    state.values = linked();
    const few = said.knobs.filter((k) => k.mapped), main = few.length ? few : said.knobs.filter((k) => !k.natural).slice(0, 8), rest = said.knobs.filter((k) => !main.includes(k));
    $("knob-list").replaceChildren(...main.map(row)); $("more-list").replaceChildren(...rest.map(row)); $("more").hidden = !rest.length || !!frozen;
    $("scenario").hidden = !!frozen; if (!said.scenario) { $("scenario").title = `None: ${said.unwritten}`; }
    $("scenario").onclick = () => { if (said.scenario) { fetched("scenario.toml", "text/plain"); } else { state.notice = `there is no scenario to download: ${said.unwritten}`; show(); } };
    $("figures").hidden = !!frozen; $("slice-box").hidden = !few.length;
    for (const [id, place] of [["slice-x", 0], ["slice-y", 1]]) {
      $(id).replaceChildren(...(place ? [new Option("nothing else", "")] : []), ...few.map((k) => new Option(k.key, k.name)));
      if (few[place]) { $(id).value = few[place].name; }
      $(id).onchange = ask;
    }
    ask();
  }
  function linked() { // the values that the address holds; what of it cannot be taken is said
    const from = new URLSearchParams(location.hash.slice(1)), lost = new Set(from.keys());
    const values = Object.fromEntries(state.knobs.map((k) => {
      const said = from.get(k.key), v = said && DECIMAL.test(said.trim()) ? Number(said) : NaN;
      if (!Number.isFinite(v)) { return [k.name, state.first[k.name]]; }
      const at = placed(k, v * k.size); if (at === v * k.size && from.getAll(k.key).length === 1) { lost.delete(k.key); }
      return [k.name, at];
    }));
    state.unlinked = lost.size ? `not as the link says: ${[...lost].map((key) => `${key}=${from.get(key)}`.slice(0, 60)).join(", ")}` : "";
    return values;
  }
  const nearest = (grid, v) => grid.reduce((best, at) => Math.abs(at - v) < Math.abs(best - v) ? at : best);
  const placed = (knob, v) => knob.grid ? nearest(knob.grid, v) : v; // what is outside a slider's range widens it
  const clamp = (knob, v) => { const now = state.values[knob.name]; return placed(knob, Math.min(Math.max(knob.high, now), Math.max(Math.min(knob.low, now), v)) / knob.size * knob.size); }; // as it is shown
  function exact(knob, v) { // the number in the unit that is shown which gives this value to the last bit, for links
    const near = v / knob.size, step = Math.abs(near) * 2 ** -53;
    return [0, 1, -1, 2, -2, 3, -3, 4, -4].map((k) => near + k * step).find((at) => at * knob.size === v) ?? near;
  }
  function row(knob) {
    const box = document.createElement("div"), id = "knob-" + knob.name, label = document.createElement("label"), name = document.createElement("b");
    const slider = document.createElement("input"), number = document.createElement("input"), right = document.createElement("span");
    box.className = "knob"; name.append(...knob.key.split(/(?<=[._])/).flatMap((piece) => [piece, document.createElement("wbr")])); label.htmlFor = id;
    slider.type = "range"; slider.id = id; slider.step = "any"; slider.dataset.name = knob.name;
    number.type = "number"; number.step = "any"; number.setAttribute("aria-label", `${knob.key} in ${knob.unit}`);
    right.append(number, " " + (knob.unit === "1" ? "" : knob.unit)); label.append(name, right); box.append(label, slider);
    const set = () => {
      const v = exact(knob, state.values[knob.name]);
      slider.min = Math.min(knob.low / knob.size, v); slider.max = Math.max(knob.high / knob.size, v); slider.value = v; slider.setAttribute("aria-valuetext", told(v, knob.unit));
      number.title = String(v); if (document.activeElement !== number) { number.value = numeral(v); }
    };
    knob.set = set; set();
    let held = false;
    const move = (v) => { // what stays where it is is no step back, and asks nothing
      const to = placed(knob, v * knob.size);
      if (to !== state.values[knob.name]) { if (!held) { remember(); held = true; } state.values[knob.name] = to; ask(); }
      set();
    };
    slider.oninput = () => move(parseFloat(slider.value)); slider.onchange = () => { held = false; save(); };
    slider.onpointerdown = () => { held = false; }; // a touch where it is already ends without a change
    slider.onpointercancel = () => { if (held) { held = false; restore(state.past.pop()); } }; // a finger that scrolls the page moves nothing
    slider.onkeydown = (event) => { // an even step, ten times as far with Shift
      const way = { ArrowRight: 1, ArrowUp: 1, ArrowLeft: -1, ArrowDown: -1 }[event.key];
      if (way) { event.preventDefault(); held = false; move(clamp(knob, state.values[knob.name] + way * (event.shiftKey ? 10 : 1) * (knob.high - knob.low) / 200) / knob.size); held = false; save(); }
    };
    const wrong = document.createElement("p"); wrong.className = "wrong"; wrong.setAttribute("role", "alert"); box.append(wrong);
    number.oninput = () => text(wrong, "");
    number.onchange = () => {
      const v = parseFloat(number.value), taken = Number.isFinite(v), what = number.validity.badInput ? "That is no number that can be used" : "No number was typed";
      if (taken) { held = false; move(v); held = false; save(); }
      number.value = numeral(exact(knob, state.values[knob.name]));
      const moved = taken && knob.grid && Math.abs(v - number.value) > 1e-3 * Math.abs(knob.high - knob.low) / knob.size;
      text(wrong, !taken ? `${what}: it stays at ${told(+number.value, knob.unit)}.` : moved ? `This page holds some values alone: the nearest is ${told(+number.value, knob.unit)}.` : "");
    };
    return box;
  }
  function remember() { state.past.push({ ...state.values }); if (state.past.length > HOT) { state.past.shift(); } state.ahead = []; state.unlinked = ""; buttons(); }
  function restore(values) { state.values = { ...values }; for (const k of state.knobs) { k.set(); } save(); buttons(); ask(); }
  function undo() { if (state.past.length) { state.unlinked = ""; state.ahead.push({ ...state.values }); restore(state.past.pop()); } }
  function redo() { if (state.ahead.length) { state.unlinked = ""; state.past.push({ ...state.values }); restore(state.ahead.pop()); } }
  function buttons() { $("undo").disabled = !state.past.length; $("redo").disabled = !state.ahead.length; }
  function hash() { const moved = new URLSearchParams(); for (const k of state.knobs) { if (state.values[k.name] !== state.first[k.name]) { moved.set(k.key, exact(k, state.values[k.name])); } } return moved.toString(); }
  function save() { history.replaceState(null, "", "#" + hash()); }
  function axes() { const a = $("slice-x").value, b = $("slice-y").value; return [a, b].filter((name, i, all) => name && all.indexOf(name) === i); }

  // -- showing --------------------------------------------------------------------------------------------------
  function show() {
    const refused = state.refused, flight = state.flight;
    const late = !!state.doing && state.doing.number > state.shown; // what is shown is of other values, and for longer than a frame
    $("refusal").hidden = !refused; $("view").classList.toggle("stale", !!refused || late || !!state.ended);
    if (refused) {
      const lines = [refused.what, refused.reason, refused.got && `got: ${refused.got}`, refused.expected && `expected: ${refused.expected}`, refused.try && `try: ${refused.try}`];
      text($("refusal"), lines.filter(Boolean).join("\n"));
      const node = document.createElement("span"); text(node, (refused.impossible ? "physics says no" : "no answer here") + (flight ? "; below is the flight before" : "")); waits([node]);
      return;
    }
    if (!flight) { waits([]); return; }
    text($("title"), flight.title); late ? waits(["below is the flight before"]) : source(flight); numbers(flight);
    drawn(flight);
  }
  function drawn(flight) {
    const flights = [flight, ...state.pins.map((pin) => pin.flight)];
    legends(flight); Draw.path($("path"), flights);
    const flat = !flight.views.ground && Draw.series(flight, "east").length && Draw.series(flight, "north").length;
    $("ground-box").hidden = !flight.views.ground && !flat;
    if (!$("ground-box").hidden) { Draw.whenSeen($("ground"), () => from_above(flights, flat)); }
    histories(flight); extremals(flight); lights(flight); map();
  }
  function source(flight) {
    const proof = flight.proved, took = flight.latency < 1 ? `${(1000 * flight.latency).toFixed(1)} ms` : `${flight.latency.toFixed(1)} s`, parts = [];
    const part = (kind, words) => { const node = document.createElement(kind); text(node, words); parts.push(node); };
    if (proof) { part(proof.outcome === "PROVED" ? "b" : "i", `${proof.outcome}, level ${proof.level}, in ${proof.took.toFixed(1)} s`); }
    part(flight.source === "jumped" ? "i" : "span", flight.compared ? `${flight.words}, ${flight.compared}` : flight.words);
    if (flight.source !== "stored") { part("span", took); }
    waits(parts);
  }
  function waits(parts) { // what is done now, and what went wrong beside it
    const doing = state.doing && document.createElement("span");
    if (doing) { text(doing, `${state.doing.words.length > 90 ? state.doing.words.slice(0, 90) + "…" : state.doing.words}, ${state.doing.took.toFixed(0)} s`); parts.push(doing); }
    for (const words of [state.notice, state.unlinked].filter(Boolean)) { const node = document.createElement("i"); text(node, words); parts.push(node); }
    if (state.ended) { parts = [state.ended]; } // whatever it was: nothing that is moved now is answered
    $("source").replaceChildren(...parts.flatMap((node, i) => i ? ["; ", node] : [node]));
    hear(parts.filter((node) => node !== doing).map((node) => node.textContent ?? node));
  }
  let soon = 0;
  function hear(parts) { // for who hears the page: when nothing has moved for a moment, and not every second of what takes long
    clearTimeout(soon);
    soon = setTimeout(() => {
      const [first] = state.flight && !state.refused ? Object.entries(state.flight.results) : [], more = state.doing ? "at work" : first ? `${called(state.flight, first[0])} ${result(first[1])}` : "";
      const said = [...parts, more].filter(Boolean).join("; "); if ($("said").textContent !== said) { text($("said"), said); }
    }, 700);
  }
  function numbers(flight) {
    $("numbers").replaceChildren(...Object.entries(flight.results).map(([name, one]) => {
      const box = document.createElement("div"), label = document.createElement("span"), value = document.createElement("b");
      text(label, called(flight, name)); text(value, result(one)); box.title = one.description || ""; box.append(label, value);
      state.pins.forEach((pin, k) => { const other = pin.flight.results[name]; if (other) { const em = document.createElement("em"); em.className = `pin${k + 1}`; text(em, `pinned ${k + 1}: ${result(other)}`); box.append(em); } });
      return box;
    }));
  }
  function series(flight, name) {
    const x = [], values = []; let unit = "";
    for (const phase of flight.phases) {
      const column = phase.columns[name]; if (!column) { continue; }
      unit = column.unit;
      phase.time.forEach((t, i) => { // no line where an angle goes on from the other end of its range
        if (i && unit === "deg" && Math.abs(column.values[i] - column.values[i - 1]) > 180) { x.push(t); values.push(null); }
        x.push(t); values.push(column.values[i]);
      });
    }
    return { x, values, unit };
  }
  function histories(flight) {
    const names = [...new Set(flight.phases.flatMap((p) => Object.keys(p.columns)))];
    const adjoint = names.filter((n) => n.startsWith("lambda_") || n === "H");
    const shown = flight.views.histories.flatMap((h) => h.quantities).filter((n, i, all) => names.includes(n) && all.indexOf(n) === i);
    // Of the controls: what the problem shows of them (an angle, a throttle), and their own components where it shows none.
    const steering = shown.filter((n) => /thrust|(?<!path_)angle|throttle|bank|lift|attack|pointing/.test(n) && n !== "thrust_acceleration");
    const turned = steering.length ? steering : flight.views.controls.filter((n) => names.includes(n));
    const others = shown.filter((n) => !turned.includes(n)), rest = names.filter((n) => !adjoint.includes(n) && !shown.includes(n) && !flight.views.controls.includes(n));
    panels("states", flight, [...others, ...rest].slice(0, 10)); panels("controls", flight, turned.slice(0, 6));
    panels("costates", flight, [...adjoint.filter((n) => n !== "H").slice(0, 9), ...adjoint.filter((n) => n === "H")]);
  }
  function legends(flight) { // which line is which flight, and what of the pinned ones is not as it is now
    const entries = state.pins.map(({ values }, k) => {
      const other = state.knobs.filter((one) => values[one.name] !== (flight.values[one.name] ?? one.value));
      const said = other.slice(0, 3).map((one) => `${one.key} ${told(exact(one, values[one.name]), one.unit)}`);
      return [`pin${k + 1}`, `pinned ${k + 1}: ${[...said, ...(other.length > 3 ? [`${other.length - 3} more`] : [])].join(", ") || "the same values"}`];
    });
    for (const box of document.querySelectorAll(".legend")) {
      box.hidden = !entries.length;
      box.replaceChildren(...[["now", "now"], ...entries].map(([kind, words]) => { const entry = document.createElement("span"); entry.className = kind; entry.append(document.createElement("i"), words); return entry; }));
    }
  }
  function panels(id, flight, names) {
    const parent = $(id);
    for (const box of [...parent.children]) { if (!names.includes(box.dataset.name)) { box.remove(); } }
    for (const name of names) {
      let box = [...parent.children].find((child) => child.dataset.name === name);
      if (!box) { box = document.createElement("div"); box.dataset.name = name; parent.append(box); }
      const own = series(flight, name), curves = [own, ...state.pins.map((pin) => series(pin.flight, name))];
      const least = name === "H" ? 1e-6 * Math.abs(flight.objective) / (own.x[own.x.length - 1] || 1) : 0;
      if (own.x.length) { Draw.lines(box, `${id}-${name}`, called(flight, name), own.unit, curves, 128, null, least); }
    }
  }
  function extremals(flight) {
    const rows = flight.extremals, table = document.createElement("table"), names = rows.length ? Object.keys(rows[0]) : [], head = table.insertRow();
    for (const name of names) { const th = document.createElement("th"); const { unit } = name === "objective" ? flight : flight.results[name] || {}; text(th, name.replaceAll("_", " ") + (unit && unit !== "1" ? ` [${unit}]` : "")); head.append(th); }
    for (const entry of rows) { const line = table.insertRow(); for (const name of names) { text(line.insertCell(), typeof entry[name] === "number" ? Draw.fine(entry[name]) : entry[name]); } }
    $("extremals").replaceChildren(table);
    const family = state.family, sign = state.maximised ? -1 : 1; $("family").classList.toggle("stale", !family); // of the flight before
    if (family && family.values.length > 2) {
      const others = flight.roots.slice(1).filter((e) => family.name in e.free).map((e) => [e.free[family.name], sign * e.objective, Draw.css("--ink")]);
      const mark = [...others, [flight.free[family.name], sign * flight.objective]];
      Draw.lines($("family"), "family", `${state.maximised ? state.maximised.replaceAll("_", " ") : "J"} along ${family.name.replaceAll("_", " ")}${family.unit === "1" ? "" : ` [${family.unit}]`}`, flight.unit, [{ x: family.values, values: family.objective.map((v) => sign * v) }], 170, mark);
    }
  }
  function lights(flight) {
    const checks = flight.proof.checks;
    if (flight.proved || checks.length) { text($("proof-words"), flight.proved ? `${flight.proved.outcome} at level ${flight.proved.level}: ${checks.filter((c) => c.passed).length} of ${checks.length} checks passed` : ""); }
    else { text($("proof-words"), frozen ? "Stored without a proof to level 3: a page with a server behind it proves what it shows." : "Not proved yet: it is when nothing is moved for a moment."); }
    $("lights").replaceChildren(...checks.map((check) => { const li = document.createElement("li"); li.className = check.passed ? "yes" : "no"; li.title = check.meaning; text(li, `${check.level} ${check.name}: ${Draw.fine(check.value)}, limit ${told(check.limit, check.unit)}${check.passed ? "" : " FAILED"}`); return li; }));
  }
  let unproject = null;
  function map() {
    const shown = state.slice, off = state.knobs.filter((k) => !k.mapped && state.values[k.name] !== state.first[k.name]);
    $("slice").hidden = off.length > 0;
    if (off.length) { text($("slice-words"), `The map is of another ${off.map((k) => k.key).join(", ")}.`); return; }
    if (!shown) { return; }
    const by = Object.fromEntries(state.knobs.map((k) => [k.name, k])), at = shown.axes.map((n) => state.values[n]);
    Draw.whenSeen($("slice"), () => { unproject = Draw.slice($("slice"), shown, at, shown.axes.map((n) => by[n].size), state.maximised ? -1 : 1, state.flight.unit); });
    const reasons = [...new Set(shown.why.filter((w) => w >= 0))].map((w) => shown.reasons[w]);
    const sheets = new Set(shown.sheet.filter((s) => s >= 0)).size;
    text($("slice-words"), `${state.maximised ? state.maximised.replaceAll("_", " ") : "J"}${state.flight.unit === "1" ? "" : ` [${state.flight.unit}]`} over ${shown.axes.map((n) => `${by[n].key} [${by[n].unit}]`).join(" and ")}, answered by ${sheets === 1 ? "one sheet" : `${sheets} sheets`}${reasons.length ? "; blank: " + reasons.join("; ") : ""}. Click to go there.`);
  }
  $("slice").onclick = (event) => {
    if (!unproject || !state.slice) { return; }
    const box = $("slice").getBoundingClientRect(), to = [unproject.px(event.clientX - box.left), unproject.py(event.clientY - box.top)];
    remember(); state.slice.axes.forEach((name, i) => { const knob = state.knobs.find((k) => k.name === name); state.values[name] = clamp(knob, to[i]); knob.set(); }); save(); ask();
  };

  // The landing site may be dragged: on the globe by its longitude and latitude, from above by where the approach begins.
  let back = null, frame = null, dragging = false;
  const knob = (name) => state.knobs.find((k) => k.name === name);
  function from_above(flights, flat) {
    const moves = flat ? knob("approach_east") && knob("approach_north") : knob("site_longitude") && knob("site_latitude");
    text($("ground-title"), flat ? "From above" : "Ground track");
    $("ground").style.touchAction = moves ? "none" : ""; // a finger moves the site, not the page
    if (flat) {
      const shown = Draw.plan($("ground"), flights, [state, ...state.pins].map(offset), dragging ? frame : null);
      frame = shown.box; if (!dragging) { back = shown.back; }
      text($("ground-words"), `a line every ${Draw.fine(shown.step)} m${moves ? "; drag the landing site" : ""}`);
    } else {
      const found = Draw.ground($("ground"), flights, state.coasts); if (!dragging) { back = found; }
      text($("ground-words"), moves ? "Drag the landing site." : "");
    }
  }
  const offset = ({ values }) => ["approach_east", "approach_north"].map((name) => knob(name) ? state.first[name] - values[name] : 0);
  function toSite(event) {
    const box = $("ground").getBoundingClientRect(), to = back && back(event.clientX - box.left, event.clientY - box.top);
    if (!to) { return; }
    const put = (name, v) => { const k = knob(name); if (k) { state.values[name] = clamp(k, v); k.set(); } };
    if ($("ground-title").textContent === "From above") { ["approach_east", "approach_north"].forEach((name, i) => put(name, state.first[name] - to[i])); }
    else { const lon = to[0] * Math.PI / 180, now = state.values.site_longitude; put("site_longitude", lon + 2 * Math.PI * Math.round((now - lon) / (2 * Math.PI))); put("site_latitude", to[1] * Math.PI / 180); }
    ask();
  }
  $("ground").onpointerdown = (event) => { if (back && $("ground-words").textContent.match(/drag/i)) { dragging = true; remember(); $("ground").setPointerCapture(event.pointerId); toSite(event); } };
  $("ground").onpointermove = (event) => { if (dragging) { toSite(event); } };
  $("ground").onpointerup = $("ground").onpointercancel = () => { dragging = false; save(); show(); };

  // -- tools ----------------------------------------------------------------------------------------------------
  function give(name, kind, content) {
    const a = document.createElement("a"); a.href = URL.createObjectURL(new Blob([content], { type: kind })); a.download = name; a.click(); setTimeout(() => URL.revokeObjectURL(a.href), 1000);
  }
  $("undo").onclick = undo; $("redo").onclick = redo; $("reset").onclick = () => { if (hash()) { remember(); restore(state.first); } };
  $("pin").onclick = () => { if (!state.flight) { return; } if (state.pins.length >= 2) { state.pins = []; } else { state.pins.push({ values: { ...state.first, ...state.flight.values }, flight: state.flight }); } text($("pin"), state.pins.length >= 2 ? "Unpin all" : "Pin"); whole(); };
  $("link").onclick = async () => { save(); try { await navigator.clipboard.writeText(location.href); text($("link"), "Copied"); } catch { text($("link"), "Copy the address above"); } setTimeout(() => text($("link"), "Copy link"), 1500); };
  $("csv").onclick = () => {
    if (!frozen) { fetched("flight.csv", "text/csv"); return; }
    const f = state.flight; if (!f) { return; }
    const names = [...new Set(f.phases.flatMap((p) => Object.keys(p.columns)))], unit = (n) => (f.phases.find((p) => p.columns[n]) || { columns: {} }).columns[n].unit;
    const lines = [["phase", "time [s]", ...names.map((n) => `${n} [${unit(n)}]`), "proof"].join(",")];
    for (const p of f.phases) { p.time.forEach((t, i) => lines.push([p.name, t, ...names.map((n) => p.columns[n] ? p.columns[n].values[i] : ""), UNPROVED].join(","))); }
    give("flight.csv", "text/csv", lines.join("\n") + "\n");
  };
  const verdict = (f) => f.proved ? `${f.proved.outcome}, level ${f.proved.level}` : f.source === "stored" ? UNPROVED : "not proved yet";
  $("picture").onclick = () => { // with what it shows and what is known of that, as it may go where nothing else tells
    if (!$("path-svg")) { state.notice = "there is no path to draw: the problem states none"; show(); return; }
    const made = $("path-svg").cloneNode(true), [, , wide, high] = made.getAttribute("viewBox").split(" ").map(Number), more = 34;
    const put = (name, attributes, said = "") => { const node = document.createElementNS(made.namespaceURI, name); for (const [k, v] of Object.entries(attributes)) { node.setAttribute(k, v); } text(node, said); return node; };
    made.setAttribute("viewBox", `0 0 ${wide} ${high + more}`); made.prepend(put("rect", { width: wide, height: high + more, fill: Draw.css("--paper") }));
    [state.flight.title, verdict(state.flight)].forEach((said, i) => made.append(put("text", { x: 10, y: high + 12 + 14 * i, fill: Draw.css("--ink"), "font-size": 11, "font-family": "sans-serif" }, said)));
    give("path.svg", "image/svg+xml", made.outerHTML);
  };
  async function fetched(name, kind) {
    const refuse = (words) => { text($("refusal"), words); $("refusal").hidden = false; };
    try {
      const answer = await fetch(`${name}?${new URLSearchParams({ client: state.client, number: state.shown })}`); // what is shown
      if (answer.ok) { give(name, kind, await answer.blob()); } else { refuse(await answer.text()); }
    } catch { refuse(`${name} did not come: ${state.ended || "the program does not answer"}`); }
  }
  $("figures").onclick = () => fetched("figures.zip", "application/zip");
  document.addEventListener("keydown", (event) => {
    if (!(event.ctrlKey || event.metaKey) || event.target.type === "number") { return; }
    const key = event.key.toLowerCase(); // with Shift it is a capital
    if (key === "z") { event.preventDefault(); event.shiftKey ? redo() : undo(); } else if (key === "y") { event.preventDefault(); redo(); }
  });
  addEventListener("hashchange", () => { // a link into an open page
    if (location.hash.slice(1) === hash()) { return; }
    const to = linked(), lost = state.unlinked;
    if (state.knobs.some((k) => to[k.name] !== state.values[k.name])) { remember(); }
    state.unlinked = lost; restore(to);
  });
  document.querySelector(".skip").onclick = (event) => { event.preventDefault(); $("knobs").focus(); $("knobs").scrollIntoView(); }; // the address holds values
  new ResizeObserver(([head]) => document.documentElement.style.setProperty("--head", `${head.target.offsetHeight}px`)).observe(document.querySelector("header"));
  const whole = () => { show(); if (state.refused && state.flight) { numbers(state.flight); drawn(state.flight); } }; // the flight before, behind a refusal, too
  const redrawn = () => { Draw.forget(); whole(); };
  addEventListener("resize", redrawn);
  matchMedia("(prefers-color-scheme: dark)").addEventListener("change", redrawn);
  connect();
})();
