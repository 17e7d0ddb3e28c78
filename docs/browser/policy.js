/* A certified network as the policy of an arm whose links have one hinge and one slide, and the proved bound: a port of
   the C that the package exports, lieednn.c and policy.c, which say why; with the numbers of its headers. Left out is
   what a simulated arm does not need: faults of measurements, braking, and the filter of what is sent. */

const scaled = (a, factor) => a.map((value) => factor * value);
const dot = (a, b) => a.reduce((sum, value, i) => sum + value * b[i], 0);
const cross = (a, b) => [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]];
const clip = (value, low, high) => Math.min(Math.max(value, low), high);

/** v + b w x v + c w x (w x v). */
function turned(w, v, b, c) {
  const once = cross(w, v);
  const twice = cross(w, once);
  return v.map((value, k) => value + b * once[k] + c * twice[k]);
}

function leftJacobian(w, v) {
  const angle = Math.sqrt(Math.max(dot(w, w), 1e-16));
  return turned(w, v, 2 * (Math.sin(0.5 * angle) / angle) ** 2, (1 - Math.sin(angle) / angle) / angle ** 2);
}

/** The unit quaternion (w, x, y, z) of a rotation vector, a product of two, and a vector turned by one. */
function rotation(w) {
  const angle = Math.sqrt(Math.max(dot(w, w), 1e-32));
  return [Math.cos(0.5 * angle), ...scaled(w, Math.sin(0.5 * angle) / angle)];
}

const multiply = ([r, ...a], [s, ...b]) => [r * s - dot(a, b), ...cross(a, b).map((v, k) => v + r * b[k] + s * a[k])];
const rotate = ([r, ...w], v) => turned(w, v, 2 * r, 2);

/** The twist of a pose (rotation r, translation p). */
function logarithm({ r: [real, ...vector], p }) {
  const sine = Math.sqrt(dot(vector, vector));
  const angle = 2 * Math.atan2(sine, Math.abs(real));
  const half = Math.max(0.5 * angle, 1e-8);
  const w = scaled(vector, sine > 0 ? ((real < 0 ? -1 : 1) * angle) / sine : 0);
  return [...w, ...turned(w, p, -0.5, (1 - half / Math.tan(half)) / (4 * half * half))];
}

/** The network x' = -gamma x + mu (W tanh(x) + b), whose bias b holds the target, and the arm's reference q, qd. */
export class Policy {
  /** Numbers of both exported headers, and of the proved bounds; the arm rests at joints q. */
  constructor({ network, policy, guarantees }, q, target) {
    Object.assign(this, { network, guarantees, numbers: { ...network, ...policy } });
    this.links = [...Array(policy.LINKS).keys()];
    this.rows = network.weight[0].map((_, i) => Float64Array.from(network.weight, (column) => column[i]));
    this.q = Float64Array.from(q);
    this.qd = this.q.map(() => 0);
    this.bias = Float64Array.from(network.bias);
    this.goal = Float64Array.from(network.rest);
    this.retarget(target);
    this.x = Float64Array.from([...this.encode(q), ...(network.hidden_start ?? [])]);
    this.aim(target);
  }

  /** mu W tanh(x), of the neurons that have inputs, which come first. */
  inputs(x) {
    const output = x.map(Math.tanh);
    return this.rows.map((row) => dot(row, output));
  }

  field(x) {
    const inputs = this.inputs(x);
    return x.map((value, i) => this.bias[i] - this.network.GAMMA * value + (inputs[i] ?? 0));
  }

  /** A step of the classical Runge-Kutta method. */
  integrate(h) {
    const { x } = this;
    const sum = new Float64Array(x.length);
    let rate = sum;
    for (const [part, share] of [[0, 1], [0.5, 2], [0.5, 2], [1, 1]]) {
      rate = this.field(x.map((value, i) => value + part * h * rate[i]));
      rate.forEach((value, i) => (sum[i] += share * value));
    }
    this.x = x.map((value, i) => value + (h / 6) * sum[i]);
  }

  /** Another target, under the same proof: only the bias changes. */
  retarget(target) {
    this.goal.set(this.encode(target));
    const inputs = this.inputs(this.goal).slice(0, this.network.VISIBLE);
    this.bias.set(inputs.map((value, i) => this.network.GAMMA * this.goal[i] - value));
    this.target = target;
  }

  /** The pose of a link: a turn about one axis, then a slide along another, which the turn turns. */
  pose(link, q) {
    const [axis, slide] = [this.numbers.axes[2 * link][0], this.numbers.axes[2 * link + 1][0]];
    const r = rotation(scaled(axis, q[2 * link]));
    const along = rotate(r, slide);
    return { r, p: scaled(along, q[2 * link + 1]), axis, along };
  }

  /** Joints as the state of the visible neurons, a twist for each link. */
  encode(q) {
    return this.links.flatMap((link) => logarithm(this.pose(link, q)));
  }

  /** Joints of the poses nearest to a state, by Newton's method from q, which is near; their rates along a field. */
  decode(x, flow, q) {
    const ahead = [0, 1e-4, -1e-4]; // a central difference gives the rates
    const given = this.links.map((link) => ahead.map((step) => {
      const [a, b, c, ...v] = [0, 1, 2, 3, 4, 5].map((k) => x[6 * link + k] + step * flow[6 * link + k]);
      return { r: rotation([a, b, c]), p: leftJacobian([a, b, c], v) };
    }));
    const rate = new Float64Array(q.length);
    q = Float64Array.from(q);
    for (let round = 0, largest = 1; round < 8 && largest >= 1e-3; round++) {
      largest = 0;
      for (const link of this.links) {
        const { r, p, axis, along } = this.pose(link, q);
        const swing = cross(axis, p);
        // The normal equations, with something that keeps undetermined joints in place.
        const [a, b, d] = [dot(axis, axis) + dot(swing, swing) + 5e-13, dot(swing, along), dot(along, along) + 5e-13];
        const [now, later, before] = given[link].map((pose) => {
          const [real, ...turn] = multiply(pose.r, [-r[0], ...r.slice(1)]); // q and -q are one rotation
          const off = pose.p.map((value, k) => value - p[k]);
          const [f, g] = [2 * real * dot(axis, turn) + dot(swing, off), dot(along, off)];
          return scaled([d * f - b * g, a * g - b * f], 1 / (a * d - b * b));
        });
        now.forEach((value, k) => {
          q[2 * link + k] += value;
          rate[2 * link + k] = (later[k] - before[k]) / (ahead[1] - ahead[2]);
          largest = Math.max(largest, Math.abs(value));
        });
      }
    }
    return [q, rate];
  }

  /** A period: the reference q and qd for its end, from measured joints and a target; whether it is another motion. */
  step(measured, target) {
    const { PERIOD, SPEED, MAX_STEP, MAX_STEPS, STIFFNESS, VISIBLE } = this.numbers;
    const { max_speed, max_acceleration, low, high } = this.numbers;
    const moved = target.some((value, i) => value !== this.target[i]);
    if (moved) this.aim(target);
    const [waiting, drift, rate] = this.listen(measured);
    const scale = waiting * SPEED;
    const allowed = this.qd.map((value, i) => Math.min(max_speed[i], Math.abs(value) + max_acceleration[i] * PERIOD));
    const excess = (velocity) => Math.max(...velocity.map((value, i) => Math.abs(value) / allowed[i]));
    const desired = this.flowRate.map((value, i) => scale * value + rate[i]);
    const fastest = Math.max(STIFFNESS, ...this.flow.subarray(VISIBLE).map(Math.abs));
    const [x, bias] = [this.x, this.bias];
    let [fraction, flow, drawn, flowRate, qd] = [1 / Math.max(1, excess(desired))];
    // Again if velocities at the end exceed their limits.
    for (let attempt = 0; attempt < 4; attempt++) {
      const count = clip(Math.ceil((fraction * scale * PERIOD * fastest) / MAX_STEP), 1, MAX_STEPS);
      this.x = x;
      this.bias = bias.map((value, i) => value + (i < VISIBLE ? drift[i] / scale : 0));
      for (let k = 0; k < count; k++) this.integrate((fraction * scale * PERIOD) / count);
      this.bias = bias;
      flow = this.field(this.x);
      [drawn, flowRate] = this.decode(this.x, flow, this.q.map((value, i) => value + fraction * PERIOD * desired[i]));
      qd = flowRate.map((value, i) => fraction * (scale * value + rate[i]));
      if (excess(qd) <= 1.001) break;
      fraction /= excess(qd);
    }
    this.q = drawn.map((value, i) => clip(value, low[i], high[i]));
    this.qd = qd.map((value, i) => (this.q[i] === drawn[i] ? value : 0));
    Object.assign(this, { flow, flowRate, pace: fraction * waiting }); // pace: a fraction of the network's speed
    // A pull makes another motion of it, about which the bound begins again.
    if (this.pulled) this.beginBound();
    else this.time += this.pace * SPEED * PERIOD;
    return moved || this.pulled;
  }

  /** Goes to another target from now on. */
  aim(target) {
    const { RATE, jump_speed } = this.numbers;
    const jumped = !this.flow || target.some((value, i) => Math.abs(value - this.target[i]) * RATE > jump_speed[i]);
    this.retarget(target);
    this.flow = this.field(this.x);
    if (jumped) [, this.flowRate] = this.decode(this.x, this.flow, this.q);
    this.beginBound();
  }

  /** How fast the network runs behind an arm that lags, and the pull of one that is pushed: on its state, on joints. */
  listen(measured) {
    const { PATIENCE, PULL, TOLERANCE, range } = this.numbers;
    const off = Array.from(measured, (value, i) => value - this.q[i]);
    const behind = Math.max(...off.map((value, i) => Math.abs(value) / range[i]));
    const pull = PULL * Math.max(0, 1 - TOLERANCE / Math.max(behind, 1e-300));
    this.pulled = pull > 0;
    const here = this.encode(this.q);
    const drift = this.encode(measured).map((value, i) => pull * (value - here[i]));
    return [Math.max(1 / (1 + (behind / PATIENCE) ** 2), 0.01), drift, scaled(off, pull)];
  }

  /** Joints along the network's own way from its present state to its target. */
  ahead(points, time) {
    const [now, way] = [this.x, [this.q]];
    for (let point = 0; point < points; point++) {
      this.integrate(time / points);
      way.push(this.decode(this.x, this.flow, way[point])[0]);
    }
    this.x = now;
    return way;
  }

  /** The proved bound begins anew. */
  beginBound() {
    const off = this.x.map((value, i) => value - this.goal[i]);
    this.sizes = this.guarantees.map(({ factor }) => Math.hypot(...factor.map((row) => dot(row, off))));
    this.time = 0; // since then, the network's own
  }

  /** Distance of the visible neurons from their goal; the bound, the least of several |factor e| exp(-rate t). */
  progress() {
    const bounds = this.guarantees.map(({ rate }, i) => this.sizes[i] * Math.exp(-rate * this.time));
    const off = this.x.subarray(0, this.network.VISIBLE).map((value, i) => value - this.goal[i]);
    return [Math.hypot(...off), Math.min(...bounds)];
  }
}
