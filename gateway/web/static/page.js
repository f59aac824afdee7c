// Shows what the server sends: sentences of the catalogue, numbers and times as the browser's locale writes them. Texts
// of others become text nodes, never markup.
(() => {
  "use strict";
  const $ = (id) => document.getElementById(id);
  const texts = JSON.parse($("texts").textContent);
  const machine = document.body.dataset.machine;
  const SILENT_MS = 7000;

  const has = (key) => Object.hasOwn(texts, key);
  const word = (key) => has(key) ? texts[key] : key.replace(/^[a-z]+\./, "").replaceAll("_", " ");
  const clock = new Intl.DateTimeFormat(undefined, { hour: "2-digit", minute: "2-digit" });
  const day = new Intl.DateTimeFormat(undefined, { weekday: "short", day: "numeric", month: "short", hour: "2-digit", minute: "2-digit" });
  const exact = new Intl.DateTimeFormat(undefined, { hour: "2-digit", minute: "2-digit", second: "2-digit" });
  const time = (iso) => {
    const at = new Date(iso);
    if (Number.isNaN(at.getTime())) return "–";
    return (at.toDateString() === new Date().toDateString() ? clock : day).format(at);
  };
  const numbers = new Map();
  const amount = ({ n, u, d, sign }) => {
    if (n === null || n === undefined) return "–";
    const key = d + (sign ? "+" : "");
    if (!numbers.has(key)) numbers.set(key, new Intl.NumberFormat(undefined, {
      minimumFractionDigits: d, maximumFractionDigits: d, signDisplay: sign ? "exceptZero" : "auto" }));
    return numbers.get(key).format(n).replace("-", "\u2212") + (u ? "\u202f" + u : "");
  };
  const atom = (a) => {
    if (a === undefined) return "–";
    if ("w" in a) return word(a.w);
    if ("s" in a) return a.s;
    if ("t" in a) return time(a.t);
    return amount(a);
  };
  const sentence = ({ say, values }) => word(say).replace(/\{(\w+)\}/g, (_, name) => atom(values[name]));

  const make = (tag, text, kind) => {
    const found = document.createElement(tag);
    if (text !== undefined) found.textContent = text;
    if (kind) found.className = kind;
    return found;
  };
  const put = (place, text) => { if (place.textContent !== text) place.textContent = text; };
  // A part is drawn again only when it has changed, so that nothing jumps and what is selected stays selected.
  const drawn = new Map();
  const draw = (id, data, nodes) => {
    const text = JSON.stringify(data);
    if (drawn.get(id) === text) return;
    drawn.set(id, text);
    $(id).replaceChildren(...nodes());
  };
  const marked = (mark) => mark ? make("span", word("mark." + mark), "mark m-" + mark) : "";

  const colours = ["red", "grey", "amber", "green"];
  const paint = (place, colour) => { if (!place.classList.contains(colour)) { place.classList.remove(...colours); place.classList.add(colour); } };
  const say = (list, kind) => list.map((each) => make("p", sentence(each), kind));

  // The choice of this browser, kept by machine.
  const kept = () => { try { return JSON.parse(localStorage.getItem("asked " + machine)) || {}; } catch { return {}; } };
  const query = () => {
    const found = new URLSearchParams();
    for (const [name, value] of Object.entries(kept())) if (value !== "") found.set(name, value);
    return found.toString();
  };

  let latest = null, heardMs = performance.now(), lost = false;
  const loseOrFind = (gone) => {
    if (gone === lost) return;
    lost = gone;
    document.body.classList.toggle("past", lost || (latest !== null && latest.alive === false));
    $("lost").hidden = !lost;
    if (lost) {
      $("lost").textContent = word("page.no_server").replace("{at}", latest ? time(latest.shownAt) : "–");
      if (machine) { paint($("ready"), "grey"); put($("word"), word("word.lost")); }
    }
  };

  const showMachine = (v) => {
    latest = { ...v, shownAt: new Date().toISOString() };
    const { verdict } = v;
    document.body.classList.toggle("past", !v.alive);
    paint($("ready"), verdict.colour);
    put($("word"), word(verdict.word));
    document.title = `${word(verdict.word)} · ${v.machine}`;
    const heard = [];
    if (v.heard) heard.push(word("page.heard").replace("{at}", exact.format(new Date(v.heard))));
    if (v.simulated && v.gateway_time) heard.push(word("page.simulated").replace("{at}", time(v.gateway_time)));
    put($("heard"), heard.join(" · "));
    draw("notices", v.notices, () => say(v.notices, "notice"));
    draw("because", verdict.because, () => say(verdict.because));
    put($("since"), verdict.since ? word("since.at").replace("{at}", time(verdict.since)) : "");
    draw("helps", verdict.helps, () => say(verdict.helps));
    showAxes(v.axes);
    draw("tool-notes", v.tool_notes, () => say(v.tool_notes, "note"));
    draw("waits", v.waits, () => rows(v.waits));
    draw("health", v.health, () => rows(v.health));
    showHeat(v);
  };

  const rows = (list) => list.map((row) => {
    const each = make("div"), value = make("dd", sentence(row.said));
    value.prepend(marked(row.mark), row.mark ? " " : "");
    each.append(make("dt", word(row.label)), value);
    return each;
  });

  const showAxes = (axes) => {
    $("tool-empty").hidden = axes.length > 0;
    for (const place of document.querySelectorAll("#axes article")) {
      const axis = axes.find((each) => each.axis === place.dataset.axis);
      for (const cell of place.querySelectorAll("[data-of]")) put(cell, axis ? amount(axis[cell.dataset.of]) : "–");
    }
  };

  const showHeat = (v) => {
    draw("doubts", v.doubts, () => v.doubts.length
      ? v.doubts.map((each) => { const p = make("p", sentence(each), "doubt"); p.prepend(marked("bad"), " "); return p; })
      : v.channels.length ? [make("p", word("doubt.none"), "note")] : []);
    $("heat-empty").hidden = v.channels.length > 0;
    draw("channels", v.channels, () => v.channels.map((c) => {
      const item = make("li", undefined, c.good ? "" : "not-good");
      item.append(make("span", c.channel, "name"), " ", make("span", c.value ? amount(c.value) : "–", "number"));
      if (!c.good) item.append(" ", make("span", word(c.quality), "mark m-bad"));
      if (c.detail) item.title = c.detail;
      return item;
    }));
    showSketch(v.channels.filter((c) => c.body));
    $("drives-empty").hidden = v.driven.length > 0;
    $("drives").hidden = !v.driven.length;
    const body = $("drives").tBodies[0];
    const text = JSON.stringify(v.driven);
    if (drawn.get("drives") === text) return;
    drawn.set("drives", text);
    body.replaceChildren(...v.driven.map((e) => {
      const row = make("tr"), name = make("th", e.error);
      name.scope = "row";
      const by = e.corrected ? e.movers.map(([input, by]) => `${input} ${amount(by)}`).join(", ") : word("heat.not_corrected");
      row.append(name, make("td", amount(e.estimate), "right"), make("td", by));
      return row;
    }));
  };

  // The mean of each part; nothing where no name tells of one.
  const showSketch = (channels) => {
    const sketch = $("sketch");
    sketch.toggleAttribute("hidden", !channels.length);
    for (const part of sketch.querySelectorAll("[data-body]")) {
      const own = channels.filter((c) => c.body === part.dataset.body && (!c.value || c.value.u === "°C"));
      const good = own.filter((c) => c.good && c.value);
      const mean = good.length ? good.reduce((sum, c) => sum + c.value.n, 0) / good.length : null;
      put(part.querySelector(".number"), amount({ n: mean, u: "°C", d: 1 }) + (good.length < own.length ? " !" : ""));
      part.classList.toggle("doubtful", good.length < own.length);
      part.classList.toggle("nothing", !own.length);
    }
  };

  let events = [];
  const showEvents = () => {
    const kind = $("event-kind").value, part = $("event-text").value.toLowerCase();
    const shown = events.filter((e) => (!kind || (kind === "notable" ? e.mark : e.kind === kind))
      && (!part || (e.text + " " + word(e.kind)).toLowerCase().includes(part)));
    $("events").hidden = !shown.length;
    $("events-empty").hidden = shown.length > 0;
    put($("events-empty"), word(events.length ? "events.no_match" : "events.none"));
    $("events").tBodies[0].replaceChildren(...shown.map((e) => {
      const row = make("tr"), kindCell = make("td", word(e.kind));
      if (e.mark) kindCell.className = "kind m-" + e.mark;
      row.append(make("td", time(e.t), "when"), kindCell, make("td", e.text));
      return row;
    }));
  };
  const takeEvents = (list) => {
    events = list;
    const chooser = $("event-kind"), there = new Set([...chooser.options].map((o) => o.value));
    for (const kind of new Set(list.map((e) => e.kind))) if (!there.has(kind)) {
      const option = make("option", word(kind));
      option.value = kind;
      chooser.append(option);
    }
    showEvents();
  };

  // The charts: one time axis, one cursor; drag to zoom, double click to see all.
  const ink = (name) => getComputedStyle(document.documentElement).getPropertyValue("--" + name).trim();
  let charts = [], course = null, zoomed = false, following = false;
  const follow = (u, key) => {
    if (key !== "x" || following) return;
    const { min, max } = u.scales.x;
    following = true;
    zoomed = course !== null && course.t.length > 1 && (min > course.t[0] || max < course.t.at(-1));
    charts.forEach((other) => { if (other !== u) other.setScale("x", { min, max }); });
    following = false;
  };
  const columns = (i) => {
    const { t, without, left, half, measured_t, measured } = course;
    const edge = (sign) => without[i].map((v, j) => v === null || half[i][j] === null ? null : v + sign * half[i][j]);
    return uPlot.join([[t, without[i], edge(-1), edge(1), left[i]], [measured_t, measured[i]]]);
  };
  const chart = (place, i) => {
    const value = (_, v) => amount({ n: v, u: "µm", d: 1, sign: true });
    const axis = { stroke: ink("soft"), grid: { stroke: ink("line"), width: 1 }, ticks: { show: false }, font: "12px system-ui, sans-serif" };
    const line = (label, colour, more) => ({ label: word("chart." + label), stroke: ink(colour), width: 1.5, points: { show: false }, value, spanGaps: true, ...more });
    return new uPlot({
      width: place.clientWidth, height: 150,
      axes: [{ ...axis, size: 26, space: 70, values: (_, all) => all.map((v) => clock.format(new Date(v * 1e3))) },
        { ...axis, size: 40, space: 30, values: (_, all) => all.map((v) => amount({ n: v, d: 0 })) }],
      scales: { y: { range: (_, min, max) => { const pad = Math.max((max - min) * 0.1, 1); return [min - pad, max + pad]; } } },
      series: [{ label: word("chart.time"), value: (_, v) => v === null ? "–" : time(v * 1e3) },
        line("without", "before"), line("low", "band", { width: 0 }), line("high", "band", { width: 0 }),
        line("left", "after", { dash: [6, 3], width: 2 }),
        line("measured", "measured", { paths: () => null, points: { show: true, size: 6, fill: ink("measured") } })],
      bands: [{ series: [3, 2], fill: ink("band") }],
      legend: { show: false },
      cursor: { sync: { key: "tool" }, drag: { x: true, y: false } },
      hooks: { setScale: [follow], setCursor: [(u) => tell(u, i)] },
    }, columns(i), place);
  };
  const tell = (u, i) => {
    const at = u.cursor.idx, place = u.root.parentNode;
    let note = place.querySelector(".reading");
    if (!note) { note = make("p", undefined, "reading"); place.append(note); }
    if (at === null || at === undefined) { put(note, "\u00a0"); return; }
    const value = (s) => amount({ n: u.data[s][at], u: "µm", d: 1, sign: true });
    put(note, `${time(u.data[0][at] * 1e3)}: ${word("chart.without")} ${value(1)}, ${word("chart.left")} ${value(4)}`);
  };
  const drawCharts = () => {
    charts.forEach((u) => u.destroy());
    charts = [];
    if (!course || !course.t.length) return;
    document.querySelectorAll("#axes .chart").forEach((place, i) => { place.replaceChildren(); charts.push(chart(place, i)); });
    charts.forEach(tell);
  };
  const showCourse = (c) => {
    const first = !charts.length;
    course = c;
    put($("chart-note"), c.said ? sentence(c.said) : "");
    if (first) drawCharts(); else charts.forEach((u, i) => u.setData(columns(i), !zoomed));
  };

  const showList = (list) => {
    latest = { alive: true, shownAt: new Date().toISOString() };
    $("no-machine").hidden = list.length > 0;
    const language = document.documentElement.lang;
    draw("machines", list, () => list.map((m) => {
      const item = make("li", undefined, m.colour), link = make("a");
      link.href = `/machine/${encodeURIComponent(m.machine)}?lang=${language}`;
      link.append(make("span", undefined, "sign"), make("span", m.machine, "name"), " ", make("span", word(m.word), "word"));
      link.firstChild.setAttribute("aria-hidden", "true");
      item.append(link, ...say(m.notices, "notice"), ...say(m.because),
        make("p", m.heard ? word("page.heard").replace("{at}", time(m.heard)) : "", "note"));
      return item;
    }));
  };

  let stream = null;
  const listen = () => {
    if (stream) stream.close();
    stream = new EventSource((machine ? "/stream/" + encodeURIComponent(machine) : "/stream") + "?" + (machine ? query() : ""));
    const on = (kind, show) => stream.addEventListener(kind, (event) => {
      heardMs = performance.now();
      loseOrFind(false);
      if (show) show(JSON.parse(event.data));
    });
    on("tick");
    on("list", showList);
    on("view", showMachine);
    on("events", takeEvents);
    on("course", showCourse);
    stream.onerror = () => {
      loseOrFind(true);
      if (stream.readyState === EventSource.CLOSED) setTimeout(listen, 3000);
    };
  };
  setInterval(() => { if (performance.now() - heardMs > SILENT_MS) loseOrFind(true); }, 1000);

  if (machine) {
    const form = $("asked"), inputs = [...form.querySelectorAll("input")];
    const fill = () => { const own = kept(); for (const i of inputs) i.value = own[i.name] ?? i.dataset.declared; };
    const keep = (own) => { localStorage.setItem("asked " + machine, JSON.stringify(own)); fill(); zoomed = false; listen(); };
    form.addEventListener("submit", (event) => {
      event.preventDefault();
      keep(Object.fromEntries(inputs.filter((i) => i.value !== i.dataset.declared).map((i) => [i.name, i.value])));
    });
    form.addEventListener("reset", (event) => { event.preventDefault(); keep({}); });
    fill();
    $("event-kind").addEventListener("change", showEvents);
    $("event-text").addEventListener("input", showEvents);
    let width = innerWidth;
    addEventListener("resize", () => { if (innerWidth !== width) { width = innerWidth; drawCharts(); } });
    matchMedia("(prefers-color-scheme: dark)").addEventListener("change", drawCharts);
  }
  listen();
})();
