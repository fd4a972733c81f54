"use strict";
// The page itself: where moments come from, the clock, and the controls.

const $ = (id) => document.getElementById(id);

/** Moments that a live page keeps: some minutes at 50 a second. */
const KEPT = 12000;

/** A live page stays this far behind what it has [s], so that the picture does not stutter. */
const BEHIND = 0.12;

const player = {
  recording: new Recording(),
  prints: new Map(),
  marked: 0,
  playing: true,
  pace: 1,
  /** Seconds that the charts show; 0: all of a recording. */
  part: 0,
  time: 0,
  live: !$("recording"),
  world: null,
};

function fail(error) {
  $("failure").hidden = false;
  $("failure").textContent = `The page cannot go on: ${error.message || error}`;
  throw error;
}

/** Sections whose footprints are kept. */
const PRINTED = 20;

/** Marks the footprints of the moments that came in since the last look. */
function mark() {
  const { moments } = player.recording;
  for (; player.marked + 1 < moments.length; player.marked += 1) {
    const [a, b] = [moments[player.marked], moments[player.marked + 1]];
    if (!player.prints.has(a.section)) {
      player.prints.set(a.section, new Prints());
      if (player.prints.size > PRINTED) player.prints.delete(player.prints.keys().next().value);
    }
    if (a.section === b.section) player.prints.get(a.section).add(a.section, a, b);
  }
}

function text(value, digits) {
  const rounded = value.toFixed(digits);
  // A small negative number is rounded to "-0.000".
  return (Number(rounded) ? rounded.replace("-", "−") : (0).toFixed(digits)).padStart(7);
}

/** The numbers beside the picture. */
function readout(section, row) {
  const one = (name) => section.get(row, name)[0];
  const [v, command] = [base_velocity(section, row), commanded(section)];
  const lines = [];
  const add = (label, value, unit, digits = 3) => lines.push(`${label.padEnd(9)}${text(value, digits)} ${unit}`);
  add("time", one("time"), "s", 2);
  for (const [name, label, unit] of [["forward", "speed", "m/s"], ["left", "to left", "m/s"], ["yaw", "yaw", "rad/s"]]) {
    if (name === "forward" || command[name]) add(label, v[name], unit);
    if (command[name]) add(" command", one(command[name]), unit);
  }
  add("x", one("position"), "m");
  if (section.header.slope_deg) add("slope", section.header.slope_deg, "°", 1);
  if (section.header.episode !== null) add("episode", section.header.episode, "", 0);
  $("readout").textContent = lines.join("\n");
}

/** Advances the clock by `passed` seconds of the viewer's time. */
function tick(passed) {
  const { recording } = player;
  if (player.playing) player.time += passed * player.pace;
  if (player.live) {
    if (player.playing && player.pace === 1) {
      // Keep up with the server without jumping: a little faster or slower, and a leap only when far off.
      const lag = recording.end - BEHIND - player.time;
      player.time = Math.abs(lag) > 1 ? recording.end - BEHIND : player.time + 0.05 * lag;
    }
    player.time = Math.min(Math.max(player.time, recording.start), recording.end);
  } else if (player.time > recording.end) {
    player.time = player.playing ? recording.start : recording.end;
  }
}

function show() {
  const { recording, world, time } = player;
  if (!recording.moments.length) return;
  const k = recording.index(time);
  const a = recording.moments[k];
  const next = recording.moments[Math.min(k + 1, recording.moments.length - 1)];
  const b = next.section === a.section ? next : a;
  const share = b.at > a.at ? Math.min(Math.max((time - a.at) / (b.at - a.at), 0), 1) : 0;
  world.show(player.prints.get(a.section), a, b, share, time);
  readout(a.section, a.row);
  chart_all(recording, time, a.section, player.part, player.live);
  const newton = 0.01 / world.arrows.scale;
  const arrows = world.layers.arrows && a.section.pushed ? `arrows: 10 mm stand for ${newton.toPrecision(2)} N, ` : "";
  $("scale").textContent = `${arrows}lines: 0.1 m apart`;
  const scrub = $("scrub");
  [scrub.min, scrub.max] = [recording.start, recording.end];
  scrub.value = time;
  $("clock").textContent = `${(time - recording.start).toFixed(2)} / ${(recording.end - recording.start).toFixed(2)} s`;
}

function frame(now) {
  const passed = Math.min((now - (player.before || now)) / 1000, 0.25);
  player.before = now;
  try {
    mark();
    tick(passed);
    show();
    player.world.draw();
  } catch (error) {
    fail(error);
  }
  requestAnimationFrame(frame);
}

function controls() {
  const play = (on) => {
    player.playing = on;
    $("play").textContent = on ? "Pause" : "Play";
  };
  $("play").onclick = () => play(!player.playing);
  $("pace").onchange = () => { player.pace = Number($("pace").value); };
  $("scrub").oninput = () => {
    play(false);
    player.time = Number($("scrub").value);
  };
  const parts = player.live ? [[LIVE_SPAN, "last 4 s"], [20, "last 20 s"]] : [[0, "whole"], [20, "20 s"], [4, "4 s"]];
  $("part").replaceChildren(...parts.map(([value, label]) => new Option(label, value)));
  [[player.part]] = parts;
  $("part").onchange = () => { player.part = Number($("part").value); };
  for (const canvas of document.querySelectorAll("figure canvas")) {
    const seek = (event) => {
      const time = event.buttons && !player.live ? time_at(canvas, event) : undefined;
      if (time === undefined) return;
      play(false);
      player.time = Math.min(Math.max(time, player.recording.start), player.recording.end);
    };
    canvas.onpointerdown = seek;
    canvas.onpointermove = seek;
  }
  for (const name of ["arrows", "prints", "glass", "follow"]) {
    $(name).onchange = () => { player.world.layers[name] = $(name).checked; };
  }
  document.addEventListener("keydown", (event) => {
    if (event.code === "Space" && event.target === document.body) {
      event.preventDefault();
      play(!player.playing);
    }
  });
  player.play = play;
}

/** What the recording is of, in the page's upper right corner. */
function describe(section) {
  const { task, robot, medium, law, hard } = section.header;
  const ground = hard ? [`${medium} and hard ground`, law] : [medium, law];
  $("status").textContent = [task, robot, ...(hard?.some(everywhere) ? ["hard ground"] : ground)].join(" · ");
  // Robots from files have feet, and no footprints; old recordings of them have no forces.
  const { legs, segments } = section.header;
  $("gait-title").textContent = legs.length ? "Legs held by the sand" : "Feet in contact with the ground";
  $("arrows-title").textContent = legs.length ? "sand's force on each segment" : "ground's force on each body";
  $("arrows").parentElement.hidden = !section.pushed;
  $("prints").parentElement.hidden = !segments.length;
}

function main() {
  try {
    player.world = new World($("world"));
  } catch (error) {
    fail(error);
  }
  controls();
  const start = player.live ? follow_server() : embedded($("recording").textContent).then((bytes) => {
    player.recording.feed(bytes);
    if (!player.recording.moments.length) throw new Error("the recording holds no moment");
    player.time = player.recording.start;
    describe(player.recording.sections[0]);
  });
  start.catch(fail);
  requestAnimationFrame(frame);
}

/** Interval between two looks at keys and gamepad [ms]. */
const STEERING = 50;

/** A stick in less than this share of its way is at rest. */
const AT_REST = 0.15;

/** Makes `element` a stick for a finger or mouse: `set` gets its shares to the right and up, from -1 to 1. */
function stick(element, set) {
  const knob = element.querySelector("i");
  let pointer = null;
  const move = (event) => {
    const box = element.getBoundingClientRect();
    const radius = box.width / 2;
    const [x, y] = [(event.clientX - box.left - radius) / radius, (box.top + radius - event.clientY) / radius];
    const far = Math.max(Math.hypot(x, y), 1);
    knob.style.transform = `translate(${(x / far) * radius * 0.6}px, ${(-y / far) * radius * 0.6}px)`;
    set(...[x / far, y / far].map((share) => (Math.abs(share) < AT_REST ? 0 : share)));
  };
  element.onpointerdown = (event) => {
    event.preventDefault();
    pointer = event.pointerId;
    element.setPointerCapture(pointer);
    move(event);
  };
  element.onpointermove = (event) => { if (event.pointerId === pointer) move(event); };
  element.onpointerup = element.onpointercancel = (event) => {
    if (event.pointerId !== pointer) return;
    pointer = null;
    knob.style.transform = "";
    set(0, 0);
  };
}

/**
 * Shows the sticks where fingers can reach them. `axes`: whether the policy walks forward, to the side, and turns.
 * Returns their present command.
 */
function sticks([forward, aside, turn]) {
  const command = [0, 0, 0];
  $("sticks").hidden = !matchMedia("(any-pointer: coarse)").matches;
  $("stick-walk").hidden = !forward && !turn;
  $("stick-aside").hidden = !aside;
  // A share to the right is one of a speed to the right, which is negative.
  stick($("stick-walk"), (x, y) => { [command[0], command[2]] = [forward ? y : 0, turn ? -x : 0]; });
  stick($("stick-aside"), (x) => { command[1] = -x; });
  return command;
}

/** The header with the key in this page's address. */
function authorization() {
  return { authorization: `Bearer ${new URLSearchParams(location.hash.slice(1)).get("key") || ""}` };
}

/**
 * Sends the command of arrow keys, a gamepad or the sticks whenever it changes: shares from -1 to 1, forward, to the left, yaw to
 * the left. `keys`: what they do, in words; `axes`: as for `sticks`.
 */
function steer(keys, axes) {
  const held = new Set();
  const arrows = ["ArrowUp", "ArrowDown", "ArrowLeft", "ArrowRight"];
  document.addEventListener("keydown", (event) => {
    if (arrows.includes(event.code)) event.preventDefault();
    held.add(event.code);
  });
  document.addEventListener("keyup", (event) => held.delete(event.code));
  window.addEventListener("blur", () => held.clear());
  const dragged = sticks(axes);
  const pressed = (...codes) => (codes.some((code) => held.has(code)) ? 1 : 0);
  const commanded_now = () => {
    const aside = pressed("ArrowLeft") - pressed("ArrowRight");
    const shift = pressed("ShiftLeft", "ShiftRight");
    const command = [pressed("ArrowUp") - pressed("ArrowDown"), shift * aside, (1 - shift) * aside];
    const add = (shares) => shares.forEach((share, k) => { command[k] = Math.min(Math.max(command[k] + share, -1), 1); });
    add(dragged);
    for (const pad of navigator.getGamepads ? navigator.getGamepads() : []) {
      if (!pad) continue;
      const axis = (k) => (Math.abs(pad.axes[k] || 0) < 0.1 ? 0 : -pad.axes[k]);
      add([axis(1), axis(0), axis(2)]);
    }
    return command;
  };
  let sent = "";
  setInterval(async () => {
    const body = JSON.stringify(commanded_now());
    if (body === sent) return;
    sent = body;
    const reply = await fetch("steer", { method: "POST", body, headers: authorization() }).catch(() => null);
    $("steering").textContent = reply && reply.ok ? keys : reply ? await reply.text() : "The program has ended.";
  }, STEERING);
  $("steering").hidden = false;
  $("steering").textContent = keys;
}

/** Lists the server's environments, and follows the one that is chosen. */
async function follow_server() {
  const choice = $("environment");
  $("source").hidden = false;
  let stop = new AbortController();
  let cut = false;
  choice.onchange = async () => {
    stop.abort();
    const own = (stop = new AbortController());
    cut = false;
    await watch(choice.value, own.signal);
    cut = cut || !own.signal.aborted;
  };
  const list = async () => {
    const reply = await fetch("sessions");
    const sessions = await reply.json();
    const steered = sessions.find((session) => session.steered);
    if (steered && $("steering").hidden) steer(steered.keys, steered.axes);
    const options = sessions.flatMap(({ name, task, envs }) => Array.from({ length: Math.min(envs, 64) }, (_, i) =>
      [`${name}/${i}`, `${name} · ${task.replace("sandgait/", "")} · ${i + 1} of ${envs}`]));
    const known = Array.from(choice.options, (o) => o.value).join();
    if (options.map((o) => o[0]).join() !== known) {
      const before = choice.value;
      choice.replaceChildren(...options.map(([value, label]) => new Option(label, value)));
      if (options.some((o) => o[0] === before)) choice.value = before;
      else if (options.length) choice.onchange();
    }
    // The server has closed the connection, to make room for another viewer, and the session goes on.
    if (cut && options.some((o) => o[0] === choice.value)) choice.onchange();
    if (!options.length) $("status").textContent = "No session yet: make an environment on this server.";
  };
  await list();
  setInterval(() => list().catch(() => { $("status").textContent = "The server does not answer."; }), 2000);
}

async function watch(place, signal) {
  const recording = new Recording();
  Object.assign(player, { recording, prints: new Map(), marked: 0, time: 0 });
  $("status").textContent = "Waiting for its next step.";
  let described = null;
  try {
    const reply = await fetch(`watch/${place}`, { signal, headers: authorization() });
    if (!reply.ok) throw new Error(await reply.text());
    const reader = reply.body.getReader();
    for (let part = await reader.read(); !part.done; part = await reader.read()) {
      recording.feed(part.value);
      const kept = recording.moments.length;
      recording.forget(KEPT);
      player.marked -= kept - recording.moments.length;
      const section = recording.sections[recording.sections.length - 1];
      if (recording.moments.length && section !== described) describe(described = section);
    }
    if (!signal.aborted) $("status").textContent = "This session has ended.";
  } catch (error) {
    if (!signal.aborted) $("status").textContent = `Cannot follow ${place}: ${error.message}`;
  }
}

main();
