"use strict";
/* Plays a run on a canvas: the map, the paths up to a time, loops, particles and the latest key scan. */
function makePlayer(parts) {
  const { canvas, slider, status, layers, onTime } = parts;
  const context = canvas.getContext("2d");
  const LAYERS = [
    ["map", "map", null, true], ["texture", "floor", null, true], ["scans", "scan", "--scan", true], ["truth", "truth", "--truth", true],
    ["final", "SLAM (final)", "--slam", true], ["online", "SLAM (online)", "--online", false],
    ["odometry", "dead reckoning", "--odometry", true], ["loops", "loops", "--loop", true],
    ["rejected", "rejected loops", "--rejected", false], ["particles", "particles", "--particle", true],
  ];
  let run = null, step = 0, shown = {}, view = { x: 0, y: 0, scale: 20 }, follow = false, pending = false;

  const sums = (deltas, unit) => { let sum = 0; return Float64Array.from(deltas, (d) => (sum += d) * unit); };
  const path = (raw) => raw && { x: sums(raw[0], 1e-3), y: sums(raw[1], 1e-3), a: sums(raw[2], 1e-3) };
  const colour = (name) => getComputedStyle(document.documentElement).getPropertyValue(name).trim();

  function load(raw) {
    run = { t: sums(raw.t, 1e-3), states: raw.states, state: raw.state, effective: raw.effective, errors: {} };
    for (const name of ["final", "online", "odometry", "truth"]) run[name] = path(raw[name]);
    for (const name in raw.errors || {}) run.errors[name] = sums(raw.errors[name], 1e-4).map((v) => (v < 0 ? NaN : v));
    run.largest = Math.max(...Object.values(run.errors).map((each) => Math.max(...each.filter((v) => v >= 0))));
    run.unit = run.largest < 0.02 ? ["mm", 1000] : run.largest < 1 ? ["cm", 100] : ["m", 1];
    run.loops = (raw.loops || []).map((l) => ({ t: l[0] / 1e3, ends: l.slice(1, 5).map((v) => v / 1e3), verdict: l[5] }));
    run.particles = raw.particles && {
      t: sums(raw.particles.t, 1e-3), paths: raw.particles.paths.map((p) => [sums(p[0], 1e-3), sums(p[1], 1e-3)]),
    };
    run.scans = raw.scans && { t: sums(raw.scans.t, 1e-3), places: raw.scans.places.map((p) => [sums(p[0], 1e-2), sums(p[1], 1e-2)]) };
    for (const name of ["map", "texture"]) {
      if (!raw[name]) continue;
      const image = new Image();
      image.onload = draw;
      image.src = raw[name].source;
      run[name] = { ...raw[name], image };
    }
    slider.max = run.t.length - 1;
    makeLayers();
    fit();
    goTo(run.t.length - 1);
  }

  function makeLayers() {
    const has = { loops: run.loops.some((l) => l.verdict === 1), rejected: run.loops.some((l) => l.verdict > 1) };
    const legend = layers.firstElementChild;
    layers.replaceChildren(legend);
    for (const [name, title, variable, on] of LAYERS) {
      if (!(name in has ? has[name] : run[name])) continue;
      if (!(name in shown)) shown[name] = on;
      const label = document.createElement("label"), box = document.createElement("input");
      box.type = "checkbox"; box.checked = shown[name]; box.dataset.layer = name;
      box.addEventListener("change", () => { shown[name] = box.checked; draw(); });
      label.append(box, " ");
      if (variable) {
        const swatch = document.createElement("span");
        swatch.className = "swatch"; swatch.style.borderTopColor = colour(variable);
        label.append(swatch);
      }
      label.append(title);
      layers.append(label);
    }
  }

  function bounds() {
    let low = [Infinity, Infinity], high = [-Infinity, -Infinity];
    const grow = (x, y) => { low = [Math.min(low[0], x), Math.min(low[1], y)]; high = [Math.max(high[0], x), Math.max(high[1], y)]; };
    for (const name of ["final", "truth"]) if (run[name]) run[name].x.forEach((x, k) => grow(x, run[name].y[k]));
    if (run.map) { grow(run.map.x, run.map.y); grow(run.map.x + run.map.width, run.map.y + run.map.height); }
    return [low, high];
  }

  function size() {
    const ratio = window.devicePixelRatio || 1, box = canvas.getBoundingClientRect();
    const width = Math.max(1, Math.round(box.width * ratio)), height = Math.max(1, Math.round(box.height * ratio));
    if (canvas.width !== width || canvas.height !== height) { canvas.width = width; canvas.height = height; }
    return { width, height, ratio };
  }

  function fit() {
    if (!run) return;
    const [low, high] = bounds(), { width, height } = size();
    view = {
      x: (low[0] + high[0]) / 2, y: (low[1] + high[1]) / 2,
      scale: 0.95 * Math.min(width / Math.max(high[0] - low[0], 1), height / Math.max(high[1] - low[1], 1)),
    };
    draw();
  }

  function draw() {
    if (pending || !run) return;
    pending = true;
    requestAnimationFrame(() => { pending = false; paint(); });
  }

  function paint() {
    const { width, height, ratio } = size();
    if (follow) { view.x = run.final.x[step]; view.y = run.final.y[step]; }
    const X = (x) => width / 2 + (x - view.x) * view.scale, Y = (y) => height / 2 - (y - view.y) * view.scale;
    context.setTransform(1, 0, 0, 1, 0, 0);
    context.fillStyle = "#e0e0e0";
    context.fillRect(0, 0, width, height);
    for (const name of ["map", "texture"]) {
      const picture = run[name];
      if (!picture || !shown[name] || !picture.image.complete || !picture.image.naturalWidth) continue;
      context.save();
      context.translate(X(picture.x), Y(picture.y));
      context.rotate(-picture.yaw);
      context.imageSmoothingEnabled = view.scale * picture.width < picture.image.naturalWidth;
      context.drawImage(picture.image, 0, -picture.height * view.scale, picture.width * view.scale, picture.height * view.scale);
      context.restore();
    }
    const line = (places, to, style, thick, dash) => {
      context.beginPath();
      for (let k = 0; k <= to; k++) context[k ? "lineTo" : "moveTo"](X(places.x[k]), Y(places.y[k]));
      context.strokeStyle = style; context.lineWidth = thick * ratio; context.setLineDash(dash.map((d) => d * ratio));
      context.stroke(); context.setLineDash([]);
    };
    if (shown.odometry && run.odometry) line(run.odometry, step, colour("--odometry"), 1.5, [6, 4]);
    if (shown.truth && run.truth) line(run.truth, step, colour("--truth"), 4, []);
    if (shown.online && run.online) line(run.online, step, colour("--online"), 1.5, [2, 3]);
    if (shown.final) line(run.final, step, colour("--slam"), 1.8, []);
    const now = run.t[step];
    for (const loop of run.loops) {
      if (loop.t > now + 1e-6 || !shown[loop.verdict === 1 ? "loops" : "rejected"]) continue;
      context.beginPath();
      context.moveTo(X(loop.ends[0]), Y(loop.ends[1])); context.lineTo(X(loop.ends[2]), Y(loop.ends[3]));
      context.strokeStyle = colour(loop.verdict === 1 ? "--loop" : "--rejected");
      context.setLineDash(loop.verdict === 1 ? [] : [4 * ratio, 3 * ratio]);
      context.lineWidth = (loop.verdict === 1 ? 3 : 1) * ratio; context.stroke(); context.setLineDash([]);
    }
    if (shown.particles && run.particles) {
      const t = run.particles.t, at = Math.max(0, lower(t, now + 1e-6) - 1), next = Math.min(at + 1, t.length - 1);
      const part = next > at ? Math.min(1, Math.max(0, (now - t[at]) / Math.max(t[next] - t[at], 1e-6))) : 0;
      context.fillStyle = colour("--particle");
      for (const [x, y] of run.particles.paths) {
        context.beginPath();
        context.arc(X(x[at] + part * (x[next] - x[at])), Y(y[at] + part * (y[next] - y[at])), 3 * ratio, 0, 7);
        context.fill();
      }
    }
    if (shown.scans && run.scans) {
      const [x, y] = run.scans.places[Math.max(0, lower(run.scans.t, now + 1e-6) - 1)];
      context.fillStyle = colour("--scan");
      x.forEach((each, k) => context.fillRect(X(each) - 1.5 * ratio, Y(y[k]) - 1.5 * ratio, 3 * ratio, 3 * ratio));
    }
    robot(X(run.final.x[step]), Y(run.final.y[step]), run.final.a[step], 9 * ratio);
    ruler(width, height, ratio);
    say(now);
  }

  function robot(x, y, angle, radius) {
    context.save();
    context.translate(x, y); context.rotate(-angle);
    context.beginPath(); context.moveTo(radius, 0); context.lineTo(-0.7 * radius, 0.65 * radius);
    context.lineTo(-0.35 * radius, 0); context.lineTo(-0.7 * radius, -0.65 * radius); context.closePath();
    context.fillStyle = "#000000"; context.strokeStyle = "#ffffff"; context.lineWidth = radius / 5;
    context.stroke(); context.fill();
    context.restore();
  }

  function ruler(width, height, ratio) {
    const wanted = (120 * ratio) / view.scale, power = 10 ** Math.floor(Math.log10(wanted));
    const length = power * [5, 2, 1].find((f) => f * power <= wanted), pixels = length * view.scale;
    const x = 14 * ratio, y = height - 14 * ratio;
    context.fillStyle = "rgba(255,255,255,.8)";
    context.fillRect(x - 6 * ratio, y - 22 * ratio, pixels + 12 * ratio, 30 * ratio);
    context.fillStyle = "#000000"; context.fillRect(x, y, pixels, 3 * ratio);
    context.font = `${12 * ratio}px sans-serif`;
    context.fillText(length >= 1 ? `${length} m` : `${Math.round(100 * length)} cm`, x, y - 6 * ratio);
  }

  function say(now) {
    const words = [`${now.toFixed(1)} s of ${run.t[run.t.length - 1].toFixed(1)} s`];
    for (const name of ["final", "online"]) {
      if (run.errors[name]?.[step] >= 0) words.push(`${name} error ${(run.unit[1] * run.errors[name][step]).toPrecision(3)} ${run.unit[0]}`);
    }
    if (run.state) words.push(run.states[run.state[step]]);
    if (run.effective) words.push(`N_eff ${run.effective[step]}`);
    status.textContent = words.join(" · ");
    slider.setAttribute("aria-valuetext", words[0]);
  }

  function lower(values, value) {
    let low = 0, high = values.length;
    while (low < high) { const middle = (low + high) >> 1; if (values[middle] < value) low = middle + 1; else high = middle; }
    return low;
  }

  function goTo(index) {
    step = Math.max(0, Math.min(run.t.length - 1, index));
    slider.value = step;
    onTime(run.t[step]);
    draw();
  }

  function zoom(factor, x = canvas.width / 2, y = canvas.height / 2) {
    const dx = (x - canvas.width / 2) / view.scale, dy = (canvas.height / 2 - y) / view.scale;
    const scale = Math.max(0.5, Math.min(5000, view.scale * factor));
    view.x += dx - (dx * view.scale) / scale; view.y += dy - (dy * view.scale) / scale; view.scale = scale;
    draw();
  }

  const pointers = new Map();
  const place = (event) => {
    const box = canvas.getBoundingClientRect(), ratio = canvas.width / box.width;
    return [(event.clientX - box.left) * ratio, (event.clientY - box.top) * ratio];
  };
  canvas.addEventListener("pointerdown", (event) => { canvas.setPointerCapture(event.pointerId); pointers.set(event.pointerId, place(event)); });
  canvas.addEventListener("pointermove", (event) => {
    if (!pointers.has(event.pointerId)) return;
    const before = [...pointers.values()], from = pointers.get(event.pointerId), to = place(event);
    pointers.set(event.pointerId, to);
    if (pointers.size === 1) { view.x -= (to[0] - from[0]) / view.scale; view.y += (to[1] - from[1]) / view.scale; draw(); }
    if (pointers.size === 2) {
      const after = [...pointers.values()], apart = (p) => Math.hypot(p[0][0] - p[1][0], p[0][1] - p[1][1]);
      zoom(apart(after) / Math.max(apart(before), 1), (after[0][0] + after[1][0]) / 2, (after[0][1] + after[1][1]) / 2);
    }
  });
  for (const name of ["pointerup", "pointercancel"]) canvas.addEventListener(name, (event) => pointers.delete(event.pointerId));
  canvas.addEventListener("wheel", (event) => { event.preventDefault(); zoom(Math.exp(-event.deltaY / 400), ...place(event)); }, { passive: false });
  canvas.addEventListener("keydown", (event) => {
    const move = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, 1], ArrowDown: [0, -1] }[event.key];
    if (move) { view.x += (60 * move[0]) / view.scale; view.y += (60 * move[1]) / view.scale; draw(); }
    else if (event.key === "+" || event.key === "=") zoom(1.3);
    else if (event.key === "-") zoom(1 / 1.3);
    else return;
    event.preventDefault();
  });
  new ResizeObserver(() => draw()).observe(canvas);
  slider.addEventListener("input", () => goTo(Number(slider.value)));

  return {
    load, fit, zoom, draw: () => { if (run) makeLayers(); draw(); }, goTo,
    goToTime: (time) => goTo(Math.max(0, lower(run.t, time + 1e-6) - 1)),
    follow: (on) => { follow = on; draw(); },
    get run() { return run; }, get step() { return step; }, get time() { return run.t[step]; },
  };
}
