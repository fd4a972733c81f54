"use strict";
// The scene: robot, rocks, forces, and the sand of sand.js. x is forward, z is up from the surface; all of it is tilted so
// that gravity points down.

const LEG_TINTS = { A: 0x226eb2, B: 0x609e60 };
const LINK_TINTS = [0x4682b4, 0x70a470, 0xb08854, 0x9674a0];

/** `radius` of the robot for which distances and lights of the scene are made [m]; others scale them. */
const USUAL = 0.1;

/** Vertical field of view [°]. */
const FIELD = 35;

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
    if (header.shapes) this.shapes(header, paint);
    else this.trunk(header, paint);
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

  /** The shapes of a robot from a file, coloured by the number of joints between body and base. */
  shapes({ bodies, shapes }, paint) {
    const depth = (k) => (bodies[k].parent ? 1 + depth(bodies[k].parent) : 0);
    const meshes = shapes.meshes.map(mesh_of);
    for (const { body, at, form } of shapes.shapes) {
      const material = paint(body ? LINK_TINTS[depth(body) % LINK_TINTS.length] : 0x7c8696);
      const part = new THREE.Group();
      // Meshes may be inside out.
      if (form.mesh !== undefined) Object.assign(material, { flatShading: true, side: THREE.DoubleSide });
      for (const geometry of solids(form, meshes)) part.add(new THREE.Mesh(geometry, material));
      part.position.set(at[0], at[1], at[2]);
      part.quaternion.copy(quaternion(at.slice(3)));
      this.bodies[body].add(part);
    }
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

function mesh_of({ corners, faces }) {
  const geometry = new THREE.BufferGeometry();
  geometry.setAttribute("position", new THREE.BufferAttribute(new Float32Array(corners.flat()), 3));
  geometry.setIndex(faces.flat());
  return geometry;
}

/** Geometries of a shape; cylinders and capsules lie along z. */
function solids(form, meshes) {
  const upright = (g, by) => { g.rotateX(Math.PI / 2); g.translate(0, 0, by); return g; };
  const tube = ({ radius, half_length: h }) => upright(new THREE.CylinderGeometry(radius, radius, 2 * h, 32), 0);
  const ball = (radius, by) => upright(new THREE.SphereGeometry(radius, 32, 16), by);
  if (form.sphere) return [ball(form.sphere.radius, 0)];
  if (form.box) return [new THREE.BoxGeometry(...form.box.half.map((h) => 2 * h))];
  if (form.cylinder) return [tube(form.cylinder)];
  if (form.mesh !== undefined) return [meshes[form.mesh]];
  const { radius, half_length } = form.capsule;
  return [tube(form.capsule), ball(radius, half_length), ball(radius, -half_length)];
}

function shape(obstacle) {
  if (obstacle.radius !== null) return new THREE.SphereGeometry(obstacle.radius, 24, 16);
  const geometry = new THREE.BufferGeometry();
  const points = obstacle.faces.flatMap((face) => face.flatMap((i) => obstacle.corners[i]));
  geometry.setAttribute("position", new THREE.BufferAttribute(new Float32Array(points), 3));
  geometry.computeVertexNormals();
  return geometry;
}

/** One arrow for each force: where the ground pushes, how hard and which way. `size`: of the robot; 1 is usual. */
class Arrows {
  constructor(section, group, size) {
    const count = Math.max(section.pushed, 1);
    this.any = section.pushed > 0;
    this.size = size;
    const material = new THREE.MeshBasicMaterial({ color: 0xc81e3c });
    const shaft = new THREE.CylinderGeometry(0.0009 * size, 0.0009 * size, 1, 6);
    shaft.translate(0, 0.5, 0);
    this.shafts = new THREE.InstancedMesh(shaft, material, count);
    this.heads = new THREE.InstancedMesh(new THREE.ConeGeometry(0.0028 * size, 0.008 * size, 10), material, count);
    for (const mesh of [this.shafts, this.heads]) {
      mesh.frustumCulled = false;
      group.add(mesh);
    }
    const weight = section.header.mass * Math.hypot(...section.header.gravity);
    /** [m/N]: for the usual robot's weight half a metre, because many segments share it; a fifth for robots from files. */
    this.scale = ((section.header.touching ? 0.2 : 0.5) * size) / weight;
  }

  show({ force: forces, at: places }) {
    const [up, force, turn] = [new THREE.Vector3(0, 1, 0), new THREE.Vector3(), new THREE.Quaternion()];
    const [matrix, none] = [new THREE.Matrix4(), new THREE.Matrix4().makeScale(0, 0, 0)];
    places.forEach((at, k) => {
      force.set(forces[3 * k], forces[3 * k + 1], forces[3 * k + 2]);
      const length = force.length() * this.scale;
      if (!(length >= 0.001 * this.size)) {
        this.shafts.setMatrixAt(k, none);
        return this.heads.setMatrixAt(k, none);
      }
      turn.setFromUnitVectors(up, force.normalize());
      this.shafts.setMatrixAt(k, matrix.compose(at, turn, new THREE.Vector3(1, length, 1)));
      const tip = at.clone().addScaledVector(force, length);
      const head = Math.min(1, length / (0.012 * this.size));
      this.heads.setMatrixAt(k, matrix.compose(tip, turn, new THREE.Vector3(1, head, 1)));
    });
    this.shafts.instanceMatrix.needsUpdate = this.heads.instanceMatrix.needsUpdate = true;
  }

  set visible(on) { this.shafts.visible = this.heads.visible = on && this.any; }
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
    this.sun.shadow.bias = -0.0005;
    this.scene.add(this.sun, this.sun.target);
    this.camera = new THREE.PerspectiveCamera(FIELD, 1, 0.01, 20);
    this.camera.up.set(0, 0, 1);
    this.controls = new THREE.OrbitControls(this.camera, canvas);
    this.controls.maxPolarAngle = 1.52;
    this.controls.maxDistance = 3;
    this.sand = new Sand(this.tilted);
    this.camera.position.set(0.16, -0.5, 0.3);
    this.zoom(1);
    this.section = null;
    this.layers = { arrows: true, prints: true, glass: false, follow: true };
  }

  /** Distances for a robot `scale` times as large as the usual one. */
  zoom(scale) {
    const near = this.controls.target;
    this.camera.position.sub(near).multiplyScalar(scale / (this.scale || 1)).add(near);
    this.scale = scale;
    const [side, far] = [0.3 * scale, 3 * scale];
    Object.assign(this.sun.shadow.camera, { left: -side, right: side, top: side, bottom: -side, near: 0.1 * scale, far });
    this.sun.shadow.camera.updateProjectionMatrix();
    Object.assign(this.scene.fog, { near: 1.5 * scale, far: 4.5 * scale });
    this.camera.far = 20 * scale;
    this.camera.updateProjectionMatrix();
    this.controls.maxDistance = 3 * scale;
  }

  /** Another robot, or another episode. */
  enter(section) {
    if (this.figures) this.tilted.remove(this.figures.group, this.arrows.shafts, this.arrows.heads);
    this.figures = new Figures(section, this.tilted);
    this.section = section;
    const { shapes, radius, relief, hard } = section.header;
    this.zoom(shapes ? radius / USUAL : 1);
    this.arrows = new Arrows(section, this.tilted, this.scale);
    this.sand.enter(this.scale, relief, hard);
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
    this.arrows.show(section.forces(share < 0.5 ? a.row : b.row, pose.bodies));
    this.sand.glass = this.layers.glass;
    const at = pose.bodies[0].position;
    this.sand.show(this.layers.prints ? prints : null, at.x, at.y, time, section.sand(share < 0.5 ? a.row : b.row));
    this.tilted.updateMatrixWorld();
    const place = this.tilted.localToWorld(new THREE.Vector3(at.x, at.y, this.middle(at)));
    if (!this.target || this.layers.follow) {
      const moved = place.clone().sub(this.controls.target);
      this.camera.position.add(moved);
      this.controls.target.copy(place);
      this.target = place;
    }
    this.sun.target.position.copy(place);
    this.sun.position.copy(place).add(new THREE.Vector3(0.45, -0.7, 1.2).multiplyScalar(this.scale));
    this.pose = pose;
  }

  /** The height that the camera looks at [m]. */
  middle({ x, y }) {
    const { shapes, radius, relief } = this.section.header;
    return (relief ? height_at(relief, x, y) : 0) + (shapes ? 0.5 * radius : 0.02);
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
      // A narrow picture shows as much from left to right as one of 6 to 5.
      const half = Math.tan((FIELD / 2) * Math.PI / 180) * Math.max(1, 1.2 / this.camera.aspect);
      this.camera.fov = 2 * Math.atan(half) * 180 / Math.PI;
      this.camera.updateProjectionMatrix();
    }
    this.controls.update();
    this.renderer.render(this.scene, this.camera);
  }
}
