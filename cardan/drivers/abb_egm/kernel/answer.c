#include "answer.h"

#include <stdbool.h>

/* JointLimiter.track: how fast the target of axis `i` moves. */
static double forward(const EgmAnswer *answer, int i, bool with_velocities, double dt_s)
{
    if (answer->has_target)
        return (answer->positions[i] - answer->target[i]) / dt_s;
    return with_velocities ? answer->velocities[i] : 0.0;
}

static void advance(EgmAnswer *answer, int i, double velocity, double dt_s)
{
    joint_advance(&answer->limits, i, velocity, dt_s, answer->reference, answer->velocity);
}

/* JointReferenceGenerator._relocate */
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
    if (!is_period(dt_s) || !joints_in_range(answer->positions, answer->largest_position) ||
        (with_velocities && !joints_in_range(answer->velocities, answer->largest_velocity)))
        return 0;
    for (int i = 0; i < EGM_JOINTS; i++) {
        double velocity = joint_desired(&answer->limits, i, answer->positions[i],
                                        forward(answer, i, with_velocities, dt_s),
                                        answer->reference[i], dt_s);
        advance(answer, i, velocity, dt_s);
        answer->target[i] = answer->positions[i];
    }
    answer->has_target = true;
    return reply(answer, seqno, tm_ms);
}

int32_t egm_answer_speed(EgmAnswer *answer, double dt_s, uint32_t seqno, uint32_t tm_ms)
{
    if (!is_period(dt_s) || !joints_in_range(answer->velocities, answer->largest_velocity))
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
