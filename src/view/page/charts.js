"use strict";
// Curves over time on plain canvases. A recording is shown whole, or in parts of a chosen length, with a cursor at the
// moment that the picture shows. A live page shows the last seconds.

/** Colours that people with any colour vision tell apart (Okabe and Ito 2008), and dashes for further curves. */
const COLORS = ["#0072b2", "#d55e00", "#009e73", "#cc79a7", "#e69f00", "#56b4e9"];
const DASHES = [[], [7, 3], [2, 2], [9, 3, 2, 3], [1, 4], [12, 5]];
const LEG_COLORS = { A: "#226eb2", B: "#609e60" };

/** Seconds that a chart of a live page shows. */
const LIVE_SPAN = 4;

/** Height of a row of a legend, and of a leg in the diagram of the gait [px]. */
const ROW = 17;

/** How the columns of feet in contact begin. */
const CONTACT = "contact, ";

const FONT = "13px system-ui, 'DejaVu Sans', sans-serif";
const INK = "#22262b";

/** Frames of the charts for which the pointer can choose a time: canvas → {span, left, right}. */
const FRAMES = new Map();

/** What was drawn before: canvas → {key, image}. */
const DRAWN = new WeakMap();

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
  const [top, bottom, right] = [6, Math.max(height - 19, 12), width - 6];
  const x = (t) => left + ((t - t0) / (t1 - t0)) * (right - left);
  const y = (v) => bottom - ((v - low) / (high - low)) * (bottom - top);
  context.strokeStyle = "#e4e0d6";
  context.fillStyle = "#5b6470";
  context.lineWidth = 1;
  context.textAlign = "center";
  context.textBaseline = "top";
  const by = step(t1 - t0, Math.max(2, (right - left) / 70));
  const digits = Math.max(0, -Math.floor(Math.log10(by) + 1e-9));
  for (let k = Math.ceil(t0 / by - 1e-9); k * by <= t1 + 1e-9; k += 1) {
    const t = k * by;
    context.beginPath();
    context.moveTo(x(t), top);
    context.lineTo(x(t), bottom);
    context.stroke();
    if (x(t) < right - 12) context.fillText(`${t.toFixed(digits)} s`, x(t), bottom + 3);
  }
  return { x, y, top, bottom, left, right };
}

function ticks({ context }, frame, [low, high], left) {
  const by = step(high - low, Math.max(2, Math.min(4, (frame.bottom - frame.top) / 22)));
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

/**
 * The time that charts show: {span: [from, to], until}. `until` is the last moment that is drawn. `part`: length of a
 * part [s]; 0: all of the recording.
 */
function window_of(recording, now, part, live) {
  const { start, end } = recording;
  if (live) {
    const last = Math.max(now, start + part);
    return { span: [last - part, last], until: now };
  }
  const from = part ? start + Math.floor((now - start) / part) * part : start;
  const to = part ? from + part : Math.max(end, start + 0.1);
  return { span: [from, to], until: Math.min(to, end) };
}

/**
 * Draws a chart by `paint(area)`, which gives the chart's frame, and the cursor. What stays the same from one moment to
 * the next, as `key` tells, is copied.
 */
function chart(canvas, { span, now, live, key }, paint) {
  const area = sharp(canvas);
  const whole = `${key} ${canvas.width} ${canvas.height} ${span}`;
  let drawn = DRAWN.get(canvas);
  if (live || drawn?.key !== whole) {
    const frame = paint(area);
    const image = live ? null : document.createElement("canvas");
    if (image && canvas.width && canvas.height) {
      [image.width, image.height] = [canvas.width, canvas.height];
      image.getContext("2d").drawImage(canvas, 0, 0);
    }
    drawn = { key: whole, frame, image };
    DRAWN.set(canvas, drawn);
  } else if (drawn.image.width) {
    area.context.drawImage(drawn.image, 0, 0, area.width, area.height);
  }
  const { frame } = drawn;
  FRAMES.set(canvas, { span, left: frame.left, right: frame.right });
  if (live) return;
  area.context.strokeStyle = INK;
  area.context.lineWidth = 1;
  area.context.beginPath();
  area.context.moveTo(frame.x(now), frame.top - 4);
  area.context.lineTo(frame.x(now), frame.bottom + 2);
  area.context.stroke();
}

/** The time of the recording at which the pointer is over a chart; undefined beside its axes. */
function time_at(canvas, event) {
  const frame = FRAMES.get(canvas);
  const share = frame ? (event.offsetX - frame.left) / (frame.right - frame.left) : -1;
  return share >= 0 && share <= 1 ? frame.span[0] + share * (frame.span[1] - frame.span[0]) : undefined;
}

/** Draws one curve; where many moments share a column of pixels, from their least to their largest value. */
function curve(context, frame, moments, line) {
  context.strokeStyle = line.color;
  context.lineWidth = line.width || 1.6;
  context.setLineDash(line.dash || []);
  context.beginPath();
  let [before, column, low, high] = [null, NaN, 0, 0];
  const flush = () => {
    if (Number.isNaN(column)) return;
    context.lineTo(column, frame.y(low));
    if (high !== low) context.lineTo(column, frame.y(high));
  };
  const dense = moments.length > 2 * (frame.right - frame.left);
  for (const m of moments) {
    const v = line.value(m);
    if (!Number.isFinite(v)) continue;
    const x = dense ? Math.round(frame.x(m.at)) : frame.x(m.at);
    // A new section is a new robot: its curve begins anew.
    if (!before || before.section !== m.section) {
      flush();
      context.moveTo(x, frame.y(v));
      [column, low, high] = [x, v, v];
    } else if (x === column) {
      [low, high] = [Math.min(low, v), Math.max(high, v)];
    } else {
      flush();
      [column, low, high] = [x, v, v];
    }
    before = m;
  }
  flush();
  context.stroke();
  context.setLineDash([]);
}

/** Curves: [{label, color, dash, value: moment → number}]; `legend`: what its legend shows, if not the curves. */
function curves(canvas, view, lines, floor, legend = lines) {
  const room = canvas.clientWidth - 46 - 6;
  const rows = legend_rows(legend.filter((l) => l.label), room);
  const least = `${96 + ROW * rows.length}px`;
  if (canvas.style.minHeight !== least) canvas.style.minHeight = least;
  chart(canvas, view, (area) => {
    const moments = between(view.recording, view.span[0], view.until);
    let [low, high] = floor;
    for (const line of lines) {
      for (const m of moments) {
        const v = line.value(m);
        if (Number.isFinite(v)) [low, high] = [Math.min(low, v), Math.max(high, v)];
      }
    }
    const range = [low - 0.05 * (high - low), high + 0.05 * (high - low)];
    const left = 46;
    const inner = { ...area, height: area.height - ROW * rows.length };
    const frame = axes(inner, view.span, range, left);
    ticks(inner, frame, range, left);
    const { context } = area;
    context.save();
    context.beginPath();
    context.rect(left, 0, frame.right - left, frame.bottom + 1);
    context.clip();
    lines.forEach((line) => curve(context, frame, moments, line));
    context.restore();
    draw_legend(context, rows, left, inner.height + ROW / 2);
    return frame;
  });
}

const MEASURE = document.createElement("canvas").getContext("2d");

/** The entries of a legend in rows of at most `room` [px], each with its width. */
function legend_rows(entries, room) {
  MEASURE.font = FONT;
  const rows = [];
  let used = Infinity;
  for (const entry of entries) {
    const width = 26 + MEASURE.measureText(entry.label).width + 10;
    if (used + width - 10 > room) {
      rows.push([]);
      used = 0;
    }
    rows[rows.length - 1].push({ ...entry, x: used });
    used += width;
  }
  return rows;
}

function draw_legend(context, rows, left, y) {
  context.textAlign = "left";
  context.textBaseline = "middle";
  rows.flatMap((row, k) => row.map((entry) => ({ ...entry, y: y + k * ROW }))).forEach((entry) => {
    context.strokeStyle = entry.color;
    context.lineWidth = 2.5;
    context.setLineDash(entry.dash || []);
    context.beginPath();
    context.moveTo(left + entry.x, entry.y);
    context.lineTo(left + entry.x + 22, entry.y);
    context.stroke();
    context.setLineDash([]);
    context.fillStyle = INK;
    context.fillText(entry.label, left + entry.x + 26, entry.y);
  });
}

/** Legs, each with the column that tells whether the ground holds it (for a robot from a file: its foot). */
function held(section) {
  if (section.header.legs.length) {
    return section.header.legs.map(({ name, tripod }, k) => ({ name, color: LEG_COLORS[tripod], column: "stance", k }));
  }
  const feet = [...section.places.keys()].filter((name) => name.startsWith(CONTACT));
  return feet.map((column, i) => ({ name: column.slice(CONTACT.length), color: COLORS[i % 6], column, k: 0 }));
}

/** One bar for each leg, dark while the ground holds the leg. */
function gait(canvas, view, section) {
  const legs = held(section);
  canvas.style.minHeight = `${ROW * legs.length + 25}px`;
  chart(canvas, view, (area) => {
    const left = 92;
    const frame = axes(area, view.span, [0, 1], left);
    const { context } = area;
    const high = (frame.bottom - frame.top) / Math.max(legs.length, 1);
    context.textAlign = "right";
    context.textBaseline = "middle";
    legs.forEach((leg, k) => {
      context.fillStyle = INK;
      context.fillText(leg.name, left - 6, frame.top + (k + 0.5) * high);
      context.fillStyle = "#f3f0e9";
      context.fillRect(left, frame.top + k * high + 2, frame.right - left, high - 4);
    });
    const moments = between(view.recording, view.span[0], view.until);
    moments.forEach((m, n) => {
      const until = n + 1 < moments.length ? moments[n + 1].at : view.until;
      const [from, to] = [frame.x(m.at), frame.x(until)].map((x) => Math.round(Math.max(left, x)));
      legs.forEach((leg, k) => {
        if (!(m.section.get(m.row, leg.column)[leg.k] >= 0.5)) return;
        context.fillStyle = leg.color;
        context.fillRect(from, frame.top + k * high + 2, to - from, high - 4);
      });
    });
    return frame;
  });
}

/** The columns of a task's commands: forward, to the left, and the yaw rate; null if the task has none. */
function commanded(section) {
  const has = (name) => (section.places.has(name) ? name : null);
  const forward = has("command_lin_vel_x") || has("commanded_speed");
  return { forward, left: has("command_lin_vel_y"), yaw: has("command_ang_vel_yaw") };
}

/**
 * Velocity [m/s] and yaw rate [rad/s] of the base in the frame of the task's command. For tasks with a command to the left
 * this is the frame of the base, for others that of the robot's heading, which lies in the surface.
 */
function base_velocity(section, row) {
  const turn = quaternion(section.get(row, "orientation"));
  if (!commanded(section).left) {
    const ahead = new THREE.Vector3(1, 0, 0).applyQuaternion(turn);
    turn.setFromAxisAngle(new THREE.Vector3(0, 0, 1), Math.atan2(ahead.y, ahead.x));
  }
  const back = turn.invert();
  const [v, w] = ["velocity", "angular_velocity"].map((name) =>
    new THREE.Vector3(...section.get(row, name)).applyQuaternion(back));
  return { forward: v.x, left: v.y, yaw: w.z };
}

/** A joint's name without the name of its leg, if it begins with that. */
function joint_name(name, leg) {
  return name.startsWith(leg) ? name.slice(leg.length).replace(/^[-_ ]+/, "") || name : name;
}

/** For each joint: the number and name of its leg, and its number and name within the leg. */
function joint_groups({ header }) {
  const { joints, legs, bodies } = header;
  const parent = (k) => (bodies[k]?.parent ? bodies[k].parent : 0);
  // Of a robot from a file a leg is a branch of the tree; body k + 1 hangs on joint k. Old recordings have no bodies.
  const branch = (k) => (parent(k) ? branch(parent(k)) : k);
  const depth = (k) => (parent(k) ? 1 + depth(parent(k)) : 0);
  const each = joints.length / Math.max(legs.length, 1);
  const roots = [...new Set(joints.map((_, k) => branch(k + 1)))];
  return joints.map((name, k) => {
    const leg = legs.length ? legs[Math.floor(k / each)].name : joints[branch(k + 1) - 1].split(/[-_ ]/)[0];
    return {
      leg,
      group: legs.length ? Math.floor(k / each) : roots.indexOf(branch(k + 1)),
      joint: joint_name(name, leg),
      level: legs.length ? k % each : depth(k + 1),
    };
  });
}

/** `color` mixed with white (share > 0) or black (share < 0). */
function shade(color, share) {
  const to = share > 0 ? 255 : 0;
  const part = (at) => {
    const c = parseInt(color.slice(at, at + 2), 16);
    return Math.round(c + (to - c) * Math.abs(share)).toString(16).padStart(2, "0");
  };
  return `#${part(1)}${part(3)}${part(5)}`;
}

/** Colour and dash of a joint: a colour for each leg, and for each joint of a leg its dash and brightness. */
function joint_style({ group, level }) {
  const lap = Math.floor(group / COLORS.length);
  return { color: shade(COLORS[group % 6], [0, -0.35, 0.3][level % 3]), dash: DASHES[(level + 3 * lap) % 6] };
}

/** Curves of all torques, and their legend: legs by colour, joints of a leg by dash. */
function torque_lines(section) {
  const groups = joint_groups(section);
  const lines = groups.map((place, k) => ({
    ...joint_style(place),
    width: 1.4,
    value: (m) => { const t = m.section.get(m.row, "torques"); return k < t.length ? t[k] : NaN; },
  }));
  const first = (key) => groups.filter((g, k) => groups.findIndex((other) => other[key] === g[key]) === k);
  const legs = first("group").map((g) => ({ label: g.leg, color: COLORS[g.group % 6] }));
  const levels = first("level");
  if (levels.length < 2) return { lines, legend: legs };
  const common = (level) => groups.every((g) => g.level !== level.level || g.joint === level.joint);
  const joints = levels.map((g) => ({
    label: common(g) ? g.joint : `joint ${g.level + 1}`,
    color: shade("#6a7078", [0, -0.35, 0.3][g.level % 3]),
    dash: DASHES[g.level % 6],
  }));
  return { lines, legend: [...legs, ...joints] };
}

/** Shows or hides a figure. */
function shown(id, on) {
  const figure = document.getElementById(id).parentElement;
  figure.hidden = !on;
  figure.style.display = on ? "" : "none";
  return on;
}

/** All charts at time `now`. `part`: seconds that they show, 0 for all of a recording. */
function chart_all(recording, now, section, part, live) {
  const $ = (id) => document.getElementById(id);
  const number = recording.sections.indexOf(section);
  const key = `${number} ${recording.moments.length}`;
  const view = { recording, now, live, key, ...window_of(recording, now, part, live) };
  const info = (name) => (m) => { const v = m.section.get(m.row, name); return v.length ? v[0] : NaN; };
  const command = commanded(section);
  gait($("gait"), view, section);
  const of_base = (name) => ({ label: "of the base", color: COLORS[0], value: (m) => base_velocity(m.section, m.row)[name] });
  const wanted = (column) => ({ label: "commanded", color: COLORS[1], dash: [5, 4], width: 2, value: info(column) });
  const speeds = [of_base("forward")];
  // A task without a velocity command takes the mean over each step.
  if (section.places.has("speed") && !command.left) speeds.push({ label: "over each step", color: COLORS[2], value: info("speed") });
  if (command.forward) speeds.push(wanted(command.forward));
  curves($("speed"), view, speeds, [0, 0.1]);
  if (shown("lateral", command.left)) curves($("lateral"), view, [of_base("left"), wanted(command.left)], [-0.05, 0.05]);
  if (shown("yaw", command.yaw)) curves($("yaw"), view, [of_base("yaw"), wanted(command.yaw)], [-0.05, 0.05]);
  const { lines, legend } = torque_lines(section);
  curves($("torque"), view, lines, [-0.005, 0.005], legend);
  const { terms } = section;
  if (shown("reward", terms.length > 0)) {
    const of_term = (name, k) => ({
      label: name.replace("reward_", ""), color: COLORS[k % 6], dash: DASHES[Math.floor(k / 6) % 6], value: info(name),
    });
    curves($("reward"), view, terms.map(of_term), [-0.05, 0.05]);
  }
}
