/* A certified network as the policy of an arm: a port of the C that the package exports (lieednn.c and policy.c there,
   whose comments have the reasons), with the numbers of its headers, for arms whose links have one hinge and one slide.
   Left out is what a simulated arm does not need: faults of measurements, braking, and the filter of what is sent. */

const dot = (a, b) => a[0] * b[0] + a[1] * b[1] + a[2] * b[2];

const scaled = (a, factor) => a.map((value) => factor * value);

const cross = (a, b) => [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]];

/** v + b w x v + c w x (w x v). */
function turned(w, v, b, c) {
  const once = cross(w, v);
  const twice = cross(w, once);
  return [0, 1, 2].map((k) => v[k] + b * once[k] + c * twice[k]);
}

function leftJacobian(w, v) {
  const square = Math.max(dot(w, w), 1e-16);
  const angle = Math.sqrt(square);
  const sine = Math.sin(0.5 * angle);
  return turned(w, v, (2 * sine * sine) / square, (1 - Math.sin(angle) / angle) / square);
}

/** Of v by a unit quaternion (w, x, y, z). */
const rotate = (r, v) => turned(r.slice(1), v, 2 * r[0], 2);

function multiply(r, s) {
  const [a, b] = [r.slice(1), s.slice(1)];
  const c = cross(a, b);
  return [r[0] * s[0] - dot(a, b), ...c.map((value, k) => value + r[0] * b[k] + s[0] * a[k])];
}

function rotation(w) {
  const angle = Math.sqrt(Math.max(dot(w, w), 1e-32));
  const factor = Math.sin(0.5 * angle) / angle;
  return [Math.cos(0.5 * angle), ...scaled(w, factor)];
}

/** The twist of a pose (rotation r, translation p). */
function logarithm({ r, p }) {
  const sign = r[0] < 0 ? -1 : 1;
  const vector = r.slice(1);
  const sine = Math.sqrt(dot(vector, vector));
  const angle = 2 * Math.atan2(sine, sign * r[0]);
  const half = Math.max(0.5 * angle, 1e-8);
  const w = scaled(vector, sine > 0 ? (sign * angle) / sine : 0);
  return [...w, ...turned(w, p, -0.5, (1 - half / Math.tan(half)) / (4 * half * half))];
}

/** x' = -gamma x + mu (W tanh(x) + b), by the classical Runge-Kutta method; the bias b holds the target. */
export class Network {
  constructor(numbers) {
    this.numbers = numbers;
    this.weight = numbers.weight.map((column) => Float64Array.from(column));
    this.x = new Float64Array(numbers.SIZE);
    this.bias = Float64Array.from(numbers.bias);
    this.goal = Float64Array.from(numbers.rest);
  }

  /** Adds sign mu W tanh(x) to a sum. */
  addInputs(x, sum, sign) {
    const { SIZE, DRIVEN } = this.numbers;
    for (let j = 0; j < SIZE; j++) {
      const output = sign * Math.tanh(x[j]);
      const column = this.weight[j];
      for (let i = 0; i < DRIVEN; i++) sum[i] += column[i] * output;
    }
  }

  field(x) {
    const rate = this.bias.map((value, i) => value - this.numbers.GAMMA * x[i]);
    this.addInputs(x, rate, 1);
    return rate;
  }

  step(h) {
    const x = this.x;
    const sum = new Float64Array(x.length);
    let rate = sum;
    for (const [part, share] of [[0, 1], [0.5, 2], [0.5, 2], [1, 1]]) {
      rate = this.field(x.map((value, i) => value + part * h * rate[i]));
      rate.forEach((value, i) => (sum[i] += share * value));
    }
    this.x = x.map((value, i) => value + (h / 6) * sum[i]);
  }

  /** Visible neurons begin at a state, hidden ones where their law says. */
  start(visible) {
    const { VISIBLE, HIDDEN, START_LAW, rest, hidden_start, start_gain, start_reference, goal_gain } = this.numbers;
    this.x.set(visible);
    for (let i = 0; i < HIDDEN; i++) {
      let value = hidden_start[i];
      for (let j = 0; START_LAW && j < VISIBLE; j++) {
        const moved = this.goal[j] - rest[j];
        value += start_gain[i][j] * (visible[j] - start_reference[j] - moved) + goal_gain[i][j] * moved;
      }
      this.x[VISIBLE + i] = value;
    }
  }

  /** Another target of the visible neurons, under the same proof: only the bias changes. */
  retarget(visible) {
    this.goal.set(visible);
    const pull = this.goal.map((value) => this.numbers.GAMMA * value);
    this.addInputs(this.goal, pull, -1);
    this.bias.set(pull.subarray(0, visible.length));
  }
}

export class Policy {
  /** Numbers of both exported headers; at rest at joints q, with a target. */
  constructor({ network, policy }, q, target = q) {
    this.numbers = { ...network, ...policy };
    this.network = new Network(network);
    this.links = [...Array(policy.LINKS).keys()];
    this.q = Float64Array.from(q); // the reference, and its velocity
    this.qd = this.q.map(() => 0);
    this.network.retarget(this.encode(target));
    this.network.start(this.encode(q));
    this.aim(target);
    this.pace = 1; // how fast the network runs, as a fraction of its speed
    this.pulled = false; // whether measured joints pulled its state in the last period
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

  /** Joints of the poses nearest to a state, by Newton's method from q, which is near; and their rates along a field. */
  decode(x, flow, q) {
    const ahead = [0, 1e-4, -1e-4]; // a central difference gives the rates
    const given = ahead.map((step) =>
      this.links.map((link) => {
        const xi = [0, 1, 2, 3, 4, 5].map((k) => x[6 * link + k] + step * flow[6 * link + k]);
        return { r: rotation(xi.slice(0, 3)), p: leftJacobian(xi.slice(0, 3), xi.slice(3)) };
      }),
    );
    const rate = new Float64Array(q.length);
    q = Float64Array.from(q);
    for (let round = 0, largest = 1; round < 8 && largest >= 1e-3; round++) {
      largest = 0;
      for (const link of this.links) {
        const { r, p, axis, along } = this.pose(link, q);
        const back = [-r[0], ...r.slice(1)]; // its inverse: q and -q are one rotation
        const swing = cross(axis, p);
        // The normal equations, with something that keeps undetermined joints in place.
        const [a, b, d] = [dot(axis, axis) + dot(swing, swing) + 5e-13, dot(swing, along), dot(along, along) + 5e-13];
        const [now, later, before] = given.map((poses) => {
          const turn = multiply(poses[link].r, back);
          const off = poses[link].p.map((value, k) => value - p[k]);
          const [f, g] = [2 * turn[0] * dot(axis, turn.slice(1)) + dot(swing, off), dot(along, off)];
          return [(d * f - b * g) / (a * d - b * b), (a * g - b * f) / (a * d - b * b)];
        });
        for (const k of [0, 1]) {
          q[2 * link + k] += now[k];
          rate[2 * link + k] = (later[k] - before[k]) / (ahead[1] - ahead[2]);
          largest = Math.max(largest, Math.abs(now[k]));
        }
      }
    }
    return [q, rate];
  }

  /** A period: the reference q and qd for its end, from measured joints and a target. */
  step(measured, target) {
    const { PERIOD, SPEED, max_speed, max_acceleration, low, high } = this.numbers;
    this.aim(target);
    const [waiting, drift, rate] = this.listen(measured);
    const scale = waiting * SPEED;
    const allowed = this.qd.map((value, i) => Math.min(max_speed[i], Math.abs(value) + max_acceleration[i] * PERIOD));
    const excess = (velocity) => Math.max(...velocity.map((value, i) => Math.abs(value) / allowed[i]));
    const desired = this.flowRate.map((value, i) => scale * value + rate[i]);
    const x = this.network.x;
    let fraction = 1 / Math.max(1, excess(desired));
    let flow, drawn, flowRate, qd;
    // Again if velocities at the end exceed their limits.
    for (let attempt = 0; attempt < 4; attempt++) {
      this.network.x = x;
      this.integrate(fraction * scale, drift.map((value) => value / scale));
      flow = this.network.field(this.network.x);
      const near = this.q.map((value, i) => value + fraction * PERIOD * desired[i]);
      [drawn, flowRate] = this.decode(this.network.x, flow, near);
      qd = flowRate.map((value, i) => fraction * (scale * value + rate[i]));
      if (excess(qd) <= 1.001) break;
      fraction /= excess(qd);
    }
    this.q = drawn.map((value, i) => Math.min(Math.max(value, low[i]), high[i]));
    this.qd = qd.map((value, i) => (this.q[i] === drawn[i] ? value : 0));
    Object.assign(this, { flow, flowRate, pace: fraction * waiting });
  }

  /** A new target is a new bias. */
  aim(target) {
    const { RATE, jump_speed } = this.numbers;
    if (this.target && target.every((value, i) => value === this.target[i])) return;
    const jumped = !this.target || target.some((value, i) => Math.abs(value - this.target[i]) * RATE > jump_speed[i]);
    this.network.retarget(this.encode(target));
    this.flow = this.network.field(this.network.x);
    if (jumped) [, this.flowRate] = this.decode(this.network.x, this.flow, this.q);
    this.target = Float64Array.from(target);
  }

  /** How fast the network runs behind an arm that lags, and the pull of one that is pushed: on its state, on joints. */
  listen(measured) {
    const { PATIENCE, PULL, TOLERANCE, VISIBLE, range } = this.numbers;
    const off = Array.from(measured, (value, i) => value - this.q[i]);
    const behind = Math.max(...off.map((value, i) => Math.abs(value) / range[i]));
    const pull = PULL * Math.max(0, 1 - TOLERANCE / Math.max(behind, 1e-300));
    this.pulled = pull > 0;
    const here = this.pulled && this.encode(this.q);
    const drift = this.pulled ? this.encode(measured).map((value, i) => pull * (value - here[i])) : Array(VISIBLE).fill(0);
    return [Math.max(1 / (1 + (behind / PATIENCE) ** 2), 0.01), drift, off.map((value) => pull * value)];
  }

  /** A period of x' = scale (F(x) + drift). */
  integrate(scale, drift) {
    const { PERIOD, STIFFNESS, MAX_STEP, MAX_STEPS, VISIBLE } = this.numbers;
    const fastest = this.flow.reduce((most, value, i) => (i < VISIBLE ? most : Math.max(most, Math.abs(value))), STIFFNESS);
    const count = Math.max(Math.min(Math.ceil((scale * PERIOD * fastest) / MAX_STEP), MAX_STEPS), 1);
    const bias = this.network.bias.slice();
    drift.forEach((value, i) => (this.network.bias[i] += value));
    for (let step = 0; step < count; step++) this.network.step((scale * PERIOD) / count);
    this.network.bias = bias;
  }

  /** Joints along the network's own way from its present state to its target. */
  ahead(points, time) {
    const now = this.network.x;
    const way = [this.q];
    for (let point = 0; point < points; point++) {
      this.network.step(time / points);
      way.push(this.decode(this.network.x, this.flow, way[point])[0]);
    }
    this.network.x = now;
    return way;
  }
}

/** The proved bound on the distance of the visible neurons from their goal, the least of several guarantees. */
export class Decay {
  constructor(guarantees, policy) {
    Object.assign(this, { guarantees, policy });
    this.begin();
  }

  /** Begins again, as after every change of the target and every pull of the arm. */
  begin() {
    const { x, goal } = this.policy.network;
    const off = x.map((value, i) => value - goal[i]);
    const norm = (rows) => Math.hypot(...rows.map((row) => row.reduce((sum, value, i) => sum + value * off[i], 0)));
    this.sizes = this.guarantees.map(({ factor }) => norm(factor));
    this.time = 0;
  }

  /** After a period, in which a pull makes another motion of it. */
  after() {
    const { pulled, pace, numbers } = this.policy;
    if (pulled) this.begin();
    else this.time += pace * numbers.SPEED * numbers.PERIOD;
  }

  get bound() {
    return Math.min(...this.guarantees.map(({ rate }, i) => this.sizes[i] * Math.exp(-rate * this.time)));
  }

  get distance() {
    const { x, goal, numbers } = this.policy.network;
    return Math.hypot(...x.subarray(0, numbers.VISIBLE).map((value, i) => value - goal[i]));
  }
}
