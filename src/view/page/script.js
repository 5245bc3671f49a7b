"use strict";
const by = id => document.getElementById(id);
const MAIN = {"stabilize.enabled": "Stabilization", "smooth.strength": "Strength", "crop.zoom": "Zoom", "smooth.lookahead_ms": "Look-ahead"};
// Length of the plots in seconds.
const SECONDS = 10;
const span = () => about.recording ? Math.min(SECONDS, Math.max(1, length)) : SECONDS;
const OUTCOMES = ["stabilized", "first frame", "track lost", "stabilization off", "damaged, previous picture"];
let about, settings = {}, saved = null, pending = {};
let wipe = 0.5, seen = 0, epoch = 0, last = null, series = [];
let playing = false, length = 0, seeking = false;

const get = async path => {
  const answer = await fetch(location.pathname + path, {cache: "no-store"});
  if (!answer.ok) throw new Error("refused with status " + answer.status);
  return answer;
};
const post = async (path, text) => (await (await fetch(location.pathname + path, {method: "POST", body: text, cache: "no-store"})).json());
const sleep = ms => new Promise(done => setTimeout(done, ms));
const make = (kind, text, parent, name) => {
  const element = document.createElement(kind);
  if (text !== undefined) element.textContent = text;
  if (name) element.className = name;
  if (parent) parent.append(element);
  return element;
};
const bare = value => value.replace(/^"|"$/g, "");
const newest = () => last && last.frames[last.frames.length - 1];
const colour = name => getComputedStyle(document.documentElement).getPropertyValue("--" + name).trim();

// --- picture ---------------------------------------------------------------------------------------------------------------------

const stage = by("stage"), canvas = by("picture"), brush = canvas.getContext("2d");
let pair = null;

// The pair has the output above the input. The input is drawn left of the divider, with the outline of what the output shows of it.
const draw = () => {
  by("divider").style.left = 100 * wipe + "%";
  by("divider").hidden = wipe <= 0 || wipe >= 1;
  stage.setAttribute("aria-valuenow", Math.round(100 * wipe));
  document.querySelector(".left").hidden = wipe <= 0.03;
  document.querySelector(".right").hidden = wipe >= 0.97;
  for (const button of document.querySelectorAll("#show button")) button.classList.toggle("on", Number(button.dataset.wipe) === wipe);
  if (!pair) return;
  const [width, height] = last.size, edge = Math.round(wipe * width);
  if (canvas.width !== width || canvas.height !== height) {
    [canvas.width, canvas.height] = [width, height];
    // A small picture is enlarged twice at most: beyond that it is only less sharp.
    stage.style.maxWidth = `min(${Math.max(2 * width, 480)}px, calc(76vh * ${width / height}))`;
  }
  brush.drawImage(pair, 0, 0, width, height, 0, 0, width, height);
  if (edge > 0) brush.drawImage(pair, 0, height, edge, height, 0, 0, edge, height);
  const outline = document.getElementById("window"), [across, down] = last.input;
  outline.classList.toggle("full", newest().crop > 0.98);
  outline.style.display = by("outline").checked ? "" : "none";
  outline.style.clipPath = `inset(0 ${100 - 100 * wipe}% 0 0)`;
  outline.setAttribute("viewBox", `-0.5 -0.5 ${across} ${down}`);
  outline.firstElementChild.setAttribute("points", newest().corners.map(corner => corner.join()).join(" "));
};

const set_wipe = share => { wipe = Math.min(1, Math.max(0, share)); draw(); };
const follow = event => {
  const box = stage.getBoundingClientRect();
  set_wipe((event.clientX - box.left) / box.width);
};
stage.addEventListener("pointerdown", event => { stage.setPointerCapture(event.pointerId); follow(event); });
stage.addEventListener("pointermove", event => { if (event.buttons) follow(event); });
for (const button of document.querySelectorAll("#show button")) button.addEventListener("click", () => set_wipe(Number(button.dataset.wipe)));
by("outline").addEventListener("change", draw);

const receive = async () => {
  const since = last ? `&since=${newest().n}` : "";
  const answer = await get(`preview?seen=${seen}&epoch=${epoch}${since}`);
  if (answer.status === 204) return;
  const bytes = await answer.arrayBuffer(), size = new DataView(bytes).getUint32(0, true);
  const head = JSON.parse(new TextDecoder().decode(new Uint8Array(bytes, 4, size)));
  const picture = await createImageBitmap(new Blob([new Uint8Array(bytes, 4 + size)], {type: "image/jpeg"}));
  if (pair) pair.close();
  if (head.epoch !== epoch) series = [];
  [pair, last, seen, epoch] = [picture, head, head.number, head.epoch];
  series.push(...head.frames);
  const end = newest().t;
  series = series.filter(frame => frame.t > end - SECONDS && frame.t <= end);
  by("none").hidden = true;
  draw();
  plot();
  document.body.dataset.pictures = seen;
};
const receive_all = async () => {
  for (;;) {
    try {
      // A page that is not visible is no viewer.
      if (document.hidden) await sleep(300);
      else await receive();
    } catch (error) {
      disconnected();
      await sleep(1000);
    }
  }
};
const disconnected = () => {
  by("activity").textContent = "no connection: is gimbald view still running?";
  by("state").className = "warn";
};

// --- plots -----------------------------------------------------------------------------------------------------------------------
// Drawn here and not by src/report/html/svg.rs, which writes the plots of reports once and whole: these change with every frame, and the
// page gets numbers for them, not drawings.

const figures = [];
let pointed = null;

const figure = (title, unit, lines, {range, least = 0} = {}) => {
  const outer = make("figure", undefined, by("plots")), caption = make("figcaption", undefined, outer);
  make("b", title, caption);
  lines.forEach(({label, kind}) => make("span", label, caption, kind));
  if (unit) make("span", unit, caption, "unit");
  const shown = make("output", "", caption), surface = make("canvas", undefined, outer);
  surface.setAttribute("role", "img");
  surface.setAttribute("aria-label", `${title} over the last ${SECONDS} seconds`);
  figures.push({surface, shown, lines, range, least});
  surface.addEventListener("pointermove", event => {
    pointed = (event.clientX - surface.getBoundingClientRect().left) / surface.clientWidth;
    plot();
  });
  surface.addEventListener("pointerleave", () => { pointed = null; plot(); });
};

const fitted = surface => {
  const scale = devicePixelRatio || 1, width = Math.round(surface.clientWidth * scale), height = Math.round(surface.clientHeight * scale);
  if (surface.width !== width || surface.height !== height) [surface.width, surface.height] = [width, height];
  const pen = surface.getContext("2d");
  pen.clearRect(0, 0, width, height);
  return [pen, width, height, scale];
};
const limits = ({lines, range, least}) => {
  if (range) return range;
  let [low, high] = [Infinity, -Infinity];
  for (const {of} of lines) for (const frame of series) {
    const value = of(frame);
    if (isFinite(value)) { low = Math.min(low, value); high = Math.max(high, value); }
  }
  if (!isFinite(low)) return [-least, least];
  // What is smaller than `least` is noise.
  const more = Math.max(0, least - (high - low)) / 2;
  return [low - more, high + more];
};
const short = value => Math.abs(value) < 1e-9 ? "0" : Math.abs(value) >= 100 ? value.toFixed(0) : String(Number(value.toPrecision(2)));

const plot_lines = figure => {
  const [pen, width, height, scale] = fitted(figure.surface), [low, high] = limits(figure);
  const end = newest().t, margin = 0.1 * (high - low);
  const x = time => width * (1 - (end - time) / span()), y = value => height * (1 - (value - low + margin) / (high - low + 2 * margin));
  pen.strokeStyle = colour("grid");
  pen.lineWidth = scale;
  const tick = span() > 3 ? 2 : 0.5;
  for (let second = Math.ceil((end - span()) / tick) * tick; second < end; second += tick) {
    pen.beginPath();
    pen.moveTo(x(second), 0);
    pen.lineTo(x(second), height);
    pen.stroke();
  }
  for (const {of, kind} of figure.lines) {
    pen.beginPath();
    pen.lineWidth = 1.6 * scale;
    pen.strokeStyle = colour(kind);
    series.forEach((frame, i) => pen[i && frame.t - series[i - 1].t < 1 ? "lineTo" : "moveTo"](x(frame.t), y(of(frame))));
    pen.stroke();
  }
  pen.font = `${11 * scale}px system-ui`;
  pen.fillStyle = colour("soft");
  pen.fillText(short(high), 5 * scale, 14 * scale);
  pen.fillText(short(low), 5 * scale, height - 6 * scale);
  figure.shown.textContent = "";
  if (pointed === null) return;
  const time = end - (1 - pointed) * span();
  const frame = series.reduce((best, frame) => Math.abs(frame.t - time) < Math.abs(best.t - time) ? frame : best);
  pen.fillStyle = colour("soft");
  pen.fillRect(x(frame.t), 0, scale, height);
  const when = about.recording ? `${frame.t.toFixed(2)} s` : `${(frame.t - end).toFixed(1)} s`;
  figure.shown.textContent = `${when}: ${figure.lines.map(({of}) => of(frame).toPrecision(3)).join(" / ")}`;
};

// The camera's picture, the output's outline in it, and where its centre has been.
const plot_window = ({surface, shown}) => {
  const [pen, width, height, scale] = fitted(surface), [across, down] = last.input;
  const zoom = Math.min((width - 16 * scale) / across, (height - 16 * scale) / down);
  pen.save();
  pen.translate((width - across * zoom) / 2, (height - down * zoom) / 2);
  pen.lineWidth = scale;
  pen.strokeStyle = colour("soft");
  pen.strokeRect(0, 0, across * zoom, down * zoom);
  const centre = ({corners}) => [0, 1].map(i => corners.reduce((sum, corner) => sum + corner[i], 0) / 4 * zoom);
  pen.beginPath();
  series.forEach((frame, i) => pen[i ? "lineTo" : "moveTo"](...centre(frame)));
  pen.strokeStyle = colour("before");
  pen.stroke();
  pen.beginPath();
  newest().corners.forEach(([x, y], i) => pen[i ? "lineTo" : "moveTo"]((x + 0.5) * zoom, (y + 0.5) * zoom));
  pen.closePath();
  pen.lineWidth = 2 * scale;
  pen.strokeStyle = newest().crop > 0.98 ? colour("warn") : colour("after");
  pen.stroke();
  pen.beginPath();
  pen.arc(...centre(newest()), 3 * scale, 0, 7);
  pen.fillStyle = colour("after");
  pen.fill();
  pen.restore();
  shown.textContent = `${(100 * newest().crop).toFixed(0)} % of the margin`;
};

const plot = () => {
  if (!series.length) return;
  for (const figure of figures) (figure.lines[0].of ? plot_lines : plot_window)(figure);
};

const add_figures = axes => {
  figure("crop window", "", [{label: "center", kind: "before"}, {label: "output", kind: "after"}]);
  axes.forEach(({name, meaning, unit}, i) => {
    const [factor, shown] = unit === "rad" ? [180 / Math.PI, "degrees"] : [1, unit];
    figure(name.length > 1 ? name : meaning, shown, [
      {label: "camera", kind: "before", of: frame => factor * frame.path[i]},
      {label: "virtual camera", kind: "after", of: frame => factor * frame.smoothed[i]},
    ], {least: unit === "rad" ? 0.2 : unit === "px" ? 2 : 0.01});
  });
  figure("trust", "0 to 1", [
    {label: "confidence of each frame", kind: "before", of: frame => frame.confidence},
    {label: "trust", kind: "after", of: frame => frame.trust},
  ], {range: [0, 1]});
  figure("crop margin in use", "0 to 1", [{label: "share", kind: "after", of: frame => frame.crop}], {range: [0, 1]});
};
matchMedia("(prefers-color-scheme: dark)").addEventListener("change", plot);
addEventListener("resize", () => { draw(); plot(); });

// --- numbers ---------------------------------------------------------------------------------------------------------------------

const shown_facts = new Map();
const fact = (name, value, more) => {
  if (!shown_facts.has(name)) {
    const place = make("div", undefined, by("facts"));
    make("dt", name, place);
    shown_facts.set(name, {value: make("dd", "", place), more: null, place});
  }
  const {value: dd, place} = shown_facts.get(name);
  dd.textContent = value;
  if (more) make("small", more, dd);
};
const number = (value, digits, unit) => Number.isFinite(value) ? value.toFixed(digits) + unit : "-";

const show_status = status => {
  const viewers = [], pages = status.pipewire ? status.pipewire.pages : 0;
  if (status.watchers) viewers.push(`loopback ${status.watchers}`);
  if (status.pipewire && status.pipewire.watched) viewers.push(`PipeWire ${status.pipewire.watched}`);
  fact("viewers", viewers.length + pages ? [...viewers, `page ${pages}`].join(", ") : "none", pages ? "this page counts as one" : "");
  fact("frame rate", number(status.fps, 1, " fps"));
  const latency = status.latency_ms;
  fact("latency", latency ? number(latency.p50, 1, " ms") : "-", latency ? `99 %: ${number(latency.p99, 1, " ms")}` : "");
  const {camera_missing, camera_stale, behind, damaged, cut} = status.drops;
  fact("frames lost", `${camera_missing + camera_stale} by the camera, ${behind} late`, `of ${status.frames.captured}`);
  fact("frames damaged", String(damaged), cut ? `${cut} partly shown` : "");
};
const show_frame = frame => {
  fact("this frame", OUTCOMES[frame.outcome] || "", number(frame.ms, 1, " ms of processing"));
  fact("trust", number(frame.trust, 2, ""), `confidence ${number(frame.confidence, 2, "")}`);
  fact("inliers", `${frame.points[0]} of ${frame.points[1]}`, "tracked points");
  const [readout, readout_deviation, hfov, hfov_deviation] = frame.camera;
  if (!(hfov > 0)) return;
  const source = (deviation, factor, unit) => deviation > 0 ? `estimated ± ${number(2 * factor * deviation, 1, unit)}` : "configured";
  fact("readout time", number(1e3 * readout, 1, " ms"), source(readout_deviation, 1e3, " ms"));
  fact("field of view", number(hfov, 1, "°"), source(hfov_deviation, 1, "°"));
};

const show_state = state => {
  const status = state.status;
  if (about.recording) {
    [playing, length] = [state.playing, state.length_s];
    by("play").textContent = playing ? "Pause" : "Play";
    by("loop").checked = state.looping;
    if (!seeking) {
      by("seek").max = length;
      by("seek").value = state.position_s;
      by("position").textContent = `${state.position_s.toFixed(1)} / ${length.toFixed(1)} s`;
    }
    by("activity").textContent = state.error || (playing ? "playing" : "paused");
    by("state").className = state.error ? "warn" : playing ? "good" : "";
  } else {
    by("activity").textContent = status ? status.what || status.state : state.error;
    by("state").className = status && status.state === "streaming" ? "good" : status ? "" : "warn";
    if (status) show_status(status);
    if (state.problem && !last) by("none").textContent = state.problem;
    const problem = last && state.problem;
    by("note").textContent = problem || "This page counts as a viewer: while it is open, the camera is on.";
    by("note").className = problem ? "fault" : "";
  }
  if (last) show_frame(newest());
};

// --- settings --------------------------------------------------------------------------------------------------------------------

const controls = new Map();

const send = async (name, value) => {
  const control = controls.get(name);
  if (!control.key.live) {
    // Only written to the configuration; the running service keeps its value.
    if (value === settings[name]) delete pending[name]; else pending[name] = value;
    show_settings(settings);
    return;
  }
  const answer = await post("set", `${name}=${value}`);
  control.fault.textContent = answer.ok ? "" : answer.error;
  await update();
};
// One request at a time, and the latest value always.
const change = async (name, value) => {
  const control = controls.get(name);
  control.wanted = value;
  if (control.sending) return;
  control.sending = true;
  while (control.wanted !== null) {
    const next = control.wanted;
    control.wanted = null;
    await send(name, next).catch(disconnected);
  }
  control.sending = false;
};

const switch_of = (entry, row) => {
  const input = make("input", undefined, row);
  input.type = "checkbox";
  input.setAttribute("role", "switch");
  input.addEventListener("change", () => change(entry.key.name, String(input.checked)));
  entry.show = value => { input.checked = value === "true"; };
  return input;
};
const choice_of = (entry, row) => {
  const input = make("select", undefined, row);
  entry.key.words.forEach(word => make("option", word, input));
  input.addEventListener("change", () => change(entry.key.name, `"${input.value}"`));
  entry.show = value => { input.value = bare(value); };
  return input;
};
const text_of = (entry, row) => {
  const input = make("input", undefined, row);
  input.type = "text";
  input.addEventListener("change", () => change(entry.key.name, JSON.stringify(input.value)));
  entry.show = value => { input.value = bare(value); };
  return input;
};
const slider_of = (entry, row) => {
  const {name, kind, low, high, step} = entry.key, input = make("input", undefined, row);
  input.type = "range";
  [input.min, input.max, input.step] = [low, high, step || Number(Math.max((high - low) / 500, 1e-4).toPrecision(1))];
  if (kind === "number or auto") {
    const label = make("label", undefined, row, "check");
    entry.auto = make("input", undefined, label);
    entry.auto.type = "checkbox";
    entry.auto.id = `set-${name}-auto`;
    label.append("auto");
    entry.auto.addEventListener("change", () => change(name, entry.auto.checked ? '"auto"' : input.value));
  }
  input.addEventListener("input", () => {
    entry.shown.textContent = input.value + entry.unit;
    if (entry.auto) entry.auto.checked = false;
    change(name, input.value);
  });
  entry.show = value => {
    const is_auto = bare(value) === "auto";
    if (entry.auto) entry.auto.checked = is_auto;
    if (!is_auto) input.value = entry.key.names[bare(value)] ?? value;
  };
  return input;
};
const add_setting = (key, parent) => {
  const outer = make("div", undefined, parent, "setting"), head = make("div", undefined, outer, "head");
  const label = make("label", MAIN[key.name] || key.name, head);
  const unit = key.unit && key.unit !== "ratio" && key.unit !== "count" ? " " + key.unit : "";
  const entry = {key, outer, unit, shown: make("output", "", head), wanted: null, sending: false};
  const row = make("div", undefined, key.kind === "switch" ? head : outer, "row");
  const kinds = {switch: switch_of, choice: choice_of, text: text_of};
  entry.input = (kinds[key.kind] || slider_of)(entry, row);
  entry.input.id = label.htmlFor = "set-" + key.name;
  const note = make("small", undefined, outer);
  if (MAIN[key.name]) { make("code", key.name, note); note.append(": "); }
  note.append(key.meaning + (key.live ? "" : " Takes effect after a restart."));
  entry.fault = make("small", "", outer, "fault");
  controls.set(key.name, entry);
};

const value_of = name => name in pending ? pending[name] : settings[name];
const changed = () => [...controls.keys()].filter(name => saved && name in settings && value_of(name) !== saved[name]);

const show_settings = values => {
  settings = values;
  saved = saved || {...values};
  for (const [name, control] of controls) {
    if (!(name in values)) continue;
    const value = value_of(name);
    if (!control.sending) {
      if (control.input.type !== "text" || document.activeElement !== control.input) control.show(value);
      control.shown.textContent = control.input.type === "range" ? bare(value) + (bare(value) === "auto" ? "" : control.unit) : "";
    }
    control.outer.classList.toggle("changed", value !== saved[name]);
  }
  by("write").disabled = by("undo").disabled = changed().length === 0;
};

const update = async () => {
  const answer = await (await get("state")).json();
  show_state(answer.state);
  if (answer.settings) show_settings(answer.settings);
};

by("write").addEventListener("click", async () => {
  const names = changed(), answer = await post("write", names.map(name => `${name}=${value_of(name)}`).join("\n"));
  by("wrote").textContent = answer.ok ? `Written to ${answer.path}.` : answer.error;
  if (answer.ok && names.some(name => name in pending)) by("wrote").textContent += " Restart the service to apply all of it.";
  by("wrote").className = answer.ok ? "" : "fault";
  by("lines").hidden = answer.ok || !answer.lines;
  by("lines").textContent = answer.lines || "";
  if (!answer.ok) return;
  saved = Object.fromEntries(Object.keys(settings).map(name => [name, value_of(name)]));
  show_settings(settings);
});
by("undo").addEventListener("click", () => changed().forEach(name => change(name, saved[name])));

// --- recordings ------------------------------------------------------------------------------------------------------------------

const order = async text => { await post("play", text); await update(); };
const seek_to = seconds => order("seek " + Math.max(0, Math.min(length, seconds)));
by("play").addEventListener("click", () => order(playing ? "pause" : "play"));
by("loop").addEventListener("change", () => order(by("loop").checked ? "loop" : "once"));
by("seek").addEventListener("input", () => { seeking = true; by("position").textContent = `${Number(by("seek").value).toFixed(1)} / ${length.toFixed(1)} s`; });
by("seek").addEventListener("change", () => { seeking = false; seek_to(Number(by("seek").value)); });

// --- keyboard --------------------------------------------------------------------------------------------------------------------

const KEYS = {
  1: () => set_wipe(1), 2: () => set_wipe(0), 3: () => set_wipe(0.5),
  0: () => controls.get("stabilize.enabled").input.click(),
  w: () => { by("outline").checked = !by("outline").checked; draw(); },
};
const RECORDING_KEYS = {
  " ": () => order(playing ? "pause" : "play"),
  ",": () => seek_to(Number(by("seek").value) - 1), ".": () => seek_to(Number(by("seek").value) + 1),
  l: () => order(by("loop").checked ? "once" : "loop"),
};
const STAGE_KEYS = {
  ArrowLeft: () => set_wipe(wipe - 0.05), ArrowRight: () => set_wipe(wipe + 0.05), Home: () => set_wipe(0), End: () => set_wipe(1),
};
document.addEventListener("keydown", event => {
  if (event.ctrlKey || event.altKey || event.metaKey) return;
  const {target, key} = event, typing = target.type === "text" || target.tagName === "SELECT";
  const pressing = key === " " && (["BUTTON", "SUMMARY"].includes(target.tagName) || target.type === "checkbox");
  const action = (target === stage && STAGE_KEYS[key]) || KEYS[key] || (about && about.recording && RECORDING_KEYS[key]);
  if (typing || pressing || !action) return;
  action();
  event.preventDefault();
});

// --- start -----------------------------------------------------------------------------------------------------------------------

(async () => {
  try {
    about = await (await get("about")).json();
  } catch (error) {
    by("activity").textContent = "no answer: " + error.message;
    return;
  }
  by("name").textContent = about.name;
  document.title = `${about.name} - gimbald`;
  by("player").hidden = !about.recording;
  for (const entry of document.querySelectorAll(".recording")) entry.hidden = !about.recording;
  const file = about.configuration;
  by("file").textContent = !file ? "Changes are not saved: no configuration file is known. Start with gimbald view --config FILE."
    : about.recording ? `Configuration: ${file}` : `Changes last until the service reloads ${file}.`;
  const offered = new Map(about.keys.map(key => [key.name, key]));
  for (const name of Object.keys(MAIN)) if (offered.has(name)) add_setting(offered.get(name), by("main"));
  for (const key of about.keys) if (!(key.name in MAIN)) add_setting(key, by("rest"));
  add_figures(about.axes);
  draw();
  receive_all();
  for (;;) {
    await update().catch(disconnected);
    await sleep(about.recording ? 150 : 500);
  }
})();
