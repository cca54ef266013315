/*
 * What UR's driver does in nearly every cycle: a state as RtdeFeed of cardan/drivers/ur_rtde/feed.py
 * takes it where nothing is unusual, and the answer of motion.py to a target for the joints; both to
 * the last bit. Whatever is unusual is left to these.
 *
 * cardan/drivers/ur_rtde/compiled.py mirrors the structures, and owns their memory.
 */
#ifndef CARDAN_UR_CYCLE_H
#define CARDAN_UR_CYCLE_H

#include <stddef.h>
#include <stdint.h>

#include "joint_limiter.h"

#if defined(__GNUC__)
#define UR_API __attribute__((visibility("default")))
#else
#define UR_API
#endif

#define UR_JOINTS LIMITED_JOINTS
#define UR_HEAD 4 /* bytes that all data packages of a recipe begin with */
#define UR_VECTORS 4
#define UR_INTEGERS 3
#define UR_STATE_SIZE (UR_HEAD + 8 * (3 + UR_VECTORS * UR_JOINTS) + 2 * 4 * UR_INTEGERS)
#define UR_COMMAND_SIZE (UR_HEAD + 4 * UR_INTEGERS + 2 * 8 * UR_JOINTS)

/* What a state is judged by. */
typedef struct {
    double largest_time_s, largest_position, largest_velocity, largest_scale;
    double rate_hz, period_s; /* of states */
    double slack_s, pause_s;  /* SLACK_S and PAUSE_S of missed_cycles.py */
    double astray_rad;        /* of a joint from its target */
    uint32_t moves_in;        /* safety modes, a bit for each */
    int32_t robot_mode;       /* of a program that obeys, and so the next three */
    uint32_t runtime_state;
    int32_t report, token;
    uint8_t head[UR_HEAD];
} UrStates;

/* AgreedTime of missed_cycles.py */
typedef struct {
    double controller_s, local_s, waited_s, best_s, end_s, credit_s, time_s;
} UrClock;

/* A Package of feed.py, and what follows from it. */
typedef struct {
    double timestamp;
    double joints[UR_VECTORS][UR_JOINTS]; /* target_q, target_qd, actual_q, actual_qd */
    int64_t modes[UR_INTEGERS];           /* robot_mode, safety_mode, runtime_state */
    double speed_scaling, target_speed_fraction;
    int64_t registers[UR_INTEGERS]; /* token, report, beat */
    double slider;
    int32_t obeys; /* the program runs, may move the arm, and no joint is astray */
} UrState;

typedef struct {
    JointLimits limits;
    double largest_position, largest_velocity; /* of a command */
    /* WORK_OFF_S and so on of missed_cycles.py */
    double work_off_s, work_off_share, recent_s, speed_up_s, slow_down_s, nothing;
    int32_t token, order;
    uint8_t head[UR_HEAD];
} UrCommands;

/* Where the reference is, and the command that it follows. */
typedef struct {
    double positions[UR_JOINTS], velocities[UR_JOINTS];
    double target[UR_JOINTS]; /* of the command before, where has_target */
    double reference[UR_JOINTS], velocity[UR_JOINTS];
    int32_t has_velocities, has_target;
} UrReference;

/* SlipCompensation of missed_cycles.py in motion */
typedef struct {
    double offset[UR_JOINTS], rate[UR_JOINTS], fastest;
    double before[UR_JOINTS]; /* speeds of the command before */
} UrSlip;

UR_API const char *ur_version(void);
UR_API size_t ur_layout(const size_t **values);

/* Read what came at `now_s`, and have the clock count it. 0, and the clock is not changed, where it is
 * anything but one usual state. */
UR_API int32_t ur_take(const UrStates *states, const uint8_t *data, int64_t length, double now_s,
                       UrClock *clock, UrState *into);

/* One period of SlipCompensation.step, which is added to the command. 0, and nothing is changed, where
 * the command rests, the slip ends, or a number is none or out of range. */
UR_API int32_t ur_follow(const UrCommands *commands, UrReference *reference, double dt_s,
                         UrSlip *slip);

/* One period of the limiter, and the data package in `into` of UR_COMMAND_SIZE bytes. 0, and nothing
 * is changed, where a number is none or out of range, or the period is not above 0. */
UR_API int32_t ur_answer(const UrCommands *commands, UrReference *reference, double dt_s,
                         int32_t beat, uint8_t *into);

#endif
