#include "joint_limiter.h"

#include <math.h>

/* As in limiters.py, which says why. */
#define TINY 1e-12

bool joints_in_range(const double *values, double largest)
{
    for (int i = 0; i < LIMITED_JOINTS; i++)
        if (!(fabs(values[i]) <= largest)) /* false for NaN */
            return false;
    return true;
}

bool is_period(double dt_s)
{
    return dt_s > 0.0 && isfinite(dt_s);
}

static double stopping_speed(double distance, double acceleration, double dt_s)
{
    if (!(distance > 0.0))
        return 0.0;
    double gain = acceleration * dt_s;
    return sqrt(gain * gain + 2.0 * acceleration * distance) - gain;
}

double joint_desired(const JointLimits *limits, int i, double goal, double forward, double reference,
                     double dt_s)
{
    double speed = limits->speed[i];
    if (forward > speed)
        forward = speed;
    else if (forward < -speed)
        forward = -speed;
    double behind = goal - reference - forward * dt_s;
    double acceleration = limits->acceleration[i], gain = acceleration * dt_s;
    if (behind > TINY)
        forward += sqrt(gain * gain + 2.0 * acceleration * behind) - gain;
    else if (behind < -TINY)
        forward -= sqrt(gain * gain - 2.0 * acceleration * behind) - gain;
    return forward;
}

/* JointLimiter._advance */
void joint_advance(const JointLimits *limits, int i, double velocity, double dt_s,
                   double *references, double *velocities)
{
    double position = references[i], before = velocities[i];
    double acceleration = limits->acceleration[i], speed = limits->speed[i];
    double highest = before + acceleration * dt_s, lowest = before - acceleration * dt_s;
    if (highest > speed)
        highest = speed;
    if (lowest < -speed)
        lowest = -speed;
    if (position > limits->inner_upper[i]) {
        double stop = stopping_speed(limits->upper[i] - position, acceleration, dt_s);
        if (stop < highest)
            highest = stop;
    }
    if (position < limits->inner_lower[i]) {
        double stop = -stopping_speed(position - limits->lower[i], acceleration, dt_s);
        if (stop > lowest)
            lowest = stop;
    }
    if (velocity < lowest)
        velocity = lowest;
    if (velocity > highest)
        velocity = highest;
    velocities[i] = velocity;
    references[i] = position + velocity * dt_s;
}
