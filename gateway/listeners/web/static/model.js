// The machine in perspective, from where its axes meet: coloured by its temperatures, and bent by its errors.
import { $, changed, drawn, put } from "./elements.js";
import { amount, word } from "./words.js";

// From the workpiece over the bed b to the tool, ' on the table's side. A gateway that does not tell has no other chain.
const CHAIN = "w-C'-A'-X'-b-Y-Z-S-t";
// The drawing's own units: the table's radius, and how far out on it the sphere stands.
const TABLE = 200, SPHERE = 0.92 * TABLE, SIDES = 32;
const TURN = 28 * Math.PI / 180, DOWN = 24 * Math.PI / 180, FAR = 5200;
const project = ([x, y, z]) => {
  const back = y * Math.cos(TURN) - x * Math.sin(TURN), near = 1 + (back * Math.cos(DOWN) - z * Math.sin(DOWN)) / FAR;
  return [(x * Math.cos(TURN) + y * Math.sin(TURN)) / near, -(z * Math.cos(DOWN) + back * Math.sin(DOWN)) / near];
};
const box = ([x0, x1], [y0, y1], [z0, z1]) => {
  const c = (i, j, k) => [i ? x1 : x0, j ? y1 : y0, k ? z1 : z0];
  return [[c(0, 0, 0), c(1, 0, 0), c(1, 0, 1), c(0, 0, 1)], [c(1, 0, 0), c(1, 1, 0), c(1, 1, 1), c(1, 0, 1)], [c(0, 0, 1), c(1, 0, 1), c(1, 1, 1), c(0, 1, 1)],
    [c(1, 1, 0), c(0, 1, 0), c(0, 1, 1), c(1, 1, 1)], [c(0, 1, 0), c(0, 0, 0), c(0, 0, 1), c(0, 1, 1)], [c(0, 1, 0), c(1, 1, 0), c(1, 0, 0), c(0, 0, 0)]];
};
const circle = ([x, y], r, z) => Array.from({ length: SIDES }, (_, i) => {
  const angle = 2 * Math.PI * i / SIDES;
  return [x + r * Math.cos(angle), y + r * Math.sin(angle), z];
});
const round = (at, below, low, above, high) => {
  const a = circle(at, below, low), b = circle(at, above, high);
  return [...a.map((p, i) => [p, a[(i + 1) % SIDES], b[(i + 1) % SIDES], b[i]]), b, [...a].reverse()];
};
// From the back to the front: part, what carries it, the axis without which it is not there (!: with which), its faces.
const PARTS = [
  ["bed", "", "", box([-390, 390], [-430, 430], [-420, -310])],
  ["column", "", "", box([-270, 270], [270, 430], [-310, 540])],
  ["slides", "", "X", box([-250, 250], [240, 270], [60, 420])],
  ["slides", "", "Y", box([-200, 200], [205, 270], [90, 440])], ["slides", "", "Z", box([-115, 115], [70, 205], [150, 500])],
  ["spindle", "", "", round([0, 10], 78, 225, 78, 470)], ["spindle", "", "", round([0, 10], 44, 165, 78, 225)],
  ["slides", "", "Y'", box([-300, 300], [-230, 230], [-310, -272])], ["slides", "", "X'", box([-420, 420], [-150, 150], [-310, -272])],
  ["bed", "", "A'", box([-390, -300], [-120, 120], [-272, 60])], ["bed", "", "!A'", round([0, 0], 140, -272, 140, -75)],
  ["cradle", "A", "A'", box([-300, -255], [-90, 90], [-130, 45])], ["cradle", "A", "A'", box([-255, 255], [-110, 110], [-130, -75])],
  ["table", "C", "", round([0, 0], TABLE, -75, TABLE, -20)], ["work", "C", "", box([-75, 75], [-65, 65], [-20, 40])],
  ["tool", "", "", round([0, 10], 11, 62, 11, 165)],
  ["cradle", "A", "A'", box([255, 300], [-90, 90], [-130, 45])], ["bed", "", "A'", box([300, 390], [-120, 120], [-272, 60])],
];
const MOVES = { cradle: "A", table: "C", slides: "XYZ" };
const axesOf = (chain) => {
  const axes = chain.split("-");
  return axes.includes("b") ? axes : CHAIN.split("-");
};
// Where the label of each part stands, and the point that it means.
const LABELS = {
  column: [[74, 22], [-200, 430, 540]], spindle: [[74, 76], [-70, -10, 380]], cradle: [[74, 132], [-278, -90, 20]], bed: [[74, 190], [-330, -430, -365]],
  slides: [[286, 44], [115, 90, 420]], table: [[286, 110], [195, 0, -45]], ambient: [[286, 166]], fluids: [[286, 214]],
};
const SIZE = { bed: [360, 400, 40], column: [240, 70, 380], slides: [150, 30, 150], spindle: [60, 60, 110], cradle: [270, 80, 40], table: [150, 150, 20] };
const MIDDLE = { bed: [0, -30, -330], column: [0, 340, 200], slides: [0, 180, 300], spindle: [0, -40, 340], cradle: [0, -60, -90], table: [0, 0, -20] };
const SIDE = [[["left", "x"], ["right"]], [["front", "lower", "y"], ["rear", "back"]], [["bottom", "low", "nut"], ["top", "high", "motor", "drive"]]];
const WIDE = [84, 276, 8, 222];
const COLD = 18, HOT = 32;
const FACTORS = [5000, 2000, 1000, 500, 200, 100, 50, 20];
const MOST = 70;

// errors: of the machine, µm and µm/m; factor: how much larger they are drawn; unit: of the drawing, per mm
const bent = (errors, factor, unit, a, c) => {
  const mm = (name) => (errors[name] ?? 0) * 1e-3 * factor * unit, tilt = (name) => (errors[name] ?? 0) * 1e-6 * factor;
  const turn = (angle, [x, y]) => [x * Math.cos(angle) - y * Math.sin(angle), x * Math.sin(angle) + y * Math.cos(angle)];
  const held = ([x, y, z]) => { const [v, w] = turn(a, [y, z]); return [x, v + mm("EY0A"), w + mm("EZ0A")]; };
  const grown = 1 + mm("ER0T") / SPHERE;
  const onTable = ([x, y, z]) => {
    const [u, v] = turn(c + tilt("EC0C"), [x * grown, y * grown]);
    return held([u + mm("EX0C") + z * tilt("EB0C"), v + mm("EY0C") - z * tilt("EA0C"), z + mm("EZ0T") * (z > -70) + v * tilt("EA0C") - u * tilt("EB0C")]);
  };
  return { "": (p) => p, A: held, C: onTable };
};
const displaced = (errors) => Math.max(Math.hypot(...["EY0A", "EZ0A", "EX0C", "EY0C", "EZ0T", "ER0T"].map((e) => errors[e] ?? 0)), 0.2 * Math.hypot(...["EA0C", "EB0C"].map((e) => errors[e] ?? 0))) * 1e-3;
const path = (points) => "M" + points.map(([x, y]) => `${x.toFixed(1)} ${y.toFixed(1)}`).join("L") + "Z";

const spot = (channel, part, i) => {
  const words = channel.toLowerCase().split(/[-_]/), side = (axis) => SIDE[axis][0].some((w) => words.includes(w)) ? -1 : SIDE[axis][1].some((w) => words.includes(w)) ? 1 : 0;
  const spread = [(i % 3 - 1) * 0.5, -0.9, (i % 2 ? 0.5 : -0.3)];
  return MIDDLE[part].map((m, axis) => m + SIZE[part][axis] * (side(axis) || spread[axis]));
};

let scaled = null;
// The probing sphere on its stem, where it stands on the table.
const ballAt = (height, carried) => {
  const [x, y] = scaled(carried([SPHERE, 0, Math.max(height, -8)])), [u, v] = scaled(carried([SPHERE, 0, -20]));
  return drawn("g", { class: "ball" }, drawn("path", { d: `M${u} ${v}L${x} ${y}` }), drawn("circle", { cx: x, cy: y, r: 4 }, drawn("title", {}, word("heat.sphere"))));
};
const build = (channels, errors, place, angles, sphere, axes) => {
  const unit = SPHERE / (sphere ? sphere[0] : SPHERE), factor = FACTORS.find((each) => displaced(errors) * each * unit <= MOST) ?? FACTORS.at(-1);
  const radians = angles.map((degrees) => degrees * Math.PI / 180), now = bent(errors, factor, unit, ...radians), cold = bent({}, 0, unit, ...radians);
  if (!scaled) {
    const all = PARTS.flatMap(([, , , faces]) => faces.flat().map(project)), xs = all.map((p) => p[0]), ys = all.map((p) => p[1]);
    const k = Math.min((WIDE[1] - WIDE[0]) / (Math.max(...xs) - Math.min(...xs)), (WIDE[3] - WIDE[2]) / (Math.max(...ys) - Math.min(...ys)));
    const x = (WIDE[0] + WIDE[1] - k * (Math.max(...xs) + Math.min(...xs))) / 2, y = (WIDE[2] + WIDE[3] - k * (Math.max(...ys) + Math.min(...ys))) / 2;
    scaled = (point) => { const [u, v] = project(point); return [x + k * u, y + k * v]; };
  }
  const there = PARTS.filter(([, , axis]) => !axis || (axis.startsWith("!") ? !axes.includes(axis.slice(1)) : axes.includes(axis)));
  const groups = there.map(([part, carried, , faces]) => {
    const group = drawn("g", { class: "part", "data-part": part });
    for (const face of faces) {
      const moved = face.map(now[carried]), seen = moved.map(scaled);
      const area = seen.reduce((sum, [x, y], i) => { const [u, v] = seen[(i + 1) % seen.length]; return sum + x * v - u * y; }, 0);
      if (area >= 0) continue;
      const [p, q, r] = moved, u = q.map((v, i) => v - p[i]), w = r.map((v, i) => v - q[i]);
      const normal = [u[1] * w[2] - u[2] * w[1], u[2] * w[0] - u[0] * w[2], u[0] * w[1] - u[1] * w[0]], length = Math.hypot(...normal) || 1;
      const light = (-0.35 * normal[0] - 0.6 * normal[1] + 0.72 * normal[2]) / length, shown = drawn("path", { d: path(seen), class: light > 0.5 ? "lit" : "dim" });
      shown.style.setProperty("--by", `${(light > 0.5 ? (light - 0.5) * 70 : (0.5 - light) * 42).toFixed(0)}%`);
      if (faces.length > 6 && face.length === 4) shown.classList.add("curved");
      group.append(shown);
    }
    if (part in LABELS) {
      const link = drawn("a", { href: `#sensors/${part}`, tabindex: "-1", "aria-hidden": "true" }, group);
      return link;
    }
    return group;
  });
  const ring = circle([0, 0], TABLE, -20).map(cold.C).map(scaled), from = scaled(cold.C([TABLE, 0, -20])), to = scaled(now.C([TABLE, 0, -20]));
  const rings = [drawn("path", { class: "cold", d: path(ring) }), drawn("path", { class: "shift", d: `M${from}L${to}` })];
  const ball = sphere ? [ballAt(sphere[1] * unit, now.C)] : [];
  const count = {};
  const dots = channels.filter((c) => c.body in MIDDLE).map((c) => {
    count[c.body] = (count[c.body] ?? -1) + 1;
    const carried = c.body === "cradle" ? "A" : c.body === "table" ? "C" : "", [x, y] = scaled(now[carried](spot(c.channel, c.body, count[c.body])));
    return drawn("circle", { class: !c.good ? "sensor failed" : c.doubt ? "sensor doubted" : "sensor", cx: x.toFixed(1), cy: y.toFixed(1), r: c.good && !c.doubt ? 1.9 : 4 }, drawn("title", {}, c.channel));
  });
  const labels = Object.entries(LABELS).map(([part, [[x, y], point]]) => {
    const left = x < 180, carried = part === "cradle" ? "A" : part === "table" ? "C" : "", [u, v] = point ? scaled(now[carried](point)) : [];
    const link = drawn("a", { href: `#sensors/${part}`, "data-body": part });
    if (point) link.append(drawn("path", { class: "leader", d: `M${left ? x + 5 : x - 5} ${y - 4}L${u} ${v}` }), drawn("circle", { class: "end", cx: u, cy: v, r: 2.2 }));
    link.append(drawn("rect", { class: "touched", x: left ? x - 78 : x, y: y - 22, width: 78, height: 44 }), drawn("text", { x, y: y - 3, class: left ? "left" : "" }, `${word("body." + part).replace(/ .*/, "")} ${[...MOVES[part] ?? ""].filter((letter) => axes.some((axis) => axis[0] === letter)).join("")}`), drawn("text", { x, y: y + 14, class: left ? "left number" : "number" }));
    return link;
  });
  const bends = Object.keys(errors).length > 0 && displaced(errors) > 0;
  const key = [drawn("path", { class: bends ? "cold" : "none", d: "M8 242h20" }), drawn("text", { x: 33, y: 246, class: bends ? "" : "none" }, `${word("heat.cold_table")}, × ${amount({ n: factor, d: 0 })}`),
    drawn("text", { x: 253, y: 246, class: "left" }, String(COLD)), drawn("rect", { class: "scale", x: 258, y: 238, width: 52, height: 8, fill: "url(#heat)" }), drawn("text", { x: 315, y: 246 }, `${HOT}\u202f°C`)];
  place.replaceChildren(
    drawn("defs", {}, drawn("linearGradient", { id: "heat" }, drawn("stop", { offset: "0", class: "cold-end" }), drawn("stop", { offset: "0.5", class: "middle" }), drawn("stop", { offset: "1", class: "hot-end" })),
      drawn("pattern", { id: "hatch", width: 6, height: 6, patternUnits: "userSpaceOnUse", patternTransform: "rotate(45)" }, drawn("rect", { class: "hatch-ground", width: 6, height: 6 }), drawn("rect", { class: "hatch-line", width: 2.4, height: 6 }))),
    ...groups, ...ball, ...(bends ? rings : []), ...dots, ...labels, ...key);
};
// The mean of each part that has a good temperature, by part; null: it has sensors, and none is good.
export const means = (channels) => {
  const by = {};
  for (const part of Object.keys(LABELS)) {
    const own = channels.filter((c) => c.body === part && (!c.value || c.value.u === "°C")), good = own.filter((c) => c.good && c.value);
    if (own.length) by[part] = { mean: good.length ? good.reduce((sum, c) => sum + c.value.n, 0) / good.length : null, lost: own.length - good.length };
  }
  return by;
};
export const heat = (degrees) => `${Math.min(Math.max((degrees - COLD) / (HOT - COLD) * 100, 0), 100).toFixed(0)}%`;
// sphere: its radius and height, mm, or null; angles: of A and C at the chosen point, degrees; now: whether the
// temperatures are current
export const showModel = (v, sphere, angles, now) => {
  const place = $("sketch"), channels = v.channels.filter((c) => c.body), failing = channels.map((c) => [c.channel, c.body, c.good, c.doubt]);
  if (changed("sketch", [failing, v.errors, angles, sphere, v.kinematics])) build(channels, v.errors, place, angles, sphere, axesOf(v.kinematics));
  const by = means(channels);
  for (const part of place.querySelectorAll("[data-part]")) {
    const own = by[part.dataset.part];
    part.classList.toggle("lost", Boolean(own) && own.mean === null);
    part.classList.toggle("plain", !now || !own);
    if (own && own.mean !== null) part.style.setProperty("--heat", heat(own.mean));
  }
  for (const label of place.querySelectorAll("[data-body]")) {
    const own = by[label.dataset.body];
    label.classList.toggle("doubtful", Boolean(own) && own.lost > 0);
    label.toggleAttribute("hidden", !own);
    if (own) put(label.querySelector(".number"), amount({ n: own.mean, u: "°C", d: 1 }) + (own.lost ? " !" : ""));
  }
};
