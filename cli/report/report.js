// Draws what a reader can turn, zoom and point at. Everything it shows is in the element "data".
(function () {
  "use strict";
  const root = document.documentElement;
  const data = JSON.parse(document.getElementById("data").textContent);
  const INK = "#1a2229", GRID = "#e1e7eb", FONT = { family: "system-ui, sans-serif", size: 12, color: INK };
  const LINES = {
    recovered: { color: "#0b5a86", width: 2 },
    design: { color: "#c24e00", width: 1.6, dash: "dash" },
    reference: { color: INK, width: 1.4, dash: "dot" },
  };
  const CONFIG = { displaylogo: false, responsive: false, modeBarButtons: [["toImage", "zoom2d", "pan2d", "resetScale2d"]], displayModeBar: matchMedia("(hover: hover)").matches && "hover" };
  const [WIDTH, LENGTH] = data.plate_mm;

  /** Rows of a packed array. */
  function rows(packed) {
    const bytes = Uint8Array.from(atob(packed.f4), (character) => character.charCodeAt(0));
    const values = new Float32Array(bytes.buffer), [count, length] = packed.shape, found = [];
    for (let row = 0; row < count; row++) found.push(values.subarray(row * length, (row + 1) * length));
    return found;
  }

  /** Centres of equal cells over an extent around 0. */
  function centres(count, size) {
    return Array.from({ length: count }, (_, index) => ((index + 0.5) / count - 0.5) * size);
  }

  function axis(title, more) {
    return Object.assign({ title: { text: title, standoff: 6 }, gridcolor: GRID, zeroline: false, linecolor: "#7b8790", ticks: "outside", ticklen: 4, automargin: false }, more);
  }

  function layout(margin, more) {
    return Object.assign({ font: FONT, margin: margin, paper_bgcolor: "#fff", plot_bgcolor: "#fff", hoverlabel: { font: FONT } }, more);
  }

  // Plots and how high each is for its width; Plotly's own resizing does not know the plate's shape.
  const drawn = [];
  function draw(id, traces, style, heightFor, config) {
    const plot = document.getElementById(id);
    if (!plot) return null;
    const width = plot.clientWidth;
    Plotly.newPlot(plot, traces, Object.assign(style, { width: width, height: heightFor(width) }), config || CONFIG);
    drawn.push({ plot: plot, heightFor: heightFor, width: width });
    scalable(plot);
    return plot;
  }

  /** Lets the style sheet for paper shrink a plot. */
  function scalable(plot) {
    const width = plot.layout.width, height = plot.layout.height;
    plot.style.setProperty("--ratio", width + " / " + height);
    plot.querySelectorAll(".main-svg").forEach((svg) => svg.setAttribute("viewBox", "0 0 " + width + " " + height));
  }

  function resize(item, width) {
    if (!width || width === item.width) return;
    item.width = width;
    Plotly.relayout(item.plot, { width: width, height: item.heightFor(width) });
    scalable(item.plot);
  }

  // On A4 with the margins of the style sheet a column is so wide; text keeps its size on paper.
  const PAPER = { half: 336, full: 690 };
  let isPrinting = false;
  function fit() {
    if (!isPrinting) drawn.forEach((item) => resize(item, item.plot.clientWidth));
  }
  window.addEventListener("beforeprint", () => {
    isPrinting = true;
    document.querySelectorAll("details").forEach((part) => { part.open = true; });
    drawn.forEach((item) => { if (item.plot.dataset.kind !== "surface") resize(item, item.plot.closest(".two") ? PAPER.half : PAPER.full); });
  });
  window.addEventListener("afterprint", () => { isPrinting = false; fit(); });
  let waiting = 0;
  window.addEventListener("resize", () => { clearTimeout(waiting); waiting = setTimeout(fit, 120); });

  // Maps.
  const MAP_MARGIN = { l: 46, r: 78, t: 8, b: 40 };
  function drawMap(name) {
    const map = data.maps[name], values = rows(map.values), [count, length] = map.values.shape;
    const bar = { thickness: 13, len: 1, lenmode: "fraction", outlinewidth: 0, x: 1.02, xpad: 2, ypad: 0, title: { text: map.label, side: "right" } };
    if (map.ticks) Object.assign(bar, { tickvals: map.ticks.map((tick) => tick[0]), ticktext: map.ticks.map((tick) => tick[1]) });
    const trace = {
      type: "heatmap", z: values, x0: (0.5 / length - 0.5) * WIDTH, dx: WIDTH / length, y0: (0.5 / count - 0.5) * LENGTH, dy: LENGTH / count,
      zmin: map.low, zmax: map.high, colorscale: map.colours, colorbar: bar, zsmooth: false, hoverongaps: false,
      hovertemplate: "x %{x:.2f} mm, y %{y:.2f} mm<br>%{z:.4~g} " + map.unit + "<extra></extra>",
    };
    if (map.is_log) {
      trace.customdata = values.map((row) => Array.from(row, (value) => Math.pow(10, value)));
      trace.hovertemplate = trace.hovertemplate.replace("%{z:", "%{customdata:");
    }
    const boxes = map.boxes.map(([x0, y0, x1, y1]) => ({ type: "rect", x0: x0, y0: y0, x1: x1, y1: y1, line: { color: INK, width: 1.3 } }));
    const numbers = map.boxes.map(([, y0, x1, , text]) => ({ x: x1, y: y0, text: "<b>" + text + "</b>", showarrow: false, xanchor: "left", yanchor: "top", bgcolor: "rgba(255,255,255,0.8)", borderpad: 1, font: { size: 12, color: INK } }));
    const style = layout(MAP_MARGIN, {
      xaxis: axis("x [mm]", { range: [-WIDTH / 2, WIDTH / 2], constrain: "domain", showgrid: false }),
      // Row 0 on top, as a photo viewer shows the image.
      yaxis: axis("y [mm]", { range: [LENGTH / 2, -LENGTH / 2], scaleanchor: "x", constrain: "domain", showgrid: false }),
      plot_bgcolor: "#bebebe", shapes: boxes, annotations: numbers,
    });
    return draw("map-" + name, [trace], style, (width) => {
      const inner = width - MAP_MARGIN.l - MAP_MARGIN.r;
      return MAP_MARGIN.t + MAP_MARGIN.b + inner * Math.min(2.5, LENGTH / WIDTH);
    });
  }

  // Sections through a point of the height map.
  function drawSections(heightMap) {
    const profiles = Object.entries(data.profiles).map(([name, packed]) => ({ name: name, values: rows(packed) }));
    const [count, length] = data.profiles.recovered.shape, sigma = data.sigma && rows(data.sigma);
    const x = centres(length, WIDTH), y = centres(count, LENGTH);
    const [low, high] = data.profile_range_um, slack = 0.06 * (high - low);
    const state = { row: data.start[0], column: data.start[1] };
    const control = (id) => document.getElementById(id);
    const line = (values, along, at) => (along === "x" ? values[at] : Float32Array.from(values, (row) => row[at]));

    function traces(along) {
      const places = along === "x" ? x : y, at = along === "x" ? state.row : state.column, made = [];
      if (sigma) {
        const middle = line(profiles[0].values, along, at), spread = line(sigma, along, at);
        const edge = (sign) => Array.from(middle, (value, index) => value + sign * 2 * spread[index]);
        const hidden = { mode: "lines", line: { width: 0 }, hoverinfo: "skip", showlegend: false };
        made.push(Object.assign({ x: places, y: edge(-1) }, hidden), Object.assign({ x: places, y: edge(1), fill: "tonexty", fillcolor: "rgba(11,90,134,0.18)" }, hidden));
      }
      profiles.forEach((profile) => made.push({
        x: places, y: line(profile.values, along, at), name: profile.name, mode: "lines", line: LINES[profile.name], showlegend: profiles.length > 1,
        hovertemplate: "%{y:.4~g} um<extra>" + profile.name + "</extra>",
      }));
      return made;
    }

    function style(along, plot) {
      const other = along === "x" ? "y = " + y[state.row].toFixed(2) : "x = " + x[state.column].toFixed(2), half = (along === "x" ? WIDTH : LENGTH) / 2;
      const place = along === "x" ? x[state.column] : y[state.row];
      return layout({ l: 58, r: 12, t: 30, b: 46 }, {
        width: plot.clientWidth, height: sectionHeight(plot.clientWidth), hovermode: "x unified", uirevision: along,
        title: { text: "Section along " + along + " at " + other + " mm", font: { size: 13 }, x: 0, xref: "paper", y: 0.98, yanchor: "top" },
        legend: { orientation: "h", traceorder: "normal", x: 1, xanchor: "right", y: 1.02, yanchor: "bottom", bgcolor: "rgba(0,0,0,0)" },
        xaxis: axis(along + " [mm]", { range: [-half, half] }), yaxis: axis("height [um]", { range: [low - slack, high + slack] }),
        shapes: [{ type: "line", x0: place, x1: place, yref: "paper", y0: 0, y1: 1, line: { color: "#7b8790", width: 1, dash: "dot" } }],
      });
    }
    const sectionHeight = (width) => Math.max(200, Math.min(300, 0.46 * width));
    const plots = { x: control("section-x"), y: control("section-y") };

    function show() {
      ["x", "y"].forEach((along) => {
        const plot = plots[along];
        Plotly.react(plot, traces(along), style(along, plot), CONFIG).then(() => scalable(plot));
        plot.setAttribute("aria-label", "Section along " + along + ", heights from " + low.toPrecision(3) + " to " + high.toPrecision(3) + " um");
      });
      const cross = { type: "line", line: { color: "#fff", width: 1 } };
      const under = { type: "line", line: { color: "#000", width: 2.5 } };
      const across = { x0: -WIDTH / 2, x1: WIDTH / 2, y0: y[state.row], y1: y[state.row] }, along = { x0: x[state.column], x1: x[state.column], y0: -LENGTH / 2, y1: LENGTH / 2 };
      Plotly.relayout(heightMap, { shapes: [{ ...under, ...across }, { ...under, ...along }, { ...cross, ...across }, { ...cross, ...along }] });
      control("column").value = state.column;
      control("row").value = state.row;
      control("column-mm").textContent = x[state.column].toFixed(2) + " mm";
      control("row-mm").textContent = y[state.row].toFixed(2) + " mm";
      root.dataset.section = state.row + "," + state.column;
    }

    // One drawing per 16 ms, however fast the pointer moves.
    let isAsked = false;
    function move(row, column) {
      if (row === state.row && column === state.column) return;
      Object.assign(state, { row: row, column: column });
      if (isAsked) return;
      isAsked = true;
      setTimeout(() => { isAsked = false; show(); }, 16);
    }
    const cell = (event) => { const [row, column] = event.points[0].pointIndex; return [row, column]; };
    heightMap.on("plotly_hover", (event) => { if (control("follow").checked) move(...cell(event)); });
    heightMap.on("plotly_click", (event) => { control("follow").checked = !control("follow").checked; move(...cell(event)); });
    [["column", length], ["row", count]].forEach(([name, size]) => {
      control(name).max = size - 1;
      control(name).addEventListener("input", () => { control("follow").checked = false; move(+control("row").value, +control("column").value); });
    });
    control("highest").addEventListener("click", () => { control("follow").checked = false; move(...data.start); });
    ["x", "y"].forEach((along) => draw("section-" + along, traces(along), style(along, plots[along]), sectionHeight));
    show();
  }

  function drawHistogram(name) {
    const bins = data.histograms[name], lines = bins.tolerance === null ? [] : [-bins.tolerance, bins.tolerance];
    const smallest = Math.min(...bins.share.filter((share) => share > 0)), low = Math.floor(Math.log10(smallest)), colours = data.maps[name];
    const trace = {
      type: "bar", x: bins.centres, y: bins.share, width: bins.width, hovertemplate: "%{customdata:.4~g} um: %{y:.3~g} %<extra></extra>",
      customdata: bins.centres.map((place) => (bins.ticks ? Math.pow(10, place) : place)),
      marker: { color: bins.centres, colorscale: colours.colours, cmin: colours.low, cmax: colours.high, line: { color: "#5d6a73", width: 0.6 } },
    };
    draw("histogram-" + name, [trace], layout({ l: 58, r: 12, t: 24, b: 40 }, {
      bargap: 0, xaxis: axis(bins.label, bins.ticks ? { tickvals: bins.ticks.map((tick) => tick[0]), ticktext: bins.ticks.map((tick) => tick[1]) } : {}), yaxis: axis("share [%]", { type: "log", dtick: 1, range: [isFinite(low) ? low : -2, 2.1], exponentformat: "none" }),
      shapes: lines.map((place) => ({ type: "line", x0: place, x1: place, yref: "paper", y0: 0, y1: 1, line: { color: INK, width: 1.6, dash: "dash" } })),
      annotations: lines.map((place) => ({ x: place, y: 1, yref: "paper", yanchor: "bottom", xanchor: place > 0 ? "left" : "right", text: (place > 0 ? "+" : "\u2212") + +Math.abs(place).toPrecision(3) + " um", showarrow: false })),
    }), (width) => (name === "height" ? 220 : Math.max(260, Math.min(440, 0.72 * width))));
  }

  function drawConvergence() {
    if (!data.convergence.length) return;
    const colours = ["#0b5a86", "#c24e00", "#00785a", "#8a3f74", "#8a6100"], marks = ["circle", "square", "diamond", "triangle-up", "x"];
    const escaped = (text) => text.replace(/&/g, "&amp;").replace(/</g, "&lt;").replace(/>/g, "&gt;");
    const traces = data.convergence.map((curve, index) => ({
      x: curve.iteration, y: curve.residual, name: escaped(curve.stage), mode: "lines+markers", showlegend: true,
      line: { color: colours[index % 5], width: 1.6 }, marker: { symbol: marks[index % 5], size: 5 }, hovertemplate: "%{x}: %{y:.4~g} %<extra></extra>",
    }));
    // 1, 2 and 5 of every decade, written out: Plotly's own labels leave the decade away.
    const places = [];
    for (let power = -6; power <= 6; power++) [1, 2, 5].forEach((digit) => places.push(+(digit + "e" + power)));
    draw("convergence-plot", traces, layout({ l: 58, r: 12, t: 34, b: 40 }, {
      legend: { orientation: "h", x: 0, y: 1.02, yanchor: "bottom" },
      xaxis: axis("step"), yaxis: axis("image residual [%]", { type: "log", tickvals: places, ticktext: places.map(String) }),
    }), (width) => Math.max(240, Math.min(340, 0.4 * width)));
  }

  /** Where a map has no value or a neighbour has none; Plotly leaves out what touches a missing height. */
  function beside(values, heights) {
    return heights.map((line, row) => line.map((height, column) => {
      const near = values.slice(Math.max(0, row - 1), row + 2).some((other) => other.subarray(Math.max(0, column - 1), column + 2).some(Number.isNaN));
      return near ? height : NaN;
    }));
  }

  // The surface.
  function drawSurface() {
    const heights = rows(data.surface.heights), [count, length] = data.surface.heights.shape, [low, high] = data.surface.range_um;
    const names = Object.keys(data.surface.colours), widest = Math.max(WIDTH, LENGTH), part = ((high - low) * 1e-3) / widest;
    const factor = data.surface.factor, map = (name) => data.maps[name];
    const slack = 0.02 * (high - low);
    const ratio = (scale) => ({ x: WIDTH / widest, y: LENGTH / widest, z: 1.04 * part * scale });
    // Far enough that the whole plate is seen: on a narrow screen the width is what counts.
    const far = document.getElementById("surface-plot").clientWidth < 600 ? 1.45 : 1;
    const oblique = { eye: { x: -0.64 * far, y: -0.98 * far, z: 0.7 * far }, center: { x: 0.03, y: 0.02, z: -0.2 }, up: { x: 0, y: 0, z: 1 } };
    const above = { eye: { x: 0, y: -0.001, z: 1.15 * far }, center: { x: 0, y: 0, z: 0 }, up: { x: 0, y: 1, z: 0 } };
    // Two surfaces: what the map has a value for in its colours, and the rest in grey.
    const paint = (name) => {
      const shown = map(name), values = rows(data.surface.colours[name]);
      return {
        z: heights.map((line, row) => line.map((height, column) => (Number.isNaN(values[row][column]) ? NaN : height))),
        surfacecolor: values, customdata: values, colorscale: shown.colours, cmin: shown.low, cmax: shown.high,
        colorbar: { thickness: 13, len: 0.7, outlinewidth: 0, x: 1, xpad: 4, title: { text: shown.label, side: "right" } },
        hovertemplate: "x %{x:.2f} mm, y %{y:.2f} mm<br>height %{z:.4~g} um" + (name === "height" ? "" : "<br>" + shown.title.toLowerCase() + " %{customdata:.4~g} um") + "<extra></extra>",
      };
    };
    const rest = (name) => {
      const values = rows(data.surface.colours[name]), isNeeded = name !== "height" && values.some((row) => row.some(Number.isNaN));
      return { z: isNeeded ? beside(values, heights) : heights, visible: isNeeded };
    };
    const glass = {
      type: "surface", x: centres(length, WIDTH), y: centres(count, LENGTH),
      lighting: { ambient: 0.72, diffuse: 0.42, specular: 0.06, roughness: 0.6, fresnel: 0.05 }, lightposition: { x: -2000, y: 3000, z: 6000 },
      contours: { x: { highlight: false }, y: { highlight: false }, z: { highlight: false } },
    };
    const grey = { colorscale: [[0, "#bebebe"], [1, "#bebebe"]], showscale: false, hovertemplate: "x %{x:.2f} mm, y %{y:.2f} mm<br>height %{z:.4~g} um<extra></extra>" };
    const traces = [{ ...glass, ...paint(names[0]) }, { ...glass, ...grey, ...rest(names[0]) }];
    const side = (title, more) => Object.assign({ title: { text: title }, gridcolor: "#c3ccd3", zerolinecolor: "#c3ccd3", showbackground: true, backgroundcolor: "#eef2f5", showspikes: false, color: INK }, more);
    const plot = draw("surface-plot", traces, layout({ l: 0, r: 0, t: 0, b: 0 }, {
      scene: {
        bgcolor: "#e4eaee", aspectmode: "manual", aspectratio: ratio(factor), camera: oblique, dragmode: "turntable",
        xaxis: side("x [mm]", { range: [-WIDTH / 2, WIDTH / 2] }), yaxis: side("y [mm]", { range: [-LENGTH / 2, LENGTH / 2] }),
        zaxis: side("height [um]", { range: [low - slack, high + slack], nticks: 5 }),
      },
    }), (width) => Math.max(300, Math.min(620, 0.56 * width)), { ...CONFIG, modeBarButtons: [["toImage", "resetCameraDefault3d"]] });

    const pressed = (buttons, chosen) => buttons.forEach((button) => button.setAttribute("aria-pressed", String(button === chosen)));
    const scales = [document.getElementById("exaggerated"), document.getElementById("true-scale")];
    scales[0].textContent = "exaggerated " + factor + " times";
    scales.forEach((button, index) => button.addEventListener("click", () => {
      pressed(scales, button);
      Plotly.relayout(plot, { "scene.aspectratio": ratio(index ? 1 : factor), "scene.zaxis.visible": !index || part > 0.1 });
    }));
    const paints = Array.from(document.querySelectorAll("button.colour"));
    paints.forEach((button) => button.addEventListener("click", () => {
      pressed(paints, button);
      const chosen = [paint(button.dataset.map), rest(button.dataset.map)];
      chosen.forEach((values, index) => Plotly.restyle(plot, Object.fromEntries(Object.entries(values).map(([key, value]) => [key, [value]])), [index]));
    }));
    document.getElementById("from-above").addEventListener("click", () => Plotly.relayout(plot, { "scene.camera": above }));
    document.getElementById("oblique").addEventListener("click", () => Plotly.relayout(plot, { "scene.camera": oblique }));
    return plot;
  }

  function hasWebGL() {
    const canvas = document.createElement("canvas");
    return Boolean(canvas.getContext("webgl2") || canvas.getContext("webgl"));
  }

  function blink() {
    const button = document.getElementById("blink"), picture = document.querySelector("#simulated image");
    const own = picture.getAttribute("href"), measured = document.querySelector("#caustic image").getAttribute("href");
    button.addEventListener("click", () => {
      const isOn = button.getAttribute("aria-pressed") !== "true";
      button.setAttribute("aria-pressed", String(isOn));
      picture.setAttribute("href", isOn ? measured : own);
      document.querySelector("#simulated figcaption").textContent = isOn ? "Measured, for comparison" : "Re-simulated from the recovered relief";
    });
  }

  let heightMap = null;
  Object.keys(data.maps).forEach((name) => { const plot = drawMap(name); if (name === "height") heightMap = plot; });
  drawSections(heightMap);
  Object.keys(data.histograms).forEach(drawHistogram);
  drawConvergence();
  blink();
  if (hasWebGL()) drawSurface(); else root.classList.add("no-webgl");
  root.dataset.ready = "true";
})();
