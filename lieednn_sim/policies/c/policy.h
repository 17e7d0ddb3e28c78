/* A certified network as the policy of an arm, as C99: measured joints and target in, reference out, once a period.

   It computes what NetworkPolicy of the Python package computes, and does about faults what its control_loop does: the
   reference keeps the limits of position, velocity and acceleration, and brakes where measurements cannot be used. It
   allocates nothing, and a step takes a bounded number of operations. Its state is in a `policy` that you own.
   Joints [rad, m] are in the order of policy_numbers.h; a ball joint has the three entries of a rotation vector. */
#ifndef POLICY_H
#define POLICY_H

#include "lieednn.h"
#include "policy_numbers.h"

/* What is done about faults; who defines the first one before defines all. */
#ifndef POLICY_MAX_MISSING
#define POLICY_MAX_MISSING 20 /* periods in a row without a usable measurement, after which the policy brakes */
#define POLICY_JUMP_SPEED 2.0 /* a joint jumps that moved at more than this times its largest speed, */
#define POLICY_JUMP_WAY 0.01 /* and this fraction of its range on top */
#define POLICY_MAX_STALE 50 /* periods in a row in which all joints stay equal, after which the policy brakes, */
#define POLICY_STALE_WAY 0.005 /* if the reference moved by this fraction of a joint's range since */
#endif

/* The status of a period, as bits. */
enum {
    POLICY_MISSING = 1, /* nothing was measured, or something that is not finite: no feedback in this period */
    POLICY_JUMPED = 2, /* measured joints are further away than they can be: no feedback in this period */
    POLICY_STALE = 4, /* the measurement has stayed the same for too long: brakes */
    POLICY_REFUSED = 8, /* the target is not finite or beyond a limit: the last one stays; or a start is: no start */
    POLICY_FAILED = 16, /* the reference would not be finite: brakes from the last one; or there was no start */
    POLICY_LIMITED = 32, /* the network is slowed down by limits of velocity or acceleration; no fault */
    POLICY_BRAKING = 64, /* brakes, or has braked: only policy_start begins again */
    POLICY_AT_REST = 128, /* has braked, and rests */
    POLICY_BITS = 8
};

typedef struct {
    double q[POLICY_JOINTS], qd[POLICY_JOINTS]; /* the reference, at the end of the last period */
    double own_q[POLICY_JOINTS], own_qd[POLICY_JOINTS]; /* the network's, which that follows within the limits */
    double pace; /* how fast the network ran, as a fraction of its speed */
    double behind; /* largest distance of measured joints from the reference, as a fraction of their ranges */
    unsigned long count[POLICY_BITS]; /* in how many periods each bit was set */

    /* Its own. */
    lieednn net;
    int started, aimed, settled;
    unsigned braking, unseen, same; /* numbers of periods */
    double wanted[POLICY_JOINTS], target[POLICY_JOINTS], goal[LIEEDNN_VISIBLE]; /* last valid target; the one in use */
    double flow[LIEEDNN_SIZE], flow_rate[POLICY_JOINTS]; /* the network's field, and as rates of the joints */
    double mean[POLICY_JOINTS]; /* velocities in the last period */
    double seen[POLICY_JOINTS], since[POLICY_JOINTS]; /* last measurement, and the reference when it was new */
    double from[POLICY_JOINTS], rate[POLICY_JOINTS], end[POLICY_JOINTS], needed; /* way of braking, its time [s] */
} policy;

#ifdef __cplusplus
extern "C" {
#endif

/* Begin at rest where the joints are: 0; or POLICY_REFUSED. */
LIEEDNN_API unsigned policy_start(policy *p, const double q[POLICY_JOINTS]);

/* The reference for the end of the period that begins now, in p->q and p->qd, and the status. Both arguments may be
   NULL: nothing was measured; the target is the last one. */
LIEEDNN_API unsigned policy_step(policy *p, const double *measured, const double *target);

/* From the next step on brake, straight ahead and within the limits of acceleration, whatever is measured or wanted. */
LIEEDNN_API void policy_stop(policy *p);

#ifdef __cplusplus
}
#endif

#endif
