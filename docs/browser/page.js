/* The page: an arm of the package in MuJoCo, led by a certified network, with a target and links to be dragged. */

import loadMujoco from "@mujoco/mujoco";
import * as three from "three";
import { OrbitControls } from "three/addons/controls/OrbitControls.js";

import { Policy } from "./policy.js";

const SPRING = 800; // of a link to the mouse [N/m], up to half of it [N]
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
    this.mujoco.mj_resetData(this.model, this.data);
    this.data.qpos.set(this.given.home);
    this.mujoco.mj_forward(this.model, this.data);
    this.policy = new Policy(this.given, this.given.home, this.target);
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

  /** Moves the target to a point of its box, or near it: by damped least squares within limits, near a posture. */
  aim(wanted) {
    const { box, posture, policy: { low, high, turns } } = this.given;
    const [frame, half] = [new three.Matrix4().fromArray(box.frame), new three.Vector3(...box.half)];
    const inside = wanted.clone().applyMatrix4(frame.clone().invert()).clamp(half.clone().negate(), half);
    const [q, point] = [Float64Array.from(this.target), inside.applyMatrix4(frame)];
    for (let round = 0; round < 60; round++) {
      const tip = this.tipAt(q);
      const off = point.clone().sub(tip).clampLength(0, 0.1);
      const back = q.map((value, i) => (round < 40 ? 0.1 : 0) * (posture[i] - value));
      const rows = Array.from(q, (_, i) => {
        const axis = vector(this.trial.xaxis, i);
        return turns[i] ? axis.cross(tip.clone().sub(vector(this.trial.xanchor, i))) : axis;
      });
      rows.forEach((row, i) => off.addScaledVector(row, -back[i]));
      const entry = (r, c) => rows.reduce((sum, row) => sum + row[r] * row[c], r === c ? 1e-4 : 0);
      const square = [..."xyz"].flatMap((r) => [..."xyz"].map((c) => entry(r, c)));
      off.applyMatrix3(new three.Matrix3().set(...square).invert());
      rows.forEach((row, i) => (q[i] = three.MathUtils.clamp(q[i] + back[i] + row.dot(off), low[i], high[i])));
    }
    this.target = q;
  }

  /** A period of the policy, in steps of the simulation. */
  advance() {
    const { data, policy, given } = this;
    const [{ q, qd }, { PERIOD }] = [policy, given.policy];
    this.changed = policy.step(data.qpos, this.target) || this.changed;
    for (let s = given.step / PERIOD; s < 1 + 1e-9; s += given.step / PERIOD) {
      // The cubic between the references; a servo that is told of the velocity, too, does not lag.
      data.ctrl.set(q.map((at, i) => {
        const [way, begin, end] = [policy.q[i] - at, PERIOD * qd[i], PERIOD * policy.qd[i]];
        const [b, c] = [3 * way - 2 * begin - end, begin + end - 2 * way];
        return at + s * (begin + s * (b + s * c)) + (given.damping[i] / PERIOD) * (begin + s * (2 * b + 3 * s * c));
      }));
      this.pull();
      this.mujoco.mj_step(this.model, data);
    }
  }

  /** Begins a push of a body at a place: a force and until when, or towards which place until `push` is null. */
  hold(body, place, more) {
    const point = place.clone().applyMatrix4(poseOf(this.data.xpos, this.data.xmat, body).invert());
    this.push = { body, point, until: Infinity, ...more };
  }

  /** Applies the push. */
  pull() {
    const { data, push } = this;
    data.xfrc_applied.fill(0);
    if (push?.until < data.time) this.push = null;
    if (!this.push) return;
    push.at = push.point.clone().applyMatrix4(poseOf(data.xpos, data.xmat, push.body));
    push.acts = push.force ?? push.towards.clone().sub(push.at).multiplyScalar(SPRING).clampLength(0, SPRING / 2);
    const lever = push.at.clone().sub(vector(data.xipos, push.body));
    data.xfrc_applied.set([...push.acts, ...lever.cross(push.acts)], 6 * push.body);
  }
}

function shapeOf(kind, size) {
  const [a, b, c] = size;
  if (kind === "cylinder") return new three.CylinderGeometry(a, a, 2 * b, 32).rotateX(Math.PI / 2);
  if (kind === "box") return new three.BoxGeometry(2 * a, 2 * b, 2 * c);
  const triangles = new three.BufferGeometry().setAttribute("position", new three.Float32BufferAttribute(size, 3));
  triangles.computeVertexNormals();
  return triangles;
}

/** What is drawn of a scene, and what the mouse does there. */
class Stage {
  constructor() {
    const canvas = element("stage");
    this.renderer = new three.WebGLRenderer({ canvas, antialias: true, alpha: true });
    this.camera = new three.PerspectiveCamera(38, 1, 0.05, 50);
    this.camera.up.set(0, 0, 1);
    this.camera.position.set(3.8, -3.1, 2.4);
    this.controls = new OrbitControls(this.camera, canvas);
    this.controls.target.set(1.25, 0, 0.95);
    this.ray = new three.Raycaster();
    this.ball = new three.Mesh(new three.SphereGeometry(0.04), new three.MeshStandardMaterial({ color: 0x2f9e44 }));
    canvas.addEventListener("pointerdown", (event) => this.press(event), { capture: true });
    canvas.addEventListener("pointermove", (event) => this.drag?.(this.aimed(event)));
    canvas.onpointerup = canvas.onpointercancel = () => {
      if (this.drag) this.world.push = null;
      this.drag = null;
      this.controls.enabled = true;
    };
  }

  show(world) {
    this.world = world;
    this.scene = new three.Scene();
    const sun = new three.DirectionalLight(0xffffff, 1.8);
    sun.position.set(2, -3, 5);
    const grid = new three.GridHelper(6, 24, 0x888888, 0x888888).rotateX(Math.PI / 2);
    Object.assign(grid.material, { transparent: true, opacity: 0.3 });
    this.geoms = world.given.geoms.map(({ id, body, rgba: [r, g, b, opacity], shape, size }) => {
      const color = new three.Color().setRGB(r, g, b, three.SRGBColorSpace);
      const look = { color, opacity, roughness: 0.55, transparent: opacity < 1, depthWrite: opacity === 1 };
      const mesh = new three.Mesh(shapeOf(shape, size), new three.MeshStandardMaterial(look));
      return Object.assign(mesh, { matrixAutoUpdate: false, userData: { id, body } });
    });
    const line = (color) => {
      const geometry = new three.BufferGeometry();
      const dots = new three.Points(geometry, new three.PointsMaterial({ color, size: 4, sizeAttenuation: false }));
      dots.frustumCulled = false;
      const line = new three.Line(geometry, new three.LineBasicMaterial({ color }));
      return Object.assign(line.add(dots), { frustumCulled: false });
    };
    Object.assign(this, { way: line(0x12a594), trace: line(0xe8a200), arrow: line(0xe03131) });
    const edges = new three.EdgesGeometry(new three.BoxGeometry(...world.given.box.half.map((half) => 2 * half)));
    const box = new three.LineSegments(edges, new three.LineBasicMaterial({ color: 0x2f9e44 }));
    box.visible = world.given.name === "window";
    box.applyMatrix4(new three.Matrix4().fromArray(world.given.box.frame));
    const sky = new three.HemisphereLight(0xffffff, 0x8a8a8a, 2);
    this.scene.add(sky, sun, grid, ...this.geoms, this.way, this.trace, this.arrow, this.ball, box);
    this.travelled = Array(600).fill(world.tip);
  }

  /** The ray from the eye to where the mouse is. */
  aimed(event) {
    const box = this.renderer.domElement.getBoundingClientRect();
    const [x, y] = [(event.clientX - box.x) / box.width, (event.clientY - box.y) / box.height];
    this.ray.setFromCamera(new three.Vector2(2 * x - 1, 1 - 2 * y), this.camera);
    return this.ray.ray;
  }

  /** Begins to drag the target, or a link of the arm; what is neither turns the view. */
  press(event) {
    const { world, ball } = this;
    const near = this.aimed(event).distanceToPoint(ball.position) < 0.07;
    const [hit] = this.ray.intersectObjects(this.geoms.filter((geom) => geom.userData.body > 1));
    if (!near && !hit) return;
    const place = near ? ball.position.clone() : hit.point;
    const plane = new three.Plane().setFromNormalAndCoplanarPoint(this.ray.ray.direction, place);
    if (!near) world.hold(hit.object.userData.body, place, { towards: place });
    this.drag = (ray) => ray.intersectPlane(plane, place) && near && world.aim(place);
    this.controls.enabled = false;
    event.target.setPointerCapture(event.pointerId);
  }

  draw() {
    const { world, world: { data }, renderer, camera } = this;
    const { clientWidth: width, clientHeight: height } = renderer.domElement;
    renderer.setDrawingBufferSize(width, height, Math.min(devicePixelRatio, 2));
    Object.assign(camera, { aspect: width / height, fov: width < height ? 50 : 38 }).updateProjectionMatrix();
    this.controls.update();
    for (const { matrix, userData: { id } } of this.geoms) matrix.copy(poseOf(data.geom_xpos, data.geom_xmat, id));
    if (world.changed) this.way.geometry.setFromPoints(world.policy.ahead(60, 12).map((q) => world.tipAt(q)));
    world.changed = false;
    this.travelled = [...this.travelled.slice(1), world.tip];
    this.trace.geometry.setFromPoints(this.travelled);
    const { at = world.tip, acts = at } = world.push ?? {};
    this.arrow.geometry.setFromPoints([at, at.clone().addScaledVector(acts, world.push ? 3e-3 : 0)]);
    this.ball.position.copy(world.tipAt(world.target));
    renderer.render(this.scene, camera);
  }
}

/** What the arm does, in words. */
function stateOf({ data, policy, push }, far) {
  if (data.ncon) return "touches something, which holds it back: the proof is about the network, not about contact";
  if (push) return "is pulled aside, and pulls the network's state along; it comes back when it is let go";
  if (far < 1e-3) return "has arrived within 1 mm";
  return policy.pace > 0.99 ? "moves as the network does" : "moves along the network's way, as fast as its joints can";
}

/** Shows the last row of time, the network's distance, its bound, the end effector's distance, clock; charts all. */
function tell(world, rows) {
  const [now, distance, bound, far, clock] = rows.at(-1);
  const size = (value) => (value < 1e-6 ? "less than 1e-6" : Number(value.toPrecision(3)));
  const speed = rows.length > 1 ? (1e3 * (now - rows[0][0])) / (clock - rows[0][4]) : 1;
  element("state").textContent = stateOf(world, far);
  element("reach").textContent = `${far < 1e-6 ? "less than 0.001" : size(1e3 * far)} mm from the ball`;
  element("network").textContent = `${size(distance)} from its target; proved: ${bound < 1e-6 ? "" : "at most "}${size(bound)}`;
  element("speed").textContent = `${now.toFixed(1)} s, ${speed.toFixed(2)} times real time`;
  const canvas = element("chart");
  const [width, height, ratio, left] = [canvas.clientWidth, canvas.clientHeight, Math.min(devicePixelRatio, 2), 38];
  Object.assign(canvas, { width: width * ratio, height: height * ratio });
  const pen = canvas.getContext("2d");
  const up = (value) => height - 6 - ((Math.log10(Math.max(value, 1e-4)) + 4) / 6) * (height - 14);
  const line = (name, points, k, dash) => {
    pen.setLineDash(dash);
    pen.strokeStyle = pen.fillStyle = getComputedStyle(document.body).getPropertyValue(name);
    pen.beginPath();
    for (const row of points) pen.lineTo(left + ((row[0] - now + SPAN) / SPAN) * (width - left), up(row[k]));
    pen.stroke();
  };
  pen.scale(ratio, ratio);
  pen.font = "11px system-ui";
  for (const power of [-4, -2, 0, 2]) {
    line("--rule", [[now - SPAN, 10 ** power], [now, 10 ** power]], 1, []);
    pen.fillStyle = getComputedStyle(document.body).getPropertyValue("--soft");
    pen.fillText(power ? `1e${power}` : "1", 4, up(10 ** power) + 4);
  }
  pen.lineWidth = 1.8;
  for (const [name, k, dash] of [["--soft", 2, [5, 4]], ["--sun", 3, []], ["--teal", 1, []]]) line(name, rows, k, dash);
}

async function unpacked(id) {
  const bytes = Uint8Array.from(atob(element(id).textContent), (letter) => letter.charCodeAt(0));
  return new Response(new Blob([bytes]).stream().pipeThrough(new DecompressionStream("gzip")));
}

async function main() {
  const given = await (await unpacked("scenes")).json();
  const mujoco = await loadMujoco({ wasmBinary: await (await unpacked("wasm")).arrayBuffer() });
  const [stage, worlds] = [new Stage(), {}];
  let [world, rows, last, behind] = [null, [], performance.now(), 0];
  const choose = (name) => {
    world = worlds[name] ??= new World(mujoco, given[name]);
    rows = [];
    stage.show(world);
    for (const id of ["proof", "about"]) element(id).textContent = world.given[id];
    for (const other of Object.keys(given)) element(other).setAttribute("aria-pressed", other === name);
    globalThis.page = { world, stage, Policy }; // for tests, and for the curious
  };
  for (const name of Object.keys(given)) element(name).onclick = () => choose(name);
  element("again").onclick = () => choose(world.given.name, world.begin());
  element("push").onclick = () => {
    const force = new three.Vector3(0, world.given.push, 0);
    world.hold(world.given.last, world.tip, { force, until: world.data.time + 0.2 });
  };
  choose("free");
  requestAnimationFrame(function frame(clock) {
    const period = world.given.policy.PERIOD;
    behind = Math.min(behind + Math.max(clock - last, 0) / 1e3, 0.1); // a slow machine shows it slower
    for (last = clock; behind > period; behind -= period) world.advance();
    stage.draw();
    const [now, far] = [world.data.time, world.tip.distanceTo(stage.ball.position)];
    rows = [...rows.filter((row) => row[0] > now - SPAN), [now, ...world.policy.progress(), far, clock]];
    tell(world, rows);
    requestAnimationFrame(frame);
  });
}

main().catch((error) => (element("state").textContent = `This browser cannot show it: ${error}`));
