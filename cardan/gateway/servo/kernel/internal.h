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

/* Pairs of shapes of one body with one shape, which come nearer alike. */
typedef struct {
    double sweep[MAX_JOINTS], safety_m; /* of all its pairs, at most */
    double far_m;                       /* pairs whose `clear_m` is more do not matter now */
} PairGroup;

struct Kernel {
    KernelState state;
    Chain chain;
    ChainPose pose; /* where `state.q` was when the last call began */
    double jacobian[6][MAX_JOINTS];
    Programme programme;

    int n;
    double lower[MAX_JOINTS], upper[MAX_JOINTS], velocity[MAX_JOINTS], acceleration[MAX_JOINTS];
    double weights[6], scales[6];
    int equal_weights, full_rank, smallest;
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
    int32_t *near; /* pairs that may need a row of the programme, first those that have one */
    double *room;

    /* A pair that was far away need not be looked at before it can have come near. */
    uint64_t looks;   /* counts the poses that pairs were looked at in */
    uint64_t *placed; /* when a shape was placed */
    double looked_at[MAX_JOINTS];
    double travel_m;             /* how much nearer any pair can have come, all in all */
    double *clear_m; /* of each pair: what is left of its distance at least, plus `travel_m` then */
    PairGroup *groups;
    size_t group_count;
    int32_t *group; /* of each pair */
};

/* Distances of all pairs at `kernel->pose`, of the joints `q`: that of the nearest, and those below
 * `far_m`, exact; the others are larger than both, and no more is known of them. What others move
 * counts as near as it is less how much farther away it is kept. */
void kernel_separate(Kernel *kernel, const double *q, double far_m);

#endif
