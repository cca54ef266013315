#include "answer.h"

#include <math.h>
#include <stdbool.h>

/* As in limiters.py, which says why. */
#define TINY 1e-12

static bool in_range(const double *values, double largest)
{
    for (int i = 0; i < EGM_JOINTS; i++)
        if (!(fabs(values[i]) <= largest)) /* false for NaN */
            return false;
    return true;
}

static double stopping_speed(double distance, double acceleration, double dt_s)
{
    if (distance <= 0.0)
        return 0.0;
    double gain = acceleration * dt_s;
    return sqrt(gain * gain + 2.0 * acceleration * distance) - gain;
}

/* JointLimiter.track: the velocity with which axis `i` would reach its target. */
static double desired(const EgmAnswer *answer, int i, bool with_velocities, double dt_s)
{
    double goal = answer->positions[i], speed = answer->speed[i], forward = 0.0;
    if (answer->has_target)
        forward = (goal - answer->target[i]) / dt_s;
    else if (with_velocities)
        forward = answer->velocities[i];
    if (forward > speed)
        forward = speed;
    else if (forward < -speed)
        forward = -speed;
    double behind = goal - answer->reference[i] - forward * dt_s;
    double acceleration = answer->acceleration[i], gain = acceleration * dt_s;
    if (behind > TINY)
        forward += sqrt(gain * gain + 2.0 * acceleration * behind) - gain;
    else if (behind < -TINY)
        forward -= sqrt(gain * gain - 2.0 * acceleration * behind) - gain;
    return forward;
}

/* JointLimiter._advance */
static void advance(EgmAnswer *answer, int i, double velocity, double dt_s)
{
    double position = answer->reference[i], before = answer->velocity[i];
    double acceleration = answer->acceleration[i], speed = answer->speed[i];
    double highest = before + acceleration * dt_s, lowest = before - acceleration * dt_s;
    if (highest > speed)
        highest = speed;
    if (lowest < -speed)
        lowest = -speed;
    if (position > answer->inner_upper[i]) {
        double stop = stopping_speed(answer->upper[i] - position, acceleration, dt_s);
        if (stop < highest)
            highest = stop;
    }
    if (position < answer->inner_lower[i]) {
        double stop = -stopping_speed(position - answer->lower[i], acceleration, dt_s);
        if (stop > lowest)
            lowest = stop;
    }
    if (velocity < lowest)
        velocity = lowest;
    if (velocity > highest)
        velocity = highest;
    answer->velocity[i] = velocity;
    answer->reference[i] = position + velocity * dt_s;
}

static bool is_period(double dt_s)
{
    return dt_s > 0.0 && isfinite(dt_s);
}

/* JointGuidance._relocate */
static void relocate(EgmAnswer *answer)
{
    for (int i = 0; i < EGM_JOINTS; i++)
        answer->reference[i] = answer->measured[i] + answer->velocity[i] * answer->delay_s;
}

static int32_t reply(EgmAnswer *answer, uint32_t seqno, uint32_t tm_ms)
{
    answer->moving = false;
    for (int i = 0; i < EGM_JOINTS; i++)
        answer->moving |= answer->velocity[i] != 0.0;
    uint8_t *at = egm_put_header(answer->reply, seqno, tm_ms);
    if (answer->says & EGM_SAYS_POSITION)
        at = egm_put_joints(at, answer->reference);
    if (answer->says & EGM_SAYS_SPEED)
        at = egm_put_joint_speeds(at, answer->velocity);
    return (int32_t)(at - answer->reply);
}

int32_t egm_answer(EgmAnswer *answer, int32_t with_velocities, double dt_s, uint32_t seqno,
                   uint32_t tm_ms)
{
    if (!is_period(dt_s) || !in_range(answer->positions, answer->largest_position) ||
        (with_velocities && !in_range(answer->velocities, answer->largest_velocity)))
        return 0;
    for (int i = 0; i < EGM_JOINTS; i++) {
        advance(answer, i, desired(answer, i, with_velocities, dt_s), dt_s);
        answer->target[i] = answer->positions[i];
    }
    answer->has_target = true;
    return reply(answer, seqno, tm_ms);
}

int32_t egm_answer_speed(EgmAnswer *answer, double dt_s, uint32_t seqno, uint32_t tm_ms)
{
    if (!is_period(dt_s) || !in_range(answer->velocities, answer->largest_velocity))
        return 0;
    if (answer->relocates)
        relocate(answer);
    answer->has_target = false;
    for (int i = 0; i < EGM_JOINTS; i++)
        advance(answer, i, answer->velocities[i], dt_s);
    return reply(answer, seqno, tm_ms);
}

int32_t egm_answer_hold(EgmAnswer *answer, double dt_s, uint32_t seqno, uint32_t tm_ms)
{
    if (!is_period(dt_s))
        return 0;
    if (answer->relocates)
        relocate(answer);
    answer->has_target = false;
    bool moves = false;
    for (int i = 0; i < EGM_JOINTS; i++)
        moves |= answer->velocity[i] != 0.0;
    for (int i = 0; moves && i < EGM_JOINTS; i++)
        advance(answer, i, 0.0, dt_s);
    return reply(answer, seqno, tm_ms);
}
