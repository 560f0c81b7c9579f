"use strict";
// Slider, playing, choice of robots: what the reader does.
const PLAY_SECONDS = 40; // a whole log, at most

function control(run, number) {
  const map = drawMap(run, number), panels = drawPanels(run, number);
  const slider = at("slider", number), now = at("now", number), play = at("play", number);
  const robot = at("robot", number), last = map.time.length - 1;
  const boxes = [panels, drawPairs(run, number), drawWindows(run, number)].filter(Boolean);
  drawTraffic(run, number);
  for (const name of run.robots) robot.add(new Option(name, name));
  const whole = at("whole", number);
  whole.checked = !crowded(run);
  slider.max = last;
  let waiting = false, timer = null;

  function cursor() {
    if (!panels) return;
    const x = map.time[slider.value];
    Plotly.relayout(panels, { shapes: [{
      type: "line", xref: "x", yref: "paper", x0: x, x1: x, y0: 0, y1: 1,
      line: { color: report.ink, width: 1 },
    }] });
  }

  function show() {
    const text = `${map.time[slider.value].toFixed(1)} s`;
    now.textContent = text;
    slider.setAttribute("aria-valuetext", text);
    if (waiting) return;
    waiting = true;
    requestAnimationFrame(() => {
      waiting = false;
      map.show(Number(slider.value));
    });
  }

  function stop() {
    if (timer === null) return;
    cancelAnimationFrame(timer);
    timer = null;
    play.textContent = "Play";
    play.setAttribute("aria-pressed", "false");
    cursor();
  }

  function start() {
    const seconds = Math.min(PLAY_SECONDS, Math.max(run.seconds, 1));
    const from = Number(slider.value) >= last ? 0 : Number(slider.value);
    const begin = performance.now();
    play.textContent = "Pause";
    play.setAttribute("aria-pressed", "true");
    const tick = (time) => {
      const k = Math.min(last, Math.round(from + (last * (time - begin)) / 1000 / seconds));
      slider.value = Math.max(0, k);
      show();
      if (k >= last) stop();
      else timer = requestAnimationFrame(tick);
    };
    timer = requestAnimationFrame(tick);
  }

  slider.addEventListener("input", () => { stop(); show(); });
  slider.addEventListener("change", cursor);
  play.addEventListener("click", () => (timer === null ? start() : stop()));
  whole.addEventListener("change", () => map.choose(robot.value, whole.checked));
  robot.addEventListener("change", () => {
    map.choose(robot.value, whole.checked);
    if (!panels) return;
    const visible = panels.data.map((one) => robot.value === "" || one.meta.robot === robot.value);
    Plotly.restyle(panels, { visible }, panels.data.map((_, k) => k));
  });
  for (const box of boxes) {
    box.on("plotly_click", (event) => {
      if (event.points[0].xaxis._name !== "xaxis") return;
      const wanted = event.points[0].x;
      stop();
      slider.value = map.time.findLastIndex((one) => one <= wanted);
      show();
      cursor();
    });
  }
  slider.value = last; // The whole way is seen, also in print.
  show();
  cursor();
}

drawComparison();
report.runs.forEach(control);
document.body.dataset.ready = "true";
