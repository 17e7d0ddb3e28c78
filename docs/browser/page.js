/* The page: an arm of the package in MuJoCo, led by a certified network, with a target and links to be dragged. */

import loadMujoco from "@mujoco/mujoco";
import * as three from "three";
import { OrbitControls } from "three/addons/controls/OrbitControls.js";

import { Decay, Policy } from "./policy.js";

const SPRING = 500; // of a link to the mouse [N/m], up to half of it [N]
const SPAN = 12; // of the chart [s]

const element = (id) => document.getElementById(id);
const vector = (values, i) => new three.Vector3(...values.subarray(3 * i, 3 * i + 3));

function poseOf(positions, matrices, i) {
  const [m, p] = [matrices.subarray(9 * i, 9 * i + 9), positions.subarray(3 * i, 3 * i + 3)];
  return new three.Matrix4().set(m[0], m[1], m[2], p[0], m[3], m[4], m[5], p[1], m[6], m[7], m[8], p[2], 0, 0, 0, 1);
}

/** The arm of a scene in MuJoCo, behind its policy. */
class World {
  constructor(mujoco, given) {
    Object.assign(this, { mujoco, given, model: mujoco.MjModel.from_xml_string(given.xml) });
    this.data = new mujoco.MjData(this.model);
    this.trial = new mujoco.MjData(this.model); // for joints where the arm is not
    this.target = Float64Array.from(given.target);
    this.begin();
  }

  /** From home again, towards the present target. */
  begin() {
    const { data, model, given } = this;
    this.mujoco.mj_resetData(model, data);
    data.qpos.set(given.home);
    this.mujoco.mj_forward(model, data);
    this.policy = new Policy(given.numbers, given.home, this.target);
    this.decay = new Decay(given.guarantees, this.policy);
    this.push = null; // of a body, at a point of it: a force, or towards a place; until when
    this.changed = true; // since the way ahead was drawn
  }

  get tip() {
    return vector(this.data.site_xpos, this.given.tip);
  }

  tipAt(q) {
    this.trial.qpos.set(q);
    this.mujoco.mj_kinematics(this.model, this.trial);
    return vector(this.trial.site_xpos, this.given.tip);
  }

  /** Moves the target to a point, or near it, by damped least squares within the joints' limits. */
  aim(wanted) {
    const { low, high, turns } = this.given.numbers.policy;
    const [q, point] = [Float64Array.from(this.target), this.allowed(wanted)];
    for (let round = 0; round < 30; round++) {
      const tip = this.tipAt(q);
      const off = point.clone().sub(tip).clampLength(0, 0.1);
      const rows = Array.from(q, (_, i) => {
        const axis = vector(this.trial.xaxis, i);
        return turns[i] ? axis.cross(tip.clone().sub(vector(this.trial.xanchor, i))) : axis;
      });
      const entry = (r, c) => rows.reduce((sum, row) => sum + row.getComponent(r) * row.getComponent(c), r === c && 1e-4);
      off.applyMatrix3(new three.Matrix3().set(...[0, 1, 2].flatMap((r) => [0, 1, 2].map((c) => entry(r, c)))).invert());
      rows.forEach((row, i) => (q[i] = Math.min(Math.max(q[i] + row.dot(off), low[i]), high[i])));
    }
    this.target = q;
  }

  /** The nearest point above the floor, and in the box for targets where there is one. */
  allowed(point) {
    const { box } = this.given;
    if (!box) return point.clone().setZ(Math.max(point.z, 0.15));
    const frame = poseOf(this.data.site_xpos, this.data.site_xmat, box.site);
    const half = new three.Vector3(...box.half);
    return point.clone().applyMatrix4(frame.clone().invert()).clamp(half.clone().negate(), half).applyMatrix4(frame);
  }

  /** A period of the policy, in steps of the simulation. */
  advance() {
    const { data, policy, decay, given } = this;
    const [before, velocity] = [policy.q, policy.qd];
    const { PERIOD } = given.numbers.policy;
    const moved = decay.target !== this.target;
    policy.step(data.qpos, this.target);
    if (moved) decay.begin();
    else decay.after();
    this.changed ||= moved || policy.pulled;
    decay.target = this.target;
    for (let s = given.step / PERIOD; s < 1 + 1e-9; s += given.step / PERIOD) {
      // The cubic between the references; a servo that is told of the velocity, too, does not lag.
      data.ctrl.set(before.map((q, i) => {
        const [way, begin, end] = [policy.q[i] - q, PERIOD * velocity[i], PERIOD * policy.qd[i]];
        const [b, c] = [3 * way - 2 * begin - end, begin + end - 2 * way];
        return q + s * (begin + s * (b + s * c)) + (given.damping[i] / PERIOD) * (begin + s * (2 * b + 3 * s * c));
      }));
      this.pull();
      this.mujoco.mj_step(this.model, data);
    }
  }

  /** Applies the push, if there is one. */
  pull() {
    const { data } = this;
    if (this.push?.until < data.time) this.push = null;
    data.xfrc_applied.fill(0);
    if (!this.push) return;
    const { body, force, towards } = this.push;
    const at = this.held;
    this.force = force ?? towards.clone().sub(at).multiplyScalar(SPRING).clampLength(0, SPRING / 2);
    const lever = at.sub(vector(data.xipos, body));
    data.xfrc_applied.set([...this.force, ...lever.cross(this.force)], 6 * body);
  }

  /** Where the push acts. */
  get held() {
    return this.push.point.clone().applyMatrix4(poseOf(this.data.xpos, this.data.xmat, this.push.body));
  }

  hold(body, place, more) {
    const point = place.clone().applyMatrix4(poseOf(this.data.xpos, this.data.xmat, body).invert());
    this.push = { body, point, until: Infinity, ...more };
  }
}

/** What is drawn of a scene, and what the mouse does there. */
class Stage {
  constructor() {
    const canvas = element("stage");
    this.renderer = new three.WebGLRenderer({ canvas, antialias: true, alpha: true });
    this.camera = new three.PerspectiveCamera(38, 1, 0.05, 50);
    this.camera.up.set(0, 0, 1);
    this.camera.position.set(0.1, -4.0, 2.4);
    this.controls = new OrbitControls(this.camera, canvas);
    this.controls.target.set(1.0, 0, 0.95);
    this.ray = new three.Raycaster();
    canvas.addEventListener("pointerdown", (event) => this.press(event), { capture: true });
    canvas.addEventListener("pointermove", (event) => this.drag?.(this.onPlane(event)));
    for (const end of ["pointerup", "pointercancel"]) canvas.addEventListener(end, () => this.release());
  }

  show(world) {
    this.world = world;
    this.scene = new three.Scene();
    const sun = new three.DirectionalLight(0xffffff, 1.8);
    sun.position.set(2, -3, 5);
    const grid = new three.GridHelper(6, 24, 0x888888, 0x888888).rotateX(Math.PI / 2);
    Object.assign(grid.material, { transparent: true, opacity: 0.3 });
    this.scene.add(new three.HemisphereLight(0xffffff, 0x8a8a8a, 2), sun, grid);
    this.geoms = world.given.geoms.map(({ id, body, rgba: [r, g, b, a], shape, size }) => {
      const colour = new three.Color().setRGB(r, g, b, three.SRGBColorSpace);
      const look = { color: colour, roughness: 0.55, transparent: a < 1, opacity: a, depthWrite: a === 1 };
      const mesh = new three.Mesh(shapeOf(shape, size), new three.MeshStandardMaterial(look));
      mesh.matrixAutoUpdate = false;
      mesh.userData = { id, body };
      this.scene.add(mesh);
      return mesh;
    });
    const line = (color, opacity) => new three.Line(new three.BufferGeometry(), new three.LineBasicMaterial({ color, transparent: true, opacity }));
    [this.way, this.trace, this.pull] = [line(0x12a594, 1), line(0xe8a200, 1), line(0xe03131, 1)];
    this.ball = new three.Mesh(new three.SphereGeometry(0.04, 24, 16), new three.MeshStandardMaterial({ color: 0x2f9e44, emissive: 0x14501f }));
    this.scene.add(this.way, this.trace, this.pull, this.ball);
    for (const part of [this.way, this.trace, this.pull]) part.frustumCulled = false;
    this.travelled = [];
  }

  at(event) {
    const box = this.renderer.domElement.getBoundingClientRect();
    return new three.Vector2((2 * (event.clientX - box.x)) / box.width - 1, 1 - (2 * (event.clientY - box.y)) / box.height);
  }

  /** Begins to drag the target, or a link of the arm; what is neither turns the view. */
  press(event) {
    this.ray.setFromCamera(this.at(event), this.camera);
    const { origin, direction } = this.ray.ray;
    const { world } = this;
    const near = direction.clone().multiplyScalar(this.ball.position.clone().sub(origin).dot(direction)).add(origin);
    const [hit] = this.ray.intersectObjects(this.geoms.filter((geom) => geom.userData.body > 1));
    let begin;
    if (near.distanceTo(this.ball.position) < 0.07) {
      begin = this.ball.position;
      this.drag = (point) => world.aim(point);
    } else if (hit) {
      begin = hit.point;
      world.hold(hit.object.userData.body, begin, { towards: begin });
      this.drag = (point) => world.push && (world.push.towards = point);
    } else return;
    this.plane = new three.Plane().setFromNormalAndCoplanarPoint(direction, begin);
    this.controls.enabled = false;
    event.target.setPointerCapture(event.pointerId);
  }

  onPlane(event) {
    this.ray.setFromCamera(this.at(event), this.camera);
    return this.ray.ray.intersectPlane(this.plane, new three.Vector3()) ?? this.ball.position;
  }

  release() {
    if (this.drag) this.world.push = null;
    this.drag = null;
    this.controls.enabled = true;
  }

  draw() {
    const { world, renderer, camera } = this;
    const { clientWidth: width, clientHeight: height } = renderer.domElement.parentElement;
    renderer.setPixelRatio(Math.min(devicePixelRatio, 2));
    renderer.setSize(width, height, false);
    camera.aspect = width / height;
    camera.fov = width < height ? 50 : 38;
    camera.updateProjectionMatrix();
    this.controls.update();
    for (const mesh of this.geoms) mesh.matrix.copy(poseOf(world.data.geom_xpos, world.data.geom_xmat, mesh.userData.id));
    this.ball.position.copy(world.tipAt(world.target));
    if (world.changed) redraw(this.way, world.policy.ahead(60, 12).map((q) => world.tipAt(q)));
    world.changed = false;
    this.travelled = [...this.travelled.slice(-600), world.tip];
    redraw(this.trace, this.travelled);
    this.pull.visible = Boolean(world.push);
    if (world.push) redraw(this.pull, [world.held, world.held.addScaledVector(world.force, 3e-3)]);
    renderer.render(this.scene, camera);
  }
}

function redraw(line, points) {
  line.geometry.dispose();
  line.geometry = new three.BufferGeometry().setFromPoints(points);
}

function shapeOf(kind, size) {
  const [a, b, c] = size;
  if (kind === "sphere") return new three.SphereGeometry(a, 24, 16);
  if (kind === "capsule") return new three.CapsuleGeometry(a, 2 * b, 8, 20).rotateX(Math.PI / 2);
  if (kind === "cylinder") return new three.CylinderGeometry(a, a, 2 * b, 32).rotateX(Math.PI / 2);
  if (kind === "box") return new three.BoxGeometry(2 * a, 2 * b, 2 * c);
  const triangles = new three.BufferGeometry();
  triangles.setAttribute("position", new three.Float32BufferAttribute(size, 3));
  triangles.computeVertexNormals();
  return triangles;
}

/** What the arm does, in words. */
function stateOf({ data, policy, push }, far) {
  if (data.ncon) return "touches something, which holds it back: the proof is about the network, not about contact";
  if (push) return "is pulled aside, and pulls the network's state along; it comes back when it is let go";
  if (policy.pulled) return "was pulled aside: the network goes on from where the arm is";
  if (far < 1e-3) return "has arrived within 1 mm";
  if (policy.pace > 0.99) return "moves as the network does";
  return "moves along the network's way, slower: within the limits of its joints, or waiting for them";
}

/** The numbers beside the scene, and their chart. */
class Panel {
  begin({ given }) {
    const { lambda_max, bound } = given.certificate;
    element("proof").textContent = `\u03bb\u2098\u2090\u2093 ${lambda_max.toPrecision(3)} < \u03b3/\u03bc ${bound}: every start ends at the target`;
    element("about").textContent = given.about;
    this.rows = []; // time, distances of network and end effector, bound
  }

  show(world, speed) {
    const { data, decay } = world;
    const far = world.tip.distanceTo(world.tipAt(world.target));
    const [distance, bound] = [decay.distance, decay.bound];
    element("state").textContent = stateOf(world, far);
    element("reach").textContent = `${(1e3 * far).toPrecision(3)} mm from the ball`;
    element("network").textContent = distance < 1e-9 ? "below 1e-9" : `${distance.toPrecision(3)} away, at most ${bound.toPrecision(3)} proved`;
    element("speed").textContent = `${data.time.toFixed(1)} s, ${speed.toFixed(2)} times real time`;
    this.rows = [...this.rows.filter((row) => row[0] > data.time - SPAN), [data.time, distance, far, bound]];
    this.draw(data.time);
  }

  draw(now) {
    const canvas = element("chart");
    const [width, height, ratio] = [canvas.clientWidth, canvas.clientHeight, Math.min(devicePixelRatio, 2)];
    Object.assign(canvas, { width: width * ratio, height: height * ratio });
    const pen = canvas.getContext("2d");
    const colour = (name) => getComputedStyle(document.body).getPropertyValue(name);
    const [left, bottom] = [38, height - 6];
    const across = (time) => left + ((time - now + SPAN) / SPAN) * (width - left);
    const up = (value) => bottom - ((Math.log10(Math.max(value, 1e-4)) + 4) / 6) * (bottom - 8);
    pen.scale(ratio, ratio);
    pen.font = "11px system-ui";
    for (let power = -4; power <= 2; power += 2) {
      pen.strokeStyle = colour("--rule");
      pen.fillStyle = colour("--soft");
      pen.strokeRect(left, up(10 ** power), width - left, 0);
      pen.fillText(power ? `1e${power}` : "1", 4, up(10 ** power) + 4);
    }
    for (const [k, name, dash] of [[3, "--soft", [5, 4]], [2, "--sun", []], [1, "--teal", []]]) {
      Object.assign(pen, { strokeStyle: colour(name), lineWidth: 1.8 });
      pen.setLineDash(dash);
      pen.beginPath();
      for (const row of this.rows) pen.lineTo(across(row[0]), up(row[k]));
      pen.stroke();
    }
  }
}

async function unpacked(id) {
  const bytes = Uint8Array.from(atob(element(id).textContent), (letter) => letter.charCodeAt(0));
  return new Response(new Blob([bytes]).stream().pipeThrough(new DecompressionStream("gzip")));
}

async function main() {
  const given = await (await unpacked("scenes")).json();
  const wasmBinary = await (await unpacked("wasm")).arrayBuffer();
  const mujoco = await loadMujoco({ wasmBinary, locateFile: (path) => path });
  const [stage, panel] = [new Stage(), new Panel()];
  const [page, worlds] = [{ given, Policy, stage }, {}];
  const choose = (name) => {
    page.world = worlds[name] ??= new World(mujoco, given[name]);
    stage.show(page.world);
    panel.begin(page.world);
    for (const other of Object.keys(given)) element(other).setAttribute("aria-pressed", other === name);
  };
  for (const name of Object.keys(given)) element(name).onclick = () => choose(name);
  element("again").onclick = () => {
    page.world.begin();
    choose(page.world.given.name);
  };
  element("push").onclick = () => {
    const { world } = page;
    const force = new three.Vector3(0, 150, 0);
    world.hold(world.given.last, world.tip, { force, until: world.data.time + 0.2 });
  };
  choose("free");
  let [last, speed, behind] = [performance.now(), 1, 0];
  const frame = (now) => {
    const period = page.world.given.numbers.policy.PERIOD;
    behind = Math.min(behind + (now - last) / 1e3, 0.1);
    const count = Math.floor(behind / period);
    for (let k = 0; k < count; k++) page.world.advance();
    behind -= count * period;
    if (now > last) speed += 0.05 * ((count * period * 1e3) / (now - last) - speed);
    last = now;
    stage.draw();
    panel.show(page.world, speed);
    page.frames = (page.frames ?? 0) + 1;
    requestAnimationFrame(frame);
  };
  requestAnimationFrame(frame);
  globalThis.page = page; // for tests, and for the curious
}

main().catch((error) => (element("state").textContent = `This browser cannot show it: ${error}`));
