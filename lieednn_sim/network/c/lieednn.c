#define LIEEDNN_ARRAYS
#include "lieednn.h"

#include <math.h>
#include <string.h>

static void add_inputs(const double x[LIEEDNN_SIZE], double sum[LIEEDNN_SIZE], double sign)
{
    for (int j = 0; j < LIEEDNN_SIZE; j++) {
        const double output = sign * LIEEDNN_PHI(x[j]);
        for (int i = 0; i < LIEEDNN_DRIVEN; i++)
            sum[i] += weight[j][i] * output;
    }
}

LIEEDNN_API void lieednn_field(const lieednn *net, const double x[LIEEDNN_SIZE], double rate[LIEEDNN_SIZE])
{
    for (int i = 0; i < LIEEDNN_SIZE; i++)
        rate[i] = net->bias[i] - LIEEDNN_GAMMA * x[i];
    add_inputs(x, rate, 1.0);
}

LIEEDNN_API void lieednn_step(lieednn *net, double h)
{
    static const double part[4] = {0.0, 0.5, 0.5, 1.0}, share[4] = {1.0, 2.0, 2.0, 1.0};
    double *at = net->work[0], *rate = net->work[1], *sum = net->work[2], *end = net->work[3];
    memset(rate, 0, sizeof net->work[1]);
    memset(sum, 0, sizeof net->work[2]);
    for (int stage = 0; stage < 4; stage++) {
        for (int i = 0; i < LIEEDNN_SIZE; i++)
            at[i] = net->x[i] + part[stage] * h * rate[i];
        lieednn_field(net, at, rate);
        for (int i = 0; i < LIEEDNN_SIZE; i++)
            sum[i] += share[stage] * rate[i];
    }
    for (int i = 0; i < LIEEDNN_SIZE; i++)
        end[i] = net->x[i] + h / 6.0 * sum[i];
    memcpy(net->x, end, sizeof net->x);
}

LIEEDNN_API void lieednn_init(lieednn *net)
{
    memset(net, 0, sizeof *net);
    memcpy(net->bias, bias, sizeof bias);
    memcpy(net->target, rest, sizeof net->target);
}

LIEEDNN_API void lieednn_start(lieednn *net, const double visible[LIEEDNN_VISIBLE])
{
    memcpy(net->x, visible, sizeof net->target);
#if LIEEDNN_HIDDEN
    memcpy(net->x + LIEEDNN_VISIBLE, hidden_start, sizeof hidden_start);
#endif
#if LIEEDNN_START_LAW
    /* From hidden_start by gains, with the way that the target has moved since the export. */
    for (int j = 0; j < LIEEDNN_VISIBLE; j++) {
        const double moved = net->target[j] - rest[j];
        for (int i = 0; i < LIEEDNN_HIDDEN; i++)
            net->x[LIEEDNN_VISIBLE + i] +=
                start_gain[i][j] * (visible[j] - start_reference[j] - moved) + goal_gain[i][j] * moved;
    }
#endif
}

LIEEDNN_API void lieednn_retarget(lieednn *net, const double target[LIEEDNN_VISIBLE])
{
    double *goal = net->work[0], *pull = net->work[1];
    memcpy(goal, rest, sizeof rest);
    memcpy(goal, target, sizeof net->target);
    for (int i = 0; i < LIEEDNN_SIZE; i++)
        pull[i] = LIEEDNN_GAMMA * goal[i];
    add_inputs(goal, pull, -1.0);
    memcpy(net->bias, pull, sizeof net->target);
    memcpy(net->target, target, sizeof net->target);
}
