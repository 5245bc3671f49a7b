"use strict";
(() => {
  const by = id => document.getElementById(id);
  const data = by("clip") && JSON.parse(by("clip").textContent);
  const frames = data ? data.frames.map(([time, text]) => {
    const image = new Image();
    image.src = "data:image/jpeg;base64," + text;
    return {time, image};
  }) : [];
  let wipe = 0.5, now = data ? data.from : 0, playing = null, shown = null;

  // --- plots: a cursor in each, and the values at its time -------------------------------------------------------------------------

  const plots = [...document.querySelectorAll("svg[data-time]")].map(svg => {
    const [from, to, left, right] = svg.dataset.time.split(" ").map(Number);
    const [low, high, top, bottom] = (svg.dataset.value || "").split(" ").map(Number);
    const cursor = document.createElementNS(svg.namespaceURI, "line");
    cursor.setAttribute("class", "cursor");
    // Outside until a time is pointed at.
    cursor.setAttribute("x1", -9);
    cursor.setAttribute("x2", -9);
    cursor.setAttribute("y1", 0);
    cursor.setAttribute("y2", svg.viewBox.baseVal.height);
    svg.append(cursor);
    const caption = svg.parentElement.querySelector("figcaption"), output = document.createElement("output");
    caption.append(output);
    // The points of each line, from its path: M and L have x and y, V a second y at the same x.
    const lines = [...svg.querySelectorAll("path.line")].map(path => {
      const points = [];
      for (const [, command, numbers] of path.getAttribute("d").matchAll(/([MLV])([^MLV]*)/g)) {
        const values = numbers.trim().split(" ").map(Number);
        if (command === "V") points[points.length - 1].push(values[0]);
        else points.push(values);
      }
      return {name: path.dataset.name, points};
    });
    const to_x = time => left + (time - from) / (to - from) * (right - left);
    const to_time = x => from + (x - left) / (right - left) * (to - from);
    const to_value = y => high - (y - top) / (bottom - top) * (high - low);
    return {svg, from, to, cursor, output, lines, to_x, to_time, to_value, step: (high - low) / (bottom - top)};
  });

  const value_at = ({to_x, to_value, step}, {name, points}, time) => {
    const x = to_x(time);
    let best = null;
    for (const point of points) if (!best || Math.abs(point[0] - x) < Math.abs(best[0] - x)) best = point;
    if (!best || Math.abs(best[0] - x) > 8) return null;
    const digits = Math.max(0, Math.min(6, Math.ceil(-Math.log10(step || 1))));
    const values = [...new Set(best.slice(1).map(y => to_value(y).toFixed(digits).replace(/^-(0(\.0*)?)$/, "$1")))];
    return (name ? name + " " : "") + values.reverse().join(" to ");
  };
  const point_plots = (time, with_values) => {
    for (const plot of plots) {
      const x = plot.to_x(time);
      plot.cursor.setAttribute("x1", x);
      plot.cursor.setAttribute("x2", x);
      const values = with_values ? plot.lines.map(line => value_at(plot, line, time)).filter(text => text !== null) : [];
      plot.output.textContent = values.length ? `${time.toFixed(2)} s: ${values.join(", ")}` : "";
    }
  };
  for (const plot of plots) {
    const time_of = event => {
      const box = plot.svg.getBoundingClientRect();
      const time = plot.to_time((event.clientX - box.left) / box.width * plot.svg.viewBox.baseVal.width);
      return Math.max(plot.from, Math.min(plot.to, time));
    };
    const go = event => { stop(); show(time_of(event), true); };
    plot.svg.addEventListener("pointermove", go);
    plot.svg.addEventListener("pointerdown", go);
  }

  // --- player ----------------------------------------------------------------------------------------------------------------------

  const nearest = time => frames.reduce((best, frame) => !best || Math.abs(frame.time - time) < Math.abs(best.time - time) ? frame : best, null);
  const draw = () => {
    if (!data) return;
    by("divider").style.left = 100 * wipe + "%";
    by("divider").hidden = wipe <= 0 || wipe >= 1;
    by("stage").setAttribute("aria-valuenow", Math.round(100 * wipe));
    if (!shown || !shown.image.naturalWidth) return;
    const canvas = by("picture"), [width, height] = data.size, pen = canvas.getContext("2d"), edge = Math.round(wipe * width);
    if (canvas.width !== width || canvas.height !== height) [canvas.width, canvas.height] = [width, height];
    // The output is above the input.
    pen.drawImage(shown.image, 0, 0, width, height, 0, 0, width, height);
    if (edge > 0) pen.drawImage(shown.image, 0, height, edge, height, 0, 0, edge, height);
  };
  const show = (time, with_values) => {
    now = time;
    point_plots(time, with_values);
    if (!data) return;
    const frame = nearest(time);
    if (frame !== shown) {
      shown = frame;
      shown.image.decode().then(draw, () => {});
    }
    by("seek").value = Math.max(data.from, Math.min(data.to, time));
    const apart = Math.abs(frame.time - time) > 0.2 ? ` (picture of ${frame.time.toFixed(2)} s)` : "";
    by("time").textContent = `${time.toFixed(2)} s${apart}`;
  };
  const stop = () => {
    if (playing !== null) cancelAnimationFrame(playing);
    playing = null;
    if (data) by("play").textContent = "Play";
  };
  const play = () => {
    let before = null;
    by("play").textContent = "Pause";
    if (now < data.from || now >= data.to) now = data.from;
    const step = stamp => {
      let time = now + (before === null ? 0 : (stamp - before) / 1000);
      before = stamp;
      if (time > data.to) time = data.from;
      show(time, false);
      playing = requestAnimationFrame(step);
    };
    playing = requestAnimationFrame(step);
  };
  const toggle = () => playing === null ? play() : stop();
  const step = by_frames => {
    stop();
    const at = frames.indexOf(shown) + by_frames;
    if (frames[at]) show(frames[at].time, true);
  };
  const set_wipe = share => { wipe = Math.min(1, Math.max(0, share)); draw(); };

  if (!data) return;
  by("player").hidden = false;
  [by("seek").min, by("seek").max] = [data.from, data.to];
  by("play").addEventListener("click", toggle);
  by("seek").addEventListener("input", () => { stop(); show(Number(by("seek").value), true); });
  const follow = event => {
    const box = by("stage").getBoundingClientRect();
    set_wipe((event.clientX - box.left) / box.width);
  };
  by("stage").addEventListener("pointerdown", event => { by("stage").setPointerCapture(event.pointerId); follow(event); });
  by("stage").addEventListener("pointermove", event => { if (event.buttons) follow(event); });
  document.addEventListener("keydown", event => {
    if (event.ctrlKey || event.altKey || event.metaKey) return;
    const on_stage = {ArrowLeft: () => set_wipe(wipe - 0.05), ArrowRight: () => set_wipe(wipe + 0.05), Home: () => set_wipe(0), End: () => set_wipe(1)};
    const anywhere = {" ": toggle, ",": () => step(-1), ".": () => step(1), 1: () => set_wipe(1), 2: () => set_wipe(0), 3: () => set_wipe(0.5)};
    const action = (event.target === by("stage") && on_stage[event.key]) || anywhere[event.key];
    if (!action || (event.key === " " && event.target.tagName === "BUTTON")) return;
    action();
    event.preventDefault();
  });
  show(data.from, false);
})();
