"use strict";
// The sand: its surface around the robot, and footprints on it.

/** Side of a cell of the sand's height field [m], and how many there are along x and y. */
const CELL = 0.004;
const CELLS = [220, 130];

/** Deepest print that is drawn [m], and number of looks between two moments. Prints are drawn, not computed. */
const DEEPEST = 0.012;
const LOOKS = 3;

/** Most cells with prints that are kept. */
const MOST_PRINTS = 200000;

/** Factor on the side of the drawn field where the ground is not flat, because only the field shows it. */
const WIDER = 2;

/** Where legs and belly were under the surface, by cell: when first, and how deep at most. */
class Prints {
  constructor() {
    this.cells = new Map();
    this.changed = 0;
  }

  static key(x, y) { return (x + 1048576) * 4194304 + (y + 1048576); }

  mark(x, y, depth, time) {
    const key = Prints.key(Math.round(x / CELL), Math.round(y / CELL));
    const cell = this.cells.get(key);
    if (!cell) {
      this.cells.set(key, [time, Math.min(depth, DEEPEST)]);
      if (this.cells.size > MOST_PRINTS) this.cells.delete(this.cells.keys().next().value);
    } else if (depth > cell[1]) {
      cell[1] = Math.min(depth, DEEPEST);
    }
    this.changed += 1;
  }

  /** Marks what happened from moment `a` to moment `b` of a section, unless moments between them are missing. */
  add(section, a, b) {
    if (b.at - a.at > 2.5 / section.header.rate) return;
    for (let look = 0; look < LOOKS; look += 1) {
      const { bodies } = section.pose(a.row, b.row, look / LOOKS);
      const time = a.at + (b.at - a.at) * (look / LOOKS);
      const places = section.segments(bodies);
      section.header.segments.forEach((segment, k) => {
        const p = places[k];
        if (p.z >= 0) return;
        const piece = section.header.bodies[segment.body].pieces[0];
        if (!piece) return this.mark(p.x, p.y, -p.z, time);
        const across = new THREE.Vector3(...piece.across).applyQuaternion(bodies[segment.body].turn);
        for (const part of [-0.4, 0, 0.4]) {
          const q = p.clone().addScaledVector(across, part * piece.size[1]);
          this.mark(q.x, q.y, -q.z, time);
        }
      });
    }
  }
}

/** Grains, and a line every tenth of a metre, as a texture that repeats. */
function grains() {
  const canvas = document.createElement("canvas");
  canvas.width = canvas.height = 256;
  const context = canvas.getContext("2d");
  const image = context.createImageData(256, 256);
  let seed = 1;
  for (let k = 0; k < 65536; k += 1) {
    seed = (seed * 1103515245 + 12345) % 2147483648;
    const light = 232 + (seed / 2147483648) * 23;
    image.data.set([light, light, light, 255], 4 * k);
  }
  context.putImageData(image, 0, 0);
  context.fillStyle = "rgba(110, 85, 45, 0.45)";
  context.fillRect(0, 0, 256, 2);
  context.fillRect(0, 0, 2, 256);
  const texture = new THREE.CanvasTexture(canvas);
  texture.wrapS = texture.wrapT = THREE.RepeatWrapping;
  texture.anisotropy = 4;
  return texture;
}

/** Largest number of pieces of hard ground, as in src/sim/tree/hard.rs, and the slope beyond their edges. */
const MOST_HARD = 8;
const EDGE = 2;

/** Share of grey at a place, as in src/view/hard.rs: of each piece [centre, size] and [distance of copies, depth]. */
const HARD_GROUND = `
uniform vec4 pieces[${MOST_HARD}];
uniform vec3 copies[${MOST_HARD}];
uniform int count;
varying vec2 place;
float hardness() {
  float share = 0.0;
  vec2 blur = fwidth(place);
  for (int k = 0; k < count; k += 1) {
    vec2 size = pieces[k].zw, every = max(copies[k].xy, 1e-3), again = step(1e-3, copies[k].xy);
    float depth = copies[k].z;
    vec2 at = place - pieces[k].xy;
    vec2 outside = max(abs(at - again * round(at / every) * every) - 0.5 * size, 0.0);
    bool flank = depth <= 0.0 && depth + ${EDGE}.0 * (outside.x + outside.y) <= 0.0;
    vec2 sharp = flank ? vec2(1.0) : 1.0 - step(1e-6, outside);
    vec2 along = mix(sharp, size / every, again * min(max(blur.x, blur.y) / every, 1.0));
    share = max(share, (depth <= 0.0 ? 1.0 : 0.4) * along.x * along.y);
  }
  return share;
}
`;

/** Paints pieces of hard ground grey. Gives the function that changes the pieces. */
function with_hard_ground(material) {
  const [pieces, copies, count] = [new Float32Array(4 * MOST_HARD), new Float32Array(3 * MOST_HARD), { value: 0 }];
  material.onBeforeCompile = (shader) => {
    Object.assign(shader.uniforms, { pieces: { value: pieces }, copies: { value: copies }, count });
    const after = (text, part, added) => text.replace(`#include <${part}>`, `#include <${part}>\n${added}`);
    shader.vertexShader = `varying vec2 place;\n${after(shader.vertexShader, "begin_vertex", "place = position.xy;")}`;
    const grey = `vec3 grey = vec3(0.55, 0.6, 0.72) * dot(diffuseColor.rgb, vec3(0.2126, 0.7152, 0.0722));
      diffuseColor.rgb = mix(diffuseColor.rgb, grey, hardness());`;
    shader.fragmentShader = HARD_GROUND + after(shader.fragmentShader, "color_fragment", grey);
  };
  return (hard) => {
    count.value = hard.length;
    hard.forEach(({ center, size, every, depth }, k) => {
      pieces.set([...center, ...size], 4 * k);
      copies.set([...every, depth], 3 * k);
    });
  };
}

/** Is a piece of hard ground endless, so that there is no sand? As in src/sim/tree/hard.rs. */
function everywhere({ size, depth }) { return Math.min(...size) >= 1e5 && depth <= 0; }

/** How far hard ground rises above the sand [m]. */
function rise(hard, x, y) {
  const top = ({ center, size, every, depth }) => [x, y].reduce((sum, at, k) => {
    const from = at - center[k];
    const outside = Math.abs(from - (every[k] ? Math.round(from / every[k]) * every[k] : 0)) - size[k] / 2;
    return sum - EDGE * Math.max(outside, 0);
  }, -depth);
  return Math.max(0, ...hard.map(top));
}

/** The surface: a height field around the robot, and a flat frame around that. */
class Sand {
  constructor(group) {
    const [nx, ny] = CELLS;
    const count = (nx + 1) * (ny + 1);
    this.heights = new Float32Array(count);
    this.geometry = new THREE.BufferGeometry();
    const attribute = (n) => new THREE.BufferAttribute(new Float32Array(count * n), n);
    for (const [name, n] of [["position", 3], ["normal", 3], ["color", 3], ["uv", 2]]) {
      this.geometry.setAttribute(name, attribute(n));
    }
    const index = [];
    for (let j = 0; j < ny; j += 1) {
      for (let i = 0; i < nx; i += 1) {
        const a = j * (nx + 1) + i;
        index.push(a, a + 1, a + nx + 2, a, a + nx + 2, a + nx + 1);
      }
    }
    this.geometry.setIndex(index);
    this.material = new THREE.MeshLambertMaterial({ vertexColors: true, map: grains() });
    this.paint = with_hard_ground(this.material);
    this.mesh = new THREE.Mesh(this.geometry, this.material);
    this.mesh.receiveShadow = true;
    this.mesh.frustumCulled = false;
    group.add(this.mesh);
    this.frame = new THREE.Mesh(new THREE.BufferGeometry(), this.material);
    this.frame.frustumCulled = false;
    group.add(this.frame);
    this.enter(1);
  }

  /** For a robot of this scale; without `relief` the ground is flat, without `hard` it is sand alone. */
  enter(scale, relief, hard = []) {
    this.cell = CELL * scale * (relief ? WIDER : 1);
    this.relief = relief;
    this.paint(hard);
    this.risen = hard.filter((piece) => piece.depth < 0);
    this.frame.visible = !relief;
    this.far = 6 * scale;
    this.shown = "";
  }

  /** Moves the field under (x, y) and shows the prints made until `time`, or the computed heights `moved`. */
  show(prints, x, y, time, moved = null) {
    const [nx, ny] = CELLS;
    const [i0, j0] = [Math.round(x / this.cell / 10) * 10 - nx / 2, Math.round(y / this.cell / 10) * 10 - ny / 2];
    const clock = prints || moved ? Math.floor(time * 25) : "";
    const state = `${i0} ${j0} ${prints ? prints.changed : "none"} ${clock}`;
    if (state === this.shown) return;
    this.shown = state;
    this.heights.fill(0);
    if (this.relief || this.risen.length) {
      for (let k = 0; k < this.heights.length; k += 1) {
        const [x, y] = [i0 + (k % (nx + 1)), j0 + Math.floor(k / (nx + 1))].map((cell) => cell * this.cell);
        this.heights[k] = (this.relief ? height_at(this.relief, x, y) : 0) + rise(this.risen, x, y);
      }
    } else if (moved) {
      for (let k = 0; k < this.heights.length; k += 1) {
        const [x, y] = [i0 + (k % (nx + 1)), j0 + Math.floor(k / (nx + 1))].map((cell) => cell * this.cell);
        this.heights[k] = moved_height(moved, x, y);
      }
    } else if (prints) {
      for (let j = 1, k = nx + 1; j < ny; j += 1, k = j * (nx + 1)) {
        for (let i = 1; i < nx; i += 1) {
          const cell = prints.cells.get(Prints.key(i0 + i, j0 + j));
          if (cell && cell[0] <= time) this.heights[k + i] = -cell[1];
        }
      }
      this.smooth();
    }
    this.fill(i0, j0);
    this.surround(i0, j0);
  }

  /** Sand does not stand upright: each cell takes some of its neighbours' height. */
  smooth() {
    const [nx, ny] = CELLS;
    const [h, old] = [this.heights, this.heights.slice()];
    const row = nx + 1;
    for (let j = 1; j < ny; j += 1) {
      for (let i = 1; i < nx; i += 1) {
        const k = j * row + i;
        const sides = old[k - 1] + old[k + 1] + old[k - row] + old[k + row];
        const corners = old[k - row - 1] + old[k - row + 1] + old[k + row - 1] + old[k + row + 1];
        h[k] = 0.25 * old[k] + 0.125 * sides + 0.0625 * corners;
      }
    }
  }

  fill(i0, j0) {
    const [nx, ny] = CELLS;
    const row = nx + 1;
    const { position, normal, color, uv } = this.geometry.attributes;
    const h = this.heights;
    for (let j = 0; j <= ny; j += 1) {
      for (let i = 0; i <= nx; i += 1) {
        const k = j * row + i;
        const [x, y] = [(i0 + i) * this.cell, (j0 + j) * this.cell];
        position.setXYZ(k, x, y, h[k]);
        const dx = i > 0 && i < nx ? (h[k + 1] - h[k - 1]) / (2 * this.cell) : 0;
        const dy = j > 0 && j < ny ? (h[k + row] - h[k - row]) / (2 * this.cell) : 0;
        const length = Math.hypot(dx, dy, 1);
        normal.setXYZ(k, -dx / length, -dy / length, 1 / length);
        // Prints are darker; the light shows dunes.
        const dark = 1 + 22 * Math.min(this.relief ? 0 : h[k], 0);
        color.setXYZ(k, 0.83 * dark, 0.72 * dark, 0.52 * dark);
        uv.setXY(k, x * 10, y * 10);
      }
    }
    for (const attribute of [position, normal, color, uv]) attribute.needsUpdate = true;
  }

  surround(i0, j0) {
    const [nx, ny] = CELLS;
    const [x0, x1, y0, y1] = [i0, i0 + nx, j0, j0 + ny].map((k) => k * this.cell);
    const { far } = this;
    const corners = [[x0, y0], [x1, y0], [x1, y1], [x0, y1]];
    const outer = [[x0 - far, y0 - far], [x1 + far, y0 - far], [x1 + far, y1 + far], [x0 - far, y1 + far]];
    const points = [...corners, ...outer];
    const geometry = new THREE.BufferGeometry();
    const set = (name, n, values) =>
      geometry.setAttribute(name, new THREE.BufferAttribute(new Float32Array(values.flat()), n));
    set("position", 3, points.map(([x, y]) => [x, y, 0]));
    set("normal", 3, points.map(() => [0, 0, 1]));
    set("color", 3, points.map(() => [0.83, 0.72, 0.52]));
    set("uv", 2, points.map(([x, y]) => [x * 10, y * 10]));
    const sides = [0, 1, 2, 3].map((k) => [k + 4, ((k + 1) % 4) + 4, (k + 1) % 4, k + 4, (k + 1) % 4, k]);
    geometry.setIndex(sides.flat());
    this.frame.geometry.dispose();
    this.frame.geometry = geometry;
  }

  set glass(on) {
    this.material.transparent = on;
    this.material.opacity = on ? 0.45 : 1;
    this.material.depthWrite = !on;
    this.material.needsUpdate = true;
  }
}

/** Height of sand that was moved [m], bilinear between its nodes; level outside of them. */
function moved_height({ x: x0, y: y0, spacing, side, heights }, x, y) {
  const [u, v] = [(x - x0) / spacing, (y - y0) / spacing];
  const [i, j] = [Math.floor(u), Math.floor(v)];
  if (i < 0 || j < 0 || i + 1 >= side || j + 1 >= side) return 0;
  const [a, b, k] = [u - i, v - j, j * side + i];
  const row = (k) => heights[k] + a * (heights[k + 1] - heights[k]);
  return (1 - b) * row(k) + b * row(k + side);
}

/** Height of the ground [m]: the quadratic B-spline over its nodes, as in src/sim/tree/relief.rs. */
function height_at({ spacing, repeats, heights }, x, y) {
  const along = (at, count) => {
    const node = Math.round(at / spacing);
    const t = at / spacing - node;
    const index = (k) => (repeats ? (((node + k) % count) + count) % count : Math.min(Math.max(node + k, 0), count - 1));
    return [[index(-1), 0.5 * (0.5 - t) ** 2], [index(0), 0.75 - t * t], [index(1), 0.5 * (0.5 + t) ** 2]];
  };
  const columns = along(x, heights[0].length);
  const of_row = (row) => columns.reduce((sum, [i, weight]) => sum + weight * row[i], 0);
  return along(y, heights.length).reduce((sum, [j, weight]) => sum + weight * of_row(heights[j]), 0);
}
