"use strict";
// The map: whole paths, and on top of them what the time slider moves.
const ELLIPSE_POINTS = 40;
const TRAIL_SECONDS = 20;
const MAX_DASHED = 5; // The truth of more robots is solid: many dashes are slow to draw.
const CROWDED = 900; // Robots times seconds: beyond, whole paths hide each other and are off at first.
const crowded = (run) => run.robots.length * run.seconds > CROWDED;
const LINKS = [
  { status: 1, name: "range used", color: "#009E73", dash: "solid", width: 1.2 },
  { status: 2, name: "range rejected", color: "#B00020", dash: "dot", width: 2 },
  { status: 3, name: "range", color: "#767676", dash: "solid", width: 1 },
];

function ellipse(x, y, xx, xy, yy) {
  const mean = (xx + yy) / 2, spread = Math.hypot((xx - yy) / 2, xy);
  const a = 3 * Math.sqrt(Math.max(mean + spread, 0));
  const b = 3 * Math.sqrt(Math.max(mean - spread, 0));
  const turn = Math.atan2(2 * xy, xx - yy) / 2, c = Math.cos(turn), s = Math.sin(turn);
  const xs = [], ys = [];
  for (let k = 0; k <= ELLIPSE_POINTS; k++) {
    const angle = (2 * Math.PI * k) / ELLIPSE_POINTS;
    const u = a * Math.cos(angle), v = b * Math.sin(angle);
    xs.push(x + c * u - s * v);
    ys.push(y + s * u + c * v);
  }
  return [xs, ys];
}

// The least and the largest coordinates of all that is drawn, with some room around.
function extent(map, key) {
  let low = map.ego ? 0 : Infinity, high = map.ego ? 0 : -Infinity;
  const take = (value) => {
    if (value < low) low = value;
    if (value > high) high = value;
  };
  for (const kind of ["estimate", "truth"]) {
    for (const one of Object.values(map.paths[kind])) decode(one[key]).forEach(take);
  }
  for (const one of Object.values(map.static)) take(one[key]);
  if (!(high >= low)) return [-1, 1];
  const room = Math.max(0.08 * (high - low), 0.5);
  return [low - room, high + room];
}

function drawMap(run, number) {
  const map = run.map, box = at("map", number);
  const time = decode(map.time), status = decode(map.status);
  const moving = {}, truth = {};
  for (const [name, one] of Object.entries(map.robots)) moving[name] = decodeAll(one);
  for (const [name, one] of Object.entries(map.truth)) truth[name] = decodeAll(one);
  const names = Object.keys(moving), trailSteps = Math.max(2, Math.round(TRAIL_SECONDS / map.step));
  const what = map.estimated ? "estimate" : "odometry alone";
  const traces = pathTraces(run, what), fixed = traces.length;

  function place(robot, k) {
    if (robot === map.ego) return [0, 0];
    if (moving[robot]) return [moving[robot].x[k], moving[robot].y[k]];
    if (map.static[robot]) return [map.static[robot].x, map.static[robot].y];
    return truth[robot] ? [truth[robot].x[k], truth[robot].y[k]] : [NaN, NaN];
  }

  function links(wanted, k) {
    const xs = [], ys = [];
    map.pairs.forEach(([a, b], column) => {
      if (status[k * map.pairs.length + column] !== wanted) return;
      const [ax, ay] = place(a, k), [bx, by] = place(b, k);
      if (Number.isFinite(ax + ay + bx + by)) {
        xs.push(ax, bx, null);
        ys.push(ay, by, null);
      }
    });
    return xs.length > 0 ? [xs, ys] : [[null], [null]];
  }

  // What moves, in the order of the traces behind the fixed ones.
  function step(k) {
    const xs = [], ys = [];
    for (const link of LINKS) {
      const [x, y] = links(link.status, k);
      xs.push(x);
      ys.push(y);
    }
    for (const name of names) {
      const from = Math.max(0, k - trailSteps), one = moving[name];
      xs.push(Array.from(one.x.slice(from, k + 1)));
      ys.push(Array.from(one.y.slice(from, k + 1)));
      const shape = one.xx ? ellipse(one.x[k], one.y[k], one.xx[k], one.xy[k], one.yy[k]) : [[], []];
      xs.push(shape[0]);
      ys.push(shape[1]);
    }
    for (const one of Object.values(truth)) {
      const from = Math.max(0, k - trailSteps);
      xs.push(Array.from(one.x.slice(from, k + 1)));
      ys.push(Array.from(one.y.slice(from, k + 1)));
    }
    xs.push(Object.values(truth).map((one) => one.x[k]));
    ys.push(Object.values(truth).map((one) => one.y[k]));
    xs.push(names.map((name) => moving[name].x[k]));
    ys.push(names.map((name) => moving[name].y[k]));
    return [xs, ys];
  }

  for (const link of LINKS) {
    traces.push({
      mode: "lines", name: link.name, x: [], y: [], hoverinfo: "skip",
      line: { color: link.color, dash: link.dash, width: link.width },
      showlegend: map.estimated ? link.status < 3 : link.status === 3, legendrank: 1100,
    });
  }
  for (const name of names) {
    const look = lookOf(run, name), group = { legendgroup: name, showlegend: false };
    traces.push({
      mode: "lines", x: [], y: [], line: { color: look.color, width: 5 }, opacity: 0.45,
      hoverinfo: "skip", meta: { robot: name }, ...group,
    });
    traces.push({
      mode: "lines", x: [], y: [], fill: "toself", fillcolor: `${look.color}33`,
      line: { color: look.color, width: 1.5 }, hoverinfo: "skip", meta: { robot: name }, ...group,
    });
  }
  for (const name of Object.keys(truth)) {
    traces.push({
      mode: "lines", x: [], y: [], line: { color: report.ink, width: 1.5, dash: "dash" },
      hoverinfo: "skip", showlegend: false, meta: { robot: name },
    });
  }
  traces.push({
    mode: "markers", name: "true position now", x: [], y: [], hoverinfo: "skip", legendrank: 1050,
    marker: { symbol: "x-thin", size: 9, line: { color: report.ink, width: 2 } },
    showlegend: Object.keys(truth).length > 0, text: Object.keys(truth),
  });
  traces.push({
    mode: names.length <= 16 ? "markers+text" : "markers", x: [], y: [], text: names,
    textposition: "top center", showlegend: false, name: "robots",
    hovertemplate: "%{text}<br>x %{x:.3f} m, y %{y:.3f} m<extra></extra>",
    textfont: { size: 13, color: report.ink },
    marker: {
      size: 14, color: names.map((name) => lookOf(run, name).color), opacity: 1,
      line: { color: "#fff", width: 1.5 }, symbol: names.map((n) => symbolOf(moving[n], 0)),
    },
  });
  const dynamic = traces.map((_, k) => k).slice(fixed);
  const [xs, ys] = step(time.length - 1);
  dynamic.forEach((trace, i) => Object.assign(traces[trace], { x: xs[i], y: ys[i] }));
  Plotly.newPlot(box, traces, layoutWith({
    height: narrow() ? 460 : 620,
    title: { text: map.title, font: { size: 14 }, x: 0, xanchor: "left" },
    xaxis: { title: { text: "x in m" }, range: extent(map, "x"), ...grid },
    yaxis: { title: { text: "y in m" }, range: extent(map, "y"), scaleanchor: "x", ...grid },
    legend: { orientation: "h", y: narrow() ? -0.3 : -0.14, yanchor: "top", x: 0 },
  }), { ...config, scrollZoom: true });

  // Without redraw: only the traces that move are drawn again.
  const immediate = { mode: "immediate", frame: { duration: 0, redraw: false }, transition: { duration: 0 } };

  function show(k) {
    const [xs, ys] = step(k), data = dynamic.map((_, i) => ({ x: xs[i], y: ys[i] }));
    data[data.length - 1].marker = {
      angle: names.map((n) => markerAngle(moving[n].heading[k])),
      symbol: names.map((n) => symbolOf(moving[n], k)),
    };
    Plotly.animate(box, { data, traces: dynamic }, immediate);
  }

  // Of one robot or all ("") what moves, and the whole paths where these are wanted.
  function choose(robot, whole) {
    const visible = box.data.map(({ meta }) => {
      if (!meta?.robot) return true;
      if (robot !== "" && meta.robot !== robot) return false;
      return meta.path && !whole ? "legendonly" : true;
    });
    Plotly.restyle(box, { visible }, box.data.map((_, k) => k));
  }
  return { time, show, choose };
}

// plotly.js turns markers clockwise from upright; headings are counter-clockwise from +x.
const markerAngle = (heading) => (Number.isFinite(heading) ? 90 - (heading * 180) / Math.PI : 0);
const symbolOf = (one, k) => (Number.isFinite(one.heading[k]) ? "arrow" : "circle");

function pathTraces(run, what) {
  const map = run.map, traces = [];
  const looks = {
    "dead reckoning": { width: THIN, dash: "solid", color: report.grey },
    truth: { width: THIN, dash: run.robots.length > MAX_DASHED ? "solid" : "dash", color: report.ink },
  };
  for (const kind of ["dead reckoning", "estimate", "truth"]) {
    let first = true;
    for (const [robot, one] of Object.entries(map.paths[kind])) {
      const look = looks[kind] || { ...lookOf(run, robot), width: THIN };
      const whole = kind === "estimate";
      traces.push({
        mode: "lines", x: decode(one.x), y: decode(one.y), connectgaps: false, line: look,
        name: whole ? `${robot} (${what})` : kind, legendgroup: whole ? robot : kind,
        showlegend: whole || first, meta: { robot, path: true }, legendrank: whole ? 1000 : 1040,
        visible: crowded(run) ? "legendonly" : true,
        hovertemplate: `${robot}, ${whole ? what : kind}<br>x %{x:.3f} m, y %{y:.3f} m<extra></extra>`,
      });
      first = false;
    }
  }
  const still = Object.entries(map.static);
  if (still.length > 0) {
    traces.push({
      mode: "markers+text", name: "static robot", legendrank: 1060, text: still.map(([name]) => name),
      x: still.map(([, one]) => one.x), y: still.map(([, one]) => one.y),
      textposition: "bottom center",
      marker: { size: 11, color: report.ink, symbol: still.map(([, one]) => (one.known ? "square" : "square-open")) },
      hovertemplate: "%{text}<br>x %{x:.3f} m, y %{y:.3f} m<extra></extra>",
    });
  }
  if (map.ego) {
    traces.push({
      mode: "markers+text", name: map.ego, x: [0], y: [0], text: [map.ego], showlegend: false,
      textposition: "bottom center", marker: { size: 13, symbol: "triangle-right", color: report.ink },
      hovertemplate: `${map.ego}<extra></extra>`,
    });
  }
  return traces;
}
