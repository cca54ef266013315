/* The joints of a robot that lags behind its command, as cardan/gateway/servo/response_lag.py has them. */
#include <string.h>

#include "internal.h"
#include "vectors.h"

/* How far that joint is away which is farthest, and which it is: the first of those alike; or the
 * first that is `enough` away. */
static double farthest(const Kernel *kernel, const double *place, const double *other,
                       double enough, int *joint)
{
    double most = -1.0;
    for (int i = 0; i < kernel->n && most < enough; i++) {
        double way = fabs(place[i] - other[i]);
        if (way > M_PI && kernel->past.turns >> i & 1)
            way = fabs(remainder(way, 2.0 * M_PI));
        if (way > most) {
            most = way;
            *joint = i;
        }
    }
    return most;
}

void kernel_keep_past(Kernel *kernel, double lag_s, int32_t turns)
{
    kernel->past.turns = turns;
    kernel->past.spacing_s = lag_s > 0.0 ? lag_s / (PAST_ROWS - 1) : 0.0;
    kernel->past.filled = false;
    kernel->past.newest = kernel->past.nearest = 0;
}

void kernel_note(Kernel *kernel, double stamp_s)
{
    Past *past = &kernel->past;
    if (past->spacing_s == 0.0 || (past->filled && !(stamp_s >= past->next_s)))
        return;
    /* After a gap the past is gone but for its newest row. */
    double missed = PAST_ROWS - 1;
    if (past->filled)
        missed = smaller((stamp_s - past->next_s) / past->spacing_s, missed);
    for (int i = 0; i <= (int)missed; i++) {
        past->newest = (past->newest + 1) % PAST_ROWS;
        memcpy(past->rows[past->newest], kernel->state.q, sizeof kernel->state.q);
    }
    past->filled = true;
    past->next_s = stamp_s + past->spacing_s;
}

/* The way from the nearest place of the past to the commanded one is still to come. */
static void catch_up(Kernel *kernel, double *joints)
{
    Past *past = &kernel->past;
    const double *commanded = kernel->state.q, *nearest = commanded;
    int joint = 0;
    double least = farthest(kernel, commanded, joints, INFINITY, &joint);
    double last = farthest(kernel, past->rows[past->nearest], joints, least, &joint);
    if (last < least) {
        least = last;
        nearest = past->rows[past->nearest];
    }
    for (int i = 0; i < PAST_ROWS; i++) {
        double away = farthest(kernel, past->rows[i], joints, least, &joint);
        if (away < least) {
            least = away;
            past->nearest = i;
            nearest = past->rows[i];
        }
    }
    if (nearest != commanded)
        for (int i = 0; i < kernel->n; i++)
            joints[i] += commanded[i] - nearest[i];
}

int32_t kernel_measure(Kernel *kernel)
{
    KernelState *state = &kernel->state;
    int joint = 0;
    if (kernel->past.filled)
        catch_up(kernel, state->pose_joints);
    kernel_pose_at(kernel);
    state->joint_error = farthest(kernel, state->q, state->pose_joints, INFINITY, &joint);
    return joint;
}
