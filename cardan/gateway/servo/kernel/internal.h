#ifndef CARDAN_SERVO_INTERNAL_H
#define CARDAN_SERVO_INTERNAL_H

#include <stdbool.h>

#include "kernel.h"

/* No length, angle, speed or weight is larger; a product of a few of them is still a number. */
#define LARGEST 1e9

/* No loop is slower. */
#define LONGEST_PERIOD_S 10.0

static inline bool all_within(const double *values, size_t count, double low, double high)
{
    for (size_t i = 0; i < count; i++)
        if (!(values[i] >= low && values[i] <= high)) /* false for NaN */
            return false;
    return true;
}

/* The pairs of two bodies' shapes. */
typedef struct {
    int32_t low, high;    /* the bodies; the joints from `low` to before `high` move one to the other */
    size_t first, beyond; /* where in `order` they are */
    double sweep[MAX_JOINTS], safety_m; /* of all of them, at most */
    double deceleration_m_s2;           /* at least */
    double at[3];   /* middle of the ball around `high`, in the frame of `low`, when last looked at */
    double travel_m; /* how much nearer they can have come, all in all */
    double far_m;    /* those that are farther away do not matter now */
    double clear_m;  /* the least of theirs, or less */
} PairGroup;

/* Past commands that are kept: _ROWS of lag.py. */
#define PAST_ROWS 17

/* Commanded joints of the robot's lag, a ring of rows; without a row before the first command. */
typedef struct {
    double spacing_s, next_s; /* between rows, 0: none are kept; when the next is due */
    double rows[PAST_ROWS][MAX_JOINTS];
    int filled, newest, nearest; /* nearest: the row that was so last */
    int32_t turns;               /* bit i: whole turns of joint i make no difference */
} Past;

/* Around the shapes of a body, in its frame. */
typedef struct {
    double middle[3], radius_m;
} Ball;

struct Kernel {
    KernelState state;
    Chain chain;
    ChainPose pose; /* where `state.q` was when the last call began */
    double jacobian[6][MAX_JOINTS];
    Program program;

    Past past;

    int n;
    double lower[MAX_JOINTS], upper[MAX_JOINTS], velocity[MAX_JOINTS], acceleration[MAX_JOINTS];
    double weights[6], scales[6];
    int directions[6], counted; /* those that have a weight */
    int full_rank, smallest;
    double small_m, small_rad;
    KernelOptions options;

    size_t shape_count, pair_count;
    double farthest[MAX_JOINTS]; /* of all pairs' sweeps */
    double nearest_m;
    double *grown_m; /* of each shape: how much farther away than its pairs' distance it is kept */
    int ending, held; /* a joint's range bounds it; and is what slows the motion */
    double task[MAX_UNKNOWNS][6], back[6]; /* columns of the task, and the feedback, weighed */
    KernelShape *shapes;
    KernelPair *pairs;
    Body *bodies, *ahead; /* shapes where they are, and where a step would take them */
    Separation *separations;     /* of pairs that were looked at, when they were */
    int32_t *near; /* pairs that may need a row of the program, first those that have one */
    double *room;

    /* A pair that was far away need not be looked at before it can have come near. */
    uint64_t looks;   /* counts the poses that pairs were looked at in */
    uint64_t *placed; /* when a shape was placed */
    double looked_at[MAX_JOINTS];
    double *clear_m; /* of each pair: what is left of its distance at least, plus `travel_m` then */
    Ball balls[MAX_JOINTS + 1];                        /* of each body */
    int32_t group_of[MAX_JOINTS + 1][MAX_JOINTS + 1];  /* of two bodies; -1: none */
    PairGroup *groups;
    size_t group_count;
    int32_t *group, *order; /* of each pair; pairs, group after group */
};

/* Distances of all pairs at `kernel->pose`, of the joints `q`: that of the nearest, and those below
 * `far_m`, exact; the others are larger than both, and no more is known of them. What others move
 * counts as near as it is less how much farther away it is kept. */
void kernel_separate(Kernel *kernel, const double *q, double far_m);

#endif
