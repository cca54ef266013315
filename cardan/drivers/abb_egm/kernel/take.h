/*
 * What a session makes of feedback as it comes in nearly every cycle: EgmSession.receive of
 * cardan/drivers/abb_egm/session.py where nothing is unusual, to the last bit. Whatever is anywhere
 * near a limit is left to that.
 *
 * cardan/drivers/abb_egm/compiled.py mirrors the structure, and owns its memory.
 */
#ifndef CARDAN_EGM_TAKE_H
#define CARDAN_EGM_TAKE_H

#include "read.h"

typedef struct {
    double nominal_s, lost_after_s, late_after_s;
    double longest_gap_s;                     /* between answers, of the controller's time */
    double jump, jump_per_s;                  /* rad or m, and by the second */
    double usual;                             /* largest sum of all coordinates */
    double rounding;                          /* of a quaternion's squared length */
    double shortest_squared, longest_squared; /* of a rotation's */
    double slack_s, most_credit_s;            /* SLACK_S and PAUSE_S of lost_time.py */
    int32_t by_joints;                        /* jumps are those of joints; else of the position */

    /* The session's, which both languages go on with. */
    int32_t states[3]; /* of the controller */
    int64_t tm_ms, time_us; /* its clocks at the newest datagram; below 0: not known */
    double last_step_s, since_reply_s, credit_s, replied_s;
    uint32_t out_seqno; /* of the next answer */
    int32_t said_speed; /* by the last one */
    int32_t steady;     /* no answer before has left anything to be made up for */

    /* Of the state before, where it is known; else it has to be put here. */
    int32_t known;
    double last_s;
    double joints[6], position[3], orientation[4];
    uint32_t seqno;

    /* Found in this datagram. */
    int32_t layout;
    double jitter_s;  /* how much earlier or later it came than its clock says */
    double turned[4]; /* the orientation, a unit quaternion on the side of the one before */
} EgmCycle;

/* Read a datagram that came at `now_s`, and take it for the next one of the session; 0, and nothing of
 * the session is changed, where it is not as usual. */
int32_t egm_take(EgmCycle *cycle, EgmReader *reader, const uint8_t *data, int64_t length,
                 double now_s);

/* The period of an answer at `now_s` to what came at `stamp_s`; 0 where something is to be made up
 * for or the answer is late. */
double egm_answer_period(const EgmCycle *cycle, double stamp_s, double now_s);

/* The time in its header, ms. */
uint32_t egm_answer_time(const EgmCycle *cycle, double now_s);

/* Note that it was given. */
void egm_answered(EgmCycle *cycle, int32_t moving, double now_s);

#endif
