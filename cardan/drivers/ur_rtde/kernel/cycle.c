#include "cycle.h"

#include <math.h>
#include <string.h>

#define SAFETY_MODES 32

/* -- the wire: big-endian ------------------------------------------------------------------------ */

static uint64_t get(const uint8_t **at, int size)
{
    uint64_t bits = 0;
    for (int i = 0; i < size; i++)
        bits = bits << 8 | (*at)[i];
    *at += size;
    return bits;
}

static double get_double(const uint8_t **at)
{
    uint64_t bits = get(at, 8);
    double value;
    memcpy(&value, &bits, sizeof value);
    return value;
}

static int64_t get_int32(const uint8_t **at)
{
    return (int32_t)(uint32_t)get(at, 4);
}

static uint8_t *put(uint8_t *at, uint64_t bits, int size)
{
    for (int i = 0; i < size; i++)
        at[i] = (uint8_t)(bits >> (8 * (size - 1 - i)));
    return at + size;
}

static uint8_t *put_doubles(uint8_t *at, const double *values)
{
    for (int i = 0; i < UR_JOINTS; i++) {
        uint64_t bits;
        memcpy(&bits, &values[i], sizeof bits);
        at = put(at, bits, 8);
    }
    return at;
}

/* -- states -------------------------------------------------------------------------------------- */

static void read_state(const uint8_t *at, UrState *into)
{
    into->timestamp = get_double(&at);
    for (int vector = 0; vector < UR_VECTORS; vector++)
        for (int i = 0; i < UR_JOINTS; i++)
            into->joints[vector][i] = get_double(&at);
    into->modes[0] = get_int32(&at);
    into->modes[1] = get_int32(&at);
    into->modes[2] = (int64_t)get(&at, 4); /* the only unsigned one */
    into->speed_scaling = get_double(&at);
    into->target_speed_fraction = get_double(&at);
    for (int i = 0; i < UR_INTEGERS; i++)
        into->registers[i] = get_int32(&at);
}

/* _implausible; the comparisons are false for NaN. */
static bool is_plausible(const UrStates *states, const UrState *state)
{
    return fabs(state->timestamp) <= states->largest_time_s &&
           joints_in_range(state->joints[0], states->largest_position) &&
           joints_in_range(state->joints[1], states->largest_velocity) &&
           joints_in_range(state->joints[2], states->largest_position) &&
           joints_in_range(state->joints[3], states->largest_velocity) &&
           fabs(state->speed_scaling) <= states->largest_scale &&
           fabs(state->target_speed_fraction) <= states->largest_scale;
}

/* AgreedTime.passed */
static bool count(const UrStates *states, double controller_s, double local_s, UrClock *clock)
{
    double step_s = controller_s - clock->controller_s, waited_s = local_s - clock->local_s;
    if (!(step_s > 0.0 && waited_s <= states->pause_s && local_s < clock->end_s &&
          controller_s - local_s <= clock->best_s) ||
        step_s * states->rate_hz >= 1.5)
        return false;
    /* believed_s */
    double found_s = step_s, slack_s = waited_s + states->slack_s;
    double credit_s = clock->credit_s + waited_s;
    if (found_s > states->period_s && found_s > slack_s)
        found_s = states->period_s > slack_s ? states->period_s : slack_s;
    if (found_s > credit_s)
        found_s = credit_s;
    if (!(found_s > 0.0))
        found_s = 0.0;
    credit_s -= found_s;
    clock->credit_s = credit_s < states->pause_s ? credit_s : states->pause_s;
    clock->controller_s = controller_s;
    clock->local_s = local_s;
    clock->waited_s = waited_s;
    clock->time_s += found_s;
    return true;
}

/* UrSession._watch finds nothing to end motion for, besides a program that does not answer. */
static bool obeys(const UrStates *states, const UrState *state)
{
    int64_t safety = state->modes[1];
    if (safety < 0 || safety >= SAFETY_MODES || !(states->moves_in >> safety & 1u) ||
        state->modes[0] != states->robot_mode || state->modes[2] != states->runtime_state ||
        state->registers[0] != states->token || state->registers[1] != states->report)
        return false;
    for (int i = 0; i < UR_JOINTS; i++)
        if (!(fabs(state->joints[2][i] - state->joints[0][i]) <= states->astray_rad))
            return false;
    return true;
}

int32_t ur_take(const UrStates *states, const uint8_t *data, int64_t length, double now_s,
                UrClock *clock, UrState *into)
{
    if (length != UR_STATE_SIZE || memcmp(data, states->head, UR_HEAD))
        return 0;
    read_state(data + UR_HEAD, into);
    if (!is_plausible(states, into) || !count(states, into->timestamp, now_s, clock))
        return 0;
    double own = into->speed_scaling, slider = into->target_speed_fraction;
    into->slider = 0.0 < own && own < 1.0 ? slider * own : slider;
    into->obeys = obeys(states, into);
    return 1;
}

/* -- commands ------------------------------------------------------------------------------------ */

static bool command_in_range(const UrCommands *commands, const UrReference *reference)
{
    return joints_in_range(reference->positions, commands->largest_position) &&
           (!reference->has_velocities ||
            joints_in_range(reference->velocities, commands->largest_velocity));
}

int32_t ur_follow(const UrCommands *commands, UrReference *reference, double dt_s, UrSlip *slip)
{
    const double *velocity = reference->velocities, nothing = commands->nothing;
    double ahead = 0.0, square = 0.0, faster = 0.0, size = 0.0;
    if (!is_period(dt_s) || !reference->has_velocities || !command_in_range(commands, reference))
        return 0;
    for (int i = 0; i < UR_JOINTS; i++) {
        double v = velocity[i], each = slip->offset[i], r = slip->rate[i];
        ahead += each * v;
        square += v * v;
        size += each * each;
        faster += r * (v + 0.5 * r);
    }
    if (!(square >= nothing * nothing) || !(size > 0.0))
        return 0;
    double fastest = slip->fastest * (1.0 - fmin(dt_s / commands->recent_s, 1.0)), back = 0.0;
    if (ahead > 0.0)
        back = -fmin(1.0 / commands->work_off_s, commands->work_off_share * sqrt(square / size));
    double share = fmin(dt_s / commands->slow_down_s, 1.0);
    if (faster <= 0.0) {
        double slower = 0.0, gain = 0.0;
        for (int i = 0; i < UR_JOINTS; i++) {
            double more = back * slip->offset[i] - slip->rate[i];
            slower += more * more;
            gain += more * velocity[i];
        }
        share = dt_s / commands->speed_up_s;
        if (gain > 0.0)
            share *= sqrt(square / slower);
        share = fmin(share, 1.0);
    }
    UrSlip next = *slip;
    bool left = false;
    for (int i = 0; i < UR_JOINTS; i++) {
        double each = slip->offset[i], v = velocity[i], r = slip->rate[i];
        double was = slip->before[i] + r, aim = v + back * each;
        double low = was > aim ? aim : was, high = was > aim ? was : aim;
        double speed = v + r + share * (back * each - r);
        speed = speed < low ? low : speed;
        speed = speed > high ? high : speed;
        next.rate[i] = r = speed - v;
        next.offset[i] = each = each + r * dt_s;
        left = left || !(fabs(each) <= nothing && fabs(r) <= nothing);
    }
    if (!left)
        return 0;
    next.fastest = fmax(fastest, sqrt(square));
    *slip = next;
    for (int i = 0; i < UR_JOINTS; i++) {
        reference->positions[i] += slip->offset[i];
        reference->velocities[i] += slip->rate[i];
    }
    return 1;
}

int32_t ur_answer(const UrCommands *commands, UrReference *reference, double dt_s, int32_t beat,
                  uint8_t *into)
{
    if (!is_period(dt_s) || !command_in_range(commands, reference))
        return 0;
    for (int i = 0; i < UR_JOINTS; i++) {
        double goal = reference->positions[i], forward = 0.0;
        if (reference->has_target)
            forward = (goal - reference->target[i]) / dt_s;
        else if (reference->has_velocities)
            forward = reference->velocities[i];
        forward = joint_desired(&commands->limits, i, goal, forward, reference->reference[i], dt_s);
        joint_advance(&commands->limits, i, forward, dt_s, reference->reference,
                      reference->velocity);
    }
    memcpy(into, commands->head, UR_HEAD);
    uint8_t *at = into + UR_HEAD;
    at = put(at, (uint32_t)commands->token, 4);
    at = put(at, (uint32_t)beat, 4);
    at = put(at, (uint32_t)commands->order, 4);
    at = put_doubles(at, reference->reference);
    put_doubles(at, reference->velocity);
    return 1;
}
