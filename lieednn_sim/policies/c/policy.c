#define POLICY_ARRAYS
#include <float.h>
#include <math.h>
#include <string.h>

#include "policy.h"

enum { N = POLICY_JOINTS, SEEN = LIEEDNN_VISIBLE };

/* A unit quaternion (w, x, y, z), and a translation in the network's unit of length. */
typedef struct {
    double r[4], p[3];
} pose;

static double dot(const double a[3], const double b[3]) { return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]; }

static void cross(const double a[3], const double b[3], double out[3])
{
    const double x = a[1] * b[2] - a[2] * b[1], y = a[2] * b[0] - a[0] * b[2];
    out[2] = a[0] * b[1] - a[1] * b[0];
    out[0] = x;
    out[1] = y;
}

/* v + b w x v + c w x (w x v): rotations and the Jacobians of SO(3) by their coefficients. */
static void turned(const double w[3], const double v[3], double b, double c, double out[3])
{
    double once[3], twice[3];
    cross(w, v, once);
    cross(w, once, twice);
    for (int k = 0; k < 3; k++)
        out[k] = v[k] + b * once[k] + c * twice[k];
}

static void left_jacobian(const double w[3], const double v[3], double out[3])
{
    const double square = fmax(dot(w, w), 1e-16), angle = sqrt(square), sine = sin(0.5 * angle);
    turned(w, v, 2.0 * sine * sine / square, (1.0 - sin(angle) / angle) / square, out);
}

static void rotate(const double r[4], const double v[3], double out[3]) { turned(r + 1, v, 2.0 * r[0], 2.0, out); }

static void multiply(const double r[4], const double s[4], double out[4])
{
    cross(r + 1, s + 1, out + 1);
    out[0] = r[0] * s[0] - dot(r + 1, s + 1);
    for (int k = 1; k < 4; k++)
        out[k] += r[0] * s[k] + s[0] * r[k];
}

static void rotation(const double w[3], double r[4])
{
    const double angle = sqrt(fmax(dot(w, w), 1e-32)), factor = sin(0.5 * angle) / angle;
    r[0] = cos(0.5 * angle);
    for (int k = 0; k < 3; k++)
        r[k + 1] = factor * w[k];
}

static void logarithm(const pose *t, double xi[6])
{
    const double sign = t->r[0] < 0.0 ? -1.0 : 1.0, sine = sqrt(dot(t->r + 1, t->r + 1));
    const double angle = 2.0 * atan2(sine, sign * t->r[0]), half = fmax(0.5 * angle, 1e-8);
    for (int k = 0; k < 3; k++)
        xi[k] = sine > 0.0 ? sign * angle / sine * t->r[k + 1] : 0.0;
    turned(xi, t->p, -0.5, (1.0 - half / tan(half)) / (4.0 * half * half), xi + 3);
}

/* The pose of a link's joints, and its spatial twists at unit rates of the coordinates if they are asked for. */
static void move(int link, const double q[N], pose *at, double twists[N][6])
{
    memset(at, 0, sizeof *at);
    at->r[0] = 1.0;
    for (int f = factor_of[link]; f < factor_of[link + 1]; f++) {
        double way[3] = {0.0, 0.0, 0.0}, point[3], part[3], r[4], before[4];
        for (int c = 0; c < columns[f]; c++)
            for (int k = 0; k < 3; k++)
                way[k] += axes[f][c][k] * (q[coordinate[f][c]] - reference[coordinate[f][c]]);
        rotate(at->r, turns[f] ? anchor[f] : way, part);
        for (int k = 0; k < 3; k++)
            point[k] = at->p[k] + part[k];
        for (int c = 0; twists && c < columns[f]; c++) {
            double omega[3] = {0.0, 0.0, 0.0}, v[3];
            if (turns[f]) {
                left_jacobian(way, axes[f][c], part);
                rotate(at->r, part, omega);
                cross(point, omega, v);
            } else
                rotate(at->r, axes[f][c], v);
            for (int k = 0; k < 6; k++)
                twists[coordinate[f][c]][k] += k < 3 ? omega[k] : v[k - 3];
        }
        memcpy(at->p, point, sizeof point);
        if (turns[f]) {
            rotation(way, r);
            memcpy(before, at->r, sizeof before);
            multiply(before, r, at->r);
            rotate(at->r, anchor[f], part);
            for (int k = 0; k < 3; k++)
                at->p[k] -= part[k];
        }
    }
}

/* The links' coordinates in the network: logarithms, or a screw times its coordinate, however far it turns. */
static void encode(const double q[N], double xi[SEEN])
{
    for (int link = 0; link < POLICY_LINKS; link++) {
        const int i = screwed[link];
        pose at;
        if (i < 0) {
            move(link, q, &at, NULL);
            logarithm(&at, xi + 6 * link);
        }
        for (int k = 0; i >= 0 && k < 6; k++)
            xi[6 * link + k] = (q[i] - reference[i]) * screw[link][k];
    }
}

/* Solves m x = b for three b, by Cholesky's method within the lower triangle's envelope; m becomes its factor. */
static void solve(double m[N][N], double b[3][N])
{
    for (int i = 0; i < N; i++) {
        for (int j = begin[i]; j <= i; j++) {
            double sum = m[i][j];
            for (int k = begin[i] > begin[j] ? begin[i] : begin[j]; k < j; k++)
                sum -= m[i][k] * m[j][k];
            m[i][j] = j < i ? sum / m[j][j] : sqrt(fmax(sum, 1e-16));
        }
        for (int s = 0; s < 3; s++) {
            for (int k = begin[i]; k < i; k++)
                b[s][i] -= m[i][k] * b[s][k];
            b[s][i] /= m[i][i];
        }
    }
    for (int i = N - 1; i >= 0; i--)
        for (int s = 0; s < 3; s++) {
            b[s][i] /= m[i][i];
            for (int k = begin[i]; k < i; k++)
                b[s][k] -= m[i][k] * b[s][i];
        }
}

/* The joints of a state of the network, nearest to poses that no joints meet, and their rates along a field: by Newton's
   method on |R(q) - R|^2 / 2 + |p(q) - p|^2, summed over the links, from q, which is near. */
static void decode(const double x[SEEN], const double flow[SEEN], double q[N], double rate[N])
{
    static const double ahead[3] = {0.0, 1e-4, -1e-4}; /* a central difference gives the rates */
    pose given[3][POLICY_LINKS];
    for (int s = 0; s < 3; s++)
        for (int link = 0; link < POLICY_LINKS; link++) {
            double xi[6];
            for (int k = 0; k < 6; k++)
                xi[k] = x[6 * link + k] + ahead[s] * flow[6 * link + k];
            rotation(xi, given[s][link].r);
            left_jacobian(xi, xi + 3, given[s][link].p);
        }
    for (int step = 0; step < 8; step++) {
        double m[N][N], b[3][N], largest = 0.0;
        memset(m, 0, sizeof m);
        memset(b, 0, sizeof b);
        for (int i = 0; i < N; i++)
            m[i][i] = 5e-13; /* keeps undetermined coordinates in place */
        for (int link = 0; link < POLICY_LINKS; link++) {
            double twists[N][6], off[3][6], turn[4], swing[3];
            pose at;
            memset(twists, 0, sizeof twists);
            move(link, q, &at, twists);
            at.r[0] = -at.r[0]; /* inverts it: q and -q are one rotation */
            for (int s = 0; s < 3; s++) {
                multiply(given[s][link].r, at.r, turn);
                for (int k = 0; k < 3; k++) {
                    off[s][k] = 2.0 * turn[0] * turn[k + 1];
                    off[s][k + 3] = given[s][link].p[k] - at.p[k];
                }
            }
            for (int c = moved_by[link]; c < moved_by[link + 1]; c++) {
                const int i = mover[c];
                cross(twists[i], at.p, swing);
                for (int k = 0; k < 3; k++)
                    twists[i][k + 3] += swing[k];
                for (int e = moved_by[link]; e <= c; e++)
                    m[i][mover[e]] += dot(twists[i], twists[mover[e]]) + dot(twists[i] + 3, twists[mover[e]] + 3);
                for (int s = 0; s < 3; s++)
                    b[s][i] += dot(twists[i], off[s]) + dot(twists[i] + 3, off[s] + 3);
            }
        }
        solve(m, b);
        for (int i = 0; i < N; i++) {
            q[i] += b[0][i];
            rate[i] = (b[1][i] - b[2][i]) / (ahead[1] - ahead[2]);
            largest = fmax(largest, fabs(b[0][i]));
        }
        if (largest < 1e-3)
            break;
    }
}

/* Joints at the limits where they are beyond; a ball joint's rotation vector keeps its direction. */
static void limit(double q[N])
{
    for (int i = 0; i < N; i++) {
        double square = 0.0;
        for (int k = i; ball[i] && k < i + 3; k++)
            square += q[k] * q[k];
        const double angle = sqrt(square);
        for (int k = i; ball[i] && angle > high[i] && k < i + 3; k++)
            q[k] *= (1.0 - 1e-15) * high[i] / angle;
        q[i] = fmin(fmax(q[i], low[i]), high[i]);
    }
}

/* Whether values are numbers and, up to a tolerance, joints within their limits; DBL_MAX allows all that are finite. */
static int within(const double q[N], double tolerance)
{
    double inside[N];
    memcpy(inside, q, sizeof inside);
    limit(inside);
    for (int i = 0; i < N; i++)
        if (!(fabs(q[i] - inside[i]) <= tolerance))
            return 0;
    return 1;
}

/* Largest velocity at the end of a period from which a distance suffices to brake. */
static double stopping(double distance, double velocity, double a)
{
    const double h = POLICY_PERIOD, left = distance - 0.5 * h * velocity, lost = 0.5 * a * h;
    return left < 0.0 ? 2.0 * left / h : sqrt(lost * lost + 2.0 * a * left) - lost;
}

/* The network's target, in the middle of the period; adds the rates of one that moves. */
static void aim(policy *p, double drift[SEEN], double rate[N])
{
    double goal[SEEN], velocity[N], between[SEEN];
    int jumped = 0, moves = 0;
    for (int i = 0; i < N; i++) {
        velocity[i] = (p->wanted[i] - p->target[i]) * POLICY_RATE;
        jumped |= fabs(velocity[i]) > jump_speed[i];
        moves |= velocity[i] != 0.0;
    }
    if (p->aimed && !moves && p->settled)
        return;
    encode(p->wanted, goal);
    p->settled = !(POLICY_FEEDFORWARD && p->aimed && moves && !jumped);
    for (int i = 0; i < N; i++)
        rate[i] = p->settled ? 0.0 : velocity[i];
    for (int i = 0; i < SEEN; i++) {
        drift[i] = p->settled ? 0.0 : (goal[i] - p->goal[i]) * POLICY_RATE;
        between[i] = goal[i] + 0.5 * POLICY_PERIOD * drift[i];
    }
    lieednn_retarget(&p->net, between);
    lieednn_field(&p->net, p->net.x, p->flow);
    if (!p->aimed || jumped) {
        double near[N];
        memcpy(near, p->own_q, sizeof near);
        decode(p->net.x, p->flow, near, p->flow_rate);
    }
    memcpy(p->target, p->wanted, sizeof p->target);
    memcpy(p->goal, goal, sizeof goal);
    p->aimed = 1;
}

/* Adds the pull of measured joints; how fast the network runs. */
static double listen(policy *p, const double measured[N], double drift[SEEN], double rate[N])
{
    double there[SEEN], here[SEEN], behind = 0.0;
    for (int i = 0; i < N; i++)
        behind = fmax(behind, fabs(measured[i] - p->own_q[i]) / range[i]);
    const double late = behind / POLICY_PATIENCE;
    const double pull = POLICY_PULL * fmax(0.0, 1.0 - POLICY_TOLERANCE / fmax(behind, 1e-300));
    p->behind = behind;
    if (pull > 0.0) {
        encode(measured, there);
        encode(p->own_q, here);
        for (int i = 0; i < SEEN; i++)
            drift[i] += pull * (there[i] - here[i]);
        for (int i = 0; i < N; i++)
            rate[i] += pull * (measured[i] - p->own_q[i]);
    }
    return fmax(1.0 / (1.0 + late * late), 0.01);
}

/* A period of x' = scale (F(x) + drift); the state and the field at its end. */
static void integrate(policy *p, double scale, const double drift[SEEN])
{
    double bias[SEEN], fastest = POLICY_STIFFNESS;
    for (int i = SEEN; i < LIEEDNN_SIZE; i++)
        fastest = fmax(fastest, fabs(p->flow[i]));
    const double extent = ceil(scale * POLICY_PERIOD * fastest / POLICY_MAX_STEP);
    const int count = (int)fmax(fmin(extent, POLICY_MAX_STEPS), 1.0);
    memcpy(bias, p->net.bias, sizeof bias);
    for (int i = 0; i < SEEN; i++)
        p->net.bias[i] += drift[i];
    for (int step = 0; step < count; step++)
        lieednn_step(&p->net, scale * POLICY_PERIOD / count);
    memcpy(p->net.bias, bias, sizeof bias);
}

/* A period of the reference after one at q with qd: each joint is at that where limits of velocity and acceleration
   allow it, else follows it within them. Its velocities are the rates, and the differences of positions. */
static void follow(policy *p, const double q[N], const double qd[N])
{
    const double h = POLICY_PERIOD;
    for (int i = 0; i < N; i++) {
        /* With something for rounding; a limit of 1e6 is none. */
        const double a = fmin(1.001 * max_acceleration[i], 1e6), v = 1.001 * max_speed[i], old = p->qd[i];
        const double slowest = fmax(-v, old - a * h), fastest = fmin(v, old + a * h);
        const double upper = fmin(fmax(stopping(high[i] - p->q[i], old, a), slowest), fastest);
        const double back = fmin(fmax(-stopping(p->q[i] - low[i], -old, a), slowest), fastest), lower = fmin(back, upper);
        const double mean = (q[i] - p->q[i]) / h, lag = q[i] - p->q[i] - 0.5 * h * (old + qd[i]);
        if (lower <= qd[i] && qd[i] <= upper && fabs(mean - p->mean[i]) <= a * h && fabs(qd[i] - mean) <= 0.5 * a * h) {
            p->q[i] = q[i];
            p->qd[i] = qd[i];
            p->mean[i] = mean;
        } else {
            /* The lag vanishes at 8/s, or as fast as half of the acceleration can end. */
            const double extra = fmin(8.0 * fabs(lag), sqrt(a * fabs(lag)));
            p->qd[i] = fmin(fmax(qd[i] + copysign(extra, lag), lower), upper);
            p->mean[i] = 0.5 * (old + p->qd[i]);
            p->q[i] += h * p->mean[i];
        }
    }
}

static unsigned act(policy *p, const double *measured)
{
    double drift[SEEN] = {0.0}, rate[N] = {0.0}, allowed[N], desired[N], x[LIEEDNN_SIZE], flow[LIEEDNN_SIZE];
    double drawn[N], flow_rate[N], qd[N], excess = 0.0;
    aim(p, drift, rate);
    const double waiting = measured ? listen(p, measured, drift, rate) : 1.0, scale = waiting * POLICY_SPEED;
    for (int i = 0; i < N; i++) {
        allowed[i] = fmin(max_speed[i], fabs(p->own_qd[i]) + max_acceleration[i] * POLICY_PERIOD);
        desired[i] = scale * p->flow_rate[i] + rate[i];
        excess = fmax(excess, fabs(desired[i]) / allowed[i]);
    }
    for (int i = 0; i < SEEN; i++)
        drift[i] /= scale;
    double fraction = 1.0 / fmax(1.0, excess);
    memcpy(x, p->net.x, sizeof x);
    /* Again if velocities at the end exceed their limits. */
    for (int attempt = 0; attempt < 4; attempt++) {
        memcpy(p->net.x, x, sizeof x);
        integrate(p, fraction * scale, drift);
        lieednn_field(&p->net, p->net.x, flow);
        for (int i = 0; i < N; i++)
            drawn[i] = p->own_q[i] + fraction * POLICY_PERIOD * desired[i];
        decode(p->net.x, flow, drawn, flow_rate);
        excess = 0.0;
        for (int i = 0; i < N; i++) {
            qd[i] = fraction * (scale * flow_rate[i] + rate[i]);
            excess = fmax(excess, fabs(qd[i]) / allowed[i]);
        }
        if (excess <= 1.001)
            break;
        fraction /= excess;
    }
    if (!within(drawn, DBL_MAX) || !within(qd, DBL_MAX)) {
        policy_stop(p);
        return POLICY_FAILED;
    }
    memcpy(p->flow, flow, sizeof flow);
    memcpy(p->flow_rate, flow_rate, sizeof flow_rate);
    memcpy(p->own_q, drawn, sizeof drawn);
    limit(p->own_q);
    for (int i = 0; i < N; i++)
        p->own_qd[i] = p->own_q[i] == drawn[i] ? qd[i] : 0.0;
    follow(p, p->own_q, p->own_qd);
    p->pace = fraction * waiting;
    return fraction < 1.0 ? POLICY_LIMITED : 0;
}

LIEEDNN_API unsigned policy_start(policy *p, const double q[N])
{
    double xi[SEEN];
    memset(p, 0, sizeof *p);
    if (!within(q, POLICY_START_TOLERANCE))
        return POLICY_REFUSED;
    memcpy(p->q, q, sizeof p->q);
    limit(p->q);
    memcpy(p->own_q, p->q, sizeof p->own_q);
    memcpy(p->wanted, p->q, sizeof p->wanted);
    memcpy(p->seen, q, sizeof p->seen);
    memcpy(p->since, p->q, sizeof p->since);
    lieednn_init(&p->net);
    encode(p->q, xi);
    lieednn_start(&p->net, xi);
    p->pace = 1.0;
    p->started = 1;
    return 0;
}

LIEEDNN_API void policy_stop(policy *p)
{
    if (p->braking || !p->started)
        return;
    p->braking = 1;
    p->needed = 2.0 * POLICY_PERIOD;
    for (int i = 0; i < N; i++)
        p->needed = fmax(p->needed, fabs(p->qd[i]) / max_acceleration[i]);
    for (int i = 0; i < N; i++)
        p->end[i] = p->q[i] + 0.5 * p->needed * p->qd[i];
    limit(p->end);
    memcpy(p->from, p->q, sizeof p->from);
    memcpy(p->rate, p->qd, sizeof p->rate);
}

/* A period of a cubic from the reference at which braking began to rest. */
static unsigned brake(policy *p)
{
    const double s = fmin(p->braking * POLICY_PERIOD / p->needed, 1.0), rest = 1.0 - s;
    double q[N], qd[N];
    int moves = s < 1.0;
    for (int i = 0; i < N; i++) {
        const double slope = p->needed * p->rate[i], way = p->end[i] - p->from[i];
        q[i] = p->from[i] + s * s * (3.0 - 2.0 * s) * way + s * rest * rest * slope;
        qd[i] = s < 1.0 ? (6.0 * s * rest * way + (1.0 - 3.0 * s) * rest * slope) / p->needed : 0.0;
    }
    follow(p, q, qd);
    p->braking += s < 1.0;
    for (int i = 0; i < N; i++)
        moves |= fabs(p->qd[i]) > 1e-9; /* at a limit something may be left by rounding */
    if (!moves)
        memset(p->qd, 0, sizeof p->qd);
    return moves ? POLICY_BRAKING : POLICY_BRAKING | POLICY_AT_REST;
}

/* What is wrong with a measurement. */
static unsigned faults(policy *p, const double *measured)
{
    double moved = 0.0;
    int same = 1;
    if (!measured || !within(measured, DBL_MAX))
        return POLICY_MISSING;
    for (int i = 0; i < N; i++) {
        const double way = POLICY_JUMP_SPEED * jump_speed[i] * (p->unseen + 1) * POLICY_PERIOD;
        if (fabs(measured[i] - p->seen[i]) > way + POLICY_JUMP_WAY * range[i])
            return POLICY_JUMPED;
        same &= measured[i] == p->seen[i];
        moved = fmax(moved, fabs(p->q[i] - p->since[i]) / range[i]);
    }
    if (!same) {
        memcpy(p->seen, measured, sizeof p->seen);
        memcpy(p->since, p->q, sizeof p->since);
    }
    p->same = same ? p->same + 1 : 0;
    return p->same > POLICY_MAX_STALE && moved > POLICY_STALE_WAY ? POLICY_STALE : 0;
}

LIEEDNN_API unsigned policy_step(policy *p, const double *measured, const double *target)
{
    unsigned status = 0;
    if (!p->started)
        return POLICY_FAILED;
    if (target && within(target, POLICY_ROUNDING)) {
        memcpy(p->wanted, target, sizeof p->wanted);
        limit(p->wanted);
    } else if (target)
        status |= POLICY_REFUSED;
    /* A policy without feedback needs no measurement. */
    if (POLICY_FEEDBACK)
        status |= faults(p, measured);
    const int unseen = (status & (POLICY_MISSING | POLICY_JUMPED)) != 0;
    p->unseen = unseen ? p->unseen + 1 : 0;
    if (p->unseen > POLICY_MAX_MISSING || status & POLICY_STALE)
        policy_stop(p);
    if (!p->braking)
        status |= act(p, POLICY_FEEDBACK && !unseen ? measured : NULL);
    if (p->braking)
        status |= brake(p);
    for (int bit = 0; bit < POLICY_BITS; bit++)
        p->count[bit] += status >> bit & 1;
    return status;
}
