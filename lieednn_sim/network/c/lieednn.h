/* A neural ODE, x' = -gamma x + mu (W phi(x) + b), as C99; lieednn_numbers.h has its numbers, and says what is proved.

   A neuron's state is a twist (omega [rad], v in the network's unit of length); visible neurons come first. */
#ifndef LIEEDNN_H
#define LIEEDNN_H

#include "lieednn_numbers.h"

/* Before each function. A program with several networks has a file for each: it defines this as `static inline`,
   includes lieednn.c, and policy.c if there is one, and has functions of other names that call these. */
#ifndef LIEEDNN_API
#define LIEEDNN_API
#endif

#ifdef __cplusplus
extern "C" {
#endif

typedef struct {
    double x[LIEEDNN_SIZE]; /* state */
    double bias[LIEEDNN_SIZE]; /* mu b, which holds the target */
    double target[LIEEDNN_VISIBLE]; /* equilibrium of the visible neurons */
    double work[4][LIEEDNN_SIZE];
} lieednn;

/* The network at the target that it was exported with. Call lieednn_start next. */
LIEEDNN_API void lieednn_init(lieednn *net);

/* Begin a motion with the visible neurons at the given state; hidden ones start where their law says. */
LIEEDNN_API void lieednn_start(lieednn *net, const double visible[LIEEDNN_VISIBLE]);

/* Another target, under the same proof; a motion under way goes on to it. */
LIEEDNN_API void lieednn_retarget(lieednn *net, const double target[LIEEDNN_VISIBLE]);

/* The rate of a state, per unit of the network's time. */
LIEEDNN_API void lieednn_field(const lieednn *net, const double x[LIEEDNN_SIZE], double rate[LIEEDNN_SIZE]);

/* One step of the classical Runge-Kutta method, h in the network's time. */
LIEEDNN_API void lieednn_step(lieednn *net, double h);

#ifdef __cplusplus
}
#endif

#endif
