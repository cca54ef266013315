#include "take.h"

#include <math.h>
#include <stdbool.h>
#include <string.h>

/* Sums are not added up in the same order by all versions of Python: nearer to a limit than this,
 * it decides. */
#define NEARLY 0.999

static bool is_plausible(const EgmCycle *cycle, const EgmReader *reader, double since_s)
{
    double sum = 0.0, squared = 0.0;
    for (int i = 0; i < 6; i++)
        sum += fabs(reader->joints[i]);
    for (int i = 0; i < 3; i++)
        sum += fabs(reader->position[i]);
    for (int i = 0; i < (cycle->by_joints ? 6 : 3); i++) {
        double way = cycle->by_joints ? reader->joints[i] - cycle->joints[i]
                                       : reader->position[i] - cycle->position[i];
        squared += way * way;
    }
    double farthest = NEARLY * (cycle->jump + cycle->jump_per_s * since_s);
    return sum <= NEARLY * cycle->usual && squared <= farthest * farthest;
}

/* _pose of session.py */
static bool turned(EgmCycle *cycle, const EgmReader *reader)
{
    double q[4], side = 0.0;
    const double *before = cycle->orientation;
    memcpy(q, reader->orientation, sizeof q);
    double squared = q[0] * q[0] + q[1] * q[1] + q[2] * q[2] + q[3] * q[3];
    if (!(-cycle->rounding < squared - 1.0 && squared - 1.0 < cycle->rounding)) {
        if (!(cycle->shortest_squared <= squared && squared <= cycle->longest_squared))
            return false;
        double length = sqrt(squared);
        for (int i = 0; i < 4; i++)
            q[i] /= length;
    }
    side = before[0] * q[0] + before[1] * q[1] + before[2] * q[2] + before[3] * q[3];
    for (int i = 0; i < 4; i++)
        cycle->turned[i] = side < 0.0 ? -q[i] : q[i];
    return true;
}

int32_t egm_take(EgmCycle *cycle, EgmReader *reader, const uint8_t *data, int64_t length,
                 double now_s)
{
    double since_s = now_s - cycle->last_s, period_s = cycle->nominal_s;
    int32_t found = egm_read(reader, data, length);
    if (found < 0 || reader->seqno != (uint32_t)(cycle->seqno + 1u) ||
        !(since_s < cycle->lost_after_s) ||
        memcmp(cycle->states, reader->layouts[found].states, sizeof cycle->states) ||
        !is_plausible(cycle, reader, since_s) || !turned(cycle, reader))
        return 0;
    if (cycle->time_us >= 0) {
        double measured_s = (double)(reader->time_us - cycle->time_us) * 1e-6;
        if (0.25 * period_s < measured_s && measured_s < 4.0 * period_s)
            period_s = measured_s;
    }
    /* believed_s of lost_time.py */
    period_s = fmin(period_s, fmax(cycle->nominal_s, since_s + cycle->slack_s));
    period_s = fmax(fmin(period_s, cycle->credit_s + since_s), 0.0);
    cycle->credit_s = fmin(cycle->credit_s + since_s - period_s, cycle->most_credit_s);
    cycle->last_s = now_s;
    cycle->seqno = reader->seqno;
    memcpy(cycle->joints, reader->joints, sizeof cycle->joints);
    memcpy(cycle->position, reader->position, sizeof cycle->position);
    memcpy(cycle->orientation, cycle->turned, sizeof cycle->orientation);
    cycle->known = true;
    cycle->layout = found;
    cycle->tm_ms = reader->tm_ms;
    cycle->time_us = reader->time_us;
    cycle->jitter_s = fabs(since_s - period_s);
    cycle->last_step_s = period_s;
    cycle->since_reply_s += period_s;
    return 1;
}

double egm_answer_period(const EgmCycle *cycle, double stamp_s, double now_s)
{
    bool good = cycle->steady && cycle->since_reply_s <= cycle->longest_gap_s &&
                now_s - stamp_s <= cycle->late_after_s &&
                now_s - cycle->replied_s <= cycle->late_after_s;
    return good ? cycle->since_reply_s : 0.0;
}

uint32_t egm_answer_time(const EgmCycle *cycle, double now_s)
{
    return (uint32_t)(cycle->tm_ms < 0 ? (int64_t)(now_s * 1e3) : cycle->tm_ms);
}

void egm_answered(EgmCycle *cycle, int32_t moving, double now_s)
{
    cycle->out_seqno++;
    cycle->said_speed = moving;
    cycle->replied_s = now_s;
    cycle->since_reply_s = 0.0;
}
