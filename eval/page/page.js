"use strict";
/* The page: charts in its colours, tables that sort, the player's controls. */
(() => {
  const get = (id) => document.getElementById(id);
  const data = (id) => JSON.parse(get(id).textContent);
  const figures = data("charts");
  const variable = (name) => getComputedStyle(document.documentElement).getPropertyValue(name).trim();
  const logTicks = (low, high) => {
    const steps = high < 1000 * low ? [1, 2, 5] : [1], ticks = [];
    for (let p = Math.floor(Math.log10(low)) - 1; p <= Math.ceil(Math.log10(high)); p++) ticks.push(...steps.map((step) => step * 10 ** p));
    return { type: "log", tickvals: ticks, ticktext: ticks.map((tick) => String(Number(tick.toPrecision(1)))) };
  };
  const CONFIG = { responsive: true, displaylogo: false, modeBarButtonsToRemove: ["lasso2d", "select2d"] };
  let number = 0, player = null, ignoreTime = false;

  function layout(own) {
    const text = variable("--text"), line = variable("--line"), style = { gridcolor: line, linecolor: line, zerolinecolor: line, automargin: true };
    return {
      paper_bgcolor: "rgba(0,0,0,0)", plot_bgcolor: "rgba(0,0,0,0)", font: { color: text, size: 13 },
      margin: { l: 60, r: 16, t: 36, b: 48 }, hovermode: "closest", hoverlabel: { align: "left" },
      modebar: { bgcolor: "rgba(0,0,0,0)", color: variable("--quiet"), activecolor: text },
      legend: { orientation: "h", y: 1, yanchor: "bottom" }, ...own, // above: labels below are of any height
      xaxis: { ...style, ...own.xaxis }, yaxis: { ...style, ...own.yaxis },
    };
  }

  function chart(place, figure) {
    const note = place.parentElement.querySelector(".more");
    place.parentElement.hidden = !figure;
    if (!figure) return;
    if (note) note.textContent = figure.note || "";
    Plotly.react(place, figure.data, layout(figure.layout), CONFIG);
  }

  function drawCharts() {
    const own = figures[number];
    for (const place of document.querySelectorAll("[data-chart]")) chart(place, own[place.dataset.chart]);
    for (const table of document.querySelectorAll(".of-metric")) table.hidden = Number(table.dataset.metric) !== number;
    const curves = document.querySelector("[data-charts=curves]");
    if (!curves) return;
    while (curves.children.length > own.curves.length) curves.lastElementChild.remove();
    own.curves.forEach((figure, k) => {
      if (!curves.children[k]) {
        const block = document.createElement("figure"), place = document.createElement("div"), caption = document.createElement("figcaption");
        const more = document.createElement("span");
        place.className = "chart"; more.className = "more";
        caption.append("Medians over the runs, of enough of them with 95 % intervals. ", more);
        block.append(place, caption); curves.append(block);
      }
      chart(curves.children[k].firstElementChild, figure);
    });
  }

  function drawError() {
    const place = get("error"), run = player && player.run;
    if (!place || !run) return;
    const names = [["final", "SLAM (final)", "--slam", "solid"], ["online", "SLAM (online)", "--online", "dot"], ["odometry", "dead reckoning", "--odometry", "dash"]];
    const known = names.filter(([name]) => run.errors[name]);
    place.parentElement.hidden = !known.length;
    if (!known.length) return;
    const [unit, factor] = run.unit, largest = run.largest;
    const traces = known.map(([name, title, colour, dash]) => ({
      type: "scatter", mode: "lines", name: title, x: Array.from(run.t), y: Array.from(run.errors[name], (e) => factor * e),
      line: { color: variable(colour), dash, width: 1.5 }, hovertemplate: `%{x:.1f} s: %{y:.3~g} ${unit}<extra></extra>`,
    }));
    const least = Math.min(...known.flatMap(([name]) => [...run.errors[name].filter((e) => e > 0)])), scale = largest < 20 * least ? {} : logTicks(factor * least, factor * largest);
    Plotly.react(place, traces, layout({
      xaxis: { title: { text: "time [s]" } }, yaxis: { title: { text: `position error [${unit}]` }, ...scale },
      shapes: [cursor(player.time)],
    }), CONFIG);
    place.removeAllListeners("plotly_click");
    place.on("plotly_click", (event) => player.goToTime(event.points[0].x));
  }

  const cursor = (time) => ({ type: "line", x0: time, x1: time, yref: "paper", y0: 0, y1: 1, line: { color: variable("--quiet"), width: 1 } });
  let last = 0, due = 0;
  function moveCursor(time) {
    const place = get("error");
    if (ignoreTime || !place || !place.layout) return;
    clearTimeout(due);
    const wait = 100 - (performance.now() - last);
    if (wait > 0) { due = setTimeout(() => moveCursor(time), wait); return; }
    last = performance.now();
    Plotly.relayout(place, { shapes: [cursor(time)] });
  }

  function sortable(table) {
    const heads = [...table.tHead.rows[0].cells], body = table.tBodies[0];
    heads.forEach((head, column) => {
      const button = head.querySelector("button");
      if (!button) return;
      button.addEventListener("click", () => {
        const down = head.getAttribute("aria-sort") === "ascending";
        heads.forEach((other) => other.hasAttribute("aria-sort") && other.setAttribute("aria-sort", "none"));
        head.setAttribute("aria-sort", down ? "descending" : "ascending");
        const rows = [...body.rows].map((row) => {
          const cell = row.cells[column], key = cell.dataset.key;
          const text = key === undefined ? cell.textContent.trim() : key, value = text === "inf" ? Infinity : text === "-inf" ? -Infinity : Number(text);
          return { row, text, value: text !== "" && !Number.isNaN(value) ? value : null };
        });
        const sign = down ? -1 : 1;
        rows.sort((a, b) => {
          if ((a.text === "") !== (b.text === "")) return a.text === "" ? 1 : -1;
          if (a.value !== null && b.value !== null) return a.value === b.value ? 0 : sign * (a.value < b.value ? -1 : 1);
          return sign * a.text.localeCompare(b.text, undefined, { numeric: true });
        });
        body.append(...rows.map((each) => each.row));
      });
    });
  }

  function filterRows() {
    const wanted = get("filter").value.toLowerCase(), rows = [...get("all").tBodies[0].rows];
    let count = 0;
    for (const row of rows) {
      row.hidden = !row.textContent.toLowerCase().includes(wanted);
      count += !row.hidden;
    }
    get("shown").textContent = wanted ? `${count} of ${rows.length} rows` : "";
  }

  function setUpPlayer() {
    if (!get("player")) return;
    player = makePlayer({ canvas: get("map"), slider: get("time"), status: get("now"), layers: get("layers"), onTime: moveCursor });
    let timer = 0, begun = 0, from = 0;
    const stop = () => { cancelAnimationFrame(timer); timer = 0; get("play").textContent = "Play"; get("play").setAttribute("aria-pressed", "false"); };
    const tick = (now) => {
      const time = from + ((now - begun) / 1000) * Number(get("speed").value);
      player.goToTime(time);
      if (player.step >= player.run.t.length - 1) stop(); else timer = requestAnimationFrame(tick);
    };
    const play = () => {
      if (timer) { stop(); return; }
      if (player.step >= player.run.t.length - 1) player.goTo(0);
      begun = performance.now(); from = player.time;
      get("play").textContent = "Pause"; get("play").setAttribute("aria-pressed", "true");
      timer = requestAnimationFrame(tick);
    };
    const load = (index) => {
      stop();
      ignoreTime = true; player.load(data(`run-${index}`)); ignoreTime = false;
      get("run").value = index;
      drawError();
    };
    get("play").addEventListener("click", play);
    get("time").addEventListener("pointerdown", stop);
    get("time").addEventListener("keydown", (event) => { if (event.key !== " " && event.key !== "Tab") stop(); });
    get("speed").addEventListener("change", () => { begun = performance.now(); from = player.time; });
    get("run").addEventListener("change", () => load(Number(get("run").value)));
    get("nearer").addEventListener("click", () => player.zoom(1.4));
    get("farther").addEventListener("click", () => player.zoom(1 / 1.4));
    get("fit").addEventListener("click", () => { get("follow").checked = false; player.follow(false); player.fit(); });
    get("follow").addEventListener("change", () => player.follow(get("follow").checked));
    for (const button of document.querySelectorAll("button.show")) {
      button.addEventListener("click", () => { load(Number(button.dataset.run)); get("player").scrollIntoView(); get("play").focus(); });
    }
    document.addEventListener("keydown", (event) => {
      const busy = event.target.closest("input, select, textarea, button, summary, a");
      if (event.key === " " && (!busy || event.target === get("time"))) { event.preventDefault(); play(); }
    });
    load(0);
  }

  function recolour() { drawCharts(); if (player) { player.draw(); drawError(); } }

  document.querySelectorAll("table.sortable").forEach(sortable);
  get("filter").addEventListener("input", filterRows);
  get("metric").addEventListener("change", () => { number = Number(get("metric").value); drawCharts(); });
  get("scheme").addEventListener("change", () => {
    const wanted = get("scheme").value;
    if (wanted) document.documentElement.dataset.scheme = wanted; else delete document.documentElement.dataset.scheme;
    recolour();
  });
  matchMedia("(prefers-color-scheme: dark)").addEventListener("change", recolour);
  let scheme = "";
  window.addEventListener("beforeprint", () => { scheme = document.documentElement.dataset.scheme || ""; document.documentElement.dataset.scheme = "light"; recolour(); });
  window.addEventListener("afterprint", () => { if (scheme) document.documentElement.dataset.scheme = scheme; else delete document.documentElement.dataset.scheme; recolour(); });
  async function library() {
    const packed = Uint8Array.from(atob(get("library").textContent), (letter) => letter.charCodeAt(0));
    const script = document.createElement("script"), stream = new Blob([packed]).stream();
    script.textContent = await new Response(stream.pipeThrough(new DecompressionStream("gzip"))).text();
    document.head.append(script);
  }

  library().then(() => {
    setUpPlayer();
    drawCharts();
    document.documentElement.dataset.ready = "yes";
  });
})();
