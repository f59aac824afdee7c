// The live charts: one time axis, one cursor. Without this script the page shows the same as pictures.
(() => {
  "use strict";
  const data = JSON.parse(document.getElementById("series").textContent);
  const charts = [];
  let view = [data.start, data.start + data.end];
  let following = false;

  const colour = (name) => getComputedStyle(document.documentElement).getPropertyValue("--" + name).trim();
  const locale = document.documentElement.lang === "en" ? "en-GB" : document.documentElement.lang;
  const clock = new Intl.DateTimeFormat(locale, { timeZone: data.zone, hour: "2-digit", minute: "2-digit" });
  const day = new Intl.DateTimeFormat(locale, { timeZone: data.zone, weekday: "short", day: "numeric", month: "short" });
  const full = new Intl.DateTimeFormat(locale, {
    timeZone: data.zone, weekday: "short", day: "numeric", month: "short", hour: "2-digit", minute: "2-digit", timeZoneName: "short",
  });
  const hours = (s) => `${Math.floor(Math.round(s / 60) / 60)}:${String(Math.round(s / 60) % 60).padStart(2, "0")} h`;
  const onClock = (s) => { const at = new Date(s * 1e3), time = clock.format(at); return time === "00:00" ? day.format(at) : time; };
  const moment = data.dated ? onClock : hours;
  const inFull = data.dated ? (s) => full.format(new Date(s * 1e3)) : hours;

  // Every chart shows the same stretch of time.
  const show = (begin, end) => {
    const least = 600, whole = [data.start, data.start + data.end];
    const length = Math.min(Math.max(end - begin, least), data.end);
    const from = Math.min(Math.max(begin, whole[0]), whole[1] - length);
    view = [from, from + length];
    following = true;
    charts.forEach((u) => u.setScale("x", { min: view[0], max: view[1] }));
    following = false;
  };
  const follow = (u, key) => {
    const { min, max } = u.scales.x;
    if (key === "x" && !following && min != null && (min !== view[0] || max !== view[1])) queueMicrotask(() => show(min, max));
  };

  // Each line of a chart has its own instants: the cursor reads the nearest value of each.
  const nearest = (u, s, i) => {
    const y = u.data[s];
    if (s === 0 || y[i] != null) return i;
    for (let d = 1; d < y.length; d++) {
      if (y[i - d] != null) return i - d;
      if (y[i + d] != null) return i + d;
    }
    return i;
  };

  // Behind the lines: phases, shifts, model updates.
  const behind = (u) => {
    const { ctx, bbox } = u, at = (s) => u.valToPos(data.start + s, "x", true);
    ctx.save();
    ctx.beginPath(); ctx.rect(bbox.left, bbox.top, bbox.width, bbox.height); ctx.clip();
    for (const [begin, end, phase] of data.spans) {
      ctx.fillStyle = colour(phase);
      ctx.fillRect(at(begin), bbox.top, at(end) - at(begin), bbox.height);
    }
    const stroke = (times, ink, dash) => {
      ctx.strokeStyle = colour(ink); ctx.setLineDash(dash); ctx.lineWidth = devicePixelRatio;
      for (const s of times) { ctx.beginPath(); ctx.moveTo(at(s), bbox.top); ctx.lineTo(at(s), bbox.top + bbox.height); ctx.stroke(); }
    };
    stroke(data.shifts, "soft", [2, 4]);
    stroke(data.updates, "update", [6, 4]);
    ctx.restore();
  };

  // Fingers on a chart: two stretch the time, one moves it; up and down the page scrolls (touch-action in page.css).
  const LEAST_APART = 20;
  const fingers = new Map();
  let held = null, frame = null;
  // What lies under the fingers stays under them.
  const hold = (u) => {
    const left = u.over.getBoundingClientRect().left, width = u.over.clientWidth;
    const times = [...fingers.values()].map((x) => u.posToVal(x - left, "x"));
    held = fingers.size ? { u, left, width, times, perPixel: (view[1] - view[0]) / width } : null;
  };
  const moved = () => {
    frame = null;
    if (!held) return;
    const [x, other] = [...fingers.values()].map((at) => at - held.left), [time, second] = held.times;
    const apart = Math.abs(other - x);  // NaN with one finger
    const perPixel = apart >= LEAST_APART ? Math.abs(second - time) / apart : held.perPixel;
    show(time - x * perPixel, time + (held.width - x) * perPixel);
  };
  const feel = (u) => {
    u.over.addEventListener("pointerdown", (event) => {
      if (event.pointerType !== "touch" || fingers.size > 1 || (held && held.u !== u)) return;
      fingers.set(event.pointerId, event.clientX);
      hold(u);
    });
    u.over.addEventListener("pointermove", (event) => {
      if (!fingers.has(event.pointerId)) return;
      fingers.set(event.pointerId, event.clientX);
      frame ??= requestAnimationFrame(moved);
    });
    const lift = (event) => { if (fingers.delete(event.pointerId)) hold(u); };
    u.over.addEventListener("pointerup", lift);
    u.over.addEventListener("pointercancel", lift);
  };

  // The axes' numbers as text, which can be selected, enlarged and read aloud.
  const numbers = (u) => {
    let box = u.root.querySelector(".numbers");
    if (!box) { box = document.createElement("div"); box.className = "numbers"; u.over.parentNode.append(box); }
    const left = u.over.offsetLeft, top = u.over.offsetTop, height = u.over.offsetHeight;
    const of = (scale, place, text) => (u.marks[scale] || []).map((v) => {
      const span = document.createElement("span"), pos = u.valToPos(v, scale);
      span.textContent = text(v);
      span.className = scale;
      Object.assign(span.style, place(pos));
      return span;
    });
    box.replaceChildren(
      ...of("x", (p) => ({ left: left + p + "px", top: top + height + 6 + "px" }), moment),
      ...of("y", (p) => ({ right: `calc(100% - ${left - 6}px)`, top: top + p + "px" }), (v) => String(+v.toFixed(6)).replace("-", "−")),
    );
  };
  const marked = (scale) => (v) => v != null && (scale !== "x" || v % 60 === 0); // times are written without seconds
  const marks = (scale) => (u, values) => { (u.marks ??= {})[scale] = values.filter(marked(scale)); return values.map(() => ""); };

  const line = ({ label, ink, kind }, unit) => ({
    label, stroke: colour(ink), width: 1.4,
    paths: kind === "dots" ? () => null : kind === "step" ? uPlot.paths.stepped({ align: 1 }) : undefined,
    points: { show: kind === "dots", size: 4, fill: colour(ink) },
    value: (_, v) => (v == null ? "–" : v.toFixed(1).replace("-", "−") + " " + unit),
  });

  const draw = (place, chart) => {
    const width = place.clientWidth, tables = chart.lines.map(({ x, y }) => [x.map((s) => s + data.start), y]);
    const axis = { stroke: colour("ink"), grid: { stroke: colour("line"), width: 1 }, ticks: { stroke: colour("line"), width: 1, size: 4 } };
    const options = {
      width, height: chart.low ? 130 : 210,
      tzDate: (s) => uPlot.tzDate(new Date(s * 1e3), data.zone),
      scales: { x: { min: view[0], max: view[1] } },
      axes: [
        { ...axis, size: 28, space: 64, values: marks("x") },
        { ...axis, size: 48, space: 28, values: marks("y") },
      ],
      series: [{ label: "time", value: (_, v) => (v == null ? "–" : inFull(v)) }, ...chart.lines.map((l) => line(l, chart.unit))],
      cursor: { sync: { key: "report", scales: ["x", null] }, dataIdx: nearest, drag: { x: true, y: false } },
      hooks: { setScale: [follow], drawClear: [behind], draw: [numbers] },
    };
    const heading = document.createElement("p");
    heading.className = "axis";
    heading.textContent = chart.unit ? `${chart.title}, ${chart.unit}` : chart.title;
    place.append(heading);
    const u = new uPlot(options, uPlot.join(tables), place);
    feel(u);
    charts.push(u);
  };

  const drawAll = () => {
    charts.splice(0).forEach((u) => u.destroy());
    fingers.clear();
    held = null;
    document.querySelectorAll(".live").forEach((place) => {
      place.replaceChildren();
      data.groups[place.dataset.group].forEach((chart) => draw(place, chart));
    });
    show(...view);
  };

  const moves = {
    earlier: (a, b) => [a - (b - a) / 2, b - (b - a) / 2],
    later: (a, b) => [a + (b - a) / 2, b + (b - a) / 2],
    closer: (a, b) => [a + (b - a) / 4, b - (b - a) / 4],
    wider: (a, b) => [a - (b - a) / 2, b + (b - a) / 2],
    all: () => [data.start, data.start + data.end],
  };
  document.querySelectorAll("#time button").forEach((button) => button.addEventListener("click", () => show(...moves[button.name](...view))));
  document.documentElement.classList.add("script");
  drawAll();
  let width = innerWidth;
  addEventListener("resize", () => { if (innerWidth !== width) { width = innerWidth; drawAll(); } });
  matchMedia("(prefers-color-scheme: dark)").addEventListener("change", drawAll);
})();
