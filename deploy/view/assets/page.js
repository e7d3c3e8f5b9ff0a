"use strict";
// Script of the page: shows the channel's state, and turns keys, buttons and taps into commands.
(() => {
  const $ = (id) => document.getElementById(id);
  const page = { state: null, channel: null, plot: null, queue: [], number: 0, shown: {}, frames: 0 };

  // --- commands: at most one message in a turn of the event loop ------------------------------------
  function send(op, more = {}) {
    page.queue.push({ op, ...more });
    if (page.queue.length === 1) queueMicrotask(flush);
  }
  function flush() {
    if (page.channel) page.channel.command = { number: ++page.number, commands: page.queue };
    page.queue = [];
  }

  // --- numbers --------------------------------------------------------------------------------------
  const fixed = (value, digits) => (value === null || value === undefined ? "–" : value.toFixed(digits));
  function short(value) {
    if (typeof value === "boolean") return value ? "yes" : "no";
    if (typeof value !== "number") return value === null ? "–" : String(value);
    if (Number.isInteger(value)) return String(value);
    const size = Math.abs(value);
    return size >= 1e-4 && size < 1e6 ? String(+value.toPrecision(6)) : value.toExponential(3);
  }
  function element(tag, attributes = {}, ...children) {
    const made = document.createElement(tag);
    for (const [name, value] of Object.entries(attributes)) {
      if (name.startsWith("on")) made.addEventListener(name.slice(2), value);
      else if (value !== false && value !== null) made.setAttribute(name, value === true ? "" : value);
    }
    made.append(...children);
    return made;
  }
  // Rebuild a part of the page only when what it shows has changed: a button under the pointer must stay.
  function changed(name, value) {
    const text = JSON.stringify(value);
    if (page.shown[name] === text) return false;
    page.shown[name] = text;
    return true;
  }

  // --- the parts of the page ------------------------------------------------------------------------
  function showClock(s) {
    $("time").textContent = `${s.time_s.toFixed(3)} s`;
    $("tick").textContent = s.tick < 0 ? "–" : s.tick.toLocaleString("en");
    $("rtf").textContent = s.live ? `${fixed(s.real_time_factor, 2)} ×` : s.run === "ended" ? "ended" : "replay";
    $("lag").textContent = s.live ? `${fixed(s.lag_s, 2)} s` : "–";
  }
  function showControls(s) {
    const control = s.allows.includes("control") || !s.following;
    $("toggle").textContent = s.playing ? "❚❚ Pause" : s.following ? "▶ Run" : "▶ Play";
    for (const id of ["toggle", "step", "reset"]) $(id).disabled = !control || (s.following && s.run === "ended");
    $("follow").hidden = !s.live;
    $("follow").setAttribute("aria-pressed", String(s.following));
    $("reverse").hidden = s.following;
    $("reverse").setAttribute("aria-pressed", String(s.backwards));
    const speeds = page.channel.menu.speeds.map((v) => [String(v), `${v} ×`]);
    if (s.following) speeds.push(["", "fastest"]);
    if (s.speed !== null && !page.channel.menu.speeds.includes(s.speed)) speeds.unshift([String(s.speed), `${short(s.speed)} ×`]);
    if (changed("speeds", [speeds, s.speed])) {
      $("speed").replaceChildren(...speeds.map(([value, label]) => element("option", { value }, label)));
      $("speed").value = s.speed === null ? "" : String(s.speed);
    }
    $("speed").disabled = !control;
  }
  function showLooks(s) {
    if (changed("colours", s.colours)) {
      $("colour").replaceChildren(...s.colours.map((c) => element("option", { value: c.name }, c.label)));
    }
    if (document.activeElement !== $("colour")) $("colour").value = s.legend.name;
    if (changed("layers", [s.layers, page.channel.menu.layers])) {
      for (const { name, label } of page.channel.menu.layers) {
        let box = $(`layer-${name}`);
        if (!box) {
          box = element("input", { type: "checkbox", id: `layer-${name}` });
          box.addEventListener("change", () => send("layer", { name, on: box.checked }));
          $("layers").append(element("label", {}, box, label));
        }
        box.checked = s.layers.includes(name);
      }
    }
    if (changed("legend", s.legend)) showLegend(s.legend);
  }
  function showLegend(legend) {
    const unit = legend.unit ? `, ${legend.unit}` : "";
    const parts = [element("div", {}, legend.label + unit)];
    if (legend.categories.length) {
      for (const { name, colour } of legend.categories)
        parts.push(element("div", { class: "kind" }, element("i", { style: `background:${colour}` }), name));
    } else {
      parts.push(element("div", { class: "bar", style: `background:linear-gradient(90deg,${legend.scale.join(",")})` }));
      parts.push(element("div", { class: "ends" }, element("span", {}, short(+legend.low.toPrecision(3))), element("span", {}, short(+legend.high.toPrecision(3)))));
    }
    $("legend").replaceChildren(...parts);
  }

  // --- the inspector: rows keep their elements, values change in place ---------------------------------
  function showInspector(s) {
    const facts = s.selected;
    const outline = facts && [facts.title, facts.sections.map((x) => [x.name, x.rows.map((r) => r.name)]), facts.faults, s.allows, facts.neighbours];
    if (changed("inspector", outline)) buildInspector(facts, s);
    if (!facts) return;
    for (const section of facts.sections)
      for (const row of section.rows) {
        const cell = page.cells[`${section.name}/${row.name}`];
        const many = Array.isArray(row.value);
        const text = `${many ? row.value.map(short).join(", ") : short(row.value)}${row.unit && row.value !== null ? ` ${row.unit}` : ""}`;
        if (cell.textContent !== text) cell.textContent = text;
        const exact = JSON.stringify(row.value);
        if (cell.dataset.value !== exact) cell.dataset.value = exact;
      }
    for (const section of facts.sections) if (section.note && page.notes[section.name]) page.notes[section.name].textContent = ` ${section.note}`;
  }
  function buildInspector(facts, s) {
    page.cells = {};
    page.notes = {};
    if (!facts) {
      $("inspector").replaceChildren(
        element("p", { class: "empty" }, "Tap a cell or a parcel, or press the keys W A S D or P. A second tap on a cell selects the parcel above it."),
      );
      return;
    }
    const parts = [element("h3", { id: "selected" }, facts.title)];
    if (facts.kind === "cell") parts.push(...faultParts(facts, s));
    for (const section of facts.sections) {
      const note = element("small");
      page.notes[section.name] = note;
      parts.push(element("h2", {}, section.name, note));
      const body = element("tbody");
      for (const row of section.rows) {
        const cell = element("td");
        page.cells[`${section.name}/${row.name}`] = cell;
        const plotted = section.name === "Registers" || section.name === "Inbox" || section.name === "Outbox";
        const name = row.name.split(" ")[0];
        body.append(element("tr", { title: plotted ? "double click: plot" : null, ondblclick: () => plotted && send("register", { name }) }, element("td", {}, row.name), cell));
      }
      parts.push(element("table", {}, body));
    }
    if (facts.neighbours.length) {
      parts.push(element("h2", {}, "Neighbours"));
      parts.push(element("div", { class: "buttons" }, ...facts.neighbours.map((n) =>
        element("button", { onclick: () => send("select_cell", { row: n.row, column: n.column }) }, `${n.side} ${n.row},${n.column}`))));
    }
    $("inspector").replaceChildren(...parts);
  }
  function faultParts(facts, s) {
    const may = s.allows.includes("fault");
    const parts = [];
    for (const { number, kind } of facts.faults)
      parts.push(element("div", { class: "fault" }, `${kind} (fault ${number})`, element("button", { class: "repair", disabled: !may, onclick: () => send("repair", { number }) }, "Repair")));
    if (!may) return parts;
    parts.push(element("h2", {}, "Break it"));
    const groups = {};
    for (const fault of page.channel.menu.faults) (groups[fault.group] ??= []).push(fault);
    const settings = element("input", { id: "settings", placeholder: 'keys for the next, as side = "north"', "aria-label": "Keys of the next fault" });
    for (const [group, faults] of Object.entries(groups)) {
      parts.push(element("div", { class: "group" }, group));
      parts.push(element("div", { class: "buttons" }, ...faults.map((fault) => {
        const given = Object.entries(fault.settings).map(([k, v]) => `${k} = ${JSON.stringify(v)}`).join("; ");
        const label = fault.kind.replace(/^(link|sensor|wheel)_/, "").replaceAll("_", " ");
        return element("button", { "data-fault": fault.kind, title: `${fault.gist}${given ? ` (${given})` : ""}`, onclick: () => send("fault", { kind: fault.kind, settings: settings.value }) }, label);
      })));
    }
    parts.push(settings);
    return parts;
  }

  // --- timeline and events ----------------------------------------------------------------------------
  function showSlider(s) {
    const slider = $("slider");
    slider.max = String(Math.max(0, s.count - 1));
    if (!page.sliding) slider.value = String(Math.max(0, s.index));
    slider.setAttribute("aria-valuetext", `${s.time_s.toFixed(3)} seconds`);
  }
  function drawMarks() {
    const s = page.state, events = page.channel.events, canvas = $("marks");
    const width = canvas.clientWidth;
    if (!s || !events || !width) return;
    if (!changed("marks", [page.eventsNumber, width, s.first_s, s.last_s, s.dark])) return;
    canvas.width = width;
    const pen = canvas.getContext("2d");
    pen.clearRect(0, 0, width, 18);
    const style = getComputedStyle(document.documentElement);
    const span = Math.max(1e-9, s.last_s - s.first_s), at = (t) => 8 + ((t - s.first_s) / span) * (width - 16);
    for (const kind of ["event", "fault"]) {
      pen.fillStyle = style.getPropertyValue(kind === "fault" ? "--fault" : "--soft");
      for (const time of events.marks[kind]) {
        const x = at(time);
        if (kind === "event") pen.fillRect(x, 9, 1, 8);
        else {
          pen.fillRect(x - 1, 6, 2, 12);
          pen.beginPath(); pen.moveTo(x - 4, 0); pen.lineTo(x + 4, 0); pen.lineTo(x, 7); pen.fill();
        }
      }
    }
  }
  function showEvents() {
    const events = page.channel.events;
    if (!events) return;
    page.eventsNumber = (page.eventsNumber || 0) + 1;
    drawMarks();
    if (!$("events").hidden) buildRows(events);
  }
  function buildRows(events) {
    if (!changed("rows", page.eventsNumber)) return;
    const rows = events.rows.map((row) =>
      element("li", { class: row.kind === "fault" ? "fault-row" : null, onclick: () => jump(row) }, element("time", {}, `${row.time_s.toFixed(3)} s`), row.text));
    if (events.left_out) rows.unshift(element("li", {}, element("time"), `${events.left_out.toLocaleString("en")} earlier events are not listed`));
    if (!rows.length) rows.push(element("li", {}, element("time"), "no events yet"));
    const place = $("events").scrollTop, bottom = place + $("events").clientHeight >= $("events").scrollHeight - 4;
    $("rows").replaceChildren(...rows);
    if (bottom && page.state?.live) $("events").scrollTop = $("events").scrollHeight;
  }
  function jump(row) {
    send("seek", { time_s: row.time_s });
  }
  // The row of the last event up to the instant is marked, whichever way the page came there.
  function markRow(s) {
    const events = page.channel.events;
    if (!events || $("events").hidden) return;
    const last = events.rows.findLastIndex((row) => row.time_s <= s.time_s + 1e-9);
    if (!changed("row", [page.eventsNumber, last])) return;
    $("rows").querySelector("[aria-current]")?.removeAttribute("aria-current");
    const item = last < 0 ? null : $("rows").children[last + (events.left_out ? 1 : 0)];
    item?.setAttribute("aria-current", "true");
    if (!s.playing) item?.scrollIntoView({ block: "nearest" });
  }

  // --- tabs ---------------------------------------------------------------------------------------------
  const TABS = [["position", "Position"], ["angle", "Angle"], ["velocity", "Velocity"], ["spin", "Spin"], ["wheels", "Wheels"], ["quantity", "Quantity"], ["register", "Register"], ["events", "Events"]];
  function buildTabs() {
    for (const [name, label] of TABS)
      $("tabs").append(element("button", { id: `tab-${name}`, role: "tab", hidden: name === "register", onclick: () => (name === "register" ? send(name, { name: list.value }) : send("tab", { name })) }, label));
    const list = element("select", { id: "register", hidden: true, "aria-label": "Register in the plot", onchange: () => send("register", { name: list.value }) });
    $("tab-register").after(list);
    $("tab-quantity").title = "What colours cells, of the selected cell";
    $("tabs").append(element("span", { class: "subject", id: "subject" }));
  }
  function showTab(s) {
    const names = s.colours.map((c) => c.name).filter((n) => n.startsWith("register:")).map((n) => n.slice(9));
    if (changed("registers", names)) {
      $("register").replaceChildren(...names.map((n) => element("option", { value: n }, n)));
      $("register").hidden = $("tab-register").hidden = !names.length;
      page.shown.tab = null;
    }
    if (!changed("tab", [s.tab, s.register])) return;
    for (const [name] of TABS) $(`tab-${name}`)?.setAttribute("aria-selected", String(s.tab === name));
    if (s.register) $("register").value = s.register;
    $("events").hidden = s.tab !== "events";
    $("plot").hidden = $("subject").hidden = s.tab === "events";
    if (s.tab === "events" && page.channel.events) buildRows(page.channel.events);
  }
  function showLines() {
    const lines = page.channel.lines;
    if (!lines) return;
    const parts = lines.names.map((name, k) => element("b", { style: `color:${lines.colours[k % lines.colours.length]}` }, `${"━╍┅┈━╍"[k]} ${name}`));
    $("subject").replaceChildren(element("span", { title: lines.title }, lines.title), ...parts);
  }
  function showNotice({ text, kind, number }) {
    if (!number || !changed("notice", number)) return;
    $("notice").textContent = text;
    $("notice").className = `shown ${kind}`;
    clearTimeout(page.fade);
    page.fade = setTimeout(() => ($("notice").className = ""), kind === "error" ? 7000 : 4000);
  }

  // --- view: equal axes at every size ---------------------------------------------------------------------
  function fit(box) {
    const { plot } = page, width = plot.inner_width, height = plot.inner_height;
    if (!(width > 0 && height > 0)) return;
    const x = (box.x0 + box.x1) / 2, y = (box.y0 + box.y1) / 2;
    const metre = Math.max((box.x1 - box.x0) / width, (box.y1 - box.y0) / height);
    plot.x_range.setv({ start: x - (metre * width) / 2, end: x + (metre * width) / 2 });
    plot.y_range.setv({ start: y - (metre * height) / 2, end: y + (metre * height) / 2 });
  }
  const box = () => ({ x0: page.plot.x_range.start, x1: page.plot.x_range.end, y0: page.plot.y_range.start, y1: page.plot.y_range.end });
  function zoom(factor, focus) {
    const b = box(), x = focus?.x ?? (b.x0 + b.x1) / 2, y = focus?.y ?? (b.y0 + b.y1) / 2;
    fit({ x0: x + (b.x0 - x) * factor, x1: x + (b.x1 - x) * factor, y0: y + (b.y0 - y) * factor, y1: y + (b.y1 - y) * factor });
  }
  function shift(dx, dy) {
    const b = box(), w = (b.x1 - b.x0) * 0.1, h = (b.y1 - b.y0) * 0.1;
    fit({ x0: b.x0 + dx * w, x1: b.x1 + dx * w, y0: b.y0 + dy * h, y1: b.y1 + dy * h });
  }
  function place(event) {
    const view = Bokeh.index.find_one(page.plot), edge = view.el.getBoundingClientRect();
    return { x: view.frame.x_scale.invert(event.clientX - edge.left), y: view.frame.y_scale.invert(event.clientY - edge.top) };
  }

  // --- keys -------------------------------------------------------------------------------------------------
  const SHOWN_KEYS = [
    ["Space", "run or pause; play or pause a replay"], ["→ ←", "one tick on, one instant back"], ["+ −", "faster, slower"], ["B", "play backwards"],
    ["Home End", "first instant, newest instant"], ["Shift+R", "reset"], ["[ ]", "event before, event after"],
    ["W A S D", "select the cell above, left, below, right"], ["P Shift+P", "select the next, the previous parcel"], ["Esc", "leave a control; select nothing"],
    ["X", "crash the selected cell"], ["F", "list of faults (Tab and Enter choose)"], ["R", "repair the selected cell"],
    ["I J K L, Q E", "while paused: move the selected parcel, turn it"], ["Shift+drag", "while paused: move a parcel"],
    ["1 … 9", "colour cells by the n-th quantity"], ["0 . ,", "whole array, closer, farther"], ["Alt+arrows", "pan"], ["T", "light or dark"], ["?", "this list"],
  ];
  function speedBy(by) {
    const values = page.channel.menu.speeds, now = page.state.speed ?? Infinity;
    const index = by > 0 ? values.findIndex((v) => v > now) : values.findLastIndex((v) => v < now);
    if (index >= 0) send("speed", { factor: values[index] });
    else if (by > 0 && page.state.following) send("speed", { factor: null });
  }
  const KEYS = {
    " ": () => send("toggle"), ArrowRight: () => send("step", { instants: 1 }), ArrowLeft: () => send("step", { instants: -1 }),
    "+": () => speedBy(1), "=": () => speedBy(1), "-": () => speedBy(-1), b: () => send("reverse"),
    Home: () => send("seek", { index: 0 }), End: () => send("follow"), R: () => send("reset"),
    "[": () => send("event", { by: -1 }), "]": () => send("event", { by: 1 }),
    w: () => send("walk", { rows: 1, columns: 0 }), s: () => send("walk", { rows: -1, columns: 0 }), a: () => send("walk", { rows: 0, columns: -1 }), d: () => send("walk", { rows: 0, columns: 1 }),
    p: () => send("next_parcel", { by: 1 }), P: () => send("next_parcel", { by: -1 }), Escape: () => send("select_none"),
    x: () => send("fault", { kind: "crash" }), r: () => send("repair"), f: () => document.querySelector("[data-fault]")?.focus(),
    i: () => send("nudge", { y: 0.1 }), k: () => send("nudge", { y: -0.1 }), j: () => send("nudge", { x: -0.1 }), l: () => send("nudge", { x: 0.1 }),
    q: () => send("nudge", { angle_rad: 0.05 }), e: () => send("nudge", { angle_rad: -0.05 }),
    0: () => fit(page.home), ".": () => zoom(0.8), ",": () => zoom(1.25), t: () => $("theme").click(), "?": () => $("keys").showModal(),
  };
  const RELEASES = { click: "button", change: "select, input[type=checkbox]" };
  const PANS = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, 1], ArrowDown: [0, -1] };
  function onKey(event) {
    if (!page.state || event.ctrlKey || event.metaKey || $("keys").open) return;
    if (event.key === "Escape" && event.target.matches("button, input, select")) { event.target.blur(); return; }
    const typing = event.target.matches("input[type=text], input:not([type]), textarea");
    const own = (event.target.matches("select") && /^(Arrow|Home$|End$|[a-z]$)/i.test(event.key))
      || (event.target.matches("input[type=range]") && /^(Arrow|Home$|End$|Page)/.test(event.key));
    const press = event.target.matches("button, input[type=checkbox]") && event.key === " ";
    if (typing || own || press) return;
    const pan = event.altKey && PANS[event.key];
    const digit = /^[1-9]$/.test(event.key) && page.state.colours[+event.key - 1];
    const act = pan ? () => shift(...pan) : event.altKey ? null : digit ? () => send("colour", { name: digit.name }) : KEYS[event.key];
    if (!act) return;
    event.preventDefault();
    act();
  }

  // --- wiring -------------------------------------------------------------------------------------------------
  function wire() {
    const on = (id, event, act) => $(id).addEventListener(event, act);
    on("toggle", "click", () => send("toggle"));
    on("step", "click", () => send("step", { instants: 1 }));
    on("back", "click", () => send("step", { instants: -1 }));
    on("reset", "click", () => send("reset"));
    on("reverse", "click", () => send("reverse"));
    on("follow", "click", () => send("follow"));
    on("speed", "change", () => send("speed", { factor: $("speed").value === "" ? null : +$("speed").value }));
    on("colour", "change", () => send("colour", { name: $("colour").value }));
    on("fit", "click", () => fit(page.home));
    on("in", "click", () => zoom(0.8));
    on("out", "click", () => zoom(1.25));
    on("help", "click", () => $("keys").showModal());
    on("theme", "click", () => theme(!page.state.dark));
    on("slider", "input", () => { page.sliding = true; send("seek", { index: +$("slider").value }); });
    on("slider", "change", () => { page.sliding = false; });
    on("marks", "click", (event) => {
      const edge = $("marks").getBoundingClientRect(), share = (event.clientX - edge.left - 8) / (edge.width - 16);
      send("seek", { time_s: page.state.first_s + share * (page.state.last_s - page.state.first_s) });
    });
    document.addEventListener("keydown", onKey);
    // what was pressed with the pointer doesn't keep the keys: Space pauses and arrows step after a click on a layer, too
    document.addEventListener("pointerdown", () => { page.pointed = true; }, true);
    document.addEventListener("keydown", () => { page.pointed = false; }, true);
    for (const kind of ["click", "change"])
      document.addEventListener(kind, (event) => { if (page.pointed && event.target.matches(RELEASES[kind])) event.target.blur(); });
    $("keytable").append(...SHOWN_KEYS.map(([keys, what]) => element("tr", {}, element("td", {}, element("kbd", {}, keys)), element("td", {}, what))));
    wireDrag();
    new ResizeObserver(() => { page.shown.marks = null; drawMarks(); }).observe($("marks"));
  }
  function wireDrag() {
    let dragging = false;
    const map = $("map");
    const tell = (phase, event) => send("drag", { phase, ...place(event) });
    map.addEventListener("pointerdown", (event) => {
      if (!event.shiftKey || event.button !== 0) return;
      event.stopPropagation(); event.preventDefault();
      dragging = true; map.setPointerCapture(event.pointerId); tell("begin", event);
    }, true);
    map.addEventListener("pointermove", (event) => { if (dragging) { event.stopPropagation(); tell("move", event); } }, true);
    map.addEventListener("pointerup", (event) => { if (dragging) { event.stopPropagation(); dragging = false; tell("end", event); } }, true);
  }
  function theme(dark) {
    document.documentElement.classList.toggle("dark", dark);
    send("theme", { dark });
  }

  function show() {
    const s = (page.state = page.channel.state);
    if (!s) return;
    document.documentElement.classList.toggle("dark", s.dark);
    showClock(s); showControls(s); showLooks(s); showInspector(s); showSlider(s); showTab(s); markRow(s); showNotice(s.notice); drawMarks();
    // confirmed once painted: the server sends no more to a page that doesn't paint
    requestAnimationFrame(() => { page.frames += 1; page.channel.seen = s.seq; });
  }
  function lost() {
    $("notice").textContent = "The server has ended, or the connection was lost. The page comes back when it does.";
    $("notice").className = "shown error";
    clearTimeout(page.fade);
    setInterval(() => fetch(location.href, { cache: "no-store" }).then((answer) => answer.ok && location.reload()).catch(() => {}), 2000);
  }
  function begin() {
    const doc = Bokeh.documents[0], channel = doc?.get_model_by_name("channel"), plot = doc?.get_model_by_name("map");
    if (!channel || !plot || !plot.inner_width || !Bokeh.index.find_one(plot)) { setTimeout(begin, 30); return; }
    Object.assign(page, { channel, plot });
    page.home = box();
    wire(); buildTabs(); fit(page.home);
    let size = [plot.inner_width, plot.inner_height];
    plot.properties.inner_width.change.connect(refit); plot.properties.inner_height.change.connect(refit);
    function refit() {
      if (size[0] === plot.inner_width && size[1] === plot.inner_height) return;
      size = [plot.inner_width, plot.inner_height];
      fit(box());
    }
    channel.properties.state.change.connect(show);
    channel.properties.events.change.connect(showEvents);
    channel.properties.lines.change.connect(showLines);
    const wanted = new URLSearchParams(location.search).get("theme");
    theme(wanted ? wanted === "dark" : matchMedia("(prefers-color-scheme: dark)").matches);
    show(); showEvents(); showLines();
    $("page").classList.remove("waiting");
  }
  window.mdms = { page, send, lost };
  begin();
})();
