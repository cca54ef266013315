#include "tick.h"

#include <math.h>
#include <stdatomic.h>
#include <stdbool.h>
#include <stdlib.h>
#include <string.h>

/* ---------------------------------------------------------------------------------------------
 * Triple buffer: which of three buffers each side has, and which lies between them. */

#define FRESH 4u

typedef struct {
    _Atomic unsigned middle; /* index | FRESH: not read yet */
    unsigned writer;
    unsigned reader;
} Exchange;

static void exchange_reset(Exchange *exchange)
{
    exchange->writer = 0;
    atomic_store(&exchange->middle, 1u);
    exchange->reader = 2;
}

/* Hands over what the writer has filled. */
static void exchange_give(Exchange *exchange)
{
    unsigned old = atomic_exchange_explicit(&exchange->middle, exchange->writer | FRESH,
                                            memory_order_acq_rel);
    exchange->writer = old & 3u;
}

/* True if the reader has had what was given last. */
static bool exchange_was_taken(Exchange *exchange)
{
    return !(atomic_load_explicit(&exchange->middle, memory_order_relaxed) & FRESH);
}

/* True if there is something new, which the reader then has. */
static bool exchange_take(Exchange *exchange)
{
    if (!(atomic_load_explicit(&exchange->middle, memory_order_relaxed) & FRESH))
        return false;
    exchange->reader = atomic_exchange_explicit(&exchange->middle, exchange->reader,
                                                memory_order_acq_rel) & 3u;
    return true;
}

/* --------------------------------------------------------------------------------------------- */

enum { OUT, WAITING, RAMPING, IN };

#define FORCE_ERRORS 3
#define FORCE_ERRORS_WINDOW_S 10.0
#define BUZZ_RING 32
#define BUZZ_GAIN_FLOOR 0.3
#define BUZZ_RECOVERY_S 20.0
#define EDGE_FADE_M 0.02
#define DERATING_BAND 0.2
#define LONGEST_STEP_S 0.02
#define LONGEST_RELEASE_S 0.05 /* most_work() counts its ticks one by one */
/* A library divides the way of a late tick by its nominal period, and smooths that for as long: it
 * is no flight. Our own velocity knows the time. */
#define LIBRARY_SPEED_SETTLES_S 0.05
#define CALIBRATION_JUMP_M 0.002 /* no hand moves so far in a tick, short of the velocity gate */
#define STILL_TICKS 20 /* so many ticks without time are a clock that stands */
#define FREE_SPACE_N 0.1 /* commanded; no hand feels less through the device's own friction */
#define SURPLUS_J 0.05 /* what a spring of 40 N/m holds at 2 N: it may give that back */
#define ALPHA_SPEED_M_S 0.005
#define BISECTIONS 12
/* After the loop stood still for a moment a hand that leant on the force has begun to fall: it is met
 * soon, but not at once. After longer than pause_s nobody knows what the hand does. */
#define RESUME_RAMP_S 0.1
/* A tick that is late by less costs one regular step down; after one that is later the force is
 * let go, and comes back by the ramp. */
#define LATE_GRACE_S 0.005
/* So many interruptions within so long are no accidents: a force that comes and goes is worse than
 * none. After so long without any the force may engage again. */
#define INTERRUPTIONS 4
#define INTERRUPTIONS_WINDOW_S 1.0
#define CALM_S 0.5
/* Contacts of a switch bounce for some ms (its makers say 5 to 10, old ones 20), and no finger
 * presses twice so soon: the first edge counts at once, and then nothing for so long. */
#define BUTTON_LOCKOUT_S 0.025
/* A rate is low when it is for so long (a stall or two is none), and not low any more when it is
 * above the lowest by so much. */
#define SLOW_AFTER_S 0.05
#define RATE_RETURN 1.03
/* Readings that fail for so long are no accident either. */
#define UNSOUND_FAULT_S 0.1
/* A stamp may be ahead of the newest tick by so much: a loop that is dead is given up sooner. */
#define AHEAD_S 1.0

struct Tick {
    /* shared */
    _Atomic uint32_t word; /* state | reason << 8 | generation << 16 */
    _Atomic uint32_t dropped;
    _Atomic uint32_t losses;
    _Atomic int barred;     /* the motors are off */
    _Atomic double clock_s; /* of the newest tick; NaN: nothing ticks */
    Exchange command_exchange;
    TickCommand commands[3];
    uint32_t engagements[3]; /* how often commands had begun to be engaged, with each */
    Exchange limits_exchange;
    TickLimits limits_buffers[3];
    Exchange snapshot_exchange;
    TickSnapshot snapshots[3];

    /* the commanding side's */
    bool commanded_once;
    uint64_t given_sequence;
    double given_stamp_s;
    double given_pause_s;
    double given_hold_s;
    uint32_t given_engagements;
    bool given_engaged;

    /* the tick's own */
    TickLimits limits;
    const TickCommand *command; /* NULL: none yet */
    double command_seen_s;
    uint32_t generation;
    uint32_t engagement;
    bool anew; /* what comes next is an engagement of its own */
    bool was_alive;
    bool started;
    double now_s;
    bool located; /* position is one that motion can be measured from */
    double position[3];
    double moved[3]; /* since the tick before */
    double velocity[3];
    double period_s; /* smoothed */
    double sent[3];
    double directions[TICK_FIXTURES][3];
    int32_t direction_kinds[TICK_FIXTURES];
    double measured_stamp_s;
    double measured_extra[3];
    double distrust_until_s; /* the library's velocity */
    int32_t still_ticks; /* in a row, in which no time went by */
    int phase;
    int32_t small_ticks;
    double share;
    double ramp_s; /* how long the share takes to 1 */
    bool resumes;  /* the loop stood still, for a moment only, while force was out */
    double stalled_s; /* since then, where it resumes */
    bool broken;   /* force was interrupted, and is to come back by the ramp */
    double interruptions[INTERRUPTIONS];
    unsigned interruption_at;
    double irregular_s; /* the newest of them, or what would be one */
    bool slow;
    double slow_since_s;    /* TICK_NEVER: the rate is not low */
    double unsound_since_s; /* TICK_NEVER: the sample before was sound */
    double located_s;
    double given_j; /* booked as given to the hand in this engagement */
    double energy_j;
    double mean_square;
    double gain;
    int signs[3];
    double turns[3][BUZZ_RING];
    unsigned turn_at[3];
    int32_t buttons;
    double button_s[TICK_BUTTONS]; /* when its level changed last */
    double force_errors[FORCE_ERRORS];
    unsigned force_error_at;
    double quiet_until_s;
    double before_sent[3]; /* what was sent before `sent` */
    double own_gap_s;      /* this tick's, of which the snapshot has the longest */
    double own_cost_s;
    TickSnapshot now;
};

/* ---------------------------------------------------------------------------------------------
 * Vectors */

static double dot(const double a[3], const double b[3])
{
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
}

static double norm(const double a[3])
{
    return sqrt(dot(a, a));
}

static void set(double to[3], const double from[3])
{
    memcpy(to, from, 3 * sizeof(double));
}

static void clear(double a[3])
{
    a[0] = a[1] = a[2] = 0.0;
}

static void add(double to[3], double factor, const double a[3])
{
    for (int i = 0; i < 3; i++)
        to[i] += factor * a[i];
}

static void times(double to[3], const double m[9], const double a[3])
{
    for (int i = 0; i < 3; i++)
        to[i] = m[3 * i] * a[0] + m[3 * i + 1] * a[1] + m[3 * i + 2] * a[2];
}

static void times_transposed(double to[3], const double m[9], const double a[3])
{
    for (int i = 0; i < 3; i++)
        to[i] = m[i] * a[0] + m[3 + i] * a[1] + m[6 + i] * a[2];
}

static void limit_norm(double a[3], double most)
{
    double size = norm(a);
    if (size > most)
        for (int i = 0; i < 3; i++)
            a[i] *= most / size * (1.0 - 1e-15); /* not above it by rounding either */
}

static double within(double low, double value, double high)
{
    return value < low ? low : value > high ? high : value;
}

static bool finite_all(const double *values, size_t count)
{
    for (size_t i = 0; i < count; i++)
        if (!isfinite(values[i]))
            return false;
    return true;
}

static double determinant(const double m[9])
{
    return m[0] * (m[4] * m[8] - m[5] * m[7]) - m[1] * (m[3] * m[8] - m[5] * m[6]) +
           m[2] * (m[3] * m[7] - m[4] * m[6]);
}

static bool is_rotation(const double m[9])
{
    for (int i = 0; i < 3; i++)
        for (int j = i; j < 3; j++)
            if (fabs(dot(m + 3 * i, m + 3 * j) - (i == j)) > 1e-6)
                return false;
    return determinant(m) > 0.0;
}

/* x of transposed(m) x = a; false where that has no sound answer. */
static bool solve_transposed(double x[3], const double m[9], const double a[3])
{
    double d = determinant(m);
    if (!(fabs(d) > 1e-5)) /* m^3; 2.94e-3 in the middle of an Omni's room */
        return false;
    x[0] = ((m[4] * m[8] - m[5] * m[7]) * a[0] + (m[5] * m[6] - m[3] * m[8]) * a[1] +
            (m[3] * m[7] - m[4] * m[6]) * a[2]) / d;
    x[1] = ((m[2] * m[7] - m[1] * m[8]) * a[0] + (m[0] * m[8] - m[2] * m[6]) * a[1] +
            (m[1] * m[6] - m[0] * m[7]) * a[2]) / d;
    x[2] = ((m[1] * m[5] - m[2] * m[4]) * a[0] + (m[2] * m[3] - m[0] * m[5]) * a[1] +
            (m[0] * m[4] - m[1] * m[3]) * a[2]) / d;
    return true;
}

/* Shortens a force so that no joint needs a torque above `most`; true if it had to. */
static bool limit_torques(double force[3], const double jacobian[9], double most)
{
    double torques[3], largest = 0.0;
    times_transposed(torques, jacobian, force);
    for (int i = 0; i < 3; i++)
        largest = fmax(largest, fabs(torques[i]));
    if (largest <= most)
        return false;
    for (int i = 0; i < 3; i++)
        force[i] *= most / largest;
    return true;
}

/* ---------------------------------------------------------------------------------------------
 * Fixtures, world frame. `last` is the direction a fixture pushed along before, for where its
 * geometry has none. */

/* A one-sided spring and damper along the unit `out`; it never pulls. */
static void push_out(double force[3], const TickFixture *f, const double out[3], double depth,
                     const double velocity[3])
{
    if (depth > 0.0) {
        double size = f->stiffness_n_m * depth - f->damping_n_s_m * dot(velocity, out);
        add(force, within(0.0, size, f->cap_n), out);
    }
}

/* Of sphere and cylinder: `d` leads from the middle to the point. */
static void push_round(double force[3], const TickFixture *f, double d[3],
                       const double velocity[3], double last[3])
{
    double distance = norm(d);
    if (distance > 1e-9)
        for (int i = 0; i < 3; i++)
            last[i] = d[i] / distance;
    if (f->inside) {
        double in[3] = {-last[0], -last[1], -last[2]};
        push_out(force, f, in, distance - f->radius_m, velocity);
    } else {
        push_out(force, f, last, f->radius_m - distance, velocity);
    }
}

static void push_box(double force[3], const TickFixture *f, const double d[3],
                     const double velocity[3], double last[3])
{
    double p[3], v[3], push[3] = {0.0, 0.0, 0.0};
    times_transposed(p, f->rotation, d);
    times_transposed(v, f->rotation, velocity);
    if (f->inside) {
        for (int i = 0; i < 3; i++) {
            double in[3] = {0.0, 0.0, 0.0};
            in[i] = p[i] > 0.0 ? -1.0 : 1.0;
            push_out(push, f, in, fabs(p[i]) - f->axis[i], v);
        }
        limit_norm(push, f->cap_n);
    } else {
        int nearest = 0;
        double depth = INFINITY;
        for (int i = 0; i < 3; i++)
            if (f->axis[i] - fabs(p[i]) < depth) {
                depth = f->axis[i] - fabs(p[i]);
                nearest = i;
            }
        if (depth > 0.0) {
            double out[3] = {0.0, 0.0, 0.0};
            if (fabs(p[nearest]) > 1e-9)
                out[nearest] = p[nearest] > 0.0 ? 1.0 : -1.0;
            else if (fabs(last[nearest]) > 0.5)
                out[nearest] = last[nearest];
            else
                out[nearest] = 1.0;
            set(last, out);
            push_out(push, f, out, depth, v);
        }
    }
    double world[3];
    times(world, f->rotation, push);
    add(force, 1.0, world);
}

static void push_fixture(double force[3], const TickFixture *f, const double point[3],
                         const double velocity[3], double last[3])
{
    double d[3] = {point[0] - f->point[0], point[1] - f->point[1], point[2] - f->point[2]};
    switch (f->kind) {
    case TICK_SPHERE:
        push_round(force, f, d, velocity, last);
        break;
    case TICK_PLANE:
        push_out(force, f, f->axis, -dot(d, f->axis), velocity);
        break;
    case TICK_BOX:
        push_box(force, f, d, velocity, last);
        break;
    case TICK_CYLINDER:
        add(d, -dot(d, f->axis), f->axis);
        push_round(force, f, d, velocity, last);
        break;
    default: {
        double pull[3] = {0.0, 0.0, 0.0};
        if (f->kind == TICK_SPRING)
            add(pull, -f->stiffness_n_m, d);
        add(pull, -f->damping_n_s_m, velocity);
        limit_norm(pull, f->cap_n);
        add(force, 1.0, pull);
    }
    }
}

/* Some direction to begin with, where a fixture has shown none yet: away from the ground, or
 * square to a cylinder's axis. */
static void first_direction(double last[3], const TickFixture *f)
{
    clear(last);
    last[2] = 1.0;
    if (f->kind == TICK_CYLINDER) {
        int least = 0;
        for (int i = 1; i < 3; i++)
            if (fabs(f->axis[i]) < fabs(f->axis[least]))
                least = i;
        double other[3] = {0.0, 0.0, 0.0};
        other[least] = 1.0;
        add(other, -f->axis[least], f->axis);
        for (int i = 0; i < 3; i++)
            last[i] = other[i] / norm(other);
    } else if (f->kind == TICK_BOX) {
        clear(last);
    }
}

/* ---------------------------------------------------------------------------------------------
 * Commands and limits: the other thread's side */

#define R(field, low, high) {offsetof(TickLimits, field), low, high}

/* What a device may be driven with: limits.py has the reasons. */
static const struct {
    size_t at;
    double low, high;
} ranges[] = {
    R(clamp_n, 0.01, 3.3),
    R(slew_rise_n_s, 1.0, 400.0),
    R(slew_fall_n_s, 1.0, 3300.0),
    R(release_s, 0.001, 0.05),
    R(engage_ramp_s, 0.01, 10.0),
    R(engage_below_n, 0.001, 0.5),
    R(hold_s, 0.001, 0.2),
    R(pause_s, 0.001, 1.0),
    R(measured_hold_s, 0.001, 0.2),
    R(velocity_gate_m_s, 0.2, 2.0),
    R(damping_n_s_m, 0.0, 3.0),
    R(velocity_cutoff_hz, 5.0, 100.0),
    R(continuous_n, 0.01, 1.5),
    R(continuous_window_s, 1.0, 30.0),
    R(squeeze_s, 0.05, 10.0),
    R(temperature_limit, 0.05, 1.0),
    R(alpha_max_n_s_m, 0.0, 10.0),
    R(energy_budget_j, 0.0, 0.2),
    R(prediction_error_m, 1e-5, 1e-3),
    R(leak_s, 0.01, 60.0),
    R(edge_stiffness_n_m, 0.0, 500.0),
    R(extrapolate_s, 0.0, 0.05),
    R(overrun_gap_s, 0.0012, 0.02),
    R(pause_gap_s, 0.002, 0.1),
    R(buzz_window_s, 0.02, 1.0),
    R(buzz_speed_m_s, 0.001, 0.2),
    R(force_error_wait_s, 0.1, 10.0),
    R(torque_limit_n_m, 0.01, 0.5),
    R(lowest_rate_hz, 800.0, 960.0),
};

#undef R

static bool limits_are_in_range(const TickLimits *l)
{
    for (size_t i = 0; i < sizeof ranges / sizeof *ranges; i++) {
        double value;
        memcpy(&value, (const char *)l + ranges[i].at, sizeof value);
        if (value < ranges[i].low || value > ranges[i].high)
            return false;
    }
    for (int i = 0; i < 3; i++)
        if (l->workspace_lower_m[i] < -1.0 || l->workspace_upper_m[i] > 1.0)
            return false;
    return l->engage_ticks <= 10000;
}

static bool limits_are_sound(const TickLimits *l)
{
    if (!l->unchecked && !limits_are_in_range(l))
        return false;
    if (!finite_all(&l->clamp_n, offsetof(TickLimits, engage_ticks) / sizeof(double)))
        return false;
    for (int i = 0; i < 3; i++)
        if (!(l->workspace_lower_m[i] < l->workspace_upper_m[i]))
            return false;
    return l->clamp_n > 0.0 && l->clamp_n <= 3.3 && l->slew_rise_n_s > 0.0 && l->release_s > 0.0 &&
           l->release_s <= LONGEST_RELEASE_S &&
           l->slew_fall_n_s * l->release_s >= l->clamp_n * (1.0 - 1e-9) &&
           l->engage_ramp_s >= 0.0 && l->engage_below_n > 0.0 && l->hold_s > 0.0 &&
           l->pause_s >= l->hold_s && l->measured_hold_s > 0.0 && l->velocity_gate_m_s > 0.0 &&
           l->damping_n_s_m >= 0.0 && l->velocity_cutoff_hz > 0.0 && l->continuous_n > 0.0 &&
           l->continuous_window_s > 0.0 && l->squeeze_s > 0.0 && l->temperature_limit > 0.0 &&
           l->alpha_max_n_s_m >= 0.0 && l->energy_budget_j >= 0.0 &&
           l->prediction_error_m >= 0.0 && l->leak_s > 0.0 && l->edge_stiffness_n_m >= 0.0 &&
           l->extrapolate_s >= 0.0 && l->overrun_gap_s > 0.0 &&
           l->pause_gap_s >= l->overrun_gap_s && l->buzz_window_s > 0.0 &&
           l->buzz_speed_m_s > 0.0 && l->force_error_wait_s >= 0.0 &&
           l->torque_limit_n_m > 0.0 && l->lowest_rate_hz >= 0.0 && l->engage_ticks >= 1 && l->buzz_changes >= 2 &&
           l->buzz_changes <= BUZZ_RING;
}

static int check_command(const TickCommand *c)
{
    if (c->fixture_count < 0 || c->fixture_count > TICK_FIXTURES)
        return TICK_TOO_MANY_FIXTURES;
    if (!isfinite(c->stamp_s) ||
        !finite_all(c->linear, (offsetof(TickCommand, fixtures) - offsetof(TickCommand, linear)) /
                                   sizeof(double)))
        return TICK_NOT_FINITE;
    if (!is_rotation(c->rotation))
        return TICK_NOT_A_ROTATION;
    if (c->force_scale < 0.0 || c->measured_stiffness_n_m < 0.0)
        return TICK_NEGATIVE;
    for (int i = 0; i < c->fixture_count; i++) {
        const TickFixture *f = c->fixtures + i;
        if (!finite_all(f->point, (sizeof *f - offsetof(TickFixture, point)) / sizeof(double)))
            return TICK_NOT_FINITE;
        if (f->radius_m < 0.0 || f->stiffness_n_m < 0.0 || f->cap_n < 0.0 || f->damping_n_s_m < 0.0)
            return TICK_NEGATIVE;
        if ((f->kind == TICK_PLANE || f->kind == TICK_CYLINDER) &&
            fabs(norm(f->axis) - 1.0) > 1e-6)
            return TICK_NOT_UNIT;
        if (f->kind == TICK_BOX) {
            if (f->axis[0] < 0.0 || f->axis[1] < 0.0 || f->axis[2] < 0.0)
                return TICK_NEGATIVE;
            if (!is_rotation(f->rotation))
                return TICK_NOT_A_ROTATION;
        }
    }
    return TICK_TAKEN;
}

int tick_command(Tick *tick, const TickCommand *command, double now_s)
{
    int wrong = check_command(command);
    if (wrong)
        return wrong;
    double ahead = tick->given_hold_s;
    if (!isfinite(now_s)) {
        now_s = atomic_load_explicit(&tick->clock_s, memory_order_relaxed);
        ahead = AHEAD_S;
    }
    if (command->stamp_s > now_s + ahead) /* false for NaN */
        return TICK_OF_THE_FUTURE;
    bool believed = !(tick->given_stamp_s > now_s + tick->given_hold_s);
    if (tick->commanded_once && believed &&
        (command->stamp_s < tick->given_stamp_s ||
         (command->sequence <= tick->given_sequence &&
          command->stamp_s < tick->given_stamp_s + tick->given_pause_s))) {
        atomic_fetch_add_explicit(&tick->dropped, 1u, memory_order_relaxed);
        return TICK_DROPPED;
    }
    tick->commanded_once = true;
    tick->given_sequence = command->sequence;
    tick->given_stamp_s = command->stamp_s;
    size_t used = offsetof(TickCommand, fixtures) +
                  (size_t)command->fixture_count * sizeof(TickFixture);
    memcpy(&tick->commands[tick->command_exchange.writer], command, used);
    tick->given_engagements += command->engaged && !tick->given_engaged;
    tick->given_engaged = command->engaged != 0;
    tick->engagements[tick->command_exchange.writer] = tick->given_engagements;
    exchange_give(&tick->command_exchange);
    return TICK_TAKEN;
}

int tick_set_limits(Tick *tick, const TickLimits *limits)
{
    if (!limits_are_sound(limits))
        return TICK_BAD_LIMIT;
    tick->given_pause_s = limits->pause_s;
    tick->given_hold_s = limits->hold_s;
    tick->limits_buffers[tick->limits_exchange.writer] = *limits;
    exchange_give(&tick->limits_exchange);
    return TICK_TAKEN;
}

uint32_t tick_dropped(const Tick *tick)
{
    return atomic_load_explicit(&tick->dropped, memory_order_relaxed);
}

Tick *tick_create(const TickLimits *limits)
{
    if (!limits_are_sound(limits))
        return NULL;
    Tick *tick = calloc(1, sizeof *tick);
    if (!tick)
        return NULL;
    exchange_reset(&tick->command_exchange);
    exchange_reset(&tick->limits_exchange);
    exchange_reset(&tick->snapshot_exchange);
    atomic_store(&tick->word, TICK_DISABLED | TICK_NOT_ENABLED << 8);
    tick->limits = *limits;
    tick->given_pause_s = limits->pause_s;
    tick->given_hold_s = limits->hold_s;
    atomic_store(&tick->clock_s, NAN);
    for (int i = 0; i < TICK_BUTTONS; i++)
        tick->button_s[i] = TICK_NEVER;
    for (int i = 0; i < INTERRUPTIONS; i++)
        tick->interruptions[i] = TICK_NEVER;
    tick->irregular_s = tick->slow_since_s = tick->unsound_since_s = TICK_NEVER;
    tick->period_s = TICK_PERIOD_S;
    tick->gain = 1.0;
    tick->quiet_until_s = tick->distrust_until_s = TICK_NEVER;
    tick->measured_stamp_s = TICK_NEVER;
    for (int i = 0; i < FORCE_ERRORS; i++)
        tick->force_errors[i] = TICK_NEVER;
    for (int i = 0; i < TICK_FIXTURES; i++)
        tick->direction_kinds[i] = -1;
    tick->now.stamp_s = TICK_NEVER;
    tick->now.command_age_s = tick->now.force_age_s = INFINITY;
    tick->now.squeeze = 1.0;
    tick->now.realtime = -1;
    tick->now.calibration = -1;
    tick->now.reason = TICK_NOT_ENABLED;
    tick->now.rotation[0] = tick->now.rotation[4] = tick->now.rotation[8] = 1.0;
    tick->snapshots[tick->snapshot_exchange.reader] = tick->now;
    return tick;
}

void tick_destroy(Tick *tick)
{
    free(tick);
}

/* ---------------------------------------------------------------------------------------------
 * The operating state: one word, so that a request and a fault never overwrite each other. */

static uint32_t word_of(uint32_t state, uint32_t reason, uint32_t generation)
{
    return state | reason << 8 | (generation & 0xffffu) << 16;
}

int tick_request(Tick *tick, int verb)
{
    uint32_t word = atomic_load(&tick->word);
    for (;;) {
        uint32_t state = word & 0xffu, generation = word >> 16, next;
        if (verb == TICK_ENABLE && state == TICK_ENABLED)
            return 0;
        if (verb == TICK_ENABLE && (state == TICK_DISABLED || state == TICK_FAULT))
            next = word_of(TICK_ENABLED, TICK_AS_COMMANDED, generation + 1);
        else if (verb == TICK_DISABLE)
            next = word_of(TICK_DISABLED, TICK_NOT_ENABLED, generation);
        else if (verb == TICK_PAUSE && (state == TICK_ENABLED || state == TICK_PAUSED))
            next = word_of(TICK_PAUSED, TICK_PAUSED_ON_REQUEST, generation);
        else if (verb == TICK_RESUME && state == TICK_PAUSED)
            next = word_of(TICK_ENABLED, TICK_AS_COMMANDED, generation + 1);
        else
            return -1;
        if (atomic_compare_exchange_weak(&tick->word, &word, next))
            return 0;
    }
}

int tick_state(const Tick *tick)
{
    return (int)(atomic_load(&tick->word) & 0xffffu);
}

/* From the tick: to `state` because of `reason`, unless a request came in between. */
static bool go(Tick *tick, uint32_t *word, uint32_t state, uint32_t reason)
{
    uint32_t next = word_of(state, reason, *word >> 16);
    if (!atomic_compare_exchange_strong(&tick->word, word, next))
        return false;
    *word = next;
    return true;
}

/* A fault is latched whatever was requested meanwhile. */
static void fault(Tick *tick, uint32_t *word, uint32_t reason)
{
    while ((*word & 0xffu) != TICK_FAULT)
        if (go(tick, word, TICK_FAULT, reason)) {
            tick->now.faults++;
            tick->phase = OUT;
        }
}

void tick_lose(Tick *tick)
{
    atomic_store(&tick->clock_s, NAN);
    uint32_t word = atomic_load(&tick->word);
    while ((word & 0xffu) != TICK_FAULT)
        if (go(tick, &word, TICK_FAULT, TICK_FAULT_DEVICE))
            atomic_fetch_add(&tick->losses, 1u);
}

void tick_allow(Tick *tick, int allowed)
{
    atomic_store(&tick->barred, !allowed);
}

static void publish(Tick *tick)
{
    uint32_t word = atomic_load(&tick->word);
    tick->now.state = (int32_t)(word & 0xffu);
    if (exchange_was_taken(&tick->snapshot_exchange)) {
        tick->now.gap_s = tick->own_gap_s;
        tick->now.cost_s = tick->own_cost_s;
    }
    tick->snapshots[tick->snapshot_exchange.writer] = tick->now;
    exchange_give(&tick->snapshot_exchange);
}

void tick_snapshot(Tick *tick, TickSnapshot *snapshot)
{
    exchange_take(&tick->snapshot_exchange);
    *snapshot = tick->snapshots[tick->snapshot_exchange.reader];
    snapshot->faults += atomic_load(&tick->losses);
    uint32_t word = atomic_load(&tick->word);
    if ((int32_t)(word & 0xffu) != snapshot->state) {
        snapshot->state = (int32_t)(word & 0xffu);
        snapshot->reason = (int32_t)(word >> 8 & 0xffu);
    }
}

static void note_error(Tick *tick, uint32_t code, int32_t internal)
{
    tick->now.errors++;
    tick->now.error = code;
    tick->now.internal_error = internal;
}

void tick_error(Tick *tick, uint32_t code, int32_t internal, double now_s)
{
    note_error(tick, code, internal);
    if ((code & 0xff00u) == 0x0200u) {
        tick->now.force_errors++;
        tick->quiet_until_s = now_s + tick->limits.force_error_wait_s;
        tick->phase = OUT;
        tick->force_errors[tick->force_error_at] = now_s;
        tick->force_error_at = (tick->force_error_at + 1) % FORCE_ERRORS;
        if (tick->force_errors[tick->force_error_at] > now_s - FORCE_ERRORS_WINDOW_S) {
            uint32_t word = atomic_load(&tick->word);
            fault(tick, &word, TICK_FAULT_FORCE_ERRORS);
            tick->now.reason = (int32_t)(word >> 8 & 0xffu);
            for (int i = 0; i < FORCE_ERRORS; i++)
                tick->force_errors[i] = TICK_NEVER;
        }
    }
    publish(tick);
}

void tick_fatal(Tick *tick, uint32_t code, int32_t internal)
{
    note_error(tick, code, internal);
    uint32_t word = atomic_load(&tick->word);
    fault(tick, &word, TICK_FAULT_DEVICE);
    tick->now.reason = (int32_t)(word >> 8 & 0xffu);
    clear(tick->sent); /* the frame was lost, and with it the force */
    set(tick->now.force, tick->sent);
    publish(tick);
}

void tick_set_realtime(Tick *tick, int realtime)
{
    tick->now.realtime = realtime;
}

void tick_set_finished(Tick *tick, int finished)
{
    tick->now.finished = finished;
    publish(tick);
}

/* ---------------------------------------------------------------------------------------------
 * The parts of a step */

static void count_buttons(Tick *tick, int32_t raw, double now_s)
{
    for (int i = 0; i < TICK_BUTTONS; i++) {
        if (!((raw ^ tick->buttons) >> i & 1) ||
            fabs(now_s - tick->button_s[i]) < BUTTON_LOCKOUT_S)
            continue;
        tick->button_s[i] = now_s;
        tick->buttons ^= 1 << i;
        tick->now.presses[i] += (uint32_t)(tick->buttons >> i & 1);
    }
}

/* Whether the loop is too slow for force. */
static bool is_slow(Tick *tick, double now_s)
{
    double rate = 1.0 / tick->period_s, lowest = tick->limits.lowest_rate_hz;
    if (rate >= lowest * (tick->slow ? RATE_RETURN : 1.0)) {
        tick->slow = false;
        tick->slow_since_s = TICK_NEVER;
    } else if (tick->slow_since_s == TICK_NEVER) {
        tick->slow_since_s = now_s;
    } else if (now_s - tick->slow_since_s >= SLOW_AFTER_S) {
        tick->slow = true;
    }
    return tick->slow;
}

/* Notes an interruption; true if there were too many. */
static bool too_irregular(Tick *tick, double now_s)
{
    tick->interruptions[tick->interruption_at] = now_s;
    tick->interruption_at = (tick->interruption_at + 1) % INTERRUPTIONS;
    return tick->interruptions[tick->interruption_at] > now_s - INTERRUPTIONS_WINDOW_S;
}

static void forget_interruptions(Tick *tick)
{
    for (int i = 0; i < INTERRUPTIONS; i++)
        tick->interruptions[i] = TICK_NEVER;
}

/* A first-order low-pass of the exact difference quotient; sound for any period, zero too. */
static void filter_velocity(Tick *tick, double dt)
{
    double omega = 2.0 * M_PI * tick->limits.velocity_cutoff_hz;
    for (int i = 0; i < 3; i++)
        tick->velocity[i] = (tick->velocity[i] + omega * tick->moved[i]) / (1.0 + omega * dt);
}

/* True once the velocity has changed sign often enough in the window. */
static bool buzzes(Tick *tick, double now_s)
{
    bool found = false;
    unsigned changes = (unsigned)tick->limits.buzz_changes;
    for (int i = 0; i < 3; i++) {
        if (fabs(tick->velocity[i]) < tick->limits.buzz_speed_m_s)
            continue;
        int sign = tick->velocity[i] > 0.0 ? 1 : -1;
        if (tick->signs[i] && sign != tick->signs[i]) {
            double *ring = tick->turns[i];
            ring[tick->turn_at[i] % BUZZ_RING] = now_s;
            tick->turn_at[i]++;
            if (tick->turn_at[i] >= changes &&
                ring[(tick->turn_at[i] - changes) % BUZZ_RING] > now_s - tick->limits.buzz_window_s)
                found = true;
        }
        tick->signs[i] = sign;
    }
    if (found)
        tick->turn_at[0] = tick->turn_at[1] = tick->turn_at[2] = 0;
    return found;
}

static void forget_buzz(Tick *tick)
{
    tick->gain = 1.0;
    tick->turn_at[0] = tick->turn_at[1] = tick->turn_at[2] = 0;
}

/* The force that was measured elsewhere, as it may be now. */
static void render_measured(Tick *tick, const TickCommand *c, double now_s, double force[3])
{
    const TickLimits *l = &tick->limits;
    double age = now_s - c->measured_stamp_s;
    tick->now.force_age_s = age;
    if (c->measured_stamp_s != tick->measured_stamp_s) {
        tick->measured_stamp_s = c->measured_stamp_s;
        clear(tick->measured_extra);
        age = within(0.0, age, l->extrapolate_s);
        add(tick->measured_extra, age, c->measured_rate_n_s);
    } else if (age <= l->extrapolate_s) {
        clear(tick->measured_extra);
        add(tick->measured_extra, within(0.0, age, age), c->measured_rate_n_s);
    } else {
        age = INFINITY; /* what was last extrapolated stays */
    }
    if (isfinite(age) && c->measured_stiffness_n_m > 0.0) {
        add(tick->measured_extra, -c->measured_stiffness_n_m, tick->position);
        add(tick->measured_extra, c->measured_stiffness_n_m, c->measured_position);
    }
    if (tick->now.force_age_s < -l->hold_s)
        tick->now.force_age_s = INFINITY; /* of a time to come: not to be believed */
    if (tick->now.force_age_s > l->measured_hold_s)
        return;
    double felt[3];
    set(felt, c->measured_force);
    add(felt, 1.0, tick->measured_extra);
    limit_norm(felt, l->clamp_n);
    add(force, 1.0, felt);
}

/* What the command asks for here and now, hand frame. */
static void render(Tick *tick, const TickSample *s, double now_s, double force[3])
{
    const TickCommand *c = tick->command;
    const TickLimits *l = &tick->limits;
    clear(force);
    tick->now.force_age_s = INFINITY;
    if (c->has_torques) {
        if (!solve_transposed(force, s->jacobian, c->torques_n_m))
            clear(force);
        return;
    }
    double point[3], velocity[3], world[3] = {0.0, 0.0, 0.0};
    times(point, c->linear, tick->position);
    add(point, 1.0, c->offset);
    times(velocity, c->linear, tick->velocity);
    for (int i = 0; i < c->fixture_count; i++) {
        if (tick->direction_kinds[i] != c->fixtures[i].kind) {
            tick->direction_kinds[i] = c->fixtures[i].kind;
            first_direction(tick->directions[i], c->fixtures + i);
        }
        push_fixture(world, c->fixtures + i, point, velocity, tick->directions[i]);
    }
    for (int i = c->fixture_count; i < TICK_FIXTURES; i++)
        tick->direction_kinds[i] = -1;

    double edge[3], outside = 0.0;
    for (int i = 0; i < 3; i++) {
        edge[i] = within(l->workspace_lower_m[i], tick->position[i], l->workspace_upper_m[i]) -
                  tick->position[i];
        outside = fmax(outside, fabs(edge[i]));
    }
    double scale = c->force_scale * within(0.0, 1.0 - outside / EDGE_FADE_M, 1.0);
    double hand[3];
    times_transposed(hand, c->rotation, world);
    add(force, scale, hand);
    if (c->has_measured)
        render_measured(tick, c, now_s, force);
    add(force, 1.0, c->force);
    add(force, l->edge_stiffness_n_m, edge);
}

/* Most that may yet be booked should `force` be sent now and fall to zero from then on: R(F) of
 * tick.h. `sent` is the force before it, whose work may not be booked yet. */
static double most_work(const double force[3], const double sent[3], const double moved[3],
                        double fall, double error)
{
    double size = norm(force);
    double speed = size > 0.0 ? dot(force, moved) / size : 0.0;
    double work = fmax(size * (speed + error), dot(sent, moved) + norm(sent) * error);
    for (int j = 2; size > 0.0; j++) {
        double next = fmax(0.0, size - fall);
        double farther = speed + j * error;
        work += fmax(size * farther, next * farther);
        size = next;
    }
    return work;
}

static bool slew_allows(const double from[3], const double to[3], double rise, double fall)
{
    double d[3] = {to[0] - from[0], to[1] - from[1], to[2] - from[2]};
    return norm(d) <= (norm(to) > norm(from) ? rise : fall) * (1.0 + 1e-12);
}

/* From `from` towards `target` as far as the slew limit lets it. */
static void slew(double to[3], const double from[3], const double target[3], double rise,
                 double fall)
{
    double d[3] = {target[0] - from[0], target[1] - from[1], target[2] - from[2]};
    double distance = norm(d), size = norm(from);
    set(to, from);
    if (distance <= 0.0)
        return;
    add(to, fmin(1.0, fall / distance), d);
    if (norm(to) > size) {
        set(to, from);
        add(to, fmin(1.0, rise / distance), d);
    }
}

/* Takes from `force` so much that the tank never runs dry. What works on the hand goes first;
 * where that is not enough the force falls along its own direction, which is always allowed. */
static bool spare_energy(Tick *tick, double force[3], double rise, double fall, double tank)
{
    double moved[3], step = tick->limits.slew_fall_n_s * tick->period_s;
    double error = tick->limits.prediction_error_m;
    double most = fmax(tank, 0.0);
    set(moved, tick->moved);
    if (most_work(force, tick->sent, moved, step, error) <= most)
        return false;
    double length = norm(moved), away = 0.0;
    double idle[3];
    set(idle, force);
    if (length > 0.0 && (away = dot(force, moved) / length) > 0.0) {
        double bare[3];
        set(bare, force);
        add(bare, -away / length, moved);
        slew(idle, tick->sent, bare, rise, fall);
    }
    double safe[3], from[3], to[3];
    set(to, force);
    if (most_work(idle, tick->sent, moved, step, error) <= most) {
        set(safe, idle);
    } else {
        set(to, idle);
        set(safe, tick->sent);
        double size = norm(safe);
        add(safe, size > fall ? -fall / size : -1.0, tick->sent);
    }
    set(from, safe);
    double low = 0.0, high = 1.0;
    for (int i = 0; i < BISECTIONS; i++) {
        double middle = 0.5 * (low + high), tried[3];
        for (int j = 0; j < 3; j++)
            tried[j] = from[j] + middle * (to[j] - from[j]);
        if (most_work(tried, tick->sent, moved, step, error) <= most &&
            slew_allows(tick->sent, tried, rise, fall)) {
            low = middle;
            set(safe, tried);
        } else {
            high = middle;
        }
    }
    set(force, safe);
    return true;
}

/* ---------------------------------------------------------------------------------------------
 * The step */

static bool sample_is_finite(const TickSample *s)
{
    return finite_all(&s->now_s, offsetof(TickSample, encoders) / sizeof(double));
}

void tick_begin(Tick *tick)
{
    clear(tick->sent);
    clear(tick->before_sent);
    clear(tick->velocity);
    set(tick->now.force, tick->sent);
    tick->started = tick->located = tick->was_alive = false;
    tick->resumes = tick->broken = tick->slow = false;
    tick->slow_since_s = tick->unsound_since_s = TICK_NEVER;
    tick->phase = OUT;
    tick->period_s = TICK_PERIOD_S;
    tick->still_ticks = 0;
}

void tick_step(Tick *tick, const TickSample *s, TickOutput *output)
{
    TickSnapshot *now = &tick->now;
    const TickLimits *l = &tick->limits;
    if (exchange_take(&tick->limits_exchange))
        tick->limits = tick->limits_buffers[tick->limits_exchange.reader];

    /* Time. A clock that stands still or goes back gives no step of the slew limit. */
    bool numbers = s->unsound ? isfinite(s->now_s) : sample_is_finite(s);
    bool sound = numbers && !s->unsound;
    double now_s = isfinite(s->now_s) ? s->now_s : tick->now_s + tick->period_s;
    double gap = tick->started ? now_s - tick->now_s : TICK_PERIOD_S;
    double dt = within(0.0, gap, LONGEST_STEP_S);
    bool late = tick->started && gap > l->overrun_gap_s;
    tick->now_s = now_s;
    tick->started = true;
    now->ticks++;
    if (isfinite(s->now_s))
        atomic_store_explicit(&tick->clock_s, now_s, memory_order_relaxed);
    tick->own_gap_s = gap;
    tick->own_cost_s = isfinite(s->cost_s) ? s->cost_s : 0.0;
    now->gap_s = fmax(now->gap_s, tick->own_gap_s);
    now->cost_s = fmax(now->cost_s, tick->own_cost_s);
    now->late_ticks += late;
    if (dt > 0.0)
        tick->period_s += 0.02 * (within(0.25e-3, dt, 4e-3) - tick->period_s);
    now->rate_hz = 1.0 / tick->period_s;

    if (exchange_take(&tick->command_exchange)) {
        tick->command = &tick->commands[tick->command_exchange.reader];
        tick->command_seen_s = now_s;
    }
    const TickCommand *c = tick->command;

    uint32_t word = atomic_load(&tick->word);
    uint32_t engagement = c ? tick->engagements[tick->command_exchange.reader] : 0;
    if (word >> 16 != tick->generation || engagement != tick->engagement) {
        tick->generation = word >> 16;
        tick->engagement = engagement;
        tick->anew = true;
        tick->resumes = false;
        tick->phase = OUT;
    }

    /* Work of the force sent last, and motion. A position that jumps because the calibration
     * changed is no motion. */
    double energy_before = tick->energy_j;
    clear(tick->moved);
    if (sound) {
        for (int i = 0; i < 3; i++)
            tick->moved[i] = s->position[i] - tick->position[i];
        bool jump = !s->calibrated != !now->calibrated && norm(tick->moved) > CALIBRATION_JUMP_M;
        if (tick->located && !jump) {
            double work = fmax(dot(tick->sent, tick->moved), dot(tick->before_sent, tick->moved));
            tick->energy_j -= work;
            tick->given_j += work;
            now->delivered_j += work;
            now->given_peak_j = fmax(now->given_peak_j, tick->given_j);
        } else {
            clear(tick->moved);
            clear(tick->velocity);
        }
        set(tick->position, s->position);
        filter_velocity(tick, fmax(tick->located ? now_s - tick->located_s : gap, 0.0));
        tick->located = true;
        tick->located_s = now_s;
        count_buttons(tick, s->buttons, now_s);
        now->stamp_s = now_s;
        set(now->position, s->position);
        memcpy(now->rotation, s->rotation, sizeof now->rotation);
        set(now->joints_rad, s->joints_rad);
        set(now->gimbal_rad, s->gimbal_rad);
        memcpy(now->encoders, s->encoders, sizeof now->encoders);
        now->temperature = s->temperature;
        now->inkwell = s->inkwell;
        now->calibrated = s->calibrated;
        now->calibration = s->calibration;
    }
    now->buttons = tick->buttons;
    set(now->velocity, tick->velocity);

    /* What forbids force. */
    int reason = TICK_AS_COMMANDED;
    double age = c ? fmax(now_s - c->stamp_s, now_s - tick->command_seen_s) : INFINITY;
    if (c && c->stamp_s > now_s + l->hold_s)
        age = INFINITY; /* of a time to come: not to be believed */
    tick->still_ticks = dt > 0.0 ? 0 : tick->still_ticks + 1;
    bool alive = age <= l->hold_s && tick->still_ticks < STILL_TICKS;
    bool fell_silent = !alive && tick->was_alive;
    now->stale_commands += fell_silent;
    tick->was_alive = alive;
    now->command_age_s = age;
    now->command_sequence = c ? c->sequence : 0;

    double force[3] = {0.0, 0.0, 0.0};
    if (c && sound)
        render(tick, s, now_s, force);
    bool finite = finite_all(force, 3);
    if (late)
        tick->distrust_until_s = now_s + LIBRARY_SPEED_SETTLES_S;
    double told = now_s < tick->distrust_until_s ? 0.0 : norm(s->velocity);
    bool fast = fmax(norm(tick->velocity), told) > l->velocity_gate_m_s;
    if (!finite)
        clear(force);
    bool failed = s->unsound && tick->unsound_since_s == TICK_NEVER;
    if (!s->unsound)
        tick->unsound_since_s = TICK_NEVER;
    else if (failed)
        tick->unsound_since_s = now_s;
    now->bad_readings += s->unsound != 0;
    if (!numbers || !finite) {
        fault(tick, &word, TICK_FAULT_NOT_FINITE);
    } else if (s->unsound) {
        if (now_s - tick->unsound_since_s >= UNSOUND_FAULT_S)
            fault(tick, &word, TICK_FAULT_READINGS);
    } else if (fast && s->calibrated && (tick->phase >= RAMPING || norm(tick->sent) > 0.0)) {
        fault(tick, &word, TICK_FAULT_VELOCITY);
    }
    bool let_go = late && gap > LATE_GRACE_S;
    if (!alive || let_go || s->unsound)
        tick->irregular_s = now_s;
    if ((word & 0xffu) == TICK_PAUSED) {
        uint32_t because = word >> 8 & 0xffu;
        if ((because == TICK_PAUSED_IRREGULAR &&
             ((c && !c->engaged) || now_s - tick->irregular_s >= CALM_S)) ||
            ((because == TICK_PAUSED_SILENT || because == TICK_PAUSED_LATE) && alive && !late) ||
            (because == TICK_PAUSED_BUZZ && c && !c->engaged))
            go(tick, &word, TICK_ENABLED, TICK_AS_COMMANDED);
        else if (because == TICK_PAUSED_LATE && age > l->pause_s)
            go(tick, &word, TICK_PAUSED, TICK_PAUSED_SILENT);
    }
    if ((word & 0xffu) == TICK_ENABLED && tick->phase != OUT) {
        if (buzzes(tick, now_s)) {
            now->buzzes++;
            tick->gain *= 0.5;
            if (tick->gain < BUZZ_GAIN_FLOOR)
                go(tick, &word, TICK_PAUSED, TICK_PAUSED_BUZZ);
        }
        if (tick->phase >= RAMPING && c && c->engaged && (fell_silent || let_go || failed)) {
            tick->broken = true;
            if (too_irregular(tick, now_s))
                go(tick, &word, TICK_PAUSED, TICK_PAUSED_IRREGULAR);
        }
        if ((word & 0xffu) == TICK_ENABLED && late && gap > l->pause_gap_s &&
            go(tick, &word, TICK_PAUSED, TICK_PAUSED_LATE)) {
            tick->resumes = tick->phase >= RAMPING;
            tick->stalled_s = now_s - gap;
        }
    }
    if ((word & 0xffu) == TICK_ENABLED && c && c->engaged && age > l->pause_s)
        go(tick, &word, TICK_PAUSED, TICK_PAUSED_SILENT);
    tick->gain = fmin(1.0, tick->gain + dt / BUZZ_RECOVERY_S);

    bool hold_phase = false, slow = is_slow(tick, now_s);
    bool barred = atomic_load_explicit(&tick->barred, memory_order_relaxed) != 0;
    bool away = sound && (!s->calibrated || s->inkwell);
    if ((word & 0xffu) != TICK_ENABLED) {
        reason = (int)(word >> 8 & 0xffu);
    } else if (barred) {
        reason = TICK_NO_OUTPUT;
    } else if (slow) {
        reason = TICK_TOO_SLOW;
    } else if (!sound) {
        reason = TICK_NO_READING;
        hold_phase = true;
    } else if (!s->calibrated) {
        reason = TICK_UNCALIBRATED;
    } else if (s->inkwell) {
        reason = TICK_DOCKED;
    } else if (!c) {
        reason = TICK_NO_COMMAND;
    } else if (!c->engaged) {
        reason = TICK_NOT_ENGAGED;
    } else if (!alive) {
        reason = TICK_SILENT;
        hold_phase = true;
    } else if (now_s < tick->quiet_until_s) {
        reason = TICK_AFTER_FORCE_ERROR;
    } else if (late) {
        reason = TICK_LATE;
        hold_phase = true;
    }

    /* Engagement. */
    bool forbidden = reason && reason != TICK_PAUSED_LATE && !hold_phase;
    if (forbidden || barred || slow || away || now_s < tick->quiet_until_s || age > l->pause_s ||
        !(fabs(now_s - tick->stalled_s) <= l->pause_s))
        tick->resumes = false;
    if (reason) {
        if (!hold_phase) {
            tick->phase = OUT;
            tick->broken = false;
        }
    } else {
        if (tick->phase == OUT && norm(tick->sent) <= 0.0) {
            tick->phase = WAITING;
            tick->small_ticks = 0;
            if (tick->anew) {
                tick->anew = false;
                tick->energy_j = tick->given_j = energy_before = 0.0;
                forget_buzz(tick);
                forget_interruptions(tick);
            }
            if (tick->resumes) {
                tick->phase = RAMPING;
                tick->share = 0.0;
                tick->ramp_s = fmin(RESUME_RAMP_S, l->engage_ramp_s);
                tick->resumes = false;
            }
        }
        if (tick->broken && tick->phase >= RAMPING) {
            /* On from what is still out. */
            double asked = norm(force);
            if (asked > 0.0)
                tick->share = fmin(tick->share, norm(tick->sent) / asked);
            if (tick->phase == IN && tick->share < 1.0) {
                tick->phase = RAMPING;
                tick->ramp_s = fmin(RESUME_RAMP_S, l->engage_ramp_s);
            }
        }
        tick->broken = false;
        if (tick->phase == OUT) {
            reason = TICK_NOT_SMALL;
        } else if (tick->phase == WAITING) {
            tick->share = 0.0;
            tick->small_ticks =
                norm(force) < l->engage_below_n && !fast ? tick->small_ticks + 1 : 0;
            if (tick->small_ticks >= l->engage_ticks) {
                tick->phase = RAMPING;
                tick->ramp_s = l->engage_ramp_s;
            }
            reason = TICK_NOT_SMALL;
        } else if (tick->phase == RAMPING) {
            tick->share += tick->ramp_s > 0.0 ? dt / tick->ramp_s : 1.0;
            if (tick->share >= 1.0) {
                tick->share = 1.0;
                tick->phase = IN;
            } else {
                reason = TICK_ENGAGING;
            }
        }
    }

    /* The target. */
    bool rendering = !reason || reason == TICK_ENGAGING;
    bool torque_mode = s->by_torque || (c && c->has_torques);
    double target[3] = {0.0, 0.0, 0.0};
    double alpha = 0.0;
    double mean_most = l->continuous_n * l->continuous_n;
    double heat = fmin(1.0, sqrt(mean_most + fmax(0.0, mean_most - tick->mean_square) *
                                                 l->continuous_window_s / l->squeeze_s) /
                                l->clamp_n);
    now->squeeze =
        heat * within(0.0, (l->temperature_limit - now->temperature) / DERATING_BAND, 1.0);
    if (rendering) {
        add(target, tick->share * tick->gain, force);
        if (tick->gain < 1.0 && !reason)
            reason = TICK_BUZZ;
        if (!c->has_torques)
            add(target, -tick->share * l->damping_n_s_m, tick->velocity);
        double speed2 = dot(tick->velocity, tick->velocity);
        if (l->passivity && tick->energy_j < 0.0 && speed2 > ALPHA_SPEED_M_S * ALPHA_SPEED_M_S) {
            alpha = fmin(l->alpha_max_n_s_m, -tick->energy_j / (tick->period_s * speed2));
            add(target, -alpha, tick->velocity);
        }
        if (torque_mode && limit_torques(target, s->jacobian, l->torque_limit_n_m) && !reason)
            reason = TICK_CLAMPED;
        double most = l->clamp_n * now->squeeze;
        if (norm(target) > most) {
            limit_norm(target, most);
            if (!reason)
                reason = now->squeeze < 1.0 ? TICK_THERMAL : TICK_CLAMPED;
        }
    }

    /* What is sent. */
    double rise = l->slew_rise_n_s * fmin(dt, l->overrun_gap_s), fall = l->slew_fall_n_s * dt;
    if (tick->still_ticks >= STILL_TICKS)
        fall = l->slew_fall_n_s * TICK_PERIOD_S;
    double sent[3];
    bool graced = reason == TICK_LATE && !let_go;
    slew(sent, tick->sent, target, rise,
         graced ? fmin(fall, l->slew_fall_n_s * TICK_PERIOD_S) : fall);
    if (rendering || graced) {
        double short_of[3] = {target[0] - sent[0], target[1] - sent[1], target[2] - sent[2]};
        if (!reason && norm(short_of) > 1e-9)
            reason = TICK_SLEWING;
        if (l->passivity &&
            spare_energy(tick, sent, rise, fall, tick->energy_j + l->energy_budget_j) && rendering)
            reason = TICK_PASSIVITY;
    }
    if (!finite_all(sent, 3)) {
        clear(sent);
        fault(tick, &word, TICK_FAULT_NOT_FINITE);
    }

    /* A surplus would let a later contact give as much: what damping alone took in is none, it
     * fades while nothing is asked for, and it has an end. But never so that the force that is out
     * could overdraw what is left. */
    if (tick->energy_j > 0.0) {
        double kept = fmin(tick->energy_j, SURPLUS_J);
        if (norm(force) < FREE_SPACE_N)
            kept = fmin(kept, fmax(0.0, energy_before)) * fmax(0.0, 1.0 - dt / l->leak_s);
        double needed = most_work(sent, tick->sent, tick->moved, l->slew_fall_n_s * tick->period_s,
                                  l->prediction_error_m) - l->energy_budget_j;
        tick->energy_j = fmax(kept, fmin(tick->energy_j, needed));
    }

    double torques[3] = {0.0, 0.0, 0.0};
    if (torque_mode && sound)
        limit_torques(sent, s->jacobian, l->torque_limit_n_m); /* the joints have moved since */
    if (sound)
        times_transposed(torques, s->jacobian, sent);
    else
        torque_mode = false;
    set(tick->before_sent, tick->sent);
    set(tick->sent, sent);
    tick->mean_square += (dot(sent, sent) - tick->mean_square) *
                         -expm1(-dt / l->continuous_window_s);

    set(now->commanded, force);
    set(now->force, sent);
    now->rendering = rendering;
    now->peak_n = fmax(now->peak_n, norm(sent));
    set(now->torques_n_m, torques);
    now->energy_j = tick->energy_j;
    now->alpha_n_s_m = alpha;
    now->reason = reason;
    set(output->force, sent);
    set(output->torques_n_m, torques);
    output->torque_mode = torque_mode;
    output->state = (int32_t)(word & 0xffu);
    publish(tick);
}

/* --------------------------------------------------------------------------------------------- */

#define F(type, field) offsetof(type, field)

static const size_t layout[] = {
    sizeof(TickLimits), F(TickLimits, clamp_n), F(TickLimits, slew_rise_n_s),
    F(TickLimits, slew_fall_n_s), F(TickLimits, release_s), F(TickLimits, engage_ramp_s),
    F(TickLimits, engage_below_n), F(TickLimits, hold_s), F(TickLimits, pause_s),
    F(TickLimits, measured_hold_s), F(TickLimits, velocity_gate_m_s),
    F(TickLimits, damping_n_s_m), F(TickLimits, velocity_cutoff_hz), F(TickLimits, continuous_n),
    F(TickLimits, continuous_window_s), F(TickLimits, squeeze_s),
    F(TickLimits, temperature_limit), F(TickLimits, alpha_max_n_s_m),
    F(TickLimits, energy_budget_j), F(TickLimits, prediction_error_m), F(TickLimits, leak_s),
    F(TickLimits, workspace_lower_m), F(TickLimits, workspace_upper_m),
    F(TickLimits, edge_stiffness_n_m), F(TickLimits, extrapolate_s), F(TickLimits, overrun_gap_s),
    F(TickLimits, pause_gap_s), F(TickLimits, buzz_window_s), F(TickLimits, buzz_speed_m_s),
    F(TickLimits, force_error_wait_s), F(TickLimits, torque_limit_n_m),
    F(TickLimits, lowest_rate_hz), F(TickLimits, engage_ticks), F(TickLimits, buzz_changes),
    F(TickLimits, passivity), F(TickLimits, unchecked),

    sizeof(TickFixture), F(TickFixture, kind), F(TickFixture, inside), F(TickFixture, point),
    F(TickFixture, axis), F(TickFixture, rotation), F(TickFixture, radius_m),
    F(TickFixture, stiffness_n_m), F(TickFixture, cap_n), F(TickFixture, damping_n_s_m),

    sizeof(TickCommand), F(TickCommand, sequence), F(TickCommand, stamp_s),
    F(TickCommand, engaged), F(TickCommand, fixture_count), F(TickCommand, has_measured),
    F(TickCommand, has_torques), F(TickCommand, linear), F(TickCommand, offset),
    F(TickCommand, rotation), F(TickCommand, force), F(TickCommand, force_scale),
    F(TickCommand, torques_n_m), F(TickCommand, measured_force),
    F(TickCommand, measured_stamp_s), F(TickCommand, measured_rate_n_s),
    F(TickCommand, measured_position), F(TickCommand, measured_stiffness_n_m),
    F(TickCommand, fixtures),

    sizeof(TickSample), F(TickSample, now_s), F(TickSample, position), F(TickSample, velocity),
    F(TickSample, rotation), F(TickSample, joints_rad), F(TickSample, gimbal_rad),
    F(TickSample, jacobian), F(TickSample, temperature), F(TickSample, cost_s),
    F(TickSample, encoders), F(TickSample, buttons), F(TickSample, inkwell),
    F(TickSample, calibrated), F(TickSample, calibration), F(TickSample, by_torque),
    F(TickSample, unsound),

    sizeof(TickOutput), F(TickOutput, force), F(TickOutput, torques_n_m),
    F(TickOutput, torque_mode), F(TickOutput, state),

    sizeof(TickSnapshot), F(TickSnapshot, stamp_s), F(TickSnapshot, ticks),
    F(TickSnapshot, state), F(TickSnapshot, reason), F(TickSnapshot, position),
    F(TickSnapshot, velocity), F(TickSnapshot, rotation), F(TickSnapshot, joints_rad),
    F(TickSnapshot, gimbal_rad), F(TickSnapshot, commanded), F(TickSnapshot, force),
    F(TickSnapshot, torques_n_m), F(TickSnapshot, energy_j), F(TickSnapshot, delivered_j),
    F(TickSnapshot, alpha_n_s_m), F(TickSnapshot, squeeze), F(TickSnapshot, temperature),
    F(TickSnapshot, command_sequence), F(TickSnapshot, command_age_s),
    F(TickSnapshot, force_age_s), F(TickSnapshot, gap_s), F(TickSnapshot, cost_s),
    F(TickSnapshot, rate_hz), F(TickSnapshot, encoders), F(TickSnapshot, buttons),
    F(TickSnapshot, inkwell), F(TickSnapshot, calibrated), F(TickSnapshot, calibration),
    F(TickSnapshot, presses), F(TickSnapshot, late_ticks), F(TickSnapshot, stale_commands),
    F(TickSnapshot, faults), F(TickSnapshot, buzzes), F(TickSnapshot, errors),
    F(TickSnapshot, force_errors), F(TickSnapshot, error), F(TickSnapshot, internal_error),
    F(TickSnapshot, realtime), F(TickSnapshot, finished), F(TickSnapshot, peak_n),
    F(TickSnapshot, given_peak_j), F(TickSnapshot, rendering),
    F(TickSnapshot, bad_readings),
};

size_t tick_layout(const size_t **values)
{
    *values = layout;
    return sizeof layout / sizeof *layout;
}
