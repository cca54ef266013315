/*
 * The answer to a controller of a six-axis arm in joint mode, in one call: the command's range, one
 * period of the limiter, and the message. What it does is cardan/drivers/limiters.py's JointLimiter
 * and the encoding of JointReferenceGenerator, to the last bit.
 *
 * cardan/drivers/abb_egm/compiled.py mirrors the structure, and owns its memory.
 */
#ifndef CARDAN_EGM_ANSWER_H
#define CARDAN_EGM_ANSWER_H

#include "joint_limiter.h"
#include "message.h"

#define EGM_JOINTS LIMITED_JOINTS

typedef struct {
    JointLimits limits;
    double largest_position, largest_velocity; /* of a command */
    double delay_s;                            /* from a reference to where it is measured */

    double target[EGM_JOINTS]; /* of the command before, where has_target */
    double reference[EGM_JOINTS], velocity[EGM_JOINTS];
    double positions[EGM_JOINTS], velocities[EGM_JOINTS]; /* of this command */

    double measured[EGM_JOINTS]; /* where relocates */

    int32_t has_target;
    int32_t says;   /* EGM_SAYS_POSITION, EGM_SAYS_SPEED */
    int32_t moving; /* after an answer: whether any velocity is not 0 */
    int32_t relocates; /* speeds and holds begin where the arm is by now */
    uint8_t reply[EGM_REPLY_MAX];
} EgmAnswer;

EGM_API const char *egm_version(void);
EGM_API size_t egm_layout(const size_t **values);

/* Each moves the reference by one period of `dt_s` and makes the reply; its bytes. 0, and nothing is
 * changed, where a number of the command is none or out of range, or the period is not above 0. */

/* Towards the command's positions, which move at its velocities, if there are any. */
int32_t egm_answer(EgmAnswer *answer, int32_t with_velocities, double dt_s, uint32_t seqno,
                           uint32_t tm_ms);
/* At the command's velocities. */
int32_t egm_answer_speed(EgmAnswer *answer, double dt_s, uint32_t seqno, uint32_t tm_ms);
/* Slower, to a stop. */
int32_t egm_answer_hold(EgmAnswer *answer, double dt_s, uint32_t seqno, uint32_t tm_ms);

#endif
