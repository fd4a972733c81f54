"use strict";
// Reads the stream of src/view/recording.rs: blocks of a kind, a length and a content.

/** Parts of a header that a file has once while they stay the same. */
const SAME = ["shapes", "relief"];

/** Sections with their moments; grows as blocks come in. */
class Recording {
  constructor() {
    this.sections = [];
    this.pending = new Uint8Array(0);
    /** Every moment, in order: {section, row}; `at` is its place on the page's clock [s]. */
    this.moments = [];
  }

  /** Takes the next bytes of the stream, however they were cut. */
  feed(bytes) {
    const all = new Uint8Array(this.pending.length + bytes.length);
    all.set(this.pending);
    all.set(bytes, this.pending.length);
    let at = 0;
    while (all.length - at >= 8) {
      const view = new DataView(all.buffer, at);
      const length = view.getUint32(4, true);
      if (all.length - at < 8 + length) break;
      const kind = String.fromCharCode(...all.subarray(at, at + 4));
      this.take(kind, all.slice(at + 8, at + 8 + length));
      at += 8 + length;
    }
    this.pending = all.slice(at);
  }

  take(kind, content) {
    if (kind === "HEAD") {
      const header = JSON.parse(new TextDecoder().decode(content));
      const before = this.sections[this.sections.length - 1];
      for (const part of SAME.filter((name) => header[name] === "as before")) header[part] = before?.header[part];
      this.sections.push(new Section(header));
    } else if (kind === "ROWS" && this.sections.length) {
      const section = this.sections[this.sections.length - 1];
      const numbers = new Float32Array(content.buffer, 0, content.length / 4);
      for (let k = 0; k + section.width <= numbers.length; k += section.width) {
        this.append(section, numbers.subarray(k, k + section.width));
      }
    } else {
      throw new Error("this is no recording of sandgait");
    }
  }

  append(section, row) {
    const last = this.moments[this.moments.length - 1];
    const step = 1 / section.header.rate;
    let at = 0;
    if (last) {
      // Within a section time is the robot's; between sections a step passes.
      const passed = section === last.section ? section.get(row, "time")[0] - section.get(last.row, "time")[0] : step;
      at = last.at + (passed > 0 ? passed : step);
    }
    this.moments.push({ section, row, at });
  }

  /** Drops all but the last `count` moments. */
  forget(count) {
    if (this.moments.length <= 1.5 * count) return;
    this.moments.splice(0, this.moments.length - count);
    this.sections = this.sections.slice(this.sections.indexOf(this.moments[0].section));
  }

  get start() { return this.moments.length ? this.moments[0].at : 0; }
  get end() { return this.moments.length ? this.moments[this.moments.length - 1].at : 0; }

  /** Number of the last moment at or before `time`. */
  index(time) {
    let [low, high] = [0, this.moments.length - 1];
    while (low < high) {
      const middle = (low + high + 1) >> 1;
      if (this.moments[middle].at <= time) low = middle; else high = middle - 1;
    }
    return low;
  }
}

/** Moments of one robot; rows are Float32Array. */
class Section {
  constructor(header) {
    if (header.format !== "sandgait recording" || header.version !== 1) {
      throw new Error("this is no recording that this page can read");
    }
    this.header = header;
    this.places = new Map();
    let at = 0;
    for (const column of header.columns) {
      const length = column.shape.reduce((product, n) => product * n, 1);
      this.places.set(column.name, [at, at + length]);
      at += length;
    }
    this.width = at;
  }

  /** The numbers of column `name` in a row; empty if there is no such column. */
  get(row, name) {
    const place = this.places.get(name);
    return place ? row.subarray(place[0], place[1]) : row.subarray(0, 0);
  }

  /** The sand's heights around the robot in sand with memory; null without it. */
  sand(row) {
    const [x, y, spacing] = this.get(row, "sand_frame");
    const heights = this.get(row, "sand_heights");
    return spacing > 0 ? { x, y, spacing, side: Math.sqrt(heights.length), heights } : null;
  }

  /** Names of the reward's terms. */
  get terms() {
    const names = this.header.columns.map((c) => c.name);
    const first = names.indexOf("reward") + 1;
    return names.slice(first, first + this.header.reward_terms);
  }

  /**
   * Positions and turns of all bodies (THREE.Vector3, THREE.Quaternion) `share` of the way from row `a` to row `b`.
   */
  pose(a, b, share) {
    const mix = (name, k) => {
      const [x, y] = [this.get(a, name)[k], this.get(b, name)[k]];
      return x + (y - x) * share;
    };
    // Hips turn on and on: an angle that jumps by whole turns did not move that far.
    const angle = (k) => {
      const [x, y] = [this.get(a, "angles")[k], this.get(b, "angles")[k]];
      const turn = 2 * Math.PI;
      return x + (y - x - turn * Math.round((y - x) / turn)) * share;
    };
    const turn = (row, name, at) => quaternion(this.get(row, name).subarray(at, at + 4));
    const bodies = [{
      position: new THREE.Vector3(mix("position", 0), mix("position", 1), mix("position", 2)),
      turn: turn(a, "orientation", 0).slerp(turn(b, "orientation", 0), share),
    }];
    this.header.bodies.slice(1).forEach((body, joint) => {
      const parent = bodies[body.parent];
      const position = new THREE.Vector3(...body.joint).applyQuaternion(parent.turn).add(parent.position);
      const turned = parent.turn.clone();
      if (body.turn) turned.multiply(quaternion(body.turn));
      const axis = new THREE.Vector3(...body.axis);
      if (body.slides) {
        position.addScaledVector(axis.applyQuaternion(turned), mix("angles", joint));
      } else {
        turned.multiply(new THREE.Quaternion().setFromAxisAngle(axis, angle(joint)));
      }
      bodies.push({ position, turn: turned });
    });
    const moving = this.header.obstacles.filter((o) => o.moves).length;
    const objects = Array.from({ length: moving }, (_, i) => ({
      position: new THREE.Vector3(mix("objects", 7 * i), mix("objects", 7 * i + 1), mix("objects", 7 * i + 2)),
      turn: turn(a, "objects", 7 * i + 3).slerp(turn(b, "objects", 7 * i + 3), share),
    }));
    return { bodies, objects };
  }

  /** Number of forces that a moment has: on segments, or on bodies of a robot from a file. */
  get pushed() {
    const { segments, touching } = this.header;
    return touching && this.places.has("ground_forces") ? touching.length : segments.length;
  }

  /** These forces [N] and where they act (THREE.Vector3), for bodies of `pose`. */
  forces(row, bodies) {
    const force = this.get(row, "ground_forces");
    if (!force.length) return { force: this.get(row, "forces"), at: this.segments(bodies) };
    const point = this.get(row, "ground_points");
    const at = Array.from({ length: point.length / 3 }, (_, k) => new THREE.Vector3(...point.subarray(3 * k, 3 * k + 3)));
    return { force, at };
  }

  /** The world position of each segment, for bodies of `pose`. */
  segments(bodies) {
    return this.header.segments.map((s) =>
      new THREE.Vector3(...s.center).applyQuaternion(bodies[s.body].turn).add(bodies[s.body].position));
  }
}

function quaternion([w, x, y, z]) { return new THREE.Quaternion(x, y, z, w); }

/** The bytes of a page's own recording, unpacked. */
async function embedded(text) {
  const packed = Uint8Array.from(atob(text.trim()), (c) => c.charCodeAt(0));
  const stream = new Blob([packed]).stream().pipeThrough(new DecompressionStream("gzip"));
  return new Uint8Array(await new Response(stream).arrayBuffer());
}
