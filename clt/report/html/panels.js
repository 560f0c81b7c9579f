"use strict";
// Panels over time, of pairs, of windows, of messages.
function stackedLayout(panels, height, gap = 0.09) {
  const layout = layoutWith({ height, annotations: [], shapes: [] });
  const each = (1 - gap * (panels.length - 1)) / panels.length;
  panels.forEach((panel, k) => {
    const top = 1 - k * (each + gap), axis = k === 0 ? "" : k + 1;
    layout[`yaxis${axis}`] = {
      domain: [top - each, top], title: { text: panel.unit }, fixedrange: false, ...grid, ...panel.axis,
    };
    layout.annotations.push(titleAt(panel.title, top));
  });
  layout.xaxis = { title: { text: "time in s" }, anchor: `y${panels.length === 1 ? "" : panels.length}`, ...grid };
  return layout;
}

function drawPanels(run, number) {
  const box = at("time", number), traces = [];
  if (!box) return null;
  const named = new Set();
  run.panels.forEach((panel, k) => {
    panel.axis = { range: panel.signed ? [-panel.limit, panel.limit] : [0, panel.limit] };
    for (const line of panel.lines) {
      const look = lookOf(run, line.robot), bound = line.role === "bound";
      traces.push({
        mode: "lines", x: decode(line.time), y: decode(line.value), connectgaps: false,
        yaxis: `y${k === 0 ? "" : k + 1}`, name: line.robot, legendgroup: line.robot,
        showlegend: !bound && !named.has(line.robot), meta: { robot: line.robot },
        line: { color: look.color, width: THIN, dash: bound ? "dot" : look.dash },
        hovertemplate: `${line.robot}${bound ? ", 3 sigma" : ""}<br>%{x:.2f} s: %{y:.4g} ${panel.unit}<extra></extra>`,
      });
      if (!bound) named.add(line.robot);
    }
  });
  Plotly.newPlot(box, traces, stackedLayout(run.panels, narrow() ? 480 : 520), config);
  return box;
}

function drawPairs(run, number) {
  const box = at("pairs", number), select = at("pair", number), note = at("pair-note", number);
  const pairs = run.pairs.pairs, names = Object.keys(pairs);
  if (names.length === 0) {
    box.textContent = "There are no ranges in this log.";
    box.style.minHeight = "0";
    select.parentElement.remove();
    return null;
  }
  for (const name of names) select.add(new Option(name, name));
  const draw = run.pairs.kind === "residuals" ? drawResiduals : drawRanges;
  const show = () => draw(box, note, run, select.value);
  select.addEventListener("change", show);
  show();
  return box;
}

function drawRanges(box, note, run, name) {
  const one = run.pairs.pairs[name], time = decode(one.ranges.time);
  note.textContent = `${one.count} ranges, ${time.length} drawn`;
  const layout = stackedLayout([{ title: `Ranges of ${name}`, unit: "m" }], 360);
  const dots = { mode: "markers", x: time, y: decode(one.ranges.value), marker: { size: 4, color: report.colours[0] } };
  Plotly.react(box, [{ ...dots, hovertemplate: "%{x:.2f} s: %{y:.3f} m<extra></extra>" }], layout, config);
}

function drawResiduals(box, note, run, name) {
  const one = run.pairs.pairs[name], small = narrow();
  const used = decode(one.used.time), rejected = decode(one.rejected.time);
  note.textContent = `${one.count} ranges, ${one.rejected_count} rejected; ${used.length + rejected.length} drawn`;
  const hover = "%{x:.2f} s: %{y:.2f} sigma<extra></extra>";
  const bins = run.pairs.bins, normal = bins.map((z) => Math.exp((-z * z) / 2) / Math.sqrt(2 * Math.PI));
  const lags = one.autocorrelation.map((_, k) => k + 1);
  const traces = [
    { mode: "markers", name: "used", x: used, y: decode(one.used.value), hovertemplate: hover,
      marker: { size: 4, color: report.colours[0], opacity: 0.6 } },
    { mode: "markers", name: "rejected", x: rejected, y: decode(one.rejected.value), hovertemplate: hover,
      marker: { size: 7, color: report.alarm, symbol: "x" } },
    { type: "bar", name: "histogram of the used ones", x: bins, y: decode(one.histogram), xaxis: "x2", yaxis: "y2",
      marker: { color: report.colours[5] }, hovertemplate: "%{x:.2f} sigma: %{y:.3f}<extra></extra>" },
    { mode: "lines", name: "standard normal", x: bins, y: normal, xaxis: "x2", yaxis: "y2",
      line: { color: report.ink, width: 1.5, dash: "dash" }, hoverinfo: "skip" },
    { type: "bar", name: "autocorrelation", x: lags, y: one.autocorrelation, xaxis: "x3", yaxis: "y3",
      marker: { color: report.colours[2] }, hovertemplate: "lag %{x}: %{y:.3f}<extra></extra>" },
  ];
  const values = [...decode(one.used.value), ...decode(one.rejected.value)].map(Math.abs).sort((a, b) => a - b);
  const limit = Math.max(4, 1.1 * (values[Math.floor(0.995 * (values.length - 1))] || 0));
  const level = (y, ref, dash = "dot") => ({
    type: "line", xref: `${ref} domain`, yref: ref.replace("x", "y"), x0: 0, x1: 1, y0: y, y1: y,
    line: { color: report.ink, width: 1, dash },
  });
  const b = one.autocorrelation_bound;
  const most = Math.min(1, 1.3 * Math.max(0.05, b, ...one.autocorrelation.map(Math.abs)));
  const domains = small
    ? { top: [0.74, 1], a: [[0, 1], [0.38, 0.58]], b: [[0, 1], [0.02, 0.22]] }
    : { top: [0.52, 1], a: [[0, 0.48], [0, 0.36]], b: [[0.56, 1], [0, 0.36]] };
  const layout = layoutWith({
    height: small ? 860 : 560, bargap: 0.05,
    xaxis: { anchor: "y", title: { text: "time in s" }, ...grid },
    yaxis: { domain: domains.top, range: [-limit, limit], title: { text: "residual / sigma" }, ...grid },
    xaxis2: { domain: domains.a[0], anchor: "y2", title: { text: "residual / sigma" }, ...grid },
    yaxis2: { domain: domains.a[1], anchor: "x2", title: { text: "density" }, ...grid },
    xaxis3: { domain: domains.b[0], anchor: "y3", title: { text: "lag in ranges of the pair" }, ...grid },
    yaxis3: { domain: domains.b[1], anchor: "x3", range: [-most, most], ...grid },
    shapes: [level(3, "x"), level(-3, "x"), level(b, "x3"), level(-b, "x3")],
    annotations: [
      titleAt(`Residuals of ${name}, dotted: 3 sigma`, domains.top[1]),
      { ...titleAt("Histogram of the used ones", domains.a[1][1]), x: domains.a[0][0] },
      { ...titleAt("Autocorrelation, dotted: 95 % by chance", domains.b[1][1]), x: domains.b[0][0] },
    ],
    legend: { orientation: "h", y: small ? -0.1 : -0.14, yanchor: "top", x: 0 },
  });
  Plotly.react(box, traces, layout, config);
}

function drawWindows(run, number) {
  const box = at("windows", number), found = run.windows;
  if (!box || !found) return null;
  const time = decode(found.time), traces = [];
  // Two decades below the limit are shown at least, and as much of what is known.
  const logAxis = (kind, limit) => {
    const known = Object.values(found.robots).flatMap((one) => [...decode(one[kind])]);
    const shown = [...known.filter((one) => one > 0 && Number.isFinite(one)), limit, limit / 20];
    const ends = [Math.min(...shown) / 1.6, Math.max(...shown) * 1.6].map(Math.log10);
    return { type: "log", range: ends, dtick: "D2", tickformat: "~g" };
  };
  const panels = [
    { title: `Numbers that a window of ${found.length} s alone determines, of ${found.dimension} (in ${found.frame}, at the ${found.source})`,
      unit: "rank", axis: { range: [0, found.dimension + 0.5] } },
    { title: "Best standard deviation of the position; above the dotted line it counts as unknown", unit: "m", axis: logAxis("position", found.position_limit) },
    { title: "The same of the heading", unit: "degrees", axis: logAxis("heading", found.heading_limit) },
  ];
  traces.push({ mode: "lines", line: { shape: "hv", color: report.ink, width: 1.6 }, x: time, y: found.rank,
    name: "rank of the team", hovertemplate: "%{x:.1f} s: rank %{y}<extra></extra>" });
  for (const [robot, one] of Object.entries(found.robots)) {
    const look = lookOf(run, robot);
    ["position", "heading"].forEach((kind, k) => {
      if (kind === "heading" && !one.has_heading) return;
      traces.push({
        mode: "lines+markers", x: time, y: decode(one[kind]), yaxis: `y${k + 2}`, name: robot, legendgroup: robot,
        showlegend: k === 0, line: { ...look, width: 1.3 }, marker: { size: 4 }, connectgaps: false,
        hovertemplate: `${robot}<br>%{x:.1f} s: %{y:.3g}<extra></extra>`,
      });
    });
  }
  const layout = stackedLayout(panels, narrow() ? 620 : 640);
  layout.shapes = [["y2", found.position_limit], ["y3", found.heading_limit]].map(([yref, y]) => ({
    type: "line", xref: "paper", yref, x0: 0, x1: 1, y0: y, y1: y, line: { color: report.ink, width: 1, dash: "dot" },
  }));
  if (narrow()) layout.annotations.forEach((one) => { one.text = one.text.replace(/[;(,].*/, ""); });
  Plotly.newPlot(box, traces, layout, config);
  return box;
}

function drawTraffic(run, number) {
  const box = at("traffic", number), names = Object.keys(run.traffic);
  if (!box) return;
  const bar = (key, name, color, shape) => ({
    type: "bar", name, x: names, y: names.map((one) => run.traffic[one][key]),
    marker: { color, pattern: { shape } }, hovertemplate: `%{x}: %{y} bytes ${name}<extra></extra>`,
  });
  Plotly.newPlot(box, [bar("bytes_sent", "sent", report.colours[0], ""), bar("bytes_heard", "heard", report.colours[4], "/")],
    layoutWith({ height: 320, barmode: "group", xaxis: { type: "category" }, yaxis: { title: { text: "bytes" }, ...grid } }), config);
}

function drawComparison() {
  const box = document.getElementById("comparison");
  if (!box) return;
  const traces = report.runs.filter((run) => run.team_error).map((run, k) => ({
    mode: "lines", name: run.name, x: decode(run.team_error.time), y: decode(run.team_error.value),
    line: { color: report.colours[k % report.colours.length], dash: ["solid", "dash", "dot"][Math.floor(k / report.colours.length) % 3], width: 1.6 },
    hovertemplate: `${run.name}<br>%{x:.1f} s: %{y:.3f} m<extra></extra>`,
  }));
  const panel = { title: "Position error of the team (root mean square)", unit: "m", axis: { rangemode: "tozero" } };
  Plotly.newPlot(box, traces, stackedLayout([panel], 380), config);
}
