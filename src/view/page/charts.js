"use strict";
// Curves over time on plain canvases: the last seconds up to the moment that is shown.

const COLORS = ["#0072b2", "#d55e00", "#009e73", "#cc79a7", "#e69f00", "#56b4e9"];
const LEG_COLORS = { A: "#226eb2", B: "#609e60" };

/** Seconds that a chart shows. */
const SPAN = 4;

/** How the columns of feet in contact begin. */
const CONTACT = "contact, ";

const FONT = "13px system-ui, 'DejaVu Sans', sans-serif";

/** A canvas in its own pixels; gives the context and the size in page pixels. */
function sharp(canvas) {
  const ratio = window.devicePixelRatio || 1;
  const [width, height] = [canvas.clientWidth, canvas.clientHeight];
  if (canvas.width !== Math.round(width * ratio) || canvas.height !== Math.round(height * ratio)) {
    canvas.width = Math.round(width * ratio);
    canvas.height = Math.round(height * ratio);
  }
  const context = canvas.getContext("2d");
  context.setTransform(ratio, 0, 0, ratio, 0, 0);
  context.clearRect(0, 0, width, height);
  context.font = FONT;
  context.lineJoin = "round";
  return { context, width, height };
}

/** A round step that divides `range` into about `count` parts. */
function step(range, count) {
  const rough = range / count;
  const power = 10 ** Math.floor(Math.log10(rough));
  return [1, 2, 5, 10].map((k) => k * power).find((s) => s >= rough);
}

/** Axes with round ticks; gives the maps from time and value to pixels. */
function axes({ context, width, height }, [t0, t1], [low, high], left) {
  const [top, bottom, right] = [6, height - 19, width - 6];
  const x = (t) => left + ((t - t0) / (t1 - t0)) * (right - left);
  const y = (v) => bottom - ((v - low) / (high - low)) * (bottom - top);
  context.strokeStyle = "#e4e0d6";
  context.fillStyle = "#5b6470";
  context.lineWidth = 1;
  context.textAlign = "center";
  context.textBaseline = "top";
  for (let t = Math.ceil(t0); t <= t1 + 1e-9; t += 1) {
    context.beginPath();
    context.moveTo(x(t), top);
    context.lineTo(x(t), bottom);
    context.stroke();
    if (x(t) < right - 12) context.fillText(`${t} s`, x(t), bottom + 3);
  }
  return { x, y, top, bottom, right };
}

function ticks({ context }, frame, [low, high], left) {
  const by = step(high - low, 4);
  const digits = Math.max(0, -Math.floor(Math.log10(by) + 1e-9));
  context.textAlign = "right";
  context.textBaseline = "middle";
  for (let k = Math.ceil(low / by - 1e-9); k * by <= high + 1e-9 * by; k += 1) {
    const v = k * by;
    context.strokeStyle = k === 0 ? "#9aa0a6" : "#e4e0d6";
    context.beginPath();
    context.moveTo(left, frame.y(v));
    context.lineTo(frame.right, frame.y(v));
    context.stroke();
    context.fillText(v.toFixed(digits).replace("-", "−"), left - 5, frame.y(v));
  }
}

/** The moments from `t0` to `t1`. */
function between(recording, t0, t1) {
  if (!recording.moments.length) return [];
  const from = Math.max(0, recording.index(t0));
  return recording.moments.slice(from, recording.index(t1) + 1);
}

function window_of(recording, now) {
  const end = Math.max(now, recording.start + SPAN);
  return [end - SPAN, end];
}

/** Curves: [{label, color, value: moment → number}]. */
function curves(canvas, recording, now, lines, floor) {
  const area = sharp(canvas);
  const span = window_of(recording, now);
  const moments = between(recording, span[0], now);
  let [low, high] = floor;
  for (const line of lines) {
    for (const m of moments) {
      const v = line.value(m);
      if (Number.isFinite(v)) [low, high] = [Math.min(low, v), Math.max(high, v)];
    }
  }
  const range = [low - 0.05 * (high - low), high + 0.05 * (high - low)];
  const left = 46;
  const legend = lines.some((l) => l.label) ? 18 : 0;
  area.height -= legend;
  const frame = axes(area, span, range, left);
  ticks(area, frame, range, left);
  const { context } = area;
  context.save();
  context.beginPath();
  context.rect(left, 0, frame.right - left, frame.bottom + 1);
  context.clip();
  for (const line of lines) {
    context.strokeStyle = line.color;
    context.lineWidth = line.width || 1.6;
    context.setLineDash(line.dash || []);
    context.beginPath();
    let before = null;
    for (const m of moments) {
      const v = line.value(m);
      if (!Number.isFinite(v)) continue;
      // A new section is a new robot: its curve begins anew.
      if (before && before.section === m.section) context.lineTo(frame.x(m.at), frame.y(v));
      else context.moveTo(frame.x(m.at), frame.y(v));
      before = m;
    }
    context.stroke();
  }
  context.restore();
  if (legend) keys(context, lines, left, area.height + 9, frame.right);
}

function keys(context, lines, left, y, right) {
  let x = left;
  context.textAlign = "left";
  context.textBaseline = "middle";
  for (const line of lines.filter((l) => l.label)) {
    const width = context.measureText(line.label).width;
    if (x + 14 + width > right + 6) break;
    context.strokeStyle = line.color;
    context.lineWidth = 3;
    context.setLineDash(line.dash || []);
    context.beginPath();
    context.moveTo(x, y);
    context.lineTo(x + 10, y);
    context.stroke();
    context.setLineDash([]);
    context.fillStyle = "#22262b";
    context.fillText(line.label, x + 14, y);
    x += 14 + width + 9;
  }
}

/** Legs with the column that tells which are held: for a robot from a file, its feet in contact. */
function held(section) {
  if (section.header.legs.length) {
    return section.header.legs.map(({ name, tripod }, k) => ({ name, color: LEG_COLORS[tripod], column: "stance", k }));
  }
  const feet = [...section.places.keys()].filter((name) => name.startsWith(CONTACT));
  return feet.map((column, i) => ({ name: column.slice(CONTACT.length), color: COLORS[i % 6], column, k: 0 }));
}

/** One bar a leg, dark while the ground holds it. */
function gait(canvas, recording, now, section) {
  const area = sharp(canvas);
  const span = window_of(recording, now);
  const left = 92;
  const frame = axes(area, span, [0, 1], left);
  const { context } = area;
  const legs = held(section);
  const high = (frame.bottom - frame.top) / Math.max(legs.length, 1);
  context.textAlign = "right";
  context.textBaseline = "middle";
  legs.forEach((leg, k) => {
    context.fillStyle = "#22262b";
    context.fillText(leg.name, left - 6, frame.top + (k + 0.5) * high);
    context.fillStyle = "#f3f0e9";
    context.fillRect(left, frame.top + k * high + 2, frame.right - left, high - 4);
  });
  const moments = between(recording, span[0], now);
  moments.forEach((m, n) => {
    const until = n + 1 < moments.length ? moments[n + 1].at : now;
    const [from, to] = [frame.x(m.at), frame.x(until)].map((x) => Math.round(Math.max(left, x)));
    legs.forEach((leg, k) => {
      if (!(m.section.get(m.row, leg.column)[leg.k] >= 0.5)) return;
      context.fillStyle = leg.color;
      context.fillRect(from, frame.top + k * high + 2, to - from, high - 4);
    });
  });
}

/** The column of the commanded forward speed. */
function commanded(section) {
  return section.places.has("commanded_speed") ? "commanded_speed" : "command_lin_vel_x";
}

/** For each joint: the number of its leg, and a label on the first joint of each. */
function joint_groups({ header }) {
  const { joints, legs, bodies } = header;
  if (!legs.length) {
    // Of a robot from a file a leg is a branch of the tree; body k + 1 hangs on joint k. Old recordings have no bodies.
    const branch = (k) => (bodies[k]?.parent ? branch(bodies[k].parent) : k);
    const roots = [...new Set(joints.map((_, k) => branch(k + 1)))];
    return joints.map((name, k) => {
      const label = roots.includes(k + 1) ? name.split(/[-_ ]/)[0] : "";
      return { label, group: roots.indexOf(branch(k + 1)), width: 1 };
    });
  }
  const each = joints.length / legs.length;
  const initials = (name) => name.split(/[-_ ]/).map((w) => w[0].toUpperCase()).join("");
  return joints.map((_, k) => ({
    label: k % each === 0 ? initials(legs[k / each].name) : "",
    group: Math.floor(k / each),
    width: each === 1 ? 1.6 : 1,
  }));
}

/** All charts at time `now`. */
function chart_all(recording, now, section) {
  const $ = (id) => document.getElementById(id);
  const info = (name) => (m) => { const v = m.section.get(m.row, name); return v.length ? v[0] : NaN; };
  gait($("gait"), recording, now, section);
  const speeds = [{ label: "of the base", color: COLORS[0], value: (m) => m.section.get(m.row, "velocity")[0] }];
  if (section.places.has("speed")) {
    speeds.push({ label: "over each step", color: COLORS[2], value: info("speed") });
    speeds.push({ label: "commanded", color: COLORS[1], dash: [5, 4], value: info(commanded(section)) });
  }
  curves($("speed"), recording, now, speeds, [0, 0.1]);
  const groups = joint_groups(section);
  const torques = groups.map(({ label, group, width }, k) => ({
    label,
    color: COLORS[group % 6],
    width,
    value: (m) => { const t = m.section.get(m.row, "torques"); return k < t.length ? t[k] : NaN; },
  }));
  curves($("torque"), recording, now, torques, [-0.005, 0.005]);
  const terms = section.terms;
  $("reward-figure").hidden = !terms.length;
  $("reward-figure").style.display = terms.length ? "" : "none";
  if (terms.length) {
    const lines = terms.map((name, k) => ({
      label: name.replace("reward_", ""), color: COLORS[k % 6], value: info(name),
    }));
    curves($("reward"), recording, now, lines, [-0.05, 0.05]);
  }
}
