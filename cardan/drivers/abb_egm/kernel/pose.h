/*
 * The answer to a controller in pose mode, in one call: the command's range, one period of both
 * limiters, and the message. What it does is cardan/drivers/limiters.py's PointLimiter and
 * OrientationLimiter and the encoding of PoseReferenceGenerator, to the last bit.
 *
 * cardan/drivers/abb_egm/compiled.py mirrors the structures, and owns their memory.
 */
#ifndef CARDAN_EGM_POSE_H
#define CARDAN_EGM_POSE_H

#include "message.h"

typedef struct {
    double lower[3], upper[3]; /* m, where has_box */
    double speed, acceleration;
    double target[3]; /* of the command before, where has_target */
    double reference[3], velocity[3];
    int32_t has_box, has_target;
} EgmPoint;

typedef struct {
    double speed, acceleration;
    double target[4];
    double reference[4], velocity[3];
    int32_t has_target;
} EgmTurn;

typedef struct {
    double largest_position, largest_linear, largest_angular; /* of a command */
    double shortest_squared, longest_squared;                 /* of its quaternion */
    double delay_s; /* from a reference to where it is measured */
    EgmPoint point;
    EgmTurn turn;
    double position[3], orientation[4], linear[3], angular[3]; /* of this command */
    double measured_position[3], measured_orientation[4]; /* where relocates */
    int32_t says, moving, relocates;                      /* as in EgmAnswer */
    uint8_t reply[EGM_REPLY_MAX];
} EgmPoseAnswer;

/* As those of answer.h. */
int32_t egm_pose_answer(EgmPoseAnswer *answer, int32_t with_twist, double dt_s,
                                uint32_t seqno, uint32_t tm_ms);
int32_t egm_pose_answer_speed(EgmPoseAnswer *answer, double dt_s, uint32_t seqno,
                                      uint32_t tm_ms);
int32_t egm_pose_answer_hold(EgmPoseAnswer *answer, double dt_s, uint32_t seqno,
                                     uint32_t tm_ms);

#endif
