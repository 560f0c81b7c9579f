"use strict";
// Numbers of the page: arrays are base64 of little-endian numbers, as plotly.js takes them.
const report = JSON.parse(document.getElementById("data").textContent);
const kinds = { f4: Float32Array, f8: Float64Array, u1: Uint8Array };

function decode(packed) {
  const text = atob(packed.bdata);
  const bytes = new Uint8Array(text.length);
  for (let i = 0; i < text.length; i++) bytes[i] = text.charCodeAt(i);
  return new kinds[packed.dtype](bytes.buffer);
}

function decodeAll(table) {
  return Object.fromEntries(Object.entries(table).map(([name, one]) => [name, decode(one)]));
}

// Lines of many points are one pixel wide: browsers draw wider ones several times slower.
const THIN = 1;

const at = (name, run) => document.getElementById(`${name}-${run}`);
const narrow = () => window.innerWidth < 600;

// Colours repeat after six robots; the dash does not, so that no line depends on colour alone.
function lookOf(run, robot) {
  const index = Math.max(0, run.robots.indexOf(robot));
  const round = Math.floor(index / report.colours.length);
  return {
    color: report.colours[index % report.colours.length],
    dash: ["solid", "dashdot", "longdash"][round % 3],
  };
}

const font = { family: "system-ui, sans-serif", size: 13, color: report.ink };
const grid = { gridcolor: "#e4e4e4", zerolinecolor: "#c8c8c8", linecolor: report.grey };

function layoutWith(extra) {
  const base = {
    font, paper_bgcolor: "#fff", plot_bgcolor: "#fff", hovermode: "closest",
    margin: { l: narrow() ? 44 : 60, r: 12, t: 30, b: 46 },
    legend: { orientation: "h", y: narrow() ? -0.2 : -0.14, yanchor: "top", x: 0 },
    dragmode: "pan",
  };
  return Object.assign(base, extra);
}

// plotly.js offers by default to upload a chart: nothing of a report may leave it.
const config = {
  responsive: true, displaylogo: false, scrollZoom: false, showSendToCloud: false, plotlyServerURL: "",
  displayModeBar: !narrow(), modeBarButtonsToRemove: ["select2d", "lasso2d", "autoScale2d"],
};

function titleAt(text, y) {
  return {
    text, xref: "paper", yref: "paper", x: 0, y, xanchor: "left", yanchor: "bottom",
    showarrow: false, font: { size: 13, weight: 600 },
  };
}
