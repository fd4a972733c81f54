"use strict";
// The scene: sand with footprints, robot, rocks, forces. x is forward, z is up from the surface; all of it is tilted so
// that gravity points down.

/** Side of a cell of the sand's height field [m], and how many there are along x and y. */
const CELL = 0.004;
const CELLS = [220, 130];

/** Deepest print that is drawn [m], and looks between two moments: a drawing, because the sand's surface is not computed. */
const DEEPEST = 0.012;
const LOOKS = 3;

/** Most cells with prints that are kept. */
const MOST_PRINTS = 200000;

const LEG_TINTS = { A: 0x226eb2, B: 0x609e60 };

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
    this.mesh = new THREE.Mesh(this.geometry, this.material);
    this.mesh.receiveShadow = true;
    this.mesh.frustumCulled = false;
    group.add(this.mesh);
    this.frame = new THREE.Mesh(new THREE.BufferGeometry(), this.material);
    this.frame.frustumCulled = false;
    group.add(this.frame);
    this.shown = "";
  }

  /** Moves the field under (x, y) and shows the prints made until `time`. */
  show(prints, x, y, time) {
    const [nx, ny] = CELLS;
    const [i0, j0] = [Math.round(x / CELL / 10) * 10 - nx / 2, Math.round(y / CELL / 10) * 10 - ny / 2];
    const state = `${i0} ${j0} ${prints ? prints.changed : "none"} ${prints ? Math.floor(time * 25) : ""}`;
    if (state === this.shown) return;
    this.shown = state;
    this.heights.fill(0);
    if (prints) {
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
        const [x, y] = [(i0 + i) * CELL, (j0 + j) * CELL];
        position.setXYZ(k, x, y, h[k]);
        const dx = i > 0 && i < nx ? (h[k + 1] - h[k - 1]) / (2 * CELL) : 0;
        const dy = j > 0 && j < ny ? (h[k + row] - h[k - row]) / (2 * CELL) : 0;
        const length = Math.hypot(dx, dy, 1);
        normal.setXYZ(k, -dx / length, -dy / length, 1 / length);
        const dark = 1 + 22 * h[k];
        color.setXYZ(k, 0.83 * dark, 0.72 * dark, 0.52 * dark);
        uv.setXY(k, x * 10, y * 10);
      }
    }
    for (const attribute of [position, normal, color, uv]) attribute.needsUpdate = true;
  }

  surround(i0, j0) {
    const [nx, ny] = CELLS;
    const [x0, x1, y0, y1] = [i0 * CELL, (i0 + nx) * CELL, j0 * CELL, (j0 + ny) * CELL];
    const far = 6;
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

/** Robot and rocks of one section, as meshes. */
class Figures {
  constructor(section, group) {
    this.group = new THREE.Group();
    group.add(this.group);
    const { header } = section;
    const paint = (color) => new THREE.MeshStandardMaterial({ color, roughness: 0.7 });
    this.bodies = header.bodies.map((body) => {
      const tint = body.leg === null ? 0x565e6a : LEG_TINTS[header.legs[body.leg].tripod];
      const part = new THREE.Group();
      for (const piece of body.pieces) part.add(this.strip(piece, paint(tint)));
      this.group.add(part);
      return part;
    });
    this.trunk(header, paint);
    this.objects = [];
    for (const obstacle of header.obstacles) {
      const mesh = new THREE.Mesh(shape(obstacle), paint(0x968e86));
      mesh.position.set(...obstacle.position);
      const [w, x, y, z] = obstacle.orientation;
      mesh.quaternion.set(x, y, z, w);
      this.group.add(mesh);
      if (obstacle.moves) this.objects.push(mesh);
    }
    this.group.traverse((o) => { o.castShadow = o.receiveShadow = Boolean(o.isMesh); });
  }

  strip(piece, material) {
    const mesh = new THREE.Mesh(new THREE.BoxGeometry(piece.size[0], piece.size[1], 0.002), material);
    const [along, across] = [new THREE.Vector3(...piece.along), new THREE.Vector3(...piece.across)];
    const basis = new THREE.Matrix4().makeBasis(along, across, along.clone().cross(across));
    mesh.quaternion.setFromRotationMatrix(basis);
    mesh.position.set(...piece.center);
    return mesh;
  }

  /** The base, its front, and what holds the hips. */
  trunk(header, paint) {
    const [length, width, height] = header.base;
    const trunk = this.bodies[0];
    trunk.add(new THREE.Mesh(new THREE.BoxGeometry(length, width, height), paint(0x7c8696)));
    const front = new THREE.Mesh(new THREE.BoxGeometry(0.006, 0.7 * width, 0.6 * height), paint(0xce7030));
    front.position.x = length / 2;
    trunk.add(front);
    for (const body of header.bodies.filter((b) => b.parent === 0)) {
      const hip = new THREE.Vector3(...body.joint);
      const side = new THREE.Vector3(hip.x, Math.sign(hip.y) * width / 2, hip.z);
      const axle = new THREE.Mesh(new THREE.CylinderGeometry(0.003, 0.003, 1, 10), paint(0x3a4048));
      axle.scale.y = Math.max(hip.distanceTo(side) + 0.005, 1e-4);
      axle.position.copy(hip).add(side).multiplyScalar(0.5);
      axle.quaternion.setFromUnitVectors(new THREE.Vector3(0, 1, 0), hip.clone().sub(side).normalize());
      trunk.add(axle);
    }
  }

  place({ bodies, objects }) {
    const set = (mesh, at) => { mesh.position.copy(at.position); mesh.quaternion.copy(at.turn); };
    this.bodies.forEach((mesh, k) => set(mesh, bodies[k]));
    this.objects.forEach((mesh, k) => set(mesh, objects[k]));
  }
}

function shape(obstacle) {
  if (obstacle.radius !== null) return new THREE.SphereGeometry(obstacle.radius, 24, 16);
  const geometry = new THREE.BufferGeometry();
  const points = obstacle.faces.flatMap((face) => face.flatMap((i) => obstacle.corners[i]));
  geometry.setAttribute("position", new THREE.BufferAttribute(new Float32Array(points), 3));
  geometry.computeVertexNormals();
  return geometry;
}

/** An arrow a segment: where the sand pushes, how hard and which way. */
class Arrows {
  constructor(section, group) {
    const count = Math.max(section.header.segments.length, 1);
    const material = new THREE.MeshBasicMaterial({ color: 0xc81e3c });
    const shaft = new THREE.CylinderGeometry(0.0009, 0.0009, 1, 6);
    shaft.translate(0, 0.5, 0);
    this.shafts = new THREE.InstancedMesh(shaft, material, count);
    this.heads = new THREE.InstancedMesh(new THREE.ConeGeometry(0.0028, 0.008, 10), material, count);
    for (const mesh of [this.shafts, this.heads]) {
      mesh.frustumCulled = false;
      group.add(mesh);
    }
    const weight = section.header.mass * Math.hypot(...section.header.gravity);
    /** [m/N]: half a metre for the robot's weight, because many segments share it. */
    this.scale = 0.5 / weight;
  }

  show(section, row, places) {
    const forces = section.get(row, "forces");
    const [up, force, turn] = [new THREE.Vector3(0, 1, 0), new THREE.Vector3(), new THREE.Quaternion()];
    const [matrix, none] = [new THREE.Matrix4(), new THREE.Matrix4().makeScale(0, 0, 0)];
    places.forEach((at, k) => {
      force.set(forces[3 * k], forces[3 * k + 1], forces[3 * k + 2]);
      const length = force.length() * this.scale;
      if (length < 0.001) {
        this.shafts.setMatrixAt(k, none);
        return this.heads.setMatrixAt(k, none);
      }
      turn.setFromUnitVectors(up, force.normalize());
      this.shafts.setMatrixAt(k, matrix.compose(at, turn, new THREE.Vector3(1, length, 1)));
      const tip = at.clone().addScaledVector(force, length);
      this.heads.setMatrixAt(k, matrix.compose(tip, turn, new THREE.Vector3(1, Math.min(1, length / 0.012), 1)));
    });
    this.shafts.instanceMatrix.needsUpdate = this.heads.instanceMatrix.needsUpdate = true;
  }

  set visible(on) { this.shafts.visible = this.heads.visible = on; }
}

/** Everything on the stage. */
class World {
  constructor(canvas) {
    this.canvas = canvas;
    this.renderer = new THREE.WebGLRenderer({ canvas, antialias: true, preserveDrawingBuffer: true });
    this.renderer.shadowMap.enabled = true;
    this.scene = new THREE.Scene();
    this.scene.background = new THREE.Color(0xe8eef3);
    this.scene.fog = new THREE.Fog(0xe8eef3, 1.5, 4.5);
    this.tilted = new THREE.Group();
    this.scene.add(this.tilted, new THREE.HemisphereLight(0xffffff, 0xb09a70, 1.9));
    this.sun = new THREE.DirectionalLight(0xfff4e0, 2.2);
    this.sun.castShadow = true;
    this.sun.shadow.mapSize.set(1024, 1024);
    const reach = { left: -0.3, right: 0.3, top: 0.3, bottom: -0.3, near: 0.1, far: 3 };
    Object.assign(this.sun.shadow.camera, reach);
    this.sun.shadow.bias = -0.0005;
    this.scene.add(this.sun, this.sun.target);
    this.camera = new THREE.PerspectiveCamera(35, 1, 0.01, 20);
    this.camera.up.set(0, 0, 1);
    this.controls = new THREE.OrbitControls(this.camera, canvas);
    this.controls.maxPolarAngle = 1.52;
    this.controls.maxDistance = 3;
    this.sand = new Sand(this.tilted);
    this.camera.position.set(0.16, -0.5, 0.3);
    this.section = null;
    this.layers = { arrows: true, prints: true, glass: false, follow: true };
  }

  /** Another robot, or another episode. */
  enter(section) {
    if (this.figures) this.tilted.remove(this.figures.group, this.arrows.shafts, this.arrows.heads);
    this.figures = new Figures(section, this.tilted);
    this.arrows = new Arrows(section, this.tilted);
    this.section = section;
    const down = new THREE.Vector3(...section.header.gravity).normalize();
    this.tilted.quaternion.setFromUnitVectors(down.negate(), new THREE.Vector3(0, 0, 1));
  }

  /** Shows the moment `share` of the way from `a` to `b`, at `time` of the page's clock. */
  show(prints, a, b, share, time) {
    if (a.section !== this.section) this.enter(a.section);
    const { section } = this;
    const pose = section.pose(a.row, b.row, share);
    this.figures.place(pose);
    this.arrows.visible = this.layers.arrows;
    this.arrows.show(section, share < 0.5 ? a.row : b.row, section.segments(pose.bodies));
    this.sand.glass = this.layers.glass;
    const at = pose.bodies[0].position;
    this.sand.show(this.layers.prints ? prints : null, at.x, at.y, time);
    this.tilted.updateMatrixWorld();
    const place = this.tilted.localToWorld(new THREE.Vector3(at.x, at.y, 0.02));
    if (!this.target || this.layers.follow) {
      const moved = place.clone().sub(this.controls.target);
      this.camera.position.add(moved);
      this.controls.target.copy(place);
      this.target = place;
    }
    this.sun.target.position.copy(place);
    this.sun.position.copy(place).add(new THREE.Vector3(0.45, -0.7, 1.2));
    this.pose = pose;
  }

  draw() {
    const [width, height] = [this.canvas.clientWidth, this.canvas.clientHeight];
    const ratio = Math.min(window.devicePixelRatio || 1, 2);
    const size = `${width} ${height} ${ratio}`;
    if (size !== this.size && width && height) {
      this.size = size;
      this.renderer.setPixelRatio(ratio);
      this.renderer.setSize(width, height, false);
      this.camera.aspect = width / height;
      this.camera.updateProjectionMatrix();
    }
    this.controls.update();
    this.renderer.render(this.scene, this.camera);
  }
}
