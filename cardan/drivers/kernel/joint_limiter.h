/*
 * One period of one axis of cardan/drivers/limiters.py's JointLimiter, to the last bit: for the
 * compiled parts of drivers.
 */
#ifndef CARDAN_JOINT_LIMITER_H
#define CARDAN_JOINT_LIMITER_H

#include <stdbool.h>

#define LIMITED_JOINTS 6

typedef struct {
    double lower[LIMITED_JOINTS], upper[LIMITED_JOINTS]; /* rad */
    double inner_lower[LIMITED_JOINTS], inner_upper[LIMITED_JOINTS];
    double speed[LIMITED_JOINTS], acceleration[LIMITED_JOINTS];
} JointLimits;

/* Whether all values are numbers of at most `largest`, above or below zero. */
bool joints_in_range(const double *values, double largest);

bool is_period(double dt_s);

/* With which velocity axis `i` would reach its goal, which moves at `forward`. */
double joint_desired(const JointLimits *limits, int i, double goal, double forward, double reference,
                     double dt_s);

/* Move the reference of axis `i` by one period, as near to `velocity` as it can. */
void joint_advance(const JointLimits *limits, int i, double velocity, double dt_s,
                   double *references, double *velocities);

#endif
